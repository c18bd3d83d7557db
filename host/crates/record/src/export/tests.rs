use super::*;
use crate::measurement::{ControlSpec, Direction, RunData, RunKind};
use crate::recording::Recording;
use crate::synthetic::{Line, bits_block, configured, control_blocks, edges_block};
use tempfile::TempDir;
use twum_files::output::{Existing, OutputError};
use twum_shared::Duty;
use twum_shared::message::{DeviceMessage, HostMessage, Pass, RunEnd, SpeedRun, TrackRun};
use twum_shared::reference::Reference;
use twum_shared::step::ConfigSpec;

/// One open-loop run of 400 ms at half duty, with a lost block of bits, and one closed-loop run of 40 ms.
fn recording(dir: &TempDir) -> Recording {
    let path = dir.path().join("a.mcap");
    let mut line = Line::new(&path);
    line.device(configured(ConfigSpec::THESIS));
    line.device(DeviceMessage::Aligned);
    let run = SpeedRun { duty: Duty::from_ratio(1, 2), direction: twum_shared::Direction::Ccw, duration_ms: 400 };
    line.host(HostMessage::Speed { pass: Pass::default(), run });
    line.now_us = 100_000;
    line.device(DeviceMessage::RunStarted { start_us: 100_000 });
    for index in 0..10 {
        let (first_sample, first_us) = (64 * index, 50_000 + 64_000 * index);
        line.now_us = first_us + 64_000;
        let block = DeviceMessage::Bits(bits_block(first_sample, first_us, 2));
        if index == 4 {
            line.lost(block)
        } else {
            line.device(block)
        }
        line.device(DeviceMessage::Edges(edges_block(9 * index, 50_500 + 63_000 * index, 9)));
        if index == 7 {
            line.device(DeviceMessage::RunEnded { end: RunEnd::Completed, end_us: 500_000 });
        }
    }
    let start_us = line.now_us + 1000;
    let reference = Reference::Sine { amplitude: 60, omega_urad_s: 1_000_000 };
    line.host(HostMessage::Track { pass: Pass::default(), run: TrackRun { reference, duration_ms: 40 } });
    line.device(DeviceMessage::RunStarted { start_us });
    for block in control_blocks(ConfigSpec::THESIS, start_us, 5) {
        line.now_us = block.first_us + 8000;
        line.device(DeviceMessage::Control(block));
    }
    line.device(DeviceMessage::RunEnded { end: RunEnd::Completed, end_us: start_us + 40_000 });
    line.device(DeviceMessage::Log("a \"quoted\", line".try_into().unwrap()));
    line.finish();
    Recording::load(&path).unwrap()
}

#[test]
fn runs_become_a_measurement_folder_that_loads() {
    let dir = tempfile::tempdir().unwrap();
    let (measurement, notes) = to_measurement(&recording(&dir), "bench", EncoderSource::Edges).unwrap();
    assert!(notes.is_empty(), "{notes:?}");
    let measurement = measurement.save(dir.path().join("folder")).unwrap();
    let [speed, track] = &measurement.runs[..] else { panic!("{} runs", measurement.runs.len()) };
    assert_eq!((speed.kind, speed.duty, speed.direction), (RunKind::Speed, Some(0.5), Some(Direction::Ccw)));
    assert_eq!((speed.drive_on_s, speed.aligned, track.aligned), (Some(0.4), true, false));
    let RunData::Edges { initial, start_us, edges, end_us } = &speed.data else { panic!() };
    // Edges come at 50.5 ms + 7 ms k; the eighth (level low) is the last before the run starts at 100 ms.
    assert_eq!((*initial, *start_us, edges[0].time_us, edges[0].level), (false, 0.0, 6500.0, true));
    assert_eq!(*end_us, track_start_us() - 100_000.0, "the record ends where the next run starts");
    assert_eq!((track.kind, track.control), (RunKind::Track, Some(ControlSpec::Thesis)));
    let RunData::Control(rows) = &track.data else { panic!() };
    assert_eq!((rows.len(), rows[79].time_us), (80, 39_500.0));
    assert!(rows.iter().all(|row| (row.duty * 32.0).fract() == 0.0));
}

