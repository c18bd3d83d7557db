//! The page itself, inside the binary: nothing is built, and nothing is loaded from a network.

use crate::report::page::SHARED;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};

/// A file of the page.
pub struct Asset {
    /// Where it is asked for.
    pub path: &'static str,
    kind: &'static str,
    text: &'static str,
}

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

macro_rules! own {
    ($path:literal, $kind:expr, $file:literal) => {
        Asset { path: $path, kind: $kind, text: include_str!(concat!("../../templates/serve/", $file)) }
    };
}

/// Every file; the look and the plots are those of the reports.
pub const ASSETS: [Asset; 16] = [
    own!("/", HTML, "index.html"),
    own!("/serve.css", CSS, "serve.css"),
    own!("/main.js", SCRIPT, "main.js"),
    own!("/talk.js", SCRIPT, "talk.js"),
    own!("/parts.js", SCRIPT, "parts.js"),
    own!("/bench.js", SCRIPT, "bench.js"),
    own!("/live.js", SCRIPT, "live.js"),
    own!("/settings.js", SCRIPT, "settings.js"),
    own!("/model.js", SCRIPT, "model.js"),
    own!("/runs.js", SCRIPT, "runs.js"),
    own!("/studies.js", SCRIPT, "studies.js"),
    own!("/sweep.js", SCRIPT, "sweep.js"),
    Asset { path: "/look.css", kind: CSS, text: SHARED.look },
    Asset { path: "/plots.js", kind: SCRIPT, text: SHARED.plots },
    Asset { path: "/uplot.css", kind: CSS, text: SHARED.plot_style },
    Asset { path: "/uplot.js", kind: SCRIPT, text: SHARED.plot_library },
];

impl IntoResponse for &Asset {
    fn into_response(self) -> Response {
        ([(CONTENT_TYPE, self.kind)], self.text).into_response()
    }
}
