//! Frames: `0x00`-separated COBS blocks of header, postcard message and CRC-32.
//!
//! Before COBS, a frame is (little endian): protocol version (1), kind (1), sequence (4), device time in µs (8, zero from
//! the host), the message in postcard, CRC-32/ISO-HDLC of all before it (4). A sender also writes a `0x00` before its first
//! frame, so that whatever stood on the line before (a boot loader's text) ends there.

use crate::message::{DeviceMessage, HostMessage};
use crc::{CRC_32_ISO_HDLC, Crc, Table};
use serde::{Serialize, de::DeserializeOwned};

/// Version of the protocol. Another version is refused at the first frame.
pub const PROTOCOL_VERSION: u8 = 7;
/// Longest frame before COBS, bytes.
pub const MAX_PLAIN: usize = 680;
/// Longest frame on the line, its separator included, bytes.
pub const MAX_ENCODED: usize = MAX_PLAIN + MAX_PLAIN / 254 + 2;

const HEADER: usize = 14;
const TRAILER: usize = 4;
/// 1 KiB of table, in flash.
static CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// A message that travels in frames of its own kind.
pub trait Message: Serialize + DeserializeOwned {
    /// Tells the two directions apart, so that an echoed frame is not taken for an answer.
    const KIND: u8;
}

impl Message for HostMessage {
    const KIND: u8 = b'H';
}

impl Message for DeviceMessage {
    const KIND: u8 = b'D';
}

/// What every frame carries beside its message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// Counts every frame meant to be sent, also those the sender had to drop.
    pub sequence: u32,
    /// Device time, µs; zero from the host.
    pub time_us: u64,
}

/// A message that does not fit a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the message does not fit a frame")]
pub struct TooLong;

/// Why the bytes between two separators are not a frame for us.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// Longer than any frame.
    #[error("longer than any frame")]
    TooLong,
    /// Not COBS, or too short for header and checksum.
    #[error("not a frame")]
    NotAFrame,
    /// The checksum does not match.
    #[error("checksum mismatch")]
    Checksum,
    /// An intact frame of another protocol version.
    #[error("protocol version {0}, not {PROTOCOL_VERSION}")]
    Version(u8),
    /// An intact frame of the other direction.
    #[error("a frame of kind {0:#04x}, which is not for this end")]
    Kind(u8),
    /// An intact frame whose message is unknown.
    #[error("an unknown message")]
    Message,
}

/// Encodes one frame, its separator included; gives the bytes written.
///
/// # Errors
/// [`TooLong`] when the message does not fit.
pub fn encode<'a, M: Message>(
    header: Header,
    message: &M,
    out: &'a mut [u8; MAX_ENCODED],
) -> Result<&'a [u8], TooLong> {
    let mut plain = [0u8; MAX_PLAIN];
    let head = plain.first_chunk_mut::<HEADER>().ok_or(TooLong)?;
    let [version, kind, rest @ ..] = head;
    (*version, *kind) = (PROTOCOL_VERSION, M::KIND);
    let (sequence, time) = rest.split_at_mut(4);
    sequence.copy_from_slice(&header.sequence.to_le_bytes());
    time.copy_from_slice(&header.time_us.to_le_bytes());
    let body = plain.get_mut(HEADER..MAX_PLAIN - TRAILER).ok_or(TooLong)?;
    let length = HEADER + postcard::to_slice(message, body).map_err(|_| TooLong)?.len();
    let (checked, rest) = plain.split_at_mut_checked(length).ok_or(TooLong)?;
    rest.first_chunk_mut::<TRAILER>().ok_or(TooLong)?.copy_from_slice(&CRC.checksum(checked).to_le_bytes());
    let whole = plain.get(..length + TRAILER).ok_or(TooLong)?;
    let encoded = cobs::try_encode(whole, out).map_err(|_| TooLong)?;
    *out.get_mut(encoded).ok_or(TooLong)? = 0;
    out.get(..=encoded).ok_or(TooLong)
}

/// An intact frame whose message has not been looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Opened<'a> {
    /// Protocol version.
    pub version: u8,
    /// [`Message::KIND`] of its message.
    pub kind: u8,
    /// What it carries beside the message.
    pub header: Header,
    /// The message in postcard.
    pub body: &'a [u8],
}

impl<'a> Opened<'a> {
    /// The message, if it is one of this type and nothing follows it.
    pub fn message<T: serde::Deserialize<'a>>(&self) -> Option<T> {
        match postcard::take_from_bytes(self.body) {
            Ok((message, [])) => Some(message),
            _ => None,
        }
    }
}

