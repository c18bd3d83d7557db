//! The bit-for-bit check of a recording: every control tick recomputed with [`twum_shared::step::step`].

use crate::record::decode::{Decoder, Item, LinkStatistics};
use crate::record::store::{Integrity, StoreError};
use serde::Serialize;
use std::path::Path;
use twum_shared::message::{ControlBlock, ControlSample, DeviceMessage, HostMessage};
use twum_shared::step::{self, Config, State};

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
    /// Where a model of the rotor believes it to be at the start of a block, 2^-20 count past its own.
    Place,
    /// The speed it believes, 2^-20 count a tick.
    Speed,
    /// Its speed at full drive, of either direction.
    FullSpeed,
    /// Its braking.
    Braking,
    /// The load on it that a target gives way to, and its variance.
    Load,
    /// How far a target that gives way is off its path, 2^-20 count.
    Deviation,
}

/// What a target that gives way to a load did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Guided {
    /// Ticks under a controller whose target may give way.
    pub ticks: u64,
    /// Of these, ticks in which a load was believed; in the others the target went back to its path.
    pub believed: u64,
    /// Farthest that it was off its path, counts.
    pub farthest_counts: u32,
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
    /// Runs whose end is not in the recording: the board restarted, or the recorder was stopped.
    pub unended: u64,
    /// Samples of the 1 kHz capture missing between those recorded.
    pub missing_bits: u64,
    /// Encoder edges missing between those recorded.
    pub missing_edges: u64,
    /// Of controllers whose target may give way.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub guided: Option<Guided>,
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
    let mut board = 0;
    while let Some(item) = decoder.next_item()? {
        match item {
            Item::Device { session, message, .. } => {
                if session != board {
                    board = session;
                    replay.restarted();
                }
                replay.observe(&message);
            }
            Item::Host { message, .. } => replay.commanded(&message),
            _ => {}
        }
    }
    Ok(RecordingReplay { replay: replay.finish(), link: decoder.statistics(), file: decoder.integrity() })
}

/// At most so many mismatches are kept.
const KEPT: usize = 10;

/// Checks a stream of device messages, in their order.
#[derive(Debug, Default)]
pub struct Replay {
    config: Option<Config>,
    /// Where the block before ended: its next tick, and the state it left.
    reached: Option<(u64, State)>,
    run: Option<Run>,
    /// What the host asked for last: the control stream, a closed loop.
    streams_control: bool,
    tracks: bool,
    next_bit: u64,
    next_edge: u64,
    report: ReplayReport,
}

