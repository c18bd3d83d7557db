//! The motor's parameters: one flat record, its names, units and bounds.
//!
//! The names are those of the thesis's initialisation script (section A.4), so a `--set Ks=4.8e10` on the command line, a
//! key of a motor file and a line of the thesis speak of the same thing. `uoff` alone is new: the listing has no friction
//! without a wave.

use serde::Serialize;
use std::f64::consts::PI;
use thiserror::Error;

/// Which reading of the hybrid model is meant.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, serde::Deserialize)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Flavour {
    /// The listing's errors put right: lighter stator, greater preload, and a rotor clamped while the drive is off
    #[default]
    Physical,
    /// The thesis's closed loop with the real motor: the listed equations, and a rotor that brakes partly while the drive is off
    Measured,
    /// Formula for formula as the thesis lists it, errors included: the rotor coasts while the drive is off
    Thesis,
}

impl Flavour {
    /// Every flavour, in the order of the thesis's history: listed, put right, measured.
    pub const ALL: [Flavour; 3] = [Flavour::Thesis, Flavour::Physical, Flavour::Measured];

    /// Whether wave and contact follow the equations as listed (sections A.4 to A.6): the identified constants go with
    /// them. `Measured` differs from `Thesis` in the friction without a wave alone.
    pub fn is_listed(self) -> bool {
        self != Flavour::Physical
    }
}

impl std::fmt::Display for Flavour {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Flavour::Thesis => "thesis",
            Flavour::Physical => "physical",
            Flavour::Measured => "measured",
        })
    }
}

/// A parameter set of the hybrid model.
///
/// Values inside [`SPECS`]'s bounds never make the model panic; [`Parameters::check`] names the first that is outside.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub struct Parameters {
    /// `f`: supply frequency (Hz).
    pub frequency_hz: f64,
    /// `Vrms`: supply voltage, RMS (V).
    pub vrms_v: f64,
    /// `Ms`: modal mass of one stator mode (kg).
    pub modal_mass_kg: f64,
    /// `Cs`: modal damping (N·s/m).
    pub modal_damping_ns_m: f64,
    /// `Ks`: modal stiffness (N/m).
    pub modal_stiffness_n_m: f64,
    /// `eta`: modal electromechanical force factor (N/V).
    pub force_factor_n_v: f64,
    /// `Rr`: radial shape constant of the travelling wave (1).
    pub radial_shape: f64,
    /// `R0`: middle radius of the contact area (m).
    pub contact_radius_m: f64,
    /// `b`: radial width of the contact area (m). Listed, used by no equation: `Cn` is per metre of circumference.
    pub contact_width_m: f64,
    /// `n`: number of waves round the stator (1), a whole number.
    pub waves: f64,
    /// `h`: half the stator's thickness (m).
    pub half_thickness_m: f64,
    /// `Mr`: rotor mass (kg).
    pub rotor_mass_kg: f64,
    /// `Jr`: rotor inertia (kg·m²).
    pub rotor_inertia_kg_m2: f64,
    /// `Cz`: vertical damping of the rotor (N·s/m).
    pub vertical_damping_ns_m: f64,
    /// `Ctheta`: rotational damping of the rotor (N·m·s).
    pub rotational_damping_nms: f64,
    /// `u`: Coulomb coefficient of friction under a running wave (1).
    pub friction: f64,
    /// `Fext`: axial force pressing the rotor on the stator (N).
    pub preload_n: f64,
    /// `Tload`: load torque against positive rotation (N·m).
    pub load_nm: f64,
    /// `Cn`: normal stiffness of the contact per metre of circumference (N/m²).
    pub contact_stiffness_n_m2: f64,
    /// `uoff`: coefficient of friction while the rotor rests on the whole stator (1). Unused in the thesis flavour.
    /// `uoff`·`Fext`·`R0` is the torque that brakes the rotor once the wave is gone.
    pub off_friction: f64,
}

/// What is known of one parameter whatever the motor: its name, unit and the bounds inside which the model is defined.
#[derive(Debug, Clone, Copy)]
pub struct ParameterSpec {
    /// Name, as in section A.4 of the thesis.
    pub name: &'static str,
    /// Unit as a motor file must state it.
    pub unit: &'static str,
    /// Smallest admissible value.
    pub lower: f64,
    /// Largest admissible value.
    pub upper: f64,
}

const fn spec(name: &'static str, unit: &'static str, lower: f64, upper: f64) -> ParameterSpec {
    ParameterSpec { name, unit, lower, upper }
}

