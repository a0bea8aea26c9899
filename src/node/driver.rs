//! Runs stage and controller as two processes in lockstep, gives them a motion, and waits until it
//! is over.
//!
//! The run repeats bit for bit: the stage's time stands still at its first sample until that is
//! answered, and the controller answers nothing before it has its motion.

use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::Context as _;

use super::domain::OwnDomain;
use super::inlet::Inlet;
use super::outlet::Outlet;
use super::participant::{Network, Participant, Reach};
use super::qos::{COMMANDS, DIAGNOSTICS};
use super::socket_filter::LARGEST_SAMPLE;
use super::waiter::Waiter;
use super::wire::joint_trajectory;
use super::words::quoted;
use crate::interrupt::{self, Patience};
use friction_stage_core::control::Point;
use friction_stage_data::message::to_cdr;
use friction_stage_data::message::{DiagnosticArray, DiagnosticStatus, JointTrajectory};

/// Longest wait for the next sign of progress: for a process to be found, to take the motion, to
/// take the next sample, or to end. A process that ended by itself is seen at once; this is for a
/// machine that is very busy.
const PATIENCE: Duration = Duration::from_secs(120);
/// What a run goes on for after its motion, so that the recording shows how the stage settles.
const SETTLING: Duration = Duration::from_millis(500);
/// Exit code of a node that did its work and lacks something, as the log says.
const WARNED: i32 = 3;

/// One run.
#[derive(Clone, Debug)]
pub struct LockstepRun {
    /// ROS arguments of the stage, such as `-p model:=guide_2`; lockstep and standing still at
    /// first are added.
    pub stage_arguments: Vec<String>,
    pub controller_arguments: Vec<String>,
    /// Motion from the first sample on; times in ns after it.
    pub points: Vec<Point>,
    /// Files that take what the two processes log; `stage` and `controller` are added to the stem.
    pub log_stem: PathBuf,
}

/// How a run went.
#[derive(Clone, Copy, Debug)]
pub struct RunResult {
    /// Samples of the stage.
    pub cycles: u64,
    /// Cycles per second of wall time.
    pub rate: f64,
    /// The recording lacks samples; the log of the stage says how many.
    pub incomplete: bool,
}

/// A participant of its own that drives one run.
pub struct Driver {
    participant: Participant,
    network: Network,
    program: PathBuf,
    /// Kept as long as the run lasts.
    _domain: Option<OwnDomain>,
}

/// A child process that is asked to end when dropped.
struct Process {
    child: Child,
    name: &'static str,
    log: PathBuf,
}

impl Process {
    /// Starts the `name` node (stage or controller); its log goes beside `log_stem`.
    fn start(
        driver: &Driver,
        name: &'static str,
        arguments: &[String],
        log_stem: &Path,
    ) -> anyhow::Result<Process> {
        let log = log_stem.with_file_name(format!(
            "{}_{name}.log",
            log_stem.file_name().map(|name| name.to_string_lossy()).unwrap_or_default()
        ));
        let file = std::fs::File::create(&log)
            .with_context(|| format!("cannot write {}", log.display()))?;
        let mut command = Command::new(&driver.program);
        // Ctrl-C of a terminal is for the driver, which ends its nodes in order.
        command.process_group(0);
        // SAFETY: prctl is async-signal-safe and touches nothing of the parent's.
        unsafe {
            // A node whose driver was killed would go on, and keep the topics of the next one.
            command.pre_exec(|| {
                libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGTERM);
                Ok(())
            });
        }
        let child = command
            .envs(driver.network.variables())
            .arg(format!("{name}-node"))
            .arg("--ros-args")
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(file)
            .spawn()
            .with_context(|| format!("cannot start {}", driver.program.display()))?;
        Ok(Process { child, name, log })
    }

    /// An error with the end of its log if the process has ended.
    fn check(&mut self) -> anyhow::Result<()> {
        match self.child.try_wait()? {
            None => Ok(()),
            Some(status) => Err(self.ended(status)),
        }
    }

    fn ended(&self, status: ExitStatus) -> anyhow::Error {
        anyhow::anyhow!("the {} node ended ({status}); {}", self.name, self.last_words())
    }

    /// The last lines of its log, and where it is.
    fn last_words(&self) -> String {
        let log = std::fs::read_to_string(&self.log).unwrap_or_default();
        let lines: Vec<&str> = log.lines().rev().take(5).collect();
        let tail = lines.into_iter().rev().collect::<Vec<_>>().join("\n  ");
        format!("{} says:\n  {tail}", self.log.display())
    }

    fn signal(&self) {
        // SAFETY: the child has not been waited for, so its process id is still its own.
        unsafe { libc::kill(self.child.id() as libc::pid_t, libc::SIGTERM) };
    }

    /// Asks the process to end and waits for it; whether it ended with a warning.
    fn stop(mut self) -> anyhow::Result<bool> {
        if self.child.try_wait()?.is_none() {
            self.signal();
        }
        let deadline = Instant::now() + PATIENCE;
        while Instant::now() < deadline {
            if let Some(status) = self.child.try_wait()? {
                return match status.code() {
                    Some(0) => Ok(false),
                    Some(WARNED) => Ok(true),
                    _ => Err(self.ended(status)),
                };
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        anyhow::bail!("the {} node did not end within {PATIENCE:?} of SIGTERM", self.name)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            self.signal();
            let deadline = Instant::now() + Duration::from_secs(3);
            while matches!(self.child.try_wait(), Ok(None)) {
                if Instant::now() > deadline {
                    let _ = self.child.kill();
                    let _ = self.child.wait();
                    return;
                }
                std::thread::sleep(Duration::from_millis(5));
            }
        }
    }
}

