//! A closed-loop run taken apart: four residuals that tell controller, actuator path, plant and sensor from each other before
//! anything is fitted. The loop hides what is wrong with the motor in the position; the residuals do not.

use super::controller::{self, ControllerCheck, ControllerError, root_mean};
use super::simulation::can_be_simulated;
use crate::model::actuator::Pwm;
use crate::model::motor::Motor;
use crate::model::motor_plant::{History, MotorPlant, Solver};
use crate::model::parameters::Flavour;
use crate::model::plant;
use crate::model::sensor::Encoder;
use crate::record::measurement::{ControlRow, Direction, Run, RunData};
use serde::Serialize;
use twum_shared::step::{ConfigSpec, DriveLaw};

/// The plant is judged by how far it turns in stretches of this length, s: the replay is not corrected by the loop, so its
/// position drifts off sooner or later, however good it is.
const STRETCH_S: f64 = 0.1;

/// One closed-loop run, taken apart.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClosedLoop {
    /// The run.
    pub run: String,
    /// Which reading of the model was replayed.
    pub flavour: Flavour,
    /// The controller recomputed; `None` where that is not possible.
    pub controller: Option<ControllerCheck>,
    /// Why it is not.
    pub not_recomputed: Option<String>,
    /// The actuator path; `None` where the controller is not known.
    pub actuator: Option<ActuatorParity>,
    /// The motor.
    pub plant: PlantParity,
    /// The encoder.
    pub sensor: SensorParity,
    /// The ticks with the position of the replayed plant, for pictures.
    #[serde(skip)]
    pub ticks: Vec<(ControlRow, f64)>,
    /// Encoder edges a revolution.
    #[serde(skip)]
    pub edges_per_rev: u32,
}

/// Recorded duty and direction against those the recorded control signal asks for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ActuatorParity {
    /// RMS of the duty's difference, fraction of the period.
    pub duty_rms: f64,
    /// Share of the ticks whose direction is not the control signal's.
    pub wrong_direction: f64,
}

/// The recorded position against that of the simulated motor under the recorded duty and direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PlantParity {
    /// How far the motor turned in stretches of 0.1 s, less how far the simulated one did: RMS, as a speed in rpm. One count
    /// in 0.1 s is 1.5 rpm at 400 edges.
    pub rms_rpm: f64,
    /// By what factor the motor turned further than the simulated one (least squares over the stretches); `None` where the
    /// simulated motor does not turn.
    pub gain: Option<f64>,
    /// Share of the measured motion's mean square that the replay explains.
    pub explained: Option<f64>,
    /// Largest distance of the replayed position from the recorded one, in degrees. Nothing holds it back.
    pub largest_drift_deg: f64,
}

/// The encoder against itself.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SensorParity {
    /// Share of the position changes that go against the direction pin. The pin gives the encoder its sign, so there should
    /// be none.
    pub against_direction: f64,
    /// Largest change of the position in a tick, counts.
    pub largest_jump: f64,
}

/// Takes a closed-loop run apart.
///
/// # Errors
/// A run that is no table of control ticks, or names a controller that is not valid.
pub fn compare(run: &Run, edges_per_rev: u32, motor: &Motor, flavour: Flavour) -> Result<ClosedLoop, ControllerError> {
    let RunData::Control(rows) = &run.data else { return Err(ControllerError::NoTicks(run.id.clone())) };
    can_be_simulated(run).map_err(|reason| ControllerError::TooLong { run: run.id.clone(), reason })?;
    let (controller, not_recomputed) = match controller::check(run) {
        Ok(check) => (Some(check), None),
        Err(reason @ (ControllerError::NoController(_) | ControllerError::FeedForward)) => {
            (None, Some(reason.to_string()))
        }
        Err(error) => return Err(error),
    };
    let spec = run.control.map(|control| control.config()).transpose()?;
    let replayed = replay(run, rows, edges_per_rev, motor, flavour);
    Ok(ClosedLoop {
        run: run.id.clone(),
        flavour,
        controller,
        not_recomputed,
        actuator: spec.map(|spec| actuator(rows, &spec)),
        plant: plant_parity(rows, &replayed, edges_per_rev),
        sensor: sensor(rows),
        ticks: rows.iter().copied().zip(replayed).collect(),
        edges_per_rev,
    })
}

