//! A recording survives the end of the program that makes it, whatever ends it. The board is simulated in virtual time, so
//! an interrupted recording must be the beginning of the uninterrupted one, byte for byte.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;
use twum_host::compare::replay::replay_recording;
use twum_host::record::store::{Ending, Reader};

fn track(out: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_twum"));
    command.args(["track", "--port", "sim", "--control", "thesis", "--seconds", "100", "--out"]).arg(out);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn frames(path: &Path) -> (u64, Ending) {
    let mut reader = Reader::open(path).unwrap();
    while reader.next_entry().unwrap().is_some() {}
    assert!(reader.integrity().is_whole(), "{:?}", reader.integrity());
    (reader.integrity().frames, reader.integrity().ending)
}

#[cfg(unix)]
#[test]
fn killed_at_any_moment_it_is_readable_to_its_last_frame() {
    let dir = tempfile::tempdir().unwrap();
    let whole = dir.path().join("whole.mcap");
    let begun = std::time::Instant::now();
    assert!(track(&whole).status().unwrap().success());
    let length = begun.elapsed();
    let reference = std::fs::read(&whole).unwrap();
    let (all, ending) = frames(&whole);
    assert_eq!(ending, Ending::Finished);

    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let (mut before_first, mut inside) = (0, 0);
    for attempt in 0..30 {
        let path = dir.path().join(format!("{attempt}.mcap"));
        let mut child = track(&path).spawn().unwrap();
        std::thread::sleep(Duration::from_secs_f64(length.as_secs_f64() * rng.random_range(0.0..0.9)));
        child.kill().unwrap();
        child.wait().unwrap();
        let Ok(bytes) = std::fs::read(&path) else {
            before_first += 1;
            continue;
        };
        if bytes.is_empty() {
            before_first += 1;
            continue;
        }
        assert!(reference.starts_with(&bytes), "attempt {attempt}: not the beginning of the whole recording");
        let (read, ending) = frames(&path);
        if ending == Ending::Stopped && read > 0 {
            inside += 1;
            assert!(read <= all);
            let replay = replay_recording(&path).unwrap();
            assert_eq!((replay.replay.mismatched, replay.replay.gaps, replay.link.missing_sequences), (0, 0, 0));
        }
    }
    println!("{inside} of 30 kills fell inside the recording, {before_first} before its first frame");
    assert!(inside >= 10, "only {inside} kills fell inside the recording: the test does not test");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_ends_it_with_a_clear_message_and_whole_frames() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let inner = track(&path);
    // A limit on the size of files stands in for a full disk: the same call fails, only with another reason.
    let mut limited = Command::new("sh");
    limited.args(["-c", "trap '' XFSZ; ulimit -f 100; exec \"$@\"", "sh"]);
    limited.arg(inner.get_program()).args(inner.get_args());
    let output = limited.output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(message.contains("cannot write any more") && message.contains("are intact"), "{message}");
    let (read, ending) = frames(&path);
    assert_eq!(ending, Ending::Stopped);
    assert!(message.contains(&format!("the {read} frames captured so far are intact")), "{read} frames; {message}");
}
