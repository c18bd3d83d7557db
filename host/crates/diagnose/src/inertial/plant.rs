//! The plant: an inertia with viscous and Coulomb friction behind an actuator, exact between samples and at every stick and slip.
//!
//! τ·ω̇ = K·(x − b) − ω − K·F·sign(ω), where x is the input after dead time, the actuator's map and a second lag, F the friction and b
//! a load, both as shares of the largest input. At rest the rotor stays while |x − b| is no more than the friction at rest.
//! Between two changes of the input x is constant or approaches its goal exponentially, so ω is a sum of exponentials; the
//! instants at which the rotor stops or breaks away are found in closed form (with a second lag: stops by bisection).

use super::angle::KEPT;
use super::data::{Data, DriveRun};

/// A number of the plant; 0 means absent but for the first two.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum P {
    /// K: speed at the largest input, in rpm.
    Gain,
    /// ln of τ in s.
    LogLag,
    /// By how much the record's input is early, in samples of the run: one or less is how loggers are written.
    Skew,
    /// Dead time in s, beyond that.
    DeadTime,
    /// Second lag in s.
    SecondLag,
    /// Coulomb friction as a share of the largest input.
    Coulomb,
    /// By how much it is larger forwards and smaller backwards, relative.
    FrictionSplit,
    /// What friction at rest has more, as a share of the largest input.
    Stiction,
    /// Load, as a share of the largest input.
    Bias,
    /// Part of the input that the actuator loses.
    DeadZone,
    /// By how much it is larger forwards, relative.
    DeadSplit,
    /// By how much the gain is larger forwards, relative.
    GainSplit,
    /// Bend b of u/(1 + (b·u)^p)^(1/p).
    Bend,
    /// By how much its power p is above 1: a bend at once, or one behind a straight beginning.
    BendPower,
    /// Share of the range over which the top is flat.
    FlatTop,
    /// Torque over the strongest order of the angle, cosine, as a share of the largest input.
    CoggingCos,
    /// The same, sine.
    CoggingSin,
    /// Torque over a second order, cosine.
    Cogging2Cos,
    /// The same, sine.
    Cogging2Sin,
    /// Share of the input's torque that goes with the strongest order of the angle, cosine.
    RippleCos,
    /// The same, sine.
    RippleSin,
}

impl P {
    /// All, in their order.
    pub const ALL: [P; COUNT] = [
        P::Gain,
        P::LogLag,
        P::Skew,
        P::DeadTime,
        P::SecondLag,
        P::Coulomb,
        P::FrictionSplit,
        P::Stiction,
        P::Bias,
        P::DeadZone,
        P::DeadSplit,
        P::GainSplit,
        P::Bend,
        P::BendPower,
        P::FlatTop,
        P::CoggingCos,
        P::CoggingSin,
        P::Cogging2Cos,
        P::Cogging2Sin,
        P::RippleCos,
        P::RippleSin,
    ];
}

/// How many numbers there are.
pub const COUNT: usize = P::RippleSin as usize + 1;

/// All numbers of a plant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Values([f64; COUNT]);

impl Values {
    /// A gain and a lag alone.
    pub fn line(gain_rpm: f64, lag_s: f64) -> Self {
        let mut v = Self([0.0; COUNT]);
        v.set(P::Gain, gain_rpm);
        v.set(P::LogLag, lag_s.ln());
        v
    }

    /// One number.
    pub fn get(&self, p: P) -> f64 {
        self.0[p as usize]
    }

    /// Sets one number.
    pub fn set(&mut self, p: P, value: f64) {
        self.0[p as usize] = value;
    }

    /// With one number changed.
    pub fn with(mut self, p: P, value: f64) -> Self {
        self.set(p, value);
        self
    }

    /// τ in s.
    pub fn lag_s(&self) -> f64 {
        self.get(P::LogLag).exp()
    }

