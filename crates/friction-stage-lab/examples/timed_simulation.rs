//! The fast move of the paper once for each line of standard input; prints the time of each, s.
//!
//! `crates/friction-stage-python/benches/speed.py` compares the Python package with it.

#![expect(clippy::disallowed_methods, reason = "it measures time")]

use std::io::BufRead as _;
use std::time::Instant;

use friction_stage_core::control::ControllerSettings;
use friction_stage_core::model::StageModel;
use friction_stage_lab::{LabError, PaperMotion, Row, Settings, closed_loop};

/// Rest before the move, s.
const REST: f64 = 20.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let model = StageModel::on_guides("guide_2");
    for line in std::io::stdin().lock().lines() {
        line?;
        let start = Instant::now();
        let rows = run(&model)?;
        println!("{:.9}", start.elapsed().as_secs_f64());
        assert!(!rows.is_empty());
    }
    Ok(())
}

fn run(model: &StageModel) -> Result<Vec<Row>, LabError> {
    let settings = Settings::default();
    let rate = settings.rates.control();
    let motion = PaperMotion::fast(REST);
    let controller = ControllerSettings::of_model(model, ControllerSettings::PAPER_BANDWIDTH, rate);
    let count = (motion.duration() as f64 * 1e-9 * rate).ceil() as usize;
    let mut stage = closed_loop(model, &settings, controller, motion.points)?;
    let mut rows = Vec::with_capacity(count);
    for _ in 0..count {
        rows.push(Row::of(&stage.cycle()?));
    }
    Ok(rows)
}
