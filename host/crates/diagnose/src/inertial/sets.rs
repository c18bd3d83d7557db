//! Sets of effects of an ordinary motor: what is free in them, their refit, and what they weigh.

use super::super::evidence::{Weighed, independent};
use super::super::form_error::FormError;
use super::super::level::Level;
use super::super::verdict::{Course, Visited};
use super::super::weighing::{EFFECT_COST, SAME_COORDINATE};
use super::angle::Ripple;
use super::data::Data;
use super::effects::{EFFECTS, Free, free, over_angle, refined_by};
use super::fit::{Plant, log_prior, misfit, refit, refit_to_the_end};
use super::plant::simulate_all;
use super::ripple::{followed, span};
use super::values::{P, Values};
use super::weigh::{Evidence, Terms, weigh_plant};
use rayon::prelude::*;
use twum_fit::noise::Noise;

/// Usual spread of the gain from run to run: supplies and warmth of ordinary drives.
pub const GAIN_SPREAD: f64 = 0.02;
/// Steps of a look, and of a refit that counts.
pub const LOOK: usize = 4;
pub const STEPS: usize = 40;
/// Periods over which a torque that goes with the input and the angle has to be seen: of such as were another effect's, none of five went
/// through more than 1.4.
const LEAST_RIPPLES: f64 = 2.0;
/// Share of the lag within which a load swings through a radian: the friction that makes the lag damps slower ones as they begin.
const SLOWEST_SWING: f64 = 0.5;
/// Times that other valleys are looked for.
const SCANS: usize = 3;
/// Size, in deviations of what is believed, below which an effect is none.
const LEAST_SIZE: f64 = 1e-3;
/// Fewest independent residuals that a record counts as: a run has a gain, a lag and some thresholds to say something of.
pub const LEAST_INDEPENDENT: f64 = 40.0;
/// Rows of a TWUM overlap fourfold; those of an ordinary motor do not.
const INDEPENDENT_SHARE: f64 = 4.0;

/// An effect in a set and its form.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Part {
    /// Index in [`EFFECTS`].
    pub effect: usize,
    /// Index among its forms.
    pub form: usize,
}

/// A set of effects, refitted and weighed.
#[derive(Debug, Clone)]
pub struct Set {
    /// The effects.
    pub parts: Vec<Part>,
    /// The plant with them.
    pub plant: Plant,
    /// Log evidence with costs and priors.
    pub score: f64,
    /// What was found by integrating.
    pub weighed: Weighed,
    terms: Vec<(&'static str, f64)>,
    courses: Vec<Course>,
    /// Whether others were looked for from it.
    pub expanded: bool,
    /// Whether its twins were put in its place.
    pub exchanged: bool,
    /// Whether other forms of its effects were tried.
    pub reformed: bool,
}

impl Set {
    /// Indices of its effects, sorted.
    pub fn key(&self) -> Vec<usize> {
        key(&self.parts)
    }

    /// The numbers of its effects.
    fn numbers(&self) -> impl Iterator<Item = P> {
        self.parts.iter().flat_map(|p| EFFECTS[p.effect].forms[p.form].numbers).copied()
    }

    /// What the verdict has to know of it.
    pub fn visited(&self) -> Visited {
        Visited {
            key: self.key(),
            score: self.score,
            left: self.weighed.left,
            taus: self.weighed.taus,
            belief: self.weighed.belief,
            terms: self.terms.clone(),
            courses: self.courses.clone(),
            // Runs of an ordinary motor differ by chance alone, see `Level::by_chance`.
            by_gains: 0.0,
            scattered: [0.0; 5],
        }
    }
}

pub fn key(parts: &[Part]) -> Vec<usize> {
    let mut k: Vec<usize> = parts.iter().map(|p| p.effect).collect();
    k.sort_unstable();
    k
}

/// What a search works on.
pub struct Ground<'a> {
    /// The runs.
    pub data: &'a Data,
    /// Indices of the effects that these runs can show.
    pub usable: Vec<usize>,
    /// What the gains of the runs scatter by.
    pub level: Level,
    terms: Terms,
    /// How many independent residuals the runs count as.
    pub independent: f64,
    /// The squared error that counts as one of the forms, in rpm².
    pub form_error: FormError,
}

impl<'a> Ground<'a> {
    /// Of some runs.
    pub fn new(data: &'a Data, usable: Vec<usize>) -> Self {
        let independent = independent(INDEPENDENT_SHARE * data.rows() as f64, data.runs.len());
        Self {
            data,
            usable,
            level: Level::by_chance(data.runs.len(), GAIN_SPREAD),
            terms: Terms::new(data),
            independent,
            form_error: FormError::UNBOUNDED,
        }
    }

