//! Text files read line by line, with bounds, and errors that name line and column.

use super::{
    ControlRow, Direction, DriveResponse, Format, LevelEdge, MAX_LOADED_BYTES, MAX_RECORD_S, MAX_TIME_US,
    MeasurementError, RunData,
};
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use twum_files::input;

/// Longest line accepted, in bytes.
const MAX_LINE: usize = 4096;

/// What the files of one folder may still bring into memory.
pub(super) struct Budget {
    bytes_left: usize,
}

impl Budget {
    pub(super) fn new() -> Self {
        Self { bytes_left: MAX_LOADED_BYTES }
    }

    fn charge(&mut self, bytes: usize, lines: &Lines) -> Result<(), MeasurementError> {
        self.bytes_left = self.bytes_left.checked_sub(bytes).ok_or_else(|| {
            lines.error(
                1,
                format!(
                    "the folder's data exceed {} MiB in memory: split it into several folders",
                    MAX_LOADED_BYTES >> 20
                ),
            )
        })?;
        Ok(())
    }

    /// Appends to `vec`, charging the element's size.
    pub(super) fn push<T>(&mut self, vec: &mut Vec<T>, value: T, lines: &Lines) -> Result<(), MeasurementError> {
        self.charge(size_of::<T>(), lines)?;
        vec.push(value);
        Ok(())
    }
}

/// The lines of a text file that hold something: comments (`#`) and blank lines are skipped.
pub(super) struct Lines {
    reader: Box<dyn BufRead>,
    path: PathBuf,
    buffer: Vec<u8>,
    /// Number of the current line, from 1.
    number: usize,
}

impl Lines {
    fn new(reader: Box<dyn BufRead>, path: &Path) -> Self {
        Self { reader, path: path.to_owned(), buffer: Vec::new(), number: 0 }
    }

    /// An error at a column of the current line.
    pub(super) fn error(&self, column: usize, message: impl Into<String>) -> MeasurementError {
        MeasurementError::at(&self.path, self.number.max(1), column, message)
    }

    /// Moves to the next line that holds something; `false` at the end of the file.
    pub(super) fn advance(&mut self) -> Result<bool, MeasurementError> {
        loop {
            self.buffer.clear();
            let read = (&mut self.reader)
                .take(MAX_LINE as u64 + 1)
                .read_until(b'\n', &mut self.buffer)
                .map_err(|source| MeasurementError::io(&self.path, source))?;
            if read == 0 {
                return Ok(false);
            }
            self.number += 1;
            if self.buffer.len() > MAX_LINE {
                return Err(
                    self.error(MAX_LINE + 1, format!("line longer than {MAX_LINE} bytes: not a table of numbers"))
                );
            }
            if self.number == 1 && self.buffer.starts_with(b"\xEF\xBB\xBF") {
                self.buffer.drain(..3);
            }
            let content = self.buffer.trim_ascii();
            if !content.is_empty() && content[0] != b'#' {
                return Ok(true);
            }
        }
    }

    /// The current line, without its end.
    pub(super) fn line(&self) -> &[u8] {
        self.buffer.trim_ascii_end()
    }

    /// Splits the current line at commas into exactly `N` fields with their columns.
    fn fields<const N: usize>(&self) -> Result<[Field<'_>; N], MeasurementError> {
        let mut fields = [Field { text: b"", column: 1 }; N];
        let mut count = 0;
        let mut start = 0;
        for raw in self.line().split(|byte| *byte == b',') {
            let text = raw.trim_ascii();
            let column = start + 1 + (raw.len() - raw.trim_ascii_start().len());
            let Some(field) = fields.get_mut(count) else {
                return Err(self.error(column, format!("more than the {N} columns of the header")));
            };
            *field = Field { text, column };
            count += 1;
            start += raw.len() + 1;
        }
        if count < N {
            let column = self.line().len() + 1;
            return Err(self.error(
                column,
                format!("{count} of {N} columns: the line is cut off or the separator is not a comma"),
            ));
        }
        Ok(fields)
    }

    /// Reads the header and says which of the accepted ones it is.
    fn header(&mut self, accepted: &[&str]) -> Result<usize, MeasurementError> {
        let expected = accepted.join("` or `");
        if !self.advance()? {
            return Err(self.error(1, format!("the file is empty: expected the header `{expected}`")));
        }
        let found: Vec<&[u8]> = self.line().split(|byte| *byte == b',').map(<[u8]>::trim_ascii).collect();
        accepted.iter().position(|header| header.split(',').map(str::as_bytes).eq(found.iter().copied())).ok_or_else(
            || {
                let line = self.line();
                let shown = line[..line.len().min(60)].escape_ascii();
                self.error(1, format!("expected the header `{expected}`, found `{shown}`"))
            },
        )
    }

