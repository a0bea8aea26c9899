//! Signs and units, by whatever can be compared: reference and position, cell and command, force
//! and acceleration, the declared mass and friction.

use std::ops::Range;

use super::motion::Moment;
use super::regression::{ALIKE, Slope};
use super::{Examiner, RoughFit};
use crate::quality::finding::{DataFinding, Disagreement};
use crate::signals::Signal;
use friction_stage_core::model::{Guide, JointType};
use friction_stage_core::plant::EffectDescriptor;

/// Part of what a cell is off the command before it that it must be off the one behind it for the
/// two to be swapped. Assumed: what a motor adds is as far from either.
const SWAPPED: f64 = 0.3;
/// Standard deviations that a rough fit must be away from what is declared. Assumed: what the fit
/// lacks is no white noise.
const SURELY: f64 = 5.0;
/// What one signal may be of another that should be the same. Assumed: what is beyond is no error
/// of a gain.
const SAME: Range<f64> = 0.5..2.0;

/// What no stage does: speed, m/s, and acceleration, m/s². Linear guides with recirculating balls
/// are rated up to 5 m/s and up to 10 m/s at the most, linear motors reach some 300 m/s². Assumed
/// with a factor of 3 for the latter.
const FASTEST_PRISMATIC: (f64, f64) = (10.0, 1e3);
/// The same of a revolute joint, rad/s and rad/s²: grinding spindles reach 1e4 rad/s, which the
/// smallest motors do in 10 ms. Assumed.
const FASTEST_REVOLUTE: (f64, f64) = (1e4, 1e6);
/// Part of the moments that must be beyond it. Assumed: dropouts are fewer.
const BEYOND: f64 = 0.01;

