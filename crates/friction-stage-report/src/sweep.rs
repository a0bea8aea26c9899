//! The report of a sweep: the table of its points or of their quantiles, and errors and settling
//! times over each axis as a figure.

use std::fmt::Write as _;

use crate::chart::{Chart, Style};
use crate::figure::{FigureError, svg};
use crate::paper_motion::micrometres;
use crate::words::{fixed, guide_label, in_line, in_prefix_short};
use friction_stage_core::numerics::range;
use friction_stage_core::plant::EffectDescriptor;
use friction_stage_lab::{
    MotionQuality, NumberedPlan as _, PointSummary, SETTLING_BANDS, SweepMotion, SweepPlan,
    SweepQuantiles, SweepSummary, SweepValue, sweep_unit,
};

/// Points that the table lists one by one.
const LISTED: u64 = 40;
/// Points that a figure shows at most.
const SHOWN: u64 = 4000;
/// Values of another axis that have a colour of their own.
const COLOURS: u64 = 6;

/// What of a point a figure shows.
struct Quantity {
    name: &'static str,
    unit: &'static str,
    /// None where the point never gets there.
    of: fn(&MotionQuality) -> Option<f64>,
}

const QUANTITIES: [Quantity; 2] = [
    Quantity { name: "peak error", unit: "µm", of: |quality| Some(quality.peak_error * 1e6) },
    Quantity {
        name: "time to settle to 1 µm",
        unit: "ms",
        of: |quality| quality.settling[1].map(|time| time * 1e3),
    },
];

/// The result as text for a person.
pub fn sweep_text(plan: &SweepPlan, summary: &SweepSummary) -> String {
    let mut out = String::new();
    // A string takes whatever is written.
    let _ = write_text(&mut out, plan, summary);
    out
}

fn write_text(out: &mut String, plan: &SweepPlan, summary: &SweepSummary) -> std::fmt::Result {
    let axes: Vec<String> = summary
        .axes
        .iter()
        .map(|axis| match axis.drawn {
            true => format!("{} (drawn)", axis.key),
            false => format!("{} ({} values)", axis.key, axis.count),
        })
        .collect();
    writeln!(
        out,
        "{}: {} points over {}\n",
        in_line(&summary.stage),
        summary.points,
        axes.join(", ")
    )?;
    let joint = plan.model.joint;
    let widths: Vec<usize> = plan.axes.iter().map(|axis| axis.key.len().max(12)).collect();
    if summary.points <= LISTED && summary.all_rows {
        for width in &widths {
            write!(out, "{:width$}  ", "")?;
        }
        let [peak_force, force, length] =
            [joint.quantity("peak force"), joint.unit("N"), joint.unit("µm")];
        writeln!(
            out,
            "{:>10}  {:>10}  {:>26}  {peak_force:>10}",
            "peak error", "rms error", "settled within, ms"
        )?;
        for (axis, width) in plan.axes.iter().zip(&widths) {
            write!(out, "{:>width$}  ", axis.key)?;
        }
        let [ten, one, tenth] = ["10", "1", "0.1"].map(|size| format!("{size} {length}"));
        writeln!(out, "{length:>10}  {length:>10}  {ten:>8} {one:>8} {tenth:>8}  {force:>8}")?;
        for point in &summary.rows {
            write_row(out, point, &widths)?;
        }
    } else {
        writeln!(out, "{:28}{:>12}{:>12}{:>12}", "over all points", "5 %", "50 %", "95 %")?;
        quantiles(out, &joint.unit("peak error, µm"), summary.peak_error, 1e6)?;
        quantiles(out, &joint.unit("rms error, µm"), summary.rms_error, 1e6)?;
        for (band, settling) in SETTLING_BANDS.iter().zip(summary.settling) {
            let name = format!("settled to {} after, ms", joint.unit(&micrometres(*band)));
            quantiles(out, &name, settling, 1e3)?;
        }
        writeln!(out)?;
        for (name, point) in
            [("smallest peak error", &summary.best), ("largest peak error", &summary.worst)]
        {
            let Some(PointSummary { point, values, result: Some(result), .. }) = point else {
                continue;
            };
            let values: Vec<String> = plan
                .axes
                .iter()
                .zip(values)
                .map(|(axis, value)| format!("{} {}", axis.key, shown(value)))
                .collect();
            let peak = fixed(result.peak_error * 1e6, 3);
            writeln!(
                out,
                "{name}: {peak} {} at point {point}: {}",
                joint.unit("µm"),
                values.join(", ")
            )?;
        }
    }
    if summary.saturated > 0 {
        let force = joint.quantity("force");
        writeln!(out, "\nthe {force} reaches its limit in {} points", summary.saturated)?;
    }
    if let Some(reason) = &summary.first_failure {
        writeln!(
            out,
            "\nwarning: {} of {} points cannot be computed, the first: {}",
            summary.failed,
            summary.points,
            in_line(reason)
        )?;
    }
    Ok(())
}

