//! The force factor from simulated speed runs whose true value is known, its rivals perturbed.

use twum_host::identify::force_factor::{Loaded, identify};
use twum_host::model::effects::EffectSet;
use twum_host::model::motor::Motor;
use twum_host::model::motor_plant::{History, Solver};
use twum_host::model::parameters::{Flavour, Parameters};
use twum_host::model::plant::Direction;
use twum_host::model::simulate::{PlantModel, Program, simulate};
use twum_host::record::measurement::{Direction as Sense, LevelEdge, Measurement, Run, RunData, RunKind};

fn model(parameters: Parameters) -> PlantModel {
    PlantModel::Motor { parameters, flavour: Flavour::Physical, solver: Solver::Averaged }
}

/// Edge records of the given motor at three duties, both ways.
fn measured(parameters: Parameters) -> Measurement {
    let mut runs = Vec::new();
    for duty in [0.4, 0.7, 1.0] {
        for (sense, direction) in [(Sense::Cw, Direction::Cw), (Sense::Ccw, Direction::Ccw)] {
            let mut program = Program::constant(duty, direction, 1.5, 1.6);
            program.encoder_phase_rad = 0.003 * duty;
            let trace = simulate(&program, &model(parameters), &EffectSet::default(), History::default());
            let mut level = trace.initial;
            let edges = trace
                .edges
                .iter()
                .map(|e| {
                    level = !level;
                    LevelEdge { time_us: e.time_s * 1e6, level }
                })
                .collect();
            let data = RunData::Edges { initial: trace.initial, start_us: 0.0, edges, end_us: 1.6e6 };
            let mut run = Run::new(format!("d{duty}-{sense:?}"), RunKind::Speed, data);
            (run.duty, run.direction, run.drive_on_s) = (Some(duty), Some(sense), Some(1.5));
            runs.push(run);
        }
    }
    Measurement {
        name: "synthetic".into(),
        motor: "pcbmotor-30mm".into(),
        edges_per_rev: 400,
        runs,
        folder: "synthetic".into(),
    }
}

#[test]
fn the_interval_holds_the_truth_though_the_motor_file_is_off() {
    let motor = Motor::pcbmotor_30mm();
    let base = motor.parameters(Flavour::Physical);
    let mut truth = base;
    truth.force_factor_n_v *= 1.08;
    truth.off_friction *= 1.07;
    truth.preload_n *= 0.94;
    let report = identify(&measured(truth), &[], &motor, Flavour::Physical).unwrap();
    print!("{}", report.text());
    let [low, high] = report.ci95;
    assert!(
        low < truth.force_factor_n_v && truth.force_factor_n_v < high,
        "{low} {high}, not {}",
        truth.force_factor_n_v
    );
    let [near, far] = report.ci95_others_exact;
    assert!(far - near < high - low);
    assert!(report.r2_speed.unwrap() > 0.99);
    // The supply multiplies the force factor in every equation: no data separate the two, and the report must say so.
    let supply = report.trades.iter().find(|t| t.with == "Vrms").unwrap();
    assert!(
        (supply.exchange + 1.0).abs() < 0.02 && supply.posterior_relative > 0.95 * supply.prior_relative,
        "{supply:?}"
    );
    assert!(report.notes.iter().any(|n| n.contains("Vrms")));
}

#[test]
fn loaded_speeds_narrow_what_speeds_alone_leave_open() {
    let motor = Motor::pcbmotor_30mm();
    let base = motor.parameters(Flavour::Physical);
    let alone = identify(&measured(base), &[], &motor, Flavour::Physical).unwrap();
    let loads: Vec<Loaded> = [0.002, 0.004, 0.006]
        .into_iter()
        .map(|load_nm| {
            let mut loaded = base;
            loaded.load_nm = load_nm;
            let program = |end_s| Program::constant(1.0, Direction::Cw, 2.0, end_s);
            let angle =
                |end_s| simulate(&program(end_s), &model(loaded), &EffectSet::default(), History::default()).end_rad;
            Loaded { duty: 1.0, load_nm, rpm: (angle(1.0) - angle(0.5)) / 0.5 * 30.0 / std::f64::consts::PI }
        })
        .collect();
    let with = identify(&measured(base), &loads, &motor, Flavour::Physical).unwrap();
    // Where the encoder stood at the start is not told: it shifts the lags by milliseconds, and η with them.
    assert!((with.eta_n_v / base.force_factor_n_v - 1.0).abs() < 0.05, "{}", with.eta_n_v);
    assert!((with.ci95[0]..with.ci95[1]).contains(&base.force_factor_n_v));
    let width = |r: &twum_host::identify::force_factor::Report| (r.ci95[1] / r.ci95[0]).ln();
    assert!(width(&with) < width(&alone), "{} {}", width(&with), width(&alone));
    assert!(!with.notes.iter().any(|n| n.contains("no loaded run")));
}

#[test]
fn no_runs_is_said_so() {
    let motor = Motor::pcbmotor_30mm();
    let mut empty = measured(motor.parameters(Flavour::Physical));
    empty.runs.truncate(1);
    empty.runs[0].duty = None;
    let message = identify(&empty, &[], &motor, Flavour::Physical).unwrap_err().to_string();
    assert!(message.contains("no speed run"), "{message}");
}
