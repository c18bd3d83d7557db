//! A run, stepped from event to event.

mod acting;

use super::clock::driven_s;
use super::motion::{Piece, Pull, off_piece, on_piece};
use super::parameters::placed;
use super::warming::Warming;
use super::wave::{Course, Wave};
use super::{P, Parameters, RunTerms, Schedule, effective_duty, start_delay, warm_up};
use std::sync::Arc;
use twum_motor::hypothesis::{ActsOn, Hypothesis, MOST_NUMBERS};

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
    /// Effects that are formulas; their numbers are among the parameters.
    pub formulas: &'a [Arc<Hypothesis>],
}

/// Longest steps in s: of anything, and of what hangs on the angle.
const LONGEST_S: f64 = 0.02;
const LONGEST_OVER_ANGLE_S: f64 = 4e-3;
/// Step in s while friction changes with a speed that is not far above the Stribeck speed.
const STRIBECK_S: f64 = 2.5e-4;
/// Time in s in which the contact takes up the last of a speed difference, at least: a narrower band would be crossed back and forth within
/// one step.
const SHORTEST_S: f64 = 1e-7;
/// Settling times after which nothing is left of it (e⁻⁹).
const SETTLED: f64 = 9.0;
/// Change over a period of the speed, relative to the free speed, of the sag and of the wave's height below which periods repeat each other.
const REPEATS: f64 = 1e-7;

/// What moves the rotor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum By {
    /// The wave carries it.
    Wave,
    /// It lies on the stator.
    Friction,
}

/// A period that later ones repeat: its pieces, and by how far it turns the rotor in all and the speed it leaves, once one was repeated.
#[derive(Default)]
struct Record {
    pieces: Vec<Repeated>,
    whole: Option<(f64, f64)>,
}

/// One piece of it: when it began and from what.
struct Repeated {
    t: f64,
    angle: f64,
    speed: f64,
    piece: Piece,
}

/// What a simulated rotor does.
#[derive(Debug, Clone, Default)]
pub struct Trajectory {
    /// Its angle at every measured time, in rad.
    pub angle: Vec<f64>,
    /// Its speed there, in rad/s.
    pub speed: Vec<f64>,
}

/// Simulates a run.
///
/// An edge that was seen between two samples lies, its place on the wheel being unknown, anywhere between the rotor's angles at
/// the two with equal probability: what a measured time stands for is their mean, not the angle in the middle of the period. The
/// two differ wherever the rotor starts or stops, thousands of times a run.
pub fn simulate(input: &RunInput, p: &Parameters, terms: &RunTerms) -> Trajectory {
    let simulation = || Simulation::new(input, p, terms);
    match Warming::of(input, p).filter(|_| simulation().is_steady()) {
        Some(warming) => {
            let at = |warmth: f64| Simulation { held: true, warmth, ..simulation() }.run();
            warming.between(input.times.iter().map(|t| driven_s(*t, p)), &warming.ends().map(at))
        }
        None => period_by_period(input, p, terms),
    }
}

/// The same, period by period where the motor warms.
pub(super) fn period_by_period(input: &RunInput, p: &Parameters, terms: &RunTerms) -> Trajectory {
    Simulation::new(input, p, terms).run()
}

struct Simulation<'a> {
    input: &'a RunInput<'a>,
    p: &'a Parameters,
    terms: &'a RunTerms,
    wave: Wave,
    /// What changes with the angle, so that no period repeats another.
    has_angle: bool,
    /// What [`Self::over_angle`] said of the angle that was measured last, and which that was.
    over_measured: Option<(usize, f64, f64)>,
    /// Effects that are formulas and there, with their numbers.
    formulas: Vec<(&'a Hypothesis, [f64; MOST_NUMBERS])>,
    /// Commanded duty of the period.
    duty: f64,
    /// Times that are asked for, in s of the drive; the next of them.
    asked: Vec<f64>,
    next: usize,
    angles: Vec<f64>,
    speeds: Vec<f64>,
    t: f64,
    angle: f64,
    speed: f64,
    warmth: f64,
    /// Whether it stays as warm as it is.
    held: bool,
    sagged: f64,
    on_time: f64,
    measured: usize,
    direction: usize,
    /// Share of the speed that the bend of a high duty leaves.
    kept: f64,
    /// Relative changes of the wave's speed and of the friction since the contact was new, and the revolutions up to which they are held.
    worn: [f64; 2],
    worn_until: f64,
    /// The period that is recorded, if one is.
    record: Option<Record>,
}

