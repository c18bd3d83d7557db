//! Whether the encoder shows what any motor must have done under the drive it was given.
//!
//! Two judgements, both of drive (duty times time) and not of time alone, so that they hold for any duty and any reference:
//!
//! - **No edge.** The identified motor's speed is proportional to the duty, so the drive since the last edge is an angle. Past
//!   the budget of [`Limits`](crate::safety::Limits) it is a stall: a quarter of a second of full drive by default, 52°.
//! - **Too few edges.** What the slowest motor that [`Limits`](crate::safety::Limits) allow for would have made of the drive is owed, and every edge
//!   pays for itself. Nothing is forgiven with time, and nothing is paid in advance: a motor that turns at that speed or faster
//!   owes an edge or two, whatever the reference; what is owed beyond a share of a turn is a stall. So whatever the line
//!   shows, and for however long, the slowest motor would have turned by no more than what is shown and that.

use crate::Duty;
use crate::message::Configuration;
use crate::step::{ConfigSpec, DriveLaw};

/// The default budget is 250 ms of full drive, in which the identified motor, at 35 rpm, makes 7/48 of a turn.
const BUDGET_TURNS: (u64, u64) = (7, 48);
/// What may be owed, a fifty-sixth of a turn: 7 of 400 edges. The motors of every flavour, with every effect that a simulated board can
/// have, owe 2.4 at the most.
const OWED_SHARE_OF_TURN: u16 = 56;
/// Of a coarse encoder an edge and the next, because the first may come a whole pitch after the start.
const LEAST_OWED: u16 = 2;
/// The PWM frequency up to which the slowest speed was held against motors, Hz. Above it each period is more of a start, and an edge
/// pays for in proportion more.
const HELD_AGAINST_HZ: u16 = 50;
/// An edge is this power of two of what is owed: at the smallest duty a tick of the shortest period still owes some hundreds.
const EDGE_BITS: u32 = 24;
/// More than the finest encoder's 178, and with what a tick adds at the most still within 32 bits.
const MOST_OWED: u16 = 192;
const MOST_A_TICK: u64 = 1 << (EDGE_BITS + 5);

/// The judge of a run.
#[derive(Clone, Debug, Default)]
pub struct Stall {
    rules: Rules,
    /// Duties of the ticks since the last edge, added up.
    driven: u32,
    owed: u32,
}

#[derive(Clone, Copy, Debug, Default)]
struct Rules {
    /// Duties of ticks that may pass without an edge.
    budget: u32,
    owed_at_most: u32,
    /// The duty below which the slowest speed falls with the duty's square.
    start: u32,
    /// What a tick of full drive owes, by the slowest speed.
    full: u32,
    /// That times 2^15, over `start`.
    square: u32,
}

impl Rules {
    fn new(configuration: &Configuration) -> Self {
        let (limits, per_turn) = (&configuration.limits, configuration.edges_per_rev);
        let period_us = u64::from(configuration.control.period_us).max(1);
        // A gated drive goes on until the rotor is where it is to be; of a pulse that a motor does follow, half may go into the start.
        let pwm_hz = match configuration.control.law {
            DriveLaw::Gated => u64::from(2 * HELD_AGAINST_HZ),
            DriveLaw::ActiveLowTruncated | DriveLaw::OnTimeRounded => {
                u64::from(configuration.pwm_hz.max(HELD_AGAINST_HZ))
            }
        };
        // Duty times µs.
        let budget = u64::from(limits.stall_duty) * u64::from(limits.stall_ms) * 1_000;
        let (turns, of) = BUDGET_TURNS;
        // Edges in a tick at full speed are `moved / drive`; the shift by EDGE_BITS is shared by both, and so is the budget's by 15,
        // so that nothing leaves 64 bits.
        let moved = (u64::from(per_turn) * turns * period_us * u64::from(HELD_AGAINST_HZ)) << (15 + EDGE_BITS - 13);
        let drive = (of * pwm_hz * budget) >> 13;
        let slowest = (moved / drive.max(1)).min(MOST_A_TICK) * u64::from(limits.slowest_percent) / 100;
        let full = match configuration.control.law {
            DriveLaw::Gated => slowest.max(told(&configuration.control).min(MOST_A_TICK)),
            DriveLaw::ActiveLowTruncated | DriveLaw::OnTimeRounded => slowest,
        };
        let start = u32::from(limits.slow_start_duty);
        let in_range = |value| u32::try_from(value).unwrap_or(u32::MAX);
        Self {
            budget: in_range(budget / period_us),
            owed_at_most: u32::from((per_turn / OWED_SHARE_OF_TURN).clamp(LEAST_OWED, MOST_OWED)) << EDGE_BITS,
            start,
            full: in_range(full),
            square: in_range((full << 15) / u64::from(start.max(1))),
        }
    }

    /// What a tick at this duty owes.
    const fn owed(&self, duty: u32) -> u32 {
        // A duty has 15 bits after the point, its square 30.
        if duty < self.start { upper((duty * duty) << 2, self.square) } else { upper(duty << 16, self.full) << 1 }
    }
}

/// What a tick of full drive owes of a motor whose speed the controller is told: it takes it for half as fast at the least, and of each
/// pulse half may go into the start.
fn told(control: &ConfigSpec) -> u64 {
    ((u64::from(control.full_speed_counts_s) * u64::from(control.period_us)) << EDGE_BITS) / 4_000_000
}

/// The upper half of a product.
const fn upper(a: u32, b: u32) -> u32 {
    ((a as u64 * b as u64) >> 32) as u32
}

impl Stall {
    /// A judge by the limits, encoder, PWM and control period of a validated configuration.
    pub fn new(configuration: &Configuration) -> Self {
        Self { rules: Rules::new(configuration), ..Self::default() }
    }

