//! The bit-for-bit check of a recording: every control tick recomputed with [`twum_shared::step::step`].

use crate::record::decode::{Decoder, Item, LinkStatistics};
use crate::record::store::{Integrity, StoreError};
use serde::Serialize;
use std::path::Path;
use twum_shared::message::{ControlBlock, ControlSample, DeviceMessage};
use twum_shared::step::{self, Config, Inputs, State};

/// What one tick should have been and was.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Mismatch {
    /// Tick of its run.
    pub tick: u64,
    /// Device time at which it was due, µs.
    pub time_us: u64,
    /// What differs.
    pub field: Field,
    /// What the fixed-point step gives.
    pub expected: i64,
    /// What was recorded.
    pub recorded: i64,
}

/// A field of a control tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Field {
    /// The control signal, Q16.16 duty steps.
    ControlSignal,
    /// Steps with the drive on.
    OnSteps,
    /// Direction, +1 or -1.
    Direction,
    /// The integral at the start of a block, count·ticks.
    Integral,
    /// The error before a block, counts.
    PreviousError,
}

/// What the check found.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ReplayReport {
    /// Ticks recomputed.
    pub checked: u64,
    /// Ticks that differ.
    pub mismatched: u64,
    /// The first few, in order.
    pub first: Vec<Mismatch>,
    /// Runs seen.
    pub runs: u64,
    /// Places where ticks are missing.
    pub gaps: u64,
    /// Ticks missing there.
    pub missing: u64,
    /// Ticks that could not be checked because no valid configuration came before them.
    pub unconfigured: u64,
}

impl ReplayReport {
    /// Whether something was checked and all of it matches.
    pub fn is_exact(&self) -> bool {
        self.checked > 0 && self.mismatched == 0 && self.unconfigured == 0
    }
}

/// What the check of a recording found, and in what state the recording is.
#[derive(Clone, Debug, Serialize)]
pub struct RecordingReplay {
    /// The control ticks.
    #[serde(flatten)]
    pub replay: ReplayReport,
    /// What the line did.
    pub link: LinkStatistics,
    /// The state of the file.
    pub file: Integrity,
}

/// Checks a recording from beginning to end. Memory is bounded by one frame.
///
/// # Errors
/// As [`Decoder::open`] and [`Decoder::next_item`].
pub fn replay_recording(path: impl AsRef<Path>) -> Result<RecordingReplay, StoreError> {
    let mut decoder = Decoder::open(path)?;
    let mut replay = Replay::new();
    while let Some(item) = decoder.next_item()? {
        if let Item::Device { message, .. } = item {
            replay.observe(&message);
        }
    }
    Ok(RecordingReplay { replay: replay.report, link: decoder.statistics(), file: decoder.integrity() })
}

/// At most so many mismatches are kept.
const KEPT: usize = 10;

/// Checks a stream of device messages, in their order.
#[derive(Debug, Default)]
pub struct Replay {
    config: Option<Config>,
    /// Where the block before ended: its next tick, and the state it left.
    reached: Option<(u64, State)>,
    report: ReplayReport,
}

impl Replay {
    /// Nothing seen yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes one message; those without control ticks or configuration pass by.
    pub fn observe(&mut self, message: &DeviceMessage) {
        match message {
            DeviceMessage::Configured(configuration) => self.config = Config::try_from(configuration.control).ok(),
            DeviceMessage::RunStarted { .. } => self.reached = None,
            DeviceMessage::Control(block) => self.check(block),
            _ => {}
        }
    }

    /// What was found so far.
    pub fn report(&self) -> &ReplayReport {
        &self.report
    }

    fn check(&mut self, block: &ControlBlock) {
        let Some(config) = self.config else {
            self.report.unconfigured += block.samples.len() as u64;
            return;
        };
        let next = self.reached.map_or(0, |(tick, _)| tick);
        if block.first_tick == 0 {
            self.report.runs += 1;
        } else if block.first_tick != next {
            self.report.gaps += 1;
            self.report.missing = self.report.missing.saturating_add(block.first_tick.saturating_sub(next));
        } else if let Some((tick, state)) = self.reached {
            self.compare_state(tick, block, state);
        }
        let mut state = block.state;
        for (index, sample) in block.samples.iter().enumerate() {
            let tick = block.first_tick.wrapping_add(index as u64);
            let time_us = block.first_us.wrapping_add(index as u64 * u64::from(config.spec().period_us));
            self.compare(&config, &mut state, tick, time_us, sample);
        }
        self.reached = Some((block.first_tick.wrapping_add(block.samples.len() as u64), state));
    }

