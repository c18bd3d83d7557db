//! The 1 kHz encoder capture: one bit a sample, 32 to a word, the oldest in the most significant bit (thesis C.1).

/// Collects levels into words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BitPacker {
    word: u32,
    filled: u8,
}

impl BitPacker {
    /// An empty packer.
    pub const fn new() -> Self {
        Self { word: 0, filled: 0 }
    }

    /// Adds one sample; gives the word when it is full.
    pub fn push(&mut self, level: bool) -> Option<u32> {
        self.word = (self.word << 1) | u32::from(level);
        self.filled += 1;
        if self.filled == 32 {
            let word = self.word;
            *self = Self::new();
            return Some(word);
        }
        None
    }

    /// Takes what is left: the samples at the top of the word, and how many there are.
    pub fn flush(&mut self) -> Option<(u32, u8)> {
        if self.filled == 0 {
            return None;
        }
        let rest = (self.word << (32 - u32::from(self.filled)), self.filled);
        *self = Self::new();
        Some(rest)
    }
}

/// The samples of a word, oldest first.
pub fn levels(word: u32, samples: u8) -> impl Iterator<Item = bool> {
    (0..u32::from(samples.min(32))).map(move |index| (word >> (31 - index)) & 1 == 1)
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    #[test]
    fn the_oldest_sample_is_the_most_significant_bit() {
        let mut packer = BitPacker::new();
        assert_eq!(packer.push(true), None);
        for _ in 0..30 {
            assert_eq!(packer.push(false), None);
        }
        assert_eq!(packer.push(true), Some(0x8000_0001));
        assert_eq!(packer.flush(), None);
    }

    proptest! {
        #[test]
        fn what_is_packed_unpacks(samples in proptest::collection::vec(any::<bool>(), 0..200)) {
            let mut packer = BitPacker::new();
            let mut out = Vec::new();
            for &sample in &samples {
                if let Some(word) = packer.push(sample) {
                    out.extend(levels(word, 32));
                }
            }
            if let Some((word, count)) = packer.flush() {
                out.extend(levels(word, count));
            }
            prop_assert_eq!(out, samples);
        }
    }
}
