//! The plots of a page in a real browser: they zoom, tell values, switch curves off, by mouse and
//! keyboard, light and dark, on a wide screen and a narrow one.
//!
//! Needs Debian's `chromium`, or the browser that `CHROMIUM` names; without one the tests say so
//! and pass.

mod browser;

use std::process::Command;

use browser::{Browser, Look, chromium};
use friction_stage_report::chart::{Axis, Chart, Scale, Style};
use friction_stage_report::page::Page;

const WIDE: Look = Look { width: 1280, dark: false };
const SAMPLES: u32 = 200_000;
/// The one sample that is far from the others, s.
const SPIKE: f64 = 123.4565;

/// Two charts over the same 200 s: a line and a wave with one spike of a single sample; and a loop,
/// which has no plot.
fn page() -> String {
    let time = |k: u32| 1e-3 * f64::from(k);
    let mut first = Chart::new("A line and a wave", "time, s", "force, N");
    first.add("line", 0, Style::Line, (0..SAMPLES).map(|k| (time(k), 3.0 * time(k))));
    let spike = (SPIKE * 1e3) as u32;
    let wave = |k: u32| if k == spike { 1000.0 } else { (0.05 * time(k)).sin() };
    first.add("wave", 1, Style::Line, (0..SAMPLES).map(|k| (time(k), wave(k))));
    first.band("noise", Axis::Y, -20.0, 20.0);
    first.zooms_with = Some("time".to_owned());
    let mut second = Chart::new("With a gap", "time, s", "position, mm");
    let gap = |k: u32| if (80_000..90_000).contains(&k) { f64::NAN } else { -time(k) };
    second.add("fall", 2, Style::Line, (0..SAMPLES).map(|k| (time(k), gap(k))));
    second.zooms_with = Some("time".to_owned());
    let mut third = Chart::new("Loop", "x", "y");
    third.add("", 0, Style::Line, [(0.0, 0.0), (1.0, 1.0), (0.5, 2.0), (0.0, 0.0)]);
    let mut page = Page::new("Plots", "of a test");
    page.section("Plots");
    for chart in [&first, &second, &third] {
        page.figure(chart, "caption").expect("a chart");
    }
    page.finish()
}

struct Open {
    browser: Browser,
    _directory: tempfile::TempDir,
}

fn open(look: Look) -> Option<Open> {
    open_page(look, page())
}

fn open_page(look: Look, page: String) -> Option<Open> {
    let program = chromium()?;
    let directory = tempfile::tempdir().expect("a directory");
    let file = directory.path().join("page.html");
    std::fs::write(&file, page).expect("a page");
    let browser = Browser::open(&program, &format!("file://{}", file.display()), look);
    Some(Open { browser, _directory: directory })
}

/// The part of a plot in which the cursor moves.
fn over(figure: usize) -> String {
    format!("document.querySelectorAll('figure')[{figure}].querySelector('.u-over')")
}

fn shown(figure: usize, what: &str) -> String {
    format!("document.querySelectorAll('figure')[{figure}].querySelector('{what}').textContent")
}

impl Open {
    /// Abscissa and values that the cursor tells at a part of the width.
    fn values(&mut self, figure: usize, part: f64) -> (f64, Vec<f64>) {
        let at = self.browser.place(&over(figure), (part, 0.5));
        self.browser.mouse("mouseMoved", (at.0 - 9.0, at.1), 0);
        self.browser.mouse("mouseMoved", at, 0);
        self.browser.wait_until(&format!("{} !== ''", shown(figure, ".plot-at")));
        let x = self.browser.text(&shown(figure, ".plot-at"));
        let all = self.browser.evaluate(&format!(
            "[...document.querySelectorAll('figure')[{figure}].querySelectorAll('output')].map((o) \
             => Number.parseFloat(o.textContent || 0))"
        ));
        let x = x.trim_end_matches(" s").parse().expect("a number and its unit");
        let all = all.as_array().expect("values").iter().map(|v| v.as_f64().expect("a number"));
        (x, all.collect())
    }

