//! What holds of every command there is: it has help, a page and completions; what it answers, it answers as JSON too; and a full
//! disk behind its standard output is an error, no panic.
#![cfg(target_os = "linux")]

mod simulator;

use serde_json::Value;
use simulator::{Simulator, text};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn twum(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_twum"));
    command.args(arguments).current_dir(folder).stdin(Stdio::null()).env_remove("TWUM_PORT");
    command.env("XDG_CONFIG_HOME", folder.join("own")).env("XDG_CACHE_HOME", folder.join("cache"));
    command
}

fn run(folder: &Path, arguments: &[&str]) -> Output {
    twum(folder, arguments).output().unwrap()
}

/// Every command by its words, `experiment run`, as the pages have them.
fn commands(folder: &Path) -> BTreeSet<String> {
    let man = run(folder, &["man", "pages"]);
    assert!(man.status.success(), "{}", text(&man));
    let pages = std::fs::read_dir(folder.join("pages")).unwrap();
    let names = pages.map(|page| page.unwrap().file_name().into_string().unwrap());
    // Names of commands have hyphens of their own: `twum-identify-force-factor`.
    names
        .filter_map(|name| {
            Some(name.strip_prefix("twum-")?.strip_suffix(".1")?.replace("force-factor", "force_factor"))
        })
        .map(|name| name.replace('-', " ").replace('_', "-"))
        .collect()
}

#[test]
fn every_command_has_help_a_page_and_completions() {
    let folder = tempfile::tempdir().unwrap();
    let commands = commands(folder.path());
    assert!(commands.len() > 40, "{commands:?}");
    let shells =
        ["bash", "elvish", "fish", "powershell", "zsh"].map(|shell| text(&run(folder.path(), &["completions", shell])));
    for command in &commands {
        let mut words: Vec<&str> = command.split(' ').collect();
        let page = folder.path().join(format!("pages/twum-{}.1", words.join("-")));
        let page = std::fs::read_to_string(&page).unwrap_or_else(|error| panic!("{}: {error}", page.display()));
        assert!(page.contains(".SH NAME") && page.contains(".SH SYNOPSIS"), "{command}");
        for shell in &shells {
            assert!(shell.contains(words.last().unwrap()), "{command}: {}", &shell[..80]);
        }
        words.push("--help");
        let help = run(folder.path(), &words);
        assert!(help.status.success() && text(&help).contains(&format!("Usage: twum {command}")), "{}", text(&help));
        // What it does stands before how it is called.
        assert!(!text(&help).starts_with("Usage"), "{command} does not say what it does");
    }
}

