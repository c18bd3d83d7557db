//! Seconds that each estimator takes for a record of bits; `host/benches/velocity_speed.py` runs it beside SciPy and Octave.

use std::time::Instant;
use twum_host::record::measurement::Direction;
use twum_host::signal::edges::{Directions, EdgeTrain};
use twum_host::signal::smoother::smooth;
use twum_host::signal::thesis;

const PERIOD_US: f64 = 1000.0;
const REPEATS: usize = 20;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("usage: velocity_speed FILE (one 0 or 1 a line)")?;
    let levels: Vec<bool> = std::fs::read_to_string(path)?.lines().map(|line| line == "1").collect();
    let grid: Vec<f64> = (0..levels.len()).map(|i| i as f64 * PERIOD_US).collect();
    let fit_s = best(|| {
        let mut rpm = Vec::with_capacity(levels.len());
        thesis::local_cubics(PERIOD_US, &levels, 400, |block| rpm.extend_from_slice(block.raw_rpm))?;
        Ok(rpm)
    })?;
    let thesis_s = best(|| Ok(thesis::estimate(0.0, PERIOD_US, &levels, 400)?.fit.raw_rpm))?;
    let smoother_s = best(|| {
        let directions = Directions::constant(Direction::Cw);
        Ok(smooth(&EdgeTrain::from_levels(0.0, PERIOD_US, &levels, 400, &directions)?, &grid)?.speed_rpm)
    })?;
    println!(
        "{{\"fit_s\": {}, \"thesis_s\": {}, \"thesis_rpm\": {}, \"smoother_s\": {}, \"smoother_rpm\": {}}}",
        fit_s.0, thesis_s.0, thesis_s.1, smoother_s.0, smoother_s.1
    );
    Ok(())
}

/// Least time of some repeats, and the mean speed found.
fn best(
    run: impl Fn() -> Result<Vec<f64>, Box<dyn std::error::Error>>,
) -> Result<(f64, f64), Box<dyn std::error::Error>> {
    let mut least = f64::INFINITY;
    let mut mean = 0.0;
    for _ in 0..REPEATS {
        let start = Instant::now();
        let speed = run()?;
        least = least.min(start.elapsed().as_secs_f64());
        mean = speed.iter().sum::<f64>() / speed.len() as f64;
    }
    Ok((least, mean))
}
