//! Dropped samples: the recorder loses a word of 32 samples, and what follows moves up in time.
//!
//! A gap is an event, not a parameter, so it is looked for before everything else: each run is followed window by window
//! through the states "n words lost so far", and the cheapest path is taken (Viterbi). The PWM line makes the shift visible:
//! after a gap the drive's phases no longer fit the record's time.

use super::finding::{Estimate, Finding, Status};
use super::observe::{Observed, Window};
use super::problem::{Model, Problem, RPM, RunResidual};
use super::stats::HeldOut;
use super::verdict::{LARGEST_P, LEAST_GAIN};
use twum_record::measurement::RunKind;

/// Samples in a word of the thesis's capture.
const WORD: f64 = 32.0;
/// Most words lost in one run that are looked for: a third of a second, which in most runs a wrong clock would have to err by some per cent for.
const MOST: usize = 10;
/// Most words lost at once: what is longer is two gaps beside each other.
const AT_ONCE: usize = 3;

/// By how much what follows a gap has to speak for it beside the windows that it falls into, which are wild for many reasons: two deviations.
const LEAST_AFTER: f64 = 4.0;

/// What was found.
#[derive(Debug, Clone)]
pub struct Gaps {
    /// Runs with the lost time put back.
    pub problem: Problem,
    /// Words lost in each run.
    pub lost: Vec<usize>,
    /// The evidence.
    pub finding: Finding,
}

impl Gaps {
    /// Whether they are enough where nothing else was found beside them.
    pub fn stand_alone(&self) -> bool {
        is_enough(self.finding.gain, self.finding.gain_interval, Beside::Found)
    }
}

/// Beside what lost words are looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Beside {
    /// A motor whose effects are not known yet: a small gain may be as much as there can be beside their error.
    Unknown,
    /// A motor with what was found: what is left is theirs.
    Found,
}

/// Looks for lost words in runs sampled on a grid; `None` if there are none.
pub fn find(problem: &Problem, model: &Model, beside: Beside, seed: u64) -> Option<Gaps> {
    let usable =
        |r: &Observed| r.kind == RunKind::Speed && r.pitch > 0.0 && r.time_spread > 1e-4 && r.windows.len() > 20;
    if !problem.runs.iter().any(usable) {
        return None;
    }
    let now = problem.residuals(model);
    let variance = typical_variance(problem, &now);
    let shifts: Vec<Vec<Vec<f64>>> = (0..=MOST)
        .map(|m| {
            let mut shifted = problem.clone();
            for run in &mut shifted.runs {
                let step = word_s(run) * m as f64;
                for t in &mut run.times {
                    *t += step;
                }
            }
            shifted.angles(model)
        })
        .collect();
    let mut runs = problem.runs.clone();
    let mut lost = vec![0; runs.len()];
    let mut best_improvement: f64 = 0.0;
    let windows: usize = problem.runs.iter().map(|r| r.windows.len()).sum();
    let followed = |i: usize, under_drive: bool| Followed {
        run: &problem.runs[i],
        angles: shifts.iter().map(|s| &s[i]).collect(),
        variance,
        under_drive,
    };
    let path = |i: usize, under_drive: bool| followed(i, under_drive).path((windows as f64).ln());
    let usable: Vec<usize> = (0..runs.len()).filter(|i| usable(&problem.runs[*i])).collect();
    let mut paths: Vec<_> = usable.iter().map(|i| path(*i, false)).collect();
    // Where the drive ends words are lost in one run by chance; in several it is how the rotor stops.
    let ends =
        |(i, path): (&usize, &Option<Path>)| path.as_ref().is_some_and(|(jumps, _)| followed(*i, false).ends_in(jumps));
    if usable.iter().zip(&paths).filter(|run| ends(*run)).count() > 1 {
        paths = usable.iter().map(|i| path(*i, true)).collect();
    }
    for (i, path) in usable.into_iter().zip(paths) {
        if let Some((jumps, improvement)) = path {
            best_improvement = best_improvement.max(improvement / jumps.len() as f64);
            lost[i] = jumps.iter().map(|j| j.words).sum();
            put_back(&mut runs[i], &jumps);
        }
    }
    let total: usize = lost.iter().sum();
    if total == 0 {
        return None;
    }
    let corrected = Problem::new(runs).with(problem.formulas.clone());
    let after = corrected.residuals(model);
    let squares = squared(problem, &now).zip(squared(&corrected, &after));
    let pairs: Vec<[f64; 2]> = squares.map(|(before, after)| [before, after]).collect();
    let held =
        HeldOut { loss: pairs.clone(), plain: pairs, seconds: problem.runs.iter().map(|r| r.compared_s()).collect() };
    let gain = held.gain();
    let p_null = (windows as f64 * (-0.5 * best_improvement).exp()).clamp(1e-6, 1.0);
    let gain_interval = held.gain_interval(seed);
    if !is_enough(gain, gain_interval, beside) || p_null > LARGEST_P {
        return None;
    }
    let finding = Finding {
        name: "dropped-samples".to_owned(),
        status: Status::Named,
        probability: None,
        gain,
        gain_interval,
        p_null,
        parameters: vec![
            count("words_lost", total as f64),
            count("runs_affected", lost.iter().filter(|n| **n > 0).count() as f64),
            Estimate { name: "word_s".to_owned(), value: 0.032, interval: [0.032, 0.032], unit: "s".to_owned() },
        ],
        conflicts: Vec::new(),
        next_experiment: "record again with frame sequence numbers (twum capture reports every loss)".to_owned(),
        share: 0.0,
        note: "found in each run by itself; the lost time is put back before anything else is judged".to_owned(),
    };
    Some(Gaps { problem: corrected, lost, finding })
}

