//! `twum model speed`, `sweep` and `torque`: steady speeds.

use super::super::output::{print_table, stage};
use super::{Common, print_json};
use anyhow::{Result, bail};
use rayon::prelude::*;
use serde::Serialize;
use serde_json::{Value, json};
use twum_host::model::study::{Setup, Speed};
use twum_host::model::uncertainty::Band;
use twum_host::report::figure::{Figure, Panel};

pub fn speed(common: &Common, duty: f64) -> Result<()> {
    let setup = common.setup(duty, 1.0)?;
    let waiting = stage("simulating");
    let speed = setup.speed()?;
    waiting.finish_and_clear();
    finite(&[(duty, speed)])?;
    let band = common
        .possible(&setup)?
        .map(|motors| bands(&motors, |motor| Ok(vec![motor.speed()?.speed_rpm])))
        .transpose()?;
    let band = band.and_then(|bands| bands.first().copied());
    if common.json {
        let mut told = json!(speed);
        if let Some(band) = band {
            told["uncertainty"] = common.uncertainty.json(json!({ "speed_rpm": band }));
        }
        print_json(&told)?;
    } else {
        println!(
            "speed           {:.4} rad/s = {:.3} rpm (mean over the last 20 %)",
            speed.speed_rad_s, speed.speed_rpm
        );
        if let Some(Band { ci95: [low, high], .. }) = band {
            println!("                {low:.3} to {high:.3} rpm ({})", common.uncertainty.words());
        }
        println!("wave amplitude  {:.4e} m", speed.wave_amplitude_m);
        println!("rotor height    {:.4e} m", speed.rotor_height_m);
        let times = setup.seconds / speed.wall_s;
        println!("{} steps in {:.4} s, {:.3} times real time", speed.steps, speed.wall_s, times);
    }
    common.draw(|| {
        let line = setup.start_up()?;
        let title = format!("Start of the {} motor model, duty {duty}", setup.flavour);
        Ok(Figure::new(title).panel(Panel::new("time (s)", "speed (rpm)").line("speed", &line)))
    })
}

/// The band of each number that a motor gives, on all cores.
fn bands(motors: &[Setup], of: impl Fn(&Setup) -> Result<Vec<f64>> + Sync + Send) -> Result<Vec<Band>> {
    let found = motors.par_iter().map(of).collect::<Result<Vec<_>>>()?;
    let count = found.first().map_or(0, Vec::len);
    Ok((0..count).map(|k| Band::of(found.iter().map(|values| values[k]).collect())).collect())
}

/// The ends of bands as what a table shows of each.
fn ends(band: Option<&Band>) -> String {
    band.map_or(String::new(), |band| format!("{:.3} to {:.3}", band.ci95[0], band.ci95[1]))
}

/// Refuses an answer that is no number.
fn finite(speeds: &[(f64, Speed)]) -> Result<()> {
    match speeds.iter().find(|(_, speed)| !speed.speed_rad_s.is_finite()) {
        Some((at, _)) => {
            bail!("the model gives no finite speed at {at}: these parameters are outside what it describes")
        }
        None => Ok(()),
    }
}

/// A table of speeds, the last column of bands only where they were asked for.
fn print_points(header: [&str; 3], mut rows: Vec<Vec<String>>, common: &Common, banded: bool) {
    let mut header: Vec<String> = header.map(str::to_owned).to_vec();
    if banded {
        header.push(format!("rpm, {}", common.uncertainty.words()));
    } else {
        rows.iter_mut().for_each(|row| row.truncate(3));
    }
    print_table(&header, &rows);
}

#[derive(Serialize)]
struct SweepPoint {
    duty: f64,
    #[serde(flatten)]
    speed: Speed,
    #[serde(skip_serializing_if = "Option::is_none")]
    uncertainty: Option<Value>,
}

