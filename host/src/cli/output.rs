//! How commands talk to people: tables on stdout, progress on stderr.

use indicatif::ProgressBar;
use std::time::Duration;

/// Prints rows under a header, columns aligned.
pub fn print_table<H: AsRef<str>>(header: &[H], rows: &[Vec<String>]) {
    let widths: Vec<usize> = (0..header.len())
        .map(|column| {
            let cells = rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count());
            cells.chain([header[column].as_ref().chars().count()]).max().unwrap_or(0)
        })
        .collect();
    let line = |cells: Vec<&str>| {
        let padded: Vec<String> = cells.iter().zip(&widths).map(|(cell, width)| format!("{cell:<width$}")).collect();
        println!("{}", padded.join("  ").trim_end());
    };
    line(header.iter().map(AsRef::as_ref).collect());
    for row in rows {
        line(row.iter().map(String::as_str).collect());
    }
}

/// A spinner on stderr; invisible where stderr is not a terminal.
pub fn spinner() -> ProgressBar {
    let spinner = ProgressBar::new_spinner();
    spinner.enable_steady_tick(Duration::from_millis(100));
    spinner
}
