//! A recorded `.dat` log, read in chunks, never loaded: as a [`CsiSource`] at once ([`Replay`]) or at the pace at which it was
//! recorded ([`Paced`]). Most readers need no more than a [`Log`](crate::Log).

use super::other_card::{Translated, is_other};
use super::side_file::{Checks, Said, SideFile};
use super::{CsiSource, Error, Loss, Next, Origin, Stamps};
use crate::time::{Instant, Span, Unwrap32};
use driver_iface::bfee::Bfee;
use driver_iface::record::{Framer, LOOKAHEAD, Reason, Record, Step, Tail, code};
use driver_iface::side_file::Layout;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Bytes read at a time: large enough for few calls; each new page of it costs as much as decoding its records.
const CHUNK: usize = 64 * 1024;

/// Plays back a log as fast as it is read. Memory is one buffer, for any size of log.
pub struct Replay<R> {
    bytes: Bytes<R>,
    framing: Framing,
    /// The time of the last call: the next record is due by then. None once the log has ended.
    due: Option<Instant>,
}

/// The bytes of a log, in the order in which they are used: half of a [`Replay`].
#[doc(hidden)]
pub struct Bytes<R> {
    reader: R,
    name: String,
    buffer: Vec<u8>,
    start: usize,
    filled: usize,
    end_of_file: bool,
    read: u64,
}

/// Which bytes of a log are records: the other half of a [`Replay`].
#[doc(hidden)]
pub struct Framing {
    framer: Framer,
    side: Option<SideFile>,
}

/// What stands at the front of the bytes that were not used before.
#[doc(hidden)]
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Front {
    /// A record of `used` bytes, the last `body` of them its body.
    Record {
        /// Bytes to use up.
        used: usize,
        /// Bytes of the body.
        body: usize,
        /// What the record is.
        code: u8,
        /// Bytes of the log before it.
        offset: u64,
        /// When the host received it, microseconds since the Unix epoch.
        host_us: Option<i64>,
    },
    /// No record, or a wrong one.
    Lost {
        /// Bytes to use up.
        used: usize,
        /// What was lost.
        loss: Loss,
    },
    /// More bytes are needed behind those; [`LOOKAHEAD`] of them are always enough.
    Short,
    /// The log's end.
    End(Tail),
}

impl Replay<Box<dyn Read + Send>> {
    /// Opens a log; `-` is standard input. Host times come from its side file (`<log>stp`), if there is one; a record
    /// whose checksum is not the side file's is lost. A log of FeitCSI (AX200, AX210), which is recognised by its first
    /// bytes, is read as one of a 5300: 30 subcarriers of the middle 20 or 40 MHz, 8 bits, no frame numbers.
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
        let mut file = File::open(path).map_err(io)?;
        if is_other(&mut file).map_err(io)? {
            return Ok(Self::new(Box::new(Translated::new(file)), name));
        }
        let mut replay = Self::new(Box::new(file), name);
        replay.framing.side = SideFile::of(path, || Some(Replay::new(File::open(path).ok()?, String::new())));
        Ok(replay)
    }
}

impl<R> Bytes<R> {
    /// The bytes that are there and were not used.
    #[inline]
    fn front(&self) -> &[u8] {
        &self.buffer[self.start..self.filled]
    }
}

impl<R: Read> Bytes<R> {
    /// Makes room in the buffer and reads on.
    fn fill(&mut self) -> Result<(), Error> {
        self.buffer.copy_within(self.start..self.filled, 0);
        self.filled -= self.start;
        self.start = 0;
        let mut buffer = std::mem::take(&mut self.buffer);
        let read = buffer.get_mut(self.filled..).map_or(Ok(0), |room| self.read_on(room));
        self.buffer = buffer;
        self.filled += read?;
        Ok(())
    }

    /// Reads the bytes that come next into other memory than the buffer's, which is emptied first; how many, 0 at the log's
    /// end.
    ///
    /// # Errors
    /// If the reader fails.
    pub fn read_into(&mut self, room: &mut [u8]) -> Result<usize, Error> {
        let left = self.front();
        if left.is_empty() {
            return self.read_on(room);
        }
        let count = left.len().min(room.len());
        room.iter_mut().zip(left).for_each(|(to, from)| *to = *from);
        self.start += count;
        Ok(count)
    }

    fn read_on(&mut self, room: &mut [u8]) -> Result<usize, Error> {
        loop {
            match self.reader.read(room) {
                Ok(read) => {
                    self.end_of_file |= read == 0;
                    self.read += read as u64;
                    return Ok(read);
                }
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(source) => {
                    let what = format!("reading {} at byte {}", self.name, self.read);
                    return Err(Error::Io { what, source });
                }
            }
        }
    }
}

