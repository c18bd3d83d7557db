//! How far the rotor can turn unseen when the encoder's line fails: every duty and reference against every way it may fail.

use crate::bench::{Bench, TICK_US, speed};
use crate::document;
use std::fmt::Write;
use twum_host::sim::Disturbance;
use twum_shared::message::{Configuration, Mode, TrackRun};
use twum_shared::reference::Reference;
use twum_shared::step::ConfigSpec;
use twum_shared::{Direction, Duty};

/// Nothing may turn farther than this unseen, degrees.
const BOUND_DEG: f64 = 90.0;
/// Length of a run.
const RUN_MS: u32 = 30_000;
/// A phantom edge comes this often.
const PHANTOM_US: u64 = 400_000;

#[derive(Clone, Copy)]
struct Line {
    name: &'static str,
    /// From when on the rotor's own edges are not seen, µs into the run.
    dead_from_us: u64,
    phantoms: bool,
}

const LINES: [Line; 4] = [
    Line { name: "dead", dead_from_us: 0, phantoms: false },
    Line { name: "dies after 1.03 s", dead_from_us: 1_030_000, phantoms: false },
    Line { name: "dead, an edge every 0.4 s", dead_from_us: 0, phantoms: true },
    Line { name: "dies after 1.03 s, an edge every 0.4 s", dead_from_us: 1_030_000, phantoms: true },
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

fn started(run: &Run) -> Bench {
    match run {
        Run::Duty(on, of) => {
            let mut bench = Bench::armed(Configuration::with_control(ConfigSpec::DEFAULT));
            bench.session.start_speed(speed(Duty::from_ratio(*on, *of), Direction::Cw, RUN_MS)).unwrap();
            bench
        }
        Run::Track(spec, reference) => {
            let mut bench = Bench::armed(Configuration::with_control(*spec));
            bench.session.start_track(TrackRun { reference: reference.clone(), duration_ms: RUN_MS }).unwrap();
            bench
        }
    }
}

/// The angle turned and not counted, in the direction of turning, since the line failed, at its worst, degrees; and how the run ended.
fn unseen(run: &Run, line: Line) -> (f64, String) {
    let mut bench = started(run);
    let start_us = bench.board().now_us();
    let (mut from, mut worst_deg, mut next_phantom_us): (Option<(f64, i32)>, f64, u64) = (None, 0.0, PHANTOM_US);
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
            next_phantom_us = elapsed_us + PHANTOM_US;
        }
        let phantom = line.phantoms && from.is_some() && elapsed_us >= next_phantom_us;
        if phantom {
            next_phantom_us = elapsed_us + PHANTOM_US;
            bench.board().disturb(Disturbance::Chatter(1));
        }
        bench.board().run_for(TICK_US);
        if phantom {
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
    for (name, run) in runs() {
        write!(table, "| {name} |").unwrap();
        for line in LINES {
            let (unseen_deg, end) = unseen(&run, line);
            write!(table, " {unseen_deg:.1}° ({end}) |").unwrap();
            worst_deg = worst_deg.max(unseen_deg);
            if unseen_deg > BOUND_DEG {
                too_far.push(format!("{name}, {}: {unseen_deg:.1}°", line.name));
            }
        }
        table += "\n";
    }
    println!("{table}worst: {worst_deg:.1}°");
    assert!(too_far.is_empty(), "{too_far:#?}");
    document::check("dead-encoder", &table);
}

#[test]
fn a_motor_that_turns_is_no_stall_at_any_duty() {
    for (on, of) in [(1, 32), (5, 100), (10, 100), (249, 1_000), (50, 100), (95, 100), (100, 100)] {
        let mut bench = started(&Run::Duty(on, of));
        bench.wait(20_000);
        assert_eq!(bench.board().mode(), Mode::Running, "duty {on}/{of}: {:?}", bench.session.hello().unwrap().fault);
    }
}
