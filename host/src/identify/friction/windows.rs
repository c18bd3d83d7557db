//! Finding the motion in a torque record.
//!
//! The record is cut where three constant levels (rest, motion, after) fit it best in the least-squares sense. That needs
//! no threshold and no peak, and it measures how long the motion took, which the geometry must agree with.

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

#[cfg(test)]
mod tests {
    use super::*;

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
