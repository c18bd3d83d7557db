//! Everything that an effect can change in the rotor equation.

use std::sync::Arc;
use twum_motor::hypothesis::{Hypothesis, MOST_NUMBERS};

/// Number of scalar parameters, see [`P`].
pub const PARAMETERS: usize = P::ALL.len();

/// One scalar parameter of the rotor equation. The first ones are the baseline's own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(usize)]
pub enum P {
    /// Free speed under drive in rad/s (the force factor sets it).
    FreeSpeed,
    /// Drive torque over inertia in rad/s² (contact friction sets it).
    OnAcceleration,
    /// Braking torque with the wave off over inertia in rad/s² (off-phase friction).
    OffDeceleration,
    /// Time in which the stator's wave builds up and dies away, in s, from the motor file (2·Ms/Cs): a crest that is faster than
    /// the rotor goes on driving it after a fall, one that is slower holds it back.
    WaveTime,
    /// Time in which the wave dies away over the one in which it builds up: a driver leaves the stator shorted or open.
    Dying,
    /// Share of its full height from which the wave carries the rotor: below, the rotor lies on the stator and is braked.
    Lift,
    /// Share of the drive's torque with which the wave holds back a rotor that is faster than its crest.
    Ahead,
    /// Distance of the drive from the stator's resonance, in half-widths of it.
    Detuning,
    /// Viscous damping over inertia in 1/s.
    Viscous,
    /// Common delay of the record behind the drive in s (a nuisance, not physics).
    Latency,
    /// Pitches by which the first edge is late where the rotor last turned the other way: the comparator's hysteresis (a nuisance).
    Hysteresis,
    /// Width of the slip band as a fraction of the free speed (contact stiffness and exponent).
    SlipBand,
    /// `resonance-heating`: speed lost when warm, as a fraction at full duty.
    HeatLoss,
    /// `resonance-heating`: relative change of the friction when warm, under the wave and without it.
    HeatFriction,
    /// `resonance-heating`: thermal time constant in s.
    HeatTau,
    /// `resonance-heating`: share of the warmth that survives until the next run.
    HeatCarry,
    /// `frequency-settling`: relative speed excess at the start of a drive.
    SettleExcess,
    /// `frequency-settling`: time constant in s.
    SettleTau,
    /// `dead-zone`: duty below which nothing moves.
    DeadDuty,
    /// `start-delay`: delay of the wave after each PWM rise, in s.
    StartDelay,
    /// `start-delay`: rest in s after which nearly two thirds of the delay are there; 0 if all of it always is.
    DelayRest,
    /// `duty-quantisation`: how much of the rounding error acts (1 = all of it).
    QuantShare,
    /// `duty-quantisation`: number of duty steps.
    QuantSteps,
    /// `duty-quantisation`: 0 rounds to the nearest step, 1 to the one below.
    QuantDown,
    /// `high-duty-saturation`: 1/us.
    Saturation,
    /// `contact-stiffening`: addition to the slip band.
    SlipExtra,
    /// `contact-stiffening`: exponent n of the contact's force: half the slip band gives ½ⁿ of the torque.
    SlipExponent,
    /// `direction-asymmetry`: relative speed difference, half of cw minus ccw.
    AsymSpeed,
    /// `direction-asymmetry`: relative difference of the friction, under the wave and without it, half of cw minus ccw.
    AsymFriction,
    /// `direction-asymmetry`: relative difference of the braking without a wave alone, half of cw minus ccw.
    AsymBrake,
    /// `clock-error`: relative error of the recorder's clock.
    ClockError,
    /// `unequal-edges`: excess of the high slots as a fraction of a pitch.
    EdgeOffset,
    /// `stribeck-friction`: extra friction at rest, as a share of what the contact has under drive.
    Stribeck,
    /// `stribeck-friction`: Stribeck speed in rad/s.
    StribeckSpeed,
    /// `supply-sag`: relative speed lost at full duty.
    Sag,
    /// `supply-sag`: time in s in which the supply gives way and recovers.
    SagTime,
    /// `run-in-wear`: relative speed change per unit of log(1 + revs/r0).
    Wear,
    /// `run-in-wear`: relative speed change once run in, by 1 − exp(−revs/r0).
    WearRunIn,
    /// `run-in-wear`: the same of the friction, under the wave and without it.
    WearFriction,
    /// `run-in-wear`: r0 in revolutions.
    WearRevolutions,
    /// `backlash`: lost motion at a reversal, in rad.
    Backlash,
    /// `reversal-miscount`: counts gained at a reversal, in the new sense.
    Miscount,
    /// `reversal-miscount`: counts gained at every reversal whatever its sense.
    MiscountDrift,
    /// `dead-zone`: duty below which the drive is gated off; above it, all of it acts.
    GateDuty,
    /// `dead-zone`: how softly the gate opens, in duty.
    GateWidth,
    /// `high-duty-saturation`: bend, u/(1 + bend·u^p).
    Bend,
    /// `high-duty-saturation`: relative speed lost at full duty, as u^p.
    BendLoss,
    /// `high-duty-saturation`: the power p of a bend.
    BendPower,
    /// `high-duty-saturation`: what of the duty beyond 1 − `FlatFrom` is lost.
    FlatTop,
    /// `clock-error`: change of the clock's relative error a second, at first.
    ClockDrift,
    /// `clock-error`: time constant in s with which that change dies away (0: it does not).
    ClockTau,
    /// `frequency-settling`: 1 where it counts the time of the drive, 0 where it counts time.
    SettleOnTime,
    /// `off-phase-braking`: share of the friction without a wave that is missing.
    OffLoss,
    /// `preload-runout`: how much of it acts on the speed of the wave (1 = all).
    RunoutSpeed,
    /// `preload-runout`: how much of it acts on the drive's torque.
    RunoutTorque,
    /// `preload-runout`: how much of it acts on the braking without a wave.
    RunoutBrake,
    /// The numbers of the effects that are formulas, one effect after the other.
    Formula0,
    /// Number 2 of these.
    Formula1,
    /// Number 3 of these.
    Formula2,
    /// Number 4 of these.
    Formula3,
    /// Number 5 of these.
    Formula4,
    /// Number 6 of these.
    Formula5,
    /// Number 7 of these.
    Formula6,
    /// Number 8 of these.
    Formula7,
    /// Number 9 of these.
    Formula8,
    /// Number 10 of these.
    Formula9,
    /// Number 11 of these.
    Formula10,
    /// Number 12 of these.
    Formula11,
    /// Number 13 of these.
    Formula12,
    /// Number 14 of these.
    Formula13,
    /// Number 15 of these.
    Formula14,
    /// Number 16 of these.
    Formula15,
}

