//! How fast a recording is written, decoded, checked and plotted: `cargo bench -p twum-host --bench record`.
//!
//! The recording is an hour of the control loop at 2 kHz (450 000 frames). Each figure is the best of three passes over a
//! file in the page cache, on one core, in processor time.

use std::path::Path;
use std::time::Instant;
use twum_host::compare::replay::replay_recording;
use twum_host::plot::recording_figure;
use twum_host::record::decode::{Decoder, Item};
use twum_host::record::recording::Recording;
use twum_host::record::store::{Metadata, Reader, Sender, Writer};
use twum_shared::frame::{self, Header, MAX_ENCODED};
use twum_shared::message::{BLOCK_SAMPLES, Configuration, ControlBlock, ControlSample, DeviceMessage, RunEnd};
use twum_shared::step::{Config, ConfigSpec, Inputs, State, step};

const TICKS: u64 = 7_200_000;

fn main() {
    let dir = std::env::temp_dir().join(format!("twum-bench-{}", std::process::id()));
    std::fs::create_dir_all(&dir).expect("a temporary folder");
    let path = dir.join("hour.mcap");
    let (seconds, ()) = timed(|| write_hour(&path));
    let bytes = std::fs::metadata(&path).expect("just written").len() as f64 / 1e6;
    println!("write      {:>8.1} MB in {seconds:.2} s: {:>6.0} MB/s", bytes, bytes / seconds);
    report("read", bytes, || read(&path));
    report("decode", bytes, || decode(&path));
    report("views", bytes, || views(&path));
    report("check", bytes, || check(&path));
    report("plot", bytes, || plot(&path));
    if let Some(peak) = peak_megabytes() {
        println!("peak memory of all of it: {peak:.0} MB");
    }
    std::fs::remove_dir_all(&dir).expect("removable");
}

/// Seconds of processor time of this thread: other work on the machine does not count. Wall time where the system does
/// not say.
fn timed<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let (processor, wall) = (processor_s(), Instant::now());
    let value = work();
    match (processor, processor_s()) {
        (Some(before), Some(after)) => (after - before, value),
        _ => (wall.elapsed().as_secs_f64(), value),
    }
}

fn processor_s() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split_whitespace().next()?.parse::<f64>().ok()? * 1e-9)
}

fn report(name: &str, megabytes: f64, work: impl Fn() -> u64) {
    let (best, count) = (0..3).map(|_| timed(&work)).min_by(|a, b| a.0.total_cmp(&b.0)).expect("three passes");
    println!("{name:<10} {megabytes:>8.1} MB in {best:.2} s: {:>6.0} MB/s ({count} counted)", megabytes / best);
}

/// A rotor that follows the control signal with a lag: values of the size a real run has.
fn write_hour(path: &Path) {
    let mut writer = Writer::create(path, &Metadata::simulated()).expect("a new file");
    let config = Config::try_from(ConfigSpec::THESIS).expect("a named configuration");
    let (mut sequence, mut state, mut speed, mut position) = (0, State::REST, 0.0, 0.0);
    let mut send = |time_us: u64, message: &DeviceMessage| {
        let mut out = [0; MAX_ENCODED];
        let bytes = frame::encode(Header { sequence, time_us }, message, &mut out).expect("fits");
        writer.frame(Sender::Device, time_us * 1000, bytes).expect("disk space");
        sequence += 1;
    };
    send(0, &DeviceMessage::Configured(Configuration::with_control(ConfigSpec::THESIS)));
    send(0, &DeviceMessage::RunStarted { start_us: 0 });
    for block in 0..TICKS / BLOCK_SAMPLES as u64 {
        let first_tick = block * BLOCK_SAMPLES as u64;
        let mut message = ControlBlock { first_tick, first_us: first_tick * 500, state, samples: Default::default() };
        for tick in first_tick..first_tick + BLOCK_SAMPLES as u64 {
            let phase = 1.257 * tick as f64 * 500e-6;
            let inputs = Inputs {
                target: (89.0 * phase.sin()) as i32,
                target_rate: (89.0 * 1.257 * phase.cos()) as i32,
                position: position as i32,
                ..Inputs::default()
            };
            let out = step(&config, &mut state, inputs);
            let drive = f64::from(out.on_steps.saturating_sub(1)) / 31.0 * f64::from(out.direction.sign());
            speed += (drive * 350.0 - speed) * 500e-6 / 5e-3;
            position += speed * 500e-6;
            let sample = ControlSample::new(inputs, out, (tick % 5) as u16, 6 + (tick % 3) as u16);
            message.samples.push(sample).expect("a block's size");
        }
        let sent_us = message.first_us + 500 * BLOCK_SAMPLES as u64;
        send(sent_us, &DeviceMessage::Control(message));
    }
    let end_us = TICKS * 500;
    send(end_us, &DeviceMessage::RunEnded { end: RunEnd::Completed, end_us });
    writer.finish().expect("disk space");
}

/// As `twum replay` does.
fn check(path: &Path) -> u64 {
    let found = replay_recording(path).expect("just written");
    assert!(found.replay.is_exact(), "{:?}", found.replay);
    found.replay.checked
}

/// As `twum plot` does.
fn plot(path: &Path) -> u64 {
    let (figure, _) = recording_figure(path, "hour").expect("has signals");
    figure.png().expect("a usual size").len() as u64
}

fn peak_megabytes() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<f64>().ok()? / 1024.0)
}

fn read(path: &Path) -> u64 {
    let mut reader = Reader::open(path).expect("just written");
    while reader.next_entry().expect("readable").is_some() {}
    reader.integrity().frames
}

fn decode(path: &Path) -> u64 {
    let mut decoder = Decoder::open(path).expect("just written");
    let mut samples = 0;
    while let Some(item) = decoder.next_item().expect("readable") {
        if let Item::Device { message: DeviceMessage::Control(block), .. } = item {
            samples += block.samples.len() as u64;
        }
    }
    samples
}

fn views(path: &Path) -> u64 {
    let recording = Recording::load(path).expect("just written");
    recording.control.iter().map(|segment| segment.samples.len() as u64).sum()
}
