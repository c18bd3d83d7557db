//! Who holds the motor: the session that set it in motion, or may; and the passes, each good for one motion.

use super::Control;
use crate::output::OutputStage;
use crate::shared::Event;
use twum_shared::message::{Mode, Pass, Refusal};

/// The pass that was given last and not used.
#[derive(Debug, Default)]
pub(super) struct Passes {
    open: Option<Pass>,
    nonce: u32,
}

impl Passes {
    /// Another one each time; it voids the one before.
    fn give(&mut self, token: u32, heard_us: u64, now_us: u64) -> Pass {
        self.nonce = another_nonce(self.nonce, heard_us, now_us);
        let pass = Pass { token, nonce: self.nonce };
        self.open = Some(pass);
        pass
    }

    /// Takes a pass: it works once.
    pub fn take(&mut self, pass: Pass) -> Result<(), Refusal> {
        if self.open != Some(pass) {
            return Err(Refusal::Pass);
        }
        self.open = None;
        Ok(())
    }
}

impl<S: OutputStage> Control<'_, S> {
    /// Gives a session the pass for its next motion, and voids the one before. The µs at which a frame was heard do not
    /// repeat, and so neither does the pass.
    pub(super) fn give_pass(&mut self, token: u32, heard_us: u64, now_us: u64) -> Result<(), Refusal> {
        if token == 0 {
            return Err(Refusal::Pass);
        }
        if ![0, token].contains(&self.shared.holder()) {
            return Err(Refusal::Held);
        }
        let pass = self.passes.give(token, heard_us, now_us);
        self.shared.tell(Event::Pass(pass));
        Ok(())
    }

    /// From here on the motor moves, or may, as long as this session is heard.
    pub(super) fn hold(&mut self, token: u32) {
        self.shared.set_holder(token);
        self.monitor.reset();
        self.lost.in_a_row = 0;
    }

    /// Nobody holds the motor, and nothing that was asked for before moves it.
    pub(super) fn release(&mut self) {
        self.shared.set_holder(0);
        self.shared.end_errand();
        self.passes.open = None;
    }

    pub(super) fn arm(&mut self, token: u32, heard_us: u64, now_us: u64) -> Result<(), Refusal> {
        self.require(Mode::Idle)?;
        if self.configured.is_none() {
            return Err(Refusal::NotConfigured);
        }
        if self.shared.is_keeping() {
            return Err(Refusal::Busy);
        }
        if !self.alignment.done {
            return Err(Refusal::NotAligned);
        }
        self.give_pass(token, heard_us, now_us)?;
        self.hold(token);
        self.mode = Mode::Armed;
        Ok(())
    }
}

/// Another number each time: the µs at which frames arrive and ticks start do not repeat from one session, or one boot, to the
/// next. The mixing is the finaliser of MurmurHash3.
fn another_nonce(before: u32, heard_us: u64, now_us: u64) -> u32 {
    let mut mixed = before.wrapping_add(0x9e37_79b9) ^ heard_us as u32 ^ (now_us as u32).rotate_left(16);
    mixed = (mixed ^ (mixed >> 16)).wrapping_mul(0x85eb_ca6b);
    mixed = (mixed ^ (mixed >> 13)).wrapping_mul(0xc2b2_ae35);
    mixed ^ (mixed >> 16)
}
