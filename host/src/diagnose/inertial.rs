//! Ordinary motors (plant `inertial`): input to speed with a gain and a lag, and what that line gets wrong.
//!
//! Coulomb friction is not refitted in this baseline: at slowly changing inputs it is the same thing as a dead zone, and
//! the question is whether there is one.

use super::problem::RunDesign;
use super::search::{Estimate, Finding, LARGEST_P, LEAST_GAIN, Status, Unknown};
use super::stats::{Fold, Grams, Group, HeldOut, p_value};
use crate::record::measurement::{DriveResponse, Run, RunData};

/// Samples in one piece of a run: pieces are what the bootstrap draws.
const PIECE: usize = 25;

/// An ordinary motor's run.
#[derive(Debug, Clone)]
pub struct DriveRun {
    /// Identifier.
    pub id: String,
    /// Times in s.
    pub time: Vec<f64>,
    /// Input relative to the largest one of all runs.
    pub input: Vec<f64>,
    /// Speed in rpm.
    pub rpm: Vec<f64>,
}

/// What was found.
#[derive(Debug, Clone)]
pub struct InertialOutcome {
    /// Evidence an effect.
    pub findings: Vec<Finding>,
    /// Without a cause.
    pub unknown: Vec<Unknown>,
    /// Held-out errors of baseline and extended model.
    pub held_out: HeldOut,
    /// Noise floor in rpm: from neighbouring samples.
    pub noise_floor: f64,
    /// Speed of the baseline at full input in rpm, and its lag in s.
    pub gain_rpm: f64,
    /// Lag in s.
    pub lag_s: f64,
    /// Runs.
    pub runs: Vec<DriveRun>,
    /// Predicted speeds of the extended model, one list a run.
    pub predicted: Vec<Vec<f64>>,
}

/// Reads the runs of format `drive`.
pub fn drive_runs(runs: &[&Run]) -> (Vec<DriveRun>, Vec<String>) {
    let mut out = Vec::new();
    let mut notes = Vec::new();
    for run in runs {
        let RunData::Drive { time_us, input, response } = &run.data else { continue };
        if input.len() < 40 {
            notes.push(format!("run {}: {} samples, too few; left out", run.id, input.len()));
            continue;
        }
        let time: Vec<f64> = time_us.iter().map(|t| t * 1e-6).collect();
        let rpm = match response {
            DriveResponse::SpeedRpm(v) => v.clone(),
            DriveResponse::PositionRad(p) => {
                let n = p.len();
                (0..n)
                    .map(|k| {
                        let (a, b) = (k.saturating_sub(1), (k + 1).min(n - 1));
                        (p[b] - p[a]) / (time[b] - time[a]).max(1e-9) * super::problem::RPM
                    })
                    .collect()
            }
        };
        out.push(DriveRun { id: run.id.clone(), time, input: input.clone(), rpm });
    }
    let largest = out.iter().flat_map(|r| &r.input).fold(0.0f64, |a, b| a.max(b.abs()));
    if largest > 0.0 {
        for r in &mut out {
            for u in &mut r.input {
                *u /= largest;
            }
        }
    }
    (out, notes)
}

struct Candidate {
    effect: usize,
    columns: Vec<Vec<Vec<f64>>>,
    shape: Vec<(&'static str, f64, &'static str)>,
}

const EFFECTS: [(&str, &str); 4] = [
    (
        "dead-zone",
        "sweep the input slowly from zero up and back down around the threshold: friction with a peak at rest shows a loop, a dead zone does not",
    ),
    ("direction-asymmetry", "mount the motor the other way round and repeat the sweep: a load's bias changes sides"),
    ("high-duty-saturation", "log the supply voltage at full input: a sag is in the supply, a saturation is not"),
    (
        "stribeck-friction",
        "sweep the input slowly from zero up and back down around the threshold: friction with a peak at rest shows a loop, a dead zone does not",
    ),
];

