//! What a user sets once: `$XDG_CONFIG_HOME/twum/config.toml`.
//!
//! A command line comes before an environment variable, that before this file, that before what the board is configured
//! with or what is built in.

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use twum_host::input;

/// The file, as `twum config --help` shows it.
pub const EXAMPLE: &str = "\
Your own defaults are in a file, whose place `twum config path` prints. Every key may be left out; a command line and an
environment variable come before it, what the board is configured with after it:

  port = \"/dev/ttyUSB0\"
  motor = \"bench3.toml\"
  control = \"default\"
  edges_per_rev = 400
  pwm_hz = 50

  [limits]                  # as `twum config dump` writes them
  stall_ms = 500";

/// The file. Every key may be missing.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Defaults {
    /// As `--port`.
    pub port: Option<String>,
    /// As `--motor`.
    pub motor: Option<String>,
    /// As `--control`.
    pub control: Option<String>,
    /// As `--edges-per-rev`.
    pub edges_per_rev: Option<u16>,
    /// As `--pwm-hz`.
    pub pwm_hz: Option<u16>,
    /// As the file of `--limits`.
    pub limits: Option<toml::Table>,
}

/// Where the file is, or would be.
///
/// # Errors
/// When the environment names no place.
pub fn path() -> Result<PathBuf> {
    place().context("neither XDG_CONFIG_HOME nor HOME is set, so there is no place for a file")
}

fn place() -> Option<PathBuf> {
    let set = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    let folder = set("XDG_CONFIG_HOME").or_else(|| Some(set("HOME")?.join(".config")))?;
    Some(folder.join("twum").join("config.toml"))
}

/// Reads the file; without one nothing is set.
///
/// # Errors
/// Names the file and what is wrong in it.
pub fn load() -> Result<Defaults> {
    place().map_or(Ok(Defaults::default()), |path| read(&path))
}

fn read(path: &Path) -> Result<Defaults> {
    match input::text(path, input::WRITTEN) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Defaults::default()),
        text => toml::from_str(&text.with_context(|| path.display().to_string())?)
            .with_context(|| format!("{}: `twum config --help` shows its keys", path.display())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_and_its_mistakes_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        assert_eq!(read(&path).unwrap(), Defaults::default());
        std::fs::write(&path, "port = \"sim\"\nedges_per_rev = 200\n[limits]\nstall_ms = 900\n").unwrap();
        let found = read(&path).unwrap();
        assert_eq!((found.port.as_deref(), found.edges_per_rev), (Some("sim"), Some(200)));
        assert_eq!(found.limits.unwrap()["stall_ms"].as_integer(), Some(900));
        std::fs::write(&path, "prt = \"sim\"\n").unwrap();
        let message = format!("{:#}", read(&path).unwrap_err());
        assert!(message.contains("config.toml") && message.contains("prt"), "{message}");
        let shown = EXAMPLE.lines().filter(|line| line.starts_with("  ")).collect::<Vec<_>>().join("\n");
        assert!(toml::from_str::<Defaults>(&shown).is_ok(), "{shown}");
    }
}
