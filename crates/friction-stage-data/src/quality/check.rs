//! Says what messages a recording holds and what is wrong with them: per topic rate, gaps and bad
//! values.
//!
//! One pass over all messages, in bounded memory: intervals between stamps are kept as counts, to
//! four digits.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::finding::FileFinding;
use super::log_times::LogTimes;
use crate::bag::{BagError, BagMessage, BagReader, Damage, Places, topics};
use crate::message::*;
use crate::signals::{Mapping, SignalError, visit_rows};

/// An interval of more than this many usual ones is a gap.
const GAP: f64 = 1.5;
/// Share of the intervals, the longest ones, that say nothing of whether messages come at a rate or
/// in bursts, and at least one: a recording may be interrupted, and a burst of more than a hundred
/// messages is a time in which they come at a rate.
const INTERRUPTIONS: f64 = 0.01;
/// Root mean square of the distance of intervals from the usual (median) one, in usual ones, where
/// messages of a fixed rate are lost at random, each with a probability of one half: sqrt(3). It is
/// the most that a loss can do, since with a larger one the usual interval is a longer one.
/// Independent events have sqrt(1 + (1 - ln 2)^2) / ln 2 = 1.51. Intervals that scatter by more are
/// those of messages that come in bursts.
const SCATTER_OF_LOSSES: f64 = 1.732_050_807_568_877_2;

/// One topic of a checked recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TopicCheck {
    /// Name of the topic.
    pub name: String,
    /// Its type.
    pub type_name: String,
    /// Messages read.
    pub messages: u64,
    /// Whether times are those in the headers; else log times.
    pub by_stamp: bool,
    /// Messages per second: one over the usual (median) interval. None where there is no usual one.
    pub rate_hz: Option<f64>,
    /// Whether messages come in bursts, so that they have no rate: their intervals scatter about
    /// the usual one by more than the loss of every other message at random explains.
    pub in_bursts: bool,
    /// Standard deviation of the intervals that are no gaps, s.
    pub jitter_s: Option<f64>,
    /// Intervals of more than 1.5 usual ones.
    pub gaps: u64,
    /// The usual (median) interval, s; 0 where there is none.
    #[serde(skip)]
    pub usual_s: f64,
    /// The longest interval, s.
    pub longest_gap_s: Option<f64>,
    /// Stamps equal to the one before.
    pub repeated_stamps: u64,
    /// Stamps before the one before.
    pub backward_stamps: u64,
    /// Values that are NaN or infinite.
    pub non_finite: u64,
    /// Messages that do not decode as their type.
    pub decode_failures: u64,
    /// Whether this program knows the type, so that values were looked at.
    pub decoded: bool,
}

/// What a recording holds and what is wrong with it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckReport {
    /// The recording.
    pub path: PathBuf,
    /// Bytes of its data files.
    pub bytes: u64,
    /// Messages read.
    pub messages: u64,
    /// Last minus first log time, s.
    pub duration_s: f64,
    /// Whether it ends as it should.
    pub complete: bool,
    /// Whether it says which model, seed, version and arguments made it.
    pub has_provenance: bool,
    /// Joint names in it.
    pub joints: Vec<String>,
    /// Per topic.
    pub topics: Vec<TopicCheck>,
    /// Places in the files that are not as they should be.
    pub damage: Vec<Damage>,
    /// What is wrong with it.
    pub findings: Vec<FileFinding>,
}

/// Samples between two words of progress.
const TOLD_EVERY: u64 = 100_000;

/// The times of all rows of a table, in bounded memory. `progress` gets the rows read so far.
pub(super) fn check_rows(
    path: &Path,
    mapping: &Mapping,
    progress: &mut dyn FnMut(u64),
) -> Result<TopicCheck, SignalError> {
    let mut watch = Watch::new("rows", "table");
    watch.report.by_stamp = true;
    visit_rows(path, mapping, &mut |stamp, values| {
        watch.report.messages += 1;
        watch.report.non_finite += values.iter().filter(|value| !value.is_finite()).count() as u64;
        if let Some(stamp) = stamp {
            watch.at(stamp);
        }
        if watch.report.messages.is_multiple_of(TOLD_EVERY) {
            progress(watch.report.messages);
        }
    })?;
    Ok(watch.finish())
}

