use super::ExportError;
use crate::measurement::{
    ControlGains, ControlRow, ControlSpec, Direction, LevelEdge, MAX_RECORD_S, MAX_TIME_US, Measurement, Run, RunData,
    RunKind,
};
use crate::recording::{BitsSegment, Command, ControlSegment, EdgesSegment, RecordedRun, Recording, TimedEdge};
use std::path::PathBuf;
use twum_shared::message::Configuration;

/// How long after its end a run is followed: the rotor stops within this time.
const COAST_US: u64 = 2_000_000;
/// Sampling period of the bit capture.
const BIT_PERIOD_US: u64 = 1_000;

/// Which record of the encoder becomes a run's data where a recording holds both.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EncoderSource {
    /// Timestamped edges: the better ones.
    Edges,
    /// 1 kHz levels, as in the thesis.
    Bits,
}

/// Makes a measurement of a recording, and says what was left out.
///
/// Every run becomes one entry (`control` for a closed loop, `edges` or `levels` for an open one), from its start to two
/// seconds behind its end; where samples are missing it becomes several, all with times from the run's start.
///
/// # Errors
/// [`ExportError::NoRun`].
pub fn to_measurement(
    recording: &Recording,
    name: &str,
    source: EncoderSource,
) -> Result<(Measurement, Vec<String>), ExportError> {
    let mut notes = Vec::new();
    let mut runs = Vec::new();
    for (index, run) in recording.runs.iter().enumerate() {
        let window = Window::of(recording, index);
        let (kind, parts) = match (&run.command, control_rows(recording, &window)) {
            (Command::Speed(_), _) => (RunKind::Speed, encoder_parts(recording, &window, source)),
            (_, Some(rows)) => (RunKind::Track, vec![RunData::Control(rows)]),
            (Command::Track(_), None) => (RunKind::Track, encoder_parts(recording, &window, source)),
            (Command::Unknown, None) => {
                notes.push(format!("run {}: left out, the recording does not say what it was", index + 1));
                continue;
            }
        };
        if parts.is_empty() {
            notes.push(format!("run {}: left out, no encoder or control data were captured", index + 1));
        }
        if parts.len() > 1 {
            notes.push(format!(
                "run {}: in {} parts, because samples are missing between them",
                index + 1,
                parts.len()
            ));
        }
        let said = run.configuration.is_none_or(|configuration| control_spec(&configuration).is_some());
        if kind == RunKind::Track && !said {
            notes.push(format!(
                "run {}: its controller is more than a table of gains, so `control` is left out",
                index + 1
            ));
        }
        let several = parts.len() > 1;
        for (part, data) in parts.into_iter().enumerate() {
            let mut id = run_id(index, run);
            if several {
                id += &format!("-part{}", part + 1);
            }
            let described = describe(Run::new(id, kind, data), index, run);
            let (start_us, end_us) = described.span_us();
            if end_us - start_us > MAX_RECORD_S * 1e6 || end_us.abs() > MAX_TIME_US {
                notes.push(format!("run {}: left out, its times span days: are they damaged?", index + 1));
                continue;
            }
            runs.push(described);
        }
    }
    if runs.is_empty() {
        return Err(ExportError::NoRun);
    }
    let configuration = recording.runs.iter().find_map(|run| run.configuration.filter(can_be));
    let measurement = Measurement {
        name: name.to_owned(),
        motor: match recording.metadata.motor.as_str() {
            "" => "pcbmotor-30mm".to_owned(),
            motor => motor.to_owned(),
        },
        edges_per_rev: configuration.map_or(400, |configuration| configuration.edges_per_rev.into()),
        runs,
        folder: PathBuf::new(),
    };
    Ok((measurement, notes))
}

/// Whether a board can have run so: a recording whose bytes are damaged may say anything.
fn can_be(configuration: &Configuration) -> bool {
    configuration.pwm_hz > 0 && configuration.edges_per_rev > 0 && configuration.control.period_us > 0
}

fn run_id(index: usize, run: &RecordedRun) -> String {
    let what = match &run.command {
        Command::Speed(speed) => {
            format!("speed-d{:.3}-{}", duty(speed.duty), if speed.direction.pin_high() { "cw" } else { "ccw" })
        }
        Command::Track(_) | Command::Unknown => "track".to_owned(),
    };
    format!("{:03}-{what}", index + 1)
}

fn describe(mut run: Run, index: usize, recorded: &RecordedRun) -> Run {
    if let Command::Speed(speed) = &recorded.command {
        run.duty = Some(duty(speed.duty));
        run.direction = Some(direction(speed.direction));
    }
    if let Some(configuration) = recorded.configuration.filter(can_be) {
        run.pwm_hz = configuration.pwm_hz.into();
        run.control = (run.kind == RunKind::Track).then(|| control_spec(&configuration)).flatten();
    }
    run.drive_on_s = recorded.end.map(|(_, end_us)| end_us.saturating_sub(recorded.start_us) as f64 / 1e6);
    run.aligned = recorded.aligned;
    run.order = u32::try_from(index).ok();
    run
}

fn duty(duty: twum_shared::Duty) -> f64 {
    f64::from(duty.raw()) / f64::from(twum_shared::Duty::FULL.raw())
}

fn direction(direction: twum_shared::Direction) -> Direction {
    if direction.pin_high() { Direction::Cw } else { Direction::Ccw }
}

