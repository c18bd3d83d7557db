//! Drawing a figure with plotters.

use super::axis::Axis;
use super::trace::{Frame, Pixel, clip, dashes, stretches, thin};
use super::{Figure, FigureError, Panel, Shape};
use plotters::backend::{BitMapBackend, DrawingBackend, SVGBackend};
use plotters::coord::Shift;
use plotters::drawing::{DrawingArea, IntoDrawingArea};
use plotters::element::{Circle, PathElement, Polygon, Rectangle, Text};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{
    Color, FontStyle, FontTransform, IntoFont, RGBAColor, RGBColor, ShapeStyle, TextStyle, WHITE, register_font,
};
use std::collections::{BTreeSet, HashMap};
use std::sync::Once;

/// Okabe and Ito's palette (2008), told apart by readers with any common colour vision.
const PALETTE: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(160, 120, 0),
    RGBColor(90, 90, 90),
    RGBColor(230, 159, 0),
];
/// The first colour of the palette as the SVG backend writes it.
#[cfg(test)]
pub(super) const FIRST_COLOUR: &str = "#0072B2";

const INK: RGBColor = RGBColor(40, 40, 40);
const GRID: RGBColor = RGBColor(225, 225, 225);
const FRAME_INK: RGBColor = RGBColor(120, 120, 120);
/// The embedded face first, then faces of the same widths for viewers of an SVG.
const FONT: &str = "DejaVu Sans, Verdana, sans-serif";

/// Pixels of the drawing for a pixel of the figure: plotters draws at whole pixels, so the SVG is drawn large and scaled
/// by its view box, the PNG is drawn large and averaged down.
const SVG_SCALE: u32 = 8;
const PNG_SCALE: u32 = 2;

const TITLE_PX: f64 = 18.0;
const TEXT_PX: f64 = 14.0;
const MIN_PANEL_HEIGHT: u32 = 110;

pub(super) fn svg(figure: &Figure) -> Result<String, FigureError> {
    let (width, height) = checked_size(figure)?;
    let large = (width * SVG_SCALE, height * SVG_SCALE);
    let mut out = String::new();
    draw(figure, SVGBackend::with_string(&mut out, large).into_drawing_area(), f64::from(SVG_SCALE), Joints::Together)?;
    let body = out.split_once('\n').map_or("", |(_, body)| body);
    Ok(format!(
        "<svg width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {} {}\" stroke-linejoin=\"round\" \
         xmlns=\"http://www.w3.org/2000/svg\">\n{body}",
        large.0, large.1
    ))
}

pub(super) fn png(figure: &Figure) -> Result<Vec<u8>, FigureError> {
    let (width, height) = checked_size(figure)?;
    let large = (width * PNG_SCALE, height * PNG_SCALE);
    let mut pixels = vec![0u8; large.0 as usize * large.1 as usize * 3];
    draw(
        figure,
        BitMapBackend::with_buffer(&mut pixels, large).into_drawing_area(),
        f64::from(PNG_SCALE),
        Joints::Apart,
    )?;
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header()?.write_image_data(&averaged_down(&pixels, width as usize, height as usize))?;
    Ok(out)
}

fn averaged_down(pixels: &[u8], width: usize, height: usize) -> Vec<u8> {
    let scale = PNG_SCALE as usize;
    let mut out = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        for x in 0..width {
            for channel in 0..3 {
                let mut sum = 0usize;
                for (dy, dx) in (0..scale * scale).map(|i| (i / scale, i % scale)) {
                    sum += usize::from(pixels[((y * scale + dy) * width * scale + x * scale + dx) * 3 + channel]);
                }
                out.push((sum / (scale * scale)) as u8);
            }
        }
    }
    out
}

fn checked_size(figure: &Figure) -> Result<(u32, u32), FigureError> {
    let (width, height) = (figure.width, figure.height_px());
    let min_height = 40 + MIN_PANEL_HEIGHT * figure.rows() as u32;
    if width < 200 || height < min_height || width > 20_000 || height > 20_000 {
        return Err(FigureError::Size { width, height, panels: figure.panels.len(), min_height });
    }
    Ok((width, height))
}

