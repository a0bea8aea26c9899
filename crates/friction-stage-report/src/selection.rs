//! The report of a choice of a guide: the ranking in words, and the trade-off as a figure.

use std::fmt::Write as _;

use serde::Serialize;

use crate::chart::{Axis, Chart, Style};
use crate::figure::{FigureError, svg};
use crate::paper_motion::micrometres;
use crate::words::{Worded, Words as _, all_words, fixed, guide_label};
use friction_stage_core::model::JointType;
use friction_stage_data::quality::Severity;
use friction_stage_lab::{GuideSelection, Ranked, SelectionFinding, SelectionPlan, Tally};

/// The whole of `summary.json`.
#[derive(Debug, Serialize)]
pub struct SelectionSummary<'a> {
    /// Version of the format.
    pub schema_version: u32,
    /// Name of the application.
    pub application: &'a str,
    /// Seed of draws and noise.
    pub seed: u64,
    /// Variants in the result, over all guides.
    pub variants: u64,
    /// The guide to take, if one meets the requirement in some variant.
    pub choice: Option<&'a str>,
    /// The guides, the best first.
    pub ranking: Vec<RankedInWords<'a>>,
    /// What a user should know, each with a code.
    pub findings: Vec<Worded<'a, SelectionFinding>>,
    /// What a script must notice: the choice is not a safe one.
    pub warnings: Vec<String>,
    /// Advice.
    pub notes: Vec<String>,
}

/// One row of the ranking, with words.
#[derive(Debug, Serialize)]
pub struct RankedInWords<'a> {
    /// Its numbers.
    #[serde(flatten)]
    pub row: &'a Ranked,
    /// Why it is not the one to take; empty for the chosen one.
    pub reasons: Vec<String>,
}

impl<'a> SelectionSummary<'a> {
    /// A choice with the words for it.
    pub fn new(selection: &'a GuideSelection) -> SelectionSummary<'a> {
        let joint = JointType::Prismatic;
        let (warnings, notes): (Vec<_>, Vec<_>) =
            selection.findings.iter().partition(|finding| finding.is_warning());
        SelectionSummary {
            schema_version: 1,
            application: &selection.application,
            seed: selection.seed,
            variants: selection.variants,
            choice: selection.choice.as_deref(),
            ranking: selection
                .ranking
                .iter()
                .map(|row| RankedInWords { row, reasons: all_words(&row.drawbacks, joint) })
                .collect(),
            findings: selection.findings.iter().map(worded).collect(),
            warnings: all_words(warnings, joint),
            notes: all_words(notes, joint),
        }
    }
}

fn worded(finding: &SelectionFinding) -> Worded<'_, SelectionFinding> {
    let severity = if finding.is_warning() { Severity::Warning } else { Severity::Note };
    Worded::new(finding.code(), severity, finding, JointType::Prismatic)
}

/// Why a guide is not the one to take, in one sentence.
pub fn reasons(row: &Ranked) -> String {
    all_words(&row.drawbacks, JointType::Prismatic).join("; ")
}

/// The ranking as text for a person.
pub fn selection_text(plan: &SelectionPlan, selection: &GuideSelection) -> String {
    let mut out = String::new();
    // A string takes whatever is written.
    let _ = write_ranking(&mut out, plan, selection);
    out
}

