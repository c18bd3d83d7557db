//! How much of what is hidden a record can show: its size over the noise, once a linear motor was fitted to it.
//!
//! Computed from simulations of this generator alone, without noise, of the inputs that a record holds.

use super::{Drive, Hidden, Record, Rotor, Sensor};

/// Most steps of the refit: from the true motor a few do, an effect as large as the motion takes more.
const STEPS: usize = 12;

/// A motor without an effect as it is refitted: relative changes of gain and lag, and what every run begins with, as a share of the gain.
#[derive(Clone)]
struct Refit {
    gain: f64,
    lag: f64,
    starts: Vec<f64>,
}

impl Drive {
    /// ρ: root mean square of what an effect does to the speeds, less what gain, lag and initial speeds of the motor without it make of
    /// that, over the root mean square of the noise.
    pub fn rho(&self, hidden: Hidden, records: &[Record]) -> f64 {
        let inputs: Vec<Vec<f64>> =
            records.iter().map(|r| r.input.iter().map(|u| u / self.largest).collect()).collect();
        let still = Refit { gain: 1.0, lag: 1.0, starts: vec![0.0; inputs.len()] };
        let wanted = self.clean(&inputs, &still);
        let left = self.without(hidden).fitted(&inputs, &wanted, still);
        let rows = left.iter().map(Vec::len).sum::<usize>() as f64;
        (squares(&left) / rows).sqrt() / self.noise_rpm()
    }

    /// What is left of some speeds once gain, lag and starts of this motor are fitted to them.
    fn fitted(&self, inputs: &[Vec<f64>], wanted: &[Vec<f64>], mut at: Refit) -> Vec<Vec<f64>> {
        let rest = |at: &Refit| -> Vec<Vec<f64>> {
            let now = self.clean(inputs, at);
            wanted.iter().zip(&now).map(|(w, n)| w.iter().zip(n).map(|(w, n)| w - n).collect()).collect()
        };
        let mut left = rest(&at);
        for _ in 0..STEPS {
            let Some(step) = self.step_of(inputs, &at, &left) else { break };
            // Half as far as long as it leads away.
            let tried = (0..6).map(|k| at.moved(&step, 0.5f64.powi(k))).map(|to| (rest(&to), to));
            let Some((better, to)) = tried.into_iter().find(|t| squares(&t.0) < squares(&left)) else { break };
            let settled = squares(&better) > 0.999 * squares(&left);
            (at, left) = (to, better);
            if settled {
                break;
            }
        }
        left
    }

    /// The speeds of these inputs without noise, as they are measured: at the samples, or over windows of a lag where counts are.
    fn clean(&self, inputs: &[Vec<f64>], motor: &Refit) -> Vec<Vec<f64>> {
        let one = |(input, start): (&Vec<f64>, &f64)| {
            let mut rotor = Rotor::at(start * self.gain);
            let (mut speeds, mut turns) = (Vec::new(), Vec::new());
            for k in 0..input.len() {
                speeds.push(self.seen(&rotor));
                turns.push(rotor.turns);
                self.turn(&mut rotor, self.driven(input, k), motor.gain * self.gain, motor.lag * self.lag);
            }
            match self.sensor {
                Sensor::Counts(_) => {
                    let ends: Vec<f64> = turns.into_iter().step_by(self.window()).collect();
                    let seconds = self.window() as f64 * self.period;
                    ends.windows(2).map(|w| (w[1] - w[0]) / seconds * 60.0).collect()
                }
                _ => speeds,
            }
        };
        inputs.iter().zip(&motor.starts).map(one).collect()
    }

    /// Samples of a lag.
    fn window(&self) -> usize {
        (self.lag / self.period).round().max(1.0) as usize
    }

    /// Root mean square of what the sensor adds to the speeds of [`Drive::clean`]: rounding errs evenly within a step.
    fn noise_rpm(&self) -> f64 {
        let noise = self.noise * self.gain;
        match self.sensor {
            Sensor::Speed => noise,
            Sensor::Rounded(step) => noise.hypot(step / 12f64.sqrt()),
            Sensor::Counts(counts) => (2.0 / 12f64).sqrt() / counts / (self.window() as f64 * self.period) * 60.0,
        }
    }

