//! Files handed in from outside: only regular ones (a pipe or a device would block or never end), and what is read whole only
//! up to a size that somebody can have meant. What was opened here is remembered, so that [`crate::output`] never writes onto
//! what the same program reads.

use std::collections::HashSet;
use std::fs::{File, Metadata};
use std::io::{Error, ErrorKind, Read};
use std::path::Path;
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::SystemTime;

/// Most bytes of a file that a person writes by hand, or an editor saves.
pub const WRITTEN: u64 = 4 << 20;
/// Most bytes of a file that an instrument saves.
pub const MEASURED: u64 = 1 << 30;

/// What makes a file the same under any name: device, number there and birth, since a number is given again.
type Identity = (u64, u64, Option<SystemTime>);

static OPENED: LazyLock<Mutex<HashSet<Identity>>> = LazyLock::new(Mutex::default);

#[cfg(unix)]
fn identity(metadata: &Metadata) -> Identity {
    use std::os::unix::fs::MetadataExt;
    (metadata.dev(), metadata.ino(), metadata.created().ok())
}

/// Without numbers of files, length and birth have to do: two files that share both to the tick of the clock are held for one,
/// which refuses an output and loses nothing.
#[cfg(not(unix))]
fn identity(metadata: &Metadata) -> Identity {
    (0, metadata.len(), metadata.created().ok())
}

/// Opens a regular file to read.
///
/// # Errors
/// The system's, and [`ErrorKind::InvalidInput`] for what is no regular file.
pub fn open(path: &Path) -> Result<File, Error> {
    // Asked before it is opened: opening a pipe waits for its other end.
    if !std::fs::metadata(path)?.is_file() {
        return Err(Error::new(ErrorKind::InvalidInput, "not a regular file"));
    }
    let file = File::open(path)?;
    OPENED.lock().unwrap_or_else(PoisonError::into_inner).insert(identity(&file.metadata()?));
    Ok(file)
}

/// Whether this program has opened that file as an input, under whatever name.
pub(crate) fn was_opened(metadata: &Metadata) -> bool {
    OPENED.lock().unwrap_or_else(PoisonError::into_inner).contains(&identity(metadata))
}

/// The bytes of a file.
///
/// # Errors
/// As [`open`], and [`ErrorKind::InvalidInput`] for what is longer than `most` bytes.
pub fn bytes(path: &Path, most: u64) -> Result<Vec<u8>, Error> {
    let mut bytes = Vec::new();
    // The length is not trusted: the file may grow, and some report none.
    open(path)?.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return Err(Error::new(ErrorKind::InvalidInput, format!("larger than {} MiB", most >> 20)));
    }
    Ok(bytes)
}

/// Text from outside as it may be shown: what a device or a file says must not command the terminal.
pub fn printable(text: &str) -> String {
    text.chars().flat_map(|c| if c.is_control() { c.escape_default().collect() } else { vec![c] }).collect()
}

/// The text of a file.
///
/// # Errors
/// As [`bytes`], and [`ErrorKind::InvalidData`] where it is not UTF-8.
pub fn text(path: &Path, most: u64) -> Result<String, Error> {
    String::from_utf8(bytes(path, most)?).map_err(|_| Error::new(ErrorKind::InvalidData, "not UTF-8 text"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_up_to_its_bound_and_not_beyond() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        std::fs::write(&path, b"1234").unwrap();
        assert_eq!(text(&path, 4).unwrap(), "1234");
        assert_eq!(bytes(&path, 3).unwrap_err().kind(), ErrorKind::InvalidInput);
        std::fs::write(&path, b"\xff").unwrap();
        assert_eq!(text(&path, 4).unwrap_err().kind(), ErrorKind::InvalidData);
        assert_eq!(bytes(dir.path(), 4).unwrap_err().kind(), ErrorKind::InvalidInput);
    }

    #[test]
    fn what_commands_a_terminal_is_escaped_and_other_text_stays() {
        assert_eq!(printable("30 mm, µ\u{1b}[2J\r\n\u{9b}1m\u{7}"), "30 mm, µ\\u{1b}[2J\\r\\n\\u{9b}1m\\u{7}");
    }

    #[cfg(unix)]
    #[test]
    fn a_device_or_pipe_is_not_waited_for() {
        assert_eq!(bytes(Path::new("/dev/zero"), 4).unwrap_err().to_string(), "not a regular file");
        let dir = tempfile::tempdir().unwrap();
        let pipe = dir.path().join("pipe");
        if !std::process::Command::new("mkfifo").arg(&pipe).status().is_ok_and(|status| status.success()) {
            println!("skipped: no mkfifo here");
            return;
        }
        assert_eq!(bytes(&pipe, 4).unwrap_err().to_string(), "not a regular file");
    }
}
