//! A figure as data for a page's plotting library.

use super::draw::{Colours, series_colours};
use super::trace::stretches;
use super::{Figure, Panel, Shape};
use serde::Serialize;

/// A figure as a page's script reads it (`templates/plots.js`).
#[derive(Debug, Serialize)]
pub struct Interactive {
    columns: usize,
    panels: Vec<PanelData>,
    /// Whether some line has fewer points than the figure's.
    #[serde(skip)]
    pub thinned: bool,
}

#[derive(Debug, Serialize)]
struct PanelData {
    title: String,
    x_label: String,
    y_label: String,
    x_range: Option<(f64, f64)>,
    y_range: Option<(f64, f64)>,
    x_log: bool,
    y_log: bool,
    series: Vec<SeriesData>,
}

#[derive(Debug, Serialize)]
struct SeriesData {
    label: String,
    colour: String,
    shape: &'static str,
    x: Vec<f64>,
    /// None is a gap; the lower edge of a band.
    y: Vec<Option<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    high: Option<Vec<Option<f64>>>,
}

/// x, y, and the upper edge of a band.
type Row = [f64; 3];

impl Figure {
    /// Number of lines, bands and clouds of points.
    pub fn series_count(&self) -> usize {
        self.panels.iter().map(|panel| panel.series.len()).sum()
    }

    /// The figure's data, about `most_points` a series at most: of longer ones the extremes of equal stretches are kept.
    pub fn interactive(&self, most_points: usize) -> Interactive {
        let mut colours = Colours::default();
        let mut thinned = false;
        let panels = self.panels.iter().map(|panel| data_of(panel, &mut colours, most_points, &mut thinned)).collect();
        Interactive { columns: self.columns, panels, thinned }
    }
}

