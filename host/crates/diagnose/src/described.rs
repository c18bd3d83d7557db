//! What lives where no effect explains it, said in words and numbers: the strongest terms over named coordinates, fitted beside what was
//! accepted, as equations with intervals. None of them is a cause.

mod gains;
mod orders;

use super::design::{Basis, Column};
use super::discrepancy::Term;
use super::finding::{Curve, Described, Estimate};
use super::ground::Ground;
use super::held_out::{LEAST_RUNS, Scorer};
use super::level::NAMES;
use super::numbers::FORM;
use super::set::Set;
use super::stats::Group;
use nalgebra::{DMatrix, DVector};
use twum_fit::quantile::{NORMAL_95, student_95};

/// Most places that are described: of what is weaker than two others, a person reads nothing.
const MOST: usize = 3;
/// Seconds of delay that a unit of [`Column::Lag`] stands for.
const LAG_S: f64 = 1e-2;

/// The terms over the places in which something lives, strongest first, fitted beside the `accepted` set.
pub fn describe(ground: &Ground, scorer: &Scorer, accepted: &Set, lives_in: &[(&'static str, f64)]) -> Vec<Described> {
    let mut places: Vec<&str> = Vec::new();
    for (place, _) in lives_in {
        // Two effects that were struck may have one.
        if !places.contains(place) {
            places.push(place);
        }
    }
    let spread = |place: &&str| NAMES.iter().position(|name| name == place);
    let view = View { ground, scorer, set: accepted };
    let terms = places.iter().filter(|place| spread(place).is_none());
    let mut all: Vec<Described> = terms.filter_map(|place| view.term(place)).collect();
    let mut spreads: Vec<(f64, Described)> =
        places.iter().filter_map(spread).map(|k| gains::spread(ground, accepted, k)).collect();
    spreads.sort_by(|a, b| b.0.total_cmp(&a.0));
    all.extend(spreads.into_iter().map(|s| s.1));
    // A closed loop has no duty of its own, say.
    all.retain(|d| !d.parameters.is_empty());
    all.truncate(MOST);
    all
}

/// What a term of columns would gain on runs that were not fitted, beside a set.
pub fn term_gain(scorer: &Scorer, set: &Set, term: &Term) -> f64 {
    let (grams, free, _) = scorer.equations(set, &term.columns);
    let own: Vec<usize> = (0..free).collect();
    let columns: Vec<usize> = (grams.columns() - term.columns.len()..grams.columns()).collect();
    let group = if term.own {
        Group::Phased(columns.chunks_exact(2).map(|c| [c[0], c[1]]).collect())
    } else {
        Group::Linear(columns)
    };
    grams.hold_out_around_a_fit(&own, &group).gain()
}

/// What terms are fitted from.
struct View<'a> {
    ground: &'a Ground<'a>,
    scorer: &'a Scorer<'a>,
    set: &'a Set,
}

impl View<'_> {
    fn term(&self, place: &str) -> Option<Described> {
        let term = self.ground.terms.iter().find(|t| t.lives_in == place)?;
        let said = if term.own { orders::own(self.ground, self.set, term) } else { self.common(term)? };
        Some(Described {
            coordinate: coordinate(term.lives_in),
            equation: said.equation,
            parameters: said.parameters,
            gain: term_gain(self.scorer, self.set, term),
            curve: said.curve,
        })
    }

    /// A term whose coefficients all runs share.
    fn common(&self, term: &Term) -> Option<Said> {
        let fit = self.fit(term);
        let longest_s = self.ground.problem.runs.iter().map(|r| r.drive_end).fold(0.0, f64::max);
        let estimate = |name: &dyn Fn(usize) -> String, unit: &str, scale: f64, fit: &Fit| -> Vec<Estimate> {
            let one = |k: usize| fit.estimate(k, name(k), unit, scale);
            (0..fit.values.len()).map(one).collect()
        };
        Some(match *term.columns.first()? {
            Column::Flexible(basis @ (Basis::Time(_, n) | Basis::Heading(_, n) | Basis::Reversed(_, n))) => {
                let times: Vec<f64> = (0..n).map(|k| longest_s * k as f64 / (n - 1).max(1) as f64).collect();
                // A mean over all runs is the free speed, and one over some what runs scatter by; a direction's is its own.
                let fit = if matches!(basis, Basis::Heading(..)) { fit } else { fit.about_its_mean(&ends_half(n)) };
                let (form, whose) = match basis {
                    Basis::Heading(..) => ("speed·(1 ± Σ c_k·hat_k(t))", "+ cw and − ccw"),
                    Basis::Reversed(..) => {
                        ("speed·(1 + Σ c_k·hat_k(t))", "0 on average, in runs that go another way than the one before")
                    }
                    _ => ("speed·(1 + Σ c_k·hat_k(t))", "0 on average"),
                };
                let knots = times.iter().map(|t| short(*t)).collect::<Vec<_>>().join(", ");
                let points = times.iter().zip(fit.values.iter()).map(|(t, c)| [*t, *c]).collect();
                Said {
                    equation: format!("{form}, knots at {knots} s, {whose}"),
                    parameters: estimate(&|k| format!("at_{}_s", short(times[k])), "1", 1.0, &fit),
                    curve: match basis {
                        Basis::Heading(..) => Curve::TimeAndDirection(points),
                        Basis::Reversed(..) => Curve::Elsewhere,
                        _ => Curve::Time(points),
                    },
                }
            }
            Column::Flexible(Basis::Phase(_, n)) => {
                let fit = fit.about_its_mean(&vec![1.0; n]);
                let phase = |k: usize| short(k as f64 / n as f64);
                let knots: Vec<String> = (0..n).map(phase).collect();
                Said::elsewhere(
                    format!("speed·(1 + Σ c_k·hat_k(φ)), φ the PWM phase, knots at {}, 0 on average", knots.join(", ")),
                    estimate(&|k| format!("at_phase_{}", phase(k)), "1", 1.0, &fit),
                )
            }
            Column::Flexible(Basis::Periods(..)) => {
                let name = |k: usize| match term.columns[k] {
                    Column::Flexible(Basis::Periods(n, quarter)) => {
                        format!("every_{n}_periods_{}", if quarter == 0 { "cos" } else { "sin" })
                    }
                    _ => String::new(),
                };
                Said::elsewhere(
                    "speed·(1 + Σ a_n·cos(2πk/n) + b_n·sin(2πk/n)), k PWM periods since the start".to_owned(),
                    estimate(&name, "1", 1.0, &fit),
                )
            }
            Column::Flexible(Basis::Slot) => Said::elsewhere(
                "high slots are pitch·(1 + c) wide, low ones pitch·(1 − c)".to_owned(),
                estimate(&|_| "c".to_owned(), "1", 1.0, &fit),
            ),
            Column::Lag(_, n) => {
                let fit = fit.about_its_mean(&ends_half(n));
                let time = |k: usize| short(longest_s * k as f64 / (n - 1).max(1) as f64);
                Said::elsewhere(
                    "the record is Σ d_k·hat_k(t) behind the drive, 0 on average".to_owned(),
                    estimate(&|k| format!("at_{}_s", time(k)), "s", LAG_S, &fit),
                )
            }
            Column::Flexible(Basis::Pulse(_)) => Said::elsewhere(
                "speed·(1 + c_k) in millisecond k of each pulse".to_owned(),
                estimate(&|k| format!("at_{k}_to_{}_ms", k + 1), "1", 1.0, &fit),
            ),
            Column::Flexible(Basis::AfterSwitching(..)) => {
                let name = |k: usize| match term.columns[k] {
                    Column::Flexible(Basis::AfterSwitching(rise, ms)) => {
                        format!("{}_{ms}_to_{}_ms", if rise { "on" } else { "off" }, ms + 1)
                    }
                    _ => String::new(),
                };
                Said::elsewhere(
                    "speed + free speed·c_k in millisecond k after each switching on or off".to_owned(),
                    estimate(&name, "1", 1.0, &fit),
                )
            }
            _ => return None,
        })
    }

    /// The coefficients of a common term beside the set's own parameters. Their covariance is what whole runs scatter; of few runs, what
    /// sampling does.
    fn fit(&self, term: &Term) -> Fit {
        let (grams, free, _) = self.scorer.equations(self.set, &term.columns);
        let n = term.columns.len();
        let columns: Vec<usize> = (0..free).chain(grams.columns() - n..grams.columns()).collect();
        let (all, mut covariance) = grams.fit_all(&columns);
        let runs = self.ground.problem.runs.len();
        if runs < LEAST_RUNS {
            covariance = grams.covariance(&columns);
        }
        let quantile = if runs < LEAST_RUNS { NORMAL_95 } else { student_95((runs - 1) as f64) };
        Fit {
            values: all.rows(free, n).into_owned(),
            covariance: covariance.view((free, free), (n, n)).into_owned(),
            quantile,
        }
    }
}

