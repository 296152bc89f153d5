//! Bit streams, lowest bit first, as the 5300 and the QCA9300 pack their samples.

/// Reads numbers of a few bits each.
pub(crate) struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Bits<'a> {
    pub(crate) const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    pub(crate) const fn skip(&mut self, bits: usize) {
        self.at += bits;
    }

    /// The next `bits` (at most 16) as a two's complement number; `None` past the end.
    pub(crate) fn signed(&mut self, bits: usize) -> Option<i16> {
        let mut word = 0_u32;
        for k in 0..3 {
            word |= u32::from(self.bytes.get(self.at / 8 + k).copied().unwrap_or(0)) << (8 * k);
        }
        let at = self.at;
        self.at += bits;
        let value = (word >> (at % 8)) << (32 - bits);
        (self.at <= 8 * self.bytes.len()).then_some((value.cast_signed() >> (32 - bits)) as i16)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_lowest_bit_first_and_end_with_the_bytes() {
        // 3 bits unused, then -1 of 8 bits, then 2 of 10 bits: 0b0000000010_11111111_000.
        let mut bits = Bits::new(&[0b1111_1000, 0b0001_0111, 0b0000_0000]);
        bits.skip(3);
        assert_eq!((bits.signed(8), bits.signed(10)), (Some(-1), Some(2)));
        assert_eq!((bits.signed(3), bits.signed(1)), (Some(0), None));
    }
}
