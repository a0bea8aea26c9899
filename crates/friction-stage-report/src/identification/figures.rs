//! The figures of an identification: what the models miss before and after, over everything that a
//! cause could depend on.

use crate::chart::{Axis, Chart, Scale, Style, peaks};
use crate::error::ReportError;
use crate::words::{Words, harmonic_name, in_prefix_short};
use friction_stage_core::model::{
    Coordinate, Curve, CurveSide, EffectParameters, JointType, StageModel,
};
use friction_stage_core::numerics::rounded;
use friction_stage_core::plant::effects::CURVE;
use friction_stage_identify::{
    Criteria, Floor, Identification, IdentifyFinding, LoopError, Measured, Missing, Record,
    Records, Sides, spectrum,
};

/// A drawn figure; `name` is its file without the ending.
pub struct IdentificationFigure {
    /// Name of its file, without the ending.
    pub name: String,
    /// Where it stands in the report.
    pub group: FigureGroup,
    /// What is drawn.
    pub chart: Chart,
    /// The drawing.
    pub svg: String,
    /// What it shows.
    pub caption: String,
}

/// Section of the report in which a figure stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FigureGroup {
    /// What the models miss before and after, and the measured force.
    Comparison,
    /// What the models miss.
    Residual,
    /// Spectra of the residual.
    Spectrum,
}

/// Bins of a residual over a coordinate, were all of them as wide and as narrow as they may be.
const BINS: [f64; 2] = [80.0, 2000.0];
/// Rows that a bin needs to be shown.
const LEAST_IN_BIN: usize = 6;
/// How much wider than others a bin may be to hold them.
const SPARSE: f64 = 8.0;
/// Colour of what noise alone would be.
const NOISE: usize = 4;
/// Half width of the band of noise in its standard deviations: 95 % of the rows are within.
const NOISE_BAND: f64 = 1.96;
/// Where the ordinate of a spectrum begins, as a part of the density of the noise.
const BELOW_NOISE: f64 = 0.2;
/// Length of the close-up, s.
const CLOSE_UP: f64 = 1.0;

/// What both models miss on a record.
struct Residuals<'a> {
    joint: JointType,
    measured: &'a Measured,
    before: Missing,
    after: Missing,
    floor: Floor,
}

/// What the models miss on one side.
struct Side<'a> {
    name: &'static str,
    /// Colours before and after: warm and cold.
    colours: [usize; 2],
    before: &'a [f64],
    after: &'a [f64],
    /// What the sensors' noise alone leaves, N rms.
    floor: f64,
}

impl IdentificationFigure {
    fn new(
        name: impl Into<String>,
        group: FigureGroup,
        chart: Chart,
        caption: impl Into<String>,
    ) -> Result<IdentificationFigure, ReportError> {
        let svg = chart.svg()?;
        Ok(IdentificationFigure { name: name.into(), group, chart, svg, caption: caption.into() })
    }
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
            floor: selection.floor,
            before: selection.before.hypothesis.missing(measured, Sides::BOTH)?,
            after: selection
                .after
                .fitted
                .hypothesis
                .in_record(measured)?
                .missing(measured, Sides::BOTH)?,
        })
    }

    /// Both sides; the motor side only where a force cell divides it from the carriage.
    fn sides(&self) -> Vec<Side<'_>> {
        let side =
            |name, colours, before, after, floor| Side { name, colours, before, after, floor };
        let (before, after) = (&self.before, &self.after);
        let mut sides = Vec::new();
        if !before.motor.is_empty() {
            sides.push(side("motor side", [1, 0], &before.motor, &after.motor, self.floor.motor));
        }
        let colours = if sides.is_empty() { [1, 0] } else { [5, 6] };
        let (left, right) = (before.carriage.as_slice(), after.carriage.as_slice());
        sides.push(side("carriage side", colours, left, right, self.floor.carriage));
        sides
    }

    /// The side on which the declared model misses most, measured in noise.
    fn worst(&self) -> Option<Side<'_>> {
        let size = |side: &Side| {
            side.before.iter().map(|value| value * value).sum::<f64>() / side.floor.powi(2)
        };
        self.sides().into_iter().max_by(|a, b| size(a).total_cmp(&size(b)))
    }

    /// That side, and the other one where the declared model misses more than noise there, too.
    fn sides_that_miss(&self) -> Vec<Side<'_>> {
        let worst = self.worst().map(|side| side.name);
        let misses = |side: &Side| {
            let squares: f64 = side.before.iter().map(|value| value * value).sum();
            (squares / side.before.len().max(1) as f64).sqrt()
                > Criteria::USUAL.noise_like * side.floor
        };
        let mut sides = self.sides();
        sides.sort_by_key(|side| Some(side.name) != worst);
        sides.retain(|side| Some(side.name) == worst || misses(side));
        sides
    }

    /// Density of the noise of the sensors on the side that has less of it, N/√Hz: what the lowpass
    /// lets pass of it is even up to half the rate of the rows.
    fn noise_density(&self) -> f64 {
        let least = self.sides().iter().map(|side| side.floor).fold(f64::INFINITY, f64::min);
        least / (0.5 * self.measured.lowpass.kept_rate()).sqrt()
    }

    /// A chart of the missing force over time with the band of noise.
    fn chart(&self, title: String, record: &str, floor: f64) -> Chart {
        let mut chart = Chart::new(title, "time, s", axis(self.joint, "missing force, N"));
        let half = NOISE_BAND * floor;
        chart.band("noise of the sensors, 95 %", Axis::Y, -half, half);
        chart.zooms_with = Some(record.to_owned());
        chart
    }
}

