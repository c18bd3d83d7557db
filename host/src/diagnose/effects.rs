//! The library of effects: what each one changes in the rotor equation, how it is looked for, what it is mistaken for.

use super::problem::{Column, Problem};
use super::rotor::{P, Parameters};
use crate::record::measurement::RunKind;

/// One way in which an effect may act: columns of the linear search.
#[derive(Debug, Clone)]
pub struct Shape {
    /// Columns and, for phased ones, which pairs belong together.
    pub columns: Vec<Column>,
    /// Shape parameters pinned for the linear search.
    pub pinned: Vec<(P, f64)>,
    /// Cosine/sine pairs with a phase of their own in every run.
    pub phased: bool,
}

/// A parameter of an effect as it is reported.
#[derive(Debug, Clone, Copy)]
pub struct Reported {
    /// Name in the JSON.
    pub name: &'static str,
    /// Unit in the JSON.
    pub unit: &'static str,
    /// Where it lives.
    pub parameter: P,
    /// Physically admissible range.
    pub bounds: (f64, f64),
    /// Factor from the parameter to the reported number.
    pub factor: f64,
    /// Whether it is the size of the effect (must differ from 0) or its shape.
    pub size: bool,
}

/// An effect of the library.
#[derive(Debug, Clone)]
pub struct Effect {
    /// Name, as in the list of effects.
    pub name: &'static str,
    /// One sentence for the text answer.
    pub says: &'static str,
    /// What the model gains.
    pub equation: &'static str,
    /// Ways to act.
    pub shapes: Vec<Shape>,
    /// Parameters, size first.
    pub reported: Vec<Reported>,
    /// Effects that look alike.
    pub conflicts: &'static [&'static str],
    /// The cheapest experiment that separates it from them.
    pub next_experiment: &'static str,
}

/// What is found before the plant is fitted, in the record and in the controller, with the sentence and the equation of each.
const BEFORE_THE_PLANT: [(&str, &str, &str); 3] = [
    (
        "dropped-samples",
        "whole words of samples are missing, and what follows has moved up",
        "32 samples put back at each gap",
    ),
    (
        "loop-delay",
        "the control signal belongs to older samples than it was logged with",
        "u(k) computed from target and position of tick k − n",
    ),
    (
        "controller-mismatch",
        "the controller that ran is not the one stated: its gains differ",
        "u = (1 + p)·kp·e + (1 + i)·ki·Σe + (1 + d)·kd·Δe",
    ),
];

/// The sentence and the equation of an effect.
pub fn says(name: &str) -> Option<(&'static str, &'static str)> {
    let early = BEFORE_THE_PLANT.iter().find(|e| e.0 == name).map(|e| (e.1, e.2));
    early.or_else(|| library(1.0).iter().find(|e| e.name == name).map(|e| (e.says, e.equation)))
}

fn scalar(parameter: P, scale: f64, step: f64, shape: &[(P, f64)]) -> Column {
    Column::Scalar { parameter, scale, step, shape: shape.to_vec() }
}

fn one(parameter: P, scale: f64, step: f64) -> Shape {
    Shape { columns: vec![scalar(parameter, scale, step, &[])], pinned: Vec::new(), phased: false }
}

fn shaped(parameter: P, scale: f64, step: f64, pinned: Vec<(P, f64)>) -> Shape {
    Shape { columns: vec![scalar(parameter, scale, step, &pinned)], pinned, phased: false }
}

fn size(name: &'static str, unit: &'static str, parameter: P, low: f64, high: f64) -> Reported {
    Reported { name, unit, parameter, bounds: (low, high), factor: 1.0, size: true }
}

fn form(name: &'static str, unit: &'static str, parameter: P, low: f64, high: f64) -> Reported {
    Reported { name, unit, parameter, bounds: (low, high), factor: 1.0, size: false }
}

