//! What both nodes share: arguments, logging, the participant, services, signals, exit codes.
//!
//! The main thread runs a single-threaded tokio runtime with everything that waits and is in no
//! hurry: discovery, services, diagnostics, signals. The node's own loop runs on a plain thread and
//! gets what happens as [`Control`] events.

use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::sync::{Arc, Mutex};

use anyhow::Context as _;
use futures::channel::mpsc::UnboundedSender;
use futures::future::BoxFuture;
use ros2_client::NodeOptions;
use tokio::sync::oneshot;

use super::arguments::{Override, RosArguments, fully_qualified};
use super::control::Control;
use super::cpu;
use super::lifecycle::{self, Lifecycle};
use super::lock::lock;
use super::memory_watch;
use super::parameters::{ParameterServer, ParameterSet, ParameterSpec};
use super::participant::{self, Network, Participant, environment};
use super::qos_overrides::{self, QosOverrides};
use super::service::{self, services};
use super::signals::Signals;
use super::simulation;
use super::std_srvs::{SetBoolRequest, SetBoolResponse, TriggerRequest, TriggerResponse};
use super::words::quoted;

/// Name and arguments of a node, before it joins the network.
pub struct Startup {
    pub arguments: RosArguments,
    /// The command line, for the provenance of recordings.
    pub command_line: Vec<String>,
    pub name: String,
    pub namespace: String,
}

impl Startup {
    /// Reads the command line (without the program's name) of a node called `default_name` unless
    /// remapped.
    pub fn parse(default_name: &str, command_line: Vec<String>) -> anyhow::Result<Startup> {
        let (arguments, others) = RosArguments::parse(command_line.iter().cloned())?;
        if let Some(other) = others.first() {
            anyhow::bail!(
                "unexpected argument `{other}`; parameters go behind --ros-args, as in --ros-args \
                 -p name:=value; --help lists them"
            );
        }
        let name = arguments.node_name(default_name);
        let namespace = arguments.namespace(&name, "/");
        Ok(Startup { arguments, command_line, name, namespace })
    }

    pub fn full_name(&self) -> String {
        fully_qualified(&self.namespace, &self.name)
    }

    /// Absolute name of a topic after expansion and remapping.
    pub fn topic(&self, name: &str) -> String {
        self.arguments.resolve(&self.name, &self.namespace, name)
    }

    fn service_name(&self, name: &str) -> String {
        self.arguments.resolve_service(&self.name, &self.namespace, name)
    }

    /// Values of parameters that the command line and its files give to this node.
    pub fn overrides(&self) -> BTreeMap<String, Override> {
        let mut given = self.arguments.parameters_for(&self.full_name());
        given.retain(|name, _| !name.starts_with(qos_overrides::PREFIX));
        given
    }

    /// The rest of them: quality of service of single topics.
    fn qos_overrides(&self) -> anyhow::Result<QosOverrides> {
        let given = self.arguments.parameters_for(&self.full_name());
        let named = given.iter().filter(|(name, _)| name.starts_with(qos_overrides::PREFIX));
        Ok(QosOverrides::new(named.map(|(name, given)| (name.as_str(), &given.value)))?)
    }

    /// Logs of this process go to stderr, at the level of `--log-level`, else of `RUST_LOG`, else
    /// info.
    pub fn start_logging(&self) {
        use tracing_subscriber::filter::{EnvFilter, LevelFilter};
        let level =
            self.arguments.log_level(&self.name).map_or(LevelFilter::INFO, LevelFilter::from);
        // The DDS library warns of every stray packet, and calls errors what is none: leaving a
        // multicast group that loopback does not have, a writer that is removed under load.
        let quiet = "rustdds=error,ros2_client=error,rustdds::network=off,\
                     rustdds::discovery::discovery_db=off,rustdds::dds::pubsub=off,\
                     ros2_client::node=off";
        let filter = std::env::var("RUST_LOG")
            .ok()
            .and_then(|text| EnvFilter::try_new(text).ok())
            .unwrap_or_else(|| EnvFilter::new(format!("{level},{quiet}")));
        // A second start in one process (tests) keeps the first subscriber.
        let _ = tracing_subscriber::fmt()
            .with_env_filter(filter)
            .with_writer(std::io::stderr)
            .with_ansi(std::io::stderr().is_terminal())
            .with_target(false)
            .try_init();
    }

