//! LuGre parameters of a guide from recordings of the measuring rig, with confidence intervals.
//!
//! The two steps of the literature (Canudas de Wit, Lischinsky, "Adaptive friction compensation
//! with partially known dynamic friction model", Int. J. Adapt. Control Signal Process. 11, 1997):
//! first the static curve from runs at constant velocity, then stiffness and damping of the bristle
//! from slow loops; then all parameters together on both. The force along the *measured* motion is
//! compared with the force cell, so that it does not matter how the rig was driven: F = m a +
//! sigma0 z + sigma1 dz/dt + sigma2 v + offset, with the bristle moved exactly over each sampling
//! interval.

use std::slice;

use serde::Serialize;

use super::finding::GuideFitFinding;
use super::least_squares::{FitError, Minimum, minimise};
use super::specimen::LabRecording as Recording;
use friction_stage_core::model::{
    Catalogue, CatalogueEntry, Guide, ModelError, Provenance, Quantity,
};
use friction_stage_core::numerics::TWO_SIDED_95;
use friction_stage_core::numerics::correlation::correlation_length;
use friction_stage_core::plant::GuideBank;

/// What the measuring rig records, one row per sample, SI units.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RigRecord {
    /// s, evenly spaced.
    pub time: Vec<f64>,
    /// Encoder, m.
    pub position: Vec<f64>,
    /// Force cell, N.
    pub force: Vec<f64>,
}

impl From<&Recording> for RigRecord {
    fn from(recording: &Recording) -> RigRecord {
        let samples = || recording.rows.iter().map(|row| row.sample);
        RigRecord {
            time: samples().map(|sample| sample.time as f64 * 1e-9).collect(),
            position: samples().map(|sample| sample.position).collect(),
            force: samples().map(|sample| sample.force_cell).collect(),
        }
    }
}

/// A parameter with its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Fitted {
    /// Estimate, in the unit of the parameter.
    pub value: f64,
    /// Lower and upper end of its 95 % interval.
    pub ci95: [f64; 2],
}

/// A guide as the recordings show it. SI units, names as in [`Guide`].
#[derive(Clone, Debug, PartialEq)]
pub struct GuideFit {
    /// Bristle stiffness sigma0, N/m.
    pub stiffness: Fitted,
    /// Bristle damping sigma1, N s/m.
    pub bristle_damping: Fitted,
    /// Viscous friction sigma2, N s/m.
    pub viscous_friction: Fitted,
    /// Coulomb friction Fc, N.
    pub coulomb_force: Fitted,
    /// Static friction Fs, N.
    pub static_force: Fitted,
    /// Stribeck velocity vs, m/s; `None` where the friction level does not fall with velocity: then
    /// static and Coulomb force are one.
    pub stribeck_velocity: Option<Fitted>,
    /// What the force cell reads without force, N.
    pub offset: Fitted,
    /// Runs at constant velocity that were found.
    pub windows: usize,
    /// Rows of the loops.
    pub rows: usize,
    /// Rms of what the model leaves of the loops' force, N.
    pub force_rms: f64,
    /// Rms of the noise of the force cell, from its differences, N.
    pub noise_rms: f64,
    /// What a user should know.
    pub findings: Vec<GuideFitFinding>,
}

/// How a fitted guide is built, which no recording shows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GuideConstruction {
    /// What the guide is, in words.
    pub description: String,
    /// Whether it has seals.
    pub seals: bool,
    /// Whether its balls are in a cage.
    pub cage: bool,
    /// Name of its lubricant.
    pub lubricant: String,
}

impl Default for GuideConstruction {
    /// Nothing is known: without seals, it is never chosen where sealing is required.
    fn default() -> GuideConstruction {
        GuideConstruction {
            description: "fitted to recordings".to_owned(),
            seals: false,
            cage: false,
            lubricant: "unknown".to_owned(),
        }
    }
}

