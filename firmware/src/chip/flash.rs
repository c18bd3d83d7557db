//! Where the configuration is kept: the `nvs` partition, which every usual partition table has.

use core::ops::Range;
use embassy_embedded_hal::adapter::BlockingAsync;
use esp_bootloader_esp_idf::partitions::{
    DataPartitionSubType, PARTITION_TABLE_MAX_LEN, PartitionType, read_partition_table,
};
use esp_hal::peripherals::FLASH;
use esp_storage::FlashStorage;
use static_cell::ConstStaticCell;

/// The chip's flash. Writing stalls the core; the other core, where there is one, is parked meanwhile.
pub type Flash = BlockingAsync<FlashStorage<'static>>;

static TABLE: ConstStaticCell<[u8; PARTITION_TABLE_MAX_LEN]> = ConstStaticCell::new([0; PARTITION_TABLE_MAX_LEN]);

/// The flash and the range of the configuration in it; `None` where the partition table has no place for it.
pub fn open(flash: FLASH<'static>) -> Option<(Flash, Range<u32>)> {
    let mut flash = super::board::share_flash(FlashStorage::new(flash));
    let table = read_partition_table(&mut flash, TABLE.take()).ok()?;
    let nvs = table.find_partition(PartitionType::Data(DataPartitionSubType::Nvs)).ok()??;
    Some((BlockingAsync::new(flash), nvs.offset()..nvs.offset() + nvs.len()))
}
