//! How commands talk to people: tables on stdout, progress on stderr.

use comfy_table::{Table, presets};
use indicatif::{ProgressBar, ProgressStyle};
use std::time::Duration;

/// Prints rows under a header, columns aligned.
pub fn print_table<H: AsRef<str>>(header: &[H], rows: &[Vec<String>]) {
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(header.iter().map(AsRef::as_ref)).add_rows(rows);
    for column in table.column_iter_mut() {
        column.set_padding((0, 2));
    }
    println!("{}", table.trim_fmt());
}

/// A bar over a run of a known length on stderr: time, and whatever its message says of the motor.
pub fn progress(length: Duration) -> ProgressBar {
    let template = "{bar:30} {elapsed_precise} of {prefix} s {msg}";
    let style = ProgressStyle::with_template(template).expect("the template is valid");
    let seconds = format!("{:.1}", length.as_secs_f64());
    ProgressBar::new(length.as_millis() as u64).with_style(style).with_prefix(seconds)
}

/// A spinner on stderr; invisible where stderr is not a terminal.
pub fn spinner() -> ProgressBar {
    let spinner = ProgressBar::new_spinner();
    spinner.enable_steady_tick(Duration::from_millis(100));
    spinner
}
