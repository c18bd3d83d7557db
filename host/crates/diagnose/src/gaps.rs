//! Dropped samples: the recorder loses a word of 32 samples, and what follows moves up in time.
//!
//! A gap is an event, not a parameter, so it is looked for before everything else: each run is followed window by window
//! through the states "n words lost so far", and the cheapest path is taken (Viterbi). The PWM line makes the shift visible:
//! after a gap the drive's phases no longer fit the record's time.

use super::finding::{Estimate, Finding, Status};
use super::observe::{Observed, Window};
use super::problem::{Model, Problem, RPM, RunResidual};
use super::stats::HeldOut;
use super::verdict::{LARGEST_P, LEAST_GAIN};
use twum_record::measurement::RunKind;

/// Samples in a word of the thesis's capture.
const WORD: f64 = 32.0;
/// Most words lost in one run that are looked for.
const MOST: usize = 4;

/// What was found.
#[derive(Debug, Clone)]
pub struct Gaps {
    /// Runs with the lost time put back.
    pub problem: Problem,
    /// Words lost in each run.
    pub lost: Vec<usize>,
    /// The evidence.
    pub finding: Finding,
}

/// Looks for lost words in runs sampled on a grid; `None` if there are none.
pub fn find(problem: &Problem, model: &Model, seed: u64) -> Option<Gaps> {
    let usable =
        |r: &Observed| r.kind == RunKind::Speed && r.pitch > 0.0 && r.time_spread > 1e-4 && r.windows.len() > 20;
    if !problem.runs.iter().any(usable) {
        return None;
    }
    let now = problem.residuals(model);
    let variance = typical_variance(problem, &now);
    let shifts: Vec<Vec<Vec<f64>>> = (0..=MOST)
        .map(|m| {
            let mut shifted = problem.clone();
            for run in &mut shifted.runs {
                let step = word_s(run) * m as f64;
                for t in &mut run.times {
                    *t += step;
                }
            }
            shifted.angles(model)
        })
        .collect();
    let mut runs = problem.runs.clone();
    let mut lost = vec![0; runs.len()];
    let mut best_improvement: f64 = 0.0;
    let windows: usize = problem.runs.iter().map(|r| r.windows.len()).sum();
    for (i, run) in problem.runs.iter().enumerate() {
        if !usable(run) {
            continue;
        }
        let angles: Vec<&Vec<f64>> = shifts.iter().map(|s| &s[i]).collect();
        let path = follow(run, &angles, variance, (windows as f64).ln());
        if let Some((jumps, improvement)) = path {
            best_improvement = best_improvement.max(improvement / jumps.len() as f64);
            lost[i] = jumps.len();
            put_back(&mut runs[i], &jumps);
        }
    }
    let total: usize = lost.iter().sum();
    if total == 0 {
        return None;
    }
    let corrected = Problem::new(runs).with(problem.formulas.clone());
    let after = corrected.residuals(model);
    let squares = squared(problem, &now).zip(squared(&corrected, &after));
    let pairs: Vec<[f64; 2]> = squares.map(|(before, after)| [before, after]).collect();
    let held =
        HeldOut { loss: pairs.clone(), plain: pairs, seconds: problem.runs.iter().map(|r| r.compared_s()).collect() };
    let gain = held.gain();
    let p_null = (windows as f64 * (-0.5 * best_improvement).exp()).clamp(1e-6, 1.0);
    let gain_interval = held.gain_interval(seed);
    // Beside another cause's error a small gain is as much as there can be: every choice among the runs then has to gain by it.
    if (gain < LEAST_GAIN && gain_interval[0] <= 0.0) || p_null > LARGEST_P {
        return None;
    }
    let finding = Finding {
        name: "dropped-samples".to_owned(),
        status: Status::Named,
        probability: None,
        gain,
        gain_interval,
        p_null,
        parameters: vec![
            count("words_lost", total as f64),
            count("runs_affected", lost.iter().filter(|n| **n > 0).count() as f64),
            Estimate { name: "word_s".to_owned(), value: 0.032, interval: [0.032, 0.032], unit: "s".to_owned() },
        ],
        conflicts: Vec::new(),
        next_experiment: "record again with frame sequence numbers (twum capture reports every loss)".to_owned(),
        share: 0.0,
        note: "found in each run by itself; the lost time is put back before anything else is judged".to_owned(),
    };
    Some(Gaps { problem: corrected, lost, finding })
}