/// The whole library. The rotor's acceleration under drive in rad/s² sets the scale of the searches over friction.
pub fn library(on_acceleration: f64) -> Vec<Effect> {
    vec![
        Effect {
            name: "resonance-heating",
            says: "the motor slows as it warms up: its resonance drifts away from the drive frequency",
            equation: "dT/dt = (u − T)/τ, speed·(1 − h·T)",
            shapes: [0.5, 1.0, 2.0, 5.0, 15.0]
                .iter()
                .flat_map(|tau| {
                    [0.0, 0.5, 0.9]
                        .map(|carry| shaped(P::HeatLoss, 0.2, 0.02, vec![(P::HeatTau, *tau), (P::HeatCarry, carry)]))
                })
                .collect(),
            reported: vec![
                size("speed_loss_warm", "1", P::HeatLoss, 0.0, 0.9),
                form("thermal_time_s", "s", P::HeatTau, 0.3, 60.0),
                form("warmth_kept_between_runs", "1", P::HeatCarry, 0.0, 1.0),
            ],
            conflicts: &["run-in-wear", "supply-sag"],
            next_experiment: "repeat the first run after a pause of ten thermal time constants: warmth recovers, wear does not",
        },
        Effect {
            name: "frequency-settling",
            says: "the drive frequency needs time to find the resonance at each start, so the speed over- or undershoots",
            equation: "speed·(1 + δ·exp(−t/τ)), t from the start of the drive",
            shapes: [0.006, 0.012, 0.025, 0.05, 0.1, 0.2]
                .iter()
                .map(|tau| shaped(P::SettleExcess, 0.3, 0.02, vec![(P::SettleTau, *tau)]))
                .collect(),
            reported: vec![
                size("relative_excess_at_start", "1", P::SettleExcess, -1.5, 3.0),
                form("settling_time_s", "s", P::SettleTau, 0.002, 0.4),
            ],
            conflicts: &["resonance-heating", "start-delay"],
            next_experiment: "runs of 0.2 s at full duty, repeated after pauses of 1 s and 30 s: settling repeats at each start, heating depends on the pause",
        },
        Effect {
            name: "dead-zone",
            says: "part of every commanded duty is lost: below a threshold nothing moves",
            equation: "u → max(u − u₀, 0)",
            shapes: vec![one(P::DeadDuty, 0.1, 0.005)],
            reported: vec![size("threshold_duty", "1", P::DeadDuty, 0.0, 0.6)],
            conflicts: &["start-delay", "stribeck-friction"],
            next_experiment: "repeat two duties at another pwm_hz (e.g. 100 Hz): a delay loses pwm_hz·t_d of duty, a dead zone the same duty",
        },
        Effect {
            name: "start-delay",
            says: "the wave builds up late after each rise of the PWM",
            equation: "drive starts t_d after each PWM rise",
            shapes: vec![one(P::StartDelay, 2e-3, 1e-4)],
            reported: vec![size("delay_s", "s", P::StartDelay, 0.0, 0.015)],
            conflicts: &["dead-zone", "frequency-settling"],
            next_experiment: "repeat two duties at another pwm_hz (e.g. 100 Hz), and one run at duty 1: a delay loses nothing there",
        },
        Effect {
            name: "off-phase-braking",
            says: "friction clamps the rotor whenever the wave is gone; the model lets it coast",
            equation: "Coulomb torque −Fc_off·sign(ω) while the drive is off",
            shapes: vec![one(P::OffDeceleration, on_acceleration, on_acceleration * 0.05)],
            reported: vec![size("off_deceleration", "rad/s^2", P::OffDeceleration, 0.0, 1e5)],
            conflicts: &["contact-stiffening"],
            next_experiment: "record the final stop with edge timestamps (format edges)",
        },
        Effect {
            name: "duty-quantisation",
            says: "the duty is rounded to a coarse grid",
            equation: "u → round(N·u)/N",
            shapes: (3..=26)
                .chain([31, 32, 40, 50, 64])
                .map(f64::from)
                .collect::<Vec<f64>>()
                .iter()
                .map(|n| shaped(P::QuantShare, 1.0, 0.5, vec![(P::QuantSteps, *n)]))
                .collect(),
            reported: vec![
                size("rounding_share", "1", P::QuantShare, 0.5, 1.5),
                form("duty_steps", "1", P::QuantSteps, 2.0, 4096.0),
            ],
            conflicts: &["dead-zone"],
            next_experiment: "sweep the duty in steps of 0.01 over 0.1: a staircase shows its treads",
        },
        Effect {
            name: "high-duty-saturation",
            says: "more duty gives less and less drive: the speed–duty line bends at the top",
            equation: "u → u/(1 + u/us)",
            shapes: vec![one(P::Saturation, 0.3, 0.01)],
            reported: vec![size("inverse_saturation_duty", "1", P::Saturation, 0.0, 5.0)],
            conflicts: &["contact-stiffening", "supply-sag"],
            next_experiment: "edge timestamps (format edges) at duties 0.8 to 1: saturation shortens the drive, a sag slows the rotor within it",
        },
        Effect {
            name: "contact-stiffening",
            says: "the contact takes up the speed difference softly: the rotor approaches the wave's speed slowly",
            equation: "drive torque saturates within a slip band (s₀ + s)·ω_free instead of s₀·ω_free (contact force ∝ δⁿ)",
            // Secants: a wide band is far from what a narrow one suggests.
            shapes: vec![one(P::SlipExtra, 0.5, 0.05), one(P::SlipExtra, 0.3, 0.3), one(P::SlipExtra, 1.0, 1.0)],
            reported: vec![size("slip_band_excess", "1", P::SlipExtra, 0.0, 5.0)],
            conflicts: &["high-duty-saturation", "stribeck-friction"],
            next_experiment: "edge timestamps (format edges) of starts at full duty: the approach to the final speed shows the band",
        },
        Effect {
            name: "direction-asymmetry",
            says: "the motor is faster in one direction than in the other",
            equation: "speed·(1 ± g), braking·(1 ± b)",
            shapes: vec![
                Shape { columns: vec![scalar(P::AsymSpeed, 0.1, 0.005, &[])], pinned: Vec::new(), phased: false },
                Shape {
                    columns: vec![scalar(P::AsymSpeed, 0.1, 0.005, &[]), scalar(P::AsymBrake, 0.3, 0.03, &[])],
                    pinned: Vec::new(),
                    phased: false,
                },
            ],
            reported: vec![
                size("speed_asymmetry", "1", P::AsymSpeed, -0.6, 0.6),
                form("braking_asymmetry", "1", P::AsymBrake, -0.9, 0.9),
            ],
            conflicts: &["gravity-load"],
            next_experiment: "turn the motor's axis vertical and repeat one duty in both directions: a load's bias goes, an asymmetry stays",
        },
        Effect {
            name: "preload-runout",
            says: "the drive changes with the rotor's angle: the preload is not the same all round",
            equation: "drive·(1 + a₁·cos(θ − φ₁) + a₂·cos(2θ − φ₂))",
            shapes: vec![
                Shape { columns: (0..2).map(Column::Runout).collect(), pinned: Vec::new(), phased: true },
                Shape { columns: (2..4).map(Column::Runout).collect(), pinned: Vec::new(), phased: true },
                Shape { columns: (0..4).map(Column::Runout).collect(), pinned: Vec::new(), phased: true },
            ],
            reported: Vec::new(),
            conflicts: &["encoder-eccentricity"],
            next_experiment: "re-seat the rotor by 90° against the encoder wheel and repeat one run: runout turns with the rotor, eccentricity stays with the wheel",
        },
        Effect {
            name: "encoder-eccentricity",
            says: "the encoder wheel is not centred: its angle errs once a turn, the same at every duty",
            equation: "θ_measured = θ + e·sin(θ − φ)",
            shapes: vec![Shape {
                columns: (0..2).map(Column::Eccentricity).collect(),
                pinned: Vec::new(),
                phased: true,
            }],
            reported: Vec::new(),
            conflicts: &["preload-runout"],
            next_experiment: "re-seat the rotor by 90° against the encoder wheel and repeat one run: runout turns with the rotor, eccentricity stays with the wheel",
        },
        Effect {
            name: "unequal-edges",
            says: "the encoder's high and low slots are not equally wide",
            equation: "high slots (1 + δ) pitch, low slots (1 − δ) pitch",
            shapes: vec![one(P::EdgeOffset, 0.2, 0.01)],
            reported: vec![size("high_slot_excess", "1", P::EdgeOffset, -0.9, 0.9)],
            conflicts: &[],
            next_experiment: "one run at full duty with edge timestamps (format edges)",
        },
        Effect {
            name: "clock-error",
            says: "the recorder's clock runs fast or slow: speeds and PWM periods are scaled alike",
            equation: "t_recorded = (1 + ε)·t",
            shapes: std::iter::once(one(P::ClockError, 1e-3, 2e-5))
                .chain((1..=15).flat_map(|k| {
                    let e = 8e-4 * f64::from(k);
                    // Secants: a drift of a PWM period is far from linear.
                    [one(P::ClockError, e, e), one(P::ClockError, -e, -e)]
                }))
                .collect(),
            reported: vec![size("relative_clock_error", "1", P::ClockError, -0.1, 0.1)],
            conflicts: &["dropped-samples"],
            next_experiment: "record a reference signal of known frequency on the encoder input",
        },
        Effect {
            name: "stribeck-friction",
            says: "the rotor sticks at low speed: friction is larger at rest",
            equation: "friction + Fs·exp(−(ω/vs)²)",
            shapes: [0.15, 0.4, 1.0, 2.0]
                .iter()
                .map(|vs| {
                    shaped(
                        P::StribeckDeceleration,
                        0.5 * on_acceleration,
                        0.05 * on_acceleration,
                        vec![(P::StribeckSpeed, *vs)],
                    )
                })
                .collect(),
            // Dry contacts hold at rest up to one and three quarters of what they hold when sliding: more extra friction than that is a start
            // on the edge of standing still, which poses as a delay.
            reported: vec![
                size("extra_friction_over_inertia", "rad/s^2", P::StribeckDeceleration, 0.0, 0.75 * on_acceleration),
                form("stribeck_speed", "rad/s", P::StribeckSpeed, 0.02, 4.0),
            ],
            conflicts: &["dead-zone", "start-delay", "contact-stiffening"],
            next_experiment: "runs at the lowest duty that moves, at 25 Hz and 100 Hz PWM, with edge timestamps",
        },
        Effect {
            name: "supply-sag",
            says: "the supply gives way under load: more drive power, less speed, at once",
            equation: "speed·(1 − r·s), τ·ds/dt = drive − s  (V = V₀ − R·I, with the supply's capacitance)",
            shapes: [0.003, 0.01, 0.03, 0.1]
                .iter()
                .map(|tau| shaped(P::Sag, 0.2, 0.01, vec![(P::SagTime, *tau)]))
                .collect(),
            reported: vec![
                size("speed_lost_at_full_duty", "1", P::Sag, 0.0, 0.9),
                form("supply_time_s", "s", P::SagTime, 1e-3, 0.25),
            ],
            conflicts: &["resonance-heating", "high-duty-saturation"],
            next_experiment: "repeat duties 0.5 and 1 with the supply's voltage logged, or from a stiffer supply",
        },
        Effect {
            name: "run-in-wear",
            says: "the motor changes for good from run to run, with the distance it has turned",
            equation: "speed·(1 + w·log(1 + revs/r₀))",
            shapes: [0.3, 3.0, 30.0]
                .iter()
                .map(|r0| shaped(P::Wear, 0.05, 0.002, vec![(P::WearRevolutions, *r0)]))
                .collect(),
            reported: vec![
                size("change_per_log_revolution", "1", P::Wear, -0.3, 0.3),
                form("run_in_revolutions", "1", P::WearRevolutions, 0.03, 1000.0),
            ],
            conflicts: &["resonance-heating"],
            next_experiment: "repeat the first run now, after a long pause: wear stays, warmth is gone",
        },
        Effect {
            name: "gravity-load",
            says: "a weight off the axis pulls with the sine of the angle",
            equation: "load torque m·g·l·sin(θ + φ)",
            shapes: vec![Shape { columns: (0..2).map(Column::Gravity).collect(), pinned: Vec::new(), phased: true }],
            reported: Vec::new(),
            conflicts: &["preload-runout"],
            next_experiment: "turn the motor's axis vertical and repeat the run: gravity's torque goes",
        },
        Effect {
            name: "backlash",
            says: "motion is lost at each reversal before the encoder follows",
            equation: "a gap g between motor and encoder",
            shapes: vec![one(P::Backlash, 0.02, 1e-3)],
            reported: vec![size("gap_rad", "rad", P::Backlash, 0.0, 0.3)],
            conflicts: &["reversal-miscount", "presliding"],
            next_experiment: "reverse by hand-sized steps of 10°: a gap returns, a miscount accumulates",
        },
        Effect {
            name: "reversal-miscount",
            says: "the counter gains or loses counts at each reversal",
            equation: "count + n at each reversal, in the new sense or always in the same",
            shapes: vec![one(P::Miscount, 1.0, 0.1), one(P::MiscountDrift, 1.0, 0.1)],
            reported: vec![
                size("counts_per_reversal", "1", P::Miscount, -5.0, 5.0),
                size("counts_gained_per_reversal", "1", P::MiscountDrift, -5.0, 5.0),
            ],
            conflicts: &["backlash"],
            next_experiment: "track the same sine for ten periods and return to the mark: a miscount's error grows with each reversal",
        },
    ]
}

