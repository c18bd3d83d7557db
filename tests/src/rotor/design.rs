//! The experiment: which runs are made, in which order, with which encoder and recorder.

use super::shape::{between, log_between, one_of};
use crate::drive::Drive;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

/// One run as it is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Planned {
    /// What drives it.
    pub drive: Drive,
    /// Its place in the order; places of lost runs are left out.
    pub order: usize,
    /// Rest that follows in s.
    pub rest_s: f64,
    /// The file was lost: it was made, but nobody has it.
    pub missing: bool,
}

/// An experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// Edges a revolution.
    pub edges: u32,
    /// Sampling period of levels in µs; `None` for timestamped edges.
    pub sample_us: Option<u64>,
    /// Runs in the order in which they were made.
    pub runs: Vec<Planned>,
    /// On fractions.
    pub duties: Vec<f64>,
    /// Both directions.
    pub both: bool,
    /// PWM frequencies in Hz.
    pub pwm_hz: Vec<f64>,
    /// The encoder stood at the beginning of a pulse before each run.
    pub aligned: bool,
}

const ENCODERS: [u32; 11] = [200, 256, 360, 400, 500, 720, 1000, 1024, 2000, 2048, 4096];

impl Design {
    /// Draws one for a motor of `rpm` under full drive: 6–60 runs of 1–10 s, 300 s in all at most.
    pub fn draw(rng: &mut ChaCha8Rng, rpm: f64) -> Self {
        // Levels at 1 ms need pulses of some samples: 300 edges a second at most.
        let slow: Vec<u32> = ENCODERS.into_iter().filter(|e| f64::from(*e) * rpm / 60.0 < 300.0).collect();
        let levels = !slow.is_empty() && rng.random::<f64>() < 0.6;
        let edges = one_of(rng, if levels { &slow } else { &ENCODERS });
        let duties = duties(rng);
        let both = rng.random::<f64>() < 0.7;
        let first = one_of(rng, &[50.0, 50.0, 80.0, 100.0]);
        let second = one_of(rng, &[50.0, 80.0, 100.0]);
        let pwm_hz = if rng.random::<f64>() < 0.3 && second != first { vec![first, second] } else { vec![first] };
        let kinds = duties.len() * if both { 2 } else { 1 } * pwm_hz.len();
        let trials = rng.random_range(1..=5_usize).max(6_usize.div_ceil(kinds)).min((60 / kinds).max(1));
        let seconds = log_between(rng, 1.0, 10.0).min(300.0 / (kinds * trials) as f64).max(1.0);
        let seconds = (seconds * 10.0).round() / 10.0;
        let mut drives = Vec::new();
        for _ in 0..trials {
            for pwm in &pwm_hz {
                for sign in if both { &[1.0, -1.0][..] } else { &[1.0] } {
                    drives.extend(duties.iter().map(|duty| Drive { duty: *duty, sign: *sign, pwm_hz: *pwm, seconds }));
                }
            }
        }
        if rng.random::<f64>() < 0.75 {
            for i in (1..drives.len()).rev() {
                drives.swap(i, rng.random_range(0..=i));
            }
        }
        drives.truncate(60);
        let lossy = rng.random::<f64>() < 0.3;
        let mut runs: Vec<Planned> = drives
            .into_iter()
            .enumerate()
            .map(|(order, drive)| Planned {
                drive,
                order,
                rest_s: if rng.random::<f64>() < 0.05 { between(rng, 60.0, 600.0) } else { between(rng, 2.0, 15.0) },
                missing: lossy && rng.random::<f64>() < 0.1,
            })
            .collect();
        if runs.iter().filter(|r| !r.missing).count() < 6 {
            runs.iter_mut().for_each(|r| r.missing = false);
        }
        let aligned = !both && rng.random::<f64>() < 0.2;
        Self { edges, sample_us: levels.then_some(1000), runs, duties, both, pwm_hz, aligned }
    }

    /// The numbers, for the sealed file.
    pub fn numbers(&self) -> BTreeMap<String, f64> {
        [
            ("edges_per_rev", f64::from(self.edges)),
            ("runs", self.runs.iter().filter(|r| !r.missing).count() as f64),
            ("seconds", self.runs.first().map_or(0.0, |r| r.drive.seconds)),
            ("duties", self.duties.len() as f64),
            ("directions", if self.both { 2.0 } else { 1.0 }),
            ("pwm_frequencies", self.pwm_hz.len() as f64),
            ("levels", f64::from(u8::from(self.sample_us.is_some()))),
        ]
        .map(|(k, v)| (k.to_owned(), v))
        .into()
    }

    /// Whether these runs could show an effect at all.
    pub fn shows(&self, effect: &str) -> bool {
        let kept = self.runs.iter().filter(|r| !r.missing).count();
        match effect {
            "direction-asymmetry" | "outside-memory" => self.both,
            "dropped-samples" => self.sample_us.is_some(),
            "dead-zone" | "high-duty-saturation" | "contact-stiffening" | "supply-sag" => self.duties.len() >= 4,
            "duty-quantisation" | "outside-bump" => self.duties.len() >= 5,
            "run-in-wear" | "outside-daytime" => kept >= 10,
            "start-delay" | "stribeck-friction" => self.duties.len() >= 3,
            _ => true,
        }
    }
}

/// 3–12 on fractions between 0.05 and 1, mostly with full drive among them.
fn duties(rng: &mut ChaCha8Rng) -> Vec<f64> {
    let n = rng.random_range(3..=12);
    let low = between(rng, 0.05, 0.25);
    let high = if rng.random::<f64>() < 0.7 { 1.0 } else { between(rng, 0.8, 0.98) };
    let step = (high - low) / f64::from(n - 1);
    (0..n)
        .map(|k| {
            let inside = k > 0 && k < n - 1;
            let shift = if inside { between(rng, -0.3, 0.3) * step } else { 0.0 };
            ((low + step * f64::from(k) + shift) * 1000.0).round() / 1000.0
        })
        .collect()
}
