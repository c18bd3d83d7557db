//! The controller's parity residual: the control signal recomputed from the logged target and position, against the logged
//! one. It separates the controller from everything behind it before any physics is fitted.

use super::design::RunDesign;
use super::finding::{Estimate, Finding, Status};
use super::stats::{Fold, Grams, Group, HeldOut, p_value};
use super::verdict::{LARGEST_P, LEAST_GAIN};
use twum_fit::quantile::NORMAL_95;
use twum_record::control::recomputed;
use twum_record::measurement::{ControlRow, Run, RunData};
use twum_shared::step::{ConfigError, ConfigSpec};

/// Longest delay that is tried, in ticks: a PWM period and a half at 50 Hz. All up to it are: what jumps from tick to tick, as the
/// derivative of whole counts does, is unlike itself a tick later.
const LONGEST_DELAY: usize = 60;
/// Ticks held out together: a second at 500 µs, far longer than a signal is like itself.
const PIECE_TICKS: usize = 2_000;
/// A record of fewer ticks shows no controller.
const LEAST_TICKS: usize = 400;
/// What is fitted to the control signal: a constant, each delay, the controller's three parts.
const COLUMNS: usize = 1 + LONGEST_DELAY + 3;
/// The least that two control signals can differ by, in duty steps: one in the last binary place of the chip's.
const LAST_PLACE: f64 = 1.0 / 65_536.0;
/// Decimal places that hold all of it.
const DECIMALS: i32 = 5;
/// Share of a delay's consequences from which it is one: it acts in full, or it is none.
const LEAST_DELAY: f64 = 0.5;
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
    let mut same = LAST_PLACE;
    let mut all = Vec::new();
    let mut fed_forward = false;
    for run in runs {
        let RunData::Control(rows) = &run.data else { continue };
        let recomputed = controller_of(run, rows).and_then(|spec| {
            fed_forward |= spec.feed_forward != 0;
            same = same.max(RATE_ERROR * spec.feed_forward.to_num::<f64>().abs()).max(printed_to(rows));
            Recomputed::of(rows, spec).map_err(|error| error.to_string())
        });
        match recomputed {
            Ok(recomputed) => all.push(recomputed),
            Err(why) => out.notes.push(format!("run {}: {why}; its control signal cannot be recomputed", run.id)),
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
    let ticks: usize = all.iter().map(|r| r.logged.len()).sum();
    let square: f64 = all.iter().flat_map(|r| r.logged.iter().zip(&r.same)).map(|(a, b)| (a - b) * (a - b)).sum();
    let rms = (square / ticks.max(1) as f64).sqrt();
    out.rms_steps = Some(rms);
    if rms < same {
        return out;
    }
    let designs: Vec<RunDesign> = all.iter().flat_map(Recomputed::pieces).collect();
    if designs.len() < 4 {
        out.notes.push(format!("the logged control signal differs from the recomputed one by {rms:.4} steps RMS; too short a record to say why"));
        return out;
    }
    out.findings =
        Contest::of(&designs, repetitions, seed, without).map_or(Vec::new(), |contest| contest.findings(rms));
    out
}

/// The controller that a run's ticks are of, or why they are none's.
fn controller_of(run: &Run, rows: &[ControlRow]) -> Result<ConfigSpec, String> {
    let control = run.control.as_ref().ok_or("no `control` stated")?;
    let spec = control.config().map_err(|error| error.to_string())?;
    let spacing = (rows[rows.len() - 1].time_us - rows[0].time_us) / (rows.len().max(2) - 1) as f64;
    if rows.len() < LEAST_TICKS || (spacing / f64::from(spec.period_us) - 1.0).abs() > 0.02 {
        return Err(format!(
            "{} rows {spacing:.0} µs apart, the controller steps every {} µs",
            rows.len(),
            spec.period_us
        ));
    }
    Ok(spec)
}

impl Recomputed {
    fn of(rows: &[ControlRow], spec: ConfigSpec) -> Result<Self, ConfigError> {
        let rates = target_rates(rows, f64::from(spec.period_us) * 1e-6);
        let inputs = |k: usize| rows[k].inputs(rates[k] as i32);
        let signal =
            |spec: ConfigSpec, delay: usize| recomputed(spec, (0..rows.len()).map(|k| inputs(k.saturating_sub(delay))));
        let none = ConfigSpec {
            kp: Default::default(),
            ki_tick: Default::default(),
            kd_tick: Default::default(),
            feed_forward: Default::default(),
            ..spec
        };
        Ok(Self {
            logged: rows.iter().map(|r| r.u).collect(),
            same: signal(spec, 0)?,
            delayed: (1..=LONGEST_DELAY).map(|d| signal(spec, d)).collect::<Result<_, _>>()?,
            parts: [
                signal(ConfigSpec { kp: spec.kp, ..none }, 0)?,
                signal(ConfigSpec { ki_tick: spec.ki_tick, ..none }, 0)?,
                signal(ConfigSpec { kd_tick: spec.kd_tick, ..none }, 0)?,
            ],
        })
    }

    /// What is logged beyond the same controller, over a constant, what each delay would change, and each part of the controller:
    /// in pieces, each held out in its turn.
    fn pieces(&self) -> Vec<RunDesign> {
        let of = |ticks: std::ops::Range<usize>| {
            let mut design =
                RunDesign { columns: COLUMNS, x: Vec::new(), y: Vec::new(), weight: Vec::new(), seconds: 0.0 };
            for i in ticks {
                design.x.push(1.0);
                design.x.extend(self.delayed.iter().map(|delayed| delayed[i] - self.same[i]));
                design.x.extend(self.parts.iter().map(|part| part[i]));
                design.y.push(self.logged[i] - self.same[i]);
                design.weight.push(1.0);
                design.seconds += 1.0;
            }
            design
        };
        let ends = |start: usize| start..(start + PIECE_TICKS).min(self.logged.len());
        (0..self.logged.len()).step_by(PIECE_TICKS).map(|start| of(ends(start))).collect()
    }
}

/// A change of the controller that may explain what is logged.
#[derive(Clone, Copy, PartialEq)]
enum Change {
    /// It acts so many ticks late.
    Delay(usize),
    /// It has other gains.
    Gains,
}

impl Change {
    fn name(self) -> &'static str {
        match self {
            Self::Delay(_) => "loop-delay",
            Self::Gains => "controller-mismatch",
        }
    }

    fn rival(self) -> &'static str {
        match self {
            Self::Delay(_) => Self::Gains.name(),
            Self::Gains => Self::Delay(0).name(),
        }
    }

    fn columns(self) -> Vec<usize> {
        match self {
            Self::Delay(ticks) => vec![ticks],
            Self::Gains => (1 + LONGEST_DELAY..COLUMNS).collect(),
        }
    }
}

