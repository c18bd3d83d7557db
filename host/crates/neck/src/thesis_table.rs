//! The thesis's Table 5.6, and why its first column is not in the unit it states.
//!
//! Whatever an error is, its mean square lies between the square of its mean (Jensen) and its mean times its largest
//! value. Two points on a sphere of radius L are at most 2·L apart. A mean square outside these bounds was not computed
//! from the same errors in the same unit.

use super::kinematics::THESIS_LENGTH_M;
use serde::Serialize;

/// A row of the table as printed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Row {
    /// The exercise.
    pub exercise: &'static str,
    /// Mean square error as printed, said to be m².
    pub mse: f64,
    /// Mean absolute error as printed, m.
    pub mean_abs_error_m: f64,
}

/// Table 5.6.
pub const TABLE_5_6: [Row; 3] = [
    Row { exercise: "flexion-extension", mse: 0.89, mean_abs_error_m: 0.0289 },
    Row { exercise: "lateral-flexion", mse: 0.399, mean_abs_error_m: 0.0188 },
    Row { exercise: "rotation", mse: 2.618e-4, mean_abs_error_m: 5.323e-4 },
];

impl Row {
    /// The row of an exercise, if the thesis has one.
    pub fn of(exercise: &str) -> Option<&'static Self> {
        TABLE_5_6.iter().find(|row| row.exercise == exercise)
    }

    /// Smallest and largest mean square error, m², that go with the row's mean error on a neck of the thesis's length.
    pub fn possible_mse_m2(&self) -> (f64, f64) {
        (self.mean_abs_error_m.powi(2), self.mean_abs_error_m * 2.0 * THESIS_LENGTH_M)
    }

    /// Whether the printed mean square error could be in m².
    pub fn consistent(&self) -> bool {
        let (low, high) = self.possible_mse_m2();
        (low..=high).contains(&self.mse)
    }

    /// Smallest and largest unit of length, m, in whose square the printed mean square error would be possible.
    pub fn possible_unit_m(&self) -> (f64, f64) {
        let (low, high) = self.possible_mse_m2();
        ((low / self.mse).sqrt(), (high / self.mse).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_row_can_be_in_square_metres() {
        for row in TABLE_5_6 {
            assert!(!row.consistent(), "{}", row.exercise);
        }
        let (low, high) = TABLE_5_6[0].possible_mse_m2();
        assert!((low - 8.3521e-4).abs() < 1e-9 && (high - 0.013_814).abs() < 1e-6);
    }

    /// Millimetres and centimetres are too small for every row's Jensen bound, metres too large for every row.
    #[test]
    fn neither_millimetres_nor_centimetres_repair_it() {
        for row in TABLE_5_6 {
            let (low, high) = row.possible_unit_m();
            assert!(low > 0.01 && high < 1.0, "{}: {low} to {high} m", row.exercise);
        }
    }
}
