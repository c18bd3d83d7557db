//! The contact and the rates of one instant of the averaged model.

use super::Averaged;
use crate::arccosine::acos;
use crate::carrier::CREEP_RAD_S;
use crate::momentary::Complex;
use crate::parameters::Flavour;
use std::f64::consts::PI;

/// The contact at one amplitude of the wave.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Pressed {
    pub(super) phi: f64,
    pub(super) zeta: f64,
    /// β(φ), and the integral of (cos − ζ)·cos over the contact.
    pub(super) beta: f64,
    pub(super) work: f64,
    pub(super) friction: f64,
    /// Share of the torque the listing's unfloored amplitude leaves; 1 in the physical flavour.
    pub(super) share: f64,
    /// The measure in which the wave is gone, 0 to 1.
    pub(super) gone: f64,
}

/// The contact and the rates of one instant.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Field {
    pub(super) pressed: Pressed,
    /// Sense of travel of the stronger wave, ±1.
    pub(super) sense: f64,
    /// Rotor speed that keeps up with the crest (rad/s).
    pub(super) crest: f64,
    /// Torque the contact can transmit (N·m).
    pub(super) limit: f64,
    /// The measure in which the wave is gone, 0 to 1.
    pub(super) gone: f64,
    /// λ of either envelope (1/s), where it would settle (m), and its present rate (m/s).
    pub(super) rate: [Complex; 2],
    pub(super) target: [Complex; 2],
    pub(super) change: [Complex; 2],
    /// What the crest's turning adds to amplitude·ω (m/s).
    pub(super) turning: f64,
}

impl Averaged {
    /// Rotor speed at which the rotor keeps up with the crest of a steady wave of this amplitude (rad/s).
    #[inline]
    pub(super) fn crest(&self, amplitude: f64) -> f64 {
        let c = &self.coefficients;
        match self.flavour {
            Flavour::Thesis | Flavour::Measured => c.rotor_per_crest * amplitude,
            Flavour::Physical => c.rotor_per_crest * amplitude * c.omega,
        }
    }

    #[inline]
    pub(super) fn press(&self, amplitude: f64) -> Pressed {
        let c = &self.coefficients;
        let (floored, share) = match self.flavour {
            Flavour::Thesis | Flavour::Measured => {
                let floored = amplitude.max(c.wmin);
                (floored, amplitude / floored)
            }
            Flavour::Physical => (amplitude.max(1e-8 * self.reference_m), 1.0),
        };
        let mut q = c.preload / (c.force * floored);
        let (mut phi, mut cos) = self.table.at(q);
        if c.exponent != 1.0 {
            // A contact that stiffens with depth, as the linear one with the secant stiffness of its deepest point.
            let linear = q;
            for _ in 0..6 {
                let depth = floored * (1.0 - if q >= PI { -q / PI } else { cos });
                let stiffer = (depth / self.reference_depth_m).powf(c.exponent - 1.0);
                q = (q * linear / stiffer).sqrt();
                (phi, cos) = self.table.at(q);
            }
        }
        let (zeta, beta) = if q >= PI && self.flavour == Flavour::Physical { (-q / PI, q) } else { (cos, q.min(PI)) };
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let closed = match self.flavour {
            Flavour::Thesis | Flavour::Measured => 1.0 - share,
            Flavour::Physical => ((phi - 0.5 * PI) / (0.5 * PI)).max(0.0),
        };
        let friction = match self.flavour {
            Flavour::Thesis | Flavour::Measured => c.friction,
            Flavour::Physical => c.friction + (c.off_friction - c.friction) * closed,
        };
        Pressed { phi, zeta, beta, work: phi + sin * cos - 2.0 * zeta * sin, friction, share, gone: closed }
    }

    /// G1 and G2 of the tangential feedback (section A.5.4).
    #[inline]
    pub(super) fn feedback(&self, pressed: &Pressed, ratio: f64) -> (f64, f64) {
        let Pressed { phi, zeta, work, .. } = *pressed;
        let clipped = ratio.clamp(-1.0, 1.0);
        let (psi, cos) = if clipped <= zeta { (phi, zeta.max(-1.0)) } else { (acos(clipped), clipped) };
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let g1 = 2.0 * (psi + sin * cos - 2.0 * zeta * sin) - work;
        let g2 = match self.flavour {
            Flavour::Thesis | Flavour::Measured => {
                2.0 * sin * sin - (1.0 - zeta * zeta) - 2.0 * zeta * zeta + 4.0 * zeta * cos - 2.0
            }
            Flavour::Physical => 0.0,
        };
        (g1, g2)
    }

    /// The waves `h` later, had the contact stayed as it is.
    #[inline]
    pub(super) fn relax(&self, field: &Field, h: f64) -> [Complex; 2] {
        [0, 1].map(|i| {
            let away = self.waves[i].minus(field.target[i]);
            if away == Complex::ZERO {
                self.waves[i]
            } else {
                field.target[i].plus(away.times(field.rate[i].scaled(h).exp()))
            }
        })
    }

    /// The contact and the rates of both envelopes. `turning` is how far the crest's turning rate was from the drive's one
    /// evaluation ago: it changes slowly, and the stick angle needs it before the rates are known.
    #[inline]
    pub(super) fn field(&self, waves: [Complex; 2], source: [f64; 2], turning: f64) -> Field {
        let c = &self.coefficients;
        let (cw, ccw) = (waves[0].square(), waves[1].square());
        let amplitude = (cw + ccw).sqrt();
        let sense = if cw > ccw || (cw == ccw && source[1] == 0.0) { 1.0 } else { -1.0 };
        let pressed = self.press(amplitude);
        let purity = if ccw == 0.0 || cw == 0.0 { 1.0 } else { (cw - ccw).abs() / (cw + ccw) };
        let (crest, creep) = match self.flavour {
            Flavour::Thesis | Flavour::Measured => (c.rotor_per_crest * amplitude.max(c.wmin), 1.0),
            Flavour::Physical => {
                let crest = c.rotor_per_crest * purity * (amplitude * c.omega + turning);
                (crest.max(CREEP_RAD_S), (crest / CREEP_RAD_S).clamp(0.0, 1.0))
            }
        };
        let (g1, g2) = self.feedback(&pressed, sense * self.speed_rad_s / crest);
        let drag = pressed.friction * c.tangential * creep;
        let mut field = Field {
            pressed,
            sense,
            crest,
            limit: pressed.friction * pressed.share * c.preload * c.radius,
            gone: pressed.gone,
            ..Field::default()
        };
        for i in 0..2 {
            if source[i] == 0.0 && waves[i] == Complex::ZERO {
                continue;
            }
            let along = if (i == 0) == (sense > 0.0) { drag } else { -drag };
            let q = Complex::new(c.detuning.re + c.normal * pressed.work + drag * g2, c.detuning.im + along * g1);
            // Slow root of λ² + (2iω + Cs/Ms)·λ + Q = 0, to second order in Q.
            let x = q.times(c.slow2);
            let bracket = Complex::new(1.0 + x.re, x.im).plus(x.times(x).scaled(2.0));
            field.rate[i] = q.times(c.slow).times(bracket).scaled(-1.0);
            if source[i] != 0.0 {
                field.target[i] = q.inverse().scaled(source[i]);
            }
            field.change[i] = field.rate[i].times(waves[i].minus(field.target[i]));
        }
        if self.flavour == Flavour::Physical && amplitude > 0.0 {
            let lead = usize::from(sense < 0.0);
            let (w, d) = (waves[lead], field.change[lead]);
            field.turning = (w.re * d.im - w.im * d.re) / amplitude;
        }
        field
    }
}
