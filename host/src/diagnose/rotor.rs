//! The rotor equation the diagnosis searches with: drive phases, a saturating drive torque, Coulomb braking.
//!
//! It is the averaged motor model reduced once more. Between two switching instants the drive pulls the rotor towards the
//! free speed of the wave with a torque that is constant (friction is saturated) until the speed comes within a slip band of
//! the wave's, and proportional inside the band; with the wave off, Coulomb friction brakes. Both have closed forms, so
//! a run is stepped from event to event, without a truncation error and thousands of times faster than real time.
//!
//! Everything an effect of the library can change is a parameter here, with the value 0 for "absent".

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
    /// How long the dying wave brakes with the drive's own torque after each fall of the drive, in s: all the braking a
    /// coasting rotor has.
    RingDown,
    /// Time in which the stator's wave builds up and dies away, in s, from the motor file (2·Ms/Cs): a crest that is faster than
    /// the rotor goes on driving it after a fall, one that is slower goes on braking it after a rise.
    WaveTime,
    /// Viscous damping over inertia in 1/s.
    Viscous,
    /// Common delay of the record behind the drive in s (a nuisance, not physics).
    Latency,
    /// Width of the slip band as a fraction of the free speed (contact stiffness and exponent).
    SlipBand,
    /// `resonance-heating`: speed lost when warm, as a fraction at full duty.
    HeatLoss,
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
    /// `duty-quantisation`: how much of the rounding error acts (1 = all of it).
    QuantShare,
    /// `duty-quantisation`: number of duty steps.
    QuantSteps,
    /// `high-duty-saturation`: 1/us.
    Saturation,
    /// `contact-stiffening`: addition to the slip band.
    SlipExtra,
    /// `direction-asymmetry`: relative speed difference, half of cw minus ccw.
    AsymSpeed,
    /// `direction-asymmetry`: relative braking difference, half of cw minus ccw.
    AsymBrake,
    /// `clock-error`: relative error of the recorder's clock.
    ClockError,
    /// `unequal-edges`: excess of the high slots as a fraction of a pitch.
    EdgeOffset,
    /// `stribeck-friction`: extra friction at rest over inertia in rad/s².
    StribeckDeceleration,
    /// `stribeck-friction`: Stribeck speed in rad/s.
    StribeckSpeed,
    /// `supply-sag`: relative speed lost at full duty.
    Sag,
    /// `supply-sag`: time in s in which the supply gives way and recovers.
    SagTime,
    /// `run-in-wear`: relative speed change per unit of log(1 + revs/r0).
    Wear,
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
    /// `high-duty-saturation`: quadratic bend, u/(1 + bend·u²).
    Bend,
    /// `high-duty-saturation`: what of the duty beyond 1 − `FlatFrom` is lost.
    FlatTop,
    /// `clock-error`: change of the clock's relative error a second.
    ClockDrift,
    /// `frequency-settling`: 1 where it counts the time of the drive, 0 where it counts time.
    SettleOnTime,
    /// `preload-runout`: how much of it acts on the speed of the wave (1 = all).
    RunoutSpeed,
    /// `preload-runout`: how much of it acts on the drive's torque.
    RunoutTorque,
    /// `preload-runout`: how much of it acts on the braking without a wave.
    RunoutBrake,
}

