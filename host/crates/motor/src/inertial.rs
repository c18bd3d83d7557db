//! An ordinary motor: inertia, viscous and Coulomb friction, and a torque proportional to its input.

use super::effects::EffectSet;
use super::plant::{Drive, Plant, Segment};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Parameters of [`InertialPlant`]: J·v' = K·input − B·v − Tc·sign(v) − load.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct InertialParameters {
    /// J (kg·m²).
    pub inertia_kg_m2: f64,
    /// B (N·m·s).
    pub viscous_nms: f64,
    /// Tc (N·m).
    pub coulomb_nm: f64,
    /// K, torque at input 1 (N·m).
    pub gain_nm: f64,
}

impl InertialParameters {
    /// From a no-load speed (rad/s), a time constant (s) and the Coulomb friction as a share of the full torque: only ratios
    /// show in motion, so the inertia is taken as 1 kg·m².
    pub fn from_motion(no_load_rad_s: f64, time_constant_s: f64, coulomb_share: f64) -> Self {
        let viscous = 1.0 / time_constant_s;
        let gain = no_load_rad_s * viscous / (1.0 - coulomb_share);
        InertialParameters { inertia_kg_m2: 1.0, viscous_nms: viscous, coulomb_nm: coulomb_share * gain, gain_nm: gain }
    }
}

/// Longest step (s).
const LONGEST_S: f64 = 1e-3;

/// An ordinary motor behind the plant seam. The plant effects that are not about a wave act on it too: direction-asymmetry,
/// gravity-load, stribeck-friction, off-phase-braking (while the input is 0), supply-sag, run-in-wear and preload-runout (as a
/// torque that varies round the rotor).
#[derive(Debug, Clone)]
pub struct InertialPlant {
    parameters: InertialParameters,
    effects: EffectSet,
    time_s: f64,
    position_rad: f64,
    speed_rad_s: f64,
    current: f64,
    revolutions: f64,
}

impl InertialPlant {
    /// A motor at rest.
    pub fn new(parameters: InertialParameters, effects: &EffectSet) -> Self {
        InertialPlant {
            parameters,
            effects: effects.clone(),
            time_s: 0.0,
            position_rad: 0.0,
            speed_rad_s: 0.0,
            current: 0.0,
            revolutions: 0.0,
        }
    }

    /// Driving torque, load and friction limit (N·m).
    fn torques(&self, drive: Drive) -> (f64, f64, f64) {
        let (e, p) = (&self.effects, &self.parameters);
        let sense = drive.sign();
        let mut torque = p.gain_nm * drive.level * sense;
        let mut load = 0.0;
        let mut limit = p.coulomb_nm;
        if let Some(e) = e.direction_asymmetry {
            torque *= 1.0 + sense * e.gain;
            limit *= 1.0 + sense * e.friction;
        }
        if let Some(e) = e.preload_runout {
            torque *= 1.0 + e.relative(self.position_rad);
        }
        if let Some(e) = e.supply_sag {
            torque *= 1.0 - e.sag * self.current;
        }
        if let Some(e) = e.run_in_wear {
            let [gain, friction] = e.changes(self.revolutions);
            torque *= (1.0 + gain).max(0.0);
            limit *= (1.0 + friction).max(0.0);
        }
        if let Some(e) = e.gravity_load {
            load += e.torque_nm * (self.position_rad + e.phase_rad).sin();
        }
        if let Some(e) = e.stribeck_friction {
            limit += e.torque_nm * (-(self.speed_rad_s / e.speed_rad_s).powi(2)).exp();
        }
        if let (Some(e), true) = (e.off_phase_braking, drive.level == 0.0) {
            limit += e.torque_nm;
        }
        (torque, load, limit)
    }
}

impl Plant for InertialPlant {
    fn time_s(&self) -> f64 {
        self.time_s
    }

    fn position_rad(&self) -> f64 {
        self.position_rad
    }

    fn speed_rad_s(&self) -> f64 {
        self.speed_rad_s
    }

    fn advance(&mut self, until_s: f64, drive: Drive, observe: &mut dyn FnMut(&Segment)) {
        let p = self.parameters;
        while self.time_s < until_s {
            let (torque, load, limit) = self.torques(drive);
            let left = until_s - self.time_s;
            let rate = p.viscous_nms / p.inertia_kg_m2;
            let v0 = self.speed_rad_s;
            let start = (self.time_s, self.position_rad);
            let net = torque - load;
            let stuck = v0 == 0.0 && net.abs() <= limit;
            let mut h = if stuck && self.effects == EffectSet::default() { left } else { left.min(LONGEST_S) };
            if !stuck {
                let sense = if v0 == 0.0 { net.signum() } else { v0.signum() };
                let target_rate = (net - sense * limit) / p.inertia_kg_m2;
                // v(t) = v0 + (target_rate − rate·v0)·(1 − exp(−rate·t))/rate, exactly.
                let acceleration = target_rate - rate * v0;
                let mut end = (v0, 0.0);
                let travel = |h: f64| {
                    let x = -rate * h;
                    let phi1 = if x.abs() < 1e-9 { 1.0 } else { x.exp_m1() / x };
                    let phi2 = if x.abs() < 1e-5 { 0.5 + x / 6.0 } else { (phi1 - 1.0) / x };
                    (v0 + acceleration * h * phi1, v0 * h + acceleration * h * h * phi2)
                };
                if v0 != 0.0 && acceleration * sense < 0.0 {
                    let y = v0 * rate / acceleration;
                    let stop = if rate * v0.abs() < 1e-9 * acceleration.abs() {
                        -v0 / acceleration
                    } else {
                        -y.ln_1p() / rate
                    };
                    if stop.is_finite() && stop < h {
                        h = stop.max(1e-12);
                        end = (0.0, travel(h).1);
                    } else {
                        end = travel(h);
                    }
                } else {
                    end = if h > 0.0 { travel(h) } else { end };
                }
                self.speed_rad_s = end.0;
                self.position_rad += end.1;
            }
            self.time_s = if h >= left { until_s } else { self.time_s + h };
            self.revolutions += (self.position_rad - start.1).abs() / (2.0 * PI);
            if let Some(e) = self.effects.supply_sag {
                self.current = drive.level + (self.current - drive.level) * (-h / e.tau_s).exp();
            }
            observe(&Segment {
                start_s: start.0,
                end_s: self.time_s,
                start_rad: start.1,
                end_rad: self.position_rad,
                start_rad_s: v0,
                end_rad_s: self.speed_rad_s,
            });
        }
    }
}
