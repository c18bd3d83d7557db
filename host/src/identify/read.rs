//! Reading sweeps: impedance, admittance and waveform CSV, folders of one file a frequency, Touchstone one-ports.

use super::sine;
use super::sweep::{Point, Sweep, Waveform};
use nalgebra::Complex;
use rayon::prelude::*;
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

/// Fewest points a circuit is fitted to.
pub const FEWEST_POINTS: usize = 20;

/// Why a sweep could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file system said no.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// A line or cell is wrong.
    #[error("{}, line {line}: {message}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong and what to do.
        message: String,
    },
    /// The file as a whole is wrong.
    #[error("{}: {message}", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong and what to do.
        message: String,
    },
}

/// Where the shunt sits, seen from the generator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum Shunt {
    /// Generator, shunt, stator, ground (the thesis): v1 before the shunt, v2 across the stator.
    #[default]
    High,
    /// Generator, stator, shunt, ground: v1 across both, v2 across the shunt.
    Low,
}

/// What the files do not say themselves.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ReadOptions {
    /// Shunt resistance (Ω); needed for waveforms.
    pub shunt_ohm: Option<f64>,
    /// Where the shunt sits.
    pub shunt: Shunt,
    /// Known capacitance of cables and probe across the stator, taken off (F).
    pub stray_f: f64,
}

/// Reads a sweep from a CSV file, a Touchstone `.s1p` file, or a folder with one waveform file a frequency.
///
/// # Errors
/// When a file cannot be read, a cell is not a finite number, a frequency is not positive, or there are too few points.
pub fn read(path: &Path, options: &ReadOptions) -> Result<Sweep, ReadError> {
    if let Some(shunt) = options.shunt_ohm
        && !(shunt.is_finite() && shunt > 0.0)
    {
        return Err(file(path, format!("the shunt resistance must be positive, got {shunt} ohm")));
    }
    let mut sweep = if path.is_dir() {
        folder(path, options)?
    } else if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("s1p")) {
        touchstone(path)?
    } else {
        csv(path, options)?
    };
    sweep.points.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    sweep.waveforms.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    for point in &mut sweep.points {
        point.admittance_s.im -= TAU * point.frequency_hz * options.stray_f;
    }
    let mut distinct: Vec<f64> = sweep.frequencies();
    distinct.dedup();
    if distinct.len() < FEWEST_POINTS {
        return Err(file(
            path,
            format!("{} distinct frequencies; a circuit needs at least {FEWEST_POINTS}", distinct.len()),
        ));
    }
    Ok(sweep)
}

fn file(path: &Path, message: impl Into<String>) -> ReadError {
    ReadError::File { path: path.to_owned(), message: message.into() }
}

fn line(path: &Path, line: usize, message: impl Into<String>) -> ReadError {
    ReadError::Line { path: path.to_owned(), line, message: message.into() }
}

fn text(path: &Path) -> Result<String, ReadError> {
    let bytes = std::fs::read(path).map_err(|source| ReadError::Io { path: path.to_owned(), source })?;
    String::from_utf8(bytes)
        .map(|t| t.trim_start_matches('\u{feff}').to_owned())
        .map_err(|_| file(path, "is not text; expected CSV or Touchstone"))
}

/// A numeric table: header names, and rows with their line numbers.
struct Table {
    header: Vec<String>,
    rows: Vec<(usize, Vec<f64>)>,
    comments: Vec<String>,
}