    /// Pixels of a colour in a plot, and the highest of them as a part of the height.
    fn pixels(&mut self, figure: usize, colour: [u8; 3]) -> (f64, f64) {
        let [r, g, b] = colour;
        let found = self.browser.evaluate(&format!(
            "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => {{ \
             const c = document.createElement('canvas'); const from = \
             document.querySelectorAll('figure')[{figure}].querySelector('canvas'); c.width = \
             from.width; c.height = from.height; const to = c.getContext('2d', \
             {{willReadFrequently: true}}); to.drawImage(from, 0, 0); const d = to.getImageData(0, \
             0, c.width, c.height).data; let n = 0, top = 1; for \
             (let k = 0; k < d.length; k += 4) if (Math.abs(d[k] - {r}) + Math.abs(d[k + 1] - {g}) \
             + Math.abs(d[k + 2] - {b}) < 40 && d[k + 3] > 200) {{ n++; top = Math.min(top, \
             Math.floor(k / 4 / c.width) / c.height); }} done([n, top]); }})))"
        ));
        (found[0].as_f64().expect("a number"), found[1].as_f64().expect("a number"))
    }

    fn assert_quiet(&self) {
        assert!(self.browser.console.is_empty(), "{:#?}", self.browser.console);
        let foreign = |url: &&String| !url.contains("page.html");
        assert_eq!(self.browser.requests.iter().find(foreign), None);
    }
}

const LINE: [u8; 3] = [0, 114, 178];
const WAVE: [u8; 3] = [213, 94, 0];

#[test]
fn the_cursor_tells_values_and_a_drag_zooms_all_charts_of_a_group() {
    let Some(mut open) = open(WIDE) else { return };
    let whole = open.values(0, 0.5);
    assert!((whole.0 - 100.0).abs() < 1.0, "{whole:?}");
    assert!((whole.1[0] - 3.0 * whole.0).abs() < 0.01, "{whole:?}");
    assert!((whole.1[1] - (0.05 * whole.0).sin()).abs() < 1e-3, "{whole:?}");

    // From a quarter to the half.
    let [from, to] = [0.25, 0.5].map(|part| open.browser.place(&over(0), (part, 0.5)));
    open.browser.mouse("mouseMoved", from, 0);
    open.browser.mouse("mousePressed", from, 1);
    open.browser.mouse("mouseMoved", ((from.0 + to.0) / 2.0, to.1), 1);
    open.browser.mouse("mouseMoved", to, 1);
    open.browser.mouse("mouseReleased", to, 1);
    for figure in [0, 1] {
        let (left, right) = (open.values(figure, 0.01).0, open.values(figure, 0.99).0);
        assert!((left - 49.0).abs() < 2.0 && (right - 99.5).abs() < 2.0, "{left} to {right}");
    }
    // What the cursor tells is a sample and not what was drawn.
    let (x, values) = open.values(0, 0.4);
    assert!((values[0] - 3.0 * x).abs() < 0.003, "{x}: {values:?}");

    let at = open.browser.place(&over(0), (0.5, 0.5));
    for clicks in [1, 2] {
        open.browser.mouse("mousePressed", at, clicks);
        open.browser.mouse("mouseReleased", at, clicks);
    }
    assert!(open.values(1, 0.99).0 > 190.0);
    open.assert_quiet();
}

#[test]
fn a_single_sample_is_seen_on_the_whole_and_a_curve_can_be_switched_off() {
    let Some(mut open) = open(WIDE) else { return };
    // Of 200 000 samples the one that is far off reaches the top.
    let (count, top) = open.pixels(0, WAVE);
    assert!(count > 100.0 && top < 0.15, "{count} pixels, the highest at {top}");
    let button = "document.querySelectorAll('.plot-curve')[1]";
    open.browser.click(button);
    assert_eq!(open.browser.text(&format!("{button}.getAttribute('aria-pressed')")), "false");
    assert_eq!(open.pixels(0, WAVE).0, 0.0);
    // The line has the room to itself.
    let (count, top) = open.pixels(0, LINE);
    assert!(count > 300.0 && top < 0.15, "{count} pixels, the highest at {top}");
    open.browser.click(button);
    assert!(open.pixels(0, WAVE).0 > 100.0);
    open.assert_quiet();
}

