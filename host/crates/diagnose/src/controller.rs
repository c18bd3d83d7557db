//! The controller's parity residual: the control signal recomputed from the logged target and position, against the logged
//! one. It separates the controller from everything behind it before any physics is fitted.

use super::finding::{Estimate, Finding, Status};
use super::problem::RunDesign;
use super::stats::{Fold, Grams, Group, p_value};
use super::verdict::{LARGEST_P, LEAST_GAIN};
use twum_record::measurement::{ControlRow, Run, RunData};
use twum_shared::step::{Config, ConfigSpec, Inputs, State, step};

/// Longest delay that is tried, in ticks: a PWM period and a half at 50 Hz. All up to it are: what jumps from tick to tick, as the
/// derivative of whole counts does, is unlike itself a tick later.
const LONGEST_DELAY: usize = 60;
/// Smallest RMS difference worth a word, in duty steps: below it the two are the same number printed twice.
const SAME: f64 = 0.02;
/// Smallest relative difference of a gain that is another gain: what the read-off rate leaves of a loop at its limits looks like 2 %.
const LEAST_MISMATCH: f64 = 0.05;
/// What the target's rate, which is not logged, can be read off whole counts to, in counts/s: feed-forward is known no better.
const RATE_ERROR: f64 = 3.0;
/// Half the window over which the rate is read, in s.
const RATE_WINDOW_S: f64 = 0.2;
/// A target that moves more counts than this in a tick jumps; a jump has no rate.
const JUMP_COUNTS: f64 = 3.0;

/// What recomputing the controller shows.
#[derive(Debug, Clone, Default)]
pub struct Parity {
    /// RMS of logged minus recomputed control signal in duty steps, over all closed-loop runs.
    pub rms_steps: Option<f64>,
    /// Evidence for `loop-delay` and `controller-mismatch`.
    pub findings: Vec<Finding>,
    /// What could not be recomputed, and why.
    pub notes: Vec<String>,
}

/// One run's logged and recomputed signals.
struct Recomputed {
    logged: Vec<f64>,
    same: Vec<f64>,
    delayed: Vec<Vec<f64>>,
    parts: [Vec<f64>; 3],
}

