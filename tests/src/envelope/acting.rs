//! What hidden effects do to stator, contact and rotor while a run goes on.

use super::bench::Planned;
use super::bristles::{Grip, Rotor};
use super::effects::Effect;
use super::motor::Motor;
use crate::drive::Drive;
use crate::profile::random::Dice;
use std::f64::consts::TAU;

/// Time constants of warming that are followed.
const WARMTHS: usize = 2;

/// What happened before a run.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Past {
    /// Share of the experiment's revolutions that are done, and that this run makes.
    pub turned: [f64; 2],
    /// Share of the experiment's runs that are done.
    pub done: f64,
    /// Warmth at the time constants of a heating, 1 for one that was driven for ever.
    pub warm: [f64; WARMTHS],
}

impl Past {
    /// Of every run of a plan.
    pub fn of(plan: &[Planned], hidden: &[Effect]) -> Vec<Self> {
        // Revolutions go roughly with the driven time.
        let driven = |r: &Planned| r.drive.duty * r.drive.seconds;
        let all: f64 = plan.iter().map(driven).sum();
        let last = (plan.len().max(2) - 1) as f64;
        let mut now = Self::default();
        let mut out = Vec::with_capacity(plan.len());
        for (k, run) in plan.iter().enumerate() {
            now.done = k as f64 / last;
            now.turned[1] = driven(run) / all;
            out.push(now);
            now.turned[0] += now.turned[1];
            for e in hidden.iter().filter(|e| e.name == "resonance-heating") {
                for (warm, tau) in now.warm.iter_mut().zip(warming_s(e, run.drive.seconds)) {
                    let heated = run.drive.duty + (*warm - run.drive.duty) * (-run.drive.seconds / tau).exp();
                    *warm = heated * (-run.pause_s / tau).exp();
                }
            }
        }
        out
    }
}

/// A heating's time constants in s: the stator's, and that of what it is screwed to.
fn warming_s(e: &Effect, seconds: f64) -> [f64; WARMTHS] {
    let fast = seconds * e.between(0, 0.15, 1.2);
    [fast, fast * e.between(1, 4.0, 20.0)]
}

/// A moment of a run.
#[derive(Debug, Clone, Copy)]
pub struct Moment {
    /// Time in s.
    pub t: f64,
    /// Length of the cell in s.
    pub dt: f64,
    /// The drive is on.
    pub on: bool,
    /// Number of the PWM period.
    pub pulse: u64,
    /// Time since the pulse began in s.
    pub since_on: f64,
    /// The rotor.
    pub rotor: Rotor,
    /// Angle that it started at.
    pub zero: f64,
}

/// What acts for a cell: factors, but for what is added to the tuning.
#[derive(Debug, Clone, Copy)]
pub struct Factors {
    /// On the supply's voltage.
    pub voltage: f64,
    /// On every speed and friction alike: the rotor's whole course is so much faster.
    pub speed: f64,
    /// On the friction with the wave.
    pub contact: f64,
    /// On the friction without it.
    pub brake: f64,
    /// Added half-widths.
    pub detuning: f64,
    /// Added error of the quadrature in rad.
    pub quadrature: f64,
}

/// Effects at work in one run.
#[derive(Debug, Clone)]
pub struct Acting<'a> {
    hidden: &'a [Effect],
    motor: &'a Motor,
    drive: Drive,
    past: Past,
    warm: [f64; WARMTHS],
    driven_s: f64,
    stored: f64,
    /// Two random numbers of the run's own in 0..1.
    own: [f64; 2],
    /// Something acts within a cell.
    pub quick: bool,
    /// Speed below which friction rises, in rad/s.
    slow: f64,
}

impl<'a> Acting<'a> {
    /// For one run; `seed` is the run's.
    pub fn new(hidden: &'a [Effect], motor: &'a Motor, drive: Drive, past: Past, seed: u64) -> Self {
        let mut dice = Dice::new(seed, "acting");
        Self {
            hidden,
            motor,
            drive,
            past,
            warm: past.warm,
            driven_s: 0.0,
            stored: 1.0,
            own: [dice.even(0.0, 1.0), dice.even(0.0, 1.0)],
            quick: hidden.iter().any(|e| matches!(e.name, "stribeck-friction" | "contact-stiffening")),
            slow: hidden
                .iter()
                .find(|e| e.name == "stribeck-friction")
                .map_or(motor.full, |e| e.between(0, 0.06, 0.5) * motor.full),
        }
    }

    /// On fraction that reaches the driver.
    pub fn duty(&self) -> f64 {
        self.hidden.iter().fold(self.drive.duty, |u, e| e.duty(u))
    }

    /// How much later a pulse begins after `off_s` without drive, in s.
    pub fn delay(&self, off_s: f64) -> f64 {
        self.hidden.iter().map(|e| e.delay(off_s)).sum()
    }

