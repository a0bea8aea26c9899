//! The live page: a running stage in the browser, on loopback only.
//!
//! The publishing thread puts samples into a ring and never waits: what does not fit is dropped for
//! the page alone. A thread of its own, which has no real-time priority, takes them out, serves the
//! page and passes on what is set there; it ends with the publishing thread. The tick thread knows
//! nothing of it.

use std::future::IntoFuture as _;
use std::net::{Ipv4Addr, TcpListener};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::Router;
use axum::extract::State;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::get;
use futures::channel::mpsc::UnboundedSender;
use serde::{Deserialize, Serialize};
use tokio::sync::{broadcast, oneshot};

use super::control::Control;
use super::lock::lock;
use super::recorder::RecorderHandle;
use super::wire::Tick;
use crate::cpu;
use friction_stage_core::control::Follower;
use friction_stage_core::model::StageModel;
use friction_stage_report::live::{LiveStage, live_page};

/// Samples that may wait for the page: 4 s at the rate at which they are passed on.
const WAITING: usize = 2048;
/// Samples per second of the page: more than a screen shows.
const SHOWN: f64 = 500.0;
/// Interval of the messages to the page.
const INTERVAL: Duration = Duration::from_millis(50);
/// Messages that may wait for a slow page before it misses some.
const BEHIND: usize = 32;
/// Pages at a time.
const PAGES: usize = 8;
/// Longest message of a page, bytes.
const LONGEST: usize = 1024;

/// A page that cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    #[error(
        "parameter live_port is {port}: cannot listen on 127.0.0.1:{port}: {source}; choose a port \
         that is free"
    )]
    Listen { port: u16, source: std::io::Error },
    #[error("cannot start the thread of the live page: {0}")]
    Thread(std::io::Error),
}

#[derive(Clone, Copy)]
struct Seen {
    /// ns
    time: i64,
    position: f64,
    force: f64,
}

/// The end of the publishing thread.
pub struct LiveFeed {
    ring: rtrb::Producer<Seen>,
    every: u64,
}

impl LiveFeed {
    /// Passes a sample on, if it is due and there is room.
    pub fn offer(&mut self, tick: &Tick) {
        let sample = &tick.sample;
        if sample.index.is_multiple_of(self.every) {
            let (time, position, force) = (sample.time, sample.position, sample.force_cell);
            let _ = self.ring.push(Seen { time, position, force });
        }
    }
}

/// What the stage follows, for the error that the page shows; none in `drive: force`.
pub type SharedFollower = Arc<Mutex<Option<Follower>>>;

/// What the page needs of its node.
pub struct LiveSetup {
    pub port: u16,
    pub model: StageModel,
    /// Hz, of a stage that drives itself.
    pub bandwidth: Option<f64>,
    /// Samples per second of the stage.
    pub rate: f64,
    pub follower: SharedFollower,
    pub control: UnboundedSender<Control>,
    /// Starts and ends a recording, and says what it did.
    pub record: Arc<dyn Fn(bool) -> Result<String, String> + Send + Sync>,
    pub recorder: RecorderHandle,
    /// Processor that the page keeps away from.
    pub busy_cpu: Option<usize>,
}

/// What a page may ask for.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
enum Wish {
    /// Hz
    Bandwidth(f64),
    /// m
    Step(f64),
    Record(bool),
}

/// What is sent to a page.
#[derive(Serialize)]
#[serde(untagged)]
enum Reply {
    Samples {
        t: Vec<f64>,
        position: Vec<f64>,
        error: Vec<Option<f64>>,
        force: Vec<f64>,
        recording: bool,
    },
    Done {
        said: String,
        /// After a wish for another one, which may be refused: the one in use, Hz.
        #[serde(skip_serializing_if = "Option::is_none")]
        bandwidth: Option<f64>,
    },
}

struct Served {
    /// Of the stage's own loop, Hz.
    bandwidth: Mutex<Option<f64>>,
    model: StageModel,
    /// Names under which a browser on this machine knows the server.
    hosts: [String; 2],
    frames: broadcast::Sender<Arc<str>>,
    pages: AtomicUsize,
    control: UnboundedSender<Control>,
    record: Arc<dyn Fn(bool) -> Result<String, String> + Send + Sync>,
}

/// Listens, and serves until the end of the feed.
pub fn start(setup: LiveSetup) -> Result<LiveFeed, LiveError> {
    let port = setup.port;
    let listen = |source| LiveError::Listen { port, source };
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(listen)?;
    listener.set_nonblocking(true).map_err(listen)?;
    let (ring, samples) = rtrb::RingBuffer::new(WAITING);
    let every = ((setup.rate / SHOWN) as u64).max(1);
    let work = move || {
        // The page may be late, the stage may not.
        let apart = setup.busy_cpu.map_or(Ok(()), cpu::avoid).and_then(|()| cpu::not_real_time());
        if let Err(error) = apart {
            tracing::warn!("the live page competes with the stage: {error}");
        }
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        if let Err(error) =
            runtime.and_then(|runtime| runtime.block_on(serve(setup, listener, samples)))
        {
            tracing::error!("the live page has ended: {error}");
        }
    };
    std::thread::Builder::new().name("live".to_owned()).spawn(work).map_err(LiveError::Thread)?;
    tracing::info!("live page on http://127.0.0.1:{port}/");
    Ok(LiveFeed { ring, every })
}

