//! What residuals of runs scatter.

/// Each residual by itself, and all of a run by a common factor, its gain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Variance of a residual: two of them are one nat.
    pub variance: f64,
    /// Relative spread of the runs' gains.
    pub gain_spread: f64,
}

impl Noise {
    /// Without scatter of the gains, so that an error is what it is.
    pub const PLAIN: Self = Self { variance: 1.0, gain_spread: 0.0 };

    /// Squared error of a run with its gain taken out as far as gains scatter: `yy` the squared residuals, `gg` the squared predictions,
    /// `gy` one times the other (a Gaussian gain integrated; Sherman & Morrison, Ann. Math. Stat. 21 (1950) 124).
    pub fn squared_error(self, yy: f64, gg: f64, gy: f64) -> f64 {
        yy - self.gamma(gg) * gy * gy
    }

    /// How much of a residual along the prediction is the gain's, over the squared prediction `gg`.
    pub fn gamma(self, gg: f64) -> f64 {
        let t = self.gain_spread * self.gain_spread;
        t / (self.variance + t * gg)
    }
}
