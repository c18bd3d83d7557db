//! The folder of runs: what is in it, and the notes that people write beside it. No name leads out of it.

use crate::input;
use crate::model::motor::Motor;
use crate::output;
use serde::Serialize;
use std::path::{Component, Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Longest notes, bytes.
pub const NOTES: usize = 32 << 10;
/// Entries listed, the newest first.
const LISTED: usize = 1000;
/// How deep recordings may lie: `EXPERIMENT/recordings/RUN.mcap`.
const DEEPEST: usize = 3;

/// What an entry is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A recording.
    Recording,
    /// A measurement folder.
    Measurement,
    /// A series of runs with its plan.
    Experiment,
    /// A stator's sweep, as CSV.
    Sweep,
    /// A folder of friction trials.
    Friction,
}

/// One entry of the list.
#[derive(Clone, Debug, Serialize)]
pub struct Entry {
    /// Its path in the folder, by which it is asked for.
    pub name: String,
    /// What it is.
    pub kind: Kind,
    /// Size, bytes; of a folder 0.
    pub bytes: u64,
    /// When it was changed last, s since the Unix epoch.
    pub changed_s: u64,
    /// The first line of its notes.
    pub note: Option<String>,
}

/// A folder of runs.
#[derive(Debug, Clone)]
pub struct Folder {
    root: PathBuf,
}

