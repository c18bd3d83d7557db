//! From duty to supply: the PWM pin and what the driver makes of it.
//!
//! The off part of a period comes first (the pin is active low and starts high). A new duty takes effect at the next period, a
//! new direction at once.

use super::effects::EffectSet;
use super::hypothesis::{ActsOn, Now};
use super::plant::{Direction, Drive, Plant, Segment};

/// A command to the motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// When (s).
    pub time_s: f64,
    /// Fraction of the PWM period with the drive on, 0 to 1.
    pub duty: f64,
    /// Sense of rotation.
    pub direction: Direction,
}

/// The duty the driver works with in this direction: quantised, less the dead zone, bent at the top.
pub fn effective_duty(effects: &EffectSet, duty: f64, direction: Direction) -> f64 {
    let mut u = duty.clamp(0.0, 1.0);
    if u == 0.0 {
        return u;
    }
    for formula in &effects.formulas {
        u = (u + formula
            .change_of(ActsOn::Duty, &Now { duty, direction: f64::from(direction.sign()), ..Now::default() }))
        .clamp(0.0, 1.0);
    }
    if let Some(e) = effects.duty_quantisation
        && e.step > 0.0
    {
        // A whole number of steps may come out of the division a little below itself.
        let steps = if e.down > 0.5 { (u / e.step + 1e-9).floor() } else { (u / e.step).round() };
        u = (steps * e.step).min(1.0);
    }
    if let Some(e) = effects.dead_zone {
        u = (u - e.threshold_duty).max(0.0);
        if e.gate_duty > 0.0 {
            u /= 1.0 + (-(duty - e.gate_duty) / e.gate_width).exp();
        }
    }
    if let Some(e) = effects.high_duty_saturation {
        u /= 1.0 + e.bend * u.powf(e.bend_power);
        u = u.min(1.0 - e.flat_top);
        u /= 1.0 + u * e.inverse_us;
    }
    u.min(1.0)
}

/// How late the supply comes on (s) at a rise of the pin after it was off for `rest_s`.
pub fn start_delay_s(effects: &EffectSet, rest_s: f64) -> f64 {
    let grown = |rest: f64| if rest > 0.0 { 1.0 - (-rest_s / rest).exp() } else { 1.0 };
    effects.start_delay.map_or(0.0, |e| e.delay_s * grown(e.rest_s))
}

/// The PWM generator in front of a plant, with the effects of the actuator path.
#[derive(Debug, Clone)]
pub struct Pwm {
    period_s: f64,
    /// A time at which a period starts (s).
    phase_s: f64,
    effects: EffectSet,
    /// Commanded duty, the duty of the running period, and the direction.
    commanded: f64,
    running: f64,
    direction: Direction,
    /// Index of the running period.
    index: i64,
    /// When the supply comes on after the pin's last rise (s).
    supplied_s: f64,
    /// When the pin last went off (s).
    fell_s: f64,
    was_on: bool,
}

impl Pwm {
    /// A generator at `pwm_hz`, `pwm_phase_s` into a period at time 0.
    pub fn new(pwm_hz: f64, pwm_phase_s: f64, effects: &EffectSet) -> Self {
        let period_s = 1.0 / pwm_hz;
        let phase_s = -pwm_phase_s;
        Pwm {
            period_s,
            phase_s,
            effects: effects.clone(),
            commanded: 0.0,
            running: 0.0,
            direction: Direction::Cw,
            index: (-phase_s / period_s).floor() as i64,
            supplied_s: f64::NEG_INFINITY,
            fell_s: f64::NEG_INFINITY,
            was_on: false,
        }
    }

    /// Sets the duty from the next period on, and the direction from now on.
    pub fn command(&mut self, duty: f64, direction: Direction) {
        self.commanded = duty;
        self.direction = direction;
    }

    /// Sets the duty of the running period too: how a run begins.
    pub fn begin(&mut self, duty: f64, direction: Direction) {
        self.command(duty, direction);
        self.running = self.commanded;
    }

    /// Drives `plant` to `until_s`.
    pub fn advance(&mut self, plant: &mut impl Plant, until_s: f64, observe: &mut dyn FnMut(&Segment)) {
        while plant.time_s() < until_s {
            let now = plant.time_s();
            let mut start = self.phase_s + self.index as f64 * self.period_s;
            let mut end = start + self.period_s;
            while now >= end - 1e-12 {
                self.index += 1;
                self.running = self.commanded;
                start = self.phase_s + self.index as f64 * self.period_s;
                end = start + self.period_s;
            }
            let duty = effective_duty(&self.effects, self.running, self.direction);
            let rise = if duty > 0.0 { start + (1.0 - duty) * self.period_s } else { f64::INFINITY };
            let on = now >= rise - 1e-12;
            if on && !self.was_on {
                self.supplied_s = now + start_delay_s(&self.effects, now - self.fell_s);
            } else if self.was_on && !on {
                self.fell_s = now;
            }
            self.was_on = on;
            let mut next = until_s.min(end);
            let mut level = 0.0;
            if on {
                if now >= self.supplied_s - 1e-12 {
                    level = 1.0;
                } else {
                    next = next.min(self.supplied_s);
                }
            } else {
                next = next.min(rise);
            }
            plant.advance(next, Drive { level, direction: self.direction, duty: self.running }, observe);
        }
    }
}