/// Recordings from which no guide can be fitted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GuideFitError {
    /// A recording with too few rows.
    #[error(
        "the {record} recording has {rows} rows with position and force, at least {needed} are \
         needed"
    )]
    TooShort {
        /// Which recording: `Stribeck` or `Dahl`.
        record: &'static str,
        /// Rows with position and force.
        rows: usize,
        /// Fewest rows for a fit.
        needed: usize,
    },
    /// A recording with uneven steps of time, or with a hole.
    #[error(
        "the {record} recording is not evenly sampled: a step of {step:.3e} s at {time:.4} s, \
         usually {usual:.3e} s"
    )]
    Uneven {
        /// Which recording: `Stribeck` or `Dahl`.
        record: &'static str,
        /// The step that differs, s; NaN at a hole.
        step: f64,
        /// Time at its beginning, s.
        time: f64,
        /// Mean step of the recording, s.
        usual: f64,
    },
    /// Too few runs at constant velocity in one direction.
    #[error(
        "the Stribeck recording has {windows} runs at constant velocity (of at least {needed}): {} \
         needed in each direction",
        needed / 2
    )]
    Windows {
        /// Runs that were found, in both directions.
        windows: usize,
        /// Fewest runs for a fit, half of them in each direction.
        needed: usize,
    },
    /// A step of the fit without a result.
    #[error("the {step} step: {source}")]
    Search {
        /// Which step: `static`, `presliding` or `joint`.
        step: &'static str,
        /// Why the search has none.
        source: FitError,
    },
}

/// Half width of the local cubic that smooths the position, s. Assumed: well below the rise time of
/// a 60 Hz servo, and wide enough that the noise of the encoder does not count as way.
const SMOOTHING: f64 = 2.5e-3;
/// Share of its speed within which a run counts as of constant velocity. Assumed.
const CONSTANT: f64 = 0.01;
/// Half of the time over which a speed is averaged to tell whether it is constant, s. Assumed: some
/// periods of the servo.
const AVERAGE: f64 = 0.02;
/// Travel, in units of Fs/sigma0, after which the friction is taken as steady: exp(-10) of the way
/// is left.
const STEADY: f64 = 10.0;
/// Shortest stretch of constant velocity, s. Assumed: three periods of the mains.
const SHORTEST: f64 = 0.06;
/// Fewest runs: as many as the static curve has parameters and one more, in each direction.
const FEWEST_RUNS: usize = 10;
/// Share of the cell's noise that the force of the bristle damping must reach in the loops, rms.
/// Assumed: on the guides of the catalogue, loops with 0.2 to 0.6 give intervals beside the truth,
/// since what the servo trembles resembles damping there; with 1.0 to 2.6 they hold it.
const LEAST_DAMPING: f64 = 0.8;
/// 99.9 % quantile of chi-squared with 2 degrees of freedom: what the falling part of F(v) must
/// gain.
pub(super) const SIGNIFICANT: f64 = 13.816;
/// Stribeck velocity where nothing falls with velocity, m/s: that of the catalogue's guide 2.
const UNUSED_STRIBECK_VELOCITY: f64 = 5e-3;

/// A recording with what follows from its positions.
struct Motion {
    step: f64,
    position: Vec<f64>,
    velocity: Vec<f64>,
    acceleration: Vec<f64>,
    force: Vec<f64>,
}

/// A run at constant velocity: means over its rows.
struct Window {
    velocity: f64,
    acceleration: f64,
    force: f64,
    /// Square root of the number of rows.
    weight: f64,
    noise: f64,
    rows: usize,
}