    /// The step of Gauss and Newton towards what is left of the speeds: of gain, of lag, and of the start of every run.
    fn step_of(&self, inputs: &[Vec<f64>], at: &Refit, left: &[Vec<f64>]) -> Option<Refit> {
        const H: f64 = 1e-4;
        let now = self.clean(inputs, at);
        let slope = |to: &Refit| -> Vec<Vec<f64>> {
            let moved = self.clean(inputs, to);
            now.iter().zip(&moved).map(|(n, m)| n.iter().zip(m).map(|(n, m)| (m - n) / H).collect()).collect()
        };
        let gain = slope(&Refit { gain: at.gain + H, ..at.clone() });
        let lag = slope(&Refit { lag: at.lag + H, ..at.clone() });
        let start = slope(&Refit { starts: at.starts.iter().map(|s| s + H).collect(), ..at.clone() });
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        // The starts touch one run each: they are eliminated from the two equations that all runs share.
        let (mut gg, mut gl, mut ll, mut gr, mut lr) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for i in 0..inputs.len() {
            let s = &start[i];
            let ss = dot(s, s).max(1e-300);
            let less = |a: &[f64], b: &[f64]| dot(a, b) - dot(a, s) * dot(b, s) / ss;
            gg += less(&gain[i], &gain[i]);
            gl += less(&gain[i], &lag[i]);
            ll += less(&lag[i], &lag[i]);
            gr += less(&gain[i], &left[i]);
            lr += less(&lag[i], &left[i]);
        }
        let determinant = gg * ll - gl * gl;
        if determinant <= 1e-12 * gg * ll {
            return None;
        }
        let (by_gain, by_lag) = ((gr * ll - lr * gl) / determinant, (lr * gg - gr * gl) / determinant);
        let starts = (0..inputs.len()).map(|i| {
            let s = &start[i];
            (dot(s, &left[i]) - by_gain * dot(s, &gain[i]) - by_lag * dot(s, &lag[i])) / dot(s, s).max(1e-300)
        });
        Some(Refit { gain: by_gain, lag: by_lag, starts: starts.collect() })
    }
}

fn squares(all: &[Vec<f64>]) -> f64 {
    all.iter().flatten().map(|v| v * v).sum()
}

impl Refit {
    /// A share of a step on; a lag stays one that the small steps of the generator can follow.
    fn moved(&self, step: &Refit, share: f64) -> Self {
        Self {
            gain: self.gain + share * step.gain,
            lag: (self.lag + share * step.lag).clamp(0.2, 20.0),
            starts: self.starts.iter().zip(&step.starts).map(|(s, by)| s + share * by).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if ρ is not the offset that a load leaves of the speeds over their noise, where the input swings evenly about zero and neither gain
    /// nor lag can make an offset; or if what changes nothing is seen.
    #[test]
    fn a_load_is_seen_as_the_offset_that_it_is() {
        let swings = (1..200).map(|seed| Drive::draw(&[Hidden::Load], seed)).filter(|d| d.shape == 2);
        for drive in swings.take(5) {
            let records = drive.make();
            let offset = 0.06 * drive.size / drive.noise;
            let rho = drive.rho(Hidden::Load, &records);
            assert!((rho / offset - 1.0).abs() < 0.15, "{rho} where {offset} goes: {}", drive.describe());
            assert_eq!(drive.rho(Hidden::Nothing, &records), 0.0);
        }
    }

    /// Fails if what another gain or lag does passes for something to be seen.
    #[test]
    fn what_gain_and_lag_take_is_not_seen() {
        let drive = Drive::draw(&[Hidden::Nothing], 3);
        let inputs: Vec<Vec<f64>> =
            drive.make().iter().map(|r| r.input.iter().map(|u| u / drive.largest).collect()).collect();
        let still = Refit { gain: 1.0, lag: 1.0, starts: vec![0.0; inputs.len()] };
        let other = Refit { gain: 1.2, lag: 0.8, starts: vec![0.1; inputs.len()] };
        let wanted = drive.clean(&inputs, &other);
        let before = drive.fitted(&inputs, &wanted, still.clone());
        let after: f64 = before.iter().flatten().map(|v| v * v).sum();
        let all: f64 = wanted.iter().flatten().map(|v| v * v).sum();
        assert!(after < 1e-6 * all, "{after} of {all} is left");
    }
}
