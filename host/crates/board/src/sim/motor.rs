//! The seam to a motor, and the simple motor the board has when no other is given.

use twum_shared::Direction;

/// A motor with its rotor, as the simulated board drives it: the wave on or off, one direction.
pub trait SimulatedMotor {
    /// Moves on by `dt_s` (at most 50 µs) under constant drive and gives the rotor's angle, rad, positive clockwise.
    fn advance(&mut self, dt_s: f64, drive_on: bool, direction: Direction) -> f64;

    /// The duty and the period (s) of the PWM, told before the motor moves on.
    fn pwm(&mut self, _duty: f64, _period_s: f64) {}

    /// The driver board moves the rotor by so much, rad: a microstep in its text mode.
    fn nudge(&mut self, angle_rad: f64);
}

/// A rotor that approaches its speed exponentially while the wave is on, and is braked by constant friction while it is
/// off. Full speed and times are those of the 30 mm PCBMotor (35 rpm, about 10 ms to start, a few ms to stop).
#[derive(Clone, Debug)]
pub struct FirstOrderMotor {
    /// Speed under full drive, rad/s.
    pub full_speed_rad_s: f64,
    /// Time constant of starting, s.
    pub rise_s: f64,
    /// Deceleration by friction with the wave off, rad/s².
    pub braking_rad_s2: f64,
    /// Speed ripple twice a turn, as a fraction.
    pub ripple: f64,
    /// Whether the rotor is held.
    pub stuck: bool,
    angle_rad: f64,
    speed_rad_s: f64,
}

impl Default for FirstOrderMotor {
    fn default() -> Self {
        Self {
            full_speed_rad_s: 35.0 * std::f64::consts::TAU / 60.0,
            rise_s: 0.006,
            braking_rad_s2: 900.0,
            ripple: 0.12,
            stuck: false,
            angle_rad: 0.0,
            speed_rad_s: 0.0,
        }
    }
}

impl FirstOrderMotor {
    /// A motor whose rotor stands at `angle_rad`.
    pub fn at(angle_rad: f64) -> Self {
        Self { angle_rad, ..Self::default() }
    }
}

impl SimulatedMotor for FirstOrderMotor {
    fn advance(&mut self, dt_s: f64, drive_on: bool, direction: Direction) -> f64 {
        if self.stuck {
            self.speed_rad_s = 0.0;
            return self.angle_rad;
        }
        let before = self.speed_rad_s;
        if drive_on {
            let ripple = 1.0 + self.ripple * (2.0 * self.angle_rad).cos();
            let wanted = self.full_speed_rad_s * ripple * f64::from(direction.sign());
            self.speed_rad_s = wanted + (before - wanted) * (-dt_s / self.rise_s).exp();
        } else {
            let braked = (before.abs() - self.braking_rad_s2 * dt_s).max(0.0);
            self.speed_rad_s = braked.copysign(before);
        }
        self.angle_rad += 0.5 * (before + self.speed_rad_s) * dt_s;
        self.angle_rad
    }

    fn nudge(&mut self, angle_rad: f64) {
        if !self.stuck {
            self.angle_rad += angle_rad;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_reaches_its_speed_and_friction_stops_it() {
        let mut motor = FirstOrderMotor { ripple: 0.0, ..FirstOrderMotor::default() };
        let mut angle = 0.0;
        for _ in 0..20_000 {
            angle = motor.advance(50e-6, true, Direction::Ccw);
        }
        // A second of driving: full speed less the angle lost in the exponential start.
        let expected = -motor.full_speed_rad_s * (1.0 - motor.rise_s);
        assert!((angle - expected).abs() < 1e-3, "{angle} against {expected}");
        for _ in 0..200 {
            motor.advance(50e-6, false, Direction::Ccw);
        }
        assert_eq!(motor.speed_rad_s, 0.0);
    }
}
