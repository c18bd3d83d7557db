//! Coulomb and static friction between rotor and stator, from torque (thesis sections A.2.1 and A.2.2).
//!
//! A lead screw drags the pressed rotor round by a wire while a torque arm holds against it. Sliding torque with the motor
//! less sliding torque without it is Coulomb friction; the peak before it slips is static friction.

pub mod filter;
pub mod setup;
pub mod trials;
pub mod windows;

use serde::Serialize;
use setup::{FrictionError, Setup};
use statrs::distribution::{ContinuousCDF, FisherSnedecor, StudentsT};
use std::path::Path;
use trials::{Set, Trial, Trials};
use twum_fit::quantile::{NORMAL_95, student_95};

/// A coefficient and its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Coefficient {
    /// Estimate.
    pub value: f64,
    /// 95 % interval; absent with a single trial.
    pub ci95: Option<[f64; 2]>,
}

/// One speed's result.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpeedResult {
    /// Speed of the screw's motor (rpm).
    pub speed_rpm: u32,
    /// Sliding speed at the contact (m/s).
    pub sliding_m_s: f64,
    /// Coefficient, torque difference and scatter.
    pub coefficient: Coefficient,
    /// Torque it comes from (N·m).
    pub torque_nm: f64,
    /// Trials used.
    pub trials: usize,
}

/// A coefficient over all speeds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Overall {
    /// Mean of the speeds' values.
    pub value: f64,
    /// Its 95 % interval: trials, differences between speeds and geometry.
    pub ci95: Option<[f64; 2]>,
    /// Change with sliding speed (s/m).
    pub slope_s_m: Option<Coefficient>,
    /// Probability of such a slope without any dependence on speed.
    pub slope_p: Option<f64>,
    /// Probability of such differences between speeds from the scatter of trials alone.
    pub homogeneous_p: Option<f64>,
    /// Each speed.
    pub speeds: Vec<SpeedResult>,
}

/// The answer of `twum identify friction`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Version of this shape.
    pub schema: u32,
    /// Folder read.
    pub source: String,
    /// Coulomb coefficient.
    pub coulomb: Overall,
    /// Static coefficient.
    #[serde(rename = "static")]
    pub stat: Overall,
    /// Cut-off used (Hz).
    pub cutoff_hz: f64,
    /// Where it came from.
    pub cutoff_source: String,
    /// Relative standard uncertainty of geometry and sensor, part of every interval.
    pub geometry_relative: f64,
    /// What a reader should know.
    pub notes: Vec<String>,
}

/// The report and what its figure needs.
#[derive(Debug, Clone)]
pub struct Identification {
    /// The numbers.
    pub report: Report,
    /// Power spectrum of the motor trials (Hz, (N·m)²/Hz), averaged.
    pub spectrum: Vec<(f64, f64)>,
}

/// Identifies friction from a folder; `allow_missing` goes on without missing trials.
///
/// # Errors
/// Names the file or key that is wrong, a missing trial, a reversed sign, or a geometry that contradicts the records.
pub fn identify(folder: &Path, allow_missing: bool) -> Result<Identification, FrictionError> {
    let setup = Setup::load(folder)?;
    let trials = trials::load(folder, &setup, allow_missing)?;
    let spectrum = mean_spectrum(&trials[&Set::Motor], &setup);
    let cutoff = setup.cutoff_hz.unwrap_or_else(|| filter::cutoff_from_spectrum(&spectrum, setup.sample_hz));
    let mut notes = Vec::new();
    let sliding = |set: Set| -> Result<Vec<(u32, f64)>, FrictionError> {
        trials[&set].iter().map(|t| Ok((t.speed_rpm, sliding_torque(t, &setup, set, cutoff)?))).collect()
    };
    let (motor, bench) = (sliding(Set::Motor)?, sliding(Set::NoMotor)?);
    let peaks: Vec<(u32, f64)> = trials[&Set::Static]
        .iter()
        .map(|t| Ok((t.speed_rpm, peak_torque(t, &setup, cutoff)?)))
        .collect::<Result<_, FrictionError>>()?;
    signs(&trials, Set::Motor, &motor, true)?;
    signs(&trials, Set::Static, &peaks, true)?;
    signs(&trials, Set::NoMotor, &bench, false)?;
    let coulomb = combine(&setup, &motor, Some(&bench));
    let stat = combine(&setup, &peaks, None);
    for (name, overall) in [("Coulomb", &coulomb), ("static", &stat)] {
        if !(0.005..=1.5).contains(&overall.value) {
            return Err(FrictionError::Implausible(format!(
                "the {name} coefficient comes out as {:.4}, which no contact has: check torque_arm_m, attachment_radius_m, \
                 contact_radius_m and weight_kg in friction.toml, and the unit of the torque (N m)",
                overall.value
            )));
        }
        if overall.slope_p.is_some_and(|p| p < 0.05) {
            notes.push(format!(
                "the {name} coefficient changes with speed (p = {:.3}): one number hides it",
                overall.slope_p.unwrap_or(f64::NAN)
            ));
        } else if overall.homogeneous_p.is_some_and(|p| p < 0.05) {
            notes.push(format!(
                "the {name} coefficient differs between speeds by more than its trials scatter (p = {:.3}), without a trend",
                overall.homogeneous_p.unwrap_or(f64::NAN)
            ));
        }
    }
    if stat.value < coulomb.value {
        notes.push(
            "the static coefficient is below the Coulomb one: was the static travel long enough to break away?"
                .to_owned(),
        );
    }
    if setup.coefficient_relative() == 0.0 {
        notes.push(
            "no [uncertainty] in friction.toml: the intervals hold the geometry and the sensor's slope for exact"
                .to_owned(),
        );
    }
    let report = Report {
        schema: 1,
        source: folder.display().to_string(),
        coulomb,
        stat,
        cutoff_hz: cutoff,
        cutoff_source: if setup.cutoff_hz.is_some() { "friction.toml" } else { "power spectrum" }.to_owned(),
        geometry_relative: setup.coefficient_relative(),
        notes,
    };
    Ok(Identification { report, spectrum })
}

