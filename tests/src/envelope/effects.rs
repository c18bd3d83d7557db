//! What this generator can hide: names, forms, largest sizes, and what an effect does to duty, encoder and clock.

use super::curves::{Curve, Ring};
use crate::profile::random::Dice;
use std::collections::BTreeMap;

/// One hidden effect.
#[derive(Debug, Clone, PartialEq)]
pub struct Effect {
    /// Name as in the library, or `outside-...`.
    pub name: &'static str,
    /// Which form was drawn; of effects outside the library, what it hangs on.
    pub form: &'static str,
    /// Size, in the effect's own unit; signed where the sign means something.
    pub size: f64,
    /// Numbers in 0..1 that set times, places and shares.
    pub knob: [f64; 5],
    /// From 0 to 1 over the effect's own coordinate.
    pub rising: Curve,
    /// Of mean 0 over the effect's own coordinate.
    pub wandering: Curve,
    /// Of the shaft's angle.
    pub ring: Ring,
}

/// Name, forms, largest size that makes sense.
type Entry = (&'static str, &'static [&'static str], f64);

/// Effects of open-loop runs that are in the library.
///
/// The sizes are shares of the free speed, of the friction or of the whole duty where nothing else is said.
pub const LIBRARY: [Entry; 16] = [
    // Loss when warmed through: a motor that loses more stops.
    ("resonance-heating", &["resonance", "resonance, two times", "friction", "curve"], 0.5),
    ("direction-asymmetry", &["speed", "wave", "friction", "quadrature", "curve"], 0.25),
    // In pitches: with half of one the narrow slots are lost.
    ("unequal-edges", &["even", "round the wheel"], 0.45),
    ("frequency-settling", &["run time", "driven time", "tracking loop", "curve"], 0.6),
    ("dead-zone", &["cut", "soft", "gate", "curve"], 0.25),
    // In rad: a millimetre and a half on a wheel of 15 mm across.
    ("encoder-eccentricity", &["once a turn", "twice as well", "curve"], 0.2),
    ("supply-sag", &["load", "storage", "mean current", "curve"], 0.4),
    ("run-in-wear", &["logarithm", "exponential", "friction", "curve"], 0.4),
    // Of the clock's rate: an RC oscillator that nobody trimmed.
    ("clock-error", &["constant", "drifting", "warming", "curve"], 0.04),
    ("preload-runout", &["preload", "height", "both"], 0.5),
    ("high-duty-saturation", &["soft", "flat", "power", "curve"], 0.5),
    // Of the drive's friction: what holds more does not start.
    ("stribeck-friction", &["bell", "exponential", "contact", "curve"], 0.8),
    // In s: a quarter of the longer PWM period.
    ("start-delay", &["fixed", "growing", "curve"], 5e-3),
    // One over the number of steps.
    ("duty-quantisation", &["round", "floor", "uneven"], 1.0 / 6.0),
    // Added exponent, or a relative change.
    ("contact-stiffening", &["bend", "wave", "speed", "curve"], 1.5),
    // Places a run at which something is lost.
    ("dropped-samples", &["words", "blocks"], 3.0),
];

/// What no library holds; the form is the coordinate it hangs on. Sizes are shares of the free speed.
pub const OUTSIDE: [Entry; 10] = [
    ("outside-hum", &["time"], 0.3),
    ("outside-nodes", &["angle"], 0.5),
    ("outside-lifting-off", &["time"], 0.6),
    ("outside-weather", &["order"], 0.2),
    ("outside-ringing-pulse", &["phase"], 0.7),
    ("outside-driver-resonance", &["duty"], 0.4),
    ("outside-heading-drift", &["direction"], 0.3),
    ("outside-cage", &["angle"], 0.5),
    ("outside-missing-pulse", &["phase"], 0.9),
    ("outside-changed-part", &["order"], 0.3),
];

fn entry(name: &str) -> Option<Entry> {
    LIBRARY.iter().chain(&OUTSIDE).find(|e| e.0 == name).copied()
}

/// The larger of `x` and 0, the corner rounded over `width`.
fn softened(x: f64, width: f64) -> f64 {
    let scaled = x / width;
    // Beyond 40 widths nothing is left of the corner.
    if scaled > 40.0 { x } else { width * scaled.exp().ln_1p() }
}

impl Effect {
    /// Draws form and shape; the size is yet to be found.
    pub fn draw(name: &str, dice: &mut Dice) -> Option<Self> {
        let (name, forms, largest) = entry(name)?;
        let either = match name {
            "direction-asymmetry" | "unequal-edges" | "clock-error" => dice.chance(0.5),
            "run-in-wear" | "frequency-settling" | "outside-heading-drift" | "outside-driver-resonance" => {
                dice.chance(0.4)
            }
            _ => false,
        };
        let form = dice.pick(forms);
        let knob: [f64; 5] = std::array::from_fn(|_| dice.even(0.0, 1.0));
        let orders: &[f64] = match (name, form) {
            ("encoder-eccentricity", "once a turn") => &[1.0],
            ("encoder-eccentricity", "twice as well") => &[1.0, 2.0],
            // Nodal diameters of the stator that the rotor's lining has taken the print of, and their neighbours.
            ("outside-nodes", _) => {
                [&[6.0, 7.0], &[12.0, 11.0], &[9.0, 10.0], &[7.0, 5.0]][(4.0 * knob[0]) as usize % 4]
            }
            // A cage of balls goes round slower than the shaft by their share of the bearing.
            ("outside-cage", _) => {
                [&[0.38, 0.76], &[0.41, 0.82], &[0.43, 3.01], &[2.58, 5.16]][(4.0 * knob[0]) as usize % 4]
            }
            _ => &[1.0, 2.0, 3.0],
        };
        Some(Self {
            name,
            form,
            size: if either { -0.2 * largest } else { 0.2 * largest },
            knob,
            rising: Curve::rising(dice),
            wandering: Curve::wandering(dice),
            ring: Ring::draw(dice, orders),
        })
    }

    /// Largest size that makes sense.
    pub fn largest(&self) -> f64 {
        entry(self.name).map_or(1.0, |e| e.2)
    }

    /// A number between two, even in the logarithm.
    pub fn between(&self, knob: usize, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.knob[knob])
    }

    /// Steps of a quantised duty, 6 to 64.
    pub fn steps(&self) -> f64 {
        (1.0 / self.size.abs().max(1e-3)).round().clamp(6.0, 64.0)
    }

    /// Numbers with a meaning beyond this generator, under the library's names; only of forms whose number means the same.
    pub fn parameters(&self) -> BTreeMap<String, f64> {
        let number = match (self.name, self.form) {
            ("dead-zone", "cut") => Some(("threshold_duty", self.size)),
            ("start-delay", "fixed") => Some(("delay_s", self.size)),
            ("direction-asymmetry", "speed") => Some(("speed_asymmetry", self.size)),
            ("unequal-edges", "even") => Some(("high_slot_excess", self.size)),
            ("clock-error", "constant") => Some(("relative_clock_error", self.size)),
            ("encoder-eccentricity", _) => Some(("eccentricity_rad", self.size)),
            ("duty-quantisation", "round" | "floor") => Some(("duty_steps", self.steps())),
            _ => None,
        };
        number.map(|(k, v)| (k.to_owned(), v)).into_iter().collect()
    }

    /// What is left of an on fraction on its way to the driver.
    pub fn duty(&self, u: f64) -> f64 {
        let (s, k) = (self.size, self.knob[0]);
        let left = match (self.name, self.form) {
            ("dead-zone", "cut") => u - s,
            // The softplus of a cut, a third as wide as the cut is deep.
            ("dead-zone", "soft") => softened(u - s, s / 3.0 + 1e-4),
            ("dead-zone", "gate") => u / (1.0 + (-(u - s) / (0.002 + 0.01 * k)).exp()),
            ("dead-zone", "curve") => u - s * (0.5 + 0.5 * self.rising.at(u / (2.0 * s))),
            // Somewhere between a limit that all duties approach and one that they hit.
            ("high-duty-saturation", "soft") => u * (1.0 + (u * s / 0.7).powf(1.0 + 2.0 * k)).recip(),
            ("high-duty-saturation", "flat") => 1.0 - s - softened(1.0 - s - u, 0.02),
            ("high-duty-saturation", "curve") => u - s * u * self.rising.at((u - 0.3) / 0.7),
            ("duty-quantisation", "round") => (u * self.steps()).round() / self.steps(),
            // A little more than the fraction, which as a decimal may fall short of its own step.
            ("duty-quantisation", "floor") => (u * self.steps() + 1e-6).floor() / self.steps(),
            ("duty-quantisation", "uneven") => self.uneven(u),
            _ => u,
        };
        left.clamp(0.0, 1.0)
    }

    /// The nearest of steps that are not evenly spaced: a converter's.
    fn uneven(&self, u: f64) -> f64 {
        let steps = self.steps();
        let place = |n: f64| {
            let x = n / steps;
            0.7 * x + 0.3 * self.rising.at(x)
        };
        (0..=steps as usize)
            .map(|n| place(n as f64))
            .min_by(|a, b| (a - u).abs().total_cmp(&(b - u).abs()))
            .unwrap_or(u)
    }

    /// How much later a pulse begins than it should, in s, after `off_s` without drive.
    pub fn delay(&self, off_s: f64) -> f64 {
        // Off parts of a PWM period are 20 ms at most: what grows with the pause grows within them.
        match (self.name, self.form) {
            ("start-delay", "fixed") => self.size,
            ("start-delay", "growing") => self.size * (1.0 - (-off_s / self.between(0, 2e-3, 15e-3)).exp()),
            ("start-delay", "curve") => self.size * (0.2 + 0.8 * self.rising.at(off_s / 0.018)),
            _ => 0.0,
        }
    }

    /// Excess of a high slot in pitches at an angle of the wheel.
    pub fn slot_excess(&self, angle: f64) -> f64 {
        match (self.name, self.form) {
            ("unequal-edges", "even") => self.size,
            ("unequal-edges", _) => (self.size * (1.0 + 0.35 * self.ring.at(angle))).clamp(-0.7, 0.7),
            _ => 0.0,
        }
    }

    /// What a wheel's seat adds to its angle in rad.
    pub fn seat(&self, angle: f64) -> f64 {
        if self.name != "encoder-eccentricity" {
            return 0.0;
        }
        // The size is the first harmonic's; those above are a third of it at most.
        let first = self.ring.first(angle);
        self.size * (first + 0.4 * (self.ring.at(angle) - first))
    }

    /// What the recorder's clock gains in s up to a time, in a run of some length.
    pub fn clock(&self, t: f64, seconds: f64) -> f64 {
        if self.name != "clock-error" {
            return 0.0;
        }
        let x = t / seconds;
        let shape = match self.form {
            "constant" => x,
            "drifting" => x + 0.3 * (self.knob[0] - 0.5) * x * x,
            // The rate settles from a third more or less.
            "warming" => {
                let tau = self.between(0, 0.1, 0.5);
                x + 0.6 * (self.knob[1] - 0.5) * tau * (1.0 - (-x / tau).exp())
            }
            // Slopes of the curve are some ten at most: the rate wanders by a tenth.
            _ => x + 0.01 * (self.wandering.at(x) - self.wandering.at(0.0)),
        };
        self.size * seconds * shape
    }

    /// Where words are lost in a run, as shares of its record.
    pub fn lost(&self, dice: &mut Dice) -> Vec<f64> {
        if self.name != "dropped-samples" {
            return Vec::new();
        }
        // About `size` places a run: a whole number on either side of it.
        let places = self.size.floor() as usize + usize::from(dice.chance(self.size.fract()));
        let mut all = Vec::new();
        for _ in 0..places {
            let at = dice.even(0.05, 0.92);
            let words = if self.form == "blocks" { dice.whole(1, 3) } else { 1 };
            all.extend(std::iter::repeat_n(at, words));
        }
        all
    }
}
