//! The averaged model: the wave's complex amplitude and the rotor, some thousand times cheaper than the carrier.
//!
//! The two modes together are one complex displacement w = w1 + i·w2, and the contact acts on it isotropically, so a wave
//! under a two-phase supply is w = a·exp(±iωt) with an amplitude `a` that changes over tenths of a millisecond. The rotor's height
//! follows the wave at some 20 kHz; its mean follows from Fint = Fext. What is left is `a` (one for each sense of
//! travel) and the rotor's angle and speed. `docs/model.md` derives it and shows how far it is from the carrier model.
//!
//! Each step is exponential: exact for a frozen contact, so it is stable at any size and the steps follow the changes, not
//! the fastest rate.

use super::arccosine::acos;
use super::carrier::CREEP_RAD_S;
use super::contact::Contact;
use super::half_contact_table::HalfContactTable;
use super::modulation::Modulation;
use super::momentary::{Complex, Momentary};
use super::parameters::{Flavour, Parameters};
use super::plant::{Drive, Segment};
use super::stretches::Stretches;
use std::f64::consts::PI;

/// Largest change of the wave and of the rotor in one step, as a share of the largest amplitude and speed.
const CHANGE: f64 = 0.06;
/// Longest step while anything changes (s).
const LONGEST_S: f64 = 1e-3;
/// Shortest step (s): a bound on the work, whatever the parameters.
const SHORTEST_S: f64 = 1e-7;
/// Changes smaller than this, as the same share, over all that is left of an interval are none.
const STILL: f64 = 1e-5;

/// What a step needs of parameters and modulation.
#[derive(Debug, Clone, Copy)]
struct Coefficients {
    omega: f64,
    /// Supply force over modal mass at full level (m/s²).
    source: f64,
    /// Q without contact: Ω² − ω² (1/s²); its imaginary part ω·Cs/Ms.
    detuning: Complex,
    /// 1/(2iω + Cs/Ms), and its square.
    slow: Complex,
    slow2: Complex,
    /// Normal and tangential feedback over Ms.
    normal: f64,
    tangential: f64,
    force: f64,
    rotor_per_crest: f64,
    friction: f64,
    off_friction: f64,
    preload: f64,
    load: f64,
    brake: f64,
    off_brake: f64,
    stribeck: f64,
    stribeck_speed_inv: f64,
    exponent: f64,
    slip_excess: f64,
    bristle: (f64, f64),
    radius: f64,
    inertia_inv: f64,
    rotational_damping: f64,
    wmin: f64,
}

impl Coefficients {
    fn new(p: &Parameters, flavour: Flavour, m: &Modulation) -> Self {
        let contact = Contact::new(p);
        let omega = p.omega() + 2.0 * PI * m.drive_shift_hz;
        let resonance = 2.0 * PI * (p.resonance_hz() + m.resonance_shift_hz);
        let damping = p.modal_damping_ns_m / p.modal_mass_kg;
        let slow = Complex::new(damping, 2.0 * omega).inverse();
        Coefficients {
            omega,
            source: m.voltage * p.force_factor_n_v * p.vmax() / p.modal_mass_kg,
            detuning: Complex::new(resonance * resonance - omega * omega, omega * damping),
            slow,
            slow2: slow.times(slow),
            normal: contact.normal_n_m / p.modal_mass_kg,
            tangential: contact.tangential_n_m / p.modal_mass_kg,
            force: contact.force_n_m,
            rotor_per_crest: match flavour {
                Flavour::Thesis | Flavour::Measured => contact.surface * omega / (contact.radius_m * contact.radius_m),
                Flavour::Physical => contact.surface / contact.radius_m,
            },
            friction: p.friction * m.friction,
            off_friction: p.off_friction * m.off_friction,
            preload: p.preload_n * m.preload,
            load: p.load_nm + m.load_nm,
            brake: m.brake_nm,
            // As listed, the contact's own torque goes with the wave: what is left without one is added.
            off_brake: m.off_brake_nm
                + if flavour.is_listed() { p.off_friction_nm(flavour) * m.preload * m.friction } else { 0.0 },
            stribeck: m.stribeck_nm,
            stribeck_speed_inv: 1.0 / m.stribeck_rad_s,
            exponent: m.contact_exponent,
            slip_excess: m.slip_excess,
            bristle: (m.bristle_nm_rad, m.bristle_nms_rad),
            radius: contact.radius_m,
            inertia_inv: 1.0 / p.rotor_inertia_kg_m2,
            rotational_damping: p.rotational_damping_nms,
            wmin: p.wmin_m(),
        }
    }
}