#[test]
fn a_keyboard_is_enough_and_says_what_it_finds() {
    let Some(mut open) = open(WIDE) else { return };
    open.browser.evaluate("document.querySelector('.plot-stage').focus()");
    open.browser.key("ArrowRight");
    let said = shown(0, ".plot-said");
    open.browser.wait_until(&format!("{said}.startsWith('10')"));
    let reported = open.browser.text(&said);
    assert!(reported.contains(" s: line 3") && reported.contains("wave"), "{reported}");
    open.browser.key("+");
    open.browser.key("+");
    let (left, right) = (open.values(0, 0.01).0, open.values(0, 0.99).0);
    assert!((45.0..56.0).contains(&(right - left)), "{left} to {right}");
    open.browser.key("PageDown");
    assert!(open.values(0, 0.01).0 > left + 20.0);
    open.browser.key("0");
    assert!(open.values(0, 0.99).0 > 190.0);
    // A switch of a curve is a button.
    open.browser.evaluate("document.querySelector('.plot-curve').focus()");
    let event = |kind| serde_json::json!({"type": kind, "key": " ", "code": "Space", "text": " "});
    open.browser.call("Input.dispatchKeyEvent", event("keyDown"));
    open.browser.call("Input.dispatchKeyEvent", event("keyUp"));
    let pressed = "document.querySelector('.plot-curve').getAttribute('aria-pressed')";
    assert_eq!(open.browser.text(pressed), "false");
    open.assert_quiet();
}

#[test]
fn the_page_fits_a_phone_follows_the_colours_of_the_system_and_prints_its_drawings() {
    let Some(mut open) = open(WIDE) else { return };
    let display =
        |what: &str| format!("getComputedStyle(document.querySelector('{what}')).display");
    assert_eq!(open.browser.text(&display("figure.live > svg")), "none");
    // A loop is a drawing: it has several values at an abscissa.
    let loops = "getComputedStyle(document.querySelectorAll('figure > svg')[2]).display";
    assert_eq!(open.browser.text(loops), "block");
    open.browser.look(Look { width: 400, dark: true });
    open.browser.wait_until("document.querySelector('canvas').width < 400");
    assert!(open.browser.number("document.documentElement.scrollWidth") <= 400.0);
    let ground =
        open.browser.text("getComputedStyle(document.querySelector('main')).backgroundColor");
    assert_eq!(ground, "rgb(22, 27, 34)");
    assert!(open.pixels(0, [74, 168, 224]).0 > 50.0 && open.pixels(0, LINE).0 == 0.0);
    open.browser.print();
    assert_eq!(open.browser.text(&display("figure.live > svg")), "block");
    assert_eq!(open.browser.text(&display(".plot")), "none");
    open.assert_quiet();
}

#[test]
fn a_curve_is_wider_only_while_another_one_lies_on_it() {
    let mut page = Page::new("Plots", "of a test");
    let mut chart = Chart::new("Two curves", "time, s", "position, mm");
    let wave = |off: f64| (0..2000).map(move |k| (f64::from(k), (1e-2 * f64::from(k)).sin() + off));
    chart.add("below", 0, Style::Line, wave(0.0));
    chart.add("above", 1, Style::Line, wave(0.004));
    page.figure(&chart, "Caption.").expect("a chart");
    let Some(mut open) = open_page(WIDE, page.finish()) else { return };
    let said = shown(0, ".overlaps");
    let lies_on = format!("{said}.includes('\u{201c}above\u{201d} lies on \u{201c}below\u{201d}')");
    let apart = format!("{said} === ''");
    let swatch = "document.querySelector('.plot-curve i').style.borderTopWidth";
    open.browser.wait_until(&lies_on);
    assert_eq!(open.browser.text(swatch), "5px");
    open.browser.evaluate("document.querySelector('.plot-stage').focus()");
    for _ in 0..7 {
        open.browser.key("+");
    }
    open.browser.wait_until(&apart);
    assert_eq!(open.browser.text(swatch), "3px");
    open.browser.key("0");
    open.browser.wait_until(&lies_on);
    let button = "document.querySelectorAll('.plot-curve')[1]";
    open.browser.click(button);
    open.browser.wait_until(&apart);
    open.browser.click(button);
    open.browser.wait_until(&lies_on);
    open.assert_quiet();
}

#[test]
fn a_drawing_has_the_colours_of_the_plots_in_the_dark_as_well() {
    let Some(mut open) = open(WIDE) else { return };
    let stroke = "getComputedStyle([...document.querySelectorAll('figure > svg')[2]\
                  .querySelectorAll('polyline')].pop()).stroke";
    assert_eq!(open.browser.text(stroke), "rgb(0, 114, 178)");
    open.browser.look(Look { width: 1280, dark: true });
    open.browser.wait_until(&format!("{stroke} === 'rgb(74, 168, 224)'"));
    assert!(open.pixels(0, [74, 168, 224]).0 > 50.0);
    open.assert_quiet();
}