/// Recomputes the control signal of every closed-loop run.
pub fn parity(runs: &[&Run], repetitions: usize, seed: u64, without: &[String]) -> Parity {
    let mut out = Parity::default();
    let mut all = Vec::new();
    let mut same = SAME;
    let mut fed_forward = false;
    for run in runs {
        let RunData::Control(rows) = &run.data else { continue };
        let Some(control) = &run.control else {
            out.notes.push(format!("run {}: no `control` stated, so its control signal cannot be recomputed", run.id));
            continue;
        };
        let spec = match control.config() {
            Ok(spec) => spec,
            Err(error) => {
                out.notes.push(format!("run {}: {error}; its control signal cannot be recomputed", run.id));
                continue;
            }
        };
        let spacing = (rows[rows.len() - 1].time_us - rows[0].time_us) / (rows.len().max(2) - 1) as f64;
        if rows.len() < 400 || (spacing / f64::from(spec.period_us) - 1.0).abs() > 0.02 {
            out.notes.push(format!(
                "run {}: {} rows {spacing:.0} µs apart, the controller steps every {} µs; its control signal cannot be recomputed",
                run.id,
                rows.len(),
                spec.period_us
            ));
            continue;
        }
        fed_forward |= spec.feed_forward != ConfigSpec::THESIS.feed_forward;
        if let Some(r) = recompute(rows, spec) {
            all.push(r);
            same = same.max(RATE_ERROR * spec.feed_forward.to_num::<f64>().abs());
        }
    }
    if all.is_empty() {
        return out;
    }
    if fed_forward {
        out.notes.push(format!(
            "the target's rate is not logged; for the controller's feed-forward it is read off the target to about {RATE_ERROR} counts/s"
        ));
    }
    let (mut square, mut count) = (0.0, 0.0);
    for r in &all {
        for (a, b) in r.logged.iter().zip(&r.same) {
            square += (a - b) * (a - b);
            count += 1.0;
        }
    }
    let rms = (square / f64::max(count, 1.0)).sqrt();
    out.rms_steps = Some(rms);
    if rms < same {
        return out;
    }
    // Pieces of a second; every other one is held out.
    let piece = 2000;
    let width = 1 + LONGEST_DELAY + 3;
    let mut designs = Vec::new();
    for r in &all {
        let mut k = 0;
        while k < r.logged.len() {
            let end = (k + piece).min(r.logged.len());
            let mut d = RunDesign { columns: width, x: Vec::new(), y: Vec::new(), weight: Vec::new(), seconds: 0.0 };
            for i in k..end {
                d.x.push(1.0);
                for delayed in &r.delayed {
                    d.x.push(delayed[i] - r.same[i]);
                }
                for part in &r.parts {
                    d.x.push(part[i]);
                }
                d.y.push(r.logged[i] - r.same[i]);
                d.weight.push(1.0);
                d.seconds += 1.0;
            }
            designs.push(d);
            k = end;
        }
    }
    if designs.len() < 4 {
        out.notes.push(format!("the logged control signal differs from the recomputed one by {rms:.2} steps RMS; too short a record to say why"));
        return out;
    }
    let folds: Vec<Fold> = (0..2)
        .map(|h| Fold {
            train: (0..designs.len()).filter(|p| p % 2 != h).collect(),
            test: (0..designs.len()).filter(|p| p % 2 == h).collect(),
        })
        .collect();
    let scales = vec![3.0; width];
    let grams = Grams::with_blocks(&designs, 0, &scales, None, folds, 100);
    let mut names: Vec<(&str, Option<usize>)> = Vec::new();
    let mut groups = Vec::new();
    for ticks in 1..=LONGEST_DELAY {
        names.push(("loop-delay", Some(ticks)));
        groups.push(Group::Linear(vec![ticks]));
    }
    names.push(("controller-mismatch", None));
    let first = 1 + LONGEST_DELAY;
    groups.push(Group::Linear((first..first + 3).collect()));
    let keep: Vec<usize> = (0..names.len()).filter(|k| !without.iter().any(|w| w == names[*k].0)).collect();
    let groups: Vec<Group> = keep.iter().map(|k| groups[*k].clone()).collect();
    if groups.is_empty() {
        return out;
    }
    let (improvements, null) = grams.screen(&[0], &groups, &[], repetitions, seed);
    let best_of = |name: &str| {
        (0..keep.len())
            .filter(|k| names[keep[*k]].0 == name)
            .max_by(|a, b| improvements[*a].total_cmp(&improvements[*b]))
    };
    let best: Vec<usize> = ["loop-delay", "controller-mismatch"].into_iter().filter_map(best_of).collect();
    let held: Vec<_> = best.iter().map(|k| grams.hold_out(&[0], &groups[*k])).collect();
    let winner = (0..best.len()).max_by(|a, b| improvements[best[*a]].total_cmp(&improvements[best[*b]])).unwrap_or(0);
    for (slot, k) in best.iter().enumerate() {
        let (name, ticks) = names[keep[*k]];
        let Group::Linear(own) = &groups[*k] else { continue };
        let (beta, cov) = grams.fit_all(&[vec![0], own.clone()].concat());
        let parameters = match ticks {
            Some(ticks) => {
                let value = ticks as f64;
                vec![
                    Estimate { name: "ticks".into(), value, interval: [value - 0.5, value + 0.5], unit: "1".into() },
                    around("share", beta[1], cov[(1, 1)]),
                ]
            }
            None => ["kp_relative", "ki_relative", "kd_relative"]
                .iter()
                .enumerate()
                .map(|(i, n)| around(n, beta[1 + i], cov[(1 + i, 1 + i)]))
                .collect(),
        };
        let gain = held[slot].gain();
        let interval = held[slot].gain_interval(seed);
        let p = p_value(improvements[*k], &null);
        let other_gains = ticks.is_some() || parameters.iter().any(|e| e.value.abs() >= LEAST_MISMATCH);
        let good = p <= LARGEST_P && gain >= LEAST_GAIN && interval[0] > 0.0 && other_gains;
        let beaten = slot != winner && held[winner].lead_interval(&held[slot], seed)[0] > 0.0;
        let tied = good
            && (0..best.len()).any(|o| {
                o != slot
                    && held[o].gain() >= 0.5 * gain
                    && held[winner].lead_interval(&held[if slot == winner { o } else { slot }], seed)[0] <= 0.0
            });
        out.findings.push(Finding {
            name: name.to_owned(),
            status: if !good || beaten {
                Status::Rejected
            } else if tied {
                Status::Ambiguous
            } else {
                Status::Named
            },
            probability: None,
            gain,
            gain_interval: interval,
            p_null: p,
            parameters,
            conflicts: if tied {
                vec![if name == "loop-delay" { "controller-mismatch" } else { "loop-delay" }.to_owned()]
            } else {
                Vec::new()
            },
            next_experiment: "track a step: a delay moves the control signal's edge, another gain changes its height"
                .to_owned(),
            share: 0.0,
            note: format!("scored on the control signal: recomputed and logged differ by {rms:.2} duty steps RMS"),
        });
    }
    out
}

