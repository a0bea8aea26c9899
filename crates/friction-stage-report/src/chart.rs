//! One pair of axes with lines, marks, bands and labels, linear or logarithmic: as SVG for print,
//! and as data for the plots of a page that zoom ([`super::interactive`]).

use std::borrow::Cow;

use plotters::coord::ranged1d::{
    AsRangedCoord, KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter,
};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::figure::FigureError;
use super::room::{Rect, Room, places_at};
use super::text_width::text_width;
use friction_stage_core::numerics::rounded;

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// A line.
    Line,
    /// Thin and dashed: what a curve is compared with and is no result itself, such as a reference
    /// or a law. Nothing else is dashed.
    Dashed,
    /// Marks at its points.
    Marks,
    /// A line with marks at its points.
    Both,
    /// Open marks around its points: stated values, with the measured ones inside where they agree.
    Rings,
}

impl Style {
    /// Whether its points are joined.
    pub(crate) fn has_line(self) -> bool {
        !matches!(self, Style::Marks | Style::Rings)
    }

    /// Radius of its marks, px, and whether they are open.
    pub(crate) fn marks(self) -> Option<(i32, bool)> {
        match self {
            Style::Line | Style::Dashed => None,
            Style::Marks | Style::Both => Some((3, false)),
            Style::Rings => Some((6, true)),
        }
    }
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

/// An axis of a chart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// The abscissa.
    X,
    /// The ordinate.
    Y,
}

/// A range of an axis that means something: what noise alone makes, what counts as settled. A
/// dotted line where both ends are the same; a level, a line along the abscissa, has its name where
/// it is drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Band {
    /// Name in the legend, or at a level.
    pub name: String,
    /// Along which axis its ends are.
    pub axis: Axis,
    /// Its lower end.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
    /// Index into the palette; without one a line is grey, and a band has a colour that no series
    /// in front has.
    pub colour: Option<usize>,
}

/// A word at a point, for a peak.
#[derive(Clone, Debug, PartialEq)]
pub struct PointLabel {
    /// The point.
    pub at: (f64, f64),
    /// The word.
    pub text: String,
}

/// How the values of an axis are spread along it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scale {
    /// Evenly.
    Linear,
    /// By their logarithm; only positive values have a place.
    Log,
    /// Evenly near zero and by their logarithm from about this distance on, on both sides (inverse
    /// hyperbolic sine).
    Asinh(f64),
}

impl Scale {
    /// The scale on which both the many small and the few large of these values are seen: even up
    /// to their median size, or a thousandth of the largest.
    pub fn of_both_signs(values: &[f64]) -> Scale {
        let mut sizes: Vec<f64> =
            values.iter().filter(|value| value.is_finite()).map(|value| value.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let largest = sizes.last().copied().unwrap_or(0.0);
        let even = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0).max(1e-3 * largest);
        if even > 0.0 { Scale::Asinh(even) } else { Scale::Linear }
    }

    /// Where a value is along the axis, in units of the scale's own.
    pub fn place(self, value: f64) -> f64 {
        match self {
            Scale::Linear => value,
            Scale::Log => value.ln(),
            Scale::Asinh(even) => (value / even).asinh(),
        }
    }

    /// The value at a place.
    fn value(self, place: f64) -> f64 {
        match self {
            Scale::Linear => place,
            Scale::Log => place.exp(),
            Scale::Asinh(even) => even * place.sinh(),
        }
    }

    /// Whether a value has a place.
    fn has(self, value: f64) -> bool {
        value.is_finite() && (self != Scale::Log || value > 0.0)
    }
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
    /// How values are spread along the abscissa.
    pub x_scale: Scale,
    /// How values are spread along the ordinate.
    pub y_scale: Scale,
    /// What is drawn, in this order.
    pub series: Vec<Series>,
    /// Drawn below the series.
    pub bands: Vec<Band>,
    /// Drawn above the series; of two that would overlap, the first.
    pub labels: Vec<PointLabel>,
    /// Charts of one page with the same word here zoom together.
    pub zooms_with: Option<String>,
    /// Names in the place of the numbers 1, 2, ... of the abscissa; empty for numbers.
    pub x_names: Vec<String>,
    /// What the abscissa of a drawing shows at least, points or not.
    pub x_least: Option<(f64, f64)>,
    /// A value that the ordinate shows in any case.
    pub y_least: Option<f64>,
    /// Where a logarithmic ordinate begins at the lowest: what is below is no result.
    pub y_from: Option<f64>,
}

