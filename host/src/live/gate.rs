//! The door of the live server. Any page that a browser on this machine has open may connect to a port of this machine; only
//! those that are meant come through, told by the `Host` they asked for and the `Origin` they come from. The server itself
//! listens behind it, on a loopback address and port that nobody is told.

use crate::origin::{host_of, is_this_machine, name_of};
use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;

/// Origins besides this machine's own: Foxglove in a browser, and its desktop program.
const ORIGINS: [&str; 3] = ["https://app.foxglove.dev", "https://studio.foxglove.dev", "file://"];
/// Longest head of a request, bytes, and how long it may take.
const LONGEST_HEAD: usize = 8192;
const PATIENCE: Duration = Duration::from_secs(5);
/// Listeners at once.
const MOST: usize = 16;

const REFUSAL: &[u8] = b"HTTP/1.1 403 Forbidden\r\nConnection: close\r\nContent-Type: text/plain\r\n\r\n\
this view is served to 127.0.0.1 and localhost, for programs and pages of this machine and for Foxglove\n";

/// Opens the door at `port` of 127.0.0.1 (0 takes any) and lets through to `server`; gives the port.
///
/// # Errors
/// When the port is in use or may not be taken.
pub(super) fn open(port: u16, server: SocketAddr) -> io::Result<u16> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))?;
    let port = listener.local_addr()?.port();
    let inside = Arc::new(AtomicUsize::new(0));
    thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let inside = Arc::clone(&inside);
            if inside.fetch_add(1, Ordering::Relaxed) >= MOST {
                inside.fetch_sub(1, Ordering::Relaxed);
                continue;
            }
            thread::spawn(move || {
                // A connection that breaks ends by itself.
                let _ = admit(stream, server);
                inside.fetch_sub(1, Ordering::Relaxed);
            });
        }
    });
    Ok(port)
}

fn admit(mut stream: TcpStream, server: SocketAddr) -> io::Result<()> {
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut head = Vec::new();
    let mut buffer = [0; 1024];
    while !head.windows(4).any(|end| end == b"\r\n\r\n") {
        let read = stream.read(&mut buffer)?;
        head.extend_from_slice(&buffer[..read]);
        if read == 0 || head.len() > LONGEST_HEAD {
            return Ok(());
        }
    }
    if !is_welcome(&head) {
        stream.write_all(REFUSAL)?;
        return stream.shutdown(Shutdown::Write);
    }
    let mut inner = TcpStream::connect(server)?;
    inner.write_all(&head)?;
    stream.set_read_timeout(None)?;
    stream.set_write_timeout(None)?;
    stream.set_nodelay(true)?;
    let (mut from, mut to) = (stream.try_clone()?, inner.try_clone()?);
    thread::spawn(move || {
        let _ = io::copy(&mut from, &mut to);
        let _ = to.shutdown(Shutdown::Both);
    });
    let result = io::copy(&mut inner, &mut stream).map(|_| ());
    let _ = stream.shutdown(Shutdown::Both);
    result
}

/// Whether the request asks this machine by its own name, and comes from no strange page.
fn is_welcome(head: &[u8]) -> bool {
    let head = String::from_utf8_lossy(head);
    let values = |name: &str| -> Vec<String> {
        head.lines()
            .skip(1)
            .filter_map(|line| line.split_once(':'))
            .filter(|(key, _)| key.trim().eq_ignore_ascii_case(name))
            .map(|(_, value)| value.trim().to_ascii_lowercase())
            .collect()
    };
    let hosts = values("host");
    let origins = values("origin");
    let local = |host: &str| is_this_machine(&name_of(host));
    let own = |origin: &str| host_of(origin).is_some_and(local);
    hosts.len() == 1 && local(&hosts[0]) && origins.iter().all(|origin| own(origin) || ORIGINS.contains(&&**origin))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strange_pages_and_names_are_not_let_in() {
        let head = |rest: &str| format!("GET / HTTP/1.1\r\n{rest}Upgrade: websocket\r\n\r\n");
        for (rest, welcome) in [
            ("Host: 127.0.0.1:8765\r\n", true),
            ("host: localhost:8765\r\norigin: https://app.foxglove.dev\r\n", true),
            ("Host: localhost\r\nOrigin: http://localhost:3000\r\n", true),
            ("Host: 127.0.0.1:8765\r\nOrigin: https://example.org\r\n", false),
            ("Host: 127.0.0.1:8765\r\nOrigin: null\r\n", false),
            ("Host: 127.0.0.1:8765\r\nOrigin: http://localhost.example.org\r\n", false),
            ("Host: 127.0.0.1:8765\r\nOrigin: https://app.foxglove.dev\r\nOrigin: https://example.org\r\n", false),
            ("Host: rebound.example.org:8765\r\n", false),
            ("Host: 127.0.0.1.example.org\r\n", false),
            ("Host: 127.0.0.1\r\nHost: example.org\r\n", false),
            ("", false),
        ] {
            assert_eq!(is_welcome(head(rest).as_bytes()), welcome, "{rest:?}");
        }
    }
}
