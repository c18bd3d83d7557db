//! The Model page: speed against duty and the closed loop of the averaged model, for parameters that a person moves, beside
//! what was measured.

use super::App;
use super::answer::{Answer, Refused, in_force};
use crate::configuration::controller;
use crate::model::closed_loop::{LoopProgram, following, run as run_loop};
use crate::model::effects::{EffectSet, catalogue};
use crate::model::motor::{Motor, SHIPPED};
use crate::model::motor_plant::{History, MotorPlant, Solver};
use crate::model::parameters::{Flavour, SPECS};
use crate::model::study::Setup;
use crate::record::load::load_runs;
use crate::report::figure::{Figure, Panel};
use crate::report::run::RunFigures;
use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::routing::get;
use axum::{Json, Router};
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use tokio::sync::Semaphore;
use twum_shared::step::Config;

/// Duties of the speed–duty line.
const DUTIES: u32 = 21;
/// Length of each duty's run, and of the closed loop (s): the thesis's.
const SPEED_S: f64 = 1.0;
const LOOP_S: f64 = 10.0;
/// Points of a line.
const POINTS: usize = 2_000;
/// One answer is computed at a time; the next waits, and no more than a few.
static COMPUTING: Semaphore = Semaphore::const_new(1);

/// What can be asked of the model.
pub fn routes() -> Router<Arc<App>> {
    Router::new().route("/api/model", get(sliders).post(predict))
}

/// What a person chose.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Chosen {
    /// A shipped motor, or a motor file of the folder; the 30 mm motor where none is named.
    motor: Option<String>,
    flavour: Flavours,
    /// Parameters that differ from the motor's.
    set: BTreeMap<String, f64>,
    /// Effects, with their parameters in the order of the catalogue.
    effects: BTreeMap<String, Vec<f64>>,
    /// `thesis`, `default` or `board`.
    control: Controllers,
    /// A measured run or folder to draw beside it.
    run: Option<String>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Flavours {
    Thesis,
    Physical,
    Measured,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Controllers {
    Thesis,
    Default,
    Board,
}

impl From<Flavours> for Flavour {
    fn from(chosen: Flavours) -> Self {
        match chosen {
            Flavours::Thesis => Self::Thesis,
            Flavours::Physical => Self::Physical,
            Flavours::Measured => Self::Measured,
        }
    }
}

/// Which motor's parameters are asked for.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Which {
    motor: Option<String>,
}

fn motor_of(app: &App, name: Option<&str>) -> Result<Motor, String> {
    name.map_or_else(|| Ok(Motor::pcbmotor_30mm()), |name| app.folder.motor(name))
}

async fn sliders(State(app): State<Arc<App>>, Query(which): Query<Which>) -> Answer {
    let motor = motor_of(&app, which.motor.as_deref())?;
    let of = |flavour: Flavour| -> Vec<Value> {
        let values = motor.parameters(flavour).to_array();
        let rows = SPECS.iter().zip(values).map(|(spec, value)| {
            json!({ "name": spec.name, "unit": spec.unit, "value": value, "lower": spec.lower, "upper": spec.upper })
        });
        rows.collect()
    };
    let effects: Vec<Value> = catalogue()
        .iter()
        .map(|effect| {
            let parameters: Vec<Value> = effect
                .parameters
                .iter()
                .map(|p| json!({ "name": p.name, "unit": p.unit, "absent": p.absent, "typical": p.typical, "lower": p.lower, "upper": p.upper }))
                .collect();
            json!({ "name": effect.name, "parameters": parameters })
        })
        .collect();
    let own: BTreeMap<&str, Vec<f64>> =
        motor.effects().present().into_iter().map(|(info, values)| (info.name, values)).collect();
    let motors: Vec<String> = SHIPPED.iter().map(|(name, _)| (*name).to_owned()).chain(app.folder.motors()).collect();
    Ok(Json(json!({
        "motor": motor.name,
        "motors": motors,
        "own_effects": own,
        "flavours": { "physical": of(Flavour::Physical), "thesis": of(Flavour::Thesis), "measured": of(Flavour::Measured) },
        "effects": effects,
    })))
}