fn draw<B: DrawingBackend>(
    figure: &Figure,
    area: DrawingArea<B, Shift>,
    scale: f64,
    joints: Joints,
) -> Result<(), FigureError> {
    register_fonts();
    let canvas = Canvas { area, scale, joints };
    let (width, height) = (f64::from(figure.width), f64::from(figure.height_px()));
    canvas.fill(WHITE)?;
    let top = if figure.title.is_empty() { 8.0 } else { 40.0 };
    if !figure.title.is_empty() {
        // Bold letters are a little wider than those measured.
        let wide = 1.1 * canvas.text_width(&figure.title, TITLE_PX)?;
        let size_px = TITLE_PX * ((width - 20.0) / wide).clamp(0.5, 1.0);
        canvas.text(&figure.title, (width / 2.0, 22.0), size_px, Place::Centre, FontStyle::Bold)?;
    }
    let columns = figure.columns.min(figure.panels.len().max(1));
    let (cell_width, cell_height) = (width / columns as f64, (height - top) / figure.rows() as f64);
    let mut colours = Colours::default();
    for (i, panel) in figure.panels.iter().enumerate() {
        let (left, top) = ((i % columns) as f64 * cell_width, top + (i / columns) as f64 * cell_height);
        let cell = Frame { left, top, right: left + cell_width, bottom: top + cell_height };
        canvas.panel(panel, cell, &mut colours)?;
    }
    canvas.area.present().map_err(refused)
}

fn register_fonts() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        for (style, bytes) in [(FontStyle::Normal, dejavu::sans::regular()), (FontStyle::Bold, dejavu::sans::bold())] {
            // An embedded font that does not parse is a broken build, and every test of this module fails on it.
            let _ = register_font(FONT, style, bytes);
        }
    });
}

/// Colours given out so far.
#[derive(Default)]
pub(super) struct Colours {
    of_label: HashMap<String, RGBColor>,
    next: usize,
}

impl Colours {
    fn of(&mut self, label: &str) -> RGBColor {
        if let Some(colour) = self.of_label.get(label) {
            return *colour;
        }
        let colour = PALETTE[self.next % PALETTE.len()];
        self.next += 1;
        if !label.is_empty() {
            self.of_label.insert(label.to_owned(), colour);
        }
        colour
    }
}

/// Where a text lies relative to the point given.
#[derive(Clone, Copy)]
enum Place {
    Centre,
    Left,
    Right,
    Up,
}

/// A drawing area addressed in pixels of the figure.
struct Canvas<B: DrawingBackend> {
    area: DrawingArea<B, Shift>,
    scale: f64,
    joints: Joints,
}

/// How the segments of a line meet. The bitmap backend mitres them, which throws spikes where a line turns back on itself,
/// so there each segment is drawn alone; SVG rounds them by itself.
#[derive(Clone, Copy)]
enum Joints {
    Together,
    Apart,
}

fn refused<E: std::error::Error + Send + Sync>(error: plotters::drawing::DrawingAreaErrorKind<E>) -> FigureError {
    FigureError::Draw(error.to_string())
}

impl<B: DrawingBackend> Canvas<B> {
    fn at(&self, p: Pixel) -> (i32, i32) {
        ((p.0 * self.scale).round() as i32, (p.1 * self.scale).round() as i32)
    }

    fn stroke(&self, colour: impl Color, width_px: f64) -> ShapeStyle {
        colour.stroke_width((width_px * self.scale).round().max(1.0) as u32)
    }

    fn fill(&self, colour: RGBColor) -> Result<(), FigureError> {
        self.area.fill(&colour).map_err(refused)
    }

    fn path(&self, points: &[Pixel], style: ShapeStyle) -> Result<(), FigureError> {
        let points: Vec<(i32, i32)> = points.iter().map(|p| self.at(*p)).collect();
        match self.joints {
            Joints::Together => self.area.draw(&PathElement::new(points, style)).map_err(refused),
            Joints::Apart => points
                .windows(2)
                .try_for_each(|pair| self.area.draw(&PathElement::new(pair.to_vec(), style)).map_err(refused)),
        }
    }

