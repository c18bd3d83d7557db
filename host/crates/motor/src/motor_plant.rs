//! A travelling-wave motor behind the plant seam: either model, with the effects that live in the motor.

use super::averaged::Averaged;
use super::blend::Blend;
use super::carrier::Carrier;
use super::effects::EffectSet;
use super::hypothesis::{ActsOn, Formula, Now};
use super::modulation::Modulation;
use super::parameters::{Flavour, Parameters};
use super::plant::{Drive, Plant, Segment};
use std::f64::consts::PI;

/// Which model integrates the motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Solver {
    /// [`Averaged`].
    Averaged,
    /// [`Carrier`].
    Carrier,
}

/// What a motor remembers from one run to the next.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct History {
    /// Warmth, 0 cold to 1 fully warm under continuous drive; see `resonance-heating`.
    pub warmth: f64,
    /// Revolutions made, either way; see `run-in-wear`.
    pub revolutions: f64,
}

/// A pause of the drive longer than this makes the driver search its frequency anew (s); see `frequency-settling`.
const RESTART_S: f64 = 0.1;
/// A stretch of drive shorter than this is a control tick, not a part of a PWM period: it will not come again unless the rotor
/// stops (s).
const WORTH_REMEMBERING_S: f64 = 5.1e-4;
/// A runout of several harmonics leaves at least this share of what it acts on (1).
const LEAST_FACTOR: f64 = 0.02;
/// A settling this slow (s) may be held over the on part of a 50 Hz period at its value in the middle: half a per cent of it.
const SETTLES_SLOWLY_S: f64 = 0.05;
/// Longest step while an effect changes the motor (s); an angle-dependent one sees 0.2° at full speed.
const LONGEST_S: f64 = 1e-3;

#[derive(Debug, Clone)]
enum Model {
    Averaged(Box<Averaged>),
    Carrier(Box<Carrier>, f64),
}

/// A motor and its plant effects.
#[derive(Debug, Clone)]
pub struct MotorPlant {
    model: Model,
    effects: EffectSet,
    history: History,
    /// Supply current as a share of the full one; see `supply-sag`.
    current: f64,
    /// When the drive began, and when it was last on (s).
    began_s: f64,
    last_on_s: f64,
    /// Where the drive began (rad): a run's record begins with its drive.
    began_rad: f64,
    /// Time driven since the drive began (s).
    driven_s: f64,
    /// Longest step (s): infinite where no effect needs one.
    longest_s: f64,
    /// Whether any effect of the plant is present.
    changes: bool,
    /// Where effects change a motor slowly that stops in every period.
    blend: Option<Box<Blend>>,
    /// Angle turned in the last on part (rad): half of it ahead is where an angle-dependent effect is looked at.
    last_turn_rad: f64,
    /// Torque of a hand, clockwise (N·m).
    hand_nm: f64,
}

