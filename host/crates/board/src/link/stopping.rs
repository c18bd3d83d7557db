//! How a session stops the motor.

use super::session::Attention;
use super::{LinkError, Port, Session};
use std::time::Duration;
use twum_shared::message::{DeviceMessage, HostMessage, Mode};

/// A stop that is not acknowledged is sent again this often: with three lost, and a driver board that ends its line of 40 ms, the
/// motor still stands within 100 ms of an interruption that is seen within 10 ms.
pub(super) const STOP_AGAIN: Duration = Duration::from_millis(10);
/// A stop is given up after this long: by then the device's own command timeout, 2 s at most, has switched the motor off.
const STOP_PATIENCE: Duration = Duration::from_millis(2_500);
/// The driver board's own motion ends within this time of a stop, and its end is seen.
const STANDSTILL: Duration = Duration::from_secs(10);
/// A status comes ten times a second.
const STATUS: Duration = Duration::from_millis(1_000);

impl<P: Port> Session<P> {
    /// Stops the motor and disarms, and clears a latched fault: what a person decides. See [`Session::halt`].
    ///
    /// # Errors
    /// As [`Session::halt`].
    pub fn stop(&mut self) -> Result<(), LinkError> {
        self.switch_off(true)
    }

    /// Stops the motor and disarms; a latched fault stays. Sent every 10 ms until it is acknowledged, without a sign of life
    /// between, then held against what the board says of itself: the drive off, the edges ceased. No interruption, full disk
    /// or closed pipe keeps it from that.
    ///
    /// # Errors
    /// When the port is gone, nothing acknowledges it, or the motor is not seen to stand.
    pub fn halt(&mut self) -> Result<(), LinkError> {
        self.switch_off(false)
    }

    /// [`Session::halt`], if this session set the motor in motion, or may have; what another one moves goes on.
    ///
    /// # Errors
    /// As [`Session::halt`].
    pub fn let_go(&mut self) -> Result<(), LinkError> {
        if self.holding { self.halt() } else { Ok(()) }
    }

    pub(super) fn switch_off(&mut self, clear_fault: bool) -> Result<(), LinkError> {
        self.pass = None;
        let began = self.port.elapsed();
        let mut sent = Vec::new();
        loop {
            if self.port.elapsed() >= began + STOP_PATIENCE {
                return Err(LinkError::NotStopped("nothing acknowledged the stop"));
            }
            sent.push(self.send(&HostMessage::Stop { clear_fault })?);
            let until = self.port.elapsed() + STOP_AGAIN;
            let acknowledged = self.search(until, Attention::Stopping, |received| match &received.message {
                DeviceMessage::Ack { of } if sent.contains(of) => Some(received.header.time_us),
                _ => None,
            })?;
            if let Some(at_us) = acknowledged {
                self.see_it_stand(at_us)?;
                break;
            }
        }
        self.hold(false);
        Ok(())
    }

    /// Waits for a status, not older than the acknowledgement, that says that nothing moves.
    fn see_it_stand(&mut self, acknowledged_us: u64) -> Result<(), LinkError> {
        let mut looked_at = 0;
        let give_up = self.port.elapsed() + STANDSTILL;
        let mut next_status = self.port.elapsed() + STATUS;
        loop {
            while let Some(received) = self.inbox.get(looked_at) {
                looked_at += 1;
                let DeviceMessage::Status(status) = &received.message else { continue };
                if received.header.time_us < acknowledged_us {
                    continue;
                }
                next_status = self.port.elapsed() + STATUS;
                if status.duty.is_off() && matches!(status.mode, Mode::Idle | Mode::Fault) {
                    return Ok(());
                }
            }
            let now = self.port.elapsed();
            if now >= give_up {
                return Err(LinkError::NotStopped("the board took the stop, and the encoder still shows motion"));
            }
            if now >= next_status {
                return Err(LinkError::NotStopped("the board took the stop, and says nothing of the motor since"));
            }
            self.fill(next_status.min(give_up), Attention::Stopping)?;
        }
    }
}
