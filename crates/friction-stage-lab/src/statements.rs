//! The paper's statements beside what the stage shows: one row each, holds or not.
//!
//! In come the reduced results of the experiments on guides 1, 2 and 3, out go rows with the
//! figures in them. Limits for words like "roughly" are in the rows' texts.

use serde::Serialize;

use super::dahl::{DahlCurves, HysteresisLoop};
use super::distributed_fit::DistributedFit;
use super::fast_move::FastMove;
use super::fine_step::FineStep;
use super::frequency_response::FrequencyResponse;
use super::hunting::HuntingResult;
use super::rig::RigBias;
use super::stribeck::StribeckCurve;

/// One statement of the paper.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Statement {
    /// Section of the paper.
    pub section: &'static str,
    /// What the paper says, with the limit that it is held to.
    pub paper: &'static str,
    /// What the stage shows, in figures.
    pub stage: String,
    /// Whether the figures are within that limit.
    pub holds: bool,
    /// Why it does not hold, where the reason is known.
    pub reason: Option<&'static str>,
}

/// Results on guides 1, 2, 3, in this order.
#[derive(Clone, Copy, Debug)]
pub struct PaperResults<'a> {
    /// What the guides are: `lugre` or `lugre + distributed_bristles`.
    pub model: &'static str,
    /// Friction over constant velocity.
    pub stribeck: [&'a StribeckCurve; 3],
    /// Hysteresis loops.
    pub dahl: [&'a DahlCurves; 3],
    /// Guide 1 with distributed bristles.
    pub distributed: &'a DahlCurves,
    /// Stage under a sinusoidal force.
    pub response: [&'a FrequencyResponse; 3],
    /// Fast move without viscous feedforward.
    pub fast: [&'a FastMove; 3],
    /// With viscous feedforward.
    pub fast_fed: [&'a FastMove; 3],
    /// Fine steps without viscous feedforward.
    pub fine: [&'a FineStep; 3],
    /// Motion at rest per bandwidth and integral gain.
    pub hunting: [&'a [HuntingResult]; 3],
    /// Of guide 1.
    pub rig: &'a [RigBias],
}

/// Why one bristle misses stiffnesses that several meet.
const SINGLE: &str = "one bristle has k = Fs tanh(sigma0 A/Fs)/A: two stiffnesses fix the third; \
                      see distributed bristles";

/// Effective stiffnesses of guide 1 that the paper states: amplitude (m) and stiffness (N/m).
pub const STATED_STIFFNESS: [(f64, f64); 3] = [(10e-9, 7.5e5), (1e-6, 4.5e5), (40e-6, 2.3e5)];

/// A stated stiffness compared with one bristle and several: relative errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StiffnessError {
    /// m
    pub amplitude: f64,
    /// N/m, by the paper.
    pub stated: f64,
    /// Measured less stated over stated, on the catalogue's bristle.
    pub catalogue: f64,
    /// The same of the single bristle that fits best, in closed form.
    pub best_single: f64,
    /// The same as measured on the distributed bristles.
    pub distributed: f64,
}

/// The loop at this amplitude, m: the one nearest in ratio.
pub fn loop_at(curves: &DahlCurves, amplitude: f64) -> Option<&HysteresisLoop> {
    let distance = |of: &&HysteresisLoop| (of.amplitude / amplitude).ln().abs();
    curves
        .loops
        .iter()
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        .filter(|found| distance(found) < 0.2)
}

/// Stiffness at an amplitude (m) between the loops, N/m: straight in the logarithms; outside of the
/// loops that of the nearest one.
fn stiffness_along(curves: &DahlCurves, amplitude: f64) -> f64 {
    let at = |index: usize| {
        curves.loops.get(index).map(|found| (found.amplitude.ln(), found.stiffness.value.ln()))
    };
    let above = curves.loops.partition_point(|found| found.amplitude < amplitude);
    let logarithm = match (above.checked_sub(1).and_then(at), at(above)) {
        (Some((a, k)), Some((b, l))) => k + (l - k) * (amplitude.ln() - a) / (b - a),
        (Some((_, k)), None) | (None, Some((_, k))) => k,
        (None, None) => f64::NAN,
    };
    logarithm.exp()
}

/// Errors at the three stated amplitudes before and after; `single` is the best single bristle's
/// sigma0, N/m.
pub fn stiffness_errors(
    single: &DahlCurves,
    distributed: &DahlCurves,
    best: f64,
    static_force: f64,
) -> Vec<StiffnessError> {
    let error = |curves, amplitude, stated: f64| {
        loop_at(curves, amplitude).map(|found| found.stiffness.value / stated - 1.0)
    };
    // Amplitudes that were measured.
    let of = |&(amplitude, stated): &(f64, f64)| {
        Some(StiffnessError {
            amplitude,
            stated,
            catalogue: error(single, amplitude, stated)?,
            best_single: static_force * (best * amplitude / static_force).tanh()
                / amplitude
                / stated
                - 1.0,
            distributed: error(distributed, amplitude, stated)?,
        })
    };
    STATED_STIFFNESS.iter().filter_map(of).collect()
}

/// The fit of three bristles to guide 1's stated stiffnesses under a static friction, N.
pub fn fit_stated(static_force: f64) -> Result<DistributedFit, super::NoDistributedFit> {
    super::fit_distributed(STATED_STIFFNESS, static_force)
}

/// Every statement, in the order of the paper.
pub fn statements(of: &PaperResults) -> Vec<Statement> {
    let mut rows = Vec::new();
    // The reasons are about one bristle per guide.
    let mut add = |section, paper, stage: String, holds: bool, reason: Option<&'static str>| {
        let why = |_: &&str| !holds && of.model == "lugre";
        rows.push(Statement { section, paper, stage, holds, reason: reason.filter(why) });
    };
    let [one, two, three] = of.stribeck;
    let stiffness = |curves: &DahlCurves, amplitude| {
        loop_at(curves, amplitude).map_or(f64::NAN, |found| found.stiffness.value)
    };
    let tip = |curves: &DahlCurves, amplitude| {
        loop_at(curves, amplitude).map_or(f64::NAN, |found| found.tip_force.value)
    };
    // Section 1
    if let Some(row) = of.rig.iter().find(|row| row.property == "coupling" && row.value == 100.0) {
        add(
            "1.2",
            "a coupling about 100 times as stiff as the guide leaves the measurement alone (within \
             2 %)",
            format!(
                "stiffness at 1 µm {:+.2} % with the encoder at the guide, {:+.2} % behind the \
                 coupling",
                100.0 * row.stiffness_bias,
                100.0 * row.stiffness_bias_at_motor
            ),
            row.stiffness_bias.abs() < 0.02 && row.stiffness_bias_at_motor.abs() < 0.02,
            None,
        );
    }
    // Section 2
    let slow = [one, two, three].map(|curve| curve.slow_force.value);
    let forces =
        |values: [f64; 3]| format!("{:.2}, {:.2}, {:.2} N", values[0], values[1], values[2]);
    add(
        "2",
        "at very low velocity the guide without seals (2) has much lower friction (less than half)",
        format!("{} at 0.1 mm/s", forces(slow)),
        slow[1] < 0.5 * slow[0] && slow[1] < 0.5 * slow[2],
        None,
    );
    add(
        "2",
        "low-friction grease (3) has the highest static friction",
        format!("{} at 0.1 mm/s", forces(slow)),
        slow[2] > slow[0] && slow[2] > slow[1],
        None,
    );
    let slopes = [one, two, three].map(|curve| curve.viscous_slope);
    let levels = [one, two, three].map(|curve| curve.viscous_level);
    add(
        "2",
        "at high velocity guides 1 and 2 have roughly the same slope (within 10 %) at different \
         force levels",
        format!(
            "{:.2} and {:.2} N s/m at levels of {:.2} and {:.2} N",
            slopes[0], slopes[1], levels[0], levels[1]
        ),
        (slopes[0] / slopes[1] - 1.0).abs() < 0.1 && (levels[0] / levels[1] - 1.0).abs() > 0.2,
        None,
    );
    add(
        "2",
        "guide 3 has low viscous friction (less than half of guide 1's)",
        format!("{:.2} against {:.2} N s/m", slopes[2], slopes[0]),
        slopes[2] < 0.5 * slopes[0],
        None,
    );
    add(
        "2",
        "guides 1 and 3 have a falling F(v) at low velocity, guide 2 has not",
        format!(
            "from 0.1 mm/s to the least force: {:+.1} %, {:+.1} %, {:+.1} %",
            100.0 * (one.least_force.value / slow[0] - 1.0),
            100.0 * (two.least_force.value / slow[1] - 1.0),
            100.0 * (three.least_force.value / slow[2] - 1.0)
        ),
        one.falls && three.falls && !two.falls,
        None,
    );
    let hunts =
        of.hunting.map(|results| results.iter().filter(|result| result.cycle.is_some()).count());
    let reported = |results: &[HuntingResult]| {
        let at: Vec<String> = results
            .iter()
            .filter_map(|r| {
                let cycle = r.cycle?;
                let amplitude = 1e3 * cycle.amplitude;
                Some(format!(
                    "{} Hz x{} ({amplitude:.1} mm, {:.1} s)",
                    r.bandwidth, r.integral, cycle.period
                ))
            })
            .collect();
        if at.is_empty() { "with none".to_owned() } else { format!("with {}", at.join(", ")) }
    };
    add(
        "2",
        "guides 1 and 3 are more vulnerable to limit cycling with integral control than guide 2",
        format!(
            "bandwidth x integral gain (amplitude, period): guide 1 {}; guide 2 {}; guide 3 {}",
            reported(of.hunting[0]),
            reported(of.hunting[1]),
            reported(of.hunting[2])
        ),
        hunts[0] > hunts[1] && hunts[2] > hunts[1],
        None,
    );
    // Section 3
    for (index, (amplitude, stated)) in STATED_STIFFNESS.into_iter().enumerate() {
        let found = stiffness(of.dahl[0], amplitude);
        let paper = [
            "effective stiffness of guide 1 at 10 nm: 7.5e5 N/m (within 5 %)",
            "effective stiffness of guide 1 at 1 µm: 4.5e5 N/m (within 5 %)",
            "effective stiffness of guide 1 at 40 µm: 2.3e5 N/m (within 5 %)",
        ][index];
        let error = 100.0 * (found / stated - 1.0);
        add(
            "3",
            paper,
            format!("{}: {found:.3e} N/m, {error:+.1} %", of.model),
            error.abs() < 5.0,
            Some(SINGLE),
        );
    }
    let with: Vec<(f64, f64)> = STATED_STIFFNESS
        .iter()
        .map(|&(amplitude, stated)| (stiffness(of.distributed, amplitude), stated))
        .collect();
    add(
        "3",
        "all three stiffnesses of guide 1 (7.5e5, 4.5e5, 2.3e5 N/m), each within 2 %",
        format!(
            "lugre + distributed_bristles: {}",
            with.iter()
                .map(|(found, stated)| format!(
                    "{found:.3e} ({:+.1} %)",
                    100.0 * (found / stated - 1.0)
                ))
                .collect::<Vec<_>>()
                .join(", ")
        ),
        with.iter().all(|(found, stated)| (found / stated - 1.0).abs() < 0.02),
        None,
    );
    let at_1um = of.dahl.map(|curves| stiffness(curves, 1e-6));
    add(
        "3",
        "effective stiffness of guide 2 at 1 µm: 2.6e5 N/m (within 5 %)",
        format!("{:.3e} N/m, {:+.1} %", at_1um[1], 100.0 * (at_1um[1] / 2.6e5 - 1.0)),
        (at_1um[1] / 2.6e5 - 1.0).abs() < 0.05,
        None,
    );
    add(
        "3",
        "the lubricant barely changes the stiffness at 1 µm (guides 1 and 3 within 5 %)",
        format!("{:.3e} and {:.3e} N/m", at_1um[0], at_1um[2]),
        (at_1um[2] / at_1um[0] - 1.0).abs() < 0.05,
        None,
    );
    let break_away = of.dahl.map(|curves| tip(curves, 420e-6));
    add(
        "3",
        "without seals the break-away force is about 12 N lower (within 1 N)",
        format!(
            "{:.2} N lower: {:.2} against {:.2} N at 420 µm",
            break_away[0] - break_away[1],
            break_away[1],
            break_away[0]
        ),
        (break_away[0] - break_away[1] - 12.0).abs() < 1.0,
        None,
    );
    let reached = of.dahl.map(|curves| tip(curves, 40e-6) / tip(curves, 420e-6));
    add(
        "3",
        "at 40 µm guide 2 has exceeded its break-away force (95 % of it), guides 1 and 3 have not",
        format!(
            "force at 40 µm over force at 420 µm: {:.2}, {:.2}, {:.2}",
            reached[0], reached[1], reached[2]
        ),
        reached[1] > 0.95 && reached[0] < 0.95 && reached[2] < 0.95,
        None,
    );
    let falling = of.dahl.iter().chain([&of.distributed]).all(|curves| {
        curves.loops.windows(2).all(|pair| {
            let noise = pair[0].stiffness.standard_error.hypot(pair[1].stiffness.standard_error);
            pair[1].stiffness.value
                < pair[0].stiffness.value + 3.0 * noise + 0.005 * pair[0].stiffness.value
        })
    });
    let resolved = |curves: &DahlCurves| -> Vec<f64> {
        let pairs = curves.loops.iter().zip(&curves.resonances);
        pairs
            .filter(|(found, _)| found.area_is_resolved)
            .map(|(_, resonance)| resonance.damping.value)
            .collect()
    };
    let growing =
        of.dahl.iter().all(|curves| resolved(curves).is_sorted() && resolved(curves).len() > 3);
    let damping = resolved(of.dahl[0]);
    add(
        "3",
        "smaller amplitudes give higher effective stiffness and lower damping",
        format!(
            "guide 1: stiffness from {:.2e} (10 nm) to {:.2e} N/m (1 mm), damping ratio of the \
             loops from {:.3} to {:.2}",
            of.dahl[0].loops.first().map_or(f64::NAN, |found| found.stiffness.value),
            of.dahl[0].loops.last().map_or(f64::NAN, |found| found.stiffness.value),
            damping.first().copied().unwrap_or(f64::NAN),
            damping.last().copied().unwrap_or(f64::NAN)
        ),
        falling && growing,
        None,
    );
    let response = of.response[0];
    let low = response.levels[0].points[0];
    // The guides' stiffness depends on the amplitude: that of the stage's own motion.
    let dahl_stiffness = 4.0 * stiffness_along(of.dahl[0], low.amplitude)
        - response.mass * (2.0 * std::f64::consts::PI * low.frequency).powi(2);
    add(
        "3",
        "the stage's frequency response shows the guides' stiffness up to a frequency, and the \
         mass above (5 %)",
        format!(
            "{:.3e} N/m at {} Hz and {:.2} µm, from the loops {dahl_stiffness:.3e}; {:.2} kg above",
            low.stiffness.0,
            low.frequency,
            1e6 * low.amplitude,
            response.mass
        ),
        (low.stiffness.0 / dahl_stiffness - 1.0).abs() < 0.05
            && (response.mass / 40.0 - 1.0).abs() < 0.05,
        None,
    );
    // Section 4, fast move
    let um = |values: [f64; 3]| {
        format!("{:.1}, {:.1}, {:.1} µm", 1e6 * values[0], 1e6 * values[1], 1e6 * values[2])
    };
    let peaks = of.fast.map(|found| found.forward.peak_error);
    add(
        "4, fast move",
        "the guide without seals (2) has the lowest peak error",
        um(peaks),
        peaks[1] < peaks[0] && peaks[1] < peaks[2],
        None,
    );
    let wave = of.fast.map(|found| found.wave_rms);
    add(
        "4, fast move",
        "between 25 and 150 ms guide 3 has a small error (the smallest rms)",
        format!("rms {}", um(wave)),
        wave[2] < wave[0] && wave[2] < wave[1],
        None,
    );
    // What is left of the wave that viscous friction makes, in its middle: after the break-away has
    // been worked off.
    let middle = |found: &FastMove| {
        let part: Vec<f64> = found
            .points
            .iter()
            .filter(|(t, _)| *t > 0.05 && *t < 0.15)
            .map(|(_, error)| *error)
            .collect();
        let (low, high) = part
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), e| (low.min(*e), high.max(*e)));
        high - low
    };
    let (without, fed) = (of.fast.map(middle), of.fast_fed.map(middle));
    add(
        "4, fast move",
        "viscous feedforward removes the wave there (guides 1 and 2: peak to peak between 50 and \
         150 ms to less than a third)",
        format!("without {}; with {}", um(without), um(fed)),
        fed[0] < without[0] / 3.0 && fed[1] < without[1] / 3.0,
        None,
    );
    let into = |found: &FastMove, band: f64| {
        found
            .settling_over_band
            .iter()
            .find(|row| row.0 == band)
            .and_then(|row| row.1)
            .map(|time| 1e3 * time)
    };
    let ms = |values: [Option<f64>; 3]| {
        values.map(|value| value.map_or("never".to_owned(), |ms| format!("{ms:.0}"))).join(", ")
            + " ms"
    };
    let order = |values: [Option<f64>; 3]| values.map(|value| value.unwrap_or(f64::INFINITY));
    let coarse = of.fast.map(|found| into(found, 10e-6));
    let [a, b, c] = order(coarse);
    add(
        "4, fast move",
        "guide 3 initially settles faster (to 10 µm)",
        ms(coarse),
        c < a && c < b,
        None,
    );
    let bands = [10e-6, 1e-6, 0.1e-6, 30e-9].map(|band| of.fast.map(|found| into(found, band)));
    let lead = bands.map(|times| {
        let [a, b, c] = order(times);
        (a - c, b - c)
    });
    add(
        "4, fast move",
        "the other two catch up as the error becomes very small (their lag behind guide 3 shrinks)",
        format!(
            "lag of guides 1 and 2 at 1, 0.1, 0.03 µm: {:.0} and {:.0}, {:.0} and {:.0}, {:.0} and \
             {:.0} ms",
            lead[1].0, lead[1].1, lead[2].0, lead[2].1, lead[3].0, lead[3].1
        ),
        lead[3].0 < lead[2].0 && lead[2].0 < lead[1].0 && lead[3].1 < lead[1].1,
        None,
    );
    let fine_band = bands[2];
    let [a, b, c] = order(fine_band);
    add(
        "4, fast move",
        "guide 3 reaches the required position last (to 0.1 µm)",
        ms(fine_band),
        c > a && c > b,
        Some(
            "guide 2 does overtake it; guide 1 does not above 30 nm: once at rest every sealed \
             guide creeps with the same time constant, (p + k)/i, and guide 1 starts that creep \
             with the larger error that its viscous friction leaves. Higher Coulomb friction of \
             guide 3 with less viscous friction of guide 1 turns the order round, but then guide 3 \
             has no longer the smallest error between 25 and 150 ms",
        ),
    );
    // Section 4, fine step
    let gain = of.fine[0].proportional_gain;
    let guides = of.dahl.map(|curves| 4.0 * stiffness(curves, 10e-9));
    add(
        "4, fine step",
        "the bearing stiffness exceeds the proportional gain of the controller (four guides)",
        format!(
            "{}: {:.2e}, {:.2e}, {:.2e} against {gain:.2e} N/m",
            of.model, guides[0], guides[1], guides[2]
        ),
        guides.iter().all(|stiffness| *stiffness > gain),
        Some(
            "the catalogue meets the stiffness at 1 µm; one bristle cannot have the higher one at \
             10 nm as well. The paper gives no gains: a 60 Hz PID by the usual rules of thumb has \
             this one",
        ),
    );
    let distributed = 4.0 * stiffness(of.distributed, 10e-9);
    add(
        "4, fine step",
        "the same for guide 1 with the small-displacement stiffness that the paper states",
        format!("lugre + distributed_bristles: {distributed:.2e} against {gain:.2e} N/m"),
        distributed > gain,
        None,
    );
    let first = |found: &FineStep| found.steps.first().copied();
    let peaks = of.fine.map(|found| first(found).map_or(f64::NAN, |step| step.peak_error));
    add(
        "4, fine step",
        "guide 2 has the lowest peak error",
        format!("{:.2}, {:.2}, {:.2} µm", 1e6 * peaks[0], 1e6 * peaks[1], 1e6 * peaks[2]),
        peaks[1] < peaks[0] && peaks[1] < peaks[2],
        None,
    );
    let settled =
        of.fine.map(|found| first(found).and_then(|step| step.settling[2]).map(|time| 1e3 * time));
    let [a, b, c] = order(settled);
    add("4, fine step", "guide 2 settles first (to 0.1 µm)", ms(settled), b < a && b < c, None);
    add(
        "4, fine step",
        "guide 3 has the worst performance",
        format!("peak {:.2} µm, {} into 0.1 µm", 1e6 * peaks[2], ms(settled)),
        peaks[2] > peaks[0] && peaks[2] > peaks[1] && c > a && c > b,
        None,
    );
    rows
}

#[cfg(test)]
mod tests {
    use super::super::specimen::MeasuredValue;
    use super::*;

    #[test]
    fn stiffness_between_two_loops_lies_on_their_power_law() {
        let exact = |value| MeasuredValue { value, standard_error: 0.0 };
        let of = |amplitude: f64| HysteresisLoop {
            amplitude,
            stiffness: exact(3.0 * amplitude.powf(-0.5)),
            area: exact(0.0),
            area_is_resolved: true,
            tip_force: exact(0.0),
            points: Vec::new(),
        };
        let loops = [1e-8, 1e-7, 1e-6].map(of).to_vec();
        let curves = DahlCurves { name: String::new(), loops, resonances: Vec::new() };
        let power = |amplitude: f64| 3.0 * amplitude.powf(-0.5);
        for (amplitude, at) in [(3e-8, 3e-8), (1e-7, 1e-7), (5e-7, 5e-7), (1e-9, 1e-8), (1.0, 1e-6)]
        {
            let found = stiffness_along(&curves, amplitude);
            assert!((found / power(at) - 1.0).abs() < 1e-9, "{amplitude}: {found}");
        }
    }
}