/// The counted position of the simulated motor at each tick, under the recorded duties and directions, from rest.
fn replay(run: &Run, rows: &[ControlRow], edges_per_rev: u32, motor: &Motor, flavour: Flavour) -> Vec<f64> {
    let effects = motor.effects();
    let parameters = motor.parameters(flavour);
    let mut plant = MotorPlant::new(parameters, flavour, Solver::Averaged, &effects, History::default());
    let pitch_rad = std::f64::consts::TAU / f64::from(edges_per_rev);
    let mut encoder = Encoder::new(edges_per_rev, if run.aligned { 0.0 } else { 0.5 * pitch_rad }, &effects);
    let Some(first) = rows.first() else { return Vec::new() };
    let mut pwm = Pwm::new(run.pwm_hz, run.pwm_phase_s + first.time_us * 1e-6, &effects);
    let mut position = first.position;
    let mut positions = Vec::with_capacity(rows.len());
    for (i, row) in rows.iter().enumerate() {
        let direction = match row.direction {
            Direction::Cw => plant::Direction::Cw,
            Direction::Ccw => plant::Direction::Ccw,
        };
        if i == 0 {
            pwm.begin(row.duty, direction);
        } else {
            pwm.command(row.duty, direction);
        }
        positions.push(position);
        let Some(next) = rows.get(i + 1) else { break };
        // As on the board, a count takes its sign from the direction pin.
        pwm.advance(&mut plant, (next.time_us - first.time_us) * 1e-6, &mut |segment| {
            encoder.watch(segment, &mut |_| position += row.direction.sign());
        });
    }
    positions
}

/// The least step of a recorded control signal: Q16.16.
const RECORDED_U: f64 = 1.0 / 65_536.0;

fn actuator(rows: &[ControlRow], spec: &ConfigSpec) -> ActuatorParity {
    let steps = f64::from(spec.duty_steps);
    let wanted_on = |u: f64| match spec.law {
        DriveLaw::ActiveLowTruncated => steps - (steps - 1.0 - u.abs()).max(0.0).trunc(),
        DriveLaw::OnTimeRounded | DriveLaw::Gated => u.abs().min(steps).round(),
    };
    // The record holds u rounded: what the board computed with may lie to either side of a step or of zero.
    let off = |row: &ControlRow| {
        let off = [0.0, -RECORDED_U, RECORDED_U].map(|by| row.duty - wanted_on(row.u + by) / steps);
        off.into_iter().min_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(0.0)
    };
    let wrong_direction = |row: &&ControlRow| {
        let known = match spec.law {
            DriveLaw::ActiveLowTruncated => row.u.abs() > RECORDED_U,
            DriveLaw::OnTimeRounded | DriveLaw::Gated => wanted_on(row.u) > 0.0,
        };
        known && (row.u > 0.0) != (row.direction == Direction::Cw)
    };
    ActuatorParity {
        duty_rms: root_mean(rows.iter().map(off), rows.len()),
        wrong_direction: rows.iter().filter(wrong_direction).count() as f64 / rows.len().max(1) as f64,
    }
}

/// Recorded and replayed turn of each stretch, in counts, and the stretch's middle and length in s.
pub(crate) fn stretches(rows: &[ControlRow], replayed: &[f64]) -> Vec<(f64, f64, f64, f64)> {
    let mut found = Vec::new();
    let mut from = 0;
    for to in 1..rows.len() {
        let length_s = (rows[to].time_us - rows[from].time_us) * 1e-6;
        if length_s >= STRETCH_S * (1.0 - 1e-9) {
            let middle_s = 0.5e-6 * (rows[to].time_us + rows[from].time_us);
            let recorded = rows[to].position - rows[from].position;
            found.push((middle_s, length_s, recorded, replayed[to] - replayed[from]));
            from = to;
        }
    }
    found
}

pub(crate) fn rpm(counts: f64, time_s: f64, edges_per_rev: u32) -> f64 {
    counts / f64::from(edges_per_rev) / time_s * 60.0
}

