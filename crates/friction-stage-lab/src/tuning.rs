//! Gains for a stage and an application: as good as the margins allow, over the tolerances of the
//! guides.
//!
//! In come a model and an application, out come gains, what they reach on variants that the search
//! did not see, and the same of the rule of thumb for a bandwidth. Every loop that is considered
//! keeps its modulus margin on all drawn guides, at all amplitudes, and on the plain mass. Of these
//! the one counts that is best in simulated moves, forth and back (Garpinger, Hägglund, Åström, J.
//! Process Control 24, 2014, tune alike: performance under a bound of the largest sensitivity).

use rayon::prelude::*;
use serde::Serialize;

use friction_stage_core::ClosedLoop;
use friction_stage_core::control::{
    Controller, ControllerError, ControllerSettings, Gains, Point, Trajectory, TrajectoryError,
};
use friction_stage_core::model::{Guide, GuideSource, ModelError, StageModel};
use friction_stage_core::plant::{EffectDescriptor, Rates, RatesError, Stage};

use super::application::Application;
use super::balance::rest_to_balance;
use super::loop_analysis::{LoopResponse, Margins, SampledStage, StageMotion, loop_frequencies};
use super::variant::{VariantError, VariantExperiment, VariantResult};

/// Least modulus margin: |S| of at most 2, 6 dB (Åström, Murray, Feedback Systems, 2nd ed. 2021,
/// section 10.3: 1.2 to 2 are common).
const LEAST_MODULUS: f64 = 0.5;
/// Amplitudes at which margins are kept, in break-away distances of the guides.
const AMPLITUDES: [f64; 5] = [0.01, 0.1, 1.0, 10.0, 100.0];
/// Guides drawn to keep margins on, variants to improve on, and variants that decide whether what
/// was found is better at all. Assumed.
const DRAWN: u64 = 8;
const TRAINED: u64 = 16;
const CHECKED: u64 = 100;
/// First numbers of these variants: far from each other.
const CHECK_FROM: u64 = 1_000_000;
const UNSEEN_FROM: u64 = 2_000_000;
/// Factors of the bandwidth that the search looks at first, and by how much it then changes single
/// gains.
const BANDWIDTHS: [f64; 12] = [0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0, 1.25, 1.6, 2.0, 2.5, 3.2];
const FACTORS: [f64; 4] = [1.6, 1.25, 1.1, 1.04];
/// Highest cutoff of the lowpass, as a part of the sampling rate. Assumed: beyond it there is
/// little of a lowpass left against the noise of the encoder.
const HIGHEST_LOWPASS: f64 = 0.25;
/// Rounds at each of them. Assumed.
const ROUNDS: usize = 3;
/// Name under which variants of a model are drawn.
const NAME: &str = "tune";

/// What is to be made small.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Objective {
    /// Largest error of the moves.
    Peak,
    /// Time to settle.
    Settling,
    /// The larger of the two, each over what the application requires.
    #[default]
    Both,
}

/// What is to be tuned, and for what.
#[derive(Clone, Debug)]
pub struct TuningPlan {
    /// The stage on its nominal guides.
    pub model: StageModel,
    /// Motion, requirement, tolerances, and the bandwidth to begin with.
    pub application: Application,
    /// What is made small.
    pub objective: Objective,
    /// Variants that the search does not see.
    pub unseen: u64,
    /// Seed of draws and noise.
    pub seed: u64,
}

