//! Where the configuration is kept: the `nvs` partition, which every usual partition table has.

use core::ops::Range;
use embassy_embedded_hal::adapter::BlockingAsync;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use esp_bootloader_esp_idf::partitions::{
    DataPartitionSubType, PARTITION_TABLE_MAX_LEN, PartitionType, read_partition_table,
};
use esp_hal::peripherals::FLASH;
use esp_storage::FlashStorage;
use static_cell::ConstStaticCell;
use twum_firmware::standstill::{Moving, Standstill};

/// What the control core agrees to before flash is written.
pub static STANDSTILL: Standstill = Standstill::new();

static TABLE: ConstStaticCell<[u8; PARTITION_TABLE_MAX_LEN]> = ConstStaticCell::new([0; PARTITION_TABLE_MAX_LEN]);

/// The flash and the range of the configuration in it; `None` where the partition table has no place for it.
pub fn open(flash: FLASH<'static>) -> Option<(Flash, Range<u32>)> {
    let mut flash = super::board::share_flash(FlashStorage::new(flash));
    let table = read_partition_table(&mut flash, TABLE.take()).ok()?;
    let nvs = table.find_partition(PartitionType::Data(DataPartitionSubType::Nvs)).ok()??;
    Some((Flash(BlockingAsync::new(flash)), nvs.offset()..nvs.offset() + nvs.len()))
}

/// The chip's flash. Writing stalls the core; the other core, where there is one, stands still and is stalled meanwhile.
pub struct Flash(BlockingAsync<FlashStorage<'static>>);

type Inner = <BlockingAsync<FlashStorage<'static>> as ErrorType>::Error;

/// Why flash was not read or written.
#[derive(Debug)]
pub enum FlashError {
    Flash(Inner),
    Moving(Moving),
}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Flash(error) => error.kind(),
            Self::Moving(_) => NorFlashErrorKind::Other,
        }
    }
}

impl ErrorType for Flash {
    type Error = FlashError;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = <BlockingAsync<FlashStorage<'static>> as ReadNorFlash>::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        self.0.read(offset, bytes).await.map_err(FlashError::Flash)
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = <BlockingAsync<FlashStorage<'static>> as NorFlash>::WRITE_SIZE;
    const ERASE_SIZE: usize = <BlockingAsync<FlashStorage<'static>> as NorFlash>::ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        super::board::stand_still(&STANDSTILL).await.map_err(FlashError::Moving)?;
        let erased = self.0.erase(from, to).await;
        STANDSTILL.end();
        erased.map_err(FlashError::Flash)
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        super::board::stand_still(&STANDSTILL).await.map_err(FlashError::Moving)?;
        let written = self.0.write(offset, bytes).await;
        STANDSTILL.end();
        written.map_err(FlashError::Flash)
    }
}
