//! The equations of motion: what a state changes by, in either reading, and what sliding costs.

use super::{AMPLITUDE_FLOOR_M, CREEP_RAD_S, Coefficients};
use crate::arccosine::acos_of;
use crate::lanes::Lanes;

#[inline(always)]
pub(super) fn derivative<const N: usize, const PHYSICAL: bool>(
    c: &Coefficients<N>,
    s: &[Lanes<N>; 8],
    (cos, sin): (Lanes<N>, Lanes<N>),
    sense: Lanes<N>,
) -> [Lanes<N>; 8] {
    if PHYSICAL { physical(c, s, cos, sense * sin) } else { thesis(c, s, cos, sense * sin) }
}

/// Sections A.6.1 and A.6.2, with the missing input vector. For a wave running the other way the two modes change roles.
#[inline(always)]
fn thesis<const N: usize>(c: &Coefficients<N>, s: &[Lanes<N>; 8], drive1: Lanes<N>, drive2: Lanes<N>) -> [Lanes<N>; 8] {
    let [w1, w2, v1, v2, z, zd, _, speed] = *s;
    let (zero, one) = (Lanes::all(0.0), Lanes::all(1.0));
    let square = w1 * w1 + w2 * w2;
    let least = c.wmin * c.wmin;
    let floored = square.where_below(least, least, square);
    let (travelling, amplitude) = (square.sqrt(), floored.sqrt());
    // 1/W as W/W²: the division need not wait for the root.
    let inverse = amplitude * (1.0 / floored);
    let sense = (w1 * v2 - w2 * v1).where_below(zero, -one, one);
    let cx = (z * c.shape_inv * inverse).at_least(-1.0).at_most(1.0);
    let phi = acos_of(cx);
    let sx = (1.0 - cx * cx).sqrt();
    let ratio = (sense * speed * c.listed_amplitude_per_rotor * inverse).at_least(-1.0).at_most(1.0);
    let psi = cx.where_below(ratio, acos_of(ratio), phi);
    let cs = cx.where_below(ratio, ratio, cx);
    let ss = (1.0 - cs * cs).sqrt();

    let g1 = 2.0 * (psi - 0.5 * phi + ss * cs - 0.5 * sx * cx - cx * (2.0 * ss - sx));
    let g2 = 2.0 * ss * ss - sx * sx - 2.0 * cx * cx + 4.0 * cx * cs - Lanes::all(2.0);
    let beta_x = sx - phi * cx;
    let beta_s = ss - psi * cx;

    let normal = -(c.normal * (phi - sx * cx));
    let tangential = c.friction * c.tangential;
    let force = c.force * amplitude * beta_x - c.preload;
    let torque = sense * c.friction * c.force * travelling * c.radius * (2.0 * beta_s - beta_x);
    let gone = 1.0 - travelling / amplitude;
    [
        v1,
        v2,
        drive1 - c.stiffness * w1 - c.damping * v1 + normal * w1 + tangential * (sense * w2 * g1 - w1 * g2),
        drive2 - c.stiffness * w2 - c.damping * v2 + normal * w2 - tangential * (sense * w1 * g1 + w2 * g2),
        zd,
        (force - c.vertical_damping * zd) * c.rotor_mass_inv,
        speed,
        (torque - c.rotational_damping * speed - c.load - braking(c, speed, gone)) * c.inertia_inv,
    ]
}

