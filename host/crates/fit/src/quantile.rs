//! From a standard deviation, or from a sample, to an interval.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Two-sided 95 % quantile of the normal distribution, to the two decimals in which it is known.
pub const NORMAL_95: f64 = 1.96;

/// Where a central 95 % interval begins and ends.
pub const INTERVAL_95: [f64; 2] = [0.025, 0.975];

/// Two-sided 95 % quantile of Student's t.
pub fn student_95(freedom: f64) -> f64 {
    StudentsT::new(0.0, 1.0, freedom.max(1.0)).map_or(NORMAL_95, |t| t.inverse_cdf(0.975))
}

/// Quantiles of a sample at `shares` (0 to 1), linear between neighbours (the seventh definition of Hyndman and Fan, "Sample
/// quantiles in statistical packages", 1996: that of NumPy and R). NaN of none.
pub fn quantiles<const N: usize>(mut sample: Vec<f64>, shares: [f64; N]) -> [f64; N] {
    sample.sort_by(f64::total_cmp);
    let value = |i: usize| sample.get(i).copied().unwrap_or(f64::NAN);
    shares.map(|share| {
        let place = share * sample.len().saturating_sub(1) as f64;
        let (low, high) = (value(place.floor() as usize), value(place.ceil() as usize));
        low + place.fract() * (high - low)
    })
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

    /// NumPy's `quantile` of the same five numbers.
    #[test]
    fn a_quantile_lies_between_its_neighbours() {
        assert_eq!(quantiles(vec![4.0, 0.0, 1.0, 3.0, 2.0], [0.0, 0.5, 0.9, 1.0]), [0.0, 2.0, 3.6, 4.0]);
        assert_eq!(quantiles(vec![5.0], [0.5, 0.9]), [5.0, 5.0]);
        assert!(quantiles(Vec::new(), [0.5])[0].is_nan());
    }
}
