//! Which guide for an application: every guide of a database by what it reaches over its
//! tolerances.
//!
//! In come an application and guides, out goes a ranking with quantiles, the chance to meet the
//! requirement, and why the others lose. Variants are numbered and each depends on its number
//! alone, so that any part of them can be computed anywhere in any order. What is kept of them is a
//! fixed number of counters per guide.

use std::ops::Range;

use hdrhistogram::Histogram;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::application::Application;
use super::finding::{Drawback, SelectionFinding};
use super::rows::{Cell, Column, ColumnKind, NumberedPlan, OtherJob, RowsError, VariantRows};
use super::variant::{VariantError, VariantExperiment, VariantResult, variant_seed};
use friction_stage_core::model::{Catalogue, CatalogueEntry, Guide};
use friction_stage_core::numerics::TWO_SIDED_95;

/// A guide that stands for selection.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// Name in the database.
    pub name: String,
    /// Nominal parameters.
    pub guide: Guide,
    /// Why it cannot be used, whatever it reaches.
    pub obstacle: Option<String>,
}

/// What is to be computed, the same in every shard of it. Job `j` is variant `j / guides` of guide
/// `j % guides`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SelectionPlan {
    /// What the stage is to do.
    pub application: Application,
    /// Guides to compare, in the order in which they get jobs.
    pub candidates: Vec<Candidate>,
    /// Seed of draws and noise.
    pub seed: u64,
    /// Variants over all guides, dealt to them in turn.
    pub variants: u64,
}

/// Part `index` of `count`, counted from 1: a stretch of the jobs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shard {
    /// Which part, 1 to `count`.
    pub index: u64,
    /// Number of parts, at least 1.
    pub count: u64,
}

/// A selection that cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum SelectionError {
    /// A database without guides.
    #[error("there is no guide to choose from: the database is empty")]
    NoGuides,
    /// Constraints that exclude every guide.
    #[error("no guide can be used: {obstacles}")]
    NothingAllowed {
        /// Each guide with what excludes it, in words.
        obstacles: String,
    },
    /// Fewer variants than guides.
    #[error("{variants} variants are too few for {guides} guides: at least one for each")]
    TooFewVariants {
        /// Variants over all guides, as given.
        variants: u64,
        /// Number of guides.
        guides: usize,
    },
    /// Text that is no shard.
    #[error("`{text}` is no shard: give it as i/n with i from 1 to n, such as 2/8")]
    Shard {
        /// The text as given.
        text: String,
    },
    /// A variant that cannot be simulated.
    #[error(transparent)]
    Variant(#[from] VariantError),
}

/// Quantiles of a quantity over the variants; infinite where it lies among those that never
/// settled.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Quantiles {
    /// 5 % are below.
    pub q05: f64,
    /// Median.
    pub q50: f64,
    /// 95 % are below.
    pub q95: f64,
}

/// Counters of one guide. A fixed size whatever the number of variants.
#[derive(Clone, Debug)]
pub struct Tally {
    /// Variants that were counted.
    pub variants: u64,
    /// Variants that met peak error and settling time without reaching the motor's limit.
    pub met: u64,
    /// Variants with a larger peak error than required.
    pub peak_too_large: u64,
    /// Variants that settled later than required or not while watched.
    pub settled_too_late: u64,
    /// Variants that did not settle while watched.
    pub never_settled: u64,
    /// Variants whose motor came to its limit.
    pub saturated: u64,
    /// pm
    peak_error: Histogram<u64>,
    /// ns, of those that settled.
    settling_time: Histogram<u64>,
}

