//! The driver board's UART on the two wires.

use super::stage::{Chip, FLAGS};
use embedded_io_async::{ErrorType, Read, Write};
use esp_hal::Async;
use esp_hal::uart::{IoError, Uart};
use twum_firmware::driver::DriverPort;
use twum_firmware::stage::{to_hardware, to_text};

/// The UART and the wires it has while the driver board is in its text mode.
pub struct Port {
    uart: Uart<'static, Async>,
}

impl Port {
    pub const fn new(uart: Uart<'static, Async>) -> Self {
        Self { uart }
    }
}

impl DriverPort for Port {
    fn to_text(&mut self) {
        to_text(&Chip, &FLAGS);
        // What the pin did before it was a UART's is not a reply.
        let mut scrap = [0; 32];
        while let Ok(1..) = self.uart.read_buffered(&mut scrap) {}
    }

    fn to_hardware(&mut self) {
        to_hardware(&Chip, &FLAGS);
    }
}

impl ErrorType for Port {
    type Error = IoError;
}

impl Read for Port {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, IoError> {
        Ok(self.uart.read_async(buffer).await?)
    }
}

impl Write for Port {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, IoError> {
        Ok(self.uart.write_async(bytes).await?)
    }

    async fn flush(&mut self) -> Result<(), IoError> {
        Ok(self.uart.flush_async().await?)
    }
}