#[test]
fn without_arguments_a_newcomer_is_told_what_to_do_next() {
    let folder = tempfile::tempdir().unwrap();
    let output = run(folder.path(), &[]);
    let said = text(&output);
    assert!(output.status.success(), "{said}");
    for next in ["twum demo", "twum track --port sim", "twum ports", "twum experiment run", "twum diagnose"] {
        assert!(said.contains(next), "{next} in\n{said}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left in the folder");
    // What it proposes is understood.
    for line in said.lines().filter_map(|line| line.trim().strip_prefix("twum ")) {
        let words: Vec<&str> = line.split("  ").next().unwrap().split(' ').collect();
        let mut known = words.iter().take_while(|word| word.bytes().all(|b| b.is_ascii_lowercase()));
        let mut help: Vec<&str> = known.next().into_iter().copied().collect();
        help.extend(known.next().filter(|_| help == ["experiment"]));
        help.push("--help");
        assert!(run(folder.path(), &help).status.success(), "{line}");
    }
}

/// What a line answers on its standard output.
#[derive(Clone, Copy, PartialEq)]
enum Says {
    /// JSON with `--json`.
    Json,
    /// The same, after computing for long.
    Slow,
    /// Text that is itself for a program, or a person's page.
    Text,
    /// JSON once, then it goes on until it is ended.
    Serves,
    /// Nothing here: it is refused, because it needs what a test has not.
    Refused,
}
use Says::{Json, Refused, Serves, Slow, Text};

/// A line of every command. `PORT` is a configured board on a pseudo-terminal, `NEW` a name that is not taken, `EXAMPLES` the folder of
/// examples.
const LINES: [(Says, &str); 51] = [
    (Json, "align --port sim"),
    (Json, "capture --port sim --seconds 0.2 --out NEW.mcap"),
    (Json, "compare run.mcap --flavour physical"),
    (Text, "completions zsh"),
    (Json, "config defaults"),
    (Json, "config diff --port PORT other.toml"),
    (Json, "config dump --port PORT"),
    (Json, "config load --port PORT board.toml"),
    (Json, "config path"),
    (Json, "config show --port PORT"),
    (Slow, "demo --hide none --seed 1 --out NEW"),
    (Json, "diagnose run.mcap --quick"),
    (Json, "driver --port sim u100,ap"),
    (Json, "experiment plan --duties 0.5,1 --trials 2"),
    (Refused, "experiment pulses EXAMPLES/first"),
    (Json, "experiment run --port sim --duties 0.6 --trials 1 --seconds 0.5 --out NEW"),
    (Json, "export run.mcap --to csv NEW"),
    (Refused, "flash --port sim"),
    (Slow, "identify force-factor EXAMPLES/first"),
    (Json, "identify friction EXAMPLES/friction"),
    (Slow, "identify motor EXAMPLES/gear-motor"),
    (Json, "identify stator EXAMPLES/stator.csv --shunt 2000"),
    (Json, "import EXAMPLES/first"),
    (Json, "info --port sim"),
    (Refused, "instruments off 127.0.0.1:1"),
    (Serves, "instruments simulate --generator-port 0 --scope-port 0"),
    (Refused, "instruments sweep NEW.csv --generator 127.0.0.1:1 --scope 127.0.0.1:1"),
    (Json, "live run.mcap --once"),
    (Text, "man"),
    (Slow, "model braking"),
    (Slow, "model check"),
    (Json, "model loop --seconds 0.1"),
    (Json, "model robust --control default --draws 1 --seconds 0.2"),
    (Json, "model speed --seconds 0.05"),
    (Json, "model sweep --seconds 0.02 --points 3"),
    (Json, "model torque --seconds 0.02 --points 3"),
    (Json, "neck --exercise rotation"),
    (Json, "neck exercises"),
    (Json, "neck path --exercise rotation --rate-hz 5"),
    (Json, "neck study study.toml"),
    (Json, "plot run.mcap NEW.svg"),
    (Json, "ports"),
    (Json, "reboot --port sim"),
    (Json, "replay run.mcap"),
    (Serves, "serve --port sim --listen 127.0.0.1:0 --folder NEW"),
    (Serves, "sim --pty"),
    (Json, "speed --port sim --duty 0.5 --seconds 0.5"),
    (Json, "stop --port sim"),
    (Json, "track --port sim --seconds 0.5"),
    (Slow, "tune --port sim --out NEW --draws 10 --seconds 0.5"),
    (Json, "velocity run.mcap"),
];

/// A folder with what the lines read, and the board they ask.
struct Bench {
    folder: tempfile::TempDir,
    simulator: Simulator,
    named: std::cell::Cell<u32>,
}

impl Bench {
    fn new() -> Self {
        let bench = Self { folder: tempfile::tempdir().unwrap(), simulator: Simulator::start(), named: 0.into() };
        let write = |name: &str, text: &str| std::fs::write(bench.folder.path().join(name), text).unwrap();
        write("board.toml", "pwm_hz = 50\n");
        write("other.toml", "pwm_hz = 100\n");
        write("study.toml", "exercises = [\"rotation\"]\nedges_per_rev = [400]\ndisturbance_deg = [0.0, 1000.0]\n");
        std::fs::create_dir_all(bench.folder.path().join("own/twum")).unwrap();
        write("own/twum/config.toml", "edges_per_rev = 400\n");
        let speed = ["speed", "--port", "sim", "--duty", "1", "--seconds", "2", "--out", "run.mcap"];
        assert!(run(bench.folder.path(), &speed).status.success());
        bench.simulator.say(&["config", "load", bench.folder.path().join("board.toml").to_str().unwrap()]);
        bench
    }

    fn words(&self, line: &str) -> Vec<String> {
        self.named.set(self.named.get() + 1);
        let examples = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples");
        let word = |word: &str| {
            let new = format!("new-{}", self.named.get());
            word.replace("PORT", &self.simulator.port).replace("NEW", &new).replace("EXAMPLES", examples)
        };
        line.split(' ').map(word).collect()
    }

    fn command(&self, line: &str, more: &[&str]) -> Command {
        let words = self.words(line);
        let mut words: Vec<&str> = words.iter().map(String::as_str).collect();
        words.extend(more);
        let mut command = twum(self.folder.path(), &words);
        command.env("XDG_RUNTIME_DIR", self.simulator.runtime.path());
        command
    }
}

/// The first line that a command says which then goes on, and its end.
fn first_line(mut command: Command) -> String {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    child.kill().unwrap();
    child.wait().unwrap();
    line
}

#[test]
fn the_lines_are_of_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let commands = commands(folder.path());
    for command in &commands {
        let is_a_group = commands.iter().any(|other| other.starts_with(&format!("{command} ")));
        let has_a_line = LINES.iter().any(|(_, line)| *line == command || line.starts_with(&format!("{command} ")));
        assert!(has_a_line, "no line of `twum {command}`{}", if is_a_group { " or below it" } else { "" });
    }
}

