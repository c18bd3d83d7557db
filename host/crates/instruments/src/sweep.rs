//! A resumable frequency sweep into a waveform file.
//!
//! Each frequency is written whole and closed by a `# done` comment before the next begins. Started again on the same file,
//! the sweep drops what follows the last such comment and goes on from there.

use super::generator::{Generator, LARGEST_VPP};
use super::oscilloscope::Oscilloscope;
use super::scpi::InstrumentError;
use std::collections::HashSet;
use std::fmt::Write as _;
use std::fs::OpenOptions;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Why a sweep stopped. The generator is off in every case.
#[derive(Debug, thiserror::Error)]
pub enum SweepError {
    /// The plan makes no sense.
    #[error("{0}")]
    Plan(String),
    /// An instrument failed.
    #[error(transparent)]
    Instrument(#[from] InstrumentError),
    /// The file could not be read or written.
    #[error("{}: {cause}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The cause.
        cause: std::io::Error,
    },
    /// The file belongs to another sweep.
    #[error(
        "{}, line {line}: holds another sweep (`{found}`, this one is `{expected}`): choose another file or remove it",
        path.display()
    )]
    OtherSweep {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What it says.
        found: String,
        /// What this sweep would say.
        expected: String,
    },
    /// Somebody asked to stop.
    #[error("stopped after {done} of {total} frequencies; the same sweep into the same file goes on from there")]
    Stopped {
        /// Frequencies in the file.
        done: usize,
        /// Frequencies planned.
        total: usize,
    },
}

/// Frequencies and drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// First frequency (Hz).
    pub from_hz: f64,
    /// Last frequency (Hz).
    pub to_hz: f64,
    /// Step (Hz).
    pub step_hz: f64,
    /// Drive, peak to peak (V).
    pub vpp: f64,
    /// Time for the stator to ring in after each step.
    pub settle: Duration,
}

impl Default for Plan {
    /// The thesis's sweep: 30 to 50 kHz by 10 Hz at 6 Vpp.
    fn default() -> Self {
        Self { from_hz: 30e3, to_hz: 50e3, step_hz: 10.0, vpp: 6.0, settle: Duration::from_millis(5) }
    }
}

impl Plan {
    /// The frequencies (Hz).
    ///
    /// # Errors
    /// When the range, the step or the drive cannot be.
    pub fn frequencies(&self) -> Result<Vec<f64>, SweepError> {
        let fail = |message: String| Err(SweepError::Plan(message));
        if !(self.from_hz > 0.0 && self.to_hz >= self.from_hz && self.to_hz <= 20e6) {
            return fail(format!(
                "a sweep runs upwards between 0 and 20 MHz, not from {} to {} Hz",
                self.from_hz, self.to_hz
            ));
        }
        if !(self.step_hz > 0.0 && self.step_hz.is_finite()) {
            return fail(format!("the step must be positive, got {} Hz", self.step_hz));
        }
        if !(self.vpp > 0.0 && self.vpp <= LARGEST_VPP) {
            return fail(format!("the drive must lie above 0 and at most {LARGEST_VPP} Vpp, got {}", self.vpp));
        }
        let count = ((self.to_hz - self.from_hz) / self.step_hz + 1e-9).floor();
        if count > 1e6 {
            return fail(format!("{count} steps are too many: take a larger step"));
        }
        Ok((0..=count as usize).map(|i| self.from_hz + i as f64 * self.step_hz).collect())
    }

    fn headline(&self) -> String {
        format!("# sweep {} to {} Hz by {} Hz at {} Vpp", self.from_hz, self.to_hz, self.step_hz, self.vpp)
    }
}

