//! How strongly the speed changes, between each two nodes.

use super::Node;
use super::kalman::{Angle, Change, Gaussian};
use nalgebra::{Matrix3, Vector3};

/// The weakest jerk of the bank, in pitch²/s⁵; each further one is [`RATIO`] times stronger.
pub(super) const WEAKEST: f64 = 1.0;
const RATIO: f64 = 100.0;
const BANK: usize = 8;
/// Probability that the strength is drawn anew from one statement to the next.
const CHANGE: f64 = 0.005;

type Probabilities = [f64; BANK];
/// Time in s, what is said of the angle, and whether the drive took hold since the statement before.
type Said = (f64, Angle, bool);

/// Sets the strength of every jerk to its expectation over the bank; `start` is what is known before the first node.
pub(super) fn assign(nodes: &mut [Node], start: Gaussian) {
    let said: Vec<Said> = nodes.iter().map(|n| (n.time_s, n.angle, n.change == Change::Kick)).collect();
    let forwards = probabilities(&said, start);
    let turned: Vec<Said> = said.iter().rev().map(|(t, a, _)| (-t, *a, false)).collect();
    let end = turned.iter().find_map(|(_, a, _)| a.moments()).map_or(start.mean[0], |(mean, _)| mean);
    let backwards = probabilities(&turned, Gaussian::about(end));
    for i in (0..nodes.len()).filter(|i| !said[*i].2) {
        // The interval before node i is the one before node n - i of the turned record.
        let both = match i {
            0 => backwards[nodes.len() - 1],
            _ => std::array::from_fn(|j| forwards[i][j] * backwards[nodes.len() - i][j]),
        };
        let total: f64 = both.iter().sum();
        nodes[i].change = Change::Jerk(both.iter().enumerate().map(|(j, p)| p / total * strength(j)).sum());
    }
}

fn strength(member: usize) -> f64 {
    WEAKEST * RATIO.powi(member as i32)
}

/// Probability of each strength in the interval before each statement, given that statement and those before it.
fn probabilities(said: &[Said], start: Gaussian) -> Vec<Probabilities> {
    let mut bank = [start; BANK];
    let mut probability = [1.0 / BANK as f64; BANK];
    let mut all = Vec::with_capacity(said.len());
    for (i, (time_s, angle, kicked)) in said.iter().enumerate() {
        if let Some(before) = i.checked_sub(1) {
            let prior: Probabilities = std::array::from_fn(|j| (1.0 - CHANGE) * probability[j] + CHANGE / BANK as f64);
            let mixture = mixed(&bank, &probability);
            for j in 0..BANK {
                let own = (1.0 - CHANGE) * probability[j] / prior[j];
                let pair = mixed(&[bank[j], mixture], &[own, 1.0 - own]);
                let change = if *kicked { Change::Kick } else { Change::Jerk(strength(j)) };
                bank[j] = pair.after(time_s - said[before].0, change);
            }
            probability = prior;
        }
        if let Some((mean, variance)) = angle.moments() {
            let logs: Probabilities = std::array::from_fn(|j| bank[j].measure(mean, variance).log_likelihood());
            let top = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            // The floor keeps a member alive through a stretch that it cannot explain.
            let weight: Probabilities = std::array::from_fn(|j| (probability[j] * (logs[j] - top).exp()).max(1e-12));
            let total: f64 = weight.iter().sum();
            probability = weight.map(|w| w / total);
        }
        all.push(probability);
    }
    all
}

/// The Gaussian with the mean and covariance of a mixture.
fn mixed(members: &[Gaussian], weights: &[f64]) -> Gaussian {
    let each = || members.iter().zip(weights);
    let mean = each().fold(Vector3::zeros(), |sum, (g, w)| sum + g.mean * *w);
    let cov = each().fold(Matrix3::zeros(), |sum, (g, w)| {
        let d = g.mean - mean;
        sum + (g.cov + d * d.transpose()) * *w
    });
    Gaussian { mean, cov }
}