/// Size of a figure, px.
pub(crate) const SIZE: (u32, u32) = (900, 420);
/// Size of the axes of one for a narrow screen, px.
const NARROW: (u32, u32) = (360, 300);
/// Margin of a figure, and room for the ordinate's numbers and its title, px.
const MARGIN: u32 = 12;
const Y_LABELS: u32 = 72;
/// One px in the units of a drawing: its points are whole units, and a curve needs finer ones.
pub(crate) const PX: u32 = 10;
/// Width of the legend at its right: line and margins, and its limits.
const LEGEND: (u32, std::ops::RangeInclusive<u32>) = (54 * PX, 120 * PX..=320 * PX);
/// Size of its font, px.
const LEGEND_FONT: f64 = 13.0;
/// The margin at the right where there is nothing to name: half a number of the abscissa.
const NO_LEGEND: u32 = 24 * PX;
/// Colours that stay apart for colour-blind readers (Okabe, Ito 2008).
/// `page.css` has them, too, and those for a dark ground. The last one is that of the text, for
/// marks that belong to no curve.
pub(crate) const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(90, 90, 90),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(29, 37, 48),
];
/// Colours of bands: those of the series the other way round, since series begin in front.
const BANDS: [usize; 7] = [5, 4, 3, 2, 1, 0, 6];
/// Columns of a figure: of what falls into one, the extremes are drawn.
const COLUMNS: usize = 1000;
/// Colour of a level.
const LEVEL: RGBColor = RGBColor(90, 90, 90);
/// Decades below its highest point that a logarithmic ordinate shows: 240 dB, more than anything
/// measures. What is 0 but for rounding lies below.
const DECADES: i32 = 12;
/// Dash and gap of a thin line, px.
const DASH: [u32; 2] = [5, 4];
/// Dot and gap of a limit or another line across the whole chart, px.
const DOT: [u32; 2] = [2, 3];
/// Its width.
const DOT_WIDTH: u32 = 3 * PX / 2;
/// By how much a line is wider than each line that lies on it, px.
const WIDER: u32 = 2;
/// Room between two numbers of an axis, px.
const BETWEEN_NUMBERS: f64 = 8.0;
/// Room that a number of the abscissa needs, px.
const X_NUMBER: u32 = 50;
/// Height of a word and the size of its font, px.
const WORD: (i32, u32) = (14, 13);
/// A line lies on another where most of its length, seen at so many columns, is no farther from it
/// than this part of the height: the width of a line.
const COMPARED: usize = 100;
const NEAR: f64 = 0.006;
/// Units that take a prefix where their numbers would be powers of ten.
const WITH_PREFIX: [&str; 16] = [
    "N",
    "N rms",
    "N/m",
    "m/N",
    "N/√Hz",
    "N s/m",
    "N/(m s)",
    "J",
    "J per cycle",
    "N m",
    "N m rms",
    "N m/rad",
    "rad/(N m)",
    "N m/√Hz",
    "m",
    "rad",
];
/// Prefixes with their sizes: those of large numbers first.
const PREFIXES: [(f64, &str); 7] =
    [(1e9, "G"), (1e6, "M"), (1e3, "k"), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p")];
/// From where on, and up to where, the numbers of an axis are no powers of ten.
const PLAIN: (f64, f64) = (1e-3, 1e5);
/// Colour of what stands for all dashed curves.
const DASHED_KEY: usize = 4;
/// Radius of a sample that no line joins, px.
const DOT_RADIUS: i32 = 2;
/// Part of a band's colour.
const BAND_OPACITY: f64 = 0.16;

pub(crate) type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;
pub(crate) type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

/// What an axis shows.
type Span = std::ops::Range<f64>;

/// Takes the part of a point that is along an axis.
type PartOfPoint = fn(&(f64, f64)) -> f64;

impl Band {
    /// Whether it is a line along the abscissa.
    pub fn is_level(&self) -> bool {
        self.axis == Axis::Y && self.low == self.high
    }

    /// Its place in the palette as the one of so many.
    pub(crate) fn palette(&self, index: usize) -> usize {
        let default = if self.low == self.high { DASHED_KEY } else { BANDS[index % BANDS.len()] };
        self.colour.unwrap_or(default)
    }

    fn colour(&self, index: usize) -> RGBColor {
        COLOURS[self.palette(index) % COLOURS.len()]
    }
}

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
            x_scale: Scale::Linear,
            y_scale: Scale::Linear,
            series: Vec::new(),
            bands: Vec::new(),
            labels: Vec::new(),
            zooms_with: None,
            x_names: Vec::new(),
            x_least: None,
            y_least: None,
            y_from: None,
        }
    }

    /// The same with names along the abscissa: the first at 1.
    pub fn named(mut self, names: Vec<String>) -> Chart {
        self.x_names = names;
        self
    }

    /// The same with logarithmic axes.
    pub fn logarithmic(mut self, x: bool, y: bool) -> Chart {
        let scale = |log| if log { Scale::Log } else { Scale::Linear };
        (self.x_scale, self.y_scale) = (scale(x), scale(y));
        self
    }

    /// The same with another abscissa.
    pub fn along(mut self, scale: Scale) -> Chart {
        self.x_scale = scale;
        self
    }

    /// Adds a series. One that runs from right to left is drawn as its reverse, which is the same.
    pub fn add(
        &mut self,
        name: impl Into<String>,
        colour: usize,
        style: Style,
        points: impl IntoIterator<Item = (f64, f64)>,
    ) {
        let mut points: Vec<_> = points.into_iter().collect();
        if points.is_sorted_by(|a, b| a.0 > b.0) {
            points.reverse();
        }
        self.series.push(Series { name: name.into(), points, style, colour });
    }

    /// Adds a band.
    pub fn band(&mut self, name: impl Into<String>, axis: Axis, low: f64, high: f64) {
        self.bands.push(Band { name: name.into(), axis, low, high, colour: None });
    }

    /// Adds a line across the whole chart.
    pub fn line(&mut self, name: impl Into<String>, axis: Axis, at: f64) {
        self.band(name, axis, at, at);
    }

    /// Adds such a line in a colour of the palette: those of one colour belong together.
    pub fn coloured_line(&mut self, name: impl Into<String>, axis: Axis, at: f64, colour: usize) {
        let (low, high) = (at, at);
        self.bands.push(Band { name: name.into(), axis, low, high, colour: Some(colour) });
    }

    /// What dashed curves without a name are, for the legend.
    pub fn dashed_are(&mut self, name: impl Into<String>) {
        self.add(name, DASHED_KEY, Style::Dashed, []);
    }

    /// The same in a prefix of its units in which the numbers of its axes need no powers of ten.
    pub(crate) fn readable(&self) -> Cow<'_, Chart> {
        let mut chart = Cow::Borrowed(self);
        for axis in [Axis::X, Axis::Y] {
            if let Some((size, prefix)) = chart.prefix(axis) {
                chart = Cow::Owned(chart.in_units(axis, size, prefix));
            }
        }
        chart
    }

    /// The prefix, with its size, that an axis lacks.
    fn prefix(&self, axis: Axis) -> Option<(f64, &'static str)> {
        let (label, scale) = match axis {
            Axis::X => (&self.x_label, self.x_scale),
            Axis::Y => (&self.y_label, self.y_scale),
        };
        let (_, unit) = label.rsplit_once(", ")?;
        if !WITH_PREFIX.contains(&unit) {
            return None;
        }
        let range = self.range(axis);
        let largest = range.start.abs().max(range.end.abs());
        let (smallest, middle) = match scale {
            Scale::Linear => (largest, largest),
            Scale::Log => (range.start, (range.start * range.end).sqrt()),
            Scale::Asinh(_) => return None,
        };
        let is_plain = |size: f64| smallest / size >= PLAIN.0 && largest / size < PLAIN.1;
        if is_plain(1.0) {
            return None;
        }
        // Of a unit that begins with a length or an angle there are only parts.
        let from = if unit.starts_with(['m', 'r']) { 3 } else { 0 };
        // Between 1 and 1000 where that may be.
        let far = |size: f64| ((middle / size).log10() - 1.5).abs();
        let fit = PREFIXES[from..].iter().copied().filter(|(size, _)| is_plain(*size));
        fit.min_by(|a, b| far(a.0).total_cmp(&far(b.0)))
    }

    /// The same with values of an axis in units of this size.
    fn in_units(&self, axis: Axis, size: f64, prefix: &str) -> Chart {
        let mut chart = self.clone();
        let along = |point: &mut (f64, f64)| match axis {
            Axis::X => point.0 /= size,
            Axis::Y => point.1 /= size,
        };
        chart.series.iter_mut().flat_map(|series| &mut series.points).for_each(along);
        chart.labels.iter_mut().map(|label| &mut label.at).for_each(along);
        for band in chart.bands.iter_mut().filter(|band| band.axis == axis) {
            (band.low, band.high) = (band.low / size, band.high / size);
        }
        let label = match axis {
            Axis::X => {
                chart.x_least = chart.x_least.map(|(low, high)| (low / size, high / size));
                &mut chart.x_label
            }
            Axis::Y => {
                chart.y_least = chart.y_least.map(|least| least / size);
                chart.y_from = chart.y_from.map(|from| from / size);
                &mut chart.y_label
            }
        };
        if let Some((quantity, unit)) = label.rsplit_once(", ") {
            *label = format!("{quantity}, {prefix}{unit}");
        }
        chart
    }

    /// Writes a word at a point.
    pub fn label(&mut self, at: (f64, f64), text: impl Into<String>) {
        self.labels.push(PointLabel { at, text: text.into() });
    }

    /// The name at a value of the abscissa; nothing between two.
    fn x_name(&self, value: f64) -> String {
        let at = value.round();
        let is_at = (value - at).abs() < 1e-6 && at >= 1.0;
        let name = self.x_names.get(at as usize - usize::from(is_at)).filter(|_| is_at);
        name.cloned().unwrap_or_default()
    }

    /// Whether every series goes from left to right: only then its value at an abscissa is one.
    pub fn goes_right(&self) -> bool {
        self.series.iter().all(|series| series.points.is_sorted_by(|a, b| a.0 < b.0))
    }

    /// Series that lie on an earlier one, most of their way and of its way, with that one.
    fn overlaps(&self) -> Vec<(usize, usize)> {
        let axes = (self.range(Axis::X), self.range(Axis::Y));
        // A reference may lie on its curve, and what is measured on its law.
        let kind = |series: &Series| (series.style == Style::Dashed, series.style.has_line());
        let lies_on = |upper: &Series, lower: &Series| {
            kind(upper) == kind(lower)
                && upper.style != Style::Rings
                && upper.colour != lower.colour
                && self.lies_on(upper, lower, &axes)
                && self.lies_on(lower, upper, &axes)
        };
        let of = |upper: usize| {
            let lower =
                (0..upper).filter(move |&lower| lies_on(&self.series[upper], &self.series[lower]));
            lower.map(move |lower| (upper, lower))
        };
        (0..self.series.len()).flat_map(of).collect()
    }

    /// By how much each series is wider than usual, px: one that others lie on shows at their
    /// sides.
    pub(crate) fn wider(&self) -> Vec<u32> {
        let overlaps = self.overlaps();
        let above = |index| overlaps.iter().filter(|(_, lower)| *lower == index).count() as u32;
        (0..self.series.len()).map(|index| WIDER * above(index)).collect()
    }

    /// Which named curves lie on which, as a sentence; none where none does.
    pub(crate) fn overlaps_in_words(&self) -> Option<String> {
        let overlaps = self.overlaps();
        let name = |index: usize| self.series[index].name.as_str();
        let of = |upper: usize| {
            let pairs = overlaps.iter().filter(|pair| pair.0 == upper);
            let lower: Vec<&str> =
                pairs.map(|pair| name(pair.1)).filter(|name| !name.is_empty()).collect();
            let is_told = !lower.is_empty() && !name(upper).is_empty();
            let quoted = |name: &str| format!("\u{201c}{name}\u{201d}");
            let lower: Vec<String> = lower.into_iter().map(quoted).collect();
            is_told.then(|| format!("{} lies on {}", quoted(name(upper)), lower.join(" and on ")))
        };
        let reported: Vec<String> = (0..self.series.len()).filter_map(of).collect();
        let end = "what lies below is drawn wider.";
        (!reported.is_empty()).then(|| format!("Here {}; {end}", reported.join("; ")))
    }

    /// Whether most of the length of a line is where another one is.
    fn lies_on(&self, line: &Series, other: &Series, (x_axis, y_axis): &(Span, Span)) -> bool {
        let at = |point: &(f64, f64)| {
            (area_part(x_axis, point.0, self.x_scale), area_part(y_axis, point.1, self.y_scale))
        };
        let seen = |series: &Series, columns: usize| -> Vec<(f64, f64)> {
            let points = decimated(&series.points, columns).into_iter();
            points.filter(|point| self.shown(point)).collect()
        };
        let rises = |series: &Series| series.points.is_sorted_by(|a, b| a.0 < b.0);
        let is_function = rises(line) && rises(other);
        let along: Vec<(f64, f64)> =
            if is_function { Vec::new() } else { seen(other, COMPARED).iter().map(at).collect() };
        let is_near = |point: &(f64, f64)| match is_function {
            true => height_at(&other.points, point.0)
                .is_some_and(|there| (at(point).1 - at(&(point.0, there)).1).abs() <= NEAR),
            false => {
                let from = at(point);
                along.windows(2).any(|piece| distance(from, piece[0], piece[1]) <= NEAR)
            }
        };
        let (mut near, mut length) = (0.0, 0.0);
        for pair in seen(line, COMPARED).windows(2) {
            let (from, to) = (at(&pair[0]), at(&pair[1]));
            let piece = (to.0 - from.0).hypot(to.1 - from.1);
            length += piece;
            near += if is_near(&pair[0]) && is_near(&pair[1]) { piece } else { 0.0 };
        }
        near > 0.8 * length
    }

    /// The figure as an SVG document. Points that are not finite, or not positive on a logarithmic
    /// axis, are left out.
    pub fn svg(&self) -> Result<String, FigureError> {
        let chart = self.readable();
        document(&self.title, SIZE, |root| chart.draw_on(root, chart.legend_width()))
    }

    /// The figure for a screen that is not as wide: its legend is below the axes.
    pub fn narrow_svg(&self) -> Result<String, FigureError> {
        let below = px(20) * self.legend_names().len() as i32 + px(8);
        let (width, height) = NARROW;
        document(&self.title, (width, height + below as u32 / PX), |root| {
            let (axes, legend) = root.split_vertically(height * PX);
            self.readable().draw_axes_on(&axes, NO_LEGEND)?;
            self.draw_legend(&legend, (px(24), px(8)))
        })
    }

    /// Series and bands with a name in the legend.
    fn legend_names(&self) -> Vec<&str> {
        let series = self.series.iter().map(|series| series.name.as_str());
        let bands = self.bands.iter().filter(|band| self.in_legend(band));
        series.chain(bands.map(|band| band.name.as_str())).filter(|name| !name.is_empty()).collect()
    }

    fn in_legend(&self, band: &Band) -> bool {
        !band.name.is_empty() && !band.is_level() && self.has(band)
    }

    /// Room that its legend needs at the right.
    pub(crate) fn legend_width(&self) -> u32 {
        let (frame, widths) = LEGEND;
        let longest = self.legend_names().into_iter().map(|name| text_width(name, LEGEND_FONT));
        match longest.reduce(f64::max) {
            None => NO_LEGEND,
            Some(longest) => {
                let width = frame + (longest * f64::from(PX)).ceil() as u32;
                width.clamp(*widths.start(), *widths.end())
            }
        }
    }

    /// Draws it on an area of its own, with so much room for the legend: charts below each other
    /// have the same.
    pub(crate) fn draw_on(&self, area: &Area, legend: u32) -> Drawn {
        self.draw_axes_on(area, legend)?;
        let left = (area.dim_in_pixel().0 - legend) as i32 + px(12);
        self.draw_legend(area, (left, px(56)))
    }

    fn draw_axes_on(&self, area: &Area, legend: u32) -> Drawn {
        let (x, y) = (self.range(Axis::X), self.range(Axis::Y));
        let spread =
            |range: Span, scale, room| Spread { marks: marks(&range, scale, room), range, scale };
        let (mut x_spread, y_spread) =
            (spread(x.clone(), self.x_scale, 9.0), spread(y.clone(), self.y_scale, 8.0));
        x_spread.keep_apart(f64::from(self.width_between(area, legend)) / f64::from(PX));
        match (self.x_scale == Scale::Linear, self.y_scale == Scale::Linear) {
            (true, true) => self.draw(area, legend, x, y),
            (false, true) => self.draw(area, legend, x_spread, y),
            (true, false) => self.draw(area, legend, x, y_spread),
            (false, false) => self.draw(area, legend, x_spread, y_spread),
        }
    }

    fn shown(&self, point: &(f64, f64)) -> bool {
        let is_above = self.y_from.is_none_or(|from| point.1 >= from);
        self.x_scale.has(point.0) && self.y_scale.has(point.1) && is_above
    }

    /// Whether a band has a place on its axis: a logarithmic one has none at zero.
    fn has(&self, band: &Band) -> bool {
        let scale = if band.axis == Axis::X { self.x_scale } else { self.y_scale };
        scale.has(band.high)
    }

    /// What an axis shows: all points, and lines, but no more of a band than there is of them.
    fn range(&self, axis: Axis) -> std::ops::Range<f64> {
        let (part, scale): (PartOfPoint, Scale) = match axis {
            Axis::X => (|point| point.0, self.x_scale),
            Axis::Y => (|point| point.1, self.y_scale),
        };
        let lines = self
            .bands
            .iter()
            .filter(|band| band.axis == axis && band.low == band.high && self.has(band))
            .map(|band| band.low);
        let points = self
            .series
            .iter()
            .flat_map(|series| &series.points)
            .filter(|point| self.shown(point))
            .map(part);
        let ends = self.x_least.filter(|_| axis == Axis::X).map(|(low, high)| [low, high]);
        let least = self.y_least.filter(|_| axis == Axis::Y);
        let ends = ends.into_iter().flatten().chain(least).filter(|end| scale.has(*end));
        let (low, high) = points
            .chain(lines)
            .chain(ends)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                (low.min(value), high.max(value))
            });
        if axis == Axis::X && !self.x_names.is_empty() {
            return 0.5..self.x_names.len() as f64 + 0.5;
        }
        let low = match scale {
            Scale::Log if axis == Axis::Y => low.max(high * 10f64.powi(-DECADES)),
            _ => low,
        };
        // Words at peaks have room above them.
        let above = if axis == Axis::Y && !self.labels.is_empty() { 0.12 } else { 0.05 };
        match low.partial_cmp(&high) {
            Some(std::cmp::Ordering::Less) => {
                let (from, to) = (scale.place(low), scale.place(high));
                scale.value(from - 0.05 * (to - from))..scale.value(to + above * (to - from))
            }
            Some(std::cmp::Ordering::Equal) if scale == Scale::Log => 0.5 * low..2.0 * low,
            Some(std::cmp::Ordering::Equal) => low - 1.0..high + 1.0,
            _ => 1.0..10.0,
        }
    }

    /// Width of the frame, in units of the drawing.
    fn width_between(&self, area: &Area, legend: u32) -> u32 {
        let sides = legend + (MARGIN + Y_LABELS) * PX;
        area.dim_in_pixel().0.saturating_sub(sides)
    }

    fn draw<X, Y>(&self, area: &Area, legend: u32, x: X, y: Y) -> Drawn
    where
        X: AsRangedCoord<Value = f64>,
        Y: AsRangedCoord<Value = f64>,
        X::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
        Y::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
    {
        let (x_range, y_range) = (self.range(Axis::X), self.range(Axis::Y));
        let numbers = (self.width_between(area, legend) / (X_NUMBER * PX)).clamp(3, 9) as usize;
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, font(18))
            .margin(MARGIN * PX)
            .margin_right(legend)
            .x_label_area_size(44 * PX)
            .y_label_area_size(Y_LABELS * PX)
            .build_cartesian_2d(x, y)?;
        chart
            .configure_mesh()
            .x_desc(&self.x_label)
            .y_desc(&self.y_label)
            .x_labels(if self.x_names.is_empty() { numbers } else { self.x_names.len() + 1 })
            .y_labels(8)
            .x_label_formatter(&|value| match self.x_names.is_empty() {
                true => tick(*value, &x_range, self.x_scale),
                false => self.x_name(*value),
            })
            .y_label_formatter(&|value| tick(*value, &y_range, self.y_scale))
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.12).stroke_width(PX))
            .axis_style(BLACK.stroke_width(PX))
            .set_all_tick_mark_size(5 * PX)
            .label_style(font(13))
            .axis_desc_style(font(14))
            .draw()?;
        let word = font(WORD.1).into_text_style(area);
        for (index, band) in self.bands.iter().enumerate().filter(|(_, band)| self.has(band)) {
            let range = if band.axis == Axis::X { &x_range } else { &y_range };
            let (low, high) =
                (band.low.clamp(range.start, range.end), band.high.clamp(range.start, range.end));
            let corners = match band.axis {
                Axis::X => [(low, y_range.start), (high, y_range.end)],
                Axis::Y => [(x_range.start, low), (x_range.end, high)],
            };
            let colour = band.colour(index);
            if band.low == band.high {
                let [dot, gap] = DOT.map(|length| length * PX);
                let stroke = colour.stroke_width(DOT_WIDTH);
                chart.draw_series(DashedLineSeries::new(corners, dot, gap, stroke))?;
            } else {
                chart.draw_series([Rectangle::new(corners, colour.mix(BAND_OPACITY).filled())])?;
            }
        }
        let wider = self.wider();
        let has_words = !self.labels.is_empty() || self.bands.iter().any(Band::is_level);
        let mut curves: Vec<Vec<(i32, i32)>> = Vec::new();
        for (series, wider) in self.series.iter().zip(&wider) {
            let stroke = series.stroke(*wider);
            // What is not there is a gap and no line.
            for piece in series.points.split(|point| !self.shown(point)) {
                let points = decimated(piece, COLUMNS);
                let line = points.iter().copied();
                if let ([alone], true, None) = (&*points, series.style.has_line(), mark(series, 0))
                {
                    let style = ShapeStyle { filled: true, ..stroke };
                    chart.draw_series([Circle::new(*alone, px(DOT_RADIUS), style)])?;
                }
                match series.style {
                    Style::Marks | Style::Rings => {}
                    Style::Line | Style::Both => {
                        chart.draw_series(LineSeries::new(line, stroke))?;
                    }
                    Style::Dashed => {
                        let [dash, gap] = DASH.map(|length| length * PX);
                        chart.draw_series(DashedLineSeries::new(line, dash, gap, stroke))?;
                    }
                }
                if has_words {
                    curves.push(points.iter().map(|at| chart.backend_coord(at)).collect());
                }
                if let Some((radius, style)) = mark(series, *wider) {
                    let marks = points.into_iter().map(|at| Circle::new(at, radius, style));
                    chart.draw_series(marks)?;
                }
            }
        }
        // The edges of what noise may be, above the curves: these may fill it.
        for band in self.bands.iter().filter(|band| band.axis == Axis::Y && band.low < band.high) {
            let inside = |edge: &f64| *edge > y_range.start && *edge < y_range.end;
            for edge in [band.low, band.high].into_iter().filter(inside) {
                let line = [(x_range.start, edge), (x_range.end, edge)];
                chart.draw_series(LineSeries::new(line, LEVEL.stroke_width(PX)))?;
            }
        }
        let frame = {
            let (x, y) = chart.plotting_area().get_pixel_range();
            [x.start, y.start, x.end, y.end]
        };
        let mut room = Room { frame, curves, taken: Vec::new() };
        // On curves a word stays legible by a ground of its own.
        let ground = WHITE.mix(0.75).filled();
        let size = |text: &str| {
            let width = text_width(text, f64::from(WORD.1)) + 4.0;
            ((width * f64::from(PX)) as i32, px(WORD.0))
        };
        for band in self.bands.iter().filter(|band| band.is_level() && self.has(band)) {
            let at = (x_range.end, band.low);
            let (right, y) = chart.backend_coord(&at);
            let places = places_along((frame[0], right), y, size(&band.name));
            let Some([left, top, end, bottom]) = room.take(places) else { continue };
            let style = word.pos(Pos::new(HPos::Right, VPos::Top)).color(&LEVEL);
            chart.draw_series([EmptyElement::at(at)
                + Rectangle::new([(left - right, top - y), (end - right, bottom - y)], ground)
                + Text::new(band.name.clone(), (end - right, top - y), style)])?;
        }
        for label in self.labels.iter().filter(|label| self.shown(&label.at)) {
            let (x, y) = chart.backend_coord(&label.at);
            let places = places_at((x, y), size(&label.text), px(7));
            // At an edge it is within the frame.
            let places = places.into_iter().map(|place| inside(place, &frame));
            let Some([left, top, right, bottom]) = room.take(places) else { continue };
            let style = word.pos(Pos::new(HPos::Center, VPos::Top));
            let to = (x.clamp(left, right) - x, y.clamp(top, bottom) - y);
            chart.draw_series([EmptyElement::at(label.at)
                + PathElement::new(vec![(0, 0), to], LEVEL.stroke_width(PX))
                + Rectangle::new([(left - x, top - y), (right - x, bottom - y)], ground)
                + Text::new(label.text.clone(), ((left + right) / 2 - x, top - y), style)])?;
        }
        Ok(())
    }

    /// What each line, mark and band is, below each other.
    fn draw_legend(&self, area: &Area, (left, mut y): (i32, i32)) -> Drawn {
        let style = font(13).into_text_style(area).pos(Pos::new(HPos::Left, VPos::Center));
        let wider = self.wider();
        let named = self.series.iter().zip(&wider).filter(|(series, _)| !series.name.is_empty());
        let line = |y: i32, [dash, gap]: [u32; 2], stroke: ShapeStyle| -> Drawn {
            let end = left + px(22);
            for x in (left..end).step_by(((dash + gap) * PX) as usize) {
                let to = (x + px(dash as i32)).min(end);
                area.draw(&PathElement::new([(x, y), (to, y)], stroke))?;
            }
            Ok(())
        };
        for (series, wider) in named {
            if series.style.has_line() {
                let dash = if series.style == Style::Dashed { DASH } else { [22, 1] };
                line(y, dash, series.stroke(*wider))?;
            }
            if let Some((radius, style)) = mark(series, *wider) {
                area.draw(&Circle::new((left + px(11), y), radius, style))?;
            }
            area.draw(&Text::new(series.name.clone(), (left + px(28), y), style.clone()))?;
            y += px(20);
        }
        let bands = self.bands.iter().enumerate();
        for (index, band) in bands.filter(|(_, band)| self.in_legend(band)) {
            let colour = band.colour(index);
            if band.low == band.high {
                line(y, DOT, colour.stroke_width(DOT_WIDTH))?;
            } else {
                let box_ = [(left, y - px(6)), (left + px(22), y + px(6))];
                area.draw(&Rectangle::new(box_, colour.mix(2.0 * BAND_OPACITY).filled()))?;
            }
            area.draw(&Text::new(band.name.clone(), (left + px(28), y), style.clone()))?;
            y += px(20);
        }
        Ok(())
    }
}

