//! The plant: an inertia with viscous and Coulomb friction behind an actuator, exact between samples and at every stick and slip.
//!
//! τ·ω̇ = K·(x − b) − ω − K·F·sign(ω), where x is the input after dead time, the actuator's map and a second lag, F the friction and b
//! a load, both as shares of the largest input. At rest the rotor stays while |x − b| is no more than the friction at rest.
//! Between two changes of the input x is constant or approaches its goal exponentially, so ω is a sum of exponentials; the
//! instants at which the rotor stops or breaks away are found in closed form (with a second lag: stops by bisection). What a load on an
//! elastic coupling adds is exact too but where friction or a second lag bend the course of an exponential.

use super::aside::Aside;
use super::data::{Data, DriveRun};
use super::swing::Swing;
use super::values::{P, Values};

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
    /// What an elastic coupling adds to both.
    swing: Option<Swing>,
}

impl State {
    /// The speed becomes another one in `h`.
    fn change(&mut self, h: f64, speed: f64) {
        if let Some(swing) = self.swing.as_mut().filter(|_| h > 0.0) {
            swing.advance(h, speed - self.speed);
        }
        self.speed = speed;
    }

    /// Speed in rpm and way in rpm·s that the sensor sees.
    fn seen(&self) -> (f64, f64) {
        let swing = self.swing.as_ref();
        swing.map_or((self.speed, self.way), |s| (self.speed + s.rpm(), self.way + s.way(self.speed)))
    }
}

struct Solver<'a> {
    values: &'a Values,
    lag: f64,
    second: f64,
    decays: Decays,
    /// Whether friction may hold the rotor.
    held: bool,
    /// What acts beside the input.
    aside: Aside,
}

/// Friction of a slipping rotor over a band of speeds, in which it changes evenly with the speed.
#[derive(Clone, Copy)]
struct Drag {
    /// What it would be at no speed, as a share of the largest input.
    at_rest: f64,
    /// By how much the speed brakes, as a multiple of the viscous friction: less than one where the friction falls.
    slope: f64,
    /// The band, in rpm of the sense of motion.
    band: (f64, f64),
}

