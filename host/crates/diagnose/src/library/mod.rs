//! The library of effects as the search sees it: one file an effect.
//!
//! An effect is a family of forms. A form says which numbers of the rotor equation it changes, how large they may plausibly be
//! and what is known of its times before the data; which of the forms holds is decided by the data like everything else.

mod clock_error;
mod closed_loop;
mod contact_stiffening;
mod dead_zone;
mod direction_asymmetry;
mod duty_quantisation;
mod encoder_eccentricity;
mod formula;
mod frequency_settling;
mod high_duty_saturation;
mod preload_runout;
mod resonance_heating;
mod run_in_wear;
mod start_delay;
mod stribeck_friction;
mod supply_sag;
mod unequal_edges;

use super::design::Column;
use super::problem::Problem;
use super::rotor::{P, placed};
use std::borrow::Cow;
use std::sync::Arc;
use twum_motor::formula_file::shipped_effects;
use twum_motor::hypothesis::Hypothesis;
use twum_record::measurement::RunKind;

/// A belief about a positive number: a log-normal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LogNormal {
    /// Median, in the parameter's unit.
    pub median: f64,
    /// Standard deviation of the natural logarithm.
    pub log_sd: f64,
}

/// A number that makes the size of an effect; 0 means absent.
#[derive(Debug, Clone, PartialEq)]
pub struct Size {
    /// Where it lives.
    pub parameter: P,
    /// Standard deviation of what is plausible before the data.
    pub scale: f64,
    /// Finite step of the linear search: small for a derivative, the size itself for a secant.
    pub step: f64,
    /// Physically admissible range.
    pub bounds: (f64, f64),
}

/// A number that makes the form of an effect.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// Where it lives.
    pub parameter: P,
    /// Value in the linear search.
    pub start: f64,
    /// What is known of it; without, it stays at `start`.
    pub prior: Option<LogNormal>,
    /// Admissible range.
    pub bounds: (f64, f64),
}

/// What has a phase of its own in every run: the rotor's angle is unknown between runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phased {
    /// Drive modulation at a multiple of the angle (0: once a turn).
    Runout(usize),
    /// Encoder angle error at a multiple of the angle (0: once a turn).
    Eccentricity(usize),
    /// Load torque once a turn.
    Gravity,
}

impl Phased {
    /// The cosine and the sine as columns of a design.
    pub fn columns(self) -> [Column; 2] {
        match self {
            Phased::Runout(h) => [Column::Runout(2 * h), Column::Runout(2 * h + 1)],
            Phased::Eccentricity(h) => [Column::Eccentricity(2 * h), Column::Eccentricity(2 * h + 1)],
            Phased::Gravity => [Column::Gravity(0), Column::Gravity(1)],
        }
    }

    /// Which multiple of the angle a runout or an eccentric wheel acts at, less one.
    pub fn harmonic(self) -> Option<usize> {
        match self {
            Phased::Runout(h) | Phased::Eccentricity(h) => Some(h),
            Phased::Gravity => None,
        }
    }

    /// Its cosine and sine where `[c, s]` are those of the twin that changes the observed speed alike: a drive that is stronger by
    /// c·cos(kθ) + s·sin(kθ) moves the angle as a wheel that errs by the integral of that over θ.
    pub fn from_twin(self, [c, s]: [f64; 2]) -> [f64; 2] {
        match self {
            Phased::Eccentricity(h) => [-s / (h + 1) as f64, c / (h + 1) as f64],
            Phased::Runout(h) => [s * (h + 1) as f64, -c * (h + 1) as f64],
            Phased::Gravity => [c, s],
        }
    }
}

/// One way in which an effect may act.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Form {
    /// Numbers that make its size.
    pub sizes: Vec<Size>,
    /// Numbers that make its shape.
    pub shapes: Vec<Shape>,
    /// Pairs of cosine and sine.
    pub phased: Vec<Phased>,
}

/// A number of an effect as it is reported.
#[derive(Debug, Clone)]
pub struct Reported {
    /// Name in the JSON.
    pub name: Cow<'static, str>,
    /// Unit in the JSON.
    pub unit: Cow<'static, str>,
    /// Where it lives.
    pub parameter: P,
    /// What that is a share of.
    pub of: Option<P>,
}

/// Turns within a run from which what goes with the angle is looked for: over a third of one a cosine bends away from a straight line by up to
/// a quarter of its amplitude; over less each run has a slope of its own, which anything makes.
pub const LEAST_TURNS: f64 = 1.0 / 3.0;

