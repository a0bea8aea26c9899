//! What a model is and what follows from it, as a table of figures and as JSON.

use std::f64::consts::TAU;

use friction_stage_core::model::{
    CatalogueEntry, EffectParameters, Guide, JointType, ModelError, StageModel,
};
use friction_stage_core::plant::effects::{EffectDescriptor, Effects, ParameterKind};
use serde::Serialize;
use serde_json::{Value, json};

use crate::words::{acts_on, multiplicity};

/// Stroke, m, and duration, s, of the fast move (paper, section 4).
const FAST_MOVE: (f64, f64) = (50e-3, 100e-3);
/// Instants at which the force of the move is looked at.
const INSTANTS: u32 = 1000;

/// A model with what follows from it. SI units, those of `joint`.
#[derive(Clone, Debug, Serialize)]
pub struct ModelFacts {
    /// What the file says, catalogue names as they are.
    pub model: StageModel,
    /// The guides' parameters.
    pub guides: Vec<Guide>,
    /// What the file does not say of its guides and is assumed.
    pub assumptions: Vec<String>,
    /// Guides that are not passive.
    pub notes: Vec<String>,
    /// What follows.
    pub derived: Derived,
}

/// Figures that follow from a model. Guides count as single LuGre bristles; of the effects only a
/// constant mass is in them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Derived {
    /// All that the motor moves, kg.
    pub moving_mass: f64,
    /// Bristle stiffness of all guides together, N/m.
    pub stiffness: f64,
    /// Bristle damping of all guides together, N s/m.
    pub bristle_damping: f64,
    /// Dahl resonance, Hz: the moving mass on the bristles of its guides.
    pub dahl_resonance: f64,
    /// Damping ratio of that resonance.
    pub damping_ratio: f64,
    /// Static friction of all guides together, N: above it the stage slides.
    pub break_away_force: f64,
    /// Deflection at which the first guide has broken away, m: Fs/sigma0, on bristles in parallel
    /// that of the last element.
    pub break_away_distance: f64,
    /// Largest force that the paper's move of 50 mm in 100 ms needs, N; none of a revolute joint.
    pub fast_move_force: Option<f64>,
    /// Whether the motor has that force.
    pub fast_move_possible: Option<bool>,
}

impl ModelFacts {
    /// The facts of a model, whose effects are checked too.
    pub fn new(model: &StageModel) -> Result<ModelFacts, ModelError> {
        model.check()?;
        let effects = Effects::new(&model.effects)?;
        let guides = model.resolved_guides()?;
        let derived = Derived::new(model, &guides, &effects)?;
        let assumptions = model.assumptions();
        let notes = model.passivity_note()?.into_iter().collect();
        Ok(ModelFacts { model: model.clone(), guides, assumptions, notes, derived })
    }
}

impl Derived {
    fn new(model: &StageModel, guides: &[Guide], effects: &Effects) -> Result<Derived, ModelError> {
        let last = effects.bristle_elements().map_or(1.0, |elements| elements.last_break_away());
        let sum = |of: fn(&Guide) -> f64| guides.iter().map(of).sum::<f64>();
        let mut moving_mass =
            model.mass + model.coupling.as_ref().map_or(0.0, |coupling| coupling.motor_mass);
        for effect in &model.effects {
            let (descriptor, values) = EffectDescriptor::read(effect)?;
            moving_mass += descriptor.constant_mass(&values);
        }
        let stiffness = sum(|guide| guide.stiffness);
        let damping = sum(|guide| guide.bristle_damping + guide.viscous_friction);
        let fast_move_force =
            (model.joint == JointType::Prismatic).then(|| fast_move_force(moving_mass, guides));
        Ok(Derived {
            moving_mass,
            stiffness,
            bristle_damping: sum(|guide| guide.bristle_damping),
            dahl_resonance: (stiffness / moving_mass).sqrt() / TAU,
            damping_ratio: 0.5 * damping / (stiffness * moving_mass).sqrt(),
            break_away_force: sum(|guide| guide.static_force),
            break_away_distance: guides
                .iter()
                .map(|guide| last * guide.static_force / guide.stiffness)
                .fold(f64::INFINITY, f64::min),
            fast_move_force,
            fast_move_possible: fast_move_force.map(|force| force <= model.motor.force_limit),
        })
    }
}

