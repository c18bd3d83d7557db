//! A controller as people write it, turned into the fixed-point one that runs.

use super::{ControlGains, ControlSpec};
use fixed::types::{I16F48, I32F32};
use std::path::{Path, PathBuf};
use thiserror::Error;
use twum_files::input;
use twum_shared::step::{Config, ConfigError, ConfigSpec, DriveLaw};

/// Why a controller cannot run.
#[derive(Debug, Error)]
pub enum ControlError {
    /// A value fixed point cannot hold.
    #[error("{name} = {value} cannot be represented: {range}")]
    Unrepresentable {
        /// Which value.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What can be.
        range: &'static str,
    },
    /// Representable, but refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A file that cannot be read.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
}

impl ControlSpec {
    /// The controller named `thesis` or `default`, or the gains in a TOML file (`kp`, `ki`, `kd`, `period_us`,
    /// `duty_steps`, `integral_min`, `integral_max`).
    ///
    /// # Errors
    /// A file that cannot be read or holds no gains.
    pub fn named(name: &str) -> Result<Self, ControlError> {
        match name {
            "thesis" => Ok(Self::Thesis),
            "default" => Ok(Self::Default),
            path => {
                let file = |reason: String| ControlError::File { path: path.into(), reason };
                let text = input::text(Path::new(path), input::WRITTEN).map_err(|error| {
                    file(format!("{error}; a controller is `thesis`, `default` or a TOML file of gains"))
                })?;
                let gains: ControlGains = toml::from_str(&text).map_err(|error| file(error.to_string()))?;
                gains.validate().map_err(file)?;
                Ok(Self::Table(gains))
            }
        }
    }

    /// The fixed-point controller, validated.
    ///
    /// # Errors
    /// A gain, clamp, period or step count that cannot be represented or is refused.
    pub fn config(&self) -> Result<ConfigSpec, ControlError> {
        let spec = match self {
            Self::Thesis => ConfigSpec::THESIS,
            Self::Default => ConfigSpec::DEFAULT,
            Self::Table(gains) => gains.config()?,
        };
        Config::try_from(spec)?;
        Ok(spec)
    }
}

impl ControlGains {
    /// A plain PID with true off: gains per second become gains per tick.
    fn config(&self) -> Result<ConfigSpec, ControlError> {
        let period_s = self.period_us * 1e-6;
        let gain = |name, value: f64, per_tick: f64| {
            I32F32::checked_from_num(per_tick).ok_or(ControlError::Unrepresentable {
                name,
                value,
                range: "its magnitude must stay below 1024 duty steps a tick",
            })
        };
        let clamp = |name, value: f64| {
            let ticks = (value / period_s).round();
            if ticks.abs() <= f64::from(i32::MAX) {
                Ok(ticks as i32)
            } else {
                Err(ControlError::Unrepresentable { name, value, range: "at most 2^31 count·ticks" })
            }
        };
        let whole_period = self.period_us.round() == self.period_us;
        if !whole_period {
            let (value, range) = (self.period_us, "a whole number of µs");
            return Err(ControlError::Unrepresentable { name: "period_us", value, range });
        }
        let duty_steps = u16::try_from(self.duty_steps).map_err(|_| ControlError::Unrepresentable {
            name: "duty_steps",
            value: f64::from(self.duty_steps),
            range: "2 to 32768",
        })?;
        Ok(ConfigSpec {
            kp: gain("kp", self.kp, self.kp)?,
            ki_tick: I16F48::checked_from_num(self.ki * period_s).ok_or(ControlError::Unrepresentable {
                name: "ki",
                value: self.ki,
                range: "its magnitude must stay below 1024 duty steps a tick",
            })?,
            kd_tick: gain("kd", self.kd, self.kd / period_s)?,
            feed_forward: I32F32::ZERO,
            integral_min: clamp("integral_min", self.integral_min)?,
            integral_max: clamp("integral_max", self.integral_max)?,
            period_us: self.period_us as u32,
            duty_steps,
            law: DriveLaw::OnTimeRounded,
            dead_band_counts: 0,
            conditional_integration: false,
            ..ConfigSpec::DEFAULT
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const THESIS_GAINS: ControlGains = ControlGains {
        kp: 1.3,
        ki: 0.0015,
        kd: 0.00004,
        period_us: 500.0,
        duty_steps: 32,
        integral_min: 0.0,
        integral_max: 31.0,
    };

    #[test]
    fn the_thesis_gains_become_the_thesis_configuration() {
        let spec = ControlSpec::Table(THESIS_GAINS).config().unwrap();
        let thesis = ConfigSpec::THESIS;
        assert_eq!((spec.kp, spec.ki_tick, spec.kd_tick), (thesis.kp, thesis.ki_tick, thesis.kd_tick));
        assert_eq!((spec.integral_min, spec.integral_max), (thesis.integral_min, thesis.integral_max));
    }

    #[test]
    fn what_fixed_point_cannot_hold_is_named() {
        let with = |change: fn(&mut ControlGains)| {
            let mut gains = THESIS_GAINS;
            change(&mut gains);
            ControlSpec::Table(gains).config().unwrap_err().to_string()
        };
        assert!(with(|g| g.kp = 1e12).starts_with("kp = 1000000000000 cannot be represented"));
        assert!(with(|g| g.kp = 2000.0).contains("kp is out of range"));
        assert!(with(|g| g.ki = 1e9).starts_with("ki = 1000000000"));
        assert!(with(|g| g.integral_max = 1e9).starts_with("integral_max"));
        assert!(with(|g| g.period_us = 500.5).contains("whole number"));
        assert!(with(|g| g.duty_steps = 65_536).contains("duty_steps"));
    }

    #[test]
    fn a_controller_that_is_no_file_says_what_there_is() {
        let error = ControlSpec::named("no-such").unwrap_err().to_string();
        assert!(error.contains("no-such") && error.contains("thesis"), "{error}");
    }
}
