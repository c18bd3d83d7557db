//! How honest the load is that a controller believes, against the hand that pushed.

use super::closed_loop::{Hand, Tick};
use serde::Serialize;

/// What a controller with a target that gives way believed, from when on the hand was there.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Guidance {
    /// Share of the ticks in which the load was believed (1).
    pub believed: f64,
    /// Mean amount by which it was off the hand then (N·m).
    pub mean_abs_error_nm: f64,
    /// Mean by which it was off then, clockwise (N·m).
    pub mean_error_nm: f64,
    /// Mean amount of the hand's torque (N·m): what an estimate of none would be off by.
    pub mean_abs_hand_nm: f64,
    /// Farthest that the target was off its path (counts).
    pub farthest_counts: f64,
}

impl Guidance {
    /// Of a run; none without a tick with the hand there.
    pub fn of(hand: &Hand, trace: &[Tick]) -> Option<Self> {
        let held: Vec<&Tick> = trace.iter().filter(|tick| tick.time_s > hand.from_s).collect();
        let all = held.len() as f64;
        let errors: Vec<f64> = held.iter().filter_map(|tick| Some(tick.load_nm? - hand.at(tick.time_s))).collect();
        let mean = |values: &mut dyn Iterator<Item = f64>, count: f64| values.sum::<f64>() / count.max(1.0);
        (!held.is_empty()).then(|| Self {
            believed: errors.len() as f64 / all,
            mean_abs_error_nm: mean(&mut errors.iter().map(|e| e.abs()), errors.len() as f64),
            mean_error_nm: mean(&mut errors.iter().copied(), errors.len() as f64),
            mean_abs_hand_nm: mean(&mut held.iter().map(|tick| hand.at(tick.time_s).abs()), all),
            farthest_counts: held.iter().map(|tick| tick.deviation.abs()).fold(0.0, f64::max),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::motor::Motor;
    use super::super::parameters::Flavour;
    use super::super::robust::{Candidate, ROTORS, Study, Target, robust};
    use super::*;
    use twum_shared::step::{Config, ConfigSpec, GuideSpec};

    #[test]
    fn a_hand_comes_when_it_is_to_and_pushes_as_it_is_to() {
        let ramp = Hand { torque_nm: 2.0, frequency_hz: 0.0, from_s: 1.0, until_s: 3.0 };
        assert_eq!([0.0, 1.0, 2.0, 3.0, 9.0].map(|t| ramp.at(t)), [0.0, 0.0, 1.0, 2.0, 2.0]);
        let sine = Hand { frequency_hz: 0.25, ..ramp };
        assert!([(0.5, 0.0), (2.0, 2.0), (4.0, -2.0)].iter().all(|(t, nm)| (sine.at(*t) - nm).abs() < 1e-9));
    }

    /// Fails when a load is believed on a rotor that the drive's end clamps, where none can be told, or of the wrong sense on one that runs
    /// on.
    #[test]
    fn a_hand_is_believed_on_a_rotor_that_runs_on_and_on_no_other() {
        let motor = Motor::pcbmotor_30mm();
        let hand = Hand { torque_nm: 120e-6, frequency_hz: 0.0, from_s: 10.0, until_s: 25.0 };
        let config = Config::try_from(ConfigSpec { guide: GuideSpec::EXAMPLE, ..ConfigSpec::PLANNED }).unwrap();
        let guided = Candidate { name: "guided".to_owned(), config, pwm_hz: 2_000.0 };
        let target = Target::Sine { amplitude: 89, omega_rad_s: 1.257 };
        let study = Study { motor: &motor, target, load: 0.0, hand: Some(hand), seconds: 25.0, draws: 4, seed: 5 };
        let cells = robust(&study, &[guided], &ROTORS[..2]).unwrap();
        let [clamped, braking] = [0, 1].map(|k| cells[k].outcomes.iter().map(|o| o.guidance.unwrap()));
        assert_eq!(ROTORS[0].1, Flavour::Physical);
        assert!(clamped.clone().all(|felt| felt.believed < 0.1), "{:?}", clamped.collect::<Vec<_>>());
        // On motors that differ hardly more than the sense is sure (docs/control.md).
        let right = |felt: &Guidance| felt.believed > 0.5 && felt.mean_error_nm > -felt.mean_abs_hand_nm;
        assert!(braking.clone().all(|felt| right(&felt)), "{:?}", braking.collect::<Vec<_>>());
    }
}
