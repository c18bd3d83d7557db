//! The driver board's text mode: alignment, and lines passed on from the host.

use crate::shared::{Command, DriverRequest, Errand, Event, Shared};
use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Instant, Timer, with_timeout};
use embedded_hal::digital::InputPin;
use embedded_io_async::{Read, Write};
use heapless::{String, Vec};
use twum_shared::alignment::{Action, Alignment, Event as AlignEvent, Failure};
use twum_shared::driver::{self, Command as Text, LINE_MICROSTEPS, Line, write};

/// The two wires to the driver board, which are a UART in its text mode, and PWM and direction in hardware mode.
pub trait DriverPort: Read + Write {
    /// Makes the wires a UART (19200 8N1) and forgets what was received before.
    fn to_text(&mut self);
    /// Makes the wires PWM (held off) and direction. Undone only by [`DriverPort::to_text`] after the driver's power was
    /// cycled.
    fn to_hardware(&mut self);
}

/// The rotor stands when no edge came for this long.
const STANDSTILL_MS: u64 = 300;
/// A passed-on line is given up after this long.
const PASSTHROUGH_MS: u64 = 60_000;
/// A line's worth of microsteps, or a reading of the sensor, is answered within this time.
const REPLY_MS: u32 = 2_000;
/// A pause that ends a reply which has no line end.
const QUIET_MS: u32 = 50;
/// Whether an errand is over is looked at this often.
const LOOK_MS: u64 = 5;

/// Serves alignment and pass-through for ever. Nothing in the board's text mode ends a motion that has begun, so the
/// board is never given more than [`LINE_MICROSTEPS`] at once, and more only while the errand lasts: a stop, a silent host, a
/// fault or a restart of the chip all end the motion within that.
pub async fn serve<P: DriverPort, E: InputPin>(shared: &Shared, mut port: P, mut encoder: E) {
    loop {
        let Errand { number, request } = shared.driver.wait().await;
        port.to_text();
        match request {
            DriverRequest::Align => match select(over(shared, number), align(shared, &mut port, &mut encoder)).await {
                Either::First(()) => come_to_rest(shared, &mut port).await,
                Either::Second(result) => {
                    if result.is_ok() {
                        port.to_hardware();
                    }
                    shared.driver_rests();
                    shared.command(Command::AlignEnded(number, result)).await;
                }
            },
            DriverRequest::Passthrough(line) => {
                let passing = with_timeout(Duration::from_millis(PASSTHROUGH_MS), pass(shared, &mut port, &line));
                match select(over(shared, number), passing).await {
                    Either::First(()) => {}
                    Either::Second(Ok(Ok(()))) => {}
                    Either::Second(Ok(Err(Silent))) => {
                        shared.log("the driver line was ended: the board does not answer")
                    }
                    Either::Second(Err(_)) => shared.log("the driver line was ended after a minute"),
                }
                come_to_rest(shared, &mut port).await;
                shared.command(Command::PassthroughEnded(number)).await;
            }
        }
    }
}

/// Waits until this errand is over because of a stop or a fault.
async fn over(shared: &Shared, number: u32) {
    while shared.errand() == number {
        Timer::after(Duration::from_millis(LOOK_MS)).await;
    }
}

/// A line that was sent then is answered now: the next may last as long, and be begun just before its errand is seen to be over.
fn answered(shared: &Shared, sent: Instant) {
    let lasted = sent.elapsed() + Duration::from_millis(LOOK_MS);
    shared.line_lasted(u32::try_from(lasted.as_micros()).unwrap_or(u32::MAX));
}

/// Ends what was being written, and waits until the edges have ceased.
async fn come_to_rest<P: DriverPort>(shared: &Shared, port: &mut P) {
    // A line that was cut off must not become the beginning of the next; what is left of it moves no farther than the whole.
    let _ = port.write_all(b"\r\n").await;
    let mut edges = shared.encoder.edges();
    loop {
        Timer::after(Duration::from_millis(STANDSTILL_MS)).await;
        let now = shared.encoder.edges();
        if now == edges {
            break;
        }
        edges = now;
    }
    drain(port).await;
    shared.driver_rests();
}

async fn align<P: DriverPort, E: InputPin>(shared: &Shared, port: &mut P, encoder: &mut E) -> Result<(), Failure> {
    let (mut alignment, mut action) = Alignment::start();
    loop {
        action = match action {
            Action::Ask { line, first_ms, quiet_ms, total_ms } => {
                drain(port).await;
                send(port, &line).await;
                let reply = collect(shared, port, first_ms, quiet_ms, total_ms).await;
                alignment.next(if reply.is_empty() { AlignEvent::Silence } else { AlignEvent::Reply(&reply) })
            }
            Action::Do { line, wait_ms } => {
                send(port, &line).await;
                Timer::after(Duration::from_millis(u64::from(wait_ms))).await;
                drain(port).await;
                // A pin that cannot be read counts as low: the confirmation by stepping back then fails.
                alignment.next(AlignEvent::Waited(encoder.is_high().unwrap_or(false)))
            }
            Action::Aligned => return Ok(()),
            Action::Failed(failure) => {
                let text = match failure {
                    Failure::DriverSilent => "alignment: no reply from the driver board",
                    Failure::NoEdge => "alignment: no edge could be confirmed",
                };
                shared.tell(Event::Log(String::try_from(text).unwrap_or_default()));
                return Err(failure);
            }
        };
    }
}

