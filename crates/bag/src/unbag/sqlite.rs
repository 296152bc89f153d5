//! Messages of an SQLite database, as `ros2 bag record -s sqlite3` writes it (Humble's default): tables `topics` and
//! `messages`, read page by page in the file format (\[sqlite\] 1.3, 1.6, 2). Journals are not applied.

use super::{BagError, Channel, Ended, Used, refused};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// First bytes of a file.
pub(super) const MAGIC: &[u8; 16] = b"SQLite format 3\0";
/// What another database is.
const NO_TABLES: &str = "is an SQLite database without the tables of a recording (topics, messages)";
/// Deepest tree of a table: more levels would need more pages than a file can have.
const DEEPEST: usize = 20;
/// Largest row, bytes.
const LARGEST: u64 = 1 << 30;

/// Why a row or page cannot be read.
enum Wrong {
    Io(io::Error),
    /// It violates the format.
    Damaged,
    /// The file ends before it.
    Missing,
    /// The caller cannot continue.
    Bag(BagError),
}

impl From<io::Error> for Wrong {
    fn from(error: io::Error) -> Self {
        if error.kind() == io::ErrorKind::UnexpectedEof { Self::Missing } else { Self::Io(error) }
    }
}

/// A value of a row, of the types in recordings.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Value<'a> {
    Number(i64),
    Bytes(&'a [u8]),
    Other,
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A number of one to nine bytes, seven bits each, highest first; and the bytes after it.
fn varint(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let mut value = 0_u64;
    for (k, byte) in bytes.iter().enumerate().take(9) {
        if k == 8 {
            return Some((value << 8 | u64::from(*byte), bytes.get(9..)?));
        }
        value = value << 7 | u64::from(byte & 0x7f);
        if byte & 0x80 == 0 {
            return Some((value, bytes.get(k + 1..)?));
        }
    }
    None
}

fn signed(bytes: &[u8]) -> i64 {
    let first = bytes.first().map_or(0, |byte| i64::from(*byte as i8));
    bytes.iter().skip(1).fold(first, |value, byte| value << 8 | i64::from(*byte))
}

/// Columns of a row that are decoded: no table here needs more.
const COLUMNS: usize = 8;

/// The first values of a row.
fn values(row: &[u8]) -> Option<Vec<Value<'_>>> {
    let (length, _) = varint(row)?;
    let (head, mut content) = row.split_at_checked(usize::try_from(length).ok()?)?;
    let (_, mut kinds) = varint(head)?;
    let mut all = Vec::new();
    while !kinds.is_empty() && all.len() < COLUMNS {
        let (kind, rest) = varint(kinds)?;
        kinds = rest;
        let length = match kind {
            0 | 8 | 9 => 0,
            1..=4 => kind,
            5 => 6,
            6 | 7 => 8,
            10 | 11 => return None,
            _ => (kind - 12) / 2,
        };
        let (bytes, rest) = content.split_at_checked(usize::try_from(length).ok()?)?;
        content = rest;
        all.push(match kind {
            1..=6 => Value::Number(signed(bytes)),
            8 | 9 => Value::Number(kind as i64 - 8),
            0 | 7 => Value::Other,
            _ => Value::Bytes(bytes),
        });
    }
    Some(all)
}

fn be16(page: &[u8], at: usize) -> Option<usize> {
    Some(u16::from_be_bytes(*page.get(at..)?.first_chunk()?).into())
}

fn be32(page: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(*page.get(at..)?.first_chunk()?))
}

/// Receives a row: its number and its bytes.
type Rows<'a> = dyn FnMut(u64, &[u8]) -> Result<(), BagError> + 'a;

/// An open database.
struct Database<R> {
    from: R,
    page: usize,
    /// Usable bytes of a page.
    usable: usize,
    /// Pages that it has.
    pages: u32,
    /// Pages of the tree that were read: a tree that leads back to itself ends.
    seen: BTreeSet<u32>,
    /// Overflow pages that may still be read: as many as the file has pages.
    left: u32,
    ended: Ended,
}

