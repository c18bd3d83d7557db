//! Figures: panels of lines, points and bands over labelled axes.
//!
//! The text is set in the embedded DejaVu Sans, so a figure looks the same on every machine and needs neither a
//! display nor an installed font. A value that is not finite is a gap and is drawn as one.

mod axis;
mod draw;
pub mod interactive;
mod over;
mod trace;

use crate::output::OutputError;

/// Why a figure was not made.
#[derive(Debug, thiserror::Error)]
pub enum FigureError {
    /// The figure is smaller than its labels, or larger than an image may be.
    #[error(
        "a figure of {width} x {height} px with {panels} panel(s) cannot be drawn: take a size between {min_height} px high (and 200 px wide) and 20000 px"
    )]
    Size {
        /// Width asked for, in pixels.
        width: u32,
        /// Height asked for, in pixels.
        height: u32,
        /// Number of panels.
        panels: usize,
        /// Least height that holds the panels, in pixels.
        min_height: u32,
    },
    /// The drawing library refused.
    #[error("drawing failed: {0}")]
    Draw(String),
    /// The PNG encoder refused.
    #[error("encoding the PNG failed")]
    Png(#[from] png::EncodingError),
    /// The file name ends in none of `.svg`, `.png` and `.html`.
    #[error("{0}: a figure is written as .svg, .png or .html, name the file accordingly")]
    Extension(String),
    /// The file could not be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// A figure: a title over panels laid out in rows.
#[derive(Debug, Clone)]
pub struct Figure {
    title: String,
    width: u32,
    height: Option<u32>,
    columns: usize,
    panels: Vec<Panel>,
}

impl Figure {
    /// An empty figure, 960 px wide and 320 px high for each row of panels.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), width: 960, height: None, columns: 1, panels: Vec::new() }
    }

    /// Sets width and height, in pixels.
    #[must_use]
    pub fn size(mut self, width_px: u32, height_px: u32) -> Self {
        (self.width, self.height) = (width_px, Some(height_px));
        self
    }

    /// Lays the panels out in rows of this many (at least 1).
    #[must_use]
    pub fn columns(mut self, columns: usize) -> Self {
        self.columns = columns.max(1);
        self
    }

    /// Adds a panel after the others, left to right and top to bottom.
    #[must_use]
    pub fn panel(mut self, panel: Panel) -> Self {
        self.panels.push(panel);
        self
    }

    /// The title.
    pub fn title(&self) -> &str {
        &self.title
    }

    /// The figure as an SVG document.
    ///
    /// # Errors
    /// [`FigureError::Size`] when the panels do not fit.
    pub fn svg(&self) -> Result<String, FigureError> {
        draw::svg(self)
    }

    /// The figure as a PNG file.
    ///
    /// # Errors
    /// [`FigureError::Size`] when the panels do not fit.
    pub fn png(&self) -> Result<Vec<u8>, FigureError> {
        draw::png(self)
    }

    /// Its title, and the figure without it: what a page has in its heading is not said twice.
    pub fn untitled(&self) -> (String, Self) {
        (self.title.clone(), Self { title: String::new(), ..self.clone() })
    }

    fn rows(&self) -> usize {
        self.panels.len().div_ceil(self.columns).max(1)
    }

    fn height_px(&self) -> u32 {
        self.height.unwrap_or(40 + 320 * self.rows() as u32)
    }
}

/// One pair of axes and what is drawn between them.
///
/// Series with the same non-empty label share a colour throughout the figure; a band takes the colour of the series
/// before it. A series with an empty label is left out of the legend.
#[derive(Debug, Clone)]
pub struct Panel {
    title: String,
    x_label: String,
    y_label: String,
    x_range: Option<(f64, f64)>,
    y_range: Option<(f64, f64)>,
    x_log: bool,
    y_log: bool,
    series: Vec<Series>,
}

#[derive(Debug, Clone)]
struct Series {
    label: String,
    shape: Shape,
}

#[derive(Debug, Clone)]
enum Shape {
    Line(Vec<(f64, f64)>),
    Dashed(Vec<(f64, f64)>),
    Points(Vec<(f64, f64)>),
    /// `(x, low, high)`.
    Band(Vec<(f64, f64, f64)>),
    /// Vertical lines at these x.
    Marks(Vec<f64>),
}

impl Panel {
    /// An empty panel; the labels name the quantity and its unit, as in `"time (s)"`.
    pub fn new(x_label: impl Into<String>, y_label: impl Into<String>) -> Self {
        Self {
            title: String::new(),
            x_label: x_label.into(),
            y_label: y_label.into(),
            x_range: None,
            y_range: None,
            x_log: false,
            y_log: false,
            series: Vec::new(),
        }
    }

    /// A line above the panel.
    #[must_use]
    pub fn title(mut self, title: impl Into<String>) -> Self {
        self.title = title.into();
        self
    }