    fn compare(&mut self, config: &Config, state: &mut State, tick: u64, time_us: u64, sample: &ControlSample) {
        let ControlSample { target, target_rate, position, .. } = *sample;
        let ours = step::step(config, state, Inputs { target, target_rate, position });
        self.report.checked += 1;
        let pairs = [
            (Field::ControlSignal, i64::from(ours.u), i64::from(sample.u)),
            (Field::OnSteps, i64::from(ours.on_steps), i64::from(sample.on_steps)),
            (Field::Direction, i64::from(ours.direction.sign()), i64::from(sample.direction.sign())),
        ];
        self.note(tick, time_us, &pairs);
    }

    /// The state a block starts with has to be the one the block before left.
    fn compare_state(&mut self, tick: u64, block: &ControlBlock, state: State) {
        let pairs = [
            (Field::Integral, i64::from(state.integral), i64::from(block.state.integral)),
            (Field::PreviousError, i64::from(state.previous_error), i64::from(block.state.previous_error)),
        ];
        self.note(tick, block.first_us, &pairs);
    }

    fn note(&mut self, tick: u64, time_us: u64, pairs: &[(Field, i64, i64)]) {
        if let Some(&(field, expected, recorded)) = pairs.iter().find(|(_, expected, recorded)| expected != recorded) {
            self.report.mismatched += 1;
            if self.report.first.len() < KEPT {
                self.report.first.push(Mismatch { tick, time_us, field, expected, recorded });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use twum_shared::message::Configuration;
    use twum_shared::step::ConfigSpec;

    /// A run of three blocks, as a device sends it.
    fn blocks() -> Vec<ControlBlock> {
        let config = Config::try_from(ConfigSpec::THESIS).unwrap();
        let mut state = State::REST;
        (0..3u64)
            .map(|index| {
                let before = state;
                let samples = (0..16)
                    .map(|sample| {
                        let target = (index * 16 + sample) as i32;
                        let out = step::step(&config, &mut state, Inputs { target, target_rate: 0, position: 0 });
                        ControlSample {
                            target,
                            target_rate: 0,
                            position: 0,
                            u: out.u,
                            on_steps: out.on_steps,
                            direction: out.direction,
                            late_us: 0,
                            duration_us: 0,
                        }
                    })
                    .collect();
                ControlBlock { first_tick: index * 16, first_us: index * 8_000, state: before, samples }
            })
            .collect()
    }

    fn replay(blocks: &[ControlBlock]) -> ReplayReport {
        let mut replay = Replay::new();
        replay.observe(&DeviceMessage::Configured(Configuration::with_control(ConfigSpec::THESIS)));
        replay.observe(&DeviceMessage::RunStarted { start_us: 0 });
        for block in blocks {
            replay.observe(&DeviceMessage::Control(block.clone()));
        }
        replay.report().clone()
    }

    #[test]
    fn an_untouched_run_is_exact() {
        let report = replay(&blocks());
        assert!(report.is_exact());
        assert_eq!((report.checked, report.runs, report.gaps), (48, 1, 0));
    }

    #[test]
    fn one_flipped_bit_is_named() {
        let mut blocks = blocks();
        blocks[1].samples[3].u ^= 1;
        let report = replay(&blocks);
        assert_eq!(report.mismatched, 1);
        assert_eq!((report.first[0].tick, report.first[0].field), (19, Field::ControlSignal));
    }

    #[test]
    fn a_changed_state_shows_where_the_block_starts() {
        let mut blocks = blocks();
        blocks[2].state.integral += 1;
        let report = replay(&blocks);
        assert_eq!((report.first[0].tick, report.first[0].field), (32, Field::Integral));
    }

    #[test]
    fn a_lost_block_is_a_gap_and_the_rest_still_checks() {
        let mut blocks = blocks();
        blocks.remove(1);
        let report = replay(&blocks);
        assert!(report.is_exact());
        assert_eq!((report.checked, report.gaps, report.missing), (32, 1, 16));
    }

    #[test]
    fn without_a_configuration_nothing_is_claimed() {
        let mut replay = Replay::new();
        replay.observe(&DeviceMessage::Control(blocks()[0].clone()));
        assert!(!replay.report().is_exact());
        assert_eq!(replay.report().unconfigured, 16);
    }
}
