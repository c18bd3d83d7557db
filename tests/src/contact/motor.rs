//! The motor: the wave's envelope, the contact, the rotor, and their integration in time.

use super::smooth::Table;
use crate::profile::random::Dice;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Acceleration in rad/s² that the thesis's contact gives its rotor: 0.1057 · 1 N · 13.675 mm over 7.6558e-7 kg·m².
const LISTED: f64 = 1888.0;
/// What one step may be off a straight line in acceleration, as a share of the crest's speed.
const TOLERANCE: f64 = 5e-4;
/// Shortest and longest step in s.
const STEPS_S: [f64; 2] = [1e-6, 0.25e-3];
/// Speed over the crest's below which friction without a wave gives way.
const STILL: f64 = 0.01;
/// Slip over the crest's speed up to which the torque's table is fine, and its end.
const SLIP: [f64; 2] = [0.1, 2.4];
/// Points of each part of the torque's table.
const SLIP_POINTS: usize = 200;

/// The contact's torque over its largest driving one, against the slip over the crest's speed.
#[derive(Debug, Clone, PartialEq)]
pub struct Torque {
    /// Fine and coarse part, for negative and positive slip.
    parts: [[Vec<f64>; 2]; 2],
}

impl Torque {
    /// Of a mixture of rising steps of many widths, some beside zero; a rotor ahead of its wave is held by `overrun` of it.
    fn draw(dice: &mut Dice, overrun: f64) -> Self {
        let narrow = dice.decade(0.004, 0.03);
        let mut steps = vec![(dice.even(0.5, 1.0), narrow, 0.0)];
        for _ in 0..dice.whole(1, 4) {
            let width = dice.decade(narrow, 0.3);
            steps.push((dice.even(0.0, 0.4), width, dice.even(0.0, 1.5) * width));
        }
        let step = |x: f64| x / (1.0 + x * x).sqrt();
        let rise = |x: f64| -> f64 {
            steps.iter().map(|(w, b, c)| w * 0.5 * (step((x - c) / b) + step((x + c) / b))).sum::<f64>()
        };
        let whole = rise(1.0);
        let side = |sign: f64, from: f64, to: f64, start: f64| -> Vec<f64> {
            let cell = (to - from) / SLIP_POINTS as f64;
            let mut sum = start;
            let mut values = vec![sum];
            for n in 0..SLIP_POINTS {
                let x = from + n as f64 * cell;
                let share =
                    if sign > 0.0 { 1.0 } else { overrun + (1.0 - overrun) * (-(x + 0.5 * cell) / narrow).exp() };
                sum += share * (rise(x + cell) - rise(x)) / whole;
                values.push(sum);
            }
            values
        };
        let half = |sign: f64| {
            let fine = side(sign, 0.0, SLIP[0], 0.0);
            let coarse = side(sign, SLIP[0], SLIP[1], fine[SLIP_POINTS]);
            [fine, coarse]
        };
        Self { parts: [half(-1.0), half(1.0)] }
    }

    /// Value and slope.
    pub fn at(&self, slip: f64) -> (f64, f64) {
        let size = slip.abs();
        let half = &self.parts[usize::from(slip > 0.0)];
        let (table, from, to) = if size < SLIP[0] { (&half[0], 0.0, SLIP[0]) } else { (&half[1], SLIP[0], SLIP[1]) };
        let cell = (to - from) / SLIP_POINTS as f64;
        let x = (size - from) / cell;
        if x >= SLIP_POINTS as f64 {
            return (slip.signum() * table[SLIP_POINTS], 0.0);
        }
        let n = x as usize;
        let rise = table[n + 1] - table[n];
        (slip.signum() * (table[n] + (x - n as f64) * rise), rise / cell)
    }
}