fn around(name: &str, value: f64, variance: f64) -> Estimate {
    let half = 1.96 * variance.max(0.0).sqrt();
    Estimate { name: name.to_owned(), value, interval: [value - half, value + half], unit: "1".to_owned() }
}

fn recompute(rows: &[ControlRow], spec: ConfigSpec) -> Option<Recomputed> {
    let config = Config::try_from(spec).ok()?;
    let rates = target_rates(rows, f64::from(spec.period_us) * 1e-6);
    let signal = |spec: ConfigSpec, delay: usize| -> Option<Vec<f64>> {
        let config = Config::try_from(spec).ok()?;
        let mut state = State::REST;
        Some(
            (0..rows.len())
                .map(|k| {
                    let row = &rows[k.saturating_sub(delay)];
                    let rate = rates[k.saturating_sub(delay)];
                    let inputs =
                        Inputs { target: row.target as i32, target_rate: rate as i32, position: row.position as i32 };
                    f64::from(step(&config, &mut state, inputs).u) / 65_536.0
                })
                .collect(),
        )
    };
    let _ = config;
    let zero = ConfigSpec::THESIS.feed_forward;
    let only = |p: bool, i: bool, d: bool| {
        let mut s = spec;
        if !p {
            s.kp = zero;
        }
        if !i {
            s.ki_tick = Default::default();
        }
        if !d {
            s.kd_tick = zero;
        }
        s.feed_forward = zero;
        signal(s, 0)
    };
    Some(Recomputed {
        logged: rows.iter().map(|r| r.u).collect(),
        same: signal(spec, 0)?,
        delayed: (1..=LONGEST_DELAY).map(|d| signal(spec, d)).collect::<Option<Vec<_>>>()?,
        parts: [only(true, false, false)?, only(false, true, false)?, only(false, false, true)?],
    })
}

/// Rate of the target at every row in counts/s: a cubic through the counts around it, jumps taken out.
fn target_rates(rows: &[ControlRow], period_s: f64) -> Vec<f64> {
    const EVERY: usize = 20;
    let mut smooth = vec![0.0; rows.len()];
    for k in 1..rows.len() {
        let step = rows[k].target - rows[k - 1].target;
        smooth[k] = smooth[k - 1] + if step.abs() > JUMP_COUNTS { 0.0 } else { step };
    }
    let half = ((RATE_WINDOW_S / period_s) as usize).max(4);
    let at = |k: usize| -> f64 {
        let (from, to) = (k.saturating_sub(half), (k + half + 1).min(rows.len()));
        let mut normal = nalgebra::Matrix4::<f64>::zeros();
        let mut right = nalgebra::Vector4::<f64>::zeros();
        for i in (from..to).step_by(4) {
            let x = (i as f64 - k as f64) / half as f64;
            let row = nalgebra::Vector4::new(1.0, x, x * x, x * x * x);
            normal += row * row.transpose();
            right += row * smooth[i];
        }
        normal.lu().solve(&right).map_or(0.0, |c| c[1] / (half as f64 * period_s))
    };
    let nodes: Vec<f64> = (0..rows.len().div_ceil(EVERY) + 1).map(|n| at((n * EVERY).min(rows.len() - 1))).collect();
    (0..rows.len())
        .map(|k| {
            let f = (k % EVERY) as f64 / EVERY as f64;
            nodes[k / EVERY] * (1.0 - f) + nodes[k / EVERY + 1] * f
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use twum_record::measurement::Direction;

    /// Against the derivative of the sine itself; fails if whole counts are differenced tick by tick.
    #[test]
    fn the_rate_is_read_off_whole_counts() {
        let (amplitude, omega, period) = (89.0, 1.257, 5e-4);
        let rows: Vec<ControlRow> = (0..12_000)
            .map(|k| ControlRow {
                time_us: f64::from(k) * 500.0,
                target: (amplitude * (omega * f64::from(k) * period).sin()).trunc(),
                position: 0.0,
                u: 0.0,
                duty: 0.0,
                direction: Direction::Cw,
            })
            .collect();
        let rates = target_rates(&rows, period);
        let square: f64 = rates
            .iter()
            .enumerate()
            .map(|(k, r)| (r - amplitude * omega * (omega * k as f64 * period).cos()).powi(2))
            .sum();
        let rms = (square / rates.len() as f64).sqrt();
        assert!(rms < RATE_ERROR, "{rms}");
    }
}
