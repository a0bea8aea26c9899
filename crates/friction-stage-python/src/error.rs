//! Errors of the crates below as exceptions, with the words of the command line.

use std::error::Error;

use friction_stage_core::control::{ControllerError, TrajectoryError};
use friction_stage_core::model::ModelError;
use friction_stage_core::plant::RatesError;
use friction_stage_data::motion_file::MotionFileError;
use friction_stage_data::signals::SignalError;
use friction_stage_lab::{LabError, MoveError};
use friction_stage_report::words::in_one_line;
use pyo3::prelude::*;

/// The exceptions, which `friction_stage/errors.py` defines.
pub(crate) mod raised {
    use pyo3::import_exception;

    import_exception!(friction_stage.errors, FrictionStageError);
    import_exception!(friction_stage.errors, ModelError);
    import_exception!(friction_stage.errors, MotionError);
    import_exception!(friction_stage.errors, ControllerError);
    import_exception!(friction_stage.errors, RecordingError);
    import_exception!(friction_stage.errors, IdentificationError);
    import_exception!(friction_stage.errors, FitError);
    import_exception!(friction_stage.errors, SelectionError);
    import_exception!(friction_stage.errors, SweepError);
    import_exception!(friction_stage.errors, ExperimentError);
}

/// What a failure of the crates below is in Python.
pub(crate) trait Raise {
    fn raise(self) -> PyErr;
}

macro_rules! raise {
    ($($error:ty => $exception:ident),* $(,)?) => {
        $(impl Raise for $error {
            fn raise(self) -> PyErr {
                raised::$exception::new_err(words(&self))
            }
        })*
    };
}

raise! {
    ModelError => ModelError,
    TrajectoryError => MotionError,
    MoveError => MotionError,
    MotionFileError => MotionError,
    SignalError => RecordingError,
    RatesError => ControllerError,
    ControllerError => ControllerError,
}

impl Raise for LabError {
    fn raise(self) -> PyErr {
        match self {
            LabError::Model(error) => error.raise(),
            LabError::Controller(error) => error.raise(),
            LabError::Trajectory(error) => error.raise(),
            other => raised::ExperimentError::new_err(words(&other)),
        }
    }
}

/// An error with its causes, as the command line prints it.
pub(crate) fn words(error: &(dyn Error + 'static)) -> String {
    in_one_line(error)
}

/// Raises the error of a result.
pub(crate) trait OrRaise<T> {
    fn or_raise(self) -> PyResult<T>;
}

impl<T, E: Raise> OrRaise<T> for Result<T, E> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(Raise::raise)
    }
}
