//! A link that flips, drops, doubles, inserts and reorders: no wrong message passes, every loss is counted.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Duration;
use twum_host::link::{LinkError, Port, Session, Tally};
use twum_shared::Direction;
use twum_shared::encoder::Edge;
use twum_shared::frame::{self, Header, MAX_ENCODED};
use twum_shared::message::{BitsBlock, DeviceMessage, EdgesBlock, RunEnd};

/// What is done to the bytes.
#[derive(Clone, Copy, Debug)]
enum Harm {
    /// Each bit flips with this probability.
    Flip(f64),
    /// Each byte is lost with this probability.
    Drop(f64),
    /// Each byte comes twice with this probability.
    Double(f64),
    /// A random byte is put in front of each with this probability.
    Insert(f64),
    /// Each byte changes places with the next with this probability.
    Swap(f64),
    /// A frame is cut in half with this probability.
    Halve(f64),
}

/// The message with a sequence is known from the sequence, so that a wrong one is seen.
fn message(sequence: u32) -> DeviceMessage {
    match sequence % 4 {
        0 => DeviceMessage::Ack { of: sequence },
        1 => DeviceMessage::Edges(EdgesBlock {
            first_edge: u64::from(sequence),
            edges: (0..sequence % 20)
                .map(|edge| Edge {
                    time_us: sequence.wrapping_mul(edge),
                    level: edge % 2 == 0,
                    direction: Direction::Cw,
                })
                .collect(),
        }),
        2 => DeviceMessage::RunEnded { end: RunEnd::Completed, end_us: u64::from(sequence) << 20 },
        _ => DeviceMessage::Bits(BitsBlock {
            first_sample: u64::from(sequence),
            first_us: 0,
            samples: 256,
            words: (0..8).map(|word| sequence.rotate_left(word)).collect(),
        }),
    }
}

/// A device that sends as fast as it is read, through a harmful line. After `frames` frames it sends a last one unharmed.
struct HarmfulPort {
    rng: ChaCha8Rng,
    harm: Harm,
    first: u32,
    sent: u32,
    frames: u32,
    elapsed_us: u64,
    longest_buffer: usize,
}

impl HarmfulPort {
    fn harm(&mut self, bytes: &[u8], into: &mut Vec<u8>) {
        let start = into.len();
        for &byte in bytes {
            match self.harm {
                Harm::Flip(p) => {
                    let mut flipped = byte;
                    for bit in 0..8 {
                        if self.rng.random_bool(p) {
                            flipped ^= 1 << bit;
                        }
                    }
                    into.push(flipped);
                }
                Harm::Drop(p) => {
                    if !self.rng.random_bool(p) {
                        into.push(byte);
                    }
                }
                Harm::Double(p) => {
                    into.push(byte);
                    if self.rng.random_bool(p) {
                        into.push(byte);
                    }
                }
                Harm::Insert(p) => {
                    if self.rng.random_bool(p) {
                        into.push(self.rng.random());
                    }
                    into.push(byte);
                }
                Harm::Swap(_) | Harm::Halve(_) => into.push(byte),
            }
        }
        match self.harm {
            Harm::Swap(p) => {
                for at in start..into.len().saturating_sub(1) {
                    if self.rng.random_bool(p) {
                        into.swap(at, at + 1);
                    }
                }
            }
            Harm::Halve(p) if self.rng.random_bool(p) => into.truncate(start + bytes.len() / 2),
            _ => {}
        }
    }
}

impl Port for HarmfulPort {
    fn send(&mut self, _: &[u8]) -> Result<(), LinkError> {
        Ok(())
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        self.longest_buffer = self.longest_buffer.max(into.capacity());
        self.elapsed_us += 1_000.min(wait.as_micros() as u64);
        for _ in 0..16 {
            if self.sent > self.frames {
                self.elapsed_us += wait.as_micros() as u64;
                return Ok(());
            }
            let sequence = self.first.wrapping_add(self.sent);
            let mut buffer = [0; MAX_ENCODED];
            let bytes =
                frame::encode(Header { sequence, time_us: 0 }, &message(sequence), &mut buffer).unwrap().to_vec();
            if self.sent == self.frames {
                into.push(0);
                into.extend(bytes);
            } else {
                self.harm(&bytes, into);
            }
            self.sent += 1;
        }
        Ok(())
    }

