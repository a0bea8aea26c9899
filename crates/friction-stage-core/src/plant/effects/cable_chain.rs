//! Cable chain: the cables of the carriage pull it towards where they hang free, with some
//! hysteresis.
//!
//! F = -k (x - xc) - A h, along +x on the carriage: k stiffness (N/m), xc center (m), A amplitude
//! of the hysteresis (N). h runs from -1 to 1 with the path, w width of the transition (m), in one
//! of three forms: with u = h sign(v) and s the path,
//! - `dahl`: du/ds = (1 - u) / w,
//! - `bouc_wen`: du/ds = (1 - u |u|) / w,
//! - `slider`: du/ds = 1 / w up to u = 1.
//!
//! Exact for each step. Source of the hysteresis: Dahl's model with exponent 1 (P. Dahl, "A solid
//! friction model", 1968); that of Bouc and Wen with exponent 2 (Wen, J. Eng. Mech. Div. ASCE
//! 102(2), 1976) and equal parts in loading and unloading; spring and slider (Iwan, J. Appl. Mech.
//! 33, 1966). Of the spring: assumed linear over the stroke. Sizes: assumed, 1 to 10 N over the
//! stroke. Not modelled: bumps of single links, dwell-time creep of the cables.

use std::iter;

use super::regression::{along, largest_over_decades, least_squares};
use super::{
    Action, EffectDescriptor, EffectParameter, ForceLaw, Motion, Multiplicity, RecordSpecific,
    Residual, Role, descriptor,
};

/// Path over which the hysteresis turns where a model does not say it, m. Assumed.
const WIDTH: f64 = 1e-3;
/// Shortest and longest one of a proposal, m: shorter is what the bristles of the guides do, longer
/// a spring on any stroke.
const WIDTHS: (f64, f64) = (1e-4, 0.3);
/// Least stiffness of a proposal, N/m: with less, a fit cannot find the center.
const SOFTEST: f64 = 0.1;

/// Names of the forms, in the order of their numbers in a slice of values.
const FORMS: [&str; 3] = ["dahl", "bouc_wen", "slider"];

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "cable_chain",
    role: Role::CarriageForce,
    law: "F = -stiffness (x - center) - amplitude h, u = h sign(v); dahl: du/ds = (1 - u) / \
          width, bouc_wen: (1 - u |u|) / width, slider: 1 / width up to u = 1",
    source: "linear spring (assumed) and hysteresis of Dahl 1968, Bouc and Wen 1976, or Iwan 1966 \
             (slider)",
    telltale: "low-order polynomial in position at every speed, not seen by the force cell",
    parameters: &[
        EffectParameter::required(
            "stiffness",
            "N/m",
            "spring stiffness of the cables",
            (0.0, 1e5),
            10.0,
        ),
        EffectParameter::optional(
            "center",
            "m",
            "position at which the cables do not pull",
            (-10.0, 10.0),
            0.05,
            0.0,
        ),
        EffectParameter::optional(
            "amplitude",
            "N",
            "force of the hysteresis",
            (0.0, 1000.0),
            1.0,
            0.0,
        ),
        EffectParameter::optional(
            "width",
            "m",
            "path over which the hysteresis turns",
            (1e-6, 1.0),
            1e-3,
            WIDTH,
        ),
        EffectParameter::choice(
            "form",
            "law of the hysteresis: of Dahl, of Bouc and Wen, or of a spring and a slider",
            &FORMS,
        ),
    ],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[20.0, 0.0, 0.5, 1e-3, 0.0],
    check: descriptor::any,
    free: |values, index| index < AMPLITUDE || (index < FORM && values[AMPLITUDE] > 0.0),
    build: |values| Action::CarriageForce(Box::new(CableChain::new(values))),
    proposal: Some(propose),
    starts: forms_and_widths,
    curve: None,
};

/// Hysteresis that a fit begins with where the residual shows none, N. Assumed.
const LEAST_LOOP: f64 = 0.1;
/// Where these values stand.
const AMPLITUDE: usize = 2;
const WIDTH_AT: usize = 3;
const FORM: usize = 4;