impl Framing {
    /// Judges the front of the unused bytes; `end`: no more will follow. Inlined, like [`Framer::step`].
    #[inline(always)]
    pub fn step(&mut self, front: &[u8], end: bool) -> Front {
        match self.framer.step(front, end) {
            Step::Record { offset, used, record } => {
                let said = self.side.as_mut().map_or(Said::NOTHING, |side| side.take(front.split_at(used).0));
                if said.is_right {
                    let Record { code, body } = record;
                    return Front::Record { used, body: body.len(), code, offset, host_us: said.host_us };
                }
                let loss = Loss::Bytes { offset, len: used as u64, reason: Reason::Checksum };
                Front::Lost { used, loss }
            }
            Step::Incomplete => Front::Short,
            Step::Bad { offset, skipped, reason } => {
                self.side.iter_mut().for_each(SideFile::skip);
                Front::Lost { used: skipped, loss: Loss::Bytes { offset, len: skipped as u64, reason } }
            }
            Step::End(tail) => {
                self.side.iter_mut().for_each(SideFile::end);
                Front::End(tail)
            }
        }
    }
}

impl<R: Read> Replay<R> {
    /// Replays what `reader` gives; `name` is for messages.
    pub fn new(reader: R, name: String) -> Self {
        let buffer = vec![0; CHUNK + LOOKAHEAD];
        let bytes = Bytes { reader, name, buffer, start: 0, filled: 0, end_of_file: false, read: 0 };
        Self { bytes, framing: Framing { framer: Framer::new(), side: None }, due: Some(Instant::ZERO) }
    }

    /// Its halves, for who reads bytes and frames records in different threads, to the log's end: nothing is received
    /// afterwards.
    #[doc(hidden)]
    pub fn halves(&mut self) -> (&mut Bytes<R>, &mut Framing) {
        self.due = None;
        (&mut self.bytes, &mut self.framing)
    }

    /// Bytes read so far: the size of the log once it ended.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes.read
    }

    /// How the log's side file is laid out, if it has one.
    #[doc(hidden)] // for the crates of this workspace
    #[must_use]
    pub fn side_layout(&self) -> Option<Layout> {
        self.framing.side.as_ref().map(|side| side.layout)
    }

    /// The results of the side file's checksums so far; `None` without checksums.
    #[doc(hidden)] // for the crates of this workspace
    #[must_use]
    pub fn checks(&self) -> Option<Checks> {
        self.framing.side.as_ref().and_then(SideFile::checks)
    }

    /// The name given at the start.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.bytes.name
    }
}

impl<R: Read> CsiSource for Replay<R> {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        self.due = Some(now);
        loop {
            let bytes = &mut self.bytes;
            match self.framing.step(bytes.front(), bytes.end_of_file) {
                Front::Record { used, body, code, offset, host_us } => {
                    bytes.start += used;
                    let stamps = Stamps { at: now, host_us, origin: Origin::File { offset } };
                    let body = &self.bytes.buffer[self.bytes.start - body..self.bytes.start];
                    return Ok(Next::Record(stamps, Record { code, body }));
                }
                Front::Lost { used, loss } => {
                    bytes.start += used;
                    return Ok(Next::Lost(loss));
                }
                Front::Short => bytes.fill()?,
                Front::End(tail) => {
                    self.due = None;
                    return Ok(Next::End(tail));
                }
            }
        }
    }

    fn next_at(&self) -> Option<Instant> {
        self.due
    }
}

/// Gives each record of `S` when it is due by the card's clock (`timestamp_low`).
///
/// Records without a clock of their own (MPDUs come just before their bfee) are due with the record before them. A clock
/// that steps back, as after a reload of the driver, costs no time.
#[doc(hidden)]
pub struct Paced<S> {
    source: S,
    speed: f64,
    longest: Option<Span>,
    clock: Unwrap32,
    last_card_us: Option<i64>,
    due: Option<Instant>,
    held: Held,
    /// The time of the last call.
    asked: Instant,
    body: Vec<u8>,
}

/// Records read ahead that wait for their time.
enum Held {
    Nothing,
    Record(Stamps, u8),
    Lost(Loss),
    End(Tail),
}

