//! Parameters of the controller node. Gains have the names of ros2_control's pid_controller.

use std::collections::BTreeMap;
use std::path::Path;

use super::arguments::{Override, RosArguments};
use super::identify_loop;
use super::parameters::{ParameterSet, ParameterSpec, ParameterValues};
use super::runtime::Startup;
use friction_stage_core::control::{
    AntiWindup, Compensation, CompensationTermsOn, ControllerSettings, Gains, ObserverSettings,
    SupervisorSettings,
};
use friction_stage_core::plant::model_named;
use ros2_client::ParameterValue;

/// Parameters that follow from the bandwidth while `tuning` is `bandwidth`.
pub const DERIVED: [&str; 5] =
    ["gains.stage.p", "gains.stage.i", "gains.stage.d", "lowpass.frequency", "lowpass.damping"];

/// The stroke of the built-in stages, m.
const STROKE: f64 = friction_stage_core::model::StageModel::REACH;
/// What the supervision allows.
pub fn supervision(values: &ParameterValues) -> SupervisorSettings {
    let limit = values.double("gains.stage.u_clamp_max");
    SupervisorSettings {
        error: values.double("supervision.error"),
        patience: values.double("supervision.patience"),
        ..SupervisorSettings::new(values.double("rate"), limit)
    }
}

