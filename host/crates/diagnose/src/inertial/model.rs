//! An ordinary motor as a file: what `--save-model` writes, and what it makes of a run.

use super::angle::Ripple;
use super::conclude::InertialOutcome;
use super::data::{Data, DriveRun};
use super::effects::reported;
use super::fit::{Plant, refit};
use super::held_out::squared_error;
use super::plant::{simulate, simulate_all};
use super::ripple::followed;
use super::values::{P, Values};
use crate::answer::Diagnosis;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use twum_files::input;
use twum_fit::noise::Noise;
use twum_record::measurement::Run;

/// Steps of the fit of a run's initial speed, the only number that a saved motor leaves open.
const STEPS: usize = 10;

/// Why a file is no ordinary motor.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// It cannot be read.
    #[error("{file}: {reason}")]
    Read {
        /// The file.
        file: String,
        /// Why.
        reason: String,
    },
    /// It holds something else.
    #[error("{file}: {what}")]
    Wrong {
        /// The file.
        file: String,
        /// What is wrong, and where.
        what: String,
    },
}

/// An order of the angle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Order {
    /// Periods a turn.
    order: usize,
    /// Phase in rad of every run that it was found in, by its identifier: an encoder without a zero begins anew in each.
    phases_rad: BTreeMap<String, f64>,
}

/// A saved motor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Model {
    /// What it is called.
    pub name: String,
    /// `inertial`.
    plant: String,
    /// The largest input of the runs it was fitted to, in their unit: sizes are shares of it.
    pub largest_input: f64,
    /// Whether speeds have no sign.
    #[serde(default)]
    unsigned: bool,
    /// The largest load of the runs it was fitted to, in their unit, where it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    largest_load: Option<f64>,
    /// The mean temperature of the runs it was fitted to, in °C, where it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    temperature: Option<f64>,
    /// Its numbers by name.
    numbers: BTreeMap<String, f64>,
    /// Orders of torques over the angle.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    orders: Vec<Order>,
}

/// A run beside what a saved motor makes of its input.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunAgainst {
    /// Identifier.
    pub id: String,
    /// Root mean square of the difference, in rpm.
    pub rmse_rpm: f64,
    /// The same as a share of the run's own spread of speeds.
    pub rmse_relative: f64,
    /// Times in s.
    #[serde(skip)]
    pub time_s: Vec<f64>,
    /// Measured speeds in rpm.
    #[serde(skip)]
    pub measured_rpm: Vec<f64>,
    /// Simulated ones.
    #[serde(skip)]
    pub simulated_rpm: Vec<f64>,
}

/// The name of a number in the file: that of the JSON, where this is of one number alone.
fn key(number: P) -> &'static str {
    match number {
        P::LogLag => "lag_s",
        P::Skew => "input_early_samples",
        P::CoggingCos => "cogging_cos",
        P::CoggingSin => "cogging_sin",
        P::Cogging2Cos => "cogging_2_cos",
        P::Cogging2Sin => "cogging_2_sin",
        P::RippleCos => "torque_ripple_cos",
        P::RippleSin => "torque_ripple_sin",
        other => reported(other).0,
    }
}

impl Model {
    /// What was found, of runs that are of one motor.
    pub fn of(name: &str, outcome: &InertialOutcome) -> Option<Self> {
        let values = outcome.fitted.as_ref()?.plant;
        let number = |p: P| if p == P::LogLag { values.lag_s() } else { values.get(p) };
        let always = [P::Gain, P::LogLag, P::Skew];
        let there = P::ALL.into_iter().filter(|p| always.contains(p) || values.get(*p) != 0.0);
        let runs = &outcome.data.runs;
        let order = |r: &Ripple| Order {
            order: r.order,
            phases_rad: runs.iter().zip(&r.phases).map(|(run, phase)| (run.id.clone(), *phase)).collect(),
        };
        let numbers: BTreeMap<String, f64> = there.map(|p| (key(p).to_owned(), number(p))).collect();
        let over_angle = numbers.keys().any(|k| k.ends_with("_cos"));
        Some(Self {
            name: name.to_owned(),
            plant: "inertial".to_owned(),
            largest_input: outcome.data.largest_input,
            unsigned: outcome.data.unsigned,
            largest_load: outcome.data.largest_load,
            temperature: outcome.data.temperature.map(|t| t.0),
            numbers,
            orders: if over_angle { outcome.data.ripples.iter().map(order).collect() } else { Vec::new() },
        })
    }

