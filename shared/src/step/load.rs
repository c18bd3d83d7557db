//! What a rotor that runs on says of the torque on it.
//!
//! With the drive off the rotor is braked by a friction that is known, so how far it runs on tells what else pulls at it. The drive itself
//! tells hardly anything: a motor gives way to a torque by a per cent of its speed, which a turn's runout takes and gives ten
//! times over (docs/control.md). One number is estimated, by Kalman's filter over the edges: what an edge is off by, over how much a
//! push of one would have moved it there.

use super::model::{COUNT, Model};
use serde::{Deserialize, Serialize};

/// Edges from which the rotor is learnt before anything that it does is taken for a load: a turn of the encoder that this is for, so
/// that its runout is in it; no hand may be on the rotor then. The first half of them is as without a hand, the second tells speed and
/// braking apart as the load will be told.
const TAUGHT: u16 = 400;
/// A variance is in 2^-12 of the square of the braking: this is a load that may be as large as what the rotor bears.
const ANY: u16 = 1 << 12;
/// What a tick adds to it: a hand that changes its mind within a sixth of a second (341 ticks) by half of what the rotor bears.
const WANDERS: u16 = 3;
/// Up to here the estimate is worth something: its deviation is half of what the rotor bears.
const WORTH: u16 = 1 << 10;
/// What an edge tells goes to the braking by so little while the rotor is learnt: eight such constants in the half turn there is.
const TEACHES: i32 = 24;
/// And by so little of what goes to the load afterwards: slow against a hand, as what both directions have in common is the rotor's own.
const UNLEARNS: i32 = 32;
/// Longest motion that is reckoned with, ticks and ticks², so that products stay within 32 bits.
const LONGEST: u16 = 255;

/// The load on the rotor, as it is believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Load {
    /// What it adds to the speed in a tick, clockwise, 2^-20 count a tick.
    pub pushes: i32,
    /// Its variance, 2^-12 of the square of the braking.
    pub doubt: u16,
    /// For how long a push has come to bear on the speed: with the drive off only, ticks.
    pub speed_ticks: u16,
    /// How far a push of one has moved the rotor since the last edge, ticks².
    pub place_ticks: u16,
    /// Edges seen, up to those that teach what the rotor is without a load.
    pub edges: u16,
}

impl Load {
    /// Nothing known.
    pub const REST: Self = Self { pushes: 0, doubt: ANY, speed_ticks: 0, place_ticks: 0, edges: 0 };

    /// Whether the rotor is known well enough for the rest to be the load's.
    pub(super) const fn is_taught(&self) -> bool {
        self.edges >= TAUGHT
    }

    /// Whether it is known well enough to be told apart from a load.
    pub(super) const fn is_known_roughly(&self) -> bool {
        self.edges >= TAUGHT / 2
    }

    /// The largest that is believed: beyond it a rotor at rest is near to being dragged away, uncounted.
    const fn largest(braking: i32) -> i32 {
        braking - braking / 4
    }

    /// No more is believed than a rotor that is braked so bears, whatever a state that was recorded says.
    #[inline(always)]
    pub(super) fn is_borne(&mut self, braking: i32) {
        let largest = Self::largest(braking);
        self.pushes = self.pushes.max(-largest).min(largest);
    }

    /// A tick, under a drive or none, of a rotor that moves or does not.
    #[inline(always)]
    pub(super) fn passes(&mut self, drives: bool, moves: bool) {
        self.doubt = self.doubt.saturating_add(WANDERS).min(ANY);
        let bears = self.speed_ticks.min(LONGEST);
        self.speed_ticks = match (drives, moves) {
            // The drive takes the rotor to its own speed, 5/8 of what is missing in a tick.
            (true, _) => bears * 3 / 8,
            (false, true) => bears + 1,
            (false, false) => 0,
        };
        self.place_ticks = self.place_ticks.saturating_add(self.speed_ticks).min(LONGEST);
        if self.doubt > WORTH {
            self.pushes -= self.pushes / 512;
        }
    }

    /// An edge, or that there is none: the rotor is farther by `error` than foretold, 2^-20 count. Gives by what it is to be taken to
    /// be pushed, beside the load, 2^-20 count a tick.
    #[inline(always)]
    pub(super) fn tells(&mut self, model: &Model, error: i32) -> i32 {
        let ticks = u32::from(self.place_ticks.min(LONGEST));
        self.place_ticks = 0;
        if ticks == 0 {
            return 0;
        }
        let known = u32::from(self.doubt.min(ANY)) * ticks * ticks;
        let noise = (model.noise_ticks * model.noise_ticks) << 12;
        let gain = (known / ((known + noise) >> 8).max(1)).min(1 << 8);
        // A jump by more than a count is no motion of this rotor.
        let push = error.clamp(-COUNT, COUNT) / ticks as i32;
        let push = (push * gain as i32) >> 8;
        if !self.is_taught() {
            return push / TEACHES;
        }
        self.pushes += push;
        self.doubt -= ((u32::from(self.doubt) * gain) >> 8) as u16;
        push / UNLEARNS
    }

    /// An edge was seen.
    pub(super) fn counts(&mut self) {
        self.edges = self.edges.saturating_add(1).min(TAUGHT);
    }

    /// The load, where the estimate is worth something.
    #[inline(always)]
    pub(super) fn worth(&self, braking: i32) -> Option<i32> {
        let is_inside = self.pushes.unsigned_abs() < Self::largest(braking).unsigned_abs();
        (self.is_taught() && self.doubt <= WORTH && is_inside).then_some(self.pushes)
    }
}