/// A value in the unit of an axis, in two digits.
fn with_unit(value: f64, axis: &str) -> String {
    let unit = axis.split_once(", ").map_or("", |(_, unit)| unit);
    format!("{} {unit}", rounded(value, 2))
}

/// The label of an axis, a quantity and its unit, with the units of a joint.
fn axis(joint: JointType, label: &str) -> String {
    match label.split_once(", ") {
        Some((quantity, unit)) => format!("{}, {}", joint.quantity(quantity), joint.unit(unit)),
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
    let mut figures: Vec<IdentificationFigure> =
        maps(identification.found_model(), &holdout.sides())?;
    figures.extend(before_and_after(&holdout, "hold-out")?);
    if let Some(loops) = &identification.loops {
        figures.push(position(&records.holdout, &loops.holdout, joint)?);
    }
    figures.push(force(&holdout, "hold-out")?);
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
            "acceleration, m/s²",
            1.0,
            acceleration.clone(),
        ),
        ("residual_over_jerk", "jerk", "jerk, m/s³", 1.0, slope(measured, &acceleration)),
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
        // Most rows of a rate are near zero, and the few large ones are far from it.
        let scale = match word {
            "position" | "travelled distance" => Scale::Linear,
            _ => Scale::of_both_signs(&along),
        };
        let chart_of = |what: &str, ordinate: &str| {
            Chart::new(
                format!("Residual over {word}: {what}"),
                axis(joint, label),
                axis(joint, ordinate),
            )
            .along(scale)
        };
        let mut chart = chart_of("mean of each bin", "missing force, N");
        let mut spread = chart_of("rms in each bin", "missing force, N rms");
        let sides = holdout.sides_that_miss();
        if let Some(worst) = sides.first() {
            let noise = |what: &str| format!("noise, {}, {what}", worst.name);
            let bins = binned(&along, worst.before, scale);
            for (name, half) in
                [(noise("95 % of the means"), -NOISE_BAND), (String::new(), NOISE_BAND)]
            {
                let edge = bins.iter().map(|bin| (bin.place, half * worst.floor / bin.rows.sqrt()));
                chart.add(name, NOISE, Style::Dashed, edge);
            }
            spread.band(noise("rms"), Axis::Y, 0.0, worst.floor);
            spread.y_least = Some(0.0);
        }
        for curve in before_then_after(&sides) {
            let bins = binned(&along, curve.values, scale);
            chart.add(
                &curve.name,
                curve.colour,
                Style::Both,
                bins.iter().map(|bin| (bin.place, bin.mean)),
            );
            spread.add(
                curve.name,
                curve.colour,
                Style::Both,
                bins.iter().map(|bin| (bin.place, bin.rms)),
            );
        }
        let spread_out = match scale {
            Scale::Asinh(even) => format!(
                " The axis is even up to {}, and logarithmic beyond.",
                with_unit(even, &axis(joint, label))
            ),
            Scale::Linear | Scale::Log => String::new(),
        };
        let caption = format!(
            "What the declared (before) and the identified (after) model miss over {word}, \
             hold-out record; mean of the rows of a bin. Dashed: 95 % of the means would be within \
             if the noise of the sensors alone were left, which falls with the root of the number \
             of rows in a bin.{spread_out}"
        );
        figures.push(IdentificationFigure::new(name, FigureGroup::Residual, chart, caption)?);
        // Over the signed coordinates a cause that changes its sign averages out; its size does
        // not.
        if matches!(word, "position" | "velocity") {
            let caption = format!(
                "The same as size: root mean square of the rows of a bin over \
                     {word}.{spread_out}"
            );
            let name = format!("residual_size_over_{word}");
            figures.push(IdentificationFigure::new(name, FigureGroup::Residual, spread, caption)?);
        }
    }
    figures.extend(spectra(&train, identification.found_model())?);
    Ok(figures)
}