/// A motor of the kind.
#[derive(Debug, Clone, PartialEq)]
pub struct Motor {
    /// Speed of the wave's crest at full amplitude in rad/s.
    pub crest: f64,
    /// Largest driving torque over inertia in rad/s².
    pub contact: f64,
    /// Friction with the wave gone over inertia in rad/s².
    pub brake: f64,
    /// Viscous damping over inertia in 1/s.
    pub viscous: f64,
    /// Time constants of the wave's rise and fall in s.
    pub wave_s: [f64; 2],
    /// How far the drive is off the resonance, in half bandwidths.
    detuned: f64,
    /// How much faster than its amplitude the crest's speed grows at first.
    bent: f64,
    /// Amplitude from which the wave alone carries the rotor.
    lifted: f64,
    lift: Table,
    torque: Torque,
}

impl Motor {
    /// Draws one: 10 to 100 rpm, a tenth to ten times the listed friction, waves that rise (10 to 90 %) in 1 to 10 ms.
    pub fn draw(dice: &mut Dice) -> Self {
        let crest = dice.decade(11.0, 100.0) * TAU / 60.0;
        // Slower ones add up their pulses until they turn at full speed whatever the duty.
        let contact = (LISTED * dice.decade(0.1, 10.0)).max(crest / 14e-3);
        let (share, overrun) = match dice.whole(0, 4) {
            0 => (dice.decade(0.004, 0.04), dice.decade(0.03, 0.2)),
            1 | 2 => (dice.decade(0.05, 0.6), dice.even(0.1, 0.8)),
            _ => (dice.even(0.7, 1.3), dice.even(0.7, 1.2)),
        };
        let rise_s = dice.decade(1e-3, 10e-3) / 9f64.ln();
        Self {
            crest,
            contact,
            brake: contact * share,
            viscous: dice.decade(0.05, 3.0).min(0.1 * contact / crest),
            wave_s: [rise_s, rise_s * dice.even(0.75, 1.3)],
            detuned: dice.even(-0.35, 0.35),
            bent: dice.even(-0.12, 0.12),
            lifted: dice.even(0.08, 0.35),
            lift: Table::climb(dice, 0.5),
            torque: Torque::draw(dice, overrun),
        }
    }

    /// Clamped by its friction as soon as the wave is gone, as closed loops want it.
    pub fn clamped(mut self, dice: &mut Dice) -> Self {
        self.brake = self.contact * dice.even(0.8, 1.2);
        self.torque = Torque::draw(dice, 1.0);
        self
    }

    /// Hardly held with the wave gone.
    pub fn coasting(mut self, dice: &mut Dice) -> Self {
        self.brake = self.contact * dice.decade(0.01, 0.15);
        self.torque = Torque::draw(dice, 0.15);
        self
    }

    /// Speed under full drive in rad/s: where the contact's torque is the viscous one.
    pub fn full(&self) -> f64 {
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let slip = 0.5 * (low + high);
            let pulled = self.contact * self.torque.at(slip).0 > self.viscous * (1.0 - slip) * self.crest;
            if pulled { high = slip } else { low = slip }
        }
        self.crest * (1.0 - low)
    }

    /// The numbers, for the sealed file.
    pub fn numbers(&self) -> BTreeMap<String, f64> {
        [
            ("full_rpm", self.full() * 60.0 / TAU),
            ("contact_rad_s2", self.contact),
            ("brake_rad_s2", self.brake),
            ("viscous_per_s", self.viscous),
            ("wave_rise_s", self.wave_s[0]),
            ("wave_fall_s", self.wave_s[1]),
            ("lifted_amplitude", self.lifted),
            ("held_ahead", -self.torque.at(-1.0).0),
        ]
        .map(|(k, v)| (k.to_owned(), v))
        .into()
    }

    /// How many parameters [`Self::nudged`] knows.
    pub const PARAMETERS: usize = 5;

    /// The motor with one of its own parameters a little changed, for the linear refit.
    pub fn nudged(&self, k: usize) -> Self {
        let mut m = self.clone();
        match k {
            0 => m.crest *= 1.005,
            1 => m.contact *= 1.04,
            2 => m.brake *= 1.04,
            3 => m.viscous += 0.02 * m.contact / m.crest,
            _ => m.wave_s = m.wave_s.map(|s| 1.05 * s),
        }
        m
    }
}

