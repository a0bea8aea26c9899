//! What a stage is to do, and what it may cost: the question to which `select` gives the answer.
//!
//! In comes YAML, out goes a checked description of mass, motion, controller, requirement,
//! constraints on how the guide is built, and tolerances of its parameters.

use friction_stage_core::numerics::plain;
use serde::{Deserialize, Serialize};

use super::paper::{Conditioning, MoveKind, PaperMotion};
use friction_stage_core::model::{CatalogueEntry, Guide, MAX_GUIDES, StageModel};
use friction_stage_core::yaml;

/// An application for which a guide is to be chosen. SI units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Application {
    /// Name for people.
    pub name: String,
    /// Moving mass, kg (paper, section 4: 40 kg).
    #[serde(default = "mass")]
    pub mass: f64,
    /// Number of guides, all of one type.
    #[serde(default = "guides")]
    pub guides: usize,
    /// Move that is judged, with what comes before it.
    pub motion: ApplicationMotion,
    /// PID and motor of the stage; those of [`Loop::default`] where not given.
    #[serde(default)]
    pub controller: Loop,
    /// Largest error and latest settling that are allowed.
    pub requirement: Requirement,
    /// How the guide must be built; every guide may be used where not given.
    #[serde(default)]
    pub constraints: Constraints,
    /// Spread of the guide parameters; none where not given.
    #[serde(default)]
    pub tolerances: GuideTolerances,
}

/// A rest-to-rest move, after a conditioning move in the other direction as the paper makes it
/// (section 4).
///
/// The paper does not give its profile; the minimum-jerk (quintic) one is assumed, as in the rest
/// of the laboratory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ApplicationMotion {
    /// Way of the move, m.
    pub distance: f64,
    /// Time of the move, s.
    pub duration: f64,
    /// Time after the arrival over which the error is watched, s; what has not settled then counts
    /// as never settled.
    pub settle: f64,
    /// Move back again after that, judged alike.
    #[serde(default, rename = "return")]
    pub and_return: bool,
    /// Move and rest before it; those of [`Conditioning::default`] where not given.
    #[serde(default)]
    pub conditioning: Conditioning,
}

/// The controller: the paper's PID with lowpass and ideal mass feedforward.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Loop {
    /// Bandwidth of the PID, Hz (paper, section 4: 60 Hz).
    pub bandwidth: f64,
    /// Sampling rate, Hz.
    pub rate: f64,
    /// Viscous friction feedforward, N s/m; the paper's simulations have none.
    pub viscous_feedforward: f64,
    /// Largest force of the motor, N.
    pub force_limit: f64,
}

/// What the application needs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Requirement {
    /// Largest |position error| during and after the move, m.
    pub peak_error: f64,
    /// |error| within which the stage counts as settled, m.
    pub settling_band: f64,
    /// Latest time after the arrival of the reference at which it has settled, s.
    pub settling_time: f64,
}

/// How the guide must be built.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Constraints {
    /// Whether only guides with seals may be used.
    pub sealing: Sealing,
    /// Lubricants that may be used; every one if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lubricants: Option<Vec<String>>,
    /// A cage is needed (paper, section 2: without it wear and vibration grow).
    pub cage: bool,
}

/// Whether the environment asks for seals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sealing {
    /// Dirt or loss of grease: a guide without seals cannot be used.
    Required,
    /// A clean environment: seals may be there or not.
    #[default]
    NotNeeded,
}

/// Relative standard deviations of the guide parameters, of a log-normal distribution around the
/// catalogue's value as its median.
///
/// `coulomb_force` spreads the ratio Fc/Fs, so that a guide with much static friction has much
/// Coulomb friction as well; the ratio stays at most 1. Each guide of a stage is drawn on its own,
/// unless `together`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GuideTolerances {
    /// Spread of the bristle stiffness sigma0, relative.
    pub stiffness: f64,
    /// Spread of the bristle damping sigma1, relative.
    pub bristle_damping: f64,
    /// Spread of the viscous friction sigma2, relative.
    pub viscous_friction: f64,
    /// Spread of the ratio Fc/Fs, relative.
    pub coulomb_force: f64,
    /// Spread of the static friction Fs, relative.
    pub static_force: f64,
    /// Spread of the Stribeck velocity vs, relative.
    pub stribeck_velocity: f64,
    /// All guides of a stage have the same parameters, as when they come from one batch.
    pub together: bool,
}

