//! The files host and guest exchange: runs of inputs, and what became of each input.
//!
//! `inputs` is, for each run: the controller in postcard behind its length (a byte), padded to [`SPEC_BYTES`]; the number
//! of ticks (u32); whether its telemetry is encoded (u32); the ticks ([`TICK_BYTES`] each). A length of zero ends it.
//! `rows` holds a [`Row`] for each tick; `frames` holds for each telemetry block the instructions its frame took (u32), the
//! frame's length (u32) and the frame. All little endian.

use twum_shared::step::Inputs;

/// Where the host leaves the inputs for the guest.
pub const INPUTS: &core::ffi::CStr = c"inputs";
/// Where the guest leaves a row for each tick.
pub const ROWS: &core::ffi::CStr = c"rows";
/// Where the guest leaves the frames.
pub const FRAMES: &core::ffi::CStr = c"frames";
/// Room for a controller, its length included.
pub const SPEC_BYTES: usize = 128;
/// A tick's inputs: target, its rate, position, age of the last edge, the target's fraction, nothing.
pub const TICK_BYTES: usize = 16;
/// A tick's outputs.
pub const ROW_BYTES: usize = 28;

/// What became of one tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// Control signal, Q16.16.
    pub u: i32,
    /// Integral after the step.
    pub integral: i32,
    /// Error the state remembers.
    pub previous_error: i32,
    /// Where a model of the rotor believes it to be, past its count.
    pub place: i32,
    /// Duty steps on.
    pub on_steps: u16,
    /// Bit 0: clockwise; bit 1: clockwise by the doubles.
    pub directions: u8,
    /// The doubles' PWM value.
    pub doubles_pwm: u8,
    /// Whether the ticks so far are a stall: 1, or 0.
    pub stalled: u16,
    /// Instructions of the step. Zero from the host, which does not count.
    pub step_cost: u16,
    /// Instructions of the doubles.
    pub doubles_cost: u16,
    /// Instructions of the judgement of a stall.
    pub stall_cost: u16,
}

impl Row {
    /// As it stands in the file.
    #[cfg(target_os = "none")]
    pub fn to_bytes(self) -> [u8; ROW_BYTES] {
        let mut bytes = [0; ROW_BYTES];
        bytes[0..4].copy_from_slice(&self.u.to_le_bytes());
        bytes[4..8].copy_from_slice(&self.integral.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.previous_error.to_le_bytes());
        bytes[12..14].copy_from_slice(&self.on_steps.to_le_bytes());
        (bytes[14], bytes[15]) = (self.directions, self.doubles_pwm);
        bytes[16..18].copy_from_slice(&self.step_cost.to_le_bytes());
        bytes[18..20].copy_from_slice(&self.doubles_cost.to_le_bytes());
        bytes[20..22].copy_from_slice(&self.stalled.to_le_bytes());
        bytes[22..24].copy_from_slice(&self.stall_cost.to_le_bytes());
        bytes[24..28].copy_from_slice(&self.place.to_le_bytes());
        bytes
    }

    /// From the file.
    #[cfg(not(target_os = "none"))]
    pub fn from_bytes(b: &[u8; ROW_BYTES]) -> Self {
        Self {
            u: i32::from_le_bytes([b[0], b[1], b[2], b[3]]),
            integral: i32::from_le_bytes([b[4], b[5], b[6], b[7]]),
            previous_error: i32::from_le_bytes([b[8], b[9], b[10], b[11]]),
            on_steps: u16::from_le_bytes([b[12], b[13]]),
            directions: b[14],
            doubles_pwm: b[15],
            step_cost: u16::from_le_bytes([b[16], b[17]]),
            doubles_cost: u16::from_le_bytes([b[18], b[19]]),
            stalled: u16::from_le_bytes([b[20], b[21]]),
            stall_cost: u16::from_le_bytes([b[22], b[23]]),
            place: i32::from_le_bytes([b[24], b[25], b[26], b[27]]),
        }
    }
}

/// A tick's inputs as they stand in the file.
#[cfg(not(target_os = "none"))]
pub fn tick_to_bytes(inputs: &Inputs) -> [u8; TICK_BYTES] {
    let mut bytes = [0; TICK_BYTES];
    bytes[0..4].copy_from_slice(&inputs.target.to_le_bytes());
    bytes[4..8].copy_from_slice(&inputs.target_rate.to_le_bytes());
    bytes[8..12].copy_from_slice(&inputs.position.to_le_bytes());
    bytes[12..14].copy_from_slice(&inputs.edge_age_us.to_le_bytes());
    bytes[14..15].copy_from_slice(&inputs.target_fraction.to_le_bytes());
    bytes
}

/// A tick's inputs from the file.
#[cfg(target_os = "none")]
pub fn tick_from_bytes(b: &[u8; TICK_BYTES]) -> Inputs {
    Inputs {
        target: i32::from_le_bytes([b[0], b[1], b[2], b[3]]),
        target_rate: i32::from_le_bytes([b[4], b[5], b[6], b[7]]),
        position: i32::from_le_bytes([b[8], b[9], b[10], b[11]]),
        edge_age_us: u16::from_le_bytes([b[12], b[13]]),
        target_fraction: i8::from_le_bytes([b[14]]),
    }
}
