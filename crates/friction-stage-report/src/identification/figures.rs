//! The figures of an identification: what the models miss before and after, over everything that a
//! cause could depend on.

use crate::chart::{Chart, Style};
use crate::error::ReportError;
use crate::words::Words;
use friction_stage_core::model::{Coordinate, Curve, CurveSide, JointType, StageModel};
use friction_stage_core::plant::effects::CURVE;
use friction_stage_identify::{
    Identification, IdentifyFinding, LoopError, Measured, Missing, Record, Records, Sides, spectrum,
};

/// A drawn figure; `name` is its file without the ending.
pub struct IdentificationFigure {
    /// Name of its file, without the ending.
    pub name: String,
    /// Where it stands in the report.
    pub group: FigureGroup,
    /// The drawing.
    pub svg: String,
    /// What it shows.
    pub caption: String,
}

/// Section of the report in which a figure stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FigureGroup {
    /// Measured and modelled.
    Comparison,
    /// What the models miss.
    Residual,
    /// Spectra of the residual.
    Spectrum,
}

/// Bins of a residual over a coordinate, equally wide.
const BINS: usize = 80;
/// Rows that a bin needs to be shown.
const LEAST_IN_BIN: usize = 6;
/// Columns of a figure over time.
const COLUMNS: usize = 1200;
/// Length of the close-up of the force, s.
const CLOSE_UP: f64 = 1.0;

/// What both models miss on a record.
struct Residuals<'a> {
    joint: JointType,
    measured: &'a Measured,
    before: Missing,
    after: Missing,
}

impl Residuals<'_> {
    fn of<'a>(
        identification: &Identification,
        measured: &'a Measured,
    ) -> Result<Residuals<'a>, ReportError> {
        let selection = &identification.selection;
        Ok(Residuals {
            joint: identification.model.joint,
            measured,
            before: selection.before.hypothesis.missing(measured, Sides::BOTH)?,
            after: selection
                .after
                .fitted
                .hypothesis
                .in_record(measured)?
                .missing(measured, Sides::BOTH)?,
        })
    }

    /// Name, colour in a chart, before, after; the motor side only where a force cell divides it
    /// from the carriage.
    fn sides(&self) -> Vec<(&'static str, usize, &[f64], &[f64])> {
        let mut sides = Vec::new();
        if !self.before.motor.is_empty() {
            sides.push((
                "motor side",
                0,
                self.before.motor.as_slice(),
                self.after.motor.as_slice(),
            ));
        }
        sides.push((
            "carriage side",
            1,
            self.before.carriage.as_slice(),
            self.after.carriage.as_slice(),
        ));
        sides
    }
}

/// The label of an axis, a quantity and its unit, with the units of a joint.
fn axis(joint: JointType, label: &str) -> String {
    match label.split_once(", ") {
        Some((quantity, unit)) => format!("{quantity}, {}", joint.unit(unit)),
        None => label.to_owned(),
    }
}

