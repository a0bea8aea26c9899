//! The units of what a sweep changes.

use friction_stage_core::plant::EffectDescriptor;

/// Keys by their last parts with the units of a prismatic joint; the first that fits holds.
const UNITS: [(&str, &str); 37] = [
    ("model.mass", "kg"),
    ("guides.stiffness", "N/m"),
    ("guides.bristle_damping", "N s/m"),
    ("guides.viscous_friction", "N s/m"),
    ("guides.coulomb_force", "N"),
    ("guides.static_force", "N"),
    ("guides.stribeck_velocity", "m/s"),
    ("guides.damping_velocity", "m/s"),
    ("stroke.low", "m"),
    ("stroke.high", "m"),
    ("stroke.stiffness", "N/m"),
    ("stroke.damping", "N s/m"),
    ("motor.force_limit", "N"),
    ("force_cell.noise", "N"),
    ("encoder.resolution", "m"),
    ("encoder.noise", "m"),
    ("coupling.stiffness", "N/m"),
    ("coupling.damping", "N s/m"),
    ("coupling.motor_mass", "kg"),
    ("controller.rate", "Hz"),
    ("controller.bandwidth", "Hz"),
    ("controller.mass", "kg"),
    ("stage.p", "N/m"),
    ("stage.i", "N/(m s)"),
    ("stage.d", "N s/m"),
    ("stage.u_clamp_max", "N"),
    ("stage.u_clamp_min", "N"),
    ("lowpass.frequency", "Hz"),
    ("feedforward.mass", "kg"),
    ("feedforward.viscous", "N s/m"),
    ("disturbance_observer.bandwidth", "Hz"),
    ("disturbance_observer.limit", "N"),
    ("disturbance_observer.delay", "s"),
    ("distance", "m"),
    ("duration", "s"),
    ("settle", "s"),
    ("rest", "s"),
];

/// The unit of the numbers of a key, as a prismatic joint has it; none where they have none.
pub fn sweep_unit(key: &str) -> Option<&'static str> {
    // The number of a guide or an effect is no part of its name.
    let parts: Vec<&str> = key.split('.').filter(|part| part.parse::<usize>().is_err()).collect();
    if let ["model", "effects", effect, parameter] = parts[..] {
        let known = EffectDescriptor::find(effect).ok()?;
        let found = known.parameters.iter().find(|one| one.name == parameter)?;
        return (found.unit != "1").then_some(found.unit);
    }
    let ends_with = |end: &str| {
        let end: Vec<&str> = end.split('.').collect();
        parts.ends_with(&end)
    };
    UNITS.iter().find(|(end, _)| ends_with(end)).map(|(_, unit)| *unit)
}

#[cfg(test)]
mod tests {
    use super::super::{CONTROLLER_KEYS, SweepMotion, document};
    use super::*;
    use friction_stage_core::model::{GuideSource, StageModel};

    #[test]
    fn every_number_that_may_be_swept_has_its_unit() {
        let rig = StageModel::measuring_rig("guide_1").unwrap();
        let mut stage = StageModel::on_guides("guide_1");
        stage.guides =
            stage.resolved_guides().unwrap().into_iter().map(GuideSource::Inline).collect();
        let model = [stage, rig].map(|model| serde_json::to_value(model).unwrap());
        let motion = SweepMotion::named("fine-step").unwrap().document().unwrap();
        let of = |section: &str, document: &serde_json::Value| -> Vec<String> {
            let keys = document::keys(document).into_iter();
            keys.map(|key| format!("{section}.{key}")).collect()
        };
        let mut keys = of("motion", &motion);
        model.iter().for_each(|one| keys.extend(of("model", one)));
        keys.extend(CONTROLLER_KEYS.iter().map(|key| format!("controller.{key}")));
        let without: Vec<&str> =
            keys.iter().map(String::as_str).filter(|key| sweep_unit(key).is_none()).collect();
        // Names, choices, and what is a ratio.
        let names = ["name", "joint", "guides", "return", "antiwindup_strategy", "lowpass.damping"];
        let has_none = |key: &str| names.iter().any(|name| key.ends_with(name));
        assert!(without.iter().all(|key| has_none(key)), "{without:?}");
        assert!(keys.len() > 30, "{keys:?}");
        assert_eq!(sweep_unit("model.guides.2.stiffness"), Some("N/m"));
        assert_eq!(sweep_unit("model.effects.cogging.period"), Some("m"));
    }
}
