//! Effects a measurement can hide: each one small type, with parameters, units, bounds and the value at which it is absent.
//!
//! An effect acts where it lives: in the plant (through [`super::modulation::Modulation`]), on the way from the duty to the plant
//! ([`super::actuator`]), in the encoder and its clock ([`super::sensor`]), or in the controller ([`super::closed_loop`]). Those that are
//! formulas ([`super::hypothesis`]) act by themselves. [`EffectSet`] holds any combination of them, and of a user's own;
//! [`catalogue`] lists them for whoever searches.

pub use super::effect_info::{EffectInfo, EffectParameter, Kind, Seat};
use super::formula_file::shipped_effects;
use super::hypothesis::Formula;
use std::sync::LazyLock;
use thiserror::Error;

/// A name or a value that will not do.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum EffectError {
    /// No effect of this name.
    #[error("no effect `{name}`: the names are {}", catalogue().iter().map(|e| e.name).collect::<Vec<_>>().join(", "))]
    Unknown {
        /// What was asked for.
        name: String,
    },
    /// The wrong number of values.
    #[error("effect `{name}` takes 1 to {expected} values, not {given}")]
    Count {
        /// The effect.
        name: &'static str,
        /// How many it takes at most.
        expected: usize,
        /// How many came.
        given: usize,
    },
    /// A value outside the bounds.
    #[error("effect `{effect}`: {parameter} = {value} is outside {lower} ..= {upper}")]
    OutOfBounds {
        /// The effect.
        effect: &'static str,
        /// The parameter.
        parameter: &'static str,
        /// What was given.
        value: f64,
        /// Smallest admissible value.
        lower: f64,
        /// Largest admissible value.
        upper: f64,
    },
}

