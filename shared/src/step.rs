//! The one pure control step: target and position in, signed drive out, integers only.
//!
//! Four named configurations exist. [`ConfigSpec::THESIS`] is the arithmetic of the thesis's position controller
//! (appendix C.2), quirks included; [`ConfigSpec::DEFAULT`] is what this project recommends; [`ConfigSpec::GATED`] knows its
//! motor and is an order better, where the driver board follows pulses of a millisecond as they come; [`ConfigSpec::PLANNED`] makes one
//! pulse of that knowledge every 20 ms. All run through the same [`step`], and so does anything a user configures.

mod gated;
mod guide;
mod load;
mod model;
#[cfg(test)]
mod motor;
mod planned;
mod reversal;
mod rotor;

use crate::{Direction, Duty};
use fixed::types::{I16F48, I32F32};
pub use guide::GuideSpec;
pub use load::Load;
pub use reversal::Reversal;
pub use rotor::Rotor;
use serde::{Deserialize, Serialize};

/// How the control signal becomes a duty.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DriveLaw {
    /// The thesis's: the pin's high time is `steps - 1 - |u|`, clipped at zero and truncated, so no control signal still
    /// leaves one step of drive on, and a zero signal turns counter-clockwise.
    ActiveLowTruncated,
    /// On time is `|u|` rounded to the nearest step, zero is off, and the direction only changes with drive.
    OnTimeRounded,
    /// On or off for a whole control period, by a model of the rotor instead of gains: the PWM period must be the control
    /// period.
    Gated,
}

/// A controller as it travels and is stored: not yet validated. [`Config::try_from`] validates it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConfigSpec {
    /// Proportional gain, duty steps per count.
    pub kp: I32F32,
    /// Integral gain, duty steps per count and tick (the usual gain per count·s, times the period).
    pub ki_tick: I16F48,
    /// Derivative gain, duty steps per count/tick (the usual gain per count/s, over the period).
    pub kd_tick: I32F32,
    /// Feed-forward of the target's rate, duty steps per count/s.
    pub feed_forward: I32F32,
    /// Smallest value of the error integral, count·ticks.
    pub integral_min: i32,
    /// Largest value of the error integral, count·ticks.
    pub integral_max: i32,
    /// Control period, µs.
    pub period_us: u32,
    /// Duty steps in a PWM period.
    pub duty_steps: u16,
    /// How the control signal becomes a duty.
    pub law: DriveLaw,
    /// While the target rests, errors up to this many counts are left alone and the drive is off.
    pub dead_band_counts: u16,
    /// Stop integrating while the drive is saturated in the direction of the error.
    pub conditional_integration: bool,
    /// The direction changes only after so many ticks with the drive off and without an edge; zero changes it at once.
    pub reversal_rest_ticks: u16,
    /// It changes after so many ticks with the drive off at the latest, edges or not.
    pub reversal_limit_ticks: u16,
    /// Speed at full drive, counts/s, for a law that has a model of the rotor; it adapts to what it sees, within limits.
    pub full_speed_counts_s: u16,
    /// Speed lost with the drive off, counts/s². It adapts too.
    pub braking_counts_s2: u32,
    /// Control periods between a decision and its effect on the rotor.
    pub delay_ticks: u8,
    /// Shortest pulse, and shortest rest, that the driver board follows, control periods.
    pub shortest_pulse_ticks: u8,
    /// From one pulse's beginning to the next at least, control periods; at 1 a pulse begins and ends when it has to.
    pub pulse_period_ticks: u8,
    /// Whether a model of the rotor is corrected by what is seen of it.
    pub learns: bool,
    /// How the target of a gated drive gives way to a load.
    pub guide: GuideSpec,
}

