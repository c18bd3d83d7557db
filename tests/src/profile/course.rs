//! The course of the speed: a rise and a fall as smooth random curves, followed pulse by pulse.

use super::effects::{Now, Work};
use super::random::{Dice, Smooth};
use crate::drive::Drive;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Spacing of the angles that a run is followed in, in s.
pub const CELL_S: f64 = 0.25e-3;
/// Points of a curve's table.
const POINTS: usize = 400;

/// A motor: how fast it gets and along which curves.
#[derive(Debug, Clone, PartialEq)]
pub struct Motor {
    /// Speed under full drive in rad/s.
    pub full: f64,
    /// Time from rest to full speed, were the first acceleration kept, in s.
    pub rise_s: f64,
    /// Time from full speed to rest, alike, in s.
    pub fall_s: f64,
    /// Share of the full speed below it in which the rise slackens.
    pub slack: f64,
    /// Growth of the fall's rate from rest to full speed.
    pub drag: f64,
    /// Time by which the rotor follows the drive's rise later than its fall, in s.
    pub foot_s: f64,
    /// How uneven the two rates are over the speed.
    pub uneven: f64,
    rise_shape: Smooth,
    fall_shape: Smooth,
}

impl Motor {
    /// Draws one: 10 to 100 rpm, times of 0.3 to 16 ms, from nearly coasting to clamped.
    pub fn draw(dice: &mut Dice) -> Self {
        let full = dice.decade(10.0, 100.0) * TAU / 60.0;
        // A tenth to ten times the listed motor's 2 ms at 35 rpm, more where it turns faster.
        let rise_s = (full / 3.67 * dice.decade(0.2e-3, 20e-3)).clamp(0.3e-3, 16e-3);
        let fall_s = match dice.whole(0, 9) {
            0 | 1 => rise_s * dice.decade(20.0, 200.0),
            2..=4 => rise_s * dice.decade(1.6, 15.0),
            _ => rise_s * dice.even(0.75, 1.4),
        };
        Self {
            full,
            rise_s,
            fall_s,
            slack: dice.decade(0.01, 0.08),
            drag: dice.even(0.0, 0.3),
            foot_s: dice.even(-0.05e-3, 0.12e-3),
            uneven: dice.even(0.0, 0.03),
            rise_shape: Smooth::free(dice, 5),
            fall_shape: Smooth::free(dice, 5),
        }
    }

    /// The numbers, for the sealed file.
    pub fn numbers(&self) -> BTreeMap<String, f64> {
        [
            ("full_rpm", self.full * 60.0 / TAU),
            ("rise_s", self.rise_s),
            ("fall_s", self.fall_s),
            ("slack", self.slack),
            ("drag", self.drag),
            ("foot_s", self.foot_s),
            ("uneven", self.uneven),
        ]
        .map(|(k, v)| (k.to_owned(), v))
        .into()
    }

    /// How many of its own parameters [`Self::nudged`] changes: speed, rise, fall, drag, foot.
    pub const PARAMETERS: usize = 5;

    /// The motor with one of its own parameters a little changed, for the linear refit.
    pub fn nudged(&self, k: usize) -> Self {
        let mut m = self.clone();
        match k {
            0 => m.full *= 1.005,
            1 => m.rise_s *= 1.03,
            2 => m.fall_s *= 1.03,
            3 => m.drag += 0.05,
            _ => m.foot_s += 0.02e-3,
        }
        m
    }

    /// Curves of the rise and of the fall with what is hidden in them: `slack` widens the rise's end, `stick` slows the
    /// rise and hastens the fall at low speeds.
    pub fn curves(&self, slack: f64, stick: &dyn Fn(f64) -> f64) -> [Curve; 2] {
        let width = self.slack + slack;
        let rise = |y: f64| {
            let end = (1.0 - y) / width;
            let uneven = 1.0 + self.uneven * self.rise_shape.at(y);
            uneven * end / (1.0 + end.powi(4)).powf(0.25) * (1.0 - stick(y)).max(0.02) / self.rise_s
        };
        let fall = |y: f64| {
            (1.0 + self.drag * y) * (1.0 + self.uneven * self.fall_shape.at(y)) / self.fall_s + stick(y) / self.rise_s
        };
        [Curve::new(&rise, 0.9995), Curve::new(&fall, 1.0)]
    }
}

/// A speed's way between rest and its end, as the time it takes: speed over full speed, by table.
#[derive(Debug, Clone)]
pub struct Curve {
    /// Time since rest at evenly spaced speeds.
    time: Vec<f64>,
    end: f64,
}

