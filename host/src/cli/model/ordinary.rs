//! `twum model speed` and `sweep` of a saved ordinary motor: duty is the share of the largest input it was fitted to.

use super::super::output::print_table;
use super::{Common, print_json};
use anyhow::{Result, bail};
use serde::Serialize;
use twum_host::diagnose::inertial::Model;
use twum_host::output::{self, Existing};
use twum_host::report::figure::{Figure, Panel};

/// Lags after which a motor has come to its speed.
const SETTLED: f64 = 10.0;

/// A steady speed.
#[derive(Serialize)]
struct Steady {
    duty: f64,
    input: f64,
    speed_rpm: f64,
}

impl Steady {
    fn of(model: &Model, duty: f64) -> Self {
        let input = duty * model.largest_input;
        Self { duty, input, speed_rpm: model.steady_rpm(input) }
    }
}

impl Common {
    /// The saved ordinary motor, where `--motor` is one.
    pub fn ordinary(&self) -> Result<Option<Model>> {
        let Some(model) = Model::find(&self.motor)? else { return Ok(None) };
        if !self.set.is_empty() || self.pwm_hz.is_some() || self.effects.is_some() {
            bail!(
                "{}: --set, --pwm-hz and --effects are of a TWUM; an ordinary motor's numbers are changed in its file",
                self.motor
            );
        }
        if let Some(path) = &self.plot {
            output::may_write(path, Existing::Keep)?;
        }
        Ok(Some(model))
    }
}

pub fn speed(common: &Common, model: &Model, duty: f64) -> Result<()> {
    if !(-1.0..=1.0).contains(&duty) {
        bail!("--duty {duty} is outside -1 ..= 1");
    }
    let seconds = common.seconds.unwrap_or(SETTLED * model.lag_s());
    if !(seconds > 0.0 && seconds <= 1e6) {
        bail!("--seconds {seconds} is outside 0 to 1000000");
    }
    let steady = Steady::of(model, duty);
    if common.json {
        print_json(&steady)?;
    } else {
        println!("input           {:.4} ({duty} of the largest)", steady.input);
        println!("speed           {:.3} rpm, steady, from rest", steady.speed_rpm);
        println!("lag             {:.5} s", model.lag_s());
    }
    common.draw(|| {
        let title = format!("Start of {}, input {:.4}", model.name, steady.input);
        let panel = Panel::new("time (s)", "speed (rpm)").line("saved motor", &model.step(steady.input, seconds));
        Ok(Figure::new(title).panel(panel))
    })
}

pub fn sweep(common: &Common, model: &Model, points: usize) -> Result<()> {
    if !(2..=10_000).contains(&points) {
        bail!("--points {points} is outside 2 ..= 10000");
    }
    let duty = |i: usize| 2.0 * i as f64 / (points - 1) as f64 - 1.0;
    let speeds: Vec<Steady> = (0..points).map(|i| Steady::of(model, duty(i))).collect();
    if common.json {
        print_json(&speeds)?;
    } else {
        let row = |s: &Steady| vec![format!("{:.4}", s.duty), format!("{:.4}", s.input), format!("{:.3}", s.speed_rpm)];
        print_table(&["duty", "input", "rpm"], &speeds.iter().map(row).collect::<Vec<_>>());
    }
    common.draw(|| {
        let line: Vec<_> = speeds.iter().map(|s| (s.input, s.speed_rpm)).collect();
        let title = format!("Speed of {} against its input, from rest", model.name);
        Ok(Figure::new(title).panel(Panel::new("input", "speed (rpm)").line("saved motor", &line)))
    })
}