fn plant_parity(rows: &[ControlRow], replayed: &[f64], edges_per_rev: u32) -> PlantParity {
    let turns = stretches(rows, replayed);
    let sum = |f: &dyn Fn(f64, f64) -> f64| turns.iter().map(|(_, _, m, s)| f(*m, *s)).sum::<f64>();
    let share = |part: f64, whole: f64| (whole > 0.0).then(|| part / whole);
    let left = turns.iter().map(|(_, length_s, m, s)| rpm(m - s, *length_s, edges_per_rev));
    let drift = rows.iter().zip(replayed).map(|(row, position)| (row.position - position).abs());
    PlantParity {
        rms_rpm: root_mean(left, turns.len()),
        gain: share(sum(&|m, s| m * s), sum(&|_, s| s * s)),
        explained: share(sum(&|m, s| (m - s) * (m - s)), sum(&|m, _| m * m)).map(|left| 1.0 - left),
        largest_drift_deg: drift.fold(0.0, f64::max) * 360.0 / f64::from(edges_per_rev),
    }
}

fn sensor(rows: &[ControlRow]) -> SensorParity {
    let moves: Vec<(f64, f64)> = rows
        .windows(2)
        .map(|pair| (pair[1].position - pair[0].position, pair[0].direction.sign()))
        .filter(|(change, _)| *change != 0.0)
        .collect();
    let against = moves.iter().filter(|(change, sign)| change * sign < 0.0).count();
    SensorParity {
        against_direction: against as f64 / moves.len().max(1) as f64,
        largest_jump: moves.iter().map(|(change, _)| change.abs()).fold(0.0, f64::max),
    }
}