/// What is said of a term, but for where it is and what it gains.
struct Said {
    equation: String,
    parameters: Vec<Estimate>,
    curve: Curve,
}

impl Said {
    fn elsewhere(equation: String, parameters: Vec<Estimate>) -> Self {
        Self { equation, parameters, curve: Curve::Elsewhere }
    }
}

/// Coefficients with their covariance.
struct Fit {
    values: DVector<f64>,
    covariance: DMatrix<f64>,
    quantile: f64,
}

impl Fit {
    /// The same less their mean under `weights`: that is the speed as a whole (or the record's delay), which the motor's own parameters hold.
    fn about_its_mean(self, weights: &[f64]) -> Self {
        let total: f64 = weights.iter().sum();
        let n = weights.len();
        let less = DMatrix::from_fn(n, n, |i, j| f64::from(u8::from(i == j)) - weights[j] / total);
        Self { values: &less * self.values, covariance: &less * self.covariance * less.transpose(), ..self }
    }

    fn estimate(&self, k: usize, name: String, unit: &str, scale: f64) -> Estimate {
        let half = (self.quantile * self.covariance[(k, k)].max(0.0).sqrt()).hypot(NORMAL_95 * FORM * self.values[k]);
        let [value, low, high] = [0.0, -half, half].map(|off| scale * (self.values[k] + off));
        Estimate { name, value, interval: [low, high], unit: unit.to_owned() }
    }
}

