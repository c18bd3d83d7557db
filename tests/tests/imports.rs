//! Imports run one way: between crates, and between the modules of each. What imports each other can neither be understood nor
//! changed nor tested alone.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Module paths (`store::reader` is `["store", "reader"]`, a crate's root is `[]`) with the text of each.
type Modules = BTreeMap<Vec<String>, String>;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Folders of the project's crates.
fn crates() -> Vec<PathBuf> {
    let below = std::fs::read_dir(root().join("host/crates")).unwrap().map(|entry| entry.unwrap().path());
    let mut found: Vec<PathBuf> = ["shared", "firmware", "host", "tests"].map(|name| root().join(name)).to_vec();
    found.extend(below.filter(|path| path.join("Cargo.toml").exists()));
    found.sort();
    found
}

/// Every module of a crate but its tests, comments left out.
fn modules(folder: &Path) -> Modules {
    let source = folder.join("src");
    let (mut found, mut open) = (Modules::new(), vec![source.clone()]);
    while let Some(path) = open.pop() {
        if path.is_dir() {
            open.extend(std::fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().path()));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let inner = path.strip_prefix(&source).unwrap().with_extension("");
            let mut name: Vec<String> = inner.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
            if name.last().is_some_and(|last| ["mod", "lib", "main"].contains(&last.as_str())) {
                name.pop();
            }
            if name.last().is_some_and(|last| last == "tests") {
                continue;
            }
            let text = std::fs::read_to_string(&path).unwrap();
            let program = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
            let lines = program.lines().filter(|line| !line.trim_start().starts_with("//"));
            // A library and a program may share a root.
            *found.entry(name).or_default() += &lines.collect::<Vec<_>>().join("\n");
        }
    }
    found
}

/// The paths that a `use` tree or an expression names: `a::{b, c::{d, e}}` is `a::b`, `a::c::d` and `a::c::e`.
fn paths(tree: &str, before: &[String], out: &mut Vec<Vec<String>>) {
    let mut path = before.to_vec();
    let mut rest = tree.trim_start();
    loop {
        let word = rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len());
        if word > 0 {
            path.push(rest[..word].to_owned());
        }
        rest = rest[word..].trim_start();
        match rest.strip_prefix("::").map(str::trim_start) {
            Some(next) if next.starts_with('{') => {
                let (mut depth, mut from) = (0, 1);
                for (at, c) in next.char_indices() {
                    depth += i32::from(c == '{') - i32::from(c == '}');
                    if (c == ',' && depth == 1) || depth == 0 {
                        paths(&next[from..at], &path, out);
                        from = at + 1;
                    }
                    if depth == 0 {
                        break;
                    }
                }
                return;
            }
            Some(next) => rest = next,
            None => {
                out.push(path);
                return;
            }
        }
    }
}

/// The modules that a module names by `crate::` or `super::`.
fn named(of: &[String], text: &str, all: &Modules) -> BTreeSet<Vec<String>> {
    let mut found = Vec::new();
    for start in ["crate::", "super::"] {
        for (at, _) in text.match_indices(start) {
            let begins = !text[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':');
            if begins {
                paths(&text[at..], &[], &mut found);
            }
        }
    }
    let resolve = |path: Vec<String>| {
        let ups = path.iter().take_while(|part| *part == "super").count();
        let from = if path[0] == "crate" { &[][..] } else { &of[..of.len().saturating_sub(ups)] };
        let mut whole = [from, &path[ups.max(1)..]].concat();
        // What is no module is something in one.
        while !all.contains_key(&whole) && whole.pop().is_some() {}
        whole
    };
    found.into_iter().map(resolve).collect()
}

/// Imports between neighbours: an import counts between the two parts that hold its ends and lie in one folder. A module and
/// what lies within it are one part.
fn between_neighbours(all: &Modules) -> BTreeMap<Vec<String>, BTreeSet<Vec<String>>> {
    let mut imports: BTreeMap<_, BTreeSet<_>> = BTreeMap::new();
    for (from, text) in all {
        for to in named(from, text, all) {
            let common = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
            if common < from.len() && common < to.len() {
                imports.entry(from[..=common].to_vec()).or_default().insert(to[..=common].to_vec());
            }
        }
    }
    imports
}