impl P {
    /// All parameters in index order.
    pub const ALL: [P; 41] = [
        P::FreeSpeed,
        P::OnAcceleration,
        P::OffDeceleration,
        P::RingDown,
        P::WaveTime,
        P::Viscous,
        P::Latency,
        P::SlipBand,
        P::HeatLoss,
        P::HeatTau,
        P::HeatCarry,
        P::SettleExcess,
        P::SettleTau,
        P::DeadDuty,
        P::StartDelay,
        P::QuantShare,
        P::QuantSteps,
        P::Saturation,
        P::SlipExtra,
        P::AsymSpeed,
        P::AsymBrake,
        P::ClockError,
        P::EdgeOffset,
        P::StribeckDeceleration,
        P::StribeckSpeed,
        P::Sag,
        P::SagTime,
        P::Wear,
        P::WearRevolutions,
        P::Backlash,
        P::Miscount,
        P::MiscountDrift,
        P::GateDuty,
        P::GateWidth,
        P::Bend,
        P::FlatTop,
        P::ClockDrift,
        P::SettleOnTime,
        P::RunoutSpeed,
        P::RunoutTorque,
        P::RunoutBrake,
    ];
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
        p.set(P::HeatTau, 1.0);
        p.set(P::SettleTau, 0.03);
        p.set(P::QuantSteps, 32.0);
        p.set(P::SagTime, 0.01);
        p.set(P::StribeckSpeed, 0.5);
        p.set(P::WearRevolutions, 1.0);
        p.set(P::GateWidth, 0.02);
        p.set(P::RunoutSpeed, 1.0);
        p.set(P::RunoutTorque, 1.0);
        p
    }

    /// The value of one parameter.
    pub fn get(&self, p: P) -> f64 {
        self.0[p as usize]
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
fn harmonics(coefficients: &[f64; 2 * HARMONICS], theta: f64) -> f64 {
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
    /// Load torque over inertia: cos θ, sin θ coefficients in rad/s².
    pub gravity: [f64; 2],
}

impl RunTerms {
    /// Angle that the encoder reads too far at a measured angle, in rad.
    pub fn encoder_error(&self, measured: f64) -> f64 {
        harmonics(&self.eccentricity, measured)
    }
}

/// One PWM period, or any stretch of time with one duty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Period {
    /// Start and end in s; drive is in the last `duty` fraction.
    pub start: f64,
    /// End in s.
    pub end: f64,
    /// Fraction of the period with drive on.
    pub duty: f64,
}

/// How a run was driven.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Schedule {
    /// PWM periods in time order; the drive is off before the first and after the last.
    pub periods: Vec<Period>,
    /// Direction pin: sign from this time on, in time order, first at or before the first period.
    pub directions: Vec<(f64, f64)>,
}

impl Schedule {
    /// Constant duty and direction from 0 to `on_s`, periods of `1/pwm_hz`, `phase_s` into a period at t = 0.
    pub fn constant(duty: f64, direction: f64, pwm_hz: f64, phase_s: f64, on_s: f64) -> Self {
        let period = 1.0 / pwm_hz;
        let mut periods = Vec::with_capacity((on_s / period) as usize + 2);
        let mut k = 0;
        loop {
            let start = k as f64 * period - phase_s.rem_euclid(period);
            if start >= on_s || duty <= 0.0 {
                break;
            }
            periods.push(Period { start, end: start + period, duty });
            k += 1;
        }
        Self { periods, directions: vec![(0.0, direction)] }
    }

    /// Share of the time between two instants that lies within the millisecond `after_s` behind a rise of the drive, or (`false`) a fall.
    pub fn share_after_switching(&self, [from, to]: [f64; 2], rise: bool, after_s: f64, p: &Parameters) -> f64 {
        let latency = p.get(P::Latency);
        let (from, to) = (from - latency, to - latency);
        let first = self.periods.partition_point(|k| k.end + 0.01 < from);
        let inside = self.periods[first..].iter().take_while(|k| k.start < to).filter_map(|k| {
            let duty = effective_duty(k.duty, p);
            let rises = k.end - duty * (k.end - k.start) + p.get(P::StartDelay);
            (duty > 0.0 && rises > k.start).then_some(if rise { rises } else { k.end })
        });
        let overlap = |at: f64| ((at + 1e-3).min(to) - at.max(from)).max(0.0);
        inside.map(|switched| overlap(switched + after_s)).sum::<f64>() / (to - from).max(1e-9)
    }

    /// Total time with drive on, in s, up to `until`.
    pub fn drive_time(&self) -> f64 {
        self.periods.iter().map(|p| (p.end - p.start) * p.duty).sum()
    }
}

