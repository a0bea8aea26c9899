//! A recording as identification needs it: motion, forces and noise on one grid, independent of any
//! hypothesis.

mod at_rest;
pub mod joined;
pub mod lowpass;
pub mod measured;
pub mod records;
pub mod spectrum;
