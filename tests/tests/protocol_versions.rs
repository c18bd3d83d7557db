//! Recordings of earlier protocol versions: read, and replayed exactly.

use std::path::{Path, PathBuf};
use twum_host::compare::replay::replay_recording;
use twum_host::record::decode::{Decoder, Item};
use twum_shared::message::{Configuration, DeviceMessage, HostMessage, TrackRun};
use twum_shared::reference::Reference;
use twum_shared::step::ConfigSpec;

/// Made by the last program of version 1: `twum track --port sim --control thesis --seconds 1.5 --out protocol-1.mcap`. What is
/// expected of it here is what that program's own `twum replay` said.
fn version_1() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/protocol-1.mcap")
}

#[test]
fn a_recording_of_version_1_replays_bit_for_bit() {
    let found = replay_recording(version_1()).unwrap();
    assert_eq!((found.replay.checked, found.replay.mismatched, found.replay.runs), (3_000, 0, 1));
    assert_eq!((found.replay.gaps, found.replay.missing, found.replay.unconfigured), (0, 0, 0));
    let link = found.link;
    assert_eq!((link.device_frames, link.host_frames, link.broken_frames, link.missing_sequences), (267, 39, 0, 0));
    assert_eq!((found.file.frames, found.file.damaged_places), (306, 0));
}

/// Made by the last program of version 2, in the same way.
fn version_2() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/protocol-2.mcap")
}

#[test]
fn a_recording_of_version_2_replays_bit_for_bit() {
    let found = replay_recording(version_2()).unwrap();
    assert_eq!((found.replay.checked, found.replay.mismatched, found.replay.runs), (3_000, 0, 1));
    assert_eq!((found.replay.gaps, found.replay.missing, found.replay.unconfigured), (0, 0, 0));
    let link = found.link;
    assert_eq!((link.device_frames, link.host_frames, link.broken_frames, link.missing_sequences), (261, 32, 0, 0));
    assert_eq!((found.file.frames, found.file.damaged_places), (293, 0));
}

/// Made by the last program of version 3, in the same way.
fn version_3() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/protocol-3.mcap")
}

#[test]
fn a_recording_of_version_3_replays_bit_for_bit() {
    let found = replay_recording(version_3()).unwrap();
    assert_eq!((found.replay.checked, found.replay.mismatched, found.replay.runs), (3_000, 0, 1));
    assert_eq!((found.replay.gaps, found.replay.missing, found.replay.unconfigured), (0, 0, 0));
    let link = found.link;
    assert_eq!((link.device_frames, link.host_frames, link.broken_frames, link.missing_sequences), (261, 32, 0, 0));
    assert_eq!((found.file.frames, found.file.damaged_places), (293, 0));
}

/// Fails when a field that version 3 had not is read from its bytes: what follows it would be another's.
#[test]
fn a_configuration_of_version_3_is_what_it_was_and_reverses_at_once() {
    let expected = Configuration::with_control(ConfigSpec::THESIS);
    let mut decoder = Decoder::open(version_3()).unwrap();
    let (mut set, mut in_force) = (0, 0);
    while let Some(item) = decoder.next_item().unwrap() {
        match item {
            Item::Host { message: HostMessage::Configure(configuration), .. } => {
                assert_eq!(configuration, expected);
                set += 1;
            }
            Item::Device { message: DeviceMessage::Configured(configuration), .. } => {
                assert_eq!(configuration, expected);
                in_force += 1;
            }
            Item::Broken { error, .. } => panic!("{error}"),
            _ => {}
        }
    }
    assert!(set == 1 && in_force >= 1, "{set}, {in_force}");
}

#[test]
fn a_configuration_of_version_2_is_what_it_was_and_as_slow_as_the_motor_might_be_then() {
    let expected = Configuration::with_control(ConfigSpec::THESIS);
    let mut decoder = Decoder::open(version_2()).unwrap();
    let (mut set, mut in_force) = (0, 0);
    while let Some(item) = decoder.next_item().unwrap() {
        match item {
            Item::Host { message: HostMessage::Configure(configuration), .. } => {
                assert_eq!(configuration, expected);
                set += 1;
            }
            Item::Device { message: DeviceMessage::Configured(configuration), .. } => {
                assert_eq!(configuration, expected);
                in_force += 1;
            }
            Item::Broken { error, .. } => panic!("{error}"),
            _ => {}
        }
    }
    assert!(set == 1 && in_force >= 1, "{set}, {in_force}");
}

#[test]
fn what_the_host_said_in_version_1_is_read_as_what_it_was() {
    let mut decoder = Decoder::open(version_1()).unwrap();
    let mut said = Vec::new();
    while let Some(item) = decoder.next_item().unwrap() {
        match item {
            Item::Host { message, .. } => said.push(message),
            Item::Broken { error, .. } => panic!("{error}"),
            _ => {}
        }
    }
    let sine = Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 };
    let tracked = TrackRun { reference: sine, duration_ms: 1_500 };
    assert!(said.iter().any(|message| matches!(message, HostMessage::Track { run, .. } if *run == tracked)));
    for (what, count) in [("Configure", 1), ("Arm", 2), ("Align", 1), ("Capture", 2), ("Stop", 1)] {
        let found = said.iter().filter(|message| format!("{message:?}").starts_with(what)).count();
        assert_eq!(found, count, "{what}");
    }
}
