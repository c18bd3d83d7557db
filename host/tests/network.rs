//! Nothing listens on a network unless it was asked to, and then on loopback only. Linux says who listens where.
#![cfg(target_os = "linux")]

use std::collections::HashSet;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts a command that prints a line once it serves.
fn serving(arguments: &[&str]) -> (Running, String) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_twum"))
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    (Running(child), line.trim().to_owned())
}

/// Every internet socket of a process: protocol, local address as the kernel writes it (hexadecimal), state.
fn internet_sockets(process: u32) -> Vec<(&'static str, String, String)> {
    let mut inodes = HashSet::new();
    let Ok(descriptors) = std::fs::read_dir(format!("/proc/{process}/fd")) else { return Vec::new() };
    for descriptor in descriptors.flatten() {
        let target = std::fs::read_link(descriptor.path()).unwrap_or_default();
        if let Some(inode) = target.to_string_lossy().strip_prefix("socket:[").and_then(|rest| rest.strip_suffix(']')) {
            inodes.insert(inode.to_owned());
        }
    }
    let mut sockets = Vec::new();
    for protocol in ["tcp", "tcp6", "udp", "udp6", "raw", "raw6"] {
        let table = std::fs::read_to_string(format!("/proc/{process}/net/{protocol}")).unwrap_or_default();
        for row in table.lines().skip(1) {
            let columns: Vec<&str> = row.split_whitespace().collect();
            if columns.get(9).is_some_and(|inode| inodes.contains(*inode)) {
                sockets.push((protocol, columns[1].to_owned(), columns[3].to_owned()));
            }
        }
    }
    sockets
}

#[test]
fn the_simulated_instruments_listen_on_loopback_only() {
    let (bench, line) = serving(&["instruments", "simulate", "--generator-port", "0", "--scope-port", "0"]);
    assert!(line.contains("127.0.0.1:"), "{line}");
    let sockets = internet_sockets(bench.0.id());
    // 0A is LISTEN, 0100007F is 127.0.0.1.
    let listening = sockets.iter().filter(|(_, _, state)| state == "0A").count();
    assert_eq!(listening, 2, "generator and oscilloscope: {sockets:?}");
    assert!(sockets.iter().all(|(_, address, _)| address.starts_with("0100007F:")), "{sockets:?}");
}

#[test]
fn the_bench_is_served_on_loopback_only_unless_another_address_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    for (listen, seen) in [("127.0.0.1:0", "0100007F:"), ("0.0.0.0:0", "00000000:")] {
        let (bench, line) =
            serving(&["serve", "--port", "sim", "--listen", listen, "--folder", runs.to_str().unwrap()]);
        assert_eq!(line.contains("#token="), listen != "127.0.0.1:0", "{line}");
        let sockets = internet_sockets(bench.0.id());
        let listening: Vec<_> = sockets.iter().filter(|(_, _, state)| state == "0A").collect();
        assert!(listening.len() == 1 && listening[0].1.starts_with(seen), "{sockets:?}");
    }
}

#[test]
fn a_simulated_board_opens_no_internet_socket() {
    let (board, port) = serving(&["sim", "--pty"]);
    assert!(port.starts_with("/dev/"), "{port}");
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("a.mcap");
    let client = Command::new(env!("CARGO_BIN_EXE_twum"))
        .args(["track", "--port", &port, "--seconds", "3", "--out"])
        .arg(&recording)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let client = Running(client);
    for _ in 0..20 {
        assert_eq!(internet_sockets(board.0.id()), []);
        assert_eq!(internet_sockets(client.0.id()), []);
        std::thread::sleep(Duration::from_millis(100));
    }
    assert!(recording.exists(), "the client was at work");
}

/// The two tests above see two commands at work; that no other can listen shows in the source.
#[test]
fn what_listens_in_the_program_is_known() {
    fn visit(folder: &std::path::Path, found: &mut Vec<String>) {
        for entry in std::fs::read_dir(folder).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                visit(&path, found);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = std::fs::read_to_string(&path).unwrap();
                for line in text.lines().filter(|line| !line.trim_start().starts_with("//")) {
                    if ["TcpListener::", "UdpSocket::", "UnixListener::", "socket2::"]
                        .iter()
                        .any(|way| line.contains(way))
                    {
                        found.push(line.trim().to_owned());
                    }
                }
            }
        }
    }
    let mut found = Vec::new();
    let host = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    visit(&host.join("src"), &mut found);
    for part in std::fs::read_dir(host.join("crates")).unwrap().flatten() {
        visit(&part.path().join("src"), &mut found);
    }
    // The server of the bench, the simulated instruments, the door of the live server, a unit test of it (which names its address to its library), and one of an
    // instrument that never stops talking.
    found.sort();
    // Those by the name of a file are the stop socket in the user's own runtime directory: nothing on a network.
    let known = [
        "UnixListener::bind(path)?",
        "let listener = TcpListener::bind(&*addresses).map_err(failed)?;",
        "let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))?;",
        "let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))?;",
        "let listener = match UnixListener::bind(path) {",
        "let listener = tokio::net::TcpListener::from_std(listener).map_err(ServeError::System)?;",
        "let server = std::net::TcpListener::bind(\"127.0.0.1:0\").unwrap();",
        "let taken = std::net::TcpListener::bind((LOOPBACK, 0)).unwrap();",
    ];
    assert_eq!(found, known);
}