/// Checks a rosbag2 directory or one of its files. An error means that nothing of it can be read;
/// everything else that is wrong is in the report.
pub fn check(path: &Path) -> Result<CheckReport, BagError> {
    check_messages(path, &mut |_| {})
}

/// As [`check`]; `progress` gets the messages read so far.
pub(super) fn check_messages(
    path: &Path,
    progress: &mut dyn FnMut(u64),
) -> Result<CheckReport, BagError> {
    let reader = BagReader::open(path)?;
    let mut topics: Vec<Watch> =
        reader.topics().iter().map(|t| Watch::new(&t.name, &t.type_name)).collect();
    let mut damage = reader.damage();
    damage.extend(reader.verify_checksums()?);
    let mut damage = Places::new(damage);
    let places = reader.places();
    let mut log_times = LogTimes::default();
    let mut joints = BTreeSet::new();
    let mut range: Option<(u64, u64)> = None;
    let mut count = 0;
    for message in reader.messages() {
        let message = match message {
            Ok(message) => message,
            Err(BagError::Broken { path, offset, expected, found }) => {
                let place = Damage { bytes: 0, path, offset, expected, found };
                damage.note(place, |place| reader.span_length(&place.path, place.offset));
                continue;
            }
            Err(error) => return Err(error),
        };
        count += 1;
        if u64::is_multiple_of(count, TOLD_EVERY) {
            progress(count);
        }
        range = Some(match range {
            None => (message.log_time, message.log_time),
            Some((first, last)) => (first.min(message.log_time), last.max(message.log_time)),
        });
        if let Some(place) = places.get(message.topic.name.as_str())
            && let Some(stamp) = topics[*place].take(&message, &mut joints)
        {
            let log_time = i64::try_from(message.log_time).unwrap_or(i64::MAX);
            log_times.take(*place, log_time, stamp);
        }
    }
    let damage = damage.into_list();
    let topics: Vec<TopicCheck> = topics.into_iter().map(Watch::finish).collect();
    let complete = reader.is_complete();
    let mut findings = Vec::new();
    if !complete {
        findings.push(FileFinding::Incomplete);
    } else if !damage.is_empty() {
        findings.push(FileFinding::Damaged);
    }
    match reader.declared_count() {
        Some(declared) if declared != count => {
            findings.push(FileFinding::MessageCount { declared, read: count });
        }
        None if path.is_dir() && !reader.has_metadata() => findings.push(FileFinding::NoMetadata),
        _ => {}
    }
    let untold = reader.topics().iter().filter(|topic| {
        topic.messages > 0 && (topic.type_name.is_empty() || !topic.fitting_types.is_empty())
    });
    findings.extend(untold.map(|topic| FileFinding::TypeByMessages {
        topic: topic.name.clone(),
        fitting: topic.fitting_types.clone(),
        type_name: topic.type_name.clone(),
    }));
    findings.extend(topics.iter().flat_map(TopicCheck::findings));
    findings.extend(log_times.finish().into_iter().map(|misfit| FileFinding::LogTimes {
        topic: topics[misfit.topic].name.clone(),
        messages: misfit.messages,
        seconds: misfit.seconds,
    }));
    Ok(CheckReport {
        path: path.to_owned(),
        bytes: reader.size(),
        messages: count,
        duration_s: range.map_or(0.0, |(first, last)| (last - first) as f64 * 1e-9),
        complete,
        has_provenance: reader.provenance().is_some(),
        joints: joints.into_iter().collect(),
        topics,
        damage,
        findings,
    })
}

/// What one message says about itself.
struct Facts {
    stamp: Option<i64>,
    non_finite: u64,
}

impl Facts {
    fn new(stamp: Option<Time>) -> Self {
        Self { stamp: stamp.map(Time::to_nanos), non_finite: 0 }
    }