/// The parameters of the controller node.
pub fn specs() -> Vec<ParameterSpec> {
    let paper = ControllerSettings::paper(40.0, 4000.0, 2000.0);
    let gains = paper.gains;
    let mut specs = vec![
        Startup::cpu_spec(),
        Startup::priority_spec(),
        Startup::lifecycle_spec(),
        ParameterSpec::double(
            "rate",
            paper.rate,
            "samples per second that the controller computes; the stage may sample faster",
        )
        .unit("Hz")
        .range(1.0, 20_000.0)
        .read_only(),
        ParameterSpec::string(
            "stage",
            "stage",
            "name of the stage node to control, in the namespace of the controller unless it \
             begins with /",
        )
        .read_only(),
        ParameterSpec::string("joint", "stage", "name of the joint in messages").read_only(),
        ParameterSpec::boolean(
            "enabled",
            true,
            "whether the controller commands from the start; ~/enable changes it",
        )
        .read_only(),
        ParameterSpec::boolean(
            "wait_for_setpoint",
            false,
            "answer no sample before the first setpoint is accepted",
        )
        .read_only(),
        ParameterSpec::string(
            "tuning",
            "bandwidth",
            "where gains and lowpass come from: worked out from bandwidth and mass, or given",
        )
        .choices(&["bandwidth", "gains"]),
        ParameterSpec::double(
            "bandwidth",
            60.0,
            "crossover of the open loop, with tuning: bandwidth",
        )
        .unit("Hz")
        .range(0.1, 1000.0),
        ParameterSpec::double("mass", 40.0, "moving mass that the gains are worked out for")
            .unit("kg")
            .range(1e-3, 1e5),
        ParameterSpec::double("gains.stage.p", gains.p, "proportional gain")
            .unit("N/m")
            .range(0.0, 1e12),
        ParameterSpec::double("gains.stage.i", gains.i, "integral gain")
            .unit("N/(m s)")
            .range(0.0, 1e14),
        ParameterSpec::double("gains.stage.d", gains.d, "derivative gain")
            .unit("N s/m")
            .range(0.0, 1e9),
        ParameterSpec::double("gains.stage.u_clamp_max", paper.limits.1, "largest force")
            .unit("N")
            .range(1e-6, 1e6),
        ParameterSpec::double("gains.stage.u_clamp_min", paper.limits.0, "smallest force")
            .unit("N")
            .range(-1e6, -1e-6),
        ParameterSpec::string(
            "gains.stage.antiwindup_strategy",
            "conditional_integration",
            "what the integrator does in saturation",
        )
        .choices(&AntiWindup::NAMES),
        ParameterSpec::double(
            "lowpass.frequency",
            gains.lowpass_frequency,
            "cutoff of the lowpass behind the PID",
        )
        .unit("Hz")
        .range(0.01, 10_000.0),
        ParameterSpec::double(
            "lowpass.damping",
            gains.lowpass_damping,
            "damping ratio of the lowpass",
        )
        .range(0.01, 10.0),
        ParameterSpec::double("feedforward.mass", paper.mass_feedforward, "mass feedforward")
            .unit("kg")
            .range(0.0, 1e5),
        ParameterSpec::double(
            "feedforward.viscous",
            paper.viscous_feedforward,
            "viscous feedforward",
        )
        .unit("N s/m")
        .range(0.0, 1e6),
        ParameterSpec::string(
            "compensation",
            "",
            "model whose friction, effects and motor are fed forward along the reference, in the \
             place of feedforward.*: a model file, such as identify writes",
        )
        .read_only(),
        ParameterSpec::boolean("compensation_terms.mass", true, "its mass times acceleration"),
        ParameterSpec::boolean("compensation_terms.viscous", true, "its viscous friction"),
        ParameterSpec::boolean("compensation_terms.bristles", true, "its bristle friction"),
        ParameterSpec::boolean(
            "compensation_terms.forces",
            true,
            "against its effects that are a force: cogging, cable, maps",
        ),
        ParameterSpec::boolean(
            "compensation_terms.motor",
            true,
            "against gain, ripple and lag of its motor",
        ),
        ParameterSpec::double(
            "disturbance_observer.bandwidth",
            0.0,
            "up to where a disturbance observer answers the force that command and motion do not \
             explain; 0: none",
        )
        .unit("Hz")
        .range(0.0, 10_000.0),
        ParameterSpec::double(
            "disturbance_observer.limit",
            ObserverSettings::LIMIT,
            "largest force that it adds",
        )
        .unit("N")
        .range(1e-6, 1e6),
        ParameterSpec::double(
            "disturbance_observer.delay",
            0.0,
            "delay of the motor's force that it reckons with; 0 with a compensation: that of its \
             model",
        )
        .unit("s")
        .range(0.0, ObserverSettings::LONGEST_DELAY)
        .read_only(),
        ParameterSpec::double("stroke_min", -STROKE, "lowest setpoint that is followed")
            .unit("m")
            .range(-1e6, 0.0)
            .read_only(),
        ParameterSpec::double("stroke_max", STROKE, "highest setpoint that is followed")
            .unit("m")
            .range(0.0, 1e6)
            .read_only(),
        ParameterSpec::boolean(
            "supervision.enabled",
            true,
            "whether a loop that does not hold (see supervision.*) goes to a damped stop; without \
             it there are warnings only",
        ),
        ParameterSpec::double(
            "supervision.error",
            SupervisorSettings::ERROR,
            "largest position error at rest; ten times as much in motion",
        )
        .unit("m")
        .range(1e-9, 1e3)
        .read_only(),
        ParameterSpec::double(
            "supervision.patience",
            SupervisorSettings::PATIENCE,
            "how long error, saturation or swings may last before the stop",
        )
        .unit("s")
        .range(1e-2, 3600.0)
        .read_only(),
        ParameterSpec::double(
            "supervision.delay",
            1e-3,
            "delay of samples in real time from which the loop gives up bandwidth in proportion; \
             1 ms is 22 degrees of phase at 60 Hz",
        )
        .unit("s")
        .range(1e-6, 3600.0)
        .read_only(),
        ParameterSpec::double(
            "constraints.stage.trajectory",
            0.0,
            "largest position error of a goal of follow_joint_trajectory in motion, where the goal \
             says none; 0: any",
        )
        .unit("m")
        .range(0.0, 1e3),
        ParameterSpec::double(
            "constraints.stage.goal",
            0.0,
            "largest position error at which a goal is reached, where the goal says none; 0: any",
        )
        .unit("m")
        .range(0.0, 1e3),
        ParameterSpec::double(
            "constraints.stopped_velocity_tolerance",
            0.01,
            "largest speed at which a goal is reached, where the goal says none; 0: any",
        )
        .unit("m/s")
        .range(0.0, 1e3),
        ParameterSpec::double(
            "constraints.goal_time",
            0.0,
            "time after the end of a goal's motion to come within its tolerances, where the goal \
             says none; 0: any",
        )
        .unit("s")
        .range(0.0, 1e6),
        ParameterSpec::double(
            "action_monitor_rate",
            20.0,
            "feedback of follow_joint_trajectory per second of the samples' time",
        )
        .unit("Hz")
        .range(0.01, 20_000.0)
        .read_only(),
        ParameterSpec::double(
            "state_publish_rate",
            50.0,
            "messages on ~/controller_state per second of the samples' time",
        )
        .unit("Hz")
        .range(0.01, 20_000.0)
        .read_only(),
        ParameterSpec::double("setpoint_jump_limit", 1e-3, "largest step of a single setpoint")
            .unit("m")
            .range(0.0, 10.0)
            .read_only(),
    ];
    specs.extend(identify_loop::specs());
    specs
}

