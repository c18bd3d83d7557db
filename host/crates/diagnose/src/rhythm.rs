//! What goes with the angle, beside the noise of sampling alone.
//!
//! Sets are weighed and refitted under a tempered likelihood, which takes what is left for errors of forms, few and slow: it holds the coefficients
//! of single runs back by more than sampling does. A run that turns round tells them apart from what is slow.

use super::design::RunDesign;
use super::free::columns_of;
use super::ground::Ground;
use super::library::Phased;
use super::problem::Problem;
use super::refit::{FIRST_POWER, coefficients, equations, expected_power, precision, put_coefficients};
use super::set::{Set, phased_of};
use twum_fit::noise::Noise;
use twum_fit::normal::Normal;

/// Turns from which a run tells a rhythm of the angle from the slow errors that forms have, so that only the sampling's noise is left beside it.
const TOLD_APART_TURNS: f64 = 1.0;
/// Fewest such runs that say how large it is: one repeats nothing.
const FEWEST_TOLD_APART: usize = 2;

/// Rounds in which the powers are found by themselves, at most; from one that is 20 times as large they fall to a thousandth in a dozen where
/// the runs know them well.
const ROUNDS: usize = 100;
/// They end when no power moves by more than this share of itself.
const SETTLED: f64 = 1e-4;

/// The runs that turned far enough to tell a rhythm apart; none where they are too few.
pub fn told_apart(problem: &Problem) -> Vec<usize> {
    let runs = problem.runs.iter().enumerate().filter(|(_, r)| r.revolutions() >= TOLD_APART_TURNS);
    let far: Vec<usize> = runs.map(|(k, _)| k).collect();
    if far.len() < FEWEST_TOLD_APART { Vec::new() } else { far }
}

/// The runs that say how large a rhythm is: those that tell it apart, or all where none do.
pub fn shown_by(problem: &Problem) -> Vec<usize> {
    let far = told_apart(problem);
    if far.is_empty() { (0..problem.runs.len()).collect() } else { far }
}

/// The run that turned farthest: its phases stand for all, which start at unknown angles of the rotor.
pub fn longest(problem: &Problem) -> usize {
    let turned = |i: &usize| problem.runs[*i].revolutions().abs();
    (0..problem.runs.len()).max_by(|a, b| turned(a).total_cmp(&turned(b))).unwrap_or(0)
}

/// The power that each pair of `phased` has in the runs that say how large it is.
pub fn powers(ground: &Ground, set: &Set, phased: &[Phased]) -> Vec<f64> {
    Beside::of(ground, set, phased).powers(&shown_by(ground.problem))
}

/// The set with the coefficients of the runs that tell them apart as large as they are, and the power that they have there; the same set where
/// none do.
pub fn whole(ground: &Ground, set: &Set) -> Set {
    let phased = phased_of(&set.parts);
    let far = told_apart(ground.problem);
    let mut whole = set.clone();
    if phased.is_empty() || far.is_empty() {
        return whole;
    }
    let beside = Beside::of(ground, set, &phased);
    let powers = beside.powers(&far);
    let precision = precision(&powers, beside.noise.variance);
    let mut values = coefficients(&set.model, &phased);
    for run in far {
        let own = beside.runs[run].own_inverse(1, &precision) * beside.runs[run].b.rows(1, precision.len());
        values[run] = own.as_slice().to_vec();
    }
    put_coefficients(&mut whole.model, &phased, &values);
    whole.weighed.powers = powers;
    whole
}

/// The equations of every run around a set, its free speed the run's own as far as gains scatter, beside the noise of sampling.
struct Beside {
    runs: Vec<Normal>,
    noise: Noise,
    pairs: usize,
}

impl Beside {
    fn of(ground: &Ground, set: &Set, phased: &[Phased]) -> Self {
        let noise = ground.noise_of_sampling(set);
        let mut columns = columns_of(&ground.free(&set.model, &set.parts)[..1]);
        columns.extend(phased.iter().flat_map(|p| p.columns()));
        let designs = ground.problem.design(&set.model, &columns);
        let now = coefficients(&set.model, phased);
        let of = |(design, own): (&RunDesign, &Vec<f64>)| equations(design, 1, own).without_gain(0, noise);
        let runs = designs.iter().zip(&now).map(of).collect();
        Self { runs, noise, pairs: phased.len() }
    }

    /// The power of each pair in the runs `of`.
    fn powers(&self, of: &[usize]) -> Vec<f64> {
        let runs: Vec<Normal> = of.iter().map(|k| self.runs[*k].clone()).collect();
        let mut power = vec![FIRST_POWER; self.pairs];
        for _ in 0..ROUNDS {
            let next = expected_power(&runs, 1, &power, self.noise.variance);
            let settled = next.iter().zip(&power).all(|(to, from)| (to - from).abs() < SETTLED * from);
            power = next;
            if settled {
                break;
            }
        }
        power
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::library::library;
    use crate::observe::shorten;
    use crate::set::Part;
    use crate::{Options, starting_rotor, trial};
    use std::f64::consts::TAU;

    /// Runs of two turns that are 5 % faster on one side, beside a wander that nothing explains. Fails if their coefficients stay as far behind as the
    /// wander, taken for an error of forms, holds them; or if their power is not that of what they are.
    #[test]
    fn a_rhythm_beside_what_nothing_explains_is_as_large_as_it_is() {
        let slow = |k: usize, t: f64| 0.05 * (TAU * t / 0.5 - 2.3 * k as f64).sin();
        let runs = trial::runs(&|k, _, t, angle| 0.05 * (angle - 1.7 * k as f64).cos() + slow(k, t));
        let rotor = starting_rotor(&runs, &Options::default());
        let problem = Problem::new(runs).widened();
        let effects = library(&[], &[]);
        let ground = Ground::new(&problem, rotor.clone(), &effects, Vec::new());
        let root = ground.root(problem.model(rotor));
        let part = Part { effect: 0, form: 0, free: Vec::new(), phased: vec![Phased::Runout(0)] };
        let model = ground.refitted(root.model.clone(), std::slice::from_ref(&part), ground.scatter(&root), 8);
        let set = ground.weigh_set(vec![part], model, Some(&root));
        let whole = whole(&ground, &set);
        let amplitudes = |set: &Set| -> Vec<f64> {
            coefficients(&set.model, &[Phased::Runout(0)]).iter().map(|z| z[0].hypot(z[1])).collect()
        };
        assert!(amplitudes(&set).iter().all(|a| *a < 0.045), "held back: {:?}", amplitudes(&set));
        assert!(amplitudes(&whole).iter().all(|a| (a - 0.05).abs() < 0.001), "{:?}", amplitudes(&whole));
        assert!(((2.0 * whole.weighed.powers[0]).sqrt() - 0.05).abs() < 0.001, "{:?}", whole.weighed.powers);
    }

    /// Fails if a run of less than a turn says how large a rhythm is beside others of two, by coefficients that are held back; or if none does where
    /// all are short.
    #[test]
    fn short_runs_say_how_large_a_rhythm_is_where_there_are_no_others() {
        let mut runs = trial::runs(&|_, _, _, _| 0.0);
        shorten(&mut runs[..1], 0.5);
        assert_eq!(shown_by(&Problem::new(runs.clone())), [1, 2, 3, 4, 5, 6, 7]);
        shorten(&mut runs, 0.5);
        assert_eq!(shown_by(&Problem::new(runs)).len(), 8);
    }
}