fn mean_spectrum(trials: &[Trial], setup: &Setup) -> Vec<(f64, f64)> {
    let shortest = trials.iter().map(|t| t.torque_nm.len()).min().unwrap_or(0);
    let segment = shortest.min((8.0 * setup.sample_hz) as usize);
    let mut mean: Vec<(f64, f64)> = Vec::new();
    for trial in trials {
        let one = filter::power_spectrum(&trial.torque_nm, setup.sample_hz, segment);
        if mean.is_empty() {
            mean = one;
        } else {
            mean.iter_mut().zip(&one).for_each(|(m, o)| m.1 += o.1);
        }
    }
    let count = trials.len() as f64;
    mean.iter_mut().for_each(|m| m.1 /= count);
    mean
}

fn low_pass(trial: &Trial, setup: &Setup, cutoff_hz: f64) -> Result<Vec<f64>, FrictionError> {
    filter::zero_phase_low_pass(&trial.torque_nm, setup.sample_hz, cutoff_hz).map_err(|e| trial.error(e.to_string()))
}

/// Mean torque of the sliding above rest (N·m), its ends left out.
fn sliding_torque(trial: &Trial, setup: &Setup, set: Set, cutoff_hz: f64) -> Result<f64, FrictionError> {
    let filtered = low_pass(trial, setup, cutoff_hz)?;
    let motion = windows::motion(&filtered).ok_or_else(|| trial.error("too short to find the motion in"))?;
    let step = (motion.level_nm - motion.rest_nm).abs();
    if set == Set::Motor && step < 4.0 * motion.scatter_nm {
        return Err(trial.error(format!(
            "no motion visible: the torque steps by {step:.2e} N m only, its scatter is {:.2e}; a record begins at rest",
            motion.scatter_nm
        )));
    }
    let expected = setup.duration_s(setup.coulomb_travel_mm, trial.speed_rpm);
    let seen = (motion.end - motion.start) as f64 / setup.sample_hz;
    let clear = set == Set::Motor && step > 4.0 * motion.scatter_nm;
    let doubt = "check coulomb_travel_mm, lead_mm and gear_reduction in friction.toml";
    if clear && motion.drops && !(0.8..1.25).contains(&(seen / expected)) {
        return Err(trial.error(format!(
            "the motion lasts {seen:.1} s, the geometry says {expected:.1} s at {} rpm: {doubt}",
            trial.speed_rpm
        )));
    }
    if clear && !motion.drops && seen < 0.8 * expected {
        return Err(trial.error(format!(
            "the record ends {seen:.1} s into a motion that the geometry says lasts {expected:.1} s: {doubt}, or record longer"
        )));
    }
    let length = (seen.min(expected) * setup.sample_hz) as usize;
    let (from, to) = (motion.start + length / 5, motion.start + length - length / 10);
    let window = filtered.get(from..to.min(filtered.len())).filter(|w| !w.is_empty());
    let window = window.ok_or_else(|| trial.error("the motion is too short to average over"))?;
    Ok(window.iter().sum::<f64>() / window.len() as f64 - rest(&filtered, &motion))
}

