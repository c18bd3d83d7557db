//! The picture of a speed: against time, against angle, and what repeats each turn.

use super::figure::{Figure, Panel};
use crate::record::measurement::Run;
use crate::signal::SignalError;
use crate::signal::course::{Course, Drive, START_S};
use crate::signal::run::Motion;
use crate::signal::spectrum::against_angle;
use crate::signal::turn::TurnFit;
use std::f64::consts::TAU;
use twum_fit::quantile::NORMAL_95;

/// Highest order shown.
const ORDERS_SHOWN: f64 = 10.0;
/// Turns drawn with a line of their own; later ones share one.
const TURNS_NAMED: usize = 4;

/// What a simulation says about the same run.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulated {
    /// Time in s and speed in rpm.
    pub speed: Vec<(f64, f64)>,
}

impl Simulated {
    /// One speed from `from_s` to `to_s`.
    pub fn constant(rpm: f64, from_s: f64, to_s: f64) -> Self {
        const POINTS: u32 = 1000;
        let at = |i: u32| from_s + (to_s - from_s) * f64::from(i) / f64::from(POINTS);
        Self { speed: (0..=POINTS).map(|i| (at(i), rpm)).collect() }
    }

    fn motion(&self) -> Motion {
        let (time_us, rpm): (Vec<f64>, Vec<f64>) = self.speed.iter().map(|(s, rpm)| (s * 1e6, *rpm)).unzip();
        Motion::of_speeds(&time_us, &rpm)
    }
}

/// What a measured speed has and a simulated one lacks, in words; empty when there is nothing of note (3 % of the mean
/// speed).
pub fn lacking(measured: &Course, simulated: &Course) -> Vec<String> {
    const OF_NOTE: f64 = 0.03;
    let Some(fit) = &measured.fit else { return Vec::new() };
    let mean = measured.mean_rpm.unwrap_or(0.0).abs();
    let mut lacks = Vec::new();
    let over = measured.overshoot.unwrap_or(0.0);
    if over - simulated.overshoot.unwrap_or(0.0) > 2.0 * OF_NOTE {
        lacks.push(format!("a start that overshoots by {:.0} %", 100.0 * over));
    }
    let (how_often, ripple) = strongest_order(fit);
    let in_simulation = simulated.fit.as_ref().map_or(0.0, |fit| fit.amplitude_rpm.iter().copied().fold(0.0, f64::max));
    if ripple - in_simulation > OF_NOTE * mean {
        let share = 100.0 * ripple / mean;
        lacks.push(format!("\u{b1}{} rpm ({share:.0} %) {how_often} a turn", number(ripple, 1)));
    }
    let drift = fit.drift_rpm_per_s;
    let simulated_drift = simulated.fit.as_ref().map_or(0.0, |fit| fit.drift_rpm_per_s);
    if (drift - simulated_drift).abs() * fit.turns / mean * 60.0 > OF_NOTE * mean {
        lacks.push(format!("a drift of {} rpm/s", number(drift, 2)));
    }
    lacks
}

fn strongest_order(fit: &TurnFit) -> (&'static str, f64) {
    let strongest =
        (0..fit.amplitude_rpm.len()).fold(0, |a, b| if fit.amplitude_rpm[b] > fit.amplitude_rpm[a] { b } else { a });
    (["once", "twice", "three times", "four times"][strongest], fit.amplitude_rpm[strongest])
}