fn answers_as_json(bench: &Bench, says: Says, line: &str) {
    let said = match says {
        Text | Refused => return,
        Serves => first_line(bench.command(line, &["--json"])),
        Json | Slow => {
            let output = bench.command(line, &["--json"]).output().unwrap();
            // A comparison may say no.
            assert!(matches!(output.status.code(), Some(0 | 1)), "twum {line}: {}", text(&output));
            String::from_utf8(output.stdout).unwrap()
        }
    };
    let answer: Value = serde_json::from_str(&said).unwrap_or_else(|error| panic!("twum {line}: {error}\n{said}"));
    assert!(answer.is_object() || answer.is_array(), "twum {line}: {said}");
    if line.starts_with("neck study") {
        assert!(answer[0]["refused"].is_null() && answer[1]["mse_m2"].is_null(), "nothing is null: {said}");
    }
}

fn bears_a_full_disk(bench: &Bench, says: Says, line: &str) {
    for more in [&[][..], &["--json"]] {
        if !more.is_empty() && matches!(says, Text | Refused) {
            continue;
        }
        let mut command = bench.command(line, more);
        command.stdout(File::options().write(true).open("/dev/full").unwrap()).stderr(Stdio::piped());
        let output = command.output().unwrap();
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(!told.contains("panicked"), "twum {line} {more:?}: {told}");
        // What prints nothing, such as `plot` and `export` without `--json`, is not concerned.
        let silent = more.is_empty() && (line.starts_with("plot") || line.starts_with("export"));
        let code = output.status.code();
        assert!(code == Some(2) || silent && code == Some(0), "twum {line} {more:?}: {code:?}, {told}");
        assert!(silent || told.contains("error: "), "twum {line} {more:?}: {told}");
    }
}

#[test]
fn whatever_answers_answers_as_json_too() {
    let bench = Bench::new();
    let quick = LINES.iter().filter(|(says, _)| *says != Slow);
    quick.for_each(|(says, line)| answers_as_json(&bench, *says, line));
}

#[test]
fn a_full_disk_behind_standard_output_is_an_error_and_no_panic() {
    let bench = Bench::new();
    let quick = LINES.iter().filter(|(says, _)| *says != Slow);
    quick.for_each(|(says, line)| bears_a_full_disk(&bench, *says, line));
}

#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_computes_for_long_answers_as_json_and_bears_a_full_disk_too() {
    let bench = Bench::new();
    for (says, line) in LINES.iter().filter(|(says, _)| *says == Slow) {
        answers_as_json(&bench, *says, line);
        bears_a_full_disk(&bench, *says, line);
    }
}
