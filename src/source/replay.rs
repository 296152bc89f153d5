//! A recorded `.dat` log as a [`CsiSource`]: read in chunks, never loaded.

use super::side_file::{Checks, Said, SideFile};
use super::{CsiSource, Error, Loss, Next, Origin, Stamps};
use crate::time::Instant;
use driver_iface::record::{Framer, LOOKAHEAD, Reason, Record, Step};
use driver_iface::side_file::Layout;
use std::io::Read;
use std::path::Path;

/// Bytes asked for at a time: large enough to cost few calls; each page of it that is new to the process costs as much as
/// decoding what fits on it.
const CHUNK: usize = 64 * 1024;

/// Plays back a log as fast as it is asked for. Memory is one buffer, whatever the size of the log.
pub struct Replay<R> {
    reader: R,
    name: String,
    buffer: Vec<u8>,
    start: usize,
    filled: usize,
    end_of_file: bool,
    framer: Framer,
    bytes: u64,
    side: Option<SideFile>,
    /// The time of the last call: the next record is due by then. None once the log has ended.
    due: Option<Instant>,
}

impl Replay<Box<dyn Read + Send>> {
    /// Opens a log; `-` is standard input. Host times come from its side file (`<log>stp`), where there is one; a record
    /// whose checksum is not the side file's is lost.
    ///
    /// # Errors
    /// If it cannot be opened, or is a directory.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let name = path.display().to_string();
        if path.as_os_str() == "-" {
            return Ok(Self::new(Box::new(std::io::stdin()), "standard input".into()));
        }
        let io = |source| Error::Io { what: format!("cannot read the log {name}"), source };
        if path.is_dir() {
            return Err(Error::Directory { path: path.into() });
        }
        let file = std::fs::File::open(path).map_err(io)?;
        Ok(Self { side: SideFile::of(path), ..Self::new(Box::new(file), name.clone()) })
    }
}

impl<R: Read> Replay<R> {
    /// Replays what `reader` gives; `name` is for messages.
    pub fn new(reader: R, name: String) -> Self {
        let buffer = vec![0; CHUNK + LOOKAHEAD];
        Self {
            reader,
            name,
            buffer,
            start: 0,
            filled: 0,
            end_of_file: false,
            framer: Framer::new(),
            bytes: 0,
            side: None,
            due: Some(Instant::ZERO),
        }
    }

    /// Bytes read so far: the size of the log once it ended.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// How the log's side file is laid out, if it has one.
    #[must_use]
    pub fn side_layout(&self) -> Option<Layout> {
        self.side.as_ref().map(SideFile::layout)
    }

    /// What the checksums of the side file said so far; `None` without a side file that has them.
    #[must_use]
    pub fn checks(&self) -> Option<Checks> {
        self.side.as_ref().and_then(SideFile::checks)
    }

    /// The name given at the start.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    fn fill(&mut self) -> Result<(), Error> {
        self.buffer.copy_within(self.start..self.filled, 0);
        self.filled -= self.start;
        self.start = 0;
        loop {
            match self.reader.read(&mut self.buffer[self.filled..]) {
                Ok(0) => self.end_of_file = true,
                Ok(read) => {
                    self.filled += read;
                    self.bytes += read as u64;
                }
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
                Err(source) => {
                    let what = format!("reading {} at byte {}", self.name, self.bytes);
                    return Err(Error::Io { what, source });
                }
            }
            return Ok(());
        }
    }
}

impl<R: Read> CsiSource for Replay<R> {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        self.due = Some(now);
        let (offset, code, said, from, to) = loop {
            let front = &self.buffer[self.start..self.filled];
            match self.framer.step(front, self.end_of_file) {
                Step::Record { offset, used, record } => {
                    let said = self.side.as_mut().map_or(Said::NOTHING, |side| side.take(front.split_at(used).0));
                    let to = self.start + used;
                    let from = to - record.body.len();
                    self.start = to;
                    if !said.is_right {
                        return Ok(Next::Lost(Loss::Bytes { offset, len: used as u64, reason: Reason::Checksum }));
                    }
                    break (offset, record.code, said, from, to);
                }
                Step::Incomplete => self.fill()?,
                Step::Bad { offset, skipped, reason } => {
                    self.start += skipped;
                    self.side.iter_mut().for_each(SideFile::skip);
                    return Ok(Next::Lost(Loss::Bytes { offset, len: skipped as u64, reason }));
                }
                Step::End(tail) => {
                    self.due = None;
                    self.side.iter_mut().for_each(SideFile::end);
                    return Ok(Next::End(tail));
                }
            }
        };
        let stamps = Stamps { at: now, host_us: said.host_us, origin: Origin::File { offset } };
        Ok(Next::Record(stamps, Record { code, body: &self.buffer[from..to] }))
    }

    fn next_at(&self) -> Option<Instant> {
        self.due
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use driver_iface::bfee::{Iq, Repr};
    use driver_iface::record::{Tail, code};

    /// Five records with noise before and between: each is found, every byte is accounted for, time is the caller's.
    #[test]
    fn noise_is_counted_to_the_byte_and_costs_no_record() {
        let repr = Repr::default();
        let mut body = vec![0; repr.body_len()];
        repr.emit(&vec![Iq { i: 3, q: -4 }; repr.samples()], &mut body).unwrap();
        let whole = Record { code: code::BFEE, body: &body };
        let mut record = vec![0; whole.emit_len()];
        whole.emit(&mut record).unwrap();
        let noise = [0xff; 7];
        let log = [&noise[..], &record.repeat(3), &noise, &record.repeat(2)].concat();
        let mut replay = Replay::new(&log[..], "two.dat".into());
        assert_eq!(replay.name(), "two.dat");
        let (mut records, mut lost, mut now) = (0, 0, Instant::ZERO);
        loop {
            now += crate::time::Span::from_ms(1);
            match replay.receive(now).unwrap() {
                Next::Record(stamps, record) => {
                    assert_eq!((stamps.at, record.body), (now, &body[..]));
                    records += 1;
                }
                Next::Lost(Loss::Bytes { len, .. }) => lost += len,
                Next::End(tail) => break assert_eq!(tail, Tail::Clean),
                other => panic!("{other:?}"),
            }
            assert_eq!(replay.next_at(), Some(now), "the next record is there");
        }
        assert_eq!((records, lost, replay.bytes()), (5, 14, log.len() as u64));
        assert_eq!(replay.next_at(), None, "nothing comes after the end");
    }
}
