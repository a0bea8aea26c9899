//! An action of a node: goals come in, feedback and one result per goal go out.
//!
//! [`serve`] opens the three services and the two topics of an action and gives back a future that
//! keeps its goals, as rcl_action does: their states, their results for who asks, and what is known
//! of goals that are over. What a goal means is decided elsewhere: each [`Wish`] of a client goes
//! to the node, and the node's [`News`] of its goals come back.

use std::collections::{BTreeMap, VecDeque};
use std::future::poll_fn;
use std::pin::pin;
use std::task::{Context, Poll};

use futures::StreamExt;
use futures::channel::mpsc::UnboundedReceiver;
use futures::stream::FuturesUnordered;
use ros2_client::action::{
    ActionServer, ActionServerQosPolicies, CancelGoalRequest, CancelGoalResponse, GetResultRequest,
    GetResultResponse, GoalInfo, GoalStatusEnum, SendGoalRequest, SendGoalResponse,
};
use ros2_client::action_msgs::{CancelGoalResponseEnum, GoalStatus, GoalStatusArray};
use ros2_client::builtin_interfaces::Time;
use ros2_client::{ActionTypeName, Message, QosProfile, ReadError, RmwRequestId, ServiceMapping};
use serde::Deserialize;
use tokio::sync::oneshot;

use super::participant::Participant;
use super::qos::{ACTION_STATUS, FEEDBACK, SERVICES};
use super::reopened::{Reopened, Shared, Taken};
use super::service::{ServiceError, WAITING_ANSWERS, absolute, reader_is_there};

pub use ros2_client::action::GoalId;

/// Goals that are over and whose results can still be asked for.
const REMEMBERED: usize = 100;
/// Clients that may wait for the result of one goal.
const ASKING: usize = 1000;

/// An action type, as in `control_msgs/action/FollowJointTrajectory`.
pub trait Action: 'static {
    type Goal: Message + Clone + Send + Sync + 'static;
    type Result: Message + Clone + Default + Send + Sync + 'static;
    type Feedback: Message + Send + Sync + 'static;
    /// Package that defines the type.
    const PACKAGE: &'static str;
    /// Name of the type without package.
    const NAME: &'static str;
}

/// What a client wants. Who drops `reply` says no.
#[derive(Debug)]
pub enum Wish<A: Action> {
    /// To be followed from the answer on, or refused with a result that says why.
    Goal { id: GoalId, goal: A::Goal, reply: oneshot::Sender<Result<(), A::Result>> },
    /// Whether the goal ends now; its end comes as news.
    Cancel { id: GoalId, reply: oneshot::Sender<bool> },
}

/// How a goal ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GoalEnd {
    Succeeded,
    Canceled,
    Aborted,
}

/// What the node says of a goal that it accepted.
#[derive(Debug)]
pub enum News<A: Action> {
    Feedback(GoalId, A::Feedback),
    Ended(GoalId, GoalEnd, A::Result),
}

type Server<A> = ActionServer<<A as Action>::Goal, <A as Action>::Result, <A as Action>::Feedback>;

enum Request<A: Action> {
    Goal(SendGoalRequest<A::Goal>),
    Cancel(CancelGoalRequest),
    Result(GetResultRequest),
}

type Asked<A> = Taken<Server<A>, Request<A>>;

/// Who asked, and the server that is to answer.
struct Asking<A: Action> {
    server: Shared<Server<A>>,
    id: RmwRequestId,
}

enum Answer<A: Action> {
    Goal(SendGoalResponse),
    Cancel(CancelGoalResponse),
    Result(GetResultResponse<A::Result>),
}

/// The only field of [`CancelGoalRequest`], which ros2-client 0.12 keeps to itself.
#[derive(Deserialize)]
struct CancelFields {
    goal_info: GoalInfo,
}

