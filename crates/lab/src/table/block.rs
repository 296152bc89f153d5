//! Memory for records: blocks that are written once, from their beginning on.

use memmap2::MmapMut;

/// Bytes of a block.
pub(super) const BLOCK: usize = 4 << 20;

/// A block: of the heap, which takes memory as it is written, or mapped in large pages, which takes all of it at the first
/// byte and a hundredth of the time a byte.
#[derive(Debug)]
pub(super) enum Block {
    /// Of the heap.
    Heap(Vec<u8>),
    /// Mapped; the first `len` bytes are written.
    Mapped {
        /// The memory.
        map: MmapMut,
        /// Bytes written.
        len: usize,
    },
}

impl Block {
    /// For few records.
    pub fn small() -> Self {
        Self::Heap(Vec::new())
    }

    /// For many.
    pub fn large() -> Self {
        let Ok(map) = MmapMut::map_anon(BLOCK) else { return Self::Heap(Vec::with_capacity(BLOCK)) };
        // Pages of the usual size do as well.
        #[cfg(target_os = "linux")]
        let _ = map.advise(memmap2::Advice::HugePage);
        Self::Mapped { map, len: 0 }
    }

    /// Bytes for which there is room.
    pub fn room(&self) -> usize {
        BLOCK.saturating_sub(self.bytes().len())
    }

    /// Adds bytes; where they begin, or `None` without room for them. An empty heap block takes any number.
    pub fn push(&mut self, bytes: &[u8]) -> Option<u32> {
        let from = self.bytes().len();
        match self {
            Self::Heap(heap) if from == 0 || from + bytes.len() <= BLOCK => heap.extend_from_slice(bytes),
            Self::Mapped { map, len } => {
                map.get_mut(from..from + bytes.len())?.copy_from_slice(bytes);
                *len += bytes.len();
            }
            Self::Heap(_) => return None,
        }
        u32::try_from(from).ok()
    }

    /// What was written.
    pub fn bytes(&self) -> &[u8] {
        match self {
            Self::Heap(heap) => heap,
            Self::Mapped { map, len } => map.get(..*len).unwrap_or_default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{BLOCK, Block};

    #[test]
    fn a_block_holds_what_was_written_and_no_more() {
        for mut block in [Block::small(), Block::large()] {
            assert!(block.bytes().is_empty() && block.room() == BLOCK);
            assert_eq!((block.push(&[1, 2, 3]), block.push(&[4])), (Some(0), Some(3)));
            assert_eq!((block.bytes(), block.room()), (&[1, 2, 3, 4][..], BLOCK - 4));
            assert_eq!(block.push(&vec![5; BLOCK - 3]), None);
            assert_eq!(block.push(&vec![6; BLOCK - 4]), Some(4));
            assert_eq!((block.room(), block.bytes()[BLOCK - 1], block.push(&[7])), (0, 6, None));
        }
        let mut own = Block::small();
        assert_eq!((own.push(&vec![8; BLOCK + 1]), own.push(&[9]), own.room()), (Some(0), None, 0));
    }
}
