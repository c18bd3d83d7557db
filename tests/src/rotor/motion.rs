//! The rotor in time: one scalar equation, stepped implicitly between the switching instants of the PWM.

use super::effects::{Acting, Factors};
use super::shape::{between, log_between, one_of};
use crate::drive::Drive;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Acceleration that the listed motor's contact gives its rotor: 0.1057 · 1 N · 13.675 mm / 7.6558e-7 kg·m², in rad/s².
pub const LISTED_CONTACT: f64 = 1888.0;

/// Longest time from rest to the crest's speed in s.
const SLOWEST_S: f64 = 12e-3;

/// How the contact's friction saturates over the slip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Saturation {
    /// Linear, then constant.
    Clamp,
    /// Hyperbolic tangent.
    Tanh,
    /// x / √(1 + x²).
    Root,
}

impl Saturation {
    /// Value and slope.
    fn at(self, x: f64) -> (f64, f64) {
        match self {
            Saturation::Clamp => (x.clamp(-1.0, 1.0), if x.abs() < 1.0 { 1.0 } else { 0.0 }),
            Saturation::Tanh => {
                let y = x.tanh();
                (y, 1.0 - y * y)
            }
            Saturation::Root => {
                let r = 1.0 / (1.0 + x * x).sqrt();
                (x * r, r * r * r)
            }
        }
    }
}

/// A motor of the kind.
#[derive(Debug, Clone, PartialEq)]
pub struct Rotor {
    /// Speed of the wave's crest under full drive in rad/s.
    pub crest: f64,
    /// Largest contact torque over inertia in rad/s².
    pub contact: f64,
    /// Friction with the wave gone over inertia in rad/s².
    pub brake: f64,
    /// Viscous damping over inertia in 1/s.
    pub viscous: f64,
    /// Time constant of the wave in s.
    pub wave_s: f64,
    /// Slip over the crest's speed at which the contact saturates.
    pub slip: f64,
    /// How it does.
    pub saturation: Saturation,
    /// Share of the contact with which a wave that comes or goes holds back a rotor faster than its crest.
    pub dying: f64,
}

impl Rotor {
    /// Draws one: 10 to 100 rpm, a tenth to ten times the listed friction, from nearly coasting to clamped.
    pub fn draw(rng: &mut ChaCha8Rng) -> Self {
        let crest = log_between(rng, 10.0, 100.0) * TAU / 60.0;
        // Where speed takes longer than a PWM period, pulses add up until the rotor is at the crest, whatever the duty.
        let contact = (LISTED_CONTACT * log_between(rng, 0.1, 10.0)).max(crest / SLOWEST_S);
        let share = match one_of(rng, &[0, 1, 1, 2, 2]) {
            0 => log_between(rng, 0.003, 0.03),
            1 => log_between(rng, 0.05, 0.6),
            _ => between(rng, 0.7, 1.3),
        };
        Self {
            crest,
            contact,
            brake: contact * share,
            viscous: log_between(rng, 0.05, 3.0),
            wave_s: log_between(rng, 0.1e-3, 1.5e-3),
            slip: log_between(rng, 0.003, 0.05),
            saturation: one_of(rng, &[Saturation::Clamp, Saturation::Tanh, Saturation::Root]),
            dying: if rng.random() { 1.0 } else { between(rng, 0.0, 0.3) },
        }
    }

    /// The numbers, for the sealed file.
    pub fn numbers(&self) -> BTreeMap<String, f64> {
        [
            ("crest_rpm", self.crest * 60.0 / TAU),
            ("contact_rad_s2", self.contact),
            ("brake_rad_s2", self.brake),
            ("viscous_per_s", self.viscous),
            ("wave_s", self.wave_s),
            ("slip", self.slip),
            ("dying", self.dying),
        ]
        .map(|(k, v)| (k.to_owned(), v))
        .into()
    }

    /// The motor with one of its own parameters a little changed, for the linear refit.
    pub fn nudged(&self, k: usize) -> Self {
        let mut r = self.clone();
        match k {
            0 => r.crest *= 1.005,
            1 => r.contact *= 1.03,
            2 => r.brake *= 1.03,
            3 => r.viscous += 0.05,
            _ => r.wave_s *= 1.05,
        }
        r
    }

    /// How many parameters [`Self::nudged`] knows.
    pub const PARAMETERS: usize = 5;