impl Solver<'_> {
    /// What an input leaves to move the rotor against friction.
    fn push(&self, x: f64) -> f64 {
        x * (1.0 + self.aside.share) + self.aside.torque - self.values.get(P::Bias)
    }

    /// The friction around a speed; where speeds are counted against the input, it still brakes.
    fn drag(&self, speed: f64, sense: f64) -> Drag {
        let v = self.values;
        let friction = v.friction(sense * v.get(P::Gain).signum());
        let (more, fades) = (v.get(P::Stiction), v.get(P::StribeckSpeed));
        let edge = fades * v.get(P::Gain).abs();
        if speed.abs() >= edge || more == 0.0 {
            return Drag { at_rest: friction, slope: 1.0, band: (if more == 0.0 { 0.0 } else { edge }, f64::INFINITY) };
        }
        let slope = 1.0 - more / fades;
        // A slope of none has another closed form; a part in a million away from it nothing is lost.
        let slope = if slope.abs() < 1e-6 { 1e-6 } else { slope };
        Drag { at_rest: friction + more, slope, band: (0.0, edge) }
    }

    /// The speed after `h` in slip towards `goal`, and the way made.
    fn slip(&self, s: &State, goal: f64, sense: f64, h: f64, decay: [f64; 2], drag: Drag) -> (f64, f64) {
        let gain = self.values.get(P::Gain);
        let end = gain * (self.push(goal) - sense * gain.signum() * drag.at_rest) / drag.slope;
        let lag = self.lag / drag.slope;
        let [first, second] = [if drag.slope == 1.0 { decay[0] } else { (-h / lag).exp() }, decay[1]];
        if self.second == 0.0 {
            let away = s.speed - end;
            return (end + away * first, end * h + away * lag * (1.0 - first));
        }
        let a = gain * (1.0 + self.aside.share) * (s.x - goal) / (drag.slope - self.lag / self.second);
        let b = s.speed - end - a;
        let way = end * h + a * self.second * (1.0 - second) + b * lag * (1.0 - first);
        (end + a * second + b * first, way)
    }

    /// The time within `h` at which a slipping rotor comes to a speed.
    fn reaches(&self, level: f64, s: &State, goal: f64, sense: f64, h: f64, drag: Drag) -> f64 {
        if self.second == 0.0 && level == 0.0 && drag.slope == 1.0 {
            let end =
                self.values.get(P::Gain) * self.push(goal) - sense * self.values.get(P::Gain).abs() * drag.at_rest;
            return (self.lag * ((s.speed - end) / -end).ln()).clamp(0.0, h);
        }
        let rises = level > s.speed * sense;
        let (mut low, mut high) = (0.0, h);
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            let speed = self.slip(s, goal, sense, middle, self.decay(middle), drag).0 * sense;
            if (speed < level) == rises {
                low = middle;
            } else {
                high = middle;
            }
        }
        high
    }

    fn decay(&self, h: f64) -> [f64; 2] {
        self.decays.lags.map(|lag| if lag > 0.0 { (-h / lag).exp() } else { 0.0 })
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
        let held = later * (v.friction(later) + v.get(P::Stiction)) + v.get(P::Bias) - self.aside.torque;
        let threshold = held / (1.0 + self.aside.share);
        let t = self.second * ((goal - s.x) / (goal - threshold)).ln();
        if t < h { (t.max(0.0), later * v.get(P::Gain).signum()) } else { (h, 0.0) }
    }

    /// Moves the state by `h` with the actuator's output at `goal`.
    fn advance(&mut self, s: &mut State, goal: f64, h: f64) {
        if !self.held {
            let decay = self.decays.of(h);
            let free = Drag { at_rest: 0.0, slope: 1.0, band: (0.0, f64::INFINITY) };
            self.move_on(s, goal, 0.0, h, decay, free);
            return;
        }
        let mut left = h;
        // Stop, rest, break-away and a speed at which the friction changes: a handful a step at most; beyond would be chatter without motion.
        for _ in 0..8 {
            if left <= 0.0 {
                return;
            }
            let mut sense = s.speed.signum();
            if s.speed == 0.0 {
                let (still, towards) = self.rest(s, goal, left);
                self.approach(s, goal, still);
                s.change(still, 0.0);
                left -= still;
                if towards == 0.0 || left <= 0.0 {
                    return;
                }
                sense = towards;
            }
            let drag = self.drag(s.speed, sense);
            let decay = self.decays.of(left);
            let speed = self.slip(s, goal, sense, left, decay, drag).0 * sense;
            if (drag.band.0..=drag.band.1).contains(&speed) {
                self.move_on(s, goal, sense, left, decay, drag);
                return;
            }
            let level = if speed > drag.band.1 { drag.band.1 } else { drag.band.0 };
            let until = self.reaches(level, s, goal, sense, left, drag);
            s.way += self.slip(s, goal, sense, until, self.decay(until), drag).1;
            // A hair within the band that is entered.
            s.change(until, if level == drag.band.1 { sense * level } else { sense * level * (1.0 - 1e-12) });
            self.approach(s, goal, until);
            left -= until.max(1e-12 * h);
        }
    }

    /// Slips for the whole of `h`.
    fn move_on(&self, s: &mut State, goal: f64, sense: f64, h: f64, decay: [f64; 2], drag: Drag) {
        let (speed, way) = self.slip(s, goal, sense, h, decay, drag);
        s.change(h, speed);
        s.way += way;
        s.x = if self.second == 0.0 { goal } else { goal + (s.x - goal) * decay[1] };
    }

    fn approach(&self, s: &mut State, goal: f64, h: f64) {
        s.x = if self.second == 0.0 { goal } else { goal + (s.x - goal) * (-h / self.second).exp() };
    }
}

/// What the actuator makes of the inputs of a run.
pub fn goals(run: &DriveRun, values: &Values) -> Vec<f64> {
    run.input.iter().map(|u| values.actuated(*u)).collect()
}

/// Simulates a run from a speed in rpm.
pub fn simulate(run: &DriveRun, values: &Values, start_rpm: f64, unsigned: bool) -> Motion {
    simulate_goals(run, values, &goals(run, values), start_rpm, unsigned)
}

