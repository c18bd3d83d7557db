//! Runs as a page asks for them: angles in degrees, lengths in s.

use crate::link::bench::Action;
use crate::record::series::{duration_ms, speed_run};
use serde::Deserialize;
use twum_shared::Direction;
use twum_shared::message::TrackRun;
use twum_shared::reference::{MAX_WAY_POINTS, Reference, WayPoint};

/// A run.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum Run {
    /// At constant duty.
    Speed {
        /// Fraction of the PWM period with drive on.
        duty: f64,
        /// `cw` or `ccw`.
        direction: Way,
        /// Length, s.
        seconds: f64,
    },
    /// A sine in closed loop.
    Sine {
        /// Amplitude, degrees.
        amplitude_deg: f64,
        /// Angular frequency, rad/s.
        omega_rad_s: f64,
        /// Length, s.
        seconds: f64,
    },
    /// A step at the start.
    Step {
        /// Its height, degrees.
        angle_deg: f64,
        /// Length, s.
        seconds: f64,
    },
    /// A constant speed up to an angle.
    Ramp {
        /// Speed, degrees/s.
        speed_deg_s: f64,
        /// Where it ends, degrees without sign.
        limit_deg: f64,
        /// Length, s.
        seconds: f64,
    },
    /// Quintics through way points.
    Path {
        /// Angle (degrees) and the time to get there (s).
        points: Vec<(f64, f64)>,
        /// Length, s.
        seconds: f64,
    },
}

/// A direction of rotation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Way {
    /// Clockwise.
    Cw,
    /// Counter-clockwise.
    Ccw,
}

impl Run {
    /// One word for it, which its recording is named with.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Speed { .. } => "speed",
            Self::Sine { .. } => "sine",
            Self::Step { .. } => "step",
            Self::Ramp { .. } => "ramp",
            Self::Path { .. } => "path",
        }
    }

    /// What the board is to do, by its encoder.
    ///
    /// # Errors
    /// Names the value that cannot be.
    pub fn action(&self, edges_per_rev: u16) -> Result<Action, String> {
        let counts = |name: &str, degrees: f64| whole(name, degrees * f64::from(edges_per_rev) / 360.0);
        let track = |reference: Reference, seconds: f64| {
            reference.validate().map_err(|error| error.to_string())?;
            let duration_ms = duration_ms(seconds).map_err(|error| error.to_string())?;
            Ok(Action::Track(TrackRun { reference, duration_ms }))
        };
        match self {
            Self::Speed { duty, direction, seconds } => {
                let direction = match direction {
                    Way::Cw => Direction::Cw,
                    Way::Ccw => Direction::Ccw,
                };
                Ok(Action::Speed(speed_run(*duty, direction, *seconds).map_err(|error| error.to_string())?))
            }
            Self::Sine { amplitude_deg, omega_rad_s, seconds } => {
                if !(0.0..=100.0).contains(omega_rad_s) {
                    return Err(format!("omega_rad_s = {omega_rad_s}: outside 0 to 100"));
                }
                let amplitude = counts("amplitude_deg", *amplitude_deg)?;
                let omega_urad_s = (omega_rad_s * 1e6).round() as u32;
                track(Reference::Sine { amplitude, omega_urad_s }, *seconds)
            }
            Self::Step { angle_deg, seconds } => {
                track(Reference::Step { position: counts("angle_deg", *angle_deg)?, at_us: 0 }, *seconds)
            }
            Self::Ramp { speed_deg_s, limit_deg, seconds } => {
                let limit = u32::try_from(counts("limit_deg", *limit_deg)?)
                    .map_err(|_| format!("limit_deg = {limit_deg}: an amount has no sign"))?;
                track(Reference::Ramp { rate: counts("speed_deg_s", *speed_deg_s)?, limit }, *seconds)
            }
            Self::Path { points, seconds } => {
                let mut way_points = heapless::Vec::new();
                for (angle_deg, seconds) in points {
                    if !(0.0..=4000.0).contains(seconds) {
                        return Err(format!("points: {seconds} s is outside 0 to 4000 s"));
                    }
                    let point = WayPoint {
                        position: counts("points", *angle_deg)?,
                        duration_us: (seconds * 1e6).round() as u32,
                    };
                    way_points
                        .push(point)
                        .map_err(|_| format!("points: {} way points, at most {MAX_WAY_POINTS} fit", points.len()))?;
                }
                track(Reference::Path { start: 0, way_points }, *seconds)
            }
        }
    }
}

fn whole(name: &str, value: f64) -> Result<i32, String> {
    let value = value.round();
    if value.is_finite() && value.abs() <= f64::from(i32::MAX) {
        Ok(value as i32)
    } else {
        Err(format!("{name}: more than the board can count"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn action(text: &str) -> Result<Action, String> {
        serde_json::from_str::<Run>(text).map_err(|error| error.to_string())?.action(400)
    }

    #[test]
    fn the_sine_of_the_thesis_is_89_counts() {
        let asked = action(r#"{"kind":"sine","amplitude_deg":80.1,"omega_rad_s":1.257,"seconds":20}"#);
        let Ok(Action::Track(run)) = asked else { panic!("{asked:?}") };
        assert_eq!(run.reference, Reference::Sine { amplitude: 89, omega_urad_s: 1_257_000 });
        assert_eq!(run.duration_ms, 20_000);
    }

    #[test]
    fn what_cannot_be_is_named() {
        for (text, named) in [
            (r#"{"kind":"speed","duty":1.5,"direction":"cw","seconds":5}"#, "duty 1.5"),
            (r#"{"kind":"speed","duty":0.5,"direction":"up","seconds":5}"#, "up"),
            (r#"{"kind":"speed","duty":0.5,"direction":"cw","seconds":0}"#, "0 s is outside"),
            (r#"{"kind":"speed","duty":0.5,"direction":"cw","seconds":4000}"#, "4000 s is outside"),
            (r#"{"kind":"sine","amplitude_deg":1e300,"omega_rad_s":1,"seconds":1}"#, "amplitude_deg"),
            (r#"{"kind":"sine","amplitude_deg":1,"omega_rad_s":-1,"seconds":1}"#, "omega_rad_s"),
            (r#"{"kind":"ramp","speed_deg_s":1,"limit_deg":-9,"seconds":1}"#, "limit_deg"),
            (r#"{"kind":"path","points":[],"seconds":1}"#, "at least one way point"),
            (r#"{"kind":"path","points":[[9,0]],"seconds":1}"#, "moves in no time"),
            (r#"{"kind":"fly","seconds":1}"#, "fly"),
            (r#"{"kind":"step","angle_deg":1,"seconds":1,"force":true}"#, "force"),
        ] {
            let error = action(text).unwrap_err();
            assert!(error.contains(named), "{text}: {error}");
        }
        let many = vec!["[1,1]"; 17].join(",");
        assert!(
            action(&format!(r#"{{"kind":"path","points":[{many}],"seconds":1}}"#)).unwrap_err().contains("at most 16")
        );
    }
}
