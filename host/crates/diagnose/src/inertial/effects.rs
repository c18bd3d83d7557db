//! The library of effects of an ordinary motor, and what is believed of every number of the plant before the data.
//!
//! Sizes of inputs are shares of the largest one, times are in the record's own scale: nothing here knows a motor.

use super::data::Data;
use super::values::P;

/// A number that is fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Free {
    /// Which.
    pub number: P,
    /// Centre of what is believed.
    pub centre: f64,
    /// Standard deviation of what is believed.
    pub sd: f64,
    /// Admissible range.
    pub bounds: (f64, f64),
    /// Step of the derivative.
    pub step: f64,
}

impl Free {
    /// Log density of a value, without its constant.
    pub fn log_density(&self, value: f64) -> f64 {
        -0.5 * ((value - self.centre) / self.sd).powi(2)
    }
}

/// Over what an effect shows; two over one coordinate may be one whose form is not the library's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Coordinate {
    /// Around standstill.
    Rest,
    /// At large inputs.
    Top,
    /// The two directions.
    Direction,
    /// The time after a change of the input.
    Time,
    /// The angle.
    Angle,
    /// The temperature.
    Temperature,
}

/// One way in which an effect acts.
#[derive(Debug, Clone, Copy)]
pub struct Form {
    /// Its numbers.
    pub numbers: &'static [P],
    /// Where the search begins, one value a number; of times, in samples.
    pub starts: &'static [&'static [f64]],
    /// Numbers without which it makes no sense.
    pub needs: &'static [P],
}

/// An effect.
#[derive(Debug, Clone, Copy)]
pub struct Effect {
    /// Name in the JSON.
    pub name: &'static str,
    /// What it is, in a sentence.
    pub says: &'static str,
    /// What the model gains.
    pub equation: &'static str,
    /// Over what it shows.
    pub coordinate: Coordinate,
    /// Ways in which it may act.
    pub forms: &'static [Form],
    /// What would tell it from its rivals.
    pub next_experiment: &'static str,
    /// Whether it belongs to what a motor is: reported as the plant's own, never as a cause.
    pub own: bool,
}

const AROUND_THE_THRESHOLD: &str = "let the motor run down from full speed at input zero: friction brakes it to a stop in a straight line, a dead zone lets it \
     coast along an exponential; then sweep the input slowly through zero: friction with a peak at rest shows a loop";
const OTHER_WAY_ROUND: &str = "mount the motor the other way round and repeat the sweep: a load changes sides, the motor's own asymmetry does not";

/// From where a resonance is looked for: times of swinging in samples, each so near the next that a fit from one of the two arrives (a swing is
/// felt over a period that differs by a third), with the damping and inertia ratios of a usual coupling.
const SWINGS: [&[f64]; 8] = [
    &[0.6, 0.1, 0.5],
    &[1.0, 0.1, 0.5],
    &[1.7, 0.1, 0.5],
    &[2.9, 0.1, 0.5],
    &[4.9, 0.1, 0.5],
    &[8.4, 0.1, 0.5],
    &[14.0, 0.1, 0.5],
    &[24.0, 0.1, 0.5],
];

