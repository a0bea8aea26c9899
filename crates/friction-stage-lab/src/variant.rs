//! One variant of a stage: guides drawn from their tolerances, one run of the application's motion,
//! what it reached.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::application::Application;
use super::paper::{Move, MoveKind};
use friction_stage_core::ClosedLoop;
use friction_stage_core::control::{
    Controller, ControllerError, ControllerSettings, Gains, Trajectory, TrajectoryError,
};
use friction_stage_core::model::{Guide, GuideSource, ModelError, StageModel};
use friction_stage_core::plant::{Rates, RatesError, Stage};

/// What one variant reached. Guide parameters are the means over the guides of its stage, SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct VariantResult {
    /// Number of the variant among those of its guide.
    pub variant: u64,
    /// Largest |position error| over the moves, m.
    pub peak_error: f64,
    /// Time from the arrival until the error stays within the band, s, the longest of the moves;
    /// `None`: not while watched.
    pub settling_time: Option<f64>,
    /// The motor reached its limit.
    pub saturated: bool,
    /// Mean parameters of its guides, SI units.
    pub guide: Guide,
}

/// A variant that cannot be simulated.
#[derive(Debug, thiserror::Error)]
pub enum VariantError {
    /// A stage that cannot be.
    #[error("{guide}, variant {variant}: {source}")]
    Model {
        /// Name of the guide.
        guide: String,
        /// Number of the variant.
        variant: u64,
        /// Why it cannot be.
        source: Box<ModelError>,
    },
    /// Rates that do not fit each other.
    #[error(transparent)]
    Rates(#[from] RatesError),
    /// A controller that cannot be.
    #[error(transparent)]
    Controller(#[from] ControllerError),
    /// A motion that cannot be.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
}

/// Everything of an application that its variants share: rates, controller, trajectory, times of
/// the moves.
#[derive(Clone, Debug)]
pub struct VariantExperiment {
    application: Application,
    /// Its guides are replaced by those of each variant.
    model: StageModel,
    rates: Rates,
    settings: ControllerSettings,
    trajectory: Trajectory,
    /// The moves that are judged.
    moves: Vec<Move>,
}

/// Seed of a variant: the first word of the ChaCha8 stream whose key is (seed, FNV-1a of the
/// guide's name, variant).
///
/// It depends on nothing else, so that neither the order of the variants nor other guides in the
/// database change a result.
pub fn variant_seed(seed: u64, guide: &str, variant: u64) -> u64 {
    // Offset and prime of FNV-1a, 64 bit (Fowler, Noll, Vo; IETF draft-eastlake-fnv).
    let name = guide.bytes().fold(0xcbf2_9ce4_8422_2325u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    });
    let mut key = [0; 32];
    for (place, word) in key.chunks_exact_mut(8).zip([seed, name, variant]) {
        place.copy_from_slice(&word.to_le_bytes());
    }
    ChaCha8Rng::from_seed(key).next_u64()
}

impl VariantExperiment {
    /// The step is that of [`Rates::DEFAULT`], or the next smaller one that divides the
    /// controller's period.
    pub fn new(application: &Application) -> Result<VariantExperiment, VariantError> {
        let control = application.controller.rate;
        let rates = Rates::new(control, control * (Rates::DEFAULT.physics() / control).ceil())?;
        let controller = &application.controller;
        let settings = ControllerSettings {
            gains: Gains::from_bandwidth(controller.bandwidth, application.mass),
            viscous_feedforward: controller.viscous_feedforward,
            ..ControllerSettings::paper(application.mass, control, controller.force_limit)
        };
        let model = application.stage(Vec::new());
        VariantExperiment::of_model(application, model, settings, rates)
    }

    /// The application's motion on a stage of `model`, whose guides are those of the variants,
    /// under a controller of one's own.
    pub fn of_model(
        application: &Application,
        model: StageModel,
        settings: ControllerSettings,
        rates: Rates,
    ) -> Result<VariantExperiment, VariantError> {
        settings.check()?;
        let path = application.motion.path();
        let moves = path
            .moves
            .iter()
            .filter(|the_move| the_move.kind == MoveKind::Application)
            .copied()
            .collect();
        let trajectory = Trajectory::new(0, path.points)?;
        Ok(VariantExperiment {
            application: application.clone(),
            model,
            rates,
            settings,
            trajectory,
            moves,
        })
    }

    /// Runs variant number `variant` of a guide with these nominal parameters.
    pub fn run(
        &self,
        name: &str,
        nominal: &Guide,
        seed: u64,
        variant: u64,
    ) -> Result<VariantResult, VariantError> {
        let nominal = vec![nominal.clone(); self.application.guides];
        self.run_on(name, &nominal, seed, variant)
    }

