//! Closed loops: the rising and falling speed under the chip's control step, with something hidden in the loop.
//!
//! The step is the contract itself (`twum_shared`), not a model.

use super::course::{Curve, Motor};
use super::random::Dice;
use crate::folder::{Folder, Record, Run, Tick};
use crate::truth::{Made, Request, Truth};
use fixed::types::{I16F48, I32F32};
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use twum_shared::step::{Config, ConfigSpec, DriveLaw, Inputs, State, step};

/// What a closed loop may hide.
pub const LOOPS: [&str; 7] =
    ["controller-mismatch", "backlash", "none", "off-phase-braking", "gravity-load", "loop-delay", "reversal-miscount"];

const TICK_US: u64 = 500;
const TICKS: u64 = 30_000;
const PERIOD_TICKS: u64 = 40;
/// Parts of a tick in which the rotor is followed.
const PARTS: u32 = 5;

/// What is wrong in one loop; all absent by default.
#[derive(Debug, Clone, Default)]
struct Wrong {
    old_ticks: usize,
    kp: Option<f64>,
    ki: Option<f64>,
    kd: Option<f64>,
    integral: Option<f64>,
    gap: f64,
    each_reversal: i32,
    one_way: bool,
    /// Share by which a load hastens or slows rise and fall at its worst angle.
    load: f64,
    load_at: f64,
}

/// The controller that the folder names: gains a count, count·s and count/s in `steps`, and the integral's limits.
#[derive(Debug, Clone, Copy)]
struct Named {
    thesis: bool,
    kp: f64,
    ki: f64,
    kd: f64,
    steps: u16,
    integral: [f64; 2],
}

impl Named {
    fn draw(dice: &mut Dice) -> Self {
        if dice.chance(0.5) {
            return Self { thesis: true, kp: 1.3, ki: 0.0015, kd: 0.00004, steps: 32, integral: [0.0, 31.0] };
        }
        let steps = dice.pick(&[100_u16, 200, 500, 1000]);
        let full = f64::from(steps);
        let limit = dice.pick(&[4.0, 8.0, 16.0]);
        let rounded = |x: f64| (x * 1e3).round() / 1e3;
        Self {
            thesis: false,
            kp: rounded(full * dice.decade(0.02, 0.08)),
            ki: rounded(full * dice.decade(0.01, 0.08)),
            kd: rounded(full * dice.decade(1e-4, 4e-4)),
            steps,
            integral: [-limit, limit],
        }
    }

    fn toml(&self) -> String {
        if self.thesis {
            return "\"thesis\"".to_owned();
        }
        format!(
            "{{ kp = {:?}, ki = {:?}, kd = {:?}, period_us = {TICK_US}, duty_steps = {}, integral_min = {:?}, integral_max = {:?} }}",
            self.kp, self.ki, self.kd, self.steps, self.integral[0], self.integral[1]
        )
    }

    /// What really runs.
    fn running(&self, wrong: &Wrong) -> Config {
        let period = TICK_US as f64 * 1e-6;
        let base = if self.thesis {
            ConfigSpec::THESIS
        } else {
            ConfigSpec { law: DriveLaw::OnTimeRounded, conditional_integration: false, ..ConfigSpec::DEFAULT }
        };
        let limit = |x: f64| (x * wrong.integral.unwrap_or(1.0) / period).round() as i32;
        let spec = ConfigSpec {
            kp: I32F32::saturating_from_num(self.kp * wrong.kp.unwrap_or(1.0)),
            ki_tick: I16F48::saturating_from_num(self.ki * wrong.ki.unwrap_or(1.0) * period),
            kd_tick: I32F32::saturating_from_num(self.kd * wrong.kd.unwrap_or(1.0) / period),
            feed_forward: I32F32::ZERO,
            integral_min: limit(self.integral[0]),
            integral_max: limit(self.integral[1]),
            period_us: TICK_US as u32,
            duty_steps: self.steps,
            dead_band_counts: 0,
            ..base
        };
        // The named controller of the thesis is its own constants, not their decimals read again.
        let exact = self.thesis && [wrong.kp, wrong.ki, wrong.kd, wrong.integral].iter().all(Option::is_none);
        Config::try_from(if exact { ConfigSpec::THESIS } else { spec }).expect("the gains drawn are a controller's")
    }
}

