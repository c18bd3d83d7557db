//! A session: one exercise, three joints, each a motor in its own position loop.

use super::control::{Named, at_resolution};
use super::disturbance::Disturbance;
use super::exercise::{Exercise, Problem};
use super::joint::{JointTrace, Loop};
use super::kinematics::{JOINTS, Wrist};
use super::load::Head;
use super::motor::JointMotor;
use super::path;
use rayon::prelude::*;
use twum_shared::step::ConfigError;

/// Everything about a session but its exercise.
#[derive(Debug, Clone)]
pub struct Setup {
    /// The motor at each joint.
    pub motor: JointMotor,
    /// The controller, tuned for 400 edges a revolution; see [`at_resolution`].
    pub control: Named,
    /// Resolution of the sensor at each joint, edges a revolution.
    pub edges_per_rev: u32,
    /// PWM frequency, Hz.
    pub pwm_hz: f64,
    /// What pushes the joints off their path.
    pub disturbance: Disturbance,
    /// What the motors carry.
    pub head: Head,
    /// The manipulator's geometry.
    pub wrist: Wrist,
}

/// Edges a revolution of the joints' sensors unless asked otherwise. The thesis speaks of a more accurate sensor without
/// saying which; 4096 (0.088°) is what a 12-bit magnetic encoder gives.
pub const DEFAULT_EDGES_PER_REV: u32 = 4096;

/// Why a session cannot be simulated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SessionError {
    /// The motor cannot follow the exercise.
    #[error("{exercise}: {problem}")]
    Exercise {
        /// The exercise.
        exercise: String,
        /// What it asks too much of.
        problem: Box<Problem>,
    },
    /// The controller cannot run at this resolution.
    #[error("the controller cannot run on {edges_per_rev} edges a revolution: {source}")]
    Control {
        /// Resolution asked for.
        edges_per_rev: u32,
        /// What the control step said.
        source: ConfigError,
    },
    /// A quantity outside its bounds.
    #[error("{name} {value} is outside {low} to {high} {unit}")]
    Bound {
        /// The quantity.
        name: &'static str,
        /// What was given.
        value: f64,
        /// Smallest admissible value.
        low: f64,
        /// Largest admissible value.
        high: f64,
        /// Its unit.
        unit: &'static str,
    },
}

/// A session that was simulated, one entry a control tick from 0 to the end of the exercise.
#[derive(Debug, Clone, PartialEq)]
pub struct Session {
    /// The exercise done.
    pub exercise: Exercise,
    /// The manipulator's geometry.
    pub wrist: Wrist,
    /// Time between entries, s.
    pub tick_s: f64,
    /// What each joint did.
    pub joints: [JointTrace; JOINTS],
}

impl Setup {
    /// Checks everything but the exercise.
    ///
    /// # Errors
    /// Names the quantity and its bounds.
    pub fn check(&self) -> Result<(), SessionError> {
        let bounds = [
            ("sensor resolution", f64::from(self.edges_per_rev), 4.0, 65_536.0, "edges a revolution"),
            ("PWM frequency", self.pwm_hz, 1.0, 100_000.0, "Hz"),
            ("disturbance amplitude", self.disturbance.amplitude_deg, 0.0, 90.0, "°"),
            ("disturbance frequency", self.disturbance.frequency_hz, 0.0, 100.0, "Hz"),
            ("disturbance phase", self.disturbance.phase_deg, -360.0, 360.0, "°"),
            ("head mass", self.head.mass_kg, 0.0, 20.0, "kg"),
            ("head centre distance", self.head.centre_m, 0.0, 1.0, "m"),
            ("neck length", self.wrist.length_m, 0.001, 10.0, "m"),
        ];
        for (name, value, low, high, unit) in bounds {
            if !(low..=high).contains(&value) {
                return Err(SessionError::Bound { name, value, low, high, unit });
            }
        }
        at_resolution(&self.control.spec(), self.edges_per_rev)
            .map(|_| ())
            .map_err(|source| SessionError::Control { edges_per_rev: self.edges_per_rev, source })
    }

    /// Simulates the three joints through an exercise.
    ///
    /// # Errors
    /// When the exercise is too fast for the motor, or a quantity is out of bounds.
    pub fn simulate(&self, exercise: &Exercise) -> Result<Session, SessionError> {
        self.check()?;
        exercise.check_speed(self.motor.name(), self.motor.no_load_deg_s()).map_err(|problem| {
            SessionError::Exercise { exercise: exercise.name().to_owned(), problem: Box::new(problem) }
        })?;
        let config = at_resolution(&self.control.spec(), self.edges_per_rev)
            .map_err(|source| SessionError::Control { edges_per_rev: self.edges_per_rev, source })?;
        let tick_s = f64::from(config.spec().period_us) * 1e-6;
        let ticks = (exercise.duration_s() / tick_s).round() as usize + 1;
        let joints: Vec<JointTrace> = (0..JOINTS)
            .into_par_iter()
            .map(|joint| {
                let run = Loop {
                    config: &config,
                    reference: path::reference(exercise, joint, self.edges_per_rev),
                    start_deg: exercise.start_deg()[joint],
                    joint,
                    disturbance: &self.disturbance,
                    edges_per_rev: self.edges_per_rev,
                    pwm_hz: self.pwm_hz,
                    ticks,
                };
                let (added_kg_m2, effects) = self.head.at_joint(exercise, joint);
                run.run(&mut self.motor.at_joint(added_kg_m2, &effects), &effects)
            })
            .collect();
        let joints = joints.try_into().expect("one trace was made for each joint");
        Ok(Session { exercise: exercise.clone(), wrist: self.wrist, tick_s, joints })
    }
}

impl Session {
    /// Number of entries.
    pub fn len(&self) -> usize {
        self.joints[0].deg.len()
    }

    /// Whether nothing was simulated; a session has at least its start.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Time of an entry, s.
    pub fn time_s(&self, tick: usize) -> f64 {
        tick as f64 * self.tick_s
    }

    /// True joint angles at an entry, °.
    pub fn joints_deg(&self, tick: usize) -> [f64; JOINTS] {
        std::array::from_fn(|joint| self.joints[joint].deg[tick])
    }

    /// Reference joint angles at an entry, °: the path in doubles, before any way point is rounded to a count.
    pub fn reference_deg(&self, tick: usize) -> [f64; JOINTS] {
        path::motion(&self.exercise, self.time_s(tick)).map(|motion| motion.deg)
    }

    /// Distance of the end point from its reference at an entry, m.
    pub fn error_m(&self, tick: usize) -> f64 {
        (self.wrist.end_point_m(self.joints_deg(tick)) - self.wrist.end_point_m(self.reference_deg(tick))).norm()
    }
}
