//! The stream to a page: what the board says, as soon as it says it, and the page's answers.
//!
//! Each page reads at its own pace. What it does not take in time it finds in the next message or not at all; nobody waits
//! for it, and nothing is kept for it beyond the ten minutes that are kept for all.

use super::App;
use super::board::{Cursor, News};
use super::door::{refusal, secret};
use axum::extract::State;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use tokio::time::timeout;

/// Pages at once.
const PAGES: usize = 64;
/// Longest message of a page, bytes: `{"beat":18446744073709551615}` fits twice.
const LONGEST: usize = 64;
/// A page hears something at least this often, so that it can answer: well inside the shortest sensible command timeout.
const AT_LEAST: Duration = Duration::from_millis(100);
/// A page that takes nothing for so long is gone.
const PATIENCE: Duration = Duration::from_secs(5);
/// Messages whose answers are waited for: some seconds of them.
const UNANSWERED: usize = 128;

#[derive(Serialize)]
struct ToPage<'a> {
    /// To be sent back as soon as it is shown.
    beat: u64,
    /// This page's name, in its first message.
    #[serde(skip_serializing_if = "Option::is_none")]
    page: Option<&'a str>,
    /// Who holds the motor.
    holder: &'static str,
    #[serde(flatten)]
    news: News,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FromPage {
    beat: u64,
}

/// Opens a stream.
pub async fn open(State(app): State<Arc<App>>, upgrade: WebSocketUpgrade) -> Response {
    if app.pages.fetch_add(1, Ordering::Relaxed) >= PAGES {
        app.pages.fetch_sub(1, Ordering::Relaxed);
        return refusal(StatusCode::SERVICE_UNAVAILABLE, format!("{PAGES} pages are open: close one"));
    }
    let count = Counted(Arc::clone(&app));
    upgrade.max_message_size(LONGEST).max_frame_size(LONGEST).on_upgrade(move |socket| async move {
        follow(socket, &count.0).await;
    })
}

/// Counts a page for as long as it lives, whether or not it ever came to a stream.
struct Counted(Arc<App>);

impl Drop for Counted {
    fn drop(&mut self) {
        self.0.pages.fetch_sub(1, Ordering::Relaxed);
    }
}

async fn follow(mut socket: WebSocket, app: &App) {
    let page = secret();
    app.enter(&page);
    talk(&mut socket, app, &page).await;
    app.leave(&page);
}

async fn talk(socket: &mut WebSocket, app: &App, page: &str) {
    let (mut cursor, mut changes) = (Cursor::default(), app.board.changes());
    let mut sent: VecDeque<(u64, Instant)> = VecDeque::new();
    for beat in 0.. {
        changes.mark_unchanged();
        let message = ToPage {
            beat,
            page: (beat == 0).then_some(page),
            holder: app.holder.of(page),
            news: app.board.news(&mut cursor),
        };
        let text = serde_json::to_string(&message).expect("numbers and strings always serialise");
        sent.push_back((beat, Instant::now()));
        if sent.len() > UNANSWERED {
            sent.pop_front();
        }
        if !matches!(timeout(PATIENCE, socket.send(Message::Text(text.into()))).await, Ok(Ok(()))) {
            return;
        }
        if !listen(socket, app, page, &mut sent, &mut changes).await {
            return;
        }
    }
}

/// Takes answers until there is something new to send; whether the page is still there.
async fn listen(
    socket: &mut WebSocket,
    app: &App,
    page: &str,
    sent: &mut VecDeque<(u64, Instant)>,
    changes: &mut tokio::sync::watch::Receiver<u64>,
) -> bool {
    let until = tokio::time::Instant::now() + AT_LEAST;
    loop {
        tokio::select! {
            received = socket.recv() => match received {
                Some(Ok(Message::Text(text))) => {
                    let Ok(FromPage { beat }) = serde_json::from_str(&text) else { return false };
                    if let Some(at) = sent.iter().find(|(number, _)| *number == beat).map(|(_, at)| *at) {
                        app.holder.beat(page, at, app.board.command_timeout());
                        sent.retain(|(number, _)| *number > beat);
                    }
                }
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
                _ => return false,
            },
            changed = changes.changed() => return changed.is_ok(),
            () = tokio::time::sleep_until(until) => return true,
        }
    }
}
