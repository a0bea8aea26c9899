//! Real time: how late the ticks of the stage are, beside a thread that only sleeps, and whether a
//! recording keeps up.
//!
//! `cargo bench --bench realtime -- [--seconds S]`
//!
//! The stage is the real node, publishing all its topics: alone, with its live page in a browser
//! (if there is a chromium), and with a recording. The sleeping thread has the same deadlines and
//! the same scheduling and does nothing. Lateness is what this machine's scheduler makes of it;
//! compare the rows, not the numbers of two machines.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use friction_stage::node::clock::{Ticks, monotonic, prepare_tick_thread};
use friction_stage::node::driver::Driver;
use friction_stage::node::lateness::LatenessHistogram;
use friction_stage::node::participant::{Network, Reach};
use friction_stage_data::bag::BagReader;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> =
        std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let seconds: f64 = match &arguments[..] {
        [] => 10.0,
        [flag, value] if flag == "--seconds" => value.parse()?,
        _ => anyhow::bail!("unknown arguments {arguments:?}: known is --seconds S"),
    };
    let duration = Duration::from_secs_f64(seconds);
    println!(
        "{:<34} {:>9} {:>9} {:>10} {:>9} {:>12}",
        "lateness, us", "p50", "p99", "max", "overruns", "unpublished"
    );
    for rate in [1000.0, 4000.0] {
        sleeping(rate, duration);
        stage(rate, duration, Beside::Nothing)?;
        stage(rate, duration, Beside::Page)?;
        stage(rate, duration, Beside::Recording)?;
    }
    stage(10_000.0, duration, Beside::Recording)
}

fn row(name: &str, [p50, p99, max, overruns]: [f64; 4], unpublished: &str) {
    println!("{name:<34} {p50:>9.1} {p99:>9.1} {max:>10.1} {overruns:>9} {unpublished:>12}");
}

fn sleeping(rate: f64, duration: Duration) {
    let histogram = LatenessHistogram::default();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            prepare_tick_thread(true);
            let mut ticks = Ticks::new(monotonic(), rate);
            for _ in 0..(rate * duration.as_secs_f64()) as u64 {
                histogram.record(ticks.wait(), (1e9 / rate) as i64);
            }
        });
    });
    if let Some(found) = histogram.lateness() {
        row(
            &format!("{rate} Hz, a thread that only sleeps"),
            [found.p50, found.p99, found.max, histogram.overruns() as f64],
            "",
        );
    }
}

/// What runs alongside the stage.
#[derive(Clone, Copy, PartialEq)]
enum Beside {
    Nothing,
    /// Its live page in a browser.
    Page,
    /// A recording and a controller at the same rate.
    Recording,
}

/// A browser that opens a page as soon as it is served.
fn watch(port: u16) -> std::io::Result<std::process::Child> {
    while std::net::TcpStream::connect((std::net::Ipv4Addr::LOCALHOST, port)).is_err() {
        std::thread::sleep(Duration::from_millis(50));
    }
    std::process::Command::new(std::env::var_os("CHROMIUM").unwrap_or_else(|| "chromium".into()))
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0"])
        .arg(format!("http://127.0.0.1:{port}/"))
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
}

/// The real stage; recorded together with a controller at the same rate, whose two topics are in
/// the bag as well.
fn stage(rate: f64, duration: Duration, beside: Beside) -> anyhow::Result<()> {
    let recorded = beside == Beside::Recording;
    let directory = tempfile::tempdir()?;
    let bag = directory.path().join("bag");
    let arguments = |given: &[String]| -> Vec<String> {
        given.iter().flat_map(|parameter| ["-p".to_owned(), parameter.clone()]).collect()
    };
    let mut given = vec![format!("control_rate:={rate:.1}"), "physics_rate:=40000.0".to_owned()];
    given.push("publish_clock:=true".to_owned());
    if recorded {
        given.push(format!("record:={}", bag.display()));
    }
    let mut watching = None;
    if beside == Beside::Page {
        let listener = std::net::TcpListener::bind((std::net::Ipv4Addr::LOCALHOST, 0))?;
        let port = listener.local_addr()?.port();
        given.push(format!("live_port:={port}"));
        drop(listener);
        watching = Some(std::thread::spawn(move || watch(port)));
    }
    let controller = arguments(&[format!("rate:={rate:.1}"), "bandwidth:=30.0".to_owned()]);
    let network =
        Network { domain: 1 + (std::process::id() % 100) as u16, reach: Reach::Localhost };
    let driver = Driver::new(Path::new(env!("CARGO_BIN_EXE_friction-stage")), network)?;
    let keys = [
        "lateness_p50_us",
        "lateness_p99_us",
        "lateness_max_us",
        "overruns",
        "unpublished_samples",
        "recording_dropped_samples",
    ];
    let log_stem = directory.path().join("run");
    let [p50, p99, max, overruns, unpublished, dropped] = driver.observe(
        &arguments(&given),
        recorded.then_some(&controller[..]),
        &log_stem,
        duration,
        keys,
    )?;
    if let Some(Ok(browser)) = watching.map(std::thread::JoinHandle::join) {
        match browser {
            Ok(mut browser) => {
                browser.kill()?;
                browser.wait()?;
            }
            Err(error) => {
                println!("    no browser watched (name one in CHROMIUM): {error}");
                return Ok(());
            }
        }
    }
    let name = match beside {
        Beside::Nothing => "alone",
        Beside::Page => "watched live",
        Beside::Recording => "controlled, recorded",
    };
    row(
        &format!("{rate} Hz, the stage, {name}"),
        [p50, p99, max, overruns],
        &unpublished.to_string(),
    );
    if recorded {
        report_bag(&bag, rate, dropped)?;
    }
    Ok(())
}

/// Messages per topic, and gaps in the stamps of the encoder: a dropped sample would leave one.
fn report_bag(bag: &Path, rate: f64, dropped: f64) -> anyhow::Result<()> {
    let reader = BagReader::open(bag)?;
    let mut counts: BTreeMap<String, u64> = BTreeMap::new();
    let (mut last, mut gaps) = (None, 0);
    for message in reader.messages() {
        let message = message?;
        *counts.entry(message.topic.name.clone()).or_default() += 1;
        if message.topic.name.ends_with("/encoder") {
            gaps +=
                u64::from(last.is_some_and(|last| (message.log_time - last) as f64 > 1.5e9 / rate));
            last = Some(message.log_time);
        }
    }
    let counts: Vec<String> =
        counts.iter().map(|(topic, count)| format!("{topic} {count}")).collect();
    println!("    in the bag: {}", counts.join(", "));
    println!("    {gaps} gaps in the encoder, {dropped} samples dropped by the recorder");
    Ok(())
}