/// An application that cannot be read or cannot be.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum ApplicationError {
    /// Text that is no application.
    #[error("{origin}: {message}")]
    Yaml {
        /// Name of the text.
        origin: String,
        /// What is wrong in it, in words.
        message: String,
    },
    /// A value out of its range.
    #[error("{origin}: {key} is {}, must {limit}", plain(*value))]
    Value {
        /// Name of the text.
        origin: String,
        /// Dotted path of the key, such as `motion.settle`.
        key: &'static str,
        /// The value as given, SI units.
        value: f64,
        /// Its range, in words after "must".
        limit: String,
    },
    /// A move that needs more force than the motor has.
    #[error(
        "{origin}: {the_move} of {distance} m in {duration} s needs {needed:.0} N to accelerate \
         {mass} kg, the motor has {limit} N (controller.force_limit): at least {slowest:.4} s \
         would do"
    )]
    Motor {
        /// Name of the text.
        origin: String,
        /// Which of the moves, in words.
        the_move: &'static str,
        /// Way of the move, m.
        distance: f64,
        /// Time of the move, s.
        duration: f64,
        /// Peak force to accelerate the mass, N.
        needed: f64,
        /// Moving mass, kg.
        mass: f64,
        /// Largest force of the motor, N.
        limit: f64,
        /// Shortest time for which that limit is enough, friction left out, s.
        slowest: f64,
    },
}

/// Peak acceleration of the minimum-jerk profile over distance / duration^2: at u = (3 - sqrt 3)/6
/// of its acceleration 60 u - 180 u^2 + 120 u^3.
pub(super) const PEAK_ACCELERATION: f64 = 5.773_502_691_896_258;
/// Largest relative standard deviation of a parameter. Assumed: beyond it one no longer speaks of a
/// tolerance.
const LARGEST_TOLERANCE: f64 = 1.0;
/// Longest simulated time of one variant, s. Assumed: guards against a slip of the unit.
const LONGEST: f64 = 600.0;

fn mass() -> f64 {
    StageModel::default().mass
}

fn guides() -> usize {
    MAX_GUIDES
}

impl Default for Loop {
    fn default() -> Self {
        Loop {
            bandwidth: 60.0,
            rate: 4000.0,
            viscous_feedforward: 0.0,
            force_limit: StageModel::default().motor.force_limit,
        }
    }
}

impl ApplicationMotion {
    /// The moves of one run, the conditioning first.
    pub(super) fn path(&self) -> PaperMotion {
        let mut path = PaperMotion::conditioned(LEAD, &self.conditioning);
        path.travel(MoveKind::Application, self.distance, self.duration, self.settle);
        if self.and_return {
            path.travel(MoveKind::Application, -self.distance, self.duration, self.settle);
        }
        path
    }
}

impl Application {
    /// Reads and checks an application; `origin` names the text in errors.
    pub fn from_yaml(text: &str, origin: &str) -> Result<Application, ApplicationError> {
        let application: Application = yaml::read(text)
            .map_err(|message| ApplicationError::Yaml { origin: origin.to_owned(), message })?;
        application.check(origin)?;
        Ok(application)
    }

    /// The fine step of the paper in a clean environment, with requirement and tolerances as in
    /// `launch_config/application_fine_step_clean.yaml`.
    pub fn fine_step() -> Application {
        Application {
            name: "fine step, clean environment".to_owned(),
            mass: mass(),
            guides: guides(),
            motion: ApplicationMotion {
                distance: 10e-6,
                duration: 3e-3,
                settle: 0.3,
                and_return: false,
                conditioning: Conditioning::default(),
            },
            controller: Loop::default(),
            requirement: Requirement { peak_error: 6e-6, settling_band: 1e-6, settling_time: 0.1 },
            constraints: Constraints::default(),
            tolerances: GuideTolerances {
                stiffness: 0.1,
                bristle_damping: 0.2,
                viscous_friction: 0.1,
                coulomb_force: 0.05,
                static_force: 0.1,
                stribeck_velocity: 0.2,
                together: false,
            },
        }
    }