/// Fits a guide. `mass` in kg is what moves behind the force cell: the carriage with its adapter.
pub fn fit_guide(
    stribeck: &RigRecord,
    dahl: &RigRecord,
    mass: f64,
) -> Result<GuideFit, GuideFitError> {
    let runs = Motion::new(stribeck, "Stribeck")?;
    let loops = Motion::new(dahl, "Dahl")?;
    // Without anything known: the level that the loops reach, the offset in their middle, the
    // stiffness that fits best.
    let (low, high) = loops.force_range();
    let (rough_level, offset) = (0.5 * (high - low), 0.5 * (high + low));
    let rough = |stiffness: f64| Guide {
        stiffness,
        // The damping ratio that the catalogue assumes for guide 1, 900 N s/m at 4.5e5 N/m.
        bristle_damping: 2e-3 * stiffness,
        viscous_friction: 0.0,
        coulomb_force: rough_level,
        static_force: rough_level,
        stribeck_velocity: 1.0,
        stribeck_exponent: None,
        damping_velocity: None,
    };
    let misfit = |guide: &Guide| -> f64 {
        let residuals = loops.residuals(guide, mass, offset, 0.0, 0.0);
        residuals.iter().map(|residual| residual * residual).sum()
    };
    // 1e4 to 1e7 N/m in steps of 26 %: from a tenth of the paper's softest to ten times its
    // stiffest.
    let guess = (0..=30)
        .map(|k| rough(1e4 * 10f64.powf(0.1 * f64::from(k))))
        .min_by(|a, b| misfit(a).total_cmp(&misfit(b)));
    let guess = guess.unwrap_or_else(|| rough(1e5));

    let windows = runs.windows(STEADY * guess.static_force / guess.stiffness);
    let each_way = windows.iter().filter(|window| window.velocity > 0.0).count();
    if each_way.min(windows.len() - each_way) < FEWEST_RUNS / 2 {
        return Err(GuideFitError::Windows { windows: windows.len(), needed: FEWEST_RUNS });
    }

    // First step: the static curve, falling if that explains more than chance.
    let flat = static_step(&windows, mass, offset, &guess, Shape { falls: false });
    let falling = static_step(&windows, mass, offset, &guess, Shape { falls: true });
    let (shape, curve) = match (flat, falling) {
        (Some(flat), Some(falling)) => {
            let freedom = windows.len().saturating_sub(5).max(1);
            let variance = noise_of(&windows).max(falling.cost / freedom as f64);
            match flat.cost - falling.cost > SIGNIFICANT * variance {
                true => (Shape { falls: true }, falling),
                false => (Shape { falls: false }, flat),
            }
        }
        (Some(flat), None) => (Shape { falls: false }, flat),
        (None, Some(falling)) => (Shape { falls: true }, falling),
        (None, None) => {
            let source = FitError::Singular { parameters: 3 };
            return Err(GuideFitError::Search { step: "static", source });
        }
    };
    let minimum = both_steps(&windows, &loops, mass, &curve.parameters, shape)?;
    Ok(conclude(&minimum, shape, &windows, &loops))
}

/// The parameters of a search: logarithms, but for offset (N), first deflection (in units of
/// Fs/sigma0) and trembling (in um^2/s^2).
#[derive(Clone, Copy)]
struct Shape {
    falls: bool,
}

impl Shape {
    /// Order: ln sigma0, ln sigma1, ln sigma2, ln Fc, offset, deflection, trembling, ln (Fs - Fc),
    /// ln vs.
    fn guide(self, p: &[f64]) -> Guide {
        let coulomb_force = p[3].exp();
        Guide {
            stiffness: p[0].exp(),
            bristle_damping: p[1].exp(),
            viscous_friction: p[2].exp(),
            coulomb_force,
            static_force: if self.falls { coulomb_force + p[7].exp() } else { coulomb_force },
            stribeck_velocity: if self.falls { p[8].exp() } else { UNUSED_STRIBECK_VELOCITY },
            stribeck_exponent: None,
            damping_velocity: None,
        }
    }
}

/// Mean measured less modelled force of the runs, N, times the root of their rows.
fn static_residuals(windows: &[Window], mass: f64, guide: &Guide, offset: f64) -> Vec<f64> {
    let of = |window: &Window| {
        let model = guide.steady_force(window.velocity) + mass * window.acceleration + offset;
        window.weight * (window.force - model)
    };
    windows.iter().map(of).collect()
}

/// Mean square of the noise of the force cell, N^2, from differences of neighbouring rows.
fn noise_of(windows: &[Window]) -> f64 {
    let sum = |value: &dyn Fn(&Window) -> f64| windows.iter().map(value).sum::<f64>();
    sum(&|window| window.noise * window.rows as f64) / sum(&|window| window.rows as f64)
}