#[derive(Clone, Copy, Debug)]
enum Form {
    Dahl,
    BoucWen,
    Slider,
}

impl Form {
    /// u after `path` widths of motion.
    fn after(self, u: f64, path: f64) -> f64 {
        match self {
            Form::Dahl => 1.0 + (u - 1.0) * (-path).exp(),
            // A tangent up to 0, then a hyperbolic one.
            Form::BoucWen => match path + u.min(0.0).atan() {
                before if before < 0.0 => before.tan(),
                // tanh(a + b) from tanh(a) and tanh(b): u may be 1.
                beyond => (beyond.tanh() + u.max(0.0)) / (1.0 + beyond.tanh() * u.max(0.0)),
            },
            Form::Slider => (u + path).min(1.0),
        }
    }
}

#[derive(Debug)]
struct CableChain {
    form: Form,
    stiffness: f64,
    center: f64,
    amplitude: f64,
    width: f64,
    /// h, -1 to 1.
    hysteresis: f64,
}

impl CableChain {
    fn new(values: &[f64]) -> CableChain {
        let form = match values[FORM] {
            code if code < 0.5 => Form::Dahl,
            code if code < 1.5 => Form::BoucWen,
            _ => Form::Slider,
        };
        CableChain {
            form,
            stiffness: values[0],
            center: values[1],
            amplitude: values[2],
            width: values[WIDTH_AT],
            hysteresis: 0.0,
        }
    }
}

impl ForceLaw for CableChain {
    fn force(&mut self, motion: &Motion, step: f64) -> f64 {
        let before = self.hysteresis;
        if self.amplitude > 0.0 {
            let direction = motion.velocity.signum();
            let path = motion.velocity.abs() * step / self.width;
            self.hysteresis = direction * self.form.after(direction * before, path);
        }
        let middle = 0.5 * (before + self.hysteresis);
        -self.stiffness * (motion.position - self.center) - self.amplitude * middle
    }

    fn stiffness(&self) -> f64 {
        self.stiffness + self.amplitude / self.width
    }

    fn stored_energy(&self, position: f64) -> f64 {
        let stretch = position - self.center;
        0.5 * self.stiffness * stretch * stretch
            + 0.5 * self.amplitude * self.width * self.hysteresis * self.hysteresis
    }

    fn reset(&mut self) {
        self.hysteresis = 0.0;
    }
}

/// Spring from the slope of the residual over position, hysteresis from its loop, at the width at
/// which both explain most.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let base = least_squares(residual.force, |_| [1.0])?;
    let fit = |width: f64| {
        let hysteresis = {
            let mut chain = CableChain::new(&[0.0, 0.0, 1.0, width, 0.0]);
            along(residual, |motion, step| chain.force(motion, step))
        };
        least_squares(residual.force, |k| [1.0, residual.position[k], hysteresis[k]])
    };
    let width = largest_over_decades(WIDTHS.0, WIDTHS.1, |width| {
        fit(width).map_or(0.0, |fit| fit.explained)
    });
    let fit = fit(width)?;
    let [offset, slope, amplitude] = fit.coefficients;
    let (stiffness, amplitude) = ((-slope).max(SOFTEST), amplitude.max(0.0));
    (fit.improves_on(&base) && (slope < 0.0 || amplitude > 0.0))
        .then(|| vec![stiffness, (offset / stiffness).clamp(-10.0, 10.0), amplitude, width, 0.0])
}

