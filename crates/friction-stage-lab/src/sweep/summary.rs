//! What a whole sweep says: quantiles over its points, the best and the worst of them.

use serde::Serialize;

use super::{SweepPlan, SweepRows, SweepValue};
use crate::motion_quality::MotionQuality;
use crate::rows::RowsError;

/// Points that a summary lists at most; all of them are in the rows.
const LISTED: usize = 1000;

/// The summary of a sweep, `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct SweepSummary {
    /// Version of the format.
    pub schema_version: u32,
    /// Name of the stage.
    pub stage: String,
    /// Of draws and noise.
    pub seed: u64,
    /// Points in the rows.
    pub points: u64,
    /// Those that could not be computed.
    pub failed: u64,
    /// Why the first of them could not.
    pub first_failure: Option<String>,
    /// Points in which the force reached a limit.
    pub saturated: u64,
    /// What was swept.
    pub axes: Vec<AxisSummary>,
    /// m
    pub peak_error: Option<SweepQuantiles>,
    /// m
    pub rms_error: Option<SweepQuantiles>,
    /// Into 10 µm, 1 µm and 0.1 µm, s; infinite (null in JSON) among those that never settled.
    pub settling: [Option<SweepQuantiles>; 3],
    /// The point with the smallest peak error.
    pub best: Option<PointSummary>,
    /// The point with the largest peak error.
    pub worst: Option<PointSummary>,
    /// The points in their order, as many as are listed.
    pub rows: Vec<PointSummary>,
    /// Whether all points are among them.
    pub all_rows: bool,
}

/// An axis.
#[derive(Clone, Debug, Serialize)]
pub struct AxisSummary {
    /// Its key.
    pub key: String,
    /// Values on the grid; 1 of a distribution.
    pub count: u64,
    /// Whether its values are drawn.
    pub drawn: bool,
}

/// Quantiles over the points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SweepQuantiles {
    /// 5 %
    pub q05: f64,
    /// Median.
    pub q50: f64,
    /// 95 %
    pub q95: f64,
}

/// One point.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PointSummary {
    /// Its number.
    pub point: u64,
    /// Values of the axes.
    pub values: Vec<SweepValue>,
    /// How well the motion was followed.
    pub result: Option<MotionQuality>,
    /// Why it could not be.
    pub failure: Option<String>,
}

/// Takes each point with its number.
type EachPoint<'a> = dyn FnMut(u64, super::SweepOutcome) -> Result<(), RowsError> + 'a;

/// The quantiles of values: the smallest value that so many are not above.
fn quantiles(mut values: Vec<f64>) -> Option<SweepQuantiles> {
    values.sort_by(f64::total_cmp);
    let at = |part: f64| {
        let rank = (part * values.len() as f64).ceil() as usize;
        values.get(rank.saturating_sub(1)).copied()
    };
    Some(SweepQuantiles { q05: at(0.05)?, q50: at(0.5)?, q95: at(0.95)? })
}

impl SweepSummary {
    /// The summary of all outcomes, each with its number, in their order.
    fn of(
        plan: &SweepPlan,
        read: impl FnOnce(&mut EachPoint<'_>) -> Result<(), RowsError>,
    ) -> Result<SweepSummary, RowsError> {
        let (mut peaks, mut rms) = (Vec::new(), Vec::new());
        let mut settling: [Vec<f64>; 3] = Default::default();
        let (mut points, mut failed, mut saturated) = (0, 0, 0);
        let mut first_failure = None;
        let (mut best, mut worst): (Option<PointSummary>, Option<PointSummary>) = (None, None);
        let mut rows = Vec::new();
        read(&mut |point, outcome| {
            points += 1;
            let (result, failure) = match outcome {
                Ok(result) => (Some(result), None),
                Err(reason) => (None, Some(reason)),
            };
            if let Some(found) = result {
                peaks.push(found.peak_error);
                rms.push(found.rms_error);
                for (all, time) in settling.iter_mut().zip(found.settling) {
                    all.push(time.unwrap_or(f64::INFINITY));
                }
                saturated += u64::from(found.saturated > 0);
            }
            failed += u64::from(failure.is_some());
            let summary = || PointSummary {
                point,
                values: plan.values(point),
                result,
                failure: failure.clone(),
            };
            if failure.is_some() && first_failure.is_none() {
                let values = plan.axes.iter().zip(plan.values(point));
                let values: Vec<String> =
                    values.map(|(axis, value)| format!("{} {value}", axis.key)).collect();
                let reason = failure.as_deref().unwrap_or_default();
                first_failure = Some(format!("{reason} (at {})", values.join(", ")));
            }
            let peak = |of: &Option<PointSummary>| {
                of.as_ref().and_then(|point| point.result).map(|found| found.peak_error)
            };
            if let Some(found) = result {
                if peak(&best).is_none_or(|least| found.peak_error < least) {
                    best = Some(summary());
                }
                if peak(&worst).is_none_or(|most| found.peak_error > most) {
                    worst = Some(summary());
                }
            }
            if rows.len() < LISTED {
                rows.push(summary());
            }
            Ok(())
        })?;
        Ok(SweepSummary {
            schema_version: 1,
            stage: plan.model.name.clone(),
            seed: plan.seed,
            points,
            failed,
            first_failure,
            saturated,
            axes: plan
                .axes
                .iter()
                .map(|axis| AxisSummary {
                    key: axis.key.clone(),
                    count: axis.count(),
                    drawn: axis.is_drawn(),
                })
                .collect(),
            peak_error: quantiles(peaks),
            rms_error: quantiles(rms),
            settling: settling.map(quantiles),
            best,
            worst,
            all_rows: rows.len() as u64 == points,
            rows,
        })
    }

    /// The summary of the rows of a directory.
    pub fn of_rows(rows: &SweepRows) -> Result<SweepSummary, RowsError> {
        SweepSummary::of(&rows.sheet().plan, |each| rows.read(each))
    }

    /// The summary of outcomes in memory, each with the number of its point.
    pub fn of_outcomes(
        plan: &SweepPlan,
        mut outcomes: impl Iterator<Item = (u64, super::SweepOutcome)>,
    ) -> Result<SweepSummary, RowsError> {
        SweepSummary::of(plan, |each| {
            outcomes.try_for_each(|(point, outcome)| each(point, outcome))
        })
    }
}
