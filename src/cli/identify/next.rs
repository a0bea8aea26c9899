//! `--next-experiment`: the limits that the user gives, and what the motion is for in words.

use clap::Args;

use super::input::Input;
use crate::cli::WrongArguments;
use friction_stage_core::model::StageModel;
use friction_stage_core::plant::EffectDescriptor;
use friction_stage_identify::{Limits, NextExperiment};

/// Name of the motion in the directory of the results.
pub const FILE: &str = "next_experiment.yaml";
/// Largest speed where none is given, m/s: the paper's fast move, 50 mm in 100 ms, peaks at 0.94
/// m/s.
const SPEED: f64 = 1.0;
/// Duration where none is given, s. Assumed: long enough for several pieces, short enough to be
/// played twice.
const DURATION: f64 = 20.0;

/// What the next experiment may do.
#[derive(Debug, Clone, PartialEq, Args)]
pub struct LimitArgs {
    /// Lowest and highest position of the next experiment, m [default: those of the train record]
    #[arg(
        long,
        value_names = ["LOW", "HIGH"],
        num_args = 2,
        allow_negative_numbers = true,
        requires = "next_experiment",
    )]
    pub stroke: Option<Vec<f64>>,
    /// Its largest speed, m/s
    #[arg(long, value_name = "M/S", default_value_t = SPEED, requires = "next_experiment")]
    pub max_speed: f64,
    /// Its largest motor force, N [default: that of the model's motor]
    #[arg(long, value_name = "N", requires = "next_experiment")]
    pub max_force: Option<f64>,
    /// About how long it may take, s
    #[arg(long, value_name = "SECONDS", default_value_t = DURATION, requires = "next_experiment")]
    pub max_duration: f64,
}

impl LimitArgs {
    /// The limits, with what follows from data and model where the user gives none; impossible ones
    /// are wrong arguments.
    pub fn limits(&self, model: &StageModel, input: &Input) -> anyhow::Result<Limits> {
        let stroke = match self.stroke.as_deref() {
            Some([low, high]) => (*low, *high),
            _ => input
                .train
                .traces()
                .flat_map(|trace| &trace.position)
                .filter(|position| position.is_finite())
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
                    (low.min(*x), high.max(*x))
                }),
        };
        let force = self.max_force.unwrap_or(model.motor.force_limit);
        let limits = Limits { stroke, speed: self.max_speed, force, duration: self.max_duration };
        limits.check(model).map_err(|error| WrongArguments(format!("next experiment: {error}")))?;
        Ok(limits)
    }
}

/// What the motion is and what it is for, a line each.
pub fn lines(next: &NextExperiment) -> Vec<String> {
    let mut lines = vec![
        format!("next experiment: {}", next.file),
        format!(
            "{:.1} s between {:.4} and {:.4} m, up to {:.3} m/s and {:.0} N",
            next.duration, next.stroke[0], next.stroke[1], next.peak_speed, next.peak_force
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
            "{} {} from {}: what one of them cannot imitate of the other is {:.2} floors of the \
             sensors' noise in the present record, {:.2} in this motion ({:.2} are needed)",
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
            (Some(value), unit) => format!("{value:.3e} {unit}"),
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
            "shows {}: at a usual size it leaves {:.2} floors of the sensors' noise in the present \
             record, {:.2} in this motion",
            shown.effect, shown.before, shown.after
        )
    }));
    lines
}

/// What no motion within the limits does.
pub fn warnings(next: &NextExperiment) -> Vec<String> {
    let telltale = |name: &str| EffectDescriptor::find(name).map_or("", |found| found.telltale);
    next.rivals
        .iter()
        .filter(|rival| !rival.separates)
        .map(|rival| {
            format!(
                "no motion that was tried within the limits separates {} from {}: allow more \
                 speed, force or stroke, or measure what else tells them apart: {} ({}); {} ({})",
                rival.effect,
                rival.rival,
                telltale(&rival.effect),
                rival.effect,
                telltale(&rival.rival),
                rival.rival
            )
        })
        .collect()
}
