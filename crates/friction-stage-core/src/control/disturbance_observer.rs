//! Disturbance observer: the force that a stage shows beyond what the controller knows, estimated
//! from command and position and added to the command.
//!
//! The law is d = Q(s) (F - m s^2 x): the force that accelerates the nominal mass, less the one
//! that the acceleration shows, after a lowpass Q of second order, which makes it proper (Ohnishi,
//! Shibata, Murakami, IEEE/ASME Trans. Mechatronics 1(1), 1996; stability and choice of Q:
//! Sariyildiz, Oboe, Ohnishi, IEEE Trans. Ind. Electron. 67(3), 2020). F is the command within the
//! limits, less what is fed forward against friction and effects, so that the observer finds what a
//! compensation leaves. Sampled: a mass under a held force moves so that
//!
//! m (x[k] - 2 x[k-1] + x[k-2]) / T^2 = (F[k-1] + F[k-2]) / 2
//!
//! holds exactly, and Q is the bilinear Butterworth lowpass. On the nominal mass the sensitivity is
//! that without the observer times 1 - Q: lower below the bandwidth, and up to 1.3 times as high
//! around it. The estimate added to the command is bounded. The stiffness of the guides counts as a
//! disturbance. Nothing here allocates after construction.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};

use nalgebra::Complex;

use super::controller::ControllerError;
use super::lowpass::Lowpass;

/// What a disturbance observer takes for given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObserverSettings {
    /// Cutoff of its lowpass, Hz.
    pub bandwidth: f64,
    /// Largest force that it adds, N.
    pub limit: f64,
    /// Nominal mass, kg.
    pub mass: f64,
    /// Delay of the motor's force after the command, s.
    pub delay: f64,
    /// The same for what is fed forward: a compensation leads it through the lag of the motor, s.
    pub forward_delay: f64,
}

impl ObserverSettings {
    /// Largest force where none is given, N. Assumed: a tenth of what the paper's motor has.
    pub const LIMIT: f64 = 200.0;
    /// Longest delay, s. Assumed: beyond it no loop of a stage has a bandwidth.
    pub const LONGEST_DELAY: f64 = 0.05;

    /// Refuses settings that no observer sampled at `rate` (Hz) can have.
    pub fn check(&self, rate: f64) -> Result<(), ControllerError> {
        let refuse =
            |name, value, limit: String| Err(ControllerError::Value { name, value, limit });
        let nyquist = rate / 2.0;
        if !(self.bandwidth > 0.0 && self.bandwidth < nyquist) {
            let limit = format!("be greater than 0 and below half the rate, which is {nyquist} Hz");
            return refuse("disturbance_observer.bandwidth", self.bandwidth, limit);
        }
        if !(self.limit.is_finite() && self.limit > 0.0) {
            let limit = "be finite and greater than 0".to_owned();
            return refuse("disturbance_observer.limit", self.limit, limit);
        }
        if !(self.mass.is_finite() && self.mass > 0.0) {
            let limit = "be finite and greater than 0 with a disturbance observer, which needs it";
            return refuse("feedforward.mass", self.mass, limit.to_owned());
        }
        for delay in [self.delay, self.forward_delay] {
            if !(0.0..=ObserverSettings::LONGEST_DELAY).contains(&delay) {
                let limit = format!("be between 0 and {}", ObserverSettings::LONGEST_DELAY);
                return refuse("disturbance_observer.delay", delay, limit);
            }
        }
        Ok(())
    }

    /// Q as sampled, at `z` = exp(j w T).
    fn lowpass(&self, rate: f64) -> Lowpass {
        Lowpass::new(self.bandwidth, FRAC_1_SQRT_2, rate)
    }

    /// The controller with the observer from the one without it, force over position error at
    /// `frequency` (Hz): (C + Q m s^2) / (1 - Q), as sampled.
    pub fn around(&self, without: Complex<f64>, frequency: f64, rate: f64) -> Complex<f64> {
        let late = Complex::from_polar(1.0, -TAU * frequency / rate);
        let q = self.lowpass(rate).transfer(late.inv());
        let change = -late + 1.0;
        let known = late * (late + 1.0) * 0.5 * DelayLine::new(self.delay * rate).transfer(late);
        (without + q * change * change * (self.mass * rate * rate)) / (-(q * known) + 1.0)
    }
}

