//! The live page of a stage that runs in real time, in a real browser; and who is refused there.
//!
//! Needs Debian's `chromium`, or the browser that `CHROMIUM` names, for all but the refusals.

mod browser;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, SocketAddrV4, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use browser::{Browser, Look, chromium};
use friction_stage::node::domain::OwnDomain;

/// A stage with its live page.
struct Stage {
    process: Child,
    port: u16,
    _domain: OwnDomain,
}

fn free_port() -> u16 {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    listener.local_addr().expect("its number").port()
}

fn node(domain: u16, parameters: &[String]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stage_node"));
    command
        .arg("--ros-args")
        .args(parameters.iter().flat_map(|parameter| ["-p", parameter]))
        .env("ROS_DOMAIN_ID", domain.to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    command
}

impl Stage {
    fn start(directory: &Path, drive: &str) -> Stage {
        let (domain, port) = (OwnDomain::take().expect("a free domain"), free_port());
        let parameters = [
            format!("drive:={drive}"),
            format!("live_port:={port}"),
            "control_rate:=1000.0".to_owned(),
            format!("record_into:={}", directory.display()),
        ];
        let mut process = node(domain.number(), &parameters).spawn().expect("the node starts");
        let mut lines = BufReader::new(process.stderr.take().expect("a log")).lines();
        let listens = lines.any(|line| line.expect("text").contains("live page on"));
        assert!(listens, "the node ended without a live page");
        // The node may log on, and blocks if it is not read.
        std::thread::spawn(move || lines.for_each(drop));
        Stage { process, port, _domain: domain }
    }

    fn open(&self) -> Option<Browser> {
        let look = Look { width: 1280, dark: false };
        Some(Browser::open(&chromium()?, &format!("http://127.0.0.1:{}/", self.port), look))
    }

    /// First line of the answer to a request with these headers.
    fn ask(&self, path: &str, headers: &[(&str, &str)]) -> String {
        let mut stream =
            TcpStream::connect((Ipv4Addr::LOCALHOST, self.port)).expect("the page listens");
        let mut request = format!("GET {path} HTTP/1.1\r\nConnection: close\r\n");
        for (name, value) in headers {
            request += &format!("{name}: {value}\r\n");
        }
        stream.write_all((request + "\r\n").as_bytes()).expect("it reads");
        let mut answer = String::new();
        BufReader::new(stream).read_line(&mut answer).expect("it answers");
        answer.trim().to_owned()
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn text(id: &str) -> String {
    format!("document.getElementById('{id}').textContent")
}

#[test]
fn a_running_stage_is_watched_moved_and_recorded_from_the_page() {
    let directory = tempfile::tempdir().expect("a directory");
    let stage = Stage::start(directory.path(), "servo");
    let Some(mut browser) = stage.open() else { return };
    for shown in ["position", "error"] {
        let text = text(shown);
        browser.wait_until(&format!("{text} !== '' && Number.isFinite(Number({text}))"));
    }
    assert_eq!(browser.text(&text("state")), "running");

    // Nothing moves from under the pointer when a button changes its words.
    let places = "JSON.stringify(['record', 'forth', 'plots'].map((id) => { \
                  const {left, top, width} = document.getElementById(id).getBoundingClientRect(); \
                  return [left, top, width]; }))";
    let before_recording = browser.text(places);
    browser.click("document.getElementById('record')");
    browser.wait_until("document.getElementById('record').getAttribute('aria-pressed') === 'true'");
    browser.wait_until(&format!("{} !== ''", text("said")));
    assert_eq!(browser.text(places), before_recording);

    // 10 µm, and back by as much.
    // mm, whatever the unit in which it is shown.
    let position = "(1e3 * Number(document.getElementById('position').dataset.value))".to_owned();
    assert!(browser.text("document.getElementById('plots').textContent").contains("setpoint"));
    let before = browser.number(&position);
    browser.click("document.getElementById('forth')");
    browser.wait_until(&format!("{}.startsWith('step of 10.0 µm in 3.00 ms')", text("said")));
    browser.wait_until(&format!("Math.abs({position} - {before} - 0.01) < 0.0015"));
    browser.click("document.getElementById('back')");
    browser.wait_until(&format!("Math.abs({position} - {before}) < 0.0015"));

    browser.evaluate("document.getElementById('bandwidth').focus()");
    for _ in 0..3 {
        let key = |kind| {
            serde_json::json!({"type": kind, "key": "ArrowLeft", "code": "ArrowLeft",
                "windowsVirtualKeyCode": 37})
        };
        browser.call("Input.dispatchKeyEvent", key("keyDown"));
        browser.call("Input.dispatchKeyEvent", key("keyUp"));
    }
    browser.wait_until(&format!("{} === 'bandwidth 57 Hz'", text("said")));
    assert_eq!(browser.text(&text("bandwidth-value")), "57 Hz");
    // What is refused does not stay on the slider: 60 samples per second would not do for it.
    browser.evaluate(
        "const slider = document.getElementById('bandwidth'); slider.max = 900; slider.value = \
         900; slider.dispatchEvent(new Event('change'))",
    );
    browser.wait_until(&format!("{}.includes('must be')", text("said")));
    assert_eq!(browser.text(&text("bandwidth-value")), "57 Hz");
    // Another page has it, too.
    let mut another = stage.open().expect("a browser");
    another.wait_until(&format!("{} === '57 Hz'", text("bandwidth-value")));
    // It holds its position with the new gains.
    browser.click("document.getElementById('forth')");
    browser.wait_until(&format!("Math.abs({position} - {before} - 0.01) < 0.0015"));

    browser.click("document.getElementById('record')");
    browser
        .wait_until("document.getElementById('record').getAttribute('aria-pressed') === 'false'");
    let bags: Vec<_> = std::fs::read_dir(directory.path()).expect("a directory").collect();
    assert_eq!(bags.len(), 1, "{bags:?}");
    let bag = bags[0].as_ref().expect("a bag").path();
    let recorded = friction_stage_data::signals::load(&bag, None).expect("a recording");
    let highest = recorded.trace.position.iter().copied().fold(f64::MIN, f64::max);
    assert!((highest - 1e-3 * before - 10e-6).abs() < 3e-6, "{highest}");

    // What the page may not ask for is answered and does nothing.
    browser.evaluate(
        "window.reported = []; window.other = new WebSocket(`ws://${location.host}/data`); \
         other.onmessage = (m) => { const said = JSON.parse(m.data).said; if (said) \
         reported.push(said); }; new Promise((done) => { other.onopen = done; })",
    );
    for (wish, words) in [
        ("{\"step\": 1e9}", "must be at most"),
        ("{\"bandwidth\": -3}", "must be"),
        ("{\"bandwidth\": null}", "not understood"),
        ("{\"reboot\": 1}", "not understood"),
        ("nonsense", "not understood"),
    ] {
        browser.evaluate(&format!("reported.length = 0; other.send('{wish}')"));
        browser.wait_until("reported.length === 1");
        let reported = browser.text("reported[0]");
        assert!(reported.contains(words), "{wish}: {reported}");
    }
    assert!(browser.console.is_empty(), "{:#?}", browser.console);

    // A page that is open does not keep the stage from its end.
    let mut stage = stage;
    // SAFETY: the process is a child of ours that has not been waited for.
    assert_eq!(unsafe { libc::kill(stage.process.id() as i32, libc::SIGINT) }, 0);
    assert!(stage.process.wait().expect("it ends").success());
    browser.wait_until(&format!("{} === 'the stage has ended'", text("state")));
    assert_eq!(browser.evaluate("document.getElementById('forth').disabled"), true);
    let own = |url: &String| url.contains(&format!("127.0.0.1:{}/", stage.port));
    assert!(
        browser.requests.iter().all(|url| own(url) || url.starts_with("\"data:")),
        "{:?}",
        browser.requests
    );
}

#[test]
fn a_stage_that_another_node_controls_is_watched_only() {
    let directory = tempfile::tempdir().expect("a directory");
    let stage = Stage::start(directory.path(), "force");
    let Some(mut browser) = stage.open() else { return };
    browser.wait_until(&format!("Number.isFinite(Number({}))", text("position")));
    for id in ["bandwidth", "size", "back", "forth"] {
        let disabled = browser.evaluate(&format!("document.getElementById('{id}').disabled"));
        assert_eq!(disabled, true, "{id}");
    }
    assert!(browser.text("document.querySelector('.note').textContent").contains("drive:=servo"));
    // It has no error of its own to show.
    assert_eq!(browser.evaluate("document.getElementById('error') === null"), true);
    assert_eq!(browser.evaluate("document.querySelectorAll('.uplot').length"), 2);
}

#[test]
fn other_origins_other_names_and_other_interfaces_are_refused() {
    let directory = tempfile::tempdir().expect("a directory");
    let stage = Stage::start(directory.path(), "servo");
    let own = format!("127.0.0.1:{}", stage.port);
    let named = format!("localhost:{}", stage.port);
    let (good, evil) = (format!("http://{own}"), "http://example.com");
    let upgrade = |host, origin| {
        let mut headers = vec![
            ("Host", host),
            ("Upgrade", "websocket"),
            ("Sec-WebSocket-Version", "13"),
            ("Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ=="),
        ];
        headers.extend(origin);
        headers
    };
    let forbidden = "HTTP/1.1 403 Forbidden";
    assert_eq!(stage.ask("/", &[("Host", &own)]), "HTTP/1.1 200 OK");
    assert_eq!(stage.ask("/", &[("Host", &named)]), "HTTP/1.1 200 OK");
    assert_eq!(stage.ask("/", &[("Host", "example.com")]), forbidden);
    assert_eq!(stage.ask("/", &[("Host", &own), ("Origin", evil)]), forbidden);
    // A connection that is to become a socket is not to be closed.
    for (host, origin, welcome) in [
        (own.as_str(), Some(("Origin", good.as_str())), true),
        (own.as_str(), Some(("Origin", evil)), false),
        (own.as_str(), Some(("Origin", "null")), false),
        (own.as_str(), None, false),
        ("example.com", Some(("Origin", "http://example.com")), false),
    ] {
        let mut stream =
            TcpStream::connect((Ipv4Addr::LOCALHOST, stage.port)).expect("the page listens");
        let mut request = "GET /data HTTP/1.1\r\nConnection: Upgrade\r\n".to_owned();
        for (name, value) in upgrade(host, origin) {
            request += &format!("{name}: {value}\r\n");
        }
        stream.write_all((request + "\r\n").as_bytes()).expect("it reads");
        let mut first = [0; 12];
        stream.read_exact(&mut first).expect("it answers");
        let status = if welcome { b"HTTP/1.1 101" } else { b"HTTP/1.1 403" };
        assert_eq!(&first, status, "{host} {origin:?}");
    }
    let another = SocketAddrV4::new(Ipv4Addr::new(127, 0, 0, 2), stage.port);
    assert!(TcpStream::connect(another).is_err());
}

#[test]
fn a_stage_without_a_page_ends_when_it_is_asked_to() {
    let domain = OwnDomain::take().expect("a free domain");
    let mut process = node(domain.number(), &[]).spawn().expect("the node starts");
    let mut lines = BufReader::new(process.stderr.take().expect("a log")).lines();
    assert!(lines.any(|line| line.expect("text").contains("Hz control")));
    std::thread::spawn(move || lines.for_each(drop));
    // SAFETY: the process is a child of ours that has not been waited for.
    assert_eq!(unsafe { libc::kill(process.id() as i32, libc::SIGINT) }, 0);
    assert!(process.wait().expect("it ends").success());
}

#[test]
fn a_port_that_is_taken_and_a_stage_in_lockstep_are_told_at_the_start() {
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let port = taken.local_addr().expect("its number").port();
    let domain = OwnDomain::take().expect("a free domain");
    for (mode, words) in
        [("realtime", "choose a port that is free"), ("lockstep", "mode: realtime")]
    {
        let parameters = [format!("live_port:={port}"), format!("mode:={mode}")];
        let output = node(domain.number(), &parameters).output().expect("the node starts");
        assert!(!output.status.success());
        let reported = String::from_utf8_lossy(&output.stderr);
        assert!(reported.contains(words) && reported.contains("live_port"), "{reported}");
    }
}