    /// Refuses impossible values and a motion that the motor cannot make.
    pub fn check(&self, origin: &str) -> Result<(), ApplicationError> {
        let refuse = |key, value, limit: String| {
            Err(ApplicationError::Value { origin: origin.to_owned(), key, value, limit })
        };
        let ApplicationMotion { conditioning, .. } = &self.motion;
        let positive = [
            ("mass", self.mass),
            ("motion.distance", self.motion.distance),
            ("motion.duration", self.motion.duration),
            ("motion.settle", self.motion.settle),
            ("motion.conditioning.distance", conditioning.distance),
            ("motion.conditioning.duration", conditioning.duration),
            ("controller.bandwidth", self.controller.bandwidth),
            ("controller.rate", self.controller.rate),
            ("controller.force_limit", self.controller.force_limit),
            ("requirement.peak_error", self.requirement.peak_error),
            ("requirement.settling_band", self.requirement.settling_band),
            ("requirement.settling_time", self.requirement.settling_time),
        ];
        for (key, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return refuse(key, value, "be finite and greater than 0".to_owned());
            }
        }
        let not_negative = [
            ("motion.conditioning.rest", conditioning.rest),
            ("controller.viscous_feedforward", self.controller.viscous_feedforward),
        ];
        for (key, value) in not_negative {
            if !(value.is_finite() && value >= 0.0) {
                return refuse(key, value, "be finite and not negative".to_owned());
            }
        }
        if !(1..=MAX_GUIDES).contains(&self.guides) {
            return refuse("guides", self.guides as f64, format!("be 1 to {MAX_GUIDES}"));
        }
        for (key, value) in self.tolerances.by_name() {
            if !(0.0..=LARGEST_TOLERANCE).contains(&value) {
                return refuse(
                    key,
                    value,
                    format!("be between 0 and {LARGEST_TOLERANCE}, a relative standard deviation"),
                );
            }
        }
        if self.requirement.settling_time > self.motion.settle {
            let limit = format!(
                "not be above motion.settle, the {} s that are watched",
                self.motion.settle
            );
            return refuse("requirement.settling_time", self.requirement.settling_time, limit);
        }
        if self.simulated_time() > LONGEST {
            return refuse(
                "motion",
                self.simulated_time(),
                format!("take at most {LONGEST} s in all"),
            );
        }
        for (the_move, distance, duration) in [
            ("the move", self.motion.distance, self.motion.duration),
            (
                "the move before it (motion.conditioning)",
                conditioning.distance,
                conditioning.duration,
            ),
        ] {
            let impulse = PEAK_ACCELERATION * self.mass * distance;
            let needed = impulse / (duration * duration);
            let limit = self.controller.force_limit;
            if needed > limit {
                return Err(ApplicationError::Motor {
                    origin: origin.to_owned(),
                    the_move,
                    distance,
                    duration,
                    needed,
                    mass: self.mass,
                    limit,
                    slowest: (impulse / limit).sqrt(),
                });
            }
        }
        Ok(())
    }

    /// Simulated time of one variant, s.
    pub fn simulated_time(&self) -> f64 {
        let ApplicationMotion { duration, settle, conditioning, .. } = &self.motion;
        let moves = if self.motion.and_return { 2.0 } else { 1.0 };
        LEAD + conditioning.duration + conditioning.rest + moves * (duration + settle)
    }

    /// The application's stage on the given guides.
    pub fn stage(&self, guides: Vec<Guide>) -> StageModel {
        let mut model = StageModel {
            name: self.name.clone(),
            mass: self.mass,
            guides: guides
                .into_iter()
                .map(friction_stage_core::model::GuideSource::Inline)
                .collect(),
            ..StageModel::default()
        };
        model.motor.force_limit = self.controller.force_limit;
        model
    }

    /// Why a guide cannot be used, however it performs; `None` if it can.
    pub fn obstacle(&self, entry: &CatalogueEntry) -> Option<String> {
        let Constraints { sealing, lubricants, cage } = &self.constraints;
        if *sealing == Sealing::Required && !entry.seals {
            return Some("has no seals, and the application needs sealing".to_owned());
        }
        if let Some(allowed) = lubricants
            && !allowed.contains(&entry.lubricant)
        {
            return Some(format!(
                "is lubricated with `{}`, and the application allows {}",
                entry.lubricant,
                allowed.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")
            ));
        }
        (*cage && !entry.cage).then(|| "has no cage, and the application needs one".to_owned())
    }
}

/// Time at rest before the conditioning move, s: the controller starts on it.
pub(super) const LEAD: f64 = 0.005;

