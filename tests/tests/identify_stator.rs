//! Identification of a stator: known circuits through noise, probe capacitance and an 8-bit oscilloscope.
//!
//! The statistics are for release builds: `cargo test --release -p twum-tests --test identify_stator -- --nocapture`.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use std::f64::consts::TAU;
use twum_host::identify::read::{ReadOptions, read};
use twum_host::identify::stator::{Options, Report, Verdict, identify};

/// Seeds of each study.
const SEEDS: u64 = 200;

/// Elements of the circuit behind the data, computed here by themselves: L (H), C (F), R (Ω), Cd (F), Rd (Ω).
#[derive(Clone, Copy)]
struct Truth {
    l: f64,
    c: f64,
    r: f64,
    cd: f64,
    rd: f64,
}

/// The thesis's stator: Ms, Cs and Ks of section A.4 over η², with a clamped capacitance and a loss chosen here.
const STATOR: Truth = Truth { l: 2.1094, c: 6.1653e-12, r: 18_488.0, cd: 150e-12, rd: 2e6 };

fn admittance(truth: &Truth, f: f64) -> (f64, f64) {
    let w = TAU * f;
    let x = w * truth.l - 1.0 / (w * truth.c);
    let m = truth.r * truth.r + x * x;
    (truth.r / m + 1.0 / truth.rd, -x / m + w * truth.cd)
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// The thesis's sweep: 30 to 50 kHz by 10 Hz.
fn thesis_sweep() -> impl Iterator<Item = f64> {
    (0..2001).map(|i| 30_000.0 + 10.0 * f64::from(i))
}

/// Standard deviation of each component over |Y|, for noise in proportion: 40 dB is 1 % of |Y|, split over both.
fn share(decibel: f64) -> f64 {
    10f64.powf(-decibel / 20.0) / 2f64.sqrt()
}

/// Admittance of so many sweeps of a circuit with noise in proportion to it.
fn admittance_csv(truth: &Truth, seed: u64, decibel: f64, sweeps: usize) -> String {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = String::from("frequency_hz,g,b\n");
    for f in std::iter::repeat_n((), sweeps).flat_map(|()| thesis_sweep()) {
        let (g, b) = admittance(truth, f);
        let s = share(decibel) * g.hypot(b);
        out += &format!("{f},{:e},{:e}\n", g + s * normal(&mut rng), b + s * normal(&mut rng));
    }
    out
}

/// Elements in the order of the information matrix.
fn elements(t: &Truth) -> [f64; 5] {
    [t.l, t.c, t.r, t.cd, t.rd]
}

/// The circuit with one element's logarithm moved.
fn moved(truth: &Truth, element: usize, by: f64) -> Truth {
    let mut e = elements(truth);
    e[element] *= by.exp();
    let [l, c, r, cd, rd] = e;
    Truth { l, c, r, cd, rd }
}

/// Fisher information on the logarithms of the five elements in one [`admittance_csv`] sweep, the noise level known.
///
/// Each component of Y is Gaussian about the circuit's with standard deviation s·|Y|, so that the elements show in the
/// mean and, a little, in the variance: I = Σ Re(∂Y*ᵢ ∂Yⱼ)/(s·|Y|)² + (∂|Y|²ᵢ/|Y|²)(∂|Y|²ⱼ/|Y|²) (Kay, Estimation Theory,
/// 1993, section 3.9).
fn information(truth: &Truth, decibel: f64) -> [[f64; 5]; 5] {
    let mut sum = [[0.0; 5]; 5];
    let h = 1e-5;
    for f in thesis_sweep() {
        let (g, b) = admittance(truth, f);
        let power = g * g + b * b;
        let slopes: [(f64, f64); 5] = std::array::from_fn(|i| {
            let (up, down) = (admittance(&moved(truth, i, h), f), admittance(&moved(truth, i, -h), f));
            ((up.0 - down.0) / (2.0 * h), (up.1 - down.1) / (2.0 * h))
        });
        for (i, p) in slopes.iter().enumerate() {
            for (j, q) in slopes.iter().enumerate() {
                let by_mean = (p.0 * q.0 + p.1 * q.1) / (share(decibel).powi(2) * power);
                let by_variance = 4.0 * (g * p.0 + b * p.1) * (g * q.0 + b * q.1) / (power * power);
                sum[i][j] += by_mean + by_variance;
            }
        }
    }
    sum
}

/// x with A·x = y, by elimination; the matrices here are positive definite.
fn solve(mut a: [[f64; 5]; 5], mut y: [f64; 5]) -> [f64; 5] {
    for k in 0..5 {
        for i in 0..5 {
            if i != k {
                let factor = a[i][k] / a[k][k];
                let pivot = a[k];
                a[i].iter_mut().zip(pivot).for_each(|(x, p)| *x -= factor * p);
                y[i] -= factor * y[k];
            }
        }
    }
    std::array::from_fn(|k| y[k] / a[k][k])
}

/// Relative standard deviation that no unbiased estimator of a quantity stays below (Cramér and Rao).
fn bound(truth: &Truth, decibel: f64, quantity: usize) -> f64 {
    let h = 1e-5;
    let of = |t: &Truth| truths(t)[quantity].1.ln();
    let slope: [f64; 5] = std::array::from_fn(|i| (of(&moved(truth, i, h)) - of(&moved(truth, i, -h))) / (2.0 * h));
    let x = solve(information(truth, decibel), slope);
    slope.iter().zip(&x).map(|(a, b)| a * b).sum::<f64>().sqrt()
}

/// Impedance with noise even in ohm, behind a probe of 12 pF that the reader is told of.
fn impedance_csv(truth: &Truth, seed: u64) -> String {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let truth = Truth { cd: truth.cd + 12e-12, ..*truth };
    let mut out = String::from("frequency_hz,z_re,z_im\n");
    for i in 0..1001 {
        let f = 38_000.0 + 12.0 * f64::from(i);
        let (g, b) = admittance(&truth, f);
        let m = g * g + b * b;
        out += &format!("{f},{:e},{:e}\n", g / m + 120.0 * normal(&mut rng), -b / m + 120.0 * normal(&mut rng));
    }
    out
}

/// What an 8-bit oscilloscope of 25 counts a division shows on both sides of a 2 kΩ shunt, the phase left to the trigger.
fn waveform_csv(truth: &Truth, seed: u64) -> String {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let volt_a_count = 1.0 / 25.0;
    let quantise = |v: f64| (v / volt_a_count).round().clamp(-127.0, 128.0) * volt_a_count;
    let mut out = String::from("frequency_hz,time_s,v1,v2\n");
    for i in 0..201 {
        let f = 38_000.0 + 60.0 * f64::from(i);
        let (g, b) = admittance(truth, f);
        let phase = 0.05 * (rng.random::<f64>() - 0.5);
        // V2/V1 of the divider: 1/(1 + R·Y).
        let (dr, di) = (1.0 + 2000.0 * g, 2000.0 * b);
        let (amplitude, lag) = (3.0 / dr.hypot(di), di.atan2(dr));
        for k in 0..300 {
            let t = -30e-6 + 2e-7 * f64::from(k);
            let v1 = quantise(3.0 * (TAU * f * t + phase).sin() + 0.01 * normal(&mut rng));
            let v2 = quantise(amplitude * (TAU * f * t + phase - lag).sin() + 0.01 * normal(&mut rng));
            out += &format!("{f},{t:e},{v1},{v2}\n");
        }
    }
    out
}

fn report(text: &str, read_options: &ReadOptions, options: &Options) -> Report {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sweep.csv");
    std::fs::write(&path, text).unwrap();
    identify(&read(&path, read_options).unwrap(), options).unwrap().report
}

/// Name, truth, and how to read it off the report.
fn truths(t: &Truth) -> Vec<(&'static str, f64)> {
    let fs = 1.0 / (TAU * (t.l * t.c).sqrt());
    let eta2 = 0.5439f64.powi(2);
    vec![
        ("fs_hz", fs),
        ("fp_hz", fs * (1.0 + t.c / t.cd).sqrt()),
        ("c_f", t.c),
        ("l_h", t.l),
        ("r_ohm", t.r),
        ("q", (t.l / t.c).sqrt() / t.r),
        ("cd_f", t.cd),
        ("rd_ohm", t.rd),
        ("ms_kg", eta2 * t.l),
        ("cs_ns_m", eta2 * t.r),
        ("ks_n_m", eta2 / t.c),
    ]
}

fn value(report: &Report, name: &str) -> Option<f64> {
    serde_json::to_value(report).unwrap()[name].as_f64()
}

/// Coverage and worst error of each quantity over seeds, printed as one table beside the thesis's estimator.
fn study(name: &str, truth: &Truth, make: impl Fn(u64) -> String + Sync, read_options: ReadOptions) -> Vec<Report> {
    let reports: Vec<Report> =
        (0..SEEDS).into_par_iter().map(|seed| report(&make(seed), &read_options, &Options::default())).collect();
    println!("{name}: 200 seeds");
    println!("{:<8} {:>9} {:>12} {:>12} {:>14}", "", "coverage", "rms error", "worst", "thesis rms");
    for (field, truth) in truths(truth) {
        let errors: Vec<f64> = reports.iter().filter_map(|r| Some(value(r, field)? / truth - 1.0)).collect();
        let thesis: Vec<f64> = reports
            .iter()
            .filter_map(|r| Some(serde_json::to_value(r.thesis?).unwrap()[field].as_f64()? / truth - 1.0))
            .collect();
        let rms = |e: &[f64]| 100.0 * (e.iter().map(|e| e * e).sum::<f64>() / e.len() as f64).sqrt();
        let covered = reports
            .iter()
            .filter(|r| matches!(r.ci95.get(field), Some(Some([low, high])) if (*low..=*high).contains(&truth)))
            .count() as f64
            / reports.len() as f64;
        let worst = 100.0 * errors.iter().fold(0.0, |w: f64, e| w.max(e.abs()));
        println!("{field:<8} {:>8.1}% {:>11.4}% {worst:>11.4}% {:>13.4}%", 100.0 * covered, rms(&errors), rms(&thesis));
        assert!((0.90..=0.98).contains(&covered), "{name}: {field} covered in {covered}");
    }
    let single = reports.iter().filter(|r| r.verdict == Verdict::SingleMode).count();
    println!("single-mode: {single} of 200\n");
    assert!(single >= 198, "{name}: only {single} of 200 single-mode");
    reports
}

#[test]
#[cfg_attr(debug_assertions, ignore = "statistics: run with --release")]
fn intervals_cover_the_truth_in_admittance_at_40_db() {
    let make = |s| admittance_csv(&STATOR, s, 40.0, 1);
    let reports = study("admittance, 40 dB", &STATOR, make, ReadOptions::default());
    println!("{:<8} {:>12} {:>12}", "", "rms error", "lowest");
    for (i, (field, truth)) in truths(&STATOR).into_iter().enumerate() {
        let errors: Vec<f64> = reports.iter().map(|r| value(r, field).unwrap() / truth - 1.0).collect();
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        let lowest = bound(&STATOR, 40.0, i);
        println!("{field:<8} {:>11.4}% {:>11.4}%", 100.0 * rms, 100.0 * lowest);
        // 200 seeds know a root mean square to 5 %.
        assert!((0.85..1.15).contains(&(rms / lowest)), "{field}: {rms} where {lowest} is possible");
        let off = errors.iter().filter(|e| e.abs() > 0.01).count();
        if lowest < 0.005 {
            assert!(off <= 10, "{field}: beyond 1 % in {off} of 200");
        } else {
            assert_eq!(field, "rd_ohm");
        }
    }
    // Nor does it help to know everything else.
    let alone = information(&STATOR, 40.0)[4][4].powf(-0.5);
    println!("rd_ohm, everything else known: {:.4}%\n", 100.0 * alone);
    assert!(alone > 0.01);
}

#[test]
#[cfg_attr(debug_assertions, ignore = "statistics: run with --release")]
fn seven_sweeps_at_40_db_give_the_loss_within_1_percent() {
    let seeds = 100;
    let errors: Vec<f64> = (0..seeds)
        .into_par_iter()
        .map(|seed| {
            let text = admittance_csv(&STATOR, 500 + seed, 40.0, 7);
            report(&text, &ReadOptions::default(), &Options::default()).rd_ohm.unwrap() / STATOR.rd - 1.0
        })
        .collect();
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / seeds as f64).sqrt();
    let off = errors.iter().filter(|e| e.abs() > 0.01).count();
    println!("7 sweeps: rd_ohm {:.3}% rms, beyond 1 % in {off} of {seeds}", 100.0 * rms);
    assert!(off <= 10, "{off} of {seeds}");
}

