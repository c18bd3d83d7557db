//! Closed loops: the same rotor under the chip's control step, with something hidden in the loop.
//!
//! The step is the contract itself (`twum_shared`), not a model.

use super::effects::Factors;
use super::motion::{LISTED_CONTACT, Rotor};
use super::shape::{between, log_between, normal, one_of};
use crate::folder::{Folder, Record, Run, Tick};
use crate::truth::{Made, Request, Truth};
use fixed::types::{I16F48, I32F32};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, VecDeque};
use std::f64::consts::TAU;
use twum_shared::step::{Config, ConfigSpec, DriveLaw, Inputs, State, step};

/// Effects of closed loops, and nothing.
pub const LOOPS: [&str; 7] =
    ["none", "gravity-load", "reversal-miscount", "backlash", "loop-delay", "controller-mismatch", "off-phase-braking"];

const RUNS: usize = 3;
const SECONDS: f64 = 15.0;
/// Steps of the rotor a tick.
const SUB: usize = 10;

/// What is hidden in the loop.
#[derive(Debug, Clone, Copy, Default)]
struct Fault {
    /// Ticks between a sample and the control signal made of it.
    delay: usize,
    /// Factors on kp, ki and kd.
    gains: [f64; 3],
    /// Gap between rotor and encoder in rad.
    gap: f64,
    /// Counts added at each reversal in the new sense, and always in the same sense.
    miscount: [i32; 2],
    /// Amplitude of the load over inertia in rad/s², and the angle where it vanishes.
    gravity: [f64; 2],
}

/// Makes the data set of a seed.
///
/// # Errors
/// An effect that no closed loop has.
pub fn make(seed: u64, request: &Request) -> Result<Made, String> {
    let name = match request.effects.first() {
        None => LOOPS[(seed % LOOPS.len() as u64) as usize],
        Some(asked) => *LOOPS
            .iter()
            .find(|n| *n == asked)
            .ok_or_else(|| format!("no effect {asked} of closed loops: one of {}", LOOPS.join(", ")))?,
    };
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x1009);
    let mut rotor = Rotor::draw(&mut rng);
    rotor.crest = log_between(&mut rng, 18.0, 70.0) * TAU / 60.0;
    rotor.contact = LISTED_CONTACT * log_between(&mut rng, 0.3, 10.0);
    rotor.brake = rotor.contact * between(&mut rng, 0.8, 1.2);
    let edges: u32 = one_of(&mut rng, &[200, 360, 400, 500, 720]);
    let law = Law::draw(&mut rng);
    let (fault, numbers) = Fault::draw(name, &mut rotor, &law, edges, &mut rng);
    let runs = (0..RUNS).map(|k| run(&rotor, &law, &fault, edges, k, rng.random())).collect();
    let design = [f64::from(edges), RUNS as f64];
    let truth = Truth::of_loops(("b", seed), name, law.text(), numbers, rotor.numbers(), design);
    Ok(Made { folder: Folder { name: format!("loop {seed}"), edges_per_rev: edges, runs }, truth })
}

/// The controller as the folder says it.
#[derive(Debug, Clone, Copy)]
enum Law {
    Thesis,
    /// kp, ki, kd in duty steps per count, count·s and count/s; duty steps; limit of the integral in count·s.
    Table {
        gains: [f64; 3],
        steps: u16,
        integral: f64,
    },
}

impl Law {
    fn draw(rng: &mut ChaCha8Rng) -> Self {
        if rng.random::<f64>() < 0.5 {
            return Law::Thesis;
        }
        let steps = one_of(rng, &[64_u16, 256, 1024]);
        let scale = f64::from(steps) / 32.0;
        let digits = |x: f64| (x * 1e4).round() / 1e4;
        Law::Table {
            gains: [
                digits(scale * log_between(rng, 0.7, 2.5)),
                digits(scale * log_between(rng, 0.2, 2.0)),
                digits(scale * log_between(rng, 0.002, 0.01)),
            ],
            steps,
            integral: one_of(rng, &[5.0, 10.0, 20.0]),
        }
    }

