//! The next runs to make: what would decide what is open.

use super::answer::Diagnosis;
use twum_record::measurement::{Direction, Measurement, RunKind};
use twum_record::series::SeriesRun;

/// A run worth making.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct PlannedRun {
    /// On fraction.
    pub duty: f64,
    /// `cw` or `ccw`.
    pub direction: &'static str,
    /// PWM frequency in Hz.
    pub pwm_hz: f64,
    /// Length of the drive in s.
    pub seconds: f64,
    /// Pause before it in s.
    pub pause_s: f64,
    /// What it decides.
    pub why: String,
}

impl PlannedRun {
    /// Identifier, unique within a plan by its number.
    pub fn id(&self, number: usize) -> String {
        format!("{number:03}-d{:03.0}-{}-{:.0}hz", 100.0 * self.duty, self.direction, self.pwm_hz)
    }

    /// The run as a series keeps it.
    pub fn in_series(&self, number: usize) -> SeriesRun {
        SeriesRun {
            id: self.id(number),
            duty: self.duty,
            direction: self.direction.to_owned(),
            pwm_hz: self.pwm_hz,
            seconds: self.seconds,
            pause_s: self.pause_s,
            why: self.why.clone(),
        }
    }

    /// The command that makes it.
    pub fn command(&self, number: usize, port: &str, folder: &str) -> String {
        let pause = if self.pause_s > 0.0 { format!("sleep {:.0}; ", self.pause_s) } else { String::new() };
        format!(
            "{pause}twum speed --port {port} --duty {:.4} --direction {} --pwm-hz {:.0} --seconds {} --out {folder}/{}.mcap",
            self.duty,
            self.direction,
            self.pwm_hz,
            self.seconds,
            self.id(number)
        )
    }
}

/// A first experiment where nothing has been measured yet: `trials` repetitions of `duties` in both directions, in an
/// order that neither rises nor falls, so that warmth and wear cannot pose as duty.
pub fn first_experiment(duties: &[f64], trials: usize, seconds: f64, pwm_hz: f64) -> Vec<PlannedRun> {
    let mut runs = Vec::new();
    let n = duties.len();
    // A stride of about two fifths, without a common divisor, visits every duty and follows none of its trends.
    let stride = (1..=(2 * n / 5).max(1)).rev().find(|s| divisor(*s, n) == 1).unwrap_or(1);
    for trial in 0..trials {
        for k in 0..n {
            let duty = duties[(trial + k * stride) % n];
            let mut both = [Direction::Cw, Direction::Ccw];
            if (trial + k) % 2 == 1 {
                both.reverse();
            }
            for direction in both {
                runs.push(run(duty, direction, pwm_hz, seconds, 0.0, "first experiment"));
            }
        }
    }
    runs
}

fn divisor(a: usize, b: usize) -> usize {
    if b == 0 { a } else { divisor(b, a % b) }
}

