//! How commands talk to people: tables on stdout, progress on stderr.

use indicatif::{ProgressBar, ProgressFinish, ProgressStyle};
use std::borrow::Cow;
use std::time::Duration;
use twum_host::report::table::table;

/// Prints rows under a header, columns aligned.
pub fn print_table<H: AsRef<str>>(header: &[H], rows: &[Vec<String>]) {
    print!("{}", table(header, rows));
}

/// Prints an answer: as JSON on one line, or in words.
pub fn answer(json: bool, value: &serde_json::Value, words: &str) {
    if json { println!("{value}") } else { println!("{words}") }
}

/// A bar over a run of a known length on stderr: time, and whatever its message says of the motor.
pub fn progress(length: Duration) -> ProgressBar {
    let template = "{bar:30} {elapsed_precise} of {prefix} s {msg}";
    let style = ProgressStyle::with_template(template).expect("the template is valid");
    let seconds = format!("{:.1}", length.as_secs_f64());
    ProgressBar::new(length.as_millis() as u64).with_style(style).with_prefix(seconds)
}

/// A spinner on stderr with what is being done and for how long; gone when it is dropped, invisible where stderr is not a
/// terminal.
pub fn stage(what: impl Into<Cow<'static, str>>) -> ProgressBar {
    let style = ProgressStyle::with_template("{spinner} {msg}, {elapsed}").expect("the template is valid");
    let spinner = ProgressBar::new_spinner().with_style(style).with_finish(ProgressFinish::AndClear).with_message(what);
    spinner.enable_steady_tick(Duration::from_millis(100));
    spinner
}

/// A bar on stderr over a known number of pieces, with the time that is left; gone when it is dropped.
pub fn pieces(what: impl Into<Cow<'static, str>>, count: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:30} {pos}/{len} {msg}, {eta} left").expect("the template is valid");
    let bar = ProgressBar::new(count as u64).with_style(style).with_finish(ProgressFinish::AndClear).with_message(what);
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}
