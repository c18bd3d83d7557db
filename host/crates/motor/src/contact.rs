//! Contact mechanics: what a wave of amplitude W does to a rotor at height z (thesis, sections A.5.1 to A.5.4).
//!
//! Everything is a function of three angles. With `x` along the contact circle and `k` the wavenumber, the stator's surface
//! is `Rr·W·cos(kx)`, the rotor a plane at `z`, and ζ = z/(Rr·W):
//! - φ = k·x0, the half-contact angle, cos φ = ζ: surface and rotor touch for |kx| < φ;
//! - ψ = k·xs, the stick angle: inside it the stator's surface is faster than the rotor's and drags it on, outside it holds it back.
//!
//! The pressure is `Cn·Rr·W·(cos kx − ζ)`, so its integral from 0 to A is β(A) = sin A − ζ·A (over k).

use super::parameters::Parameters;
use std::f64::consts::PI;

/// The constants of the contact, computed once.
#[derive(Debug, Clone, Copy)]
pub struct Contact {
    /// Force scale: `2·Rr·(n/k)·Cn` (N/m); times W and β it is a normal force.
    pub force_n_m: f64,
    /// Normal feedback scale: `Rr²·(n/k)·Cn` (N/m).
    pub normal_n_m: f64,
    /// Tangential feedback scale without friction: `h·n·Rr²·Cn` (N/m).
    pub tangential_n_m: f64,
    /// Surface speed scale `h·k·Rr` (1): times W·ω it is the crest's tangential speed (m/s).
    pub surface: f64,
    /// `R0` (m).
    pub radius_m: f64,
    /// `Rr` (1).
    pub shape: f64,
}

impl Contact {
    /// From a parameter set.
    pub fn new(p: &Parameters) -> Self {
        let shape = p.radial_shape;
        Contact {
            force_n_m: 2.0 * shape * p.contact_radius_m * p.contact_stiffness_n_m2,
            normal_n_m: shape * shape * p.contact_radius_m * p.contact_stiffness_n_m2,
            tangential_n_m: p.half_thickness_m * p.waves * shape * shape * p.contact_stiffness_n_m2,
            surface: p.half_thickness_m * p.wavenumber() * shape,
            radius_m: p.contact_radius_m,
            shape,
        }
    }
}

/// β: the pressure's integral from the crest to the angle `angle`, over k·Cn·Rr·W.
#[inline]
pub fn beta(angle: f64, zeta: f64) -> f64 {
    angle.sin() - zeta * angle
}

/// The integral of (cos x − ζ)·cos x from −A to A: the share of the contact's work that goes into the wave.
#[inline]
pub fn wave_work(angle: f64, zeta: f64) -> f64 {
    let (sin, cos) = angle.sin_cos();
    angle + sin * cos - 2.0 * zeta * sin
}

/// The half-contact angle φ at a relative height ζ, and the ζ to use with it.
///
/// Above the crest (ζ > 1) nothing touches; below the trough (ζ < −1) everything does and the pressure simply deepens.
/// The listing clips instead, which bounds the force a wave can carry; see `docs/model.md`.
#[inline]
pub fn half_contact(zeta: f64) -> f64 {
    if zeta >= 1.0 {
        0.0
    } else if zeta <= -1.0 {
        PI
    } else {
        zeta.acos()
    }
}

/// The share of the friction limit u·F·R0 that drives the rotor, from −1 (all of the contact holds it back) to 1.
///
/// `ratio` is the rotor's surface speed over the crest's, cos ψ before clipping.
#[inline]
pub fn drive_share(ratio: f64, phi: f64, zeta: f64) -> f64 {
    if phi <= 0.0 {
        return 0.0;
    }
    let psi = if ratio >= 1.0 {
        0.0
    } else if ratio <= -1.0 {
        PI
    } else {
        ratio.acos()
    }
    .min(phi);
    2.0 * beta(psi, zeta) / beta(phi, zeta) - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn simpson(f: impl Fn(f64) -> f64, a: f64, b: f64) -> f64 {
        let n = 2000;
        let h = (b - a) / n as f64;
        let inner: f64 = (1..n).map(|i| f(a + i as f64 * h) * if i % 2 == 0 { 2.0 } else { 4.0 }).sum();
        (f(a) + f(b) + inner) * h / 3.0
    }

    #[test]
    fn closed_forms_are_the_integrals_they_stand_for() {
        for zeta in [-3.0, -0.9, 0.2, 0.95f64] {
            let phi = half_contact(zeta);
            for share in [0.1, 0.5, 1.0] {
                let a = share * phi;
                assert!((beta(a, zeta) - simpson(|x| x.cos() - zeta, 0.0, a)).abs() < 1e-10);
                assert!((wave_work(a, zeta) - simpson(|x| (x.cos() - zeta) * x.cos(), -a, a)).abs() < 1e-10);
            }
        }
    }

    #[test]
    fn drive_share_goes_from_full_drive_to_full_brake() {
        let zeta: f64 = 0.9;
        let phi = half_contact(zeta);
        assert_eq!(drive_share(-2.0, phi, zeta), 1.0);
        assert_eq!(drive_share(zeta - 1e-9, phi, zeta), 1.0);
        assert_eq!(drive_share(1.0, phi, zeta), -1.0);
        assert!(drive_share(0.95, phi, zeta) > drive_share(0.99, phi, zeta));
        // Resting on the whole stator with a vanishing wave, friction is odd in the speed: no drive at standstill.
        assert!(drive_share(0.0, PI, -1e6).abs() < 1e-5);
    }
}