impl<'a> Simulation<'a> {
    fn new(input: &'a RunInput, p: &'a Parameters, terms: &'a RunTerms) -> Self {
        let driven = |t: f64| driven_s(t, p);
        let half = input.half_sample_s;
        // Asked for on both sides of every time; put together at the end.
        let asked: Vec<f64> = if half > 0.0 {
            input.times.iter().flat_map(|t| [driven(t - half), driven(t + half)]).collect()
        } else {
            input.times.iter().map(|t| driven(*t)).collect()
        };
        let [tau, dying, detuning, lift, full, rate] =
            [P::WaveTime, P::Dying, P::Detuning, P::Lift, P::FreeSpeed, P::OnAcceleration].map(|k| p.get(k).max(0.0));
        let rates = [rate.max(1.0), p.off_deceleration().max(0.0)];
        let wave = Wave::new([tau, tau * dying], detuning, lift, full, rates);
        Self {
            input,
            p,
            terms,
            wave,
            formulas: placed(input.formulas)
                .map(|(h, places)| (h.as_ref(), p.of_formula(places)))
                .filter(|(h, values)| h.is_there(values))
                .collect(),
            duty: 0.0,
            over_measured: None,
            has_angle: terms.runout.iter().chain(&terms.gravity).any(|c| *c != 0.0),
            angles: Vec::with_capacity(asked.len()),
            speeds: Vec::with_capacity(asked.len()),
            asked,
            next: 0,
            t: 0.0,
            angle: 0.0,
            speed: 0.0,
            warmth: input.warmth,
            held: !p.warms(),
            sagged: 0.0,
            on_time: 0.0,
            measured: 0,
            direction: 0,
            kept: 1.0,
            worn: [0.0; 2],
            worn_until: 0.0,
            record: None,
        }
    }

    fn run(mut self) -> Trajectory {
        self.periods();
        self.coast();
        self.finish()
    }

    fn done(&self) -> bool {
        self.next >= self.asked.len()
    }

    /// Whether nothing changes with the angle, or as a formula says.
    fn is_steady(&self) -> bool {
        !self.has_angle && self.formulas.iter().all(|f| f.0.is_steady())
    }

    /// Whether a period may repeat the one before it: nothing changes slowly or with the angle.
    fn can_repeat(&self) -> bool {
        let settle = self.p.get(P::SettleExcess);
        let since = if self.p.get(P::SettleOnTime) > 0.5 { self.on_time } else { self.t };
        self.is_steady()
            && self.held
            && self.input.schedule.directions.len() <= 1
            && (settle == 0.0 || since > SETTLED * self.p.get(P::SettleTau))
    }

    fn periods(&mut self) {
        let periods = &self.input.schedule.periods;
        let mut before = [f64::NAN; 4];
        for (k, period) in periods.iter().enumerate() {
            if period.start >= self.input.drive_end || self.done() {
                return;
            }
            let whole = period.end <= self.input.drive_end && period.start > 0.0;
            let same = k > 0 && {
                let last = &periods[k - 1];
                last.duty == period.duty && (last.end - last.start - (period.end - period.start)).abs() < 1e-12
            };
            let worn = self.wears();
            let repeats = whole && same && !worn && self.can_repeat();
            if repeats && let Some(mut record) = self.record.take_if(|r| !r.pieces.is_empty()) {
                self.repeat(period.start, period.end, &mut record);
                self.record = Some(record);
                continue;
            }
            let wave = self.wave.amplitude_at(self.t);
            let now = [self.speed / self.wave.full, self.sagged, wave.re, wave.im];
            let still = now.iter().zip(before).all(|(now, before)| (now - before).abs() <= REPEATS);
            before = now;
            self.record = (repeats && still).then(Record::default);
            let half = 0.5 * (period.end - period.start);
            self.warm(period.duty, half);
            self.period(period.start, period.end, period.duty);
            self.warm(period.duty, half);
        }
    }

    /// Warms, or cools, for some time at a duty; over a period the motor is as warm as in its middle.
    fn warm(&mut self, duty: f64, seconds: f64) {
        if !self.held {
            self.warmth = warm_up(self.warmth, effective_duty(duty, self.p), seconds, self.p.get(P::HeatTau));
        }
    }

