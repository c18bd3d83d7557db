use super::clock;
use super::driver_board::{DriverBoard, DriverHealth};
use super::firmware::{Firmware, boot};
use super::flash::Flash;
use super::motor::{FirstOrderMotor, SimulatedMotor};
use super::silicon::{Chip, Half, PadEdge, Silicon};
use super::wire::Wire;
use std::cell::Cell;
use std::rc::Rc;
use twum_firmware::fatal;
use twum_firmware::stage::Registers;
use twum_motor::effects::EffectSet;
use twum_motor::plant::Segment;
use twum_motor::sensor::Encoder;
use twum_shared::message::{Mode, ResetCause};
use twum_shared::{Direction, Fault};

/// The plant moves in steps no longer than this, µs.
const PLANT_STEP_US: u64 = 50;
/// Baud rate of the link.
const LINK_BAUD: u32 = 921_600;
/// Baud rate of the driver board (thesis C.1).
const DRIVER_BAUD: u32 = 19_200;
/// The hardware watchdog bites after this long without being fed.
const WATCHDOG_US: u64 = 1_000_000;

/// A simulated board before it is switched on.
pub struct Setup {
    /// Edges of the encoder a revolution.
    pub edges_per_rev: u32,
    /// The rotor's angle within an encoder pitch at the start, as a fraction of the pitch in [0, 2): at 1 and above the
    /// encoder line starts high.
    pub start_pitch: f64,
    /// What the board says it simulates: see [`super::Simulated`].
    pub simulates: String,
    /// Whose modules drive the pins.
    pub chip: Chip,
    /// The motor.
    pub motor: Box<dyn SimulatedMotor>,
    /// The encoder's own faults, if it has any.
    pub encoder_effects: EffectSet,
    /// How well the driver board is.
    pub driver: DriverHealth,
    /// Why the board starts.
    pub reset: ResetCause,
    /// The device clock at the start, µs.
    pub start_us: u64,
    /// Seed of the ticks' start jitter; zero for none.
    pub jitter_seed: u64,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            edges_per_rev: 400,
            start_pitch: 0.3,
            simulates: "simulated simple".to_owned(),
            chip: Chip::default(),
            motor: Box::new(FirstOrderMotor::default()),
            encoder_effects: EffectSet::default(),
            driver: DriverHealth::Well,
            reset: ResetCause::PowerOn,
            start_us: 0,
            jitter_seed: 1,
        }
    }
}

/// What a test or a user does to a running board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Disturbance {
    /// Control ticks start so much later than they are due, µs.
    LateTicks(u64),
    /// The encoder line makes so many extra edges in every control period.
    Chatter(u32),
    /// The encoder line is dead.
    EncoderDead(bool),
    /// The stop input is pulled low, or released.
    StopInput(bool),
    /// A task asks for this fault, as it does when it meets it.
    Fault(Fault),
    /// The control interrupt no longer runs: the hardware watchdog has to act.
    ControlHung,
    /// The tasks no longer run: the hardware watchdog has to act.
    TasksHung,
    /// The board restarts for this reason: a supply that sags; the reset pin.
    Reset(ResetCause),
    /// The firmware panics, in a task or in a control interrupt. The handler runs there until the board restarts; what else
    /// the chip executes meanwhile goes on.
    Panic(Half),
    /// The driver board's power is cycled.
    DriverPowerCycled,
}

/// A board that is asked to restart first sends what it has to say, for so long.
const REBOOT_US: u64 = 20_000;

/// A panic handler writes its message and backtrace for about so long before it restarts the chip.
const PANIC_US: u64 = 600_000;

/// A simulated board with its driver board and motor. It lives on one thread: its clock is the thread's.
pub struct Board {
    firmware: Firmware,
    chip: Chip,
    silicon: Silicon,
    encoder_level: Rc<Cell<bool>>,
    fed_us: Rc<Cell<u64>>,
    flash: Flash,
    to_board: Wire,
    from_board: Wire,
    driver_rx: Wire,
    driver_tx: Wire,
    driver: DriverBoard,
    motor: Box<dyn SimulatedMotor>,
    encoder: Encoder,
    simulates: String,
    angle_rad: f64,
    jitter: u64,
    late_us: u64,
    chatter: u32,
    encoder_dead: bool,
    stop_input_low: bool,
    control_hung: bool,
    tasks_hung: bool,
    reboot_us: Option<u64>,
    panicked: Option<(u64, Half)>,
}

