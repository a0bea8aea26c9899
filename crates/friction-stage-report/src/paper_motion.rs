//! The position error along the motion of the paper, as its Figures 6 and 7.

use crate::chart::{Axis, Chart, Scale, Style};
use crate::figure::FigureError;
use crate::page::{Align, Cell, Page, Table};
use crate::words::PAPER_WITH_TITLE;
use friction_stage_core::model::JointType;
use friction_stage_lab::{MoveKind, PaperMotion, SETTLING_BANDS};

/// Times (ns after the start of the motion) and errors (m) of one run.
pub type PositionErrorSeries = Vec<(i64, f64)>;

/// Error over time after the start of the move, for the fast move and for the first fine step, and
/// its size on the way into the bands in which the paper counts as settled.
pub fn position_error_charts(
    motion: &PaperMotion,
    runs: &[(String, PositionErrorSeries)],
) -> Vec<Chart> {
    let moves = [
        (MoveKind::FastForward, "Fast move: 50 mm in 100 ms", 300_000_000),
        (MoveKind::FineStep, "Fine step: 10 µm in 3 ms", 200_000_000),
    ];
    let mut charts = Vec::new();
    for (kind, title, window) in moves {
        let Some(the_move) = motion.moves.iter().find(|the_move| the_move.kind == kind) else {
            continue;
        };
        let span = (the_move.start - window / 20)..=(the_move.start + window);
        let ms = |time: i64| (time - the_move.start) as f64 * 1e-6;
        let label = "time after the start of the move, ms";
        let mut error = Chart::new(title, label, "position error, µm");
        let mut size =
            Chart::new(format!("{title}: settling"), label, "largest error still to come, µm")
                .logarithmic(false, true);
        let (mut largest, mut settled, mut to_come) = (0.0f64, 0.0f64, Vec::new());
        for (colour, (name, errors)) in runs.iter().enumerate() {
            let within = || {
                let shown = errors.iter().filter(|(time, _)| span.contains(time));
                shown.map(|(time, error)| (ms(*time), error * 1e6))
            };
            largest = within().map(|point| point.1).fold(largest, f64::max);
            error.add(name, colour, Style::Line, within());
            let whole = the_move.start..=the_move.end.max(*span.end());
            let moving = errors.iter().filter(|(time, _)| whole.contains(time));
            let sizes = envelope(moving.map(|(time, e)| (ms(*time), e.abs() * 1e6)).collect());
            settled = settled.max(settled_at(&sizes).unwrap_or(0.0));
            to_come.push((colour, name, sizes));
        }
        // Until all have settled.
        let until = (1.1 * settled).max(ms(*span.end()));
        for (colour, name, sizes) in to_come {
            size.add(name, colour, Style::Line, sizes.into_iter().filter(|p| p.0 <= until));
        }
        let duration = (the_move.arrival - the_move.start) as f64;
        let reference = span.step_by(100_000).map(|time| {
            let u = ((time - the_move.start) as f64 / duration).clamp(0.0, 1.0);
            (ms(time), largest * u * u * u * (10.0 - 15.0 * u + 6.0 * u * u))
        });
        error.add("reference, scaled", 4, Style::Dashed, reference);
        size.line("arrival", Axis::X, ms(the_move.arrival));
        for band in SETTLING_BANDS {
            size.line(micrometres(band), Axis::Y, band * 1e6);
        }
        settling_bands(&mut error, JointType::Prismatic);
        charts.extend([error, size]);
    }
    charts
}

/// The bands in which the paper counts as settled, in a chart of errors in µm: those that can be
/// seen in it.
pub(crate) fn settling_bands(chart: &mut Chart, joint: JointType) {
    let points = chart.series.iter().flat_map(|series| &series.points);
    let largest = points.map(|point| point.1.abs()).fold(0.0, f64::max);
    for band in SETTLING_BANDS {
        let half = 1e6 * band;
        // Narrower ones would be no more than the line of the axis.
        if (0.02 * largest..largest).contains(&half) {
            chart.band(format!("within {}", joint.unit(&micrometres(band))), Axis::Y, -half, half);
        }
    }
}

/// A length as the paper gives its bands, without what a binary fraction adds.
pub(crate) fn micrometres(length: f64) -> String {
    format!("{} µm", (length * 1e9).round() / 1e3)
}