/// A change with what it explains of the data that it was fitted to, and of those that it was not.
struct Contender {
    change: Change,
    improvement: f64,
    held: HeldOut,
}

/// The best delay and the best gains against each other.
struct Contest {
    grams: Grams,
    /// Improvements of the whole search where there is nothing to find.
    null: Vec<f64>,
    contenders: Vec<Contender>,
    winner: usize,
    seed: u64,
}

impl Contest {
    fn of(designs: &[RunDesign], repetitions: usize, seed: u64, without: &[String]) -> Option<Self> {
        let half = |h: usize| Fold {
            train: (0..designs.len()).filter(|p| p % 2 != h).collect(),
            test: (0..designs.len()).filter(|p| p % 2 == h).collect(),
        };
        let grams = Grams::with_blocks(designs, 0, &[3.0; COLUMNS], None, vec![half(0), half(1)], 100);
        let changes: Vec<Change> = (1..=LONGEST_DELAY)
            .map(Change::Delay)
            .chain([Change::Gains])
            .filter(|change| !without.iter().any(|w| w == change.name()))
            .collect();
        let groups: Vec<Group> = changes.iter().map(|change| Group::Linear(change.columns())).collect();
        if groups.is_empty() {
            return None;
        }
        let (improvements, null) = grams.screen(&[0], &groups, &[], repetitions, seed);
        let best_of = |name: &str| {
            let of_name = (0..changes.len()).filter(|k| changes[*k].name() == name);
            of_name.max_by(|a, b| improvements[*a].total_cmp(&improvements[*b]))
        };
        let best = [Change::Delay(0), Change::Gains].into_iter().filter_map(|change| best_of(change.name()));
        let contenders: Vec<Contender> = best
            .map(|k| Contender {
                change: changes[k],
                improvement: improvements[k],
                held: grams.hold_out(&[0], &groups[k]),
            })
            .collect();
        let winner = (0..contenders.len())
            .max_by(|a, b| contenders[*a].improvement.total_cmp(&contenders[*b].improvement))
            .unwrap_or(0);
        Some(Self { grams, null, contenders, winner, seed })
    }

