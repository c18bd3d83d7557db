//! Frames of recordings made with protocol version 1. The device's messages read as they are: they have only gained variants
//! since. What the host said had no session and no pass.

use serde::Deserialize;
use twum_shared::frame::{self, FrameError, Header, Opened, PROTOCOL_VERSION};
use twum_shared::message::{CaptureMode, Configuration, DeviceMessage, HostMessage, Pass, SpeedRun, TrackRun};

/// A message that recordings hold.
pub(super) trait Recorded: frame::Message {
    /// The message of a frame of version 1.
    fn from_version_1(frame: &Opened<'_>) -> Option<Self>;
}

impl Recorded for DeviceMessage {
    fn from_version_1(frame: &Opened<'_>) -> Option<Self> {
        frame.message()
    }
}

impl Recorded for HostMessage {
    fn from_version_1(frame: &Opened<'_>) -> Option<Self> {
        frame.message::<HostMessage1>().map(Into::into)
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
    Configure(Configuration),
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
            HostMessage1::Configure(configuration) => Self::Configure(configuration),
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
