//! Parameters of the stage node: what there is, and what it means.

use std::path::PathBuf;
use std::time::Duration;

use super::parameters::{ParameterSpec, ParameterValues};
use super::runtime::Startup;
use friction_stage_core::model::{ModelError, StageModel};
use friction_stage_core::plant::{Rates, RatesError, model_named};
use friction_stage_data::bag::{BagOptions, Sync};

/// How the time of the stage runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// With the wall clock; commands act from the next sample on.
    Realtime,
    /// From answer to answer; time stands still while a sample is unanswered.
    Lockstep,
}

/// What drives the motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drive {
    /// Force commands.
    Force,
    /// The stage's own position loop on the setpoint, as in the measuring rig.
    Servo,
}

/// Everything the stage node is started with.
#[derive(Clone, Debug)]
pub struct StageSettings {
    pub model: StageModel,
    pub rates: Rates,
    pub mode: Mode,
    pub drive: Drive,
    pub seed: u64,
    /// Real-time priority that is asked for; 0: none.
    pub priority: i64,
    pub command_timeout: Duration,
    /// In lockstep, every this many samples one needs an answer.
    pub every: u64,
    /// Pause between a sample and its clock in lockstep.
    pub clock_pause: Duration,
    pub answer_timeout: Duration,
    pub wait_for_command: bool,
    /// In lockstep, time of the sample after which time is paused, ns since the first one.
    pub pause_at: Option<i64>,
    pub publish_clock: bool,
    pub record: Option<PathBuf>,
    pub record_into: PathBuf,
    /// How bags are written.
    pub bags: BagOptions,
    pub joint: String,
    pub frame: String,
    /// Hz
    pub servo_bandwidth: f64,
    /// m
    pub setpoint_jump_limit: f64,
    /// Port of the live page on loopback; none: no page.
    pub live_port: Option<u16>,
}

/// Least and largest bandwidth of the stage's own position loop, Hz.
pub const SERVO_BANDWIDTH: (f64, f64) = (0.1, 1000.0);

/// ` is NAME` for a message about the model, where its cause does not name it.
fn said_once(name: &str, cause: &ModelError) -> String {
    if cause.to_string().contains(name) { String::new() } else { format!(" is {name}") }
}

/// Settings that do not fit together.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    #[error("parameter model{}: {source}", said_once(name, source))]
    Model { name: String, source: ModelError },
    #[error(transparent)]
    Rates(#[from] RatesError),
    #[error(
        "drive: servo has no commands to wait for, so it cannot run in mode: lockstep; use mode: \
         realtime"
    )]
    ServoInLockstep,
    #[error(
        "live_port is {0}: the live page shows a stage in real time, use mode: realtime, or view \
         with friction-stage what a run in mode: lockstep has recorded"
    )]
    LiveInLockstep(u16),
}

/// The parameters of the stage node.
pub fn specs() -> Vec<ParameterSpec> {
    let (control_min, control_max) = Rates::CONTROL_RANGE;
    let (physics_min, physics_max) = Rates::PHYSICS_RANGE;
    vec![
        Startup::cpu_spec(),
        Startup::priority_spec(),
        Startup::lifecycle_spec(),
        ParameterSpec::string(
            "model",
            "guide_1",
            "what the stage is: a model file (.yaml), a guide of the catalogue for the 40 kg stage \
             on four of it, or rig:GUIDE for the measuring rig with one",
        )
        .read_only(),
        ParameterSpec::double("control_rate", Rates::DEFAULT.control(), "samples per second")
            .unit("Hz")
            .range(control_min, control_max)
            .read_only(),
        ParameterSpec::double(
            "physics_rate",
            Rates::DEFAULT.physics(),
            "internal steps per second, a whole multiple of control_rate",
        )
        .unit("Hz")
        .range(physics_min, physics_max)
        .read_only(),
        ParameterSpec::string(
            "mode",
            "realtime",
            "how time runs: with the wall clock, or from \
            answer to answer",
        )
        .choices(&["realtime", "lockstep"])
        .read_only(),
        ParameterSpec::string(
            "drive",
            "force",
            "what drives the motor: force commands, or a position loop of its own on the setpoint",
        )
        .choices(&["force", "servo"])
        .read_only(),
        ParameterSpec::integer("seed", 1, "seed of the sensor noise")
            .range(0.0, i64::MAX as f64)
            .read_only(),
        ParameterSpec::boolean(
            "noise",
            true,
            "false: sensors without noise and without \
            quantisation",
        )
        .read_only(),
        ParameterSpec::double(
            "command_timeout",
            0.1,
            "silence after which the motor force goes to zero, in lockstep of simulated time where \
             time moves on without answers; in real time another source may then command",
        )
        .unit("s")
        .range(1e-3, 3600.0),
        ParameterSpec::integer(
            "every",
            1,
            "in lockstep, one sample in this many waits for an \
            answer",
        )
        .range(1.0, 1e6)
        .read_only(),
        ParameterSpec::double(
            "clock_pause",
            0.0,
            "in lockstep, pause between a sample and its \
            clock",
        )
        .unit("s")
        .range(0.0, 1.0),
        ParameterSpec::double(
            "answer_timeout",
            1.0,
            "in lockstep, wait after which a missing answer to ~/force is an error and the sample \
             is sent again; on ~/joint_commands time then moves on without it",
        )
        .unit("s")
        .range(1e-2, 3600.0),
        ParameterSpec::boolean(
            "wait_for_command",
            false,
            "in lockstep, time stands still from the start until the first command",
        )
        .read_only(),
        ParameterSpec::double(
            "pause_at",
            0.0,
            "in lockstep, simulated time at which time is paused once: the sample there is \
             answered, and no other goes out before ~/set_simulation_state or ~/step_simulation; \
             0: never",
        )
        .unit("s")
        .range(0.0, 1e9)
        .read_only(),
        ParameterSpec::boolean(
            "publish_clock",
            false,
            "publish /clock in real time too; in \
            lockstep it always is",
        )
        .read_only(),
        ParameterSpec::string(
            "record",
            "",
            "bag directory to record into from the start; must not \
            exist",
        )
        .read_only(),
        ParameterSpec::string(
            "record_sync",
            Sync::NAMES[1],
            "when a recording is brought to the disk: left to the system, when a file is closed, \
             or every half second as well",
        )
        .choices(&Sync::NAMES)
        .read_only(),
        ParameterSpec::integer(
            "record_split_size",
            0,
            "size of a file of a recording, bytes, from which the next one is begun; 0: one file",
        )
        .range(0.0, 1e15)
        .read_only(),
        ParameterSpec::double(
            "record_split_duration",
            0.0,
            "time of a file of a recording from which the next one is begun; 0: one file",
        )
        .unit("s")
        .range(0.0, 1e9)
        .read_only(),
        ParameterSpec::string("record_into", ".", "directory for the bags that ~/record starts")
            .read_only(),
        ParameterSpec::integer(
            "live_port",
            0,
            "port of a page on 127.0.0.1 that shows the stage as it runs and, in drive: servo, \
             moves it; 0: none",
        )
        .range(0.0, 65535.0)
        .read_only(),
        ParameterSpec::string("joint", "stage", "name of the joint in messages").read_only(),
        ParameterSpec::string("frame_id", "stage", "frame of the messages").read_only(),
        ParameterSpec::double(
            "servo_bandwidth",
            60.0,
            "bandwidth of the position loop of drive: \
            servo",
        )
        .unit("Hz")
        .range(SERVO_BANDWIDTH.0, SERVO_BANDWIDTH.1)
        .read_only(),
        ParameterSpec::double(
            "setpoint_jump_limit",
            1e-3,
            "largest step of a single setpoint in \
            drive: servo",
        )
        .unit("m")
        .range(0.0, 10.0)
        .read_only(),
    ]
}

