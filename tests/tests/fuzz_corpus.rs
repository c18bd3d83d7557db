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

use std::path::Path;

fn replay(target: &str, body: fn(&[u8])) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus").join(target);
    let mut inputs = 0;
    for entry in std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display())) {
        let path = entry.unwrap().path();
        let data = std::fs::read(&path).unwrap();
        // Which input, should it panic.
        println!("{}", path.display());
        body(&data);
        inputs += 1;
    }
    assert!(inputs > 0, "{} is empty", folder.display());
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
