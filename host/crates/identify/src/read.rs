//! Reading sweeps: impedance, admittance and waveform CSV, folders of one file a frequency, Touchstone one-ports.

mod touchstone;

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
    #[error("{}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        cause: std::io::Error,
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
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
        touchstone::read(path)?
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
    let bytes = twum_files::input::bytes(path, twum_files::input::MEASURED)
        .map_err(|cause| ReadError::Io { path: path.to_owned(), cause })?;
    let mut text = String::from_utf8(bytes).map_err(|_| file(path, "is not text; expected CSV or Touchstone"))?;
    if text.starts_with('\u{feff}') {
        text.remove(0);
    }
    Ok(text)
}

/// The rows of a CSV file, cut down to the columns asked for.
struct Table {
    /// Which of the layouts asked for it has.
    layout: usize,
    /// Line number and the layout's columns; unused ones are 0.
    rows: Vec<(usize, [f64; 4])>,
    comments: Vec<String>,
}

/// Reads the first of `layouts` (lists of column names) that the header holds; other columns are passed over.
fn table(path: &Path, layouts: &[&[&str]]) -> Result<Table, ReadError> {
    let text = text(path)?;
    let mut comments = Vec::new();
    let mut lines = text.lines().enumerate().map(|(i, l)| (i + 1, l.trim())).filter(|(_, l)| !l.is_empty());
    let (number, head) = loop {
        match lines.next() {
            None => return Err(file(path, "is empty")),
            Some((_, content)) if content.starts_with('#') => comments.push(content[1..].trim().to_owned()),
            Some(found) => break found,
        }
    };
    let names: Vec<String> = head.split([',', ';', '\t']).map(|c| c.trim().to_ascii_lowercase()).collect();
    let wanted = layouts.iter().map(|l| format!("`{}`", l.join(","))).collect::<Vec<_>>().join(", ");
    if names.iter().all(|c| c.parse::<f64>().is_ok()) {
        return Err(line(path, number, format!("the header line is missing; begin with one of {wanted}")));
    }
    let place =
        |layout: &[&str]| -> Option<Vec<usize>> { layout.iter().map(|n| names.iter().position(|h| h == n)).collect() };
    let Some((layout, columns)) = layouts.iter().enumerate().find_map(|(i, l)| place(l).map(|c| (i, c))) else {
        return Err(line(path, number, format!("columns `{}`; expected one of {wanted}", names.join(","))));
    };
    let body: Vec<(usize, &str)> = lines
        .filter(|(_, content)| {
            let comment = content.strip_prefix('#');
            comments.extend(comment.map(|c| c.trim().to_owned()));
            comment.is_none()
        })
        .collect();
    let parse = |&(number, content): &(usize, &str)| -> Result<(usize, [f64; 4]), ReadError> {
        let mut values = [0.0; 4];
        let mut found = 0;
        for (at, cell) in content.split([',', ';', '\t']).enumerate() {
            found = at + 1;
            for (value, column) in values.iter_mut().zip(&columns) {
                if *column == at {
                    *value = cell.trim().parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(|| {
                        let cell = cell.trim();
                        line(path, number, format!("column `{}`: `{cell}` is not a finite number", names[at]))
                    })?;
                }
            }
        }
        if found != names.len() {
            return Err(line(path, number, format!("{found} columns, the header has {}", names.len())));
        }
        Ok((number, values))
    };
    let rows = all_or_first_error(body.par_iter().map(parse))?;
    if rows.is_empty() {
        return Err(file(path, "has a header but no data"));
    }
    Ok(Table { layout, rows, comments })
}

fn positive(path: &Path, number: usize, frequency_hz: f64) -> Result<f64, ReadError> {
    if frequency_hz > 0.0 {
        Ok(frequency_hz)
    } else {
        Err(line(path, number, format!("column `frequency_hz`: {frequency_hz} is not a positive frequency")))
    }
}