    /// Answers what falls into a period that repeats a recorded one.
    fn repeat(&mut self, start: f64, end: f64, Record { pieces, whole }: &mut Record) {
        let (first, from) = (pieces[0].t, pieces[0].angle);
        let mut k = 0;
        while !self.done() && self.asked[self.next] <= end {
            let t = self.asked[self.next] - start + first;
            while k + 1 < pieces.len() && pieces[k + 1].t < t {
                k += 1;
            }
            let (a, w) = pieces[k].piece.at(pieces[k].speed, (t - pieces[k].t).max(0.0));
            self.angles.push(self.angle + pieces[k].angle - from + a);
            self.speeds.push(w);
            self.next += 1;
        }
        let (advance, speed) = *whole.get_or_insert_with(|| {
            let last = &pieces[pieces.len() - 1];
            let (a, w) = last.piece.at(last.speed, end - start + first - last.t);
            (last.angle - from + a, w)
        });
        self.angle += advance;
        self.speed = speed;
        self.t = end;
        self.wave.shift(end - start);
    }

    fn period(&mut self, start: f64, end: f64, duty: f64) {
        let loss = self.p.get(P::BendLoss);
        self.kept = if loss != 0.0 { 1.0 - loss * duty.powf(self.p.get(P::BendPower)) } else { 1.0 };
        self.duty = duty;
        let duty = effective_duty(self.commanded(start, duty), self.p);
        let ends = end.min(self.input.drive_end);
        let rises = (end - duty * (end - start)).max(if start <= 0.0 { 0.0 } else { start }).min(ends);
        if rises > start + 1e-9 {
            self.stretch(start, rises, false);
        }
        // What still stands of the wave need not build up again.
        let rest_s = if start <= 0.0 { f64::INFINITY } else { rises - start };
        let delay = start_delay(self.p, rest_s);
        let late = if delay > 0.0 { rises + delay * (1.0 - self.wave.height_at(rises)) } else { rises };
        if late > rises + 1e-9 {
            self.stretch(rises, late.min(ends), false);
        }
        if duty > 0.0 {
            self.stretch(late.min(ends), ends, true);
        }
    }

    /// From a switching of the drive to the next: the wave moves the rotor once it is high enough, and as long as it is.
    fn stretch(&mut self, from: f64, until: f64, driven: bool) {
        if self.wave.driven() != driven || !driven {
            self.wave.switch(from, driven);
        }
        let crosses = self.wave.overcomes_at().min(until);
        let [before, after] = if driven { [By::Friction, By::Wave] } else { [By::Wave, By::Friction] };
        self.advance(crosses, before);
        self.advance(until, after);
    }

    /// After the last period.
    fn coast(&mut self) {
        self.record = None;
        if let Some(last) = self.asked.last().filter(|_| !self.done()) {
            let last = last.max(self.t) + 1e-6;
            self.stretch(self.t, last, false);
        }
    }

    fn finish(mut self) -> Trajectory {
        // Times before the start of the drive, or after numerical ties.
        self.angles.resize(self.asked.len(), self.angle);
        self.speeds.resize(self.asked.len(), self.speed);
        if self.input.half_sample_s > 0.0 {
            let n = self.input.times.len();
            for list in [&mut self.angles, &mut self.speeds] {
                for k in 0..n {
                    list[k] = 0.5 * (list[2 * k] + list[2 * k + 1]);
                }
                list.truncate(n);
            }
        }
        Trajectory { angle: self.angles, speed: self.speeds }
    }

    /// Longest step that may be made now, in s.
    fn longest_step(&self) -> f64 {
        let p = self.p;
        let mut longest = LONGEST_S;
        if p.get(P::SettleExcess) != 0.0 {
            longest = longest.min(0.3 * p.get(P::SettleTau)).max(1e-3);
        }
        if self.has_angle || self.formulas.iter().any(|f| !f.0.is_steady()) {
            longest = longest.min(LONGEST_OVER_ANGLE_S);
        }
        let viscous = p.get(P::Viscous);
        if viscous != 0.0 {
            longest = longest.min(0.02 / viscous.max(1e-9)).max(5e-4);
        }
        if p.get(P::Sag) != 0.0 {
            longest = longest.min(0.25 * p.get(P::SagTime)).max(5e-4);
        }
        if p.get(P::Stribeck) != 0.0 && self.speed.abs() < 3.0 * p.get(P::StribeckSpeed) {
            longest = longest.min(STRIBECK_S);
        }
        longest
    }