fn write_row(out: &mut String, point: &PointSummary, widths: &[usize]) -> std::fmt::Result {
    for (value, width) in point.values.iter().zip(widths) {
        write!(out, "{:>width$}  ", in_line(&shown(value)))?;
    }
    let Some(MotionQuality { peak_error, rms_error, settling, peak_force, saturated }) =
        point.result
    else {
        return writeln!(out, "{}", in_line(point.failure.as_deref().unwrap_or_default()));
    };
    let [a, b, c] = settling.map(milliseconds);
    let limit = if saturated > 0 { "  at the limit" } else { "" };
    writeln!(
        out,
        "{:>10}  {:>10}  {a:>8} {b:>8} {c:>8}  {:>8}{limit}",
        fixed(peak_error * 1e6, 3),
        fixed(rms_error * 1e6, 3),
        fixed(peak_force, 1)
    )
}

/// A time in ms; `never` where there is none.
pub(crate) fn milliseconds(time: Option<f64>) -> String {
    match time {
        Some(time) if time.is_finite() => format!("{:.1}", time * 1e3),
        _ => "never".to_owned(),
    }
}

/// A value with as many digits as a person reads.
fn shown(value: &SweepValue) -> String {
    match value.number() {
        None => value.to_string(),
        Some(number) => {
            let short = format!("{number:.6e}").parse::<f64>().unwrap_or(number);
            let plain = format!("{short}");
            if plain.len() <= 12 { plain } else { format!("{number:.4e}") }
        }
    }
}

fn quantiles(
    out: &mut String,
    name: &str,
    found: Option<SweepQuantiles>,
    unit: f64,
) -> std::fmt::Result {
    let Some(SweepQuantiles { q05, q50, q95 }) = found else { return Ok(()) };
    write!(out, "{name:28}")?;
    for value in [q05, q50, q95] {
        match value.is_finite() {
            true => write!(out, "{:>12}", fixed(value * unit, 3))?,
            false => write!(out, "{:>12}", "never")?,
        }
    }
    writeln!(out)
}

