//! What a search finds: evidence for and against effects, and what lives where nothing explains it.

/// How a cause is called.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// All conditions hold.
    Named,
    /// Real, but another cause explains it as well.
    Ambiguous,
    /// Looked for, not supported.
    Rejected,
}

/// What is noted of an effect beside which more is left than may stay beside a cause.
pub const NOT_ALL: &str = "explains part of it, but more is there that it does not explain: not the cause";

/// An estimated parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Name in the JSON.
    pub name: String,
    /// Value.
    pub value: f64,
    /// 95 % interval.
    pub interval: [f64; 2],
    /// Unit.
    pub unit: String,
}

/// One effect's evidence.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// Name of the effect.
    pub name: String,
    /// Verdict on it.
    pub status: Status,
    /// Probability that it is there, where sets of effects were weighed.
    pub probability: Option<f64>,
    /// Held-out gain: with it against without it, beside all else that was found.
    pub gain: f64,
    /// Its 95 % interval.
    pub gain_interval: [f64; 2],
    /// Share of null data sets in which some candidate does as well.
    pub p_null: f64,
    /// Parameters.
    pub parameters: Vec<Estimate>,
    /// Effects that explain the data as well.
    pub conflicts: Vec<String>,
    /// What would decide.
    pub next_experiment: String,
    /// Share of the baseline's squared error it removes (Shapley).
    pub share: f64,
    /// Why it was not taken, or what is special.
    pub note: String,
}

/// A term without physics that still explains something.
#[derive(Debug, Clone, PartialEq)]
pub struct Unknown {
    /// Where it lives: "time", "angle", ...
    pub lives_in: &'static str,
    /// Held-out gain on top of the extended model.
    pub gain: f64,
    /// Share of all squared error that was removed that it removes.
    pub share: f64,
    /// Its p-value.
    pub p_null: f64,
}

/// What lives where no effect explains it, in words and numbers. It is no cause: it says how the runs are, and not why.
#[derive(Debug, Clone, PartialEq)]
pub struct Described {
    /// Over what: the words of [`Unknown::lives_in`], with the plain name of the coordinate in them.
    pub coordinate: String,
    /// What the model gains by it.
    pub equation: String,
    /// Its numbers, in the order of the coordinate; relative changes of the speed where their unit is 1.
    pub parameters: Vec<Estimate>,
    /// Held-out gain on top of the extended model.
    pub gain: f64,
    /// The same for the motor model.
    pub curve: Curve,
}

/// A relative change of the speed over what the motor model's formulas know.
#[derive(Debug, Clone, PartialEq)]
pub enum Curve {
    /// At times since the drive began in s, in between linear.
    Time(Vec<[f64; 2]>),
    /// At duties, in between linear.
    Duty(Vec<[f64; 2]>),
    /// Where the direction is positive; the opposite in the other one.
    Direction(f64),
    /// The same at duties, in between linear.
    DutyAndDirection(Vec<[f64; 2]>),
    /// The same at times since the drive began in s, in between linear.
    TimeAndDirection(Vec<[f64; 2]>),
    /// Orders of a turn with amplitude and phase (rad): `amplitude·cos(order·angle − phase)`.
    Angle(Vec<[f64; 3]>),
    /// Cycles a second with amplitude and phase (rad): `amplitude·cos(2π·cycles·time − phase)`.
    Cycle(Vec<[f64; 3]>),
    /// Over something else.
    Elsewhere,
}
