//! Experiments: which runs are made, what is recorded, and the folder they are written to.

use crate::hidden::Hidden;
use crate::motor::{ContactTable, Motor};
use crate::noise::{Nuisance, normal};
use crate::trace::{EDGES, History, Run, Trace, Wheel, after, stiffened};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::Path;

/// PWM frequency in Hz.
pub const PWM_HZ: f64 = 50.0;
/// Sampling period in s.
pub const SAMPLE_S: f64 = 1e-3;

/// The runs that are made.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// On fractions.
    pub duties: Vec<f64>,
    /// Repetitions of each duty and direction.
    pub trials: usize,
    /// Length of each drive in s.
    pub seconds: f64,
    /// Both directions, or clockwise only.
    pub both_directions: bool,
    /// PWM frequencies in Hz.
    pub pwm_hz: Vec<f64>,
}

impl Design {
    /// A small experiment for bulk statistics: 6 duties, both directions, 3 trials of 2.5 s.
    pub fn small() -> Self {
        Self {
            duties: vec![0.18, 0.33, 0.5, 0.66, 0.83, 1.0],
            trials: 3,
            seconds: 2.5,
            both_directions: true,
            pwm_hz: vec![PWM_HZ],
        }
    }

    /// The small experiment at two PWM frequencies: a dead zone loses the same duty at both, a delay the same time.
    pub fn two_frequencies() -> Self {
        Self { trials: 2, pwm_hz: vec![PWM_HZ, 2.0 * PWM_HZ], ..Self::small() }
    }

    /// The thesis's experiment in both directions: 11 duties, 5 trials of 5 s.
    pub fn thesis() -> Self {
        Self {
            duties: (0..11).map(|k| 0.1 + 0.09 * k as f64).collect(),
            trials: 5,
            seconds: 5.0,
            both_directions: true,
            pwm_hz: vec![PWM_HZ],
        }
    }
}

/// One run as it is made.
#[derive(Debug, Clone, PartialEq)]
pub struct Made {
    /// Identifier.
    pub id: String,
    /// On fraction.
    pub duty: f64,
    /// Direction.
    pub sign: f64,
    /// PWM frequency.
    pub pwm_hz: f64,
    /// Length of the drive in s.
    pub seconds: f64,
    /// Order.
    pub order: usize,
    /// Encoder levels, one a millisecond.
    pub levels: Vec<bool>,
}

/// A whole data set with what is hidden in it.
#[derive(Debug, Clone, PartialEq)]
pub struct DataSet {
    /// The runs.
    pub runs: Vec<Made>,
    /// What is hidden.
    pub hidden: Vec<Hidden>,
    /// The motor.
    pub motor: Motor,
}

/// A data set drawn from a seed: motor, order, nuisances and the hidden effects' numbers.
#[derive(Debug, Clone)]
pub struct Sealed {
    /// Runs to make.
    pub design: Design,
    /// Disturbances.
    pub nuisance: Nuisance,
    /// Perturbed motor.
    pub motor: Motor,
    /// Seed of the runs.
    pub(crate) seed: u64,
    /// Duty, direction and PWM frequency of each run.
    pub(crate) order: Vec<(f64, f64, f64)>,
}

