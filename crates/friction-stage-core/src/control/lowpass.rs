//! Second-order lowpass, sampled.

use std::f64::consts::PI;

use nalgebra::Complex;

/// H(s) = w^2 / (s^2 + 2 zeta w s + w^2) by the bilinear transform with prewarping at w; zero
/// initial state.
#[derive(Clone, Debug)]
pub struct Lowpass {
    input_gain: f64,
    feedback: [f64; 2],
    /// Transposed direct form II memory. It depends on the coefficients.
    memory: [f64; 2],
    /// The last two inputs and outputs, newest first. They do not.
    inputs: [f64; 2],
    outputs: [f64; 2],
}

impl Lowpass {
    /// `frequency` in Hz, below half the sampling `rate` in Hz; `damping` is zeta.
    pub fn new(frequency: f64, damping: f64, rate: f64) -> Lowpass {
        let k = (PI * frequency / rate).tan();
        let norm = (1.0 + 2.0 * damping * k + k * k).recip();
        Lowpass {
            input_gain: k * k * norm,
            feedback: [2.0 * (k * k - 1.0) * norm, (1.0 - 2.0 * damping * k + k * k) * norm],
            memory: [0.0; 2],
            inputs: [0.0; 2],
            outputs: [0.0; 2],
        }
    }

    /// The output for the next input, in the unit of the input.
    #[inline]
    pub fn filter(&mut self, input: f64) -> f64 {
        let scaled = self.input_gain * input;
        let output = scaled + self.memory[0];
        self.memory[0] = 2.0 * scaled - self.feedback[0] * output + self.memory[1];
        self.memory[1] = scaled - self.feedback[1] * output;
        self.inputs = [input, self.inputs[0]];
        self.outputs = [output, self.outputs[0]];
        output
    }

    /// Takes over the coefficients of `other`, not its memory. The last inputs and outputs keep
    /// their effect: a constant stays constant, however often this is done.
    pub fn retune(&mut self, other: &Lowpass) {
        (self.input_gain, self.feedback) = (other.input_gain, other.feedback);
        let ([input, before], [output, output_before]) = (self.inputs, self.outputs);
        let [first, second] = self.feedback;
        // What the memory would be with these inputs and outputs (direct form I).
        self.memory = [
            self.input_gain * (2.0 * input + before) - first * output - second * output_before,
            self.input_gain * input - second * output,
        ];
    }

    /// Forgets all inputs.
    pub fn reset(&mut self) {
        (self.memory, self.inputs, self.outputs) = ([0.0; 2], [0.0; 2], [0.0; 2]);
    }

    /// Transfer function as sampled, at `z` = exp(j w T).
    pub fn transfer(&self, z: Complex<f64>) -> Complex<f64> {
        let late = z.inv();
        let [first, second] = self.feedback;
        self.input_gain * (late + 1.0) * (late + 1.0) / ((late * second + first) * late + 1.0)
    }

    /// |H| and its phase, rad, of the continuous filter at `frequency / cutoff = ratio`.
    pub fn response(ratio: f64, damping: f64) -> (f64, f64) {
        let (real, imaginary) = (1.0 - ratio * ratio, 2.0 * damping * ratio);
        (real.hypot(imaginary).recip(), -imaginary.atan2(real))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Amplitude of the response to a sine, by projection over whole periods after the transient.
    fn gain(frequency: f64, cutoff: f64, rate: f64) -> f64 {
        let mut lowpass = Lowpass::new(cutoff, std::f64::consts::FRAC_1_SQRT_2, rate);
        let period = (rate / frequency).round() as usize;
        let output: Vec<f64> = (0..60 * period)
            .map(|k| lowpass.filter((2.0 * PI * k as f64 / period as f64).sin()))
            .collect();
        let tail = &output[50 * period..];
        let project = |f: fn(f64) -> f64| -> f64 {
            tail.iter()
                .enumerate()
                .map(|(k, y)| y * f(2.0 * PI * k as f64 / period as f64))
                .sum::<f64>()
        };
        2.0 * project(f64::sin).hypot(project(f64::cos)) / tail.len() as f64
    }

    #[test]
    fn transfer_function_has_the_gain_that_a_sine_meets() {
        let at = |frequency: f64| Complex::from_polar(1.0, 2.0 * PI * frequency / 4000.0);
        let lowpass = Lowpass::new(360.0, std::f64::consts::FRAC_1_SQRT_2, 4000.0);
        for frequency in [40.0, 400.0, 1000.0] {
            let expected = gain(frequency, 360.0, 4000.0);
            let found = lowpass.transfer(at(frequency)).norm();
            assert!((found - expected).abs() < 1e-6, "{frequency} Hz: {found}, {expected}");
        }
        // At its own frequency the prewarped filter is the continuous one: -j / (2 zeta).
        let found = Lowpass::new(360.0, 0.6, 4000.0).transfer(at(360.0));
        assert!((found - Complex::new(0.0, -1.0 / 1.2)).norm() < 1e-12, "{found}");
    }

    #[test]
    fn new_coefficients_leave_a_constant_and_the_own_ones_all_as_it_is() {
        let new = |frequency: f64| Lowpass::new(frequency, std::f64::consts::FRAC_1_SQRT_2, 4000.0);
        let mut lowpass = new(360.0);
        let settled = (0..4000).map(|_| lowpass.filter(-6.0)).last().unwrap();
        assert!((settled + 6.0).abs() < 1e-9, "{settled}");
        for k in 0..400 {
            lowpass.retune(&new([180.0, 90.0, 360.0, 500.0][k % 4]));
            for _ in 0..k % 5 {
                let output = lowpass.filter(-6.0);
                assert!((output + 6.0).abs() < 1e-9, "{output} after {k} changes");
            }
        }
        // The same coefficients change nothing, whatever goes through.
        let (mut kept, mut retuned) = (new(360.0), new(360.0));
        for k in 0..1000 {
            let input = (0.3 * f64::from(k)).sin() + f64::from(k % 7);
            retuned.retune(&new(360.0));
            let (expected, found) = (kept.filter(input), retuned.filter(input));
            assert!((found - expected).abs() < 1e-9, "{found}, {expected}");
        }
    }

    #[test]
    fn passes_low_frequencies_halves_the_power_at_the_cutoff_and_falls_by_40_db_per_decade() {
        assert!((gain(4.0, 360.0, 4000.0) - 1.0).abs() < 1e-3);
        assert!((gain(400.0, 400.0, 4000.0) - std::f64::consts::FRAC_1_SQRT_2).abs() < 1e-3);
        assert!((gain(200.0, 20.0, 40_000.0) - 0.01).abs() < 1e-3);
    }
}
