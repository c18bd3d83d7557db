//! A rotor that warms, between rotors that stay as warm as they are.
//!
//! No period of a motor that warms repeats the one before it, and stepping them all takes some fifteen times as long. But warmth changes within a
//! good third of a second and slower, over many periods: at each time the motor is the one that has always been as warm. Two of those are
//! simulated, as warm as at the beginning and at the end, whose periods repeat each other; between them the speed goes with the warmth.

use super::{P, Parameters, RunInput, Trajectory, effective_duty};

/// How warm a motor is during a run at one duty: it goes from one warmth to another with a time constant.
pub(super) struct Warming {
    from: f64,
    to: f64,
    tau_s: f64,
    drive_end: f64,
    /// Share of the way to where it would stand still that it is gone at the end.
    gone_at_end: f64,
}

impl Warming {
    /// Of a run that is driven at one duty and warms; `None` of any other.
    pub(super) fn of(input: &RunInput, p: &Parameters) -> Option<Self> {
        let warms = p.warms() && input.drive_end > 0.0;
        let duty = warms.then(|| input.schedule.only_duty()).flatten()?;
        let tau_s = p.get(P::HeatTau).max(1e-3);
        let to = super::warm_up(input.warmth, effective_duty(duty, p), input.drive_end, tau_s);
        let gone_at_end = -(-input.drive_end / tau_s).exp_m1();
        Some(Self { from: input.warmth, to, tau_s, drive_end: input.drive_end, gone_at_end })
    }

    /// The first warmth and the last.
    pub(super) fn ends(&self) -> [f64; 2] {
        [self.from, self.to]
    }

    /// Share of the way from the first warmth to the last that is gone at `t`, in s of the drive.
    fn gone(&self, t: f64) -> f64 {
        -(-t.clamp(0.0, self.drive_end) / self.tau_s).exp_m1() / self.gone_at_end
    }

    /// The run, from what rotors that are as warm as at its ends do at the same `times`, in s of the drive.
    pub(super) fn between(&self, times: impl Iterator<Item = f64>, [from, to]: &[Trajectory; 2]) -> Trajectory {
        let mix = |gone: f64, from: f64, to: f64| from + gone * (to - from);
        let mut run = Trajectory::default();
        let (mut last_t, mut angle) = (0.0, 0.0);
        for (k, t) in times.enumerate() {
            let turned = |end: &Trajectory| end.angle[k] - k.checked_sub(1).map_or(0.0, |last| end.angle[last]);
            angle += mix(self.gone(0.5 * (last_t + t)), turned(from), turned(to));
            last_t = t;
            run.angle.push(angle);
            run.speed.push(mix(self.gone(t), from.speed[k], to.speed[k]));
        }
        run
    }
}

#[cfg(test)]
mod tests {
    use super::super::simulate::period_by_period;
    use super::super::{RunTerms, Schedule, simulate};
    use super::*;

    /// Speeds over every five periods of runs at three duties, of motors that lose a third of their speed or change their friction by as much as a
    /// warm contact may. Fails if the run does not pass all warmths at their time, or if a motor that has been warm starts cold.
    #[test]
    fn a_warming_motor_is_the_one_that_is_stepped() {
        let times: Vec<f64> = (0..50).map(|k| 0.1 * f64::from(k)).collect();
        let angles = vec![0.0; times.len()];
        let rotor = Parameters::new(3.6, 900.0, 700.0, 0.3, 0.1).with(P::WaveTime, 1e-3).with(P::Lift, 0.1);
        for duty in [0.2, 0.6, 1.0] {
            let schedule = Schedule::constant(duty, 1.0, 50.0, 0.0, 4.5);
            let input = RunInput {
                schedule: &schedule,
                drive_end: 4.5,
                times: &times,
                half_sample_s: 0.0,
                angles: &angles,
                warmth: 0.3,
                revolutions: 0.0,
                formulas: &[],
            };
            for (change, size) in [(P::HeatLoss, 0.33), (P::HeatFriction, 0.9), (P::HeatFriction, -0.5)] {
                for tau_s in [0.3, 2.0, 60.0] {
                    let p = rotor.with(change, size).with(P::HeatTau, tau_s);
                    let [fast, slow] = [simulate, period_by_period].map(|f| f(&input, &p, &RunTerms::default()).angle);
                    let most = 0.1 * 3.6 * duty;
                    for (k, (a, b)) in fast.windows(2).zip(slow.windows(2)).enumerate() {
                        let off = ((a[1] - a[0]) - (b[1] - b[0])) / most;
                        assert!(
                            off.abs() < 3e-3,
                            "{change:?} {size} in {tau_s} s at {duty}: {off} of the speed at {k}"
                        );
                    }
                }
            }
        }
    }
}