/// On less than a decade, on two that begin anywhere, and on more than numbers of 64 bits resolve.
#[test]
fn a_logarithmic_axis_has_its_numbers_whatever_it_spans() {
    let mut page = Page::new("Plots", "of a test");
    for values in [[2.0, 7.0, 3.0], [4.7e3, 4.6e5, 2e4], [1e-20, 2e3, 1.0]] {
        let mut chart = Chart::new("t", "x", "y").logarithmic(false, true);
        let points = values.into_iter().enumerate().map(|(k, value)| (0.1 * k as f64, value));
        chart.add("curve", 0, Style::Both, points);
        chart.line("limit", Axis::Y, values[2]);
        page.figure(&chart, "caption").expect("a chart");
    }
    let Some(mut open) = open_page(WIDE, page.finish()) else { return };
    // What is written from now on; the plots are made again for a dark screen.
    open.browser.evaluate(
        "window.words = []; const write = CanvasRenderingContext2D.prototype.fillText; \
         CanvasRenderingContext2D.prototype.fillText = function (text, ...more) { \
         window.words.push(text); return write.call(this, text, ...more); }; true",
    );
    open.browser.look(Look { width: 1280, dark: true });
    for number in ["4", "6", "1e4", "1e5", "1e-8", "1e2", "limit"] {
        open.browser.wait_until(&format!("window.words.includes('{number}')"));
    }
    for figure in 0..3 {
        assert!(open.pixels(figure, [74, 168, 224]).0 > 50.0, "{figure}");
    }
    open.assert_quiet();
}

/// What is written and drawn from now on; the plots are made again for a dark screen. A word with
/// its middle or end, its width and its figure, a line with its abscissas.
const RECORD: &str = "window.words = []; window.lines = []; const write = \
    CanvasRenderingContext2D.prototype.fillText; CanvasRenderingContext2D.prototype.fillText = \
    function (text, x, y) { window.words.push({text, x, y, width: this.measureText(text).width, \
    align: this.textAlign, canvas: this.canvas}); return write.call(this, text, x, y); }; const to \
    = Path2D.prototype.lineTo; Path2D.prototype.lineTo = function (x, y) { window.lines.push([x, \
    y]); return to.call(this, x, y); }; true";

#[test]
fn numbers_of_an_axis_do_not_overlap_on_a_phone() {
    let mut page = Page::new("Plots", "of a test");
    for scale in [Scale::Asinh(0.0099), Scale::Asinh(2.0), Scale::Log] {
        let mut chart = Chart::new("t", "acceleration, m/s²", "N").along(scale);
        let from = if scale == Scale::Log { 1 } else { -3000 };
        chart.add("curve", 0, Style::Line, (from..3000).map(|k| (1e-2 * f64::from(k), 1.0)));
        page.figure(&chart, "caption").expect("a chart");
    }
    let Some(mut open) = open_page(Look { width: 400, dark: false }, page.finish()) else { return };
    open.browser.evaluate(RECORD);
    open.browser.look(Look { width: 400, dark: true });
    open.browser.wait_until("new Set(window.words.map((w) => w.canvas)).size === 3");
    let overlaps = open.browser.evaluate(
        "(() => { const found = []; const number = (w) => w.align === 'center' && \
         /^-?[0-9.e-]+$/.test(w.text); const all = window.words.filter(number); for (const a of \
         all) for (const b of all) { const is_row = a.canvas === b.canvas && Math.abs(a.y - b.y) < \
         2 && a.x < b.x; if (is_row && b.x - a.x < (a.width + b.width) / 2) found.push(`${a.text} \
         ${b.text}`); } return all.length < 6 ? ['too few'] : found; })()",
    );
    assert_eq!(overlaps, serde_json::json!([]));
    open.assert_quiet();
}

