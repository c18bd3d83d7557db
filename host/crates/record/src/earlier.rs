//! Frames of recordings made with earlier protocol versions. The messages have only gained variants since, but for four things: in
//! version 1 what the host said had no session and no pass, until version 2 a configuration did not say how slow a motor may be,
//! until version 3 no controller waited with a reversal, and until version 4 none had a model of its rotor.

use fixed::types::{I16F48, I32F32};
use serde::Deserialize;
use twum_shared::Direction;
use twum_shared::encoder::CountSign;
use twum_shared::frame::{self, FrameError, Header, Opened, PROTOCOL_VERSION};
use twum_shared::message::{BLOCK_SAMPLES, ControlBlock, ControlSample};
use twum_shared::message::{CaptureMode, Configuration, DeviceMessage, HostMessage, Pass, SpeedRun, TrackRun};
use twum_shared::safety::Limits;
use twum_shared::step::{ConfigSpec, DriveLaw, Reversal, State};

/// A message that recordings hold.
pub(super) trait Recorded: frame::Message {
    /// The message of a frame of version 1.
    fn from_version_1(frame: &Opened<'_>) -> Option<Self>;

    /// The message of a frame of version 2.
    fn from_version_2(frame: &Opened<'_>) -> Option<Self>;

    /// The message of a frame of version 3.
    fn from_version_3(frame: &Opened<'_>) -> Option<Self>;

    /// The message of a frame of version 4.
    fn from_version_4(frame: &Opened<'_>) -> Option<Self>;
}

/// Place of [`DeviceMessage::Configured`], of [`DeviceMessage::Control`] and of [`HostMessage::Configure`] among their variants.
const CONFIGURED: u8 = 3;
const CONTROL: u8 = 9;
const CONFIGURE: u8 = 2;

impl Recorded for DeviceMessage {
    fn from_version_1(frame: &Opened<'_>) -> Option<Self> {
        Self::from_version_2(frame)
    }

    fn from_version_2(frame: &Opened<'_>) -> Option<Self> {
        match frame.body.first() {
            Some(&CONFIGURED) => frame.message().map(|(_, old): (u8, Configuration2)| Self::Configured(old.into())),
            _ => Self::from_version_3(frame),
        }
    }

    fn from_version_3(frame: &Opened<'_>) -> Option<Self> {
        match frame.body.first() {
            Some(&CONFIGURED) => frame.message().map(|(_, old): (u8, Configuration3)| Self::Configured(old.into())),
            Some(&CONTROL) => frame.message().map(|(_, old): (u8, ControlBlock3)| Self::Control(old.into())),
            _ => Self::from_version_4(frame),
        }
    }

    fn from_version_4(frame: &Opened<'_>) -> Option<Self> {
        match frame.body.first() {
            Some(&CONFIGURED) => frame.message().map(|(_, old): (u8, Configuration4)| Self::Configured(old.into())),
            Some(&CONTROL) => frame.message().map(|(_, old): (u8, ControlBlock4)| Self::Control(old.into())),
            _ => frame.message(),
        }
    }
}

impl Recorded for HostMessage {
    fn from_version_1(frame: &Opened<'_>) -> Option<Self> {
        frame.message::<HostMessage1>().map(Into::into)
    }

    fn from_version_2(frame: &Opened<'_>) -> Option<Self> {
        match frame.body.first() {
            Some(&CONFIGURE) => frame.message().map(|(_, old): (u8, Configuration2)| Self::Configure(old.into())),
            _ => Self::from_version_3(frame),
        }
    }

    fn from_version_3(frame: &Opened<'_>) -> Option<Self> {
        match frame.body.first() {
            Some(&CONFIGURE) => frame.message().map(|(_, old): (u8, Configuration3)| Self::Configure(old.into())),
            _ => Self::from_version_4(frame),
        }
    }

    fn from_version_4(frame: &Opened<'_>) -> Option<Self> {
        match frame.body.first() {
            Some(&CONFIGURE) => frame.message().map(|(_, old): (u8, Configuration4)| Self::Configure(old.into())),
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
        1 => M::from_version_1(&opened),
        2 => M::from_version_2(&opened),
        3 => M::from_version_3(&opened),
        4 => M::from_version_4(&opened),
        PROTOCOL_VERSION => opened.message(),
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

impl<C: Into<ConfigSpec>, L: Into<Limits>> From<Earlier<C, L>> for Configuration {
    fn from(old: Earlier<C, L>) -> Self {
        let Earlier { control, limits, count_sign, edges_per_rev, pwm_hz } = old;
        Self { control: control.into(), limits: limits.into(), count_sign, edges_per_rev, pwm_hz }
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
        }
    }
}

/// Control ticks with an earlier state.
#[derive(Deserialize)]
struct EarlierBlock<S> {
    first_tick: u64,
    first_us: u64,
    state: S,
    samples: heapless::Vec<ControlSample4, BLOCK_SAMPLES>,
}

type ControlBlock3 = EarlierBlock<State3>;
type ControlBlock4 = EarlierBlock<State4>;

impl<S: Into<State>> From<EarlierBlock<S>> for ControlBlock {
    fn from(old: EarlierBlock<S>) -> Self {
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