/// The settings that the parameters ask for.
pub fn settings(values: &ParameterValues) -> ControllerSettings {
    ControllerSettings {
        rate: values.double("rate"),
        gains: Gains {
            p: values.double("gains.stage.p"),
            i: values.double("gains.stage.i"),
            d: values.double("gains.stage.d"),
            lowpass_frequency: values.double("lowpass.frequency"),
            lowpass_damping: values.double("lowpass.damping"),
        },
        // The choices of the parameter are the names of the strategies.
        anti_windup: AntiWindup::from_name(&values.string("gains.stage.antiwindup_strategy"))
            .unwrap_or(AntiWindup::None),
        limits: (
            values.double("gains.stage.u_clamp_min"),
            values.double("gains.stage.u_clamp_max"),
        ),
        mass_feedforward: values.double("feedforward.mass"),
        viscous_feedforward: values.double("feedforward.viscous"),
        observer: (values.double("disturbance_observer.bandwidth") > 0.0).then(|| {
            ObserverSettings {
                bandwidth: values.double("disturbance_observer.bandwidth"),
                limit: values.double("disturbance_observer.limit"),
                mass: values.double("feedforward.mass"),
                delay: values.double("disturbance_observer.delay"),
                forward_delay: values.double("disturbance_observer.delay"),
            }
        }),
    }
}

/// The compensation that the parameters ask for, if any.
pub fn compensation(
    values: &ParameterValues,
    settings: &ControllerSettings,
) -> anyhow::Result<Option<Compensation>> {
    let name = values.string("compensation");
    if name.is_empty() {
        return Ok(None);
    }
    let refused = |error: &dyn std::fmt::Display| {
        anyhow::anyhow!("parameter compensation is {name}: {error}")
    };
    let model = model_named(&name).map_err(|error| refused(&error))?;
    let compensation = Compensation::new(&model, settings, compensation_terms(values))
        .map_err(|error| refused(&error))?;
    Ok(Some(compensation))
}

/// The terms of the compensation that are on.
pub fn compensation_terms(values: &ParameterValues) -> CompensationTermsOn {
    let on = |term: &str| values.boolean(&format!("compensation_terms.{term}"));
    CompensationTermsOn {
        mass: on("mass"),
        viscous: on("viscous"),
        bristles: on("bristles"),
        forces: on("forces"),
        motor: on("motor"),
    }
}

/// The parameters of a controller with what was given for it, checked.
pub fn declared(overrides: &BTreeMap<String, Override>) -> anyhow::Result<ParameterSet> {
    let mut parameters = ParameterSet::declare(specs(), overrides)?;
    let given: Vec<_> =
        overrides.iter().map(|(name, given)| (name.as_str(), given.value.clone())).collect();
    check_given(&given, &parameters).map_err(|reason| anyhow::anyhow!(reason))?;
    parameters.derive(derived);
    Ok(parameters)
}

/// The settings that a controller node called `controller` takes from a parameter file.
pub fn from_file(path: &Path) -> anyhow::Result<ControllerSettings> {
    let file = path.display().to_string();
    let given = ["--ros-args", "--params-file", file.as_str()].map(str::to_owned);
    let (arguments, _) = RosArguments::parse(given.into_iter())?;
    let settings = settings(&*declared(&arguments.parameters_for("/controller"))?);
    settings.check()?;
    Ok(settings)
}

/// Values of [`DERIVED`] that follow from the bandwidth; none while the gains are given.
pub fn derived(values: &ParameterValues) -> Vec<(&'static str, ParameterValue)> {
    if values.string("tuning") != "bandwidth" {
        return Vec::new();
    }
    let gains = Gains::from_bandwidth(values.double("bandwidth"), values.double("mass"));
    let numbers = [gains.p, gains.i, gains.d, gains.lowpass_frequency, gains.lowpass_damping];
    DERIVED.into_iter().zip(numbers.map(ParameterValue::Double)).collect()
}

/// Refuses a gain that `tuning: bandwidth` would overwrite.
pub fn check_given(
    changes: &[(&str, ParameterValue)],
    values: &ParameterValues,
) -> Result<(), String> {
    match changes.iter().find(|(name, _)| DERIVED.contains(name)) {
        Some((name, _)) if values.string("tuning") == "bandwidth" => Err(format!(
            "{name} follows from bandwidth and mass while tuning is bandwidth; set tuning to gains \
             as well"
        )),
        _ => Ok(()),
    }
}

/// The same, and values that do not go together; `values` hold what follows from the changes.
pub fn check_changes(
    changes: &[(&str, ParameterValue)],
    values: &ParameterValues,
) -> Result<(), String> {
    check_given(changes, values)?;
    settings(values).check().map_err(|error| error.to_string())
}
