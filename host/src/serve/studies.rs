//! What computes for long: diagnosis, comparison, plans. The command line does it, in a program of its own: it takes the
//! processor when nobody else wants it, is ended by a click, and cannot bring down the server that owns the port.

use super::App;
use super::answer::{Answer, Refused, command, in_force};
use super::owner::Command as Order;
use super::series::Task;
use crate::diagnose::plan::first_experiment;
use crate::record::series::{Series, SeriesRun};
use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::http::header::{CONTENT_SECURITY_POLICY, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

/// Studies whose answers are kept, the latest.
const KEPT: usize = 20;
/// Longest text kept of what a study prints, bytes.
const PRINTED: u64 = 4 << 20;
/// Runs of a plan.
const PLANNED: usize = 1000;
/// Keys pressed in a report's frame do not come to the page around it: those that stop are told to it.
const KEYS: &str = "<script>addEventListener('keydown', e => { if (e.key === 'Escape' || e.key === ' ') { e.preventDefault(); \
                    parent.postMessage('stop', '*'); } }, true);</script>";
/// A study's end is looked for this often.
const LOOKED_AT: Duration = Duration::from_millis(50);

/// What can be asked of studies.
pub fn routes() -> Router<Arc<App>> {
    Router::new()
        .route("/api/studies", get(list))
        .route("/api/study", post(start))
        .route("/api/study/cancel", post(cancel))
        .route("/api/study/page", get(page))
        .route("/api/study/text", get(text))
        .route("/api/experiment/plan", post(plan))
        .route("/api/experiment/run", post(run))
}

/// What to study.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Question {
    /// What the simulation gets wrong, and why.
    Diagnose {
        /// Recordings and folders.
        runs: Vec<String>,
        /// A first look.
        quick: bool,
    },
    /// A run against the simulation.
    Compare {
        /// The run.
        run: String,
    },
    /// The stator's circuit, of a sweep.
    Stator {
        /// Its file.
        run: String,
        /// The shunt (ohm).
        shunt_ohm: f64,
    },
    /// The motor's friction, of a folder of trials.
    Friction {
        /// The folder.
        run: String,
    },
    /// The neck manipulator in simulation.
    Neck {
        /// One of `twum neck exercises`, or `all`.
        exercise: String,
    },
    /// The runs that decide what a diagnosis left open.
    NextRuns {
        /// Recordings and folders measured so far.
        runs: Vec<String>,
    },
}

impl Question {
    /// The command line that answers it: its words, and the page that it writes.
    fn words(&self, app: &App, page: &Path) -> Result<Vec<String>, String> {
        let text = |path: PathBuf| path.to_string_lossy().into_owned();
        let all = |runs: &[String]| -> Result<Vec<String>, String> {
            if runs.is_empty() {
                return Err("choose at least one run or folder".to_owned());
            }
            runs.iter().map(|run| app.folder.existing(run).map(text)).collect()
        };
        let own = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect::<Vec<String>>();
        let report = text(page.to_owned());
        Ok(match self {
            Self::Diagnose { runs, quick } => {
                let mut words = own(&["diagnose", "--progress", "--report", &report]);
                words.extend(quick.then(|| "--quick".to_owned()));
                [words, all(runs)?].concat()
            }
            Self::Compare { run } => [own(&["compare", "--report", &report]), all(std::slice::from_ref(run))?].concat(),
            Self::Stator { run, shunt_ohm } => {
                let shunt = shunt_ohm.to_string();
                let words = own(&["identify", "stator", "--shunt", &shunt, "--plot", &report]);
                [words, all(std::slice::from_ref(run))?].concat()
            }
            Self::Friction { run } => {
                [own(&["identify", "friction", "--plot", &report]), all(std::slice::from_ref(run))?].concat()
            }
            Self::Neck { exercise } => {
                // A name, never a path.
                if !exercise.chars().all(|c| c.is_ascii_lowercase() || c == '-') || exercise.starts_with('-') {
                    return Err(format!("no exercise `{}`", crate::input::printable(exercise)));
                }
                own(&["neck", "--exercise", exercise, "--report", &report])
            }
            Self::NextRuns { runs } => [own(&["experiment", "plan", "--json"]), all(runs)?].concat(),
        })
    }

    fn title(&self) -> String {
        match self {
            Self::Diagnose { runs, quick } => {
                format!("diagnosis of {}{}", runs.join(", "), if *quick { ", a first look" } else { "" })
            }
            Self::Compare { run } => format!("{run} against the simulation"),
            Self::Stator { run, .. } => format!("the stator's circuit, of {run}"),
            Self::Friction { run } => format!("friction, of {run}"),
            Self::Neck { exercise } => format!("the neck, exercise {exercise}"),
            Self::NextRuns { runs } => format!("the runs that decide, after {}", runs.join(", ")),
        }
    }
}

