//! Recordings of earlier protocol versions: read, and replayed exactly.

use std::path::{Path, PathBuf};
use twum_host::compare::replay::replay_recording;
use twum_host::record::decode::{Decoder, Item};
use twum_shared::message::{Configuration, DeviceMessage, HostMessage, TrackRun};
use twum_shared::reference::Reference;
use twum_shared::step::ConfigSpec;

/// Made by the last program of that version: `twum track --port sim --control thesis --seconds 1.5 --out protocol-N.mcap`,
/// of version 5 also with `--control gated`, of version 6 with `--control planned`.
fn recording(version: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("data/protocol-{version}.mcap"))
}

/// Frames of the device, of the host, and in the file: what each program's own `twum replay` said of its recording.
const FRAMES: [(&str, [u64; 3]); 8] = [
    ("1", [267, 39, 306]),
    ("2", [261, 32, 293]),
    ("3", [261, 32, 293]),
    ("4", [261, 84, 345]),
    ("5", [259, 84, 343]),
    ("5-gated", [259, 84, 343]),
    ("6", [259, 84, 343]),
    ("6-planned", [259, 84, 343]),
];

#[test]
fn recordings_of_earlier_versions_replay_bit_for_bit() {
    for (version, [device, host, file]) in FRAMES {
        let found = replay_recording(recording(version)).unwrap();
        assert_eq!((found.replay.checked, found.replay.mismatched, found.replay.runs), (3_000, 0, 1), "{version}");
        assert_eq!((found.replay.gaps, found.replay.missing, found.replay.unconfigured), (0, 0, 0), "{version}");
        let link = found.link;
        assert_eq!((link.device_frames, link.host_frames), (device, host), "{version}");
        assert_eq!((link.broken_frames, link.missing_sequences), (0, 0), "{version}");
        assert_eq!((found.file.frames, found.file.damaged_places), (file, 0), "{version}");
    }
}

/// Fails when a field that a version had not is read from its bytes (what follows it would be another's), or when what stands in
/// its place is not what that version did: the motor as slow as it might be in version 2, reversals at once in version 3, no model of the rotor in version 4, no period of
/// pulses in version 5, no target that gives way in version 6.
#[test]
fn a_configuration_of_an_earlier_version_is_what_it_was() {
    let expected = Configuration::with_control(ConfigSpec::THESIS);
    for version in ["2", "3", "4", "5", "6"] {
        let mut decoder = Decoder::open(recording(version)).unwrap();
        let (mut set, mut in_force) = (0, 0);
        while let Some(item) = decoder.next_item().unwrap() {
            match item {
                Item::Host { message: HostMessage::Configure(configuration), .. } => {
                    assert_eq!(configuration, expected, "{version}");
                    set += 1;
                }
                Item::Device { message: DeviceMessage::Configured(configuration), .. } => {
                    assert_eq!(configuration, expected, "{version}");
                    in_force += 1;
                }
                Item::Broken { error, .. } => panic!("{version}: {error}"),
                _ => {}
            }
        }
        assert!(set == 1 && in_force >= 1, "{version}: {set}, {in_force}");
    }
}

#[test]
fn what_the_host_said_in_version_1_is_read_as_what_it_was() {
    let mut decoder = Decoder::open(recording("1")).unwrap();
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
