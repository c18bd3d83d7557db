//! One run only: fitted on its first turn, scored on the later ones.
//!
//! Whole runs cannot be held out, so later turns are: what repeats with the angle, or goes on with time, must do so
//! where it was not fitted. The start-up happens once; what is said about it cannot be replicated, and the answer says so.

use super::baseline::baseline_free;
use super::finding::{Estimate, Finding, Status, Unknown};
use super::fit::refit;
use super::observe::{Observed, Window};
use super::problem::{Basis, Column, Problem, RunDesign};
use super::rotor::{P, Parameters};
use super::search::{LARGEST_P, LEAST_GAIN};
use super::stats::{Fold, Grams, Group, HeldOut, p_value};
use std::f64::consts::{PI, TAU};

/// End of the start-up in s: the first part of a drive, taken apart.
pub const START_UP_S: f64 = 0.1;
/// Half the window over which digitised speeds were smoothed, in s: earlier samples mix rest and motion.
const SMOOTHING_S: f64 = 0.0105;
/// Largest p-value at which an effect stays in the model as ambiguous: half turns of one run are few, and what is left out
/// would be blamed on the others.
const SUGGESTIVE_P: f64 = 0.05;
/// Harmonics of the angle profile.
const HARMONICS: usize = 4;
/// Thermal time constant assumed where one turn cannot tell it, in s.
const THERMAL_S: f64 = 2.0;

/// What one run shows.
#[derive(Debug, Clone)]
pub struct SingleOutcome {
    /// The run.
    pub run: Observed,
    /// Evidence an effect.
    pub findings: Vec<Finding>,
    /// Without a cause.
    pub unknown: Vec<Unknown>,
    /// Errors on later turns, baseline and extended, by half turns.
    pub held_out: HeldOut,
    /// Noise floor in rpm: spread between neighbouring windows.
    pub noise_floor: f64,
    /// Angle error over the later turns in degrees, baseline and extended.
    pub position_deg: [f64; 2],
    /// Effects that cannot be judged.
    pub not_judged: Vec<(String, String)>,
    /// Time of each window's middle in s, measured speed, baseline, extended in rpm.
    pub curve: Vec<[f64; 4]>,
    /// Time at which the scored part begins, in s.
    pub scored_from_s: f64,
}