    /// Whether one explains data that it was not fitted to clearly better than the other.
    fn leads(&self, one: usize, other: usize) -> bool {
        self.contenders[one].held.lead_interval(&self.contenders[other].held, self.seed)[0] > 0.0
    }

    fn findings(&self, rms: f64) -> Vec<Finding> {
        (0..self.contenders.len()).map(|slot| self.finding(slot, rms)).collect()
    }

    fn finding(&self, slot: usize, rms: f64) -> Finding {
        let Contender { change, improvement, held } = &self.contenders[slot];
        let parameters = self.parameters(*change);
        let gain = held.gain();
        let interval = held.gain_interval(self.seed);
        let p = p_value(*improvement, &self.null);
        let differs = match change {
            Change::Delay(_) => parameters.iter().any(|e| e.name == "share" && e.value >= LEAST_DELAY),
            Change::Gains => parameters.iter().any(|e| e.value.abs() >= LEAST_MISMATCH),
        };
        let good = p <= LARGEST_P && gain >= LEAST_GAIN && interval[0] > 0.0 && differs;
        let beaten = slot != self.winner && self.leads(self.winner, slot);
        let as_good = |o: usize| {
            let loser = if slot == self.winner { o } else { slot };
            o != slot && self.contenders[o].held.gain() >= 0.5 * gain && !self.leads(self.winner, loser)
        };
        let tied = good && (0..self.contenders.len()).any(as_good);
        Finding {
            name: change.name().to_owned(),
            status: match (good && !beaten, tied) {
                (false, _) => Status::Rejected,
                (true, true) => Status::Ambiguous,
                (true, false) => Status::Named,
            },
            probability: None,
            gain,
            gain_interval: interval,
            p_null: p,
            parameters,
            conflicts: if tied { vec![change.rival().to_owned()] } else { Vec::new() },
            next_experiment: "track a step: a delay moves the control signal's edge, another gain changes its height"
                .to_owned(),
            share: 0.0,
            note: format!("scored on the control signal: recomputed and logged differ by {rms:.4} duty steps RMS"),
        }
    }

    fn parameters(&self, change: Change) -> Vec<Estimate> {
        let (beta, cov) = self.grams.fit_all(&[vec![0], change.columns()].concat());
        match change {
            Change::Delay(ticks) => {
                let value = ticks as f64;
                vec![
                    Estimate { name: "ticks".into(), value, interval: [value - 0.5, value + 0.5], unit: "1".into() },
                    around("share", beta[1], cov[(1, 1)]),
                ]
            }
            Change::Gains => ["kp_relative", "ki_relative", "kd_relative"]
                .iter()
                .enumerate()
                .map(|(i, n)| around(n, beta[1 + i], cov[(1 + i, 1 + i)]))
                .collect(),
        }
    }
}

fn around(name: &str, value: f64, variance: f64) -> Estimate {
    let half = NORMAL_95 * variance.max(0.0).sqrt();
    Estimate { name: name.to_owned(), value, interval: [value - half, value + half], unit: "1".to_owned() }
}

/// What the control signal was rounded to when it was logged, in duty steps: the coarsest decimal place that holds all of it.
///
/// The two signals are the same number printed twice as long as they differ by less: rounding alone is a third of it RMS.
fn printed_to(rows: &[ControlRow]) -> f64 {
    let holds = |place: f64| rows.iter().all(|r| (r.u / place - (r.u / place).round()).abs() < 1e-3);
    (0..=DECIMALS).map(|d| 0.1_f64.powi(d)).find(|place| holds(*place)).unwrap_or(LAST_PLACE)
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

    /// Fails if a signal that was printed is compared closer than it was printed, or one that was not farther than the chip's last place.
    #[test]
    fn a_signal_is_compared_as_far_as_it_was_printed() {
        let of = |place: f64| {
            let row = |k: i32| ControlRow {
                time_us: f64::from(k) * 500.0,
                target: 0.0,
                position: 0.0,
                u: (1_234.567_89 * f64::from(k).sin() / place).round() * place,
                duty: 0.0,
                direction: Direction::Cw,
            };
            printed_to(&(0..500).map(row).collect::<Vec<_>>())
        };
        for place in [1.0, 1e-3, 1e-5] {
            assert!((of(place) / place - 1.0).abs() < 1e-9, "{place}: {}", of(place));
        }
        assert_eq!(of(LAST_PLACE), LAST_PLACE);
    }

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