    /// What acts in the cell that begins now.
    pub fn factors(&mut self, now: &Moment) -> Factors {
        let mut f = Factors { voltage: 1.0, speed: 1.0, contact: 1.0, brake: 1.0, detuning: 0.0, quadrature: 0.0 };
        if now.on {
            self.driven_s += now.dt;
        }
        for e in self.hidden {
            match e.name {
                "resonance-heating" => self.heat(e, now, &mut f),
                "frequency-settling" => self.settle(e, now, &mut f),
                "direction-asymmetry" => self.lean(e, &mut f),
                "preload-runout" => {
                    let m = (1.0 + e.size * e.ring.at(now.zero + now.rotor.angle)).max(0.1);
                    if e.form != "height" {
                        f.contact *= m;
                        f.brake *= m;
                    }
                    if e.form != "preload" {
                        // Half as much on the wave's reach as on the load: where it presses more, it also bends more.
                        f.voltage *= 0.5 + 0.5 * m;
                    }
                }
                "supply-sag" => f.voltage *= self.supply(e, now),
                "high-duty-saturation" if e.form == "power" => {
                    // The supply's limit is reached at a duty between a third and four fifths.
                    let knee = 0.33 + 0.47 * e.knob[0];
                    f.voltage *= 1.0 - e.size * ((self.drive.duty - knee) / (1.0 - knee)).max(0.0).powi(2);
                }
                "run-in-wear" => self.wear(e, now, &mut f),
                name if name.starts_with("outside") => self.outside(e, now, &mut f),
                _ => {}
            }
        }
        f
    }

    fn heat(&mut self, e: &Effect, now: &Moment, f: &mut Factors) {
        let goal = f64::from(u8::from(now.on));
        for (warm, tau) in self.warm.iter_mut().zip(warming_s(e, self.drive.seconds)) {
            *warm += (goal - *warm) * now.dt / tau;
        }
        let slow = if e.form == "resonance, two times" { 0.3 + 0.4 * e.knob[2] } else { 0.0 };
        let warm = (1.0 - slow) * self.warm[0] + slow * self.warm[1];
        match e.form {
            "friction" => {
                f.contact *= 1.0 - e.size * warm;
                f.brake *= 1.0 - e.size * warm;
            }
            "curve" => f.voltage *= 1.0 - e.size * e.rising.at(warm),
            // The resonance falls, so that the drive lies higher above it; of small shifts, as the warmth.
            _ => f.detuning += self.motor.detuned_for(e.size) * warm,
        }
    }

    fn settle(&self, e: &Effect, now: &Moment, f: &mut Factors) {
        let tau = e.between(0, 0.03, 0.3);
        let left = match e.form {
            "driven time" => (-self.driven_s / tau).exp(),
            // A loop that overshoots a little: two thirds of critical damping and less.
            "tracking loop" => (-now.t / tau).exp() * (now.t / tau * (0.8 + 1.5 * e.knob[1])).cos(),
            "curve" => 1.0 - e.rising.at(now.t / (3.0 * tau)),
            _ => (-now.t / tau).exp(),
        };
        if e.form == "curve" {
            f.voltage *= 1.0 - e.size * left;
            return;
        }
        let shift = self.motor.detuned_for(e.size.abs());
        // From above the resonance, or from below it and across.
        f.detuning += left * if e.size > 0.0 { shift } else { -shift - 2.0 * self.motor.detuning };
    }

    fn lean(&self, e: &Effect, f: &mut Factors) {
        let lean = e.size * self.drive.sign;
        match e.form {
            "speed" => f.speed *= 1.0 + lean,
            "wave" => f.voltage *= 1.0 + lean,
            "friction" => {
                f.contact *= 1.0 + 1.5 * lean;
                f.brake *= 1.0 + 1.5 * lean * (1.0 - 2.0 * e.knob[0]);
            }
            // One of the two directions has its supplies so far from quadrature that the wave is weaker by twice the size.
            "quadrature" if lean < 0.0 => f.quadrature += (1.0 + 2.0 * lean).clamp(-1.0, 1.0).acos(),
            "curve" => f.voltage *= 1.0 + lean * (0.4 + 1.2 * e.rising.at(self.drive.duty)),
            _ => {}
        }
    }

    fn supply(&mut self, e: &Effect, now: &Moment) -> f64 {
        match e.form {
            // An inner resistance, and a current that goes with the torque.
            "load" if now.on => 1.0 - e.size * now.rotor.bend.abs(),
            // A capacitor that a pulse empties and a pause fills.
            "storage" => {
                let goal = if now.on { 1.0 - e.size } else { 1.0 };
                self.stored += (goal - self.stored) * now.dt / e.between(0, 3e-3, 40e-3);
                self.stored
            }
            "mean current" => 1.0 - e.size * self.duty(),
            "curve" => 1.0 - e.size * e.rising.at(self.duty()),
            _ => 1.0,
        }
    }

