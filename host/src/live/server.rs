//! The live view for Foxglove: its WebSocket, on this machine only, while somebody asks for it.
//!
//! What is sent is what the terminal shows: [`crate::record::live::Point`]s and events. The server has threads of its own and drops what
//! a slow listener does not take, so neither it nor a listener holds up whoever feeds the view.

use super::gate;
use crate::record::live::LiveView;

use foxglove::{
    ChannelBuilder, Context, FoxgloveError, PartialMetadata, RawChannel, Schema, WebSocketServer, WebSocketServerHandle,
};
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};
use thiserror::Error;

/// Topic of the values.
pub const TOPIC_LIVE: &str = "/live";
/// Topic of the events.
pub const TOPIC_LOG: &str = "/log";
/// The only address served.
const LOOPBACK: &str = "127.0.0.1";

const LIVE_SCHEMA: &str = r#"{"type":"object","title":"twum.Live","properties":{
"time_us":{"type":"integer","description":"of the board's clock"},
"target_deg":{"type":["number","null"],"description":"wanted position, in a closed loop"},
"position_deg":{"type":"number"},
"speed_rpm":{"type":"number","description":"mean over the last 0.3 s"},
"duty":{"type":"number","description":"signed fraction of the PWM period with drive on"},
"mode":{"type":["string","null"]},
"fault":{"type":["string","null"]}}}"#;

/// Why the view cannot be served.
#[derive(Debug, Error)]
#[error("cannot serve on {LOOPBACK}:{port}: {reason}; take another port")]
pub struct LiveServerError {
    port: u16,
    reason: String,
}

/// Serves a view to whoever connects from this machine.
pub struct LiveServer {
    /// Dropped to end the server.
    _handle: WebSocketServerHandle,
    port: u16,
    /// Server and channels know each other through it, and hold it weakly.
    _context: Arc<Context>,
    live: Arc<RawChannel>,
    log: Arc<RawChannel>,
    /// The board's time of the last point sent, µs.
    sent_us: Option<u64>,
    /// Notes sent.
    noted: u64,
}

impl LiveServer {
    /// Starts serving; port 0 takes any that is free.
    ///
    /// # Errors
    /// When the port is in use or may not be taken.
    pub fn start(port: u16) -> Result<Self, LiveServerError> {
        let failed = |reason: FoxgloveError| LiveServerError { port, reason: reason.to_string() };
        let context = Context::new();
        let channel = |topic: &str, schema: Schema| {
            ChannelBuilder::new(topic)
                .context(&context)
                .message_encoding("json")
                .schema(schema)
                .build_raw()
                .map_err(failed)
        };
        let live = channel(TOPIC_LIVE, Schema::new("twum.Live", "jsonschema", LIVE_SCHEMA.as_bytes()))?;
        let log = channel(
            TOPIC_LOG,
            Schema::new("foxglove.Log", "jsonschema", crate::record::export::LOG_SCHEMA.as_bytes()),
        )?;
        let hidden = hidden_loopback();
        let server = WebSocketServer::new().name("twum live").context(&context).bind(hidden.to_string(), 0);
        let handle = server.start_blocking().map_err(failed)?;
        let port = gate::open(port, SocketAddr::from((hidden, handle.port())))
            .map_err(|reason| LiveServerError { port, reason: reason.to_string() })?;
        Ok(Self { _handle: handle, port, _context: context, live, log, sent_us: None, noted: 0 })
    }

    /// Where to connect to.
    pub fn address(&self) -> String {
        format!("ws://{LOOPBACK}:{}", self.port)
    }

    /// Sends what is new. The first listener gets the whole half minute that the view holds.
    pub fn send(&mut self, view: &LiveView) {
        let now_ns = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
        let latest_us = view.history().last().map_or(0, |point| point.time_us);
        if self.live.has_sinks() {
            // The board's clock has started anew.
            if self.sent_us.is_some_and(|sent_us| sent_us > latest_us) {
                self.sent_us = None;
            }
            for point in view.history().filter(|point| self.sent_us.is_none_or(|sent_us| point.time_us > sent_us)) {
                let json = serde_json::to_vec(point).expect("a point has neither maps nor values that JSON lacks");
                let at_ns = now_ns.saturating_sub((latest_us - point.time_us) * 1000);
                self.live.log_with_meta(&json, PartialMetadata { log_time: Some(at_ns) });
            }
            self.sent_us = Some(latest_us);
        }
        if self.log.has_sinks() {
            let (lines, noted) = view.notes_after(self.noted);
            for line in lines {
                const INFO: u8 = 2;
                let message = serde_json::json!({
                    "timestamp": { "sec": now_ns / 1_000_000_000, "nsec": now_ns % 1_000_000_000 },
                    "level": INFO, "message": line, "name": "twum", "file": "", "line": 0,
                });
                self.log.log_with_meta(message.to_string().as_bytes(), PartialMetadata { log_time: Some(now_ns) });
            }
            self.noted = noted;
        }
    }
}

/// A loopback address that no page can guess. Where the system has one address only, it is that one.
fn hidden_loopback() -> Ipv4Addr {
    let any = rand::random::<u32>().to_be_bytes();
    let hidden = Ipv4Addr::new(127, any[0].clamp(1, 254), any[1], any[2].clamp(1, 254));
    if cfg!(target_os = "linux") { hidden } else { Ipv4Addr::LOCALHOST }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_in_use_is_named() {
        let taken = std::net::TcpListener::bind((LOOPBACK, 0)).unwrap();
        let port = taken.local_addr().unwrap().port();
        let error = LiveServer::start(port).err().unwrap().to_string();
        assert!(error.starts_with(&format!("cannot serve on 127.0.0.1:{port}: ")), "{error}");
    }
}
