//! What a chip's modules do behind the firmware's registers: the PWM unit, the pads, the cores. The chip's own output stage
//! ([`twum_firmware::stage`]) runs against it, so what the simulated board's pins do is what that code makes of the
//! hardware the manuals describe.

mod cores;
mod ledc;

use cores::Cores;
pub use cores::Half;
use ledc::Ledc;
use std::cell::RefCell;
use std::rc::Rc;
use twum_firmware::fatal::System;
use twum_firmware::stage::{Registers, Source, Wire};
use twum_shared::Direction;

/// Cycles of the PWM unit's clock in a microsecond.
const CYCLES_PER_US: u64 = 80;

/// Which chip's modules.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Chip {
    /// Two Xtensa cores: control has the second for itself.
    Esp32,
    /// One RISC-V core.
    #[default]
    Esp32c3,
    /// One RISC-V core.
    Esp32c6,
}

impl Chip {
    /// Every chip.
    pub const ALL: [Self; 3] = [Self::Esp32, Self::Esp32c3, Self::Esp32c6];
}

/// A level a wire took, and when, ns of device time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PadEdge {
    /// When, ns.
    pub time_ns: u64,
    /// The level since.
    pub high: bool,
}

/// A wire's pad: chapter "IO MUX and GPIO Matrix".
#[derive(Clone, Debug)]
struct Pad {
    /// Whether the IO MUX gives the pad to the GPIO matrix.
    taken: bool,
    level: bool,
    source: Source,
    output: bool,
}

impl Pad {
    /// After reset no driver is on, and the pad has the function its column "reset" names, which need not be GPIO.
    const fn new() -> Self {
        Self { taken: false, level: false, source: Source::Level, output: false }
    }

    /// The wire's level: driven, or pulled up (the 10 kΩ of the wiring) where nothing drives. "GPIO output enable" and the
    /// matrix reach a pad only through the IO MUX's function GPIO.
    fn wire_level(&self, unit: bool) -> bool {
        match (self.taken && self.output, self.source) {
            (false, _) | (true, Source::Uart) => true,
            (true, Source::Level) => self.level,
            (true, Source::Pwm) => unit,
        }
    }
}

/// The modules' state.
#[derive(Debug)]
pub(super) struct State {
    now: u64,
    ledc: Ledc,
    cores: Cores,
    /// A software reset was asked for.
    reset: bool,
    pwm: Pad,
    direction: Pad,
    mark: Pad,
    /// The levels the PWM wire took, since somebody wants to know.
    edges: Option<Vec<PadEdge>>,
}

impl State {
    fn pwm_level(&self) -> bool {
        self.pwm.wire_level(self.ledc.output(self.now))
    }

    fn note(&mut self) {
        let (high, time_ns) = (self.pwm_level(), self.now * 1_000 / CYCLES_PER_US);
        if let Some(edges) = &mut self.edges
            && edges.last().is_none_or(|edge| edge.high != high)
        {
            edges.push(PadEdge { time_ns, high });
        }
    }

    fn pad(&mut self, wire: Wire) -> &mut Pad {
        match wire {
            Wire::Pwm => &mut self.pwm,
            Wire::Direction => &mut self.direction,
            Wire::Mark => &mut self.mark,
        }
    }
}

/// A chip's modules, shared by everything that reaches their registers.
#[derive(Clone, Debug)]
pub(super) struct Silicon(Rc<RefCell<State>>);

impl Silicon {
    /// A chip that was powered at `now_us`.
    pub fn new(chip: Chip, now_us: u64) -> Self {
        let now = now_us * CYCLES_PER_US;
        let state = State {
            now,
            ledc: Ledc::new(chip, now),
            cores: Cores::new(chip),
            reset: false,
            pwm: Pad::new(),
            direction: Pad::new(),
            mark: Pad::new(),
            edges: None,
        };
        Self(Rc::new(RefCell::new(state)))
    }

    /// "Reset and Clock": a reset of the digital system sets its modules back. Time goes on, and so does the watching.
    pub fn reset(&self, chip: Chip, software: bool) {
        let mut state = self.0.borrow_mut();
        state.cores.reset(software);
        state.ledc = Ledc::new(chip, state.now);
        (state.pwm, state.direction, state.mark) = (Pad::new(), Pad::new(), Pad::new());
        state.note();
    }

    /// From now on, keeps the levels the PWM wire takes.
    pub fn watch(&self) {
        let mut state = self.0.borrow_mut();
        state.edges = Some(Vec::new());
        state.note();
    }

    /// Lets the modules run up to `now_us`.
    pub fn advance(&self, now_us: u64) {
        let mut state = self.0.borrow_mut();
        let until = now_us * CYCLES_PER_US;
        loop {
            let next = state.ledc.next_event(state.now);
            if next > until {
                break;
            }
            state.now = next;
            state.ledc.turn(next);
            state.note();
        }
        state.now = until;
    }

    /// When the modules next do something, µs, after `now_us`.
    pub fn next_event_us(&self, now_us: u64) -> u64 {
        self.0.borrow().ledc.next_event(now_us * CYCLES_PER_US).div_ceil(CYCLES_PER_US)
    }

    /// Whether the PWM unit asks for its interrupt.
    pub fn overflowed(&self) -> bool {
        self.0.borrow().ledc.overflowed
    }

