//! Guides with parallel bristles fitted to all that the paper says of its three guides.
//!
//! In comes nothing but [`data`]: the stiffnesses and forces that the text states, the orders in
//! which it puts the guides, and the values that the catalogue assumes where the text is silent.
//! Out come three guides and how each datum is met.
//!
//! The guides share their parts, as Table 1 shares them: guide 2 has three bristle elements
//! (rolling elements and cage), guide 1 the same three and a fourth one in parallel (the seals),
//! guide 3 those of guide 1 with seals that hold more (its lubricant). Element i has the stiffness
//! K_i and breaks away at d_i, so that a slow loop of amplitude A shows the sum of K_i d_i
//! tanh(A/d_i)/A (see [`super::fit_distributed`]).
//!
//! Objective: the sum of the squares of
//! - ln(found / stated) over [`STATED_WIDTH`] for each number of the text;
//! - max(0, [`ORDER_MARGIN`] - ln(larger / smaller)) over [`ORDER_WIDTH`] for each order;
//! - ln(found / assumed) over [`ASSUMED_WIDTH`] for each value without a number in the text, over
//!   [`FREE_WIDTH`] for the break-away distances of elements 1 and 2.
//!
//! The moves of section 4 are simulated without sensor noise. Not fitted, since the text has
//! nothing that determines them: Stribeck velocity and bristle damping over bristle stiffness,
//! which are those of the catalogue's guide 1.

use std::f64::consts::PI;

use serde::Serialize;

use super::dahl::{AMPLITUDES, AREA_FROM};
use super::fast_move::{FastMove, fast_move};
use super::fine_step::{FineStep, fine_step};
use super::least_squares::{FitError, minimise};
use super::specimen::{LabError, Settings, Specimen};
use super::statements::STATED_STIFFNESS;
use friction_stage_core::control::{ControllerSettings, Gains};
use friction_stage_core::model::{EffectParameters, Guide, ModelError, StageModel};

/// Width of a stated number, relative: half a unit of the second digit of 4.5e5.
pub const STATED_WIDTH: f64 = 0.011;
/// An order counts as met from this ratio on, as a logarithm, and its width. Assumed: the sensor
/// noise, which the fit leaves out, changes settling times by 1 % and the damping of a loop of
/// 300 nm by up to 4 %.
pub const ORDER_MARGIN: f64 = 0.05;
/// See [`ORDER_MARGIN`].
pub const ORDER_WIDTH: f64 = 0.005;
/// Width of an assumed value, as a logarithm: a factor of 1.5. Assumed: the catalogue gives orders
/// of magnitude.
pub const ASSUMED_WIDTH: f64 = 0.405;
/// Width of a break-away distance between 10 nm and 1 µm, as a logarithm: a factor of 10 around
/// their geometric mean.
pub const FREE_WIDTH: f64 = 2.303;
/// Rest before the moves, s. Without noise a longer one changes nothing.
const REST: f64 = 1.0;

/// One datum of the fit with how it is met.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PaperDatum {
    /// Section of the paper; of an assumed value, the guide of the catalogue.
    pub section: &'static str,
    /// What it says, with the unit.
    pub what: &'static str,
    /// How it enters the objective.
    pub kind: DatumKind,
    /// What the fitted guides have.
    pub found: f64,
    /// Stated or assumed number; of an order, what `found` is to exceed.
    pub wanted: f64,
}

/// How a datum enters the objective.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum DatumKind {
    /// A number of the text.
    Stated,
    /// `found` is larger than `wanted`.
    Order,
    /// A value of the catalogue without a number in the text.
    Assumed,
    /// A size that the catalogue does not know either, but for the range around `wanted`.
    Free,
}

impl PaperDatum {
    /// Its term of the objective, before squaring.
    pub fn residual(&self) -> f64 {
        let ratio = (self.found / self.wanted).ln();
        match self.kind {
            DatumKind::Stated => ratio / STATED_WIDTH,
            DatumKind::Order if ratio > ORDER_MARGIN => 0.0,
            DatumKind::Order => (ORDER_MARGIN - ratio) / ORDER_WIDTH,
            DatumKind::Assumed => ratio / ASSUMED_WIDTH,
            DatumKind::Free => ratio / FREE_WIDTH,
        }
    }
}

