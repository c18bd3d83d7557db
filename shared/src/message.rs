//! What host and device say to each other. Serialised with postcard inside [`crate::frame`]s; a change of any type here
//! is a change of [`crate::frame::PROTOCOL_VERSION`]. Recordings hold frames: device messages and what they are made of only
//! ever gain variants at their end, so that those of every version read as they are.

use crate::encoder::{CountSign, Edge};
use crate::reference::{Reference, ReferenceError};
use crate::safety::Limits;
use crate::step::{ConfigError, ConfigSpec, DriveLaw, Inputs, Outputs, State};
use crate::{Direction, Duty, Fault};
use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

/// Words in a block of bits: one second of samples.
pub const BITS_WORDS: usize = 32;
/// Edges in a block.
pub const BLOCK_EDGES: usize = 48;
/// Samples in a block of control samples.
pub const BLOCK_SAMPLES: usize = 16;

/// Everything the motor is run with. Validated by the device before it can arm, and echoed back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Configuration {
    /// The controller.
    pub control: ConfigSpec,
    /// The limits.
    pub limits: Limits,
    /// Which way the count moves while the direction pin is high.
    pub count_sign: CountSign,
    /// Encoder edges a revolution.
    pub edges_per_rev: u16,
    /// PWM frequency, Hz.
    pub pwm_hz: u16,
}

impl Configuration {
    /// The 30 mm PCBMotor under `control`, with the PWM frequency that belongs to it.
    pub const fn with_control(control: ConfigSpec) -> Self {
        let pwm_hz = control.pwm_hz();
        Self { control, limits: Limits::DEFAULT, count_sign: CountSign::Positive, edges_per_rev: 400, pwm_hz }
    }

    /// Whether the PWM is one that the controller's law can be run with: a gated drive is decided anew for every period.
    pub const fn pwm_fits(&self) -> bool {
        !matches!(self.control.law, DriveLaw::Gated) || self.pwm_hz == self.control.pwm_hz()
    }
}

/// Which capture streams run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CaptureMode {
    /// The encoder level at 1 kHz, packed.
    pub bits: bool,
    /// Every encoder edge with its time.
    pub edges: bool,
    /// Every control tick.
    pub control: bool,
}

/// A timed run at constant duty.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SpeedRun {
    /// Drive-on fraction.
    pub duty: Duty,
    /// Direction.
    pub direction: Direction,
    /// How long the drive is on, ms.
    pub duration_ms: u32,
}

/// A timed closed-loop run; the position at its start becomes zero.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrackRun {
    /// What to track.
    pub reference: Reference,
    /// How long, ms.
    pub duration_ms: u32,
}

/// What a command that sets the motor in motion has to carry: who asks, and the number the device has just given to that
/// session. A pass works once, so bytes that are replayed start nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pass {
    /// The session's own number, chosen by the host, never zero.
    pub token: u32,
    /// The device's number, another one each time.
    pub nonce: u32,
}

/// Host to device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum HostMessage {
    /// Opens the conversation; answered with [`DeviceMessage::Hello`].
    Hello,
    /// Says that the session that set the motor in motion is alive; not acknowledged. Of another session, or with a sequence
    /// that is not newer than the one before, it says nothing.
    Keepalive {
        /// The session.
        token: u32,
    },
    /// Sets the configuration. Refused unless the motor is idle.
    Configure(Configuration),
    /// Aligns the motor. Refused unless idle and in the driver's text mode.
    Align(Pass),
    /// Allows this session's runs. Refused unless idle, configured and aligned. Answered with [`DeviceMessage::Pass`] too.
    Arm {
        /// The session.
        token: u32,
    },
    /// Runs at constant duty. Refused unless armed.
    Speed {
        /// The pass given last.
        pass: Pass,
        /// The run.
        run: SpeedRun,
    },
    /// Tracks a reference. Refused unless armed.
    Track {
        /// The pass given last.
        pass: Pass,
        /// The run.
        run: TrackRun,
    },
    /// Chooses the capture streams.
    Capture(CaptureMode),
    /// Passes a line of text to the driver board. Refused unless idle and in the driver's text mode.
    Driver {
        /// The pass given last.
        pass: Pass,
        /// Commands of [`crate::driver`].
        line: String<64>,
    },
    /// Stops the motor and disarms. From anyone, in any state, ahead of everything that waits, and never refused.
    Stop {
        /// Whether a latched fault is cleared too: a person's decision, never that of a command that runs the motor.
        clear_fault: bool,
    },
    /// Restarts the device. Refused unless idle or in fault.
    Reboot,
    /// Asks for a pass; answered with [`DeviceMessage::Pass`]. Refused while another session holds the motor.
    AskPass {
        /// The session.
        token: u32,
    },
}