/// The contact at one amplitude of the wave.
#[derive(Debug, Clone, Copy, Default)]
struct Pressed {
    phi: f64,
    zeta: f64,
    /// β(φ), and the integral of (cos − ζ)·cos over the contact.
    beta: f64,
    work: f64,
    friction: f64,
    /// Share of the torque the listing's unfloored amplitude leaves; 1 in the physical flavour.
    share: f64,
    /// The measure in which the wave is gone, 0 to 1.
    gone: f64,
}

/// The averaged model of one motor.
#[derive(Debug, Clone)]
pub struct Averaged {
    parameters: Parameters,
    flavour: Flavour,
    modulation: Modulation,
    coefficients: Coefficients,
    table: &'static HalfContactTable,
    /// Envelopes of the waves travelling clockwise and counter-clockwise (m), each in its own rotating frame.
    waves: [Complex; 2],
    position_rad: f64,
    speed_rad_s: f64,
    time_s: f64,
    /// Reference amplitude and speed, of the steady wave: what step sizes and "gone" are measured against.
    reference_m: f64,
    reference_rad_s: f64,
    /// Depth of the contact under the reference wave (m): where a stiffening contact has the linear one's stiffness.
    reference_depth_m: f64,
    /// Deflection of the bristles of a resting contact (rad).
    bristle_rad: f64,
    /// What the crest's turning added to amplitude·ω one step ago (m/s).
    turning: f64,
    steps: u64,
    stretches: Stretches,
}

impl Averaged {
    /// A motor at rest.
    pub fn new(parameters: Parameters, flavour: Flavour) -> Self {
        let coefficients = Coefficients::new(&parameters, flavour, &Modulation::NONE);
        let mut model = Averaged {
            parameters,
            flavour,
            modulation: Modulation::NONE,
            coefficients,
            table: HalfContactTable::shared(),
            waves: [Complex::ZERO; 2],
            position_rad: 0.0,
            speed_rad_s: 0.0,
            time_s: 0.0,
            reference_m: 0.0,
            reference_rad_s: 0.0,
            reference_depth_m: 1.0,
            bristle_rad: 0.0,
            turning: 0.0,
            steps: 0,
            stretches: Stretches::default(),
        };
        let linear = coefficients.source / coefficients.detuning.square().sqrt();
        model.reference_m = linear.max(1e-12);
        model.reference_rad_s = model.crest(model.reference_m).max(1e-6);
        let pressed = model.press(model.reference_m);
        model.reference_depth_m = (model.reference_m * (1.0 - pressed.zeta)).max(1e-15);
        model
    }

    /// Time since the start (s).
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Rotor angle (rad).
    pub fn position_rad(&self) -> f64 {
        self.position_rad
    }

    /// Rotor speed (rad/s).
    pub fn speed_rad_s(&self) -> f64 {
        self.speed_rad_s
    }

    /// Amplitude of the wave (m).
    pub fn amplitude_m(&self) -> f64 {
        (self.waves[0].square() + self.waves[1].square()).sqrt()
    }

    /// Rotor height at which the contact carries the preload (m).
    pub fn height_m(&self) -> f64 {
        let amplitude = self.amplitude_m();
        let pressed = self.press(amplitude);
        let floored = if self.flavour.is_listed() { amplitude.max(self.coefficients.wmin) } else { amplitude };
        if floored > 0.0 {
            pressed.zeta * self.parameters.radial_shape * floored
        } else {
            -self.coefficients.preload * self.parameters.radial_shape / (PI * self.coefficients.force)
        }
    }