    /// What is free in a set, the gain first.
    pub fn free(&self, parts: &[Part]) -> Vec<Free> {
        self.free_with(parts, &[])
    }

    /// The same with others beside.
    pub fn free_with(&self, parts: &[Part], others: &[P]) -> Vec<Free> {
        let numbers = parts.iter().flat_map(|p| EFFECTS[p.effect].forms[p.form].numbers).chain(others);
        // A load that was measured is as any input, known up to its size.
        let load = self.data.largest_load.map(|_| &P::Load);
        [P::Gain, P::LogLag, P::Skew].iter().chain(load).chain(numbers).map(|p| free(*p, self.data)).collect()
    }

    /// What residuals scatter around a plant.
    pub fn noise(&self, plant: &Plant) -> Noise {
        self.noise_among(self.independent, plant)
    }

    /// The same where every sample counts that is not foretold by the one before: sizes are told by all of them, and what is believed of a
    /// size may not stand against more of them than it is worth.
    pub fn noise_of_samples(&self, plant: &Plant) -> Noise {
        self.noise_among(self.data.rows() as f64 / memory(self.data, plant), plant)
    }

    fn noise_among(&self, independent: f64, plant: &Plant) -> Noise {
        let variance = misfit(self.data, plant, &[], Noise::PLAIN, &[]) / independent;
        Noise { variance: variance.max(1e-12), gain_spread: GAIN_SPREAD }
    }

    /// Refitted to the end, until the noise by which the priors are weighed is that of the fit itself.
    pub fn refitted(&self, mut plant: Plant, parts: &[Part]) -> Plant {
        for _ in 0..4 {
            let before = self.noise(&plant).variance;
            plant = self.refitted_once(plant, parts);
            if self.noise(&plant).variance > 0.8 * before {
                break;
            }
        }
        plant
    }

    /// Inputs come in steps, so that a threshold moves the break-away in jumps and derivatives see one valley of
    /// many: others are tried about it.
    fn refitted_once(&self, plant: Plant, parts: &[Part]) -> Plant {
        let noise = self.noise(&plant);
        let free = self.free(parts);
        let value = |p: &Plant| misfit(self.data, p, &free, noise, &[]);
        let mut best = refit(self.data, plant, &free, noise, &[], STEPS);
        for _ in 0..SCANS {
            let mut tried: Vec<(f64, Plant)> = free
                .iter()
                .flat_map(|f| neighbours(f.number).iter().map(|by| (f.number, *by)))
                .collect::<Vec<_>>()
                .into_par_iter()
                .map(|(number, factor)| {
                    let mut plant = best.clone();
                    plant.values.set(number, factor * plant.values.get(number));
                    let plant = self.with_gain(plant);
                    (value(&plant), plant)
                })
                .collect();
            tried.sort_by(|a, b| a.0.total_cmp(&b.0));
            let near: Vec<Plant> =
                tried.into_par_iter().take(2).map(|t| refit(self.data, t.1, &free, noise, &[], LOOK)).collect();
            let Some(other) = near.into_iter().min_by(|a, b| value(a).total_cmp(&value(b))) else { break };
            if value(&other) > 0.999 * value(&best) {
                break;
            }
            best = refit(self.data, other, &free, noise, &[], STEPS);
        }
        best
    }

    /// A set with its plant refitted as finely as its intervals are told, its forms with what the search leaves out of them.
    pub fn settled(&self, set: &Set) -> Set {
        let noise = self.noise_of_samples(&set.plant);
        let fitted = |plant: Plant| {
            let free = self.free_of(&set.parts, &plant.values);
            let plant = refit_to_the_end(self.data, plant, &free, noise, STEPS);
            (misfit(self.data, &plant, &free, noise, &[]), plant)
        };
        let mut best = fitted(set.plant.clone());
        for finer in set.numbers().map(refined_by) {
            let mut values = best.1.values;
            for (number, begin) in finer.iter().filter(|f| best.1.values.get(f.0) == 0.0) {
                values.set(*number, *begin);
            }
            let finer = fitted(Plant { values, starts: best.1.starts.clone() });
            if finer.0 < best.0 {
                best = finer;
            }
        }
        // Where a step of the input falls onto a sample, steps of a fit that see one side of it alone end beside the best.
        let mut whole = best.1.clone();
        let period = self.data.runs.iter().map(|r| r.period_s).fold(f64::INFINITY, f64::min);
        let late = whole.values.get(P::DeadTime) / period;
        whole.values.set(P::Skew, (late + whole.values.get(P::Skew)).round() - late);
        let free = self.free_of(&set.parts, &whole.values);
        let others: Vec<Free> =
            free.iter().filter(|f| f.number != P::Skew && f.number != P::DeadTime).copied().collect();
        let whole = refit_to_the_end(self.data, whole, &others, noise, STEPS);
        if misfit(self.data, &whole, &free, noise, &[]) < best.0 {
            best.1 = whole;
        }
        Set { plant: best.1, ..set.clone() }
    }

