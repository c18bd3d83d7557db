//! A simulated bench: a DG1022 and an oscilloscope on loopback, with a stator behind a shunt between them.
//!
//! Each answers its own commands only as far as the drivers and the thesis's listing use them; anything else is an error
//! the bench remembers, so that a test can ask whether there was any.

use super::oscilloscope::Family;
use nalgebra::Complex;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;
use std::io::{BufRead, BufReader, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use twum_identify::circuit::{Circuit, Mode};

/// Motional inductance of the thesis's stator (H).
pub const INDUCTANCE_H: f64 = 2.1094;
/// Its motional capacitance (F).
pub const CAPACITANCE_F: f64 = 6.1653e-12;
/// Its motional resistance (Ω).
pub const RESISTANCE_OHM: f64 = 18_488.0;
/// A clamped capacitance (F): the thesis's own is part of its probes'.
pub const CLAMPED_F: f64 = 150e-12;
/// A dielectric loss (Ω).
pub const LOSS_OHM: f64 = 2e6;

/// Output resistance of the generator (Ω).
const SOURCE_OHM: f64 = 50.0;

/// What stands on the bench.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// The stator.
    pub circuit: Circuit,
    /// Shunt before it (Ω).
    pub shunt_ohm: f64,
    /// Noise at each input (V).
    pub noise_v: f64,
    /// Which oscilloscope.
    pub family: Family,
    /// Seed of noise and trigger jitter.
    pub seed: u64,
    /// Ports of generator and oscilloscope; 0 takes any.
    pub ports: (u16, u16),
}

impl Default for Setup {
    /// The thesis's stator and shunt, and a DS1104Z.
    fn default() -> Self {
        let mode = Mode::from_elements(INDUCTANCE_H, CAPACITANCE_F, RESISTANCE_OHM);
        Self {
            circuit: Circuit::single(CLAMPED_F, LOSS_OHM, mode),
            shunt_ohm: 2000.0,
            noise_v: 0.01,
            family: Family::Ds1104z,
            seed: 1,
            ports: (0, 0),
        }
    }
}

/// One output of the generator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Output {
    /// Whether it is on.
    pub on: bool,
    /// Frequency (Hz).
    pub frequency_hz: f64,
    /// Amplitude, peak to peak (V).
    pub vpp: f64,
}

#[derive(Debug)]
struct State {
    setup: Setup,
    outputs: [Output; 2],
    scale: [f64; 2],
    offset: [f64; 2],
    second_a_division: f64,
    delay_s: f64,
    source: usize,
    armed: u32,
    frozen: Option<[Vec<u8>; 2]>,
    errors: Vec<String>,
    largest_vpp: f64,
    rng: ChaCha8Rng,
}

/// A running bench; it stops when dropped.
#[derive(Debug)]
pub struct Bench {
    /// Where the generator listens.
    pub generator: SocketAddr,
    /// Where the oscilloscope listens.
    pub scope: SocketAddr,
    state: Arc<Mutex<State>>,
    stop: Arc<AtomicBool>,
}

impl Bench {
    /// Starts both instruments on loopback.
    ///
    /// # Errors
    /// When a port cannot be bound.
    pub fn start(setup: Setup) -> std::io::Result<Self> {
        let ports = setup.ports;
        let rng = ChaCha8Rng::seed_from_u64(setup.seed);
        let state = Arc::new(Mutex::new(State {
            setup,
            outputs: [Output { on: false, frequency_hz: 1000.0, vpp: 5.0 }; 2],
            scale: [1.0; 2],
            offset: [0.0; 2],
            second_a_division: 1e-3,
            delay_s: 0.0,
            source: 0,
            armed: 0,
            frozen: None,
            errors: Vec::new(),
            largest_vpp: 0.0,
            rng,
        }));
        let stop = Arc::new(AtomicBool::new(false));
        let generator = serve(ports.0, &state, &stop, generator_answers)?;
        let scope = serve(ports.1, &state, &stop, scope_answers)?;
        Ok(Self { generator, scope, state, stop })
    }

    /// The generator's outputs as they are now.
    pub fn outputs(&self) -> [Output; 2] {
        lock(&self.state).outputs
    }

    /// Commands that either instrument did not understand or refused.
    pub fn errors(&self) -> Vec<String> {
        lock(&self.state).errors.clone()
    }

    /// The largest amplitude ever asked of an output (V, peak to peak).
    pub fn largest_vpp(&self) -> f64 {
        lock(&self.state).largest_vpp
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // Wakes the listeners from their wait.
        for address in [self.generator, self.scope] {
            drop(TcpStream::connect(address));
        }
    }
}

fn lock(state: &Mutex<State>) -> MutexGuard<'_, State> {
    // A connection that panicked leaves settings behind, not broken invariants.
    state.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

type Answers = fn(&mut State, &str) -> Option<Vec<u8>>;

