//! What this generator can hide, and how it acts on the rotor, in forms drawn for each data set.

use super::shape::{Curve, Rising, between, normal, one_of};
use crate::drive::Drive;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// One hidden effect: its form, its size and the numbers that shape it.
#[derive(Debug, Clone, PartialEq)]
pub struct Effect {
    /// Name as in the library, or `outside-...`.
    pub name: &'static str,
    /// Drawn form.
    pub form: &'static str,
    /// Size; what it means depends on the effect.
    pub size: f64,
    /// Drawn sign.
    pub sign: f64,
    /// Even numbers in 0..1 that set times, places and shares.
    pub a: [f64; 6],
    /// Weights and phases of harmonics 1–4; the weights' squares sum to 1.
    pub harmonics: [(f64, f64); 4],
    curve: Rising,
}

/// Name, forms, largest size that makes sense.
type Entry = (&'static str, &'static [&'static str], f64);

/// Effects of open-loop runs that are in the library.
pub const LIBRARY: [Entry; 16] = [
    ("resonance-heating", &["loss", "two poles", "detuning", "smooth"], 0.6),
    ("frequency-settling", &["run", "run, two times", "on-time", "recovering"], 0.8),
    ("dead-zone", &["hard offset", "soft offset", "gate", "rescaled"], 0.3),
    ("start-delay", &["constant", "scattered", "after rest"], 6e-3),
    ("duty-quantisation", &["round", "floor"], 0.2),
    ("high-duty-saturation", &["rational", "flat", "soft flat", "smooth"], 1.0),
    ("contact-stiffening", &["wide band", "bent line"], 1.0),
    ("direction-asymmetry", &["speed", "speed and braking", "friction"], 0.4),
    ("preload-runout", &["speed", "torque", "all", "all but braking"], 0.6),
    ("encoder-eccentricity", &["harmonics"], 0.3),
    ("unequal-edges", &["duty"], 0.5),
    ("clock-error", &["constant", "drifting"], 0.04),
    ("dropped-samples", &["words"], 3.0),
    ("stribeck-friction", &["exponential", "lorentzian", "presliding"], 0.75),
    ("supply-sag", &["fast", "mean", "smooth in the duty"], 0.5),
    ("run-in-wear", &["logarithm", "power", "saturating", "smooth"], 0.5),
];

/// What no library holds, with the coordinate it hangs on as its form.
pub const OUTSIDE: [Entry; 7] = [
    ("outside-cogging", &["angle"], 0.6),
    ("outside-cos3", &["angle"], 0.6),
    ("outside-daytime", &["order"], 0.3),
    ("outside-telegraph", &["time"], 0.3),
    ("outside-bump", &["duty"], 0.5),
    ("outside-wander", &["time"], 0.3),
    ("outside-pulse-angle", &["angle"], 0.3),
];

/// As [`OUTSIDE`], for experiments in both directions.
pub const OUTSIDE_BOTH: Entry = ("outside-memory", &["direction"], 0.4);

impl Effect {
    /// Draws form, sign and shape; the size is yet to be found.
    pub fn draw(name: &str, rng: &mut ChaCha8Rng) -> Option<Self> {
        let (name, forms, largest) =
            *LIBRARY.iter().chain(&OUTSIDE).chain([&OUTSIDE_BOTH]).find(|(n, _, _)| *n == name)?;
        let mut harmonics = [(0.0, 0.0); 4];
        let fall = between(rng, 0.5, 3.0);
        for (k, h) in harmonics.iter_mut().enumerate() {
            *h = ((normal(rng).abs() + 0.05) / ((k + 1) as f64).powf(fall), between(rng, 0.0, TAU));
        }
        let norm = harmonics.iter().map(|(w, _)| w * w).sum::<f64>().sqrt();
        harmonics.iter_mut().for_each(|(w, _)| *w /= norm);
        Some(Self {
            name,
            form: one_of(rng, forms),
            size: 0.2 * largest,
            sign: if rng.random() { 1.0 } else { -1.0 },
            a: std::array::from_fn(|_| rng.random()),
            harmonics,
            curve: Curve::draw(rng).table(),
        })
    }

    /// Largest size that makes sense.
    pub fn largest(&self) -> f64 {
        LIBRARY
            .iter()
            .chain(&OUTSIDE)
            .chain([&OUTSIDE_BOTH])
            .find(|(n, _, _)| *n == self.name)
            .map_or(1.0, |(_, _, largest)| *largest)
    }

    /// Smallest size that is the effect and not a nuisance: crystals are that wrong anyway.
    pub fn least(&self) -> f64 {
        if self.name == "clock-error" { 3e-3 } else { 0.0 }
    }

    fn between(&self, k: usize, low: f64, high: f64) -> f64 {
        low + (high - low) * self.a[k]
    }

    /// Steps that a quantised duty has.
    pub fn steps(&self) -> f64 {
        (1.0 / self.size.max(1e-3)).round().max(4.0)
    }

    /// The numbers that have a meaning beyond this generator, under the library's names.
    pub fn parameters(&self) -> BTreeMap<String, f64> {
        let mut numbers = BTreeMap::new();
        let mut put = |name: &str, value: f64| {
            numbers.insert(name.to_owned(), value);
        };
        match (self.name, self.form) {
            ("dead-zone", "hard offset" | "soft offset") => put("threshold_duty", self.size),
            ("start-delay", "constant" | "scattered") => put("delay_s", self.size),
            ("direction-asymmetry", "speed" | "speed and braking") => {
                put("speed_asymmetry", self.sign * self.size);
            }
            ("unequal-edges", _) => put("high_slot_excess", self.sign * self.size),
            ("clock-error", "constant") => put("relative_clock_error", self.sign * self.size),
            ("supply-sag", "fast" | "mean") => put("speed_lost_at_full_duty", self.size),
            ("encoder-eccentricity", _) => put("eccentricity_rad", self.size),
            ("duty-quantisation", _) => put("duty_steps", self.steps()),
            _ => {}
        }
        numbers
    }

    /// Time constants of warmth in s, and the share of it that a rest of a given length leaves.
    fn warmth(&self, seconds: f64) -> [f64; 2] {
        let tau = seconds * 0.15 * 10f64.powf(self.a[0]);
        [tau, tau * self.between(1, 3.0, 8.0)]
    }

    /// On fraction that reaches the driver.
    fn duty(&self, u: f64) -> f64 {
        let s = self.size;
        let made = match (self.name, self.form) {
            ("dead-zone", "hard offset") => u - s,
            ("dead-zone", "soft offset") => {
                let soft = self.between(0, 0.005, 0.03);
                soft * ((u - s) / soft).min(40.0).exp().ln_1p().max((u - s) / soft - 40.0)
            }
            ("dead-zone", "gate") => {
                if u < s {
                    0.0
                } else {
                    u
                }
            }
            ("dead-zone", _) => (u - s) / (1.0 - s),
            ("duty-quantisation", "round") => (u * self.steps()).round() / self.steps(),
            ("duty-quantisation", _) => (u * self.steps() + 1e-9).floor() / self.steps(),
            ("high-duty-saturation", "rational") => u / (1.0 + s * u),
            ("high-duty-saturation", "flat") => u.min(1.0 - 0.7 * s),
            ("high-duty-saturation", "soft flat") => {
                let (knee, n) = (1.0 - 0.6 * s, self.between(0, 3.0, 12.0));
                u / (1.0 + (u / knee).powf(n)).powf(1.0 / n)
            }
            ("high-duty-saturation", _) => u * (1.0 - 0.6 * s * self.curve.at(u)),
            _ => u,
        };
        made.clamp(0.0, 1.0)
    }

    fn runout(&self, angle: f64) -> f64 {
        let m: f64 = self.harmonics.iter().enumerate().map(|(k, (w, p))| w * ((k + 1) as f64 * angle - p).cos()).sum();
        self.size * m
    }
}

/// What acts on the rotor at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Factors {
    /// On the crest's speed.
    pub gain: f64,
    /// On the contact torque.
    pub grip: f64,
    /// On the friction with the wave gone.
    pub brake: f64,
    /// Further friction over inertia in rad/s².
    pub drag: f64,
    /// Further slip band.
    pub slip: f64,
    /// Load over inertia in rad/s².
    pub load: f64,
}

impl Default for Factors {
    fn default() -> Self {
        Self { gain: 1.0, grip: 1.0, brake: 1.0, drag: 0.0, slip: 0.0, load: 0.0 }
    }
}

/// What happened before a run.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Past {
    /// Time since the first run began in s.
    pub time_s: f64,
    /// Revolutions turned.
    pub revolutions: f64,
    /// Warmth left at the two poles.
    pub warm: [f64; 2],
    /// Direction of the run before; 0 for none.
    pub sign: f64,
}