/// What a simulation of one run needs beside the parameters.
#[derive(Debug, Clone)]
pub struct RunInput<'a> {
    /// The drive.
    pub schedule: &'a Schedule,
    /// Drive is off from here on, in s (cuts the last period).
    pub drive_end: f64,
    /// Measured times in s, ascending, at which the angle is wanted.
    pub times: &'a [f64],
    /// Half a sampling period in s (0 for times that are exact): an edge was somewhere in the period around its time.
    pub half_sample_s: f64,
    /// Measured angle at these times in rad (angle-dependent effects read it).
    pub angles: &'a [f64],
    /// Warmth carried into this run, 0..1.
    pub warmth: f64,
    /// Revolutions made before this run.
    pub revolutions: f64,
}

/// Wave times after which the crest is full to a few thousandths.
const WAVE_GONE: f64 = 5.0;
/// First step after a rise, and how later ones grow with the time since, in wave times.
const RISE_STEP: f64 = 0.3;
const RISE_GROWTH: f64 = 0.5;

/// What the drive asks of the wave.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Wanted {
    /// No wave.
    Off,
    /// A wave at its full height.
    On,
    /// A wave that builds up since a rise, when a share of its height was missing.
    Rising { since: f64, missing: f64 },
}

struct State {
    t: f64,
    angle: f64,
    speed: f64,
}

