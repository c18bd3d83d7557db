//! What a session reads back of the configuration.

use super::{LinkError, Port, Session};
use std::time::Duration;
use twum_shared::message::{CaptureMode, Configuration, DeviceMessage};

impl<P: Port> Session<P> {
    /// The configuration in force, as the board says it; `None` where it has none. Switches the capture streams off, and
    /// passes over what waits to be read.
    ///
    /// # Errors
    /// No answer.
    pub fn configuration(&mut self) -> Result<Option<Configuration>, LinkError> {
        // A board says its configuration whenever the streams are chosen, before it acknowledges the choice.
        self.capture(CaptureMode::default())?;
        let mut found = None;
        while let Some(received) = self.next(Duration::ZERO)? {
            if let DeviceMessage::Configured(configuration) = received.message {
                found = Some(configuration);
            }
        }
        Ok(found)
    }
}