/// Draws speed against time, against the angle in the turn, and its orders, with a simulation beside it if there is
/// one. The headings say in numbers what the panels show, the title what the simulation lacks.
///
/// # Errors
/// Only of the spectrum when the motion holds more than a turn and still cannot be transformed.
pub fn figure(
    title: &str,
    motion: &Motion,
    drive: Drive,
    simulated: Option<&Simulated>,
) -> Result<Figure, SignalError> {
    let found = Course::of(motion, drive);
    let seconds: Vec<f64> = motion.time_us.iter().map(|t| t * 1e-6).collect();
    let measured: Vec<(f64, f64)> = seconds.iter().copied().zip(motion.speed_rpm.iter().copied()).collect();
    let mut over_time = Panel::new("time (s)", "speed (rpm)").title(time_heading(&found)).line("measured", &measured);
    if let Some(sd) = &motion.speed_sd_rpm {
        let band: Vec<(f64, f64, f64)> =
            measured.iter().zip(sd).map(|((t, v), sd)| (*t, v - NORMAL_95 * sd, v + NORMAL_95 * sd)).collect();
        over_time = over_time.band("95 %", &band);
        over_time = within(over_time, &motion.speed_rpm, simulated);
    }
    if let Some(simulated) = simulated {
        over_time = over_time.dashed("simulated", &simulated.speed);
    }
    let Some(fit) = &found.fit else { return Ok(Figure::new(title).panel(over_time)) };
    let lacks = simulated.map_or(Vec::new(), |simulated| lacking(&found, &Course::of(&simulated.motion(), drive)));
    let title = match lacks.as_slice() {
        [] => title.to_owned(),
        lacks => format!("{title}. The simulation lacks: {}", lacks.join("; ")),
    };
    let trend: Vec<(f64, f64)> =
        found.settled_s.map(|t| (t, fit.mean_rpm + fit.drift_rpm_per_s * (t - fit.middle_s))).to_vec();
    over_time = over_time.line("trend", &trend);
    let spectrum =
        against_angle(&motion.position_rad[found.settled.clone()], &motion.speed_rpm[found.settled.clone()])?;
    let shown: Vec<(f64, f64)> = spectrum
        .at
        .iter()
        .copied()
        .zip(spectrum.amplitude.iter().copied())
        .take_while(|(order, _)| *order <= ORDERS_SHOWN)
        .collect();
    let orders = Panel::new("order (periods a turn)", "amplitude (rpm)")
        .title(format!("Orders of a turn; {:.1} turns tell {:.1} orders apart", fit.turns, spectrum.resolution))
        .x_range(0.0, ORDERS_SHOWN)
        .line("measured", &shown);
    let begins = seconds[0];
    let mut start = Panel::new("time (s)", "speed (rpm)")
        .title(start_heading(&found))
        .x_range(begins, begins + 1.5 * START_S)
        .line("measured", &measured);
    if let Some(simulated) = simulated {
        start = start.dashed("simulated", &simulated.speed);
    }
    Ok(Figure::new(title)
        .size(1280, 800)
        .columns(2)
        .panel(over_time)
        .panel(start)
        .panel(angle_panel(motion, &found, fit, simulated))
        .panel(orders))
}

/// The band of a start from an unknown state would set the scale; the speeds do.
fn within(panel: Panel, speed_rpm: &[f64], simulated: Option<&Simulated>) -> Panel {
    let others = simulated.into_iter().flat_map(|s| s.speed.iter().map(|p| p.1));
    let all = speed_rpm.iter().copied().chain(others).filter(|v| v.is_finite());
    let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    if low > high {
        return panel;
    }
    let margin = (0.15 * (high - low)).max(0.05 * high.abs().max(low.abs())).max(0.1);
    panel.y_range(low - margin, high + margin)
}

fn time_heading(found: &Course) -> String {
    let Some(mean) = found.mean_rpm else { return "Speed against time".to_owned() };
    let trend = found.fit.as_ref().map_or(String::new(), |f| format!(", trend {} rpm/s", number(f.drift_rpm_per_s, 2)));
    format!("Against time: mean {} rpm settled{trend}", number(mean, 2))
}

fn start_heading(found: &Course) -> String {
    /// A start is said to overshoot from here on: the PWM's own ripple is less at high duty.
    const OF_NOTE: f64 = 0.1;
    match (found.overshoot, found.start_peak_rpm, found.start_peak_s) {
        (Some(over), Some(peak), Some(at)) if over > OF_NOTE => {
            format!("Start: overshoots to {} rpm at {:.0} ms", number(peak, 1), at * 1e3)
        }
        _ => "Start".to_owned(),
    }
}

