//! An arccosine that inlines: the contact needs two a derivative, and a library call costs more than the rest of it.

use super::lanes::Lanes;
use std::f64::consts::{FRAC_PI_2, PI};

/// (asin(√z)/√z − 1)/z on 0..1/4, interpolated at Chebyshev nodes: asin is off by less than 1.9e-18.
const COEFFICIENTS: [f64; 13] = [
    0.16666666666666669,
    0.07499999999998433,
    0.04464285714635543,
    0.030381944138531247,
    0.02237217294214989,
    0.017352392720869973,
    0.013971212973552933,
    0.011479177415184906,
    0.01032281435018578,
    0.005457506718640358,
    0.01740087944269402,
    -0.014851887071247204,
    0.028757851367421566,
];

/// acos(x) for −1 ≤ x ≤ 1, to within 1e-15·π of the exact value; without branches.
#[inline(always)]
pub fn acos(x: f64) -> f64 {
    acos_of(Lanes([x])).0[0]
}

/// [`acos`] of every lane.
#[inline(always)]
pub fn acos_of<const N: usize>(x: Lanes<N>) -> Lanes<N> {
    let half = Lanes::all(0.5);
    let a = x.abs();
    // acos(a) = 2·asin(√((1 − a)/2)) where the slope of acos is steep.
    let z = half.where_below(a, 0.5 * (1.0 - a), a * a);
    let s = half.where_below(a, z.sqrt(), a);
    let c = COEFFICIENTS.map(Lanes::all);
    let z2 = z * z;
    let z4 = z2 * z2;
    let low = (c[0] + c[1] * z) + (c[2] + c[3] * z) * z2;
    let middle = (c[4] + c[5] * z) + (c[6] + c[7] * z) * z2;
    let high = (c[8] + c[9] * z) + (c[10] + c[11] * z) * z2 + c[12] * z4;
    let asin = s + s * z * (low + (middle + high * z4) * z4);
    let acos = half.where_below(a, 2.0 * asin, FRAC_PI_2 - asin);
    x.where_below(Lanes::all(0.0), PI - acos, acos)
}

#[cfg(test)]
mod tests {
    #[test]
    fn agrees_with_the_library() {
        for i in -100_000..=100_000 {
            let x = f64::from(i) / 100_000.0;
            assert!((super::acos(x) - x.acos()).abs() < 4e-15, "{x}");
        }
        assert_eq!(super::acos(1.0), 0.0);
        assert_eq!(super::acos(-1.0), std::f64::consts::PI);
    }
}