fn data_of(panel: &Panel, colours: &mut Colours, most_points: usize, thinned: &mut bool) -> PanelData {
    let mut joined: Vec<(&str, &'static str, String, Vec<Row>)> = Vec::new();
    for (series, colour) in panel.series.iter().zip(series_colours(panel, colours)) {
        let (shape, rows) = rows(&series.shape);
        let kept = thin(&rows, most_points);
        *thinned |= kept.len() < rows.iter().filter(|row| row.iter().all(|v| v.is_finite())).count();
        match joined.iter_mut().find(|it| !it.0.is_empty() && it.0 == series.label && it.1 == shape) {
            // Stretches of one name are one line with gaps.
            Some(same) => {
                same.3.push([f64::NAN; 3]);
                same.3.extend(kept);
            }
            None => {
                joined.push((&series.label, shape, format!("#{:02x}{:02x}{:02x}", colour.0, colour.1, colour.2), kept))
            }
        }
    }
    let all = || joined.iter().flat_map(|it| &it.3);
    let x_digits = digits(all().map(|row| row[0]), panel.x_log);
    let y_digits = digits(all().flat_map(|row| [row[1], row[2]]), panel.y_log);
    let series = joined.iter().map(|(label, shape, colour, rows)| {
        let y = |column: usize| rows.iter().map(|row| finite(y_digits(row[column]))).collect::<Vec<_>>();
        let mut before = 0.0;
        SeriesData {
            label: (*label).to_owned(),
            colour: colour.clone(),
            shape,
            x: rows
                .iter()
                .map(|row| {
                    before = finite(x_digits(row[0])).unwrap_or(before);
                    before
                })
                .collect(),
            y: if *shape == "marks" { vec![None; rows.len()] } else { y(1) },
            high: (*shape == "band").then(|| y(2)),
        }
    });
    PanelData {
        title: panel.title.clone(),
        x_label: panel.x_label.clone(),
        y_label: panel.y_label.clone(),
        x_range: panel.x_range,
        y_range: panel.y_range,
        x_log: panel.x_log,
        y_log: panel.y_log,
        series: series.collect(),
    }
}

fn rows(shape: &Shape) -> (&'static str, Vec<Row>) {
    let plain = |points: &[(f64, f64)]| points.iter().map(|&(x, y)| [x, y, y]).collect();
    match shape {
        Shape::Line(points) => ("line", plain(points)),
        Shape::Dashed(points) => ("dashed", plain(points)),
        Shape::Points(points) => ("points", plain(points)),
        Shape::Band(points) => ("band", points.iter().map(|&(x, low, high)| [x, low, high]).collect()),
        Shape::Marks(at) => ("marks", at.iter().filter(|x| x.is_finite()).map(|&x| [x; 3]).collect()),
    }
}

/// Keeps of each of equal stretches what is first, last, least and greatest in every column; a gap stays a gap.
fn thin(rows: &[Row], most_points: usize) -> Vec<Row> {
    /// First and last, and two extremes of three columns.
    const KEPT_OF_A_STRETCH: usize = 8;
    let length = (rows.len() * KEPT_OF_A_STRETCH).div_ceil(most_points.max(KEPT_OF_A_STRETCH)).max(1);
    let mut kept = Vec::new();
    for whole in stretches(rows.iter().copied(), |row| row.iter().all(|v| v.is_finite())) {
        if !kept.is_empty() {
            kept.push([f64::NAN; 3]);
        }
        if rows.len() <= most_points {
            kept.extend(whole);
            continue;
        }
        for stretch in whole.chunks(length) {
            let mut indices = vec![0, stretch.len() - 1];
            for column in 0..3 {
                let by = |a: &usize, b: &usize| stretch[*a][column].total_cmp(&stretch[*b][column]);
                indices.extend((0..stretch.len()).min_by(by));
                indices.extend((0..stretch.len()).max_by(by));
            }
            indices.sort_unstable();
            indices.dedup();
            kept.extend(indices.into_iter().map(|index| stretch[index]));
        }
    }
    kept
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// Rounds to a millionth of the range, or of the value on a logarithmic axis: more than a screen shows at a hundredfold zoom.
fn digits(values: impl Iterator<Item = f64>, log: bool) -> impl Fn(f64) -> f64 {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    move |value: f64| {
        let scale = if log { value.abs() } else { high - low };
        let decimals = 6.0 - scale.log10().floor();
        if !decimals.is_finite() || !(-15.0..=15.0).contains(&decimals) {
            return value;
        }
        let unit = 10f64.powi(decimals as i32);
        (value * unit).round() / unit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_line_keeps_its_spike_and_its_gap() {
        let line: Vec<(f64, f64)> = (0..100_000)
            .map(|i| match i {
                40_000..40_100 => (f64::from(i), f64::NAN),
                73_211 => (f64::from(i), 9.0),
                _ => (f64::from(i), f64::from(i % 5)),
            })
            .collect();
        let data = Figure::new("").panel(Panel::new("x", "y").line("a", &line)).interactive(2000);
        let series = &data.panels[0].series[0];
        assert!(data.thinned && series.x.len() <= 2000 && series.x.is_sorted(), "{}", series.x.len());
        let spike = series.y.iter().position(|y| *y == Some(9.0)).unwrap();
        assert_eq!(series.x[spike], 73_211.0);
        assert_eq!(series.y.iter().filter(|y| y.is_none()).count(), 1);
        let short = Figure::new("").panel(Panel::new("x", "y").line("a", &line[..100])).interactive(2000);
        assert!(!short.thinned && short.panels[0].series[0].x.len() == 100);
    }

    #[test]
    fn stretches_of_one_name_are_one_series_and_the_colours_are_the_pictures() {
        let panel = Panel::new("x", "y")
            .line("turns", &[(0.0, 1.0), (1.0, 2.0)])
            .band("", &[(0.0, 0.5, 1.5)])
            .line("turns", &[(0.0, 3.0)])
            .marks("on", &[0.25]);
        let data = Figure::new("").panel(panel).interactive(100);
        let [turns, band, marks] = data.panels[0].series.as_slice() else { panic!("{data:?}") };
        assert_eq!((turns.x.as_slice(), turns.y[2]), ([0.0, 1.0, 1.0, 0.0].as_slice(), None));
        assert_eq!(turns.colour, super::super::draw::FIRST_COLOUR.to_lowercase());
        assert_eq!((band.colour.as_str(), band.high.as_deref()), (turns.colour.as_str(), Some([Some(1.5)].as_slice())));
        assert_eq!((marks.x.as_slice(), marks.y.as_slice()), ([0.25].as_slice(), [None].as_slice()));
    }

    #[test]
    fn numbers_are_short_and_true_to_a_millionth_of_the_range() {
        let points = [(0.0, 1.0 / 3.0), (10.0, 2000.0)];
        let text =
            serde_json::to_string(&Figure::new("").panel(Panel::new("x", "y").line("a", &points)).interactive(9));
        assert!(text.as_ref().is_ok_and(|text| text.contains("\"y\":[0.333,2000.0]")), "{text:?}");
    }
}
