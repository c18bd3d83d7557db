//! Frame decoding, in both directions, and what the ends do with a message first.

use crate::sealed;
use twum_shared::driver;
use twum_shared::frame::{self, Decoder, FrameError, Header, MAX_ENCODED, Message};
use twum_shared::message::{DeviceMessage, HostMessage};
use twum_shared::step::{self, Config, Inputs, State};

/// The first byte chooses: a raw stream, or one message in a sealed frame; to the board, or from it.
pub fn frames(data: &[u8]) {
    let Some((choice, rest)) = data.split_first() else { return };
    match choice & 3 {
        0 => stream::<HostMessage>(rest, use_by_board),
        1 => stream::<DeviceMessage>(rest, |_| {}),
        2 => one::<HostMessage>(rest, use_by_board),
        _ => one::<DeviceMessage>(rest, |_| {}),
    }
}

fn stream<M: Message + Clone + PartialEq + std::fmt::Debug>(bytes: &[u8], mut then: impl FnMut(&M)) {
    let mut decoder = Decoder::new();
    let separators = bytes.iter().filter(|byte| **byte == 0).count();
    let mut results = 0;
    for byte in bytes {
        if let Some(result) = decoder.push::<M>(*byte) {
            results += 1;
            if let Ok((header, message)) = result {
                round_trip(header, &message);
                then(&message);
            }
        }
    }
    assert!(results <= separators, "a separator ends at most one frame");
    // Whatever came before: two separators later the decoder is in step again.
    let keepalive = sealed::frame(M::KIND, 7, 8, &[0]);
    let mut last = None;
    for byte in [0].iter().chain(&keepalive) {
        last = decoder.push::<M>(*byte).or(last);
    }
    if let Some(Ok((header, _))) = last {
        assert_eq!(header, Header { sequence: 7, time_us: 8 });
    } else {
        // The message of one zero byte is a host's hello; a device's hello needs more.
        assert_eq!(last.map(|result| result.err()), Some(Some(FrameError::Message)));
    }
}

fn one<M: Message + Clone + PartialEq + std::fmt::Debug>(message: &[u8], mut then: impl FnMut(&M)) {
    let mut block = sealed::frame(M::KIND, 0xA5A5_0001, u64::MAX - 1, message);
    block.pop();
    match frame::decode::<M>(&mut block) {
        Ok((header, message)) => {
            assert_eq!(header, Header { sequence: 0xA5A5_0001, time_us: u64::MAX - 1 });
            round_trip(header, &message);
            then(&message);
        }
        Err(FrameError::Message) => {}
        Err(FrameError::TooLong) => assert!(message.len() > 560, "{} bytes are no more than fit", message.len()),
        Err(other) => panic!("a sealed frame is refused as {other}"),
    }
}

/// A message that was accepted can be sent, and arrives as itself.
fn round_trip<M: Message + Clone + PartialEq + std::fmt::Debug>(header: Header, message: &M) {
    let mut buffer = [0; MAX_ENCODED];
    let line = frame::encode(header, message, &mut buffer).expect("what was decoded can be encoded").to_vec();
    let (content, separator) = line.split_at(line.len() - 1);
    assert!(separator == [0] && !content.contains(&0));
    let mut block = content.to_vec();
    assert_eq!(frame::decode::<M>(&mut block), Ok((header, message.clone())));
}

/// What the board does with a command before it takes it.
fn use_by_board(message: &HostMessage) {
    match message {
        HostMessage::Configure(configuration) => {
            let _ = configuration.limits.validate();
            let Ok(config) = Config::try_from(configuration.control) else { return };
            let mut state = State::REST;
            for (target, target_rate, position) in
                [(0, 0, 0), (1, 1, -1), (i32::MAX, i32::MIN, i32::MIN), (i32::MIN, i32::MAX, i32::MAX)]
            {
                let out =
                    step::step(&config, &mut state, Inputs { target, target_rate, position, ..Inputs::default() });
                assert!(out.on_steps <= configuration.control.duty_steps);
            }
        }
        HostMessage::Track { run, .. } => {
            let bounded = run.reference.validate().is_ok();
            for elapsed_us in [0, 1, 499_999, 1 << 20, u64::from(u32::MAX), u64::from(u32::MAX) * 16, u64::MAX] {
                let target = run.reference.at(elapsed_us);
                assert!(!bounded || target.position.unsigned_abs() <= 1 << 24, "{target:?} of {:?}", run.reference);
            }
        }
        HostMessage::Driver { line, .. } => {
            let _ = driver::parse(line);
        }
        _ => {}
    }
}
