//! Several charts below each other as one SVG document.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::chart::{Chart, PX, SIZE, document, font};

/// A figure that could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("cannot draw the figure `{title}`: {reason}")]
pub struct FigureError {
    /// Title above the axes.
    pub title: String,
    /// Why not.
    pub reason: String,
}

/// Height of the title above the charts, px.
const TITLE: u32 = 40;

/// The charts below each other, as one SVG document.
pub fn svg(title: &str, charts: &[Chart]) -> Result<String, FigureError> {
    let height = SIZE.1 * charts.len() as u32 + TITLE;
    let charts: Vec<_> = charts.iter().map(Chart::readable).collect();
    document(title, (SIZE.0, height), |root| {
        let (head, rest) = root.split_vertically(TITLE * PX);
        let (width, height) = head.dim_in_pixel();
        let middle = Pos::new(HPos::Center, VPos::Center);
        let style = font(20).into_text_style(&head).pos(middle);
        head.draw(&Text::new(title.to_owned(), ((width / 2) as i32, (height / 2) as i32), style))?;
        // The same instant is above itself.
        let legend = charts.iter().map(|chart| chart.legend_width()).max().unwrap_or(0);
        for (chart, area) in charts.iter().zip(rest.split_evenly((charts.len().max(1), 1))) {
            chart.draw_on(&area, legend)?;
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::{Axis, Style};

    #[test]
    fn a_figure_holds_its_titles_its_curves_and_its_legend() {
        let mut chart = Chart::new("error", "time, ms", "µm");
        for (colour, name) in ["guide 1", "guide 2"].into_iter().enumerate() {
            let wave = (0..5000).map(|k| (k as f64 * 0.1, (k as f64 * 0.01 + colour as f64).sin()));
            chart.add(name, colour, Style::Line, wave);
        }
        chart.band("settled", Axis::Y, -0.1, 0.1);
        let text = svg("Fast move", &[chart.clone(), chart]).unwrap();
        for words in [
            "<svg",
            "Fast move",
            "error",
            "time, ms",
            "guide 1",
            "guide 2",
            "settled",
            "#0072B2",
            "#D55E00",
        ] {
            assert!(text.contains(words), "no {words}");
        }
        assert!(text.len() < 800_000, "{} bytes", text.len());
    }
}
