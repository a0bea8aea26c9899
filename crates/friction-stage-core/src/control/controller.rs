//! The controller: reference and measured position in, force with all its terms out.

use crate::numerics::plain;
use std::f64::consts::TAU;

use nalgebra::Complex;

use super::compensation::{Compensated, Compensation, CompensationTerms};
use super::disturbance_observer::{DisturbanceObserver, ObserverSettings};
use super::lowpass::Lowpass;
use super::pid::{AntiWindup, Gains, Pid};
use super::trajectory::{Follower, Reference};
use crate::model::StageModel;

/// What a controller is made of. Rates in Hz.
#[derive(Clone, Debug, PartialEq)]
pub struct ControllerSettings {
    /// Rate at which it is sampled, Hz.
    pub rate: f64,
    /// Gains of the PID.
    pub gains: Gains,
    /// What the integral does at a limit of the force.
    pub anti_windup: AntiWindup,
    /// Smallest and largest force, N.
    pub limits: (f64, f64),
    /// kg; the ideal mass feedforward of the paper is the mass of the stage.
    pub mass_feedforward: f64,
    /// N s/m
    pub viscous_feedforward: f64,
    /// The disturbance observer, if any.
    pub observer: Option<ObserverSettings>,
}

/// Settings that no controller can have.
#[expect(missing_docs, reason = "the message of each says what its fields are")]
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ControllerError {
    #[error("{name} is {}, must {limit}", plain(*value))]
    Value { name: &'static str, value: f64, limit: String },
}

/// Everything that the controller adds up for one sample, SI units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Terms {
    /// Where the carriage should be.
    pub reference: Reference,
    /// Measured position, m.
    pub position: f64,
    /// Reference less position, m.
    pub error: f64,
    /// Proportional term, N.
    pub proportional: f64,
    /// Integral term, N.
    pub integral: f64,
    /// Derivative term, N.
    pub derivative: f64,
    /// Sum of the three behind the lowpass, N.
    pub feedback: f64,
    /// Mass times acceleration of the reference, N.
    pub mass_feedforward: f64,
    /// Viscous coefficient times velocity of the reference, N.
    pub viscous_feedforward: f64,
    /// What a compensation adds to mass and viscous friction, N.
    pub compensation: CompensationTerms,
    /// What a disturbance observer adds, N.
    pub disturbance: f64,
    /// Sum of feedback, feedforward, disturbance observer and the effort of the reference, within
    /// the limits, N.
    pub output: f64,
    /// Whether the output is at a limit.
    pub saturated: bool,
    /// No motion is being followed.
    pub holding: bool,
}

/// A sampled position controller. The same references and positions give the same bits.
#[derive(Clone, Debug)]
pub struct Controller {
    settings: ControllerSettings,
    /// Sampling period, ns and s.
    period: f64,
    period_ns: i64,
    pid: Pid,
    lowpass: Lowpass,
    observer: Option<DisturbanceObserver>,
}

impl ControllerSettings {
    /// Bandwidth of the paper's controller, Hz (section 4).
    pub const PAPER_BANDWIDTH: f64 = 60.0;

    /// The paper's controller for what a stage moves and its motor can, with another bandwidth and
    /// rate (Hz).
    pub fn of_model(model: &StageModel, bandwidth: f64, rate: f64) -> ControllerSettings {
        let mass = model.moving_mass();
        ControllerSettings {
            gains: Gains::from_bandwidth(bandwidth, mass),
            ..ControllerSettings::paper(mass, rate, model.motor.force_limit)
        }
    }

    /// The controller of the paper's section 4 for a stage of `mass` kg: 60 Hz PID with lowpass,
    /// ideal mass feedforward.
    pub fn paper(mass: f64, rate: f64, force_limit: f64) -> ControllerSettings {
        ControllerSettings {
            rate,
            gains: Gains::from_bandwidth(ControllerSettings::PAPER_BANDWIDTH, mass),
            anti_windup: AntiWindup::ConditionalIntegration,
            limits: (-force_limit, force_limit),
            mass_feedforward: mass,
            viscous_feedforward: 0.0,
            observer: None,
        }
    }

    /// The same loop with `share` of its bandwidth, for one that comes late: gains and lowpass as
    /// [`Gains::from_bandwidth`] scales them; feedforward and limits stay.
    pub fn slowed(&self, share: f64) -> ControllerSettings {
        let gains = Gains {
            p: self.gains.p * share.powi(2),
            i: self.gains.i * share.powi(3),
            d: self.gains.d * share,
            lowpass_frequency: self.gains.lowpass_frequency * share,
            ..self.gains
        };
        let observer = self
            .observer
            .map(|observer| ObserverSettings { bandwidth: observer.bandwidth * share, ..observer });
        ControllerSettings { gains, observer, ..self.clone() }
    }

    /// The same with what a compensation knows for the disturbance observer: the moving mass, and
    /// the delay of the motor where the settings have none.
    pub fn informed(&self, compensation: &Compensation) -> ControllerSettings {
        let observer = self.observer.map(|observer| compensation.informed(observer));
        ControllerSettings { observer, ..self.clone() }
    }

