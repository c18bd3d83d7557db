//! How far the rotor can turn unseen when the encoder's line fails: every duty and reference against every way it may fail.

use crate::bench::{Bench, TICK_US, speed};
use crate::document;
use std::fmt::Write;
use twum_host::model::effects::EffectSet;
use twum_host::model::motor::Motor;
use twum_host::model::motor_plant::{History, MotorPlant, Solver};
use twum_host::model::parameters::Flavour;
use twum_host::model::plant::{Drive, Plant};
use twum_host::sim::{Disturbance, FirstOrderMotor, Setup, SimulatedMotor};
use twum_shared::message::{Configuration, Mode, TrackRun};
use twum_shared::reference::Reference;
use twum_shared::step::ConfigSpec;
use twum_shared::{Direction, Duty};

/// Nothing may turn farther than this unseen, degrees; but see [`cannot_be_told`].
const BOUND_DEG: f64 = 90.0;
/// Length of a run.
const RUN_S: u32 = 30;
/// A long one.
const LONG_RUN_S: u32 = 600;

#[derive(Clone, Copy)]
struct Line {
    name: &'static str,
    /// From when on the rotor's own edges are not seen, µs into the run.
    dead_from_us: u64,
    /// A phantom edge comes this often.
    phantom_us: Option<u64>,
}

const LINES: [Line; 4] = [
    Line { name: "dead", dead_from_us: 0, phantom_us: None },
    Line { name: "dies after 1.03 s", dead_from_us: 1_030_000, phantom_us: None },
    Line { name: "dead, an edge every 0.4 s", dead_from_us: 0, phantom_us: Some(400_000) },
    Line { name: "dies after 1.03 s, an edge every 0.4 s", dead_from_us: 1_030_000, phantom_us: Some(400_000) },
];

#[derive(Clone)]
enum Run {
    Duty(u16, u16),
    Track(ConfigSpec, Reference),
}

fn runs() -> Vec<(String, Run)> {
    let mut runs: Vec<(String, Run)> = [(1, 32), (5, 100), (10, 100), (249, 1_000), (50, 100), (100, 100)]
        .into_iter()
        .map(|(on, of)| (format!("duty {:.3}", f64::from(on) / f64::from(of)), Run::Duty(on, of)))
        .collect();
    let references = [
        ("sine of 10 counts", Reference::Sine { amplitude: 10, omega_urad_s: 1_257_000 }),
        ("sine of 89 counts", Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 }),
        ("step of 3 counts", Reference::Step { position: 3, at_us: 0 }),
        ("step of 100 counts", Reference::Step { position: 100, at_us: 0 }),
        ("ramp of 5 counts/s", Reference::Ramp { rate: 5, limit: 1_000 }),
    ];
    for (controller, spec) in [("thesis", ConfigSpec::THESIS), ("default", ConfigSpec::DEFAULT)] {
        for (name, reference) in &references {
            runs.push((format!("{name}, {controller} controller"), Run::Track(spec, reference.clone())));
        }
    }
    runs
}

/// Two motors between which others lie: one that needs 6 ms to start in every PWM period, so that it is slow at small duties, and
/// the identified one of the hybrid model, whose speed is in proportion to the duty.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Rotor {
    SlowToStart,
    Identified,
}

/// The hybrid model, averaged, behind the board's seam.
struct Identified {
    plant: MotorPlant,
    nudged_rad: f64,
}

impl Identified {
    fn new() -> Self {
        let motor = Motor::load("pcbmotor-30mm").unwrap();
        let parameters = motor.parameters(Flavour::Physical);
        let effects = EffectSet::default();
        let plant = MotorPlant::new(parameters, Flavour::Physical, Solver::Averaged, &effects, History::default());
        Self { plant, nudged_rad: 0.0 }
    }
}

