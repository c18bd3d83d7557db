//! What a refitted set weighs: its evidence, its priors, what effects cost, and the terms without physics that the data ask for beside it.

use super::amplitude::of_one_amplitude;
use super::baseline::first_covariance;
use super::design::{Basis, Column};
use super::discrepancy::{FREE_FORM_COST, SIZE, TERM_COST, Term};
use super::evidence::{Equations, Promise, Question, Spreads, Start, Weighed, weigh};
use super::ground::Ground;
use super::library::Phased;
use super::observe::Observed;
use super::problem::Model;
use super::refit::coefficients;
use super::set::{Part, Set, phased_of};
use super::verdict::Course;
use rayon::prelude::*;
use std::ops::Range;

/// What an effect costs before the data, in nats: one in twenty effects is there.
pub(super) const EFFECT_COST: f64 = 3.0;
/// What a second effect over the same coordinate costs besides: the difference between the library's form of one and the real one lies
/// there too.
pub(super) const SAME_COORDINATE: f64 = 10.0;
/// Relative error of speed from which a wheel is no wheel: it would read motion out of its own error.
const MOST_OF_A_WHEEL: f64 = 0.7;
/// The same of a runout: the wave would stand still, or turn back, within every turn.
const MOST_RUNOUT: f64 = 1.0;
/// Power of the third harmonic and beyond over that of the first two: half of the amplitude is once or twice a turn.
const MOST_BEYOND_TWICE: f64 = 4.0;
/// A plausible amplitude of what goes with the angle (relative, or rad), and its log deviation.
const AMPLITUDE: (f64, f64) = (0.08, 1.2);

impl Ground<'_> {
    /// The refitted baseline, weighed.
    pub fn root(&self, baseline: Model) -> Set {
        self.weigh_set(Vec::new(), baseline, None)
    }

    /// Weighs a refitted set; `root` is the set without effects.
    pub(super) fn weigh_set(&self, parts: Vec<Part>, model: Model, root: Option<&Set>) -> Set {
        let (mut columns, base) = self.columns(&model, &parts);
        let own_columns = base.own_range();
        let at: Vec<std::ops::Range<usize>> = self
            .terms
            .iter()
            .map(|t| {
                let from = columns.len();
                columns.extend(t.columns.iter().cloned());
                from..columns.len()
            })
            .collect();
        let speed = columns.len();
        columns.push(Column::Flexible(Basis::Time(0, 1)));
        let phased = phased_of(&parts);
        let designs = self.problem.design(&model, &columns);
        let equations = Equations::new(&designs, own_columns, &coefficients(&model, &phased));
        let without = root.map_or(0.0, |r| self.form_error.base(r.weighed.left));
        let start = Start {
            variance: root.map_or_else(
                || first_covariance(self.problem, &model, self.independent).variance,
                |r| r.weighed.variance,
            ),
            taus: self.level.believed(),
            without,
            spreads: Spreads::Anywhere,
        };
        let scale = Scale { ground: self, equations, base, at, speed };
        let failed = || Weighed {
            log: f64::NEG_INFINITY,
            left: f64::INFINITY,
            variance: start.variance,
            taus: start.taus,
            belief: [0.0; 5],
            gains: vec![0.0; self.problem.runs.len()],
            shared: Vec::new(),
            powers: Vec::new(),
        };
        let mut weighed = weigh(&scale.equations, &self.level, &scale.base, &start).unwrap_or_else(failed);
        if let Some(r) = root {
            let level = self.level.beside_a_shift(explained(&weighed.gains, &r.weighed.gains));
            let near = Start { taus: weighed.taus, spreads: Spreads::Near, ..start.clone() };
            weighed = weigh(&scale.equations, &level, &scale.base, &near).unwrap_or_else(failed);
        }
        let beside = scale.terms(&weighed, without);
        let speeds = scale.equations.squared_speeds();
        let gains = || weighed.gains.iter().zip(&speeds).enumerate();
        let removed = |(i, (gain, square)): (usize, (&f64, &f64))| {
            root.map_or(0.0, |r| (gain - r.weighed.gains[i]).powi(2) * square)
        };
        let scattered = std::array::from_fn(|k| {
            gains().map(|(i, (gain, square))| gain * gain * square * self.level.share(&weighed.taus, k, i)).sum()
        });
        let by_gains = gains().map(removed).sum();
        let prior = self.log_prior(&model, &parts);
        let amplitude: f64 = weighed
            .powers
            .iter()
            .map(|p| -0.5 * (((2.0 * p).sqrt() / AMPLITUDE.0).ln() / AMPLITUDE.1).powi(2))
            .sum::<f64>();
        let amplitude = if admissible(&parts, &weighed.powers) { amplitude } else { f64::NEG_INFINITY };
        let ways: f64 = parts.iter().map(|p| (self.effects[p.effect].ways() as f64).ln()).sum();
        let coordinates: std::collections::BTreeSet<_> =
            parts.iter().map(|p| self.effects[p.effect].coordinate as u8).collect();
        let shared = (parts.len() - coordinates.len()) as f64;
        let same = of_one_amplitude(&scale.equations.runs, &scale.base, &weighed);
        let costs = EFFECT_COST * parts.len() as f64 + SAME_COORDINATE * shared + ways;
        let score = beside.log + same + prior + amplitude - costs;
        Set {
            parts,
            model,
            score,
            weighed,
            terms: beside.left,
            courses: beside.courses,
            by_gains,
            scattered,
            expanded: false,
        }
    }

    fn term_cost(&self, term: usize) -> f64 {
        let over = |e: &usize| self.terms[term].coordinates.contains(&self.effects[*e].coordinate);
        let cost = if self.usable.iter().any(over) { FREE_FORM_COST } else { TERM_COST };
        cost + (self.terms[term].among as f64).ln()
    }
}

