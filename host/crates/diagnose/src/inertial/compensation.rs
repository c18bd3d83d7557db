//! The feed-forward that cancels what was found: the input that a wanted motion takes.

use super::angle::{Course, Ripple};
use super::aside::Aside;
use super::data::DriveRun;
use super::effects::{over_angle, reported};
use super::plant::simulate;
use super::values::{P, Values};
use std::f64::consts::TAU;

/// Speeds of the table to either side.
const STEPS: usize = 20;
/// Rows of the table over the angle to a period of the highest order.
const STEPS_A_PERIOD: usize = 24;
/// Share of the reach at which a threshold is seen from above.
const JUST_MOVING: f64 = 1e-3;
/// The motion by which it is tried: a sine of half the reach, in lags a period, in samples a lag, for so many periods.
const TRIED: (f64, f64, usize) = (20.0, 50.0, 3);

/// A plant with the line that anyone would take for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fitted {
    /// Gain and lag alone.
    pub line: Values,
    /// The same with all that was found.
    pub plant: Values,
}

/// The inverse of a plant.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Compensation {
    /// Steady speeds in rpm with the inputs that hold them, in the record's unit.
    pub table: Vec<[f64; 2]>,
    /// Angles in degrees over a turn with the input that holds the rotor there against cogging, in the record's unit; empty without.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub cogging: Vec<[f64; 2]>,
    /// The input of any motion ω(t) in rpm.
    pub formula: String,
    /// Error in rpm (root mean square) of a sine of half the reach, by simulation of the plant: with the line's feed-forward.
    pub line_rms_rpm: f64,
    /// The same with this one.
    pub rms_rpm: f64,
}

impl Compensation {
    /// Of a plant whose largest input is `largest` in the record's unit; none of a motor that reaches one direction only.
    pub fn of(fitted: &Fitted, ripples: &[Ripple], largest: f64) -> Option<Self> {
        let plant = &fitted.plant;
        let reach = reach(plant);
        let mut shares: Vec<f64> = (1..=STEPS).map(|k| k as f64 / STEPS as f64).collect();
        shares.insert(0, JUST_MOVING);
        let row = |speed: f64| steady(plant, speed).map(|u| [speed, largest * u]);
        let down = shares.iter().rev().map(|s| -s * reach);
        let speeds = down.chain([0.0]).chain(shares.iter().map(|s| s * reach));
        let table: Vec<[f64; 2]> = speeds.filter_map(row).collect();
        let [line_rms_rpm, rms_rpm] = [&fitted.line, plant].map(|by| error(plant, by, ripples, 0.5 * reach));
        let cogging = cogging(plant, ripples, largest);
        (reach > 0.0).then(|| Self { table, cogging, formula: formula(plant, ripples, largest), line_rms_rpm, rms_rpm })
    }

    /// The table over the angle as CSV; none of a motor without cogging.
    pub fn cogging_csv(&self) -> Option<String> {
        let rows: String = self.cogging.iter().map(|[angle, input]| format!("{angle:.4},{input:.6}\n")).collect();
        (!self.cogging.is_empty())
            .then(|| format!("# added to the input at this angle; the angle is that of the first run's record\nangle_deg,input\n{rows}"))
    }

    /// The table as CSV.
    pub fn csv(&self) -> String {
        let rows: String = self.table.iter().map(|[speed, input]| format!("{speed:.6},{input:.6}\n")).collect();
        format!("# {}\nspeed_rpm,input\n{rows}", self.formula)
    }
}

/// The largest speed that is reached both ways.
fn reach(plant: &Values) -> f64 {
    let gain = plant.get(P::Gain).abs();
    let side = |s: f64| gain * (s * plant.actuated(s) - s * plant.get(P::Bias) - plant.friction(s));
    // A hair less, so that rounding does not put the last row beyond the largest input.
    0.999_999 * side(1.0).min(side(-1.0)).max(0.0)
}

/// The input that a speed and its change (rpm/s) take beside what else acts.
fn input(plant: &Values, speed: f64, change: f64, aside: Aside) -> Option<f64> {
    let gain = plant.get(P::Gain);
    let side = if speed == 0.0 { 0.0 } else { speed.signum() * gain.signum() };
    let held = plant.get(P::Bias) + side * plant.friction(side) - aside.torque;
    plant.input_for(((speed + plant.lag_s() * change) / gain + held) / (1.0 + aside.share))
}

