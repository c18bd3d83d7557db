//! How much of the squared error is one of the forms: effects do not have the library's forms exactly.

/// Share of the squared error without effects below which no form is trusted.
pub const FORM_ERROR: f64 = 0.06;

/// What counts as error of the forms: a share of what is left without effects, and no more than the best set leaves at all, or than that share of what is
/// left beside effects that have no form to be wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FormError {
    most: f64,
}

impl FormError {
    /// Before any set is known.
    pub const UNBOUNDED: Self = Self { most: f64::INFINITY };

    /// Where it is bounded by this much.
    pub fn no_more_than(left: f64) -> Self {
        Self { most: left }
    }

    /// The error, of what is `left` without effects.
    pub fn of(self, left: f64) -> f64 {
        self.most.min(FORM_ERROR * left)
    }

    /// That of which the error is the share: what is `left` without effects, as far as it counts.
    pub fn base(self, left: f64) -> f64 {
        left.min(self.most / FORM_ERROR)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if the bound is forgotten, or the share is taken of something else than what is left without effects.
    #[test]
    fn it_is_a_share_of_what_is_left_and_no_more_than_the_bound() {
        assert_eq!(FormError::UNBOUNDED.of(100.0), FORM_ERROR * 100.0);
        assert_eq!(FormError::UNBOUNDED.base(100.0), 100.0);
        let bounded = FormError::no_more_than(3.0);
        assert_eq!(bounded.of(100.0), 3.0);
        assert!((FORM_ERROR * bounded.base(100.0) - 3.0).abs() < 1e-12);
        assert_eq!(bounded.of(10.0), FORM_ERROR * 10.0);
    }
}
