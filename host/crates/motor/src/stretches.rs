//! Stretches of constant drive that come again: what they did is replayed, not computed.
//!
//! A motor that stops in every off part starts every period from rest. Under a control loop the period is cut into control
//! ticks, but the PWM's grid and the ticks' have few phases against each other, so those pieces come again as well.

use super::modulation::Modulation;
use super::momentary::Momentary;
use super::plant::{Drive, Segment};
use std::collections::HashMap;

/// Most stretches kept; beyond, all are forgotten.
const KEPT: usize = 1024;
/// Most sets of effects kept apart.
const MODULATIONS: usize = 64;
/// Durations closer than this are the same (s).
const SAME_S: f64 = 1e-11;
/// Steps are dropped from a replay where a cubic over the gap is this close to them (rad): a quarter of a microsecond at full speed.
const THINNED_RAD: f64 = 1e-6;
/// Longest gap, in steps.
const LONGEST_GAP: usize = 16;

/// From where, under what.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Key {
    start: [u64; 7],
    level: u64,
    clockwise: bool,
    modulation: usize,
    duration_ns: u64,
}

/// End of a step after the stretch's start (s), angle turned since then (rad), speed (rad/s).
type Step = (f64, f64, f64);

/// What a stretch did.
#[derive(Debug, Clone)]
struct Stretch {
    duration_s: f64,
    steps: Vec<Step>,
    thinned: bool,
    end: Momentary,
}

/// What one motor did before.
#[derive(Debug, Clone, Default)]
pub(super) struct Stretches {
    known: HashMap<Key, Stretch>,
    modulations: Vec<Modulation>,
    modulation: usize,
}

impl Stretches {
    /// The effects in force from now on.
    pub(super) fn modulate(&mut self, modulation: &Modulation) {
        self.modulation = self.modulations.iter().position(|known| known == modulation).unwrap_or_else(|| {
            if self.modulations.len() == MODULATIONS {
                self.modulations.clear();
                self.known.clear();
            }
            self.modulations.push(*modulation);
            self.modulations.len() - 1
        });
    }

    fn key(&self, start: &Momentary, duration_s: f64, drive: Drive) -> Key {
        Key {
            start: start.bits(),
            level: drive.level.to_bits(),
            clockwise: drive.sign() > 0.0,
            modulation: self.modulation,
            duration_ns: (duration_s * 1e9).round() as u64,
        }
    }

    /// Reports the steps of a stretch made before from `start`, as of a time (s) and an angle (rad), and returns the angle and
    /// the state it ended in; none if it is new.
    pub(super) fn replay(
        &mut self,
        start: &Momentary,
        (start_s, start_rad): (f64, f64),
        until_s: f64,
        drive: Drive,
        observe: &mut dyn FnMut(&Segment),
    ) -> Option<(f64, Momentary)> {
        let key = self.key(start, until_s - start_s, drive);
        let stretch = self.known.get_mut(&key).filter(|s| (s.duration_s - (until_s - start_s)).abs() < SAME_S)?;
        let speed = start.speed_rad_s();
        if !stretch.thinned {
            stretch.steps = thin(speed, &stretch.steps);
            stretch.thinned = true;
        }
        let mut last =
            Segment { start_s, end_s: start_s, start_rad, end_rad: start_rad, start_rad_s: speed, end_rad_s: speed };
        let count = stretch.steps.len();
        for (i, &(after_s, turned_rad, speed)) in stretch.steps.iter().enumerate() {
            last = Segment {
                start_s: last.end_s,
                end_s: if i + 1 == count { until_s } else { start_s + after_s },
                start_rad: last.end_rad,
                end_rad: start_rad + turned_rad,
                start_rad_s: last.end_rad_s,
                end_rad_s: speed,
            };
            observe(&last);
        }
        Some((last.end_rad, stretch.end))
    }

    /// Keeps what a stretch did.
    pub(super) fn keep(&mut self, start: &Momentary, duration_s: f64, drive: Drive, steps: Vec<Step>, end: Momentary) {
        if self.known.len() == KEPT {
            self.known.clear();
        }
        let key = self.key(start, duration_s, drive);
        self.known.insert(key, Stretch { duration_s, steps, thinned: false, end });
    }
}

/// The fewest steps, gap after gap, whose cubics pass within [`THINNED_RAD`] of those left out.
fn thin(start_rad_s: f64, steps: &[Step]) -> Vec<Step> {
    let mut kept = Vec::new();
    let mut from = (0.0, 0.0, start_rad_s);
    let mut next = 0;
    while next < steps.len() {
        let follows = |to: usize| {
            let (end_s, end_rad, end_rad_s) = steps[to];
            let (start_s, start_rad, start_rad_s) = from;
            let cubic = Segment { start_s, end_s, start_rad, end_rad, start_rad_s, end_rad_s };
            steps[next..to].iter().all(|&(at, rad, _)| (cubic.position_rad(at) - rad).abs() < THINNED_RAD)
        };
        let last = (next + 1..steps.len().min(next + LONGEST_GAP)).take_while(|&to| follows(to)).last().unwrap_or(next);
        from = steps[last];
        kept.push(from);
        next = last + 1;
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thinned_stretch_passes_where_the_whole_did() {
        // A motor running up and stopping: v = 4·(1 − exp(−t/1 ms)), then a straight brake.
        let angle = |t: f64| 4.0 * (t - 1e-3 * (1.0 - (-t / 1e-3).exp()));
        let speed = |t: f64| 4.0 * (1.0 - (-t / 1e-3).exp());
        let steps: Vec<Step> = (1..=100).map(|i| 5e-5 * f64::from(i)).map(|t| (t, angle(t), speed(t))).collect();
        let kept = thin(0.0, &steps);
        assert!(kept.len() < 30, "{}", kept.len());
        assert_eq!(kept.last(), steps.last());
        let mut from = (0.0, 0.0, 0.0);
        for &(end_s, end_rad, end_rad_s) in &kept {
            let (start_s, start_rad, start_rad_s) = from;
            let cubic = Segment { start_s, end_s, start_rad, end_rad, start_rad_s, end_rad_s };
            for i in 0..=10 {
                let t = start_s + (end_s - start_s) * f64::from(i) / 10.0;
                assert!((cubic.position_rad(t) - angle(t)).abs() < 2.0 * THINNED_RAD, "{t}");
            }
            from = (end_s, end_rad, end_rad_s);
        }
    }
}