/// Opens the bytes between two separators, in place: any version, any kind.
///
/// # Errors
/// Says why the bytes are not a frame.
pub fn open(block: &mut [u8]) -> Result<Opened<'_>, FrameError> {
    if block.len() >= MAX_ENCODED {
        return Err(FrameError::TooLong);
    }
    let length = cobs::decode_in_place(block).map_err(|_| FrameError::NotAFrame)?;
    let plain = block.get(..length).ok_or(FrameError::NotAFrame)?;
    let (checked, trailer) = plain.split_last_chunk::<TRAILER>().ok_or(FrameError::NotAFrame)?;
    let (head, body) = checked.split_first_chunk::<HEADER>().ok_or(FrameError::NotAFrame)?;
    if CRC.checksum(checked) != u32::from_le_bytes(*trailer) {
        return Err(FrameError::Checksum);
    }
    let [version, kind, s0, s1, s2, s3, time @ ..] = *head;
    let header = Header { sequence: u32::from_le_bytes([s0, s1, s2, s3]), time_us: u64::from_le_bytes(time) };
    Ok(Opened { version, kind, header, body })
}

/// Decodes the bytes between two separators, in place.
///
/// # Errors
/// Says why the bytes are not a frame of this kind.
pub fn decode<M: Message>(block: &mut [u8]) -> Result<(Header, M), FrameError> {
    let opened = open(block)?;
    if opened.version != PROTOCOL_VERSION {
        return Err(FrameError::Version(opened.version));
    }
    if opened.kind != M::KIND {
        return Err(FrameError::Kind(opened.kind));
    }
    opened.message().map(|message| (opened.header, message)).ok_or(FrameError::Message)
}

/// Cuts a byte stream at its separators and decodes what lies between. Memory is bounded: what is longer than any frame is
/// dropped up to the next separator and reported once.
#[derive(Clone, Debug)]
pub struct Decoder {
    block: heapless::Vec<u8, MAX_ENCODED>,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// A decoder at the start of a stream, or anywhere in one.
    pub const fn new() -> Self {
        Self { block: heapless::Vec::new() }
    }