async fn serve(
    setup: LiveSetup,
    listener: TcpListener,
    samples: rtrb::Consumer<Seen>,
) -> std::io::Result<()> {
    let (frames, _) = broadcast::channel(BEHIND);
    let port = setup.port;
    let served = Arc::new(Served {
        bandwidth: Mutex::new(setup.bandwidth),
        model: setup.model,
        hosts: [format!("127.0.0.1:{port}"), format!("localhost:{port}")],
        frames: frames.clone(),
        pages: AtomicUsize::new(0),
        control: setup.control,
        record: setup.record,
    });
    let router = Router::new().route("/", get(page)).route("/data", get(data)).with_state(served);
    // Pages that are open end with the runtime.
    let server = axum::serve(tokio::net::TcpListener::from_std(listener)?, router);
    tokio::select! {
        ended = server.into_future() => ended,
        () = pump(samples, setup.follower, setup.recorder, frames) => Ok(()),
    }
}

/// Makes messages of the samples for all pages, until the publishing thread has ended.
async fn pump(
    mut samples: rtrb::Consumer<Seen>,
    follower: SharedFollower,
    recorder: RecorderHandle,
    frames: broadcast::Sender<Arc<str>>,
) {
    let mut interval = tokio::time::interval(INTERVAL);
    while !samples.is_abandoned() {
        interval.tick().await;
        let (mut t, mut position, mut error, mut force) = (vec![], vec![], vec![], vec![]);
        {
            let follower = lock(&follower);
            while let Ok(seen) = samples.pop() {
                t.push(seen.time as f64 * 1e-9);
                position.push(seen.position * 1e3);
                error.push(
                    follower
                        .as_ref()
                        .map(|follower| (follower.at(seen.time).position - seen.position) * 1e6),
                );
                force.push(seen.force);
            }
        }
        if t.is_empty() || frames.receiver_count() == 0 {
            continue;
        }
        let recording = recorder.is_recording();
        let reported = Reply::Samples { t, position, error, force, recording };
        if let Ok(text) = serde_json::to_string(&reported) {
            let _ = frames.send(text.into());
        }
    }
}

impl Served {
    /// A browser tells under which name it reached the server, and whose page asks. A page of
    /// another origin, and a foreign name that resolves to this machine, are refused.
    fn refusal(&self, headers: &HeaderMap) -> Option<Response> {
        let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
        let own = |host: &str| self.hosts.iter().any(|known| known == host);
        let host = text(header::HOST).is_some_and(own);
        let origin = match headers.get(header::ORIGIN) {
            None => true,
            Some(_) => text(header::ORIGIN)
                .and_then(|origin| origin.strip_prefix("http://"))
                .is_some_and(own),
        };
        (!host || !origin).then(|| {
            (StatusCode::FORBIDDEN, "this page is for browsers on this machine, under its own name")
                .into_response()
        })
    }

    /// What to tell a page about its wish.
    async fn answer(&self, text: &str) -> Reply {
        let wish = match serde_json::from_str(text) {
            Ok(wish) => wish,
            Err(error) => {
                return Reply::Done { said: format!("not understood: {error}"), bandwidth: None };
            }
        };
        let (reply, answer) = oneshot::channel();
        let wanted = match wish {
            Wish::Bandwidth(bandwidth) => Some(bandwidth),
            _ => None,
        };
        let control = match wish {
            Wish::Bandwidth(bandwidth) => Control::Bandwidth(bandwidth, reply),
            Wish::Step(distance) => Control::Move(distance, reply),
            Wish::Record(on) => {
                let record = self.record.clone();
                let done = tokio::task::spawn_blocking(move || record(on)).await;
                let said = match done {
                    Ok(Ok(said) | Err(said)) => said,
                    Err(error) => error.to_string(),
                };
                return Reply::Done { said, bandwidth: None };
            }
        };
        let gone = || Err("the stage is shutting down".to_owned());
        let done = match self.control.unbounded_send(control) {
            Ok(()) => answer.await.unwrap_or_else(|_| gone()),
            Err(_) => gone(),
        };
        let bandwidth = wanted.and_then(|wanted| {
            let mut in_use = lock(&self.bandwidth);
            if done.is_ok() {
                *in_use = Some(wanted);
            }
            *in_use
        });
        Reply::Done { said: done.unwrap_or_else(|reason| reason), bandwidth }
    }
}

async fn page(State(served): State<Arc<Served>>, headers: HeaderMap) -> Response {
    served.refusal(&headers).unwrap_or_else(|| {
        let bandwidth = *lock(&served.bandwidth);
        Html(live_page(&LiveStage { model: &served.model, bandwidth })).into_response()
    })
}

async fn data(
    State(served): State<Arc<Served>>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    if let Some(refusal) = served.refusal(&headers) {
        return refusal;
    }
    // A client that is no browser has no origin: it has no business here.
    if !headers.contains_key(header::ORIGIN) {
        return (StatusCode::FORBIDDEN, "for the page of this server only").into_response();
    }
    upgrade.max_message_size(LONGEST).on_upgrade(move |socket| async move {
        if served.pages.fetch_add(1, Ordering::Relaxed) < PAGES {
            watch(&served, socket).await;
        }
        served.pages.fetch_sub(1, Ordering::Relaxed);
    })
}

/// One page, until it is closed.
async fn watch(served: &Served, mut socket: WebSocket) {
    let mut frames = served.frames.subscribe();
    loop {
        let text = tokio::select! {
            frame = frames.recv() => match frame {
                Ok(frame) => frame.to_string(),
                Err(broadcast::error::RecvError::Lagged(_)) => continue,
                Err(broadcast::error::RecvError::Closed) => return,
            },
            message = socket.recv() => match message {
                Some(Ok(Message::Text(text))) => {
                    serde_json::to_string(&served.answer(&text).await).unwrap_or_default()
                }
                Some(Ok(Message::Close(_)) | Err(_)) | None => return,
                Some(Ok(_)) => continue,
            },
        };
        if socket.send(Message::Text(text.into())).await.is_err() {
            return;
        }
    }
}
