//! The generators that draw motors, experiments and forms: their folders, their strengths, and the suite that runs them.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use twum_host::record::measurement::{Measurement, RunKind};
use twum_tests::folder::{Record, Run};
use twum_tests::strength::{Floor, GRID_S, Refit, Traces};
use twum_tests::suite::{Case, make};
use twum_tests::truth::{Kind, Made, Request};

const GENERATORS: [&str; 2] = ["b", "c"];

fn case(generator: &str, kind: Kind, seed: u64) -> Case {
    Case { generator: generator.to_owned(), kind, seed }
}

/// Mean speed in rpm over the steady part of a run, from its first to its last edge there.
fn mean_rpm(run: &Run, edges_per_rev: u32) -> Option<f64> {
    let times: Vec<f64> = match &run.record {
        Record::Levels { period_us, levels } => (1..levels.len())
            .filter(|n| levels[*n] != levels[n - 1])
            .map(|n| n as f64 * *period_us as f64 * 1e-6)
            .collect(),
        Record::Edges { times_us, .. } => times_us.iter().map(|t| *t as f64 * 1e-6).collect(),
        Record::Control { .. } => return None,
    };
    let steady: Vec<f64> = times.into_iter().filter(|t| (0.3..run.drive_on_s).contains(t)).collect();
    let (first, last) = (steady.first()?, steady.last()?);
    (last - first > 0.3).then(|| 60.0 * (steady.len() - 1) as f64 / f64::from(edges_per_rev) / (last - first))
}

/// Fails if a folder is not one the command can read, or the runs it holds are not those that were made.
#[test]
fn folders_are_what_the_command_reads() {
    for generator in ["a", "b", "c"] {
        for kind in [Kind::Null, Kind::Closed] {
            let made = case(generator, kind, 3).make().expect("it can be made");
            let folder = tempfile::tempdir().expect("a temporary folder");
            let at = folder.path().join("data");
            let truth = made.write(&at).expect("it can be written");
            assert!(!truth.starts_with(&at), "the truth lies beside the folder, not in it");
            let read = Measurement::load(&at).unwrap_or_else(|e| panic!("{generator} {kind:?}: {e}"));
            assert_eq!(read.motor, "pcbmotor-30mm");
            assert_eq!(read.edges_per_rev, made.folder.edges_per_rev);
            let ids: Vec<&str> = read.runs.iter().map(|r| r.id.as_str()).collect();
            assert_eq!(ids, made.folder.runs.iter().map(|r| r.id.as_str()).collect::<Vec<&str>>());
            let track = kind == Kind::Closed;
            assert!(read.runs.iter().all(|r| (r.kind == RunKind::Track) == track && r.order.is_some()));
        }
    }
}

/// Fails if the seed does not decide everything.
#[test]
fn equal_seeds_make_equal_data() {
    GENERATORS.into_iter().for_each(|generator| is_decided_by_the_seed(generator, Kind::Null));
}

/// The same with something hidden, and of closed loops.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_equal_seeds_make_equal_data() {
    is_decided_by_the_seed("b", Kind::Single);
    is_decided_by_the_seed("c", Kind::Closed);
}

fn is_decided_by_the_seed(generator: &str, kind: Kind) {
    let made = |seed| case(generator, kind, seed).make().expect("it can be made");
    let first = made(37);
    assert_eq!(first, made(37), "{generator} {kind:?}");
    assert_ne!(first.folder, made(38).folder, "{generator} {kind:?}");
}

/// Fails if motors, experiments and recorders are not as varied as they are said to be.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_experiments_are_varied_within_their_bounds() {
    for generator in GENERATORS {
        let drawn: Vec<Made> =
            (1..=8).map(|seed| case(generator, Kind::Null, seed).make().expect("it can be made")).collect();
        let mut seen: BTreeMap<&str, usize> = BTreeMap::new();
        for made in &drawn {
            let (runs, d) = (&made.folder.runs, &made.truth.design);
            assert!((6..=60).contains(&runs.len()), "{generator}: {} runs", runs.len());
            assert!((200..=4096).contains(&made.folder.edges_per_rev));
            let rpm = made.truth.motor.get("crest_rpm").or(made.truth.motor.get("full_rpm")).expect("it has a speed");
            assert!((10.0..=100.0).contains(rpm), "{generator}: {rpm} rpm");
            for run in runs {
                assert!((0.05..=1.0).contains(&run.duty) && (1.0..=10.0).contains(&run.drive_on_s), "{run:?}");
            }
            let mut count = |what, is| *seen.entry(what).or_default() += usize::from(is);
            count("levels", d["levels"] > 0.0);
            count("timestamps", d["levels"] == 0.0);
            count("both directions", d["directions"] > 1.0);
            count("one direction", d["directions"] < 2.0);
            count("two frequencies", d["pwm_frequencies"] > 1.0);
            count("lost runs", runs.last().is_some_and(|r| r.order >= runs.len()));
            count("fast", *rpm > 50.0);
            count("slow", *rpm < 20.0);
        }
        assert!(seen.values().all(|n| *n >= 1), "{generator}: {seen:?}");
    }
}