/// The controller as the folder can say it: a named one, or a gain set that stands for exactly the same one. What goes
/// beyond that (feed-forward, dead band, another law) cannot be written there.
fn control_spec(configuration: &Configuration) -> Option<ControlSpec> {
    let spec = configuration.control;
    let period_s = f64::from(spec.period_us) * 1e-6;
    let gains = ControlSpec::Table(ControlGains {
        kp: spec.kp.to_num(),
        ki: spec.ki_tick.to_num::<f64>() / period_s,
        kd: spec.kd_tick.to_num::<f64>() * period_s,
        period_us: spec.period_us.into(),
        duty_steps: spec.duty_steps.into(),
        integral_min: f64::from(spec.integral_min) * period_s,
        integral_max: f64::from(spec.integral_max) * period_s,
    });
    let candidates = [ControlSpec::Thesis, ControlSpec::Default, gains];
    candidates.into_iter().find(|candidate| candidate.config().is_ok_and(|config| config == spec))
}

/// The part of the board's time that belongs to a run.
struct Window {
    session: u32,
    start_us: u64,
    stop_us: u64,
}

impl Window {
    fn of(recording: &Recording, index: usize) -> Self {
        let run = &recording.runs[index];
        let session_end_us = recording.sessions.get(run.session as usize).map_or(0, |session| session.end_us);
        let coasted_us = run.end.map_or(session_end_us, |(_, end_us)| end_us.saturating_add(COAST_US));
        let next = recording.runs.get(index + 1).filter(|next| next.session == run.session);
        let stop_us = coasted_us.min(session_end_us).min(next.map_or(u64::MAX, |next| next.start_us));
        Self { session: run.session, start_us: run.start_us, stop_us }
    }

    fn holds(&self, time_us: u64) -> bool {
        (self.start_us..self.stop_us).contains(&time_us)
    }

    /// Time from the run's start in µs.
    fn time_us(&self, time_us: u64) -> f64 {
        time_us as f64 - self.start_us as f64
    }
}

fn control_rows(recording: &Recording, window: &Window) -> Option<Vec<ControlRow>> {
    let segments = recording.control.iter().filter(|segment| segment.session == window.session);
    let row = |segment: &ControlSegment, index: usize| {
        let sample = &segment.samples[index];
        ControlRow {
            time_us: window.time_us(segment.time_us(index)),
            target: sample.target.into(),
            position: sample.position.into(),
            u: f64::from(sample.u) / 65_536.0,
            duty: (f64::from(sample.on_steps) / f64::from(segment.duty_steps.max(1))).min(1.0),
            direction: direction(sample.direction),
        }
    };
    let rows: Vec<ControlRow> = segments
        .flat_map(|segment| {
            let inside = (0..segment.samples.len()).filter(|index| window.holds(segment.time_us(*index)));
            inside.map(move |index| row(segment, index))
        })
        .collect();
    (rows.len() > 1).then_some(rows)
}

fn encoder_parts(recording: &Recording, window: &Window, source: EncoderSource) -> Vec<RunData> {
    let edges = || -> Vec<RunData> {
        let segments: Vec<&EdgesSegment> =
            recording.edges.iter().filter(|segment| segment.session == window.session).collect();
        let parts = segments
            .iter()
            .enumerate()
            .filter_map(|(index, segment)| edges_part(segment, window, index + 1 == segments.len()));
        parts.collect()
    };
    let bits = || -> Vec<RunData> {
        let segments = recording.bits.iter().filter(|segment| segment.session == window.session);
        segments.filter_map(|segment| bits_part(segment, window)).collect()
    };
    let (first, second): (&dyn Fn() -> _, &dyn Fn() -> _) = match source {
        EncoderSource::Edges => (&edges, &bits),
        EncoderSource::Bits => (&bits, &edges),
    };
    let parts = first();
    if parts.is_empty() { second() } else { parts }
}

/// The edges of a segment inside the window. A segment that begins inside it, behind a gap, has its first edge as its
/// beginning; one that a gap follows ends with its last edge.
fn edges_part(segment: &EdgesSegment, window: &Window, is_last: bool) -> Option<RunData> {
    let inside: Vec<&TimedEdge> = segment.edges.iter().filter(|edge| window.holds(edge.time_us)).collect();
    let begins_before =
        segment.first_edge == 0 || segment.edges.first().is_some_and(|edge| edge.time_us < window.start_us);
    let goes_on_behind = is_last || segment.edges.last().is_some_and(|edge| edge.time_us >= window.stop_us);
    let (start_us, initial, edges) = if begins_before {
        let before = segment.edges.iter().rev().find(|edge| edge.time_us < window.start_us);
        let initial = before.map(|edge| edge.level).or(inside.first().map(|edge| !edge.level))?;
        (window.start_us, initial, &inside[..])
    } else {
        let (first, rest) = inside.split_first()?;
        (first.time_us, first.level, rest)
    };
    let end_us = if goes_on_behind { window.stop_us } else { edges.last()?.time_us };
    let edge = |edge: &&TimedEdge| LevelEdge { time_us: window.time_us(edge.time_us), level: edge.level };
    (end_us > start_us).then(|| RunData::Edges {
        initial,
        start_us: window.time_us(start_us),
        edges: edges.iter().map(edge).collect(),
        end_us: window.time_us(end_us),
    })
}

fn bits_part(segment: &BitsSegment, window: &Window) -> Option<RunData> {
    let index_at = |time_us: u64| time_us.saturating_sub(segment.first_us).div_ceil(BIT_PERIOD_US) as usize;
    let levels = segment.levels.get(index_at(window.start_us)..index_at(window.stop_us).min(segment.levels.len()))?;
    let first_us = segment.first_us.saturating_add(index_at(window.start_us) as u64 * BIT_PERIOD_US);
    (levels.len() > 1).then(|| RunData::Levels {
        start_us: window.time_us(first_us),
        period_us: BIT_PERIOD_US as f64,
        levels: levels.to_vec(),
    })
}