impl SimulatedMotor for Identified {
    fn advance(&mut self, dt_s: f64, drive_on: bool, direction: Direction) -> f64 {
        let level = f64::from(u8::from(drive_on));
        if dt_s > 0.0 {
            let until_s = self.plant.time_s() + dt_s;
            self.plant.advance(until_s, Drive { level, direction, duty: level }, &mut |_| {});
        }
        self.plant.position_rad() + self.nudged_rad
    }

    fn nudge(&mut self, angle_rad: f64) {
        self.nudged_rad += angle_rad;
    }
}

fn armed(configuration: Configuration, rotor: Rotor) -> Bench {
    let motor: Box<dyn SimulatedMotor> = match rotor {
        Rotor::SlowToStart => Box::new(FirstOrderMotor::default()),
        Rotor::Identified => Box::new(Identified::new()),
    };
    let mut bench = Bench::new(Setup { motor, ..Setup::default() });
    bench.session.align().expect("alignment");
    bench.session.configure(configuration).expect("configuration");
    bench.session.arm().expect("arming");
    bench
}

fn started(run: &Run, rotor: Rotor, duration_s: u32) -> Bench {
    let duration_ms = duration_s * 1_000;
    match run {
        Run::Duty(on, of) => {
            let mut bench = armed(Configuration::with_control(ConfigSpec::DEFAULT), rotor);
            bench.session.start_speed(speed(Duty::from_ratio(*on, *of), Direction::Cw, duration_ms)).unwrap();
            bench
        }
        Run::Track(spec, reference) => {
            let mut bench = armed(Configuration::with_control(*spec), rotor);
            bench.session.start_track(TrackRun { reference: reference.clone(), duration_ms }).unwrap();
            bench
        }
    }
}

/// The angle turned and not counted, in the direction of turning, since the line failed, at its worst, degrees; and how the run ended.
fn unseen(run: &Run, rotor: Rotor, line: Line, duration_s: u32) -> (f64, String) {
    let mut bench = started(run, rotor, duration_s);
    let start_us = bench.board().now_us();
    let (mut from, mut worst_deg, mut next_phantom_us): (Option<(f64, i32)>, f64, u64) = (None, 0.0, 0);
    let mut next_keepalive_us = 0;
    loop {
        let elapsed_us = bench.board().now_us() - start_us;
        if elapsed_us >= next_keepalive_us {
            next_keepalive_us = elapsed_us + 100_000;
            bench.session.keep_alive().unwrap();
        }
        if elapsed_us >= line.dead_from_us && from.is_none() {
            bench.board().disturb(Disturbance::EncoderDead(true));
            from = Some((bench.board().angle_rad(), bench.board().count()));
            next_phantom_us = elapsed_us + line.phantom_us.unwrap_or_default();
        }
        let phantom = line.phantom_us.filter(|_| from.is_some() && elapsed_us >= next_phantom_us);
        if let Some(interval_us) = phantom {
            next_phantom_us = elapsed_us + interval_us;
            bench.board().disturb(Disturbance::Chatter(1));
        }
        bench.board().run_for(TICK_US);
        if phantom.is_some() {
            bench.board().disturb(Disturbance::Chatter(0));
        }
        if let Some((angle_rad, count)) = from {
            let turned_deg = (bench.board().angle_rad() - angle_rad).to_degrees();
            let counted_deg = f64::from(bench.board().count() - count) * 0.9;
            // What is counted the other way hides nothing: it adds.
            worst_deg = worst_deg.max((turned_deg - counted_deg) * turned_deg.signum());
        }
        if bench.board().mode() != Mode::Running {
            // It coasts to a stand.
            bench.board().run_for(50_000);
            let fault = bench.session.hello().unwrap().fault;
            let at_s = elapsed_us as f64 * 1e-6;
            return (worst_deg, fault.map_or("ran to its end".to_owned(), |fault| format!("{fault:?}, {at_s:.2} s")));
        }
    }
}

