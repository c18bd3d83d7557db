//! Many pages at once, one of which never reads.

use super::page::Page;
use super::served::Served;
use serde_json::json;
use std::io::Write;
use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};
use twum_fit::quantile::quantiles;
use twum_host::record::decode::{Decoder, Item};

/// Resident memory of a process, MB.
fn memory_mb(process: u32) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.trim().trim_end_matches(" kB").parse::<f64>().unwrap() / 1024.0
}

/// A page that opens its stream and never reads.
fn deaf(served: &Served) -> TcpStream {
    let mut stream = TcpStream::connect(&served.address).unwrap();
    write!(
        stream,
        "GET /api/stream HTTP/1.1\r\nHost: {}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n",
        served.address
    )
    .unwrap();
    stream
}

/// By how much the frames of the board came later than the least late one, ms: of 999 in 1 000, and the worst.
fn lateness_ms(recording: &Path) -> [f64; 2] {
    let mut decoder = Decoder::open(recording).unwrap();
    let mut late = Vec::new();
    while let Some(item) = decoder.next_item().unwrap() {
        if let Item::Device { host_time_ns, header, .. } = item {
            late.push(host_time_ns as f64 * 1e-6 - header.time_us as f64 * 1e-3);
        }
    }
    let least = late.iter().copied().fold(f64::INFINITY, f64::min);
    quantiles(late, [0.999, 1.0]).map(|late| late - least)
}

/// A run that so many pages watch, and one that never reads beside them if there are any.
fn watched(watchers: usize, seconds: u32) {
    let served = Served::sim();
    served.until("the board answers", |state| state["connected"] == true);
    let holder = Page::open(&served);
    holder.take();
    let pages: Vec<Page<'_>> = (0..watchers).map(|_| Page::open(&served)).collect();
    let _deaf = (watchers > 0).then(|| deaf(&served));
    let sine = json!({ "kind": "sine", "amplitude_deg": 80.1, "omega_rad_s": 1.257, "seconds": seconds });
    let name = holder.does("/api/run", Some(sine))["recording"].as_str().unwrap().to_owned();
    served.until("the run begins", |state| state["mode"] == "Running");
    let (began, before) = (Instant::now(), memory_mb(served.process.id()));
    let points: Vec<u64> = pages.iter().map(Page::points).collect();
    let mut most = before;
    while served.state()["doing"].is_object() {
        most = most.max(memory_mb(served.process.id()));
        std::thread::sleep(Duration::from_millis(500));
    }
    let state = served.state();
    let rates: Vec<f64> = pages
        .iter()
        .zip(&points)
        .map(|(page, from)| (page.points() - from) as f64 / began.elapsed().as_secs_f64())
        .collect();
    let [usual, worst] = lateness_ms(&served.runs().join(name));
    let to_pages = rates.iter().copied().reduce(f64::min).zip(rates.iter().copied().reduce(f64::max));
    let watched = to_pages.map_or("no page".to_owned(), |(least, most)| {
        format!("{watchers} pages, {least:.1} to {most:.1} points a second each, and one that never reads")
    });
    println!(
        "{watched}, {seconds} s: {}; 99.9 % of the frames at most {usual:.1} ms late in the file, the worst {worst:.1} ms; \
         memory {before:.0} MB at first, {most:.0} MB at most; late ticks {}",
        state["last"]["words"], state["late_ticks"]
    );
    assert_eq!(state["last"]["ok"], true, "{state}");
    assert!(rates.iter().all(|rate| *rate > 5.0), "{rates:?}");
    // The recorder's queue holds 40 MB at the most (`link::recorder`).
    assert!(most < before + 60.0, "{before} MB, then {most} MB");
}

#[test]
fn pages_that_watch_cost_the_recording_nothing() {
    watched(20, 5);
}

/// `cargo test --release -p twum-host --test serve -- --ignored --nocapture ten_minutes`
#[test]
#[ignore = "ten minutes; docs/serve.md gives the command"]
fn twenty_pages_watch_for_ten_minutes() {
    watched(0, 60);
    watched(20, 600);
}
