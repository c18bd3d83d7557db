//! What asks a program to end: Ctrl-C, Ctrl-\, a termination, a window that is closed.

use anyhow::{Context, Result};
use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};
use signal_hook::iterator::Signals;

/// Calls `handle` for each such signal, on a thread of its own; none of them ends the program by itself any more.
pub fn on_signal(mut handle: impl FnMut() + Send + 'static) -> Result<()> {
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP, SIGQUIT]).context("cannot watch for Ctrl-C")?;
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || signals.forever().for_each(|_| handle()))
        .context("cannot watch for Ctrl-C")?;
    Ok(())
}
