//! Recordings over each other: position, error and forces of any runs on one page.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::chart::{Chart, Series, Style};
use crate::figure::FigureError;
use crate::page::{Align, Cell, Page, Table};
use friction_stage_core::model::JointType;
use friction_stage_data::signals::Recording;

/// A recording with where it comes from.
pub struct ViewedRun {
    /// What the user calls it.
    pub path: PathBuf,
    /// Its signals on one grid.
    pub recording: Recording,
}

/// Runs whose charts would have two units on one axis.
#[derive(Debug, thiserror::Error)]
#[error(
    "{} is of a {} stage and {} of a {} one, which have no axis in common: view them apart",
    .first.display(), kind(.first_joint), .other.display(), kind(.other_joint)
)]
pub struct DifferentJoints {
    first: PathBuf,
    first_joint: JointType,
    other: PathBuf,
    other_joint: JointType,
}

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// A chart that could not be drawn.
    #[error(transparent)]
    Figure(#[from] FigureError),
    /// Runs in different units.
    #[error(transparent)]
    Joints(#[from] Box<DifferentJoints>),
}

fn kind(joint: &JointType) -> &'static str {
    match joint {
        JointType::Prismatic => "linear",
        JointType::Revolute => "rotary",
    }
}

/// The page of some runs, each from its first sample on.
pub fn view_page(runs: &[ViewedRun]) -> Result<String, ViewError> {
    let joint = joint(runs)?;
    let names = names(runs.iter().map(|run| run.path.as_path()));
    let mut page = Page::new(
        names.join(", "),
        format!(
            "friction-stage {} \u{b7} time from the first sample of each",
            env!("CARGO_PKG_VERSION")
        ),
    );
    let mut table = Table::new(&[
        ("run", Align::Left),
        ("duration, s", Align::Right),
        ("samples", Align::Right),
        ("rate, Hz", Align::Right),
        ("rows that lack a signal", Align::Right),
    ]);
    for (name, run) in names.iter().zip(runs) {
        let (trace, quality) = (&run.recording.trace, &run.recording.quality);
        table.row([
            Cell::text(name),
            Cell::number(trace.time.last().copied().unwrap_or(0.0), 3),
            Cell::text(quality.rows.to_string()),
            Cell::number(quality.rate_hz, 3),
            Cell::text((quality.rows - quality.valid_rows).to_string()),
        ]);
    }
    page.table(&table);
    let mut missing = Vec::new();
    for signal in &SIGNALS {
        let curves = curves(signal.value, runs, &names);
        let name = joint.quantity(signal.name);
        let mut title = name.clone().into_owned();
        title[..1].make_ascii_uppercase();
        let apart = difference(&curves);
        let difference_title =
            curves.first().map(|first| format!("{title} less that of {}", first.name));
        let setpoints = signal.setpoint.map(|value| setpoints(value, runs, &names));
        let all = curves.into_iter().chain(setpoints.into_iter().flatten()).collect();
        match chart(title, &name, signal.unit, joint, all) {
            Some(chart) => page.figure(&chart, signal.caption)?,
            None => missing.push(signal.name),
        }
        let apart = difference_title
            .and_then(|title| chart(title, &format!("{name} apart"), signal.unit, joint, apart));
        if let Some(chart) = apart {
            page.figure(&chart, "What is left where the first run is taken away.")?;
        }
    }
    if !missing.is_empty() {
        page.text(&format!("In no recording: {}.", missing.join(", ")));
    }
    Ok(page.finish())
}

/// A signal that is shown.
struct Viewed {
    name: &'static str,
    /// Unit of a linear stage.
    unit: &'static str,
    caption: &'static str,
    value: Value,
    /// What it was to be.
    setpoint: Option<Value>,
}

/// The value of a signal in a row, SI units.
type Value = fn(&Recording, usize) -> f64;

const SIGNALS: [Viewed; 4] = [
    Viewed {
        name: "position",
        unit: "m",
        caption: "What the encoder shows; dashed: the setpoint.",
        value: |run, row| run.trace.position[row],
        setpoint: Some(|run, row| run.trace.reference_position[row]),
    },
    Viewed {
        name: "position error",
        unit: "m",
        caption: "Setpoint less encoder.",
        value: |run, row| run.trace.reference_position[row] - run.trace.position[row],
        setpoint: None,
    },
    Viewed {
        name: "force command",
        unit: "N",
        caption: "What the controller asks of the motor.",
        value: |run, row| run.trace.force[row],
        setpoint: None,
    },
    Viewed {
        name: "force cell",
        unit: "N",
        caption: "What the motor side makes, as the force cell shows it.",
        value: |run, row| run.trace.force_cell[row],
        setpoint: None,
    },
];