    fn polygon(&self, points: &[Pixel], colour: RGBAColor) -> Result<(), FigureError> {
        let points: Vec<(i32, i32)> = points.iter().map(|p| self.at(*p)).collect();
        self.area.draw(&Polygon::new(points, colour.filled())).map_err(refused)
    }

    fn dot(&self, p: Pixel, radius_px: f64, colour: RGBColor) -> Result<(), FigureError> {
        let radius = (radius_px * self.scale).round() as i32;
        self.area.draw(&Circle::new(self.at(p), radius, colour.filled())).map_err(refused)
    }

    fn font(&self, size_px: f64, style: FontStyle) -> TextStyle<'static> {
        // plotters' font size is that of the line box; 1.24 is its ratio to the em.
        (FONT, size_px * self.scale, style).into_font().color(&INK)
    }

    fn text(&self, text: &str, p: Pixel, size_px: f64, place: Place, style: FontStyle) -> Result<(), FigureError> {
        let h = match place {
            Place::Left => HPos::Left,
            Place::Right => HPos::Right,
            Place::Centre | Place::Up => HPos::Center,
        };
        let mut font = self.font(size_px, style).pos(Pos::new(h, VPos::Center));
        if matches!(place, Place::Up) {
            font = font.transform(FontTransform::Rotate270);
        }
        self.area.draw(&Text::new(text.to_owned(), self.at(p), font)).map_err(refused)
    }

    fn text_width(&self, text: &str, size_px: f64) -> Result<f64, FigureError> {
        let size = self.area.estimate_text_size(text, &self.font(size_px, FontStyle::Normal)).map_err(refused)?;
        Ok(f64::from(size.0) / self.scale)
    }

    fn panel(&self, panel: &Panel, cell: Frame, colours: &mut Colours) -> Result<(), FigureError> {
        let styles = series_colours(panel, colours);
        let legend_rows = self.legend_rows(panel, cell.right - cell.left - 24.0)?;
        let title_height = if panel.title.is_empty() { 0.0 } else { 20.0 };
        let (x_axis, y_axis) = axes(panel);
        let head = title_height + 20.0 * legend_rows.len() as f64;
        let bottom = cell.bottom - 46.0;
        let top = (cell.top + head + 8.0).min(bottom - 30.0);
        let y_ticks = y_axis.ticks((((bottom - top) / 38.0) as usize).clamp(2, 10));
        // At least this wide, so that most panels above each other line up.
        let mut tick_width = self.text_width("\u{2212}00.0", TEXT_PX)?;
        for (_, text) in &y_ticks {
            tick_width = tick_width.max(self.text_width(text, TEXT_PX)?);
        }
        let frame = Frame { left: cell.left + 34.0 + tick_width, top, right: cell.right - 18.0, bottom };
        let x_ticks = x_axis.ticks((((frame.right - frame.left) / 80.0) as usize).clamp(2, 12));

        if !panel.title.is_empty() {
            self.text(&panel.title, (frame.left, cell.top + 9.0), TEXT_PX, Place::Left, FontStyle::Bold)?;
        }
        self.legend(panel, &styles, &legend_rows, (frame.left, cell.top + title_height + 9.0))?;
        self.axes(panel, frame, cell, &x_ticks, &y_ticks)?;
        let project = |x: f64, y: f64| {
            (
                frame.left + x_axis.fraction(x) * (frame.right - frame.left),
                frame.bottom - y_axis.fraction(y) * (frame.bottom - frame.top),
            )
        };
        for bands_first in [true, false] {
            for (series, colour) in panel.series.iter().zip(&styles) {
                if matches!(series.shape, Shape::Band(_)) == bands_first {
                    self.shape(&series.shape, *colour, frame, &project)?;
                }
            }
        }
        let Frame { left, top, right, bottom } = frame;
        let around = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)];
        self.path(&around, self.stroke(FRAME_INK, 1.0))
    }

    fn axes(
        &self,
        panel: &Panel,
        frame: Frame,
        cell: Frame,
        x_ticks: &[(f64, String)],
        y_ticks: &[(f64, String)],
    ) -> Result<(), FigureError> {
        let grid = self.stroke(GRID, 1.0);
        for (fraction, text) in x_ticks {
            let x = frame.left + fraction * (frame.right - frame.left);
            self.path(&[(x, frame.top), (x, frame.bottom)], grid)?;
            self.text(text, (x, frame.bottom + 12.0), TEXT_PX, Place::Centre, FontStyle::Normal)?;
        }
        for (fraction, text) in y_ticks {
            let y = frame.bottom - fraction * (frame.bottom - frame.top);
            self.path(&[(frame.left, y), (frame.right, y)], grid)?;
            self.text(text, (frame.left - 5.0, y), TEXT_PX, Place::Right, FontStyle::Normal)?;
        }
        let middle = ((frame.left + frame.right) / 2.0, (frame.top + frame.bottom) / 2.0);
        self.text(&panel.x_label, (middle.0, frame.bottom + 31.0), TEXT_PX, Place::Centre, FontStyle::Normal)?;
        self.text(&panel.y_label, (cell.left + 15.0, middle.1), TEXT_PX, Place::Up, FontStyle::Normal)
    }

    /// The labelled series, each label once, broken into rows that fit `width`; each entry is its index and its x offset.
    fn legend_rows(&self, panel: &Panel, width: f64) -> Result<Vec<Vec<(usize, f64)>>, FigureError> {
        let mut rows: Vec<Vec<(usize, f64)>> = Vec::new();
        let mut x = f64::INFINITY;
        let listed = |i: usize, label: &str| label.is_empty() || panel.series[..i].iter().any(|s| s.label == label);
        for (i, series) in panel.series.iter().enumerate().filter(|(i, s)| !listed(*i, &s.label)) {
            let needed = 30.0 + self.text_width(&series.label, TEXT_PX)? + 18.0;
            if x + needed > width {
                rows.push(Vec::new());
                x = 0.0;
            }
            if let Some(row) = rows.last_mut() {
                row.push((i, x));
            }
            x += needed;
        }
        Ok(rows)
    }

    fn legend(
        &self,
        panel: &Panel,
        colours: &[RGBColor],
        rows: &[Vec<(usize, f64)>],
        origin: Pixel,
    ) -> Result<(), FigureError> {
        for (row, entries) in rows.iter().enumerate() {
            let y = origin.1 + 20.0 * row as f64;
            for &(i, offset) in entries {
                let (x, colour, series) = (origin.0 + offset, colours[i], &panel.series[i]);
                match series.shape {
                    Shape::Line(_) => self.path(&[(x, y), (x + 24.0, y)], self.stroke(colour, 2.0))?,
                    Shape::Dashed(_) => {
                        for dash in dashes(&[(x, y), (x + 24.0, y)], 6.0, 4.0) {
                            self.path(&dash, self.stroke(colour, 2.0))?;
                        }
                    }
                    Shape::Points(_) => self.dot((x + 12.0, y), 3.0, colour)?,
                    Shape::Band(_) => {
                        let (a, b) = (self.at((x, y - 6.0)), self.at((x + 24.0, y + 6.0)));
                        self.area.draw(&Rectangle::new([a, b], colour.mix(0.25).filled())).map_err(refused)?;
                    }
                    Shape::Marks(_) => {
                        self.path(&[(x + 12.0, y - 7.0), (x + 12.0, y + 7.0)], self.stroke(colour, 1.0))?
                    }
                }
                self.text(&series.label, (x + 30.0, y), TEXT_PX, Place::Left, FontStyle::Normal)?;
            }
        }
        Ok(())
    }

    fn shape(
        &self,
        shape: &Shape,
        colour: RGBColor,
        frame: Frame,
        project: &impl Fn(f64, f64) -> Pixel,
    ) -> Result<(), FigureError> {
        match shape {
            Shape::Line(points) => {
                for part in visible(points, frame, project) {
                    self.path(&part, self.stroke(colour, 1.5))?;
                }
            }
            Shape::Dashed(points) => {
                for dash in visible(points, frame, project).iter().flat_map(|part| dashes(part, 6.0, 4.0)) {
                    self.path(&dash, self.stroke(colour, 1.5))?;
                }
            }
            Shape::Points(points) => {
                let inside = |p: &Pixel| {
                    (frame.left - 1.0..=frame.right + 1.0).contains(&p.0)
                        && (frame.top - 1.0..=frame.bottom + 1.0).contains(&p.1)
                };
                let radius = if points.len() > 400 { 1.3 } else { 2.6 };
                let mut seen = BTreeSet::new();
                for p in points.iter().map(|&(x, y)| project(x, y)).filter(inside) {
                    if seen.insert(self.at(p)) {
                        self.dot(p, radius, colour)?;
                    }
                }
            }
            Shape::Band(points) => self.band(points, colour, frame, project)?,
            Shape::Marks(at) => {
                for &x in at {
                    let x = project(x, f64::NAN).0;
                    if (frame.left..=frame.right).contains(&x) {
                        self.path(&[(x, frame.top), (x, frame.bottom)], self.stroke(colour, 1.0))?;
                    }
                }
            }
        }
        Ok(())
    }

    fn band(
        &self,
        points: &[(f64, f64, f64)],
        colour: RGBColor,
        frame: Frame,
        project: &impl Fn(f64, f64) -> Pixel,
    ) -> Result<(), FigureError> {
        let projected = points.iter().map(|&(x, low, high)| (project(x, low), project(x, high)));
        let finite = |(a, b): &(Pixel, Pixel)| a.0.is_finite() && a.1.is_finite() && b.1.is_finite();
        for stretch in stretches(projected, finite) {
            let inside = stretch.iter().filter(|(a, _)| (frame.left..=frame.right).contains(&a.0));
            let mut columns: Vec<(f64, f64, f64)> = Vec::new();
            for (a, b) in inside {
                let (top, bottom) = (a.1.min(b.1).max(frame.top), a.1.max(b.1).min(frame.bottom));
                match columns.last_mut() {
                    Some(c) if (c.0 * 4.0).floor() == (a.0 * 4.0).floor() => {
                        (c.1, c.2) = (c.1.min(top), c.2.max(bottom))
                    }
                    _ => columns.push((a.0, top.min(frame.bottom), bottom.max(frame.top))),
                }
            }
            let upper = columns.iter().map(|c| (c.0, c.1));
            let lower = columns.iter().rev().map(|c| (c.0, c.2));
            self.polygon(&upper.chain(lower).collect::<Vec<_>>(), colour.mix(0.25))?;
        }
        Ok(())
    }
}