/// Variance of a weighted residual, from the middle of the squares: gaps must not set it. Of a square of variance 1 the median is
/// 0.455 (chi-squared of one degree).
fn typical_variance(problem: &Problem, residuals: &[RunResidual]) -> f64 {
    let of = |(run, r): (&Observed, &RunResidual)| -> Vec<f64> {
        run.windows.iter().zip(&r.rpm).map(|(w, v)| v * v * run.duration(w)).collect()
    };
    let mut squares: Vec<f64> = problem.runs.iter().zip(residuals).flat_map(of).collect();
    squares.sort_by(f64::total_cmp);
    (squares[squares.len() / 2] / 0.455).max(1e-9)
}

/// Squared residual of each run, rpm²·s.
fn squared(problem: &Problem, residuals: &[RunResidual]) -> impl Iterator<Item = f64> {
    let of = |(run, r): (&Observed, &RunResidual)| {
        run.windows.iter().zip(&r.rpm).map(|(w, v)| v * v * run.duration(w)).sum()
    };
    problem.runs.iter().zip(residuals).map(of)
}

fn count(name: &str, value: f64) -> Estimate {
    Estimate { name: name.to_owned(), value, interval: [value, value], unit: "1".to_owned() }
}

fn word_s(run: &Observed) -> f64 {
    // time_spread is period / √12.
    WORD * run.time_spread * 12f64.sqrt()
}

/// A gap: the window it falls into and the encoder pitches lost with it beyond the one seen.
type Jump = (usize, f64);

fn follow(run: &Observed, angles: &[&Vec<f64>], variance: f64, log_windows: f64) -> Option<(Vec<Jump>, f64)> {
    let n = run.windows.len();
    let states = angles.len();
    // What one gap must gain: its place among all windows, and a margin of e⁻⁸.
    let penalty = 2.0 * log_windows + 16.0;
    let word = word_s(run);
    let cost = |w: &Window, from: usize, to: usize| -> (f64, f64) {
        let advance = angles[to][w.to] - angles[from][w.from];
        let dt = (run.duration(w) + word * (to - from) as f64).max(1e-6);
        let mut measured = advance.clamp(w.low, w.high);
        let mut extra = 0.0;
        if to > from && w.low == w.high {
            let q = ((advance / w.low - 1.0) / 2.0).round().max(0.0);
            extra = 2.0 * q;
            measured = w.low * (1.0 + extra);
        }
        let r = (measured - advance) / dt * RPM;
        // A wild window says no more than a clearly wrong one: it must not pay for a gap alone.
        ((r * r * dt / variance).min(25.0), extra)
    };
    let mut best = vec![f64::INFINITY; states];
    best[0] = 0.0;
    let mut back: Vec<Vec<usize>> = Vec::with_capacity(n);
    let mut stay = 0.0;
    for w in &run.windows {
        let mut next = vec![f64::INFINITY; states];
        let mut from = vec![0; states];
        stay += cost(w, 0, 0).0;
        for m in 0..states {
            if best[m].is_infinite() {
                continue;
            }
            let c = best[m] + cost(w, m, m).0;
            if c < next[m] {
                next[m] = c;
                from[m] = m;
            }
            if m + 1 < states {
                let c = best[m] + cost(w, m, m + 1).0 + penalty;
                if c < next[m + 1] {
                    next[m + 1] = c;
                    from[m + 1] = m;
                }
            }
        }
        best = next;
        back.push(from);
    }
    let (mut state, total) = best.iter().copied().enumerate().min_by(|a, b| a.1.total_cmp(&b.1))?;
    if state == 0 || state == states - 1 {
        // None, or more than can be told from a wrong clock.
        return None;
    }
    let improvement = stay - total + penalty * state as f64;
    let mut jumps = Vec::new();
    for k in (0..n).rev() {
        let before = back[k][state];
        if before != state {
            jumps.push((k, cost(&run.windows[k], before, state).1));
        }
        state = before;
    }
    jumps.reverse();
    Some((jumps, improvement))
}

fn put_back(run: &mut Observed, jumps: &[Jump]) {
    let word = word_s(run);
    for (k, extra) in jumps {
        let w = run.windows[*k];
        let pitch = w.low;
        for t in &mut run.times[w.to..] {
            *t += word;
        }
        for a in &mut run.angles[w.to..] {
            *a += pitch * extra;
        }
        if w.low == w.high {
            run.windows[*k].low = pitch * (1.0 + extra);
            run.windows[*k].high = pitch * (1.0 + extra);
        }
    }
    run.record_end += word * jumps.len() as f64;
}
