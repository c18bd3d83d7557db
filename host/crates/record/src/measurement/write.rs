//! Writing a measurement folder; nothing is ever overwritten.

use super::manifest::{self, Entry, Manifest};
use super::{ControlSpec, Direction, DriveResponse, MANIFEST, Measurement, MeasurementError, Run, RunData};
use std::collections::HashSet;
use std::io::{self, Write};
use std::path::Path;
use toml::Spanned;
use twum_files::input;
use twum_files::output::{NewFolder, Output, OutputError};

pub(super) fn save(measurement: &Measurement, folder: &Path) -> Result<Measurement, MeasurementError> {
    let mut new = NewFolder::begin(folder)?;
    let mut taken: HashSet<String> = HashSet::from([MANIFEST.to_owned()]);
    let mut motor_name = measurement.motor.clone();
    if let Some(text) = measurement.motor_text() {
        "motor.toml".clone_into(&mut motor_name);
        put(&mut new, &motor_name, |out| out.write_all(text.as_bytes()))?;
        taken.insert(motor_name.clone());
    } else if measurement.motor_file().is_some() && !measurement.folder.is_dir() {
        let what = format!("the motor file `{}` is not at hand: give --motor NAME|FILE", measurement.motor);
        return Err(MeasurementError::whole(folder, what));
    } else if let Some(source) = measurement.motor_file() {
        manifest::inside(&measurement.folder, &measurement.motor)
            .map_err(|what| MeasurementError::whole(&source, format!("motor: {what}")))?;
        let motor = input::bytes(&source, input::WRITTEN).map_err(|reason| MeasurementError::io(&source, reason))?;
        put(&mut new, &measurement.motor, |out| out.write_all(&motor))?;
        taken.insert(measurement.motor.to_lowercase());
    }
    let mut entries = Vec::with_capacity(measurement.runs.len());
    for run in &measurement.runs {
        let file = file_name(&run.id, &mut taken);
        put(&mut new, &file, |out| write_data(out, &run.data))?;
        entries.push(entry(run, file));
    }
    let manifest = Manifest {
        name: measurement.name.clone(),
        motor: spanned(motor_name),
        edges_per_rev: Some(spanned(measurement.edges_per_rev)),
        // What was read is in the units of the columns' names.
        time_unit: None,
        input_unit: None,
        position_unit: None,
        speed_unit: None,
        counts_per_turn: None,
        mm_per_turn: None,
        run: entries,
    };
    let text = toml::to_string(&manifest)
        .map_err(|error| MeasurementError::whole(&folder.join(MANIFEST), error.to_string()))?;
    // Last: a folder without it is none.
    put(&mut new, MANIFEST, |out| out.write_all(text.as_bytes()))?;
    // Reading back costs little and proves that what was written keeps every rule of the format.
    let mut saved = Measurement::load(new.path())?;
    new.finish()?;
    folder.clone_into(&mut saved.folder);
    Ok(saved)
}

fn put(
    folder: &mut NewFolder,
    name: &str,
    fill: impl FnOnce(&mut Output) -> io::Result<()>,
) -> Result<(), OutputError> {
    folder.file(name, |out| fill(out).map_err(|reason| out.failed(reason)))
}

fn spanned<T>(value: T) -> Spanned<T> {
    Spanned::new(0..0, value)
}

/// A file name made of the run's id that is valid everywhere and unique even where case does not count.
fn file_name(id: &str, taken: &mut HashSet<String>) -> String {
    let stem: String =
        id.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' || c == '_' { c } else { '_' }).take(60).collect();
    let mut name = format!("{stem}.csv");
    let mut suffix = 2;
    while !taken.insert(name.to_lowercase()) {
        name = format!("{stem}-{suffix}.csv");
        suffix += 1;
    }
    name
}

fn entry(run: &Run, file: String) -> Entry {
    Entry {
        id: spanned(run.id.clone()),
        kind: run.kind,
        file: spanned(file),
        format: run.data.format(),
        duty: run.duty.map(spanned),
        direction: run.direction,
        pwm_hz: Some(spanned(run.pwm_hz)),
        drive_on_s: run.drive_on_s.map(spanned),
        pwm_phase_s: (run.pwm_phase_s != 0.0).then(|| spanned(run.pwm_phase_s)),
        aligned: run.aligned.then_some(true),
        order: run.order,
        control: run.control.as_ref().map(|control| spanned(control_value(control))),
    }
}

fn control_value(control: &ControlSpec) -> toml::Value {
    match control {
        ControlSpec::Thesis => "thesis".into(),
        ControlSpec::Default => "default".into(),
        ControlSpec::Table(gains) => toml::Value::try_from(gains).expect("numbers always serialise"),
    }
}

/// Writes the samples as the table [`RunData::format`] names. Numbers are printed with as many digits as bring the same
/// number back.
pub(super) fn write_data(out: &mut impl Write, data: &RunData) -> io::Result<()> {
    match data {
        RunData::Levels { start_us, period_us, levels } => {
            writeln!(out, "time_us,level")?;
            for (index, level) in levels.iter().enumerate() {
                writeln!(out, "{},{}", start_us + index as f64 * period_us, u8::from(*level))?;
            }
        }
        RunData::Edges { initial, start_us, edges, end_us } => {
            writeln!(out, "time_us,level\n{start_us},{}", u8::from(*initial))?;
            for edge in edges {
                writeln!(out, "{},{}", edge.time_us, u8::from(edge.level))?;
            }
            let last = edges.last();
            if last.is_none_or(|edge| edge.time_us < *end_us) {
                writeln!(out, "{end_us},{}", u8::from(last.map_or(*initial, |edge| edge.level)))?;
            }
        }
        RunData::Velocity { time_us, rpm } => {
            writeln!(out, "time_us,rpm")?;
            for (time_us, rpm) in time_us.iter().zip(rpm) {
                writeln!(out, "{time_us},{rpm}")?;
            }
        }
        RunData::Control(rows) => {
            writeln!(out, "time_us,target,position,u,duty,direction")?;
            for row in rows {
                let direction = if row.direction == Direction::Cw { 1 } else { -1 };
                writeln!(out, "{},{},{},{},{},{direction}", row.time_us, row.target, row.position, row.u, row.duty)?;
            }
        }
        RunData::Drive { time_us, input, response, beside } => {
            let (name, values) = match response {
                DriveResponse::PositionRad(values) => ("position_rad", values),
                DriveResponse::SpeedRpm(values) => ("speed_rpm", values),
            };
            let names: String = beside.keys().map(|column| format!(",{}", column.name())).collect();
            writeln!(out, "time_us,input,{name}{names}")?;
            for (k, ((time_us, input), value)) in time_us.iter().zip(input).zip(values).enumerate() {
                let more: String = beside.values().filter_map(|v| v.get(k)).map(|v| format!(",{v}")).collect();
                writeln!(out, "{time_us},{input},{value}{more}")?;
            }
        }
    }
    Ok(())
}
