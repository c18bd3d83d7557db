//! Self-contained HTML pages: one file, readable offline, in light and dark, its plots to be zoomed. One look for all of them:
//! `templates/look.css`; one way to draw: `templates/plots.js`, with uPlot (`templates/vendor`).

#[cfg(test)]
pub(crate) mod browser;

use super::figure::{Figure, FigureError};
use crate::output::{self, Existing, OutputError};
use askama::Template;
use std::path::Path;

/// Points of all lines of a page together: some three megabytes.
const POINTS_OF_A_PAGE: usize = 200_000;
/// A line has at least so many, however many lines there are.
const LEAST_POINTS: usize = 500;
/// A line has no more than any screen shows.
const MOST_POINTS: usize = 12_000;

/// What every page's file holds of its own: looks and scripts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shared {
    pub(crate) look: &'static str,
    pub(crate) plots: &'static str,
    pub(crate) plot_style: &'static str,
    pub(crate) plot_library: &'static str,
}

pub(crate) const SHARED: Shared = Shared {
    look: include_str!("../../../templates/look.css"),
    plots: include_str!("../../../templates/plots.js"),
    plot_style: include_str!("../../../templates/vendor/uplot-1.6.32/uPlot.min.css"),
    plot_library: include_str!("../../../templates/vendor/uplot-1.6.32/uPlot.iife.min.js"),
};

/// An HTML page under construction; every text given to it is escaped.
#[derive(Debug, Clone)]
pub struct Page {
    title: String,
    blocks: Vec<Block>,
}

#[derive(Debug, Clone)]
enum Block {
    Heading(String),
    Subheading(String),
    Paragraph(String),
    Callout(String),
    List(Vec<String>),
    Code(String),
    Table { header: Vec<String>, rows: Vec<Vec<String>> },
    Plots { figure: Box<Figure>, caption: String },
}

#[derive(Template)]
#[template(path = "page.html")]
struct Document<'a> {
    title: &'a str,
    shared: Shared,
    blocks: &'a [Block],
    points: usize,
}

/// A figure as the page holds it.
struct Plots {
    json: String,
    thinned: bool,
}

impl Document<'_> {
    fn plots(&self, figure: &Figure) -> Plots {
        let data = figure.interactive(self.points);
        Plots { json: embedded(&data), thinned: data.thinned }
    }
}

/// Data for a script element, which no text in it can end.
pub(crate) fn embedded(data: &impl serde::Serialize) -> String {
    serde_json::to_string(data).expect("numbers and strings always serialise").replace('<', "\\u003c")
}

fn class_of(cell: &str) -> Option<&'static str> {
    /// Cells of more letters are given room for a line of words.
    const LONG: usize = 40;
    let number = cell.trim().trim_end_matches('%').trim_end();
    match number.replace('\u{2212}', "-").parse::<f64>() {
        Ok(_) => Some("number"),
        Err(_) => (cell.chars().count() > LONG).then_some("long"),
    }
}