/// Fails if the rotor does not turn as a motor of the kind does: faster with more drive, and under full drive as fast as
/// it was drawn.
#[test]
fn speeds_follow_the_duty() {
    for generator in GENERATORS {
        for seed in 1..=2 {
            let made = case(generator, Kind::Null, seed).make().expect("it can be made");
            let mut by_duty: BTreeMap<u64, Vec<f64>> = BTreeMap::new();
            for run in made.folder.runs.iter().filter(|r| r.pwm_hz == made.folder.runs[0].pwm_hz) {
                if let Some(rpm) = mean_rpm(run, made.folder.edges_per_rev) {
                    by_duty.entry((run.duty * 1e4) as u64).or_default().push(rpm);
                }
            }
            let means: Vec<(u64, f64)> =
                by_duty.iter().map(|(d, v)| (*d, v.iter().sum::<f64>() / v.len() as f64)).collect();
            // A run's own gain differs by some per cent.
            assert!(means.windows(2).all(|p| p[1].1 > 0.95 * p[0].1), "{generator} {seed}: {means:?}");
            let full = made.truth.motor.get("crest_rpm").or(made.truth.motor.get("full_rpm")).expect("it has a speed");
            if let Some((10_000, rpm)) = means.last() {
                assert!((rpm / full - 1.0).abs() < 0.05, "{generator} {seed}: {rpm} of {full} rpm");
            }
        }
    }
}

/// Fails if what is hidden is not in the data, or is in those with nothing hidden: the ratio of the speeds in the two
/// directions is known.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_is_hidden_is_in_the_data_and_in_no_other() {
    let ratio = |made: &Made| {
        let mean = |sign: f64| {
            let runs = made.folder.runs.iter().filter(|r| r.sign == sign && r.duty > 0.5);
            let log: Vec<f64> = runs.filter_map(|r| mean_rpm(r, made.folder.edges_per_rev)).map(f64::ln).collect();
            log.iter().sum::<f64>() / log.len() as f64
        };
        (mean(1.0) - mean(-1.0)).exp()
    };
    // Seeds whose experiment has many runs both ways, and whose form is a factor on the speed alone.
    for (generator, seed) in [("b", 12), ("c", 11)] {
        let request = Request { kind: Kind::Single, effects: vec!["direction-asymmetry".to_owned()], rho: Some(6.0) };
        let made = make(generator, seed, &request, false).expect("the effect can be hidden");
        let clean = make(generator, seed, &request, true).expect("it can be made without");
        let effect = &made.truth.effects[0];
        assert!(effect.form == "speed" && made.truth.design["runs"] >= 24.0, "{effect:?}");
        assert!(clean.truth.effects.is_empty() && clean.truth.motor == made.truth.motor);
        let g = effect.parameters["speed_asymmetry"];
        let (with, without) = (ratio(&made), ratio(&clean));
        // Noise and experiment are the same in both: their ratio is the effect.
        let wanted = (1.0 + g) / (1.0 - g);
        assert!((with / without / wanted - 1.0).abs() < 0.02, "{generator} {seed}: {with} {without} {wanted}");
        assert!((without - 1.0).abs() < 0.03, "{generator} {seed}: {without} with nothing hidden");
    }
}

/// Fails if an effect cannot be hidden, comes weaker or stronger than said, or larger than makes sense. Every effect of
/// the library and beyond it, half of them from each generator.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_every_effect_can_be_hidden_as_strongly_as_said() {
    for (kind, effects) in [(Kind::Single, 16), (Kind::Outside, 8)] {
        for n in 0..effects {
            let generator = GENERATORS[n as usize % 2];
            let seed = if n % 2 == 0 { n } else { effects + n };
            let made = case(generator, kind, seed).make().expect("it can be made");
            let [effect] = made.truth.effects.as_slice() else { panic!("one effect") };
            assert!((0.9..13.0).contains(&effect.rho), "{generator} {seed}: {effect:?}");
            assert!(effect.size.abs() > 0.0 && effect.coordinate.is_some() == (kind == Kind::Outside), "{effect:?}");
            let best = made.truth.oracle_gain[0].max(made.truth.oracle_gain[1]);
            let from_rho = 1.0 - 1.0 / effect.rho.hypot(1.0);
            assert!((best - from_rho).abs() < 1e-6, "{generator} {seed}: {best} {from_rho}");
        }
    }
}