/// Opens the action `name` (absolute) and gives back the future that serves it. `wish` takes what
/// clients want to the node; `news` come from there.
///
/// The future ends only when it is dropped; it is polled on a tokio runtime with time.
pub fn serve<A: Action, W: FnMut(Wish<A>) + Send>(
    participant: &Participant,
    name: &str,
    wish: W,
    mut news: UnboundedReceiver<News<A>>,
) -> Result<impl Future<Output = ()> + Send + use<A, W>, ServiceError> {
    let parsed = absolute(name)?;
    let qos = || ActionServerQosPolicies {
        goal_service: QosProfile::from(&SERVICES),
        result_service: QosProfile::from(&SERVICES),
        cancel_service: QosProfile::from(&SERVICES),
        feedback_publisher: QosProfile::from(&FEEDBACK),
        status_publisher: QosProfile::from(&ACTION_STATUS),
    };
    let action_type = ActionTypeName::new(A::PACKAGE, A::NAME);
    let (name, participant) = (name.to_owned(), participant.clone());
    let servers = Reopened::new(&participant, &name, {
        let (name, participant) = (name.clone(), participant.clone());
        move || {
            participant
                .node()
                .create_action_server::<A::Goal, A::Result, A::Feedback>(
                    ServiceMapping::Enhanced,
                    &parsed,
                    &action_type,
                    qos(),
                )
                .map_err(ServiceError::creating(&name))
        }
    })?;
    let mut goals = Goals::<A, _> {
        name: name.clone(),
        servers,
        wish,
        known: BTreeMap::new(),
        over: VecDeque::new(),
    };
    Ok(async move {
        let mut waiting = FuturesUnordered::new();
        loop {
            let answers: Vec<(Asking<A>, Answer<A>)> = tokio::select! {
                biased;
                Some(news) = news.next() => goals.note(news),
                Some((asking, answer)) = waiting.next() => {
                    if let Some(answer) = answer {
                        goals.send(&asking, answer);
                    }
                    Vec::new()
                }
                request = poll_fn(|context| goals.poll(context)),
                    if waiting.len() < WAITING_ANSWERS =>
                {
                    match request {
                        Ok(request) => goals.handle(request).await,
                        Err(error) => {
                            tracing::warn!("action {name}: a request could not be read: {error}");
                            Vec::new()
                        }
                    }
                }
            };
            for (asking, answer) in answers {
                let (participant, name) = (&participant, &name);
                waiting.push(async move {
                    let there = reader_is_there(participant, name, &asking.id).await;
                    (asking, there.then_some(answer))
                });
            }
        }
    })
}

struct Known<A: Action> {
    accepted: Time,
    status: GoalStatusEnum,
    /// Once it is over, or was refused.
    result: Option<A::Result>,
    /// Who waits for the result.
    asking: Vec<Asking<A>>,
}

struct Goals<A: Action, W> {
    name: String,
    servers: Reopened<Server<A>>,
    wish: W,
    known: BTreeMap<GoalId, Known<A>>,
    /// Goals that are over or were refused, the oldest first.
    over: VecDeque<GoalId>,
}

impl<A: Action, W: FnMut(Wish<A>) + Send> Goals<A, W> {
    /// The next request of a client; a cancel goes before what it may cancel.
    fn poll(&mut self, context: &mut Context<'_>) -> Poll<Result<Asked<A>, ReadError>> {
        if self.servers.meet_returned(context) {
            // The new publisher of the states has none for who comes late.
            self.publish_status();
        }
        self.servers.poll(context, |server, context| {
            // A new future each time is sound here: rustdds' stream keeps no state between polls.
            let cancel = pin!(server.cancel_server().async_receive_request()).poll(context);
            if let Poll::Ready(request) = cancel {
                return Poll::Ready(request.map(|(id, request)| (id, Request::Cancel(request))));
            }
            let goal = pin!(server.goal_server().async_receive_request()).poll(context);
            if let Poll::Ready(request) = goal {
                return Poll::Ready(request.map(|(id, request)| (id, Request::Goal(request))));
            }
            let result = pin!(server.result_server().async_receive_request()).poll(context);
            result.map(|request| request.map(|(id, request)| (id, Request::Result(request))))
        })
    }

    async fn handle(
        &mut self,
        Taken { server, id, request }: Asked<A>,
    ) -> Vec<(Asking<A>, Answer<A>)> {
        let asking = Asking { server, id };
        let answer = match request {
            Request::Goal(request) => {
                Answer::Goal(self.accept(request.goal_id, request.goal).await)
            }
            Request::Cancel(request) => Answer::Cancel(self.cancel(&request).await),
            Request::Result(GetResultRequest { goal_id }) => match self.known.get_mut(&goal_id) {
                None => result(GoalStatusEnum::Unknown, A::Result::default()),
                Some(known) => match &known.result {
                    Some(known_result) => result(known.status, known_result.clone()),
                    None if known.asking.len() < ASKING => {
                        known.asking.push(asking);
                        return Vec::new();
                    }
                    None => result(known.status, A::Result::default()),
                },
            },
        };
        vec![(asking, answer)]
    }

    async fn accept(&mut self, id: GoalId, goal: A::Goal) -> SendGoalResponse {
        let accepted = Time::now();
        let refused = SendGoalResponse { accepted: false, stamp: accepted };
        if self.known.contains_key(&id) {
            tracing::warn!("action {}: a goal with the id {id:?} is known already", self.name);
            return refused;
        }
        let (reply, answer) = oneshot::channel();
        (self.wish)(Wish::Goal { id, goal, reply });
        let mut known =
            Known { accepted, status: GoalStatusEnum::Executing, result: None, asking: Vec::new() };
        match answer.await {
            Ok(Ok(())) => {
                self.known.insert(id, known);
                self.publish_status();
                SendGoalResponse { accepted: true, stamp: accepted }
            }
            Ok(Err(why)) => {
                // No state of a goal, but who asks for its result learns why.
                (known.status, known.result) = (GoalStatusEnum::Unknown, Some(why));
                self.known.insert(id, known);
                self.forget_after(id);
                refused
            }
            // The node is shutting down.
            Err(_) => refused,
        }
    }

