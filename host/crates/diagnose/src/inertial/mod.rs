//! Ordinary motors (plant `inertial`): input to speed with a gain and a lag, and what that line gets wrong.
//!
//! Coulomb friction is not refitted in this baseline: at slowly changing inputs it is the same thing as a dead zone, and
//! the question is whether there is one. Every candidate is fitted together with the gain and everything accepted before it
//! ([`map`]).

pub mod map;

use super::design::RunDesign;
use super::finding::{Estimate, Finding, Status, Unknown};
use super::stats::{Fold, Grams, Group, HeldOut, p_value};
use super::verdict::{LARGEST_P, LEAST_GAIN};
use map::{Map, Shape, Top, VALUES};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use twum_record::measurement::{DriveResponse, Run, RunData};

/// Samples in one piece of a run: pieces are what the bootstrap draws and the null turns.
const PIECE: usize = 25;
/// Steps of a full fit.
const ITERATIONS: usize = 40;

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
    /// Whether whole runs were held out; otherwise every other piece of each run, because the runs are not of one motor.
    pub whole_runs: bool,
    /// Runs.
    pub runs: Vec<DriveRun>,
    /// The extended model: one map a run (all the same where the runs are of one motor).
    pub maps: Vec<Map>,
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

/// An effect of an ordinary motor and the ways it may change a map.
struct Effect {
    name: &'static str,
    next_experiment: &'static str,
    forms: &'static [fn(Shape) -> Shape],
    present: fn(Shape) -> bool,
    /// Values that are its own.
    values: &'static [usize],
}

const AROUND_THE_THRESHOLD: &str = "sweep the input slowly from zero up and back down around the threshold: friction with a peak at rest shows a loop, a dead zone does not";

const EFFECTS: [Effect; 4] = [
    Effect {
        name: "dead-zone",
        next_experiment: AROUND_THE_THRESHOLD,
        forms: &[|s| Shape { dead_zone: true, ..s }],
        present: |s| s.dead_zone,
        values: &[1],
    },
    Effect {
        name: "direction-asymmetry",
        next_experiment: "mount the motor the other way round and repeat the sweep: a load's bias changes sides",
        forms: &[|s| Shape { asymmetry: true, ..s }],
        present: |s| s.asymmetry,
        values: &[2, 3],
    },
    Effect {
        name: "high-duty-saturation",
        next_experiment: "log the supply voltage at full input: a sag is in the supply, a saturation is not",
        forms: &[|s| Shape { top: Top::Soft, ..s }, |s| Shape { top: Top::Flat, ..s }],
        present: |s| s.top != Top::Straight,
        values: &[4],
    },
    Effect {
        name: "stribeck-friction",
        next_experiment: AROUND_THE_THRESHOLD,
        forms: &[|s| Shape { breakaway: true, ..s }],
        present: |s| s.breakaway,
        values: &[5],
    },
];

/// The data in pieces, and which of them are fitted and scored together.
struct Pieces {
    /// Run of each piece.
    run: Vec<usize>,
    /// Inputs and speeds of each piece.
    u: Vec<Vec<f64>>,
    y: Vec<Vec<f64>>,
    /// Pieces fitted, pieces scored with that fit.
    folds: Vec<Fold>,
}

impl Pieces {
    fn new(runs: &[DriveRun], inputs: &[Vec<f64>]) -> Self {
        let mut p = Self { run: Vec::new(), u: Vec::new(), y: Vec::new(), folds: Vec::new() };
        for (i, (r, u)) in runs.iter().zip(inputs).enumerate() {
            for (u, y) in u.chunks(PIECE).zip(r.rpm.chunks(PIECE)) {
                p.run.push(i);
                p.u.push(u.to_vec());
                p.y.push(y.to_vec());
            }
        }
        p
    }

    /// Whole runs held out in turn, with the others' values.
    fn by_run(&self, runs: usize) -> Vec<Fold> {
        (0..runs).map(|i| self.fold(|p| self.run[p] != i, |p| self.run[p] == i)).collect()
    }

    /// Every fourth piece held out in turn, each run with values of its own.
    fn within_runs(&self, runs: usize) -> Vec<Fold> {
        (0..runs)
            .flat_map(|i| {
                (0..4).map(move |k| self.fold(|p| self.run[p] == i && p % 4 != k, |p| self.run[p] == i && p % 4 == k))
            })
            .collect()
    }