/// Rotor angle in rad at every measured time, and the rotor speed there in rad/s.
///
/// An edge that was seen between two samples lies, its place on the wheel being unknown, anywhere between the rotor's angles at
/// the two with equal probability: what a measured time stands for is their mean, not the angle in the middle of the period. The
/// two differ wherever the rotor starts or stops, thousands of times a run.
pub fn simulate(input: &RunInput, p: &Parameters, terms: &RunTerms, angle: &mut Vec<f64>, speed: &mut Vec<f64>) {
    angle.clear();
    speed.clear();
    let clock = 1.0 + p.get(P::ClockError);
    let latency = p.get(P::Latency);
    // Asked for on both sides of every time; put together at the end.
    let half = input.half_sample_s;
    let sided = |q: usize| input.times[q / 2] + if q.is_multiple_of(2) { -half } else { half };
    let drift = p.get(P::ClockDrift);
    let true_time = |q: usize| {
        let t = if half > 0.0 { sided(q) } else { input.times[q] } - latency;
        // t_recorded = (1 + ε + drift·t/2)·t, solved to first order in the drift.
        t / (clock + 0.5 * drift * t)
    };
    let count = if half > 0.0 { 2 * input.times.len() } else { input.times.len() };
    let mut next = 0;
    let mut warmth = input.warmth;
    let heat_loss = p.get(P::HeatLoss);
    let heat_tau = p.get(P::HeatTau).max(1e-3);
    let settle = p.get(P::SettleExcess);
    let settle_tau = p.get(P::SettleTau).max(1e-4);
    let wear = p.get(P::Wear) * (1.0 + input.revolutions / p.get(P::WearRevolutions).max(1e-6)).ln();
    let wear_slope = p.get(P::Wear);
    let wear_r0 = p.get(P::WearRevolutions).max(1e-6);
    let sag = p.get(P::Sag);
    let sag_time = p.get(P::SagTime).max(1e-4);
    let mut sagged = 0.0;
    let settle_on_time = p.get(P::SettleOnTime) > 0.5;
    let mut on_time = 0.0;
    let [runout_speed, runout_torque, runout_brake] =
        [P::RunoutSpeed, P::RunoutTorque, P::RunoutBrake].map(|k| p.get(k));
    let free_speed = p.get(P::FreeSpeed);
    let on_acceleration = p.get(P::OnAcceleration).max(1.0);
    let band_fraction = (p.get(P::SlipBand) + p.get(P::SlipExtra)).max(1e-3);
    let viscous = p.get(P::Viscous);
    let off_brake = p.get(P::OffDeceleration).max(0.0);
    let ring_down = p.get(P::RingDown).max(0.0);
    let wave_time = p.get(P::WaveTime).max(0.0);
    let mut wave = Wave { tau: wave_time, full: free_speed, rate: on_acceleration, crest: 0.0, since: 0.0 };
    let stribeck = p.get(P::StribeckDeceleration);
    let stribeck_speed = p.get(P::StribeckSpeed).max(1e-3);
    let has_angle = terms.runout.iter().chain(&terms.gravity).any(|c| *c != 0.0);
    let mut step_limit: f64 = 0.02;
    if settle != 0.0 {
        step_limit = step_limit.min(settle_tau * 0.3).max(1e-3);
    }
    if has_angle {
        step_limit = step_limit.min(4e-3);
    }
    if viscous != 0.0 {
        step_limit = step_limit.min(0.02 / viscous.max(1e-9)).max(5e-4);
    }
    if sag != 0.0 {
        step_limit = step_limit.min(0.25 * sag_time).max(5e-4);
    }
    if stribeck != 0.0 {
        step_limit = 2.5e-4;
    }
    let mut measured = 0;
    let mut state = State { t: 0.0, angle: 0.0, speed: 0.0 };
    let mut direction_index = 0;
    let directions = &input.schedule.directions;

    // Advances to `until` with the drive on or off, answering queries on the way.
    let mut advance = |state: &mut State, until: f64, drive: Wanted, brake: f64, warmth: f64, next: &mut usize| {
        let on = drive != Wanted::Off;
        while state.t < until - 1e-12 && *next < count {
            while direction_index + 1 < directions.len() && directions[direction_index + 1].0 <= state.t + 1e-12 {
                direction_index += 1;
            }
            let sign = directions.get(direction_index).map_or(1.0, |d| d.1);
            let mut end = until.min(state.t + step_limit);
            let mut crest = 1.0;
            if let Wanted::Rising { since, missing } = drive {
                // Steps that grow with the time since the rise: the crest moves less and less.
                let age = state.t - since;
                if age < WAVE_GONE * wave_time {
                    end = end.min(state.t + (RISE_STEP * wave_time).max(RISE_GROWTH * age));
                    crest = 1.0 - missing * (-(0.5 * (state.t + end) - since) / wave_time).exp();
                }
            }
            if let Some(d) = directions.get(direction_index + 1) {
                end = end.min(d.0);
            }
            let mut external = -viscous * state.speed;
            let mut modulation = 0.0;
            if has_angle {
                let now = state.t * clock + latency;
                while measured + 1 < input.times.len() && input.times[measured + 1] <= now {
                    measured += 1;
                }
                let theta = input.angles[measured];
                let (s, c) = theta.sin_cos();
                modulation = harmonics(&terms.runout, theta);
                external += terms.gravity[0] * c + terms.gravity[1] * s;
            }
            if stribeck != 0.0 {
                let x = state.speed / stribeck_speed;
                let sense = if state.speed != 0.0 { state.speed.signum() } else { sign };
                let grip = stribeck * (-x * x).exp();
                external -= if on || state.speed != 0.0 { sense * grip } else { 0.0 };
            }
            let brake = brake * (1.0 + sign * p.get(P::AsymBrake) + runout_brake * modulation).max(0.0);
            let mut target = 0.0;
            let mut acceleration = on_acceleration;
            if on {
                let mut gain = 1.0 - heat_loss * warmth + sign * p.get(P::AsymSpeed) + runout_speed * modulation + wear;
                if wear_slope != 0.0 {
                    let revs = input.revolutions + state.angle.abs() / std::f64::consts::TAU;
                    gain += wear_slope * ((1.0 + revs / wear_r0) / (1.0 + input.revolutions / wear_r0)).ln();
                }
                if sag != 0.0 {
                    let middle = 1.0 - (1.0 - sagged) * (-0.5 * (end - state.t) / sag_time).exp();
                    gain -= sag * middle;
                }
                if settle != 0.0 {
                    let middle = 0.5 * (end - state.t);
                    let since = if settle_on_time { on_time } else { state.t };
                    gain += settle * (-(since + middle) / settle_tau).exp();
                }
                on_time += end - state.t;
                target = sign * free_speed * gain.max(0.0) * crest;
                acceleration *= (1.0 + runout_torque * modulation).max(0.01);
            }
            if sag != 0.0 {
                let drive = if on { 1.0 } else { 0.0 };
                sagged = drive + (sagged - drive) * (-(end - state.t) / sag_time).exp();
            }
            let band = (band_fraction * target.abs()).max(1e-6);
            while state.t < end - 1e-12 && *next < count {
                let piece = if on {
                    on_piece(state.speed, target, acceleration, band, external)
                } else {
                    off_piece(state.speed, brake, external)
                };
                let stop = (state.t + piece.duration.max(1e-9)).min(end);
                while *next < count {
                    let tq = true_time(*next);
                    if tq > stop {
                        break;
                    }
                    let (a, w) = piece.at(state.speed, (tq - state.t).max(0.0));
                    angle.push(state.angle + a);
                    speed.push(w);
                    *next += 1;
                }
                let (a, w) = piece.at(state.speed, stop - state.t);
                state.angle += a;
                state.speed = w;
                state.t = stop;
            }
        }
    };

    for period in &input.schedule.periods {
        if period.start >= input.drive_end || next >= count {
            break;
        }
        let length = period.end - period.start;
        let duty = effective_duty(period.duty, p);
        let mut on_from = period.end - duty * length;
        if duty < 1.0 - 1e-9 {
            on_from += p.get(P::StartDelay);
        } else if period.start <= 0.0 {
            on_from = on_from.max(0.0) + p.get(P::StartDelay);
        }
        let on_from = on_from.clamp(period.start, period.end).min(input.drive_end);
        let off_until = period.end.min(input.drive_end);
        if on_from > period.start + 1e-9 {
            let overrun = wave.overrun_s(period.start, state.speed);
            advance(&mut state, on_from.min(period.start + overrun), Wanted::On, off_brake, warmth, &mut next);
            if ring_down > 0.0 && duty < 1.0 - 1e-9 {
                let dying = period.start + overrun + ring_down;
                advance(&mut state, on_from.min(dying), Wanted::Off, on_acceleration, warmth, &mut next);
            }
            advance(&mut state, on_from, Wanted::Off, off_brake, warmth, &mut next);
        }
        if duty > 0.0 {
            let missing = wave.missing(on_from);
            let drive = if wave_time > 0.0 && missing > 1e-3 { Wanted::Rising { since: on_from, missing } } else { Wanted::On };
            wave.rise(on_from, off_until);
            advance(&mut state, off_until, drive, off_brake, warmth, &mut next);
        }
        if heat_loss != 0.0 {
            warmth = duty + (warmth - duty) * (-length / heat_tau).exp();
        }
    }
    if next < count {
        let last = true_time(count - 1).max(state.t) + 1e-6;
        let overrun = wave.overrun_s(state.t, state.speed);
        let overrun_end = last.min(state.t + overrun);
        advance(&mut state, overrun_end, Wanted::On, off_brake, warmth, &mut next);
        if ring_down > 0.0 {
            let dying = last.min(state.t + ring_down);
            advance(&mut state, dying, Wanted::Off, on_acceleration, warmth, &mut next);
        }
        advance(&mut state, last, Wanted::Off, off_brake, warmth, &mut next);
    }
    // Times before the start of the drive, or after numerical ties.
    while angle.len() < count {
        angle.push(state.angle);
        speed.push(state.speed);
    }
    if half > 0.0 {
        for k in 0..input.times.len() {
            angle[k] = 0.5 * (angle[2 * k] + angle[2 * k + 1]);
            speed[k] = 0.5 * (speed[2 * k] + speed[2 * k + 1]);
        }
        angle.truncate(input.times.len());
        speed.truncate(input.times.len());
    }
}

