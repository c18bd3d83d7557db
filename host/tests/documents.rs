//! What a document says a command prints is what it prints.
//!
//! In a block marked `console`, a line `$ twum ...` is followed by what it writes to standard output. The commands of a document
//! run in one new folder, in its order; numbers may differ by [`SAME`]. `TWUM_DOCUMENTS=write` writes what they print now into the documents.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Share by which numbers may differ: sines and powers differ in their last bit from one machine's library to the next, and a loop at
/// its limits makes a fiftieth of that.
const SAME: f64 = 0.05;

/// Whether two lines say the same.
fn alike(was: &str, is: &str) -> bool {
    let number = |word: &str| word.trim_matches(|c: char| !c.is_ascii_digit() && c != '-').parse::<f64>().ok();
    let word = |(a, b): (&str, &str)| {
        a == b || number(a).zip(number(b)).is_some_and(|(x, y)| (x - y).abs() <= SAME * x.abs().max(y.abs()))
    };
    was.split_whitespace().count() == is.split_whitespace().count()
        && was.split_whitespace().zip(is.split_whitespace()).all(word)
}

/// The standard output of a command line in `folder`.
fn printed(folder: &Path, line: &str) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_twum"))
        .args(line.split_whitespace())
        .current_dir(folder)
        .env("XDG_CONFIG_HOME", folder.join("own"))
        .env("XDG_CACHE_HOME", folder.join("cache"))
        .stderr(Stdio::piped())
        .output()
        .unwrap();
    assert!(output.status.success(), "twum {line}\n{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The document with what its commands print now; a line `...` stands for the rest of a command's output.
fn renewed(document: &str, run: impl Fn(&str) -> String) -> String {
    let mut out = String::new();
    let mut lines = document.lines().peekable();
    let mut within = false;
    while let Some(line) = lines.next() {
        out += line;
        out.push('\n');
        within = if within { line != "```" } else { line == "```console" };
        let Some(command) = line.strip_prefix("$ twum ").filter(|_| within) else { continue };
        let mut said = 0;
        let mut cut = false;
        while let Some(next) = lines.next_if(|next| !next.starts_with("$ ") && *next != "```") {
            cut = next == "...";
            said += 1;
        }
        let text = run(command);
        let kept = if cut { said - 1 } else { usize::MAX };
        for text in text.lines().take(kept) {
            out += text.trim_end();
            out.push('\n');
        }
        if cut {
            out += "...\n";
        }
    }
    out
}

fn documents() -> Vec<PathBuf> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    let mut found: Vec<PathBuf> = std::fs::read_dir(docs).unwrap().map(|entry| entry.unwrap().path()).collect();
    found.retain(|path| std::fs::read_to_string(path).is_ok_and(|text| text.contains("```console\n")));
    found.sort();
    found
}

#[cfg(unix)]
#[test]
fn documents_say_what_the_commands_print() {
    assert!(documents().len() >= 3, "{:?}", documents());
    for path in documents() {
        let folder = tempfile::tempdir().unwrap();
        let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples");
        std::os::unix::fs::symlink(examples, folder.path().join("examples")).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let now = renewed(&text, |line| printed(folder.path(), line));
        if std::env::var_os("TWUM_DOCUMENTS").is_some_and(|value| value == "write") {
            std::fs::write(&path, &now).unwrap();
            continue;
        }
        let differs = text.lines().zip(now.lines()).find(|(was, is)| !alike(was, is));
        if differs.is_some() || text.lines().count() != now.lines().count() {
            let name = path.file_name().unwrap().to_string_lossy();
            panic!(
                "docs/{name} is out of date (TWUM_DOCUMENTS=write cargo test -p twum-host --test documents renews it): {differs:?}"
            );
        }
    }
}

/// Fails if the share is of nothing, or words pass for numbers.
#[test]
fn only_numbers_may_differ_a_little() {
    assert!(alike("thesis 14.029 7.2%", "thesis   14.062 7.2%"));
    assert!(!alike("thesis 14.029", "thesis 16.0"));
    assert!(!alike("named dead-zone", "named start-delay"));
}

#[test]
fn a_block_is_renewed_and_the_rest_left_alone() {
    let document = "$ twum a\n\n```console\n$ twum b c\nold\n$ twum d\n1\n...\n```\nend\n";
    let run = |line: &str| format!("{line} 1\n{line} 2\n");
    let expected = "$ twum a\n\n```console\n$ twum b c\nb c 1\nb c 2\n$ twum d\nd 1\n...\n```\nend\n";
    assert_eq!(renewed(document, run), expected);
}
