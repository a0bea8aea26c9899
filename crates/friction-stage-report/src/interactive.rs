//! Charts as data for the plots of a page: columns of numbers, each once, and what is drawn of
//! them.
//!
//! What comes in are charts, what goes out is JSON that `assets/plot.js` draws with uPlot. A column
//! that grows evenly is its start and step; a long one is 32-bit counts of its range, a short one
//! 64-bit numbers, both in base64. All points are in the page: decimation is for the width of a
//! screen and the range that it shows, and happens there.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;

use crate::chart::{Axis, Chart, Scale, Style, decimated};

/// uPlot 1.6.32 (MIT licence, Leon Sorokin), as published.
pub const LIBRARY: &str = include_str!("../assets/uplot-1.6.32/uPlot.iife.min.js");
/// Its style.
pub const LIBRARY_STYLE: &str = include_str!("../assets/uplot-1.6.32/uPlot.min.css");
/// Its licence.
pub const LIBRARY_LICENCE: &str = include_str!("../assets/uplot-1.6.32/LICENSE");
/// How this page and the live one draw curves with it.
pub const CURVES: &str = include_str!("../assets/curves.js");
/// What draws the charts of a page.
pub const SCRIPT: &str = include_str!("../assets/plot.js");

/// Columns from this length on are counts of their range: half the bytes, and finer than any
/// screen. Shorter ones keep every bit.
const LONG: usize = 10_000;
/// Points of a series above which it is decimated here: four times 10^6 samples.
const MOST: usize = 1 << 22;
/// A step is even if no value is farther than this part of it from its place.
const EVEN: f64 = 1e-6;

/// A column of numbers as a page holds it.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
enum Column {
    /// start + step k.
    Even { n: usize, start: f64, step: f64 },
    /// low + step c; the least integer stands for no value.
    Counts { n: usize, low: f64, step: f64, i32: String },
    /// As they are.
    Numbers { n: usize, f64: String },
}

impl Column {
    fn new(values: &[f64]) -> Column {
        let n = values.len();
        if let [start, .., last] = *values {
            let step = (last - start) / (n - 1) as f64;
            let even = |(k, value): (usize, &f64)| {
                (start + step * k as f64 - value).abs() <= EVEN * step.abs()
            };
            if n > 2 && step > 0.0 && values.iter().enumerate().all(even) {
                return Column::Even { n, start, step };
            }
        }
        if n < LONG {
            let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
            return Column::Numbers { n, f64: STANDARD.encode(bytes) };
        }
        let finite = values.iter().copied().filter(|value| value.is_finite());
        let (low, high) = finite
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), value| (l.min(value), h.max(value)));
        let (low, high) = if low <= high { (low, high) } else { (0.0, 0.0) };
        let middle = 0.5 * (low + high);
        let step = ((high - low) / (2.0 * (f64::from(i32::MAX) - 1.0))).max(f64::MIN_POSITIVE);
        let count = |value: &f64| match value.is_finite() {
            // Within the range of an i32 by the choice of the step.
            true => ((value - middle) / step).round() as i32,
            false => i32::MIN,
        };
        let bytes: Vec<u8> = values.iter().flat_map(|value| count(value).to_le_bytes()).collect();
        Column::Counts { n, low: middle, step, i32: STANDARD.encode(bytes) }
    }
}

/// The columns of a page.
#[derive(Clone, Debug, Default)]
pub struct Columns {
    columns: Vec<Column>,
}

#[derive(Serialize)]
struct Drawn<'a> {
    title: &'a str,
    x: Along<'a>,
    y: Along<'a>,
    series: Vec<Curve<'a>>,
    bands: Vec<Range<'a>>,
    labels: Vec<Label<'a>>,
    group: Option<&'a str>,
}

#[derive(Serialize)]
struct Along<'a> {
    label: &'a str,
    log: bool,
    /// Distance from zero up to which it is even, where it is logarithmic beyond.
    even: Option<f64>,
    /// A value that is shown in any case.
    least: Option<f64>,
    /// Where a logarithmic axis begins at the lowest.
    from: Option<f64>,
    names: &'a [String],
}

impl<'a> Along<'a> {
    fn new(label: &'a str, scale: Scale, names: &'a [String]) -> Along<'a> {
        let even = match scale {
            Scale::Asinh(even) => Some(even),
            Scale::Linear | Scale::Log => None,
        };
        Along { label, log: scale == Scale::Log, even, least: None, from: None, names }
    }
}

#[derive(Serialize)]
struct Curve<'a> {
    name: &'a str,
    colour: usize,
    line: bool,
    /// Whether it is thin and dashed.
    dashed: bool,
    /// Diameter of its marks, px; 0 for none.
    marks: i32,
    /// Whether they are rings.
    open: bool,
    /// Places of its columns.
    x: usize,
    y: usize,
}

