//! What the data say for a set of effects: the equations around a refitted plant, with terms without physics beside it.

use super::super::discrepancy::{FREE_FORM_COST, SIZE, TERM_COST};
use super::super::evidence::{Equations, Question, Spreads, Start, Weighed, weigh};
use super::super::level::Level;
use super::super::verdict::Course;
use super::data::{Data, DriveRun};
use super::effects::Free;
use super::fit::{Plant, derivatives};
use nalgebra::Complex;
use rayon::prelude::*;
use std::f64::consts::TAU;
use twum_fit::normal::Normal;

/// Knots over the input.
const INPUT_KNOTS: usize = 9;
/// Knots over the time, common to all runs.
const TIME_KNOTS: usize = 6;
/// Knots of a run's own wander.
const WANDER_KNOTS: usize = 16;
/// Earlier speeds that a term over the dynamics holds against the present one.
const ECHOES: usize = 5;
/// Turns a run has to make before its angle is looked at.
const LEAST_TURNS: f64 = 0.6;
/// Rows that are put into the equations at once.
const CHUNK: usize = 1024;

/// A smooth family of additions to the speed, or of factors on it.
struct Term {
    lives_in: &'static str,
    columns: usize,
    own: bool,
    harmonic: bool,
    factor: bool,
    cost: f64,
}

/// Terms without physics beside a set.
pub struct Terms(Vec<Term>);

impl Terms {
    /// Those that the runs can show.
    pub fn new(data: &Data) -> Self {
        let term = |lives_in, columns, own, cost| Term { lives_in, columns, own, harmonic: false, factor: false, cost };
        let mut all = vec![
            term("input", INPUT_KNOTS, false, FREE_FORM_COST),
            term("the time after a change of the input", ECHOES, false, FREE_FORM_COST),
        ];
        // Where each input is passed but once, its time says nothing that the input does not.
        if !data.passes_once() {
            all.push(term("time", TIME_KNOTS, false, TERM_COST));
            // What warms turns slower by a share: where the speed goes to and fro, nothing that is added follows that. It costs what an unknown
            // form of an effect costs, for it is one of heating.
            all.push(Term { factor: true, ..term("time", TIME_KNOTS, false, FREE_FORM_COST) });
            all.push(term("time, each run its own", WANDER_KNOTS, true, TERM_COST));
        }
        let turns = |r: &DriveRun| r.turns.iter().fold(0.0f64, |a, t| a.max((t - r.turns[0]).abs()));
        if data.runs.iter().any(|r| turns(r) > LEAST_TURNS) {
            all.push(Term { harmonic: true, ..term("angle", 4, true, TERM_COST) });
            all.push(Term { harmonic: true, ..term("angle, three and more times a turn", 12, true, TERM_COST) });
        }
        Self(all)
    }

    fn columns(&self) -> usize {
        self.0.iter().map(|t| t.columns).sum()
    }

    /// Puts the columns of row `k` of a run into `row`.
    fn fill(
        &self,
        run: &DriveRun,
        predicted: &[f64],
        echoes: &[usize; ECHOES],
        data: &Data,
        k: usize,
        row: &mut [f64],
    ) {
        let longest = data.runs.iter().map(DriveRun::seconds).fold(1e-9, f64::max);
        let sample = run.sample(k);
        let since = run.time[sample] - run.time[0];
        let mut at = 0;
        for term in &self.0 {
            let to = &mut row[at..at + term.columns];
            at += term.columns;
            match term.lives_in {
                "input" => hats(to, 0.5 * (run.input[sample] + 1.0)),
                "time" => hats(to, since / longest),
                "time, each run its own" => hats(to, since / run.seconds()),
                "the time after a change of the input" => {
                    for (to, back) in to.iter_mut().zip(echoes) {
                        *to = (predicted[k.saturating_sub(*back)] - predicted[k]) / data.usual_rpm;
                    }
                }
                place => {
                    let first = if place == "angle" { 1 } else { 3 };
                    let once = Complex::from_polar(1.0, TAU * run.turns[sample]);
                    let mut wave = once.powu(first);
                    for pair in to.chunks_exact_mut(2) {
                        pair.copy_from_slice(&[wave.re, wave.im]);
                        wave *= once;
                    }
                }
            }
            let size = if term.factor { predicted[k] } else { data.usual_rpm };
            to.iter_mut().for_each(|v| *v *= size);
        }
    }
}

/// Piecewise linear basis functions over 0..1.
fn hats(to: &mut [f64], x: f64) {
    let x = x.clamp(0.0, 1.0) * (to.len() - 1) as f64;
    for (j, value) in to.iter_mut().enumerate() {
        *value = (1.0 - (x - j as f64).abs()).max(0.0);
    }
}