impl ConfigSpec {
    /// The thesis's position controller (C.2): gains 1.3, 0.0015 and 0.00004 in 5-bit duty steps, every 500 µs, the
    /// integral clamped to [0, 31] count·s.
    pub const THESIS: Self = Self {
        kp: I32F32::lit("1.3"),
        ki_tick: I16F48::lit("0.00000075"),
        kd_tick: I32F32::lit("0.08"),
        feed_forward: I32F32::ZERO,
        integral_min: 0,
        integral_max: 62_000,
        period_us: 500,
        duty_steps: 32,
        law: DriveLaw::ActiveLowTruncated,
        dead_band_counts: 0,
        conditional_integration: false,
        reversal_rest_ticks: 0,
        reversal_limit_ticks: 0,
        full_speed_counts_s: 0,
        braking_counts_s2: 0,
        delay_ticks: 0,
        shortest_pulse_ticks: 0,
        pulse_period_ticks: 0,
        learns: false,
        guide: GuideSpec::OFF,
    };

    /// The recommended controller: finer duty, symmetric anti-windup, feed-forward of the target's rate, true off.
    ///
    /// There is no derivative term: the encoder resolves 0.9°, so its difference over 500 µs is all quantisation.
    pub const DEFAULT: Self = Self {
        kp: I32F32::lit("70"),
        ki_tick: I16F48::lit("0.1"),
        kd_tick: I32F32::ZERO,
        feed_forward: I32F32::lit("4"),
        integral_min: -4_000,
        integral_max: 4_000,
        period_us: 500,
        duty_steps: 1_024,
        law: DriveLaw::OnTimeRounded,
        dead_band_counts: 0,
        conditional_integration: true,
        reversal_rest_ticks: 0,
        reversal_limit_ticks: 0,
        full_speed_counts_s: 0,
        braking_counts_s2: 0,
        delay_ticks: 0,
        shortest_pulse_ticks: 0,
        pulse_period_ticks: 0,
        learns: false,
        guide: GuideSpec::OFF,
    };

    /// The 30 mm PCBMotor under a drive that is gated every control period, with pulses of 1 ms and more: 35 rpm at full drive,
    /// and the braking that the thesis's closed loop shows of the real motor (`twum model braking`). Between a decision
    /// and the rotor lie a PWM period and what the wave takes to grow. The direction changes 10 ms after the last edge, by when
    /// this rotor stands.
    pub const GATED: Self = Self {
        kp: I32F32::ZERO,
        ki_tick: I16F48::ZERO,
        feed_forward: I32F32::ZERO,
        integral_min: 0,
        integral_max: 0,
        law: DriveLaw::Gated,
        conditional_integration: false,
        reversal_rest_ticks: 20,
        reversal_limit_ticks: 100,
        full_speed_counts_s: 234,
        braking_counts_s2: 16_400,
        delay_ticks: 2,
        shortest_pulse_ticks: 2,
        pulse_period_ticks: 1,
        learns: true,
        ..Self::DEFAULT
    };

    /// [`ConfigSpec::GATED`] with one pulse every 20 ms, for a driver board made for 50 Hz.
    pub const PLANNED: Self = Self { pulse_period_ticks: 40, ..Self::GATED };
}

