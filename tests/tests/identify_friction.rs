//! Friction from synthetic torque records with known coefficients, and the messages when something is wrong.

use rayon::prelude::*;
use std::path::Path;
use twum_host::identify::friction::{Report, identify};
use twum_host::report::identified::text;
use twum_tests::friction::{BENCH, Bench};

fn made(bench: &Bench, seed: u64) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    bench.write(folder.path(), seed).unwrap();
    folder
}

fn run(folder: &Path) -> Result<Report, String> {
    identify(folder, false).map(|i| i.report).map_err(|e| e.to_string())
}

#[test]
fn known_coefficients_lie_in_their_intervals() {
    let folder = made(&Bench { sample_hz: 1000.0, ..BENCH }, 4);
    let report = run(folder.path()).unwrap();
    print!("{}", text::friction(&report));
    for (overall, truth) in [(&report.coulomb, BENCH.coulomb), (&report.stat, BENCH.stat)] {
        let [low, high] = overall.ci95.unwrap();
        assert!(low < truth && truth < high, "{truth} outside {low} to {high}");
        assert!(high - low < 0.05 * truth, "{low} to {high}");
        assert_eq!(overall.speeds.len(), 7);
        assert!(overall.speeds.iter().all(|s| s.trials == 5));
    }
}

#[test]
#[cfg_attr(debug_assertions, ignore = "statistics: run with --release")]
fn intervals_cover_the_truth() {
    let reports: Vec<Report> =
        (0..100u64).into_par_iter().map(|seed| run(made(&BENCH, 1000 + seed).path()).unwrap()).collect();
    let inside = |ci: Option<[f64; 2]>, truth: f64| ci.is_some_and(|[low, high]| low <= truth && truth <= high);
    let coulomb = reports.iter().filter(|r| inside(r.coulomb.ci95, BENCH.coulomb)).count();
    let stat = reports.iter().filter(|r| inside(r.stat.ci95, BENCH.stat)).count();
    let each =
        reports.iter().flat_map(|r| &r.coulomb.speeds).filter(|s| inside(s.coefficient.ci95, BENCH.coulomb)).count();
    let trend = reports.iter().filter(|r| r.coulomb.slope_p.unwrap() < 0.05).count();
    let flat = reports.iter().filter(|r| inside(r.coulomb.slope_s_m.and_then(|s| s.ci95), 0.0)).count();
    println!("of 100: Coulomb {coulomb}, static {stat}, slope {flat}; of 700 speeds {each}; false trends {trend}");
    let mean = |f: fn(&Report) -> f64| reports.iter().map(f).sum::<f64>() / reports.len() as f64;
    println!("means: Coulomb {:.5}, static {:.5}", mean(|r| r.coulomb.value), mean(|r| r.stat.value));
    assert!((90..=98).contains(&coulomb) && (90..=98).contains(&stat), "{coulomb} {stat}");
    assert!((630..=686).contains(&each) && trend <= 11);
}

#[test]
fn a_dependence_on_speed_is_reported() {
    let folder = made(&Bench { slope_s_m: 120.0, ..BENCH }, 9);
    let report = run(folder.path()).unwrap();
    let slope = report.coulomb.slope_s_m.unwrap();
    let [low, high] = slope.ci95.unwrap();
    // How often the interval holds the truth is counted over many seeds below; here that the trend is seen.
    assert!(low > 0.0 && (slope.value / 120.0 - 1.0).abs() < 0.25, "{slope:?} {high}");
    assert!(report.notes.iter().any(|n| n.contains("Coulomb") && n.contains("speed")));
    assert!(report.stat.slope_p.unwrap() > 0.05);
}

#[test]
fn a_missing_trial_is_named() {
    let folder = made(&BENCH, 1);
    std::fs::remove_file(folder.path().join("motor/200_rpm_3.csv")).unwrap();
    let message = run(folder.path()).unwrap_err();
    assert!(message.contains("200_rpm_3") && message.contains("missing") && message.contains("5 trials"), "{message}");
    let report = identify(folder.path(), true).unwrap().report;
    assert_eq!(report.coulomb.speeds[2].trials, 4);
}

#[test]
fn a_reversed_sign_is_named() {
    let folder = made(&BENCH, 2);
    let path = folder.path().join("motor/300_rpm_2.csv");
    let turned: String = std::fs::read_to_string(&path)
        .unwrap()
        .lines()
        .map(|l| match l.split_once(",-") {
            Some((t, v)) => format!("{t},{v}\n"),
            None => l
                .split_once(',')
                .filter(|c| c.1 != "torque_nm")
                .map_or(format!("{l}\n"), |(t, v)| format!("{t},-{v}\n")),
        })
        .collect();
    std::fs::write(&path, turned).unwrap();
    let message = run(folder.path()).unwrap_err();
    assert!(message.contains("300_rpm_2.csv") && message.contains("other sign"), "{message}");

    let toml = folder.path().join("friction.toml");
    std::fs::write(&toml, std::fs::read_to_string(&toml).unwrap().replace("torque_sign = -1", "torque_sign = 1"))
        .unwrap();
    let message = run(folder.path()).unwrap_err();
    assert!(message.contains("torque_sign"), "{message}");
}

#[test]
fn a_wrong_geometry_is_named() {
    for (from, to, expected) in [
        ("torque_arm_m = 0.2075", "torque_arm_m = 207.5", "millimetres"),
        ("gear_reduction = 29.0", "gear_reduction = 58.0", "gear_reduction"),
        ("lead_mm = 2.0", "lead_mm = 4.0", "lead_mm"),
        ("weight_kg = 0.21083", "weight_kg = 0.0021083", "weight_kg"),
        ("weight_kg = 0.21083", "weight_kg = -0.2", "weight_kg"),
        ("lead_mm = 2.0", "led_mm = 2.0", "led_mm"),
    ] {
        let folder = made(&BENCH, 3);
        let toml = folder.path().join("friction.toml");
        std::fs::write(&toml, std::fs::read_to_string(&toml).unwrap().replace(from, to)).unwrap();
        let message = run(folder.path()).unwrap_err();
        assert!(message.contains(expected), "{to}: {message}");
    }
}

#[test]
fn a_bad_cell_is_named_by_line() {
    let folder = made(&BENCH, 3);
    let path = folder.path().join("static/100_rpm_1.csv");
    let mut lines: Vec<String> = std::fs::read_to_string(&path).unwrap().lines().map(str::to_owned).collect();
    lines[7] = "0.0240,oops".to_owned();
    std::fs::write(&path, lines.join("\n")).unwrap();
    let message = run(folder.path()).unwrap_err();
    assert!(
        message.contains("100_rpm_1.csv") && message.contains("line 8") && message.contains("torque_nm"),
        "{message}"
    );
}
