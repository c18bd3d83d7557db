//! The suite: data sets of the generators through the `twum` command, as a user calls it, and the tables of what came out.
//!
//! ```text
//! suite --generator a|b|c|d|e [--kind KIND]... [--count N] [--from SEED] [--shard I/N] [--jobs J] [--twum PATH] [--twins N] --out DIR
//! suite --table DIR... [--list] [--write-docs [FILE]]
//! ```
//!
//! Without `--kind` all kinds are run, each as often as in the documented run; `--count` sets how often, `--from` the
//! first seed. One JSON line a data set is appended to a file in DIR, and what is there already is not done again, so the
//! suite may be killed and started again at any time, and shards may run side by side or on several machines.
//! Every fourth single effect is diagnosed a second time with the effect taken away (`--twins`, 0 for never): what an
//! oracle would remove.

use std::path::PathBuf;
use twum_tests::suite::runner::{Runner, read};
use twum_tests::suite::{Case, full, judge, tables};
use twum_tests::truth::Kind;

fn main() {
    if let Err(error) = suite() {
        eprintln!("{error}");
        std::process::exit(2);
    }
}

struct Asked {
    generators: Vec<String>,
    kinds: Vec<Kind>,
    count: Option<u64>,
    from: u64,
    runner: Runner,
    tables: Vec<PathBuf>,
    list: bool,
    docs: Option<PathBuf>,
}

fn suite() -> Result<(), String> {
    let asked = asked()?;
    if !asked.tables.is_empty() {
        return table(&asked);
    }
    let mut cases = Vec::new();
    for generator in &asked.generators {
        for kind in &asked.kinds {
            let count = asked.count.unwrap_or_else(|| full(*kind));
            cases.extend(
                (0..count).map(|k| (k, Case { generator: generator.clone(), kind: *kind, seed: asked.from + k })),
            );
        }
    }
    // All kinds advance together: a suite that is stopped early has some of each.
    cases.sort_by_key(|(k, case)| (*k, case.kind));
    asked.runner.run(&cases.into_iter().map(|(_, case)| case).collect::<Vec<Case>>())
}

fn table(asked: &Asked) -> Result<(), String> {
    let mut outcomes = read(&asked.tables)?;
    outcomes.retain(|o| asked.generators.contains(&o.truth.generator) && asked.kinds.contains(&o.truth.kind));
    outcomes.sort_by_key(|o| (o.truth.generator.clone(), o.truth.kind, o.truth.seed));
    if asked.list {
        outcomes.iter().for_each(|o| println!("{}", judge::line(o)));
    }
    let text = tables::markdown(&outcomes);
    println!("{text}");
    let Some(path) = &asked.docs else { return Ok(()) };
    let head = format!(
        "# How often the diagnosis finds what is hidden, and how often it errs\n\n\
         Printed by `cargo run --release -p twum-tests --example suite -- --table DIR --write-docs` from {} data sets of generator {}, \
         of which [generators.md](generators.md) says what was chosen on it. Each data set is another motor, experiment and form of what is hidden, \
         diagnosed by `twum diagnose FOLDER` with its defaults and the shipped motor file. Intervals are 95 % Wilson intervals.\n\n",
        outcomes.len(),
        asked.generators.join(" and "),
    );
    std::fs::write(path, head + &text).map_err(|e| format!("{}: {e}", path.display()))
}

fn asked() -> Result<Asked, String> {
    let mut asked = Asked {
        generators: Vec::new(),
        kinds: Vec::new(),
        count: None,
        from: 1,
        runner: Runner {
            twum: PathBuf::from("target/release/twum"),
            out: PathBuf::new(),
            jobs: std::thread::available_parallelism().map_or(1, usize::from),
            twins: 4,
            shard: (1, 1),
        },
        tables: Vec::new(),
        list: false,
        docs: None,
    };
    let mut tabling = false;
    let mut args = std::env::args().skip(1).peekable();
    while let Some(arg) = args.next() {
        let mut value = || args.next().ok_or_else(|| format!("{arg} needs a value"));
        let number = |text: String| text.parse::<u64>().map_err(|e| format!("{text}: {e}"));
        match arg.as_str() {
            "--generator" => asked.generators.push(value()?),
            "--kind" => {
                let word = value()?;
                asked.kinds.push(Kind::parse(&word).ok_or_else(|| format!("no kind {word}"))?);
            }
            "--count" => asked.count = Some(number(value()?)?),
            "--from" => asked.from = number(value()?)?,
            "--jobs" => asked.runner.jobs = number(value()?)?.max(1) as usize,
            "--twins" => asked.runner.twins = number(value()?)?,
            "--twum" => asked.runner.twum = PathBuf::from(value()?),
            "--out" => asked.runner.out = PathBuf::from(value()?),
            "--shard" => {
                let text = value()?;
                let parts: Vec<usize> = text.split('/').filter_map(|p| p.parse().ok()).collect();
                asked.runner.shard = match parts[..] {
                    [part, of] if part >= 1 && part <= of => (part, of),
                    _ => return Err(format!("--shard {text}: wanted as 3/8")),
                };
            }
            "--list" => asked.list = true,
            "--write-docs" => {
                let given = args.next_if(|a| a.ends_with(".md"));
                asked.docs = Some(PathBuf::from(given.unwrap_or_else(|| "docs/detection.md".to_owned())));
            }
            "--table" => tabling = true,
            folder if tabling && !folder.starts_with("--") => asked.tables.push(PathBuf::from(folder)),
            other => return Err(format!("{other}: not an option of the suite (see the head of examples/suite.rs)")),
        }
    }
    if asked.generators.is_empty() {
        // The one that is for reporting (docs/generators.md).
        asked.generators.push("e".to_owned());
    }
    if asked.kinds.is_empty() {
        asked.kinds = Kind::ALL.to_vec();
    }
    if asked.tables.is_empty() && asked.runner.out.as_os_str().is_empty() {
        return Err("the suite needs --out DIR, or --table DIR...".to_owned());
    }
    Ok(asked)
}
