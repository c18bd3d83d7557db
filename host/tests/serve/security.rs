//! Who does not come in, and what does not crash it.

use super::page::Page;
use super::served::Served;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use std::time::Duration;

const JSON: &str = "Content-Type: application/json";

/// What changes anything.
const CHANGES: [&str; 15] = [
    "/api/login",
    "/api/stop",
    "/api/take",
    "/api/release",
    "/api/clear",
    "/api/arm",
    "/api/align",
    "/api/run",
    "/api/configuration",
    "/api/run/notes",
    "/api/study",
    "/api/study/cancel",
    "/api/experiment/plan",
    "/api/experiment/run",
    "/api/sweep/run",
];

#[test]
fn what_is_not_meant_is_refused_and_moves_nothing() {
    let served = Served::sim();
    served.until("the board answers", |state| state["connected"] == true);
    let page = Page::open(&served);
    page.take();
    let run = json!({ "page": page.name(), "what": { "kind": "speed", "duty": 1, "direction": "cw", "seconds": 5 } })
        .to_string();
    let host = format!("Host: {}", served.address);
    let long = "x".repeat(70_000);
    type Row<'a> = (&'a str, &'a str, &'a str, Vec<&'a str>, &'a str, u16);
    let table: [Row<'_>; 17] = [
        ("another origin", "POST", "/api/run", vec![JSON, "Origin: https://example.org"], &run, 403),
        ("no origin at all, as a file", "POST", "/api/run", vec![JSON, "Origin: null"], &run, 403),
        ("another port's page", "POST", "/api/run", vec![JSON, "Origin: http://127.0.0.1:1"], &run, 403),
        ("a name bound to this address", "POST", "/api/run", vec![JSON, "Host: rebound.example.org"], &run, 403),
        ("two hosts", "POST", "/api/run", vec![JSON, &host, "Host: example.org"], &run, 403),
        ("a form", "POST", "/api/run", vec!["Content-Type: application/x-www-form-urlencoded"], &run, 415),
        ("plain text", "POST", "/api/run", vec!["Content-Type: text/plain"], &run, 415),
        ("no type", "POST", "/api/stop", vec![], "{}", 415),
        ("a page that holds nothing", "POST", "/api/run", vec![JSON], &run.replace(&page.name(), &"0".repeat(32)), 409),
        ("keys nobody knows", "POST", "/api/run", vec![JSON], &run.replace("\"kind\"", "\"force\":1,\"kind\""), 422),
        ("a body that is too long", "POST", "/api/run/notes", vec![JSON], &long, 413),
        ("a path out of the folder", "GET", "/api/run/figures?run=../secret.mcap", vec![], "", 400),
        ("the same, encoded", "GET", "/api/run/plots?run=%2e%2e%2fsecret.mcap", vec![], "", 400),
        ("an absolute path", "GET", "/api/run/replay?run=/etc/passwd", vec![], "", 400),
        ("a path to study", "POST", "/api/study", vec![JSON], r#"{"kind":"compare","run":"../../etc/passwd"}"#, 409),
        ("an option to study", "POST", "/api/study", vec![JSON], r#"{"kind":"compare","run":"--report"}"#, 409),
        (
            "a stream of another origin",
            "GET",
            "/api/stream",
            vec!["Origin: https://example.org", "Upgrade: websocket"],
            "",
            403,
        ),
    ];
    std::fs::write(served.folder.path().join("secret.mcap"), "secret").unwrap();
    for (what, method, path, head, body, status) in table {
        let (got, answer) = served.request(method, path, &head, body);
        println!("{what:30} {method} {path}: {got}");
        assert_eq!(got, status, "{what}: {answer}");
        assert!(!answer.contains("secret.mcap\"") && !answer.contains("root:"), "{what}: {answer}");
    }
    for path in CHANGES {
        let (status, _) = served.request("GET", path, &[JSON], "");
        assert!(path == "/api/configuration" || path == "/api/run/notes" || status == 405, "GET {path}: {status}");
    }
    let state = served.state();
    assert_eq!((&state["is_off"], &state["mode"]), (&json!(true), &json!("Idle")), "{state}");
    assert_eq!(std::fs::read_dir(served.runs()).unwrap().count(), 0, "nothing was recorded or written");
}

#[test]
fn beyond_this_machine_nothing_is_told_without_the_token() {
    let served = Served::start("sim", "0.0.0.0:0", "");
    assert_eq!(served.token.as_ref().map(String::len), Some(32));
    for path in
        ["/api/state", "/api/runs", "/api/configuration", "/api/stream", "/api/studies", "/api/study/page?study=1"]
    {
        assert_eq!(served.request("GET", path, &[], "").0, 401, "{path}");
        assert_eq!(
            served.request("GET", path, &["Cookie: twum=00000000000000000000000000000000"], "").0,
            401,
            "{path}"
        );
    }
    for path in CHANGES.iter().filter(|path| **path != "/api/login") {
        assert_eq!(served.request("POST", path, &[JSON], "{}").0, 401, "{path}");
    }
    assert_eq!(served.request("POST", "/api/login", &[JSON], r#"{"token":"00"}"#).0, 401);
    let token = served.token.clone().unwrap();
    let login = format!(
        "POST /api/login HTTP/1.1\r\nHost: {}\r\n{JSON}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        served.address,
        token.len() + 12
    );
    let answer = served.raw(format!("{login}{{\"token\":\"{token}\"}}").as_bytes(), Duration::from_secs(30));
    assert!(answer.contains(&format!("set-cookie: twum={token}; HttpOnly; SameSite=Strict")), "{answer}");
    assert_eq!(served.request("GET", "/api/state", &[&format!("Cookie: twum={token}")], "").0, 200);
    // The page itself is for everybody, and says nothing.
    assert_eq!(served.request("GET", "/", &[], "").0, 200);
    let page = Page::open(&served);
    page.take();
}

/// Requests on their way at once: a divisor of 10 000.
const THREADS: u64 = 16;

fn mutated(seed: &[u8], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..rng.random_range(1..6) {
        let at = rng.random_range(0..bytes.len());
        match rng.random_range(0..4) {
            0 => bytes[at] = rng.random(),
            1 => drop(bytes.splice(at..at, (0..rng.random_range(1..40)).map(|_| b'9').collect::<Vec<u8>>())),
            2 => drop(bytes.drain(at..(at + rng.random_range(1..20)).min(bytes.len()))),
            _ => bytes.truncate(at.max(1)),
        }
        if bytes.is_empty() {
            bytes.push(0);
        }
    }
    bytes
}

/// 10 000 requests of the page, each with something of it changed; none of them comes from the page that holds the motor.
#[test]
fn ten_thousand_mutated_requests_neither_move_the_motor_nor_crash_the_server() {
    let served = Served::sim();
    served.until("the board answers", |state| state["connected"] == true);
    let seeds: Vec<Vec<u8>> = CHANGES
        .iter()
        .map(|path| {
            let body = r#"{"page":"00000000000000000000000000000000","what":{"kind":"speed","duty":0.5,"direction":"cw","seconds":5}}"#;
            format!(
                "POST {path} HTTP/1.1\r\nHost: {}\r\n{JSON}\r\nConnection: close\r\nContent-Length: {}\r\n\r\n{body}",
                served.address,
                body.len()
            )
        })
        .chain(["/api/runs", "/api/run/plots?run=a.mcap", "/api/stream", "/", "/api/study/page?study=1"].map(|path| {
            format!(
                "GET {path} HTTP/1.1\r\nHost: {}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
                 Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n\u{1}\u{81}{{\"beat\":0}}",
                served.address
            )
        }))
        .map(String::into_bytes)
        .collect();
    // What is cut short is never answered: many wait at once, each for a moment.
    let answered: usize = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..THREADS)
            .map(|thread| {
                let (served, seeds) = (&served, &seeds);
                scope.spawn(move || {
                    let mut rng = ChaCha8Rng::seed_from_u64(thread);
                    let mutated =
                        (0..10_000 / THREADS as usize).map(|number| mutated(&seeds[number % seeds.len()], &mut rng));
                    mutated
                        .filter(|bytes| served.raw(bytes, Duration::from_millis(50)).starts_with("HTTP/1.1 "))
                        .count()
                })
            })
            .collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).sum()
    });
    println!("{answered} of 10000 were answered");
    assert!(answered > 1000);
    let state = served.until("the board is heard", |state| state["heard_ms_ago"].as_u64().is_some_and(|ms| ms < 1000));
    assert_eq!(
        (&state["is_off"], &state["mode"], &state["fault"]),
        (&json!(true), &json!("Idle"), &serde_json::Value::Null)
    );
    let page = Page::open(&served);
    page.take();
    page.does("/api/run", Some(json!({ "kind": "speed", "duty": 0.5, "direction": "cw", "seconds": 0.3 })));
    served.until("it still runs", |state| state["last"]["ok"] == true);
}
