//! Several numbers that go through the same arithmetic, one lane each: what the compiler turns into vector instructions.
//!
//! Every operation is the scalar one lane by lane, without contraction, so a lane's result does not depend on how many
//! others there are or on which instructions the processor has.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// `N` numbers side by side; one is a plain number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lanes<const N: usize>(pub [f64; N]);

macro_rules! lane_by_lane {
    ($operation:ident, $name:ident, $symbol:tt) => {
        impl<const N: usize> $operation for Lanes<N> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                let mut result = self;
                for i in 0..N {
                    result.0[i] = self.0[i] $symbol other.0[i];
                }
                result
            }
        }

        impl<const N: usize> $operation<Lanes<N>> for f64 {
            type Output = Lanes<N>;
            #[inline(always)]
            fn $name(self, other: Lanes<N>) -> Lanes<N> {
                Lanes::all(self) $symbol other
            }
        }
    };
}

lane_by_lane!(Add, add, +);
lane_by_lane!(Sub, sub, -);
lane_by_lane!(Mul, mul, *);
lane_by_lane!(Div, div, /);

impl<const N: usize> Neg for Lanes<N> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.each(|x| -x)
    }
}

impl<const N: usize> Lanes<N> {
    /// The same number in every lane.
    #[inline(always)]
    pub fn all(value: f64) -> Self {
        Lanes([value; N])
    }

    /// A function of each lane.
    #[inline(always)]
    pub fn each(mut self, of: impl Fn(f64) -> f64) -> Self {
        for i in 0..N {
            self.0[i] = of(self.0[i]);
        }
        self
    }

    /// Square roots.
    #[inline(always)]
    pub fn sqrt(self) -> Self {
        self.each(f64::sqrt)
    }

    /// Absolute values.
    #[inline(always)]
    pub fn abs(self) -> Self {
        self.each(f64::abs)
    }

    /// At least `bound`. (`f64::max` minds NaN, which costs two more instructions.)
    #[inline(always)]
    pub fn at_least(self, bound: f64) -> Self {
        self.each(|x| if x > bound { x } else { bound })
    }

    /// At most `bound`.
    #[inline(always)]
    pub fn at_most(self, bound: f64) -> Self {
        self.each(|x| if x < bound { x } else { bound })
    }

    /// Where `self < bound` the lane of `then`, elsewhere that of `otherwise`.
    #[inline(always)]
    pub fn where_below(self, bound: Self, then: Self, otherwise: Self) -> Self {
        let mut chosen = otherwise;
        for i in 0..N {
            chosen.0[i] = if self.0[i] < bound.0[i] { then.0[i] } else { otherwise.0[i] };
        }
        chosen
    }
}
