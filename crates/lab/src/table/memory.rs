//! Records in memory, as the card sent them: blocks that are written once, and a log's bfee records in them ([`Arena`]). [`LogReader`] reads records of a log again whose columns alone are in memory.

use driver_iface::bfee::Bfee;
use driver_iface::record::{LENGTH_FIELD, MAX_LENGTH, Record, card_clock_ps, code};
use memmap2::MmapMut;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// Bytes of a block.
pub(super) const BLOCK: usize = 4 << 20;

/// Memory of a fixed size.
#[derive(Debug)]
pub(super) enum Memory {
    /// From the heap.
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

/// A block: on the heap, which takes memory as it is written, or of a fixed size.
#[derive(Debug)]
pub(super) enum Block {
    /// On the heap.
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

    /// For many records: mapped in large pages; all of the memory is taken at the first byte, at a hundredth of the cost per byte.
    pub fn large() -> Self {
        let block = Self::fixed(BLOCK);
        // Pages of the usual size work, too.
        #[cfg(target_os = "linux")]
        if let Self::Fixed { memory: Memory::Mapped(map), .. } = &block {
            let _ = map.advise(memmap2::Advice::HugePage);
        }
        block
    }

    /// For this many bytes; takes memory page by page.
    pub fn fixed(bytes: usize) -> Self {
        let memory = MmapMut::map_anon(bytes).map_or_else(|_| Memory::Heap(vec![0; bytes]), Memory::Mapped);
        Self::Fixed { memory, len: 0 }
    }

    /// Free bytes.
    pub fn room(&self) -> usize {
        match self {
            Self::Growing(heap) => BLOCK.saturating_sub(heap.len()),
            Self::Fixed { memory, len } => memory.bytes().len().saturating_sub(*len),
        }
    }

    /// Appends bytes; returns their offset, or `None` without room. An empty heap block takes any number.
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

    /// Lets `fill` write after the written bytes and return their number. A growing block has no room for that.
    pub fn fill<E>(&mut self, fill: impl FnOnce(&mut [u8]) -> Result<usize, E>) -> Result<usize, E> {
        let Self::Fixed { memory, len } = self else { return Ok(0) };
        let room = memory.bytes_mut().get_mut(*len..).unwrap_or_default();
        let most = room.len();
        let written = fill(room)?.min(most);
        *len += written;
        Ok(written)
    }

    /// Skips the next bytes.
    pub fn skip(&mut self, bytes: usize) {
        if let Self::Fixed { memory, len } = self {
            *len = (*len + bytes).min(memory.bytes().len());
        }
    }

    /// The memory of a fixed-size block, for reuse.
    pub fn emptied(self) -> Option<Self> {
        match self {
            Self::Fixed { memory, .. } => Some(Self::Fixed { memory, len: 0 }),
            Self::Growing(_) => None,
        }
    }

    /// Writes `bytes` so that they end at `to`, over what is there; returns their offset. A block with too few bytes before `to`
    /// becomes one with `bytes` and everything from `to` on.
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

    /// The written bytes.
    pub fn bytes(&self) -> &[u8] {
        match self {
            Self::Growing(heap) => heap,
            Self::Fixed { memory, len } => memory.bytes().get(..*len).unwrap_or_default(),
        }
    }
}

/// A bfee record and the frame that the driver logged with it, each in a block.
#[derive(Clone, Copy, Debug, Default)]
struct Entry {
    bfee: Place,
    /// The MPDU record before it; length 0 without one.
    mpdu: Place,
}

/// The place of a record's body.
#[derive(Clone, Copy, Debug, Default)]
struct Place {
    block: u32,
    span: Span,
}

impl Place {
    fn of(self, blocks: &[Block]) -> &[u8] {
        blocks.get(self.block as usize).map(|block| self.span.of(block.bytes())).unwrap_or_default()
    }
}

/// Copies a body into the last block, or into a new one if it has no room.
fn store(blocks: &mut Vec<Block>, body: &[u8]) -> Place {
    let stored = blocks.last_mut().and_then(|block| block.push(body));
    let from = stored.or_else(|| {
        blocks.push(Block::small());
        blocks.last_mut()?.push(body)
    });
    let span = Span { from: from.unwrap_or_default(), len: body.len() as u32 };
    Place { block: blocks.len().saturating_sub(1) as u32, span }
}

/// bfee records in the order of the log, each with the MPDU record that names its sender, if there is one.
#[derive(Debug, Default)]
pub struct Arena {
    blocks: Vec<Block>,
    entries: Vec<Entry>,
    /// The newest MPDU, until a bfee takes it.
    waiting: Vec<u8>,
}

impl Arena {
    /// Number of bfee records.
    #[must_use]
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// True without any.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Keeps an MPDU for the next bfee.
    pub fn note_mpdu(&mut self, body: &[u8]) {
        self.waiting.clear();
        self.waiting.extend_from_slice(body);
    }

    /// Forgets the MPDU of a bfee that is not kept.
    pub fn drop_mpdu(&mut self) {
        self.waiting.clear();
    }

    /// Adds the body of a checked bfee record.
    pub fn push(&mut self, body: &[u8]) {
        let waiting = std::mem::take(&mut self.waiting);
        let mpdu = if waiting.is_empty() { Place::default() } else { store(&mut self.blocks, &waiting) };
        self.waiting = waiting;
        self.waiting.clear();
        let bfee = store(&mut self.blocks, body);
        self.entries.push(Entry { bfee, mpdu });
    }

