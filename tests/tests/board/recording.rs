//! Recordings of a simulated board: repeatable to the byte, and exact to the bit.

use std::fs;
use std::path::Path;
use twum_host::compare::replay::Replay;
use twum_host::link::bench::{Action, Experiment, Outcome, perform};
use twum_host::link::{Session, SimulatedLink};
use twum_host::record::store::{Entry, Reader, Sender};
use twum_host::sim::Setup;
use twum_shared::frame;
use twum_shared::message::{CaptureMode, Configuration, DeviceMessage, TrackRun};
use twum_shared::reference::Reference;
use twum_shared::step::ConfigSpec;

fn track(path: &Path, jitter_seed: u64) -> Outcome {
    let mut session = Session::new(SimulatedLink::new(Setup { jitter_seed, ..Setup::default() }));
    let experiment = Experiment {
        configuration: Some(Configuration::with_control(ConfigSpec::THESIS)),
        capture: CaptureMode { bits: true, edges: true, control: true },
        action: Action::Track(TrackRun {
            reference: Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 },
            duration_ms: 3_000,
        }),
        recording: Some(path.to_owned()),
        motor: "simulated".to_owned(),
    };
    perform(&mut session, &experiment, None, |_| {}).expect("the experiment")
}

#[test]
fn the_same_seed_records_the_same_bytes_and_another_seed_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let paths = ["a.mcap", "b.mcap", "c.mcap"].map(|name| folder.path().join(name));
    for (path, seed) in paths.iter().zip([7, 7, 8]) {
        track(path, seed);
    }
    let [a, b, c] = paths.map(|path| fs::read(path).unwrap());
    assert!(a.len() > 50_000, "{} bytes", a.len());
    assert_eq!(a, b);
    assert_ne!(a, c);
}

#[test]
fn a_recording_replays_bit_for_bit_and_holds_every_tick_edge_and_sample() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let outcome = track(&path, 1);
    assert!(outcome.tally.is_lossless());
    let mut reader = Reader::open(&path).unwrap();
    let mut replay = Replay::new();
    let (mut edges, mut samples, mut next_sample, mut next_edge) = (0, 0, 0, 0);
    while let Some(entry) = reader.next_entry().unwrap() {
        let Entry::Frame { sender: Sender::Device, bytes, .. } = entry else { continue };
        let mut block = bytes.strip_suffix(&[0]).unwrap().to_vec();
        let (_, message) = frame::decode::<DeviceMessage>(&mut block).unwrap();
        replay.observe(&message);
        match message {
            DeviceMessage::Edges(block) => {
                assert_eq!(block.first_edge, next_edge, "edges are consecutive");
                next_edge += block.edges.len() as u64;
                edges += block.edges.len();
            }
            DeviceMessage::Bits(block) => {
                assert_eq!(block.first_sample, next_sample, "samples are consecutive");
                next_sample += u64::from(block.samples);
                samples += u64::from(block.samples);
            }
            _ => {}
        }
    }
    let report = replay.report();
    assert!(report.is_exact(), "{report:?}");
    assert_eq!((report.checked, report.gaps), (6_000, 0));
    // 3 s of run and the tail behind it, at 1 kHz.
    assert!((3_000..4_200).contains(&samples), "{samples}");
    assert!(edges > 100, "{edges}");
}
