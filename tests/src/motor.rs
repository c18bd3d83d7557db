//! The motor of the generator: a rotor on a stator whose wave comes and goes with the PWM.
//!
//! State: wave amplitude (relative to its steady value), rotor speed, rotor angle. The contact is an integral over the
//! wave crest: pressure above the contact line, friction towards the local surface velocity, smoothed over a creep
//! velocity. The integral is tabulated once a motor over the slip ratio; the carrier-resolution equations of
//! [`crate::carrier`] check the table.

use std::f64::consts::TAU;

/// Parameters of the generator's motor.
#[derive(Debug, Clone, PartialEq)]
pub struct Motor {
    /// Speed of the wave's crest on the rotor in rad/s, steady.
    pub crest_speed: f64,
    /// Largest contact torque over inertia in rad/s².
    pub contact: f64,
    /// Friction with the wave gone over inertia in rad/s².
    pub off_friction: f64,
    /// Viscous damping over inertia in 1/s.
    pub viscous: f64,
    /// Build-up time of the wave in s (2·Ms/Cs of the stator).
    pub wave_time: f64,
    /// Half contact angle of a crest in rad (half-contact length times wave number).
    pub half_contact: f64,
    /// Creep velocity relative to the crest speed.
    pub creep: f64,
    /// Exponent of pressure over penetration.
    pub exponent: f64,
}

impl Default for Motor {
    fn default() -> Self {
        Self {
            crest_speed: 3.75,
            contact: 1890.0,
            off_friction: 1890.0,
            viscous: 0.26,
            wave_time: 0.228e-3,
            half_contact: 0.3,
            creep: 0.01,
            exponent: 1.0,
        }
    }
}

/// Contact torque as a fraction of the largest, over the ratio of rotor speed to crest speed.
#[derive(Debug, Clone)]
pub struct ContactTable {
    low: f64,
    step: f64,
    values: Vec<f64>,
}

impl ContactTable {
    /// Integrates the contact for one motor.
    pub fn new(m: &Motor) -> Self {
        let (low, high, n) = (-1.0, 2.0, 1501);
        let step = (high - low) / (n - 1) as f64;
        let points = 200;
        let values = (0..n)
            .map(|i| {
                let ratio = low + step * i as f64;
                let (mut torque, mut load) = (0.0, 0.0);
                for k in 0..points {
                    let x = m.half_contact * (k as f64 + 0.5) / points as f64;
                    let pressure = (x.cos() - m.half_contact.cos()).max(0.0).powf(m.exponent);
                    torque += pressure * ((x.cos() - ratio) / m.creep).tanh();
                    load += pressure;
                }
                torque / load
            })
            .collect();
        Self { low, step, values }
    }

    /// Torque fraction at a ratio of rotor speed to crest speed.
    pub fn at(&self, ratio: f64) -> f64 {
        let x = ((ratio - self.low) / self.step).clamp(0.0, (self.values.len() - 1) as f64 - 1e-9);
        let i = x as usize;
        let f = x - i as f64;
        self.values[i] * (1.0 - f) + self.values[i + 1] * f
    }
}

/// What changes the drive at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drive {
    /// Wave driven or not.
    pub on: bool,
    /// Direction.
    pub sign: f64,
    /// Factor on the crest speed.
    pub gain: f64,
    /// Factor on the contact torque.
    pub grip: f64,
    /// Extra friction over inertia in rad/s².
    pub drag: f64,
    /// Load torque over inertia in rad/s² (signed).
    pub load: f64,
    /// Factor on the friction with the wave gone.
    pub brake: f64,
}

impl Default for Drive {
    fn default() -> Self {
        Self { on: false, sign: 1.0, gain: 1.0, grip: 1.0, drag: 0.0, load: 0.0, brake: 1.0 }
    }
}

/// State of the rotor.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct State {
    /// Wave amplitude relative to its steady value.
    pub wave: f64,
    /// Angle in rad.
    pub angle: f64,
    /// Speed in rad/s.
    pub speed: f64,
}

/// One step of `dt` seconds (0.1 ms or less).
pub fn step(m: &Motor, table: &ContactTable, s: &mut State, d: &Drive, dt: f64) {
    let goal = if d.on { 1.0 } else { 0.0 };
    let wave_middle = goal + (s.wave - goal) * (-0.5 * dt / m.wave_time).exp();
    let acceleration = |speed: f64| -> f64 {
        let crest = m.crest_speed * d.gain * wave_middle;
        let mut a = -m.viscous * speed + d.load;
        if crest > 0.02 * m.crest_speed {
            a += d.sign * m.contact * d.grip * table.at(d.sign * speed / crest);
        }
        a
    };
    let crest = m.crest_speed * d.gain * wave_middle;
    let mut friction = d.drag;
    if crest <= 0.02 * m.crest_speed {
        friction += m.off_friction * d.brake;
    }
    let a0 = acceleration(s.speed);
    let half = s.speed + 0.5 * dt * a0;
    let mut a = acceleration(half);
    // The slope near the crest speed is steep: damp the step by it.
    let slope = (acceleration(s.speed + 0.02) - acceleration(s.speed - 0.02)) / 0.04;
    if slope * dt < -0.5 {
        a = a0 / (1.0 - 0.5 * slope * dt) * 1.0;
    }
    let free = s.speed + dt * a;
    let limit = friction * dt;
    let next = if friction > 0.0 {
        if free.abs() <= limit && (s.speed == 0.0 || free * s.speed <= 0.0 || s.speed.abs() <= limit) {
            0.0
        } else {
            let sense = if s.speed != 0.0 { s.speed.signum() } else { free.signum() };
            let moved = free - sense * limit;
            if moved * sense < 0.0 && s.speed != 0.0 { 0.0 } else { moved }
        }
    } else {
        free
    };
    s.angle += 0.5 * (s.speed + next) * dt;
    s.speed = next;
    s.wave = goal + (s.wave - goal) * (-dt / m.wave_time).exp();
}

/// Revolutions a minute.
pub fn rpm(speed: f64) -> f64 {
    speed * 60.0 / TAU
}