    /// Numbers that refine those of some effects in a plant, and are not theirs.
    pub fn finer(&self, parts: &[Part], values: &Values) -> Vec<P> {
        let own = |p: &Part| EFFECTS[p.effect].forms[p.form].numbers;
        let mut finer: Vec<P> = Vec::new();
        for (number, _) in parts.iter().flat_map(own).flat_map(|n| refined_by(*n)) {
            if values.get(*number) > 0.0 && !finer.contains(number) && parts.iter().all(|p| !own(p).contains(number)) {
                finer.push(*number);
            }
        }
        finer
    }

    /// What is free in a set whose plant has these values.
    pub fn free_of(&self, parts: &[Part], values: &Values) -> Vec<Free> {
        self.free_with(parts, &self.finer(parts, values))
    }

    /// The gain that suits the other numbers best: speeds go with it as a whole.
    pub fn with_gain(&self, mut plant: Plant) -> Plant {
        let motions = simulate_all(self.data, &plant.values, &plant.starts);
        let (mut yp, mut pp) = (0.0, 0.0);
        for (run, m) in self.data.runs.iter().zip(&motions) {
            for (y, p) in run.rpm.iter().zip(&m.rpm) {
                yp += y * p;
                pp += p * p;
            }
        }
        if pp > 0.0 && yp != 0.0 {
            plant.values.set(P::Gain, plant.values.get(P::Gain) * yp / pp);
        }
        plant
    }

    /// The line with a lag that does best, from lags of a fraction of a sample to the whole record.
    pub fn root(&self) -> Set {
        let shortest = self.data.runs.iter().map(|r| r.period_s).fold(f64::INFINITY, f64::min);
        let longest = self.data.runs.iter().map(|r| r.seconds()).fold(0.0, f64::max);
        let starts: Vec<f64> = self.data.runs.iter().map(|r| r.rpm[0]).collect();
        let lag = |k: usize| 0.3 * shortest * (longest / shortest).powf(k as f64 / 9.0);
        let value = |p: &Plant| misfit(self.data, p, &[], Noise::PLAIN, &[]);
        let mut lines: Vec<(f64, Plant)> = (0..20)
            .into_par_iter()
            .map(|k| {
                let skew = if k % 2 == 0 { 0.0 } else { -1.0 };
                let values = Values::line(self.data.usual_rpm, lag(k / 2)).with(P::Skew, skew);
                let plant = self.with_gain(Plant { values, starts: starts.clone() });
                (value(&plant), plant)
            })
            .collect();
        lines.sort_by(|a, b| a.0.total_cmp(&b.0));
        let near = lines.into_iter().take(3).map(|l| self.refitted(l.1, &[]));
        let best = near.min_by(|a, b| value(a).total_cmp(&value(b))).expect("three lines were tried");
        self.weigh_set(Vec::new(), best, None)
    }

    pub fn weigh_set(&self, parts: Vec<Part>, plant: Plant, root: Option<&Set>) -> Set {
        let free = self.free(&parts);
        let without = root.map(|r| self.form_error.base(r.weighed.left));
        let Evidence { weighed, log, terms, courses } =
            weigh_plant(self.data, &self.terms, &self.level, self.independent, &plant, &free, without);
        let prior = log_prior(&plant.values, &free[1..]);
        let ways: f64 = parts.iter().map(|p| (EFFECTS[p.effect].forms.len() as f64).ln()).sum();
        let coordinates: std::collections::BTreeSet<_> = parts.iter().map(|p| EFFECTS[p.effect].coordinate).collect();
        let shared = (parts.len() - coordinates.len()) as f64;
        // An effect of no size is none, and what the equations make of its other sign is not there.
        let sizeless = |p: &Part| {
            let size = free.iter().find(|f| f.number == EFFECTS[p.effect].forms[p.form].numbers[0]);
            size.is_some_and(|f| f.bounds.0 == 0.0 && plant.values.get(f.number) < LEAST_SIZE * f.sd)
        };
        // Of a load that is seen the search hardly tells the weight: only the motor's friction shows it.
        let swingless = |f: &Free| f.number != P::SwingOfLoad && no_swing(f, &plant.values);
        let none = parts.iter().any(sizeless) || free.iter().any(swingless);
        let log = if none { f64::NEG_INFINITY } else { log };
        let orders = parts.iter().map(|p| self.orders_of(p)).max().unwrap_or(0);
        let chosen: f64 = self.data.ripples.iter().take(orders).map(Ripple::cost).sum();
        let score = log + prior - chosen - EFFECT_COST * parts.len() as f64 - SAME_COORDINATE * shared - ways;
        Set { parts, plant, score, weighed, terms, courses, expanded: false, exchanged: false, reformed: false }
    }