/// The static curve; all parameters of the shape, of which those of the bristle are still the
/// guess.
fn static_step(
    windows: &[Window],
    mass: f64,
    offset: f64,
    guess: &Guide,
    shape: Shape,
) -> Option<Minimum> {
    let speeds = windows.iter().map(|window| window.velocity.abs());
    let (slowest, fastest) =
        speeds.fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), v| (low.min(v), high.max(v)));
    let level = guess.static_force;
    // A Stribeck velocity is found from within a factor of a few: one start for each half decade of
    // the measured speeds.
    let starts: Vec<f64> = match shape.falls {
        true => (1..20)
            .map(|k| slowest * 10f64.powf(0.5 * f64::from(k)))
            .take_while(|v| *v < fastest)
            .collect(),
        false => vec![UNUSED_STRIBECK_VELOCITY],
    };
    let search = |velocity: f64| {
        let mut start = vec![(0.2 * level / fastest).ln(), (0.85 * level).ln(), offset];
        if shape.falls {
            start.extend([(0.15 * level).ln(), velocity.ln()]);
        }
        let whole = |p: &[f64]| -> Vec<f64> {
            let mut all =
                vec![guess.stiffness.ln(), guess.bristle_damping.ln(), p[0], p[1], p[2], 0.0, 0.0];
            all.extend_from_slice(&p[3..]);
            all
        };
        let residuals = |p: &[f64]| static_residuals(windows, mass, &shape.guide(&whole(p)), p[2]);
        let found = minimise(&start, &residuals).ok()?;
        let parameters = whole(&found.parameters);
        // A fall outside the measured speeds is none that was measured.
        let inside = !shape.falls || (slowest..fastest).contains(&parameters[8].exp());
        inside.then_some(Minimum { parameters, ..found })
    };
    starts.into_iter().filter_map(search).min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// Second step, the bristle with the static curve as it is; then all parameters on both recordings.
fn both_steps(
    windows: &[Window],
    loops: &Motion,
    mass: f64,
    curve: &[f64],
    shape: Shape,
) -> Result<Minimum, GuideFitError> {
    let failed =
        |step: &'static str| move |source: FitError| GuideFitError::Search { step, source };
    let with = |p: &[f64]| -> Vec<f64> {
        let mut all = curve.to_vec();
        (all[0], all[1], all[4], all[5], all[6]) = (p[0], p[1], p[2], p[3], p[4]);
        all
    };
    let of_loops = |all: &[f64]| -> Vec<f64> {
        let guide = shape.guide(all);
        loops.residuals(
            &guide,
            mass,
            all[4],
            all[5] * guide.static_force / guide.stiffness,
            1e-12 * all[6],
        )
    };
    let start = [curve[0], curve[1], curve[4], 0.0, 0.0];
    let second = minimise(&start, &|p: &[f64]| of_loops(&with(p))).map_err(failed("presliding"))?;
    let joint = |p: &[f64]| -> Vec<f64> {
        let mut residuals = static_residuals(windows, mass, &shape.guide(p), p[4]);
        residuals.extend(of_loops(p));
        residuals
    };
    minimise(&with(&second.parameters), &joint).map_err(failed("joint"))
}

fn conclude(minimum: &Minimum, shape: Shape, windows: &[Window], loops: &Motion) -> GuideFit {
    let p = &minimum.parameters;
    let (guide, falls) = (shape.guide(p), shape.falls);
    let of_loops = &minimum.residuals[windows.len()..];
    let freedom = minimum.residuals.len() - p.len();
    // Residuals that resemble their neighbours count as fewer: the variance grows by their
    // correlation time.
    let variance = minimum.cost / freedom as f64 * correlation_length(of_loops);
    let covariance = |a: usize, b: usize| minimum.covariance[(a, b)] * variance;
    let logarithmic = |k: usize| {
        let (value, half) = (p[k].exp(), TWO_SIDED_95 * covariance(k, k).sqrt());
        Fitted { value, ci95: [value * (-half).exp(), value * half.exp()] }
    };
    let coulomb_force = logarithmic(3);
    let static_force = if falls {
        let (fc, excess) = (p[3].exp(), p[7].exp());
        let deviation = (fc * fc * covariance(3, 3)
            + excess * excess * covariance(7, 7)
            + 2.0 * fc * excess * covariance(3, 7))
        .sqrt();
        let value = fc + excess;
        Fitted { value, ci95: [value - TWO_SIDED_95 * deviation, value + TWO_SIDED_95 * deviation] }
    } else {
        coulomb_force
    };
    let half = TWO_SIDED_95 * covariance(4, 4).sqrt();
    let force_rms = (of_loops.iter().map(|residual| residual * residual).sum::<f64>()
        / of_loops.len() as f64)
        .sqrt();
    let mut fit = GuideFit {
        stiffness: logarithmic(0),
        bristle_damping: logarithmic(1),
        viscous_friction: logarithmic(2),
        coulomb_force,
        static_force,
        stribeck_velocity: falls.then(|| logarithmic(8)),
        offset: Fitted { value: p[4], ci95: [p[4] - half, p[4] + half] },
        windows: windows.len(),
        rows: loops.force.len(),
        force_rms,
        noise_rms: noise_of(windows).sqrt(),
        findings: Vec::new(),
    };
    fit.warn(&guide, loops);
    fit
}

