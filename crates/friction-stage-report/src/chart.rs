//! One pair of axes with lines and marks, linear or logarithmic, as SVG.

use plotters::coord::ranged1d::{AsRangedCoord, Ranged, ValueFormatter};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::figure::FigureError;

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// A line.
    Line,
    /// Thin and dashed: a prediction beside a measurement.
    Dashed,
    /// Marks at its points.
    Marks,
    /// A line with marks at its points.
    Both,
}

/// A named series of (x, y) points.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Name in the legend; empty for none.
    pub name: String,
    /// Its points; those that are not finite are left out.
    pub points: Vec<(f64, f64)>,
    /// How it is drawn.
    pub style: Style,
    /// Index into the palette; series of one colour belong together.
    pub colour: usize,
}

/// A figure.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// Title above the axes.
    pub title: String,
    /// Quantity and unit along the abscissa.
    pub x_label: String,
    /// Quantity and unit along the ordinate.
    pub y_label: String,
    /// Whether the abscissa is logarithmic.
    pub x_log: bool,
    /// Whether the ordinate is logarithmic.
    pub y_log: bool,
    /// What is drawn, in this order.
    pub series: Vec<Series>,
}

/// Size of a figure, px, and of the legend at its right.
const SIZE: (u32, u32) = (900, 420);
const LEGEND: u32 = 190;
/// Colours that stay apart for colour-blind readers (Okabe, Ito 2008).
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(90, 90, 90),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
];
/// Most points of a series that are drawn.
const MOST: usize = 2500;

type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;
type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

impl Chart {
    /// A chart without series, with linear axes.
    pub fn new(
        title: impl Into<String>,
        x_label: impl Into<String>,
        y_label: impl Into<String>,
    ) -> Chart {
        Chart {
            title: title.into(),
            x_label: x_label.into(),
            y_label: y_label.into(),
            x_log: false,
            y_log: false,
            series: Vec::new(),
        }
    }

    /// The same with logarithmic axes.
    pub fn logarithmic(mut self, x: bool, y: bool) -> Chart {
        (self.x_log, self.y_log) = (x, y);
        self
    }

    /// Adds a series.
    pub fn add(
        &mut self,
        name: impl Into<String>,
        colour: usize,
        style: Style,
        points: impl IntoIterator<Item = (f64, f64)>,
    ) {
        self.series.push(Series {
            name: name.into(),
            points: points.into_iter().collect(),
            style,
            colour,
        });
    }

    /// The figure as an SVG document. Points that are not finite, or not positive on a logarithmic
    /// axis, are left out.
    pub fn svg(&self) -> Result<String, FigureError> {
        let failed = |error: DrawingAreaErrorKind<std::io::Error>| FigureError {
            title: self.title.clone(),
            reason: error.to_string(),
        };
        let mut text = String::new();
        {
            let root = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
            root.fill(&WHITE).map_err(failed)?;
            let (x, y) = (self.range(|p| p.0, self.x_log), self.range(|p| p.1, self.y_log));
            match (self.x_log, self.y_log) {
                (false, false) => self.draw(&root, x, y),
                (true, false) => self.draw(&root, x.log_scale(), y),
                (false, true) => self.draw(&root, x, y.log_scale()),
                (true, true) => self.draw(&root, x.log_scale(), y.log_scale()),
            }
            .map_err(failed)?;
            root.present().map_err(failed)?;
        }
        Ok(text)
    }

    fn shown(&self, point: &(f64, f64)) -> bool {
        let fine = |value: f64, log: bool| value.is_finite() && (!log || value > 0.0);
        fine(point.0, self.x_log) && fine(point.1, self.y_log)
    }