/// The same where what the actuator makes of the inputs is known.
pub fn simulate_goals(run: &DriveRun, values: &Values, goals: &[f64], start_rpm: f64, unsigned: bool) -> Motion {
    let swing = Swing::of(values);
    let lag = swing.as_ref().map_or(values.lag_s(), Swing::lag_s);
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
    let mut solver = Solver { values, lag, second, decays, held, aside: Aside::default() };
    let delay = values.get(P::Skew) * run.period_s + values.get(P::DeadTime);
    let n = run.time.len();
    let mut state = State { speed: start_rpm, x: goals[0], way: 0.0, swing };
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
        solver.aside = Aside::at(values, run, k - 1);
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
        // A torque that changes within the interval, as over the angle of a rotor that turns; one at rest has none that does.
        let [torque, share] = solver.aside.way;
        state.way += values.get(P::Gain) * (torque + share * state.x) * (until - run.time[k - 1]);
        let (speed, way) = state.seen();
        match &run.windows {
            None => out.push(magnitude(speed)),
            Some(ends) if ends.get(window.0 + 1) == Some(&k) => {
                let seconds = run.time[k] - run.time[ends[window.0]];
                out.push(magnitude((way - window.1) / seconds));
                window = (window.0 + 1, way);
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
            beside: Vec::new(),
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
                let wave = run.ripple.get(k - 1).copied().unwrap_or_default();
                let (torque, share) = (
                    v.get(P::CoggingCos) * wave[0] + v.get(P::CoggingSin) * wave[1] + v.get(P::Cogging2Sin) * wave[3],
                    v.get(P::RippleSin) * wave[1],
                );
                let [load, warmth] = run.beside.get(k - 1).copied().unwrap_or_default();
                let torque = torque - v.get(P::Load) * load;
                let push = x * (1.0 + share) * (1.0 - v.get(P::Heating) * warmth) + torque - v.get(P::Bias);
                let held = v.get(P::Coulomb) + v.get(P::Stiction);
                if speed == 0.0 && push.abs() <= held {
                    continue;
                }
                let sense = if speed == 0.0 { push.signum() } else { speed.signum() };
                let fades = v.get(P::StribeckSpeed) * v.get(P::Gain);
                let more = if fades > 0.0 { v.get(P::Stiction) * (1.0 - speed.abs() / fades).max(0.0) } else { 0.0 };
                let friction = v.get(P::Coulomb) + more;
                let moved = speed + h / v.lag_s() * (v.get(P::Gain) * (push - sense * friction) - speed);
                speed = if speed != 0.0 && moved * sense <= 0.0 { 0.0 } else { moved };
            }
            out.push(speed);
        }
        out
    }

    /// Fails if an instant of stop or break-away is missed, or a lag, a dead time or a load acts at another place.
    #[test]
    fn stick_and_slip_are_those_of_small_steps() {
        let input: Vec<f64> =
            (0..120).map(|k| (0.11 * f64::from(k)).sin() * if k % 7 < 2 { 0.2 } else { 0.9 }).collect();
        let ripple =
            (0..120).map(|k| [0.9, 1.7, 2.3, 0.4, 0.0, 0.0, 0.0, 0.0].map(|by| (by * f64::from(k)).sin())).collect();
        let beside = (0..120).map(|k| [0.7, 0.05].map(|by| 3.0 * (by * f64::from(k)).sin())).collect();
        let run = DriveRun { ripple, beside, ..run(input, 4e-3) };
        let plain = Values::line(300.0, 0.02).with(P::Coulomb, 0.2);
        for v in [
            plain,
            plain.with(P::Stiction, 0.1).with(P::Bias, 0.05),
            plain.with(P::SecondLag, 0.006).with(P::DeadTime, 0.0102),
            Values::line(300.0, 0.02).with(P::DeadZone, 0.15).with(P::Bend, 1.5).with(P::Skew, 0.5),
            plain.with(P::CoggingCos, 0.15).with(P::Cogging2Sin, -0.1),
            plain.with(P::RippleSin, 0.3).with(P::SecondLag, 0.006),
            plain.with(P::Load, 0.1).with(P::Heating, 0.1),
            plain.with(P::Stiction, 0.1).with(P::StribeckSpeed, 0.15),
            plain.with(P::Stiction, 0.15).with(P::StribeckSpeed, 0.1).with(P::SecondLag, 0.006),
        ] {
            let exact = simulate(&run, &v, 0.0, false).rpm;
            for (k, (a, b)) in exact.iter().zip(stepped(&run, &v)).enumerate() {
                assert!((a - b).abs() < 0.2, "{v:?}: {a} and {b} rpm at sample {k}");
            }
        }
    }

    /// Fails if the mean speed of a window leaves out that a torque over the angle changes within a sample: an encoder shows it.
    #[test]
    fn a_window_shows_a_torque_that_changes_within_it() {
        use super::super::angle::{Course, Ripple};
        let (gain, lag_s, period_s, order) = (300.0, 0.05, 0.02, 3);
        // A sixth of a tooth, and half a tooth, from sample to sample.
        let turns: Vec<f64> = (0..40).map(|k| f64::from(k.min(20)) / 18.0 + f64::from((k - 20).max(0)) / 6.0).collect();
        let mut run = run(vec![0.5; 40], period_s);
        run.windows = Some((0..40).collect());
        run.rpm = vec![0.0; 39];
        let course = Course { time_s: &run.time, turns: &turns, rpm: None, lag_s };
        run.ripple = course.ripple(0, &[Ripple { order, phases: vec![0.0] }]);
        let values = Values::line(gain, lag_s).with(P::CoggingCos, 0.2);
        let windows = simulate(&run, &values, 0.0, false).rpm;
        let (steps, mut speed) = (4000, 0.0);
        for (k, window) in windows.iter().enumerate() {
            let mut mean = 0.0;
            for i in 0..steps {
                let at = turns[k] + (turns[k + 1] - turns[k]) * (f64::from(i) + 0.5) / f64::from(steps);
                let torque = 0.5 + 0.2 * (std::f64::consts::TAU * order as f64 * at).cos();
                let before = speed;
                speed += (gain * torque - speed) * period_s / f64::from(steps) / lag_s;
                mean += 0.5 * (before + speed) / f64::from(steps);
            }
            assert!((window - mean).abs() < 0.01 * gain * 0.2, "{window} and {mean} rpm in window {k}");
        }
    }
}