    /// Force over position error at `frequency` (Hz, up to half the rate), N/m: PID, lowpass and
    /// disturbance observer as they are sampled.
    pub fn transfer(&self, frequency: f64) -> Complex<f64> {
        let (z, gains) = (Complex::from_polar(1.0, TAU * frequency / self.rate), &self.gains);
        let lowpass = Lowpass::new(gains.lowpass_frequency, gains.lowpass_damping, self.rate);
        let feedback = gains.transfer(frequency, self.rate) * lowpass.transfer(z);
        match &self.observer {
            Some(observer) => observer.around(feedback, frequency, self.rate),
            None => feedback,
        }
    }

    /// Refuses settings that no controller can have.
    pub fn check(&self) -> Result<(), ControllerError> {
        let refuse =
            |name, value, limit: String| Err(ControllerError::Value { name, value, limit });
        let not_negative = [
            ("gains.stage.p", self.gains.p),
            ("gains.stage.i", self.gains.i),
            ("gains.stage.d", self.gains.d),
            ("feedforward.mass", self.mass_feedforward),
            ("feedforward.viscous", self.viscous_feedforward),
        ];
        for (name, value) in not_negative {
            if !(value.is_finite() && value >= 0.0) {
                return refuse(name, value, "be finite and not negative".to_owned());
            }
        }
        if !(self.rate.is_finite() && self.rate > 0.0) {
            return refuse("rate", self.rate, "be finite and greater than 0".to_owned());
        }
        let nyquist = self.rate / 2.0;
        if !(self.gains.lowpass_frequency > 0.0 && self.gains.lowpass_frequency < nyquist) {
            let limit = format!("be greater than 0 and below half the rate, which is {nyquist} Hz");
            return refuse("lowpass.frequency", self.gains.lowpass_frequency, limit);
        }
        if !(self.gains.lowpass_damping > 0.0 && self.gains.lowpass_damping <= 10.0) {
            return refuse(
                "lowpass.damping",
                self.gains.lowpass_damping,
                "be greater than 0 and at most 10".to_owned(),
            );
        }
        if !(self.limits.0 < 0.0 && self.limits.1 > 0.0) {
            let limit =
                format!("be greater than 0, with the lower limit ({}) below 0", self.limits.0);
            return refuse("gains.stage.u_clamp_max", self.limits.1, limit);
        }
        self.observer.map_or(Ok(()), |observer| observer.check(self.rate))
    }
}

impl Controller {
    /// A controller that has seen no sample yet.
    pub fn new(settings: ControllerSettings) -> Result<Controller, ControllerError> {
        settings.check()?;
        let period = settings.rate.recip();
        Ok(Controller {
            period,
            period_ns: (period * 1e9).round() as i64,
            pid: Pid::new(settings.gains, settings.anti_windup, period),
            lowpass: Lowpass::new(
                settings.gains.lowpass_frequency,
                settings.gains.lowpass_damping,
                settings.rate,
            ),
            observer: settings
                .observer
                .map(|observer| DisturbanceObserver::new(observer, settings.rate)),
            settings,
        })
    }

    /// The force for the sample at `time` (ns) with the measured `position` (m).
    ///
    /// Mass feedforward takes the mean acceleration of the reference over the coming sample where a
    /// trajectory is followed: a force held over the sample then gives the mass the reference's
    /// velocity at its end. A streamed setpoint brings its own acceleration.
    #[inline]
    pub fn update(&mut self, time: i64, position: f64, follower: &mut Follower) -> Terms {
        self.update_with(time, position, follower, None)
    }

    /// As [`Controller::update`]; a compensation takes the place of mass and viscous feedforward.
    #[inline]
    pub fn update_with(
        &mut self,
        time: i64,
        position: f64,
        follower: &mut Follower,
        compensation: Option<&mut Compensation>,
    ) -> Terms {
        follower.advance(time);
        let reference = follower.at(time);
        let error = reference.position - position;
        let pid = self.pid.update(error);
        let feedback = self.lowpass.filter(pid.proportional + pid.integral + pid.derivative);
        let forward = match compensation {
            Some(compensation) => compensation.update(time, follower, self.settings.limits),
            None => self.feedforward(time, &reference, follower),
        };
        let Compensated { mass, viscous, terms } = forward;
        let mut wanted = feedback + mass + viscous + reference.effort;
        if terms != CompensationTerms::default() {
            wanted += terms.bristles + terms.forces + terms.motor;
        }
        let disturbance = match &mut self.observer {
            Some(observer) => observer.estimate(time, position),
            None => 0.0,
        };
        if self.observer.is_some() {
            wanted += disturbance;
        }
        let output = wanted.clamp(self.settings.limits.0, self.settings.limits.1);
        if let Some(observer) = &mut self.observer {
            let against = viscous + reference.effort;
            let compensated = terms.bristles + terms.forces + terms.motor;
            observer.commanded(output - mass - against - compensated, mass);
        }
        self.pid.saturated(wanted - output, error);
        Terms {
            reference,
            position,
            error,
            proportional: pid.proportional,
            integral: pid.integral,
            derivative: pid.derivative,
            feedback,
            mass_feedforward: mass,
            viscous_feedforward: viscous,
            compensation: terms,
            disturbance,
            output,
            saturated: wanted != output,
            holding: !follower.is_moving(time),
        }
    }

