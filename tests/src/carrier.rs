//! The motor at carrier resolution: two stator modes, the rotor's height and its rotation, driven at 45 kHz.
//!
//! Contact pressure and friction are integrated numerically over the wave crest; nothing is averaged. Slow, and only
//! there to check [`crate::motor`], which makes the bulk of the data.

use crate::motor::{ContactTable, Motor};
use crate::solver::integrate;
use std::f64::consts::{PI, TAU};

/// Physical parameters (values of the 30 mm PCBMotor; the force factor puts the speed at about 35 rpm).
#[derive(Debug, Clone, PartialEq)]
pub struct Carrier {
    /// Supply amplitude in V.
    pub volt: f64,
    /// Supply frequency in Hz.
    pub frequency: f64,
    /// Modal mass in kg, damping in N·s/m, stiffness in N/m.
    pub modal: [f64; 3],
    /// Force factor in N/V.
    pub force_factor: f64,
    /// Radial shape constant.
    pub shape: f64,
    /// Middle radius of contact in m.
    pub radius: f64,
    /// Waves round the stator.
    pub waves: f64,
    /// Half thickness of the stator in m.
    pub half_thickness: f64,
    /// Contact stiffness a length and depth in N/m².
    pub contact: f64,
    /// Rotor mass in kg, inertia in kg·m², vertical damping in N·s/m, rotational damping in N·m·s.
    pub rotor: [f64; 4],
    /// Friction coefficient.
    pub friction: f64,
    /// Preload in N.
    pub preload: f64,
    /// Creep velocity relative to the crest's.
    pub creep: f64,
}

impl Default for Carrier {
    fn default() -> Self {
        Self {
            volt: 148.5,
            frequency: 45_000.0,
            modal: [0.624, 5469.328, 4.798e10],
            force_factor: 38.0,
            shape: 0.7,
            radius: 0.013_675,
            waves: 6.0,
            half_thickness: 0.25e-3,
            contact: 20_761_245_675.0 / 3.33,
            rotor: [6.09e-3, 765.58e-9, 35.0, 2e-7],
            friction: 0.1057,
            preload: 1.0,
            creep: 0.01,
        }
    }
}

/// Where the motor is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CarrierState {
    /// Time in s.
    pub t: f64,
    /// Two modal displacements, two modal velocities, rotor height, its velocity, angle, speed.
    pub y: [f64; 8],
    step: f64,
}

impl Default for CarrierState {
    fn default() -> Self {
        Self { t: 0.0, y: [0.0; 8], step: 1e-7 }
    }
}

impl Carrier {
    fn wave_number(&self) -> f64 {
        self.waves / self.radius
    }

    /// Integrates until `until` with the drive on or off (clockwise).
    pub fn run(&self, s: &mut CarrierState, until: f64, on: bool) {
        let scale = [1e-7, 1e-7, 3e-2, 3e-2, 1e-7, 1e-2, 1e-2, 1.0];
        let mut f = |t: f64, y: &[f64; 8]| self.derivative(t, y, on);
        integrate(&mut f, &mut s.t, &mut s.y, until, &mut s.step, &scale, 1e-5);
    }

    fn derivative(&self, t: f64, y: &[f64; 8], on: bool) -> [f64; 8] {
        let [w1, w2, v1, v2, z, vz, _, speed] = *y;
        let [mass, damping, stiffness] = self.modal;
        let [rotor_mass, inertia, rotor_damping, drag] = self.rotor;
        let amplitude = w1.hypot(w2).max(1e-14);
        let velocity = v1.hypot(v2).max(1e-12);
        // Sense of travel: the wave that runs clockwise leads with mode 1.
        let sense = (w1 * v2 - w2 * v1).signum();
        let crest = self.shape * amplitude;
        let edge = (z / crest).clamp(-1.0, 1.0).acos();
        let surface = self.half_thickness * self.wave_number() * self.shape * velocity * sense;
        let rotor_surface = self.radius * speed;
        let creep = self.creep * (0.05 + surface.abs());
        let points = 24;
        let (mut normal, mut along, mut modal_normal, mut modal_shear) = (0.0, 0.0, 0.0, 0.0);
        let dx = edge / f64::from(points);
        for i in 0..points {
            let x = dx * (f64::from(i) + 0.5);
            let c = x.cos();
            let pressure = self.contact * (crest * c - z).max(0.0);
            let shear = self.friction * pressure * ((surface * c - rotor_surface) / creep).tanh();
            normal += pressure;
            along += shear;
            modal_normal += pressure * c;
            modal_shear += shear * c;
        }
        // Both sides of the crest, all crests, angle to length.
        let factor = 2.0 * self.waves * dx / self.wave_number();
        let back = -self.shape * modal_normal * factor / amplitude;
        let drain = -self.half_thickness * self.wave_number() * self.shape * modal_shear * factor * sense / velocity;
        let phase = TAU * self.frequency * t;
        let (p1, p2) = if on { (self.volt * phase.cos(), self.volt * phase.sin()) } else { (0.0, 0.0) };
        [
            v1,
            v2,
            (self.force_factor * p1 + back * w1 + drain * v1 - damping * v1 - stiffness * w1) / mass,
            (self.force_factor * p2 + back * w2 + drain * v2 - damping * v2 - stiffness * w2) / mass,
            vz,
            (normal * factor - self.preload - rotor_damping * vz) / rotor_mass,
            speed,
            (self.radius * along * factor - drag * speed) / inertia,
        ]
    }

    /// The reduced motor these parameters stand for: crest speed and half-contact angle from a steady wave.
    pub fn reduced(&self, steady: &CarrierState) -> Motor {
        let amplitude = steady.y[0].hypot(steady.y[1]);
        let velocity = steady.y[2].hypot(steady.y[3]);
        let contact = self.friction * self.preload * self.radius / self.rotor[1];
        Motor {
            crest_speed: self.half_thickness * self.wave_number() * self.shape * velocity / self.radius,
            contact,
            off_friction: contact,
            viscous: self.rotor[3] / self.rotor[1],
            wave_time: 2.0 * self.modal[0] / self.modal[1],
            half_contact: (steady.y[4] / (self.shape * amplitude)).clamp(-1.0, 1.0).acos().min(PI),
            creep: self.creep * 1.05,
            exponent: 1.0,
        }
    }
}

/// Angle the reduced motor turns in `on_s` of drive and `off_s` without, from rest.
pub fn reduced_angle(motor: &Motor, on_s: f64, off_s: f64) -> f64 {
    use crate::motor::{Drive, State, step};
    let table = ContactTable::new(motor);
    let mut state = State::default();
    let dt = 1e-4;
    for (on, seconds) in [(true, on_s), (false, off_s)] {
        for _ in 0..(seconds / dt).round() as usize {
            step(motor, &table, &mut state, &Drive { on, ..Drive::default() }, dt);
        }
    }
    state.angle
}