async fn send<P: Write>(port: &mut P, line: &Line) {
    let Ok(text) = write(line) else { return };
    // A write that fails shows as the reply that does not come.
    let _ = port.write_all(text.as_bytes()).await;
    let _ = port.write_all(b"\r\n").await;
}

async fn drain<P: Read>(port: &mut P) {
    let mut buffer = [0u8; 32];
    while let Ok(Ok(1..)) = with_timeout(Duration::from_millis(2), port.read(&mut buffer)).await {}
}

/// The last bytes of a reply, up to a pause.
async fn collect<P: Read>(shared: &Shared, port: &mut P, first_ms: u32, quiet_ms: u32, total_ms: u32) -> Vec<u8, 64> {
    let sent = Instant::now();
    let deadline = sent + Duration::from_millis(u64::from(total_ms));
    let mut reply: Vec<u8, 64> = Vec::new();
    let mut wait_ms = first_ms;
    let mut buffer = [0u8; 32];
    while Instant::now() < deadline {
        let Ok(Ok(length)) = with_timeout(Duration::from_millis(u64::from(wait_ms)), port.read(&mut buffer)).await
        else {
            break;
        };
        answered(shared, sent);
        for &byte in buffer.iter().take(length) {
            if reply.is_full() {
                reply.remove(0);
            }
            let _ = reply.push(byte);
        }
        wait_ms = quiet_ms;
    }
    reply
}

/// The driver board does not answer.
struct Silent;

/// Does what a line says, command by command, as the board would: the board itself gets the motion in pieces, each followed by
/// a reading of the sensor, whose reply says that the piece is done.
async fn pass<P: DriverPort>(shared: &Shared, port: &mut P, line: &str) -> Result<(), Silent> {
    drain(port).await;
    // The supervisor has parsed it before.
    let line = driver::parse(line).unwrap_or_default();
    let repeats = line.iter().find_map(|command| if let Text::Repeat(times) = command { Some(*times) } else { None });
    for _ in 0..repeats.unwrap_or(1) {
        for &command in &line {
            match command {
                Text::Microsteps { count, back } => step(shared, port, count, back).await?,
                Text::SensorReport => {
                    let reply = ask(shared, port, &[Text::SensorReport], 1).await?;
                    shared.tell(Event::DriverReply(reply.tail));
                }
                Text::StopWhen { .. } => {
                    // As in the thesis's own line: the second reading comes unless the condition ends the repetition.
                    let twice = [Text::SensorReport, command, Text::Repeat(2)];
                    if ask(shared, port, &twice, 2).await?.lines < 2 {
                        return Ok(());
                    }
                }
                Text::HardwareMode => {
                    send(port, &Line::from_slice(&[command]).unwrap_or_default()).await;
                    return Ok(());
                }
                Text::Repeat(_) => {}
            }
        }
    }
    Ok(())
}

/// So many microsteps, a line's worth at a time.
async fn step<P: DriverPort>(shared: &Shared, port: &mut P, count: u16, back: bool) -> Result<(), Silent> {
    let mut left = count;
    while left > 0 {
        let count = left.min(LINE_MICROSTEPS);
        ask(shared, port, &[Text::Microsteps { count, back }, Text::SensorReport], 1).await?;
        left -= count;
    }
    Ok(())
}

/// A reply: its last bytes, and how many lines it had.
struct Reply {
    tail: Vec<u8, 64>,
    lines: usize,
}

/// Sends a line and takes its reply, up to so many line ends or a pause.
async fn ask<P: DriverPort>(
    shared: &Shared,
    port: &mut P,
    commands: &[Text],
    most_lines: usize,
) -> Result<Reply, Silent> {
    let sent = Instant::now();
    send(port, &Line::from_slice(commands).unwrap_or_default()).await;
    let mut reply = Reply { tail: Vec::new(), lines: 0 };
    let mut wait_ms = REPLY_MS;
    let mut byte = [0u8; 1];
    while reply.lines < most_lines {
        match with_timeout(Duration::from_millis(u64::from(wait_ms)), port.read(&mut byte)).await {
            Ok(Ok(1)) => {
                answered(shared, sent);
                if reply.tail.is_full() {
                    reply.tail.remove(0);
                }
                let _ = reply.tail.push(byte[0]);
                reply.lines += usize::from(byte[0] == b'\n');
            }
            Ok(_) => {}
            Err(_) if reply.tail.is_empty() => return Err(Silent),
            Err(_) => break,
        }
        wait_ms = QUIET_MS;
    }
    Ok(reply)
}