#[test]
#[cfg_attr(debug_assertions, ignore = "statistics: run with --release")]
fn intervals_cover_the_truth_in_impedance_behind_a_probe() {
    let options = ReadOptions { stray_f: 12e-12, ..ReadOptions::default() };
    study("impedance, 120 ohm of noise, 12 pF probe", &STATOR, |s| impedance_csv(&STATOR, s), options);
}

#[test]
#[cfg_attr(debug_assertions, ignore = "statistics: run with --release")]
fn intervals_cover_the_truth_through_an_8_bit_oscilloscope() {
    let options = ReadOptions { shunt_ohm: Some(2000.0), ..ReadOptions::default() };
    study("waveforms, 8 bits, 2 kohm shunt", &STATOR, |s| waveform_csv(&STATOR, s), options);
}

#[test]
fn the_bootstrap_agrees_with_the_covariance() {
    let text = admittance_csv(&STATOR, 7, 40.0, 1);
    let plain = report(&text, &ReadOptions::default(), &Options::default());
    let boot = report(&text, &ReadOptions::default(), &Options { bootstrap: 200, ..Options::default() });
    for field in ["fs_hz", "r_ohm", "c_f", "ks_n_m"] {
        let width = |r: &Report| r.ci95[field].map(|[low, high]| high - low).unwrap();
        let ratio = width(&boot) / width(&plain);
        assert!((0.8..1.25).contains(&ratio), "{field}: {ratio}");
    }
}