/// Whether gaps gain enough: beside another cause's error every choice among the runs has to gain by what is little.
fn is_enough(gain: f64, gain_interval: [f64; 2], beside: Beside) -> bool {
    gain >= LEAST_GAIN || beside == Beside::Unknown && gain_interval[0] > 0.0
}

/// Variance of a weighted residual, from the middle of the squares: gaps must not set it. Of a square of variance 1 the median is
/// 0.455 (chi-squared of one degree).
fn typical_variance(problem: &Problem, residuals: &[RunResidual]) -> f64 {
    let of = |(run, r): (&Observed, &RunResidual)| -> Vec<f64> {
        run.windows.iter().zip(&r.rpm).map(|(w, v)| v * v * run.duration(w)).collect()
    };
    let mut squares: Vec<f64> = problem.runs.iter().zip(residuals).flat_map(of).collect();
    squares.sort_by(f64::total_cmp);
    (squares[squares.len() / 2] / 0.455).max(1e-9)
}

/// Squared residual of each run, rpm²·s.
fn squared(problem: &Problem, residuals: &[RunResidual]) -> impl Iterator<Item = f64> {
    let of = |(run, r): (&Observed, &RunResidual)| {
        run.windows.iter().zip(&r.rpm).map(|(w, v)| v * v * run.duration(w)).sum()
    };
    problem.runs.iter().zip(residuals).map(of)
}

fn count(name: &str, value: f64) -> Estimate {
    Estimate { name: name.to_owned(), value, interval: [value, value], unit: "1".to_owned() }
}

fn word_s(run: &Observed) -> f64 {
    // time_spread is period / √12.
    WORD * run.time_spread * 12f64.sqrt()
}

/// A gap: where it is and what was lost in it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Jump {
    /// Window it falls into.
    window: usize,
    /// Words lost.
    words: usize,
    /// Whether the window ends where the record was joined: of an odd number of edges lost, the level changes there, and where no edge was
    /// one seems to be. The next window then ends at the first true one.
    joined: bool,
    /// Encoder pitches lost beyond those seen.
    extra: f64,
}

/// One run, followed through the states "n words lost so far".
struct Followed<'a> {
    run: &'a Observed,
    /// Simulated angle at each time, by how many words are lost before it.
    angles: Vec<&'a Vec<f64>>,
    variance: f64,
    /// Whether gaps are looked for only where the drive goes on after them.
    under_drive: bool,
}

