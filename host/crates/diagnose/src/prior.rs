//! What is known of a number before the data.

/// A belief about one number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Prior {
    /// Nothing is known.
    Flat,
    /// Around a value, either sign.
    Normal {
        /// Centre, in the number's unit.
        centre: f64,
        /// Standard deviation, in the number's unit.
        sd: f64,
    },
    /// A positive number: either near the first median, or anywhere near the second.
    Either {
        /// Medians, in the number's unit.
        medians: [f64; 2],
        /// Standard deviations of the natural logarithm.
        log_sds: [f64; 2],
        /// Probability of the first.
        first: f64,
    },
}

impl Prior {
    /// A log-normal.
    pub fn log_normal(median: f64, log_sd: f64) -> Self {
        Prior::Either { medians: [median; 2], log_sds: [log_sd; 2], first: 1.0 }
    }

    /// Log density over the number (`Normal`) or its logarithm (`Either`), without the constant of 2π; 0 where nothing is known.
    pub fn log_density(&self, value: f64) -> f64 {
        match *self {
            Prior::Flat => 0.0,
            Prior::Normal { centre, sd } => -0.5 * ((value - centre) / sd).powi(2),
            Prior::Either { .. } => self.parts(value).iter().sum::<f64>().max(1e-300).ln(),
        }
    }

    /// Densities of the two parts, each relative to the height a lone first part would have.
    fn parts(&self, value: f64) -> [f64; 2] {
        let Prior::Either { medians, log_sds, first } = *self else { return [1.0, 0.0] };
        let density = |k: usize, weight: f64| {
            let z = (value.max(1e-12) / medians[k]).ln() / log_sds[k];
            weight * (-0.5 * z * z).exp() * log_sds[0] / log_sds[k]
        };
        [density(0, first), density(1, 1.0 - first)]
    }

    /// Slope and curvature of the negative log density in the number itself; the curvature is that of a parabola above it, so that a
    /// Newton step never overshoots.
    pub fn pull(&self, value: f64) -> (f64, f64) {
        match *self {
            Prior::Flat => (0.0, 0.0),
            Prior::Normal { centre, sd } => ((value - centre) / (sd * sd), 1.0 / (sd * sd)),
            Prior::Either { medians, log_sds, .. } => {
                let value = value.max(1e-12);
                let parts = self.parts(value);
                let total = (parts[0] + parts[1]).max(1e-300);
                let (mut slope, mut curvature) = (0.0, 0.0);
                for k in 0..2 {
                    let precision = parts[k] / total / (log_sds[k] * log_sds[k]);
                    slope += precision * (value / medians[k]).ln() / value;
                    curvature += precision / (value * value);
                }
                (slope, curvature)
            }
        }
    }

    /// Standard deviation in the number's own unit near a value; infinite where nothing is known.
    pub fn sd_near(&self, value: f64) -> f64 {
        let curvature = self.pull(value).1;
        if curvature > 0.0 { curvature.sqrt().recip() } else { f64::INFINITY }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if slope and density no longer belong together, or if another motor's friction costs what a wrong file would.
    #[test]
    fn slopes_are_those_of_the_density() {
        let either = Prior::Either { medians: [10.0, 10.0], log_sds: [0.3, 1.5], first: 0.5 };
        for prior in [Prior::Normal { centre: 1.0, sd: 2.0 }, Prior::log_normal(5.0, 0.9), either] {
            for value in [0.3, 2.0, 9.0, 30.0] {
                let h = 1e-5 * value;
                let slope = (prior.log_density(value - h) - prior.log_density(value + h)) / (2.0 * h);
                assert!((slope - prior.pull(value).0).abs() < 1e-4 * slope.abs().max(1e-3), "{prior:?} at {value}");
            }
        }
        assert!(either.log_density(100.0) > Prior::log_normal(10.0, 0.3).log_density(100.0) + 20.0);
    }
}
