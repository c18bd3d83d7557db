//! Whether the encoder shows what any motor must have done under the drive it was given.
//!
//! Two judgements, both of drive (duty times time) and not of time alone, so that they hold for any duty and any reference:
//!
//! - **No edge.** The identified motor's speed is proportional to the duty, so the drive since the last edge is an angle. Past
//!   the budget of [`Limits`](twum_shared::safety::Limits) it is a stall: a quarter of a second of full drive by default, 52°.
//! - **Too few edges.** One edge now and then hides nothing. A quarter of the identified motor's speed counts as the slowest
//!   that it turns at, and below a seventh of the duty, where a motor that starts slowly anew with every PWM period falls short
//!   of that, 7/4 of the duty's square, three quarters of such a motor's. What this makes of an eighth of the budget has to come
//!   as edges; above 50 Hz, where each period is little more than a start, of in proportion more.

use twum_shared::Duty;
use twum_shared::message::Configuration;

/// The PWM frequency at which the slowest speed was held against motors, Hz.
const HELD_AGAINST_HZ: u64 = 50;
/// An eighth of the default budget is 31 ms of full drive, in which the identified motor makes 7.3 of 400 edges.
const WINDOWS_PER_BUDGET: u64 = 8;
const SHARE_OF_TURN: u32 = 56;

#[derive(Debug, Default)]
pub(super) struct Stall {
    /// Drive that may pass without an edge, 1/32768ths of full drive times µs.
    budget: u64,
    /// Drive, weighed by [`slowest`], in which `needed` edges have to come.
    window: u64,
    needed: u32,
    driven: u64,
    driven_in_window: u64,
    edges_in_window: u32,
}

impl Stall {
    pub fn new(configuration: &Configuration) -> Self {
        let limits = &configuration.limits;
        let budget = u64::from(limits.stall_duty) * u64::from(limits.stall_ms) * 1_000;
        let window =
            budget / WINDOWS_PER_BUDGET * u64::from(configuration.pwm_hz).max(HELD_AGAINST_HZ) / HELD_AGAINST_HZ;
        let needed = u32::from(configuration.edges_per_rev) / SHARE_OF_TURN;
        Self { budget, window, needed, ..Self::default() }
    }

    /// The same judgement of a new run.
    pub fn anew(&self) -> Self {
        Self { budget: self.budget, window: self.window, needed: self.needed, ..Self::default() }
    }

    /// Whether it is a stall, after a period at this duty in which so many edges came.
    pub fn check(&mut self, period_us: u32, duty: Duty, edges: u32) -> bool {
        let duty = u32::from(duty.raw());
        self.driven = if edges == 0 { self.driven + u64::from(duty) * u64::from(period_us) } else { 0 };
        self.driven_in_window += u64::from(slowest(duty)) * u64::from(period_us);
        self.edges_in_window = self.edges_in_window.saturating_add(edges);
        if self.driven > self.budget {
            return true;
        }
        if self.driven_in_window < self.window {
            return false;
        }
        let too_few = self.edges_in_window < self.needed;
        (self.driven_in_window, self.edges_in_window) = (0, 0);
        too_few
    }
}

/// The slowest speed of a motor under this duty, 1/32768ths of full speed. A duty is at most 2^15, so its square fits.
const fn slowest(duty: u32) -> u32 {
    let (square, linear) = (((duty * duty) >> 17) * 7, duty >> 2);
    if square < linear { square } else { linear }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use twum_shared::step::ConfigSpec;

    fn stall() -> Stall {
        Stall::new(&Configuration::with_control(ConfigSpec::DEFAULT))
    }

    /// Ticks of 500 µs until it is a stall, with an edge every so many ticks.
    fn ticks(duty: Duty, every: u32) -> Option<u32> {
        let mut stall = stall();
        (1..200_000).find(|tick| stall.check(500, duty, u32::from(every > 0 && tick % every == 0)))
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
        assert_eq!(ticks(Duty::FULL, 800), Some(250));
        assert_eq!(ticks(Duty::from_ratio(1, 2), 800), Some(500));
        assert!(ticks(Duty::from_ratio(1, 10), 800).is_some());
        // 233 counts/s at full drive is an edge in 8.6 ticks; here in 34 and in 36.
        assert_eq!(ticks(Duty::FULL, 34), None);
        assert_eq!(ticks(Duty::FULL, 36), Some(250));
    }
}