/// What cogging takes of the input over a turn.
fn cogging(plant: &Values, ripples: &[Ripple], largest: f64) -> Vec<[f64; 2]> {
    let steady = plant.with(P::RippleCos, 0.0).with(P::RippleSin, 0.0);
    if ripples.is_empty() || [P::CoggingCos, P::CoggingSin].iter().all(|p| steady.get(*p) == 0.0) {
        return Vec::new();
    }
    let rows = STEPS_A_PERIOD * ripples.iter().map(|r| r.order).max().unwrap_or(1);
    let turns: Vec<f64> = (0..=rows).map(|k| k as f64 / rows as f64).collect();
    // Of places, not of the ways between them.
    let place = |t: f64| Course { time_s: &[0.0, 1.0], turns: &[t, t], rpm: None, lag_s: 1.0 }.ripple(0, ripples)[0];
    let torque = |t: f64| Aside::of_angle(&steady, &place(t)).torque;
    turns.into_iter().map(|t| [360.0 * t, -largest * torque(t)]).collect()
}

fn steady(plant: &Values, speed: f64) -> Option<f64> {
    if speed == 0.0 { Some(0.0) } else { input(plant, speed, 0.0, Aside::default()) }
}

/// Error in rpm of a sine of this height where the plant is driven by the feed-forward of another.
fn error(plant: &Values, by: &Values, ripples: &[Ripple], height: f64) -> f64 {
    let (period, samples, periods) = TRIED;
    let (step, pulsation) = (plant.lag_s() / samples, TAU / (period * plant.lag_s()));
    let time: Vec<f64> = (0..periods * (period * samples) as usize).map(|k| k as f64 * step).collect();
    let wanted = |t: f64| (height * (pulsation * t).sin(), height * pulsation * (pulsation * t).cos());
    // The angle that is wanted is nearly that which is reached.
    let turns: Vec<f64> = time.iter().map(|t| height * (1.0 - (pulsation * t).cos()) / pulsation / 60.0).collect();
    let ripple = Course { time_s: &time, turns: &turns, rpm: None, lag_s: plant.lag_s() }.ripple(0, ripples);
    let input: Vec<f64> = time
        .iter()
        .zip(&ripple)
        .map(|(t, wave)| {
            let (speed, change) = wanted(t + 0.5 * step);
            // What is out of reach is driven with all there is.
            input(by, speed, change, Aside::of_angle(by, wave))
                .unwrap_or(speed.signum() * by.get(P::Gain).signum())
                .clamp(-1.0, 1.0)
        })
        .collect();
    let n = time.len();
    let run = DriveRun {
        id: String::new(),
        period_s: step,
        rpm: vec![0.0; n],
        windows: None,
        turns,
        time,
        input,
        ripple,
        beside: Vec::new(),
    };
    // Delays of the record are the logger's, or cannot be cancelled but by asking earlier.
    let tried = plant.with(P::Skew, 0.0).with(P::DeadTime, 0.0).with(P::SecondLag, 0.0);
    let motion = simulate(&run, &tried, 0.0, false);
    let squares = motion.rpm.iter().zip(&run.time).map(|(v, t)| (v - wanted(*t).0).powi(2));
    (squares.sum::<f64>() / n as f64).sqrt()
}

fn formula(plant: &Values, ripples: &[Ripple], largest: f64) -> String {
    let has = |p: P| plant.get(p) != 0.0;
    let either = |value: f64, split: f64, of: &str| {
        if split == 0.0 { format!("{value:.5}") } else { format!("({value:.5} + {:.5}·{of})", value * split) }
    };
    // What speeds counted against the input are to the equations: friction acts with the sense of the drive.
    let sense = if plant.get(P::Gain) < 0.0 { "sign(−ω)" } else { "sign(ω)" };
    let mut x = format!("(ω + {:.5}·ω')/{:.3}", plant.lag_s(), plant.get(P::Gain));
    if has(P::Coulomb) {
        x += &format!(" + {}·{sense}", either(plant.get(P::Coulomb), plant.get(P::FrictionSplit), sense));
    }
    if has(P::Bias) {
        x += &format!(" + {:.5}", plant.get(P::Bias));
    }
    for cos in [P::CoggingCos, P::Cogging2Cos, P::RippleCos] {
        let Some((wave, height)) = wave(plant, ripples, cos) else { continue };
        x = if cos == P::RippleCos {
            format!("({x})/(1 + {height:.5}·{wave})")
        } else {
            format!("{x} − {height:.5}·{wave}")
        };
    }
    let mut u = "|x|".to_owned();
    if has(P::GainSplit) {
        u = format!("{u}/(1 + {:.5}·sign(x))", plant.get(P::GainSplit));
    }
    if has(P::Bend) {
        let (bend, power) = (plant.get(P::Bend), 1.0 + plant.get(P::BendPower));
        u = if power == 1.0 {
            format!("q/(1 − {bend:.4}·q), q = {u}")
        } else {
            format!("q/(1 − ({bend:.4}·q)^{power:.3})^(1/{power:.3}), q = {u}")
        };
    }
    if has(P::DeadZone) {
        let zone = either(plant.get(P::DeadZone), plant.get(P::DeadSplit), "sign(x)");
        u = match u.split_once(", q = ") {
            Some((bent, q)) => format!("{zone} + {bent}, q = {q}"),
            None => format!("{zone} + {u}"),
        };
    }
    let corner = match has(P::Corner) {
        true => format!(
            "; the threshold's corner, rounded over {:.5} to either side, is in the table only",
            plant.get(P::Corner)
        ),
        false => String::new(),
    };
    let open: Vec<String> = [P::DeadTime, P::SecondLag, P::Swing, P::Load, P::Heating]
        .into_iter()
        .filter(|p| has(*p))
        .map(|p| match reported(p) {
            (name, "s") => format!("; {} of {:.5} s is not cancelled", name.trim_end_matches("_s"), plant.get(p)),
            (name, _) => format!("; {name} of {:.5} is not cancelled", plant.get(p)),
        })
        .collect();
    format!(
        "input = {largest}·sign(x)·u; u = {u}; x = {x}; ω in rpm, ω' in rpm/s; at most {:.3} of the largest input; 0 at rest{corner}{}",
        1.0 - plant.get(P::FlatTop),
        open.concat()
    )
}

