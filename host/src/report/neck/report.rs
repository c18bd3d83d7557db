//! What a run of exercises gives: the scores beside the thesis's table, for people and for programs.

use crate::model::motor_plant::Solver;
use crate::model::parameters::Flavour;
use crate::neck::kinematics::JOINTS;
use crate::neck::score::{Guidance, HAPTIC_FORCE_N, STATED_STALL_NM, Score};
use crate::neck::session::Setup;
use crate::neck::thesis_table::{Row, TABLE_5_6};
use crate::report::table::table;
use serde::Serialize;
use std::fmt::Write as _;

/// The answer of `twum neck`, as its JSON prints it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Version of this shape.
    pub schema: u32,
    /// How it was made.
    pub setup: SetupSummary,
    /// Each exercise.
    pub exercises: Vec<Beside>,
    /// The worst of the exercises' mean absolute end-point errors, m.
    pub worst_mean_abs_error_m: f64,
    /// What the motor as simulated can guide the end point with.
    pub guidance: Guidance,
    /// What a motor with the stall torque the thesis states could.
    pub guidance_stated: Guidance,
    /// Force of the haptic actuator the thesis compares with, N.
    pub haptic_force_n: f64,
}

/// How a report was made.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SetupSummary {
    /// The motor.
    pub motor: String,
    /// Flavour of its model.
    pub flavour: Flavour,
    /// How the model is solved.
    pub solver: Solver,
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
    /// Joints disturbed, from 1.
    pub disturbance_joints: Vec<usize>,
    /// Mass of the head carried, kg.
    pub head_kg: f64,
    /// Distance of its centre from the wrist's, m.
    pub head_centre_m: f64,
    /// Distance of the end point from the wrist's centre, m.
    pub neck_length_m: f64,
    /// Speed of the motor without load at full drive, °/s.
    pub no_load_deg_s: f64,
    /// Torque of the motor at standstill and full drive, N·m.
    pub stall_nm: f64,
}

/// A score, and what the thesis printed for the same exercise.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Beside {
    /// Ours.
    #[serde(flatten)]
    pub score: Score,
    /// The thesis's row of Table 5.6, null for exercises it does not have.
    pub thesis: Option<Printed>,
}

/// A row of Table 5.6 with the bounds its mean square error breaks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Printed {
    /// Mean square error as printed, said to be m².
    pub mse_as_printed: f64,
    /// Mean absolute error as printed, m.
    pub mean_abs_error_m: f64,
    /// Smallest mean square error that goes with that mean, m².
    pub least_possible_mse_m2: f64,
    /// Largest mean square error that goes with that mean, m².
    pub largest_possible_mse_m2: f64,
    /// Whether the printed one lies between them.
    pub consistent: bool,
}

impl From<&Row> for Printed {
    fn from(row: &Row) -> Self {
        let (least_possible_mse_m2, largest_possible_mse_m2) = row.possible_mse_m2();
        Self {
            mse_as_printed: row.mse,
            mean_abs_error_m: row.mean_abs_error_m,
            least_possible_mse_m2,
            largest_possible_mse_m2,
            consistent: row.consistent(),
        }
    }
}

impl Report {
    /// A report of scores made with one setup.
    pub fn new(setup: &Setup, scores: Vec<Score>) -> Self {
        let joints = setup.disturbance.joints;
        Self {
            schema: 1,
            setup: SetupSummary {
                motor: setup.motor.name().to_owned(),
                flavour: setup.motor.flavour(),
                solver: setup.motor.solver(),
                control: setup.control.name.clone(),
                edges_per_rev: setup.edges_per_rev,
                pwm_hz: setup.pwm_hz,
                disturbance_deg: setup.disturbance.amplitude_deg,
                disturbance_hz: setup.disturbance.frequency_hz,
                disturbance_phase_deg: setup.disturbance.phase_deg,
                disturbance_joints: (0..JOINTS).filter(|&joint| joints[joint]).map(|joint| joint + 1).collect(),
                head_kg: setup.head.mass_kg,
                head_centre_m: setup.head.centre_m,
                neck_length_m: setup.wrist.length_m,
                no_load_deg_s: setup.motor.no_load_deg_s(),
                stall_nm: setup.motor.stall_nm(),
            },
            worst_mean_abs_error_m: scores.iter().map(|score| score.mean_abs_error_m).fold(0.0, f64::max),
            exercises: scores
                .into_iter()
                .map(|score| Beside { thesis: Row::of(&score.exercise).map(Printed::from), score })
                .collect(),
            guidance: Guidance::of(setup.motor.stall_nm(), setup.wrist.length_m),
            guidance_stated: Guidance::of(STATED_STALL_NM, setup.wrist.length_m),
            haptic_force_n: HAPTIC_FORCE_N,
        }
    }