/// Speed of the wave's crest after the drive was switched: it follows with a time constant.
struct Wave {
    tau: f64,
    /// Speed of the full crest in rad/s.
    full: f64,
    /// What the contact accelerates or brakes the rotor by, in rad/s².
    rate: f64,
    /// Speed of the crest at `since`, the last fall.
    crest: f64,
    since: f64,
}

impl Wave {
    fn crest_at(&self, t: f64) -> f64 {
        self.crest * (-(t - self.since).max(0.0) / self.tau).exp()
    }

    /// The drive is on from `from` to `until`.
    fn rise(&mut self, from: f64, until: f64) {
        if self.tau > 0.0 {
            self.crest = self.full - (self.full - self.crest_at(from)) * (-(until - from).max(0.0) / self.tau).exp();
            self.since = until;
        }
    }

    /// How long, after a fall, the crest stays faster than a rotor of `speed` that it still pulls, in s.
    fn overrun_s(&self, fall: f64, speed: f64) -> f64 {
        if self.tau <= 0.0 {
            return 0.0;
        }
        let crest = self.crest_at(fall);
        let mut time = 0.0;
        for _ in 0..4 {
            time = self.tau * (crest / (speed.abs() + self.rate * time).max(1e-3 * self.full)).max(1.0).ln();
        }
        time
    }