/// One row of the ranking.
#[derive(Clone, Debug, Serialize)]
pub struct Ranked {
    /// Place in the ranking, from 1 on.
    pub rank: usize,
    /// Name of the guide.
    pub guide: String,
    /// Why it cannot be used, whatever it reaches.
    pub obstacle: Option<String>,
    /// Variants that were computed.
    pub variants: u64,
    /// Share of the variants that meet the requirement, with its 95 % interval (Wilson, JASA 22,
    /// 1927).
    pub chance: f64,
    /// 95 % interval of the chance to meet the requirement.
    pub chance_ci95: [f64; 2],
    /// m
    pub peak_error: Quantiles,
    /// s; `null` in JSON where it never settles.
    pub settling_time: Quantiles,
    /// Variants that did not settle.
    pub never_settled: u64,
    /// Variants whose motor came to its limit.
    pub saturated: u64,
    /// Why it is not the one to take; empty for the chosen one.
    #[serde(skip)]
    pub drawbacks: Vec<Drawback>,
}

/// The answer.
#[derive(Clone, Debug)]
pub struct GuideSelection {
    /// Name of the application.
    pub application: String,
    /// Seed of draws and noise.
    pub seed: u64,
    /// Variants in the result, over all guides.
    pub variants: u64,
    /// The guide to take, if one meets the requirement in some variant.
    pub choice: Option<String>,
    /// The guides, the best first.
    pub ranking: Vec<Ranked>,
    /// What a user should know.
    pub findings: Vec<SelectionFinding>,
}

/// Relative resolution of the quantiles: significant decimal digits of the histograms.
const DIGITS: u8 = 3;
/// Largest value of the histograms, pm and ns: 1000 km are out of reach, 1000 s are more than is
/// simulated.
const LARGEST: u64 = 1_000_000_000_000;
/// Chance below which the choice deserves a warning. Assumed.
const SAFE: f64 = 0.95;
/// Factor from which on a difference of a parameter is reported as a reason. Assumed.
const NOTABLE: f64 = 1.05;

impl std::str::FromStr for Shard {
    type Err = SelectionError;

    fn from_str(text: &str) -> Result<Shard, SelectionError> {
        text.split_once('/')
            .and_then(|(index, count)| {
                Some(Shard { index: index.parse().ok()?, count: count.parse().ok()? })
            })
            .filter(|shard| (1..=shard.count).contains(&shard.index))
            .ok_or_else(|| SelectionError::Shard { text: text.to_owned() })
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(formatter, "{}/{}", self.index, self.count)
    }
}

impl Shard {
    /// Everything in one.
    pub const WHOLE: Shard = Shard { index: 1, count: 1 };

    /// The jobs of this shard, of `jobs` in all. Shards in order, one after the other, are all
    /// jobs.
    pub fn jobs(&self, jobs: u64) -> Range<u64> {
        let end =
            |index: u64| (u128::from(jobs) * u128::from(index) / u128::from(self.count)) as u64;
        end(self.index - 1)..end(self.index)
    }
}

impl SelectionPlan {
    /// A plan over every guide of the database; guides that the constraints exclude are computed
    /// too, to show their price.
    pub fn new(
        application: Application,
        database: &Catalogue,
        seed: u64,
        variants: u64,
    ) -> Result<SelectionPlan, SelectionError> {
        let candidate = |(name, entry): (&str, &CatalogueEntry)| Candidate {
            name: name.to_owned(),
            guide: entry.guide(),
            obstacle: application.obstacle(entry),
        };
        let candidates: Vec<Candidate> = database.entries().map(candidate).collect();
        if candidates.is_empty() {
            return Err(SelectionError::NoGuides);
        }
        if candidates.iter().all(|candidate| candidate.obstacle.is_some()) {
            let reported = candidates.iter().filter_map(|candidate| {
                candidate.obstacle.as_ref().map(|obstacle| format!("{} {obstacle}", candidate.name))
            });
            return Err(SelectionError::NothingAllowed {
                obstacles: reported.collect::<Vec<_>>().join("; "),
            });
        }
        if variants < candidates.len() as u64 {
            return Err(SelectionError::TooFewVariants { variants, guides: candidates.len() });
        }
        Ok(SelectionPlan { application, candidates, seed, variants })
    }

