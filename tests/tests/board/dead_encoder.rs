//! How far the rotor can turn unseen when the encoder's line fails: every duty and reference against every way it may fail.

use crate::bench::{Bench, TICK_US};
use crate::document;
use crate::drives::{Run, runs};
use rayon::prelude::*;
use std::fmt::Write;
use twum_host::model::effects::EffectSet;
use twum_host::model::motor::Motor;
use twum_host::model::motor_plant::{History, MotorPlant, Solver};
use twum_host::model::parameters::Flavour;
use twum_host::model::plant::{Drive, Plant};
use twum_host::sim::{Disturbance, FirstOrderMotor, Setup, SimulatedMotor};
use twum_shared::Direction;
use twum_shared::message::Mode;
use twum_shared::safety::Limits;
use twum_shared::step::DriveLaw;

/// Nothing may turn farther than this unseen, degrees.
const BOUND_DEG: f64 = 90.0;
/// Length of a run.
const RUN_S: u32 = 30;

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

/// Two motors between which others lie: one that needs 6 ms to start in every PWM period, so that it is slow at small duties, and
/// the identified one of the hybrid model, whose speed is in proportion to the duty.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Rotor {
    SlowToStart,
    Identified,
}

impl Rotor {
    /// The limits of a person who has measured the motor's speed over its duty: four fifths of it.
    fn known(self) -> Limits {
        let (slowest_percent, slow_start_duty) = match self {
            Self::SlowToStart => (40, 6_554),
            Self::Identified => (80, 0),
        };
        Limits { slowest_percent, slow_start_duty, ..Limits::DEFAULT }
    }
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

fn started(run: &Run, rotor: Rotor, limits: Limits) -> Bench {
    let motor: Box<dyn SimulatedMotor> = match rotor {
        Rotor::SlowToStart => Box::new(FirstOrderMotor::default()),
        Rotor::Identified => Box::new(Identified::new()),
    };
    let mut bench = Bench::new(Setup { motor, ..Setup::default() });
    bench.session.align().expect("alignment");
    run.start(&mut bench, limits, RUN_S * 1_000);
    bench
}

/// What came of a run whose line failed.
struct Unseen {
    /// The angle turned and not counted, in the direction of turning, since then, at its worst, degrees.
    deg: f64,
    /// How the run ended.
    end: String,
    /// Edges that the line made up, and that the rotor would have made from there to where it stopped.
    made_up: u32,
    own: f64,
}

impl Unseen {
    /// Nothing is missing where the line makes up more edges than the rotor makes; only which way they were is wrong, and that
    /// a line without a direction does not say.
    fn is_drowned(&self) -> bool {
        f64::from(self.made_up) > self.own
    }

    fn is_too_far(&self) -> bool {
        self.deg > BOUND_DEG && !self.is_drowned()
    }
}

fn unseen(run: &Run, rotor: Rotor, limits: Limits, line: Line) -> Unseen {
    let mut bench = started(run, rotor, limits);
    let start_us = bench.board().now_us();
    let (mut from, mut worst_deg, mut next_phantom_us): (Option<(f64, i32)>, f64, u64) = (None, 0.0, 0);
    let (mut made_up, mut own) = (0, 0.0f64);
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
            made_up += 1;
            bench.board().disturb(Disturbance::Chatter(1));
        }
        bench.board().run_for(TICK_US);
        if phantom.is_some() {
            bench.board().disturb(Disturbance::Chatter(0));
        }
        if let Some((angle_rad, count)) = from {
            let turned_deg = (bench.board().angle_rad() - angle_rad).to_degrees();
            own = turned_deg.abs() / 0.9;
            let counted_deg = f64::from(bench.board().count() - count) * 0.9;
            // What is counted the other way hides nothing: it adds.
            worst_deg = worst_deg.max((turned_deg - counted_deg) * turned_deg.signum());
        }
        if bench.board().mode() != Mode::Running {
            // It coasts to a stand.
            bench.board().run_for(50_000);
            let fault = bench.session.hello().unwrap().fault;
            let at_s = elapsed_us as f64 * 1e-6;
            let end = fault.map_or("ran to its end".to_owned(), |fault| format!("{fault:?}, {at_s:.2} s"));
            return Unseen { deg: worst_deg, end, made_up, own };
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
            let came = unseen(&run, rotor, rotor.known(), line);
            write!(table, " {:.1}° ({}) |", came.deg, came.end).unwrap();
            worst_deg = worst_deg.max(came.deg);
            if came.deg > BOUND_DEG {
                too_far.push(format!("{name}, {}: {:.1}°", line.name, came.deg));
            }
        }
        table += "\n";
    }
    println!("{table}worst: {worst_deg:.1}°");
    assert!(too_far.is_empty(), "{too_far:#?}");
    document::check("dead-encoder", &table);
}

