//! Generator E: its stator and contact against formulas, its experiments, and what is hidden in its data.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use twum_host::record::measurement::Measurement;
use twum_tests::envelope::bristles::{Grip, Rotor};
use twum_tests::envelope::effects::{LIBRARY, OUTSIDE};
use twum_tests::envelope::motor::Motor;
use twum_tests::envelope::stator::{Stator, Tuning};
use twum_tests::folder::{Record, Run};
use twum_tests::profile::random::Dice;
use twum_tests::suite::make;
use twum_tests::truth::{Kind, Made, Request};

fn made(kind: Kind, seed: u64) -> Made {
    make("e", seed, &Request::of(kind), false).expect("it can be made")
}

/// One effect, and the same with nothing hidden.
fn hidden(effect: &str, seed: u64, rho: f64) -> [Made; 2] {
    let request = Request { kind: Kind::Single, effects: vec![effect.to_owned()], rho: Some(rho) };
    [false, true].map(|clean| make("e", seed, &request, clean).expect("it can be hidden"))
}

/// A motor tuned to its resonance, its modes in perfect quadrature.
fn tuned() -> Motor {
    Motor { detuning: 0.0, split: 0.0, quadrature: 0.0, ..Motor::draw(&mut Dice::new(1, "tuned")) }
}

/// Times of a run's edges in s and the level before the first.
fn edges(run: &Run) -> (bool, Vec<f64>) {
    match &run.record {
        Record::Levels { period_us, levels } => {
            let changed = (1..levels.len()).filter(|n| levels[*n] != levels[n - 1]);
            (levels[0], changed.map(|n| (n as f64 - 0.5) * *period_us as f64 * 1e-6).collect())
        }
        Record::Edges { first, times_us, .. } => (*first, times_us.iter().map(|t| *t as f64 * 1e-6).collect()),
        Record::Control { .. } => (false, Vec::new()),
    }
}

/// Mean speed in rpm over the steady part of a run, from its first to its last edge there.
fn mean_rpm(run: &Run, edges_per_rev: u32) -> Option<f64> {
    let steady: Vec<f64> = edges(run).1.into_iter().filter(|t| (0.3..run.drive_on_s).contains(t)).collect();
    let (first, last) = (steady.first()?, steady.last()?);
    (last - first > 0.3).then(|| 60.0 * (steady.len() - 1) as f64 / f64::from(edges_per_rev) / (last - first))
}

/// Fails if the wave does not rise as a resonance does: at resonance by 1 − exp(−t/τ), and detuned by x half-widths to
/// 1/√(1 + x²) of it; and fails if it does not turn round with the drive.
#[test]
fn waves_rise_as_resonances_do() {
    let (motor, dt) = (tuned(), 10e-6);
    let mut stator = Stator::new(&motor, dt);
    for n in 1..=2000 {
        stator.step(1.0);
        let [speed, amplitude] = stator.surface();
        let wanted = 1.0 - (-f64::from(n) * dt / motor.wave_s).exp();
        assert!((speed - wanted).abs() < 1e-9 && (amplitude - wanted).abs() < 1e-9, "{n}: {speed} {wanted}");
    }
    let settled = |detuning: f64, sign: f64| {
        let mut stator = Stator::new(&motor, dt);
        stator.tune(Tuning { detuning, quadrature: 0.0, sign });
        (0..5000).for_each(|_| stator.step(1.0));
        stator.surface()[0]
    };
    assert!((settled(0.75, 1.0) - 0.8).abs() < 1e-6 && (settled(0.75, -1.0) + 0.8).abs() < 1e-6);
    assert!((motor.detuned_for(0.2) - 0.75).abs() < 1e-9);
}

/// Fails if steady slip does not pull by v/(|v| + r·bend) of the friction, or if bristles do not hold a rotor without a wave: a
/// load below the friction bends them by its share of it.
#[test]
fn bristles_pull_in_slip_and_hold_at_rest() {
    let motor = tuned();
    let grip = Grip::of(&motor);
    let dt = 50e-6;
    // As good as clamped: the rotor keeps a millionth of what a step's torque gives it.
    let clamped = Grip { viscous: 1e9, ..grip };
    for slip in [0.02, 0.2, 2.0] {
        let mut rotor = Rotor::default();
        (0..4000).for_each(|_| rotor.step(&clamped, slip, 1.0, dt));
        let share = 1.0 / (1.0 + motor.lift * motor.lift);
        let wanted = slip / (slip + share * motor.softness * motor.full);
        assert!((rotor.bend / wanted - 1.0).abs() < 0.02, "{slip}: {} of {wanted}", rotor.bend);
    }
    let mut rotor = Rotor::default();
    for _ in 0..20_000 {
        rotor.step(&Grip { load: 0.5 * motor.brake, ..grip }, 0.0, 0.0, dt);
    }
    // Put on at once, half the friction swings up to nearly all of it and slips a little before it holds.
    assert!(rotor.speed.abs() < 1e-6 && rotor.angle < 5.0 * motor.bend, "{rotor:?}");
    assert!((rotor.bend + 0.5).abs() < 0.01, "{rotor:?}");
}

