//! What can be hidden in the data: one effect at a size, in a form that the host's library does not use.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A hidden effect: a kind and its numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Hidden {
    /// Name as in the list of effects, or `outside-...` for one that is in no library.
    pub name: &'static str,
    /// Size; 1 is large. It is scaled to reach a wanted strength.
    pub size: f64,
    /// Sign, shape and phase numbers drawn from the seed.
    pub shape: [f64; 4],
}

/// Effects that show in open-loop runs.
pub const OPEN_LOOP: [&str; 15] = [
    "resonance-heating",
    "frequency-settling",
    "dead-zone",
    "start-delay",
    "duty-quantisation",
    "high-duty-saturation",
    "contact-stiffening",
    "direction-asymmetry",
    "preload-runout",
    "encoder-eccentricity",
    "unequal-edges",
    "clock-error",
    "stribeck-friction",
    "supply-sag",
    "run-in-wear",
];

/// Effects that are in no library.
pub const OUTSIDE: [&str; 3] = ["outside-cogging", "outside-rhythm", "outside-notch"];

impl Hidden {
    /// An effect with shape numbers drawn from `rng`, at a middling size.
    pub fn draw(name: &'static str, rng: &mut ChaCha8Rng) -> Self {
        Self { name, size: 0.3, shape: [rng.random(), rng.random(), rng.random(), rng.random()] }
    }

    /// Largest size that makes sense: beyond it the motor no longer turns, or the form is no longer itself.
    pub fn largest(&self) -> f64 {
        match self.name {
            "stribeck-friction" => 0.55,
            "frequency-settling" => 0.6,
            "duty-quantisation" => 0.6,
            "resonance-heating" | "supply-sag" | "start-delay" | "contact-stiffening" => 1.2,
            "clock-error" => 2.0,
            _ => 1.5,
        }
    }

    /// Sign drawn with the shape.
    pub fn sign(&self) -> f64 {
        if self.shape[3] < 0.5 { -1.0 } else { 1.0 }
    }

    /// Linear between two values by shape number `k`.
    pub fn between(&self, k: usize, low: f64, high: f64) -> f64 {
        low + (high - low) * self.shape[k]
    }

    /// The number the library would call this effect's size, where the two forms have one in common.
    pub fn comparable(&self) -> Option<f64> {
        let s = self.size;
        match self.name {
            "dead-zone" => Some(0.3 * s),
            "start-delay" => Some(5e-3 * s),
            "direction-asymmetry" => Some(0.3 * s * self.sign()),
            "unequal-edges" => Some(0.6 * s * self.sign()),
            // The clock drifts by a tenth of its error over a drive; its error between the start and the end of one is half of that larger.
            "clock-error" => Some(0.01 * s * self.sign() * 1.05),
            // Relative to the speed of an unloaded supply, which the generator puts 0.3·s above its nominal one.
            "supply-sag" => Some(0.5 * s / (1.0 + 0.3 * s)),
            "preload-runout" => Some(0.4 * s),
            "encoder-eccentricity" => Some(0.4 * s),
            _ => None,
        }
    }
}
