//! Answers kept between calls, so that a second look at the same question is instant.
//!
//! An answer is kept under a hash of everything it depends on: the bytes of the measurement and of the motor file, the options
//! and the program itself. Whatever cannot be read or written is worked out again.

use super::Options;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use twum_files::output::{self, Existing};
use twum_record::measurement::Measurement;

/// What a question was answered.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Kept {
    /// The JSON.
    pub json: String,
    /// The page for a person.
    pub text: String,
}

/// Where the answer to one question is kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place(PathBuf);

impl Place {
    /// The place of the answer for these measurements and options under `folder`; none if a file cannot be read.
    pub fn new(folder: &Path, measurements: &[Measurement], options: &Options) -> Option<Self> {
        let mut hash = DefaultHasher::new();
        env!("CARGO_PKG_VERSION").hash(&mut hash);
        // Of two builds of one version the newer must not repeat the older's answer.
        let program = std::env::current_exe().and_then(std::fs::metadata).ok()?;
        (program.len(), program.modified().ok()?).hash(&mut hash);
        format!("{options:?}").hash(&mut hash);
        for m in measurements {
            m.folder.hash(&mut hash);
            if m.folder.is_file() {
                // A recording holds all its runs.
                std::fs::read(&m.folder).ok()?.hash(&mut hash);
                continue;
            }
            std::fs::read(m.folder.join("measurement.toml")).ok()?.hash(&mut hash);
            for run in &m.runs {
                std::fs::read(m.folder.join(&run.file)).ok()?.hash(&mut hash);
            }
        }
        Some(Self(folder.join(format!("{:016x}.json", hash.finish()))))
    }

    /// What was kept here.
    pub fn read(&self) -> Option<Kept> {
        serde_json::from_slice(&std::fs::read(&self.0).ok()?).ok()
    }

    /// Keeps an answer; one that is half written is never seen.
    ///
    /// # Errors
    /// When the folder or the file cannot be written.
    pub fn write(&self, kept: &Kept) -> std::io::Result<()> {
        if let Some(folder) = self.0.parent() {
            std::fs::create_dir_all(folder)?;
        }
        output::write(&self.0, serde_json::to_vec(kept)?, Existing::Replace).map_err(std::io::Error::other)
    }
}

/// Where answers are kept by default: the user's cache folder.
pub fn default_folder() -> Option<PathBuf> {
    let cache = std::env::var_os("XDG_CACHE_HOME")
        .filter(|v| !v.is_empty())
        .map(PathBuf::from)
        .or_else(|| std::env::var_os("HOME").map(|home| PathBuf::from(home).join(".cache")))?;
    Some(cache.join("twum").join("diagnose"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measurement(folder: &Path, duty: f64, csv: &str) -> Measurement {
        let toml = format!(
            "name = \"m\"\nmotor = \"pcbmotor-30mm\"\nedges_per_rev = 400\n[[run]]\nid = \"a\"\nkind = \"speed\"\nfile = \"a.csv\"\n\
             format = \"levels\"\nduty = {duty}\ndirection = \"cw\"\n"
        );
        std::fs::write(folder.join("measurement.toml"), toml).expect("it can be written");
        std::fs::write(folder.join("a.csv"), csv).expect("it can be written");
        Measurement::load(folder).expect("it is a measurement")
    }

    /// Fails if an answer is repeated for a question that differs in the data, the metadata or the options.
    #[test]
    fn another_question_has_another_place() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let csv = "time_us,level\n0,0\n1000,1\n2000,0\n";
        let options = Options::default();
        let place = |m: Measurement, o: &Options| Place::new(folder.path(), &[m], o).expect("the files are there");
        let first = place(measurement(folder.path(), 0.5, csv), &options);
        assert_eq!(first, place(measurement(folder.path(), 0.5, csv), &options));
        let seed = place(measurement(folder.path(), 0.5, csv), &Options { seed: 2, ..Options::default() });
        let duty = place(measurement(folder.path(), 0.6, csv), &options);
        let data = place(measurement(folder.path(), 0.5, &csv.replace("2000,0", "2000,1")), &options);
        assert!([seed, duty, data].iter().all(|other| *other != first));
    }

    /// Fails if what was kept cannot be had back, or if damage is taken for an answer.
    #[test]
    fn an_answer_comes_back_and_damage_does_not() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let m = measurement(folder.path(), 0.5, "time_us,level\n0,0\n1000,1\n");
        let place = Place::new(&folder.path().join("cache"), &[m], &Options::default()).expect("the files are there");
        assert_eq!(place.read(), None);
        let kept = Kept { json: "{}".into(), text: "NONE".into() };
        place.write(&kept).expect("it can be written");
        assert_eq!(place.read(), Some(kept));
        std::fs::write(&place.0, "half an ans").expect("it can be written");
        assert_eq!(place.read(), None);
    }
}
