//! What effects change of a rotor now: its drive, its friction, its load.

use super::super::P;
use super::super::parameters::harmonics;
use super::Simulation;
use std::f64::consts::TAU;
use twum_motor::hypothesis::{ActsOn, Now};

/// The sizes of `run-in-wear`.
const WEAR: [P; 3] = [P::Wear, P::WearRunIn, P::WearFriction];

/// Wear is held, so that periods repeat each other, while the way grows by this share of itself and these revolutions: by then neither
/// ln(1 + x) nor 1 − e⁻ˣ has changed by more than half a hundredth, for what runs in within half a revolution and slower. It does not hang on
/// the fitted revolutions: over them, what is held would be no smooth function.
const WORN_SHARE: f64 = 0.005;
const WORN_REVOLUTIONS: f64 = 0.002;

impl Simulation<'_> {
    /// What brakes without a wave, in rad/s², where the friction is so much of its own.
    pub(super) fn brake(&mut self, friction: f64, sign: f64, modulation: f64) -> f64 {
        let p = self.p;
        p.off_deceleration().max(0.0)
            * friction
            * (1.0 + sign * p.get(P::AsymBrake) + p.get(P::RunoutBrake) * modulation).max(0.0)
            * (1.0 + self.by_formulas(ActsOn::Braking, sign)).max(0.0)
    }

    /// The angle that the encoder shows now, in rad.
    fn shown(&mut self) -> f64 {
        let now = self.t * (1.0 + self.p.get(P::ClockError)) + self.p.get(P::Latency);
        let times = self.input.times;
        while self.measured + 1 < times.len() && times[self.measured + 1] <= now {
            self.measured += 1;
        }
        self.input.angles.get(self.measured).copied().unwrap_or(self.angle)
    }

    /// What the effects that are formulas change now of what they act on.
    pub(super) fn by_formulas(&mut self, what: ActsOn, sign: f64) -> f64 {
        if self.formulas.iter().all(|f| f.0.acts_on != what) {
            return 0.0;
        }
        let now = Now {
            duty: self.duty,
            time_s: self.t,
            on_s: self.on_time,
            turned_rad: self.shown(),
            speed_rad_s: self.speed,
            direction: sign,
            revolutions: self.input.revolutions + self.angle.abs() / TAU,
        };
        self.changes(what, &now).map(|change| 1.0 + change).product::<f64>() - 1.0
    }

    fn changes(&self, what: ActsOn, now: &Now) -> impl Iterator<Item = f64> {
        self.formulas.iter().filter(move |f| f.0.acts_on == what).map(move |(h, values)| h.change(values, now))
    }

    /// The duty that is asked of the driver's own map in the period that begins now.
    pub(super) fn commanded(&self, start: f64, duty: f64) -> f64 {
        if duty <= 0.0 || self.formulas.is_empty() {
            return duty;
        }
        let directions = &self.input.schedule.directions;
        let direction = directions.iter().rev().find(|d| d.0 <= start).map_or(1.0, |d| d.1);
        let mut u = duty;
        for change in self.changes(ActsOn::Duty, &Now { duty, direction, ..Now::default() }) {
            u = (u + change).clamp(0.0, 1.0);
        }
        u
    }

    /// Relative modulation by the angle, and the torque over inertia that hangs on it.
    pub(super) fn over_angle(&mut self) -> (f64, f64) {
        if !self.has_angle {
            return (0.0, 0.0);
        }
        let theta = self.shown();
        if let Some((measured, modulation, load)) = self.over_measured
            && measured == self.measured
        {
            return (modulation, load);
        }
        let (s, c) = theta.sin_cos();
        let load = self.p.get(P::OnAcceleration) * (self.terms.gravity[0] * c + self.terms.gravity[1] * s);
        let modulation = harmonics(&self.terms.runout, theta);
        self.over_measured = Some((self.measured, modulation, load));
        (modulation, load)
    }

    /// Friction that fades with speed, over inertia, against the motion.
    pub(super) fn stribeck(&self, carried: bool, sign: f64) -> f64 {
        let extra = self.p.get(P::Stribeck) * self.p.get(P::OnAcceleration);
        if extra == 0.0 || !(carried || self.speed != 0.0) {
            return 0.0;
        }
        let x = self.speed / self.p.get(P::StribeckSpeed).max(1e-3);
        let sense = if self.speed != 0.0 { self.speed.signum() } else { sign };
        sense * extra * (-x * x).exp()
    }

    /// Looks again how far the contact has worn, if it has turned by enough; whether it did.
    pub(super) fn wears(&mut self) -> bool {
        let [for_ever, run_in, friction] = WEAR.map(|p| self.p.get(p));
        if [for_ever, run_in, friction] == [0.0; 3] {
            return false;
        }
        let revolutions = self.input.revolutions + self.angle.abs() / TAU;
        if revolutions < self.worn_until {
            return false;
        }
        self.worn_until = WORN_REVOLUTIONS + revolutions * (1.0 + WORN_SHARE);
        let x = revolutions / self.p.get(P::WearRevolutions).max(1e-6);
        let done = -(-x).exp_m1();
        self.worn = [for_ever * x.ln_1p() + run_in * done, friction * done];
        true
    }

    /// Factor on the wave's speed until `end`.
    pub(super) fn gain(&self, sign: f64, worn: f64, modulation: f64, end: f64) -> f64 {
        let p = self.p;
        let mut gain = 1.0 + worn - p.get(P::HeatLoss) * self.warmth
            + sign * p.get(P::AsymSpeed)
            + p.get(P::RunoutSpeed) * modulation;
        if p.get(P::Sag) != 0.0 {
            let middle = (-0.5 * (end - self.t) / p.get(P::SagTime).max(1e-4)).exp();
            gain -= p.get(P::Sag) * (1.0 - (1.0 - self.sagged) * middle);
        }
        if p.get(P::SettleExcess) != 0.0 {
            let since = if p.get(P::SettleOnTime) > 0.5 { self.on_time } else { self.t };
            gain += p.get(P::SettleExcess) * (-(since + 0.5 * (end - self.t)) / p.get(P::SettleTau).max(1e-4)).exp();
        }
        (gain * self.kept).max(0.0)
    }
}
