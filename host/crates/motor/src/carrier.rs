//! The hybrid model at carrier resolution: eight states driven at 45 kHz, stepped with the classical Runge-Kutta method.
//!
//! States, in order: the two modes' displacements w1, w2 (m), their velocities (m/s), the rotor's height z (m) and its
//! velocity (m/s), the rotor's angle θ (rad) and speed (rad/s). The listing's system matrices are section A.6.1's; the input
//! vector they lack is η·V + FN + FT on each mode, Fint − Fext on the height and Tint − Tload on the angle.
//!
//! A derivative is a chain of roots and arccosines in which most of the processor waits. [`SideBySide`] integrates several
//! motors in the lanes of its vector instructions, at some four times the steps a second.

mod equations;

use super::contact::Contact;
use super::lanes::Lanes;
use super::modulation::Modulation;
use super::parameters::{Flavour, Parameters};
use super::plant::Drive;
use equations::{derivative, slip};
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
    coefficients: Coefficients<1>,
    state: State,
    /// Phase of the supply (rad), kept in 0..2π.
    phase: f64,
    step_s: f64,
    steps: u64,
}

/// What one derivative needs, all divided out beforehand.
#[derive(Debug, Clone, Copy)]
struct Coefficients<const N: usize> {
    /// Ks/Ms, Cs/Ms (1/s², 1/s).
    stiffness: Lanes<N>,
    damping: Lanes<N>,
    /// Normal and tangential feedback over Ms (1/s²); the second without friction.
    normal: Lanes<N>,
    tangential: Lanes<N>,
    /// 2·Rr·R0·Cn (N/m).
    force: Lanes<N>,
    /// Rotor speed that keeps up with a crest moving at 1 m/s times h·k·Rr (rad/s per m/s).
    rotor_per_crest: Lanes<N>,
    /// The listing's stick condition, R0² in the place of R0: this times speed over amplitude is cos ψ (m per rad/s).
    listed_amplitude_per_rotor: Lanes<N>,
    wmin: Lanes<N>,
    shape_inv: Lanes<N>,
    radius: Lanes<N>,
    friction: Lanes<N>,
    off_friction: Lanes<N>,
    preload: Lanes<N>,
    load: Lanes<N>,
    rotor_mass_inv: Lanes<N>,
    vertical_damping: Lanes<N>,
    inertia_inv: Lanes<N>,
    rotational_damping: Lanes<N>,
    braking: Option<Braking<N>>,
}

/// Friction beside the contact's.
#[derive(Debug, Clone, Copy)]
struct Braking<const N: usize> {
    brake: f64,
    off_brake: Lanes<N>,
    stribeck: f64,
    stribeck_speed_inv: f64,
}

impl<const N: usize> Coefficients<N> {
    fn new(parameters: &[Parameters; N], flavour: Flavour, m: &Modulation) -> Self {
        let contacts = parameters.each_ref().map(Contact::new);
        let of =
            |f: &dyn Fn(&Parameters, &Contact) -> f64| Lanes(std::array::from_fn(|i| f(&parameters[i], &contacts[i])));
        let stretch = |p: &Parameters| (1.0 + m.resonance_shift_hz / p.resonance_hz()).powi(2);
        // As listed, the contact's own torque goes with the wave: what is left without one is added.
        let off_friction_nm = |p: &Parameters| {
            if flavour.is_listed() { p.off_friction_nm(flavour) * m.preload * m.friction } else { 0.0 }
        };
        let braking = Braking {
            brake: m.brake_nm,
            off_brake: of(&|p, _| m.off_brake_nm + off_friction_nm(p)),
            stribeck: m.stribeck_nm,
            stribeck_speed_inv: 1.0 / m.stribeck_rad_s,
        };
        Coefficients {
            stiffness: of(&|p, _| p.modal_stiffness_n_m * stretch(p) / p.modal_mass_kg),
            damping: of(&|p, _| p.modal_damping_ns_m / p.modal_mass_kg),
            normal: of(&|p, c| c.normal_n_m / p.modal_mass_kg),
            tangential: of(&|p, c| c.tangential_n_m / p.modal_mass_kg),
            force: of(&|_, c| c.force_n_m),
            rotor_per_crest: of(&|_, c| c.surface / c.radius_m),
            listed_amplitude_per_rotor: of(&|p, c| c.radius_m * c.radius_m / (c.surface * p.omega())),
            wmin: of(&|p, _| p.wmin_m()),
            shape_inv: of(&|_, c| 1.0 / c.shape),
            radius: of(&|_, c| c.radius_m),
            friction: of(&|p, _| p.friction * m.friction),
            off_friction: of(&|p, _| p.off_friction * m.off_friction),
            preload: of(&|p, _| p.preload_n * m.preload),
            load: of(&|p, _| p.load_nm + m.load_nm),
            rotor_mass_inv: of(&|p, _| 1.0 / p.rotor_mass_kg),
            vertical_damping: of(&|p, _| p.vertical_damping_ns_m),
            inertia_inv: of(&|p, _| 1.0 / p.rotor_inertia_kg_m2),
            rotational_damping: of(&|p, _| p.rotational_damping_nms),
            braking: (m.brake_nm != 0.0 || m.stribeck_nm != 0.0 || braking.off_brake.0.iter().any(|t| *t != 0.0))
                .then_some(braking),
        }
    }
}

