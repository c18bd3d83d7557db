//! `twum model speed`, `sweep` and `torque`: steady speeds.

use super::super::output::{print_table, stage};
use super::{Common, print_json};
use anyhow::{Result, bail};
use serde::Serialize;
use twum_host::model::study::Speed;
use twum_host::report::figure::{Figure, Panel};

pub fn speed(common: &Common, duty: f64) -> Result<()> {
    let setup = common.setup(duty, 1.0)?;
    let waiting = stage("simulating");
    let speed = setup.speed()?;
    waiting.finish_and_clear();
    finite(&[(duty, speed)])?;
    if common.json {
        print_json(&speed)?;
    } else {
        println!(
            "speed           {:.4} rad/s = {:.3} rpm (mean over the last 20 %)",
            speed.speed_rad_s, speed.speed_rpm
        );
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

/// Refuses an answer that is no number.
fn finite(speeds: &[(f64, Speed)]) -> Result<()> {
    match speeds.iter().find(|(_, speed)| !speed.speed_rad_s.is_finite()) {
        Some((at, _)) => {
            bail!("the model gives no finite speed at {at}: these parameters are outside what it describes")
        }
        None => Ok(()),
    }
}

#[derive(Serialize)]
struct SweepPoint {
    duty: f64,
    #[serde(flatten)]
    speed: Speed,
}

pub fn sweep(common: &Common, points: usize) -> Result<()> {
    if !(2..=10_000).contains(&points) {
        bail!("--points {points} is outside 2 ..= 10000");
    }
    let setup = common.setup(1.0, 1.0)?;
    let duties: Vec<f64> = (0..points).map(|i| i as f64 / (points - 1) as f64).collect();
    let waiting = stage("simulating every duty");
    let speeds = setup.sweep(&duties)?;
    waiting.finish_and_clear();
    finite(&speeds)?;
    if common.json {
        print_json(&speeds.iter().map(|&(duty, speed)| SweepPoint { duty, speed }).collect::<Vec<_>>())?;
    } else {
        let rows: Vec<_> = speeds
            .iter()
            .map(|(duty, s)| vec![format!("{duty:.4}"), format!("{:.4}", s.speed_rad_s), format!("{:.3}", s.speed_rpm)])
            .collect();
        print_table(&["duty", "rad/s", "rpm"], &rows);
    }
    common.draw(|| {
        let line: Vec<_> = speeds.iter().map(|(duty, s)| (*duty, s.speed_rpm)).collect();
        let title = format!("Speed against duty, {} flavour, {} Hz PWM", setup.flavour, setup.pwm_hz);
        Ok(Figure::new(title).panel(Panel::new("duty", "speed (rpm)").line("model", &line)))
    })
}

#[derive(Serialize)]
struct TorquePoint {
    load_nm: f64,
    #[serde(flatten)]
    speed: Speed,
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
    waiting.finish_and_clear();
    finite(&speeds)?;
    if common.json {
        print_json(&speeds.iter().map(|&(load_nm, speed)| TorquePoint { load_nm, speed }).collect::<Vec<_>>())?;
    } else {
        let rows: Vec<_> = speeds
            .iter()
            .map(|(load, s)| {
                vec![format!("{:.4}", load * 1e3), format!("{:.4}", s.speed_rad_s), format!("{:.3}", s.speed_rpm)]
            })
            .collect();
        print_table(&["mN·m", "rad/s", "rpm"], &rows);
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
