//! A person drifting off the path: a sinusoid added to the joint angles, which the loops have to reject.
//!
//! The thesis adds a sinusoidal disturbance (section 5.5) without stating its amplitude, frequency, phase or joint. The
//! defaults here are this project's own.

use super::kinematics::JOINTS;
use std::f64::consts::TAU;

/// `amplitude · sin(2π·frequency·t + phase)` on the joints chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disturbance {
    /// Amplitude, °.
    pub amplitude_deg: f64,
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Phase at the start, °.
    pub phase_deg: f64,
    /// Which joints it moves.
    pub joints: [bool; JOINTS],
}

impl Default for Disturbance {
    fn default() -> Self {
        Self { amplitude_deg: 5.0, frequency_hz: 0.2, phase_deg: 0.0, joints: [true; JOINTS] }
    }
}

impl Disturbance {
    /// No disturbance.
    pub const NONE: Self = Self { amplitude_deg: 0.0, frequency_hz: 0.0, phase_deg: 0.0, joints: [false; JOINTS] };

    /// What it adds to a joint's angle, °.
    pub fn deg(&self, joint: usize, time_s: f64) -> f64 {
        if !self.joints[joint] {
            return 0.0;
        }
        self.amplitude_deg * (TAU * self.frequency_hz * time_s + self.phase_deg.to_radians()).sin()
    }

    /// Its largest rate, °/s.
    pub fn peak_deg_s(&self) -> f64 {
        (self.amplitude_deg * TAU * self.frequency_hz).abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_sinusoid_asked_for_on_the_joints_asked_for() {
        let quarter = Disturbance { phase_deg: 30.0, joints: [false, true, true], ..Disturbance::default() };
        assert_eq!(quarter.deg(0, 1.0), 0.0);
        assert!((quarter.deg(1, 0.0) - 2.5).abs() < 1e-12);
        // A sixth of the 5 s period on from 30° is the crest.
        assert!((quarter.deg(2, 5.0 / 6.0) - 5.0).abs() < 1e-12);
        let rate = (Disturbance::default().deg(0, 1e-4) - Disturbance::default().deg(0, -1e-4)) / 2e-4;
        assert!((rate - Disturbance::default().peak_deg_s()).abs() < 1e-6);
    }
}
