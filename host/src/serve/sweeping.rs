//! A stator's sweep that a page starts. The command line makes it, in a program of its own, which ends with the generator's
//! outputs off when this server lets go of its standard input: to stop it, and also when the server itself is killed; and when
//! nothing is said there any more, as by a server that is frozen.

use super::answer::{Answer, Refused, conflict};
use super::board::{Doing, Ended};
use super::owner::Aside;
use super::{App, studies};
use crate::instruments::simulate::{Bench, Setup};
use crate::instruments::sweep::Plan;
use axum::extract::State;
use axum::http::StatusCode;
use axum::routing::{get, post};
use axum::{Json, Router};
use serde::Deserialize;
use serde_json::json;
use std::io::Write;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// A stop, and the sweep's own end, are seen within this time.
const LOOKED_AT: Duration = Duration::from_millis(20);
/// The sweep is shown life this often: it ends when it sees none for a second.
const SIGN_OF_LIFE: Duration = Duration::from_millis(100);
/// A sweep that is told to end does so after the frequency under way: an instrument is waited for 5 s, an output's two
/// answers for 3 s each. One that takes longer is killed, and the generator is told from here.
const PATIENCE: Duration = Duration::from_secs(12);
/// Who stops it hears of its end within this time: the patience, and the generator told once more.
const ENDING: Duration = Duration::from_secs(25);
/// Longest time for the stator to ring in, ms.
const LONGEST_SETTLE_MS: u64 = 10_000;

/// What can be asked of sweeps to be made.
pub fn routes() -> Router<Arc<App>> {
    Router::new().route("/api/sweep/setup", get(setup)).route("/api/sweep/run", post(run))
}

/// The instruments as the server was told of them.
#[derive(Clone, Debug, Default)]
pub struct Instruments {
    /// Generator.
    pub generator: Option<String>,
    /// Oscilloscope.
    pub scope: Option<String>,
    /// Whether the board is a simulated one: simulated instruments are offered then, and only then.
    pub is_simulated: bool,
}

/// What makes sweeps.
pub struct Sweeping {
    known: Instruments,
    simulated: Mutex<Option<Bench>>,
    /// How the last one ended, and whether its generator is off.
    last: Mutex<Option<(String, bool)>>,
}

impl Sweeping {
    /// With these instruments.
    pub fn new(known: Instruments) -> Self {
        Self { known, simulated: Mutex::default(), last: Mutex::default() }
    }

    /// The addresses of generator and oscilloscope that a page asks for.
    fn addresses(&self, wanted: &Wanted) -> Result<[String; 2], String> {
        let names = [&wanted.generator, &wanted.scope].map(|name| name.trim());
        if names.contains(&"sim") {
            if names != ["sim"; 2] || !self.known.is_simulated {
                return Err("`sim` is both instruments, of a server of `--port sim`".to_owned());
            }
            let mut simulated = self.simulated.lock().expect("nothing panics while it holds the simulated bench");
            if simulated.is_none() {
                let bench = Bench::start(Setup::default()).map_err(|error| format!("no simulated bench: {error}"))?;
                *simulated = Some(bench);
            }
            let bench = simulated.as_ref().expect("it was started");
            return Ok([bench.generator.to_string(), bench.scope.to_string()]);
        }
        for (name, known) in names.iter().zip([&self.known.generator, &self.known.scope]) {
            if known.as_deref() != Some(name) && !is_address(name) {
                let name = crate::input::printable(name);
                return Err(format!("`{name}` is no address of an instrument: /dev/usbtmcN, host or host:port"));
            }
        }
        Ok(names.map(str::to_owned))
    }
}

/// Whether a page may name it: a device of the instruments' own class, or a host. No other path, and no option.
fn is_address(name: &str) -> bool {
    let is_host = |name: &str| {
        name.starts_with(|c: char| c.is_ascii_alphanumeric() || c == '[')
            && name.chars().all(|c| c.is_ascii_alphanumeric() || ".-:[]_".contains(c))
    };
    match name.strip_prefix("/dev/usbtmc") {
        Some(number) => !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()),
        None => is_host(name) && name.len() < 256,
    }
}

