//! What this generator can hide: mostly smooth random functions of what an effect hangs on.

use super::random::{Dice, Periodic, Smooth};
use crate::drive::Drive;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// One hidden effect.
#[derive(Debug, Clone, PartialEq)]
pub struct Effect {
    /// Name as in the library, or `outside-...`.
    pub name: &'static str,
    /// Which variant was drawn.
    pub variant: &'static str,
    /// Size, in the effect's own unit; signed where the sign means something.
    pub size: f64,
    /// Numbers in 0..1 that set times, places and shares.
    pub knob: [f64; 5],
    rising: Smooth,
    late: Smooth,
    free: Smooth,
    /// Of the rotor's or the wheel's angle.
    pub periodic: Periodic,
}

/// Name, variants, largest size.
type Entry = (&'static str, &'static [&'static str], f64);

/// Effects of open-loop runs that are in the library.
pub const LIBRARY: [Entry; 16] = [
    ("encoder-eccentricity", &["wheel"], 0.25),
    ("resonance-heating", &["speed", "speed and rise"], 0.5),
    ("clock-error", &["constant", "drifting"], 0.04),
    ("dead-zone", &["nearly even", "soft", "gate"], 0.25),
    ("direction-asymmetry", &["speed", "rise and fall", "all"], 0.35),
    ("run-in-wear", &["speed"], 0.4),
    ("unequal-edges", &["wheel"], 0.5),
    ("supply-sag", &["within the pulse", "over the pulses"], 0.45),
    ("frequency-settling", &["since the start", "of driven time", "after each rest"], 0.7),
    ("preload-runout", &["speed", "speed and rates", "rates"], 0.5),
    ("high-duty-saturation", &["driven time", "speed"], 0.7),
    ("start-delay", &["even", "growing with the rest"], 5e-3),
    ("stribeck-friction", &["curve"], 0.9),
    ("duty-quantisation", &["nearest", "below"], 0.2),
    ("contact-stiffening", &["slack"], 1.2),
    ("dropped-samples", &["words"], 2.5),
];

/// What no library holds; the variant is the coordinate it hangs on.
pub const OUTSIDE: [Entry; 8] = [
    ("outside-beat", &["time"], 0.3),
    ("outside-ripple", &["angle"], 0.5),
    ("outside-touch", &["time"], 0.5),
    ("outside-days", &["order"], 0.3),
    ("outside-slipping-pattern", &["angle"], 0.5),
    ("outside-alternate", &["phase"], 0.6),
    ("outside-notch", &["duty"], 0.5),
    ("outside-memory", &["direction"], 0.4),
];

fn entry(name: &str) -> Option<Entry> {
    LIBRARY.iter().chain(&OUTSIDE).find(|e| e.0 == name).copied()
}

impl Effect {
    /// Draws variant and shape; the size is yet to be found.
    pub fn draw(name: &str, dice: &mut Dice) -> Option<Self> {
        let (name, variants, largest) = entry(name)?;
        let knob: [f64; 5] = std::array::from_fn(|_| dice.even(0.0, 1.0));
        let knots = dice.whole(5, 8);
        let negative = match name {
            "direction-asymmetry" | "unequal-edges" | "clock-error" => dice.chance(0.5),
            "run-in-wear" | "frequency-settling" | "outside-notch" => dice.chance(0.4),
            _ => false,
        };
        let periodic = match name {
            "preload-runout" => Periodic::draw(dice, if knob[4] < 0.6 { 1 } else { 2 }, 4, 1.0),
            "outside-ripple" => Periodic::draw(dice, 5, 9, 1.0),
            // A pattern on something the rotor drags along: it does not come round with the wheel.
            "outside-slipping-pattern" => Periodic::draw(dice, 1, 2, 0.6 + 0.25 * knob[0]),
            _ => Periodic::draw(dice, 1, 3, 1.0),
        };
        Some(Self {
            name,
            variant: dice.pick(variants),
            size: if negative { -0.2 * largest } else { 0.2 * largest },
            knob,
            rising: Smooth::rising(dice, knots),
            late: Smooth::late(dice, knots),
            free: Smooth::free(dice, knots),
            periodic,
        })
    }

    /// Largest size that makes sense.
    pub fn largest(&self) -> f64 {
        entry(self.name).map_or(1.0, |e| e.2)
    }

    fn knob(&self, k: usize, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.knob[k])
    }

    /// Steps of a quantised duty.
    pub fn steps(&self) -> f64 {
        (1.0 / self.size.abs().max(1e-3)).round().max(4.0)
    }

    /// Numbers with a meaning beyond this generator, under the library's names.
    pub fn parameters(&self) -> BTreeMap<String, f64> {
        let number = match (self.name, self.variant) {
            ("dead-zone", "nearly even") => Some(("threshold_duty", self.size)),
            ("start-delay", "even") => Some(("delay_s", self.size)),
            ("direction-asymmetry", "speed" | "all") => Some(("speed_asymmetry", self.size)),
            ("unequal-edges", _) => Some(("high_slot_excess", self.size)),
            ("clock-error", "constant") => Some(("relative_clock_error", self.size)),
            ("encoder-eccentricity", _) => Some(("eccentricity_rad", self.size)),
            ("duty-quantisation", _) => Some(("duty_steps", self.steps())),
            _ => None,
        };
        number.map(|(k, v)| (k.to_owned(), v)).into_iter().collect()
    }

    /// Clock: relative error at a time in a drive of given length.
    pub fn clock(&self, t: f64, seconds: f64) -> f64 {
        match (self.name, self.variant) {
            ("clock-error", "constant") => self.size,
            ("clock-error", _) => self.size * (1.0 + 0.2 * self.free.at(t / seconds)),
            _ => 0.0,
        }
    }

    fn warm_s(&self, seconds: f64) -> [f64; 3] {
        let fast = seconds * self.knob(0, 0.1, 0.8);
        [fast, 2.5 * fast, 7.0 * fast]
    }

    fn duty(&self, u: f64) -> f64 {
        let s = self.size;
        let made = match (self.name, self.variant) {
            ("dead-zone", "nearly even") => u - s * (1.0 + 0.06 * self.free.at(u)),
            ("dead-zone", "soft") => {
                let x = (u - s) / (0.5 * s + 0.01);
                if x > 1.0 { u - s } else { (0.5 * s + 0.01) * 0.25 * (x + 1.0).max(0.0).powi(2) }
            }
            // A gate opens between two of the duties, within a few thousandths.
            ("dead-zone", _) => u * ((u - s) / 0.004).clamp(0.0, 1.0),
            ("duty-quantisation", "nearest") => (u * self.steps()).round() / self.steps(),
            ("duty-quantisation", _) => ((u + 1e-9) * self.steps()).floor() / self.steps(),
            ("high-duty-saturation", "driven time") => u - 0.7 * s * self.late.at(u),
            _ => u,
        };
        made.clamp(0.0, 1.0)
    }
}

/// Where a run is.
#[derive(Debug, Clone, Copy)]
pub struct Now {
    /// Time in s, and the length that is asked about.
    pub t: f64,
    /// Length of the cell in s.
    pub dt: f64,
    /// Driven during some of it.
    pub on: bool,
    /// Travelled angle in rad.
    pub travelled: f64,
    /// Speed over full speed.
    pub speed: f64,
    /// Number of the pulse.
    pub pulse: i64,
}

/// What acts there: factors on the speed and on the rates of its rise and fall.
#[derive(Debug, Clone, Copy)]
pub struct Factors {
    /// On the speed.
    pub gain: f64,
    /// On the rate of the rise.
    pub rise: f64,
    /// On the rate of the fall.
    pub fall: f64,
}

/// What happened before a run.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Before {
    /// Share of the experiment's travel that is done, and that this run makes.
    pub travel: [f64; 2],
    /// Share of the experiment's runs that are done.
    pub done: f64,
    /// Warmth at the three times of [`Effect`].
    pub warm: [f64; 3],
    /// Direction of the last run, 0 before the first.
    pub sign: f64,
}

