//! Files handed out: the one place that writes what a person keeps. Recordings and sweeps alone have writers of their own,
//! because they must keep what they have when the program is killed ([`twum_record::store`], [`crate::instruments::sweep`]).
//!
//! A file is written beside its place, brought onto the disk and only then given its name: it is there whole or not at all,
//! whatever ends the program and however full the disk is, and of two writers at once one wins whole. What may be lost by it
//! is decided by one rule: pictures and pages (`.svg`, `.png`, `.html`) are drawn anew from data and are replaced; anything
//! else is replaced only where the user said so; a folder, and what the same program reads, never.

use crate::input;
use std::fs::{self, File, Metadata};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use tempfile::{NamedTempFile, TempDir};
use thiserror::Error;

/// Names that end so are pictures and pages.
const DRAWN: [&str; 4] = ["svg", "png", "html", "htm"];
/// The names of what is not finished end so. A program that was killed leaves one behind.
const UNFINISHED: &str = ".part";

/// Whether data and tables that are there already are replaced.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Existing {
    /// They are kept, and the writer refused.
    #[default]
    Keep,
    /// They are replaced.
    Replace,
}

/// Why a file could not be written; what was there is as it was.
#[derive(Debug, Error)]
pub enum OutputError {
    /// It is there already.
    #[error(
        "{}: exists; data and tables are replaced only with --force (where the command has it), folders never: choose \
         another name",
        .0.display()
    )]
    Exists(PathBuf),
    /// It is what the same program reads.
    #[error("{}: is read by this command, and would be lost: choose another name", .0.display())]
    Input(PathBuf),
    /// A link to nothing.
    #[error("{}: a link that leads nowhere: remove it, or name the file itself", .0.display())]
    Dangling(PathBuf),
    /// The system refused.
    #[error("cannot write {}: {reason}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// The system's reason.
        reason: io::Error,
    },
}

impl OutputError {
    fn io(path: &Path, reason: io::Error) -> Self {
        // The library that makes temporary files puts their names into its errors, which nobody asked for.
        let reason = if reason.raw_os_error().is_none() { reason.kind().into() } else { reason };
        Self::Io { path: path.to_owned(), reason }
    }
}

/// A file that gets its name when it is finished. Dropped before, it leaves nothing.
#[derive(Debug)]
pub struct Output {
    place: Place,
    /// Its name in messages.
    shown: PathBuf,
    out: BufWriter<Sink>,
}

#[derive(Debug)]
enum Sink {
    Beside(NamedTempFile),
    /// A device or a pipe, which holds nothing that could be lost.
    Through(File),
}

impl Output {
    /// Begins a file; refuses at once where [`Output::finish`] would.
    ///
    /// # Errors
    /// When something is there that must not be replaced, or the system refuses.
    pub fn begin(path: impl AsRef<Path>, existing: Existing) -> Result<Self, OutputError> {
        let place = Place::find(path.as_ref(), existing)?;
        let failed = |reason| OutputError::io(&place.path, reason);
        let sink = match &place.there {
            Some(there) if !there.is_file() => {
                Sink::Through(File::options().write(true).open(&place.path).map_err(failed)?)
            }
            there => Sink::Beside(beside(&place.path, there.as_ref()).map_err(failed)?),
        };
        Ok(Self { shown: place.asked.clone(), out: BufWriter::with_capacity(1 << 16, sink), place })
    }

    /// Brings the file onto the disk and gives it its name.
    ///
    /// # Errors
    /// As [`Output::begin`]; the file is then not there, or as it was.
    pub fn finish(self) -> Result<(), OutputError> {
        let Self { place, shown, out } = self;
        let failed = |reason| OutputError::io(&shown, reason);
        let held = match out.into_inner().map_err(|error| failed(error.into_error()))? {
            Sink::Through(mut file) => return file.flush().map_err(failed),
            Sink::Beside(held) => held,
        };
        held.as_file().sync_all().map_err(failed)?;
        // What is there may have changed since.
        Place::find(&place.asked, place.existing)?;
        let named = if place.replaces { held.persist(&place.path) } else { held.persist_noclobber(&place.path) };
        named.map_err(|error| match error.error.kind() {
            io::ErrorKind::AlreadyExists => OutputError::Exists(shown.clone()),
            _ => failed(error.error),
        })?;
        sync_folder(&place.path);
        Ok(())
    }

