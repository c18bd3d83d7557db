//! Scores, numbers and left-overs of the sets that were visited.

use super::super::finding::{Estimate, Finding, NOT_ALL, Status, Unknown};
use super::super::stats::HeldOut;
use super::super::verdict::{Background, Judgement, LARGEST_P, LEAST_GAIN, MOST_BESIDE, TEMPERATURE, Visited, judge};
use super::compensation::Fitted;
use super::data::Data;
use super::effects::{Coordinate, EFFECTS, free, reported, twin};
use super::fit::Plant;
use super::held_out::{Chance, Scorer, squared_error};
use super::numbers::{estimates, own_numbers};
use super::plant::simulate_all;
use super::sets::{Ground, Part, Set, memory, no_swing};
use super::values::P;

/// Lead in nats from which an effect needs no second opinion of runs held out; as for runs of a TWUM.
const BEYOND_DOUBT: f64 = 25.0;
/// Nats by which friction has to lead a dead zone, or dead time a second lag, where what is left has a form: half of what a TWUM's need,
/// whose equations are less well known.
const CLEAR_LEAD: f64 = 20.0;
/// Share of the rest that courses of the runs' own may take where nothing is found: gains shrunk towards one another leave some.
const MOST_OF_A_COURSE: f64 = 0.15;
/// Share of all that could be removed that follows from sample to sample beside causes of the library's own forms: 0.04 at most in 130 motors
/// drawn for choosing; 0.06 and more where another effect stood for one that was taken out of the library.
const MOST_OF_ITS_FORM: f64 = 0.06;
/// How much inputs have to change while a load swings through a radian: a sine does so much whose own radian is seven times as long. What slower
/// ones seemed to shake was another effect's in 3 of 6 motors.
const LEAST_SHAKEN: f64 = 0.01;
/// Share of what is left that neighbours foretell, from which "nothing" may not be said.
const MOST_FORETOLD: f64 = 0.5;
/// Share of the usual speed below which what is left is nobody's concern: twice what no equation is believed below.
const NEGLIGIBLE: f64 = 0.01;
/// Where something lives that neighbours foretell and no coordinate has.
const FOLLOWS: &str = "time: what is left follows from sample to sample";
/// Samples that noise lasts at most: beyond, what is left has a form that no effect of the set has.
const MOST_MEMORY_OF_NOISE: f64 = 1.5;

/// What was found.
#[derive(Debug, Clone)]
pub struct InertialOutcome {
    /// The runs as they were compared.
    pub data: Data,
    /// Speeds of the line with a lag, refitted: a list a run, in rpm.
    pub before: Vec<Vec<f64>>,
    /// Speeds of the plant with all accepted effects, the same.
    pub after: Vec<Vec<f64>>,
    /// Evidence an effect.
    pub findings: Vec<Finding>,
    /// Without a cause.
    pub unknown: Vec<Unknown>,
    /// Effects that these runs cannot show, with the reason.
    pub not_judged: Vec<(String, String)>,
    /// Held-out errors of baseline and extended plant.
    pub held_out: HeldOut,
    /// Noise floor in rpm.
    pub noise_floor: f64,
    /// Numbers that belong to the motor itself, with 95 % intervals.
    pub own: Vec<Estimate>,
    /// The plant with all accepted effects and the line; none where the runs are not of one motor.
    pub fitted: Option<Fitted>,
    /// What else must be said.
    pub notes: Vec<String>,
}