impl Board {
    /// Switches a board on. Resets this thread's clock.
    pub fn new(setup: Setup) -> Self {
        clock::reset(setup.start_us);
        let silicon = Silicon::new(setup.chip, setup.start_us);
        let mut motor = setup.motor;
        let angle_rad = motor.advance(0.0, false, Direction::Cw);
        let pitch_rad = std::f64::consts::TAU / f64::from(setup.edges_per_rev);
        let mut encoder = Encoder::new(setup.edges_per_rev, setup.start_pitch * pitch_rad, &setup.encoder_effects);
        let there = Segment { end_rad: angle_rad, ..Segment::default() };
        encoder.watch(&there, &mut |_| {});
        let encoder_level = Rc::new(Cell::new(encoder.level()));
        let fed_us = Rc::new(Cell::new(setup.start_us));
        let (to_board, from_board) = (Wire::new(LINK_BAUD), Wire::new(LINK_BAUD));
        let (driver_rx, driver_tx) = (Wire::new(DRIVER_BAUD), Wire::new(DRIVER_BAUD));
        let wires = [&to_board, &from_board, &driver_rx, &driver_tx].map(Clone::clone);
        let flash = Flash::erased();
        let firmware = boot(&silicon, &encoder_level, &fed_us, &flash, &wires, &setup.simulates, setup.reset);
        Self {
            firmware,
            chip: setup.chip,
            silicon,
            encoder_level,
            fed_us,
            flash,
            to_board,
            from_board,
            driver_rx,
            driver_tx,
            driver: DriverBoard::new(setup.driver),
            motor,
            encoder,
            simulates: setup.simulates,
            angle_rad,
            jitter: setup.jitter_seed,
            late_us: 0,
            chatter: 0,
            encoder_dead: false,
            stop_input_low: false,
            control_hung: false,
            tasks_hung: false,
            reboot_us: None,
            panicked: None,
        }
    }

    /// The device clock, µs.
    pub fn now_us(&self) -> u64 {
        clock::now_us()
    }

