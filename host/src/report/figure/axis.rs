//! Ranges and tick marks.

/// A range of values shown along one side of a panel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axis {
    low: f64,
    high: f64,
    log: bool,
}

/// Beyond this a range can no longer be subdivided in `f64`.
const LARGEST: f64 = 1e300;

impl Axis {
    /// The axis that shows all usable `values`, or exactly `fixed`.
    pub(super) fn new(values: impl Iterator<Item = f64>, fixed: Option<(f64, f64)>, log: bool) -> Self {
        let usable = |v: &f64| v.is_finite() && (!log || *v > 0.0);
        let fixed = fixed.filter(|(a, b)| usable(a) && usable(b) && a < b);
        let (mut low, mut high) = fixed.unwrap_or_else(|| {
            values.filter(usable).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
        });
        if low > high {
            (low, high) = if log { (1.0, 10.0) } else { (0.0, 1.0) };
        }
        if log {
            (low, high) = (low.log10(), high.log10());
        }
        (low, high) = (low.clamp(-LARGEST, LARGEST), high.clamp(-LARGEST, LARGEST));
        let least = 1e-9 * low.abs().max(high.abs()).max(1e-290);
        if high - low < least {
            let pad = if log { 0.5 } else { (0.5 * low.abs()).max(0.5) };
            (low, high) = (low - pad, high + pad);
        }
        Self { low, high, log }
    }

    /// Widens the range by a share of itself on both sides, so that extremes do not lie on the frame.
    pub(super) fn padded(mut self, share: f64) -> Self {
        let pad = share * (self.high - self.low);
        (self.low, self.high) = (self.low - pad, self.high + pad);
        self
    }

    /// Where `value` lies: 0 at the low end, 1 at the high end; NaN for what the axis cannot show.
    pub(super) fn fraction(&self, value: f64) -> f64 {
        let v = match (value.is_finite(), self.log) {
            (false, _) => return f64::NAN,
            (true, false) => value,
            (true, true) if value > 0.0 => value.log10(),
            (true, true) => return f64::NAN,
        };
        (v - self.low) / (self.high - self.low)
    }

    /// About `wanted` round values, as their fraction of the axis and their text.
    pub(super) fn ticks(&self, wanted: usize) -> Vec<(f64, String)> {
        let span = self.high - self.low;
        if self.log && span >= 1.0 {
            return self.decade_ticks(wanted);
        }
        let (low, high) = if self.log { (10f64.powf(self.low), 10f64.powf(self.high)) } else { (self.low, self.high) };
        let step = round_step((high - low) / wanted.max(2) as f64);
        let first = (low / step).ceil();
        let count = ((high / step).floor() - first).clamp(0.0, 100.0) as usize;
        (0..=count)
            .map(|i| (first + i as f64) * step)
            .map(|v| (self.fraction(v), text(v, step, low.abs().max(high.abs()))))
            .filter(|(f, _)| f.is_finite())
            .collect()
    }

    fn decade_ticks(&self, wanted: usize) -> Vec<(f64, String)> {
        let span = self.high - self.low;
        let every = (span / wanted as f64).ceil().max(1.0);
        let multiples: &[f64] = if span < 2.5 { &[1.0, 2.0, 5.0] } else { &[1.0] };
        let mut ticks = Vec::new();
        let mut decade = (self.low / every).floor() * every;
        while decade <= self.high {
            for m in multiples {
                let exponent = decade + m.log10();
                if (self.low - 1e-9..=self.high + 1e-9).contains(&exponent) {
                    let value = m * 10f64.powf(decade);
                    ticks.push(((exponent - self.low) / span, text(value, value, value)));
                }
            }
            decade += every;
        }
        ticks
    }
}

/// The smallest of 1, 2, 5 x 10^k that is at least `step`.
fn round_step(step: f64) -> f64 {
    let power = 10f64.powf(step.log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|m| m * power).find(|s| *s >= step * (1.0 - 1e-9)).unwrap_or(10.0 * power)
}

/// `value` with the digits that tell it from its neighbour at `step`, on an axis that reaches `largest`.
fn text(value: f64, step: f64, largest: f64) -> String {
    let value = if value.abs() < step * 1e-6 { 0.0 } else { value };
    if value != 0.0 && !(1e-4..1e6).contains(&largest) {
        let digits = (value.abs().log10().floor() - step.log10().floor()).clamp(0.0, 6.0) as usize;
        return format!("{value:.digits$e}").replace('-', "\u{2212}");
    }
    let decimals = (-(step * (1.0 + 1e-9)).log10().floor()).clamp(0.0, 12.0) as usize;
    format!("{value:.decimals$}").replace('-', "\u{2212}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(values: &[f64], log: bool) -> Vec<String> {
        Axis::new(values.iter().copied(), None, log).ticks(5).into_iter().map(|t| t.1).collect()
    }

    #[test]
    fn ticks_are_round_numbers() {
        assert_eq!(labels(&[0.0, 10.0], false), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(labels(&[-0.5, 0.5], false), ["\u{2212}0.4", "\u{2212}0.2", "0.0", "0.2", "0.4"]);
        assert_eq!(labels(&[1e7, 2e7], false), ["1.0e7", "1.2e7", "1.4e7", "1.6e7", "1.8e7", "2.0e7"]);
        assert_eq!(labels(&[1.0, 1e5], true), ["1", "10", "100", "1000", "10000", "100000"]);
        assert_eq!(labels(&[1.0, 20.0], true), ["1", "2", "5", "10", "20"]);
    }

    #[test]
    fn fractions_run_from_0_to_1() {
        let axis = Axis::new([2.0, 4.0].into_iter(), None, false);
        assert_eq!(axis.fraction(3.0), 0.5);
        assert!(axis.fraction(f64::NAN).is_nan());
        assert!(Axis::new([1.0, 10.0].into_iter(), None, true).fraction(-1.0).is_nan());
    }
}