/// Why there are no gains.
#[derive(Debug, thiserror::Error)]
pub enum TuningError {
    /// A model that cannot be.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A variant that cannot be simulated.
    #[error(transparent)]
    Variant(#[from] VariantError),
    /// A controller that cannot be.
    #[error(transparent)]
    Controller(#[from] ControllerError),
    /// Rates that do not fit each other.
    #[error(transparent)]
    Rates(#[from] RatesError),
    /// A motion that cannot be.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    /// No bandwidth that keeps the modulus margin.
    #[error(
        "no loop at {rate} Hz keeps a modulus margin of 6 dB on this stage, from {least:.1} to \
         {most:.1} Hz of bandwidth: the largest |S| is {peak:.1} dB at the best of them; sample \
         faster, or make the motor less late"
    )]
    NoMargins {
        /// Sampling rate, Hz.
        rate: f64,
        /// Lowest bandwidth that was tried, Hz.
        least: f64,
        /// Highest bandwidth that was tried, Hz.
        most: f64,
        /// Largest |S| of the best of them, dB.
        peak: f64,
    },
    /// A rate that is too low for the lowpass of a bandwidth.
    #[error(
        "a rate of {rate} Hz is too low for a bandwidth of {bandwidth} Hz, whose lowpass at \
         {lowpass} Hz must stay below half the rate: at least {needed} Hz, or at most \
         {possible:.1} Hz of bandwidth"
    )]
    Rate {
        /// Sampling rate, Hz.
        rate: f64,
        /// Bandwidth of the application, Hz.
        bandwidth: f64,
        /// Cutoff of the lowpass for it, Hz.
        lowpass: f64,
        /// Lowest rate for this bandwidth, Hz.
        needed: f64,
        /// Highest bandwidth for this rate, Hz.
        possible: f64,
    },
    /// Gains to compare whose closed loop is unstable.
    #[error(
        "the gains of {name} are beyond the limit of stability{}: lower them, or begin with those \
         that are proposed without them",
        margins.crossover.map_or_else(String::new, |at| format!(", with a crossover of {at:.0} Hz"))
    )]
    Unstable {
        /// Name of the gains.
        name: String,
        /// Their worst margins.
        margins: Margins,
    },
    /// A move that needs more force than the motor has.
    #[error(
        "the application's move of {distance} m needs {needed:.0} N for the {mass} kg of the \
         model, whose motor has {limit} N"
    )]
    Motor {
        /// Way of the move, m.
        distance: f64,
        /// Peak force to accelerate the mass, N.
        needed: f64,
        /// Moving mass of the model, kg.
        mass: f64,
        /// Largest force of the motor, N.
        limit: f64,
    },
    /// Too few variants to compare on: how many.
    #[error("{0} variants are too few to compare on: at least 1")]
    TooFewVariants(u64),
}

/// Margins of a loop at one amplitude of the nominal stage.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AmplitudeMargins {
    /// m; `None`: the plain mass.
    pub amplitude: Option<f64>,
    /// Margins of the loop.
    pub margins: Margins,
}

/// What a controller reaches on variants. SI units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OnVariants {
    /// Variants that were computed.
    pub variants: u64,
    /// Median and 95 % quantile of the largest error, m.
    pub peak_error: [f64; 2],
    /// Of the settling time, s; infinite (`null` in JSON) for what does not settle while watched.
    pub settling_time: [f64; 2],
    /// Share that meets the requirement.
    pub met: f64,
    /// Share that is not worse than the rule of thumb, and the median over the variants of this
    /// one's objective over that of the rule.
    pub not_worse: f64,
    /// Objective over that of the rule of thumb, median.
    pub ratio: f64,
    /// Variants whose motor came to its limit.
    pub saturated: u64,
}

/// A controller with what it reaches.
#[derive(Clone, Debug, PartialEq)]
pub struct Tuned {
    /// Name for people.
    pub name: String,
    /// Rate, gains, feedforward and limits.
    pub settings: ControllerSettings,
    /// Worst over guides within their tolerances and amplitudes: the least of each.
    pub worst: Margins,
    /// The same of PID alone, for controllers without a lowpass.
    pub without_lowpass: Margins,
    /// Of the nominal stage.
    pub nominal: Vec<AmplitudeMargins>,
    /// On variants that the search did not see.
    pub on_variants: OnVariants,
}

/// Tunings to compare: the rule of thumb, what was found, and what was given to compare.
#[derive(Clone, Debug, PartialEq)]
pub struct Tuning {
    /// What was made small.
    pub objective: Objective,
    /// Moving mass, kg.
    pub mass: f64,
    /// The rule of thumb, what was found, then what was given.
    pub tunings: Vec<Tuned>,
    /// Whether the search found better gains than the rule of thumb.
    pub improved: bool,
    /// Whether the rule of thumb keeps the modulus margin.
    pub rule_keeps_margins: bool,
}