    /// Advances to `until`, answering what is asked on the way.
    fn advance(&mut self, until: f64, by: By) {
        let p = self.p;
        let driven = self.wave.driven();
        let half_band_torque = 0.5_f64.powf(p.get(P::SlipExponent));
        let band_fraction = (p.get(P::SlipBand) + p.get(P::SlipExtra)).max(1e-3);
        while self.t < until - 1e-12 && !self.done() {
            let directions = &self.input.schedule.directions;
            while self.direction + 1 < directions.len() && directions[self.direction + 1].0 <= self.t + 1e-12 {
                self.direction += 1;
            }
            let sign = directions.get(self.direction).map_or(1.0, |d| d.1);
            let mut end = until.min(self.t + self.longest_step());
            if by == By::Wave {
                end = end.min(self.t + self.wave.step_s(self.t));
            }
            if let Some(d) = directions.get(self.direction + 1) {
                end = end.min(d.0);
            }
            let (modulation, mut external) = self.over_angle();
            external -= p.get(P::Viscous) * self.speed + self.stribeck(by == By::Wave, sign);
            let [worn_speed, worn_friction] = self.worn;
            let warm_friction = p.get(P::HeatFriction) * self.warmth;
            let friction = (1.0 + worn_friction).max(0.01)
                * (1.0 + warm_friction).max(0.01)
                * (1.0 + sign * p.get(P::AsymFriction));
            let step_s = end - self.t;
            match by {
                By::Wave => {
                    let kept = (1.0 + self.by_formulas(ActsOn::Speed, sign)).max(0.0);
                    let full = sign * self.wave.full * self.gain(sign, worn_speed, modulation, end) * kept;
                    let torque = friction
                        * (1.0 + p.get(P::RunoutTorque) * modulation)
                        * (1.0 + self.by_formulas(ActsOn::Torque, sign));
                    let Course { heights, carried } = self.wave.course(self.t, end);
                    // What the wave carries pulls as it does, the rest as without it, but no more.
                    let whole = self.wave.rate * torque.max(0.01);
                    let rest = (1.0 - carried) * self.brake(friction, sign, modulation).min(whole);
                    let acceleration = carried * whole + rest;
                    let ahead = (carried * whole * p.get(P::Ahead) + rest) / acceleration;
                    let band = (band_fraction * full.abs()).max(SHORTEST_S * acceleration);
                    let [from, to] = heights.map(|height| full * height);
                    let (began, slope) = (self.t, (to - from) / step_s);
                    while self.t < end - 1e-12 && !self.done() {
                        let crest = from + slope * (self.t - began);
                        let pull = Pull { sign, crest, slope, acceleration, band, half_band_torque, ahead };
                        self.follow(on_piece(self.speed, &pull, external), end);
                    }
                }
                By::Friction => {
                    let brake = self.brake(friction, sign, modulation);
                    while self.t < end - 1e-12 && !self.done() {
                        self.follow(off_piece(self.speed, brake, external), end);
                    }
                }
            }
            if driven {
                self.on_time += step_s;
            }
            if p.get(P::Sag) != 0.0 {
                let drive = if driven { 1.0 } else { 0.0 };
                self.sagged = drive + (self.sagged - drive) * (-step_s / p.get(P::SagTime).max(1e-4)).exp();
            }
        }
    }

    /// Follows a closed form until it ends, or until `end`.
    fn follow(&mut self, piece: Piece, end: f64) {
        if let Some(record) = &mut self.record {
            record.pieces.push(Repeated { t: self.t, angle: self.angle, speed: self.speed, piece });
        }
        let stop = (self.t + piece.duration.max(1e-9)).min(end);
        while !self.done() && self.asked[self.next] <= stop {
            let (a, w) = piece.at(self.speed, (self.asked[self.next] - self.t).max(0.0));
            self.angles.push(self.angle + a);
            self.speeds.push(w);
            self.next += 1;
        }
        let (a, w) = piece.at(self.speed, stop - self.t);
        self.angle += a;
        self.speed = w;
        self.t = stop;
    }
}