/// Fails if a folder is not one the command can read.
#[test]
fn folders_are_what_the_command_reads() {
    for kind in [Kind::Null, Kind::Closed] {
        let made = made(kind, 5);
        let folder = tempfile::tempdir().expect("a temporary folder");
        let at = folder.path().join("data");
        let truth = made.write(&at).expect("it can be written");
        assert!(!truth.starts_with(&at), "the truth lies beside the folder, not in it");
        let read = Measurement::load(&at).unwrap_or_else(|e| panic!("{kind:?}: {e}"));
        assert_eq!(read.runs.len(), made.folder.runs.len());
        assert_eq!(read.edges_per_rev, made.folder.edges_per_rev);
    }
}

/// Fails if the seed does not decide everything.
#[test]
fn equal_seeds_make_equal_data() {
    is_decided_by_the_seed(Kind::Null);
}

/// The same with something hidden, and of closed loops.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_equal_seeds_make_equal_data() {
    is_decided_by_the_seed(Kind::Single);
    is_decided_by_the_seed(Kind::Closed);
}

fn is_decided_by_the_seed(kind: Kind) {
    let first = made(kind, 12);
    assert_eq!(first, made(kind, 12), "{kind:?}");
    assert_ne!(first.folder, made(kind, 13).folder, "{kind:?}");
}

/// Fails if motors, experiments and recorders are not as varied as they are said to be, or a rotor does not turn as a motor of the
/// kind does: faster with more drive, and under full drive as fast as it was drawn.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_experiments_are_varied_and_speeds_follow_the_duty() {
    let mut seen: BTreeMap<&str, usize> = BTreeMap::new();
    for seed in 1..=16 {
        let made = made(Kind::Null, seed);
        let (runs, d, m) = (&made.folder.runs, &made.truth.design, &made.truth.motor);
        assert!((6..=60).contains(&runs.len()), "{seed}: {} runs", runs.len());
        assert!((200..=4096).contains(&made.folder.edges_per_rev));
        let full = m["full_rpm"];
        assert!((10.0..=100.0).contains(&full), "{seed}: {full} rpm");
        assert!((0.2e-3..=5e-3).contains(&m["wave_10_90_s"]));
        let mut by_duty: BTreeMap<u64, Vec<f64>> = BTreeMap::new();
        for run in runs {
            assert!((0.05..=1.0).contains(&run.duty) && (1.0..=10.0).contains(&run.drive_on_s), "{run:?}");
            if run.pwm_hz == runs[0].pwm_hz {
                by_duty.entry((run.duty * 1e4) as u64).or_default().extend(mean_rpm(run, made.folder.edges_per_rev));
            }
        }
        by_duty.retain(|_, speeds| !speeds.is_empty());
        let means: Vec<(u64, f64)> =
            by_duty.iter().map(|(d, v)| (*d, v.iter().sum::<f64>() / v.len() as f64)).collect();
        // A run's own gain differs by two per cent at most, in three deviations.
        assert!(means.windows(2).all(|p| p[1].1 > 0.94 * p[0].1), "{seed}: {means:?}");
        if let Some((10_000, rpm)) = means.last() {
            assert!((rpm / full - 1.0).abs() < 0.06, "{seed}: {rpm} of {full} rpm");
        }
        let mut count = |what, is| *seen.entry(what).or_default() += usize::from(is);
        count("levels", d["levels"] > 0.0);
        count("timestamps", d["levels"] == 0.0);
        count("both directions", d["directions"] > 1.0);
        count("one direction", d["directions"] < 2.0);
        count("two frequencies", d["pwm_frequencies"] > 1.0);
        count("sorted", d["sorted"] > 0.0);
        count("lost runs", runs.last().is_some_and(|r| r.order >= runs.len()));
        count("clamped", m["fall_s"] < 2.0 * m["rise_s"]);
        count("not clamped", m["fall_s"] > 2.0 * m["rise_s"]);
    }
    assert!(seen.values().all(|n| *n >= 2), "{seen:?}");
}

/// Fails if an effect cannot be hidden, comes weaker or stronger than said, or larger than makes sense.
fn hidden_as_strongly_as_said(kind: Kind, seed: u64) {
    let entries = if kind == Kind::Single { &LIBRARY[..] } else { &OUTSIDE[..] };
    let made = made(kind, seed);
    let [effect] = made.truth.effects.as_slice() else { panic!("{seed}: one effect") };
    let (name, forms, largest) = entries[seed as usize % entries.len()];
    assert!(effect.name == name && forms.contains(&effect.form.as_str()), "{effect:?}");
    assert!((1.05..13.0).contains(&effect.rho), "{effect:?}");
    assert!(effect.size.abs() > 0.0 && effect.size.abs() <= largest, "{effect:?}");
    assert_eq!(effect.coordinate.is_some(), kind == Kind::Outside);
    let best = made.truth.oracle_gain[0].max(made.truth.oracle_gain[1]);
    assert!((best - (1.0 - 1.0 / effect.rho.hypot(1.0))).abs() < 1e-6, "{seed}: {best} {}", effect.rho);
}

