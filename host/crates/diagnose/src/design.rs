//! The residuals' derivatives: by parameters, by what belongs to single runs, over functions without physics.

use super::observe::Window;
use super::problem::{Model, Problem, RPM, RunResidual};
use super::rotor::{P, Parameters, RunTerms, Trajectory, effective_duty, placed};
use rayon::prelude::*;
use std::borrow::Cow;
use std::f64::consts::{FRAC_PI_2, TAU};
use twum_record::measurement::RunKind;

/// A change of the delay over time that is small against the windows (s), and the unit of its column (s).
const LATER_S: [f64; 2] = [5e-4, 1e-2];

/// Largest rhythm of the angle, as a share of speed or torque, beside which a derivative by a common parameter is that without it: it is wrong by
/// as much of itself, by twice as much where the square of the speed counts (braking), and what it tells of the data by the square of that, some
/// hundredths.
const SMALL_RHYTHM: f64 = 0.1;

/// A direction in parameter space along which residuals are differentiated.
#[derive(Debug, Clone, PartialEq)]
pub enum Column {
    /// A common parameter; other parameters are first set as listed (shape of the effect).
    Scalar {
        /// What is varied.
        parameter: P,
        /// Size of one unit of the column.
        scale: f64,
        /// Finite step, in units of the parameter.
        step: f64,
        /// Shape parameters set before.
        shape: Vec<(P, f64)>,
    },
    /// The delay of the record behind the drive, by a hundredth of a second, in hat `k` of `n` over time.
    Lag(usize, usize),
    /// A coefficient of [`super::rotor::RunTerms::runout`].
    Runout(usize),
    /// A coefficient of [`super::rotor::RunTerms::eccentricity`].
    Eccentricity(usize),
    /// A coefficient of [`super::rotor::RunTerms::gravity`].
    Gravity(usize),
    /// A phased coefficient with parameters first set as listed (shape of the effect).
    Shaped(Box<Column>, Vec<(P, f64)>),
    /// Relative speed error times a basis function of the window, for terms that stand for no physics.
    Flexible(Basis),
}

/// Basis functions of the flexible terms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Basis {
    /// Hat `k` of `n` over the time since the start of the drive (0 to the longest run).
    Time(usize, usize),
    /// Hat `k` of `n` over the phase in the PWM period (cyclic).
    Phase(usize, usize),
    /// The cosine (0) or the sine (1) that repeats every so many PWM periods, averaged over the window.
    Periods(u8, u8),
    /// The sign of the slot a window begins with, where it ends with one of the other kind.
    Slot,
    /// The cosine (0) or the sine (1) of so many times the measured angle.
    Angle(f64, u8),
    /// The cosine (0) or the sine (1) of so many cycles a second, averaged over the window.
    Cycle(f64, u8),
    /// Hat `k` of `n` over the time since the start of the drive, with the sign of the direction.
    Heading(usize, usize),
    /// The same hat, in the runs that go another way than the run before.
    Reversed(usize, usize),
    /// Millisecond `k` of each pulse, as long as the drive is on.
    Pulse(usize),
    /// The free speed, in millisecond `k` after each rise of the drive or (`false`) each fall: what the rotor equation leaves out of
    /// the wave's coming and going.
    AfterSwitching(bool, usize),
}

/// Weighted residuals and derivatives of one run.
#[derive(Debug, Clone)]
pub struct RunDesign {
    /// Number of columns.
    pub columns: usize,
    /// Row-major windows × columns, in rpm·√s.
    pub x: Vec<f64>,
    /// Residual (measured − predicted) in rpm·√s.
    pub y: Vec<f64>,
    /// Square root of each window's duration in √s.
    pub weight: Vec<f64>,
    /// Time compared in s; the mean squared residual is `Σy²/seconds`.
    pub seconds: f64,
}

impl Problem {
    /// Weighted residuals of every run and their derivatives by each column: rows are windows.
    pub fn design(&self, model: &Model, columns: &[Column]) -> Vec<RunDesign> {
        let around = Linearised::new(self, model, columns);
        (0..self.runs.len()).into_par_iter().map(|run| around.design(run)).collect()
    }
}

/// A model and what its derivatives are taken with.
struct Linearised<'a> {
    problem: &'a Problem,
    model: &'a Model,
    columns: &'a [Column],
    /// Warmth that each run starts with.
    warmth: Vec<f64>,
    /// The parameters that each scalar column moves.
    moved: Vec<Option<Moved>>,
    /// The longest drive (s).
    longest_s: f64,
    /// Which runs go another way than the one before.
    reversed: Vec<bool>,
}