impl ConfigSpec {
    /// The controllers that have a name.
    pub const NAMED: [(&'static str, Self); 4] =
        [("thesis", Self::THESIS), ("default", Self::DEFAULT), ("gated", Self::GATED), ("planned", Self::PLANNED)];

    /// The controller of a name.
    pub fn named(name: &str) -> Option<Self> {
        Self::NAMED.into_iter().find(|(known, _)| *known == name).map(|(_, spec)| spec)
    }

    /// Whether a gated drive makes one pulse a period, instead of one whenever it has to.
    const fn has_pulse_period(&self) -> bool {
        self.pulse_period_ticks > 1
    }

    /// The PWM frequency that goes with the law, Hz: the thesis's, or one period for each tick of a gated drive.
    pub const fn pwm_hz(&self) -> u16 {
        match self.law {
            DriveLaw::ActiveLowTruncated | DriveLaw::OnTimeRounded => 50,
            DriveLaw::Gated if self.period_us < 100 => 10_000,
            DriveLaw::Gated => (1_000_000 / self.period_us) as u16,
        }
    }
}

/// Why a configuration cannot run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum ConfigError {
    /// A gain whose product with the largest error would overflow.
    #[error("gain {0} is out of range: its magnitude must stay below 1024 duty steps per unit")]
    Gain(GainName),
    /// Integral limits that are not in order, do not contain zero, or overflow with the integral gain.
    #[error("integral limits must satisfy min <= 0 <= max, and |ki| times the larger one stay below 16384 duty steps")]
    IntegralLimits,
    /// A period the timers do not serve.
    #[error("control period {0} us is outside 100..=10000 us")]
    Period(u32),
    /// Too few or too many duty steps.
    #[error("{0} duty steps are outside 2..=32768")]
    DutySteps(u16),
    /// A rest that the limit of the wait would never let come.
    #[error("reversal_rest_ticks must not be above reversal_limit_ticks")]
    Reversal,
    /// A model of the rotor that fixed point cannot hold.
    #[error(
        "a gated drive needs full_speed_counts_s up to 8 counts a tick, a braking that it has some ticks to bear, \
         delay_ticks up to 8, shortest_pulse_ticks and pulse_period_ticks 1 to 40 and reversal_rest_ticks above 0"
    )]
    Rotor,
    /// A target that gives way in a manner that fixed point cannot hold, or under a law that knows of no load.
    #[error(
        "a target gives way (guide_limit_counts, up to 256) under law gated with pulse_period_ticks above 1 only; guide_stiffness_nnm, \
         guide_damping_nnm_s and guide_braking_nnm are 1 to 1000000000, guide_dead_band_nnm is below the braking, and \
         stiffness over damping 0.04 to 1000 a second"
    )]
    Guide,
}

/// Names a gain in an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum GainName {
    /// Proportional.
    Kp,
    /// Integral.
    Ki,
    /// Derivative.
    Kd,
    /// Feed-forward.
    FeedForward,
}

impl core::fmt::Display for GainName {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Kp => "kp",
            Self::Ki => "ki",
            Self::Kd => "kd",
            Self::FeedForward => "feed_forward",
        })
    }
}

/// A validated controller: every arithmetic operation of [`step`] stays inside 64 bits for any input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Config {
    spec: ConfigSpec,
    model: model::Model,
    admittance: guide::Admittance,
    /// A count/s in counts a tick, 2^-32.
    rate_of_one: u32,
}

impl Config {
    /// What the controller was built from.
    pub const fn spec(&self) -> &ConfigSpec {
        &self.spec
    }
}

/// Errors saturate here: 2^18 counts are 655 turns of a 400-edge encoder, far beyond any drive's saturation.
const ERROR_LIMIT: i32 = 1 << 18;
/// Gains stay below this, so that gain (Q32) x difference of two errors stays below 2^62.
const GAIN_LIMIT: I32F32 = I32F32::lit("1024");
const KI_LIMIT: I16F48 = I16F48::lit("1024");
/// Rates of the target saturate here, counts/s.
const RATE_LIMIT: i32 = 1 << 18;

impl TryFrom<ConfigSpec> for Config {
    type Error = ConfigError;

    fn try_from(spec: ConfigSpec) -> Result<Self, ConfigError> {
        let gains = [(GainName::Kp, spec.kp), (GainName::Kd, spec.kd_tick), (GainName::FeedForward, spec.feed_forward)];
        for (name, gain) in gains {
            if gain <= -GAIN_LIMIT || gain >= GAIN_LIMIT {
                return Err(ConfigError::Gain(name));
            }
        }
        if spec.ki_tick <= -KI_LIMIT || spec.ki_tick >= KI_LIMIT {
            return Err(ConfigError::Gain(GainName::Ki));
        }
        let limit = i64::from(spec.integral_max).max(-i64::from(spec.integral_min));
        let product = spec.ki_tick.to_bits().checked_abs().and_then(|ki| ki.checked_mul(limit));
        let in_order = spec.integral_min <= 0 && spec.integral_max >= 0;
        // With 48 fractional bits, 2^62 is 2^14 duty steps; a product that fits is also one the sum can bear.
        if !in_order || product.is_none_or(|p| p >= 1 << 62) {
            return Err(ConfigError::IntegralLimits);
        }
        if !(100..=10_000).contains(&spec.period_us) {
            return Err(ConfigError::Period(spec.period_us));
        }
        if !(2..=32_768).contains(&spec.duty_steps) {
            return Err(ConfigError::DutySteps(spec.duty_steps));
        }
        if spec.reversal_rest_ticks > spec.reversal_limit_ticks {
            return Err(ConfigError::Reversal);
        }
        let model = match spec.law {
            DriveLaw::Gated => model::Model::of(&spec).ok_or(ConfigError::Rotor)?,
            DriveLaw::ActiveLowTruncated | DriveLaw::OnTimeRounded => model::Model::default(),
        };
        let admittance = match spec.law {
            DriveLaw::Gated => guide::Admittance::of(&spec, &model).ok_or(ConfigError::Guide)?,
            _ if spec.guide.limit_counts > 0 => return Err(ConfigError::Guide),
            _ => guide::Admittance::default(),
        };
        // At most 10 000 µs: below 2^26.
        let rate_of_one = ((u64::from(spec.period_us) << 32) / 1_000_000) as u32;
        Ok(Self { spec, model, admittance, rate_of_one })
    }
}

