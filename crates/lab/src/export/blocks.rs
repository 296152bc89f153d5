//! Values of arrays on their way to a file, in blocks.

use bytemuck::{Pod, cast_slice};
use std::io::{self, Write};

/// Bytes written at a time: many for one call of the kernel, few enough to stay in the second-level cache.
const BLOCK: usize = 256 * 1024;

/// Writes values as they lie in memory; gives how many there were.
///
/// # Errors
/// As the writer.
pub(super) fn emit<T: Pod>(mut values: impl Iterator<Item = T>, out: &mut impl Write) -> io::Result<u64> {
    let next = |block: &mut Vec<T>| {
        block.clear();
        block.extend(values.by_ref().take(BLOCK / size_of::<T>().max(1)));
    };
    emit_blocks(next, out)
}

/// The same of values that are handed over block by block: `next` puts the next values in the place of those in the block, and none
/// at the end.
///
/// # Errors
/// As the writer.
pub(super) fn emit_blocks<T: Pod>(mut next: impl FnMut(&mut Vec<T>), out: &mut impl Write) -> io::Result<u64> {
    let (mut block, mut written) = (Vec::new(), 0);
    loop {
        next(&mut block);
        if block.is_empty() {
            return Ok(written);
        }
        out.write_all(cast_slice(&block))?;
        written += block.len() as u64;
    }
}