impl Examiner<'_> {
    /// Whether the motion is one that no stage makes, for longer than dropouts explain.
    pub(super) fn possible_motion(&mut self, moments: &[Moment]) {
        let (fastest, sharpest) = match self.joint() {
            JointType::Prismatic => FASTEST_PRISMATIC,
            JointType::Revolute => FASTEST_REVOLUTE,
        };
        let usually_below = |of: fn(&Moment) -> f64| {
            let mut sizes: Vec<f64> = moments.iter().map(|m| of(m).abs()).collect();
            sizes.sort_by(f64::total_cmp);
            let beyond = (BEYOND * sizes.len() as f64).ceil() as usize;
            sizes.iter().rev().nth(beyond).copied().unwrap_or(0.0)
        };
        let speed = usually_below(|moment| moment.velocity);
        let acceleration = usually_below(|moment| moment.acceleration);
        if speed > fastest || acceleration > sharpest {
            self.findings.push(DataFinding::ImpossibleMotion {
                speed,
                fastest,
                acceleration,
                sharpest,
            });
        }
    }

    /// Signs and units, by whatever can be compared: reference and position, cell and command,
    /// force and acceleration.
    pub(super) fn signs_and_units(&mut self, cell: Option<RoughFit>, command: Option<RoughFit>) {
        let declared = self.model.map(|m| {
            let payload = |effect| match EffectDescriptor::read(effect) {
                Ok((descriptor, values)) => descriptor.constant_mass(&values),
                Err(_) => 0.0,
            };
            m.mass + m.effects.iter().map(payload).sum::<f64>()
        });
        let guides = self.model.and_then(|model| model.resolved_guides().ok());
        let of_guides =
            |value: fn(&Guide) -> f64| Some(guides.as_ref()?.iter().map(value).sum::<f64>());
        let (coulomb, viscous) =
            (of_guides(|guide| guide.coulomb_force), of_guides(|guide| guide.viscous_friction));
        let fits: Vec<(Signal, RoughFit)> = [(Signal::ForceCell, cell), (Signal::Force, command)]
            .into_iter()
            .filter_map(|(s, f)| Some((s, f?)))
            .collect();
        // an explained share below a half is no fit to draw conclusions from (assumed)
        for (signal, fit) in &fits {
            if fit.explained < 0.5 {
                self.findings
                    .push(DataFinding::Unrelated { signal: *signal, share: fit.explained });
            }
        }
        // at one speed all acceleration is where the motion begins and ends, and what the bristles
        // do there passes for a mass
        let one_speed =
            self.findings.iter().any(|finding| matches!(finding, DataFinding::OneSpeed { .. }));
        let moving: Vec<(Signal, RoughFit)> =
            fits.into_iter().filter(|(_, fit)| !one_speed && fit.explained >= 0.5).collect();
        let clear: Vec<(Signal, RoughFit)> =
            moving.iter().copied().filter(|(_, fit)| fit.knows_the_mass()).collect();
        let all = !clear.is_empty();
        let mut reported = false;
        // signs
        let negative: Vec<&(Signal, RoughFit)> =
            clear.iter().filter(|(_, f)| f.mass < 0.0).collect();
        let reference = self.reference_slope();
        if all
            && negative.len() == clear.len()
            && (clear.len() == 2 || reference.is_some_and(|s| s < 0.0))
        {
            self.findings.push(DataFinding::SwappedSign {
                signal: Signal::Position,
                mass: negative[0].1.mass,
                or_every_force: !reference.is_some_and(|s| s < 0.0),
            });
            reported = true;
        } else {
            for (signal, fit) in &negative {
                self.findings.push(DataFinding::SwappedSign {
                    signal: *signal,
                    mass: fit.mass,
                    or_every_force: false,
                });
                reported = true;
            }
        }
        // units of the forces and of the position against the declared mass; a signal that is cut
        // off has another mass for that
        let cut =
            self.findings.iter().any(|finding| matches!(finding, DataFinding::Clipped { .. }));
        if let Some(declared) = declared {
            let ratios: Vec<(Signal, RoughFit, f64)> =
                clear.iter().map(|(s, f)| (*s, *f, f.mass.abs() / declared)).collect();
            let position_unit = ratios.first().and_then(|(_, fit, ratio)| {
                let same = ratios.iter().all(|(_, _, other)| (other / ratio).ln().abs() < 0.3);
                let friction: f64 = coulomb?;
                let fits = (0.2..5.0).contains(&(fit.coulomb.abs() / friction));
                let (unit, signal) = position_unit(*ratio)?;
                let in_velocities = if signal == Signal::Time { ratio.sqrt() } else { *ratio };
                let fits = fits && !is_as_declared(fit.viscous, viscous?, in_velocities);
                (same && fits && !cut).then_some((unit, signal, *fit))
            });
            if let Some((unit, signal, fit)) = position_unit {
                self.findings.push(DataFinding::WrongUnit {
                    signal,
                    unit,
                    mass: fit.mass.abs(),
                    declared,
                    friction_fits: true,
                });
                reported = true;
            } else {
                for (signal, fit, ratio) in &ratios {
                    if let Some(unit) = force_unit(*ratio).filter(|_| {
                        !cut && !coulomb
                            .is_some_and(|coulomb| is_as_declared(fit.coulomb, coulomb, *ratio))
                    }) {
                        self.findings.push(DataFinding::WrongUnit {
                            signal: *signal,
                            unit,
                            mass: fit.mass.abs(),
                            declared,
                            friction_fits: false,
                        });
                        reported = true;
                    }
                }
                if let Some((_, fit, _)) = ratios.first().filter(|_| !reported) {
                    self.other_machine(fit, declared, coulomb);
                }
            }
        }
        // In one direction a Coulomb friction is an offset.
        let one_direction =
            self.findings.iter().any(|finding| matches!(finding, DataFinding::OneDirection));
        if let Some((_, fit)) = moving.first().filter(|_| !reported && !one_direction)
            && let Some(declared) = coulomb
        {
            self.other_friction(fit, declared);
        }
        self.cell_and_command(reported);
    }

    /// Whether the mass is not that of the model, kg; `coulomb`: its Coulomb friction, N.
    fn other_machine(&mut self, fit: &RoughFit, declared: f64, coulomb: Option<f64>) {
        // A force over the position, which the model may declare or lack, takes part of what would
        // be a mass.
        let is_other = |mass: f64| !(0.8..1.25).contains(&(mass / declared));
        let (mass, [with_spring, its_deviation]) = (fit.mass.abs(), fit.mass_with_spring);
        let surely = (with_spring - declared).abs() > SURELY * its_deviation;
        // A spring does not make the friction another one by the same factor.
        let with_friction = coulomb.filter(|coulomb| *coulomb > 0.0).is_some_and(|coulomb| {
            ALIKE.contains(&(fit.coulomb.abs() / coulomb / (mass / declared)))
        });
        if is_other(mass) && (with_friction || is_other(with_spring) && surely) {
            let off = |mass: f64| (mass / declared).ln().abs();
            let (measured, deviation) = match !with_friction && off(with_spring) < off(mass) {
                true => (with_spring, its_deviation),
                false => (fit.mass, fit.mass_deviation),
            };
            self.findings.push(DataFinding::OtherMachine { declared, measured, deviation });
        }
    }

    /// Whether the Coulomb friction of the guides is another one than the model declares, N.
    fn other_friction(&mut self, fit: &RoughFit, declared: f64) {
        let (measured, deviation) = (fit.coulomb, fit.coulomb_deviation);
        if declared > 0.0
            && !(0.4..2.5).contains(&(measured / declared))
            && (measured - declared).abs() > SURELY * deviation
        {
            self.findings.push(DataFinding::OtherFriction { declared, measured, deviation });
        }
    }

    fn reference_slope(&self) -> Option<f64> {
        if !self.recording.has(Signal::ReferencePosition) {
            return None;
        }
        let reference = self.column(Signal::ReferencePosition);
        let slope = self.slope(self.column(Signal::Position), |row| reference[row])?;
        (slope.explained > 0.9).then_some(slope.value)
    }

    /// Signals that should be the same: cell and command, position and reference, and the
    /// references among themselves.
    fn cell_and_command(&mut self, reported: bool) {
        let mut disagree = |first: Signal, second: Signal, slope: f64| {
            if SAME.contains(&slope) {
                return;
            }
            let evidence = Disagreement::Factor(slope);
            self.findings.push(DataFinding::Disagree { first, second, evidence });
        };
        let trace = &self.recording.trace;
        let examiner = Examiner { findings: Vec::new(), segments: self.segments.clone(), ..*self };
        // With a coupling the cell shows what moves the carriage, not what moves the motor.
        let rigid = self.model.is_none_or(|model| model.coupling.is_none());
        if !reported
            && rigid
            && examiner.recording.has(Signal::ForceCell)
            && examiner.recording.has(Signal::Force)
        {
            // the cell shows a command one row later
            let apart = |ahead: usize, behind: usize| {
                let pairs = trace.force_cell[ahead..].iter().zip(&trace.force[behind..]);
                pairs
                    .map(|(cell, command)| (cell - command).powi(2))
                    .filter(|square| square.is_finite())
                    .sum::<f64>()
            };
            let (behind, ahead) = (apart(1, 0).sqrt(), apart(0, 1).sqrt());
            if ahead < SWAPPED * behind {
                let (first, second) = (Signal::ForceCell, Signal::Force);
                let evidence = Disagreement::Before(behind / ahead);
                self.findings.push(DataFinding::Disagree { first, second, evidence });
                return;
            }
            let slope = examiner.slope(&trace.force_cell, |row| trace.force[row.max(1) - 1]);
            // A sign or a unit changes the means as well. What does not is a force of the motor
            // side that the command answers.
            let is_sure = |slope: &Slope| {
                let off = |value: f64| (SAME.start - value).max(value - SAME.end);
                slope.explained > 0.5
                    && slope.is_of_both_halves
                    && off(slope.ratio) > 0.0
                    && off(slope.value) > SURELY * slope.deviation
            };
            if let Some(slope) = slope.filter(is_sure) {
                disagree(Signal::ForceCell, Signal::Force, slope.value);
            }
        }
        if let Some(slope) = examiner.reference_slope() {
            disagree(Signal::Position, Signal::ReferencePosition, slope);
        }
        let derivatives = [
            (Signal::ReferenceVelocity, Signal::ReferencePosition),
            (Signal::ReferenceAcceleration, Signal::ReferenceVelocity),
        ];
        for (rate, of) in derivatives {
            if !examiner.recording.has(rate) || !examiner.recording.has(of) {
                continue;
            }
            let (column, rate_column) = (examiner.column(of), examiner.column(rate));
            let derivative = |row: usize| match (row.checked_sub(1), column.get(row + 1)) {
                (Some(before), Some(after)) => (after - column[before]) / (2.0 * examiner.step),
                _ => f64::NAN,
            };
            if let Some(slope) =
                examiner.slope(rate_column, derivative).filter(|slope| slope.explained > 0.9)
                && !(0.8..1.25).contains(&slope.value)
            {
                disagree(rate, of, slope.value);
            }
        }
    }
}

