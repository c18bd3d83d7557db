//! Programs that have nothing of the test's, and programs on a terminal of their own.
#![allow(dead_code, reason = "each test uses a part")]

use serialport::{SerialPort, TTYPort};
use std::fs::File;
use std::process::Command;

/// A shell's `last` words with the `twum` of this build as its arguments. Other tests' pseudo-terminals are not held open by it.
pub fn alone(last: &str) -> Command {
    const ALONE: &str =
        "for d in /proc/self/fd/*; do n=${d##*/}; [ $n -gt 2 ] && eval \"exec $n>&-\"; done 2>/dev/null; ";
    let mut command = Command::new("bash");
    command.args(["-c", &format!("{ALONE}{last}"), "bash", env!("CARGO_BIN_EXE_twum")]);
    command
}

/// `twum` as the leader of a session on a terminal, after the shell's `first` words, and the terminal's other end: closing that
/// hangs up.
pub fn on_terminal(first: &str) -> (Command, TTYPort) {
    let (master, mut slave) = TTYPort::pair().unwrap();
    slave.set_exclusive(false).unwrap();
    let open = || File::options().read(true).write(true).open(slave.name().unwrap()).unwrap();
    let mut command = alone(&format!("stty rows 40 cols 120; {first} exec setsid -c \"$@\""));
    command.stdin(open()).stdout(open()).stderr(open());
    (command, master)
}