impl Page {
    /// An empty page with a title.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), blocks: Vec::new() }
    }

    /// A section heading.
    #[must_use]
    pub fn heading(self, text: &str) -> Self {
        self.block(Block::Heading(text.to_owned()))
    }

    /// A heading below a section heading.
    #[must_use]
    pub fn subheading(self, text: &str) -> Self {
        self.block(Block::Subheading(text.to_owned()))
    }

    /// A paragraph.
    #[must_use]
    pub fn paragraph(self, text: &str) -> Self {
        self.block(Block::Paragraph(text.to_owned()))
    }

    /// A paragraph set apart: the answer, or a warning.
    #[must_use]
    pub fn callout(self, text: &str) -> Self {
        self.block(Block::Callout(text.to_owned()))
    }

    /// A bulleted list.
    #[must_use]
    pub fn list<S: AsRef<str>>(self, items: &[S]) -> Self {
        self.block(Block::List(owned(items)))
    }

    /// Text kept as it stands, for commands and configuration.
    #[must_use]
    pub fn code(self, text: &str) -> Self {
        self.block(Block::Code(text.to_owned()))
    }

    /// A table; cells that read as numbers are set right.
    #[must_use]
    pub fn table<H: AsRef<str>, C: AsRef<str>>(self, header: &[H], rows: &[Vec<C>]) -> Self {
        self.block(Block::Table { header: owned(header), rows: rows.iter().map(|row| owned(row)).collect() })
    }

    /// A figure that can be zoomed, over its caption.
    #[must_use]
    pub fn figure(self, figure: Figure, caption: &str) -> Self {
        self.block(Block::Plots { figure: Box::new(figure), caption: caption.to_owned() })
    }

    /// The page as one HTML document.
    pub fn html(&self) -> String {
        let series: usize = self
            .blocks
            .iter()
            .map(|block| if let Block::Plots { figure, .. } = block { figure.series_count() } else { 0 })
            .sum();
        let points = (POINTS_OF_A_PAGE / series.max(1)).clamp(LEAST_POINTS, MOST_POINTS);
        let document = Document { title: &self.title, shared: SHARED, blocks: &self.blocks, points };
        document.render().expect("a page is written to a string")
    }

    /// Writes the page to a file; a page that is there is replaced.
    ///
    /// # Errors
    /// When the file cannot be written, or holds something else than a page.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), OutputError> {
        output::write(path, self.html(), Existing::Keep)
    }

    fn block(mut self, block: Block) -> Self {
        self.blocks.push(block);
        self
    }
}

fn owned<S: AsRef<str>>(texts: &[S]) -> Vec<String> {
    texts.iter().map(|text| text.as_ref().to_owned()).collect()
}