fn serve(
    port: u16,
    state: &Arc<Mutex<State>>,
    stop: &Arc<AtomicBool>,
    answers: Answers,
) -> std::io::Result<SocketAddr> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))?;
    let address = listener.local_addr()?;
    let (state, stop) = (Arc::clone(state), Arc::clone(stop));
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            if stop.load(Ordering::Relaxed) {
                return;
            }
            let Ok(stream) = stream else { continue };
            let state = Arc::clone(&state);
            std::thread::spawn(move || converse(stream, &state, answers));
        }
    });
    Ok(address)
}

/// Answers one connection until it closes; a broken one ends by itself.
fn converse(stream: TcpStream, state: &Mutex<State>, answers: Answers) {
    let Ok(mut out) = stream.try_clone() else { return };
    // Answers are small and waited for: collecting them into larger packets would delay each.
    let _ = out.set_nodelay(true);
    for line in BufReader::new(stream).lines() {
        let Ok(line) = line else { return };
        // A page in a browser speaks first of all HTTP: it is none of the bench's.
        if line.trim_end().ends_with("HTTP/1.1") || line.trim_end().ends_with("HTTP/1.0") {
            return;
        }
        let answer = answers(&mut lock(state), line.trim());
        if let Some(mut bytes) = answer {
            bytes.push(b'\n');
            if out.write_all(&bytes).is_err() {
                return;
            }
        }
    }
}

impl State {
    fn refuse(&mut self, command: &str) -> Option<Vec<u8>> {
        self.errors.push(command.to_owned());
        None
    }

    /// Phasors before and behind the shunt for the first output's drive.
    fn voltages(&self) -> [Complex<f64>; 2] {
        let drive = self.outputs[0];
        if !drive.on {
            return [Complex::new(0.0, 0.0); 2];
        }
        let y = self.setup.circuit.admittance(drive.frequency_hz);
        let stator = Complex::new(drive.vpp / 2.0, 0.0) / (y * (SOURCE_OHM + self.setup.shunt_ohm) + 1.0);
        let before = stator * (y * self.setup.shunt_ohm + 1.0);
        [before, stator]
    }

    /// What the screen holds after a trigger on channel 1 rising through zero.
    fn acquire(&mut self) -> [Vec<u8>; 2] {
        let phasors = self.voltages();
        let frequency = self.outputs[0].frequency_hz;
        let (points, divisions) = match self.setup.family {
            Family::Ds1052e => (600, 12.0),
            Family::Ds1104z => (1200, 12.0),
        };
        let jitter = 0.02 * (self.rng.random::<f64>() - 0.5);
        let start = -divisions / 2.0 * self.second_a_division + self.delay_s;
        let step = divisions * self.second_a_division / points as f64;
        let noise_v = self.setup.noise_v;
        let (scale, offset, family) = (self.scale, self.offset, self.setup.family);
        let rng = &mut self.rng;
        std::array::from_fn(|c| {
            let lag = phasors[c].arg() - phasors[0].arg() + jitter;
            (0..points)
                .map(|i| {
                    let t = start + i as f64 * step;
                    let noise: f64 = StandardNormal.sample(rng);
                    let v = phasors[c].norm() * (TAU * frequency * t + lag).sin() + noise_v * noise;
                    let counts = match family {
                        Family::Ds1052e => 240.0 - (v + offset[c] + 4.6 * scale[c]) * 25.0 / scale[c],
                        Family::Ds1104z => 127.0 + (v + offset[c]) * 25.0 / scale[c],
                    };
                    // The screen ends four divisions above and below its middle.
                    let middle = if family == Family::Ds1052e { 125.0 } else { 127.0 };
                    counts.round().clamp(middle - 100.0, middle + 100.0) as u8
                })
                .collect()
        })
    }
}

fn text(answer: impl std::fmt::Display) -> Option<Vec<u8>> {
    Some(answer.to_string().into_bytes())
}

fn generator_answers(state: &mut State, command: &str) -> Option<Vec<u8>> {
    let upper = command.to_ascii_uppercase();
    let (head, argument) = upper.split_once(' ').unwrap_or((&upper, ""));
    let query = head.ends_with('?');
    let head = head.trim_end_matches('?');
    let (name, channel) = match head.strip_suffix(":CH2") {
        Some(name) => (name, 1),
        None => (head, 0),
    };
    let prefix = if channel == 1 { "CH2:" } else { "" };
    let output = state.outputs[channel];
    match (name, query) {
        ("*IDN", true) => text("RIGOL TECHNOLOGIES,DG1022,DG1D000000000,,00.02.00.06.00.02.07"),
        ("OUTP", true) => text(if output.on { "ON" } else { "OFF" }),
        ("OUTP", false) if argument == "ON" || argument == "OFF" => {
            state.outputs[channel].on = argument == "ON";
            None
        }
        ("FREQ", true) => text(format!("{prefix}{:e}", output.frequency_hz)),
        ("VOLT", true) => text(format!("{prefix}{:e}", output.vpp)),
        ("FREQ", false) => match argument.parse::<f64>() {
            Ok(f) if f > 0.0 && f <= 20e6 => {
                state.outputs[channel].frequency_hz = f;
                None
            }
            _ => state.refuse(command),
        },
        ("VOLT:UNIT", false) if argument == "VPP" => None,
        ("PHAS", false) | ("PHAS:ALIGN", false) => None,
        ("APPL:SIN", false) => {
            let values: Vec<Option<f64>> = argument.split(',').map(|a| a.trim().parse().ok()).collect();
            let (Some(Some(f)), Some(Some(vpp))) = (values.first(), values.get(1)) else {
                return state.refuse(command);
            };
            state.largest_vpp = state.largest_vpp.max(*vpp);
            let most = if channel == 1 { 6.0 } else { 20.0 };
            if *f > 0.0 && *vpp > 0.0 && *vpp <= most {
                state.outputs[channel].frequency_hz = *f;
                state.outputs[channel].vpp = *vpp;
                None
            } else {
                state.refuse(command)
            }
        }
        _ => state.refuse(command),
    }
}