fn csv(path: &Path, options: &ReadOptions) -> Result<Sweep, ReadError> {
    const LAYOUTS: [&[&str]; 3] =
        [&["frequency_hz", "z_re", "z_im"], &["frequency_hz", "g", "b"], &["frequency_hz", "time_s", "v1", "v2"]];
    let table = table(path, &LAYOUTS)?;
    if table.layout == 2 {
        let mut waveforms: Vec<(usize, Waveform)> = Vec::new();
        for (number, [f, t, v1, v2]) in table.rows {
            let f = positive(path, number, f)?;
            if waveforms.last().is_none_or(|w| w.1.frequency_hz != f) {
                waveforms.push((number, empty(f)));
            }
            let Some((_, w)) = waveforms.last_mut() else { continue };
            w.time_s.push(t);
            w.v1.push(v1);
            w.v2.push(v2);
        }
        return from_waveforms(path, waveforms.into_iter().map(|(n, w)| (path.to_owned(), n, w)).collect(), options);
    }
    let mut points = Vec::with_capacity(table.rows.len());
    for (number, [f, re, im, _]) in table.rows {
        let value = Complex::new(re, im);
        if value.norm() == 0.0 {
            return Err(line(path, number, "the value is exactly zero: is this row a placeholder?"));
        }
        points.push(Point {
            frequency_hz: positive(path, number, f)?,
            admittance_s: if table.layout == 0 { Complex::new(1.0, 0.0) / value } else { value },
            sigma_s: None,
        });
    }
    Ok(Sweep { source: path.display().to_string(), points, waveforms: Vec::new(), shunt_ohm: None })
}

fn empty(frequency_hz: f64) -> Waveform {
    Waveform { frequency_hz, time_s: Vec::new(), v1: Vec::new(), v2: Vec::new() }
}

/// A folder of `time_s,v1,v2` files, the frequency in a comment `# frequency_hz = …` or in the file's name.
fn folder(path: &Path, options: &ReadOptions) -> Result<Sweep, ReadError> {
    let io = |cause| ReadError::Io { path: path.to_owned(), cause };
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
        let table = table(&name, &[&["time_s", "v1", "v2"]])?;
        let stated = table.comments.iter().find_map(|c| {
            c.strip_prefix("frequency_hz").and_then(|rest| rest.trim_start_matches([' ', '=', ':']).parse().ok())
        });
        let f = stated.or_else(|| frequency_in_name(&name)).filter(|f: &f64| *f > 0.0 && f.is_finite()).ok_or_else(
            || file(&name, "no frequency: name the file by it (`44100.csv`) or add `# frequency_hz = 44100`"),
        )?;
        let mut w = empty(f);
        let first = table.rows[0].0;
        for (_, [t, v1, v2, _]) in table.rows {
            w.time_s.push(t);
            w.v1.push(v1);
            w.v2.push(v2);
        }
        waveforms.push((name, first, w));
    }
    from_waveforms(path, waveforms, options)
}

fn frequency_in_name(path: &Path) -> Option<f64> {
    let stem = path.file_stem()?.to_str()?;
    let digits: String =
        stem.chars().skip_while(|c| !c.is_ascii_digit()).take_while(|c| c.is_ascii_digit() || *c == '.').collect();
    digits.trim_end_matches('.').parse().ok()
}

/// What was read on every core, or of several errors the one that stands first in the file: rayon's own `collect` keeps
/// whichever came first in time.
fn all_or_first_error<T: Send>(
    read: impl IndexedParallelIterator<Item = Result<T, ReadError>>,
) -> Result<Vec<T>, ReadError> {
    read.collect::<Vec<_>>().into_iter().collect()
}

fn from_waveforms(
    path: &Path,
    waveforms: Vec<(PathBuf, usize, Waveform)>,
    options: &ReadOptions,
) -> Result<Sweep, ReadError> {
    let shunt = options.shunt_ohm.ok_or_else(|| {
        file(path, "holds waveforms: give the shunt resistance with --shunt OHM (the thesis's was 2000)")
    })?;
    let points = all_or_first_error(waveforms.par_iter().map(|(name, number, w)| {
        point(w, shunt, options.shunt)
            .map_err(|message| line(name, *number, format!("at {} Hz {message}", w.frequency_hz)))
    }))?;
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

#[cfg(test)]
mod tests;