#[derive(Serialize)]
struct Range<'a> {
    name: &'a str,
    axis: &'static str,
    low: f64,
    high: f64,
    /// Place in the palette.
    colour: usize,
}

#[derive(Serialize)]
struct Label<'a> {
    x: f64,
    y: f64,
    text: &'a str,
}

impl Columns {
    fn add(&mut self, values: &[f64]) -> usize {
        let column = Column::new(values);
        self.columns.iter().position(|known| *known == column).unwrap_or_else(|| {
            self.columns.push(column);
            self.columns.len() - 1
        })
    }

    /// The chart over these columns as JSON, safe inside HTML; none for a chart of loops, which
    /// have several values at an abscissa.
    pub fn chart(&mut self, chart: &Chart) -> Option<String> {
        if !chart.goes_right() || chart.series.iter().all(|series| series.points.is_empty()) {
            return None;
        }
        let chart = chart.readable();
        let mut series = Vec::with_capacity(chart.series.len());
        for one in &chart.series {
            let fewer;
            let points = if one.points.len() > MOST {
                fewer = decimated(&one.points, MOST / 4);
                &fewer
            } else {
                &one.points
            };
            let part = |part: fn(&(f64, f64)) -> f64| points.iter().map(part).collect::<Vec<_>>();
            series.push(Curve {
                name: &one.name,
                colour: one.colour,
                line: one.style.has_line(),
                dashed: one.style == Style::Dashed,
                marks: one.style.marks().map_or(0, |(radius, _)| 2 * radius),
                open: one.style.marks().is_some_and(|(_, is_open)| is_open),
                x: self.add(&part(|point| point.0)),
                y: self.add(&part(|point| point.1)),
            });
        }
        let bands = chart.bands.iter().enumerate().map(|(index, band)| Range {
            colour: band.palette(index),
            name: &band.name,
            axis: if band.axis == Axis::X { "x" } else { "y" },
            low: band.low,
            high: band.high,
        });
        let labels = chart.labels.iter().map(|label| Label {
            x: label.at.0,
            y: label.at.1,
            text: &label.text,
        });
        let drawn = Drawn {
            title: &chart.title,
            x: Along::new(&chart.x_label, chart.x_scale, &chart.x_names),
            y: Along {
                least: chart.y_least,
                from: chart.y_from,
                ..Along::new(&chart.y_label, chart.y_scale, &[])
            },
            series,
            bands: bands.collect(),
            labels: labels.collect(),
            group: chart.zooms_with.as_deref(),
        };
        Some(in_html(&drawn))
    }

    /// All columns as JSON, safe inside HTML.
    pub fn json(&self) -> String {
        in_html(&self.columns)
    }
}

/// JSON that no markup can end: `<` occurs in strings only, where it may be written as an escape.
fn in_html(data: &impl Serialize) -> String {
    serde_json::to_string(data).expect("numbers and strings are JSON").replace('<', "\\u003c")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_as_short_as_they_may_be_and_each_is_there_once() {
        let even: Vec<f64> = (0..30_000).map(|k| 0.5 + 0.00025 * f64::from(k)).collect();
        assert!(matches!(Column::new(&even), Column::Even { n: 30_000, .. }));
        let wave: Vec<f64> = even.iter().map(|t| (7.0 * t).sin()).collect();
        let Column::Counts { low, step, i32, .. } = Column::new(&wave) else { panic!() };
        let bytes = STANDARD.decode(i32).unwrap();
        for (four, value) in bytes.chunks(4).zip(&wave) {
            let count = i32::from_le_bytes(four.try_into().unwrap());
            assert!((low + step * f64::from(count) - value).abs() <= step);
        }
        let Column::Numbers { f64, .. } = Column::new(&[1.0, f64::NAN, 1e-9]) else { panic!() };
        assert_eq!(STANDARD.decode(f64).unwrap().len(), 24);
        // A constant, nothing but gaps, nothing.
        for odd in [vec![3.0; 20_000], vec![f64::NAN; 20_000], vec![]] {
            let json = serde_json::to_string(&Column::new(&odd)).unwrap();
            assert!(!json.contains("null"), "{}", &json[..json.len().min(80)]);
        }

        let mut chart = Chart::new("</script>", "time, s", "N");
        for colour in 0..2 {
            let points = even.iter().copied().zip(wave.iter().copied());
            chart.add("a", colour, Style::Line, points);
        }
        let mut columns = Columns::default();
        let json = columns.chart(&chart).unwrap();
        assert!(!json.contains('<') && columns.columns.len() == 2);
        chart.add("loop", 0, Style::Line, [(0.0, 1.0), (1.0, 2.0), (0.5, 3.0)]);
        assert_eq!(columns.chart(&chart), None);
    }
}
