//! The host's end of the link: other versions, boot text, refusals, a cable that is pulled.

use crate::bench::{default_configuration, speed};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::time::Duration;
use twum_host::link::bench::{Action, Experiment, perform};
use twum_host::link::{LinkError, Port, Session, SimulatedLink};
use twum_host::record::store::{Entry, Reader};
use twum_host::sim::Setup;
use twum_shared::frame::{self, Decoder, Header, MAX_ENCODED};
use twum_shared::message::{CaptureMode, DeviceMessage, HostMessage, Refusal, RunEnd};
use twum_shared::{Direction, Duty, Fault};

/// Answers every read with the next of its lines.
struct Script(VecDeque<Vec<u8>>, Duration);

impl Port for Script {
    fn send(&mut self, _: &[u8]) -> Result<(), LinkError> {
        Ok(())
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        self.1 += wait.max(Duration::from_millis(1));
        into.extend(self.0.pop_front().unwrap_or_default());
        Ok(())
    }

    fn elapsed(&self) -> Duration {
        self.1
    }

    fn is_virtual(&self) -> bool {
        true
    }
}

#[test]
fn a_device_of_another_protocol_version_is_named() {
    // A frame of version 9, kind D: header, one byte, CRC-32 (computed bit by bit, not with the project's own code).
    let mut plain = vec![9, b'D', 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1];
    plain.extend(crc32(&plain).to_le_bytes());
    let mut line = vec![0];
    line.extend(cobs(&plain));
    line.push(0);
    let error = Session::new(Script([line].into(), Duration::ZERO)).hello().unwrap_err();
    assert!(matches!(error, LinkError::Version(9)), "{error}");
    assert!(error.to_string().contains("flash the firmware"), "{error}");
}

fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = u32::MAX;
    for byte in bytes {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = (crc >> 1) ^ (0xEDB8_8320 & (0u32.wrapping_sub(crc & 1)));
        }
    }
    !crc
}

fn cobs(plain: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    for piece in plain.split(|byte| *byte == 0) {
        out.push(piece.len() as u8 + 1);
        out.extend(piece);
    }
    out
}

#[test]
fn silence_ends_in_a_sentence_that_says_what_to_do() {
    let error = Session::new(Script(VecDeque::new(), Duration::ZERO)).hello().unwrap_err();
    assert!(error.to_string().contains("no answer within 3000 ms"), "{error}");
}

#[test]
fn boot_text_is_counted_apart_from_loss() {
    let mut session = Session::new(SimulatedLink::new(Setup::default()));
    session.hello().unwrap();
    let tally = session.tally();
    assert!(tally.is_lossless());
    let text = b"ets Jul 29 2019 12:21:46\r\nrst:0x1 (POWERON_RESET),boot:0x13\r\n\0".to_vec();
    let mut session = Session::new(Script([text].into(), Duration::ZERO));
    assert_eq!(session.next(Duration::from_millis(10)).unwrap(), None);
    assert_eq!((session.tally().text, session.tally().bad), (1, 0));
}

/// A cable to a board that is pulled at some time.
struct Cable {
    board: Rc<RefCell<SimulatedLink>>,
    pulled_at: Duration,
}

impl Cable {
    fn plugged(&self) -> Result<(), LinkError> {
        if self.elapsed() < self.pulled_at {
            return Ok(());
        }
        Err(LinkError::Lost { port: "cable".to_owned(), reason: "pulled".to_owned() })
    }
}

impl Port for Cable {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.plugged()?;
        self.board.borrow_mut().send(bytes)
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        self.plugged()?;
        self.board.borrow_mut().receive(into, wait)
    }

    fn elapsed(&self) -> Duration {
        self.board.borrow().elapsed()
    }

    fn is_virtual(&self) -> bool {
        true
    }
}

#[test]
fn a_cable_that_does_not_come_back_is_waited_for_a_minute_and_no_longer() {
    let board = Rc::new(RefCell::new(SimulatedLink::new(Setup::default())));
    let mut session = Session::new(Cable { board: board.clone(), pulled_at: Duration::from_secs(3) });
    let experiment = Experiment {
        configuration: Some(default_configuration()),
        capture: CaptureMode::default(),
        action: Action::Speed(speed(Duty::from_ratio(1, 2), Direction::Cw, 5_000)),
        recording: None,
        motor: String::new(),
    };
    let mut asked = 0;
    let mut reopen = || {
        asked += 1;
        board.borrow_mut().board().run_for(10_000_000);
        Err(LinkError::Lost { port: "cable".to_owned(), reason: "still gone".to_owned() })
    };
    let ended = perform(&mut session, &experiment, Some(&mut reopen), |_| {});
    assert!(matches!(ended, Err(LinkError::Lost { .. })), "{:?}", ended.map(|outcome| outcome.tally));
    assert!((5..=10).contains(&asked), "asked every ten seconds for {asked} times");
}