#[test]
fn a_dead_line_hides_less_than_a_quarter_turn_of_a_motor_that_nobody_has_measured() {
    let mut worst = (0.0f64, String::new());
    for (name, run, rotor) in cases() {
        for line in LINES.into_iter().filter(|line| line.phantom_us.is_none()) {
            let came = unseen(&run, rotor, Limits::DEFAULT, line);
            if came.deg > worst.0 {
                worst = (came.deg, format!("{name}, {}: {}", line.name, came.end));
            }
        }
    }
    println!("worst: {worst:?}");
    assert!(worst.0 <= BOUND_DEG, "{worst:?}");
}

/// Each run with each motor.
fn cases() -> Vec<(String, Run, Rotor)> {
    let each = |(name, run): (String, Run)| {
        [("slow", Rotor::SlowToStart), ("identified", Rotor::Identified)]
            .map(|(motor, rotor)| (format!("{name}, {motor}"), run.clone(), rotor))
    };
    runs().into_iter().flat_map(each).collect()
}

/// Nothing is forgiven with time, so a motor that is too slow by a little trips late: the whole of the run is waited for.
fn runs_to_its_end(name: &str, run: &Run, rotor: Rotor, limits: Limits) {
    let mut bench = started(run, rotor, limits);
    bench.wait(u64::from(RUN_S) * 1_000 - 500);
    let mode = bench.board().mode();
    assert_eq!(mode, Mode::Running, "{name}, {rotor:?}, {limits:?}: {:?}", bench.session.hello().unwrap().fault);
}

#[test]
fn a_motor_that_turns_is_no_stall_at_any_duty() {
    let duties = [(1, 32), (5, 100), (10, 100), (12, 100), (249, 1_000), (50, 100), (95, 100), (100, 100)];
    for ((on, of), rotor) in duties.into_iter().flat_map(|duty| [(duty, Rotor::SlowToStart), (duty, Rotor::Identified)])
    {
        for limits in [Limits::DEFAULT, rotor.known()] {
            runs_to_its_end(&format!("duty {on}/{of}"), &Run::Duty(on, of), rotor, limits);
        }
    }
}

#[test]
fn a_motor_that_is_tracked_with_a_sound_encoder_faults_with_neither_motor() {
    is_tracked_to_the_end(Rotor::known);
}

/// The same with the limits of a motor that nobody has measured.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_motor_that_is_tracked_with_a_sound_encoder_faults_with_neither_motor() {
    is_tracked_to_the_end(|_| Limits::DEFAULT);
}

fn is_tracked_to_the_end(limits: fn(Rotor) -> Limits) {
    // Pulses of 1 ms are none to a motor that takes 6 ms to start: a gated drive is not for it, and it is stopped.
    let suits = |run: &Run, rotor: Rotor| match run {
        Run::Track(spec, _) => spec.law != DriveLaw::Gated || rotor == Rotor::Identified,
        Run::Duty(..) => false,
    };
    for (name, run, rotor) in cases().into_iter().filter(|(_, run, rotor)| suits(run, *rotor)) {
        runs_to_its_end(&name, &run, rotor, limits(rotor));
    }
}

/// Every case at every rate of phantom edges, the worse of a line that is dead from the start and one that dies: the table, and what
/// `is_too_far` of it.
fn phantoms(limits: fn(Rotor) -> Limits, is_too_far: impl Fn(&Run, &Unseen) -> bool + Sync) -> String {
    const EVERY_S: [f64; 6] = [0.1, 0.2, 0.4, 0.5, 1.0, 2.0];
    let heads = EVERY_S.map(|s| format!("every {s} s"));
    let mut table = format!("| run of {RUN_S} s | {} |\n|---|{}\n", heads.join(" | "), "---|".repeat(EVERY_S.len()));
    let mut too_far = Vec::new();
    let cases = cases();
    let rows: Vec<Vec<Unseen>> = cases
        .par_iter()
        .map(|(_, run, rotor)| {
            let worst_at = |every_s: &f64| {
                let phantom_us = Some((every_s * 1e6) as u64);
                let lines = [0, 1_030_000].map(|dead_from_us| Line { name: "", dead_from_us, phantom_us });
                let came = lines.map(|line| unseen(run, *rotor, limits(*rotor), line));
                came.into_iter().max_by(|a, b| a.deg.total_cmp(&b.deg)).expect("two lines")
            };
            EVERY_S.iter().map(worst_at).collect()
        })
        .collect();
    for ((name, run, _), row) in cases.iter().zip(&rows) {
        write!(table, "| {name} |").unwrap();
        for (worst, every_s) in row.iter().zip(EVERY_S) {
            write!(table, " {:.1}° ({}) |", worst.deg, worst.end).unwrap();
            if is_too_far(run, worst) {
                too_far.push(format!("{name}, every {every_s} s: {:.1}°, {:.0} edges", worst.deg, worst.own));
            }
        }
        table += "\n";
    }
    println!("{table}");
    assert!(too_far.is_empty(), "{too_far:#?}");
    table
}