/// Weights of evenly spaced knots in a mean over what is linear between them.
fn ends_half(n: usize) -> Vec<f64> {
    (0..n).map(|k| if k == 0 || k + 1 == n { 0.5 } else { 1.0 }).collect()
}

/// A place in words, with the plain name of its coordinate in them.
fn coordinate(lives_in: &str) -> String {
    match lives_in {
        "the milliseconds after switching" => format!("PWM phase: {lives_in}"),
        other => other.to_owned(),
    }
}

/// A number of a coordinate, to three decimals.
fn short(value: f64) -> String {
    format!("{}", (1e3 * value).round() / 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cycles::cycles;
    use crate::problem::Problem;
    use crate::{Options, starting_rotor, trial};
    use std::f64::consts::TAU;

    /// What is described of [`crate::trial::runs`], all of it left over in one place.
    fn described(off: &dyn Fn(usize, f64, f64, f64) -> f64, place: &'static str) -> Described {
        let runs = trial::runs(off);
        let rotor = starting_rotor(&runs, &Options::default());
        let problem = Problem::new(runs).widened();
        let mut ground = Ground::new(&problem, rotor.clone(), &[], Vec::new());
        ground.terms.extend(cycles(&problem, &rotor));
        let root = ground.root(problem.model(rotor));
        let scorer = Scorer::new(&ground, &root, 1);
        let mut all = describe(&ground, &scorer, &root, &[(place, 1.0)]);
        assert_eq!(all.len(), 1);
        all.remove(0)
    }

    fn number<'a>(d: &'a Described, name: &str) -> &'a Estimate {
        d.parameters.iter().find(|e| e.name == name).unwrap_or_else(|| panic!("{name} of {d:?}"))
    }

    fn assert_holds(e: &Estimate, truth: f64) {
        let holds = e.interval[0] <= truth && truth <= e.interval[1];
        assert!(holds && (e.value - truth).abs() < 0.005, "{e:?}, not {truth}");
        assert!(e.interval[1] - e.interval[0] < 0.03, "{e:?}");
    }

    /// Fails if an order that is there is missed or has another size, if one is told that is not there, or if phases that differ agree.
    #[test]
    fn a_wave_of_the_angle_is_told_by_its_order_and_size() {
        const PLACE: &str = "angle, three and more times a turn";
        let wave = |angle: f64, phase: f64| 0.05 * (3.0 * angle - phase).cos();
        let apart = described(&|k, _, _, angle| wave(angle, 1.7 * k as f64), PLACE);
        assert_eq!(apart.coordinate, PLACE);
        assert_eq!(apart.equation, "speed·(1 + a3·cos(3θ − φ3)), a φ of its own in every run");
        assert_holds(number(&apart, "a3"), 0.05);
        assert!(apart.gain > 0.5, "{apart:?}");
        let together = described(&|_, _, _, angle| wave(angle, 0.4), PLACE);
        assert!(together.equation.ends_with("the same φ in all runs"), "{}", together.equation);
        let Curve::Angle(orders) = together.curve else { panic!("{together:?}") };
        assert!(orders.len() == 1 && orders[0][0] == 3.0, "{orders:?}");
        assert!((orders[0][1] - 0.05).abs() < 0.005 && (orders[0][2] - 0.4).abs() < 0.1, "{orders:?}");
    }

    /// Fails if what comes at a rate of its own is told at another one, with another size, or in the other coordinate's words.
    #[test]
    fn what_comes_at_a_rate_of_its_own_is_told_by_it() {
        let cage = described(
            &|k, _, _, angle| 0.05 * (2.58 * angle - 1.7 * k as f64).cos(),
            "angle, no whole number of times a turn",
        );
        let Curve::Angle(orders) = &cage.curve else { panic!("{cage:?}") };
        assert!(orders.len() == 1 && (orders[0][0] - 2.58).abs() < 0.1, "{orders:?}");
        let told = &cage.parameters[0];
        assert!(cage.gain > 0.5 && told.interval[0] < 0.05 && 0.05 < told.interval[1], "{cage:?}");
        let hum =
            described(&|k, _, t, _| 0.05 * (TAU * 3.3 * t - 1.7 * k as f64).cos(), "time, so many cycles a second");
        let Curve::Cycle(cycles) = &hum.curve else { panic!("{hum:?}") };
        assert!(cycles.len() == 1 && (cycles[0][0] - 3.3).abs() < 0.1 && hum.gain > 0.5, "{hum:?}");
        assert!(hum.equation.contains("·2πt"), "{}", hum.equation);
    }

    /// Fails if a course of one direction is told of both, or as its mean alone.
    #[test]
    fn a_course_over_the_time_of_one_direction_is_told_with_its_sign() {
        let d = described(&|_, sign, t, _| 0.04 * sign * (t / 2.5), "direction, over the time");
        for (time, expected) in [("at_0.833_s", 0.0133), ("at_2.5_s", 0.04)] {
            assert_holds(number(&d, time), expected);
        }
        assert!(matches!(&d.curve, Curve::TimeAndDirection(points) if points.len() == 4), "{d:?}");
    }

    /// Fails if a course that all runs share is told wrongly, or with the speed as a whole in it.
    #[test]
    fn a_course_over_time_is_told_about_its_mean() {
        let d = described(&|_, _, t, _| 0.06 * (t / 2.5 - 0.5), "time");
        for (time, expected) in [("at_0.5_s", -0.018), ("at_1.5_s", 0.006), ("at_2.5_s", 0.03)] {
            assert_holds(number(&d, time), expected);
        }
        assert!(d.gain > 0.3, "{d:?}");
        let Curve::Time(points) = &d.curve else { panic!("{d:?}") };
        assert!(points.len() == 6 && points[5][0] == 2.5 && (points[5][1] - 0.03).abs() < 0.005, "{points:?}");
    }

    /// Fails if what comes in each pulse is told of another millisecond of it, or with another size.
    #[test]
    fn what_comes_within_every_pulse_is_told_by_its_milliseconds() {
        let bump = |t: f64| if (3e-3..6e-3).contains(&(t % 0.02)) { 0.08 } else { 0.0 };
        let d = described(&|_, _, t, _| bump(t), "PWM phase, within the pulse");
        assert_eq!(d.equation, "speed·(1 + c_k) in millisecond k of each pulse");
        let [before, within, after] =
            ["at_1_to_2_ms", "at_4_to_5_ms", "at_8_to_9_ms"].map(|name| number(&d, name).value);
        assert!((within - 0.08).abs() < 0.02 && before.abs() < 0.02 && after.abs() < 0.02, "{d:?}");
        assert!(d.gain > 0.3, "{d:?}");
    }

    /// Fails if a course that every run has of its own is lost in what sampling makes of it, or told of a motor that has none.
    #[test]
    fn a_course_of_its_own_in_every_run_is_told_by_its_size() {
        const PLACE: &str = "time, each run its own";
        let d = described(&|k, _, t, _| 0.05 * (TAU * t / 0.9 - 1.7 * k as f64).sin(), PLACE);
        assert_holds(number(&d, "root_mean_square"), 0.05 * 0.5_f64.sqrt());
        assert!(d.gain > 0.3 && d.curve == Curve::Elsewhere, "{d:?}");
        let none = described(&|_, _, _, _| 0.0, PLACE);
        assert!(number(&none, "root_mean_square").value < 0.003, "{none:?}");
    }

    /// Fails if what differs with the direction is told with the wrong sign or size, or does not foretell runs left out.
    #[test]
    fn a_spread_over_the_direction_is_told_by_its_sides() {
        let d = described(&|k, sign, _, _| 0.03 * sign + 0.002 * (k as f64 - 3.5).sin(), "direction");
        let [cw, ccw] = ["cw", "ccw"].map(|side| number(&d, side));
        assert!((cw.value - 0.03).abs() < 0.006 && (cw.value + ccw.value).abs() < 1e-9, "{d:?}");
        assert!(cw.interval[0] < 0.03 && 0.03 < cw.interval[1] && cw.interval[0] > 0.0, "{cw:?}");
        assert!(d.gain > 0.5 && d.curve == Curve::Direction(cw.value), "{d:?}");
    }
}