#[test]
fn a_pulled_cable_leaves_the_motor_off_and_the_recording_goes_on_with_its_gap_marked() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("pulled.mcap");
    let board = Rc::new(RefCell::new(SimulatedLink::new(Setup::default())));
    let mut session = Session::new(Cable { board: board.clone(), pulled_at: Duration::from_secs(3) });
    let experiment = Experiment {
        configuration: Some(default_configuration()),
        capture: CaptureMode { bits: true, edges: true, control: false },
        action: Action::Speed(speed(Duty::from_ratio(1, 2), Direction::Cw, 60_000)),
        recording: Some(recording.clone()),
        motor: String::new(),
    };
    let mut reopen = || {
        // Two seconds pass before the cable is back.
        board.borrow_mut().board().run_for(2_000_000);
        assert!(board.borrow_mut().board().output_is_off(), "the command timeout has stopped the motor");
        Ok(Cable { board: board.clone(), pulled_at: Duration::MAX })
    };
    let outcome = perform(&mut session, &experiment, Some(&mut reopen), |_| {}).unwrap();
    assert_eq!(outcome.run.map(|run| run.end), Some(RunEnd::Fault(Fault::CommandTimeout)));
    assert_eq!(outcome.tally.reconnects, 1);
    assert!(!outcome.tally.is_lossless());

    let mut reader = Reader::open(&recording).unwrap();
    let (mut remarks, mut before, mut after, mut last_ns) = (Vec::new(), 0, 0, 0);
    while let Some(entry) = reader.next_entry().unwrap() {
        match entry {
            Entry::Remark { json, .. } => remarks.push(json.to_owned()),
            Entry::Frame { host_time_ns, .. } => {
                assert!(host_time_ns >= last_ns, "host time never goes back");
                last_ns = host_time_ns;
                *(if remarks.is_empty() { &mut before } else { &mut after }) += 1;
            }
        }
    }
    assert_eq!(remarks.len(), 3, "{remarks:?}");
    assert!(remarks[0].contains("lost") && remarks[1].contains("reconnected"), "{remarks:?}");
    assert!(remarks[2].contains("cut short: fault CommandTimeout"), "{remarks:?}");
    assert!(before > 50 && after > 3, "{before} frames before, {after} after");
}

/// A board that is busy until some time, as one that writes its flash.
struct BusyBoard {
    busy_until: Duration,
    now: Duration,
    decoder: Decoder,
    answers: Vec<u8>,
    asked: u32,
}

impl Port for BusyBoard {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        for byte in bytes {
            if let Some(Ok((header, HostMessage::Configure(_)))) = self.decoder.push::<HostMessage>(*byte) {
                let of = header.sequence;
                let answer = if self.now < self.busy_until {
                    DeviceMessage::Nack { of, reason: Refusal::Busy }
                } else {
                    DeviceMessage::Ack { of }
                };
                let header = Header { sequence: self.asked, time_us: 0 };
                self.answers.extend(frame::encode(header, &answer, &mut [0; MAX_ENCODED]).unwrap());
                self.asked += 1;
            }
        }
        Ok(())
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        if self.answers.is_empty() {
            self.now += wait.max(Duration::from_millis(1));
        }
        into.append(&mut self.answers);
        Ok(())
    }

    fn elapsed(&self) -> Duration {
        self.now
    }

    fn is_virtual(&self) -> bool {
        true
    }
}

#[test]
fn a_busy_board_is_asked_again_and_not_for_ever() {
    let board = |busy_until| {
        let (now, decoder, answers) = (Duration::ZERO, Decoder::new(), Vec::new());
        Session::new(BusyBoard { busy_until, now, decoder, answers, asked: 0 })
    };
    board(Duration::from_millis(400)).configure(default_configuration()).unwrap();
    let error = board(Duration::MAX).configure(default_configuration()).unwrap_err();
    assert!(matches!(error, LinkError::Refused { reason: Refusal::Busy, .. }), "{error}");
}
