//! The comparison itself: residuals of every window for given parameters, and their derivatives.

use super::observe::{Observed, one_of_each, shorten};
use super::rotor::{P, Parameters, RunInput, RunTerms, Trajectory, Wheel, simulate, warm_up};
use rayon::prelude::*;
use std::borrow::Cow;
use std::f64::consts::TAU;
use std::sync::Arc;
use twum_motor::hypothesis::Hypothesis;
use twum_record::measurement::RunKind;

/// rad/s to revolutions a minute.
pub const RPM: f64 = 60.0 / TAU;

/// The first seconds of a run that tell one kind of motor from another: a rotor that coasts has stopped.
const FIRST_S: f64 = 2.5;

/// The measured runs as one fitting problem.
#[derive(Debug, Clone)]
pub struct Problem {
    /// The runs.
    pub runs: Vec<Observed>,
    /// Revolutions made before each run (in the order of making; 0 without one).
    revolutions_before: Vec<f64>,
    /// Run indices in the order of making, if every run states it.
    sequence: Option<Vec<usize>>,
    /// Effects that are formulas: of the library, and the user's own.
    pub formulas: Vec<Arc<Hypothesis>>,
}

/// A model: common parameters and what belongs to single runs.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Parameters of the rotor and the effects.
    pub parameters: Parameters,
    /// One entry a run.
    pub terms: Vec<RunTerms>,
}

