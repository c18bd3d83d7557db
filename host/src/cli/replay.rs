//! `twum replay`.

use super::output::stage;
use anyhow::Result;
use std::path::PathBuf;
use std::process::ExitCode;
use twum_host::compare::replay::{RecordingReplay, replay_recording};

/// Arguments of `twum replay`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Every control tick is recomputed with the function the board runs, from the state its block starts with, and must match bit
for bit. Missing ticks are counted, not guessed, to the end of their run; so are missing samples and edges, and restarts.

Examples:
  twum replay sine.mcap
  twum replay sine.mcap --json

Exit code 0: everything recorded matches. 1: a tick differs, or there was none to check. 2: not a recording.")]
pub struct Args {
    /// Recording
    recording: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs `twum replay`.
pub fn run(args: Args) -> Result<ExitCode> {
    let waiting = stage("recomputing every tick");
    let found = replay_recording(&args.recording)?;
    waiting.finish_and_clear();
    if args.json {
        println!("{}", serde_json::to_string_pretty(&found)?);
    } else {
        print(&found);
    }
    Ok(if found.replay.is_exact() { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

fn print(found: &RecordingReplay) {
    let RecordingReplay { replay, link, file } = found;
    println!("{} control ticks checked in {} runs, {} differ", replay.checked, replay.runs, replay.mismatched);
    for mismatch in &replay.first {
        println!(
            "  tick {} at {} us: {:?} is {}, should be {}",
            mismatch.tick, mismatch.time_us, mismatch.field, mismatch.recorded, mismatch.expected
        );
    }
    println!("{} gaps, {} ticks missing", replay.gaps, replay.missing);
    if replay.missing_bits > 0 || replay.missing_edges > 0 {
        println!("{} samples of the 1 kHz capture and {} edges missing", replay.missing_bits, replay.missing_edges);
    }
    if let Some(guided) = replay.guided {
        let share = 100.0 * guided.believed as f64 / guided.ticks as f64;
        println!(
            "the target gave way by up to {} counts; a load was believed in {share:.0} % of the ticks, in the others it went back to its path",
            guided.farthest_counts
        );
    }
    if replay.unended > 0 {
        println!("{} runs without their end", replay.unended);
    }
    if link.sessions > 1 {
        println!("the board restarted {} times", link.sessions - 1);
    }
    if replay.unconfigured > 0 {
        println!("{} ticks without a configuration before them: not checked", replay.unconfigured);
    }
    if replay.checked == 0 {
        println!("nothing to check: only `twum track` records control ticks");
    }
    println!(
        "frames: {} intact, {} broken, {} sequence numbers missing, {} came again and were dropped; file: {:?}, {} \
         damaged places",
        link.device_frames,
        link.broken_frames,
        link.missing_sequences,
        link.duplicates,
        file.ending,
        file.damaged_places
    );
}