    /// Shows x from `low` to `high` only; what lies outside is cut off.
    #[must_use]
    pub fn x_range(mut self, low: f64, high: f64) -> Self {
        self.x_range = Some((low, high));
        self
    }

    /// Shows y from `low` to `high` only; what lies outside is cut off.
    #[must_use]
    pub fn y_range(mut self, low: f64, high: f64) -> Self {
        self.y_range = Some((low, high));
        self
    }

    /// A logarithmic x axis; values not above zero are gaps.
    #[must_use]
    pub fn x_log(mut self) -> Self {
        self.x_log = true;
        self
    }

    /// A logarithmic y axis; values not above zero are gaps.
    #[must_use]
    pub fn y_log(mut self) -> Self {
        self.y_log = true;
        self
    }

    /// Joins `(x, y)` in the order given; a value that is not finite breaks the line.
    #[must_use]
    pub fn line(self, label: impl Into<String>, points: &[(f64, f64)]) -> Self {
        self.series(label, Shape::Line(points.to_vec()))
    }

    /// As [`Panel::line`], dashed.
    #[must_use]
    pub fn dashed(self, label: impl Into<String>, points: &[(f64, f64)]) -> Self {
        self.series(label, Shape::Dashed(points.to_vec()))
    }

    /// A dot at each `(x, y)`.
    #[must_use]
    pub fn points(self, label: impl Into<String>, points: &[(f64, f64)]) -> Self {
        self.series(label, Shape::Points(points.to_vec()))
    }

    /// Shades between `low` and `high` of `(x, low, high)`, behind the lines.
    #[must_use]
    pub fn band(self, label: impl Into<String>, points: &[(f64, f64, f64)]) -> Self {
        self.series(label, Shape::Band(points.to_vec()))
    }

    /// A vertical line at each x, for events.
    #[must_use]
    pub fn marks(self, label: impl Into<String>, x: &[f64]) -> Self {
        self.series(label, Shape::Marks(x.to_vec()))
    }

    fn series(mut self, label: impl Into<String>, shape: Shape) -> Self {
        self.series.push(Series { label: label.into(), shape });
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Figure {
        let wave: Vec<(f64, f64)> = (0..200)
            .map(|i| (i as f64 * 0.01, if (60..90).contains(&i) { f64::NAN } else { 40.0 * (i as f64 * 0.1).sin() }))
            .collect();
        let band: Vec<(f64, f64, f64)> = wave.iter().map(|&(x, y)| (x, y - 5.0, y + 5.0)).collect();
        Figure::new("Speed & <edges>")
            .size(640, 400)
            .panel(Panel::new("time (s)", "speed (rpm)").line("measured", &wave).band("95 %", &band))
    }

    #[test]
    fn equal_input_gives_equal_bytes() {
        assert_eq!(example().svg().unwrap(), example().svg().unwrap());
        assert_eq!(example().png().unwrap(), example().png().unwrap());
    }

    #[test]
    fn svg_escapes_text_and_breaks_the_line_at_the_gap() {
        let svg = example().svg().unwrap();
        assert!(svg.contains("Speed &amp; &lt;edges&gt;"));
        assert!(svg.contains("speed (rpm)"));
        let data = svg.lines().filter(|l| l.starts_with("<polyline") && l.contains(draw::FIRST_COLOUR)).count();
        assert_eq!(data, 2 + 1, "two stretches of the line and its legend");
        assert_eq!(svg.lines().filter(|l| l.starts_with("<polygon")).count(), 2, "two stretches of the band");
    }

    #[test]
    fn png_has_the_size_asked_for() {
        let png = example().png().unwrap();
        let reader = png::Decoder::new(png.as_slice()).read_info().unwrap();
        assert_eq!((reader.info().width, reader.info().height), (640, 400));
    }

    #[test]
    fn awkward_data_is_drawn() {
        let nan = f64::NAN;
        for points in [
            vec![],
            vec![(nan, nan)],
            vec![(1.0, 1.0)],
            vec![(0.0, 1e-300), (1.0, 1e300)],
            vec![(0.0, f64::INFINITY), (1.0, 2.0)],
            vec![(f64::MIN, f64::MIN), (f64::MAX, f64::MAX)],
            vec![(5.0, 5.0); 3],
        ] {
            for panel in [Panel::new("x", "y"), Panel::new("x", "y").x_log().y_log()] {
                let figure =
                    Figure::new("").panel(panel.line("a", &points).points("b", &points).marks("c", &[nan, 1.0]));
                figure.svg().unwrap();
                figure.png().unwrap();
            }
        }
    }

    #[test]
    fn bad_sizes_and_names_are_refused() {
        assert!(matches!(example().size(10, 10).svg(), Err(FigureError::Size { .. })));
        assert!(matches!(example().size(100_000, 400).png(), Err(FigureError::Size { .. })));
        assert!(matches!(example().write("figure.pdf"), Err(FigureError::Extension(_))));
    }
}