    /// How many orders of the angle a form is about.
    fn orders_of(&self, part: &Part) -> usize {
        let numbers = EFFECTS[part.effect].forms[part.form].numbers;
        numbers.iter().filter_map(|n| over_angle(*n)).map(|(_, at)| at + 1).max().unwrap_or(0)
    }

    /// Whether a torque over the angle is in a set.
    pub fn has_angle(&self, set: &Set) -> bool {
        set.parts.iter().any(|p| self.orders_of(p) > 0)
    }

    /// The data with the angle told anew by a set with a torque over it.
    pub fn followed(&self, set: &Set) -> Data {
        let (free, noise) = (self.free(&set.parts), self.noise_of_samples(&set.plant));
        followed(self.data, &set.plant, |data, plant| refit(data, plant, &free, noise, &[], LOOK))
    }

    /// Whether a form can act beside a set: its numbers are about something that is there.
    pub fn makes_sense(&self, part: Part, beside: &[Part]) -> bool {
        let numbers = |p: &Part| EFFECTS[p.effect].forms[p.form].numbers;
        let orders = self.orders_of(&part) <= self.data.ripples.len();
        // Over a period or so, what goes with the input and the angle is any curve over the input or the time.
        let way = || self.data.runs.iter().map(span).fold(0.0, f64::max);
        let periods = || self.data.ripples.first().map_or(0.0, |r| r.order as f64 * way());
        orders
            && (!numbers(&part).contains(&P::RippleCos) || periods() >= LEAST_RIPPLES)
            && EFFECTS[part.effect].forms[part.form].needs.iter().all(|n| beside.iter().any(|p| numbers(p).contains(n)))
    }

    /// The set without its effect `k`: visited, or refitted.
    pub fn without(&self, set: &Set, k: usize, pool: &[Set]) -> Set {
        let mut parts = set.parts.clone();
        let gone = parts.remove(k);
        if let Some(known) = pool.iter().find(|s| s.key() == key(&parts)) {
            return known.clone();
        }
        let mut plant = set.plant.clone();
        for p in EFFECTS[gone.effect].forms[gone.form].numbers {
            plant.values.set(*p, 0.0);
        }
        // What was about the effect that is gone goes with it: the other form of an asymmetry.
        for i in 0..parts.len() {
            if !self.makes_sense(parts[i], &parts) {
                for p in EFFECTS[parts[i].effect].forms[parts[i].form].numbers {
                    plant.values.set(*p, 0.0);
                }
                parts[i].form = 0;
            }
        }
        let plant = self.refitted(plant, &parts);
        self.weigh_set(parts, plant, pool.iter().find(|s| s.parts.is_empty()))
    }
}

/// Factors by which a number is moved in search of another valley: thresholds jump from one step of the input to the next, a strong bend
/// goes with another gain.
fn neighbours(number: P) -> &'static [f64] {
    match number {
        P::Coulomb | P::DeadZone | P::Stiction => &[0.7, 0.85, 0.94, 0.98, 1.02, 1.06, 1.15, 1.3],
        P::Bend => &[0.4, 1.6, 3.0],
        _ => &[],
    }
}

/// Whether a number says that a load swings for ever, not at all, as slowly as the lag, or weighs nothing: it is then some other thing whose form
/// the library has not.
pub fn no_swing(f: &Free, values: &Values) -> bool {
    let value = values.get(f.number);
    match f.number {
        P::Swing => value > SLOWEST_SWING * values.lag_s(),
        P::SwingDamping | P::SwingOfMotor | P::SwingOfLoad => value < 1.05 * f.bounds.0 || value > 0.95 * f.bounds.1,
        _ => false,
    }
}

/// How many samples what a plant misses lasts: (1 + ρ)/(1 − ρ) of neighbours that are correlated by ρ.
pub fn memory(data: &Data, plant: &Plant) -> f64 {
    let motions = simulate_all(data, &plant.values, &plant.starts);
    let (mut own, mut next) = (1e-300, 0.0);
    for (run, m) in data.runs.iter().zip(&motions) {
        let rest: Vec<f64> = run.rpm.iter().zip(&m.rpm).map(|(y, p)| y - p).collect();
        own += rest.iter().map(|r| r * r).sum::<f64>();
        next += rest.windows(2).map(|w| w[0] * w[1]).sum::<f64>();
    }
    let rho = (next / own).clamp(0.0, 0.999);
    (1.0 + rho) / (1.0 - rho)
}
