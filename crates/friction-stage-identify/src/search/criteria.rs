//! What decides in a search, each with what it is a size of.

/// What decides in a search. Nothing here is a probability: over 30,000 rows every error is
/// significant, so that what counts is its size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Criteria {
    /// Fall of the logarithm of what is left beyond the noise, on either record, for which a
    /// hypothesis may have more parameters. Of two with as many that differ by less neither is
    /// better. A fifth of what is left: of up to four laws that are missing the strongest is a
    /// quarter of it at least.
    pub fall: f64,
    /// The same for a curve, or a ripple whose phase is each record's own, in place of laws that
    /// are an answer, and for a law alongside such a one: either can follow what the other leaves.
    /// Half of what is left.
    pub fall_of_curve: f64,
    /// Mean square of the carriage that counts like nothing, in squares of its noise floor: the
    /// measured motion stands for the true one, and guides differ from each other.
    pub blur_of_carriage: f64,
    /// The same of the motor behind a force cell, whose model is exact.
    pub blur_of_motor: f64,
    /// Noise floors up to which the residual of a record passes for noise.
    pub noise_like: f64,
    /// Share of what can be explained that laws which are the answer may leave.
    pub left_at_most: f64,
    /// Noise floors that they may leave.
    pub floors_at_most: f64,
    /// Part of a force beyond which the noise of the sensors hides it.
    pub hidden: f64,
    /// Tolerances beyond which a parameter of sliding is another guide's.
    pub far_guides: f64,
    /// Periods within the travel from which on a ripple has shown that it is one.
    pub least_periods: f64,
}

impl Criteria {
    /// Those of every search that is not to try others.
    pub const USUAL: Criteria = Criteria {
        fall: 0.2,
        fall_of_curve: std::f64::consts::LN_2,
        blur_of_carriage: 1.0,
        blur_of_motor: 0.08,
        noise_like: 2.0,
        left_at_most: 0.05,
        floors_at_most: 15.0,
        hidden: 0.5,
        far_guides: 3.0,
        least_periods: 3.0,
    };
}

impl Criteria {
    /// Their names.
    pub const NAMES: [&'static str; 10] = [
        "fall",
        "fall_of_curve",
        "blur_of_carriage",
        "blur_of_motor",
        "noise_like",
        "left_at_most",
        "floors_at_most",
        "hidden",
        "far_guides",
        "least_periods",
    ];

    /// One of them, by its name.
    pub fn by_name(&mut self, name: &str) -> Option<&mut f64> {
        Some(match name {
            "fall" => &mut self.fall,
            "fall_of_curve" => &mut self.fall_of_curve,
            "blur_of_carriage" => &mut self.blur_of_carriage,
            "blur_of_motor" => &mut self.blur_of_motor,
            "noise_like" => &mut self.noise_like,
            "left_at_most" => &mut self.left_at_most,
            "floors_at_most" => &mut self.floors_at_most,
            "hidden" => &mut self.hidden,
            "far_guides" => &mut self.far_guides,
            "least_periods" => &mut self.least_periods,
            _ => return None,
        })
    }

    /// Mean square of a force on the carriage that is seen, in squares of the noise floor.
    pub fn seen_on_carriage(&self) -> f64 {
        (self.fall.exp() - 1.0) * self.blur_of_carriage
    }
}

impl Default for Criteria {
    fn default() -> Criteria {
        Criteria::USUAL
    }
}
