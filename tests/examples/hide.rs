//! Writes a measurement folder in which an effect is hidden: `hide FOLDER SEED [EFFECT|sealed|none] [RHO] [--thesis]`.
//!
//! `sealed` (the default) lets the seed draw effect, strength, sign and shape, and does not tell.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::PathBuf;
use twum_tests::experiment::{Design, Sealed};
use twum_tests::hidden::{Hidden, OPEN_LOOP, OUTSIDE};

fn main() {
    let args: Vec<String> = std::env::args().skip(1).filter(|a| a != "--thesis").collect();
    let (Some(folder), Some(seed)) = (args.first(), args.get(1).and_then(|s| s.parse::<u64>().ok())) else {
        eprintln!("usage: hide FOLDER SEED [EFFECT|sealed|none] [RHO] [--thesis]");
        std::process::exit(2);
    };
    let design = if std::env::args().any(|a| a == "--thesis") { Design::thesis() } else { Design::small() };
    let sealed = Sealed::new(design, seed);
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x0b5c_u64);
    let drawn: f64 = rng.random_range(0.5..2.0);
    let rho = args.get(3).map_or(drawn, |s| s.parse().expect("RHO is a number"));
    let all: Vec<&'static str> = OPEN_LOOP.iter().chain(&OUTSIDE).copied().chain(["dropped-samples"]).collect();
    let name = match args.get(2).map_or("sealed", String::as_str) {
        "sealed" => Some(all[rng.random_range(0..all.len())]),
        "none" => None,
        given => match all.iter().find(|n| **n == given) {
            Some(name) => Some(*name),
            None => {
                eprintln!("no effect {given}: one of {}", all.join(", "));
                std::process::exit(2);
            }
        },
    };
    let hidden: Vec<Hidden> = name
        .map(|name| {
            let mut hidden = Hidden::draw(name, &mut rng);
            sealed.scale_to(&mut hidden, rho);
            hidden
        })
        .into_iter()
        .collect();
    let path = PathBuf::from(folder);
    if let Err(error) = sealed.make(&hidden).write(&path, &format!("seed {seed}")) {
        eprintln!("{}: {error}", path.display());
        std::process::exit(2);
    }
}