impl Folder {
    /// A folder, made if need be.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn open(root: &Path) -> std::io::Result<Self> {
        std::fs::create_dir_all(root)?;
        Ok(Self { root: std::fs::canonicalize(root)? })
    }

    /// Its place.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The place of what goes by `name`; it need not be there.
    ///
    /// # Errors
    /// When the name leads out of the folder, or is none.
    pub fn place(&self, name: &str) -> Result<PathBuf, String> {
        let plain = |part: Component<'_>| match part {
            Component::Normal(part) => part.to_str().is_some_and(|part| {
                !part.starts_with('.') && part.chars().all(|c| c.is_alphanumeric() || "-_.+ ".contains(c))
            }),
            _ => false,
        };
        let path = Path::new(name);
        if name.is_empty() || name.len() > 200 || !path.components().all(plain) || path.components().count() > DEEPEST {
            return Err(format!("`{}` is no name of a run in this folder", input::printable(name)));
        }
        let place = self.root.join(path);
        // A link in the folder may lead out of it.
        let mut there = place.as_path();
        while !there.exists() {
            there = there.parent().unwrap_or(&self.root);
        }
        match std::fs::canonicalize(there) {
            Ok(real) if real.starts_with(&self.root) => Ok(place),
            _ => Err(format!("`{}` leads out of this folder", input::printable(name))),
        }
    }

    /// The place of something that is there.
    ///
    /// # Errors
    /// As [`Self::place`], and when it is not there.
    pub fn existing(&self, name: &str) -> Result<PathBuf, String> {
        let place = self.place(name)?;
        if place.exists() { Ok(place) } else { Err(format!("there is no `{name}` in this folder")) }
    }

    /// Where the next run of a kind is recorded: `run-0007-sine.mcap`. A recording is never overwritten.
    pub fn next(&self, word: &str) -> PathBuf {
        let number = |entry: std::fs::DirEntry| {
            entry.file_name().to_str()?.strip_prefix("run-")?.split('-').next()?.parse::<u32>().ok()
        };
        let entries = std::fs::read_dir(&self.root).into_iter().flatten().flatten();
        let last = entries.filter_map(number).max().unwrap_or(0);
        self.root.join(format!("run-{:04}-{word}.mcap", last.saturating_add(1)))
    }

    /// What is in it, newest first.
    pub fn list(&self) -> Vec<Entry> {
        let mut found = Vec::new();
        self.visit(&self.root, 1, &mut found);
        found.sort_by(|a, b| b.changed_s.cmp(&a.changed_s).then_with(|| b.name.cmp(&a.name)));
        found.truncate(LISTED);
        for entry in &mut found {
            let notes = self.notes(&entry.name).unwrap_or_default();
            entry.note = notes.lines().next().map(str::to_owned);
        }
        found
    }

    /// The motor files that lie in it, by name.
    pub fn motors(&self) -> Vec<String> {
        let files = std::fs::read_dir(&self.root).into_iter().flatten().flatten();
        let is_motor = |name: &String| name.ends_with(".toml") && self.motor(name).is_ok();
        let mut motors: Vec<String> =
            files.filter_map(|file| file.file_name().into_string().ok()).take(LISTED).filter(is_motor).collect();
        motors.sort();
        motors
    }

    /// A shipped motor by its name, or that of a motor file in the folder.
    ///
    /// # Errors
    /// As [`Self::existing`], or what the file does not say as a motor file does.
    pub fn motor(&self, name: &str) -> Result<Motor, String> {
        if let Ok(motor) = Motor::shipped(name) {
            return Ok(motor);
        }
        let text = input::text(&self.existing(name)?, input::WRITTEN).map_err(|error| format!("{name}: {error}"))?;
        Motor::parse(name, &text).map_err(|error| error.to_string())
    }

    fn visit(&self, folder: &Path, depth: usize, found: &mut Vec<Entry>) {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            let Some(name) = path.strip_prefix(&self.root).ok().and_then(Path::to_str).map(str::to_owned) else {
                continue;
            };
            let Ok(about) = entry.metadata() else { continue };
            if self.place(&name).is_err() {
                continue;
            }
            let changed = about.modified().ok().and_then(|at| at.duration_since(UNIX_EPOCH).ok());
            let changed_s = changed.map_or(0, |since| since.as_secs());
            let mut push = |kind, bytes| found.push(Entry { name: name.clone(), kind, bytes, changed_s, note: None });
            if about.is_file() && path.extension().is_some_and(|extension| extension == "mcap") {
                push(Kind::Recording, about.len());
            } else if about.is_file() && path.extension().is_some_and(|extension| extension == "csv") {
                push(Kind::Sweep, about.len());
            } else if about.is_dir() {
                if path.join("plan.json").is_file() {
                    push(Kind::Experiment, 0);
                }
                if path.join("measurement.toml").is_file() {
                    push(Kind::Measurement, 0);
                } else if path.join("friction.toml").is_file() {
                    push(Kind::Friction, 0);
                } else if depth < DEEPEST {
                    self.visit(&path, depth + 1, found);
                }
            }
        }
    }

    /// The notes beside a run.
    ///
    /// # Errors
    /// As [`Self::place`].
    pub fn notes(&self, name: &str) -> Result<String, String> {
        let path = self.beside(name)?;
        match input::text(&path, NOTES as u64) {
            Ok(text) => Ok(text),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(String::new()),
            Err(error) => Err(format!("{}: {error}", path.display())),
        }
    }

    /// Writes the notes beside a run that is there; the run's own file stays as it is.
    ///
    /// # Errors
    /// Too long, or the system's reason.
    pub fn write_notes(&self, name: &str, text: &str) -> Result<(), String> {
        self.existing(name)?;
        if text.len() > NOTES {
            return Err(format!("these notes have {} bytes, at most {NOTES} are kept", text.len()));
        }
        output::rewrite(self.beside(name)?, text).map_err(|error| error.to_string())
    }

    fn beside(&self, name: &str) -> Result<PathBuf, String> {
        let mut path = self.place(name)?.into_os_string();
        path.push(".notes.txt");
        Ok(path.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_leads_out_of_the_folder() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("secret.mcap"), "s").unwrap();
        let folder = Folder::open(&dir.path().join("runs")).unwrap();
        std::os::unix::fs::symlink(dir.path().join("secret.mcap"), folder.root().join("link.mcap")).unwrap();
        std::os::unix::fs::symlink(dir.path(), folder.root().join("up")).unwrap();
        std::fs::write(folder.root().join("run-0001-sine.mcap"), "r").unwrap();
        for name in [
            "",
            ".",
            "..",
            "../secret.mcap",
            "up/secret.mcap",
            "link.mcap",
            "/etc/passwd",
            "a/../../secret.mcap",
            ".hidden",
            "a/b/c/d",
            "run-0001-sine.mcap\0",
            "a\\..\\b",
            "%2e%2e/secret.mcap",
            "~root",
            "a\nb",
            &"x".repeat(300),
        ] {
            assert!(folder.place(name).is_err(), "{name:?}");
            assert!(folder.write_notes(name, "n").is_err() && folder.notes(name).is_err(), "{name:?}");
        }
        assert!(folder.existing("run-0001-sine.mcap").is_ok() && folder.existing("run-0002-sine.mcap").is_err());
        assert_eq!(folder.list().iter().map(|entry| &*entry.name).collect::<Vec<_>>(), ["run-0001-sine.mcap"]);
    }

    #[test]
    fn notes_stand_beside_the_run_and_change_nothing_in_it() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::open(dir.path()).unwrap();
        assert!(folder.next("speed").ends_with("run-0001-speed.mcap"));
        let run = folder.next("speed");
        std::fs::write(&run, "frames").unwrap();
        assert!(folder.next("sine").ends_with("run-0002-sine.mcap"));
        let name = "run-0001-speed.mcap";
        assert!(folder.write_notes("run-0009-speed.mcap", "n").is_err());
        folder.write_notes(name, "bearing oiled\nagain").unwrap();
        folder.write_notes(name, "bearing dry\nagain").unwrap();
        assert_eq!(folder.notes(name).unwrap(), "bearing dry\nagain");
        assert_eq!(folder.list()[0].note.as_deref(), Some("bearing dry"));
        assert_eq!(std::fs::read(&run).unwrap(), b"frames");
        assert!(folder.write_notes(name, &"x".repeat(NOTES + 1)).is_err());
    }
}
