//! A run: the rotor under the drive, with what is hidden in it, and the wheel that is read.

use crate::hidden::Hidden;
use crate::motor::{ContactTable, Drive, Motor, State, step};
use crate::noise::normal;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Encoder edges a revolution.
pub const EDGES: f64 = 400.0;
/// Encoder pitch in rad.
pub const PITCH: f64 = TAU / EDGES;

/// What a run starts from: all that happened before.
#[derive(Debug, Clone, Copy, Default)]
pub struct History {
    /// Warmth of the two poles (1).
    pub warm: [f64; 2],
    /// Revolutions made (1).
    pub revolutions: f64,
}

/// A run to be made.
#[derive(Debug, Clone, Copy)]
pub struct Run {
    /// On fraction.
    pub duty: f64,
    /// Direction.
    pub sign: f64,
    /// PWM frequency in Hz.
    pub pwm_hz: f64,
    /// Length of the drive in s.
    pub seconds: f64,
    /// Angle of the rotor at the start in rad.
    pub zero_angle: f64,
    /// Gain of the drive in this run.
    pub gain: f64,
    /// What happened before.
    pub history: History,
}

/// The motor with a softer contact, if that is hidden.
pub fn stiffened(motor: &Motor, hidden: &[Hidden]) -> Motor {
    let mut m = motor.clone();
    for h in hidden {
        if h.name == "contact-stiffening" {
            m.creep += 1.2 * h.size;
            m.crest_speed *= 1.0 + 0.05 * h.size;
        }
    }
    m
}

/// Warmth and distance after a run and the rest that follows.
pub fn after(before: History, duty: f64, seconds: f64, speed: f64, hidden: &[Hidden], rest: f64) -> History {
    let mut h = before;
    for e in hidden {
        if e.name == "resonance-heating" {
            let tau = e.between(0, 0.7, 4.0);
            for (k, tau) in [tau, 3.0 * tau].into_iter().enumerate() {
                h.warm[k] = duty + (h.warm[k] - duty) * (-seconds / tau).exp();
                h.warm[k] *= (-rest / (4.0 * tau)).exp();
            }
        }
    }
    h.revolutions += duty * speed * seconds / TAU;
    h
}

/// The encoder wheel with its errors.
pub struct Wheel {
    eccentricity: f64,
    phase: f64,
    harmonic: f64,
    slot: f64,
}

impl Wheel {
    /// A wheel with what is hidden of it.
    pub fn new(hidden: &[Hidden]) -> Self {
        let mut w = Self { eccentricity: 0.0, phase: 0.0, harmonic: 0.0, slot: 0.0 };
        for h in hidden {
            match h.name {
                "encoder-eccentricity" => {
                    w.eccentricity = 0.4 * h.size;
                    w.phase = TAU * h.shape[0];
                    w.harmonic = 0.1;
                }
                "unequal-edges" => w.slot = 0.6 * h.size * h.sign(),
                _ => {}
            }
        }
        w
    }

    /// The encoder line at an angle (rad).
    pub fn level(&self, angle: f64) -> bool {
        let x = angle - self.phase;
        let read = angle + self.eccentricity * (x.sin() + self.harmonic * (2.0 * x + 1.0).sin());
        let place = (read / (2.0 * PITCH)).rem_euclid(1.0);
        place < 0.5 * (1.0 + self.slot)
    }
}

/// A rotor in motion that can be asked for its angle at ascending times.
pub struct Trace<'a> {
    motor: &'a Motor,
    table: &'a ContactTable,
    run: Run,
    period: f64,
    hidden: &'a [Hidden],
    state: State,
    before: State,
    t: f64,
    warm: [f64; 2],
    sagged: f64,
    pulse_noise: ChaCha8Rng,
    pulse: i64,
    pulse_delay: f64,
    effective: f64,
}

/// Step of the integration (s).
const DT: f64 = 1e-4;

impl<'a> Trace<'a> {
    /// A rotor at rest, about to make a run.
    pub fn new(motor: &'a Motor, table: &'a ContactTable, run: Run, hidden: &'a [Hidden], seed: u64) -> Self {
        let mut effective = run.duty;
        for h in hidden {
            effective = actuator(h, effective);
        }
        Self {
            motor,
            table,
            run,
            period: 1.0 / run.pwm_hz,
            hidden,
            state: State::default(),
            before: State::default(),
            t: 0.0,
            warm: run.history.warm,
            sagged: 0.0,
            pulse_noise: ChaCha8Rng::seed_from_u64(seed),
            pulse: -1,
            pulse_delay: 0.0,
            effective,
        }
    }

    /// Its angle (rad) at a time (s) no earlier than the last one asked for.
    pub fn angle_at(&mut self, t: f64) -> f64 {
        while self.t < t {
            self.before = self.state;
            self.advance();
        }
        if self.t <= 0.0 || t <= 0.0 {
            return 0.0;
        }
        let f = ((t - (self.t - DT)) / DT).clamp(0.0, 1.0);
        self.before.angle + f * (self.state.angle - self.before.angle)
    }