/// What the controller remembers between ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct State {
    /// Sum of the error over the ticks, count·ticks, inside the configured limits.
    pub integral: i32,
    /// Error of the last tick, counts.
    pub previous_error: i32,
    /// Direction of the last drive.
    pub direction: Direction,
    /// What a change of the direction waits for, where the controller waits.
    pub reversal: Reversal,
    /// Where a law that has a model of the rotor believes it to be.
    pub rotor: Rotor,
    /// How far a target that gives way is off its path, 2^-20 count.
    pub deviation: i32,
}

impl State {
    /// A controller that has seen nothing.
    pub const REST: Self = Self {
        integral: 0,
        previous_error: 0,
        direction: Direction::Ccw,
        reversal: Reversal::REST,
        rotor: Rotor::REST,
        deviation: 0,
    };

    /// The load that a guided controller believes the rotor to bear, clockwise, nN·m; none where the estimate is worth nothing.
    pub fn load_nnm(&self, config: &Config) -> Option<i32> {
        let push = self.rotor.load.worth(self.rotor.braking).filter(|_| config.admittance.is_on())?;
        let torque =
            i64::from(push) * i64::from(config.spec.guide.braking_nnm) / i64::from(config.model.braking.max(1));
        Some(torque.clamp(i32::MIN.into(), i32::MAX.into()) as i32)
    }
}

/// What a tick sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Inputs {
    /// Wanted position, counts.
    pub target: i32,
    /// Rate of the wanted position, counts/s.
    pub target_rate: i32,
    /// Measured position, counts.
    pub position: i32,
    /// What the wanted position lies beyond its whole counts, 1/128 count.
    pub target_fraction: i8,
    /// How long ago the last edge came, µs; at its limit for one that is older.
    pub edge_age_us: u16,
}

/// What a tick decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Outputs {
    /// Control signal, signed duty steps in Q16.16, saturated.
    pub u: i32,
    /// Steps of the PWM period with the drive on, 0..=`duty_steps`.
    pub on_steps: u16,
    /// Direction of the drive.
    pub direction: Direction,
}

impl Outputs {
    /// The duty for an output stage.
    pub const fn duty(&self, config: &Config) -> Duty {
        Duty::from_ratio(self.on_steps, config.spec.duty_steps)
    }
}