    #[inline]
    fn feedforward(&self, time: i64, reference: &Reference, follower: &Follower) -> Compensated {
        let acceleration = if follower.can_look_ahead() {
            (follower.at(time + self.period_ns).velocity - reference.velocity) / self.period
        } else {
            reference.acceleration
        };
        Compensated {
            mass: self.settings.mass_feedforward * acceleration,
            viscous: self.settings.viscous_feedforward * reference.velocity,
            terms: CompensationTerms::default(),
        }
    }

    /// New settings while running; the rate stays. What integrator and lowpass hold is kept.
    pub fn retune(&mut self, settings: ControllerSettings) -> Result<(), ControllerError> {
        settings.check()?;
        if settings.rate != self.settings.rate {
            let limit = format!("stay {} Hz while running", self.settings.rate);
            return Err(ControllerError::Value { name: "rate", value: settings.rate, limit });
        }
        self.pid.retune(settings.gains, settings.anti_windup);
        let gains = &settings.gains;
        self.lowpass.retune(&Lowpass::new(
            gains.lowpass_frequency,
            gains.lowpass_damping,
            settings.rate,
        ));
        match (&mut self.observer, settings.observer) {
            (Some(observer), Some(wanted)) => observer.retune(wanted),
            (observer, wanted) => {
                *observer = wanted.map(|wanted| DisturbanceObserver::new(wanted, settings.rate));
            }
        }
        self.settings = settings;
        Ok(())
    }

    /// The settings in use.
    pub fn settings(&self) -> &ControllerSettings {
        &self.settings
    }

    /// Forgets integral, lowpass, last error and the estimate of the disturbance.
    pub fn reset(&mut self) {
        self.pid.reset();
        self.lowpass.reset();
        if let Some(observer) = &mut self.observer {
            observer.reset();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mass_feedforward_alone_carries_a_free_mass_along_the_reference() {
        let mut settings = ControllerSettings::paper(40.0, 4000.0, 2000.0);
        (settings.gains.p, settings.gains.i, settings.gains.d) = (0.0, 0.0, 0.0);
        let mut controller = Controller::new(settings).unwrap();
        let mut follower = Follower::new(1e-3);
        follower.follow(0, super::super::Trajectory::rest_to_rest(0, 0.05, 100_000_000)).unwrap();
        let (mut x, mut v) = (0.0, 0.0);
        for k in 0..400 {
            let terms = controller.update(k * 250_000, x, &mut follower);
            let a = terms.output / 40.0;
            x += v * 2.5e-4 + 0.5 * a * 2.5e-4 * 2.5e-4;
            v += a * 2.5e-4;
        }
        // What remains is the shape of the acceleration within a sample: a T^2 / 12 = 0.15 µm at
        // the most.
        assert!((x - 0.05).abs() < 2e-7 && v.abs() < 1e-9, "{x} {v}");
    }

    #[test]
    fn output_is_the_sum_of_its_terms_within_the_limits() {
        let mut controller =
            Controller::new(ControllerSettings::paper(40.0, 4000.0, 50.0)).unwrap();
        let mut follower = Follower::new(1e-3);
        let small = controller.update(0, 1e-9, &mut follower);
        assert!(!small.saturated && small.output == small.feedback && small.error == -1e-9);
        let large = controller.update(250_000, -0.1, &mut follower);
        assert!(large.saturated && large.output == 50.0 && large.feedback > 50.0);
    }

    #[test]
    fn a_slowed_loop_is_that_of_the_smaller_bandwidth() {
        let fast = ControllerSettings::paper(40.0, 4000.0, 2000.0);
        let slow = Gains::from_bandwidth(15.0, 40.0);
        let found = fast.slowed(0.25).gains;
        for (found, expected) in [
            (found.p, slow.p),
            (found.i, slow.i),
            (found.d, slow.d),
            (found.lowpass_frequency, slow.lowpass_frequency),
        ] {
            assert!((found / expected - 1.0).abs() < 1e-12, "{found} {expected}");
        }
    }

    #[test]
    fn impossible_settings_are_refused_by_name() {
        let good = ControllerSettings::paper(40.0, 4000.0, 2000.0);
        let mut slow = good.clone();
        slow.rate = 500.0;
        assert!(slow.check().unwrap_err().to_string().contains("lowpass.frequency is 360"));
        let mut negative = good.clone();
        negative.gains.i = -1.0;
        assert!(negative.check().unwrap_err().to_string().contains("gains.stage.i is -1"));
    }
}
