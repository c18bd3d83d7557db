//! The driver board's text mode: alignment, and lines passed on from the host.

use crate::shared::{Command, DriverRequest, Errand, Event, Shared};
use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Instant, Timer, with_timeout};
use embedded_hal::digital::InputPin;
use embedded_io_async::{Read, Write};
use heapless::{String, Vec};
use twum_shared::alignment::{Action, Alignment, Event as AlignEvent, Failure};
use twum_shared::driver::{Line, write};

/// The two wires to the driver board, which are a UART in its text mode, and PWM and direction in hardware mode.
pub trait DriverPort: Read + Write {
    /// Makes the wires a UART (19200 8N1) and forgets what was received before.
    fn to_text(&mut self);
    /// Makes the wires PWM (held off) and direction. Undone only by [`DriverPort::to_text`] after the driver's power was
    /// cycled.
    fn to_hardware(&mut self);
}

/// After a passed-on line, motion is over when no edge came for this long.
const STANDSTILL_MS: u64 = 300;
/// A passed-on line is given up after this long.
const PASSTHROUGH_MS: u64 = 60_000;

/// Serves alignment and pass-through for ever.
pub async fn serve<P: DriverPort, E: InputPin>(shared: &Shared, mut port: P, mut encoder: E) {
    loop {
        let Errand { number, request } = shared.driver.wait().await;
        port.to_text();
        match request {
            DriverRequest::Align => {
                let ended = select(over(shared, number), align(shared, &mut port, &mut encoder)).await;
                if let Either::Second(result) = ended {
                    if result.is_ok() {
                        port.to_hardware();
                    }
                    shared.command(Command::AlignEnded(number, result)).await;
                }
            }
            DriverRequest::Passthrough(line) => {
                let passing = with_timeout(Duration::from_millis(PASSTHROUGH_MS), pass(shared, &mut port, &line));
                // Stopping, or running out of time, ends the capture; what the driver does meanwhile is its own.
                let _ = select(over(shared, number), passing).await;
                shared.command(Command::PassthroughEnded(number)).await;
            }
        }
    }
}

/// Waits until this errand is over because of a stop or a fault.
async fn over(shared: &Shared, number: u32) {
    while shared.errand() == number {
        Timer::after(Duration::from_millis(5)).await;
    }
}

async fn align<P: DriverPort, E: InputPin>(shared: &Shared, port: &mut P, encoder: &mut E) -> Result<(), Failure> {
    let (mut alignment, mut action) = Alignment::start();
    loop {
        action = match action {
            Action::Ask { line, first_ms, quiet_ms, total_ms } => {
                drain(port).await;
                send(port, &line).await;
                let reply = collect(port, first_ms, quiet_ms, total_ms).await;
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
async fn collect<P: Read>(port: &mut P, first_ms: u32, quiet_ms: u32, total_ms: u32) -> Vec<u8, 64> {
    let deadline = Instant::now() + Duration::from_millis(u64::from(total_ms));
    let mut reply: Vec<u8, 64> = Vec::new();
    let mut wait_ms = first_ms;
    let mut buffer = [0u8; 32];
    while Instant::now() < deadline {
        let Ok(Ok(length)) = with_timeout(Duration::from_millis(u64::from(wait_ms)), port.read(&mut buffer)).await
        else {
            break;
        };
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

async fn pass<P: DriverPort>(shared: &Shared, port: &mut P, line: &str) {
    drain(port).await;
    let _ = port.write_all(line.as_bytes()).await;
    let _ = port.write_all(b"\r\n").await;
    let mut buffer = [0u8; 64];
    let mut edges = shared.encoder.edges();
    loop {
        match with_timeout(Duration::from_millis(STANDSTILL_MS), port.read(&mut buffer)).await {
            Ok(Ok(length)) => {
                let piece = Vec::from_slice(buffer.get(..length).unwrap_or_default()).unwrap_or_default();
                shared.tell(Event::DriverReply(piece));
            }
            Ok(Err(_)) => {}
            Err(_) => {
                let now = shared.encoder.edges();
                if now == edges {
                    return;
                }
                edges = now;
            }
        }
    }
}
