//! `--next-experiment`: the limits that the user gives.

use clap::Args;

use crate::cli::WrongArguments;
use friction_stage_core::model::StageModel;
use friction_stage_identify::{Limits, Record};

/// Name of the motion in the directory of the results.
pub const FILE: &str = "next_experiment.yaml";
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
    #[arg(long, value_name = "M/S", default_value_t = Limits::SPEED, requires = "next_experiment")]
    pub max_speed: f64,
    /// Its largest motor force, N [default: that of the model's motor]
    #[arg(long, value_name = "N", requires = "next_experiment")]
    pub max_force: Option<f64>,
    /// About how long it may take, s
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = Limits::DURATION,
        requires = "next_experiment"
    )]
    pub max_duration: f64,
}

impl LimitArgs {
    /// The limits, with what follows from data and model where the user gives none; impossible ones
    /// are wrong arguments.
    pub fn limits(&self, model: &StageModel, train: &Record) -> anyhow::Result<Limits> {
        let stroke = match self.stroke.as_deref() {
            Some([low, high]) => Some((*low, *high)),
            _ => None,
        };
        let (speed, duration) = (Some(self.max_speed), Some(self.max_duration));
        let limits = Limits::given(stroke, speed, self.max_force, duration, model, train)
            .map_err(|error| WrongArguments(format!("next experiment: {error}")))?;
        Ok(limits)
    }
}
