//! Closed forms between two events.

#[derive(Debug, Clone, Copy)]
enum Motion {
    /// Constant acceleration.
    Linear(f64),
    /// Exponential approach to a speed at a rate.
    Approach { to: f64, rate: f64 },
}

/// A stretch of motion in closed form.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece {
    /// How long it holds, in s.
    pub(super) duration: f64,
    motion: Motion,
}

impl Piece {
    /// Angle gained and speed after `dt`, from `speed`.
    pub(super) fn at(&self, speed: f64, dt: f64) -> (f64, f64) {
        let dt = dt.min(self.duration);
        match self.motion {
            Motion::Linear(a) => {
                let w =
                    if dt >= self.duration && a != 0.0 && (speed + a * dt).abs() < 1e-7 { 0.0 } else { speed + a * dt };
                (speed * dt + 0.5 * a * dt * dt, w)
            }
            Motion::Approach { to, rate } => {
                let decay = (-rate * dt).exp();
                (to * dt + (speed - to) * (1.0 - decay) / rate, to + (speed - to) * decay)
            }
        }
    }
}

/// Motion with the drive on: towards the wave's speed with a constant torque, within the slip band in proportion.
pub(super) fn on_piece(speed: f64, target: f64, acceleration: f64, band: f64, external: f64) -> Piece {
    let lag = target - speed;
    let forever = f64::INFINITY;
    if lag.abs() > band * (1.0 + 1e-9) {
        let sense = lag.signum();
        let a = sense * acceleration + external;
        let closing = a * sense;
        let duration = if closing > 0.0 { (lag.abs() - band) / closing } else { forever };
        Piece { duration: duration.max(1e-9), motion: Motion::Linear(a) }
    } else {
        let rate = acceleration / band;
        let to = target + external.clamp(-acceleration, acceleration) / rate;
        Piece { duration: forever, motion: Motion::Approach { to, rate } }
    }
}

/// Motion without a wave: Coulomb friction brakes.
pub(super) fn off_piece(speed: f64, brake: f64, external: f64) -> Piece {
    if speed.abs() < 1e-9 {
        if external.abs() <= brake {
            return Piece { duration: f64::INFINITY, motion: Motion::Linear(0.0) };
        }
        return Piece { duration: f64::INFINITY, motion: Motion::Linear(external - external.signum() * brake) };
    }
    let a = external - speed.signum() * brake;
    let duration = if a * speed < 0.0 { -speed / a } else { f64::INFINITY };
    Piece { duration, motion: Motion::Linear(a) }
}