/// Diagnoses one run.
pub fn search(run: Observed, start: Parameters, repetitions: usize, seed: u64, without: &[String]) -> SingleOutcome {
    let smooth = run.pitch == 0.0;
    let turns = run.revolutions();
    let middle = |w: &Window| 0.5 * (run.times[w.from] + run.times[w.to]);
    let angle = |w: &Window| 0.5 * (run.angles[w.from] + run.angles[w.to]).abs();
    let by_turns = turns >= 1.5;
    let half_time = 0.5 * run.drive_end.min(run.record_end);
    let drive_end = run.drive_end;
    let later = |w: &Window| if by_turns { angle(w) >= TAU } else { middle(w) >= half_time };
    let early = |w: &Window| middle(w) < START_UP_S;
    let usable = |w: &Window| middle(w) <= drive_end;

    // The baseline is refitted on the first turn without the start-up.
    let mut first = run.clone();
    first.windows.retain(|w| usable(w) && !later(w) && !early(w));
    let free = baseline_free(&start, &start, false);
    let few = if run.duty.is_some_and(|d| d >= 1.0 - 1e-9) { 1 } else { free.len() };
    let fitting = Problem::new(vec![first]);
    let (baseline, _) = refit(&fitting, fitting.model(start), &free[..few], &[], 10);

    let problem = Problem::new(vec![run.clone()]);
    let mut columns = vec![Column::Scalar {
        parameter: P::FreeSpeed,
        scale: baseline.parameters.get(P::FreeSpeed),
        step: 0.02 * baseline.parameters.get(P::FreeSpeed),
        shape: Vec::new(),
    }];
    let mut scales = vec![1.0];
    // Smoothed speeds repeat each other: their number counts for less.
    let (memory, block) = if smooth { (21.0f64, 42) } else { (1.0, 12) };
    let mut candidates: Vec<(&'static str, Vec<usize>)> = Vec::new();
    let mut add = |name: &'static str, list: Vec<(Column, f64)>| {
        let from = columns.len();
        for (c, s) in list {
            columns.push(c);
            scales.push(s / memory.sqrt());
        }
        candidates.push((name, (from..columns.len()).collect()));
    };
    add(
        "preload-runout",
        (0..2 * HARMONICS).map(|j| (Column::Flexible(Basis::Angle(j)), if j < 4 { 0.15 } else { 0.03 })).collect(),
    );
    add("encoder-eccentricity", vec![(Column::Eccentricity(0), 0.1), (Column::Eccentricity(1), 0.1)]);
    let heat = vec![(P::HeatTau, THERMAL_S)];
    add(
        "resonance-heating",
        vec![(Column::Scalar { parameter: P::HeatLoss, scale: 1.0, step: 0.02, shape: heat }, 0.1)],
    );
    if !smooth {
        add(
            "unequal-edges",
            vec![(Column::Scalar { parameter: P::EdgeOffset, scale: 1.0, step: 0.01, shape: Vec::new() }, 0.2)],
        );
    }
    candidates.retain(|(n, _)| !without.iter().any(|w| w == n));
    let settle_at = columns.len();
    const TAUS: [f64; 10] = [0.004, 0.006, 0.009, 0.013, 0.019, 0.028, 0.04, 0.06, 0.09, 0.13];
    for tau in TAUS {
        let shape = vec![(P::SettleTau, tau)];
        columns.push(Column::Scalar { parameter: P::SettleExcess, scale: 1.0, step: 0.02, shape });
        scales.push(0.5 / memory.sqrt());
    }
    let flexible_at = columns.len();
    for j in 0..6 {
        columns.push(Column::Flexible(Basis::Time(j, 6)));
        scales.push(0.1 / memory.sqrt());
    }
    let design = problem.design(&baseline, &columns).remove(0);

    // Half turns are the pieces the bootstrap draws; the start-up is one of its own.
    let windows = &run.windows;
    let piece_of = |w: &Window| -> Option<usize> {
        if !usable(w) || (smooth && middle(w) < 1.2 * SMOOTHING_S) {
            None
        } else if early(w) {
            Some(0)
        } else if by_turns {
            Some(1 + (angle(w) / PI) as usize)
        } else {
            Some(1 + (8.0 * middle(w) / run.record_end.max(1e-9)) as usize)
        }
    };
    let pieces = windows.iter().filter_map(piece_of).max().unwrap_or(0) + 1;
    let empty = RunDesign { columns: columns.len(), x: Vec::new(), y: Vec::new(), weight: Vec::new(), seconds: 0.0 };
    let mut parts = vec![empty; pieces];
    let mut is_test = vec![false; pieces];
    for (k, w) in windows.iter().enumerate() {
        if let Some(p) = piece_of(w) {
            let part = &mut parts[p];
            part.x.extend_from_slice(&design.x[k * columns.len()..(k + 1) * columns.len()]);
            part.y.push(design.y[k]);
            part.weight.push(design.weight[k]);
            part.seconds += run.duration(w);
            is_test[p] = p > 0 && later(w);
        }
    }
    let train: Vec<usize> = (1..pieces).filter(|p| !is_test[*p] && parts[*p].seconds > 0.0).collect();
    let test: Vec<usize> = (1..pieces).filter(|p| is_test[*p]).collect();
    let division = vec![Fold { train: train.clone(), test: test.clone() }];
    // Around what is accepted so far: residuals without it, and the noise they then show.
    let around = |base: &[usize]| -> Grams {
        let first = Grams::with_blocks(&parts, 0, &scales, None, division.clone(), block);
        let variance = spread_after(&parts, &train, base, &first.fit(&train, base));
        let beta = first.with_noise(variance, 0.0);
        let beta = beta.fit(&train, base);
        let mut rest = parts.clone();
        for part in &mut rest {
            remove(part, base, &beta);
        }
        let variance = spread_after(&parts, &train, base, &beta);
        Grams::with_blocks(&rest, 0, &scales, None, division.clone(), block).with_noise(variance, 0.0)
    };
    let mut grams = around(&[0]);

    let mut base = vec![0];
    let mut accepted: Vec<&'static str> = Vec::new();
    let mut findings: Vec<Finding> = Vec::new();
    let mut rejected: Vec<Finding> = Vec::new();
    for round in 0..3u64 {
        let open: Vec<&(&'static str, Vec<usize>)> = candidates.iter().filter(|c| !accepted.contains(&c.0)).collect();
        if open.is_empty() || test.is_empty() {
            break;
        }
        let groups: Vec<Group> = open.iter().map(|c| Group::Linear(c.1.clone())).collect();
        let (improvements, null) = grams.screen(&base, &groups, repetitions, seed + round);
        let held: Vec<HeldOut> = groups.iter().map(|g| grams.hold_out(&base, g)).collect();
        let evidence = |k: usize, status: Status| -> Finding {
            let set = [base.clone(), open[k].1.clone()].concat();
            let beta = grams.fit(&train, &set);
            let cov = grams.covariance(&set) * memory;
            let own: Vec<(f64, f64)> =
                (base.len()..set.len()).map(|i| (beta[i], cov[(i, i)].max(0.0).sqrt())).collect();
            Finding {
                name: open[k].0.to_owned(),
                status,
                gain: held[k].gain(),
                gain_interval: held[k].gain_interval(seed),
                p_null: p_value(improvements[k], &null),
                parameters: parameters(open[k].0, &own),
                conflicts: Vec::new(),
                next_experiment: experiment(open[k].0).to_owned(),
                share: 0.0,
                note: String::new(),
            }
        };
        if round == 0 {
            rejected = (0..open.len()).map(|k| evidence(k, Status::Rejected)).collect();
        }
        let mut order: Vec<usize> = (0..open.len()).collect();
        order.sort_by(|a, b| improvements[*b].total_cmp(&improvements[*a]));
        let winner = order[0];
        let mut f = evidence(winner, Status::Named);
        let admissible = f.name != "resonance-heating" || f.parameters[0].value > 0.0;
        if f.p_null > SUGGESTIVE_P || f.gain < LEAST_GAIN || f.gain_interval[0] <= 0.0 || !admissible {
            if let Some(r) = rejected.iter_mut().find(|r| r.name == f.name) {
                *r = Finding {
                    note: format!(
                        "p = {:.3}, gain {:.1} %{}",
                        f.p_null,
                        100.0 * f.gain,
                        if admissible { "" } else { ", of the wrong sign" }
                    ),
                    status: Status::Rejected,
                    ..f
                };
            }
            break;
        }
        for k in order.into_iter().skip(1) {
            if held[k].gain() >= 0.5 * held[winner].gain() && held[winner].lead_interval(&held[k], seed)[0] <= 0.0 {
                f.conflicts.push(open[k].0.to_owned());
                f.status = Status::Ambiguous;
            }
        }
        if f.p_null > LARGEST_P {
            f.status = Status::Ambiguous;
            f.note = format!("p = {:.3} would not name it even if nothing rivalled it", f.p_null);
        }
        if f.name == "resonance-heating" {
            f.conflicts.push("run-in-wear".to_owned());
            f.status = Status::Ambiguous;
            f.note = format!(
                "{}{}one run cannot tell warmth from wear, nor the time constant (taken as {THERMAL_S} s); the size leans on the angle profile fitted with it",
                f.note,
                if f.note.is_empty() { "" } else { "; " }
            );
        }
        base.extend(&open[winner].1);
        accepted.push(open[winner].0);
        findings.push(f);
        grams = around(&base);
    }

    let plain = {
        let first = Grams::with_blocks(&parts, 0, &scales, None, division.clone(), block);
        let variance = spread_after(&parts, &train, &base, &first.fit(&train, &base));
        first.with_noise(variance, 0.0)
    };

    // The start-up: with the angle profile known from later, what is left in the first tenth of a second?
    let mut settle_set: Option<(usize, f64)> = None;
    if parts[0].y.len() > 20 && !without.iter().any(|w| w == "frequency-settling") {
        let beta = plain.fit(&(1..pieces).collect::<Vec<_>>(), &base);
        let width = columns.len();
        let rest: Vec<f64> = (0..parts[0].y.len())
            .map(|k| {
                parts[0].y[k] - base.iter().zip(beta.iter()).map(|(c, b)| parts[0].x[k * width + c] * b).sum::<f64>()
            })
            .collect();
        let before: f64 = rest.iter().map(|r| r * r).sum();
        let mut best = (f64::INFINITY, 0, 0.0);
        for t in 0..TAUS.len() {
            let c = settle_at + t;
            let (mut xx, mut xy) = (0.0, 0.0);
            for (k, left) in rest.iter().enumerate() {
                let x = parts[0].x[k * width + c];
                xx += x * x;
                xy += x * left;
            }
            let amplitude = if xx > 0.0 { xy / xx } else { 0.0 };
            let after = before - amplitude * xy;
            if after < best.0 {
                best = (after, t, amplitude);
            }
        }
        let (after, t, amplitude) = best;
        let gain = 1.0 - (after.max(0.0) / before.max(1e-12)).sqrt();
        // Spread of the same fit at other starts along the run: how often does plain variation look like this?
        let scores = elsewhere(&parts, &base, &beta, &TAUS, settle_at, width, parts[0].y.len());
        let p = (1 + scores.iter().filter(|s| **s >= before - after).count()) as f64 / (1 + scores.len()) as f64;
        let error = (after / (rest.len() as f64 / memory).max(1.0) / before.max(1e-12)).sqrt() * amplitude.abs() * 2.0;
        // Blocks as long as the smoothing are drawn again: what the fit gains in each.
        let pairs: Vec<[f64; 2]> = (0..rest.len())
            .step_by(block / 2)
            .map(|from| {
                let to = (from + block / 2).min(rest.len());
                let mut pair = [0.0; 2];
                for (k, left) in rest.iter().enumerate().take(to).skip(from) {
                    let x = parts[0].x[k * width + settle_at + t];
                    pair[0] += left * left;
                    pair[1] += (left - amplitude * x).powi(2);
                }
                pair
            })
            .collect();
        let seconds = vec![1.0; pairs.len()];
        let gain_interval = HeldOut { loss: pairs.clone(), plain: pairs, seconds }.gain_interval(seed);
        let real = gain >= LEAST_GAIN && gain_interval[0] > 0.0 && amplitude.abs() > 1.96 * error;
        if real {
            settle_set = Some((settle_at + t, amplitude));
        }
        findings.push(Finding {
            name: "frequency-settling".to_owned(),
            status: if real { Status::Ambiguous } else { Status::Rejected },
            gain,
            gain_interval,
            p_null: p,
            parameters: vec![
                estimate("relative_excess_at_start", amplitude, error, "1"),
                Estimate {
                    name: "settling_time_s".to_owned(),
                    value: TAUS[t],
                    interval: [TAUS[t.saturating_sub(1)], TAUS[(t + 1).min(TAUS.len() - 1)]],
                    unit: "s".to_owned(),
                },
            ],
            conflicts: vec!["resonance-heating".to_owned(), "start-delay".to_owned()],
            next_experiment: "repeat starts of 0.2 s from different angles, after pauses of 1 s and 30 s: settling repeats at each, heating depends on the pause".to_owned(),
            share: 0.0,
            note: "the same angles passed a turn later show no such excess, so it is not the angle; but there is one start \
                   only, its gain is that of the fit itself (not held out), and p counts how often other stretches of the run look like it"
                .to_owned(),
        });
    }

    let flexible = Group::Linear((flexible_at..flexible_at + 6).collect());
    let mut unknown = Vec::new();
    if !test.is_empty() {
        let (improvement, null) = grams.screen(&base, std::slice::from_ref(&flexible), repetitions, seed + 55);
        let p = p_value(improvement[0], &null);
        let gain = grams.hold_out(&base, &flexible).gain();
        if p <= LARGEST_P && gain > 0.0 {
            unknown.push(Unknown { lives_in: "time", gain, p_null: p });
        }
    }
    let held_out = plain.hold_out(&[0], &Group::Linear(base[1..].to_vec()));
    let beta_base = plain.fit(&train, &[0]);
    let beta = plain.fit(&train, &base);
    let residuals = problem.residuals(&baseline).remove(0);
    let width = columns.len();
    let mut curve = Vec::with_capacity(windows.len());
    let mut error = [0.0; 2];
    let mut square = [0.0; 2];
    let mut seconds = 0.0;
    for (k, w) in windows.iter().enumerate() {
        let weight = design.weight[k].max(1e-9);
        let measured = residuals.predicted[k] + residuals.rpm[k];
        let plain = residuals.predicted[k] + design.x[k * width] * beta_base[0] / weight;
        let mut full = residuals.predicted[k];
        for (c, b) in base.iter().zip(beta.iter()) {
            full += design.x[k * width + c] * b / weight;
        }
        if let Some((c, amplitude)) = settle_set {
            full += design.x[k * width + c] * amplitude / weight;
        }
        curve.push([middle(w), measured, plain, full]);
        if later(w) && usable(w) {
            let dt = run.duration(w);
            for (i, predicted) in [plain, full].into_iter().enumerate() {
                error[i] += (measured - predicted) * dt * 6.0;
                square[i] += error[i] * error[i] * dt;
            }
            seconds += dt;
        }
    }
    for f in rejected {
        if !findings.iter().any(|g| g.name == f.name) {
            findings.push(f);
        }
    }
    let scored_from_s = windows.iter().find(|w| later(w)).map_or(run.record_end, middle);
    let noise_floor = neighbours(&curve, if smooth { 21 } else { 1 });
    SingleOutcome {
        findings,
        unknown,
        held_out,
        noise_floor,
        position_deg: square.map(|s| (s / f64::max(seconds, 1e-9)).sqrt()),
        not_judged: not_judged(&run),
        curve,
        scored_from_s,
        run,
    }
}

/// Mean squared residual of the fitted parts, in the units of the design.
fn spread_after(parts: &[RunDesign], train: &[usize], base: &[usize], beta: &nalgebra::DVector<f64>) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for p in train {
        let mut part = parts[*p].clone();
        remove(&mut part, base, beta);
        sum += part.y.iter().map(|y| y * y).sum::<f64>();
        n += part.y.len() as f64;
    }
    (sum / f64::max(n, 1.0)).max(1e-12)
}

