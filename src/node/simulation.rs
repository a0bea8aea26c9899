//! `simulation_interfaces` 2.1: the stage as any simulator, for test scripts.
//!
//! Time can be paused and stepped in lockstep, where it is simulated; a step is one sample with all
//! that lockstep does for it, its answer included. The services know the state that they asked for;
//! the loop stands still between two samples and says when steps are done.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use futures::StreamExt;
use futures::channel::mpsc::{UnboundedReceiver, UnboundedSender, unbounded};
use futures::future::{BoxFuture, ready};
use ros2_client::Message;
use serde::{Deserialize, Serialize};
use tokio::sync::oneshot;

use super::action::{self, Action, GoalEnd, GoalId, News, Wish};
use super::control::{Control, Steps, StepsEnd};
use super::lock::lock;
use super::participant::Participant;
use super::service::{self, services};
use super::stage_status::StageStatus;
use super::words::quoted;
use friction_stage_data::message::{Header, Quaternion, Twist, Vector3};

/// Interval of feedback, wall time.
const FEEDBACK: Duration = Duration::from_millis(100);

const STOPPED: u8 = 0;
const PLAYING: u8 = 1;
const PAUSED: u8 = 2;

/// Results of all interfaces.
const UNSUPPORTED: u8 = 0;
const OK: u8 = 1;
const NOT_FOUND: u8 = 2;
const FAILED: u8 = 4;
/// Results of SetSimulationState.
const ALREADY: u8 = 101;
const INCORRECT_TRANSITION: u8 = 103;

/// Scopes of ResetSimulation that reset the stage: all, its state, what was spawned (nothing).
const ALL: [u8; 2] = [0, 255];
const STATE: u8 = 2;
const SPAWNED: u8 = 4;

/// Features of SimulatorFeatures: state of an entity, reset, reset of the state, state of the
/// simulation.
const ALWAYS: [u16; 4] = [10, 20, 22, 24];
/// Setting the state, pausing, one step, several, the action.
const IN_LOCKSTEP: [u16; 5] = [25, 26, 31, 32, 33];

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Outcome {
    result: u8,
    error_message: String,
}

impl Outcome {
    fn ok() -> Outcome {
        Outcome { result: OK, error_message: String::new() }
    }