macro_rules! effects {
    ($(
        $(#[$doc:meta])*
        $slot:ident: $type:ident, $name:literal, $seat:ident {
            $( $(#[$field_doc:meta])* $field:ident: $unit:literal, $kind:ident, [$lower:expr, $upper:expr], $absent:expr, $typical:expr; )+
        }
    )+) => {
        $(
            $(#[$doc])*
            #[derive(Debug, Clone, Copy, PartialEq)]
            pub struct $type { $( $(#[$field_doc])* pub $field: f64, )+ }

            impl $type {
                /// Its entry of the catalogue.
                pub const INFO: EffectInfo = EffectInfo {
                    name: $name,
                    seat: Seat::$seat,
                    parameters: &[ $( EffectParameter {
                        name: stringify!($field),
                        unit: $unit,
                        lower: $lower,
                        upper: $upper,
                        absent: $absent,
                        typical: $typical,
                        kind: Kind::$kind,
                    }, )+ ],
                };
                /// With every parameter at its absent value: changes nothing.
                pub const ABSENT: $type = $type { $( $field: $absent, )+ };
            }
        )+

        /// Every effect that is listed below, in the order of the catalogue.
        const LISTED: &[EffectInfo] = &[ $( $type::INFO, )+ ];

        /// Any combination of effects; the default is none.
        #[derive(Debug, Clone, PartialEq, Default)]
        pub struct EffectSet {
            $( #[doc = concat!("`", $name, "`.")] pub $slot: Option<$type>, )+
            /// Those that are formulas: of the catalogue, the user's own, and what a diagnosis described without a cause.
            pub formulas: Vec<Formula>,
        }

        impl EffectSet {
            /// Adds or replaces an effect by name, with its parameters in the order of its catalogue entry; those left out at the
            /// end keep their absent value.
            ///
            /// # Errors
            /// When there is no such effect, there is no value or one too many, or one is outside its bounds.
            pub fn set(&mut self, name: &str, values: &[f64]) -> Result<(), EffectError> {
                match name {
                    $( $name => {
                        check(&$type::INFO, values)?;
                        let mut values = values.iter().copied();
                        self.$slot = Some($type {
                            $( $field: values.next().unwrap_or($absent), )+
                        });
                        Ok(())
                    } )+
                    _ => self.set_formula(name, values),
                }
            }

            /// Removes an effect; one that is not there stays so.
            pub fn remove(&mut self, name: &str) {
                match name {
                    $( $name => self.$slot = None, )+
                    _ => self.formulas.retain(|f| f.hypothesis.name != name),
                }
            }

            /// Takes in what another combination has; an effect that both have becomes the other's.
            pub fn join(&mut self, other: &EffectSet) {
                $( self.$slot = other.$slot.or(self.$slot); )+
                other.formulas.iter().for_each(|f| self.put(f.clone()));
            }

            /// The effects of the catalogue that are present, with their values.
            pub fn present(&self) -> Vec<(&'static EffectInfo, Vec<f64>)> {
                let mut present = Vec::new();
                $( if let Some(effect) = self.$slot {
                    present.push((&$type::INFO, vec![ $( effect.$field, )+ ]));
                } )+
                let shipped = |f: &Formula| info(&f.hypothesis.name).ok().map(|info| (info, f.values.clone()));
                present.extend(self.formulas.iter().filter_map(shipped));
                present
            }
        }
    };
}

impl EffectSet {
    /// Adds a formula, or replaces the one of its name.
    pub fn put(&mut self, formula: Formula) {
        self.remove(&formula.hypothesis.name);
        self.formulas.push(formula);
    }

    fn set_formula(&mut self, name: &str, values: &[f64]) -> Result<(), EffectError> {
        let shipped = shipped_effects().iter().find(|h| h.name == name);
        let hypothesis = shipped.ok_or_else(|| EffectError::Unknown { name: name.to_owned() })?.clone();
        let info = info(name)?;
        check(info, values)?;
        let value = |(k, p): (usize, &EffectParameter)| values.get(k).copied().unwrap_or(p.absent);
        let values = info.parameters.iter().enumerate().map(value).collect();
        self.put(Formula { hypothesis, values, voltage_per_speed: 1.0 });
        Ok(())
    }
}

/// Every effect of the library.
pub fn catalogue() -> &'static [EffectInfo] {
    static ALL: LazyLock<Vec<EffectInfo>> = LazyLock::new(|| {
        LISTED.iter().copied().chain(shipped_effects().iter().map(|h| EffectInfo::of_formula(h))).collect()
    });
    &ALL
}

fn check(info: &EffectInfo, values: &[f64]) -> Result<(), EffectError> {
    if values.is_empty() || values.len() > info.parameters.len() {
        return Err(EffectError::Count { name: info.name, expected: info.parameters.len(), given: values.len() });
    }
    for (parameter, &value) in info.parameters.iter().zip(values) {
        if !(parameter.lower..=parameter.upper).contains(&value) {
            return Err(EffectError::OutOfBounds {
                effect: info.name,
                parameter: parameter.name,
                value,
                lower: parameter.lower,
                upper: parameter.upper,
            });
        }
    }
    Ok(())
}

/// The entry of an effect.
///
/// # Errors
/// When there is no such effect.
pub fn info(name: &str) -> Result<&'static EffectInfo, EffectError> {
    catalogue().iter().find(|info| info.name == name).ok_or_else(|| EffectError::Unknown { name: name.to_owned() })
}

effects! {
    /// The stator warms while driven and its resonance falls: dT/dt = (drive − T)/τ, f_r = f0 − shift·T, friction·(1 + friction·T). `T` is carried
    /// from run to run in [`super::motor_plant::History`].
    resonance_heating: ResonanceHeating, "resonance-heating", Plant {
        /// Fall of the resonance under continuous drive, once warm (Hz).
        shift_hz: "Hz", Linear, [-2000.0, 2000.0], 0.0, 200.0;
        /// Thermal time constant (s).
        tau_s: "s", Scale, [0.2, 3600.0], 10.0, 10.0;
        /// Share of the warmth that is left at the start of the next run (1).
        kept: "1", Linear, [0.0, 1.0], 1.0, 0.6;
        /// What the friction has gained when warm, under the wave and without it (1).
        friction: "1", Linear, [-0.9, 1.0], 0.0, 0.0;
    }
    /// At each start the driver's frequency is off its tracked value and comes back: detuning·exp(−t/τ).
    frequency_settling: FrequencySettling, "frequency-settling", Plant {
        /// Offset of the drive frequency at the start (Hz).
        detuning_hz: "Hz", Linear, [-2000.0, 2000.0], 0.0, -400.0;
        /// Time constant (s).
        tau_s: "s", Scale, [0.002, 1.0], 0.03, 0.03;
        /// 1 where only the time with the drive on counts, 0 where all time since the start does (1).
        on_time: "1", Linear, [0.0, 1.0], 0.0, 0.0;
    }
    /// Coulomb friction in the measure in which the wave is gone, beyond what the contact itself has.
    off_phase_braking: OffPhaseBraking, "off-phase-braking", Plant {
        /// Friction torque (N·m).
        torque_nm: "N·m", Linear, [0.0, 0.1], 0.0, 1e-3;
    }
    /// More duty gives less and less drive: of a duty u, u/(1 + bend·u^bend_power), no more than 1 − flat_top, and of that u/(1 + u/us).
    high_duty_saturation: HighDutySaturation, "high-duty-saturation", Actuator {
        /// 1/us (1).
        inverse_us: "1", Linear, [-0.5, 5.0], 0.0, 0.3;
        /// Bend (1).
        bend: "1", Linear, [0.0, 5.0], 0.0, 0.0;
        /// Share of the supply's voltage that is lost at full duty, as u^bend_power (1).
        voltage_loss: "1", Linear, [0.0, 0.9], 0.0, 0.0;
        /// Power of the bend (1).
        bend_power: "1", Linear, [1.0, 12.0], 2.0, 2.0;
        /// Duty that is lost at the top (1).
        flat_top: "1", Linear, [0.0, 0.6], 0.0, 0.0;
    }
    /// Contact force ∝ depthⁿ, with the linear contact's stiffness at the depth of the linear steady wave. A soft contact also
    /// creeps: it takes a slip to transmit a torque, beyond the one of the rigid contact.
    contact_stiffening: ContactStiffening, "contact-stiffening", Plant {
        /// n (1).
        exponent: "1", Linear, [0.5, 3.0], 1.0, 1.5;
        /// Slip at the whole torque, as a share of the speed at none (1).
        slip_band_excess: "1", Linear, [0.0, 5.0], 0.0, 0.5;
        /// n of that slip: half of it gives ½ⁿ of the torque (1).
        slip_exponent: "1", Linear, [0.1, 4.0], 1.0, 1.0;
    }
    /// The two directions differ.
    direction_asymmetry: DirectionAsymmetry, "direction-asymmetry", Plant {
        /// Half the difference of the drive's strength, clockwise less counter-clockwise, over its mean (1).
        gain: "1", Linear, [-0.5, 0.5], 0.0, 0.05;
        /// The same of the friction (1).
        friction: "1", Linear, [-0.5, 0.5], 0.0, 0.1;
        /// The same of the braking without a wave alone (1).
        braking: "1", Linear, [-0.9, 0.9], 0.0, 0.0;
    }
    /// The preload varies round the rotor: Fext·(1 + r), r = Σ amplitude_k·cos(kθ − phase_k). What is known of its consequences
    /// instead stands beside it: supply·(1 + on_voltage·r), friction·(1 + on_friction·r), the same of the braking without a wave.
    preload_runout: PreloadRunout, "preload-runout", Plant {
        /// Relative variation once a turn (1).
        amplitude: "1", Linear, [0.0, 0.8], 0.0, 0.1;
        /// Angle of the largest preload (rad).
        phase_rad: "rad", Angle, [-6.3, 6.3], 0.0, 1.0;
        /// The same twice a turn (1).
        amplitude_2: "1", Linear, [0.0, 0.8], 0.0, 0.0;
        /// Its phase (rad).
        phase_2_rad: "rad", Angle, [-6.3, 6.3], 0.0, 0.0;
        /// Three times a turn (1).
        amplitude_3: "1", Linear, [0.0, 0.8], 0.0, 0.0;
        /// Its phase (rad).
        phase_3_rad: "rad", Angle, [-6.3, 6.3], 0.0, 0.0;
        /// Four times a turn (1).
        amplitude_4: "1", Linear, [0.0, 0.8], 0.0, 0.0;
        /// Its phase (rad).
        phase_4_rad: "rad", Angle, [-6.3, 6.3], 0.0, 0.0;
        /// How much of it acts on the preload (1).
        on_preload: "1", Linear, [-5.0, 5.0], 1.0, 1.0;
        /// On the supply (1).
        on_voltage: "1", Linear, [-5.0, 5.0], 0.0, 0.0;
        /// On the friction under drive (1).
        on_friction: "1", Linear, [-5.0, 5.0], 0.0, 0.0;
        /// On the braking without a wave (1).
        on_braking: "1", Linear, [-5.0, 5.0], 0.0, 0.0;
    }
    /// Friction that fades with speed: torque·exp(−(v/vs)²).
    stribeck_friction: StribeckFriction, "stribeck-friction", Plant {
        /// Added friction at standstill (N·m).
        torque_nm: "N·m", Linear, [0.0, 0.1], 0.0, 2e-3;
        /// vs (rad/s).
        speed_rad_s: "rad/s", Scale, [0.01, 10.0], 0.5, 0.5;
    }
    /// The resting contact bends before it slides: LuGre's σ0 (as its compliance) and σ1.
    presliding: Presliding, "presliding", Plant {
        /// 1/σ0 (rad/(N·m)).
        compliance_rad_nm: "rad/(N·m)", Linear, [0.0, 10.0], 0.0, 0.1;
        /// σ1 (N·m·s/rad).
        damping_nms: "N·m·s/rad", Scale, [1e-6, 1.0], 1e-3, 1e-3;
    }
    /// A weight on the shaft: load torque·sin(θ + phase).
    gravity_load: GravityLoad, "gravity-load", Plant {
        /// m·g·l (N·m).
        torque_nm: "N·m", Linear, [0.0, 0.5], 0.0, 2e-3;
        /// Phase (rad).
        phase_rad: "rad", Angle, [-6.3, 6.3], 0.0, 0.5;
    }
    /// The supply sags under the drive's current: V = V0·(1 − sag·current), the current following the drive within τ.
    supply_sag: SupplySag, "supply-sag", Plant {
        /// Relative sag under continuous drive (1).
        sag: "1", Linear, [-0.3, 0.6], 0.0, 0.1;
        /// Time constant of the supply (s).
        tau_s: "s", Scale, [1e-4, 0.25], 5e-3, 5e-3;
    }
    /// The contact runs in: drive strength·(1 + gain·ln(1 + x) + gain_run_in·(1 − exp(−x))), friction·(1 + friction_run_in·(1 − exp(−x))),
    /// x the revolutions over r0. Revolutions are carried from run to run in [`super::motor_plant::History`].
    run_in_wear: RunInWear, "run-in-wear", Plant {
        /// What the drive gains for ever (1).
        gain: "1", Linear, [-0.5, 0.5], 0.0, 0.03;
        /// r0 (revolutions).
        revolutions: "rev", Scale, [0.01, 1e5], 10.0, 10.0;
        /// What it has gained once run in (1).
        gain_run_in: "1", Linear, [-0.6, 1.0], 0.0, 0.0;
        /// What the friction has gained then, under the wave and without it (1).
        friction_run_in: "1", Linear, [-0.9, 3.0], 0.0, 0.0;
    }
    /// No motion below a duty: max(u − threshold, 0), or a gate that opens at a duty and then lets all of it through,
    /// u/(1 + exp(−(u − gate_duty)/gate_width)).
    dead_zone: DeadZone, "dead-zone", Actuator {
        /// Duty at which the motor starts (1).
        threshold_duty: "1", Linear, [0.0, 0.6], 0.0, 0.05;
        /// Duty at which the gate is half open; 0 is no gate (1).
        gate_duty: "1", Linear, [0.0, 0.6], 0.0, 0.0;
        /// How softly it opens (1).
        gate_width: "1", Scale, [1e-4, 0.2], 0.02, 0.02;
    }
    /// The supply comes on late at each rise of the PWM: by delay, or by delay·(1 − exp(−rest/rest_s)) after a rest.
    start_delay: StartDelay, "start-delay", Actuator {
        /// Delay (s).
        delay_s: "s", Linear, [0.0, 0.05], 0.0, 1e-3;
        /// Rest after which nearly two thirds of the delay are there; 0: all of it always is (s).
        rest_s: "s", Linear, [0.0, 0.1], 0.0, 0.0;
    }
    /// The duty comes in steps: step·round(u/step), or step·floor(u/step).
    duty_quantisation: DutyQuantisation, "duty-quantisation", Actuator {
        /// Step, 1/N (1).
        step: "1", Linear, [0.0, 0.5], 0.0, 0.03125;
        /// 0 rounds to the nearest step, 1 to the one below (1).
        down: "1", Linear, [0.0, 1.0], 0.0, 0.0;
    }
    /// The encoder's disc is off centre or uneven: θ + Σ amplitude_k·sin(kθ − phase_k).
    encoder_eccentricity: EncoderEccentricity, "encoder-eccentricity", Sensor {
        /// Angle error (rad).
        amplitude_rad: "rad", Linear, [0.0, 0.2], 0.0, 0.01;
        /// Phase (rad).
        phase_rad: "rad", Angle, [-6.3, 6.3], 0.0, 1.0;
        /// Angle error twice a turn (rad).
        amplitude_2_rad: "rad", Linear, [0.0, 0.05], 0.0, 0.0;
        /// Its phase (rad).
        phase_2_rad: "rad", Angle, [-6.3, 6.3], 0.0, 0.0;
        /// Three times a turn (rad).
        amplitude_3_rad: "rad", Linear, [0.0, 0.03], 0.0, 0.0;
        /// Its phase (rad).
        phase_3_rad: "rad", Angle, [-6.3, 6.3], 0.0, 0.0;
        /// Four times a turn (rad).
        amplitude_4_rad: "rad", Linear, [0.0, 0.02], 0.0, 0.0;
        /// Its phase (rad).
        phase_4_rad: "rad", Angle, [-6.3, 6.3], 0.0, 0.0;
    }
    /// Light and dark differ in width: the edges at which a high slot begins, in the positive sense, are late by a share of the
    /// pitch. High slots are 1 − offset pitches wide, low ones 1 + offset: the `high_slot_excess` of a diagnosis is −offset.
    unequal_edges: UnequalEdges, "unequal-edges", Sensor {
        /// Shift of the odd edges, in pitches (1).
        offset: "1", Linear, [-0.9, 0.9], 0.0, 0.1;
    }
    /// The recorder's clock is off: recorded time = t·(1 + error + drift·t/2), or with a drift that dies away as exp(−t/tau).
    clock_error: ClockError, "clock-error", Sensor {
        /// Relative error (1).
        error: "1", Linear, [-0.2, 0.2], 0.0, 5e-3;
        /// Change of the error (1/s); it ends where the error would reach a half.
        drift_per_s: "1/s", Linear, [-0.05, 0.05], 0.0, 0.0;
        /// Time constant with which the change dies away (s); 0: it does not.
        drift_tau_s: "s", Scale, [0.0, 10.0], 0.0, 0.0;
    }
    /// Stretches of the record are lost and what follows moves up: `length_s` missing at `first_s` and every `every_s` after
    /// (in the recorder's time; 0 means once).
    dropped_samples: DroppedSamples, "dropped-samples", Sensor {
        /// Length of a gap (s); 32 samples are 0.032 s.
        length_s: "s", Linear, [0.0, 1.0], 0.0, 0.032;
        /// First gap (s).
        first_s: "s", Scale, [0.0, 1e4], 1.0, 1.0;
        /// Time between gaps (s).
        every_s: "s", Scale, [0.0, 1e4], 0.0, 0.0;
    }
    /// Each reversal adds counts.
    reversal_miscount: ReversalMiscount, "reversal-miscount", Sensor {
        /// Counts added a reversal, positive in the new direction (1).
        counts: "counts", Linear, [-8.0, 8.0], 0.0, 1.0;
        /// Counts added a reversal whatever its sense (1).
        drift: "counts", Linear, [-8.0, 8.0], 0.0, 0.0;
    }
    /// Lost motion between rotor and encoder.
    backlash: Backlash, "backlash", Sensor {
        /// Whole gap (rad).
        gap_rad: "rad", Linear, [0.0, 0.5], 0.0, 0.016;
    }
    /// The loop acts late.
    loop_delay: LoopDelay, "loop-delay", Controller {
        /// Ticks of the control period (1).
        ticks: "ticks", Linear, [0.0, 200.0], 0.0, 4.0;
    }
    /// The controller is not the one stated.
    controller_mismatch: ControllerMismatch, "controller-mismatch", Controller {
        /// Factor on kp, less 1 (1).
        kp: "1", Linear, [-0.9, 4.0], 0.0, 0.3;
        /// Factor on ki, less 1 (1).
        ki: "1", Linear, [-1.0, 1000.0], 0.0, 1.0;
        /// Factor on kd, less 1 (1).
        kd: "1", Linear, [-1.0, 1000.0], 0.0, 1.0;
    }
}

impl RunInWear {
    /// Relative changes of the drive's strength and of the friction after so many revolutions.
    pub fn changes(&self, revolutions: f64) -> [f64; 2] {
        let x = revolutions / self.revolutions;
        let done = -(-x).exp_m1();
        [self.gain * x.ln_1p() + self.gain_run_in * done, self.friction_run_in * done]
    }
}

impl PreloadRunout {
    /// The relative variation at an angle of the rotor (rad).
    pub fn relative(&self, angle_rad: f64) -> f64 {
        let harmonics = [
            (self.amplitude, self.phase_rad),
            (self.amplitude_2, self.phase_2_rad),
            (self.amplitude_3, self.phase_3_rad),
            (self.amplitude_4, self.phase_4_rad),
        ];
        let mut sum = 0.0;
        for (k, (amplitude, phase)) in (1..).zip(harmonics) {
            if amplitude != 0.0 {
                sum += amplitude * (f64::from(k) * angle_rad - phase).cos();
            }
        }
        sum
    }
}

impl EncoderEccentricity {
    /// What the disc shows too much at an angle of its shaft (rad).
    pub fn error_rad(&self, shaft_rad: f64) -> f64 {
        let harmonics = [
            (self.amplitude_rad, self.phase_rad),
            (self.amplitude_2_rad, self.phase_2_rad),
            (self.amplitude_3_rad, self.phase_3_rad),
            (self.amplitude_4_rad, self.phase_4_rad),
        ];
        let mut sum = 0.0;
        for (k, (amplitude, phase)) in (1..).zip(harmonics) {
            if amplitude != 0.0 {
                sum += amplitude * (f64::from(k) * shaft_rad - phase).sin();
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_catalogue_is_the_one_the_answer_names() {
        assert_eq!(LISTED.len(), 23);
        for info in catalogue() {
            assert_eq!(info.parameters[0].kind, Kind::Linear, "{}: the size comes first", info.name);
            for p in info.parameters {
                assert!(
                    (p.lower..=p.upper).contains(&p.absent) && (p.lower..=p.upper).contains(&p.typical),
                    "{}",
                    p.name
                );
            }
        }
    }

    #[test]
    fn effects_are_set_by_name_and_checked() {
        let mut set = EffectSet::default();
        set.set("dead-zone", &[0.1]).unwrap();
        assert_eq!(set.dead_zone, Some(DeadZone { threshold_duty: 0.1, ..DeadZone::ABSENT }));
        assert_eq!(set.present()[0].1, vec![0.1, 0.0, 0.02]);
        assert!(matches!(set.set("dead-zone", &[0.1, 0.2, 0.02, 0.0]), Err(EffectError::Count { .. })));
        assert!(matches!(set.set("dead-zone", &[]), Err(EffectError::Count { .. })));
        assert!(matches!(set.set("dead-zone", &[2.0]), Err(EffectError::OutOfBounds { .. })));
        assert!(matches!(set.set("dead-zone", &[f64::NAN]), Err(EffectError::OutOfBounds { .. })));
        assert!(matches!(set.set("dead", &[2.0]), Err(EffectError::Unknown { .. })));
        set.remove("dead-zone");
        assert_eq!(set, EffectSet::default());
    }

    /// Fails if an effect that is one file and one line is not an effect like the others: by name, with bounds, absent and present.
    #[test]
    fn a_shipped_formula_is_an_effect_like_the_others() {
        let mut set = EffectSet::default();
        set.set("turned-drag", &[0.2]).unwrap();
        let (info, values) = set.present().remove(0);
        assert_eq!((info.name, info.seat, info.parameters[1].unit), ("turned-drag", Seat::Plant, "rad"));
        assert_eq!(values, [0.2, 6.0]);
        assert!(matches!(set.set("turned-drag", &[0.9]), Err(EffectError::OutOfBounds { .. })));
        let mut other = EffectSet::default();
        other.set("turned-drag", &[0.1, 3.0]).unwrap();
        other.set("dead-zone", &[0.1]).unwrap();
        set.join(&other);
        assert_eq!(set, other);
        set.remove("turned-drag");
        assert!(set.formulas.is_empty());
    }
}