    /// The text of its file, with what the answer says of it at its head.
    ///
    /// # Errors
    /// When it cannot be written as TOML.
    pub fn file(&self, diagnosis: &Diagnosis) -> Result<String, toml::ser::Error> {
        let mut text = String::from(
            "# Written by twum diagnose: an ordinary motor, τ·ω' = K·(u − b) − ω − K·F·sign(ω), with what was found. Sizes are shares of largest_input.\n",
        );
        for e in diagnosis.effects.iter().filter(|e| e.status != "rejected") {
            let one = |(n, p): (&String, &crate::answer::ParameterAnswer)| {
                format!("{n} = {} {} [{}, {}]", p.value, p.unit, p.ci95[0], p.ci95[1])
            };
            let list: Vec<String> = e.parameters.iter().map(one).collect();
            let _ = writeln!(text, "#   {} ({}): {}", e.name, e.status, list.join("; "));
        }
        text.push_str(&toml::to_string(self)?);
        Ok(text)
    }

    /// Whether a text is of an ordinary motor, whatever else may be wrong with it.
    pub fn is_of(text: &str) -> bool {
        text.parse::<toml::Table>().is_ok_and(|t| t.get("plant").and_then(toml::Value::as_str) == Some("inertial"))
    }

    /// The ordinary motor of a file; none where the file is of something else, or is not there (the name of a shipped motor).
    ///
    /// # Errors
    /// When a file of an ordinary motor will not do.
    pub fn find(name_or_path: &str) -> Result<Option<Self>, ModelError> {
        match input::text(Path::new(name_or_path), input::WRITTEN) {
            Ok(text) if Self::is_of(&text) => Self::parse(name_or_path, &text).map(Some),
            _ => Ok(None),
        }
    }

    /// Of a file.
    ///
    /// # Errors
    /// When it cannot be read, or is not of an ordinary motor.
    pub fn load(path: &str) -> Result<Self, ModelError> {
        let text = input::text(Path::new(path), input::WRITTEN)
            .map_err(|reason| ModelError::Read { file: path.into(), reason: reason.to_string() })?;
        Self::parse(path, &text)
    }

    /// Of a file's text.
    ///
    /// # Errors
    /// As [`Model::load`].
    pub fn parse(file: &str, text: &str) -> Result<Self, ModelError> {
        let wrong = |what: String| ModelError::Wrong { file: file.to_owned(), what };
        if !Self::is_of(text) {
            return Err(wrong(
                "no `plant = \"inertial\"`: not the file of an ordinary motor, as twum diagnose FOLDER --save-model FILE writes it".to_owned(),
            ));
        }
        let model: Self = toml::from_str(text).map_err(|e| wrong(e.to_string()))?;
        if !(model.largest_input.is_finite() && model.largest_input > 0.0) {
            return Err(wrong(format!("largest_input = {} is not above 0", model.largest_input)));
        }
        for (name, value) in &model.numbers {
            let known = P::ALL.into_iter().find(|p| key(*p) == name);
            let Some(number) = known else {
                let names: Vec<&str> = P::ALL.into_iter().map(key).collect();
                return Err(wrong(format!(
                    "numbers.{name}: no number of an ordinary motor; they are {}",
                    names.join(", ")
                )));
            };
            let (low, high) = admissible(number);
            if !(low..=high).contains(value) {
                return Err(wrong(format!("numbers.{name} = {value} is outside {low} to {high}")));
            }
        }
        for needed in [P::Gain, P::LogLag] {
            if !model.numbers.contains_key(key(needed)) {
                return Err(wrong(format!("numbers.{} is missing", key(needed))));
            }
        }
        let orders = |p: &P| model.numbers.contains_key(key(*p));
        let over = [
            (P::CoggingCos, 1),
            (P::CoggingSin, 1),
            (P::RippleCos, 1),
            (P::RippleSin, 1),
            (P::Cogging2Cos, 2),
            (P::Cogging2Sin, 2),
        ];
        if let Some((p, needed)) = over.iter().find(|(p, needed)| orders(p) && model.orders.len() < *needed) {
            return Err(wrong(format!("numbers.{} needs [[orders]], {needed} of them", key(*p))));
        }
        let has = |p: P| model.numbers.contains_key(key(p));
        let seen = [P::SwingOfMotor, P::SwingOfLoad];
        if seen.map(has).iter().filter(|h| **h).count() != usize::from(has(P::Swing)) {
            let [motor, load] = seen.map(key);
            return Err(wrong(format!("numbers.{} goes with one of {motor} and {load}", key(P::Swing))));
        }
        if model.numbers.contains_key(key(P::Load)) && !model.largest_load.is_some_and(|v| v.is_finite() && v > 0.0) {
            return Err(wrong(format!("numbers.{} needs largest_load, above 0", key(P::Load))));
        }
        if model.numbers.contains_key(key(P::Heating)) && !model.temperature.is_some_and(f64::is_finite) {
            return Err(wrong(format!("numbers.{} needs temperature, in °C", key(P::Heating))));
        }
        if model.orders.iter().any(|o| o.phases_rad.is_empty() || o.phases_rad.values().any(|v| !v.is_finite())) {
            return Err(wrong("orders.phases_rad: at least one phase, and each a number".to_owned()));
        }
        Ok(model)
    }

