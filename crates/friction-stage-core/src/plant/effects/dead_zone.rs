//! Dead zone: a drive that answers small commands with nothing.
//!
//! F = -max(-w, min(w, u)), along +x on the motor side: u commanded force as it arrives after an
//! `actuator_lag` (N), w width (N). Up to w the motor makes no force, beyond it w less than
//! commanded. Source: dead zone of an actuator (G. Tao, P. Kokotovic, IEEE Trans. Automatic Control
//! 39(1), 1994, eq. 2, equal on both sides and of slope 1): dead time of the bridge, threshold of a
//! valve or an analogue input. Sizes: assumed, 0.1 to 2 % of the peak force. Not modelled: sides
//! that differ, a slope other than 1 (a `motor_gain`), a zone that depends on the current's rate.
//!
//! A force cell shows it alone. Without one it looks like Coulomb friction where command and
//! velocity have one sign: braking tells them apart, as the dead zone lengthens the way there and
//! friction shortens it.

use super::regression::{largest_over_decades, least_squares};
use super::{
    Action, CommandLaw, CommandStage, EffectDescriptor, EffectParameter, Motion, Multiplicity,
    RecordSpecific, Residual, Role, descriptor,
};

/// Largest width, N.
const WIDEST: f64 = 1e5;
/// Narrowest zone of a proposal, as a part of the largest command: 1/1000 shows in no record.
const NARROWEST: f64 = 1e-3;

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "dead_zone",
    role: Role::Command(CommandStage::Threshold),
    law: "F = -max(-width, min(width, command))",
    source: "Tao and Kokotovic 1994, equal sides and slope 1",
    telltale: "as much force missing at all but the smallest commands, with their sign, seen by \
               the force cell",
    parameters: &[EffectParameter::required(
        "width",
        "N",
        "largest command that makes no force",
        (0.0, WIDEST),
        0.5,
    )],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[2.0],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::Command(Box::new(DeadZone { width: values[0] })),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct DeadZone {
    width: f64,
}

impl CommandLaw for DeadZone {
    fn change(&mut self, command: f64, _motion: &Motion, _step: f64) -> f64 {
        -command.clamp(-self.width, self.width)
    }
}

/// The width whose missing force takes most out of the residual, beside errors of gain and
/// friction.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let largest = residual
        .command
        .iter()
        .filter(|command| command.is_finite())
        .fold(0.0f64, |largest, command| largest.max(command.abs()));
    if largest <= 0.0 {
        return None;
    }
    let base = least_squares(residual.force, |k| [1.0, residual.command[k], residual.friction[k]])?;
    let fit = |width: f64| {
        least_squares(residual.force, |k| {
            let command = residual.command[k];
            [1.0, command, residual.friction[k], -(command / width).clamp(-1.0, 1.0)]
        })
    };
    let explained = |width: f64| fit(width).map_or(f64::NEG_INFINITY, |fit| fit.explained);
    let width = largest_over_decades(NARROWEST * largest, largest, explained);
    let fit = fit(width)?;
    // What is missing beyond the zone is its width, which shows better than where it ends.
    let missing = fit.coefficients[3];
    (fit.improves_on(&base) && missing > 0.0).then(|| vec![missing.min(WIDEST)])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    #[test]
    fn small_commands_make_no_force_and_large_ones_lack_the_width() {
        let mut zone = DeadZone { width: 3.0 };
        let mut force = |command: f64| command + zone.change(command, &Motion::default(), 1e-4);
        for (command, expected) in [(2.9, 0.0), (-2.9, 0.0), (10.0, 7.0), (-10.0, -7.0)] {
            assert!((force(command) - expected).abs() < 1e-12, "{command} N");
        }
    }

    #[test]
    fn proposal_finds_the_width_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[4.0]);
        assert!((found[0] / 4.0 - 1.0).abs() < 0.1, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
