//! SCPI over a USB test-and-measurement device file (`/dev/usbtmcN`) or raw TCP.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

/// How long an answer may take.
const ANSWER: Duration = Duration::from_secs(5);
/// Port on which Rigol instruments listen for raw SCPI.
pub const RIGOL_PORT: u16 = 5555;
/// Largest block accepted (bytes).
const LARGEST_BLOCK: usize = 64 << 20;

/// What went wrong with an instrument.
#[derive(Debug, thiserror::Error)]
pub enum InstrumentError {
    /// It could not be opened.
    #[error("{address}: {cause}; check the address, the cable and, for /dev/usbtmc*, that you may read and write it")]
    Open {
        /// Where it was looked for.
        address: String,
        /// The cause.
        cause: std::io::Error,
    },
    /// The line broke or fell silent.
    #[error("{address}: `{command}`: {cause}")]
    Link {
        /// Which instrument.
        address: String,
        /// What was sent.
        command: String,
        /// The cause.
        cause: std::io::Error,
    },
    /// It answered something else than expected.
    #[error("{address}: `{command}` answered `{answer}`: {expected}")]
    Answer {
        /// Which instrument.
        address: String,
        /// What was sent.
        command: String,
        /// What came.
        answer: String,
        /// What was expected, and what to do.
        expected: String,
    },
}

enum Line {
    Tcp(TcpStream),
    Usbtmc(File),
}

/// An instrument that takes commands and answers queries.
pub struct Scpi {
    address: String,
    line: Line,
    pending: Vec<u8>,
}

impl std::fmt::Debug for Scpi {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Scpi({})", self.address)
    }
}

impl Scpi {
    /// Opens `/dev/usbtmcN`, `host`, `host:port` or `tcp://host:port`.
    ///
    /// # Errors
    /// [`InstrumentError::Open`] when there is nothing there.
    pub fn open(address: &str) -> Result<Self, InstrumentError> {
        let failed = |cause| InstrumentError::Open { address: address.to_owned(), cause };
        let line = if address.starts_with('/') {
            Line::Usbtmc(OpenOptions::new().read(true).write(true).open(address).map_err(failed)?)
        } else {
            let host = address.trim_start_matches("tcp://");
            let place = if host.contains(':') { host.to_owned() } else { format!("{host}:{RIGOL_PORT}") };
            let target = place
                .to_socket_addrs()
                .map_err(failed)?
                .next()
                .ok_or_else(|| failed(std::io::Error::from(ErrorKind::AddrNotAvailable)))?;
            let stream = TcpStream::connect_timeout(&target, ANSWER).map_err(failed)?;
            stream.set_read_timeout(Some(ANSWER)).map_err(failed)?;
            stream.set_write_timeout(Some(ANSWER)).map_err(failed)?;
            stream.set_nodelay(true).map_err(failed)?;
            Line::Tcp(stream)
        };
        Ok(Self { address: address.to_owned(), line, pending: Vec::new() })
    }