fn remove(part: &mut RunDesign, base: &[usize], beta: &nalgebra::DVector<f64>) {
    for k in 0..part.y.len() {
        part.y[k] -= base.iter().zip(beta.iter()).map(|(c, b)| part.x[k * part.columns + c] * b).sum::<f64>();
    }
}

fn estimate(name: &str, value: f64, error: f64, unit: &str) -> Estimate {
    Estimate {
        name: name.to_owned(),
        value,
        interval: [value - 1.96 * error, value + 1.96 * error],
        unit: unit.to_owned(),
    }
}

fn parameters(name: &str, own: &[(f64, f64)]) -> Vec<Estimate> {
    let amplitude = |i: usize, name: &str, unit: &str| {
        let (a, b) = (own[i], own[i + 1]);
        estimate(name, a.0.hypot(b.0), (0.5 * (a.1 * a.1 + b.1 * b.1)).sqrt(), unit)
    };
    match name {
        "preload-runout" => {
            let mut list = vec![amplitude(0, "once_a_turn", "1"), amplitude(2, "twice_a_turn", "1")];
            if own.len() >= 8 {
                list.push(amplitude(4, "three_times_a_turn", "1"));
                list.push(amplitude(6, "four_times_a_turn", "1"));
            }
            list
        }
        "encoder-eccentricity" => vec![amplitude(0, "eccentricity_rad", "rad")],
        "resonance-heating" => vec![estimate("speed_loss_warm", own[0].0, own[0].1, "1")],
        _ => vec![estimate("high_slot_excess", own[0].0, own[0].1, "1")],
    }
}