    fn values(mut self, values: &[f64]) -> Self {
        self.non_finite += values.iter().filter(|v| !v.is_finite()).count() as u64;
        self
    }
}

/// Most joints that are listed.
const JOINTS: usize = 1000;

fn note_joints(joints: &mut BTreeSet<String>, names: &[String]) {
    for name in names {
        if joints.len() < JOINTS && !joints.contains(name) {
            joints.insert(name.clone());
        }
    }
}

/// Looks into a message; `None` if the type is not one of ours.
fn facts(message: &BagMessage, joints: &mut BTreeSet<String>) -> Option<Result<Facts, CdrError>> {
    fn decode<M: RosMessage>(
        message: &BagMessage,
        facts: impl FnOnce(M) -> Facts,
    ) -> Option<Result<Facts, CdrError>> {
        Some(from_cdr::<M>(message).map(facts))
    }
    match current_type_name(&message.topic.type_name).as_ref() {
        "sensor_msgs/msg/JointState" => decode(message, |m: JointState| {
            note_joints(joints, &m.name);
            // The clock of topic hardware is its own.
            let stamp =
                (!message.topic.name.ends_with(topics::JOINT_COMMANDS)).then_some(m.header.stamp);
            Facts::new(stamp).values(&m.position).values(&m.velocity).values(&m.effort)
        }),
        "geometry_msgs/msg/WrenchStamped" => decode(message, |m: WrenchStamped| {
            let (f, t) = (m.wrench.force, m.wrench.torque);
            Facts::new(Some(m.header.stamp)).values(&[f.x, f.y, f.z, t.x, t.y, t.z])
        }),
        "trajectory_msgs/msg/JointTrajectory" => decode(message, |m: JointTrajectory| {
            note_joints(joints, &m.joint_names);
            // Its stamp says when it begins, not when it was sent.
            m.points.iter().fold(Facts::new(None), |facts, p| {
                facts
                    .values(&p.positions)
                    .values(&p.velocities)
                    .values(&p.accelerations)
                    .values(&p.effort)
            })
        }),
        "std_msgs/msg/Float64MultiArray" => {
            decode(message, |m: Float64MultiArray| Facts::new(None).values(&m.data))
        }
        "rosgraph_msgs/msg/Clock" => decode(message, |m: Clock| Facts::new(Some(m.clock))),
        "diagnostic_msgs/msg/DiagnosticArray" => {
            decode(message, |m: DiagnosticArray| Facts::new(Some(m.header.stamp)))
        }
        "friction_stage_msgs/msg/StageState" => decode(message, |m: StageState| {
            Facts::new(Some(m.header.stamp))
                .values(&[m.position, m.velocity, m.acceleration, m.motor_force])
                .values(&m.bristle_deflection)
                .values(&m.guide_force)
                .values(&m.effect_force)
        }),
        "friction_stage_msgs/msg/ControllerState" => decode(message, |m: ControllerState| {
            Facts::new(Some(m.header.stamp)).values(&[
                m.reference_position,
                m.reference_velocity,
                m.reference_acceleration,
                m.position,
                m.error,
                m.proportional,
                m.integral,
                m.derivative,
                m.feedback,
                m.mass_feedforward,
                m.viscous_feedforward,
                m.effort,
                m.output,
                m.bristles_feedforward,
                m.forces_feedforward,
                m.motor_feedforward,
                m.disturbance,
            ])
        }),
        _ => None,
    }
}

/// Gathers the figures of one topic.
struct Watch {
    report: TopicCheck,
    last: Option<i64>,
    /// Intervals, ns, to four digits, and how many of each.
    intervals: BTreeMap<u64, u64>,
}

