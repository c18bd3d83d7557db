//! A board that restarts in the midst of a recording: what listens goes on and tells it, what moves ends at once.

use std::path::Path;
use std::time::Duration;
use twum_host::compare::replay::{RecordingReplay, replay_recording};
use twum_host::link::bench::{Action, Experiment, Outcome, perform};
use twum_host::link::{LinkError, Port, Session, SimulatedLink};
use twum_host::record::recording::{EventKind, Recording};
use twum_host::sim::{Disturbance, Setup};
use twum_shared::message::{CaptureMode, Configuration, ResetCause, TrackRun};
use twum_shared::reference::Reference;
use twum_shared::step::ConfigSpec;

const ALL: CaptureMode = CaptureMode { bits: true, edges: true, control: true };

/// A line on which the board restarts at a time, and every frame comes twice where that is wanted.
struct Line {
    link: SimulatedLink,
    restart_at: Duration,
    twice: bool,
    /// What came of the frame that is not at its end.
    frame: Vec<u8>,
}

impl Port for Line {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.link.send(bytes)
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        if self.link.elapsed() >= self.restart_at {
            self.restart_at = Duration::MAX;
            self.link.board().disturb(Disturbance::Reset(ResetCause::BrownOut));
        }
        let before = into.len();
        self.link.receive(into, wait)?;
        if self.twice {
            let came = into.split_off(before);
            for byte in came {
                into.push(byte);
                self.frame.push(byte);
                if byte == 0 {
                    into.append(&mut self.frame);
                }
            }
        }
        Ok(())
    }

    fn elapsed(&self) -> Duration {
        self.link.elapsed()
    }

    fn is_virtual(&self) -> bool {
        true
    }
}

fn performed(path: &Path, action: Action, restart_at: Duration, twice: bool) -> Result<Outcome, LinkError> {
    let mut session =
        Session::new(Line { link: SimulatedLink::new(Setup::default()), restart_at, twice, frame: Vec::new() });
    let experiment = Experiment {
        configuration: matches!(action, Action::Track(_)).then(|| Configuration::with_control(ConfigSpec::THESIS)),
        capture: ALL,
        action,
        recording: Some(path.to_owned()),
        motor: "simulated".to_owned(),
    };
    perform(&mut session, &experiment, None, |_| {})
}

fn sine(duration_ms: u32) -> Action {
    Action::Track(TrackRun { reference: Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 }, duration_ms })
}

fn replayed(path: &Path) -> RecordingReplay {
    replay_recording(path).unwrap()
}

#[test]
fn a_capture_goes_on_after_a_restart_which_is_told_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture.mcap");
    let outcome =
        performed(&path, Action::Watch(Duration::from_secs(10)), Duration::from_secs(4), false).expect("it listens on");
    assert_eq!(outcome.tally.restarts, 1);
    assert!(!outcome.tally.is_lossless(), "a restart is no capture without a loss");
    assert_eq!(replayed(&path).link.sessions, 2);
    let recording = Recording::load(&path).unwrap();
    let remarked = |event: &EventKind| matches!(event, EventKind::Remark(json) if json.contains("restarted"));
    assert!(recording.events.iter().any(|event| remarked(&event.kind)), "the recording marks where");
    // Seconds of the 1 kHz capture on both sides: the streams were switched on again.
    for session in [0, 1] {
        let samples: usize =
            recording.bits.iter().filter(|part| part.session == session).map(|part| part.levels.len()).sum();
        assert!(samples > 3_000, "{samples} samples in session {session}");
    }
}

#[test]
fn a_run_ends_at_once_when_the_board_restarts() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("track.mcap");
    let error = performed(&path, sine(20_000), Duration::from_secs(8), false).unwrap_err();
    assert!(matches!(error, LinkError::Restarted), "{error}");
    let replay = replayed(&path);
    assert_eq!((replay.link.sessions, replay.replay.unended, replay.replay.mismatched), (2, 1, 0));
    let recording = Recording::load(&path).unwrap();
    let last_ns = recording.events.iter().map(|event| event.host_time_ns).max().unwrap();
    assert!(last_ns < 12_000_000_000, "told {} s after it began, not at the end of the run", last_ns as f64 * 1e-9);
}

#[test]
fn frames_that_come_twice_are_dropped_and_counted_and_the_signals_are_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let (once, twice) = (folder.path().join("once.mcap"), folder.path().join("twice.mcap"));
    performed(&once, sine(2_000), Duration::MAX, false).unwrap();
    let outcome = performed(&twice, sine(2_000), Duration::MAX, true).unwrap();
    let tally = outcome.tally;
    assert_eq!((tally.restarts, tally.lost, tally.bad), (0, 0, 0));
    assert!(tally.is_lossless() && tally.duplicates >= tally.received, "{tally:?}");
    let [one, two] = [&once, &twice].map(|path| Recording::load(path).unwrap());
    assert_eq!((two.link.sessions, two.link.missing_sequences), (1, 0));
    assert!(two.link.duplicates > 300, "{:?}", two.link);
    assert_eq!(one.control, two.control);
    assert_eq!(one.edges, two.edges);
    assert_eq!(replayed(&twice).replay.checked, 4_000);
}