/// A guide with its parallel bristle elements.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ElementGuide {
    /// Stiffness (N/m) and break-away distance (m) of each element.
    pub elements: Vec<(f64, f64)>,
    /// Viscous friction sigma2, N s/m.
    pub viscous_friction: f64,
    /// Coulomb friction Fc, N.
    pub coulomb_force: f64,
    /// Stribeck velocity vs, m/s.
    pub stribeck_velocity: f64,
    /// sigma1 / sigma0 of each element, s.
    pub damping_time: f64,
}

impl ElementGuide {
    /// Static friction Fs, N.
    pub fn static_force(&self) -> f64 {
        self.elements.iter().map(|(stiffness, distance)| stiffness * distance).sum()
    }

    /// Stiffness of a slow loop of this amplitude (m), N/m.
    pub fn effective_stiffness(&self, amplitude: f64) -> f64 {
        self.elements
            .iter()
            .map(|(stiffness, distance)| stiffness * distance * (amplitude / distance).tanh())
            .sum::<f64>()
            / amplitude
    }

    /// Damping ratio of a slow loop of this amplitude (m): area over 2 pi k A^2.
    pub fn damping(&self, amplitude: f64) -> f64 {
        let area = |&(stiffness, distance): &(f64, f64)| {
            4.0 * stiffness * distance * (amplitude - distance * (amplitude / distance).tanh())
        };
        self.elements.iter().map(area).sum::<f64>()
            / (2.0 * PI * self.effective_stiffness(amplitude) * amplitude * amplitude)
    }

    /// The parameters of the guide and of the effect that belongs to it.
    pub fn parameters(&self) -> (Guide, EffectParameters) {
        let stiffness: f64 = self.elements.iter().map(|(stiffness, _)| stiffness).sum();
        let static_force = self.static_force();
        let share = |index: usize| {
            let (part, distance) = self.elements.get(index).copied().unwrap_or((0.0, 0.0));
            (part / stiffness, part * distance / static_force)
        };
        let effect = EffectParameters::parallel_bristles([0, 1, 2].map(share));
        let guide = Guide {
            stiffness,
            bristle_damping: self.damping_time * stiffness,
            viscous_friction: self.viscous_friction,
            coulomb_force: self.coulomb_force,
            static_force,
            stribeck_velocity: self.stribeck_velocity,
            stribeck_exponent: None,
            damping_velocity: None,
        };
        (guide, effect)
    }

    fn specimen(&self, name: &str) -> Result<Specimen, ModelError> {
        let (guide, effect) = self.parameters();
        let stage = StageModel { effects: vec![effect], ..StageModel::on_guides(name) };
        Ok(Specimen::of_model(&stage.without_noise())?.with_guide(guide))
    }
}

/// The fitted guides 1, 2 and 3 with what they were fitted to.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PaperFit {
    /// Guides 1, 2 and 3 in this order.
    pub guides: [ElementGuide; 3],
    /// Each datum with how it is met.
    pub data: Vec<PaperDatum>,
    /// Sum of the squared residuals.
    pub objective: f64,
}

