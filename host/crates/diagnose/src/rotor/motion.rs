//! Closed forms between two events.

#[derive(Debug, Clone, Copy)]
enum Motion {
    /// Constant acceleration.
    Linear(f64),
    /// Exponential approach, at a rate, to a speed that moves itself.
    Approach { to: f64, drift: f64, rate: f64 },
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
            Motion::Approach { to, drift, rate } => {
                let decay = decayed(rate * dt);
                let angle = to * dt + 0.5 * drift * dt * dt + (speed - to) * (1.0 - decay) / rate;
                (angle, to + drift * dt + (speed - to) * decay)
            }
        }
    }
}

/// Time constants after which a double holds nothing of what was (e⁻³⁷ is half its last digit).
const GONE_FOR_GOOD: f64 = 37.0;

/// What is left after so many time constants. Most of a run lies where nothing is: that needs no exponential.
pub(super) fn decayed(time_constants: f64) -> f64 {
    if time_constants < GONE_FOR_GOOD { (-time_constants).exp() } else { 0.0 }
}

/// How the wave's crest pulls the rotor.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pull {
    /// Sense in which the crest runs.
    pub(super) sign: f64,
    /// Its speed now in rad/s, and how fast that changes in rad/s².
    pub(super) crest: f64,
    pub(super) slope: f64,
    /// Greatest acceleration of a rotor that is slower, in rad/s².
    pub(super) acceleration: f64,
    /// How much slower a rotor is that is pulled with all of it, in rad/s.
    pub(super) band: f64,
    /// Share of it that holds back a rotor that is faster.
    pub(super) ahead: f64,
}

/// Distance from an edge of the slip band, as a share of it, within which the rotor is on the edge.
const EDGE: f64 = 1e-6;

/// Motion under the wave: towards the crest's speed with a constant torque, within the slip band in proportion to what is missing.
///
/// With x the crest's lead over the rotor in the crest's own sense, dx/dt = slope − external − a·clamp(x/band, −ahead, 1).
pub(super) fn on_piece(speed: f64, pull: &Pull, external: f64) -> Piece {
    let Pull { sign, crest, slope, acceleration, band, ahead } = *pull;
    let lead = sign * (crest - speed);
    let drift = sign * (slope - external);
    let rate = acceleration / band;
    // The lead at which the rotor would follow, were the band without edges.
    let following = drift / rate;
    let (low, high) = (-ahead * band, band);
    let beyond = |edge: f64, sense: f64| {
        let over = sense * (lead - edge);
        over > EDGE * band || (over > -EDGE * band && sense * (following - edge) > 0.0)
    };
    for (edge, sense) in [(high, 1.0), (low, -1.0)] {
        if beyond(edge, sense) {
            let torque = edge * rate;
            let closing = sense * (torque - drift);
            let duration = if closing > 0.0 { sense * (lead - edge) / closing } else { f64::INFINITY };
            return Piece { duration: duration.max(SHORTEST_S), motion: Motion::Linear(sign * torque + external) };
        }
    }
    let leaves = |edge: f64| ((lead - following) / (edge - following)).ln() / rate;
    let duration = if following > high {
        leaves(high)
    } else if following < low {
        leaves(low)
    } else {
        f64::INFINITY
    };
    let motion = Motion::Approach { to: crest - sign * following, drift: slope, rate };
    Piece { duration: duration.max(SHORTEST_S), motion }
}

/// No piece is shorter, in s.
const SHORTEST_S: f64 = 1e-9;

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
