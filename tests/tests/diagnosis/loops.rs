//! Closed loops in which something, or nothing, is hidden.

use super::answer;
use twum_host::diagnose::answer::{Diagnosis, Verdict};
use twum_tests::tracking::{self, HiddenInLoop};

fn closed_loop(hidden: HiddenInLoop, seed: u64) -> Diagnosis {
    let folder = tempfile::tempdir().expect("a temporary folder");
    tracking::write(&tracking::sines(&hidden, seed), folder.path()).expect("the folder can be written");
    answer(folder.path())
}

fn nothing_is_named(seed: u64) {
    let d = closed_loop(HiddenInLoop::default(), seed);
    assert_eq!(d.verdict, Verdict::None, "seed {seed}: {:?}", d.suspected());
}

/// The loop hides model errors in position and quantisation makes others. Fails if either gets a name.
#[test]
fn a_sound_closed_loop_names_nothing() {
    nothing_is_named(31);
}

/// The same of two more.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_no_sound_closed_loop_names_anything() {
    nothing_is_named(32);
    nothing_is_named(33);
}

/// Fails if the controller is no longer held against its own law before the plant is blamed.
#[test]
fn a_late_controller_is_named() {
    let d = closed_loop(HiddenInLoop { delay_ticks: 6, ..HiddenInLoop::default() }, 34);
    assert_eq!(d.named(), ["loop-delay"], "{:?}", d.verdict);
    assert_eq!(d.effects[0].parameters["ticks"].value, 6.0);
}

/// The same of one with another gain.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_wrong_controller_is_named() {
    let d = closed_loop(HiddenInLoop { gain_error: [0.4, 0.0], ..HiddenInLoop::default() }, 35);
    assert_eq!(d.named(), ["controller-mismatch"], "{:?}", d.verdict);
    let effect = d.effects.iter().find(|e| e.name == "controller-mismatch").expect("it was named");
    let kp = &effect.parameters["kp_relative"];
    assert!((kp.value - 0.4).abs() < 0.02, "{kp:?}");
}

/// A gap and a count lost at each reversal look alike.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_reversals_show_a_gap() {
    let d = closed_loop(HiddenInLoop { gap_rad: 0.035, ..HiddenInLoop::default() }, 36);
    let suspected = d.suspected();
    assert!(suspected.contains(&"backlash"), "{:?} {suspected:?}", d.verdict);
    assert!(suspected.iter().all(|n| ["backlash", "reversal-miscount"].contains(n)), "{suspected:?}");
}

/// Counts gained always in the same sense look like nothing else.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_reversals_show_a_miscount() {
    let d = closed_loop(HiddenInLoop { drift: 1, ..HiddenInLoop::default() }, 37);
    assert_eq!(d.named(), ["reversal-miscount"], "{:?} {:?}", d.verdict, d.suspected());
}