/// A length in px as that of a drawing.
fn px(length: i32) -> i32 {
    length * PX as i32
}

/// The font of a figure, by its size in px.
pub(crate) fn font(size: u32) -> (&'static str, u32) {
    ("sans-serif", size * PX)
}

/// A document of a size in px, with what is drawn on it.
pub(crate) fn document(
    title: &str,
    size: (u32, u32),
    draw: impl FnOnce(&Area) -> Drawn,
) -> Result<String, FigureError> {
    let failed = |error: DrawingAreaErrorKind<std::io::Error>| FigureError {
        title: title.to_owned(),
        reason: error.to_string(),
    };
    let (width, height) = (size.0 * PX, size.1 * PX);
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, (width, height)).into_drawing_area();
        root.fill(&WHITE).map_err(failed)?;
        draw(&root).map_err(failed)?;
        root.present().map_err(failed)?;
    }
    // Shown in px; what is drawn keeps its units by the `viewBox`.
    let drawn = format!("width=\"{width}\" height=\"{height}\"");
    let text = text.replacen(&drawn, &format!("width=\"{}\" height=\"{}\"", size.0, size.1), 1);
    // What no document may hold, from a name that a user gave.
    let forbidden = |c: char| c.is_control() && !matches!(c, '\n' | '\t');
    Ok(text.replace(forbidden, "\u{fffd}"))
}