/// A run as it is where its derivatives by common parameters are taken.
struct Surroundings<'a> {
    terms: RunTerms,
    now: Cow<'a, RunResidual>,
}

/// A parameter moved by a step, with the warmth that the runs then start with.
struct Moved {
    /// What it is moved from, where that is not the model itself.
    from: Option<(Parameters, Vec<f64>)>,
    to: (Parameters, Vec<f64>),
    per_step: f64,
}

/// A rhythm that is none, but there.
const NO_RHYTHM: f64 = 1e-12;

impl<'a> Linearised<'a> {
    fn new(problem: &'a Problem, model: &'a Model, columns: &'a [Column]) -> Self {
        let with_warmth = |p: Parameters| {
            let warmth = problem.warmth(&p);
            (p, warmth)
        };
        let moved = |column: &Column| match column {
            Column::Scalar { parameter, scale, step, shape } => {
                let from = shape.iter().fold(model.parameters.clone(), |p, (which, value)| p.with(*which, *value));
                let to = from.with(*parameter, from.get(*parameter) + step);
                let is_model = shape.is_empty() || from.get(*parameter) == 0.0;
                Some(Moved {
                    from: (!is_model).then(|| with_warmth(from)),
                    to: with_warmth(to),
                    per_step: scale / step,
                })
            }
            _ => None,
        };
        Self {
            problem,
            model,
            columns,
            warmth: problem.warmth(&model.parameters),
            moved: columns.iter().map(moved).collect(),
            longest_s: problem.runs.iter().map(|r| r.drive_end).fold(0.0, f64::max).max(1e-6),
            reversed: problem.reversed(),
        }
    }

    fn design(&self, i: usize) -> RunDesign {
        let run = &self.problem.runs[i];
        let now = self.problem.run_residual(i, &self.model.parameters, &self.model.terms[i], self.warmth[i]);
        let around = self.surroundings(i, &now);
        let over_angle = self.over_angle(i, &now);
        let weight: Vec<f64> = run.windows.iter().map(|w| run.duration(w).max(0.0).sqrt()).collect();
        let width = self.columns.len();
        let mut x = vec![0.0; weight.len() * width];
        for c in 0..width {
            for (k, value) in self.column(i, c, &now, &around, &over_angle).into_iter().enumerate() {
                x[k * width + c] = weight[k] * value;
            }
        }
        let y = now.rpm.iter().zip(&weight).map(|(r, w)| r * w).collect();
        RunDesign { columns: width, x, y, weight, seconds: run.compared_s() }
    }

