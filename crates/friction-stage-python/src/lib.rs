//! The Python package `friction_stage`: the library for numpy arrays.
//!
//! Each file gives one thing of the crates below to Python and decides nothing. Long work runs on a
//! thread of its own while the caller's waits without the interpreter's lock (`waiting`); errors
//! carry the words of the command line (`error`). What needs no Rust, such as data frames and
//! plots, is in `python/friction_stage`.

mod controller;
mod error;
mod experiment;
mod guide;
mod identification;
mod model;
mod motion;
mod recording;
mod selection;
mod simulation;
mod stage;
mod sweep;
mod waiting;

use pyo3::prelude::*;

#[pymodule]
mod _native {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::controller::Controller;
    #[pymodule_export]
    use super::experiment::experiment;
    #[pymodule_export]
    use super::guide::{FittedGuide, fit};
    #[pymodule_export]
    use super::identification::{Identified, identify};
    #[pymodule_export]
    use super::model::Model;
    #[pymodule_export]
    use super::motion::Motion;
    #[pymodule_export]
    use super::recording::{check, read_bag, write_csv};
    #[pymodule_export]
    use super::selection::{Plan, Ranking};
    #[pymodule_export]
    use super::simulation::simulate;
    #[pymodule_export]
    use super::stage::{Sample, Stage};
    #[pymodule_export]
    use super::sweep::{PlannedSweep, SweepTally, sweep};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}

/// Text in JSON as the Python objects that it stands for.
pub(crate) fn from_json<'py>(py: Python<'py>, text: &str) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.getattr("loads")?.call1((text,))
}