impl std::fmt::Display for ClosedLoop {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (&self.controller, &self.not_recomputed) {
            (Some(check), _) => {
                writeln!(
                    f,
                    "  controller  {} ticks recomputed, {} differ, {:.4} duty steps RMS",
                    check.ticks, check.mismatched, check.rms_steps
                )?;
                if let Some(first) = &check.first {
                    writeln!(
                        f,
                        "              first at row {} ({:.0} us): u is {:.4}, the controller gives {:.4} duty steps",
                        first.row, first.time_us, first.recorded_u, first.expected_u
                    )?;
                }
                if let Some(kind) = &check.kind {
                    writeln!(f, "              likely: {kind}")?;
                }
            }
            (None, reason) => {
                writeln!(f, "  controller  not recomputed: {}", reason.as_deref().unwrap_or("not known"))?;
            }
        }
        match &self.actuator {
            Some(a) => writeln!(
                f,
                "  actuator    duty {:.5} RMS off what u asks for, direction wrong in {:.2} % of the ticks",
                a.duty_rms,
                100.0 * a.wrong_direction
            )?,
            None => writeln!(f, "  actuator    not known without the controller")?,
        }
        let p = &self.plant;
        let further = match (p.gain, p.explained) {
            (Some(gain), Some(explained)) => {
                format!("turned {gain:.3} times as far as simulated ({}), {explained:.3} explained; ", self.flavour)
            }
            _ => "one of both did not turn; ".to_owned(),
        };
        writeln!(
            f,
            "  plant       {further}{:.2} rpm RMS over 0.1 s each (a count is {:.2} rpm), drifts {:.1}\u{b0} apart",
            p.rms_rpm,
            rpm(1.0, STRETCH_S, self.edges_per_rev),
            p.largest_drift_deg
        )?;
        writeln!(
            f,
            "  sensor      {:.2} % of the counts go against the direction pin, largest step {:.0} counts",
            100.0 * self.sensor.against_direction,
            self.sensor.largest_jump
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::closed_loop::{LoopProgram, run as run_loop};
    use crate::model::effects::EffectSet;
    use crate::record::measurement::{ControlSpec, RunKind};
    use twum_shared::reference::Reference;
    use twum_shared::step::Config;

    /// Four seconds of the thesis's controller on a simulated motor.
    fn run(change: impl Fn(&mut EffectSet)) -> Run {
        let flavour = Flavour::Physical;
        let mut effects = EffectSet::default();
        change(&mut effects);
        let motor = Motor::pcbmotor_30mm();
        let mut plant =
            MotorPlant::new(motor.parameters(flavour), flavour, Solver::Averaged, &effects, History::default());
        let program = LoopProgram {
            config: Config::try_from(ConfigSpec::THESIS).unwrap(),
            reference: Reference::Sine { amplitude: 89, omega_urad_s: 3_141_593 },
            pwm_hz: 50.0,
            edges_per_rev: 400,
            encoder_phase_rad: 0.0,
            end_s: 4.0,
            true_sense: false,
        };
        let rows = run_loop(&program, &mut plant, &effects)
            .unwrap()
            .into_iter()
            .map(|tick| ControlRow {
                time_us: tick.time_s * 1e6,
                target: tick.target.into(),
                position: tick.position.into(),
                u: f64::from(tick.u) / 65_536.0,
                duty: tick.duty,
                direction: if tick.direction == plant::Direction::Cw { Direction::Cw } else { Direction::Ccw },
            })
            .collect();
        let mut run = Run::new("sine", RunKind::Track, RunData::Control(rows));
        (run.control, run.aligned) = (Some(ControlSpec::Thesis), true);
        run
    }

    fn taken_apart(run: &Run) -> ClosedLoop {
        compare(run, 400, &Motor::pcbmotor_30mm(), Flavour::Physical).unwrap()
    }

    #[test]
    fn a_run_of_the_model_itself_leaves_nothing() {
        let found = taken_apart(&run(|_| {}));
        let check = found.controller.as_ref().unwrap();
        assert_eq!((check.ticks, check.mismatched), (8000, 0), "{found}");
        let actuator = found.actuator.unwrap();
        assert_eq!((actuator.duty_rms, actuator.wrong_direction), (0.0, 0.0));
        assert!(found.plant.rms_rpm < 0.01 && found.plant.largest_drift_deg < 0.91, "{found}");
        assert!((found.plant.gain.unwrap() - 1.0).abs() < 1e-3 && found.plant.explained.unwrap() > 0.9999, "{found}");
        assert_eq!((found.sensor.against_direction, found.sensor.largest_jump), (0.0, 1.0));
    }

    /// The loop corrects the position of a slower motor; only the plant's residual shows it.
    #[test]
    fn a_slower_motor_shows_in_the_plant_alone() {
        let found = taken_apart(&run(|effects| {
            effects.supply_sag = Some(crate::model::effects::SupplySag { sag: 0.3, tau_s: 5e-3 });
        }));
        assert_eq!(found.controller.as_ref().unwrap().mismatched, 0);
        assert_eq!(found.actuator.unwrap().duty_rms, 0.0);
        assert!(found.plant.gain.unwrap() < 0.95 && found.plant.largest_drift_deg > 5.0, "{found}");
        assert_eq!(found.sensor.against_direction, 0.0);
    }

    #[test]
    fn a_swapped_duty_or_count_shows_where_it_is() {
        let sound = run(|_| {});
        let with = |change: &dyn Fn(&mut Vec<ControlRow>)| {
            let mut changed = sound.clone();
            if let RunData::Control(rows) = &mut changed.data {
                change(rows);
            }
            taken_apart(&changed)
        };
        let weaker = with(&|rows| rows.iter_mut().for_each(|row| row.duty *= 0.5));
        assert!(weaker.actuator.unwrap().duty_rms > 0.05 && weaker.plant.gain.unwrap() > 1.2, "{weaker}");
        let backwards = with(&|rows| rows.iter_mut().for_each(|row| row.position *= -1.0));
        assert!(backwards.sensor.against_direction > 0.99 && backwards.plant.gain.unwrap() < -0.9, "{backwards}");
    }

    #[test]
    fn without_a_controller_plant_and_sensor_are_still_compared() {
        let mut nameless = run(|_| {});
        nameless.control = None;
        let found = taken_apart(&nameless);
        assert!(found.controller.is_none() && found.actuator.is_none());
        assert!(found.not_recomputed.as_deref().unwrap().contains("add `control"), "{found}");
        assert!(found.plant.explained.unwrap() > 0.9999, "{found}");
    }
}