    fn new(result: u8, message: impl Into<String>) -> Outcome {
        Outcome { result, error_message: message.into() }
    }
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct Empty {
    structure_needs_at_least_one_member: u8,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct Features {
    features: Vec<u16>,
    spawn_formats: Vec<String>,
    custom_info: String,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct FeaturesResponse {
    features: Features,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct StateResponse {
    state: u8,
    result: Outcome,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct StateRequest {
    state: u8,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct StepRequest {
    steps: u64,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct ResetRequest {
    scope: u8,
}

#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct OutcomeResponse {
    result: Outcome,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct EntityRequest {
    entity: String,
}

#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Pose {
    position: Vector3,
    orientation: Quaternion,
}

#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct EntityState {
    header: Header,
    pose: Pose,
    twist: Twist,
    acceleration: Twist,
}

#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct EntityResponse {
    result: Outcome,
    state: EntityState,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct StepFeedback {
    completed_steps: u64,
    remaining_steps: u64,
}

impl Message for Empty {}
impl Message for FeaturesResponse {}
impl Message for StateResponse {}
impl Message for StateRequest {}
impl Message for StepRequest {}
impl Message for ResetRequest {}
impl Message for OutcomeResponse {}
impl Message for EntityRequest {}
impl Message for EntityResponse {}
impl Message for StepFeedback {}

services! { "simulation_interfaces":
    GetSimulatorFeatures(Empty) -> FeaturesResponse,
    GetSimulationState(Empty) -> StateResponse,
    SetSimulationState(StateRequest) -> OutcomeResponse,
    StepSimulation(StepRequest) -> OutcomeResponse,
    ResetSimulation(ResetRequest) -> OutcomeResponse,
    GetEntityState(EntityRequest) -> EntityResponse,
}

struct SimulateSteps;

impl Action for SimulateSteps {
    type Goal = StepRequest;
    type Result = OutcomeResponse;
    type Feedback = StepFeedback;
    const PACKAGE: &'static str = "simulation_interfaces";
    const NAME: &'static str = "SimulateSteps";
}

/// What the services share.
#[derive(Clone)]
struct Simulation {
    /// Time is simulated.
    lockstep: bool,
    /// As it was asked for last.
    state: Arc<Mutex<u8>>,
    control: UnboundedSender<Control>,
    status: Arc<StageStatus>,
    joint: String,
    frame: String,
}

impl Simulation {
    /// As it was asked for last, or paused because its parameter says so.
    fn state(&self) -> u8 {
        match *lock(&self.state) {
            PLAYING if self.status.paused.load(Ordering::Relaxed) => PAUSED,
            asked => asked,
        }
    }

    fn features(&self) -> FeaturesResponse {
        let mut features = ALWAYS.to_vec();
        if self.lockstep {
            features.extend(IN_LOCKSTEP);
        }
        let custom_info = "One stage. Its time never goes back, not on reset. It is paused and \
                           stepped in mode: lockstep."
            .to_owned();
        FeaturesResponse { features: Features { features, spawn_formats: Vec::new(), custom_info } }
    }

    async fn set(&self, wanted: u8) -> Outcome {
        if !self.lockstep {
            return Outcome::new(UNSUPPORTED, "the stage runs in real time, not in lockstep");
        }
        let now = self.state();
        match (now, wanted) {
            _ if now == wanted => {
                return Outcome::new(ALREADY, "the simulation is in this state already");
            }
            (STOPPED, PAUSED) => {
                return Outcome::new(INCORRECT_TRANSITION, "stopped: play first, then pause");
            }
            (_, STOPPED | PLAYING | PAUSED) => {}
            _ => {
                let text = format!(
                    "state {wanted} is none of 0 (stopped), 1 (playing), 2 (paused); a signal ends \
                     the program"
                );
                return Outcome::new(UNSUPPORTED, text);
            }
        }
        let (reply, stands) = oneshot::channel();
        let _ = self.control.unbounded_send(Control::Pause(wanted != PLAYING, reply));
        if stands.await.is_err() {
            return Outcome::new(FAILED, "the node is shutting down");
        }
        *lock(&self.state) = wanted;
        if wanted == STOPPED { self.reset().await } else { Outcome::ok() }
    }

    async fn reset(&self) -> Outcome {
        let (reply, done) = oneshot::channel();
        let _ = self.control.unbounded_send(Control::Reset(reply));
        match done.await {
            Ok(Ok(_)) => Outcome::ok(),
            Ok(Err(why)) => Outcome::new(FAILED, why),
            Err(_) => Outcome::new(FAILED, "the node is shutting down"),
        }
    }

    async fn reset_scope(&self, scope: u8) -> Outcome {
        match scope {
            SPAWNED => Outcome::ok(),
            STATE => self.reset().await,
            scope if ALL.contains(&scope) => {
                let mut outcome = self.reset().await;
                if outcome.result == OK {
                    outcome.error_message = "time goes on: it never goes back".to_owned();
                }
                outcome
            }
            scope => {
                let text = format!("scope {scope}: time never goes back; 2 resets the state");
                Outcome::new(UNSUPPORTED, text)
            }
        }
    }

    /// Asks for steps: what is done so far, and their end.
    fn step(&self, count: u64) -> Result<(Arc<AtomicU64>, oneshot::Receiver<StepsEnd>), Outcome> {
        if !self.lockstep {
            let text = "the stage runs in real time, not in lockstep";
            return Err(Outcome::new(UNSUPPORTED, text));
        }
        if self.state() != PAUSED {
            return Err(Outcome::new(FAILED, "the simulation is not paused: SetSimulationState 2"));
        }
        if count == 0 {
            return Err(Outcome::new(FAILED, "steps is 0, must be 1 or more"));
        }
        let (end, ended) = oneshot::channel();
        let done = Arc::new(AtomicU64::new(0));
        let steps = Steps { count, done: done.clone(), end };
        let _ = self.control.unbounded_send(Control::Step(steps));
        Ok((done, ended))
    }

    fn entity(&self, name: &str) -> EntityResponse {
        if name != self.joint {
            let text = format!("no entity `{}`: there is `{}`", quoted(name), self.joint);
            let result = Outcome::new(NOT_FOUND, text);
            return EntityResponse { result, ..EntityResponse::default() };
        }
        let [position, velocity, acceleration] = self.status.motion();
        let along = |x| Vector3 { x, ..Vector3::default() };
        let stamp = self.status.stamp.load(Ordering::Relaxed);
        let state = EntityState {
            header: Header::new(stamp, self.frame.as_str()),
            pose: Pose { position: along(position), ..Pose::default() },
            twist: Twist { linear: along(velocity), ..Twist::default() },
            acceleration: Twist { linear: along(acceleration), ..Twist::default() },
        };
        EntityResponse { result: Outcome::ok(), state }
    }
}

fn outcome_of(end: Result<StepsEnd, oneshot::error::RecvError>) -> Outcome {
    match end {
        Ok(StepsEnd::Done) => Outcome::ok(),
        Ok(StepsEnd::Stopped) => Outcome::new(FAILED, "the steps were stopped"),
        Ok(StepsEnd::Failed(why)) => Outcome::new(FAILED, why),
        Err(_) => Outcome::new(FAILED, "the node is shutting down"),
    }
}

/// What the services need of the stage.
pub struct Setup<'a> {
    pub participant: &'a Participant,
    pub lockstep: bool,
    pub control: UnboundedSender<Control>,
    pub status: Arc<StageStatus>,
    pub joint: &'a str,
    pub frame: &'a str,
}

/// Opens the services, whose names `resolve` makes absolute; what there is to poll.
pub fn serve(
    setup: Setup<'_>,
    resolve: impl Fn(&str) -> String,
    action_name: &str,
) -> anyhow::Result<Vec<BoxFuture<'static, ()>>> {
    let participant = setup.participant;
    let simulation = Simulation {
        lockstep: setup.lockstep,
        state: Arc::new(Mutex::new(PLAYING)),
        control: setup.control,
        status: setup.status,
        joint: setup.joint.to_owned(),
        frame: setup.frame.to_owned(),
    };
    let own = || simulation.clone();
    let (features, current, setting) = (own(), own(), own());
    let (stepping, resetting, looking, acting) = (own(), own(), own(), own());
    let mut tasks: Vec<BoxFuture<'static, ()>> = vec![
        Box::pin(service::serve::<GetSimulatorFeatures, _, _>(
            participant,
            &resolve("~/get_simulator_features"),
            move |_: Empty| ready(features.features()),
        )?),
        Box::pin(service::serve::<GetSimulationState, _, _>(
            participant,
            &resolve("~/get_simulation_state"),
            move |_: Empty| ready(StateResponse { state: current.state(), result: Outcome::ok() }),
        )?),
        Box::pin(service::serve::<GetEntityState, _, _>(
            participant,
            &resolve("~/get_entity_state"),
            move |request: EntityRequest| ready(looking.entity(&request.entity)),
        )?),
    ];
    tasks.push(Box::pin(service::serve::<SetSimulationState, _, _>(
        participant,
        &resolve("~/set_simulation_state"),
        move |request: StateRequest| {
            let simulation = setting.clone();
            async move { OutcomeResponse { result: simulation.set(request.state).await } }
        },
    )?));
    tasks.push(Box::pin(service::serve::<StepSimulation, _, _>(
        participant,
        &resolve("~/step_simulation"),
        move |request: StepRequest| {
            let asked = stepping.step(request.steps);
            async move {
                let result = match asked {
                    Ok((_, ended)) => outcome_of(ended.await),
                    Err(refused) => refused,
                };
                OutcomeResponse { result }
            }
        },
    )?));
    tasks.push(Box::pin(service::serve::<ResetSimulation, _, _>(
        participant,
        &resolve("~/reset_simulation"),
        move |request: ResetRequest| {
            let simulation = resetting.clone();
            async move { OutcomeResponse { result: simulation.reset_scope(request.scope).await } }
        },
    )?));
    let (wish, wishes) = unbounded();
    let (news, reported) = unbounded();
    let wish = move |wanted| {
        let _ = wish.unbounded_send(wanted);
    };
    tasks.push(Box::pin(action::serve::<SimulateSteps, _>(
        participant,
        action_name,
        wish,
        reported,
    )?));
    tasks.push(Box::pin(act(acting, wishes, news)));
    Ok(tasks)
}

/// Steps that a goal asked for.
struct Acting {
    id: GoalId,
    count: u64,
    done: Arc<AtomicU64>,
    ended: oneshot::Receiver<StepsEnd>,
}

/// The end of the steps, if there are any; else it waits for ever.
async fn end_of(acting: &mut Option<Acting>) -> Result<StepsEnd, oneshot::error::RecvError> {
    match acting {
        Some(acting) => (&mut acting.ended).await,
        None => std::future::pending().await,
    }
}

/// Serves the goals of `~/simulate_steps`, one at a time.
async fn act(
    simulation: Simulation,
    mut wishes: UnboundedReceiver<Wish<SimulateSteps>>,
    news: UnboundedSender<News<SimulateSteps>>,
) {
    let tell = |reported| {
        let _ = news.unbounded_send(reported);
    };
    let mut acting: Option<Acting> = None;
    let mut interval = tokio::time::interval(FEEDBACK);
    loop {
        tokio::select! {
            biased;
            ended = end_of(&mut acting) => {
                let Some(Acting { id, .. }) = acting.take() else { continue };
                let end = match &ended {
                    Ok(StepsEnd::Done) => GoalEnd::Succeeded,
                    Ok(StepsEnd::Stopped) => GoalEnd::Canceled,
                    _ => GoalEnd::Aborted,
                };
                tell(News::Ended(id, end, OutcomeResponse { result: outcome_of(ended) }));
            }
            wish = wishes.next() => match wish {
                None => return,
                Some(Wish::Cancel { id, reply }) => {
                    let active = acting.as_ref().is_some_and(|acting| acting.id == id);
                    if active {
                        let _ = simulation.control.unbounded_send(Control::StopSteps);
                    }
                    let _ = reply.send(active);
                }
                Some(Wish::Goal { id, goal, reply }) => {
                    let _ = reply.send(Ok(()));
                    match simulation.step(goal.steps) {
                        Ok((done, ended)) if acting.is_none() => {
                            acting = Some(Acting { id, count: goal.steps, done, ended });
                        }
                        Ok((_, ended)) => {
                            let result = outcome_of(ended.await);
                            tell(News::Ended(id, GoalEnd::Aborted, OutcomeResponse { result }));
                        }
                        Err(result) => {
                            tell(News::Ended(id, GoalEnd::Aborted, OutcomeResponse { result }));
                        }
                    }
                }
            },
            _ = interval.tick(), if acting.is_some() => {
                if let Some(Acting { id, count, done, .. }) = &acting {
                    let completed_steps = done.load(Ordering::Relaxed);
                    let remaining_steps = count.saturating_sub(completed_steps);
                    tell(News::Feedback(*id, StepFeedback { completed_steps, remaining_steps }));
                }
            }
        }
    }
}
