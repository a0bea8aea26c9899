//! Words for models, guides and effects.

use friction_stage_core::model::{CatalogueEntry, JointType, Provenance, Quantity};
use friction_stage_core::plant::effects::{
    CommandStage, EffectDescriptor, Multiplicity, ParameterKind, Role,
};

use friction_stage_core::numerics::rounded;

use super::{in_prefix, short};
use crate::model::{ModelFacts, example_yaml};

/// What an effect acts on.
pub fn acts_on(effect: &EffectDescriptor) -> &'static str {
    if effect.is_curve() {
        return "motor, carriage, friction or mass, as the curve says";
    }
    match effect.role {
        Role::Command(CommandStage::Lag) => "command of the motor: it arrives late",
        Role::Command(_) => "command of the motor: force per command",
        Role::MotorForce => "motor side; the force cell reads it",
        Role::CarriageForce => "carriage; the force cell does not read it",
        Role::Friction(_) => "friction of the guides",
        Role::Bristles => "bristles of the guides",
        Role::Mass | Role::VaryingMass => "moving mass",
        Role::Encoder => "reading of the encoder",
        Role::ForceCell => "reading of the force cell",
    }
}

/// How many effects of a law a model may have.
pub fn multiplicity(multiplicity: Multiplicity) -> &'static str {
    match multiplicity {
        Multiplicity::One => "one per model",
        Multiplicity::Several => "several per model",
        Multiplicity::OnePerGuide => "several per model, such as one per guide",
    }
}

/// The effects, one a line.
pub fn effects_text(effects: &[&EffectDescriptor]) -> String {
    let width = effects.iter().map(|effect| effect.name.len()).max().unwrap_or(0);
    let line = |effect: &&EffectDescriptor| format!("{:width$}  {}\n", effect.name, effect.law);
    effects.iter().map(line).collect()
}

/// All that is known of an effect.
pub fn effect_text(effect: &EffectDescriptor) -> String {
    let mut text = format!(
        "{}\n  law       {}\n  acts on   {}\n  source    {}\n  telltale  {}\n  number    {}\n\n",
        effect.name,
        effect.law,
        acts_on(effect),
        effect.source,
        effect.telltale,
        multiplicity(effect.multiplicity)
    );
    for parameter in effect.parameters {
        let range = match parameter.kind {
            ParameterKind::Choice(names) => format!("one of {}", names.join(", ")),
            _ => {
                let (low, high) = parameter.bounds;
                let unit = if parameter.unit == "1" { "" } else { parameter.unit };
                format!("{low} to {high} {unit}").trim_end().to_owned()
            }
        };
        let default = match (parameter.default, parameter.kind) {
            (None, _) => "required".to_owned(),
            (Some(value), ParameterKind::Choice(names)) => {
                format!("default {}", names.get(value as usize).unwrap_or(&""))
            }
            (Some(value), _) => format!("default {value}"),
        };
        text += &format!("  {}: {}; {range}; {default}\n", parameter.name, parameter.description);
    }
    if let Some(example) = example_yaml(effect) {
        text += &format!("\nIn a model file, with values of a usual size:\n\n{example}");
    }
    text
}

fn provenance(of: Provenance) -> &'static str {
    match of {
        Provenance::Stated => "stated",
        Provenance::Derived => "derived",
        Provenance::Assumed => "assumed",
        Provenance::Measured => "measured",
    }
}

/// The guides of a catalogue, one a line.
pub fn guides_text<'a>(guides: impl Iterator<Item = (&'a str, &'a CatalogueEntry)>) -> String {
    guides.map(|(name, entry)| format!("{name}  {}\n", entry.description)).collect()
}