/// Draws several runs: all speeds against time, and each run's mean speed against its duty. `simulated_rpm` is a constant
/// speed to draw beside them.
pub fn overview(title: &str, runs: &[(&Run, &Motion)], simulated_rpm: Option<f64>) -> Figure {
    /// More names than this make a legend nobody reads.
    const MOST_NAMED: usize = 12;
    let mut over_time = Panel::new("time (s)", "speed (rpm)").title("Against time");
    let mut means = Vec::new();
    for (run, motion) in runs {
        let label = if runs.len() <= MOST_NAMED { run.id.clone() } else { String::new() };
        let line: Vec<(f64, f64)> =
            motion.time_us.iter().map(|t| t * 1e-6).zip(motion.speed_rpm.iter().copied()).collect();
        if let Some((duty, mean)) = run.duty.zip(Course::of(motion, Drive::of(run)).mean_rpm) {
            means.push((100.0 * duty, mean));
        }
        over_time = over_time.line(label, &line);
    }
    let mut over_duty = Panel::new("duty (%)", "mean speed (rpm)")
        .title("Against duty")
        .x_range(0.0, 100.0)
        .points("mean of a run", &means);
    if let Some(rpm) = simulated_rpm {
        let ends = |values: &mut dyn Iterator<Item = f64>| {
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
        };
        let time = ends(&mut runs.iter().flat_map(|(_, m)| m.time_us.iter().map(|t| t * 1e-6)));
        over_time = over_time.dashed("simulated", &[(time.0, rpm), (time.1, rpm)]);
        over_duty = over_duty.dashed("simulated", &[(0.0, rpm), (100.0, rpm)]);
    }
    let figure = Figure::new(title).size(1000, 420).panel(over_time);
    if means.is_empty() { figure } else { figure.size(1000, 760).panel(over_duty) }
}

/// Speed less its trend against the angle in the turn, one line a turn.
fn angle_panel(motion: &Motion, found: &Course, fit: &TurnFit, simulated: Option<&Simulated>) -> Panel {
    let start = motion.position_rad[found.settled.start];
    let mut turns: Vec<Vec<(f64, f64)>> = Vec::new();
    for i in found.settled.clone() {
        let angle = motion.position_rad[i];
        let turn = ((angle - start) / TAU).abs().floor() as usize;
        let drift = fit.drift_rpm_per_s * (motion.time_us[i] * 1e-6 - fit.middle_s);
        let point = (angle.rem_euclid(TAU).to_degrees(), motion.speed_rpm[i] - drift);
        if turns.len() <= turn {
            turns.resize(turn + 1, Vec::new());
        }
        let line = &mut turns[turn];
        push_around(line, point);
    }
    let (how_often, ripple) = strongest_order(fit);
    let share = 100.0 * ripple / fit.mean_rpm.abs();
    let heading = format!(
        "Against angle, trend taken off: varies most {how_often} a turn, by \u{b1}{} rpm ({share:.0} %)",
        number(ripple, 1)
    );
    let mut panel = Panel::new("angle in the turn (\u{b0})", "speed (rpm)").title(heading).x_range(0.0, 360.0);
    for (i, turn) in turns.iter().enumerate() {
        let label = match i {
            _ if i < TURNS_NAMED => format!("turn {}", i + 1),
            _ => "later turns".to_owned(),
        };
        panel = panel.line(label, turn);
    }
    let curve: Vec<(f64, f64)> =
        (0..=360).map(|d| (f64::from(d), fit.at(fit.middle_s, f64::from(d).to_radians()))).collect();
    panel = panel.dashed(format!("fit of orders 1 to 4 (R\u{b2} {:.2})", fit.r2), &curve);
    if let Some(simulated) = simulated {
        panel = panel.dashed("simulated", &against_own_angle(simulated));
    }
    panel
}