/// Draws all of them.
pub fn identification_figures(
    identification: &Identification,
    records: &Records,
) -> Result<Vec<IdentificationFigure>, ReportError> {
    let joint = identification.model.joint;
    let train = Residuals::of(identification, &records.train.measured)?;
    let holdout = Residuals::of(identification, &records.holdout.measured)?;
    let mut figures: Vec<IdentificationFigure> = maps(&identification.model)?;
    figures.extend(force(&holdout)?);
    if let Some(loops) = &identification.loops {
        figures.push(position(&records.holdout, &loops.holdout, joint)?);
    }
    figures.extend(over_time(&holdout, "hold-out")?);
    figures.extend(over_time(&train, "train")?);
    let measured = holdout.measured;
    let acceleration = measured.filtered(&measured.acceleration);
    let coordinates: [(&'static str, &'static str, &str, f64, Vec<f64>); 5] = [
        (
            "residual_over_position",
            "position",
            "position, mm",
            1e3,
            measured.at_rows(&measured.position),
        ),
        (
            "residual_over_velocity",
            "velocity",
            "velocity, mm/s",
            1e3,
            measured.at_rows(&measured.velocity),
        ),
        (
            "residual_over_acceleration",
            "acceleration",
            "acceleration, m/s^2",
            1.0,
            acceleration.clone(),
        ),
        ("residual_over_jerk", "jerk", "jerk, m/s^3", 1.0, slope(measured, &acceleration)),
        (
            "residual_over_distance",
            "travelled distance",
            "travelled distance, m",
            1.0,
            distance(measured),
        ),
    ];
    for (name, word, label, scale, along) in coordinates {
        let along: Vec<f64> = along.iter().map(|value| value * scale).collect();
        let mut chart = Chart::new(
            format!("Residual over {word}: mean of each bin"),
            axis(joint, label),
            axis(joint, "missing force, N"),
        );
        let mut spread = Chart::new(
            format!("Residual over {word}: rms in each bin"),
            axis(joint, label),
            axis(joint, "missing force, N rms"),
        );
        for (side, colour, before, after) in holdout.sides() {
            for (values, style, when) in
                [(before, Style::Dashed, "before"), (after, Style::Line, "after")]
            {
                let bins = binned(&along, values);
                chart.add(
                    format!("{side}, {when}"),
                    colour,
                    style,
                    bins.iter().map(|bin| (bin.0, bin.1)),
                );
                spread.add(
                    format!("{side}, {when}"),
                    colour,
                    style,
                    bins.iter().map(|bin| (bin.0, bin.2)),
                );
            }
        }
        figures.push(IdentificationFigure {
            name: name.to_owned(),
            group: FigureGroup::Residual,
            svg: chart.svg()?,
            caption: format!(
                "What the declared (before) and the identified (after) model miss \
                              over {word}, hold-out record; mean of the rows of a bin."
            ),
        });
        // Over the signed coordinates a cause that changes its sign averages out; its size does
        // not.
        if matches!(word, "position" | "velocity") {
            figures.push(IdentificationFigure {
                name: format!("residual_size_over_{word}"),
                group: FigureGroup::Residual,
                svg: spread.svg()?,
                caption: format!(
                    "The same as size: root mean square of the rows of a bin over {word}."
                ),
            });
        }
    }
    figures.extend(spectra(&train)?);
    Ok(figures)
}

/// The empirical curves of a model.
fn maps(model: &StageModel) -> Result<Vec<IdentificationFigure>, ReportError> {
    let curves = model.effects.iter().filter_map(|effect| effect.curve.as_ref());
    let figure = |(index, curve): (usize, &Curve)| {
        let word = curve.coordinate.name();
        let (label, scale) = match curve.coordinate {
            Coordinate::Position => ("position, mm", 1e3),
            Coordinate::Velocity => ("velocity, mm/s", 1e3),
            Coordinate::Time => ("time, s", 1.0),
        };
        let (what, ordinate) = match curve.side {
            CurveSide::Carriage => ("Force on the carriage", "force, N"),
            CurveSide::Motor => ("Force of the motor", "force, N"),
            CurveSide::Friction => {
                ("Change of Coulomb and static friction", "part of the friction")
            }
            CurveSide::Viscous => ("Change of viscous friction", "part of the friction"),
            CurveSide::Mass => ("Change of the moving mass", "mass, kg"),
        };
        let mut chart = Chart::new(
            format!("{what} over {word} that no law of the list explains"),
            axis(model.joint, label),
            axis(model.joint, ordinate),
        );
        let points = curve.corners().into_iter().map(|(place, value)| (scale * place, value));
        chart.add(CURVE.name, 0, Style::Line, points);
        let jump = IdentifyFinding::of_jump(curve)
            .map_or_else(String::new, |jump| format!("; {}", jump.words(model.joint)));
        Ok(IdentificationFigure {
            name: match index {
                0 => CURVE.name.to_owned(),
                before => format!("{}_{}", CURVE.name, before + 1),
            },
            group: FigureGroup::Comparison,
            svg: chart.svg()?,
            caption: format!(
                "The empirical map of the identified model over {word}: linear between {} knots, \
                 constant beyond{jump}.",
                curve.values.len()
            ),
        })
    };
    curves.enumerate().map(figure).collect()
}

