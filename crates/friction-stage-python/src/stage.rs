//! `Stage`: the plant for a loop of one's own, one force and one sample at a time.

use friction_stage_core::plant::{self, Rates};
use pyo3::prelude::*;

use crate::error::OrRaise;
use crate::model::Model;

/// What the sensors say at one sampling instant.
#[pyclass(frozen, get_all, module = "friction_stage")]
#[derive(Clone, Copy)]
pub(crate) struct Sample {
    /// Counted from the start.
    index: u64,
    /// s
    time: f64,
    /// m
    position: f64,
    /// m/s
    velocity: f64,
    /// N
    force_cell: f64,
}

impl From<plant::Sample> for Sample {
    fn from(sample: plant::Sample) -> Sample {
        Sample {
            index: sample.index,
            time: sample.time as f64 * 1e-9,
            position: sample.position,
            velocity: sample.velocity,
            force_cell: sample.force_cell,
        }
    }
}

#[pymethods]
impl Sample {
    fn __repr__(&self) -> String {
        format!(
            "Sample(index={}, time={}, position={:e}, velocity={:e}, force_cell={})",
            self.index, self.time, self.position, self.velocity, self.force_cell
        )
    }
}

/// A stage at rest at position 0.
#[pyclass(module = "friction_stage")]
pub(crate) struct Stage {
    stage: plant::Stage,
    sample: Sample,
}

#[pymethods]
impl Stage {
    #[new]
    #[pyo3(signature = (model, *, rate = 4000.0, noise = true, seed = 1))]
    fn new(model: &Model, rate: f64, noise: bool, seed: u64) -> PyResult<Stage> {
        let model = if noise { model.0.clone() } else { model.0.clone().without_noise() };
        let rates = Rates::of_control(rate).or_raise()?;
        let mut stage = plant::Stage::new(&model, rates, seed).or_raise()?;
        let sample = stage.sample().into();
        Ok(Stage { stage, sample })
    }

    #[getter]
    fn sample(&self) -> Sample {
        self.sample
    }

    fn step(&mut self, force: f64) -> Sample {
        self.stage.advance(force);
        self.sample = self.stage.sample().into();
        self.sample
    }

    #[getter]
    fn rate(&self) -> f64 {
        self.stage.rates().control()
    }

    #[getter]
    fn force_limit(&self) -> f64 {
        self.stage.force_limit()
    }

    #[getter]
    fn true_position(&self) -> f64 {
        self.stage.state().position
    }

    #[getter]
    fn true_velocity(&self) -> f64 {
        self.stage.state().velocity
    }

    #[getter]
    fn guide_forces(&self) -> Vec<f64> {
        let state = self.stage.state();
        state.guide_force[..state.guides].to_vec()
    }
}
