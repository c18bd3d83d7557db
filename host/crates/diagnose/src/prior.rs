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
    /// A positive number, around a median by factors.
    LogNormal {
        /// Median, in the number's unit.
        median: f64,
        /// Standard deviation of the natural logarithm.
        log_sd: f64,
    },
}

impl Prior {
    /// Log density over the number (`Normal`) or its logarithm (`LogNormal`), relative to its peak; 0 where nothing is known.
    pub fn log_density(&self, value: f64) -> f64 {
        match *self {
            Prior::Flat => 0.0,
            Prior::Normal { centre, sd } => -0.5 * ((value - centre) / sd).powi(2),
            Prior::LogNormal { median, log_sd } => -0.5 * ((value.max(1e-12) / median).ln() / log_sd).powi(2),
        }
    }

    /// The same with its height, without the constant of 2π: by which beliefs in one number are compared.
    pub fn log_height(&self, value: f64) -> f64 {
        let width = match *self {
            Prior::Flat => 1.0,
            Prior::Normal { sd, .. } => sd,
            Prior::LogNormal { log_sd, .. } => log_sd,
        };
        self.log_density(value) - width.ln()
    }

    /// Slope and curvature of the negative log density in the number itself; the curvature is that of a parabola above it, so that a
    /// Newton step never overshoots.
    pub fn pull(&self, value: f64) -> (f64, f64) {
        match *self {
            Prior::Flat => (0.0, 0.0),
            Prior::Normal { centre, sd } => ((value - centre) / (sd * sd), 1.0 / (sd * sd)),
            Prior::LogNormal { median, log_sd } => {
                let value = value.max(1e-12);
                let precision = 1.0 / (log_sd * log_sd);
                (precision * (value / median).ln() / value, precision / (value * value))
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

    /// Fails if slope and density no longer belong together, or if a wide belief does not pay for its width.
    #[test]
    fn slopes_are_those_of_the_density() {
        let (narrow, wide) =
            (Prior::LogNormal { median: 10.0, log_sd: 0.3 }, Prior::LogNormal { median: 10.0, log_sd: 1.5 });
        for prior in [Prior::Normal { centre: 1.0, sd: 2.0 }, narrow, wide] {
            for value in [0.3, 2.0, 9.0, 30.0] {
                let h = 1e-5 * value;
                let slope = (prior.log_density(value - h) - prior.log_density(value + h)) / (2.0 * h);
                assert!((slope - prior.pull(value).0).abs() < 1e-4 * slope.abs().max(1e-3), "{prior:?} at {value}");
            }
        }
        assert!(narrow.log_height(10.0) > wide.log_height(10.0) && narrow.log_height(100.0) < wide.log_height(100.0));
    }
}