fn table(path: &Path) -> Result<Table, ReadError> {
    let text = text(path)?;
    let mut header: Option<Vec<String>> = None;
    let mut rows = Vec::new();
    let mut comments = Vec::new();
    for (index, raw) in text.lines().enumerate() {
        let number = index + 1;
        let content = raw.trim();
        if content.is_empty() {
            continue;
        }
        if let Some(comment) = content.strip_prefix('#') {
            comments.push(comment.trim().to_owned());
            continue;
        }
        let cells: Vec<&str> = content.split([',', ';', '\t']).map(str::trim).collect();
        let Some(names) = &header else {
            if cells.iter().all(|c| c.parse::<f64>().is_ok()) {
                return Err(line(
                    path,
                    number,
                    "the header line is missing; begin with `frequency_hz,z_re,z_im`, `frequency_hz,g,b` or \
                     `frequency_hz,time_s,v1,v2`",
                ));
            }
            header = Some(cells.iter().map(|c| c.to_ascii_lowercase()).collect());
            continue;
        };
        if cells.len() != names.len() {
            return Err(line(path, number, format!("{} columns, the header has {}", cells.len(), names.len())));
        }
        let mut row = Vec::with_capacity(cells.len());
        for (cell, name) in cells.iter().zip(names) {
            match cell.parse::<f64>() {
                Ok(value) if value.is_finite() => row.push(value),
                _ => return Err(line(path, number, format!("column `{name}`: `{cell}` is not a finite number"))),
            }
        }
        rows.push((number, row));
    }
    let header = header.ok_or_else(|| file(path, "is empty"))?;
    if rows.is_empty() {
        return Err(file(path, "has a header but no data"));
    }
    Ok(Table { header, rows, comments })
}

impl Table {
    fn columns(&self, names: &[&str]) -> Option<Vec<usize>> {
        names.iter().map(|n| self.header.iter().position(|h| h == n)).collect()
    }
}

fn positive(path: &Path, number: usize, frequency_hz: f64) -> Result<f64, ReadError> {
    if frequency_hz > 0.0 {
        Ok(frequency_hz)
    } else {
        Err(line(path, number, format!("column `frequency_hz`: {frequency_hz} is not a positive frequency")))
    }
}

fn csv(path: &Path, options: &ReadOptions) -> Result<Sweep, ReadError> {
    let table = table(path)?;
    let mut points = Vec::with_capacity(table.rows.len());
    if let Some(columns) = table.columns(&["frequency_hz", "z_re", "z_im"]) {
        for (number, row) in &table.rows {
            let z = Complex::new(row[columns[1]], row[columns[2]]);
            if z.norm() == 0.0 {
                return Err(line(path, *number, "the impedance is zero: its admittance would be infinite"));
            }
            points.push(Point {
                frequency_hz: positive(path, *number, row[columns[0]])?,
                admittance_s: Complex::new(1.0, 0.0) / z,
                sigma_s: None,
            });
        }
    } else if let Some(columns) = table.columns(&["frequency_hz", "g", "b"]) {
        for (number, row) in &table.rows {
            let y = Complex::new(row[columns[1]], row[columns[2]]);
            if y.norm() == 0.0 {
                return Err(line(path, *number, "the admittance is exactly zero: is this row a placeholder?"));
            }
            points.push(Point {
                frequency_hz: positive(path, *number, row[columns[0]])?,
                admittance_s: y,
                sigma_s: None,
            });
        }
    } else if let Some(columns) = table.columns(&["frequency_hz", "time_s", "v1", "v2"]) {
        let mut waveforms: Vec<(usize, Waveform)> = Vec::new();
        for (number, row) in &table.rows {
            let f = positive(path, *number, row[columns[0]])?;
            if waveforms.last().is_none_or(|w| w.1.frequency_hz != f) {
                waveforms.push((*number, empty(f)));
            }
            let Some((_, w)) = waveforms.last_mut() else { continue };
            w.time_s.push(row[columns[1]]);
            w.v1.push(row[columns[2]]);
            w.v2.push(row[columns[3]]);
        }
        return from_waveforms(path, waveforms.into_iter().map(|(n, w)| (path.to_owned(), n, w)).collect(), options);
    } else {
        return Err(line(
            path,
            1,
            format!(
                "columns `{}`; expected `frequency_hz,z_re,z_im`, `frequency_hz,g,b` or `frequency_hz,time_s,v1,v2`",
                table.header.join(",")
            ),
        ));
    }
    Ok(Sweep { source: path.display().to_string(), points, waveforms: Vec::new(), shunt_ohm: None })
}

fn empty(frequency_hz: f64) -> Waveform {
    Waveform { frequency_hz, time_s: Vec::new(), v1: Vec::new(), v2: Vec::new() }
}

