//! The recorder's clock against the drive's time.

use super::parameters::{P, Parameters};

/// The time of the drive in s at which something was recorded.
pub(super) fn driven_s(recorded_s: f64, p: &Parameters) -> f64 {
    let since_s = recorded_s - p.get(P::Latency);
    // t_recorded = (1 + ε + drift·grown)·t, solved to first order in the drift.
    since_s / (1.0 + p.get(P::ClockError) + p.get(P::ClockDrift) * grown_s(since_s, p.get(P::ClockTau)))
}

/// What a drift of one a second has made of the clock's error by `time_s`, on average since the start: half of that time, or
/// τ·(1 − τ·(1 − exp(−t/τ))/t) of one that dies away with `tau_s`.
fn grown_s(time_s: f64, tau_s: f64) -> f64 {
    if tau_s > 0.0 && time_s > 0.0 { tau_s + tau_s * tau_s / time_s * (-time_s / tau_s).exp_m1() } else { 0.5 * time_s }
}

#[cfg(test)]
mod tests {
    use super::*;
    use twum_motor::effects::EffectSet;
    use twum_motor::sensor::{Edge, record};

    /// Fails if the search's clock and the motor model's are two: in the error, in how a drift grows, or in how it dies away.
    #[test]
    fn the_clock_is_that_of_the_motor_model() {
        for (error, drift_per_s, tau_s) in [(0.02, 0.0, 0.0), (-0.01, 2e-3, 0.0), (0.01, -8e-3, 0.7), (0.0, 5e-3, 5.0)]
        {
            let mut effects = EffectSet::default();
            effects.set("clock-error", &[error, drift_per_s, tau_s]).expect("inside the bounds");
            let p = [(P::ClockError, error), (P::ClockDrift, drift_per_s), (P::ClockTau, tau_s)]
                .into_iter()
                .fold(Parameters::new(1.0, 1.0, 1.0, 0.0, 0.0), |p, (which, value)| p.with(which, value));
            for time_s in [0.1, 1.0, 4.0] {
                let mut edges = vec![Edge { time_s, level: true, sense: 1 }];
                record(&mut edges, 5.0, &effects);
                let driven_s = driven_s(edges[0].time_s, &p);
                assert!(
                    (driven_s - time_s).abs() < 2e-4 * time_s,
                    "{time_s} s with {error}, {drift_per_s}/s, {tau_s} s: {driven_s}"
                );
            }
        }
    }
}
