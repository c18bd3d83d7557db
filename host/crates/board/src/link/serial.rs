use super::{LinkError, Port, elapsed};
use serialport::SerialPort;
use std::io::{ErrorKind, Read, Write};
use std::time::{Duration, Instant};

/// Baud rate of the link.
pub const BAUD: u32 = 921_600;

/// A board on a serial port or pseudo-terminal.
pub struct SerialLink {
    name: String,
    port: Box<dyn SerialPort>,
}

impl SerialLink {
    /// Opens a port, with both control lines released: either one can hold an ESP32 in reset or its boot loader. With
    /// `reset` the board is reset through RTS first.
    ///
    /// # Errors
    /// [`LinkError::Open`], with what to do.
    pub fn open(name: &str, reset: bool) -> Result<Self, LinkError> {
        let open = |reason: String| LinkError::Open { port: name.to_owned(), reason };
        let mut port = serialport::new(name, BAUD)
            .timeout(Duration::from_millis(1))
            .dtr_on_open(false)
            .open()
            .map_err(|error| open(explain(name, &error)))?;
        // A pseudo-terminal has no control lines; what it answers does not matter.
        let _ = port.write_data_terminal_ready(false);
        if reset {
            let _ = port.write_request_to_send(true);
            std::thread::sleep(Duration::from_millis(100));
        }
        let _ = port.write_request_to_send(false);
        elapsed();
        Ok(Self { name: name.to_owned(), port })
    }

    fn lost(&self, reason: &std::io::Error) -> LinkError {
        LinkError::Lost { port: self.name.clone(), reason: reason.to_string() }
    }
}

fn explain(name: &str, error: &serialport::Error) -> String {
    use serialport::ErrorKind as Kind;
    let advice = match error.kind() {
        Kind::NoDevice if std::path::Path::new(name).exists() => "it is in use by another program; close that one",
        Kind::NoDevice | Kind::Io(ErrorKind::NotFound) => "no such port; `twum ports` lists those there are",
        Kind::Io(ErrorKind::PermissionDenied) => "permission denied; join the group that owns it (often `dialout`)",
        _ => "",
    };
    if advice.is_empty() { error.to_string() } else { format!("{advice} ({error})") }
}

impl Port for SerialLink {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let mut rest = bytes;
        let deadline = Instant::now() + Duration::from_secs(2);
        while !rest.is_empty() {
            match self.port.write(rest) {
                Ok(0) => std::thread::sleep(Duration::from_millis(1)),
                Ok(written) => rest = &rest[written..],
                Err(error)
                    if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted) =>
                {
                    if Instant::now() > deadline {
                        return Err(self.lost(&error));
                    }
                }
                Err(error) => return Err(self.lost(&error)),
            }
        }
        Ok(())
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        let deadline = Instant::now() + wait;
        let mut buffer = [0; 4096];
        loop {
            match self.port.read(&mut buffer) {
                Ok(0) => return Err(self.lost(&std::io::Error::from(ErrorKind::UnexpectedEof))),
                Ok(length) => {
                    into.extend_from_slice(&buffer[..length]);
                    return Ok(());
                }
                Err(error)
                    if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted) =>
                {
                    if Instant::now() >= deadline {
                        return Ok(());
                    }
                }
                Err(error) => return Err(self.lost(&error)),
            }
        }
    }

    fn elapsed(&self) -> Duration {
        elapsed()
    }

    fn is_virtual(&self) -> bool {
        false
    }
}
