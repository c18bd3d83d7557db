//! The simulated board's flash: the firmware keeps the configuration in it, from one boot to the next.

use embedded_storage_async::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use std::cell::RefCell;
use std::convert::Infallible;
use std::ops::Range;
use std::rc::Rc;

const PAGE: usize = 4096;
/// As much as the firmware asks for: two pages and a spare.
const LENGTH: usize = 3 * PAGE;

/// NOR flash: erasing sets bits, writing clears them. Its contents outlive the boots.
#[derive(Clone, Debug)]
pub(super) struct Flash(Rc<RefCell<Vec<u8>>>);

impl Flash {
    pub const RANGE: Range<u32> = 0..LENGTH as u32;

    /// Flash as it comes from its maker.
    pub fn erased() -> Self {
        Self(Rc::new(RefCell::new(vec![0xff; LENGTH])))
    }
}

impl ErrorType for Flash {
    type Error = Infallible;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 4;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
        let offset = offset as usize;
        bytes.copy_from_slice(&self.0.borrow()[offset..offset + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        LENGTH
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = PAGE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Infallible> {
        self.0.borrow_mut()[from as usize..to as usize].fill(0xff);
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
        let mut cells = self.0.borrow_mut();
        for (cell, byte) in cells[offset as usize..].iter_mut().zip(bytes) {
            *cell &= byte;
        }
        Ok(())
    }
}
