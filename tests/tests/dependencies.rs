//! What the project is built of: licences compatible with MIT OR Apache-2.0, published crates only, no pre-releases. The
//! allowed licences are those of `deny.toml`, which `cargo deny` reads where it can be had.

use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// The strings of an array in `deny.toml`.
fn listed(text: &str, key: &str) -> Vec<String> {
    let start = text.find(&format!("\n{key} = [")).unwrap_or_else(|| panic!("deny.toml: {key}"));
    let end = start + text[start..].find("\n]").or_else(|| text[start..].find("]\n")).expect("the array ends");
    text[start..end].split('"').skip(1).step_by(2).map(str::to_owned).collect()
}

/// Whether an SPDX expression can be met with allowed licences alone. `/` is an old way to write OR.
fn allowed(expression: &str, allow: &[String]) -> bool {
    let spaced = expression.replace('(', " ( ").replace(')', " ) ").replace('/', " OR ");
    let words: Vec<&str> = spaced.split_whitespace().collect();
    let mut at = 0;
    let met = any_of(&words, &mut at, allow);
    met && at == words.len()
}

fn any_of(words: &[&str], at: &mut usize, allow: &[String]) -> bool {
    let mut met = all_of(words, at, allow);
    while words.get(*at) == Some(&"OR") {
        *at += 1;
        met |= all_of(words, at, allow);
    }
    met
}

fn all_of(words: &[&str], at: &mut usize, allow: &[String]) -> bool {
    let mut met = one(words, at, allow);
    while words.get(*at) == Some(&"AND") {
        *at += 1;
        met &= one(words, at, allow);
    }
    met
}

fn one(words: &[&str], at: &mut usize, allow: &[String]) -> bool {
    let Some(word) = words.get(*at) else { return false };
    *at += 1;
    if *word == "(" {
        let met = any_of(words, at, allow);
        let closed = words.get(*at) == Some(&")");
        *at += 1;
        return met && closed;
    }
    let mut licence = (*word).to_owned();
    if words.get(*at) == Some(&"WITH") {
        licence += &format!(" WITH {}", words.get(*at + 1).unwrap_or(&""));
        *at += 2;
    }
    allow.contains(&licence)
}

#[test]
fn every_dependency_is_published_under_a_compatible_licence() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let deny = std::fs::read_to_string(root.join("deny.toml")).unwrap();
    let (allow, exceptions) = (listed(&deny, "allow"), listed(&deny, "exceptions"));
    assert!(allow.len() > 5 && exceptions == ["serialport", "MPL-2.0"], "{allow:?} {exceptions:?}");
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--locked"])
        .current_dir(&root)
        .output()
        .unwrap();
    if !output.status.success() {
        // Crates of other systems are not needed to build here, and not there without a network.
        println!("skipped: {}", String::from_utf8_lossy(&output.stderr).trim());
        return;
    }
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    let (mut checked, mut wrong) = (0, Vec::new());
    for package in metadata["packages"].as_array().unwrap() {
        let text = |key: &str| package[key].as_str().unwrap_or_default();
        let (name, licence) = (text("name"), text("license"));
        let excepted = exceptions.chunks(2).any(|pair| pair == [name, licence]);
        let version = text("version").split('+').next().unwrap_or_default();
        let own = package["source"].is_null();
        if !(allowed(licence, &allow) || excepted) {
            wrong.push(format!("{name}: licence `{licence}`"));
        }
        if version.contains('-') {
            wrong.push(format!("{name}: {version} is a pre-release"));
        }
        if !own && !text("source").starts_with("registry+") {
            wrong.push(format!("{name}: comes from {}", text("source")));
        }
        checked += 1;
    }
    println!("{checked} packages");
    assert!(checked > 100 && wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn expressions_are_read_as_spdx_means_them() {
    let allow = ["MIT".to_owned(), "Zlib".to_owned(), "Apache-2.0 WITH LLVM-exception".to_owned()];
    for (expression, met) in [
        ("MIT", true),
        ("GPL-3.0-only", false),
        ("MIT OR GPL-3.0-only", true),
        ("MIT/GPL-3.0-only", true),
        ("MIT AND GPL-3.0-only", false),
        ("(MIT OR GPL-3.0-only) AND Zlib", true),
        ("GPL-3.0-only OR MIT AND BSD-1-Clause", false),
        ("Apache-2.0 WITH LLVM-exception", true),
        ("Apache-2.0", false),
        ("", false),
    ] {
        assert_eq!(allowed(expression, &allow), met, "{expression}");
    }
}
