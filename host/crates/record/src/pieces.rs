//! A recording read from beginning to end in pieces: memory does not grow with its length.

use super::decode::Decoder;
use super::recording::{BitsSegment, Builder, ControlSegment, Recording, TimedEdge};
use super::store::StoreError;
use std::io::{Read, Seek};
use twum_shared::message::Status;

/// Samples of a piece that does not end its segment.
const LENGTH: usize = 1 << 14;

/// A piece of what a board streams.
#[derive(Debug)]
pub enum Piece<'a> {
    /// Consecutive control ticks.
    Control(&'a ControlSegment),
    /// Consecutive 1 kHz samples.
    Bits(&'a BitsSegment),
    /// Consecutive edges, and the board's start.
    Edges(u32, &'a [TimedEdge]),
    /// Session, device time (µs), status.
    Status(&'a (u32, u64, Status)),
}

impl Recording {
    /// Reads a recording to its end. `take` gets what was streamed, piece by piece, and with each whether it goes on from that
    /// stream's piece before without a gap. What is given back has all the rest; of its statuses, those that tell of losses.
    ///
    /// # Errors
    /// As [`Decoder::next_item`].
    pub fn read_in_pieces<S: Read + Seek>(
        mut decoder: Decoder<S>,
        mut take: impl FnMut(Piece<'_>, bool),
    ) -> Result<Self, StoreError> {
        let mut builder = Builder::new(decoder.metadata().clone());
        let mut pieces = Pieces::default();
        while let Some(item) = decoder.next_item()? {
            builder.add(item);
            pieces.hand_out(&mut builder.recording, LENGTH, &mut take);
        }
        pieces.hand_out(&mut builder.recording, 1, &mut take);
        let mut recording = builder.recording;
        recording.control.clear();
        recording.bits.clear();
        recording.edges.clear();
        recording.status = pieces.losing;
        recording.integrity = decoder.integrity();
        recording.link = decoder.statistics();
        Ok(recording)
    }
}

/// Which first segments were handed out in part, and so go on.
#[derive(Default)]
struct Pieces {
    control: bool,
    bits: bool,
    edges: bool,
    losing: Vec<(u32, u64, Status)>,
}

impl Pieces {
    /// Hands out every segment that has ended, and what has `length` of those that go on.
    fn hand_out(&mut self, recording: &mut Recording, length: usize, take: &mut impl FnMut(Piece<'_>, bool)) {
        self.control(&mut recording.control, length, take);
        self.bits(&mut recording.bits, length, take);
        self.edges(recording, length, take);
        for status in recording.status.drain(..) {
            take(Piece::Status(&status), true);
            if status.2.lost_items > self.losing.last().map_or(0, |(_, _, before)| before.lost_items) {
                self.losing.push(status);
            }
        }
    }

    fn control(&mut self, segments: &mut Vec<ControlSegment>, length: usize, take: &mut impl FnMut(Piece<'_>, bool)) {
        while let Some(ended) = ended(segments, length, |segment| segment.samples.len()) {
            let segment = &mut segments[0];
            if !segment.samples.is_empty() {
                take(Piece::Control(segment), std::mem::replace(&mut self.control, true));
            }
            let count = segment.samples.len();
            segment.first_us = segment.time_us(count);
            segment.first_tick = segment.first_tick.wrapping_add(count as u64);
            segment.samples.clear();
            if !ended {
                return;
            }
            segments.remove(0);
            self.control = false;
        }
    }

    fn bits(&mut self, segments: &mut Vec<BitsSegment>, length: usize, take: &mut impl FnMut(Piece<'_>, bool)) {
        while let Some(ended) = ended(segments, length, |segment| segment.levels.len()) {
            let segment = &mut segments[0];
            if !segment.levels.is_empty() {
                take(Piece::Bits(segment), std::mem::replace(&mut self.bits, true));
            }
            let count = segment.levels.len() as u64;
            segment.first_us = segment.first_us.saturating_add(1_000 * count);
            segment.first_sample = segment.first_sample.wrapping_add(count);
            segment.levels.clear();
            if !ended {
                return;
            }
            segments.remove(0);
            self.bits = false;
        }
    }

    fn edges(&mut self, recording: &mut Recording, length: usize, take: &mut impl FnMut(Piece<'_>, bool)) {
        let segments = &mut recording.edges;
        while let Some(ended) = ended(segments, length + usize::from(self.edges), |segment| segment.edges.len()) {
            let segment = &mut segments[0];
            // The last edge of a piece stays: the next is held against its level.
            let known = usize::from(self.edges);
            let fresh = segment.edges.get(known..).unwrap_or_default();
            if !fresh.is_empty() {
                take(Piece::Edges(segment.session, fresh), std::mem::replace(&mut self.edges, true));
            }
            let all_but_one = segment.edges.len().saturating_sub(1);
            segment.first_edge = segment.first_edge.wrapping_add(all_but_one as u64);
            segment.edges.drain(..all_but_one);
            if !ended {
                return;
            }
            segments.remove(0);
            self.edges = false;
        }
    }
}

/// Whether the first segment is to be handed out, and whether it has ended then.
fn ended<T>(segments: &[T], length: usize, of: impl Fn(&T) -> usize) -> Option<bool> {
    match segments {
        [] => None,
        [only] => (of(only) >= length).then_some(false),
        _ => Some(true),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{Line, configured, control_blocks};
    use twum_shared::message::DeviceMessage;
    use twum_shared::step::ConfigSpec;

    #[test]
    fn the_pieces_together_are_the_recording() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mcap");
        let mut line = Line::new(&path);
        line.device(configured(ConfigSpec::THESIS));
        for (index, block) in control_blocks(ConfigSpec::THESIS, 1000, 3_000).into_iter().enumerate() {
            line.now_us = block.first_us + 8_000;
            let message = DeviceMessage::Control(block);
            if (2_000..2_010).contains(&index) { line.lost(message) } else { line.device(message) }
        }
        line.finish();
        let whole = Recording::load(&path).unwrap();
        let (mut control, mut longest): (Vec<ControlSegment>, usize) = (Vec::new(), 0);
        let rest = Recording::read_in_pieces(Decoder::open(&path).unwrap(), |piece, goes_on| {
            let Piece::Control(piece) = piece else { return };
            longest = longest.max(piece.samples.len());
            match control.last_mut().filter(|_| goes_on) {
                Some(segment) => segment.samples.extend_from_slice(&piece.samples),
                None => control.push(piece.clone()),
            }
        })
        .unwrap();
        assert_eq!(control, whole.control);
        assert!(control.len() == 2 && longest <= LENGTH + 16, "{} segments, {longest} ticks", control.len());
        assert_eq!((rest.sessions, rest.runs, rest.events), (whole.sessions, whole.runs, whole.events));
    }
}