/// A sweep.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Wanted {
    page: String,
    /// Its file in the folder; one that was begun with the same plan is gone on with.
    name: String,
    generator: String,
    scope: String,
    from_hz: f64,
    to_hz: f64,
    step_hz: f64,
    vpp: f64,
    settle_ms: u64,
    /// Leave the generator's second channel off.
    single_phase: bool,
}

impl Wanted {
    fn check(&self) -> Result<(), String> {
        if !self.name.ends_with(".csv") || self.name.contains('/') {
            return Err("a sweep's file lies in the folder itself and ends in `.csv`".to_owned());
        }
        if self.settle_ms > LONGEST_SETTLE_MS {
            return Err(format!("settle_ms = {}: at most {LONGEST_SETTLE_MS}", self.settle_ms));
        }
        let Self { from_hz, to_hz, step_hz, vpp, settle_ms, .. } = *self;
        let plan = Plan { from_hz, to_hz, step_hz, vpp, settle: Duration::from_millis(settle_ms) };
        plan.frequencies().map(|_| ()).map_err(|error| error.to_string())
    }

    /// The command line that makes it.
    fn words(&self, file: &Path, [generator, scope]: &[String; 2]) -> Vec<String> {
        let mut words: Vec<String> = ["instruments", "sweep", "--attended", "--progress"].map(str::to_owned).into();
        words.extend([format!("--generator={generator}"), format!("--scope={scope}")]);
        words.extend(
            [("from", self.from_hz), ("to", self.to_hz), ("step", self.step_hz), ("vpp", self.vpp)]
                .map(|(name, value)| format!("--{name}={value}")),
        );
        words.push(format!("--settle-ms={}", self.settle_ms));
        words.extend(self.single_phase.then(|| "--single-phase".to_owned()));
        words.extend(["--".to_owned(), file.to_string_lossy().into_owned()]);
        words
    }
}

async fn setup(State(app): State<Arc<App>>) -> Answer {
    let (known, plan) = (&app.sweeping.known, Plan::default());
    let simulated = known.is_simulated.then_some("sim");
    let free = (1..).map(|number| format!("stator-{number}.csv")).find(|name| app.folder.existing(name).is_err());
    Ok(Json(json!({
        "name": free,
        "generator": known.generator.as_deref().or(simulated),
        "scope": known.scope.as_deref().or(simulated),
        "from_hz": plan.from_hz,
        "to_hz": plan.to_hz,
        "step_hz": plan.step_hz,
        "vpp": plan.vpp,
        "settle_ms": plan.settle.as_millis() as u64,
    })))
}

async fn run(State(app): State<Arc<App>>, Json(wanted): Json<Wanted>) -> Answer {
    app.holder.check(&wanted.page, app.board.command_timeout()).map_err(conflict)?;
    let file = app.folder.place(&wanted.name)?;
    wanted.check()?;
    let addresses = app.sweeping.addresses(&wanted)?;
    let aside = app.owner.set_aside().map_err(conflict)?;
    let child = std::env::current_exe().and_then(|program| {
        let mut command = Command::new(program);
        command.args(wanted.words(&file, &addresses)).stdin(Stdio::piped()).stdout(Stdio::null());
        command.stderr(Stdio::piped()).spawn()
    });
    let child = child.map_err(|error| format!("it cannot be begun: {error}"))?;
    app.board.doing(Some(Doing::new(format!("{}: instruments", what(&wanted.name)))));
    let [generator, _] = addresses;
    let (name, app) = (wanted.name, Arc::clone(&app));
    std::thread::spawn(move || follow(&app, child, &name, &generator, aside));
    Ok(Json(json!({ "accepted": true })))
}

fn what(name: &str) -> String {
    format!("sweep, the generator drives the stator, into {name}")
}

