//! The output stage. [`Output`] is the only type that can energise the motor, and it starts by switching it off.

use twum_shared::{Direction, Duty};

/// The PWM pin (active low) and the direction pin, as a board drives them. Called from the control interrupt only, so it
/// must not block; a board writes registers here.
pub trait OutputStage {
    /// Holds the PWM pin high: no drive, at once.
    fn off(&mut self);
    /// Sets the drive-on fraction from the next PWM period on, and the direction at once.
    fn drive(&mut self, duty: Duty, direction: Direction);
    /// Starts a new PWM period now, so that a run begins with one.
    fn restart_period(&mut self);
    /// Sets the PWM frequency. Called only while the output is off.
    fn set_frequency(&mut self, hz: u16);
    /// Marks a run on the start-mark pin.
    fn mark(&mut self, running: bool);
}

/// The motor's output, off until told otherwise.
#[derive(Debug)]
pub struct Output<S> {
    stage: S,
    duty: Duty,
    direction: Direction,
}

impl<S: OutputStage> Output<S> {
    /// Takes the stage and switches it off before anything else. A board calls this first of all, before anything that can
    /// fail.
    pub fn boot(mut stage: S) -> Self {
        stage.off();
        Self { stage, duty: Duty::OFF, direction: Direction::Ccw }
    }

    /// Switches off, whatever is cached: the hardware is written every time.
    pub(crate) fn off(&mut self) {
        self.stage.off();
        self.duty = Duty::OFF;
    }

    pub(crate) fn drive(&mut self, duty: Duty, direction: Direction) {
        if duty.is_off() {
            self.off();
            return;
        }
        if duty != self.duty || direction != self.direction {
            self.stage.drive(duty, direction);
            (self.duty, self.direction) = (duty, direction);
        }
    }

    pub(crate) fn begin_run(&mut self) {
        self.stage.restart_period();
        self.stage.mark(true);
    }

    pub(crate) fn end_run(&mut self) {
        self.off();
        self.stage.mark(false);
    }

    pub(crate) fn set_frequency(&mut self, hz: u16) {
        self.stage.set_frequency(hz);
    }

    /// The drive-on fraction now.
    pub const fn duty(&self) -> Duty {
        self.duty
    }

    /// The direction now.
    pub const fn direction(&self) -> Direction {
        self.direction
    }
}