/// Places for the name of a level: at its right end, its left one and between, above and below.
fn places_along((left, right): (i32, i32), y: i32, (width, height): (i32, i32)) -> Vec<Rect> {
    let ends =
        [0, 4, 2, 1, 3].map(|part| right - px(4) - (right - left - width - px(8)) * part / 4);
    let rows = [y - height - px(2), y + px(3)];
    let place = |end: i32| rows.map(|top| [end - width, top, end, top + height]);
    ends.into_iter().flat_map(place).collect()
}

/// A place moved so far along the abscissa that it is within a frame.
fn inside([left, top, right, bottom]: Rect, frame: &Rect) -> Rect {
    let by = (frame[0] - left).max(0) + (frame[2] - right).min(0);
    [left + by, top, right + by, bottom]
}

/// Height of a rising curve at an abscissa, by a straight line between its points.
fn height_at(curve: &[(f64, f64)], x: f64) -> Option<f64> {
    let (first, last) = (curve.first()?, curve.last()?);
    if !(first.0..=last.0).contains(&x) {
        return None;
    }
    let after = curve.partition_point(|there| there.0 < x);
    let (right, left) = (curve[after], curve[after.saturating_sub(1)]);
    let part = if right.0 > left.0 { (x - left.0) / (right.0 - left.0) } else { 0.0 };
    Some(left.1 + part * (right.1 - left.1))
}

