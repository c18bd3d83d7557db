//! The tables of a measurement folder: a header, then rows of numbers.

use super::lines::{Budget, Clock, Lines};
use super::units::Units;
use super::{ControlRow, Direction, DriveResponse, Format, LevelEdge, MeasurementError, RunData, packed};
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

/// The headers of an ordinary motor: units in the names, or in `measurement.toml`.
const DRIVE: [&str; 8] = [
    "time_us,input,position_rad",
    "time_us,input,speed_rpm",
    "time,input,position_rad",
    "time,input,speed_rpm",
    "time_us,input,position",
    "time_us,input,speed",
    "time,input,position",
    "time,input,speed",
];

fn drive(lines: &mut Lines, units: &Units, budget: &mut Budget) -> Result<RunData, MeasurementError> {
    let header = DRIVE[lines.header(&DRIVE)?];
    let unit = |named: bool, of: Result<f64, String>| match named {
        true => Ok(1.0),
        false => of.map_err(|what| lines.error(1, what)),
    };
    let is_speed = header.contains("speed");
    let unit_us = unit(header.starts_with("time_us"), units.time_us())?;
    let by = match is_speed {
        true => unit(header.ends_with("_rpm"), units.speed_rpm())?,
        false => unit(header.ends_with("_rad"), units.position_rad())?,
    };
    let name = if is_speed { "speed" } else { "position" };
    let mut clock = Clock::default();
    let (mut time_us, mut input, mut values) = (Vec::new(), Vec::new(), Vec::new());
    while lines.advance()? {
        let [time, known, measured] = lines.fields::<3>()?;
        budget.push(&mut time_us, lines.time_in(unit_us, time, &mut clock)?, lines)?;
        budget.push(&mut input, lines.number(known, "input")?, lines)?;
        budget.push(&mut values, by * lines.number(measured, name)?, lines)?;
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