/// Residuals of one run.
#[derive(Debug, Clone, Default)]
pub struct RunResidual {
    /// Measured minus predicted mean speed of each window in rpm.
    pub rpm: Vec<f64>,
    /// Predicted mean speed of each window in rpm.
    pub predicted: Vec<f64>,
    /// What the simulated rotor did.
    pub trajectory: Trajectory,
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
        Self { runs, revolutions_before, sequence, formulas: Vec::new() }
    }

    /// The same runs, and effects that are formulas.
    pub fn with(self, formulas: Vec<Arc<Hypothesis>>) -> Self {
        Self { formulas, ..self }
    }

    /// The same runs compared over stretches of several edges, see [`Observed::widen`].
    pub fn widened(mut self) -> Self {
        self.runs.iter_mut().for_each(Observed::widen);
        self
    }

    /// One repetition of each kind of run, the first seconds of each: enough to tell one kind of motor from another.
    pub fn thinned(&self) -> Self {
        self.less(|runs| {
            one_of_each(runs);
            shorten(runs, FIRST_S);
        })
    }

    /// One repetition of each kind of run.
    pub fn one_of_each(&self) -> Self {
        self.less(one_of_each)
    }

    fn less(&self, leave_out: fn(&mut Vec<Observed>)) -> Self {
        let mut runs = self.runs.clone();
        leave_out(&mut runs);
        Self::new(runs).with(self.formulas.clone())
    }

    /// A model with what belongs to those of its runs that are also in `few`.
    pub fn of_the_runs_of(&self, few: &Self, model: &Model) -> Model {
        let terms_of = |run: &Observed| {
            self.runs.iter().position(|own| own.id == run.id && own.order == run.order).map(|i| model.terms[i])
        };
        let terms = few.runs.iter().map(|run| terms_of(run).unwrap_or_default()).collect();
        Model { parameters: model.parameters.clone(), terms }
    }

    /// How many windows are compared.
    pub fn windows(&self) -> f64 {
        self.runs.iter().map(|r| r.windows.len() as f64).sum()
    }

    /// Edges of the encoder a turn; none where the data carry speed instead.
    pub fn edges_per_rev(&self) -> Option<u32> {
        let pitch = self.runs.iter().map(|r| r.pitch).find(|pitch| *pitch > 0.0)?;
        Some((TAU / pitch).round() as u32)
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

    /// Which runs go another way than the one made before them; none where the order or the directions are unknown.
    pub fn reversed(&self) -> Vec<bool> {
        let mut reversed = vec![false; self.runs.len()];
        for (before, now) in self.sequence.iter().flat_map(|s| s.iter().zip(s.iter().skip(1))) {
            let [before, run] = [before, now].map(|i| &self.runs[*i]);
            let known = before.direction_known && run.direction_known;
            reversed[*now] = known && before.direction * run.direction < 0.0;
        }
        reversed
    }

    /// Whether a drive is switched within its PWM periods.
    pub fn pulsed(&self) -> bool {
        self.runs.iter().any(|r| r.kind == RunKind::Track || r.duty.is_some_and(|d| d > 0.0 && d < 1.0 - 1e-9))
    }

    /// How many duties the open-loop runs have.
    pub fn duties(&self) -> usize {
        let mut duties: Vec<f64> = self.runs.iter().filter_map(|r| r.duty).collect();
        duties.sort_by(f64::total_cmp);
        duties.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
        duties.len()
    }

    /// Revolutions made during the longest way of a run.
    pub fn most_turns(&self) -> f64 {
        self.runs.iter().map(Observed::revolutions).fold(0.0, f64::max)
    }

    /// A model without run terms.
    pub fn model(&self, parameters: Parameters) -> Model {
        Model { parameters, terms: vec![RunTerms::default(); self.runs.len()] }
    }

    /// Warmth each run starts with.
    pub(super) fn warmth(&self, p: &Parameters) -> Vec<f64> {
        let mut start = vec![0.0; self.runs.len()];
        let carry = p.get(P::HeatCarry);
        if let Some(sequence) = &self.sequence
            && carry > 0.0
            && p.warms()
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

    /// What the slots of every run's encoder show of the simulated rotor's angle at its measured times, in rad. A wheel's error is left out: its phase
    /// in each run was fitted where lost words were put back, which is what is asked with these angles.
    pub fn angles(&self, model: &Model) -> Vec<Vec<f64>> {
        let warmth = self.warmth(&model.parameters);
        let p = &model.parameters;
        let one = |i: usize| {
            let angle = simulate(&self.input(i, warmth[i]), p, &model.terms[i]).angle;
            self.shown(i, &angle, p, &RunTerms::default()).into_owned()
        };
        (0..self.runs.len()).into_par_iter().map(one).collect()
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
            formulas: &self.formulas,
        }
    }

    pub(super) fn run_residual(&self, i: usize, p: &Parameters, terms: &RunTerms, warmth: f64) -> RunResidual {
        self.compared(i, simulate(&self.input(i, warmth), p, terms), p, terms)
    }

    /// What the encoder of run `i` shows of a rotor's trajectory, held against what was recorded.
    pub(super) fn compared(&self, i: usize, trajectory: Trajectory, p: &Parameters, terms: &RunTerms) -> RunResidual {
        let run = &self.runs[i];
        let angle = &trajectory.angle;
        let [mut rpm, mut predicted] = [(); 2].map(|()| Vec::with_capacity(run.windows.len()));
        let shown = self.shown(i, angle, p, terms);
        let track = run.kind == RunKind::Track;
        let backlash = p.get(P::Backlash);
        let miscount = p.get(P::Miscount);
        let drift = p.get(P::MiscountDrift);
        let first = 1.0 + p.get(P::Hysteresis);
        for w in &run.windows {
            let exact = w.low == w.high;
            let of = if exact { &shown } else { angle.as_slice() };
            let mut advance = of[w.to] - of[w.from];
            if exact && track && (backlash != 0.0 || miscount != 0.0 || drift != 0.0) {
                // Thousands in a loop that chatters: they are sorted by time.
                let until = |t: f64| run.reversals.partition_point(|r| r.0 <= t);
                for (_, sign) in &run.reversals[until(run.times[w.from])..until(run.times[w.to])] {
                    advance += (sign * miscount + drift) * run.pitch - sign * backlash;
                }
            }
            // Up to the first edge the rotor turned a pitch at most, and by how much the comparator hangs back.
            let most = if !exact && w.from == 0 { first } else { 1.0 };
            let measured = advance.clamp(most * w.low, most * w.high);
            let dt = run.duration(w).max(1e-6);
            rpm.push((measured - advance) / dt * RPM);
            predicted.push(advance / dt * RPM);
        }
        RunResidual { rpm, predicted, trajectory }
    }

    /// The rotor's angles as the encoder of run `i` shows them where edges are seen: slots that differ, and a wheel that is off its centre.
    fn shown<'a>(&self, i: usize, angle: &'a [f64], p: &Parameters, terms: &RunTerms) -> Cow<'a, [f64]> {
        let run = &self.runs[i];
        let offset = p.get(P::EdgeOffset) * run.pitch * 0.5 * run.direction;
        let wheel = terms.eccentricity.iter().any(|c| *c != 0.0).then(|| Wheel::new(&terms.eccentricity));
        if offset == 0.0 && wheel.is_none() {
            return Cow::Borrowed(angle);
        }
        let error = |k: usize| wheel.as_ref().map_or(0.0, |wheel| wheel.error(run.angles[k]));
        angle.iter().enumerate().map(|(k, a)| a + offset * f64::from(run.level[k]) + error(k)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if a run goes with what belongs to another, also where two folders call their runs the same.
    #[test]
    fn each_run_keeps_what_belongs_to_it() {
        let run = |order: u32| Observed { id: "run".to_owned(), order: Some(order), ..Observed::unrecorded() };
        let problem = Problem::new((0..3).map(run).collect());
        let mut model = problem.model(Parameters::new(3.6, 1900.0, 1900.0, 0.3, 0.02));
        (0..3).for_each(|k| model.terms[k].runout[0] = k as f64);
        let few = Problem::new(vec![run(2), run(1)]);
        let own = problem.of_the_runs_of(&few, &model).terms;
        assert_eq!(own.iter().map(|t| t.runout[0]).collect::<Vec<_>>(), [2.0, 1.0]);
    }

    /// Fails if a rotor that starts the other way, whose first edge comes up to a pitch late by the comparator's hysteresis, is said to have been
    /// slow until then.
    #[test]
    fn a_comparator_that_hangs_back_makes_no_rotor_slow() {
        let (speed, hysteresis) = (2.0, 0.35_f64);
        for (direction, start) in [1.0, -1.0].into_iter().flat_map(|d| (0..20).map(move |k| (d, 0.05 * f64::from(k)))) {
            let mut run = Observed { direction, ..Observed::unrecorded() };
            // In pitches; the level is a sine's, whose sign it takes once the sine is beyond the threshold.
            let pitch = run.pitch;
            let at = |t: f64| start + direction * speed * t / pitch;
            let sine = |t: f64| (std::f64::consts::PI * at(t)).sin();
            let threshold = (0.5 * std::f64::consts::PI * hysteresis).sin();
            let initial = sine(0.0) > 0.0;
            let (mut level, mut edges) = (initial, Vec::new());
            for t in (1..50_000).map(|k| 1e-5 * f64::from(k)) {
                if (if level { -sine(t) } else { sine(t) }) > threshold {
                    level = !level;
                    edges.push((t, level));
                }
            }
            run.put_edges(&edges, initial, 0.0, 0.5);
            let angle = run.times.iter().map(|t| (at(*t) - start) * pitch).collect();
            let problem = Problem::new(vec![run]);
            let p = Parameters::new(3.6, 1900.0, 1900.0, 0.3, 0.02).with(P::Hysteresis, hysteresis);
            let seen = problem.compared(0, Trajectory { angle, ..Trajectory::default() }, &p, &RunTerms::default());
            let worst = seen.rpm.iter().map(|rpm| rpm.abs()).fold(0.0, f64::max);
            assert!(worst < 0.1, "{direction} from {start}: {worst} rpm of {:.0}", speed * RPM);
        }
    }
}