/// A fit without a result.
#[derive(Debug, thiserror::Error)]
pub enum PaperFitError {
    /// A guide or a move that cannot be simulated.
    #[error(transparent)]
    Lab(#[from] LabError),
    /// A search without a minimum.
    #[error(transparent)]
    Search(#[from] FitError),
}

/// Fits the three guides; minutes of computing time.
pub fn fit_paper() -> Result<PaperFit, PaperFitError> {
    let assumed = Assumed::of_catalogue()?;
    let start = assumed.start();
    let residuals = |parameters: &[f64]| -> Vec<f64> {
        let found = data(&assumed.guides(parameters), &assumed);
        // A move that cannot be made is no place to search.
        found.map_or(vec![f64::NAN], |data| data.iter().map(PaperDatum::residual).collect())
    };
    let minimum = minimise(&start, &residuals)?;
    let guides = assumed.guides(&minimum.parameters);
    let data = data(&guides, &assumed)?;
    Ok(PaperFit { guides, data, objective: minimum.cost })
}

/// What the catalogue assumes where the paper has no number.
struct Assumed {
    one: Guide,
    three: Guide,
    /// Break-away distances of the first two elements, m.
    first: [f64; 2],
}

impl Assumed {
    fn of_catalogue() -> Result<Assumed, LabError> {
        let guide = |name| Specimen::of_guide(name)?.guide();
        let [(ten_nm, _), (one_um, _), _] = STATED_STIFFNESS;
        // Two elements make the stiffness fall between these amplitudes: evenly in the logarithm.
        let first = [1.0, 2.0].map(|third| ten_nm * (one_um / ten_nm).powf(third / 3.0));
        Ok(Assumed { one: guide("guide_1")?, three: guide("guide_3")?, first })
    }

    /// Fs / Fc - 1.
    fn fall(guide: &Guide) -> f64 {
        guide.static_force / guide.coulomb_force - 1.0
    }

    /// Fs of guide 3 over that of guide 1, less 1.
    fn excess(&self) -> f64 {
        self.three.static_force / self.one.static_force - 1.0
    }

    /// Logarithms of everything that is fitted.
    fn start(&self) -> Vec<f64> {
        let [(_, smallest), (_, small), (large_amplitude, large)] = STATED_STIFFNESS;
        let seals = small - SMALL_STIFFNESS_OF_GUIDE_2;
        let rolling = SMALL_STIFFNESS_OF_GUIDE_2;
        [
            0.5 * (smallest - small),
            self.first[0],
            0.5 * (smallest - small),
            self.first[1],
            rolling,
            0.25 * large * large_amplitude / rolling,
            seals,
            SEAL_FORCE / seals,
            Assumed::fall(&self.one),
            self.one.viscous_friction,
            self.excess(),
            Assumed::fall(&self.three),
            self.three.viscous_friction,
        ]
        .map(f64::ln)
        .to_vec()
    }

    /// Guides 1, 2 and 3 of such logarithms.
    fn guides(&self, parameters: &[f64]) -> [ElementGuide; 3] {
        let of = |index: usize| parameters[index].exp();
        let rolling = [(of(0), of(1)), (of(2), of(3)), (of(4), of(5))];
        let seals = (of(6), of(7));
        let guide = |elements: Vec<(f64, f64)>, fall: f64, viscous_friction: f64| {
            let plain = ElementGuide {
                elements,
                viscous_friction,
                coulomb_force: 0.0,
                stribeck_velocity: self.one.stribeck_velocity,
                damping_time: self.one.bristle_damping / self.one.stiffness,
            };
            ElementGuide { coulomb_force: plain.static_force() / (1.0 + fall), ..plain }
        };
        let with = |seals: (f64, f64)| rolling.into_iter().chain([seals]).collect();
        let one = guide(with(seals), of(8), of(9));
        let two = guide(rolling.to_vec(), 0.0, of(9));
        let more = of(10) * one.static_force() / seals.0;
        let three = guide(with((seals.0, seals.1 + more)), of(11), of(12));
        [one, two, three]
    }
}

/// N/m at 1 µm (section 3).
const SMALL_STIFFNESS_OF_GUIDE_2: f64 = 2.6e5;
/// N (section 3).
const SEAL_FORCE: f64 = 12.0;
/// Largest amplitude of a loop, m (Figure 4).
const LARGEST: f64 = 420e-6;

/// What section 4 compares of a guide.
struct Moves {
    /// Largest error of the fast move and its rms between 25 and 150 ms, m.
    peak: f64,
    wave: f64,
    /// Times from the arrival into 10, 1, 0.1 and 0.03 µm, s.
    into: [f64; 4],
    /// Largest error of the fine step, m, and time into 0.1 µm, s.
    fine_peak: f64,
    fine_into: f64,
}

/// Time from `arrival` (s) until |error| (m) stays within `band`, s, interpolated between samples.
fn settled(points: &[(f64, f64)], arrival: f64, band: f64) -> f64 {
    let Some(last) = points.iter().rposition(|(_, error)| error.abs() > band) else { return 0.0 };
    let (time, error) = points[last];
    let Some((next_time, next_error)) = points.get(last + 1) else { return f64::NAN };
    let (outside, inside) = (error.abs(), next_error.abs());
    (time + (next_time - time) * (outside - band) / (outside - inside) - arrival).max(0.0)
}

fn moves(of: &ElementGuide, name: &str) -> Result<Moves, LabError> {
    let specimen = of.specimen(name)?;
    let settings = Settings::default();
    let (fast, _): (FastMove, _) = fast_move(&specimen, &settings, REST, false)?;
    let (fine, _): (FineStep, _) = fine_step(&specimen, &settings, REST, false)?;
    let into = [10e-6, 1e-6, 0.1e-6, 30e-9];
    let step = fine.steps.first().map_or(f64::NAN, |step| step.peak_error);
    Ok(Moves {
        peak: fast.forward.peak_error,
        wave: fast.wave_rms,
        into: into.map(|band| settled(&fast.points, super::paper::FAST.1, band)),
        fine_peak: step,
        fine_into: settled(&fine.points, super::paper::FINE.1, 0.1e-6),
    })
}

/// Every datum with what these guides have.
fn data(guides: &[ElementGuide; 3], assumed: &Assumed) -> Result<Vec<PaperDatum>, LabError> {
    let [one, two, three] = guides;
    let [m1, m2, m3] = {
        let found: Result<Vec<Moves>, LabError> =
            guides.iter().zip(Specimen::PAPER_GUIDES).map(|(of, name)| moves(of, name)).collect();
        <[Moves; 3]>::try_from(found?).unwrap_or_else(|_| unreachable!("three guides"))
    };
    let gain =
        Gains::from_bandwidth(ControllerSettings::PAPER_BANDWIDTH, StageModel::default().mass).p;
    let mut data = Vec::new();
    let mut add = |section, what, kind, found, wanted| {
        data.push(PaperDatum { section, what, kind, found, wanted });
    };
    use DatumKind::{Assumed as Silent, Free, Order, Stated};
    let [ten_nm, one_um, forty_um] = STATED_STIFFNESS;
    let stiffness =
        |of: &ElementGuide, (amplitude, _): (f64, f64)| of.effective_stiffness(amplitude);
    add("3", "stiffness of guide 1 at 10 nm, N/m", Stated, stiffness(one, ten_nm), ten_nm.1);
    add("3", "stiffness of guide 1 at 1 µm, N/m", Stated, stiffness(one, one_um), one_um.1);
    add("3", "stiffness of guide 1 at 40 µm, N/m", Stated, stiffness(one, forty_um), forty_um.1);
    let small = stiffness(two, one_um);
    add("3", "stiffness of guide 2 at 1 µm, N/m", Stated, small, SMALL_STIFFNESS_OF_GUIDE_2);
    let [force_1, force_2, force_3] = [one, two, three].map(ElementGuide::static_force);
    add(
        "3",
        "break-away of guide 1 less that of guide 2, N",
        Stated,
        force_1 - force_2,
        SEAL_FORCE,
    );
    let reached = |of: &ElementGuide| stiffness(of, forty_um) * forty_um.0 / of.static_force();
    add("3", "at 40 µm guide 2 has broken away: part of Fs", Order, reached(two), 0.95);
    add("3", "at 40 µm guide 1 has not: part of Fs", Order, 0.95, reached(one));
    add("3", "at 40 µm guide 3 has not: part of Fs", Order, 0.95, reached(three));
    add(
        "2",
        "guide 2 has much lower static friction: half of guide 1's, N",
        Order,
        0.5 * force_1,
        force_2,
    );
    add("2", "guide 3 has the highest static friction, N", Order, force_3, force_1);
    add(
        "3",
        "stiffness of guide 1 at the smallest displacements, N/m",
        Stated,
        one.elements.iter().map(|x| x.0).sum(),
        ten_nm.1,
    );
    // Below 200 nm no rig resolves the area of a loop.
    let of_loops = AMPLITUDES.into_iter().filter(|of| (AREA_FROM..=LARGEST).contains(of));
    let amplitudes: Vec<f64> = [ten_nm.0].into_iter().chain(of_loops).collect();
    for of in guides {
        for pair in amplitudes.windows(2) {
            let what = "smaller amplitudes have lower damping: ratio";
            add("3", what, Order, of.damping(pair[1]), of.damping(pair[0]));
        }
    }
    let [viscous, _, low] = guides.each_ref().map(|of| of.viscous_friction);
    add(
        "2",
        "guide 3 has low viscous friction: half of guide 1's, N s/m",
        Order,
        0.5 * viscous,
        low,
    );
    for of in [one, three] {
        add(
            "2",
            "guides 1 and 3 have a falling F(v): Fs over Fc",
            Order,
            of.static_force(),
            of.coulomb_force,
        );
    }
    let least = [one, two, three]
        .map(|of| 4.0 * stiffness(of, ten_nm))
        .into_iter()
        .fold(f64::INFINITY, f64::min);
    add(
        "4, fine step",
        "four bearings are stiffer than the proportional gain, N/m",
        Order,
        least,
        gain,
    );
    let fast = "4, fast move";
    add(fast, "guide 2 has the lowest peak error: guide 1, m", Order, m1.peak, m2.peak);
    add(fast, "guide 2 has the lowest peak error: guide 3, m", Order, m3.peak, m2.peak);
    add(
        fast,
        "guide 3 has the smallest rms from 25 to 150 ms: guide 1, m",
        Order,
        m1.wave,
        m3.wave,
    );
    add(
        fast,
        "guide 3 has the smallest rms from 25 to 150 ms: guide 2, m",
        Order,
        m2.wave,
        m3.wave,
    );
    // Times from the start of the move: guide 3 may be within 10 µm when the reference arrives.
    let from_start = |time: f64| super::paper::FAST.1 + time;
    add(
        fast,
        "guide 3 settles faster to 10 µm: guide 1, s",
        Order,
        from_start(m1.into[0]),
        from_start(m3.into[0]),
    );
    add(
        fast,
        "guide 3 settles faster to 10 µm: guide 2, s",
        Order,
        from_start(m2.into[0]),
        from_start(m3.into[0]),
    );
    // From one band to the next the others take less time than guide 3: they catch up.
    let step = |of: &Moves, coarse: usize| of.into[coarse + 1] - of.into[coarse];
    add(fast, "guide 1 catches up from 1 to 0.1 µm, s", Order, step(&m3, 1), step(&m1, 1));
    add(fast, "guide 1 catches up from 0.1 to 0.03 µm, s", Order, step(&m3, 2), step(&m1, 2));
    add(
        fast,
        "guide 2 catches up from 1 to 0.03 µm, s",
        Order,
        step(&m3, 1) + step(&m3, 2),
        step(&m2, 1) + step(&m2, 2),
    );
    add(fast, "guide 3 is last into 0.1 µm: guide 1, s", Order, m3.into[2], m1.into[2]);
    add(fast, "guide 3 is last into 0.1 µm: guide 2, s", Order, m3.into[2], m2.into[2]);
    let fine = "4, fine step";
    add(fine, "guide 2 has the lowest peak error: guide 1, m", Order, m1.fine_peak, m2.fine_peak);
    add(fine, "guide 3 has the highest peak error: guide 1, m", Order, m3.fine_peak, m1.fine_peak);
    add(fine, "guide 2 is first into 0.1 µm: guide 1, s", Order, m1.fine_into, m2.fine_into);
    add(fine, "guide 3 is last into 0.1 µm: guide 1, s", Order, m3.fine_into, m1.fine_into);
    let fall = |of: &ElementGuide| of.static_force() / of.coulomb_force - 1.0;
    for element in [0, 1] {
        let what = "break-away distance of elements 1 and 2, m";
        add("guide_1", what, Free, one.elements[element].1, (ten_nm.0 * one_um.0).sqrt());
    }
    add("guide_1", "Fs over Fc, less 1", Silent, fall(one), Assumed::fall(&assumed.one));
    add("guide_1", "viscous friction, N s/m", Silent, viscous, assumed.one.viscous_friction);
    add(
        "guide_3",
        "Fs over that of guide 1, less 1",
        Silent,
        force_3 / force_1 - 1.0,
        assumed.excess(),
    );
    add("guide_3", "Fs over Fc, less 1", Silent, fall(three), Assumed::fall(&assumed.three));
    add("guide_3", "viscous friction, N s/m", Silent, low, assumed.three.viscous_friction);
    Ok(data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use friction_stage_core::model::Catalogue;
    use rayon::prelude::*;

    /// The guides of the catalogue as logarithms of the fit's parameters.
    fn of_catalogue() -> Vec<f64> {
        let catalogue = Catalogue::builtin();
        let of = |name: &str| catalogue.distributed_bristles(name).unwrap();
        let ((one, effect), (three, _)) = (of("guide_1"), of("guide_3"));
        let shares = |kind: &str| -> Vec<f64> {
            let share = |element| format!("{kind}_share_{element}");
            let mut given: Vec<f64> =
                (1..=3).map(|i| effect.values[&share(i)].number().unwrap()).collect();
            given.push(1.0 - given.iter().sum::<f64>());
            given
        };
        let elements = shares("stiffness").into_iter().zip(shares("strength"));
        let mut parameters: Vec<f64> = elements
            .flat_map(|(a, b)| {
                let stiffness = a * one.stiffness;
                [stiffness, b * one.static_force / stiffness]
            })
            .collect();
        parameters.extend([
            Assumed::fall(&one),
            one.viscous_friction,
            three.static_force / one.static_force - 1.0,
            Assumed::fall(&three),
            three.viscous_friction,
        ]);
        parameters.into_iter().map(f64::ln).collect()
    }

    fn objective(data: &[PaperDatum]) -> f64 {
        data.iter().map(|datum| datum.residual().powi(2)).sum()
    }

    #[test]
    #[cfg_attr(debug_assertions, ignore = "a minute in the dev profile; runs with --release")]
    fn the_guides_of_the_catalogue_meet_every_datum_and_are_the_minimum() {
        let assumed = Assumed::of_catalogue().unwrap();
        let parameters = of_catalogue();
        let at = |parameters: &[f64]| data(&assumed.guides(parameters), &assumed).unwrap();
        let found = at(&parameters);
        for datum in &found {
            let limit = if datum.kind == DatumKind::Order { 0.2 } else { 1.0 };
            assert!(datum.residual().abs() < limit, "{datum:?}: {}", datum.residual());
        }
        let least = objective(&found);
        // The digits of the catalogue move the objective by less than this.
        let rounding = 0.02;
        (0..2 * parameters.len()).into_par_iter().for_each(|step| {
            let (index, shift) = (step / 2, if step % 2 == 0 { -0.02 } else { 0.02 });
            let mut beside = parameters.clone();
            beside[index] += shift;
            let there = objective(&at(&beside));
            assert!(there > least - rounding, "parameter {index}: {there} below {least}");
        });
    }

    #[test]
    fn a_datum_counts_as_its_kind_says() {
        let of = |kind, found, wanted| PaperDatum { section: "3", what: "", kind, found, wanted };
        assert!((of(DatumKind::Stated, 1.011, 1.0).residual() - 1.0).abs() < 0.01);
        assert!((of(DatumKind::Assumed, 1.5, 1.0).residual() - 1.0).abs() < 0.01);
        assert!((of(DatumKind::Free, 0.1, 1.0).residual() + 1.0).abs() < 0.01);
        // An order costs nothing once it is met with the margin, and grows with what is missing.
        assert_eq!(of(DatumKind::Order, 1.06, 1.0).residual(), 0.0);
        assert!((of(DatumKind::Order, 1.0, 1.0).residual() - 10.0).abs() < 0.01);
        assert!(of(DatumKind::Order, 0.9, 1.0).residual() > 30.0);
        assert!(of(DatumKind::Order, f64::NAN, 1.0).residual().is_nan(), "it was not found");
    }

    #[test]
    fn the_time_into_a_band_lies_between_two_samples() {
        // |error| falls by 1 per second from 5 at time 0.
        let points: Vec<(f64, f64)> =
            (0..10).map(|k| (f64::from(k), f64::from(5 - k).max(0.0))).collect();
        assert!((settled(&points, 1.0, 2.5) - 1.5).abs() < 1e-12);
        assert_eq!(settled(&points, 4.0, 2.5), 0.0);
        assert_eq!(settled(&points, 0.0, 9.0), 0.0);
        assert!(settled(&points[..3], 0.0, 1.0).is_nan(), "it never comes there");
    }

    #[test]
    fn stiffness_and_damping_of_one_element_are_those_of_its_bristle() {
        let of = ElementGuide {
            elements: vec![(4.5e5, 3e-5)],
            viscous_friction: 18.0,
            coulomb_force: 10.0,
            stribeck_velocity: 5e-3,
            damping_time: 2e-3,
        };
        let (guide, _) = of.parameters();
        for amplitude in [1e-6f64, 4e-5] {
            let stiffness = guide.effective_stiffness(amplitude);
            let damping = guide.loop_area(amplitude) / (2.0 * PI * stiffness * amplitude.powi(2));
            assert!((of.effective_stiffness(amplitude) / stiffness - 1.0).abs() < 1e-12);
            assert!((of.damping(amplitude) / damping - 1.0).abs() < 1e-9);
        }
    }
}
