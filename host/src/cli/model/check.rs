//! `twum model check`.

use super::super::output::{print_table, stage};
use super::print_json;
use anyhow::Result;
use twum_host::model::check::check;
use twum_host::model::motor::Motor;

pub fn run(motor: &str, json: bool) -> Result<()> {
    let motor = Motor::load(motor)?;
    let waiting = stage("holding the models against each other");
    let found = check(&motor)?;
    waiting.finish_and_clear();
    if json {
        return print_json(&found);
    }
    println!("Carrier model: error of the wave after 102.4 us against a step of 5 ns, speed after 60 ms of full drive");
    let rows = found.convergence.iter().map(|r| {
        vec![
            r.flavour.to_string(),
            format!("{:.2}", r.step_s * 1e6),
            format!("{:.1e}", r.error),
            r.order.map_or(String::new(), |o| format!("{o:.2}")),
            format!("{:.5}", r.speed_rad_s),
        ]
    });
    print_table(&["flavour", "step (us)", "error", "order", "rad/s"], &rows.collect::<Vec<_>>());
    println!("\nCarrier against averaged model: steady speed");
    let rows = found.duties.iter().map(|r| {
        let off = r.averaged_rpm - r.carrier_rpm;
        vec![
            r.flavour.to_string(),
            format!("{:.0}/32", r.duty * 32.0),
            format!("{:.3}", r.carrier_rpm),
            format!("{:.3}", r.averaged_rpm),
            format!("{off:+.3}"),
            format!("{:+.2} %", 100.0 * off / r.carrier_rpm),
        ]
    });
    print_table(&["flavour", "duty", "carrier (rpm)", "averaged (rpm)", "off by (rpm)", ""], &rows.collect::<Vec<_>>());
    println!("\nThe first 10 ms of a start and of a stop: error of the averaged model's speed over the steady speed");
    let rows = found.transients.iter().map(|r| {
        vec![
            r.flavour.to_string(),
            r.case.clone(),
            format!("{:.2} %", 100.0 * r.rms),
            format!("{:.2} %", 100.0 * r.worst),
            format!("{:+.1}", r.ahead_us),
        ]
    });
    print_table(&["flavour", "case", "rms", "worst 0.1 ms", "ahead by (us)"], &rows.collect::<Vec<_>>());
    println!(
        "\nThe thesis's closed-loop test; its simulation: 2.566 deg2, 1.452 deg; its real motor: 14.199 deg2, 3.125 deg"
    );
    let rows = found.pieces.iter().map(|r| {
        vec![
            format!("{:.3}", r.following.mse_deg2),
            format!("{:.3}", r.following.mean_abs_deg),
            format!("{:.3}", r.following.true_mean_abs_deg),
            r.model.clone(),
        ]
    });
    print_table(&["MSE (deg2)", "mean (deg)", "true mean (deg)", "model"], &rows.collect::<Vec<_>>());
    Ok(())
}
