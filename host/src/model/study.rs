//! Questions asked of the motor model: its speed, its speed against duty, its speed against torque, its start.

use super::actuator::Pwm;
use super::effects::EffectSet;
use super::motor_plant::{History, MotorPlant, Solver};
use super::parameters::{Flavour, ParameterError, Parameters};
use super::plant::{Direction, Plant, Segment};
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::PI;
use std::time::Instant;
use thiserror::Error;

/// A run at constant duty.
#[derive(Debug, Clone, Copy)]
pub struct Setup {
    /// The motor.
    pub parameters: Parameters,
    /// The reading of the model.
    pub flavour: Flavour,
    /// Which model integrates it.
    pub solver: Solver,
    /// Effects the motor has.
    pub effects: EffectSet,
    /// Fraction of the PWM period with the drive on, 0 to 1.
    pub duty: f64,
    /// PWM frequency (Hz).
    pub pwm_hz: f64,
    /// Length of the run (s).
    pub seconds: f64,
}

/// A run that cannot be made.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SetupError {
    /// A parameter is outside its bounds.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// A setting is outside its bounds.
    #[error("{name} = {value} is outside {lower} ..= {upper}")]
    OutOfBounds {
        /// The setting.
        name: &'static str,
        /// What was given.
        value: f64,
        /// Smallest admissible value.
        lower: f64,
        /// Largest admissible value.
        upper: f64,
    },
}

/// What a run at constant duty came to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Speed {
    /// Mean speed over the last 20 % of the run (rad/s).
    pub speed_rad_s: f64,
    /// The same (rpm).
    pub speed_rpm: f64,
    /// Amplitude of the wave at the end (m).
    pub wave_amplitude_m: f64,
    /// Height of the rotor at the end (m).
    pub rotor_height_m: f64,
    /// Integration steps taken.
    pub steps: u64,
    /// Time it took (s).
    pub wall_s: f64,
}

impl Setup {
    /// Checks the parameters and the settings.
    ///
    /// # Errors
    /// Names what is outside its bounds.
    pub fn check(&self) -> Result<(), SetupError> {
        self.parameters.check()?;
        let bounds =
            [("duty", self.duty, 0.0, 1.0), ("pwm-hz", self.pwm_hz, 0.1, 2e4), ("seconds", self.seconds, 1e-6, 1e5)];
        for (name, value, lower, upper) in bounds {
            if !(lower..=upper).contains(&value) {
                return Err(SetupError::OutOfBounds { name, value, lower, upper });
            }
        }
        Ok(())
    }

    fn plant(&self) -> (MotorPlant, Pwm) {
        let mut pwm = Pwm::new(self.pwm_hz, 0.0, &self.effects);
        pwm.begin(self.duty, Direction::Cw);
        (MotorPlant::new(self.parameters, self.flavour, self.solver, &self.effects, History::default()), pwm)
    }

    /// Runs it.
    ///
    /// # Errors
    /// As [`Setup::check`].
    pub fn speed(&self) -> Result<Speed, SetupError> {
        self.check()?;
        let began = Instant::now();
        let (mut plant, mut pwm) = self.plant();
        let from_s = 0.8 * self.seconds;
        pwm.advance(&mut plant, from_s, &mut |_| ());
        let from_rad = plant.position_rad();
        pwm.advance(&mut plant, self.seconds, &mut |_| ());
        let speed = (plant.position_rad() - from_rad) / (self.seconds - from_s);
        Ok(Speed {
            speed_rad_s: speed,
            speed_rpm: speed * 30.0 / PI,
            wave_amplitude_m: plant.amplitude_m(),
            rotor_height_m: plant.height_m(),
            steps: plant.steps(),
            wall_s: began.elapsed().as_secs_f64(),
        })
    }

    /// Speed over the run as (s, rpm), at the ends of the integration steps.
    ///
    /// # Errors
    /// As [`Setup::check`].
    pub fn start_up(&self) -> Result<Vec<(f64, f64)>, SetupError> {
        self.check()?;
        let (mut plant, mut pwm) = self.plant();
        let mut points = vec![(0.0, 0.0)];
        pwm.advance(&mut plant, self.seconds, &mut |s: &Segment| points.push((s.end_s, s.end_rad_s * 30.0 / PI)));
        Ok(points)
    }

    /// Speeds at several duties, on all cores.
    ///
    /// # Errors
    /// As [`Setup::check`].
    pub fn sweep(&self, duties: &[f64]) -> Result<Vec<(f64, Speed)>, SetupError> {
        duties.par_iter().map(|&duty| Ok((duty, Setup { duty, ..*self }.speed()?))).collect()
    }

    /// Speeds under several loads (N·m), on all cores.
    ///
    /// # Errors
    /// As [`Setup::check`].
    pub fn under_loads(&self, loads_nm: &[f64]) -> Result<Vec<(f64, Speed)>, SetupError> {
        loads_nm
            .par_iter()
            .map(|&load_nm| {
                let parameters = Parameters { load_nm, ..self.parameters };
                Ok((load_nm, Setup { parameters, ..*self }.speed()?))
            })
            .collect()
    }

    /// Torque the contact can transmit to a rotor at rest (N·m), u·Fext·R0: the stall torque of either flavour.
    pub fn stall_torque_nm(&self) -> f64 {
        let p = &self.parameters;
        p.friction * p.preload_n * p.contact_radius_m
    }
}