    /// Where it is.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Opens the same address again, after the line broke.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn reopen(&mut self) -> Result<(), InstrumentError> {
        *self = Self::open(&self.address)?;
        Ok(())
    }

    /// Sends a command.
    ///
    /// # Errors
    /// [`InstrumentError::Link`].
    pub fn send(&mut self, command: &str) -> Result<(), InstrumentError> {
        // What an earlier answer left behind is no answer to this.
        self.pending.clear();
        let message = format!("{command}\n");
        match &mut self.line {
            Line::Tcp(stream) => stream.write_all(message.as_bytes()),
            Line::Usbtmc(file) => file.write_all(message.as_bytes()),
        }
        .map_err(|cause| self.broken(command, cause))
    }

    /// Sends a query and returns its answer, white space around it removed.
    ///
    /// # Errors
    /// [`InstrumentError::Link`], also when no answer comes.
    pub fn query(&mut self, command: &str) -> Result<String, InstrumentError> {
        self.send(command)?;
        let deadline = Instant::now() + ANSWER;
        loop {
            // A block's own line end may still be on its way: empty lines are none of ours.
            while self.pending.first().is_some_and(u8::is_ascii_whitespace) {
                self.pending.remove(0);
            }
            let end = self.pending.iter().position(|b| *b == b'\n');
            if let Some(end) = end {
                let rest = self.pending.split_off(end);
                let answer = std::mem::replace(&mut self.pending, rest);
                return Ok(String::from_utf8_lossy(&answer).trim().to_owned());
            }
            let whole = self.receive(command, deadline)?;
            if whole && !self.pending.iter().all(u8::is_ascii_whitespace) && !self.pending.contains(&b'\n') {
                // USB frames its messages: some Rigol answers come without a line end.
                self.pending.push(b'\n');
            }
        }
    }

    /// Sends a query and returns its answer as a number.
    ///
    /// # Errors
    /// [`InstrumentError::Answer`] when it is none, otherwise as [`Self::query`].
    pub fn number(&mut self, command: &str) -> Result<f64, InstrumentError> {
        let answer = self.query(command)?;
        // The DG1022 repeats the channel before the value of some answers (`CH2:6.000000e+00`).
        let value = answer.rsplit([':', ' ']).next().unwrap_or_default();
        value
            .parse::<f64>()
            .ok()
            .filter(|v| v.is_finite())
            .ok_or_else(|| self.unexpected(command, &answer, "expected a number"))
    }

    /// Sends a query and returns the definite-length block (`#<digits><length><bytes>`) it answers with.
    ///
    /// # Errors
    /// [`InstrumentError::Answer`] when the header is no block header, otherwise as [`Self::query`].
    pub fn block(&mut self, command: &str) -> Result<Vec<u8>, InstrumentError> {
        self.send(command)?;
        let deadline = Instant::now() + ANSWER;
        loop {
            while self.pending.first().is_some_and(u8::is_ascii_whitespace) {
                self.pending.remove(0);
            }
            if self.pending.len() >= 2 {
                let digits = usize::from(self.pending[1].wrapping_sub(b'0'));
                if self.pending[0] != b'#' || !(1..=9).contains(&digits) {
                    let shown = String::from_utf8_lossy(&self.pending[..self.pending.len().min(40)]).into_owned();
                    return Err(self.unexpected(command, &shown, "expected a block, `#<digits><length>...`"));
                }
                if self.pending.len() >= 2 + digits {
                    let header = String::from_utf8_lossy(&self.pending[2..2 + digits]).into_owned();
                    let length = header
                        .parse::<usize>()
                        .ok()
                        .filter(|l| *l <= LARGEST_BLOCK)
                        .ok_or_else(|| self.unexpected(command, &header, "expected the length of a block"))?;
                    if self.pending.len() >= 2 + digits + length {
                        let block = self.pending[2 + digits..2 + digits + length].to_vec();
                        self.pending.drain(..2 + digits + length);
                        return Ok(block);
                    }
                }
            }
            self.receive(command, deadline)?;
        }
    }

    /// Waits until a query's answer satisfies `good`.
    ///
    /// # Errors
    /// [`InstrumentError::Answer`] with the last answer when it does not within `patience`.
    pub fn wait(
        &mut self,
        command: &str,
        patience: Duration,
        expected: &str,
        good: impl Fn(&str) -> bool,
    ) -> Result<String, InstrumentError> {
        let deadline = Instant::now() + patience;
        loop {
            let answer = self.query(command)?;
            if good(&answer) {
                return Ok(answer);
            }
            if Instant::now() > deadline {
                return Err(self.unexpected(command, &answer, expected));
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Reads what is there into `pending`; true when the line delimits messages and one ended.
    fn receive(&mut self, command: &str, deadline: Instant) -> Result<bool, InstrumentError> {
        let mut buffer = [0; 4096];
        if Instant::now() > deadline {
            return Err(self.broken(command, std::io::Error::new(ErrorKind::TimedOut, "no complete answer within 5 s")));
        }
        let (got, framed) = match &mut self.line {
            Line::Tcp(stream) => (stream.read(&mut buffer), false),
            Line::Usbtmc(file) => (file.read(&mut buffer), true),
        };
        match got {
            Ok(0) => Err(self.broken(command, std::io::Error::new(ErrorKind::UnexpectedEof, "the line was closed"))),
            Ok(count) => {
                self.pending.extend_from_slice(&buffer[..count]);
                Ok(framed && count < buffer.len())
            }
            Err(e) if e.kind() == ErrorKind::Interrupted => Ok(false),
            Err(e) if e.kind() == ErrorKind::WouldBlock => {
                Err(self.broken(command, std::io::Error::new(ErrorKind::TimedOut, "no answer within 5 s")))
            }
            Err(e) => Err(self.broken(command, e)),
        }
    }

    fn broken(&self, command: &str, cause: std::io::Error) -> InstrumentError {
        InstrumentError::Link { address: self.address.clone(), command: command.to_owned(), cause }
    }

    /// An error about an answer.
    pub fn unexpected(&self, command: &str, answer: &str, expected: impl Into<String>) -> InstrumentError {
        InstrumentError::Answer {
            address: self.address.clone(),
            command: command.to_owned(),
            answer: answer.to_owned(),
            expected: expected.into(),
        }
    }
}
