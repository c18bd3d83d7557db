//! How well a set of effects of an ordinary motor does where it was not fitted.

use super::super::design::RunDesign;
use super::super::stats::{Fold, Grams, Group, HeldOut, p_value};
use super::data::Data;
use super::fit::{Block, Plant, derivatives, refit};
use super::plant::{simulate, simulate_all};
use super::sets::{Ground, Part, Set};
use super::values::P;
use rayon::prelude::*;
use std::cell::RefCell;

/// Pieces of a run that are scored apart: what the interval of a gain resamples.
const PIECES: usize = 8;
/// Parts of a single run, held out in turn: a slow sweep passes each input once, so that longer ones would hide a range of inputs.
const PARTS: usize = 40;
/// Divisions of the runs, or of the parts of a single one.
const FOLDS: usize = 5;
/// Steps of a refit without what is held out: it begins where all was fitted.
const STEPS: usize = 4;

/// Divisions of the runs: whole ones are held out, of a single one every fifth part.
pub fn divisions(data: &Data) -> Vec<Vec<Block>> {
    let runs = data.runs.len();
    if runs == 1 {
        let n = data.runs[0].rpm.len();
        let part = |k: usize| Block { run: 0, rows: n * k / PARTS..n * (k + 1) / PARTS };
        return (0..FOLDS).map(|f| (f..PARTS).step_by(FOLDS).map(part).collect()).collect();
    }
    let folds = if runs < 2 * FOLDS { runs } else { FOLDS };
    let whole = |run: usize| Block { run, rows: 0..data.runs[run].rpm.len() };
    (0..folds).map(|k| (0..runs).filter(|r| r % folds == k).map(whole).collect()).collect()
}

/// Scores sets on what they were not fitted to, each once.
pub struct Scorer<'a> {
    /// What the sets are of.
    pub ground: &'a Ground<'a>,
    known: RefCell<Vec<(Vec<Part>, Plant, HeldOut)>>,
}

impl<'a> Scorer<'a> {
    /// Without any score yet.
    pub fn new(ground: &'a Ground<'a>) -> Self {
        Self { ground, known: RefCell::new(Vec::new()) }
    }

    /// The errors of a set.
    pub fn held_out(&self, set: &Set) -> HeldOut {
        // A set whose forms were refined is another.
        let same = |k: &&(Vec<Part>, Plant, HeldOut)| k.0 == set.parts && k.1 == set.plant;
        let known = self.known.borrow().iter().find(same).map(|k| k.2.clone());
        known.unwrap_or_else(|| {
            let new = held_out(self.ground, set);
            self.known.borrow_mut().push((set.parts.clone(), set.plant.clone(), new.clone()));
            new
        })
    }
}

/// Errors of a set on what it was not fitted to; the initial speed of a run that is held out is its own.
fn held_out(ground: &Ground, set: &Set) -> HeldOut {
    let data = ground.data;
    let free = ground.free_of(&set.parts, &set.plant.values);
    let noise = ground.noise(&set.plant);
    let scored: Vec<(Vec<f64>, Vec<f64>)> = divisions(data)
        .into_par_iter()
        .map(|hidden| {
            let plant = refit(data, set.plant.clone(), &free, noise, &hidden, STEPS);
            let mut out = (Vec::new(), Vec::new());
            for block in &hidden {
                let motion = simulate(&data.runs[block.run], &plant.values, plant.starts[block.run], data.unsigned);
                let rows: Vec<usize> = block.rows.clone().collect();
                let pieces = if data.runs.len() == 1 { 1 } else { PIECES };
                for piece in rows.chunks(rows.len().div_ceil(pieces)) {
                    let error = |k: &usize| (data.runs[block.run].rpm[*k] - motion.rpm[*k]).powi(2);
                    out.0.push(piece.iter().map(error).sum());
                    out.1.push(piece.len() as f64);
                }
            }
            out
        })
        .collect();
    let errors = || scored.iter().flat_map(|s| &s.0).map(|e| [*e; 2]).collect();
    HeldOut { loss: errors(), plain: errors(), seconds: scored.iter().flat_map(|s| s.1.iter().copied()).collect() }
}

