use super::{ExportError, create_new};
use crate::record::recording::{Event, EventKind, Recording};
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Writes what a recording holds as tables into a new folder: `control.csv`, `edges.csv`, `bits.csv`, `status.csv`,
/// `runs.csv` and `events.csv`. Times are the board's clock in µs within its `session` (its starts, from 0).
///
/// # Errors
/// When the folder exists and is not empty, or writing fails.
pub fn write_csv(recording: &Recording, folder: &Path) -> Result<(), ExportError> {
    let io_error = |reason| ExportError::Io { path: folder.to_owned(), reason };
    fs::create_dir_all(folder).map_err(io_error)?;
    if fs::read_dir(folder).map_err(io_error)?.next().is_some() {
        return Err(ExportError::Exists(folder.to_owned()));
    }
    let table = |name: &str, write: &dyn Fn(&mut BufWriter<File>) -> io::Result<()>| {
        let path = folder.join(name);
        let mut out = create_new(&path)?;
        write(&mut out).and_then(|()| out.flush()).map_err(|reason| ExportError::Io { path, reason })
    };
    table("control.csv", &|out| control(recording, out))?;
    table("edges.csv", &|out| edges(recording, out))?;
    table("bits.csv", &|out| bits(recording, out))?;
    table("status.csv", &|out| status(recording, out))?;
    table("runs.csv", &|out| runs(recording, out))?;
    table("events.csv", &|out| events(recording, out))
}

fn control(recording: &Recording, out: &mut impl Write) -> io::Result<()> {
    writeln!(out, "session,tick,time_us,target,target_rate,position,u,duty,direction,late_us,duration_us")?;
    for segment in &recording.control {
        for (index, sample) in segment.samples.iter().enumerate() {
            writeln!(
                out,
                "{},{},{},{},{},{},{},{},{},{},{}",
                segment.session,
                segment.first_tick + index as u64,
                segment.time_us(index),
                sample.target,
                sample.target_rate,
                sample.position,
                f64::from(sample.u) / 65_536.0,
                f64::from(sample.on_steps) / f64::from(segment.duty_steps.max(1)),
                sample.direction.sign(),
                sample.late_us,
                sample.duration_us
            )?;
        }
    }
    Ok(())
}

fn edges(recording: &Recording, out: &mut impl Write) -> io::Result<()> {
    writeln!(out, "session,edge,time_us,level,direction")?;
    for segment in &recording.edges {
        for (index, edge) in segment.edges.iter().enumerate() {
            let number = segment.first_edge + index as u64;
            let level = u8::from(edge.level);
            writeln!(out, "{},{number},{},{level},{}", segment.session, edge.time_us, edge.direction.sign())?;
        }
    }
    Ok(())
}

fn bits(recording: &Recording, out: &mut impl Write) -> io::Result<()> {
    writeln!(out, "session,sample,time_us,level")?;
    for segment in &recording.bits {
        for (index, level) in segment.levels.iter().enumerate() {
            let index = index as u64;
            let (sample, time_us) = (segment.first_sample + index, segment.first_us + 1000 * index);
            writeln!(out, "{},{sample},{time_us},{}", segment.session, u8::from(*level))?;
        }
    }
    Ok(())
}

fn status(recording: &Recording, out: &mut impl Write) -> io::Result<()> {
    writeln!(
        out,
        "session,time_us,mode,fault,position,duty,direction,ticks,late_ticks,worst_late_us,worst_duration_us,edges,\
         lost_items,bad_frames"
    )?;
    for (session, time_us, status) in &recording.status {
        writeln!(
            out,
            "{session},{time_us},{:?},{},{},{},{},{},{},{},{},{},{},{}",
            status.mode,
            status.fault.map_or(String::new(), |fault| format!("{fault:?}")),
            status.position,
            f64::from(status.duty.raw()) / f64::from(twum_shared::Duty::FULL.raw()),
            status.direction.sign(),
            status.ticks,
            status.late_ticks,
            status.worst_late_us,
            status.worst_duration_us,
            status.edges,
            status.lost_items,
            status.bad_frames
        )?;
    }
    Ok(())
}

fn runs(recording: &Recording, out: &mut impl Write) -> io::Result<()> {
    writeln!(out, "session,run,start_us,end_us,end,command")?;
    for (index, run) in recording.runs.iter().enumerate() {
        let (end, end_us) = run.end.map_or_else(Default::default, |(end, us)| (format!("{end:?}"), us.to_string()));
        let command = quoted(&format!("{:?}", run.command));
        writeln!(out, "{},{},{},{end_us},{end},{command}", run.session, index + 1, run.start_us)?;
    }
    Ok(())
}

fn events(recording: &Recording, out: &mut impl Write) -> io::Result<()> {
    writeln!(out, "session,time_us,host_time_ns,event,text")?;
    for Event { session, time_us, host_time_ns, kind } in &recording.events {
        let (name, text) = kind.describe();
        writeln!(out, "{session},{time_us},{host_time_ns},{name},{}", quoted(&text))?;
    }
    Ok(())
}

/// A field that may hold commas, quotes or line ends (RFC 4180).
fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('"', "\"\""))
}

impl EventKind {
    /// A short name of the kind, and what there is to read about it.
    pub fn describe(&self) -> (&'static str, String) {
        match self {
            Self::Hello(identity) => {
                ("hello", format!("{} on {}, reset: {:?}", identity.firmware, identity.chip, identity.reset))
            }
            Self::Configured(configuration) => ("configured", format!("{configuration:?}")),
            Self::Aligned => ("aligned", String::new()),
            Self::RunStarted => ("run-started", String::new()),
            Self::RunEnded(end) => ("run-ended", format!("{end:?}")),
            Self::Fault(report) => {
                ("fault", format!("{:?}: {} (off at {} us)", report.fault, report.fault, report.off_us))
            }
            Self::Log(line) => ("log", line.clone()),
            Self::Command(command) => ("command", command.clone()),
            Self::Refused(reason) => ("refused", reason.clone()),
            Self::Remark(json) => ("recorder", json.clone()),
            Self::Broken(sender, error) => ("broken", format!("{sender:?}: {error}")),
        }
    }
}
