use crate::shared::{Command, Event, Request, Shared};
use embassy_time::{Duration, Timer};
use embedded_io_async::Read;
use twum_shared::Fault;
use twum_shared::frame::{Decoder, FrameError};
use twum_shared::message::{HostMessage, Refusal};

/// Reads the host's frames for ever. A reading error means that bytes were lost: [`Fault::RxOverrun`].
pub async fn receive<R: Read>(shared: &Shared, mut port: R) {
    let mut decoder = Decoder::new();
    let mut buffer = [0u8; 64];
    loop {
        match port.read(&mut buffer).await {
            Ok(0) => Timer::after(Duration::from_millis(1)).await,
            Ok(length) => {
                for &byte in buffer.iter().take(length) {
                    match decoder.push::<HostMessage>(byte) {
                        Some(Ok((header, message))) => take(shared, header.sequence, message),
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
        command(shared, 0, Request::Identify);
    }
}

fn take(shared: &Shared, sequence: u32, message: HostMessage) {
    shared.host_spoke();
    let request = match message {
        HostMessage::Hello => Request::Identify,
        HostMessage::Keepalive => return,
        HostMessage::Configure(configuration) => Request::Configure(configuration),
        HostMessage::Align => Request::Align,
        HostMessage::Arm => Request::Arm,
        HostMessage::Speed(run) => Request::Speed(run),
        HostMessage::Track(run) => Request::Track(run),
        HostMessage::Capture(mode) => Request::Capture(mode),
        HostMessage::Driver(line) => Request::Driver(line),
        HostMessage::Stop => Request::Stop,
        HostMessage::Reboot => Request::Reboot,
    };
    command(shared, sequence, request);
}

fn command(shared: &Shared, sequence: u32, request: Request) {
    if shared.commands.push(Command::Host(sequence, request)).is_err() {
        shared.tell(Event::Nack(sequence, Refusal::Busy));
    }
}
