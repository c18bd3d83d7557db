//! How a run was driven.

use super::{P, Parameters, effective_duty, start_delay};

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

    /// Share of the time between two instants that lies within the millisecond `after_s` behind a rise of the drive, or (`false`) a fall.
    pub fn share_after_switching(&self, [from, to]: [f64; 2], rise: bool, after_s: f64, p: &Parameters) -> f64 {
        let latency = p.get(P::Latency);
        let (from, to) = (from - latency, to - latency);
        let first = self.periods.partition_point(|k| k.end + 0.01 < from);
        let inside = self.periods[first..].iter().take_while(|k| k.start < to).filter_map(|k| {
            let duty = effective_duty(k.duty, p);
            let rest_s = (1.0 - duty) * (k.end - k.start);
            let rises = k.start + rest_s + start_delay(p, rest_s);
            (duty > 0.0 && rises > k.start).then_some(if rise { rises } else { k.end })
        });
        let overlap = |at: f64| ((at + 1e-3).min(to) - at.max(from)).max(0.0);
        inside.map(|switched| overlap(switched + after_s)).sum::<f64>() / (to - from).max(1e-9)
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
