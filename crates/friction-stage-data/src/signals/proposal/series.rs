//! How the values of a column go on from row to row.

/// Most captures that a column counts.
const MOST_CAPTURES: usize = 1000;

pub(super) fn steps(values: &[f64]) -> impl Iterator<Item = f64> + '_ {
    values.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| step.is_finite())
}

/// Median of the steps; none for less than two values.
pub(super) fn usual_step(values: &[f64]) -> Option<f64> {
    let mut steps: Vec<f64> = steps(values).collect();
    let middle = steps.len() / 2;
    (!steps.is_empty()).then(|| *steps.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Whether values hardly ever fall, and rise.
pub(super) fn increases(values: &[f64]) -> bool {
    let falling = steps(values).filter(|step| *step < 0.0).count();
    usual_step(values).is_some_and(|step| step > 0.0) && falling * 20 <= values.len()
}

/// Whether values hardly ever rise, and fall.
pub(super) fn falls(values: &[f64]) -> bool {
    let rising = steps(values).filter(|step| *step > 0.0).count();
    usual_step(values).is_some_and(|step| step < 0.0) && rising * 20 <= values.len()
}

pub(super) fn is_uniform(values: &[f64]) -> bool {
    let Some(usual) = usual_step(values) else { return false };
    let alike = steps(values).filter(|step| (step / usual - 1.0).abs() < 0.1).count();
    alike * 10 >= 9 * (values.len() - 1)
}

/// Whether values move as a position does: from row to row they go on as before.
pub(super) fn is_smooth(values: &[f64]) -> bool {
    roughness(values) < 0.1
}

/// How much the steps from row to row change, as part of how large they are, of squares.
pub(super) fn roughness(values: &[f64]) -> f64 {
    let steps: Vec<f64> = steps(values).collect();
    let size = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>();
    let changes = size(&mut steps.windows(2).map(|pair| pair[1] - pair[0]));
    let moves = size(&mut steps.iter().copied());
    changes / moves
}

/// Whether values count rows: each is one more than that before it.
pub(super) fn counts_rows(values: &[f64]) -> bool {
    steps(values).next().is_some() && steps(values).all(|step| step == 1.0)
}

/// How many captures a column counts, if it counts any: different whole numbers.
pub(super) fn captures(values: &[f64]) -> Option<usize> {
    let mut seen: Vec<i64> = Vec::new();
    for value in values.iter().filter(|value| value.is_finite()) {
        let whole = *value as i64;
        if whole as f64 != *value || seen.len() > MOST_CAPTURES {
            return None;
        }
        if !seen.contains(&whole) {
            seen.push(whole);
        }
    }
    Some(seen.len())
}
