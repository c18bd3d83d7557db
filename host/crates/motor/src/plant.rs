//! The seam between whatever turns and whatever drives it.

pub use twum_shared::duty::Direction;

/// What drives the plant over an interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drive {
    /// 1 while the supply is on, 0 while it is off; an ordinary motor takes anything between.
    pub level: f64,
    /// Sense of rotation.
    pub direction: Direction,
    /// Commanded duty of the present PWM period, 0 to 1; what slow effects follow.
    pub duty: f64,
}

impl Drive {
    /// +1 for clockwise, −1 for counter-clockwise.
    pub fn sign(&self) -> f64 {
        f64::from(self.direction.sign())
    }

    /// Full drive, clockwise.
    pub const ON: Drive = Drive { level: 1.0, direction: Direction::Cw, duty: 1.0 };
    /// No drive.
    pub const OFF: Drive = Drive { level: 0.0, direction: Direction::Cw, duty: 0.0 };
}

/// Whatever turns: it has a time, an angle and a speed, and moves under a drive that is constant over an interval.
pub trait Plant {
    /// Time since the start (s).
    fn time_s(&self) -> f64;
    /// Angle (rad), clockwise positive.
    fn position_rad(&self) -> f64;
    /// Speed (rad/s).
    fn speed_rad_s(&self) -> f64;
    /// Advances to `until_s` under a constant drive. `observe` sees every step taken, in order, so that whoever listens (an
    /// encoder) can place an event inside it; a time that has passed is no step at all.
    fn advance(&mut self, until_s: f64, drive: Drive, observe: &mut dyn FnMut(&Segment));
}

/// One step of a plant: its ends, from which everything between follows by cubic interpolation.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Segment {
    /// Start (s).
    pub start_s: f64,
    /// End (s).
    pub end_s: f64,
    /// Angle at the start (rad).
    pub start_rad: f64,
    /// Angle at the end (rad).
    pub end_rad: f64,
    /// Speed at the start (rad/s).
    pub start_rad_s: f64,
    /// Speed at the end (rad/s).
    pub end_rad_s: f64,
}

impl Segment {
    /// Angle at a time inside the step (rad).
    pub fn position_rad(&self, time_s: f64) -> f64 {
        let h = self.end_s - self.start_s;
        if h <= 0.0 {
            return self.end_rad;
        }
        let t = ((time_s - self.start_s) / h).clamp(0.0, 1.0);
        let d = self.end_rad - self.start_rad;
        let (m0, m1) = (self.start_rad_s * h, self.end_rad_s * h);
        self.start_rad + t * (m0 + t * (3.0 * d - 2.0 * m0 - m1 + t * (m0 + m1 - 2.0 * d)))
    }

    /// Speed at a time inside the step (rad/s), the slope of [`Segment::position_rad`].
    pub fn speed_rad_s(&self, time_s: f64) -> f64 {
        let h = self.end_s - self.start_s;
        if h <= 0.0 {
            return self.end_rad_s;
        }
        let t = ((time_s - self.start_s) / h).clamp(0.0, 1.0);
        let d = self.end_rad - self.start_rad;
        let (m0, m1) = (self.start_rad_s * h, self.end_rad_s * h);
        (m0 + t * (2.0 * (3.0 * d - 2.0 * m0 - m1) + t * 3.0 * (m0 + m1 - 2.0 * d))) / h
    }
}
