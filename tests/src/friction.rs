//! A simulated friction bench: torque records of a rotor dragged over a stator, with known coefficients.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::fmt::Write as _;
use std::io;
use std::path::Path;

/// Geometry of the thesis (section A.2.2), the Coulomb travel shortened.
const TOML: &str =
    "torque_arm_m = 0.2075\nattachment_radius_m = 0.015725\ncontact_radius_m = 0.013675\nweight_kg = 0.21083
coulomb_travel_mm = 5.0\nstatic_travel_mm = 1.25\nlead_mm = 2.0\ngear_reduction = 29.0\n";

/// What is true of the bench, and how it is recorded.
#[derive(Debug, Clone, Copy)]
pub struct Bench {
    /// Coulomb coefficient.
    pub coulomb: f64,
    /// Static coefficient.
    pub stat: f64,
    /// Change of the Coulomb coefficient with the sliding speed, s/m.
    pub slope_s_m: f64,
    /// Samples a second.
    pub sample_hz: f64,
    /// Motor speeds, rpm.
    pub speeds_rpm: &'static [u32],
    /// Trials a speed.
    pub trials: u32,
}

/// The thesis's coefficients, speeds and trials.
pub const BENCH: Bench = Bench {
    coulomb: 0.1057,
    stat: 0.14,
    slope_s_m: 0.0,
    sample_hz: 250.0,
    speeds_rpm: &[100, 150, 200, 250, 300, 350, 400],
    trials: 5,
};

impl Bench {
    /// Writes the folder that `twum identify friction` reads.
    ///
    /// # Errors
    /// When a file or folder cannot be made.
    pub fn write(&self, folder: &Path, seed: u64) -> io::Result<()> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        std::fs::create_dir_all(folder)?;
        let toml = format!("{TOML}sample_hz = {}\ntorque_sign = -1\n", self.sample_hz);
        std::fs::write(folder.join("friction.toml"), toml)?;
        for set in ["motor", "no-motor", "static"] {
            std::fs::create_dir(folder.join(set))?;
        }
        for &rpm in self.speeds_rpm {
            let sliding = f64::from(rpm) / 60.0 / 29.0 * 2e-3 * 0.013675 / 0.015725;
            for trial in 1..=self.trials {
                let mu = self.coulomb + self.slope_s_m * sliding;
                let idle = 0.003 * (1.0 + 0.05 * normal(&mut rng));
                let with = torque(mu) * (1.0 + 0.03 * normal(&mut rng)) + 0.003 * (1.0 + 0.05 * normal(&mut rng));
                let peak = torque(self.stat) * (1.0 + 0.03 * normal(&mut rng));
                for (set, text) in [
                    ("motor", self.record(&mut rng, rpm, with, with, 5.0)),
                    ("no-motor", self.record(&mut rng, rpm, idle, idle, 5.0)),
                    ("static", self.record(&mut rng, rpm, peak, 0.85 * peak, 2.0)),
                ] {
                    std::fs::write(folder.join(set).join(format!("{rpm}_rpm_{trial}.csv")), text)?;
                }
            }
        }
        Ok(())
    }

    /// One record: rest, a climb while wire and arm give, sliding, and slack afterwards; noise, mains hum and a zero offset.
    fn record(&self, rng: &mut ChaCha8Rng, rpm: u32, peak: f64, level: f64, travel_mm: f64) -> String {
        let speed = f64::from(rpm) / 60.0 / 29.0 * 2.0;
        let (climb, total) = (0.6 / speed, travel_mm / speed);
        let offset = 0.004 * normal(rng);
        let mut out = String::from("time_s,torque_nm\n");
        for i in 0..((3.0 + total + 2.0) * self.sample_hz) as usize {
            let t = i as f64 / self.sample_hz;
            let shape = match t - 3.0 {
                s if s < 0.0 => 0.0,
                s if s < climb => peak * s / climb,
                s if s < total => level + (peak - level) * (-(s - climb) / 1.5).exp(),
                _ => 0.0,
            };
            let hum = 0.001 * (2.0 * std::f64::consts::PI * 60.0 * t).sin();
            let _ = writeln!(out, "{t:.4},{:.7}", -(shape + offset + hum + 0.0015 * normal(rng)));
        }
        out
    }
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Torque at the sensor a unit of friction coefficient, by the levers: µ·m·g·r_contact/r_attach·l.
fn torque(mu: f64) -> f64 {
    mu * 0.21083 * 9.80665 * 0.013675 / 0.015725 * 0.2075
}