    /// Steps taken since the start.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Sets the rotor's angle and speed.
    pub fn set_rotor(&mut self, position_rad: f64, speed_rad_s: f64) {
        self.position_rad = position_rad;
        self.speed_rad_s = speed_rad_s;
    }

    pub(super) fn momentary(&self) -> Momentary {
        Momentary {
            waves: self.waves,
            speed_rad_s: self.speed_rad_s,
            turning: self.turning,
            bristle_rad: self.bristle_rad,
        }
    }

    /// Goes on from elsewhere.
    pub(super) fn resume(&mut self, time_s: f64, position_rad: f64, from: Momentary) {
        self.time_s = time_s;
        self.position_rad = position_rad;
        self.waves = from.waves;
        self.speed_rad_s = from.speed_rad_s;
        self.turning = from.turning;
        self.bristle_rad = from.bristle_rad;
    }

    /// Takes over what the effects change.
    pub fn modulate(&mut self, modulation: &Modulation) {
        if *modulation != self.modulation {
            self.modulation = *modulation;
            self.coefficients = Coefficients::new(&self.parameters, self.flavour, modulation);
            self.stretches.modulate(modulation);
        }
    }

    /// Rotor speed at which the rotor keeps up with the crest of a steady wave of this amplitude (rad/s).
    #[inline]
    fn crest(&self, amplitude: f64) -> f64 {
        let c = &self.coefficients;
        match self.flavour {
            Flavour::Thesis | Flavour::Measured => c.rotor_per_crest * amplitude,
            Flavour::Physical => c.rotor_per_crest * amplitude * c.omega,
        }
    }

