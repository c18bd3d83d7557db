//! The comparison itself: residuals of every window for given parameters, and their derivatives.

use super::observe::Observed;
use super::rotor::{P, Parameters, RunInput, RunTerms, simulate, warm_up};
use rayon::prelude::*;
use std::f64::consts::TAU;
use twum_record::measurement::RunKind;

/// rad/s to revolutions a minute.
pub const RPM: f64 = 60.0 / TAU;

/// The measured runs as one fitting problem.
#[derive(Debug, Clone)]
pub struct Problem {
    /// The runs.
    pub runs: Vec<Observed>,
    /// Revolutions made before each run (in the order of making; 0 without one).
    revolutions_before: Vec<f64>,
    /// Run indices in the order of making, if every run states it.
    sequence: Option<Vec<usize>>,
}

/// A model: common parameters and what belongs to single runs.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Parameters of the rotor and the effects.
    pub parameters: Parameters,
    /// One entry a run.
    pub terms: Vec<RunTerms>,
}

/// A direction in parameter space along which residuals are differentiated.
#[derive(Debug, Clone, PartialEq)]
pub enum Column {
    /// A common parameter; other parameters are first set as listed (shape of the effect).
    Scalar {
        /// What is varied.
        parameter: P,
        /// Size of one unit of the column.
        scale: f64,
        /// Finite step, in units of the parameter.
        step: f64,
        /// Shape parameters set before.
        shape: Vec<(P, f64)>,
    },
    /// The delay of the record behind the drive, by a hundredth of a second, in hat `k` of `n` over time.
    Lag(usize, usize),
    /// A coefficient of [`RunTerms::runout`].
    Runout(usize),
    /// A coefficient of [`RunTerms::eccentricity`].
    Eccentricity(usize),
    /// A coefficient of [`RunTerms::gravity`].
    Gravity(usize),
    /// A phased coefficient with parameters first set as listed (shape of the effect).
    Shaped(Box<Column>, Vec<(P, f64)>),
    /// Relative speed error times a basis function of the window, for terms that stand for no physics.
    Flexible(Basis),
}

/// Basis functions of the flexible terms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Basis {
    /// Hat `k` of `n` over the time since the start of the drive (0 to the longest run).
    Time(usize, usize),
    /// Hat `k` of `n` over the phase in the PWM period (cyclic).
    Phase(usize, usize),
    /// 1 in a PWM period, −1 in the next, averaged over the window.
    EveryOtherPeriod,
    /// The sign of the slot a window begins with, where it ends with one of the other kind.
    Slot,
    /// `cos` (even) or `sin` (odd) of harmonic `k/2 + 1` of the measured angle.
    Angle(usize),
    /// The free speed, in millisecond `k` after each rise of the drive or (`false`) each fall: what the rotor equation leaves out of
    /// the wave's coming and going.
    AfterSwitching(bool, usize),
}

/// Residuals of one run.
#[derive(Debug, Clone, Default)]
pub struct RunResidual {
    /// Measured minus predicted mean speed of each window in rpm.
    pub rpm: Vec<f64>,
    /// Predicted mean speed of each window in rpm.
    pub predicted: Vec<f64>,
    /// Rotor speed at each time in rad/s.
    pub speed: Vec<f64>,
}

impl Problem {
    /// Puts runs together.
    pub fn new(runs: Vec<Observed>) -> Self {
        let ordered = runs.iter().all(|r| r.order.is_some());
        let sequence = ordered.then(|| {
            let mut s: Vec<usize> = (0..runs.len()).collect();
            s.sort_by_key(|i| runs[*i].order);
            s
        });
        let mut revolutions_before = vec![0.0; runs.len()];
        if let Some(sequence) = &sequence {
            let mut total = 0.0;
            for &i in sequence {
                revolutions_before[i] = total;
                // A record cut short still belongs to a full drive.
                let run = &runs[i];
                let seen = run.record_end.min(run.drive_end).max(1e-3);
                total += run.revolutions() * (run.drive_end / seen).clamp(1.0, 5.0);
            }
        }
        Self { runs, revolutions_before, sequence }
    }

