//! The verdict: one function from the sets that were visited to what may be said.
//!
//! Every number that decides is here, with its reason; what the evidence itself rests on is in [`super::evidence`],
//! [`super::level`], [`super::search`] and the priors of the library.

use super::evidence::MODEL_FLOOR;
use super::level::{LARGEST_SPREAD, NAMES, Taus};

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
/// for choosing the wrong one led by up to 37. So has one beside the other.
pub const ALIKE: f64 = 40.0;
/// Share of all that is removed that a term without physics may remove beside a cause: more, and the cause is not what there is to see.
pub const MOST_BESIDE: f64 = 0.4;
/// Share of what is within runs that they may take, beyond chance, with courses of their own over time or angle where nothing is hidden:
/// the sampling of edges has none. In 30 motors without an effect it was 0.032 at most (generators B, C and D).
pub const MOST_OF_A_COURSE: f64 = 0.05;
/// Share of what the strongest course takes from which the course of an effect is what there is to see: one over the time bends where it likes,
/// so that it takes what one over the angle takes, and a little more by chance.
pub const SAME_COURSE: f64 = 0.9;
/// Smallest held-out gain of what is found outside the evidence (lost samples, the controller, an ordinary motor), and of what makes an answer
/// `unknown` by itself: of eight motors without an effect that were `unknown` six had less, of 59 with something outside the library two. Ordinary
/// motors' effects, and lost samples as long as no cause is known, may bring less where the gain's interval speaks for them.
pub const LEAST_GAIN: f64 = 0.05;
/// Largest p-value of the same.
pub const LARGEST_P: f64 = 0.01;

/// What the verdict knows of a set of effects that was visited, whatever plant it belongs to.
#[derive(Debug, Clone, PartialEq)]
pub struct Visited {
    /// Indices of its effects, sorted.
    pub key: Vec<usize>,
    /// Log evidence with costs and priors.
    pub score: f64,
    /// Squared error that is left.
    pub left: f64,
    /// Spreads of the gains.
    pub taus: Taus,
    /// Log prior of each, beside what the effects have moved.
    pub belief: Taus,
    /// Terms without physics that the data ask for beside it, strongest first, with the squared error that is then left.
    pub terms: Vec<(&'static str, f64)>,
    /// Share of the squared error left that a course of each run's own would take, by the term's name.
    pub courses: Vec<Course>,
    /// Squared error in rpm²·s that the effects remove by moving the gains of the runs, which is not in `left`.
    pub by_gains: f64,
    /// Squared error in rpm²·s that the gains take up, by what they scatter with.
    pub scattered: Taus,
}

/// What a course of each run's own would take beside a set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Course {
    /// The term's coordinate, in words.
    pub lives_in: &'static str,
    /// Squared error that it would take beyond chance, in rpm²·s.
    pub taken: f64,
    /// The same as a share of what there is within runs.
    pub share: f64,
}

/// What may be said.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// Effects with their probability, likeliest first; those below [`POSSIBLE`] left out.
    pub inclusion: Vec<(usize, f64)>,
    /// Effects to name.
    pub named: Vec<usize>,
    /// The smallest sets of each of which one is there, where none of its effects is certain.
    pub one_of: Vec<Vec<usize>>,
    /// The one of them that is said for the courses of single runs, which are beyond chance by themselves; empty if none is.
    pub of_course: Vec<usize>,
    /// Where something lives that no effect explains, strongest first, with the share of all removed squared error that it removes.
    pub lives_in: Vec<(&'static str, f64)>,
    /// Whether what lives there is more than may stay beside a cause.
    pub withheld: bool,
}