fn experiment(name: &str) -> &'static str {
    match name {
        "preload-runout" | "encoder-eccentricity" => {
            "re-seat the rotor by 90° against the encoder wheel and repeat the run; a second run at half the duty tells them apart too"
        }
        "resonance-heating" => "run 30 s, pause 60 s, run again: warmth recovers, wear does not",
        _ => "repeat the run",
    }
}

fn not_judged(run: &Observed) -> Vec<(String, String)> {
    let one = "one duty and one direction cannot show it";
    let order = "one run has no order";
    let mut list: Vec<(&str, &str)> = vec![
        ("dead-zone", one),
        ("high-duty-saturation", one),
        ("duty-quantisation", one),
        ("supply-sag", one),
        ("direction-asymmetry", one),
        ("run-in-wear", order),
    ];
    if run.duty.is_some_and(|d| d >= 1.0 - 1e-9) {
        list.push(("start-delay", "full duty has one PWM rise only"));
        list.push(("off-phase-braking", "full duty has no off phase"));
        list.push(("clock-error", "full duty has no PWM line"));
    }
    if run.pitch == 0.0 {
        list.push(("unequal-edges", "the record holds speeds, not edges"));
    }
    list.into_iter().map(|(a, b)| (a.to_owned(), b.to_owned())).collect()
}

