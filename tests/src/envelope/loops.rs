//! Closed loops: the same stator and rotor under the chip's control step, with something hidden in the loop.
//!
//! The step is the contract itself (`twum_shared`), not a model.

use super::bench::normal;
use super::bristles::{Grip, Rotor};
use super::curves::Ring;
use super::motor::Motor;
use super::stator::{Stator, Tuning};
use crate::folder::{Folder, Record, Run, Tick};
use crate::profile::random::Dice;
use crate::truth::{Made, Request, Truth};
use fixed::types::{I16F48, I32F32};
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use twum_shared::step::{Config, ConfigSpec, DriveLaw, Inputs, State, step};

/// What a closed loop may hide, and nothing.
const LOOPS: [&str; 7] =
    ["none", "gravity-load", "backlash", "loop-delay", "off-phase-braking", "controller-mismatch", "reversal-miscount"];

const RUNS: usize = 3;
const SECONDS: f64 = 15.0;
const TICK_US: u64 = 500;
const TICK_S: f64 = TICK_US as f64 * 1e-6;
/// Ticks in a PWM period of 20 ms.
const PERIOD: u64 = 40;
/// Steps of the rotor in a tick: 50 µs each, which the rotors of loops are slow enough for.
const STEPS: u64 = 10;

/// What is wrong in one loop; all absent by default.
#[derive(Debug, Clone)]
struct Fault {
    /// Ticks from a sample to the control signal made of it, beyond the usual.
    late_ticks: usize,
    /// Factors on kp, ki, kd and the integral's limits.
    factors: [f64; 4],
    /// Play between shaft and encoder in rad.
    play: f64,
    /// Counts too many at a reversal; in the sense of the new direction, or always the same way.
    miscount: i32,
    one_way: bool,
    /// Largest torque of a load over inertia in rad/s², and its course over the angle.
    load: f64,
    arm: Ring,
}

/// The controller that the folder names: gains a count, count·s and count/s, steps of the duty, limit of the integral.
#[derive(Debug, Clone, Copy)]
struct Law {
    thesis: bool,
    gains: [f64; 3],
    steps: u16,
    integral: f64,
}

impl Law {
    fn draw(dice: &mut Dice) -> Self {
        if dice.chance(0.45) {
            return Self { thesis: true, gains: [1.3, 0.0015, 0.00004], steps: 32, integral: 31.0 };
        }
        let steps = dice.pick(&[64_u16, 100, 256, 800]);
        let full = f64::from(steps);
        // Full drive at 15 to 50 counts of error; an integral that takes seconds; a difference that calms a little.
        let gains = [full * dice.decade(0.02, 0.07), full * dice.decade(0.01, 0.07), full * dice.decade(1e-4, 3e-4)];
        let rounded = gains.map(|x| ((x * 1e3).round() / 1e3).max(1e-3));
        Self { thesis: false, gains: rounded, steps, integral: dice.pick(&[3.0, 6.0, 10.0]) }
    }

    fn text(&self) -> String {
        if self.thesis {
            return "\"thesis\"".to_owned();
        }
        let [kp, ki, kd] = self.gains;
        format!(
            "{{ kp = {kp:?}, ki = {ki:?}, kd = {kd:?}, period_us = {TICK_US}, duty_steps = {}, integral_min = {:?}, integral_max = {:?} }}",
            self.steps, -self.integral, self.integral
        )
    }

    /// What really runs.
    fn running(&self, fault: &Fault) -> Result<Config, String> {
        // The thesis's constants are exact as named, and not quite their decimals.
        if self.thesis && fault.factors == [1.0; 4] {
            return Config::try_from(ConfigSpec::THESIS).map_err(|e| format!("{e:?}"));
        }
        let ([kp, ki, kd], [p, i, d, limit]) = (self.gains, fault.factors);
        let most = (self.integral * limit / TICK_S).round() as i32;
        let base = if self.thesis { ConfigSpec::THESIS } else { ConfigSpec::DEFAULT };
        let spec = ConfigSpec {
            kp: I32F32::saturating_from_num(kp * p),
            ki_tick: I16F48::saturating_from_num(ki * i * TICK_S),
            kd_tick: I32F32::saturating_from_num(kd * d / TICK_S),
            feed_forward: I32F32::ZERO,
            integral_min: if self.thesis { 0 } else { -most },
            integral_max: most,
            period_us: TICK_US as u32,
            duty_steps: self.steps,
            dead_band_counts: 0,
            conditional_integration: self.thesis && base.conditional_integration,
            law: if self.thesis { base.law } else { DriveLaw::OnTimeRounded },
            ..base
        };
        Config::try_from(spec).map_err(|e| format!("{e:?}"))
    }
}