impl MotorPlant {
    /// A motor at rest.
    pub fn new(
        parameters: Parameters,
        flavour: Flavour,
        solver: Solver,
        effects: &EffectSet,
        history: History,
    ) -> Self {
        let formulas: Vec<&Formula> = effects
            .formulas
            .iter()
            .filter(|m| m.hypothesis.acts_on != ActsOn::Duty && m.hypothesis.is_there(&m.values))
            .collect();
        let steady = formulas.iter().all(|m| m.hypothesis.is_steady());
        let moving = !steady
            || effects.resonance_heating.is_some()
            || effects.frequency_settling.is_some()
            || effects.preload_runout.is_some()
            || effects.gravity_load.is_some()
            || effects.supply_sag.is_some()
            || effects.run_in_wear.is_some();
        let fixed = !formulas.is_empty()
            || effects.off_phase_braking.is_some()
            || effects.contact_stiffening.is_some()
            || effects.direction_asymmetry.is_some()
            || effects.high_duty_saturation.is_some_and(|e| e.voltage_loss != 0.0)
            || effects.stribeck_friction.is_some()
            || effects.presliding.is_some();
        let averaged = matches!(solver, Solver::Averaged).then(|| Averaged::new(parameters, flavour));
        // What changes within one part of a period has to be integrated through it.
        let quick =
            effects.supply_sag.is_some() || effects.frequency_settling.is_some_and(|e| e.tau_s < SETTLES_SLOWLY_S);
        // Nor has the blend's grid an axis for a friction that varies.
        let rubs = effects.preload_runout.is_some_and(|e| e.on_friction != 0.0 || e.on_braking != 0.0)
            || effects.resonance_heating.is_some_and(|e| e.friction != 0.0)
            || effects.run_in_wear.is_some_and(|e| e.friction_run_in != 0.0);
        let blends = moving
            && formulas.is_empty()
            && !quick
            && !rubs
            && flavour == Flavour::Physical
            && effects.presliding.is_none();
        let left = effects.resonance_heating.map_or(1.0, |e| e.kept);
        let history = History { warmth: left * history.warmth, ..history };
        MotorPlant {
            blend: averaged.as_ref().filter(|_| blends).map(|model| Box::new(Blend::new(model))),
            last_turn_rad: 0.0,
            hand_nm: 0.0,
            model: match solver {
                Solver::Averaged => Model::Averaged(Box::new(Averaged::new(parameters, flavour))),
                Solver::Carrier => Model::Carrier(Box::new(Carrier::new(parameters, flavour)), 0.0),
            },
            effects: effects.clone(),
            history,
            current: 0.0,
            began_s: 0.0,
            began_rad: 0.0,
            last_on_s: f64::NEG_INFINITY,
            driven_s: 0.0,
            longest_s: if moving { LONGEST_S } else { f64::INFINITY },
            changes: moving || fixed,
        }
    }

    /// A hand pushes the rotor clockwise from now on (N·m).
    pub fn push(&mut self, torque_nm: f64) {
        self.hand_nm = torque_nm;
        self.changes = true;
    }

    /// What the motor will remember.
    pub fn history(&self) -> History {
        self.history
    }

    /// Amplitude of the wave (m).
    pub fn amplitude_m(&self) -> f64 {
        match &self.model {
            Model::Averaged(model) => model.amplitude_m(),
            Model::Carrier(model, _) => model.amplitude_m(),
        }
    }

    /// Height of the rotor (m).
    pub fn height_m(&self) -> f64 {
        match &self.model {
            Model::Averaged(model) => model.height_m(),
            Model::Carrier(model, _) => model.state()[4],
        }
    }

    /// Steps taken.
    pub fn steps(&self) -> u64 {
        match &self.model {
            Model::Averaged(model) => model.steps(),
            Model::Carrier(model, _) => model.steps(),
        }
    }