/// Distance of a point from the straight piece between two others.
fn distance(point: (f64, f64), from: (f64, f64), to: (f64, f64)) -> f64 {
    let (along, off) = ((to.0 - from.0, to.1 - from.1), (point.0 - from.0, point.1 - from.1));
    let square = along.0 * along.0 + along.1 * along.1;
    let part = (off.0 * along.0 + off.1 * along.1) / square;
    let part = if square > 0.0 { part.clamp(0.0, 1.0) } else { 0.0 };
    (off.0 - part * along.0).hypot(off.1 - part * along.1)
}

/// How far up a range a value is, as a part of it.
fn area_part(range: &Span, value: f64, scale: Scale) -> f64 {
    let (from, to) = (scale.place(range.start), scale.place(range.end));
    (scale.place(value) - from) / (to - from)
}

/// An axis that is not linear, with its marks.
struct Spread {
    range: Span,
    scale: Scale,
    marks: Vec<f64>,
}

impl Spread {
    /// Leaves out marks whose numbers would overlap on an axis of so many px: zero stays, then
    /// whole powers, and of these the largest.
    fn keep_apart(&mut self, width: f64) {
        let half = |mark: f64| {
            let number = tick(mark, &self.range, self.scale);
            0.5 * text_width(&number, f64::from(WORD.1)) + 0.5 * BETWEEN_NUMBERS
        };
        let power = |mark: f64| mark.abs().log10();
        let rank = |mark: &f64| match *mark {
            0.0 => 0,
            mark if (power(mark) - power(mark).round()).abs() < 1e-9 => 1,
            _ => 2,
        };
        let mut order = self.marks.clone();
        order.sort_by(|a, b| rank(a).cmp(&rank(b)).then(b.abs().total_cmp(&a.abs())));
        let place = |mark: f64| width * area_part(&self.range, mark, self.scale);
        let mut kept: Vec<f64> = Vec::new();
        for mark in order {
            let is_apart =
                |other: &f64| (place(mark) - place(*other)).abs() > half(mark) + half(*other);
            if kept.iter().all(is_apart) {
                kept.push(mark);
            }
        }
        kept.sort_by(f64::total_cmp);
        self.marks = kept;
    }
}

impl Ranged for Spread {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let part = area_part(&self.range, *value, self.scale);
        limit.0 + (part * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.marks.clone()
    }

    fn range(&self) -> Span {
        self.range.clone()
    }
}

impl ValueFormatter<f64> for Spread {}

/// The points that many columns show: of each column the first, the last and the extremes along
/// both axes, in their order.
pub fn decimated(points: &[(f64, f64)], columns: usize) -> Vec<(f64, f64)> {
    let width = points.len().div_ceil(columns.max(1)).max(1);
    if width < 5 {
        return points.to_vec();
    }
    let mut kept = Vec::with_capacity(4 * columns);
    for piece in points.chunks(width) {
        let at = |part: fn(&(f64, f64)) -> f64| {
            let by = |a: &usize, b: &usize| part(&piece[*a]).total_cmp(&part(&piece[*b]));
            [(0..piece.len()).min_by(by), (0..piece.len()).max_by(by)]
        };
        let mut places: Vec<usize> = [Some(0), Some(piece.len() - 1)]
            .into_iter()
            .chain(at(|point| point.0))
            .chain(at(|point| point.1))
            .flatten()
            .collect();
        places.sort_unstable();
        places.dedup();
        kept.extend(places.into_iter().map(|place| piece[place]));
    }
    kept
}

/// The peaks of a spectrum over a logarithmic abscissa, highest first, between its points by the
/// parabola through three of them: those that stand `STANDS_OUT` times above the lowest point
/// between them and anything higher, are no less than `SEEN` of the highest, and rise above what
/// noise makes of the decades at their sides.
pub fn peaks(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let highest = points.iter().map(|point| point.1).fold(0.0, f64::max);
    let mut found: Vec<(f64, f64)> = (1..points.len().saturating_sub(1))
        .filter(|&at| points[at].1 >= points[at - 1].1 && points[at].1 > points[at + 1].1)
        .filter(|&at| points[at].1 >= SEEN * highest)
        .filter(|&at| {
            let height = points[at].1;
            // The valley on the way to what is higher; at the end of the curve there is none.
            let valley = |way: &mut dyn Iterator<Item = &(f64, f64)>| {
                way.take_while(|point| point.1 <= height)
                    .map(|point| point.1)
                    .fold(f64::INFINITY, f64::min)
            };
            let left = valley(&mut points[..at].iter().rev());
            let right = valley(&mut points[at + 1..].iter());
            STANDS_OUT * left.max(right) <= height
        })
        .filter(|&at| points[at].1 >= ABOVE_NOISE * around(points, points[at].0))
        .map(|at| vertex(&points[at - 1..=at + 1]))
        .collect();
    found.sort_by(|a, b| b.1.total_cmp(&a.1));
    found.truncate(MOST_PEAKS);
    found
}

/// Median of a curve over the decades at the sides of a place, along the logarithm of the abscissa
/// whatever the spacing of its points; 0 where there is none.
fn around(points: &[(f64, f64)], place: f64) -> f64 {
    let mut near: Vec<(f64, f64)> = points
        .windows(3)
        .filter(|three| three[0].0 > 0.0 && (0.1 * place..=10.0 * place).contains(&three[1].0))
        .map(|three| (three[1].1, (three[2].0 / three[0].0).ln()))
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * near.iter().map(|point| point.1).sum::<f64>();
    let mut below = 0.0;
    let median = near.iter().find(|point| {
        below += point.1;
        below >= half
    });
    median.map_or(0.0, |point| point.0)
}

