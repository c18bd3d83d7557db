//! The sweep against the simulated bench: what it measures, how it ends, and the whole chain to the model.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use twum_host::identify::circuit::{Circuit, Mode};
use twum_host::identify::read::{ReadOptions, read};
use twum_host::identify::stator::{Options, Report, Verdict, identify};
use twum_host::instruments::generator::{Generator, Phases};
use twum_host::instruments::oscilloscope::{Family, Oscilloscope};
use twum_host::instruments::scpi::Scpi;
use twum_host::instruments::simulate::{Bench, Setup};
use twum_host::instruments::sweep::{Plan, SweepError, run};

const L: f64 = 2.1094;
const C: f64 = 6.1653e-12;
const R: f64 = 18_488.0;

fn bench(family: Family) -> Bench {
    Bench::start(Setup {
        circuit: Circuit::single(150e-12, 2e6, Mode::from_elements(L, C, R)),
        shunt_ohm: 2000.0,
        noise_v: 0.01,
        family,
        seed: 3,
        ports: (0, 0),
    })
    .unwrap()
}

fn plan() -> Plan {
    Plan { from_hz: 40_000.0, to_hz: 48_000.0, step_hz: 100.0, settle: Duration::ZERO, ..Plan::default() }
}

fn sweep(bench: &Bench, plan: &Plan, path: &Path, stop: &AtomicBool, after: usize) -> Result<usize, SweepError> {
    let generator = Generator::new(Scpi::open(&bench.generator.to_string())?, Phases::Two)?;
    let mut scope = Oscilloscope::new(Scpi::open(&bench.scope.to_string())?)?;
    run(plan, path, generator, &mut scope, stop, |done, _| stop.store(done >= after, Ordering::Relaxed))
}

fn identified(path: &Path) -> Report {
    let options = ReadOptions { shunt_ohm: Some(2000.0), ..ReadOptions::default() };
    identify(&read(path, &options).unwrap(), &Options::default()).unwrap().report
}

#[test]
fn both_oscilloscopes_give_the_stator_back() {
    for family in [Family::Ds1104z, Family::Ds1052e] {
        let bench = bench(family);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sweep.csv");
        let taken = sweep(&bench, &plan(), &path, &AtomicBool::new(false), usize::MAX).unwrap();
        assert_eq!(taken, 81);
        assert!(bench.outputs().iter().all(|o| !o.on), "{family:?}: an output stayed on");
        assert_eq!(bench.errors(), Vec::<String>::new());
        // The listing's missing comma would have asked for 60.
        assert_eq!(bench.largest_vpp(), 6.0);
        let report = identified(&path);
        assert_eq!(report.verdict, Verdict::SingleMode, "{family:?}");
        for (name, truth) in [("l_h", L), ("c_f", C), ("r_ohm", R), ("cd_f", 150e-12)] {
            let value = serde_json::to_value(&report).unwrap()[name].as_f64().unwrap();
            assert!((value / truth - 1.0).abs() < 0.01, "{family:?}: {name} = {value}, not {truth}");
        }
    }
}

#[test]
fn a_stopped_sweep_goes_on_where_it_was_and_leaves_the_outputs_off() {
    let bench = bench(Family::Ds1104z);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sweep.csv");
    let stop = AtomicBool::new(false);
    let error = sweep(&bench, &plan(), &path, &stop, 10).unwrap_err();
    assert!(matches!(error, SweepError::Stopped { done: 10, total: 81 }), "{error}");
    assert!(bench.outputs().iter().all(|o| !o.on));
    // A tear in the middle of a frequency, as a cut of power leaves it.
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, format!("{text}41000,1.0e-5,0.5")).unwrap();
    stop.store(false, Ordering::Relaxed);
    assert_eq!(sweep(&bench, &plan(), &path, &stop, usize::MAX).unwrap(), 71);
    assert_eq!(identified(&path).points, 81);
    assert_eq!(sweep(&bench, &plan(), &path, &stop, usize::MAX).unwrap(), 0);
}

#[test]
fn outputs_go_off_when_the_oscilloscope_fails_and_on_a_panic() {
    let bench = bench(Family::Ds1104z);
    let folder = tempfile::tempdir().unwrap();
    // Somebody switches the generator off by hand: no trigger comes any more.
    let generator = Generator::new(Scpi::open(&bench.generator.to_string()).unwrap(), Phases::Two).unwrap();
    let mut scope = Oscilloscope::new(Scpi::open(&bench.scope.to_string()).unwrap()).unwrap();
    let mut hand = Scpi::open(&bench.generator.to_string()).unwrap();
    let path = folder.path().join("e.csv");
    let error = run(&plan(), &path, generator, &mut scope, &AtomicBool::new(false), |done, _| {
        if done == 3 {
            hand.send("OUTP OFF").unwrap();
            assert_eq!(hand.query("OUTP?").unwrap(), "OFF");
        }
    })
    .unwrap_err();
    assert!(error.to_string().contains("no trigger"), "{error}");
    assert!(bench.outputs().iter().all(|o| !o.on));
    assert!(std::fs::read_to_string(&path).unwrap().ends_with("# done 40200\n"));
    let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        let generator = Generator::new(Scpi::open(&bench.generator.to_string()).unwrap(), Phases::Two).unwrap();
        let mut scope = Oscilloscope::new(Scpi::open(&bench.scope.to_string()).unwrap()).unwrap();
        let seen = AtomicBool::new(false);
        let path = folder.path().join("p.csv");
        let _ = run(&plan(), &path, generator, &mut scope, &AtomicBool::new(false), |done, _| {
            if done == 3 {
                seen.store(bench.outputs()[0].on, Ordering::Relaxed);
                assert!(!seen.load(Ordering::Relaxed), "the outputs are on, so a panic here means something");
            }
        });
    }));
    assert!(panicked.is_err());
    assert!(bench.outputs().iter().all(|o| !o.on));
}

