//! The report of a compensation: the same motion without and with, as a table and as a page.

use std::fmt::Write as _;

use serde_json::{Value, json};

use friction_stage_lab::TrialRun;

use crate::chart::{Chart, Style};
use crate::figure::FigureError;
use crate::page::{Align, Cell, Mark, Page, Table, Tile};
use crate::words::{fixed, four_digits, in_prefix};

/// Both runs of a trial, with what is not compensated.
#[derive(Clone, Copy, Debug)]
pub struct TrialRuns<'a> {
    /// Without.
    pub plain: &'a TrialRun,
    /// With.
    pub compensated: &'a TrialRun,
    /// Effects of the model that are not compensated.
    pub left_out: &'a [&'static str],
}

/// What of a run is compared: name, value and unit of both; `NaN` for what never settles.
fn rows(runs: &TrialRuns) -> [(&'static str, f64, f64); 5] {
    let settled = |run: &TrialRun, band: usize| {
        run.settling()[band].map_or(f64::NAN, |seconds| 1e3 * seconds)
    };
    let (plain, with) = (runs.plain, runs.compensated);
    [
        ("peak error, µm", 1e6 * plain.peak, 1e6 * with.peak),
        ("rms error, µm", 1e6 * plain.rms, 1e6 * with.rms),
        ("settled to 10 µm, ms", settled(plain, 0), settled(with, 0)),
        ("settled to 1 µm, ms", settled(plain, 1), settled(with, 1)),
        ("settled to 0.1 µm, ms", settled(plain, 2), settled(with, 2)),
    ]
}

/// A value of a row as it is shown: times to the sample, errors in digits of their own size.
fn in_digits(name: &str, value: f64) -> String {
    if name.ends_with("ms") { fixed(value, 2) } else { four_digits(value) }
}

/// The table as text for a person.
pub fn compensation_text(runs: &TrialRuns) -> String {
    let mut out = String::new();
    // A string takes whatever is written.
    let _ = writeln!(out, "{:24} {:>12} {:>12} {:>8}", "", "without", "with", "ratio");
    for (name, plain, with) in rows(runs) {
        let shown = |value: f64| match value.is_finite() {
            true => in_digits(name, value),
            false => "never".to_owned(),
        };
        let ratio = if plain > 0.0 { with / plain } else { f64::NAN };
        let ratio = if ratio.is_finite() { format!("{ratio:.3}") } else { "-".to_owned() };
        let _ = writeln!(out, "{name:24} {:>12} {:>12} {ratio:>8}", shown(plain), shown(with));
    }
    for warning in compensation_warnings(runs) {
        let _ = writeln!(out, "warning: {warning}");
    }
    out
}

/// What a user should know.
pub fn compensation_warnings(runs: &TrialRuns) -> Vec<String> {
    let mut warnings = Vec::new();
    if runs.compensated.rms > runs.plain.rms {
        warnings.push(
            "the error is larger with the compensation: the model is not that of this stage"
                .to_owned(),
        );
    }
    if runs.compensated.saturated > 0 {
        warnings.push(format!(
            "the motor is at its limit in {} samples with the compensation",
            runs.compensated.saturated
        ));
    }
    if !runs.left_out.is_empty() {
        warnings.push(format!("not compensated: {}", runs.left_out.join(", ")));
    }
    warnings
}

/// Both runs for other programs, SI units.
pub fn compensation_json(runs: &TrialRuns) -> Value {
    json!({
        "schema_version": 1,
        "without": runs.plain,
        "with": runs.compensated,
        "not_compensated": runs.left_out,
        "warnings": compensation_warnings(runs),
    })
}

/// What the user calls the models of a trial.
#[derive(Clone, Copy, Debug)]
pub struct TrialNames<'a> {
    /// What is known.
    pub known: &'a str,
    /// The stage as it is.
    pub real: &'a str,
}

/// Colours of the runs without and with: warm and cold, as before and after an identification.
const COLOURS: [usize; 2] = [1, 0];

/// The unit in which an error of this size is read, m, and how many there are in a metre.
fn unit_of(size: f64) -> (f64, &'static str) {
    match size {
        size if size >= 1e-3 => (1e3, "mm"),
        size if size >= 1e-6 => (1e6, "µm"),
        _ => (1e9, "nm"),
    }
}

/// The page and its figure.
pub fn compensation_page(
    names: TrialNames,
    runs: &TrialRuns,
) -> Result<(String, String), FigureError> {
    let (plain, with) = (runs.plain, runs.compensated);
    let mut page = Page::new(
        format!("Compensation of {} by {}", names.real, names.known),
        format!(
            "The same motion of {} without and with what {} knows, fed forward along the \
             reference.",
            names.real, names.known
        ),
    );
    let tile = |name: &str, plain: f64, with: f64| Tile {
        name: name.to_owned(),
        value: in_prefix(with, "m"),
        detail: format!("without compensation {}", in_prefix(plain, "m")),
        mark: if with < plain { Mark::Good } else { Mark::Bad },
    };
    page.tiles(&[
        tile("peak error", plain.peak, with.peak),
        tile("rms error", plain.rms, with.rms),
    ]);
    for warning in compensation_warnings(runs) {
        page.note(Mark::Warning, &warning);
    }
    let (of_both, of_one) = (plain.peak.max(with.peak), with.peak);
    let error = |run: &TrialRun, scale: f64| -> Vec<(f64, f64)> {
        run.errors.iter().map(|(time, error)| (1e-9 * *time as f64, scale * error)).collect()
    };
    let (scale, unit) = unit_of(of_both);
    let mut chart = Chart::new("Position error", "time, s", format!("position error, {unit}"));
    for (name, run, colour) in [("without", plain, COLOURS[0]), ("with", with, COLOURS[1])] {
        chart.add(name, colour, Style::Line, error(run, scale));
    }
    chart.zooms_with = Some("time".to_owned());
    let svg = chart.svg()?;
    page.figure(
        &chart,
        "Measured error along the motion, after a rest of ten time constants of the integral, 10 s \
         at most, in which it takes over the constant forces.",
    )?;
    let (scale, unit) = unit_of(of_one);
    let label = format!("position error, {unit}");
    let mut left = Chart::new("Position error with compensation", "time, s", label);
    left.zooms_with = chart.zooms_with.clone();
    left.add("with", COLOURS[1], Style::Line, error(with, scale));
    page.figure(&left, "What the compensation leaves, on a scale of its own.")?;
    let mut table =
        Table::new(&[("", Align::Left), ("without", Align::Right), ("with", Align::Right)])
            .captioned(
                "Settling: the longest of all moves that end in a rest; a dash: some never do.",
            );
    for (name, plain, with) in rows(runs) {
        let (name, unit) = name.rsplit_once(", ").unwrap_or((name, ""));
        let shown = |value: f64| match (value.is_finite(), unit) {
            (false, _) => Cell::text("\u{2013}"),
            (true, "µm") => Cell::text(in_prefix(1e-6 * value, "m")),
            (true, unit) => Cell::text(format!("{} {unit}", fixed(value, 2))),
        };
        table.row([Cell::text(name), shown(plain), shown(with)]);
    }
    page.table(&table);
    Ok((page.finish(), svg))
}
