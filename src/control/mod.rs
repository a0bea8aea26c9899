//! How a stage is driven: PID, lowpass, feedforward, motion.
