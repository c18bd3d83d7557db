//! The motors that turn the joints: the hybrid model at a joint, averaged or at carrier resolution.

use super::load::Rotor;
use twum_motor::averaged::Averaged;
use twum_motor::effects::EffectSet;
use twum_motor::motor::{Motor, MotorError};
use twum_motor::motor_plant::{History, MotorPlant, Solver};
use twum_motor::parameters::{Flavour, Parameters};
use twum_motor::plant::Drive;

/// A motor, ready to be put at a joint.
#[derive(Debug, Clone)]
pub struct JointMotor {
    name: String,
    flavour: Flavour,
    solver: Solver,
    parameters: Parameters,
    no_load_deg_s: f64,
    stall_nm: f64,
}

/// Time by which the wave and a free rotor are steady, s.
const SETTLING_S: f64 = 1.0;
/// A rotor so heavy that it hardly moves while its torque is read, kg·m².
const LOCKED_KG_M2: f64 = 1.0;
/// Between which times the torque of a locked rotor is read, s.
const LOCKED_S: [f64; 2] = [0.04, 0.06];

impl JointMotor {
    /// A shipped motor by its name, or the one in the file at that path.
    ///
    /// # Errors
    /// When there is neither, or the file will not do.
    pub fn load(name_or_path: &str, flavour: Flavour, solver: Solver) -> Result<Self, MotorError> {
        let motor = Motor::load(name_or_path)?;
        Ok(Self::new(motor.name.clone(), motor.parameters(flavour), flavour, solver))
    }

    /// A motor from its parameters; its speed without load and its stall torque are read off the averaged model at full
    /// drive.
    pub fn new(name: String, parameters: Parameters, flavour: Flavour, solver: Solver) -> Self {
        let mut free = Averaged::new(parameters, flavour);
        free.advance(SETTLING_S, Drive::ON, &mut |_| {});
        let mut locked = Averaged::new(Parameters { rotor_inertia_kg_m2: LOCKED_KG_M2, ..parameters }, flavour);
        let [before, after] = LOCKED_S.map(|time_s| {
            locked.advance(time_s, Drive::ON, &mut |_| {});
            locked.speed_rad_s()
        });
        let no_load_deg_s = free.speed_rad_s().to_degrees();
        let stall_nm = LOCKED_KG_M2 * (after - before) / (LOCKED_S[1] - LOCKED_S[0]);
        Self { name, flavour, solver, parameters, no_load_deg_s, stall_nm }
    }

    /// Its name, for messages and tables.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its parameters.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Flavour of its model.
    pub fn flavour(&self) -> Flavour {
        self.flavour
    }

    /// Which model integrates it.
    pub fn solver(&self) -> Solver {
        self.solver
    }

    /// Speed without load at full drive, °/s.
    pub fn no_load_deg_s(&self) -> f64 {
        self.no_load_deg_s
    }

    /// Torque at standstill and full drive, N·m.
    pub fn stall_nm(&self) -> f64 {
        self.stall_nm
    }

    /// What of it turns with the joint.
    pub fn rotor(&self) -> Rotor {
        Rotor {
            inertia_kg_m2: self.parameters.rotor_inertia_kg_m2,
            damping_nms: self.parameters.rotational_damping_nms,
        }
    }

    /// The motor at rest at a joint that adds this inertia to its rotor, with the effects given.
    pub(super) fn at_joint(&self, added_inertia_kg_m2: f64, effects: &EffectSet) -> MotorPlant {
        let rotor_inertia_kg_m2 = self.parameters.rotor_inertia_kg_m2 + added_inertia_kg_m2;
        let parameters = Parameters { rotor_inertia_kg_m2, ..self.parameters };
        MotorPlant::new(parameters, self.flavour, self.solver, effects, History::default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motor(flavour: Flavour) -> JointMotor {
        JointMotor::load("pcbmotor-30mm", flavour, Solver::Averaged).unwrap()
    }

    /// A standing rotor slips everywhere against the crests, so the contact gives its whole friction: μ·Fext·R0.
    #[test]
    fn stall_torque_is_the_contacts_whole_friction() {
        for flavour in Flavour::ALL {
            let p = Motor::pcbmotor_30mm().parameters(flavour);
            let friction_nm = p.friction * p.preload_n * p.contact_radius_m;
            let stall_nm = motor(flavour).stall_nm();
            assert!((stall_nm / friction_nm - 1.0).abs() < 1e-3, "{flavour}: {stall_nm} against {friction_nm}");
        }
    }

    /// 3.6466 rad/s is the steady speed of the carrier model as listed (thesis, sections A.4 to A.6).
    #[test]
    fn speed_without_load_is_the_listed_models() {
        let rad_s = motor(Flavour::Thesis).no_load_deg_s().to_radians();
        assert!((rad_s / 3.6466 - 1.0).abs() < 5e-3, "{rad_s}");
    }
}