/// Torque at rest before a motion (N·m): what is left before the climb to it began.
fn rest(torque: &[f64], motion: &windows::Motion) -> f64 {
    let high = motion.rest_nm + 0.9 * (motion.level_nm - motion.rest_nm);
    let climbing = |v: f64| (v - high) * (motion.level_nm - motion.rest_nm) < 0.0;
    let end = (motion.start..motion.end).find(|&i| !climbing(torque[i])).unwrap_or(motion.end);
    windows::rest(torque, end).map_or(motion.rest_nm, |r| r.0)
}

/// Greatest torque above rest before the motor slips (N·m).
fn peak_torque(trial: &Trial, setup: &Setup, cutoff_hz: f64) -> Result<f64, FrictionError> {
    let filtered = low_pass(trial, setup, cutoff_hz)?;
    let motion = windows::motion(&filtered).ok_or_else(|| trial.error("too short to find the break-away in"))?;
    if (motion.level_nm - motion.rest_nm).abs() < 4.0 * motion.scatter_nm {
        return Err(trial.error(format!(
            "no break-away visible: the torque steps by {:.2e} N m only, its scatter is {:.2e}",
            (motion.level_nm - motion.rest_nm).abs(),
            motion.scatter_nm
        )));
    }
    let ramp = (setup.duration_s(setup.static_travel_mm, trial.speed_rpm) * setup.sample_hz) as usize;
    // The cut lies half-way up the ramp; the thesis's window reaches 2.5 ramps past its alignment.
    let end = (motion.start + ramp * 5 / 2).clamp(motion.start + 1, filtered.len());
    let zero = rest(&filtered, &motion);
    let sign = (motion.level_nm - motion.rest_nm).signum();
    let peak = (motion.start..end)
        .max_by(|a, b| (sign * filtered[*a]).total_cmp(&(sign * filtered[*b])))
        .ok_or_else(|| trial.error("no sample after the break-away"))?;
    if peak + 1 == filtered.len() {
        return Err(trial.error("the torque still rises when the record ends: record longer, or it never broke away"));
    }
    let reach = ramp / 4;
    windows::corner(&trial.torque_nm, peak.saturating_sub(reach), (peak + reach).min(trial.torque_nm.len()))
        .map(|corner| corner - zero)
        .ok_or_else(|| trial.error("too few samples about the break-away"))
}

/// Every trial of a set must have the sign of friction; `needed` also refuses a whole set that is negative.
fn signs(trials: &Trials, set: Set, torque: &[(u32, f64)], needed: bool) -> Result<(), FrictionError> {
    let list = &trials[&set];
    let mut sorted: Vec<f64> = torque.iter().map(|t| t.1).collect();
    sorted.sort_by(f64::total_cmp);
    let median = sorted[sorted.len() / 2];
    if needed && median < 0.0 {
        return Err(list[0].error(format!(
            "friction reads negative ({median:.4} N m is the median of its set): the sensor's sign is reversed; set \
             `torque_sign` in friction.toml to the other sign"
        )));
    }
    for (trial, (_, value)) in list.iter().zip(torque) {
        if value.signum() != median.signum() && value.abs() > 0.5 * median.abs() {
            return Err(trial.error(format!(
                "its torque ({value:.4} N m) has the other sign than its set's median ({median:.4} N m): was this trial run \
                 or recorded the other way round?"
            )));
        }
    }
    Ok(())
}

struct Group {
    mean: f64,
    variance_of_mean: f64,
    freedom: f64,
    count: usize,
}

fn group(values: impl Iterator<Item = f64> + Clone) -> Option<Group> {
    let count = values.clone().count();
    if count == 0 {
        return None;
    }
    let n = count as f64;
    let mean = values.clone().sum::<f64>() / n;
    let variance = if count > 1 { values.map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0) } else { f64::NAN };
    Some(Group { mean, variance_of_mean: variance / n, freedom: n - 1.0, count })
}

