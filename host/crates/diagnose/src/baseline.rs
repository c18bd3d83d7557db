//! The motor's own parameters: free in every model, refitted from several starts.

use super::free::Free;
use super::library::LogNormal;
use super::prior::Prior;
use super::problem::{Model, Problem};
use super::refit::{Covariance, objective, refit, squared_error};
use super::rotor::{P, Parameters};
use rayon::prelude::*;
use twum_fit::noise::Noise;

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
/// The widest band of all, in which the torque falls over all of the wave's speed.
const WIDEST_BAND: f64 = 1.0;
/// Crystals of two boards differ by some ten parts in a million: no cause, but seen in long runs.
const CLOCK: f64 = 5e-5;
/// Delay of a record behind the drive: a sample or two of a millisecond.
const LATENCY_S: f64 = 2e-3;
/// Pitches by which a comparator behind the wheel hangs back: little where its signal is clean, no whole one, or it would not switch.
pub const HYSTERESIS: LogNormal = LogNormal { median: 0.05, log_sd: 1.0 };
/// Time in s in which another motor's wave builds up and dies away: from a tenth of a millisecond to some, by the quality of its resonance.
const OTHER_WAVE_S: LogNormal = LogNormal { median: 7e-4, log_sd: 1.0 };
/// A wave dies as it builds up: both are set by the stator's own damping. The contact changes that by a third.
pub const DYING: LogNormal = LogNormal { median: 1.0, log_sd: 0.3 };
/// Share of its height at which a wave carries half of the contact of a rotor that is pressed on it: a tenth or so, pressed harder more.
pub const LIFT: LogNormal = LogNormal { median: 0.1, log_sd: 0.5 };
/// Share of the drive's torque with which the wave holds back a rotor that is ahead of its crest: all of it by the textbook, less where the
/// contact is open for part of a wave.
pub const AHEAD: LogNormal = LogNormal { median: 0.7, log_sd: 1.0 };

/// How far beside its resonance a stator is driven, in half-widths: the speed is set and held there, and it is gone a few half-widths away.
pub const DETUNING: LogNormal = LogNormal { median: 0.4, log_sd: 0.7 };

/// The motor's own parameters that are fitted, as they are believed to be of the motor file's motor or of another, whichever these are likelier
/// of; `home` are the motor file's, `closed` says that the runs are of closed loops.
pub fn baseline_free(model: &Parameters, home: &Parameters, closed: bool) -> Vec<Free> {
    let [listed, other] = [false, true].map(|other| own_parameters(model, home, closed, other));
    let height = |free: &[Free]| free.iter().map(|f| f.prior.log_height(model.get(f.parameter))).sum::<f64>();
    if SAME_MOTOR.ln() + height(&listed) >= (1.0 - SAME_MOTOR).ln() + height(&other) { listed } else { other }
}

/// What is free in the motor file's motor, or in any `other` of the kind: a motor is another one in all that the file says of it.
fn own_parameters(model: &Parameters, home: &Parameters, closed: bool, other: bool) -> Vec<Free> {
    let positive = |parameter: P, bounds: (f64, f64), belief: LogNormal| Free {
        parameter,
        scale: model.get(parameter).max(bounds.0),
        bounds,
        prior: Prior::LogNormal { median: belief.median, log_sd: belief.log_sd },
    };
    let either = |listed: f64, log_sd: f64, another: LogNormal| {
        if other { another } else { LogNormal { median: listed, log_sd } }
    };
    let rate = |parameter: P, another: LogNormal| {
        let listed = if home.get(parameter) > 0.0 { home.get(parameter) } else { home.get(P::OnAcceleration) };
        let another = LogNormal { median: another.median * listed, ..another };
        positive(parameter, (1e-5 * listed, 50.0 * listed), either(listed, SAME_MOTOR_LOG_SD, another))
    };
    let near =
        |parameter: P, listed: f64, belief: LogNormal| positive(parameter, (0.02 * listed, 50.0 * listed), belief);
    let off = if closed && home.get(P::OffDeceleration) > 0.0 {
        // That the motor brakes less than its file says is a finding there.
        let like = home.get(P::OffDeceleration) / home.get(P::OnAcceleration).max(1e-9);
        let median = (like * model.get(P::OnAcceleration)).max(1.0);
        near(P::OffDeceleration, median, LogNormal { median, log_sd: SAME_MOTOR_LOG_SD })
    } else {
        rate(P::OffDeceleration, OTHER_BRAKE)
    };
    let viscous = home.get(P::Viscous).max(0.05);
    let band = home.get(P::SlipBand).max(1e-3);
    // What is too soft to be a motor's own is an effect where that can be judged.
    let widest = if closed { WIDEST_BAND } else { widest_own_band(home) };
    let wave_s = if home.get(P::WaveTime) > 0.0 { home.get(P::WaveTime) } else { OTHER_WAVE_S.median };
    let speed = model.get(P::FreeSpeed);
    let normal = |parameter: P, sd: f64, most: f64| Free {
        parameter,
        scale: sd,
        bounds: (home.get(parameter) - most * sd, home.get(parameter) + most * sd),
        prior: Prior::Normal { centre: home.get(parameter), sd },
    };
    vec![
        Free { parameter: P::FreeSpeed, scale: speed, bounds: (0.02 * speed, 50.0 * speed), prior: Prior::Flat },
        rate(P::OnAcceleration, OTHER_MOTOR),
        off,
        near(P::Viscous, viscous, LogNormal { median: viscous, ..HARDLY_SEEN }),
        positive(P::SlipBand, (1e-3, widest), either(band, HARDLY_SEEN.log_sd, OTHER_BAND)),
        normal(P::ClockError, CLOCK, 20.0),
        normal(P::Latency, LATENCY_S, 5.0),
        positive(P::Hysteresis, (1e-3, 1.0), HYSTERESIS),
        positive(P::WaveTime, (0.02 * wave_s, 100.0 * wave_s), either(wave_s, SAME_MOTOR_LOG_SD, OTHER_WAVE_S)),
        positive(P::Dying, (0.02, 50.0), DYING),
        positive(P::Lift, (0.01, 0.3), LIFT),
        positive(P::Ahead, (0.01, 5.0), AHEAD),
        positive(P::Detuning, (0.02, 2.0), DETUNING),
    ]
}