/// The same equations with the corrections of `docs/model.md`: R0 in the stick condition, the crest's own turning rate in
/// place of ω, full contact below the trough, friction without a wave, no in-phase tangential force.
#[inline(always)]
fn physical<const N: usize>(
    c: &Coefficients<N>,
    s: &[Lanes<N>; 8],
    drive1: Lanes<N>,
    drive2: Lanes<N>,
) -> [Lanes<N>; 8] {
    let [w1, w2, v1, v2, z, zd, _, speed] = *s;
    let (zero, one) = (Lanes::all(0.0), Lanes::all(1.0));
    let square = (w1 * w1 + w2 * w2).at_least(AMPLITUDE_FLOOR_M * AMPLITUDE_FLOOR_M);
    let amplitude = square.sqrt();
    // 1/W as W/W²: the division need not wait for the root.
    let inverse = amplitude * (1.0 / square);
    let turned = c.rotor_per_crest * (w1 * v2 - w2 * v1);
    let crest = turned.abs() * inverse;
    let sense = turned.where_below(zero, -one, one);
    let zeta = z * c.shape_inv * inverse;
    let cx = zeta.at_least(-1.0).at_most(1.0);
    let phi = acos_of(cx);
    let sx = (1.0 - cx * cx).sqrt();
    // Speed over crest, both times W: the division need not wait for the root either.
    let least = CREEP_RAD_S * amplitude;
    let against = turned.abs();
    let ratio = (sense * speed * amplitude / against.where_below(least, least, against)).at_least(-1.0).at_most(1.0);
    let psi = cx.where_below(ratio, acos_of(ratio), phi);
    let cs = cx.where_below(ratio, ratio, cx);
    let ss = (1.0 - cs * cs).sqrt();
    // Above the crest nothing touches: φ = 0 and every term below vanishes, for which ζ has to stop at 1.
    let zeta = zeta.at_most(1.0);

    let work_x = phi + sx * cx - 2.0 * zeta * sx;
    let work_s = psi + ss * cs - 2.0 * zeta * ss;
    let beta_x = sx - phi * zeta;
    let beta_s = ss - psi * zeta;

    let friction = friction_of(c, phi);
    let normal = -(c.normal * work_x);
    // A surface that hardly moves is not rubbed at full strength, or a vanishing wave would be rubbed infinitely hard.
    let creep = ((1.0 / CREEP_RAD_S) * crest).at_most(1.0);
    let tangential = sense * creep * friction * c.tangential * (2.0 * work_s - work_x);
    let carried = c.force * amplitude;
    let force = carried * beta_x - c.preload;
    let torque = sense * friction * carried * c.radius * (2.0 * beta_s - beta_x);
    [
        v1,
        v2,
        drive1 - c.stiffness * w1 - c.damping * v1 + normal * w1 + tangential * w2,
        drive2 - c.stiffness * w2 - c.damping * v2 + normal * w2 - tangential * w1,
        zd,
        (force - c.vertical_damping * zd) * c.rotor_mass_inv,
        speed,
        (torque - c.rotational_damping * speed - c.load - braking(c, speed, closed(phi))) * c.inertia_inv,
    ]
}

/// Friction beside the contact's, fading out below [`CREEP_RAD_S`]; `gone` is the measure in which the wave is.
#[inline(always)]
fn braking<const N: usize>(c: &Coefficients<N>, speed: Lanes<N>, gone: Lanes<N>) -> Lanes<N> {
    let Some(b) = c.braking else { return Lanes::all(0.0) };
    let fading = speed.each(|v| b.stribeck * (-(v * b.stribeck_speed_inv).powi(2)).exp());
    (Lanes::all(b.brake) + b.off_brake * gone + fading) * speed.each(|v| (v / CREEP_RAD_S).clamp(-1.0, 1.0))
}

/// Power lost to sliding: friction times the difference of the surfaces' speeds, integrated over the contact.
#[allow(clippy::too_many_arguments)]
pub(super) fn slip(
    c: &Coefficients<1>,
    w1: f64,
    w2: f64,
    v1: f64,
    v2: f64,
    phi: f64,
    zeta: f64,
    speed: f64,
    amplitude: f64,
) -> f64 {
    let crest = c.rotor_per_crest.0[0] * (w1 * v2 - w2 * v1) / amplitude;
    let sense = if crest < 0.0 { -1.0 } else { 1.0 };
    let ratio = (sense * speed / crest.abs().max(CREEP_RAD_S)).clamp(-1.0, 1.0);
    let psi = ratio.acos().min(phi);
    let [friction] = friction_of(c, Lanes([phi])).0;
    let scale = friction * c.radius.0[0] * c.force.0[0] * amplitude;
    // ∫ p·sign(slip)·(crest·cos x − speed): the crest's part is half the wave's work, the rotor's part is the torque.
    let wave = crate::contact::wave_work(psi, zeta) - 0.5 * crate::contact::wave_work(phi, zeta);
    let rotor = 2.0 * crate::contact::beta(psi, zeta) - crate::contact::beta(phi, zeta);
    scale * (crest.abs() * wave - sense * speed * rotor)
}

/// Friction under a wave, or without one: from `u` to `uoff` as the contact closes from half the stator to all of it.
#[inline(always)]
pub(super) fn friction_of<const N: usize>(c: &Coefficients<N>, phi: Lanes<N>) -> Lanes<N> {
    c.friction + (c.off_friction - c.friction) * closed(phi)
}

/// The measure in which a contact of half-angle φ has closed: 0 up to a quarter wave, 1 when all of the stator touches.
#[inline(always)]
pub(super) fn closed<const N: usize>(phi: Lanes<N>) -> Lanes<N> {
    (std::f64::consts::FRAC_2_PI * phi - Lanes::all(1.0)).at_least(0.0)
}
