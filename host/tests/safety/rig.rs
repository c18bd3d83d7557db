//! A simulated board on a pseudo-terminal in real time, with what can go wrong between it and the host, and with eyes on the
//! rotor that no link has.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use twum_host::link::PseudoTerminal;
use twum_host::sim::{Board, Disturbance, FirstOrderMotor, Setup, SimulatedMotor};
use twum_shared::Direction;
use twum_shared::frame::{self, Header, MAX_ENCODED};
use twum_shared::message::{HostMessage, Mode};

/// What a test does to the line or the board.
#[derive(Clone, Copy, Debug)]
pub enum Do {
    /// The board.
    Disturb(Disturbance),
    /// So many stop frames do not arrive.
    LoseStops(u32),
    /// The cable is pulled, for good.
    Pull,
    /// A viewer says hello and shows life, ten times a second.
    View,
    /// The last frames of the host, all of them, come again.
    Replay,
    /// The rig ends.
    End,
}

/// What is seen of the rotor, in µs of the board's clock, which is the rig's own.
#[derive(Clone, Copy, Debug, Default)]
pub struct Seen {
    /// When the rotor was driven last, by the PWM or by the driver board.
    pub driven_us: u64,
    pub angle_rad: f64,
    /// Runs and text commands that began.
    pub begun: u32,
}

#[derive(Default)]
struct Common {
    seen: Seen,
    wanted: VecDeque<Do>,
    /// When a thread that wanted to run was kept from it, µs: from, to.
    kept_us: Vec<(u64, u64)>,
    /// When the board stood still for longer than two turns, µs: from, to.
    stood_us: Vec<(u64, u64)>,
}

pub struct Rig {
    pub port: String,
    started: Instant,
    common: Arc<Mutex<Common>>,
    ends: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

/// What a thread that sleeps for a millisecond oversleeps on a machine that does nothing else, µs.
const OVERSLEPT_US: u64 = 300;

/// A turn of the board, at the most, on a machine that does nothing else, µs.
const TURN_US: u64 = 2_500;

/// Notes for how long the machine keeps a thread from running that asks for next to nothing.
fn watch_the_machine(started: Instant, common: &Mutex<Common>, ends: &AtomicBool) {
    let now_us = || started.elapsed().as_micros() as u64;
    while !ends.load(Ordering::Relaxed) {
        let due_us = now_us() + 1_000;
        std::thread::sleep(Duration::from_millis(1));
        let now_us = now_us();
        if now_us > due_us + OVERSLEPT_US {
            common.lock().unwrap().kept_us.push((due_us, now_us));
        }
    }
}

/// The motor, watched.
struct Watched {
    motor: FirstOrderMotor,
    now_s: f64,
    common: Arc<Mutex<Common>>,
}

impl Watched {
    fn see(&self, driven: bool, angle_rad: f64) {
        let mut common = self.common.lock().unwrap();
        common.seen.angle_rad = angle_rad;
        if driven {
            common.seen.driven_us = (self.now_s * 1e6) as u64;
        }
    }
}

impl SimulatedMotor for Watched {
    fn advance(&mut self, dt_s: f64, drive_on: bool, direction: Direction) -> f64 {
        self.now_s += dt_s;
        let angle_rad = self.motor.advance(dt_s, drive_on, direction);
        self.see(drive_on, angle_rad);
        angle_rad
    }

    fn nudge(&mut self, angle_rad: f64) {
        self.motor.nudge(angle_rad);
        let mut common = self.common.lock().unwrap();
        common.seen.driven_us = (self.now_s * 1e6) as u64;
    }
}

impl Rig {
    pub fn start() -> Self {
        let PseudoTerminal { board: line, name: port, kept_open } = PseudoTerminal::open().expect("a pseudo-terminal");
        let common = Arc::new(Mutex::new(Common::default()));
        let started = Instant::now();
        let (inner, watched, ends) = (common.clone(), common.clone(), Arc::new(AtomicBool::new(false)));
        let inner_ends = ends.clone();
        let watcher = std::thread::spawn(move || watch_the_machine(started, &watched, &inner_ends));
        let thread = std::thread::spawn(move || {
            let motor = Watched { motor: FirstOrderMotor::default(), now_s: 0.0, common: inner.clone() };
            let board = Board::new(Setup { motor: Box::new(motor), ..Setup::default() });
            Server::new(board, line, kept_open, started, inner).serve();
        });
        Self { port, started, common, ends, threads: vec![thread, watcher] }
    }

    /// For how long, between two times, the machine kept a thread that wanted to run from it, µs.
    pub fn kept_us(&self, from_us: u64, to_us: u64) -> u64 {
        let kept = &self.common.lock().unwrap().kept_us;
        kept.iter().map(|&(from, to)| to.min(to_us).saturating_sub(from.max(from_us))).sum()
    }

