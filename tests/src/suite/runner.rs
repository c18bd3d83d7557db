//! Runs the command on each data set and appends one JSON line each to a results file. What is there already is skipped.

use super::Case;
use super::judge::{self, Outcome};
use crate::truth::{Kind, Truth};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Longest that one diagnosis may take: a hundred times what one should, for a machine with much else to do.
const PATIENCE: Duration = Duration::from_secs(3600);

/// Why there is no answer.
enum Failure {
    /// It took too long, which may be the machine's fault: no result, to be asked again another time.
    TimedOut,
    /// What the command said: a result.
    Said(String),
}

/// How to run.
#[derive(Debug, Clone)]
pub struct Runner {
    /// The command.
    pub twum: PathBuf,
    /// Folder of the results, and of data sets while they are diagnosed.
    pub out: PathBuf,
    /// Data sets at a time.
    pub jobs: usize,
    /// Every so manieth single effect is diagnosed without the effect too, for the oracle's gain; 0 for none.
    pub twins: u64,
    /// Which part of how many, from 1.
    pub shard: (usize, usize),
}

impl Runner {
    /// Runs all cases of this shard that have no result yet.
    ///
    /// # Errors
    /// Files that cannot be read or written. A data set that cannot be made or diagnosed is a line that says so.
    pub fn run(&self, cases: &[Case]) -> Result<(), String> {
        std::fs::create_dir_all(&self.out).map_err(|e| format!("{}: {e}", self.out.display()))?;
        let done: BTreeSet<Case> = read(std::slice::from_ref(&self.out))?.iter().map(|o| case_of(&o.truth)).collect();
        let (part, of) = self.shard;
        let mine: Vec<&Case> =
            cases.iter().enumerate().filter(|(n, c)| n % of == part - 1 && !done.contains(c)).map(|(_, c)| c).collect();
        eprintln!("{} data sets to do, {} of {} in this shard done before", mine.len(), done.len(), cases.len());
        let path = self.out.join(format!("results-{part}of{of}.jsonl"));
        let file = Mutex::new(opened(&path)?);
        let next = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for worker in 0..self.jobs {
                let (mine, file, next, path) = (&mine, &file, &next, &path);
                scope.spawn(move || {
                    while let Some(case) = mine.get(next.fetch_add(1, Ordering::Relaxed)) {
                        let Some(outcome) = self.outcome(case, worker) else { continue };
                        let mut line = serde_json::to_string(&outcome).expect("an outcome is JSON");
                        line.push('\n');
                        let mut file = file.lock().expect("no worker panics while it writes");
                        if let Err(e) = file.write_all(line.as_bytes()) {
                            eprintln!("{}: {e}", path.display());
                        }
                        eprintln!("{}", judge::line(&outcome));
                    }
                });
            }
        });
        Ok(())
    }

    fn outcome(&self, case: &Case, worker: usize) -> Option<Outcome> {
        let made = match case.make() {
            Ok(made) => made,
            Err(error) => {
                eprintln!("{error}");
                return None;
            }
        };
        let name = format!("{}-{}-{}", case.generator, case.kind.word(), case.seed);
        let folder = self.out.join(format!("tmp-{}-{worker}-{name}", std::process::id()));
        let start = Instant::now();
        let without = (case.kind == Kind::Removed).then(|| made.truth.effects[0].name.clone());
        let answered = made
            .folder
            .write(&folder)
            .map_err(|e| Failure::Said(e.to_string()))
            .and_then(|()| self.ask(&folder, without));
        let seconds = start.elapsed().as_secs_f64();
        let twin = case.kind == Kind::Single && self.twins > 0 && (case.seed / 16).is_multiple_of(self.twins);
        let clean_rmse_rpm = twin.then(|| self.clean(case, &folder)).flatten();
        // A folder that stays behind costs space, no more.
        let _ = std::fs::remove_dir_all(&folder);
        let (answer, error) = match answered {
            Ok(answer) => (answer, None),
            Err(Failure::Said(error)) => (Value::Null, Some(error)),
            Err(Failure::TimedOut) => {
                eprintln!("{name}: no answer within {} s", PATIENCE.as_secs());
                return None;
            }
        };
        Some(Outcome { truth: made.truth, answer, error, seconds, clean_rmse_rpm })
    }

    fn clean(&self, case: &Case, folder: &Path) -> Option<f64> {
        let _ = std::fs::remove_dir_all(folder);
        case.make_clean().ok()?.folder.write(folder).ok()?;
        self.ask(folder, None).ok()?["baseline"]["rmse_speed_rpm"].as_f64()
    }

    /// The command's answer on a folder, as a user would ask.
    fn ask(&self, folder: &Path, without: Option<String>) -> Result<Value, Failure> {
        let mut command = Command::new("nice");
        command.args(["-n", "10"]).arg(&self.twum).arg("diagnose").arg(folder).args(["--json", "--no-cache"]);
        if let Some(name) = without {
            command.args(["--without", &name]);
        }
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        command.env("RAYON_NUM_THREADS", (cores / self.jobs).max(1).to_string());
        let mut child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|e| Failure::Said(format!("{}: {e}", self.twum.display())))?;
        // Both pipes are emptied while it runs: a full one would stop it.
        let gathered = |mut pipe: Box<dyn std::io::Read + Send>| {
            std::thread::spawn(move || {
                let mut text = String::new();
                let _ = pipe.read_to_string(&mut text);
                text
            })
        };
        let out = gathered(Box::new(child.stdout.take().expect("it is piped")));
        let err = gathered(Box::new(child.stderr.take().expect("it is piped")));
        let start = Instant::now();
        let status = loop {
            match child.try_wait().map_err(|e| Failure::Said(e.to_string()))? {
                Some(status) => break Some(status),
                None if start.elapsed() > PATIENCE => {
                    let _ = child.kill();
                    let _ = child.wait();
                    break None;
                }
                None => std::thread::sleep(Duration::from_millis(50)),
            }
        };
        let (out, err) = (out.join().unwrap_or_default(), err.join().unwrap_or_default());
        match status {
            Some(status) if status.success() => {
                serde_json::from_str(&out).map_err(|e| Failure::Said(format!("not JSON: {e}")))
            }
            Some(status) => Err(Failure::Said(format!("{status}: {}", err.trim()))),
            None => Err(Failure::TimedOut),
        }
    }
}