    /// Takes over a block; `records` are its kept bfee records, each with its MPDU if that is in the block too. The first one's may
    /// be an MPDU [noted](Self::note_mpdu) before.
    pub(super) fn adopt(&mut self, block: Block, records: impl IntoIterator<Item = (Span, Option<Span>)>) {
        let noted = std::mem::take(&mut self.waiting);
        let mut noted = (!noted.is_empty()).then(|| store(&mut self.blocks, &noted));
        // 2^32 blocks would be 16 PiB.
        let own = |block: usize, span| Place { block: block as u32, span };
        let number = self.blocks.len();
        self.entries.extend(records.into_iter().map(|(bfee, mpdu)| {
            let before = noted.take();
            let mpdu = mpdu.map(|span| own(number, span)).or(before).unwrap_or_default();
            Entry { bfee: own(number, bfee), mpdu }
        }));
        self.blocks.push(block);
    }

    /// The body of a bfee record; empty beyond the last.
    #[must_use]
    pub fn body(&self, index: usize) -> &[u8] {
        self.entries.get(index).map_or(&[], |entry| entry.bfee.of(&self.blocks))
    }

    /// The MPDU logged with a bfee record, or the [clock](code::CARD_CLOCK) of a translated log; empty without either.
    #[must_use]
    pub fn mpdu(&self, index: usize) -> &[u8] {
        self.entries.get(index).map_or(&[], |entry| entry.mpdu.of(&self.blocks))
    }

    /// A bfee record, checked again.
    #[must_use]
    pub fn bfee(&self, index: usize) -> Option<Bfee<'_>> {
        Bfee::new_checked(self.body(index)).ok()
    }

    /// Bytes of a record and its MPDU, MPDU first, with their codes.
    pub fn records(&self, index: usize) -> impl Iterator<Item = (u8, &[u8])> {
        let before = self.mpdu(index);
        // In a log translated from another card its place is the clock's; no frame is as short.
        let own = if card_clock_ps(before).is_some() { code::CARD_CLOCK } else { code::MPDU };
        let all = [(own, before), (code::BFEE, self.body(index))];
        all.into_iter().filter(|(_, body)| !body.is_empty())
    }

    /// Bytes held.
    #[must_use]
    pub fn size(&self) -> usize {
        self.blocks.iter().map(|block| block.bytes().len()).sum()
    }
}

/// The place of a record's body in a block.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Span {
    /// Its first byte.
    pub from: u32,
    /// Its bytes; 0 for none.
    pub len: u32,
}

impl Span {
    /// The body.
    pub fn of(self, bytes: &[u8]) -> &[u8] {
        let from = self.from as usize;
        bytes.get(from..from + self.len as usize).unwrap_or_default()
    }
}

/// Bytes of the window: large enough to cost few calls, small enough to stay in the second-level cache.
const WINDOW: usize = 256 * 1024;
/// Bytes of the longest record.
const LONGEST: usize = LENGTH_FIELD + MAX_LENGTH;

/// A log that was read before and whose records are read again.
pub(crate) struct LogReader {
    file: File,
    window: Vec<u8>,
    /// Offset of the window in the file.
    start: u64,
    /// Bytes in the window.
    filled: usize,
}

impl LogReader {
    /// Opens a log; the file must be seekable.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(Self { file: File::open(path)?, window: vec![0; WINDOW], start: 0, filled: 0 })
    }

    /// The bfee record at an offset of the log; `None` if there is none (any more). Fast if offsets rise.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn bfee(&mut self, offset: i64) -> io::Result<Option<Bfee<'_>>> {
        let place = u64::try_from(offset).unwrap_or(u64::MAX);
        let inside = place.checked_sub(self.start).and_then(|at| usize::try_from(at).ok());
        let at = match inside.filter(|at| at.saturating_add(LONGEST) <= self.filled) {
            Some(at) => at,
            None => {
                self.move_to(place)?;
                0
            }
        };
        Ok(bfee_at(self.window.get(at..self.filled).unwrap_or_default()))
    }

    /// Moves the window to an offset: keeps the overlapping bytes and reads the others, as many as there are.
    fn move_to(&mut self, place: u64) -> io::Result<()> {
        let end = self.start + self.filled as u64;
        let kept = if (self.start..end).contains(&place) { (end - place) as usize } else { 0 };
        self.window.copy_within(self.filled - kept..self.filled, 0);
        self.file.seek(SeekFrom::Start(place + kept as u64))?;
        (self.start, self.filled) = (place, kept);
        while let Some(room) = self.window.get_mut(self.filled..).filter(|room| !room.is_empty()) {
            match self.file.read(room) {
                Ok(0) => break,
                Ok(read) => self.filled += read,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

/// The bfee record at the front of some bytes.
fn bfee_at(bytes: &[u8]) -> Option<Bfee<'_>> {
    let length = u16::from_be_bytes(*bytes.first_chunk::<LENGTH_FIELD>()?);
    let record = Record::from_message(bytes.get(LENGTH_FIELD..LENGTH_FIELD + usize::from(length))?)?;
    (record.code == code::BFEE).then(|| Bfee::new_checked(record.body).ok())?
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn bytes_are_read_after_a_gap_that_takes_earlier_unused_bytes() {
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
