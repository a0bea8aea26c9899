//! How a stage moves: guides, motor, carriage, sensors, effects.
