//! A motor: its stator, its contact and its rotor, drawn round the thesis's 30 mm motor.

use crate::profile::random::Dice;
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

/// Friction of the 30 mm motor's contact in N m: µ 0.1057, preload 1 N, radius 13.675 mm (thesis, appendix A.4).
const FRICTION_NM: f64 = 0.1057 * 0.013_675;
/// Inertia of its rotor in kg m² (thesis, appendix A.4).
const INERTIA: f64 = 765.58e-9;
/// Its drive's frequency in Hz (thesis, appendix A.4).
const DRIVE_HZ: f64 = 45e3;

/// Parameters of one motor.
#[derive(Debug, Clone, PartialEq)]
pub struct Motor {
    /// Speed of the wave's surface under steady drive in rad/s: the free speed.
    pub full: f64,
    /// Time constant of the modes' amplitudes in s.
    pub wave_s: f64,
    /// How far the drive's frequency lies above the modes' mean, in half-widths of the resonance.
    pub detuning: f64,
    /// Distance between the two modes' frequencies, in the same unit.
    pub split: f64,
    /// Error of the quadrature between the two supplies in rad.
    pub quadrature: f64,
    /// Friction of the contact with the wave over inertia in rad/s².
    pub contact: f64,
    /// Friction of the contact without it, over inertia in rad/s².
    pub brake: f64,
    /// Slip over the free speed at which half of the friction pulls.
    pub softness: f64,
    /// Way over which a bristle bends before it slips, in rad.
    pub bend: f64,
    /// Wave amplitude at which the contact is halfway between the two frictions.
    pub lift: f64,
    /// Viscous damping over inertia in 1/s.
    pub viscous: f64,
}

impl Motor {
    /// Draws one: 10–100 rpm, frictions and inertias of a tenth to ten times the 30 mm motor's, waves of 0.2–5 ms.
    pub fn draw(dice: &mut Dice) -> Self {
        let full = dice.decade(10.0, 100.0) * TAU / 60.0;
        let mut contact = FRICTION_NM / INERTIA;
        for _ in 0..60 {
            contact = FRICTION_NM * dice.decade(0.1, 10.0) / (INERTIA * dice.decade(0.1, 10.0));
            // A slower rotor than 14 ms adds up the pulses of a PWM period of 12.5 ms; a faster one than 0.2 ms is its wave.
            if (0.2e-3..14e-3).contains(&(full / contact)) {
                break;
            }
        }
        contact = contact.clamp(full / 14e-3, full / 0.2e-3);
        let held = match dice.whole(0, 9) {
            // Coasting: the rotor hardly touches what does not move.
            0 => dice.decade(0.005, 0.05),
            1..=3 => dice.decade(0.08, 0.6),
            // Clamped by the same preload as drives it.
            _ => dice.even(0.65, 1.15),
        };
        Self {
            full,
            // An amplitude rises from 10 to 90 % in ln 9 = 2.2 time constants.
            wave_s: dice.decade(0.2e-3, 5e-3) / 9f64.ln(),
            detuning: dice.even(0.0, 0.7),
            split: dice.even(-0.15, 0.15),
            quadrature: dice.even(-0.08, 0.08),
            contact,
            brake: contact * held,
            softness: dice.decade(0.01, 0.08),
            // 0.4 to 2.7 µm at the 30 mm motor's radius: what asperities bend by.
            bend: dice.decade(0.3e-4, 2e-4),
            lift: dice.even(0.05, 0.3),
            viscous: dice.decade(0.05, 3.0),
        }
    }

    /// The numbers, for the sealed file.
    pub fn numbers(&self) -> BTreeMap<String, f64> {
        [
            ("full_rpm", self.full * 60.0 / TAU),
            ("rise_s", self.full / self.contact),
            ("fall_s", self.full / self.brake),
            ("wave_10_90_s", self.wave_s * 9f64.ln()),
            ("quality", PI * DRIVE_HZ * self.wave_s),
            ("detuning_half_widths", self.detuning),
            ("split_half_widths", self.split),
            ("quadrature_error_rad", self.quadrature),
            ("softness", self.softness),
            ("bend_rad", self.bend),
            ("lift", self.lift),
            ("viscous_1_s", self.viscous),
        ]
        .map(|(k, v)| (k.to_owned(), v))
        .into()
    }

    /// How many of its own parameters [`Self::nudged`] changes.
    pub const PARAMETERS: usize = 5;

    /// The motor with one of its own parameters a little changed, for the linear refit: free speed, friction, friction without a
    /// wave, softness, damping. Little enough to be linear, enough to stand out of rounding.
    pub fn nudged(&self, k: usize) -> Self {
        let mut m = self.clone();
        match k {
            0 => m.full *= 1.005,
            1 => m.contact *= 1.03,
            2 => m.brake *= 1.03,
            3 => m.softness *= 1.1,
            _ => m.viscous += 0.3,
        }
        m
    }

    /// Detuning beyond its own at which the wave is weaker by the share `less`.
    pub fn detuned_for(&self, less: f64) -> f64 {
        let x = self.detuning;
        ((1.0 + x * x) / (1.0 - less.clamp(0.0, 0.95)).powi(2) - 1.0).sqrt() - x
    }

    /// Steps in a quarter of a millisecond: 50 µs where the rotor takes a millisecond to its speed, 25 µs below.
    pub fn steps(&self) -> usize {
        if self.full / self.contact.max(self.brake) > 1e-3 { 5 } else { 10 }
    }
}