/// Draws the conclusions from sets, best first.
pub fn conclude(ground: &Ground, visited: &[Set], repetitions: usize, seed: u64) -> InertialOutcome {
    let root = visited.iter().find(|s| s.parts.is_empty()).unwrap_or(&visited[0]);
    let scorer = Scorer::new(ground);
    let mut standing = Standing::of(&scorer, visited, root, seed);
    let mut accepted = ground.settled(standing.accepted(root));
    if standing.withhold(ground, root, &accepted) {
        accepted = ground.settled(standing.accepted(root));
    }
    let accepted = &accepted;
    // What refines a form moves the numbers; over one slow pass it may foretell no better than without.
    let [refined, plain] = [accepted, standing.accepted(root)].map(|set| scorer.held_out(set));
    let after = if refined.rmse(0) < plain.rmse(0) { refined } else { plain };
    let held = scorer.held_out(root).against(&after);
    let chance = Chance::new(ground, root, visited, repetitions, seed);
    let view = View { ground, scorer: &scorer, visited, root, standing: &standing, chance: &chance, repetitions, seed };
    let mut findings: Vec<Finding> = accepted.parts.iter().map(|part| view.accepted(accepted, *part)).collect();
    share_out(ground, visited, root, accepted, &mut findings);
    not_quite(share_that_follows(ground, root, accepted), &mut findings);
    findings.extend(view.others(accepted));
    // The motor's own second lag is no cause, though it may be what looks like one.
    findings.retain(|f| EFFECTS.iter().all(|e| e.name != f.name || !e.own || f.status == Status::Ambiguous));
    let foretold = foretold(ground.data, &accepted.plant);
    let speeds = |plant: &Plant| -> Vec<Vec<f64>> {
        simulate_all(ground.data, &plant.values, &plant.starts).into_iter().map(|m| m.rpm).collect()
    };
    let unknown = left_over(ground, &standing.judged, &findings, &held, foretold);
    InertialOutcome {
        data: ground.data.clone(),
        before: speeds(&root.plant),
        after: speeds(&accepted.plant),
        unknown,
        not_judged: Vec::new(),
        notes: Vec::new(),
        noise_floor: noise_floor(ground, &held, foretold),
        own: own_numbers(ground, accepted),
        fitted: Some(Fitted { line: root.plant.values, plant: accepted.plant.values }),
        held_out: held,
        findings,
    }
}

/// What the sets say together with runs held out.
struct Standing {
    /// The sets without what was struck, best first.
    sets: Vec<Set>,
    judged: Judgement,
    struck: Vec<usize>,
}

impl Standing {
    fn of(scorer: &Scorer, visited: &[Set], root: &Set, seed: u64) -> Self {
        let ground = scorer.ground;
        // Where noise alone is left, no form is wrong.
        let form_counts = memory(ground.data, &visited[0].plant) > MOST_MEMORY_OF_NOISE;
        // Over one slow pass friction and a dead zone are one thing, whatever the form of what lies above.
        let one_pass = ground.data.passes_once();
        let background = Background {
            temperature: TEMPERATURE,
            alike: &|named, rival| (form_counts || one_pass) && alike(named, rival),
            clear_lead: if one_pass { f64::INFINITY } else { CLEAR_LEAD },
            most_of_a_course: MOST_OF_A_COURSE,
            within_runs: &|_| true,
            makes_course: &|_, _| false,
        };
        let mut sets = visited.to_vec();
        let mut struck = Vec::new();
        loop {
            let views: Vec<Visited> = sets.iter().map(Set::visited).collect();
            let mut judged = judge(&views, &root.visited(), &background);
            if ground.data.starts() < 2 {
                seen_once(&mut judged);
            }
            let more = uncertain_effects(scorer, &sets, root, &judged, seed);
            if more.is_empty() {
                return Self { sets, judged, struck };
            }
            sets.retain(|s| !s.key().iter().any(|e| more.contains(e)));
            struck.extend(more);
        }
    }
}

impl Standing {
    /// The set of what may be said.
    fn accepted<'a>(&'a self, root: &'a Set) -> &'a Set {
        self.judged.accepted(&self.sets, Set::key, |e| EFFECTS[e].own).unwrap_or(root)
    }

    /// Takes every name back where what follows from sample to sample beside them is more of all that could be removed than may stay
    /// beside a cause, in whatever coordinate it lives; whether it did.
    fn withhold(&mut self, ground: &Ground, root: &Set, accepted: &Set) -> bool {
        let judged = &mut self.judged;
        if judged.named.is_empty() && judged.one_of.is_empty() {
            return false;
        }
        let share = share_that_follows(ground, root, accepted);
        let left = squared_error(ground.data, &accepted.plant);
        if share < MOST_BESIDE || left < (NEGLIGIBLE * ground.data.usual_rpm).powi(2) * ground.data.rows() as f64 {
            return false;
        }
        judged.named.clear();
        judged.one_of.clear();
        judged.withheld = true;
        if judged.lives_in.is_empty() {
            judged.lives_in.push((FOLLOWS, share));
        }
        true
    }
}

/// Friction and a dead zone differ in how a motor runs down, dead time and a second lag in how a step begins.
fn alike(named: usize, rival: usize) -> bool {
    let number = |e: usize| EFFECTS[e].forms[0].numbers[0];
    !EFFECTS[named].own && twin(number(named)) == Some(number(rival))
}