    /// The same judgement of a new run.
    pub fn anew(&self) -> Self {
        Self { rules: self.rules, ..Self::default() }
    }

    /// Whether it is a stall, after a control period at this duty in which so many edges came.
    #[inline]
    pub fn check(&mut self, duty: Duty, edges: u32) -> bool {
        let duty = u32::from(duty.raw());
        // Neither sum can wrap before it is a stall, which ends the run and with it this judge.
        self.owed = self.owed.wrapping_add(self.rules.owed(duty));
        if edges == 0 {
            self.driven = self.driven.wrapping_add(duty);
        } else {
            self.driven = 0;
            // More than 255 in a tick are chatter, and pay too little.
            self.owed = self.owed.saturating_sub(edges << EDGE_BITS);
        }
        (self.driven > self.rules.budget) | (self.owed > self.rules.owed_at_most)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::step::ConfigSpec;

    fn configuration() -> Configuration {
        Configuration::with_control(ConfigSpec::DEFAULT)
    }

    /// Ticks of 500 µs until it is a stall, with an edge every so many ticks.
    fn ticks_of(configuration: &Configuration, duty: Duty, every: u32) -> Option<u32> {
        let mut stall = Stall::new(configuration);
        (1..200_000).find(|tick| stall.check(duty, u32::from(every > 0 && tick % every == 0)))
    }

    fn ticks(duty: Duty, every: u32) -> Option<u32> {
        ticks_of(&configuration(), duty, every)
    }

    /// A motor that is known to turn in proportion to the duty, at this many percent at least.
    fn known(percent: u8) -> Configuration {
        let mut configuration = configuration();
        (configuration.limits.slowest_percent, configuration.limits.slow_start_duty) = (percent, 0);
        configuration
    }

    #[test]
    fn a_standing_encoder_is_a_stall_within_the_same_drive_at_any_duty() {
        for (on, of) in [(1, 32), (1, 10), (249, 1_000), (1, 2), (1, 1)] {
            let budget = 500.0 * f64::from(of) / f64::from(on);
            let ticks = f64::from(ticks(Duty::from_ratio(on, of), 0).unwrap());
            assert!(ticks < budget + 3.0, "{on}/{of}: {ticks} for {budget}");
            // Where so little drive brings no edges anyhow, it is their absence alone that counts.
            assert!(on * 20 > of || ticks > budget - 3.0, "{on}/{of}: {ticks} for {budget}");
        }
        assert_eq!(ticks(Duty::OFF, 0), None);
    }

    #[test]
    fn an_edge_now_and_then_hides_no_drive_and_a_quarter_of_the_speed_is_enough() {
        // One edge in 400 ms.
        assert_eq!(ticks(Duty::FULL, 800), Some(241));
        assert_eq!(ticks(Duty::from_ratio(1, 2), 800), Some(481));
        assert!(ticks(Duty::from_ratio(1, 10), 800).is_some());
        // 233 counts/s at full drive is an edge in 8.6 ticks; here in 34 and in 36.
        assert_eq!(ticks(Duty::FULL, 34), None);
        assert!(ticks(Duty::FULL, 36).is_some());
    }

    #[test]
    fn what_is_missing_adds_up_however_slowly_and_what_was_shown_before_pays_nothing_later() {
        // An edge in 400 ms at a duty of 1/20, where the known motor makes 4.7: hidden for ever when 8 s are judged by themselves.
        assert_eq!(ticks(Duty::from_ratio(1, 20), 800), None);
        let owing = ticks_of(&known(80), Duty::from_ratio(1, 20), 800).unwrap();
        // 9.3 edges/s are owed and 2.5 shown, of 7 that may be.
        assert!((1_900..1_960).contains(&owing), "{owing}");
        // After a minute of the full speed a dead line is found as soon as from standstill.
        let mut stall = Stall::new(&configuration());
        assert!((1..=120_000).all(|tick| !stall.check(Duty::FULL, u32::from(tick % 8 == 0))));
        assert_eq!((1..1_000).find(|_| stall.check(Duty::FULL, 0)), Some(241));
    }

    #[test]
    fn no_configuration_that_validates_leaves_the_integers() {
        let mut configuration = known(100);
        let every = [(2, 10, 100), (2, 2_000, 10_000), (10_000, 10, 10_000), (10_000, 2_000, 100), (400, 50, 500)];
        let limits = [(1, 1), (1, 2_000), (32_768, 1), (32_768, 2_000)];
        let slowest = [(1, 0), (100, 0), (100, 1), (100, 32_768), (1, 32_768)];
        for ((edges_per_rev, pwm_hz, period_us), (stall_duty, stall_ms), (slowest_percent, slow_start_duty)) in every
            .into_iter()
            .flat_map(|e| limits.into_iter().flat_map(move |l| slowest.into_iter().map(move |s| (e, l, s))))
        {
            (configuration.edges_per_rev, configuration.pwm_hz) = (edges_per_rev, pwm_hz);
            configuration.control.period_us = period_us;
            let l = &mut configuration.limits;
            (l.stall_duty, l.stall_ms, l.slowest_percent, l.slow_start_duty) =
                (stall_duty, stall_ms, slowest_percent, slow_start_duty);
            assert_eq!(l.validate(), Ok(()));
            let mut stall = Stall::new(&configuration);
            // The budget's drive, of which no more than the product of its duty and time passes without an edge.
            let budget_us = (u64::from(stall_duty) * u64::from(stall_ms) * 1_000) >> 15;
            let within = budget_us / u64::from(period_us) + 2;
            assert!((0..within).any(|_| stall.check(Duty::FULL, 0)), "{configuration:?}");
            assert!(!stall.check(Duty::OFF, u32::MAX), "{configuration:?}");
        }
    }
}
