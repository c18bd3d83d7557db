//! Who comes in: told by the `Host` that was asked for, the `Origin` it is asked from, and, where the server listens beyond
//! this machine, the token.
//!
//! A page of somebody else's that is open in a browser here may send requests to this machine. It cannot set these headers,
//! and a name that was bound to this machine's address after the fact (DNS rebinding) is none that is let in.

use super::App;
use crate::origin;
use axum::Json;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::header::{AUTHORIZATION, CONTENT_TYPE, COOKIE, HOST, ORIGIN, SET_COOKIE};
use axum::http::{HeaderMap, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::json;
use std::net::IpAddr;
use std::sync::Arc;

/// The cookie that carries the token.
const COOKIE_NAME: &str = "twum";

/// What is asked of whoever comes in.
pub struct Door {
    /// The name in `--listen`, if it is one.
    name: Option<String>,
    /// Whether only this machine is served.
    is_loopback: bool,
    token: Option<String>,
}

impl Door {
    /// The door of a server that was told to listen at `asked`, a name or an address without its port, and does so on loopback
    /// or beyond.
    pub fn new(asked: &str, is_loopback: bool) -> Self {
        let name = asked.parse::<IpAddr>().is_err().then(|| asked.to_ascii_lowercase());
        Self { name, is_loopback, token: (!is_loopback).then(secret) }
    }

    /// The token, where one is asked for.
    pub fn token(&self) -> Option<&str> {
        self.token.as_deref()
    }

    /// Whether a `Host` is one of this server's own names. Nobody can bind an address, so addresses are.
    fn knows(&self, host: &str) -> bool {
        let name = origin::name_of(host);
        let is_address = name.parse::<IpAddr>().is_ok();
        origin::is_this_machine(&name) || (is_address && !self.is_loopback) || self.name.as_ref() == Some(&name)
    }

    /// Why a request is not let in.
    fn refuses(&self, method: &Method, path: &str, headers: &HeaderMap) -> Option<(StatusCode, &'static str)> {
        let mut hosts = headers.get_all(HOST).iter();
        let host = hosts.next().and_then(|host| host.to_str().ok());
        let Some(host) = host.filter(|host| hosts.next().is_none() && self.knows(host)) else {
            return Some((
                StatusCode::FORBIDDEN,
                "this server goes by its address, or by the name it was told to listen at",
            ));
        };
        let own = |origin: &str| origin::host_of(origin).is_some_and(|there| there.eq_ignore_ascii_case(host));
        if !headers.get_all(ORIGIN).iter().all(|origin| origin.to_str().is_ok_and(own)) {
            return Some((StatusCode::FORBIDDEN, "pages of other origins are not let in"));
        }
        if method == Method::POST {
            let kind = headers.get(CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or_default();
            if kind.split(';').next().map(str::trim) != Some("application/json") {
                return Some((StatusCode::UNSUPPORTED_MEDIA_TYPE, "what is sent is JSON, as application/json"));
            }
        }
        let is_open = !path.starts_with("/api/") || path == "/api/login";
        match &self.token {
            Some(token) if !is_open && !shown(headers).any(|it| is_same(&it, token)) => Some((
                StatusCode::UNAUTHORIZED,
                "the token is missing or wrong: open the address that the server printed",
            )),
            _ => None,
        }
    }
}

/// 128 bits that nobody guesses, in hexadecimal digits.
pub fn secret() -> String {
    format!("{:032x}", rand::random::<u128>())
}

/// The tokens that a request shows.
fn shown(headers: &HeaderMap) -> impl Iterator<Item = String> {
    let bearer = headers.get(AUTHORIZATION).and_then(|it| it.to_str().ok()?.strip_prefix("Bearer ").map(str::to_owned));
    let cookies = headers.get_all(COOKIE).iter().filter_map(|it| it.to_str().ok()).flat_map(|it| it.split(';'));
    let cookies: Vec<String> = cookies
        .filter_map(|pair| pair.trim().split_once('=').filter(|(name, _)| *name == COOKIE_NAME))
        .map(|(_, value)| value.to_owned())
        .collect();
    bearer.into_iter().chain(cookies)
}

/// Compares in a time that depends on the lengths only.
fn is_same(one: &str, other: &str) -> bool {
    let differ = one.bytes().zip(other.bytes()).fold(0, |differ, (a, b)| differ | (a ^ b));
    one.len() == other.len() && std::hint::black_box(differ) == 0
}

/// A refusal, in a sentence.
pub fn refusal(status: StatusCode, why: impl Into<String>) -> Response {
    (status, Json(json!({ "error": why.into() }))).into_response()
}

/// Lets requests in or not, and says of every answer what a browser may do with it.
pub async fn watch(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let refused = app.door.refuses(request.method(), request.uri().path(), request.headers());
    let mut response = match refused {
        Some((status, why)) => refusal(status, why),
        None => next.run(request).await,
    };
    let headers = response.headers_mut();
    let mut say = |name: &'static str, value: &'static str| {
        headers.entry(name).or_insert(value.parse().expect("these are plain text"));
    };
    say(
        "content-security-policy",
        "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; form-action 'none'; base-uri 'none'",
    );
    say("x-content-type-options", "nosniff");
    say("referrer-policy", "no-referrer");
    say("cache-control", "no-store");
    say("cross-origin-resource-policy", "same-origin");
    response
}

/// The token, as a page found it in its address.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Login {
    token: String,
}

/// Takes the token and gives it back as a cookie, which no script reads and no other site sends.
pub async fn login(State(app): State<Arc<App>>, Json(login): Json<Login>) -> Response {
    match app.door.token() {
        Some(token) if !is_same(&login.token, token) => refusal(StatusCode::UNAUTHORIZED, "the token is wrong"),
        _ => {
            let cookie =
                format!("{COOKIE_NAME}={}; HttpOnly; SameSite=Strict; Path=/", app.door.token().unwrap_or_default());
            Response::builder().header(SET_COOKIE, cookie).body(Body::from("{}")).expect("a token is plain text")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(pairs: &[(&'static str, &str)]) -> HeaderMap {
        pairs
            .iter()
            .map(|(name, value)| (name.parse().unwrap(), value.parse().unwrap()))
            .collect::<Vec<_>>()
            .into_iter()
            .fold(HeaderMap::new(), |mut map, (name, value): (axum::http::HeaderName, axum::http::HeaderValue)| {
                map.append(name, value);
                map
            })
    }

    #[test]
    fn strange_pages_and_names_are_not_let_in() {
        let door = Door::new("127.0.0.1", true);
        for (pairs, welcome) in [
            (&[("host", "127.0.0.1:8080")][..], true),
            (&[("host", "localhost:8080"), ("origin", "http://localhost:8080")], true),
            (&[("host", "[::1]:8080")], true),
            (&[("host", "127.0.0.1:8080"), ("origin", "http://localhost:8080")], false),
            (&[("host", "127.0.0.1:8080"), ("origin", "http://127.0.0.1:9090")], false),
            (&[("host", "127.0.0.1:8080"), ("origin", "https://example.org")], false),
            (&[("host", "127.0.0.1:8080"), ("origin", "null")], false),
            (&[("host", "rebound.example.org:8080")], false),
            (&[("host", "127.0.0.1.example.org")], false),
            (&[("host", "192.0.2.7:8080")], false),
            (&[("host", "127.0.0.1"), ("host", "example.org")], false),
            (&[("host", "")], false),
            (&[], false),
        ] {
            let refused = door.refuses(&Method::GET, "/api/state", &headers(pairs));
            assert_eq!(refused.is_none(), welcome, "{pairs:?}: {refused:?}");
        }
    }

    #[test]
    fn beyond_this_machine_a_token_is_asked_for() {
        let door = Door::new("bench.example.org", false);
        let token = door.token().unwrap().to_owned();
        assert_eq!(token.len(), 32);
        let asks = |path: &str, pairs: &[(&'static str, &str)]| {
            let mut all = vec![("host", "bench.example.org:8080")];
            all.extend(pairs);
            door.refuses(&Method::GET, path, &headers(&all)).map(|(status, _)| status.as_u16())
        };
        assert_eq!(asks("/", &[]), None, "the page itself says nothing");
        assert_eq!(asks("/api/state", &[]), Some(401));
        assert_eq!(asks("/api/state", &[("authorization", &format!("Bearer {token}"))]), None);
        assert_eq!(asks("/api/state", &[("cookie", &format!("a=b; twum={token}"))]), None);
        for wrong in ["", &token[1..], &format!("{token}0"), &token.replace(&token[..1], "g")] {
            assert_eq!(asks("/api/state", &[("cookie", &format!("twum={wrong}"))]), Some(401), "{wrong}");
        }
    }

    #[test]
    fn only_json_changes_anything() {
        let door = Door::new("localhost", true);
        for (kind, taken) in
            [("application/json", true), ("application/json; charset=utf-8", true), ("text/plain", false)]
        {
            let sent = headers(&[("host", "localhost"), ("content-type", kind)]);
            assert_eq!(door.refuses(&Method::POST, "/api/stop", &sent).is_none(), taken, "{kind}");
        }
        assert!(door.refuses(&Method::POST, "/api/stop", &headers(&[("host", "localhost")])).is_some());
    }
}