/// `TWUM_WRITE_DOCS=1 cargo test --release -p twum-tests --test board -- --ignored --nocapture at_any_rate`
#[test]
#[ignore = "minutes: the matrix at every rate of phantom edges; the document holds its table"]
fn phantom_edges_at_any_rate_hide_less_than_a_quarter_turn_of_a_known_motor() {
    document::record("phantom-edges", &phantoms(Rotor::known, |_, came| came.is_too_far()));
}

/// What may pass unseen at a constant duty with the default limits, degrees: of so many edges shown, and of the seven that may be owed.
fn default_bound_deg(duty: f64, shown: u32) -> f64 {
    let Limits { slowest_percent, slow_start_duty, .. } = Limits::DEFAULT;
    let slow_start = f64::from(slow_start_duty) / 32_768.0;
    let share = f64::from(slowest_percent) / 100.0 * (duty / slow_start).min(1.0);
    // In proportion to the duty the identified motor is faster than its round number, by a quarter at 1/32; and the first and last edges
    // are cut at any phase.
    0.9 * (1.3 / share * (f64::from(shown) + 7.0) - f64::from(shown) + 2.0)
}

/// `TWUM_WRITE_DOCS=1 cargo test --release -p twum-tests --test board -- --ignored --nocapture nobody_has_measured_by_the_formula`
#[test]
#[ignore = "minutes: the same with the default limits; the document holds its table"]
fn phantom_edges_hide_of_a_motor_that_nobody_has_measured_by_the_formula_and_no_more() {
    let is_too_far = |run: &Run, came: &Unseen| match run {
        Run::Duty(on, of) => came.deg > default_bound_deg(f64::from(*on) / f64::from(*of), came.made_up),
        Run::Track(..) => false,
    };
    document::record("phantom-edges-default", &phantoms(|_| Limits::DEFAULT, is_too_far));
}

/// Edges of every tick of a run on a sound line.
fn shown(run: &Run, rotor: Rotor) -> Vec<u32> {
    let mut bench = started(run, rotor, Limits::DEFAULT);
    let (mut ticks, mut before) = (Vec::new(), bench.board().count());
    while bench.board().mode() == Mode::Running {
        if ticks.len() % 200 == 0 {
            bench.session.keep_alive().unwrap();
        }
        bench.board().run_for(TICK_US);
        let now = bench.board().count();
        ticks.push(now.abs_diff(before));
        before = now;
    }
    ticks
}

/// Why no judge of counts does better than the slowest motor that it lets run: a line that shows what that motor would is its line.
#[test]
fn a_line_that_shows_a_slower_motor_is_that_motor_s_and_hides_what_the_faster_one_turns() {
    let run = Run::Duty(5, 100);
    let slow = shown(&run, Rotor::SlowToStart);
    assert!(slow.len() as u64 > u64::from(RUN_S) * 1_990, "the slower motor is sound, and runs to its end");
    let mut bench = started(&run, Rotor::Identified, Limits::DEFAULT);
    bench.board().disturb(Disturbance::EncoderDead(true));
    let from_rad = bench.board().angle_rad();
    for (tick, edges) in slow.iter().enumerate() {
        if tick % 200 == 0 {
            bench.session.keep_alive().unwrap();
        }
        bench.board().disturb(Disturbance::Chatter(*edges));
        bench.board().run_for(TICK_US);
    }
    let unseen_deg = (bench.board().angle_rad() - from_rad).to_degrees() - 0.9 * f64::from(slow.iter().sum::<u32>());
    assert_eq!(bench.hello().fault, None, "what was not a fault there is none here");
    assert!(unseen_deg > 2.0 * BOUND_DEG, "{unseen_deg}°");
    println!("{} edges shown in {RUN_S} s, {unseen_deg:.0}° unseen", slow.iter().sum::<u32>());
}
