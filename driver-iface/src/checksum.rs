//! Reflected 32-bit checksums: the frame check sequence of 802.11, and CRC-32C of side files.

/// Bytes that are looked up at once.
const LANES: usize = 16;

/// Tables of a polynomial: of a byte followed by a number of zero bytes.
pub(crate) type Tables = [[u32; 256]; LANES];

/// The tables of a polynomial whose bits are reversed.
pub(crate) const fn tables(polynomial: u32) -> Tables {
    let mut tables = [[0; 256]; LANES];
    let mut index = 0;
    while index < 256 {
        let mut crc = index as u32;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 1 == 1 { crc >> 1 ^ polynomial } else { crc >> 1 };
            bit += 1;
        }
        tables[0][index] = crc;
        index += 1;
    }
    let mut lane = 1;
    while lane < LANES {
        let mut index = 0;
        while index < 256 {
            let before = tables[lane - 1][index];
            tables[lane][index] = before >> 8 ^ tables[0][(before & 0xff) as usize];
            index += 1;
        }
        lane += 1;
    }
    tables
}

/// The checksum of bytes, with all ones before and after. Sixteen bytes at a time, then eight, four and one.
pub(crate) fn of(tables: &Tables, bytes: &[u8]) -> u32 {
    let (crc, rest) = by_blocks::<LANES>(tables, !0, bytes);
    let (crc, rest) = by_blocks::<8>(tables, crc, rest);
    let (crc, rest) = by_blocks::<4>(tables, crc, rest);
    !byte_by_byte(tables, crc, rest)
}

/// Continues a checksum over blocks of `BYTES`, four to [`LANES`]; returns it and the remaining bytes.
#[inline(always)]
fn by_blocks<'a, const BYTES: usize>(tables: &Tables, crc: u32, bytes: &'a [u8]) -> (u32, &'a [u8]) {
    let (blocks, rest) = bytes.as_chunks::<BYTES>();
    let crc = blocks.iter().fold(crc, |crc: u32, block| {
        let mut block = *block;
        for (byte, before) in block.iter_mut().zip(crc.to_le_bytes()) {
            *byte ^= before;
        }
        // From the last byte on: those that depend on the previous checksum come last.
        tables.iter().zip(block.iter().rev()).fold(0, |crc, (table, byte)| crc ^ table[usize::from(*byte)])
    });
    (crc, rest)
}

/// Continues a checksum byte by byte.
fn byte_by_byte(tables: &Tables, crc: u32, bytes: &[u8]) -> u32 {
    bytes.iter().fold(crc, |crc, &byte| crc >> 8 ^ tables[0][usize::from(crc as u8 ^ byte)])
}

#[cfg(test)]
mod tests {
    use super::{byte_by_byte, of, tables};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn table_lookups_equal_the_bytewise_checksum(bytes in prop::collection::vec(any::<u8>(), 0..200), polynomial: u32) {
            let tables = tables(polynomial | 1 << 31);
            prop_assert_eq!(of(&tables, &bytes), !byte_by_byte(&tables, !0, &bytes));
        }
    }
}