    /// The same runs compared over stretches of several edges, see [`Observed::widen`].
    pub fn widened(mut self) -> Self {
        self.runs.iter_mut().for_each(Observed::widen);
        self
    }

    /// Whether all runs are of closed loops.
    pub fn closed(&self) -> bool {
        self.runs.iter().all(|r| r.kind == RunKind::Track)
    }

    /// Whether the order of the runs is known.
    pub fn ordered(&self) -> bool {
        self.sequence.is_some()
    }

    /// Place of each run in the order of making; all 0 where that is unknown.
    pub fn ranks(&self) -> Vec<f64> {
        let mut rank = vec![0.0; self.runs.len()];
        for (k, i) in self.sequence.iter().flatten().enumerate() {
            rank[*i] = k as f64;
        }
        rank
    }

    /// How many duties the open-loop runs have.
    pub fn duties(&self) -> usize {
        let mut duties: Vec<f64> = self.runs.iter().filter_map(|r| r.duty).collect();
        duties.sort_by(f64::total_cmp);
        duties.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
        duties.len()
    }

    /// A model without run terms.
    pub fn model(&self, parameters: Parameters) -> Model {
        Model { parameters, terms: vec![RunTerms::default(); self.runs.len()] }
    }

    /// Warmth each run starts with.
    fn warmth(&self, p: &Parameters) -> Vec<f64> {
        let mut start = vec![0.0; self.runs.len()];
        let carry = p.get(P::HeatCarry);
        if let Some(sequence) = &self.sequence
            && carry > 0.0
            && p.get(P::HeatLoss) != 0.0
        {
            let mut warmth = 0.0;
            for &i in sequence {
                start[i] = warmth;
                let run = &self.runs[i];
                let duty = run.duty.unwrap_or_else(|| run.schedule.drive_time() / run.drive_end.max(1e-9));
                warmth = carry * warm_up(warmth, duty, run.drive_end, p.get(P::HeatTau));
            }
        }
        start
    }

    /// Residuals of all runs.
    pub fn residuals(&self, model: &Model) -> Vec<RunResidual> {
        let warmth = self.warmth(&model.parameters);
        (0..self.runs.len())
            .into_par_iter()
            .map(|i| self.run_residual(i, &model.parameters, &model.terms[i], warmth[i]))
            .collect()
    }

    /// Simulated rotor angle of every run at its measured times, in rad.
    pub fn angles(&self, model: &Model) -> Vec<Vec<f64>> {
        let warmth = self.warmth(&model.parameters);
        (0..self.runs.len())
            .into_par_iter()
            .map(|i| {
                let mut angle = Vec::new();
                simulate(&self.input(i, warmth[i]), &model.parameters, &model.terms[i], &mut angle, &mut Vec::new());
                angle
            })
            .collect()
    }