impl Before {
    /// Warmth after a drive and a rest.
    pub fn warmed(warm: [f64; 3], drive: &Drive, rest_s: f64, hidden: &[Effect]) -> [f64; 3] {
        let mut out = warm;
        for e in hidden.iter().filter(|e| e.name == "resonance-heating") {
            for (w, tau) in out.iter_mut().zip(e.warm_s(drive.seconds)) {
                *w = drive.duty + (*w - drive.duty) * (-drive.seconds / tau).exp();
                *w *= (-rest_s / (tau * e.knob(2, 0.05, 20.0))).exp();
            }
        }
        out
    }
}

/// Effects at work in one run.
#[derive(Debug, Clone)]
pub struct Work<'a> {
    hidden: &'a [Effect],
    drive: Drive,
    before: Before,
    zero: f64,
    warm: [f64; 3],
    driven: f64,
    rested: f64,
    supply: f64,
    touches: [f64; 2],
    beat: f64,
}

impl<'a> Work<'a> {
    /// For one run that starts at angle `zero`.
    pub fn new(hidden: &'a [Effect], drive: Drive, before: Before, zero: f64, seed: u64) -> Self {
        let mut dice = Dice::new(seed, "work");
        let from = dice.even(0.05, 0.8) * drive.seconds;
        let touches = if dice.chance(0.6) { [from, from + dice.even(0.1, 0.4) * drive.seconds] } else { [0.0; 2] };
        Self {
            hidden,
            drive,
            before,
            zero,
            warm: before.warm,
            driven: 0.0,
            rested: 1.0,
            supply: 0.0,
            touches,
            beat: dice.even(0.0, TAU),
        }
    }