    fn modulation(&self, drive: Drive, time: f64, angle: f64) -> Modulation {
        let e = &self.effects;
        let sense = drive.sign();
        let mut m = Modulation { load_nm: -self.hand_nm, ..Modulation::NONE };
        if let Some(e) = e.resonance_heating {
            m.resonance_shift_hz -= e.shift_hz * self.history.warmth;
            let friction = (1.0 + e.friction * self.history.warmth).clamp(LEAST_FACTOR, 1.0 / LEAST_FACTOR);
            m.friction *= friction;
            m.off_friction *= friction;
        }
        if let Some(e) = e.frequency_settling {
            let since_s = if e.on_time > 0.5 { self.driven_s } else { time - self.began_s };
            m.drive_shift_hz += e.detuning_hz * (-since_s.max(0.0) / e.tau_s).exp();
        }
        if let Some(e) = e.off_phase_braking {
            m.off_brake_nm += e.torque_nm;
        }
        if let Some(e) = e.contact_stiffening {
            m.contact_exponent = e.exponent;
            m.slip_excess = e.slip_band_excess;
            m.slip_exponent = e.slip_exponent;
        }
        if let Some(e) = e.direction_asymmetry {
            m.voltage *= 1.0 + sense * e.gain;
            m.friction *= 1.0 + sense * e.friction;
            m.off_friction *= (1.0 + sense * e.friction) * (1.0 + sense * e.braking);
        }
        if let Some(e) = e.preload_runout {
            // As far as a preload can fall and a friction rise.
            let r = e.relative(angle);
            let factor = |share: f64| (1.0 + share * r).clamp(LEAST_FACTOR, 1.0 / LEAST_FACTOR);
            m.preload *= factor(e.on_preload);
            m.voltage *= factor(e.on_voltage);
            m.friction *= factor(e.on_friction);
            m.off_friction *= factor(e.on_braking);
        }
        if let Some(e) = e.stribeck_friction {
            m.stribeck_nm = e.torque_nm;
            m.stribeck_rad_s = e.speed_rad_s;
        }
        if let Some(e) = e.presliding
            && e.compliance_rad_nm > 0.0
        {
            m.bristle_nm_rad = 1.0 / e.compliance_rad_nm;
            m.bristle_nms_rad = e.damping_nms;
        }
        if let Some(e) = e.gravity_load {
            m.load_nm += e.torque_nm * (angle + e.phase_rad).sin();
        }
        if let Some(e) = e.supply_sag {
            m.voltage *= 1.0 - e.sag * self.current;
        }
        if let Some(e) = e.high_duty_saturation {
            m.voltage *= 1.0 - e.voltage_loss * drive.duty.powf(e.bend_power);
        }
        if let Some(e) = e.run_in_wear {
            let [gain, friction] = e.changes(self.history.revolutions);
            m.voltage *= (1.0 + gain).max(0.0);
            let friction = (1.0 + friction).clamp(LEAST_FACTOR, 1.0 / LEAST_FACTOR);
            m.friction *= friction;
            m.off_friction *= friction;
        }
        for formula in &e.formulas {
            let now = Now {
                duty: drive.duty,
                time_s: time - self.began_s,
                on_s: self.driven_s,
                turned_rad: angle - self.began_rad,
                speed_rad_s: self.speed_rad_s(),
                direction: sense,
                revolutions: self.history.revolutions,
            };
            let change = |what| formula.change_of(what, &now);
            m.voltage *= (1.0 + formula.voltage_per_speed * change(ActsOn::Speed)).max(0.0);
            m.friction *= (1.0 + change(ActsOn::Torque)).clamp(LEAST_FACTOR, 1.0 / LEAST_FACTOR);
            m.off_friction *= (1.0 + change(ActsOn::Braking)).clamp(LEAST_FACTOR, 1.0 / LEAST_FACTOR);
        }
        m
    }

    /// Advances by blending, where that is possible; see [`Blend`].
    fn blended(&mut self, until_s: f64, drive: Drive, observe: &mut dyn FnMut(&Segment)) -> bool {
        if self.blend.is_none() {
            return false;
        }
        let ahead_rad = if drive.level > 0.0 { 0.5 * self.last_turn_rad * drive.sign() } else { 0.0 };
        // What changes within the stretch is taken at its middle.
        let middle_s = 0.5 * (self.time_s() + until_s);
        let modulation = self.modulation(drive, middle_s, self.position_rad() + ahead_rad);
        let before = (self.time_s(), self.position_rad());
        let (Some(blend), Model::Averaged(model)) = (&mut self.blend, &mut self.model) else { return false };
        if !blend.advance(model, until_s, drive, &modulation, observe) {
            return false;
        }
        if drive.level > 0.0 {
            self.last_turn_rad = (self.position_rad() - before.1).abs();
        }
        self.remember(before, drive);
        true
    }

