//! The tables of a measurement folder: a header, then rows of numbers.

use super::lines::{Budget, Clock, Field, Lines};
use super::units::Units;
use super::{Beside, ControlRow, Direction, DriveResponse, Format, LevelEdge, MeasurementError, RunData, packed};
use std::io::BufRead;
use std::path::Path;

/// Reads the data of a run; `path` is their file's name in messages.
pub(super) fn read(
    reader: Box<dyn BufRead>,
    path: &Path,
    format: Format,
    units: &Units,
    budget: &mut Budget,
) -> Result<RunData, MeasurementError> {
    let mut lines = Lines::new(reader, path);
    match format {
        Format::Levels => levels(&mut lines, budget),
        Format::Edges => edges(&mut lines, budget),
        Format::Packed => packed::read(&mut lines, budget),
        Format::Velocity => velocity(&mut lines, budget),
        Format::Control => control(&mut lines, budget),
        Format::Drive => drive(&mut lines, units, budget),
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

/// Ten times what an ultracentrifuge reaches: beyond, a speed is another unit's or a damaged table's, and its square may be no number.
const FASTEST_RPM: f64 = 1e7;

fn velocity(lines: &mut Lines, budget: &mut Budget) -> Result<RunData, MeasurementError> {
    lines.header(&["time_us,rpm"])?;
    let mut clock = Clock::default();
    let (mut time_us, mut rpm) = (Vec::new(), Vec::new());
    while lines.advance()? {
        let [time, speed] = lines.fields::<2>()?;
        budget.push(&mut time_us, lines.time(time, &mut clock)?, lines)?;
        let speed = match lines.number(speed, "rpm")? {
            value if value.abs() <= FASTEST_RPM => value,
            value => return Err(lines.error(speed.column, format!("{value:e} rpm: no motor turns that fast"))),
        };
        budget.push(&mut rpm, speed, lines)?;
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

/// The headers of an ordinary motor, in words.
const DRIVE: &str = "`time_us,input,position_rad` or `time_us,input,speed_rpm` (or `time`, `position`, `speed` in the units of the folder; \
                     `current` where the input is one), then any of `load`, `reference`, `current`, `temperature`";

/// The columns of an ordinary motor's file: units in the names, or in `measurement.toml`.
struct DriveColumns {
    /// µs of one unit of the time.
    unit_us: f64,
    /// rpm or rad of one unit of what is measured.
    unit: f64,
    is_speed: bool,
    beside: Vec<Beside>,
}

impl DriveColumns {
    fn read(lines: &mut Lines, units: &Units) -> Result<Self, MeasurementError> {
        let names = lines.names(DRIVE)?;
        let [time, input, measured, more @ ..] = names.as_slice() else { return Err(lines.unexpected(DRIVE)) };
        let mut beside: Vec<Beside> = Vec::new();
        for name in more {
            match Beside::ALL.into_iter().find(|b| b.name() == name) {
                Some(one) if input == name || beside.contains(&one) => {
                    return Err(lines.error(1, format!("the column `{name}` is there twice")));
                }
                Some(one) => beside.push(one),
                None => return Err(lines.unexpected(DRIVE)),
            }
        }
        let unit = |of: Result<f64, String>| of.map_err(|what| lines.error(1, what));
        let (is_speed, unit_of_measured) = match measured.as_str() {
            "speed_rpm" => (true, 1.0),
            "position_rad" => (false, 1.0),
            "speed" => (true, unit(units.speed_rpm())?),
            "position" => (false, unit(units.position_rad())?),
            _ => return Err(lines.unexpected(DRIVE)),
        };
        let unit_us = match time.as_str() {
            "time_us" => 1.0,
            "time" => unit(units.time_us())?,
            _ => return Err(lines.unexpected(DRIVE)),
        };
        if !["input", "current"].contains(&input.as_str()) {
            return Err(lines.unexpected(DRIVE));
        }
        Ok(Self { unit_us, unit: unit_of_measured, is_speed, beside })
    }
}

fn drive(lines: &mut Lines, units: &Units, budget: &mut Budget) -> Result<RunData, MeasurementError> {
    let columns = DriveColumns::read(lines, units)?;
    let name = if columns.is_speed { "speed" } else { "position" };
    let mut clock = Clock::default();
    let (mut time_us, mut input, mut values) = (Vec::new(), Vec::new(), Vec::new());
    let mut beside: Vec<Vec<f64>> = vec![Vec::new(); columns.beside.len()];
    while lines.advance()? {
        let mut fields = [Field::default(); 3 + Beside::ALL.len()];
        let fields = &mut fields[..3 + beside.len()];
        lines.split(fields)?;
        budget.push(&mut time_us, lines.time_in(columns.unit_us, fields[0], &mut clock)?, lines)?;
        budget.push(&mut input, lines.number(fields[1], "input")?, lines)?;
        budget.push(&mut values, columns.unit * lines.number(fields[2], name)?, lines)?;
        for ((to, field), column) in beside.iter_mut().zip(&fields[3..]).zip(&columns.beside) {
            budget.push(to, lines.number(*field, column.name())?, lines)?;
        }
    }
    two_rows(lines, time_us.len())?;
    let response = if columns.is_speed { DriveResponse::SpeedRpm(values) } else { DriveResponse::PositionRad(values) };
    Ok(RunData::Drive { time_us, input, response, beside: columns.beside.into_iter().zip(beside).collect() })
}

fn two_rows(lines: &Lines, count: usize) -> Result<(), MeasurementError> {
    if count < 2 {
        return Err(lines.error(1, "a record needs at least two rows below its header"));
    }
    Ok(())
}
