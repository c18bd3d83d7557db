//! Numbers of an effect with their intervals: what the runs scatter, what is only believed, what forms leave open.

use super::discrepancy::switching;
use super::finding::Estimate;
use super::held_out::Scorer;
use super::library::{Effect, Phased};
use super::rhythm;
use super::rotor::P;
use super::set::{Part, Set};
use twum_fit::quantile::{NORMAL_95, student_95};

/// Share of a number by which the library's form of an effect, or what a term describes between two edges, and the real one may disagree on it.
pub(super) const FORM: f64 = 0.04;

/// Names of the amplitudes of a runout, by harmonic.
const RUNOUT: [&str; 4] = ["once_a_turn", "twice_a_turn", "three_times_a_turn", "four_times_a_turn"];
/// Names of the amplitudes of an eccentric wheel, by harmonic.
const ECCENTRICITY: [&str; 4] =
    ["eccentricity_rad", "eccentricity_twice_rad", "eccentricity_three_times_rad", "eccentricity_four_times_rad"];

/// Estimates of an effect of a set.
pub fn estimates(scorer: &Scorer, effect: &Effect, set: &Set, part: &Part) -> Vec<Estimate> {
    let mut out = common(scorer, effect, set, part);
    let pairs: Vec<(usize, Phased)> =
        set.parts.iter().flat_map(|p| p.phased.iter().map(|pair| (p.effect, *pair))).collect();
    if pairs.iter().any(|(of, _)| *of == part.effect) {
        let phased: Vec<Phased> = pairs.iter().map(|(_, pair)| *pair).collect();
        let sampled: Vec<f64> = rhythm::powers(scorer.ground, set, &phased).iter().map(|p| (2.0 * p).sqrt()).collect();
        let of_part = pairs.iter().enumerate().filter(|(_, (of, _))| *of == part.effect);
        out.extend(of_part.map(|(k, (_, pair))| amplitude(scorer, set, *pair, set.weighed.powers[k], sampled[k])));
    }
    out
}

fn common(scorer: &Scorer, effect: &Effect, set: &Set, part: &Part) -> Vec<Estimate> {
    if part.free.is_empty() {
        return Vec::new();
    }
    let (grams, free, _) = scorer.equations(set, &switching());
    let columns: Vec<usize> = (0..grams.columns()).collect();
    let (beta, covariance) = grams.fit_all(&columns);
    let first = free - set.parts.iter().map(|p| p.free.len()).sum::<usize>();
    let all = scorer.ground.free(&set.model, &set.parts);
    let before: usize = set.parts.iter().take_while(|p| p.effect != part.effect).map(|p| p.free.len()).sum();
    let quantile = student_95(scorer.keys.len().saturating_sub(1) as f64);
    let form = &effect.forms[part.form];
    effect
        .reported
        .iter()
        .filter_map(|reported| {
            let now = set.model.parameters.get(reported.parameter);
            let name = reported.name.to_string();
            let unit = reported.unit.to_string();
            if let Some(k) = part.free.iter().position(|f| f.parameter == reported.parameter) {
                let at = first + before + k;
                let f = &all[at];
                let value = (now + beta[at].clamp(-0.3, 0.3) * f.scale).clamp(f.bounds.0, f.bounds.1);
                let mut variance = covariance[(at, at)] * f.scale * f.scale;
                // What is a share of another number is as uncertain as both together (the delta method).
                let whole = reported.of.map_or(1.0, |p| set.model.parameters.get(p));
                if let Some(k) = all.iter().position(|other| Some(other.parameter) == reported.of) {
                    let per_whole = value / whole * all[k].scale;
                    variance += per_whole * (per_whole * covariance[(k, k)] + 2.0 * f.scale * covariance[(k, at)]);
                }
                let half = (quantile * variance.max(0.0).sqrt()).hypot(NORMAL_95 * FORM * value);
                let interval = [(value - half).max(f.bounds.0.min(0.0)), (value + half).min(f.bounds.1)];
                return Some(Estimate { name, value: value * whole, interval: interval.map(|end| end * whole), unit });
            }
            // A shape that the form states.
            let stated = form.shapes.iter().find(|s| s.parameter == reported.parameter)?;
            Some(Estimate { name, value: stated.start, interval: [stated.start; 2], unit })
        })
        .collect()
}

/// The amplitude that all runs share; its spread by leaving out one run after the other. It has `power` where what is left is taken for errors of forms,
/// which makes it too small by their noise, and is as large as `sampled` where it is taken for sampling: of shorter runs it lies anywhere between.
fn amplitude(scorer: &Scorer, set: &Set, pair: Phased, power: f64, sampled: f64) -> Estimate {
    let squares: Vec<f64> = scorer.phases(set, pair).iter().map(|c| c[0] * c[0] + c[1] * c[1]).collect();
    let n = squares.len() as f64;
    let weighed = (2.0 * power).sqrt();
    let (value, between) = if rhythm::told_apart(scorer.ground.problem).is_empty() {
        (weighed, 0.5 * (sampled - weighed))
    } else {
        (sampled, 0.0)
    };
    let total: f64 = squares.iter().sum();
    // A share: the runs' coefficients are held back by the tempered noise, all alike.
    let spread = if n > 1.0 {
        let jack: Vec<f64> = squares.iter().map(|s| ((total - s) / (n - 1.0)).max(0.0).sqrt()).collect();
        let mean = jack.iter().sum::<f64>() / n;
        (jack.iter().map(|a| (a - mean).powi(2)).sum::<f64>() * (n - 1.0) / n).sqrt() / mean.max(f64::MIN_POSITIVE)
    } else {
        0.0
    };
    let half = NORMAL_95 * (value * spread.hypot(FORM)).hypot(between);
    let (name, unit, scale) = match pair {
        Phased::Runout(h) => (RUNOUT[h], "1", 1.0),
        Phased::Eccentricity(h) => (ECCENTRICITY[h], "rad", 1.0),
        Phased::Gravity => ("gravity_torque_over_inertia", "rad/s^2", set.model.parameters.get(P::OnAcceleration)),
    };
    let interval = [(value - half).max(0.0) * scale, (value + half) * scale];
    Estimate { name: name.to_owned(), value: value * scale, interval, unit: unit.to_owned() }
}
