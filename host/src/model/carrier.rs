//! The hybrid model at carrier resolution: eight states driven at 45 kHz, stepped with the classical Runge-Kutta method.
//!
//! States, in order: the two modes' displacements w1, w2 (m), their velocities (m/s), the rotor's height z (m) and its
//! velocity (m/s), the rotor's angle θ (rad) and speed (rad/s). The listing's system matrices are section A.6.1's; the input
//! vector they lack is η·V + FN + FT on each mode, Fint − Fext on the height and Tint − Tload on the angle.

use super::arccosine::acos;
use super::contact::Contact;
use super::modulation::Modulation;
use super::parameters::{Flavour, Parameters};
use super::plant::Drive;
use std::f64::consts::PI;

/// The step the anchors and the documentation use (s).
pub const STEP_S: f64 = 1e-7;

/// Rotor speed below which friction without a wave fades out instead of switching (rad/s): a real contact creeps.
pub const CREEP_RAD_S: f64 = 2e-3;

/// Smallest amplitude the physical contact divides by (m): a ten-thousandth of an atom.
const AMPLITUDE_FLOOR_M: f64 = 1e-14;

/// The eight states.
pub type State = [f64; 8];

/// The carrier model of one motor.
#[derive(Debug, Clone)]
pub struct Carrier {
    parameters: Parameters,
    flavour: Flavour,
    coefficients: Coefficients,
    state: State,
    /// Phase of the supply (rad), kept in 0..2π.
    phase: f64,
    direction: f64,
    step_s: f64,
    steps: u64,
}

/// What one derivative needs, all divided out beforehand.
#[derive(Debug, Clone, Copy)]
struct Coefficients {
    /// Ks/Ms, Cs/Ms (1/s², 1/s).
    stiffness: f64,
    damping: f64,
    /// Normal and tangential feedback over Ms (1/s²); the second without friction.
    normal: f64,
    tangential: f64,
    /// 2·Rr·R0·Cn (N/m).
    force: f64,
    /// Rotor speed that keeps up with a crest moving at 1 m/s times h·k·Rr (rad/s per m/s).
    rotor_per_crest: f64,
    /// The listing's stick condition, R0² in the place of R0: this times speed over amplitude is cos ψ (m per rad/s).
    listed_amplitude_per_rotor: f64,
    wmin: f64,
    shape_inv: f64,
    radius: f64,
    friction: f64,
    off_friction: f64,
    preload: f64,
    load: f64,
    brake: f64,
    off_brake: f64,
    stribeck: f64,
    stribeck_speed_inv: f64,
    rotor_mass_inv: f64,
    vertical_damping: f64,
    inertia_inv: f64,
    rotational_damping: f64,
}

impl Coefficients {
    fn new(p: &Parameters, m: &Modulation) -> Self {
        let c = Contact::new(p);
        let stiffness_n_m = p.modal_stiffness_n_m * (1.0 + m.resonance_shift_hz / p.resonance_hz()).powi(2);
        Coefficients {
            stiffness: stiffness_n_m / p.modal_mass_kg,
            damping: p.modal_damping_ns_m / p.modal_mass_kg,
            normal: c.normal_n_m / p.modal_mass_kg,
            tangential: c.tangential_n_m / p.modal_mass_kg,
            force: c.force_n_m,
            rotor_per_crest: c.surface / c.radius_m,
            listed_amplitude_per_rotor: c.radius_m * c.radius_m / (c.surface * p.omega()),
            wmin: p.wmin_m(),
            shape_inv: 1.0 / c.shape,
            radius: c.radius_m,
            friction: p.friction * m.friction,
            off_friction: p.off_friction * m.friction,
            preload: p.preload_n * m.preload,
            load: p.load_nm + m.load_nm,
            brake: m.brake_nm,
            off_brake: m.off_brake_nm,
            stribeck: m.stribeck_nm,
            stribeck_speed_inv: 1.0 / m.stribeck_rad_s,
            rotor_mass_inv: 1.0 / p.rotor_mass_kg,
            vertical_damping: p.vertical_damping_ns_m,
            inertia_inv: 1.0 / p.rotor_inertia_kg_m2,
            rotational_damping: p.rotational_damping_nms,
        }
    }
}