/// Fails if an effect is not hidden as it is said to be: of each part of the motor, one.
#[test]
fn effects_are_hidden_as_strongly_as_said() {
    for seed in [2, 12] {
        hidden_as_strongly_as_said(Kind::Single, seed);
    }
    hidden_as_strongly_as_said(Kind::Outside, 5);
}

/// The same of every effect in the library and beyond it.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_every_effect_can_be_hidden_as_strongly_as_said() {
    (0..LIBRARY.len() as u64).for_each(|seed| hidden_as_strongly_as_said(Kind::Single, seed));
    (0..OUTSIDE.len() as u64).for_each(|seed| hidden_as_strongly_as_said(Kind::Outside, seed));
}

/// Fails if the numbers told are not those in the data, or are also in those with nothing hidden: a ratio of the two directions'
/// speeds, a wide high slot, a fast clock.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_numbers_told_are_in_the_data() {
    let [with, clean] = of_form("direction-asymmetry", "speed");
    let told = with.truth.effects[0].parameters["speed_asymmetry"];
    assert!(clean.truth.effects.is_empty() && clean.truth.motor == with.truth.motor);
    // Noise and experiment are the same in both: their ratio is the effect.
    let ratio = |sign| mean_log(&with, sign) - mean_log(&clean, sign);
    let wanted = ((1.0 + told) / (1.0 - told)).ln();
    assert!((ratio(1.0) - ratio(-1.0) - wanted).abs() < 0.05 * wanted.abs(), "{} {wanted}", ratio(1.0) - ratio(-1.0));

    let [with, clean] = of_form("unequal-edges", "even");
    let told = with.truth.effects[0].parameters["high_slot_excess"];
    let difference = high_share(&with) - high_share(&clean);
    // A high slot is 1 + e pitches of two.
    assert!((difference - 0.5 * told).abs() < 0.1 * told.abs(), "{difference} {told}");

    let [with, clean] = of_form("clock-error", "constant");
    let told = with.truth.effects[0].parameters["relative_clock_error"];
    let slower = [1.0, -1.0].map(|sign| mean_log(&clean, sign) - mean_log(&with, sign));
    let slower = slower.into_iter().find(|s| s.is_finite()).expect("one direction is run");
    assert!((slower - told).abs() < 0.15 * told.abs(), "{slower} {told}");
}

/// The first seed's data in which an effect has a form, with it and without.
fn of_form(effect: &str, form: &str) -> [Made; 2] {
    (1..40)
        .map(|seed| hidden(effect, seed, 4.0))
        .find(|made| made[0].truth.effects[0].form == form)
        .unwrap_or_else(|| panic!("{effect} has no form {form}"))
}

/// Mean logarithm of the speeds in a direction.
fn mean_log(made: &Made, sign: f64) -> f64 {
    let runs = made.folder.runs.iter().filter(|r| r.sign == sign && r.duty > 0.5);
    let log: Vec<f64> = runs.filter_map(|r| mean_rpm(r, made.folder.edges_per_rev)).map(f64::ln).collect();
    log.iter().sum::<f64>() / log.len() as f64
}

/// Share of the time that the encoder is high while the motor turns at its fullest.
fn high_share(made: &Made) -> f64 {
    let (mut high, mut all) = (0.0, 0.0);
    for run in made.folder.runs.iter().filter(|r| r.duty > 0.5) {
        let (first, times) = edges(run);
        let mut level = first;
        for pair in times.windows(2) {
            level = !level;
            if (0.3..run.drive_on_s).contains(&pair[0]) {
                all += pair[1] - pair[0];
                high += if level { pair[1] - pair[0] } else { 0.0 };
            }
        }
    }
    high / all
}

/// Fails if a closed loop does not follow its target, or hides nothing where it says something.
#[test]
fn loops_follow_their_targets() {
    for seed in 0..7 {
        let made = made(Kind::Closed, seed);
        assert_eq!(made.truth.effects.is_empty(), seed == 0);
        for run in &made.folder.runs {
            let Record::Control { ticks, .. } = &run.record else { panic!("a closed loop") };
            assert_eq!(ticks.len(), 30_000);
            let turn = f64::from(made.folder.edges_per_rev) / TAU;
            let square = |f: &dyn Fn(&twum_tests::folder::Tick) -> f64| ticks.iter().map(|t| f(t).powi(2)).sum::<f64>();
            let error = square(&|t| f64::from(t.target - t.position)) / square(&|t| f64::from(t.target));
            // Miscounted reversals carry the shaft away, not the count.
            assert!(error.sqrt() < 0.35, "{seed} {}: {:.3} of the target, {turn} counts a rad", run.id, error.sqrt());
            assert!(ticks.iter().any(|t| t.direction > 0) && ticks.iter().any(|t| t.direction < 0));
        }
    }
}
