//! Closed loops: the same rotor under the chip's control step, with something hidden in the loop.
//!
//! The step is the contract itself (`twum_shared`), not a model.

use super::motor::{Factors, Motor, Rotor};
use super::smooth::{Ring, normal};
use crate::folder::{Folder, Record, Run, Tick};
use crate::profile::random::Dice;
use crate::truth::{Made, Request, Truth};
use fixed::types::{I16F48, I32F32};
use std::collections::{BTreeMap, VecDeque};
use std::f64::consts::TAU;
use twum_shared::step::{Config, ConfigSpec, DriveLaw, Inputs, State, step};

/// What a closed loop may hide, and nothing; the last only where it is asked for.
const LOOPS: [&str; 8] = [
    "off-phase-braking",
    "loop-delay",
    "gravity-load",
    "none",
    "reversal-miscount",
    "controller-mismatch",
    "backlash",
    "presliding",
];

const RUNS: usize = 3;
const SECONDS: f64 = 15.0;
const TICK_S: f64 = 500e-6;
/// Ticks in a PWM period.
const PERIOD: u64 = 40;

/// What is wrong in one loop; all absent by default.
#[derive(Debug, Clone)]
struct Fault {
    /// Ticks between a sample and the control signal made of it.
    old_ticks: usize,
    /// Factors on kp, ki, kd and the integral's limits.
    gains: [f64; 4],
    /// Samples over which the controller averages the position.
    averaged: usize,
    /// Play between shaft and encoder in rad.
    gap: f64,
    /// Counts at a reversal, always in the same sense or in that of the new direction.
    miscount: i32,
    one_sense: bool,
    /// Load over inertia in rad/s², and the angle where it vanishes.
    load: [f64; 2],
    /// Way that the friction yields in rad.
    spring: f64,
    /// What gap and load vary by over the angle.
    ring: Ring,
}

/// The controller that the folder names: gains a count, count·s and count/s.
#[derive(Debug, Clone, Copy)]
struct Law {
    thesis: bool,
    gains: [f64; 3],
    steps: u16,
    integral: f64,
}

impl Law {
    fn draw(dice: &mut Dice) -> Self {
        if dice.chance(0.4) {
            return Self { thesis: true, gains: [1.3, 0.0015, 0.00004], steps: 32, integral: 31.0 };
        }
        let steps = dice.pick(&[50_u16, 128, 400, 1000]);
        let full = f64::from(steps);
        let rounded = |x: f64| (x * 1e3).round() / 1e3;
        Self {
            thesis: false,
            gains: [
                rounded(full * dice.decade(0.02, 0.07)),
                rounded(full * dice.decade(0.01, 0.06)),
                rounded(full * dice.decade(1e-4, 3e-4)).max(1e-3),
            ],
            steps,
            integral: dice.pick(&[4.0, 6.0, 12.0]),
        }
    }

    fn text(&self) -> String {
        let [kp, ki, kd] = self.gains;
        if self.thesis {
            return "\"thesis\"".to_owned();
        }
        format!(
            "{{ kp = {kp:?}, ki = {ki:?}, kd = {kd:?}, period_us = 500, duty_steps = {}, integral_min = {:?}, integral_max = {:?} }}",
            self.steps, -self.integral, self.integral
        )
    }

    /// What really runs.
    fn running(&self, fault: &Fault) -> Config {
        let [kp, ki, kd] = self.gains;
        let [p, i, d, limit] = fault.gains;
        let named = if self.thesis { ConfigSpec::THESIS } else { ConfigSpec::DEFAULT };
        let ticks = (self.integral * limit / TICK_S).round() as i32;
        let spec = ConfigSpec {
            kp: I32F32::saturating_from_num(kp * p),
            ki_tick: I16F48::saturating_from_num(ki * i * TICK_S),
            kd_tick: I32F32::saturating_from_num(kd * d / TICK_S),
            feed_forward: I32F32::ZERO,
            integral_min: if self.thesis { 0 } else { -ticks },
            integral_max: ticks,
            period_us: 500,
            duty_steps: self.steps,
            law: if self.thesis { DriveLaw::ActiveLowTruncated } else { DriveLaw::OnTimeRounded },
            dead_band_counts: 0,
            conditional_integration: false,
            ..ConfigSpec::DEFAULT
        };
        // The thesis's constants are exact as named, and not quite their decimals.
        let spec = if self.thesis && fault.gains == [1.0; 4] { named } else { spec };
        Config::try_from(spec).expect("the gains drawn are a controller's")
    }
}