/// The spring alone, and with a hysteresis of the width as it was proposed, and of the assumed one:
/// where the loop is small compared with the spring, both bias the fit of the guides, and the
/// proposed width may be wrong.
fn forms_and_widths(values: &[f64], _step: f64) -> Vec<Vec<f64>> {
    let (mut spring, mut proposed) = (values.to_vec(), values.to_vec());
    spring[AMPLITUDE] = 0.0;
    proposed[AMPLITUDE] = proposed[AMPLITUDE].max(LEAST_LOOP);
    let mut assumed = proposed.clone();
    assumed[WIDTH_AT] = WIDTH;
    let with_loop =
        [proposed, assumed].into_iter().flat_map(|values| descriptor::every_form(&values, FORM, 3));
    iter::once(spring).chain(with_loop).collect()
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{Record, proposal};
    use super::*;

    fn chain() -> CableChain {
        CableChain::new(&[100.0, 0.01, 2.0, 1e-3, 0.0])
    }

    #[test]
    fn spring_pulls_towards_the_center_and_hysteresis_against_the_motion() {
        let mut chain = chain();
        let step = 1e-4;
        let mut force = 0.0;
        for k in 0..10_000 {
            let position = 0.1 * k as f64 * step;
            force = chain.force(&Motion { position, velocity: 0.1, ..Motion::default() }, step);
        }
        // After 100 mm in one direction the hysteresis is fully turned: -100 (0.1 - 0.01) - 2.
        assert!((force + 11.0).abs() < 1e-2, "{force}");
    }

    /// Against small steps of the differential equations, and in one step as in many.
    #[test]
    fn hysteresis_of_every_form_solves_its_equation() {
        let rate = |form: Form, u: f64| match form {
            Form::Dahl => 1.0 - u,
            Form::BoucWen => 1.0 - u * u.abs(),
            Form::Slider => f64::from(u8::from(u < 1.0)),
        };
        for form in [Form::Dahl, Form::BoucWen, Form::Slider] {
            let rate = |u: f64| rate(form, u);
            for start in [-1.0, -0.3, 0.0, 0.6, 1.0] {
                for path in [0.0, 0.2, 0.9, 3.0] {
                    let steps = 100_000;
                    let small = path / f64::from(steps);
                    let expected = (0..steps)
                        .fold(start, |u, _| (u + small * rate(u + 0.5 * small * rate(u))).min(1.0));
                    let at_once = form.after(start, path);
                    let in_two = form.after(form.after(start, 0.4 * path), 0.6 * path);
                    assert!(
                        (at_once - expected).abs() < 1e-4,
                        "{form:?} {start} {path}: {at_once} {expected}"
                    );
                    assert!((at_once - in_two).abs() < 1e-12, "{form:?} {start} {path}");
                }
            }
        }
    }

    #[test]
    fn a_closed_loop_of_motion_costs_the_area_of_the_hysteresis() {
        let mut chain = chain();
        let step = 1e-5;
        let mut work = 0.0;
        // Two round trips of +-10 mm at 0.1 m/s; the second is the closed loop: 2 A x 20 mm less
        // the two turns (2 A w each).
        for k in 0..80_000u32 {
            let phase = k % 40_000;
            let (position, velocity) = if phase < 20_000 {
                (-0.01 + 1e-6 * f64::from(phase), 0.1)
            } else {
                (0.01 - 1e-6 * f64::from(phase - 20_000), -0.1)
            };
            let motion = Motion { position, velocity, ..Motion::default() };
            let force = chain.force(&motion, step);
            if k >= 40_000 {
                work -= force * velocity * step;
            }
        }
        let expected = 2.0 * 2.0 * 0.02 - 2.0 * 2.0 * 2.0 * 1e-3;
        assert!((work / expected - 1.0).abs() < 1e-3, "{work} {expected}");
    }

    #[test]
    fn proposal_finds_spring_center_and_hysteresis_under_noise_and_nothing_in_noise() {
        for width in [1e-3, 0.02] {
            let found = proposal(&DESCRIPTOR, &[80.0, 0.06, 1.5, width, 0.0]);
            assert!(
                (found[0] / 80.0 - 1.0).abs() < 0.02 && (found[1] - 0.06).abs() < 3e-3,
                "{found:?}"
            );
            assert!(
                (found[2] / 1.5 - 1.0).abs() < 0.05 && (found[3] / width - 1.0).abs() < 0.5,
                "{found:?}"
            );
        }
        let none = Record::motion().with_noise(0.3, 3);
        assert!(propose(&none.residual()).is_none());
    }
}