/// Improvements that the start-up's form would make at other places of the run.
fn elsewhere(
    parts: &[RunDesign],
    base: &[usize],
    beta: &nalgebra::DVector<f64>,
    taus: &[f64],
    settle_at: usize,
    width: usize,
    length: usize,
) -> Vec<f64> {
    let rest: Vec<f64> = parts[1..]
        .iter()
        .flat_map(|d| {
            (0..d.y.len())
                .map(move |k| d.y[k] - base.iter().zip(beta.iter()).map(|(c, b)| d.x[k * width + c] * b).sum::<f64>())
        })
        .collect();
    let mut scores = Vec::new();
    let mut at = 0;
    while at + length <= rest.len() {
        let mut best: f64 = 0.0;
        for t in 0..taus.len() {
            let (mut xx, mut xy) = (0.0, 0.0);
            for k in 0..length {
                let x = parts[0].x[k * width + settle_at + t];
                xx += x * x;
                xy += x * rest[at + k];
            }
            if xx > 0.0 {
                best = best.max(xy * xy / xx);
            }
        }
        scores.push(best);
        at += (length / 4).max(1);
    }
    scores
}

/// Spread of the residual between samples `lag` apart, in rpm: what no smooth model can follow.
fn neighbours(curve: &[[f64; 4]], lag: usize) -> f64 {
    let rest: Vec<f64> = curve.iter().filter(|c| c[0] > START_UP_S).map(|c| c[1] - c[3]).collect();
    if rest.len() <= 2 * lag {
        return 0.0;
    }
    let n = rest.len() - 2 * lag;
    ((0..n).map(|k| (rest[k] - 2.0 * rest[k + lag] + rest[k + 2 * lag]).powi(2) / 6.0).sum::<f64>() / n as f64).sqrt()
}
