//! One run: pulses, stator, contact and rotor, step by step.

use super::acting::{Acting, Moment};
use super::bench::{Bench, normal};
use super::bristles::{Grip, Rotor};
use super::motor::Motor;
use super::stator::{Stator, Tuning};
use crate::drive::Drive;
use crate::profile::random::Dice;

/// Spacing of the angles that a run is followed in, in s: both PWM periods are whole numbers of it.
pub const CELL_S: f64 = 0.25e-3;

/// How rough the contact of a run is: its friction wanders by chance.
#[derive(Debug, Clone)]
pub struct Roughness {
    dice: Dice,
    deviation: f64,
    keep: f64,
    now: f64,
}

impl Roughness {
    /// As rough as a bench says.
    pub fn new(bench: &Bench, dice: Dice) -> Self {
        let [deviation, stays_s] = bench.rough;
        Self { dice, deviation, keep: (-CELL_S / stays_s).exp(), now: 0.0 }
    }

    /// Factor on the friction in the next cell.
    fn next(&mut self) -> f64 {
        self.now = self.keep * self.now + (1.0 - self.keep * self.keep).sqrt() * normal(&mut self.dice);
        1.0 + self.deviation * self.now
    }
}

/// When the drive is on in a PWM period, in s: its end, as the pin is low for the on fraction and goes low last.
fn window(drive: &Drive, acting: &Acting, duty: f64, pulse: u64) -> [f64; 2] {
    let period = 1.0 / drive.pwm_hz;
    let start = pulse as f64 * period;
    let off_s = (1.0 - duty) * period;
    // A pulse as long as its period has no beginning but the first.
    let late = if off_s > 1e-9 || pulse == 0 { acting.delay(if pulse == 0 { 1.0 } else { off_s }) } else { 0.0 };
    let to = (start + period).min(drive.seconds);
    [(start + off_s + late).min(to), to]
}

/// Angles in rad every [`CELL_S`] of true time up to `until`, from `zero` on.
pub fn followed(
    motor: &Motor,
    drive: &Drive,
    acting: &mut Acting,
    mut rough: Option<Roughness>,
    [zero, gain, until]: [f64; 3],
) -> Vec<f64> {
    let steps = motor.steps();
    let dt = CELL_S / steps as f64;
    let mut stator = Stator::new(motor, dt);
    let mut rotor = Rotor::default();
    let own = Grip::of(motor);
    let duty = acting.duty();
    let cells = (until / CELL_S) as usize + 1;
    let mut angles = Vec::with_capacity(cells + 1);
    angles.push(zero);
    let (mut pulse, mut on) = (u64::MAX, [0.0; 2]);
    for n in 0..cells {
        let t = n as f64 * CELL_S;
        let current = ((t + 1e-9) * drive.pwm_hz) as u64;
        if current != pulse {
            pulse = current;
            on = window(drive, acting, duty, pulse);
        }
        let middle = t + 0.5 * CELL_S;
        let driven = middle > on[0] && middle < on[1];
        let moment = Moment { t, dt: CELL_S, on: driven, pulse, since_on: (t - on[0]).max(0.0), rotor, zero };
        let f = acting.factors(&moment);
        stator.tune(Tuning {
            detuning: motor.detuning + f.detuning,
            quadrature: motor.quadrature + f.quadrature,
            sign: drive.sign,
        });
        let speed = f.speed * gain;
        let friction = speed * rough.as_mut().map_or(1.0, Roughness::next);
        let grip = Grip {
            contact: own.contact * f.contact * friction,
            brake: own.brake * f.brake * friction,
            renewal: own.renewal * speed,
            ..own
        };
        let full = motor.full * speed;
        for k in 0..steps {
            let from = t + k as f64 * dt;
            let share = ((on[1].min(from + dt) - on[0].max(from)) / dt).max(0.0);
            stator.step(f.voltage * share);
            let [surface, amplitude] = stator.surface();
            let surface = full * surface;
            if acting.quick {
                let now = acting.grip(&grip, &rotor, surface, amplitude);
                rotor.step(&now, surface, amplitude, dt);
            } else {
                rotor.step(&grip, surface, amplitude, dt);
            }
        }
        angles.push(zero + rotor.angle);
    }
    angles
}