/// A supply with a phase of its own in every lane.
#[derive(Debug, Clone, Copy)]
struct Supply<const N: usize> {
    /// Phase at the start (rad).
    phase: [f64; N],
    /// rad/s.
    omega: [f64; N],
    /// Force over modal mass (m/s²).
    amplitude: [f64; N],
    /// Sense of travel, ±1.
    sense: Lanes<N>,
}

impl<const N: usize> Supply<N> {
    fn new(parameters: &[Parameters; N], phase: [f64; N], drive: [Drive; N], m: &Modulation) -> Self {
        Supply {
            phase,
            omega: parameters.each_ref().map(|p| p.omega() + 2.0 * PI * m.drive_shift_hz),
            amplitude: std::array::from_fn(|i| {
                let p = &parameters[i];
                drive[i].level * m.voltage * p.force_factor_n_v * p.vmax() / p.modal_mass_kg
            }),
            sense: Lanes(drive.map(|d| d.sign())),
        }
    }

    fn phase_after(&self, duration_s: f64) -> [f64; N] {
        std::array::from_fn(|i| (self.phase[i] + self.omega[i] * duration_s).rem_euclid(2.0 * PI))
    }
}

/// Number and length of the equal steps, none longer than `longest_s`.
fn steps_of(duration_s: f64, longest_s: f64) -> (u64, f64) {
    let count = (duration_s / longest_s * (1.0 - 1e-9)).ceil().max(1.0);
    (count as u64, duration_s / count)
}

/// The rotor's height at rest (m).
fn resting_height_m(p: &Parameters, flavour: Flavour) -> f64 {
    match flavour {
        Flavour::Thesis | Flavour::Measured => 0.0,
        // Without a wave the contact is a spring of stiffness 2π·R0·Cn.
        Flavour::Physical => -p.preload_n / (2.0 * PI * p.contact_radius_m * p.contact_stiffness_n_m2),
    }
}

/// `N` motors of one flavour, integrated together in the lanes of vector instructions: each as [`Carrier`] would, step for
/// step. For sweeps; effects act on single motors only.
#[derive(Debug, Clone)]
pub struct SideBySide<const N: usize> {
    parameters: [Parameters; N],
    flavour: Flavour,
    coefficients: Coefficients<N>,
    state: [Lanes<N>; 8],
    phase: [f64; N],
    step_s: f64,
    steps: u64,
}

impl<const N: usize> SideBySide<N> {
    /// Motors at rest.
    pub fn new(parameters: [Parameters; N], flavour: Flavour) -> Self {
        let mut state = [Lanes::all(0.0); 8];
        state[4] = Lanes(parameters.each_ref().map(|p| resting_height_m(p, flavour)));
        SideBySide {
            coefficients: Coefficients::new(&parameters, flavour, &Modulation::NONE),
            parameters,
            flavour,
            state,
            phase: [0.0; N],
            step_s: STEP_S,
            steps: 0,
        }
    }

    /// The largest step to take (s); the default is [`STEP_S`].
    pub fn with_step(mut self, step_s: f64) -> Self {
        self.step_s = step_s;
        self
    }

    /// The eight states of one motor.
    pub fn state(&self, lane: usize) -> State {
        self.state.map(|s| s.0[lane])
    }

    /// Steps taken since the start, by each motor.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Integrates `duration_s`, each motor under its own constant drive.
    pub fn run(&mut self, duration_s: f64, drive: [Drive; N]) {
        if duration_s <= 0.0 {
            return;
        }
        let (count, h) = steps_of(duration_s, self.step_s);
        let supply = Supply::new(&self.parameters, self.phase, drive, &Modulation::NONE);
        integrate(&self.coefficients, &supply, self.flavour, &mut self.state, count, h);
        self.phase = supply.phase_after(duration_s);
        self.steps += count;
    }
}

