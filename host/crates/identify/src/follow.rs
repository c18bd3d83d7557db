//! A sweep while it is made: the frequencies that are whole in a waveform file that grows.

use super::read::{ReadError, Shunt, point};
use super::sweep::{Point, Waveform};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Read at once, bytes: some hundred frequencies. What is there beyond is read the next time.
const AT_ONCE: u64 = 8 << 20;
/// The columns of the file, and how a frequency is closed and a plan told (`twum instruments sweep`).
const COLUMNS: &str = "frequency_hz,time_s,v1,v2";
const DONE: &str = "# done ";
const PLAN: &str = "# sweep ";

/// Follows a waveform file that a sweep writes.
#[derive(Debug)]
pub struct Following {
    path: PathBuf,
    shunt_ohm: f64,
    shunt: Shunt,
    /// Bytes taken from the file.
    taken: u64,
    /// What came after the last whole line.
    rest: Vec<u8>,
    has_columns: bool,
    waveform: Waveform,
    points: Vec<Point>,
    unreadable: usize,
    planned: Option<usize>,
}

impl Following {
    /// Follows the file at `path` from its beginning; voltages are over a shunt of so many ohm.
    pub fn new(path: &Path, shunt_ohm: f64, shunt: Shunt) -> Self {
        Self {
            path: path.to_owned(),
            shunt_ohm,
            shunt,
            taken: 0,
            rest: Vec::new(),
            has_columns: false,
            waveform: empty(),
            points: Vec::new(),
            unreadable: 0,
            planned: None,
        }
    }

    /// Takes what is new in the file. A file that is shorter than before was begun anew, and so is this.
    ///
    /// # Errors
    /// When it cannot be read, or is no sweep of waveforms.
    pub fn advance(&mut self) -> Result<(), ReadError> {
        let path = self.path.clone();
        let io = |cause| ReadError::Io { path: path.clone(), cause };
        let mut file = twum_files::input::open(&path).map_err(io)?;
        if file.metadata().map_err(io)?.len() < self.taken {
            *self = Self::new(&path, self.shunt_ohm, self.shunt);
        }
        file.seek(SeekFrom::Start(self.taken)).map_err(io)?;
        let read = file.take(AT_ONCE).read_to_end(&mut self.rest).map_err(io)?;
        self.taken += read as u64;
        let whole = self.rest.iter().rposition(|&byte| byte == b'\n').map_or(0, |last| last + 1);
        let rest = self.rest.split_off(whole);
        let lines = std::mem::replace(&mut self.rest, rest);
        String::from_utf8_lossy(&lines).lines().try_for_each(|line| self.take(line))
    }

    fn take(&mut self, line: &str) -> Result<(), ReadError> {
        if let Some(plan) = line.strip_prefix(PLAN) {
            self.planned = frequencies(plan);
        } else if line.starts_with(DONE) {
            let waveform = std::mem::replace(&mut self.waveform, empty());
            match point(&waveform, self.shunt_ohm, self.shunt) {
                Ok(point) => self.points.push(point),
                Err(_) => self.unreadable += 1,
            }
        } else if line.starts_with('#') {
        } else if !self.has_columns {
            self.has_columns = line.trim() == COLUMNS;
            if !self.has_columns {
                let message = format!(
                    "only waveforms ({COLUMNS}, as `twum instruments sweep` writes them) are shown while they are taken; \
                     a circuit is fitted to whatever `twum identify stator` reads"
                );
                return Err(ReadError::File { path: self.path.clone(), message });
            }
        } else {
            let mut cells = line.split(',').map(|cell| cell.trim().parse::<f64>().unwrap_or(f64::NAN));
            let mut cell = || cells.next().unwrap_or(f64::NAN);
            let (frequency_hz, time_s, v1, v2) = (cell(), cell(), cell(), cell());
            // A cell that is no number makes its frequency one that says nothing.
            self.waveform.frequency_hz = frequency_hz;
            self.waveform.time_s.push(time_s);
            self.waveform.v1.push(v1);
            self.waveform.v2.push(v2);
        }
        Ok(())
    }

    /// The frequencies that are whole so far, in the order they were taken.
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// Frequencies whose samples determine no admittance.
    pub fn unreadable(&self) -> usize {
        self.unreadable
    }

    /// How many frequencies the sweep is to have, where its first line says so.
    pub fn planned(&self) -> Option<usize> {
        self.planned
    }
}

fn empty() -> Waveform {
    Waveform { frequency_hz: f64::NAN, time_s: Vec::new(), v1: Vec::new(), v2: Vec::new() }
}

/// Of `30000 to 50000 Hz by 10 Hz at 6 Vpp`.
fn frequencies(plan: &str) -> Option<usize> {
    let words: Vec<&str> = plan.split_whitespace().collect();
    let [from, "to", to, "Hz", "by", step, "Hz", ..] = words[..] else { return None };
    let (from, to, step): (f64, f64, f64) = (from.parse().ok()?, to.parse().ok()?, step.parse().ok()?);
    let steps = (to - from) / step;
    (0.0..1e6).contains(&steps).then(|| (steps + 1e-9) as usize + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;
    use std::fmt::Write as _;
    use std::io::Write as _;

    /// A frequency as a sweep writes it, of a stator of 2 kΩ behind a shunt of 2 kΩ: half the voltage.
    fn frequency(hz: f64) -> String {
        let mut text = String::new();
        for i in 0..200 {
            let time_s = f64::from(i) * 1e-6;
            let volt = 3.0 * (TAU * hz * time_s).sin();
            writeln!(text, "{hz},{time_s:.5e},{volt:.6},{:.6}", 0.5 * volt).unwrap();
        }
        writeln!(text, "# done {hz}").unwrap();
        text
    }

    #[test]
    fn whole_frequencies_are_points_and_torn_ones_wait() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.csv");
        let mut file = std::fs::File::create(&path).unwrap();
        let mut following = Following::new(&path, 2000.0, Shunt::High);
        following.advance().unwrap();
        assert_eq!((following.points().len(), following.planned()), (0, None));
        write!(file, "# sweep 30000 to 50000 Hz by 10 Hz at 6 Vpp\n{COLUMNS}\n{}", frequency(30e3)).unwrap();
        let second = frequency(30_010.0);
        let (torn, end) = second.split_at(second.len() / 2);
        write!(file, "{torn}").unwrap();
        following.advance().unwrap();
        assert_eq!((following.points().len(), following.planned()), (1, Some(2001)));
        let y = following.points()[0].admittance_s;
        assert!((y.re * 2000.0 - 1.0).abs() < 1e-3 && (y.im * 2000.0).abs() < 1e-3, "{y}");
        write!(file, "{end}30020,0,bad\n# done 30020\n").unwrap();
        following.advance().unwrap();
        following.advance().unwrap();
        assert_eq!((following.points().len(), following.unreadable()), (2, 1));
        std::fs::write(&path, format!("{COLUMNS}\n")).unwrap();
        following.advance().unwrap();
        assert_eq!(following.points().len(), 0, "begun anew");
        std::fs::write(&path, "z\n1\n").unwrap();
        let error = Following::new(&path, 2000.0, Shunt::High).advance().unwrap_err();
        assert!(error.to_string().contains("only waveforms"), "{error}");
    }
}