/// Largest force of mass and steady friction along the minimum-jerk move, N.
fn fast_move_force(mass: f64, guides: &[Guide]) -> f64 {
    let (distance, duration) = FAST_MOVE;
    (0..=INSTANTS)
        .map(|k| f64::from(k) / f64::from(INSTANTS))
        .map(|s| {
            let velocity = distance / duration * (30.0 * s.powi(2) * (1.0 - s).powi(2));
            let acceleration =
                distance / duration.powi(2) * (60.0 * s * (1.0 - s) * (1.0 - 2.0 * s));
            let friction: f64 = match velocity > 0.0 {
                true => guides.iter().map(|guide| guide.steady_force(velocity)).sum(),
                false => 0.0,
            };
            (mass * acceleration + friction).abs()
        })
        .fold(0.0, f64::max)
}

/// An effect with its parameters, for other programs.
pub fn effect_json(effect: &EffectDescriptor) -> Value {
    let parameters: Vec<Value> = effect
        .parameters
        .iter()
        .map(|parameter| {
            let forms = match parameter.kind {
                ParameterKind::Choice(names) => json!(names),
                _ => Value::Null,
            };
            json!({
                "name": parameter.name,
                "unit": parameter.unit,
                "description": parameter.description,
                "min": parameter.bounds.0,
                "max": parameter.bounds.1,
                "default": parameter.default,
                "forms": forms,
            })
        })
        .collect();
    json!({
        "name": effect.name,
        "acts_on": acts_on(effect),
        "law": effect.law,
        "source": effect.source,
        "telltale": effect.telltale,
        "how_many": multiplicity(effect.multiplicity),
        "is_curve": effect.is_curve(),
        "parameters": parameters,
        "example": example_yaml(effect),
    })
}

/// The effect with typical values, as a model file has it; none of a curve.
pub fn example_yaml(effect: &EffectDescriptor) -> Option<String> {
    if effect.is_curve() {
        return None;
    }
    let EffectParameters { values, .. } = effect.parameters_of(effect.typical);
    let mut text = format!("effects:\n  - {}:\n", effect.name);
    for parameter in effect.parameters {
        let value = values.get(parameter.name)?;
        text += &match value.number() {
            Some(number) => format!("      {}: {number:?} # {}\n", parameter.name, parameter.unit),
            None => format!("      {}: {}\n", parameter.name, json!(value).as_str()?),
        };
    }
    Some(text)
}

/// A guide of a catalogue with its name, for other programs.
pub fn guide_json(name: &str, entry: &CatalogueEntry) -> Result<Value, serde_json::Error> {
    let mut value = serde_json::to_value(entry)?;
    value["name"] = json!(name);
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stage_of_the_paper_has_the_figures_that_its_catalogue_states() {
        let facts = ModelFacts::new(&StageModel::default()).unwrap();
        let derived = facts.derived;
        assert!((derived.dahl_resonance - 33.8).abs() < 0.1, "{derived:?}");
        assert!((derived.damping_ratio - 0.21).abs() < 0.01, "{derived:?}");
        assert!((derived.break_away_force - 67.2).abs() < 1e-9, "{derived:?}");
        // 1155 N of the mass (5.7735 D/T^2), 54 N of Coulomb friction and the viscous part.
        let force = derived.fast_move_force.unwrap();
        assert!((1155.0 + 54.0..1155.0 + 54.0 + 72.0).contains(&force), "{force}");
    }

    /// The seals of guide 1 and the last element of guide 2 in docs/explanation/stiffness.md.
    #[test]
    fn of_bristles_in_parallel_the_last_one_says_where_a_guide_breaks_away() {
        for (guide, expected) in [("guide_1", 62.8e-6), ("guide_2", 11.6e-6)] {
            let model = StageModel::named(&format!("{guide}+distributed_bristles")).unwrap();
            let found = ModelFacts::new(&model).unwrap().derived.break_away_distance;
            assert!((found / expected - 1.0).abs() < 5e-3, "{guide}: {found} m");
        }
    }

    #[test]
    fn a_motor_that_is_too_weak_for_the_move_is_reported() {
        let mut model = StageModel::default();
        model.motor.force_limit = 1100.0;
        assert_eq!(ModelFacts::new(&model).unwrap().derived.fast_move_possible, Some(false));
    }

    #[test]
    fn every_example_is_a_model_that_loads() {
        use friction_stage_core::plant::effects::ALL;
        for effect in ALL.iter().filter(|effect| !effect.is_curve()) {
            let text = example_yaml(effect).unwrap();
            let model = StageModel::from_yaml(&text, effect.name).unwrap();
            let (_, values) = EffectDescriptor::read(&model.effects[0]).unwrap();
            assert_eq!(values, effect.typical, "{text}");
        }
    }
}