    fn input(&self, i: usize, warmth: f64) -> RunInput<'_> {
        let run = &self.runs[i];
        RunInput {
            schedule: &run.schedule,
            drive_end: run.drive_end,
            times: &run.times,
            half_sample_s: run.half_sample_s(),
            angles: &run.angles,
            warmth,
            revolutions: self.revolutions_before[i],
        }
    }

    fn run_residual(&self, i: usize, p: &Parameters, terms: &RunTerms, warmth: f64) -> RunResidual {
        let run = &self.runs[i];
        let input = self.input(i, warmth);
        let mut angle = Vec::with_capacity(run.times.len());
        let mut out = RunResidual::default();
        simulate(&input, p, terms, &mut angle, &mut out.speed);
        let offset = p.get(P::EdgeOffset) * run.pitch * 0.5 * run.direction;
        let sensor = terms.eccentricity.iter().any(|c| *c != 0.0);
        out.rpm.reserve(run.windows.len());
        out.predicted.reserve(run.windows.len());
        let track = run.kind == RunKind::Track;
        let backlash = p.get(P::Backlash);
        let miscount = p.get(P::Miscount);
        let drift = p.get(P::MiscountDrift);
        for w in &run.windows {
            let mut advance = angle[w.to] - angle[w.from];
            if w.low == w.high {
                if offset != 0.0 {
                    advance -= offset * f64::from(run.level[w.from] - run.level[w.to]);
                }
                if sensor {
                    advance += terms.encoder_error(run.angles[w.to]) - terms.encoder_error(run.angles[w.from]);
                }
                if track && (backlash != 0.0 || miscount != 0.0 || drift != 0.0) {
                    // Thousands in a loop that chatters: they are sorted by time.
                    let until = |t: f64| run.reversals.partition_point(|r| r.0 <= t);
                    for (_, sign) in &run.reversals[until(run.times[w.from])..until(run.times[w.to])] {
                        advance += (sign * miscount + drift) * run.pitch - sign * backlash;
                    }
                }
            }
            let measured = advance.clamp(w.low, w.high);
            let dt = run.duration(w).max(1e-6);
            out.rpm.push((measured - advance) / dt * RPM);
            out.predicted.push(advance / dt * RPM);
        }
        out
    }

    /// Residuals of a run with one phased coefficient larger by a step, and the step.
    fn phased_step(
        &self,
        i: usize,
        column: &Column,
        p: &Parameters,
        terms: &RunTerms,
        warmth: f64,
    ) -> (RunResidual, f64) {
        let mut terms = *terms;
        let step = match column {
            Column::Runout(h) => {
                terms.runout[*h] += 0.01;
                0.01
            }
            Column::Eccentricity(h) => {
                terms.eccentricity[*h] += 1e-3;
                1e-3
            }
            Column::Gravity(h) => {
                terms.gravity[*h] += 0.01;
                0.01
            }
            _ => 1.0,
        };
        (self.run_residual(i, p, &terms, warmth), step)
    }

    /// Predicted-speed derivatives of one run for each column, weighted like the residuals: rows are windows.
    pub fn design(&self, model: &Model, columns: &[Column]) -> Vec<RunDesign> {
        let warmth = self.warmth(&model.parameters);
        let shaped: Vec<Option<ShapedColumn>> = columns
            .iter()
            .map(|c| match c {
                Column::Scalar { parameter, scale, step, shape } => {
                    let mut base = model.parameters.clone();
                    for (q, v) in shape {
                        base.set(*q, *v);
                    }
                    let moved = base.with(*parameter, base.get(*parameter) + step);
                    let same_base = shape.is_empty() || base.get(*parameter) == 0.0;
                    Some(ShapedColumn {
                        warm_base: self.warmth(&base),
                        warm_moved: self.warmth(&moved),
                        base: (!same_base).then_some(base),
                        moved,
                        factor: scale / step,
                    })
                }
                _ => None,
            })
            .collect();
        let longest = self.runs.iter().map(|r| r.drive_end).fold(0.0, f64::max).max(1e-6);
        (0..self.runs.len())
            .into_par_iter()
            .map(|i| {
                let run = &self.runs[i];
                let p = &model.parameters;
                let now = self.run_residual(i, p, &model.terms[i], warmth[i]);
                let n = run.windows.len();
                let weight: Vec<f64> = run.windows.iter().map(|w| run.duration(w).max(0.0).sqrt()).collect();
                let mut x = vec![0.0; n * columns.len()];
                for (c, column) in columns.iter().enumerate() {
                    let mut put = |values: &dyn Fn(usize) -> f64| {
                        for k in 0..n {
                            x[k * columns.len() + c] = weight[k] * values(k);
                        }
                    };
                    match column {
                        Column::Scalar { .. } => {
                            let s = shaped[c].as_ref().expect("scalar columns are shaped above");
                            let moved = self.run_residual(i, &s.moved, &model.terms[i], s.warm_moved[i]);
                            match &s.base {
                                None => put(&|k| (now.rpm[k] - moved.rpm[k]) * s.factor),
                                Some(base) => {
                                    let base = self.run_residual(i, base, &model.terms[i], s.warm_base[i]);
                                    put(&|k| (base.rpm[k] - moved.rpm[k]) * s.factor);
                                }
                            }
                        }
                        Column::Lag(j, n) => {
                            let step = 5e-4;
                            let later = p.with(P::Latency, p.get(P::Latency) + step);
                            let moved = self.run_residual(i, &later, &model.terms[i], warmth[i]);
                            put(&|k| {
                                let w = &run.windows[k];
                                let t = 0.5 * (run.times[w.from] + run.times[w.to]);
                                (now.rpm[k] - moved.rpm[k]) / step * 1e-2 * hat(*j, *n, t / longest)
                            });
                        }
                        Column::Runout(_) | Column::Eccentricity(_) | Column::Gravity(_) => {
                            let moved = self.phased_step(i, column, p, &model.terms[i], warmth[i]);
                            put(&|k| (now.rpm[k] - moved.0.rpm[k]) / moved.1);
                        }
                        Column::Shaped(phased, shape) => {
                            let shaped = shape.iter().fold(p.clone(), |q, (which, value)| q.with(*which, *value));
                            let moved = self.phased_step(i, phased, &shaped, &model.terms[i], warmth[i]);
                            put(&|k| (now.rpm[k] - moved.0.rpm[k]) / moved.1);
                        }
                        Column::Flexible(basis) => {
                            let value = |k: usize| {
                                let w = &run.windows[k];
                                let t = 0.5 * (run.times[w.from] + run.times[w.to]);
                                let theta = 0.5 * (run.angles[w.from] + run.angles[w.to]);
                                let period = 1.0 / run.pwm_hz;
                                let b = match *basis {
                                    Basis::Time(j, n) => hat(j, n, t / longest),
                                    Basis::Phase(j, n) => cyclic_hat(j, n, t / period),
                                    Basis::EveryOtherPeriod => {
                                        let between = [run.times[w.from], run.times[w.to]];
                                        period * (parity(between[1] / period) - parity(between[0] / period))
                                            / run.duration(w).max(1e-6)
                                    }
                                    Basis::Slot => {
                                        let slots = f64::from(run.level[w.from] - run.level[w.to]);
                                        return run.direction * 0.5 * slots * run.pitch / run.duration(w).max(1e-6)
                                            * RPM;
                                    }
                                    Basis::Angle(j) => {
                                        let h = (j / 2 + 1) as f64 * theta;
                                        if j % 2 == 0 { h.cos() } else { h.sin() }
                                    }
                                    Basis::AfterSwitching(rise, j) => {
                                        let share = run.schedule.share_after_switching(
                                            [run.times[w.from], run.times[w.to]],
                                            rise,
                                            1e-3 * j as f64,
                                            p,
                                        );
                                        return run.direction * share * p.get(P::FreeSpeed) * RPM;
                                    }
                                };
                                b * now.predicted[k]
                            };
                            put(&value);
                        }
                    }
                }
                let y = now.rpm.iter().zip(&weight).map(|(r, w)| r * w).collect();
                RunDesign { columns: columns.len(), x, y, weight, seconds: run.compared_s() }
            })
            .collect()
    }
}

