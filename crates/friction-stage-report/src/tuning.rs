//! The report of a tuning: table, page with Bode plots, step and moves, and parameter files.

use std::fmt::Write as _;

use serde_json::{Value, json};

use friction_stage_core::control::ControllerSettings;
use friction_stage_core::model::{JointType, StageModel};
use friction_stage_core::plant::Rates;
use friction_stage_lab::{
    Application, Conditioning, LoopPoint, LoopResponse, Margins, MeasuredLoopPoint, MoveKind,
    PaperMotion, SampledStage, Settings, StageMotion, Tuned, Tuning, break_away, errors_along,
    loop_frequencies, measure_loop, settling, step_response,
};

use crate::chart::{Axis, Chart, Style};
use crate::figure::svg;
use crate::measured_loop::MeasuredReport;
use crate::page::{Align, Cell, Mark, Page, Table, Tile};
use crate::paper_motion::{caption, position_error_charts};
use crate::words::{PAPER, in_prefix_short};

/// Why a page could not be made.
#[derive(Debug, thiserror::Error)]
pub enum TuningPageError {
    /// A figure that could not be drawn.
    #[error(transparent)]
    Figure(#[from] crate::figure::FigureError),
    /// A run that failed.
    #[error(transparent)]
    Tuning(#[from] friction_stage_lab::TuningError),
    /// A stage that cannot be analysed.
    #[error(transparent)]
    Model(#[from] friction_stage_core::model::ModelError),
    /// A measurement that failed.
    #[error(transparent)]
    Lab(#[from] friction_stage_lab::LabError),
    /// Rates that do not fit each other.
    #[error(transparent)]
    Rates(#[from] friction_stage_core::plant::RatesError),
}

/// Amplitudes that the page shows, in break-away distances.
const SHOWN: [(f64, &str); 3] = [(0.01, "sticking"), (1.0, "at break-away"), (100.0, "sliding")];
/// Size of the step, m, and what is seen of it, s.
const STEP: (f64, f64) = (1e-6, 0.1);
/// Rest before the moves of the paper, s.
const REST: f64 = Conditioning::VARIANT_REST;

/// The gains for other programs, with a measured loop if there is one.
pub fn tuning_json(tuning: &Tuning, measured: Option<&MeasuredReport>) -> Value {
    let tunings: Vec<Value> = tuning
        .tunings
        .iter()
        .map(|one| {
            let gains = one.settings.gains;
            json!({
                "name": one.name,
                "gains": {
                    "p": gains.p,
                    "i": gains.i,
                    "d": gains.d,
                    "lowpass_frequency": gains.lowpass_frequency,
                    "lowpass_damping": gains.lowpass_damping,
                },
                "worst": one.worst,
                "without_lowpass": one.without_lowpass,
                "nominal": one.nominal,
                "on_variants": one.on_variants,
            })
        })
        .collect();
    let mut summary = json!({
        "schema_version": 1,
        "objective": tuning.objective,
        "mass": tuning.mass,
        "rate": tuning.tunings[0].settings.rate,
        "improved": tuning.improved,
        "rule_keeps_margins": tuning.rule_keeps_margins,
        "tunings": tunings,
        "warnings": tuning_warnings(tuning, measured),
    });
    if let Some(measured) = measured {
        summary["measured"] = measured.json();
    }
    summary
}

/// What a user should know of the gains.
pub fn tuning_warnings(tuning: &Tuning, measured: Option<&MeasuredReport>) -> Vec<String> {
    let (rule, found) = (&tuning.tunings[0], tuning.found());
    let mut warnings = Vec::new();
    if !tuning.rule_keeps_margins {
        let state = if rule.worst.stable { "is stable" } else { "is unstable" };
        warnings.push(format!(
            "the rule of thumb {state} with a largest |S| of {:.1} dB on some of the guides and \
             amplitudes: it keeps no 6 dB, and what it reaches is no measure",
            rule.worst.peak_sensitivity_db()
        ));
    } else if !tuning.improved {
        warnings.push(
            "nothing better than the rule of thumb was found within the margins: its gains are \
             kept"
                .to_owned(),
        );
    }
    if !found.without_lowpass.stable || found.without_lowpass.modulus_margin < 0.5 {
        warnings.push(
            "without the lowpass, as ros2_control's controllers are, these gains do not keep 6 dB"
                .to_owned(),
        );
    }
    for one in &tuning.tunings[2..] {
        if one.worst.modulus_margin < 0.5 {
            warnings.push(format!(
                "{}: largest |S| is {:.1} dB, above 6 dB",
                one.name,
                one.worst.peak_sensitivity_db()
            ));
        }
    }
    if found.on_variants.saturated > 0 {
        warnings.push(format!(
            "the motor reaches its limit in {} of {} variants",
            found.on_variants.saturated, found.on_variants.variants
        ));
    }
    warnings.extend(measured.into_iter().flat_map(MeasuredReport::warnings));
    warnings
}

/// The result as text for a person.
pub fn tuning_text(tuning: &Tuning, joint: JointType) -> String {
    let mut out = String::new();
    // A string takes whatever is written.
    let _ = write_text(&mut out, tuning, joint);
    out
}

fn write_text(out: &mut String, tuning: &Tuning, joint: JointType) -> std::fmt::Result {
    let on = tuning.found().on_variants;
    writeln!(
        out,
        "{:16} {:>10} {:>12} {:>10} {:>8}   {:>9} {:>7} {:>8}   {:>16} {:>16}",
        "",
        joint.unit("p, N/m"),
        joint.unit("i, N/(m s)"),
        joint.unit("d, N s/m"),
        "lowpass",
        "max |S|",
        "phase",
        "gain",
        joint.unit("peak, µm"),
        "settled, ms"
    )?;
    for one in &tuning.tunings {
        let gains = one.settings.gains;
        let pair = |[median, q95]: [f64; 2], scale: f64| {
            let number = |value: f64| match value.is_finite() {
                true => format!("{:.3}", scale * value),
                false => "never".to_owned(),
            };
            format!("{} / {}", number(median), number(q95))
        };
        writeln!(
            out,
            "{:16} {:>10.4e} {:>12.4e} {:>10.4e} {:>5.0} Hz   {:>6.1} dB {:>6.0}° {:>8}   {:>16} \
             {:>16}",
            one.name,
            gains.p,
            gains.i,
            gains.d,
            gains.lowpass_frequency,
            one.worst.peak_sensitivity_db(),
            one.worst.phase_margin.unwrap_or(f64::NAN),
            decibel(one.worst.gain_margin),
            pair(one.on_variants.peak_error, 1e6),
            pair(one.on_variants.settling_time, 1e3),
        )?;
    }
    writeln!(
        out,
        "\nmargins: the least over guides within their tolerances and amplitudes; peak and \
         settling: median / 95 % of {} variants that the search did not see",
        on.variants
    )?;
    writeln!(out, "{}", verdict(tuning))
}

fn decibel(factor: Option<f64>) -> String {
    factor.map_or("any".to_owned(), |factor| format!("{:.1} dB", 20.0 * factor.log10()))
}

fn verdict(tuning: &Tuning) -> String {
    let on = tuning.found().on_variants;
    if !tuning.improved {
        return "the gains of the rule of thumb are the ones to take".to_owned();
    }
    let change = 100.0 * (1.0 - on.ratio);
    let (amount, word) = (change.abs(), if change >= 0.0 { "better" } else { "worse" });
    format!(
        "tuned: by {amount:.0} % {word} than the rule of thumb in the median of the variants, not \
         worse in {:.1} % of them",
        100.0 * on.not_worse
    )
}

/// A parameter file for `controller_node`.
pub fn controller_parameters(model: &StageModel, tuned: &Tuned) -> String {
    let ControllerSettings { rate, gains, limits, mass_feedforward, viscous_feedforward, .. } =
        &tuned.settings;
    let stroke = model.stroke.map_or_else(String::new, |stroke| {
        format!("    stroke_min: {:?}\n    stroke_max: {:?}\n", stroke.low, stroke.high)
    });
    format!(
        "# Gains of `friction-stage tune`: controller_node --ros-args --params-file THIS_FILE\n\
         # {}\n\
         /**/controller:\n  ros__parameters:\n    rate: {rate:?}\n    tuning: gains\n    \
         mass: {mass_feedforward:?}\n{stroke}    gains:\n      stage:\n        p: {:?}\n        \
         i: {:?}\n        d: {:?}\n        u_clamp_max: {:?}\n        u_clamp_min: {:?}\n        \
         antiwindup_strategy: conditional_integration\n    lowpass:\n      frequency: {:?}\n      \
         damping: {:?}\n    feedforward:\n      mass: {mass_feedforward:?}\n      \
         viscous: {viscous_feedforward:?}\n",
        margins_in_words(&tuned.worst),
        gains.p,
        gains.i,
        gains.d,
        limits.1,
        limits.0,
        gains.lowpass_frequency,
        gains.lowpass_damping,
    )
}

/// A parameter file for pid_controller and joint_trajectory_controller of ros2_control.
pub fn ros2_control_parameters(tuned: &Tuned) -> String {
    let ControllerSettings { rate, gains, limits, viscous_feedforward, .. } = &tuned.settings;
    let stage = |indent: &str| {
        format!(
            "{indent}p: {:?}\n{indent}i: {:?}\n{indent}d: {:?}\n{indent}u_clamp_max: {:?}\n\
             {indent}u_clamp_min: {:?}\n{indent}antiwindup_strategy: conditional_integration\n",
            gains.p, gains.i, gains.d, limits.1, limits.0
        )
    };
    let inner = stage("        ");
    format!(
        "# Gains of `friction-stage tune` for ros2_control. Its controllers have no lowpass behind \
         the PID\n# and no mass feedforward: {}.\n\
         controller_manager:\n  ros__parameters:\n    update_rate: {}\n\n\
         pid_controller:\n  ros__parameters:\n    dof_names: [stage]\n    \
         command_interface: effort\n    \
         reference_and_state_interfaces: [position]\n    gains:\n      stage:\n{inner}\n\
         joint_trajectory_controller:\n  ros__parameters:\n    joints: [stage]\n    \
         command_interfaces: [effort]\n    state_interfaces: [position, velocity]\n    \
         gains:\n      stage:\n{inner}        ff_velocity_scale: {viscous_feedforward:?}\n",
        margins_in_words(&tuned.without_lowpass),
        rate.round() as i64,
    )
}

fn margins_in_words(margins: &Margins) -> String {
    if !margins.stable {
        return "unstable on some of the guides within their tolerances".to_owned();
    }
    format!(
        "largest |S| {:.1} dB, phase margin {:.0} degrees over guides and amplitudes",
        margins.peak_sensitivity_db(),
        margins.phase_margin.unwrap_or(f64::NAN)
    )
}

/// Colours on the page, each with one meaning: of the controllers, the rule of thumb first; of the
/// amplitudes; of the model and of what is measured, where these are compared.
const CONTROLLERS: [usize; 3] = [1, 0, 6];
const AMPLITUDES: [usize; 3] = [2, 3, 5];
pub(crate) const COMPARED: [usize; 2] = [4, 7];

/// Colour of a controller by its place.
fn of_controller(index: usize) -> usize {
    CONTROLLERS[index % CONTROLLERS.len()]
}

/// What the gains are for, as names and values.
fn task(application: &Application, joint: JointType) -> [(&'static str, String); 4] {
    let m = joint.unit("m");
    let (motion, required) = (&application.motion, &application.requirement);
    let length = |value: f64| in_prefix_short(value, &m);
    let time = |value: f64| in_prefix_short(value, "s");
    let returns = if motion.and_return { ", and back" } else { "" };
    let before = &motion.conditioning;
    [
        ("application", application.name.clone()),
        ("motion", format!("{} in {}{returns}", length(motion.distance), time(motion.duration))),
        (
            "before it",
            format!(
                "a move of {} in {} the other way, and a rest of {}",
                length(before.distance),
                time(before.duration),
                time(before.rest)
            ),
        ),
        (
            "requirement",
            format!(
                "error of at most {}, and within {} at the latest {} after the arrival",
                length(required.peak_error),
                length(required.settling_band),
                time(required.settling_time)
            ),
        ),
    ]
}

/// The page, and its figures with their names. `file` is what the user calls the model,
/// `application` what the gains were searched for.
pub fn tuning_page(
    file: &str,
    model: &StageModel,
    application: &Application,
    tuning: &Tuning,
    measured: Option<&MeasuredReport>,
    seed: u64,
) -> Result<(String, Vec<(String, String)>), TuningPageError> {
    let found = tuning.found();
    let mut page = Page::new(
        format!("Tuning of {file}"),
        format!("model \u{201c}{}\u{201d}; {}", model.name, verdict(tuning)),
    );
    let mut figures: Vec<(String, String)> = Vec::new();
    page.facts(task(application, model.joint));
    page.tiles(&tiles(tuning));
    for warning in tuning_warnings(tuning, measured) {
        page.note(Mark::Warning, &warning);
    }
    page.section("Gains and what they reach");
    page.table(&gains(tuning, model.joint));
    page.table(&reached(tuning, model.joint));
    page.section("Loop");
    page.text(
        "Open loop of the tuned controller on the nominal stage: a free mass, and the guides by \
         their describing function at three amplitudes. Marks: a sine on the emulator.",
    );
    let rate = found.settings.rate;
    // Close to half the rate the zero of the hold is all that is seen.
    let drawn = 1.0..=0.475 * rate;
    let frequencies: Vec<f64> =
        loop_frequencies(rate).into_iter().filter(|one| drawn.contains(one)).collect();
    let distance = break_away(&model.resolved_guides()?);
    let motions = [(StageMotion::PlainMass, "free mass".to_owned(), None)].into_iter().chain(
        SHOWN.map(|(share, words)| {
            let amplitude = share * distance;
            let length = in_prefix_short(amplitude, &model.joint.unit("m"));
            let name = format!("{length}, {words}");
            (StageMotion::Amplitude(amplitude), name, Some(amplitude))
        }),
    );
    let (mut gain, mut phase) = (
        Chart::new("Open loop: gain", "frequency, Hz", "open loop |L|").logarithmic(true, true),
        Chart::new("Open loop: phase", "frequency, Hz", "phase, degrees").logarithmic(true, false),
    );
    let mut sensitivity =
        Chart::new("Sensitivity", "frequency, Hz", "sensitivity |S|, dB").logarithmic(true, false);
    let mut process = Chart::new(
        "Process sensitivity",
        "frequency, Hz",
        model.joint.heading("position over force |P S|, m/N"),
    )
    .logarithmic(true, true);
    let settings = Settings { seed, rates: Rates::of_control(rate)? };
    let swept: Vec<f64> = frequencies
        .iter()
        .copied()
        .filter(|frequency| (3.0..=0.1 * rate).contains(frequency))
        .step_by(18)
        .collect();
    for (index, (motion, name, amplitude)) in motions.enumerate() {
        let colour = match index {
            0 => of_controller(1),
            amplitude => AMPLITUDES[amplitude - 1],
        };
        let stage = SampledStage::new(model, rate, 0.0, motion, &frequencies)?;
        let response = LoopResponse::new(&stage, &found.settings);
        let points = &response.points;
        gain.add(
            &name,
            colour,
            Style::Line,
            points.iter().map(|p| (p.frequency, p.open_loop.norm())),
        );
        let angles = points.iter().map(|p| p.open_loop.arg().to_degrees());
        let line: Vec<(f64, f64)> =
            points.iter().map(|p| p.frequency).zip(unwrapped(angles)).collect();
        phase.add(&name, colour, Style::Line, line.iter().copied());
        sensitivity.add(&name, colour, Style::Line, in_decibels(points));
        process.add(
            &name,
            colour,
            Style::Line,
            points.iter().map(|p| (p.frequency, p.process.norm())),
        );
        if let Some(amplitude) = amplitude {
            let measured = measure_loop(model, &settings, &found.settings, amplitude, &swept)?;
            let good = |point: &&MeasuredLoopPoint| {
                point.coherence > 0.99 && (point.amplitude / amplitude - 1.0).abs() < 0.1
            };
            let marks: Vec<_> = measured.iter().filter(good).collect();
            gain.add(
                "",
                colour,
                Style::Marks,
                marks.iter().map(|p| (p.frequency, p.open_loop.norm())),
            );
            phase.add(
                "",
                colour,
                Style::Marks,
                marks.iter().map(|p| {
                    let near = line.iter().find(|point| point.0 >= p.frequency);
                    let angle = p.open_loop.arg().to_degrees();
                    (p.frequency, near.map_or(angle, |near| beside(near.1, angle)))
                }),
            );
        }
        if motion == StageMotion::PlainMass {
            let others = tuning.tunings.iter().enumerate().filter(|(index, _)| *index != 1);
            for (index, one) in others {
                let name = format!("free mass, {}", one.name);
                let response = LoopResponse::new(&stage, &one.settings);
                let along = |of: fn(&LoopPoint) -> f64| {
                    response.points.iter().map(move |p| (p.frequency, of(p)))
                };
                let other = |chart: &mut Chart, points: Vec<(f64, f64)>| {
                    chart.add(&name, of_controller(index), Style::Line, points);
                };
                other(&mut gain, along(|p| p.open_loop.norm()).collect());
                other(&mut sensitivity, in_decibels(&response.points).collect());
                other(&mut process, along(|p| p.process.norm()).collect());
            }
        }
    }
    sensitivity.line("6 dB", Axis::Y, 6.0);
    phase.line("-180°", Axis::Y, -180.0);
    gain.line("|L| = 1", Axis::Y, 1.0);
    for (name, chart, caption) in [
        (
            "open_loop_gain",
            gain,
            "Guides hold the stage below their resonance. Where the gain falls below 1 is the \
             crossover.",
        ),
        (
            "open_loop_phase",
            phase,
            "Its distance from -180° where the gain is 1 is the phase margin.",
        ),
        (
            "sensitivity",
            sensitivity,
            "Below 6 dB the modulus margin is kept. What is below -40 dB is left out.",
        ),
        (
            "process_sensitivity",
            process,
            &model.joint.heading("Position over a force: small is stiff."),
        ),
    ] {
        page.figure(&chart, caption)?;
        figures.push((name.to_owned(), chart.svg()?));
    }
    page.table(&by_amplitude(found, model.joint));
    for compared in &tuning.tunings[2..] {
        page.table(&by_amplitude(compared, model.joint));
    }
    if let Some(measured) = measured {
        measured.section(&mut page, &mut figures)?;
    }
    page.section("Step");
    let mut steps = Chart::new(
        model.joint.unit("Step of 1 µm of the reference"),
        "time, ms",
        model.joint.heading("position, part of the step"),
    );
    for (index, one) in tuning.tunings.iter().enumerate() {
        let response = step_response(model, &one.settings, STEP.0, STEP.1)?;
        let points = response.into_iter().map(|(time, x)| (1e3 * time, x));
        steps.add(&one.name, of_controller(index), Style::Line, points);
    }
    steps.line("reference", Axis::Y, 1.0);
    page.figure(
        &steps,
        "On the emulator, without noise and feedforward, after a rest of ten time constants of the \
         integral, 10 s at most, in which it takes over the constant forces: what moves the stage \
         is the step alone.",
    )?;
    figures.push(("step".to_owned(), steps.svg()?));
    // They are lengths, which a joint that turns has none of.
    if model.joint == JointType::Prismatic {
        moves(&mut page, &mut figures, model, tuning, seed)?;
    }
    Ok((page.finish(), figures))
}

/// The paper's moves on the nominal stage, where it can make them.
fn moves(
    page: &mut Page,
    figures: &mut Vec<(String, String)>,
    model: &StageModel,
    tuning: &Tuning,
    seed: u64,
) -> Result<(), TuningPageError> {
    page.section(&format!("The moves of {PAPER}"));
    let motion = PaperMotion::new(REST, 1);
    // 5.7735 D / T^2, and the friction of the guides.
    let friction: f64 = model.resolved_guides()?.iter().map(|guide| guide.static_force).sum();
    let needed = tuning.mass * 10.0 / 3f64.sqrt() * 5.0 + friction;
    let far = motion.points.iter().map(|point| point.position.abs()).fold(0.0, f64::max);
    let within = model.stroke.is_none_or(|stroke| stroke.low < -far && stroke.high > far);
    if needed > model.motor.force_limit || !within {
        page.text(&format!(
            "50 mm in 100 ms need {needed:.0} N and {far} m to either side, which this stage does \
             not have."
        ));
        return Ok(());
    }
    let mut runs = Vec::new();
    let mut table = Table::new(&[
        ("controller", Align::Left),
        ("move", Align::Left),
        ("peak error, µm", Align::Right),
        ("settled to 1 µm, ms", Align::Right),
        ("to 0.1 µm, ms", Align::Right),
    ])
    .captioned("Time to settle: after the arrival of the reference.");
    for one in &tuning.tunings {
        let errors = errors_along(model, &one.settings, motion.points.clone(), seed)?;
        for (kind, words) in
            [(MoveKind::FastForward, "50 mm in 100 ms"), (MoveKind::FineStep, "10 µm in 3 ms")]
        {
            let Some(the_move) = motion.moves.iter().find(|the_move| the_move.kind == kind) else {
                continue;
            };
            if let Some(result) = settling(the_move, errors.iter().copied()) {
                table.row([
                    Cell::text(one.name.as_str()),
                    Cell::text(words),
                    Cell::number(1e6 * result.peak_error, 3),
                    Cell::maybe(result.settling[1].map(|time| 1e3 * time), 1),
                    Cell::maybe(result.settling[2].map(|time| 1e3 * time), 1),
                ]);
            }
        }
        runs.push((one.name.clone(), errors));
    }
    let mut charts = position_error_charts(&motion, &runs);
    for curve in charts.iter_mut().flat_map(|chart| &mut chart.series) {
        if let Some(index) = runs.iter().position(|run| run.0 == curve.name) {
            curve.colour = of_controller(index);
        }
    }
    for chart in &charts {
        page.figure(chart, caption(chart))?;
    }
    figures.push(("moves".to_owned(), svg("Position error", &charts)?));
    page.table(&table);
    Ok(())
}

fn tiles(tuning: &Tuning) -> Vec<Tile> {
    let (found, on) = (tuning.found(), tuning.found().on_variants);
    let kept = found.worst.stable && found.worst.modulus_margin >= 0.5;
    vec![
        Tile {
            name: "against the rule of thumb".to_owned(),
            value: format!("{:.2}", on.ratio),
            detail: "times the objective, median of unseen variants".to_owned(),
            mark: if on.ratio < 1.0 { Mark::Good } else { Mark::Neutral },
        },
        Tile {
            name: "largest |S|".to_owned(),
            value: format!("{:.1} dB", found.worst.peak_sensitivity_db()),
            detail: "over guides and amplitudes, at most 6 dB".to_owned(),
            mark: if kept { Mark::Good } else { Mark::Bad },
        },
        Tile {
            name: "requirement met".to_owned(),
            value: format!("{:.1} %", 100.0 * on.met),
            detail: format!("of {} variants", on.variants),
            mark: Mark::Neutral,
        },
    ]
}

fn gains(tuning: &Tuning, joint: JointType) -> Table {
    let mut table = Table::new(&[
        ("controller", Align::Left),
        (&joint.unit("p, N/m"), Align::Right),
        (&joint.unit("i, N/(m s)"), Align::Right),
        (&joint.unit("d, N s/m"), Align::Right),
        ("lowpass, Hz", Align::Right),
    ]);
    for one in &tuning.tunings {
        let gains = one.settings.gains;
        table.row([
            Cell::text(one.name.as_str()),
            Cell::text(format!("{:.4e}", gains.p)),
            Cell::text(format!("{:.4e}", gains.i)),
            Cell::text(format!("{:.4e}", gains.d)),
            Cell::number(gains.lowpass_frequency, 0),
        ]);
    }
    table
}

fn reached(tuning: &Tuning, joint: JointType) -> Table {
    let mut table = Table::new(&[
        ("controller", Align::Left),
        (&joint.unit("peak error, µm: median"), Align::Right),
        ("of 95 %", Align::Right),
        ("settled, ms: median", Align::Right),
        ("of 95 %", Align::Right),
        ("requirement met, %", Align::Right),
        ("not worse than the rule, %", Align::Right),
    ])
    .captioned(format!(
        "On {} variants that the search did not see.",
        tuning.found().on_variants.variants
    ));
    for one in &tuning.tunings {
        let on = one.on_variants;
        table.row([
            Cell::text(one.name.as_str()),
            Cell::number(1e6 * on.peak_error[0], 3),
            Cell::number(1e6 * on.peak_error[1], 3),
            Cell::number(1e3 * on.settling_time[0], 1),
            Cell::number(1e3 * on.settling_time[1], 1),
            Cell::number(100.0 * on.met, 1),
            Cell::number(100.0 * on.not_worse, 1),
        ]);
    }
    table
}

/// Sensitivity over frequency in dB; nothing where it is so small that it would hide its peak.
fn in_decibels(points: &[LoopPoint]) -> impl Iterator<Item = (f64, f64)> {
    const LEAST: f64 = -40.0;
    points.iter().map(|point| {
        let size = 20.0 * point.sensitivity.norm().log10();
        (point.frequency, if size < LEAST { f64::NAN } else { size })
    })
}

fn by_amplitude(found: &Tuned, joint: JointType) -> Table {
    let mut table = Table::new(&[
        (&joint.unit("amplitude, µm"), Align::Right),
        ("crossover, Hz", Align::Right),
        ("phase margin, degrees", Align::Right),
        ("gain margin, dB", Align::Right),
        ("least gain, dB", Align::Right),
        ("largest |S|, dB", Align::Right),
        ("at, Hz", Align::Right),
    ])
    .captioned(format!(
        "Loop of the controller \u{201c}{}\u{201d} on the nominal stage.",
        found.name
    ));
    let db = |factor: Option<f64>| Cell::maybe(factor.map(|factor| 20.0 * factor.log10()), 1);
    for one in &found.nominal {
        let margins = &one.margins;
        table.row([
            one.amplitude.map_or(Cell::text("free mass"), |x| Cell::text(short(1e6 * x))),
            Cell::maybe(margins.crossover, 1),
            Cell::maybe(margins.phase_margin, 1),
            db(margins.gain_margin),
            db(margins.least_gain),
            Cell::number(margins.peak_sensitivity_db(), 1),
            Cell::number(margins.modulus_frequency, 0),
        ]);
    }
    table
}

/// Two digits that count.
fn short(value: f64) -> String {
    let digits = (1.0 - value.abs().log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.digits$}")
}

/// A phase in whole turns from another, so that both are less than half a turn apart.
pub(crate) fn beside(other: f64, degrees: f64) -> f64 {
    degrees + 360.0 * ((other - degrees) / 360.0).round()
}

/// Phases along a frequency without jumps of a turn; the first between -330 and 30 degrees, since
/// a loop begins with integrators.
pub(crate) fn unwrapped(phases: impl Iterator<Item = f64>) -> impl Iterator<Item = f64> {
    phases.scan(-150.0, |last, phase| {
        *last = beside(*last, phase);
        Some(*last)
    })
}
