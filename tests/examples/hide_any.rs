//! Writes one measurement folder of a generator, and its truth beside it as `DIR.truth.json`:
//! `hide_any --generator a|b|c|d|e --seed N [--kind null|single|pair|outside|removed|closed] [--effect NAME]... [--rho R]
//! [--clean] DIR`.
//!
//! `--clean` writes the same data set with nothing hidden: same motor, same experiment, same noise.

use std::path::PathBuf;
use twum_tests::truth::{Kind, Request};

fn main() {
    if let Err(error) = hide() {
        eprintln!("{error}");
        std::process::exit(2);
    }
}

fn hide() -> Result<(), String> {
    let (mut generator, mut seed, mut clean, mut folder) = ("b".to_owned(), 1, false, None);
    let mut request = Request::of(Kind::Single);
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().ok_or_else(|| format!("{arg} needs a value"));
        match arg.as_str() {
            "--generator" => generator = value()?,
            "--seed" => seed = value()?.parse().map_err(|e| format!("--seed: {e}"))?,
            "--kind" => {
                let word = value()?;
                request.kind = Kind::parse(&word).ok_or_else(|| format!("no kind {word}"))?;
            }
            "--effect" => request.effects.push(value()?),
            "--rho" => request.rho = Some(value()?.parse().map_err(|e| format!("--rho: {e}"))?),
            "--clean" => clean = true,
            option if option.starts_with("--") => {
                return Err(format!("{option}: not an option of hide_any (see the head of examples/hide_any.rs)"));
            }
            _ => folder = Some(PathBuf::from(arg)),
        }
    }
    let folder = folder.ok_or("hide_any needs the folder to write")?;
    let made = twum_tests::suite::make(&generator, seed, &request, clean)?;
    let truth = made.write(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    println!("{} and {}", folder.display(), truth.display());
    Ok(())
}