/// Measured force and both models along the measured motion, whole and close up.
fn force(residuals: &Residuals) -> Result<[IdentificationFigure; 2], ReportError> {
    let measured = residuals.measured;
    let time = measured.at_rows(&measured.time);
    let reading = measured.filtered(measured.cell.as_deref().unwrap_or(&measured.command));
    let model = |missing: &[f64]| {
        reading.iter().zip(missing).map(|(force, missing)| force + missing).collect::<Vec<_>>()
    };
    let (before, after) = (model(&residuals.before.carriage), model(&residuals.after.carriage));
    // Where the declared model is worst.
    let window = ((CLOSE_UP * measured.lowpass.kept_rate()) as usize).clamp(2, time.len().max(2));
    let squares: Vec<f64> = residuals.before.carriage.iter().map(|value| value * value).collect();
    let mut sum: f64 = squares.iter().take(window).sum();
    let (mut most, mut start) = (sum, 0);
    for end in window..squares.len() {
        sum += squares[end] - squares[end - window];
        if sum > most {
            (most, start) = (sum, end + 1 - window);
        }
    }
    let part = start..(start + window).min(time.len());
    let what = if measured.cell.is_some() { "force cell" } else { "force command" };
    let draw = |title: String, part: std::ops::Range<usize>| {
        let mut chart = Chart::new(title, "time, s", axis(residuals.joint, "force, N"));
        let series = [
            ("measured", 4, Style::Line, &reading),
            ("model before", 1, Style::Line, &before),
            ("model after", 0, Style::Dashed, &after),
        ];
        for (name, colour, style, values) in series {
            chart.add(name, colour, style, thin(&time[part.clone()], &values[part.clone()]));
        }
        chart.svg()
    };
    let seconds = part.len() as f64 / measured.lowpass.kept_rate();
    Ok([
        IdentificationFigure {
            name: "force_measured_and_simulated".to_owned(),
            group: FigureGroup::Comparison,
            svg: draw("Measured and simulated force, hold-out record".to_owned(), 0..time.len())?,
            caption: format!(
                "Force on the carriage: {what}, and mass times acceleration plus friction less \
                 effects along the measured motion, all through the same zero-phase lowpass. \
                 Before: declared model, refitted; after: identified model."
            ),
        },
        IdentificationFigure {
            name: "force_close_up".to_owned(),
            group: FigureGroup::Comparison,
            svg: draw(format!("Measured and simulated force, {seconds:.1} s of it"), part)?,
            caption: "The same where the declared model misses most on the carriage side."
                .to_owned(),
        },
    ])
}

fn position(
    record: &Record,
    error: &LoopError,
    joint: JointType,
) -> Result<IdentificationFigure, ReportError> {
    let mut time = Vec::new();
    for trace in record.traces() {
        let from = time.last().copied().unwrap_or(0.0);
        time.extend(trace.time.iter().map(|t| from + t));
    }
    let largest = error
        .before
        .iter()
        .chain(&error.after)
        .filter(|e| e.is_finite())
        .fold(0.0, |m: f64, e| m.max(e.abs()));
    let (scale, unit) = if largest < 1e-6 { (1e9, "nm") } else { (1e6, "µm") };
    let scaled = |values: &[f64]| values.iter().map(|value| value * scale).collect::<Vec<_>>();
    let mut chart = Chart::new(
        "Position in closed loop, hold-out record",
        "time, s",
        format!("simulated less encoder, {}", joint.unit(unit)),
    );
    pair(&mut chart, &time, &scaled(&error.before), &scaled(&error.after));
    Ok(IdentificationFigure {
        name: "position_error_in_closed_loop".to_owned(),
        group: FigureGroup::Comparison,
        svg: chart.svg()?,
        caption: "Simulated loop (identified or declared stage, recorded setpoint, controller \
                  found from the record) less recorded encoder."
            .to_owned(),
    })
}

fn over_time(
    residuals: &Residuals,
    record: &str,
) -> Result<Vec<IdentificationFigure>, ReportError> {
    let time = residuals.measured.at_rows(&residuals.measured.time);
    residuals
        .sides()
        .into_iter()
        .map(|(side, _, before, after)| {
            let mut chart = Chart::new(
                format!("Residual over time, {side}, {record} record"),
                "time, s",
                axis(residuals.joint, "missing force, N"),
            );
            pair(&mut chart, &time, before, after);
            let law = match side {
                "motor side" => "cell less command and motor effects",
                _ => "mass times acceleration plus friction less effects and measured force",
            };
            Ok(IdentificationFigure {
                name: format!(
                    "residual_over_time_{}_{}",
                    side.replace(' ', "_"),
                    record.replace('-', "")
                ),
                group: FigureGroup::Residual,
                svg: chart.svg()?,
                caption: format!(
                    "Force that the models miss on the {side} ({law}), {record} record."
                ),
            })
        })
        .collect()
}

/// Before and after in one chart; one line where both are the same.
fn pair(chart: &mut Chart, time: &[f64], before: &[f64], after: &[f64]) {
    if before == after {
        chart.add("before and after", 0, Style::Line, thin(time, before));
    } else {
        chart.add("before", 1, Style::Line, thin(time, before));
        chart.add("after", 0, Style::Line, thin(time, after));
    }
}

