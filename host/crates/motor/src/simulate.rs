//! One simulated run: what an encoder on the motor would have recorded.

use super::actuator::{Command, Pwm};
use super::effects::EffectSet;
use super::inertial::{InertialParameters, InertialPlant};
use super::motor_plant::{History, MotorPlant, Solver};
use super::parameters::{Flavour, Parameters};
use super::plant::{Direction, Plant};
use super::sensor::{Edge, Encoder, record};

/// A run to simulate: when the motor is told what, and how it is watched.
#[derive(Debug, Clone, PartialEq)]
pub struct Program {
    /// Commands in order of time; the first at or before 0 is in force from the start.
    pub commands: Vec<Command>,
    /// PWM frequency (Hz).
    pub pwm_hz: f64,
    /// Time from the start of a PWM period to t = 0 (s).
    pub pwm_phase_s: f64,
    /// End of the run (s).
    pub end_s: f64,
    /// Edges of the encoder a revolution.
    pub edges_per_rev: u32,
    /// How far past an edge the encoder stands at the start (rad).
    pub encoder_phase_rad: f64,
}

impl Program {
    /// A constant duty from 0 to `drive_on_s`, watched until `end_s`; 50 Hz PWM, 400 edges.
    pub fn constant(duty: f64, direction: Direction, drive_on_s: f64, end_s: f64) -> Self {
        Program {
            commands: vec![
                Command { time_s: 0.0, duty, direction },
                Command { time_s: drive_on_s, duty: 0.0, direction },
            ],
            pwm_hz: 50.0,
            pwm_phase_s: 0.0,
            end_s,
            edges_per_rev: 400,
            encoder_phase_rad: 0.0,
        }
    }
}

/// What turns in a simulated run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PlantModel {
    /// A travelling-wave motor.
    Motor {
        /// Its parameters.
        parameters: Parameters,
        /// The reading of the model.
        flavour: Flavour,
        /// Averaged for speed, carrier to check it.
        solver: Solver,
    },
    /// An ordinary motor.
    Inertial(InertialParameters),
}

/// What was recorded.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trace {
    /// Level of the line at the start.
    pub initial: bool,
    /// Its edges, on the recorder's clock.
    pub edges: Vec<Edge>,
    /// End of the record, on the recorder's clock (s).
    pub end_s: f64,
    /// Angle at the end of the run (rad).
    pub end_rad: f64,
    /// What the motor remembers for the next run.
    pub history: History,
}

/// Simulates a run.
pub fn simulate(program: &Program, model: &PlantModel, effects: &EffectSet, history: History) -> Trace {
    let mut trace = Trace::default();
    simulate_into(program, model, effects, history, &mut trace);
    trace
}

/// As [`simulate`], into a trace whose memory is used again.
pub fn simulate_into(program: &Program, model: &PlantModel, effects: &EffectSet, history: History, trace: &mut Trace) {
    match *model {
        PlantModel::Motor { parameters, flavour, solver } => {
            let mut plant = MotorPlant::new(parameters, flavour, solver, effects, history);
            drive(program, &mut plant, effects, trace);
            trace.history = plant.history();
        }
        PlantModel::Inertial(parameters) => {
            let mut plant = InertialPlant::new(parameters, effects);
            drive(program, &mut plant, effects, trace);
            trace.history = history;
        }
    }
}

fn drive(program: &Program, plant: &mut impl Plant, effects: &EffectSet, trace: &mut Trace) {
    let mut encoder = Encoder::new(program.edges_per_rev, program.encoder_phase_rad, effects);
    let mut pwm = Pwm::new(program.pwm_hz, program.pwm_phase_s, effects);
    trace.initial = encoder.level();
    trace.edges.clear();
    let edges = &mut trace.edges;
    let mut commands = program.commands.iter().peekable();
    while let Some(command) = commands.next_if(|command| command.time_s <= 0.0) {
        pwm.begin(command.duty, command.direction);
    }
    while plant.time_s() < program.end_s {
        let until = commands.peek().map_or(program.end_s, |command| command.time_s.min(program.end_s));
        pwm.advance(plant, until, &mut |segment| encoder.watch(segment, &mut |edge| edges.push(edge)));
        while let Some(command) = commands.next_if(|command| command.time_s <= plant.time_s()) {
            pwm.command(command.duty, command.direction);
        }
    }
    trace.end_rad = plant.position_rad();
    trace.end_s = record(edges, program.end_s, effects);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::Motor;

    fn averaged(flavour: Flavour) -> PlantModel {
        let parameters = Motor::pcbmotor_30mm().parameters(flavour);
        PlantModel::Motor { parameters, flavour, solver: Solver::Averaged }
    }

    #[test]
    fn the_two_directions_mirror_each_other() {
        for flavour in [Flavour::Thesis, Flavour::Physical] {
            let [cw, ccw] = [Direction::Cw, Direction::Ccw].map(|direction| {
                let program = Program::constant(0.5, direction, 0.5, 0.6);
                simulate(&program, &averaged(flavour), &EffectSet::default(), History::default()).end_rad
            });
            assert!(cw > 0.5 && (cw + ccw).abs() < 1e-9 * cw, "{flavour}: {cw} and {ccw}");
        }
    }

    #[test]
    fn the_same_run_gives_the_same_edges() {
        let program = Program::constant(0.4, Direction::Cw, 0.4, 0.5);
        let run = || simulate(&program, &averaged(Flavour::Physical), &EffectSet::default(), History::default());
        assert_eq!(run(), run());
    }

    #[test]
    fn edges_lie_a_pitch_apart_on_the_rotor() {
        let program = Program::constant(1.0, Direction::Cw, 0.5, 0.5);
        let trace = simulate(&program, &averaged(Flavour::Physical), &EffectSet::default(), History::default());
        let speed = 2.0 * std::f64::consts::PI / 400.0 / (trace.edges[20].time_s - trace.edges[19].time_s);
        let mean = (trace.edges[25].time_s - trace.edges[15].time_s) / 10.0;
        assert!((speed * mean * 400.0 / (2.0 * std::f64::consts::PI) - 1.0).abs() < 1e-3);
    }
}
