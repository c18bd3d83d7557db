//! The force factor from simulated speed runs whose true value is known, its rivals perturbed.
//!
//! The coverage studies are for release builds: `cargo test --release -p twum-tests --test identify_force_factor -- --nocapture`.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use std::f64::consts::TAU;
use twum_host::identify::force_factor::{Loaded, Report, TorqueRuns, Trade, identify};
use twum_host::model::effects::EffectSet;
use twum_host::model::motor::Entry;
use twum_host::model::motor::Motor;
use twum_host::model::motor_plant::{History, Solver};
use twum_host::model::parameters::{Flavour, Parameters};
use twum_host::model::plant::Direction;
use twum_host::model::simulate::{PlantModel, Program, simulate};
use twum_host::record::measurement::{Direction as Sense, LevelEdge, Measurement, Run, RunData, RunKind};
use twum_host::report::identified::text;
use twum_tests::carrier::{Carrier, CarrierState};

fn model(parameters: Parameters) -> PlantModel {
    PlantModel::Motor { parameters, flavour: Flavour::Physical, solver: Solver::Averaged }
}

/// A speed run from the times of its edges.
fn run(duty: f64, sense: Sense, initial: bool, times_s: impl Iterator<Item = f64>, end_s: f64) -> Run {
    let mut level = initial;
    let edges = times_s
        .map(|t| {
            level = !level;
            LevelEdge { time_us: t * 1e6, level }
        })
        .collect();
    let data = RunData::Edges { initial, start_us: 0.0, edges, end_us: end_s * 1e6 };
    let mut run = Run::new(format!("d{duty}-{sense:?}"), RunKind::Speed, data);
    (run.duty, run.direction, run.drive_on_s) = (Some(duty), Some(sense), Some(end_s - 0.1));
    run
}

fn measurement(runs: Vec<Run>) -> Measurement {
    Measurement {
        name: "synthetic".into(),
        motor: "pcbmotor-30mm".into(),
        edges_per_rev: 400,
        runs,
        folder: "synthetic".into(),
    }
}

/// Edge records of the given motor at three duties, both ways.
fn measured(parameters: Parameters) -> Measurement {
    repeated(parameters, 1, &mut |duty| (0.003 * duty, 1.0))
}

/// The same, repeated; `each` says for a duty where the encoder stands (rad) and by what factor this run is slower.
fn repeated(parameters: Parameters, trials: usize, each: &mut dyn FnMut(f64) -> (f64, f64)) -> Measurement {
    let mut runs = Vec::new();
    for duty in [0.4, 0.7, 1.0] {
        for (sense, direction) in [(Sense::Cw, Direction::Cw), (Sense::Ccw, Direction::Ccw)] {
            for _ in 0..trials {
                let mut program = Program::constant(duty, direction, 1.5, 1.6);
                let slower;
                (program.encoder_phase_rad, slower) = each(duty);
                let trace = simulate(&program, &model(parameters), &EffectSet::default(), History::default());
                let times = trace.edges.iter().map(|e| e.time_s * slower);
                runs.push(run(duty, sense, trace.initial, times, 1.6 * slower));
            }
        }
    }
    measurement(runs)
}