/// Whether fitted parameters say that it is not this effect but another: a time ran to the end of its range in the library (the limits
/// here lie just inside those).
pub fn belongs_elsewhere(effect: &str, p: &Parameters) -> bool {
    match effect {
        // Quicker is no warmth; what builds up over many runs and is never lost is wear.
        "resonance-heating" => p.get(P::HeatTau) < 0.302 || p.get(P::HeatCarry) > 0.995 && p.get(P::HeatTau) > 10.0,
        // Slower is warmth.
        "frequency-settling" => p.get(P::SettleTau) > 0.398,
        // A supply gives way at once.
        "supply-sag" => p.get(P::SagTime) > 0.249,
        _ => false,
    }
}

/// Whether an effect that cannot be judged from some runs may still act in them, and look like another.
pub fn could_pose(effect: &str) -> bool {
    matches!(
        effect,
        "resonance-heating"
            | "run-in-wear"
            | "dead-zone"
            | "start-delay"
            | "stribeck-friction"
            | "high-duty-saturation"
            | "supply-sag"
    )
}

/// Why an effect cannot be judged from these runs, if it cannot.
pub fn not_judged(effect: &str, problem: &Problem, coasting_baseline: bool) -> Option<String> {
    let runs = &problem.runs;
    let any_track = runs.iter().any(|r| r.kind == RunKind::Track);
    let pwm = runs.iter().filter_map(|r| r.duty).any(|d| d > 0.0 && d < 1.0 - 1e-9) || any_track;
    let edges = runs.iter().any(|r| r.pitch > 0.0);
    let levels = runs.iter().any(|r| r.pitch > 0.0 && r.level.iter().any(|l| *l != 0));
    let directions = any_track || (runs.iter().any(|r| r.direction > 0.0) && runs.iter().any(|r| r.direction < 0.0));
    let turns = runs.iter().map(|r| r.revolutions()).fold(0.0, f64::max);
    let missing = |what: &str| Some(what.to_owned());
    match effect {
        "dead-zone" | "high-duty-saturation" | "supply-sag" | "duty-quantisation"
            if problem.duties() < 3 && !any_track =>
        {
            missing("needs at least three duties")
        }
        "start-delay" | "stribeck-friction" | "contact-stiffening" if !pwm => missing("needs runs below full duty"),
        "off-phase-braking" if !coasting_baseline => missing("the baseline's own off-phase friction is refitted"),
        "off-phase-braking" if !pwm => missing("needs runs below full duty"),
        "direction-asymmetry" if !directions => missing("needs runs in both directions"),
        "preload-runout" | "encoder-eccentricity" | "gravity-load" if turns < 0.6 => {
            missing("needs runs of more than half a turn")
        }
        "gravity-load" if !any_track => missing("needs closed-loop runs"),
        "unequal-edges" if !levels => missing("needs encoder edges"),
        "clock-error" if !pwm || !edges => missing("needs edges of runs below full duty: the PWM line is the clock"),
        "run-in-wear" if !problem.ordered() || runs.len() < 4 => missing("needs the order of at least four runs"),
        "backlash" | "reversal-miscount" | "presliding" if !any_track => {
            missing("needs closed-loop runs with reversals")
        }
        "resonance-heating" if runs.iter().all(|r| r.record_end < 0.8) => missing("needs runs of a second or more"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if wear may pose as warmth that is never lost, or real warmth is refused because little of it is lost between runs.
    #[test]
    fn a_time_at_the_end_of_its_range_is_another_effect() {
        let p = Parameters::new(3.6, 1888.0, 1888.0, 0.26, 0.02);
        let elsewhere = |effect: &str, values: &[(P, f64)]| {
            belongs_elsewhere(effect, &values.iter().fold(p.clone(), |p, (which, value)| p.with(*which, *value)))
        };
        assert!(elsewhere("resonance-heating", &[(P::HeatTau, 30.0), (P::HeatCarry, 1.0)]));
        assert!(elsewhere("resonance-heating", &[(P::HeatTau, 0.3), (P::HeatCarry, 0.5)]));
        assert!(!elsewhere("resonance-heating", &[(P::HeatTau, 2.8), (P::HeatCarry, 1.0)]));
        assert!(!elsewhere("resonance-heating", &[(P::HeatTau, 60.0), (P::HeatCarry, 0.9)]));
        assert!(elsewhere("supply-sag", &[(P::SagTime, 0.25)]) && !elsewhere("supply-sag", &[(P::SagTime, 0.02)]));
        assert!(elsewhere("frequency-settling", &[(P::SettleTau, 0.4)]));
        assert!(!elsewhere("frequency-settling", &[(P::SettleTau, 0.3)]));
    }
}