    /// Where common parameters are moved: beside a small rhythm of the angle, the same run without it, whose periods repeat each other.
    fn surroundings<'b>(&self, i: usize, now: &'b RunResidual) -> Surroundings<'b> {
        let terms = &self.model.terms[i];
        let rhythm = terms.runout.iter().chain(&terms.gravity).map(|c| c * c).sum::<f64>().sqrt();
        if rhythm == 0.0 || rhythm > SMALL_RHYTHM || self.problem.runs[i].kind == RunKind::Track {
            return Surroundings { terms: *terms, now: Cow::Borrowed(now) };
        }
        let terms = RunTerms { eccentricity: terms.eccentricity, ..RunTerms::default() };
        let now = Cow::Owned(self.problem.run_residual(i, &self.model.parameters, &terms, self.warmth[i]));
        Surroundings { terms, now }
    }

    /// Where what goes with the angle is moved: beside no rhythm of it, the same run with one that is nothing, whose periods are stepped one by one as
    /// they are beside any. What repeated periods differ by from these, a hundredth of a rhythm makes a hundred times as large.
    fn over_angle<'b>(&self, i: usize, now: &'b RunResidual) -> Cow<'b, RunResidual> {
        let terms = &self.model.terms[i];
        let moves = |c: &Column| matches!(c, Column::Runout(_) | Column::Gravity(_) | Column::Shaped(..));
        let repeats = terms.runout.iter().chain(&terms.gravity).all(|c| *c == 0.0);
        if !repeats || !self.columns.iter().any(moves) {
            return Cow::Borrowed(now);
        }
        let mut stepped = *terms;
        stepped.runout[0] = NO_RHYTHM;
        Cow::Owned(self.problem.run_residual(i, &self.model.parameters, &stepped, self.warmth[i]))
    }

    /// What a unit of column `c` adds to the predicted speed of each window of run `i`, rpm.
    fn column(
        &self,
        i: usize,
        c: usize,
        now: &RunResidual,
        around: &Surroundings,
        over_angle: &RunResidual,
    ) -> Vec<f64> {
        let run = &self.problem.runs[i];
        let p = &self.model.parameters;
        let change = |from: &RunResidual, to: &RunResidual, per: f64| -> Vec<f64> {
            from.rpm.iter().zip(&to.rpm).map(|(a, b)| (a - b) * per).collect()
        };
        match &self.columns[c] {
            Column::Scalar { .. } => {
                let Moved { from, to, per_step } = self.moved[c].as_ref().expect("every scalar column is moved");
                let at =
                    |(p, warmth): &(Parameters, Vec<f64>)| self.problem.run_residual(i, p, &around.terms, warmth[i]);
                match from {
                    None => change(&around.now, &self.moved_residual(i, &to.0, to.1[i], around), *per_step),
                    Some(from) => change(&at(from), &at(to), *per_step),
                }
            }
            Column::Lag(j, n) => {
                let [step_s, unit_s] = LATER_S;
                let later = p.with(P::Latency, p.get(P::Latency) + step_s);
                let later = self.moved_residual(i, &later, self.warmth[i], around);
                let at = run.windows.iter().map(|w| hat(*j, *n, w.middle(&run.times) / self.longest_s));
                change(&around.now, &later, unit_s / step_s)
                    .into_iter()
                    .zip(at)
                    .map(|(change, at)| change * at)
                    .collect()
            }
            Column::Eccentricity(_) => {
                let (terms, step) = self.phased_step(i, &self.columns[c]);
                change(now, &self.problem.compared(i, now.trajectory.clone(), p, &terms), 1.0 / step)
            }
            Column::Runout(_) | Column::Gravity(_) => {
                let (terms, step) = self.phased_step(i, &self.columns[c]);
                change(over_angle, &self.problem.run_residual(i, p, &terms, self.warmth[i]), 1.0 / step)
            }
            Column::Shaped(phased, shape) => {
                let shaped = shape.iter().fold(p.clone(), |q, (which, value)| q.with(*which, *value));
                let (terms, step) = self.phased_step(i, phased);
                change(over_angle, &self.problem.run_residual(i, &shaped, &terms, self.warmth[i]), 1.0 / step)
            }
            Column::Flexible(basis) => {
                let of = |(w, predicted): (&Window, &f64)| self.flexible(i, *basis, w, *predicted);
                run.windows.iter().zip(&now.predicted).map(of).collect()
            }
        }
    }

    /// The residuals of parameters `p` that differ in one from the model: what moves the record and not the rotor needs no simulation.
    fn moved_residual(&self, i: usize, p: &Parameters, warmth: f64, around: &Surroundings) -> RunResidual {
        let Surroundings { terms, now } = around;
        let here = &self.model.parameters;
        let moves = |which: P| p.get(which) != here.get(which);
        if [P::EdgeOffset, P::Backlash, P::Miscount, P::MiscountDrift, P::Hysteresis].into_iter().any(moves) {
            return self.problem.compared(i, now.trajectory.clone(), p, terms);
        }
        if [P::Latency, P::ClockError].into_iter().any(moves) {
            let clock = 1.0 + here.get(P::ClockError);
            let later =
                |t: &f64| (t - p.get(P::Latency)) / (1.0 + p.get(P::ClockError)) - (t - here.get(P::Latency)) / clock;
            let Trajectory { angle, speed } = &now.trajectory;
            let moved = self.problem.runs[i].times.iter().zip(angle).zip(speed).map(|((t, a), w)| a + w * later(t));
            let trajectory = Trajectory { angle: moved.collect(), speed: speed.clone() };
            return self.problem.compared(i, trajectory, p, terms);
        }
        // A duty that is mapped to the same one as before is the same drive: most of a coarse grid's treads are.
        let mapped = |duty: f64| effective_duty(duty, p) == effective_duty(duty, here);
        let by_the_duty_alone = || P::ALL.into_iter().all(|which| !moves(which) || P::OF_THE_DUTY.contains(&which));
        let no_formula = || placed(&self.problem.formulas).all(|(h, places)| !h.is_there(&p.of_formula(places)));
        if self.problem.runs[i].duty.is_some_and(mapped) && by_the_duty_alone() && no_formula() {
            return now.as_ref().clone();
        }
        self.problem.run_residual(i, p, terms, warmth)
    }

    /// What belongs to a run with one phased coefficient larger by a step, and the step.
    fn phased_step(&self, i: usize, column: &Column) -> (RunTerms, f64) {
        let mut terms = self.model.terms[i];
        let step = match column {
            Column::Runout(h) => {
                terms.runout[*h] += 0.01;
                0.01
            }
            Column::Eccentricity(h) => {
                terms.eccentricity[*h] += 1e-3;
                1e-3
            }
            Column::Gravity(h) => {
                terms.gravity[*h] += 0.01;
                0.01
            }
            _ => 1.0,
        };
        (terms, step)
    }

    /// What a function without physics adds to a window whose predicted speed is `predicted` (rpm).
    fn flexible(&self, i: usize, basis: Basis, w: &Window, predicted: f64) -> f64 {
        let run = &self.problem.runs[i];
        let time_s = w.middle(&run.times);
        let period_s = 1.0 / run.pwm_hz;
        let between = [run.times[w.from], run.times[w.to]];
        let duration_s = run.duration(w).max(1e-6);
        predicted
            * match basis {
                Basis::Time(j, n) => hat(j, n, time_s / self.longest_s),
                Basis::Phase(j, n) => cyclic_hat(j, n, time_s / period_s),
                Basis::Periods(n, quarter) => mean_cosine(between, 1.0 / (f64::from(n) * period_s), quarter),
                Basis::Cycle(hz, quarter) => mean_cosine(between, hz, quarter),
                Basis::Heading(j, n) => run.direction * hat(j, n, time_s / self.longest_s),
                Basis::Reversed(_, _) if !self.reversed[i] => 0.0,
                Basis::Reversed(j, n) => hat(j, n, time_s / self.longest_s),
                Basis::Slot => {
                    let slots = f64::from(run.level[w.from] - run.level[w.to]);
                    return run.direction * 0.5 * slots * run.pitch / duration_s * RPM;
                }
                Basis::Angle(order, quarter) => (order * w.middle(&run.angles) - FRAC_PI_2 * f64::from(quarter)).cos(),
                Basis::Pulse(j) => run.schedule.share_within_pulses(between, 1e-3 * j as f64, &self.model.parameters),
                Basis::AfterSwitching(rise, j) => {
                    let p = &self.model.parameters;
                    let share = run.schedule.share_after_switching(between, rise, 1e-3 * j as f64, p);
                    return run.direction * share * p.get(P::FreeSpeed) * RPM;
                }
            }
    }
}

