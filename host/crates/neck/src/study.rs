//! A study: every combination of exercises, motors, controllers, disturbances and sensors, one case a row of a CSV file.

use super::control::Controller;
use super::disturbance::Disturbance;
use super::exercise::{Exercise, ExerciseError};
use super::kinematics::{JOINTS, Wrist};
use super::load::Head;
use super::motor::JointMotor;
use super::score::Score;
use super::session::{DEFAULT_EDGES_PER_REV, SessionError, Setup};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use twum_motor::motor::MotorError;
use twum_motor::motor_plant::Solver;
use twum_motor::parameters::Flavour;
use twum_record::configuration::ControllerError;

/// Most cases a study may have.
const MOST_CASES: usize = 1_000_000;

/// A grid of cases, as written in a study file; every list is one axis.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Study {
    /// Exercises: shipped names or files.
    pub exercises: Vec<String>,
    /// Motors: shipped names or files.
    pub motors: Vec<String>,
    /// Flavours of the motor model.
    pub flavours: Vec<Flavour>,
    /// Controllers: names or files.
    pub controls: Vec<String>,
    /// Sensor resolutions, edges a revolution.
    pub edges_per_rev: Vec<u32>,
    /// PWM frequencies, Hz.
    pub pwm_hz: Vec<f64>,
    /// Disturbance amplitudes, °.
    pub disturbance_deg: Vec<f64>,
    /// Disturbance frequencies, Hz.
    pub disturbance_hz: Vec<f64>,
    /// Disturbance phases, °.
    pub disturbance_phase_deg: Vec<f64>,
}

impl Default for Study {
    fn default() -> Self {
        Self {
            exercises: Exercise::SHIPPED.map(str::to_owned).to_vec(),
            motors: vec!["pcbmotor-30mm".to_owned()],
            flavours: vec![Flavour::Physical],
            controls: vec!["default".to_owned()],
            edges_per_rev: vec![DEFAULT_EDGES_PER_REV],
            pwm_hz: vec![50.0],
            disturbance_deg: vec![5.0],
            disturbance_hz: vec![0.2],
            disturbance_phase_deg: vec![0.0],
        }
    }
}