impl<S: CsiSource> Paced<S> {
    /// Plays `source` at `speed` times its own pace (above 0; infinity for no waiting), shortening pauses to `longest`
    /// of the player's time.
    pub fn new(source: S, speed: f64, longest: Option<Span>) -> Self {
        Self {
            source,
            speed,
            longest,
            clock: Unwrap32::default(),
            last_card_us: None,
            due: None,
            held: Held::Nothing,
            asked: Instant::ZERO,
            body: Vec::new(),
        }
    }

    /// The same, its first record due at `at`.
    #[must_use]
    pub fn beginning(self, at: Instant) -> Self {
        Self { due: Some(at), ..self }
    }

    /// The log being played.
    pub fn source(&self) -> &S {
        &self.source
    }

    fn read_ahead(&mut self, now: Instant) -> Result<(), Error> {
        let (held, clock) = match self.source.receive(now)? {
            Next::Record(stamps, record) => {
                self.body.clear();
                self.body.extend_from_slice(record.body);
                let bfee = (record.code == code::BFEE).then(|| Bfee::new_checked(record.body).ok()).flatten();
                (Held::Record(stamps, record.code), bfee.map(|bfee| bfee.timestamp_low()))
            }
            Next::Lost(loss) => (Held::Lost(loss), None),
            Next::End(tail) => (Held::End(tail), None),
            Next::Pending => (Held::Nothing, None),
        };
        self.held = held;
        let Some(raw) = clock else { return Ok(()) };
        let card_us = self.clock.next(raw);
        let step_us = self.last_card_us.map_or(0, |last| card_us - last).max(0);
        self.last_card_us = Some(card_us);
        let wait = Span::from_s(step_us as f64 * 1e-6 / self.speed);
        let wait = self.longest.map_or(wait, |longest| wait.min(longest));
        self.due = Some(self.due.unwrap_or(now) + wait);
        Ok(())
    }
}