impl Watch {
    fn new(name: &str, type_name: &str) -> Self {
        Self {
            report: TopicCheck {
                name: name.into(),
                type_name: type_name.into(),
                messages: 0,
                by_stamp: false,
                rate_hz: None,
                in_bursts: false,
                jitter_s: None,
                gaps: 0,
                usual_s: 0.0,
                longest_gap_s: None,
                repeated_stamps: 0,
                backward_stamps: 0,
                non_finite: 0,
                decode_failures: 0,
                decoded: true,
            },
            last: None,
            intervals: BTreeMap::new(),
        }
    }

    /// Takes a message; its stamp, ns, if it has one.
    fn take(&mut self, message: &BagMessage, joints: &mut BTreeSet<String>) -> Option<i64> {
        let report = &mut self.report;
        report.messages += 1;
        let facts = match facts(message, joints) {
            None => {
                report.decoded = false;
                Facts::new(None)
            }
            Some(Ok(facts)) => facts,
            Some(Err(_)) => {
                report.decode_failures += 1;
                return None;
            }
        };
        report.non_finite += facts.non_finite;
        report.by_stamp = facts.stamp.is_some();
        self.at(facts.stamp.unwrap_or_else(|| i64::try_from(message.log_time).unwrap_or(i64::MAX)));
        facts.stamp
    }

    /// Takes the time of a message, ns.
    fn at(&mut self, time: i64) {
        if let Some(last) = self.last {
            match time.saturating_sub(last) {
                0 => self.report.repeated_stamps += 1,
                step if step < 0 => self.report.backward_stamps += 1,
                step => *self.intervals.entry(four_digits(step as u64)).or_insert(0) += 1,
            }
        }
        self.last = Some(time);
    }

    fn finish(self) -> TopicCheck {
        let mut report = self.report;
        let total: u64 = self.intervals.values().sum();
        let mut seen = 0;
        let median = self.intervals.iter().find_map(|(&interval, &count)| {
            seen += count;
            (2 * seen >= total).then_some(interval as f64 * 1e-9)
        });
        let Some(median) = median else {
            return report;
        };
        report.usual_s = median;
        report.in_bursts = scatter(&self.intervals, median * 1e9) > SCATTER_OF_LOSSES;
        report.longest_gap_s = self.intervals.keys().next_back().map(|&i| i as f64 * 1e-9);
        let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for (&interval, &count) in &self.intervals {
            let (interval, count_f) = (interval as f64 * 1e-9, count as f64);
            if interval > GAP * median {
                report.gaps += count;
            } else {
                let off = interval - median;
                n += count_f;
                sum += count_f * off;
                squares += count_f * off * off;
            }
        }
        if report.in_bursts {
            // Between bursts is no gap, unless the topic is to have none.
            if is_occasional(&report.name) {
                report.gaps = 0;
            }
            return report;
        }
        report.rate_hz = Some(1.0 / median);
        let mean = sum / n;
        report.jitter_s = Some((squares / n - mean * mean).max(0.0).sqrt());
        report
    }
}

/// Root mean square of the distance of the intervals from the usual one, in usual ones, without
/// [`INTERRUPTIONS`].
fn scatter(intervals: &BTreeMap<u64, u64>, usual: f64) -> f64 {
    let total: u64 = intervals.values().sum();
    let kept = total - ((INTERRUPTIONS * total as f64) as u64).max(1);
    let (mut left, mut squares) = (kept, 0.0);
    for (&interval, &count) in intervals {
        let count = count.min(left);
        left -= count;
        squares += count as f64 * (interval as f64 / usual - 1.0).powi(2);
    }
    if kept == 0 { 0.0 } else { (squares / kept as f64).sqrt() }
}

/// Rounds to four significant digits, so that the number of different intervals stays small.
fn four_digits(value: u64) -> u64 {
    let scale = 10u64.pow(value.checked_ilog10().unwrap_or(0).saturating_sub(3));
    let down = value / scale * scale;
    down + if value - down >= scale.div_ceil(2) && scale > 1 { scale } else { 0 }
}

/// Topics that are sent when there is something to say, not at a rate.
fn is_occasional(topic: &str) -> bool {
    topic.ends_with(topics::SETPOINT)
        || !(topic.contains("/stage/") || topic.contains("/controller/"))
}