/// Peak error and time to settle to 1 µm over each axis. `read` gives each point with its number
/// and outcome.
pub fn sweep_figure<E: From<FigureError>>(
    plan: &SweepPlan,
    read: impl FnOnce(&mut dyn FnMut(u64, Option<MotionQuality>)) -> Result<(), E>,
) -> Result<String, E> {
    // Every so many-th point, where there are too many to be seen.
    let every = plan.count().div_ceil(SHOWN).max(1);
    let mut points: Vec<(Vec<SweepValue>, MotionQuality)> = Vec::new();
    read(&mut |point, outcome| {
        if let (0, Some(quality)) = (point % every, outcome) {
            points.push((plan.values(point), quality));
        }
    })?;
    let joint = plan.model.joint;
    let mut charts = Vec::new();
    for (index, axis) in plan.axes.iter().enumerate() {
        let names = names_of(&points, index);
        let labels: Vec<String> = match axis.is_numeric() {
            true => Vec::new(),
            false => names.iter().map(|name| label_of(&axis.key, name)).collect(),
        };
        let place = |value: &SweepValue| match value.number().filter(|_| axis.is_numeric()) {
            Some(number) => number,
            None => {
                let name = value.to_string();
                names.iter().position(|known| *known == name).map_or(0.0, |at| at as f64 + 1.0)
            }
        };
        let unit = |key: &str| sweep_unit(key).map(|unit| joint.unit(unit));
        let words = key_in_words(&axis.key);
        let label = match unit(&axis.key).filter(|_| axis.is_numeric()) {
            Some(unit) => format!("{words}, {unit}"),
            None => words.clone(),
        };
        // Another axis with a few values has a curve for each.
        let other = plan.axes.iter().enumerate().find(|(at, other)| {
            *at != index && !other.is_drawn() && (2..=COLOURS).contains(&other.count())
        });
        let places: Vec<f64> = points.iter().map(|(values, _)| place(&values[index])).collect();
        let logarithmic = axis.is_numeric() && spans_decades(&places);
        for Quantity { name, unit: of_quantity, of } in QUANTITIES {
            let never = points.iter().filter(|(_, quality)| of(quality).is_none()).count();
            let title = joint.unit(&format!("{name} over {words}")).into_owned();
            let title = match never {
                0 => title,
                _ => format!("{title} ({never} of {} points never do)", points.len()),
            };
            let ordinate = format!("{name}, {}", joint.unit(of_quantity));
            let numbers: Vec<f64> = points.iter().filter_map(|(_, quality)| of(quality)).collect();
            let mut chart = Chart::new(upper(&title), &label, ordinate)
                .logarithmic(logarithmic, spans_decades(&numbers))
                .named(labels.clone());
            // Points that never settle have their place, too.
            chart.x_least = Some(range(&places));
            // Between names there is nothing.
            let apart = plan.axes.len() == 1 || plan.axes.len() == 2 && other.is_some();
            let single_curve = plan.samples == 1 && apart && axis.is_numeric();
            let style = if single_curve { Style::Both } else { Style::Marks };
            let series: Vec<Option<SweepValue>> = match other {
                None => vec![None],
                Some((_, other)) => {
                    (0..other.count()).map(|at| Some(other.value(at, plan.seed, 0))).collect()
                }
            };
            for (colour, wanted) in series.iter().enumerate() {
                let within = points.iter().filter(|(values, _)| match (other, wanted) {
                    (Some((at, _)), Some(wanted)) => values[at] == *wanted,
                    _ => true,
                });
                let mut curve: Vec<(f64, f64)> = within
                    .filter_map(|(values, quality)| Some((place(&values[index]), of(quality)?)))
                    .collect();
                curve.sort_by(|a, b| a.0.total_cmp(&b.0));
                let name = match (other, wanted) {
                    (Some((_, other)), Some(value)) => {
                        let key = key_in_words(&other.key);
                        match (unit(&other.key), value.number()) {
                            // A name says what it is.
                            (_, None) => label_of(&other.key, &shown(value)),
                            (Some(unit), _) => format!("{key} {} {unit}", shown(value)),
                            (None, _) => format!("{key} {}", shown(value)),
                        }
                    }
                    _ => String::new(),
                };
                if !curve.is_empty() {
                    chart.add(name, colour, style, curve);
                }
            }
            if !chart.series.is_empty() {
                charts.push(chart);
            }
        }
    }
    // The model's name says its guides, which a sweep over them changes.
    let name = match plan.axes.iter().any(|axis| axis.key == GUIDES) {
        true => "stage",
        false => &plan.model.name,
    };
    let motion = motion_in_words(plan);
    Ok(svg(&format!("{name}, {motion}: {} points", plan.count()), &charts)?)
}

/// What is moved, as far as no axis changes it.
fn motion_in_words(plan: &SweepPlan) -> String {
    let is_swept = |key: &str| plan.axes.iter().any(|axis| axis.key == key);
    match &plan.motion {
        SweepMotion::Move(a_move) => {
            let mut words = "a move".to_owned();
            if !is_swept("motion.distance") {
                let unit = plan.model.joint.unit("m");
                words = format!("{words} of {}", in_prefix_short(a_move.distance, &unit));
            }
            if !is_swept("motion.duration") {
                words = format!("{words} in {}", in_prefix_short(a_move.duration, "s"));
            }
            words
        }
        SweepMotion::Trajectory { moves, .. } => match moves.len() {
            1 => "a motion with 1 move".to_owned(),
            count => format!("a motion with {count} moves"),
        },
    }
}

/// A key as an axis names it: `model.guides.static_force` is the static force of the guides.
fn key_in_words(key: &str) -> String {
    let word = |part: &str| part.replace('_', " ");
    // The number of a guide stays; that the stage is a model need not be said.
    let parts: Vec<&str> =
        key.split('.').filter(|part| !["model", "effects", "gains"].contains(part)).collect();
    match parts.as_slice() {
        [] => key.to_owned(),
        [one] => word(one),
        ["stage", gain] | [.., "stage", gain] => format!("gain {}", word(gain)),
        ["motion", "settle"] => "time watched after the move".to_owned(),
        [.., "guides", number, last] if number.parse::<usize>().is_ok() => {
            format!("{} of guides.{number}", word(last))
        }
        [.., owner, last] => {
            let article = if EffectDescriptor::find(owner).is_ok() { "" } else { "the " };
            format!("{} of {article}{}", word(last), word(owner))
        }
    }
}