    /// The error of a write to this file, with its name.
    pub fn failed(&self, reason: io::Error) -> OutputError {
        OutputError::io(&self.shown, reason)
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.out.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

impl Seek for Output {
    fn seek(&mut self, target: SeekFrom) -> io::Result<u64> {
        self.out.seek(target)
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Beside(file) => file.write(bytes),
            Self::Through(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Beside(file) => file.flush(),
            Self::Through(file) => file.flush(),
        }
    }
}

impl Seek for Sink {
    fn seek(&mut self, target: SeekFrom) -> io::Result<u64> {
        match self {
            Self::Beside(file) => file.seek(target),
            Self::Through(file) => file.seek(target),
        }
    }
}

/// Writes a whole file.
///
/// # Errors
/// As [`Output::begin`] and [`Output::finish`].
pub fn write(path: impl AsRef<Path>, content: impl AsRef<[u8]>, existing: Existing) -> Result<(), OutputError> {
    let mut out = Output::begin(path, existing)?;
    out.write_all(content.as_ref()).map_err(|reason| out.failed(reason))?;
    out.finish()
}

/// Writes a file anew that this program has read in order to change it.
///
/// # Errors
/// As [`write()`].
pub fn rewrite(path: impl AsRef<Path>, content: impl AsRef<[u8]>) -> Result<(), OutputError> {
    let path = path.as_ref();
    let real = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let failed = |reason| OutputError::io(path, reason);
    let there = fs::metadata(&real).ok();
    let mut held = beside(&real, there.as_ref()).map_err(failed)?;
    held.write_all(content.as_ref()).and_then(|()| held.as_file().sync_all()).map_err(failed)?;
    held.persist(&real).map_err(|error| failed(error.error))?;
    sync_folder(&real);
    Ok(())
}

/// Refuses now what [`Output::begin`] would refuse after a long computation.
///
/// # Errors
/// As [`Output::begin`].
pub fn may_write(path: impl AsRef<Path>, existing: Existing) -> Result<(), OutputError> {
    Output::begin(path, existing).map(|_| ())
}

/// A folder that gets its name when it is finished, with everything in it. Dropped before, it leaves nothing.
#[derive(Debug)]
pub struct NewFolder {
    asked: PathBuf,
    held: TempDir,
    /// Files in the order in which they were written: the last one tells the folder is whole.
    written: Vec<PathBuf>,
}

impl NewFolder {
    /// Begins a folder where there is none, or an empty one.
    ///
    /// # Errors
    /// When there is something, or the system refuses.
    pub fn begin(path: impl AsRef<Path>) -> Result<Self, OutputError> {
        let asked = path.as_ref().to_owned();
        let failed = |reason| OutputError::io(&asked, reason);
        let within = match fs::read_dir(&asked) {
            Ok(mut entries) => match entries.next() {
                None => asked.as_path(),
                Some(_) => return Err(OutputError::Exists(asked)),
            },
            Err(reason) if reason.kind() == io::ErrorKind::NotFound => {
                if fs::symlink_metadata(&asked).is_ok() {
                    return Err(OutputError::Dangling(asked));
                }
                fs::create_dir_all(folder_of(&asked)).map_err(failed)?;
                folder_of(&asked)
            }
            Err(reason) if reason.kind() == io::ErrorKind::NotADirectory => return Err(OutputError::Exists(asked)),
            Err(reason) => return Err(failed(reason)),
        };
        let prefix = unfinished(&asked);
        let mut builder = tempfile::Builder::new();
        builder.prefix(&prefix).suffix(UNFINISHED);
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o777));
        let held = builder.tempdir_in(within).map_err(failed)?;
        Ok(Self { asked, held, written: Vec::new() })
    }

    /// Where its files are until it is finished.
    pub fn path(&self) -> &Path {
        self.held.path()
    }

    /// Writes a file of it; `name` may lie in folders below, which are made.
    ///
    /// # Errors
    /// When the system refuses, or what `fill` gives.
    pub fn file<E: From<OutputError>>(
        &mut self,
        name: impl AsRef<Path>,
        fill: impl FnOnce(&mut Output) -> Result<(), E>,
    ) -> Result<(), E> {
        let path = self.held.path().join(&name);
        fs::create_dir_all(folder_of(&path)).map_err(|reason| OutputError::io(&self.asked, reason))?;
        let mut out = Output::begin(path, Existing::Keep)?;
        out.shown = self.asked.join(&name);
        fill(&mut out)?;
        out.finish()?;
        self.written.extend(name.as_ref().iter().next().map(PathBuf::from));
        Ok(())
    }

