//! How the rotor moves in a step of the averaged model.

use super::Averaged;
use super::field::{Field, Pressed};
use crate::arccosine::acos;
use crate::carrier::CREEP_RAD_S;
use std::f64::consts::PI;

impl Averaged {
    /// Rotor acceleration (rad/s²) and its slope with the speed (1/s).
    #[inline]
    pub(super) fn accelerate(&self, field: &Field, speed: f64) -> (f64, f64) {
        let c = &self.coefficients;
        let Field { pressed: Pressed { phi, zeta, beta, .. }, sense, crest, limit, .. } = *field;
        let (share, slope) = match c.slip_excess {
            0.0 => share(sense * speed / crest, phi, zeta, beta),
            excess => soft_share(sense * speed / crest, phi, zeta, beta, (excess, c.half_slip_torque)),
        };
        let fading = (speed / CREEP_RAD_S).clamp(-1.0, 1.0);
        let brake = c.brake + c.off_brake * field.gone + self.stribeck(speed);
        let torque = sense * limit * share - c.rotational_damping * speed - c.load - brake * fading;
        (torque * c.inertia_inv, (limit * slope / crest - c.rotational_damping) * c.inertia_inv)
    }

    /// The rotor `h` later, from acceleration `f0` and slope `s0` at the start to the contact at the end.
    ///
    /// The acceleration is taken as linear in time and speed, and solved exactly. The slope is the secant over the step, found
    /// by iteration: the torque has kinks where the rotor overtakes the first or the last of the contact.
    #[inline]
    pub(super) fn turn(&mut self, end: &Field, h: f64, f0: f64, s0: f64) {
        let v0 = self.speed_rad_s;
        let (late, late_slope) = self.accelerate(end, v0);
        let drift = late - f0;
        let mut slope = 0.5 * (s0 + late_slope);
        let tolerance = 1e-3 * self.reference_rad_s;
        let (mut phi1, mut phi2) = phis(slope * h);
        let mut v1 = v0 + h * (phi1 * f0 + phi2 * drift);
        for _ in 0..4 {
            // A guess beyond the crest would see only the flat brake there.
            let top = end.crest * end.sense;
            if (v1 - top) * (v0 - top) < 0.0 {
                v1 = top;
            }
            if (v1 - v0).abs() < 1e-9 * self.reference_rad_s {
                break;
            }
            let (f1, _) = self.accelerate(end, v1);
            let secant = ((f1 - late) / (v1 - v0)).min(0.0);
            (phi1, phi2) = phis(secant * h);
            slope = secant;
            let better = v0 + h * (phi1 * f0 + phi2 * drift);
            let moved = (better - v1).abs();
            v1 = better;
            if moved < tolerance {
                break;
            }
        }
        // ∫ of the same linear solution.
        let x = slope * h;
        let phi3 = if x.abs() < 1e-2 { 1.0 / 6.0 + x / 24.0 + x * x / 120.0 } else { (phi2 - 0.5) / x };
        self.position_rad += h * (v0 + h * (phi2 * f0 + phi3 * drift));
        self.speed_rad_s = v1;
    }

    /// The rotor `h` later at a constant acceleration and slope.
    fn glide(&mut self, h: f64, acceleration: f64, slope: f64) {
        let (phi1, phi2) = phis(slope * h);
        self.position_rad += h * (self.speed_rad_s + h * acceleration * phi2);
        self.speed_rad_s += acceleration * h * phi1;
    }

    /// No wave, and a contact of bristles that bend before they slide (LuGre without the Stribeck term, whose limit is `limit`):
    /// the bristle's relaxation is solved exactly, the rotor on it implicitly, so any stiffness is stable.
    pub(super) fn bristle(&mut self, longest: f64, limit: f64) -> f64 {
        let c = self.coefficients;
        let (stiffness, damping) = c.bristle;
        if self.speed_rad_s.abs() < 1e-7 && (stiffness * self.bristle_rad + c.load).abs() < 1e-6 * limit {
            self.speed_rad_s = 0.0;
            return longest;
        }
        let period = (stiffness * c.inertia_inv).sqrt();
        let h = longest.min((0.15 / period).max(1e-5));
        let v = self.speed_rad_s;
        let bent = self.bristle_rad;
        let slide = stiffness * v.abs() / limit.max(1e-12);
        // Linearly implicit in speed and deflection: z' = v − slide·z, J·v' = −σ0·z − σ1·z' − Cθ·v − load.
        let z_v = h / (1.0 + h * slide);
        let z_0 = bent / (1.0 + h * slide);
        let k = h * c.inertia_inv;
        let a = 1.0 + k * (stiffness * z_v + damping * (1.0 - slide * z_v) + c.rotational_damping);
        let b = v - k * (stiffness * z_0 - damping * slide * z_0 + c.load);
        let speed = b / a;
        self.bristle_rad = z_0 + z_v * speed;
        self.position_rad += 0.5 * h * (v + speed);
        self.speed_rad_s = speed;
        h
    }

