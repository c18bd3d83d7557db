//! The motors that turn the joints.

use super::joint::Motor;
use super::load::Rotor;
use twum_shared::Direction;

/// A motor, ready to be put at a joint.
#[derive(Debug, Clone)]
pub struct JointMotor {
    /// Its name, for messages and tables.
    pub name: String,
    /// Speed without load at full drive, °/s.
    pub no_load_deg_s: f64,
    /// Torque at standstill and full drive, N·m.
    pub stall_nm: f64,
    /// What of it turns with the joint.
    pub rotor: Rotor,
}

impl JointMotor {
    /// A stand-in.
    pub fn stand_in() -> Self {
        Self {
            name: "stand-in".to_owned(),
            no_load_deg_s: 208.9,
            stall_nm: 1.445e-3,
            rotor: Rotor { inertia_kg_m2: 765.58e-9, damping_nms: 2e-7 },
        }
    }

    pub(super) fn plant(&self) -> impl Motor + use<> {
        StandIn { now_s: 0.0, rad: 0.0, rad_s: 0.0, limit: self.no_load_deg_s.to_radians() }
    }
}

struct StandIn {
    now_s: f64,
    rad: f64,
    rad_s: f64,
    limit: f64,
}

impl Motor for StandIn {
    fn advance(&mut self, until_s: f64, on: bool, direction: Direction) {
        let target = if on { f64::from(direction.sign()) * self.limit } else { 0.0 };
        let keep = (-(until_s - self.now_s) / 2e-3).exp();
        self.rad_s = target + (self.rad_s - target) * keep;
        self.rad += self.rad_s * (until_s - self.now_s);
        self.now_s = until_s;
    }

    fn set_load_nm(&mut self, _: f64) {}

    fn angle_rad(&self) -> f64 {
        self.rad
    }
}
