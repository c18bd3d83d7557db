//! What moves the motor through the driver board's text mode: alignment, and lines that are passed on.

use super::Control;
use crate::output::OutputStage;
use crate::shared::{DriverRequest, Event};
use twum_shared::Fault;
use twum_shared::alignment::Failure;
use twum_shared::message::{Mode, Pass, Refusal};

/// Where the driver board is.
#[derive(Debug, Default)]
pub(super) struct Alignment {
    /// The rotor was aligned.
    pub done: bool,
    /// The driver board listens to PWM, and no longer to text.
    pub hardware_mode: bool,
}

impl<S: OutputStage> Control<'_, S> {
    /// Starts what moves the motor through the driver board's text mode.
    pub(super) fn begin_text(&mut self, pass: Pass, request: DriverRequest, mode: Mode) -> Result<(), Refusal> {
        self.require(Mode::Idle)?;
        if self.alignment.hardware_mode {
            return Err(Refusal::HardwareMode);
        }
        self.passes.take(pass)?;
        self.hold(pass.token);
        self.shared.begin_errand(request);
        self.mode = mode;
        Ok(())
    }

    /// The alignment routine of this errand ended.
    pub(super) fn align_ended(&mut self, result: Result<(), Failure>, now_us: u64, position: i32) {
        if self.mode != Mode::Aligning {
            return;
        }
        match result {
            Ok(()) => {
                self.shared.encoder.zero();
                self.shared.encoder.set_unsigned(false);
                self.monitor.reset();
                self.alignment = Alignment { done: true, hardware_mode: true };
                self.mode = Mode::Idle;
                self.release();
                self.shared.tell(Event::Aligned);
            }
            Err(Failure::DriverSilent) => self.latch(Fault::DriverSilent, now_us, position),
            Err(Failure::NoEdge) => self.latch(Fault::AlignFailed, now_us, position),
        }
    }

    /// The line of this errand was passed on, and the motor stands.
    pub(super) fn passthrough_ended(&mut self) {
        if self.mode == Mode::Passthrough {
            self.mode = Mode::Idle;
            self.release();
            self.shared.tell(Event::DriverDone);
        }
    }
}
