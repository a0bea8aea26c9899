//! What a hypothesis leaves unexplained of a record: guides, effects and sensors driven along the
//! measured motion, and the force that is missing.

pub(crate) mod driven;
pub(crate) mod missing;
mod own_of_record;
pub(crate) mod slipping;
