//! How a run was driven.

use super::{P, Parameters, effective_duty, start_delay};

/// What is told of a pulse ends so long (s) after it.
const MOST_AFTER_S: f64 = 0.01;

/// One PWM period, or any stretch of time with one duty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Period {
    /// Start and end in s; drive is in the last `duty` fraction.
    pub start: f64,
    /// End in s.
    pub end: f64,
    /// Fraction of the period with drive on.
    pub duty: f64,
}

/// How a run was driven.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Schedule {
    /// PWM periods in time order; the drive is off before the first and after the last.
    pub periods: Vec<Period>,
    /// Direction pin: sign from this time on, in time order, first at or before the first period.
    pub directions: Vec<(f64, f64)>,
}

impl Schedule {
    /// Constant duty and direction from 0 to `on_s`, periods of `1/pwm_hz`, `phase_s` into a period at t = 0.
    pub fn constant(duty: f64, direction: f64, pwm_hz: f64, phase_s: f64, on_s: f64) -> Self {
        let period = 1.0 / pwm_hz;
        let mut periods = Vec::with_capacity((on_s / period) as usize + 2);
        let mut k = 0;
        loop {
            let start = k as f64 * period - phase_s.rem_euclid(period);
            if start >= on_s || duty <= 0.0 {
                break;
            }
            periods.push(Period { start, end: start + period, duty });
            k += 1;
        }
        Self { periods, directions: vec![(0.0, direction)] }
    }

    /// Share of the time between two instants (s of the record) that lies within the millisecond `after_s` behind a rise of the drive, or (`false`) a fall.
    pub fn share_after_switching(&self, between: [f64; 2], rise: bool, after_s: f64, p: &Parameters) -> f64 {
        self.share_of_pulses(between, p, |[on, off]| {
            let switched = if rise { on } else { off };
            [switched + after_s, switched + after_s + 1e-3]
        })
    }

    /// The same of the millisecond `after_s` behind a rise, as long as the drive is on.
    pub fn share_within_pulses(&self, between: [f64; 2], after_s: f64, p: &Parameters) -> f64 {
        self.share_of_pulses(between, p, |[on, off]| [on + after_s, (on + after_s + 1e-3).min(off)])
    }

    /// The same of any `part` of a pulse, from its beginning and end in s of the drive.
    fn share_of_pulses(&self, between: [f64; 2], p: &Parameters, part: impl Fn([f64; 2]) -> [f64; 2]) -> f64 {
        let [from, to] = between.map(|t| t - p.get(P::Latency));
        let first = self.periods.partition_point(|k| k.end + MOST_AFTER_S < from);
        let inside = self.periods[first..].iter().take_while(|k| k.start < to).filter_map(|k| {
            let duty = effective_duty(k.duty, p);
            let rest_s = (1.0 - duty) * (k.end - k.start);
            let rises = k.start + rest_s + start_delay(p, rest_s);
            (duty > 0.0 && rises > k.start).then_some([rises, k.end])
        });
        let overlap = |[a, b]: [f64; 2]| (b.min(to) - a.max(from)).max(0.0);
        inside.map(|pulse| overlap(part(pulse))).sum::<f64>() / (to - from).max(1e-9)
    }

    /// The duty of all periods, where they have one and the direction stays.
    pub fn only_duty(&self) -> Option<f64> {
        let first = self.periods.first().filter(|_| self.directions.len() <= 1)?.duty;
        self.periods.iter().all(|period| period.duty == first).then_some(first)
    }

    /// Total time with drive on, in s, up to `until`.
    pub fn drive_time(&self) -> f64 {
        self.periods.iter().map(|p| (p.end - p.start) * p.duty).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half duty, on in the last ten of 20 ms. Fails if a pulse is told from where its period begins, or beyond where it ends.
    #[test]
    fn a_pulse_is_told_from_its_rise_to_its_fall() {
        let schedule = Schedule::constant(0.5, 1.0, 50.0, 0.0, 2.0);
        let p = Parameters::new(3.6, 900.0, 600.0, 0.3, 0.02);
        let within = |between: [f64; 2], ms: usize| schedule.share_within_pulses(between, 1e-3 * ms as f64, &p);
        let close = |share: f64, expected: f64| assert!((share - expected).abs() < 1e-9, "{share}, not {expected}");
        close(within([1.000, 1.002], 0), 0.0);
        close(within([1.010, 1.012], 0), 0.5);
        close(within([1.010, 1.012], 1), 0.5);
        close(within([1.019, 1.021], 9), 0.5);
        close(within([1.019, 1.021], 10), 0.0);
        close(schedule.share_after_switching([1.019, 1.021], true, 0.010, &p), 0.5);
        close(schedule.share_after_switching([1.019, 1.021], false, 0.0, &p), 0.5);
    }
}
