//! The suite: data sets of the generators through the `twum` command as a user calls it, and the tables of what came out.
//!
//! What may be looked at while priors and numbers of the diagnosis are chosen says docs/generators.md.

pub mod judge;
pub mod runner;
pub mod tables;

use crate::truth::{Kind, Made, Request};
use crate::{contact, envelope, first, profile, rotor};

/// The generators the suite knows.
pub const GENERATORS: [&str; 5] = ["a", "b", "c", "d", "e"];

/// One data set to be made and diagnosed.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Case {
    /// Which generator.
    pub generator: String,
    /// What for.
    pub kind: Kind,
    /// Its seed.
    pub seed: u64,
}

impl Case {
    /// Makes the data set.
    ///
    /// # Errors
    /// What the generator says.
    pub fn make(&self) -> Result<Made, String> {
        make(&self.generator, self.seed, &Request::of(self.kind), false)
    }

    /// Makes the data set of the same motor, experiment and noise with nothing hidden.
    ///
    /// # Errors
    /// What the generator says.
    pub fn make_clean(&self) -> Result<Made, String> {
        make(&self.generator, self.seed, &Request::of(self.kind), true)
    }
}

/// Makes what is asked of a generator, or the same with nothing hidden.
///
/// # Errors
/// What the generator says, or that there is none of that name.
pub fn make(generator: &str, seed: u64, request: &Request, clean: bool) -> Result<Made, String> {
    match (generator, clean) {
        ("a", false) => first::make(seed, request),
        ("a", true) => first::without(seed, request),
        ("b", false) => rotor::make(seed, request),
        ("b", true) => rotor::make::without(seed, request),
        ("c", false) => profile::make(seed, request),
        ("c", true) => profile::make::without(seed, request),
        ("d", false) => contact::make(seed, request),
        ("d", true) => contact::make::without(seed, request),
        ("e", false) => envelope::make(seed, request),
        ("e", true) => envelope::make::without(seed, request),
        (other, _) => Err(format!("no generator {other}: one of {}", GENERATORS.join(", "))),
    }
}

/// Data sets of a kind in a full run of the suite: every effect some ten times.
pub fn full(kind: Kind) -> u64 {
    match kind {
        Kind::Null => 100,
        Kind::Single => 160,
        Kind::Pair => 48,
        Kind::Outside => 48,
        Kind::Removed => 48,
        Kind::Closed => 42,
    }
}