impl Driver {
    /// Joins `network`, as the nodes will. `program` is the `friction-stage` executable, which is
    /// both nodes too.
    pub fn new(program: &Path, network: Network) -> anyhow::Result<Driver> {
        Driver::join(program, network, None)
    }

    /// On loopback in the domain `wanted`, or in one that no other process on this machine uses.
    pub fn on_loopback(program: &Path, wanted: Option<u16>) -> anyhow::Result<Driver> {
        let own = match wanted {
            Some(_) => None,
            None => Some(OwnDomain::take()?),
        };
        let domain = wanted.or(own.as_ref().map(OwnDomain::number)).unwrap_or_default();
        Driver::join(program, Network { domain, reach: Reach::Localhost }, own)
    }

    /// The domain of the run.
    pub fn domain(&self) -> u16 {
        self.network.domain
    }

    fn join(program: &Path, network: Network, domain: Option<OwnDomain>) -> anyhow::Result<Driver> {
        let options =
            ros2_client::NodeOptions::new().start_parameter_services(false).enable_rosout(false);
        let participant = Participant::join(network, "/", "friction_stage_driver", options)?;
        Ok(Driver { participant, network, program: program.to_owned(), _domain: domain })
    }

    /// Runs a stage, and a controller if it has arguments, in real time for `duration`; numbers of
    /// its last `/diagnostics` by key, 0 where one is missing.
    pub fn observe<const N: usize>(
        self,
        stage_arguments: &[String],
        controller_arguments: Option<&[String]>,
        log_stem: &Path,
        duration: Duration,
        keys: [&str; N],
    ) -> anyhow::Result<[f64; N]> {
        let mut diagnostics =
            Inlet::<DiagnosticArray>::new(&self.participant, "/diagnostics", &DIAGNOSTICS)?;
        let mut stage = Process::start(&self, "stage", stage_arguments, log_stem)?;
        let controller = controller_arguments
            .map(|arguments| Process::start(&self, "controller", arguments, log_stem))
            .transpose()?;
        let (waiter, start) = (Waiter::new(), Instant::now());
        let mut found = None;
        while start.elapsed() < duration {
            stage.check()?;
            let soon = Instant::now() + Duration::from_millis(100);
            if let Some(Ok(message)) =
                waiter.wait(Some(soon), |context| diagnostics.poll_take(context))
                && stage_report(&message).is_some()
            {
                found = Some(keys.map(|key| stage_value(&message, key).unwrap_or(0.0)));
            }
        }
        stage.stop()?;
        controller.map_or(Ok(false), Process::stop)?;
        found.context("the stage published no diagnostics")
    }