/// Fails if strength is not what it is said to be. A motor at 1 rev/s whose speed wavers by 10 % every 40 ms, seen in
/// windows of 2 ms and 20 ms: the sine of 6 rpm has an RMS of 6/√2, and its halves have a mean of ±6·2/π.
#[test]
fn strength_is_measured_after_the_refit() {
    let points = 4001;
    let trace = |f: &dyn Fn(f64) -> f64| (0..points).map(|n| f(n as f64 * GRID_S)).collect::<Vec<f64>>();
    let plain = trace(&|t| TAU * t);
    let nudged = vec![trace(&|t| 1.01 * TAU * t)];
    let refit = Refit::new(&[Traces { plain, nudged, period_s: 0.02, pitch: TAU / 500.0 }]);
    let [fine, coarse] = refit.beyond(&[trace(&|t| 1.2 * TAU * t)]);
    assert!(fine < 1e-6 && coarse < 1e-6, "a faster motor is no effect: {fine} {coarse}");
    let omega = TAU / 0.04;
    let [fine, coarse] = refit.beyond(&[trace(&|t| TAU * t - 0.1 * TAU / omega * (omega * t).cos())]);
    assert!((fine - 6.0 / 2f64.sqrt()).abs() < 0.04, "{fine} rpm");
    assert!((coarse - 6.0 * 2.0 / std::f64::consts::PI).abs() < 0.04, "{coarse} rpm");
}

/// Fails if the noise floor is not the error of the edges' speeds. Edges of a motor at 1 rev/s come alternately 0.2 ms
/// early and late: the intervals of 2 ms err by 0.4 ms, or every tenth of 20 ms by nothing.
#[test]
fn the_noise_floor_is_read_from_edges() {
    let plain: Vec<f64> = (0..4001).map(|n| TAU * n as f64 * GRID_S).collect();
    let edges: Vec<f64> = (1..900).map(|n| f64::from(n) * 2e-3 + if n % 2 == 0 { 0.1e-3 } else { -0.1e-3 }).collect();
    let mut floor = Floor::default();
    floor.add(&edges, &plain, TAU / 500.0, 0.02 - 1e-6);
    let [fine, coarse] = floor.rpm();
    // Intervals of 1.8 and 2.2 ms: errors of 60·0.2/1.8 and 60·0.2/2.2 rpm, weighted by their length.
    let wanted = ((6.667_f64.powi(2) * 1.8 + 5.4545_f64.powi(2) * 2.2) / 4.0).sqrt();
    assert!((fine / wanted - 1.0).abs() < 0.01 && coarse < 0.01, "{fine} of {wanted}, {coarse}");
}

/// Fails if runs with nothing hidden do not repeat as well as is said, or what every motor of generator D has a little of is
/// more than a little. The deviation of n repeated speeds is known to 1/√(2n).
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_runs_with_nothing_hidden_repeat_as_said() {
    let (mut square, mut count) = (0.0, 0.0);
    for seed in [21, 22, 23, 24] {
        let made = case("d", Kind::Null, seed).make().expect("it can be made");
        assert!(made.truth.effects.is_empty() && made.truth.effect_rpm == [0.0; 2]);
        let slight = made.truth.design.iter().filter(|(k, _)| k.starts_with("slight_"));
        let sizes: Vec<f64> = slight.map(|(_, v)| v.abs()).collect();
        assert!(sizes.len() >= 2 && sizes.iter().all(|s| *s < 0.03), "{seed}: {sizes:?}");
        let mut by_setting: BTreeMap<[u64; 2], Vec<f64>> = BTreeMap::new();
        for run in made.folder.runs.iter().filter(|r| r.duty > 0.5) {
            // Half a per cent of asymmetry is slight: the two directions are counted apart by the sign of the frequency.
            let setting = [(run.duty * 1e4) as u64, (10.0 * run.pwm_hz * (2.0 + run.sign)) as u64];
            by_setting.entry(setting).or_default().extend(mean_rpm(run, made.folder.edges_per_rev));
        }
        for speeds in by_setting.values().filter(|v| v.len() > 1) {
            let mean = speeds.iter().sum::<f64>() / speeds.len() as f64;
            let spread = made.truth.design["gain_spread"];
            square += speeds.iter().map(|v| ((v / mean - 1.0) / spread).powi(2)).sum::<f64>();
            count += speeds.len() as f64 - 1.0;
        }
    }
    let (ratio, known) = ((square / count).sqrt(), (0.5 / count).sqrt());
    assert!(count >= 12.0 && (ratio - 1.0).abs() < 3.0 * known + 0.1, "{ratio} of the spread said, from {count}");
}
