//! Records and hypotheses that tests of several files share.

use std::f64::consts::TAU;

use friction_stage_core::control::{Controller, ControllerSettings, Follower, Trajectory};
use friction_stage_core::model::StageModel;
use friction_stage_core::plant::{EffectDescriptor, Rates, Stage};
use friction_stage_data::signals::Trace;

use crate::hypothesis::{Hypothesis, Part};
use crate::record::measured::Measured;

/// Moves of 20 mm and back under our own controller, recorded at 2 kHz; before them the guides
/// came to hold a force.
pub(crate) fn recording(model: &StageModel, seed: u64, held: f64, moves: u64) -> Trace {
    let rates = Rates::new(2000.0, 40_000.0).unwrap();
    let mut stage = Stage::new(model, rates, seed).unwrap();
    for _ in 0..1000 {
        stage.advance(held);
    }
    let mut settings = ControllerSettings::paper(model.mass, 2000.0, 2000.0);
    settings.gains.lowpass_frequency = 300.0;
    let mut controller = Controller::new(settings).unwrap();
    let mut follower = Follower::new(f64::INFINITY);
    follower.hold(0, 0.0);
    let mut trace = Trace::default();
    for row in 0..3000 * moves {
        let sample = stage.sample();
        if row % 3000 == 0 {
            let target = if row % 6000 == 0 { 0.02 } else { 0.0 };
            follower
                .follow(sample.time, Trajectory::rest_to_rest(sample.time, target, 1_000_000_000))
                .unwrap();
        }
        let terms = controller.update(sample.time, sample.position, &mut follower);
        trace.push(&sample, &terms);
        stage.advance(terms.output);
    }
    trace
}

/// Two seconds at 2 kHz over 0.1 m, as an encoder reads them, with a force that is of no
/// importance.
pub(crate) fn record() -> Measured {
    let mut trace = Trace::default();
    for k in 0..4000 {
        let time = 5e-4 * f64::from(k);
        trace.time.push(time);
        trace.position.push(0.05 * (1.0 - (TAU * time).cos()));
        trace.force.push(80.0 * (TAU * time).cos());
        trace.force_cell.push(80.0 * (TAU * time).cos());
    }
    Measured::new(&trace, &StageModel::default(), "a record").unwrap()
}

pub(crate) fn hypothesis(effects: &[(&str, &[f64])]) -> Hypothesis {
    let start = Hypothesis::new(&StageModel::default(), Default::default()).unwrap();
    effects.iter().fold(start, |with, (name, values)| {
        with.with(Part {
            descriptor: EffectDescriptor::find(name).unwrap(),
            values: values.to_vec(),
        })
    })
}