    /// Net acceleration at speed `w`, and its slope, with the wave at `wave` and what acts on it.
    fn acceleration(&self, w: f64, wave: f64, f: &Factors) -> (f64, f64) {
        let grown = (wave / 0.05).min(1.0);
        let brake = self.brake * f.brake;
        // A wave that comes or goes need not hold back a rotor that is faster than its crest.
        let partial = wave < 0.8 && w > wave * self.crest * f.gain;
        let held = if partial { self.dying } else { 1.0 };
        let grip = brake + (self.contact * f.grip - brake) * grown * held;
        // Against the stator at rest there is no crest to creep on.
        let width = (self.slip + f.slip) * self.crest * (0.05 + 0.95 * grown);
        let (pull, slope) = self.saturation.at((wave * self.crest * f.gain - w) / width);
        let still = 2e-3 * self.crest;
        let (hold, hold_slope) = self.saturation.at(w / still);
        (
            grip * pull - self.viscous * w - f.drag * hold + f.load,
            -grip * slope / width - self.viscous - f.drag * hold_slope / still,
        )
    }

    /// Speed after `dt`: the root of x = w + dt · acceleration(x), which is the only one.
    pub fn after(&self, w: f64, wave: f64, f: &Factors, dt: f64) -> f64 {
        let (a, _) = self.acceleration(w, wave, f);
        let (mut low, mut high) = if a > 0.0 { (w, w + dt * a) } else { (w + dt * a, w) };
        let mut x = w + dt * a;
        for _ in 0..12 {
            let (a, slope) = self.acceleration(x, wave, f);
            let miss = x - w - dt * a;
            if miss.abs() < 1e-6 * self.crest {
                break;
            }
            if miss > 0.0 {
                high = x
            } else {
                low = x
            }
            let newton = x - miss / (1.0 - dt * slope);
            x = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        }
        x
    }
}

/// One step of the rotor: times, travelled angles and speeds at both ends.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    /// Times in s.
    pub t: [f64; 2],
    /// Travelled angle in rad, positive along the drive.
    pub angle: [f64; 2],
    /// Speed in rad/s.
    pub speed: [f64; 2],
}

/// A rotor under way.
pub struct Motion<'a> {
    rotor: &'a Rotor,
    drive: Drive,
    acting: Acting<'a>,
    gain: f64,
    t: f64,
    wave: f64,
    speed: f64,
    angle: f64,
}

impl<'a> Motion<'a> {
    /// At rest at t = 0, with the run's own factor on the crest's speed and its pull.
    pub fn new(rotor: &'a Rotor, drive: Drive, acting: Acting<'a>, gain: f64) -> Self {
        Self { rotor, drive, acting, gain, t: 0.0, wave: 0.0, speed: 0.0, angle: 0.0 }
    }

    /// Runs until `until`, handing each step to `sink`.
    pub fn run(&mut self, until: f64, sink: &mut dyn FnMut(&Step)) {
        let period = 1.0 / self.drive.pwm_hz;
        let duty = self.acting.duty(self.drive.duty);
        let mut pulse = 0;
        while self.t < self.drive.seconds.min(until) - 1e-12 {
            let start = f64::from(pulse) * period;
            let late = self.acting.delay(pulse, (1.0 - duty) * period, self.angle);
            let on_from = start + ((1.0 - duty) * period + late).min(period);
            let stop = (start + period).min(self.drive.seconds).min(until);
            self.segment(on_from.min(stop), false, sink);
            self.segment(stop, true, sink);
            pulse += 1;
        }
        self.segment(until, false, sink);
    }

    fn segment(&mut self, until: f64, on: bool, sink: &mut dyn FnMut(&Step)) {
        let rotor = self.rotor;
        let start = self.t;
        let swing = rotor.crest / if on { rotor.contact } else { rotor.brake.max(0.05 * rotor.contact) };
        let (growing, swinging) = (0.25 * rotor.wave_s, (0.04 * swing).clamp(25e-6, 250e-6));
        let grown = 6.0 * rotor.wave_s;
        while self.t < until - 1e-12 {
            let resting = !on && self.wave < 1e-3 && self.speed.abs() < 1e-4 * rotor.crest;
            let dt = if resting {
                until - self.t
            } else if self.t - start < grown {
                growing.min(swinging)
            } else if self.t - start < grown + 1.5 * swing {
                swinging
            } else {
                0.5e-3
            };
            self.advance(on, dt.min(until - self.t), sink);
        }
    }

    fn advance(&mut self, on: bool, dt: f64, sink: &mut dyn FnMut(&Step)) {
        let goal = if on { 1.0 } else { 0.0 };
        let mut factors = self.acting.factors(self.t + 0.5 * dt, dt, on, self.angle, self.speed);
        factors.gain *= self.gain;
        factors.grip *= self.gain;
        self.wave = goal + (self.wave - goal) * (-dt / self.rotor.wave_s).exp();
        let next = self.rotor.after(self.speed, self.wave, &factors, dt);
        let angle = self.angle + 0.5 * (self.speed + next) * dt;
        sink(&Step { t: [self.t, self.t + dt], angle: [self.angle, angle], speed: [self.speed, next] });
        self.t += dt;
        self.speed = next;
        self.angle = angle;
    }
}
