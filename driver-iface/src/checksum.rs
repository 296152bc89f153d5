//! Reflected 32-bit checksums: the frame check sequence of 802.11, and CRC-32C of side files.

/// The table of a polynomial whose bits are reversed.
pub(crate) const fn table(polynomial: u32) -> [u32; 256] {
    let mut table = [0; 256];
    let mut index = 0;
    while index < 256 {
        let mut crc = index as u32;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 1 == 1 { crc >> 1 ^ polynomial } else { crc >> 1 };
            bit += 1;
        }
        table[index] = crc;
        index += 1;
    }
    table
}

/// The checksum of bytes: all ones before and after.
pub(crate) fn of(table: &[u32; 256], bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |crc: u32, &byte| {
        let index = (crc as u8 ^ byte) as usize;
        crc >> 8 ^ table[index & 0xff]
    })
}
