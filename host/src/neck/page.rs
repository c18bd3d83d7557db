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
    /// The end point's largest error from one pose to the next.
    worst_mm: Vec<f64>,
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
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::parameters::Flavour;
    use crate::neck::exercise::Exercise;
    use crate::neck::fixture::{session, setup};
    use std::process::Command;

    fn html(session: &Session) -> String {
        let score = Score::of(session, &setup(Flavour::Physical));
        page("Neck <1> @DATA@", "a & b", &[(session, &score)])
    }

    fn data(html: &str) -> serde_json::Value {
        let (_, after) = html.split_once("<script type=\"application/json\" id=\"data\">").unwrap();
        serde_json::from_str(after.split_once("</script>").unwrap().0).unwrap()
    }

    #[test]
    fn nothing_is_fetched_and_text_is_escaped() {
        let html = html(&session("rotation"));
        assert!(html.contains("<h1>Neck &lt;1&gt; &#64;DATA&#64;</h1>") && html.contains("<p>a &amp; b</p>"));
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
        let browsers = ["chromium", "chromium-browser", "google-chrome"];
        let Some(browser) = browsers.into_iter().find(|name| Command::new(name).arg("--version").output().is_ok())
        else {
            eprintln!("SKIPPED: no Chromium here, the page's script was not run");
            return;
        };
        let session = session("flexion-extension");
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("neck.html");
        std::fs::write(&file, html(&session)).unwrap();
        let url = format!("file://{}#flexion-extension@6.5", file.display());
        let profile = format!("--user-data-dir={}", folder.path().join("profile").display());
        let options =
            ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=2000", "--dump-dom", &profile];
        let output = Command::new(browser).args(options).arg(url).output().unwrap();
        let dom = String::from_utf8_lossy(&output.stdout);
        assert!(!dom.contains("data-failed"), "the script failed: {dom}");
        let attribute = |name: &str| -> &str {
            let (_, after) = dom.split_once(&format!("{name}=\"")).unwrap_or_else(|| panic!("no {name} in {dom}"));
            after.split_once('"').unwrap().0
        };
        assert_eq!((attribute("data-exercise"), attribute("data-time")), ("flexion-extension", "6.500"));
        let shown_mm: f64 = attribute("data-error-mm").parse().unwrap();
        let error_mm = session.error_m(13_000) * 1e3;
        // Angles are kept to a thousandth of a degree, 4 µm at the end point.
        assert!((shown_mm - error_mm).abs() < 0.01, "{shown_mm} against {error_mm} mm");
        assert!(dom.contains("Now: hold flexion"));
    }
}
