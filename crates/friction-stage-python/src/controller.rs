//! `Controller`: PID with lowpass and feedforward.

use friction_stage_core::control::{AntiWindup, ControllerSettings, Gains};
use pyo3::prelude::*;

use crate::error::{OrRaise, raised};
use crate::model::Model;

/// The settings of a sampled position controller.
#[pyclass(frozen, eq, module = "friction_stage")]
#[derive(Clone, PartialEq)]
pub(crate) struct Controller(pub ControllerSettings);

#[pymethods]
impl Controller {
    #[new]
    #[pyo3(signature = (
        model,
        *,
        bandwidth = ControllerSettings::PAPER_BANDWIDTH,
        rate = 4000.0,
        mass_feedforward = None,
        viscous_feedforward = 0.0,
        p = None,
        i = None,
        d = None,
        lowpass_frequency = None,
        lowpass_damping = None,
        force_limit = None,
        anti_windup = "conditional_integration",
    ))]
    #[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
    fn new(
        model: &Model,
        bandwidth: f64,
        rate: f64,
        mass_feedforward: Option<f64>,
        viscous_feedforward: f64,
        p: Option<f64>,
        i: Option<f64>,
        d: Option<f64>,
        lowpass_frequency: Option<f64>,
        lowpass_damping: Option<f64>,
        force_limit: Option<f64>,
        anti_windup: &str,
    ) -> PyResult<Controller> {
        let paper = ControllerSettings::of_model(&model.0, bandwidth, rate);
        let strategy = AntiWindup::from_name(anti_windup).ok_or_else(|| {
            raised::ControllerError::new_err(format!(
                "anti_windup is `{anti_windup}`, must be one of {}",
                AntiWindup::NAMES.join(", ")
            ))
        })?;
        let settings = ControllerSettings {
            gains: Gains {
                p: p.unwrap_or(paper.gains.p),
                i: i.unwrap_or(paper.gains.i),
                d: d.unwrap_or(paper.gains.d),
                lowpass_frequency: lowpass_frequency.unwrap_or(paper.gains.lowpass_frequency),
                lowpass_damping: lowpass_damping.unwrap_or(paper.gains.lowpass_damping),
            },
            anti_windup: strategy,
            limits: force_limit.map_or(paper.limits, |limit| (-limit, limit)),
            mass_feedforward: mass_feedforward.unwrap_or(paper.mass_feedforward),
            viscous_feedforward,
            observer: None,
            rate,
        };
        settings.check().or_raise()?;
        Ok(Controller(settings))
    }

    #[getter]
    fn rate(&self) -> f64 {
        self.0.rate
    }

    #[getter]
    fn p(&self) -> f64 {
        self.0.gains.p
    }

    #[getter]
    fn i(&self) -> f64 {
        self.0.gains.i
    }

    #[getter]
    fn d(&self) -> f64 {
        self.0.gains.d
    }

    #[getter]
    fn lowpass_frequency(&self) -> f64 {
        self.0.gains.lowpass_frequency
    }

    #[getter]
    fn lowpass_damping(&self) -> f64 {
        self.0.gains.lowpass_damping
    }

    #[getter]
    fn force_limit(&self) -> f64 {
        self.0.limits.1
    }

    #[getter]
    fn mass_feedforward(&self) -> f64 {
        self.0.mass_feedforward
    }

    #[getter]
    fn viscous_feedforward(&self) -> f64 {
        self.0.viscous_feedforward
    }

    fn __repr__(&self) -> String {
        let gains = &self.0.gains;
        format!(
            "<Controller p {:.6e} N/m, i {:.6e} N/(m s), d {:.6e} N s/m at {} Hz>",
            gains.p, gains.i, gains.d, self.0.rate
        )
    }
}