/// What an effect needs in the data before it can be judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Need {
    /// Runs that are no closed loops.
    OpenLoop,
    /// Three duties, or a closed loop.
    ThreeDuties,
    /// Runs below full duty.
    PulsedDrive,
    /// Runs in both directions.
    BothDirections,
    /// Runs of more than [`LEAST_TURNS`].
    ThirdOfATurn,
    /// Closed-loop runs.
    ClosedLoop,
    /// Encoder edges with known levels.
    Levels,
    /// Encoder edges.
    Edges,
    /// The order of at least four runs.
    Order,
    /// A run of 0.8 s or more.
    LongRun,
}

/// Over what an effect shows. Two effects over one coordinate may be one whose form is not the library's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Coordinate {
    /// The duty.
    Duty,
    /// The time within a pulse of the drive.
    Pulse,
    /// The time since the start of a run, or since the motor was cold.
    Start,
    /// The runs, one after the other.
    Order,
    /// The direction.
    Direction,
    /// The angle of the rotor or the wheel.
    Angle,
    /// The slots of the wheel.
    Slots,
    /// The recorder's time.
    Clock,
    /// Reversals.
    Reversal,
}

impl Coordinate {
    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Duty => "duty",
            Self::Pulse => "PWM phase",
            Self::Start => "time",
            Self::Order => "order",
            Self::Direction => "direction",
            Self::Angle => "angle",
            Self::Slots => "encoder slots",
            Self::Clock => "timing against the PWM",
            Self::Reversal => "reversals",
        }
    }
}

/// An effect of the library.
#[derive(Debug, Clone)]
pub struct Effect {
    /// Name, as in the list of effects.
    pub name: Cow<'static, str>,
    /// One sentence for the text answer.
    pub says: Cow<'static, str>,
    /// What the model gains.
    pub equation: Cow<'static, str>,
    /// Over what it shows.
    pub coordinate: Coordinate,
    /// What the data have to show.
    pub needs: &'static [Need],
    /// Ways to act.
    pub forms: Vec<Form>,
    /// Parameters, sizes first.
    pub reported: Vec<Reported>,
    /// Effects that look alike.
    pub conflicts: &'static [&'static str],
    /// The cheapest experiment that separates it from them.
    pub next_experiment: &'static str,
}

/// What is found before the plant is fitted, in the record and in the controller, with the sentence and the equation of each.
const BEFORE_THE_PLANT: [(&str, &str, &str); 3] = [
    (
        "dropped-samples",
        "whole words of samples are missing, and what follows has moved up",
        "32 samples put back at each gap",
    ),
    (
        "loop-delay",
        "the control signal belongs to older samples than it was logged with",
        "u(k) computed from target and position of tick k − n",
    ),
    (
        "controller-mismatch",
        "the controller that ran is not the one stated: its gains differ",
        "u = (1 + p)·kp·e + (1 + i)·ki·Σe + (1 + d)·kd·Δe",
    ),
];

/// Names of all effects of a TWUM that can be found.
pub fn known_effects() -> Vec<String> {
    let early = BEFORE_THE_PLANT.iter().map(|e| e.0.to_owned());
    early.chain(library(&[], shipped_effects()).into_iter().map(|e| e.name.into_owned())).collect()
}

/// The sentence and the equation of an effect of the library, or of one of the `formulas`.
pub fn says(name: &str, formulas: &[Arc<Hypothesis>]) -> Option<(String, String)> {
    let early = BEFORE_THE_PLANT.iter().find(|e| e.0 == name).map(|e| (e.1.to_owned(), e.2.to_owned()));
    let of = |e: Effect| (e.says.into_owned(), e.equation.into_owned());
    early.or_else(|| library(&[], formulas).into_iter().find(|e| e.name == name).map(of))
}

/// The whole library. `clock_errors` are the relative errors at which the PWM's line stands out in the records; `formulas` are the effects
/// that are formulas.
pub fn library(clock_errors: &[f64], formulas: &[Arc<Hypothesis>]) -> Vec<Effect> {
    let known = vec![
        resonance_heating::effect(),
        frequency_settling::effect(),
        dead_zone::effect(),
        start_delay::effect(),
        duty_quantisation::effect(),
        high_duty_saturation::effect(),
        contact_stiffening::effect(),
        direction_asymmetry::effect(),
        preload_runout::effect(),
        encoder_eccentricity::effect(),
        unequal_edges::effect(),
        clock_error::effect(clock_errors),
        stribeck_friction::effect(),
        supply_sag::effect(),
        run_in_wear::effect(),
        closed_loop::gravity_load(),
        closed_loop::backlash(),
        closed_loop::reversal_miscount(),
        closed_loop::off_phase_braking(),
    ];
    known.into_iter().chain(placed(formulas).map(|(h, places)| formula::effect(h, places))).collect()
}