/// The parameters with one of the report's rivals scaled.
fn scale(p: &mut Parameters, name: &str, k: f64) {
    match name {
        "stator" => {
            p.modal_mass_kg *= k;
            p.modal_damping_ns_m *= k;
            p.modal_stiffness_n_m *= k;
        }
        "Vrms" => p.vrms_v *= k,
        "f" => p.frequency_hz *= k,
        "Rr" => p.radial_shape *= k,
        "Fext" => p.preload_n *= k,
        "u" => p.friction *= k,
        "uoff" => p.off_friction *= k,
        "Ctheta" => p.rotational_damping_nms *= k,
        "Cn" => p.contact_stiffness_n_m2 *= k,
        other => panic!("{other} is no rival this study knows"),
    }
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// How often the intervals hold the force factor behind the data.
struct Coverage {
    whole: f64,
    others_exact: f64,
    /// Root mean square of ln(η/truth), and the median half-width of the interval on the same scale.
    error: f64,
    half_width: f64,
    with_torque: f64,
    half_width_with_torque: f64,
}

/// A motor drawn from a seed that turns fast enough to be seen: its force factor, and what is said of it from its speeds alone and with
/// torque runs.
fn asked(motor: &Motor, known: &[Trade], seed: u64) -> (f64, Report, Report) {
    let base = motor.parameters(Flavour::Physical);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    loop {
        let mut truth = base;
        truth.force_factor_n_v *= (0.6 * (rng.random::<f64>() - 0.5)).exp();
        for rival in known {
            scale(&mut truth, &rival.with, (rival.prior_relative * normal(&mut rng)).exp());
        }
        let mut each = |_| (TAU / 400.0 * rng.random::<f64>(), 1.0 + 0.01 * normal(&mut rng));
        let data = repeated(truth, 2, &mut each);
        let least = data.runs.iter().map(|r| match &r.data {
            RunData::Edges { edges, .. } => edges.len(),
            _ => 0,
        });
        if least.min().unwrap() < 30 {
            continue;
        }
        let stall = truth.friction * truth.preload_n * truth.contact_radius_m;
        let loaded = [0.2, 0.5]
            .map(|share| {
                let load_nm = share * stall;
                let rpm = steady_rpm(truth, load_nm) * (1.0 + 0.02 * normal(&mut rng));
                Loaded { duty: 1.0, load_nm, rpm }
            })
            .into();
        let torque = TorqueRuns { loaded, stall_nm: vec![stall * (1.0 + 0.02 * normal(&mut rng))] };
        let alone = identify(&data, &TorqueRuns::default(), motor, Flavour::Physical).unwrap();
        let with = identify(&data, &torque, motor, Flavour::Physical).unwrap();
        return (truth.force_factor_n_v, alone, with);
    }
}

/// Motors drawn from what the motor file says is known, each measured with 1 % of scatter from run to run (`seeds` of them
/// that turn at every duty), identified from the unchanged motor file without and with torque runs.
fn coverage(motor: &Motor, seeds: u64, first: u64) -> Coverage {
    let base = motor.parameters(Flavour::Physical);
    let known = identify(&measured(base), &TorqueRuns::default(), motor, Flavour::Physical).unwrap().trades;
    let found: Vec<(f64, Report, Report)> =
        (first..first + seeds).into_par_iter().map(|seed| asked(motor, &known, seed)).collect();
    let n = found.len() as f64;
    for (seed, (truth, alone, _)) in (first..).zip(&found) {
        let [low, high] = alone.ci95;
        if !(low <= *truth && *truth <= high) {
            println!(
                "  motor {seed}: {truth:.4} outside {low:.4} to {high:.4}, estimate {:.4}, misfit {:.2}",
                alone.eta_n_v, alone.misfit
            );
        }
    }
    let share = |of: &dyn Fn(&Report) -> [f64; 2], torque: bool| {
        let inside = |(truth, alone, with): &&(f64, Report, Report)| {
            let [low, high] = of(if torque { with } else { alone });
            low <= *truth && *truth <= high
        };
        found.iter().filter(inside).count() as f64 / n
    };
    let width = |torque: bool| {
        let half = |(_, alone, with): &(f64, Report, Report)| {
            let [low, high] = if torque { with.ci95 } else { alone.ci95 };
            0.5 * (high / low).ln()
        };
        let mut widths: Vec<f64> = found.iter().map(half).collect();
        widths.sort_by(f64::total_cmp);
        widths[widths.len() / 2]
    };
    let coverage = Coverage {
        whole: share(&|r| r.ci95, false),
        others_exact: share(&|r| r.ci95_others_exact, false),
        error: (found.iter().map(|f| (f.1.eta_n_v / f.0).ln().powi(2)).sum::<f64>() / n).sqrt(),
        half_width: width(false),
        with_torque: share(&|r| r.ci95, true),
        half_width_with_torque: width(true),
    };
    println!(
        "{seeds} motors: interval covers {:.1} % (half-width {:.1} %, rms error {:.1} %), were all else exact {:.1} %; with \
         torque runs {:.1} % (half-width {:.1} %)",
        100.0 * coverage.whole,
        100.0 * coverage.half_width,
        100.0 * coverage.error,
        100.0 * coverage.others_exact,
        100.0 * coverage.with_torque,
        100.0 * coverage.half_width_with_torque
    );
    coverage
}

/// Steady speed at full drive under a load (rpm).
fn steady_rpm(mut parameters: Parameters, load_nm: f64) -> f64 {
    parameters.load_nm = load_nm;
    let angle = |end_s| {
        let program = Program::constant(1.0, Direction::Cw, 2.0, end_s);
        simulate(&program, &model(parameters), &EffectSet::default(), History::default()).end_rad
    };
    (angle(1.0) - angle(0.5)) / 0.5 * 30.0 / std::f64::consts::PI
}

/// A motor file whose stator has been swept: its modal constants and the drive's frequency are known.
fn swept() -> Motor {
    let mut motor = Motor::pcbmotor_30mm();
    for (name, relative) in [("Ms", 0.1), ("f", 0.001)] {
        let entry: &mut Entry = motor.physical.get_mut(name).unwrap();
        entry.uncertainty = Some(relative * entry.value);
    }
    motor
}

#[test]
#[cfg_attr(debug_assertions, ignore = "statistics: run with --release")]
fn intervals_cover_the_truth_of_a_stator_that_was_swept() {
    let found = coverage(&swept(), 60, 1);
    // Short of 95 %, as docs/identify.md says.
    assert!(found.whole > 0.80 && found.with_torque > 0.80, "{} {}", found.whole, found.with_torque);
    // What a fit of the force factor alone would claim.
    assert!(found.others_exact < 0.5, "{}", found.others_exact);
}

#[test]
#[cfg_attr(debug_assertions, ignore = "statistics: run with --release")]
fn an_independent_carrier_model_gives_its_force_factor_back() {
    let truth = Carrier::default();
    let [mass, damping, stiffness] = truth.modal;
    let mut motor = Motor::pcbmotor_30mm();
    for (name, value) in [
        ("f", truth.frequency),
        ("Ms", mass),
        ("Cs", damping),
        ("Ks", stiffness),
        ("Fext", truth.preload),
        // A quarter beside the truth: the fit has to find it.
        ("eta", 1.25 * truth.force_factor),
    ] {
        let entry = motor.physical.get_mut(name).unwrap();
        (entry.value, entry.uncertainty) = (value, None);
    }
    let pitch = TAU / 400.0;
    let runs: Vec<Run> = [0.5, 1.0]
        .into_par_iter()
        .map(|duty| {
            let mut state = CarrierState::default();
            let (mut times, mut before) = (Vec::new(), (0.0, 0.0));
            for k in 1..=1200 {
                let until = 1e-3 * f64::from(k);
                truth.run(&mut state, until, f64::from((k - 1) % 20) < 20.0 * duty);
                let now = (until, state.y[6]);
                while now.1 >= pitch * (times.len() + 1) as f64 {
                    let share = (pitch * (times.len() + 1) as f64 - before.1) / (now.1 - before.1);
                    times.push(before.0 + share * (now.0 - before.0));
                }
                before = now;
            }
            run(duty, Sense::Cw, false, times.into_iter(), 1.2)
        })
        .collect();
    let found = identify(&measurement(runs), &TorqueRuns::default(), &motor, Flavour::Physical).unwrap();
    print!("{}", text::force_factor(&found));
    let [low, high] = found.ci95;
    assert!(low < truth.force_factor && truth.force_factor < high, "{low} {high}");
    assert!((found.eta_n_v / truth.force_factor - 1.0).abs() < 0.05, "{}", found.eta_n_v);
}

#[test]
fn the_interval_holds_the_truth_though_the_motor_file_is_off() {
    let motor = Motor::pcbmotor_30mm();
    let base = motor.parameters(Flavour::Physical);
    let mut truth = base;
    truth.force_factor_n_v *= 1.08;
    truth.off_friction *= 1.07;
    truth.preload_n *= 0.94;
    let report = identify(&measured(truth), &TorqueRuns::default(), &motor, Flavour::Physical).unwrap();
    print!("{}", text::force_factor(&report));
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

/// The answer without and with three loaded speeds of the same motor.
fn alone_and_loaded(base: Parameters) -> (Report, Report) {
    let motor = Motor::pcbmotor_30mm();
    let alone = identify(&measured(base), &TorqueRuns::default(), &motor, Flavour::Physical).unwrap();
    let loaded: Vec<Loaded> = [0.002, 0.004, 0.006]
        .into_iter()
        .map(|load_nm| Loaded { duty: 1.0, load_nm, rpm: steady_rpm(base, load_nm) })
        .collect();
    let torque = TorqueRuns { loaded, stall_nm: Vec::new() };
    (alone, identify(&measured(base), &torque, &motor, Flavour::Physical).unwrap())
}

#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_loaded_speeds_are_taken_in() {
    let base = Motor::pcbmotor_30mm().parameters(Flavour::Physical);
    let (_, with) = alone_and_loaded(base);
    // Where the encoder stood at the start is not told: it shifts the lags by milliseconds, and η with them.
    assert!((with.eta_n_v / base.force_factor_n_v - 1.0).abs() < 0.05, "{}", with.eta_n_v);
    assert!((with.ci95[0]..with.ci95[1]).contains(&base.force_factor_n_v));
    assert!(!with.notes.iter().any(|n| n.contains("no loaded run")));
}

#[test]
#[ignore = "known shortfall, docs/identify.md: three loaded speeds far below the stall widen the interval by a tenth instead"]
fn loaded_speeds_narrow_what_speeds_alone_leave_open() {
    let (alone, with) = alone_and_loaded(Motor::pcbmotor_30mm().parameters(Flavour::Physical));
    let width = |r: &Report| (r.ci95[1] / r.ci95[0]).ln();
    assert!(width(&with) < width(&alone), "{} {}", width(&with), width(&alone));
}

#[test]
fn no_runs_is_said_so() {
    let motor = Motor::pcbmotor_30mm();
    let mut empty = measured(motor.parameters(Flavour::Physical));
    empty.runs.truncate(1);
    empty.runs[0].duty = None;
    let message = identify(&empty, &TorqueRuns::default(), &motor, Flavour::Physical).unwrap_err().to_string();
    assert!(message.contains("no speed run"), "{message}");
}

#[test]
fn torque_runs_are_read_and_what_is_wrong_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("torque.csv");
    let read = |text: &str| {
        std::fs::write(&path, text).unwrap();
        let mut torque = TorqueRuns::default();
        torque.read(&path).map(|()| torque).map_err(|e| e.to_string())
    };
    let good = read("# bench of May\nduty,load_nm,rpm\n1, 0.004, 31.5\n1,0.0149,0\n").unwrap();
    assert_eq!(good.loaded, [Loaded { duty: 1.0, load_nm: 0.004, rpm: 31.5 }]);
    assert_eq!(good.stall_nm, [0.0149]);
    for (row, parts) in [
        ("0.5,0.0149,0", ["line 3", "stall"]),
        ("1.5,0.004,30", ["line 3", "duty 1.5"]),
        ("1,0.004,-3", ["line 3", "-3 rpm"]),
        ("1,x,30", ["line: 3", "float"]),
        ("1,0.004", ["line: 3", "fields"]),
    ] {
        let message = read(&format!("duty,load_nm,rpm\n1,0.002,33\n{row}\n")).unwrap_err();
        assert!(parts.iter().all(|p| message.contains(p)) && message.contains("torque.csv"), "{row}: {message}");
    }
}