/// What acts on the rotor at one instant beside the motor's own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Factors {
    /// On the crest's speed.
    pub crest: f64,
    /// On the contact's torque.
    pub grip: f64,
    /// On the friction with the wave gone.
    pub brake: f64,
    /// Further friction over inertia in rad/s².
    pub drag: f64,
    /// Share of a softer contact, and the slip over the crest's speed at which that one saturates.
    pub soft: [f64; 2],
    /// Way in rad that the friction with the wave gone yields before it slides; 0 for none.
    pub spring: f64,
    /// Load over inertia in rad/s².
    pub load: f64,
}

impl Default for Factors {
    fn default() -> Self {
        Self { crest: 1.0, grip: 1.0, brake: 1.0, drag: 0.0, soft: [0.0, 1.0], spring: 0.0, load: 0.0 }
    }
}

/// One step of the rotor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Its beginning and end in s.
    pub t: [f64; 2],
    /// Angles in rad there.
    pub angle: [f64; 2],
    /// Speeds in rad/s there.
    pub speed: [f64; 2],
}

impl Step {
    /// The angle at a share of the step: the cubic through angles and speeds.
    pub fn angle_at(&self, share: f64) -> f64 {
        let dt = self.t[1] - self.t[0];
        let (x, rest) = (share, 1.0 - share);
        self.angle[0] * (1.0 + 2.0 * x) * rest * rest
            + self.angle[1] * x * x * (3.0 - 2.0 * x)
            + dt * x * rest * (self.speed[0] * rest - self.speed[1] * x)
    }
}

/// A rotor under way.
#[derive(Debug, Clone)]
pub struct Rotor<'a> {
    motor: &'a Motor,
    /// Envelopes of the two modes as complex numbers; the second turns with the direction.
    modes: [[f64; 2]; 2],
    driven: (bool, f64),
    /// Time since the drive last changed in s.
    since: f64,
    dt: f64,
    /// Way that the friction has yielded in rad.
    yielded: f64,
    /// Time in s.
    pub t: f64,
    /// Speed in rad/s.
    pub speed: f64,
    /// Angle in rad.
    pub angle: f64,
}

impl<'a> Rotor<'a> {
    /// At rest at t = 0.
    pub fn at(motor: &'a Motor, angle: f64) -> Self {
        Self {
            motor,
            modes: [[0.0; 2]; 2],
            driven: (false, 1.0),
            since: 1.0,
            dt: STEPS_S[0],
            yielded: 0.0,
            t: 0.0,
            speed: 0.0,
            angle,
        }
    }

    /// Whether nothing moves and nothing will by itself.
    pub fn rests(&self) -> bool {
        let gone = self.modes[0][0].hypot(self.modes[0][1]) < 1e-3;
        gone && self.speed.abs() < 1e-5 * self.motor.crest && self.yielded == 0.0
    }

    /// The modes after `dt`: damped resonators seen from their drive.
    fn modes_after(&self, dt: f64) -> [[f64; 2]; 2] {
        let m = self.motor;
        let (on, sign) = self.driven;
        let tau = m.wave_s[usize::from(!on)];
        let keep = (-dt / tau).exp();
        let (sin, cos) = (m.detuned * dt / tau).sin_cos();
        let goals = if on { [1.0, sign] } else { [0.0, 0.0] };
        [0, 1].map(|k| {
            let [re, im] = [self.modes[k][0] - goals[k], self.modes[k][1]];
            [goals[k] + keep * (re * cos - im * sin), keep * (re * sin + im * cos)]
        })
    }