    /// No wave: the rotor under Coulomb friction `limit` (N·m), viscous friction and load; stops, and stays stopped while
    /// the friction can hold it.
    pub(super) fn coast(&mut self, longest: f64, limit: f64) -> f64 {
        let c = self.coefficients;
        let slope = -c.rotational_damping * c.inertia_inv;
        if self.speed_rad_s == 0.0 {
            if c.load.abs() <= limit {
                return longest;
            }
            let acceleration = (-c.load + limit * c.load.signum()) * c.inertia_inv;
            self.glide(longest, acceleration, slope);
            return longest;
        }
        let sense = self.speed_rad_s.signum();
        let acceleration = -(c.load + limit * sense) * c.inertia_inv + slope * self.speed_rad_s;
        let before = self.speed_rad_s;
        let stop = if acceleration * sense < 0.0 {
            // Exact with viscous friction: v(t) = v + a·(exp(st) − 1)/s.
            let y = -before * slope / acceleration;
            if slope.abs() < 1e-12 || y.abs() < 1e-12 { -before / acceleration } else { y.ln_1p() / slope }
        } else {
            f64::INFINITY
        };
        let h = longest.min(if stop.is_nan() { f64::INFINITY } else { stop });
        self.glide(h, acceleration, slope);
        if h < longest {
            self.speed_rad_s = 0.0;
        }
        h.max(1e-9)
    }
}

/// φ1(x) = (eˣ − 1)/x and φ2(x) = (φ1 − 1)/x, of exponential integrators.
#[inline]
fn phis(x: f64) -> (f64, f64) {
    if x.abs() < 2e-2 {
        let phi2 = 0.5 + x * (1.0 / 6.0 + x * (1.0 / 24.0 + x / 120.0));
        (1.0 + x * phi2, phi2)
    } else {
        let phi1 = x.exp_m1() / x;
        (phi1, (phi1 - 1.0) / x)
    }
}

/// The drive share of [`crate::contact::drive_share`] with β(φ) known, and its slope with the speed ratio.
#[inline]
fn share(ratio: f64, phi: f64, zeta: f64, beta: f64) -> (f64, f64) {
    if ratio <= zeta.max(-1.0) {
        return (if zeta < -1.0 { 2.0 * (-zeta * PI) / beta - 1.0 } else { 1.0 }, 0.0);
    }
    if ratio >= 1.0 || phi <= 0.0 {
        return (-1.0, 0.0);
    }
    let psi = acos(ratio);
    let sin = (1.0 - ratio * ratio).sqrt();
    (2.0 * (sin - zeta * psi) / beta - 1.0, -2.0 * (ratio - zeta) / (beta * sin.max(1e-3)))
}

/// [`share`] of a soft contact, which takes a slip for a torque beyond the rigid one's: share(ratio + excess·balanced·lag(s)) = s, where
/// `balanced` is the ratio at which the rigid contact gives none and `lag` the share of the slip that goes with a share s of the torque: straight
/// to the torque at half of it, and on to all. The left side falls and the right one rises with s.
fn soft_share(ratio: f64, phi: f64, zeta: f64, beta: f64, (excess, half_torque): (f64, f64)) -> (f64, f64) {
    let root = |low: f64, high: f64, f: &dyn Fn(f64) -> f64| {
        let (mut low, mut high) = (low, high);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if f(middle) > 0.0 { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    };
    let lag = |s: f64| {
        let beyond = (s.abs() - half_torque).max(0.0);
        let slope = if beyond > 0.0 { 0.5 / (1.0 - half_torque) } else { 0.5 / half_torque };
        (s.signum() * (0.5 * s.abs().min(half_torque) / half_torque + 0.5 * beyond / (1.0 - half_torque)), slope)
    };
    let balanced = root(zeta.clamp(-1.0, 1.0), 1.0, &|r| share(r, phi, zeta, beta).0).max(0.0);
    let slip = excess * balanced;
    let soft = root(-1.0, 1.0, &|s| share(ratio + slip * lag(s).0, phi, zeta, beta).0 - s);
    let (at, steeper) = lag(soft);
    let slope = share(ratio + slip * at, phi, zeta, beta).1;
    (soft, slope / (1.0 - slip * steeper * slope))
}
