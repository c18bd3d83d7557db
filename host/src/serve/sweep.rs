//! A stator's sweep while it is made: what is in its file so far, as Nyquist and Bode plots.

use super::App;
use super::answer::Answer;
use crate::identify::follow::Following;
use crate::identify::read::Shunt;
use crate::report::identified::figures;
use axum::extract::{Query, State};
use axum::routing::get;
use axum::{Json, Router};
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// Sweeps whose points are kept: pages may look at different ones.
const KEPT: usize = 4;
/// Points of a line: the longest sweep that is usual, the thesis's, has 2001.
const POINTS: usize = 4_000;

/// What can be asked of sweeps.
pub fn routes() -> Router<Arc<App>> {
    Router::new().route("/api/sweep", get(so_far))
}

/// The sweeps that are looked at.
#[derive(Default)]
pub struct Sweeps {
    followed: Mutex<VecDeque<Followed>>,
}

struct Followed {
    path: PathBuf,
    shunt_ohm: f64,
    following: Following,
}

impl Sweeps {
    fn so_far(&self, path: &Path, shunt_ohm: f64) -> Result<Value, String> {
        let mut followed = self.followed.lock().expect("nothing panics while it holds the sweeps");
        let known = followed.iter().position(|it| it.path == path && it.shunt_ohm == shunt_ohm);
        let mut it = known.and_then(|at| followed.remove(at)).unwrap_or_else(|| Followed {
            path: path.to_owned(),
            shunt_ohm,
            following: Following::new(path, shunt_ohm, Shunt::High),
        });
        it.following.advance().map_err(|error| error.to_string())?;
        let (taken, planned) = (it.following.points().len() + it.following.unreadable(), it.following.planned());
        let found = json!({
            "taken": taken,
            "planned": planned,
            "unreadable": it.following.unreadable(),
            "figure": figures::swept(it.following.points()).interactive(POINTS),
        });
        followed.truncate(KEPT - 1);
        followed.push_front(it);
        Ok(found)
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Asked {
    run: String,
    shunt_ohm: f64,
}

async fn so_far(State(app): State<Arc<App>>, Query(asked): Query<Asked>) -> Answer {
    let path = app.folder.existing(&asked.run)?;
    if !(asked.shunt_ohm.is_finite() && asked.shunt_ohm > 0.0) {
        return Err(format!("a shunt of {} ohm cannot be", asked.shunt_ohm).into());
    }
    let read = tokio::task::spawn_blocking(move || app.sweeps.so_far(&path, asked.shunt_ohm)).await;
    let read = read.unwrap_or_else(|_| Err("the sweep could not be read; the server's terminal says more".to_owned()));
    read.map(Json).map_err(Into::into)
}
