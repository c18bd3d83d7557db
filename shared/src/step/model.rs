//! What a drive that is gated is told of its motor, and the units that it reckons in: angles in 2^-20 count, speeds in that a tick.

use super::ConfigSpec;

/// A count, to 2^[`FINE`].
pub(super) const COUNT: i32 = 1 << FINE;
pub(super) const FINE: u32 = 20;
/// Fastest rotor, 8 counts a tick: twice that still leaves room for the product with an edge's age.
pub(super) const FASTEST: i32 = 8 * COUNT;
/// Longest delay, ticks: 4 ms at 500 µs. A motor farther behind is not led by pulses.
const LONGEST_DELAY: u8 = 8;
/// Longest pulse, and longest time from one pulse to the next, that may be asked for, ticks: 20 ms at 500 µs.
const LONGEST_PULSE: u8 = 40;
/// Errors beyond this are counted so far only, counts.
pub(super) const FARTHEST: i32 = 512;

/// What the controller is told of its motor, per tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Model {
    /// Speed at full drive.
    pub(super) full: i32,
    /// What the speed loses in a tick with the drive off.
    pub(super) braking: i32,
    /// Ticks² for which a push as strong as the braking has to bear before it moves the rotor by what an edge may be off.
    pub(super) noise_ticks: u32,
}

/// What an edge may be off by: a disc whose light is wider than its dark, a rotor that is not quite the one foretold; 0.15 of a count.
const EDGE_NOISE: u32 = COUNT as u32 / 20 * 3;

impl Model {
    /// The model of a configuration; `None` where it leaves what 32 bits hold.
    pub(super) fn of(spec: &ConfigSpec) -> Option<Self> {
        let period = u64::from(spec.period_us);
        let full = ((u64::from(spec.full_speed_counts_s) * period) << FINE) / 1_000_000;
        // A period is at most 10 000 µs: in this order both products fit.
        let braking = ((u64::from(spec.braking_counts_s2) * period * period / 1_000_000) << FINE) / 1_000_000;
        let inside = (1 << 12..=FASTEST as u64).contains(&full) && (1 << 5..=full).contains(&braking);
        let inside = inside
            && spec.delay_ticks <= LONGEST_DELAY
            && (1..=LONGEST_PULSE).contains(&spec.shortest_pulse_ticks)
            && (1..=LONGEST_PULSE).contains(&spec.pulse_period_ticks)
            && spec.reversal_rest_ticks > 0;
        inside.then_some(Self {
            full: full as i32,
            braking: braking as i32,
            noise_ticks: (EDGE_NOISE / (braking as u32).max(1)).clamp(1, 255),
        })
    }

    /// A speed at full drive as far as it may differ from the one told: by what motors, temperature, runout and load make of it.
    pub(super) fn about(&self, full: i32) -> i32 {
        full.max(self.full / 2).min(self.full / 5 * 8)
    }

    /// A braking likewise: up to a rotor that stands at once, but not down to one that nothing brakes, whose way is not to be
    /// foretold.
    pub(super) fn braked(&self, braking: i32) -> i32 {
        braking.max(self.braking / 2).min(self.full)
    }
}
