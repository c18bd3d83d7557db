//! One pulse a period: when it begins, and when it ends, where the drive may not be switched every tick.
//!
//! In a period T the target moves by r·T, and a rotor that follows it moves as far in one go and waits. It is off the least, on the
//! mean, where it is ahead at the one end of the wait by as much as it is behind at the other. So the pulse ends when the
//! rotor, run on and at rest, would be at the period's end behind the target by what makes the mean of such periods nothing.
//! Asking for no mean error in *this* period instead answers a pulse too short by one too long, for ever.

use super::Config;
use super::rotor::Rotor;
use crate::Direction;

/// What there is to be when a decision comes to bear, along the drive: 2^-12 count, and that a tick.
pub(super) struct Foretold {
    /// How far the rotor is ahead of its target.
    ahead: i32,
    speed: i32,
    rate: i32,
    braking: i32,
}

impl Foretold {
    /// From what is so in 2^-20 counts, clockwise.
    pub(super) const fn along(direction: Direction, rotor: &Rotor, ahead: i32, speed: i32, rate: i32) -> Self {
        let sign = direction.sign();
        let braking = rotor.slows(sign) >> 8;
        Self { ahead: (ahead >> 8) * sign, speed: (speed >> 8) * sign, rate: (rate >> 8) * sign, braking }
    }
}

/// Whether the drive is to be on in a tick in which it may be switched.
#[inline(always)]
pub(super) fn wants(config: &Config, rotor: &Rotor, at: &Foretold) -> bool {
    let period = i32::from(config.spec.pulse_period_ticks);
    let was_on = rotor.on & 1 == 1;
    let over = rotor.since >= config.spec.pulse_period_ticks;
    if !was_on && !over {
        return false;
    }
    let gone = if over { 0 } else { i32::from(rotor.since) };
    let left = period - gone;
    let Rest { way, sum } = rest(rotor, at, left);
    let (full, rate) = (config.model.full >> 8, at.rate);
    // Half a tick of full drive: what a tick more or less is closest to.
    if was_on {
        let behind_at_end = rate * left - at.ahead - way;
        // Behind its last place the rotor is, on the mean, by half of the way while the drive is on, and by what is left after it.
        let pulse = gone * ((rate * period + way) / 2) + way * left - sum;
        let middle = rate * period / 2 * period;
        period * behind_at_end > middle - pulse + full * period / 2
    } else {
        // A period without a pulse would leave the rotor behind on the mean.
        at.ahead * left + sum + full * left / 2 < rate * left / 2 * left
    }
}

/// What is left of a rotor's motion with the drive off.
struct Rest {
    /// How far it goes, 2^-12 count.
    way: i32,
    /// Sum over the ticks of how far it has gone.
    sum: i32,
}

/// A rotor of this speed, or what the dying wave leaves of it, braked over so many ticks.
#[inline(always)]
fn rest(rotor: &Rotor, at: &Foretold, ticks: i32) -> Rest {
    let speed = at.speed.max(0);
    let speed = if rotor.on & 1 == 1 { speed - speed / 4 } else { speed };
    let braking = at.braking.max(1);
    let stops = (speed.unsigned_abs() / braking.unsigned_abs()) as i32;
    if stops >= ticks {
        // The braking takes no more than the speed over these ticks: each product is below speed·ticks².
        let (way, sum) = (speed * ticks, speed * ticks / 2 * ticks);
        Rest { way: way - braking * ticks / 2 * ticks, sum: sum - braking * ticks / 6 * ticks * ticks }
    } else {
        let way = speed / 2 * stops;
        Rest { way, sum: way / 3 * (3 * ticks - stops) }
    }
}
