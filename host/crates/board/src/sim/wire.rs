//! A simulated UART line: bytes arrive at the pace of their baud rate, and a sender waits while its FIFO is full.

use embassy_time::{Duration, Instant, Timer};
use embedded_io_async::{ErrorType, Read, Write};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::rc::Rc;

/// Bytes a sender may be ahead of the line.
const FIFO_BYTES: u64 = 128;
/// Bytes a line keeps for a reader that does not read; the oldest go first, as in an overrun.
const CAPACITY: usize = 1 << 16;

#[derive(Debug)]
struct Line {
    ten_bits_ns: u64,
    free_ns: u64,
    bytes: VecDeque<(u64, u8)>,
}

/// One direction of a UART, shared by its two ends.
#[derive(Clone, Debug)]
pub(super) struct Wire {
    line: Rc<RefCell<Line>>,
}

impl Wire {
    pub fn new(baud: u32) -> Self {
        let line = Line { ten_bits_ns: 10_000_000_000 / u64::from(baud), free_ns: 0, bytes: VecDeque::new() };
        Self { line: Rc::new(RefCell::new(line)) }
    }

    /// Puts a byte on the line at `now_us`; it arrives after those before it.
    pub fn send(&self, now_us: u64, byte: u8) {
        let mut line = self.line.borrow_mut();
        line.free_ns = line.free_ns.max(now_us * 1_000) + line.ten_bits_ns;
        let arrival_us = line.free_ns.div_ceil(1_000);
        if line.bytes.len() == CAPACITY {
            line.bytes.pop_front();
        }
        line.bytes.push_back((arrival_us, byte));
    }

    /// Takes a byte that has arrived by `now_us`.
    pub fn receive(&self, now_us: u64) -> Option<u8> {
        let mut line = self.line.borrow_mut();
        match line.bytes.front() {
            Some(&(arrival_us, byte)) if arrival_us <= now_us => {
                line.bytes.pop_front();
                Some(byte)
            }
            _ => None,
        }
    }

    /// When the next byte arrives, if one is on the line.
    pub fn next_arrival_us(&self) -> Option<u64> {
        self.line.borrow().bytes.front().map(|&(arrival_us, _)| arrival_us)
    }

    /// Forgets what is on the line.
    pub fn clear(&self) {
        self.line.borrow_mut().bytes.clear();
    }

    fn backlog_us(&self, now_us: u64) -> u64 {
        let line = self.line.borrow();
        let allowed_ns = now_us * 1_000 + FIFO_BYTES * line.ten_bits_ns;
        line.free_ns.saturating_sub(allowed_ns).div_ceil(1_000)
    }
}

/// The firmware's end of a UART.
#[derive(Clone, Debug)]
pub(super) struct Uart {
    pub rx: Wire,
    pub tx: Wire,
}

impl ErrorType for Uart {
    type Error = Infallible;
}

/// How often an idle reader looks at its line. A chip is woken by an interrupt; a finer poll only costs time.
const POLL_US: u64 = 500;

impl Read for Uart {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        loop {
            let now_us = super::clock::now_us();
            let mut length = 0;
            while length < buffer.len() {
                let Some(byte) = self.rx.receive(now_us) else { break };
                buffer[length] = byte;
                length += 1;
            }
            if length > 0 {
                return Ok(length);
            }
            let next_us = self.rx.next_arrival_us().unwrap_or(now_us + POLL_US);
            Timer::at(Instant::from_micros(next_us.min(now_us + POLL_US))).await;
        }
    }
}

impl Write for Uart {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let wait_us = self.tx.backlog_us(super::clock::now_us());
        if wait_us > 0 {
            Timer::after(Duration::from_micros(wait_us)).await;
        }
        let length = bytes.len().min(FIFO_BYTES as usize / 2);
        for &byte in &bytes[..length] {
            self.tx.send(super::clock::now_us(), byte);
        }
        Ok(length)
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_arrive_at_the_baud_rate() {
        let wire = Wire::new(19_200);
        wire.send(0, b'a');
        wire.send(0, b'b');
        assert_eq!((wire.receive(520), wire.receive(521)), (None, Some(b'a')));
        assert_eq!(wire.next_arrival_us(), Some(1_042));
    }
}