/// A form of one size and no shape.
fn one(parameter: P, scale: f64, step: f64, bounds: (f64, f64)) -> Form {
    Form { sizes: vec![Size { parameter, scale, step, bounds }], ..Form::default() }
}

/// A form of pairs alone.
fn phased(pairs: Vec<Phased>) -> Form {
    Form { phased: pairs, ..Form::default() }
}

impl Form {
    /// The form with the sizes of another as well.
    fn and(mut self, other: &Self) -> Self {
        self.sizes.extend(other.sizes.iter().cloned());
        self
    }

    /// The form with a shape that the data may move.
    fn shaped(mut self, parameter: P, start: f64, prior: LogNormal, bounds: (f64, f64)) -> Self {
        self.shapes.push(Shape { parameter, start, prior: Some(prior), bounds });
        self
    }

    /// The form with a shape that stays.
    fn pinned(mut self, parameter: P, value: f64) -> Self {
        self.shapes.push(Shape { parameter, start: value, prior: None, bounds: (value, value) });
        self
    }

    /// Whether two forms differ in more than where the linear search looks.
    pub fn differs(&self, other: &Self) -> bool {
        let pinned = |f: &Self| {
            f.shapes.iter().filter(|s| s.prior.is_none()).map(|s| (s.parameter, s.start)).collect::<Vec<_>>()
        };
        let free = |f: &Self| f.shapes.iter().filter(|s| s.prior.is_some()).map(|s| s.parameter).collect::<Vec<_>>();
        let sizes = |f: &Self| f.sizes.iter().map(|s| s.parameter).collect::<Vec<_>>();
        pinned(self) != pinned(other)
            || free(self) != free(other)
            || sizes(self) != sizes(other)
            || self.phased != other.phased
    }

    /// Whether it has the sizes and the shapes of another one and further ones, with the same phases.
    pub fn extends(&self, other: &Self) -> bool {
        let numbers = |f: &Self| f.numbers().collect::<Vec<P>>();
        let [own, others] = [numbers(self), numbers(other)];
        own.len() > others.len() && others.iter().all(|p| own.contains(p)) && self.phased == other.phased
    }

    /// What its sizes and its shapes are.
    fn numbers(&self) -> impl Iterator<Item = P> {
        self.sizes.iter().map(|s| s.parameter).chain(self.shapes.iter().map(|s| s.parameter))
    }

    /// Its sizes as columns of a design.
    pub fn columns(&self) -> Vec<Column> {
        let shape: Vec<(P, f64)> = self.shapes.iter().map(|s| (s.parameter, s.start)).collect();
        self.sizes
            .iter()
            .map(|s| Column::Scalar { parameter: s.parameter, scale: s.scale, step: s.step, shape: shape.clone() })
            .collect()
    }
}

impl Effect {
    /// Whether two effects do the same to the data but for their form: one thing seen from two sides, never both in a set.
    pub fn is_twin(&self, other: &Self) -> bool {
        let angle = |e: &Self| e.forms.iter().any(|f| f.phased.iter().any(|p| p.harmonic().is_some()));
        angle(self) && angle(other)
    }

    /// Whether two effects are mistaken for each other.
    pub fn looks_like(&self, other: &Self) -> bool {
        self.coordinate == Coordinate::Angle && other.coordinate == Coordinate::Angle
            || self.conflicts.contains(&other.name.as_ref())
            || other.conflicts.contains(&self.name.as_ref())
    }

    /// Whether it does what the library says and nothing else: it is the recorder's arithmetic, or the wheel's, and not the motor's.
    pub fn is_exact(&self) -> bool {
        matches!(self.coordinate, Coordinate::Clock | Coordinate::Slots)
    }

    /// Whether it acts in these runs, and they have too few duties to judge it by.
    pub fn acts_unseen(&self, problem: &Problem) -> bool {
        self.needs.contains(&Need::ThreeDuties) && not_judged(self, problem).is_some()
    }