    fn wear(&self, e: &Effect, now: &Moment, f: &mut Factors) {
        let [done, of] = self.past.turned;
        let x = done + of * (now.t / self.drive.seconds).min(1.0);
        let scale = e.between(0, 0.03, 0.5);
        let worn = match e.form {
            "logarithm" => (1.0 + x / scale).ln() / (1.0 + 1.0 / scale).ln(),
            "curve" => e.rising.at(x),
            _ => (1.0 - (-x / scale).exp()) / (1.0 - (-1.0 / scale).exp()),
        };
        let m = 1.0 + e.size * (worn - 0.5);
        if e.form == "friction" {
            f.contact *= m;
            f.brake *= m;
        }
        // A lining that fits better carries better: the wave's surface takes it along in full.
        f.voltage *= if e.form == "friction" { 0.7 + 0.3 * m } else { m };
    }

    fn outside(&self, e: &Effect, now: &Moment, f: &mut Factors) {
        let s = e.size;
        let x = now.t / self.drive.seconds;
        let pulsing = |of: f64| f64::from(u8::from(now.pulse as f64 % of < 1.0));
        match e.name {
            "outside-hum" => f.voltage *= 1.0 + s * (TAU * (e.between(0, 0.6, 8.0) * now.t + self.own[0])).sin(),
            "outside-nodes" => f.voltage *= (1.0 + s * e.ring.at(now.zero + now.rotor.angle)).max(0.1),
            "outside-cage" => f.speed *= (1.0 + s * e.ring.at(now.rotor.angle + TAU * self.own[0])).max(0.1),
            "outside-lifting-off" => {
                // One long time and a short one later, in two runs of three.
                let from = [0.05 + 0.3 * self.own[0], 0.6 + 0.25 * self.own[0]];
                let long = [0.1 + 0.2 * e.knob[0], 0.05 + 0.08 * e.knob[1]];
                let lifted = (0..2).any(|k| x > from[k] && x < from[k] + long[k]);
                f.speed *= if lifted && self.own[1] < 0.67 { 1.0 - s } else { 1.0 };
            }
            "outside-weather" => f.speed *= (1.0 + s * e.wandering.at(self.past.done)).max(0.2),
            "outside-changed-part" => {
                let from = 0.2 + 0.3 * e.knob[0];
                let changed = (from..from + 0.2 + 0.2 * e.knob[1]).contains(&self.past.done);
                f.speed *= if changed { 1.0 - s } else { 1.0 };
            }
            "outside-ringing-pulse" if now.on => {
                let t = now.since_on;
                let ringing = (TAU * e.between(0, 90.0, 300.0) * t).sin() * (-t / e.between(1, 4e-3, 20e-3)).exp();
                f.voltage *= (1.0 + s * ringing).max(0.0);
            }
            "outside-missing-pulse" => f.voltage *= 1.0 - s * pulsing(2.0 + (3.0 * e.knob[0]).floor()),
            "outside-driver-resonance" => {
                let off = (self.drive.duty - 0.3 - 0.4 * e.knob[0]) / (0.05 + 0.06 * e.knob[1]);
                f.speed *= 1.0 + s * (-off * off).exp();
            }
            "outside-heading-drift" => f.speed *= 1.0 + s * self.drive.sign * (2.0 * e.rising.at(x) - 1.0),
            _ => {}
        }
    }

    /// What changes within a cell: friction that hangs on the speed, and stiffness that hangs on what it carries.
    #[inline]
    pub fn grip(&self, of: &Grip, rotor: &Rotor, surface: f64, amplitude: f64) -> Grip {
        let mut g = *of;
        for e in self.hidden {
            let s = e.size;
            match e.name {
                "stribeck-friction" => {
                    let x = rotor.speed.abs() / self.slow;
                    match e.form {
                        "bell" => g.drag += s * self.motor.contact * (-x * x).exp(),
                        "exponential" => g.drag += s * self.motor.contact * (-x).exp(),
                        "curve" => g.drag += s * self.motor.contact * (1.0 - e.rising.at(0.5 * x)),
                        // What sticks holds better than what slips.
                        _ => {
                            let slip = (surface - rotor.speed) / self.slow;
                            let m = 1.0 + 2.0 * s * (-slip * slip).exp();
                            g.contact *= m;
                            g.brake *= m;
                        }
                    }
                }
                "contact-stiffening" => {
                    let x = rotor.bend.abs();
                    match e.form {
                        "bend" => g.contact *= (x + 0.02).powf(s),
                        "wave" => g.contact *= (amplitude + 0.02).powf(s).min(2.0),
                        // Soft at rest, its own at full speed.
                        "speed" => g.renewal *= 1.0 + 8.0 * s * (1.0 - rotor.speed.abs() / self.motor.full).max(0.0),
                        _ => g.contact *= 1.0 - s / e.largest() * (1.0 - e.rising.at(x)),
                    }
                }
                _ => {}
            }
        }
        g
    }
}
