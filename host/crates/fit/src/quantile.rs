//! From a standard deviation to an interval.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Two-sided 95 % quantile of the normal distribution, to the two decimals in which it is known.
pub const NORMAL_95: f64 = 1.96;

/// Two-sided 95 % quantile of Student's t.
pub fn student_95(freedom: f64) -> f64 {
    StudentsT::new(0.0, 1.0, freedom.max(1.0)).map_or(NORMAL_95, |t| t.inverse_cdf(0.975))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Table values; with few degrees the interval is far wider than the normal one.
    #[test]
    fn quantiles_are_those_of_the_tables() {
        for (freedom, expected) in [(1.0, 12.706), (4.0, 2.776), (30.0, 2.042), (1e6, 1.960)] {
            assert!((student_95(freedom) - expected).abs() < 6e-4, "{freedom}: {}", student_95(freedom));
        }
        assert_eq!(student_95(0.0), student_95(1.0));
    }
}