    #[inline]
    fn press(&self, amplitude: f64) -> Pressed {
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
    fn feedback(&self, pressed: &Pressed, ratio: f64) -> (f64, f64) {
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

    /// Advances to `until_s` under a constant drive, reporting every step taken.
    pub fn advance(&mut self, until_s: f64, drive: Drive, observe: &mut dyn FnMut(&Segment)) {
        self.advance_at_most(until_s, drive, f64::INFINITY, observe);
    }

    /// As [`Averaged::advance`], remembering what it did: a stretch that starts from the same state under the same drive as one
    /// before is replayed, not computed. A motor that stops in every off part repeats itself exactly.
    pub fn advance_remembering(&mut self, until_s: f64, drive: Drive, observe: &mut dyn FnMut(&Segment)) {
        let start = self.momentary();
        let (start_s, start_rad) = (self.time_s, self.position_rad);
        if until_s <= start_s {
            return;
        }
        if let Some((end_rad, end)) = self.stretches.replay(&start, (start_s, start_rad), until_s, drive, observe) {
            self.resume(until_s, end_rad, end);
            return;
        }
        let mut steps = Vec::new();
        while !self.step(until_s, drive, f64::INFINITY, &mut |segment| {
            steps.push((segment.end_s - start_s, segment.end_rad - start_rad, segment.end_rad_s));
            observe(segment);
        }) {}
        let end = self.momentary();
        self.stretches.keep(&start, until_s - start_s, drive, steps, end);
    }

    /// Whether the rotor comes to rest soon after the wave: then even short stretches come again.
    pub(super) fn stops(&self) -> bool {
        self.flavour == Flavour::Physical
    }

    /// As [`Averaged::advance`], in one step of at most `longest_s` and never past `until_s`. Returns whether it got there.
    pub fn step(&mut self, until_s: f64, drive: Drive, longest_s: f64, observe: &mut dyn FnMut(&Segment)) -> bool {
        let left = until_s - self.time_s;
        if left <= 0.0 {
            return true;
        }
        let start = (self.time_s, self.position_rad, self.speed_rad_s);
        let taken = self.take(left.min(longest_s), drive);
        self.time_s = if taken >= left { until_s } else { self.time_s + taken };
        self.steps += 1;
        observe(&Segment {
            start_s: start.0,
            end_s: self.time_s,
            start_rad: start.1,
            end_rad: self.position_rad,
            start_rad_s: start.2,
            end_rad_s: self.speed_rad_s,
        });
        taken >= left
    }

    fn advance_at_most(&mut self, until_s: f64, drive: Drive, longest_s: f64, observe: &mut dyn FnMut(&Segment)) {
        while !self.step(until_s, drive, longest_s, observe) {}
    }

    /// One step of at most `longest` seconds; returns the seconds taken.
    fn take(&mut self, longest: f64, drive: Drive) -> f64 {
        let c = self.coefficients;
        let forced = usize::from(drive.sign() < 0.0);
        let source = [0, 1].map(|i| if i == forced { drive.level * c.source } else { 0.0 });
        let gone = self.gone_m();
        for (wave, source) in self.waves.iter_mut().zip(source) {
            if source == 0.0 && wave.square() < gone * gone {
                *wave = Complex::ZERO;
            }
        }
        if source == [0.0; 2] && self.waves == [Complex::ZERO; 2] {
            self.turning = 0.0;
            let contact = match self.flavour {
                Flavour::Thesis | Flavour::Measured => 0.0,
                Flavour::Physical => c.off_friction * c.preload * c.radius,
            };
            let limit = contact + c.brake + c.off_brake + self.stribeck(self.speed_rad_s);
            return if c.bristle.0 > 0.0 { self.bristle(longest, limit) } else { self.coast(longest, limit) };
        }

        self.bristle_rad = 0.0;
        let now = self.field(self.waves, source, self.turning);
        let v0 = self.speed_rad_s;
        let (f0, s0) = self.accelerate(&now, v0);

        // The step: neither the waves nor the rotor may change by more than CHANGE of their references.
        let pace = (now.change[0].square() + now.change[1].square()).sqrt();
        let mut h = longest.min(LONGEST_S).min(CHANGE * self.reference_m / pace.max(1e-300));
        if self.flavour.is_listed() {
            // The listed torque goes with the wave's amplitude all the way down.
            h = h.min(0.25 * self.amplitude_m().max(3e-3 * self.reference_m) / pace.max(1e-300));
        }
        if f0.abs() > CHANGE * self.reference_rad_s * s0.abs() {
            h = h.min((CHANGE * self.reference_rad_s / f0.abs()).max(1e-6));
        }
        if pace * longest < STILL * self.reference_m && f0.abs() < STILL * self.reference_rad_s * s0.abs() {
            // Nothing moves but the angle: one step to the end.
            h = longest;
        }

        h = h.max(SHORTEST_S).min(longest);
        let half = self.relax(&now, 0.5 * h);
        let middle = self.field(half, source, self.turning);
        self.waves = self.relax(&middle, h);
        let end = self.field(self.waves, source, self.turning);
        self.turning = end.turning;
        self.turn(&end, h, f0, s0);
        h
    }

    #[inline]
    fn stribeck(&self, speed: f64) -> f64 {
        let c = &self.coefficients;
        if c.stribeck == 0.0 { 0.0 } else { c.stribeck * (-(speed * c.stribeck_speed_inv).powi(2)).exp() }
    }

    fn gone_m(&self) -> f64 {
        self.reference_m
            * match self.flavour {
                Flavour::Thesis | Flavour::Measured => 1e-4,
                Flavour::Physical => 3e-3,
            }
    }

    /// The waves `h` later, had the contact stayed as it is.
    #[inline]
    fn relax(&self, field: &Field, h: f64) -> [Complex; 2] {
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
    fn field(&self, waves: [Complex; 2], source: [f64; 2], turning: f64) -> Field {
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

    /// Rotor acceleration (rad/s²) and its slope with the speed (1/s).
    #[inline]
    fn accelerate(&self, field: &Field, speed: f64) -> (f64, f64) {
        let c = &self.coefficients;
        let Field { pressed: Pressed { phi, zeta, beta, .. }, sense, crest, limit, .. } = *field;
        let (share, slope) = match c.slip_excess {
            0.0 => share(sense * speed / crest, phi, zeta, beta),
            excess => soft_share(sense * speed / crest, phi, zeta, beta, excess),
        };
        let fading = (speed / CREEP_RAD_S).clamp(-1.0, 1.0);
        let brake = c.brake + c.off_brake * field.gone + self.stribeck(speed);
        let torque = sense * limit * share - c.rotational_damping * speed - c.load - brake * fading;
        (torque * c.inertia_inv, (limit * slope / crest - c.rotational_damping) * c.inertia_inv)
    }

    /// The rotor `h` later, from acceleration `f0` and slope `s0` at the start to the contact at the end.
    ///
    /// The acceleration is taken as linear in time and speed, and solved exactly. The slope is the secant over the step, found
    /// by iteration: the torque has kinks where the rotor overtakes the first or the last of the contact.
    #[inline]
    fn turn(&mut self, end: &Field, h: f64, f0: f64, s0: f64) {
        let v0 = self.speed_rad_s;
        let (late, late_slope) = self.accelerate(end, v0);
        let drift = late - f0;
        let mut slope = 0.5 * (s0 + late_slope);
        let tolerance = 1e-3 * self.reference_rad_s;
        let (mut phi1, mut phi2) = phis(slope * h);
        let mut v1 = v0 + h * (phi1 * f0 + phi2 * drift);
        for _ in 0..4 {
            // A guess beyond the crest would see only the flat brake there.
            let top = end.crest * end.sense;
            if (v1 - top) * (v0 - top) < 0.0 {
                v1 = top;
            }
            if (v1 - v0).abs() < 1e-9 * self.reference_rad_s {
                break;
            }
            let (f1, _) = self.accelerate(end, v1);
            let secant = ((f1 - late) / (v1 - v0)).min(0.0);
            (phi1, phi2) = phis(secant * h);
            slope = secant;
            let better = v0 + h * (phi1 * f0 + phi2 * drift);
            let moved = (better - v1).abs();
            v1 = better;
            if moved < tolerance {
                break;
            }
        }
        // ∫ of the same linear solution.
        let x = slope * h;
        let phi3 = if x.abs() < 1e-2 { 1.0 / 6.0 + x / 24.0 + x * x / 120.0 } else { (phi2 - 0.5) / x };
        self.position_rad += h * (v0 + h * (phi2 * f0 + phi3 * drift));
        self.speed_rad_s = v1;
    }

    /// The rotor `h` later at a constant acceleration and slope.
    fn glide(&mut self, h: f64, acceleration: f64, slope: f64) {
        let (phi1, phi2) = phis(slope * h);
        self.position_rad += h * (self.speed_rad_s + h * acceleration * phi2);
        self.speed_rad_s += acceleration * h * phi1;
    }

    /// No wave, and a contact of bristles that bend before they slide (LuGre without the Stribeck term, whose limit is `limit`):
    /// the bristle's relaxation is solved exactly, the rotor on it implicitly, so any stiffness is stable.
    fn bristle(&mut self, longest: f64, limit: f64) -> f64 {
        let c = self.coefficients;
        let (stiffness, damping) = c.bristle;
        if self.speed_rad_s.abs() < 1e-7 && (stiffness * self.bristle_rad + c.load).abs() < 1e-6 * limit {
            self.speed_rad_s = 0.0;
            return longest;
        }
        let period = (stiffness * c.inertia_inv).sqrt();
        let h = longest.min((0.15 / period).max(1e-5));
        let v = self.speed_rad_s;
        let bent = self.bristle_rad;
        let slide = stiffness * v.abs() / limit.max(1e-12);
        // Linearly implicit in speed and deflection: z' = v − slide·z, J·v' = −σ0·z − σ1·z' − Cθ·v − load.
        let z_v = h / (1.0 + h * slide);
        let z_0 = bent / (1.0 + h * slide);
        let k = h * c.inertia_inv;
        let a = 1.0 + k * (stiffness * z_v + damping * (1.0 - slide * z_v) + c.rotational_damping);
        let b = v - k * (stiffness * z_0 - damping * slide * z_0 + c.load);
        let speed = b / a;
        self.bristle_rad = z_0 + z_v * speed;
        self.position_rad += 0.5 * h * (v + speed);
        self.speed_rad_s = speed;
        h
    }

    /// No wave: the rotor under Coulomb friction `limit` (N·m), viscous friction and load; stops, and stays stopped while
    /// the friction can hold it.
    fn coast(&mut self, longest: f64, limit: f64) -> f64 {
        let c = self.coefficients;
        let slope = -c.rotational_damping * c.inertia_inv;
        if self.speed_rad_s == 0.0 {
            if c.load.abs() <= limit {
                return longest;
            }
            let acceleration = (-c.load + limit * c.load.signum()) * c.inertia_inv;
            self.glide(longest, acceleration, slope);
            return longest;
        }
        let sense = self.speed_rad_s.signum();
        let acceleration = -(c.load + limit * sense) * c.inertia_inv + slope * self.speed_rad_s;
        let before = self.speed_rad_s;
        let stop = if acceleration * sense < 0.0 {
            // Exact with viscous friction: v(t) = v + a·(exp(st) − 1)/s.
            let y = -before * slope / acceleration;
            if slope.abs() < 1e-12 || y.abs() < 1e-12 { -before / acceleration } else { y.ln_1p() / slope }
        } else {
            f64::INFINITY
        };
        let h = longest.min(if stop.is_nan() { f64::INFINITY } else { stop });
        self.glide(h, acceleration, slope);
        if h < longest {
            self.speed_rad_s = 0.0;
        }
        h.max(1e-9)
    }
}

/// φ1(x) = (eˣ − 1)/x and φ2(x) = (φ1 − 1)/x, of exponential integrators.
#[inline]
fn phis(x: f64) -> (f64, f64) {
    if x.abs() < 2e-2 {
        let phi2 = 0.5 + x * (1.0 / 6.0 + x * (1.0 / 24.0 + x / 120.0));
        (1.0 + x * phi2, phi2)
    } else {
        let phi1 = x.exp_m1() / x;
        (phi1, (phi1 - 1.0) / x)
    }
}

/// The drive share of [`super::contact::drive_share`] with β(φ) known, and its slope with the speed ratio.
#[inline]
fn share(ratio: f64, phi: f64, zeta: f64, beta: f64) -> (f64, f64) {
    if ratio <= zeta.max(-1.0) {
        return (if zeta < -1.0 { 2.0 * (-zeta * PI) / beta - 1.0 } else { 1.0 }, 0.0);
    }
    if ratio >= 1.0 || phi <= 0.0 {
        return (-1.0, 0.0);
    }
    let psi = acos(ratio);
    let sin = (1.0 - ratio * ratio).sqrt();
    (2.0 * (sin - zeta * psi) / beta - 1.0, -2.0 * (ratio - zeta) / (beta * sin.max(1e-3)))
}

/// [`share`] of a soft contact, which takes a slip for a torque beyond the rigid one's: share(ratio + excess·balanced·s) = s, where
/// `balanced` is the ratio at which the rigid contact gives none. The left side falls and the right one rises with s.
fn soft_share(ratio: f64, phi: f64, zeta: f64, beta: f64, excess: f64) -> (f64, f64) {
    let root = |low: f64, high: f64, f: &dyn Fn(f64) -> f64| {
        let (mut low, mut high) = (low, high);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if f(middle) > 0.0 { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    };
    let balanced = root(zeta.clamp(-1.0, 1.0), 1.0, &|r| share(r, phi, zeta, beta).0).max(0.0);
    let slip = excess * balanced;
    let soft = root(-1.0, 1.0, &|s| share(ratio + slip * s, phi, zeta, beta).0 - s);
    let slope = share(ratio + slip * soft, phi, zeta, beta).1;
    (soft, slope / (1.0 - slip * slope))
}

/// The contact and the rates of one instant.
#[derive(Debug, Clone, Copy, Default)]
struct Field {
    pressed: Pressed,
    /// Sense of travel of the stronger wave, ±1.
    sense: f64,
    /// Rotor speed that keeps up with the crest (rad/s).
    crest: f64,
    /// Torque the contact can transmit (N·m).
    limit: f64,
    /// The measure in which the wave is gone, 0 to 1.
    gone: f64,
    /// λ of either envelope (1/s), where it would settle (m), and its present rate (m/s).
    rate: [Complex; 2],
    target: [Complex; 2],
    change: [Complex; 2],
    /// What the crest's turning adds to amplitude·ω (m/s).
    turning: f64,
}
