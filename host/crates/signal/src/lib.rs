//! From the encoder line to position and speed.
//!
//! ```
//! use twum_record::measurement::Direction;
//! use twum_signal::edges::{Directions, EdgeTrain};
//! use twum_signal::smoother::smooth;
//!
//! // A line sampled at 1 kHz that changes every 15 ms, 400 edges a turn: 10 rpm.
//! let levels: Vec<bool> = (0..3000).map(|i| (i / 15) % 2 == 1).collect();
//! let train = EdgeTrain::from_levels(0.0, 1000.0, &levels, 400, &Directions::constant(Direction::Cw))?;
//! let found = smooth(&train, &[1_500_000.0])?;
//! assert!((found.speed_rpm[0] - 10.0).abs() < 0.1);
//! # Ok::<(), twum_signal::SignalError>(())
//! ```
//!
//! [`edges`] turns samples or timestamps into crossings of known angles and the interval each crossing is known to lie
//! in. [`smoother`] is the estimator to use: it takes those intervals as they are, adapts to how fast the speed changes
//! and says how sure it is. [`course`] reads a run's figures off a motion. [`thesis`] is the
//! thesis's method, kept to reproduce its figures; [`window`] is one fixed window, the yardstick for both. [`spectrum`] and [`turn`] show what repeats in time and in angle. `docs/signals.md`
//! compares the estimators.

pub mod course;
pub mod edges;
pub mod filters;
pub mod run;
pub mod score;
pub mod smoother;
pub mod spectrum;
pub mod spline;
pub mod thesis;
pub mod trial;
pub mod turn;
pub mod window;

/// Revolutions a minute in a radian a second.
pub const RAD_S_TO_RPM: f64 = 30.0 / std::f64::consts::PI;

/// Why a signal could not be estimated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SignalError {
    /// A filter's corner lies outside what its sampling rate allows.
    #[error(
        "a corner of {cutoff_hz} Hz cannot be filtered at {sample_rate_hz} samples/s: take one above 0 and below half of that"
    )]
    Cutoff {
        /// Corner asked for, in Hz.
        cutoff_hz: f64,
        /// Sampling rate, in Hz.
        sample_rate_hz: f64,
    },
    /// A record too short for a method.
    #[error("{samples} samples are too few for the {stage}: it takes {needed}")]
    TooShort {
        /// Samples given.
        samples: usize,
        /// Samples needed.
        needed: usize,
        /// What needs them.
        stage: &'static str,
    },
    /// A number that must be finite and above zero is not.
    #[error("{name} is {value}: it must be a finite number above zero")]
    NotPositive {
        /// What it is.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// More samples than an estimate may have.
    #[error("{samples} samples are asked for, {most} are the most: take a longer period")]
    TooMany {
        /// Samples asked for.
        samples: usize,
        /// The bound.
        most: usize,
    },
    /// More samples than a record may have.
    #[error(transparent)]
    Samples(#[from] twum_record::convert::TooManySamples),
    /// More PWM periods than can be simulated.
    #[error(
        "it ends {periods:.0} PWM periods after t = 0, {most:.0} are the most to simulate for its samples: let its times \
         begin at 0, or is one wrong?"
    )]
    TooLong {
        /// Periods from t = 0 to the end of the run.
        periods: f64,
        /// The bound.
        most: f64,
    },
    /// Not enough rotation.
    #[error("{turns:.2} turns are too few: what varies over a turn shows after one turn at the earliest")]
    TooFewTurns {
        /// Turns in the record.
        turns: f64,
    },
    /// More rotation than the samples can show.
    #[error("{turns:.3e} turns in {samples} samples: no more than one turn in two of them can be seen")]
    TooManyTurns {
        /// Turns in the record.
        turns: f64,
        /// Samples of it.
        samples: usize,
    },
    /// A count that moves faster than any encoder.
    #[error("the count goes from {from} to {to} in one step (row {index}): that is no encoder's")]
    Jump {
        /// Row of the later count, from 0.
        index: usize,
        /// Count before.
        from: f64,
        /// Count after.
        to: f64,
    },
    /// A run without encoder data.
    #[error("the run holds neither encoder data (levels, edges, packed, control) nor speed")]
    NoEncoder,
    /// Times that do not increase.
    #[error("time {time_us} µs (entry {index}) does not come after the one before it")]
    Time {
        /// Place in the list, from 0.
        index: usize,
        /// The time, in µs.
        time_us: f64,
    },
}

fn check_positive(name: &'static str, value: f64) -> Result<(), SignalError> {
    if value.is_finite() && value > 0.0 { Ok(()) } else { Err(SignalError::NotPositive { name, value }) }
}
