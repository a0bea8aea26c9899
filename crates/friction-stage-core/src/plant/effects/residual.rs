//! What a recording leaves of a force after the declared model: what effects are guessed from.

/// What is left of a measured force after the declared model, sample by sample at a uniform rate;
/// all slices of one length.
///
/// `force` has the sign of an effect's force: what it would have to add along +x on its side. Motor
/// side: force cell less command. Carriage side and encoder: mass times acceleration plus friction
/// less force cell. Readings of the force cell: cell less command.
#[derive(Clone, Copy, Debug)]
pub struct Residual<'a> {
    /// Since the start of the record, s.
    pub time: &'a [f64],
    /// m
    pub position: &'a [f64],
    /// m/s
    pub velocity: &'a [f64],
    /// m/s^2
    pub acceleration: &'a [f64],
    /// Commanded motor force, N.
    pub command: &'a [f64],
    /// Friction of the guides along the motion as modelled, N, positive against positive motion.
    pub friction: &'a [f64],
    /// What an effect would have to add, N.
    pub force: &'a [f64],
    /// Moving mass as modelled, kg.
    pub mass: f64,
    /// The carriage side before the lowpass and at every sample: what is too fast for the rows
    /// above shows here.
    pub samples: Samples<'a>,
}

/// A residual at the rate of the recording.
#[derive(Clone, Copy, Debug)]
pub struct Samples<'a> {
    /// As the encoder says, m.
    pub position: &'a [f64],
    /// What an effect would have to add, N.
    pub force: &'a [f64],
    /// Time between samples, s.
    pub step: f64,
}