impl Judgement {
    /// The best of the sets, best first, that holds every named effect, one of each set of rivals, and nothing else but what is `free`;
    /// where none holds all, most of them. `None` where every set holds something else.
    pub fn accepted<'a, S>(
        &self,
        sets: &'a [S],
        key: impl Fn(&S) -> Vec<usize>,
        free: impl Fn(usize) -> bool,
    ) -> Option<&'a S> {
        let said = |e: &usize| free(*e) || self.says(*e);
        let holds = |s: &S| {
            let key = key(s);
            let named = self.named.iter().filter(|e| key.contains(e)).count();
            named + self.one_of.iter().filter(|set| key.iter().any(|e| set.contains(e))).count()
        };
        let of_said = sets.iter().filter(|s| key(s).iter().all(said));
        // The first of equals is the best.
        of_said.reduce(|best, s| if holds(s) > holds(best) { s } else { best })
    }

    /// Whether an effect is named, or one of a set of rivals.
    pub fn says(&self, effect: usize) -> bool {
        self.named.contains(&effect) || self.set_of(effect).is_some()
    }

    /// The set of rivals that an effect is in.
    pub fn set_of(&self, effect: usize) -> Option<&Vec<usize>> {
        self.one_of.iter().find(|set| set.contains(&effect))
    }
}

/// What the verdict has to know of the effects and the runs.
pub struct Background<'a> {
    /// What leads are divided by.
    pub temperature: f64,
    /// Whether two effects do the same to the data but for their form.
    pub alike: &'a dyn Fn(usize, usize) -> bool,
    /// Nats by which one of two such effects has to lead.
    pub clear_lead: f64,
    /// Share of what is within runs that courses of their own may take where nothing is found.
    pub most_of_a_course: f64,
    /// Whether all that an effect does, it does within a run.
    pub within_runs: &'a dyn Fn(usize) -> bool,
    /// Whether an effect is what a course of each run's own over this coordinate would be.
    pub makes_course: &'a dyn Fn(usize, &str) -> bool,
}

/// The visited sets with their probabilities.
struct Weighted<'a> {
    sets: &'a [Visited],
    weights: Vec<f64>,
}

impl<'a> Weighted<'a> {
    fn new(sets: &'a [Visited], temperature: f64) -> Self {
        let weights: Vec<f64> = sets.iter().map(|s| ((s.score - sets[0].score) / temperature).exp()).collect();
        let total: f64 = weights.iter().sum();
        Self { sets, weights: weights.into_iter().map(|w| w / total).collect() }
    }

    /// The probability that one of these is there.
    fn any(&self, of: &[usize]) -> f64 {
        let holds = |s: &&Visited| s.key.iter().any(|e| of.contains(e));
        self.sets.iter().zip(&self.weights).filter(|(s, _)| holds(s)).map(|(_, w)| w).sum()
    }

    /// The smallest set among these, likeliest first, of which one is there; empty if that is not certain.
    fn smallest(&self, among: &[usize]) -> Vec<usize> {
        let mut set = among.to_vec();
        if self.any(&set) < NAMED {
            return Vec::new();
        }
        for e in among.iter().rev() {
            let without: Vec<usize> = set.iter().copied().filter(|k| k != e).collect();
            if self.any(&without) >= NAMED {
                set = without;
            }
        }
        set
    }
}

