//! Encoder scale: the encoder's metre is longer or shorter than a metre.
//!
//! Reading x (1 + g) at the true position x: g fraction. In a residual it shows as m g a along +x,
//! as the encoder sees an acceleration that does not happen; the friction hardly changes. Source:
//! thermal expansion of the scale, linear (assumed). Sizes: 8 to 11 ppm per kelvin for glass and
//! steel (assumed); errors of the declared pitch are larger. Not modelled: scale error that changes
//! along the scale.

use super::regression::least_squares;
use super::{
    Action, EffectDescriptor, EffectParameter, Multiplicity, ReadingLaw, RecordSpecific, Residual,
    Role, descriptor,
};

/// Largest error that is still an error and not another encoder.
const LIMIT: f64 = 0.5;

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "encoder_scale",
    role: Role::Encoder,
    law: "reading = x (1 + fraction), in a residual F = m fraction a",
    source: "linear scale error (assumed)",
    telltale: "proportional to the acceleration, as a payload of the opposite sign; distances \
               differ from those of another gauge",
    parameters: &[EffectParameter::required(
        "fraction",
        "1",
        "reading beyond the position, as a part of it",
        (-LIMIT, LIMIT),
        0.01,
    )],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[0.01],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::Encoder(Box::new(EncoderScale { fraction: values[0] })),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct EncoderScale {
    fraction: f64,
}

impl ReadingLaw for EncoderScale {
    fn reading(&self, _time: f64, position: f64) -> f64 {
        position + self.fraction * position
    }
}

/// Slope of the residual over the acceleration, as a part of the mass.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let base = least_squares(residual.force, |_| [1.0])?;
    let fit = least_squares(residual.force, |k| [1.0, residual.mass * residual.acceleration[k]])?;
    fit.improves_on(&base).then(|| vec![fit.coefficients[1].clamp(-LIMIT, LIMIT)])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;
    use crate::model::{EffectParameters, StageModel};
    use crate::plant::{Rates, Stage};

    #[test]
    fn a_stage_at_100_mm_reads_what_its_scale_says_and_stays_where_it_is() {
        let model = StageModel {
            effects: vec![EffectParameters::new("encoder_scale", [("fraction", 1e-3)])],
            ..StageModel::default().without_noise()
        };
        let mut stage = Stage::new(&model, Rates::DEFAULT, 0).unwrap();
        stage.set_state(0.1, 0.0, &[]);
        assert!((stage.sample().position - 0.1001).abs() < 1e-15);
        assert_eq!(stage.state().position, 0.1);
    }

    #[test]
    fn proposal_finds_the_fraction_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[0.02]);
        assert!((found[0] / 0.02 - 1.0).abs() < 0.02, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