impl Fault {
    fn draw(name: &str, motor: &Motor, law: &Law, pitch: f64, dice: &mut Dice) -> (Self, BTreeMap<String, f64>) {
        let mut fault = Self {
            old_ticks: 0,
            gains: [1.0; 4],
            averaged: 1,
            gap: 0.0,
            miscount: 0,
            one_sense: false,
            load: [0.0; 2],
            spring: 0.0,
            ring: Ring::bumps(dice, 2, [0.3, 2.0]),
        };
        let (key, value) = match name {
            "gravity-load" => {
                // The weaker of what drives and what holds bears it, or the arm would run away.
                fault.load = [motor.contact.min(motor.brake) * dice.even(0.15, 0.5), dice.even(0.0, TAU)];
                ("load_rad_s2", fault.load[0])
            }
            "reversal-miscount" => {
                fault.miscount = dice.pick(&[-3, -2, -1, 1, 2, 3]);
                fault.one_sense = dice.chance(0.5);
                ("counts_per_reversal", f64::from(fault.miscount))
            }
            "backlash" => {
                fault.gap = pitch * dice.even(1.5, 7.0);
                ("gap_rad", fault.gap)
            }
            "loop-delay" => {
                fault.old_ticks = dice.whole(1, 10);
                ("delay_ticks", fault.old_ticks as f64)
            }
            "presliding" => {
                fault.spring = pitch * dice.even(0.5, 3.0);
                ("yielding_rad", fault.spring)
            }
            "controller-mismatch" => fault.mismatch(law, dice),
            _ => return (fault, BTreeMap::new()),
        };
        (fault, [(key.to_owned(), value)].into())
    }

    /// Another gain or limit than is named, or a filter that nobody wrote down.
    fn mismatch(&mut self, law: &Law, dice: &mut Dice) -> (&'static str, f64) {
        let factor = if dice.chance(0.5) { dice.even(1.2, 1.9) } else { dice.even(0.45, 0.83) };
        // The thesis's integral is worth less than a duty step: neither its gain nor its limit would show.
        match dice.pick(if law.thesis { &[0, 0, 2, 4] } else { &[0, 1, 2, 3, 4] }) {
            4 => {
                self.averaged = dice.whole(3, 12);
                ("samples_averaged", self.averaged as f64)
            }
            3 => {
                self.gains[3] = 0.3 * factor;
                ("integral_limit_factor", self.gains[3])
            }
            which => {
                self.gains[which] = factor;
                (["kp_factor", "ki_factor", "kd_factor"][which], factor)
            }
        }
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
        None => LOOPS[(seed % (LOOPS.len() as u64 - 1)) as usize],
    };
    let mut dice = Dice::new(seed, "d loop");
    let mut motor = Motor::draw(&mut dice);
    motor.crest = dice.decade(18.0, 70.0) * TAU / 60.0;
    motor.contact = motor.contact.max(motor.crest / 6e-3);
    motor = if name == "off-phase-braking" { motor.coasting(&mut dice) } else { motor.clamped(&mut dice) };
    let edges = dice.pick(&[200_usize, 256, 400, 400, 500, 800]);
    let law = Law::draw(&mut dice);
    let (fault, mut numbers) = Fault::draw(name, &motor, &law, TAU / edges as f64, &mut dice);
    if name == "off-phase-braking" {
        numbers.insert("brake_over_contact".to_owned(), motor.brake / motor.contact);
    }
    let runs = (0..RUNS).map(|k| run(&motor, &law, &fault, edges, k, &mut dice)).collect();
    let design = [edges as f64, RUNS as f64];
    let truth = Truth::of_loops(("d", seed), name, law.text(), numbers, motor.numbers(), design);
    Ok(Made { folder: Folder { name: format!("followed {seed}"), edges_per_rev: edges as u32, runs }, truth })
}

/// Where the rotor is to be: moves of least jerk between places, with rests, or a sum of three sines.
enum Course {
    /// Times in s and places in counts; from each to the next.
    Moves(Vec<[f64; 2]>),
    /// Amplitudes in counts, rates in rad/s, phases.
    Sines([[f64; 3]; 3]),
}

impl Course {
    /// One that asks for at most `most` counts/s and stays within 0.7 turns of `edges`.
    fn draw(dice: &mut Dice, most: f64, edges: f64) -> Self {
        if dice.chance(0.5) {
            let mut knots = vec![[0.0, 0.0]];
            let (mut t, mut place) = (dice.even(0.1, 0.5), 0.0);
            while t < SECONDS {
                // Short enough for some ten moves in a run.
                let next = f64::clamp(dice.even(-0.7, 0.7) * edges, place - 0.6 * most, place + 0.6 * most);
                knots.push([t, place]);
                // A move of least jerk is 15/8 as fast in its middle as on average.
                t += 1.875 * f64::abs(next - place) / (most * dice.even(0.5, 1.0)) + 0.05;
                knots.push([t, next]);
                t += dice.even(0.1, 0.8);
                place = next;
            }
            return Course::Moves(knots);
        }
        let mut sines =
            [0.4, 1.0, 2.5].map(|rate| [dice.even(0.2, 1.0), rate * dice.even(0.8, 1.4), dice.even(0.0, TAU)]);
        let speed: f64 = sines.iter().map(|[a, w, _]| a * w).sum();
        let way: f64 = sines.iter().map(|[a, _, _]| a).sum();
        let scale = (most / speed).min(0.7 * edges / way);
        sines.iter_mut().for_each(|s| s[0] *= scale);
        Course::Sines(sines)
    }