/// Judges the visited sets, best first. `root` is the set without effects.
pub fn judge(sets: &[Visited], root: &Visited, background: &Background) -> Judgement {
    let weighted = Weighted::new(sets, background.temperature);
    let mut effects: Vec<usize> = sets.iter().flat_map(|s| s.key.iter().copied()).collect();
    effects.sort_unstable();
    effects.dedup();
    let of = |e: usize| (e, weighted.any(&[e]));
    let mut inclusion: Vec<(usize, f64)> = effects.into_iter().map(of).filter(|(_, p)| *p >= POSSIBLE).collect();
    inclusion.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut named: Vec<usize> = inclusion.iter().filter(|(_, p)| *p >= NAMED).map(|(e, _)| *e).collect();
    let mut one_of = sets_of_rivals(&weighted, &inclusion, background.alike);
    for (effect, rival) in close_rivals(sets, &named, background) {
        named.retain(|e| *e != effect);
        let at = one_of.iter().position(|set| set.contains(&effect) || set.contains(&rival)).unwrap_or_else(|| {
            one_of.push(Vec::new());
            one_of.len() - 1
        });
        for e in [effect, rival] {
            if !one_of[at].contains(&e) {
                one_of[at].push(e);
            }
            if !inclusion.iter().any(|(i, _)| *i == e) {
                inclusion.push(of(e));
            }
        }
    }
    for effect in forms_of_others(sets, &named, background) {
        named.retain(|e| *e != effect);
        one_of.push(vec![effect]);
    }
    let nothing_yet = named.is_empty() && one_of.is_empty();
    let of_course = if nothing_yet { course_of_effects(sets, background) } else { Vec::new() };
    one_of.extend((!of_course.is_empty()).then(|| of_course.clone()));
    let causes: Vec<usize> = named.iter().chain(one_of.iter().flatten()).copied().collect();
    let best = sets.iter().find(|s| of_course.iter().any(|e| s.key == [*e])).unwrap_or(&sets[0]);
    let mut lives_in = left_without_cause(best, root, &causes, background);
    let spreads = beyond_belief(root);
    if causes.is_empty() && best.terms.is_empty() && beyond_belief(best).is_empty() && !spreads.is_empty() {
        // What the best set explains is not explained where nothing of it is said, and is more than courses of single runs.
        let all = spreads.iter().map(|s| s.1).sum::<f64>().max(f64::MIN_POSITIVE);
        lives_in = spreads.into_iter().map(|(name, square)| (name, square / all)).collect();
    }
    let beside: f64 = lives_in.iter().map(|l| l.1).sum();
    // A cause that makes the runs differ by more than they did is none.
    let Visited { taus, belief, .. } = &sets[0];
    let spread = (1..NAMES.len()).any(|k| belief[k] < -LARGEST_SPREAD && taus[k] > root.taus[k]);
    let all = |set: &Visited| set.scattered.iter().sum::<f64>();
    let worse = spread && all(&sets[0]) > all(root);
    let withheld = beside > MOST_BESIDE || worse && !named.is_empty();
    if withheld {
        named.clear();
        one_of.clear();
    }
    Judgement { inclusion, named, one_of, of_course, lives_in, withheld }
}

/// Sets of which one is there: first of effects that look alike, then of what is left.
fn sets_of_rivals(
    weighted: &Weighted,
    inclusion: &[(usize, f64)],
    alike: &dyn Fn(usize, usize) -> bool,
) -> Vec<Vec<usize>> {
    let mut open: Vec<usize> = inclusion.iter().filter(|(_, p)| *p < NAMED).map(|(e, _)| *e).collect();
    let mut found = Vec::new();
    for effect in open.clone() {
        let kind: Vec<usize> = open.iter().copied().filter(|e| *e == effect || alike(*e, effect)).collect();
        let set = weighted.smallest(&kind);
        if open.contains(&effect) && !set.is_empty() {
            open.retain(|e| !kind.contains(e));
            found.push(set);
        }
    }
    let rest = weighted.smallest(&open);
    found.extend((!rest.is_empty()).then_some(rest));
    found
}

/// Where the runs have courses of their own that nothing explains, the effects that have such courses, likeliest first: the phase of each run
/// costs the evidence of an effect more than these courses leave in doubt.
fn course_of_effects(sets: &[Visited], background: &Background) -> Vec<usize> {
    let beyond_chance = sets[0].courses.first().is_some_and(|c| c.share > background.most_of_a_course);
    if !sets[0].terms.is_empty() || !beyond_chance {
        return Vec::new();
    }
    let alone: Vec<usize> = sets.iter().filter(|s| s.key.len() == 1 && s.score.is_finite()).map(|s| s.key[0]).collect();
    makers_of(&sets[0].courses, &alone, background)
}