    /// For how long at the most the board stood still at some time between two.
    pub fn stood_us(&self, from_us: u64, to_us: u64) -> u64 {
        let stood = &self.common.lock().unwrap().stood_us;
        stood
            .iter()
            .filter(|(from, to)| *from <= to_us && *to >= from_us)
            .map(|(from, to)| to - from)
            .max()
            .unwrap_or(0)
    }

    pub fn now_us(&self) -> u64 {
        self.started.elapsed().as_micros() as u64
    }

    pub fn seen(&self) -> Seen {
        self.common.lock().unwrap().seen
    }

    pub fn act(&self, what: Do) {
        self.common.lock().unwrap().wanted.push_back(what);
    }

    /// Waits until this holds; whether it came to that.
    pub fn wait_until(&self, limit: Duration, holds: impl Fn(&Seen) -> bool) -> bool {
        let until = Instant::now() + limit;
        while Instant::now() < until {
            if holds(&self.seen()) {
                return true;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        false
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        self.act(Do::End);
        self.ends.store(true, Ordering::Relaxed);
        self.threads.drain(..).for_each(|thread| _ = thread.join());
    }
}

struct Server {
    board: Board,
    line: Option<File>,
    /// After a pull too: its name is nobody else's while a program may still look for it.
    _kept_open: File,
    started: Instant,
    common: Arc<Mutex<Common>>,
    backlog: Vec<u8>,
    /// A frame of the host that is not whole yet.
    partial: Vec<u8>,
    /// Every frame the host sent.
    said: Vec<u8>,
    stops_to_lose: u32,
    viewing: bool,
    next_view_us: u64,
    moving: bool,
}

impl Server {
    fn new(board: Board, line: File, kept_open: File, started: Instant, common: Arc<Mutex<Common>>) -> Self {
        Self {
            board,
            line: Some(line),
            _kept_open: kept_open,
            started,
            common,
            backlog: Vec::new(),
            partial: Vec::new(),
            said: Vec::new(),
            stops_to_lose: 0,
            viewing: false,
            next_view_us: 0,
            moving: false,
        }
    }

    fn serve(mut self) {
        let mut buffer = [0; 4096];
        loop {
            let wanted = self.common.lock().unwrap().wanted.pop_front();
            match wanted {
                Some(Do::End) => return,
                Some(what) => self.act(what),
                None => {}
            }
            // Before the line is heard, so that the board goes no further than it has heard: to look at a line waits for the kernel's worker
            // that hands over what has arrived, for half a second on a busy machine.
            let now_us = self.started.elapsed().as_micros() as u64;
            self.note_if_it_stood(now_us);
            if let Some(master) = &mut self.line
                && let Ok(length) = master.read(&mut buffer)
            {
                self.take(&buffer[..length]);
            }
            self.view();
            self.board.run_until(now_us);
            self.count_runs();
            self.board.received(&mut self.backlog);
            if let Some(master) = &mut self.line
                && !self.backlog.is_empty()
                && let Ok(written) = master.write(&self.backlog)
            {
                self.backlog.drain(..written);
            }
            let excess = self.backlog.len().saturating_sub(1 << 18);
            self.backlog.drain(..excess);
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn note_if_it_stood(&self, now_us: u64) {
        let since_us = self.board.now_us();
        if now_us > since_us + 2 * TURN_US {
            self.common.lock().unwrap().stood_us.push((since_us, now_us));
        }
    }

    fn act(&mut self, what: Do) {
        match what {
            Do::Disturb(disturbance) => self.board.disturb(disturbance),
            Do::LoseStops(count) => self.stops_to_lose = count,
            Do::Pull => self.line = None,
            Do::View => self.viewing = true,
            Do::Replay => self.board.send(&self.said.clone()),
            Do::End => {}
        }
    }

    /// Passes whole frames on, but for the stops that are to be lost.
    fn take(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.partial.push(byte);
            if byte != 0 {
                continue;
            }
            let frame = std::mem::take(&mut self.partial);
            let mut block = frame[..frame.len() - 1].to_vec();
            let decoded = frame::decode::<HostMessage>(&mut block);
            if self.stops_to_lose > 0 && matches!(decoded, Ok((_, HostMessage::Stop { .. }))) {
                self.stops_to_lose -= 1;
                continue;
            }
            self.said.extend(&frame);
            self.board.send(&frame);
        }
    }

    fn view(&mut self) {
        let now_us = self.board.now_us();
        if !self.viewing || now_us < self.next_view_us {
            return;
        }
        self.next_view_us = now_us + 100_000;
        for (sequence, message) in [HostMessage::Hello, HostMessage::Keepalive { token: 0xBEEF }].iter().enumerate() {
            let header = Header { sequence: now_us as u32 + sequence as u32, time_us: 0 };
            self.board.send(frame::encode(header, message, &mut [0; MAX_ENCODED]).unwrap());
        }
    }

    fn count_runs(&mut self) {
        let moving = matches!(self.board.mode(), Mode::Running | Mode::Passthrough | Mode::Aligning);
        if moving && !self.moving {
            self.common.lock().unwrap().seen.begun += 1;
        }
        self.moving = moving;
    }
}