/// The widest slip band that may be the motor's own, two deviations from the file's or from another motor's: a wider one is
/// `contact-stiffening`.
fn widest_own_band(home: &Parameters) -> f64 {
    let [listed, other] = [home.get(P::SlipBand), OTHER_BAND.median];
    f64::max(listed * (2.0 * HARDLY_SEEN.log_sd).exp(), other * (2.0 * OTHER_BAND.log_sd).exp())
}

/// The motor's own parameters, and a contact as soft as may be: which is too soft to be its own is asked later, with all effects.
fn with_any_contact(model: &Parameters, home: &Parameters) -> Vec<Free> {
    let mut free = baseline_free(model, home, false);
    for own in free.iter_mut().filter(|f| f.parameter == P::SlipBand) {
        own.bounds.1 = WIDEST_BAND;
    }
    free
}

/// The same of a stator that is driven at its resonance, as a model without `P::Detuning` is.
fn at_resonance(model: &Model, home: &Parameters) -> Vec<Free> {
    let mut free = with_any_contact(&model.parameters, home);
    free.retain(|f| f.parameter != P::Detuning);
    free
}

/// Squared error and what is known beforehand, in rpm²·s.
fn misfit(problem: &Problem, model: &Model, free: &[Free], covariance: &Covariance) -> f64 {
    let prior: f64 = free.iter().map(|f| f.prior.log_density(model.parameters.get(f.parameter))).sum();
    objective(problem, model, covariance) - 2.0 * covariance.variance * prior
}

/// Covariance of a first look: nothing is known yet but the size of the residuals.
pub fn first_covariance(problem: &Problem, model: &Model, independent: f64) -> Covariance {
    let square = squared_error(problem, model);
    let variance = (square / independent).max(1e-9);
    Covariance::by_chance(problem.runs.len(), Noise { variance, gain_spread: GAIN_SPREAD })
}

/// Spread of the gains of runs before anything is known of it: about a per cent, and what effects over the runs do besides.
const GAIN_SPREAD: f64 = 0.015;

/// Times in s in which a rotor of the kind starts, in which it stops without a wave (a clamped one as fast as it starts, one that coasts
/// within seconds), and in which its wave builds up.
const STARTS_S: [f64; 4] = [2e-4, 1e-3, 4e-3, 1.5e-2];
const STOPS_S: [f64; 4] = [3e-4, 3e-3, 3e-2, 1.0];
const WAVES_S: [f64; 2] = [2.5e-4, 1.5e-3];

/// Heats in which the starts are refitted to a few of the runs: how many of the best go on, and for how many steps. How well an unfitted rotor
/// does says little of what it may become, so that every one has a step or two. The last heat is of all runs.
const HEATS: [(usize, usize); 2] = [(usize::MAX, 2), (12, 6)];
const FINAL: (usize, usize) = (4, 20);
/// How far beside its resonance the best of these then begins: hardly, or on either side of what is likely. Which rotor it is does not show in a
/// wave that may be any: looked for together, of E pair 411 another rotor was found, 63 nats behind.
const DETUNINGS: [f64; 3] = [0.05, 0.3, 0.9];

