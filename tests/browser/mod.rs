//! A browser that is driven over the DevTools protocol, through a pipe: no port, no other program.

#![allow(dead_code, reason = "each test uses a part of it")]

use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::os::fd::{AsRawFd, FromRawFd, RawFd};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use serde_json::{Value, json};

/// Debian's chromium, or the browser that `CHROMIUM` names.
pub fn chromium() -> Option<PathBuf> {
    let named = std::env::var_os("CHROMIUM").map(PathBuf::from);
    let found = named.or_else(|| {
        let path = std::env::var_os("PATH")?;
        let names = ["chromium", "chromium-browser", "google-chrome"];
        std::env::split_paths(&path)
            .find_map(|place| names.iter().map(|name| place.join(name)).find(|file| file.is_file()))
    });
    if found.is_none() {
        println!(
            "SKIPPED: no chromium (Debian: apt install chromium), or name a browser in CHROMIUM"
        );
    }
    found
}

/// How the page is looked at.
#[derive(Clone, Copy)]
pub struct Look {
    pub width: u32,
    pub dark: bool,
}

/// A browser with one page.
pub struct Browser {
    process: Child,
    to: File,
    from: BufReader<File>,
    last: u64,
    session: Option<String>,
    /// Errors and whatever else the page wrote to the console.
    pub console: Vec<String>,
    /// What it asked for.
    pub requests: Vec<String>,
    _profile: tempfile::TempDir,
}

/// A pipe whose ends no child inherits.
fn pipe() -> (File, File) {
    let mut ends: [RawFd; 2] = [0; 2];
    // SAFETY: the array has room for two descriptors, which nothing else owns.
    unsafe {
        assert_eq!(libc::pipe2(ends.as_mut_ptr(), libc::O_CLOEXEC), 0);
        (File::from_raw_fd(ends[0]), File::from_raw_fd(ends[1]))
    }
}

impl Browser {
    pub fn open(program: &Path, url: &str, look: Look) -> Browser {
        let profile = tempfile::tempdir().expect("a directory for the profile");
        let ((its_in, to), (from, its_out)) = (pipe(), pipe());
        let mut command = Command::new(program);
        command
            .args(["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run"])
            .args(["--disable-background-networking", "--disable-component-update"])
            .args(["--disable-sync", "--disable-dev-shm-usage", "--remote-debugging-pipe"])
            .arg("--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1")
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        let ends = (its_in.as_raw_fd(), its_out.as_raw_fd());
        // SAFETY: only calls that may be made between fork and exec. The browser reads from 3 and
        // writes to 4; the copies are above them, so that neither covers the other.
        unsafe {
            command.pre_exec(move || {
                let high = |end| libc::fcntl(end, libc::F_DUPFD_CLOEXEC, 10);
                let (read, write) = (high(ends.0), high(ends.1));
                if read < 0 || write < 0 || libc::dup2(read, 3) < 0 || libc::dup2(write, 4) < 0 {
                    return Err(std::io::Error::last_os_error());
                }
                Ok(())
            });
        }
        let process = command.spawn().expect("the browser starts");
        drop((its_in, its_out));
        let mut browser = Browser {
            process,
            to,
            from: BufReader::new(from),
            last: 0,
            session: None,
            console: Vec::new(),
            requests: Vec::new(),
            _profile: profile,
        };
        let target = browser.call("Target.createTarget", json!({"url": "about:blank"}));
        let attach = json!({"targetId": target["targetId"], "flatten": true});
        let session = browser.call("Target.attachToTarget", attach);
        browser.session = session["sessionId"].as_str().map(str::to_owned);
        for domain in ["Runtime", "Log", "Network", "Page"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        browser.look(look);
        browser.call("Page.navigate", json!({"url": url}));
        while browser.event()["method"] != "Page.loadEventFired" {}
        browser
    }

    /// Sets width and colours.
    pub fn look(&mut self, look: Look) {
        let size =
            json!({"width": look.width, "height": 900, "deviceScaleFactor": 1, "mobile": false});
        self.call("Emulation.setDeviceMetricsOverride", size);
        let colours = if look.dark { "dark" } else { "light" };
        let features = json!([{"name": "prefers-color-scheme", "value": colours}]);
        self.call("Emulation.setEmulatedMedia", json!({"media": "", "features": features}));
    }

    /// The page as it would be printed.
    pub fn print(&mut self) {
        self.call("Emulation.setEmulatedMedia", json!({"media": "print"}));
    }

    /// The next message of the browser; what concerns the page is kept.
    fn event(&mut self) -> Value {
        let mut text = Vec::new();
        let read = self.from.read_until(0, &mut text).expect("the browser answers");
        assert!(read > 0, "the browser ended");
        text.pop();
        let message: Value = serde_json::from_slice(&text).expect("the protocol is JSON");
        let parameters = &message["params"];
        match message["method"].as_str() {
            Some("Runtime.consoleAPICalled" | "Runtime.exceptionThrown" | "Log.entryAdded") => {
                self.console.push(parameters.to_string());
            }
            Some("Network.requestWillBeSent") => {
                self.requests.push(parameters["request"]["url"].to_string());
            }
            _ => {}
        }
        message
    }

    pub fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.last += 1;
        let mut message = json!({"id": self.last, "method": method, "params": parameters});
        if let Some(session) = &self.session {
            message["sessionId"] = json!(session);
        }
        let mut text = message.to_string().into_bytes();
        text.push(0);
        self.to.write_all(&text).expect("the browser listens");
        loop {
            let answer = self.event();
            if answer["id"] == self.last {
                assert!(answer["error"].is_null(), "{method}: {answer}");
                return answer["result"].clone();
            }
        }
    }

