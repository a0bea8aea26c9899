//! PID on the position error, sampled, with anti-windup.

use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

use nalgebra::Complex;

use super::lowpass::Lowpass;

/// Gains of the parallel form: u = p e + i integral(e) + d de/dt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// N/m
    pub p: f64,
    /// N/(m s)
    pub i: f64,
    /// N s/m
    pub d: f64,
    /// Cutoff of the lowpass behind the PID, Hz.
    pub lowpass_frequency: f64,
    /// Damping ratio of the lowpass.
    pub lowpass_damping: f64,
}

/// What the integrator does while the output is saturated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AntiWindup {
    /// Goes on integrating.
    None,
    /// Stands still while the error would drive the output further into saturation.
    ConditionalIntegration,
    /// Bleeds by the excess of the output with the time constant p / i.
    BackCalculation,
}

/// One PID. I is updated before it is used (backward Euler); D is the backward difference, 0 at the
/// first sample.
#[derive(Clone, Debug)]
pub struct Pid {
    gains: Gains,
    period: f64,
    strategy: AntiWindup,
    integral: f64,
    last_error: Option<f64>,
}

/// The three terms of one sample, N.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PidTerms {
    pub proportional: f64,
    pub integral: f64,
    pub derivative: f64,
}

impl Gains {
    /// Gains for a free mass (kg) so that the open loop crosses 1 at `bandwidth` (Hz).
    ///
    /// Corner frequencies by the rule of thumb for motion systems: integrator at 1/10,
    /// differentiator at 1/3 of the bandwidth (Munnig Schmidt, Schitter, Rankers, van Eijk, "The
    /// Design of High Performance Mechatronics", 2nd ed. 2014, section 4.2); the lowpass, second
    /// order at 6 times the bandwidth with damping 1/sqrt 2, stands for its taming pole and costs
    /// 14 degrees. Open loop: C(s) / (m s^2).
    pub fn from_bandwidth(bandwidth: f64, mass: f64) -> Gains {
        let crossover = 2.0 * PI * bandwidth;
        let (integrator, differentiator, lowpass) = (crossover / 10.0, crossover / 3.0, 6.0);
        let pid = (1.0f64).hypot(crossover / differentiator - integrator / crossover);
        let (gain, _) = Lowpass::response(1.0 / lowpass, FRAC_1_SQRT_2);
        let p = mass * crossover * crossover / (pid * gain);
        Gains {
            p,
            i: p * integrator,
            d: p / differentiator,
            lowpass_frequency: lowpass * bandwidth,
            lowpass_damping: FRAC_1_SQRT_2,
        }
    }
}

impl Gains {
    /// Force over position error of the PID alone at `frequency` (Hz), sampled at `rate` (Hz), N/m:
    /// P + I T / (1 - 1/z) + D (1 - 1/z) / T.
    pub fn transfer(&self, frequency: f64, rate: f64) -> Complex<f64> {
        let change = -Complex::from_polar(1.0, -TAU * frequency / rate) + 1.0;
        change.inv() * (self.i / rate) + change * (self.d * rate) + self.p
    }
}

impl AntiWindup {
    /// Names as in the pid_controller of ros2_control.
    pub const NAMES: [&'static str; 3] = ["none", "conditional_integration", "back_calculation"];

    /// The strategy of this name, as parameters give it; `None` for an unknown one.
    pub fn from_name(name: &str) -> Option<AntiWindup> {
        match name {
            "none" => Some(AntiWindup::None),
            "conditional_integration" => Some(AntiWindup::ConditionalIntegration),
            "back_calculation" => Some(AntiWindup::BackCalculation),
            _ => None,
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            AntiWindup::None => "none",
            AntiWindup::ConditionalIntegration => "conditional_integration",
            AntiWindup::BackCalculation => "back_calculation",
        }
    }
}

impl Pid {
    /// `period` in s.
    pub fn new(gains: Gains, strategy: AntiWindup, period: f64) -> Pid {
        Pid { gains, period, strategy, integral: 0.0, last_error: None }
    }

    /// Terms for the next sample of the error, m; once per period.
    #[inline]
    pub fn update(&mut self, error: f64) -> PidTerms {
        self.integral += self.gains.i * self.period * error;
        let change = error - self.last_error.unwrap_or(error);
        self.last_error = Some(error);
        PidTerms {
            proportional: self.gains.p * error,
            integral: self.integral,
            derivative: self.gains.d * change / self.period,
        }
    }

    /// Tells the PID by how much the sum of all terms exceeded the limit, N, 0 when it did not.
    #[inline]
    pub fn saturated(&mut self, excess: f64, error: f64) {
        if excess == 0.0 {
            return;
        }
        match self.strategy {
            AntiWindup::None => {}
            AntiWindup::ConditionalIntegration => {
                if excess * error > 0.0 {
                    self.integral -= self.gains.i * self.period * error;
                }
            }
            AntiWindup::BackCalculation => {
                let rate = if self.gains.p > 0.0 { self.gains.i / self.gains.p } else { 0.0 };
                self.integral -= (rate * self.period).min(1.0) * excess;
            }
        }
    }

    /// New gains without a jump of the integral term.
    pub fn retune(&mut self, gains: Gains, strategy: AntiWindup) {
        (self.gains, self.strategy) = (gains, strategy);
    }

    /// Forgets the integral and the last error.
    pub fn reset(&mut self) {
        self.integral = 0.0;
        self.last_error = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn open_loop_crosses_one_at_the_bandwidth_with_a_phase_margin_of_50_degrees() {
        let (bandwidth, mass) = (60.0, 40.0);
        let gains = Gains::from_bandwidth(bandwidth, mass);
        let w = 2.0 * PI * bandwidth;
        let (real, imaginary) = (gains.p, gains.d * w - gains.i / w);
        let (gain, phase) =
            Lowpass::response(bandwidth / gains.lowpass_frequency, gains.lowpass_damping);
        let magnitude = real.hypot(imaginary) * gain / (mass * w * w);
        assert!((magnitude - 1.0).abs() < 1e-12, "{magnitude}");
        let margin = (imaginary.atan2(real) + phase).to_degrees();
        assert!((50.0..60.0).contains(&margin), "{margin}");
    }

    #[test]
    fn integral_goes_on_stands_or_bleeds_under_saturation() {
        let gains =
            Gains { p: 10.0, i: 100.0, d: 0.0, lowpass_frequency: 1.0, lowpass_damping: 1.0 };
        let run = |strategy| {
            let mut pid = Pid::new(gains, strategy, 1e-3);
            (0..100)
                .map(|_| {
                    let terms = pid.update(1.0);
                    pid.saturated(5.0, 1.0);
                    terms.integral
                })
                .last()
                .unwrap()
        };
        assert!((run(AntiWindup::None) - 10.0).abs() < 1e-9);
        assert!((run(AntiWindup::ConditionalIntegration) - 0.1).abs() < 1e-9);
        assert!(run(AntiWindup::BackCalculation) < 6.0);
        let names = AntiWindup::NAMES.map(|name| AntiWindup::from_name(name).map(AntiWindup::name));
        assert_eq!(names, AntiWindup::NAMES.map(Some));
    }
}