    /// One step of at most `most` s under what acts on it.
    pub fn step(&mut self, on: bool, sign: f64, f: &Factors, most: f64) -> Step {
        let m = self.motor;
        if (on, sign) != self.driven {
            (self.driven, self.since) = ((on, sign), 0.0);
        }
        let tau = m.wave_s[usize::from(!on)];
        let cap = if self.since < 6.0 * tau { (0.12 * tau).min(STEPS_S[1]) } else { STEPS_S[1] };
        let mut dt = self.dt.min(cap).min(most);
        if !on && self.rests() && f.load == 0.0 {
            dt = most;
        }
        let speed = loop {
            let wave = Wave::of(&self.modes_after(0.5 * dt));
            let (a, slope) = self.acceleration(self.speed, wave, f, dt);
            let z = slope * dt;
            let grown = if z.abs() < 1e-6 { 1.0 } else { z.exp_m1() / z };
            let next = self.speed + dt * a * grown;
            let (b, _) = self.acceleration(next, wave, f, dt);
            let off = ((b - a - slope * (next - self.speed)) * dt).abs() / m.crest;
            if off < TOLERANCE || dt <= STEPS_S[0] {
                self.dt = if off < 0.25 * TOLERANCE { 1.6 * dt.min(cap) } else { dt };
                break next;
            }
            dt = (0.5 * dt).max(STEPS_S[0]);
        };
        self.modes = self.modes_after(dt);
        let way = 0.5 * (self.speed + speed) * dt;
        let step = Step { t: [self.t, self.t + dt], angle: [self.angle, self.angle + way], speed: [self.speed, speed] };
        if f.spring > 0.0 {
            // The nearer it is to sliding, the less of the way it yields.
            let slid = if way * self.yielded > 0.0 { (self.yielded / f.spring).powi(2).min(1.0) } else { 0.0 };
            self.yielded = (self.yielded + way * (1.0 - slid)).clamp(-f.spring, f.spring);
        }
        (self.speed, self.angle) = (speed, step.angle[1]);
        self.t += dt;
        self.since += dt;
        step
    }

    /// Acceleration in rad/s² at a speed, and its slope.
    fn acceleration(&self, speed: f64, wave: Wave, f: &Factors, dt: f64) -> (f64, f64) {
        let m = self.motor;
        let carried = m.lift.at(wave.lift / m.lifted);
        let along = if wave.travelling < 0.0 { -1.0 } else { 1.0 };
        let crest = wave.travelling * (1.0 + m.bent * (1.0 - wave.travelling.abs())) * f.crest;
        let slip = (crest - speed / m.crest) * along;
        let (mut pull, mut steep) = m.torque.at(slip);
        if f.soft[0] != 0.0 {
            let [share, width] = f.soft;
            let r = 1.0 / slip.hypot(width);
            pull += share * (slip * r - pull);
            steep += share * (width * width * r * r * r - steep);
        }
        let grip = m.contact * f.grip * carried;
        let still = STILL * m.crest;
        let r = 1.0 / (1.0 + (speed / still).powi(2)).sqrt();
        let bare = (1.0 - carried) * m.brake * f.brake;
        let mut a = grip * pull * along - m.viscous * speed - f.drag * speed / still * r + f.load;
        let mut slope = -grip * steep / m.crest - m.viscous - f.drag * r * r * r / still;
        if f.spring > 0.0 {
            let stiff = bare / f.spring;
            let damped = 0.4 * stiff.sqrt();
            a -= stiff * (self.yielded + 0.5 * speed * dt) + damped * speed;
            slope -= 0.5 * stiff * dt + damped;
        } else {
            a -= bare * speed / still * r;
            slope -= bare * r * r * r / still;
        }
        (a, slope)
    }
}

/// What the two modes make together.
#[derive(Debug, Clone, Copy)]
struct Wave {
    /// Amplitude of the travelling wave, signed.
    travelling: f64,
    /// Amplitude that lifts the contact, travelling or standing.
    lift: f64,
}

impl Wave {
    fn of(modes: &[[f64; 2]; 2]) -> Self {
        let [a, b] = modes;
        let lift = a[0].hypot(a[1]);
        Self { travelling: (a[0] * b[0] + a[1] * b[1]) / lift.max(1e-9), lift }
    }
}
