//! Text files read line by line, with bounds, and errors that name line and column.

use super::{MAX_LOADED_BYTES, MAX_RECORD_S, MAX_TIME_US, MeasurementError};
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
    pub(super) path: PathBuf,
    buffer: Vec<u8>,
    /// Number of the current line, from 1.
    pub(super) number: usize,
}

impl Lines {
    pub(super) fn new(reader: Box<dyn BufRead>, path: &Path) -> Self {
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
    pub(super) fn fields<const N: usize>(&self) -> Result<[Field<'_>; N], MeasurementError> {
        let mut fields = [Field::default(); N];
        self.split(&mut fields)?;
        Ok(fields)
    }

    /// Splits the current line at commas into exactly as many fields as there are.
    pub(super) fn split<'a>(&'a self, fields: &mut [Field<'a>]) -> Result<(), MeasurementError> {
        let of = fields.len();
        let mut count = 0;
        let mut start = 0;
        for raw in self.line().split(|byte| *byte == b',') {
            let text = raw.trim_ascii();
            let column = start + 1 + (raw.len() - raw.trim_ascii_start().len());
            let Some(field) = fields.get_mut(count) else {
                return Err(self.error(column, format!("more than the {of} columns of the header")));
            };
            *field = Field { text, column };
            count += 1;
            start += raw.len() + 1;
        }
        if count < of {
            let column = self.line().len() + 1;
            return Err(self.error(
                column,
                format!("{count} of {of} columns: the line is cut off or the separator is not a comma"),
            ));
        }
        Ok(())
    }

    /// Reads the header and says which of the accepted ones it is.
    pub(super) fn header(&mut self, accepted: &[&str]) -> Result<usize, MeasurementError> {
        let expected = format!("`{}`", accepted.join("` or `"));
        let found = self.names(&expected)?;
        let is = |header: &&str| header.split(',').eq(found.iter().map(String::as_str));
        accepted.iter().position(is).ok_or_else(|| self.unexpected(&expected))
    }

    /// Reads the names of a header; `expected` says in a message what they should be.
    pub(super) fn names(&mut self, expected: &str) -> Result<Vec<String>, MeasurementError> {
        if !self.advance()? {
            return Err(self.error(1, format!("the file is empty: expected the header {expected}")));
        }
        let name = |raw: &[u8]| String::from_utf8_lossy(raw.trim_ascii()).into_owned();
        Ok(self.line().split(|byte| *byte == b',').map(name).collect())
    }

    /// The current line is not the header that it should be.
    pub(super) fn unexpected(&self, expected: &str) -> MeasurementError {
        let line = self.line();
        let shown = line[..line.len().min(60)].escape_ascii();
        self.error(1, format!("expected the header {expected}, found `{shown}`"))
    }

    pub(super) fn number(&self, field: Field<'_>, name: &str) -> Result<f64, MeasurementError> {
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

    pub(super) fn bit(&self, field: Field<'_>) -> Result<bool, MeasurementError> {
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
    pub(super) fn time(&self, field: Field<'_>, clock: &mut Clock) -> Result<f64, MeasurementError> {
        self.time_in(1.0, field, clock)
    }

    /// The same of a column whose unit is so many µs.
    pub(super) fn time_in(&self, unit_us: f64, field: Field<'_>, clock: &mut Clock) -> Result<f64, MeasurementError> {
        let time_us = unit_us * self.number(field, "time_us")?;
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

#[derive(Clone, Copy, Default)]
pub(super) struct Field<'a> {
    text: &'a [u8],
    pub(super) column: usize,
}

impl Field<'_> {
    pub(super) fn shown(&self) -> String {
        self.text[..self.text.len().min(40)].escape_ascii().to_string()
    }
}

/// The times of a record so far.
#[derive(Default)]
pub(super) struct Clock {
    first_us: Option<f64>,
    last_us: Option<f64>,
}

/// Opens a regular file.
pub(super) fn open(path: &Path) -> Result<Box<dyn BufRead>, MeasurementError> {
    let file = input::open(path).map_err(|source| MeasurementError::io(path, source))?;
    Ok(Box::new(BufReader::with_capacity(1 << 16, file)))
}
