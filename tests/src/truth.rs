//! What a generator hid, sealed in a file beside the folder (never inside it), and what may be asked of a generator.

use crate::folder::Folder;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What a data set is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Nothing is hidden.
    Null,
    /// One effect of the library.
    Single,
    /// Two effects of the library.
    Pair,
    /// Something that no library holds.
    Outside,
    /// One effect of the library, to be diagnosed by a library without it.
    Removed,
    /// Closed loops with one effect of theirs, or nothing.
    Closed,
}

impl Kind {
    /// Every kind, in the order of the tables.
    pub const ALL: [Kind; 6] = [Kind::Null, Kind::Single, Kind::Pair, Kind::Outside, Kind::Removed, Kind::Closed];

    /// Its word on the command line and in files.
    pub fn word(self) -> &'static str {
        match self {
            Kind::Null => "null",
            Kind::Single => "single",
            Kind::Pair => "pair",
            Kind::Outside => "outside",
            Kind::Removed => "removed",
            Kind::Closed => "closed",
        }
    }

    /// The kind a word stands for.
    pub fn parse(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|k| k.word() == word)
    }
}

/// What is wanted of a generator, beside the seed.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// What for.
    pub kind: Kind,
    /// Effects to hide instead of drawn ones.
    pub effects: Vec<String>,
    /// Strength instead of a drawn one.
    pub rho: Option<f64>,
}

impl Request {
    /// A kind with everything drawn from the seed.
    pub fn of(kind: Kind) -> Self {
        Self { kind, effects: Vec::new(), rho: None }
    }
}

/// One hidden effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hidden {
    /// Name as in the library, or `outside-...`.
    pub name: String,
    /// Which form was drawn.
    pub form: String,
    /// The generator's own number for its size.
    pub size: f64,
    /// RMS of what it does to the speed after a refit of the motor's own parameters, over the noise floor, at the finer
    /// or the coarser of the two scales of [`crate::strength`], whichever shows more.
    pub rho: f64,
    /// Numbers with a meaning beyond this generator, under the names the library gives them.
    pub parameters: BTreeMap<String, f64>,
    /// What it hangs on (`angle`, `time`, `duty`, `direction`, `order`, `phase`), for effects outside the library.
    pub coordinate: Option<String>,
}

/// The sealed file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Which generator.
    pub generator: String,
    /// Its seed.
    pub seed: u64,
    /// What for.
    pub kind: Kind,
    /// What is hidden; empty for nothing.
    pub effects: Vec<Hidden>,
    /// Noise floor in rpm between single edges and between edges a PWM period apart.
    pub floor_rpm: [f64; 2],
    /// What all effects together leave after the refit in rpm, noise not counted, at the same two scales.
    pub effect_rpm: [f64; 2],
    /// 1 − RMSE without the effects / RMSE with them, both refitted, at the same two scales.
    pub oracle_gain: [f64; 2],
    /// The motor, in the generator's own numbers.
    pub motor: BTreeMap<String, f64>,
    /// The experiment: runs, seconds, duties, edges per revolution, ...
    pub design: BTreeMap<String, f64>,
}

impl Truth {
    /// Of three closed loops, whose effect has no strength over a floor. `law` is the controller as the folder says it, `motor` and
    /// `numbers` are the generator's own and those with a meaning beyond it; `none` hides nothing.
    pub fn of_loops(
        case: (&str, u64),
        name: &str,
        law: String,
        numbers: BTreeMap<String, f64>,
        motor: BTreeMap<String, f64>,
        [edges_per_rev, runs]: [f64; 2],
    ) -> Self {
        let hidden = Hidden {
            name: name.to_owned(),
            form: law,
            size: numbers.values().next().copied().unwrap_or(0.0),
            rho: 0.0,
            parameters: numbers,
            coordinate: None,
        };
        Self {
            generator: case.0.to_owned(),
            seed: case.1,
            kind: Kind::Closed,
            effects: if name == "none" { Vec::new() } else { vec![hidden] },
            floor_rpm: [0.0; 2],
            effect_rpm: [0.0; 2],
            oracle_gain: [0.0; 2],
            motor,
            design: [("edges_per_rev".to_owned(), edges_per_rev), ("runs".to_owned(), runs)].into(),
        }
    }
}

/// A made data set.
#[derive(Debug, Clone, PartialEq)]
pub struct Made {
    /// What a user would have.
    pub folder: Folder,
    /// What the user does not know.
    pub truth: Truth,
}

impl Made {
    /// Writes the folder, and the truth beside it as `FOLDER.truth.json`.
    ///
    /// # Errors
    /// What the file system says.
    pub fn write(&self, folder: &Path) -> std::io::Result<PathBuf> {
        self.folder.write(folder)?;
        let mut name = folder.file_name().unwrap_or_default().to_owned();
        name.push(".truth.json");
        let path = folder.with_file_name(name);
        let text = serde_json::to_string_pretty(&self.truth).map_err(std::io::Error::other)?;
        std::fs::write(&path, text)?;
        Ok(path)
    }
}
