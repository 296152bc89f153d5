//! A recovered log is one from which nothing more is to be recovered.
//!
//! Some records are accepted because of their neighbours. Without damaged neighbours a reader may judge otherwise, so
//! such records are removed until a reader finds exactly the written records.

use super::Words;
use crate::commands::draft::rest;
use csi5300::source::{CsiSource, Next, Origin, replay::Replay, side_path};
use csi5300::time::Instant;
use driver_iface::record::LENGTH_FIELD;
use driver_iface::side_file::Layout;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufReader, BufWriter, ErrorKind, Read, Write};
use std::path::Path;

/// Takes records out of a log that was just written, and their entries out of its side file, until it reads as it was
/// written. Gives how many.
pub fn settle(log: &Path, side: Option<Layout>) -> Words<u64> {
    let mut taken = 0;
    loop {
        let misread = misread(log)?;
        if misread.is_empty() {
            return Ok(taken);
        }
        taken += misread.len() as u64;
        let failed = |error: std::io::Error| format!("writing {}: {error}", log.display());
        take_out(log, side, &misread).map_err(failed)?;
    }
}

/// The numbers, from 0, of records that a reader does not find where they were written.
fn misread(log: &Path) -> Words<BTreeSet<u64>> {
    let failed = |error: std::io::Error| format!("reading {}: {error}", log.display());
    let mut written = Written::open(log).map_err(failed)?;
    let mut source = Replay::open(log).map_err(|error| error.to_string())?;
    let mut misread = BTreeSet::new();
    let mut next = written.next().map_err(failed)?;
    loop {
        let found = match source.receive(Instant::ZERO).map_err(|error| error.to_string())? {
            Next::Record(stamps, record) => match stamps.origin {
                Origin::File { offset } => Some((offset, record.emit_len())),
                Origin::Live { .. } => continue,
            },
            Next::Lost(_) | Next::Pending => continue,
            Next::End(_) => None,
        };
        while let Some((offset, len)) = next
            && found.is_none_or(|found| offset <= found.0)
        {
            if found != Some((offset, len)) {
                misread.insert(written.number - 1);
            }
            next = written.next().map_err(failed)?;
        }
        if found.is_none() {
            return Ok(misread);
        }
    }
}

/// Rewrites a log without some of its records.
fn take_out(log: &Path, side: Option<Layout>, out: &BTreeSet<u64>) -> std::io::Result<()> {
    let mut written = Written::open(log)?;
    let rest = rest(log);
    let mut kept = BufWriter::new(File::create(&rest)?);
    while written.next()?.is_some() {
        if !out.contains(&(written.number - 1)) {
            kept.write_all(&written.record)?;
        }
    }
    kept.into_inner()?.sync_data()?;
    std::fs::rename(&rest, log)?;
    let Some(layout) = side else { return Ok(()) };
    let entries = std::fs::read(side_path(log))?;
    let (head, entries) = entries.split_at_checked(layout.head().len()).unwrap_or((&entries, &[]));
    let kept = (0..).zip(entries.chunks(layout.bytes())).filter(|(number, _)| !out.contains(number));
    std::fs::write(
        side_path(log),
        kept.fold(head.to_vec(), |mut all, (_, entry)| {
            all.extend_from_slice(entry);
            all
        }),
    )
}

/// The records of an intact log, by their lengths alone.
struct Written {
    file: BufReader<File>,
    offset: u64,
    /// Of records read.
    number: u64,
    /// The last one.
    record: Vec<u8>,
}

impl Written {
    fn open(log: &Path) -> std::io::Result<Self> {
        Ok(Self { file: BufReader::new(File::open(log)?), offset: 0, number: 0, record: Vec::new() })
    }

    /// Offset and length of the next record; `None` at the end.
    fn next(&mut self) -> std::io::Result<Option<(u64, usize)>> {
        let mut length = [0; LENGTH_FIELD];
        match self.file.read_exact(&mut length) {
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
            outcome => outcome?,
        }
        self.record.clear();
        self.record.extend_from_slice(&length);
        self.record.resize(LENGTH_FIELD + usize::from(u16::from_be_bytes(length)), 0);
        self.file.read_exact(self.record.split_at_mut(LENGTH_FIELD).1)?;
        let offset = self.offset;
        self.offset += self.record.len() as u64;
        self.number += 1;
        Ok(Some((offset, self.record.len())))
    }
}
