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
    /// Share of it that half the band gives: one half where the torque goes with the slip.
    pub(super) half_band_torque: f64,
    /// Share of it that holds back a rotor that is faster.
    pub(super) ahead: f64,
}

/// Distance from a corner of the torque's course, as a share of the slip band, within which the rotor is on the corner.
const EDGE: f64 = 1e-6;

impl Pull {
    /// Corners of the torque's course: how far the crest leads there as a share of the slip band, and the share of the torque.
    ///
    /// The course is straight from none to [`Self::half_band_torque`] and from there to all of it, and odd down to `-ahead`.
    fn corners(&self) -> ([(f64, f64); 4], usize) {
        let half = self.half_band_torque;
        let held_at =
            if self.ahead <= half { 0.5 * self.ahead / half } else { 0.5 + 0.5 * (self.ahead - half) / (1.0 - half) };
        let (held, whole) = ((-held_at, -self.ahead), (1.0, 1.0));
        if half == 0.5 {
            ([held, whole, whole, whole], 2)
        } else if self.ahead <= half {
            ([held, (0.5, half), whole, whole], 3)
        } else {
            ([held, (-0.5, -half), (0.5, half), whole], 4)
        }
    }
}

/// Motion under the wave: towards the crest's speed with a constant torque, within the slip band with less the nearer it is.
///
/// With x the crest's lead over the rotor in the crest's own sense, dx/dt = slope − external − a·T(x/band), T as [`Pull::corners`] has it.
pub(super) fn on_piece(speed: f64, pull: &Pull, external: f64) -> Piece {
    let Pull { sign, crest, slope, acceleration, band, .. } = *pull;
    let lead = sign * (crest - speed);
    let drift = sign * (slope - external);
    let (corners, count) = pull.corners();
    let corners = &corners[..count];
    let beyond = |&&(at, torque): &&(f64, f64)| {
        let over = lead - at * band;
        over > EDGE * band || (over > -EDGE * band && drift > torque * acceleration)
    };
    let passed = corners.iter().take_while(beyond).count();
    let (from, to) = match passed {
        0 => (None, Some(corners[0])),
        n if n == count => (Some(corners[n - 1]), None),
        n => (Some(corners[n - 1]), Some(corners[n])),
    };
    let (Some(low), Some(high)) = (from, to) else {
        let (at, torque) = from.or(to).unwrap_or((0.0, 0.0));
        let closing = drift - torque * acceleration;
        let way = at * band - lead;
        let duration = if closing * way > 0.0 { way / closing } else { f64::INFINITY };
        let motion = Motion::Linear(sign * torque * acceleration + external);
        return Piece { duration: duration.max(SHORTEST_S), motion };
    };
    let rate = acceleration * (high.1 - low.1) / ((high.0 - low.0) * band);
    // The lead at which the rotor would follow, were this part without ends.
    let following = low.0 * band + (drift - low.1 * acceleration) / rate;
    let leaves = |at: f64| ((lead - following) / (at * band - following)).ln() / rate;
    let duration = if following > high.0 * band {
        leaves(high.0)
    } else if following < low.0 * band {
        leaves(low.0)
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the equation in steps of a microsecond, from far behind the crest and from far before it, of a contact that hardens and of one that
    /// gives way; fails if a corner of the torque's course is passed over, or taken for one with another torque.
    #[test]
    fn the_pieces_follow_the_torque_over_the_slip() {
        for (half_band_torque, ahead) in [(0.5, 0.7), (0.2, 0.1), (0.2, 0.7), (0.7, 0.4), (0.7, 1.5)] {
            let pull =
                Pull { sign: 1.0, crest: 4.0, slope: 30.0, acceleration: 2e3, band: 2.0, half_band_torque, ahead };
            let share = |x: f64| {
                let whole = |x: f64| {
                    let half = half_band_torque;
                    if x < 0.5 { 2.0 * half * x } else { half + (x - 0.5) * 2.0 * (1.0 - half) }
                };
                (whole(x.abs()) * x.signum()).clamp(-ahead, 1.0)
            };
            for external in [-300.0, 0.0] {
                for start in [0.0, 12.0] {
                    let (mut speed, mut angle, mut t) = (start, 0.0, 0.0);
                    let (mut by_steps, mut turned) = (start, 0.0);
                    let crest = |t: f64| 4.0 + 30.0 * t;
                    while t < 5e-3 {
                        let piece = on_piece(speed, &Pull { crest: crest(t), ..pull }, external);
                        let dt = piece.duration.min(5e-3 - t);
                        let (way, then) = piece.at(speed, dt);
                        (angle, speed, t) = (angle + way, then, t + dt);
                    }
                    for k in 0..5_000 {
                        let at = (f64::from(k) + 0.5) * 1e-6;
                        let slope = |speed: f64| 2e3 * share((crest(at) - speed) / 2.0) + external;
                        let middle = by_steps + 0.5e-6 * slope(by_steps);
                        turned += 1e-6 * middle;
                        by_steps += 1e-6 * slope(middle);
                    }
                    assert!((speed - by_steps).abs() < 2e-4, "{half_band_torque} {ahead} {start}: {speed}, {by_steps}");
                    assert!((angle - turned).abs() < 1e-6, "{half_band_torque} {ahead} {start}: {angle}, {turned}");
                }
            }
        }
    }
}
