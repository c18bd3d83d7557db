//! What a run says: its steady speed, and how far behind a start without a run-up it is.

use std::f64::consts::TAU;
use twum_record::measurement::{Direction, Run, RunData, RunKind};

/// From here a motor counts as run up (s): the thesis's motor takes some 50 ms.
pub const RUN_UP_S: f64 = 0.5;

/// A run's steady speed and lag.
#[derive(Debug, Clone, PartialEq)]
pub struct Observed {
    /// Run.
    pub id: String,
    /// Fraction of the PWM period with the drive on.
    pub duty: f64,
    /// +1 clockwise, -1 counter-clockwise.
    pub sign: f64,
    /// Load against the motion (N·m).
    pub load_nm: f64,
    /// PWM frequency (Hz).
    pub pwm_hz: f64,
    /// Time from the start of a PWM period to the start of the run (s).
    pub pwm_phase_s: f64,
    /// Steady speed, without sign (rpm).
    pub rpm: f64,
    /// Its standard deviation (rpm).
    pub sigma_rpm: f64,
    /// Lag and its standard deviation (s).
    pub lag: Option<(f64, f64)>,
}

/// Speed and lag of a run, from its window after the run-up.
pub fn observe(run: &Run, edges_per_rev: u32) -> Option<Observed> {
    if run.kind != RunKind::Speed {
        return None;
    }
    let (duty, sense) = (run.duty?, run.direction?);
    let (start, end) = run.span_us();
    let end_s = run.drive_on_s.unwrap_or(f64::INFINITY).min(end * 1e-6);
    let begin_s = RUN_UP_S.max(start * 1e-6);
    if end_s - begin_s < 0.3 {
        return None;
    }
    let pitch = TAU / f64::from(edges_per_rev);
    let edge_times: Vec<f64> = match &run.data {
        RunData::Edges { edges, .. } => edges.iter().map(|e| e.time_us * 1e-6).collect(),
        RunData::Levels { start_us, period_us, levels } => levels
            .windows(2)
            .enumerate()
            .filter(|(_, w)| w[0] != w[1])
            // The edge lies between two samples.
            .map(|(i, _)| (start_us + (i as f64 + 0.5) * period_us) * 1e-6)
            .collect(),
        RunData::Velocity { time_us, rpm } => {
            return Some(from_velocity(run, duty, sense, time_us, rpm, begin_s, end_s));
        }
        _ => return None,
    };
    let inside: Vec<usize> = (0..edge_times.len()).filter(|&i| (begin_s..end_s).contains(&edge_times[i])).collect();
    let observed = |rpm: f64, sigma_rpm: f64, lag| Observed {
        id: run.id.clone(),
        duty,
        sign: sense.sign(),
        load_nm: 0.0,
        pwm_hz: run.pwm_hz,
        pwm_phase_s: run.pwm_phase_s,
        rpm,
        sigma_rpm,
        lag,
    };
    let (Some(&first), Some(&last)) = (inside.first(), inside.last()) else {
        return Some(observed(0.0, 60.0 / TAU * pitch / (end_s - begin_s), None));
    };
    let Some((speed, intercept)) = line(&edge_times, first, last, pitch) else {
        return Some(observed(0.0, 60.0 / TAU * pitch / (end_s - begin_s), None));
    };
    let resolution = match &run.data {
        RunData::Levels { period_us, .. } => period_us * 1e-6 / 12f64.sqrt(),
        _ => 1e-5,
    };
    // Aligned, the encoder stands at the beginning of a pulse and the first edge comes a pitch later; otherwise anywhere
    // within one.
    let (ahead, phase) = if run.aligned { (1.0, 0.0) } else { (0.5, 1.0 / 12f64.sqrt()) };
    let lag = intercept - ahead * pitch / speed;
    let sigma_lag = (phase * pitch / speed).hypot(resolution).max(5e-4);
    let span = edge_times[last] - edge_times[first];
    let starts = start <= 0.0;
    Some(observed(
        speed * 60.0 / TAU,
        speed * 60.0 / TAU * resolution * 2f64.sqrt() / span,
        starts.then_some((lag, sigma_lag)),
    ))
}

/// Straight line of time over angle through the edges `first..=last`: the speed (rad/s) and the time at which edge 0 would
/// have come at that speed (s). All edges take part, so that PWM ripple and uneven edges average out.
pub(super) fn line(edge_times: &[f64], first: usize, last: usize, pitch: f64) -> Option<(f64, f64)> {
    let n = (last + 1).saturating_sub(first) as f64;
    if n < 4.0 {
        return None;
    }
    let (mk, mt) = ((first + last) as f64 / 2.0, edge_times[first..=last].iter().sum::<f64>() / n);
    let (mut skk, mut skt) = (0.0, 0.0);
    for (i, t) in edge_times[first..=last].iter().enumerate() {
        let k = (first + i) as f64 - mk;
        skk += k * k;
        skt += k * (t - mt);
    }
    let second_an_edge = skt / skk;
    (second_an_edge > 0.0).then(|| (pitch / second_an_edge, mt - mk * second_an_edge))
}

fn from_velocity(
    run: &Run,
    duty: f64,
    sense: Direction,
    time_us: &[f64],
    rpm: &[f64],
    begin_s: f64,
    end_s: f64,
) -> Observed {
    let window: Vec<f64> = time_us
        .iter()
        .zip(rpm)
        .filter(|(t, v)| (begin_s..end_s).contains(&(*t * 1e-6)) && v.is_finite())
        .map(|(_, v)| v.abs())
        .collect();
    let n = window.len().max(1) as f64;
    let mean = window.iter().sum::<f64>() / n;
    let spread = (window.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    // A smoothed velocity's samples are not independent: some fifty milliseconds are one.
    let independent = ((end_s - begin_s) / 0.05).max(1.0);
    let lost: f64 = time_us
        .windows(2)
        .zip(rpm)
        .filter(|(t, v)| t[1] * 1e-6 < begin_s && v.is_finite())
        .map(|(t, v)| (1.0 - v.abs() / mean) * (t[1] - t[0]) * 1e-6)
        .sum();
    let starts = time_us.first().is_some_and(|t| *t < 20_000.0) && mean > 0.0;
    Observed {
        id: run.id.clone(),
        duty,
        sign: sense.sign(),
        load_nm: 0.0,
        pwm_hz: run.pwm_hz,
        pwm_phase_s: run.pwm_phase_s,
        rpm: mean,
        sigma_rpm: spread / independent.sqrt(),
        lag: starts.then_some((lost, 5e-3)),
    }
}

/// Runs of the same duty show how far a run repeats; where none do, 1 % is assumed.
pub fn scatter(observed: &mut [Observed]) {
    let mut sum = 0.0;
    let mut freedom = 0.0;
    for (i, o) in observed.iter().enumerate() {
        let same: Vec<f64> =
            observed.iter().filter(|p| p.duty == o.duty && p.sign == o.sign && o.rpm > 0.0).map(|p| p.rpm).collect();
        let first = observed.iter().position(|p| p.duty == o.duty && p.sign == o.sign) == Some(i);
        if first && same.len() > 1 {
            let mean = same.iter().sum::<f64>() / same.len() as f64;
            sum += same.iter().map(|v| (v / mean - 1.0).powi(2)).sum::<f64>();
            freedom += same.len() as f64 - 1.0;
        }
    }
    let relative = if freedom > 0.0 { (sum / freedom).sqrt() } else { 0.01 };
    for o in observed {
        o.sigma_rpm = o.sigma_rpm.hypot(relative * o.rpm).max(1e-3);
    }
}
