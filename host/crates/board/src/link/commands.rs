//! What a session asks of a board, one method a command.

use super::{LinkError, Port, Session};
use std::time::Duration;
use twum_shared::Fault;
use twum_shared::message::{
    CaptureMode, Configuration, DeviceMessage, HostMessage, Identity, Mode, Pass, Refusal, SpeedRun, TrackRun,
};

/// How long a command's answer may take.
const ANSWER: Duration = Duration::from_millis(1_000);
/// How long a busy board is left alone before it is asked again.
const ASK_AGAIN: Duration = Duration::from_millis(20);
/// Longest alignment: four attempts, each with five lines of a search and their replies.
const ALIGNMENT: Duration = Duration::from_secs(100);

impl<P: Port> Session<P> {
    /// Sends a command and waits for its answer; other messages stay in order for [`Session::next`]. A board that is busy,
    /// as while it writes a new configuration to flash, is asked again.
    fn command(&mut self, name: &'static str, message: &HostMessage) -> Result<(), LinkError> {
        let patience = self.port.elapsed() + ANSWER;
        loop {
            let sent = self.send(message)?;
            let answer = self.wait_for(ANSWER, |message| match message {
                DeviceMessage::Ack { of } if *of == sent => Some(Ok(())),
                DeviceMessage::Nack { of, reason } if *of == sent => Some(Err(*reason)),
                _ => None,
            })?;
            match answer {
                Ok(()) => return Ok(()),
                Err(Refusal::Busy) if self.port.elapsed() < patience => {
                    match self.wait_for(ASK_AGAIN, |_| None::<()>) {
                        Ok(()) | Err(LinkError::NoAnswer { .. }) => {}
                        Err(error) => return Err(error),
                    }
                }
                Err(reason) => return Err(LinkError::Refused { command: name, reason }),
            }
        }
    }

    /// Asks who the device is. Tries for three seconds: a board that was just opened may still boot.
    ///
    /// # Errors
    /// No answer, or another protocol version.
    pub fn hello(&mut self) -> Result<Identity, LinkError> {
        let mut result = Err(LinkError::NoAnswer { waited_ms: 3_000 });
        for _ in 0..6 {
            self.send(&HostMessage::Hello)?;
            let answer = self.wait_for(Duration::from_millis(500), |message| match message {
                DeviceMessage::Hello(identity) => Some(identity.clone()),
                _ => None,
            });
            match answer {
                Ok(identity) => return Ok(identity),
                Err(LinkError::NoAnswer { .. }) => {}
                Err(error) => {
                    result = Err(error);
                    break;
                }
            }
        }
        result
    }

    /// Sets the configuration.
    ///
    /// # Errors
    /// Refused, or no answer.
    pub fn configure(&mut self, configuration: Configuration) -> Result<(), LinkError> {
        self.command("the configuration", &HostMessage::Configure(configuration))
    }

    /// Aligns the motor and waits for the end of it.
    ///
    /// # Errors
    /// Refused, the fault it ended in, or no answer.
    pub fn align(&mut self) -> Result<(), LinkError> {
        self.begin_alignment()?;
        self.wait_for(ALIGNMENT, |message| match message {
            DeviceMessage::Aligned => Some(Ok(())),
            DeviceMessage::Fault(report) => Some(Err(LinkError::Fault(report.fault))),
            DeviceMessage::Status(status) => match status.mode {
                Mode::Fault => Some(Err(LinkError::Fault(status.fault.unwrap_or(Fault::AlignFailed)))),
                Mode::Stopping => Some(Err(LinkError::StoppedByOther)),
                _ => None,
            },
            _ => None,
        })??;
        self.hold(false);
        Ok(())
    }

    /// Aligns the motor without waiting for the end of it.
    ///
    /// # Errors
    /// Refused, or no answer.
    pub fn begin_alignment(&mut self) -> Result<(), LinkError> {
        let pass = self.take_pass("alignment")?;
        self.set_in_motion("alignment", &HostMessage::Align(pass))
    }

    /// Allows runs.
    ///
    /// # Errors
    /// Refused, or no answer.
    pub fn arm(&mut self) -> Result<(), LinkError> {
        self.set_in_motion("arming", &HostMessage::Arm { token: self.token })?;
        self.pass = Some(self.wait_for_pass()?);
        Ok(())
    }

    fn wait_for_pass(&mut self) -> Result<Pass, LinkError> {
        let token = self.token;
        self.wait_for(ANSWER, |message| match message {
            DeviceMessage::Pass(pass) if pass.token == token => Some(*pass),
            _ => None,
        })
    }

    /// The pass that arming gave, or a new one.
    fn take_pass(&mut self, name: &'static str) -> Result<Pass, LinkError> {
        if let Some(pass) = self.pass.take() {
            return Ok(pass);
        }
        self.command(name, &HostMessage::AskPass { token: self.token })?;
        self.wait_for_pass()
    }

    /// Sends a command that may set the motor in motion: from here on this session holds it, unless it is refused.
    fn set_in_motion(&mut self, name: &'static str, message: &HostMessage) -> Result<(), LinkError> {
        let held = self.holding;
        self.hold(true);
        let result = self.command(name, message);
        if matches!(result, Err(LinkError::Refused { .. })) {
            self.hold(held);
        }
        result
    }

    /// Chooses the capture streams.
    ///
    /// # Errors
    /// Refused, or no answer.
    pub fn capture(&mut self, mode: CaptureMode) -> Result<(), LinkError> {
        self.command("the capture mode", &HostMessage::Capture(mode))
    }

    /// Starts a run at constant duty.
    ///
    /// # Errors
    /// Refused, or no answer.
    pub fn start_speed(&mut self, run: SpeedRun) -> Result<(), LinkError> {
        let pass = self.take_pass("the run")?;
        self.set_in_motion("the run", &HostMessage::Speed { pass, run })
    }

    /// Starts a closed-loop run.
    ///
    /// # Errors
    /// Refused, or no answer.
    pub fn start_track(&mut self, run: TrackRun) -> Result<(), LinkError> {
        let pass = self.take_pass("the run")?;
        self.set_in_motion("the run", &HostMessage::Track { pass, run })
    }

    /// Passes a line to the driver board.
    ///
    /// # Errors
    /// Refused, or no answer.
    pub fn driver(&mut self, line: heapless::String<64>) -> Result<(), LinkError> {
        let pass = self.take_pass("the driver line")?;
        self.set_in_motion("the driver line", &HostMessage::Driver { pass, line })
    }

    /// Restarts the device.
    ///
    /// # Errors
    /// Refused, or no answer.
    pub fn reboot(&mut self) -> Result<(), LinkError> {
        self.command("the reboot", &HostMessage::Reboot)
    }
}