/// Runs a sweep into `path`, or goes on with the one begun there; returns how many frequencies it took.
///
/// The generator's outputs are off when this returns, whatever happened: at the end, on an error, when `stop` was set (by
/// Ctrl-C, a termination signal or whoever started it) and on a panic, by the generator's drop. Only a kill that cannot be caught, or a cut
/// cable, leaves them on.
///
/// # Errors
/// [`SweepError`]; what was measured before stays in the file.
pub fn run(
    plan: &Plan,
    path: &Path,
    mut generator: Generator,
    scope: &mut Oscilloscope,
    stop: &AtomicBool,
    mut progress: impl FnMut(usize, usize),
) -> Result<usize, SweepError> {
    let frequencies = plan.frequencies()?;
    let failed = |cause| SweepError::File { path: path.to_owned(), cause };
    let mut file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path).map_err(failed)?;
    if !file.metadata().map_err(failed)?.is_file() {
        return Err(SweepError::Plan(format!("{}: a sweep is written to an ordinary file", path.display())));
    }
    if file.try_lock().is_err() {
        return Err(SweepError::Plan(format!("{}: another sweep is writing it", path.display())));
    }
    let done = resume(plan, path, &mut file)?;
    let todo: Vec<f64> = frequencies.iter().copied().filter(|f| !done.contains(&label(*f))).collect();
    let total = frequencies.len();
    let Some(first) = todo.first() else { return Ok(0) };
    let unless_stopped = |done| match stop.load(Ordering::Relaxed) {
        true => Err(SweepError::Stopped { done, total }),
        false => Ok(()),
    };
    let result = (|| {
        scope.prepare(plan.from_hz, plan.vpp)?;
        generator.prepare(*first, plan.vpp)?;
        unless_stopped(total - todo.len())?;
        generator.on()?;
        for (index, &frequency_hz) in todo.iter().enumerate() {
            let ready = total - todo.len() + index;
            progress(ready, total);
            unless_stopped(ready)?;
            generator.tune(frequency_hz)?;
            std::thread::sleep(plan.settle);
            let [one, two] = scope.acquire()?;
            let mut text = String::with_capacity(40 * one.volt.len());
            let f = label(frequency_hz);
            for ((t, v1), v2) in one.time_s.iter().zip(&one.volt).zip(&two.volt) {
                // Writing to a string cannot fail.
                let _ = writeln!(text, "{f},{t:.5e},{v1:.6},{v2:.6}");
            }
            let _ = writeln!(text, "# done {f}");
            file.write_all(text.as_bytes()).and_then(|()| file.flush()).map_err(failed)?;
        }
        progress(total, total);
        Ok(todo.len())
    })();
    // The first failure is the one to tell; a failure to switch off is worse and comes on top by the drop's warning.
    match result {
        Ok(count) => {
            generator.off()?;
            file.sync_all().map_err(failed)?;
            Ok(count)
        }
        Err(error) => Err(error),
    }
}

/// A frequency as written in the file.
fn label(frequency_hz: f64) -> String {
    format!("{:.3}", frequency_hz).trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// The frequencies already in the file; what follows the last whole one is cut off. A new file gets its head.
fn resume(plan: &Plan, path: &Path, file: &mut std::fs::File) -> Result<HashSet<String>, SweepError> {
    let failed = |cause| SweepError::File { path: path.to_owned(), cause };
    let mut text = String::new();
    file.read_to_string(&mut text).map_err(failed)?;
    let headline = plan.headline();
    let head = format!("{headline}\nfrequency_hz,time_s,v1,v2\n");
    let mut done = HashSet::new();
    let mut keep = 0;
    if text.trim().is_empty() || head.starts_with(&text) {
        file.set_len(0).map_err(failed)?;
        file.rewind().map_err(failed)?;
        file.write_all(head.as_bytes()).map_err(failed)?;
        return Ok(done);
    }
    if !text.starts_with(&head) {
        return Err(SweepError::OtherSweep {
            path: path.to_owned(),
            line: 1,
            found: text.lines().next().unwrap_or_default().to_owned(),
            expected: headline,
        });
    }
    keep += head.len();
    let mut at = head.len();
    for line in text[head.len()..].split_inclusive('\n') {
        at += line.len();
        if let Some(f) = line.strip_prefix("# done ")
            && line.ends_with('\n')
        {
            done.insert(f.trim().to_owned());
            keep = at;
        }
    }
    file.set_len(keep as u64).map_err(failed)?;
    file.seek(SeekFrom::End(0)).map_err(failed)?;
    Ok(done)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_thesis_sweep_has_2001_frequencies() {
        let all = Plan::default().frequencies().unwrap();
        assert_eq!((all.len(), all[0], all[2000]), (2001, 30e3, 50e3));
    }

    #[test]
    fn sixty_volts_are_refused() {
        assert!(Plan { vpp: 60.0, ..Plan::default() }.frequencies().is_err());
    }

    #[test]
    fn a_torn_file_is_cut_back_to_its_last_whole_frequency() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.csv");
        let plan = Plan::default();
        let head = format!("{}\nfrequency_hz,time_s,v1,v2\n", plan.headline());
        std::fs::write(&path, format!("{head}30000,0,1,1\n# done 30000\n30010,0,1,1\n30010,1e-")).unwrap();
        let mut file = OpenOptions::new().read(true).write(true).open(&path).unwrap();
        let done = resume(&plan, &path, &mut file).unwrap();
        assert_eq!(done.into_iter().collect::<Vec<_>>(), ["30000"]);
        assert_eq!(std::fs::read_to_string(&path).unwrap(), format!("{head}30000,0,1,1\n# done 30000\n"));
        let other = Plan { step_hz: 20.0, ..plan };
        let mut file = OpenOptions::new().read(true).write(true).open(&path).unwrap();
        assert!(matches!(resume(&other, &path, &mut file), Err(SweepError::OtherSweep { .. })));
    }
}
