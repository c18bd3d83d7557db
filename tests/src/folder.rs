//! Measurement folders as a user would have them: `measurement.toml` beside one CSV a run.
//!
//! Only the format is here; what a run holds is made by the generators, which share nothing but this.

use std::fmt::Write as _;
use std::path::Path;

/// What a run's file holds.
#[derive(Debug, Clone, PartialEq)]
pub enum Record {
    /// Encoder levels on a regular grid.
    Levels {
        /// Sampling period in µs.
        period_us: u64,
        /// One a sample.
        levels: Vec<bool>,
    },
    /// Timestamped transitions.
    Edges {
        /// Level before the first transition.
        first: bool,
        /// Ascending times of the transitions in µs.
        times_us: Vec<u64>,
        /// End of the record in µs.
        end_us: u64,
    },
    /// Logged ticks of a closed loop.
    Control {
        /// The law as `measurement.toml` says it, with its quotes or braces.
        law: String,
        /// One a tick.
        ticks: Vec<Tick>,
    },
}

/// One tick of a closed loop as it is logged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tick {
    /// Time in µs.
    pub time_us: u64,
    /// Target in counts.
    pub target: i32,
    /// Counted position in counts.
    pub position: i32,
    /// Control signal in signed duty steps.
    pub u: f64,
    /// On fraction.
    pub duty: f64,
    /// 1 clockwise, -1 counter-clockwise.
    pub direction: i32,
}

/// One run as `measurement.toml` lists it.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// Identifier, also the file's name.
    pub id: String,
    /// On fraction that was asked for (open loop).
    pub duty: f64,
    /// 1 clockwise, -1 counter-clockwise (open loop).
    pub sign: f64,
    /// PWM frequency in Hz.
    pub pwm_hz: f64,
    /// End of the drive in s (open loop).
    pub drive_on_s: f64,
    /// Place in the order in which the runs were made.
    pub order: usize,
    /// The encoder stood at the beginning of a pulse at t = 0.
    pub aligned: bool,
    /// The file.
    pub record: Record,
}

/// A folder before it is written.
#[derive(Debug, Clone, PartialEq)]
pub struct Folder {
    /// Name.
    pub name: String,
    /// Rising and falling edges a revolution.
    pub edges_per_rev: u32,
    /// Runs in the order of the listing.
    pub runs: Vec<Run>,
}

impl Folder {
    /// Writes the folder. The motor it names is the shipped one, whatever motor made the data.
    ///
    /// # Errors
    /// What the file system says.
    pub fn write(&self, folder: &Path) -> std::io::Result<()> {
        std::fs::create_dir_all(folder)?;
        let mut toml =
            format!("name = \"{}\"\nmotor = \"pcbmotor-30mm\"\nedges_per_rev = {}\n", self.name, self.edges_per_rev);
        for run in &self.runs {
            toml.push_str(&run.entry());
            std::fs::write(folder.join(format!("{}.csv", run.id)), run.record.csv())?;
        }
        std::fs::write(folder.join("measurement.toml"), toml)
    }
}

impl Run {
    fn entry(&self) -> String {
        let id = &self.id;
        if let Record::Control { law, .. } = &self.record {
            return format!(
                "\n[[run]]\nid = \"{id}\"\nkind = \"track\"\nfile = \"{id}.csv\"\nformat = \"control\"\ncontrol = {law}\norder = {}\n",
                self.order
            );
        }
        let format = if matches!(self.record, Record::Levels { .. }) { "levels" } else { "edges" };
        let direction = if self.sign > 0.0 { "cw" } else { "ccw" };
        let aligned = if self.aligned { "aligned = true\n" } else { "" };
        format!(
            "\n[[run]]\nid = \"{id}\"\nkind = \"speed\"\nfile = \"{id}.csv\"\nformat = \"{format}\"\nduty = {:.6}\n\
             direction = \"{direction}\"\npwm_hz = {:.1}\ndrive_on_s = {:.3}\n{aligned}order = {}\n",
            self.duty, self.pwm_hz, self.drive_on_s, self.order
        )
    }
}

impl Record {
    fn csv(&self) -> String {
        let mut text = String::new();
        let mut row = |line: std::fmt::Arguments| {
            text.write_fmt(line).expect("writing to a string cannot fail");
            text.push('\n');
        };
        match self {
            Record::Levels { period_us, levels } => {
                row(format_args!("time_us,level"));
                for (n, level) in levels.iter().enumerate() {
                    row(format_args!("{},{}", n as u64 * period_us, u8::from(*level)));
                }
            }
            Record::Edges { first, times_us, end_us } => {
                row(format_args!("time_us,level"));
                row(format_args!("0,{}", u8::from(*first)));
                let mut level = *first;
                for time in times_us {
                    level = !level;
                    row(format_args!("{time},{}", u8::from(level)));
                }
                row(format_args!("{end_us},{}", u8::from(level)));
            }
            Record::Control { ticks, .. } => {
                row(format_args!("time_us,target,position,u,duty,direction"));
                for t in ticks {
                    row(format_args!(
                        "{},{},{},{:.5},{:.6},{}",
                        t.time_us, t.target, t.position, t.u, t.duty, t.direction
                    ));
                }
            }
        }
        text
    }
}