/// By how much the gains of all runs are nearer to none than `without` the effects (root mean square): a shift that explains nothing of them is an
/// error of the effects' own.
fn explained(with: &[f64], without: &[f64]) -> f64 {
    let squares: f64 = with.iter().zip(without).map(|(with, without)| without * without - with * with).sum();
    (squares.max(0.0) / with.len().max(1) as f64).sqrt()
}

/// Whether what goes with the angle goes with it once or twice a turn in earnest, as speed, where it does so more often too: a rhythm of the
/// third harmonic and beyond is another cause (poles, teeth, a contact of many points). `powers` are of the pairs of all parts, one after the other.
fn admissible(parts: &[Part], powers: &[f64]) -> bool {
    let mut powers = powers.iter();
    parts.iter().all(|part| {
        // Squared amplitudes of the relative speed: a wheel's error is an angle.
        let square = |(p, power): (&Phased, &f64)| match p {
            Phased::Eccentricity(h) => (*h, ((h + 1) as f64).powi(2) * 2.0 * power),
            Phased::Runout(h) => (*h, 2.0 * power),
            Phased::Gravity => (0, 0.0),
        };
        let squares: Vec<(usize, f64)> = part.phased.iter().zip(powers.by_ref()).map(square).collect();
        let wheel = part.phased.iter().any(|p| matches!(p, Phased::Eccentricity(_)));
        let of_the_speed: f64 = squares.iter().map(|s| s.1.sqrt()).sum();
        let sum = |beyond: bool| squares.iter().filter(|s| (s.0 >= 2) == beyond).map(|s| s.1).sum::<f64>();
        sum(true) <= MOST_BEYOND_TWICE * sum(false) && of_the_speed < if wheel { MOST_OF_A_WHEEL } else { MOST_RUNOUT }
    })
}

/// A set's equations, with the columns of every term without physics in them.
struct Scale<'g> {
    ground: &'g Ground<'g>,
    equations: Equations,
    base: Question,
    /// Columns of each term.
    at: Vec<Range<usize>>,
    /// The column of the speed itself.
    speed: usize,
}

/// What terms without physics do beside a set.
struct Beside {
    /// Log evidence with those that were chosen, less their costs.
    log: f64,
    /// Those, strongest first, with the squared error that is then left.
    left: Vec<(&'static str, f64)>,
    /// Courses of the runs' own, the strongest first.
    courses: Vec<Course>,
}

impl Scale<'_> {
    /// What is asked of the set with some of the terms.
    fn question(&self, terms: &[usize]) -> Question {
        let mut q = self.base.clone();
        for t in terms {
            if self.ground.terms[*t].own {
                // Each harmonic has a power of its own; the knots of a wander share one.
                let group = q.own.iter().map(|o| o.1 + 1).max().unwrap_or(0);
                let pair = |i: usize| if self.ground.terms[*t].harmonic { i / 2 } else { 0 };
                q.own.extend(self.at[*t].clone().enumerate().map(|(i, c)| (c, group + pair(i))));
            } else {
                let sd = if self.ground.terms[*t].lives_in == "timing against the PWM" { 1.0 } else { SIZE };
                q.common.extend(self.at[*t].clone().map(|c| (c, sd)));
            }
        }
        q
    }

