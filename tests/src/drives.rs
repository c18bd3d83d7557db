//! Ordinary motors drawn at random: a fourth source of data, which shares no model code with the host.
//!
//! Torque balance in small steps (at least 60 to the shortest time constant): friction by a regularised sign with a rest rule of its own, inputs
//! of six shapes, sensors with noise and quantisation. Orders of magnitude of inertia, friction, lag, noise and sampling are drawn.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// What is hidden in a motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hidden {
    /// Nothing: a linear motor.
    Nothing,
    /// Coulomb friction.
    Coulomb,
    /// A dead zone in the input.
    DeadZone,
    /// A top that bends or is flat.
    Saturation,
    /// Directions that differ in gain.
    Asymmetry,
    /// A steady load.
    Load,
    /// A dead time of some samples.
    DeadTime,
    /// Coulomb friction, larger at rest.
    Stribeck,
}

impl Hidden {
    /// All.
    pub const ALL: [Hidden; 8] = [
        Hidden::Nothing,
        Hidden::Coulomb,
        Hidden::DeadZone,
        Hidden::Saturation,
        Hidden::Asymmetry,
        Hidden::Load,
        Hidden::DeadTime,
        Hidden::Stribeck,
    ];

    /// The names under which it is found; the first is its own.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            Hidden::Nothing => &[],
            Hidden::Coulomb => &["coulomb-friction"],
            Hidden::DeadZone => &["dead-zone"],
            Hidden::Saturation => &["high-duty-saturation"],
            Hidden::Asymmetry => &["direction-asymmetry"],
            Hidden::Load => &["load-bias"],
            Hidden::DeadTime => &["dead-time"],
            Hidden::Stribeck => &["stribeck-friction", "coulomb-friction"],
        }
    }
}

/// One record.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Times in µs.
    pub time_us: Vec<f64>,
    /// Inputs in the drive's unit.
    pub input: Vec<f64>,
    /// Speeds in rpm.
    pub rpm: Vec<f64>,
}

/// A motor and how it is measured.
#[derive(Debug, Clone)]
pub struct Drive {
    /// What is hidden.
    pub hidden: Hidden,
    gain: f64,
    lag: f64,
    largest: f64,
    period: f64,
    samples: usize,
    runs: usize,
    noise: f64,
    shape: usize,
    size: f64,
    seed: u64,
}

impl Drive {
    /// Drawn by a seed.
    pub fn draw(hidden: Hidden, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(7919).wrapping_add(17));
        let mut log = |low: f64, high: f64| low * (high / low).powf(rng.random::<f64>());
        let lag = log(3e-3, 0.8);
        let period = lag * log(0.03, 0.4);
        let (gain, largest, noise) = (log(30.0, 8000.0), log(0.5, 300.0), log(0.002, 0.02));
        let size = log(0.7, 1.4);
        let samples = log(800.0, 3000.0) as usize;
        let runs = rng.random_range(1..=4);
        let shape = rng.random_range(0..6);
        Self { hidden, gain, lag, largest, period, samples, runs, noise, shape, size, seed }
    }

    /// The same motor, sampled at the same rate for so many samples in so many runs.
    pub fn lengthened(self, samples: usize, runs: usize) -> Self {
        Self { samples, runs, ..self }
    }

    /// The input of a run at a time, as a share of the largest.
    fn input(&self, run: usize, t: f64, levels: &[f64]) -> f64 {
        let whole = self.period * self.samples as f64;
        let x = t / whole;
        let tau = std::f64::consts::TAU;
        match self.shape {
            0 => (tau * t / (self.lag * (12.0 + 5.0 * run as f64)).min(whole / 3.0)).sin(),
            1 => levels[(t / (3.0 * self.lag)) as usize % levels.len()],
            2 => levels[(t / (0.7 * self.lag)) as usize % levels.len()].signum() * (0.3 + 0.17 * run as f64),
            3 => 1.0 - (4.0 * ((x + 0.13 * run as f64).rem_euclid(1.0)) - 2.0).abs(),
            4 => (tau * x * 2.0).sin() * 0.6 + 0.4 * (tau * x * (17.0 + run as f64)).sin(),
            _ => (tau * (2.0 * x + 8.0 * x * x)).sin() * (0.4 + 0.6 * x),
        }
    }

    /// What the drive makes of an input.
    fn actuated(&self, u: f64) -> f64 {
        match self.hidden {
            // Rounded at its corner, by a hundredth of the range.
            Hidden::DeadZone => {
                let over = u.abs() - 0.15 * self.size;
                u.signum() * 0.5 * (over + (over * over + 1e-4).sqrt())
            }
            Hidden::Saturation if self.seed.is_multiple_of(2) => {
                (1.6 * self.size * u).tanh() / (1.6 * self.size).tanh()
            }
            Hidden::Saturation => u.clamp(-0.7 / self.size, 0.7 / self.size),
            Hidden::Asymmetry => u * (1.0 + 0.06 * self.size * u.signum()),
            Hidden::Load => u - 0.06 * self.size,
            _ => u,
        }
    }

    /// Friction at a speed, as a share of the largest torque.
    fn friction(&self, speed: f64) -> f64 {
        match self.hidden {
            Hidden::Coulomb => 0.12 * self.size,
            Hidden::Stribeck => self.size * (0.1 + 0.12 * (-(speed / (0.02 * self.gain)).powi(2)).exp()),
            _ => 0.0,
        }
    }

    /// The records.
    pub fn make(&self) -> Vec<Record> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let normal = Normal::new(0.0, 1.0).expect("a unit normal");
        (0..self.runs)
            .map(|run| {
                let levels: Vec<f64> = (0..400).map(|_| rng.random_range(-1.0..1.0)).collect();
                let gain = self.gain * (1.0 + 0.003 * normal.sample(&mut rng));
                let late = if self.hidden == Hidden::DeadTime { (6.0 * self.size).round() as usize } else { 0 };
                let inputs: Vec<f64> =
                    (0..self.samples).map(|k| self.input(run, k as f64 * self.period, &levels)).collect();
                let steps = (60.0 * self.period / self.lag).ceil().max(20.0) as usize;
                let h = self.period / steps as f64;
                let mut v = 0.0;
                let mut record = Record { time_us: Vec::new(), input: Vec::new(), rpm: Vec::new() };
                for k in 0..self.samples {
                    record.time_us.push(k as f64 * self.period * 1e6);
                    record.input.push(self.largest * inputs[k]);
                    record.rpm.push(v + self.noise * self.gain * normal.sample(&mut rng));
                    let drive = self.actuated(inputs[k.saturating_sub(late)]);
                    for _ in 0..steps {
                        let friction = self.friction(v);
                        let free: f64 = v + h / self.lag * (gain * drive - v);
                        // Friction takes away at most what there is.
                        let brake = h / self.lag * gain * friction;
                        v = if free.abs() <= brake { 0.0 } else { free - brake * free.signum() };
                    }
                }
                record
            })
            .collect()
    }
}