    fn fold(&self, train: impl Fn(usize) -> bool, test: impl Fn(usize) -> bool) -> Fold {
        let all = 0..self.run.len();
        Fold { train: all.clone().filter(|p| train(*p)).collect(), test: all.filter(|p| test(*p)).collect() }
    }

    fn gather(&self, pieces: &[usize], y: &[Vec<f64>]) -> (Vec<f64>, Vec<f64>) {
        (
            pieces.iter().flat_map(|p| self.u[*p].iter().copied()).collect(),
            pieces.iter().flat_map(|p| y[*p].iter().copied()).collect(),
        )
    }

    /// Squared error of each piece, held out, when `shape` is fitted from `start` (one a fold) to speeds `y`.
    fn held_out(&self, start: &[Map], shape: Shape, y: &[Vec<f64>], thorough: bool) -> (Vec<f64>, Vec<Map>) {
        let mut loss = vec![0.0; self.run.len()];
        let mut maps = Vec::with_capacity(self.folds.len());
        for (fold, start) in self.folds.iter().zip(start) {
            let (u, speeds) = self.gather(&fold.train, y);
            let map = fit(*start, shape, &u, &speeds, thorough);
            for p in &fold.test {
                loss[*p] = self.u[*p].iter().zip(&y[*p]).map(|(u, y)| (y - map.at(*u)).powi(2)).sum();
            }
            maps.push(map);
        }
        (loss, maps)
    }
}

/// Fits `shape` from the values of `start`; values the start does not have are tried at a few sizes.
fn fit(start: Map, shape: Shape, u: &[f64], y: &[f64], thorough: bool) -> Map {
    if start.shape == shape {
        return start.fit(u, y, ITERATIONS).0;
    }
    let mut tries = vec![Map { shape, ..start }];
    let mut vary = |k: usize, sizes: &[f64]| {
        tries = tries
            .iter()
            .flat_map(|m| {
                sizes.iter().map(|s| {
                    let mut m = *m;
                    m.values[k] = *s;
                    m
                })
            })
            .collect();
    };
    if shape.dead_zone && !start.shape.dead_zone {
        vary(1, if thorough { &[0.02, 0.06, 0.12, 0.2, 0.35] } else { &[0.03, 0.15] });
    }
    if shape.top == Top::Soft && start.shape.top != Top::Soft {
        vary(4, if thorough { &[0.3, 1.0, 3.0, 8.0] } else { &[0.5, 3.0] });
    }
    if shape.top == Top::Flat && start.shape.top != Top::Flat {
        vary(4, if thorough { &[0.3, 0.5, 0.7, 0.9] } else { &[0.4, 0.8] });
    }
    if shape.breakaway && !start.shape.breakaway {
        vary(5, if thorough { &[0.02, 0.06, 0.15, 0.3] } else { &[0.03, 0.15] });
    }
    tries
        .into_iter()
        .map(|m| m.fit(u, y, if thorough { ITERATIONS } else { 8 }))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map_or(start, |best| best.0)
}

/// The shape with every top it may have instead of its own; one without a bend keeps it straight.
fn tops(shape: Shape) -> Vec<Shape> {
    if shape.top == Top::Straight {
        vec![shape]
    } else {
        [Top::Soft, Top::Flat].map(|top| Shape { top, ..shape }).to_vec()
    }
}