/// A signal of all runs that have it, SI units.
fn curves(value: Value, runs: &[ViewedRun], names: &[String]) -> Vec<Series> {
    let named = runs.iter().zip(names).enumerate();
    named
        .map(|(colour, (ViewedRun { recording, .. }, name))| {
            let time = recording.trace.time.iter().copied();
            let points =
                time.enumerate().map(|(row, time)| (time, value(recording, row))).collect();
            Series { name: name.clone(), points, style: Style::Line, colour }
        })
        .filter(|curve| curve.points.iter().any(|point| point.1.is_finite()))
        .collect()
}

/// Colour of the setpoint of all runs.
const SETPOINT: usize = 4;

/// The setpoint of all runs that have one; once, where it is the same.
fn setpoints(value: Value, runs: &[ViewedRun], names: &[String]) -> Vec<Series> {
    let mut curves = curves(value, runs, names);
    let is_one = curves.windows(2).all(|pair| pair[0].points == pair[1].points);
    if is_one {
        curves.truncate(1);
    }
    let dashed = |curve: Series| Series {
        name: match is_one {
            true => "setpoint".to_owned(),
            false => format!("setpoint of {}", curve.name),
        },
        style: Style::Dashed,
        // That of all runs is grey.
        colour: if is_one { SETPOINT } else { curve.colour },
        ..curve
    };
    curves.into_iter().map(dashed).collect()
}

/// Curves in SI units as a chart, in the prefix of the unit that reads well.
fn chart(
    title: String,
    name: &str,
    unit: &str,
    joint: JointType,
    curves: Vec<Series>,
) -> Option<Chart> {
    let values = curves.iter().flat_map(|curve| &curve.points).map(|point| point.1.abs());
    let largest = values.filter(|value| value.is_finite()).reduce(f64::max)?;
    let (scale, prefix) = match (unit, largest) {
        ("m", size) if size < 1e-6 && size > 0.0 => (1e9, "n"),
        ("m", size) if size < 1e-3 => (1e6, "µ"),
        ("m", size) if size < 1.0 => (1e3, "m"),
        _ => (1.0, ""),
    };
    let unit = format!("{prefix}{unit}");
    let mut chart = Chart::new(title, "time, s", format!("{name}, {}", joint.unit(&unit)));
    chart.zooms_with = Some("time".to_owned());
    for Series { name, points, style, colour } in curves {
        chart.add(
            name,
            colour,
            style,
            points.into_iter().map(|(time, value)| (time, scale * value)),
        );
    }
    Some(chart)
}

/// The curves less the first one, at their places where it has neighbours: curves that are nearly
/// the same hide each other.
fn difference(curves: &[Series]) -> Vec<Series> {
    let Some((first, others)) = curves.split_first() else { return Vec::new() };
    let less_first = |other: &Series| {
        let mut place = 0;
        let points = other.points.iter().filter_map(|(x, y)| {
            while first.points.get(place + 1).is_some_and(|next| next.0 < *x) {
                place += 1;
            }
            let [before, after] = [first.points.get(place)?, first.points.get(place + 1)?];
            let part = (x - before.0) / (after.0 - before.0);
            let there = before.1 + part * (after.1 - before.1);
            (0.0..=1.0).contains(&part).then_some((*x, y - there))
        });
        Series { points: points.collect(), ..other.clone() }
    };
    // One that is larger than both curves is that of other motions, and says nothing.
    let size = |curve: &Series| {
        let values = || curve.points.iter().map(|point| point.1).filter(|value| value.is_finite());
        let n = values().count() as f64;
        let mean = values().sum::<f64>() / n;
        (values().map(|value| (value - mean).powi(2)).sum::<f64>() / n).sqrt()
    };
    let is_alike = |(other, apart): &(&Series, Series)| size(apart) <= size(other).max(size(first));
    others
        .iter()
        .map(|other| (other, less_first(other)))
        .filter(is_alike)
        .map(|pair| pair.1)
        .collect()
}

/// The joint of all runs; those that say nothing are of the kind of the others.
fn joint(runs: &[ViewedRun]) -> Result<JointType, Box<DifferentJoints>> {
    let mut stated = runs.iter().filter_map(|run| Some((run, run.recording.joint?)));
    let Some((first, first_joint)) = stated.next() else { return Ok(JointType::default()) };
    match stated.find(|(_, joint)| *joint != first_joint) {
        None => Ok(first_joint),
        Some((other, other_joint)) => Err(Box::new(DifferentJoints {
            first: first.path.clone(),
            first_joint,
            other: other.path.clone(),
            other_joint,
        })),
    }
}