/// Top of the parabola through three points over the logarithm of the abscissa; the middle one
/// where they are none.
fn vertex(three: &[(f64, f64)]) -> (f64, f64) {
    let [(x0, y0), middle @ (x1, y1), (x2, y2)] = *three else { return (f64::NAN, f64::NAN) };
    if x0 <= 0.0 {
        return middle;
    }
    let (left, right) = ((x0 / x1).ln(), (x2 / x1).ln());
    let (down, up) = ((y0 - y1) / left, (y2 - y1) / right);
    let curvature = (up - down) / (right - left);
    let slope = down - curvature * left;
    if curvature >= 0.0 {
        return middle;
    }
    let off = (-slope / (2.0 * curvature)).clamp(left, right);
    (x1 * off.exp(), y1 + slope * off + curvature * off * off)
}

/// How far a peak stands above the valleys at its sides to get a label. Assumed: a peak that a
/// reader would point at.
const STANDS_OUT: f64 = 2.0;
/// How far a peak rises above the median of the decades at its sides, which are wider than a line
/// of a short record. Amplitudes of noise have a Rayleigh distribution, of which 1 in 65,000 is 4
/// times its median: `2^-(4^2)`.
const ABOVE_NOISE: f64 = 4.0;
/// Least height of a peak with a label, as part of the highest: above the side lobes of a sine
/// that is cut off, 0.22 (Harris, Proc. IEEE 66 (1978) 51, table 1, rectangle: -13 dB).
const SEEN: f64 = 0.25;
/// Most labels of a curve: more are no points of interest.
const MOST_PEAKS: usize = 4;

/// Marks of an axis that is not linear, with room for so many.
fn marks(range: &Span, scale: Scale, room: f64) -> Vec<f64> {
    match scale {
        Scale::Linear => Vec::new(),
        Scale::Log => log_marks(range, room),
        Scale::Asinh(even) => asinh_marks(range, even, room),
    }
}

/// Zero and whole powers on both sides of it, with 2 and 5 of each where these have room; even
/// steps where next to nothing of the axis is logarithmic. From the largest down to zero each is
/// left out that is too near to one that is there: at the limit of the even part they draw
/// together.
fn asinh_marks(range: &Span, even: f64, room: f64) -> Vec<f64> {
    let largest = range.start.abs().max(range.end.abs());
    if largest < EVEN * even {
        return even_marks(range);
    }
    let place = |value: f64| Scale::Asinh(even).place(value);
    let apart = (place(range.end) - place(range.start)) / room;
    let decade = std::f64::consts::LN_10;
    let every = (apart / decade).ceil().max(1.0) as i32;
    let (first, last) = (even.log10().floor() as i32 - 1, largest.log10().floor() as i32);
    let marks = |factors: &[f64]| -> Vec<f64> {
        let powers = (first..=last).rev().filter(|power| power % every == 0);
        let sizes = powers
            .flat_map(|power| factors.iter().map(move |one| rounded(one * 10f64.powi(power), 12)));
        let mut kept: Vec<f64> = Vec::new();
        for size in sizes.filter(|size| *size <= largest && place(*size) >= apart) {
            if kept.last().is_none_or(|larger| place(*larger) - place(size) >= apart) {
                kept.push(size);
            }
        }
        let negative = kept.iter().map(|size| -size);
        let all = negative.chain([0.0]).chain(kept.iter().rev().copied());
        all.filter(|mark| (range.start..=range.end).contains(mark)).collect()
    };
    // Two neighbours of 1, 2 and 5 are as far from each other as 2 from 1.
    let finer = apart <= std::f64::consts::LN_2;
    let (whole, parted) = (marks(&[1.0]), marks(&[5.0, 2.0, 1.0]));
    let marks = if finer || whole.len() < FEW { parted } else { whole };
    if marks.len() >= 3 { marks } else { even_marks(range) }
}

/// Fewer marks than this are so few that others go between them.
const FEW: usize = 5;
/// Times the even part of an axis up to which its marks have even steps.
const EVEN: f64 = 5.0;

/// Round numbers with even steps: the widest that are several.
fn even_marks(range: &Span) -> Vec<f64> {
    let largest = (range.end - range.start).log10().ceil() as i32;
    let steps = (largest - 2..=largest).rev();
    let steps = steps.flat_map(|power| [5.0, 2.0, 1.0].map(|one| one * 10f64.powi(power)));
    let along = |step: f64| -> Vec<f64> {
        let (low, high) = ((range.start / step).floor(), (range.end / step).floor());
        let marks = (low as i64..=high as i64).map(|k| rounded(k as f64 * step, 12));
        marks.filter(|mark| (range.start..=range.end).contains(mark)).collect()
    };
    steps.map(along).find(|marks| marks.len() >= 4).unwrap_or_default()
}

/// Marks of a logarithmic axis with room for so many: whole powers; on few decades 1, 2 and 5 of
/// each; on less than a decade even steps.
fn log_marks(range: &Span, room: f64) -> Vec<f64> {
    let decades = (range.end / range.start).log10();
    if !(decades > 0.0 && decades.is_finite()) {
        return Vec::new();
    }
    let (first, last) = (range.start.log10().floor() as i32, range.end.log10().floor() as i32);
    let within = |mark: &f64| (range.start..=range.end).contains(mark);
    if decades < 0.9 {
        return even_marks(range);
    }
    let every = ((decades / room).ceil() as i32).max(1);
    let marks = |factors: &[f64]| -> Vec<f64> {
        let powers = (first..=last).filter(|power| power % every == 0);
        powers
            .flat_map(|power| factors.iter().map(move |one| one * 10f64.powi(power)))
            .filter(within)
            .collect()
    };
    // The fewest that still are several.
    let whole: &[&[f64]] = if 3.0 * decades < room { &[] } else { &[&[1.0]] };
    let finer: [&[f64]; 2] = [&[1.0, 2.0, 5.0], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]];
    let mut sets = whole.iter().copied().chain(finer).map(marks);
    sets.find(|marks| marks.len() >= 3).unwrap_or_else(|| marks(finer[1]))
}

/// A number as an axis with this range shows it: with the digits that tell it from its neighbours,
/// and as a power where the axis has very large numbers or only very small ones. One notation on
/// an axis.
fn tick(value: f64, range: &Span, scale: Scale) -> String {
    let size = value.abs();
    let span = if scale == Scale::Linear { range.end - range.start } else { size };
    if size < 1e-9 * span || size == 0.0 {
        return "0".to_owned();
    }
    // A step is no less than a hundredth of the range.
    let digits = (size / span).log10().floor().clamp(0.0, 12.0) as usize + 3;
    let short = rounded(value, digits);
    let largest = range.start.abs().max(range.end.abs());
    let smallest = match scale {
        Scale::Linear => largest,
        Scale::Log => range.start,
        Scale::Asinh(even) => even,
    };
    if smallest >= 1e-3 && largest < 1e5 || size == 1.0 {
        short.to_string()
    } else {
        format!("{short:e}")
    }
}

impl Series {
    /// How its line is drawn, so much wider than usual.
    fn stroke(&self, wider: u32) -> ShapeStyle {
        let width = if self.style == Style::Dashed { 1 } else { 2 };
        COLOURS[self.colour % COLOURS.len()].stroke_width((width + wider) * PX)
    }
}