/// Share of null data sets in which some effect does as well as each: what a set misses keeps its size and takes a random sign in each
/// block. Of an effect that stands beside others, the set is those others: their errors, turned about, are no chance.
pub struct Chance {
    null: Vec<f64>,
    /// Improvement of every effect beside the set on runs that were not fitted, by its index.
    alone: Vec<(usize, f64)>,
}

impl Chance {
    /// Of the visited sets that have one effect more than `set`. Each stands for its effect by the direction in which it moves the speeds.
    pub fn new(ground: &Ground, set: &Set, visited: &[Set], repetitions: usize, seed: u64) -> Self {
        let data = ground.data;
        let key = set.key();
        let more = visited.iter().filter(|s| s.parts.len() == key.len() + 1);
        let more = more.filter_map(|s| {
            let keys = s.key();
            let new = *keys.iter().find(|e| !key.contains(e))?;
            key.iter().all(|e| keys.contains(e)).then_some((new, s))
        });
        let more: Vec<(usize, &Set)> = more.collect();
        let free: Vec<_> = ground.free(&set.parts).into_iter().filter(|f| f.number != P::Gain).collect();
        let (now, columns) = derivatives(data, &set.plant, &free);
        let moved: Vec<_> = more.iter().map(|(_, s)| simulate_all(data, &s.plant.values, &s.plant.starts)).collect();
        let (base, effects) = (1 + free.len(), more.len());
        let mut designs = Vec::new();
        let mut owner = Vec::new();
        for (i, run) in data.runs.iter().enumerate() {
            let n = run.rpm.len();
            for piece in 0..PIECES {
                let rows = n * piece / PIECES..n * (piece + 1) / PIECES;
                let mut d = RunDesign {
                    columns: base + effects,
                    x: Vec::with_capacity(rows.len() * (base + effects)),
                    y: Vec::with_capacity(rows.len()),
                    weight: vec![1.0; rows.len()],
                    seconds: rows.len() as f64,
                };
                for k in rows {
                    d.x.push(now[i].rpm[k]);
                    d.x.extend(columns[i][..free.len()].iter().map(|c| c[k]));
                    d.x.extend(moved.iter().map(|m| m[i].rpm[k] - now[i].rpm[k]));
                    d.y.push(run.rpm[k] - now[i].rpm[k]);
                }
                designs.push(d);
                owner.push((i, piece));
            }
        }
        let folds = (0..PIECES)
            .map(|k| {
                let test: Vec<usize> = (0..owner.len()).filter(|p| owner[*p].1 == k).collect();
                Fold { train: (0..owner.len()).filter(|p| !test.contains(p)).collect(), test }
            })
            .collect();
        let scales: Vec<f64> = (0..base + effects).map(|c| if c < base { 1e6 } else { 3.0 }).collect();
        let block = (data.rows() / (40 * data.runs.len())).max(12);
        let grams = Grams::with_blocks(&designs, 0, &scales, None, folds, block);
        let own: Vec<usize> = (0..base).collect();
        let groups: Vec<Group> = (base..base + effects).map(|c| Group::Linear(vec![c])).collect();
        let (improvements, null) = grams.screen(&own, &groups, &[], repetitions, seed);
        Self { null, alone: more.iter().map(|s| s.0).zip(improvements).collect() }
    }

    /// The p-value of an effect by what it improves beside the others, `held`, or alone: beside another it may do more, or less.
    pub fn p(&self, effect: usize, held: Option<&HeldOut>) -> f64 {
        let alone = self.alone.iter().find(|a| a.0 == effect).map_or(0.0, |a| a.1);
        let found = held.map_or(alone, |h| h.improvement().max(alone));
        p_value(found, &self.null)
    }
}

/// Squared error in rpm² of a plant on all rows.
pub fn squared_error(data: &Data, plant: &Plant) -> f64 {
    let motions = simulate_all(data, &plant.values, &plant.starts);
    let of = |(run, m): (&super::data::DriveRun, &super::plant::Motion)| -> f64 {
        run.rpm.iter().zip(&m.rpm).map(|(y, p)| (y - p).powi(2)).sum()
    };
    data.runs.iter().zip(&motions).map(of).sum()
}
