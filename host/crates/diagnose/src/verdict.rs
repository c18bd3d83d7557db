//! The verdict: one function from the sets that were visited to what may be said.
//!
//! Every number that decides is here, with its reason; what the evidence itself rests on is in [`super::evidence`],
//! [`super::level`], [`super::search`] and the priors of the library.

use super::level::NAMES;
use super::search::Set;

/// Least probability of a name: one wrong in twenty is what a person can live with.
pub const NAMED: f64 = 0.95;
/// Least probability with which an effect is still mentioned as a rival.
pub const POSSIBLE: f64 = 0.05;
/// By how much the evidence overstates: with a third of the lead, 0.95 is 8.8 nats. On the generators that may be used for choosing six
/// of the thirteen effects that led by 5 to 9 nats were not there; nothing that was there led by 9 to 13.
pub const TEMPERATURE: f64 = 3.0;
/// The same of closed loops, three records that each see everything at once: 0.95 is 18 nats. What was not there led by up to 15; what
/// was there led by 40 and more, but for one load (9) and what looks like another.
pub const CLOSED_TEMPERATURE: f64 = 6.0;
/// Nats by which one of two effects that look alike has to lead: they differ by their form alone, and on the generators that may be used
/// for choosing the wrong one led by up to 37.
pub const ALIKE: f64 = 40.0;
/// Share of all that is removed that a term without physics may remove beside a cause: more, and the cause is not what there is to see.
const MOST_BESIDE: f64 = 0.4;
/// Share of what is left that runs may take with courses of their own over time or angle where nothing is hidden: the sampling of edges has
/// none; discs, recorders and starting took an eighth at most in 19 of 20 motors without an effect.
const MOST_OF_A_COURSE: f64 = 0.15;
/// Nats that a spread of gains over duty, direction or order may cost against what is believed of it: beyond, something moves the gains
/// that no effect of the set explains. 3.3 deviations, one in a thousand.
const LARGEST_SPREAD: f64 = 5.5;
/// Smallest held-out gain of what is found outside the evidence (lost samples, the controller, an ordinary motor).
pub const LEAST_GAIN: f64 = 0.05;
/// Largest p-value of the same.
pub const LARGEST_P: f64 = 0.01;

/// What may be said.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// Effects with their probability, likeliest first; those below [`POSSIBLE`] left out.
    pub inclusion: Vec<(usize, f64)>,
    /// Effects to name.
    pub named: Vec<usize>,
    /// The smallest set of which one is there, where none of them is certain.
    pub one_of: Vec<usize>,
    /// Where something lives that no effect explains, strongest first, with the share of all removed squared error that it removes.
    pub lives_in: Vec<(&'static str, f64)>,
    /// Whether what lives there is more than may stay beside a cause.
    pub withheld: bool,
}

/// Judges the visited sets, best first. `root` is the set without effects, `temperature` what leads are divided by; `alike` says which
/// effects do the same to the data but for their form.
pub fn judge(
    sets: &[Set],
    root: &Set,
    temperature: f64,
    alike: &dyn Fn(usize, usize) -> bool,
    log_prior_of_spread: &dyn Fn(usize, f64) -> f64,
) -> Judgement {
    let best = &sets[0];
    let weights: Vec<f64> = sets.iter().map(|s| ((s.score - best.score) / temperature).exp()).collect();
    let total: f64 = weights.iter().sum();
    let probability = |holds: &dyn Fn(&Set) -> bool| -> f64 {
        sets.iter().zip(&weights).filter(|(s, _)| holds(s)).map(|(_, w)| w).sum::<f64>() / total
    };
    let mut effects: Vec<usize> = sets.iter().flat_map(Set::key).collect();
    effects.sort_unstable();
    effects.dedup();
    let mut inclusion: Vec<(usize, f64)> = effects
        .into_iter()
        .map(|e| (e, probability(&|s| s.key().contains(&e))))
        .filter(|(_, p)| *p >= POSSIBLE)
        .collect();
    inclusion.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut named: Vec<usize> = inclusion.iter().filter(|(_, p)| *p >= NAMED).map(|(e, _)| *e).collect();
    let mut one_of: Vec<usize> = Vec::new();
    for (e, _) in inclusion.iter().filter(|(_, p)| *p < NAMED) {
        one_of.push(*e);
        if probability(&|s| s.key().iter().any(|k| one_of.contains(k))) >= NAMED {
            break;
        }
    }
    if probability(&|s| s.key().iter().any(|k| one_of.contains(k))) < NAMED {
        one_of.clear();
    }
    // What looks alike and is behind by no more than forms differ is a rival, whatever the probabilities.
    let rivals: Vec<(usize, usize)> = named
        .iter()
        .flat_map(|e| {
            sets.iter()
                .filter(|s| s.score > best.score - ALIKE && !s.key().contains(e))
                .flat_map(Set::key)
                .map(move |r| (*e, r))
        })
        .filter(|(e, r)| e != r && alike(*e, *r) && !named.contains(r))
        .collect();
    for (effect, rival) in rivals {
        named.retain(|e| *e != effect);
        for e in [effect, rival] {
            if !one_of.contains(&e) {
                one_of.push(e);
            }
            if !inclusion.iter().any(|(i, _)| *i == e) {
                inclusion.push((e, probability(&|s| s.key().contains(&e))));
            }
        }
    }
    let after = best.terms.last().map_or(best.weighed.left, |t| t.1);
    let removed = (root.weighed.left - after).max(1e-12);
    let mut before = best.weighed.left;
    let mut lives_in = Vec::new();
    for (place, left) in &best.terms {
        lives_in.push((*place, ((before - left) / removed).clamp(0.0, 1.0)));
        before = *left;
    }
    for (k, name) in NAMES.iter().enumerate() {
        if log_prior_of_spread(k, best.weighed.taus[k]) < -LARGEST_SPREAD && best.weighed.taus[k] > 0.01 {
            lives_in.push((name, 0.0));
        }
    }
    if named.is_empty() && one_of.is_empty() && lives_in.is_empty() {
        let course = best.courses.iter().max_by(|a, b| a.1.total_cmp(&b.1));
        lives_in.extend(course.filter(|c| c.1 > MOST_OF_A_COURSE).copied());
    }
    let beside: f64 = lives_in.iter().map(|l| l.1).sum();
    // A cause that makes the runs differ by more than they did is none.
    let worse = (1..NAMES.len()).any(|k| {
        log_prior_of_spread(k, best.weighed.taus[k]) < -LARGEST_SPREAD && best.weighed.taus[k] > root.weighed.taus[k]
    });
    let withheld = beside > MOST_BESIDE || worse && !named.is_empty();
    if withheld {
        named.clear();
        one_of.clear();
    }
    Judgement { inclusion, named, one_of, lives_in, withheld }
}