impl Tuning {
    /// The gains to take: the second.
    pub fn found(&self) -> &Tuned {
        &self.tunings[1]
    }
}

/// Distance at which the first guide of a model breaks away, m: Fs / sigma0.
pub fn break_away(guides: &[Guide]) -> f64 {
    guides.iter().map(|guide| guide.static_force / guide.stiffness).fold(f64::INFINITY, f64::min)
}

/// Search state: what all candidates share.
struct Search<'a> {
    plan: &'a TuningPlan,
    application: Application,
    rates: Rates,
    nominal: Vec<Guide>,
    stages: Vec<SampledStage>,
    base: ControllerSettings,
}

impl TuningPlan {
    /// Searches; `tick` is called with the part that is done, 0 to 1. `compared` are gains of one's
    /// own with their name.
    pub fn run(
        &self,
        compared: Option<(String, ControllerSettings)>,
        tick: &(dyn Fn(f64) + Sync),
    ) -> Result<Tuning, TuningError> {
        if self.unseen == 0 {
            return Err(TuningError::TooFewVariants(self.unseen));
        }
        let search = Search::new(self)?;
        tick(0.05);
        let rule = search.base.clone();
        let rule_margins = search.worst(&rule);
        let rule_keeps_margins = keeps(&rule_margins);
        let (best, peak) = search.coarse(tick)?;
        let Some(best) = best else {
            let bandwidth = self.application.controller.bandwidth;
            return Err(TuningError::NoMargins {
                rate: rule.rate,
                least: BANDWIDTHS[0] * bandwidth,
                most: BANDWIDTHS[BANDWIDTHS.len() - 1] * bandwidth,
                peak,
            });
        };
        let found = search.fine(best, tick)?;
        // What was improved on a few variants must hold on others, or the rule of thumb is kept.
        let mut improved = !rule_keeps_margins;
        let chosen = if found == rule {
            rule.clone()
        } else if rule_keeps_margins {
            let of = |settings: &ControllerSettings| {
                search.cost(settings, CHECK_FROM..CHECK_FROM + CHECKED)
            };
            improved = of(&found)? < of(&rule)?;
            if improved { found } else { rule.clone() }
        } else {
            found
        };
        tick(0.7);
        let of_rule = search.results(&rule, UNSEEN_FROM..UNSEEN_FROM + self.unseen)?;
        let mut tunings = Vec::new();
        let named = [("rule of thumb".to_owned(), rule), ("tuned".to_owned(), chosen)];
        for (index, (name, settings)) in named.into_iter().chain(compared).enumerate() {
            let worst = search.worst(&settings);
            if !worst.stable && index > 1 {
                return Err(TuningError::Unstable { name, margins: worst });
            }
            let results = match index {
                0 => of_rule.clone(),
                _ => search.results(&settings, UNSEEN_FROM..UNSEEN_FROM + self.unseen)?,
            };
            tunings.push(Tuned {
                name,
                worst,
                without_lowpass: search
                    .worst_of(&|stage| LoopResponse::without_lowpass(stage, &settings).margins()),
                nominal: search.nominal_margins(&settings)?,
                on_variants: search.on_variants(&results, &of_rule),
                settings,
            });
            tick(0.8 + 0.1 * index as f64);
        }
        Ok(Tuning {
            objective: self.objective,
            mass: search.base.mass_feedforward,
            tunings,
            improved,
            rule_keeps_margins,
        })
    }
}

fn keeps(margins: &Margins) -> bool {
    margins.stable && margins.modulus_margin >= LEAST_MODULUS
}