/// Those of the effects that make the course that there is to see.
fn makers_of(courses: &[Course], effects: &[usize], background: &Background) -> Vec<usize> {
    let strongest = courses.first().map_or(0.0, |c| c.share);
    let same = courses.iter().take_while(|c| c.share >= SAME_COURSE * strongest);
    let makers = |c: &Course| effects.iter().copied().filter(|e| (background.makes_course)(*e, c.lives_in)).collect();
    same.map(makers).find(|makers: &Vec<usize>| !makers.is_empty()).unwrap_or_default()
}

/// Named effects with what looks like them in the best set without them that has any, where it is behind by no more than forms differ: rivals,
/// whatever the probabilities. What does better beside an effect than without it is not there in its place; where there is nothing else, the effect
/// has no rival but is not certain.
fn close_rivals(sets: &[Visited], named: &[usize], background: &Background) -> Vec<(usize, usize)> {
    let instead = |e: usize| {
        let near = |s: &&Visited| s.score > sets[0].score - background.clear_lead && !s.key.contains(&e);
        let rivals = |s: &Visited| {
            let alike = |o: &usize| !named.contains(o) && (background.alike)(e, *o);
            let both = |o: &usize| sets.iter().any(|t| t.score > s.score && t.key.contains(&e) && t.key.contains(o));
            let alike: Vec<usize> = s.key.iter().copied().filter(alike).collect();
            let mut rivals: Vec<usize> = alike.iter().copied().filter(|o| !both(o)).collect();
            rivals.extend((rivals.is_empty() && !alike.is_empty()).then_some(e));
            rivals.into_iter().map(|rival| (e, rival)).collect::<Vec<_>>()
        };
        sets.iter().filter(near).map(rivals).find(|rivals| !rivals.is_empty()).unwrap_or_default()
    };
    named.iter().flat_map(|e| instead(*e)).collect()
}

/// Named effects without which others that look like them, named beside them, are behind by no more than forms differ: what they explain may be a
/// matter of those others' forms.
fn forms_of_others(sets: &[Visited], named: &[usize], background: &Background) -> Vec<usize> {
    let leads_little = |e: usize| {
        let near = |s: &&Visited| s.score > sets[0].score - background.clear_lead && !s.key.contains(&e);
        let like_it = |f: &usize| *f != e && named.contains(f) && (background.alike)(e, *f);
        sets.iter().filter(near).any(|s| s.key.iter().any(like_it))
    };
    named.iter().copied().filter(|e| leads_little(*e)).collect()
}

/// What whole runs differ by beyond what is believed of it and of any equation, with its squared error.
fn beyond_belief(set: &Visited) -> Vec<(&'static str, f64)> {
    let beyond = |k: &usize| set.belief[*k] < -LARGEST_SPREAD && set.taus[*k] > MODEL_FLOOR;
    (0..NAMES.len()).filter(beyond).map(|k| (NAMES[k], set.scattered[k])).collect()
}