    /// As [`VariantExperiment::run`], of a stage whose guides have nominal parameters of their own.
    pub fn run_on(
        &self,
        name: &str,
        nominal: &[Guide],
        seed: u64,
        variant: u64,
    ) -> Result<VariantResult, VariantError> {
        let (guides, noise_seed) = self.draw(name, nominal, seed, variant);
        let guide = mean(&guides);
        let guides = guides.into_iter().map(GuideSource::Inline).collect();
        let model = StageModel { guides, ..self.model.clone() };
        let stage = Stage::new(&model, self.rates, noise_seed).map_err(|source| {
            VariantError::Model { guide: name.to_owned(), variant, source: Box::new(source) }
        })?;
        let controller = Controller::new(self.settings.clone())?;
        let mut closed_loop = ClosedLoop::new(stage, controller, self.trajectory.clone());
        let mut result = VariantResult {
            variant,
            peak_error: 0.0,
            settling_time: Some(0.0),
            saturated: false,
            guide,
        };
        let band = self.application.requirement.settling_band;
        for &Move { start, arrival, end, .. } in &self.moves {
            let mut outside = false;
            loop {
                let cycle = closed_loop.cycle()?;
                let time = cycle.sample.time;
                if time < start {
                    continue;
                }
                if time > end {
                    break;
                }
                result.saturated |= cycle.terms.saturated;
                let error = cycle.terms.error.abs();
                result.peak_error = result.peak_error.max(error);
                outside = time >= arrival && error > band;
                if outside {
                    let after = (time - arrival) as f64 * 1e-9;
                    result.settling_time = result.settling_time.map(|longest| longest.max(after));
                }
                if time == end {
                    break;
                }
            }
            if outside {
                result.settling_time = None;
            }
        }
        Ok(result)
    }
}

impl VariantExperiment {
    /// The guides of a variant and the seed of its noise.
    pub fn draw(
        &self,
        name: &str,
        nominal: &[Guide],
        seed: u64,
        variant: u64,
    ) -> (Vec<Guide>, u64) {
        let mut random = ChaCha8Rng::seed_from_u64(variant_seed(seed, name, variant));
        let noise_seed = random.next_u64();
        let tolerances = &self.application.tolerances;
        let mut drawn: Vec<f64> = Vec::new();
        let guides = nominal.iter().enumerate().map(|(index, guide)| {
            if index > 0 && tolerances.together {
                let mut same = drawn.iter().copied();
                return tolerances.draw(guide, &mut || same.next().unwrap_or(0.0));
            }
            tolerances.draw(guide, &mut || {
                let value = StandardNormal.sample(&mut random);
                drawn.push(value);
                value
            })
        });
        (guides.collect(), noise_seed)
    }
}

fn mean(guides: &[Guide]) -> Guide {
    let of = |value: fn(&Guide) -> f64| guides.iter().map(value).sum::<f64>() / guides.len() as f64;
    Guide {
        stiffness: of(|guide| guide.stiffness),
        bristle_damping: of(|guide| guide.bristle_damping),
        viscous_friction: of(|guide| guide.viscous_friction),
        coulomb_force: of(|guide| guide.coulomb_force),
        static_force: of(|guide| guide.static_force),
        stribeck_velocity: of(|guide| guide.stribeck_velocity),
        stribeck_exponent: guides[0].stribeck_exponent,
        damping_velocity: guides[0].damping_velocity,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use friction_stage_core::model::Catalogue;

    #[test]
    fn seeds_of_variants_differ_by_seed_guide_and_number() {
        let seeds = [
            variant_seed(1, "guide_1", 0),
            variant_seed(2, "guide_1", 0),
            variant_seed(1, "guide_2", 0),
            variant_seed(1, "guide_1", 1),
        ];
        for (index, seed) in seeds.iter().enumerate() {
            assert!(!seeds[..index].contains(seed), "{seeds:?}");
        }
        assert_eq!(variant_seed(1, "guide_1", 0), seeds[0]);
    }

    /// The same motion by the laboratory's own moves and its own judgement.
    #[test]
    fn a_variant_without_tolerances_is_the_move_of_the_laboratory() {
        use super::super::{SETTLING_BANDS, settling};
        let mut application = Application::fine_step();
        application.tolerances = Default::default();
        let nominal = Catalogue::builtin().guide("guide_1").unwrap();
        let experiment = VariantExperiment::new(&application).unwrap();
        let found = experiment.run("guide_1", &nominal, 7, 3).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(variant_seed(7, "guide_1", 3));
        let model = application.stage(vec![nominal; 4]);
        let stage = Stage::new(&model, Rates::DEFAULT, random.next_u64()).unwrap();
        let controller = Controller::new(ControllerSettings::paper(40.0, 4000.0, 2000.0)).unwrap();
        let mut closed_loop = ClosedLoop::new(stage, controller, experiment.trajectory.clone());
        let errors: Vec<(i64, f64)> = (0..3233)
            .map(|_| closed_loop.cycle().unwrap())
            .map(|cycle| (cycle.sample.time, cycle.terms.error))
            .collect();
        let expected = settling(&experiment.moves[0], errors.into_iter()).unwrap();
        assert_eq!(SETTLING_BANDS[1], application.requirement.settling_band);
        assert_eq!(found.peak_error, expected.peak_error);
        assert_eq!(found.settling_time, expected.settling[1]);
        assert!(
            found.settling_time.is_some_and(|time| time > 0.01) && !found.saturated,
            "{found:?}"
        );
    }

    #[test]
    fn a_band_that_is_never_reached_gives_no_settling_time() {
        let mut application = Application::fine_step();
        application.requirement.settling_band = 1e-12;
        let nominal = Catalogue::builtin().guide("guide_2").unwrap();
        let found =
            VariantExperiment::new(&application).unwrap().run("guide_2", &nominal, 1, 0).unwrap();
        assert_eq!(found.settling_time, None);
    }
}