    /// Index of the candidate and number of the variant of job `job`.
    pub fn job(&self, job: u64) -> (usize, u64) {
        let guides = self.candidates.len() as u64;
        ((job % guides) as usize, job / guides)
    }

    /// Computes jobs on all processors; results in the order of the jobs, whatever order they ended
    /// in.
    pub fn run(
        &self,
        experiment: &VariantExperiment,
        jobs: Range<u64>,
    ) -> Result<Vec<VariantResult>, SelectionError> {
        let one = |job: u64| {
            let (index, variant) = self.job(job);
            let candidate = &self.candidates[index];
            experiment
                .run(&candidate.name, &candidate.guide, self.seed, variant)
                .map_err(SelectionError::from)
        };
        jobs.into_par_iter().map(one).collect()
    }

    /// Ranks what was tallied, one tally per candidate.
    ///
    /// Guides that can be used come first; then by the chance to meet the requirement, then by the
    /// larger of peak error and settling time over what is required, each at its 95 % quantile.
    pub fn rank(&self, tallies: &[Tally]) -> GuideSelection {
        let requirement = &self.application.requirement;
        let worst = |tally: &Tally| {
            let peak = tally.peak_error().q95 / requirement.peak_error;
            peak.max(tally.settling_time().q95 / requirement.settling_time)
        };
        let mut order: Vec<(&Candidate, &Tally)> = self.candidates.iter().zip(tallies).collect();
        order.sort_by(|(a, x), (b, y)| {
            a.obstacle
                .is_some()
                .cmp(&b.obstacle.is_some())
                .then(y.chance().total_cmp(&x.chance()))
                .then_with(|| worst(x).total_cmp(&worst(y)))
                .then(x.peak_error().q50.total_cmp(&y.peak_error().q50))
                .then(a.name.cmp(&b.name))
        });
        let (best, best_tally) = order[0];
        let choice = (best.obstacle.is_none() && best_tally.met > 0).then(|| best.name.clone());
        let mut findings = Vec::new();
        if choice.is_some() && best_tally.chance() < SAFE {
            findings.push(SelectionFinding::UnsafeChoice {
                guide: best.name.clone(),
                chance: best_tally.chance(),
            });
        }
        findings.extend(order[1..].iter().filter_map(|(candidate, tally)| {
            low_friction_trap(candidate, tally, best, best_tally)
        }));
        let ranking = order
            .iter()
            .enumerate()
            .map(|(index, (candidate, tally))| Ranked {
                rank: index + 1,
                guide: candidate.name.clone(),
                obstacle: candidate.obstacle.clone(),
                variants: tally.variants,
                chance: tally.chance(),
                chance_ci95: tally.chance_ci95(),
                peak_error: tally.peak_error(),
                settling_time: tally.settling_time(),
                never_settled: tally.never_settled,
                saturated: tally.saturated,
                drawbacks: if index == 0 && choice.is_some() {
                    Vec::new()
                } else {
                    self.drawbacks(candidate, tally, (index > 0).then_some((best, best_tally)))
                },
            })
            .collect();
        GuideSelection {
            application: self.application.name.clone(),
            seed: self.seed,
            variants: tallies.iter().map(|tally| tally.variants).sum(),
            choice,
            ranking,
            findings,
        }
    }