/// A refitted plant, weighed.
pub struct Evidence {
    /// What was found by integrating.
    pub weighed: Weighed,
    /// Log evidence with the terms that the data ask for, their costs taken off.
    pub log: f64,
    /// Those terms, strongest first, with the squared error that is then left.
    pub terms: Vec<(&'static str, f64)>,
    /// Share of the squared error left that a course of each run's own would take, by the term's name.
    pub courses: Vec<Course>,
}

/// Weighs a refitted plant. `free` begins with the gain; `without` is the squared error without effects.
pub fn weigh_plant(
    data: &Data,
    terms: &Terms,
    level: &Level,
    independent: f64,
    plant: &Plant,
    free: &[Free],
    without: Option<f64>,
) -> Evidence {
    let equations = Equations { runs: equations(data, terms, plant, &free[1..]), independent };
    let base =
        Question { common: free[1..].iter().enumerate().map(|(k, f)| (k + 1, f.sd)).collect(), ..Default::default() };
    let mut from = free.len();
    let at: Vec<std::ops::Range<usize>> = terms
        .0
        .iter()
        .map(|t| {
            from += t.columns;
            from - t.columns..from
        })
        .collect();
    let ask = |chosen: &[usize], start: &Start| {
        let mut q = base.clone();
        for t in chosen {
            if terms.0[*t].own {
                let group = q.own.iter().map(|o| o.1 + 1).max().unwrap_or(0);
                let pair = |i: usize| if terms.0[*t].harmonic { i / 2 } else { 0 };
                q.own.extend(at[*t].clone().enumerate().map(|(i, c)| (c, group + pair(i))));
            } else {
                q.common.extend(at[*t].clone().map(|c| (c, SIZE)));
            }
        }
        weigh(&equations, level, &q, start)
    };
    let misfit: f64 = equations.runs.iter().map(|run| run.yy).sum();
    let start = Start {
        variance: (misfit / independent).max(1e-12),
        taus: level.believed(),
        without: without.unwrap_or(0.0),
        spreads: Spreads::Near,
    };
    let failed = || Weighed {
        log: f64::NEG_INFINITY,
        left: f64::INFINITY,
        variance: start.variance,
        taus: start.taus,
        belief: [0.0; 5],
        gains: vec![0.0; data.runs.len()],
        shared: Vec::new(),
        powers: Vec::new(),
    };
    let weighed = ask(&[], &start).unwrap_or_else(failed);
    let near = Start {
        variance: weighed.variance,
        taus: weighed.taus,
        without: start.without.max(weighed.left),
        spreads: Spreads::Stay,
    };
    let (mut chosen, mut left, mut courses, mut log) = (Vec::new(), Vec::new(), Vec::new(), weighed.log);
    for round in 0..2 {
        let looks: Vec<(usize, f64, f64)> = (0..terms.0.len())
            .into_par_iter()
            .filter(|t| chosen.iter().all(|c: &usize| terms.0[*c].lives_in != terms.0[*t].lives_in))
            .filter_map(|t| {
                let more = [chosen.clone(), vec![t]].concat();
                ask(&more, &near).map(|w| (t, w.log, w.left))
            })
            .collect();
        if round == 0 {
            courses = courses_of(terms, &looks, weighed.left, equations.floor());
        }
        let cost = |t: &usize| terms.0[*t].cost;
        let paid: f64 = chosen.iter().map(cost).sum();
        let best = looks.into_iter().max_by(|a, b| (a.1 - cost(&a.0)).total_cmp(&(b.1 - cost(&b.0))));
        let Some((t, found, rest)) = best.filter(|b| b.1 - cost(&b.0) - paid > log) else { break };
        log = found - cost(&t) - paid;
        chosen.push(t);
        left.push((terms.0[t].lives_in, rest));
    }
    Evidence { weighed, log, terms: left, courses }
}

/// What terms of the runs' own would take of the squared error `left` and the floor, the strongest first. A look is a term with the log
/// evidence that it leads to and the squared error that it leaves.
fn courses_of(terms: &Terms, looks: &[(usize, f64, f64)], left: f64, floor: f64) -> Vec<Course> {
    let of = |&(t, _, rest): &(usize, f64, f64)| {
        let taken = left - rest;
        Course { lives_in: terms.0[t].lives_in, taken, share: taken / (left + floor).max(1e-12) }
    };
    let mut courses: Vec<Course> = looks.iter().filter(|look| terms.0[look.0].own).map(of).collect();
    courses.sort_by(|a, b| b.share.total_cmp(&a.share));
    courses
}

/// Normal equations of every run over the predicted speed, what is free beside it, and the terms.
fn equations(data: &Data, terms: &Terms, plant: &Plant, free: &[Free]) -> Vec<Normal> {
    let (now, columns) = derivatives(data, plant, free);
    let n = 1 + free.len() + terms.columns();
    (0..data.runs.len())
        .into_par_iter()
        .map(|i| {
            let run = &data.runs[i];
            let echoes = echoes(run, plant.values.lag_s());
            let mut normal = Normal::empty(n);
            for from in (0..run.rpm.len()).step_by(CHUNK) {
                let rows = from..(from + CHUNK).min(run.rpm.len());
                let mut x = vec![0.0; n * rows.len()];
                for (row, k) in x.chunks_exact_mut(n).zip(rows.clone()) {
                    row[0] = now[i].rpm[k];
                    for (to, c) in row[1..].iter_mut().zip(&columns[i][..free.len()]) {
                        *to = c[k];
                    }
                    terms.fill(run, &now[i].rpm, &echoes, data, k, &mut row[1 + free.len()..]);
                }
                let y: Vec<f64> = rows.map(|k| run.rpm[k] - now[i].rpm[k]).collect();
                normal.add(&x, &y);
            }
            normal
        })
        .collect()
}

/// Rows back to which a term over the dynamics looks: from one sample to four lags.
fn echoes(run: &DriveRun, lag_s: f64) -> [usize; ECHOES] {
    let farthest = (4.0 * lag_s / run.period_s).clamp(16.0, 0.2 * run.rpm.len() as f64 + 16.0);
    std::array::from_fn(|j| farthest.powf(j as f64 / (ECHOES - 1) as f64).round() as usize + j)
}
