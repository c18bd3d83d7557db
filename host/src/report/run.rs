//! What is said of one run: of an open-loop run its course, of a closed loop how it followed.

use crate::model::tracking::{Tick, Tracking};
use crate::record::measurement::{Measurement, Run, RunData, RunKind};
use crate::signal::SignalError;
use crate::signal::course::{Course, Drive};
use crate::signal::run::{EncoderErrors, Method, Motion, Options, motion};
use crate::signal::turn::ORDERS;
use serde::Serialize;
use std::fmt;

/// The figures of an open-loop run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpeedFigures {
    /// The run.
    pub id: String,
    /// Fraction of the PWM period with drive on.
    pub duty: Option<f64>,
    /// Length of the record, in s.
    pub duration_s: f64,
    /// Edges seen; 0 when the record holds speeds.
    pub edges: usize,
    /// Start, settled part, stop.
    #[serde(flatten)]
    pub course: Course,
    /// Time of the first edge, in s from t = 0.
    pub first_edge_s: Option<f64>,
    /// Standard deviation of the estimated speed in the settled part, in rpm.
    pub speed_sd_rpm: Option<f64>,
    /// Change of the settled speed with time, in rpm/s.
    pub drift_rpm_per_s: Option<f64>,
    /// Amplitude of the settled speed's orders of a turn, in rpm.
    pub ripple_rpm: Option<[f64; ORDERS]>,
    /// Share of its variance that drift and ripple explain.
    pub ripple_r2: Option<f64>,
    /// Turns in the settled part.
    pub turns: Option<f64>,
    /// What the estimate found out about the encoder.
    pub encoder: Option<EncoderErrors>,
}

impl SpeedFigures {
    /// Reads them off a run and its motion.
    pub fn of(run: &Run, motion: &Motion) -> Self {
        let course = Course::of(motion, Drive::of(run));
        let fit = course.fit.as_ref();
        let (start_us, end_us) = run.span_us();
        let variance = motion.speed_sd_rpm.as_ref().and_then(|sd| {
            let settled = &sd[course.settled.clone()];
            (!settled.is_empty()).then(|| settled.iter().map(|v| v * v).sum::<f64>() / settled.len() as f64)
        });
        let first_edge_s = match &run.data {
            RunData::Edges { edges, .. } => edges.first().map(|edge| edge.time_us * 1e-6),
            _ => None,
        };
        Self {
            id: run.id.clone(),
            duty: run.duty,
            duration_s: (end_us - start_us) * 1e-6,
            edges: motion.edges,
            first_edge_s,
            speed_sd_rpm: variance.map(f64::sqrt),
            drift_rpm_per_s: fit.map(|f| f.drift_rpm_per_s),
            ripple_rpm: fit.map(|f| f.amplitude_rpm),
            ripple_r2: fit.map(|f| f.r2),
            turns: fit.map(|f| f.turns),
            encoder: motion.encoder,
            course,
        }
    }
}

/// What the motor did in a run that was made.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "lowercase", tag = "kind")]
pub enum RunFigures {
    /// Open loop.
    Speed(Box<SpeedFigures>),
    /// Closed loop.
    Track(Tracking),
}

impl RunFigures {
    /// The figures of the first run of a recording; none when it holds none.
    ///
    /// # Errors
    /// When its edges cannot be read as a speed.
    pub fn of(measurement: &Measurement) -> Result<Option<Self>, SignalError> {
        let Some(run) = measurement.runs.first() else { return Ok(None) };
        let edges_per_rev = measurement.edges_per_rev;
        if let (RunKind::Track, RunData::Control(rows)) = (run.kind, &run.data) {
            let ticks: Vec<Tick> = rows
                .iter()
                .map(|row| Tick {
                    time_s: row.time_us * 1e-6,
                    target: row.target as i64,
                    position: row.position as i64,
                    duty: row.duty,
                })
                .collect();
            return Ok(Tracking::of(&ticks, edges_per_rev).map(Self::Track));
        }
        // As `twum velocity` estimates.
        let options = Options { method: Method::Smoother, edges_per_rev, period_us: None, edge_uncertainty_us: 2.0 };
        Ok(Some(Self::Speed(Box::new(SpeedFigures::of(run, &motion(run, &options)?)))))
    }

    /// What a reader should know before believing the figures, in words.
    pub fn warnings(&self) -> Vec<String> {
        match self {
            Self::Track(tracking) => tracking.warnings(),
            Self::Speed(speed) if speed.edges == 0 && speed.duty.is_some_and(|duty| duty > 0.0) => {
                vec!["the motor did not move: no edge of the encoder was seen".to_owned()]
            }
            Self::Speed(_) => Vec::new(),
        }
    }
}

impl fmt::Display for RunFigures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Speed(speed) => write_speed(f, speed),
            Self::Track(tracking) => write_tracking(f, tracking),
        }
    }
}

fn write_speed(f: &mut fmt::Formatter<'_>, speed: &SpeedFigures) -> fmt::Result {
    let c = &speed.course;
    let Some(mean) = c.mean_rpm.filter(|_| speed.edges > 0) else {
        return writeln!(f, "speed   none: no edge was seen");
    };
    write!(f, "speed   {mean:.3} rpm, the mean of {:.1} to {:.1} s", c.settled_s[0], c.settled_s[1])?;
    if let (Some(drift), Some(ripple)) = (speed.drift_rpm_per_s, speed.ripple_rpm) {
        let strongest = (0..ORDERS).fold(0, |a, b| if ripple[b] > ripple[a] { b } else { a });
        write!(f, "; drift {drift:+.3} rpm/s, ripple {:.2} rpm, {} a turn", ripple[strongest], strongest + 1)?;
    }
    writeln!(f)?;
    let ms = |name: &str, v: Option<f64>| v.map(|v| format!("{name} {:.0} ms", 1e3 * v));
    let start = [
        ms("first edge at", speed.first_edge_s),
        ms("63 % of the speed after", c.rise_s),
        c.overshoot.map(|v| format!("overshoot {:.0} %", 100.0 * v)),
    ];
    writeln!(f, "start   {}", start.into_iter().flatten().collect::<Vec<_>>().join(", "))?;
    let stop = [ms("at rest after", c.stop_s), c.coast_deg.map(|v| format!("{v:.1}° turned since the drive went off"))];
    let stop: Vec<String> = stop.into_iter().flatten().collect();
    if stop.is_empty() { Ok(()) } else { writeln!(f, "stop    {}", stop.join(", ")) }
}

fn write_tracking(f: &mut fmt::Formatter<'_>, t: &Tracking) -> fmt::Result {
    writeln!(
        f,
        "error   {:.3}° RMS, {:.3}° mean, {:.1}° worst; fully on in {:.1} % of {} ticks",
        t.rms_deg,
        t.mean_abs_deg,
        t.worst_deg,
        100.0 * t.full_duty,
        t.ticks
    )?;
    let Some(step) = &t.step else { return Ok(()) };
    let settled = step.settling_s.map_or("not settled".to_owned(), |s| format!("settled after {:.0} ms", 1e3 * s));
    writeln!(f, "step    {:.1}°: {settled}, overshoot {:.1}°", step.height_deg, step.overshoot_deg)
}
