//! What effects may change about a motor while it runs: the one thing the carrier and the averaged model both obey.

/// Instantaneous changes to the motor; [`Modulation::NONE`] changes nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Modulation {
    /// Factor on the supply's amplitude (1).
    pub voltage: f64,
    /// Added to the drive frequency (Hz).
    pub drive_shift_hz: f64,
    /// Added to the free stator's resonance (Hz).
    pub resonance_shift_hz: f64,
    /// Factor on the preload (1).
    pub preload: f64,
    /// Factor on the friction under a wave (1).
    pub friction: f64,
    /// Factor on the friction without one (1).
    pub off_friction: f64,
    /// Exponent of the contact's force over its depth; 1 is the linear contact. Averaged model only.
    pub contact_exponent: f64,
    /// Slip a soft contact needs for the whole torque, as a share of the speed at none (1). Averaged model only.
    pub slip_excess: f64,
    /// Exponent n of that slip, half of which gives ½ⁿ of the torque (1). Averaged model only.
    pub slip_exponent: f64,
    /// Added load torque, against positive rotation (N·m).
    pub load_nm: f64,
    /// Added Coulomb friction, against the motion (N·m).
    pub brake_nm: f64,
    /// The same, in the measure in which the wave is gone (N·m).
    pub off_brake_nm: f64,
    /// Added friction that fades with speed as exp(−(v/vs)²) (N·m), and vs (rad/s).
    pub stribeck_nm: f64,
    /// See `stribeck_nm`.
    pub stribeck_rad_s: f64,
    /// Bristle stiffness of a resting contact (N·m/rad) and its damping (N·m·s/rad); 0 is a rigid contact. Averaged model only.
    pub bristle_nm_rad: f64,
    /// See `bristle_nm_rad`.
    pub bristle_nms_rad: f64,
}

impl Modulation {
    /// Nothing changed.
    pub const NONE: Modulation = Modulation {
        voltage: 1.0,
        drive_shift_hz: 0.0,
        resonance_shift_hz: 0.0,
        preload: 1.0,
        friction: 1.0,
        off_friction: 1.0,
        contact_exponent: 1.0,
        slip_excess: 0.0,
        slip_exponent: 1.0,
        load_nm: 0.0,
        brake_nm: 0.0,
        off_brake_nm: 0.0,
        stribeck_nm: 0.0,
        stribeck_rad_s: 1.0,
        bristle_nm_rad: 0.0,
        bristle_nms_rad: 0.0,
    };
}