/// One way of extending the present map.
#[derive(Clone)]
struct Candidate {
    effect: usize,
    /// Which of the present maps it extends: more than one where the last step left rivals.
    base: usize,
    shape: Shape,
    loss: Vec<f64>,
    improvement: f64,
}

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
    let mut pieces = Pieces::new(&runs, &inputs);
    let y = pieces.y.clone();
    let everything: Vec<usize> = (0..pieces.run.len()).collect();
    let (all_u, all_y) = pieces.gather(&everything, &y);
    let baseline = Map::line(1.0).fit(&all_u, &all_y, ITERATIONS).0;
    let directions = all_u.iter().any(|u| *u > 0.05) && all_u.iter().any(|u| *u < -0.05);
    let usable = |e: usize| {
        !without.iter().any(|w| w == EFFECTS[e].name) && (EFFECTS[e].name != "direction-asymmetry" || directions)
    };

    // Are these runs of one motor? Values of the fullest map, common to all or one set a run: what predicts better?
    let mut fullest = Shape { dead_zone: true, asymmetry: directions, top: Top::Soft, breakaway: false };
    for (e, effect) in EFFECTS.iter().enumerate() {
        if !usable(e) && (effect.present)(fullest) {
            match effect.name {
                "dead-zone" => fullest.dead_zone = false,
                "direction-asymmetry" => fullest.asymmetry = false,
                _ => fullest.top = Top::Straight,
            }
        }
    }
    let whole_runs = runs.len() > 1 && {
        let within = pieces.within_runs(runs.len());
        let shared: Vec<Fold> = within
            .iter()
            .map(|f| Fold {
                train: everything.iter().copied().filter(|p| !f.test.contains(p)).collect(),
                test: f.test.clone(),
            })
            .collect();
        let mut score = |folds: Vec<Fold>| {
            pieces.folds = folds;
            let start = vec![baseline; pieces.folds.len()];
            pieces.held_out(&start, fullest, &y, true).0
        };
        let (own, common) = (score(within), score(shared));
        let held = HeldOut {
            loss: own.iter().zip(&common).map(|(o, c)| [*c, *o]).collect(),
            plain: own.iter().zip(&common).map(|(o, c)| [*c, *o]).collect(),
            seconds: vec![1.0; own.len()],
        };
        held.gain() < LEAST_GAIN || held.gain_interval(seed)[0] <= 0.0
    };
    pieces.folds = if whole_runs { pieces.by_run(runs.len()) } else { pieces.within_runs(runs.len()) };
    let owners =
        |i: usize| -> Vec<usize> { everything.iter().copied().filter(|p| whole_runs || pieces.run[*p] == i).collect() };

    let mut now = vec![baseline; pieces.folds.len()];
    let (base_loss, fitted) = pieces.held_out(&now, baseline.shape, &y, true);
    now = fitted;
    let mut loss = base_loss.clone();
    let seconds: Vec<f64> = y.iter().map(|v| v.len() as f64).collect();
    let against = |loss: &[f64], candidate: &[f64]| HeldOut {
        loss: loss.iter().zip(candidate).map(|(a, b)| [*a, *b]).collect(),
        plain: loss.iter().zip(candidate).map(|(a, b)| [*a, *b]).collect(),
        seconds: seconds.clone(),
    };
    let mut shape = baseline.shape;
    // The present map, and those of its rivals with the effect that makes each: one of them may go further.
    let mut bases: Vec<(Shape, Option<usize>)> = vec![(shape, None)];
    let mut findings: Vec<Finding> = Vec::new();
    let mut rejected: Vec<Finding> = Vec::new();
    // Repeating the search with its refits is dear; 200 repetitions resolve p = 0.005.
    let repetitions = repetitions.min(200);
    for round in 0..EFFECTS.len() as u64 {
        let mut forms: Vec<(usize, usize, Shape)> = Vec::new();
        for (b, (base, _)) in bases.iter().enumerate() {
            for (e, effect) in EFFECTS.iter().enumerate().filter(|(e, f)| usable(*e) && !(f.present)(*base)) {
                // What the rivals themselves add is no step further.
                if bases.len() > 1 && bases.iter().any(|(_, rival)| *rival == Some(e)) {
                    continue;
                }
                // A top that was found alone may bend otherwise beside another effect.
                for top in tops(*base) {
                    forms.extend(effect.forms.iter().map(|f| (e, b, f(top))));
                }
            }
        }
        if forms.is_empty() {
            break;
        }
        let mut candidates: Vec<Candidate> = forms
            .par_iter()
            .map(|(effect, base, shape)| {
                let candidate = pieces.held_out(&now, *shape, &y, true).0;
                let improvement = loss.iter().sum::<f64>() - candidate.iter().sum::<f64>();
                Candidate { effect: *effect, base: *base, shape: *shape, loss: candidate, improvement }
            })
            .collect();
        // The null keeps the present map and every residual, and turns the residuals of a piece by a coin: the whole
        // search, refits included, is repeated on it.
        let maps: Vec<Map> = (0..runs.len())
            .map(|i| {
                let (u, speeds) = pieces.gather(&owners(i), &y);
                fit(now[0], shape, &u, &speeds, true)
            })
            .collect();
        let null: Vec<f64> = (0..repetitions)
            .into_par_iter()
            .map(|k| {
                let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_add(1000 * round + 1 + k as u64));
                let turned: Vec<Vec<f64>> = everything
                    .iter()
                    .map(|p| {
                        let s = if rng.random::<bool>() { 1.0 } else { -1.0 };
                        let map = &maps[pieces.run[*p]];
                        pieces.u[*p].iter().zip(&y[*p]).map(|(u, y)| map.at(*u) + s * (y - map.at(*u))).collect()
                    })
                    .collect();
                let base: f64 = pieces.held_out(&now, shape, &turned, false).0.iter().sum();
                forms
                    .iter()
                    .map(|(_, _, s)| base - pieces.held_out(&now, *s, &turned, false).0.iter().sum::<f64>())
                    .fold(0.0, f64::max)
            })
            .collect();
        // The best form of each effect, best effect first.
        candidates.sort_by(|a, b| b.improvement.total_cmp(&a.improvement));
        let all = candidates.clone();
        let mut seen = Vec::new();
        candidates.retain(|c| {
            !seen.contains(&c.effect) && {
                seen.push(c.effect);
                true
            }
        });
        let held: Vec<HeldOut> = candidates.iter().map(|c| against(&loss, &c.loss)).collect();
        let describe = |slot: usize, status: Status| -> (Finding, bool) {
            let candidate = &candidates[slot];
            let effect = &EFFECTS[candidate.effect];
            let fits: Vec<(Map, [f64; VALUES])> = (0..if whole_runs { 1 } else { runs.len() })
                .map(|i| {
                    let (u, speeds) = pieces.gather(&owners(i), &y);
                    let map = fit(now[0], candidate.shape, &u, &speeds, true);
                    // Neighbouring samples err together: pieces, not samples, are independent.
                    let error: f64 = owners(i)
                        .iter()
                        .map(|p| {
                            let sum: f64 = pieces.u[*p].iter().zip(&y[*p]).map(|(u, y)| y - map.at(*u)).sum();
                            sum * sum / pieces.u[*p].len() as f64
                        })
                        .sum::<f64>()
                        / owners(i).len() as f64;
                    (map, map.spread(&u, error))
                })
                .collect();
            let mut parameters = Vec::new();
            let mut clear = false;
            for (k, name) in fits[0].0.names().iter().filter(|(k, _)| effect.values.contains(k)) {
                let n = fits.len() as f64;
                let value = fits.iter().map(|(m, _)| m.values[*k]).sum::<f64>() / n;
                let low = fits.iter().map(|(m, s)| m.values[*k] - 1.96 * s[*k]).fold(f64::INFINITY, f64::min);
                let high = fits.iter().map(|(m, s)| m.values[*k] + 1.96 * s[*k]).fold(f64::NEG_INFINITY, f64::max);
                clear |= fits.iter().all(|(m, s)| m.values[*k].abs() > 1.96 * s[*k]);
                parameters.push(Estimate {
                    name: (*name).to_owned(),
                    value,
                    interval: [low, high],
                    unit: "1".to_owned(),
                });
            }
            let mut note = String::new();
            if fits.len() > 1 {
                let each: Vec<String> = fits
                    .iter()
                    .zip(&runs)
                    .map(|((m, _), r)| {
                        let own = m.names().into_iter().filter(|(k, _)| effect.values.contains(k));
                        format!(
                            "{}: {}",
                            r.id,
                            own.map(|(k, n)| format!("{n} {:.3}", m.values[k])).collect::<Vec<_>>().join(", ")
                        )
                    })
                    .collect();
                note = each.join("; ");
            }
            let finding = Finding {
                name: effect.name.to_owned(),
                status,
                probability: None,
                gain: held[slot].gain(),
                gain_interval: held[slot].gain_interval(seed),
                p_null: p_value(candidate.improvement, &null),
                parameters,
                conflicts: Vec::new(),
                next_experiment: effect.next_experiment.to_owned(),
                share: 0.0,
                note,
            };
            (finding, clear)
        };
        let described: Vec<(Finding, bool)> = (0..candidates.len()).map(|s| describe(s, Status::Rejected)).collect();
        if round == 0 {
            rejected = described.iter().map(|d| d.0.clone()).collect();
        }
        let Some(winner) = described
            .iter()
            .position(|(f, clear)| *clear && f.p_null <= LARGEST_P && f.gain >= LEAST_GAIN && f.gain_interval[0] > 0.0)
        else {
            break;
        };
        // A rival of the last step that cannot follow this one is no rival any more.
        for (b, (_, rival)) in bases.iter().enumerate().filter(|(b, _)| *b != candidates[winner].base) {
            let follows = all.iter().find(|c| c.base == b && c.effect == candidates[winner].effect);
            let lost = follows.is_none_or(|c| held[winner].lead_interval(&against(&loss, &c.loss), seed)[0] > 0.0);
            let name = rival.map_or("", |e| EFFECTS[e].name);
            if let Some(f) = findings.iter_mut().find(|f| lost && f.name == name) {
                f.status = Status::Rejected;
                f.note = format!("explains less once {} is in the model", EFFECTS[candidates[winner].effect].name);
            }
        }
        let set: Vec<usize> = (0..candidates.len())
            .filter(|s| {
                *s == winner
                    || (described[*s].1
                        && candidates[*s].improvement >= 0.5 * candidates[winner].improvement
                        && held[winner].lead_interval(&held[*s], seed)[0] <= 0.0)
            })
            .collect();
        for s in &set {
            let mut f = described[*s].0.clone();
            f.conflicts = set.iter().filter(|o| *o != s).map(|o| described[*o].0.name.clone()).collect();
            f.status = if f.conflicts.is_empty() { Status::Named } else { Status::Ambiguous };
            findings.push(f);
        }
        shape = candidates[winner].shape;
        bases = vec![(shape, Some(candidates[winner].effect))];
        bases.extend(set.iter().filter(|s| **s != winner).map(|s| (candidates[*s].shape, Some(candidates[*s].effect))));
        (loss, now) = pieces.held_out(&now, shape, &y, true);
    }

    let maps: Vec<Map> = (0..runs.len())
        .map(|i| {
            let (u, speeds) = pieces.gather(&owners(i), &y);
            fit(now[0], shape, &u, &speeds, true)
        })
        .collect();
    let unknown = left_over(&pieces, &maps, &y, repetitions, seed);
    let predicted = maps.iter().zip(&inputs).map(|(m, u)| u.iter().map(|u| m.at(*u)).collect()).collect();
    // A rival that was accepted on its own in a later round is no rival any more.
    for k in 0..findings.len() {
        let name = findings[k].name.clone();
        if findings[k].status == Status::Ambiguous && findings[k + 1..].iter().any(|f| f.name == name) {
            findings[k].status = Status::Rejected;
        }
    }
    let names: Vec<String> = findings.iter().filter(|f| f.status != Status::Rejected).map(|f| f.name.clone()).collect();
    let lost: Vec<(String, String)> =
        findings.iter().filter(|f| f.status == Status::Rejected).map(|f| (f.name.clone(), f.note.clone())).collect();
    findings.retain(|f| f.status != Status::Rejected);
    for f in &mut findings {
        f.conflicts.retain(|c| names.contains(c));
        if f.conflicts.is_empty() {
            f.status = Status::Named;
        }
    }
    findings.extend(rejected.into_iter().filter(|f| !names.contains(&f.name)).map(|mut f| {
        if let Some((_, note)) = lost.iter().find(|(n, _)| *n == f.name) {
            f.note.clone_from(note);
        }
        f
    }));
    InertialOutcome {
        findings,
        unknown,
        held_out: against(&base_loss, &loss),
        noise_floor: floor(&runs),
        gain_rpm: baseline.values[0],
        lag_s,
        whole_runs,
        runs,
        maps,
        predicted,
    }
}