    /// What the actuator makes of an input.
    pub fn actuated(&self, input: f64) -> f64 {
        let sign = if input < 0.0 { -1.0 } else { 1.0 };
        let zone = self.get(P::DeadZone) * (1.0 + sign * self.get(P::DeadSplit));
        let top = 1.0 - self.get(P::FlatTop);
        let x = (input.abs().min(top) - zone).max(0.0);
        sign * self.bent(x, 1.0) * (1.0 + sign * self.get(P::GainSplit))
    }

    /// A positive input bent (`side` 1) or unbent (-1); what no input is bent to is no number.
    fn bent(&self, x: f64, side: f64) -> f64 {
        let (bend, power) = (self.get(P::Bend), 1.0 + self.get(P::BendPower));
        if power == 1.0 {
            return x / (1.0 + side * bend * x);
        }
        x / (1.0 + side * (bend * x).powf(power)).powf(1.0 / power)
    }

    /// The input of which the actuator makes `x`; none where it cannot.
    pub fn input_for(&self, x: f64) -> Option<f64> {
        if x == 0.0 {
            return Some(0.0);
        }
        let sign = x.signum();
        let straight = self.bent(x.abs() / (1.0 + sign * self.get(P::GainSplit)), -1.0);
        let input = straight + self.get(P::DeadZone) * (1.0 + sign * self.get(P::DeadSplit));
        (straight >= 0.0 && input <= 1.0 - self.get(P::FlatTop)).then_some(sign * input)
    }

    /// Friction of a sense of motion, as a share of the largest input.
    pub fn friction(&self, sense: f64) -> f64 {
        self.get(P::Coulomb) * (1.0 + sense * self.get(P::FrictionSplit))
    }
}

/// What is simulated of a run.
#[derive(Debug, Clone, Default)]
pub struct Motion {
    /// Predicted speeds, one for each that is compared, in rpm.
    pub rpm: Vec<f64>,
}

/// e^(−h/τ) of the intervals that come again and again.
struct Decays {
    lags: [f64; 2],
    kept: [(f64, [f64; 2]); 4],
    next: usize,
}

impl Decays {
    fn of(&mut self, h: f64) -> [f64; 2] {
        if let Some(known) = self.kept.iter().find(|k| k.0 == h) {
            return known.1;
        }
        let value = self.lags.map(|lag| if lag > 0.0 { (-h / lag).exp() } else { 0.0 });
        self.kept[self.next] = (h, value);
        self.next = (self.next + 1) % self.kept.len();
        value
    }
}

struct State {
    /// Speed in rpm.
    speed: f64,
    /// Input behind the second lag.
    x: f64,
    /// Integral of the speed in rpm·s.
    way: f64,
}

struct Solver<'a> {
    values: &'a Values,
    lag: f64,
    second: f64,
    decays: Decays,
    /// Whether friction may hold the rotor.
    held: bool,
    /// What the angle adds to the load, and takes of the input's share.
    angle: Angle,
}

/// What a place of the angle does.
#[derive(Debug, Clone, Copy, Default)]
pub struct Angle {
    /// A torque beside the input, as a share of the largest one.
    pub torque: f64,
    /// By how much the input's torque is larger, relative.
    pub share: f64,
}

impl Angle {
    /// Of a place where the courses of the orders are these.
    pub fn of(v: &Values, wave: &[f64; 2 * KEPT]) -> Self {
        let pair = |cos: P, sin: P, j: usize| v.get(cos) * wave[2 * j] + v.get(sin) * wave[2 * j + 1];
        Self {
            torque: pair(P::CoggingCos, P::CoggingSin, 0) + pair(P::Cogging2Cos, P::Cogging2Sin, 1),
            share: pair(P::RippleCos, P::RippleSin, 0),
        }
    }
}

