//! Values of arrays on their way to a file, in blocks.

use bytemuck::{Pod, cast_slice};
use std::io::{self, Write};

/// Values written at a time.
const BLOCK: usize = 8_192;

/// Writes values as they lie in memory; gives how many there were.
///
/// # Errors
/// As the writer.
pub(super) fn emit<T: Pod>(mut values: impl Iterator<Item = T>, out: &mut impl Write) -> io::Result<u64> {
    emit_blocks(|block| block.extend(values.by_ref().take(BLOCK)), out)
}

/// The same of values that are handed over block by block: `next` fills the block, which is empty, and leaves it empty at the
/// end.
///
/// # Errors
/// As the writer.
pub(super) fn emit_blocks<T: Pod>(mut next: impl FnMut(&mut Vec<T>), out: &mut impl Write) -> io::Result<u64> {
    let (mut block, mut written) = (Vec::new(), 0);
    loop {
        block.clear();
        next(&mut block);
        if block.is_empty() {
            return Ok(written);
        }
        out.write_all(cast_slice(&block))?;
        written += block.len() as u64;
    }
}