impl Curve {
    fn new(rate: &dyn Fn(f64) -> f64, end: f64) -> Self {
        let dy = end / POINTS as f64;
        let mut time = vec![0.0];
        for n in 0..POINTS {
            // Simpson's rule over each cell.
            let slowness = |share: f64| 1.0 / rate((n as f64 + share) * dy).max(1e-6);
            let last = time[n];
            time.push(last + dy / 6.0 * (slowness(0.0) + 4.0 * slowness(0.5) + slowness(1.0)));
        }
        Self { time, end }
    }

    fn time_of(&self, y: f64) -> f64 {
        let x = (y / self.end).clamp(0.0, 1.0) * POINTS as f64;
        let n = (x as usize).min(POINTS - 1);
        self.time[n] + (x - n as f64) * (self.time[n + 1] - self.time[n])
    }

    fn speed_at(&self, t: f64) -> f64 {
        if t <= 0.0 {
            return 0.0;
        }
        let n = self.time.partition_point(|at| *at <= t);
        if n > POINTS {
            return self.end;
        }
        let f = (t - self.time[n - 1]) / (self.time[n] - self.time[n - 1]);
        ((n - 1) as f64 + f) / POINTS as f64 * self.end
    }

    /// Speed a time `dt` further along the rise.
    pub fn later(&self, y: f64, dt: f64) -> f64 {
        if y >= self.end { y } else { self.speed_at(self.time_of(y) + dt) }
    }

    /// Speed a time `dt` further back: along the fall.
    pub fn earlier(&self, y: f64, dt: f64) -> f64 {
        if y <= 0.0 { 0.0 } else { self.speed_at(self.time_of(y) - dt) }
    }
}

/// Follows one run: travelled angles in rad every [`CELL_S`] of true time, up to `until`.
pub fn follow(motor: &Motor, drive: Drive, work: &mut Work, gain: f64, until: f64) -> Vec<f64> {
    let [rise, fall] = motor.curves(work.slack(), &|y| work.stick(y));
    let period = 1.0 / drive.pwm_hz;
    let duty = work.duty(drive.duty);
    let (mut y, mut angle, mut pulse) = (0.0_f64, 0.0_f64, -1_i64);
    let mut on_for = [f64::INFINITY, f64::INFINITY];
    let cells = (until / CELL_S) as usize + 1;
    let mut angles = Vec::with_capacity(cells + 1);
    angles.push(0.0);
    for n in 0..cells {
        let t = n as f64 * CELL_S;
        let now = ((t + 1e-9) / period).floor() as i64;
        if now != pulse {
            pulse = now;
            on_for = window(motor, drive, work, duty, pulse, angle);
        }
        // Parts of the cell before, within and after the time the rotor is driven.
        let end = t + CELL_S;
        let marks = [t, on_for[0].clamp(t, end), on_for[1].clamp(t, end), end];
        let at = Now { t: t + 0.5 * CELL_S, dt: CELL_S, on: marks[2] > marks[1], travelled: angle, speed: y, pulse };
        let f = work.factors(&at);
        let mut area = 0.0;
        for (k, pair) in marks.windows(2).enumerate() {
            let dt = pair[1] - pair[0];
            if dt <= 0.0 {
                continue;
            }
            let go = |dt: f64| if k == 1 { rise.later(y, dt * f.rise) } else { fall.earlier(y, dt * f.fall) };
            let (middle, next) = (go(0.5 * dt), go(dt));
            area += dt / 6.0 * (y + 4.0 * middle + next);
            y = next;
        }
        angle += motor.full * gain * f.gain * area;
        angles.push(angle);
    }
    angles
}

/// From when to when the rotor is driven in a pulse.
fn window(motor: &Motor, drive: Drive, work: &mut Work, duty: f64, pulse: i64, angle: f64) -> [f64; 2] {
    let period = 1.0 / drive.pwm_hz;
    let start = pulse as f64 * period;
    if start >= drive.seconds || duty <= 0.0 {
        return [f64::INFINITY, f64::INFINITY];
    }
    let late = work.delay(pulse, (1.0 - duty) * period, angle);
    let foot = if duty >= 1.0 - 1e-9 && pulse > 0 { 0.0 } else { motor.foot_s };
    let to = (start + period).min(drive.seconds);
    [(start + (1.0 - duty) * period + foot + late).clamp(start, to), to]
}