/// Makes the data set of a seed.
///
/// # Errors
/// An effect that closed loops do not have.
pub fn make(seed: u64, request: &Request) -> Result<Made, String> {
    let asked = request.effects.first().map(String::as_str);
    let name = match asked {
        Some(asked) => LOOPS.into_iter().find(|n| *n == asked).ok_or(format!("no closed-loop effect {asked}"))?,
        None => LOOPS[(seed % LOOPS.len() as u64) as usize],
    };
    let mut dice = Dice::new(seed, "loop");
    let mut motor = Motor::draw(&mut dice);
    motor.full = dice.decade(18.0, 60.0) * TAU / 60.0;
    motor.rise_s = dice.decade(0.5e-3, 6e-3);
    motor.fall_s = motor.rise_s * dice.even(0.8, 1.2);
    let edges = dice.pick(&[240_usize, 400, 400, 600]);
    let named = Named::draw(&mut dice);
    let mut wrong = Wrong::default();
    let mut number = BTreeMap::new();
    let mut say = |key: &str, value: f64| number.insert(key.to_owned(), value);
    match name {
        "controller-mismatch" => {
            let factor = if dice.chance(0.5) { dice.even(1.2, 2.0) } else { dice.even(0.4, 0.8) };
            // The thesis's integral cannot reach a duty step: neither its gain nor its limit shows.
            match dice.whole(0, if named.thesis { 1 } else { 3 }) {
                0 => wrong.kp = Some(factor),
                1 => wrong.kd = Some(if factor > 1.0 { 2.0 * factor } else { 0.5 * factor }),
                2 => wrong.ki = Some(factor),
                _ => wrong.integral = Some(0.3 * factor.min(1.0)),
            }
            say("factor", factor);
        }
        "backlash" => {
            wrong.gap = dice.even(2.0, 8.0) * TAU / edges as f64;
            say("gap_rad", wrong.gap);
        }
        "off-phase-braking" => {
            motor.fall_s = motor.rise_s * dice.decade(6.0, 80.0);
            say("fall_over_rise", motor.fall_s / motor.rise_s);
        }
        "gravity-load" => {
            wrong.load = dice.even(0.15, 0.45);
            wrong.load_at = dice.even(0.0, TAU);
            say("share_of_drive", wrong.load);
        }
        "loop-delay" => {
            wrong.old_ticks = dice.whole(1, 12);
            say("delay_ticks", wrong.old_ticks as f64);
        }
        "reversal-miscount" => {
            wrong.each_reversal = dice.pick(&[-3, -2, -1, 1, 2, 3]);
            wrong.one_way = dice.chance(0.5);
            say("counts_per_reversal", f64::from(wrong.each_reversal));
        }
        _ => {}
    }
    let runs = (0..3).map(|k| one(&motor, &named, &wrong, edges, k, &mut dice)).collect();
    let truth = Truth::of_loops(("c", seed), name, named.toml(), number, motor.numbers(), [edges as f64, 3.0]);
    Ok(Made { folder: Folder { name: format!("tracking {seed}"), edges_per_rev: edges as u32, runs }, truth })
}

/// The rotor on its way, its speed signed and over the full one.
struct Rotor<'a> {
    rise: &'a Curve,
    fall: &'a Curve,
    full: f64,
    wrong: &'a Wrong,
    y: f64,
    angle: f64,
}