impl Figure {
    /// Writes the figure to `path`, as SVG, PNG or a page to zoom in, by its extension; one that is there is replaced.
    ///
    /// # Errors
    /// Another extension, a size that cannot be drawn, or a file that cannot be written.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), FigureError> {
        let path = path.as_ref();
        let extension = path.extension().map(|e| e.to_ascii_lowercase());
        let bytes = match extension.as_ref().and_then(|e| e.to_str()) {
            Some("svg") => self.svg()?.into_bytes(),
            Some("png") => self.png()?,
            Some("html") => {
                let (title, figure) = self.untitled();
                Page::new(title).figure(figure, "").html().into_bytes()
            }
            _ => return Err(FigureError::Extension(path.display().to_string())),
        };
        Ok(output::write(path, bytes, Existing::Keep)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::figure::Panel;

    fn page() -> Page {
        let wave = |phase: f64| -> Vec<(f64, f64)> {
            (0..500).map(|i| (f64::from(i) * 0.01, 30.0 * (f64::from(i) * 0.05 + phase).sin())).collect()
        };
        let turn: Vec<(f64, f64)> = (0..200).map(|i| (f64::from(i) * 0.05).sin_cos()).collect();
        let figure = Figure::new("a < b")
            .columns(2)
            .panel(Panel::new("time (s)", "speed (rpm)").line("measured", &wave(0.0)).dashed("simulated", &wave(0.2)))
            .panel(Panel::new("time (s)", "error (rpm)").line("</script>", &wave(1.0)).marks("on", &[1.0]))
            .panel(Panel::new("x (m)", "y (m)").line("path", &turn).points("at", &turn[..20]))
            .panel(Panel::new("f (Hz)", "|Y| (S)").x_log().y_log().band("95 %", &[(1.0, 1.0, 2.0), (1e4, 3.0, 1e3)]));
        Page::new("Bench <3>")
            .heading("Runs & such")
            .callout("named: \"dead-zone\"")
            .table(&["run", "rpm"], &[vec!["d50", "32.5"], vec!["<script>", "n/a"]])
            .figure(figure, "Speed")
    }

    #[test]
    fn text_is_escaped_and_nothing_is_fetched() {
        let html = page().html();
        assert!(html.contains("<h1>Bench &#60;3&#62;</h1>"));
        assert!(html.contains("Runs &#38; such"));
        assert!(html.contains("<td>&#60;script&#62;</td>") && html.contains("\"\\u003c/script>\""));
        // The library's own address, in its licence line.
        let links = html.replace("https://github.com/leeoniya/uPlot", "");
        for fetched in ["http", "src=", "href=", "@import", "url(", "fetch(", "import("] {
            assert!(!links.contains(fetched), "{fetched}");
        }
    }

    #[test]
    fn numbers_are_set_right() {
        let html = page().html();
        assert!(html.contains("<td class=\"number\">32.5</td>"));
        assert!(html.contains("<td>n/a</td>"));
    }

    #[test]
    fn a_page_of_many_long_lines_stays_small() {
        let line: Vec<(f64, f64)> =
            (0..50_000).map(|i| (f64::from(i) * 5e-4, (f64::from(i) * 0.0123).sin() * 35.0)).collect();
        let panel =
            (0..60).fold(Panel::new("time (s)", "speed (rpm)"), |panel, i| panel.line(format!("run {i}"), &line));
        let size = Page::new("many").figure(Figure::new("").panel(panel), "").html().len();
        assert!(size < 4_000_000, "{size} bytes");
    }

    /// As a person would use it: drag over the first panel, hide a line, show all again, on a desk and on a phone.
    #[test]
    fn a_browser_zooms_and_hides_a_line() {
        const USE: &str = r#"
            const over = document.querySelector(".u-over"), box = over.getBoundingClientRect();
            const mouse = (type, x, on = over) => on.dispatchEvent(new MouseEvent(type,
                { clientX: box.left + x * box.width, clientY: box.top + box.height / 2, movementX: 1, bubbles: true, view: window }));
            const { panels } = used, span = i => [panels[i].u.scales.x.min, panels[i].u.scales.x.max].map(v => v.toFixed(3)).join();
            const say = (name, value) => document.body.setAttribute("data-" + name, value);
            say("before", span(0));
            mouse("mouseenter", 0.2); mouse("mousemove", 0.2); mouse("mousedown", 0.2);
            mouse("mousemove", 0.6); mouse("mouseup", 0.6, document);
            setTimeout(() => {
                say("zoomed", span(0)); say("together", span(1)); say("apart", span(2));
                mouse("mousemove", 0.5);
                document.querySelector(".u-series.named th").click();
                setTimeout(() => {
                    say("cursor", document.querySelector(".panel output").textContent);
                    say("value", document.querySelectorAll(".u-value")[1].textContent);
                    say("hidden", panels[0].u.series[1].show + "," + panels[0].u.series[2].show);
                    document.querySelector("button[title='show all']").click();
                    setTimeout(() => { say("after", span(0)); say("wide", document.documentElement.scrollWidth - innerWidth); }, 50);
                }, 50);
            }, 50);"#;
        let html = page().html();
        let html =
            html.replace("<script>plots.all();</script>", "<script>const used = { panels: plots.all()[0] };</script>");
        for width_px in [1280, 390] {
            let Some(seen) = browser::show(&html, "", USE, width_px) else { return };
            assert_eq!(seen.console, Vec::<String>::new(), "{width_px} px");
            assert_eq!(seen.attribute("data-plots"), "4");
            assert_eq!(seen.attribute("data-before"), "0.000,4.990");
            let ends: Vec<f64> = seen.attribute("data-zoomed").split(',').map(|v| v.parse().unwrap()).collect();
            assert!((ends[0] - 0.998).abs() < 0.05 && (ends[1] - 2.994).abs() < 0.05, "{ends:?}");
            assert_eq!(seen.attribute("data-together"), seen.attribute("data-zoomed"));
            assert_eq!(seen.attribute("data-apart"), "-1.080,1.080", "as it was, with room for its points");
            assert!(seen.attribute("data-cursor").starts_with("time (s): "), "{}", seen.attribute("data-cursor"));
            assert!(
                seen.attribute("data-value").parse::<f64>().is_ok()
                    || seen.attribute("data-value").starts_with('\u{2212}')
            );
            assert_eq!(seen.attribute("data-hidden"), "false,true");
            assert_eq!(seen.attribute("data-after"), "0.000,4.990");
            assert!(
                seen.attribute("data-wide").parse::<i32>().unwrap() <= 0,
                "the page scrolls sideways at {width_px} px"
            );
        }
    }
}