struct ShapedColumn {
    base: Option<Parameters>,
    moved: Parameters,
    warm_base: Vec<f64>,
    warm_moved: Vec<f64>,
    factor: f64,
}

/// Piecewise linear basis function `j` of `n` over 0..1.
fn hat(j: usize, n: usize, x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0) * (n - 1) as f64;
    (1.0 - (x - j as f64).abs()).max(0.0)
}

/// The integral over `periods` of what is 1 in a period and −1 in the next.
fn parity(periods: f64) -> f64 {
    1.0 - (periods.rem_euclid(2.0) - 1.0).abs()
}

/// Piecewise linear basis function `j` of `n` over the fraction of a period.
fn cyclic_hat(j: usize, n: usize, periods: f64) -> f64 {
    let d = (periods.rem_euclid(1.0) * n as f64 - j as f64).rem_euclid(n as f64);
    (1.0 - d.min(n as f64 - d)).max(0.0)
}

/// Weighted residuals and derivatives of one run.
#[derive(Debug, Clone)]
pub struct RunDesign {
    /// Number of columns.
    pub columns: usize,
    /// Row-major windows × columns, in rpm·√s.
    pub x: Vec<f64>,
    /// Residual (measured − predicted) in rpm·√s.
    pub y: Vec<f64>,
    /// Square root of each window's duration in √s.
    pub weight: Vec<f64>,
    /// Time compared in s; the mean squared residual is `Σy²/seconds`.
    pub seconds: f64,
}
