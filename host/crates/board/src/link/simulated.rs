use super::{LinkError, Port};
use crate::sim::{Board, Setup};
use std::time::Duration;

/// While waiting, the board runs in slices of this length, so that an answer is seen when it comes.
const SLICE_US: u64 = 1_000;

/// A simulated board in memory. Its time passes only while the host waits for it, so a conversation is deterministic and
/// as fast as the machine allows.
pub struct SimulatedLink {
    board: Board,
    start_us: u64,
}

impl SimulatedLink {
    /// Switches on a board and connects to it.
    pub fn new(setup: Setup) -> Self {
        let start_us = setup.start_us;
        Self { board: Board::new(setup), start_us }
    }

    /// The board behind the link.
    pub fn board(&mut self) -> &mut Board {
        &mut self.board
    }
}

impl Port for SimulatedLink {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.board.send(bytes);
        Ok(())
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        let deadline_us = self.board.now_us() + wait.as_micros() as u64;
        loop {
            let before = into.len();
            self.board.received(into);
            if into.len() > before || self.board.now_us() >= deadline_us {
                return Ok(());
            }
            self.board.run_until((self.board.now_us() + SLICE_US).min(deadline_us));
        }
    }

    fn elapsed(&self) -> Duration {
        Duration::from_micros(self.board.now_us() - self.start_us)
    }

    fn is_virtual(&self) -> bool {
        true
    }
}