/// Follows a sweep to its end, which is stopped by closing its input, and sees to it that the generator is off then.
fn follow(app: &Arc<App>, mut child: Child, name: &str, generator: &str, aside: Aside) {
    let (mut input, err) = (child.stdin.take(), child.stderr.take());
    let reader = {
        let (app, name) = (Arc::clone(app), name.to_owned());
        std::thread::spawn(move || {
            let said = |_, doing: &str| app.board.goes_on(format!("{}: {doing}", what(&name)));
            err.map_or_else(String::new, |err| studies::follow(err, said))
        })
    };
    // The first sign of life is shown at once: before it none is missed.
    let (mut told, mut shown) = (None::<Instant>, None::<Instant>);
    let status = loop {
        if let Some(input) = input.as_mut().filter(|_| shown.is_none_or(|shown| shown.elapsed() >= SIGN_OF_LIFE)) {
            shown = Some(Instant::now());
            // One that has ended hears nothing.
            let _ = input.write_all(b"\n");
        }
        if aside.is_stopped() && told.is_none() {
            told = Some(Instant::now());
            drop(input.take());
        }
        match child.try_wait() {
            Ok(Some(status)) => break Some(status),
            Ok(None) => {}
            Err(_) => break None,
        }
        if told.is_some_and(|told| told.elapsed() > PATIENCE) {
            // It may have ended by itself.
            let _ = child.kill();
        }
        std::thread::sleep(LOOKED_AT);
    };
    let said = reader.join().unwrap_or_default();
    let is_whole = status.is_some_and(|status| status.success());
    let last = if is_whole { "done" } else { said.lines().last().unwrap_or("error: killed") };
    let last = last.trim_start_matches("error: ").to_owned();
    let off = if is_whole { Ok(()) } else { switch_off(generator) };
    let words = match &off {
        Ok(()) => format!("sweep into {name}: {last}; the generator is off"),
        Err(why) => format!("sweep into {name}: {last}; LOOK WHETHER THE GENERATOR IS OFF, it cannot be told: {why}"),
    };
    *app.sweeping.last.lock().expect("nothing panics while it holds the words") = Some((words.clone(), off.is_ok()));
    aside.ends(Ended { recording: None, ok: is_whole, words });
}

/// Tells the generator once more, whatever became of the sweep.
fn switch_off(generator: &str) -> Result<(), String> {
    let told = std::env::current_exe()
        .and_then(|program| {
            Command::new(program).args(["instruments", "off", "--", generator]).stdin(Stdio::null()).output()
        })
        .map_err(|error| error.to_string())?;
    if told.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&told.stderr);
    Err(said.lines().last().unwrap_or("it ended without a word").trim_start_matches("error: ").to_owned())
}

/// How the sweep that was told to stop has ended.
///
/// # Errors
/// When it has not ended yet, or its generator is not known to be off.
pub async fn ended(app: &App) -> Result<String, Refused> {
    let until = Instant::now() + ENDING;
    while app.owner.has_aside() {
        if Instant::now() > until {
            let words = "the sweep has not ended yet: look whether the generator is off".to_owned();
            return Err(Refused(StatusCode::GATEWAY_TIMEOUT, words));
        }
        tokio::time::sleep(LOOKED_AT).await;
    }
    match app.sweeping.last.lock().expect("nothing panics while it holds the words").clone() {
        Some((words, true)) => Ok(words),
        Some((words, false)) => Err(conflict(words)),
        None => Ok("no sweep was begun".to_owned()),
    }
}

/// Waits for the end of a sweep that was told to stop: the generator is off then, or cannot be told.
pub fn wait(app: &App) {
    while app.owner.has_aside() {
        std::thread::sleep(LOOKED_AT);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_names_instruments_and_no_other_files() {
        for (name, is) in [
            ("/dev/usbtmc0", true),
            ("/dev/usbtmc12", true),
            ("192.168.1.20", true),
            ("scope.lab:5555", true),
            ("[::1]:5555", true),
            ("", false),
            ("/dev/usbtmc", false),
            ("/dev/usbtmc0/../sda", false),
            ("/dev/ttyUSB0", false),
            ("/etc/passwd", false),
            ("../x", false),
            ("--generator", false),
            ("a b", false),
            ("a/b", false),
        ] {
            assert_eq!(is_address(name), is, "{name:?}");
        }
    }
}
