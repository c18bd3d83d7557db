//! A port that shows what the board says, whatever the session that uses it is waiting for.

use super::board::Board;
use crate::link::{LinkError, Port, Received};
use std::sync::Arc;
use std::time::Duration;
use twum_shared::frame::Decoder;
use twum_shared::message::DeviceMessage;

/// Passes bytes on, and tells the [`Board`] of every intact frame among them.
pub struct Tap<P> {
    port: P,
    board: Arc<Board>,
    decoder: Decoder,
}

impl<P: Port> Tap<P> {
    /// A tap of an open port.
    pub fn new(port: P, board: Arc<Board>) -> Self {
        Self { port, board, decoder: Decoder::new() }
    }
}

impl<P: Port> Port for Tap<P> {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.port.send(bytes)
    }

    fn receive(&mut self, into: &mut Vec<u8>, wait: Duration) -> Result<(), LinkError> {
        let before = into.len();
        self.port.receive(into, wait)?;
        for &byte in &into[before..] {
            if let Some(Ok((header, message))) = self.decoder.push::<DeviceMessage>(byte) {
                self.board.observe(&Received { header, message });
            }
        }
        Ok(())
    }

    fn elapsed(&self) -> Duration {
        self.port.elapsed()
    }

    fn is_virtual(&self) -> bool {
        self.port.is_virtual()
    }
}