/// The empirical curves of a model.
fn maps(model: &StageModel, sides: &[Side]) -> Result<Vec<IdentificationFigure>, ReportError> {
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
        // It belongs to what is left on its side.
        let name = match curve.side {
            CurveSide::Motor => "motor side",
            _ => "carriage side",
        };
        let colour = sides.iter().find(|side| side.name == name).map_or(0, |side| side.colours[1]);
        chart.add(CURVE.name, colour, Style::Line, points);
        let jump = IdentifyFinding::of_jump(curve)
            .map_or_else(String::new, |jump| format!("; {}", jump.words(model.joint)));
        let name = match index {
            0 => CURVE.name.to_owned(),
            before => format!("{}_{}", CURVE.name, before + 1),
        };
        let caption = format!(
            "The empirical map of the identified model over {word}: linear between {} knots, \
             constant beyond{jump}.",
            curve.values.len()
        );
        IdentificationFigure::new(name, FigureGroup::Comparison, chart, caption)
    };
    curves.enumerate().map(figure).collect()
}

/// What both models miss on the side where the declared one misses most, where it does, and what
/// the identified one leaves.
fn before_and_after(
    residuals: &Residuals,
    record: &str,
) -> Result<Vec<IdentificationFigure>, ReportError> {
    let Some(side) = residuals.worst() else { return Ok(Vec::new()) };
    let measured = residuals.measured;
    let time = measured.at_rows(&measured.time);
    let window = ((CLOSE_UP * measured.lowpass.kept_rate()) as usize).clamp(2, time.len().max(2));
    let start = liveliest(side.before, window);
    let part = start..(start + window).min(time.len());
    let seconds = part.len() as f64 / measured.lowpass.kept_rate();
    let title =
        format!("Missing force on the {}, the {seconds:.1} s where it varies most", side.name);
    let mut close = residuals.chart(title, "close-up", side.floor);
    pair(
        &mut close,
        &time[part.clone()],
        &side.before[part.clone()],
        &side.after[part],
        side.floor,
        side.colours,
    );
    let title = format!("What the identified model leaves on the {}", side.name);
    let mut left = residuals.chart(title, record, side.floor);
    left.add("after", side.colours[1], Style::Line, points(&time, side.after));
    let group = FigureGroup::Comparison;
    Ok(vec![
        IdentificationFigure::new(
            "residual_close_up",
            group,
            close,
            format!(
                "What the declared (before) and the identified (after) model miss, {record} \
                 record, where that of the declared one varies most."
            ),
        )?,
        IdentificationFigure::new(
            "residual_after",
            group,
            left,
            format!(
                "What is left, {record} record, with the band in which 95 % of it would be if it \
                 were the noise of the sensors alone."
            ),
        )?,
    ])
}

/// First row of the window in which values vary most. At rest much may be missing, and nothing of
/// its cause is seen.
fn liveliest(values: &[f64], window: usize) -> usize {
    let n = window as f64;
    let variation = |sum: f64, squares: f64| squares - sum * sum / n;
    let first = values.iter().take(window);
    let (mut sum, mut squares) = (first.clone().sum(), first.map(|value| value * value).sum());
    let (mut most, mut start) = (variation(sum, squares), 0);
    for end in window..values.len() {
        let (new, old) = (values[end], values[end - window]);
        sum += new - old;
        squares += new * new - old * old;
        let now = variation(sum, squares);
        if now > most {
            (most, start) = (now, end + 1 - window);
        }
    }
    start
}