/// Gaps of a run, and by how much they beat none.
type Path = (Vec<Jump>, f64);

/// How a state was come to: from how many windows before, and with what lost on the way.
#[derive(Debug, Clone, Copy)]
struct Step {
    cost: f64,
    windows: usize,
    jump: Option<Jump>,
}

const NEVER: Step = Step { cost: f64::INFINITY, windows: 0, jump: None };

impl Followed<'_> {
    /// The cheapest gaps, and by how much they beat none.
    fn path(&self, log_windows: f64) -> Option<Path> {
        let (n, states) = (self.run.windows.len(), self.angles.len());
        // What one gap must gain: its place among all windows, which of its kinds it is, and a margin of e⁻⁸.
        let penalty = 2.0 * (log_windows + (2.0 * AT_ONCE as f64).ln()) + 16.0;
        let mut best = vec![vec![NEVER; states]; n + 1];
        best[0][0].cost = 0.0;
        for k in 0..n {
            for state in 0..states {
                let so_far = best[k][state].cost;
                if so_far.is_infinite() {
                    continue;
                }
                let stay = Step { cost: so_far + self.cost(k, 1, state, 0).0, windows: 1, jump: None };
                cheaper(&mut best[k + 1][state], stay);
                for (words, windows) in (1..=AT_ONCE).flat_map(|words| [(words, 1), (words, 2)]) {
                    if state + words >= states || k + windows > n || windows == 2 && !self.may_be_joined(k) {
                        continue;
                    }
                    if self.under_drive && !self.is_driven_after(k, state + words) {
                        continue;
                    }
                    let (cost, extra) = self.cost(k, windows, state, words);
                    let jump = Some(Jump { window: k, words, joined: windows == 2, extra });
                    let step = Step { cost: so_far + cost + penalty, windows, jump };
                    cheaper(&mut best[k + windows][state + words], step);
                }
            }
        }
        let (mut state, end) = best[n].iter().enumerate().min_by(|a, b| a.1.cost.total_cmp(&b.1.cost))?;
        if state == 0 || state == states - 1 {
            // None, or more than can be told from a wrong clock.
            return None;
        }
        let total = end.cost;
        let stay: Vec<f64> = (0..n).map(|k| self.cost(k, 1, 0, 0).0).collect();
        let (mut k, mut jumps, mut within) = (n, Vec::new(), 0.0);
        while k > 0 {
            let step = best[k][state];
            k -= step.windows;
            state -= step.jump.map_or(0, |j| j.words);
            if let Some(jump) = step.jump {
                jumps.push(jump);
                within +=
                    stay[k..k + step.windows].iter().sum::<f64>() - self.cost(k, step.windows, state, jump.words).0;
            }
        }
        jumps.reverse();
        let improvement = stay.iter().sum::<f64>() - total + penalty * jumps.len() as f64;
        (improvement > within + LEAST_AFTER).then_some((jumps, improvement))
    }

    /// Whether a period of the drive follows a gap in window `k`, `lost` words being lost by then: without one, no PWM tells the time.
    fn is_driven_after(&self, k: usize, lost: usize) -> bool {
        let resumes_s = self.run.times[self.run.windows[k].from] + word_s(self.run) * lost as f64;
        resumes_s + self.run.pwm_hz.recip() <= self.run.drive_end
    }

    /// Whether one of its gaps is where the drive ends.
    fn ends_in(&self, jumps: &[Jump]) -> bool {
        let mut lost = 0;
        jumps.iter().any(|j| {
            lost += j.words;
            !self.is_driven_after(j.window, lost)
        })
    }

    /// Whether a window and the next lie between three edges that follow each other.
    fn may_be_joined(&self, k: usize) -> bool {
        let [a, b] = [0, 1].map(|off| self.run.windows.get(k + off));
        let exact = |w: &Window| w.low == w.high;
        matches!((a, b), (Some(a), Some(b)) if exact(a) && exact(b) && a.to == b.from)
    }

    /// Squared error of one window, or of two in one, in which so many words are lost, over its variance; and the pitches lost beyond those seen.
    fn cost(&self, k: usize, windows: usize, state: usize, words: usize) -> (f64, f64) {
        let (w, to) = (&self.run.windows[k], self.run.windows[k + windows - 1].to);
        let advance = self.angles[state + words][to] - self.angles[state][w.from];
        let seen_s = self.run.times[to] - self.run.times[w.from];
        let dt = (seen_s + word_s(self.run) * words as f64).max(1e-6);
        let (mut measured, mut extra) = (advance.clamp(w.low, w.high), 0.0);
        if words > 0 && w.low == w.high {
            // The level after is the one that was seen: one edge and an even number lost, or two of which one was none and an odd number.
            extra = 2.0 * ((advance / w.low - windows as f64) / 2.0).round().max(0.0);
            measured = w.low * (windows as f64 + extra);
        }
        let rpm = (measured - advance) / dt * RPM;
        // A wild window says no more than a clearly wrong one: it must not pay for a gap alone.
        ((rpm * rpm * dt / self.variance).min(25.0), extra)
    }
}

