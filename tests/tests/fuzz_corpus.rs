//! The corpus of every fuzz target, run through the same functions that are fuzzed.

#[path = "../../fuzz/src/blocks.rs"]
mod blocks;
#[path = "../../fuzz/src/driver_replies.rs"]
mod driver_replies;
#[path = "../../fuzz/src/folders.rs"]
mod folders;
#[path = "../../fuzz/src/frames.rs"]
mod frames;
#[path = "../../fuzz/src/motors.rs"]
mod motors;
#[path = "../../fuzz/src/recordings.rs"]
mod recordings;
#[path = "../../fuzz/src/sealed.rs"]
mod sealed;

use std::io::Read;
use std::path::Path;

fn replay(target: &str, body: fn(&[u8])) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus").join(target).with_extension("tar");
    let packed = std::fs::File::open(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut inputs = 0;
    for entry in tar::Archive::new(packed).entries().unwrap() {
        let mut entry = entry.unwrap();
        let mut data = Vec::new();
        entry.read_to_end(&mut data).unwrap();
        // Which input, should it panic.
        println!("{}: {}", path.display(), entry.path().unwrap().display());
        body(&data);
        inputs += 1;
    }
    assert!(inputs > 5, "{} holds {inputs} inputs", path.display());
}

#[test]
fn the_corpus_of_frames_is_handled() {
    replay("frames", frames::frames);
}

#[test]
fn the_corpus_of_driver_replies_is_handled() {
    replay("driver_replies", driver_replies::driver_replies);
}

#[test]
fn the_corpus_of_recordings_is_handled() {
    replay("recordings", recordings::recordings);
}

#[test]
fn the_corpus_of_folders_is_handled() {
    replay("folders", folders::folders);
}

#[test]
fn the_corpus_of_motors_is_handled() {
    replay("motors", motors::motors);
}

#[test]
fn the_corpus_of_blocks_is_handled() {
    replay("blocks", blocks::blocks);
}