impl P {
    /// All parameters in index order.
    pub const ALL: [P; 72] = [
        P::FreeSpeed,
        P::OnAcceleration,
        P::OffDeceleration,
        P::WaveTime,
        P::Dying,
        P::Lift,
        P::Ahead,
        P::Detuning,
        P::Viscous,
        P::Latency,
        P::Hysteresis,
        P::SlipBand,
        P::HeatLoss,
        P::HeatFriction,
        P::HeatTau,
        P::HeatCarry,
        P::SettleExcess,
        P::SettleTau,
        P::DeadDuty,
        P::StartDelay,
        P::DelayRest,
        P::QuantShare,
        P::QuantSteps,
        P::QuantDown,
        P::Saturation,
        P::SlipExtra,
        P::SlipExponent,
        P::AsymSpeed,
        P::AsymFriction,
        P::AsymBrake,
        P::ClockError,
        P::EdgeOffset,
        P::Stribeck,
        P::StribeckSpeed,
        P::Sag,
        P::SagTime,
        P::Wear,
        P::WearRunIn,
        P::WearFriction,
        P::WearRevolutions,
        P::Backlash,
        P::Miscount,
        P::MiscountDrift,
        P::GateDuty,
        P::GateWidth,
        P::Bend,
        P::BendLoss,
        P::BendPower,
        P::FlatTop,
        P::ClockDrift,
        P::ClockTau,
        P::SettleOnTime,
        P::OffLoss,
        P::RunoutSpeed,
        P::RunoutTorque,
        P::RunoutBrake,
        P::Formula0,
        P::Formula1,
        P::Formula2,
        P::Formula3,
        P::Formula4,
        P::Formula5,
        P::Formula6,
        P::Formula7,
        P::Formula8,
        P::Formula9,
        P::Formula10,
        P::Formula11,
        P::Formula12,
        P::Formula13,
        P::Formula14,
        P::Formula15,
    ];

    /// Those by which the actuator path changes a commanded duty, and nothing else: [`super::effective_duty`].
    pub const OF_THE_DUTY: [P; 9] = [
        P::DeadDuty,
        P::QuantShare,
        P::QuantSteps,
        P::QuantDown,
        P::Saturation,
        P::GateDuty,
        P::GateWidth,
        P::Bend,
        P::FlatTop,
    ];

