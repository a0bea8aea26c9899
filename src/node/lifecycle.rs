//! A managed node: its states, the five services and the event topic, as rcl_lifecycle has them.
//!
//! On by the parameter `lifecycle`. Only an active node exerts force: the stage takes its samples
//! in every state, but commands move it when it is active alone, and the controller answers when it
//! is. To configure and to clean up is to reset. A node that stays at ERROR is deactivated. How the
//! loop does that is its own business: it gets what `~/enable` and `~/reset` would send.

use std::sync::{Arc, Mutex};

use futures::channel::mpsc::UnboundedSender;
use futures::future::{BoxFuture, ready};
use ros2_client::Message;
use serde::{Deserialize, Serialize};
use tokio::sync::oneshot;

use super::clock;
use super::control::Control;
use super::lock::lock;
use super::outlet::Outlet;
use super::participant::Participant;
use super::qos::TRANSITIONS;
use super::service::{self, services};
use friction_stage_data::message::lifecycle_msgs::{State, Transition, TransitionEvent};

/// Looks at an active node in a row that find it at ERROR before it is deactivated: what was wrong
/// before it was activated has then been forgotten.
const PATIENCE: u32 = 2;

const UNCONFIGURED: u8 = 1;
const INACTIVE: u8 = 2;
const ACTIVE: u8 = 3;
const FINALIZED: u8 = 4;

/// Numbers and names of all states.
const STATES: [(u8, &str); 11] = [
    (0, "unknown"),
    (UNCONFIGURED, "unconfigured"),
    (INACTIVE, "inactive"),
    (ACTIVE, "active"),
    (FINALIZED, "finalized"),
    (10, "configuring"),
    (11, "cleaningup"),
    (12, "shuttingdown"),
    (13, "activating"),
    (14, "deactivating"),
    (15, "errorprocessing"),
];

const DEACTIVATE: u8 = 4;

/// Numbers and names of all transitions, with the states at their ends.
const TRANSITIONS_OF_ALL: [(u8, &str, u8, u8); 25] = [
    (1, "configure", UNCONFIGURED, 10),
    (10, "transition_success", 10, INACTIVE),
    (11, "transition_failure", 10, UNCONFIGURED),
    (12, "transition_error", 10, 15),
    (2, "cleanup", INACTIVE, 11),
    (20, "transition_success", 11, UNCONFIGURED),
    (21, "transition_failure", 11, INACTIVE),
    (22, "transition_error", 11, 15),
    (3, "activate", INACTIVE, 13),
    (30, "transition_success", 13, ACTIVE),
    (31, "transition_failure", 13, INACTIVE),
    (32, "transition_error", 13, 15),
    (DEACTIVATE, "deactivate", ACTIVE, 14),
    (40, "transition_success", 14, INACTIVE),
    (41, "transition_failure", 14, ACTIVE),
    (42, "transition_error", 14, 15),
    (5, "shutdown", UNCONFIGURED, 12),
    (6, "shutdown", INACTIVE, 12),
    (7, "shutdown", ACTIVE, 12),
    (50, "transition_success", 12, FINALIZED),
    (51, "transition_failure", 12, FINALIZED),
    (52, "transition_error", 12, 15),
    (60, "transition_success", 15, UNCONFIGURED),
    (61, "transition_failure", 15, FINALIZED),
    (62, "transition_error", 15, FINALIZED),
];

fn state(id: u8) -> State {
    let label = STATES.iter().find(|(known, _)| *known == id).map_or("unknown", |(_, label)| label);
    State { id, label: label.to_owned() }
}

/// The life of one node.
#[derive(Clone)]
pub struct Lifecycle(Arc<Mutex<Life>>);

struct Life {
    state: u8,
    /// Looks in a row that found it at ERROR.
    errors: u32,
    control: UnboundedSender<Control>,
    events: Outlet<TransitionEvent>,
}

impl Lifecycle {
    /// An unconfigured node, which exerts no force.
    fn new(control: UnboundedSender<Control>, events: Outlet<TransitionEvent>) -> Lifecycle {
        let life = Life { state: UNCONFIGURED, errors: 0, control, events };
        life.tell(Control::Enable(false));
        Lifecycle(Arc::new(Mutex::new(life)))
    }

    /// The node is at ERROR, or not: whoever looks says so at each look.
    pub fn looked(&self, error: Option<&str>) {
        let mut life = lock(&self.0);
        life.errors = if error.is_some() && life.state == ACTIVE { life.errors + 1 } else { 0 };
        if let (Some(error), true) = (error, life.errors >= PATIENCE) {
            tracing::error!("deactivated: {error}");
            life.change(&Transition { id: DEACTIVATE, label: String::new() });
        }
    }
}

impl Life {
    fn tell(&self, control: Control) {
        // Where the loop has ended the node is shutting down.
        let _ = self.control.unbounded_send(control);
    }

