//! A board's configuration as people read and write it: TOML, every value under the name the firmware has for it.
//!
//! [`to_toml`] and [`overlay`] are exact: what is written and read again is the same configuration, bit for bit. A gain is
//! written as the number that reads back as itself, and as text where no floating-point number does.

use crate::measurement::{ControlError, ControlSpec};
use fixed::types::{I16F48, I32F32};
use std::fmt::{Display, Write as _};
use std::path::Path;
use std::str::FromStr;
use thiserror::Error;
use toml::{Table, Value};
use twum_files::input;
use twum_shared::encoder::CountSign;
use twum_shared::message::Configuration;
use twum_shared::safety::Limits;
use twum_shared::step::{Config, ConfigSpec, DriveLaw};

/// Why a text is no configuration.
#[derive(Debug, Error)]
pub enum ConfigurationError {
    /// It is not TOML.
    #[error("{0}")]
    Syntax(#[from] toml::de::Error),
    /// A key nobody knows.
    #[error("key `{0}` is unknown; `twum config dump` shows the keys there are")]
    Unknown(String),
    /// A value its key cannot have.
    #[error("key `{key}` = {value}: {reason}")]
    Value {
        /// The key, with its table.
        key: String,
        /// What stands there.
        value: String,
        /// What is wrong.
        reason: String,
    },
    /// Values that do not go together, or that the board would refuse.
    #[error("{0}")]
    Refused(String),
}

/// Why there is no controller.
#[derive(Debug, Error)]
pub enum ControllerError {
    /// Its file's `[control]` will not do.
    #[error("{path}: {error}")]
    File {
        /// The file.
        path: String,
        /// What is wrong.
        error: ConfigurationError,
    },
    /// No such name, or gains that cannot run.
    #[error(transparent)]
    Gains(#[from] ControlError),
}

const SIGNS: [(&str, CountSign); 2] = [("positive", CountSign::Positive), ("reversed", CountSign::Reversed)];
const LAWS: [(&str, DriveLaw); 3] = [
    ("active-low-truncated", DriveLaw::ActiveLowTruncated),
    ("on-time-rounded", DriveLaw::OnTimeRounded),
    ("gated", DriveLaw::Gated),
];

fn word<T: Copy + PartialEq>(words: &[(&'static str, T)], value: T) -> Value {
    let word = words.iter().find(|(_, known)| *known == value).map_or("", |(word, _)| word);
    Value::String(word.to_owned())
}

/// The number that reads back as `gain`, or its digits as text.
fn number<T: Display + FromStr + PartialEq>(gain: T) -> Value {
    let digits = gain.to_string();
    let shortest =
        digits.parse::<f64>().ok().filter(|value| value.to_string().parse::<T>().is_ok_and(|read| read == gain));
    shortest.map_or(Value::String(digits), Value::Float)
}

/// Every key with its value: those of the bench, of the controller, of the limits.
fn tables(configuration: &Configuration) -> [(&'static str, Vec<(String, Value)>); 3] {
    let Configuration { control, limits, count_sign, edges_per_rev, pwm_hz } = configuration;
    let named = |key: &str, value: Value| (key.to_owned(), value);
    let bench = vec![
        named("count_sign", word(&SIGNS, *count_sign)),
        named("edges_per_rev", i64::from(*edges_per_rev).into()),
        named("pwm_hz", i64::from(*pwm_hz).into()),
    ];
    let control = vec![
        named("kp", number(control.kp)),
        named("ki_tick", number(control.ki_tick)),
        named("kd_tick", number(control.kd_tick)),
        named("feed_forward", number(control.feed_forward)),
        named("integral_min", i64::from(control.integral_min).into()),
        named("integral_max", i64::from(control.integral_max).into()),
        named("period_us", i64::from(control.period_us).into()),
        named("duty_steps", i64::from(control.duty_steps).into()),
        named("law", word(&LAWS, control.law)),
        named("dead_band_counts", i64::from(control.dead_band_counts).into()),
        named("conditional_integration", control.conditional_integration.into()),
        named("reversal_rest_ticks", i64::from(control.reversal_rest_ticks).into()),
        named("reversal_limit_ticks", i64::from(control.reversal_limit_ticks).into()),
        named("full_speed_counts_s", i64::from(control.full_speed_counts_s).into()),
        named("braking_counts_s2", i64::from(control.braking_counts_s2).into()),
        named("delay_ticks", i64::from(control.delay_ticks).into()),
        named("shortest_pulse_ticks", i64::from(control.shortest_pulse_ticks).into()),
        named("pulse_period_ticks", i64::from(control.pulse_period_ticks).into()),
        named("learns", control.learns.into()),
        named("guide_limit_counts", i64::from(control.guide.limit_counts).into()),
        named("guide_stiffness_nnm", i64::from(control.guide.stiffness_nnm).into()),
        named("guide_damping_nnm_s", i64::from(control.guide.damping_nnm_s).into()),
        named("guide_dead_band_nnm", i64::from(control.guide.dead_band_nnm).into()),
        named("guide_braking_nnm", i64::from(control.guide.braking_nnm).into()),
    ];
    let limits = Table::try_from(limits).expect("limits are a struct of integers");
    [("", bench), ("control", control), ("limits", limits.into_iter().collect())]
}

/// Every key, with its table, and its value.
pub fn rows(configuration: &Configuration) -> Vec<(String, Value)> {
    let join = |table: &str, key: String| if table.is_empty() { key } else { format!("{table}.{key}") };
    tables(configuration)
        .into_iter()
        .flat_map(|(table, rows)| rows.into_iter().map(move |(key, value)| (join(table, key), value)))
        .collect()
}

/// The keys in which two configurations differ, with both values.
pub fn difference(one: &Configuration, other: &Configuration) -> Vec<(String, Value, Value)> {
    let pairs = rows(one).into_iter().zip(rows(other));
    pairs.filter(|((_, a), (_, b))| a != b).map(|((key, a), (_, b))| (key, a, b)).collect()
}

/// The configuration as a file, which [`overlay`] reads.
pub fn to_toml(configuration: &Configuration) -> String {
    let mut text = String::from(
        "# Configuration of a board; `twum config load` sends it. Gains are in duty steps: kp a count, ki_tick a count and tick,\n\
         # kd_tick a count/tick, feed_forward a count/s. A tick is period_us long. [control] may also be `control = \"thesis\"`,\n\
         # `\"default\"`, `\"gated\"` or `\"planned\"`. What is left out stays as the board has it.\n",
    );
    let [bench, control, limits] = tables(configuration);
    write_rows(&mut text, &bench.1);
    for (table, rows) in [control, limits] {
        let _ = writeln!(text, "\n[{table}]");
        write_rows(&mut text, &rows);
    }
    text
}

/// A controller as a file, which [`controller`] reads: its table `[control]`, every key.
pub fn control_toml(control: &ConfigSpec) -> String {
    let [_, (table, rows), _] = tables(&Configuration::with_control(*control));
    let mut text = format!("[{table}]\n");
    write_rows(&mut text, &rows);
    text
}

fn write_rows(text: &mut String, rows: &[(String, Value)]) {
    for (key, value) in rows {
        let _ = writeln!(text, "{key} = {value}");
    }
}

/// `base` with what a text says.
///
/// # Errors
/// Names the key and what is wrong with it.
pub fn overlay(base: &Configuration, text: &str) -> Result<Configuration, ConfigurationError> {
    let mut configuration = *base;
    for (key, value) in text.parse::<Table>()? {
        match (key.as_str(), value) {
            ("count_sign", value) => configuration.count_sign = one_of(&key, &value, &SIGNS)?,
            ("edges_per_rev", value) => configuration.edges_per_rev = integer(&key, &value)?,
            ("pwm_hz", value) => configuration.pwm_hz = integer(&key, &value)?,
            ("control", Value::String(name)) => {
                let Some(control) = ConfigSpec::named(&name) else {
                    let known = "`thesis`, `default`, `gated`, `planned` or a table [control]";
                    return Err(wrong("control", &Value::String(name), known));
                };
                choose(&mut configuration, control);
            }
            ("control", Value::Table(table)) => overlay_control(&mut configuration.control, table)?,
            ("limits", Value::Table(table)) => configuration.limits = overlay_limits(&configuration.limits, table)?,
            ("control" | "limits", value) => return Err(wrong(&key, &value, "a table is expected")),
            _ => return Err(ConfigurationError::Unknown(key)),
        }
    }
    validate(&configuration)?;
    Ok(configuration)
}

/// Gives the board another controller, and the PWM frequency that goes with it where the one it has belongs to another law.
pub fn choose(configuration: &mut Configuration, control: ConfigSpec) {
    if control.law != configuration.control.law && [control.law, configuration.control.law].contains(&DriveLaw::Gated) {
        configuration.pwm_hz = control.pwm_hz();
    }
    configuration.control = control;
}

/// `base` with the limits of a text: the keys of its table `[limits]`, or its own where it has none.
///
/// # Errors
/// As [`overlay`].
pub fn overlay_only_limits(base: &Configuration, text: &str) -> Result<Configuration, ConfigurationError> {
    let mut table = text.parse::<Table>()?;
    let limits = match table.remove("limits") {
        Some(Value::Table(limits)) => limits,
        Some(value) => return Err(wrong("limits", &value, "a table is expected")),
        None => table,
    };
    let configuration = Configuration { limits: overlay_limits(&base.limits, limits)?, ..*base };
    validate(&configuration)?;
    Ok(configuration)
}

/// A controller by name (`thesis`, `default`, `gated`, `planned`), or from a file: its table `[control]`, of which what is left out is the default's,
/// or a file of gains as a measurement folder has them.
///
/// # Errors
/// Names the file, the key and what is wrong with it.
pub fn controller(name: &str) -> Result<ConfigSpec, ControllerError> {
    let in_file = |error| ControllerError::File { path: name.to_owned(), error };
    if let Some(named) = ConfigSpec::named(name) {
        return Ok(named);
    }
    if let Ok(text) = input::text(Path::new(name), input::WRITTEN)
        && let Some(control) = text.parse::<Table>().map_err(|e| in_file(e.into()))?.remove("control")
    {
        let alone = Table::from_iter([("control".to_owned(), control)]).to_string();
        let base = Configuration::with_control(ConfigSpec::DEFAULT);
        return overlay(&base, &alone).map(|read| read.control).map_err(in_file);
    }
    Ok(ControlSpec::named(name)?.config()?)
}

/// What the board would refuse, before it is asked.
///
/// # Errors
/// The board's reason.
pub fn validate(configuration: &Configuration) -> Result<(), ConfigurationError> {
    let refused = |reason: String| Err(ConfigurationError::Refused(reason));
    if let Err(error) = Config::try_from(configuration.control) {
        return refused(format!("[control]: {error}"));
    }
    if let Err(error) = configuration.limits.validate() {
        return refused(format!("[limits]: {error}"));
    }
    for (key, value, range) in
        [("edges_per_rev", configuration.edges_per_rev, 2..=10_000), ("pwm_hz", configuration.pwm_hz, 10..=2_000)]
    {
        if !range.contains(&value) {
            return Err(wrong(key, &i64::from(value).into(), &format!("{} to {}", range.start(), range.end())));
        }
    }
    Ok(())
}

fn overlay_control(control: &mut ConfigSpec, table: Table) -> Result<(), ConfigurationError> {
    for (key, value) in table {
        let name = format!("control.{key}");
        match key.as_str() {
            "kp" => control.kp = gain::<I32F32>(&name, &value)?,
            "ki_tick" => control.ki_tick = gain::<I16F48>(&name, &value)?,
            "kd_tick" => control.kd_tick = gain::<I32F32>(&name, &value)?,
            "feed_forward" => control.feed_forward = gain::<I32F32>(&name, &value)?,
            "integral_min" => control.integral_min = integer(&name, &value)?,
            "integral_max" => control.integral_max = integer(&name, &value)?,
            "period_us" => control.period_us = integer(&name, &value)?,
            "duty_steps" => control.duty_steps = integer(&name, &value)?,
            "law" => control.law = one_of(&name, &value, &LAWS)?,
            "dead_band_counts" => control.dead_band_counts = integer(&name, &value)?,
            "conditional_integration" => control.conditional_integration = truth(&name, &value)?,
            "reversal_rest_ticks" => control.reversal_rest_ticks = integer(&name, &value)?,
            "reversal_limit_ticks" => control.reversal_limit_ticks = integer(&name, &value)?,
            "full_speed_counts_s" => control.full_speed_counts_s = integer(&name, &value)?,
            "braking_counts_s2" => control.braking_counts_s2 = integer(&name, &value)?,
            "delay_ticks" => control.delay_ticks = integer(&name, &value)?,
            "shortest_pulse_ticks" => control.shortest_pulse_ticks = integer(&name, &value)?,
            "pulse_period_ticks" => control.pulse_period_ticks = integer(&name, &value)?,
            "learns" => control.learns = truth(&name, &value)?,
            "guide_limit_counts" => control.guide.limit_counts = integer(&name, &value)?,
            "guide_stiffness_nnm" => control.guide.stiffness_nnm = integer(&name, &value)?,
            "guide_damping_nnm_s" => control.guide.damping_nnm_s = integer(&name, &value)?,
            "guide_dead_band_nnm" => control.guide.dead_band_nnm = integer(&name, &value)?,
            "guide_braking_nnm" => control.guide.braking_nnm = integer(&name, &value)?,
            _ => return Err(ConfigurationError::Unknown(name)),
        }
    }
    Ok(())
}

fn overlay_limits(base: &Limits, table: Table) -> Result<Limits, ConfigurationError> {
    let mut limits = Table::try_from(base).expect("limits are a struct of integers");
    for (key, value) in table {
        let name = format!("limits.{key}");
        let Some(place) = limits.get_mut(&key) else { return Err(ConfigurationError::Unknown(name)) };
        *place = value.clone();
        // One key after the other, so that what is wrong is this one.
        if let Err(error) = limits.clone().try_into::<Limits>() {
            return Err(wrong(&name, &value, error.message()));
        }
    }
    limits.try_into().map_err(|error: toml::de::Error| ConfigurationError::Refused(error.message().to_owned()))
}

fn wrong(key: &str, value: &Value, reason: &str) -> ConfigurationError {
    ConfigurationError::Value { key: key.to_owned(), value: value.to_string(), reason: reason.to_owned() }
}

fn integer<T: TryFrom<i64>>(key: &str, value: &Value) -> Result<T, ConfigurationError> {
    let whole = value.as_integer().ok_or_else(|| wrong(key, value, "a whole number is expected"))?;
    T::try_from(whole).map_err(|_| wrong(key, value, "out of range"))
}

fn truth(key: &str, value: &Value) -> Result<bool, ConfigurationError> {
    value.as_bool().ok_or_else(|| wrong(key, value, "true or false is expected"))
}

fn one_of<T: Copy>(key: &str, value: &Value, words: &[(&'static str, T)]) -> Result<T, ConfigurationError> {
    let found = value.as_str().and_then(|text| words.iter().find(|(word, _)| *word == text));
    found.map(|(_, known)| *known).ok_or_else(|| {
        let all: Vec<String> = words.iter().map(|(word, _)| format!("\"{word}\"")).collect();
        wrong(key, value, &format!("{} is expected", all.join(" or ")))
    })
}

/// A gain written as a number or as its digits.
fn gain<T: FromStr>(key: &str, value: &Value) -> Result<T, ConfigurationError> {
    let digits = match value {
        Value::String(digits) => digits.clone(),
        Value::Float(number) => number.to_string(),
        Value::Integer(number) => number.to_string(),
        _ => return Err(wrong(key, value, "a number is expected")),
    };
    digits
        .parse()
        .map_err(|_| wrong(key, value, "not a number that fixed point can hold: its magnitude must stay below 1024"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn base() -> Configuration {
        Configuration::with_control(ConfigSpec::DEFAULT)
    }

    #[test]
    fn what_is_written_reads_back_as_itself() {
        for (_, control) in ConfigSpec::NAMED {
            let mut configuration = Configuration::with_control(control);
            configuration.count_sign = CountSign::Reversed;
            configuration.limits.position_min = -77;
            let other = Configuration { pwm_hz: 60, ..base() };
            assert_eq!(overlay(&other, &to_toml(&configuration)).unwrap(), configuration);
        }
        let text = to_toml(&Configuration::with_control(ConfigSpec::THESIS));
        assert!(text.contains("kp = 1.3\n") && text.contains("[limits]"), "{text}");
    }

    proptest! {
        #[test]
        fn any_gains_read_back_bit_for_bit(kp in -1023i64 << 32..1023 << 32, ki in -(1i64 << 40)..1 << 40, kd in -1023i64 << 32..1023 << 32) {
            let mut configuration = base();
            configuration.control.kp = I32F32::from_bits(kp);
            configuration.control.ki_tick = I16F48::from_bits(ki);
            configuration.control.kd_tick = I32F32::from_bits(kd);
            prop_assume!(validate(&configuration).is_ok());
            prop_assert_eq!(overlay(&base(), &to_toml(&configuration)).unwrap(), configuration);
        }

        #[test]
        fn no_text_panics(text in "\\PC{0,200}") {
            let _ = overlay(&base(), &text);
            let _ = overlay_only_limits(&base(), &text);
        }
    }

    #[test]
    fn what_is_left_out_stays() {
        let changed = overlay(&base(), "count_sign = \"reversed\"\n[limits]\nstall_ms = 900\n").unwrap();
        let mut expected = base();
        expected.count_sign = CountSign::Reversed;
        expected.limits.stall_ms = 900;
        assert_eq!(changed, expected);
        let keys: Vec<String> = difference(&base(), &changed).into_iter().map(|(key, _, _)| key).collect();
        assert_eq!(keys, ["count_sign", "limits.stall_ms"]);
        assert_eq!(overlay(&base(), "control = \"thesis\"").unwrap().control, ConfigSpec::THESIS);
    }

    #[test]
    fn a_controller_is_a_name_a_table_or_gains() {
        assert_eq!(controller("thesis").unwrap(), ConfigSpec::THESIS);
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path.to_str().unwrap().to_owned()
        };
        // Every field has a key, and what is left out is the default's.
        let changed =
            ConfigSpec { kp: I32F32::lit("50"), reversal_rest_ticks: 7, reversal_limit_ticks: 9, ..ConfigSpec::THESIS };
        let whole = file("whole.toml", &to_toml(&Configuration { pwm_hz: 60, ..Configuration::with_control(changed) }));
        assert_eq!(controller(&whole).unwrap(), changed);
        let part = file("part.toml", "[control]\nkp = 50.0\n");
        assert_eq!(controller(&part).unwrap(), ConfigSpec { kp: I32F32::lit("50"), ..ConfigSpec::DEFAULT });
        let gains = file(
            "gains.toml",
            "kp = 1.0\nki = 0.5\nkd = 0.0\nperiod_us = 500.0\nduty_steps = 32\nintegral_min = -1.0\nintegral_max = 1.0\n",
        );
        assert_eq!(controller(&gains).unwrap().ki_tick, I16F48::from_num(0.5 * 500e-6));
        for (text, named) in [
            ("[control]\nkpp = 1\n", "`control.kpp` is unknown"),
            ("[control]\nreversal_rest_ticks = 3\nreversal_limit_ticks = 2\n", "reversal_rest_ticks must not be above"),
            ("[control", "TOML parse error"),
        ] {
            let error = controller(&file("bad.toml", text)).unwrap_err().to_string();
            assert!(error.contains(named) && error.contains("bad.toml"), "{text:?}: {error}");
        }
        assert!(controller("no-such").unwrap_err().to_string().contains("no-such"));
    }

    #[test]
    fn limits_alone_come_from_a_file_of_limits_or_a_whole_one() {
        let flat = overlay_only_limits(&base(), "position_max = 50").unwrap();
        assert_eq!(flat.limits.position_max, 50);
        let mut whole = Configuration::with_control(ConfigSpec::THESIS);
        whole.limits.position_max = 50;
        assert_eq!(overlay_only_limits(&base(), &to_toml(&whole)).unwrap(), flat, "the rest of the file is not taken");
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, named) in [
            ("pwm = 3", "`pwm` is unknown"),
            ("pwm_hz = 5", "`pwm_hz` = 5: 10 to 2000"),
            ("pwm_hz = 70000", "`pwm_hz` = 70000: out of range"),
            ("edges_per_rev = \"many\"", "`edges_per_rev` = \"many\": a whole number"),
            ("count_sign = \"left\"", "`count_sign` = \"left\": \"positive\" or \"reversed\""),
            ("control = 3", "`control` = 3: a table"),
            ("control = \"pid\"", "`control` = \"pid\": `thesis`"),
            ("[control]\nkp = true", "`control.kp` = true: a number"),
            ("[control]\nkp = nan", "`control.kp` = nan: not a number"),
            ("[control]\nkp = 1e300", "not a number that fixed point can hold"),
            ("[control]\nkp = 2000", "[control]: gain kp"),
            ("[control]\nki = 1", "`control.ki` is unknown"),
            ("[limits]\nstall_ms = -1", "`limits.stall_ms` = -1"),
            ("[limits]\nstall_ms = 0", "[limits]: limit stall_ms"),
            ("[limits]\nstall = 1", "`limits.stall` is unknown"),
            ("limits = 3", "`limits` = 3: a table"),
            ("pwm_hz = ", "TOML parse error"),
        ] {
            let error = overlay(&base(), text).unwrap_err().to_string();
            assert!(error.contains(named), "{text:?}: {error}");
        }
    }
}