/// The measured force, for what the residual compares with.
fn force(residuals: &Residuals, record: &str) -> Result<IdentificationFigure, ReportError> {
    let measured = residuals.measured;
    let time = measured.at_rows(&measured.time);
    let reading = measured.filtered(measured.cell.as_deref().unwrap_or(&measured.command));
    let (title, what) = match measured.cell {
        Some(_) => ("Measured force", "force cell"),
        None => ("Force that was commanded", "force command"),
    };
    let mut chart = Chart::new(
        format!("{title}, {record} record"),
        "time, s",
        axis(residuals.joint, "force, N"),
    );
    chart.zooms_with = Some(record.to_owned());
    chart.add(what, 4, Style::Line, points(&time, &reading));
    IdentificationFigure::new(
        "force_measured",
        FigureGroup::Comparison,
        chart,
        format!(
            "The {what} through the zero-phase lowpass. The models follow it to what the figures \
             of the residual show; on this scale nothing of that is seen."
        ),
    )
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
    let (before, after) = (scaled(&error.before), scaled(&error.after));
    pair(&mut chart, &time, &before, &after, 0.0, [1, 0]);
    IdentificationFigure::new(
        "position_error_in_closed_loop",
        FigureGroup::Comparison,
        chart,
        "Simulated loop (identified or declared stage, recorded setpoint, controller found from \
         the record) less recorded encoder.",
    )
}

fn over_time(
    residuals: &Residuals,
    record: &str,
) -> Result<Vec<IdentificationFigure>, ReportError> {
    let time = residuals.measured.at_rows(&residuals.measured.time);
    residuals
        .sides()
        .into_iter()
        .map(|Side { name: side, before, after, floor, colours }| {
            let title = format!("Residual over time, {side}, {record} record");
            let mut chart = residuals.chart(title, record, floor);
            pair(&mut chart, &time, before, after, floor, colours);
            let law = match side {
                "motor side" => "cell less command and motor effects",
                _ => "mass times acceleration plus friction less effects and measured force",
            };
            let name = format!(
                "residual_over_time_{}_{}",
                side.replace(' ', "_"),
                record.replace('-', "")
            );
            let caption =
                format!("Force that the models miss on the {side} ({law}), {record} record.");
            IdentificationFigure::new(name, FigureGroup::Residual, chart, caption)
        })
        .collect()
}

/// What a model misses on one side.
struct MissingCurve<'a> {
    name: String,
    colour: usize,
    values: &'a [f64],
    side: &'static str,
    is_before: bool,
}

/// What both models miss on all sides: that of the declared one first, so that what is left lies
/// above it. One curve where both are the same.
fn before_then_after<'a>(sides: &[Side<'a>]) -> Vec<MissingCurve<'a>> {
    let of = |is_before: bool| {
        sides.iter().filter_map(move |side| {
            let is_same = alike(side.before, side.after, side.floor);
            if is_same && !is_before {
                return None;
            }
            let (values, when) = match is_before {
                true if is_same => (side.before, "before and after"),
                true => (side.before, "before"),
                false => (side.after, "after"),
            };
            Some(MissingCurve {
                name: format!("{}, {when}", side.name),
                colour: side.colours[usize::from(is_same || !is_before)],
                values,
                side: side.name,
                is_before,
            })
        })
    };
    of(true).chain(of(false)).collect()
}

/// Part of the noise by which two curves may differ that are drawn as one.
const ALIKE: f64 = 0.1;

/// Whether two curves differ nowhere by more than a part of this noise, rms.
fn alike(before: &[f64], after: &[f64], noise: f64) -> bool {
    let near = |(a, b): (&f64, &f64)| a == b || (a - b).abs() <= ALIKE * noise;
    before.iter().zip(after).all(near)
}

/// Before and after in one chart; one line where they differ by less than a part of the noise.
/// `colours` are those before and after of its side, the same in all figures.
fn pair(
    chart: &mut Chart,
    time: &[f64],
    before: &[f64],
    after: &[f64],
    noise: f64,
    colours: [usize; 2],
) {
    if alike(before, after, noise) {
        chart.add("before and after", colours[1], Style::Line, points(time, after));
    } else {
        chart.add("before", colours[0], Style::Line, points(time, before));
        chart.add("after", colours[1], Style::Line, points(time, after));
    }
}

fn points(time: &[f64], values: &[f64]) -> impl Iterator<Item = (f64, f64)> {
    time.iter().copied().zip(values.iter().copied())
}

