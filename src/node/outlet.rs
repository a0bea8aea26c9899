//! A publisher that a dead or frozen subscriber cannot stall.
