//! `twum config`: the configuration a board holds, shown, written to a file, loaded from one, and compared with one; and the
//! file of the user's own defaults.

use super::configuration::UnstableArgs;
use super::connect::ConnectArgs;
use super::defaults;
use super::output::answer;
use anyhow::{Context, Result, bail};
use serde_json::json;
use std::fmt::Display;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use twum_host::configuration::{difference, overlay, rows, to_toml};
use twum_host::input;
use twum_shared::message::Configuration;
use twum_shared::step::ConfigSpec;

/// Arguments of `twum config`.
#[derive(Debug, clap::Args)]
#[command(after_help = format!("Examples:\n  twum config show --port /dev/ttyUSB0\n  \
                        twum config dump --port /dev/ttyUSB0 > bench.toml\n  \
                        twum config load --port /dev/ttyUSB0 bench.toml\n  \
                        twum config diff --port /dev/ttyUSB0 bench.toml\n\n{}", defaults::EXAMPLE))]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Show what the board is configured with
    Show {
        #[command(flatten)]
        connect: ConnectArgs,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Write it as TOML to standard output
    Dump {
        #[command(flatten)]
        connect: ConnectArgs,
        /// Print the same as JSON
        #[arg(long)]
        json: bool,
    },
    /// Send a file to the board, which keeps it; what the file leaves out stays as it is
    Load {
        #[command(flatten)]
        connect: ConnectArgs,
        /// TOML file, or `-` for standard input
        #[arg(default_value = "-")]
        file: PathBuf,
        #[command(flatten)]
        unstable: UnstableArgs,
        /// Print what changed as JSON
        #[arg(long)]
        json: bool,
    },
    /// Show in what the board differs from a file; the exit code is 1 if it does
    Diff {
        #[command(flatten)]
        connect: ConnectArgs,
        /// TOML file, or `-` for standard input
        #[arg(default_value = "-")]
        file: PathBuf,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Print where the file of your own defaults is, or would be
    Path {
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Print what that file says
    Defaults {
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
}

/// What the board holds.
fn held(connect: &ConnectArgs) -> Result<Configuration> {
    let mut session = connect.session()?;
    session.hello()?;
    session
        .configuration()?
        .context("the board has no configuration yet; `twum config load` sends one, and so does every run")
}

fn read(file: &Path) -> Result<String> {
    if file == Path::new("-") {
        let mut text = String::new();
        // Read to its end before the port is opened: what writes it may hold the same port.
        std::io::stdin().take(input::WRITTEN).read_to_string(&mut text).context("standard input")?;
        return Ok(text);
    }
    input::text(file, input::WRITTEN).with_context(|| file.display().to_string())
}

fn name(file: &Path) -> String {
    if file == Path::new("-") { "standard input".to_owned() } else { file.display().to_string() }
}

/// Runs `twum config`.
pub fn run(args: Args) -> Result<ExitCode> {
    match args.command {
        Command::Show { connect, json } => {
            let rows = rows(&held(&connect)?);
            if json {
                let object: serde_json::Map<_, _> = rows
                    .into_iter()
                    .map(|(key, value)| Ok((key, serde_json::to_value(value)?)))
                    .collect::<Result<_>>()?;
                println!("{}", serde_json::Value::Object(object));
            } else {
                rows.iter().for_each(|(key, value)| println!("{key:<32}{value}"));
            }
        }
        Command::Dump { connect, json } => {
            let text = to_toml(&held(&connect)?);
            if json {
                println!("{}", serde_json::to_string(&text.parse::<toml::Table>()?)?);
            } else {
                print!("{text}");
            }
        }
        Command::Load { connect, file, unstable, json } => return load(&connect, &file, unstable, json),
        Command::Path { json } => {
            let path = defaults::path()?;
            let exists = path.is_file();
            answer(json, &json!({ "path": path, "exists": exists }), &path.display().to_string());
        }
        Command::Defaults { json: true } => println!("{}", serde_json::to_string(&defaults::load()?)?),
        Command::Defaults { json: false } => print!("{}", toml::to_string(&defaults::load()?)?),
        Command::Diff { connect, file, json } => {
            let text = read(&file)?;
            let board = held(&connect)?;
            let other = overlay(&board, &text).with_context(|| name(&file))?;
            let different = difference(&board, &other);
            if json {
                println!("{}", changes(&different, ["board", "file"]));
            }
            for (key, board, file) in different.iter().filter(|_| !json) {
                println!("{key}: {board} on the board, {file} in the file");
            }
            return Ok(ExitCode::from(u8::from(!different.is_empty())));
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// What differs, as a list of keys with their two values.
fn changes<V: Display>(different: &[(String, V, V)], names: [&str; 2]) -> serde_json::Value {
    let change = |(key, a, b): &(String, V, V)| json!({ "key": key, names[0]: a.to_string(), names[1]: b.to_string() });
    different.iter().map(change).collect()
}

fn load(connect: &ConnectArgs, file: &Path, unstable: UnstableArgs, json: bool) -> Result<ExitCode> {
    let text = read(file)?;
    if text.trim().is_empty() {
        bail!("{} is empty", name(file));
    }
    let fallback = Configuration::with_control(ConfigSpec::DEFAULT);
    // A wrong file is refused before the board is touched.
    overlay(&fallback, &text).with_context(|| name(file))?;
    let mut session = connect.session()?;
    session.hello()?;
    let before = session.configuration()?;
    let wanted = overlay(&before.unwrap_or(fallback), &text).with_context(|| name(file))?;
    unstable.refuse(&wanted, connect.motor_args()).with_context(|| name(file))?;
    session.configure(wanted)?;
    let now = session.configuration()?.context("the board took the configuration and does not have it")?;
    if let Some((key, _, has)) = difference(&wanted, &now).into_iter().next() {
        bail!("the board took the configuration, and has {key} = {has}");
    }
    match before {
        None if json => println!("{}", json!({ "before": null, "changed": null })),
        None => println!("the board had no configuration; it has this one now"),
        Some(before) if json => {
            let changed = changes(&difference(&before, &now), ["before", "now"]);
            println!("{}", json!({ "changed": changed }));
        }
        Some(before) => {
            let changed = difference(&before, &now);
            changed.iter().for_each(|(key, was, is)| println!("{key}: {was} -> {is}"));
            println!("{} changed", changed.len());
        }
    }
    Ok(ExitCode::SUCCESS)
}