    fn values(&self) -> Values {
        let of = |p: P| self.numbers.get(key(p)).copied().unwrap_or(0.0);
        let mut values = Values::line(of(P::Gain), of(P::LogLag));
        for p in P::ALL.into_iter().filter(|p| ![P::Gain, P::LogLag].contains(p)) {
            values.set(p, of(p));
        }
        values
    }

    /// τ in s.
    pub fn lag_s(&self) -> f64 {
        self.values().lag_s()
    }

    /// The runs beside what the motor makes of their inputs; of each only the initial speed is fitted. What was left out is said.
    pub fn against(&self, runs: &[&Run]) -> (Vec<RunAgainst>, Vec<String>) {
        let (mut data, mut notes) = Data::read(runs);
        let scale = data.largest_input / self.largest_input;
        data.runs.iter_mut().flat_map(|r| &mut r.input).for_each(|u| *u *= scale);
        let load = data.largest_load.zip(self.largest_load).map_or(0.0, |(now, then)| now / then);
        let warmer = data.temperature.zip(self.temperature).map_or(0.0, |(now, then)| now.0 - then);
        data.runs.iter_mut().flat_map(|r| &mut r.beside).for_each(|[l, w]| {
            *l *= load;
            *w += warmer;
        });
        if self.largest_load.is_some() && data.largest_load.is_none() {
            notes.push(
                "the motor was fitted with a load that was measured; these runs have none: taken as 0".to_owned(),
            );
        }
        if self.numbers.contains_key(key(P::Heating)) && data.temperature.is_none() {
            notes.push(
                "the motor was fitted with its temperature; these runs have none: taken as the mean then".to_owned(),
            );
        }
        data.unsigned |= self.unsigned;
        let ripple = |o: &Order| {
            let first = o.phases_rad.values().next().copied().unwrap_or(0.0);
            let phases = data.runs.iter().map(|r| o.phases_rad.get(&r.id).copied().unwrap_or(first)).collect();
            Ripple { order: o.order, phases }
        };
        let ripples: Vec<Ripple> = self.orders.iter().map(ripple).collect();
        data = data.with_ripples(ripples, self.lag_s(), None);
        let starts = data.runs.iter().map(|r| r.rpm[0]).collect();
        let started = |data: &Data, plant| refit(data, plant, &[], Noise::PLAIN, &[], STEPS);
        let mut plant = started(&data, Plant { values: self.values(), starts });
        if !data.ripples.is_empty() {
            let told = followed(&data, &plant, started);
            let again = started(&told, plant.clone());
            if squared_error(&told, &again) < squared_error(&data, &plant) {
                (data, plant) = (told, again);
            }
        }
        let motions = simulate_all(&data, &plant.values, &plant.starts);
        let one = |(run, m): (&DriveRun, super::plant::Motion)| {
            let n = run.rpm.len() as f64;
            let mean = run.rpm.iter().sum::<f64>() / n;
            let error = run.rpm.iter().zip(&m.rpm).map(|(y, p)| (y - p).powi(2)).sum::<f64>() / n;
            let spread = run.rpm.iter().map(|y| (y - mean).powi(2)).sum::<f64>() / n;
            RunAgainst {
                id: run.id.clone(),
                rmse_rpm: error.sqrt(),
                rmse_relative: (error / spread.max(1e-12)).sqrt(),
                time_s: (0..run.rpm.len()).map(|k| run.time[run.sample(k)]).collect(),
                measured_rpm: run.rpm.clone(),
                simulated_rpm: m.rpm,
            }
        };
        (data.runs.iter().zip(motions).map(one).collect(), notes)
    }

