//! One joint: a motor under the firmware's control step, its PWM, and a sensor on the joint.

use super::disturbance::Disturbance;
use std::f64::consts::TAU;
use twum_shared::reference::Reference;
use twum_shared::step::{Config, Inputs, State, step};
use twum_shared::{Direction, Duty};

/// What turns a joint. Times run from the start of the session.
pub(super) trait Motor {
    /// Advances to `until_s` with the drive fully on or off.
    fn advance(&mut self, until_s: f64, on: bool, direction: Direction);
    /// Sets the load torque against positive rotation, N·m.
    fn set_load_nm(&mut self, load_nm: f64);
    /// Angle turned since the start, rad.
    fn angle_rad(&self) -> f64;
}

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
    /// Runs the loop; `load_nm` gives the load torque at a joint angle in degrees.
    ///
    /// The sensor sits on the joint and counts the edges crossed, so a disturbance is seen and has to be rejected. As on
    /// the driver board, a new direction takes effect at once and a new duty with the next PWM period, whose off part
    /// comes first.
    pub fn run(self, motor: &mut impl Motor, load_nm: impl Fn(f64) -> f64) -> JointTrace {
        let mut trace = JointTrace { deg: Vec::with_capacity(self.ticks), drive: Vec::with_capacity(self.ticks) };
        let mut state = State::REST;
        let mut pwm = Pwm::new(self.pwm_hz);
        let tick_ns = u64::from(self.config.spec().period_us) * 1000;
        for tick in 0..self.ticks as u64 {
            let now_ns = tick * tick_ns;
            let drift_deg = self.disturbance.deg(self.joint, now_ns as f64 * 1e-9);
            let deg = self.start_deg + motor.angle_rad().to_degrees() + drift_deg;
            let target = self.reference.at(now_ns / 1000);
            let inputs =
                Inputs { target: target.position, target_rate: target.rate, position: count(deg, self.edges_per_rev) };
            let outputs = step(self.config, &mut state, inputs);
            let duty = outputs.duty(self.config);
            trace.deg.push(deg);
            trace
                .drive
                .push((f64::from(duty.raw()) / f64::from(Duty::FULL.raw())) as f32 * outputs.direction.sign() as f32);
            motor.set_load_nm(load_nm(deg));
            pwm.run(now_ns + tick_ns, duty, |until_s, on| motor.advance(until_s, on, outputs.direction));
        }
        trace
    }
}

/// The count of an incremental encoder that has counted every edge from zero.
fn count(deg: f64, edges_per_rev: u32) -> i32 {
    // The small share of an edge keeps a joint that stands on an edge from flickering with the last bit of a double.
    (deg.to_radians() / TAU * f64::from(edges_per_rev) + 1e-9).floor() as i32
}

/// The output stage: PWM periods with their off part first.
struct Pwm {
    period_ns: u64,
    begin_ns: u64,
    now_ns: u64,
    off_ns: u64,
}

impl Pwm {
    fn new(hz: f64) -> Self {
        let period_ns = (1e9 / hz).round() as u64;
        Self { period_ns, begin_ns: 0, now_ns: 0, off_ns: period_ns }
    }