impl Fault {
    /// What is wrong, and the number that says how much.
    fn draw(name: &str, motor: &Motor, law: &Law, pitch: f64, dice: &mut Dice) -> (Self, BTreeMap<String, f64>) {
        let mut fault = Self {
            late_ticks: 0,
            factors: [1.0; 4],
            play: 0.0,
            miscount: 0,
            one_way: dice.chance(0.5),
            load: 0.0,
            arm: Ring::draw(dice, &[1.0]),
        };
        let number = match name {
            "gravity-load" => {
                // Half of what holds the rotor at most: it neither runs away nor stalls.
                fault.load = motor.contact.min(motor.brake) * dice.even(0.15, 0.5);
                ("load_rad_s2", fault.load)
            }
            "backlash" => {
                fault.play = pitch * dice.even(1.5, 8.0);
                ("gap_rad", fault.play)
            }
            "loop-delay" => {
                fault.late_ticks = dice.whole(1, 12);
                ("delay_ticks", fault.late_ticks as f64)
            }
            "reversal-miscount" => {
                fault.miscount = dice.pick(&[-3, -2, -1, 1, 2, 3]);
                ("counts_per_reversal", f64::from(fault.miscount))
            }
            "controller-mismatch" => {
                let factor = if dice.chance(0.5) { dice.even(1.25, 2.0) } else { dice.even(0.4, 0.8) };
                // The thesis's integral is worth less than a duty step: neither its gain nor its limit would show.
                let which = dice.pick(if law.thesis { &[0, 2][..] } else { &[0, 1, 2, 3][..] });
                fault.factors[which] = match which {
                    2 if factor > 1.0 => 2.0 * factor,
                    2 => 0.5 * factor,
                    3 => 0.3 * factor.min(1.0),
                    _ => factor,
                };
                (["kp_factor", "ki_factor", "kd_factor", "integral_limit_factor"][which], fault.factors[which])
            }
            "off-phase-braking" => ("brake_over_contact", motor.brake / motor.contact),
            _ => return (fault, BTreeMap::new()),
        };
        (fault, [(number.0.to_owned(), number.1)].into())
    }
}

/// Makes the data set of a seed.
///
/// # Errors
/// An effect that closed loops do not have.
pub fn make(seed: u64, request: &Request) -> Result<Made, String> {
    let name = match request.effects.first() {
        Some(asked) => *LOOPS
            .iter()
            .find(|n| *n == asked)
            .ok_or_else(|| format!("no effect {asked} of closed loops: one of {}", LOOPS.join(", ")))?,
        None => LOOPS[(seed % LOOPS.len() as u64) as usize],
    };
    let mut dice = Dice::new(seed, "e loops");
    let motor = plant(name, &mut dice);
    let edges = dice.pick(&[240_usize, 360, 400, 400, 512, 720]);
    let law = Law::draw(&mut dice);
    let (fault, numbers) = Fault::draw(name, &motor, &law, TAU / edges as f64, &mut dice);
    let mut runs = Vec::new();
    for k in 0..RUNS {
        runs.push(run(&motor, &law, &fault, edges, k, &mut dice)?);
    }
    let design = [edges as f64, RUNS as f64];
    let truth = Truth::of_loops(("e", seed), name, law.text(), numbers, motor.numbers(), design);
    Ok(Made { folder: Folder { name: format!("paths {seed}"), edges_per_rev: edges as u32, runs }, truth })
}

/// A motor that a loop can hold: not the slowest, and clamped with the drive off unless that is what is hidden.
fn plant(name: &str, dice: &mut Dice) -> Motor {
    let mut motor = Motor::draw(dice);
    motor.full = dice.decade(18.0, 65.0) * TAU / 60.0;
    motor.contact = motor.full / dice.decade(1e-3, 6e-3);
    motor.wave_s = motor.wave_s.min(1e-3);
    motor.brake =
        motor.contact * if name == "off-phase-braking" { dice.decade(0.01, 0.15) } else { dice.even(0.8, 1.15) };
    motor
}

/// Where the rotor is to be: a sum of two sines, or moves at a steady speed with rests between.
enum Course {
    /// Amplitudes in counts, rates in rad/s, phases.
    Sines([[f64; 3]; 2]),
    /// Times in s and places in counts, straight from each to the next.
    Moves(Vec<[f64; 2]>),
}

impl Course {
    /// One that asks for `most` counts/s at most and stays within 0.6 turns of `edges`.
    fn draw(dice: &mut Dice, most: f64, edges: f64) -> Self {
        if dice.chance(0.6) {
            let rate = dice.decade(0.6, 1.6);
            let other = rate * dice.even(1.7, 3.2);
            let share = dice.even(0.05, 0.3);
            let amplitude = (most / (rate + share * other)).min(0.45 * edges);
            return Self::Sines([[amplitude, rate, 0.0], [share * amplitude, other, dice.even(0.0, TAU)]]);
        }
        let (mut t, mut place) = (dice.even(0.2, 0.6), 0.0);
        let mut knots = vec![[0.0, 0.0]];
        while t < SECONDS {
            knots.push([t, place]);
            // To the other side each time, so that every move ends in a reversal.
            let next = if place > 0.0 { -1.0 } else { 1.0 } * dice.even(0.08, 0.35) * edges;
            t += f64::abs(next - place) / (most * dice.even(0.5, 1.0));
            knots.push([t, next]);
            (t, place) = (t + dice.even(0.1, 0.5), next);
        }
        Self::Moves(knots)
    }