impl<S: CsiSource> CsiSource for Paced<S> {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        self.asked = now;
        if matches!(self.held, Held::Nothing) {
            self.read_ahead(now)?;
        }
        if self.due.is_some_and(|due| due > now) {
            return Ok(Next::Pending);
        }
        Ok(match std::mem::replace(&mut self.held, Held::Nothing) {
            Held::Nothing => Next::Pending,
            Held::Record(stamps, code) => Next::Record(Stamps { at: now, ..stamps }, Record { code, body: &self.body }),
            Held::Lost(loss) => Next::Lost(loss),
            Held::End(tail) => {
                self.held = Held::End(tail);
                Next::End(tail)
            }
        })
    }

    fn next_at(&self) -> Option<Instant> {
        match self.held {
            Held::Nothing => self.source.next_at(),
            _ => Some(self.due.unwrap_or(self.asked)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::side_file::tests::bytes_of;
    use driver_iface::bfee::{self, Iq, Repr, csi_len};
    use driver_iface::side_file::{Check, Entry};

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

    #[test]
    fn what_was_not_received_is_read_whole_and_in_order() {
        let log: Vec<u8> = (1..=200_u8).flat_map(|dbm| [0, 5, code::NOISE, dbm, 0xff, 0xff, 0xff]).collect();
        for (received, room) in [(0, 5), (1, 5), (1, 10_000), (3, 7)] {
            let mut replay = Replay::new(&log[..], "two.dat".into());
            (0..received).for_each(|_| assert!(matches!(replay.receive(Instant::ZERO), Ok(Next::Record(..)))));
            let (bytes, _) = replay.halves();
            let (mut read, mut room) = (Vec::new(), vec![0; room]);
            loop {
                match bytes.read_into(&mut room).unwrap() {
                    0 => break,
                    count => read.extend_from_slice(&room[..count]),
                }
                assert!(read.len() <= log.len(), "it goes on");
            }
            assert!(read == log[7 * received..], "{received} received");
            assert_eq!(replay.next_at(), None);
        }
    }

    #[test]
    fn a_log_says_what_its_side_file_is_and_what_that_said() {
        let folder = std::env::temp_dir().join(format!("csi5300-replay-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let records: Vec<[u8; 7]> = (1..=3).map(|dbm| [0, 5, code::NOISE, dbm, 0xff, 0xff, 0xff]).collect();
        let log = folder.join("out.dat");
        std::fs::write(&log, records.concat()).unwrap();
        let replayed = || {
            let mut replay = Replay::open(&log).unwrap();
            while !matches!(replay.receive(Instant::ZERO).unwrap(), Next::End(_)) {}
            (replay.side_layout(), replay.checks().map(|checks| checks.good))
        };
        assert_eq!(replayed(), (None, None), "there is none");
        for (layout, good) in [(Layout::Narrow, None), (Layout::Wide, None), (Layout::Checked, Some(3))] {
            let entry = |(record, host_us): (&[u8; 7], i64)| Entry {
                host_us: Some(host_us),
                check: (layout == Layout::Checked).then(|| Check::of(record)),
            };
            let entries: Vec<Entry> = records.iter().zip(1_700_000_000_000_000..).map(entry).collect();
            std::fs::write(folder.join("out.datstp"), bytes_of(layout, &entries)).unwrap();
            assert_eq!(replayed(), (Some(layout), good));
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    /// A reader that is interrupted before each read, and fails at the end.
    struct Interrupted<'a>(&'a [u8], bool);

    impl Read for Interrupted<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
            self.1 = !self.1;
            if self.1 {
                return Err(std::io::ErrorKind::Interrupted.into());
            }
            match self.0.read(buffer)? {
                0 => Err(std::io::ErrorKind::ConnectionReset.into()),
                read => Ok(read),
            }
        }
    }

    #[test]
    fn an_interrupted_read_is_repeated_and_another_failure_is_said_with_its_place() {
        // Noise, -92 dBm.
        let record = [0, 5, code::NOISE, 0xa4, 0xff, 0xff, 0xff];
        let log = record.repeat(4);
        let mut replay = Replay::new(Interrupted(&log, false), "two.dat".into());
        let mut records = 0;
        let failed = loop {
            match replay.receive(Instant::ZERO) {
                Ok(Next::Record(_, record)) => records += usize::from(record.code == code::NOISE),
                Ok(other) => panic!("{other:?}"),
                Err(error) => break error,
            }
        };
        assert!((3..=4).contains(&records), "{records}");
        let Error::Io { what, source } = failed else { panic!("{failed}") };
        assert_eq!((what.as_str(), source.kind()), ("reading two.dat at byte 28", std::io::ErrorKind::ConnectionReset));
    }

    fn log(clocks_us: &[u32]) -> Vec<u8> {
        let mut log = Vec::new();
        for clock in clocks_us {
            let mut body = vec![0; bfee::STOCK_HEADER + csi_len(1, 1)];
            body[..4].copy_from_slice(&clock.to_le_bytes());
            body[bfee::offset::N_RX] = 1;
            body[bfee::offset::N_TX] = 1;
            body[bfee::offset::LEN] = csi_len(1, 1) as u8;
            let record = Record { code: code::BFEE, body: &body };
            let from = log.len();
            log.resize(from + record.emit_len(), 0);
            record.emit(&mut log[from..]).unwrap();
        }
        log
    }

    fn times(clocks_us: &[u32], speed: f64, longest: Option<Span>) -> Vec<i64> {
        let bytes = log(clocks_us);
        let mut paced = Paced::new(Replay::new(bytes.as_slice(), "test".into()), speed, longest);
        let (mut now, mut times) = (Instant::from_us(500), Vec::new());
        loop {
            match paced.receive(now).unwrap() {
                Next::Record(stamps, _) => times.push(stamps.at.as_us()),
                Next::Pending => {
                    let at = paced.next_at().unwrap();
                    assert!(at > now, "waiting for nothing");
                    now = at;
                }
                Next::End(_) => return times,
                Next::Lost(loss) => panic!("{loss:?}"),
            }
        }
    }

    #[test]
    fn records_come_at_the_cards_pace() {
        let clocks = [u32::MAX - 999, 1_000, 3_000, 2_500, 12_500];
        assert_eq!(times(&clocks, 1.0, None), [500, 2_500, 4_500, 4_500, 14_500]);
        assert_eq!(times(&clocks, 2.0, None), [500, 1_500, 2_500, 2_500, 7_500]);
        assert_eq!(times(&clocks, 1.0, Some(Span::from_ms(3))), [500, 2_500, 4_500, 4_500, 7_500]);
        assert_eq!(times(&clocks, f64::INFINITY, None), [500; 5]);
    }

    #[test]
    fn a_log_may_begin_later() {
        let bytes = log(&[7, 1_007]);
        let begin = Instant::from_us(9_000);
        let mut paced = Paced::new(Replay::new(bytes.as_slice(), "test".into()), 1.0, None).beginning(begin);
        assert!(matches!(paced.receive(Instant::ZERO), Ok(Next::Pending)));
        assert_eq!(paced.next_at(), Some(begin));
        assert!(matches!(paced.receive(begin), Ok(Next::Record(..))));
        assert!(matches!(paced.receive(begin), Ok(Next::Pending)));
        assert_eq!(paced.next_at(), Some(Instant::from_us(10_000)));
    }
}
