//! One joint: a motor under the firmware's control step, its PWM, and a sensor on the joint.

use super::disturbance::Disturbance;
use super::exercise::Exercise;
use super::kinematics::JOINTS;
use super::path;
use twum_motor::actuator::Pwm;
use twum_motor::effects::EffectSet;
use twum_motor::plant::Plant;
use twum_shared::Duty;
use twum_shared::reference::Reference;
use twum_shared::step::{Config, Inputs, State, step};

/// Everything about a joint's loop but its motor. Angles and counts are relative to the joint's start, so that joints
/// that differ by a whole number of counts do exactly the same.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Loop {
    /// The reference, counts.
    pub reference: Reference,
    /// How far the start lies from the count it is rounded to, counts.
    pub start_phase: f64,
    /// What pushes this joint.
    pub disturbance: Disturbance,
    /// Which joint the disturbance is taken of.
    pub joint: usize,
}

/// What a joint did, one entry a control tick, taken at the tick's start.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JointTrace {
    /// True angle from the start on, °: the motor's and the disturbance's together.
    pub deg: Vec<f64>,
    /// Drive, as a fraction of the PWM period with the sign of its direction.
    pub drive: Vec<f32>,
}

/// What all joints of a session have in common.
#[derive(Debug, Clone, Copy)]
pub(super) struct Common<'a> {
    pub config: &'a Config,
    pub edges_per_rev: u32,
    pub pwm_hz: f64,
}

impl Loop {
    /// The loop that takes a joint through an exercise.
    pub fn new(exercise: &Exercise, joint: usize, disturbance: &Disturbance, edges_per_rev: u32) -> Self {
        let start = exercise.start_deg()[joint] * f64::from(edges_per_rev) / 360.0;
        let reference = path::reference(exercise, joint, edges_per_rev);
        Self { reference, start_phase: start - start.round(), disturbance: *disturbance, joint }
    }

    /// Whether two loops on the same motor must do the same.
    pub fn repeats(&self, other: &Self) -> bool {
        let pushed =
            |run: &Self| Disturbance { joints: [run.disturbance.joints[run.joint]; JOINTS], ..run.disturbance };
        self.reference == other.reference && self.start_phase == other.start_phase && pushed(self) == pushed(other)
    }

    /// Runs the loop for some ticks on a plant at rest, with the effects of the actuator path.
    ///
    /// The sensor sits on the joint and counts the edges crossed, so a disturbance is seen and has to be rejected.
    pub fn run(&self, common: Common, ticks: usize, plant: &mut impl Plant, effects: &EffectSet) -> JointTrace {
        let mut trace = JointTrace { deg: Vec::with_capacity(ticks), drive: Vec::with_capacity(ticks) };
        let mut state = State::REST;
        let mut pwm = Pwm::new(common.pwm_hz, 0.0, effects);
        let tick_us = u64::from(common.config.spec().period_us);
        let mut edges_before = self.start_phase;
        for tick in 0..ticks as u64 {
            let now_us = tick * tick_us;
            let deg = plant.position_rad().to_degrees() + self.disturbance.deg(self.joint, now_us as f64 * 1e-6);
            let target = self.reference.at(now_us);
            let edges = self.start_phase + deg * f64::from(common.edges_per_rev) / 360.0;
            let inputs = Inputs {
                target: target.position,
                target_rate: target.rate,
                target_fraction: target.fraction,
                position: count(edges),
                edge_age_us: edge_age_us(edges_before, edges, tick_us),
            };
            edges_before = edges;
            let outputs = step(common.config, &mut state, inputs);
            let duty = f64::from(outputs.duty(common.config).raw()) / f64::from(Duty::FULL.raw());
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

/// The count of an incremental encoder at an angle in edges.
fn count(edges: f64) -> i32 {
    // The small share of an edge keeps a joint that stands on an edge from flickering with the last bit of a double.
    (edges + 1e-9).floor() as i32
}

/// How long before the end of a tick the last edge was crossed, µs, for a joint that moved evenly in it; without one, longer.
fn edge_age_us(before: f64, now: f64, tick_us: u64) -> u16 {
    let last = f64::from(count(now)) + if now < before { 1.0 } else { 0.0 };
    if count(before) == count(now) {
        return u16::MAX;
    }
    // A cast saturates.
    ((now - last) / (now - before) * tick_us as f64) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::at_resolution;
    use twum_motor::plant::{Drive, Segment};
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

    fn run(exercise: &Exercise, joint: usize, disturbance: &Disturbance, edges_per_rev: u32) -> JointTrace {
        let config = at_resolution(&ConfigSpec::DEFAULT, edges_per_rev).unwrap();
        let common = Common { config: &config, edges_per_rev, pwm_hz: 50.0 };
        let run = Loop::new(exercise, joint, disturbance, edges_per_rev);
        run.run(common, 44_001, &mut Ideal::default(), &EffectSet::default())
    }

    fn worst_deg(exercise: &Exercise, joint: usize, disturbance: &Disturbance, edges_per_rev: u32) -> f64 {
        let start_deg = exercise.start_deg()[joint];
        let error = |(tick, deg): (usize, &f64)| {
            (start_deg + deg - path::motion(exercise, tick as f64 * 500e-6)[joint].deg).abs()
        };
        run(exercise, joint, disturbance, edges_per_rev).deg.iter().enumerate().map(error).fold(0.0, f64::max)
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
        let counts = [0.0, 0.89, 0.9, 89.9, 90.0, -0.1, -0.9, -0.91].map(|deg| count(deg / 0.9));
        assert_eq!(counts, [0, 0, 1, 99, 100, -1, -1, -2]);
    }

    /// What lets a session compute a resting joint once: fails if a loop depends on where its joint starts.
    #[test]
    fn joints_that_repeat_do_exactly_the_same() {
        let [bending, turning] = ["flexion-extension", "rotation"].map(|name| Exercise::shipped(name).unwrap());
        let disturbance = Disturbance::default();
        let all = |exercise: &Exercise| [0, 1, 2].map(|joint| Loop::new(exercise, joint, &disturbance, 4096));
        let ([a1, a2, a3], [b1, b2, b3]) = (all(&bending), all(&turning));
        assert!(a1.repeats(&a3) && a1.repeats(&b2) && b2.repeats(&b3));
        assert!(!a1.repeats(&a2) && !a2.repeats(&b1));
        assert_eq!(run(&bending, 0, &disturbance, 4096), run(&turning, 2, &disturbance, 4096));
        let one_only = Disturbance { joints: [true, false, false], ..disturbance };
        assert!(!Loop::new(&bending, 0, &one_only, 4096).repeats(&Loop::new(&bending, 2, &one_only, 4096)));
        // 400 edges do not divide 45°: half an edge of phase makes another loop.
        let other = Exercise { start_deg: [45.45, 0.0, 0.0], ..bending.clone() };
        assert!(!Loop::new(&other, 0, &disturbance, 400).repeats(&Loop::new(&other, 2, &disturbance, 400)));
    }
}