    fn at(&self, t: f64) -> f64 {
        match self {
            Course::Moves(knots) => {
                let n = knots.partition_point(|k| k[0] <= t);
                let (Some(from), Some(to)) = (knots.get(n.wrapping_sub(1)), knots.get(n)) else {
                    return knots.last().map_or(0.0, |k| k[1]);
                };
                let x = (t - from[0]) / (to[0] - from[0]);
                from[1] + (to[1] - from[1]) * x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
            }
            // From zero on, whatever the phases.
            Course::Sines(sines) => sines.iter().map(|[a, w, p]| a * ((w * t + p).sin() - p.sin())).sum(),
        }
    }
}

/// The encoder on a shaft that turns both ways.
struct Counter {
    seen: f64,
    cell: i64,
    sense: i64,
    count: i32,
}

impl Counter {
    fn follow(&mut self, shaft: f64, pitch: f64, phase: f64, fault: &Fault) {
        let half = 0.5 * fault.gap * (1.0 + 0.1 * fault.ring.at(shaft)).max(0.5);
        self.seen = self.seen.clamp(shaft - half, shaft + half);
        let now = (self.seen / pitch + phase).floor() as i64;
        while self.cell != now {
            let way = (now - self.cell).signum();
            self.cell += way;
            self.count += way as i32;
            if self.sense == -way {
                self.count += fault.miscount * if fault.one_sense { 1 } else { way as i32 };
            }
            self.sense = way;
        }
    }
}

fn run(motor: &Motor, law: &Law, fault: &Fault, edges: usize, k: usize, dice: &mut Dice) -> Run {
    let config = law.running(fault);
    let pitch = TAU / edges as f64;
    let gain = 1.0 + 0.01 * normal(dice);
    let most = dice.even(0.35, 0.6) * motor.crest / pitch;
    let course = Course::draw(dice, most, edges as f64);
    let phase = dice.even(0.0, 1.0);
    let mut rotor = Rotor::at(motor, 0.0);
    let mut counter = Counter { seen: 0.0, cell: 0, sense: 0, count: 0 };
    let mut state = State::REST;
    let mut late = VecDeque::from(vec![(0.0, 0.0, -1); fault.old_ticks]);
    let mut positions: VecDeque<i32> = VecDeque::new();
    let mut held = 0.0;
    let mut ticks = Vec::with_capacity((SECONDS / TICK_S) as usize);
    for tick in 0..(SECONDS / TICK_S).round() as u64 {
        let start = tick as f64 * TICK_S;
        let target = course.at(start).round() as i32;
        positions.push_back(counter.count);
        if positions.len() > fault.averaged {
            positions.pop_front();
        }
        let mean = positions.iter().map(|p| f64::from(*p)).sum::<f64>() / positions.len() as f64;
        let out = step(
            &config,
            &mut state,
            Inputs { target, target_rate: 0, position: mean.round() as i32, ..Inputs::default() },
        );
        let duty = f64::from(out.on_steps) / f64::from(law.steps);
        late.push_back((f64::from(out.u) / 65_536.0, duty, out.direction.sign()));
        let (u, duty, direction) = late.pop_front().expect("one was just put in");
        ticks.push(Tick { time_us: tick * 500, target, position: counter.count, u, duty, direction });
        if tick % PERIOD == 0 {
            held = duty;
        }
        // The pin switches within a tick.
        let off_s = (1.0 - held) * PERIOD as f64 * TICK_S;
        let switch = (tick - tick % PERIOD) as f64 * TICK_S + off_s;
        let end = start + TICK_S;
        for (until, on) in [(switch.clamp(start, end), false), (end, true)] {
            while rotor.t < until - 1e-10 {
                let load = -fault.load[0] * ((rotor.angle + fault.load[1]).sin() + 0.05 * fault.ring.at(rotor.angle));
                let factors = Factors { crest: gain, load, spring: fault.spring, ..Factors::default() };
                let on = on && held > 0.0;
                rotor.step(on, f64::from(direction), &factors, until - rotor.t);
                counter.follow(rotor.angle, pitch, phase, fault);
            }
        }
    }
    Run {
        id: format!("follow-{k}"),
        duty: 0.0,
        sign: 0.0,
        pwm_hz: 1.0 / (PERIOD as f64 * TICK_S),
        drive_on_s: SECONDS,
        order: k,
        aligned: false,
        record: Record::Control { law: law.text(), ticks },
    }
}
