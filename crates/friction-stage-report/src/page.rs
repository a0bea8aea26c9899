//! One self-contained HTML page: headings, texts, tables, figures, notes. No network, printable,
//! light or dark as the reader's system is.
//!
//! What comes in is plain text, which is escaped here, and charts; what goes out is the whole
//! document. A chart is an SVG, for print and for readers without script, and the data from which
//! the script of the page makes a plot that zooms.

use std::fmt::Write as _;

use crate::chart::Chart;
use crate::figure::FigureError;
use crate::interactive::{self, Columns};
use crate::words::{fixed, unbroken};

/// A page that grows from top to bottom.
///
/// ```
/// use friction_stage_report::page::{Align, Cell, Mark, Page, Table};
///
/// let mut page = Page::new("Guides", "three configurations of one guide");
/// page.section("Friction");
/// page.text("Force at constant velocity.");
/// let mut table = Table::new(&[("guide", Align::Left), ("Fs, N", Align::Right)]);
/// table.row([Cell::text("guide_1"), Cell::number(16.8, 1)]);
/// page.table(&table);
/// page.note(Mark::Good, "every statement holds");
/// assert!(page.finish().starts_with("<!DOCTYPE html>"));
/// ```
#[derive(Clone, Debug)]
pub struct Page {
    title: String,
    subtitle: String,
    body: String,
    /// Identifier and title of each section.
    sections: Vec<(String, String)>,
    figures: usize,
    tables: usize,
    columns: Columns,
}

/// How good something is; shown as a coloured badge with a word or at the side of a note, never by
/// colour alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// As it should be.
    Good,
    /// Something to know.
    Warning,
    /// Not as it should be.
    Bad,
    /// Neither.
    Neutral,
}

/// Side of a column on which its cells stand: numbers right, words left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Align {
    /// Words.
    Left,
    /// Numbers.
    Right,
}

/// A cell of a table.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// Plain text.
    Text(String),
    /// A name, in a fixed width.
    Code(String),
    /// A word with a colour.
    Badge(Mark, String),
}

/// A table with named columns.
#[derive(Clone, Debug)]
pub struct Table {
    columns: Vec<(String, Align)>,
    rows: Vec<Vec<Cell>>,
    caption: Option<String>,
}

/// A large number with its name, for the head of a page.
#[derive(Clone, Debug)]
pub struct Tile {
    /// What the number is.
    pub name: String,
    /// The number with its unit.
    pub value: String,
    /// What it compares with.
    pub detail: String,
    /// How good it is.
    pub mark: Mark,
}

impl Mark {
    fn class(self) -> &'static str {
        match self {
            Mark::Good => "good",
            Mark::Warning => "warning",
            Mark::Bad => "bad",
            Mark::Neutral => "neutral",
        }
    }
}

impl Cell {
    /// A cell with plain text.
    pub fn text(text: impl Into<String>) -> Cell {
        Cell::Text(text.into())
    }

    /// A number with so many decimals, or with an exponent where that leaves fewer than two
    /// significant digits or the number is 1e9 or larger; a dash where it is not finite.
    pub fn number(value: f64, digits: usize) -> Cell {
        let least = 10f64.powi(1 - digits as i32);
        Cell::Text(if !value.is_finite() {
            "\u{2013}".to_owned()
        } else if value == 0.0 || digits < 2 || value.abs() >= least {
            fixed(value, digits)
        } else {
            format!("{value:.2e}")
        })
    }

    /// A number that may be absent: then a dash.
    pub fn maybe(value: Option<f64>, digits: usize) -> Cell {
        Cell::number(value.unwrap_or(f64::NAN), digits)
    }

    /// A cell with a name.
    pub fn code(text: impl Into<String>) -> Cell {
        Cell::Code(text.into())
    }

    /// A cell with a badge.
    pub fn badge(mark: Mark, text: impl Into<String>) -> Cell {
        Cell::Badge(mark, text.into())
    }

    fn html(&self) -> String {
        match self {
            Cell::Text(text) => escaped(text),
            Cell::Code(text) => format!("<code>{}</code>", escaped(text)),
            Cell::Badge(mark, text) => {
                format!("<span class=\"badge {}\">{}</span>", mark.class(), escaped(text))
            }
        }
    }
}

impl Table {
    /// Columns from left to right, units in their names.
    pub fn new(columns: &[(&str, Align)]) -> Table {
        Table {
            columns: columns.iter().map(|(name, align)| ((*name).to_owned(), *align)).collect(),
            rows: Vec::new(),
            caption: None,
        }
    }