    fn text(&self) -> String {
        match self {
            Law::Thesis => "\"thesis\"".to_owned(),
            Law::Table { gains: [kp, ki, kd], steps, integral } => format!(
                "{{ kp = {kp}, ki = {ki}, kd = {kd}, period_us = 500, duty_steps = {steps}, integral_min = -{integral:.1}, integral_max = {integral:.1} }}"
            ),
        }
    }

    /// The step's configuration with each gain multiplied.
    fn config(&self, factors: [f64; 3]) -> ConfigSpec {
        let Law::Table { gains, steps, integral } = self else {
            let t = ConfigSpec::THESIS;
            return ConfigSpec {
                kp: I32F32::saturating_from_num(t.kp.to_num::<f64>() * factors[0]),
                ki_tick: I16F48::saturating_from_num(t.ki_tick.to_num::<f64>() * factors[1]),
                kd_tick: I32F32::saturating_from_num(t.kd_tick.to_num::<f64>() * factors[2]),
                ..t
            };
        };
        let period_s = 500e-6;
        let limit = (integral / period_s).round() as i32;
        ConfigSpec {
            kp: I32F32::saturating_from_num(gains[0] * factors[0]),
            ki_tick: I16F48::saturating_from_num(gains[1] * factors[1] * period_s),
            kd_tick: I32F32::saturating_from_num(gains[2] * factors[2] / period_s),
            feed_forward: I32F32::ZERO,
            integral_min: -limit,
            integral_max: limit,
            period_us: 500,
            duty_steps: *steps,
            law: DriveLaw::OnTimeRounded,
            dead_band_counts: 0,
            conditional_integration: false,
            ..ConfigSpec::DEFAULT
        }
    }
}

impl Fault {
    fn draw(
        name: &str,
        rotor: &mut Rotor,
        law: &Law,
        edges: u32,
        rng: &mut ChaCha8Rng,
    ) -> (Self, BTreeMap<String, f64>) {
        let mut fault = Self { gains: [1.0; 3], ..Self::default() };
        let pitch = TAU / f64::from(edges);
        let sign = if rng.random() { 1 } else { -1 };
        let mut numbers = BTreeMap::new();
        let mut put = |key: &str, value: f64| {
            numbers.insert(key.to_owned(), value);
        };
        match name {
            "gravity-load" => {
                fault.gravity = [rotor.contact * between(rng, 0.15, 0.5), between(rng, 0.0, TAU)];
                put("load_rad_s2", fault.gravity[0]);
            }
            "reversal-miscount" => {
                let n = sign * rng.random_range(1..=3);
                fault.miscount = if rng.random() { [n, 0] } else { [0, n] };
                put("counts_per_reversal", f64::from(n));
            }
            "backlash" => {
                fault.gap = pitch * between(rng, 1.5, 6.0);
                put("gap_rad", fault.gap);
            }
            "loop-delay" => {
                fault.delay = rng.random_range(1..=10);
                put("delay_ticks", fault.delay as f64);
            }
            "controller-mismatch" => {
                // The thesis's integral is worth less than a duty step at its limit: its gain could not be seen.
                let which = one_of(rng, if matches!(law, Law::Thesis) { &[0, 0, 2] } else { &[0, 1, 2] });
                let factor = if rng.random() { between(rng, 1.15, 1.8) } else { between(rng, 0.5, 0.85) };
                fault.gains[which] = factor;
                put(["kp_factor", "ki_factor", "kd_factor"][which], factor);
            }
            "off-phase-braking" => {
                rotor.brake = rotor.contact * log_between(rng, 0.01, 0.2);
                put("brake_rad_s2", rotor.brake);
            }
            _ => {}
        }
        (fault, numbers)
    }
}

/// The encoder on a rotor that may turn back.
struct Counter {
    angle: f64,
    cell: i64,
    sense: i32,
    position: i32,
}

