//! Records of one rate joined into one, for a fit over all of them.

use friction_stage_core::model::StageModel;
use friction_stage_data::signals::Trace;

use crate::error::IdentifyError;
use crate::record::measured::forgetting_length;

/// Joins records of one rate into one, for a fit over all of them. Between two of them half a
/// second is left out, and of each but the first the forces until the guides have slid far enough
/// to have forgotten what they held: rows without a force are not compared. Time runs on.
pub fn joined(traces: &[&Trace], model: &StageModel) -> Result<Trace, IdentifyError> {
    let mut all = Trace::default();
    let Some(first) = traces.first() else { return Ok(all) };
    let step = first.step();
    let forgotten = forgetting_length(&model.resolved_guides()?);
    for (index, trace) in traces.iter().enumerate() {
        let own = trace.step();
        if (own / step - 1.0).abs() > 1e-5 {
            return Err(IdentifyError::Rates { first: step.recip(), other: own.recip() });
        }
        if index == 0 {
            all = (*trace).clone();
            continue;
        }
        let from = all.len();
        let gap = (0.5 / step).ceil() as usize;
        let anchor = trace.position.iter().copied().find(|x| x.is_finite()).unwrap_or(0.0);
        let slid = trace
            .position
            .iter()
            .position(|x| (x - anchor).abs() > forgotten)
            .unwrap_or(trace.len());
        for (column, add) in [
            (&mut all.position, &trace.position),
            (&mut all.reference_position, &trace.reference_position),
            (&mut all.reference_velocity, &trace.reference_velocity),
            (&mut all.reference_acceleration, &trace.reference_acceleration),
            (&mut all.force_cell, &trace.force_cell),
            (&mut all.force, &trace.force),
        ] {
            column.extend(std::iter::repeat_n(f64::NAN, gap));
            column.extend_from_slice(add);
        }
        all.force[from + gap..from + gap + slid].fill(f64::NAN);
        all.force_cell[from + gap..from + gap + slid].fill(f64::NAN);
        all.time = (0..from + gap + trace.len()).map(|row| row as f64 * step).collect();
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::measured::Measured;
    use crate::test_records::recording;

    #[test]
    fn joined_records_leave_out_what_no_record_knows() {
        let model = StageModel::default();
        let (a, b) = (recording(&model, 3, 0.0, 2), recording(&model, 4, 0.0, 2));
        let all = joined(&[&a, &b], &model).unwrap();
        assert_eq!(all.len(), 2 * 6000 + 1000);
        assert!(all.position[6000..7000].iter().all(|x| x.is_nan()) && all.force[6999].is_nan());
        assert_eq!(all.force[12_000], b.force[5000]);
        let measured = Measured::new(&all, &model, "two").unwrap();
        let length = forgetting_length(&model.resolved_guides().unwrap());
        let slid =
            7000 + b.position.iter().position(|x| (x - b.position[0]).abs() > length).unwrap();
        let left_out = measured.rows.windows(2).find(|pair| pair[1] > 7000).unwrap();
        assert!(left_out[0] < 6000 && left_out[1] >= slid, "{left_out:?}, slid at {slid}");
        assert!(left_out[1] < slid + 100, "{left_out:?}, slid at {slid}");
        assert!((all.time[12_999] - 12_999.0 / 2000.0).abs() < 1e-9);
        let mut slow = b;
        slow.time.iter_mut().for_each(|time| *time *= 2.0);
        assert!(matches!(joined(&[&a, &slow], &model), Err(IdentifyError::Rates { .. })));
    }
}