/// What acts at rest or after a change is one of several things where the motor started once.
fn seen_once(judged: &mut Judgement) {
    let once = |e: &usize| matches!(EFFECTS[*e].coordinate, Coordinate::Rest | Coordinate::Time);
    let said: Vec<usize> = judged.named.iter().chain(judged.one_of.iter().flatten()).copied().filter(once).collect();
    if said.is_empty() {
        return;
    }
    judged.named.retain(|e| !once(e));
    judged.one_of.retain(|set| !set.iter().any(once));
    let mut set = said;
    set.extend(judged.inclusion.iter().map(|i| i.0).filter(once));
    set.sort_unstable();
    set.dedup();
    judged.one_of.push(set);
    // What is left beside one of several is what the others would take.
    judged.lives_in.clear();
}

/// An effect that does not for certain help where it was not fitted, with those that it cannot be told from; empty if all do.
fn uncertain_effects(scorer: &Scorer, sets: &[Set], root: &Set, judged: &Judgement, seed: u64) -> Vec<usize> {
    let lead = |effect: usize| {
        let group = judged.set_of(effect).cloned().unwrap_or_else(|| vec![effect]);
        let best = |with: bool| {
            let of = sets.iter().filter(|s| s.key().iter().any(|e| group.contains(e)) == with);
            of.map(|s| s.score).fold(f64::NEG_INFINITY, f64::max)
        };
        best(true) - best(false)
    };
    let accepted = judged.accepted(sets, Set::key, |e| EFFECTS[e].own).unwrap_or(root);
    let all = scorer.held_out(accepted);
    let doubtful = (0..accepted.parts.len()).find(|k| {
        lead(accepted.parts[*k].effect) < BEYOND_DOUBT && {
            let less = scorer.held_out(&scorer.ground.without(accepted, *k, sets));
            let held = less.against(&all);
            held.gain() < LEAST_GAIN && held.gain_interval(seed)[0] <= 0.0
        }
    });
    let effect = doubtful.map(|k| accepted.parts[k].effect);
    effect.map_or(Vec::new(), |e| judged.set_of(e).cloned().unwrap_or_else(|| vec![e]))
}

/// What findings are made from.
struct View<'a> {
    ground: &'a Ground<'a>,
    scorer: &'a Scorer<'a>,
    visited: &'a [Set],
    root: &'a Set,
    standing: &'a Standing,
    /// Of effects alone.
    chance: &'a Chance,
    repetitions: usize,
    seed: u64,
}