impl Solver<'_> {
    /// What an input leaves to move the rotor against friction.
    fn push(&self, x: f64) -> f64 {
        x * (1.0 + self.angle.share) + self.angle.torque - self.values.get(P::Bias)
    }

    /// The speed to which a motor in slip comes; where speeds are counted against the input, friction still brakes.
    fn end(&self, goal: f64, sense: f64) -> f64 {
        let v = self.values;
        let side = sense * v.get(P::Gain).signum();
        v.get(P::Gain) * (self.push(goal) - side * v.friction(side))
    }

    /// The speed after `h` in slip towards `goal`, and the way made.
    fn slip(&mut self, s: &State, goal: f64, sense: f64, h: f64, decay: [f64; 2]) -> (f64, f64) {
        let (gain, end) = (self.values.get(P::Gain), self.end(goal, sense));
        let [first, second] = decay;
        if self.second == 0.0 {
            let away = s.speed - end;
            return (end + away * first, end * h + away * self.lag * (1.0 - first));
        }
        let a = gain * (1.0 + self.angle.share) * (s.x - goal) / (1.0 - self.lag / self.second);
        let b = s.speed - end - a;
        let way = end * h + a * self.second * (1.0 - second) + b * self.lag * (1.0 - first);
        (end + a * second + b * first, way)
    }

    /// The time at which a slipping rotor stops within `h`.
    fn stop(&mut self, s: &State, goal: f64, sense: f64, h: f64) -> f64 {
        if self.second == 0.0 {
            let end = self.end(goal, sense);
            return (self.lag * ((s.speed - end) / -end).ln()).clamp(0.0, h);
        }
        let (mut low, mut high) = (0.0, h);
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            let decay = [(-middle / self.lag).exp(), (-middle / self.second).exp()];
            if self.slip(s, goal, sense, middle, decay).0 * sense > 0.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        high
    }

    /// The time for which a rotor at rest stays so within `h`, and the sense in which it then moves.
    fn rest(&self, s: &State, goal: f64, h: f64) -> (f64, f64) {
        let v = self.values;
        let sense = |x: f64| -> f64 {
            [1.0, -1.0]
                .into_iter()
                .find(|side| side * self.push(x) > v.friction(*side) + v.get(P::Stiction))
                .unwrap_or(0.0)
        };
        let x = if self.second == 0.0 { goal } else { s.x };
        let now = sense(x) * v.get(P::Gain).signum();
        if now != 0.0 {
            return (0.0, now);
        }
        let later = if self.second == 0.0 { 0.0 } else { sense(goal) };
        if later == 0.0 {
            return (h, 0.0);
        }
        let held = later * (v.friction(later) + v.get(P::Stiction)) + v.get(P::Bias) - self.angle.torque;
        let threshold = held / (1.0 + self.angle.share);
        let t = self.second * ((goal - s.x) / (goal - threshold)).ln();
        if t < h { (t.max(0.0), later * v.get(P::Gain).signum()) } else { (h, 0.0) }
    }

    /// Moves the state by `h` with the actuator's output at `goal`.
    fn advance(&mut self, s: &mut State, goal: f64, h: f64) {
        if !self.held {
            let decay = self.decays.of(h);
            self.move_on(s, goal, 0.0, h, decay);
            return;
        }
        let mut left = h;
        // Stop, rest and break-away: a handful a step at most; what is beyond would be chatter without motion.
        for _ in 0..6 {
            if left <= 0.0 {
                return;
            }
            let mut sense = s.speed.signum();
            if s.speed == 0.0 {
                let (still, towards) = self.rest(s, goal, left);
                self.approach(s, goal, still);
                left -= still;
                if towards == 0.0 || left <= 0.0 {
                    return;
                }
                sense = towards;
            }
            let decay = self.decays.of(left);
            if self.slip(s, goal, sense, left, decay).0 * sense >= 0.0 {
                self.move_on(s, goal, sense, left, decay);
                return;
            }
            let stop = self.stop(s, goal, sense, left);
            let decay = [(-stop / self.lag).exp(), if self.second > 0.0 { (-stop / self.second).exp() } else { 0.0 }];
            s.way += self.slip(s, goal, sense, stop, decay).1;
            s.speed = 0.0;
            self.approach(s, goal, stop);
            left -= stop.max(1e-12 * h);
        }
    }

    /// Slips for the whole of `h`.
    fn move_on(&mut self, s: &mut State, goal: f64, sense: f64, h: f64, decay: [f64; 2]) {
        let (speed, way) = self.slip(s, goal, sense, h, decay);
        s.speed = speed;
        s.way += way;
        s.x = if self.second == 0.0 { goal } else { goal + (s.x - goal) * decay[1] };
    }

    fn approach(&self, s: &mut State, goal: f64, h: f64) {
        s.x = if self.second == 0.0 { goal } else { goal + (s.x - goal) * (-h / self.second).exp() };
    }
}