fn scope_answers(state: &mut State, command: &str) -> Option<Vec<u8>> {
    let upper = command.to_ascii_uppercase();
    let (head, argument) = upper.split_once(' ').unwrap_or((&upper, ""));
    let family = state.setup.family;
    let zed = family == Family::Ds1104z;
    let number = argument.parse::<f64>().ok().filter(|v| v.is_finite());
    if let Some(rest) = head.strip_prefix(":CHAN") {
        return channel_answers(state, command, rest, number);
    }
    match (head, number) {
        ("*IDN?", _) if zed => text("RIGOL TECHNOLOGIES,DS1104Z,DS1ZD000000000,00.04.04"),
        ("*IDN?", _) => text("Rigol Technologies,DS1052E,DS1ET000000000,00.04.02.01.00"),
        ("*OPC?", _) if zed => text("1"),
        (":TIM:SCAL?", _) => text(format!("{:e}", state.second_a_division)),
        (":TIM:OFFS?", _) => text(format!("{:e}", state.delay_s)),
        (":TIM:SCAL", Some(v)) if v > 0.0 => {
            state.second_a_division = v;
            None
        }
        (":TIM:OFFS", Some(v)) => {
            state.delay_s = v;
            None
        }
        (":TRIG:MODE" | ":TRIG:EDGE:SOUR" | ":TRIG:EDGE:SLOP" | ":TRIG:EDGE:LEV", _) => None,
        (":SING", _) if zed => arm(state),
        (":TRIG:EDGE:SWE", _) if !zed && argument == "SING" => None,
        (":RUN", _) if !zed => arm(state),
        (":TRIG:STAT?", _) => {
            // A trigger takes a while, and never comes without a signal.
            if state.frozen.is_none() && state.outputs[0].on {
                if state.armed == 0 {
                    state.frozen = Some(state.acquire());
                } else {
                    state.armed -= 1;
                }
            }
            text(if state.frozen.is_some() { "STOP" } else { "WAIT" })
        }
        (":WAV:SOUR", _) if zed && (argument == "CHAN1" || argument == "CHAN2") => {
            state.source = usize::from(argument == "CHAN2");
            None
        }
        (":WAV:MODE" | ":WAV:FORM", _) if zed => None,
        (":WAV:PRE?", _) if zed => {
            let (s, c) = (state.second_a_division, state.source);
            let (dv, dt) = (state.scale[c] / 25.0, s / 100.0);
            let origin = (state.offset[c] / dv).round();
            text(format!("0,0,1200,1,{dt:e},{:e},0,{dv:e},{origin},127", -6.0 * s + state.delay_s))
        }
        (":WAV:DATA?", _) => record(state, argument).or_else(|| state.refuse(command)),
        _ => state.refuse(command),
    }
}

/// `rest` of a command to a channel: its number and what is asked of it.
fn channel_answers(state: &mut State, command: &str, rest: &str, number: Option<f64>) -> Option<Vec<u8>> {
    let channel = match rest.get(..1) {
        Some("1") => 0,
        Some("2") => 1,
        _ => return state.refuse(command),
    };
    match (&rest[1..], number) {
        (":SCAL?", _) => text(format!("{:e}", state.scale[channel])),
        (":OFFS?", _) => text(format!("{:e}", state.offset[channel])),
        (":SCAL", Some(v)) if (0.002..=10.0).contains(&v) => {
            state.scale[channel] = v;
            None
        }
        (":OFFS", Some(v)) => {
            state.offset[channel] = v;
            None
        }
        (":DISP" | ":COUP", _) => None,
        _ => state.refuse(command),
    }
}

/// A channel's record as a block, if there is one: the DS1104Z gives that of its source, the DS1052E the one that is named.
fn record(state: &State, argument: &str) -> Option<Vec<u8>> {
    let zed = state.setup.family == Family::Ds1104z;
    let channel = match argument {
        "" if zed => state.source,
        "CHAN1" if !zed => 0,
        "CHAN2" if !zed => 1,
        _ => return None,
    };
    let data = &state.frozen.as_ref()?[channel];
    let head = if zed { format!("#9{:09}", data.len()) } else { format!("#8{:08}", data.len()) };
    Some([head.as_bytes(), data].concat())
}

fn arm(state: &mut State) -> Option<Vec<u8>> {
    state.frozen = None;
    state.armed = 1;
    None
}