/// Every parameter, in the order of section A.4.
pub const SPECS: [ParameterSpec; 20] = [
    spec("f", "Hz", 1e3, 1e6),
    spec("Vrms", "V", 0.0, 1e3),
    spec("Ms", "kg", 1e-6, 10.0),
    spec("Cs", "N·s/m", 1e-3, 1e6),
    spec("Ks", "N/m", 1e3, 1e13),
    spec("eta", "N/V", 0.0, 1e3),
    spec("Rr", "1", 0.01, 1.0),
    spec("R0", "m", 1e-4, 1.0),
    spec("b", "m", 1e-6, 1.0),
    spec("n", "1", 1.0, 100.0),
    spec("h", "m", 1e-6, 0.1),
    spec("Mr", "kg", 1e-5, 10.0),
    spec("Jr", "kg·m²", 1e-10, 1.0),
    spec("Cz", "N·s/m", 0.0, 1e5),
    spec("Ctheta", "N·m·s", 0.0, 1.0),
    spec("u", "1", 0.0, 2.0),
    spec("Fext", "N", 1e-3, 1e4),
    spec("Tload", "N·m", -1e3, 1e3),
    spec("Cn", "N/m²", 1e5, 1e14),
    spec("uoff", "1", 0.0, 2.0),
];

/// A parameter that is not there, or cannot be.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ParameterError {
    /// No parameter of this name.
    #[error("no parameter `{name}`: the names are {}", names())]
    Unknown {
        /// The name asked for.
        name: String,
    },
    /// A value outside the bounds of [`SPECS`].
    #[error("`{name} = {value}` is outside {lower} ..= {upper} {unit}")]
    OutOfBounds {
        /// The parameter.
        name: &'static str,
        /// What was given.
        value: f64,
        /// Smallest admissible value.
        lower: f64,
        /// Largest admissible value.
        upper: f64,
        /// Its unit.
        unit: &'static str,
    },
    /// `n` counts waves.
    #[error("`n = {value}` is not a whole number of waves")]
    NotWhole {
        /// What was given.
        value: f64,
    },
    /// A `--set` argument that is not `name=value`.
    #[error("`{argument}` is not `name=value` with a number as the value")]
    NotAnAssignment {
        /// What was given.
        argument: String,
    },
    /// The stator's resonance and the drive are so far apart that the two-mode model says nothing.
    #[error(
        "`f = {drive_hz} Hz` is not within a factor of 2 of the stator's resonance sqrt(Ks/Ms)/2π = {resonance_hz:.0} Hz"
    )]
    FarFromResonance {
        /// The drive frequency.
        drive_hz: f64,
        /// The stator's own.
        resonance_hz: f64,
    },
    /// An overdamped stator carries no wave.
    #[error("`Cs = {damping}` makes the stator's quality factor {quality:.2}: below 2 there is no wave to speak of")]
    Overdamped {
        /// The damping (N·s/m).
        damping: f64,
        /// sqrt(Ks·Ms)/Cs.
        quality: f64,
    },
}

fn names() -> String {
    SPECS.iter().map(|spec| spec.name).collect::<Vec<_>>().join(", ")
}

/// The index of a parameter in [`SPECS`].
///
/// # Errors
/// When there is no parameter of that name.
pub fn index_of(name: &str) -> Result<usize, ParameterError> {
    SPECS.iter().position(|spec| spec.name == name).ok_or_else(|| ParameterError::Unknown { name: name.to_owned() })
}

impl Parameters {
    /// The values in the order of [`SPECS`].
    pub fn to_array(&self) -> [f64; 20] {
        [
            self.frequency_hz,
            self.vrms_v,
            self.modal_mass_kg,
            self.modal_damping_ns_m,
            self.modal_stiffness_n_m,
            self.force_factor_n_v,
            self.radial_shape,
            self.contact_radius_m,
            self.contact_width_m,
            self.waves,
            self.half_thickness_m,
            self.rotor_mass_kg,
            self.rotor_inertia_kg_m2,
            self.vertical_damping_ns_m,
            self.rotational_damping_nms,
            self.friction,
            self.preload_n,
            self.load_nm,
            self.contact_stiffness_n_m2,
            self.off_friction,
        ]
    }

    /// Values in the order of [`SPECS`], unchecked: see [`Parameters::check`].
    pub fn from_array(v: [f64; 20]) -> Self {
        Parameters {
            frequency_hz: v[0],
            vrms_v: v[1],
            modal_mass_kg: v[2],
            modal_damping_ns_m: v[3],
            modal_stiffness_n_m: v[4],
            force_factor_n_v: v[5],
            radial_shape: v[6],
            contact_radius_m: v[7],
            contact_width_m: v[8],
            waves: v[9],
            half_thickness_m: v[10],
            rotor_mass_kg: v[11],
            rotor_inertia_kg_m2: v[12],
            vertical_damping_ns_m: v[13],
            rotational_damping_nms: v[14],
            friction: v[15],
            preload_n: v[16],
            load_nm: v[17],
            contact_stiffness_n_m2: v[18],
            off_friction: v[19],
        }
    }