/// A folder of `time_s,v1,v2` files, the frequency in a comment `# frequency_hz = …` or in the file's name.
fn folder(path: &Path, options: &ReadOptions) -> Result<Sweep, ReadError> {
    let io = |source| ReadError::Io { path: path.to_owned(), source };
    let mut files: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(path).map_err(io)? {
        let file = entry.map_err(io)?.path();
        if file.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv")) {
            files.push(file);
        }
    }
    files.sort();
    if files.is_empty() {
        return Err(file(path, "holds no .csv file"));
    }
    let mut waveforms = Vec::new();
    for name in files {
        let table = table(&name)?;
        let columns = table
            .columns(&["time_s", "v1", "v2"])
            .ok_or_else(|| line(&name, 1, format!("columns `{}`; expected `time_s,v1,v2`", table.header.join(","))))?;
        let stated = match table.columns(&["frequency_hz"]) {
            Some(column) => Some(table.rows[0].1[column[0]]),
            None => table.comments.iter().find_map(|c| {
                c.strip_prefix("frequency_hz").and_then(|r| r.trim_start_matches([' ', '=', ':']).parse().ok())
            }),
        };
        let f = stated.or_else(|| frequency_in_name(&name)).filter(|f: &f64| *f > 0.0 && f.is_finite()).ok_or_else(
            || file(&name, "no frequency: name the file by it (`44100.csv`) or add `# frequency_hz = 44100`"),
        )?;
        let mut w = empty(f);
        for (_, row) in &table.rows {
            w.time_s.push(row[columns[0]]);
            w.v1.push(row[columns[1]]);
            w.v2.push(row[columns[2]]);
        }
        waveforms.push((name, table.rows[0].0, w));
    }
    from_waveforms(path, waveforms, options)
}

fn frequency_in_name(path: &Path) -> Option<f64> {
    let stem = path.file_stem()?.to_str()?;
    let digits: String =
        stem.chars().skip_while(|c| !c.is_ascii_digit()).take_while(|c| c.is_ascii_digit() || *c == '.').collect();
    digits.trim_end_matches('.').parse().ok()
}

fn from_waveforms(
    path: &Path,
    waveforms: Vec<(PathBuf, usize, Waveform)>,
    options: &ReadOptions,
) -> Result<Sweep, ReadError> {
    let shunt = options.shunt_ohm.ok_or_else(|| {
        file(path, "holds waveforms: give the shunt resistance with --shunt OHM (the thesis's was 2000)")
    })?;
    let points = waveforms
        .par_iter()
        .map(|(name, number, w)| {
            point(w, shunt, options.shunt)
                .map_err(|message| line(name, *number, format!("at {} Hz {message}", w.frequency_hz)))
        })
        .collect::<Result<Vec<Point>, _>>()?;
    Ok(Sweep {
        source: path.display().to_string(),
        points,
        waveforms: waveforms.into_iter().map(|w| w.2).collect(),
        shunt_ohm: Some(shunt),
    })
}

/// The admittance of one pair of waveforms, with the noise its sine fits show: Y = (V1 − V2)/(R·V2) for a shunt on the
/// generator's side, V2/(R·(V1 − V2)) for one at ground.
///
/// # Errors
/// A sentence's end when the samples determine no sine or a channel is dead.
pub fn point(w: &Waveform, shunt_ohm: f64, shunt: Shunt) -> Result<Point, String> {
    let basis = sine::Basis::new(w.frequency_hz, &w.time_s);
    let fit = |name: &str, volt: &[f64]| {
        let grid = sine::Grid::of(volt);
        basis.as_ref().and_then(|b| grid.map_or_else(|| b.fit(volt), |g| b.fit_rounded(volt, g))).ok_or_else(|| {
            format!(
                "channel `{name}`: {} samples over {:.3} periods determine no sine; record at least half a period",
                volt.len(),
                match (w.time_s.first(), w.time_s.last()) {
                    (Some(a), Some(b)) => (b - a) * w.frequency_hz,
                    _ => 0.0,
                }
            )
        })
    };
    let (one, two) = (fit("v1", &w.v1)?, fit("v2", &w.v2)?);
    for (name, sine) in [("v1", &one), ("v2", &two)] {
        if sine.phasor.norm() < 3.0 * sine.variance.sqrt() || sine.phasor.norm() == 0.0 {
            return Err(format!(
                "channel `{name}` shows no sine above its noise: check the generator's output, the probe and the frequency"
            ));
        }
    }
    let (v1, v2) = (one.phasor, two.phasor);
    let (y, by_v1, by_v2) = match shunt {
        Shunt::High => ((v1 / v2 - 1.0) / shunt_ohm, 1.0 / v2.norm_sqr(), v1.norm_sqr() / v2.norm_sqr().powi(2)),
        Shunt::Low => {
            let across = v1 - v2;
            if across.norm() == 0.0 {
                return Err("v1 and v2 are equal: no voltage across the stator".to_owned());
            }
            let fourth = across.norm_sqr().powi(2);
            (v2 / across / shunt_ohm, v2.norm_sqr() / fourth, v1.norm_sqr() / fourth)
        }
    };
    let sigma = (by_v1 * one.variance + by_v2 * two.variance).sqrt() / shunt_ohm;
    Ok(Point { frequency_hz: w.frequency_hz, admittance_s: y, sigma_s: Some(sigma) })
}