impl View<'_> {
    fn probability(&self, effect: usize) -> f64 {
        self.standing.judged.inclusion.iter().find(|i| i.0 == effect).map_or(0.0, |i| i.1)
    }

    fn rivals(&self, effect: usize) -> Vec<String> {
        let others = self.standing.judged.set_of(effect).into_iter().flatten().filter(|o| **o != effect);
        others.map(|o| EFFECTS[*o].name.to_owned()).collect()
    }

    fn accepted(&self, accepted: &Set, part: Part) -> Finding {
        let at = accepted.parts.iter().position(|p| *p == part).unwrap_or(0);
        let less = self.ground.without(accepted, at, self.visited);
        let held = self.scorer.held_out(&less).against(&self.scorer.held_out(accepted));
        let ambiguous = self.standing.judged.set_of(part.effect).is_some();
        let effect = &EFFECTS[part.effect];
        let numbers = effect.forms[part.form].numbers;
        let finer = self.ground.finer(&[part], &accepted.plant.values);
        let mut parameters = estimates(self.ground, accepted, &[numbers, &finer].concat());
        // What refines a form is told where it is there for certain.
        let finer: Vec<&str> = finer.into_iter().map(|n| reported(n).0).collect();
        parameters.retain(|e| !finer.contains(&e.name.as_str()) || e.interval[0] > 0.0);
        let p_null = match less.parts.is_empty() {
            true => self.chance.p(part.effect, Some(&held)),
            false => {
                let with: Vec<Set> = self.visited.iter().chain([accepted]).cloned().collect();
                Chance::new(self.ground, &less, &with, self.repetitions, self.seed).p(part.effect, Some(&held))
            }
        };
        let could_be_none = parameters.iter().all(|e| e.interval[0] <= 0.0 && e.interval[1] >= 0.0);
        let doubt = match could_be_none {
            true => Some("likely, but its size could be none"),
            false if numbers.contains(&P::Swing) => self.doubt_of_a_swing(accepted, numbers, &parameters),
            false => None,
        };
        Finding {
            name: effect.name.to_owned(),
            // What is in doubt is no cause yet.
            status: match (ambiguous || doubt.is_some() || held.gain_interval(self.seed)[0] <= 0.0, effect.own) {
                (true, _) => Status::Ambiguous,
                (false, true) => Status::Rejected,
                (false, false) => Status::Named,
            },
            probability: Some(self.probability(part.effect)),
            gain: held.gain(),
            gain_interval: held.gain_interval(self.seed),
            p_null,
            parameters,
            conflicts: self.rivals(part.effect),
            next_experiment: effect.next_experiment.to_owned(),
            share: 0.0,
            note: doubt.unwrap_or_default().to_owned(),
        }
    }

    /// Why a resonance was not seen to be one: what swings for ever or at once, or what no input shakes, may be another thing's form.
    fn doubt_of_a_swing(&self, accepted: &Set, numbers: &[P], told: &[Estimate]) -> Option<&'static str> {
        let values = &accepted.plant.values;
        let least = |p: P| free(p, self.ground.data).bounds.0;
        let reaches_its_least = |p: P| told.iter().any(|e| e.name == reported(p).0 && e.interval[0] <= least(p));
        if numbers.iter().any(|n| no_swing(&free(*n, self.ground.data), values))
            || [P::Swing, P::SwingDamping].into_iter().any(reaches_its_least)
        {
            return Some("likely, but these runs do not show it swing and die away");
        }
        (self.ground.data.shaken(values.get(P::Swing)) < LEAST_SHAKEN)
            .then_some("likely, but no input of these runs changes as quickly as it swings")
    }

    /// The effects beside the accepted set: rivals, what was struck, and what no probability is left for.
    fn others(&self, accepted: &Set) -> Vec<Finding> {
        let Standing { judged, struck, .. } = self.standing;
        let mut effects: Vec<usize> = Vec::new();
        let singles = self.visited.iter().filter(|s| s.parts.len() == 1).map(|s| s.parts[0].effect);
        for e in judged.inclusion.iter().map(|i| i.0).chain(singles) {
            if !accepted.key().contains(&e) && !effects.contains(&e) {
                effects.push(e);
            }
        }
        let one = |effect: usize| {
            let alone = self.visited.iter().find(|s| s.key() == [effect]);
            let held = alone.map(|s| self.scorer.held_out(self.root).against(&self.scorer.held_out(s)));
            let probability = self.probability(effect);
            let set = self.visited.iter().filter(|_| probability > 0.0).find(|s| s.key().contains(&effect));
            let part = set.and_then(|s| s.parts.iter().find(|p| p.effect == effect).map(|p| (s, p)));
            Finding {
                name: EFFECTS[effect].name.to_owned(),
                status: if judged.set_of(effect).is_some() { Status::Ambiguous } else { Status::Rejected },
                probability: Some(probability),
                gain: held.as_ref().map_or(0.0, HeldOut::gain),
                gain_interval: held.map_or([0.0; 2], |h| h.gain_interval(self.seed)),
                p_null: self.chance.p(effect, None),
                parameters: part
                    .map_or_else(Vec::new, |(s, p)| estimates(self.ground, s, EFFECTS[effect].forms[p.form].numbers)),
                conflicts: self.rivals(effect),
                next_experiment: EFFECTS[effect].next_experiment.to_owned(),
                share: 0.0,
                note: if struck.contains(&effect) {
                    "likely, but where it was not fitted it does not help for certain"
                } else if judged.withheld && probability > 0.0 {
                    NOT_ALL
                } else {
                    ""
                }
                .to_owned(),
            }
        };
        effects.into_iter().map(one).collect()
    }
}

/// Of all that could be removed, the share that beside a set still follows from sample to sample.
fn share_that_follows(ground: &Ground, root: &Set, set: &Set) -> f64 {
    let left = squared_error(ground.data, &set.plant);
    let followed = left * foretold(ground.data, &set.plant);
    let removed = squared_error(ground.data, &root.plant) - left;
    followed / (removed + followed).max(1e-300)
}