impl GuideFit {
    /// The fitted guide.
    pub fn guide(&self) -> Guide {
        Guide {
            stiffness: self.stiffness.value,
            bristle_damping: self.bristle_damping.value,
            viscous_friction: self.viscous_friction.value,
            coulomb_force: self.coulomb_force.value,
            static_force: self.static_force.value,
            stribeck_velocity: self
                .stribeck_velocity
                .map_or(UNUSED_STRIBECK_VELOCITY, |fitted| fitted.value),
            stribeck_exponent: None,
            damping_velocity: None,
        }
    }

    /// Fitted parameters with their names as in [`Guide`].
    pub fn parameters(&self) -> Vec<(&'static str, Fitted)> {
        let always = [
            ("stiffness", self.stiffness),
            ("bristle_damping", self.bristle_damping),
            ("viscous_friction", self.viscous_friction),
            ("coulomb_force", self.coulomb_force),
            ("static_force", self.static_force),
        ];
        always
            .into_iter()
            .chain(self.stribeck_velocity.map(|fitted| ("stribeck_velocity", fitted)))
            .collect()
    }

    /// Unit of a parameter.
    pub fn unit(name: &str) -> &'static str {
        match name {
            "stiffness" => "N/m",
            "bristle_damping" | "viscous_friction" => "N s/m",
            "coulomb_force" | "static_force" => "N",
            _ => "m/s",
        }
    }

    /// A catalogue of this guide alone. `recordings` says what it was fitted to.
    pub fn catalogue(
        &self,
        name: &str,
        construction: &GuideConstruction,
        recordings: &str,
    ) -> Result<Catalogue, ModelError> {
        let source = format!("fit-guide {}: {recordings}", env!("CARGO_PKG_VERSION"));
        let quantity = |name: &str, fitted: Fitted| Quantity {
            value: fitted.value,
            unit: GuideFit::unit(name).to_owned(),
            provenance: Provenance::Measured,
            source: source.clone(),
            ci95: Some(fitted.ci95),
        };
        let stribeck_velocity = match self.stribeck_velocity {
            Some(fitted) => quantity("stribeck_velocity", fitted),
            None => Quantity {
                value: self.guide().stribeck_velocity,
                unit: GuideFit::unit("stribeck_velocity").to_owned(),
                provenance: Provenance::Assumed,
                source: "without effect while Fs = Fc: the friction level does not fall with \
                         velocity"
                    .to_owned(),
                ci95: None,
            },
        };
        let GuideConstruction { description, seals, cage, lubricant } = construction.clone();
        let entry = CatalogueEntry {
            description,
            seals,
            lubricant,
            cage,
            stiffness: quantity("stiffness", self.stiffness),
            bristle_damping: quantity("bristle_damping", self.bristle_damping),
            viscous_friction: quantity("viscous_friction", self.viscous_friction),
            coulomb_force: quantity("coulomb_force", self.coulomb_force),
            static_force: quantity("static_force", self.static_force),
            stribeck_velocity,
            effective_stiffness: Vec::new(),
            distributed_bristles: None,
        };
        let mut catalogue = Catalogue::default();
        catalogue.insert(name.to_owned(), entry, "the fit")?;
        Ok(catalogue)
    }

    fn warn(&mut self, guide: &Guide, loops: &Motion) {
        for (name, fitted) in self.parameters() {
            let width = (fitted.ci95[1] - fitted.ci95[0]) / (2.0 * fitted.value);
            // A tenth: three times what a fit on a good rig leaves.
            if width > 0.1 {
                self.findings.push(GuideFitFinding::WideInterval {
                    parameter: name,
                    value: fitted.value,
                    share: width,
                });
            }
        }
        let damping = loops.damping_force_rms(guide);
        if damping < LEAST_DAMPING * self.noise_rms {
            let noise = self.noise_rms;
            self.findings.push(GuideFitFinding::HiddenDamping { damping, noise });
        }
        if self.force_rms > 1.5 * self.noise_rms {
            let (left, noise) = (self.force_rms, self.noise_rms);
            self.findings.push(GuideFitFinding::SeveralBristles { left, noise });
        }
        let (low, high) = loops.position_range();
        let break_away = guide.static_force / guide.stiffness;
        let (span, least) = (high - low, 4.0 * break_away);
        if span < least {
            self.findings.push(GuideFitFinding::SmallLoop { span, break_away, least });
        }
    }
}

