//! Effects at work: what they make of one run, moment by moment.

use super::effects::Effect;
use super::motor::{Factors, Motor};
use super::smooth::{Table, normal};
use crate::drive::Drive;
use crate::profile::random::Dice;
use std::f64::consts::TAU;

/// What happened before a run.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Past {
    /// Revolutions turned before, and in this run, over those of the whole experiment, about.
    pub turned: [f64; 2],
    /// Place of the run among all, 0..1.
    pub place: f64,
    /// Warmth of the three stores.
    pub warm: [f64; 3],
}

impl Past {
    /// What each run of an experiment, with the pause behind it in s, starts from.
    pub fn of(runs: &[(Drive, f64)], hidden: &[Effect]) -> Vec<Self> {
        let way = |d: &Drive| d.duty * d.seconds;
        let all: f64 = runs.iter().map(|(d, _)| way(d)).sum();
        let last = runs.len().max(2) as f64 - 1.0;
        let mut now = Self::default();
        let mut pasts = Vec::with_capacity(runs.len());
        for (k, (drive, pause_s)) in runs.iter().enumerate() {
            now.turned[1] = way(drive) / all;
            now.place = k as f64 / last;
            pasts.push(now);
            now.turned[0] += now.turned[1];
            for e in hidden.iter().filter(|e| e.name == "resonance-heating") {
                for (warm, tau) in now.warm.iter_mut().zip(stores_s(e)) {
                    *warm = drive.duty + (*warm - drive.duty) * (-drive.seconds / tau).exp();
                    // A rotor at rest is no fan: it cools more slowly than it warms.
                    *warm *= (-pause_s / (tau * e.decade(4, 1.0, 4.0))).exp();
                }
            }
        }
        pasts
    }
}

/// Time constants of the three stores of warmth in s.
fn stores_s(e: &Effect) -> [f64; 3] {
    let first = e.decade(0, 0.4, 5.0);
    let apart = e.even(1, 2.0, 5.0);
    [first, first * apart, first * apart * apart]
}

/// Where the rotor is.
#[derive(Debug, Clone, Copy)]
pub struct Moment {
    /// Time in s.
    pub t: f64,
    /// The drive is on.
    pub on: bool,
    /// Time since it is on in s.
    pub driven_s: f64,
    /// Number of the PWM period.
    pub pulse: usize,
    /// Angle in rad.
    pub angle: f64,
    /// Speed in rad/s.
    pub speed: f64,
}

/// Effects at work in one run.
#[derive(Debug, Clone)]
pub struct Acting<'a> {
    hidden: &'a [Effect],
    /// Those that change within the run.
    moving: Vec<&'a Effect>,
    drive: Drive,
    past: Past,
    contact: f64,
    crest: f64,
    steady: Factors,
    warm: [f64; 3],
    driven: f64,
    supply: f64,
    scatter: Dice,
    stumbles: Vec<f64>,
}

impl<'a> Acting<'a> {
    /// For one run of a motor whose crest runs by `gain` faster in it.
    pub fn new(hidden: &'a [Effect], motor: &Motor, drive: Drive, past: Past, gain: f64, seed: u64) -> Self {
        let mut scatter = Dice::new(seed, "scatter");
        let stumbles = stumbles(&drive, &mut scatter);
        let mut acting = Self {
            hidden,
            moving: Vec::new(),
            drive,
            past,
            contact: motor.contact,
            crest: motor.crest,
            steady: Factors { crest: gain, ..Factors::default() },
            warm: past.warm,
            driven: 0.0,
            supply: 0.0,
            scatter,
            stumbles,
        };
        for e in hidden {
            if !acting.settled(e) {
                acting.moving.push(e);
            }
        }
        acting
    }