impl Carrier {
    /// A motor at rest, rotor where the preload holds it.
    pub fn new(parameters: Parameters, flavour: Flavour) -> Self {
        let mut state = [0.0; 8];
        if flavour == Flavour::Physical {
            // Without a wave the contact is a spring of stiffness 2π·R0·Cn.
            state[4] =
                -parameters.preload_n / (2.0 * PI * parameters.contact_radius_m * parameters.contact_stiffness_n_m2);
        }
        Carrier {
            coefficients: Coefficients::new(&parameters, &Modulation::NONE),
            parameters,
            flavour,
            state,
            phase: 0.0,
            direction: 1.0,
            step_s: STEP_S,
            steps: 0,
        }
    }

    /// The largest step to take (s); the default is [`STEP_S`].
    pub fn with_step(mut self, step_s: f64) -> Self {
        self.step_s = step_s;
        self
    }

    /// The eight states.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Replaces the states.
    pub fn set_state(&mut self, state: State) {
        self.state = state;
    }

    /// Steps taken since the start.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Amplitude of the wave (m).
    pub fn amplitude_m(&self) -> f64 {
        self.state[0].hypot(self.state[1])
    }

    /// Takes over what the effects change; cheap, but not free: do it every few microseconds, not every step.
    pub fn modulate(&mut self, modulation: &Modulation) {
        self.coefficients = Coefficients::new(&self.parameters, modulation);
    }

    /// Integrates `duration_s` under a constant drive, in equal steps no longer than the step set.
    pub fn run(&mut self, duration_s: f64, drive: Drive, modulation: &Modulation) {
        if duration_s <= 0.0 {
            return;
        }
        self.direction = drive.sign();
        let count = (duration_s / self.step_s * (1.0 - 1e-9)).ceil().max(1.0);
        let h = duration_s / count;
        let omega = self.parameters.omega() + 2.0 * PI * modulation.drive_shift_hz;
        let amplitude = drive.level * modulation.voltage * self.parameters.force_factor_n_v * self.parameters.vmax()
            / self.parameters.modal_mass_kg;
        match self.flavour {
            Flavour::Thesis => self.march::<false>(count as u64, h, omega, amplitude),
            Flavour::Physical => self.march::<true>(count as u64, h, omega, amplitude),
        }
        self.phase = (self.phase + omega * duration_s).rem_euclid(2.0 * PI);
    }

    fn march<const PHYSICAL: bool>(&mut self, count: u64, h: f64, omega: f64, amplitude: f64) {
        let c = &self.coefficients;
        let direction = self.direction;
        // The supply's phasor is turned, not recomputed; every 1024 steps it is set afresh, so it cannot drift.
        let (half_sin, half_cos) = (0.5 * omega * h).sin_cos();
        let turn = |(x, y): (f64, f64)| (x * half_cos - y * half_sin, x * half_sin + y * half_cos);
        let mut phasor = (0.0, 0.0);
        let mut s = self.state;
        for i in 0..count {
            if i % 1024 == 0 {
                let (sin, cos) = (self.phase + omega * h * i as f64).sin_cos();
                phasor = (amplitude * cos, amplitude * sin);
            }
            let middle = turn(phasor);
            let end = turn(middle);
            let k1 = derivative::<PHYSICAL>(c, &s, phasor, direction);
            let k2 = derivative::<PHYSICAL>(c, &along(&s, &k1, 0.5 * h), middle, direction);
            let k3 = derivative::<PHYSICAL>(c, &along(&s, &k2, 0.5 * h), middle, direction);
            let k4 = derivative::<PHYSICAL>(c, &along(&s, &k3, h), end, direction);
            for j in 0..8 {
                s[j] += h / 6.0 * (k1[j] + 2.0 * (k2[j] + k3[j]) + k4[j]);
            }
            phasor = end;
        }
        self.state = s;
        self.steps += count;
    }

