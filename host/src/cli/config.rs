//! What a user sets once: `$XDG_CONFIG_HOME/twum/config.toml`, and `twum config`.
//!
//! A command line comes before an environment variable, that before this file, that before what is built in.

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// The file. Every key may be missing.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
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
}

/// Arguments of `twum config`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
The file holds defaults of the options of the same names; a command line and an environment variable come before it:

  port = \"/dev/ttyUSB0\"
  motor = \"bench3.toml\"
  control = \"default\"
  edges_per_rev = 400
  pwm_hz = 50")]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Print where the file is, or would be
    Path,
    /// Print what it says
    Show {
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
}

/// Runs `twum config`.
pub fn run(args: &Args) -> Result<ExitCode> {
    match args.what {
        What::Path => match path() {
            Some(path) => println!("{}", path.display()),
            None => anyhow::bail!("neither XDG_CONFIG_HOME nor HOME is set, so there is no place for a file"),
        },
        What::Show { json: true } => println!("{}", serde_json::to_string(&load()?)?),
        What::Show { json: false } => print!("{}", toml::to_string(&load()?)?),
    }
    Ok(ExitCode::SUCCESS)
}

fn path() -> Option<PathBuf> {
    let set = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    let folder = set("XDG_CONFIG_HOME").or_else(|| Some(set("HOME")?.join(".config")))?;
    Some(folder.join("twum").join("config.toml"))
}

/// Reads the file; without one nothing is set.
pub fn load() -> Result<Config> {
    path().map_or(Ok(Config::default()), |path| read(&path))
}

fn read(path: &Path) -> Result<Config> {
    match std::fs::read_to_string(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Config::default()),
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
        assert_eq!(read(&path).unwrap(), Config::default());
        std::fs::write(&path, "port = \"sim\"\nedges_per_rev = 200\n").unwrap();
        let found = read(&path).unwrap();
        assert_eq!((found.port.as_deref(), found.edges_per_rev), (Some("sim"), Some(200)));
        std::fs::write(&path, "prt = \"sim\"\n").unwrap();
        let message = format!("{:#}", read(&path).unwrap_err());
        assert!(message.contains("config.toml") && message.contains("prt"), "{message}");
    }
}
