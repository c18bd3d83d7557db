//! Whether the encoder shows what any motor must have done under the drive it was given.
//!
//! Two judgements, both of drive (duty times time) and not of time alone, so that they hold for any duty and any reference:
//!
//! - **No edge.** The identified motor's speed is proportional to the duty, so the drive since the last edge is an angle. Past
//!   the budget of [`Limits`](twum_shared::safety::Limits) it is a stall: a quarter of a second of full drive by default, 52°.
//! - **Too few edges.** One edge now and then hides nothing: in every half budget there have to be a fortieth of a turn's
//!   edges, a third of what the identified motor makes at full drive. Here the drive counts by the square of the duty,
//!   which no motor that starts and stops with every PWM period falls short of; above 50 Hz, where each period is little
//!   more than a start, in proportion less.

use twum_shared::Duty;
use twum_shared::message::Configuration;

/// The PWM frequency at which the square of the duty was held against motors, Hz.
const SQUARE_LAW_HZ: u64 = 50;
/// The share of a turn that a half budget has to bring.
const SHARE_OF_TURN: u32 = 40;

#[derive(Debug, Default)]
pub(super) struct Stall {
    /// Drive that may pass without an edge, 1/32768ths of full drive times µs.
    budget: u64,
    /// Drive (by the square of the duty) in which `needed` edges have to come.
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
        let window = budget / 2 * u64::from(configuration.pwm_hz).max(SQUARE_LAW_HZ) / SQUARE_LAW_HZ;
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
        // A duty is at most 2^15, so its square fits.
        self.driven_in_window += u64::from((duty * duty) >> 15) * u64::from(period_us);
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
    fn a_standing_encoder_is_a_stall_after_the_same_drive_at_any_duty() {
        for (on, of) in [(1, 32), (1, 10), (249, 1_000), (1, 2), (1, 1)] {
            let budget = 500.0 * f64::from(of) / f64::from(on);
            let ticks = f64::from(ticks(Duty::from_ratio(on, of), 0).unwrap());
            assert!((ticks - budget).abs() < 3.0, "{on}/{of}: {ticks} for {budget}");
        }
        assert_eq!(ticks(Duty::OFF, 0), None);
    }

    #[test]
    fn an_edge_now_and_then_hides_no_drive_and_a_third_of_the_speed_is_enough() {
        // One edge in 400 ms.
        assert_eq!(ticks(Duty::FULL, 800), Some(250));
        assert_eq!(ticks(Duty::from_ratio(1, 2), 800), Some(1_000));
        // 233 counts/s at full drive is an edge in 8.6 ticks.
        assert_eq!(ticks(Duty::FULL, 24), None);
        assert_eq!(ticks(Duty::FULL, 26), Some(250));
    }
}
