//! The motor's own parameters: free in every model, refitted from several starts.

use super::library::LogNormal;
use super::prior::Prior;
use super::problem::{Model, Problem};
use super::refit::{Free, Noise, objective, refit};
use super::rotor::{P, Parameters};

/// The motor file is right: friction is measured to a third, and varies so much from day to day.
pub const SAME_MOTOR_LOG_SD: f64 = 0.3;
/// Or these runs are of another motor of the kind, whose friction is a tenth of the file's, or ten times it, at 1.5 deviations.
const OTHER_MOTOR: LogNormal = LogNormal { median: 1.0, log_sd: 1.5 };
/// Without a wave, another motor may be clamped like the file's, coast, or anything between: five decades at two deviations.
const OTHER_BRAKE: LogNormal = LogNormal { median: 0.1, log_sd: 2.5 };
/// Neither is likelier before the data.
const SAME_MOTOR: f64 = 0.5;
/// Damping hardly shows in open loop, nor does the softness of a contact like the file's.
const HARDLY_SEEN: LogNormal = LogNormal { median: 1.0, log_sd: 0.7 };
/// The slip over the wave's speed within which another motor's contact gives way: from a thousandth, a hard one, to a fifth.
const OTHER_BAND: LogNormal = LogNormal { median: 0.02, log_sd: 1.2 };
/// Crystals of two boards differ by some ten parts in a million: no cause, but seen in long runs.
const CLOCK: f64 = 5e-5;
/// Delay of a record behind the drive: a sample or two of a millisecond.
const LATENCY_S: f64 = 2e-3;
/// Where the fit of the dying wave's braking starts: twice the build-up time of the 30 mm motor's stator (2·Ms/Cs; thesis,
/// A.4), in s.
const RING_DOWN_S: f64 = 4.6e-4;

