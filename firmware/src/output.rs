//! The output stage. [`Output`] is the only type that can energise the motor, and it starts by switching it off.

use portable_atomic::{AtomicBool, Ordering};
use twum_shared::{Direction, Duty};

/// Whether an output is dead. Once shut, it stays so until the program is started anew: nothing opens it, and an
/// [`Output`] energises nothing behind it, whoever asks.
#[derive(Debug, Default)]
pub struct Latch(AtomicBool);

impl Latch {
    /// An output that may live.
    pub const fn new() -> Self {
        Self(AtomicBool::new(false))
    }

    /// Ends the output's life. From any core, in any context.
    pub fn shut(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Whether it was.
    pub fn is_shut(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

/// The PWM pin (active low) and the direction pin, as a board drives them. Called from the control interrupt only, so it
/// must not block; a board writes registers here.
pub trait OutputStage {
    /// Holds the PWM pin high: no drive, at once.
    fn off(&mut self);
    /// Sets the drive-on fraction from the next PWM period on, and the direction at once.
    fn drive(&mut self, duty: Duty, direction: Direction);
    /// A PWM period began: connects the drive if it is the first that carries it. Gives how long ago that was, µs; `None`
    /// while the drive that was told is not yet in a period.
    fn period_began(&mut self) -> Option<u32>;
    /// Sets the PWM frequency. Called only while the output is off.
    fn set_frequency(&mut self, hz: u16);
    /// Marks a run on the start-mark pin.
    fn mark(&mut self, running: bool);
}

/// The motor's output, off until told otherwise.
#[derive(Debug)]
pub struct Output<S> {
    stage: S,
    latch: &'static Latch,
    duty: Duty,
    direction: Direction,
}

impl<S: OutputStage> Output<S> {
    /// Takes the stage and switches it off before anything else. A board calls this first of all, before anything that can
    /// fail. `latch` is the one the board's panic handler shuts.
    pub fn boot(mut stage: S, latch: &'static Latch) -> Self {
        stage.off();
        Self { stage, latch, duty: Duty::OFF, direction: Direction::Ccw }
    }

    /// Switches off, whatever is cached: the hardware is written every time.
    pub(crate) fn off(&mut self) {
        self.stage.off();
        self.duty = Duty::OFF;
    }

    pub(crate) fn drive(&mut self, duty: Duty, direction: Direction) {
        if duty.is_off() || self.latch.is_shut() {
            self.off();
            return;
        }
        if duty != self.duty || direction != self.direction {
            self.stage.drive(duty, direction);
            (self.duty, self.direction) = (duty, direction);
        }
    }

    pub(crate) fn period_began(&mut self) -> Option<u32> {
        if self.latch.is_shut() {
            self.off();
            return None;
        }
        self.stage.period_began()
    }

    pub(crate) fn begin_run(&mut self) {
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

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::Shared;
    use crate::control::Control;
    use crate::queues::Queues;
    use std::cell::RefCell;
    use std::rc::Rc;
    use std::vec::Vec;
    use twum_shared::message::{Configuration, ResetCause};
    use twum_shared::step::ConfigSpec;

    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    enum Call {
        Off,
        Drive,
        Period,
        Frequency(u16),
        Mark(bool),
    }

    static LATCH: Latch = Latch::new();

    /// A stage that writes down what is done to it.
    #[derive(Clone, Default)]
    struct Recorder(Rc<RefCell<Vec<Call>>>);

    impl OutputStage for Recorder {
        fn off(&mut self) {
            self.0.borrow_mut().push(Call::Off);
        }

        fn drive(&mut self, _: Duty, _: Direction) {
            self.0.borrow_mut().push(Call::Drive);
        }

        fn period_began(&mut self) -> Option<u32> {
            self.0.borrow_mut().push(Call::Period);
            Some(0)
        }

        fn set_frequency(&mut self, hz: u16) {
            self.0.borrow_mut().push(Call::Frequency(hz));
        }

        fn mark(&mut self, running: bool) {
            self.0.borrow_mut().push(Call::Mark(running));
        }
    }

    #[test]
    fn booting_switches_off_first_and_nothing_drives_without_a_command() {
        let recorder = Recorder::default();
        let output = Output::boot(recorder.clone(), &LATCH);
        assert_eq!(*recorder.0.borrow(), [Call::Off], "off comes before everything else, and at once");

        let (shared, mut queues) = (Shared::new(), Queues::new());
        let (ends, _, _) = queues.split();
        let mut control = Control::new(&shared, ends, output, ResetCause::PowerOn);
        control.restore(Configuration::with_control(ConfigSpec::DEFAULT)).unwrap();
        for tick in 0..10_000u64 {
            control.tick(500 * tick, 500 * tick, tick % 7 == 0, || 500 * tick);
            control.period_began(500 * tick);
        }
        let mut calls = recorder.0.borrow().clone();
        calls.retain(|call| *call != Call::Period);
        assert_eq!(calls, [Call::Off, Call::Frequency(50)]);
    }

    #[test]
    fn a_dead_output_drives_nothing_whoever_asks() {
        static DEAD: Latch = Latch::new();
        let recorder = Recorder::default();
        let mut output = Output::boot(recorder.clone(), &DEAD);
        output.drive(Duty::FULL, Direction::Cw);
        assert_eq!(*recorder.0.borrow(), [Call::Off, Call::Drive]);
        DEAD.shut();
        output.drive(Duty::from_ratio(1, 2), Direction::Cw);
        output.drive(Duty::FULL, Direction::Ccw);
        assert_eq!(output.period_began(), None);
        assert_eq!(*recorder.0.borrow(), [Call::Off, Call::Drive, Call::Off, Call::Off, Call::Off]);
        assert!(output.duty().is_off());
    }

    #[test]
    fn a_boot_after_the_watchdog_or_a_panic_is_off_too() {
        for reset in [ResetCause::Watchdog, ResetCause::Panic] {
            let recorder = Recorder::default();
            let (shared, mut queues) = (Shared::new(), Queues::new());
            let (ends, _, _) = queues.split();
            let mut control = Control::new(&shared, ends, Output::boot(recorder.clone(), &LATCH), reset);
            for tick in 0..100u64 {
                control.tick(500 * tick, 500 * tick, false, || 500 * tick);
            }
            assert_eq!(*recorder.0.borrow(), [Call::Off], "{reset:?}");
        }
    }
}