    fn drawbacks(
        &self,
        candidate: &Candidate,
        tally: &Tally,
        best: Option<(&Candidate, &Tally)>,
    ) -> Vec<Drawback> {
        let requirement = &self.application.requirement;
        let mut drawbacks: Vec<Drawback> =
            candidate.obstacle.clone().map(Drawback::Excluded).into_iter().collect();
        let share = |count: u64| count as f64 / tally.variants.max(1) as f64;
        let medians = |of: &Tally| (of.peak_error().q50, of.settling_time().q50);
        let (peak, settled) = medians(tally);
        if tally.peak_too_large > 0 {
            drawbacks.push(Drawback::PeakError {
                share: share(tally.peak_too_large),
                median: peak,
                allowed: requirement.peak_error,
            });
        }
        if tally.settled_too_late > 0 {
            drawbacks.push(Drawback::Settling {
                share: share(tally.settled_too_late),
                band: requirement.settling_band,
                median: settled,
                allowed: requirement.settling_time,
            });
        }
        if tally.saturated > 0 {
            drawbacks.push(Drawback::Saturated { share: share(tally.saturated) });
        }
        let Some((best, best_tally)) = best else { return drawbacks };
        let (best_peak, best_settled) = medians(best_tally);
        if candidate.obstacle.is_none() && tally.met == tally.variants {
            drawbacks.push(Drawback::LessMargin {
                best: best.name.clone(),
                peak_error: [peak, best_peak],
                settling_time: [settled, best_settled],
            });
        }
        let parameters = notably_larger(&candidate.guide, &best.guide);
        if !parameters.is_empty() && peak > best_peak {
            drawbacks.push(Drawback::Larger { best: best.name.clone(), parameters });
        }
        drawbacks
    }
}

impl NumberedPlan for SelectionPlan {
    type Outcome = VariantResult;
    const KIND: &'static str = "selection";
    const ROWS: &'static str = "variants";

    fn count(&self) -> u64 {
        self.variants
    }

    fn obstacle(&self) -> Option<String> {
        self.candidates.is_empty().then(|| "has no guide".to_owned())
    }

    fn columns(&self) -> Vec<Column> {
        use ColumnKind::{Count, Flag, Number, Optional, Text};
        [
            ("guide", Text),
            ("variant", Count),
            ("seed", Count),
            ("peak_error_m", Number),
            ("settling_time_s", Optional),
            ("saturated", Flag),
            ("stiffness", Number),
            ("bristle_damping", Number),
            ("viscous_friction", Number),
            ("coulomb_force", Number),
            ("static_force", Number),
            ("stribeck_velocity", Number),
        ]
        .map(|(name, kind)| Column::new(name, kind))
        .into()
    }

    fn row(&self, job: u64, result: &VariantResult) -> Vec<Cell> {
        let (index, variant) = self.job(job);
        let name = &self.candidates[index].name;
        let guide = &result.guide;
        vec![
            Cell::Text(name.clone()),
            Cell::Count(variant),
            Cell::Count(variant_seed(self.seed, name, variant)),
            Cell::Number(result.peak_error),
            Cell::Optional(result.settling_time),
            Cell::Flag(result.saturated),
            Cell::Number(guide.stiffness),
            Cell::Number(guide.bristle_damping),
            Cell::Number(guide.viscous_friction),
            Cell::Number(guide.coulomb_force),
            Cell::Number(guide.static_force),
            Cell::Number(guide.stribeck_velocity),
        ]
    }

    fn outcome(&self, job: u64, row: &[Cell]) -> Result<VariantResult, OtherJob> {
        let (index, variant) = self.job(job);
        let words = |variant: u64, guide: &str| format!("variant {variant} of {guide}");
        let number = |cell: usize| row[cell].number().unwrap_or(f64::NAN);
        let (guide, found) = (row[0].text(), row[1].count());
        let name = &self.candidates[index].name;
        if guide != name || found != variant {
            return Err(OtherJob { found: words(found, guide), planned: words(variant, name) });
        }
        Ok(VariantResult {
            variant,
            peak_error: number(3),
            settling_time: row[4].number(),
            saturated: row[5].flag(),
            guide: Guide {
                stiffness: number(6),
                bristle_damping: number(7),
                viscous_friction: number(8),
                coulomb_force: number(9),
                static_force: number(10),
                stribeck_velocity: number(11),
                stribeck_exponent: None,
                damping_velocity: None,
            },
        })
    }
}