#[test]
fn a_capacitor_has_no_resonance() {
    let capacitor = Truth { c: 1e-20, ..STATOR };
    let found = report(&admittance_csv(&capacitor, 3, 40.0, 1), &ReadOptions::default(), &Options::default());
    assert_eq!(found.verdict, Verdict::NoResonance);
    assert!(found.fs_hz.is_none() && found.ms_kg.is_none());
    assert!((found.cd_f.unwrap() / 150e-12 - 1.0).abs() < 0.01);
}

#[test]
fn a_split_mode_is_two_modes() {
    let other = Truth { l: 2.0, ..STATOR };
    let mut text = String::from("frequency_hz,g,b\n");
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for i in 0..2001 {
        let f = 30_000.0 + 10.0 * f64::from(i);
        let ((g, b), (g2, b2)) = (admittance(&STATOR, f), admittance(&other, f));
        let (g, b) = (g + 0.5 * g2, b + 0.5 * b2);
        text += &format!("{f},{:e},{:e}\n", g * (1.0 + 0.003 * normal(&mut rng)), b + 3e-7 * normal(&mut rng));
    }
    let found = report(&text, &ReadOptions::default(), &Options::default());
    assert_eq!(found.verdict, Verdict::MultiMode);
    assert_eq!(found.modes.len(), 2);
    let expected = 1.0 / (TAU * (other.l * other.c).sqrt());
    assert!((found.modes[1].fs_hz / expected - 1.0).abs() < 2e-3, "{}", found.modes[1].fs_hz);
    assert!((found.modes[0].r_ohm / STATOR.r - 1.0).abs() < 0.05, "{}", found.modes[0].r_ohm);
    assert!((found.modes[1].r_ohm / (2.0 * other.r) - 1.0).abs() < 0.1, "{}", found.modes[1].r_ohm);
}

