//! Terms without physics: where the model is wrong when no effect of the library says why.

use super::design::{Basis, Column};
use super::library::{Coordinate, LEAST_TURNS};
use super::problem::Problem;

/// A smooth family of coefficients over one coordinate.
#[derive(Debug, Clone, PartialEq)]
pub struct Term {
    /// The coordinate, in words.
    pub lives_in: &'static str,
    /// Its columns.
    pub columns: Vec<Column>,
    /// Over what the library's effects act that show there, if any do.
    pub coordinates: &'static [Coordinate],
    /// Whether every run has coefficients of its own.
    pub own: bool,
    /// Whether its columns are pairs of cosine and sine.
    pub harmonic: bool,
    /// Among how many such terms it was chosen for the data.
    pub among: usize,
}

/// What a term without physics costs in nats: a cause of the library is the likelier explanation by far, but not beyond all evidence.
pub const TERM_COST: f64 = 10.0;
/// The same where an effect of the library acts over the term's coordinate: there the term is a form of that effect that nobody knows.
pub const FREE_FORM_COST: f64 = 20.0;

/// Standard deviation of a common coefficient, as a share of the speed.
pub const SIZE: f64 = 0.1;

/// Knots of a course over the time that runs of a direction share: it may bend either way.
const COURSE_KNOTS: usize = 4;

/// Milliseconds of a pulse that are told apart: what rings at 80 Hz or more has a period in them.
const PULSE_MS: usize = 12;

/// Knots of a run's own wander in time.
const WANDER_KNOTS: usize = 16;

impl Term {
    /// One whose coefficients all runs share.
    fn common(lives_in: &'static str, columns: Vec<Column>, coordinates: &'static [Coordinate]) -> Self {
        Self { lives_in, columns, coordinates, own: false, harmonic: false, among: 1 }
    }

    /// Cosine and sine, of which every run has its own.
    pub fn harmonic(lives_in: &'static str, bases: Vec<Basis>, coordinates: &'static [Coordinate]) -> Self {
        Self { own: true, harmonic: true, ..Self::common(lives_in, flexible(bases), coordinates) }
    }
}

/// The terms that these runs can show.
pub fn terms(problem: &Problem) -> Vec<Term> {
    let levels = problem.runs.iter().any(|r| r.level.iter().any(|l| *l != 0));
    let course = |knots: usize| flexible((0..knots).map(|j| Basis::Time(j, knots)).collect());
    let mut all = vec![
        Term::common("time", course(6), &[Coordinate::Start]),
        Term { own: true, ..Term::common("time, each run its own", course(WANDER_KNOTS), &[]) },
    ];
    all.extend(of_directions(problem));
    if problem.pulsed() {
        all.extend(of_pulses());
    }
    if levels {
        all.push(Term::common("encoder slots", flexible(vec![Basis::Slot]), &[Coordinate::Slots]));
    }
    if problem.most_turns() > LEAST_TURNS {
        let pair = |order: usize| [0, 1].map(|quarter| Basis::Angle(order as f64, quarter));
        let orders = |from: usize, to: usize| (from..=to).flat_map(pair).collect();
        all.push(Term::harmonic("angle", orders(1, 2), &[Coordinate::Angle]));
        all.push(Term::harmonic("angle, three and more times a turn", orders(3, 8), &[]));
        all.push(Term::harmonic("angle, nine and more times a turn", orders(9, 16), &[]));
    }
    all
}

/// Runs of either kind from which what they differ by is seen to be theirs.
const FEWEST_OF_A_KIND: usize = 2;

/// The terms of runs that go either way: over the time, and after a change of the way.
fn of_directions(problem: &Problem) -> Vec<Term> {
    let both = |way: Vec<bool>| {
        let of = way.iter().filter(|w| **w).count();
        of.min(way.len() - of) >= FEWEST_OF_A_KIND
    };
    let course = |lives_in: &'static str, basis: fn(usize, usize) -> Basis| {
        Term::common(lives_in, flexible((0..COURSE_KNOTS).map(|j| basis(j, COURSE_KNOTS)).collect()), &[])
    };
    let mut all = Vec::new();
    if both(problem.runs.iter().map(|r| r.direction < 0.0).collect()) {
        all.push(course("direction, over the time", Basis::Heading));
    }
    if both(problem.reversed()) {
        all.push(course("direction of the run before, over the time", Basis::Reversed));
    }
    all
}

/// The terms of a drive that is switched within the PWM period.
fn of_pulses() -> [Term; 5] {
    let phases = (0..8).map(|j| Basis::Phase(j, 8)).collect();
    let periods = [2, 3, 4].into_iter().flat_map(|n| [0, 1].map(|quarter| Basis::Periods(n, quarter))).collect();
    let pulse = (0..PULSE_MS).map(Basis::Pulse).collect();
    let lags = (0..6).map(|j| Column::Lag(j, 6)).collect();
    [
        Term::common("PWM phase", flexible(phases), &[Coordinate::Pulse]),
        Term::common("PWM phase, within the pulse", flexible(pulse), &[Coordinate::Pulse]),
        Term::common("PWM phase, from period to period", flexible(periods), &[]),
        Term::common("timing against the PWM", lags, &[Coordinate::Clock]),
        Term::common("the milliseconds after switching", switching(), &[Coordinate::Pulse]),
    ]
}

/// Columns of such functions.
pub fn flexible(bases: Vec<Basis>) -> Vec<Column> {
    bases.into_iter().map(Column::Flexible).collect()
}

/// Columns of the free speed in each of the first milliseconds after each switching.
pub fn switching() -> Vec<Column> {
    [true, false]
        .into_iter()
        .flat_map(|rise| (0..3).map(move |k| Column::Flexible(Basis::AfterSwitching(rise, k))))
        .collect()
}