/// The library.
pub const EFFECTS: [Effect; 11] = [
    Effect {
        name: "coulomb-friction",
        says: "a friction that does not depend on the speed brakes all motion and holds the motor at small inputs",
        equation: "τ·ω' = K·u − ω − K·F·sign(ω); at rest while |u| ≤ F",
        coordinate: Coordinate::Rest,
        forms: &[Form { numbers: &[P::Coulomb], starts: &[&[0.03], &[0.12], &[0.3]], needs: &[] }],
        next_experiment: AROUND_THE_THRESHOLD,
        own: false,
    },
    Effect {
        name: "dead-zone",
        says: "part of every input is lost: below a threshold nothing moves",
        equation: "u → sign(u)·max(|u| − u₀, 0)",
        coordinate: Coordinate::Rest,
        forms: &[Form { numbers: &[P::DeadZone], starts: &[&[0.03], &[0.12], &[0.3]], needs: &[] }],
        next_experiment: AROUND_THE_THRESHOLD,
        own: false,
    },
    Effect {
        name: "stribeck-friction",
        says: "friction is larger at rest than in motion: the motor breaks away with a jump",
        equation: "at rest while |u| ≤ F + S",
        coordinate: Coordinate::Rest,
        forms: &[Form { numbers: &[P::Stiction], starts: &[&[0.03], &[0.12]], needs: &[] }],
        next_experiment: AROUND_THE_THRESHOLD,
        own: false,
    },
    Effect {
        name: "direction-asymmetry",
        says: "the two directions differ",
        equation: "K·(1 ± g), and F·(1 ± f) or u₀·(1 ± d)",
        coordinate: Coordinate::Direction,
        forms: &[
            Form { numbers: &[P::GainSplit], starts: &[&[0.0]], needs: &[] },
            Form { numbers: &[P::GainSplit, P::DeadSplit], starts: &[&[0.0, 0.0]], needs: &[P::DeadZone] },
            Form { numbers: &[P::GainSplit, P::FrictionSplit], starts: &[&[0.0, 0.0]], needs: &[P::Coulomb] },
        ],
        next_experiment: OTHER_WAY_ROUND,
        own: false,
    },
    Effect {
        name: "load-bias",
        says: "a steady load pulls one way, or the input's zero is off",
        equation: "u → u − b",
        coordinate: Coordinate::Direction,
        forms: &[Form { numbers: &[P::Bias], starts: &[&[0.0]], needs: &[] }],
        next_experiment: OTHER_WAY_ROUND,
        own: false,
    },
    Effect {
        name: "high-duty-saturation",
        says: "the speed bends away from the input at its upper end",
        equation: "u → u/(1 + b·u), u/(1 + (b·u)^p)^(1/p), or min(u, u₁)",
        coordinate: Coordinate::Top,
        forms: &[
            Form { numbers: &[P::Bend], starts: &[&[0.3], &[2.0], &[6.0]], needs: &[] },
            Form { numbers: &[P::FlatTop], starts: &[&[0.05], &[0.3]], needs: &[] },
            Form { numbers: &[P::Bend, P::BendPower], starts: &[&[0.6, 1.5], &[1.5, 1.0]], needs: &[] },
        ],
        next_experiment: "log the supply voltage at full input: a sag is in the supply, a saturation is not",
        own: false,
    },
    Effect {
        name: "dead-time",
        says: "the motor answers a change of the input only after a time",
        equation: "u(t) → u(t − T)",
        coordinate: Coordinate::Time,
        forms: &[Form { numbers: &[P::DeadTime], starts: &[&[1.0], &[5.0], &[20.0]], needs: &[] }],
        next_experiment: "apply steps and sample ten times faster: a dead time shows a flat beginning, a second lag a rounded one",
        own: false,
    },
    Effect {
        name: "second-lag",
        says: "a second lag rounds off every change (winding, filter, elastic part)",
        equation: "T₂·x' = u − x",
        coordinate: Coordinate::Time,
        forms: &[Form { numbers: &[P::SecondLag], starts: &[&[1.0], &[5.0], &[20.0]], needs: &[] }],
        next_experiment: "apply steps and sample ten times faster: a dead time shows a flat beginning, a second lag a rounded one",
        own: true,
    },
    Effect {
        name: "coupling-resonance",
        says: "motor and load swing against one another on an elastic coupling (belt, shaft, gear)",
        equation: "τ·ω₁' = (1 + r)·(K·u − ω₁) − τ·r·M, ω₂' = M = ω₀²/(1 + r)·(φ + 2·ζ/ω₀·φ'), φ' = ω₁ − ω₂, ω₀ = 1/swing_s",
        coordinate: Coordinate::Time,
        forms: &[
            Form { numbers: &[P::Swing, P::SwingDamping, P::SwingOfMotor], starts: &SWINGS, needs: &[] },
            Form { numbers: &[P::Swing, P::SwingDamping, P::SwingOfLoad], starts: &SWINGS, needs: &[] },
        ],
        next_experiment: "hold the load and repeat a step: what swings on the coupling then swings at another frequency, or not at all",
        own: false,
    },
    Effect {
        name: "cogging",
        says: "a torque goes with the angle: teeth and magnets hold the rotor at some places and pull it on between them",
        equation: "u → u + A·cos(n·θ − φ), at n and another order, or u → u·(1 + A·cos(n·θ − φ))",
        coordinate: Coordinate::Angle,
        forms: &[
            Form { numbers: &[P::CoggingCos, P::CoggingSin], starts: &[&[0.03, 0.0], &[0.2, 0.0]], needs: &[] },
            Form {
                numbers: &[P::CoggingCos, P::CoggingSin, P::Cogging2Cos, P::Cogging2Sin],
                starts: &[&[0.1, 0.0, 0.05, 0.0]],
                needs: &[],
            },
            Form { numbers: &[P::RippleCos, P::RippleSin], starts: &[&[0.1, 0.0], &[-0.1, 0.0]], needs: &[] },
        ],
        next_experiment: "turn slowly at three steady inputs, with an encoder read: cogging keeps its size, a torque ripple grows with the input, an \
                          eccentric encoder's error with the speed",
        own: false,
    },
    Effect {
        name: "heating",
        says: "the input moves the motor less as it warms: copper and magnets lose with the temperature",
        equation: "x → x·(1 − h·(ϑ − ϑ₀)), ϑ₀ the mean temperature of the runs",
        coordinate: Coordinate::Temperature,
        forms: &[Form { numbers: &[P::Heating], starts: &[&[0.0]], needs: &[] }],
        next_experiment: "repeat a run cold and warm, in turns: what goes with the order and not with the temperature is wear",
        own: false,
    },
];

