//! What an effect reads of the motion of a step, and the force that it answers with.

/// The motion that an effect sees: middle of a step (of each part of a step in which the carriage
/// reverses).
#[derive(Clone, Copy, Debug, Default)]
pub struct Motion {
    /// Time since the start, s.
    pub time: f64,
    /// Of the carriage, m.
    pub position: f64,
    /// Of the carriage, m/s; over the step the position changes by velocity times step.
    pub velocity: f64,
    /// Of the carriage, m/s^2, at the start of the step.
    pub acceleration: f64,
    /// Commanded motor force over the step, N.
    pub motor_force: f64,
    /// Friction of the guides as the step begins, N, positive against positive motion. For laws of
    /// friction alone.
    pub friction: f64,
}

/// A force along +x over a step: what comes early and what comes late in it move the samples on
/// either side unequally.
#[derive(Clone, Copy, Debug, Default)]
pub struct ForceOverStep {
    /// Mean of the force, N.
    pub mean: f64,
    /// Mean of the force times the time since the middle of the step, N times steps: between -1/4
    /// and 1/4 of the largest force.
    pub moment: f64,
}

impl ForceOverStep {
    pub(super) fn add(&mut self, other: ForceOverStep) {
        self.mean += other.mean;
        self.moment += other.moment;
    }
}
