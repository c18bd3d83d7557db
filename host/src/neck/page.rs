//! A page that plays a session in three dimensions: one HTML file, no network.

use super::kinematics::JOINTS;
use super::score::Score;
use super::session::Session;
use crate::report::html::escaped;
use serde::Serialize;

const TEMPLATE: &str = include_str!("page.html");
/// Time between the poses kept, s: smooth to the eye, and a hundred kilobytes an exercise.
const STEP_S: f64 = 0.02;

#[derive(Serialize)]
struct Data<'a> {
    step_s: f64,
    length_m: f64,
    exercises: Vec<Played<'a>>,
}

#[derive(Serialize)]
struct Played<'a> {
    name: &'a str,
    title: &'a str,
    duration_s: f64,
    segments: Vec<Stretch<'a>>,
    reference_deg: Vec<[f64; JOINTS]>,
    true_deg: Vec<[f64; JOINTS]>,
    error_mm: Vec<f64>,
    summary: Vec<[String; 2]>,
}

#[derive(Serialize)]
struct Stretch<'a> {
    name: &'a str,
    seconds: f64,
}

/// The page for some sessions and their scores; `setup` says in a line how they were made.
///
/// `page.html#rotation@6.5` opens it at that exercise and time, at rest.
pub fn page(title: &str, setup: &str, played: &[(&Session, &Score)]) -> String {
    let data = Data {
        step_s: STEP_S,
        length_m: played.first().map_or(1.0, |(session, _)| session.wrist.length_m),
        exercises: played.iter().map(|(session, score)| exercise(session, score)).collect(),
    };
    let data = serde_json::to_string(&data).expect("numbers and strings always serialise");
    // An @ in a title must not be taken for a place in the template, nor a < in a name for the end of the data.
    let text = |text: &str| escaped(text).replace('@', "&#64;");
    TEMPLATE
        .replace("@TITLE@", &text(title))
        .replace("@SETUP@", &text(setup))
        .replace("@DATA@", &data.replace('<', "\\u003c"))
}

fn exercise<'a>(session: &'a Session, score: &'a Score) -> Played<'a> {
    let stride = ((STEP_S / session.tick_s).round() as usize).max(1);
    let ticks: Vec<usize> = (0..session.len()).step_by(stride).collect();
    let thousandths = |pose: [f64; JOINTS]| pose.map(|deg| (deg * 1e3).round() / 1e3);
    let millimetres = |metres: f64| format!("{:.2} mm", metres * 1e3);
    let mut summary = vec![
        ["mean error".to_owned(), millimetres(score.mean_abs_error_m)],
        ["root mean square error".to_owned(), millimetres(score.mse_m2.sqrt())],
        ["largest error".to_owned(), millimetres(score.max_error_m)],
        ["mean without correction".to_owned(), millimetres(score.uncorrected_mean_abs_error_m)],
    ];
    summary.extend(score.joints.iter().map(|joint| {
        [format!("joint {}: mean, largest", joint.joint), format!("{:.2}°, {:.2}°", joint.mean_abs_error_deg, joint.max_error_deg)]
    }));
    Played {
        name: session.exercise.name(),
        title: session.exercise.title(),
        duration_s: session.exercise.duration_s(),
        segments: session.exercise.segments().iter().map(|s| Stretch { name: &s.name, seconds: s.seconds }).collect(),
        reference_deg: ticks.iter().map(|&tick| thousandths(session.reference_deg(tick))).collect(),
        true_deg: ticks.iter().map(|&tick| thousandths(session.joints_deg(tick))).collect(),
        error_mm: ticks.iter().map(|&tick| (session.error_m(tick) * 1e6).round() / 1e3).collect(),
        summary,
    }
}
