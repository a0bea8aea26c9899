//! Quality of service of every topic, written out in full.
