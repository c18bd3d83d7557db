//! The friction bench: its geometry and data sets, read from `friction.toml`.

use serde::Deserialize;
use std::path::Path;

/// Standard gravity (m/s²).
const GRAVITY: f64 = 9.80665;

/// Why friction could not be identified.
#[derive(Debug, thiserror::Error)]
pub enum FrictionError {
    /// The file system said no.
    #[error("{path}: {cause}")]
    Io {
        /// File or folder.
        path: String,
        /// The cause.
        cause: std::io::Error,
    },
    /// `friction.toml` is not right.
    #[error("{path}: {message}")]
    Setup {
        /// The file.
        path: String,
        /// What is wrong and what to do.
        message: String,
    },
    /// A trial is not right.
    #[error("{path}: {message}")]
    Trial {
        /// The file.
        path: String,
        /// What is wrong and what to do.
        message: String,
    },
    /// Trials are missing.
    #[error("{missing}: missing; every speed needs {trials} trials (or pass --allow-missing to go on without)")]
    Missing {
        /// The missing files.
        missing: String,
        /// Trials a speed.
        trials: usize,
    },
    /// The outcome cannot be.
    #[error("{0}")]
    Implausible(String),
}

/// Geometry of the bench (thesis section A.2.2): the lead screw pulls a wire on the motor, a torque arm holds the sensor.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Setup {
    /// Length of the torque arm (m).
    pub torque_arm_m: f64,
    /// Radius at which the wire is attached (m).
    pub attachment_radius_m: f64,
    /// Radius of the contact between rotor and stator (m).
    pub contact_radius_m: f64,
    /// Mass pressing the motor together (kg).
    pub weight_kg: f64,
    /// Travel of the Coulomb test (mm).
    pub coulomb_travel_mm: f64,
    /// Travel of the static test before the motor slips (mm).
    pub static_travel_mm: f64,
    /// Lead of the screw (mm a turn).
    pub lead_mm: f64,
    /// Gear reduction between motor and screw.
    pub gear_reduction: f64,
    /// Sampling rate of the torque (Hz).
    #[serde(default = "default_sample_hz")]
    pub sample_hz: f64,
    /// +1, or −1 where the sensor reads friction as negative (as the thesis's did).
    #[serde(default = "default_sign")]
    pub torque_sign: f64,
    /// Cut-off of the low-pass (Hz); from the power spectrum when absent. The thesis took 0.5.
    pub cutoff_hz: Option<f64>,
    /// Speeds tested (rpm of the screw's motor); those found when absent.
    pub speeds_rpm: Option<Vec<u32>>,
    /// Trials a speed; the most found when absent.
    pub trials: Option<usize>,
    /// Standard uncertainties.
    #[serde(default)]
    pub uncertainty: Uncertainty,
}

/// Standard uncertainties of the geometry, absolute in the unit of the key, and of the sensor's slope as a share.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Uncertainty {
    /// Torque arm (m).
    pub torque_arm_m: f64,
    /// Attachment radius (m).
    pub attachment_radius_m: f64,
    /// Contact radius (m).
    pub contact_radius_m: f64,
    /// Weight (kg).
    pub weight_kg: f64,
    /// Sensor slope (share).
    pub torque_relative: f64,
}

fn default_sample_hz() -> f64 {
    1000.0
}

fn default_sign() -> f64 {
    1.0
}

impl Setup {
    /// Reads `friction.toml` in `folder`.
    ///
    /// # Errors
    /// When it is absent, not TOML, has unknown or missing keys, or a value that no bench can have.
    pub fn load(folder: &Path) -> Result<Self, FrictionError> {
        let path = folder.join("friction.toml");
        let name = path.display().to_string();
        let text = twum_files::input::text(&path, twum_files::input::WRITTEN)
            .map_err(|cause| FrictionError::Io { path: name.clone(), cause })?;
        let setup: Self = toml::from_str(&text)
            .map_err(|e| FrictionError::Setup { path: name.clone(), message: e.to_string().trim().to_owned() })?;
        setup.check().map_err(|message| FrictionError::Setup { path: name, message })?;
        Ok(setup)
    }

    fn check(&self) -> Result<(), String> {
        // (key, value, least, most): beyond these a unit was mixed up.
        let bounds = [
            ("torque_arm_m", self.torque_arm_m, 5e-3, 5.0),
            ("attachment_radius_m", self.attachment_radius_m, 5e-4, 0.5),
            ("contact_radius_m", self.contact_radius_m, 5e-4, 0.5),
            ("weight_kg", self.weight_kg, 1e-3, 100.0),
            ("coulomb_travel_mm", self.coulomb_travel_mm, 1e-2, 1e3),
            ("static_travel_mm", self.static_travel_mm, 1e-2, 1e3),
            ("lead_mm", self.lead_mm, 1e-2, 100.0),
            ("gear_reduction", self.gear_reduction, 1e-2, 1e4),
            ("sample_hz", self.sample_hz, 10.0, 1e6),
        ];
        for (key, value, least, most) in bounds {
            if !(least..=most).contains(&value) {
                let hint = if key.ends_with("_m") && value > most {
                    ": it looks like millimetres"
                } else if key.ends_with("_kg") && value > most {
                    ": it looks like grams"
                } else {
                    ""
                };
                return Err(format!("`{key} = {value}` is outside {least} to {most}{hint}"));
            }
        }
        if self.torque_sign.abs() != 1.0 {
            return Err(format!("`torque_sign = {}` must be 1 or -1", self.torque_sign));
        }
        if let Some(cutoff) = self.cutoff_hz
            && !(cutoff > 0.0 && cutoff < 0.4 * self.sample_hz)
        {
            return Err(format!("`cutoff_hz = {cutoff}` must lie between 0 and 0.4 of sample_hz"));
        }
        let u = &self.uncertainty;
        for (key, value) in [
            ("torque_arm_m", u.torque_arm_m),
            ("attachment_radius_m", u.attachment_radius_m),
            ("contact_radius_m", u.contact_radius_m),
            ("weight_kg", u.weight_kg),
            ("torque_relative", u.torque_relative),
        ] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(format!("`uncertainty.{key} = {value}` must not be negative"));
            }
        }
        Ok(())
    }

    /// Friction coefficient a newton metre at the sensor: µ = T·r_attach/(l·m·g·r_contact).
    pub fn coefficient_per_nm(&self) -> f64 {
        self.attachment_radius_m / (self.torque_arm_m * self.weight_kg * GRAVITY * self.contact_radius_m)
    }

    /// Relative standard uncertainty of that factor.
    pub fn coefficient_relative(&self) -> f64 {
        let u = &self.uncertainty;
        [
            u.torque_arm_m / self.torque_arm_m,
            u.attachment_radius_m / self.attachment_radius_m,
            u.contact_radius_m / self.contact_radius_m,
            u.weight_kg / self.weight_kg,
            u.torque_relative,
        ]
        .iter()
        .map(|r| r * r)
        .sum::<f64>()
        .sqrt()
    }

    /// How long the screw takes for `travel_mm` at `speed_rpm` (s).
    pub fn duration_s(&self, travel_mm: f64, speed_rpm: u32) -> f64 {
        travel_mm * self.gear_reduction * 60.0 / (f64::from(speed_rpm) * self.lead_mm)
    }

    /// Sliding speed at the contact (m/s).
    pub fn sliding_m_s(&self, speed_rpm: u32) -> f64 {
        f64::from(speed_rpm) / 60.0 / self.gear_reduction * self.lead_mm * 1e-3 * self.contact_radius_m
            / self.attachment_radius_m
    }
}
