//! The `twum` command.

/// As the standard one, but a message that nobody can read any more ends nothing: the standard one panics, which would take
/// the place of the exit code that a run has come to.
macro_rules! eprintln {
    ($($message:tt)*) => {{
        use std::io::Write as _;
        _ = writeln!(std::io::stderr(), $($message)*);
    }};
}

mod cli;

use clap::Parser;
use std::any::Any;
use std::io::ErrorKind;
use std::panic::{self, catch_unwind, resume_unwind};
use std::process::ExitCode;

fn main() -> ExitCode {
    let report = panic::take_hook();
    panic::set_hook(Box::new(move |info| {
        if failed_stdout(info.payload()).is_none() {
            report(info);
        }
    }));
    match catch_unwind(|| cli::Cli::parse().run()) {
        Ok(Ok(code)) => code,
        Ok(Err(error)) if error.downcast_ref::<std::io::Error>().is_some_and(|e| e.kind() == ErrorKind::BrokenPipe) => {
            cli::exit::decided()
        }
        Ok(Err(error)) => {
            eprintln!("error: {error:#}");
            ExitCode::from(cli::exit::code_of(&error))
        }
        Err(payload) if is_closed_stdout(payload.as_ref()) => cli::exit::decided(),
        Err(payload) if failed_stdout(payload.as_ref()).is_some() => {
            eprintln!("error: {}", failed_stdout(payload.as_ref()).unwrap_or_default());
            cli::exit::decided_or_failed()
        }
        Err(payload) => resume_unwind(payload),
    }
}

/// A pipe without a reader, and a terminal whose window was closed.
const CLOSED: [&str; 2] = ["os error 32", "os error 5"];

/// Whether a panic is `println!` finding its reader gone (`twum ... | head`): no failure of the command.
///
/// It has to stay a panic. The signal that other programs die by here would leave a motor turning or a generator's
/// outputs on; unwinding switches them off.
fn is_closed_stdout(payload: &(dyn Any + Send)) -> bool {
    failed_stdout(payload).is_some_and(|message| CLOSED.iter().any(|code| message.contains(code)))
}

/// The message of a panic that is `println!` finding that its output takes no more, such as on a full disk.
fn failed_stdout(payload: &(dyn Any + Send)) -> Option<&str> {
    payload.downcast_ref::<String>().map(String::as_str).filter(|message| message.starts_with("failed printing to std"))
}