/// The motor's own parameters that are fitted; `home` are the motor file's, `closed` says that the runs are of closed loops.
pub fn baseline_free(model: &Parameters, home: &Parameters, closed: bool) -> Vec<Free> {
    let speed = model.get(P::FreeSpeed);
    let rate = |parameter: P, other: LogNormal| {
        let listed = if home.get(parameter) > 0.0 { home.get(parameter) } else { home.get(P::OnAcceleration) };
        Free {
            parameter,
            scale: model.get(parameter).max(1e-4 * listed),
            bounds: (1e-5 * listed, 50.0 * listed),
            prior: Prior::Either {
                medians: [listed, other.median * listed],
                log_sds: [SAME_MOTOR_LOG_SD, other.log_sd],
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
    let off = if closed && home.get(P::OffDeceleration) > 0.0 {
        // That the motor brakes less than its file says is a finding there.
        let like = home.get(P::OffDeceleration) / home.get(P::OnAcceleration).max(1e-9);
        near(P::OffDeceleration, (like * model.get(P::OnAcceleration)).max(1.0), SAME_MOTOR_LOG_SD)
    } else {
        rate(P::OffDeceleration, OTHER_BRAKE)
    };
    let mut all = vec![
        Free { parameter: P::FreeSpeed, scale: speed, bounds: (0.02 * speed, 50.0 * speed), prior: Prior::Flat },
        rate(P::OnAcceleration, OTHER_MOTOR),
        off,
        near(P::Viscous, home.get(P::Viscous).max(0.05), HARDLY_SEEN.log_sd),
        contact(home.get(P::SlipBand).max(1e-3), model.get(P::SlipBand).max(1e-3)),
        Free {
            parameter: P::ClockError,
            scale: CLOCK,
            bounds: (-20.0 * CLOCK, 20.0 * CLOCK),
            prior: Prior::Normal { centre: 0.0, sd: CLOCK },
        },
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

/// How softly the contact takes up the slip: as in the motor file (`listed`), or as in another motor.
fn contact(listed: f64, scale: f64) -> Free {
    Free {
        parameter: P::SlipBand,
        scale,
        bounds: (1e-3, 1.0),
        prior: Prior::Either {
            medians: [listed, OTHER_BAND.median],
            log_sds: [HARDLY_SEEN.log_sd, OTHER_BAND.log_sd],
            first: SAME_MOTOR,
        },
    }
}

/// Noise of a first look: nothing is known yet but the size of the residuals.
pub fn first_noise(problem: &Problem, model: &Model, independent: f64) -> Noise {
    let square = objective(problem, model, Noise { variance: 1.0, gain_spread: 0.0 });
    Noise { variance: (square / independent).max(1e-9), gain_spread: GAIN_SPREAD }
}

/// Spread of the gains of runs before anything is known of it: about a per cent, and what effects over the runs do besides.
const GAIN_SPREAD: f64 = 0.015;

/// Times in s in which a rotor of the kind starts, and in which it stops without a wave: a clamped one as fast as it starts, one that
/// coasts within seconds.
const STARTS_S: [f64; 3] = [2e-4, 1e-3, 5e-3];
const STOPS_S: [f64; 5] = [2e-4, 1e-3, 5e-3, 5e-2, 1.0];
/// Starts of equal rates that are refitted for a few steps, how many in all, and of these to the end.
const OF_A_KIND: usize = 2;
/// Natural logarithm within which rates are equal: the next of [`STARTS_S`] is five times as slow.
const ALIKE_LOG: f64 = 0.2;
const LOOKED_AT: usize = 8;
const FINISHED: usize = 2;

/// The baseline's own parameters, refitted from several starts: a rotor that is clamped, one that coasts, one that starts slowly
/// and one that brakes in between lie in valleys of their own.
pub fn refit_baseline(problem: &Problem, home: &Parameters, independent: f64) -> Model {
    let value = |model: &Model, noise: Noise| {
        let free = baseline_free(&model.parameters, home, false);
        let prior: f64 = free.iter().map(|f| f.prior.log_density(model.parameters.get(f.parameter))).sum();
        objective(problem, model, noise) - 2.0 * noise.variance * prior
    };
    let sorted = |mut models: Vec<Model>| -> (Vec<Model>, Noise) {
        let noise = models
            .iter()
            .map(|m| first_noise(problem, m, independent))
            .min_by(|a, b| a.variance.total_cmp(&b.variance))
            .unwrap_or(Noise { variance: 1.0, gain_spread: GAIN_SPREAD });
        models.sort_by(|a, b| value(a, noise).total_cmp(&value(b, noise)));
        (models, noise)
    };
    let (looked, noise) = sorted(valleys(problem, home, &problem.model(home.clone())));
    let refitted = |models: Vec<Model>, noise: Noise, count: usize, steps: usize| -> Vec<Model> {
        let fit = |m: Model| {
            let free = baseline_free(&m.parameters, home, false);
            refit(problem, m, &free, &[], noise, steps)
        };
        models.into_iter().take(count).map(fit).collect()
    };
    let looked = of_every_kind(looked);
    let (near, noise) = sorted(refitted(looked, noise, LOOKED_AT, 4));
    let (best, _) = sorted(refitted(near, noise, FINISHED, 12));
    best.into_iter().next().unwrap_or_else(|| problem.model(home.clone()))
}

/// The best of the models that start equally fast, [`OF_A_KIND`] of each: how well an unfitted rotor does says little of what it may become.
fn of_every_kind(models: Vec<Model>) -> Vec<Model> {
    let mut kept: Vec<Model> = Vec::new();
    for m in models {
        let rate = |m: &Model| m.parameters.get(P::OnAcceleration);
        let alike = kept.iter().filter(|k| (rate(k) / rate(&m)).ln().abs() < ALIKE_LOG).count();
        if alike < OF_A_KIND {
            kept.push(m);
        }
    }
    kept
}

/// A model with its own rates, with the motor file's, and with those of rotors of each kind: clamped or coasting, quick or slow.
pub fn valleys(problem: &Problem, home: &Parameters, model: &Model) -> Vec<Model> {
    let speed = home.get(P::FreeSpeed);
    let with = |on: f64, off: f64| model.parameters.with(P::OnAcceleration, on).with(P::OffDeceleration, off);
    let mut rotors = vec![
        model.parameters.clone(),
        with(home.get(P::OnAcceleration), home.get(P::OffDeceleration)).with(P::RingDown, home.get(P::RingDown)),
    ];
    for on_s in STARTS_S {
        for off_s in STOPS_S {
            let rotor = with(speed / on_s, speed / off_s);
            // A contact that lets go at once, and one that the dying wave still brakes.
            rotors.push(rotor.with(P::RingDown, 0.0));
            if off_s >= 5e-3 {
                rotors.push(rotor.with(P::RingDown, RING_DOWN_S));
            }
        }
    }
    rotors.into_iter().map(|parameters| at_speed(problem, Model { parameters, terms: model.terms.clone() })).collect()
}

/// The model with the free speed that the runs have on average.
fn at_speed(problem: &Problem, mut model: Model) -> Model {
    for _ in 0..2 {
        let (mut gg, mut gy) = (0.0, 0.0);
        for (run, r) in problem.runs.iter().zip(problem.residuals(&model)) {
            for (k, w) in run.windows.iter().enumerate() {
                gg += r.predicted[k] * r.predicted[k] * run.duration(w);
                gy += r.predicted[k] * r.rpm[k] * run.duration(w);
            }
        }
        let factor = (1.0 + gy / f64::max(gg, 1e-12)).clamp(0.2, 5.0);
        model.parameters.set(P::FreeSpeed, factor * model.parameters.get(P::FreeSpeed));
    }
    model
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if a contact ten times as soft as the file's is as good as excluded: every such motor had `contact-stiffening` or nothing
    /// that anyone knows.
    #[test]
    fn another_motor_may_have_another_contact() {
        let prior = contact(0.02, 0.02).prior;
        assert!(prior.log_density(0.2) > prior.log_density(0.02) - 4.0);
    }
}
