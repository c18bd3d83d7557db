//! What was described, as a formula that the motor model simulates: `[effects.described]` of a motor file.

use super::answer::DescribedAnswer;
use super::finding::Curve;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::sync::Arc;
use twum_motor::hypothesis::{ActsOn, DESCRIBED, DIMENSIONLESS, Formula, Hypothesis, LONGEST, Number, Role};

/// Why a term is not in the file.
const NOT_SAID: &str = "no formula over what the motor model knows says it";
const TOO_LONG: &str = "with it the formula would be longer than a motor file takes";

/// Decimals of the numbers in a formula, of which the largest change is 1: a thousandth of it over ten seconds.
const DECIMALS: usize = 5;

/// The terms that a formula can say, the strongest first, as one effect on the speed; and those that it cannot, with the reason.
pub fn effect(described: &[DescribedAnswer], voltage_per_speed: f64) -> (Option<Formula>, Vec<(&str, &'static str)>) {
    let (mut said, mut left): (Vec<&DescribedAnswer>, _) = (Vec::new(), Vec::new());
    let mut effect = None;
    for term in described {
        if shape(&term.curve).is_none() {
            left.push((term.coordinate.as_str(), NOT_SAID));
            continue;
        }
        said.push(term);
        match together(&said, voltage_per_speed) {
            Some(longer) => effect = Some(longer),
            None => {
                said.pop();
                left.push((term.coordinate.as_str(), TOO_LONG));
            }
        }
    }
    (effect, left)
}

fn together(terms: &[&DescribedAnswer], voltage_per_speed: f64) -> Option<Formula> {
    let mut shapes: Vec<Shape> = terms.iter().filter_map(|t| shape(&t.curve)).collect();
    for k in 1..shapes.len() {
        // Two terms over one coordinate have a size each.
        let before = shapes[..k].iter().filter(|s| s.name.starts_with(&shapes[k].name)).count();
        if before > 0 {
            shapes[k].name += &format!("_{}", before + 1);
        }
    }
    let change = shapes.iter().map(|s| format!("{}*({})", s.name, s.formula)).collect::<Vec<_>>().join(" + ");
    if change.chars().count() > LONGEST {
        return None;
    }
    // Bounds for who fits it again: none at all, or twice as much.
    let number = |s: &Shape| Number {
        name: s.name.clone(),
        unit: DIMENSIONLESS.to_owned(),
        role: Role::Typical(s.size),
        min: 0.0,
        max: 2.0 * s.size,
    };
    let places: Vec<&str> = terms.iter().map(|t| t.coordinate.as_str()).collect();
    let says = format!("no cause: what no effect of the library explains, over {}", places.join("; "));
    let numbers = shapes.iter().map(number).collect();
    let hypothesis = Hypothesis::new(DESCRIBED, &says, ActsOn::Speed, &change, numbers).ok()?;
    // In the order that the hypothesis has them.
    let size = |n: &Number| shapes.iter().find(|s| s.name == n.name).map_or(0.0, |s| s.size);
    let values = hypothesis.numbers.iter().map(size).collect();
    Some(Formula { hypothesis: Arc::new(hypothesis), values, voltage_per_speed })
}

/// A curve: its largest change, and a formula of what of it is where.
struct Shape {
    name: String,
    size: f64,
    formula: String,
}

/// None of a curve that is none, or over what formulas do not know.
fn shape(curve: &Curve) -> Option<Shape> {
    let largest = |points: &[[f64; 2]]| points.iter().map(|p| p[1].abs()).fold(0.0, f64::max);
    let of = |name: &str, size: f64, formula: &dyn Fn() -> String| {
        (size > 0.0 && size.is_finite()).then(|| Shape { name: name.to_owned(), size, formula: formula() })
    };
    match curve {
        Curve::Time(points) => {
            let size = largest(points);
            of("over_time", size, &|| polyline("time_s", points, size))
        }
        Curve::Duty(points) => {
            let size = largest(points);
            of("over_duty", size, &|| polyline("duty", points, size))
        }
        Curve::Direction(cw) => {
            of("over_direction", cw.abs(), &|| if *cw > 0.0 { "direction" } else { "-direction" }.to_owned())
        }
        Curve::DutyAndDirection(points) => {
            let size = largest(points);
            of("over_both", size, &|| format!("direction*({})", polyline("duty", points, size)))
        }
        Curve::TimeAndDirection(points) => {
            let size = largest(points);
            of("by_direction_over_time", size, &|| format!("direction*({})", polyline("time_s", points, size)))
        }
        Curve::Angle(orders) => {
            let size = orders.iter().map(|o| o[1]).fold(0.0, f64::max);
            of("over_angle", size, &|| waves(orders, size, "turned_rad"))
        }
        Curve::Cycle(cycles) => {
            let size = cycles.iter().map(|o| o[1]).fold(0.0, f64::max);
            let radians: Vec<[f64; 3]> = cycles.iter().map(|[hz, a, phase]| [TAU * hz, *a, *phase]).collect();
            of("over_cycles", size, &|| waves(&radians, size, "time_s"))
        }
        Curve::Elsewhere => None,
    }
}

/// What is linear between points and constant beyond them, of a `size`: a constant, and an `abs` at each point where the slope changes.
fn polyline(variable: &str, points: &[[f64; 2]], size: f64) -> String {
    let slope = |k: usize| {
        let (from, to) = (k.checked_sub(1).and_then(|k| points.get(k)), points.get(k));
        from.zip(to).map_or(0.0, |(from, to)| (to[1] - from[1]) / (to[0] - from[0]) / size)
    };
    let ends = [points.first(), points.last()].map(|p| p.map_or(0.0, |p| p[1]));
    let mut out = decimal(0.5 * (ends[0] + ends[1]) / size);
    for (k, point) in points.iter().enumerate() {
        let bend = decimal(0.5 * (slope(k + 1) - slope(k)).abs());
        if bend != "0" {
            let sign = if slope(k + 1) < slope(k) { '-' } else { '+' };
            let _ = write!(out, "{sign}{bend}*abs({variable}-{})", decimal(point[0]));
        }
    }
    out
}

/// Waves of an angle, of a `size`.
fn waves(orders: &[[f64; 3]], size: f64, angle: &str) -> String {
    let wave = |[order, amplitude, phase]: &[f64; 3]| {
        let sign = if *phase > 0.0 { '-' } else { '+' };
        format!("{}*cos({}*{angle}{sign}{})", decimal(amplitude / size), decimal(*order), decimal(phase.abs()))
    };
    orders.iter().map(wave).collect::<Vec<_>>().join("+")
}

/// A number without what says nothing at its end.
fn decimal(value: f64) -> String {
    let text = format!("{value:.DECIMALS$}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;
    use twum_motor::hypothesis::Now;

    fn described(curve: Curve) -> DescribedAnswer {
        DescribedAnswer {
            coordinate: "somewhere".to_owned(),
            equation: String::new(),
            parameters: BTreeMap::new(),
            gain_heldout: 0.1,
            curve,
        }
    }

    /// Fails if a formula does not say what was described, between its points or beyond them.
    #[test]
    fn a_formula_says_what_was_described() {
        let times = Curve::Time(vec![[0.0, -0.03], [0.5, 0.02], [1.0, 0.01], [2.5, -0.04]]);
        let duties = vec![[0.1, 0.02], [0.45, -0.05], [1.0, 0.0]];
        let angle = Curve::Angle(vec![[3.0, 0.04, 1.2], [5.0, 0.01, -2.0]]);
        let terms = [times, Curve::Elsewhere, Curve::DutyAndDirection(duties), angle].map(described);
        let (effect, left) = effect(&terms, 0.7);
        assert_eq!(left, [("somewhere", NOT_SAID)]);
        let effect = effect.expect("three of them can be said");
        assert!(effect.hypothesis.says.starts_with("no cause"), "{}", effect.hypothesis.says);
        for (time_s, over_time) in [(0.0, -0.03), (0.25, -0.005), (0.75, 0.015), (1.75, -0.015), (9.0, -0.04)] {
            for (duty, over_duty) in [(0.05, 0.02), (0.275, -0.015), (0.725, -0.025), (1.0, 0.0)] {
                for direction in [-1.0, 1.0] {
                    let turned_rad = 3.0 * duty;
                    let angle = 0.04 * (3.0 * turned_rad - 1.2_f64).cos() + 0.01 * (5.0 * turned_rad + 2.0_f64).cos();
                    let now = Now { duty, time_s, direction, turned_rad, ..Now::default() };
                    let change = effect.change_of(ActsOn::Speed, &now);
                    let expected = over_time + direction * over_duty + angle;
                    assert!((change - expected).abs() < 1e-5, "{now:?}: {change}, not {expected}");
                }
            }
        }
    }

    /// Fails if a course over the time loses its direction's sign, or cycles a second are those of a radian.
    #[test]
    fn a_formula_says_a_direction_s_course_and_cycles() {
        let course = Curve::TimeAndDirection(vec![[0.0, 0.02], [2.0, -0.01]]);
        let cycles = Curve::Cycle(vec![[1.4, 0.03, 0.5]]);
        let terms = [course, cycles].map(described);
        let (effect, left) = effect(&terms, 1.0);
        assert_eq!(left, []);
        let effect = effect.expect("both can be said");
        for (time_s, direction) in [(0.3, 1.0), (1.1, -1.0), (3.0, -1.0)] {
            let now = Now { time_s, direction, ..Now::default() };
            let expected = direction * (0.02 - 0.015 * f64::min(time_s, 2.0)) + 0.03 * (TAU * 1.4 * time_s - 0.5).cos();
            let change = effect.change_of(ActsOn::Speed, &now);
            assert!((change - expected).abs() < 1e-4, "{now:?}: {change}, not {expected}");
        }
    }

    /// Fails if of two terms over the angle, low orders and high ones, one is lost or has the other's size.
    #[test]
    fn two_terms_over_one_coordinate_are_both_said() {
        let terms = [vec![[3.0, 0.04, 0.5]], vec![[11.0, 0.01, 0.0]]].map(|orders| described(Curve::Angle(orders)));
        let (effect, left) = effect(&terms, 1.0);
        assert_eq!(left, []);
        let now = Now { turned_rad: 0.7, ..Now::default() };
        let expected = 0.04 * (3.0 * 0.7_f64 - 0.5).cos() + 0.01 * (11.0 * 0.7_f64).cos();
        let change = effect.expect("both can be said").change_of(ActsOn::Speed, &now);
        assert!((change - expected).abs() < 1e-5, "{change}, not {expected}");
    }

    /// Fails if what is too long for a motor file takes what would fit with it, or a curve that is none makes an effect.
    #[test]
    fn what_is_too_long_is_left_out() {
        let long = Curve::Duty((0..40).map(|k| [0.025 * f64::from(k), 0.01 * f64::from(k % 3)]).collect());
        let terms = [long, Curve::Direction(-0.02)].map(described);
        let (some, left) = effect(&terms, 1.0);
        assert_eq!(left, [("somewhere", TOO_LONG)]);
        let now = Now { direction: 1.0, ..Now::default() };
        assert_eq!(some.map(|e| e.change_of(ActsOn::Speed, &now)), Some(-0.02));
        assert_eq!(effect(&[described(Curve::Direction(0.0))], 1.0).0, None);
    }
}
