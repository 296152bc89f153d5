//! Records in memory, packed as the card sent them: a quarter of what their CSI takes as complex numbers.

use super::block::Block;
use super::columns::Advise;
use super::piece::Span;
use driver_iface::bfee::Bfee;
use driver_iface::record::code;

/// A bfee record and the frame that the driver logged with it, each in a block.
#[derive(Clone, Copy, Debug, Default)]
struct Entry {
    bfee: Place,
    /// The MPDU record before it; length 0 where there is none.
    mpdu: Place,
}

/// Where a record's body lies.
#[derive(Clone, Copy, Debug, Default)]
struct Place {
    block: u32,
    span: Span,
}

/// bfee records in the order of the log, each with the MPDU record that says who sent it, where there is one.
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

    /// Makes room for so many more records, as far as memory allows; `advise` is told of it.
    pub(super) fn reserve(&mut self, records: usize, advise: &mut impl Advise) {
        if self.entries.try_reserve_exact(records).is_ok() {
            advise.advise(self.entries.spare_capacity_mut());
        }
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

    /// Takes over a block; `records` are the bfee records in it that are kept, each with its MPDU where that is in the block
    /// too. The first one's may be an MPDU [noted](Self::note_mpdu) before.
    pub(super) fn adopt(&mut self, block: Block, records: impl IntoIterator<Item = (Span, Option<Span>)>) {
        let noted = std::mem::take(&mut self.waiting);
        let mut noted = (!noted.is_empty()).then(|| self.store(&noted));
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

    fn store(&mut self, body: &[u8]) -> Place {
        let stored = self.blocks.last_mut().and_then(|block| block.push(body));
        let from = stored.or_else(|| {
            self.blocks.push(Block::small());
            self.blocks.last_mut()?.push(body)
        });
        let span = Span { from: from.unwrap_or_default(), len: body.len() as u32 };
        Place { block: self.blocks.len().saturating_sub(1) as u32, span }
    }

    fn bytes(&self, place: Place) -> &[u8] {
        self.blocks.get(place.block as usize).map(|block| place.span.of(block.bytes())).unwrap_or_default()
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
        self.blocks.iter().map(|block| block.bytes().len()).sum()
    }
}