    /// The power ledger of the present state (W) and the stored energy (J), under a constant drive: what flows in, what is
    /// lost, what leaves through the shaft. Physical flavour only: the listing's friction does not balance.
    pub fn ledger(&self, drive: Drive) -> Ledger {
        let p = &self.parameters;
        let [w1, w2, v1, v2, z, zd, _, speed] = self.state;
        let contact = Contact::new(p);
        let amplitude = w1.hypot(w2).max(AMPLITUDE_FLOOR_M);
        let zeta = z / (p.radial_shape * amplitude);
        let phi = super::contact::half_contact(zeta);
        let (sin, cos) = phi.sin_cos();
        let contact_j = contact.normal_n_m
            * amplitude
            * amplitude
            * (0.5 * (phi + sin * cos) - 2.0 * zeta * sin + zeta * zeta * phi);
        let volts = drive.level * p.vmax();
        let (s, c) = self.phase.sin_cos();
        let input = p.force_factor_n_v * volts * (c * v1 + drive.sign() * s * v2);
        let share = slip(&self.coefficients, w1, w2, v1, v2, phi, zeta, speed, amplitude);
        Ledger {
            stored_j: 0.5 * p.modal_mass_kg * (v1 * v1 + v2 * v2)
                + 0.5 * p.modal_stiffness_n_m * (w1 * w1 + w2 * w2)
                + 0.5 * p.rotor_mass_kg * zd * zd
                + 0.5 * p.rotor_inertia_kg_m2 * speed * speed
                + contact_j
                + p.preload_n * z,
            input_w: input,
            stator_loss_w: p.modal_damping_ns_m * (v1 * v1 + v2 * v2),
            vertical_loss_w: p.vertical_damping_ns_m * zd * zd,
            friction_loss_w: share,
            shaft_w: p.load_nm * speed + p.rotational_damping_nms * speed * speed,
        }
    }
}

/// Where the power goes; see [`Carrier::ledger`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ledger {
    /// Kinetic, elastic, contact and preload energy (J).
    pub stored_j: f64,
    /// From the supply (W).
    pub input_w: f64,
    /// Into the stator's damping (W).
    pub stator_loss_w: f64,
    /// Into the rotor's vertical damping (W).
    pub vertical_loss_w: f64,
    /// Into sliding at the contact (W).
    pub friction_loss_w: f64,
    /// Into the load and the bearing (W).
    pub shaft_w: f64,
}

/// Power lost to sliding: friction times the difference of the surfaces' speeds, integrated over the contact.
#[allow(clippy::too_many_arguments)]
fn slip(c: &Coefficients, w1: f64, w2: f64, v1: f64, v2: f64, phi: f64, zeta: f64, speed: f64, amplitude: f64) -> f64 {
    let crest = c.rotor_per_crest * (w1 * v2 - w2 * v1) / amplitude;
    let sense = if crest < 0.0 { -1.0 } else { 1.0 };
    let ratio = (sense * speed / crest.abs().max(CREEP_RAD_S)).clamp(-1.0, 1.0);
    let psi = ratio.acos().min(phi);
    let friction = friction_of(c, phi);
    let scale = friction * c.radius * c.force * amplitude;
    // ∫ p·sign(slip)·(crest·cos x − speed): the crest's part is half the wave's work, the rotor's part is the torque.
    let wave = super::contact::wave_work(psi, zeta) - 0.5 * super::contact::wave_work(phi, zeta);
    let rotor = 2.0 * super::contact::beta(psi, zeta) - super::contact::beta(phi, zeta);
    scale * (crest.abs() * wave - sense * speed * rotor)
}

/// Friction under a wave, or without one: from `u` to `uoff` as the contact closes from half the stator to all of it.
#[inline(always)]
fn friction_of(c: &Coefficients, phi: f64) -> f64 {
    c.friction + (c.off_friction - c.friction) * closed(phi)
}

/// The measure in which a contact of half-angle φ has closed: 0 up to a quarter wave, 1 when all of the stator touches.
#[inline(always)]
fn closed(phi: f64) -> f64 {
    (phi * std::f64::consts::FRAC_2_PI - 1.0).max(0.0)
}

#[inline(always)]
fn along(s: &State, k: &State, h: f64) -> State {
    let mut r = *s;
    for j in 0..8 {
        r[j] += h * k[j];
    }
    r
}

#[inline(always)]
fn derivative<const PHYSICAL: bool>(c: &Coefficients, s: &State, (cos, sin): (f64, f64), direction: f64) -> State {
    if PHYSICAL { physical(c, s, cos, direction * sin) } else { thesis(c, s, cos, direction * sin) }
}