    /// The same with a caption above it.
    pub fn captioned(mut self, caption: impl Into<String>) -> Table {
        self.caption = Some(caption.into());
        self
    }

    /// A row; missing cells stay empty, cells beyond the last column are left out.
    pub fn row(&mut self, cells: impl IntoIterator<Item = Cell>) {
        self.rows.push(cells.into_iter().take(self.columns.len()).collect());
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }
}

impl Page {
    /// A page without content.
    pub fn new(title: impl Into<String>, subtitle: impl Into<String>) -> Page {
        Page {
            title: title.into(),
            subtitle: subtitle.into(),
            body: String::new(),
            sections: Vec::new(),
            figures: 0,
            tables: 0,
            columns: Columns::default(),
        }
    }

    /// Begins a section; it stands in the list of contents.
    pub fn section(&mut self, title: &str) {
        let id = format!("section-{}", self.sections.len() + 1);
        self.add(format_args!("<h2 id=\"{id}\">{}</h2>\n", escaped(title)));
        self.sections.push((id, title.to_owned()));
    }

    /// Begins a subsection.
    pub fn subsection(&mut self, title: &str) {
        self.add(format_args!("<h3>{}</h3>\n", escaped(title)));
    }

    /// A paragraph.
    pub fn text(&mut self, text: &str) {
        self.add(format_args!("<p>{}</p>\n", shown(text)));
    }

    /// Adds a list.
    pub fn list<S: AsRef<str>>(&mut self, items: impl IntoIterator<Item = S>) {
        self.body.push_str("<ul>\n");
        for item in items {
            self.add(format_args!("<li>{}</li>\n", shown(item.as_ref())));
        }
        self.body.push_str("</ul>\n");
    }

    /// A box beside the text.
    pub fn note(&mut self, mark: Mark, text: &str) {
        self.add(format_args!("<p class=\"note {}\">{}</p>\n", mark.class(), shown(text)));
    }