    fn at(&self, t: f64) -> f64 {
        match self {
            Self::Sines(terms) => {
                terms.iter().map(|[a, rate, phase]| a * ((rate * t + phase).sin() - phase.sin())).sum()
            }
            Self::Moves(knots) => match knots.partition_point(|k| k[0] <= t) {
                n if n == 0 || n == knots.len() => knots.last().map_or(0.0, |k| k[1]),
                n => {
                    let [a, b] = [knots[n - 1], knots[n]];
                    a[1] + (b[1] - a[1]) * (t - a[0]) / (b[0] - a[0])
                }
            },
        }
    }
}

/// The encoder's counter, play and miscounts in it.
struct Counter<'a> {
    fault: &'a Fault,
    pitch: f64,
    seen: f64,
    cell: i64,
    sense: i64,
    count: i32,
}

impl Counter<'_> {
    fn follow(&mut self, angle: f64) {
        self.seen = self.seen.max(angle - 0.5 * self.fault.play).min(angle + 0.5 * self.fault.play);
        // Half a pitch from the first edge: at rest it reads the same whatever trembles.
        let now = (self.seen / self.pitch + 0.5).floor() as i64;
        while self.cell != now {
            let way = if now > self.cell { 1 } else { -1 };
            self.cell += way;
            self.count += way as i32;
            if self.sense == -way {
                self.count += self.fault.miscount * if self.fault.one_way { 1 } else { way as i32 };
            }
            self.sense = way;
        }
    }
}

fn run(motor: &Motor, law: &Law, fault: &Fault, edges: usize, k: usize, dice: &mut Dice) -> Result<Run, String> {
    let config = law.running(fault)?;
    let pitch = TAU / edges as f64;
    // A per cent between runs, as the best repeat.
    let full = motor.full * (1.0 + 0.01 * normal(dice));
    // Three fifths of the motor's speed at most: it can follow, and is not always slower than the target.
    let most = dice.even(0.4, 0.6) * full / pitch;
    let course = Course::draw(dice, most, edges as f64);
    let dt = TICK_S / STEPS as f64;
    let (mut stator, mut rotor, mut grip) = (Stator::new(motor, dt), Rotor::default(), Grip::of(motor));
    let mut counter = Counter { fault, pitch, seen: 0.0, cell: 0, sense: 0, count: 0 };
    let mut state = State::REST;
    let mut made: Vec<(f64, f64, i32)> = Vec::new();
    let (mut ticks, mut held) = (Vec::new(), 0.0);
    for tick in 0..(SECONDS / TICK_S).round() as u64 {
        let target = course.at(tick as f64 * TICK_S).round() as i32;
        let position = counter.count;
        let out = step(&config, &mut state, Inputs { target, target_rate: 0, position, ..Inputs::default() });
        made.push((f64::from(out.u) / 65_536.0, f64::from(out.on_steps) / f64::from(law.steps), out.direction.sign()));
        let (u, duty, direction) =
            (tick as usize).checked_sub(fault.late_ticks).map_or((0.0, 0.0, -1), |before| made[before]);
        ticks.push(Tick { time_us: tick * TICK_US, target, position, u, duty, direction });
        // The pin takes a new duty at the beginning of a PWM period, and the direction at once.
        if tick.is_multiple_of(PERIOD) {
            held = duty;
        }
        stator.tune(Tuning { detuning: motor.detuning, quadrature: motor.quadrature, sign: f64::from(direction) });
        for part in 0..STEPS {
            let from = ((tick % PERIOD) * STEPS + part) as f64 / (PERIOD * STEPS) as f64;
            let share = ((from - (1.0 - held)) * (PERIOD * STEPS) as f64 + 1.0).clamp(0.0, 1.0);
            stator.step(share);
            let [surface, amplitude] = stator.surface();
            grip.load = fault.load * fault.arm.at(rotor.angle);
            rotor.step(&grip, full * surface, amplitude, dt);
            counter.follow(rotor.angle);
        }
    }
    Ok(Run {
        id: format!("track-{k}"),
        duty: 0.0,
        sign: 0.0,
        pwm_hz: 50.0,
        drive_on_s: SECONDS,
        order: k,
        aligned: false,
        record: Record::Control { law: law.text(), ticks },
    })
}