    fn advance(&mut self) {
        let t = self.t + 0.5 * DT;
        let mut d = Drive { sign: self.run.sign, gain: self.run.gain, ..Drive::default() };
        let pulse = (t / self.period).floor() as i64;
        if pulse != self.pulse {
            self.pulse = pulse;
            self.pulse_delay = 0.0;
            for h in self.hidden {
                if h.name == "start-delay" && (self.effective < 1.0 - 1e-9 || pulse == 0) {
                    self.pulse_delay += 5e-3 * h.size * (1.0 + normal(&mut self.pulse_noise, 0.08));
                }
            }
        }
        let phase = t - pulse as f64 * self.period;
        let on_from = (1.0 - self.effective) * self.period + self.pulse_delay;
        d.on = phase >= on_from && t < self.run.seconds;
        let theta = self.state.angle + self.run.zero_angle;
        for h in self.hidden {
            let s = h.size;
            match h.name {
                "resonance-heating" => {
                    let tau = h.between(0, 0.7, 4.0);
                    let heat = if d.on { 1.0 } else { 0.0 };
                    self.warm[0] += (heat - self.warm[0]) * DT / tau;
                    self.warm[1] += (heat - self.warm[1]) * DT / (3.0 * tau);
                    let warm = 0.75 * self.warm[0] + 0.25 * self.warm[1];
                    d.gain *= (1.0 + 0.3 * s) / (1.0 + 0.8 * s * warm);
                }
                "frequency-settling" => {
                    let tau = h.between(0, 0.03, 0.08);
                    let x = t / tau;
                    d.gain *= (1.0 + 1.5 * s * h.sign() * (1.0 + 0.6 * x) * (-1.2 * x).exp()).max(0.05);
                }
                "contact-stiffening" | "dead-zone" | "start-delay" | "duty-quantisation" | "high-duty-saturation" => {}
                "direction-asymmetry" => {
                    d.gain *= 1.0 + 0.3 * s * h.sign() * self.run.sign;
                    d.brake *= 1.0 - 0.2 * s * h.sign() * self.run.sign;
                }
                "preload-runout" => {
                    let mix = h.between(1, 0.0, 1.0);
                    let x = theta - TAU * h.shape[0];
                    let y = 2.0 * theta - TAU * h.shape[2];
                    let m = 0.4 * s * (mix.sqrt() * x.cos() + (1.0 - mix).sqrt() * y.cos() + 0.1 * (3.0 * x).cos());
                    d.gain *= (1.0 + m).max(0.05);
                    d.grip *= (1.0 + m).max(0.05);
                    d.brake *= (1.0 + 0.3 * m).max(0.05);
                }
                "stribeck-friction" => {
                    let vs = h.between(0, 0.3, 1.2);
                    let x = self.state.speed / vs;
                    d.drag += 1.6 * s * self.motor.contact / (1.0 + x * x) / (1.0 + 0.3 * x * x);
                }
                "supply-sag" => {
                    self.sagged += (if d.on { 1.0 } else { 0.0 } - self.sagged) * DT / 0.01;
                    d.gain *= 1.0 - 0.5 * s * (self.sagged - 0.6);
                }
                "run-in-wear" => {
                    let r0 = h.between(0, 1.0, 15.0);
                    let revs = self.run.history.revolutions + self.state.angle.abs() / TAU;
                    d.gain *= 1.0 + 0.6 * s * h.sign() * (revs / (revs + r0) - 0.5);
                }
                "outside-cogging" => d.gain *= (1.0 + 0.5 * s * (7.0 * theta).cos()).max(0.05),
                "outside-rhythm" => d.gain *= 1.0 + 0.5 * s * (TAU * 2.7 * t + 1.0).sin(),
                "outside-notch" => {
                    let x = (self.run.duty - 0.5) / 0.1;
                    d.gain *= 1.0 - 0.6 * s * (-x * x).exp();
                }
                _ => {}
            }
        }
        // A switching instant inside the step divides it.
        let split = on_from - (phase - 0.5 * DT);
        if split > 0.0 && split < DT && t < self.run.seconds {
            step(self.motor, self.table, &mut self.state, &Drive { on: false, ..d }, split);
            step(self.motor, self.table, &mut self.state, &Drive { on: true, ..d }, DT - split);
        } else {
            step(self.motor, self.table, &mut self.state, &d, DT);
        }
        self.t += DT;
    }
}

/// What the hidden effect makes of a commanded duty.
fn actuator(h: &Hidden, duty: f64) -> f64 {
    let s = h.size;
    match h.name {
        "dead-zone" => {
            let soft = 0.012;
            let x = (duty - 0.3 * s) / soft;
            (soft * if x > 30.0 { x } else { x.exp().ln_1p() }).min(1.0)
        }
        "duty-quantisation" => {
            let steps = (2.5 / s.max(0.05)).round().clamp(4.0, 40.0);
            ((duty * steps).round() / steps).clamp(0.0, 1.0)
        }
        "high-duty-saturation" => {
            let us = 1.2 / s.max(0.02).sqrt();
            us * (duty / us).tanh()
        }
        _ => duty,
    }
}
