//! The averaged model: the wave's complex amplitude and the rotor, some thousand times cheaper than the carrier.
//!
//! The two modes together are one complex displacement w = w1 + i·w2, and the contact acts on it isotropically, so a wave
//! under a two-phase supply is w = a·exp(±iωt) with an amplitude `a` that changes over tenths of a millisecond. The rotor's height
//! follows the wave at some 20 kHz; its mean follows from Fint = Fext. What is left is `a` (one for each sense of
//! travel) and the rotor's angle and speed. `docs/model.md` derives it and shows how far it is from the carrier model.
//!
//! Each step is exponential: exact for a frozen contact, so it is stable at any size and the steps follow the changes, not
//! the fastest rate.

mod field;
mod rotor;

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
    half_slip_torque: f64,
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
            half_slip_torque: 0.5_f64.powf(m.slip_exponent),
            bristle: (m.bristle_nm_rad, m.bristle_nms_rad),
            radius: contact.radius_m,
            inertia_inv: 1.0 / p.rotor_inertia_kg_m2,
            rotational_damping: p.rotational_damping_nms,
            wmin: p.wmin_m(),
        }
    }
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
}