#[test]
#[ignore = "needs measured data: .ci/run measured"]
fn measured_transducers_are_told_apart() {
    let data = std::env::var_os("TWUM_DATA").expect("TWUM_DATA names the folder of measured data");
    let folder = std::path::Path::new(&data).join("piezo-impedance");
    let found = |name: &str| {
        identify(&read(&folder.join(name), &ReadOptions::default()).unwrap(), &Options::default()).unwrap().report
    };
    let clean = found("clean_sweep.csv");
    assert_eq!(clean.verdict, Verdict::SingleMode);
    assert!((clean.fs_hz.unwrap() - 31_250.0).abs() < 50.0 && (clean.q.unwrap() - 55.0).abs() < 2.0);
    assert!(clean.residual_rel <= 0.04, "{}", clean.residual_rel);
    assert!(!clean.residual_test.passed && clean.notes.iter().any(|n| n.contains("leads")));
    let messy = found("messy_sweep.csv");
    assert_eq!(messy.verdict, Verdict::MultiMode);
    assert!((messy.fs_hz.unwrap() - 47_000.0).abs() < 500.0);
    for expected in [25_800.0, 32_700.0] {
        assert!(messy.modes.iter().any(|m| (m.fs_hz - expected).abs() < 400.0), "none near {expected}");
    }
}