    /// The parameter `cpu` of both nodes.
    pub fn cpu_spec() -> ParameterSpec {
        let description = "processor to run on; both nodes of a lockstep run are fastest on the \
                           same one; -1: any";
        ParameterSpec::integer("cpu", cpu::ANY, description)
            .range(cpu::ANY as f64, 1023.0)
            .read_only()
    }

    /// Binds the process to the processor of the parameter `cpu`; to be called before other threads
    /// start.
    pub fn pin(&self, wanted: i64) -> anyhow::Result<()> {
        let Ok(number) = usize::try_from(wanted) else { return Ok(()) };
        cpu::pin(number).with_context(|| {
            format!("parameter cpu is {wanted}: must be below {} here", cpu::online())
        })
    }

    /// The parameter `priority` of both nodes.
    pub fn priority_spec() -> ParameterSpec {
        let description = "real-time priority (SCHED_FIFO) of the node in real time, 0 for none; \
                           needs the right to it (ulimit -r, or CAP_SYS_NICE)";
        ParameterSpec::integer("priority", 10, description).range(0.0, 49.0).read_only()
    }

    /// Asks for the real-time priority of the parameter `priority`, before other threads start;
    /// whether it was granted.
    pub fn schedule(&self, priority: i64) -> bool {
        let Some(priority) = i32::try_from(priority).ok().filter(|priority| *priority > 0) else {
            return false;
        };
        match cpu::real_time(priority) {
            Ok(()) => {
                tracing::info!("real-time scheduling: granted, priority {priority}");
                true
            }
            Err(error) => {
                tracing::info!(
                    "real-time scheduling: not granted ({error}); on a busy machine samples come \
                     late (ulimit -r, or the capability CAP_SYS_NICE, permits it)"
                );
                false
            }
        }
    }

    /// The parameter `lifecycle` of both nodes.
    pub fn lifecycle_spec() -> ParameterSpec {
        let description = "whether the node is a managed one (ros2 lifecycle), which starts \
                           unconfigured and exerts force when it is active; without ~/enable";
        ParameterSpec::boolean("lifecycle", false, description).read_only()
    }

    /// Joins the network that the environment names.
    pub fn join(&self) -> anyhow::Result<Participant> {
        let network = Network::from_environment()?;
        let enclave = self.arguments.enclave();
        for warning in participant::without_effect(network, enclave, environment) {
            tracing::warn!("{warning}");
        }
        participant::announce_to_static_peers(network)?;
        let options = NodeOptions::new()
            .start_parameter_services(false)
            .enable_rosout(self.arguments.rosout_logs());
        let qos = self.qos_overrides()?;
        Ok(Participant::join_with(network, &self.namespace, &self.name, options, qos)?)
    }
}

services! { "std_srvs":
    Trigger(TriggerRequest) -> TriggerResponse,
    SetBool(SetBoolRequest) -> SetBoolResponse,
}

/// Everything of a node that waits and is in no hurry. Built up, then [`Background::run`] until a
/// signal or the loop ends it.
pub struct Background {
    tasks: Vec<BoxFuture<'static, ()>>,
    control: UnboundedSender<Control>,
    participant: Participant,
    signals: Signals,
}

/// Why [`Background::run`] came back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// SIGINT or SIGTERM.
    Signal,
    /// The process takes this much memory, bytes, beyond [`memory_watch::BOUND`].
    Memory(u64),
    /// The node's loop ended by itself.
    Loop,
}

impl Background {
    /// Starts the parameter services. `control` reaches the node's loop.
    pub fn new(
        signals: Signals,
        participant: &Participant,
        parameters: Arc<Mutex<ParameterSet>>,
        control: UnboundedSender<Control>,
    ) -> anyhow::Result<Background> {
        let server = ParameterServer::new(participant, parameters)?;
        let participant = participant.clone();
        Ok(Background { tasks: vec![Box::pin(server.run())], control, participant, signals })
    }

    /// Another task that runs as long as the node.
    pub fn spawn(&mut self, task: impl Future<Output = ()> + Send + 'static) {
        self.tasks.push(Box::pin(task));
    }

    /// `~/enable`, or the services of a managed node where the parameter `lifecycle` asks for it.
    pub fn serve_enable_or_lifecycle(
        &mut self,
        startup: &Startup,
        participant: &Participant,
        managed: bool,
    ) -> anyhow::Result<Option<Lifecycle>> {
        if !managed {
            self.serve_enable(startup, participant)?;
            return Ok(None);
        }
        let (lifecycle, tasks) = lifecycle::serve(
            participant,
            |name| startup.service_name(name),
            &startup.topic("~/transition_event"),
            self.control.clone(),
        )?;
        self.tasks.extend(tasks);
        Ok(Some(lifecycle))
    }