impl VariantRows {
    /// Per guide what its variants reach, and all guides ranked by that.
    pub fn ranked(&self) -> Result<(Vec<Tally>, GuideSelection), RowsError> {
        let plan = &self.sheet().plan;
        let mut tallies = vec![Tally::default(); plan.candidates.len()];
        self.read(&mut |job, result| {
            tallies[plan.job(job).0].add(&result, &plan.application);
            Ok(())
        })?;
        let selection = plan.rank(&tallies);
        Ok((tallies, selection))
    }
}

/// What of a guide is notably larger than of the chosen one: name, both values, unit.
fn notably_larger(guide: &Guide, best: &Guide) -> Vec<(&'static str, f64, f64, &'static str)> {
    let compared = [
        ("bristle stiffness", guide.stiffness, best.stiffness, "N/m"),
        ("static friction", guide.static_force, best.static_force, "N"),
        ("viscous friction", guide.viscous_friction, best.viscous_friction, "N s/m"),
    ];
    compared.into_iter().filter(|(_, own, other, _)| *own > NOTABLE * other).collect()
}

/// The paper's warning (sections 2 and 4): a guide with less viscous friction looks better in a
/// data sheet and positions worse.
fn low_friction_trap(
    candidate: &Candidate,
    tally: &Tally,
    best: &Candidate,
    best_tally: &Tally,
) -> Option<SelectionFinding> {
    let (own, other) = (&candidate.guide, &best.guide);
    let peak_error = [tally, best_tally].map(|of| of.peak_error().q50);
    let static_force = [own, other].map(|of| of.static_force);
    let looks_better = own.viscous_friction * NOTABLE < other.viscous_friction;
    let is_worse = peak_error[0] > peak_error[1] && static_force[0] > static_force[1];
    (looks_better && is_worse).then(|| SelectionFinding::LowFriction {
        guide: candidate.name.clone(),
        best: best.name.clone(),
        viscous_share: own.viscous_friction / other.viscous_friction,
        static_force,
        peak_error,
    })
}

impl Default for Tally {
    fn default() -> Self {
        let histogram = || {
            // The bounds are constants that the library takes; a test builds a tally.
            Histogram::new_with_bounds(1, LARGEST, DIGITS).expect("valid bounds")
        };
        Tally {
            variants: 0,
            met: 0,
            peak_too_large: 0,
            settled_too_late: 0,
            never_settled: 0,
            saturated: 0,
            peak_error: histogram(),
            settling_time: histogram(),
        }
    }
}

impl Tally {
    /// Counts one variant.
    pub fn add(&mut self, result: &VariantResult, application: &Application) {
        let requirement = &application.requirement;
        let peak_too_large = result.peak_error > requirement.peak_error;
        let late = result.settling_time.is_none_or(|time| time > requirement.settling_time);
        self.variants += 1;
        self.met += u64::from(!peak_too_large && !late && !result.saturated);
        self.peak_too_large += u64::from(peak_too_large);
        self.settled_too_late += u64::from(late);
        self.saturated += u64::from(result.saturated);
        self.peak_error.saturating_record((result.peak_error * 1e12).round() as u64);
        match result.settling_time {
            Some(time) => self.settling_time.saturating_record((time * 1e9).round() as u64),
            None => self.never_settled += 1,
        }
    }

    /// Share of the variants that meet the requirement.
    pub fn chance(&self) -> f64 {
        self.met as f64 / self.variants.max(1) as f64
    }

    /// 95 % interval of the chance (Wilson, JASA 22, 1927).
    pub fn chance_ci95(&self) -> [f64; 2] {
        let (n, p) = (self.variants.max(1) as f64, self.chance());
        let z = TWO_SIDED_95;
        let middle = p + z * z / (2.0 * n);
        let half = z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
        let scale = 1.0 + z * z / n;
        [((middle - half) / scale).max(0.0), ((middle + half) / scale).min(1.0)]
    }

    /// Quantile of the peak error, m, to 0.1 %.
    pub fn peak_error_at(&self, quantile: f64) -> f64 {
        self.peak_error.value_at_quantile(quantile) as f64 * 1e-12
    }