    /// Gives the folder its name.
    ///
    /// # Errors
    /// When something has come in its place meanwhile, or the system refuses.
    pub fn finish(self) -> Result<(), OutputError> {
        let Self { asked, held, written } = self;
        let failed = |reason: io::Error| match reason.kind() {
            io::ErrorKind::AlreadyExists | io::ErrorKind::DirectoryNotEmpty | io::ErrorKind::NotADirectory => {
                OutputError::Exists(asked.clone())
            }
            _ => OutputError::io(&asked, reason),
        };
        if held.path().parent() == Some(asked.as_path()) {
            // An empty folder of the user's keeps its owner and rights, and may be where the user stands.
            let held_names = fs::read_dir(held.path()).map_err(failed)?;
            let mut names: Vec<PathBuf> = held_names.flatten().map(|entry| entry.file_name().into()).collect();
            // What has writers of its own, such as a recording, comes before what tells the folder is whole.
            names.retain(|name| !written.contains(name));
            for name in names.into_iter().chain(written) {
                let to = asked.join(&name);
                if fs::symlink_metadata(&to).is_ok() && held.path().join(&name).exists() {
                    return Err(OutputError::Exists(to));
                }
                match fs::rename(held.path().join(&name), &to) {
                    Err(reason) if reason.kind() != io::ErrorKind::NotFound => return Err(failed(reason)),
                    _ => {}
                }
            }
            return held.close().map_err(failed);
        }
        fs::rename(held.path(), &asked).map_err(failed)?;
        let _ = held.keep();
        sync_folder(&asked);
        Ok(())
    }
}

/// What stands where a file shall be.
#[derive(Debug)]
struct Place {
    /// As the user named it.
    asked: PathBuf,
    /// Links resolved that were there at the beginning: none that comes later is followed.
    path: PathBuf,
    there: Option<Metadata>,
    existing: Existing,
    replaces: bool,
}

impl Place {
    fn find(asked: &Path, existing: Existing) -> Result<Self, OutputError> {
        let failed = |reason| OutputError::io(asked, reason);
        let (path, there) = match fs::symlink_metadata(asked) {
            Err(reason) if reason.kind() == io::ErrorKind::NotFound => (asked.to_owned(), None),
            Err(reason) => return Err(failed(reason)),
            Ok(link) if link.is_symlink() => match fs::canonicalize(asked) {
                Err(reason) if reason.kind() == io::ErrorKind::NotFound => {
                    return Err(OutputError::Dangling(asked.to_owned()));
                }
                Err(reason) => return Err(failed(reason)),
                Ok(real) => {
                    let there = fs::metadata(&real).map_err(failed)?;
                    (real, Some(there))
                }
            },
            Ok(there) => (asked.to_owned(), Some(there)),
        };
        let drawn = path.extension().is_some_and(|end| DRAWN.iter().any(|drawn| end.eq_ignore_ascii_case(drawn)));
        let replaces = drawn || existing == Existing::Replace;
        match &there {
            Some(there) if there.is_dir() => return Err(OutputError::Exists(asked.to_owned())),
            Some(there) if there.is_file() && input::was_opened(there) => {
                return Err(OutputError::Input(asked.to_owned()));
            }
            Some(there) if there.is_file() && !replaces => return Err(OutputError::Exists(asked.to_owned())),
            _ => {}
        }
        Ok(Self { asked: asked.to_owned(), path, there, existing, replaces })
    }
}

/// The folder a path lies in.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// How what is not finished is called: hidden, and after what it was going to be.
fn unfinished(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    format!(".{}.", name.chars().take(60).collect::<String>())
}

/// Gives a finished file another name in the same folder.
///
/// # Errors
/// When the system refuses.
pub fn rename(from: &Path, to: &Path) -> Result<(), OutputError> {
    fs::rename(from, to).map_err(|reason| OutputError::io(to, reason))
}

fn beside(path: &Path, there: Option<&Metadata>) -> io::Result<NamedTempFile> {
    let prefix = unfinished(path);
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(UNFINISHED);
    // The user's mask takes off what new files of this user do not have.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let folder = folder_of(path);
    // The system's own words for a folder that is not there: those of the library that makes temporary files are others.
    fs::metadata(folder)?;
    let held = builder.tempfile_in(folder)?;
    if let Some(there) = there {
        held.as_file().set_permissions(there.permissions())?;
    }
    Ok(held)
}

/// Brings a new name onto the disk. Systems that cannot do that lose at most the name in a power cut, never a content.
fn sync_folder(path: &Path) {
    #[cfg(unix)]
    if let Ok(folder) = File::open(folder_of(path)) {
        let _ = folder.sync_all();
    }
}

#[cfg(test)]
mod tests;