/// How a study is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// It computes.
    Running,
    /// It has answered.
    Done,
    /// It could not.
    Failed,
    /// Somebody ended it.
    Cancelled,
}

#[derive(Serialize)]
struct Study {
    study: u64,
    title: String,
    stage: Stage,
    /// What it is doing now.
    doing: String,
    /// How far it is, where it says so.
    share: Option<f64>,
    seconds: f64,
    has_page: bool,
    #[serde(skip)]
    began: Instant,
    #[serde(skip)]
    page: PathBuf,
    #[serde(skip)]
    printed: String,
}

#[derive(Default)]
struct Desk {
    studies: VecDeque<Study>,
    made: u64,
    child: Option<Child>,
    pages: Option<tempfile::TempDir>,
}

/// The studies there are; one computes at a time.
#[derive(Default)]
pub struct Studies {
    desk: Mutex<Desk>,
}

impl Studies {
    fn desk(&self) -> MutexGuard<'_, Desk> {
        self.desk.lock().expect("nothing panics while it holds the studies")
    }

    /// Ends the one that computes.
    pub fn end(&self) {
        if let Some(child) = &mut self.desk().child {
            // It may have ended by itself.
            let _ = child.kill();
        }
    }
}

fn begin(app: &Arc<App>, question: &Question) -> Result<u64, String> {
    let mut desk = app.studies.desk();
    if desk.child.is_some() {
        return Err("another study computes: wait for its end, or end it".to_owned());
    }
    let (number, failed) = (desk.made + 1, |error: std::io::Error| format!("it cannot be begun: {error}"));
    let pages = match desk.pages.take() {
        Some(pages) => pages,
        None => tempfile::tempdir().map_err(failed)?,
    };
    let page = pages.path().join(format!("{number}.html"));
    desk.pages = Some(pages);
    let words = question.words(app, &page)?;
    let program = std::env::current_exe().map_err(failed)?;
    let mut nice = Command::new("nice");
    nice.args(["-n", "10"]).arg(&program).args(&words).stdin(Stdio::null());
    let mut child = nice.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().map_err(failed)?;
    let (out, err) = (child.stdout.take(), child.stderr.take());
    desk.made = number;
    desk.child = Some(child);
    desk.studies.push_back(Study {
        study: number,
        title: question.title(),
        stage: Stage::Running,
        doing: "reading".to_owned(),
        share: None,
        seconds: 0.0,
        has_page: false,
        began: Instant::now(),
        page,
        printed: String::new(),
    });
    if desk.studies.len() > KEPT {
        desk.studies.pop_front();
    }
    drop(desk);
    let printed = std::thread::spawn(move || {
        let mut text = Vec::new();
        // What was printed until it failed is what there is.
        let _ = out.map(|out| out.take(PRINTED).read_to_end(&mut text));
        String::from_utf8_lossy(&text).into_owned()
    });
    let app = Arc::clone(app);
    std::thread::spawn(move || {
        let goes_on = |share, what: &str| {
            if let Some(study) = app.studies.desk().studies.iter_mut().find(|it| it.study == number) {
                (study.share, study.doing) = (Some(share), what.to_owned());
            }
        };
        let said = err.map_or_else(String::new, |err| follow(err, goes_on));
        conclude(&app, number, said, printed.join().unwrap_or_default());
    });
    Ok(number)
}

/// Takes what a command says of its progress, share and words; gives what else it said.
pub fn follow(err: impl Read, mut goes_on: impl FnMut(f64, &str)) -> String {
    let mut said = String::new();
    for line in BufReader::new(err.take(PRINTED)).lines().map_while(Result::ok) {
        let progress = line.strip_prefix("progress ").and_then(|rest| rest.split_once(' '));
        match progress.and_then(|(share, what)| Some((share.parse::<f64>().ok()?, what))) {
            Some((share, what)) => goes_on(share, what),
            None => said += &format!("{line}\n"),
        }
    }
    said
}

fn conclude(app: &App, number: u64, said: String, printed: String) {
    let code = loop {
        let waited = app.studies.desk().child.as_mut().map(Child::try_wait);
        match waited {
            Some(Ok(None)) => std::thread::sleep(LOOKED_AT),
            Some(Ok(Some(status))) => break status.code(),
            Some(Err(_)) | None => break None,
        }
    };
    let mut desk = app.studies.desk();
    desk.child = None;
    let Some(study) = desk.studies.iter_mut().find(|it| it.study == number) else { return };
    study.has_page = study.page.exists();
    study.seconds = study.began.elapsed().as_secs_f64();
    // A comparison that finds a difference says so by its exit code.
    let answered = matches!(code, Some(0 | 1)) && (study.has_page || !printed.is_empty());
    if study.stage == Stage::Running {
        study.stage = if answered { Stage::Done } else { Stage::Failed };
    }
    let last = said.lines().last().unwrap_or("it ended without a word").to_owned();
    study.doing = if answered { String::new() } else { last };
    study.printed = printed;
    let line = format!("{}: {:?}", study.title, study.stage).to_lowercase();
    drop(desk);
    app.board.say(line);
}