/// Why the device last started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ResetCause {
    /// Power came.
    PowerOn,
    /// The reset pin, or the serial port's control lines.
    External,
    /// A reboot that was asked for.
    Software,
    /// The hardware watchdog.
    Watchdog,
    /// A panic.
    Panic,
    /// The supply sagged.
    BrownOut,
    /// Something else.
    Unknown,
}

/// Who the device is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Firmware version.
    pub firmware: String<24>,
    /// Chip, or `simulated` and what is.
    pub chip: String<48>,
    /// Why it last started.
    pub reset: ResetCause,
    /// Its state now.
    pub mode: Mode,
    /// The latched fault, if any.
    pub fault: Option<Fault>,
}

/// State of the supervisor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// Output off, waiting for commands.
    Idle,
    /// The alignment routine runs, through the driver's text mode.
    Aligning,
    /// A driver text command runs.
    Passthrough,
    /// Runs are allowed.
    Armed,
    /// A run drives the motor.
    Running,
    /// A fault is latched.
    Fault,
    /// A stop was taken; the driver board's own motion has not ceased yet.
    Stopping,
}

/// Why a command was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum Refusal {
    /// The supervisor is in a mode that does not take it.
    #[error("not possible while {0:?}")]
    Mode(Mode),
    /// A fault is latched.
    #[error("{0:?} is latched: {0}; `twum stop` clears it")]
    Fault(Fault),
    /// No valid configuration was sent.
    #[error("no valid configuration; send one first")]
    NotConfigured,
    /// The motor was not aligned.
    #[error("not aligned; align first")]
    NotAligned,
    /// The driver board is already in hardware mode, which only cycling its power ends.
    #[error(
        "the driver board is in hardware mode; cycle its power and reboot the controller to use text commands again"
    )]
    HardwareMode,
    /// The controller does not validate.
    #[error("{0}")]
    Config(ConfigError),
    /// The limits, edges or PWM frequency do not validate.
    #[error("limits, edges per revolution or PWM frequency are out of range")]
    Limits,
    /// The reference does not validate.
    #[error("{0}")]
    Reference(ReferenceError),
    /// A duration of zero or above an hour.
    #[error("duration must be between 1 ms and an hour")]
    Duration,
    /// The driver line is not understood.
    #[error("the driver line is not understood")]
    DriverLine,
    /// The device is busy with the command before.
    #[error("the device is busy with the command before; try again")]
    Busy,
    /// The pass is not the one that was given last, or was used.
    #[error("it does not carry the pass this board gave last; nothing starts from an old or repeated command")]
    Pass,
    /// Another session holds the motor.
    #[error("another program holds the motor; wait for its end, or stop it with `twum stop`")]
    Held,
    /// A stop came before the command was looked at.
    #[error("a stop came before it")]
    Overtaken,
    /// The controller gates the drive every control period, and the PWM is another one.
    #[error(
        "the controller gates the drive every control period: set pwm_hz to one PWM period in each (2000 at 500 us)"
    )]
    Pwm,
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RunEnd {
    /// Its time was up.
    Completed,
    /// The host stopped it.
    Stopped,
    /// A fault stopped it.
    Fault(Fault),
}

/// A block of 1 kHz samples.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BitsBlock {
    /// Index of the first sample since the stream was switched on; a jump is a loss.
    pub first_sample: u64,
    /// Device time of the first sample, µs.
    pub first_us: u64,
    /// Samples in the block (the last word may be partly filled, from its top).
    pub samples: u16,
    /// 32 samples a word, the oldest in the most significant bit.
    pub words: Vec<u32, BITS_WORDS>,
}

/// A block of encoder edges.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EdgesBlock {
    /// Index of the first edge among all that were streamed since boot; a jump is a loss.
    pub first_edge: u64,
    /// The edges. Their times are the low 32 bits of the device clock; the frame's own time resolves the rest.
    pub edges: Vec<Edge, BLOCK_EDGES>,
}

