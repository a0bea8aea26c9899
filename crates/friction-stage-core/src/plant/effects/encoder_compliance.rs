//! Encoder compliance: the encoder is on the motor, and what moves the carriage yields between
//! them.
//!
//! Reading x + c F: x position of the carriage (m), F force that the motor passes on (N), c
//! compliance (m/N). At a reversal the reading steps by 2 c times the friction while the carriage
//! stands; while it accelerates the motor is ahead. In a residual it shows as m c d2F/dt2 along +x.
//! Source: static compliance of a feed drive between motor and table (Altintas, Verl, Brecher,
//! Uriarte and Pritschow 2011, "Machine tool feed drives", CIRP Annals 60). Sizes: a ball screw of
//! 50 to 300 N/µm has 2e-8 to 3e-9 m/N (assumed). Not modelled: the resonance of motor and carriage
//! on the drive, so it is for motions well below it (a `coupling` of the model has it); play
//! (`backlash`); the same with a scale whose head yields, which lags where this leads.
//!
//! With a command that comes late identification takes the command as it was given (assumed).

use super::regression::{least_squares, step_of};
use super::{
    Action, EffectDescriptor, EffectParameter, Multiplicity, RecordSpecific, Residual, Role,
    descriptor,
};

/// Largest compliance, m/N: a motor of 1000 N a millimetre ahead.
const LARGEST: f64 = 1e-6;

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "encoder_compliance",
    role: Role::Encoder,
    law: "reading = x + compliance F, in a residual F = m compliance d2F/dt2",
    source: "Altintas et al. 2011, static compliance of a feed drive",
    telltale: "force proportional to the second derivative of the command; at a reversal the \
               reading steps while the carriage stands",
    parameters: &[EffectParameter::required(
        "compliance",
        "m/N",
        "by how much the encoder is ahead of the carriage per force of the motor",
        (0.0, LARGEST),
        1e-8,
    )],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[1e-8],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::Compliance(values[0]),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

/// Slope of the residual over the second derivative of the command.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let step = step_of(residual);
    let (time, command) = (residual.time, residual.command);
    let column = |k: usize| -> f64 {
        let Some([before, here, after]) =
            k.checked_sub(1).and_then(|from| command.get(from..k + 2))
        else {
            return f64::NAN;
        };
        // Rows that are left out are no neighbours.
        match time[k + 1] - time[k - 1] < 2.5 * step {
            true => residual.mass * (after - 2.0 * here + before) / (step * step),
            false => f64::NAN,
        }
    };
    // Over the same rows.
    let base =
        least_squares(residual.force, |k| [if column(k).is_finite() { 1.0 } else { f64::NAN }])?;
    let fit = least_squares(residual.force, |k| [1.0, column(k)])?;
    let compliance = fit.coefficients[1];
    (fit.improves_on(&base) && compliance > 0.0).then(|| vec![compliance.min(LARGEST)])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, on_a_slippery_guide, proposal};
    use super::*;
    use crate::model::{EffectParameters, StageModel};
    use crate::plant::{Rates, Stage};

    fn compliant() -> EffectParameters {
        EffectParameters::new("encoder_compliance", [("compliance", 1e-8)])
    }

    /// A stage that its friction holds: 20 N on four guides that hold 67 N.
    #[test]
    fn a_stage_that_stands_reads_ahead_by_the_force_and_moves_no_more_than_without() {
        let read = |effects: Vec<EffectParameters>| {
            let model = StageModel { effects, ..StageModel::default().without_noise() };
            let mut stage = Stage::new(&model, Rates::DEFAULT, 0).unwrap();
            (0..40_000).for_each(|_| stage.advance(20.0));
            (stage.sample().position, stage.state().position)
        };
        let ((seen, there), (plain, same)) = (read(vec![compliant()]), read(Vec::new()));
        assert_eq!(there, same);
        assert!((seen - plain - 20.0 * 1e-8).abs() < 1e-14, "{seen} {plain}");
    }

    #[test]
    fn the_carriage_does_not_feel_it() {
        let mut body = on_a_slippery_guide(compliant());
        body.advance(40.0, 40_000);
        // 1 m/s^2 for 1 s.
        assert!((body.velocity() - 1.0).abs() < 1e-6, "{}", body.velocity());
    }

    #[test]
    fn proposal_finds_the_compliance_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[1e-7]);
        assert!((found[0] / 1e-7 - 1.0).abs() < 0.05, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