impl Sealed {
    /// Draws motor, nuisances and order.
    pub fn new(design: Design, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5ea1ed);
        let mut spread = |width: f64| 1.0 + rng.random_range(-width..width);
        let base = Motor::default();
        let motor = Motor {
            crest_speed: base.crest_speed * spread(0.1),
            contact: base.contact * spread(0.15),
            off_friction: base.off_friction * spread(0.25),
            viscous: base.viscous * spread(0.5),
            wave_time: base.wave_time * spread(0.1),
            half_contact: base.half_contact * spread(0.15),
            creep: base.creep * spread(0.3),
            exponent: 1.0,
        };
        let nuisance = Nuisance { latency_s: rng.random_range(0.1e-3..1.5e-3), ..Nuisance::default() };
        let mut order = Vec::new();
        for _ in 0..design.trials {
            for duty in &design.duties {
                for pwm in &design.pwm_hz {
                    order.push((*duty, 1.0, *pwm));
                    if design.both_directions {
                        order.push((*duty, -1.0, *pwm));
                    }
                }
            }
        }
        for i in (1..order.len()).rev() {
            order.swap(i, rng.random_range(0..=i));
        }
        Self { design, nuisance, motor, seed, order }
    }

    /// Makes the runs with `hidden` in them.
    pub fn make(&self, hidden: &[Hidden]) -> DataSet {
        let table = ContactTable::new(&stiffened(&self.motor, hidden));
        let mut history = History::default();
        let mut start = Vec::new();
        for (k, (duty, _, _)) in self.order.iter().enumerate() {
            start.push(history);
            history = after(history, *duty, self.design.seconds, self.motor.crest_speed, hidden, self.rest_s(k));
        }
        let runs = start.into_par_iter().enumerate().map(|(k, history)| self.run(k, history, hidden, &table)).collect();
        DataSet { runs, hidden: hidden.to_vec(), motor: self.motor.clone() }
    }

    fn rest_s(&self, k: usize) -> f64 {
        3.0 + 7.0 * ((self.seed.wrapping_mul(31).wrapping_add(k as u64 * 17)) % 100) as f64 / 100.0
    }

    fn run(&self, k: usize, history: History, hidden: &[Hidden], table: &ContactTable) -> Made {
        let (duty, sign, pwm_hz) = self.order[k];
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed.wrapping_mul(1_000_003).wrapping_add(k as u64));
        let run_gain = 1.0 + normal(&mut rng, self.nuisance.gain_spread);
        let zero_angle = rng.random_range(0.0..TAU);
        let cut = if rng.random::<f64>() < 0.5 { rng.random_range(0.0..self.nuisance.truncation) } else { 0.0 };
        let record_s = (self.design.seconds + 0.15) * (1.0 - cut);
        let motor = stiffened(&self.motor, hidden);
        let run = Run { duty, sign, pwm_hz, seconds: self.design.seconds, zero_angle, gain: run_gain, history };
        let mut trace = Trace::new(&motor, table, run, hidden, rng.random());
        let wheel = Wheel::new(hidden);
        let samples = (record_s / SAMPLE_S) as usize;
        let mut levels = Vec::with_capacity(samples);
        let mut clock = 0.0;
        let mut drift = 0.0;
        let mut drop = None;
        for h in hidden {
            if h.name == "clock-error" {
                clock = 0.01 * h.size * h.sign();
                drift = 0.1 * clock;
            }
            if h.name == "dropped-samples" {
                let gaps = usize::from(rng.random::<f64>() < h.size) + usize::from(rng.random::<f64>() < h.size - 1.0);
                let mut at: Vec<usize> = (0..gaps).map(|_| rng.random_range(100..samples.max(200))).collect();
                at.sort_unstable();
                drop = Some(at);
            }
        }
        for n in 0..samples {
            let recorded = n as f64 * SAMPLE_S;
            let scale = 1.0 + clock + drift * (recorded / self.design.seconds - 0.5);
            let t = recorded / scale - self.nuisance.latency_s + normal(&mut rng, self.nuisance.jitter_s);
            let angle = trace.angle_at(t);
            levels.push(wheel.level(angle + zero_angle));
        }
        if let Some(at) = drop {
            for position in at.iter().rev() {
                if position + 32 < levels.len() {
                    levels.drain(*position..position + 32);
                }
            }
        }
        Made { id: format!("r{k:03}"), duty, sign, pwm_hz, seconds: self.design.seconds, order: k, levels }
    }
}

impl DataSet {
    /// Writes the measurement folder.
    pub fn write(&self, folder: &Path, name: &str) -> std::io::Result<()> {
        std::fs::create_dir_all(folder)?;
        let mut toml = format!("name = \"{name}\"\nmotor = \"pcbmotor-30mm\"\nedges_per_rev = {}\n", EDGES as u32);
        for run in &self.runs {
            let direction = if run.sign > 0.0 { "cw" } else { "ccw" };
            write!(
                toml,
                "\n[[run]]\nid = \"{0}\"\nkind = \"speed\"\nfile = \"{0}.csv\"\nformat = \"levels\"\nduty = {1:.6}\ndirection = \"{direction}\"\n\
                 pwm_hz = {2:.1}\ndrive_on_s = {3:.3}\norder = {4}\n",
                run.id, run.duty, run.pwm_hz, run.seconds, run.order
            )
            .expect("writing to a string cannot fail");
            let mut csv = String::with_capacity(run.levels.len() * 11);
            csv.push_str("time_us,level\n");
            for (n, level) in run.levels.iter().enumerate() {
                writeln!(csv, "{},{}", n * 1000, u8::from(*level)).expect("writing to a string cannot fail");
            }
            std::fs::write(folder.join(format!("{}.csv", run.id)), csv)?;
        }
        std::fs::write(folder.join("measurement.toml"), toml)
    }
}
