//! The position error along the motion of the paper, as its Figures 6 and 7.

use crate::figure::{FigureCurve, FigureError, Panel, svg};
use friction_stage_lab::{MoveKind, PaperMotion};

/// Times (ns after the start of the motion) and errors (m) of one run.
pub type PositionErrorSeries = Vec<(i64, f64)>;

/// Error over time after the start of the move, with the reference dashed, for the fast move and
/// for the first fine step.
pub fn position_error_figure(
    title: &str,
    motion: &PaperMotion,
    runs: &[(String, PositionErrorSeries)],
) -> Result<String, FigureError> {
    let panels: Vec<Panel> = [
        (
            MoveKind::FastForward,
            "Fast move: 50 mm in 100 ms (dashed: reference, scaled)",
            300_000_000,
        ),
        (MoveKind::FineStep, "Fine step: 10 um in 3 ms (dashed: reference, scaled)", 200_000_000),
    ]
    .into_iter()
    .filter_map(|(kind, title, window)| {
        let the_move = motion.moves.iter().find(|the_move| the_move.kind == kind)?;
        let span = (the_move.start - window / 20)..=(the_move.start + window);
        let ms = |time: i64| (time - the_move.start) as f64 * 1e-6;
        let curve = |(name, errors): &(String, PositionErrorSeries)| FigureCurve {
            name: name.clone(),
            points: errors
                .iter()
                .filter(|(time, _)| span.contains(time))
                .map(|(time, error)| (ms(*time), error * 1e6))
                .collect(),
        };
        let duration = (the_move.arrival - the_move.start) as f64;
        let reference = span.clone().step_by(100_000).map(|time| {
            let u = ((time - the_move.start) as f64 / duration).clamp(0.0, 1.0);
            (ms(time), u * u * u * (10.0 - 15.0 * u + 6.0 * u * u))
        });
        Some(Panel {
            title: title.to_owned(),
            x_label: "time after the start of the move, ms".to_owned(),
            y_label: "position error, um".to_owned(),
            curves: runs.iter().map(curve).collect(),
            reference: Some(FigureCurve {
                name: "reference, scaled".to_owned(),
                points: reference.collect(),
            }),
        })
    })
    .collect();
    svg(title, &panels)
}
