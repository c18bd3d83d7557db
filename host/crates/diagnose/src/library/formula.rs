//! Effects that are formulas instead of an equation of the rotor's: the user's own, and those that are shipped as a file.

use super::{Coordinate, Effect, Form, LogNormal, Need, Shape, Size};
use crate::library::Reported;
use crate::rotor::P;
use twum_motor::hypothesis::{ActsOn, Hypothesis, Role};

/// Share of a typical size by which the search steps: a derivative.
const STEP: f64 = 0.02;
/// A number of the form is believed to lie between its bounds with 95 %: four standard deviations of its logarithm.
const DEVIATIONS_BETWEEN_BOUNDS: f64 = 4.0;

pub(in crate::library) fn effect(hypothesis: &Hypothesis, places: &[P]) -> Effect {
    let mut form = Form::default();
    for (n, &parameter) in hypothesis.numbers.iter().zip(places) {
        let bounds = (n.min, n.max);
        match n.role {
            Role::Typical(typical) => {
                form.sizes.push(Size { parameter, scale: typical.abs(), step: STEP * typical, bounds })
            }
            Role::Start(start) => {
                let log_sd = (n.max / n.min).ln() / DEVIATIONS_BETWEEN_BOUNDS;
                form.shapes.push(Shape { parameter, start, prior: Some(LogNormal { median: start, log_sd }), bounds });
            }
        }
    }
    let reported = hypothesis.numbers.iter().zip(places).map(|(n, &parameter)| Reported {
        name: n.name.clone().into(),
        unit: n.unit.clone().into(),
        parameter,
        of: None,
    });
    let (of, grows) = match hypothesis.acts_on {
        ActsOn::Speed => ("speed", "speed·(1 + c)"),
        ActsOn::Torque => ("torque", "the contact's torque·(1 + c)"),
        ActsOn::Braking => ("braking", "braking without a wave·(1 + c)"),
        ActsOn::Duty => ("duty", "u → u + c"),
    };
    let says =
        if hypothesis.says.is_empty() { format!("your own: it changes the {of}") } else { hypothesis.says.clone() };
    let (coordinate, needs) = over(hypothesis);
    Effect {
        name: hypothesis.name.clone().into(),
        says: says.into(),
        equation: format!("{grows}, c = {}", hypothesis.change).into(),
        coordinate,
        needs,
        forms: vec![form],
        reported: reported.collect(),
        conflicts: &[],
        next_experiment: "runs in which what your formula hangs on differs and all else is the same",
    }
}

/// Over what a formula shows, and what the data have to show of that: the first of its variables that says so.
fn over(hypothesis: &Hypothesis) -> (Coordinate, &'static [Need]) {
    let on = |variable: &str| hypothesis.hangs_on().any(|v| v == variable);
    if on("turned_rad") {
        (Coordinate::Angle, &[Need::ThirdOfATurn])
    } else if on("revolutions") {
        (Coordinate::Order, &[Need::Order])
    } else if on("time_s") || on("on_s") {
        (Coordinate::Start, &[])
    } else if on("direction") {
        (Coordinate::Direction, &[Need::BothDirections])
    } else {
        (Coordinate::Duty, &[Need::ThreeDuties])
    }
}