    /// Share of the full crest that is missing at a time.
    fn missing(&self, t: f64) -> f64 {
        if self.tau > 0.0 && self.full > 0.0 { 1.0 - self.crest_at(t) / self.full } else { 0.0 }
    }
}

/// Warmth at the end of a drive of `seconds` at `duty` that began at `warmth`.
pub fn warm_up(warmth: f64, duty: f64, seconds: f64, tau: f64) -> f64 {
    duty + (warmth - duty) * (-seconds / tau.max(1e-3)).exp()
}

/// What the actuator path makes of a commanded duty.
pub fn effective_duty(duty: f64, p: &Parameters) -> f64 {
    if duty <= 0.0 {
        return 0.0;
    }
    let mut u = duty;
    let share = p.get(P::QuantShare);
    if share != 0.0 {
        let n = p.get(P::QuantSteps).max(1.0);
        u += share * ((n * u).round() / n - u);
    }
    u -= p.get(P::DeadDuty);
    u = u.max(0.0);
    let gate = p.get(P::GateDuty);
    if gate > 0.0 {
        u /= 1.0 + (-(duty - gate) / p.get(P::GateWidth).max(1e-4)).exp();
    }
    u /= (1.0 + p.get(P::Bend) * u * u).max(0.1);
    u = u.min(1.0 - p.get(P::FlatTop));
    u /= 1.0 + (u * p.get(P::Saturation)).max(-0.9);
    u.clamp(0.0, 1.0)
}

enum Motion {
    /// Constant acceleration.
    Linear(f64),
    /// Exponential approach to a speed at a rate.
    Approach { to: f64, rate: f64 },
}

struct Piece {
    duration: f64,
    motion: Motion,
}

impl Piece {
    /// Angle gained and speed after `dt`, from `speed`.
    fn at(&self, speed: f64, dt: f64) -> (f64, f64) {
        let dt = dt.min(self.duration);
        match self.motion {
            Motion::Linear(a) => {
                let w =
                    if dt >= self.duration && a != 0.0 && (speed + a * dt).abs() < 1e-7 { 0.0 } else { speed + a * dt };
                (speed * dt + 0.5 * a * dt * dt, w)
            }
            Motion::Approach { to, rate } => {
                let decay = (-rate * dt).exp();
                (to * dt + (speed - to) * (1.0 - decay) / rate, to + (speed - to) * decay)
            }
        }
    }
}

fn on_piece(speed: f64, target: f64, acceleration: f64, band: f64, external: f64) -> Piece {
    let lag = target - speed;
    let forever = f64::INFINITY;
    if lag.abs() > band * (1.0 + 1e-9) {
        let sense = lag.signum();
        let a = sense * acceleration + external;
        let closing = a * sense;
        let duration = if closing > 0.0 { (lag.abs() - band) / closing } else { forever };
        Piece { duration: duration.max(1e-9), motion: Motion::Linear(a) }
    } else {
        let rate = acceleration / band;
        let to = target + external.clamp(-acceleration, acceleration) / rate;
        Piece { duration: forever, motion: Motion::Approach { to, rate } }
    }
}

