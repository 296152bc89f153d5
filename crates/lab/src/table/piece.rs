//! What a source gave, in its order, in memory: to be worked on in another thread, or more than once.

use super::block::Block;
use csi5300::source::{CsiSource, Error, Loss, Next, Stamps};
use csi5300::time::Instant;
use driver_iface::record::{MAX_LENGTH, Record, Tail};

/// What a source gives in a piece at most; a damaged log may give more than it has bytes for records.
const MOST: usize = 65_536;

/// Where a record's body lies in a block.
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

#[derive(Clone, Debug)]
enum Item {
    Record(Stamps, u8, Span),
    Lost(Loss),
    End(Tail),
}

/// A stretch of what a source gave.
#[derive(Debug)]
pub(super) struct Piece {
    pub block: Block,
    items: Vec<Item>,
}

impl Piece {
    /// Nothing yet, in this block.
    pub fn new(block: Block) -> Self {
        Self { block, items: Vec::new() }
    }

    /// True if the last of them is the log's end.
    pub fn has_ended(&self) -> bool {
        matches!(self.items.last(), Some(Item::End(_)))
    }

    /// Takes what the source gives until the block is full, nothing is there at `now`, or all was given; whether more may be
    /// there at once.
    ///
    /// # Errors
    /// As the source. What it gave before is in the piece.
    pub fn fill(&mut self, source: &mut (impl CsiSource + ?Sized), now: Instant) -> Result<bool, Error> {
        while self.items.len() < MOST && self.block.room() >= MAX_LENGTH {
            match source.receive(now)? {
                Next::Record(stamps, record) => {
                    // There is room for the longest record.
                    let from = self.block.push(record.body).unwrap_or_default();
                    self.items.push(Item::Record(stamps, record.code, Span { from, len: record.body.len() as u32 }));
                }
                Next::Lost(loss) => self.items.push(Item::Lost(loss)),
                Next::Pending => return Ok(false),
                Next::End(tail) => {
                    self.items.push(Item::End(tail));
                    return Ok(false);
                }
            }
        }
        Ok(true)
    }

    /// What it gave in this place, and where in the block.
    pub fn get(&self, index: usize) -> Option<(Next<'_>, Span)> {
        Some(match self.items.get(index)? {
            Item::Record(stamps, code, span) => {
                (Next::Record(*stamps, Record { code: *code, body: span.of(self.block.bytes()) }), *span)
            }
            Item::Lost(loss) => (Next::Lost(loss.clone()), Span::default()),
            Item::End(tail) => (Next::End(*tail), Span::default()),
        })
    }
}

/// A log in memory, all that its source gave: records of any kind, losses and the end. [`Held::source`] gives the same again, as
/// often as is asked for.
#[derive(Debug)]
pub struct Held {
    pieces: Vec<Piece>,
}

impl Held {
    /// Reads a source to its end; `None` once `go_on`, which is asked every few megabytes, says no.
    ///
    /// # Errors
    /// As the source, and [`Error::Endless`] of one that is live.
    pub fn read(source: &mut dyn CsiSource, go_on: &dyn Fn() -> bool) -> Result<Option<Self>, Error> {
        let mut pieces = Vec::new();
        while go_on() {
            let mut piece = Piece::new(if pieces.is_empty() { Block::small() } else { Block::large() });
            let more = piece.fill(source, Instant::ZERO)?;
            let has_ended = piece.has_ended();
            pieces.push(piece);
            match (more, has_ended) {
                (_, true) => return Ok(Some(Self { pieces })),
                (true, false) => {}
                (false, false) => return Err(Error::Endless),
            }
        }
        Ok(None)
    }

    /// The log from its beginning.
    #[must_use]
    pub fn source(&self) -> HeldSource<'_> {
        HeldSource { pieces: self.pieces.iter(), piece: None, at: 0, ended: false }
    }
}

/// What a source gave, once more; see [`Held::source`].
#[derive(Clone, Debug)]
pub struct HeldSource<'a> {
    pieces: std::slice::Iter<'a, Piece>,
    piece: Option<&'a Piece>,
    at: usize,
    ended: bool,
}

impl CsiSource for HeldSource<'_> {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        loop {
            if let Some((next, _)) = self.piece.and_then(|piece| piece.get(self.at)) {
                self.at += 1;
                self.ended |= matches!(next, Next::End(_));
                return Ok(match next {
                    Next::Record(stamps, record) => Next::Record(Stamps { at: now, ..stamps }, record),
                    other => other,
                });
            }
            let Some(piece) = self.pieces.next() else { return Ok(Next::End(Tail::Clean)) };
            (self.piece, self.at) = (Some(piece), 0);
        }
    }

    fn next_at(&self) -> Option<Instant> {
        (!self.ended).then_some(Instant::ZERO)
    }
}
