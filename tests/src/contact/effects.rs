//! What this generator can hide: random functions of what each effect hangs on, and their sizes.

use super::smooth::{Ring, Table};
use crate::profile::random::Dice;
use std::collections::BTreeMap;

/// One effect: its form, size and the functions that shape it.
#[derive(Debug, Clone, PartialEq)]
pub struct Effect {
    /// Name as in the library, or `outside-...`.
    pub name: &'static str,
    /// Which form was drawn; outside the library, the coordinate it hangs on.
    pub form: &'static str,
    /// Size in the effect's own unit; signed where the sign means something.
    pub size: f64,
    /// Numbers in 0..1 that set times, places and shares.
    pub knob: [f64; 6],
    /// Rising from 0 to 1.
    pub climb: Table,
    /// Fading from 1 to 0 over four time constants.
    pub fade: Table,
    /// Mean 0, unit RMS, about two turns up and down.
    pub wave: Table,
    /// Of an angle.
    pub ring: Ring,
}

/// Name, forms, largest size, probability of the negative sign.
type Entry = (&'static str, &'static [&'static str], f64, f64);

/// Effects of open-loop runs that are in the library.
pub const LIBRARY: [Entry; 16] = [
    ("supply-sag", &["mean current", "capacitor"], 0.5, 0.0),
    ("clock-error", &["constant", "drifting"], 0.04, 0.5),
    ("contact-stiffening", &["softer", "softer by the share"], 0.95, 0.0),
    ("preload-runout", &["torque", "all", "speed"], 0.3, 0.0),
    ("start-delay", &["constant", "scattered", "growing with the pause"], 6e-3, 0.0),
    ("resonance-heating", &["one store", "three stores", "wave"], 0.6, 0.0),
    ("unequal-edges", &["even round the wheel", "varying round the wheel"], 0.5, 0.5),
    ("dead-zone", &["offset", "closing", "gate"], 0.3, 0.0),
    ("frequency-settling", &["run", "driven time", "flank"], 0.8, 0.4),
    ("run-in-wear", &["revolutions"], 0.5, 0.35),
    ("high-duty-saturation", &["driven time", "speed"], 0.6, 0.0),
    ("encoder-eccentricity", &["off centre", "off centre and tilted"], 0.3, 0.0),
    ("duty-quantisation", &["nearest", "below", "uneven"], 0.2, 0.0),
    ("dropped-samples", &["words", "bursts"], 3.0, 0.0),
    ("direction-asymmetry", &["speed", "grip", "speed and grip"], 0.4, 0.5),
    ("stribeck-friction", &["fading"], 0.8, 0.0),
];

/// What a series of runs cannot show by itself; hidden only where it is asked for.
pub const ON_REQUEST: [Entry; 1] = [("presliding", &["yielding"], 0.02, 0.0)];

/// What no library holds; the form is the coordinate it hangs on.
pub const OUTSIDE: [Entry; 10] = [
    ("outside-swell", &["time"], 0.4, 0.5),
    ("outside-teeth", &["angle"], 0.5, 0.0),
    ("outside-comb", &["duty"], 0.4, 0.5),
    ("outside-sessions", &["order"], 0.4, 0.5),
    ("outside-crossing", &["direction"], 0.4, 0.5),
    ("outside-stagger", &["phase"], 0.7, 0.5),
    ("outside-stumbles", &["time"], 0.9, 0.0),
    ("outside-dent", &["angle"], 0.9, 0.5),
    ("outside-tide", &["order"], 0.4, 0.5),
    ("outside-flutter", &["phase"], 0.8, 0.5),
];

/// Every name that can be hidden in open-loop runs.
pub fn names() -> impl Iterator<Item = &'static str> {
    LIBRARY.iter().chain(&OUTSIDE).chain(&ON_REQUEST).map(|e| e.0)
}

fn entry(name: &str) -> Option<Entry> {
    LIBRARY.iter().chain(&OUTSIDE).chain(&ON_REQUEST).find(|e| e.0 == name).copied()
}

impl Effect {
    /// Draws form, sign and functions; the size is yet to be found.
    pub fn draw(name: &str, dice: &mut Dice) -> Option<Self> {
        let (name, forms, largest, negative) = entry(name)?;
        let sign = if dice.chance(negative) { -1.0 } else { 1.0 };
        let ring = match name {
            "outside-dent" => Ring::bumps(dice, 1, [60.0, 250.0]),
            _ => {
                let bumps = dice.whole(1, 3);
                Ring::bumps(dice, bumps, [0.3, 4.0])
            }
        };
        let length = dice.even(0.12, 0.22);
        Some(Self {
            name,
            form: dice.pick(forms),
            size: sign * 0.2 * largest,
            knob: std::array::from_fn(|_| dice.even(0.0, 1.0)),
            climb: Table::climb(dice, 0.8),
            fade: Table::fade(dice),
            wave: Table::wave(dice, length),
            ring,
        })
    }

    /// In the form that acts alike on any motor, for what every motor has a little of.
    pub fn in_form(mut self, form: &'static str) -> Self {
        self.form = form;
        self
    }

    /// Largest size that makes sense.
    pub fn largest(&self) -> f64 {
        entry(self.name).map_or(1.0, |e| e.2)
    }

    /// Smallest size that is an effect: crystals are wrong by some millionths anyway, disks are not.
    pub fn least(&self) -> f64 {
        match self.name {
            "clock-error" => 3e-3,
            "dropped-samples" => 0.1,
            _ => 0.0,
        }
    }

    /// Knob `k` between two values.
    pub fn even(&self, k: usize, low: f64, high: f64) -> f64 {
        low + (high - low) * self.knob[k]
    }

    /// Knob `k` between two positive values, even in the logarithm.
    pub fn decade(&self, k: usize, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.knob[k])
    }

    /// Its fading at a time over the time constant.
    pub fn faded(&self, times: f64) -> f64 {
        self.fade.at(0.25 * times)
    }

    /// Steps of a quantised duty.
    pub fn steps(&self) -> f64 {
        (1.0 / self.size.max(1e-3)).round().max(4.0)
    }

    /// Numbers with a meaning beyond this generator, under the library's names.
    pub fn parameters(&self) -> BTreeMap<String, f64> {
        let number = match (self.name, self.form) {
            ("dead-zone", "offset") => Some(("threshold_duty", self.size)),
            ("start-delay", "constant" | "scattered") => Some(("delay_s", self.size)),
            ("direction-asymmetry", "speed" | "speed and grip") => Some(("speed_asymmetry", self.size)),
            ("unequal-edges", _) => Some(("high_slot_excess", self.size)),
            ("clock-error", "constant") => Some(("relative_clock_error", self.size)),
            ("supply-sag", _) => Some(("speed_lost_at_full_duty", self.size)),
            ("encoder-eccentricity", _) => Some(("eccentricity_rad", self.size)),
            ("duty-quantisation", "nearest" | "below") => Some(("duty_steps", self.steps())),
            _ => None,
        };
        number.map(|(k, v)| (k.to_owned(), v)).into_iter().collect()
    }

    /// On fraction that reaches the driver when `u` does.
    pub fn duty(&self, u: f64) -> f64 {
        let s = self.size;
        // A threshold between 0 and 1, nowhere abrupt.
        let above = |width: f64| 0.5 * (1.0 + ((u - s) / width).tanh());
        let past = |width: f64| {
            let x = (u - s) / width;
            if x > 30.0 { u - s } else { width * x.exp().ln_1p() }
        };
        let made = match (self.name, self.form) {
            ("dead-zone", "offset") => past(self.decade(0, 1e-3, 0.01)),
            ("dead-zone", "closing") => {
                past(self.decade(0, 1e-3, 0.01)) + s * self.even(1, 0.2, 0.7) * self.climb.at((u - s) / (1.0 - s))
            }
            ("dead-zone", _) => u * above(2e-3),
            ("duty-quantisation", "nearest") => (u * self.steps()).round() / self.steps(),
            ("duty-quantisation", "below") => (u * self.steps() + 1e-9).floor() / self.steps(),
            ("duty-quantisation", _) => {
                let step = (u * self.steps()).round();
                // Steps of unlike height, as a converter's are.
                (step + 0.3 * (7.1 * step + 6.3 * self.knob[0]).sin() * (1.0 - u)) / self.steps()
            }
            ("high-duty-saturation", "driven time") => u - s * self.bend(u),
            _ => u,
        };
        made.clamp(0.0, 1.0)
    }

    /// From a knee on, rising faster and faster to 1.
    pub fn bend(&self, u: f64) -> f64 {
        let knee = self.even(0, 0.1, 0.7);
        self.climb.at((u - knee) / (1.0 - knee)).powf(self.even(1, 1.2, 2.5))
    }

    /// Relative error of the recorder's clock at a share of the drive.
    pub fn clock(&self, share: f64) -> f64 {
        match (self.name, self.form) {
            ("clock-error", "constant") => self.size,
            ("clock-error", _) => self.size * (1.0 + 0.35 * (self.climb.at(share) - 0.5)),
            _ => 0.0,
        }
    }
}
