//! The runs a motor is identified from: short, both ways, and of pulses of two lengths.

use twum_record::series::SeriesRun;

/// Duty and PWM frequency (Hz) of each run. What a rotor runs on after each pulse, and what a dead zone takes of each, show in the
/// speed at small duties alike; at twice the pulses in a second the one counts twice and the other once.
const RUNS: [(f64, f64); 4] = [(1.0, 50.0), (0.5, 50.0), (0.25, 50.0), (0.5, 100.0)];

/// Length of each run, s: a turn and more of a motor of 35 rpm once it has run up, so that what varies round the rotor is met whole.
pub const SECONDS: f64 = 2.5;

/// Every run both ways, one after the other, so that the rotor comes back.
pub fn plan() -> Vec<SeriesRun> {
    let both = RUNS.into_iter().flat_map(|(duty, pwm_hz)| [(duty, pwm_hz, "cw"), (duty, pwm_hz, "ccw")]);
    both.enumerate()
        .map(|(number, (duty, pwm_hz, direction))| SeriesRun {
            id: format!("{number:02}-d{:03.0}-{direction}-{pwm_hz:.0}hz", 100.0 * duty),
            duty,
            direction: direction.to_owned(),
            pwm_hz,
            seconds: SECONDS,
            pause_s: 0.2,
            why: "what a controller has to know of the motor".to_owned(),
        })
        .collect()
}
