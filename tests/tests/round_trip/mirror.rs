//! The motor model's own data: an experiment, simulated run by run and sampled as a board samples.

use twum_host::model::effects::EffectSet;
use twum_host::model::motor_plant::{History, Solver};
use twum_host::model::parameters::{Flavour, Parameters};
use twum_host::model::plant::Direction as Sense;
use twum_host::model::simulate::{PlantModel, Program, Trace, simulate};
use twum_host::record::measurement::{Direction, Format, Measurement, Run, RunData, RunKind};

pub const FLAVOUR: Flavour = Flavour::Physical;
const EDGES: u32 = 400;

/// The runs of an experiment.
#[derive(Clone, Copy)]
pub struct Design {
    pub duties: &'static [f64],
    pub trials: usize,
    pub seconds: f64,
}

/// Over the whole range, in no order.
pub const DUTIES: &[f64] = &[0.5, 0.18, 0.83, 1.0, 0.33, 0.66];

fn order(design: Design) -> Vec<(f64, Sense)> {
    (0..design.trials)
        .flat_map(|trial| design.duties.iter().enumerate().map(move |(k, duty)| (trial + k, *duty)))
        .flat_map(|(k, duty)| {
            let senses = if k % 2 == 0 { [Sense::Cw, Sense::Ccw] } else { [Sense::Ccw, Sense::Cw] };
            senses.map(|sense| (duty, sense))
        })
        .collect()
}

/// One run after the other, each with what the motor remembers of those before.
pub fn traces(design: Design, parameters: Parameters, effects: &EffectSet) -> Vec<Trace> {
    let model = PlantModel::Motor { parameters, flavour: FLAVOUR, solver: Solver::Averaged };
    let mut history = History::default();
    order(design)
        .into_iter()
        .enumerate()
        .map(|(k, (duty, sense))| {
            let mut program = Program::constant(duty, sense, design.seconds, design.seconds + 0.15);
            program.edges_per_rev = EDGES;
            program.encoder_phase_rad = std::f64::consts::TAU / f64::from(EDGES) * (k as f64 * 0.618).fract();
            let trace = simulate(&program, &model, effects, history);
            history = trace.history;
            trace
        })
        .collect()
}

/// The line as sampled once a millisecond.
fn levels(trace: &Trace) -> RunData {
    let (mut level, mut next) = (trace.initial, 0);
    let levels = (0..(trace.end_s * 1e3) as usize)
        .map(|n| {
            while next < trace.edges.len() && trace.edges[next].time_s <= n as f64 * 1e-3 {
                level = trace.edges[next].level;
                next += 1;
            }
            level
        })
        .collect();
    RunData::Levels { start_us: 0.0, period_us: 1000.0, levels }
}

pub fn measurement(design: Design, traces: &[Trace]) -> Measurement {
    let runs = order(design)
        .into_iter()
        .zip(traces)
        .enumerate()
        .map(|(k, ((duty, sense), trace))| Run {
            id: format!("r{k:02}"),
            kind: RunKind::Speed,
            file: String::new(),
            format: Format::Levels,
            duty: Some(duty),
            direction: Some(if sense == Sense::Cw { Direction::Cw } else { Direction::Ccw }),
            pwm_hz: 50.0,
            drive_on_s: Some(design.seconds),
            pwm_phase_s: 0.0,
            aligned: false,
            order: Some(k as u32),
            control: None,
            data: levels(trace),
        })
        .collect();
    Measurement {
        name: "mirror".into(),
        motor: "pcbmotor-30mm".into(),
        edges_per_rev: EDGES,
        runs,
        folder: "mirror".into(),
    }
}

/// Root mean square difference of the runs' mean speeds, as a share of the root mean square speed.
pub fn difference(made: &[Trace], replayed: &[Trace]) -> f64 {
    let mean = |t: &Trace| t.edges.len() as f64 / t.end_s;
    let squares: f64 = made.iter().zip(replayed).map(|(a, b)| (mean(b) - mean(a)).powi(2)).sum();
    (squares / made.iter().map(|a| mean(a).powi(2)).sum::<f64>()).sqrt()
}