impl Past {
    /// After a run and a rest.
    pub fn after(self, drive: &Drive, crest: f64, rest_s: f64, hidden: &[Effect]) -> Self {
        let mut next = self;
        for e in hidden.iter().filter(|e| e.name == "resonance-heating") {
            for (warm, tau) in next.warm.iter_mut().zip(e.warmth(drive.seconds)) {
                *warm = drive.duty + (*warm - drive.duty) * (-drive.seconds / tau).exp();
                // From nothing kept to cooling ten times as slowly as it warms.
                *warm *= (-rest_s / (tau * 0.05 * 200f64.powf(e.a[2]))).exp();
            }
        }
        next.time_s += drive.seconds + rest_s;
        next.revolutions += drive.duty * crest * drive.seconds / TAU;
        next.sign = drive.sign;
        next
    }
}

/// Effects at work during one run.
#[derive(Debug, Clone)]
pub struct Acting<'a> {
    hidden: &'a [Effect],
    drive: Drive,
    past: Past,
    /// Angle of the rotor at t = 0 in rad.
    pub zero_angle: f64,
    /// Revolutions that the whole experiment turns, about.
    total_revolutions: f64,
    contact: f64,
    crest: f64,
    warm: [f64; 2],
    unsettled: f64,
    sagged: f64,
    rested_at: f64,
    scatter: ChaCha8Rng,
    wander: Vec<f64>,
}

