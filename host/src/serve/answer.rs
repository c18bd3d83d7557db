//! What the routes answer with, and how they hand something over to the thread that owns the port.

use super::App;
use super::door::refusal;
use super::owner::Command;
use axum::Json;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde_json::Value;
use std::path::Path;
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::time::timeout;
use twum_shared::message::Configuration;
use twum_shared::step::ConfigSpec;

/// What takes no time is answered within this time, or the port is away.
const ANSWER: Duration = Duration::from_secs(8);

/// What every route answers with: JSON, or why not.
pub type Answer = Result<Json<Value>, Refused>;

/// A refusal in a sentence.
pub struct Refused(pub StatusCode, pub String);

impl IntoResponse for Refused {
    fn into_response(self) -> Response {
        refusal(self.0, self.1)
    }
}

impl From<String> for Refused {
    fn from(why: String) -> Self {
        Self(StatusCode::BAD_REQUEST, why)
    }
}

/// A refusal for the state that things are in.
pub fn conflict(why: impl ToString) -> Refused {
    Refused(StatusCode::CONFLICT, why.to_string())
}

/// What the thread that owns the port says, within so long.
///
/// # Errors
/// Its refusal, or no answer.
pub async fn answered(answer: oneshot::Receiver<Result<Value, String>>, patience: Duration) -> Answer {
    match timeout(patience, answer).await {
        Ok(Ok(Ok(value))) => Ok(Json(value)),
        Ok(Ok(Err(why))) => Err(conflict(why)),
        Ok(Err(_)) => Err(Refused(StatusCode::SERVICE_UNAVAILABLE, "the server is ending".to_owned())),
        Err(_) => {
            Err(Refused(StatusCode::GATEWAY_TIMEOUT, "the board has not answered yet: look at its state".to_owned()))
        }
    }
}

/// Hands something over for the page that holds the motor.
///
/// # Errors
/// Another page holds it, or as [`answered`].
pub async fn command(app: &App, page: &str, command: Command) -> Answer {
    app.holder.check(page, app.board.command_timeout()).map_err(conflict)?;
    let answer = app.owner.ask(command).map_err(conflict)?;
    answered(answer, ANSWER).await
}

/// The board's configuration; the default where it has none.
pub fn in_force(app: &App) -> Configuration {
    app.board.configuration().unwrap_or(Configuration::with_control(ConfigSpec::DEFAULT))
}

/// The name of a place in messages: its last part.
pub fn last_part(path: &Path) -> String {
    path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}