/// The values of a guide with their names, as a model file has them.
fn guide_quantities(entry: &CatalogueEntry) -> [(&'static str, &Quantity); 6] {
    [
        ("stiffness", &entry.stiffness),
        ("bristle_damping", &entry.bristle_damping),
        ("viscous_friction", &entry.viscous_friction),
        ("coulomb_force", &entry.coulomb_force),
        ("static_force", &entry.static_force),
        ("stribeck_velocity", &entry.stribeck_velocity),
    ]
}

/// All that is known of a guide, with where each value comes from.
pub fn guide_text(name: &str, entry: &CatalogueEntry) -> String {
    let yes = |is: bool| if is { "with" } else { "without" };
    let mut text = format!(
        "{name}: {}\n  {} seals, {} cage, lubricant: {}\n\n",
        entry.description,
        yes(entry.seals),
        yes(entry.cage),
        entry.lubricant
    );
    for (name, quantity) in guide_quantities(entry) {
        text += &format!(
            "  {name:17} {:>9} {:5} {}: {}\n",
            quantity.value,
            quantity.unit,
            provenance(quantity.provenance),
            quantity.source
        );
    }
    for stiffness in &entry.effective_stiffness {
        text += &format!(
            "  stiffness of a slow loop of {}: {} N/m, {}: {}\n",
            in_prefix(stiffness.amplitude, "m"),
            stiffness.stiffness,
            provenance(stiffness.provenance),
            stiffness.source
        );
    }
    if entry.distributed_bristles.is_some() {
        text += "  with values for several bristles in parallel (distributed_bristles)\n";
    }
    text
}

/// A model with its units, what is assumed of it, and what follows from it.
pub fn model_text(facts: &ModelFacts) -> String {
    let ModelFacts { model, guides, assumptions, notes, derived } = facts;
    let of = |value: f64, unit: &str| format!("{} {}", readable(value), model.joint.unit(unit));
    let mut text = format!(
        "{}\n  joint             {}\n  mass              {}\n",
        model.name,
        model.joint.name(),
        of(model.mass, "kg")
    );
    let mut first = 0;
    while first < guides.len() {
        let guide = &guides[first];
        let same = guides[first..].iter().take_while(|other| *other == guide).count();
        let numbers = match same {
            1 => format!("guide {}", first + 1),
            _ => format!("guides {} to {}", first + 1, first + same),
        };
        text += &format!("  {numbers}\n");
        for (name, value, unit) in [
            ("stiffness", guide.stiffness, "N/m"),
            ("bristle_damping", guide.bristle_damping, "N s/m"),
            ("viscous_friction", guide.viscous_friction, "N s/m"),
            ("coulomb_force", guide.coulomb_force, "N"),
            ("static_force", guide.static_force, "N"),
            ("stribeck_velocity", guide.stribeck_velocity, "m/s"),
        ] {
            text += &format!("    {name:17} {}\n", of(value, unit));
        }
        if let Some(exponent) = guide.stribeck_exponent {
            text += &format!("    {:17} {exponent}\n", "stribeck_exponent");
        }
        if let Some(velocity) = guide.damping_velocity {
            text += &format!("    {:17} {}\n", "damping_velocity", of(velocity, "m/s"));
        }
        first += same;
    }
    for given in &model.effects {
        // They were checked when the facts were made.
        if let Ok((effect, values)) = EffectDescriptor::read(given) {
            text += &effect_line(effect, &values, model.joint);
        }
    }
    if let Some(stroke) = &model.stroke {
        text +=
            &format!("  stroke            {} to {}\n", readable(stroke.low), of(stroke.high, "m"));
    }
    if let Some(coupling) = &model.coupling {
        text += &format!(
            "  coupling          {}, {}, motor side {}\n",
            of(coupling.stiffness, "N/m"),
            of(coupling.damping, "N s/m"),
            of(coupling.motor_mass, "kg")
        );
    }
    text += &format!(
        "  motor             up to {}\n  force cell        noise {}\n  encoder           \
         resolution {}, noise {}\n\n",
        of(model.motor.force_limit, "N"),
        of(model.force_cell.noise, "N"),
        of(model.encoder.resolution, "m"),
        of(model.encoder.noise, "m")
    );
    text += "what follows from it\n";
    for (name, value) in [
        ("moving mass", of(derived.moving_mass, "kg")),
        ("stiffness of the guides", of(derived.stiffness, "N/m")),
        (
            "Dahl resonance",
            format!(
                "{} Hz, damping ratio {}",
                short(derived.dahl_resonance),
                short(derived.damping_ratio)
            ),
        ),
        ("break-away force", of(derived.break_away_force, "N")),
        ("break-away distance", in_prefix(derived.break_away_distance, &model.joint.unit("m"))),
    ] {
        text += &format!("  {name:26} {value}\n");
    }
    if let (Some(force), Some(possible)) = (derived.fast_move_force, derived.fast_move_possible) {
        let verdict = if possible { "the motor has it" } else { "more than the motor has" };
        text += &format!("  {:26} {} ({verdict})\n", "force for 50 mm in 100 ms", of(force, "N"));
    }
    for note in assumptions.iter().chain(notes) {
        text += &format!("note: {note}\n");
    }
    text
}

fn effect_line(effect: &EffectDescriptor, values: &[f64], joint: JointType) -> String {
    if let Some(curve) = effect.curve_of(values) {
        return format!(
            "  effect {}: {} values over {} from {} to {} {}\n",
            effect.name,
            curve.values.len(),
            curve.coordinate.name(),
            readable(curve.from),
            readable(curve.to),
            joint.unit(curve.coordinate.unit())
        );
    }
    let parts: Vec<String> = effect
        .parameters
        .iter()
        .zip(values)
        .map(|(parameter, value)| match parameter.kind {
            ParameterKind::Choice(names) => {
                format!("{} {}", parameter.name, names.get(*value as usize).unwrap_or(&""))
            }
            _ if parameter.unit == "1" => format!("{} {}", parameter.name, readable(*value)),
            _ => format!("{} {} {}", parameter.name, readable(*value), joint.unit(parameter.unit)),
        })
        .collect();
    format!("  effect {}: {}\n", effect.name, parts.join(", "))
}

/// A number as a person would write it: to six digits, without zeros that say nothing.
fn readable(value: f64) -> String {
    let value = rounded(value, 6);
    match value.abs() {
        size if size == 0.0 || (1e-3..1e6).contains(&size) => value.to_string(),
        _ => format!("{value:e}"),
    }
}