/// The key that names guides.
const GUIDES: &str = "model.guides";

/// A value that is a name, for people.
fn label_of(key: &str, name: &str) -> String {
    if key == GUIDES { guide_label(name) } else { name.to_owned() }
}

/// A title begins with a capital.
fn upper(text: &str) -> String {
    let mut rest = text.chars();
    rest.next().map_or_else(String::new, |first| first.to_uppercase().chain(rest).collect())
}

/// The names that an axis of names has, in their order.
fn names_of(points: &[(Vec<SweepValue>, MotionQuality)], index: usize) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for (values, _) in points {
        let name = values[index].to_string();
        if values[index].number().is_none() && !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

/// Whether numbers are better seen over a logarithmic axis.
fn spans_decades(numbers: &[f64]) -> bool {
    let (least, most) = range(numbers);
    least > 0.0 && most / least > 30.0
}

#[cfg(test)]
mod tests {
    use friction_stage_core::model::StageModel;
    use friction_stage_lab::SweepOutcome;

    use super::*;

    fn plan(axes: &[&str], samples: Option<u64>) -> SweepPlan {
        let axes = axes.iter().map(|axis| axis.parse().unwrap()).collect();
        let motion = SweepMotion::named("fine-step").unwrap();
        let model = StageModel::on_guides("guide_2");
        SweepPlan::new(model, Default::default(), motion, axes, samples, 1).unwrap()
    }

    fn outcome(point: u64) -> SweepOutcome {
        Ok(MotionQuality {
            peak_error: 1e-6 * (point + 1) as f64,
            rms_error: 1e-7,
            settling: [Some(0.0), Some(0.01), None],
            peak_force: 10.0,
            saturated: 0,
        })
    }

    #[test]
    fn few_points_are_listed_and_many_are_summed_up() {
        let plan_of_two = plan(&["model.guides=guide_1,guide_2"], None);
        let failed = Err("model.mass is -1".to_owned());
        let summary =
            SweepSummary::of_outcomes(&plan_of_two, [(0, outcome(0)), (1, failed)].into_iter())
                .unwrap();
        let text = sweep_text(&plan_of_two, &summary);
        for words in ["guide_1", "1.000", "never", "1 of 2 points cannot be computed"] {
            assert!(text.contains(words), "{words}: {text}");
        }
        let many = plan(&["model.mass=normal(40,1)"], Some(100));
        let outcomes: Vec<SweepOutcome> = (0..100).map(outcome).collect();
        let summary = SweepSummary::of_outcomes(&many, (0..).zip(outcomes)).unwrap();
        let quantiles = summary.peak_error.unwrap();
        let um = [quantiles.q05, quantiles.q50, quantiles.q95].map(|q| (q * 1e6).round());
        assert_eq!(um, [5.0, 50.0, 95.0]);
        let text = sweep_text(&many, &summary);
        assert!(text.contains("largest peak error: 100.000 µm at point 99"), "{text}");
    }

    #[test]
    fn every_axis_has_its_charts() {
        let plan = plan(&["model.mass=20,40", "model.guides=guide_1,guide_2"], None);
        let figure = sweep_figure::<FigureError>(&plan, |each| {
            (0..4).for_each(|point| each(point, outcome(point).ok()));
            Ok(())
        })
        .unwrap();
        for words in [
            "over mass",
            "mass, kg",
            "guide 1 (sealed)\n",
            "mass 20 kg",
            "stage, a move of 10 µm in 3 ms: 4 points",
        ] {
            assert!(figure.contains(words), "{words}");
        }
        assert!(!figure.contains("model."), "{figure}");
    }

    #[test]
    fn an_axis_is_named_by_what_it_is() {
        for (key, words) in [
            ("controller.bandwidth", "bandwidth of the controller"),
            ("model.mass", "mass"),
            ("model.guides.static_force", "static force of the guides"),
            ("model.guides.2.stiffness", "stiffness of guides.2"),
            ("model.effects.cogging.amplitude", "amplitude of cogging"),
            ("controller.gains.stage.p", "gain p"),
            ("controller.lowpass.frequency", "frequency of the lowpass"),
            ("motion.distance", "distance of the motion"),
        ] {
            assert_eq!(key_in_words(key), words);
        }
    }
}