impl GuideTolerances {
    fn by_name(&self) -> [(&'static str, f64); 6] {
        [
            ("tolerances.stiffness", self.stiffness),
            ("tolerances.bristle_damping", self.bristle_damping),
            ("tolerances.viscous_friction", self.viscous_friction),
            ("tolerances.coulomb_force", self.coulomb_force),
            ("tolerances.static_force", self.static_force),
            ("tolerances.stribeck_velocity", self.stribeck_velocity),
        ]
    }

    /// A guide of these tolerances around `nominal`; `normal` draws from the standard normal
    /// distribution, six times whatever the tolerances are, so that one of them does not shift the
    /// draws of the others.
    pub fn draw(&self, nominal: &Guide, normal: &mut impl FnMut() -> f64) -> Guide {
        let mut factor = |relative: f64| (relative * normal()).exp();
        let stiffness = nominal.stiffness * factor(self.stiffness);
        let bristle_damping = nominal.bristle_damping * factor(self.bristle_damping);
        let viscous_friction = nominal.viscous_friction * factor(self.viscous_friction);
        let static_force = nominal.static_force * factor(self.static_force);
        let ratio = nominal.coulomb_force / nominal.static_force * factor(self.coulomb_force);
        let stribeck_velocity = nominal.stribeck_velocity * factor(self.stribeck_velocity);
        Guide {
            stiffness,
            bristle_damping,
            viscous_friction,
            coulomb_force: static_force * ratio.min(1.0),
            static_force,
            stribeck_velocity,
            stribeck_exponent: nominal.stribeck_exponent,
            damping_velocity: nominal.damping_velocity,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FINE: &str = include_str!("../../../launch_config/application_fine_step_clean.yaml");

    #[test]
    fn the_example_is_the_fine_step_of_the_paper() {
        let application = Application::from_yaml(FINE, "fine.yaml").unwrap();
        assert_eq!((application.mass, application.guides), (40.0, 4));
        assert_eq!((application.motion.distance, application.motion.duration), (10e-6, 3e-3));
        assert_eq!(application.controller.bandwidth, 60.0);
        assert_eq!(application, Application::fine_step());
    }

    #[test]
    fn bad_applications_are_refused_with_key_value_and_limit() {
        let cases: &[(&str, &str, &[&str])] = &[
            ("mass: 40.0", "mass: -1.0", &["mass", "-1", "greater than 0"]),
            ("mass: 40.0", "mas: 40.0", &["did you mean `mass`"]),
            ("guides: 4", "guides: 5", &["guides", "5", "1 to 4"]),
            ("sealing: not_needed", "sealing: requird", &["requird", "did you mean `required`"]),
            ("duration: 3.0e-3", "duration: .nan", &["motion.duration", "NaN"]),
            ("stiffness: 0.1", "stiffness: 10", &["tolerances.stiffness", "10", "between 0 and 1"]),
            (
                "settle: 0.3",
                "settle: 0.01",
                &["requirement.settling_time", "motion.settle", "0.01"],
            ),
        ];
        for (good, bad, expected) in cases {
            assert!(FINE.contains(good), "{good}");
            let message = Application::from_yaml(&FINE.replace(good, bad), "fine.yaml")
                .unwrap_err()
                .to_string();
            for words in *expected {
                assert!(message.contains(words), "{bad:?} gave {message:?}, without {words:?}");
            }
        }
    }

    #[test]
    fn a_motion_beyond_the_motor_is_refused_with_the_time_that_would_do() {
        let text = FINE
            .replace("distance: 10.0e-6", "distance: 50.0e-3")
            .replace("duration: 3.0e-3", "duration: 0.05");
        let error = Application::from_yaml(&text, "fast.yaml").unwrap_err();
        let ApplicationError::Motor { needed, slowest, .. } = &error else { panic!("{error}") };
        // Peak of the minimum-jerk acceleration: 10/sqrt 3 d/T^2.
        assert!(
            (needed / (40.0 * 10.0 / 3f64.sqrt() * 0.05 / 0.0025) - 1.0).abs() < 1e-12,
            "{error}"
        );
        let slower = text.replace("duration: 0.05", &format!("duration: {}", slowest * 1.001));
        Application::from_yaml(&slower, "slower.yaml").unwrap();
    }

    #[test]
    fn drawn_guides_have_the_declared_spread_and_are_possible() {
        use rand::SeedableRng;
        use rand_distr::{Distribution, StandardNormal};
        let tolerances = GuideTolerances {
            stiffness: 0.1,
            coulomb_force: 0.3,
            static_force: 0.05,
            ..GuideTolerances::default()
        };
        let nominal = friction_stage_core::model::Catalogue::builtin().guide("guide_1").unwrap();
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let guides: Vec<Guide> =
            (0..4000).map(|_| tolerances.draw(&nominal, &mut normal)).collect();
        let spread = |value: fn(&Guide) -> f64, nominal: f64| {
            (guides.iter().map(|guide| (value(guide) / nominal).ln().powi(2)).sum::<f64>()
                / guides.len() as f64)
                .sqrt()
        };
        // Standard error of a standard deviation over 4000 draws: 1.1 %.
        assert!((spread(|guide| guide.stiffness, nominal.stiffness) / 0.1 - 1.0).abs() < 0.05);
        assert!(
            (spread(|guide| guide.static_force, nominal.static_force) / 0.05 - 1.0).abs() < 0.05
        );
        assert_eq!(spread(|guide| guide.viscous_friction, nominal.viscous_friction), 0.0);
        for guide in &guides {
            guide.check("drawn").unwrap();
        }
    }
}