/// Where something lives that the causes do not explain, with the share of all removed squared error that it would remove.
fn left_without_cause(
    best: &Visited,
    root: &Visited,
    causes: &[usize],
    background: &Background,
) -> Vec<(&'static str, f64)> {
    let after = best.terms.last().map_or(best.left, |t| t.1);
    let spreads = beyond_belief(best);
    let by_spreads: f64 = spreads.iter().map(|s| s.1).sum();
    let removed = (root.left - after + best.by_gains + by_spreads).max(1e-12);
    let mut before = best.left;
    let mut lives_in = Vec::new();
    for (place, left) in &best.terms {
        lives_in.push((*place, ((before - left) / removed).clamp(0.0, 1.0)));
        before = *left;
    }
    lives_in.extend(spreads.into_iter().map(|(name, square)| (name, square / removed)));
    lives_in.sort_by(|a, b| b.1.total_cmp(&a.1));
    if !lives_in.is_empty() {
        return lives_in;
    }
    let Some(course) = best.courses.first() else { return lives_in };
    if !makers_of(&best.courses, causes, background).is_empty() {
        // What is left over their own coordinate is a matter of their form.
        return lives_in;
    }
    if causes.is_empty() {
        lives_in.extend((course.share > background.most_of_a_course).then_some((course.lives_in, course.share)));
    } else if causes.iter().all(|e| (background.within_runs)(*e)) {
        // What causes over the runs remove, gains that differ had taken already: nothing can be held against it.
        let share = course.taken / removed;
        lives_in.extend((share > MOST_BESIDE).then_some((course.lives_in, share)));
    }
    lives_in
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(effects: &[usize], score: f64, left: f64) -> Visited {
        Visited {
            key: effects.to_vec(),
            score,
            left,
            taus: [0.01; 5],
            belief: [0.0; 5],
            terms: Vec::new(),
            courses: Vec::new(),
            by_gains: 0.0,
            scattered: [0.0; 5],
        }
    }

    /// Effects 0 and 1 look alike, and 2 and 3; what is even acts within runs.
    fn judged(sets: &[Visited]) -> Judgement {
        let background = Background {
            temperature: 1.0,
            alike: &|a, b| a / 2 == b / 2,
            clear_lead: ALIKE,
            most_of_a_course: MOST_OF_A_COURSE,
            within_runs: &|e| e % 2 == 0,
            makes_course: &|e, lives_in| e < 2 && lives_in == "angle",
        };
        judge(sets, sets.iter().find(|s| s.key.is_empty()).expect("there is a root"), &background)
    }

    /// All effects look alike.
    fn all_alike() -> Background<'static> {
        Background {
            temperature: 1.0,
            alike: &|_, _| true,
            clear_lead: ALIKE,
            most_of_a_course: MOST_OF_A_COURSE,
            within_runs: &|_| false,
            makes_course: &|_, _| false,
        }
    }

    /// Fails if rivals of different kinds make one set: a person would take either of four where it is one of each two.
    #[test]
    fn rivals_are_told_apart_by_what_they_look_like() {
        let pairs = [[0, 2], [0, 3], [1, 2], [1, 3]].map(|pair| set(&pair, 100.0, 1.0));
        let sets = [pairs.to_vec(), vec![set(&[], 0.0, 9.0)]].concat();
        assert_eq!(judged(&sets).one_of, [vec![0, 1], vec![2, 3]]);
    }

    /// Fails if what is as likely as not joins a set that holds without it.
    #[test]
    fn a_set_is_the_smallest_that_holds() {
        let sets = [
            set(&[4, 0], 100.0, 1.0),
            set(&[0], 99.9, 1.0),
            set(&[4, 1], 99.8, 1.0),
            set(&[1], 99.7, 1.0),
            set(&[], 0.0, 9.0),
        ];
        assert_eq!(judged(&sets).one_of, [vec![0, 1]]);
    }

    /// Fails if an effect is named that leads what looks like it by less than forms differ, or loses its name to what does not.
    #[test]
    fn a_lead_over_what_looks_alike_has_to_be_clear() {
        let of = |rival: usize, behind: f64| {
            judged(&[set(&[0], 200.0, 1.0), set(&[rival], 200.0 - behind, 1.0), set(&[], 0.0, 9.0)])
        };
        assert_eq!((of(1, 0.9 * ALIKE).named, of(1, 0.9 * ALIKE).one_of), (vec![], vec![vec![0, 1]]));
        assert_eq!(of(1, 1.1 * ALIKE).named, [0]);
        assert_eq!(of(2, 0.9 * ALIKE).named, [0]);
    }

    /// Fails if what would be there in an effect's place is no longer told from what does worse than that.
    #[test]
    fn the_rivals_are_those_of_the_best_set_without() {
        let behind = |effects: &[usize], share: f64| set(effects, 200.0 - share * ALIKE, 1.0);
        let sets = [behind(&[0], 0.0), behind(&[1, 2], 0.3), behind(&[3], 0.6), set(&[], 0.0, 9.0)];
        assert_eq!(judge(&sets, &sets[3], &all_alike()).one_of, [vec![0, 1, 2]]);
    }

    /// Fails if what stands beside an effect joins the rivals for its place: then one of four is said to be there where it is one of each two.
    #[test]
    fn what_stands_beside_an_effect_is_no_rival_of_it() {
        let of = |sets: &[Visited]| judge(sets, &sets[sets.len() - 1], &all_alike()).one_of;
        let root = set(&[], 0.0, 9.0);
        let [first, second] = [set(&[0, 2], 200.0, 1.0), set(&[0, 3], 199.0, 1.0)];
        let instead = set(&[1, 3], 190.0, 1.1);
        assert_eq!(of(&[first.clone(), second.clone(), instead, root.clone()]), [vec![2, 3], vec![0, 1]]);
        assert_eq!(of(&[first, second, set(&[3], 190.0, 1.1), root]), [vec![2, 3], vec![0]]);
    }

    /// Fails if what takes up the error of another's form is named beside it, if that other loses its name with it, or if what does not look like it
    /// needs as much.
    #[test]
    fn what_may_be_a_matter_of_anothers_form_is_not_named_beside_it() {
        let of = |more: usize, lead: f64| {
            judged(&[
                set(&[0, more], 200.0, 1.0),
                set(&[0], 200.0 - lead, 1.2),
                set(&[more], 20.0, 8.0),
                set(&[], 0.0, 9.0),
            ])
        };
        assert_eq!((of(1, 0.9 * ALIKE).named, of(1, 0.9 * ALIKE).one_of), (vec![0], vec![vec![1]]));
        assert_eq!(of(1, 1.1 * ALIKE).named, [0, 1]);
        assert_eq!(of(2, 0.9 * ALIKE).named, [0, 2]);
    }

    /// Fails if gains that scatter beyond belief are passed over, or are held against the belief of another set than the best; or if so is what no
    /// equation is believed to.
    #[test]
    fn gains_that_scatter_over_the_duty_are_unknown_where_the_effects_have_not_moved_them() {
        let lives_in = |tau: f64, beliefs: [f64; 2]| {
            let [mut best, mut root] = [set(&[0], 20.0, 5.0), set(&[], 0.0, 9.0)];
            for (set, belief) in [&mut best, &mut root].into_iter().zip(beliefs) {
                (set.taus[1], set.belief[1]) = (tau, belief * LARGEST_SPREAD);
            }
            judged(&[best, root]).lives_in
        };
        assert_eq!(lives_in(0.04, [-1.1, -0.9]), [("duty", 0.0)]);
        assert_eq!(lives_in(0.04, [-0.9, -1.1]), []);
        assert_eq!(lives_in(0.9 * MODEL_FLOOR, [-1.1, -1.1]), []);
    }

    /// Fails if a course that the library's effects have is nobody's, or if one that they have not is theirs.
    #[test]
    fn a_course_that_effects_have_is_one_of_them() {
        let of = |lives_in: &'static str| {
            let mut root = set(&[], 100.0, 10.0);
            root.courses = vec![Course { lives_in, taken: 3.0, share: 0.3 }];
            judged(&[root, set(&[1], 99.9, 7.0), set(&[2], 99.8, 10.0), set(&[0], 98.0, 7.1)])
        };
        assert_eq!((of("angle").one_of, of("angle").lives_in), (vec![vec![1, 0]], vec![]));
        assert_eq!((of("time").one_of, of("time").lives_in), (vec![], vec![("time", 0.3)]));
    }

    /// Fails if a course over the time that takes hardly more than one over the angle hides the effects that go with the angle, or one that takes
    /// more is theirs; or if what is left of a course of theirs is held against them.
    #[test]
    fn a_course_over_time_that_is_one_over_the_angle_is_the_angles() {
        let of = |over_time: f64, after: f64| {
            let [mut root, mut effect] = [set(&[], 100.0, 10.0), set(&[1], 99.9, 7.0)];
            let angle = Course { lives_in: "angle", taken: 2.8, share: 0.28 };
            root.courses = vec![Course { lives_in: "time", share: over_time, ..angle }, angle];
            effect.courses = vec![Course { taken: 7.0 * after, share: after, ..angle }];
            judged(&[root, effect])
        };
        assert_eq!((of(0.29, 0.02).one_of, of(0.29, 0.02).lives_in), (vec![vec![1]], vec![]));
        assert_eq!(of(0.29, 0.2).one_of, [vec![1]]);
        assert_eq!((of(0.4, 0.02).one_of, of(0.4, 0.02).lives_in), (vec![], vec![("time", 0.4)]));
    }

    /// Fails if nothing is said of motors whose runs differ by what is not believed, because a set that is not certain explains it, or beside it runs
    /// have courses of their own.
    #[test]
    fn what_no_set_says_is_left_over() {
        let lives_in = |lead: f64, course: f64| {
            let [mut uncertain, mut root] = [set(&[0], lead, 9.0), set(&[], 0.0, 9.0)];
            uncertain.scattered[1] = 10.0;
            uncertain.courses = vec![Course { lives_in: "time, each run its own", taken: 9.0 * course, share: course }];
            (root.taus[1], root.belief[1], root.scattered[1]) = (0.06, -2.0 * LARGEST_SPREAD, 40.0);
            judged(&[uncertain, root]).lives_in.iter().map(|l| l.0).collect::<Vec<_>>()
        };
        assert_eq!(lives_in(1.0, 0.0), ["duty"]);
        assert_eq!(lives_in(1.0, 1.1 * MOST_OF_A_COURSE), ["duty"]);
        assert!(lives_in(20.0, 0.0).is_empty());
    }

    /// Fails if a cause that takes most of what the runs differ by falls for a spread that only shows beside it, or one stands that makes them
    /// differ by more than they did.
    #[test]
    fn a_cause_may_not_make_the_runs_differ_by_more() {
        let withheld = |over_duty: f64| {
            let [mut best, mut root] = [set(&[0], 100.0, 10.0), set(&[], 0.0, 1000.0)];
            (best.taus[4], best.belief[4], best.scattered[4]) = (0.05, -2.0 * LARGEST_SPREAD, 20.0);
            root.scattered[1] = over_duty;
            judged(&[best, root]).withheld
        };
        assert!(!withheld(400.0) && withheld(4.0));
    }

    /// Fails if a name stands beside gains that scatter with the order for more than what it explains, or falls for less.
    #[test]
    fn a_spread_of_the_gains_counts_as_what_it_removes() {
        let withheld = |scattered: f64| {
            let [mut best, mut root] = [set(&[0], 100.0, 10.0), set(&[], 0.0, 20.0)];
            for set in [&mut best, &mut root] {
                (set.taus[4], set.belief[4], set.scattered[4]) = (0.05, -2.0 * LARGEST_SPREAD, scattered);
            }
            judged(&[best, root]).withheld
        };
        assert!(withheld(25.0) && !withheld(4.0));
    }

    /// Fails if a name stands beside a course of each run's own that is as large as what it explains, where both lie within the runs.
    #[test]
    fn a_course_of_its_own_in_each_run_is_another_cause() {
        let of = |effect: usize, course: f64| {
            let mut best = set(&[effect], 100.0, 10.0);
            best.courses = vec![Course { lives_in: "time, each run its own", taken: 10.0 * course, share: course }];
            judged(&[best, set(&[], 0.0, 20.0)])
        };
        assert!(of(0, 0.5).withheld && of(0, 0.5).named.is_empty());
        assert_eq!(of(0, 0.3).named, [0]);
        assert_eq!(of(1, 0.5).named, [1]);
    }
}