/// Forces of the last samples, N, after a delay that need not be a whole number of samples.
#[derive(Clone, Debug)]
struct DelayLine {
    /// Delay in whole samples, and the rest of it as a share of one.
    whole: usize,
    rest: f64,
    /// A ring, and where the next is written.
    values: Vec<f64>,
    next: usize,
}

impl DelayLine {
    fn new(samples: f64) -> DelayLine {
        let whole = samples as usize;
        // The mean of two, each between two neighbours, is of three samples.
        DelayLine { whole, rest: samples.fract(), values: vec![0.0; whole + 3], next: 0 }
    }

    /// The next force.
    fn push(&mut self, force: f64) {
        self.values[self.next] = force;
        self.next = (self.next + 1) % self.values.len();
    }

    /// Mean over the last two samples.
    fn mean(&self) -> f64 {
        let length = self.values.len();
        // 1: that of the last sample.
        let before = |samples: usize| self.values[(self.next + length - samples) % length];
        let at =
            |samples: usize| (1.0 - self.rest) * before(samples) + self.rest * before(samples + 1);
        0.5 * (at(self.whole + 1) + at(self.whole + 2))
    }

    /// Transfer function of the delay between samples, for `late` = exp(-j w T).
    fn transfer(&self, late: Complex<f64>) -> Complex<f64> {
        late.powu(self.whole as u32) * (late * self.rest + (1.0 - self.rest))
    }
}

/// An observer that is updated once per sample: [`DisturbanceObserver::estimate`] with the
/// position, then [`DisturbanceObserver::commanded`] with the force.
#[derive(Clone, Debug)]
pub struct DisturbanceObserver {
    settings: ObserverSettings,
    rate: f64,
    period_ns: i64,
    lowpass: Lowpass,
    /// The last positions, m, the newest first, and how many there are.
    positions: [f64; 2],
    seen: usize,
    /// Samples that must follow each other before the next estimate.
    needed: usize,
    /// Time of the last sample, ns.
    time: Option<i64>,
    /// Of feedback and feedforward.
    back: DelayLine,
    forward: DelayLine,
    /// Of the last sample, N, within the limit.
    estimate: f64,
}

impl DisturbanceObserver {
    /// `rate` in Hz; the settings must be those of [`ObserverSettings::check`].
    pub fn new(settings: ObserverSettings, rate: f64) -> DisturbanceObserver {
        DisturbanceObserver {
            settings,
            rate,
            period_ns: (1e9 / rate).round() as i64,
            lowpass: settings.lowpass(rate),
            positions: [0.0; 2],
            seen: 0,
            needed: 2,
            time: None,
            back: DelayLine::new(settings.delay * rate),
            forward: DelayLine::new(settings.forward_delay * rate),
            estimate: 0.0,
        }
    }

    /// The force against the disturbance, N, for the sample at `time` (ns) with the measured
    /// `position` (m). Of samples that do not follow each other nothing is concluded: the estimate
    /// is kept until as many of them do as the delay is long, and three at least.
    pub fn estimate(&mut self, time: i64, position: f64) -> f64 {
        // Assumed: stamps that vary by more than 2 % of a period give no acceleration.
        let follows = self
            .time
            .is_some_and(|last| (time - last - self.period_ns).abs() <= self.period_ns / 50);
        if !follows {
            self.seen = 0;
            // After lost samples only forces of samples that follow each other are in their place.
            let reach = |line: &DelayLine| line.whole + 2 + usize::from(line.rest > 0.0);
            let longest = reach(&self.back).max(reach(&self.forward));
            self.needed = if self.time.is_some() { longest } else { 2 };
        }
        self.time = Some(time);
        if self.seen >= self.needed {
            let change = position - 2.0 * self.positions[0] + self.positions[1];
            let accelerating = self.settings.mass * change * self.rate * self.rate;
            let known = self.back.mean() + self.forward.mean();
            let estimate = self.lowpass.filter(known - accelerating);
            if estimate.is_finite() {
                self.estimate = estimate.clamp(-self.settings.limit, self.settings.limit);
            } else {
                self.lowpass.reset();
                self.estimate = 0.0;
            }
        }
        self.positions = [position, self.positions[0]];
        self.seen = (self.seen + 1).min(self.needed);
        self.estimate
    }