    /// Follows what has slow memory since a time (s) and an angle (rad).
    fn remember(&mut self, (since_s, since_rad): (f64, f64), drive: Drive) {
        let h = self.time_s() - since_s;
        self.history.revolutions += (self.position_rad() - since_rad).abs() / (2.0 * PI);
        if let Some(e) = self.effects.resonance_heating {
            self.history.warmth = drive.level + (self.history.warmth - drive.level) * (-h / e.tau_s).exp();
        }
        if let Some(e) = self.effects.supply_sag {
            self.current = drive.level + (self.current - drive.level) * (-h / e.tau_s).exp();
        }
        if drive.level > 0.0 {
            self.driven_s += h;
        }
        if drive.level > 0.0 || drive.duty > 0.0 {
            self.last_on_s = self.time_s();
        }
    }
}

impl Plant for MotorPlant {
    fn time_s(&self) -> f64 {
        match &self.model {
            Model::Averaged(model) => model.time_s(),
            Model::Carrier(_, time) => *time,
        }
    }

    fn position_rad(&self) -> f64 {
        match &self.model {
            Model::Averaged(model) => model.position_rad(),
            Model::Carrier(model, _) => model.state()[6],
        }
    }

    fn speed_rad_s(&self) -> f64 {
        match &self.model {
            Model::Averaged(model) => model.speed_rad_s(),
            Model::Carrier(model, _) => model.state()[7],
        }
    }

    fn advance(&mut self, until_s: f64, drive: Drive, observe: &mut dyn FnMut(&Segment)) {
        // The driver starts with the PWM, whose period may begin with its off part.
        if (drive.level > 0.0 || drive.duty > 0.0) && self.time_s() - self.last_on_s > RESTART_S {
            self.began_s = self.time_s();
            self.began_rad = self.position_rad();
            self.driven_s = 0.0;
        }
        let now_s = self.time_s();
        if until_s - now_s > WORTH_REMEMBERING_S && self.blended(until_s, drive, observe) {
            return;
        }
        let modulation = self.modulation(drive, self.time_s(), self.position_rad());
        if let (Model::Averaged(model), true) = (&mut self.model, self.longest_s.is_infinite())
            && (until_s - now_s > WORTH_REMEMBERING_S || model.stops())
        {
            let before = (model.time_s(), model.position_rad());
            model.modulate(&modulation);
            model.advance_remembering(until_s, drive, observe);
            self.remember(before, drive);
            return;
        }
        loop {
            let modulation = if self.changes {
                self.modulation(drive, self.time_s(), self.position_rad())
            } else {
                Modulation::NONE
            };
            let longest = self.longest_s;
            let mut last = None;
            let mut watch = |segment: &Segment| {
                observe(segment);
                last = Some(*segment);
            };
            let arrived = match &mut self.model {
                Model::Averaged(model) => {
                    if self.changes {
                        model.modulate(&modulation);
                    }
                    model.step(until_s, drive, longest, &mut watch)
                }
                Model::Carrier(model, time) => {
                    if self.changes {
                        model.modulate(&modulation);
                    }
                    carrier_step(model, time, until_s, drive, longest, &modulation, &mut watch)
                }
            };
            if let Some(segment) = last {
                self.remember((segment.start_s, segment.start_rad), drive);
            }
            if arrived {
                return;
            }
        }
    }
}

/// A stretch of carrier steps short enough for a cubic between its ends.
fn carrier_step(
    model: &mut Carrier,
    time: &mut f64,
    until_s: f64,
    drive: Drive,
    longest: f64,
    modulation: &Modulation,
    observe: &mut dyn FnMut(&Segment),
) -> bool {
    const STRETCH_S: f64 = 5e-5;
    let left = until_s - *time;
    if left <= 0.0 {
        return true;
    }
    let h = left.min(STRETCH_S).min(longest);
    let (start_s, start_rad, start_rad_s) = (*time, model.state()[6], model.state()[7]);
    model.run(h, drive, modulation);
    *time = if h >= left { until_s } else { start_s + h };
    let end = model.state();
    observe(&Segment { start_s, end_s: *time, start_rad, end_rad: end[6], start_rad_s, end_rad_s: end[7] });
    h >= left
}