impl Search<'_> {
    fn new(plan: &TuningPlan) -> Result<Search<'_>, TuningError> {
        plan.model.check()?;
        let Application { controller, motion, .. } = &plan.application;
        let (rate, bandwidth) = (controller.rate, controller.bandwidth);
        let mut mass = plan.model.moving_mass();
        for effect in &plan.model.effects {
            let (descriptor, values) = EffectDescriptor::read(effect)?;
            mass += descriptor.constant_mass(&values);
        }
        let base = ControllerSettings {
            gains: Gains::from_bandwidth(bandwidth, mass),
            viscous_feedforward: controller.viscous_feedforward,
            ..ControllerSettings::paper(mass, rate, plan.model.motor.force_limit)
        };
        let lowpass = base.gains.lowpass_frequency;
        if lowpass >= 0.5 * rate {
            let ratio = lowpass / bandwidth;
            return Err(TuningError::Rate {
                rate,
                bandwidth,
                lowpass,
                needed: (2.0 * lowpass).ceil(),
                possible: 0.5 * rate / ratio,
            });
        }
        base.check()?;
        // Peak of the minimum-jerk acceleration: 10 / sqrt 3 d / T^2.
        let needed = 10.0 / 3f64.sqrt() * mass * motion.distance / motion.duration.powi(2);
        let limit = plan.model.motor.force_limit;
        if needed > limit {
            return Err(TuningError::Motor { distance: motion.distance, needed, mass, limit });
        }
        let nominal = plan.model.resolved_guides()?;
        let mut application = Application { guides: nominal.len(), ..plan.application.clone() };
        // One move alone can live from how the bristles were left before it.
        application.motion.and_return = true;
        let rates = Rates::of_control(rate)?;
        let experiment =
            VariantExperiment::of_model(&application, plan.model.clone(), base.clone(), rates)?;
        let frequencies = loop_frequencies(rate);
        let mut models = vec![plan.model.clone()];
        for variant in 0..DRAWN {
            let (guides, _) = experiment.draw(NAME, &nominal, plan.seed, variant);
            let guides = guides.into_iter().map(GuideSource::Inline).collect();
            models.push(StageModel { guides, ..plan.model.clone() });
        }
        let distance = break_away(&nominal);
        let mut wanted = vec![(plan.model.clone(), StageMotion::PlainMass)];
        wanted.extend(models.into_iter().flat_map(|model| {
            AMPLITUDES.map(|share| (model.clone(), StageMotion::Amplitude(share * distance)))
        }));
        let stages = wanted
            .par_iter()
            .map(|(model, motion)| SampledStage::new(model, rate, 0.0, *motion, &frequencies))
            .collect::<Result<Vec<_>, ModelError>>()?;
        Ok(Search { plan, application, rates, nominal, stages, base })
    }

    /// Whether a controller may be considered at all. The lowpass of the rule of thumb may be
    /// higher.
    fn possible(&self, settings: &ControllerSettings) -> bool {
        let highest = (HIGHEST_LOWPASS * settings.rate).max(self.base.gains.lowpass_frequency);
        settings.check().is_ok() && settings.gains.lowpass_frequency <= highest
    }

    /// The least margins over all stages.
    fn worst(&self, settings: &ControllerSettings) -> Margins {
        self.worst_of(&|stage| LoopResponse::new(stage, settings).margins())
    }

    fn worst_of(&self, margins: &(dyn Fn(&SampledStage) -> Margins + Sync)) -> Margins {
        let all: Vec<Margins> = self.stages.par_iter().map(margins).collect();
        let least = |a: Option<f64>, b: Option<f64>| match (a, b) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (one, other) => one.or(other),
        };
        let most = |a: Option<f64>, b: Option<f64>| match (a, b) {
            (Some(a), Some(b)) => Some(a.max(b)),
            (one, other) => one.or(other),
        };
        all.iter().skip(1).fold(all[0], |worst, one| {
            let nearer = one.modulus_margin < worst.modulus_margin;
            Margins {
                stable: worst.stable && one.stable,
                crossover: least(worst.crossover, one.crossover),
                gain_margin: least(worst.gain_margin, one.gain_margin),
                least_gain: most(worst.least_gain, one.least_gain),
                phase_margin: least(worst.phase_margin, one.phase_margin),
                modulus_margin: worst.modulus_margin.min(one.modulus_margin),
                modulus_frequency: if nearer {
                    one.modulus_frequency
                } else {
                    worst.modulus_frequency
                },
            }
        })
    }

    fn nominal_margins(
        &self,
        settings: &ControllerSettings,
    ) -> Result<Vec<AmplitudeMargins>, ModelError> {
        // The plain mass, then the nominal stage at all amplitudes: see `new`.
        let of_nominal = self.stages.iter().take(1 + AMPLITUDES.len());
        Ok(of_nominal
            .map(|stage| AmplitudeMargins {
                amplitude: match stage.motion {
                    StageMotion::PlainMass => None,
                    StageMotion::Amplitude(amplitude) => Some(amplitude),
                },
                margins: LoopResponse::new(stage, settings).margins(),
            })
            .collect())
    }

    fn results(
        &self,
        settings: &ControllerSettings,
        variants: std::ops::Range<u64>,
    ) -> Result<Vec<VariantResult>, TuningError> {
        let experiment = VariantExperiment::of_model(
            &self.application,
            self.plan.model.clone(),
            settings.clone(),
            self.rates,
        )?;
        variants
            .into_par_iter()
            .map(|variant| Ok(experiment.run_on(NAME, &self.nominal, self.plan.seed, variant)?))
            .collect()
    }

    /// What counts of one variant; what never settles counts as twice the time that is watched.
    fn objective(&self, result: &VariantResult) -> f64 {
        let requirement = &self.application.requirement;
        let peak = result.peak_error / requirement.peak_error;
        let never = 2.0 * self.application.motion.settle;
        // A sample is the finest that a settling time knows; below it there is nothing to gain.
        let least = self.rates.control().recip();
        let settled = result.settling_time.unwrap_or(never).max(least) / requirement.settling_time;
        match self.plan.objective {
            Objective::Peak => peak,
            Objective::Settling => settled,
            Objective::Both => peak.max(settled),
        }
    }

    /// Mean objective over variants.
    fn cost(
        &self,
        settings: &ControllerSettings,
        variants: std::ops::Range<u64>,
    ) -> Result<f64, TuningError> {
        let results = self.results(settings, variants)?;
        let sum: f64 = results.iter().map(|result| self.objective(result)).sum();
        Ok(sum / results.len() as f64)
    }

    /// The best bandwidth that keeps the margins with its cost; without one `None` and the least
    /// peak of |S|, dB.
    fn coarse(
        &self,
        tick: &(dyn Fn(f64) + Sync),
    ) -> Result<(Option<(f64, ControllerSettings)>, f64), TuningError> {
        let mut best: Option<(f64, ControllerSettings)> = None;
        let mut least = f64::INFINITY;
        for (index, factor) in BANDWIDTHS.into_iter().enumerate() {
            let settings = self.base.slowed(factor);
            tick(0.05 + 0.2 * index as f64 / BANDWIDTHS.len() as f64);
            if !self.possible(&settings) {
                continue;
            }
            let margins = self.worst(&settings);
            if margins.stable {
                least = least.min(margins.peak_sensitivity_db());
            }
            if keeps(&margins) {
                let cost = self.cost(&settings, 0..TRAINED)?;
                if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                    best = Some((cost, settings));
                }
            }
        }
        Ok((best, least))
    }

    /// Direct search from there (Hooke, Jeeves, J. ACM 8, 1961, without their pattern moves): each
    /// gain by a factor up or down, and a smaller factor where none helps.
    fn fine(
        &self,
        best: (f64, ControllerSettings),
        tick: &(dyn Fn(f64) + Sync),
    ) -> Result<ControllerSettings, TuningError> {
        let (mut cost, mut settings) = best;
        for (index, factor) in FACTORS.into_iter().enumerate() {
            for round in 0..ROUNDS {
                let part = (index * ROUNDS + round) as f64 / (FACTORS.len() * ROUNDS) as f64;
                tick(0.25 + 0.45 * part);
                let mut helped = false;
                for direction in 0..DIRECTIONS {
                    for by in [factor, factor.recip()] {
                        let changed = changed(&settings, direction, by);
                        if !self.possible(&changed) || !keeps(&self.worst(&changed)) {
                            continue;
                        }
                        let found = self.cost(&changed, 0..TRAINED)?;
                        if found < cost {
                            (cost, settings, helped) = (found, changed, true);
                            break;
                        }
                    }
                }
                if !helped {
                    break;
                }
            }
        }
        Ok(settings)
    }

    fn on_variants(&self, results: &[VariantResult], rule: &[VariantResult]) -> OnVariants {
        let requirement = &self.application.requirement;
        let quantiles = |of: &dyn Fn(&VariantResult) -> f64| {
            let mut values: Vec<f64> = results.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            [0.5, 0.95].map(|share| quantile(&values, share))
        };
        let settled = |result: &VariantResult| result.settling_time.unwrap_or(f64::INFINITY);
        let meets = |result: &&VariantResult| {
            result.peak_error <= requirement.peak_error
                && settled(result) <= requirement.settling_time
                && !result.saturated
        };
        let mut ratios: Vec<f64> = results
            .iter()
            .zip(rule)
            .map(|(one, rule)| self.objective(one) / self.objective(rule))
            .collect();
        ratios.sort_by(f64::total_cmp);
        let count = results.len() as f64;
        OnVariants {
            variants: results.len() as u64,
            peak_error: quantiles(&|result| result.peak_error),
            settling_time: quantiles(&settled),
            met: results.iter().filter(meets).count() as f64 / count,
            not_worse: ratios.iter().filter(|ratio| **ratio <= 1.0).count() as f64 / count,
            ratio: quantile(&ratios, 0.5),
            saturated: results.iter().filter(|result| result.saturated).count() as u64,
        }
    }
}