/// The first circle there is.
fn circle<T: Ord + Clone>(imports: &BTreeMap<T, BTreeSet<T>>) -> Option<Vec<T>> {
    fn follow<T: Ord + Clone>(
        at: &T,
        way: &mut Vec<T>,
        done: &mut BTreeSet<T>,
        imports: &BTreeMap<T, BTreeSet<T>>,
    ) -> Option<Vec<T>> {
        if let Some(begun) = way.iter().position(|passed| passed == at) {
            return Some(way[begun..].to_vec());
        }
        if !done.insert(at.clone()) {
            return None;
        }
        way.push(at.clone());
        let found = imports.get(at).into_iter().flatten().find_map(|next| follow(next, way, done, imports));
        way.pop();
        found
    }
    let mut done = BTreeSet::new();
    imports.keys().find_map(|start| follow(start, &mut Vec::new(), &mut done, imports))
}

#[test]
fn modules_import_one_way() {
    let mut wrong = Vec::new();
    for folder in crates() {
        let mut imports = between_neighbours(&modules(&folder));
        // Each circle is named, so that one run tells all.
        while let Some(found) = circle(&imports) {
            let names: Vec<String> = found.iter().map(|path| path.join("::")).collect();
            wrong.push(format!("{}: {}", folder.display(), names.join(" -> ")));
            imports.get_mut(found.last().unwrap()).unwrap().remove(&found[0]);
        }
    }
    assert!(wrong.is_empty(), "import each other, in a circle:\n{}", wrong.join("\n"));
}

/// Cargo refuses circles of crates but for those through what tests need; the order here is the one of `docs/architecture.md`.
#[test]
fn crates_import_downwards() {
    const ORDER: [&str; 15] = [
        "twum-shared",
        "twum-firmware",
        "twum-files",
        "twum-fit",
        "twum-record",
        "twum-signal",
        "twum-motor",
        "twum-identify",
        "twum-tune",
        "twum-instruments",
        "twum-diagnose",
        "twum-board",
        "twum-neck",
        "twum-host",
        "twum-tests",
    ];
    let place = |name: &str| ORDER.iter().position(|known| *known == name);
    for folder in crates() {
        let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).unwrap();
        let (_, after) = manifest.split_once("\nname = \"").unwrap();
        let name = after.split('"').next().unwrap();
        let own = place(name).unwrap_or_else(|| panic!("{name} has no place in the order"));
        for line in manifest.lines().filter(|line| line.starts_with("twum-")) {
            let other = line.split(['.', ' ', '=']).next().unwrap();
            assert!(place(other).is_some_and(|other| other < own), "{name} imports {other}, which lies above it");
        }
    }
}

#[test]
fn circles_are_found() {
    let module = |name: &str, text: &str| (name.split("::").map(str::to_owned).collect::<Vec<_>>(), text.to_owned());
    let all = Modules::from([
        (Vec::new(), "pub mod a;".to_owned()),
        module("a", "use inner::X;"),
        // A module and what lies within it are one part.
        module("a::inner", "use super::Y;\nuse super::other::Z;"),
        module("a::other", "fn f() -> crate::b::{one::P, Q} { todo!() }"),
        module("b", ""),
        module("b::one", "use super::super::{c, std_like::io};"),
        module("c", "use crate::a::inner::{\n    X,\n};"),
    ]);
    let imports = between_neighbours(&all);
    let name = |path: &str| path.split("::").map(str::to_owned).collect::<Vec<_>>();
    assert_eq!(circle(&imports), Some(vec![name("a"), name("b"), name("c")]));
    let apart = Modules::from([module("a", "use crate::b::X;"), module("b", "use std::fmt;")]);
    assert_eq!(circle(&between_neighbours(&apart)), None);
}
