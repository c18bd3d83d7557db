//! Recorded runs: their list, figures, plots, replay, and the notes beside them. Whatever reads a recording does so on a thread
//! of its own, one at a time.

use super::App;
use super::answer::{Answer, Refused, last_part};
use super::folder::NOTES;
use crate::compare::replay::replay_recording;
use crate::plot::{measurement_figure, recording_figure, timing_panel};
use crate::record::load::load_runs;
use crate::record::store::Reader;
use crate::report::figure::Figure;
use crate::report::run::RunFigures;
use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::routing::get;
use axum::{Json, Router};
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Arc;
use tokio::sync::Mutex;

/// Points of each line of a plot: more than a screen shows.
const POINTS: usize = 8_000;

/// One reader at a time: memory stays that of one recording, and the port's thread keeps its share of the machine.
static READING: Mutex<()> = Mutex::const_new(());

/// What can be asked of runs.
pub fn routes() -> Router<Arc<App>> {
    Router::new()
        .route("/api/runs", get(list))
        .route("/api/run/figures", get(figures))
        .route("/api/run/plots", get(plots))
        .route("/api/run/replay", get(replay))
        .route("/api/run/notes", get(notes).post(write_notes))
}

/// Which run.
#[derive(Deserialize)]
struct Which {
    run: String,
    /// Another to draw over it.
    with: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Notes {
    run: String,
    text: String,
}

async fn reading(what: impl FnOnce() -> Result<Value, String> + Send + 'static) -> Answer {
    let _turn = READING.lock().await;
    match tokio::task::spawn_blocking(what).await {
        Ok(Ok(value)) => Ok(Json(value)),
        Ok(Err(why)) => Err(Refused(StatusCode::UNPROCESSABLE_ENTITY, why)),
        Err(_) => Err(Refused(
            StatusCode::INTERNAL_SERVER_ERROR,
            "reading it failed; the server's terminal says more".to_owned(),
        )),
    }
}

async fn list(State(app): State<Arc<App>>) -> Answer {
    reading(move || Ok(json!({ "runs": app.folder.list(), "folder": app.folder.root() }))).await
}

async fn figures(State(app): State<Arc<App>>, Query(which): Query<Which>) -> Answer {
    let path = app.folder.existing(&which.run)?;
    reading(move || {
        let about = Reader::open(&path).ok().map(|reader| {
            let about = reader.metadata();
            json!({ "chip": about.chip, "firmware": about.firmware_version, "start_unix_ns": about.start_ns.to_string() })
        });
        let (measurement, notes) = load_runs(&path).map_err(|error| error.to_string())?;
        // A run too short to say anything of still has its frames.
        let found = RunFigures::of(&measurement).map_err(|error| error.to_string())?;
        Ok(json!({
            "about": about,
            "words": found.as_ref().map(ToString::to_string),
            "warnings": found.as_ref().map(RunFigures::warnings),
            "figures": found,
            "losses": notes,
        }))
    })
    .await
}

fn figure(path: &Path) -> Result<(Figure, Vec<String>), String> {
    if path.is_dir() {
        let (measurement, notes) = load_runs(path).map_err(|error| error.to_string())?;
        return Ok((measurement_figure(&measurement, None).map_err(|error| error.to_string())?, notes));
    }
    let (drawn, losses) = recording_figure(path, "").map_err(|error| error.to_string())?;
    let timing = timing_panel(path).map_err(|error| error.to_string())?;
    Ok((timing.into_iter().fold(drawn, Figure::panel), losses))
}

async fn plots(State(app): State<Arc<App>>, Query(which): Query<Which>) -> Answer {
    let path = app.folder.existing(&which.run)?;
    let with = which.with.map(|name| app.folder.existing(&name)).transpose()?;
    reading(move || {
        let (mut drawn, mut losses) = figure(&path)?;
        if let Some(with) = with {
            let (other, more) = figure(&with)?;
            drawn = drawn.over(&last_part(&path.with_extension("")), other, &last_part(&with.with_extension("")));
            losses.extend(more);
        }
        Ok(json!({ "figure": drawn.interactive(POINTS), "losses": losses }))
    })
    .await
}

async fn replay(State(app): State<Arc<App>>, Query(which): Query<Which>) -> Answer {
    let path = app.folder.existing(&which.run)?;
    reading(move || {
        let found = replay_recording(&path).map_err(|error| error.to_string())?;
        Ok(json!({ "exact": found.replay.is_exact(), "found": found }))
    })
    .await
}

async fn notes(State(app): State<Arc<App>>, Query(which): Query<Which>) -> Answer {
    Ok(Json(json!({ "text": app.folder.notes(&which.run)?, "most": NOTES })))
}

async fn write_notes(State(app): State<Arc<App>>, Json(Notes { run, text }): Json<Notes>) -> Answer {
    reading(move || app.folder.write_notes(&run, &text).map(|()| json!({ "kept": true }))).await
}
