//! `twum model braking`.

use super::super::output::{print_table, stage};
use super::print_json;
use anyhow::{Context, Result};
use std::path::PathBuf;
use twum_host::model::braking::{Braking, MEASURED, Point, SIMULATED, braking};
use twum_host::model::motor::Motor;
use twum_host::report::figure::{Figure, Panel};

pub fn run(motor: &str, json: bool, plot: Option<PathBuf>) -> Result<()> {
    let motor = Motor::load(motor)?;
    let waiting = stage("simulating the closed loop at every torque");
    let found = braking(&motor)?;
    waiting.finish_and_clear();
    if json {
        print_json(&found)?;
    } else {
        let rows = found.points.iter().map(|p| {
            vec![
                format!("{:.2}", p.torque_nm * 1e4),
                format!("{:.3}", p.mse_deg2),
                format!("{:.3}", p.mean_abs_deg),
                p.r2_listed.map_or("-".to_owned(), |r2| format!("{r2:.3}")),
            ]
        });
        print_table(&["1e-4 N·m", "MSE (deg2)", "mean (deg)", "R2 of listed speeds"], &rows.collect::<Vec<_>>());
        for asked in &found.asked {
            let range = |[low, high]: [f64; 2]| format!("{:.3}e-4 to {:.3}e-4 N·m", low * 1e4, high * 1e4);
            let answer = asked.range_nm.map_or("no torque gives it".to_owned(), range);
            println!("{} = {}: {answer}", asked.figure, asked.measured);
        }
        if let (Some(t), Some([low, high]), Some(u)) = (found.torque_nm, found.interval_nm, found.off_friction) {
            println!(
                "both figures of the loop: {:.3}e-4 N·m, {:.3}e-4 to {:.3}e-4 (uoff = {u:.4})",
                t * 1e4,
                low * 1e4,
                high * 1e4
            );
        }
    }
    if let Some(path) = plot {
        braking_figure(&found).write(&path).with_context(|| format!("cannot draw {}", path.display()))?;
        eprintln!("wrote {}", path.display());
    }
    Ok(())
}

fn braking_figure(found: &Braking) -> Figure {
    let line = |f: &dyn Fn(&Point) -> f64| found.points.iter().map(|p| (p.torque_nm * 1e4, f(p))).collect::<Vec<_>>();
    let last = found.points.last().map_or(0.0, |p| p.torque_nm * 1e4);
    let level = |value: f64| [(0.0, value), (last, value)];
    let x = "torque without a wave (1e-4 N·m)";
    let panel = |k: usize, label: &str, f: &dyn Fn(&Point) -> f64| {
        Panel::new(x, label)
            .line("model", &line(f))
            .dashed("real motor (thesis)", &level(MEASURED[k]))
            .dashed("the thesis's simulation", &level(SIMULATED[k]))
    };
    Figure::new("The thesis's closed-loop test against the rotor's braking with the drive off")
        .size(1000, 760)
        .panel(panel(0, "mean square error (deg²)", &|p| p.mse_deg2))
        .panel(panel(1, "mean error (deg)", &|p| p.mean_abs_deg))
}