    /// Goes through a transition that begins in this state; by its label where it has one. False
    /// where there is none.
    fn change(&mut self, wanted: &Transition) -> bool {
        let found = TRANSITIONS_OF_ALL.into_iter().find(|(id, label, from, _)| {
            let named =
                if wanted.label.is_empty() { *id == wanted.id } else { *label == wanted.label };
            named && *from == self.state
        });
        let Some((id, label, from, through)) = found else {
            let here = state(self.state).label;
            match wanted.label.as_str() {
                "" => tracing::warn!("no transition {} from the state {here}", wanted.id),
                label => tracing::warn!(
                    "no transition `{}` from the state {here}",
                    super::words::quoted(label)
                ),
            }
            return false;
        };
        let success = TRANSITIONS_OF_ALL
            .into_iter()
            .find(|(_, label, from, _)| *label == "transition_success" && *from == through);
        let Some((success, success_label, _, to)) = success else { return false };
        self.publish(id, label, from, through);
        match label {
            "configure" | "cleanup" => self.tell(Control::Reset(oneshot::channel().0)),
            "activate" => self.tell(Control::Enable(true)),
            _ => self.tell(Control::Enable(false)),
        }
        (self.state, self.errors) = (to, 0);
        self.publish(success, success_label, through, to);
        tracing::info!("{label}: {}", state(to).label);
        true
    }

    fn publish(&mut self, id: u8, label: &str, from: u8, to: u8) {
        let event = TransitionEvent {
            timestamp: clock::system().unsigned_abs(),
            transition: Transition { id, label: label.to_owned() },
            start_state: state(from),
            goal_state: state(to),
        };
        let _ = self.events.publish(event);
    }
}

/// A transition with its ends.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct TransitionDescription {
    transition: Transition,
    start_state: State,
    goal_state: State,
}

fn describe(found: impl Fn(u8) -> bool) -> Vec<TransitionDescription> {
    let all = TRANSITIONS_OF_ALL.into_iter().filter(|(_, _, from, _)| found(*from));
    all.map(|(id, label, from, to)| TransitionDescription {
        transition: Transition { id, label: label.to_owned() },
        start_state: state(from),
        goal_state: state(to),
    })
    .collect()
}

/// A request without fields, which travels as one byte.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
struct Empty {
    structure_needs_at_least_one_member: u8,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct ChangeStateRequest {
    transition: Transition,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct ChangeStateResponse {
    success: bool,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct GetStateResponse {
    current_state: State,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct StatesResponse {
    available_states: Vec<State>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct TransitionsResponse {
    available_transitions: Vec<TransitionDescription>,
}

impl Message for Empty {}
impl Message for ChangeStateRequest {}
impl Message for ChangeStateResponse {}
impl Message for GetStateResponse {}
impl Message for StatesResponse {}
impl Message for TransitionsResponse {}

services! { "lifecycle_msgs":
    ChangeState(ChangeStateRequest) -> ChangeStateResponse,
    GetState(Empty) -> GetStateResponse,
    GetAvailableStates(Empty) -> StatesResponse,
    GetAvailableTransitions(Empty) -> TransitionsResponse,
}

/// Opens the services and the event topic, whose names `resolve` makes absolute; what there is to
/// poll, and the life to report errors to.
pub fn serve(
    participant: &Participant,
    resolve: impl Fn(&str) -> String,
    event_topic: &str,
    control: UnboundedSender<Control>,
) -> anyhow::Result<(Lifecycle, Vec<BoxFuture<'static, ()>>)> {
    let lifecycle = Lifecycle::new(control, Outlet::new(participant, event_topic, &TRANSITIONS)?);
    let life = || lifecycle.0.clone();
    let (changed, current, available) = (life(), life(), life());
    let change = service::serve::<ChangeState, _, _>(
        participant,
        &resolve("~/change_state"),
        move |request: ChangeStateRequest| {
            ready(ChangeStateResponse { success: lock(&changed).change(&request.transition) })
        },
    )?;
    let get =
        service::serve::<GetState, _, _>(participant, &resolve("~/get_state"), move |_: Empty| {
            ready(GetStateResponse { current_state: state(lock(&current).state) })
        })?;
    let states = service::serve::<GetAvailableStates, _, _>(
        participant,
        &resolve("~/get_available_states"),
        |_: Empty| {
            ready(StatesResponse {
                available_states: STATES.iter().map(|(id, _)| state(*id)).collect(),
            })
        },
    )?;
    let transitions = service::serve::<GetAvailableTransitions, _, _>(
        participant,
        &resolve("~/get_available_transitions"),
        move |_: Empty| {
            let here = lock(&available).state;
            ready(TransitionsResponse { available_transitions: describe(|from| from == here) })
        },
    )?;
    let graph = service::serve::<GetAvailableTransitions, _, _>(
        participant,
        &resolve("~/get_transition_graph"),
        |_: Empty| ready(TransitionsResponse { available_transitions: describe(|_| true) }),
    )?;
    Ok((
        lifecycle,
        vec![
            Box::pin(change),
            Box::pin(get),
            Box::pin(states),
            Box::pin(transitions),
            Box::pin(graph),
        ],
    ))
}
