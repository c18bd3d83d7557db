//! `twum flash`: puts the firmware of this very version on a board, with the installed `espflash`, and hears it answer.

use super::connect::ConnectArgs;
use super::output::answer;
use anyhow::{Context, Result, anyhow, bail};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

/// This program's version, which is the firmware's.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Arguments of `twum flash`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  twum flash --port /dev/ttyUSB0\n  twum flash --port /dev/ttyUSB0 --chip esp32c3 --images ./images\n\n\
                        Images are looked for in --images (or TWUM_IMAGES), in `images` beside this program, and in \
                        `target/firmware/images` here, where `firmware/check` puts what it builds."
)]
pub struct Args {
    #[command(flatten)]
    connect: ConnectArgs,
    /// Chip of the board: `auto` asks it
    #[arg(long, value_enum, default_value = "auto")]
    chip: Chip,
    /// Folder of images
    #[arg(long, env = "TWUM_IMAGES")]
    images: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Chip {
    Auto,
    Esp32,
    Esp32c3,
    Esp32c6,
}

impl Chip {
    const fn name(self) -> Option<&'static str> {
        match self {
            Self::Auto => None,
            Self::Esp32 => Some("esp32"),
            Self::Esp32c3 => Some("esp32c3"),
            Self::Esp32c6 => Some("esp32c6"),
        }
    }
}

/// Runs `twum flash`.
pub fn run(args: Args) -> Result<ExitCode> {
    let port = args.connect.port()?;
    let port = port.as_str();
    if port == "sim" || is_pseudo_terminal(port) {
        bail!("{port} is a simulated board's: it has no flash, and runs this version's firmware already");
    }
    if !Path::new(port).exists() && cfg!(unix) {
        bail!("there is no port {port}; `twum ports` lists those there are");
    }
    let folders = folders(args.images.as_deref());
    // What can be said without the board is said first.
    if let Some(chip) = args.chip.name() {
        image(&folders, chip)?;
    }
    let found = detect(port)?;
    if args.chip.name().is_some_and(|chip| chip != found) {
        bail!(
            "the board on {port} is an {found}, not an {}; nothing was written",
            args.chip.name().unwrap_or_default()
        );
    }
    let image = image(&folders, &found)?;
    eprintln!("writing {} to the {found} on {port}", image.display());
    let image_path = image.to_str().ok_or_else(|| anyhow!("{} is no text", image.display()))?;
    // A merged image holds the boot loader and the partition table too, so it begins at 0.
    let status = espflash(&["write-bin", "--chip", &found, "--port", port, "0x0", image_path])
        .status()
        .context("espflash could not be run")?;
    if !status.success() {
        bail!("espflash failed ({status}); the board may hold half an image: run this again");
    }
    let identity = args.connect.session()?.hello().context("the image was written, and the board does not answer")?;
    if identity.firmware != VERSION || identity.chip != found.as_str() {
        bail!(
            "the image was written, and the board says it is {} with firmware {}, not {found} with {VERSION}",
            identity.chip,
            identity.firmware
        );
    }
    let value = serde_json::json!({ "port": port, "chip": found, "firmware": VERSION, "image": image_path });
    answer(args.json, &value, &format!("{found} on {port} runs firmware {VERSION}"));
    Ok(ExitCode::SUCCESS)
}

fn is_pseudo_terminal(port: &str) -> bool {
    let path = std::fs::canonicalize(port).unwrap_or_else(|_| PathBuf::from(port));
    path.starts_with("/dev/pts")
}

/// Where images may be, the likeliest first.
fn folders(given: Option<&Path>) -> Vec<PathBuf> {
    if let Some(folder) = given {
        return vec![folder.to_owned()];
    }
    let beside = std::env::current_exe().ok().and_then(|program| Some(program.parent()?.join("images")));
    beside.into_iter().chain([PathBuf::from("target/firmware/images")]).collect()
}

/// The image of this version for a chip.
fn image(folders: &[PathBuf], chip: &str) -> Result<PathBuf> {
    let name = format!("twum-{VERSION}-{chip}.bin");
    let found = folders.iter().map(|folder| folder.join(&name)).find(|path| path.is_file());
    found.ok_or_else(|| {
        let looked: Vec<String> = folders.iter().map(|folder| folder.display().to_string()).collect();
        anyhow!(
            "no image {name} in {}; `firmware/check {chip}` builds it, and a release has it; --images names another folder",
            looked.join(" or ")
        )
    })
}

fn espflash(arguments: &[&str]) -> Command {
    let mut command = Command::new("espflash");
    // It would ask on the network for a newer version of itself.
    command.args(arguments).env("ESPFLASH_SKIP_UPDATE_CHECK", "true");
    command
}

/// Asks the board what chip it has.
fn detect(port: &str) -> Result<String> {
    let output = match espflash(&["board-info", "--port", port]).output() {
        Ok(output) => output,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            bail!("espflash is not installed, and flashing needs it: cargo install espflash")
        }
        Err(error) => return Err(error).context("espflash could not be run"),
    };
    let text = String::from_utf8_lossy(&output.stdout);
    if !output.status.success() {
        bail!("espflash does not reach a chip on {port}: {}", String::from_utf8_lossy(&output.stderr).trim());
    }
    chip_in(&text).with_context(|| format!("espflash says nothing of the chip on {port}: {}", text.trim()))
}

/// The chip's name in what `espflash board-info` prints: `Chip type:         esp32c3 (revision v0.4)`.
fn chip_in(text: &str) -> Option<String> {
    let rest = text.lines().find_map(|line| line.trim().strip_prefix("Chip type:"))?;
    rest.split_whitespace().next().map(str::to_lowercase)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_chip_is_read_out_of_what_espflash_prints() {
        let text = "Chip type:         esp32c3 (revision v0.4)\nCrystal frequency: 40 MHz\nFlash size:        4MB\n";
        assert_eq!(chip_in(text).as_deref(), Some("esp32c3"));
        assert_eq!(chip_in("Flash size: 4MB"), None);
    }

    #[test]
    fn only_this_versions_image_will_do() {
        let folder = tempfile::tempdir().unwrap();
        let folders = [folder.path().to_owned()];
        std::fs::write(folder.path().join("twum-0.0.0-esp32.bin"), b"old").unwrap();
        let error = image(&folders, "esp32").unwrap_err().to_string();
        assert!(error.contains(&format!("twum-{VERSION}-esp32.bin")) && error.contains("firmware/check"), "{error}");
        let right = folder.path().join(format!("twum-{VERSION}-esp32.bin"));
        std::fs::write(&right, b"new").unwrap();
        assert_eq!(image(&folders, "esp32").unwrap(), right);
    }
}
