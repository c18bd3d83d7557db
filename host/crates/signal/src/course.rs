//! The course of an open-loop run: how it starts, how fast it goes once settled, how it stops.
//!
//! Every command that states one of these figures takes it from here.

use super::run::Motion;
use super::turn::TurnFit;
use serde::Serialize;
use std::ops::Range;
use twum_record::measurement::Run;

/// The start of a run that its settled part leaves out, in s: the real motor's start is over by then.
pub const START_S: f64 = 0.2;
/// Share of the settled speed that counts as risen, one time constant of a lag.
const RISEN: f64 = 0.63;
/// Share of the settled speed below which the rotor counts as stopped: what a speed estimated over an edge interval can tell.
const STOPPED: f64 = 0.05;

/// How a run was driven, as far as it is known.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Drive {
    /// When the drive ended, in s; to the record's end where it is not known.
    pub on_s: Option<f64>,
    /// Fraction of the PWM period with the drive on.
    pub duty: Option<f64>,
}

impl Drive {
    /// That of an open-loop run.
    pub fn of(run: &Run) -> Self {
        Self { on_s: run.drive_on_s, duty: run.duty }
    }
}

/// The figures of a run. Speeds are signed as the motion's.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Course {
    /// Mean speed of the driven, settled part, in rpm; none when no speed is known there.
    pub mean_rpm: Option<f64>,
    /// From and to when the speed counts as driven and settled, in s.
    pub settled_s: [f64; 2],
    /// Greatest speed (by amount) of the start, in rpm.
    pub start_peak_rpm: Option<f64>,
    /// When that was, in s after the drive began.
    pub start_peak_s: Option<f64>,
    /// By what share of the settled speed the start goes beyond it; 0 when it does not, none where the drive is pulsed: every pulse
    /// then goes beyond the mean.
    pub overshoot: Option<f64>,
    /// From the start of the drive to 63 % of the settled speed, in s.
    pub rise_s: Option<f64>,
    /// From the end of the drive to 5 % of the settled speed, in s.
    pub stop_s: Option<f64>,
    /// Angle turned after the end of the drive, in degrees.
    pub coast_deg: Option<f64>,
    /// Samples of the settled part.
    #[serde(skip)]
    pub settled: Range<usize>,
    /// The speed over angle and time in the settled part; none below a turn.
    #[serde(skip)]
    pub fit: Option<TurnFit>,
}

