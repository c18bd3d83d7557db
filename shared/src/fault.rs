//! Named faults. Each switches the output off and latches until an explicit stop, then arm.

use serde::{Deserialize, Serialize};

/// Why the motor was stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, thiserror::Error)]
#[repr(u8)]
pub enum Fault {
    /// Control ticks came late more often, or later, than allowed.
    #[error("the control loop overran its period; free the control core or lengthen the period")]
    LoopOverrun = 1,
    /// The host fell silent while the motor was armed or running.
    #[error("no command from the host within the timeout; check the cable, then stop and arm again")]
    CommandTimeout,
    /// Driven, and the encoder showed less than any motor would have turned under that drive.
    #[error(
        "the motor was driven and the encoder showed no turning, or too little; check rotor, driver supply and encoder wire"
    )]
    EncoderStall,
    /// More encoder edges in a tick than a motor can make.
    #[error("the encoder chatters; check its wiring, ground and threshold")]
    EncoderChatter,
    /// The count moved against the drive: its configured sign is wrong.
    #[error("the count moves against the drive; flip the configured count sign")]
    WrongDirection,
    /// The position left the target by more than allowed.
    #[error("the position error exceeded its bound; slow the reference or retune")]
    FollowingError,
    /// The count moved faster than allowed.
    #[error("the speed exceeded its bound")]
    Overspeed,
    /// The position left its allowed range.
    #[error("the position left its allowed range")]
    PositionBound,
    /// Alignment used up its attempts or its time without a confirmed edge.
    #[error("alignment found no confirmed encoder edge; check the motor turns and the sensor threshold")]
    AlignFailed,
    /// The configuration is invalid or missing.
    #[error("the configuration is invalid; send one that validates")]
    ConfigInvalid,
    /// The driver board did not answer.
    #[error("the driver board did not answer; power-cycle it (it leaves hardware mode only so) and check GPIO 16/17")]
    DriverSilent,
    /// Capture data were lost faster than allowed.
    #[error("the capture queues overflowed; capture less or raise the baud rate")]
    QueueOverflow,
    /// The last reset came from the hardware watchdog.
    #[error("the last reset came from the hardware watchdog")]
    BootFromWatchdog,
    /// The last reset followed a panic.
    #[error("the last reset followed a panic")]
    BootFromPanic,
    /// Bytes from the host were lost before they could be read.
    #[error("bytes from the host were lost in reception")]
    RxOverrun,
    /// The stop input is, or was, low.
    #[error("the stop input was pulled low; release it, then stop and arm again")]
    ExternalStop,
}

impl Fault {
    /// Every fault, in the order of their codes.
    pub const ALL: [Self; 16] = [
        Self::LoopOverrun,
        Self::CommandTimeout,
        Self::EncoderStall,
        Self::EncoderChatter,
        Self::WrongDirection,
        Self::FollowingError,
        Self::Overspeed,
        Self::PositionBound,
        Self::AlignFailed,
        Self::ConfigInvalid,
        Self::DriverSilent,
        Self::QueueOverflow,
        Self::BootFromWatchdog,
        Self::BootFromPanic,
        Self::RxOverrun,
        Self::ExternalStop,
    ];

    /// The code a fault travels under between cores; never zero.
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// The fault a code stands for.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|fault| fault.code() == code)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_round_trip_and_zero_is_none() {
        for fault in Fault::ALL {
            assert_eq!(Fault::from_code(fault.code()), Some(fault));
        }
        assert_eq!(Fault::from_code(0), None);
        assert_eq!(Fault::from_code(17), None);
    }
}
