//! Closed loops: the generator's motor under the control step of the chip, with something hidden in the loop.
//!
//! The step is the contract itself (`twum_shared`), not a model; the motor, the PWM and the encoder are the generator's own.

use crate::motor::{ContactTable, Drive, Motor, State, step as advance};
use crate::noise::normal;
use crate::trace::PITCH;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use std::fmt::Write as _;
use std::path::Path;
use twum_shared::step::{Config, ConfigSpec, Inputs, State as ControlState, step};

/// What is hidden in the loop.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct HiddenInLoop {
    /// Ticks between a sample and the control signal made of it.
    pub delay_ticks: usize,
    /// Factors on kp and ki, less 1.
    pub gain_error: [f64; 2],
    /// Gap between rotor and encoder in rad.
    pub gap_rad: f64,
    /// Counts added at each reversal, in the new sense.
    pub miscount: i32,
    /// Counts added at each reversal, always in the same sense.
    pub drift: i32,
}

/// One tick as it is logged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// Time in µs.
    pub time_us: u64,
    /// Target and counted position in counts.
    pub target: i32,
    /// Counted position in counts.
    pub position: i32,
    /// Control signal in duty steps.
    pub u: f64,
    /// On fraction.
    pub duty: f64,
    /// 1 clockwise, -1 counter-clockwise.
    pub direction: i32,
}

const TICK_US: u64 = 500;
const PWM_US: u64 = 20_000;
const SUB: usize = 10;

/// Eight sines under the thesis's controller, each of 6 s, with `hidden` in the loop.
pub fn sines(hidden: &HiddenInLoop, seed: u64) -> Vec<Vec<Row>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x7ac1);
    let mut spread = |width: f64| 1.0 + rng.random_range(-width..width);
    let base = Motor::default();
    let motor = Motor {
        crest_speed: base.crest_speed * spread(0.1),
        contact: base.contact * spread(0.15),
        off_friction: base.off_friction * spread(0.25),
        ..base
    };
    let table = ContactTable::new(&motor);
    let shapes = [(89.0, 1.257), (60.0, 2.5), (140.0, 0.9), (89.0, 1.8)];
    (0..8)
        .map(|k| {
            let (amplitude, omega) = shapes[k % shapes.len()];
            let gain = 1.0 + normal(&mut rng, 0.01);
            let phase = rng.random::<f64>();
            sine(&motor, &table, gain, phase, amplitude, omega, hidden)
        })
        .collect()
}

fn sine(
    motor: &Motor,
    table: &ContactTable,
    gain: f64,
    phase: f64,
    amplitude: f64,
    omega: f64,
    hidden: &HiddenInLoop,
) -> Vec<Row> {
    let mut spec = ConfigSpec::THESIS;
    spec.kp = spec.kp.saturating_mul(fixed(1.0 + hidden.gain_error[0]));
    spec.ki_tick = fixed_small(spec.ki_tick.to_num::<f64>() * (1.0 + hidden.gain_error[1]));
    let config = Config::try_from(spec).expect("a changed gain is still a controller");
    let steps = f64::from(spec.duty_steps);
    let mut control = ControlState::REST;
    let mut late = VecDeque::from(vec![(0.0, 0.0, -1); hidden.delay_ticks]);
    let mut rotor = State::default();
    let mut encoder_angle: f64 = 0.0;
    let mut cell = phase.floor() as i64;
    let (mut position, mut sense) = (0, 0);
    let mut latched = 0.0;
    let dt = TICK_US as f64 * 1e-6 / SUB as f64;
    (0..12_000u64)
        .map(|tick| {
            let time_us = tick * TICK_US;
            let target = (amplitude * (omega * time_us as f64 * 1e-6).sin()).trunc() as i32;
            let out = step(&config, &mut control, Inputs { target, position, ..Inputs::default() });
            let made = (f64::from(out.u) / 65_536.0, f64::from(out.on_steps) / steps, out.direction.sign());
            late.push_back(made);
            let (u, duty, direction) = late.pop_front().unwrap_or(made);
            let row = Row { time_us, target, position, u, duty, direction };
            if time_us.is_multiple_of(PWM_US) {
                latched = duty;
            }
            for n in 0..SUB {
                let within = (time_us % PWM_US) as f64 * 1e-6 + (n as f64 + 0.5) * dt;
                let on = within >= (1.0 - latched) * PWM_US as f64 * 1e-6;
                let drive = Drive { on, sign: f64::from(direction), gain, ..Drive::default() };
                advance(motor, table, &mut rotor, &drive, dt);
                encoder_angle =
                    encoder_angle.clamp(rotor.angle - 0.5 * hidden.gap_rad, rotor.angle + 0.5 * hidden.gap_rad);
                let now = (encoder_angle / PITCH + phase).floor() as i64;
                while cell != now {
                    let way = (now - cell).signum() as i32;
                    cell += i64::from(way);
                    position += way;
                    if sense != 0 && way != sense {
                        position += way * hidden.miscount + hidden.drift;
                    }
                    sense = way;
                }
            }
            row
        })
        .collect()
}

fn fixed(value: f64) -> fixed::types::I32F32 {
    fixed::types::I32F32::saturating_from_num(value)
}

fn fixed_small(value: f64) -> fixed::types::I16F48 {
    fixed::types::I16F48::saturating_from_num(value)
}

/// Writes runs as a measurement folder.
pub fn write(runs: &[Vec<Row>], folder: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    let mut toml = String::from("name = \"closed loop\"\nmotor = \"pcbmotor-30mm\"\nedges_per_rev = 400\n");
    for (k, rows) in runs.iter().enumerate() {
        let mut csv = String::from("time_us,target,position,u,duty,direction\n");
        for r in rows {
            writeln!(csv, "{},{},{},{:.5},{:.6},{}", r.time_us, r.target, r.position, r.u, r.duty, r.direction)
                .expect("writing to a string cannot fail");
        }
        std::fs::write(folder.join(format!("sine{k}.csv")), csv)?;
        write!(
            toml,
            "\n[[run]]\nid = \"sine{k}\"\nkind = \"track\"\nfile = \"sine{k}.csv\"\nformat = \"control\"\ncontrol = \"thesis\"\norder = {k}\n"
        )
        .expect("writing to a string cannot fail");
    }
    std::fs::write(folder.join("measurement.toml"), toml)
}