impl Counter {
    fn follow(&mut self, rotor: f64, pitch: f64, phase: f64, fault: &Fault) {
        self.angle = self.angle.clamp(rotor - 0.5 * fault.gap, rotor + 0.5 * fault.gap);
        let now = (self.angle / pitch + phase).floor() as i64;
        while self.cell != now {
            let way = (now - self.cell).signum() as i32;
            self.cell += i64::from(way);
            self.position += way;
            if self.sense != 0 && way != self.sense {
                self.position += way * fault.miscount[0] + fault.miscount[1];
            }
            self.sense = way;
        }
    }
}

fn run(rotor: &Rotor, law: &Law, fault: &Fault, edges: u32, k: usize, seed: u64) -> Run {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let config = Config::try_from(law.config(fault.gains)).expect("a changed gain is still a controller");
    let steps = f64::from(config.spec().duty_steps);
    let pitch = TAU / f64::from(edges);
    // Two sines whose rates together stay below what the motor can follow.
    let fastest = 0.6 * rotor.crest / pitch;
    let [w1, w2] = [log_between(&mut rng, 0.5, 2.0), log_between(&mut rng, 1.5, 5.0)];
    let share = between(&mut rng, 0.6, 1.0);
    let (a1, a2) = ((share * fastest / w1).min(0.4 * f64::from(edges)), (1.0 - share) * fastest / w2);
    let factors = |sign: f64, angle: f64, gain: f64| Factors {
        gain,
        load: -sign * fault.gravity[0] * (angle + fault.gravity[1]).sin(),
        ..Factors::default()
    };
    let gain = 1.0 + 0.01 * normal(&mut rng);
    let phase = rng.random::<f64>();
    let mut control = State::REST;
    let mut late = VecDeque::from(vec![(0.0, 0.0, -1); fault.delay]);
    let mut counter = Counter { angle: 0.0, cell: 0, sense: 0, position: 0 };
    let (mut speed, mut angle, mut wave, mut latched, mut turning) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0, -1);
    let dt = 500e-6 / SUB as f64;
    let mut ticks = Vec::with_capacity((SECONDS / 500e-6) as usize);
    for tick in 0..(SECONDS / 500e-6) as u64 {
        let time_us = tick * 500;
        let t = time_us as f64 * 1e-6;
        let target = (a1 * (w1 * t).sin() + a2 * (w2 * t).sin()).trunc() as i32;
        let out = step(
            &config,
            &mut control,
            Inputs { target, target_rate: 0, position: counter.position, ..Inputs::default() },
        );
        late.push_back((f64::from(out.u) / 65_536.0, f64::from(out.on_steps) / steps, out.direction.sign()));
        let (u, duty, direction) = late.pop_front().unwrap_or((0.0, 0.0, -1));
        ticks.push(Tick { time_us, target, position: counter.position, u, duty, direction });
        if time_us.is_multiple_of(20_000) {
            latched = duty;
        }
        if direction != turning {
            // The other way round is another wave: it has to build up.
            (turning, wave) = (direction, 0.0);
        }
        let sign = f64::from(direction);
        for n in 0..SUB {
            let within = (time_us % 20_000) as f64 * 1e-6 + (n as f64 + 0.5) * dt;
            let goal = if within >= (1.0 - latched) * 0.02 { 1.0 } else { 0.0 };
            wave = goal + (wave - goal) * (-dt / rotor.wave_s).exp();
            let next = sign * rotor.after(sign * speed, wave, &factors(sign, angle, gain), dt);
            angle += 0.5 * (speed + next) * dt;
            speed = next;
            counter.follow(angle, pitch, phase, fault);
        }
    }
    Run {
        id: format!("loop{k}"),
        duty: 0.0,
        sign: 0.0,
        pwm_hz: 50.0,
        drive_on_s: SECONDS,
        order: k,
        aligned: false,
        record: Record::Control { law: law.text(), ticks },
    }
}