/// Simulates a run from a speed in rpm.
pub fn simulate(run: &DriveRun, values: &Values, start_rpm: f64, unsigned: bool) -> Motion {
    let lag = values.lag_s();
    let mut second = values.get(P::SecondLag).max(0.0);
    // Equal lags have another closed form; a part in ten thousand away from it nothing is lost.
    if (second / lag - 1.0).abs() < 1e-4 {
        second = lag * 1.0001;
    }
    if second < 1e-9 {
        second = 0.0;
    }
    let kept = [(f64::NAN, [0.0; 2]); 4];
    let decays = Decays { lags: [lag, second], kept, next: 0 };
    let held = values.get(P::Coulomb) > 0.0 || values.get(P::Stiction) > 0.0;
    let mut solver = Solver { values, lag, second, decays, held, angle: Angle::default() };
    let goals: Vec<f64> = run.input.iter().map(|u| values.actuated(*u)).collect();
    let delay = values.get(P::Skew) * run.period_s + values.get(P::DeadTime);
    let n = run.time.len();
    let mut state = State { speed: start_rpm, x: goals[0], way: 0.0 };
    let mut applied = 0;
    let mut now = run.time[0];
    while applied + 1 < n && run.time[applied + 1] + delay <= now {
        applied += 1;
    }
    let mut out = Vec::with_capacity(run.rpm.len());
    let magnitude = |v: f64| if unsigned { v.abs() } else { v };
    let mut window = (0, 0.0);
    if run.windows.is_none() {
        out.push(magnitude(state.speed));
    }
    // What a step leaves of rounding is no interval.
    let least = 1e-9 * run.period_s;
    for k in 1..n {
        let until = run.time[k];
        solver.angle = run.ripple.get(k - 1).map_or(Angle::default(), |wave| Angle::of(values, wave));
        while applied + 1 < n && run.time[applied + 1] + delay < until - least {
            let change = run.time[applied + 1] + delay;
            if change - now > least {
                solver.advance(&mut state, goals[applied], rounded(change - now));
                now = change;
            }
            applied += 1;
        }
        solver.advance(&mut state, goals[applied], rounded(until - now));
        now = until;
        match &run.windows {
            None => out.push(magnitude(state.speed)),
            Some(ends) if ends.get(window.0 + 1) == Some(&k) => {
                let seconds = run.time[k] - run.time[ends[window.0]];
                out.push(magnitude((state.way - window.1) / seconds));
                window = (window.0 + 1, state.way);
            }
            Some(_) => {}
        }
    }
    Motion { rpm: out }
}

/// An interval without the last digits, which rounding of times makes differ from step to step: equal steps then have equal decays.
fn rounded(h: f64) -> f64 {
    f64::from(h as f32)
}

