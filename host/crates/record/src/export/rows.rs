//! What a recording holds, one row a sample: the same for tables and for messages. Times are the board's clock in µs within its
//! `session` (its starts, from 0).

use crate::recording::Recording;
use serde::Serialize;

/// One tick of the control loop.
#[derive(Default, Serialize)]
pub(super) struct ControlTick {
    pub(super) session: u32,
    tick: u64,
    pub(super) time_us: u64,
    target: i32,
    target_rate: i32,
    position: i32,
    u: f64,
    duty: f64,
    direction: i32,
    late_us: u16,
    duration_us: u16,
}

pub(super) fn control(recording: &Recording) -> impl Iterator<Item = ControlTick> {
    recording.control.iter().flat_map(|segment| {
        segment.samples.iter().enumerate().map(|(index, sample)| ControlTick {
            session: segment.session,
            tick: segment.first_tick + index as u64,
            time_us: segment.time_us(index),
            target: sample.target,
            target_rate: sample.target_rate,
            position: sample.position,
            u: f64::from(sample.u) / 65_536.0,
            duty: f64::from(sample.on_steps) / f64::from(segment.duty_steps.max(1)),
            direction: sample.direction.sign(),
            late_us: sample.late_us,
            duration_us: sample.duration_us,
        })
    })
}

/// One edge of the encoder.
#[derive(Default, Serialize)]
pub(super) struct EncoderEdge {
    pub(super) session: u32,
    edge: u64,
    pub(super) time_us: u64,
    level: u8,
    direction: i32,
}

pub(super) fn edges(recording: &Recording) -> impl Iterator<Item = EncoderEdge> {
    recording.edges.iter().flat_map(|segment| {
        segment.edges.iter().enumerate().map(|(index, edge)| EncoderEdge {
            session: segment.session,
            edge: segment.first_edge + index as u64,
            time_us: edge.time_us,
            level: u8::from(edge.level),
            direction: edge.direction.sign(),
        })
    })
}

/// One sample of the encoder line.
#[derive(Default, Serialize)]
pub(super) struct EncoderLevel {
    pub(super) session: u32,
    sample: u64,
    pub(super) time_us: u64,
    level: u8,
}

pub(super) fn levels(recording: &Recording) -> impl Iterator<Item = EncoderLevel> {
    recording.bits.iter().flat_map(|segment| {
        segment.levels.iter().enumerate().map(|(index, level)| EncoderLevel {
            session: segment.session,
            sample: segment.first_sample + index as u64,
            time_us: segment.first_us + 1000 * index as u64,
            level: u8::from(*level),
        })
    })
}

/// The board's own report, ten times a second.
#[derive(Default, Serialize)]
pub(super) struct BoardStatus {
    pub(super) session: u32,
    pub(super) time_us: u64,
    mode: String,
    fault: String,
    position: i32,
    duty: f64,
    direction: i32,
    ticks: u64,
    late_ticks: u32,
    worst_late_us: u32,
    worst_duration_us: u32,
    edges: u32,
    lost_items: u32,
    bad_frames: u32,
}

pub(super) fn status(recording: &Recording) -> impl Iterator<Item = BoardStatus> {
    recording.status.iter().map(|(session, time_us, status)| BoardStatus {
        session: *session,
        time_us: *time_us,
        mode: format!("{:?}", status.mode),
        fault: status.fault.map_or(String::new(), |fault| format!("{fault:?}")),
        position: status.position,
        duty: f64::from(status.duty.raw()) / f64::from(twum_shared::Duty::FULL.raw()),
        direction: status.direction.sign(),
        ticks: status.ticks,
        late_ticks: status.late_ticks,
        worst_late_us: status.worst_late_us,
        worst_duration_us: status.worst_duration_us,
        edges: status.edges,
        lost_items: status.lost_items,
        bad_frames: status.bad_frames,
    })
}

/// A run of the motor.
#[derive(Default, Serialize)]
pub(super) struct RunRow {
    session: u32,
    run: usize,
    start_us: u64,
    end_us: Option<u64>,
    end: String,
    command: String,
}

pub(super) fn runs(recording: &Recording) -> impl Iterator<Item = RunRow> {
    recording.runs.iter().enumerate().map(|(index, run)| RunRow {
        session: run.session,
        run: index + 1,
        start_us: run.start_us,
        end_us: run.end.map(|(_, us)| us),
        end: run.end.map_or(String::new(), |(end, _)| format!("{end:?}")),
        command: format!("{:?}", run.command),
    })
}

/// Something that happened.
#[derive(Default, Serialize)]
pub(super) struct EventRow {
    session: u32,
    time_us: u64,
    host_time_ns: u64,
    event: &'static str,
    text: String,
}

pub(super) fn events(recording: &Recording) -> impl Iterator<Item = EventRow> {
    recording.events.iter().map(|event| {
        let (name, text) = event.kind.describe();
        EventRow { session: event.session, time_us: event.time_us, host_time_ns: event.host_time_ns, event: name, text }
    })
}