/// Why a study cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// The file cannot be read.
    #[error("{path}: {reason}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        reason: std::io::Error,
    },
    /// The file is not a study.
    #[error("{path}: {message}")]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line, key and what was wrong.
        message: String,
    },
    /// No cases, or more than anyone waits for.
    #[error("the lists make {0} cases: between 1 and {MOST_CASES} can be studied")]
    Cases(usize),
    /// An exercise that cannot be done.
    #[error(transparent)]
    Exercise(#[from] ExerciseError),
    /// A motor that cannot be had.
    #[error(transparent)]
    Motor(#[from] MotorError),
    /// A controller that cannot be had.
    #[error(transparent)]
    Control(#[from] ControllerError),
}

/// A case and what came of it: a row of the CSV file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// The exercise.
    pub exercise: String,
    /// The motor.
    pub motor: String,
    /// Flavour of its model.
    pub flavour: Flavour,
    /// The controller.
    pub control: String,
    /// Sensor resolution, edges a revolution.
    pub edges_per_rev: u32,
    /// PWM frequency, Hz.
    pub pwm_hz: f64,
    /// Disturbance amplitude, °.
    pub disturbance_deg: f64,
    /// Disturbance frequency, Hz.
    pub disturbance_hz: f64,
    /// Disturbance phase, °.
    pub disturbance_phase_deg: f64,
    /// Mean square error of the end point, m².
    pub mse_m2: Option<f64>,
    /// Mean absolute error of the end point, m.
    pub mean_abs_error_m: Option<f64>,
    /// Largest error of the end point, m.
    pub max_error_m: Option<f64>,
    /// Mean absolute error had the disturbance been left alone, m.
    pub uncorrected_mean_abs_error_m: Option<f64>,
    /// Mean absolute error of joint 1, °.
    pub joint1_mean_abs_error_deg: Option<f64>,
    /// Mean absolute error of joint 2, °.
    pub joint2_mean_abs_error_deg: Option<f64>,
    /// Mean absolute error of joint 3, °.
    pub joint3_mean_abs_error_deg: Option<f64>,
    /// Largest share of the time any joint spent at full drive.
    pub saturated_share: Option<f64>,
    /// Why the case could not be simulated.
    pub refused: Option<String>,
}

impl Study {
    /// The file of the study that comes with the tool.
    pub const SHIPPED: &str = include_str!("../exercises/studies/resolution-and-disturbance.toml");

    /// The study that comes with the tool.
    pub fn shipped() -> Self {
        Self::parse(Self::SHIPPED, Path::new("shipped study")).expect("a test reads the shipped study")
    }

    /// Reads a study file; what it leaves out is the default: one case an exercise.
    ///
    /// # Errors
    /// Names the file, the line and the key.
    pub fn load(path: &Path) -> Result<Self, StudyError> {
        let text = twum_files::input::text(path, twum_files::input::WRITTEN)
            .map_err(|reason| StudyError::Read { path: path.to_owned(), reason })?;
        Self::parse(&text, path)
    }

    /// Reads a study from TOML; `path` is for messages.
    ///
    /// # Errors
    /// As [`Study::load`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, StudyError> {
        toml::from_str(text).map_err(|error| StudyError::Parse { path: path.to_owned(), message: error.to_string() })
    }

    /// Number of cases.
    pub fn cases(&self) -> usize {
        let axes = [
            self.exercises.len(),
            self.motors.len(),
            self.flavours.len(),
            self.controls.len(),
            self.edges_per_rev.len(),
            self.pwm_hz.len(),
            self.disturbance_deg.len(),
            self.disturbance_hz.len(),
            self.disturbance_phase_deg.len(),
        ];
        axes.into_iter().fold(1, usize::saturating_mul)
    }

    /// Simulates every case on all cores. The rows come in the order of the lists, the last list fastest, whatever core
    /// made them; `done` is told the number of cases finished so far. Once `stop` is set no further case is begun, and the
    /// rows are those of the cases that were.
    ///
    /// # Errors
    /// When an exercise or motor cannot be had. A case that cannot be simulated is a row that says why.
    pub fn run(&self, stop: &AtomicBool, done: impl Fn(usize) + Sync) -> Result<Vec<Row>, StudyError> {
        let cases = self.cases();
        if !(1..=MOST_CASES).contains(&cases) {
            return Err(StudyError::Cases(cases));
        }
        let exercises = self.exercises.iter().map(|name| Exercise::load(name)).collect::<Result<Vec<_>, _>>()?;
        let controls = self.controls.iter().map(|name| Controller::load(name)).collect::<Result<Vec<_>, _>>()?;
        let mut motors = Vec::new();
        for name in &self.motors {
            for &flavour in &self.flavours {
                motors.push((name.as_str(), flavour, JointMotor::load(name, flavour, Solver::Averaged)?));
            }
        }
        // One setup makes all exercises, so that the joints that rest in each are computed once.
        let setups = cases / exercises.len();
        let finished = AtomicUsize::new(0);
        let by_setup: Vec<Vec<Row>> = (0..setups)
            .into_par_iter()
            .map(|index| {
                if stop.load(Ordering::Relaxed) {
                    return Vec::new();
                }
                let rows = self.setup_rows(index, &motors, &controls, &exercises);
                done(finished.fetch_add(rows.len(), Ordering::Relaxed) + rows.len());
                rows
            })
            .collect();
        let mut columns: Vec<_> = by_setup.into_iter().map(Vec::into_iter).collect();
        Ok((0..exercises.len())
            .flat_map(|_| columns.iter_mut().filter_map(Iterator::next).collect::<Vec<_>>())
            .collect())
    }

    /// The rows of one setup, an exercise each; `index` counts the setups with the last list fastest.
    fn setup_rows(
        &self,
        index: usize,
        motors: &[(&str, Flavour, JointMotor)],
        controls: &[Controller],
        exercises: &[Exercise],
    ) -> Vec<Row> {
        let mut rest = index;
        let mut pick = |length: usize| {
            let index = rest % length;
            rest /= length;
            index
        };
        let phase_deg = self.disturbance_phase_deg[pick(self.disturbance_phase_deg.len())];
        let frequency_hz = self.disturbance_hz[pick(self.disturbance_hz.len())];
        let amplitude_deg = self.disturbance_deg[pick(self.disturbance_deg.len())];
        let pwm_hz = self.pwm_hz[pick(self.pwm_hz.len())];
        let edges_per_rev = self.edges_per_rev[pick(self.edges_per_rev.len())];
        let control = &controls[pick(controls.len())];
        let (motor_name, flavour, motor) = &motors[pick(motors.len())];
        let setup = Setup {
            motor: motor.clone(),
            control: control.clone(),
            edges_per_rev,
            pwm_hz,
            disturbance: Disturbance { amplitude_deg, frequency_hz, phase_deg, joints: [true; JOINTS] },
            head: Head::NONE,
            wrist: Wrist::default(),
        };
        let row = |exercise: &Exercise, outcome: Result<Score, SessionError>| {
            let (score, refused) = match outcome {
                Ok(score) => (Some(score), None),
                Err(error) => (None, Some(error.to_string())),
            };
            let score = score.as_ref();
            let joint = |index: usize| score.map(|s| s.joints[index].mean_abs_error_deg);
            Row {
                exercise: exercise.name().to_owned(),
                motor: (*motor_name).to_owned(),
                flavour: *flavour,
                control: control.name.clone(),
                edges_per_rev,
                pwm_hz,
                disturbance_deg: amplitude_deg,
                disturbance_hz: frequency_hz,
                disturbance_phase_deg: phase_deg,
                mse_m2: score.map(|s| s.mse_m2),
                mean_abs_error_m: score.map(|s| s.mean_abs_error_m),
                max_error_m: score.map(|s| s.max_error_m),
                uncorrected_mean_abs_error_m: score.map(|s| s.uncorrected_mean_abs_error_m),
                joint1_mean_abs_error_deg: joint(0),
                joint2_mean_abs_error_deg: joint(1),
                joint3_mean_abs_error_deg: joint(2),
                saturated_share: score.map(|s| s.joints.iter().map(|j| j.saturated_share).fold(0.0, f64::max)),
                refused,
            }
        };
        match setup.simulate_all(exercises) {
            Ok(sessions) => {
                sessions.iter().map(|session| row(&session.exercise, Ok(Score::of(session, &setup)))).collect()
            }
            // One exercise that cannot be done must not take the others with it.
            Err(_) => exercises
                .iter()
                .map(|exercise| row(exercise, setup.simulate(exercise).map(|session| Score::of(&session, &setup))))
                .collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    static GO: AtomicBool = AtomicBool::new(false);
    use crate::fixture::setup;

    fn small() -> Study {
        Study {
            exercises: vec!["rotation".to_owned(), "flexion-extension".to_owned()],
            edges_per_rev: vec![400, 4096],
            disturbance_deg: vec![0.0, 5.0],
            ..Study::default()
        }
    }

    #[test]
    fn the_shipped_study_has_its_thousand_cases() {
        assert_eq!(Study::shipped().cases(), 1008);
    }

    #[test]
    fn rows_come_in_the_order_of_the_lists_and_are_the_single_runs() {
        let done = AtomicUsize::new(0);
        let rows = small().run(&GO, |finished| _ = done.fetch_max(finished, Ordering::Relaxed)).unwrap();
        assert_eq!((rows.len(), done.into_inner()), (8, 8));
        let keys: Vec<_> = rows.iter().map(|r| (r.exercise.as_str(), r.edges_per_rev, r.disturbance_deg)).collect();
        assert_eq!(
            keys[..4],
            [("rotation", 400, 0.0), ("rotation", 400, 5.0), ("rotation", 4096, 0.0), ("rotation", 4096, 5.0)]
        );
        let setup = setup(Flavour::Physical);
        let session = setup.simulate(&Exercise::shipped("flexion-extension").unwrap()).unwrap();
        assert_eq!(rows[7].mean_abs_error_m, Some(Score::of(&session, &setup).mean_abs_error_m));
    }

    #[test]
    fn cases_that_cannot_run_say_why_in_their_row() {
        let rows = Study { disturbance_deg: vec![5.0, 1e3], ..small() }.run(&GO, |_| ()).unwrap();
        assert!(rows[0].refused.is_none() && rows[0].mse_m2.is_some());
        let why = rows[1].refused.as_deref().unwrap();
        assert!(why.contains("disturbance amplitude 1000 is outside 0 to 90") && rows[1].mse_m2.is_none());
    }

    #[test]
    fn studies_that_cannot_be_made_are_refused() {
        let empty = Study { pwm_hz: Vec::new(), ..small() };
        assert!(empty.run(&GO, |_| ()).unwrap_err().to_string().contains("0 cases"));
        let unknown = Study { exercises: vec!["nodding".to_owned()], ..small() };
        assert!(unknown.run(&GO, |_| ()).unwrap_err().to_string().contains("no exercise `nodding`"));
        let unknown = Study { controls: vec!["pid".to_owned()], ..small() };
        assert!(unknown.run(&GO, |_| ()).unwrap_err().to_string().contains("pid"));
        let error = Study::parse("edges = [1]", Path::new("mine.toml")).unwrap_err().to_string();
        assert!(error.contains("mine.toml") && error.contains("edges"), "{error}");
    }
}
