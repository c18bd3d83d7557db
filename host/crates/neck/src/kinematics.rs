//! Forward kinematics of the neck: a spherical wrist of three revolute joints (thesis, section A.8.2).
//!
//! Standard Denavit–Hartenberg rows `(a, α, d)`: `(0, −90°, 0)`, `(0, 90°, 0)`, `(0, 0, L)`. Their product is
//! `Rz(θ1)·Ry(θ2)·Rz(θ3)·Tz(L)`, so the end point is `L·(cos θ1 sin θ2, sin θ1 sin θ2, cos θ2)`: it stays on a sphere,
//! joint 3 never moves it, and joint 1 does not while the neck is upright. The base's z axis is vertical.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use std::f64::consts::FRAC_PI_2;

/// Joints of the manipulator.
pub const JOINTS: usize = 3;

/// Distance from the wrist's centre to the end point, m (`d3` in the thesis's section A.8.2).
pub const THESIS_LENGTH_M: f64 = 0.239;

/// The manipulator's geometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wrist {
    /// Distance from the centre to the end point, m.
    pub length_m: f64,
}

impl Default for Wrist {
    fn default() -> Self {
        Self { length_m: THESIS_LENGTH_M }
    }
}

impl Wrist {
    /// Where the end point is, m, in the base frame, at these joint angles in degrees.
    pub fn end_point_m(&self, joints_deg: [f64; JOINTS]) -> Point3<f64> {
        let (sin_1, cos_1) = joints_deg[0].to_radians().sin_cos();
        let (sin_2, cos_2) = joints_deg[1].to_radians().sin_cos();
        Point3::new(cos_1 * sin_2, sin_1 * sin_2, cos_2) * self.length_m
    }

    /// Each link's frame in the frame of the link before it, base first, at these joint angles in degrees: the product
    /// of the three is the head's frame in the base.
    pub fn frames(&self, joints_deg: [f64; JOINTS]) -> [Isometry3<f64>; JOINTS] {
        let rows = [(-FRAC_PI_2, 0.0), (FRAC_PI_2, 0.0), (0.0, self.length_m)];
        std::array::from_fn(|joint| {
            let (twist, offset_m) = rows[joint];
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), joints_deg[joint].to_radians());
            let translation = Translation3::new(0.0, 0.0, offset_m);
            Isometry3::from_parts(translation, turn * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), twist))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix4, Rotation3};
    use proptest::prelude::*;

    const WRIST: Wrist = Wrist { length_m: THESIS_LENGTH_M };

    /// A row of the Denavit–Hartenberg table as the textbook's 4 × 4 matrix: the independent reference.
    fn textbook(theta: f64, alpha: f64, d: f64) -> Matrix4<f64> {
        let ((st, ct), (sa, ca)) = (theta.sin_cos(), alpha.sin_cos());
        Matrix4::new(ct, -st * ca, st * sa, 0.0, st, ct * ca, -ct * sa, 0.0, 0.0, sa, ca, d, 0.0, 0.0, 0.0, 1.0)
    }

    #[test]
    fn upright_and_right_angles_are_where_geometry_puts_them() {
        let near = |joints, [x, y, z]: [f64; 3]| {
            let distance = (WRIST.end_point_m(joints) - Point3::new(x, y, z)).norm();
            assert!(distance < 1e-15, "{joints:?}: {distance}");
        };
        near([0.0, 0.0, 0.0], [0.0, 0.0, 0.239]);
        near([0.0, 90.0, 0.0], [0.239, 0.0, 0.0]);
        near([90.0, 90.0, 0.0], [0.0, 0.239, 0.0]);
        near([90.0, -90.0, -90.0], [0.0, -0.239, 0.0]);
        near([45.0, 180.0, 12.0], [0.0, 0.0, -0.239]);
    }

    proptest! {
        #[test]
        fn frames_are_the_textbook_product(a in -360.0..360.0f64, b in -360.0..360.0f64, c in -360.0..360.0f64) {
            let angles = [a, b, c];
            let textbook = textbook(a.to_radians(), -FRAC_PI_2, 0.0)
                * textbook(b.to_radians(), FRAC_PI_2, 0.0)
                * textbook(c.to_radians(), 0.0, THESIS_LENGTH_M);
            let [first, second, third] = WRIST.frames(angles);
            let head = first * second * third;
            prop_assert!((head.to_homogeneous() - textbook).amax() < 1e-12);
            prop_assert!((head.translation.vector - WRIST.end_point_m(angles).coords).amax() < 1e-12);
            let euler = Rotation3::from_axis_angle(&Vector3::z_axis(), a.to_radians())
                * Rotation3::from_axis_angle(&Vector3::y_axis(), b.to_radians())
                * Rotation3::from_axis_angle(&Vector3::z_axis(), c.to_radians());
            prop_assert!((head.rotation.to_rotation_matrix().matrix() - euler.matrix()).amax() < 1e-12);
        }

        #[test]
        fn every_pose_is_the_length_from_the_origin(a in -1e3..1e3f64, b in -1e3..1e3f64, c in -1e3..1e3f64) {
            prop_assert!((WRIST.end_point_m([a, b, c]).coords.norm() - 0.239).abs() < 1e-13);
        }

        #[test]
        fn joint_1_does_not_move_the_upright_end_point_and_joint_3_never_does(
            a in -180.0..180.0f64, b in -180.0..180.0f64, c in -180.0..180.0f64,
        ) {
            prop_assert_eq!(WRIST.end_point_m([a, 0.0, 0.0]), WRIST.end_point_m([0.0, 0.0, 0.0]));
            prop_assert_eq!(WRIST.end_point_m([a, b, c]), WRIST.end_point_m([a, b, 0.0]));
        }
    }
}
