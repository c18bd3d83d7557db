//! The control core stands still while flash is written.
//!
//! A chip with two cores stalls one while the other writes flash. Stalled at any instruction it may hold a lock that an
//! interrupt of the writing core then waits for, until the watchdog bites. So the writer asks, and the control core stops of
//! its own accord, at the end of a tick: it holds nothing there, and the output is off.

use core::future::Future;
use portable_atomic::{AtomicBool, Ordering};

/// A control core that has not stopped after so many pauses of a millisecond does not tick: its period is 10 ms at most.
const PATIENCE: u32 = 50;

/// The agreement between the core that writes and the one that ticks.
#[derive(Debug, Default)]
pub struct Standstill {
    wanted: AtomicBool,
    standing: AtomicBool,
}

/// The control core did not stop: it does not tick, or the motor is armed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the control core does not stand still")]
pub struct Moving;

impl Standstill {
    /// Nobody asks.
    pub const fn new() -> Self {
        Self { wanted: AtomicBool::new(false), standing: AtomicBool::new(false) }
    }

    /// Asks for standstill, and waits for it, a `pause` of a millisecond at a time. [`Standstill::end`] ends it.
    ///
    /// # Errors
    /// [`Moving`] if the control core does not stop; it is no longer asked then.
    pub async fn begin<F: Future>(&self, mut pause: impl FnMut() -> F) -> Result<(), Moving> {
        self.wanted.store(true, Ordering::SeqCst);
        for _ in 0..PATIENCE {
            if self.standing.load(Ordering::SeqCst) {
                return Ok(());
            }
            pause().await;
        }
        self.end();
        Err(Moving)
    }

    /// Lets the control core go on.
    pub fn end(&self) {
        self.wanted.store(false, Ordering::SeqCst);
    }

    /// For the control core, at the end of a tick and with the motor unable to move: stands still as long as it is asked to.
    /// Whether it did: the ticks that were due meanwhile are not late.
    #[inline]
    pub fn stand(&self) -> bool {
        if !self.wanted.load(Ordering::SeqCst) {
            return false;
        }
        self.standing.store(true, Ordering::SeqCst);
        while self.wanted.load(Ordering::SeqCst) {
            core::hint::spin_loop();
        }
        self.standing.store(false, Ordering::SeqCst);
        true
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use embassy_futures::block_on;
    use std::sync::atomic::AtomicU32;

    #[test]
    fn nobody_stands_who_was_not_asked_or_no_longer_is() {
        let still = Standstill::new();
        assert!(!still.stand());
        // A control core that does not tick.
        assert_eq!(block_on(still.begin(|| core::future::ready(()))), Err(Moving));
        assert!(!still.stand());
    }

    #[test]
    fn the_control_core_stands_from_the_answer_to_the_end() {
        let still = Standstill::new();
        let ticks = AtomicU32::new(0);
        std::thread::scope(|scope| {
            let control = scope.spawn(|| {
                while !still.stand() {
                    ticks.fetch_add(1, Ordering::SeqCst);
                }
            });
            let pause = || {
                std::thread::sleep(std::time::Duration::from_millis(10));
                core::future::ready(())
            };
            block_on(still.begin(pause)).expect("it stops within its patience");
            let before = ticks.load(Ordering::SeqCst);
            for _ in 0..1_000 {
                std::thread::yield_now();
            }
            assert_eq!(ticks.load(Ordering::SeqCst), before, "it does not tick meanwhile");
            assert!(!control.is_finished());
            still.end();
            control.join().expect("it goes on");
        });
    }
}
