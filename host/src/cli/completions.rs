//! `twum completions` and `twum man`.

use super::existing::ExistingArgs;
use anyhow::{Context, Result};
use clap::CommandFactory;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use twum_host::output::{self, Existing};

/// Arguments of `twum completions`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  twum completions bash > ~/.local/share/bash-completion/completions/twum\n  \
                        twum completions zsh > ~/.zfunc/_twum")]
pub struct Args {
    /// The shell
    #[arg(value_enum)]
    shell: clap_complete::Shell,
}

/// Arguments of `twum man`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  twum man | man -l -\n  twum man ~/.local/share/man/man1")]
pub struct ManArgs {
    /// Folder for a page of every command; without it the first page goes to stdout
    folder: Option<PathBuf>,
    #[command(flatten)]
    existing: ExistingArgs,
}

/// Runs `twum completions`.
pub fn run(args: &Args) -> Result<ExitCode> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut super::Cli::command(), "twum", &mut script);
    std::io::stdout().write_all(&script)?;
    Ok(ExitCode::SUCCESS)
}

/// Runs `twum man`.
pub fn man(args: &ManArgs) -> Result<ExitCode> {
    let mut command = super::Cli::command();
    command.build();
    let Some(folder) = &args.folder else {
        let mut page = Vec::new();
        clap_mangen::Man::new(command).render(&mut page)?;
        std::io::stdout().write_all(&page)?;
        return Ok(ExitCode::SUCCESS);
    };
    std::fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
    let pages = write_pages(&command, "twum", folder, args.existing.into())?;
    eprintln!("wrote {pages} pages to {}", folder.display());
    Ok(ExitCode::SUCCESS)
}

/// A page of a command and one of every command below it; how many.
fn write_pages(command: &clap::Command, name: &str, folder: &Path, existing: Existing) -> Result<usize> {
    let path = folder.join(format!("{name}.1"));
    let mut page = Vec::new();
    // The page's title takes the whole name; it lives as long as the process, as clap's own names do.
    let title: &'static str = String::leak(name.to_owned());
    clap_mangen::Man::new(command.clone().name(title)).render(&mut page)?;
    output::write(&path, page, existing)?;
    let mut count = 1;
    for below in command.get_subcommands().filter(|below| below.get_name() != "help") {
        count += write_pages(below, &format!("{name}-{}", below.get_name()), folder, existing)?;
    }
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_has_a_page_and_is_completed() {
        super::super::Cli::command().debug_assert();
        let folder = tempfile::tempdir().unwrap();
        let mut command = super::super::Cli::command();
        command.build();
        let pages = write_pages(&command, "twum", folder.path(), Existing::Keep).unwrap();
        assert!(pages > 30, "{pages}");
        for name in ["twum", "twum-track", "twum-experiment-run", "twum-model-braking"] {
            let page = std::fs::read_to_string(folder.path().join(format!("{name}.1"))).unwrap();
            assert!(page.contains(".TH") && page.contains("SYNOPSIS"), "{name}");
        }
        let mut script = Vec::new();
        clap_complete::generate(clap_complete::Shell::Bash, &mut super::super::Cli::command(), "twum", &mut script);
        let script = String::from_utf8(script).unwrap();
        for below in command.get_subcommands() {
            assert!(script.contains(below.get_name()), "{}", below.get_name());
        }
    }
}
