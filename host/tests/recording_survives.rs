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
    command.args(["track", "--port", "sim", "--control", "thesis", "--seconds", "50", "--out"]).arg(out);
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
    killed_at_random_moments(6, 9);
}

/// `cargo test --release -p twum-host --test recording_survives -- --ignored --nocapture two_hundred`
#[cfg(unix)]
#[test]
#[ignore = "minutes; docs/reliability.md gives the command"]
fn killed_at_two_hundred_moments_it_is_readable_to_its_last_frame() {
    killed_at_random_moments(200, 10);
}

#[cfg(unix)]
fn killed_at_random_moments(kills: u32, seed: u64) {
    let dir = tempfile::tempdir().unwrap();
    let whole = dir.path().join("whole.mcap");
    let begun = std::time::Instant::now();
    assert!(track(&whole).status().unwrap().success());
    let length = begun.elapsed();
    let reference = std::fs::read(&whole).unwrap();
    let (all, ending) = frames(&whole);
    assert_eq!(ending, Ending::Finished);

    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut before_first, mut inside) = (0, 0);
    for attempt in 0..kills {
        let path = dir.path().join(format!("{attempt}.mcap"));
        let mut child = track(&path).spawn().unwrap();
        std::thread::sleep(Duration::from_secs_f64(length.as_secs_f64() * rng.random_range(0.0..0.9)));
        child.kill().unwrap();
        child.wait().unwrap();
        let bytes = std::fs::read(&path).unwrap_or_default();
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
        std::fs::remove_file(&path).unwrap();
    }
    println!("{inside} of {kills} kills fell inside the recording, {before_first} before its first frame");
    assert!(inside * 3 >= kills, "only {inside} kills fell inside the recording: the test does not test");
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

/// Runs a recording that has to fail; gives its message.
fn refused(mut command: Command) -> String {
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    String::from_utf8(output.stderr).unwrap()
}

#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_is_full_from_the_start_is_named() {
    let dir = tempfile::tempdir().unwrap();
    if !mount(dir.path(), "size=4k") {
        println!("skipped: this machine does not let a test mount a file system");
        return;
    }
    let message = refused(track_in_mount(dir.path(), "size=4k", "a.mcap", None));
    assert!(message.contains("a.mcap") && message.contains("No space left"), "{message}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_fills_up_keeps_every_whole_frame() {
    let dir = tempfile::tempdir().unwrap();
    if !mount(dir.path(), "size=256k") {
        println!("skipped: this machine does not let a test mount a file system");
        return;
    }
    let kept = tempfile::tempdir().unwrap();
    let message = refused(track_in_mount(dir.path(), "size=256k", "a.mcap", Some(kept.path())));
    let path = kept.path().join("a.mcap");
    let (read, ending) = frames(&path);
    assert_eq!(ending, Ending::Stopped);
    assert!(read > 100, "{read} frames in 256 KiB");
    assert!(message.contains(&format!("the {read} frames captured so far are intact")), "{read} frames; {message}");
    assert_eq!(replay_recording(&path).unwrap().replay.mismatched, 0);
}

#[cfg(target_os = "linux")]
#[test]
fn a_read_only_file_system_is_named() {
    let dir = tempfile::tempdir().unwrap();
    if !mount(dir.path(), "ro") {
        println!("skipped: this machine does not let a test mount a file system");
        return;
    }
    let message = refused(track_in_mount(dir.path(), "ro", "a.mcap", None));
    assert!(message.contains("a.mcap") && message.contains("Read-only file system"), "{message}");
}

#[cfg(target_os = "linux")]
const UNSHARE: [&str; 4] = ["--user", "--map-root-user", "--mount", "--"];

/// Whether a test may mount a file system of its own there, seen by itself alone.
#[cfg(target_os = "linux")]
fn mount(at: &Path, options: &str) -> bool {
    let script = format!("mount -t tmpfs -o {options} none \"$1\"");
    let mut command = Command::new("unshare");
    command.args(UNSHARE).args(["sh", "-c", &script, "sh"]).arg(at).stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}

/// Records into a file system mounted for this command alone; then copies the recording to `keep`.
#[cfg(target_os = "linux")]
fn track_in_mount(at: &Path, options: &str, name: &str, keep: Option<&Path>) -> Command {
    let inner = track(&at.join(name));
    let copy = keep.map_or(String::new(), |keep| format!("cp \"$0/{name}\" {}; ", keep.display()));
    let script = format!("mount -t tmpfs -o {options} none \"$0\" && {{ \"$@\"; code=$?; {copy}exit $code; }}");
    let mut command = Command::new("unshare");
    command.args(UNSHARE).args(["sh", "-c", &script]).arg(at);
    command.arg(inner.get_program()).args(inner.get_args()).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

#[cfg(unix)]
#[test]
fn a_place_that_cannot_be_written_is_named_and_nothing_there_is_touched() {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("file"), b"mine").unwrap();
    for (path, wanted) in [
        (dir.path().join("file/a.mcap"), "Not a directory"),
        (dir.path().join("none/a.mcap"), "No such file or directory"),
        (dir.path().to_owned(), "exists"),
        (dir.path().join("file"), "exists"),
    ] {
        let message = refused(track(&path));
        assert!(message.contains(wanted), "{}: {message}", path.display());
    }
    assert_eq!(std::fs::read(dir.path().join("file")).unwrap(), b"mine");

    let locked = dir.path().join("locked");
    std::fs::create_dir(&locked).unwrap();
    std::fs::set_permissions(&locked, std::fs::Permissions::from_mode(0o555)).unwrap();
    let anyone = std::fs::write(locked.join("probe"), b"").is_ok();
    if anyone {
        // Who may do everything is not refused: somebody else has to try.
        std::fs::set_permissions(dir.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
        let inner = track(&locked.join("a.mcap"));
        let mut command = Command::new("setpriv");
        command.args(["--reuid=65534", "--regid=65534", "--clear-groups"]);
        command.arg(inner.get_program()).args(inner.get_args()).stdout(Stdio::null()).stderr(Stdio::piped());
        let reachable = Command::new("setpriv")
            .args(["--reuid=65534", "--regid=65534", "--clear-groups", "test", "-x"])
            .arg(env!("CARGO_BIN_EXE_twum"))
            .status();
        if !reachable.is_ok_and(|status| status.success()) {
            println!("skipped: nobody else on this machine can run the program");
            return;
        }
        let message = refused(command);
        assert!(message.contains("Permission denied"), "{message}");
    } else {
        let message = refused(track(&locked.join("a.mcap")));
        assert!(message.contains("Permission denied"), "{message}");
    }
}
