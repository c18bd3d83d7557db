//! How a run is driven, whichever generator makes it.

/// How one run is driven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drive {
    /// On fraction that is asked for.
    pub duty: f64,
    /// 1 clockwise, -1 counter-clockwise.
    pub sign: f64,
    /// PWM frequency in Hz.
    pub pwm_hz: f64,
    /// End of the drive in s.
    pub seconds: f64,
}
