//! Where the residual of a hidden effect sits that the model does not have.

mod declared;

use std::f64::consts::TAU;

use blind_tests::effects::{Law, Now, RailJoint, Side};
use blind_tests::{Effect, Setup};
use friction_stage_identify::{
    Hypothesis, Measured, MotionSignal, ResidualLocation, SideResidual, Tolerances,
};

use declared::declared;

/// A force of a stage that the list of effects lacks.
#[derive(Clone, Copy, Debug)]
enum Unknown {
    /// A hum of the floor whose pitch wanders around 31 Hz: 2 N.
    Hum,
    /// A knock of 60 N over 20 ms at 9.3 s.
    Knock,
    /// A rattle of 3 N on the way back, at 83 and 127 Hz.
    Rattle,
    /// A brake of 20 N s/m in the motor, before the force cell.
    MotorBrake,
    /// A motor that gives 0.01 % less per newton.
    Droop,
    /// A motor that lags by 1 ms.
    Lag,
    /// 2 kg that are not declared.
    Load,
}

impl Law for Unknown {
    fn name(&self) -> &'static str {
        "unknown"
    }
    fn side(&self) -> Side {
        match self {
            Self::MotorBrake | Self::Droop | Self::Lag => Side::Motor,
            _ => Side::Carriage,
        }
    }
    fn listed(&self) -> bool {
        false
    }
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        Vec::new()
    }
    fn scaled(&self, _factor: f64) -> Effect {
        self.copy()
    }
    fn copy(&self) -> Effect {
        Box::new(*self)
    }
    fn delay(&self) -> Option<f64> {
        matches!(self, Self::Lag).then_some(1e-3)
    }
    fn motor(&self, now: &Now<'_>, force: f64, _state: &[f64]) -> f64 {
        match self {
            Self::MotorBrake => force - 20.0 * now.v,
            Self::Droop => force - 1e-4 * force * force.abs(),
            Self::Lag => now.held(1e-3),
            _ => force,
        }
    }
    fn added_mass(&self) -> f64 {
        if matches!(self, Self::Load) { 2.0 } else { 0.0 }
    }
    fn carriage(&self, now: &Now<'_>, _state: &[f64]) -> f64 {
        match self {
            Self::Hum => 2.0 * (TAU * 31.0 * now.time + 3.0 * (1.7 * now.time).sin()).sin(),
            Self::Knock => {
                let since = (now.time - 9.3) / 0.02;
                if (0.0..1.0).contains(&since) { 60.0 * (0.5 * TAU * since).sin() } else { 0.0 }
            }
            Self::Rattle if now.v < -1e-3 => {
                3.0 * ((TAU * 83.0 * now.time).sin() + (TAU * 127.0 * now.time).sin())
            }
            _ => 0.0,
        }
    }
}

/// Of the check record of a stage that is as declared but for a hidden effect.
fn located(effect: Option<Effect>, seed: u64) -> Option<SideResidual> {
    let model = declared();
    let setup = Setup { mass_tolerance: 0.0, guide_tolerance: 0.0, ..Setup::new(seed) };
    let run = setup.with_all(effect.into_iter().collect()).generate().unwrap();
    let measured = Measured::new(&run.check.to_trace(), &model, "check").unwrap();
    let hypothesis = Hypothesis::new(&model, Tolerances::default()).unwrap();
    hypothesis.residual_location(&measured, hypothesis.floor(&measured), None).unwrap()
}

fn location(unknown: Unknown, seed: u64) -> ResidualLocation {
    let found = located(Some(Box::new(unknown)), seed).expect("more than noise");
    println!("{unknown:?}: {found:?}");
    let motor = matches!(unknown.side(), Side::Motor);
    assert_eq!(found.side == friction_stage_core::plant::Side::Motor, motor, "{found:?}");
    found.location
}

#[test]
fn a_stage_as_declared_leaves_nothing_to_locate() {
    assert_eq!(located(None, 1), None);
}

#[test]
fn a_hum_is_in_its_band() {
    let band = location(Unknown::Hum, 2).band.expect("a band");
    assert!(band.from < 31.0 && band.to > 31.0 && band.to - band.from < 5.0, "{band:?}");
}

#[test]
fn a_knock_is_an_event_at_its_instant() {
    let [from, to] = location(Unknown::Knock, 3).event.expect("an event");
    assert!((from - 9.3).abs() < 0.02 && to < 9.5, "{from} {to}");
}

#[test]
fn a_rail_joint_is_at_its_place() {
    let joint = RailJoint { force: 8.0, center: -0.02, width: 0.003 };
    let found = located(Some(joint.into()), 4).expect("more than noise");
    println!("{found:?}");
    let place = found.location.place.expect("a place");
    assert!(place.from > -0.0235 && place.to < -0.0165 && place.share < 0.1, "{place:?}");
}

#[test]
fn a_rattle_is_in_its_direction() {
    let direction = location(Unknown::Rattle, 5).direction.expect("a direction");
    assert!(direction.power < 0.1 && direction.time > 0.3, "{direction:?}");
}

#[test]
fn a_force_is_correlated_with_the_signal_that_makes_it() {
    for (unknown, signal, sign) in [
        (Unknown::MotorBrake, MotionSignal::Velocity, -1.0),
        (Unknown::Droop, MotionSignal::Command, -1.0),
        (Unknown::Lag, MotionSignal::Jerk, -1.0),
        (Unknown::Load, MotionSignal::Acceleration, -1.0),
    ] {
        let found = location(unknown, 6);
        // Where friction is little of the command, acceleration and command are nearly the same.
        let most = found.correlations.first().expect("a correlation").correlation.abs();
        let one = found.correlations.iter().find(|one| one.signal == signal);
        let correlation = sign * one.expect("of the signal").correlation;
        assert!(correlation > 0.8 && correlation > most - 0.02, "{unknown:?}: {found:?}");
    }
}