/// Coefficients by speed and over all, from torques with the motor less those without.
fn combine(setup: &Setup, with: &[(u32, f64)], without: Option<&[(u32, f64)]>) -> Overall {
    let factor = setup.coefficient_per_nm();
    let relative = setup.coefficient_relative();
    let mut speeds: Vec<u32> = with.iter().map(|t| t.0).collect();
    speeds.dedup();
    let at = |list: &[(u32, f64)], speed: u32| {
        group(list.iter().filter(|t| t.0 == speed).map(|t| t.1).collect::<Vec<_>>().into_iter())
    };
    let mut results = Vec::new();
    let mut variances = Vec::new();
    let mut freedoms = Vec::new();
    for speed in speeds {
        let Some(a) = at(with, speed) else { continue };
        let (torque, variance, freedom) = match without {
            None => (a.mean, a.variance_of_mean, a.freedom),
            Some(list) => {
                let Some(b) = at(list, speed) else { continue };
                // Welch and Satterthwaite: the two sets need not scatter alike.
                let sum = a.variance_of_mean + b.variance_of_mean;
                let freedom =
                    sum * sum / (a.variance_of_mean.powi(2) / a.freedom + b.variance_of_mean.powi(2) / b.freedom);
                (a.mean - b.mean, sum, freedom)
            }
        };
        let value = factor * torque;
        let se = factor * variance.sqrt();
        let reach = (student_95(freedom) * se).hypot(NORMAL_95 * relative * value);
        results.push(SpeedResult {
            speed_rpm: speed,
            sliding_m_s: setup.sliding_m_s(speed),
            coefficient: Coefficient { value, ci95: reach.is_finite().then_some([value - reach, value + reach]) },
            torque_nm: torque,
            trials: a.count,
        });
        variances.push(se * se);
        freedoms.push(freedom);
    }
    overall(results, &variances, &freedoms, relative)
}

fn overall(speeds: Vec<SpeedResult>, variances: &[f64], freedoms: &[f64], relative: f64) -> Overall {
    let k = speeds.len() as f64;
    let values: Vec<f64> = speeds.iter().map(|s| s.coefficient.value).collect();
    let value = values.iter().sum::<f64>() / k;
    let within = variances.iter().sum::<f64>() / (k * k);
    let within_freedom =
        variances.iter().sum::<f64>().powi(2) / variances.iter().zip(freedoms).map(|(v, f)| v * v / f).sum::<f64>();
    let between = if speeds.len() > 1 {
        values.iter().map(|v| (v - value).powi(2)).sum::<f64>() / (k - 1.0) / k
    } else {
        f64::NAN
    };
    // Analysis of variance, the scatter of trials pooled over speeds: five trials alone tell too little of theirs.
    let homogeneous_p = (speeds.len() > 1 && variances.iter().all(|v| *v > 0.0)).then(|| {
        let pooled = variances.iter().sum::<f64>() / k;
        FisherSnedecor::new(k - 1.0, freedoms.iter().sum()).map_or(f64::NAN, |d| 1.0 - d.cdf(between * k / pooled))
    });
    // Whichever is wider: scatter of trials, or of speeds.
    let reach_within = student_95(within_freedom) * within.sqrt();
    let reach_between = student_95(k - 1.0) * between.sqrt();
    let reach = if homogeneous_p.is_some_and(|p| p < 0.05) { reach_within.max(reach_between) } else { reach_within };
    let reach = reach.hypot(NORMAL_95 * relative * value);
    let (slope_s_m, slope_p) = slope(&speeds);
    Overall {
        value,
        ci95: reach.is_finite().then_some([value - reach, value + reach]),
        slope_s_m,
        slope_p,
        homogeneous_p,
        speeds,
    }
}

/// Straight line of the coefficient over sliding speed, by the speeds' means.
fn slope(speeds: &[SpeedResult]) -> (Option<Coefficient>, Option<f64>) {
    let n = speeds.len() as f64;
    if speeds.len() < 3 {
        return (None, None);
    }
    let (mx, my) = (
        speeds.iter().map(|s| s.sliding_m_s).sum::<f64>() / n,
        speeds.iter().map(|s| s.coefficient.value).sum::<f64>() / n,
    );
    let sxx: f64 = speeds.iter().map(|s| (s.sliding_m_s - mx).powi(2)).sum();
    let sxy: f64 = speeds.iter().map(|s| (s.sliding_m_s - mx) * (s.coefficient.value - my)).sum();
    let b = sxy / sxx;
    let rss: f64 = speeds.iter().map(|s| (s.coefficient.value - my - b * (s.sliding_m_s - mx)).powi(2)).sum();
    let se = (rss / (n - 2.0) / sxx).sqrt();
    let reach = student_95(n - 2.0) * se;
    let p = StudentsT::new(0.0, 1.0, n - 2.0).map_or(f64::NAN, |t| 2.0 * (1.0 - t.cdf((b / se).abs())));
    (Some(Coefficient { value: b, ci95: Some([b - reach, b + reach]) }), Some(p))
}
