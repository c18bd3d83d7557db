//! Writes a folder of torque records for `twum identify friction`: `friction DIR`. The coefficients in it are those of
//! [`twum_tests::friction::BENCH`].

use std::path::Path;
use twum_tests::friction::{BENCH, Bench};

fn main() -> std::io::Result<()> {
    let folder = std::env::args().nth(1).ok_or_else(|| std::io::Error::other("friction DIR: no folder given"))?;
    // Small enough to be kept with the source.
    let bench = Bench { sample_hz: 25.0, speeds_rpm: &[200, 300, 400], trials: 3, ..BENCH };
    bench.write(Path::new(&folder), 2)
}