pub fn sweep(common: &Common, points: usize) -> Result<()> {
    if !(2..=10_000).contains(&points) {
        bail!("--points {points} is outside 2 ..= 10000");
    }
    let setup = common.setup(1.0, 1.0)?;
    let duties: Vec<f64> = (0..points).map(|i| i as f64 / (points - 1) as f64).collect();
    let waiting = stage("simulating every duty");
    let speeds = setup.sweep(&duties)?;
    let every = |motor: &Setup| Ok(motor.sweep(&duties)?.into_iter().map(|(_, speed)| speed.speed_rpm).collect());
    let band = common.possible(&setup)?.map(|motors| bands(&motors, every)).transpose()?.unwrap_or_default();
    waiting.finish_and_clear();
    finite(&speeds)?;
    let told = |k: usize| band.get(k).map(|band| common.uncertainty.json(json!({ "speed_rpm": band })));
    if common.json {
        let point = |(k, &(duty, speed))| SweepPoint { duty, speed, uncertainty: told(k) };
        print_json(&speeds.iter().enumerate().map(point).collect::<Vec<_>>())?;
    } else {
        let row = |(k, (duty, s)): (usize, &(f64, Speed))| {
            vec![
                format!("{duty:.4}"),
                format!("{:.4}", s.speed_rad_s),
                format!("{:.3}", s.speed_rpm),
                ends(band.get(k)),
            ]
        };
        print_points(["duty", "rad/s", "rpm"], speeds.iter().enumerate().map(row).collect(), common, !band.is_empty());
    }
    common.draw(|| {
        let line: Vec<_> = speeds.iter().map(|(duty, s)| (*duty, s.speed_rpm)).collect();
        let title = format!("Speed against duty, {} flavour, {} Hz PWM", setup.flavour, setup.pwm_hz);
        let panel = Panel::new("duty", "speed (rpm)").line("model", &line);
        let between: Vec<_> =
            speeds.iter().zip(&band).map(|((duty, _), band)| (*duty, band.ci95[0], band.ci95[1])).collect();
        let panel = if between.is_empty() { panel } else { panel.band(common.uncertainty.words(), &between) };
        Ok(Figure::new(title).panel(panel))
    })
}

#[derive(Serialize)]
struct TorquePoint {
    load_nm: f64,
    #[serde(flatten)]
    speed: Speed,
    #[serde(skip_serializing_if = "Option::is_none")]
    uncertainty: Option<Value>,
}

pub fn torque(common: &Common, duty: f64, points: usize) -> Result<()> {
    if !(2..=10_000).contains(&points) {
        bail!("--points {points} is outside 2 ..= 10000");
    }
    let setup = common.setup(duty, 1.0)?;
    // Just short of the stall torque: beyond it the rotor runs away backwards.
    let stall = setup.stall_torque_nm();
    let loads: Vec<f64> = (0..points).map(|i| 0.995 * stall * i as f64 / (points - 1) as f64).collect();
    let waiting = stage("simulating every load");
    let speeds = setup.under_loads(&loads)?;
    let every = |motor: &Setup| {
        // A motor that a load stalls stands: what the model makes of it beyond is a slide.
        let held: Vec<f64> = loads.iter().copied().filter(|load| *load < motor.stall_torque_nm()).collect();
        let mut rpm: Vec<f64> = motor.under_loads(&held)?.into_iter().map(|(_, speed)| speed.speed_rpm).collect();
        rpm.resize(loads.len(), 0.0);
        Ok(rpm)
    };
    let band = common.possible(&setup)?.map(|motors| bands(&motors, every)).transpose()?.unwrap_or_default();
    waiting.finish_and_clear();
    finite(&speeds)?;
    let told = |k: usize| band.get(k).map(|band| common.uncertainty.json(json!({ "speed_rpm": band })));
    if common.json {
        let point = |(k, &(load_nm, speed))| TorquePoint { load_nm, speed, uncertainty: told(k) };
        print_json(&speeds.iter().enumerate().map(point).collect::<Vec<_>>())?;
    } else {
        let row = |(k, (load, s)): (usize, &(f64, Speed))| {
            vec![
                format!("{:.4}", load * 1e3),
                format!("{:.4}", s.speed_rad_s),
                format!("{:.3}", s.speed_rpm),
                ends(band.get(k)),
            ]
        };
        print_points(["mN·m", "rad/s", "rpm"], speeds.iter().enumerate().map(row).collect(), common, !band.is_empty());
        eprintln!("the contact transmits at most {:.3} mN·m", stall * 1e3);
    }
    common.draw(|| {
        let line: Vec<_> = speeds.iter().map(|(load, s)| (s.speed_rpm, load * 1e3)).collect();
        let title = format!("Torque against speed, {} flavour, duty {duty}", setup.flavour);
        let fastest = line.iter().fold(0.0, |top: f64, point| top.max(point.0));
        let panel = Panel::new("speed (rpm)", "torque (mN·m)").x_range(0.0, 1.05 * fastest.max(1e-3));
        Ok(Figure::new(title).panel(panel.line("model", &line)))
    })
}
