//! The baseline: the motor's own parameters, what is believed of them, and their refit.

use super::fit::{Free, objective, penalty, refit};
use super::problem::{Model, Problem, RPM};
use super::rotor::{P, Parameters};

/// How well a motor file is believed to know its friction: standard deviation of the logarithm of both rates. Friction of one motor
/// varies by a third from day to day, between motors by more; without any belief the rates run away to swallow what a dead zone
/// or a delay does to each pulse.
pub const RATE_LOG_SD: f64 = 0.3;

/// How much better a rotor that coasts must fit before it is believed of a motor whose friction is said to clamp it.
const COASTING_GAIN: f64 = 0.2;

/// Where the fit of the dying wave's braking starts: twice the build-up time of the 30 mm motor's stator (2·Ms/Cs; thesis,
/// A.4), in s.
const RING_DOWN_S: f64 = 4.6e-4;

/// The baseline's own parameters at `p`; `home` are the motor file's.
pub fn baseline_free(p: &Parameters, home: &Parameters, coasting: bool) -> Vec<Free> {
    let w = p.get(P::FreeSpeed);
    let a = p.get(P::OnAcceleration);
    let coasts = p.get(P::RingDown) > 0.0;
    let free = |parameter: P, scale: f64, bounds: (f64, f64)| Free { parameter, scale, bounds, prior: None };
    // A rotor that coasts is not the file's motor.
    let rate = |parameter: P, scale: f64, lowest: f64| {
        let listed = home.get(parameter);
        if coasts || listed <= 0.0 {
            return free(parameter, scale, (lowest, 20.0 * a));
        }
        Free { prior: Some((listed, RATE_LOG_SD)), ..free(parameter, scale, (0.02 * listed, 20.0 * listed)) }
    };
    // Damping hardly shows in open loop: it is left where the file has it, give or take a factor of two.
    let listed = home.get(P::Viscous);
    let viscous =
        Free { prior: (listed > 0.0).then_some((listed, 0.7)), ..free(P::Viscous, 1.0, (0.02 * listed, 50.0)) };
    let mut all = vec![
        free(P::FreeSpeed, w, (0.02 * w, 50.0 * w)),
        rate(P::OnAcceleration, a, 0.02 * a),
        viscous,
        free(P::Latency, 2e-3, (-5e-3, 1e-2)),
    ];
    if !coasting {
        all.insert(2, rate(P::OffDeceleration, a.max(p.get(P::OffDeceleration)), 0.0));
    }
    if coasts {
        all.push(free(P::RingDown, 5e-4, (1e-6, 5e-3)));
    }
    all
}

/// The baseline's own parameters, refitted from several starts: a rotor that is clamped, one that coasts and one that starts
/// slowly lie in valleys of their own.
pub fn refit_baseline(problem: &Problem, start: &Parameters, coasting: bool) -> Model {
    let mut starts = vec![start.clone(), start.with(P::OnAcceleration, 0.3 * start.get(P::OnAcceleration))];
    if !coasting {
        starts.push(start.with(P::OffDeceleration, 0.1 * start.get(P::OffDeceleration)));
    }
    let coasting_start = start.with(P::OffDeceleration, 0.0).with(P::RingDown, RING_DOWN_S);
    starts.push(coasting_start.clone());
    // A rotor that coasts is faster at part duty than the duty says: the start's free speed is read off the duty.
    let fastest = problem.runs.iter().map(|r| r.mean_speed_rpm().abs() / RPM).fold(0.0, f64::max);
    if fastest > 0.0 && fastest < 0.8 * start.get(P::FreeSpeed) {
        starts.push(coasting_start.with(P::FreeSpeed, fastest));
    }
    let fitted = |from: &Parameters, iterations: usize| {
        let free = baseline_free(from, start, coasting);
        let model = refit(problem, problem.model(from.clone()), &free, &[], iterations).0;
        let misfit = objective(problem, &model, 1.0, 0.0);
        let value = misfit + penalty(&free, &model, misfit / problem.runs.len() as f64);
        let doubt = if !coasting && coasts(&model) { 1.0 / (1.0 - COASTING_GAIN) } else { 1.0 };
        (doubt * value, model)
    };
    let best = starts.iter().map(|s| fitted(s, 4)).min_by(|a, b| a.0.total_cmp(&b.0));
    let near = best.map_or_else(|| start.clone(), |b| b.1.parameters);
    fitted(&near, 12).1
}

/// Whether the fitted rotor runs on with the drive off.
pub fn coasts(model: &Model) -> bool {
    model.parameters.get(P::RingDown) > 0.0 || model.parameters.get(P::OffDeceleration) <= 0.0
}

/// The same rotor with both friction rates multiplied.
pub fn rated(p: &Parameters, factor: f64) -> Parameters {
    [P::OnAcceleration, P::OffDeceleration].into_iter().fold(p.clone(), |q, rate| q.with(rate, factor * p.get(rate)))
}
