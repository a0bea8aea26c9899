//! The next experiment in words: what the motion is and what it is for.

use crate::words::short;
use friction_stage_core::model::JointType;
use friction_stage_identify::NextExperiment;

/// What the motion is and what it is for, a line each.
pub fn next_experiment_lines(next: &NextExperiment, joint: JointType) -> Vec<String> {
    let [m, n, speed] = ["m", "N", "m/s"].map(|unit| joint.unit(unit));
    let mut lines = vec![
        format!("next experiment: {}", next.file),
        format!(
            "{:.1} s between {} and {} {m}, up to {} {speed} and {} {n}",
            next.duration,
            short(next.stroke[0]),
            short(next.stroke[1]),
            short(next.peak_speed),
            short(next.peak_force)
        ),
    ];
    lines.extend(next.segments.iter().map(|segment| {
        format!(
            "{}: {} ({:.1} s)",
            segment.kind.replace('_', " "),
            segment.description,
            segment.duration
        )
    }));
    if let Some(coordinate) = &next.coordinate {
        lines.push(format!("passes again and again over the {coordinate} of what no law explains"));
    }
    lines.extend(next.rivals.iter().map(|rival| {
        format!(
            "{} {} from {}: what one of them cannot imitate of the other is {:.2} times the \
             noise floor in the present record, {:.2} times in this motion ({:.2} are needed)",
            if rival.separates { "separates" } else { "does not separate" },
            rival.effect,
            rival.rival,
            rival.before,
            rival.after,
            rival.needed
        )
    }));
    lines.extend(next.parameters.iter().map(|parameter| {
        // Less than a tenth is no gain.
        let no_better = |before: f64, after: f64| after > 0.9 * before;
        if parameter
            .before
            .zip(parameter.after)
            .is_none_or(|(before, after)| no_better(before, after))
        {
            return format!(
                "does not sharpen {}: no motion that was tried shows it better",
                parameter.name
            );
        }
        let reach = |value: Option<f64>| match (value, parameter.unit.as_str()) {
            (None, _) => "nothing".to_owned(),
            (Some(value), "1") => format!("{:.1} %", 100.0 * value),
            (Some(value), unit) => format!("{value:.3e} {}", joint.unit(unit)),
        };
        format!(
            "sharpens {}: known to {} now, to {} with this motion",
            parameter.name,
            reach(parameter.before),
            reach(parameter.after)
        )
    }));
    lines.extend(next.untested.iter().map(|shown| {
        format!(
            "shows {}: at a usual size it leaves {:.2} times the noise floor in the present \
             record, {:.2} times in this motion",
            shown.effect, shown.before, shown.after
        )
    }));
    lines
}
