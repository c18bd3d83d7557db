//! SCPI over a USB test-and-measurement device file (`/dev/usbtmcN`) or raw TCP.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};
use twum_files::input::printable;

/// How long an answer may take.
const ANSWER: Duration = Duration::from_secs(5);
/// Port on which Rigol instruments listen for raw SCPI.
pub const RIGOL_PORT: u16 = 5555;
/// Longest answer that is a line (bytes): settings and identities take tens.
const LARGEST_LINE: usize = 4096;
/// Largest block accepted (bytes).
pub const LARGEST_BLOCK: usize = 64 << 20;
/// Most bytes kept of an answer that does not end: a block with its header, and one read more.
const LARGEST_ANSWER: usize = LARGEST_BLOCK + READ;
/// Bytes asked for at a time.
const READ: usize = 4096;

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

/// A definite-length block at the front of what was received.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block<'a> {
    /// The block's bytes, header removed.
    pub data: &'a [u8],
    /// What was received after it.
    pub rest: &'a [u8],
}

/// The bytes received are no definite-length block.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{found}`: {expected}")]
pub struct NotABlock {
    /// The first bytes of what came.
    pub found: String,
    /// What was expected in their place.
    pub expected: &'static str,
}

/// Takes the definite-length block (`#<digits><length><bytes>`, IEEE 488.2 section 8.7.9) off the front of `received`,
/// white space before it skipped; `None` while more bytes are needed. Borrows everything, keeps nothing.
///
/// # Errors
/// [`NotABlock`] as soon as the bytes cannot become a block of at most [`LARGEST_BLOCK`] bytes.
pub fn take_block(received: &[u8]) -> Result<Option<Block<'_>>, NotABlock> {
    let wrong = |found: &[u8], expected| NotABlock {
        found: String::from_utf8_lossy(&found[..found.len().min(40)]).into_owned(),
        expected,
    };
    let received = received.trim_ascii_start();
    let Some((&mark, after_mark)) = received.split_first() else { return Ok(None) };
    if mark != b'#' {
        return Err(wrong(received, "expected a block, `#<digits><length>...`"));
    }
    let Some((&count, after_count)) = after_mark.split_first() else { return Ok(None) };
    if !(b'1'..=b'9').contains(&count) {
        return Err(wrong(received, "expected a block, `#<digits><length>...`"));
    }
    let digits = &after_count[..after_count.len().min(usize::from(count - b'0'))];
    if !digits.iter().all(u8::is_ascii_digit) {
        return Err(wrong(digits, "expected the length of a block"));
    }
    let Some((digits, body)) = after_count.split_at_checked(usize::from(count - b'0')) else { return Ok(None) };
    // Nine decimal digits fit 32 bits.
    let length = digits.iter().fold(0, |length, digit| length * 10 + usize::from(digit - b'0'));
    if length > LARGEST_BLOCK {
        return Err(wrong(digits, "expected a block of at most 64 MiB"));
    }
    Ok(body.split_at_checked(length).map(|(data, rest)| Block { data, rest }))
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
    /// [`InstrumentError::Open`] when there is nothing there, or a file that a command would be written into.
    pub fn open(address: &str) -> Result<Self, InstrumentError> {
        let failed = |cause| InstrumentError::Open { address: address.to_owned(), cause };
        let line = if address.starts_with('/') {
            let file = OpenOptions::new().read(true).write(true).open(address).map_err(failed)?;
            if file.metadata().map_err(failed)?.is_file() {
                return Err(failed(std::io::Error::new(ErrorKind::InvalidInput, "this is no device but a file")));
            }
            Line::Usbtmc(file)
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
            let blank = self.pending.len() - self.pending.trim_ascii_start().len();
            self.pending.drain(..blank);
            let end = self.pending.iter().position(|b| *b == b'\n');
            if let Some(end) = end {
                let rest = self.pending.split_off(end);
                let answer = std::mem::replace(&mut self.pending, rest);
                return Ok(String::from_utf8_lossy(&answer).trim().to_owned());
            }
            if self.pending.len() > LARGEST_LINE {
                let shown = String::from_utf8_lossy(&self.pending[..40]).into_owned();
                self.pending = Vec::new();
                return Err(self.unexpected(
                    command,
                    &shown,
                    "more than 4096 bytes without a line end: is this an instrument?",
                ));
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
            let taken = take_block(&self.pending)
                .map(|block| block.map(|Block { data, rest }| (data.to_vec(), self.pending.len() - rest.len())));
            match taken {
                Ok(Some((data, used))) => {
                    self.pending.drain(..used);
                    return Ok(data);
                }
                Ok(None) => self.receive(command, deadline)?,
                Err(NotABlock { found, expected }) => return Err(self.unexpected(command, &found, expected)),
            };
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
        let mut buffer = [0; READ];
        if Instant::now() > deadline {
            return Err(self.broken(command, std::io::Error::new(ErrorKind::TimedOut, "no complete answer within 5 s")));
        }
        if self.pending.len() > LARGEST_ANSWER {
            let cause =
                std::io::Error::new(ErrorKind::InvalidData, "an answer of more than 64 MiB: is this an instrument?");
            self.pending = Vec::new();
            return Err(self.broken(command, cause));
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
            answer: printable(&answer.chars().take(200).collect::<String>()),
            expected: expected.into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_is_taken_once_whole_and_leaves_the_rest() {
        let stream = b"\n #3004a\nb#\n1.0\n";
        for cut in 0..11 {
            assert_eq!(take_block(&stream[..cut]), Ok(None), "{cut} bytes");
        }
        assert_eq!(take_block(&stream[..11]), Ok(Some(Block { data: b"a\nb#", rest: b"" })));
        assert_eq!(take_block(stream), Ok(Some(Block { data: b"a\nb#", rest: b"\n1.0\n" })));
        assert_eq!(take_block(b"#10"), Ok(Some(Block { data: b"", rest: b"" })));
    }

    #[test]
    fn nothing_is_written_into_a_file_that_is_no_device() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "time_us,level").unwrap();
        let error = Scpi::open(file.path().to_str().unwrap()).and_then(|mut scpi| scpi.query("*IDN?")).unwrap_err();
        assert!(error.to_string().contains("no device"), "{error}");
        assert_eq!(std::fs::read_to_string(file.path()).unwrap(), "time_us,level");
    }

    #[test]
    fn a_line_without_an_end_is_given_up_after_its_bound() {
        let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = server.local_addr().unwrap().to_string();
        let endless = std::thread::spawn(move || {
            let (mut stream, _) = server.accept().unwrap();
            // Until the other side has had enough.
            let mut sent = 0_usize;
            while let Ok(count) = stream.write(&[b'x'; READ]) {
                sent += count;
            }
            sent
        });
        let mut scpi = Scpi::open(&address).unwrap();
        let error = scpi.query("*IDN?").unwrap_err().to_string();
        assert!(error.contains("without a line end"), "{error}");
        drop(scpi);
        // What the line itself holds, and no more, was taken off the instrument.
        assert!(endless.join().unwrap() < 64 << 20);
    }

    #[test]
    fn what_cannot_become_a_block_is_refused_at_its_first_wrong_byte() {
        for (bytes, found) in [
            (&b"1.0\n"[..], "1.0\n"),
            (b"#0abc", "#0abc"),
            (b"#A", "#A"),
            (b"#3+", "+"),
            (b"#4 12", " 12"),
            (b"#9067108865", "067108865"),
        ] {
            assert_eq!(take_block(bytes).unwrap_err().found, found);
        }
        assert_eq!(take_block(b"#9067108864"), Ok(None), "the largest block is awaited");
    }
}