/// The mean over some time of the cosine (0) or the sine (1) of so many cycles a second.
fn mean_cosine(between: [f64; 2], hz: f64, quarter: u8) -> f64 {
    let [from, to] = between.map(|t| TAU * hz * t - FRAC_PI_2 * f64::from(quarter));
    (to.sin() - from.sin()) / (to - from).max(1e-9)
}

/// Piecewise linear basis function `j` of `n` over 0..1.
fn hat(j: usize, n: usize, x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0) * (n - 1) as f64;
    (1.0 - (x - j as f64).abs()).max(0.0)
}

/// Piecewise linear basis function `j` of `n` over the fraction of a period.
fn cyclic_hat(j: usize, n: usize, periods: f64) -> f64 {
    let d = (periods.rem_euclid(1.0) * n as f64 - j as f64).rem_euclid(n as f64);
    (1.0 - d.min(n as f64 - d)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::super::observe::Observed;
    use super::super::rotor::Schedule;
    use super::*;

    /// A run of two seconds at half duty whose angle is known every ten milliseconds.
    fn run() -> Observed {
        let times: Vec<f64> = (0..200).map(|k| 0.01 * f64::from(k)).collect();
        Observed {
            schedule: Schedule::constant(0.5, 1.0, 50.0, 0.0, 2.0),
            drive_end: 2.0,
            angles: times.iter().map(|t| 1.8 * t).collect(),
            level: vec![0; times.len()],
            windows: (1..times.len()).map(|to| Window { from: to - 1, to, low: 0.018, high: 0.018 }).collect(),
            record_end: 2.0,
            times,
            ..Observed::unrecorded()
        }
    }

    /// How far a model's derivative is, as a share of itself, from the difference of two models that were simulated.
    fn share_off(problem: &Problem, model: &Model, parameter: P, step: f64) -> f64 {
        let column = Column::Scalar { parameter, scale: 1.0, step, shape: Vec::new() };
        let found = problem.design(model, &[column]).remove(0);
        let moved = |by: f64| {
            let parameters = model.parameters.with(parameter, model.parameters.get(parameter) + by);
            problem.residuals(&Model { parameters, terms: model.terms.clone() }).remove(0).predicted
        };
        let (more, less) = (moved(step), moved(-step));
        let own: Vec<f64> = more.iter().zip(less).map(|(a, b)| (a - b) / (2.0 * step)).collect();
        off(&own, &found)
    }

    /// The same of the first column of a design and the derivative `own`.
    fn off(own: &[f64], found: &RunDesign) -> f64 {
        let square = |x: &mut dyn Iterator<Item = f64>| x.map(|x| x * x).sum::<f64>();
        let off = square(&mut own.iter().zip(&found.x).zip(&found.weight).map(|((own, x), weight)| own - x / weight));
        (off / square(&mut own.iter().copied())).sqrt()
    }

    fn rotor() -> Parameters {
        Parameters::new(3.6, 900.0, 600.0, 0.3, 0.02).with(P::WaveTime, 4e-4)
    }

    /// Fails if a derivative beside a small rhythm is that of another drive, or one beside a large rhythm is taken without it.
    #[test]
    fn derivatives_beside_a_rhythm_are_those_of_the_run() {
        let problem = Problem::new(vec![run()]);
        for (rhythm, allowed) in [(0.08, 2.0 * 0.08), (0.4, 0.05)] {
            let mut model = problem.model(rotor());
            model.terms[0].runout[0] = rhythm;
            for (parameter, step) in [(P::FreeSpeed, 0.01), (P::OffDeceleration, 2.0), (P::DeadDuty, 1e-3)] {
                let share = share_off(&problem, &model, parameter, step);
                assert!(share < allowed, "{parameter:?} beside {rhythm}: {share} of itself");
            }
        }
    }

    /// Of a motor whose friction takes little from the speed. Fails if a runout is moved from periods that repeat each other, which are stepped beside
    /// any: by so many times what it does itself are the two then apart.
    #[test]
    fn a_runout_beside_none_has_its_own_derivative() {
        let schedule = Schedule::constant(0.9, 1.0, 100.0, 0.0, 2.0);
        let problem = Problem::new(vec![Observed { schedule, ..run() }]);
        let rotor = Parameters::new(3.6, 9000.0, 6000.0, 0.3, 0.02).with(P::WaveTime, 4e-4);
        let shape = [(P::RunoutSpeed, 0.0), (P::RunoutTorque, 1.0), (P::RunoutBrake, 1.0)];
        let model = problem.model(shape.iter().fold(rotor, |p, (which, value)| p.with(*which, *value)));
        for side in 0..2 {
            let column = Column::Shaped(Box::new(Column::Runout(side)), shape.to_vec());
            let found = problem.design(&model, &[column]).remove(0);
            let moved = |by: f64| {
                let mut moved = model.clone();
                moved.terms[0].runout[side] = by;
                problem.residuals(&moved).remove(0).predicted
            };
            let own: Vec<f64> = moved(0.01).iter().zip(moved(-0.01)).map(|(a, b)| (a - b) / 0.02).collect();
            let share = off(&own, &found);
            assert!(share < 0.05, "{share} of itself");
        }
    }

    /// Fails if a derivative beside warmth is that of a cold motor, or if what warmth changes is moved from one.
    #[test]
    fn derivatives_beside_warmth_are_those_of_the_run() {
        let problem = Problem::new(vec![run()]);
        for size in [0.08, 0.4] {
            for change in [P::HeatLoss, P::HeatFriction] {
                let model = problem.model(rotor().with(change, size).with(P::HeatTau, 0.5));
                for (parameter, step) in [(P::FreeSpeed, 0.01), (P::OffDeceleration, 2.0), (P::DeadDuty, 1e-3)] {
                    let share = share_off(&problem, &model, parameter, step);
                    assert!(share < 0.05, "{parameter:?} beside {change:?} {size}: {share} of itself");
                }
                for (parameter, step) in [(change, 1e-3), (P::HeatTau, 1e-3)] {
                    let share = share_off(&problem, &model, parameter, step);
                    assert!(share < 0.05, "{parameter:?} of {change:?} {size}: {share} of itself");
                }
            }
        }
    }
}
