//! What the joints have to bear: the head's weight, and the torque the path demands of the motors.

use super::exercise::Exercise;
use super::kinematics::JOINTS;
use super::path::{self, Motion};
use twum_motor::effects::{EffectSet, GravityLoad};

/// Standard gravity, m/s².
const GRAVITY_M_S2: f64 = 9.80665;

/// A point mass on the neck's axis, carried by the motors alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Head {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Distance of its centre of mass from the wrist's centre, m.
    pub centre_m: f64,
}

impl Head {
    /// No head: the manipulator of the thesis, which is kinematic.
    pub const NONE: Self = Self { mass_kg: 0.0, centre_m: 0.0 };

    /// Moment of inertia about the wrist's centre, across the neck, kg·m².
    pub fn inertia_kg_m2(&self) -> f64 {
        self.mass_kg * self.centre_m * self.centre_m
    }

    /// What the head adds to a joint's motor: an inertia, kg·m², and at joint 2 its weight as a load over the motor's angle.
    ///
    /// The inertia is the largest anywhere on the exercise's path: `I` at joint 2, `I·sin²θ2` at joint 1, none at joint 3.
    pub(super) fn at_joint(&self, exercise: &Exercise, joint: usize) -> (f64, EffectSet) {
        let mut effects = EffectSet::default();
        if *self == Self::NONE {
            return (0.0, effects);
        }
        let lean = |step: u32| path::motion(exercise, f64::from(step) * 0.01)[1].deg.to_radians().sin().powi(2);
        let share = match joint {
            0 => (0..=(exercise.duration_s() / 0.01) as u32).map(lean).fold(0.0, f64::max),
            1 => {
                // The effect's torque acts against positive rotation; gravity acts with it.
                let torque_nm = -self.mass_kg * GRAVITY_M_S2 * self.centre_m;
                effects.gravity_load =
                    Some(GravityLoad { torque_nm, phase_rad: exercise.start_deg()[joint].to_radians() });
                1.0
            }
            _ => 0.0,
        };
        (self.inertia_kg_m2() * share, effects)
    }

    /// Torque of gravity on joint 2 at its angle, N·m, positive in the joint's positive sense: it pulls the leaning neck
    /// further down. Joints 1 and 3 feel none: joint 1's axis is vertical and joint 3's passes through the mass.
    pub fn gravity_nm(&self, joint_2_deg: f64) -> f64 {
        self.mass_kg * GRAVITY_M_S2 * self.centre_m * joint_2_deg.to_radians().sin()
    }

    /// Torque each motor has to give for these joint motions, N·m: the manipulator's equation of motion for a point mass
    /// on the axis, with a rotor's inertia and viscous drag at each joint.
    ///
    /// From the Lagrangian `½·I·(θ̇2² + θ̇1² sin²θ2) − m·g·c·cos θ2` with `I = m·c²`.
    pub fn demand_nm(&self, motions: [Motion; JOINTS], rotor: Rotor) -> [f64; JOINTS] {
        let inertia = self.inertia_kg_m2();
        let (sin_2, cos_2) = motions[1].deg.to_radians().sin_cos();
        let rate = motions.map(|motion| motion.deg_s.to_radians());
        let acceleration = motions.map(|motion| motion.deg_s2.to_radians());
        let head = [
            inertia * (sin_2 * sin_2 * acceleration[0] + 2.0 * sin_2 * cos_2 * rate[0] * rate[1]),
            inertia * (acceleration[1] - sin_2 * cos_2 * rate[0] * rate[0]) - self.gravity_nm(motions[1].deg),
            0.0,
        ];
        std::array::from_fn(|joint| {
            head[joint] + rotor.inertia_kg_m2 * acceleration[joint] + rotor.damping_nms * rate[joint]
        })
    }
}

/// The part of a motor that turns with its joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotor {
    /// Moment of inertia, kg·m².
    pub inertia_kg_m2: f64,
    /// Viscous drag, N·m·s.
    pub damping_nms: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};
    use proptest::prelude::*;

    const ROTOR: Rotor = Rotor { inertia_kg_m2: 765.58e-9, damping_nms: 2e-7 };
    const HEAD: Head = Head { mass_kg: 4.5, centre_m: 0.12 };

    #[test]
    fn a_resting_neck_bears_its_weight_on_joint_2_only() {
        let resting = |deg: f64| [90.0, deg, -90.0].map(|deg| Motion { deg, ..Motion::default() });
        let [one, two, three] = HEAD.demand_nm(resting(60.0), ROTOR);
        let expected = -4.5 * 9.80665 * 0.12 * 3f64.sqrt() / 2.0;
        assert!((two - expected).abs() < 1e-12 && one == 0.0 && three == 0.0);
        assert_eq!(HEAD.demand_nm(resting(0.0), ROTOR), [0.0; 3]);
    }

    #[test]
    fn without_a_head_the_rotor_is_all_there_is() {
        let motion = Motion { deg: 12.0, deg_s: 180.0 / std::f64::consts::PI, deg_s2: 360.0 / std::f64::consts::PI };
        for torque in Head::NONE.demand_nm([motion; 3], ROTOR) {
            assert!((torque - (2.0 * 765.58e-9 + 2e-7)).abs() < 1e-18);
        }
    }

    proptest! {
        /// Against Newton: the mass's acceleration by differences along the joint motion, and the moment of the force on
        /// it about each joint's axis.
        #[test]
        fn demand_is_newtons(
            deg in prop::array::uniform3(-80.0..80.0f64), deg_s in prop::array::uniform3(-50.0..50.0f64),
            deg_s2 in prop::array::uniform3(-50.0..50.0f64),
        ) {
            let wrist = crate::kinematics::Wrist { length_m: HEAD.centre_m };
            let position = |t: f64| -> Point3<f64> {
                wrist.end_point_m(std::array::from_fn(|j| deg[j] + deg_s[j] * t + 0.5 * deg_s2[j] * t * t))
            };
            let h = 1e-3;
            let acceleration = (position(h).coords + position(-h).coords - 2.0 * position(0.0).coords) / (h * h);
            let force = (acceleration + Vector3::z() * GRAVITY_M_S2) * HEAD.mass_kg;
            let moment = position(0.0).coords.cross(&force);
            let (sin_1, cos_1) = deg[0].to_radians().sin_cos();
            let axes = [Vector3::z(), Vector3::new(-sin_1, cos_1, 0.0), position(0.0).coords.normalize()];
            let motions = std::array::from_fn(|j| Motion { deg: deg[j], deg_s: deg_s[j], deg_s2: deg_s2[j] });
            let still = Rotor { inertia_kg_m2: 0.0, damping_nms: 0.0 };
            for (ours, axis) in HEAD.demand_nm(motions, still).iter().zip(axes) {
                prop_assert!((ours - moment.dot(&axis)).abs() < 1e-5, "{ours} against {}", moment.dot(&axis));
            }
        }
    }
}