    /// What is hidden adds this to the share in which the rise slackens.
    pub fn slack(&self) -> f64 {
        self.hidden.iter().filter(|e| e.name == "contact-stiffening").map(|e| e.size).sum()
    }

    /// What is hidden holds the rotor back by this at a speed `y` (1: the full one).
    pub fn stick(&self, y: f64) -> f64 {
        let sticking = self.hidden.iter().filter(|e| e.name == "stribeck-friction");
        sticking.map(|e| e.size * (1.0 - e.rising.at(y / e.knob(0, 0.08, 0.6)))).sum()
    }

    /// On fraction that reaches the driver.
    pub fn duty(&self, asked: f64) -> f64 {
        self.hidden.iter().fold(asked, |u, e| e.duty(u))
    }

    /// How much later than it should a pulse begins, in s.
    pub fn delay(&mut self, pulse: i64, off_s: f64, _travelled: f64) -> f64 {
        let starts = off_s > 1e-9 || pulse == 0;
        let late = |e: &Effect| match (e.name, e.variant) {
            ("start-delay", "even") if starts => e.size,
            ("start-delay", _) if starts => {
                let rest = if pulse == 0 { 1.0 } else { off_s };
                e.size * e.rising.at((rest * self.drive.pwm_hz).min(1.0)).sqrt()
            }
            _ => 0.0,
        };
        self.hidden.iter().map(late).sum()
    }