fn touchstone(path: &Path) -> Result<Sweep, ReadError> {
    let text = text(path)?;
    let (mut unit, mut kind, mut form, mut reference, mut options_seen, mut version_two) =
        (1e9, 'S', "MA".to_owned(), 50.0, false, false);
    let mut points = Vec::new();
    for (index, raw) in text.lines().enumerate() {
        let number = index + 1;
        let content = raw.split('!').next().unwrap_or_default().trim();
        if content.is_empty() {
            continue;
        }
        if content.starts_with('[') {
            let keyword = content.to_ascii_lowercase();
            version_two |= keyword.starts_with("[version]");
            if keyword.starts_with("[number of ports]") && !keyword.ends_with(" 1") {
                return Err(line(path, number, "a stator is a one-port: [Number of Ports] must be 1"));
            }
            if keyword.starts_with("[end]") {
                break;
            }
            continue;
        }
        if let Some(option) = content.strip_prefix('#') {
            if options_seen {
                continue;
            }
            options_seen = true;
            let mut words = option.split_whitespace();
            while let Some(word) = words.next() {
                match word.to_ascii_uppercase().as_str() {
                    "HZ" => unit = 1.0,
                    "KHZ" => unit = 1e3,
                    "MHZ" => unit = 1e6,
                    "GHZ" => unit = 1e9,
                    w @ ("S" | "Y" | "Z") => kind = w.chars().next().unwrap_or('S'),
                    w @ ("RI" | "MA" | "DB") => form = w.to_owned(),
                    "R" => {
                        reference =
                            words.next().and_then(|r| r.parse::<f64>().ok()).filter(|r| *r > 0.0).ok_or_else(|| {
                                line(path, number, "`R` needs a positive reference resistance in ohm")
                            })?;
                    }
                    other => return Err(line(path, number, format!("unknown Touchstone option `{other}`"))),
                }
            }
            continue;
        }
        let cells: Vec<f64> = content
            .split_whitespace()
            .map(|c| {
                c.parse::<f64>()
                    .ok()
                    .filter(|v| v.is_finite())
                    .ok_or_else(|| line(path, number, format!("`{c}` is not a finite number")))
            })
            .collect::<Result<_, _>>()?;
        let [f, a, b] = cells[..] else {
            return Err(line(path, number, format!("{} numbers; a one-port has three a line", cells.len())));
        };
        let value = match form.as_str() {
            "RI" => Complex::new(a, b),
            "DB" => Complex::from_polar(10f64.powf(a / 20.0), b.to_radians()),
            _ => Complex::from_polar(a, b.to_radians()),
        };
        // Version 1 files give Y and Z relative to the reference resistance.
        let normal = if version_two { 1.0 } else { reference };
        let y = match kind {
            'S' => (Complex::new(1.0, 0.0) - value) / (value + 1.0) / reference,
            'Y' => value / normal,
            _ => Complex::new(1.0, 0.0) / (value * normal),
        };
        if !(y.re.is_finite() && y.im.is_finite()) || y.norm() == 0.0 {
            return Err(line(path, number, "the admittance here is zero or infinite: an open or a short was measured"));
        }
        points.push(Point { frequency_hz: positive(path, number, f * unit)?, admittance_s: y, sigma_s: None });
    }
    if points.is_empty() {
        return Err(file(path, "holds no data"));
    }
    Ok(Sweep { source: path.display().to_string(), points, waveforms: Vec::new(), shunt_ohm: None })
}