impl Motion {
    fn new(record: &RigRecord, name: &'static str) -> Result<Motion, GuideFitError> {
        let rows: Vec<usize> = (0..record.time.len())
            .filter(|k| record.position[*k].is_finite() && record.force[*k].is_finite())
            .collect();
        let needed = 100;
        if rows.len() < needed {
            return Err(GuideFitError::TooShort { record: name, rows: rows.len(), needed });
        }
        let (first, last) = (rows[0], rows[rows.len() - 1]);
        let span = record.time[last] - record.time[first];
        let usual = span / (last - first) as f64;
        for k in first..last {
            let step = record.time[k + 1] - record.time[k];
            // Half a sample more or less is a lost or doubled one; stamps of a real clock may
            // jitter below that.
            if !(0.5..1.5).contains(&(step / usual)) {
                return Err(GuideFitError::Uneven {
                    record: name,
                    step,
                    time: record.time[k],
                    usual,
                });
            }
        }
        if rows.len() != last + 1 - first {
            let hole = (first..last)
                .find(|k| !record.force[*k].is_finite() || !record.position[*k].is_finite());
            let time = record.time[hole.unwrap_or(first)];
            return Err(GuideFitError::Uneven { record: name, step: f64::NAN, time, usual });
        }
        let half = ((SMOOTHING / usual).round() as usize).max(2);
        if rows.len() < 4 * half {
            return Err(GuideFitError::TooShort {
                record: name,
                rows: rows.len(),
                needed: 4 * half,
            });
        }
        let raw = &record.position[first..=last];
        let kernels = local_cubic(half, usual);
        let inside = half..raw.len() - half;
        let apply = |kernel: &[f64]| -> Vec<f64> {
            let at = |k: usize| {
                // Differences to the middle keep the digits of a small motion far from zero.
                let terms = kernel
                    .iter()
                    .zip(&raw[k - half..=k + half])
                    .map(|(weight, x)| weight * (x - raw[k]));
                terms.sum::<f64>()
            };
            inside.clone().map(at).collect()
        };
        let correction = apply(&kernels[0]);
        Ok(Motion {
            step: usual,
            position: correction
                .iter()
                .zip(&raw[inside.clone()])
                .map(|(correction, x)| x + correction)
                .collect(),
            velocity: apply(&kernels[1]),
            acceleration: apply(&kernels[2]),
            force: record.force[first..=last][inside].to_vec(),
        })
    }

    fn force_range(&self) -> (f64, f64) {
        friction_stage_core::numerics::range(&self.force)
    }

    fn position_range(&self) -> (f64, f64) {
        friction_stage_core::numerics::range(&self.position)
    }

    /// Rms of sigma1 dz/dt along the motion, N.
    fn damping_force_rms(&self, guide: &Guide) -> f64 {
        let without = Guide { bristle_damping: 0.0, ..guide.clone() };
        let with = self.residuals(guide, 0.0, 0.0, 0.0, 0.0);
        let without = self.residuals(&without, 0.0, 0.0, 0.0, 0.0);
        let squares: f64 =
            with.iter().zip(&without).map(|(with, without)| (with - without).powi(2)).sum();
        (squares / with.len() as f64).sqrt()
    }

    /// Measured less modelled force, N, for a bristle that starts with this deflection, m.
    ///
    /// The bristle slips by |v| z: a guide that trembles slips while its mean stands still.
    /// `trembling`, m^2/s^2, is the mean square of the speed that the smoothing hides; it takes |v|
    /// to sqrt(v^2 + trembling).
    fn residuals(
        &self,
        guide: &Guide,
        mass: f64,
        offset: f64,
        deflection: f64,
        trembling: f64,
    ) -> Vec<f64> {
        let mut bank = GuideBank::new(slice::from_ref(guide));
        bank.set_bristles(&[deflection], 0.0);
        let speed = |velocity: f64| (velocity * velocity + trembling).max(0.0).sqrt();
        let mut residuals = Vec::with_capacity(self.force.len());
        for k in 0..self.force.len() {
            if k > 0 {
                let path = self.position[k] - self.position[k - 1];
                bank.move_trembling(path, speed(path / self.step), self.step);
            }
            let velocity = self.velocity[k];
            let friction = bank.trembling_force(velocity, speed(velocity));
            residuals.push(self.force[k] - friction - mass * self.acceleration[k] - offset);
        }
        residuals
    }