    async fn cancel(&mut self, request: &CancelGoalRequest) -> CancelGoalResponse {
        use CancelGoalResponseEnum as Code;
        let answer =
            |return_code, goals_canceling| CancelGoalResponse { return_code, goals_canceling };
        let fields = serde_json::to_value(request).and_then(serde_json::from_value::<CancelFields>);
        let Ok(CancelFields { goal_info: GoalInfo { goal_id, stamp } }) = fields else {
            return answer(Code::Rejected, Vec::new());
        };
        let one = goal_id != GoalId::ZERO;
        if one
            && !self
                .known
                .get(&goal_id)
                .is_some_and(|known| known.status != GoalStatusEnum::Unknown)
        {
            return answer(Code::UnknownGoal, Vec::new());
        }
        // action_msgs/srv/CancelGoal: one goal, those accepted until then, both, or all.
        let asked = |id: &GoalId, known: &Known<A>| {
            let until = stamp != Time::ZERO && known.accepted <= stamp;
            (one && *id == goal_id) || until || (!one && stamp == Time::ZERO)
        };
        let candidates: Vec<GoalId> = self
            .known
            .iter()
            .filter(|(id, known)| known.result.is_none() && asked(id, known))
            .map(|(id, _)| *id)
            .collect();
        let mut canceling = Vec::new();
        for id in candidates {
            let (reply, cancelled) = oneshot::channel();
            (self.wish)(Wish::Cancel { id, reply });
            if let (Ok(true), Some(known)) = (cancelled.await, self.known.get_mut(&id)) {
                known.status = GoalStatusEnum::Canceling;
                canceling.push(GoalInfo { goal_id: id, stamp: known.accepted });
            }
        }
        match canceling.is_empty() {
            false => {
                self.publish_status();
                answer(Code::None, canceling)
            }
            true if one => answer(Code::GoalTerminated, canceling),
            true => answer(Code::Rejected, canceling),
        }
    }

    /// Takes in what the node says; the answers to who waited for it.
    fn note(&mut self, news: News<A>) -> Vec<(Asking<A>, Answer<A>)> {
        let (id, end, ended) = match news {
            News::Feedback(id, feedback) => {
                if self.servers.current().lock().send_feedback(id, feedback).is_err() {
                    tracing::debug!("action {}: no room for feedback of {id:?}", self.name);
                }
                return Vec::new();
            }
            News::Ended(id, end, ended) => (id, end, ended),
        };
        let Some(known) = self.known.get_mut(&id) else { return Vec::new() };
        known.status = match end {
            GoalEnd::Succeeded => GoalStatusEnum::Succeeded,
            GoalEnd::Canceled => GoalStatusEnum::Canceled,
            GoalEnd::Aborted => GoalStatusEnum::Aborted,
        };
        let answers = std::mem::take(&mut known.asking)
            .into_iter()
            .map(|asking| (asking, result(known.status, ended.clone())))
            .collect();
        known.result = Some(ended);
        self.forget_after(id);
        self.publish_status();
        answers
    }

    /// Remembers the goal until as many as [`REMEMBERED`] have followed it.
    fn forget_after(&mut self, id: GoalId) {
        self.over.push_back(id);
        while self.over.len() > REMEMBERED {
            if let Some(oldest) = self.over.pop_front() {
                self.known.remove(&oldest);
            }
        }
    }

    fn publish_status(&self) {
        let goals = self.known.iter().filter(|(_, known)| known.status != GoalStatusEnum::Unknown);
        let status_list = goals
            .map(|(id, known)| GoalStatus {
                goal_info: GoalInfo { goal_id: *id, stamp: known.accepted },
                status: known.status,
            })
            .collect();
        let server = self.servers.current().lock();
        if let Err(error) = server.send_goal_statuses(GoalStatusArray { status_list }) {
            tracing::warn!("action {}: the status was not sent: {error}", self.name);
        }
    }

    fn send(&self, Asking { server, id }: &Asking<A>, answer: Answer<A>) {
        let server = server.lock();
        let sent = match answer {
            Answer::Goal(answer) => server.send_goal_response(*id, answer),
            Answer::Cancel(answer) => server.send_cancel_response(*id, answer),
            Answer::Result(answer) => server.send_result(*id, answer),
        };
        if let Err(error) = sent {
            tracing::warn!("action {}: the answer was not sent: {error}", self.name);
        }
    }
}

fn result<A: Action>(status: GoalStatusEnum, result: A::Result) -> Answer<A> {
    Answer::Result(GetResultResponse { status, result })
}
