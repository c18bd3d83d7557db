//! What a controller will make of the motor: tried on many that agree with the runs, with what else a bench may have.

use super::design::{Facts, design};
use super::fit::{FitError, Identified};
use super::margins::{Margins, Rig, Swings};
use rayon::prelude::*;
use serde::Serialize;
use thiserror::Error;
use twum_motor::robust::{Candidate, Drawn, RobustError, Spread, Study, cell};
use twum_shared::step::{Config, ConfigError, ConfigSpec};

/// A controller for the motor, and what is to be expected of it.
#[derive(Debug, Clone, Serialize)]
pub struct Tuned {
    /// The named controller it was made from.
    pub name: String,
    /// The controller.
    #[serde(skip)]
    pub spec: ConfigSpec,
    /// PWM frequency it is run with (Hz).
    pub pwm_hz: u16,
    /// Mean amount of the counted error (deg): what a bench can measure.
    pub counted_deg: Spread,
    /// Mean amount of the true error (deg).
    pub true_deg: Spread,
    /// Counts lost.
    pub miscount: Spread,
    /// Motors on which the board would have stopped the run for its following error.
    pub ran_away: usize,
    /// How far the motor may be another; none where it swings as it is.
    pub margins: Option<Margins>,
    /// That it swings, and by how much.
    pub unstable: Option<Swings>,
}

/// Why nothing can be foretold.
#[derive(Debug, Error)]
pub enum TuneError {
    /// Of the motor.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// Of the controller.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// Of the loops.
    #[error(transparent)]
    Robust(#[from] RobustError),
}

/// Designs the named controllers for a motor that was identified, with a crossover (rad/s) of those that have gains, and tries them
/// on as many motors that agree as the study draws. The study's own motor is the file that the fit started from.
///
/// # Errors
/// When a controller cannot run, or a motor leaves the model's bounds.
pub fn tune(identified: &Identified, study: &Study, bandwidth_rad_s: f64) -> Result<Vec<Tuned>, TuneError> {
    let facts = Facts::of(identified)?;
    let rig = Rig { motor: identified.best()?, edges_per_rev: identified.edges_per_rev, pwm_hz: None };
    let motors: Vec<Drawn> =
        (0..study.draws).into_par_iter().map(|index| identified.draw(study.seed, index)).collect::<Result<_, _>>()?;
    ConfigSpec::NAMED
        .iter()
        .map(|(name, from)| {
            let spec = design(from, &facts, bandwidth_rad_s);
            let config = Config::try_from(spec)?;
            let pwm_hz = spec.pwm_hz();
            let candidate = Candidate { name: (*name).to_owned(), config, pwm_hz: f64::from(pwm_hz) };
            let found = cell(study, &candidate, "as identified", &motors)?;
            let margins = Margins::of(&rig, &spec)?;
            Ok(Tuned {
                name: (*name).to_owned(),
                spec,
                pwm_hz,
                counted_deg: found.counted_deg,
                true_deg: found.true_deg,
                miscount: found.miscount,
                ran_away: found.ran_away,
                margins: margins.ok(),
                unstable: margins.err(),
            })
        })
        .collect()
}