/// One control tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ControlSample {
    /// Wanted position, counts.
    pub target: i32,
    /// Rate of the wanted position, counts/s.
    pub target_rate: i32,
    /// Measured position, counts.
    pub position: i32,
    /// Control signal, signed duty steps in Q16.16.
    pub u: i32,
    /// Steps of the PWM period with the drive on.
    pub on_steps: u16,
    /// Direction of the drive.
    pub direction: Direction,
    /// How late the tick started, µs.
    pub late_us: u16,
    /// How long the tick before took, µs.
    pub duration_us: u16,
    /// What the wanted position lies beyond its whole counts, 1/128 count.
    pub target_fraction: i8,
    /// How long ago the last edge came, µs; at its limit for one that is older.
    pub edge_age_us: u16,
}

impl ControlSample {
    /// What a tick saw and decided.
    pub fn new(inputs: Inputs, outputs: Outputs, late_us: u16, duration_us: u16) -> Self {
        Self {
            target: inputs.target,
            target_rate: inputs.target_rate,
            position: inputs.position,
            u: outputs.u,
            on_steps: outputs.on_steps,
            direction: outputs.direction,
            late_us,
            duration_us,
            target_fraction: inputs.target_fraction,
            edge_age_us: inputs.edge_age_us,
        }
    }

    /// What the tick saw.
    pub fn inputs(&self) -> Inputs {
        Inputs {
            target: self.target,
            target_rate: self.target_rate,
            position: self.position,
            target_fraction: self.target_fraction,
            edge_age_us: self.edge_age_us,
        }
    }
}

/// A block of consecutive control ticks. The state at its start lets a replay resume after a gap.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ControlBlock {
    /// Index of the first tick since the run started; a jump is a loss.
    pub first_tick: u64,
    /// Device time at which the first tick was due, µs.
    pub first_us: u64,
    /// The controller's state before the first tick.
    pub state: State,
    /// The ticks.
    pub samples: Vec<ControlSample, BLOCK_SAMPLES>,
}

/// How the device is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// Supervisor state.
    pub mode: Mode,
    /// Latched fault.
    pub fault: Option<Fault>,
    /// Position, counts.
    pub position: i32,
    /// Duty now.
    pub duty: Duty,
    /// Direction now.
    pub direction: Direction,
    /// Control ticks since boot.
    pub ticks: u64,
    /// Ticks that started late.
    pub late_ticks: u32,
    /// Latest start of a tick, µs after it was due.
    pub worst_late_us: u32,
    /// Longest tick, µs.
    pub worst_duration_us: u32,
    /// Encoder edges since boot.
    pub edges: u32,
    /// Capture items (words, edges, ticks) lost because a queue was full.
    pub lost_items: u32,
    /// Frames from the host that could not be read.
    pub bad_frames: u32,
}

/// Capture items lost since boot because a queue was full, by stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Losses {
    /// Control ticks.
    pub ticks: u32,
    /// Words of 1 kHz samples.
    pub words: u32,
    /// Encoder edges.
    pub edges: u32,
    /// Events, and frames that could not be sent.
    pub others: u32,
}

/// A fault, when it latched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FaultReport {
    /// The fault.
    pub fault: Fault,
    /// Device time at which the output was switched off for it, µs.
    pub off_us: u64,
    /// Position then, counts.
    pub position: i32,
}

/// Device to host.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DeviceMessage {
    /// Who the device is.
    Hello(Identity),
    /// The command with this sequence was taken.
    Ack {
        /// Sequence of the host's frame.
        of: u32,
    },
    /// The command with this sequence was refused.
    Nack {
        /// Sequence of the host's frame.
        of: u32,
        /// Why.
        reason: Refusal,
    },
    /// The configuration in force, sent when it is set and when a capture starts, so that a recording holds it.
    Configured(Configuration),
    /// The motor is aligned, its count zero, the driver in hardware mode.
    Aligned,
    /// A run began with its first PWM period; its first control tick follows within a control period.
    RunStarted {
        /// Device time at which that PWM period began, µs: t = 0 of the run.
        start_us: u64,
    },
    /// A run is over.
    RunEnded {
        /// How.
        end: RunEnd,
        /// Device time, µs.
        end_us: u64,
    },
    /// 1 kHz samples.
    Bits(BitsBlock),
    /// Encoder edges.
    Edges(EdgesBlock),
    /// Control ticks.
    Control(ControlBlock),
    /// How the device is, ten times a second.
    Status(Status),
    /// A fault latched.
    Fault(FaultReport),
    /// The driver board's reply, in pieces.
    DriverReply(Vec<u8, 64>),
    /// The driver's text command is over: its reply ended and the motor stands.
    DriverDone,
    /// A line for people.
    Log(String<96>),
    /// The pass for the session's next command that sets the motor in motion.
    Pass(Pass),
    /// What was lost, by stream; sent with the status when it has grown.
    Losses(Losses),
}
