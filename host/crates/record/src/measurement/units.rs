//! Units of an ordinary motor's columns, as `measurement.toml` names them: read once, into µs, rad and rpm.

use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Unit of a column `time`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum TimeUnit {
    #[serde(alias = "µs")]
    Us,
    Ms,
    S,
}

/// Unit of a column `position`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum PositionUnit {
    Rad,
    Deg,
    Turns,
    Counts,
    Mm,
    M,
}

/// Unit of a column `speed`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
pub(super) enum SpeedUnit {
    #[serde(rename = "rpm")]
    Rpm,
    #[serde(rename = "rad/s")]
    Rad,
    #[serde(rename = "deg/s")]
    Deg,
    #[serde(rename = "turns/s")]
    Turns,
    #[serde(rename = "counts/s")]
    Counts,
    #[serde(rename = "mm/s")]
    Mm,
    #[serde(rename = "m/s")]
    M,
}

/// The units of a folder.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Units {
    pub(super) time: Option<TimeUnit>,
    pub(super) position: Option<PositionUnit>,
    pub(super) speed: Option<SpeedUnit>,
    /// Counts of the encoder a turn.
    pub(super) counts_per_turn: Option<f64>,
    /// Travel of a linear axis a turn, in mm.
    pub(super) mm_per_turn: Option<f64>,
}

impl Units {
    /// µs of one unit of the column `time`.
    pub(super) fn time_us(&self) -> Result<f64, String> {
        match self.time {
            Some(TimeUnit::Us) => Ok(1.0),
            Some(TimeUnit::Ms) => Ok(1e3),
            Some(TimeUnit::S) => Ok(1e6),
            None => Err("a column `time` needs `time_unit = \"us\"`, \"ms\" or \"s\" in measurement.toml".to_owned()),
        }
    }

    /// Radians of one unit of the column `position`.
    pub(super) fn position_rad(&self) -> Result<f64, String> {
        let Some(unit) = self.position else {
            return Err(
                "a column `position` needs `position_unit` in measurement.toml: rad, deg, turns, counts, mm or m"
                    .to_owned(),
            );
        };
        Ok(TAU
            * match unit {
                PositionUnit::Rad => 1.0 / TAU,
                PositionUnit::Deg => 1.0 / 360.0,
                PositionUnit::Turns => 1.0,
                PositionUnit::Counts => self.counts()?,
                PositionUnit::Mm => self.mm()?,
                PositionUnit::M => 1e3 * self.mm()?,
            })
    }

    /// Turns a minute of one unit of the column `speed`.
    pub(super) fn speed_rpm(&self) -> Result<f64, String> {
        let Some(unit) = self.speed else {
            return Err(
                "a column `speed` needs `speed_unit` in measurement.toml: rpm, rad/s, deg/s, turns/s, counts/s, mm/s or m/s".to_owned(),
            );
        };
        Ok(60.0
            * match unit {
                SpeedUnit::Rpm => 1.0 / 60.0,
                SpeedUnit::Rad => 1.0 / TAU,
                SpeedUnit::Deg => 1.0 / 360.0,
                SpeedUnit::Turns => 1.0,
                SpeedUnit::Counts => self.counts()?,
                SpeedUnit::Mm => self.mm()?,
                SpeedUnit::M => 1e3 * self.mm()?,
            })
    }

    /// Turns of a count.
    fn counts(&self) -> Result<f64, String> {
        let counts = self.counts_per_turn.ok_or("counts need `counts_per_turn` in measurement.toml")?;
        Ok(1.0 / counts)
    }

    /// Turns of a millimetre.
    fn mm(&self) -> Result<f64, String> {
        let travel = self.mm_per_turn.ok_or(
            "m and mm need `mm_per_turn` in measurement.toml: the lead of the screw, or the way of the belt in one turn of the motor",
        )?;
        Ok(1.0 / travel)
    }
}