impl Rotor<'_> {
    /// `dt` with the drive in the sense of `sign`, or off.
    fn go(&mut self, on: bool, sign: f64, dt: f64) {
        let before = self.y;
        // A load against the motion slows the rise and hastens the fall, one with it the other way round.
        let load = self.wrong.load * (self.angle + self.wrong.load_at).sin();
        let along = self.y * sign;
        self.y = if on && along < 0.0 {
            // Turned round while still moving: the wave pulls as it does from rest, whatever the rotor does without one.
            -sign * (-along - self.rise.later(0.0, dt * (1.0 + load * sign))).max(0.0)
        } else if on {
            sign * self.rise.later(along, dt * (1.0 - load * sign))
        } else {
            let way = self.y.signum();
            way * self.fall.earlier(self.y.abs(), dt * (1.0 + load * way))
        };
        // Under load the rotor slips behind the wave it rides on.
        let slip = if on { 0.06 * load * sign * self.y.abs() } else { 0.0 };
        self.angle += (0.5 * (before + self.y) - slip * sign) * self.full * dt;
    }
}

fn one(motor: &Motor, named: &Named, wrong: &Wrong, edges: usize, k: usize, dice: &mut Dice) -> Run {
    let config = named.running(wrong);
    let steps = f64::from(named.steps);
    let [rise, fall] = motor.curves(0.0, &|_| 0.0);
    let pitch = TAU / edges as f64;
    let full = motor.full * (1.0 + 0.01 * dice.box_shaped());
    let mut rotor = Rotor { rise: &rise, fall: &fall, full, wrong, y: 0.0, angle: 0.0 };
    // A sine with its third harmonic, as fast as three fifths of the motor's speed at most.
    let rate = dice.decade(0.5, 1.5);
    let third = dice.even(0.0, 0.15);
    let amplitude = (dice.even(0.4, 0.6) * full / pitch / rate / (1.0 + 3.0 * third)).min(0.5 * edges as f64);
    let offset = dice.even(0.0, 1.0);
    let (mut seen, mut cell, mut sense, mut count) = (0.0_f64, 0_i64, 0, 0);
    let mut state = State::REST;
    let mut made: Vec<(f64, f64, i32)> = Vec::new();
    let (mut ticks, mut held) = (Vec::new(), 0.0);
    for tick in 0..TICKS {
        let t = (tick * TICK_US) as f64 * 1e-6;
        let target = (amplitude * ((rate * t).sin() + third * (3.0 * rate * t).sin())).round() as i32;
        let out = step(&config, &mut state, Inputs { target, target_rate: 0, position: count, ..Inputs::default() });
        made.push((f64::from(out.u) / 65_536.0, f64::from(out.on_steps) / steps, out.direction.sign()));
        let (u, duty, direction) = match (tick as usize).checked_sub(wrong.old_ticks) {
            Some(old) => made[old],
            None => (0.0, 0.0, -1),
        };
        ticks.push(Tick { time_us: tick * TICK_US, target, position: count, u, duty, direction });
        if tick % PERIOD_TICKS == 0 {
            held = duty;
        }
        let dt = TICK_US as f64 * 1e-6 / f64::from(PARTS);
        for part in 0..PARTS {
            let within =
                ((tick % PERIOD_TICKS) as f64 + (f64::from(part) + 0.5) / f64::from(PARTS)) / PERIOD_TICKS as f64;
            rotor.go(within >= 1.0 - held, f64::from(direction), dt);
            seen = seen.max(rotor.angle - 0.5 * wrong.gap).min(rotor.angle + 0.5 * wrong.gap);
            let now = (seen / pitch + offset).floor() as i64;
            while cell != now {
                let way = if now > cell { 1 } else { -1 };
                cell += i64::from(way);
                count += way;
                if sense == -way {
                    count += wrong.each_reversal * if wrong.one_way { 1 } else { way };
                }
                sense = way;
            }
        }
    }
    Run {
        id: format!("track-{k}"),
        duty: 0.0,
        sign: 0.0,
        pwm_hz: 50.0,
        drive_on_s: 15.0,
        order: k,
        aligned: false,
        record: Record::Control { law: named.toml(), ticks },
    }
}
