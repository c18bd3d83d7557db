//! Files handed in from outside, read whole: only regular ones (a pipe or a device would block or never end), and only up
//! to a size that somebody can have meant.

use std::fs::File;
use std::io::{Error, ErrorKind, Read};
use std::path::Path;

/// Most bytes of a file that a person writes by hand, or an editor saves.
pub const WRITTEN: u64 = 4 << 20;
/// Most bytes of a file that an instrument saves.
pub const MEASURED: u64 = 1 << 30;

/// The bytes of a file.
///
/// # Errors
/// The system's, and [`ErrorKind::InvalidInput`] for what is no regular file or is longer than `most` bytes.
pub fn bytes(path: &Path, most: u64) -> Result<Vec<u8>, Error> {
    if !std::fs::metadata(path)?.is_file() {
        return Err(Error::new(ErrorKind::InvalidInput, "not a regular file"));
    }
    let mut bytes = Vec::new();
    // The length is not trusted: the file may grow, and some report none.
    File::open(path)?.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return Err(Error::new(ErrorKind::InvalidInput, format!("larger than {} MiB", most >> 20)));
    }
    Ok(bytes)
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