    /// The level of the PWM wire.
    pub fn pwm_level(&self) -> bool {
        self.0.borrow().pwm_level()
    }

    /// The fraction of the running period that the unit keeps the wire low for, the drive's duty, and the period's length (s).
    pub fn pwm(&self) -> (f64, f64) {
        self.0.borrow().ledc.running()
    }

    /// Whether the PWM wire's driver is on.
    pub fn is_driven(&self) -> bool {
        let state = self.0.borrow();
        state.pwm.taken && state.pwm.output
    }

    /// The direction the wire says.
    pub fn direction(&self) -> Direction {
        Direction::from_pin(self.0.borrow().direction.level)
    }

    /// Whether the PWM wire is disconnected from the unit.
    pub fn is_disconnected(&self) -> bool {
        self.0.borrow().pwm.source != Source::Pwm
    }

    /// Whether the unit is told a drive's duty.
    pub fn is_told_to_drive(&self) -> bool {
        !self.0.borrow().ledc.is_told_off()
    }

    /// The levels the PWM wire took since it is watched.
    pub fn edges(&self) -> Vec<PadEdge> {
        self.0.borrow().edges.clone().unwrap_or_default()
    }

    /// Whether interrupts of this half's core are served.
    pub fn interruptible(&self, half: Half) -> bool {
        self.0.borrow().cores.interruptible(half)
    }

    /// Whether this half's core executes instructions.
    pub fn executes(&self, half: Half) -> bool {
        self.0.borrow().cores.executes(half)
    }

    /// Whether a software reset was asked for since the last time this was.
    pub fn take_reset(&self) -> bool {
        std::mem::take(&mut self.0.borrow_mut().reset)
    }

    /// The chip as the core of this half sees it.
    pub fn seen_by(&self, half: Half) -> Core<'_> {
        Core { silicon: self, half }
    }

    fn write(&self, change: impl FnOnce(&mut State)) {
        let mut state = self.0.borrow_mut();
        change(&mut state);
        state.note();
    }
}

impl Registers for Silicon {
    fn take_pad(&self, wire: Wire) {
        self.write(|state| state.pad(wire).taken = true);
    }

    fn set_level(&self, wire: Wire, high: bool) {
        self.write(|state| state.pad(wire).level = high);
    }

    fn route(&self, wire: Wire, source: Source) {
        self.write(|state| state.pad(wire).source = source);
    }

    fn enable_output(&self, wire: Wire, on: bool) {
        self.write(|state| state.pad(wire).output = on);
    }

    fn receive_on(&self, _: Wire) {}

    fn write_duty(&self, high: u32) {
        self.write(|state| state.ledc.write_duty(high));
    }

    fn start_duty(&self) {
        self.write(|state| state.ledc.start_duty());
    }

    fn update_channel(&self) {
        self.write(|state| state.ledc.update_channel());
    }

    fn loaded_duty(&self) -> u32 {
        self.0.borrow().ledc.loaded_duty()
    }

    fn write_divider(&self, divider: u32) {
        self.write(|state| state.ledc.write_divider(divider));
    }

    fn update_timer(&self) {
        self.write(|state| state.ledc.update_timer(state.now));
    }

    fn count(&self) -> u32 {
        let state = self.0.borrow();
        state.ledc.count(state.now)
    }

    fn clear_overflow(&self) {
        self.write(|state| state.ledc.overflowed = false);
    }
}

/// The chip as one of its cores sees it.
pub(super) struct Core<'a> {
    silicon: &'a Silicon,
    half: Half,
}

impl System for Core<'_> {
    fn mask_interrupts(&self) {
        self.silicon.0.borrow_mut().cores.mask(self.half);
    }

    fn hold_other_core(&self) {
        self.silicon.0.borrow_mut().cores.stall_other(self.half, true);
    }

    fn release_other_core(&self) {
        self.silicon.0.borrow_mut().cores.stall_other(self.half, false);
    }

    fn reset(&self) {
        self.silicon.0.borrow_mut().reset = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wire_is_pulled_up_until_its_pad_is_taken_and_its_driver_on() {
        let mut pad = Pad::new();
        assert!(pad.wire_level(false), "after reset");
        pad.output = true;
        assert!(pad.wire_level(false), "the pad is still another function's");
        pad.taken = true;
        assert!(!pad.wire_level(true), "its own level");
        pad.source = Source::Pwm;
        assert!(pad.wire_level(true) && !pad.wire_level(false), "the unit's");
        pad.output = false;
        assert!(pad.wire_level(false), "pulled up");
    }

    #[test]
    fn a_write_shows_on_the_wire_at_once_and_a_reset_lets_go_of_it() {
        let chip = Silicon::new(Chip::Esp32c3, 0);
        chip.watch();
        for wire in [Wire::Pwm, Wire::Direction] {
            chip.take_pad(wire);
            chip.enable_output(wire, true);
        }
        chip.advance(3);
        chip.set_level(Wire::Pwm, true);
        chip.advance(5);
        chip.set_level(Wire::Pwm, false);
        chip.advance(8);
        chip.reset(Chip::Esp32c3, true);
        let edges = [(0, true), (0, false), (3, true), (5, false), (8, true)];
        assert_eq!(chip.edges(), edges.map(|(us, high)| PadEdge { time_ns: us * 1_000, high }));
        assert!(!chip.is_driven());
    }
}