fn cheaper(best: &mut Step, step: Step) {
    if step.cost < best.cost {
        *best = step;
    }
}

/// Puts the lost time and the lost pitches back.
fn put_back(run: &mut Observed, jumps: &[Jump]) {
    let word = word_s(run);
    let mut joins = Vec::new();
    for jump in jumps {
        let lost_s = word * jump.words as f64;
        let w = run.windows[jump.window];
        let to = run.windows[jump.window + usize::from(jump.joined)].to;
        for t in &mut run.times[to..] {
            *t += lost_s;
        }
        for a in &mut run.angles[to..] {
            *a += w.low * jump.extra;
        }
        if w.low == w.high {
            let advance = run.angles[to] - run.angles[w.from];
            run.windows[jump.window] = Window { to, low: advance, high: advance, ..w };
        }
        if jump.joined {
            joins.push(jump.window + 1);
        }
        run.record_end += lost_s;
    }
    for k in joins.into_iter().rev() {
        run.windows.remove(k);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observe::observe;
    use std::f64::consts::TAU;
    use twum_record::measurement::{Direction, Run, RunData};

    const PITCH: f64 = TAU / 400.0;

    /// Angle of a rotor that turns a pitch in `slot_ms` on average, faster and slower with a PWM of 50 Hz.
    fn angle(t: f64, slot_ms: f64) -> f64 {
        PITCH / (1e-3 * slot_ms) * (t + 0.8 * (TAU * 50.0 * t).sin() / (TAU * 50.0))
    }

    /// Two seconds of it, sampled every millisecond; after 700 samples so many words are missing.
    fn turning(slot_ms: f64, words: usize) -> Observed {
        let seen = |k: usize| if k < 700 { k } else { k + 32 * words };
        let slot = |k: usize| (angle(1e-3 * (seen(k) as f64 + 0.5), slot_ms) / PITCH) as usize;
        let levels = (0..2000).map(|k| slot(k) % 2 == 1).collect();
        let data = RunData::Levels { start_us: 0.0, period_us: 1000.0, levels };
        let mut run = Run::new("r".to_owned(), RunKind::Speed, data);
        (run.duty, run.direction, run.drive_on_s) = (Some(1.0), Some(Direction::Cw), Some(3.0));
        observe(&run, 400).expect("it turns")
    }

    /// The same where the drive ends after `drive_s`.
    fn driven(slot_ms: f64, words: usize, drive_s: f64) -> Observed {
        Observed { drive_end: drive_s, ..turning(slot_ms, words) }
    }

    fn path(run: &Observed, slot_ms: f64) -> Option<Vec<Jump>> {
        followed(run, slot_ms, false).0
    }

    /// The cheapest gaps, and whether one is where the drive ends.
    fn followed(run: &Observed, slot_ms: f64, under_drive: bool) -> (Option<Vec<Jump>>, bool) {
        let shifted = |m: usize| run.times.iter().map(|t| angle(t + word_s(run) * m as f64, slot_ms)).collect();
        let angles: Vec<Vec<f64>> = (0..=MOST).map(shifted).collect();
        // Edges are seen up to a millisecond late at both ends.
        let variance = 2.0 * (PITCH / (1e-3 * slot_ms) * RPM * run.time_spread).powi(2) / (1e-3 * slot_ms);
        let followed = Followed { run, angles: angles.iter().collect(), variance, under_drive };
        let path = followed.path(6.0).map(|p| p.0);
        let ends = path.as_ref().is_some_and(|jumps| followed.ends_in(jumps));
        (path, ends)
    }

    /// Fails if words lost at once are not counted, if the edge that seems to be where the record was joined is taken for one, or if the time
    /// and the pitches are not put back.
    #[test]
    fn words_lost_at_once_are_put_back_with_an_odd_number_of_edges_or_an_even_one() {
        for (slot_ms, words) in [(23.3, 1), (23.3, 2), (17.7, 1), (31.4, 1), (31.4, 3), (9.7, 2), (6.1, 1)] {
            let mut run = turning(slot_ms, words);
            let jumps = path(&run, slot_ms).unwrap_or_default();
            assert_eq!(jumps.iter().map(|j| j.words).collect::<Vec<_>>(), [words], "{slot_ms} {jumps:?}");
            put_back(&mut run, &jumps);
            for w in run.windows.iter().filter(|w| w.low == w.high) {
                let turned = angle(run.times[w.to], slot_ms) - angle(run.times[w.from], slot_ms);
                assert!((turned - w.low).abs() < 0.5 * PITCH, "{slot_ms} {words} {w:?}: {turned}");
            }
            assert!(path(&run, slot_ms).is_none());
        }
    }

    /// The last edge but one is seen 70 % of a slot late. Fails if windows that are wild by themselves are a gap, though nothing that follows speaks
    /// for it.
    #[test]
    fn an_edge_seen_late_is_no_gap() {
        for slot_ms in [9.7, 15.9, 16.4, 17.7, 23.3, 31.4] {
            let mut run = turning(slot_ms, 0);
            let exact: Vec<usize> =
                (0..run.windows.len()).filter(|k| run.windows[*k].low == run.windows[*k].high).collect();
            let late = run.windows[exact[exact.len() - 2]].to;
            run.times[late] += 0.7e-3 * slot_ms;
            assert_eq!(path(&run, slot_ms), None, "{slot_ms}");
        }
    }

    /// A word is lost after 0.7 s. Fails if that is where the drive ends though a period of it follows, or is not though none does; or if a
    /// gap is found there where none is looked for.
    #[test]
    fn a_gap_is_where_the_drive_ends_if_no_period_follows_it() {
        let is_there = |drive_s: f64, under_drive: bool| {
            let (jumps, ends) = followed(&driven(17.7, 1, drive_s), 17.7, under_drive);
            assert_eq!(jumps.map_or(0, |j| j.len()), 1);
            ends
        };
        assert_eq!([is_there(0.8, false), is_there(0.74, false), is_there(0.74, true)], [false, true, false]);
    }

    /// Fails if a record without a gap has one.
    #[test]
    fn nothing_is_put_into_a_whole_record() {
        for slot_ms in [6.1, 17.7, 31.4] {
            assert_eq!(path(&turning(slot_ms, 0), slot_ms), None);
        }
    }

    /// Fails if a small gain is passed over beside what is not known yet, though every run has it, or counts though one alone has; or if so little is
    /// enough beside what was found.
    #[test]
    fn little_is_enough_beside_what_is_not_known_yet_alone() {
        let enough = |after: [f64; 4]| {
            let pairs = after.map(|after| [1.0, after]).to_vec();
            let held = HeldOut { loss: pairs.clone(), plain: pairs, seconds: vec![1.0; 4] };
            [Beside::Unknown, Beside::Found].map(|beside| is_enough(held.gain(), held.gain_interval(1), beside))
        };
        assert_eq!(enough([0.98; 4]), [true, false]);
        assert_eq!(enough([1.0, 1.0, 1.0, 0.92]), [false, false]);
        assert_eq!(enough([1.0, 1.0, 1.0, 0.5]), [true, true]);
    }
}