    fn number(&self, field: Field<'_>, name: &str) -> Result<f64, MeasurementError> {
        let value = std::str::from_utf8(field.text).ok().and_then(|text| text.parse::<f64>().ok());
        match value {
            Some(value) if value.is_finite() => Ok(value),
            Some(_) => {
                Err(self
                    .error(field.column, format!("{name} is not finite: leave the row out where there is no value")))
            }
            None => Err(self.error(field.column, format!("{name} `{}` is not a number", field.shown()))),
        }
    }

    fn bit(&self, field: Field<'_>) -> Result<bool, MeasurementError> {
        match field.text {
            b"0" => Ok(false),
            b"1" => Ok(true),
            _ => match self.number(field, "level")? {
                0.0 => Ok(false),
                1.0 => Ok(true),
                _ => Err(self.error(field.column, format!("level `{}` is neither 0 nor 1", field.shown()))),
            },
        }
    }

    /// A time that lies after the one before it and within the longest record.
    fn time(&self, field: Field<'_>, clock: &mut Clock) -> Result<f64, MeasurementError> {
        let time_us = self.number(field, "time_us")?;
        if time_us.abs() > MAX_TIME_US {
            return Err(self.error(field.column, format!("time_us {time_us} is out of range")));
        }
        if let Some(last_us) = clock.last_us
            && time_us <= last_us
        {
            return Err(self.error(field.column, format!("time_us {time_us} does not come after {last_us}")));
        }
        let first_us = *clock.first_us.get_or_insert(time_us);
        if time_us - first_us > MAX_RECORD_S * 1e6 {
            return Err(self.error(
                field.column,
                format!("time_us {time_us} lies more than 24 hours after the first row: is the unit µs? Otherwise split the run"),
            ));
        }
        clock.last_us = Some(time_us);
        Ok(time_us)
    }
}

#[derive(Clone, Copy)]
struct Field<'a> {
    text: &'a [u8],
    column: usize,
}

impl Field<'_> {
    fn shown(&self) -> String {
        self.text[..self.text.len().min(40)].escape_ascii().to_string()
    }
}

#[derive(Default)]
struct Clock {
    first_us: Option<f64>,
    last_us: Option<f64>,
}

/// Opens a regular file.
pub(super) fn open(path: &Path) -> Result<Box<dyn BufRead>, MeasurementError> {
    let file = input::open(path).map_err(|source| MeasurementError::io(path, source))?;
    Ok(Box::new(BufReader::with_capacity(1 << 16, file)))
}

/// Reads the data of a run; `path` is their file's name in messages.
pub(super) fn read(
    reader: Box<dyn BufRead>,
    path: &Path,
    format: Format,
    budget: &mut Budget,
) -> Result<RunData, MeasurementError> {
    let mut lines = Lines::new(reader, path);
    match format {
        Format::Levels => levels(&mut lines, budget),
        Format::Edges => edges(&mut lines, budget),
        Format::Packed => super::packed::read(&mut lines, budget),
        Format::Velocity => velocity(&mut lines, budget),
        Format::Control => control(&mut lines, budget),
        Format::Drive => drive(&mut lines, budget),
    }
}

fn levels(lines: &mut Lines, budget: &mut Budget) -> Result<RunData, MeasurementError> {
    lines.header(&["time_us,level"])?;
    let mut clock = Clock::default();
    // The grid's period is known only at the end, so the line each sample stood on is kept for the message.
    let mut times: Vec<(f64, u32)> = Vec::new();
    let mut levels = Vec::new();
    while lines.advance()? {
        let [time, level] = lines.fields::<2>()?;
        let time_us = lines.time(time, &mut clock)?;
        let number = u32::try_from(lines.number).unwrap_or(u32::MAX);
        budget.push(&mut times, (time_us, number), lines)?;
        budget.push(&mut levels, lines.bit(level)?, lines)?;
    }
    let (Some((start_us, _)), Some((end_us, _)), true) = (times.first(), times.last(), times.len() > 1) else {
        return Err(lines.error(1, "a record of levels needs at least two rows"));
    };
    let period_us = (end_us - start_us) / (times.len() - 1) as f64;
    // Times may have been rounded to whole µs.
    let tolerance_us = (0.01 * period_us).max(1.0).min(0.4 * period_us);
    for (index, (time_us, number)) in times.iter().enumerate() {
        let expected_us = start_us + index as f64 * period_us;
        if (time_us - expected_us).abs() > tolerance_us {
            return Err(MeasurementError::at(
                &lines.path,
                *number as usize,
                1,
                format!(
                    "time_us {time_us} is not on a regular grid (period {period_us:.3} µs, expected {expected_us:.1}): \
                     split the run where samples are missing, or write it as `edges`"
                ),
            ));
        }
    }
    Ok(RunData::Levels { start_us: *start_us, period_us, levels })
}