/// The largest error that is still to come: it falls to a band where the run has settled to it.
pub(crate) fn envelope(mut points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let mut largest = 0.0f64;
    for point in points.iter_mut().rev() {
        largest = largest.max(point.1.abs());
        point.1 = largest;
    }
    points
}

/// Where an envelope falls into the narrowest band for good; `None` where it does not.
pub(crate) fn settled_at(envelope: &[(f64, f64)]) -> Option<f64> {
    let narrowest = 1e6 * SETTLING_BANDS.iter().copied().fold(f64::INFINITY, f64::min);
    envelope.iter().find(|point| point.1 <= narrowest).map(|point| point.0)
}

/// What a chart of the position error shows.
pub(crate) fn caption(chart: &Chart) -> &'static str {
    match chart.y_scale == Scale::Log {
        false => {
            "Position error of the moves with the noise of the sensors, with the reference scaled \
             to it (Figures 6 and 7 of the MI-Partners paper)."
        }
        true => {
            "The largest error that is still to come: where it falls to a line, the stage has \
             settled to it."
        }
    }
}

/// Guide, move, peak error in µm, and times to settle into the bands in ms.
pub type DemoRow = (String, &'static str, f64, [Option<f64>; 3]);

/// The page of a demo: the charts, and a table of the moves.
pub fn demo_page(
    charts: &[Chart],
    rows: &[DemoRow],
    files: &[String],
) -> Result<String, FigureError> {
    let mut page = Page::new(
        "A 40 kg stage on four guides",
        format!(
            "friction-stage {} \u{b7} stage and controller as two ROS 2 nodes in lockstep",
            env!("CARGO_PKG_VERSION")
        ),
    );
    page.section("Which guide");
    page.text(
        "The same stage, motion and controller; only the guides differ. Which of them settles \
         first depends on the move and on the band.",
    );
    let mut table = Table::new(&[
        ("guide", Align::Left),
        ("move", Align::Left),
        ("peak error, µm", Align::Right),
        ("into 10 µm, ms", Align::Right),
        ("1 µm, ms", Align::Right),
        ("0.1 µm, ms", Align::Right),
    ]);
    for (guide, what, peak, settling) in rows {
        let [ten, one, tenth] = settling.map(|time| match time {
            Some(ms) => Cell::number(ms, 1),
            None => Cell::text("never"),
        });
        let cells = [Cell::text(guide), Cell::text(*what), Cell::number(*peak, 2), ten, one, tenth];
        table.row(cells);
    }
    page.table(&table.captioned("Time to settle: after the arrival of the reference."));
    page.section("Position error");
    for chart in charts {
        page.figure(chart, caption(chart))?;
    }
    page.section("Recordings");
    page.text(&format!("Stage, guides and moves: {PAPER_WITH_TITLE}."));
    page.text("Each bag holds its model, seed and rates; friction-stage replay BAG repeats it.");
    page.list(files);
    Ok(page.finish())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reference_starts_at_no_error_and_the_envelope_tells_when_it_has_settled() {
        let motion = PaperMotion::new(1.0, 1);
        let start =
            motion.moves.iter().find(|one| one.kind == MoveKind::FastForward).unwrap().start;
        let run: PositionErrorSeries = (-100..9000)
            .map(|k| (start + k * 100_000, 30e-6 * (-0.001 * k as f64).exp()))
            .collect();
        let charts = position_error_charts(&motion, &[("guide 1".to_owned(), run)]);
        let reference = charts[0].series.last().unwrap();
        assert!(reference.points.iter().filter(|p| p.0 <= 0.0).all(|p| p.1 == 0.0));
        let size = &charts[1].series[0].points;
        assert!(size.windows(2).all(|two| two[1].1 <= two[0].1));
        let settled = size.iter().find(|point| point.1 <= 10.0).unwrap().0;
        assert!((settled - 109.9).abs() < 0.2, "{settled}");
        // To the narrowest band it takes longer than the chart of the error is.
        let last = size.last().unwrap();
        assert!(last.1 < 0.1 && last.0 > 570.0, "{last:?}");
        assert!(charts[0].series[0].points.last().unwrap().0 <= 300.0);
        let settled = settled_at(size).unwrap();
        assert!((settled - 570.4).abs() < 0.2, "{settled}");
        assert_eq!(settled_at(&[(0.0, 3.0), (1.0, 2.0)]), None);
    }
}