async fn list(State(app): State<Arc<App>>) -> Answer {
    let mut desk = app.studies.desk();
    for study in desk.studies.iter_mut().filter(|study| study.stage == Stage::Running) {
        study.seconds = study.began.elapsed().as_secs_f64();
    }
    Ok(Json(json!({ "studies": desk.studies.iter().rev().collect::<Vec<_>>() })))
}

async fn start(State(app): State<Arc<App>>, Json(question): Json<Question>) -> Answer {
    let number = begin(&app, &question).map_err(|why| Refused(StatusCode::CONFLICT, why))?;
    Ok(Json(json!({ "study": number })))
}

/// Which study.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Which {
    study: u64,
}

async fn cancel(State(app): State<Arc<App>>, Json(which): Json<Which>) -> Answer {
    let mut desk = app.studies.desk();
    let running = desk.studies.iter_mut().find(|it| it.study == which.study && it.stage == Stage::Running);
    let Some(study) = running else { return Err("it does not compute any more".to_owned().into()) };
    study.stage = Stage::Cancelled;
    drop(desk);
    app.studies.end();
    Ok(Json(json!({ "cancelled": true })))
}

async fn page(State(app): State<Arc<App>>, Query(which): Query<Which>) -> Response {
    let path = app.studies.desk().studies.iter().find(|it| it.study == which.study).map(|it| it.page.clone());
    match path.map(std::fs::read) {
        // A report runs its own scripts, apart from everything else: it reaches nothing of this server.
        Some(Ok(html)) => {
            let html = String::from_utf8_lossy(&html).replacen("</body>", &format!("{KEYS}</body>"), 1);
            let policy = "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; \
                          img-src data:; frame-ancestors 'self'";
            ([(CONTENT_TYPE, "text/html; charset=utf-8"), (CONTENT_SECURITY_POLICY, policy)], html).into_response()
        }
        _ => Refused(StatusCode::NOT_FOUND, "this study has no page".to_owned()).into_response(),
    }
}

async fn text(State(app): State<Arc<App>>, Query(which): Query<Which>) -> Answer {
    let desk = app.studies.desk();
    let found = desk.studies.iter().find(|it| it.study == which.study);
    let found = found.ok_or_else(|| "there is no such study any more".to_owned())?;
    let value = serde_json::from_str::<Value>(&found.printed).ok();
    Ok(Json(json!({ "text": found.printed, "json": value })))
}

/// A table of runs.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    duties: Vec<f64>,
    directions: Vec<String>,
    trials: usize,
    seconds: f64,
}

async fn plan(State(app): State<Arc<App>>, Json(table): Json<Table>) -> Answer {
    let sound = table.duties.iter().all(|duty| (0.0..=1.0).contains(duty)) && (0.001..=3600.0).contains(&table.seconds);
    if !sound || table.duties.is_empty() || table.duties.len().saturating_mul(table.trials) > PLANNED / 2 {
        return Err(format!("duties are 0 to 1, seconds 0.001 to 3600, and at most {PLANNED} runs make a plan").into());
    }
    let pwm_hz = f64::from(in_force(&app).pwm_hz);
    let planned = first_experiment(&table.duties, table.trials, table.seconds, pwm_hz);
    let runs: Vec<SeriesRun> = planned
        .iter()
        .filter(|run| table.directions.iter().any(|direction| *direction == run.direction))
        .enumerate()
        .map(|(number, run)| run.in_series(number))
        .collect();
    Ok(Json(json!({ "runs": runs })))
}

/// A series to begin, or to go on with.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Wanted {
    page: String,
    name: String,
    /// The plan; none goes on with the folder's own.
    runs: Option<Vec<SeriesRun>>,
}

async fn run(State(app): State<Arc<App>>, Json(wanted): Json<Wanted>) -> Answer {
    app.holder
        .check(&wanted.page, app.board.command_timeout())
        .map_err(|why| Refused(StatusCode::CONFLICT, why.to_string()))?;
    let folder = app.folder.place(&wanted.name)?;
    if wanted.name.contains('/') {
        return Err("an experiment's name has no `/`".to_owned().into());
    }
    let series = match wanted.runs {
        None => Series::resume(&folder, None),
        Some(runs) => {
            if runs.is_empty() || runs.len() > PLANNED {
                return Err(format!("a plan has 1 to {PLANNED} runs").into());
            }
            Series::begin(&folder, runs)
        }
    };
    let series = series.map_err(|error| error.to_string())?;
    command(&app, &wanted.page, Order::Series(Box::new(Task { name: wanted.name, series }))).await
}
