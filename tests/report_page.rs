//! The report pages in a real browser: they render whole, ask the network for nothing and leave no
//! error in the console.
//!
//! Needs Debian's `chromium`, or the browser that `CHROMIUM` names; without one the tests say so
//! and pass.

mod browser;

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use blind_tests::Setup;
use blind_tests::effects::by_name;
use browser::chromium;

/// The page as the browser has made it.
struct Rendered {
    document: String,
    /// What it wrote to the console.
    console: Vec<String>,
    /// Hosts that were asked for something; no name is resolved.
    hosts: BTreeSet<String>,
}

fn render(browser: &Path, page: &Path) -> Rendered {
    let profile = tempfile::tempdir().expect("a directory for the profile");
    let requests = profile.path().join("requests.json");
    let output = Command::new(browser)
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
            "--disable-background-networking",
        ])
        .args(["--disable-component-update", "--disable-sync", "--disable-dev-shm-usage"])
        .args([
            "--host-resolver-rules=MAP * ~NOTFOUND",
            "--enable-logging=stderr",
            "--virtual-time-budget=2000",
        ])
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .arg(format!("--log-net-log={}", requests.display()))
        .arg("--dump-dom")
        .arg(format!("file://{}", page.display()))
        .output()
        .expect("the browser starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let log = String::from_utf8_lossy(&output.stderr);
    let requests: Value =
        serde_json::from_slice(&std::fs::read(requests).expect("a log of the network"))
            .expect("the log is JSON");
    let events = requests["events"].as_array().expect("events");
    let urls = events.iter().filter_map(|event| event["params"]["url"].as_str());
    Rendered {
        hosts: urls
            .filter_map(|url| Some(url.split_once("//")?.1.split('/').next()?.to_owned()))
            .collect(),
        document: String::from_utf8(output.stdout).expect("a document in UTF-8"),
        console: log.lines().filter(|line| line.contains("CONSOLE")).map(str::to_owned).collect(),
    }
}

/// Hosts that the browser asks by itself.
fn own_hosts(browser: &Path) -> BTreeSet<String> {
    let directory = tempfile::tempdir().expect("a directory");
    let page = directory.path().join("empty.html");
    std::fs::write(&page, "<!doctype html><html></html>").expect("a page");
    render(browser, &page).hosts
}

fn assert_whole(browser: &Path, page: &Path, figures: usize, said: &[&str]) {
    let rendered = render(browser, page);
    let own = own_hosts(browser);
    assert!(rendered.hosts.is_subset(&own), "{} asks {:?}", page.display(), &rendered.hosts - &own);
    assert!(rendered.console.is_empty(), "{}: {:#?}", page.display(), rendered.console);
    let document = &rendered.document;
    assert!(document.trim_end().ends_with("</html>"));
    let drawn = document.matches("<svg").count();
    assert!(drawn >= figures, "{drawn} figures in {}", page.display());
    for text in said {
        assert!(document.contains(text), "{text:?} is missing in {}", page.display());
    }
}

#[test]
fn a_page_that_fetches_or_fails_is_noticed() {
    let Some(browser) = chromium() else { return };
    let directory = tempfile::tempdir().expect("a directory");
    for bad in [
        "<img src='http://example.com/figure.png'>",
        "<script>console.error('wrong')</script>",
        "<script>f(</script>",
    ] {
        let page = directory.path().join("page.html");
        std::fs::write(&page, format!("<!doctype html><html><body>{bad}</body></html>"))
            .expect("a page");
        let rendered = render(&browser, &page);
        let noticed = !rendered.console.is_empty() || rendered.hosts.contains("example.com");
        assert!(noticed, "{bad}: {:?}\n{}", rendered.hosts, rendered.document);
    }
}

#[test]
fn the_report_of_an_identification_renders_without_network_and_errors() {
    let Some(browser) = chromium() else { return };
    let directory = tempfile::tempdir().expect("a directory");
    let hidden = by_name("motor_gain", 3).expect("an effect");
    let run = Setup::new(3).with(hidden).generate().expect("a run");
    let [train, check, out] = ["train", "check", "out"].map(|name| directory.path().join(name));
    run.train.write_bag(&train).expect("a bag");
    run.check.write_bag(&check).expect("a bag");
    let output = Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .args(["identify", "--model"])
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("launch_config/stage_measured_runs.yaml"))
        .arg("--train")
        .arg(train)
        .arg("--holdout")
        .arg(check)
        .arg("--out")
        .arg(&out)
        .output()
        .expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_whole(&browser, &out.join("report.html"), 8, &["motor_gain", "found"]);
}

#[test]
fn the_report_of_an_experiment_renders_without_network_and_errors() {
    let Some(browser) = chromium() else { return };
    let directory = tempfile::tempdir().expect("a directory");
    let output = Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .args(["experiment", "fine-step", "--guides", "guide_2", "--no-bags", "--out"])
        .arg(directory.path())
        .output()
        .expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_whole(&browser, &directory.path().join("report.html"), 1, &["fine step", "guide 2"]);
}