/// How a mark of a series is drawn: its radius, so much wider than usual, and its style.
fn mark(series: &Series, wider: u32) -> Option<(i32, ShapeStyle)> {
    let colour = COLOURS[series.colour % COLOURS.len()];
    let (radius, is_open) = series.style.marks()?;
    let style = if is_open { colour.stroke_width(2 * PX) } else { colour.filled() };
    Some((px(radius) + px(wider as i32) / 2, style))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_of_axis_and_style_is_drawn() {
        for (x, y) in [(false, false), (true, false), (false, true), (true, true)] {
            let mut chart = Chart::new("stiffness <1>", "amplitude, µm", "N/m").logarithmic(x, y);
            for (colour, style) in
                [Style::Line, Style::Dashed, Style::Marks, Style::Both, Style::Rings]
                    .into_iter()
                    .enumerate()
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
            for words in ["stiffness &lt;1&gt;", "amplitude, µm", "series 3", "#009E73"] {
                assert!(text.contains(words), "no {words}");
            }
            assert!(!text.contains("NaN") && text.len() < 1_500_000, "{} bytes", text.len());
        }
        assert!(Chart::new("empty", "", "").logarithmic(true, true).svg().is_ok());
    }

    #[test]
    fn a_sample_between_gaps_is_a_dot() {
        let mut chart = Chart::new("t", "x", "y");
        let gap = f64::NAN;
        let points = [(0.0, 1.0), (1.0, 2.0), (2.0, gap), (3.0, 1.5), (4.0, gap), (5.0, 1.0)];
        chart.add("", 0, Style::Line, points);
        let text = chart.svg().unwrap();
        assert_eq!(text.matches("<circle").count(), 2, "{text}");
    }

    #[test]
    fn an_axis_of_very_large_or_small_numbers_has_a_prefix() {
        let chart = |unit: &str, scale: bool, values: [f64; 2]| {
            let mut chart = Chart::new("t", "x", format!("quantity, {unit}"));
            chart = chart.logarithmic(false, scale);
            chart.add("", 0, Style::Line, [(0.0, values[0]), (1.0, values[1])]);
            chart.line("level", Axis::Y, values[1]);
            let shown = chart.readable().into_owned();
            assert_eq!(shown.bands[0].high, shown.series[0].points[1].1);
            (shown.y_label, shown.series[0].points[1].1)
        };
        for (unit, log, values, label, number) in [
            ("N/m", false, [1e5, 5e5], "quantity, kN/m", 500.0),
            ("N/m", true, [1e5, 4e7], "quantity, MN/m", 40.0),
            ("m/N", true, [1e-9, 2e-6], "quantity, nm/N", 2000.0),
            ("N", false, [0.0, 2e-4], "quantity, µN", 200.0),
            // As it is: numbers that are read, a unit with a prefix, no prefix that would do.
            ("N", false, [0.0, 900.0], "quantity, N", 900.0),
            ("mm", false, [0.0, 2e-5], "quantity, mm", 2e-5),
            ("N", true, [1e-7, 1e4], "quantity, N", 1e4),
        ] {
            let (found, high) = chart(unit, log, values);
            assert_eq!(found, label);
            assert!((high / number - 1.0).abs() < 1e-9, "{found}: {high}");
        }
    }

    #[test]
    fn a_line_that_lies_on_others_leaves_them_visible() {
        let wave =
            |shift: f64| (0..500).map(move |k| (f64::from(k), (k as f64 / 50.0).sin() + shift));
        let mut chart = Chart::new("lines", "time, s", "error, µm");
        chart.add("first", 0, Style::Line, wave(0.0));
        chart.add("apart", 1, Style::Line, wave(0.2));
        // On other abscissas.
        chart.add("second", 2, Style::Line, wave(1e-3).step_by(3));
        chart.add("third", 3, Style::Line, wave(-1e-3));
        chart.add("marks", 4, Style::Marks, wave(0.0));
        // Three lines on each other: the lowest shows at the sides of both.
        assert_eq!(chart.wider(), [4, 0, 2, 0, 0]);
        let said = chart.overlaps_in_words().unwrap();
        assert_eq!(
            said,
            "Here “second” lies on “first”; “third” lies on “first” and on “second”; what lies \
             below is drawn wider."
        );
        // A solid line is one piece, whatever it lies on; dashed is what it is compared with.
        let dashed = |chart: &Chart| chart.svg().unwrap().matches("<polyline").count();
        let before = dashed(&chart);
        assert!(before < 40, "{before}");
        chart.add("reference", 4, Style::Dashed, wave(0.0));
        assert!(dashed(&chart) > before + 20);
        assert_eq!(chart.wider(), [4, 0, 2, 0, 0, 0]);
    }

    #[test]
    fn loops_lie_on_each_other_as_well() {
        let ellipse = |height: f64| {
            (0..300).map(move |k| {
                let angle = f64::from(k) / 40.0;
                (angle.cos(), height * angle.sin())
            })
        };
        let mut chart = Chart::new("loops", "position, mm", "force, N");
        chart.add("guide 1", 0, Style::Line, ellipse(1.0));
        chart.add("guide 2", 1, Style::Line, ellipse(0.5));
        chart.add("guide 3", 2, Style::Line, ellipse(1.005));
        assert_eq!(chart.wider(), [2, 0, 0]);
        assert!(chart.overlaps_in_words().unwrap().contains("“guide 3” lies on “guide 1”;"));
        // One that lies on a part of another hides nothing.
        let mut chart = Chart::new("spikes", "time, s", "force, N");
        let spike = |k: i32| if k % 20 == 0 { 1.0 } else { 0.0 };
        chart.add("before", 0, Style::Line, (0..400).map(|k| (f64::from(k), spike(k))));
        chart.add("after", 1, Style::Line, (0..400).map(|k| (f64::from(k), 0.0)));
        assert_eq!(chart.wider(), [0, 0]);
    }

    #[test]
    fn numbers_of_an_axis_do_not_overlap_on_a_narrow_drawing() {
        for (range, scale) in [
            (-5.0..5.0, Scale::Asinh(0.011)),
            (-3e4..1e3, Scale::Asinh(2.0)),
            (1.0..300.0, Scale::Log),
            (30.0..70.0, Scale::Log),
        ] {
            let marks = marks(&range, scale, 9.0);
            let mut spread = Spread { range: range.clone(), scale, marks };
            spread.keep_apart(250.0);
            let ends = spread.marks.iter().map(|mark| {
                let half = 0.5 * text_width(&tick(*mark, &range, scale), 13.0);
                let at = 250.0 * area_part(&range, *mark, scale);
                (at - half, at + half)
            });
            let ends: Vec<_> = ends.collect();
            assert!(ends.len() >= 2 && ends.windows(2).all(|two| two[0].1 < two[1].0), "{ends:?}");
            assert!(range.start > 0.0 || spread.marks.contains(&0.0), "{:?}", spread.marks);
        }
    }

    #[test]
    fn a_logarithmic_ordinate_begins_where_results_do() {
        let mut chart = Chart::new("t", "x", "y").logarithmic(true, true);
        chart.add("s", 0, Style::Line, (1..100).map(|k| (f64::from(k), f64::from(k).powi(-6))));
        chart.y_from = Some(1e-4);
        let low = chart.range(Axis::Y).start;
        assert!((5e-5..=3e-4).contains(&low), "{low}");
    }

    #[test]
    fn decimation_keeps_extremes() {
        let mut points: Vec<(f64, f64)> = (0..100_000).map(|k| (k as f64, 0.0)).collect();
        (points[54_321].1, points[54_327].1) = (7.0, -3.0);
        let kept = decimated(&points, 1000);
        assert!(kept.len() <= 4000 && kept.is_sorted_by(|a, b| a.0 < b.0));
        for extreme in [(54_321.0, 7.0), (54_327.0, -3.0), (0.0, 0.0), (99_999.0, 0.0)] {
            assert!(kept.contains(&extreme), "no {extreme:?}");
        }
    }

    #[test]
    fn peaks_are_found_between_the_points_and_side_lobes_are_none() {
        // Two lines of a spectrum with their side lobes, over a grid of periods.
        let line = |period: f64, at: f64| {
            let u = 40.0 * (period / at).ln();
            if u.abs() < 1e-9 { 1.0 } else { (u.sin() / u).abs() }
        };
        let grid: Vec<f64> = (0..200).map(|k| 3.0 * 1.02f64.powi(k)).collect();
        let curve: Vec<(f64, f64)> =
            grid.iter().map(|p| (*p, 6.0 * line(*p, 24.0) + 2.5 * line(*p, 12.0))).collect();
        let found = peaks(&curve);
        assert_eq!(found.len(), 2, "{found:?}");
        for (peak, at) in found.iter().zip([24.0, 12.0]) {
            assert!((peak.0 / at - 1.0).abs() < 0.02, "{found:?}");
        }
        assert_eq!(peaks(&[(1.0, 1.0), (2.0, 2.0), (3.0, 3.0)]), []);
        assert_eq!(peaks(&[]), []);
    }

    #[test]
    fn noise_has_no_peak_and_labels_do_not_overlap() {
        // Amplitudes of noise, by the inverse of their distribution.
        let mut state = 1_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            ((state >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
        };
        let mut noise = |place: fn(i32) -> f64, level: fn(f64) -> f64| -> Vec<(f64, f64)> {
            let mut size = |x: f64| level(x) * (-2.0 * random().ln()).sqrt();
            (1..2000).map(|k| (place(k), size(place(k)))).collect()
        };
        let flat = noise(|k| 1.005f64.powi(k), |_| 1.0);
        // That of friction falls with the frequency; Welch's lines are evenly spaced.
        let falling = noise(f64::from, |x| 10.0 / x);
        assert_eq!((peaks(&flat), peaks(&falling)), (vec![], vec![]));
        for (mut curve, at) in [(flat, 700), (falling, 20)] {
            curve[at].1 = 60.0;
            let found = peaks(&curve);
            assert!(found.len() == 1 && (found[0].0 / curve[at].0 - 1.0).abs() < 0.1, "{found:?}");
        }
        assert_eq!(peaks(&[(-3.0, 0.0), (-2.0, 1.0), (-1.0, 0.0)]).len(), 1);

        let mut chart = Chart::new("t", "x", "y").logarithmic(true, false);
        chart.add("", 0, Style::Line, [(1.0, 0.0), (30.0, 1.0), (1000.0, 0.0)]);
        let labels = [(30.0, "first"), (31.0, "second"), (32.0, "third"), (500.0, "elsewhere")];
        for (at, text) in labels {
            chart.label((at, 0.5), text);
        }
        let text = chart.svg().unwrap();
        assert!(labels.iter().all(|(_, word)| text.contains(word)));
        // Their grounds, the only ones of this colour.
        let number = |line: &str, name: &str| -> f64 {
            let rest = line.split(&format!(" {name}=\"")).nth(1).unwrap();
            rest.split('"').next().unwrap().parse().unwrap()
        };
        let grounds: Vec<[f64; 4]> = text
            .lines()
            .filter(|line| line.starts_with("<rect") && line.contains("opacity=\"0.75\""))
            .map(|line| ["x", "y", "width", "height"].map(|name| number(line, name)))
            .collect();
        assert_eq!(grounds.len(), 4, "{text}");
        for (index, [x, y, width, height]) in grounds.iter().enumerate() {
            for [left, top, wide, high] in &grounds[..index] {
                let apart = *x >= left + wide
                    || *left >= x + width
                    || *y >= top + high
                    || *top >= y + height;
                assert!(apart, "{grounds:?}");
            }
        }
    }

    #[test]
    fn a_logarithmic_axis_has_several_marks_whatever_it_spans() {
        for k in 0..40 {
            let low = 10f64.powf(0.13 * f64::from(k) - 2.0);
            for n in 1..120 {
                let high = low * 10f64.powf(0.1 * f64::from(n));
                let marks = log_marks(&(low..high), 8.0);
                assert!((3..=20).contains(&marks.len()), "{low} to {high}: {marks:?}");
                assert!(marks.iter().all(|mark| (low..=high).contains(mark)), "{marks:?}");
            }
        }
        assert!(log_marks(&(1.0..1.0), 8.0).is_empty());
        // On both sides of zero as well.
        for even in [1e-3, 0.011, 0.4, 7.0] {
            for (low, high) in
                [(-300.0, 500.0), (-0.2, 4e3), (0.0, 90.0), (-1e-3, 2e-3), (-0.9, 0.9)]
            {
                let marks = asinh_marks(&(low..high), even, 9.0);
                assert!((3..=21).contains(&marks.len()), "{low} to {high}: {marks:?}");
                assert!(marks.is_sorted() && marks.iter().all(|mark| (low..=high).contains(mark)));
                // No two stand on each other: apart by a thirtieth of the axis.
                let scale = Scale::Asinh(even);
                let place = |mark: &f64| area_part(&(low..high), *mark, scale);
                let closest = marks.windows(2).map(|two| place(&two[1]) - place(&two[0]));
                let closest = closest.fold(f64::INFINITY, f64::min);
                assert!(closest > 0.03, "{low} to {high}, even to {even}: {marks:?}");
            }
        }
        // Nothing is at zero there, and nothing is drawn for it.
        let mut chart = Chart::new("t", "x", "y").logarithmic(true, false);
        chart.add("s", 0, Style::Line, [(1.0, 1.0), (2.0, 2.0)]);
        chart.line("nowhere", Axis::X, 0.0);
        assert!(!chart.svg().unwrap().contains("nowhere"));
    }

    #[test]
    fn bands_and_lines_are_named_and_only_lines_widen_an_axis() {
        let mut chart = Chart::new("t", "x", "y");
        chart.add("s", 0, Style::Line, [(0.0, 1.0), (1.0, 2.0)]);
        chart.band("noise", Axis::Y, -1000.0, 1000.0);
        chart.line("limit", Axis::X, 3.0);
        assert!(chart.range(Axis::Y).end < 3.0 && chart.range(Axis::X).end > 3.0);
        let text = chart.svg().unwrap();
        assert!(text.contains("noise") && text.contains("limit"));
    }

    #[test]
    fn axis_numbers_are_short_and_differ_from_their_neighbours() {
        let on = |range: std::ops::Range<f64>, values: [f64; 3]| {
            values.map(|value| tick(value, &range, Scale::Linear))
        };
        assert_eq!(on(-1.0..1.0, [1e-17, 0.5, 0.1 + 0.2]), ["0", "0.5", "0.3"]);
        assert_eq!(on(0.0..3e-14, [0.0, 1e-14, 2.5e-14]), ["0", "1e-14", "2.5e-14"]);
        assert_eq!(on(0.0..1e300, [5e299, 1e300, 0.0]), ["5e299", "1e300", "0"]);
        assert_eq!(on(7.0..7.0001, [7.00002, 7.00004, 7.0]), ["7.00002", "7.00004", "7"]);
        assert_eq!(on(0.0..1.2e5, [5e4, 1e5, 0.0]), ["5e4", "1e5", "0"]);
        assert_eq!(on(0.0..5.0, [5e-4, 1.0, 0.0]), ["0.0005", "1", "0"]);
        let powers = [1e-8, 1000.0, 2.5e5].map(|value| tick(value, &(1e-9..1e6), Scale::Log));
        assert_eq!(powers, ["1e-8", "1e3", "2.5e5"]);
        let both =
            [-100.0, 0.0, 10.0].map(|value| tick(value, &(-500.0..300.0), Scale::Asinh(2.0)));
        assert_eq!(both, ["-100", "0", "10"]);
    }

    #[test]
    fn a_zero_among_decades_does_not_hide_the_rest() {
        let mut chart = Chart::new("t", "x", "y").logarithmic(false, true);
        chart.add("s", 0, Style::Line, [(0.0, 1e3), (1.0, 1e-200), (2.0, 1.0)]);
        assert!((chart.range(Axis::Y).start / 1e-9).ln().abs() < 2.0);
    }

    #[test]
    fn names_stand_along_the_abscissa() {
        let names = ["guide_1".to_owned(), "guide_2".to_owned()];
        let mut chart = Chart::new("t", "x", "y").named(names.to_vec());
        chart.add("", 0, Style::Marks, [(1.0, 1.0), (2.0, 2.0)]);
        let text = chart.svg().unwrap();
        assert!(text.contains("guide_1") && text.contains("guide_2") && !text.contains("1.5<"));
    }
}