    /// Takes in an effect that is the same throughout a run; false for one that is not.
    fn settled(&mut self, e: &Effect) -> bool {
        let (s, u, sign) = (e.size, self.drive.duty, self.drive.sign);
        let f = &mut self.steady;
        match (e.name, e.form) {
            ("direction-asymmetry", form) => {
                if form != "grip" {
                    f.crest *= 1.0 + s * sign;
                }
                if form != "speed" {
                    f.grip *= 1.0 + 2.0 * s * sign;
                    f.brake *= 1.0 - 2.0 * s * sign * e.even(0, -0.5, 1.0);
                }
            }
            ("high-duty-saturation", "speed") => f.crest *= 1.0 - s * e.bend(u),
            ("supply-sag", "mean current") => f.crest *= 1.0 - s * e.climb.at(u),
            ("contact-stiffening", "softer") => f.soft = [s, e.decade(0, 0.15, 0.7)],
            ("contact-stiffening", _) => f.soft = [s.min(0.9), 0.05 + s * e.even(0, 0.3, 1.0)],
            ("presliding", _) => f.spring = s,
            ("outside-comb", _) => f.crest *= 1.0 + s * e.wave.at(u),
            ("outside-sessions", _) => f.crest *= 1.0 + s * session(e, self.past.place),
            ("outside-tide", _) => {
                let turns = e.even(0, 1.5, 3.0);
                f.crest *= 1.0 + s * (TAU * (turns * self.past.place + e.knob[1])).sin();
            }
            ("outside-crossing", _) => f.crest *= 1.0 + s * sign * crossing(&e.climb, u),
            (
                "dead-zone"
                | "start-delay"
                | "duty-quantisation"
                | "high-duty-saturation"
                | "encoder-eccentricity"
                | "unequal-edges"
                | "clock-error"
                | "dropped-samples",
                _,
            ) => {}
            _ => return false,
        }
        true
    }

    /// On fraction that reaches the driver.
    pub fn duty(&self, asked: f64) -> f64 {
        self.hidden.iter().fold(asked, |u, e| e.duty(u))
    }

    /// How much later than it should a pulse begins after a pause, in s.
    pub fn delay(&mut self, pause_s: f64) -> f64 {
        let mut late = 0.0;
        for e in self.hidden.iter().filter(|e| e.name == "start-delay") {
            late += e.size
                * match e.form {
                    "constant" => 1.0,
                    "scattered" => (1.0 + 0.2 * normal(&mut self.scatter)).max(0.0),
                    _ => 0.3 + 0.7 * e.climb.at(pause_s / e.decade(0, 0.01, 0.03)),
                };
        }
        late
    }

    /// What acts at a moment.
    pub fn factors(&self, now: &Moment) -> Factors {
        let mut f = self.steady;
        for e in &self.moving {
            let s = e.size;
            match (e.name, e.form) {
                ("preload-runout", form) => {
                    let m = (1.0 + s * e.ring.at(now.angle)).max(0.1);
                    f.crest *= if form == "torque" { 1.0 } else { m };
                    f.grip *= if form == "speed" { 1.0 } else { m };
                    f.brake *= if form == "speed" { 1.0 } else { m };
                }
                ("resonance-heating", form) => {
                    let lost = s * e.climb.at(self.warmth(e));
                    f.crest *= 1.0 - lost;
                    f.grip *= if form == "wave" { 1.0 - 0.5 * lost } else { 1.0 };
                }
                ("frequency-settling", form) => {
                    let tau = e.decade(0, 0.02, 0.15);
                    let off = s * e.faded(if form == "driven time" { self.driven } else { now.t } / tau);
                    f.crest *= if form == "flank" { flank(e.even(1, 0.3, 1.2), off) } else { 1.0 + off };
                }
                ("supply-sag", _) => f.crest *= 1.0 - s * e.climb.at(self.supply),
                ("run-in-wear", _) => {
                    let [before, within] = self.past.turned;
                    let turned = before + within * now.t / self.drive.seconds;
                    let early = e.decade(0, 0.02, 0.5);
                    let worn = (turned / early).ln_1p() / (1.0 / early).ln_1p();
                    f.crest *= 1.0 + s * (e.climb.at(worn) - 0.5);
                }
                ("stribeck-friction", _) => {
                    f.drag += s * self.contact * e.faded(now.speed.abs() / (self.crest * e.decade(0, 0.03, 0.25)));
                }
                _ => f.crest *= self.outside(e, now),
            }
        }
        f
    }

