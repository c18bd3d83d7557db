//! The configuration kept across power cycles, in the board's flash.
//!
//! A record is a version, the configuration in postcard and a CRC-32 over both. What does not decode, does not match its
//! checksum, or comes from another version counts as nothing: the board then starts unconfigured, and cannot arm until
//! the host configures it. Writing stalls a chip for as long as erasing a page takes, so it happens only while the motor
//! cannot be armed: [`crate::Shared`] refuses to arm from the moment a configuration is to be kept until it is kept.

use crate::shared::Shared;
use core::ops::Range;
use crc::{CRC_32_ISO_HDLC, Crc, Table};
use embedded_storage_async::nor_flash::NorFlash;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage};
use twum_shared::message::Configuration;

/// Changes with every change of [`Configuration`], or of what its numbers mean.
const VERSION: u8 = 5;
/// Longest record, and room to align it.
const BUFFER: usize = 256;
static CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// There is one record, so it needs no key.
type Map<F> = MapStorage<(), F, Cache<Uncached, Uncached, Uncached>>;

/// Aligned as flash drivers like it.
#[repr(align(4))]
struct Buffer([u8; BUFFER]);

/// A range of flash pages that holds the configuration.
pub struct Store<F: NorFlash> {
    map: Map<F>,
}

/// The configuration could not be kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the configuration could not be written to flash")]
pub struct NotKept;

impl<F: NorFlash> Store<F> {
    /// A store in `range` of `flash`: two erase pages or more, and nothing else in them. `None` where the range does not
    /// fit the flash's pages.
    pub fn new(flash: F, range: Range<u32>) -> Option<Self> {
        let config = MapConfig::try_new(range).ok()?;
        Some(Self { map: MapStorage::new(flash, config, Cache::new_uncached()) })
    }

    /// What was kept last, if it is whole and of this version.
    pub async fn load(&mut self) -> Option<Configuration> {
        let mut buffer = Buffer([0; BUFFER]);
        let record: &[u8] = self.map.fetch_item(&mut buffer.0, &()).await.ok()??;
        decode(record)
    }

    /// Keeps a configuration.
    ///
    /// # Errors
    /// [`NotKept`] when the flash cannot be written, even after erasing what it held.
    pub async fn save(&mut self, configuration: &Configuration) -> Result<(), NotKept> {
        let mut record = [0; BUFFER];
        let record = encode(configuration, &mut record).ok_or(NotKept)?;
        let mut buffer = Buffer([0; BUFFER]);
        if self.map.store_item(&mut buffer.0, &(), &record).await.is_ok() {
            return Ok(());
        }
        // Another program's data, or a page broken beyond repair: the range is ours, and only this record is in it.
        self.map.erase_all().await.map_err(|_| NotKept)?;
        self.map.store_item(&mut buffer.0, &(), &record).await.map_err(|_| NotKept)
    }
}

/// Keeps each configuration the host sets, for ever.
pub async fn keep<F: NorFlash>(shared: &Shared, mut store: Store<F>) {
    shared.will_keep();
    loop {
        let configuration = shared.to_keep().await;
        // Writing the same again would only wear the flash.
        if store.load().await != Some(configuration) && store.save(&configuration).await.is_err() {
            shared.log("the configuration could not be kept; it is lost at the next power cycle");
        }
        shared.kept();
    }
}

fn encode<'a>(configuration: &Configuration, out: &'a mut [u8]) -> Option<&'a [u8]> {
    let (version, rest) = out.split_first_mut()?;
    *version = VERSION;
    let length = 1 + postcard::to_slice(configuration, rest).ok()?.len();
    let (checked, rest) = out.split_at_mut_checked(length)?;
    rest.first_chunk_mut::<4>()?.copy_from_slice(&CRC.checksum(checked).to_le_bytes());
    out.get(..length + 4)
}