    /// How the report was made, in a line.
    pub fn setup_line(&self) -> String {
        let s = &self.setup;
        let disturbance = if s.disturbance_joints.is_empty() || s.disturbance_deg == 0.0 {
            "no disturbance".to_owned()
        } else {
            let joints: Vec<String> = s.disturbance_joints.iter().map(ToString::to_string).collect();
            format!("disturbance {}° at {} Hz on joints {}", s.disturbance_deg, s.disturbance_hz, joints.join(", "))
        };
        let head = if s.head_kg > 0.0 {
            format!(", a head of {} kg at {} m", s.head_kg, s.head_centre_m)
        } else {
            String::new()
        };
        format!(
            "{} ({} flavour, {} model), {} controller, {} edges a revolution, {} Hz PWM, {disturbance}{head}",
            s.motor,
            s.flavour,
            match s.solver {
                Solver::Averaged => "averaged",
                Solver::Carrier => "carrier",
            },
            s.control,
            s.edges_per_rev,
            s.pwm_hz,
        )
    }

    /// The report for people.
    pub fn text(&self) -> String {
        let mut out = format!("{}\n\n", self.setup_line());
        let end_point = |Beside { score, thesis }: &Beside| {
            let [mean, mse] = thesis.map_or(["-".to_owned(), "-".to_owned()], |row| {
                [format!("{:.4e}", row.mean_abs_error_m), format!("{:.3e}", row.mse_as_printed)]
            });
            vec![
                score.exercise.clone(),
                format!("{:.5}", score.mean_abs_error_m),
                format!("{:.3e}", score.mse_m2),
                format!("{:.5}", score.max_error_m),
                format!("{:.5}", score.uncorrected_mean_abs_error_m),
                mean,
                mse,
            ]
        };
        let header = ["end point", "mean (m)", "MSE (m²)", "worst (m)", "left alone*", "thesis mean (m)", "thesis MSE"];
        out += &table(&header, &self.exercises.iter().map(end_point).collect::<Vec<_>>());
        let _ = writeln!(out, "worst mean absolute error: {:.5} m", self.worst_mean_abs_error_m);
        let _ =
            writeln!(out, "* mean error (m) had the motors followed the path exactly and left the disturbance alone\n");

        let mut rows = Vec::new();
        for Beside { score, .. } in &self.exercises {
            for joint in &score.joints {
                rows.push(vec![
                    if joint.joint == 1 { score.exercise.clone() } else { String::new() },
                    joint.joint.to_string(),
                    format!("{:.3}", joint.mean_abs_error_deg),
                    format!("{:.3}", joint.max_error_deg),
                    format!("{:.4}", joint.mse_deg2),
                    format!("{:.4}", joint.peak_demand_nm * 1e3),
                    format!("{:.2}%", joint.demand_over_stall * 1e2),
                    format!("{:.3}", joint.mean_duty),
                    format!("{:.1}%", joint.saturated_share * 1e2),
                ]);
            }
        }
        let header = [
            "joints",
            "joint",
            "mean (°)",
            "worst (°)",
            "MSE (°²)",
            "torque (mN·m)",
            "of stall",
            "mean duty",
            "saturated",
        ];
        out += &table(&header, &rows);
        let overpowered = self.exercises.iter().flat_map(|e| e.score.joints.iter().map(move |j| (&e.score, j)));
        for (score, joint) in overpowered.filter(|(_, joint)| joint.demand_over_stall > 1.0) {
            let _ = writeln!(
                out,
                "{}: joint {} needs {:.1} times the motor's stall torque; it is overpowered",
                score.exercise, joint.joint, joint.demand_over_stall
            );
        }

        let _ = writeln!(out, "\nguidance force at the end point (joint 2, lever {} m):", self.setup.neck_length_m);
        for (name, guidance) in [("as simulated", &self.guidance), ("15 mN·m as stated", &self.guidance_stated)] {
            let _ = writeln!(
                out,
                "  {name:<18} stall {:.3} mN·m: {:.4} N, {:.2} times the {} N of the haptic actuator (which it reaches on levers up to {:.3} m)",
                guidance.stall_nm * 1e3,
                guidance.force_n,
                guidance.force_over_haptic,
                self.haptic_force_n,
                guidance.longest_lever_m,
            );
        }
        if self.exercises.iter().any(|e| e.thesis.is_some()) {
            out.push('\n');
            out.push_str(&units_note());
        }
        out
    }
}

/// Why the thesis's mean square errors cannot be in m².
fn units_note() -> String {
    let mut out = "The thesis's MSE column (Table 5.6) cannot be in m²: a mean square lies between the mean squared and the mean\n\
                   times the largest possible distance (2 × 0.239 m).\n"
        .to_owned();
    for row in TABLE_5_6 {
        let (low, high) = row.possible_mse_m2();
        let _ = writeln!(
            out,
            "  {:<18} mean {:.4e} m allows {low:.2e} to {high:.2e} m²; printed {}",
            row.exercise, row.mean_abs_error_m, row.mse
        );
    }
    out
}