    fn range(&self, part: fn(&(f64, f64)) -> f64, log: bool) -> std::ops::Range<f64> {
        let points = self
            .series
            .iter()
            .flat_map(|series| &series.points)
            .filter(|point| self.shown(point))
            .map(part);
        let (low, high) = points.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        });
        match low.partial_cmp(&high) {
            Some(std::cmp::Ordering::Less) if log => {
                let margin = (high / low).powf(0.04);
                low / margin..high * margin
            }
            Some(std::cmp::Ordering::Less) => low - 0.04 * (high - low)..high + 0.04 * (high - low),
            Some(std::cmp::Ordering::Equal) if log => 0.5 * low..2.0 * low,
            Some(std::cmp::Ordering::Equal) => low - 1.0..high + 1.0,
            _ => 1.0..10.0,
        }
    }

    fn draw<X, Y>(&self, area: &Area, x: X, y: Y) -> Drawn
    where
        X: AsRangedCoord<Value = f64>,
        Y: AsRangedCoord<Value = f64>,
        X::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
        Y::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
    {
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, ("sans-serif", 18))
            .margin(12)
            .margin_right(LEGEND)
            .x_label_area_size(44)
            .y_label_area_size(72)
            .build_cartesian_2d(x, y)?;
        chart
            .configure_mesh()
            .x_desc(&self.x_label)
            .y_desc(&self.y_label)
            .x_labels(9)
            .y_labels(8)
            .x_label_formatter(&|value| number(*value))
            .y_label_formatter(&|value| number(*value))
            .light_line_style(WHITE)
            .bold_line_style(BLACK.mix(0.12))
            .label_style(("sans-serif", 13))
            .axis_desc_style(("sans-serif", 14))
            .draw()?;
        for series in &self.series {
            let colour = COLOURS[series.colour % COLOURS.len()];
            let points: Vec<(f64, f64)> =
                series.points.iter().copied().filter(|point| self.shown(point)).collect();
            let every = points.len().div_ceil(MOST).max(1);
            let points: Vec<(f64, f64)> = points.into_iter().step_by(every).collect();
            match series.style {
                Style::Line => {
                    chart.draw_series(LineSeries::new(points, colour.stroke_width(2)))?;
                }
                Style::Dashed => {
                    chart.draw_series(DashedLineSeries::new(
                        points,
                        5,
                        4,
                        colour.stroke_width(1),
                    ))?;
                }
                Style::Marks => {
                    chart.draw_series(
                        points.into_iter().map(|point| Circle::new(point, 3, colour.filled())),
                    )?;
                }
                Style::Both => {
                    chart.draw_series(LineSeries::new(
                        points.iter().copied(),
                        colour.stroke_width(2),
                    ))?;
                    chart.draw_series(
                        points.into_iter().map(|point| Circle::new(point, 3, colour.filled())),
                    )?;
                }
            }
        }
        let style =
            ("sans-serif", 13).into_text_style(area).pos(Pos::new(HPos::Left, VPos::Center));
        let left = (SIZE.0 - LEGEND) as i32 + 12;
        for (index, series) in
            self.series.iter().filter(|series| !series.name.is_empty()).enumerate()
        {
            let y = 56 + 20 * index as i32;
            let colour = COLOURS[series.colour % COLOURS.len()];
            match series.style {
                Style::Line => area
                    .draw(&PathElement::new([(left, y), (left + 22, y)], colour.stroke_width(2)))?,
                Style::Dashed => {
                    for dash in [0, 9, 18] {
                        let x = left + dash;
                        area.draw(&PathElement::new([(x, y), (x + 5, y)], colour.stroke_width(1)))?;
                    }
                }
                Style::Marks => area.draw(&Circle::new((left + 11, y), 3, colour.filled()))?,
                Style::Both => {
                    area.draw(&PathElement::new(
                        [(left, y), (left + 22, y)],
                        colour.stroke_width(2),
                    ))?;
                    area.draw(&Circle::new((left + 11, y), 3, colour.filled()))?;
                }
            }
            area.draw(&Text::new(series.name.clone(), (left + 28, y), style.clone()))?;
        }
        Ok(())
    }
}

/// A number as an axis shows it: short, and a power where it is very large or very small.
fn number(value: f64) -> String {
    let size = value.abs();
    if size < 1e-12 {
        "0".to_owned()
    } else if (1e-3..1e5).contains(&size) {
        format!("{}", (value * 1e6).round() / 1e6)
    } else {
        format!("{value:.1e}").replace(".0e", "e")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_of_axis_and_style_is_drawn() {
        for (x, y) in [(false, false), (true, false), (false, true), (true, true)] {
            let mut chart = Chart::new("stiffness <1>", "amplitude, um", "N/m").logarithmic(x, y);
            for (colour, style) in
                [Style::Line, Style::Dashed, Style::Marks, Style::Both].into_iter().enumerate()
            {
                let curve = (0..5000).map(|k| (k as f64 * 0.01 - 1.0, (k as f64 * 0.01).powi(2)));
                chart.add(
                    format!("series {colour}"),
                    colour,
                    style,
                    curve.chain([(f64::NAN, 1.0)]),
                );
            }
            let text = chart.svg().unwrap();
            for words in ["stiffness &lt;1&gt;", "amplitude, um", "series 3", "#009E73"] {
                assert!(text.contains(words), "no {words}");
            }
            assert!(!text.contains("NaN") && text.len() < 1_500_000, "{} bytes", text.len());
        }
        assert!(Chart::new("empty", "", "").logarithmic(true, true).svg().is_ok());
    }

    #[test]
    fn axis_numbers_are_short() {
        assert_eq!(
            [0.0, 0.5, 1e-8, 2.5e5, 1000.0].map(number),
            ["0", "0.5", "1e-8", "2.5e5", "1000"]
        );
    }
}