/// Adds a point of an angle in degrees; passing 360° is no line across the panel.
fn push_around(line: &mut Vec<(f64, f64)>, point: (f64, f64)) {
    if line.last().is_some_and(|before| (before.0 - point.0).abs() > 180.0) {
        line.push((f64::NAN, f64::NAN));
    }
    line.push(point);
}

/// A simulated speed against the angle it has turned itself, over its last turn after the start.
fn against_own_angle(simulated: &Simulated) -> Vec<(f64, f64)> {
    let begins = simulated.speed.first().map_or(0.0, |p| p.0);
    let mut turns = 0.0;
    let mut after_start = Vec::new();
    for pair in simulated.speed.windows(2) {
        let [(t0, v0), (t1, v1)] = [pair[0], pair[1]];
        turns += 0.5 * (v0 + v1) / 60.0 * (t1 - t0);
        if t1 - begins >= START_S {
            after_start.push((turns, v1));
        }
    }
    let mut line = Vec::new();
    for (at, rpm) in after_start.into_iter().filter(|(at, _)| (at - turns).abs() <= 1.0) {
        push_around(&mut line, (at.rem_euclid(1.0) * 360.0, rpm));
    }
    line
}

/// A number with a true minus sign.
fn number(value: f64, decimals: usize) -> String {
    format!("{value:.decimals$}").replace('-', "\u{2212}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Overshoots to 50 rpm, then 35 rpm falling by 1 rpm/s, ±5 rpm twice a turn.
    fn example() -> Motion {
        let mut motion = Motion {
            time_us: Vec::new(),
            position_rad: Vec::new(),
            speed_rpm: Vec::new(),
            speed_sd_rpm: None,
            edges: 0,
            encoder: None,
        };
        let mut angle = 0.0_f64;
        for i in 0..4000 {
            let t = f64::from(i) * 1e-3;
            let start = 20.0 * (-t / 0.02).exp() * (1.0 - (-t / 0.002).exp());
            let rpm = 35.0 - t + 5.0 * (2.0 * angle).cos() + start;
            motion.time_us.push(t * 1e6);
            motion.position_rad.push(angle);
            motion.speed_rpm.push(rpm);
            angle += rpm / 60.0 * TAU * 1e-3;
        }
        motion
    }

    #[test]
    fn the_headings_say_what_was_put_in() {
        let motion = example();
        let found = Course::of(&motion, Drive::default());
        let fit = found.fit.unwrap();
        assert!((fit.drift_rpm_per_s + 1.0).abs() < 0.02 && (fit.amplitude_rpm[1] - 5.0).abs() < 0.05);
        let simulated = Simulated::constant(34.8, 0.0, 4.0);
        let svg = figure("Speed", &motion, Drive::default(), Some(&simulated)).unwrap().svg().unwrap();
        assert!(svg.contains("overshoots to 5"), "{svg}");
        assert!(svg.contains("trend \u{2212}1.00 rpm/s"));
        assert!(svg.contains("varies most twice a turn, by \u{b1}5.0 rpm (15 %)"));
        let course = |motion: &Motion| Course::of(motion, Drive::default());
        let lacks = lacking(&course(&motion), &course(&simulated.motion()));
        assert!(lacks[0].starts_with("a start that overshoots by 6") && lacks.len() == 3, "{lacks:?}");
        assert_eq!(lacks[1..], ["\u{b1}5.0 rpm (15 %) twice a turn", "a drift of \u{2212}1.00 rpm/s"]);
        assert!(svg.contains(&format!("The simulation lacks: {}", lacks.join("; "))), "{svg}");
        assert_eq!(lacking(&course(&motion), &course(&motion)), Vec::<String>::new());
    }

    #[test]
    fn a_short_or_empty_motion_is_drawn_against_time() {
        let mut motion = example();
        for keep in [100, 1, 0] {
            motion.time_us.truncate(keep);
            motion.position_rad.truncate(keep);
            motion.speed_rpm.truncate(keep);
            figure("Speed", &motion, Drive::default(), None).unwrap().svg().unwrap();
        }
    }
}