    fn elapsed(&self) -> Duration {
        Duration::from_micros(self.elapsed_us)
    }

    fn is_virtual(&self) -> bool {
        true
    }
}

/// Sends `frames` frames through the harm and checks every one that is accepted.
fn survive(harm: Harm, frames: u32, first: u32, seed: u64) -> Tally {
    let rng = ChaCha8Rng::seed_from_u64(seed);
    let port = HarmfulPort { rng, harm, first, sent: 0, frames, elapsed_us: 0, longest_buffer: 0 };
    let mut session = Session::new(port);
    let mut last = None;
    // The first frame may be lost; the count then starts with the first that comes.
    let mut lost_before = None;
    loop {
        match session.next(Duration::from_millis(10)) {
            Ok(Some(received)) => {
                let sequence = received.header.sequence;
                assert_eq!(received.message, message(sequence), "{harm:?}: a wrong message was accepted");
                lost_before.get_or_insert(sequence.wrapping_sub(first));
                last = Some(sequence);
            }
            Ok(None) if session.port().sent > frames => break,
            // Nothing got through for a while: at 1e-2 most frames are harmed.
            Ok(None) => {}
            Err(error) => panic!("{harm:?}: {error}"),
        }
    }
    assert_eq!(last, Some(first.wrapping_add(frames)), "{harm:?}: an unharmed frame is received");
    let tally = session.tally();
    let accounted = tally.received + tally.lost + u64::from(lost_before.unwrap_or(0));
    assert_eq!(accounted, u64::from(frames) + 1, "{harm:?}: sent = received + lost, {tally:?}");
    assert_eq!(tally.restarts, 0, "{harm:?}");
    assert!(session.port().longest_buffer < 1 << 16, "{harm:?}: memory is bounded");
    tally
}

fn harms() -> impl Iterator<Item = Harm> {
    [1e-6, 1e-5, 1e-4, 1e-3, 1e-2]
        .into_iter()
        .flat_map(|p| [Harm::Flip(p), Harm::Drop(p), Harm::Double(p), Harm::Insert(p), Harm::Swap(p), Harm::Halve(p)])
}

#[test]
fn every_loss_is_counted_and_no_wrong_message_passes() {
    for (seed, harm) in harms().enumerate() {
        let tally = survive(harm, 3_000, 0, seed as u64);
        println!("{harm:?}: {tally:?}");
    }
}

#[test]
fn an_isolated_harm_costs_at_most_the_frames_it_touches() {
    // Harms this rare stand alone: none may cost more than the two frames beside a separator.
    for (seed, harm) in
        [Harm::Flip(1e-6), Harm::Drop(1e-5), Harm::Insert(1e-5), Harm::Swap(1e-5)].into_iter().enumerate()
    {
        let tally = survive(harm, 20_000, 0, 100 + seed as u64);
        assert!(tally.longest_gap <= 2, "{harm:?}: {tally:?}");
        assert!(tally.lost > 0, "{harm:?} must have harmed something: {tally:?}");
    }
}

#[test]
fn the_sequence_wraps_without_a_loss() {
    let tally = survive(Harm::Flip(0.0), 1_000, u32::MAX - 500, 1);
    assert_eq!((tally.received, tally.lost), (1_001, 0));
}

/// Ten million frames; minutes. `cargo test --release -p twum-tests --test board -- --ignored --nocapture ten_million`
#[test]
#[ignore = "minutes; docs/reliability.md gives the command"]
fn ten_million_frames() {
    let mut total = Tally::default();
    for (seed, harm) in harms().enumerate() {
        let tally = survive(harm, 340_000, u32::MAX - 100_000, 1_000 + seed as u64);
        println!(
            "{harm:?}: received {} lost {} bad {} longest gap {}",
            tally.received, tally.lost, tally.bad, tally.longest_gap
        );
        total.received += tally.received;
        total.lost += tally.lost;
        total.bad += tally.bad;
    }
    println!("total: received {} lost {} bad {}, wrong 0", total.received, total.lost, total.bad);
}