/// Sections A.6.1 and A.6.2, with the missing input vector. For a wave running the other way the two modes change roles.
#[inline(always)]
fn thesis(c: &Coefficients, s: &State, drive1: f64, drive2: f64) -> State {
    let [w1, w2, v1, v2, z, zd, _, speed] = *s;
    let square = w1 * w1 + w2 * w2;
    let floored = square.max(c.wmin * c.wmin);
    let (travelling, amplitude) = (square.sqrt(), floored.sqrt());
    // 1/W as W/W²: the division need not wait for the root.
    let inverse = amplitude * (1.0 / floored);
    let sense = if w1 * v2 - w2 * v1 < 0.0 { -1.0 } else { 1.0 };
    let cx = (z * c.shape_inv * inverse).clamp(-1.0, 1.0);
    let phi = acos(cx);
    let sx = (1.0 - cx * cx).sqrt();
    let ratio = (sense * speed * c.listed_amplitude_per_rotor * inverse).clamp(-1.0, 1.0);
    let (psi, cs) = if ratio <= cx { (phi, cx) } else { (acos(ratio), ratio) };
    let ss = (1.0 - cs * cs).sqrt();

    let g1 = 2.0 * (psi - 0.5 * phi + ss * cs - 0.5 * sx * cx - cx * (2.0 * ss - sx));
    let g2 = 2.0 * ss * ss - sx * sx - 2.0 * cx * cx + 4.0 * cx * cs - 2.0;
    let beta_x = sx - phi * cx;
    let beta_s = ss - psi * cx;

    let normal = -c.normal * (phi - sx * cx);
    let tangential = c.friction * c.tangential;
    let force = c.force * amplitude * beta_x - c.preload;
    let torque = sense * c.friction * c.force * travelling * c.radius * (2.0 * beta_s - beta_x);
    [
        v1,
        v2,
        drive1 - c.stiffness * w1 - c.damping * v1 + normal * w1 + tangential * (sense * w2 * g1 - w1 * g2),
        drive2 - c.stiffness * w2 - c.damping * v2 + normal * w2 - tangential * (sense * w1 * g1 + w2 * g2),
        zd,
        (force - c.vertical_damping * zd) * c.rotor_mass_inv,
        speed,
        (torque - c.rotational_damping * speed - c.load - braking(c, speed, 1.0 - travelling / amplitude))
            * c.inertia_inv,
    ]
}

/// The same equations with the corrections of `docs/model.md`: R0 in the stick condition, the crest's own turning rate in
/// place of ω, full contact below the trough, friction without a wave, no in-phase tangential force.
#[inline(always)]
fn physical(c: &Coefficients, s: &State, drive1: f64, drive2: f64) -> State {
    let [w1, w2, v1, v2, z, zd, _, speed] = *s;
    let square = (w1 * w1 + w2 * w2).max(AMPLITUDE_FLOOR_M * AMPLITUDE_FLOOR_M);
    let amplitude = square.sqrt();
    // 1/W as W/W²: the division need not wait for the root.
    let inverse = amplitude * (1.0 / square);
    let crest = c.rotor_per_crest * (w1 * v2 - w2 * v1) * inverse;
    let sense = if crest < 0.0 { -1.0 } else { 1.0 };
    let zeta = z * c.shape_inv * inverse;
    let cx = zeta.clamp(-1.0, 1.0);
    let phi = acos(cx);
    let sx = (1.0 - cx * cx).sqrt();
    let ratio = (sense * speed / crest.abs().max(CREEP_RAD_S)).clamp(-1.0, 1.0);
    let (psi, cs) = if ratio <= cx { (phi, cx) } else { (acos(ratio), ratio) };
    let ss = (1.0 - cs * cs).sqrt();
    // Above the crest nothing touches: φ = 0 and every term below vanishes, for which ζ has to stop at 1.
    let zeta = zeta.min(1.0);

    let work_x = phi + sx * cx - 2.0 * zeta * sx;
    let work_s = psi + ss * cs - 2.0 * zeta * ss;
    let beta_x = sx - phi * zeta;
    let beta_s = ss - psi * zeta;

    let friction = friction_of(c, phi);
    let normal = -c.normal * work_x;
    // A surface that hardly moves is not rubbed at full strength, or a vanishing wave would be rubbed infinitely hard.
    let creep = (crest.abs() * (1.0 / CREEP_RAD_S)).min(1.0);
    let tangential = sense * creep * friction * c.tangential * (2.0 * work_s - work_x);
    let force = c.force * amplitude * beta_x - c.preload;
    let torque = sense * friction * c.force * amplitude * c.radius * (2.0 * beta_s - beta_x);
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

/// Friction that effects add, fading out below [`CREEP_RAD_S`]; `gone` is the measure in which the wave is.
#[inline(always)]
fn braking(c: &Coefficients, speed: f64, gone: f64) -> f64 {
    if c.brake == 0.0 && c.off_brake == 0.0 && c.stribeck == 0.0 {
        return 0.0;
    }
    let limit = c.brake + c.off_brake * gone + c.stribeck * (-(speed * c.stribeck_speed_inv).powi(2)).exp();
    limit * (speed / CREEP_RAD_S).clamp(-1.0, 1.0)
}