/// Simulates all runs.
pub fn simulate_all(data: &Data, values: &Values, starts: &[f64]) -> Vec<Motion> {
    use rayon::prelude::*;
    data.runs.par_iter().zip(starts).map(|(run, start)| simulate(run, values, *start, data.unsigned)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(input: Vec<f64>, period_s: f64) -> DriveRun {
        let n = input.len();
        DriveRun {
            id: "r".to_owned(),
            time: (0..n).map(|k| k as f64 * period_s).collect(),
            period_s,
            input,
            rpm: vec![0.0; n],
            windows: None,
            turns: vec![0.0; n],
            ripple: Vec::new(),
        }
    }

    /// The same plant in small steps: friction takes away at most the speed there is.
    fn stepped(run: &DriveRun, v: &Values) -> Vec<f64> {
        let (h, mut speed, mut x) = (1e-6, 0.0_f64, v.actuated(run.input[0]));
        let mut out = vec![0.0];
        for k in 1..run.time.len() {
            for j in 0..(run.period_s / h).round() as usize {
                let t = run.time[k - 1] + j as f64 * h - v.get(P::DeadTime) - v.get(P::Skew) * run.period_s;
                let at = ((t / run.period_s + 1e-9).floor().max(0.0) as usize).min(k - 1);
                let goal = v.actuated(run.input[at]);
                let lag = v.get(P::SecondLag);
                x = if lag > 0.0 { x + h / lag * (goal - x) } else { goal };
                let angle = run.ripple.get(k - 1).map_or(Angle::default(), |wave| Angle::of(v, wave));
                let push = x * (1.0 + angle.share) + angle.torque - v.get(P::Bias);
                let held = v.get(P::Coulomb) + v.get(P::Stiction);
                if speed == 0.0 && push.abs() <= held {
                    continue;
                }
                let sense = if speed == 0.0 { push.signum() } else { speed.signum() };
                let moved = speed + h / v.lag_s() * (v.get(P::Gain) * (push - sense * v.get(P::Coulomb)) - speed);
                speed = if speed != 0.0 && moved * sense <= 0.0 { 0.0 } else { moved };
            }
            out.push(speed);
        }
        out
    }

    /// Fails if the inverse leaves out a part of the actuator, or gives an input beyond its reach.
    #[test]
    fn an_actuator_is_inverted() {
        let v = Values::line(300.0, 0.02).with(P::DeadZone, 0.15).with(P::DeadSplit, 0.2).with(P::Bend, 1.5);
        for v in [v.with(P::GainSplit, -0.1), v.with(P::BendPower, 1.3)] {
            for u in [-1.0, -0.6, -0.2, 0.3, 0.9] {
                let back = v.input_for(v.actuated(u)).expect("it came from an input");
                assert!((back - u).abs() < 1e-9, "{u}: {back}");
            }
            assert_eq!(v.input_for(1.01 * v.actuated(1.0)), None);
            assert_eq!(v.input_for(2.0), None);
        }
    }

    /// Fails if an instant of stop or break-away is missed, or a lag, a dead time or a load acts at another place.
    #[test]
    fn stick_and_slip_are_those_of_small_steps() {
        let input: Vec<f64> =
            (0..120).map(|k| (0.11 * f64::from(k)).sin() * if k % 7 < 2 { 0.2 } else { 0.9 }).collect();
        let ripple = (0..120).map(|k| [0.9, 1.7, 2.3, 0.4].map(|by| (by * f64::from(k)).sin())).collect();
        let run = DriveRun { ripple, ..run(input, 4e-3) };
        let plain = Values::line(300.0, 0.02).with(P::Coulomb, 0.2);
        for v in [
            plain,
            plain.with(P::Stiction, 0.1).with(P::Bias, 0.05),
            plain.with(P::SecondLag, 0.006).with(P::DeadTime, 0.0102),
            Values::line(300.0, 0.02).with(P::DeadZone, 0.15).with(P::Bend, 1.5).with(P::Skew, 0.5),
            plain.with(P::CoggingCos, 0.15).with(P::Cogging2Sin, -0.1),
            plain.with(P::RippleSin, 0.3).with(P::SecondLag, 0.006),
        ] {
            let exact = simulate(&run, &v, 0.0, false).rpm;
            for (k, (a, b)) in exact.iter().zip(stepped(&run, &v)).enumerate() {
                assert!((a - b).abs() < 0.2, "{v:?}: {a} and {b} rpm at sample {k}");
            }
        }
    }
}