    /// A box for each kind of text, with those of one kind below each other.
    pub fn notes<'a>(&mut self, mark: Mark, texts: impl IntoIterator<Item = (&'a str, &'a str)>) {
        let mut kinds: Vec<(&str, Vec<&str>)> = Vec::new();
        for (kind, text) in texts {
            match kinds.iter_mut().find(|known| known.0 == kind) {
                Some((_, of_kind)) => of_kind.push(text),
                None => kinds.push((kind, vec![text])),
            }
        }
        for (_, of_kind) in kinds {
            let lines = of_kind.into_iter().map(|text| format!("<span>{}</span>", shown(text)));
            self.add(format_args!(
                "<p class=\"note {}\">{}</p>\n",
                mark.class(),
                lines.collect::<Vec<_>>().join("\n")
            ));
        }
    }

    /// Commands or file contents, as they are.
    pub fn code(&mut self, text: &str) {
        self.add(format_args!("<pre>{}</pre>\n", escaped(text)));
    }

    /// Names and values below each other, such as the settings of a run.
    pub fn facts<N: AsRef<str>, V: AsRef<str>>(&mut self, facts: impl IntoIterator<Item = (N, V)>) {
        self.body.push_str("<dl>\n");
        for (name, value) in facts {
            self.add(format_args!(
                "<dt>{}</dt><dd>{}</dd>\n",
                escaped(name.as_ref()),
                shown(value.as_ref())
            ));
        }
        self.body.push_str("</dl>\n");
    }

    /// A few large numbers beside each other.
    pub fn tiles(&mut self, tiles: &[Tile]) {
        self.body.push_str("<div class=\"tiles\">\n");
        for tile in tiles {
            self.add(format_args!(
                "<div class=\"tile {}\"><span class=\"name\">{}</span><span \
                 class=\"value\">{}</span><span class=\"detail\">{}</span></div>\n",
                tile.mark.class(),
                escaped(&tile.name),
                shown(&tile.value),
                shown(&tile.detail)
            ));
        }
        self.body.push_str("</div>\n");
    }

    /// Adds a table.
    pub fn table(&mut self, table: &Table) {
        // A caption within the table would be as wide as it is, beyond a small screen.
        if let Some(caption) = &table.caption {
            self.tables += 1;
            let (id, caption) = (self.tables, shown(caption));
            self.add(format_args!("<p class=\"caption\" id=\"table-{id}\">{caption}</p>\n"));
            self.add(format_args!(
                "<div class=\"table\"><table aria-describedby=\"table-{id}\">\n"
            ));
        } else {
            self.body.push_str("<div class=\"table\"><table>\n");
        }
        let class = |align: Align| if align == Align::Right { " class=\"right\"" } else { "" };
        self.body.push_str("<thead><tr>");
        for (name, align) in &table.columns {
            // The unit at the end of a name is one word.
            let name = match name.rsplit_once(", ") {
                Some((quantity, unit)) if unit.len() <= LONGEST_UNIT => {
                    format!("{quantity}, {}", unit.replace(' ', "\u{a0}"))
                }
                _ => name.clone(),
            };
            self.add(format_args!("<th{}>{}</th>", class(*align), shown(&name)));
        }
        self.body.push_str("</tr></thead>\n<tbody>\n");
        for row in &table.rows {
            self.body.push_str("<tr>");
            for (index, (_, align)) in table.columns.iter().enumerate() {
                let html = row.get(index).map_or_else(String::new, Cell::html);
                self.add(format_args!("<td{}>{html}</td>", class(*align)));
            }
            self.body.push_str("</tr>\n");
        }
        self.body.push_str("</tbody>\n</table></div>\n");
    }

    /// A chart with a numbered caption.
    pub fn figure(&mut self, chart: &Chart, caption: &str) -> Result<(), FigureError> {
        let svg = chart.svg()?;
        self.figures += 1;
        let number = self.figures;
        // A curve below another one is not taken for one that is missing.
        let overlaps = chart.overlaps_in_words().map_or(String::new(), |words| format!(" {words}"));
        let (caption, overlaps) = (shown(caption), shown(&overlaps));
        let data = self.columns.chart(chart);
        let class = if data.is_none() { " class=\"has-narrow\"" } else { "" };
        self.add(format_args!(
            "<figure role=\"img\"{class} aria-label=\"{caption}{overlaps}\">\n{svg}\n"
        ));
        match data {
            Some(data) => self.add(format_args!(
                "<script type=\"application/json\" class=\"chart\">{data}</script>\n"
            )),
            // A drawing is no smaller on a small screen: what is written in it has to be legible.
            None => {
                self.add(format_args!("<div class=\"narrow\">\n{}\n</div>\n", chart.narrow_svg()?))
            }
        }
        self.add(format_args!(
            "<figcaption><b>Figure {number}.</b> {caption}<span \
             class=\"overlaps\">{overlaps}</span></figcaption>\n</figure>\n"
        ));
        Ok(())
    }

    /// The whole document.
    pub fn finish(self) -> String {
        let title = escaped(&self.title);
        let plots = self.body.contains("class=\"chart\"");
        let style = if plots { interactive::LIBRARY_STYLE } else { "" };
        let mut text = format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, \
             initial-scale=1\">\n<meta name=\"color-scheme\" content=\"light dark\">\n\
             <title>{title}</title>\n<style>\n{style}{STYLE}</style>\n</head>\n\
             <body>\n<main>\n<header>\n<h1>{title}</h1>\n<p>{}</p>\n</header>\n",
            shown(&self.subtitle)
        );
        if self.sections.len() > 1 {
            text.push_str("<nav aria-label=\"Sections\">");
            for (id, title) in &self.sections {
                text.push_str(&format!("<a href=\"#{id}\">{}</a>", escaped(title)));
            }
            text.push_str("</nav>\n");
        }
        text += &self.body;
        text += "</main>\n";
        if plots {
            let (licence, library) = (interactive::LIBRARY_LICENCE, interactive::LIBRARY);
            text += &format!(
                "<script type=\"application/json\" id=\"columns\">{}</script>\n\
                 <script>\n/*\nuPlot 1.6.32\n{licence}\n*/\n{library}</script>\n\
                 <script>\n{}{}</script>\n",
                self.columns.json(),
                interactive::CURVES,
                interactive::SCRIPT
            );
        }
        text + "</body>\n</html>\n"
    }

    fn add(&mut self, text: std::fmt::Arguments) {
        self.body.write_fmt(text).expect("a String takes everything");
    }
}

/// A finished page with lines at its end, such as who made it.
pub fn with_footer(page: &str, lines: &str) -> String {
    let lines = escaped(lines).replace('\n', "<br>");
    match page.rsplit_once("</main>") {
        Some((before, after)) => format!("{before}<footer>{lines}</footer>\n</main>{after}"),
        None => page.to_owned(),
    }
}