    /// Whether the other, over duty or within pulses, would be named in its place where it cannot be judged.
    pub fn is_mistaken_over_duty_for(&self, other: &Self) -> bool {
        matches!(other.coordinate, Coordinate::Duty | Coordinate::Pulse) && self.looks_like(other)
    }

    /// In how many ways it may act that no parameter joins: a choice among them is a choice made on the data.
    pub fn ways(&self) -> usize {
        (0..self.forms.len()).filter(|k| self.forms[..*k].iter().all(|f| f.differs(&self.forms[*k]))).count()
    }
}

fn reported(name: &'static str, unit: &'static str, parameter: P) -> Reported {
    Reported { name: name.into(), unit: unit.into(), parameter, of: None }
}

/// Why an effect cannot be judged from these runs, if it cannot.
pub fn not_judged(effect: &Effect, problem: &Problem) -> Option<String> {
    let runs = &problem.runs;
    let any_track = runs.iter().any(|r| r.kind == RunKind::Track);
    let lacks = |need: &Need| -> Option<&'static str> {
        match need {
            Need::ThreeDuties => (problem.duties() < 3 && !any_track).then_some("needs at least three duties"),
            Need::PulsedDrive => (!problem.pulsed()).then_some("needs runs below full duty"),
            Need::BothDirections => {
                let both = runs.iter().any(|r| r.direction > 0.0) && runs.iter().any(|r| r.direction < 0.0);
                (!both && !any_track).then_some("needs runs in both directions")
            }
            Need::ThirdOfATurn => {
                (problem.most_turns() < LEAST_TURNS).then_some("needs runs of more than a third of a turn")
            }
            Need::OpenLoop => problem.closed().then_some("needs open-loop runs"),
            Need::ClosedLoop => (!any_track).then_some("needs closed-loop runs with reversals"),
            Need::Levels => {
                let levels = runs.iter().any(|r| r.pitch > 0.0 && r.level.iter().any(|l| *l != 0));
                (!levels).then_some("needs encoder edges")
            }
            Need::Edges => (!runs.iter().any(|r| r.pitch > 0.0)).then_some("needs encoder edges"),
            Need::Order => (!problem.ordered() || runs.len() < 4).then_some("needs the order of at least four runs"),
            Need::LongRun => (runs.iter().all(|r| r.record_end < 0.8)).then_some("needs runs of a second or more"),
        }
    };
    effect.needs.iter().find_map(lacks).map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if a form extends itself, one that has a number that it has not, or none that has its sizes and no shape.
    #[test]
    fn a_form_extends_those_whose_numbers_are_among_its_own() {
        let [speed, friction] = [P::AsymSpeed, P::AsymFriction].map(|p| one(p, 0.1, 0.01, (-1.0, 1.0)));
        let mut both = speed.clone();
        both.sizes.extend(friction.sizes.clone());
        assert!(both.extends(&speed) && both.extends(&friction));
        assert!(!speed.extends(&both) && !speed.extends(&friction) && !both.extends(&both));
        let shaped = both.clone().shaped(P::ClockTau, 1.0, LogNormal { median: 1.0, log_sd: 1.0 }, (0.1, 10.0));
        assert!(shaped.extends(&both) && shaped.extends(&speed) && !both.extends(&shaped));
        assert!(!both.extends(&speed.pinned(P::SettleOnTime, 1.0)));
    }

    /// Fails if a runout is put in a wheel's place with a sign or a harmonic wrong: the wheel's error grows by c·cos(kθ) + s·sin(kθ) a radian.
    #[test]
    fn twins_move_the_angle_alike() {
        for h in 0..3 {
            let k = (h + 1) as f64;
            let runout = [0.07, -0.02];
            let wheel = Phased::Eccentricity(h).from_twin(runout);
            let error = |theta: f64| wheel[0] * (k * theta).cos() + wheel[1] * (k * theta).sin();
            for theta in [0.3_f64, 1.9, 4.0] {
                let slope = (error(theta + 1e-5) - error(theta - 1e-5)) / 2e-5;
                let drive = runout[0] * (k * theta).cos() + runout[1] * (k * theta).sin();
                assert!((slope - drive).abs() < 1e-8, "{slope} {drive}");
            }
            let back = Phased::Runout(h).from_twin(wheel);
            assert!((back[0] - runout[0]).abs() + (back[1] - runout[1]).abs() < 1e-12);
        }
    }
}