const WANDER_S: f64 = 0.02;

impl<'a> Acting<'a> {
    /// For one run of a rotor with this crest speed and contact.
    pub fn new(
        hidden: &'a [Effect],
        drive: Drive,
        past: Past,
        zero_angle: f64,
        total_revolutions: f64,
        [crest, contact]: [f64; 2],
        seed: u64,
    ) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let wander = hidden.iter().find_map(|e| e.wandering(drive.seconds, &mut rng)).unwrap_or_default();
        Self {
            hidden,
            drive,
            past,
            zero_angle,
            total_revolutions,
            contact,
            crest,
            warm: past.warm,
            unsettled: 1.0,
            sagged: 0.0,
            rested_at: 0.0,
            scatter: rng,
            wander,
        }
    }

    /// On fraction that reaches the driver.
    pub fn duty(&self, asked: f64) -> f64 {
        self.hidden.iter().fold(asked, |u, e| e.duty(u))
    }

    /// How much later than it should a pulse begins, in s.
    pub fn delay(&mut self, pulse: u32, off_s: f64, travelled: f64) -> f64 {
        let mut late = 0.0;
        for e in self.hidden {
            let begins = off_s > 0.0 || pulse == 0;
            match (e.name, e.form) {
                ("start-delay", "constant") if begins => late += e.size,
                ("start-delay", "scattered") if begins => {
                    late += e.size * (1.0 + 0.15 * normal(&mut self.scatter)).max(0.0);
                }
                ("start-delay", _) if begins => {
                    let rest = if pulse == 0 { 1.0 } else { off_s };
                    late += e.size * (1.0 - (-rest / e.between(0, 1e-3, 8e-3)).exp());
                }
                ("outside-pulse-angle", _) if begins => {
                    let k = (1.0 + 4.0 * e.a[0]).round();
                    let angle = self.zero_angle + self.drive.sign * travelled;
                    late += e.size / self.drive.pwm_hz * (0.5 + 0.5 * (k * angle + TAU * e.a[1]).cos());
                }
                _ => {}
            }
        }
        late
    }

    /// What acts at `t`, for a step of `dt`.
    pub fn factors(&mut self, t: f64, dt: f64, on: bool, travelled: f64, speed: f64) -> Factors {
        let mut f = Factors::default();
        let angle = self.zero_angle + self.drive.sign * travelled;
        for e in self.hidden {
            let s = e.size;
            match e.name {
                "resonance-heating" => f.gain *= self.heat(e, dt, on),
                "frequency-settling" => f.gain *= self.settle(e, t, dt, on),
                "contact-stiffening" if e.form == "wide band" => f.slip += s,
                "contact-stiffening" => f.grip *= 1.0 - 0.95 * s * e.curve.at(speed / self.crest),
                "direction-asymmetry" => {
                    let g = s * e.sign * self.drive.sign;
                    match e.form {
                        "speed" => f.gain *= 1.0 + g,
                        "friction" => {
                            f.grip *= 1.0 + 2.0 * g;
                            f.brake *= 1.0 - 2.0 * g;
                        }
                        _ => {
                            f.gain *= 1.0 + g;
                            f.brake *= 1.0 - g * e.between(0, 0.2, 1.5);
                        }
                    }
                }
                "preload-runout" => {
                    let m = (1.0 + e.runout(angle)).max(0.05);
                    f.gain *= if e.form == "torque" { 1.0 } else { m };
                    f.grip *= if e.form == "speed" { 1.0 } else { m };
                    f.brake *= if matches!(e.form, "all" | "torque") { m } else { 1.0 };
                }
                "stribeck-friction" => f.drag += self.sticking(e, on, travelled, speed),
                "supply-sag" => f.gain *= self.sag(e, dt, on),
                "run-in-wear" => {
                    let revolutions = self.past.revolutions + travelled / TAU;
                    f.gain *= 1.0 + e.sign * s * (e.worn(revolutions, self.total_revolutions) - 0.5);
                }
                _ if e.name.starts_with("outside") => f.gain *= self.outside(e, t, angle, travelled),
                _ => {}
            }
        }
        f
    }

    fn heat(&mut self, e: &Effect, dt: f64, on: bool) -> f64 {
        let goal = if on { 1.0 } else { 0.0 };
        for (warm, tau) in self.warm.iter_mut().zip(e.warmth(self.drive.seconds)) {
            *warm = goal + (*warm - goal) * (-dt / tau).exp();
        }
        let second = if e.form == "two poles" { e.between(3, 0.2, 0.8) } else { 0.0 };
        let warm = (1.0 - second) * self.warm[0] + second * self.warm[1];
        match e.form {
            "detuning" => 1.0 / (1.0 + (warm * warm) * e.size / (1.0 - e.size)),
            "smooth" => 1.0 - e.size * e.curve.at(warm),
            _ => 1.0 - e.size * warm,
        }
    }

    fn settle(&mut self, e: &Effect, t: f64, dt: f64, on: bool) -> f64 {
        let tau = 0.02 * 10f64.powf(e.a[0]);
        match e.form {
            "run" => self.unsettled = (-t / tau).exp(),
            "run, two times" => self.unsettled = 0.6 * (-t / tau).exp() + 0.4 * (-t / (4.0 * tau)).exp(),
            "on-time" if on => self.unsettled *= (-dt / tau).exp(),
            "recovering" if on => self.unsettled *= (-dt / tau).exp(),
            "recovering" => {
                self.unsettled = 1.0 - (1.0 - self.unsettled) * (-dt / (tau * e.between(1, 1.0, 6.0))).exp()
            }
            _ => {}
        }
        // Overshoots may be larger than the speed lost at a slow start.
        let sign = if e.a[2] < 0.7 { 1.0 } else { -0.6 };
        1.0 + sign * e.size * self.unsettled
    }

    fn sticking(&mut self, e: &Effect, on: bool, travelled: f64, speed: f64) -> f64 {
        let x = speed / (self.crest * e.between(0, 0.05, 0.5));
        let share = match e.form {
            "exponential" => (-x * x).exp(),
            "lorentzian" => 1.0 / (1.0 + x * x),
            _ => {
                if !on && speed.abs() < 0.01 * self.crest {
                    self.rested_at = travelled;
                }
                (-(travelled - self.rested_at) / (e.between(1, 0.1, 1.0) * TAU / 360.0)).exp()
            }
        };
        e.size * self.contact * share
    }

    fn sag(&mut self, e: &Effect, dt: f64, on: bool) -> f64 {
        let goal = if on { 1.0 } else { 0.0 };
        let tau = 3e-3 * 20f64.powf(e.a[0]);
        self.sagged = goal + (self.sagged - goal) * (-dt / tau).exp();
        match e.form {
            "fast" => 1.0 - e.size * self.sagged,
            "mean" => 1.0 - e.size * self.drive.duty,
            _ => 1.0 - e.size * e.curve.at(self.drive.duty),
        }
    }

    fn outside(&self, e: &Effect, t: f64, angle: f64, travelled: f64) -> f64 {
        let s = e.size;
        match e.name {
            "outside-cogging" => (1.0 + s * ((5.0 + 7.0 * e.a[0]).round() * angle + TAU * e.a[1]).cos()).max(0.05),
            "outside-cos3" => (1.0 + s * (3.0 * angle + TAU * e.a[1]).cos()).max(0.05),
            "outside-daytime" => {
                let period = 60.0 * 10f64.powf(e.a[0]);
                1.0 + s * (TAU * (self.past.time_s + t) / period + TAU * e.a[1]).sin()
            }
            "outside-bump" => {
                let x = (self.drive.duty - e.between(0, 0.35, 0.7)) / e.between(1, 0.05, 0.1);
                1.0 + e.sign * s * (-x * x).exp()
            }
            "outside-telegraph" | "outside-wander" => {
                let x = (t / WANDER_S).max(0.0);
                1.0 + s * self.wander.get(x as usize).or(self.wander.last()).copied().unwrap_or(0.0)
            }
            "outside-memory" if self.past.sign * self.drive.sign < 0.0 => {
                1.0 - s * (-travelled / (TAU * e.between(0, 0.5, 4.0))).exp()
            }
            _ => 1.0,
        }
    }
}