/// Name and unit of a number in the JSON; sizes are shares of the largest input.
pub fn reported(number: P) -> (&'static str, &'static str) {
    match number {
        P::Gain => ("gain_rpm", "rpm"),
        P::LogLag => ("log_lag", "1"),
        P::Skew => ("input_early", "samples"),
        P::DeadTime => ("dead_time_s", "s"),
        P::SecondLag => ("second_lag_s", "s"),
        P::Coulomb => ("coulomb", "1"),
        P::FrictionSplit => ("friction_asymmetry", "1"),
        P::Stiction => ("stiction", "1"),
        P::Bias => ("bias", "1"),
        P::DeadZone => ("threshold", "1"),
        P::DeadSplit => ("threshold_asymmetry", "1"),
        P::GainSplit => ("gain_asymmetry", "1"),
        P::Bend => ("bend", "1"),
        P::BendPower => ("bend_power_above_1", "1"),
        P::FlatTop => ("flat_share", "1"),
        P::CoggingCos | P::CoggingSin => ("cogging", "1"),
        P::Cogging2Cos | P::Cogging2Sin => ("cogging_2", "1"),
        P::RippleCos | P::RippleSin => ("torque_ripple", "1"),
        P::Load => ("load_share", "1"),
        P::Heating => ("loss_per_kelvin", "1/K"),
        P::Corner => ("threshold_corner", "1"),
        P::StribeckSpeed => ("stribeck_speed", "1"),
        P::Swing => ("swing_s", "s"),
        P::SwingDamping => ("damping_ratio", "1"),
        P::SwingOfMotor => ("inertia_ratio_motor_seen", "1"),
        P::SwingOfLoad => ("inertia_ratio_load_seen", "1"),
    }
}

/// Of a torque over the angle, the sine that belongs to a cosine, and which of [`Data::ripples`] it is over.
pub fn over_angle(number: P) -> Option<(P, usize)> {
    match number {
        P::CoggingCos => Some((P::CoggingSin, 0)),
        P::Cogging2Cos => Some((P::Cogging2Sin, 1)),
        P::RippleCos => Some((P::RippleSin, 0)),
        _ => None,
    }
}

/// Whether a number is a time that [`Form::starts`] gives in samples.
pub fn is_time(number: P) -> bool {
    matches!(number, P::DeadTime | P::SecondLag | P::Swing)
}

/// What the search leaves out of a number's form, with where its fit begins: it hardly moves the speeds, but it moves the numbers.
pub fn refined_by(number: P) -> &'static [(P, f64)] {
    match number {
        P::DeadZone => &[(P::Corner, 0.02)],
        P::Stiction => &[(P::StribeckSpeed, 0.02)],
        P::Coulomb => &[(P::Stiction, 0.05), (P::StribeckSpeed, 0.02)],
        _ => &[],
    }
}

