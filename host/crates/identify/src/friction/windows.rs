//! Finding the motion in a torque record.
//!
//! The record is cut where three constant levels (rest, motion, after) fit it best in the least-squares sense. That needs
//! no threshold and no peak, and it measures how long the motion took, which the geometry must agree with.

use nalgebra::{Matrix4, Vector4};

/// Where the motion is, in samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// First sample of the motion.
    pub start: usize,
    /// One past its last sample; the record's end when no drop was seen.
    pub end: usize,
    /// Mean before (N·m); zero when the record starts in motion.
    pub rest_nm: f64,
    /// Mean during (N·m).
    pub level_nm: f64,
    /// Scatter of the block means about the three levels (N·m).
    pub scatter_nm: f64,
    /// Whether the torque drops clearly at `end`.
    pub drops: bool,
}

/// Most blocks searched; each pair of cuts is tried.
const MOST_BLOCKS: usize = 600;

/// The best cut into rest, motion and after.
pub fn motion(torque_nm: &[f64]) -> Option<Motion> {
    let block = torque_nm.len().div_ceil(MOST_BLOCKS).max(1);
    let means: Vec<f64> = torque_nm.chunks(block).map(|c| c.iter().sum::<f64>() / c.len() as f64).collect();
    let n = means.len();
    if n < 8 {
        return None;
    }
    let mut sum = vec![0.0; n + 1];
    let mut square = vec![0.0; n + 1];
    for (i, m) in means.iter().enumerate() {
        sum[i + 1] = sum[i] + m;
        square[i + 1] = square[i] + m * m;
    }
    let mean = |a: usize, b: usize| (sum[b] - sum[a]) / (b - a) as f64;
    let cost = |a: usize, b: usize| {
        if b > a { (square[b] - square[a]) - (sum[b] - sum[a]).powi(2) / (b - a) as f64 } else { 0.0 }
    };
    let (mut best, mut cuts) = (f64::INFINITY, (0, n));
    for start in 1..n - 2 {
        for end in start + 2..=n {
            let total = cost(0, start) + cost(start, end) + cost(end, n);
            if total < best {
                best = total;
                cuts = (start, end);
            }
        }
    }
    let (start, end) = cuts;
    let (rest, level) = (mean(0, start), mean(start, end));
    let drops = end < n && (mean(end, n) - rest).abs() < 0.6 * (level - rest).abs();
    Some(Motion {
        start: start * block,
        end: (end * block).min(torque_nm.len()),
        rest_nm: rest,
        level_nm: level,
        scatter_nm: (best / n as f64).sqrt(),
        drops,
    })
}

/// The rest before a ramp: (level in N·m, its last sample), from the flat line and slope that fit best up to `end`.
///
/// The wire and the arm give, so the torque climbs for a while before the motor slides: a cut between constant levels lies
/// half-way up that climb, and what is before it is not all rest.
pub fn rest(torque_nm: &[f64], end: usize) -> Option<(f64, usize)> {
    let (block, means) = blocks(&torque_nm[..end.min(torque_nm.len())]);
    let fit = |knee: usize| broken_line(&means, knee);
    let knee = (1..means.len().saturating_sub(2)).min_by(|a, b| fit(*a).1.total_cmp(&fit(*b).1))?;
    Some((fit(knee).0, (knee + 1) * block))
}

/// The height of the corner where a climb breaks off, within `from..to`: a straight climb and a fall that meet, fitted to the
/// unfiltered samples, because a filter rounds the corner down.
pub fn corner(torque_nm: &[f64], from: usize, to: usize) -> Option<f64> {
    let (_, means) = blocks(torque_nm.get(from..to)?);
    let n = means.len();
    (3..n.saturating_sub(4)).map(|knee| two_lines(&means, knee)).min_by(|a, b| a.1.total_cmp(&b.1)).map(|best| best.0)
}

fn blocks(torque_nm: &[f64]) -> (usize, Vec<f64>) {
    let block = torque_nm.len().div_ceil(MOST_BLOCKS / 3).max(1);
    (block, torque_nm.chunks(block).map(|c| c.iter().sum::<f64>() / c.len() as f64).collect())
}

/// Least squares of a + b·max(0, i − knee): (a, sum of squares).
fn broken_line(y: &[f64], knee: usize) -> (f64, f64) {
    let n = y.len() as f64;
    let x = |i: usize| i.saturating_sub(knee) as f64;
    let (mut sx, mut sxx, mut sy, mut sxy) = (0.0, 0.0, 0.0, 0.0);
    for (i, v) in y.iter().enumerate() {
        sx += x(i);
        sxx += x(i) * x(i);
        sy += v;
        sxy += x(i) * v;
    }
    let b = (n * sxy - sx * sy) / (n * sxx - sx * sx);
    let a = (sy - b * sx) / n;
    (a, y.iter().enumerate().map(|(i, v)| (v - a - b * x(i)).powi(2)).sum())
}

/// Least squares of a + b·min(0, x) + c·max(0, x) + d·max(0, x)², x = i − knee: (a, sum of squares). Slipping decays, so the
/// fall is allowed to bend.
fn two_lines(y: &[f64], knee: usize) -> (f64, f64) {
    let row = |i: usize| {
        let x = i as f64 - knee as f64;
        Vector4::new(1.0, x.min(0.0), x.max(0.0), x.max(0.0).powi(2))
    };
    let mut normal = Matrix4::zeros();
    let mut right = Vector4::zeros();
    for (i, v) in y.iter().enumerate() {
        normal += row(i) * row(i).transpose();
        right += row(i) * *v;
    }
    let Some(beta) = normal.try_inverse().map(|inverse| inverse * right) else { return (f64::NAN, f64::INFINITY) };
    (beta[0], y.iter().enumerate().map(|(i, v)| (v - row(i).dot(&beta)).powi(2)).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corner_and_the_rest_before_it_are_found() {
        let torque: Vec<f64> = (0..20_000)
            .map(|i| {
                let t = f64::from(i) / 1000.0;
                let shape = if t < 3.0 {
                    0.0
                } else if t < 9.0 {
                    (t - 3.0) / 6.0
                } else {
                    1.0 - 0.05 * (t - 9.0)
                };
                0.01 + 0.03 * shape + 0.001 * (t * 997.0).sin()
            })
            .collect();
        let (level, last) = rest(&torque, 9000).unwrap();
        assert!((level - 0.01).abs() < 2e-4 && last.abs_diff(3000) < 150, "{level} {last}");
        assert!((corner(&torque, 7500, 10_500).unwrap() - 0.04).abs() < 2e-4);
    }

    #[test]
    fn a_step_up_and_down_is_found() {
        let torque: Vec<f64> = (0..30_000)
            .map(|i| if (4000..20_000).contains(&i) { 0.03 } else { 0.01 } + 0.002 * (i as f64 * 12.9898).sin())
            .collect();
        let found = motion(&torque).unwrap();
        assert!(found.start.abs_diff(4000) <= 50 && found.end.abs_diff(20_000) <= 50 && found.drops, "{found:?}");
        assert!((found.level_nm - found.rest_nm - 0.02).abs() < 1e-4);
    }

    #[test]
    fn a_torque_that_stays_does_not_drop() {
        let torque: Vec<f64> = (0..30_000).map(|i| if i >= 4000 { 0.03 } else { 0.01 }).collect();
        assert!(!motion(&torque).unwrap().drops);
    }
}