#[test]
fn the_listing_s_second_channel_command_asks_for_sixty_volts() {
    let bench = bench(Family::Ds1052e);
    let mut raw = Scpi::open(&bench.generator.to_string()).unwrap();
    raw.send("APPL:SIN:CH2 50000,60").unwrap();
    assert_eq!(raw.query("OUTP:CH2?").unwrap(), "OFF");
    assert_eq!(bench.largest_vpp(), 60.0);
    assert_eq!(bench.errors(), ["APPL:SIN:CH2 50000,60"]);
}

#[test]
fn nobody_there_is_said_so() {
    let error = Scpi::open("127.0.0.1:1").unwrap_err().to_string();
    assert!(error.contains("127.0.0.1:1"), "{error}");
    let bench = bench(Family::Ds1052e);
    let error = Generator::new(Scpi::open(&bench.scope.to_string()).unwrap(), Phases::One).unwrap_err().to_string();
    assert!(error.contains("DG1022") && error.contains("DS1052E"), "{error}");
}

#[test]
fn the_chain_from_instruments_to_model_is_whole() {
    use twum_host::identify::save;
    use twum_host::model::effects::EffectSet;
    use twum_host::model::motor::Motor;
    use twum_host::model::motor_plant::{History, Solver};
    use twum_host::model::parameters::Flavour;
    use twum_host::model::plant::Direction;
    use twum_host::model::simulate::{PlantModel, Program, simulate};

    let bench = bench(Family::Ds1104z);
    let folder = tempfile::tempdir().unwrap();
    let waves = folder.path().join("sweep.csv");
    sweep(&bench, &plan(), &waves, &AtomicBool::new(false), usize::MAX).unwrap();
    let report = identified(&waves);
    let file = folder.path().join("bench-3.toml");
    save::save(&file, "pcbmotor-30mm", &save::stator(&report, &file, "pcbmotor-30mm").unwrap()).unwrap();

    let motor = Motor::load(&file.display().to_string()).unwrap();
    assert_eq!(motor.name, "bench-3");
    let eta2 = 0.5439f64.powi(2);
    for (name, truth) in [("Ms", eta2 * L), ("Cs", eta2 * R), ("Ks", eta2 / C)] {
        let entry = &motor.parameters[name];
        assert!((entry.value / truth - 1.0).abs() < 0.01, "{name} = {}", entry.value);
        assert!(entry.uncertainty.unwrap() < 0.01 * truth && entry.uncertainty.unwrap() > 0.0);
        assert!(entry.source.contains("identify stator") && entry.source.contains("95 %"), "{}", entry.source);
    }
    let physical = motor.parameters(Flavour::Physical);
    let fs = 1.0 / (std::f64::consts::TAU * (L * C).sqrt());
    assert!((physical.resonance_hz() / fs - 1.0).abs() < 1e-3);

    // The stator is the shipped motor's: so must the speed be.
    let speed = |motor: &Motor, flavour| {
        let model = PlantModel::Motor { parameters: motor.parameters(flavour), flavour, solver: Solver::Averaged };
        let program = Program::constant(1.0, Direction::Cw, 1.0, 0.5);
        simulate(&program, &model, &EffectSet::default(), History::default()).end_rad
    };
    let shipped = Motor::load("pcbmotor-30mm").unwrap();
    for flavour in [Flavour::Thesis, Flavour::Physical] {
        let (here, there) = (speed(&motor, flavour), speed(&shipped, flavour));
        assert!(here > 0.5 && (here / there - 1.0).abs() < 0.05, "{flavour}: {here} rad against {there}");
    }
    // A second result goes into the same file and leaves the first alone.
    let more =
        [save::Update { name: "u", flavour: None, value: 0.11, ci95: Some([0.105, 0.115]), source: "test".into() }];
    save::save(&file, "pcbmotor-30mm", &more).unwrap();
    let again = Motor::load(&file.display().to_string()).unwrap();
    assert_eq!(again.parameters["u"].value, 0.11);
    assert_eq!(again.parameters["Ms"], motor.parameters["Ms"]);
}
