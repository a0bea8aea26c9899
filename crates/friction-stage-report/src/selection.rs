//! The report of a choice of a guide: the ranking in words, and the trade-off as a figure.

use std::fmt::Write as _;

use crate::figure::{FigureCurve, FigureError, Panel, svg};
use friction_stage_lab::{GuideSelection, SelectionPlan, Tally};

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
    let band = plan.application.requirement.settling_band * 1e6;
    writeln!(out, "{}: {} variants", selection.application, selection.variants)?;
    writeln!(out)?;
    writeln!(
        out,
        "                     meets the   peak error, um (5, 50, 95 %)   settled to {band} um \
         after, ms"
    )?;
    writeln!(out, "     guide         requirement")?;
    for row in &selection.ranking {
        let mark = if selection.choice.as_ref() == Some(&row.guide) { '*' } else { ' ' };
        let (peak, settling) = (row.peak_error, row.settling_time);
        let [a, b, c] = [peak.q05, peak.q50, peak.q95].map(|error| format!("{:.2}", error * 1e6));
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
    for row in selection.ranking.iter().filter(|row| !row.reasons.is_empty()) {
        writeln!(out, "not {}: {}", row.guide, row.reasons.join("; "))?;
    }
    for warning in &selection.warnings {
        writeln!(out, "warning: {warning}")?;
    }
    Ok(())
}

/// Peak error against settling time: of each guide a cross from the 5 % to the 95 % quantiles
/// through the medians, the requirement as the corner that it must stay in; then the distributions
/// of both.
pub fn trade_off_figure(plan: &SelectionPlan, tallies: &[Tally]) -> Result<String, FigureError> {
    let application = &plan.application;
    let requirement = &application.requirement;
    // What never settles is drawn at the end of what was watched.
    let (um, ms) =
        (|error: f64| error * 1e6, |time: f64| time.min(application.motion.settle) * 1e3);
    let named = |index: usize| plan.candidates[index].name.replace('_', " ");
    let cross = |(index, tally): (usize, &Tally)| {
        let (peak, settling) = (tally.peak_error(), tally.settling_time());
        let ([x0, x1, x2], [y0, y1, y2]) = (
            [peak.q05, peak.q50, peak.q95].map(um),
            [settling.q05, settling.q50, settling.q95].map(ms),
        );
        FigureCurve {
            name: named(index),
            points: vec![(x0, y1), (x2, y1), (x1, y1), (x1, y0), (x1, y2)],
        }
    };
    let (x, y) = (um(requirement.peak_error), ms(requirement.settling_time));
    let required = |points: Vec<(f64, f64)>| {
        std::iter::once(FigureCurve { name: "required at most".to_owned(), points })
    };
    let distribution = |value: &dyn Fn(&Tally, f64) -> f64| -> Vec<FigureCurve> {
        let points = |tally: &Tally| {
            (1..=200)
                .map(|k| (value(tally, f64::from(k) / 200.0), f64::from(k) / 2.0))
                .collect::<Vec<_>>()
        };
        tallies
            .iter()
            .enumerate()
            .map(|(index, tally)| FigureCurve { name: named(index), points: points(tally) })
            .collect()
    };
    let settled = format!("settled to {} um after the arrival, ms", um(requirement.settling_band));
    let panel = |title: &str, x_label: &str, y_label: &str, curves: Vec<FigureCurve>| Panel {
        title: title.to_owned(),
        x_label: x_label.to_owned(),
        y_label: y_label.to_owned(),
        curves,
        reference: None,
    };
    let crosses = tallies
        .iter()
        .enumerate()
        .map(cross)
        .chain(required(vec![(0.0, y), (x, y), (x, 0.0)]))
        .collect();
    let peaks = distribution(&|tally, share| um(tally.peak_error_at(share)));
    let times = distribution(&|tally, share| ms(tally.settling_time_at(share)));
    let share = "share of the variants, %";
    let panels = [
        panel(
            "Medians with 5 % and 95 % quantiles; lower left is better",
            "peak error, um",
            &settled,
            crosses,
        ),
        panel(
            "Peak error",
            "peak error below, um",
            share,
            peaks.into_iter().chain(required(vec![(x, 0.0), (x, 100.0)])).collect(),
        ),
        panel(
            "Settling time",
            &settled,
            share,
            times.into_iter().chain(required(vec![(y, 0.0), (y, 100.0)])).collect(),
        ),
    ];
    svg(&application.name, &panels)
}
