//! A page that plays a session in three dimensions: one HTML file, no network.

use super::picture;
use crate::neck::kinematics::JOINTS;
use crate::neck::score::Score;
use crate::neck::session::Session;
use crate::report::figure::interactive::Interactive;
use crate::report::page::{SHARED, Shared, embedded};
use askama::Template;
use serde::Serialize;

#[derive(Template)]
#[template(path = "neck.html")]
struct Document<'a> {
    title: &'a str,
    shared: Shared,
    setup: &'a str,
    data: String,
}

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
    /// The end point's largest error from one pose to the next.
    worst_mm: Vec<f64>,
    summary: Vec<[String; 2]>,
    errors: Interactive,
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
    Document { title, shared: SHARED, setup, data: embedded(&data) }.render().expect("a page is written to a string")
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
        [
            format!("joint {}: mean, largest", joint.joint),
            format!("{:.2}°, {:.2}°", joint.mean_abs_error_deg, joint.max_error_deg),
        ]
    }));
    Played {
        name: session.exercise.name(),
        title: session.exercise.title(),
        duration_s: session.exercise.duration_s(),
        segments: session.exercise.segments().iter().map(|s| Stretch { name: &s.name, seconds: s.seconds }).collect(),
        reference_deg: ticks.iter().map(|&tick| thousandths(session.reference_deg(tick))).collect(),
        true_deg: ticks.iter().map(|&tick| thousandths(session.joints_deg(tick))).collect(),
        worst_mm: ticks
            .iter()
            .map(|&tick| (tick..(tick + stride).min(session.len())).map(|t| session.error_m(t)).fold(0.0, f64::max))
            .map(|metres| (metres * 1e6).round() / 1e3)
            .collect(),
        summary,
        errors: picture::errors(session).interactive(ticks.len()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::parameters::Flavour;
    use crate::neck::exercise::Exercise;
    use crate::neck::fixture::{session, setup};
    use crate::report::page::browser;

    fn html(session: &Session) -> String {
        let score = Score::of(session, &setup(Flavour::Physical));
        page("Neck <1>", "a & b", &[(session, &score)])
    }

    fn data(html: &str) -> serde_json::Value {
        let (_, after) = html.split_once("<script type=\"application/json\" id=\"data\">").unwrap();
        serde_json::from_str(after.split_once("</script>").unwrap().0).unwrap()
    }

    #[test]
    fn nothing_is_fetched_and_text_is_escaped() {
        let html = html(&session("rotation"));
        assert!(html.contains("<h1>Neck &#60;1&#62;</h1>") && html.contains("<p>a &#38; b</p>"));
        let html = html.replace("https://github.com/leeoniya/uPlot", "");
        for fetched in ["http", "src=", "href=", "@import", "url(", "fetch(", "import("] {
            assert!(!html.contains(fetched), "{fetched}");
        }
    }

    #[test]
    fn the_poses_are_the_sessions() {
        let session = session("flexion-extension");
        let data = data(&html(&session));
        let played = &data["exercises"][0];
        assert_eq!(played["true_deg"].as_array().unwrap().len(), 22 * 50 + 1);
        for index in [0, 75, 321, 1100] {
            let tick = index * 40;
            for joint in 0..JOINTS {
                let near = |rows: &str, deg: f64| (played[rows][index][joint].as_f64().unwrap() - deg).abs() <= 5.1e-4;
                assert!(near("true_deg", session.joints_deg(tick)[joint]));
                assert!(near("reference_deg", session.reference_deg(tick)[joint]));
            }
            let worst = (tick..(tick + 40).min(session.len())).map(|t| session.error_m(t) * 1e3).fold(0.0, f64::max);
            assert!((played["worst_mm"][index].as_f64().unwrap() - worst).abs() <= 5.1e-4);
        }
    }

    #[test]
    fn a_name_cannot_end_the_data() {
        let text = Exercise::shipped_file("rotation").unwrap().replace("name = \"hold\"", "name = \"</script><b>\"");
        let exercise = Exercise::parse(&text, std::path::Path::new("x")).unwrap();
        let session = setup(Flavour::Physical).simulate(&exercise).unwrap();
        let html = html(&session);
        assert!(!html.contains("</script><b>"));
        assert_eq!(data(&html)["exercises"][0]["segments"][1]["name"], "</script><b>");
    }

    /// The page as a person would see it: its script runs in a browser, and shows the simulator's own numbers.
    #[test]
    fn a_browser_shows_the_sessions_pose() {
        let session = session("flexion-extension");
        let Some(seen) = browser::show(&html(&session), "#flexion-extension@6.5", "", 1280) else { return };
        assert_eq!(seen.console, Vec::<String>::new());
        let attribute = |name: &str| seen.attribute(name);
        assert_eq!(attribute("data-plots"), "2");
        assert_eq!((attribute("data-exercise"), attribute("data-time")), ("flexion-extension", "6.500"));
        let shown_mm: f64 = attribute("data-error-mm").parse().unwrap();
        let error_mm = session.error_m(13_000) * 1e3;
        // Angles are kept to a thousandth of a degree, 4 µm at the end point.
        assert!((shown_mm - error_mm).abs() < 0.01, "{shown_mm} against {error_mm} mm");
        assert!(seen.dom.contains("Now: hold flexion"));
    }
}