    /// Quantile of the settling time, s, to 0.1 %; infinite among those that never settled.
    pub fn settling_time_at(&self, quantile: f64) -> f64 {
        let settled = self.settling_time.len() as f64 / self.variants.max(1) as f64;
        if quantile > settled {
            return f64::INFINITY;
        }
        self.settling_time.value_at_quantile((quantile / settled).min(1.0)) as f64 * 1e-9
    }

    /// Quantiles of the peak error, m.
    pub fn peak_error(&self) -> Quantiles {
        Quantiles {
            q05: self.peak_error_at(0.05),
            q50: self.peak_error_at(0.5),
            q95: self.peak_error_at(0.95),
        }
    }

    /// Quantiles of the settling time, s; infinite among those that never settled.
    pub fn settling_time(&self) -> Quantiles {
        Quantiles {
            q05: self.settling_time_at(0.05),
            q50: self.settling_time_at(0.5),
            q95: self.settling_time_at(0.95),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLEAN: &str = include_str!("../../../launch_config/application_fine_step_clean.yaml");
    const SEALED: &str = include_str!("../../../launch_config/application_fine_step_sealed.yaml");

    fn plan(text: &str, variants: u64) -> SelectionPlan {
        SelectionPlan::new(
            Application::from_yaml(text, "test").unwrap(),
            &Catalogue::builtin(),
            1,
            variants,
        )
        .unwrap()
    }

    fn select(plan: &SelectionPlan) -> GuideSelection {
        let experiment = VariantExperiment::new(&plan.application).unwrap();
        let mut tallies = vec![Tally::default(); plan.candidates.len()];
        for (job, result) in plan.run(&experiment, 0..plan.variants).unwrap().iter().enumerate() {
            tallies[plan.job(job as u64).0].add(result, &plan.application);
        }
        plan.rank(&tallies)
    }

    #[test]
    fn guide_2_is_chosen_where_it_is_clean_and_guide_1_where_sealing_is_required() {
        let clean = select(&plan(CLEAN, 60));
        assert_eq!(clean.choice.as_deref(), Some("guide_2"));
        assert_eq!(
            clean.ranking.iter().map(|row| row.guide.as_str()).collect::<Vec<_>>(),
            ["guide_2", "guide_1", "guide_3"]
        );
        let sealed = select(&plan(SEALED, 60));
        assert_eq!(sealed.choice.as_deref(), Some("guide_1"));
        let unsealed = &sealed.ranking[2];
        assert!(
            unsealed.guide == "guide_2"
                && unsealed.drawbacks[0] == Drawback::Excluded(unsealed.obstacle.clone().unwrap()),
            "{unsealed:?}"
        );
        for selection in [clean, sealed] {
            let reported = selection.findings.iter().any(|finding| match finding {
                SelectionFinding::LowFriction { guide, static_force, .. } => {
                    guide == "guide_3" && static_force[0] == 18.5
                }
                SelectionFinding::UnsafeChoice { .. } => false,
            });
            let is_safe = selection.findings.iter().all(|finding| !finding.is_warning());
            assert!(reported && is_safe, "{selection:?}");
        }
    }

    #[test]
    fn any_order_of_shards_gives_the_same_bits_as_one_run() {
        let plan = plan(CLEAN, 21);
        let experiment = VariantExperiment::new(&plan.application).unwrap();
        let whole = plan.run(&experiment, Shard::WHOLE.jobs(plan.variants)).unwrap();
        let mut parts: Vec<(u64, Vec<VariantResult>)> = [3, 1, 4, 2]
            .map(|index| {
                (
                    index,
                    plan.run(&experiment, Shard { index, count: 4 }.jobs(plan.variants)).unwrap(),
                )
            })
            .into();
        parts.sort_by_key(|(index, _)| *index);
        assert_eq!(parts.into_iter().flat_map(|(_, part)| part).collect::<Vec<_>>(), whole);
        let errors: Vec<u64> = whole.iter().map(|result| result.peak_error.to_bits()).collect();
        assert!(
            errors.iter().enumerate().all(|(index, bits)| !errors[..index].contains(bits)),
            "variants repeat"
        );
    }

    #[test]
    fn shards_are_read_and_cover_everything_once() {
        for (jobs, count) in [(10u64, 3), (2, 5), (10_000, 7)] {
            let ranges: Vec<Range<u64>> =
                (1..=count).map(|index| Shard { index, count }.jobs(jobs)).collect();
            assert!(ranges.windows(2).all(|pair| pair[0].end == pair[1].start), "{ranges:?}");
            assert_eq!((ranges[0].start, ranges[ranges.len() - 1].end), (0, jobs));
        }
        assert_eq!("2/8".parse::<Shard>().unwrap(), Shard { index: 2, count: 8 });
        for text in ["0/3", "4/3", "1", "a/b", "1/0", "-1/2"] {
            assert!(text.parse::<Shard>().unwrap_err().to_string().contains("i/n"), "{text}");
        }
    }

    #[test]
    fn quantiles_and_chance_are_those_of_the_counted_values() {
        let application = plan(CLEAN, 3).application;
        let mut tally = Tally::default();
        let guide = Catalogue::builtin().guide("guide_1").unwrap();
        for k in 1..=1000u64 {
            // Peak errors 10 nm .. 10 µm; settling 0.2 ms .. 160 ms, the last fifth never.
            let settling_time = (k <= 800).then_some(k as f64 * 0.2e-3);
            let result = VariantResult {
                variant: k,
                peak_error: k as f64 * 10e-9,
                settling_time,
                saturated: false,
                guide: guide.clone(),
            };
            tally.add(&result, &application);
        }
        let close = |found: f64, expected: f64| {
            assert!((found / expected - 1.0).abs() < 2e-3, "{found} {expected}")
        };
        let (peak, settling) = (tally.peak_error(), tally.settling_time());
        close(peak.q05, 0.5e-6);
        close(peak.q50, 5e-6);
        close(peak.q95, 9.5e-6);
        close(settling.q05, 10e-3);
        close(settling.q50, 100e-3);
        assert!(settling.q95.is_infinite() && tally.never_settled == 200);
        // Required: 6 µm and 100 ms, met by k <= 500 (100 ms is the binding one).
        assert_eq!(tally.met, 500);
        let [low, high] = tally.chance_ci95();
        // Wilson for 500 of 1000.
        assert!((low - 0.469_070).abs() < 1e-5 && (high - 0.530_930).abs() < 1e-5, "{low} {high}");
    }

    #[test]
    fn what_cannot_be_chosen_is_said_with_the_reason() {
        let application = Application::from_yaml(CLEAN, "test").unwrap();
        let empty =
            SelectionPlan::new(application.clone(), &Catalogue::default(), 1, 10).unwrap_err();
        assert!(empty.to_string().contains("the database is empty"));
        let mut waterproof = application.clone();
        waterproof.constraints.lubricants = Some(vec!["dry".into()]);
        let nothing =
            SelectionPlan::new(waterproof, &Catalogue::builtin(), 1, 10).unwrap_err().to_string();
        assert!(
            nothing.contains("guide_2 is lubricated with `standard`") && nothing.contains("`dry`"),
            "{nothing}"
        );
        let few = SelectionPlan::new(application.clone(), &Catalogue::builtin(), 1, 2)
            .unwrap_err()
            .to_string();
        assert!(few.contains("2 variants") && few.contains("3 guides"), "{few}");
        let mut strict = application;
        strict.requirement.peak_error = 1e-9;
        let selection = select(&SelectionPlan::new(strict, &Catalogue::builtin(), 1, 6).unwrap());
        assert_eq!(selection.choice, None);
        let best = &selection.ranking[0];
        let Drawback::PeakError { share, allowed, .. } = best.drawbacks[0] else {
            panic!("{best:?}");
        };
        assert_eq!((share, allowed), (1.0, 1e-9));
    }
}