    /// The course from rest in rpm over times in s where an input, in the record's unit, is held. What goes with the angle is left out.
    pub fn step(&self, input: f64, seconds: f64) -> Vec<(f64, f64)> {
        self.course(&self.values(), input, seconds)
    }

    fn course(&self, values: &Values, input: f64, seconds: f64) -> Vec<(f64, f64)> {
        const SAMPLES: usize = 1000;
        let period_s = seconds / SAMPLES as f64;
        let run = DriveRun {
            id: String::new(),
            time: (0..=SAMPLES).map(|k| k as f64 * period_s).collect(),
            period_s,
            input: vec![input / self.largest_input; SAMPLES + 1],
            rpm: vec![0.0; SAMPLES + 1],
            windows: None,
            turns: vec![0.0; SAMPLES + 1],
            ripple: Vec::new(),
            beside: Vec::new(),
        };
        // What is early in a record is early by the record's samples.
        let values = values.with(P::Skew, 0.0);
        run.time.iter().copied().zip(simulate(&run, &values, 0.0, self.unsigned).rpm).collect()
    }

    /// The speed in rpm to which a held input comes from rest.
    pub fn steady_rpm(&self, input: f64) -> f64 {
        // A swing has no part in it, and may take longer to die.
        let values = self.values().with(P::Swing, 0.0);
        let seconds = 40.0 * (values.lag_s() + values.get(P::SecondLag)) + 2.0 * values.get(P::DeadTime);
        self.course(&values, input, seconds).last().map_or(0.0, |p| p.1)
    }
}

/// The range of a number in a file: where its equation says something.
fn admissible(number: P) -> (f64, f64) {
    match number {
        P::Gain => (-1e9, 1e9),
        P::LogLag => (1e-9, 1e6),
        P::Skew => (-1e3, 1e3),
        P::DeadTime | P::SecondLag | P::Swing => (0.0, 1e6),
        P::Coulomb | P::Stiction | P::DeadZone | P::FlatTop | P::Corner | P::StribeckSpeed | P::SwingDamping => {
            (0.0, 1.0)
        }
        P::Bend | P::BendPower | P::SwingOfMotor | P::SwingOfLoad => (0.0, 100.0),
        P::Load => (-1e3, 1e3),
        _ => (-1.0, 1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if two numbers have one name: the second would take the first's place in a file.
    #[test]
    fn every_number_has_a_name_of_its_own() {
        let names: std::collections::BTreeSet<&str> = P::ALL.into_iter().map(key).collect();
        assert_eq!(names.len(), P::ALL.len());
    }

    /// Fails if a swing that has not died is part of the speed that a held input comes to, or is lost on the way there.
    #[test]
    fn a_swing_is_in_the_start_and_not_in_the_end() {
        let text = "name = \"m\"\nplant = \"inertial\"\nlargest_input = 2.0\n[numbers]\ngain_rpm = 300.0\nlag_s = 0.1\n\
                    swing_s = 0.01\ndamping_ratio = 0.001\ninertia_ratio_load_seen = 0.02\n";
        let model = Model::parse("m.toml", text).expect("it is a motor");
        assert!((model.steady_rpm(1.0) - 150.0).abs() < 0.01, "{}", model.steady_rpm(1.0));
        let late = model.step(1.0, 1.0).into_iter().filter(|p| p.0 > 0.8).map(|p| p.1);
        let (low, high) = late.fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
        assert!(high - low > 1.0, "{low} to {high}");
    }
}