impl Course {
    /// Reads the figures off a motion that is driven from its start (or t = 0, whichever is later). Of a drive shorter than 0.4 s the second half counts as settled.
    pub fn of(motion: &Motion, drive: Drive) -> Self {
        let pulsed = drive.duty.is_some_and(|duty| duty < 1.0);
        let seconds = |us: f64| us * 1e-6;
        let (first_s, last_s) =
            motion.time_us.first().zip(motion.time_us.last()).map_or((0.0, 0.0), |(a, b)| (seconds(*a), seconds(*b)));
        let begin_s = first_s.max(0.0);
        let off_s = drive.on_s.filter(|off| *off > begin_s && *off < last_s);
        let driven_to_s = off_s.unwrap_or(last_s);
        let from_s = begin_s + START_S.min(0.5 * (driven_to_s - begin_s));
        let index = |s: f64| motion.time_us.partition_point(|t| seconds(*t) < s);
        let to = if off_s.is_some() { index(driven_to_s) } else { motion.time_us.len() };
        let (begin, settled) = (index(begin_s), index(from_s)..to.max(index(from_s)));

        let known = |range: Range<usize>| range.filter(|i| motion.speed_rpm[*i].is_finite());
        let count = known(settled.clone()).count();
        let mean_rpm =
            (count > 0).then(|| known(settled.clone()).map(|i| motion.speed_rpm[i]).sum::<f64>() / count as f64);
        let peak = known(begin..settled.start)
            .max_by(|a, b| motion.speed_rpm[*a].abs().total_cmp(&motion.speed_rpm[*b].abs()));
        let time_s: Vec<f64> = motion.time_us[settled.clone()].iter().map(|t| seconds(*t)).collect();
        let fit = TurnFit::new(&time_s, &motion.position_rad[settled.clone()], &motion.speed_rpm[settled.clone()]).ok();

        // Shares of the settled speed, positive in its own direction.
        let moving = mean_rpm.filter(|mean| *mean != 0.0);
        let first = |mut range: Range<usize>, reached: &dyn Fn(f64) -> bool| {
            let mean = moving?;
            range.find(|i| reached(motion.speed_rpm[*i] / mean)).map(|i| seconds(motion.time_us[i]))
        };
        let start_peak_rpm = peak.map(|i| motion.speed_rpm[i]);
        let end = motion.position_rad.last().copied();
        Self {
            mean_rpm,
            settled_s: [from_s, driven_to_s],
            start_peak_rpm,
            start_peak_s: peak.map(|i| seconds(motion.time_us[i]) - begin_s),
            overshoot: start_peak_rpm.zip(moving).filter(|_| !pulsed).map(|(peak, mean)| (peak / mean - 1.0).max(0.0)),
            rise_s: first(begin..to, &|share| share >= RISEN).map(|at| at - begin_s),
            stop_s: off_s.and_then(|off| first(to..motion.time_us.len(), &|share| share <= STOPPED).map(|at| at - off)),
            coast_deg: off_s.and(motion.position_rad.get(to).zip(end)).map(|(at, end)| (end - at).abs().to_degrees()),
            settled,
            fit,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// A motor that rises to 50 rpm, settles at 35 by 0.1 s, and brakes from 2 s to 2.1 s, recorded for 3 s.
    fn motion(sense: f64) -> Motion {
        let rpm = |t: f64| match t {
            t if t < 0.05 => 1000.0 * t,
            t if t < 0.1 => 50.0 - 300.0 * (t - 0.05),
            t if t < 2.0 => 35.0,
            t if t < 2.1 => 35.0 * (1.0 - (t - 2.0) / 0.1),
            _ => 0.0,
        };
        let times: Vec<f64> = (0..3000).map(|i| f64::from(i) * 1e-3).collect();
        let mut angle = 0.0;
        let position_rad = times
            .iter()
            .map(|t| {
                let here = angle;
                angle += sense * rpm(*t) / 60.0 * TAU * 1e-3;
                here
            })
            .collect();
        Motion {
            time_us: times.iter().map(|t| t * 1e6).collect(),
            position_rad,
            speed_rpm: times.iter().map(|t| sense * rpm(*t)).collect(),
            speed_sd_rpm: None,
            edges: 0,
            encoder: None,
        }
    }

    fn driven(on_s: f64) -> Drive {
        Drive { on_s: Some(on_s), duty: Some(1.0) }
    }

    #[test]
    fn only_the_driven_settled_part_makes_the_mean() {
        for sense in [1.0, -1.0] {
            let found = Course::of(&motion(sense), driven(2.0));
            assert!((found.mean_rpm.unwrap() - sense * 35.0).abs() < 1e-9, "{found:?}");
            let fit = found.fit.as_ref().unwrap();
            assert!(fit.drift_rpm_per_s.abs() < 1e-6 && fit.amplitude_rpm[0] < 1e-6, "{found:?}");
            assert!((found.rise_s.unwrap() - 0.023).abs() < 1e-9, "63 % of 35 rpm at 1000 rpm/s");
            assert!((found.overshoot.unwrap() - (50.0 / 35.0 - 1.0)).abs() < 1e-3);
            assert!((found.stop_s.unwrap() - 0.095).abs() < 1.5e-3);
            // Half the speed for 0.1 s: 35 rpm are 210°/s.
            assert!((found.coast_deg.unwrap() - 10.5).abs() < 0.2, "{found:?}");
        }
    }

    #[test]
    fn what_is_not_there_is_not_said() {
        let still = Motion { speed_rpm: vec![0.0; 3000], position_rad: vec![0.0; 3000], ..motion(1.0) };
        let found = Course::of(&still, Drive::default());
        assert_eq!((found.mean_rpm, found.rise_s, found.overshoot, found.stop_s), (Some(0.0), None, None, None));
        let none = Motion { time_us: vec![], position_rad: vec![], speed_rpm: vec![], ..motion(1.0) };
        assert_eq!(Course::of(&none, driven(1.0)).mean_rpm, None);
        // Every pulse of a pulsed drive goes beyond the mean: that is no overshoot.
        let pulsed = Drive { duty: Some(0.5), ..driven(2.0) };
        assert_eq!(Course::of(&motion(1.0), pulsed).overshoot, None);
        // A drive that ends after the record is one to its end.
        let open = Course::of(&motion(1.0), driven(5.0));
        assert_eq!((open.stop_s, open.coast_deg), (None, None));
    }
}
