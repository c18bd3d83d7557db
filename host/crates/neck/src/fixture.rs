//! The setup of the thesis's exercises, and sessions made with it: for tests, examples and whoever draws them.

use super::control::Controller;
use super::disturbance::Disturbance;
use super::exercise::Exercise;
use super::kinematics::Wrist;
use super::load::Head;
use super::motor::JointMotor;
use super::session::{DEFAULT_EDGES_PER_REV, Session, Setup};
use twum_motor::motor_plant::Solver;
use twum_motor::parameters::Flavour;

/// The setup `twum neck` takes by itself, in a flavour.
///
/// # Panics
/// Never: the motor is shipped.
pub fn setup(flavour: Flavour) -> Setup {
    Setup {
        motor: JointMotor::load("pcbmotor-30mm", flavour, Solver::Averaged).unwrap(),
        control: Controller::of(flavour),
        edges_per_rev: DEFAULT_EDGES_PER_REV,
        pwm_hz: 50.0,
        disturbance: Disturbance::default(),
        head: Head::NONE,
        wrist: Wrist::default(),
    }
}

/// A shipped exercise, simulated with it.
///
/// # Panics
/// When no exercise of that name is shipped.
pub fn session(exercise: &str) -> Session {
    setup(Flavour::Physical).simulate(&Exercise::shipped(exercise).unwrap()).unwrap()
}
