//! What can be asked of the server over HTTP. Whatever changes anything is a POST of JSON; whatever may move the motor, or
//! change how it moves, is asked for by the page that holds it. A stop is anybody's.

use super::answer::{Answer, Refused, answered, command, conflict, in_force};
use super::assets::ASSETS;
use super::door::{self, refusal};
use super::owner::Command;
use super::request::Run;
use super::settings::settings;
use super::{App, model, runs, stream, studies, sweep, sweeping};
use crate::configuration::{difference, overlay, to_toml};
use crate::tune::margins::refuse_unstable;
use axum::extract::{DefaultBodyLimit, State};
use axum::http::StatusCode;
use axum::middleware::from_fn_with_state;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use serde::Deserialize;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;

/// Longest body of a request, bytes: notes, and a configuration many times over.
const LONGEST_BODY: usize = 64 << 10;
/// A stop that the board takes is seen to be one within this time (`link::stopping`), or is given up.
const STOPPING: Duration = Duration::from_secs(15);
/// Everything there is to ask for.
pub fn router(app: Arc<App>) -> Router {
    let mut router = Router::new()
        .route("/api/login", post(door::login))
        .route("/api/stream", get(stream::open))
        .route("/api/state", get(state))
        .route("/api/stop", post(stop))
        .route("/api/take", post(take))
        .route("/api/release", post(release))
        .route("/api/clear", post(clear))
        .route("/api/arm", post(arm))
        .route("/api/align", post(align))
        .route("/api/run", post(run))
        .route("/api/configuration", get(configuration).post(configure))
        .route("/api/configuration/check", post(check))
        .merge(model::routes())
        .merge(runs::routes())
        .merge(studies::routes())
        .merge(sweep::routes())
        .merge(sweeping::routes());
    for asset in &ASSETS {
        router = router.route(asset.path, get(move || async move { asset }));
    }
    router
        .fallback(|| async { refusal(StatusCode::NOT_FOUND, "there is no such page") })
        .layer(DefaultBodyLimit::max(LONGEST_BODY))
        .layer(from_fn_with_state(Arc::clone(&app), door::watch))
        .with_state(app)
}

/// The page that asks, by the name that its stream began with.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Page {
    page: String,
}

/// A page and what it sends.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Asked<T> {
    page: String,
    what: T,
}

async fn state(State(app): State<Arc<App>>) -> Response {
    Json(app.board.state()).into_response()
}

async fn stop(State(app): State<Arc<App>>, Json(Nothing {}): Json<Nothing>) -> Answer {
    stop_all(&app).await
}

/// Stops the motor, and a sweep.
async fn stop_all(app: &App) -> Answer {
    let is_sweeping = app.owner.has_aside();
    let motor = answered(app.owner.stop(), STOPPING).await;
    if !is_sweeping {
        return motor;
    }
    match (motor, sweeping::ended(app).await) {
        (Ok(_), Ok(swept)) => Ok(Json(json!({ "stopped": true, "sweep": swept }))),
        (Ok(_), Err(generator)) => Err(generator),
        (Err(Refused(status, why)), Ok(swept) | Err(Refused(_, swept))) => {
            Err(Refused(status, format!("{swept}. {why}")))
        }
    }
}

/// An empty object.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Nothing {}

async fn take(State(app): State<Arc<App>>, Json(Page { page }): Json<Page>) -> Answer {
    let pages_own = page.len() == 32 && page.bytes().all(|byte| byte.is_ascii_hexdigit());
    if !pages_own || !app.has_page(&page) {
        return Err(conflict(super::holder::HeldError::Unknown));
    }
    app.holder.take(&page, app.board.is_at_work(), app.board.command_timeout()).map_err(conflict)?;
    app.board.say("a page has taken the motor");
    Ok(Json(json!({ "held": true })))
}

async fn release(State(app): State<Arc<App>>, Json(Page { page }): Json<Page>) -> Answer {
    if !app.holder.release(&page) {
        return Err(conflict(super::holder::HeldError::NotHolder));
    }
    app.board.say("the page has given the motor back");
    if app.board.is_at_work() {
        return stop_all(&app).await;
    }
    Ok(Json(json!({ "held": false })))
}

async fn clear(State(app): State<Arc<App>>, Json(Page { page }): Json<Page>) -> Answer {
    command(&app, &page, Command::Clear).await
}

async fn arm(State(app): State<Arc<App>>, Json(Page { page }): Json<Page>) -> Answer {
    command(&app, &page, Command::Arm).await
}

async fn align(State(app): State<Arc<App>>, Json(Page { page }): Json<Page>) -> Answer {
    command(&app, &page, Command::Align).await
}

async fn run(State(app): State<Arc<App>>, Json(Asked { page, what }): Json<Asked<Run>>) -> Answer {
    app.holder.check(&page, app.board.command_timeout()).map_err(conflict)?;
    let edges_per_rev = in_force(&app).edges_per_rev;
    let action = what.action(edges_per_rev)?;
    let recording = app.folder.next(what.word());
    let name = recording.file_name().map(|name| name.to_string_lossy().into_owned());
    _ = command(&app, &page, Command::Run { action, what: what.word().to_owned(), recording }).await?;
    Ok(Json(json!({ "accepted": true, "recording": name })))
}

async fn configuration(State(app): State<Arc<App>>) -> Answer {
    let own = in_force(&app);
    Ok(Json(json!({
        "configured": app.board.configuration().is_some(),
        "rows": settings(&own),
        "toml": to_toml(&own),
    })))
}

/// A configuration as TOML; what is left out stays as the board has it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Text {
    toml: String,
}

async fn check(State(app): State<Arc<App>>, Json(Text { toml }): Json<Text>) -> Answer {
    let own = in_force(&app);
    let wanted = overlay(&own, &toml).map_err(|error| error.to_string())?;
    let differs: Vec<Value> = difference(&own, &wanted)
        .into_iter()
        .map(|(key, board, wanted)| json!({ "key": key, "board": board, "wanted": wanted }))
        .collect();
    Ok(Json(json!({ "rows": settings(&wanted), "differs": differs, "toml": to_toml(&wanted) })))
}

/// The same, to be given to the board.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Wanted {
    toml: String,
    /// Also a controller that is unstable in the model.
    #[serde(default)]
    allow_unstable: bool,
}

async fn configure(State(app): State<Arc<App>>, Json(Asked { page, what }): Json<Asked<Wanted>>) -> Answer {
    app.holder.check(&page, app.board.command_timeout()).map_err(conflict)?;
    let own = in_force(&app);
    let wanted = overlay(&own, &what.toml).map_err(|error| error.to_string())?;
    if !what.allow_unstable {
        let readings = Arc::clone(&app.readings);
        let held = tokio::task::spawn_blocking(move || refuse_unstable(&wanted, &readings)).await;
        held.map_err(conflict)?.map_err(|refused| format!("{refused}; `allow unstable` takes it all the same"))?;
    }
    _ = command(&app, &page, Command::Configure(Box::new(wanted))).await?;
    let keys: Vec<String> =
        difference(&own, &wanted).into_iter().map(|(key, _, new)| format!("{key} = {new}")).collect();
    app.board.say(format!(
        "the board is configured: {}",
        if keys.is_empty() { "as before".to_owned() } else { keys.join(", ") }
    ));
    Ok(Json(json!({ "changed": keys })))
}