/// The baseline's own parameters, refitted from several starts: a rotor that is clamped, one that coasts, one that starts slowly, one that
/// brakes in between, and one whose wave is slow lie in valleys of their own.
pub fn refit_baseline(problem: &Problem, home: &Parameters, independent: f64) -> Model {
    let few = problem.thinned();
    let sorted = |problem: &Problem, independent: f64, models: Vec<Model>| -> (Vec<Model>, Covariance) {
        let covariance = models
            .par_iter()
            .map(|m| first_covariance(problem, m, independent))
            .min_by(|a, b| a.variance.total_cmp(&b.variance))
            .unwrap_or_else(|| first_covariance(problem, &problem.model(home.clone()), independent));
        let value = |m: &Model| misfit(problem, m, &at_resonance(m, home), &covariance);
        let mut valued: Vec<(f64, Model)> = models.into_par_iter().map(|m| (value(&m), m)).collect();
        valued.sort_by(|a, b| a.0.total_cmp(&b.0));
        let models = valued.into_iter().map(|v| v.1).collect();
        (models, covariance)
    };
    let heat = |problem: &Problem,
                (models, covariance): (Vec<Model>, Covariance),
                (count, steps): (usize, usize)|
     -> Vec<Model> {
        let fit = |m: Model| {
            let free = at_resonance(&m, home);
            refit(problem, m, &free, &[], &covariance, steps)
        };
        models.into_par_iter().take(count).map(fit).collect()
    };
    let independent_of_few = independent * (few.windows() / problem.windows().max(1.0)).min(1.0);
    let mut models = valleys(&few, home, &few.model(home.clone()));
    for size in HEATS {
        models = heat(&few, sorted(&few, independent_of_few, models), size);
    }
    let whole = models.into_iter().map(|m| problem.model(m.parameters)).collect();
    let finished = heat(problem, sorted(problem, independent, whole), FINAL);
    let (best, covariance) = sorted(problem, independent, finished);
    let best = best.into_iter().next().unwrap_or_else(|| problem.model(home.clone()));
    let driven_beside = |detuning: f64| {
        let start = Model { parameters: best.parameters.with(P::Detuning, detuning), terms: best.terms.clone() };
        let free = with_any_contact(&start.parameters, home);
        refit(problem, start, &free, &[], &covariance, FINAL.1)
    };
    let beside: Vec<Model> = DETUNINGS.into_par_iter().map(driven_beside).collect();
    let value = |m: &Model| misfit(problem, m, &with_any_contact(&m.parameters, home), &covariance);
    beside.into_iter().min_by(|a, b| value(a).total_cmp(&value(b))).unwrap_or(best)
}

/// A model with its own rotor, with the motor file's, and with those of rotors of each kind: clamped or coasting, quick or slow, under a quick
/// wave or a slow one.
pub fn valleys(problem: &Problem, home: &Parameters, model: &Model) -> Vec<Model> {
    let speed = home.get(P::FreeSpeed);
    let own = &model.parameters;
    let mut rotors = vec![own.clone(), as_listed(own, home)];
    for on_s in STARTS_S {
        for off_s in STOPS_S {
            for wave_s in WAVES_S {
                let rotor = as_listed(own, home).with(P::OnAcceleration, speed / on_s);
                rotors.push(rotor.with(P::OffDeceleration, speed / off_s).with(P::WaveTime, wave_s));
            }
        }
    }
    rotors
        .into_par_iter()
        .map(|parameters| at_speed(problem, Model { parameters, terms: model.terms.clone() }))
        .collect()
}

/// Parameters with the motor file's rotor.
pub fn as_listed(own: &Parameters, home: &Parameters) -> Parameters {
    let listed =
        [P::OnAcceleration, P::OffDeceleration, P::Viscous, P::SlipBand, P::WaveTime, P::Dying, P::Lift, P::Ahead];
    listed.into_iter().fold(own.clone(), |rotor, p| rotor.with(p, home.get(p)))
}

/// The model with the free speed that the runs have on average.
pub fn at_speed(problem: &Problem, mut model: Model) -> Model {
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

    fn belief(model: &Parameters, home: &Parameters, parameter: P) -> Prior {
        let free = baseline_free(model, home, false);
        free.into_iter().find(|f| f.parameter == parameter).expect("it is free").prior
    }

    /// Fails if a contact ten times as soft as the file's is as good as excluded: every such motor had `contact-stiffening` or nothing
    /// that anyone knows.
    #[test]
    fn another_motor_may_have_another_contact() {
        let home = Parameters::new(3.6, 1900.0, 1900.0, 0.3, 0.02).with(P::WaveTime, 2.3e-4);
        let prior = belief(&home.with(P::OnAcceleration, 300.0), &home, P::SlipBand);
        assert!(prior.log_density(0.2) > prior.log_density(0.02) - 4.0);
    }

    /// Fails if a motor that is the file's in its friction may have any wave: a late start would be a slow wave, in every motor.
    #[test]
    fn the_motor_of_the_file_is_it_in_all() {
        let home = as_listed(
            &Parameters::new(3.6, 1900.0, 1900.0, 0.3, 0.02),
            &Parameters::new(3.6, 1900.0, 1900.0, 0.3, 0.02),
        )
        .with(P::WaveTime, 2.3e-4)
        .with(P::Lift, LIFT.median);
        let cost = |model: &Parameters| belief(model, &home, P::WaveTime).log_density(3e-3);
        assert!(cost(&home) < cost(&home.with(P::OnAcceleration, 300.0)) - 3.0);
    }
}