    /// Runs to `until_ns`, calling `slice` with the end, s, of every stretch the drive is on or off.
    fn run(&mut self, until_ns: u64, duty: Duty, mut slice: impl FnMut(f64, bool)) {
        while self.now_ns < until_ns {
            if self.now_ns == self.begin_ns {
                let on_ns = self.period_ns * u64::from(duty.raw()) / u64::from(Duty::FULL.raw());
                self.off_ns = self.period_ns - on_ns;
            }
            let edge_ns = self.begin_ns + self.off_ns;
            let on = self.now_ns >= edge_ns;
            let end_ns = if on { self.begin_ns + self.period_ns } else { edge_ns };
            self.now_ns = until_ns.min(end_ns);
            slice(self.now_ns as f64 * 1e-9, on);
            if self.now_ns == self.begin_ns + self.period_ns {
                self.begin_ns = self.now_ns;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::neck::control::at_resolution;
    use crate::neck::exercise::Exercise;
    use crate::neck::path;
    use twum_shared::step::ConfigSpec;

    /// A motor that reaches its speed at once and stops at once: all that a loop needs to be tested.
    struct Ideal {
        now_s: f64,
        rad: f64,
        rad_s: f64,
        on_s: f64,
        load_nm: f64,
    }

    impl Ideal {
        fn new(rad_s: f64) -> Self {
            Self { now_s: 0.0, rad: 0.0, rad_s, on_s: 0.0, load_nm: 0.0 }
        }
    }

    impl Motor for Ideal {
        fn advance(&mut self, until_s: f64, on: bool, direction: Direction) {
            if on {
                self.rad += (until_s - self.now_s) * self.rad_s * f64::from(direction.sign());
                self.on_s += until_s - self.now_s;
            }
            self.now_s = until_s;
        }

        fn set_load_nm(&mut self, load_nm: f64) {
            self.load_nm = load_nm;
        }

        fn angle_rad(&self) -> f64 {
            self.rad
        }
    }

    #[test]
    fn pwm_is_on_at_the_end_of_its_period_for_its_share_of_it() {
        let mut pwm = Pwm::new(50.0);
        let mut slices = Vec::new();
        for tick in 1..=80u64 {
            // A duty that changes inside a period waits for the next one.
            let duty = Duty::from_ratio(if tick <= 20 { 1 } else { 3 }, 4);
            pwm.run(tick * 500_000, duty, |until_s, on| slices.push(((until_s * 1e9).round() as u64, on)));
        }
        let on_ns = |from: u64, to: u64| -> u64 {
            let ends = slices.iter();
            let begins = std::iter::once(0).chain(slices.iter().map(|s| s.0));
            ends.zip(begins)
                .filter(|((end, on), _)| *on && *end > from && *end <= to)
                .map(|((end, _), b)| end - b)
                .sum()
        };
        assert_eq!(on_ns(0, 15_000_000), 0);
        assert_eq!(on_ns(15_000_000, 20_000_000), 5_000_000);
        assert_eq!(on_ns(20_000_000, 25_000_000), 0);
        assert_eq!(on_ns(25_000_000, 40_000_000), 15_000_000);
    }

    #[test]
    fn pwm_runs_at_any_frequency_without_drift() {
        for hz in [37.0, 50.0, 333.3, 1e5] {
            let mut pwm = Pwm::new(hz);
            let (mut last, mut on_s) = (0.0, 0.0);
            for tick in 1..=20_000u64 {
                pwm.run(tick * 500_000, Duty::from_ratio(1, 4), |until_s, on| {
                    on_s += if on { until_s - last } else { 0.0 };
                    last = until_s;
                });
            }
            assert!((last - 10.0).abs() < 1e-9);
            assert!((on_s - 2.5).abs() < 1.0 / hz, "{hz} Hz: on for {on_s} of 10 s");
        }
    }

    #[test]
    fn the_loop_rejects_the_disturbance_on_an_ideal_motor() {
        let exercise = Exercise::shipped("flexion-extension").unwrap();
        let config = at_resolution(&ConfigSpec::DEFAULT, 4096).unwrap();
        let disturbance = Disturbance::default();
        let trace = Loop {
            config: &config,
            reference: path::reference(&exercise, 1, 4096),
            start_deg: 0.0,
            joint: 1,
            disturbance: &disturbance,
            edges_per_rev: 4096,
            pwm_hz: 50.0,
            ticks: 44_001,
        }
        .run(&mut Ideal::new(3.6), |_| 0.0);
        let worst = trace
            .deg
            .iter()
            .enumerate()
            .map(|(tick, deg)| (deg - path::motion(&exercise, tick as f64 * 500e-6)[1].deg).abs());
        let worst = worst.fold(0.0, f64::max);
        assert!(worst < 2.5, "{worst}° with a disturbance of 5°");
    }

    #[test]
    fn counts_are_edges_crossed() {
        assert_eq!(
            [0.0, 0.89, 0.9, 89.9, 90.0, -0.1, -0.9, -0.91].map(|deg| count(deg, 400)),
            [0, 0, 1, 99, 100, -1, -1, -2]
        );
    }

    #[test]
    fn the_load_follows_the_joint() {
        let exercise = Exercise::shipped("lateral-flexion").unwrap();
        let config = at_resolution(&ConfigSpec::DEFAULT, 4096).unwrap();
        let mut motor = Ideal::new(3.6);
        Loop {
            config: &config,
            reference: path::reference(&exercise, 1, 4096),
            start_deg: 0.0,
            joint: 1,
            disturbance: &Disturbance::NONE,
            edges_per_rev: 4096,
            pwm_hz: 50.0,
            ticks: 10_000,
        }
        .run(&mut motor, |deg| -deg);
        assert!((motor.load_nm + 45.0).abs() < 1.0, "{}", motor.load_nm);
    }
}