impl Effect {
    /// Share of the run-in that is done, 0..1 over the whole experiment.
    fn worn(&self, revolutions: f64, total: f64) -> f64 {
        let x = (revolutions / total.max(1.0)).min(1.0);
        let r0 = 0.02 * 20f64.powf(self.a[0]);
        match self.form {
            "logarithm" => (x / r0).ln_1p() / (1.0 / r0).ln_1p(),
            "power" => x.powf(self.between(0, 0.3, 0.8)),
            "saturating" => x * (1.0 + r0) / (x + r0),
            _ => self.curve.at(x),
        }
    }

    /// A speed that wanders or jumps during a run, every [`WANDER_S`]; unit deviation.
    fn wandering(&self, seconds: f64, rng: &mut ChaCha8Rng) -> Option<Vec<f64>> {
        let points = (seconds / WANDER_S) as usize + 2;
        match self.name {
            "outside-telegraph" => {
                let dwell = self.between(0, 0.2, 1.5);
                let mut state = if rng.random() { 1.0 } else { -1.0 };
                let jump = WANDER_S / dwell;
                Some(
                    (0..points)
                        .map(|_| {
                            if rng.random::<f64>() < jump {
                                state = -state;
                            }
                            state
                        })
                        .collect(),
                )
            }
            "outside-wander" => {
                let keep = (-WANDER_S / self.between(0, 0.3, 2.0)).exp();
                let mut x = normal(rng);
                Some(
                    (0..points)
                        .map(|_| {
                            x = keep * x + (1.0 - keep * keep).sqrt() * normal(rng);
                            x
                        })
                        .collect(),
                )
            }
            _ => None,
        }
    }
}
