//! Whole logs on two threads: one reads bytes, the other finds records among them and sorts these. They stay where they were read.
//!
//! Reading takes new memory, which the kernel clears, and costs as much as all the rest. What is found of a record is used at once:
//! handed from one thread to another, it would have to come out of the other's cache.

use super::block::{BLOCK, Block};
use super::columns::Advise;
use super::piece::Span;
use super::reading::{Reading, Sorted, Table};
use csi5300::source::replay::{Bytes, Framing, Front, Replay};
use csi5300::source::{Error, Next, Origin, Stamps};
use csi5300::time::Instant;
use driver_iface::record::{LOOKAHEAD, Record};
use std::io::Read;
use std::sync::mpsc::sync_channel;

/// Blocks that may wait between the thread that reads and the one that sorts.
const AHEAD: usize = 4;

/// How a log is cut into blocks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    /// Bytes of the first block: a log that fits into it is read before a thread would be there.
    pub first: usize,
    /// Bytes of those in the heap after it, or `None` for [large](Block::large) ones.
    pub block: Option<usize>,
    /// Bytes before what is read into a block: room for what the block before ends with, the beginning of a record.
    pub head: usize,
}

impl Default for Cut {
    fn default() -> Self {
        const { assert!(LOOKAHEAD < BLOCK) };
        Self { first: 128 << 10, block: None, head: LOOKAHEAD }
    }
}

impl Cut {
    fn next(self) -> Block {
        let mut block = self.block.map_or_else(Block::large, Block::fixed);
        block.skip(self.head);
        block
    }
}

impl<R: Read + Send> Reading<Replay<R>> {
    /// Reads all of a log on two threads; records are received at `now`. Stops early once `go_on`, which is asked every few
    /// megabytes, says no.
    ///
    /// # Errors
    /// If the log cannot be read further. What was read before is there.
    pub fn read_all(&mut self, now: Instant, go_on: impl FnMut() -> bool) -> Result<(), Error> {
        self.read_cut(now, Cut::default(), None, &mut (), go_on)
    }

    /// The same of a log of about `bytes`, for whose records there is room then from the beginning; `advise` is told of it.
    ///
    /// # Errors
    /// As [`Self::read_all`].
    pub fn read_sized(
        &mut self,
        now: Instant,
        bytes: u64,
        advise: &mut impl Advise,
        go_on: impl FnMut() -> bool,
    ) -> Result<(), Error> {
        self.read_cut(now, Cut::default(), Some(bytes), advise, go_on)
    }

    /// The same in blocks of other sizes.
    pub(super) fn read_cut(
        &mut self,
        now: Instant,
        cut: Cut,
        size: Option<u64>,
        advise: &mut impl Advise,
        mut go_on: impl FnMut() -> bool,
    ) -> Result<(), Error> {
        if self.ended {
            return Ok(());
        }
        let (replay, table) = self.parts();
        let (bytes, framing) = replay.halves();
        let mut sorter = Sorter { framing, table, now, left: Vec::new(), sorted: Sorted::default(), ended: false };
        let (first, more) = filled(bytes, Block::fixed(cut.first));
        let first_bytes = first.bytes().len();
        sorter.take(first, 0, matches!(more, Ok(false)));
        if more? && go_on() {
            if let Some(size) = size {
                sorter.table.reserve(expected(sorter.table.kept(), first_bytes, size), advise);
            }
            in_blocks(bytes, cut, |block, is_last| {
                sorter.take(block, cut.head, is_last);
                go_on()
            })?;
        }
        self.ended = sorter.ended;
        Ok(())
    }
}

/// Records of a log of `size` bytes by those kept of its first ones, and a few more.
fn expected(kept: usize, of_bytes: usize, size: u64) -> usize {
    let all = kept as f64 * (size as f64 / of_bytes.max(1) as f64);
    (1.02 * all) as usize
}

/// Reads a log in a thread of its own and hands over one block after the other, and whether the log ends in it; `take` says whether to
/// go on.
fn in_blocks<R: Read + Send>(
    bytes: &mut Bytes<R>,
    cut: Cut,
    mut take: impl FnMut(Block, bool) -> bool,
) -> Result<(), Error> {
    let (sender, blocks) = sync_channel(AHEAD);
    std::thread::scope(|scope| {
        let read = move || {
            loop {
                let (block, more) = filled(bytes, cut.next());
                let is_last = !matches!(more, Ok(true));
                // Nobody receives once it was enough.
                if sender.send((block, more)).is_err() || is_last {
                    return;
                }
            }
        };
        let started = std::thread::Builder::new().name("csi5300-read".into()).spawn_scoped(scope, read);
        started.map_err(|source| Error::Io { what: "cannot start a thread to read the log".into(), source })?;
        for (block, more) in blocks {
            let go_on = take(block, matches!(more, Ok(false)));
            if !more? || !go_on {
                break;
            }
        }
        Ok(())
    })
}

/// Reads until a block is full or the log ends; whether there may be more.
fn filled<R: Read>(bytes: &mut Bytes<R>, mut block: Block) -> (Block, Result<bool, Error>) {
    while block.room() > 0 {
        match block.fill(|room| bytes.read_into(room)) {
            Ok(0) => return (block, Ok(false)),
            Ok(_) => {}
            Err(error) => return (block, Err(error)),
        }
    }
    (block, Ok(true))
}

/// Finds the records of a log, a block at a time, and sorts them.
struct Sorter<'a> {
    framing: &'a mut Framing,
    table: Table<'a>,
    now: Instant,
    /// What the last block ended with and was not used.
    left: Vec<u8>,
    /// Of the block at hand; its memory is used again.
    sorted: Sorted,
    ended: bool,
}

impl Sorter<'_> {
    /// Takes the next block, into which bytes were read behind `head`; `is_last` says that the log ends there.
    fn take(&mut self, mut block: Block, head: usize, is_last: bool) {
        let mut at = block.put_before(head, &self.left);
        let bytes = block.bytes();
        while let Some((next, used, body)) = self.step(bytes, at, is_last) {
            at += used;
            self.ended = matches!(next, Next::End(_));
            self.table.sort(&mut self.sorted, &next, Span { from: (at - body) as u32, len: body as u32 });
            if self.ended {
                break;
            }
        }
        self.left.clear();
        self.left.extend_from_slice(bytes.get(at..).unwrap_or_default());
        self.table.keep(&mut self.sorted, block);
    }

    /// What is in the block from byte `at` on, the bytes that it takes, and how many of them, at its end, are a record's body;
    /// `None` where that takes more bytes.
    #[inline]
    fn step<'b>(&mut self, bytes: &'b [u8], at: usize, is_last: bool) -> Option<(Next<'b>, usize, usize)> {
        let front = bytes.get(at..).unwrap_or_default();
        Some(match self.framing.step(front, is_last) {
            Front::Record { used, body, code, offset, host_us } => {
                let stamps = Stamps { at: self.now, host_us, origin: Origin::File { offset } };
                let body_bytes = front.get(used - body..used).unwrap_or_default();
                (Next::Record(stamps, Record { code, body: body_bytes }), used, body)
            }
            Front::Lost { used, loss } => (Next::Lost(loss), used, 0),
            Front::Short => return None,
            Front::End(tail) => (Next::End(tail), 0, 0),
        })
    }
}