    /// The value of an expression, awaited.
    pub fn evaluate(&mut self, expression: &str) -> Value {
        let parameters =
            json!({"expression": expression, "returnByValue": true, "awaitPromise": true});
        let answer = self.call("Runtime.evaluate", parameters);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    pub fn number(&mut self, expression: &str) -> f64 {
        // The protocol has no value of -0.
        let value = self.evaluate(&format!("({expression}) + 0"));
        value.as_f64().unwrap_or_else(|| panic!("{expression} is {value}"))
    }

    pub fn text(&mut self, expression: &str) -> String {
        let value = self.evaluate(expression);
        value.as_str().map(str::to_owned).unwrap_or_else(|| panic!("{expression} is {value}"))
    }

    /// Waits until an expression is true, frame by frame; one that never is fails.
    pub fn wait_until(&mut self, expression: &str) {
        let is_true = self.evaluate(&format!(
            "new Promise((done) => {{ const end = performance.now() + 120e3; const look = () => \
             ({expression}) ? done(true) : performance.now() > end ? done(false) : \
             requestAnimationFrame(look); look(); }})"
        ));
        assert_eq!(is_true, true, "after two minutes it is not true: {expression}");
    }

    /// A place within an element, as parts of its width and height, in the window.
    pub fn place(&mut self, element: &str, part: (f64, f64)) -> (f64, f64) {
        let box_ = self.evaluate(&format!(
            "(() => {{ const e = {element}; e.scrollIntoView({{block: 'center'}}); const b = \
             e.getBoundingClientRect(); return [b.left, b.top, b.width, b.height]; }})()"
        ));
        let at = |k: usize| box_[k].as_f64().expect("a box");
        (at(0) + part.0 * at(2), at(1) + part.1 * at(3))
    }

    pub fn mouse(&mut self, kind: &str, at: (f64, f64), clicks: u32) {
        let button = if kind == "mouseMoved" && clicks == 0 { "none" } else { "left" };
        let event = json!({"type": kind, "x": at.0, "y": at.1, "button": button,
            "clickCount": clicks, "buttons": u32::from(clicks > 0)});
        self.call("Input.dispatchMouseEvent", event);
    }

    pub fn click(&mut self, element: &str) {
        let at = self.place(element, (0.5, 0.5));
        self.mouse("mouseMoved", at, 0);
        self.mouse("mousePressed", at, 1);
        self.mouse("mouseReleased", at, 1);
    }

    /// Presses a key that types nothing or one character.
    pub fn key(&mut self, key: &str) {
        for kind in ["keyDown", "keyUp"] {
            self.call("Input.dispatchKeyEvent", json!({"type": kind, "key": key}));
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
