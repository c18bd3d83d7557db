//! How well a closed loop followed its reference, and what held it back.
//!
//! Every command that states one of these figures takes it from here.

use serde::Serialize;

/// A speed is looked at over this time (s): five PWM periods at 50 Hz.
const OVER_S: f64 = 0.1;
/// The loop counts as settled within so many counts of a step: what one edge and the dead band of a drive leave.
const SETTLED_COUNTS: i64 = 2;

/// One control tick, in counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tick {
    /// Time (s).
    pub time_s: f64,
    /// Wanted position (counts).
    pub target: i64,
    /// Counted position (counts).
    pub position: i64,
    /// Fraction of the PWM period with the drive on.
    pub duty: f64,
}

/// The figures of a closed loop; errors are target less counted position.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tracking {
    /// Ticks looked at.
    pub ticks: usize,
    /// Mean square of the error (deg²).
    pub mse_deg2: f64,
    /// Root of that (deg).
    pub rms_deg: f64,
    /// Mean amount of the error (deg).
    pub mean_abs_deg: f64,
    /// Greatest amount of the error (deg).
    pub worst_deg: f64,
    /// Share of the ticks at full duty.
    pub full_duty: f64,
    /// Greatest speed of the reference over 0.1 s (counts/s); a step has none.
    pub asked_counts_s: f64,
    /// Greatest speed of the rotor over 0.1 s (counts/s).
    pub reached_counts_s: f64,
    /// What followed a step of the reference.
    pub step: Option<StepResponse>,
}

/// What followed a step.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StepResponse {
    /// Its height (deg).
    pub height_deg: f64,
    /// How far the rotor went beyond (deg).
    pub overshoot_deg: f64,
    /// From the step until the rotor stays within two counts of the target (s); none when it does not.
    pub settling_s: Option<f64>,
}

impl Tracking {
    /// The figures of ticks in order; none without ticks.
    pub fn of(ticks: &[Tick], edges_per_rev: u32) -> Option<Self> {
        let (first, count) = (ticks.first()?, ticks.len() as f64);
        let count_deg = 360.0 / f64::from(edges_per_rev.max(1));
        let errors = || ticks.iter().map(|t| (t.target - t.position) as f64 * count_deg);
        let mse_deg2 = errors().map(|e| e * e).sum::<f64>() / count;
        let step = StepResponse::of(ticks, count_deg);
        let asked = if step.is_some() { 0.0 } else { greatest_speed(ticks, |t| t.target) };
        let moved = ticks.iter().any(|t| t.position != first.position);
        Some(Self {
            ticks: ticks.len(),
            mse_deg2,
            rms_deg: mse_deg2.sqrt(),
            mean_abs_deg: errors().map(f64::abs).sum::<f64>() / count,
            worst_deg: errors().map(f64::abs).fold(0.0, f64::max),
            full_duty: ticks.iter().filter(|t| t.duty >= 1.0).count() as f64 / count,
            asked_counts_s: asked,
            reached_counts_s: if moved { greatest_speed(ticks, |t| t.position) } else { 0.0 },
            step,
        })
    }

    /// What a reader should know before believing the figures, in words; empty when there is nothing.
    pub fn warnings(&self) -> Vec<String> {
        /// Beyond half of the ticks the drive's limit, not the controller, makes the error.
        const SATURATED: f64 = 0.5;
        /// A reference this much faster than the rotor ever was is beyond it: the speed over 0.1 s is good to some 10 %.
        const BEYOND: f64 = 1.2;
        let mut out = Vec::new();
        if self.reached_counts_s == 0.0 && self.worst_deg > 0.0 {
            out.push("the rotor did not move".to_owned());
        }
        if self.full_duty > SATURATED {
            out.push(format!(
                "the drive was fully on in {:.0} % of the ticks: the loop was saturated, and the error is the motor's limit",
                100.0 * self.full_duty
            ));
        }
        if self.asked_counts_s > BEYOND * self.reached_counts_s && self.reached_counts_s > 0.0 && self.full_duty > 0.0 {
            out.push(format!(
                "the reference is beyond the motor: asked {:.0} counts/s, this motor reached {:.0}",
                self.asked_counts_s, self.reached_counts_s
            ));
        }
        out
    }
}