fn visible(points: &[(f64, f64)], frame: Frame, project: &impl Fn(f64, f64) -> Pixel) -> Vec<Vec<Pixel>> {
    let projected = points.iter().map(|&(x, y)| project(x, y));
    stretches(projected, |p| p.0.is_finite() && p.1.is_finite())
        .iter()
        .flat_map(|stretch| clip(&thin(stretch), frame))
        .collect()
}

pub(super) fn series_colours(panel: &Panel, colours: &mut Colours) -> Vec<RGBColor> {
    let mut before = None;
    panel
        .series
        .iter()
        .map(|series| {
            let colour = match (&series.shape, before) {
                (Shape::Band(_), Some(colour)) => colour,
                _ => colours.of(&series.label),
            };
            before = Some(colour);
            colour
        })
        .collect()
}

fn axes(panel: &Panel) -> (Axis, Axis) {
    let (mut xs, mut ys) = (Vec::new(), Vec::new());
    // The y range covers what the x range shows.
    let shown = |x: f64| panel.x_range.is_none_or(|(low, high)| (low..=high).contains(&x));
    for series in &panel.series {
        match &series.shape {
            Shape::Line(points) | Shape::Dashed(points) | Shape::Points(points) => {
                for &(x, y) in points.iter().filter(|p| p.0.is_finite() && p.1.is_finite() && shown(p.0)) {
                    xs.push(x);
                    ys.push(y);
                }
            }
            Shape::Band(points) => {
                for &(x, low, high) in points.iter().filter(|p| p.0.is_finite() && shown(p.0)) {
                    xs.push(x);
                    ys.extend([low, high]);
                }
            }
            Shape::Marks(at) => xs.extend(at),
        }
    }
    let x_axis = Axis::new(xs.into_iter(), panel.x_range, panel.x_log);
    let y_axis = Axis::new(ys.into_iter(), panel.y_range, panel.y_log);
    (x_axis, if panel.y_range.is_some() { y_axis } else { y_axis.padded(0.04) })
}
