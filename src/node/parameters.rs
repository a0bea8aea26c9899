//! Declared parameters and the six parameter services.