/// The case that an outcome belongs to.
pub fn case_of(truth: &Truth) -> Case {
    Case { generator: truth.generator.clone(), kind: truth.kind, seed: truth.seed }
}

/// A results file at its end; a line that a killed suite left half written is ended first.
fn opened(path: &Path) -> Result<File, String> {
    let say = |e: std::io::Error| format!("{}: {e}", path.display());
    let cut = std::fs::read(path).is_ok_and(|text| !text.is_empty() && !text.ends_with(b"\n"));
    let mut file = OpenOptions::new().create(true).append(true).open(path).map_err(say)?;
    if cut {
        file.write_all(b"\n").map_err(say)?;
    }
    Ok(file)
}

/// All outcomes in the results files of some folders, one a case; half-written lines are left out.
///
/// # Errors
/// A folder that cannot be read.
pub fn read(folders: &[PathBuf]) -> Result<Vec<Outcome>, String> {
    let mut outcomes = Vec::new();
    let mut seen = BTreeSet::new();
    for folder in folders {
        let say = |e: std::io::Error| format!("{}: {e}", folder.display());
        let mut paths: Vec<PathBuf> = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(say)? {
            paths.push(entry.map_err(say)?.path());
        }
        paths.retain(|p| p.extension().is_some_and(|e| e == "jsonl"));
        paths.sort();
        for path in paths {
            let text = std::fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
            for line in text.lines() {
                let Ok(outcome) = serde_json::from_str::<Outcome>(line) else { continue };
                if seen.insert(case_of(&outcome.truth)) {
                    outcomes.push(outcome);
                }
            }
        }
    }
    Ok(outcomes)
}