fn off_piece(speed: f64, brake: f64, external: f64) -> Piece {
    if speed.abs() < 1e-9 {
        if external.abs() <= brake {
            return Piece { duration: f64::INFINITY, motion: Motion::Linear(0.0) };
        }
        return Piece { duration: f64::INFINITY, motion: Motion::Linear(external - external.signum() * brake) };
    }
    let a = external - speed.signum() * brake;
    let duration = if a * speed < 0.0 { -speed / a } else { f64::INFINITY };
    Piece { duration, motion: Motion::Linear(a) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn angles(p: &Parameters, on_s: f64, half_sample_s: f64, times: &[f64]) -> Vec<f64> {
        // One PWM period of 20 ms with the drive on at its end, then none.
        let schedule = Schedule {
            periods: vec![Period { start: 0.0, end: 0.02, duty: on_s / 0.02 }],
            directions: vec![(0.0, 1.0)],
        };
        let angles = vec![0.0; times.len()];
        let input = RunInput {
            schedule: &schedule,
            drive_end: 0.02,
            times,
            half_sample_s,
            angles: &angles,
            warmth: 0.0,
            revolutions: 0.0,
        };
        let mut angle = Vec::new();
        simulate(&input, p, &RunTerms::default(), &mut angle, &mut Vec::new());
        angle
    }

    /// The same rotor in steps of a microsecond: the crest follows the drive with a time constant, the contact pulls the rotor
    /// towards it, friction brakes once the wave is gone.
    fn stepped(p: &Parameters, on_s: f64) -> f64 {
        let (mut crest, mut speed, mut angle) = (0.0, 0.0_f64, 0.0);
        let dt = 1e-6;
        for k in 0..40_000 {
            let on = f64::from(k) * dt < on_s;
            let goal = if on { p.get(P::FreeSpeed) } else { 0.0 };
            crest += (goal - crest) * dt / p.get(P::WaveTime);
            speed = if crest < 0.02 * p.get(P::FreeSpeed) {
                (speed - p.get(P::OffDeceleration) * dt).max(0.0)
            } else {
                let reach = p.get(P::OnAcceleration) * dt;
                speed + (crest - speed).clamp(-reach, reach)
            };
            angle += speed * dt;
        }
        angle
    }

    /// Fails if the dying wave no longer drives a rotor that is slower than its crest: pulses of 1 ms then turn a sixth less.
    #[test]
    fn short_pulses_turn_as_far_as_small_steps_say() {
        let p = Parameters::new(3.57, 2009.0, 1900.0, 0.0, 0.005).with(P::WaveTime, 2.48e-4);
        for on_s in [1e-3, 2e-3, 4e-3, 10e-3] {
            let ours = angles(&p, on_s, 0.0, &[0.05])[0];
            let reference = stepped(&p, on_s);
            assert!((ours / reference - 1.0).abs() < 0.05, "{on_s} s: {ours} rad, in small steps {reference} rad");
        }
        let without = angles(&p.with(P::WaveTime, 0.0), 1e-3, 0.0, &[0.05])[0];
        assert!(without < 0.9 * stepped(&p, 1e-3), "the effect is there to be seen: {without}");
    }

    /// Fails if an edge is held against the angle in the middle of its sampling period.
    #[test]
    fn a_sampled_edge_stands_for_the_mean_of_both_samples() {
        let p = Parameters::new(3.57, 2009.0, 1900.0, 0.0, 0.02);
        let h = 0.5e-3;
        let times = [0.0104, 0.012, 0.0185, 0.021];
        let mean = angles(&p, 10e-3, h, &times);
        for (t, m) in times.iter().zip(mean) {
            let sides = angles(&p, 10e-3, 0.0, &[t - h, t + h]);
            assert!((m - 0.5 * (sides[0] + sides[1])).abs() < 1e-12, "at {t} s");
        }
    }
}