    /// Takes one byte; gives a frame, or the error of a broken one, at each separator that ends something.
    pub fn push<M: Message>(&mut self, byte: u8) -> Option<Result<(Header, M), FrameError>> {
        if byte != 0 {
            // A full block is too long for a frame as it is: what does not fit changes nothing.
            let _ = self.block.push(byte);
            return None;
        }
        if self.block.is_empty() {
            return None;
        }
        let result = decode(&mut self.block);
        self.block.clear();
        Some(result)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::encoder::{CountSign, Edge};
    use crate::message::*;
    use crate::reference::{Reference, WayPoint};
    use crate::safety::Limits;
    use crate::step::{ConfigSpec, Load, Reversal, Rotor, State};
    use crate::{Direction, Duty, Fault};
    use proptest::prelude::*;
    use std::vec::Vec;

    fn framed<M: Message>(sequence: u32, message: &M) -> Vec<u8> {
        let mut out = [0; MAX_ENCODED];
        encode(Header { sequence, time_us: 77 }, message, &mut out).unwrap().to_vec()
    }

    fn decoded<M: Message>(bytes: &[u8]) -> Vec<Result<(Header, M), FrameError>> {
        let mut decoder = Decoder::new();
        bytes.iter().filter_map(|&byte| decoder.push(byte)).collect()
    }

    fn widest_state() -> State {
        let reversal = Reversal { rest_left: u16::MAX, limit_left: u16::MAX, position: i32::MIN };
        let load =
            Load { pushes: i32::MIN, doubt: u16::MAX, speed_ticks: u16::MAX, place_ticks: u16::MAX, edges: u16::MAX };
        let rotor = Rotor {
            count: i32::MIN,
            place: i32::MIN,
            speed: i32::MIN,
            full_cw: i32::MIN,
            full_ccw: i32::MIN,
            braking: i32::MIN,
            on: u16::MAX,
            cw: u16::MAX,
            held: u8::MAX,
            since: u8::MAX,
            driven: i32::MIN,
            coasted: i32::MIN,
            load,
        };
        State {
            deviation: i32::MIN,
            integral: i32::MIN,
            previous_error: i32::MIN,
            direction: Direction::Cw,
            reversal,
            rotor,
        }
    }

    /// Every variant, with each collection full of its widest values.
    fn device_messages() -> Vec<DeviceMessage> {
        let sample = ControlSample {
            target: i32::MIN,
            target_rate: i32::MIN,
            position: i32::MIN,
            u: i32::MIN,
            on_steps: u16::MAX,
            direction: Direction::Ccw,
            late_us: u16::MAX,
            duration_us: u16::MAX,
            target_fraction: i8::MIN,
            edge_age_us: u16::MAX,
        };
        let edge = Edge { time_us: u32::MAX, level: true, direction: Direction::Ccw };
        let config = Configuration::with_control(ConfigSpec::DEFAULT);
        let status = Status {
            mode: Mode::Fault,
            fault: Some(Fault::RxOverrun),
            position: i32::MIN,
            duty: Duty::FULL,
            direction: Direction::Ccw,
            ticks: u64::MAX,
            late_ticks: u32::MAX,
            worst_late_us: u32::MAX,
            worst_duration_us: u32::MAX,
            edges: u32::MAX,
            lost_items: u32::MAX,
            bad_frames: u32::MAX,
        };
        let identity = Identity {
            firmware: "0123456789abcdefghijklmn".try_into().unwrap(),
            chip: "0123456789abcdef".try_into().unwrap(),
            reset: ResetCause::Watchdog,
            mode: Mode::Fault,
            fault: Some(Fault::BootFromWatchdog),
        };
        std::vec![
            DeviceMessage::Hello(identity),
            DeviceMessage::Ack { of: u32::MAX },
            DeviceMessage::Nack { of: u32::MAX, reason: Refusal::Mode(Mode::Running) },
            DeviceMessage::Configured(config),
            DeviceMessage::Aligned,
            DeviceMessage::RunStarted { start_us: u64::MAX },
            DeviceMessage::RunEnded { end: RunEnd::Fault(Fault::EncoderStall), end_us: u64::MAX },
            DeviceMessage::Bits(BitsBlock {
                first_sample: u64::MAX,
                first_us: u64::MAX,
                samples: 1024,
                words: core::iter::repeat_n(u32::MAX, BITS_WORDS).collect(),
            }),
            DeviceMessage::Edges(EdgesBlock {
                first_edge: u64::MAX,
                edges: core::iter::repeat_n(edge, BLOCK_EDGES).collect(),
            }),
            DeviceMessage::Control(ControlBlock {
                first_tick: u64::MAX,
                first_us: u64::MAX,
                state: widest_state(),
                samples: core::iter::repeat_n(sample, BLOCK_SAMPLES).collect(),
            }),
            DeviceMessage::Status(status),
            DeviceMessage::Fault(FaultReport { fault: Fault::Overspeed, off_us: u64::MAX, position: i32::MIN }),
            DeviceMessage::DriverReply(core::iter::repeat_n(0u8, 64).collect()),
            DeviceMessage::DriverDone,
            DeviceMessage::Log("x".repeat(96).as_str().try_into().unwrap()),
            DeviceMessage::Pass(Pass { token: u32::MAX, nonce: u32::MAX }),
            DeviceMessage::Losses(Losses { ticks: u32::MAX, words: u32::MAX, edges: u32::MAX, others: u32::MAX }),
        ]
    }

    fn host_messages() -> Vec<HostMessage> {
        let point = WayPoint { position: i32::MIN, duration_us: u32::MAX };
        let path = Reference::Path { start: i32::MIN, way_points: core::iter::repeat_n(point, 16).collect() };
        let pass = Pass { token: u32::MAX, nonce: u32::MAX };
        let configuration = Configuration {
            control: ConfigSpec::THESIS,
            limits: Limits::DEFAULT,
            count_sign: CountSign::Reversed,
            edges_per_rev: 400,
            pwm_hz: 50,
        };
        std::vec![
            HostMessage::Hello,
            HostMessage::Keepalive { token: u32::MAX },
            HostMessage::Configure(configuration),
            HostMessage::Align(pass),
            HostMessage::Arm { token: u32::MAX },
            HostMessage::Speed {
                pass,
                run: SpeedRun { duty: Duty::FULL, direction: Direction::Cw, duration_ms: u32::MAX },
            },
            HostMessage::Track { pass, run: TrackRun { reference: path, duration_ms: u32::MAX } },
            HostMessage::Capture(CaptureMode { bits: true, edges: true, control: true }),
            HostMessage::Driver { pass, line: "u1,ap,ADC>2100?S,x100".try_into().unwrap() },
            HostMessage::Stop { clear_fault: true },
            HostMessage::Reboot,
            HostMessage::AskPass { token: u32::MAX },
        ]
    }

    #[test]
    fn every_message_round_trips() {
        for (sequence, message) in device_messages().into_iter().enumerate() {
            let header = Header { sequence: sequence as u32, time_us: 77 };
            assert_eq!(decoded(&framed(header.sequence, &message)), [Ok((header, message))]);
        }
        for (sequence, message) in host_messages().into_iter().enumerate() {
            let header = Header { sequence: sequence as u32, time_us: 77 };
            assert_eq!(decoded(&framed(header.sequence, &message)), [Ok((header, message))]);
        }
    }

    #[test]
    fn the_checksum_is_the_standard_one() {
        assert_eq!(CRC.checksum(b"123456789"), 0xcbf4_3926);
    }

    #[test]
    fn another_version_and_the_other_direction_are_named() {
        let mut plain = std::vec![PROTOCOL_VERSION + 1, b'D', 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 9];
        plain.extend(CRC.checksum(&plain).to_le_bytes());
        let mut block = std::vec![0; cobs::max_encoding_length(plain.len()) + 1];
        let encoded = cobs::try_encode(&plain, &mut block).unwrap();
        block.truncate(encoded + 1);
        assert_eq!(decoded::<DeviceMessage>(&block), [Err(FrameError::Version(PROTOCOL_VERSION + 1))]);
        assert_eq!(
            decoded::<DeviceMessage>(&framed(1, &HostMessage::Stop { clear_fault: false })),
            [Err(FrameError::Kind(b'H'))]
        );
    }

    #[test]
    fn the_longest_frame_just_fits() {
        // COBS adds a byte to every 254 begun, and a separator ends it.
        assert_eq!(MAX_ENCODED, cobs::max_encoding_length(MAX_PLAIN) + 1);
        let mut block = std::vec![0xFF; MAX_ENCODED - 1];
        assert_ne!(decode::<DeviceMessage>(&mut block), Err(FrameError::TooLong));
        block = std::vec![0xFF; MAX_ENCODED];
        assert_eq!(decode::<DeviceMessage>(&mut block), Err(FrameError::TooLong));
    }

    #[test]
    fn boot_text_in_front_is_skipped() {
        let mut stream = b"ets Jul 29 2019 12:21:46\r\nrst:0x1 (POWERON_RESET)\r\n\0".to_vec();
        stream.extend(framed(0, &DeviceMessage::Aligned));
        let out = decoded::<DeviceMessage>(&stream);
        assert_eq!(out.iter().flatten().count(), 1);
        assert_eq!(out.last().unwrap().as_ref().unwrap().1, DeviceMessage::Aligned);
    }

    #[test]
    fn an_endless_block_costs_bounded_memory_and_one_error() {
        let mut stream = std::vec![0x55u8; if cfg!(miri) { 4 * MAX_ENCODED } else { 1 << 20 }];
        stream.push(0);
        stream.extend(framed(5, &DeviceMessage::Aligned));
        let out = decoded::<DeviceMessage>(&stream);
        assert_eq!(out.len(), 2);
        assert_eq!(out[0], Err(FrameError::TooLong));
        assert!(out[1].is_ok());
    }

    #[test]
    #[cfg_attr(miri, ignore = "too long for an interpreter: every byte is broken in a stream of its own")]
    fn a_corrupted_byte_costs_at_most_the_frames_it_touches() {
        let messages = device_messages();
        let frames: Vec<Vec<u8>> = messages.iter().enumerate().map(|(i, m)| framed(i as u32, m)).collect();
        let stream: Vec<u8> = frames.concat();
        let mut start = 0;
        for (index, frame) in frames.iter().enumerate() {
            for offset in 0..frame.len() {
                for flip in [0x01u8, 0x80, 0xff, frame[offset]] {
                    let mut broken = stream.clone();
                    broken[start + offset] ^= flip;
                    let good: Vec<u32> = decoded::<DeviceMessage>(&broken)
                        .into_iter()
                        .flatten()
                        .map(|(header, message)| {
                            assert_eq!(message, messages[header.sequence as usize], "a wrong message was accepted");
                            header.sequence
                        })
                        .collect();
                    // The separator belongs to both frames it separates.
                    let touched = if offset + 1 == frame.len() { index..=index + 1 } else { index..=index };
                    for sequence in 0..messages.len() {
                        assert!(
                            good.contains(&(sequence as u32)) || touched.contains(&sequence),
                            "byte {offset} of frame {index} flipped by {flip:#x} cost frame {sequence}"
                        );
                    }
                }
            }
            start += frame.len();
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "too long for an interpreter: every byte of the stream begins a stream of its own")]
    fn a_decoder_started_anywhere_recovers_at_the_next_frame() {
        let messages = device_messages();
        let frames: Vec<Vec<u8>> = messages.iter().enumerate().map(|(i, m)| framed(i as u32, m)).collect();
        let stream: Vec<u8> = frames.concat();
        let mut start = 0;
        for (index, frame) in frames.iter().enumerate() {
            for offset in 0..frame.len() {
                let good = decoded::<DeviceMessage>(&stream[start + offset..]).into_iter().flatten().count();
                let whole = messages.len() - index - usize::from(offset > 0);
                assert_eq!(good, whole, "started at byte {offset} of frame {index}");
            }
            start += frame.len();
        }
    }

    proptest! {
        #[test]
        fn no_bytes_panic_or_pass(bytes in proptest::collection::vec(any::<u8>(), 0..2000)) {
            prop_assert_eq!(decoded::<DeviceMessage>(&bytes).into_iter().flatten().count(), 0);
            prop_assert_eq!(decoded::<HostMessage>(&bytes).into_iter().flatten().count(), 0);
        }
    }
}
