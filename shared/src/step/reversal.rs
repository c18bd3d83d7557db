//! When the direction may change, so that counts stay true on a rotor that coasts.
//!
//! A one-line encoder is counted in the sense of the direction pin. A rotor that still turns the old way after the pin has
//! changed is counted backwards, and what it was off by stays for the rest of the run. So the drive is taken off first, and
//! the pin follows when no edge has come for a while, or at the latest after a stated time: a rotor that nothing brakes never
//! comes to rest, and would otherwise never be driven back.

use super::ConfigSpec;
use serde::{Deserialize, Serialize};

/// What is left to wait for before the direction may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reversal {
    /// Ticks without an edge that are left; zero for a rotor at rest.
    pub rest_left: u16,
    /// Ticks left at the most.
    pub limit_left: u16,
    /// Position at the last tick, counts.
    pub position: i32,
}

impl Reversal {
    /// Nothing to wait for: a rotor that was never driven.
    pub const REST: Self = Self { rest_left: 0, limit_left: 0, position: 0 };

    /// The drive is on.
    #[inline(always)]
    pub(super) fn drives(&mut self, spec: &ConfigSpec, position: i32) {
        *self = Self { rest_left: spec.reversal_rest_ticks, limit_left: spec.reversal_limit_ticks, position };
    }

    /// The drive is off, or is to be. Gives whether the direction may change.
    #[inline(always)]
    pub(super) fn waits(&mut self, spec: &ConfigSpec, position: i32) -> bool {
        if position != self.position {
            self.rest_left = spec.reversal_rest_ticks;
            self.position = position;
        }
        let may = self.rest_left == 0 || self.limit_left == 0;
        self.rest_left = self.rest_left.saturating_sub(1);
        self.limit_left = self.limit_left.saturating_sub(1);
        may
    }
}
