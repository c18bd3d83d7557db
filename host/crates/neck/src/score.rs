//! How well a session went: errors of the end point and of each joint, and what was asked of the motors.

use super::disturbance::Disturbance;
use super::kinematics::JOINTS;
use super::path;
use super::session::{Session, Setup};
use serde::Serialize;

/// Force of the haptic actuator the thesis compares with, N: 2 g at an amplitude of 1.5 standard gravities (section 5.3).
pub const HAPTIC_FORCE_N: f64 = 0.0294;

/// Stall torque of the 30 mm PCBMotor as the thesis states it, N·m (section 4.4.1.1).
pub const STATED_STALL_NM: f64 = 0.015;

/// The errors and demands of one session.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Score {
    /// The exercise.
    pub exercise: String,
    /// Length of the exercise, s.
    pub duration_s: f64,
    /// Mean square of the end point's distance from its reference, m².
    pub mse_m2: f64,
    /// Mean distance of the end point from its reference, m.
    pub mean_abs_error_m: f64,
    /// Largest distance of the end point from its reference, m.
    pub max_error_m: f64,
    /// Mean distance had the motors followed the path exactly and left the disturbance alone, m.
    pub uncorrected_mean_abs_error_m: f64,
    /// Each joint, joint 1 first.
    pub joints: [JointScore; JOINTS],
}

/// The errors and demands of one joint.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct JointScore {
    /// The joint, from 1.
    pub joint: usize,
    /// Mean square error, deg².
    pub mse_deg2: f64,
    /// Mean absolute error, °.
    pub mean_abs_error_deg: f64,
    /// Largest error, °.
    pub max_error_deg: f64,
    /// Largest torque the path demands, N·m: see [`super::load::Head::demand_nm`].
    pub peak_demand_nm: f64,
    /// That torque over the motor's stall torque.
    pub demand_over_stall: f64,
    /// Mean of the drive's fraction of the PWM period.
    pub mean_duty: f64,
    /// Share of the time at full drive.
    pub saturated_share: f64,
}

/// The force a motor can guide the end point with.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Guidance {
    /// Stall torque, N·m.
    pub stall_nm: f64,
    /// Force at the end point from joint 2, whose lever is the neck's length, N. Joint 1 has the lever `L·|sin θ2|`, none
    /// while the neck is upright, and joint 3 has none at all.
    pub force_n: f64,
    /// That force over the haptic actuator's.
    pub force_over_haptic: f64,
    /// Longest lever at which the motor reaches the haptic actuator's force, m.
    pub longest_lever_m: f64,
}

impl Guidance {
    /// The guidance force a stall torque gives at the end of a neck.
    pub fn of(stall_nm: f64, length_m: f64) -> Self {
        let force_n = stall_nm / length_m;
        Self {
            stall_nm,
            force_n,
            force_over_haptic: force_n / HAPTIC_FORCE_N,
            longest_lever_m: stall_nm / HAPTIC_FORCE_N,
        }
    }
}

impl Score {
    /// Scores a session made with `setup`.
    pub fn of(session: &Session, setup: &Setup) -> Self {
        let mut end_point = Errors::default();
        let mut uncorrected = Errors::default();
        let mut joints = [Errors::default(); JOINTS];
        let mut demand_nm = [0.0f64; JOINTS];
        for tick in 0..session.len() {
            let time_s = session.time_s(tick);
            let motions = path::motion(&session.exercise, time_s);
            let reference = motions.map(|motion| motion.deg);
            let actual = session.joints_deg(tick);
            let wanted = session.wrist.end_point_m(reference);
            end_point.add(session.error_m(tick));
            uncorrected
                .add((session.wrist.end_point_m(drifted(reference, &setup.disturbance, time_s)) - wanted).norm());
            let demand = setup.head.demand_nm(motions, setup.motor.rotor());
            for joint in 0..JOINTS {
                joints[joint].add((actual[joint] - reference[joint]).abs());
                demand_nm[joint] = demand_nm[joint].max(demand[joint].abs());
            }
        }
        let joints = std::array::from_fn(|joint| {
            let drive = &session.joints[joint].drive;
            let over = |share: f64| share / drive.len() as f64;
            JointScore {
                joint: joint + 1,
                mse_deg2: joints[joint].mean_square(),
                mean_abs_error_deg: joints[joint].mean(),
                max_error_deg: joints[joint].max,
                peak_demand_nm: demand_nm[joint],
                demand_over_stall: demand_nm[joint] / setup.motor.stall_nm(),
                mean_duty: over(drive.iter().map(|d| f64::from(d.abs())).sum()),
                saturated_share: over(drive.iter().filter(|d| d.abs() >= 1.0).count() as f64),
            }
        });
        Self {
            exercise: session.exercise.name().to_owned(),
            duration_s: session.exercise.duration_s(),
            mse_m2: end_point.mean_square(),
            mean_abs_error_m: end_point.mean(),
            max_error_m: end_point.max,
            uncorrected_mean_abs_error_m: uncorrected.mean(),
            joints,
        }
    }
}

fn drifted(reference_deg: [f64; JOINTS], disturbance: &Disturbance, time_s: f64) -> [f64; JOINTS] {
    std::array::from_fn(|joint| reference_deg[joint] + disturbance.deg(joint, time_s))
}

#[derive(Debug, Clone, Copy, Default)]
struct Errors {
    count: f64,
    sum: f64,
    squares: f64,
    max: f64,
}

impl Errors {
    fn add(&mut self, error: f64) {
        self.count += 1.0;
        self.sum += error;
        self.squares += error * error;
        self.max = self.max.max(error);
    }

    fn mean(&self) -> f64 {
        self.sum / self.count
    }

    fn mean_square(&self) -> f64 {
        self.squares / self.count
    }
}
