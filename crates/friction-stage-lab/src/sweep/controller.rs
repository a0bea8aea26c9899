//! The controller of a sweep: the parameters of controller_node that are given, and the rule of
//! thumb of the bandwidth for the rest.

use friction_stage_core::numerics::plain;
use std::collections::BTreeMap;

use super::SweepValue;
use friction_stage_core::control::{AntiWindup, ControllerSettings, Gains, ObserverSettings};
use friction_stage_core::model::{StageModel, nearest};

/// Parameters by name, as controller_node has them.
pub type GivenParameters = BTreeMap<String, SweepValue>;

/// Parameters of controller_node that a sweep knows.
pub const CONTROLLER_KEYS: [&str; 16] = [
    "rate",
    "bandwidth",
    "mass",
    "gains.stage.p",
    "gains.stage.i",
    "gains.stage.d",
    "gains.stage.u_clamp_max",
    "gains.stage.u_clamp_min",
    "gains.stage.antiwindup_strategy",
    "lowpass.frequency",
    "lowpass.damping",
    "feedforward.mass",
    "feedforward.viscous",
    "disturbance_observer.bandwidth",
    "disturbance_observer.limit",
    "disturbance_observer.delay",
];

/// Those that follow from bandwidth and mass.
const DERIVED: [&str; 5] =
    ["gains.stage.p", "gains.stage.i", "gains.stage.d", "lowpass.frequency", "lowpass.damping"];
/// Samples per second where nothing is given, Hz.
const RATE: f64 = 4000.0;

/// All parameters that settings give.
pub fn given_by(settings: &ControllerSettings) -> GivenParameters {
    let gains = &settings.gains;
    let numbers = [
        ("rate", settings.rate),
        ("gains.stage.p", gains.p),
        ("gains.stage.i", gains.i),
        ("gains.stage.d", gains.d),
        ("gains.stage.u_clamp_max", settings.limits.1),
        ("gains.stage.u_clamp_min", settings.limits.0),
        ("lowpass.frequency", gains.lowpass_frequency),
        ("lowpass.damping", gains.lowpass_damping),
        ("feedforward.mass", settings.mass_feedforward),
        ("feedforward.viscous", settings.viscous_feedforward),
    ];
    let observed = settings.observer.iter().flat_map(|observer| {
        [
            ("disturbance_observer.bandwidth", observer.bandwidth),
            ("disturbance_observer.limit", observer.limit),
            ("disturbance_observer.delay", observer.delay),
        ]
    });
    let strategy = SweepValue::Text(settings.anti_windup.name().to_owned());
    numbers
        .map(|(name, value)| (name.to_owned(), SweepValue::Number(value)))
        .into_iter()
        .chain(observed.map(|(name, value)| (name.to_owned(), SweepValue::Number(value))))
        .chain([("gains.stage.antiwindup_strategy".to_owned(), strategy)])
        .collect()
}

/// Why a key cannot be swept with the parameters that are given.
pub(super) fn obstacle(key: &str, given: &GivenParameters) -> Option<String> {
    if !CONTROLLER_KEYS.contains(&key) {
        let near = nearest(key, CONTROLLER_KEYS);
        return Some(match near.is_empty() {
            true => format!("; there are {}", CONTROLLER_KEYS.join(", ")),
            false => near,
        });
    }
    let fixed = DERIVED.iter().all(|name| given.contains_key(*name));
    (fixed && ["bandwidth", "mass"].contains(&key)).then(|| {
        ": it has no effect, since the controller gives all gains; sweep gains.stage.* and \
         lowpass.*, or leave the controller out"
            .to_owned()
    })
}

/// The settings for a model: what is given, and for the rest the paper's controller for what the
/// model moves.
pub(super) fn settings_for(
    model: &StageModel,
    given: &GivenParameters,
) -> Result<ControllerSettings, String> {
    let number = |name: &str, otherwise: f64| match given.get(name) {
        None => Ok(otherwise),
        Some(SweepValue::Number(number)) => Ok(*number),
        Some(other) => Err(format!("controller.{name} is {other}, must be a number")),
    };
    let positive = |name: &str, otherwise: f64| {
        let value = number(name, otherwise)?;
        match value.is_finite() && value > 0.0 {
            true => Ok(value),
            false => Err(format!(
                "controller.{name} is {}, must be finite and greater than 0",
                plain(value)
            )),
        }
    };
    let mass = positive("mass", model.moving_mass())?;
    let bandwidth = positive("bandwidth", ControllerSettings::PAPER_BANDWIDTH)?;
    let rate = positive("rate", RATE)?;
    let paper = ControllerSettings::of_model(model, bandwidth, rate);
    let rule = Gains::from_bandwidth(bandwidth, mass);
    let anti_windup = match given.get("gains.stage.antiwindup_strategy") {
        None => paper.anti_windup,
        Some(name) => AntiWindup::from_name(&name.to_string()).ok_or_else(|| {
            format!(
                "controller.gains.stage.antiwindup_strategy is `{name}`, must be one of {}",
                AntiWindup::NAMES.join(", ")
            )
        })?,
    };
    let mass_feedforward = number("feedforward.mass", paper.mass_feedforward)?;
    let observer = match number("disturbance_observer.bandwidth", 0.0)? {
        0.0 => None,
        bandwidth => Some(ObserverSettings {
            bandwidth,
            limit: number("disturbance_observer.limit", ObserverSettings::LIMIT)?,
            mass: mass_feedforward,
            delay: number("disturbance_observer.delay", 0.0)?,
            forward_delay: number("disturbance_observer.delay", 0.0)?,
        }),
    };
    let settings = ControllerSettings {
        rate,
        gains: Gains {
            p: number("gains.stage.p", rule.p)?,
            i: number("gains.stage.i", rule.i)?,
            d: number("gains.stage.d", rule.d)?,
            lowpass_frequency: number("lowpass.frequency", rule.lowpass_frequency)?,
            lowpass_damping: number("lowpass.damping", rule.lowpass_damping)?,
        },
        anti_windup,
        limits: (
            number("gains.stage.u_clamp_min", paper.limits.0)?,
            number("gains.stage.u_clamp_max", paper.limits.1)?,
        ),
        mass_feedforward,
        viscous_feedforward: number("feedforward.viscous", 0.0)?,
        observer,
    };
    settings.check().map_err(|error| format!("controller.{error}"))?;
    Ok(settings)
}