fn track_start_us() -> f64 {
    50_000.0 + 640_000.0 + 1000.0
}

#[test]
fn missing_bits_make_two_parts_on_the_runs_own_clock() {
    let dir = tempfile::tempdir().unwrap();
    let (measurement, notes) = to_measurement(&recording(&dir), "bench", EncoderSource::Bits).unwrap();
    assert_eq!(notes, ["run 1: in 2 parts, because samples are missing between them"]);
    let spans: Vec<(f64, f64)> = measurement.runs[..2].iter().map(|run| run.span_us()).collect();
    assert_eq!(spans, [(0.0, 205_000.0), (270_000.0, 589_000.0)]);
    measurement.save(dir.path().join("folder")).unwrap();
}

#[test]
fn the_decoded_mcap_is_read_by_the_containers_own_reader_with_its_schemas() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("out.mcap");
    let recording = recording(&dir);
    write_mcap(&recording, &path, Existing::Keep).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let error = write_mcap(&recording, &path, Existing::Keep).unwrap_err();
    assert!(matches!(error, ExportError::Output(OutputError::Exists(_))), "{error}");
    assert_eq!(std::fs::read(&path).unwrap(), bytes, "an existing file was touched");
    let mut counts = std::collections::BTreeMap::new();
    let mut last_time = 0;
    for message in ::mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let schema = message.channel.schema.clone().unwrap();
        let schema: serde_json::Value = serde_json::from_slice(&schema.data).unwrap();
        let value: serde_json::Value = serde_json::from_slice(&message.data).unwrap();
        for (key, value) in value.as_object().unwrap() {
            let kind =
                schema["properties"][key]["type"].as_str().unwrap_or_else(|| panic!("{key} is not in the schema"));
            let fits = match kind {
                "integer" => value.is_i64() || value.is_u64(),
                "number" => value.is_number(),
                "string" => value.is_string(),
                _ => value.is_object(),
            };
            assert!(fits, "{key}: {value} is no {kind}");
        }
        assert!(message.log_time >= last_time || message.channel.topic == "/log", "messages out of order");
        last_time = message.log_time.max(last_time);
        *counts.entry(message.channel.topic.clone()).or_insert(0) += 1;
    }
    assert_eq!((counts["/control"], counts["/edge"], counts["/level"]), (80, 90, 576));
    assert!(::mcap::Summary::read(&bytes).unwrap().unwrap().chunk_indexes.len() == 1);
}

/// Stands there whether the board reported or not.
const STATUS_HEADER: &str = "session,time_us,mode,fault,position,duty,direction,ticks,late_ticks,worst_late_us,\
                             worst_duration_us,edges,lost_items,bad_frames";

#[test]
fn tables_hold_every_sample_and_quote_what_people_wrote() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("tables");
    write_csv(&recording(&dir), &out).unwrap();
    let lines = |name: &str| std::fs::read_to_string(out.join(name)).unwrap().lines().count();
    assert_eq!((lines("control.csv"), lines("edges.csv"), lines("bits.csv")), (81, 91, 577));
    assert_eq!(std::fs::read_to_string(out.join("status.csv")).unwrap().lines().next().unwrap(), STATUS_HEADER);
    let mut events = ::csv::Reader::from_path(out.join("events.csv")).unwrap();
    let texts: Vec<String> = events.records().map(|record| record.unwrap()[4].to_owned()).collect();
    assert!(texts.contains(&"a \"quoted\", line".to_owned()), "{texts:?}");
    assert!(write_csv(&recording(&tempfile::tempdir().unwrap()), &out).is_err(), "written into a folder in use");
}

#[test]
fn a_recording_without_runs_says_so() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let mut line = Line::new(&path);
    line.device(DeviceMessage::Aligned);
    line.finish();
    let recording = Recording::load(&path).unwrap();
    assert!(matches!(to_measurement(&recording, "x", EncoderSource::Edges), Err(ExportError::NoRun)));
}