#[test]
fn slopes_are_no_stairs_and_words_lie_on_no_curve() {
    let mut page = Page::new("Plots", "of a test");
    let mut chart = Chart::new("Two grids", "time, s", "position, mm");
    chart.add("one", 0, Style::Line, (0..20_000).map(|k| (1e-3 * f64::from(k), f64::from(k))));
    let other = (0..17_000).map(|k| (1.1e-3 * f64::from(k), 2e4 - f64::from(k)));
    chart.add("other", 1, Style::Line, other);
    page.figure(&chart, "caption").expect("a chart");
    let mut chart = Chart::new("Peaks", "frequency, Hz", "N");
    let hill = |k: i32, middle: f64| (-(f64::from(k) - middle).powi(2) / 900.0).exp();
    chart.add("first", 0, Style::Line, (0..400).map(|k| (f64::from(k), hill(k, 150.0))));
    chart.add("second", 0, Style::Line, (0..400).map(|k| (f64::from(k), 0.7 * hill(k, 170.0))));
    chart.add("fall", 0, Style::Line, [(0.0, 1.0), (400.0, 0.0)]);
    chart.line("limit", Axis::Y, 0.05);
    chart.label((150.0, 1.0), "higher peak");
    chart.label((170.0, 0.7), "lower peak");
    page.figure(&chart, "caption").expect("a chart");
    let Some(mut open) = open_page(Look { width: 400, dark: true }, page.finish()) else { return };
    open.browser.evaluate(RECORD);
    open.browser.look(Look { width: 400, dark: false });
    for word in ["higher peak", "lower peak", "limit"] {
        open.browser.wait_until(&format!("window.words.some((w) => w.text === '{word}')"));
        let blue = open.browser.number(&format!(
            "(() => {{ const w = window.words.findLast((w) => w.text === '{word}'); \
             const c = document.createElement('canvas'); c.width = w.width; c.height = 12; \
             const to = c.getContext('2d', {{willReadFrequently: true}}); \
             to.drawImage(w.canvas, w.width / 2 - w.x, -w.y); \
             const d = to.getImageData(0, 0, c.width, c.height).data; let n = 0; \
             for (let k = 0; k < d.length; k += 4) {{ const off = Math.abs(d[k]) + \
             Math.abs(d[k + 1] - 114) + Math.abs(d[k + 2] - 178); if (off < 40 && d[k + 3] > 200) \
             n++; }} return n; }})()"
        ));
        assert_eq!(blue, 0.0, "{word}");
    }
    let lines = "window.lines.filter((at, k) => k > 0 && at[0] === window.lines[k - 1][0]).length";
    assert_eq!(open.browser.number(lines), 0.0);
    assert!(open.browser.number("window.lines.length") > 1000.0);
    open.assert_quiet();
}

#[test]
fn view_shows_runs_over_each_other() {
    let Some(program) = chromium() else { return };
    let directory = tempfile::tempdir().expect("a directory");
    let command = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_friction-stage"))
            .args(arguments)
            .current_dir(directory.path())
            .output()
            .expect("the program starts");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    assert_eq!(command(&["demo", "recordings"]).0, Some(0));
    std::fs::write(
        directory.path().join("run.csv"),
        "time,position,force_cell,force\n0,0,1,1\n0.1,0.001,2,2\n0.2,0.003,3,3\n0.3,0.002,1,1\n",
    )
    .expect("a table");
    let view = ["view", "recordings/train", "recordings/check", "run.csv", "--out", "page.html"];
    let done = command(&view);
    assert_eq!(done.0, Some(0), "{}", done.1);
    let page = directory.path().join("page.html");
    let browser = Browser::open(&program, &format!("file://{}", page.display()), WIDE);
    let mut open = Open { browser, _directory: directory };
    let names = open.browser.evaluate(
        "[...document.querySelector('figure').querySelectorAll('.plot-curve \
         span')].map((e) => e.textContent)",
    );
    let curves = ["train", "check", "run.csv", "setpoint of train", "setpoint of check"];
    assert_eq!(names, serde_json::json!(curves));
    let (x, values) = open.values(0, 0.3);
    assert!(x > 1.0 && values[0] != 0.0 && values[1] != 0.0, "{x}: {values:?}");
    open.assert_quiet();

    let nothing = tempfile::tempdir().expect("a directory");
    let output = Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .args(["view", "absent"])
        .current_dir(nothing.path())
        .output()
        .expect("the program starts");
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("absent"));
    assert_eq!(std::fs::read_dir(nothing.path()).unwrap().count(), 0);
    // Without a name each page has one of its own.
    std::fs::write(nothing.path().join("a.csv"), "time,position\n0,0\n1,1e-3\n2,0\n").unwrap();
    for pages in [1, 2] {
        let output = Command::new(env!("CARGO_BIN_EXE_friction-stage"))
            .args(["view", "a.csv"])
            .current_dir(nothing.path())
            .output()
            .expect("the program starts");
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(std::fs::read_dir(nothing.path()).unwrap().count(), 1 + pages);
    }
}