impl TopicCheck {
    fn findings(&self) -> Vec<FileFinding> {
        let topic = || self.name.clone();
        let mut findings = Vec::new();
        if self.decode_failures > 0 {
            findings.push(FileFinding::Undecodable {
                topic: topic(),
                messages: self.decode_failures,
                total: self.messages,
                type_name: self.type_name.clone(),
            });
        }
        if self.non_finite > 0 {
            findings.push(FileFinding::NotFinite { topic: topic(), values: self.non_finite });
        }
        if self.backward_stamps > 0 {
            findings
                .push(FileFinding::BackwardStamps { topic: topic(), stamps: self.backward_stamps });
        }
        if self.repeated_stamps > 0 && self.by_stamp {
            findings
                .push(FileFinding::RepeatedStamps { topic: topic(), stamps: self.repeated_stamps });
        }
        if self.gaps > 0 && !is_occasional(&self.name) {
            findings.push(FileFinding::Gaps {
                topic: topic(),
                gaps: self.gaps,
                longest_s: self.longest_gap_s.unwrap_or(0.0),
                usual_s: self.usual_s,
            });
        }
        findings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_keep_four_digits() {
        assert_eq!(four_digits(500_000), 500_000);
        assert_eq!(four_digits(123_456), 123_500);
        assert_eq!(four_digits(123_449), 123_400);
        assert_eq!(four_digits(999_960), 1_000_000);
        assert_eq!(four_digits(7), 7);
        assert_eq!(four_digits(i64::MAX as u64), 9_223_000_000_000_000_000);
    }

    /// What is said of messages at these times, ns.
    fn watched(times: impl IntoIterator<Item = u64>) -> TopicCheck {
        let mut watch = Watch::new("/rosout", "rcl_interfaces/msg/Log");
        for time in times {
            watch.at(time as i64);
        }
        watch.finish()
    }

    const SECOND: u64 = 1_000_000_000;

    #[test]
    fn bursts_have_no_rate() {
        // groups of 2 to 50 messages, close or less close together, alike or not
        for (size, within, between, alike) in [
            (2, 10_000, SECOND, true),
            (2, 10_000, SECOND, false),
            (5, 10_800, SECOND / 5, true),
            (5, 10_800, SECOND / 5, false),
            (12, 100_000, 3 * SECOND, false),
            (50, 1_000_000, 10 * SECOND, true),
            (50, 1_000_000, 10 * SECOND, false),
        ] {
            let group = |g: u64| {
                let other = if alike { 0 } else { g };
                let (size, start) = (size + other % 3, g * between + other * g * 7919);
                (0..size).map(move |k| start + k * within * (1 + other % 2))
            };
            let report = watched((0..40).flat_map(group));
            assert!(report.in_bursts, "{size} {within} {between}");
            assert_eq!((report.rate_hz, report.jitter_s, report.gaps), (None, None, 0));
        }
    }

    #[test]
    fn a_rate_stays_one_with_jitter_losses_and_an_interruption() {
        let period = 1_000_000;
        // xorshift: a number in [0, 1)
        let mut state = 88_172_645_463_325_252u64;
        let mut random = move || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let jitter: Vec<u64> =
            (0..5000).map(|k| k * period + (random() * 0.9 * period as f64) as u64).collect();
        let losses: Vec<u64> = (0..5000).filter(|_| random() > 0.4).map(|k| k * period).collect();
        let interrupted =
            |n: u64| (0..2 * n).map(move |k| k * period + if k < n { 0 } else { 1000 * SECOND });
        for times in [jitter, losses, interrupted(10).collect(), interrupted(3000).collect()] {
            let report = watched(times);
            assert!(!report.in_bursts);
            let rate = report.rate_hz.unwrap();
            assert!((rate / 1000.0 - 1.0).abs() < 0.1, "{rate}");
        }
        assert_eq!(watched([0, SECOND]).rate_hz, Some(1.0));
        assert_eq!(watched([0]).rate_hz, None);
    }
}