/// Says of every name that its form is not the motor's where more than the library's own forms leave still follows from sample to sample.
fn not_quite(share: f64, findings: &mut [Finding]) {
    if share > MOST_OF_ITS_FORM {
        for f in findings.iter_mut().filter(|f| f.status == Status::Named && f.note.is_empty()) {
            f.note = format!(
                "beside the causes {:.0} % of what could be removed still follows from sample to sample: a form is not quite the library's, or \
                 something else acts too",
                100.0 * share
            );
        }
    }
}

/// Shares of the baseline's squared error that each effect removes: the mean of adding it first and adding it last.
fn share_out(ground: &Ground, sets: &[Set], root: &Set, accepted: &Set, findings: &mut [Finding]) {
    let error = |s: &Set| squared_error(ground.data, &s.plant);
    let (none, all) = (error(root), error(accepted));
    let removed: Vec<(usize, f64)> = (0..accepted.parts.len())
        .map(|k| {
            let effect = accepted.parts[k].effect;
            let first = sets.iter().find(|s| s.key() == [effect]).map_or(none, &error);
            let last = error(&ground.without(accepted, k, sets));
            (effect, (0.5 * ((none - first) + (last - all))).max(0.0))
        })
        .collect();
    let total: f64 = removed.iter().map(|r| r.1).sum();
    for (effect, r) in removed {
        if let Some(f) = findings.iter_mut().find(|f| f.name == EFFECTS[effect].name) {
            f.share = r / total.max(1e-12) * (1.0 - all / none.max(1e-12)).max(0.0);
        }
    }
}

/// Share of what is left that the neighbours of a sample foretell: 0 of noise.
fn foretold(data: &Data, plant: &Plant) -> f64 {
    let motions = simulate_all(data, &plant.values, &plant.starts);
    let (mut rr, mut ss, mut rs) = (0.0, 0.0, 0.0);
    for (run, m) in data.runs.iter().zip(&motions) {
        let rest: Vec<f64> = run.rpm.iter().zip(&m.rpm).map(|(y, p)| y - p).collect();
        for w in rest.windows(5) {
            let around = 0.25 * (w[0] + w[1] + w[3] + w[4]);
            rr += w[2] * w[2];
            ss += around * around;
            rs += w[2] * around;
        }
    }
    if rr > 0.0 && ss > 0.0 && rs > 0.0 { (rs * rs / (rr * ss)).min(1.0) } else { 0.0 }
}

/// What is left without any structure is noise, whatever made it; so is what is too small for any equation.
fn noise_floor(ground: &Ground, held: &HeldOut, foretold: f64) -> f64 {
    let left = held.rmse(1);
    (left * (1.0 - foretold).sqrt()).max(left.min(NEGLIGIBLE * ground.data.usual_rpm))
}

/// Where something is that no effect explains. "Nothing" is never said beside most of the error.
fn left_over(ground: &Ground, judged: &Judgement, findings: &[Finding], held: &HeldOut, foretold: f64) -> Vec<Unknown> {
    let unknown = |lives_in, share| Unknown { lives_in, gain: share, share, p_null: LARGEST_P };
    let mut all: Vec<Unknown> = judged.lives_in.iter().map(|(place, share)| unknown(place, *share)).collect();
    let nothing = all.is_empty() && findings.iter().all(|f| f.status == Status::Rejected);
    let left = held.rmse(1);
    if nothing && left > NEGLIGIBLE * ground.data.usual_rpm && foretold > MOST_FORETOLD {
        all.push(unknown(FOLLOWS, foretold));
    } else if nothing && left > 0.5 * ground.data.usual_rpm {
        all.push(unknown("the speed as a whole: it does not follow the input", 1.0));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if beside one of several that were seen once, what is left makes the answer `unknown`, or what never was in doubt is thrown away.
    #[test]
    fn what_is_left_beside_a_guess_is_the_guess_s() {
        let of = |name: &str| EFFECTS.iter().position(|e| e.name == name).expect("it is in the library");
        let judged = |named: usize| {
            let mut judged = Judgement {
                inclusion: vec![(named, 0.99)],
                named: vec![named],
                one_of: Vec::new(),
                of_course: Vec::new(),
                lives_in: vec![("time, each run its own", 0.07)],
                withheld: false,
            };
            seen_once(&mut judged);
            judged
        };
        let friction = judged(of("coulomb-friction"));
        assert_eq!((friction.named, friction.lives_in), (vec![], vec![]));
        let saturation = judged(of("high-duty-saturation"));
        assert_eq!((saturation.named.len(), saturation.lives_in.len()), (1, 1));
    }
}
