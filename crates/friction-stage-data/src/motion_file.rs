//! A motion in a file: a `trajectory_msgs/JointTrajectory` in YAML, as `ros2 topic pub` takes it.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::bag::topics;
use crate::message::{self, JointTrajectory, JointTrajectoryPoint};
use crate::wire::{Setpoint, SetpointError, setpoint};
use friction_stage_core::control::Point;
use friction_stage_core::{text_file, yaml};

/// A motion file that cannot be read or played.
#[derive(Debug, thiserror::Error)]
pub enum MotionFileError {
    /// It cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        source: std::io::Error,
    },
    /// It holds something else.
    #[error("{origin} is no motion: {reason}")]
    NoMotion {
        /// The file.
        origin: String,
        /// What is wrong.
        reason: String,
    },
    /// No factor for its time.
    #[error("{factor} must be between {least} and {most}")]
    Stretch {
        /// The factor.
        factor: f64,
        /// Smallest one.
        least: f64,
        /// Largest one.
        most: f64,
    },
    /// The nodes would refuse it.
    #[error("{origin} is no motion: {source}")]
    Refused {
        /// The file.
        origin: String,
        /// Why.
        source: SetpointError,
    },
}

/// What a file leaves out is empty or 0, as `ros2 topic pub` has it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    /// When to start is said by whoever plays it.
    #[serde(default, rename = "header")]
    _header: serde::de::IgnoredAny,
    joint_names: Vec<String>,
    points: Vec<FilePoint>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FilePoint {
    positions: Vec<f64>,
    #[serde(default)]
    velocities: Vec<f64>,
    #[serde(default)]
    accelerations: Vec<f64>,
    #[serde(default)]
    effort: Vec<f64>,
    #[serde(default)]
    time_from_start: FileDuration,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct FileDuration {
    sec: i32,
    nanosec: u32,
}

/// The points of a motion file, checked as the nodes check them.
pub fn load(path: &Path) -> Result<Vec<Point>, MotionFileError> {
    let text = text_file::read(path)
        .map_err(|source| MotionFileError::Read { path: path.to_owned(), source })?;
    from_yaml(&text, &path.display().to_string())
}

/// The points of a motion in YAML; `origin` names the text in errors.
pub fn from_yaml(text: &str, origin: &str) -> Result<Vec<Point>, MotionFileError> {
    let no_motion =
        |reason: String| MotionFileError::NoMotion { origin: origin.to_owned(), reason };
    let file: File = yaml::read(text).map_err(no_motion)?;
    let points = file
        .points
        .into_iter()
        .map(|point| JointTrajectoryPoint {
            positions: point.positions,
            velocities: point.velocities,
            accelerations: point.accelerations,
            effort: point.effort,
            time_from_start: message::Duration {
                sec: point.time_from_start.sec,
                nanosec: point.time_from_start.nanosec,
            },
        })
        .collect();
    let message =
        JointTrajectory { joint_names: file.joint_names, points, ..JointTrajectory::default() };
    let refused = |source| MotionFileError::Refused { origin: origin.to_owned(), source };
    match setpoint(&message, topics::JOINT, 0).map_err(refused)? {
        Setpoint::Motion(motion) => Ok(motion.points().to_vec()),
        Setpoint::Now(_) => Err(no_motion(
            "one point without a time_from_start is a setpoint and no motion".to_owned(),
        )),
    }
}

/// Largest factor that is not a slip.
const LARGEST_STRETCH: f64 = 1000.0;

/// Refuses a factor for [`stretched`] that is a slip.
pub fn check_stretch(factor: f64) -> Result<(), MotionFileError> {
    if (LARGEST_STRETCH.recip()..=LARGEST_STRETCH).contains(&factor) {
        return Ok(());
    }
    Err(MotionFileError::Stretch { factor, least: LARGEST_STRETCH.recip(), most: LARGEST_STRETCH })
}

/// The same way in `factor` times the time.
pub fn stretched(points: &[Point], factor: f64) -> Vec<Point> {
    points
        .iter()
        .map(|point| Point {
            time: (point.time as f64 * factor).round() as i64,
            velocity: point.velocity.map(|velocity| velocity / factor),
            acceleration: point.acceleration.map(|acceleration| acceleration / (factor * factor)),
            ..*point
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_no_motion_is_refused_with_the_reason() {
        for (text, words) in [
            ("joint_names: [stage]\npoints: []", "no points"),
            (
                "joint_names: [slider]\npoints: [{positions: [0.1], time_from_start: {sec: 1}}]",
                "no joint `stage` among [slider]",
            ),
            ("joint_names: [stage]\npoints: [{position: [0.1]}]", "position"),
            ("joint_names: [stage]\npoints: [{positions: [0.1]}]", "setpoint and no motion"),
            (
                "joint_names: [stage]\npoints: [{positions: [0.1, 0.2], time_from_start: {sec: \
                 1}}]",
                "2 positions for 1 joints",
            ),
            (
                "joint_names: [stage]\npoints: [{positions: [.nan], time_from_start: {sec: 1}}]",
                "finite",
            ),
        ] {
            let reported = from_yaml(text, "a.yaml").unwrap_err().to_string();
            assert!(
                reported.contains("a.yaml is no motion") && reported.contains(words),
                "{reported:?}"
            );
        }
    }
}
