//! One joint: a motor under the firmware's control step, its PWM, and a sensor on the joint.

use super::disturbance::Disturbance;
use crate::model::actuator::Pwm;
use crate::model::effects::EffectSet;
use crate::model::plant::Plant;
use std::f64::consts::TAU;
use twum_shared::Duty;
use twum_shared::reference::Reference;
use twum_shared::step::{Config, Inputs, State, step};

/// Everything about a joint's loop but its motor.
pub(super) struct Loop<'a> {
    pub config: &'a Config,
    pub reference: Reference,
    pub start_deg: f64,
    pub joint: usize,
    pub disturbance: &'a Disturbance,
    pub edges_per_rev: u32,
    pub pwm_hz: f64,
    pub ticks: usize,
}

/// What a joint did, one entry a control tick, taken at the tick's start.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JointTrace {
    /// True angle, °: the motor's and the disturbance's together.
    pub deg: Vec<f64>,
    /// Drive, as a fraction of the PWM period with the sign of its direction.
    pub drive: Vec<f32>,
}

impl Loop<'_> {
    /// Runs the loop on a plant at rest, with the effects of the actuator path.
    ///
    /// The sensor sits on the joint and counts the edges crossed, so a disturbance is seen and has to be rejected.
    pub fn run(self, plant: &mut impl Plant, effects: &EffectSet) -> JointTrace {
        let mut trace = JointTrace { deg: Vec::with_capacity(self.ticks), drive: Vec::with_capacity(self.ticks) };
        let mut state = State::REST;
        let mut pwm = Pwm::new(self.pwm_hz, 0.0, effects);
        let tick_us = u64::from(self.config.spec().period_us);
        for tick in 0..self.ticks as u64 {
            let now_us = tick * tick_us;
            let drift_deg = self.disturbance.deg(self.joint, now_us as f64 * 1e-6);
            let deg = self.start_deg + plant.position_rad().to_degrees() + drift_deg;
            let target = self.reference.at(now_us);
            let inputs =
                Inputs { target: target.position, target_rate: target.rate, position: count(deg, self.edges_per_rev) };
            let outputs = step(self.config, &mut state, inputs);
            let duty = f64::from(outputs.duty(self.config).raw()) / f64::from(Duty::FULL.raw());
            trace.deg.push(deg);
            trace.drive.push((duty * f64::from(outputs.direction.sign())) as f32);
            match tick {
                0 => pwm.begin(duty, outputs.direction),
                _ => pwm.command(duty, outputs.direction),
            }
            pwm.advance(plant, (now_us + tick_us) as f64 * 1e-6, &mut |_| {});
        }
        trace
    }
}

/// The count of an incremental encoder that has counted every edge from zero.
fn count(deg: f64, edges_per_rev: u32) -> i32 {
    // The small share of an edge keeps a joint that stands on an edge from flickering with the last bit of a double.
    (deg.to_radians() / TAU * f64::from(edges_per_rev) + 1e-9).floor() as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::plant::{Drive, Segment};
    use crate::neck::control::at_resolution;
    use crate::neck::exercise::Exercise;
    use crate::neck::path;
    use twum_shared::step::ConfigSpec;

    /// A motor that reaches its speed at once and stops at once: all that a loop needs to be tested.
    #[derive(Default)]
    struct Ideal {
        now_s: f64,
        rad: f64,
    }

    impl Plant for Ideal {
        fn time_s(&self) -> f64 {
            self.now_s
        }

        fn position_rad(&self) -> f64 {
            self.rad
        }

        fn speed_rad_s(&self) -> f64 {
            0.0
        }

        fn advance(&mut self, until_s: f64, drive: Drive, _: &mut dyn FnMut(&Segment)) {
            self.rad += (until_s - self.now_s) * 3.6 * drive.level * drive.sign();
            self.now_s = until_s;
        }
    }

    fn worst_deg(exercise: &Exercise, joint: usize, disturbance: &Disturbance, edges_per_rev: u32) -> f64 {
        let config = at_resolution(&ConfigSpec::DEFAULT, edges_per_rev).unwrap();
        let trace = Loop {
            config: &config,
            reference: path::reference(exercise, joint, edges_per_rev),
            start_deg: exercise.start_deg()[joint],
            joint,
            disturbance,
            edges_per_rev,
            pwm_hz: 50.0,
            ticks: 44_001,
        }
        .run(&mut Ideal::default(), &EffectSet::default());
        let error = |(tick, deg): (usize, &f64)| (deg - path::motion(exercise, tick as f64 * 500e-6)[joint].deg).abs();
        trace.deg.iter().enumerate().map(error).fold(0.0, f64::max)
    }

    /// Fails if the sensor does not see the disturbance, the loop works the wrong way, or a joint starts off its path.
    #[test]
    fn the_loop_follows_the_path_and_rejects_the_disturbance() {
        for name in Exercise::SHIPPED {
            let exercise = Exercise::shipped(name).unwrap();
            for joint in 0..3 {
                let worst = worst_deg(&exercise, joint, &Disturbance::default(), 4096);
                assert!(worst < 1.5, "{name}, joint {joint}: {worst}° with a disturbance of 5°");
            }
        }
    }

    #[test]
    fn a_coarse_sensor_leaves_a_coarse_error() {
        let exercise = Exercise::shipped("flexion-extension").unwrap();
        let worst = |edges_per_rev| worst_deg(&exercise, 1, &Disturbance::NONE, edges_per_rev);
        assert!(worst(100) > 3.6 / 2.0 && worst(4096) < 0.9, "{} and {}", worst(100), worst(4096));
    }

    #[test]
    fn counts_are_edges_crossed() {
        let counts = [0.0, 0.89, 0.9, 89.9, 90.0, -0.1, -0.9, -0.91].map(|deg| count(deg, 400));
        assert_eq!(counts, [0, 0, 1, 99, 100, -1, -1, -2]);
    }
}
