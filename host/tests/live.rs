//! `twum live --foxglove`, as Foxglove would see it: its WebSocket protocol, spoken by another implementation.

use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use tungstenite::{ClientRequestBuilder, Message, WebSocket};

fn twum() -> Command {
    Command::new(env!("CARGO_BIN_EXE_twum"))
}

/// Ends the process with the test.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn text(socket: &mut WebSocket<TcpStream>, op: &str) -> Value {
    loop {
        if let Message::Text(text) = socket.read().expect("the server answers within the time limit") {
            let value: Value = serde_json::from_str(&text).unwrap();
            if value["op"] == op {
                return value;
            }
        }
    }
}

#[test]
fn foxglove_gets_the_values_and_events_of_the_view_on_loopback_alone() {
    let dir = tempfile::tempdir().unwrap();
    let recording = dir.path().join("sine.mcap");
    let made = twum()
        .args(["track", "--port", "sim", "--control", "thesis", "--seconds", "4", "--out"])
        .arg(&recording)
        .output()
        .unwrap();
    assert!(made.status.success());
    let mut child = Ended(
        twum()
            .arg("live")
            .arg(&recording)
            .arg("--foxglove=0")
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    let mut line = String::new();
    BufReader::new(child.0.stderr.take().unwrap()).read_line(&mut line).unwrap();
    let address = line.trim().strip_prefix("serving ").unwrap_or_else(|| panic!("{line}")).to_owned();
    let port: u16 = address.strip_prefix("ws://127.0.0.1:").unwrap().parse().unwrap();
    #[cfg(target_os = "linux")]
    {
        let listening = format!(":{port:04X} 00000000:0000 0A");
        let sockets: Vec<String> = ["/proc/net/tcp", "/proc/net/tcp6"]
            .iter()
            .flat_map(|file| {
                std::fs::read_to_string(file).unwrap_or_default().lines().map(str::to_owned).collect::<Vec<_>>()
            })
            .filter(|line| line.contains(&listening))
            .collect();
        assert!(sockets.len() == 1 && sockets[0].contains("0100007F:"), "{sockets:?}");
    }

    let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    let request = ClientRequestBuilder::new(address.parse().unwrap()).with_sub_protocol("foxglove.sdk.v1");
    let (mut socket, _) = tungstenite::client(request, stream).unwrap();
    assert_eq!(text(&mut socket, "serverInfo")["name"], "twum live");
    let advertised = text(&mut socket, "advertise");
    let channel = |topic: &str| {
        let channels = advertised["channels"].as_array().unwrap();
        channels.iter().find(|channel| channel["topic"] == topic).unwrap_or_else(|| panic!("{advertised}")).clone()
    };
    let (live, log) = (channel("/live"), channel("/log"));
    assert_eq!((live["encoding"].as_str(), live["schemaName"].as_str()), (Some("json"), Some("twum.Live")));
    let schema: Value = serde_json::from_str(live["schema"].as_str().unwrap()).unwrap();
    let subscriptions = json!([{"id": 1, "channelId": live["id"]}, {"id": 2, "channelId": log["id"]}]);
    socket.send(Message::text(json!({"op": "subscribe", "subscriptions": subscriptions}).to_string())).unwrap();

    let (mut points, mut notes) = (Vec::new(), Vec::new());
    while points.len() < 70 || !notes.iter().any(|note: &String| note.contains("run ended")) {
        let Message::Binary(bytes) = socket.read().expect("messages come within the time limit") else { continue };
        // Opcode 1: subscription (u32), time (u64), payload.
        assert_eq!(bytes[0], 1);
        let value: Value = serde_json::from_slice(&bytes[13..]).unwrap();
        match u32::from_le_bytes(bytes[1..5].try_into().unwrap()) {
            1 => points.push(value),
            _ => notes.push(value["message"].as_str().unwrap().to_owned()),
        }
    }
    assert!(notes.iter().any(|note| note.contains("run started")), "{notes:?}");
    for (key, _) in points[0].as_object().unwrap() {
        assert!(schema["properties"][key].is_object(), "{key} is not in the schema");
    }
    // The reference is 89 counts of 0.9 degrees at 1.257 rad/s, from where the rotor stood: a few counts off the zero of its alignment.
    let peak = points.iter().filter_map(|point| point["target_deg"].as_f64()).fold(0.0, f64::max);
    assert!((peak - 80.1).abs() < 3.0, "{peak}");
    let closest = points.iter().filter_map(|point| point["position_deg"].as_f64()).fold(0.0, f64::max);
    assert!((60.0..90.0).contains(&closest), "{closest}");
    let times: Vec<u64> = points.iter().map(|point| point["time_us"].as_u64().unwrap()).collect();
    assert!(times.windows(2).all(|pair| pair[1] - pair[0] >= 50_000), "{times:?}");
}

#[test]
fn without_a_terminal_it_says_what_to_do() {
    let output = twum().args(["live", "nowhere.mcap"]).stdout(Stdio::piped()).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(message.contains("`--once`") && message.contains("`--foxglove`"), "{message}");
}