fn edges(lines: &mut Lines, budget: &mut Budget) -> Result<RunData, MeasurementError> {
    lines.header(&["time_us,level"])?;
    let mut clock = Clock::default();
    let mut first: Option<LevelEdge> = None;
    let mut closing: Option<LevelEdge> = None;
    let mut edges: Vec<LevelEdge> = Vec::new();
    while lines.advance()? {
        let [time, level] = lines.fields::<2>()?;
        let row = LevelEdge { time_us: lines.time(time, &mut clock)?, level: lines.bit(level)? };
        if closing.is_some() {
            return Err(lines.error(
                1,
                "the row before repeats the level, which only the last row may do: an edge is missing there",
            ));
        }
        match edges.last().copied().or(first) {
            None => first = Some(row),
            Some(previous) if previous.level != row.level => budget.push(&mut edges, row, lines)?,
            Some(_) => closing = Some(row),
        }
    }
    let (Some(first), Some(end_us)) = (first, closing.or(edges.last().copied()).map(|row| row.time_us)) else {
        return Err(lines.error(1, "a record of edges needs a first and a last row"));
    };
    Ok(RunData::Edges { initial: first.level, start_us: first.time_us, edges, end_us })
}

fn velocity(lines: &mut Lines, budget: &mut Budget) -> Result<RunData, MeasurementError> {
    lines.header(&["time_us,rpm"])?;
    let mut clock = Clock::default();
    let (mut time_us, mut rpm) = (Vec::new(), Vec::new());
    while lines.advance()? {
        let [time, speed] = lines.fields::<2>()?;
        budget.push(&mut time_us, lines.time(time, &mut clock)?, lines)?;
        budget.push(&mut rpm, lines.number(speed, "rpm")?, lines)?;
    }
    two_rows(lines, time_us.len())?;
    Ok(RunData::Velocity { time_us, rpm })
}

fn control(lines: &mut Lines, budget: &mut Budget) -> Result<RunData, MeasurementError> {
    lines.header(&["time_us,target,position,u,duty,direction"])?;
    let mut clock = Clock::default();
    let mut rows = Vec::new();
    while lines.advance()? {
        let [time, target, position, u, duty, direction] = lines.fields::<6>()?;
        let row = ControlRow {
            time_us: lines.time(time, &mut clock)?,
            target: lines.number(target, "target")?,
            position: lines.number(position, "position")?,
            u: lines.number(u, "u")?,
            duty: match lines.number(duty, "duty")? {
                value if (0.0..=1.0).contains(&value) => value,
                value => {
                    return Err(lines.error(duty.column, format!("duty {value} is not a fraction of drive on, 0..1")));
                }
            },
            direction: match lines.number(direction, "direction")? {
                1.0 => Direction::Cw,
                -1.0 => Direction::Ccw,
                value => {
                    return Err(
                        lines.error(direction.column, format!("direction {value} is neither 1 (cw) nor -1 (ccw)"))
                    );
                }
            },
        };
        budget.push(&mut rows, row, lines)?;
    }
    two_rows(lines, rows.len())?;
    Ok(RunData::Control(rows))
}

fn drive(lines: &mut Lines, budget: &mut Budget) -> Result<RunData, MeasurementError> {
    let is_speed = lines.header(&["time_us,input,position_rad", "time_us,input,speed_rpm"])? == 1;
    let name = if is_speed { "speed_rpm" } else { "position_rad" };
    let mut clock = Clock::default();
    let (mut time_us, mut input, mut values) = (Vec::new(), Vec::new(), Vec::new());
    while lines.advance()? {
        let [time, known, measured] = lines.fields::<3>()?;
        budget.push(&mut time_us, lines.time(time, &mut clock)?, lines)?;
        budget.push(&mut input, lines.number(known, "input")?, lines)?;
        budget.push(&mut values, lines.number(measured, name)?, lines)?;
    }
    two_rows(lines, time_us.len())?;
    let response = if is_speed { DriveResponse::SpeedRpm(values) } else { DriveResponse::PositionRad(values) };
    Ok(RunData::Drive { time_us, input, response })
}

fn two_rows(lines: &Lines, count: usize) -> Result<(), MeasurementError> {
    if count < 2 {
        return Err(lines.error(1, "a record needs at least two rows below its header"));
    }
    Ok(())
}
