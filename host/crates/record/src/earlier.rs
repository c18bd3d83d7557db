//! Frames of recordings made with earlier protocol versions. The messages have only gained variants since, but for two things: in
//! version 1 what the host said had no session and no pass, and until version 2 a configuration did not say how slow a motor may be.

use serde::Deserialize;
use twum_shared::encoder::CountSign;
use twum_shared::frame::{self, FrameError, Header, Opened, PROTOCOL_VERSION};
use twum_shared::message::{CaptureMode, Configuration, DeviceMessage, HostMessage, Pass, SpeedRun, TrackRun};
use twum_shared::safety::Limits;
use twum_shared::step::ConfigSpec;

/// A message that recordings hold.
pub(super) trait Recorded: frame::Message {
    /// The message of a frame of version 1.
    fn from_version_1(frame: &Opened<'_>) -> Option<Self>;

    /// The message of a frame of version 2.
    fn from_version_2(frame: &Opened<'_>) -> Option<Self>;
}

/// Place of [`DeviceMessage::Configured`] and of [`HostMessage::Configure`] among their variants.
const CONFIGURED: u8 = 3;
const CONFIGURE: u8 = 2;

impl Recorded for DeviceMessage {
    fn from_version_1(frame: &Opened<'_>) -> Option<Self> {
        Self::from_version_2(frame)
    }

    fn from_version_2(frame: &Opened<'_>) -> Option<Self> {
        match frame.body.first() {
            Some(&CONFIGURED) => frame.message().map(|(_, old): (u8, Configuration2)| Self::Configured(old.into())),
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

/// A configuration until version 2.
#[derive(Deserialize)]
struct Configuration2 {
    control: ConfigSpec,
    limits: Limits2,
    count_sign: CountSign,
    edges_per_rev: u16,
    pwm_hz: u16,
}

impl From<Configuration2> for Configuration {
    fn from(old: Configuration2) -> Self {
        let Configuration2 { control, limits, count_sign, edges_per_rev, pwm_hz } = old;
        Self { control, limits: limits.into(), count_sign, edges_per_rev, pwm_hz }
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