fn decode(record: &[u8]) -> Option<Configuration> {
    let (checked, crc) = record.split_last_chunk::<4>()?;
    if CRC.checksum(checked) != u32::from_le_bytes(*crc) {
        return None;
    }
    match checked.split_first()? {
        (&VERSION, message) => match postcard::take_from_bytes(message) {
            Ok((configuration, [])) => Some(configuration),
            _ => None,
        },
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::control::Control;
    use crate::output::{Latch, Output, OutputStage};
    use crate::queues::Queues;
    use crate::shared::{Command, Event};
    use embassy_futures::block_on;
    use embedded_storage_async::nor_flash::{ErrorType, NorFlashError, NorFlashErrorKind, ReadNorFlash};
    use std::vec::Vec;
    use twum_shared::message::{HostMessage, Refusal, ResetCause};
    use twum_shared::step::ConfigSpec;
    use twum_shared::{Direction, Duty};

    const PAGE: usize = 4096;
    const RANGE: Range<u32> = 0..3 * PAGE as u32;

    /// NOR flash in memory: erasing sets bits, writing clears them. Can lose its power after some writes.
    #[derive(Clone)]
    struct Flash {
        bytes: Vec<u8>,
        writes_left: usize,
    }

    #[derive(Debug)]
    struct PowerLost;

    impl NorFlashError for PowerLost {
        fn kind(&self) -> NorFlashErrorKind {
            NorFlashErrorKind::Other
        }
    }

    impl Flash {
        fn new() -> Self {
            Self { bytes: std::vec![0xff; 3 * PAGE], writes_left: usize::MAX }
        }

        fn spend(&mut self) -> Result<(), PowerLost> {
            self.writes_left = self.writes_left.checked_sub(1).ok_or(PowerLost)?;
            Ok(())
        }
    }

    impl ErrorType for Flash {
        type Error = PowerLost;
    }

    impl ReadNorFlash for Flash {
        const READ_SIZE: usize = 4;

        async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), PowerLost> {
            let offset = offset as usize;
            bytes.copy_from_slice(&self.bytes[offset..offset + bytes.len()]);
            Ok(())
        }

        fn capacity(&self) -> usize {
            self.bytes.len()
        }
    }

    impl NorFlash for Flash {
        const WRITE_SIZE: usize = 4;
        const ERASE_SIZE: usize = PAGE;

        async fn erase(&mut self, from: u32, to: u32) -> Result<(), PowerLost> {
            self.spend()?;
            self.bytes[from as usize..to as usize].fill(0xff);
            Ok(())
        }

        async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), PowerLost> {
            for (offset, word) in (offset as usize..).step_by(4).zip(bytes.chunks(4)) {
                self.spend()?;
                for (cell, byte) in self.bytes[offset..].iter_mut().zip(word) {
                    *cell &= byte;
                }
            }
            Ok(())
        }
    }

    fn configuration(pwm_hz: u16) -> Configuration {
        Configuration { pwm_hz, ..Configuration::with_control(ConfigSpec::DEFAULT) }
    }

    fn store(flash: Flash) -> Store<Flash> {
        Store::new(flash, RANGE).unwrap()
    }

    fn flash_of(store: Store<Flash>) -> Flash {
        store.map.destroy().0
    }

    #[test]
    fn what_was_kept_last_comes_back() {
        let mut kept = store(Flash::new());
        assert_eq!(block_on(kept.load()), None);
        for pwm_hz in 50..250 {
            block_on(kept.save(&configuration(pwm_hz))).unwrap();
        }
        let mut again = store(flash_of(kept));
        assert_eq!(block_on(again.load()), Some(configuration(249)));
    }

    #[test]
    fn power_lost_at_any_write_leaves_the_old_or_the_new() {
        let mut kept = store(Flash::new());
        block_on(kept.save(&configuration(50))).unwrap();
        let before = flash_of(kept);
        for writes_left in 0..100 {
            let mut interrupted = store(Flash { writes_left, ..before.clone() });
            let done = block_on(interrupted.save(&configuration(60))).is_ok();
            let mut flash = flash_of(interrupted);
            flash.writes_left = usize::MAX;
            let found = block_on(store(flash).load());
            let allowed = [Some(configuration(50)), Some(configuration(60))];
            assert!(if done { found == allowed[1] } else { allowed.contains(&found) }, "{writes_left}: {found:?}");
        }
    }

    #[test]
    fn another_programs_flash_is_nothing_and_can_be_taken_over() {
        let mut flash = Flash::new();
        for (index, byte) in flash.bytes.iter_mut().enumerate() {
            *byte = (index * 31 + index / 7) as u8;
        }
        let mut kept = store(flash);
        assert_eq!(block_on(kept.load()), None);
        block_on(kept.save(&configuration(70))).unwrap();
        assert_eq!(block_on(kept.load()), Some(configuration(70)));
    }

    struct NoStage;

    impl OutputStage for NoStage {
        fn off(&mut self) {}
        fn drive(&mut self, _: Duty, _: Direction) {}
        fn period_began(&mut self) -> Option<u32> {
            None
        }
        fn set_frequency(&mut self, _: u16) {}
        fn mark(&mut self, _: bool) {}
    }

    #[test]
    fn the_motor_cannot_be_armed_until_its_configuration_is_kept() {
        let (shared, mut queues) = (Shared::new(), Queues::new());
        let (ends, _, _) = queues.split();
        static LATCH: Latch = Latch::new();
        let mut control = Control::new(&shared, ends, Output::boot(NoStage, &LATCH), ResetCause::PowerOn);
        let mut answer = |message| {
            assert!(shared.commands.push(Command::Host { of: 7, heard_us: 0, message }).is_ok());
            control.tick(0, 0, false, || 0);
            core::iter::from_fn(|| shared.events.pull()).find_map(|event| match event {
                Event::Ack(_) => Some(None),
                Event::Nack(_, reason) => Some(Some(reason)),
                _ => None,
            })
        };
        let arm = HostMessage::Arm { token: 1 };
        shared.will_keep();
        assert_eq!(answer(HostMessage::Configure(configuration(50))), Some(None));
        assert_eq!(answer(arm.clone()), Some(Some(Refusal::Busy)));
        assert_eq!(block_on(shared.to_keep()), configuration(50));
        assert_eq!(answer(HostMessage::Configure(configuration(60))), Some(None));
        shared.kept();
        assert_eq!(answer(arm.clone()), Some(Some(Refusal::Busy)), "the newer one is still to be kept");
        assert_eq!(block_on(shared.to_keep()), configuration(60));
        shared.kept();
        assert_eq!(answer(arm.clone()), Some(Some(Refusal::NotAligned)), "keeping no longer stands in the way");
    }

    #[test]
    fn another_version_and_every_flipped_bit_are_nothing() {
        let mut out = [0; BUFFER];
        let record = encode(&configuration(50), &mut out).unwrap().to_vec();
        assert_eq!(decode(&record), Some(configuration(50)));
        for bit in 0..record.len() * 8 {
            let mut broken = record.clone();
            broken[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(decode(&broken), None, "bit {bit}");
        }
        let mut newer = record.clone();
        newer[0] = VERSION + 1;
        let length = newer.len() - 4;
        let crc = CRC.checksum(&newer[..length]).to_le_bytes();
        newer[length..].copy_from_slice(&crc);
        assert_eq!(decode(&newer), None);
    }
}
