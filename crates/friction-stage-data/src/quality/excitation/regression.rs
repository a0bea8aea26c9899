//! The force regressed on the motion, and one signal on another.

use nalgebra::{Matrix4, Vector4};

use super::motion::Moment;
use super::{Examiner, RoughFit};
use crate::signals::Signal;

impl RoughFit {
    /// Whether the mass is known well enough to say that a sign, a unit or the machine is another:
    /// where the acceleration explains less than the fit leaves, what the fit lacks passes for a
    /// mass.
    pub(super) fn knows_the_mass(&self) -> bool {
        self.mass_deviation < 0.1 * self.mass.abs()
            && self.by_acceleration_alone >= 1.0 - self.explained
    }
}

impl Examiner<'_> {
    /// The force of a column around a moment, with the weights that a second difference gives it.
    fn force_at(&self, column: &[f64], row: usize) -> f64 {
        let w = self.half as isize;
        let mut sum = 0.0;
        for offset in -w + 1..w {
            sum += (w - offset.abs()) as f64 * column[(row as isize + offset) as usize];
        }
        sum / (w * w) as f64
    }

    pub(super) fn regress(
        &self,
        signal: Signal,
        moments: &[Moment],
        rest_speed: f64,
    ) -> Option<RoughFit> {
        let column = self.column(signal);
        // clear of the bristles' own travel: twenty times the speed that still counts as rest
        let moving = || moments.iter().filter(|m| m.velocity.abs() > 20.0 * rest_speed);
        let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
        let (mut count, mut squares) = (0usize, 0.0);
        // scaled, so that the matrix is well conditioned
        let scale_a = moving().map(|m| m.acceleration.abs()).fold(f64::MIN_POSITIVE, f64::max);
        let scale_v = moving().map(|m| m.velocity.abs()).fold(f64::MIN_POSITIVE, f64::max);
        let row = |m: &Moment| {
            Vector4::new(m.acceleration / scale_a, m.velocity.signum(), m.velocity / scale_v, 1.0)
        };
        for moment in moving() {
            let force = self.force_at(column, moment.row);
            let row = row(moment);
            normal += row * row.transpose();
            right += row * force;
            squares += force * force;
            count += 1;
        }
        if count < 20 || squares == 0.0 {
            return None;
        }
        // one direction or one speed only: the least solution is taken, and told elsewhere
        let inverse = normal.pseudo_inverse(1e-9 * count as f64).ok()?;
        let fit = inverse * right;
        let (mut rest, mut inertial) = (0.0, 0.0);
        for moment in moving() {
            let difference = self.force_at(column, moment.row) - row(moment).dot(&fit);
            rest += difference * difference;
            inertial += (fit[0] * moment.acceleration / scale_a).powi(2);
        }
        let variance = rest / (count as f64 - 4.0);
        Some(RoughFit {
            mass: fit[0] / scale_a,
            mass_deviation: (variance * inverse[(0, 0)]).sqrt() / scale_a,
            coulomb: fit[1],
            viscous: fit[2] / scale_v,
            offset: fit[3],
            explained: 1.0 - rest / squares,
            inertial: inertial / squares,
            by_acceleration_alone: fit[0] * fit[0] / inverse[(0, 0)] / squares,
        })
    }

    /// Slope of one column over another, through zero after means are taken off, and how well it
    /// explains the first.
    pub(super) fn slope(&self, of: &[f64], over: impl Fn(usize) -> f64) -> Option<(f64, f64)> {
        let rows = || {
            let segments = self.segments.iter().cloned().flatten();
            segments
                .skip(1)
                .map(|row| (of[row], over(row)))
                .filter(|(y, x)| y.is_finite() && x.is_finite())
        };
        let count = rows().count() as f64;
        let (y0, x0) = rows().fold((0.0, 0.0), |(a, b), (y, x)| (a + y, b + x));
        let (y0, x0) = (y0 / count, x0 / count);
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for (y, x) in rows() {
            xx += (x - x0) * (x - x0);
            xy += (x - x0) * (y - y0);
            yy += (y - y0) * (y - y0);
        }
        (xx > 0.0 && yy > 0.0).then(|| (xy / xx, xy * xy / (xx * yy)))
    }
}
