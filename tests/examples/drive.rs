//! Writes a measurement folder of an ordinary motor for `twum diagnose`: `drive DIR`. In the motor are Coulomb friction and a
//! top that bends; nothing of the host's model made it.

use std::fmt::Write as _;
use std::path::Path;
use twum_tests::drives::{Drive, Hidden};

fn main() -> std::io::Result<()> {
    let folder = std::env::args().nth(1).ok_or_else(|| std::io::Error::other("drive DIR: no folder given"))?;
    let folder = Path::new(&folder);
    std::fs::create_dir_all(folder)?;
    // Small enough to be kept with the source.
    let drive = Drive::draw(&[Hidden::Coulomb, Hidden::Saturation], 42).lengthened(500, 3);
    let mut toml = String::from("name = \"a gear motor\"\nmotor = \"inertial\"\n");
    for (number, record) in drive.make().iter().enumerate() {
        let mut csv = String::from("time_us,input,speed_rpm\n");
        for ((time, input), rpm) in record.time_us.iter().zip(&record.input).zip(&record.rpm) {
            let _ = writeln!(csv, "{time:.0},{input:.4},{rpm:.3}");
        }
        std::fs::write(folder.join(format!("run-{number}.csv")), csv)?;
        let _ = write!(
            toml,
            "\n[[run]]\nid = \"run-{number}\"\nkind = \"speed\"\nfile = \"run-{number}.csv\"\nformat = \"drive\"\n"
        );
    }
    std::fs::write(folder.join("measurement.toml"), toml)?;
    println!("{}", drive.describe());
    Ok(())
}
