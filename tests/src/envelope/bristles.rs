//! The rotor on the bristles of the contact.
//!
//! A bristle of bend y (1: it slips) follows ẏ = (v − |v| y)/bend − r g y, v being the surface's speed beyond the rotor's: Dahl's model,
//! and the second term what travelling crests add, which let go of bristles at a rate r as far as there is a wave (g). In steady
//! slip y = v/(|v| + r·bend): the torque rises with the slip and saturates, softly by r. Without a wave nothing lets go: the rotor
//! sticks. Wave and none differ in friction by g = a²/(a² + lift²) of the amplitude a.

use super::motor::Motor;

/// What holds and drives a rotor for a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grip {
    /// Friction with the wave over inertia in rad/s².
    pub contact: f64,
    /// Friction without it.
    pub brake: f64,
    /// Rate at which crests let go of bristles in 1/s.
    pub renewal: f64,
    /// Way to slipping in rad.
    pub bend: f64,
    /// Square of the amplitude at which the two frictions are even.
    pub lift: f64,
    /// Viscous damping in 1/s.
    pub viscous: f64,
    /// Dry friction against the housing over inertia in rad/s².
    pub drag: f64,
    /// Torque from outside over inertia in rad/s².
    pub load: f64,
}

impl Grip {
    /// A motor's own.
    pub fn of(motor: &Motor) -> Self {
        Self {
            contact: motor.contact,
            brake: motor.brake,
            renewal: motor.softness * motor.full / motor.bend,
            bend: motor.bend,
            lift: motor.lift * motor.lift,
            viscous: motor.viscous,
            drag: 0.0,
            load: 0.0,
        }
    }
}

/// State of the rotor.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rotor {
    /// Turned angle in rad.
    pub angle: f64,
    /// Speed in rad/s.
    pub speed: f64,
    /// Bend of the bristles, 1 where they slip.
    pub bend: f64,
}

impl Rotor {
    /// One step of `dt` s under a surface of `speed` rad/s and relative `amplitude`, backward in time: stable however stiff.
    #[inline]
    pub fn step(&mut self, grip: &Grip, speed: f64, amplitude: f64, dt: f64) {
        let wave = amplitude * amplitude;
        let share = wave / (wave + grip.lift);
        let friction = grip.brake + (grip.contact - grip.brake) * share;
        let slip = (speed - self.speed).abs();
        // Bend at the end of the step: bent + follow·(speed − the rotor's speed then).
        let slower = 1.0 / (1.0 + dt * (slip / grip.bend + grip.renewal * share));
        let (bent, follow) = (self.bend * slower, dt / grip.bend * slower);
        let free = (self.speed + dt * (friction * (bent + follow * speed) + grip.load))
            / (1.0 + dt * (friction * follow + grip.viscous));
        self.bend = (bent + follow * (speed - free)).clamp(-1.0, 1.0);
        let before = self.speed;
        self.speed = free.signum() * (free.abs() - grip.drag * dt).max(0.0);
        self.angle += 0.5 * (before + self.speed) * dt;
    }
}