impl Carrier {
    /// A motor at rest, rotor where the preload holds it.
    pub fn new(parameters: Parameters, flavour: Flavour) -> Self {
        let mut state = [0.0; 8];
        state[4] = resting_height_m(&parameters, flavour);
        Carrier {
            coefficients: Coefficients::new(&[parameters], flavour, &Modulation::NONE),
            parameters,
            flavour,
            state,
            phase: 0.0,
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
        self.coefficients = Coefficients::new(&[self.parameters], self.flavour, modulation);
    }

    /// Integrates `duration_s` under a constant drive, in equal steps no longer than the step set.
    pub fn run(&mut self, duration_s: f64, drive: Drive, modulation: &Modulation) {
        if duration_s <= 0.0 {
            return;
        }
        let (count, h) = steps_of(duration_s, self.step_s);
        let supply = Supply::new(&[self.parameters], [self.phase], [drive], modulation);
        let mut state = self.state.map(|x| Lanes([x]));
        integrate(&self.coefficients, &supply, self.flavour, &mut state, count, h);
        self.state = state.map(|x| x.0[0]);
        [self.phase] = supply.phase_after(duration_s);
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

/// Takes `count` steps of length `h`, with the widest instructions the processor has.
fn integrate<const N: usize>(
    c: &Coefficients<N>,
    supply: &Supply<N>,
    flavour: Flavour,
    state: &mut [Lanes<N>; 8],
    count: u64,
    h: f64,
) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: all the function asks for is a processor with AVX2, and this is one.
        unsafe { march_avx2(c, supply, flavour, state, count, h) };
        return;
    }
    march(c, supply, flavour, state, count, h);
}

/// [`march`] compiled for AVX2: the same operations in the same order, hence the same bits, four lanes at a time.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn march_avx2<const N: usize>(
    c: &Coefficients<N>,
    supply: &Supply<N>,
    flavour: Flavour,
    state: &mut [Lanes<N>; 8],
    count: u64,
    h: f64,
) {
    march(c, supply, flavour, state, count, h);
}

#[inline(always)]
fn march<const N: usize>(
    c: &Coefficients<N>,
    supply: &Supply<N>,
    flavour: Flavour,
    state: &mut [Lanes<N>; 8],
    count: u64,
    h: f64,
) {
    match flavour {
        Flavour::Thesis | Flavour::Measured => march_in::<N, false>(c, supply, state, count, h),
        Flavour::Physical => march_in::<N, true>(c, supply, state, count, h),
    }
}

#[inline(always)]
fn march_in<const N: usize, const PHYSICAL: bool>(
    c: &Coefficients<N>,
    supply: &Supply<N>,
    state: &mut [Lanes<N>; 8],
    count: u64,
    h: f64,
) {
    // The supply's phasor is turned, not recomputed; every 1024 steps it is set afresh, so it cannot drift.
    let half_cos = Lanes(supply.omega.map(|omega| (0.5 * omega * h).cos()));
    let half_sin = Lanes(supply.omega.map(|omega| (0.5 * omega * h).sin()));
    let turn = |(x, y): (Lanes<N>, Lanes<N>)| (x * half_cos - y * half_sin, x * half_sin + y * half_cos);
    let mut phasor = (Lanes::all(0.0), Lanes::all(0.0));
    let mut s = *state;
    for i in 0..count {
        if i % 1024 == 0 {
            for lane in 0..N {
                let (sin, cos) = (supply.phase[lane] + supply.omega[lane] * h * i as f64).sin_cos();
                phasor.0.0[lane] = supply.amplitude[lane] * cos;
                phasor.1.0[lane] = supply.amplitude[lane] * sin;
            }
        }
        let middle = turn(phasor);
        let end = turn(middle);
        let k1 = derivative::<N, PHYSICAL>(c, &s, phasor, supply.sense);
        let k2 = derivative::<N, PHYSICAL>(c, &along(&s, &k1, 0.5 * h), middle, supply.sense);
        let k3 = derivative::<N, PHYSICAL>(c, &along(&s, &k2, 0.5 * h), middle, supply.sense);
        let k4 = derivative::<N, PHYSICAL>(c, &along(&s, &k3, h), end, supply.sense);
        for j in 0..8 {
            s[j] = s[j] + h / 6.0 * (k1[j] + 2.0 * (k2[j] + k3[j]) + k4[j]);
        }
        phasor = end;
    }
    *state = s;
}

#[inline(always)]
fn along<const N: usize>(s: &[Lanes<N>; 8], k: &[Lanes<N>; 8], h: f64) -> [Lanes<N>; 8] {
    let mut r = *s;
    for j in 0..8 {
        r[j] = r[j] + h * k[j];
    }
    r
}