fn quantile(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

/// Ways to change a controller: each gain, the lowpass, and the bandwidth.
const DIRECTIONS: usize = 5;

fn changed(settings: &ControllerSettings, direction: usize, factor: f64) -> ControllerSettings {
    let mut changed = settings.clone();
    let gains = &mut changed.gains;
    match direction {
        0 => return settings.slowed(factor),
        1 => gains.p *= factor,
        2 => gains.i *= factor,
        3 => gains.d *= factor,
        _ => gains.lowpass_frequency *= factor,
    }
    changed
}

/// Position over the size of a step of the reference, on the emulator without noise: time, s, from
/// the step on. Before it the stage comes into balance, so that nothing but the step moves it.
pub fn step_response(
    model: &StageModel,
    settings: &ControllerSettings,
    size: f64,
    duration: f64,
) -> Result<Vec<(f64, f64)>, TuningError> {
    let rates = Rates::of_control(settings.rate)?;
    let stage = Stage::new(&model.clone().without_noise(), rates, 1)?;
    let controller = Controller::new(ControllerSettings {
        // A step has no acceleration that could be fed forward.
        mass_feedforward: 0.0,
        viscous_feedforward: 0.0,
        ..settings.clone()
    })?;
    let period = (1e9 / settings.rate).round() as i64;
    let point = |time, position| Point { time, position, ..Point::default() };
    let end = (duration * 1e9) as i64;
    let rests = (rest_to_balance(model, &settings.gains)? * settings.rate).ceil() as i64;
    let step = (rests + 1) * period;
    let points = vec![point(step, 0.0), point(step + 1, size), point(step + end + 1, size)];
    let mut run = ClosedLoop::new(stage, controller, Trajectory::new(0, points)?);
    for _ in 0..rests {
        run.cycle()?;
    }
    let mut response = Vec::new();
    for _ in 0..(duration * settings.rate) as usize {
        let sample = run.cycle()?.sample;
        response.push(((sample.time - step) as f64 * 1e-9, sample.position / size));
    }
    Ok(response)
}

/// Position error along a motion, (ns, m), with the sensor noise of a seed.
pub fn errors_along(
    model: &StageModel,
    settings: &ControllerSettings,
    points: Vec<Point>,
    seed: u64,
) -> Result<Vec<(i64, f64)>, TuningError> {
    let rates = Rates::of_control(settings.rate)?;
    let stage = Stage::new(model, rates, seed)?;
    let end = points.last().map_or(0, |point| point.time);
    let controller = Controller::new(settings.clone())?;
    let mut run = ClosedLoop::new(stage, controller, Trajectory::new(0, points)?);
    let mut errors: Vec<(i64, f64)> = Vec::new();
    while errors.last().is_none_or(|(time, _)| *time < end) {
        let cycle = run.cycle()?;
        errors.push((cycle.sample.time, cycle.terms.error));
    }
    Ok(errors)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(model: StageModel, application: Application) -> TuningPlan {
        TuningPlan { model, application, objective: Objective::Both, unseen: 40, seed: 5 }
    }

    #[test]
    fn tuned_gains_keep_the_margins_and_beat_the_rule_of_thumb_on_unseen_variants() {
        let plan = plan(StageModel::on_guides("guide_2"), Application::fine_step());
        let found = plan.run(None, &|_| ()).unwrap();
        let tuned = found.found();
        assert!(found.improved && keeps(&tuned.worst), "{tuned:?}");
        assert!(tuned.on_variants.ratio < 0.9, "{:?}", tuned.on_variants);
        assert!(tuned.on_variants.not_worse > 0.9, "{:?}", tuned.on_variants);
        assert_eq!(found.tunings[0].on_variants.ratio, 1.0);
        assert_eq!(tuned.nominal[0].amplitude, None);
    }

    #[test]
    fn a_motor_that_is_late_costs_bandwidth_and_not_the_margin() {
        let mut model = StageModel::on_guides("guide_2");
        let lag = [("time_constant", 1e-3), ("delay", 2e-3)];
        model.effects =
            vec![friction_stage_core::model::EffectParameters::new("actuator_lag", lag)];
        let found = plan(model, Application::fine_step()).run(None, &|_| ()).unwrap();
        assert!(!found.rule_keeps_margins, "{:?}", found.tunings[0].worst);
        assert!(keeps(&found.found().worst), "{:?}", found.found().worst);
    }

    #[test]
    fn bad_plans_are_refused_with_what_would_do() {
        let mut slow = Application::fine_step();
        slow.controller.rate = 500.0;
        let reported =
            plan(StageModel::default(), slow).run(None, &|_| ()).unwrap_err().to_string();
        assert!(
            reported.contains("500 Hz is too low") && reported.contains("720 Hz"),
            "{reported}"
        );
        let mut far = Application::fine_step();
        far.motion.distance = 1.0;
        let reported = plan(StageModel::default(), far).run(None, &|_| ()).unwrap_err().to_string();
        assert!(reported.contains("motor has 2000 N"), "{reported}");
        let plan = plan(StageModel::default(), Application::fine_step());
        let wild = ControllerSettings::paper(40.0, 4000.0, 2000.0).slowed(10.0 / 6.0 * 1.5);
        let mut wild = wild;
        wild.gains.p *= 100.0;
        let reported = plan.run(Some(("mine".to_owned(), wild)), &|_| ()).unwrap_err().to_string();
        assert!(reported.contains("mine") && reported.contains("stability"), "{reported}");
    }

    #[test]
    fn a_step_arrives() {
        let model = StageModel::on_guides("guide_1");
        let settings = ControllerSettings::of_model(&model, 60.0, 4000.0);
        let response = step_response(&model, &settings, 1e-6, 0.2).unwrap();
        assert_eq!(response[0].1, 0.0);
        let peak = response.iter().map(|(_, x)| *x).fold(0.0, f64::max);
        // The springs of the guides hold a part of it until the integral has made up for them.
        assert!((0.9..1.5).contains(&peak), "{peak}");
        assert!((response.last().unwrap().1 - 1.0).abs() < 0.02, "{:?}", response.last());
    }

    /// What cogging does to a stage that is switched on is no answer to the step.
    #[test]
    fn a_step_starts_from_balance() {
        let mut model = StageModel::on_guides("guide_2");
        let cogging = [("amplitude", 6.0), ("period", 0.024), ("phase", 1.0)];
        model.effects = vec![friction_stage_core::model::EffectParameters::new("cogging", cogging)];
        let settings = ControllerSettings::of_model(&model, 60.0, 4000.0);
        let response = step_response(&model, &settings, 1e-6, 0.2).unwrap();
        let first = response.iter().take_while(|(time, _)| *time <= 0.0);
        assert!(first.clone().count() >= 1 && first.clone().all(|(_, x)| x.abs() < 0.01));
        let lowest = response.iter().map(|(_, x)| *x).fold(0.0, f64::min);
        assert!(lowest > -0.02, "{lowest}");
    }
}