fn write_ranking(
    out: &mut String,
    plan: &SelectionPlan,
    selection: &GuideSelection,
) -> std::fmt::Result {
    let band = micrometres(plan.application.requirement.settling_band);
    writeln!(out, "{}: {} variants", selection.application, selection.variants)?;
    writeln!(out)?;
    writeln!(
        out,
        "                     meets the   peak error, µm (5, 50, 95 %)   settled to {band} \
         after, ms"
    )?;
    writeln!(out, "     guide         requirement")?;
    for row in &selection.ranking {
        let mark = if selection.choice.as_ref() == Some(&row.guide) { '*' } else { ' ' };
        let (peak, settling) = (row.peak_error, row.settling_time);
        let [a, b, c] = [peak.q05, peak.q50, peak.q95].map(|error| fixed(error * 1e6, 2));
        let [d, e, f] =
            [settling.q05, settling.q50, settling.q95].map(|time| match time.is_finite() {
                true => format!("{:.1}", time * 1e3),
                false => "never".to_owned(),
            });
        let chance = format!("{:.1} %", 100.0 * row.chance);
        writeln!(
            out,
            "{mark} {}. {:16} {chance:>9}     {a:>8} {b:>8} {c:>8}     {d:>8} {e:>8} {f:>8}",
            row.rank, row.guide
        )?;
    }
    writeln!(out)?;
    if let Some(choice) = &selection.choice {
        writeln!(out, "take {choice}")?;
    }
    for row in selection.ranking.iter().filter(|row| !row.drawbacks.is_empty()) {
        writeln!(out, "not {}: {}", row.guide, reasons(row))?;
    }
    for finding in &selection.findings {
        let kind = if finding.is_warning() { "warning" } else { "note" };
        writeln!(out, "{kind}: {}", finding.words(JointType::Prismatic))?;
    }
    Ok(())
}

/// Peak error against settling time: of each guide a cross from the 5 % to the 95 % quantiles
/// through the medians, the requirement as the corner that it must stay in; then the distributions
/// of both. The chosen guide is named, and guides that the application excludes are dashed.
pub fn trade_off_figure(
    plan: &SelectionPlan,
    tallies: &[Tally],
    selection: &GuideSelection,
) -> Result<String, FigureError> {
    svg(&plan.application.name, &trade_off_charts(plan, tallies, selection))
}

fn trade_off_charts(
    plan: &SelectionPlan,
    tallies: &[Tally],
    selection: &GuideSelection,
) -> [Chart; 3] {
    let application = &plan.application;
    let requirement = &application.requirement;
    // What never settles is drawn at the end of what was watched.
    let (um, ms) =
        (|error: f64| error * 1e6, |time: f64| time.min(application.motion.settle) * 1e3);
    let settled =
        format!("settled to {} after the arrival, ms", micrometres(requirement.settling_band));
    let (x, y) = (um(requirement.peak_error), ms(requirement.settling_time));
    let required = "required at most";
    let share = "share of the variants, %";
    let mut trade_off = Chart::new(
        "Medians with 5 % and 95 % quantiles; lower left is better",
        "peak error, µm",
        &settled,
    );
    let mut peaks = Chart::new("Peak error", "peak error below, µm", share);
    let mut times = Chart::new("Settling time", &settled, share);
    for (colour, tally) in tallies.iter().enumerate() {
        let candidate = &plan.candidates[colour];
        let label = guide_label(&candidate.name);
        let (name, style) = match &candidate.obstacle {
            Some(_) => (format!("{label}: excluded"), Style::Dashed),
            None if selection.choice.as_ref() == Some(&candidate.name) => {
                (format!("{label}: chosen"), Style::Line)
            }
            None => (label, Style::Line),
        };
        let (peak, settling) = (tally.peak_error(), tally.settling_time());
        let ([x0, x1, x2], [y0, y1, y2]) = (
            [peak.q05, peak.q50, peak.q95].map(um),
            [settling.q05, settling.q50, settling.q95].map(ms),
        );
        trade_off.add(&name, colour, style, [(x0, y1), (x2, y1)]);
        trade_off.add("", colour, style, [(x1, y0), (x1, y2)]);
        let steps = || (1..=200).map(|k| (f64::from(k) / 200.0, f64::from(k) / 2.0));
        let peak = steps().map(|(part, percent)| (um(tally.peak_error_at(part)), percent));
        peaks.add(&name, colour, style, peak);
        let time = steps().map(|(part, percent)| (ms(tally.settling_time_at(part)), percent));
        times.add(&name, colour, style, time);
    }
    trade_off.line("largest peak allowed", Axis::X, x);
    trade_off.line("latest settling allowed", Axis::Y, y);
    peaks.line(required, Axis::X, x);
    times.line(required, Axis::X, y);
    [trade_off, peaks, times]
}