    /// Runs the motion, and what follows until it has settled, to its end. `progress` hears the
    /// simulated time since the first sample, s.
    pub fn run(
        self,
        run: &LockstepRun,
        progress: &mut dyn FnMut(f64),
    ) -> anyhow::Result<RunResult> {
        let _patience = Patience::begin();
        let start = super::LOCKSTEP_EPOCH;
        let motion = joint_trajectory("stage", start, &run.points);
        let size = to_cdr(&motion)?.len();
        anyhow::ensure!(
            size < LARGEST_SAMPLE,
            "a motion of {} points is a message of {size} bytes, and the nodes hear less than \
             {LARGEST_SAMPLE}: leave points out, they are interpolated",
            run.points.len()
        );
        let motion_end = run.points.last().map_or(0, |point| point.time);
        let end = start + motion_end + SETTLING.as_nanos() as i64;
        let waiter = Waiter::new();
        let mut setpoint =
            Outlet::<JointTrajectory>::new(&self.participant, "/stage/setpoint", &COMMANDS)?;
        let mut diagnostics =
            Inlet::<DiagnosticArray>::new(&self.participant, "/diagnostics", &DIAGNOSTICS)?;
        let with = |given: &[String], added: &[&str]| -> Vec<String> {
            let added =
                added.iter().flat_map(|parameter| ["-p".to_owned(), (*parameter).to_owned()]);
            given.iter().cloned().chain(added).collect()
        };
        let pause = format!("pause_at:={:?}", (end - start) as f64 * 1e-9);
        let added = ["mode:=lockstep", "wait_for_command:=true", pause.as_str()];
        let arguments = with(&run.stage_arguments, &added);
        // Nothing of the nodes is there yet.
        interrupt::check()?;
        let mut stage = Process::start(&self, "stage", &arguments, &run.log_stem)?;
        let arguments =
            with(&run.controller_arguments, &["wait_for_setpoint:=true", "priority:=0"]);
        let mut controller = Process::start(&self, "controller", &arguments, &run.log_stem)?;
        let deadline = Instant::now() + PATIENCE;
        while setpoint.wait_for_subscribers(2, Duration::from_millis(100)) < 2 {
            interrupt::check()?;
            stage.check()?;
            controller.check()?;
            anyhow::ensure!(
                Instant::now() < deadline,
                "stage and controller did not find each other within {} s: discovery needs UDP \
                 multicast or unicast on the loopback interface, which a firewall or a container \
                 may forbid, and a free ROS domain (--domain chooses one); they say more in {} and \
                 {}",
                PATIENCE.as_secs(),
                stage.log.display(),
                controller.log.display()
            );
        }
        // A recorder that has not met the controller yet would miss its first states.
        loop {
            let soon = Some(Instant::now() + Duration::from_millis(100));
            let message = waiter.wait(soon, |context| diagnostics.poll_take(context));
            interrupt::check()?;
            stage.check()?;
            controller.check()?;
            let is = |key| {
                let message = message.as_ref()?.as_ref().ok()?;
                stage_value::<bool>(message, key)
            };
            if is("recording").is_some_and(|recording| !recording)
                || is("recording_hears_controller") == Some(true)
            {
                break;
            }
            anyhow::ensure!(
                Instant::now() < deadline,
                "the recorder did not hear the controller in {PATIENCE:?}"
            );
        }
        let _ = setpoint.publish(motion);
        let published = Instant::now();
        let mut deadline = published + PATIENCE;
        // Of the reports while time runs: sample, and when, ns.
        let (mut first, mut last) = (None, None);
        let mut cycles = 0;
        loop {
            let look_again = Instant::now() + Duration::from_millis(100);
            let message = waiter.wait(Some(look_again), |context| diagnostics.poll_take(context));
            interrupt::check()?;
            stage.check()?;
            controller.check()?;
            if let Some(Ok(message)) = &message
                && let Some(stopped) = controller_error(message)
            {
                anyhow::bail!(
                    "the controller: {}; see {}",
                    quoted(stopped),
                    controller.log.display()
                );
            }
            if let Some(Ok(message)) = message
                && let Some((sample, stamp)) = stage_report(&message)
            {
                progress((stamp - start).max(0) as f64 * 1e-9);
                if sample > cycles {
                    deadline = Instant::now() + PATIENCE;
                    cycles = sample;
                }
                if stage_value::<bool>(&message, "paused") == Some(true) {
                    break;
                }
                if stamp > start {
                    let at = message.header.stamp.to_nanos();
                    first.get_or_insert((sample, at));
                    last = Some((sample, at));
                }
            }
            anyhow::ensure!(
                Instant::now() < deadline,
                "the run has stood still for {} s; {}\n{}",
                PATIENCE.as_secs(),
                stage.last_words(),
                controller.last_words()
            );
        }
        let taken = published.elapsed();
        // The stage first: without it the controller has nothing to answer, without the controller
        // the stage complains.
        let incomplete = stage.stop()?;
        controller.stop()?;
        let rate = match first.zip(last) {
            Some(((from, began), (to, over))) if over > began => {
                (to - from) as f64 / ((over - began) as f64 * 1e-9)
            }
            // Over before it was seen twice.
            _ => cycles as f64 / taken.as_secs_f64(),
        };
        Ok(RunResult { cycles, rate, incomplete })
    }
}

/// Why the controller gave up, if it did.
fn controller_error(message: &DiagnosticArray) -> Option<&str> {
    let status = message.status.iter().find(|status| status.name.ends_with(": controller"))?;
    (status.level == DiagnosticStatus::ERROR).then_some(status.message.as_str())
}

/// Sample and stamp (ns) in the diagnostics of a stage.
fn stage_report(message: &DiagnosticArray) -> Option<(u64, i64)> {
    Some((stage_value(message, "sample")?, stage_value(message, "stamp_ns")?))
}

/// A value in the diagnostics of a stage.
fn stage_value<T: std::str::FromStr>(message: &DiagnosticArray, key: &str) -> Option<T> {
    let status = message.status.iter().find(|status| status.name.ends_with(": stage"))?;
    status.values.iter().find(|value| value.key == key)?.value.parse().ok()
}