/// The number that does the same to slow changes.
pub fn twin(number: P) -> Option<P> {
    match number {
        P::Coulomb => Some(P::DeadZone),
        P::DeadZone => Some(P::Coulomb),
        P::FrictionSplit => Some(P::DeadSplit),
        P::DeadSplit => Some(P::FrictionSplit),
        P::DeadTime => Some(P::SecondLag),
        P::SecondLag => Some(P::DeadTime),
        _ => None,
    }
}

/// What is believed of a number before the data. Widths span what drives of all sizes do; those of times are the record's.
pub fn free(number: P, data: &Data) -> Free {
    let shortest = data.runs.iter().map(|r| r.period_s).fold(f64::INFINITY, f64::min);
    let longest = data.runs.iter().map(|r| r.seconds()).fold(0.0, f64::max);
    let around_zero = |sd: f64, bounds: (f64, f64), step: f64| Free { number, centre: 0.0, sd, bounds, step };
    match number {
        P::Gain => {
            let gain = data.usual_rpm;
            Free { number, centre: 0.0, sd: 100.0 * gain, bounds: (-1e3 * gain, 1e3 * gain), step: 1e-4 * gain }
        }
        P::LogLag => Free {
            number,
            // Two thirds of ordinary drives lie within 40 and 270 ms. A sweep that passes each input once hardly shows the lag.
            centre: -2.3,
            sd: 1.0,
            bounds: ((shortest / 30.0).ln(), (20.0 * longest).ln()),
            step: 1e-3,
        },
        // Steps of the input bend what a delay does where it is a whole number of samples: the derivative is over far less than is told.
        P::Skew => around_zero(0.5, (-1.5, 1.5), 1e-3),
        // Longer than the skew by far where it is there at all.
        // Its derivative is over as much as that of the skew: both are one delay, and must look it on either side of a step of the input.
        P::DeadTime => around_zero(10.0 * shortest, (0.0, 0.3 * longest), 1e-3 * shortest),
        P::SecondLag => around_zero(10.0 * shortest, (0.0, 0.3 * longest), 0.02 * shortest),
        P::Coulomb => around_zero(0.2, (0.0, 0.95), 1e-4),
        P::FrictionSplit => around_zero(0.3, (-0.95, 0.95), 1e-3),
        P::Stiction => around_zero(0.1, (0.0, 0.7), 1e-3),
        P::Bias => around_zero(0.1, (-0.9, 0.9), 1e-4),
        P::DeadZone => around_zero(0.2, (0.0, 0.8), 1e-4),
        P::DeadSplit => around_zero(0.3, (-0.95, 0.95), 1e-3),
        P::GainSplit => around_zero(0.1, (-0.8, 0.8), 1e-4),
        P::Bend => around_zero(4.0, (0.0, 60.0), 1e-3),
        // Iron and amplifiers bend between at once (0) and a corner.
        P::BendPower => around_zero(1.5, (0.0, 6.0), 1e-2),
        P::FlatTop => around_zero(0.2, (0.0, 0.8), 1e-3),
        P::CoggingCos | P::CoggingSin | P::Cogging2Cos | P::Cogging2Sin => around_zero(0.1, (-0.9, 0.9), 1e-4),
        P::RippleCos | P::RippleSin => around_zero(0.1, (-0.9, 0.9), 1e-3),
        // Of any unit and sign; a load beyond what the drive can hold ten times over is none that it was run with.
        P::Load => around_zero(0.5, (-10.0, 10.0), 1e-4),
        // Copper gains 0.4 % of resistance a kelvin, magnets lose 0.1 to 0.2 %.
        P::Heating => around_zero(0.004, (-0.05, 0.05), 1e-5),
        // A ripple of some per cent rounds the corner, and friction falls within some per cent of the speed.
        P::Corner => around_zero(0.05, (0.0, 0.3), 1e-4),
        P::StribeckSpeed => around_zero(0.05, (0.0, 0.5), 1e-4),
        P::Swing => around_zero(10.0 * shortest, (0.0, 0.03 * longest), 0.02 * shortest),
        // Steel rings with hundredths (in vacuum with a thousandth), a belt dies within a swing; beyond, two lags are what is seen.
        P::SwingDamping => around_zero(0.15, (1e-3, 0.7), 1e-3),
        // A load ten times the motor's inertia holds it still at the resonance.
        P::SwingOfMotor | P::SwingOfLoad => around_zero(2.0, (1e-2, 30.0), 1e-3),
    }
}