    /// Puts bytes from the host on the line.
    pub fn send(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.to_board.send(clock::now_us(), byte);
        }
    }

    /// Takes what the board has sent so far.
    pub fn received(&mut self, into: &mut Vec<u8>) {
        let now_us = clock::now_us();
        while let Some(byte) = self.from_board.receive(now_us) {
            into.push(byte);
        }
    }

    /// Whether the pins hold the motor off, now and with the next PWM period.
    pub fn output_is_off(&self) -> bool {
        self.silicon.is_disconnected() && (self.firmware.latch.is_shut() || !self.silicon.is_told_to_drive())
    }

    /// From now on, keeps the levels the PWM wire takes, for [`Board::pwm_edges`].
    pub fn watch_pwm(&mut self) {
        self.silicon.watch();
    }

    /// Whether the chip drives the PWM wire, high or low; else only the pull-up holds it.
    pub fn pwm_is_driven(&self) -> bool {
        self.silicon.is_driven()
    }

    /// The levels the PWM wire took since it is watched, the one it had then first.
    pub fn pwm_edges(&self) -> Vec<PadEdge> {
        self.silicon.edges()
    }

    /// The supervisor's state, seen from outside the link.
    pub fn mode(&self) -> Mode {
        self.firmware.control.mode()
    }

    /// The rotor's true angle, rad.
    pub fn angle_rad(&self) -> f64 {
        self.angle_rad
    }

    /// The rotor's position as the firmware counts it, counts.
    pub fn count(&self) -> i32 {
        self.firmware.shared.encoder.count()
    }

    /// The motor, to change it while it runs.
    pub fn motor(&mut self) -> &mut dyn SimulatedMotor {
        self.motor.as_mut()
    }

    /// Does something to the board.
    pub fn disturb(&mut self, disturbance: Disturbance) {
        match disturbance {
            Disturbance::LateTicks(late_us) => self.late_us = late_us,
            Disturbance::Chatter(edges) => self.chatter = edges,
            Disturbance::EncoderDead(dead) => self.encoder_dead = dead,
            Disturbance::StopInput(low) => self.stop_input_low = low,
            Disturbance::Fault(fault) => self.firmware.shared.request_fault(fault),
            Disturbance::ControlHung => self.control_hung = true,
            Disturbance::TasksHung => self.tasks_hung = true,
            Disturbance::Reset(cause) => self.restart(cause),
            Disturbance::Panic(half) => self.panic(half),
            Disturbance::DriverPowerCycled => self.driver = DriverBoard::new(self.driver.health),
        }
    }

    /// Runs for so long, µs.
    pub fn run_for(&mut self, duration_us: u64) {
        self.run_until(clock::now_us() + duration_us);
    }

    /// Runs until the device clock shows `until_us`.
    pub fn run_until(&mut self, until_us: u64) {
        if self.tasks_run() {
            self.firmware.poll();
        }
        while clock::now_us() < until_us {
            let next_us = self.next_event_us().clamp(clock::now_us() + 1, until_us);
            self.move_plant(next_us);
            clock::set(next_us);
            self.silicon.advance(next_us);
            self.pwm_interrupt();
            self.turn_driver(next_us);
            if next_us >= self.firmware.next_tick_us + self.late_us {
                self.tick(next_us);
            }
            if self.tasks_run() {
                self.firmware.poll();
            }
            if self.firmware.shared.reboot.try_take().is_some() {
                self.reboot_us = Some(next_us + REBOOT_US);
            }
            if self.reboot_us.is_some_and(|at| at <= next_us) {
                let core = self.silicon.seen_by(Half::Tasks);
                fatal::silence(&core, &self.silicon, self.firmware.flags, self.firmware.latch);
                fatal::restart(&core);
            }
            if let Some((at_us, half)) = self.panicked
                && at_us <= next_us
            {
                fatal::restart(&self.silicon.seen_by(half));
            }
            if self.silicon.take_reset() {
                self.restart(if self.panicked.is_some() { ResetCause::Panic } else { ResetCause::Software });
            }
            if next_us.saturating_sub(self.fed_us.get()) > WATCHDOG_US {
                self.restart(ResetCause::Watchdog);
            }
        }
    }

    fn next_event_us(&self) -> u64 {
        let now_us = clock::now_us();
        let driver = self.driver.next_us(&self.driver_tx);
        [
            Some(now_us + PLANT_STEP_US),
            Some(self.firmware.next_tick_us + self.late_us),
            Some(self.silicon.next_event_us(now_us)),
            clock::next_timer_us(),
            driver,
        ]
        .into_iter()
        .flatten()
        .min()
        .unwrap_or(now_us + PLANT_STEP_US)
    }

    fn move_plant(&mut self, next_us: u64) {
        let now_us = clock::now_us();
        let direction = self.silicon.direction();
        let drive_on = self.driver.hardware && !self.silicon.pwm_level();
        let (duty, period_s) = self.silicon.pwm();
        self.motor.pwm(duty, period_s);
        let after = self.motor.advance((next_us - now_us) as f64 * 1e-6, drive_on, direction);
        self.encode(after, now_us, next_us, direction);
    }

    /// The encoder's edges on the way to an angle, with their times interpolated.
    fn encode(&mut self, after: f64, from_us: u64, to_us: u64, direction: Direction) {
        let (start_rad, end_s) = (self.angle_rad, (to_us - from_us) as f64 * 1e-6);
        let speed = if end_s > 0.0 { (after - start_rad) / end_s } else { 0.0 };
        self.angle_rad = after;
        let way = Segment { start_s: 0.0, end_s, start_rad, end_rad: after, start_rad_s: speed, end_rad_s: speed };
        let (interrupt, level, dead) = (&mut self.firmware.interrupt, &self.encoder_level, self.encoder_dead);
        self.encoder.watch(&way, &mut |edge| {
            if !dead {
                level.set(edge.level);
                interrupt.edge(edge.level, direction, (from_us + (edge.time_s * 1e6) as u64) as u32);
            }
        });
    }

    fn turn_driver(&mut self, now_us: u64) {
        let level = self.encoder_level.get();
        let nudge_rad = self.driver.turn(now_us, &self.driver_tx, &self.driver_rx, level);
        if nudge_rad != 0.0 {
            self.motor.nudge(nudge_rad);
            let after = self.motor.advance(0.0, false, Direction::Cw);
            self.encode(after, now_us, now_us, Direction::Cw);
        }
    }

    fn control_runs(&self) -> bool {
        // The core that starts the other has to run for either to.
        let started = self.silicon.executes(Half::Tasks) || self.panicked.is_some();
        !self.control_hung && self.silicon.interruptible(Half::Control) && started
    }

    fn tasks_run(&self) -> bool {
        // A handler in an interrupt of the tasks' own core keeps them from running.
        let pre_empted = self.panicked.is_some() && self.chip != Chip::Esp32;
        !self.tasks_hung && self.silicon.executes(Half::Tasks) && !pre_empted
    }

    /// What the chip's panic handler does, on the core it is called on.
    fn panic(&mut self, half: Half) {
        let core = self.silicon.seen_by(half);
        fatal::silence(&core, &self.silicon, self.firmware.flags, self.firmware.latch);
        // The handler stands where the panic was: one core has both halves, or the other core is stalled.
        match half {
            Half::Tasks => self.tasks_hung = true,
            Half::Control => self.control_hung = true,
        }
        self.panicked = Some((clock::now_us() + PANIC_US, half));
    }

    /// The PWM unit's interrupt, which has the tick's priority.
    fn pwm_interrupt(&mut self) {
        if self.silicon.overflowed() && self.control_runs() {
            self.silicon.clear_overflow();
            self.firmware.control.period_began(clock::now_us());
        }
    }

    fn tick(&mut self, now_us: u64) {
        let due_us = self.firmware.next_tick_us;
        self.firmware.next_tick_us = due_us + u64::from(self.firmware.control.period_us());
        // Ticks missed altogether merge into one, as a pending timer interrupt's do.
        while self.firmware.next_tick_us <= now_us {
            self.firmware.next_tick_us += u64::from(self.firmware.control.period_us());
        }
        if !self.control_runs() {
            return;
        }
        if self.stop_input_low {
            self.firmware.control.stop_input_is_low();
        }
        for _ in 0..self.chatter {
            let level = !self.encoder_level.get();
            self.encoder_level.set(level);
            let direction = self.silicon.direction();
            self.firmware.interrupt.edge(level, direction, now_us as u32);
        }
        let jitter_us = self.jitter_us();
        self.firmware.control.tick(due_us, now_us + jitter_us, self.encoder_level.get(), || now_us + jitter_us + 12);
    }

    /// A tick starts up to 3 µs late, as on a chip whose other interrupts are short. xorshift, so that runs repeat.
    fn jitter_us(&mut self) -> u64 {
        if self.jitter == 0 {
            return 0;
        }
        self.jitter ^= self.jitter << 13;
        self.jitter ^= self.jitter >> 7;
        self.jitter ^= self.jitter << 17;
        self.jitter % 4
    }

    fn restart(&mut self, reset: ResetCause) {
        self.from_board.clear();
        self.control_hung = false;
        self.tasks_hung = false;
        (self.reboot_us, self.panicked) = (None, None);
        clock::forget_timers();
        self.fed_us.set(clock::now_us());
        self.silicon.reset(self.chip, matches!(reset, ResetCause::Software | ResetCause::Panic));
        let wires = [&self.to_board, &self.from_board, &self.driver_rx, &self.driver_tx].map(Clone::clone);
        self.firmware =
            boot(&self.silicon, &self.encoder_level, &self.fed_us, &self.flash, &wires, &self.simulates, reset);
    }
}