    /// Stretches of constant velocity, each after `steady` m of travel in its direction.
    fn windows(&self, steady: f64) -> Vec<Window> {
        let mut windows = Vec::new();
        let mut start = 0;
        while start < self.velocity.len() {
            let sign = self.velocity[start].signum();
            let end = (start..self.velocity.len())
                .find(|k| self.velocity[*k].signum() != sign)
                .unwrap_or(self.velocity.len());
            windows.extend(self.window(start, end, steady));
            start = end;
        }
        windows
    }

    /// The longest stretch of constant velocity among rows in one direction.
    fn window(&self, start: usize, end: usize, steady: f64) -> Option<Window> {
        let shortest = (SHORTEST / self.step).ceil() as usize;
        let reach = (AVERAGE / self.step).ceil() as usize;
        let speed_at = |k: usize| {
            let (before, after) = (k.saturating_sub(reach).max(start), (k + reach).min(end - 1));
            (self.position[after] - self.position[before]).abs()
                / (self.step * (after - before).max(1) as f64)
        };
        let from =
            (start..end).find(|k| (self.position[*k] - self.position[start]).abs() > steady)?;
        if end - from < shortest {
            return None;
        }
        // The speed at which most rows are: the densest band of that width.
        let mut speeds: Vec<f64> = (from..end).map(speed_at).collect();
        speeds.sort_by(f64::total_cmp);
        let mut above = 0;
        let (mut densest, mut low) = (0, 0.0);
        for (k, speed) in speeds.iter().enumerate() {
            while above < speeds.len() && speeds[above] <= speed * (1.0 + CONSTANT) {
                above += 1;
            }
            if above - k > densest {
                (densest, low) = (above - k, *speed);
            }
        }
        let inside = |k: &usize| (low..=low * (1.0 + CONSTANT)).contains(&speed_at(*k));
        let (mut longest, mut run) = (0..0, 0);
        for k in from..=end {
            if k < end && inside(&k) {
                run += 1;
                if run > longest.len() {
                    longest = k + 1 - run..k + 1;
                }
            } else {
                run = 0;
            }
        }
        if longest.len() < shortest {
            return None;
        }
        let count = longest.len() as f64;
        let mean = |column: &[f64]| column[longest.clone()].iter().sum::<f64>() / count;
        let force = &self.force[longest.clone()];
        let noise = force.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum::<f64>()
            / (2.0 * (count - 1.0));
        Some(Window {
            velocity: mean(&self.velocity),
            acceleration: mean(&self.acceleration),
            force: mean(&self.force),
            weight: count.sqrt(),
            noise,
            rows: longest.len(),
        })
    }
}

/// Weights that give value, first and second derivative of the least-squares cubic at the middle of
/// 2 half + 1 samples (Savitzky, Golay, Anal. Chem. 36(8), 1964).
fn local_cubic(half: usize, step: f64) -> [Vec<f64>; 3] {
    let offsets: Vec<f64> = (0..=2 * half).map(|k| k as f64 - half as f64).collect();
    let moment = |power: i32| offsets.iter().map(|offset| offset.powi(power)).sum::<f64>();
    let (m0, m2, m4, m6) = (moment(0), moment(2), moment(4), moment(6));
    let even = m0 * m4 - m2 * m2;
    let odd = m2 * m6 - m4 * m4;
    let weights = |weight: &dyn Fn(f64) -> f64| {
        offsets.iter().map(|offset| weight(*offset)).collect::<Vec<f64>>()
    };
    [
        weights(&|k| (m4 - m2 * k * k) / even),
        weights(&|k| (m6 * k - m4 * k * k * k) / (odd * step)),
        weights(&|k| 2.0 * (m0 * k * k - m2) / (even * step * step)),
    ]
}