/// A torque over the angle θ in words, with its height; none where there is none.
fn wave(plant: &Values, ripples: &[Ripple], cos: P) -> Option<(String, f64)> {
    let (sin, at) = over_angle(cos)?;
    let (c, s) = (plant.get(cos), plant.get(sin));
    let ripple = ripples.get(at).filter(|_| c != 0.0 || s != 0.0)?;
    let phase = (s.atan2(c) + ripple.phases[0]).rem_euclid(TAU);
    Some((format!("cos({}·θ − {phase:.4})", ripple.order), c.hypot(s)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if what is cancelled is not what acts, or the table is not the formula's.
    #[test]
    fn a_motor_follows_the_inverse_of_itself() {
        let line = |plant: &Values| Values::line(0.85 * plant.get(P::Gain), 0.05);
        let friction = Values::line(1000.0, 0.04).with(P::Coulomb, 0.15);
        let turned = friction.with(P::Gain, -1000.0).with(P::FrictionSplit, 0.1);
        let zone = Values::line(1400.0, 0.04).with(P::DeadZone, 0.15).with(P::Bend, 0.8).with(P::Bias, 0.05);
        for plant in [
            friction,
            turned,
            zone.with(P::GainSplit, 0.04),
            zone.with(P::DeadSplit, 0.2),
            zone.with(P::BendPower, 1.0),
        ] {
            let c = Compensation::of(&Fitted { line: line(&plant), plant }, &[], 12.0).expect("it reaches both ways");
            assert!(c.rms_rpm < 0.1 * c.line_rms_rpm, "{} and {} rpm", c.rms_rpm, c.line_rms_rpm);
            for [speed, input] in &c.table {
                let u = input / 12.0;
                let side = if *speed == 0.0 { 0.0 } else { speed.signum() * plant.get(P::Gain).signum() };
                let held = plant.actuated(u) - plant.get(P::Bias) - side * plant.friction(side);
                assert!(side == 0.0 || (plant.get(P::Gain) * held - speed).abs() < 1e-6, "{speed}");
            }
            assert!(c.csv().lines().count() == c.table.len() + 2 && c.table.len() > STEPS);
        }
    }
    /// Fails if the table over the angle has another sign, order or phase than what acts.
    #[test]
    fn cogging_is_cancelled_over_the_angle() {
        let ripples = [Ripple { order: 7, phases: vec![0.4] }, Ripple { order: 14, phases: vec![1.1] }];
        let plant =
            Values::line(20.0, 0.04).with(P::CoggingCos, 0.1).with(P::CoggingSin, -0.02).with(P::Cogging2Cos, 0.03);
        let c = Compensation::of(&Fitted { line: Values::line(20.0, 0.04), plant }, &ripples, 12.0)
            .expect("it reaches both ways");
        assert!(c.rms_rpm < 0.1 * c.line_rms_rpm, "{} and {} rpm", c.rms_rpm, c.line_rms_rpm);
        for [angle, input] in &c.cogging {
            let place = angle.to_radians();
            let torque =
                0.1 * (7.0 * place - 0.4).cos() - 0.02 * (7.0 * place - 0.4).sin() + 0.03 * (14.0 * place - 1.1).cos();
            assert!((input + 12.0 * torque).abs() < 1e-9, "{angle}: {input}");
        }
        assert!(c.cogging.len() > 300 && c.cogging_csv().is_some_and(|csv| csv.lines().count() == c.cogging.len() + 2));
        assert!(c.formula.contains("cos(7·θ") && c.formula.contains("cos(14·θ"), "{}", c.formula);
    }
}
