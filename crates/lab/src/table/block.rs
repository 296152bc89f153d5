//! Memory for records: blocks that are written once, from their beginning on.

use memmap2::MmapMut;

/// Bytes of a block.
pub(super) const BLOCK: usize = 4 << 20;

/// Memory of a fixed size.
#[derive(Debug)]
pub(super) enum Memory {
    /// Of the heap.
    Heap(Vec<u8>),
    /// Mapped.
    Mapped(MmapMut),
}

impl Memory {
    fn bytes(&self) -> &[u8] {
        match self {
            Self::Heap(heap) => heap,
            Self::Mapped(map) => map,
        }
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        match self {
            Self::Heap(heap) => heap,
            Self::Mapped(map) => map,
        }
    }
}

/// A block: of the heap, which takes memory as it is written, or of a fixed size.
#[derive(Debug)]
pub(super) enum Block {
    /// Of the heap.
    Growing(Vec<u8>),
    /// Of a fixed size; the first `len` bytes are written.
    Fixed {
        /// The memory.
        memory: Memory,
        /// Bytes written.
        len: usize,
    },
}

impl Block {
    /// For few records.
    pub fn small() -> Self {
        Self::Growing(Vec::new())
    }

    /// For many: mapped in large pages, which takes all of the memory at the first byte and a hundredth of the time a byte.
    pub fn large() -> Self {
        let block = Self::fixed(BLOCK);
        // Pages of the usual size do as well.
        #[cfg(target_os = "linux")]
        if let Self::Fixed { memory: Memory::Mapped(map), .. } = &block {
            let _ = map.advise(memmap2::Advice::HugePage);
        }
        block
    }

    /// For so many bytes; takes memory page by page.
    pub fn fixed(bytes: usize) -> Self {
        let memory = MmapMut::map_anon(bytes).map_or_else(|_| Memory::Heap(vec![0; bytes]), Memory::Mapped);
        Self::Fixed { memory, len: 0 }
    }

    /// Bytes for which there is room.
    pub fn room(&self) -> usize {
        match self {
            Self::Growing(heap) => BLOCK.saturating_sub(heap.len()),
            Self::Fixed { memory, len } => memory.bytes().len().saturating_sub(*len),
        }
    }

    /// Adds bytes; where they begin, or `None` without room for them. An empty heap block takes any number.
    pub fn push(&mut self, bytes: &[u8]) -> Option<u32> {
        let from = self.bytes().len();
        match self {
            Self::Growing(heap) if from == 0 || from + bytes.len() <= BLOCK => heap.extend_from_slice(bytes),
            Self::Fixed { memory, len } => {
                memory.bytes_mut().get_mut(from..from + bytes.len())?.copy_from_slice(bytes);
                *len += bytes.len();
            }
            Self::Growing(_) => return None,
        }
        u32::try_from(from).ok()
    }

    /// Has `fill` write behind what was written, and takes the bytes that it says it wrote. A growing block has no room for that.
    pub fn fill<E>(&mut self, fill: impl FnOnce(&mut [u8]) -> Result<usize, E>) -> Result<usize, E> {
        let Self::Fixed { memory, len } = self else { return Ok(0) };
        let room = memory.bytes_mut().get_mut(*len..).unwrap_or_default();
        let most = room.len();
        let written = fill(room)?.min(most);
        *len += written;
        Ok(written)
    }

    /// Leaves the next bytes as they are.
    pub fn skip(&mut self, bytes: usize) {
        if let Self::Fixed { memory, len } = self {
            *len = (*len + bytes).min(memory.bytes().len());
        }
    }

    /// The memory of a block of a fixed size, to be written anew.
    pub fn emptied(self) -> Option<Self> {
        match self {
            Self::Fixed { memory, .. } => Some(Self::Fixed { memory, len: 0 }),
            Self::Growing(_) => None,
        }
    }

    /// Writes `bytes` so that they end at `to`, over what is there; where they begin. A block whose bytes before `to` are too few
    /// becomes one that holds `bytes` and what is behind `to`.
    pub fn put_before(&mut self, to: usize, bytes: &[u8]) -> usize {
        if let Self::Fixed { memory, .. } = self
            && let Some(from) = to.checked_sub(bytes.len())
            && let Some(place) = memory.bytes_mut().get_mut(from..to)
        {
            place.copy_from_slice(bytes);
            return from;
        }
        let whole = [bytes, self.bytes().get(to..).unwrap_or_default()].concat();
        *self = Self::Growing(whole);
        0
    }

    /// What was written.
    pub fn bytes(&self) -> &[u8] {
        match self {
            Self::Growing(heap) => heap,
            Self::Fixed { memory, len } => memory.bytes().get(..*len).unwrap_or_default(),
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
    #[test]
    fn bytes_are_read_behind_a_gap_and_what_was_left_over_is_put_before_them() {
        let mut block = Block::fixed(10);
        block.skip(3);
        let read = |room: &mut [u8]| {
            room[..4].copy_from_slice(&[3, 4, 5, 6]);
            Ok::<usize, ()>(4)
        };
        assert_eq!((block.fill(read), block.room()), (Ok(4), 3));
        assert_eq!((block.put_before(3, &[1, 2]), block.bytes()), (1, &[0, 1, 2, 3, 4, 5, 6][..]));
        assert_eq!((block.put_before(3, &[9, 9, 1, 2]), block.bytes()), (0, &[9, 9, 1, 2, 3, 4, 5, 6][..]));
        assert_eq!(block.fill(|_| Ok::<usize, ()>(1)), Ok(0));
        assert_eq!(Block::fixed(2).fill(|room| Ok::<usize, ()>(room.len() + 1)), Ok(2));
    }
}