/// The run under way, as its beginning and end tell it.
#[derive(Debug)]
struct Run {
    start_us: u64,
    end_us: Option<u64>,
    /// Whether its ticks are to be in the recording.
    has_ticks: bool,
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
            DeviceMessage::RunStarted { start_us } => {
                self.close_run();
                let has_ticks = self.tracks && self.streams_control;
                self.run = Some(Run { start_us: *start_us, end_us: None, has_ticks });
            }
            DeviceMessage::RunEnded { end_us, .. } => {
                if let Some(run) = &mut self.run {
                    run.end_us.get_or_insert(*end_us);
                }
            }
            DeviceMessage::Control(block) => self.check(block),
            DeviceMessage::Bits(block) => {
                self.report.missing_bits += follow(&mut self.next_bit, block.first_sample, block.samples.into());
            }
            DeviceMessage::Edges(block) => {
                self.report.missing_edges += follow(&mut self.next_edge, block.first_edge, block.edges.len() as u64);
            }
            _ => {}
        }
    }

    /// Takes a command of the host: which streams and runs it asked for.
    pub fn commanded(&mut self, message: &HostMessage) {
        match message {
            // What is switched on counts from 0 again.
            HostMessage::Capture(mode) => self.streams_control = mode.control,
            HostMessage::Track { .. } => self.tracks = true,
            HostMessage::Speed { .. } => self.tracks = false,
            _ => {}
        }
    }

    /// The board has restarted: its runs are over, its streams off, its configuration is to be told again.
    pub fn restarted(&mut self) {
        self.close_run();
        (self.config, self.streams_control, self.next_bit, self.next_edge) = (None, false, 0, 0);
    }

    /// What was found so far.
    pub fn report(&self) -> &ReplayReport {
        &self.report
    }

    /// What was found, the end of the last run included.
    pub fn finish(mut self) -> ReplayReport {
        self.close_run();
        self.report
    }

    /// A run's last ticks may be missing too: how many there were, its times tell.
    fn close_run(&mut self) {
        let reached = self.reached.take().map(|(tick, _)| tick);
        let Some(run) = self.run.take() else { return };
        let Some(end_us) = run.end_us else {
            self.report.unended += 1;
            return;
        };
        let (Some(config), true) = (self.config, run.has_ticks || reached.is_some()) else { return };
        let ticks = end_us.saturating_sub(run.start_us) / u64::from(config.spec().period_us.max(1));
        let missing = ticks.saturating_sub(reached.unwrap_or(0));
        self.report.gaps += u64::from(missing > 0);
        self.report.missing = self.report.missing.saturating_add(missing);
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
        let ours = step::step(config, state, sample.inputs());
        self.report.checked += 1;
        if config.spec().guide.limit_counts > 0 {
            let guided = self.report.guided.get_or_insert_default();
            guided.ticks += 1;
            guided.believed += u64::from(state.load_nnm(config).is_some());
            guided.farthest_counts = guided.farthest_counts.max(state.deviation.unsigned_abs() >> 20);
        }
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
            (Field::Place, i64::from(state.rotor.place), i64::from(block.state.rotor.place)),
            (Field::Speed, i64::from(state.rotor.speed), i64::from(block.state.rotor.speed)),
            (Field::FullSpeed, i64::from(state.rotor.full_cw), i64::from(block.state.rotor.full_cw)),
            (Field::FullSpeed, i64::from(state.rotor.full_ccw), i64::from(block.state.rotor.full_ccw)),
            (Field::Braking, i64::from(state.rotor.braking), i64::from(block.state.rotor.braking)),
            (Field::Load, i64::from(state.rotor.load.pushes), i64::from(block.state.rotor.load.pushes)),
            (Field::Load, i64::from(state.rotor.load.doubt), i64::from(block.state.rotor.load.doubt)),
            (Field::Deviation, i64::from(state.deviation), i64::from(block.state.deviation)),
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

/// How many indices of a stream are missing before `first`, and where it goes on. A stream that is switched on begins at 0.
fn follow(next: &mut u64, first: u64, count: u64) -> u64 {
    let missing = if first == 0 { 0 } else { first.saturating_sub(*next) };
    *next = first.saturating_add(count);
    missing
}

#[cfg(test)]
mod tests {
    use super::*;
    use twum_shared::message::{BitsBlock, CaptureMode, Configuration, EdgesBlock, RunEnd, TrackRun};
    use twum_shared::reference::Reference;
    use twum_shared::step::{ConfigSpec, Inputs};

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
                        let inputs = Inputs { target, ..Inputs::default() };
                        ControlSample::new(inputs, step::step(&config, &mut state, inputs), 0, 0)
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

    /// The three blocks of a run of 24 ms, which some of are not in the recording.
    fn replayed_run(kept: &[usize]) -> ReplayReport {
        let mut replay = Replay::new();
        replay.observe(&DeviceMessage::Configured(Configuration::with_control(ConfigSpec::THESIS)));
        replay.commanded(&HostMessage::Capture(CaptureMode { bits: false, edges: false, control: true }));
        let reference = Reference::Step { position: 1, at_us: 0 };
        let run = TrackRun { reference, duration_ms: 24 };
        replay.commanded(&HostMessage::Track { pass: Default::default(), run });
        replay.observe(&DeviceMessage::RunStarted { start_us: 0 });
        let blocks = blocks();
        for index in kept {
            replay.observe(&DeviceMessage::Control(blocks[*index].clone()));
        }
        replay.observe(&DeviceMessage::RunEnded { end: RunEnd::Completed, end_us: 24_000 });
        replay.finish()
    }

    #[test]
    fn ticks_missing_at_the_end_of_a_run_are_found_by_its_times() {
        for (kept, gaps, missing) in
            [(&[0, 1, 2][..], 0, 0), (&[0, 1], 1, 16), (&[0, 2], 1, 16), (&[1], 2, 32), (&[], 1, 48)]
        {
            let report = replayed_run(kept);
            assert_eq!((report.gaps, report.missing, report.unended), (gaps, missing, 0), "{kept:?}");
        }
    }

    #[test]
    fn samples_and_edges_dropped_by_the_board_are_found_by_their_indices() {
        let mut replay = Replay::new();
        let bits = |first_sample, samples| {
            DeviceMessage::Bits(BitsBlock { first_sample, first_us: 0, samples, words: Default::default() })
        };
        for message in [bits(0, 64), bits(64, 64), bits(192, 64), bits(0, 64), bits(64, 64)] {
            replay.observe(&message);
        }
        for first_edge in [0, 3, 0] {
            replay.observe(&DeviceMessage::Edges(EdgesBlock { first_edge, edges: Default::default() }));
        }
        let report = replay.finish();
        assert_eq!((report.missing_bits, report.missing_edges), (64, 3));
    }

    #[test]
    fn without_a_configuration_nothing_is_claimed() {
        let mut replay = Replay::new();
        replay.observe(&DeviceMessage::Control(blocks()[0].clone()));
        assert!(!replay.report().is_exact());
        assert_eq!(replay.report().unconfigured, 16);
    }
}