/// Smallest and largest value of each of many columns: what lies between would not be seen.
fn thin(time: &[f64], values: &[f64]) -> Vec<(f64, f64)> {
    let points: Vec<(f64, f64)> = time
        .iter()
        .copied()
        .zip(values.iter().copied())
        .filter(|(_, value)| value.is_finite())
        .collect();
    let width = points.len().div_ceil(COLUMNS).max(1);
    if width < 3 {
        return points;
    }
    let by_value = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
    points
        .chunks(width)
        .flat_map(|chunk| {
            let mut two: Vec<(f64, f64)> = chunk
                .iter()
                .min_by(by_value)
                .into_iter()
                .chain(chunk.iter().max_by(by_value))
                .copied()
                .collect();
            two.sort_by(|a, b| a.0.total_cmp(&b.0));
            two
        })
        .collect()
}

fn spectra(residuals: &Residuals) -> Result<Vec<IdentificationFigure>, ReportError> {
    let measured = residuals.measured;
    let (position, velocity) =
        (measured.at_rows(&measured.position), measured.at_rows(&measured.velocity));
    let label = |text: &str| axis(residuals.joint, text);
    let mut time = Chart::new("Spectrum over time", "frequency, Hz", label("amplitude, N/√Hz"))
        .logarithmic(true, true);
    let mut space =
        Chart::new("Spectrum over position", label("period, mm"), label("amplitude, N"))
            .logarithmic(true, false);
    for (side, colour, before, after) in residuals.sides() {
        for (values, style, when) in
            [(before, Style::Dashed, "before"), (after, Style::Line, "after")]
        {
            let name = format!("{side}, {when}");
            time.add(name.clone(), colour, style, spectrum::over_time(measured, values));
            let over =
                spectrum::over_position(&position, &velocity, measured.lowpass.kept_rate(), values);
            space.add(
                name,
                colour,
                style,
                over.into_iter().map(|(period, amplitude)| (period * 1e3, amplitude)),
            );
        }
    }
    Ok(vec![
        IdentificationFigure {
            name: "spectrum_over_time".to_owned(),
            group: FigureGroup::Spectrum,
            svg: time.svg()?,
            caption:
                "Residual of the train record over frequency (Welch). A line at one frequency \
                      whatever the speed comes from time: a vibration, a resonance."
                    .to_owned(),
        },
        IdentificationFigure {
            name: "spectrum_over_position".to_owned(),
            group: FigureGroup::Spectrum,
            svg: space.svg()?,
            caption:
                "Residual of the train record over period in position, moving rows only (best \
                      sine of each period). A line comes from something that repeats along the \
                      way: a magnet pitch, a ball, a scale."
                    .to_owned(),
        },
    ])
}

/// (middle, mean, rms) of each bin that holds enough rows.
fn binned(along: &[f64], values: &[f64]) -> Vec<(f64, f64, f64)> {
    let low = along.iter().copied().fold(f64::INFINITY, f64::min);
    let high = along.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if high.is_nan() || high <= low {
        return Vec::new();
    }
    let width = (high - low) / BINS as f64;
    let mut bins = vec![(0usize, 0.0, 0.0); BINS];
    for (at, value) in along.iter().zip(values) {
        let bin = &mut bins[(((at - low) / width) as usize).min(BINS - 1)];
        bin.0 += 1;
        bin.1 += value;
        bin.2 += value * value;
    }
    bins.iter()
        .enumerate()
        .filter(|(_, bin)| bin.0 >= LEAST_IN_BIN)
        .map(|(index, (count, sum, squares))| {
            let count = *count as f64;
            (low + (index as f64 + 0.5) * width, sum / count, (squares / count).sqrt())
        })
        .collect()
}

/// Slope of a signal at the rows over time, per second.
fn slope(measured: &Measured, values: &[f64]) -> Vec<f64> {
    let rows = &measured.rows;
    (0..values.len())
        .map(|row| {
            let (before, after) = (row.saturating_sub(1), (row + 1).min(values.len() - 1));
            let span = (rows[after] - rows[before]) as f64 / measured.rate;
            if span > 0.0 { (values[after] - values[before]) / span } else { 0.0 }
        })
        .collect()
}

/// Way travelled since the start at the rows, m; steps within the encoder's noise do not count.
fn distance(measured: &Measured) -> Vec<f64> {
    let mut total = 0.0;
    let mut along = vec![0.0; measured.len()];
    for step in &measured.steps {
        total += (step.motion.velocity * step.duration).abs();
        along[step.node + 1] = total;
    }
    measured.at_rows(&along)
}