/// The next runs, given what was measured and what was answered.
pub fn next_runs(measurements: &[Measurement], diagnosis: &Diagnosis) -> Vec<PlannedRun> {
    let runs: Vec<_> = measurements.iter().flat_map(|m| &m.runs).filter(|r| r.kind == RunKind::Speed).collect();
    let mut duties: Vec<f64> = runs.iter().filter_map(|r| r.duty).collect();
    duties.sort_by(f64::total_cmp);
    duties.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
    let pwm = runs.first().map_or(50.0, |r| r.pwm_hz);
    let longest = runs.iter().filter_map(|r| r.drive_on_s).fold(0.0, f64::max).clamp(2.0, 10.0);
    // As it was asked for: a board measures its own time to the microsecond.
    let seconds = (longest * 100.0).round() / 100.0;
    let has = |d: Direction| runs.iter().any(|r| r.direction == Some(d));
    let mut plan = Vec::new();
    if duties.len() < 3 {
        for duty in [0.25, 0.5, 0.75, 1.0] {
            if !duties.iter().any(|d| (d - duty).abs() < 0.03) {
                for direction in [Direction::Cw, Direction::Ccw] {
                    plan.push(run(duty, direction, pwm, seconds, 0.0, "effects over duty need three duties"));
                }
            }
        }
    }
    let missing = [Direction::Cw, Direction::Ccw].into_iter().find(|d| !has(*d));
    if let Some(direction) = missing
        && duties.len() >= 3
    {
        for duty in [duties[0], duties[duties.len() / 2], duties[duties.len() - 1]] {
            plan.push(run(duty, direction, pwm, seconds, 0.0, "an asymmetry needs both directions"));
        }
    }
    if !diagnosis.replicated {
        let duty = duties.last().copied().unwrap_or(1.0);
        for _ in 0..3 {
            plan.push(run(
                duty,
                Direction::Cw,
                pwm,
                seconds,
                0.0,
                "repetition: without it nothing is known of run-to-run spread",
            ));
        }
    }
    let open: Vec<&str> =
        diagnosis.effects.iter().filter(|e| e.status == "ambiguous").map(|e| e.name.as_str()).collect();
    let any = |names: &[&str]| open.iter().any(|o| names.contains(o));
    if any(&["dead-zone", "start-delay", "stribeck-friction", "high-duty-saturation"]) {
        for duty in [0.3, 0.6] {
            for direction in [Direction::Cw, Direction::Ccw] {
                let why = "a delay loses pwm_hz·t_d of duty, a dead zone the same duty at every pwm_hz";
                plan.push(run(duty, direction, 2.0 * pwm, seconds, 0.0, why));
            }
        }
        plan.push(run(1.0, Direction::Cw, pwm, seconds, 0.0, "at full duty there is no PWM rise to be late for"));
    }
    if any(&["resonance-heating", "run-in-wear", "supply-sag"]) {
        let why = "after a long pause warmth is gone, wear stays, a sag comes back at once";
        plan.push(run(1.0, Direction::Cw, pwm, 10.0, 0.0, why));
        plan.push(run(1.0, Direction::Cw, pwm, 10.0, 120.0, why));
    }
    if any(&["frequency-settling"]) {
        for pause in [1.0, 1.0, 30.0] {
            plan.push(run(
                1.0,
                Direction::Cw,
                pwm,
                0.3,
                pause,
                "settling repeats at every start, warmth depends on the pause",
            ));
        }
    }
    if any(&["preload-runout", "encoder-eccentricity"]) {
        let why =
            "RE-SEAT THE ROTOR BY 90° AGAINST THE ENCODER WHEEL FIRST: runout turns with the rotor, eccentricity stays";
        plan.push(run(1.0, Direction::Cw, pwm, seconds, 0.0, why));
        plan.push(run(0.5, Direction::Cw, pwm, seconds, 0.0, why));
    }
    plan
}

fn run(duty: f64, direction: Direction, pwm_hz: f64, seconds: f64, pause_s: f64, why: &str) -> PlannedRun {
    PlannedRun {
        duty,
        direction: if direction.sign() > 0.0 { "cw" } else { "ccw" },
        pwm_hz,
        seconds,
        pause_s,
        why: why.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if a duty is forgotten or the order rises steadily, which would let warmth pose as duty.
    #[test]
    fn first_experiment_visits_every_duty_out_of_order() {
        let duties: Vec<f64> = (1..=11).map(|k| f64::from(k) / 11.0).collect();
        let plan = first_experiment(&duties, 2, 5.0, 50.0);
        assert_eq!(plan.len(), 44);
        for duty in &duties {
            assert_eq!(plan.iter().filter(|r| r.duty == *duty).count(), 4);
        }
        let rising = plan.windows(2).filter(|w| w[1].duty > w[0].duty).count();
        let falling = plan.windows(2).filter(|w| w[1].duty < w[0].duty).count();
        assert!(rising > 4 && falling > 4, "{rising} rises, {falling} falls");
    }
}
