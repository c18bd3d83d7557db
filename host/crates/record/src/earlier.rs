//! Frames of recordings made with earlier protocol versions. The messages have only gained variants since, but for six things: in
//! version 1 what the host said had no session and no pass, until version 2 a configuration did not say how slow a motor may be,
//! until version 3 no controller waited with a reversal, until version 4 none had a model of its rotor, until version 5 none made
//! one pulse a period, and until version 6 each learnt its rotor and no target gave way to a load.

use fixed::types::{I16F48, I32F32};
use serde::Deserialize;
use twum_shared::Direction;
use twum_shared::encoder::CountSign;
use twum_shared::frame::{self, FrameError, Header, Opened, PROTOCOL_VERSION};
use twum_shared::message::{BLOCK_SAMPLES, ControlBlock, ControlSample};
use twum_shared::message::{CaptureMode, Configuration, DeviceMessage, HostMessage, Pass, SpeedRun, TrackRun};
use twum_shared::safety::Limits;
use twum_shared::step::{ConfigSpec, DriveLaw, GuideSpec, Reversal, Rotor, State};

/// A message that recordings hold.
pub(super) trait Recorded: frame::Message {
    /// The message of a frame of an earlier version.
    fn earlier(version: u8, frame: &Opened<'_>) -> Option<Self>;
}

/// Place of [`DeviceMessage::Configured`], of [`DeviceMessage::Control`] and of [`HostMessage::Configure`] among their variants.
const CONFIGURED: u8 = 3;
const CONTROL: u8 = 9;
const CONFIGURE: u8 = 2;

/// What a variant held then, as what it holds now.
fn held<'a, Then: Deserialize<'a> + Into<Now>, Now>(frame: &'a Opened<'_>) -> Option<Now> {
    frame.message().map(|(_, then): (u8, Then)| then.into())
}

fn configuration(version: u8, frame: &Opened<'_>) -> Option<Configuration> {
    match version {
        1 | 2 => held::<Configuration2, _>(frame),
        3 => held::<Configuration3, _>(frame),
        4 => held::<Configuration4, _>(frame),
        5 => held::<Configuration5, _>(frame),
        _ => held::<Configuration6, _>(frame),
    }
}

impl Recorded for DeviceMessage {
    fn earlier(version: u8, frame: &Opened<'_>) -> Option<Self> {
        match (frame.body.first(), version) {
            (Some(&CONFIGURED), _) => configuration(version, frame).map(Self::Configured),
            (Some(&CONTROL), 1..=3) => held::<ControlBlock3, _>(frame).map(Self::Control),
            (Some(&CONTROL), 4) => held::<ControlBlock4, _>(frame).map(Self::Control),
            (Some(&CONTROL), 5) => held::<ControlBlock5, _>(frame).map(Self::Control),
            (Some(&CONTROL), _) => held::<ControlBlock6, _>(frame).map(Self::Control),
            _ => frame.message(),
        }
    }
}

impl Recorded for HostMessage {
    fn earlier(version: u8, frame: &Opened<'_>) -> Option<Self> {
        match (frame.body.first(), version) {
            (_, 1) => frame.message::<HostMessage1>().map(Into::into),
            (Some(&CONFIGURE), _) => configuration(version, frame).map(Self::Configure),
            _ => frame.message(),
        }
    }
}

/// Decodes the bytes of a recorded frame without its separator, in place, of any version that there was.
///
/// # Errors
/// Says why the bytes are not a frame of this kind.
pub(super) fn decode<M: Recorded>(block: &mut [u8]) -> Result<(Header, M), FrameError> {
    let opened = frame::open(block)?;
    if opened.kind != M::KIND {
        return Err(FrameError::Kind(opened.kind));
    }
    let message = match opened.version {
        PROTOCOL_VERSION => opened.message(),
        version if (1..PROTOCOL_VERSION).contains(&version) => M::earlier(version, &opened),
        other => return Err(FrameError::Version(other)),
    };
    message.map(|message| (opened.header, message)).ok_or(FrameError::Message)
}

/// What the host said in version 1.
#[derive(Deserialize)]
enum HostMessage1 {
    Hello,
    Keepalive,
    Configure(Configuration2),
    Align,
    Arm,
    Speed(SpeedRun),
    Track(TrackRun),
    Capture(CaptureMode),
    Driver(heapless::String<64>),
    Stop,
    Reboot,
}

impl From<HostMessage1> for HostMessage {
    fn from(message: HostMessage1) -> Self {
        let (token, pass) = (0, Pass::default());
        match message {
            HostMessage1::Hello => Self::Hello,
            HostMessage1::Keepalive => Self::Keepalive { token },
            HostMessage1::Configure(configuration) => Self::Configure(configuration.into()),
            HostMessage1::Align => Self::Align(pass),
            HostMessage1::Arm => Self::Arm { token },
            HostMessage1::Speed(run) => Self::Speed { pass, run },
            HostMessage1::Track(run) => Self::Track { pass, run },
            HostMessage1::Capture(mode) => Self::Capture(mode),
            HostMessage1::Driver(line) => Self::Driver { pass, line },
            HostMessage1::Stop => Self::Stop { clear_fault: true },
            HostMessage1::Reboot => Self::Reboot,
        }
    }
}

/// A configuration with an earlier controller and earlier limits.
#[derive(Deserialize)]
struct Earlier<C, L> {
    control: C,
    limits: L,
    count_sign: CountSign,
    edges_per_rev: u16,
    pwm_hz: u16,
}

type Configuration2 = Earlier<ConfigSpec3, Limits2>;
type Configuration3 = Earlier<ConfigSpec3, Limits>;
type Configuration4 = Earlier<ConfigSpec4, Limits>;
type Configuration5 = Earlier<ConfigSpec5, Limits>;
type Configuration6 = Earlier<ConfigSpec6, Limits>;

impl<C: Into<ConfigSpec>, L: Into<Limits>> From<Earlier<C, L>> for Configuration {
    fn from(old: Earlier<C, L>) -> Self {
        let Earlier { control, limits, count_sign, edges_per_rev, pwm_hz } = old;
        Self { control: control.into(), limits: limits.into(), count_sign, edges_per_rev, pwm_hz }
    }
}

/// A controller of version 6: its target did not give way.
#[derive(Deserialize)]
struct ConfigSpec6 {
    before: ConfigSpec5,
    pulse_period_ticks: u8,
}

impl From<ConfigSpec6> for ConfigSpec {
    fn from(ConfigSpec6 { before, pulse_period_ticks }: ConfigSpec6) -> Self {
        Self { pulse_period_ticks, ..before.into() }
    }
}

/// A controller of version 5: a gated drive made a pulse whenever it had to.
#[derive(Deserialize)]
struct ConfigSpec5 {
    before: ConfigSpec4,
    full_speed_counts_s: u16,
    braking_counts_s2: u32,
    delay_ticks: u8,
    shortest_pulse_ticks: u8,
}

impl From<ConfigSpec5> for ConfigSpec {
    fn from(old: ConfigSpec5) -> Self {
        let ConfigSpec5 { before, full_speed_counts_s, braking_counts_s2, delay_ticks, shortest_pulse_ticks } = old;
        let before = Self::from(before);
        let is_gated = before.law == DriveLaw::Gated;
        Self {
            full_speed_counts_s,
            braking_counts_s2,
            delay_ticks,
            shortest_pulse_ticks,
            pulse_period_ticks: u8::from(is_gated),
            learns: is_gated,
            ..before
        }
    }
}

/// A controller of version 4: it had no model of the rotor.
#[derive(Deserialize)]
struct ConfigSpec4 {
    before: ConfigSpec3,
    reversal_rest_ticks: u16,
    reversal_limit_ticks: u16,
}

impl From<ConfigSpec4> for ConfigSpec {
    fn from(old: ConfigSpec4) -> Self {
        let ConfigSpec4 { before, reversal_rest_ticks, reversal_limit_ticks } = old;
        Self { reversal_rest_ticks, reversal_limit_ticks, ..before.into() }
    }
}

/// A controller until version 3: it reversed at once.
#[derive(Deserialize)]
struct ConfigSpec3 {
    kp: I32F32,
    ki_tick: I16F48,
    kd_tick: I32F32,
    feed_forward: I32F32,
    integral_min: i32,
    integral_max: i32,
    period_us: u32,
    duty_steps: u16,
    law: DriveLaw,
    dead_band_counts: u16,
    conditional_integration: bool,
}

impl From<ConfigSpec3> for ConfigSpec {
    fn from(old: ConfigSpec3) -> Self {
        Self {
            kp: old.kp,
            ki_tick: old.ki_tick,
            kd_tick: old.kd_tick,
            feed_forward: old.feed_forward,
            integral_min: old.integral_min,
            integral_max: old.integral_max,
            period_us: old.period_us,
            duty_steps: old.duty_steps,
            law: old.law,
            dead_band_counts: old.dead_band_counts,
            conditional_integration: old.conditional_integration,
            reversal_rest_ticks: 0,
            reversal_limit_ticks: 0,
            full_speed_counts_s: 0,
            braking_counts_s2: 0,
            delay_ticks: 0,
            shortest_pulse_ticks: 0,
            pulse_period_ticks: 0,
            learns: false,
            guide: GuideSpec::OFF,
        }
    }
}

/// Control ticks with an earlier state.
#[derive(Deserialize)]
struct EarlierBlock<S, T> {
    first_tick: u64,
    first_us: u64,
    state: S,
    samples: heapless::Vec<T, BLOCK_SAMPLES>,
}

type ControlBlock3 = EarlierBlock<State3, ControlSample4>;
type ControlBlock4 = EarlierBlock<State4, ControlSample4>;
type ControlBlock5 = EarlierBlock<State5, ControlSample>;
type ControlBlock6 = EarlierBlock<State6, ControlSample>;

impl<S: Into<State>, T: Into<ControlSample>> From<EarlierBlock<S, T>> for ControlBlock {
    fn from(old: EarlierBlock<S, T>) -> Self {
        let EarlierBlock { first_tick, first_us, state, samples } = old;
        Self { first_tick, first_us, state: state.into(), samples: samples.into_iter().map(Into::into).collect() }
    }
}

#[derive(Deserialize)]
struct State3 {
    integral: i32,
    previous_error: i32,
    direction: Direction,
}

impl From<State3> for State {
    fn from(State3 { integral, previous_error, direction }: State3) -> Self {
        Self { integral, previous_error, direction, ..Self::REST }
    }
}

#[derive(Deserialize)]
struct State4 {
    before: State3,
    reversal: Reversal,
}

impl From<State4> for State {
    fn from(State4 { before, reversal }: State4) -> Self {
        Self { reversal, ..before.into() }
    }
}

#[derive(Deserialize)]
struct State5 {
    before: State4,
    rotor: Rotor5,
}

/// What a gated drive of version 5 believed.
#[derive(Deserialize)]
struct Rotor5 {
    count: i32,
    place: i32,
    speed: i32,
    full_cw: i32,
    full_ccw: i32,
    braking: i32,
    on: u16,
    cw: u16,
    held: u8,
}

impl From<State5> for State {
    fn from(State5 { before, rotor }: State5) -> Self {
        let Rotor5 { count, place, speed, full_cw, full_ccw, braking, on, cw, held } = rotor;
        let rotor = Rotor { count, place, speed, full_cw, full_ccw, braking, on, cw, held, ..Rotor::REST };
        Self { rotor, ..before.into() }
    }
}

#[derive(Deserialize)]
struct State6 {
    before: State4,
    rotor: Rotor6,
}

/// What a gated drive of version 6 believed.
#[derive(Deserialize)]
struct Rotor6 {
    before: Rotor5,
    since: u8,
    driven: i32,
    coasted: i32,
}

impl From<State6> for State {
    fn from(State6 { before, rotor }: State6) -> Self {
        let Rotor6 { before: rotor, since, driven, coasted } = rotor;
        let before = Self::from(State5 { before, rotor });
        Self { rotor: Rotor { since, driven, coasted, ..before.rotor }, ..before }
    }
}

/// A control tick until version 4: it did not say when the last edge came.
#[derive(Deserialize)]
struct ControlSample4 {
    target: i32,
    target_rate: i32,
    position: i32,
    u: i32,
    on_steps: u16,
    direction: Direction,
    late_us: u16,
    duration_us: u16,
}

impl From<ControlSample4> for ControlSample {
    fn from(old: ControlSample4) -> Self {
        let ControlSample4 { target, target_rate, position, u, on_steps, direction, late_us, duration_us } = old;
        Self {
            target,
            target_rate,
            position,
            u,
            on_steps,
            direction,
            late_us,
            duration_us,
            target_fraction: 0,
            edge_age_us: u16::MAX,
        }
    }
}

#[derive(Deserialize)]
struct Limits2 {
    command_timeout_ms: u16,
    stall_duty: u16,
    stall_ms: u16,
    chatter_edges: u8,
    wrong_direction_counts: u16,
    following_error_counts: u32,
    overspeed_counts_s: u32,
    position_min: i32,
    position_max: i32,
    late_tick_us: u16,
    late_ticks: u8,
    lost_items: u16,
}

impl From<Limits2> for Limits {
    fn from(old: Limits2) -> Self {
        Self {
            command_timeout_ms: old.command_timeout_ms,
            stall_duty: old.stall_duty,
            stall_ms: old.stall_ms,
            chatter_edges: old.chatter_edges,
            wrong_direction_counts: old.wrong_direction_counts,
            following_error_counts: old.following_error_counts,
            overspeed_counts_s: old.overspeed_counts_s,
            position_min: old.position_min,
            position_max: old.position_max,
            late_tick_us: old.late_tick_us,
            late_ticks: old.late_ticks,
            lost_items: old.lost_items,
            ..Self::DEFAULT
        }
    }
}