fn greatest_speed(ticks: &[Tick], of: impl Fn(&Tick) -> i64) -> f64 {
    // A run cut short of that is looked at over what there is.
    let length_s = ticks.last().map_or(0.0, |last| last.time_s - ticks[0].time_s);
    let (mut from, mut greatest) = (0, 0.0_f64);
    for to in ticks {
        while to.time_s - ticks[from].time_s > OVER_S {
            from += 1;
        }
        let over_s = to.time_s - ticks[from].time_s;
        // A stretch that is still growing tells less than a count's worth.
        if over_s > 0.8 * OVER_S.min(length_s) {
            greatest = greatest.max(((of(to) - of(&ticks[from])) as f64 / over_s).abs());
        }
    }
    greatest
}

impl StepResponse {
    /// Of a reference that takes one value from its first tick on, away from where the rotor stands, or changes once.
    fn of(ticks: &[Tick], count_deg: f64) -> Option<Self> {
        let last = ticks.last()?.target;
        let at = ticks.iter().position(|t| t.target == last)?;
        if ticks[at..].iter().any(|t| t.target != last) || ticks[..at].iter().any(|t| t.target != ticks[0].target) {
            return None;
        }
        let height = last - ticks[at].position;
        if height == 0 {
            return None;
        }
        let beyond = |t: &Tick| (t.position - last) * height.signum();
        let outside = ticks[at..].iter().rposition(|t| (t.position - last).abs() > SETTLED_COUNTS);
        let settled = match outside {
            None => Some(at),
            Some(i) => Some(at + i + 1).filter(|i| *i < ticks.len()),
        };
        Some(Self {
            height_deg: height as f64 * count_deg,
            overshoot_deg: ticks[at..].iter().map(beyond).max().unwrap_or(0).max(0) as f64 * count_deg,
            settling_s: settled.map(|i| ticks[i].time_s - ticks[at].time_s),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ticks(seconds: f64, at: impl Fn(f64) -> (f64, f64, f64)) -> Vec<Tick> {
        (0..(seconds / 5e-4) as usize)
            .map(|i| {
                let time_s = i as f64 * 5e-4;
                let (target, position, duty) = at(time_s);
                Tick { time_s, target: target as i64, position: position as i64, duty }
            })
            .collect()
    }

    #[test]
    fn a_reference_beyond_the_motor_is_said_to_be() {
        // 1780 counts/s asked for, 210 reached, fully on.
        let found = Tracking::of(&ticks(1.0, |t| (1780.0 * t, 210.0 * t, 1.0)), 400).unwrap();
        assert!(
            (found.asked_counts_s / 1780.0 - 1.0).abs() < 0.02 && (found.reached_counts_s / 210.0 - 1.0).abs() < 0.06
        );
        let said = found.warnings().join("; ");
        assert!(
            said.contains("fully on in 100 %") && said.contains("asked 17") && said.contains("reached 2"),
            "{said}"
        );
        // One that the motor follows a little late has nothing to be said.
        let found = Tracking::of(&ticks(1.0, |t| (100.0 * t, (100.0 * t - 2.0).max(0.0), 0.5)), 400).unwrap();
        assert_eq!(found.warnings(), Vec::<String>::new());
        assert!((found.mean_abs_deg - 1.8).abs() < 0.1 && (found.worst_deg - 1.8).abs() < 0.91, "{found:?}");
    }

    #[test]
    fn a_step_has_overshoot_and_settling() {
        // Up to 110 counts at 0.2 s, back to 100 by 0.3 s.
        let position = |t: f64| match t {
            t if t < 0.2 => 550.0 * t,
            t if t < 0.3 => 110.0 - 100.0 * (t - 0.2),
            _ => 100.0,
        };
        let found = Tracking::of(&ticks(1.0, |t| (100.0, position(t), 0.3)), 400).unwrap();
        let step = found.step.unwrap();
        assert!((step.height_deg - 90.0).abs() < 1e-9 && (step.overshoot_deg - 9.0).abs() < 1.0, "{step:?}");
        assert!((step.settling_s.unwrap() - 0.275).abs() < 0.015, "{step:?}");
        assert_eq!(found.asked_counts_s, 0.0);
        // What never arrives has not settled.
        let found = Tracking::of(&ticks(1.0, |_| (100.0, 0.0, 0.3)), 400).unwrap();
        assert_eq!(found.step.as_ref().unwrap().settling_s, None);
        assert_eq!(found.warnings(), ["the rotor did not move"]);
        assert!(Tracking::of(&[], 400).is_none());
    }
}