fn spectra(
    residuals: &Residuals,
    model: &StageModel,
) -> Result<Vec<IdentificationFigure>, ReportError> {
    let measured = residuals.measured;
    let (position, velocity) =
        (measured.at_rows(&measured.position), measured.at_rows(&measured.velocity));
    let label = |text: &str| axis(residuals.joint, text);
    let mut time = Chart::new("Spectrum over time", "frequency, Hz", label("amplitude, N/√Hz"))
        .logarithmic(true, true);
    let mut space =
        Chart::new("Spectrum over position", label("period, mm"), label("amplitude, N"))
            .logarithmic(true, false);
    let density = residuals.noise_density();
    // The lowpass takes what is left of the highest frequencies to nothing, which is no result.
    time.y_from = (density > 0.0 && density.is_finite()).then_some(BELOW_NOISE * density);
    let sides = residuals.sides();
    let way = 1e3 * range_of(&position);
    // Peaks of the other side would lie on those of the one that matters.
    let labelled = residuals.worst().map(|side| side.name);
    for MissingCurve { name, colour, values, side, is_before } in before_then_after(&sides) {
        let density = spectrum::over_time(measured, values);
        let over =
            spectrum::over_position(&position, &velocity, measured.lowpass.kept_rate(), values);
        let mut over: Vec<(f64, f64)> =
            over.into_iter().map(|(period, amplitude)| (period * 1e3, amplitude)).collect();
        over.sort_by(|a, b| a.0.total_cmp(&b.0));
        if is_before && labelled == Some(side) {
            // Two frequencies nearer than this are one peak.
            let apart = density.get(1).map_or(0.0, |second| second.0 - density[0].0);
            for peak in peaks(&density) {
                let at = known(peak.0, apart, "frequency", 1.0, model);
                let figures = if at.is_some() { 3 } else { 2 };
                time.label(peak, format!("{} Hz", in_figures(at.unwrap_or(peak.0), figures)));
            }
            for peak in peaks(&over) {
                // And two periods, of which one cycle more or less fits on the way.
                let apart = peak.0 * peak.0 / way;
                let at = known(peak.0, apart, "period", 1e3, model);
                let unit = residuals.joint.unit("mm");
                let digits = if at.is_some() { 3 } else { 2 };
                space.label(peak, format!("{} {unit}", in_figures(at.unwrap_or(peak.0), digits)));
            }
        }
        time.add(name.clone(), colour, Style::Line, density);
        space.add(name, colour, Style::Line, over);
    }
    let mut families = Families::default();
    // The fundamental before its harmonics.
    let number = |effect: &EffectParameters, name: &str| effect.values.get(name)?.number();
    let mut effects: Vec<&EffectParameters> = model.effects.iter().collect();
    effects.sort_by(|a, b| {
        let order = |effect| {
            let period = number(effect, "period").map_or(0.0, |period| -period);
            (period, number(effect, "frequency").unwrap_or(0.0))
        };
        let (a, b) = (order(a), order(b));
        a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    for effect in effects {
        let value = |name: &str| number(effect, name);
        let name = effect.name.replace('_', " ");
        // One that is 0 is that of no ripple.
        if let Some(period) = value("period").filter(|period| *period > 0.0) {
            let length = in_prefix_short(period, &residuals.joint.unit("m"));
            let (label, colour) = families.of(&name, 1.0 / period, &length);
            space.coloured_line(label, Axis::X, 1e3 * period, colour);
        }
        if let Some(frequency) = value("frequency").filter(|frequency| *frequency > 0.0) {
            let (label, colour) = families.of(&name, frequency, &format!("{frequency:.1} Hz"));
            time.coloured_line(label, Axis::X, frequency, colour);
        }
    }
    Ok(vec![
        IdentificationFigure::new(
            "spectrum_over_time",
            FigureGroup::Spectrum,
            time,
            "Residual of the train record over frequency (Welch). A line at one frequency whatever \
             the speed comes from time: a vibration, a resonance.",
        )?,
        IdentificationFigure::new(
            "spectrum_over_position",
            FigureGroup::Spectrum,
            space,
            "Residual of the train record over period in position, moving rows only (best sine of \
             each period). A line comes from something that repeats along the way: a magnet pitch, \
             a ball, a scale.",
        )?,
    ])
}

/// The effects of a spectrum by their fundamentals.
#[derive(Default)]
struct Families {
    /// Name, frequency in time or position, colour.
    known: Vec<(String, f64, usize)>,
}

/// Colours of their lines: grey, and those that no curve of a spectrum has.
const FAMILIES: [usize; 4] = [4, 2, 3, 7];
/// Part of a harmonic's place by which it may be off a whole multiple.
const WHOLE_WITHIN: f64 = 0.02;

impl Families {
    /// Name in the legend and colour of an effect's line: a harmonic of one that is known has its
    /// colour, and the number of the harmonic for a name.
    fn of(&mut self, name: &str, frequency: f64, place: &str) -> (String, usize) {
        let order = |fundamental: f64| {
            let ratio = frequency / fundamental;
            let whole = ratio.round();
            (whole >= 2.0 && (ratio / whole - 1.0).abs() < WHOLE_WITHIN).then_some(whole)
        };
        let family = self.known.iter().find_map(|(of, fundamental, colour)| {
            let order = (of == name).then(|| order(*fundamental)).flatten()?;
            Some((order, *colour))
        });
        match family {
            Some((order, colour)) => {
                let which = harmonic_name(order as u32);
                (format!("its {which} harmonic, {place}"), colour)
            }
            None => {
                let colour = FAMILIES[self.known.len() % FAMILIES.len()];
                self.known.push((name.to_owned(), frequency, colour));
                (format!("{name}, {place}"), colour)
            }
        }
    }
}

/// Part of a peak's place by which an effect may be off that it is the peak of.
const KNOWN_WITHIN: f64 = 0.1;

/// The value of a parameter of an effect, in a unit of so many to its own, that a peak may be: the
/// nearest of those that are no farther from it than what the record can tell apart.
fn known(peak: f64, apart: f64, name: &str, scale: f64, model: &StageModel) -> Option<f64> {
    let values = model.effects.iter().filter_map(|effect| effect.values.get(name)?.number());
    // One that is 0 is that of no ripple.
    let there = values.map(|value| scale * value).filter(|value| *value > 0.0);
    let near = there.filter(|value| (value - peak).abs() <= apart.min(KNOWN_WITHIN * peak));
    near.min_by(|a, b| (a - peak).abs().total_cmp(&(b - peak).abs()))
}

/// A number in so many significant figures, with those that are 0 at its end.
fn in_figures(value: f64, figures: i32) -> String {
    let decimals = (figures - 1 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    format!("{value:.decimals$}")
}

/// Largest less smallest of the values, of those that are finite.
fn range_of(values: &[f64]) -> f64 {
    let finite = values.iter().copied().filter(|value| value.is_finite());
    let (low, high) = finite
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), value| (l.min(value), h.max(value)));
    (high - low).max(0.0)
}

/// A bin of a coordinate; `NaN` for what there is none of.
#[derive(Clone, Copy, Debug)]
struct Bin {
    /// Mean of the coordinate in it.
    place: f64,
    mean: f64,
    rms: f64,
    /// Number of its rows.
    rows: f64,
}

impl Bin {
    fn gap(place: f64) -> Bin {
        Bin { place, mean: f64::NAN, rms: f64::NAN, rows: f64::NAN }
    }
}

/// The bins of a coordinate. A bin ends where it has its share of the rows,
/// so that a few far rows do not leave one bin to all others, and at the latest where it is as wide
/// as it may be. `NaN` for one that holds too few rows and for a gap, so that no line goes through
/// what was not there. Widths are those on the scale of the axis.
fn binned(along: &[f64], values: &[f64], scale: Scale) -> Vec<Bin> {
    let mut rows: Vec<(f64, f64)> =
        along.iter().copied().zip(values.iter().copied()).filter(|row| row.0.is_finite()).collect();
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (Some((low, _)), Some((high, _))) = (rows.first(), rows.last()) else { return Vec::new() };
    if high <= low {
        return Vec::new();
    }
    let apart = |from: f64, to: f64| scale.place(to) - scale.place(from);
    let [widest, narrowest] = BINS.map(|count| apart(*low, *high) / count);
    let share = (rows.len() / BINS[0] as usize).max(LEAST_IN_BIN);
    let mut bins = Vec::new();
    let mut rest = rows.as_slice();
    while let Some((from, _)) = rest.first() {
        let belongs = |(index, row): &(usize, &(f64, f64))| {
            let width = apart(*from, row.0);
            width < narrowest
                || (*index < share && width < widest)
                || (*index < LEAST_IN_BIN && width < SPARSE * widest)
        };
        let (bin, after) =
            rest.split_at(rest.iter().enumerate().take_while(belongs).count().max(1));
        let n = bin.len() as f64;
        let place = bin.iter().map(|row| row.0).sum::<f64>() / n;
        let n = if bin.len() < LEAST_IN_BIN { f64::NAN } else { n };
        let sum: f64 = bin.iter().map(|row| row.1).sum();
        let squares: f64 = bin.iter().map(|row| row.1 * row.1).sum();
        bins.push(Bin { place, mean: sum / n, rms: (squares / n).sqrt(), rows: n });
        if let (Some(last), Some(next)) = (bin.last(), after.first())
            && apart(last.0, next.0) > widest
        {
            bins.push(Bin::gap(0.5 * (last.0 + next.0)));
        }
        rest = after;
    }
    bins
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_close_up_shows_where_something_moves() {
        // A large constant, then a small sine, then the constant again.
        let value = |k: usize| if (400..500).contains(&k) { (k as f64).sin() } else { 50.0 };
        let values: Vec<f64> = (0..1000).map(value).collect();
        let inner: Vec<f64> =
            values[..480].iter().map(|v| if *v == 50.0 { 5.0 } else { *v }).collect();
        assert!((300..=500).contains(&liveliest(&values, 100)));
        assert!((300..=400).contains(&liveliest(&inner, 60)));
        assert_eq!(liveliest(&[1.0; 50], 10), 0);
    }

    #[test]
    fn the_harmonics_of_a_ripple_are_of_its_family() {
        let mut families = Families::default();
        let of = |families: &mut Families, name, period: f64| families.of(name, 1.0 / period, "p");
        let first = of(&mut families, "cogging", 24e-3);
        assert_eq!(first, ("cogging, p".to_owned(), FAMILIES[0]));
        let second = of(&mut families, "cogging", 11.99e-3);
        assert_eq!(second, ("its second harmonic, p".to_owned(), FAMILIES[0]));
        for (name, period) in [("cogging", 15e-3), ("ball passage", 12e-3)] {
            let (label, colour) = of(&mut families, name, period);
            assert!(label.starts_with(name) && colour != FAMILIES[0], "{label}");
        }
    }

    #[test]
    fn few_far_rows_do_not_hide_the_curve_of_the_others() {
        let near = (0..4000).map(|k| f64::from(k) * 1e-3 - 2.0);
        let far = [-300.0, -250.0].into_iter().chain((0..8).map(|k| 290.0 + 0.1 * f64::from(k)));
        let along: Vec<f64> = near.chain(far).collect();
        let values: Vec<f64> = along.iter().map(|at| at.sin()).collect();
        let bins = binned(&along, &values, Scale::Linear);
        assert!(bins.is_sorted_by(|a, b| a.place < b.place) && bins.len() < 200, "{}", bins.len());
        let within: Vec<_> = bins.iter().filter(|bin| bin.place.abs() < 2.0).collect();
        let is_near = |bin: &&Bin| (bin.mean - bin.place.sin()).abs() < 0.05;
        assert!(within.len() > 12 && within.iter().all(is_near));
        // Two rows at a place are no curve, eight are; nothing joins them.
        let shown: Vec<bool> = bins.iter().map(|bin| bin.mean.is_finite()).collect();
        assert!(!shown[0] && shown[shown.len() - 1]);
        assert!(shown.windows(2).filter(|two| two[0] != two[1]).count() >= 3);
        assert!(binned(&[1.0; 50], &[2.0; 50], Scale::Linear).is_empty());
        assert!(binned(&[], &[], Scale::of_both_signs(&[])).is_empty());
        // On a scale of both signs a wide bin of far rows is parted: 40 rows over two decades.
        let far = (0..40).map(|k| 10.0 * 1.12f64.powi(k));
        let along: Vec<f64> = along.into_iter().filter(|at| at.abs() < 2.0).chain(far).collect();
        let of = |scale| binned(&along, &vec![1.0; along.len()], scale);
        let seen = |bins: &[Bin]| {
            bins.iter().filter(|bin| bin.place > 10.0 && bin.mean.is_finite()).count()
        };
        let (even, both) = (of(Scale::Linear), of(Scale::of_both_signs(&along)));
        assert!(seen(&both) > seen(&even), "{} and {}", seen(&even), seen(&both));
    }
}