/// One tick of the controller. Pure; no input overflows or panics.
///
/// Gains are exact to 2^-33, so the sum is rounded to the nearest 2^-24 before the duty is formed: products that are
/// whole numbers in decimal (1.3 × 10) are then whole numbers here too, and truncation falls as it does in the thesis's
/// doubles.
#[inline]
pub fn step(config: &Config, state: &mut State, inputs: Inputs) -> Outputs {
    let spec = &config.spec;
    if spec.law == DriveLaw::Gated {
        return gated::gated(config, state, &inputs);
    }
    let error = inputs.target.saturating_sub(inputs.position).clamp(-ERROR_LIMIT, ERROR_LIMIT);
    let difference = error - state.previous_error.clamp(-ERROR_LIMIT, ERROR_LIMIT);
    state.previous_error = error;

    let resting = inputs.target_rate == 0
        && error.unsigned_abs() <= u32::from(spec.dead_band_counts)
        && spec.dead_band_counts > 0;
    if resting {
        if spec.reversal_rest_ticks > 0 {
            state.reversal.waits(spec, inputs.position);
        }
        return Outputs { u: 0, on_steps: 0, direction: state.direction };
    }

    // `clamp` would keep a panic for limits out of order, which a validated configuration has not.
    let limited = |integral: i32| integral.max(spec.integral_min).min(spec.integral_max);
    let integral = limited(state.integral.saturating_add(error));
    let mut without_integral = product(spec.kp.to_bits(), error) + product(spec.kd_tick.to_bits(), difference);
    if spec.feed_forward != I32F32::ZERO {
        let rate = inputs.target_rate.clamp(-RATE_LIMIT, RATE_LIMIT);
        without_integral += product(spec.feed_forward.to_bits(), rate);
    }
    let sum = |integral| without_integral + (product(spec.ki_tick.to_bits(), integral) >> 16);
    let mut signal = sum(integral);
    let beyond = beyond_full_drive(spec.duty_steps);
    let winds_up =
        spec.conditional_integration && if error > 0 { signal >= beyond } else { error < 0 && signal <= -beyond };
    if winds_up {
        signal = sum(limited(state.integral));
    } else {
        state.integral = integral;
    }
    let u = rounded_q24(signal);

    // What the law adds before it cuts the fraction off: half a step rounds; a step less 2^-24 is the next whole one, as
    // cutting the high time makes it, and one step more is the one that the thesis leaves on.
    let bias = match spec.law {
        DriveLaw::ActiveLowTruncated => (2 << 24) - 1,
        DriveLaw::OnTimeRounded | DriveLaw::Gated => 1 << 23,
    };
    let on = if u < 0 { bias - u } else { bias + u };
    // |u| stays below 2^55, so its whole steps fit 32 bits.
    let mut on_steps = ((on >> 24) as u32).min(u32::from(spec.duty_steps)) as u16;
    let wanted = if u > 0 { Direction::Cw } else { Direction::Ccw };
    if spec.reversal_rest_ticks > 0 {
        let along = on_steps > 0 && wanted == state.direction;
        if !along && !state.reversal.waits(spec, inputs.position) {
            on_steps = 0;
        }
        if on_steps > 0 {
            state.reversal.drives(spec, inputs.position);
        }
    }
    // The truncating law is never off, so it always turns the way of u.
    let direction = if on_steps > 0 { wanted } else { state.direction };
    state.direction = direction;
    Outputs { u: q16(u), on_steps, direction }
}

/// `gain × whole`, raw. Gains are below 2^42 in Q32 and errors at most 2^18 (a difference of two, 2^19), so three products
/// together stay below 2^62; the integral's, checked with the configuration, is below 2^62 in Q48 and 2^46 in Q32.
fn product(gain: i64, whole: i32) -> i64 {
    // By halves: 32-bit multipliers do it in three multiplications.
    let low = i64::from(gain as u32) * i64::from(whole);
    let high = ((gain >> 32) as i32).wrapping_mul(whole);
    low.wrapping_add(i64::from(high) << 32)
}

/// The first sum that rounds to more than full drive; its negative is the first of the other direction.
const fn beyond_full_drive(duty_steps: u16) -> i64 {
    (duty_steps as i64) << 32 | 128
}

/// Q32 to Q24, to nearest, halves away from zero, so that both directions round alike.
fn rounded_q24(q32: i64) -> i64 {
    // Cutting rounds down: a negative half must land just below the half that would round it up.
    (q32 + i64::from(128 - u32::from(q32 < 0))) >> 8
}

/// Q24 to Q16, saturated.
fn q16(q24: i64) -> i32 {
    match (q24 >> 32) as i32 {
        -128..=127 => (q24 >> 8) as i32,
        beyond => {
            if beyond < 0 {
                i32::MIN
            } else {
                i32::MAX
            }
        }
    }
}

#[cfg(test)]
mod tests;
