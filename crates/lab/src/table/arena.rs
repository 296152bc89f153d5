//! Records in memory, packed as the card sent them: a quarter of what their CSI takes as complex numbers.

use driver_iface::bfee::Bfee;
use driver_iface::record::code;

/// Bytes of a block; records lie in one block each.
const BLOCK: usize = 4 << 20;

/// Where a record's body lies.
#[derive(Clone, Copy, Debug, Default)]
struct Place {
    block: u32,
    from: u32,
    len: u32,
}

/// A bfee record and the frame that the driver logged with it.
#[derive(Clone, Copy, Debug)]
struct Entry {
    bfee: Place,
    /// The MPDU record before it; length 0 where there is none.
    mpdu: Place,
}

/// bfee records in the order of the log, each with the MPDU record that says who sent it, where there is one.
#[derive(Debug, Default)]
pub struct Arena {
    blocks: Vec<Vec<u8>>,
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

    /// Adds the body of a bfee record that was checked.
    pub fn push(&mut self, body: &[u8]) {
        let waiting = std::mem::take(&mut self.waiting);
        let mpdu = if waiting.is_empty() { Place::default() } else { self.store(&waiting) };
        self.waiting = waiting;
        self.waiting.clear();
        let bfee = self.store(body);
        self.entries.push(Entry { bfee, mpdu });
    }

    fn store(&mut self, body: &[u8]) -> Place {
        let fits = self.blocks.last().is_some_and(|block| block.len() + body.len() <= BLOCK);
        if !fits {
            self.blocks.push(Vec::with_capacity(BLOCK.max(body.len())));
        }
        let block = self.blocks.len() - 1;
        let Some(last) = self.blocks.last_mut() else { return Place::default() };
        let from = last.len();
        last.extend_from_slice(body);
        // Blocks and bodies are far below 4 GiB; 2^32 blocks would be 16 PiB.
        Place { block: block as u32, from: from as u32, len: body.len() as u32 }
    }

    fn bytes(&self, place: Place) -> &[u8] {
        let from = place.from as usize;
        let block = self.blocks.get(place.block as usize);
        block.and_then(|block| block.get(from..from + place.len as usize)).unwrap_or_default()
    }

    /// The body of a bfee record; empty beyond the last.
    #[must_use]
    pub fn body(&self, index: usize) -> &[u8] {
        self.entries.get(index).map_or(&[], |entry| self.bytes(entry.bfee))
    }

    /// The MPDU logged with a bfee record; empty where there is none.
    #[must_use]
    pub fn mpdu(&self, index: usize) -> &[u8] {
        self.entries.get(index).map_or(&[], |entry| self.bytes(entry.mpdu))
    }

    /// A bfee record, checked again.
    #[must_use]
    pub fn bfee(&self, index: usize) -> Option<Bfee<'_>> {
        Bfee::new_checked(self.body(index)).ok()
    }

    /// Bytes of a record and its companion, MPDU first, with their codes.
    pub fn records(&self, index: usize) -> impl Iterator<Item = (u8, &[u8])> {
        let all = [(code::MPDU, self.mpdu(index)), (code::BFEE, self.body(index))];
        all.into_iter().filter(|(_, body)| !body.is_empty())
    }

    /// Bytes held.
    #[must_use]
    pub fn size(&self) -> usize {
        self.blocks.iter().map(Vec::len).sum()
    }
}
