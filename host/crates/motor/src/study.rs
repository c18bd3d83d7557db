//! Questions asked of the motor model: its speed, its speed against duty, its speed against torque, its start.

use super::actuator::Pwm;
use super::carrier::SideBySide;
use super::effects::EffectSet;
use super::motor_plant::{History, MotorPlant, Solver};
use super::parameters::{Flavour, ParameterError, Parameters};
use super::plant::{Direction, Drive, Plant, Segment};
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::PI;
use std::time::Instant;
use thiserror::Error;

/// A run at constant duty.
#[derive(Debug, Clone)]
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
    /// The load turns the rotor.
    #[error(
        "`Tload = {load_nm}` is not below the {stall_nm:.6} N·m that the contact transmits: the rotor would slide ever \
         faster, which the model does not describe"
    )]
    RunsAway {
        /// The load, N·m.
        load_nm: f64,
        /// What the contact transmits, N·m.
        stall_nm: f64,
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

    /// Whether the contact holds the load. Beyond it the rotor slides ever faster, as the stall torque is found by.
    ///
    /// # Errors
    /// [`SetupError::RunsAway`].
    pub fn check_load(&self) -> Result<(), SetupError> {
        let (load_nm, stall_nm) = (self.parameters.load_nm, self.stall_torque_nm());
        if load_nm != 0.0 && load_nm.abs() >= stall_nm {
            return Err(SetupError::RunsAway { load_nm, stall_nm });
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
        let setups: Vec<Setup> = duties.iter().map(|&duty| Setup { duty, ..self.clone() }).collect();
        Ok(duties.iter().copied().zip(speeds(&setups)?).collect())
    }

    /// Speeds under several loads (N·m), on all cores.
    ///
    /// # Errors
    /// As [`Setup::check`].
    pub fn under_loads(&self, loads_nm: &[f64]) -> Result<Vec<(f64, Speed)>, SetupError> {
        let with = |&load_nm: &f64| Setup { parameters: Parameters { load_nm, ..self.parameters }, ..self.clone() };
        let setups: Vec<Setup> = loads_nm.iter().map(with).collect();
        Ok(loads_nm.iter().copied().zip(speeds(&setups)?).collect())
    }

    /// Torque the contact can transmit to a rotor at rest (N·m), u·Fext·R0: the stall torque of either flavour.
    pub fn stall_torque_nm(&self) -> f64 {
        let p = &self.parameters;
        p.friction * p.preload_n * p.contact_radius_m
    }
}

/// Motors integrated together at carrier resolution.
const LANES: usize = 4;

/// Speeds of several runs that differ in parameters and duty only, on all cores, carrier runs four to a core.
fn speeds(setups: &[Setup]) -> Result<Vec<Speed>, SetupError> {
    setups.iter().try_for_each(Setup::check)?;
    match setups.first() {
        // Effects act on single motors only.
        Some(first) if first.solver == Solver::Carrier && first.effects == EffectSet::default() => {
            let groups: Vec<Vec<Speed>> = setups.par_chunks(LANES).map(carrier_speeds).collect();
            Ok(groups.into_iter().flatten().collect())
        }
        _ => setups.par_iter().map(Setup::speed).collect(),
    }
}

/// [`Setup::speed`] of up to [`LANES`] carrier runs at once; idle lanes repeat the last.
fn carrier_speeds(setups: &[Setup]) -> Vec<Speed> {
    let began = Instant::now();
    let lane: [&Setup; LANES] = std::array::from_fn(|i| &setups[i.min(setups.len() - 1)]);
    let Setup { flavour, pwm_hz, seconds, .. } = *lane[0];
    let mut motors = SideBySide::new(lane.map(|s| s.parameters), flavour);
    let period_s = 1.0 / pwm_hz;
    let from_s = 0.8 * seconds;
    let mut from_rad = [0.0; LANES];
    let mut now_s = 0.0;
    let mut period = 0.0;
    while now_s < seconds {
        // A period begins with its off part, as [`Pwm`] has it.
        let start_s = period * period_s;
        let rise_s = lane.map(|s| start_s + (1.0 - s.duty) * period_s);
        let mut edges: Vec<f64> = rise_s.into_iter().chain([start_s + period_s, from_s, seconds]).collect();
        edges.retain(|&edge| edge > now_s && edge <= (start_s + period_s).min(seconds));
        edges.sort_by(f64::total_cmp);
        for edge in edges {
            let on = rise_s.map(|rise| if now_s >= rise - 1e-12 { 1.0 } else { 0.0 });
            let drive = std::array::from_fn(|i| Drive {
                level: if lane[i].duty > 0.0 { on[i] } else { 0.0 },
                direction: Direction::Cw,
                duty: lane[i].duty,
            });
            motors.run(edge - now_s, drive);
            now_s = edge;
            if edge == from_s {
                from_rad = std::array::from_fn(|i| motors.state(i)[6]);
            }
        }
        period += 1.0;
    }
    let wall_s = began.elapsed().as_secs_f64() / setups.len() as f64;
    (0..setups.len())
        .map(|i| {
            let state = motors.state(i);
            let speed = (state[6] - from_rad[i]) / (seconds - from_s);
            Speed {
                speed_rad_s: speed,
                speed_rpm: speed * 30.0 / PI,
                wave_amplitude_m: state[0].hypot(state[1]),
                rotor_height_m: state[4],
                steps: motors.steps(),
                wall_s,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::Motor;

    /// Five carrier runs in two groups of lanes, each against the same run by itself.
    #[test]
    fn runs_side_by_side_are_the_runs_one_by_one() {
        for flavour in [Flavour::Thesis, Flavour::Physical] {
            let setup = Setup {
                parameters: Motor::pcbmotor_30mm().parameters(flavour),
                flavour,
                solver: Solver::Carrier,
                effects: EffectSet::default(),
                duty: 0.6,
                pwm_hz: 500.0,
                seconds: 0.011,
            };
            let duties = [0.0, 0.3, 0.55, 0.9, 1.0];
            for (duty, together) in setup.sweep(&duties).unwrap() {
                let alone = Setup { duty, ..setup.clone() }.speed().unwrap();
                // Edges of the others cut the steps elsewhere, no more.
                let off = (together.speed_rad_s - alone.speed_rad_s).abs();
                assert!(off < 1e-5, "{flavour} {duty}: {together:?} {alone:?}");
                assert!((together.rotor_height_m - alone.rotor_height_m).abs() < 1e-10);
            }
            let loads = [0.0, 2e-4, 1e-3];
            for (load_nm, together) in setup.under_loads(&loads).unwrap() {
                let parameters = Parameters { load_nm, ..setup.parameters };
                let alone = Setup { parameters, ..setup.clone() }.speed().unwrap();
                assert!((together.speed_rad_s - alone.speed_rad_s).abs() < 1e-5, "{flavour} {load_nm}");
            }
        }
    }
}