/// Searches the library over ordinary motors' runs.
pub fn search(runs: Vec<DriveRun>, repetitions: usize, seed: u64, without: &[String]) -> InertialOutcome {
    // Baseline: gain and lag. A lag below two sampling intervals cannot be seen.
    let spacing =
        runs.iter().map(|r| (r.time[r.time.len() - 1] - r.time[0]) / (r.time.len() - 1) as f64).fold(0.0, f64::max);
    let lag_s = [0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0]
        .into_iter()
        .filter(|lag| *lag == 0.0 || *lag > 2.0 * spacing)
        .min_by(|a, b| line_error(&runs, *a).total_cmp(&line_error(&runs, *b)))
        .unwrap_or(0.0);
    let inputs: Vec<Vec<f64>> = runs.iter().map(|r| lagged(r, lag_s)).collect();
    let (mut uy, mut uu) = (0.0, 0.0);
    for (r, u) in runs.iter().zip(&inputs) {
        for (u, y) in u.iter().zip(&r.rpm) {
            uy += u * y;
            uu += u * u;
        }
    }
    let gain_rpm = if uu > 0.0 { uy / uu } else { 0.0 };
    let of = |f: &dyn Fn(f64) -> f64| -> Vec<Vec<f64>> {
        inputs.iter().map(|u| u.iter().map(|v| f(*v)).collect()).collect()
    };
    let grid = |n: usize, low: f64, high: f64| -> Vec<f64> {
        (0..n).map(|k| low + (high - low) * k as f64 / (n - 1) as f64).collect()
    };
    let mut candidates: Vec<Candidate> = Vec::new();
    for u0 in grid(24, 0.01, 0.47) {
        candidates.push(Candidate {
            effect: 0,
            columns: vec![of(&|u| -u.signum() * u.abs().min(u0))],
            shape: vec![("threshold", u0, "1")],
        });
    }
    for plus in grid(10, 0.02, 0.38) {
        for minus in grid(10, 0.02, 0.38) {
            candidates.push(Candidate {
                effect: 0,
                columns: vec![of(&|u| if u >= 0.0 { -u.min(plus) } else { -u.max(-minus) })],
                shape: vec![("threshold_positive", plus, "1"), ("threshold_negative", minus, "1")],
            });
        }
    }
    candidates.push(Candidate { effect: 1, columns: vec![of(&|u| u.abs())], shape: Vec::new() });
    for us in [0.15, 0.3, 0.6, 1.0, 2.0, 5.0] {
        candidates.push(Candidate {
            effect: 2,
            columns: vec![of(&|u| u / (1.0 + u.abs() / us) - u)],
            shape: vec![("saturation_input", us, "1")],
        });
    }
    for top in grid(15, 0.25, 0.95) {
        candidates.push(Candidate {
            effect: 2,
            columns: vec![of(&|u| -u.signum() * (u.abs() - top).max(0.0))],
            shape: vec![("flat_from_input", top, "1")],
        });
    }
    for vs in [0.02, 0.05, 0.1, 0.2, 0.4] {
        candidates.push(Candidate {
            effect: 3,
            columns: vec![of(&|u| -u.signum() * u.abs().min(vs) - u * (-(u / vs).powi(2)).exp())],
            shape: vec![("stribeck_input", vs, "1")],
        });
    }
    candidates.retain(|c| !without.iter().any(|w| w == EFFECTS[c.effect].0));

    let directions = inputs.iter().flatten().any(|u| *u > 0.05) && inputs.iter().flatten().any(|u| *u < -0.05);
    if !directions {
        candidates.retain(|c| c.effect != 1);
    }
    let base_column = of(&|u| u * gain_rpm);
    let n_runs = runs.len();
    // Pieces: consecutive samples; folds: whole runs, or alternating pieces of a single run.
    let mut piece_run = Vec::new();
    let mut piece_range = Vec::new();
    for (i, r) in runs.iter().enumerate() {
        let mut k = 0;
        while k < r.rpm.len() {
            let end = (k + PIECE).min(r.rpm.len());
            piece_run.push(i);
            piece_range.push((k, end));
            k = end;
        }
    }
    let pieces = piece_run.len();
    let folds: Vec<Fold> = if n_runs > 1 {
        (0..n_runs)
            .map(|i| Fold {
                train: (0..pieces).filter(|p| piece_run[*p] != i).collect(),
                test: (0..pieces).filter(|p| piece_run[*p] == i).collect(),
            })
            .collect()
    } else {
        (0..4)
            .map(|i| Fold {
                train: (0..pieces).filter(|p| p % 4 != i).collect(),
                test: (0..pieces).filter(|p| p % 4 == i).collect(),
            })
            .collect()
    };
    let design = |columns: &[&Vec<Vec<f64>>]| -> Vec<RunDesign> {
        (0..pieces)
            .map(|p| {
                let run = &runs[piece_run[p]];
                let (from, to) = piece_range[p];
                let mut d = RunDesign {
                    columns: columns.len(),
                    x: Vec::new(),
                    y: Vec::new(),
                    weight: Vec::new(),
                    seconds: 0.0,
                };
                for k in from..to {
                    for c in columns {
                        d.x.push(c[piece_run[p]][k]);
                    }
                    d.y.push(run.rpm[k] - base_column[piece_run[p]][k]);
                    d.weight.push(1.0);
                    d.seconds += 1.0;
                }
                d
            })
            .collect()
    };

    let mut accepted: Vec<usize> = Vec::new();
    let mut findings: Vec<Finding> = Vec::new();
    let mut rejected: Vec<Finding> = Vec::new();
    for round in 0..4 {
        let mut columns: Vec<&Vec<Vec<f64>>> = vec![&base_column];
        for a in &accepted {
            columns.extend(candidates[*a].columns.iter());
        }
        let base: Vec<usize> = (0..columns.len()).collect();
        let mut groups = Vec::new();
        let mut index = Vec::new();
        for (k, c) in candidates.iter().enumerate() {
            if accepted.iter().any(|a| candidates[*a].effect == c.effect) {
                continue;
            }
            let at = columns.len();
            columns.extend(c.columns.iter());
            groups.push(Group::Linear((at..columns.len()).collect()));
            index.push(k);
        }
        if groups.is_empty() {
            break;
        }
        let scales: Vec<f64> =
            (0..columns.len()).map(|k| if k == 0 { 1.0 } else { 3.0 * gain_rpm.abs().max(1.0) }).collect();
        let grams = Grams::new(&design(&columns), 0, &scales, None, folds.clone());
        let (mut improvements, null) = grams.screen(&base, &groups, repetitions, seed + round);
        // A loss that adds speed is no loss: such a fit is not the effect. The null keeps both signs, to its advantage.
        let everything: Vec<usize> = (0..pieces).collect();
        for (k, group) in groups.iter().enumerate() {
            let Group::Linear(own) = group else { continue };
            let beta = grams.fit(&everything, &[base.clone(), own.clone()].concat());
            if candidates[index[k]].effect != 1 && beta[base.len()] * gain_rpm <= 0.0 {
                improvements[k] = f64::NEG_INFINITY;
            }
        }
        // Best shape an effect.
        let mut best: Vec<usize> = Vec::new();
        for e in 0..EFFECTS.len() {
            if let Some(k) = (0..groups.len())
                .filter(|k| candidates[index[*k]].effect == e)
                .max_by(|a, b| improvements[*a].total_cmp(&improvements[*b]))
            {
                best.push(k);
            }
        }
        best.sort_by(|a, b| improvements[*b].total_cmp(&improvements[*a]));
        let held: Vec<HeldOut> = best.iter().map(|k| grams.hold_out(&base, &groups[*k])).collect();
        let make = |slot: usize, status: Status, conflicts: Vec<String>| -> (Finding, bool) {
            let k = best[slot];
            let candidate = &candidates[index[k]];
            let Group::Linear(own) = &groups[k] else { unreachable!("inertial candidates are linear") };
            let (beta, cov) = grams.fit_all(&[base.clone(), own.clone()].concat());
            let at = base.len();
            let gain = gain_rpm * (1.0 + beta[0]);
            let half = 1.96 * cov[(at, at)].max(0.0).sqrt();
            let (value, low, high) = (beta[at] / gain, (beta[at] - half) / gain, (beta[at] + half) / gain);
            let clear = low > 0.0 || high < 0.0;
            // All losses take speed away; only an asymmetry may have either sign.
            let admissible = candidate.effect == 1 || value > 0.0;
            let mut parameters = vec![Estimate {
                name: if candidate.effect == 1 { "asymmetry" } else { "share" }.to_owned(),
                value,
                interval: [low.min(high), high.max(low)],
                unit: "1".to_owned(),
            }];
            for (name, v, unit) in &candidate.shape {
                // Neighbouring shapes that do nearly as well bound the shape.
                let near: Vec<f64> = index
                    .iter()
                    .enumerate()
                    .filter(|(g, c)| {
                        candidates[**c].effect == candidate.effect
                            && candidates[**c].shape.len() == candidate.shape.len()
                            && improvements[*g] > improvements[k] - 4.0 * grams.variance
                    })
                    .filter_map(|(_, c)| candidates[*c].shape.iter().find(|s| s.0 == *name).map(|s| s.1))
                    .collect();
                let low = near.iter().copied().fold(*v, f64::min);
                let high = near.iter().copied().fold(*v, f64::max);
                parameters.push(Estimate {
                    name: (*name).to_owned(),
                    value: *v,
                    interval: [low, high],
                    unit: (*unit).to_owned(),
                });
            }
            (
                Finding {
                    name: EFFECTS[candidate.effect].0.to_owned(),
                    status,
                    gain: held[slot].gain(),
                    gain_interval: held[slot].gain_interval(seed),
                    p_null: p_value(improvements[k], &null),
                    parameters,
                    conflicts,
                    next_experiment: EFFECTS[candidate.effect].1.to_owned(),
                    share: 0.0,
                    note: String::new(),
                },
                clear && admissible,
            )
        };
        let winner = (0..best.len()).find(|slot| {
            let (f, ok) = make(*slot, Status::Named, Vec::new());
            ok && f.p_null <= LARGEST_P && f.gain >= LEAST_GAIN && f.gain_interval[0] > 0.0
        });
        if round == 0 {
            rejected = (0..best.len()).map(|slot| make(slot, Status::Rejected, Vec::new()).0).collect();
        }
        let Some(winner) = winner else { break };
        let mut set = vec![winner];
        for slot in 0..best.len() {
            if slot != winner
                && improvements[best[slot]] >= 0.5 * improvements[best[winner]]
                && held[winner].lead_interval(&held[slot], seed)[0] <= 0.0
                && make(slot, Status::Named, Vec::new()).1
            {
                set.push(slot);
            }
        }
        for slot in &set {
            let name = |s: &usize| EFFECTS[candidates[index[best[*s]]].effect].0.to_owned();
            let conflicts: Vec<String> = set.iter().filter(|s| *s != slot).map(name).collect();
            let status = if conflicts.is_empty() { Status::Named } else { Status::Ambiguous };
            findings.push(make(*slot, status, conflicts).0);
        }
        accepted.push(index[best[winner]]);
    }

    // Final model, hold-out of baseline and extended, what is left over.
    let mut columns: Vec<&Vec<Vec<f64>>> = vec![&base_column];
    for a in &accepted {
        columns.extend(candidates[*a].columns.iter());
    }
    let extended: Vec<usize> = (0..columns.len()).collect();
    let hats: Vec<Vec<Vec<f64>>> =
        (0..9).map(|j| of(&|u| gain_rpm * (1.0 - ((u + 1.0) * 4.0 - f64::from(j)).abs()).max(0.0))).collect();
    let first = columns.len();
    columns.extend(hats.iter());
    let scales: Vec<f64> = (0..columns.len())
        .map(|k| {
            if k == 0 {
                1.0
            } else if k < first {
                3.0 * gain_rpm.abs().max(1.0)
            } else {
                3.0
            }
        })
        .collect();
    let grams = Grams::new(&design(&columns), 0, &scales, None, folds);
    let base_held = grams.hold_out(&[0], &Group::Linear(extended[1..].to_vec()));
    let flexible = Group::Linear((first..columns.len()).collect());
    let (improvement, null) = grams.screen(&extended, std::slice::from_ref(&flexible), repetitions, seed + 99);
    let mut unknown = Vec::new();
    let p = p_value(improvement[0], &null);
    let left = grams.hold_out(&extended, &flexible).gain();
    if p <= LARGEST_P && left > 0.0 {
        unknown.push(Unknown { lives_in: "input", gain: left, p_null: p });
    }
    let all: Vec<usize> = (0..pieces).collect();
    let beta = grams.fit(&all, &extended);
    let predicted = (0..n_runs)
        .map(|i| {
            (0..runs[i].rpm.len())
                .map(|k| base_column[i][k] + extended.iter().map(|c| columns[*c][i][k] * beta[*c]).sum::<f64>())
                .collect()
        })
        .collect();
    for f in rejected {
        if !findings.iter().any(|g| g.name == f.name) {
            findings.push(f);
        }
    }
    InertialOutcome {
        findings,
        unknown,
        held_out: base_held,
        noise_floor: floor(&runs),
        gain_rpm,
        lag_s,
        runs,
        predicted,
    }
}

/// Spread of second differences: what is left when neighbours agree.
fn floor(runs: &[DriveRun]) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for r in runs {
        for w in r.rpm.windows(3) {
            let d = w[0] - 2.0 * w[1] + w[2];
            sum += d * d / 6.0;
            n += 1.0;
        }
    }
    (sum / f64::max(n, 1.0)).sqrt()
}

fn lagged(run: &DriveRun, lag: f64) -> Vec<f64> {
    if lag <= 0.0 {
        return run.input.clone();
    }
    let mut state = run.input[0];
    let mut out = vec![state];
    for k in 1..run.input.len() {
        let a = 1.0 - (-(run.time[k] - run.time[k - 1]) / lag).exp();
        state += a * (run.input[k - 1] - state);
        out.push(state);
    }
    out
}

fn line_error(runs: &[DriveRun], lag: f64) -> f64 {
    let (mut uy, mut uu, mut yy) = (0.0, 0.0, 0.0);
    for r in runs {
        for (u, y) in lagged(r, lag).iter().zip(&r.rpm) {
            uy += u * y;
            uu += u * u;
            yy += y * y;
        }
    }
    if uu > 0.0 { yy - uy * uy / uu } else { yy }
}
