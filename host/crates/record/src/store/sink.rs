//! A file that only ever grows by whole records.

use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};

/// Collects what is written and hands it to the operating system in one piece at [`Write::flush`]. When that fails, the
/// file is cut back to the last whole piece.
#[derive(Debug)]
pub(super) struct Sink {
    file: File,
    /// Bytes in the file.
    written: u64,
    pending: Vec<u8>,
}

impl Sink {
    pub(super) fn new(file: File) -> Self {
        Self { file, written: 0, pending: Vec::with_capacity(4096) }
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.pending.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        let result = self.file.write_all(&self.pending);
        match result {
            Ok(()) => self.written += self.pending.len() as u64,
            Err(_) => {
                // Best effort: readers also tolerate the partial record this would remove.
                let _ = self.file.set_len(self.written);
                let _ = self.file.seek(SeekFrom::Start(self.written));
            }
        }
        self.pending.clear();
        result
    }
}

/// Only the position can be asked for, which is all the container's writer needs outside chunks.
impl Seek for Sink {
    fn seek(&mut self, target: SeekFrom) -> io::Result<u64> {
        match target {
            SeekFrom::Current(0) => Ok(self.written + self.pending.len() as u64),
            _ => Err(io::Error::new(io::ErrorKind::Unsupported, "a recording only grows")),
        }
    }
}
