//! Tables of the documents that are the tests' own output: a table that no longer says what is measured fails its test.

use std::path::PathBuf;

fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../docs").join(name)
}

/// A document, as it is.
#[allow(dead_code, reason = "one of the tests that use this module looks at other documents too")]
pub fn read(name: &str) -> String {
    let path = path(name);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// A table of wall time differs each time: it is written when `TWUM_WRITE_DOCS` is set, and not compared.
#[allow(dead_code, reason = "the tests on a real port use this, those in virtual time the other")]
pub fn record(name: &str, table: &str) {
    if std::env::var_os("TWUM_WRITE_DOCS").is_some() {
        check(name, table);
    }
}

/// [`check_in`] docs/reliability.md.
pub fn check(name: &str, table: &str) {
    check_in("reliability.md", name, table);
}

/// Compares what stands between `<!-- name -->` and `<!-- end -->` in a document with `table`; writes it there when
/// `TWUM_WRITE_DOCS` is set.
pub fn check_in(document: &str, name: &str, table: &str) {
    // Two tests write the same file.
    static WRITING: std::sync::Mutex<()> = std::sync::Mutex::new(());
    let _one = WRITING.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    let text = read(document);
    let mark = format!("<!-- {name} -->\n");
    let start = text.find(&mark).unwrap_or_else(|| panic!("docs/{document} has no `{}`", mark.trim())) + mark.len();
    let length = text[start..].find("<!-- end -->").expect("a table has an end");
    if text[start..start + length] == *table {
        return;
    }
    if std::env::var_os("TWUM_WRITE_DOCS").is_some() {
        std::fs::write(path(document), format!("{}{table}{}", &text[..start], &text[start + length..])).unwrap();
        return;
    }
    panic!(
        "docs/{document}, `{name}`, is not what was measured; `TWUM_WRITE_DOCS=1 cargo test -p twum-tests --test board` \
         writes it:\n{table}"
    );
}