    /// The terms that the data ask for, one after the other, at the spreads that the gains have without them.
    fn terms(&self, weighed: &Weighed, without: f64) -> Beside {
        let without = without.max(weighed.left);
        let near = Start { variance: weighed.variance, taus: weighed.taus, without, spreads: Spreads::Stay };
        let mut chosen: Vec<usize> = Vec::new();
        let mut now = weighed.clone();
        let mut best = weighed.log;
        let mut left = Vec::new();
        for _ in 0..2 {
            let cost: f64 = chosen.iter().map(|c| self.ground.term_cost(*c)).sum();
            let before = self.question(&chosen);
            let level = &self.ground.level;
            let promise = Promise::new(&self.equations, level, &before, &now, without);
            let look = |t: usize| {
                let more = self.question(&[chosen.as_slice(), &[t]].concat());
                let worth_it = promise.of(&more) > self.ground.term_cost(t);
                let weighed = worth_it.then(|| weigh(&self.equations, level, &more, &near)).flatten()?;
                Some((t, weighed.log - cost - self.ground.term_cost(t), weighed))
            };
            let open = (0..self.ground.terms.len()).into_par_iter().filter(|t| !chosen.contains(t));
            let looks: Vec<(usize, f64, Weighed)> = open.filter_map(look).collect();
            let Some((t, log, with)) = looks.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)) else { break };
            if log <= best {
                break;
            }
            best = log;
            chosen.push(t);
            left.push((self.ground.terms[t].lives_in, with.left));
            now = with;
        }
        Beside { log: best, left, courses: self.courses() }
    }

    /// What terms of the runs' own would take, the strongest first.
    fn courses(&self) -> Vec<Course> {
        // A free speed of the run's own leaves its pulses as steep as they were: a gain of its own changes all of it.
        let with: Vec<usize> = std::iter::once(self.speed).chain(self.base.own.iter().map(|o| o.0)).collect();
        let apart = self.ground.problem.runs.iter().map(Observed::apart).sum();
        let of = |(term, at): (&Term, &Range<usize>)| {
            let [taken, before] = self.equations.course(&with, at.clone(), apart);
            let share = taken / (before + self.equations.floor()).max(1e-12);
            Course { lives_in: term.lives_in, taken, share }
        };
        let own = self.ground.terms.iter().zip(&self.at).filter(|(term, _)| term.own);
        let mut courses: Vec<Course> = own.map(of).collect();
        courses.sort_by(|a, b| b.share.total_cmp(&a.share));
        courses
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(phased: Vec<Phased>) -> [Part; 1] {
        [Part { effect: 0, form: 0, free: Vec::new(), phased }]
    }

    /// Fails if gains that an effect puts where there were none make room for as much that it does not explain.
    #[test]
    fn what_an_effect_puts_into_the_gains_explains_nothing() {
        assert_eq!(explained(&[0.1, -0.1], &[0.0, 0.0]), 0.0);
        assert!((explained(&[0.0, 0.0], &[0.1, -0.1]) - 0.1).abs() < 1e-12);
        assert_eq!(explained(&[0.1, -0.1], &[-0.1, 0.1]), 0.0);
    }

    /// Relative speeds of 1 to 5 % at one to four times a turn. Fails if a wheel is asked something else than the runout that is seen as the same
    /// speed: then its twin was refused, and the wheel named in its place (`hide_any --generator c --effect preload-runout --rho 2 --seed 21001`).
    #[test]
    fn a_wheel_and_a_runout_of_the_same_speed_are_as_admissible() {
        for speeds in
            [[0.05, 0.03, 0.02, 0.01], [0.01, 0.02, 0.05, 0.05], [0.02, 0.02, 0.03, 0.03], [0.0, 0.02, 0.03, 0.02]]
        {
            let runout = part((0..4).map(Phased::Runout).collect());
            let wheel = part((0..4).map(Phased::Eccentricity).collect());
            let power = |speed: f64| 0.5 * speed * speed;
            let of_runout = speeds.map(power);
            let of_wheel: [f64; 4] = std::array::from_fn(|h| power(speeds[h] / (h + 1) as f64));
            assert_eq!(admissible(&runout, &of_runout), admissible(&wheel, &of_wheel), "{speeds:?}");
        }
    }

    /// Fails if teeth are a runout, or if a runout must have the most at one and two times a turn.
    #[test]
    fn a_runout_is_there_once_or_twice_a_turn() {
        let of =
            |speeds: [f64; 4]| admissible(&part((0..4).map(Phased::Runout).collect()), &speeds.map(|s| 0.5 * s * s));
        assert!(of([0.02, 0.02, 0.03, 0.03]));
        assert!(!of([0.005, 0.005, 0.05, 0.01]));
    }
}
