//! The motor's own parameters: free in every model, refitted from several starts.

use super::library::LogNormal;
use super::prior::Prior;
use super::problem::{Model, Problem};
use super::refit::{Free, Noise, objective, refit};
use super::rotor::{P, Parameters};

/// The motor file is right: friction is measured to a third, and varies so much from day to day.
pub const SAME_MOTOR_LOG_SD: f64 = 0.3;
/// Or these runs are of another motor of the kind, whose friction is a tenth of the file's, or ten times it, at 1.5 deviations.
const OTHER_MOTOR_LOG_SD: f64 = 1.5;
/// Neither is likelier before the data.
const SAME_MOTOR: f64 = 0.5;
/// Damping and the softness of the contact hardly show in open loop.
const HARDLY_SEEN: LogNormal = LogNormal { median: 1.0, log_sd: 0.7 };
/// Delay of a record behind the drive: a sample or two of a millisecond.
const LATENCY_S: f64 = 2e-3;
/// Where the fit of the dying wave's braking starts: twice the build-up time of the 30 mm motor's stator (2·Ms/Cs; thesis,
/// A.4), in s.
const RING_DOWN_S: f64 = 4.6e-4;

/// The motor's own parameters that are fitted; `home` are the motor file's.
pub fn baseline_free(model: &Parameters, home: &Parameters) -> Vec<Free> {
    let speed = model.get(P::FreeSpeed);
    let rate = |parameter: P| {
        let listed = if home.get(parameter) > 0.0 { home.get(parameter) } else { home.get(P::OnAcceleration) };
        Free {
            parameter,
            scale: model.get(parameter).max(0.02 * listed),
            bounds: (2e-3 * listed, 50.0 * listed),
            prior: Prior::Either {
                medians: [listed; 2],
                log_sds: [SAME_MOTOR_LOG_SD, OTHER_MOTOR_LOG_SD],
                first: SAME_MOTOR,
            },
        }
    };
    let near = |parameter: P, listed: f64, log_sd: f64| Free {
        parameter,
        scale: model.get(parameter).max(0.05 * listed),
        bounds: (0.02 * listed, 50.0 * listed),
        prior: Prior::log_normal(listed, log_sd),
    };
    let mut all = vec![
        Free { parameter: P::FreeSpeed, scale: speed, bounds: (0.02 * speed, 50.0 * speed), prior: Prior::Flat },
        rate(P::OnAcceleration),
        rate(P::OffDeceleration),
        near(P::Viscous, home.get(P::Viscous).max(0.05), HARDLY_SEEN.log_sd),
        near(P::SlipBand, home.get(P::SlipBand).max(1e-3), HARDLY_SEEN.log_sd),
        Free {
            parameter: P::Latency,
            scale: LATENCY_S,
            bounds: (-5.0 * LATENCY_S, 5.0 * LATENCY_S),
            prior: Prior::Normal { centre: 0.0, sd: LATENCY_S },
        },
    ];
    if home.get(P::WaveTime) > 0.0 {
        all.push(near(P::WaveTime, home.get(P::WaveTime), HARDLY_SEEN.log_sd));
    }
    if model.get(P::RingDown) > 0.0 {
        all.push(near(P::RingDown, RING_DOWN_S, HARDLY_SEEN.log_sd));
    }
    all
}

/// Noise of a first look: nothing is known yet but the size of the residuals.
pub fn first_noise(problem: &Problem, model: &Model, independent: f64) -> Noise {
    let square = objective(problem, model, Noise { variance: 1.0, gain_spread: 0.0 });
    Noise { variance: (square / independent).max(1e-9), gain_spread: GAIN_SPREAD }
}

/// Spread of the gains of runs before anything is known of it: about a per cent, and what effects over the runs do besides.
const GAIN_SPREAD: f64 = 0.015;

/// The baseline's own parameters, refitted from several starts: a rotor that is clamped, one that coasts, one that starts slowly
/// and one that brakes in between lie in valleys of their own.
pub fn refit_baseline(problem: &Problem, home: &Parameters, independent: f64) -> Model {
    let mut starts = Vec::new();
    for on in [0.2, 1.0, 4.0] {
        for off in [0.1, 1.0, 4.0] {
            let off = off * home.get(P::OffDeceleration).max(0.1 * home.get(P::OnAcceleration));
            starts.push(home.with(P::OnAcceleration, on * home.get(P::OnAcceleration)).with(P::OffDeceleration, off));
        }
    }
    let coasting = home.with(P::OffDeceleration, 0.01 * home.get(P::OnAcceleration)).with(P::RingDown, RING_DOWN_S);
    starts.push(coasting.clone());
    // A rotor that coasts is faster at part duty than the duty says: the start's free speed is read off the duty.
    let fastest = problem.runs.iter().map(|r| r.mean_speed_rpm().abs() / super::problem::RPM).fold(0.0, f64::max);
    if fastest > 0.0 && fastest < 0.8 * home.get(P::FreeSpeed) {
        starts.push(coasting.with(P::FreeSpeed, fastest));
    }
    let value = |model: &Model, noise: Noise| {
        let free = baseline_free(&model.parameters, home);
        let prior: f64 = free.iter().map(|f| f.prior.log_density(model.parameters.get(f.parameter))).sum();
        objective(problem, model, noise) - 2.0 * noise.variance * prior
    };
    let looked: Vec<Model> = starts
        .iter()
        .map(|start| {
            let model = problem.model(start.clone());
            let noise = first_noise(problem, &model, independent);
            refit(problem, model, &baseline_free(start, home), &[], noise, 2)
        })
        .collect();
    let best_of = |models: &[Model]| -> Option<(Model, Noise)> {
        let noise = models
            .iter()
            .map(|m| first_noise(problem, m, independent))
            .min_by(|a, b| a.variance.total_cmp(&b.variance))?;
        let best = models.iter().min_by(|a, b| value(a, noise).total_cmp(&value(b, noise)))?;
        Some((best.clone(), noise))
    };
    let Some((_, noise)) = best_of(&looked) else { return problem.model(home.clone()) };
    // The best three go on: a valley that looked worse at first may be the deeper one.
    let mut order: Vec<&Model> = looked.iter().collect();
    order.sort_by(|a, b| value(a, noise).total_cmp(&value(b, noise)));
    let finished: Vec<Model> = order
        .into_iter()
        .take(3)
        .map(|m| refit(problem, m.clone(), &baseline_free(&m.parameters, home), &[], noise, 8))
        .collect();
    best_of(&finished).map_or_else(|| problem.model(home.clone()), |b| b.0)
}