    /// What acts at a moment.
    pub fn factors(&mut self, now: &Now) -> Factors {
        let mut f = Factors { gain: 1.0, rise: 1.0, fall: 1.0 };
        if now.on {
            self.driven += now.dt;
            self.rested = (self.rested - now.dt * 20.0).max(0.0);
        } else {
            self.rested = (self.rested + now.dt * 20.0).min(1.0);
        }
        let angle = self.zero + self.drive.sign * now.travelled;
        for e in self.hidden {
            let s = e.size;
            match (e.name, e.variant) {
                ("resonance-heating", variant) => {
                    let cold = 1.0 - s * e.rising.at(self.warmth(e, now));
                    f.gain *= cold;
                    f.rise *= if variant == "speed" { 1.0 } else { cold };
                }
                ("frequency-settling", _) => f.gain *= 1.0 + s * self.unsettled(e, now),
                ("direction-asymmetry", variant) => {
                    let g = s * self.drive.sign;
                    f.gain *= if variant == "rise and fall" { 1.0 } else { 1.0 + g };
                    if variant != "speed" {
                        f.rise *= 1.0 + 1.5 * g;
                        f.fall *= 1.0 - 1.5 * g * e.knob[0];
                    }
                }
                ("preload-runout", variant) => {
                    let m = (1.0 + s * e.periodic.at(angle)).max(0.1);
                    f.gain *= if variant == "rates" { 1.0 } else { m };
                    f.rise *= if variant == "speed" { 1.0 } else { m };
                    f.fall *= if variant == "speed" { 1.0 } else { m.powf(e.knob[0]) };
                }
                ("supply-sag", "within the pulse") => {
                    let goal = if now.on { 1.0 } else { 0.0 };
                    self.supply += (goal - self.supply) * (1.0 - (-now.dt / e.knob(0, 3e-3, 40e-3)).exp());
                    f.gain *= 1.0 - s * e.rising.at(self.supply);
                }
                ("supply-sag", _) => f.gain *= 1.0 - s * e.rising.at(self.drive.duty),
                ("high-duty-saturation", "speed") => f.gain *= 1.0 - 0.6 * s * e.late.at(self.drive.duty),
                ("run-in-wear", _) => {
                    let [done, of] = self.before.travel;
                    let x = done + of * now.t / self.drive.seconds;
                    f.gain *= 1.0 + s * (e.rising.at(x.powf(e.knob(0, 0.3, 1.0))) - 0.5);
                }
                (name, _) if name.starts_with("outside") => f.gain *= self.outside(e, now, angle),
                _ => {}
            }
        }
        f
    }

    fn warmth(&mut self, e: &Effect, now: &Now) -> f64 {
        let goal = if now.on { 1.0 } else { 0.0 };
        for (w, tau) in self.warm.iter_mut().zip(e.warm_s(self.drive.seconds)) {
            *w += (goal - *w) * now.dt / tau;
        }
        let share = [1.0 - 0.7 * e.knob[1], 0.7 * e.knob[1] * (1.0 - 0.5 * e.knob[3]), 0.35 * e.knob[1] * e.knob[3]];
        self.warm.iter().zip(share).map(|(w, s)| w * s).sum()
    }

    fn unsettled(&self, e: &Effect, now: &Now) -> f64 {
        let tau = e.knob(0, 0.03, 0.25);
        let since = match e.variant {
            "since the start" => now.t / tau,
            "of driven time" => self.driven / tau,
            // Some of it comes back in every off part.
            _ => (now.t / tau).min(3.0 - 1.5 * self.rested * e.knob[1]),
        };
        1.0 - e.rising.at(since / 3.0)
    }

    fn outside(&self, e: &Effect, now: &Now, angle: f64) -> f64 {
        let s = e.size;
        match e.name {
            "outside-beat" => 1.0 + s * (TAU * e.knob(0, 0.7, 9.0) * now.t + self.beat).sin(),
            "outside-ripple" => (1.0 + s * e.periodic.at(angle)).max(0.05),
            "outside-slipping-pattern" => (1.0 + s * e.periodic.at(now.travelled + self.beat)).max(0.05),
            "outside-touch" if now.t > self.touches[0] && now.t < self.touches[1] => 1.0 - s,
            "outside-days" => 1.0 + 0.5 * s * e.free.at(self.before.done),
            "outside-alternate" if now.pulse % 2 == 0 => 1.0 + s,
            "outside-alternate" => 1.0 - s,
            "outside-notch" => {
                let x = (self.drive.duty - (0.3 + 0.45 * e.knob[0])) / (0.04 + 0.05 * e.knob[1]);
                1.0 + s / (1.0 + x.powi(4))
            }
            "outside-memory" if self.before.sign * self.drive.sign < 0.0 => {
                1.0 - s * (1.0 - e.rising.at(now.t / (self.drive.seconds * (0.2 + 0.8 * e.knob[0]))))
            }
            _ => 1.0,
        }
    }
}