    /// The forces, N, that the controller commands until the next sample: of the feedback with all
    /// that is not fed forward, and fed forward to accelerate the mass. Not part of them is what is
    /// fed forward against friction and effects.
    pub fn commanded(&mut self, back: f64, forward: f64) {
        self.back.push(back);
        self.forward.push(forward);
    }

    /// New settings without a jump of the estimate: with another delay it is kept until samples
    /// give a new one.
    pub fn retune(&mut self, settings: ObserverSettings) {
        let delays = |settings: &ObserverSettings| (settings.delay, settings.forward_delay);
        if delays(&settings) != delays(&self.settings) {
            let estimate = self.estimate.clamp(-settings.limit, settings.limit);
            *self =
                DisturbanceObserver { estimate, ..DisturbanceObserver::new(settings, self.rate) };
            return;
        }
        self.lowpass.retune(&settings.lowpass(self.rate));
        self.settings = settings;
    }

    /// Forgets all samples.
    pub fn reset(&mut self) {
        self.lowpass.reset();
        self.back.values.fill(0.0);
        self.forward.values.fill(0.0);
        (self.seen, self.needed, self.time, self.estimate) = (0, 2, None, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Controller, ControllerSettings, Follower, Gains};
    use super::*;

    const RATE: f64 = 4000.0;
    const PERIOD: f64 = 1.0 / RATE;
    const SETTINGS: ObserverSettings = ObserverSettings {
        bandwidth: 50.0,
        limit: 500.0,
        mass: 40.0,
        delay: 0.0,
        forward_delay: 0.0,
    };

    /// Estimates on a free mass under a constant disturbance, with some force of the controller
    /// that reaches the mass `late` samples after the command.
    fn estimates(settings: ObserverSettings, disturbance: f64, late: usize) -> Vec<f64> {
        let mut observer = DisturbanceObserver::new(settings, RATE);
        let (mut x, mut v) = (0.0, 0.0);
        let mut way = std::collections::VecDeque::from(vec![0.0; late]);
        (0..400)
            .map(|k| {
                let found = observer.estimate(k * 250_000, x);
                let force = 100.0 * (0.1 * k as f64).sin();
                observer.commanded(force, 0.0);
                way.push_back(force);
                let a = (way.pop_front().unwrap() - disturbance) / 40.0;
                x += v * PERIOD + 0.5 * a * PERIOD * PERIOD;
                v += a * PERIOD;
                found
            })
            .collect()
    }

    /// Step response of the Butterworth lowpass, closed form.
    fn step(time: f64, bandwidth: f64) -> f64 {
        let phase = TAU * bandwidth * FRAC_1_SQRT_2 * time;
        1.0 - (-phase).exp() * (phase.cos() + phase.sin())
    }

    #[test]
    fn a_constant_force_is_found_as_the_step_response_of_the_lowpass_whatever_the_command() {
        for (late, delay) in [(0, 0.0), (3, 3.0 * PERIOD)] {
            let found = estimates(ObserverSettings { delay, ..SETTINGS }, 30.0, late);
            // The first residual comes with the third sample and stands for the two before it.
            for (k, found) in found.iter().enumerate().skip(2) {
                let expected = 30.0 * step((k as f64 - 1.5) * PERIOD, 50.0);
                assert!((found - expected).abs() < 0.03, "{k}: {found} N, expected {expected} N");
            }
        }
        // What is taken for a delay that is not there shows as a disturbance.
        let wrong = estimates(ObserverSettings { delay: 3.0 * PERIOD, ..SETTINGS }, 30.0, 0);
        assert!((wrong[350] - 30.0).abs() > 0.1, "{} N", wrong[350]);
    }

    #[test]
    fn the_estimate_is_bounded_and_a_lost_sample_is_no_disturbance() {
        let bounded = estimates(ObserverSettings { limit: 10.0, ..SETTINGS }, -30.0, 0);
        assert!(bounded.iter().all(|found| found.abs() <= 10.0) && bounded[399] == -10.0);
        let mut observer = DisturbanceObserver::new(SETTINGS, RATE);
        // A mass that moves at 0.5 m/s without any force; 20 samples are lost.
        let kept = |k: &i64| !(100..120).contains(k);
        for k in (0..400).filter(kept) {
            let found = observer.estimate(k * 250_000, 0.5 * PERIOD * k as f64);
            observer.commanded(0.0, 0.0);
            assert!(found.abs() < 1e-3, "{k}: {found} N");
        }
        assert!(observer.estimate(400 * 250_000, f64::NAN).is_finite());
        // The same under a force that reaches the mass five samples later.
        let late = ObserverSettings { delay: 5.0 * PERIOD, ..SETTINGS };
        let mut observer = DisturbanceObserver::new(late, RATE);
        let force = |k: i64| 100.0 * (0.1 * k as f64).sin();
        let (mut x, mut v) = (0.0, 0.5);
        for k in 0..400 {
            if kept(&k) {
                let found = observer.estimate(k * 250_000, x);
                observer.commanded(force(k), 0.0);
                assert!(found.abs() < 0.1, "{k}: {found} N");
            }
            let a = if k < 5 { 0.0 } else { force(k - 5) / 40.0 };
            x += v * PERIOD + 0.5 * a * PERIOD * PERIOD;
            v += a * PERIOD;
        }
    }

    #[test]
    fn a_controller_with_it_has_the_computed_transfer_function() {
        for delay in [0.0, 0.6e-3] {
            let paper = ControllerSettings::paper(40.0, RATE, 2000.0);
            let plain = ControllerSettings {
                mass_feedforward: 0.0,
                // Without an integral next to the observer's: both would leave a ramp.
                gains: Gains { i: 0.0, ..paper.gains },
                limits: (-1e9, 1e9),
                ..paper
            };
            let observer = ObserverSettings { delay, limit: 1e9, ..SETTINGS };
            let settings = ControllerSettings { observer: Some(observer), ..plain.clone() };
            for frequency in [20.0, 80.0, 250.0] {
                let mut controller = Controller::new(settings.clone()).unwrap();
                let mut follower = Follower::new(f64::INFINITY);
                follower.hold(0, 0.0);
                let (mut sine, mut cosine, mut count) = (0.0, 0.0, 0.0);
                for k in 0..4800i64 {
                    let phase = TAU * frequency * k as f64 * PERIOD;
                    let x = 1e-6 * phase.sin();
                    let force = controller.update(k * 250_000, x, &mut follower).output;
                    if k >= 800 {
                        (sine, cosine) = (sine + force * phase.sin(), cosine + force * phase.cos());
                        count += 1.0;
                    }
                }
                let found = -Complex::new(sine, cosine) * (2.0 / (count * 1e-6));
                let expected = settings.transfer(frequency);
                // The observer integrates: it keeps a constant, which no sine has.
                let error = (found - expected).norm() / expected.norm();
                assert!(error < 2e-3, "{frequency} Hz: {found}, expected {expected}");
                let apart = (plain.transfer(frequency) - expected).norm() / expected.norm();
                assert!(apart > 0.02, "{frequency} Hz: the observer changes nothing");
            }
        }
    }

    #[test]
    fn impossible_settings_are_refused_by_name() {
        for (settings, name) in [
            (ObserverSettings { bandwidth: 2000.0, ..SETTINGS }, "disturbance_observer.bandwidth"),
            (ObserverSettings { limit: 0.0, ..SETTINGS }, "disturbance_observer.limit"),
            (ObserverSettings { mass: 0.0, ..SETTINGS }, "feedforward.mass"),
            (ObserverSettings { delay: f64::NAN, ..SETTINGS }, "disturbance_observer.delay"),
        ] {
            let reported = settings.check(RATE).unwrap_err().to_string();
            assert!(reported.contains(name), "{reported}");
        }
    }
}