/// A finished SVG figure with a line that is not drawn, such as who made it.
pub fn with_metadata(figure: &str, line: &str) -> String {
    match figure.rsplit_once("</svg>") {
        Some((before, after)) => {
            format!("{before}<metadata>{}</metadata>\n</svg>{after}", escaped(line))
        }
        None => figure.to_owned(),
    }
}

/// Text as HTML shows it: no character of it is markup.
pub fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            // Control characters are not allowed in HTML; a tab or a line end is.
            c if c.is_control() && !matches!(c, '\n' | '\t') => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// Text for a reader: no line break parts a number from its unit.
fn shown(text: &str) -> String {
    escaped(&unbroken(text))
}

/// Length of a unit at the end of a name, bytes.
const LONGEST_UNIT: usize = 8;

/// Colours with a contrast of at least 4.5 on their ground.
pub(crate) const STYLE: &str = include_str!("page.css");

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::Style;

    #[test]
    fn whatever_a_user_names_stays_text() {
        let evil = "<script>alert('1')</script> & \"x\"\u{7}";
        let mut page = Page::new(evil, evil);
        page.section(evil);
        page.subsection(evil);
        page.text(evil);
        page.note(Mark::Bad, evil);
        page.code(evil);
        page.list([evil]);
        page.facts([(evil, evil)]);
        let mut chart = Chart::new(evil, evil, evil);
        chart.add(evil, 0, Style::Line, [(0.0, 1.0), (1.0, 2.0)]);
        page.figure(&chart, evil).unwrap();
        page.tiles(&[Tile {
            name: evil.into(),
            value: evil.into(),
            detail: evil.into(),
            mark: Mark::Neutral,
        }]);
        let mut table = Table::new(&[(evil, Align::Left), ("n", Align::Right)]).captioned(evil);
        table.row([Cell::text(evil), Cell::code(evil), Cell::text("beyond the last column")]);
        table.row([Cell::badge(Mark::Good, evil)]);
        page.table(&table);
        let text = page.finish();
        // Those of the page itself: the chart's data, the columns, the library, what draws.
        assert_eq!(text.matches("<script").count(), 4);
        assert!(!text.contains("<script>alert") && !text.contains('\u{7}'), "{text}");
        assert!(!text.contains("beyond the last column"));
        let shown = "&lt;script&gt;alert(&#39;1&#39;)&lt;/script&gt; &amp; &quot;x&quot;";
        assert_eq!(text.matches(shown).count(), 21);
    }

    #[test]
    fn every_colour_of_a_drawing_is_one_of_the_page() {
        let colours = STYLE.matches("svg [stroke='#").count();
        // Those of the curves, and that of axes and words.
        assert_eq!(colours, crate::chart::COLOURS.len() + 1);
        for (index, colour) in crate::chart::COLOURS.iter().enumerate() {
            let hex = format!("#{:02X}{:02X}{:02X}", colour.0, colour.1, colour.2);
            for what in ["fill", "stroke"] {
                let rule = format!("svg [{what}='{hex}'] {{ {what}: var(--curve-{index}); }}");
                assert!(STYLE.contains(&rule), "no {rule}");
            }
            // The light ones are what the drawing states, but for that of the text.
            let light = format!("--curve-{index}: {}", hex.to_lowercase());
            assert!(STYLE.contains(&light) || index == 7, "no {light}");
        }
    }

    #[test]
    fn page_stands_alone() {
        let mut page = Page::new("t", "s");
        page.section("one");
        page.section("two");
        let mut chart = Chart::new("t", "x", "y");
        chart.add("s", 0, Style::Line, [(0.0, 1.0), (1.0, 2.0)]);
        page.figure(&chart, "c").unwrap();
        let text = page.finish().replace(interactive::LIBRARY, "");
        for word in ["src=", "url(", "@import", "<link", "https://"] {
            assert!(!text.contains(word), "{word}");
        }
        assert!(
            text.contains("<a href=\"#section-2\">two</a>")
                && text.contains("<h2 id=\"section-2\">two</h2>")
        );
        assert!(text.contains("Figure 1."));
    }

    #[test]
    fn numbers_that_are_none_are_dashes() {
        assert_eq!(Cell::number(1.25, 1), Cell::Text("1.2".into()));
        assert_eq!(Cell::number(f64::NAN, 1), Cell::maybe(None, 1));
        assert_eq!(Cell::number(-1e300, 3), Cell::Text("-1e300".into()));
        assert_eq!(Cell::number(12_345_678.5, 1), Cell::Text("12345678.5".into()));
    }
}