async fn predict(State(app): State<Arc<App>>, Json(chosen): Json<Chosen>) -> Answer {
    let run = chosen.run.as_deref().map(|run| app.folder.existing(run)).transpose()?;
    let control = match chosen.control {
        Controllers::Thesis => controller("thesis").map_err(|error| error.to_string())?,
        Controllers::Default => controller("default").map_err(|error| error.to_string())?,
        Controllers::Board => in_force(&app).control,
    };
    let config = Config::try_from(control).map_err(|error| error.to_string())?;
    let motor = motor_of(&app, chosen.motor.as_deref())?;
    let setup = setup(&motor, &chosen)?;
    let busy = |_| Refused(StatusCode::SERVICE_UNAVAILABLE, "the model is busy".to_owned());
    let _turn = COMPUTING.acquire().await.map_err(busy)?;
    let computed = tokio::task::spawn_blocking(move || answer(&motor, &setup, config, run.as_deref())).await;
    computed
        .unwrap_or_else(|_| Err("the model failed; the server's terminal says more".to_owned()))
        .map(Json)
        .map_err(Into::into)
}

fn setup(motor: &Motor, chosen: &Chosen) -> Result<Setup, String> {
    let flavour = Flavour::from(chosen.flavour);
    let mut parameters = motor.parameters(flavour);
    for (name, value) in &chosen.set {
        parameters.set(name, *value).map_err(|error| error.to_string())?;
    }
    let mut effects = EffectSet::default();
    for (name, values) in &chosen.effects {
        effects.set(name, values).map_err(|error| error.to_string())?;
    }
    let setup =
        Setup { parameters, flavour, solver: Solver::Averaged, effects, duty: 1.0, pwm_hz: 50.0, seconds: SPEED_S };
    setup.check().and_then(|()| setup.check_load()).map_err(|error| error.to_string())?;
    Ok(setup)
}

fn answer(motor: &Motor, setup: &Setup, config: Config, run: Option<&Path>) -> Result<Value, String> {
    let duties: Vec<f64> = (0..DUTIES).map(|k| f64::from(k) / f64::from(DUTIES - 1)).collect();
    let speeds = setup.sweep(&duties).map_err(|error| error.to_string())?;
    let line: Vec<(f64, f64)> = speeds.iter().map(|(duty, speed)| (*duty, speed.speed_rpm)).collect();
    let mut panel = Panel::new("duty", "speed (rpm)").line("model", &line);
    if let Some(run) = run {
        let measured = measured(run)?;
        if !measured.is_empty() {
            panel = panel.points("measured", &measured);
        }
    }
    let program = LoopProgram {
        config,
        end_s: LOOP_S,
        ..LoopProgram::thesis(motor.edges_per_rev).map_err(|error| error.to_string())?
    };
    let (solver, history) = (Solver::Averaged, History::default());
    let mut plant = MotorPlant::new(setup.parameters, setup.flavour, solver, &setup.effects, history);
    let trace = run_loop(&program, &mut plant, &setup.effects).map_err(|error| error.to_string())?;
    let found = following(&program, &trace);
    let degrees = 360.0 / f64::from(program.edges_per_rev);
    let of = |value: &dyn Fn(&crate::model::closed_loop::Tick) -> f64| -> Vec<(f64, f64)> {
        trace.iter().step_by((trace.len() / POINTS).max(1)).map(|tick| (tick.time_s, value(tick))).collect()
    };
    let target = of(&|tick| f64::from(tick.target) * degrees);
    let position = of(&|tick| f64::from(tick.position) * degrees);
    let error = of(&|tick| f64::from(tick.target - tick.position) * degrees);
    let time = "time (s)";
    let figure = Figure::new("")
        .panel(panel.title("speed against duty"))
        .panel(
            Panel::new(time, "position (°)").title("closed loop").line("target", &target).line("position", &position),
        )
        .panel(Panel::new(time, "error (°)").line("target − position", &error));
    Ok(json!({
        "figure": figure.interactive(POINTS),
        "following": { "mse_deg2": found.mse_deg2, "mean_abs_deg": found.mean_abs_deg },
        "full_drive_rpm": line.last().map(|point| point.1),
    }))
}

/// Duty and mean speed of every open-loop run, without their signs.
fn measured(run: &Path) -> Result<Vec<(f64, f64)>, String> {
    let (whole, _) = load_runs(run).map_err(|error| error.to_string())?;
    let mut points = Vec::new();
    for run in &whole.runs {
        let mut alone = whole.clone();
        alone.runs = vec![run.clone()];
        // A run without a settled part says nothing of its speed.
        if let Ok(Some(RunFigures::Speed(speed))) = RunFigures::of(&alone)
            && let (Some(duty), Some(mean)) = (speed.duty, speed.course.mean_rpm)
        {
            points.push((duty, mean.abs()));
        }
    }
    Ok(points)
}
