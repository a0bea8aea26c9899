//! Line figures as SVG: curves over time, as the paper's Figures 6 and 7.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// A named curve of (x, y) points.
#[derive(Clone, Debug, PartialEq)]
pub struct FigureCurve {
    /// Name in the legend.
    pub name: String,
    /// Its points.
    pub points: Vec<(f64, f64)>,
}

/// One pair of axes with curves and, dashed, a reference that is scaled to fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// Title above the axes.
    pub title: String,
    /// Quantity and unit along the abscissa.
    pub x_label: String,
    /// Quantity and unit along the ordinate.
    pub y_label: String,
    /// What is drawn.
    pub curves: Vec<FigureCurve>,
    /// Drawn black and dashed, scaled to the height of the panel.
    pub reference: Option<FigureCurve>,
}

/// A figure that could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("cannot draw the figure `{title}`: {reason}")]
pub struct FigureError {
    /// Title above the axes.
    pub title: String,
    /// Why not.
    pub reason: String,
}

/// Width and height of a panel, px.
const PANEL: (u32, u32) = (860, 400);
/// Colours that stay apart for colour-blind readers (Okabe, Ito 2008).
const COLOURS: [RGBColor; 4] =
    [RGBColor(0, 114, 178), RGBColor(213, 94, 0), RGBColor(0, 158, 115), RGBColor(204, 121, 167)];
/// Most points of a curve that are drawn: minimum and maximum of each of this many columns.
const COLUMNS: usize = 1200;

/// The panels below each other, as one SVG document.
pub fn svg(title: &str, panels: &[Panel]) -> Result<String, FigureError> {
    let failed = |reason: String| FigureError { title: title.to_owned(), reason };
    let height = PANEL.1 * panels.len() as u32 + 40;
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, (PANEL.0, height)).into_drawing_area();
        root.fill(&WHITE).map_err(|error| failed(error.to_string()))?;
        let root =
            root.titled(title, ("sans-serif", 20)).map_err(|error| failed(error.to_string()))?;
        for (panel, area) in panels.iter().zip(root.split_evenly((panels.len().max(1), 1))) {
            draw(panel, &area).map_err(|error| failed(error.to_string()))?;
        }
        root.present().map_err(|error| failed(error.to_string()))?;
    }
    Ok(text)
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

fn draw(panel: &Panel, area: &Area) -> Result<(), DrawingAreaErrorKind<std::io::Error>> {
    let points = || {
        panel
            .curves
            .iter()
            .flat_map(|curve| &curve.points)
            .filter(|(x, y)| x.is_finite() && y.is_finite())
    };
    let range = |part: fn(&(f64, f64)) -> f64| {
        let (low, high) =
            points().map(part).fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                (low.min(value), high.max(value))
            });
        match low.partial_cmp(&high) {
            Some(std::cmp::Ordering::Less) => (low, high),
            Some(std::cmp::Ordering::Equal) => (low - 1.0, high + 1.0),
            _ => (-1.0, 1.0),
        }
    };
    let ((x_low, x_high), (y_low, y_high)) = (range(|point| point.0), range(|point| point.1));
    let margin = 0.08 * (y_high - y_low);
    let mut chart = ChartBuilder::on(area)
        .caption(&panel.title, ("sans-serif", 16))
        .margin(12)
        .margin_right(26)
        .x_label_area_size(42)
        .y_label_area_size(64)
        .build_cartesian_2d(x_low..x_high, (y_low - margin)..(y_high + margin))?;
    chart
        .configure_mesh()
        .x_desc(&panel.x_label)
        .y_desc(&panel.y_label)
        .x_labels(11)
        .y_labels(9)
        .x_label_formatter(&|x| format!("{x}"))
        .y_label_formatter(&|y| format!("{}", (y * 1e6).round() / 1e6))
        .light_line_style(WHITE)
        .bold_line_style(BLACK.mix(0.12))
        .label_style(("sans-serif", 13))
        .axis_desc_style(("sans-serif", 14))
        .draw()?;
    if let Some(reference) = &panel.reference {
        let (low, high) = reference
            .points
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (_, y)| {
                (low.min(*y), high.max(*y))
            });
        let scale = if high > low { (y_high - y_low) / (high - low) } else { 0.0 };
        let scaled =
            thin(&reference.points).into_iter().map(|(x, y)| (x, y_low + (y - low) * scale));
        chart.draw_series(DashedLineSeries::new(scaled, 6, 4, BLACK.stroke_width(1)))?;
    }
    for (curve, colour) in panel.curves.iter().zip(COLOURS.iter().cycle()) {
        chart.draw_series(LineSeries::new(thin(&curve.points), colour.stroke_width(2)))?;
    }
    // A legend of our own: the library's cannot sit beside a dashed line without a box over the
    // curves.
    let (width, height) = area.dim_in_pixel();
    let style = ("sans-serif", 13).into_text_style(area).pos(Pos::new(HPos::Right, VPos::Center));
    for (index, (curve, colour)) in panel.curves.iter().zip(COLOURS.iter().cycle()).enumerate() {
        let (x, y) = (width as i32 - 40, height as i32 / 3 + 18 * index as i32);
        area.draw(&PathElement::new([(x - 26, y), (x, y)], colour.stroke_width(3)))?;
        area.draw(&Text::new(curve.name.clone(), (x - 32, y), style.clone()))?;
    }
    Ok(())
}

/// At most two points per column: what falls between them would not be seen.
fn thin(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let width = points.len().div_ceil(COLUMNS).max(1);
    points
        .chunks(width)
        .flat_map(|chunk| {
            let low = chunk.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1));
            let high = chunk.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1));
            let mut pair: Vec<(f64, f64)> = low.into_iter().chain(high).collect();
            pair.sort_by(|a, b| a.0.total_cmp(&b.0));
            pair.dedup();
            pair
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_holds_its_titles_its_curves_and_its_legend() {
        let wave = |phase: f64| {
            (0..5000).map(|k| (k as f64 * 0.1, (k as f64 * 0.01 + phase).sin())).collect::<Vec<_>>()
        };
        let panel = Panel {
            title: "error".into(),
            x_label: "time, ms".into(),
            y_label: "um".into(),
            curves: vec![
                FigureCurve { name: "guide 1".into(), points: wave(0.0) },
                FigureCurve { name: "guide 2".into(), points: wave(1.0) },
            ],
            reference: Some(FigureCurve { name: "reference".into(), points: wave(2.0) }),
        };
        let text = svg("Fast move", &[panel]).unwrap();
        for words in
            ["<svg", "Fast move", "error", "time, ms", "guide 1", "guide 2", "#0072B2", "#D55E00"]
        {
            assert!(text.contains(words), "no {words}");
        }
        assert!(text.len() < 400_000, "{} bytes", text.len());
    }

    #[test]
    fn constant_and_empty_curves_are_drawn_too() {
        let panel = |points| Panel {
            title: String::new(),
            x_label: String::new(),
            y_label: String::new(),
            curves: vec![FigureCurve { name: "c".into(), points }],
            reference: None,
        };
        assert!(svg("t", &[panel(vec![(0.0, 1.0), (1.0, 1.0)]), panel(vec![])]).is_ok());
    }

    #[test]
    fn thinning_keeps_extremes() {
        let mut points: Vec<(f64, f64)> = (0..100_000).map(|k| (k as f64, 0.0)).collect();
        points[54_321].1 = 7.0;
        let thinned = thin(&points);
        assert!(thinned.len() <= 2 * COLUMNS + 2 && thinned.contains(&(54_321.0, 7.0)));
    }
}