#[test]
fn a_line_that_fails_hides_less_than_a_quarter_turn_whatever_the_drive() {
    let mut table =
        format!("| run of 30 s | {} |\n|---|{}\n", LINES.map(|line| line.name).join(" | "), "---|".repeat(4));
    let (mut worst_deg, mut too_far) = (0.0f64, Vec::new());
    for (name, run, rotor) in cases() {
        write!(table, "| {name} |").unwrap();
        for line in LINES {
            let (unseen_deg, end) = unseen(&run, rotor, line, RUN_S);
            write!(table, " {unseen_deg:.1}° ({end}) |").unwrap();
            worst_deg = worst_deg.max(unseen_deg);
            if unseen_deg > BOUND_DEG && !cannot_be_told(&run, line) {
                too_far.push(format!("{name}, {}: {unseen_deg:.1}°", line.name));
            }
        }
        table += "\n";
    }
    println!("{table}worst: {worst_deg:.1}°");
    assert!(too_far.is_empty(), "{too_far:#?}");
    document::check("dead-encoder", &table);
}

/// An encoder that shows what a slow motor would, under a small duty or in a loop that rests, is taken for that motor's.
fn cannot_be_told(run: &Run, line: Line) -> bool {
    let small = match run {
        Run::Duty(on, of) => 16 * on <= *of,
        Run::Track(_, reference) => matches!(reference, Reference::Step { .. }),
    };
    line.phantom_us.is_some() && small
}

/// Each run with each motor.
fn cases() -> Vec<(String, Run, Rotor)> {
    let each = |(name, run): (String, Run)| {
        [("slow", Rotor::SlowToStart), ("identified", Rotor::Identified)]
            .map(|(motor, rotor)| (format!("{name}, {motor}"), run.clone(), rotor))
    };
    runs().into_iter().flat_map(each).collect()
}

#[test]
fn a_motor_that_turns_is_no_stall_at_any_duty() {
    let duties = [(1, 32), (5, 100), (10, 100), (12, 100), (249, 1_000), (50, 100), (95, 100), (100, 100)];
    for ((on, of), rotor) in duties.into_iter().flat_map(|duty| [(duty, Rotor::SlowToStart), (duty, Rotor::Identified)])
    {
        let mut bench = started(&Run::Duty(on, of), rotor, RUN_S);
        for second in 0..20 {
            bench.wait(1_000);
            let mode = bench.board().mode();
            let fault = bench.session.hello().unwrap().fault;
            assert_eq!(mode, Mode::Running, "{rotor:?}, duty {on}/{of}, {second} s: {fault:?}");
        }
    }
}

#[test]
fn a_motor_that_is_tracked_with_a_sound_encoder_faults_with_neither_motor() {
    for (name, run, rotor) in cases().into_iter().filter(|(_, run, _)| matches!(run, Run::Track(..))) {
        let mut bench = started(&run, rotor, RUN_S);
        bench.wait(u64::from(RUN_S) * 1_000 - 500);
        let mode = bench.board().mode();
        assert_eq!(mode, Mode::Running, "{name}: {:?}", bench.session.hello().unwrap().fault);
    }
}

/// `cargo test --release -p twum-tests --test board -- --ignored --nocapture in_ten_minutes`
#[test]
#[ignore = "minutes: prints what no judgement of edges can tell"]
fn what_phantom_edges_at_any_rate_hide_in_ten_minutes() {
    let every_s = [0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2];
    let heads: Vec<String> = every_s.iter().map(|s| format!("every {s} s")).collect();
    let mut table =
        format!("| run of {LONG_RUN_S} s | {} |\n|---|{}\n", heads.join(" | "), "---|".repeat(every_s.len()));
    for (name, run, rotor) in cases() {
        write!(table, "| {name} |").unwrap();
        for every_s in every_s {
            let phantom_us = Some((every_s * 1e6) as u64);
            let lines = [0, 1_030_000].map(|dead_from_us| Line { name: "", dead_from_us, phantom_us });
            let came = lines.map(|line| unseen(&run, rotor, line, LONG_RUN_S));
            let worst = came.iter().max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
            write!(table, " {:.1}° ({}) |", worst.0, worst.1).unwrap();
        }
        table += "\n";
    }
    println!("{table}");
}