impl<R: Read + Seek> Database<R> {
    fn open(mut from: R) -> Result<Self, Wrong> {
        let mut head = [0; 100];
        from.read_exact(&mut head)?;
        let page = match be16(&head, 16) {
            Some(1) => 65_536,
            Some(page) if page.is_power_of_two() && page >= 512 => page,
            _ => return Err(Wrong::Damaged),
        };
        let usable = page - usize::from(head.get(20).copied().unwrap_or(0));
        if usable < 480 {
            return Err(Wrong::Damaged);
        }
        let there = u32::try_from(from.seek(SeekFrom::End(0))? / page as u64).unwrap_or(u32::MAX);
        // The header's number of pages is valid if the last writer wrote it (\[sqlite\] 1.3.7).
        let is_said = be32(&head, 24) == be32(&head, 92);
        let pages = be32(&head, 28).filter(|pages| is_said && *pages > 0).unwrap_or(there);
        let ended = Ended { cut: pages > there, ..Ended::default() };
        Ok(Self { from, page, usable, pages, seen: BTreeSet::new(), left: 0, ended })
    }

    /// Page `number`, from 1.
    fn page(&mut self, number: u32) -> Result<Vec<u8>, Wrong> {
        let before = u64::from(number.checked_sub(1).filter(|_| number <= self.pages).ok_or(Wrong::Damaged)?);
        self.from.seek(SeekFrom::Start(before * self.page as u64))?;
        let mut bytes = vec![0; self.page];
        self.from.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    /// Counts what cannot be read, and continues.
    fn leave_out(&mut self, wrong: Wrong) -> Result<(), Wrong> {
        match wrong {
            Wrong::Damaged => self.ended.damaged_parts += 1,
            Wrong::Missing => self.ended.cut = true,
            other => return Err(other),
        }
        Ok(())
    }

    /// Each row of the table whose tree begins at page `root`, in order of their numbers.
    fn rows(&mut self, root: u32, used: &mut Rows<'_>) -> Result<(), Wrong> {
        (self.seen, self.left) = (BTreeSet::new(), self.pages);
        self.tree(root, 0, used)
    }

    fn tree(&mut self, number: u32, depth: usize, used: &mut Rows<'_>) -> Result<(), Wrong> {
        if depth > DEEPEST || !self.seen.insert(number) {
            return self.leave_out(Wrong::Damaged);
        }
        let page = match self.page(number) {
            Ok(page) => page,
            Err(wrong) => return self.leave_out(wrong),
        };
        // The first page starts with the file's own header.
        let at = if number == 1 { 100 } else { 0 };
        let kind = page.get(at).copied().unwrap_or(0);
        let list = at + if kind == 5 { 12 } else { 8 };
        let cells = be16(&page, at + 3).filter(|cells| [5, 13].contains(&kind) && list + 2 * cells <= page.len());
        let Some(cells) = cells else { return self.leave_out(Wrong::Damaged) };
        for cell in 0..cells {
            let cell = be16(&page, list + 2 * cell).and_then(|at| page.get(at..)).unwrap_or_default();
            if kind == 5 {
                self.tree(be32(cell, 0).unwrap_or(0), depth + 1, used)?;
                continue;
            }
            match self.row(cell) {
                Ok((id, row)) => used(id, &row).map_err(Wrong::Bag)?,
                Err(wrong) => self.leave_out(wrong)?,
            }
        }
        if kind == 5 { self.tree(be32(&page, at + 8).unwrap_or(0), depth + 1, used) } else { Ok(()) }
    }

    /// A row: its number and all of its bytes, from its overflow pages, too.
    fn row(&mut self, cell: &[u8]) -> Result<(u64, Vec<u8>), Wrong> {
        let (length, rest) = varint(cell).ok_or(Wrong::Damaged)?;
        let (id, rest) = varint(rest).ok_or(Wrong::Damaged)?;
        let whole = usize::try_from(length).ok().filter(|_| length <= LARGEST).ok_or(Wrong::Damaged)?;
        // The part of the row that stays on the page (\[sqlite\] 1.6).
        let most = self.usable - 35;
        let least = (self.usable - 12) * 32 / 255 - 23;
        let here = match whole {
            _ if whole <= most => whole,
            _ => Some(least + (whole - least) % (self.usable - 4)).filter(|here| *here <= most).unwrap_or(least),
        };
        let mut row = rest.get(..here).ok_or(Wrong::Damaged)?.to_vec();
        let mut next = if here < whole { be32(rest, here).ok_or(Wrong::Damaged)? } else { 0 };
        while row.len() < whole {
            self.left = self.left.checked_sub(1).ok_or(Wrong::Damaged)?;
            let page = self.page(next)?;
            next = be32(&page, 0).ok_or(Wrong::Damaged)?;
            let more = (whole - row.len()).min(self.usable - 4);
            row.extend(page.get(4..4 + more).ok_or(Wrong::Damaged)?);
        }
        Ok((id, row))
    }

    /// The root pages of the tables.
    fn tables(&mut self) -> Result<BTreeMap<String, u32>, Wrong> {
        let mut tables = BTreeMap::new();
        self.rows(1, &mut |_, row| {
            // type, name, table name, root page, SQL text.
            if let Some([Value::Bytes(b"table"), Value::Bytes(name), _, Value::Number(root), ..]) =
                values(row).as_deref()
            {
                tables.extend(u32::try_from(*root).ok().map(|root| (text(name), root)));
            }
            Ok(())
        })?;
        Ok(tables)
    }

    fn messages(&mut self, path: &Path, used: &mut Used<'_>) -> Result<(), Wrong> {
        let tables = self.tables()?;
        let (Some(topics), Some(messages)) = (tables.get("topics"), tables.get("messages")) else {
            return Err(Wrong::Bag(refused(path, NO_TABLES)));
        };
        let (mut channels, mut odd, mut without_topic) = (BTreeMap::new(), 0, 0);
        self.rows(*topics, &mut |id, row| {
            // id, name, type, serialization_format, and more.
            match values(row).as_deref() {
                Some([_, Value::Bytes(topic), Value::Bytes(kind), Value::Bytes(encoding), ..]) => {
                    channels.insert(id, Channel { topic: text(topic), kind: text(kind), encoding: text(encoding) });
                }
                _ => odd += 1,
            }
            Ok(())
        })?;
        self.rows(*messages, &mut |_, row| {
            // id, topic_id, timestamp, data, and more.
            match values(row).as_deref() {
                Some([_, Value::Number(topic), _, Value::Bytes(payload), ..]) => {
                    match u64::try_from(*topic).ok().and_then(|topic| channels.get(&topic)) {
                        Some(channel) => return used(channel, payload),
                        None => without_topic += 1,
                    }
                }
                _ => odd += 1,
            }
            Ok(())
        })?;
        self.ended.damaged_parts += odd;
        self.ended.without_topic += without_topic;
        Ok(())
    }
}

/// Passes each message of a recording to `used`, in order of their numbers.
pub(super) fn read(path: &Path, from: impl Read + Seek, used: &mut Used<'_>) -> Result<Ended, BagError> {
    let opened = Database::open(from).and_then(|mut database| {
        database.messages(path, used)?;
        Ok(database.ended)
    });
    match opened {
        Ok(ended) => Ok(ended),
        Err(Wrong::Missing) => Ok(Ended { cut: true, ..Ended::default() }),
        Err(Wrong::Damaged) => Ok(Ended { damaged_parts: 1, ..Ended::default() }),
        Err(Wrong::Io(source)) => Err(BagError::Io { path: path.to_owned(), source }),
        Err(Wrong::Bag(error)) => Err(error),
    }
}

/// True if there is a journal beside the file: it has the last messages of an unfinished recording.
pub(super) fn has_journal(path: &Path) -> bool {
    ["-wal", "-journal"].iter().any(|end| {
        let mut name = path.as_os_str().to_owned();
        name.push(end);
        std::fs::metadata(name).is_ok_and(|found| found.len() > 0)
    })
}