    /// `~/enable`: passes the wish on to the loop.
    fn serve_enable(&mut self, startup: &Startup, participant: &Participant) -> anyhow::Result<()> {
        let control = self.control.clone();
        let handler = move |request: SetBoolRequest| {
            let success = control.unbounded_send(Control::Enable(request.data)).is_ok();
            let message = if request.data { "enabled" } else { "disabled: no force" }.to_owned();
            std::future::ready(SetBoolResponse { success, message })
        };
        let task = service::serve::<SetBool, _, _>(
            participant,
            &startup.service_name("~/enable"),
            handler,
        )?;
        self.spawn(task);
        Ok(())
    }

    /// `~/reset`: asks the loop and waits for its answer.
    pub fn serve_reset(
        &mut self,
        startup: &Startup,
        participant: &Participant,
    ) -> anyhow::Result<()> {
        let control = self.control.clone();
        self.serve_trigger(startup, participant, "~/reset", move || {
            let (reply, answer) = oneshot::channel();
            let sent = control.unbounded_send(Control::Reset(reply)).is_ok();
            async move {
                let result = if sent { answer.await.ok() } else { None };
                result.unwrap_or_else(|| Err("the node is shutting down".to_owned()))
            }
        })
    }

    /// A service without arguments: `answer` says what was done, or why not.
    pub fn serve_trigger<F>(
        &mut self,
        startup: &Startup,
        participant: &Participant,
        name: &str,
        mut answer: impl FnMut() -> F + Send + 'static,
    ) -> anyhow::Result<()>
    where
        F: Future<Output = Result<String, String>> + Send + 'static,
    {
        let handler = move |_: TriggerRequest| {
            let answer = answer();
            async move {
                match answer.await {
                    Ok(message) => TriggerResponse { success: true, message },
                    Err(message) => TriggerResponse { success: false, message },
                }
            }
        };
        let task =
            service::serve::<Trigger, _, _>(participant, &startup.service_name(name), handler)?;
        self.spawn(task);
        Ok(())
    }

    /// The services and the action of `simulation_interfaces`.
    pub fn serve_simulation(
        &mut self,
        startup: &Startup,
        setup: simulation::Setup<'_>,
    ) -> anyhow::Result<()> {
        let action = startup.topic("~/simulate_steps");
        let tasks = simulation::serve(setup, |name| startup.service_name(name), &action)?;
        self.tasks.extend(tasks);
        Ok(())
    }

    /// `~/record`: `switch` starts or stops and says what it did.
    pub fn serve_record(
        &mut self,
        startup: &Startup,
        participant: &Participant,
        switch: impl FnMut(bool) -> Result<String, String> + Send + 'static,
    ) -> anyhow::Result<()> {
        let switch = Arc::new(Mutex::new(switch));
        let handler = move |request: SetBoolRequest| {
            let switch = switch.clone();
            // It may wait for a disk; signals and the other services do not.
            let done = tokio::task::spawn_blocking(move || (*lock(&switch))(request.data));
            async move {
                match done.await.unwrap_or_else(|error| Err(error.to_string())) {
                    Ok(message) => SetBoolResponse { success: true, message },
                    Err(message) => SetBoolResponse { success: false, message },
                }
            }
        };
        let task = service::serve::<SetBool, _, _>(
            participant,
            &startup.service_name("~/record"),
            handler,
        )?;
        self.spawn(task);
        Ok(())
    }

    /// Runs until a signal comes or `loop_ended` is done; then tells the loop to shut down.
    pub fn run(self, loop_ended: oneshot::Receiver<()>) -> anyhow::Result<End> {
        let Background { tasks, control, participant, signals } = self;
        for name in participant.qos_overrides().unused() {
            tracing::warn!("parameter `{}` has no effect: no such endpoint", quoted(&name));
        }
        let (runtime, mut signals) = signals.split();
        let end = runtime.block_on(async move {
            let everything = futures::future::join_all(tasks);
            let memory = memory_watch::exceeds(memory_watch::BOUND);
            tokio::pin!(everything, loop_ended, memory);
            tokio::select! {
                biased;
                () = signals.next() => End::Signal,
                bytes = &mut memory => End::Memory(bytes),
                _ = &mut loop_ended => End::Loop,
                _ = &mut everything => End::Loop,
            }
        });
        let _ = control.unbounded_send(Control::Shutdown);
        // What waits for a disk is not waited for here.
        runtime.shutdown_background();
        Ok(end)
    }
}