    /// The value of a parameter by its name of section A.4.
    ///
    /// # Errors
    /// When there is no parameter of that name.
    pub fn get(&self, name: &str) -> Result<f64, ParameterError> {
        Ok(self.to_array()[index_of(name)?])
    }

    /// Sets a parameter by its name of section A.4, and checks the whole set.
    ///
    /// # Errors
    /// When there is no such parameter, or the set would leave its bounds. The set is then unchanged.
    pub fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        let mut values = self.to_array();
        values[index_of(name)?] = value;
        *self = Self::from_array(values).check()?;
        Ok(())
    }

    /// Applies `name=value` assignments, as `--set` takes them, and checks the set once they are all in.
    ///
    /// # Errors
    /// As [`Parameters::set`], and when an argument is not an assignment.
    pub fn assign<S: AsRef<str>>(&self, assignments: &[S]) -> Result<Self, ParameterError> {
        let mut values = self.to_array();
        for argument in assignments {
            let argument = argument.as_ref();
            let not = || ParameterError::NotAnAssignment { argument: argument.to_owned() };
            let (name, value) = argument.split_once('=').ok_or_else(not)?;
            values[index_of(name.trim())?] = value.trim().parse().map_err(|_| not())?;
        }
        Self::from_array(values).check()
    }

    /// Checks every bound and the relations between parameters.
    ///
    /// # Errors
    /// The first parameter that is outside its bounds, or a relation that does not hold.
    pub fn check(self) -> Result<Self, ParameterError> {
        for (spec, value) in SPECS.iter().zip(self.to_array()) {
            if !(spec.lower..=spec.upper).contains(&value) {
                return Err(ParameterError::OutOfBounds {
                    name: spec.name,
                    value,
                    lower: spec.lower,
                    upper: spec.upper,
                    unit: spec.unit,
                });
            }
        }
        if self.waves.fract() != 0.0 {
            return Err(ParameterError::NotWhole { value: self.waves });
        }
        let resonance_hz = self.resonance_hz();
        if !(0.5..=2.0).contains(&(self.frequency_hz / resonance_hz)) {
            return Err(ParameterError::FarFromResonance { drive_hz: self.frequency_hz, resonance_hz });
        }
        let quality = (self.modal_stiffness_n_m * self.modal_mass_kg).sqrt() / self.modal_damping_ns_m;
        if quality < 2.0 {
            return Err(ParameterError::Overdamped { damping: self.modal_damping_ns_m, quality });
        }
        Ok(self)
    }

    /// `omega`: angular frequency of the supply (rad/s).
    pub fn omega(&self) -> f64 {
        2.0 * PI * self.frequency_hz
    }

    /// `Vmax`: amplitude of the supply (V). Section A.4 divides by 0.7071 rather than by 1/√2.
    pub fn vmax(&self) -> f64 {
        // The listing's rounding, kept: its anchors depend on it.
        self.vrms_v * (10_000.0 / 7071.0)
    }

    /// `k`: angular wavenumber round the contact circle (rad/m), n/R0.
    pub fn wavenumber(&self) -> f64 {
        self.waves / self.contact_radius_m
    }

    /// Torque that brakes the rotor once the wave is gone (N·m): none as listed, `uoff`·`Fext`·`R0` otherwise.
    pub fn off_friction_nm(&self, flavour: Flavour) -> f64 {
        match flavour {
            Flavour::Thesis => 0.0,
            Flavour::Physical | Flavour::Measured => self.off_friction * self.preload_n * self.contact_radius_m,
        }
    }

    /// `lambda`: wavelength along the contact circle (m).
    pub fn wavelength_m(&self) -> f64 {
        2.0 * PI * self.contact_radius_m / self.waves
    }

    /// `Wmin`: the amplitude below which section A.4 does not let the contact equations go (m), the one whose quarter-wave
    /// contact carries the whole preload.
    pub fn wmin_m(&self) -> f64 {
        self.preload_n / (2.0 * self.radial_shape * self.contact_radius_m * self.contact_stiffness_n_m2)
    }

    /// Resonance of the free stator (Hz).
    pub fn resonance_hz(&self) -> f64 {
        (self.modal_stiffness_n_m / self.modal_mass_kg).sqrt() / (2.0 * PI)
    }
}