/// What a free curve over the input still finds beside the maps.
fn left_over(pieces: &Pieces, maps: &[Map], y: &[Vec<f64>], repetitions: usize, seed: u64) -> Vec<Unknown> {
    const HATS: usize = 9;
    let scale = maps.iter().map(|m| m.values[0].abs()).fold(1.0, f64::max);
    let designs: Vec<RunDesign> = (0..pieces.run.len())
        .map(|p| {
            let map = &maps[pieces.run[p]];
            let mut d = RunDesign { columns: HATS + 1, x: Vec::new(), y: Vec::new(), weight: Vec::new(), seconds: 0.0 };
            for (u, y) in pieces.u[p].iter().zip(&y[p]) {
                d.x.push(map.at(*u));
                d.x.extend((0..HATS).map(|j| scale * (1.0 - ((u + 1.0) * 4.0 - j as f64).abs()).max(0.0)));
                d.y.push(y - map.at(*u));
                d.weight.push(1.0);
                d.seconds += 1.0;
            }
            d
        })
        .collect();
    let mut scales = vec![3.0; HATS + 1];
    scales[0] = 1.0;
    let grams = Grams::new(&designs, 0, &scales, None, pieces.folds.clone());
    let flexible = Group::Linear((1..=HATS).collect());
    let (improvement, null) = grams.screen(&[0], std::slice::from_ref(&flexible), &[], repetitions, seed + 99);
    let p = p_value(improvement[0], &null);
    let gain = grams.hold_out(&[0], &flexible).gain();
    if p <= LARGEST_P && gain > 0.0 {
        vec![Unknown { lives_in: "input", gain, share: 0.0, p_null: p }]
    } else {
        Vec::new()
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
