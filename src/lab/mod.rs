//! Stage and controller in one process, without DDS.