    fn outside(&self, e: &Effect, now: &Moment) -> f64 {
        let s = e.size;
        match e.name {
            "outside-swell" => 1.0 + s * e.wave.at(now.t / self.drive.seconds),
            "outside-teeth" => {
                let teeth = (6.0 + 9.0 * e.knob[0]).round();
                1.0 + s * (teeth * now.angle + TAU * e.knob[1]).cos() * (1.0 + 0.3 * e.ring.at(now.angle))
            }
            "outside-dent" => (1.0 + 0.3 * s * e.ring.at(now.angle)).clamp(0.1, 2.5),
            "outside-stumbles" => {
                let last = self.stumbles.iter().rev().find(|at| **at <= now.t);
                1.0 - s * last.map_or(0.0, |at| e.faded((now.t - at) / e.decade(0, 0.04, 0.2)))
            }
            "outside-stagger" => {
                let every = 2 + (3.0 * e.knob[0]) as usize;
                if now.pulse.is_multiple_of(every) { 1.0 - s } else { 1.0 + s / every as f64 }
            }
            "outside-flutter" if now.on => {
                let x = now.driven_s;
                1.0 + s * (TAU * e.decade(0, 90.0, 250.0) * x + TAU * e.knob[1]).sin() * (-x / 12e-3).exp()
            }
            _ => 1.0,
        }
    }

    /// The time that passed: warmth, driven time and the supply go on.
    pub fn pass(&mut self, on: bool, dt: f64) {
        let goal = f64::from(u8::from(on));
        self.driven += goal * dt;
        for e in &self.moving {
            match e.name {
                "resonance-heating" => {
                    for (warm, tau) in self.warm.iter_mut().zip(stores_s(e)) {
                        *warm = goal + (*warm - goal) * (-dt / tau).exp();
                    }
                }
                "supply-sag" => {
                    self.supply = goal + (self.supply - goal) * (-dt / e.decade(0, 2e-3, 40e-3)).exp();
                }
                _ => {}
            }
        }
    }

    fn warmth(&self, e: &Effect) -> f64 {
        let [a, b] = if e.form == "three stores" { [e.knob[2], e.knob[3]] } else { [0.0, 0.0] };
        (self.warm[0] + a * self.warm[1] + b * self.warm[2]) / (1.0 + a + b)
    }
}

/// Times at which a rotor stumbles: about one in a second and a half, never twice within 0.2 s.
fn stumbles(drive: &Drive, dice: &mut Dice) -> Vec<f64> {
    let mut t = 0.0;
    let mut all = Vec::new();
    loop {
        t += 0.2 - 1.3 * dice.even(1e-9, 1.0).ln();
        if t >= drive.seconds {
            return all;
        }
        all.push(t);
    }
}

/// Somebody took the motor apart twice: three sessions, the middle one different.
fn session(e: &Effect, place: f64) -> f64 {
    let (first, second) = (e.even(0, 0.2, 0.45), e.even(1, 0.55, 0.8));
    let levels = [e.even(2, -0.6, 0.2), 1.0, e.even(3, -0.6, 0.2)];
    levels[usize::from(place > first) + usize::from(place > second)]
}

/// Faster one way round at low duties and the other way at high ones.
fn crossing(climb: &Table, u: f64) -> f64 {
    2.0 * climb.at((u - 0.05) / 0.95) - 1.0
}

/// Speed beside a resonance `x` half bandwidths off the drive, `off` more than it will be.
fn flank(x: f64, off: f64) -> f64 {
    ((1.0 + x * x) / (1.0 + (x - off).powi(2))).sqrt()
}