/// The shortest ends of the paths that tell the runs apart.
fn names<'a>(paths: impl Iterator<Item = &'a Path>) -> Vec<String> {
    let paths: Vec<&Path> = paths.collect();
    let most = paths.iter().map(|path| path.components().count()).max().unwrap_or(1);
    let ends = |count: usize| -> Vec<String> {
        let end = |path: &&Path| {
            let all: Vec<_> = path.components().collect();
            all[all.len().saturating_sub(count)..].iter().collect::<PathBuf>().display().to_string()
        };
        paths.iter().map(end).collect()
    };
    let apart = |names: &Vec<String>| names.iter().collect::<BTreeSet<_>>().len() == names.len();
    (1..=most).map(ends).find(apart).unwrap_or_else(|| ends(most))
}

#[cfg(test)]
mod tests {
    use super::*;
    use friction_stage_data::signals::{Trace, Window, from_columns};

    fn run(path: &str, joint: Option<JointType>) -> ViewedRun {
        let time: Vec<f64> = (0..500).map(|k| 1e-3 * f64::from(k)).collect();
        let columns = Trace {
            position: time.iter().map(|t| 0.02 * (6.0 * t).sin()).collect(),
            reference_position: time.iter().map(|t| 0.02 * (6.0 * t).sin() + 5e-6).collect(),
            time,
            ..Trace::default()
        };
        let mut recording = from_columns(path, &columns, Window::default()).unwrap();
        recording.joint = joint;
        ViewedRun { path: path.into(), recording }
    }

    #[test]
    fn what_the_runs_have_is_shown_in_units_that_read_well() {
        let page = view_page(&[run("day/one", None), run("night/one", None)]).unwrap();
        for words in [
            "position, mm",
            "position error, µm",
            "day/one",
            "\"setpoint\"",
            "Position less that of day/one",
        ] {
            assert!(page.contains(words), "no {words}");
        }
        assert!(page.contains("In no recording: force command, force cell."));
        // Each with the difference of the two.
        assert_eq!(page.matches("<figure").count(), 4);
    }

    #[test]
    fn a_difference_is_that_at_the_same_time_whatever_the_grids() {
        let curve_of = |name: &str, points: Vec<(f64, f64)>| Series {
            name: name.to_owned(),
            points,
            style: Style::Line,
            colour: 0,
        };
        let first =
            curve_of("first", (0..11).map(|k| (f64::from(k), 2.0 * f64::from(k))).collect());
        assert_eq!(difference(std::slice::from_ref(&first)), []);
        let other = (-4..40).map(|k| 0.25 * f64::from(k) + 0.1).map(|x| (x, 2.0 * x + 0.5));
        let apart = difference(&[first, curve_of("other", other.collect())]);
        let [curve] = apart.as_slice() else { panic!("{apart:?}") };
        // From 0.1 to 9.85: where the first one is.
        assert_eq!(curve.points.len(), 40);
        assert!(curve.points.iter().all(|point| (point.1 - 0.5).abs() < 1e-12));
        // Those of other motions have none.
        let wave = |name: &str, rate: f64| {
            let at = |k: i32| (f64::from(k), (rate * f64::from(k)).sin());
            curve_of(name, (0..200).map(at).collect())
        };
        assert_eq!(difference(&[wave("one", 0.1), wave("other", 0.27)]), []);
        assert_eq!(difference(&[wave("one", 0.1), wave("again", 0.1001)]).len(), 1);
    }

    #[test]
    fn a_linear_and_a_rotary_stage_have_no_axis_in_common() {
        let runs = [run("a", Some(JointType::Prismatic)), run("b", Some(JointType::Revolute))];
        let reported = view_page(&runs).unwrap_err().to_string();
        assert!(
            reported.contains("a is of a linear") && reported.contains("b of a rotary"),
            "{reported}"
        );
    }

    #[test]
    fn runs_have_the_shortest_names_that_tell_them_apart() {
        let reported = |paths: &[&str]| names(paths.iter().map(Path::new));
        assert_eq!(reported(&["x/a", "x/b"]), ["a", "b"]);
        assert_eq!(reported(&["x/a", "y/a"]), ["x/a", "y/a"]);
        assert_eq!(reported(&["x/a", "x/a"]), ["x/a", "x/a"]);
    }
}
