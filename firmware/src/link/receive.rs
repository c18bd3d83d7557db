use crate::shared::{Command, Event, Shared, Stop};
use embassy_time::{Duration, Instant, Timer};
use embedded_io_async::Read;
use twum_shared::Fault;
use twum_shared::frame::{Decoder, FrameError};
use twum_shared::message::{HostMessage, Refusal};

/// Reads the host's frames for ever. A reading error means that bytes were lost: [`Fault::RxOverrun`].
pub async fn receive<R: Read>(shared: &Shared, mut port: R) {
    let mut decoder = Decoder::new();
    let mut buffer = [0u8; 64];
    let mut heard = Heard::default();
    loop {
        match port.read(&mut buffer).await {
            Ok(0) => Timer::after(Duration::from_millis(1)).await,
            Ok(length) => {
                for &byte in buffer.iter().take(length) {
                    match decoder.push::<HostMessage>(byte) {
                        Some(Ok((header, message))) => take(shared, &mut heard, header.sequence, message),
                        Some(Err(error)) => refuse(shared, error),
                        None => {}
                    }
                }
            }
            Err(_) => {
                shared.bad_frame();
                shared.request_fault(Fault::RxOverrun);
            }
        }
    }
}

fn refuse(shared: &Shared, error: FrameError) {
    shared.bad_frame();
    if let FrameError::Version(_) = error {
        // The host learns our version from the answer's header.
        command(shared, 0, HostMessage::Hello);
    }
}

/// The keepalive that was heard last: its session and its sequence.
#[derive(Default)]
struct Heard(Option<(u32, u32)>);

impl Heard {
    /// Whether this keepalive is of the session that holds the motor, and newer than the one before: one that comes twice,
    /// or is replayed, is no sign of life.
    fn is_alive(&mut self, holder: u32, token: u32, sequence: u32) -> bool {
        let old = |&(of, before): &(u32, u32)| of == token && sequence.wrapping_sub(before).wrapping_sub(1) >= 1 << 31;
        if token == 0 || token != holder || self.0.as_ref().is_some_and(old) {
            return false;
        }
        self.0 = Some((token, sequence));
        true
    }
}

fn take(shared: &Shared, heard: &mut Heard, sequence: u32, message: HostMessage) {
    match message {
        HostMessage::Keepalive { token } => {
            if heard.is_alive(shared.holder(), token, sequence) {
                shared.host_spoke();
            }
        }
        HostMessage::Stop { clear_fault } => shared.ask_stop(Stop { of: sequence, clear_fault }),
        other => command(shared, sequence, other),
    }
}

fn command(shared: &Shared, of: u32, message: HostMessage) {
    let heard_us = Instant::now().as_micros();
    if shared.commands.push(Command::Host { of, heard_us, message }).is_err() {
        shared.tell(Event::Nack(of, Refusal::Busy));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_new_keepalives_of_the_session_that_holds_the_motor_count() {
        let mut heard = Heard::default();
        assert!(!heard.is_alive(0, 0, 1), "nobody holds it");
        assert!(!heard.is_alive(7, 8, 1), "another session");
        assert!(heard.is_alive(7, 7, u32::MAX - 1));
        assert!(!heard.is_alive(7, 7, u32::MAX - 1), "the same again");
        assert!(heard.is_alive(7, 7, 3), "the sequence wraps");
        assert!(!heard.is_alive(7, 7, 2), "an older one");
        assert!(heard.is_alive(8, 8, 2), "another session has its own sequence");
    }
}