    /// The numbers of the effects that are formulas, the last of all: four of four numbers each, or more with fewer.
    pub const FORMULA: &'static [P] = Self::ALL.split_at(P::Formula0 as usize).1;
}

/// Effects that are formulas, each with the parameters that hold its numbers; there are enough for [`P::FORMULA`]'s length together.
pub fn placed(formulas: &[Arc<Hypothesis>]) -> impl Iterator<Item = (&Arc<Hypothesis>, &'static [P])> {
    let mut from = 0;
    formulas.iter().map(move |hypothesis| {
        let to = from + hypothesis.numbers.len();
        (hypothesis, P::FORMULA.get(std::mem::replace(&mut from, to)..to).unwrap_or_default())
    })
}

/// Values of all parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameters([f64; PARAMETERS]);

impl Parameters {
    /// A rotor with no effect present.
    pub fn new(free_speed: f64, on_acceleration: f64, off_deceleration: f64, viscous: f64, slip_band: f64) -> Self {
        let mut p = Self([0.0; PARAMETERS]);
        p.set(P::FreeSpeed, free_speed);
        p.set(P::OnAcceleration, on_acceleration);
        p.set(P::OffDeceleration, off_deceleration);
        p.set(P::Viscous, viscous);
        p.set(P::SlipBand, slip_band);
        p.set(P::Dying, 1.0);
        p.set(P::Ahead, 1.0);
        p.set(P::HeatTau, 1.0);
        p.set(P::SettleTau, 0.03);
        p.set(P::QuantSteps, 32.0);
        p.set(P::SlipExponent, 1.0);
        p.set(P::SagTime, 0.01);
        p.set(P::StribeckSpeed, 0.5);
        p.set(P::WearRevolutions, 1.0);
        p.set(P::GateWidth, 0.02);
        p.set(P::BendPower, 2.0);
        p.set(P::RunoutSpeed, 1.0);
        p.set(P::RunoutTorque, 1.0);
        p
    }

    /// The value of one parameter.
    pub fn get(&self, p: P) -> f64 {
        self.0[p as usize]
    }

    /// Whether anything changes as the motor warms.
    pub fn warms(&self) -> bool {
        self.get(P::HeatLoss) != 0.0 || self.get(P::HeatFriction) != 0.0
    }

    /// Deceleration without a wave in rad/s², what is missing of the friction taken off.
    pub fn off_deceleration(&self) -> f64 {
        self.get(P::OffDeceleration) * (1.0 - self.get(P::OffLoss))
    }

    /// Values of a formula's numbers.
    pub fn of_formula(&self, places: &[P]) -> [f64; MOST_NUMBERS] {
        let mut values = [0.0; MOST_NUMBERS];
        values.iter_mut().zip(places).for_each(|(value, place)| *value = self.get(*place));
        values
    }

    /// Sets one parameter.
    pub fn set(&mut self, p: P, value: f64) {
        self.0[p as usize] = value;
    }

    /// The same values with one changed.
    pub fn with(&self, p: P, value: f64) -> Self {
        let mut other = self.clone();
        other.set(p, value);
        other
    }
}

/// Harmonics of a turn in which a runout or an eccentric wheel may act.
pub const HARMONICS: usize = 4;

/// `Σ a_k·cos(kθ) + b_k·sin(kθ)` of interleaved coefficients.
pub(super) fn harmonics(coefficients: &[f64; 2 * HARMONICS], theta: f64) -> f64 {
    let (s, c) = theta.sin_cos();
    let (mut sk, mut ck) = (s, c);
    let mut sum = 0.0;
    for pair in coefficients.chunks_exact(2) {
        sum += pair[0] * ck + pair[1] * sk;
        (ck, sk) = (ck * c - sk * s, sk * c + ck * s);
    }
    sum
}

/// What belongs to one run alone: rotor angle is unknown between runs, so angle-dependent effects have a phase a run.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RunTerms {
    /// Drive modulation: cosine and sine of θ, 2θ, 3θ, 4θ (relative).
    pub runout: [f64; 2 * HARMONICS],
    /// Encoder angle error: cosine and sine of θ, 2θ, 3θ, 4θ in rad.
    pub eccentricity: [f64; 2 * HARMONICS],
    /// Load torque: cos θ, sin θ coefficients, as a share of the drive's torque.
    pub gravity: [f64; 2],
}