impl StageSettings {
    pub fn new(values: &ParameterValues) -> Result<StageSettings, SettingsError> {
        let name = values.string("model");
        let model = model_named(&name).map_err(|source| SettingsError::Model { name, source })?;
        let seconds = |name: &str| Duration::from_secs_f64(values.double(name));
        let settings = StageSettings {
            model: if values.boolean("noise") { model } else { model.without_noise() },
            rates: Rates::new(values.double("control_rate"), values.double("physics_rate"))?,
            mode: if values.string("mode") == "lockstep" { Mode::Lockstep } else { Mode::Realtime },
            drive: if values.string("drive") == "servo" { Drive::Servo } else { Drive::Force },
            seed: values.integer("seed").unsigned_abs(),
            priority: values.integer("priority"),
            command_timeout: seconds("command_timeout"),
            every: values.integer("every").unsigned_abs(),
            clock_pause: seconds("clock_pause"),
            answer_timeout: seconds("answer_timeout"),
            wait_for_command: values.boolean("wait_for_command"),
            pause_at: Some(values.double("pause_at"))
                .filter(|seconds| *seconds > 0.0)
                .map(|seconds| (seconds * 1e9).round() as i64),
            publish_clock: values.boolean("publish_clock") || values.string("mode") == "lockstep",
            record: Some(values.string("record"))
                .filter(|path| !path.is_empty())
                .map(PathBuf::from),
            record_into: PathBuf::from(values.string("record_into")),
            bags: BagOptions {
                // The choices of the parameter are the names.
                sync: Sync::from_name(&values.string("record_sync")).unwrap_or_default(),
                split_bytes: u64::try_from(values.integer("record_split_size"))
                    .ok()
                    .filter(|bytes| *bytes > 0),
                split_duration: Some(values.double("record_split_duration"))
                    .filter(|seconds| *seconds > 0.0)
                    .map(Duration::from_secs_f64),
                ..BagOptions::default()
            },
            joint: values.string("joint"),
            frame: values.string("frame_id"),
            servo_bandwidth: values.double("servo_bandwidth"),
            setpoint_jump_limit: values.double("setpoint_jump_limit"),
            live_port: u16::try_from(values.integer("live_port")).ok().filter(|port| *port > 0),
        };
        if let (Some(port), Mode::Lockstep) = (settings.live_port, settings.mode) {
            return Err(SettingsError::LiveInLockstep(port));
        }
        if settings.drive == Drive::Servo && settings.mode == Mode::Lockstep {
            return Err(SettingsError::ServoInLockstep);
        }
        Ok(settings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::parameters::ParameterSet;

    #[test]
    fn defaults_are_the_stage_of_the_paper_in_real_time() {
        let set = ParameterSet::declare(specs(), &Default::default()).unwrap();
        let settings = StageSettings::new(&set).unwrap();
        assert_eq!((settings.mode, settings.drive), (Mode::Realtime, Drive::Force));
        assert_eq!(settings.rates, Rates::DEFAULT);
        assert_eq!(settings.model.mass, 40.0);
    }
}