/// Unit of a force whose apparent mass is `ratio` times the declared one.
fn force_unit(ratio: f64) -> Option<&'static str> {
    // a factor of a thousand leaves room for a wrong model, a small factor does not
    let units = [
        ("kN", 1e-3, 2.0),
        ("mN", 1e3, 2.0),
        ("lbf", 1.0 / 4.448_221_615_260_5, 1.08),
        ("kgf", 1.0 / 9.80665, 1.08),
    ];
    units
        .into_iter()
        .find(|(_, factor, tolerance)| within(ratio, *factor, *tolerance))
        .map(|(unit, ..)| unit)
}

/// Unit of a position, or of the time, whose apparent mass is `ratio` times the declared one.
fn position_unit(ratio: f64) -> Option<(&'static str, Signal)> {
    let units = [
        ("mm", Signal::Position, 1e-3, 2.0),
        ("um", Signal::Position, 1e-6, 2.0),
        ("in", Signal::Position, 0.0254, 1.08),
        ("ms", Signal::Time, 1e6, 2.0),
        ("us", Signal::Time, 1e12, 2.0),
    ];
    let found =
        units.into_iter().find(|(_, _, factor, tolerance)| within(ratio, *factor, *tolerance));
    found.map(|(unit, signal, ..)| (unit, signal))
}

/// Whether friction is nearer to what is declared than to what a wrong unit would make of that, a
/// factor: then the mass is not the declared one, and the unit right.
fn is_as_declared(measured: f64, declared: f64, by_unit: f64) -> bool {
    let ratio = measured.abs() / declared;
    // Where none is declared it says nothing.
    ratio > 0.0 && ratio.is_finite() && ratio.ln().abs() < (ratio / by_unit).ln().abs()
}

fn within(value: f64, of: f64, tolerance: f64) -> bool {
    (of / tolerance..of * tolerance).contains(&value)
}
