//! CSI logs of cards other than the Intel 5300, read into one kind of frame.
//!
//! ```
//! # let bytes: &[u8] = &[];
//! for item in csi_formats::items(bytes).into_iter().flatten() {
//!     match item {
//!         csi_formats::Item::Frame(frame) => println!("{:?} {}x{}", frame.sender, frame.n_rx, frame.n_tx),
//!         csi_formats::Item::Skipped(skipped) => println!("{} bytes at {}: {}", skipped.len, skipped.offset, skipped.why),
//!     }
//! }
//! ```
//!
//! | module | card | bytes |
//! |---|---|---|
//! | [`feitcsi`] | Intel AX200, AX210 | records of a 272-byte head and CSI; one a UDP datagram, or one after the other |
//! | [`picoscenes`] | Intel 5300, AX200, AX210, QCA9300 | frames of named segments |
//! | [`nexmon`] | Broadcom 4339, 43455c0, 4358, 4366c0 | UDP datagrams in a pcap |
//! | [`esp32`] | ESP32 of both tools | lines of text |
//! | [`atheros`] | QCA9300 | records with a length before them, in the byte order of the logger's machine |
//!
//! A log is recognised by its content ([`detect`]). What a format does not say is absent from a [`Frame`], never 0: an
//! ESP32 has no host time unless somebody set it, a FeitCSI record has no frame number. What cannot be read is an
//! [`Item::Skipped`] with its place and reason; reading goes on at the next record that agrees with itself.
//!
//! Nothing here does I/O or panics on any bytes.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

extern crate alloc;
#[cfg(test)]
extern crate std;

pub mod atheros;
mod bits;
pub mod esp32;
pub mod feitcsi;
pub mod nexmon;
pub mod picoscenes;
mod tones;

use alloc::vec::Vec;
use core::fmt;

pub use tones::Tones;

/// The card that measured a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Card {
    /// Intel AX200 or AX210.
    Ax2xx,
    /// Intel 5300.
    Intel5300,
    /// Qualcomm Atheros QCA9300.
    Qca9300,
    /// Broadcom, by the number of the chip.
    Broadcom(&'static str),
    /// Espressif ESP32.
    Esp32,
}

impl fmt::Display for Card {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ax2xx => write!(f, "Intel AX200 or AX210"),
            Self::Intel5300 => write!(f, "Intel 5300"),
            Self::Qca9300 => write!(f, "Atheros QCA9300"),
            Self::Broadcom(chip) => write!(f, "Broadcom {chip}"),
            Self::Esp32 => write!(f, "ESP32"),
        }
    }
}

/// The kind of an 802.11 frame, by its preamble.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// 802.11a or g.
    Legacy,
    /// 802.11n.
    Ht,
    /// 802.11ac.
    Vht,
    /// 802.11ax.
    He,
}

impl Kind {
    /// The name that the standard uses.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Legacy => "legacy",
            Self::Ht => "HT",
            Self::Vht => "VHT",
            Self::He => "HE",
        }
    }
}

/// A reading of a card's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clock {
    /// Ticks since some moment that the card does not tell.
    pub ticks: u64,
    /// Length of a tick, picoseconds.
    pub tick_ps: u32,
    /// Bits of the counter, which wraps.
    pub bits: u8,
}

impl Clock {
    const fn us(ticks: u64, bits: u8) -> Self {
        Self { ticks, tick_ps: 1_000_000, bits }
    }
}

/// What [`Frame::rssi`] is in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RssiUnit {
    /// dBm.
    Dbm,
    /// dB above a reference that the card does not tell.
    Db,
}

/// One frame that a card heard.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Where its record begins in the log, bytes.
    pub offset: u64,
    /// What measured it.
    pub card: Card,
    /// The card's clock when the frame came: the finest one, if it has several.
    pub clock: Option<Clock>,
    /// A coarser clock of the card that wraps later.
    pub slow_clock: Option<Clock>,
    /// Host time, microseconds since the Unix epoch.
    pub host_us: Option<i64>,
    /// Address 2 of the frame.
    pub sender: Option<[u8; 6]>,
    /// Sequence number of the 802.11 frame, 0 to 4095, where the format tells it.
    pub sequence: Option<u16>,
    /// Centre of the channel, MHz.
    pub centre_mhz: Option<u16>,
    /// Width of the frame, MHz.
    pub width_mhz: u16,
    /// By its preamble; `None` where the format does not tell.
    pub kind: Option<Kind>,
    /// Receive chains in `csi`.
    pub n_rx: usize,
    /// Transmit chains or streams in `csi`.
    pub n_tx: usize,
    /// The chain of the card that `csi` begins with: not 0 where a format has a record for each.
    pub first_rx: u8,
    /// The stream that `csi` begins with.
    pub first_tx: u8,
    /// Which antenna each chain of a 5300 was connected to, packed as the card does.
    pub antenna_sel: Option<u8>,
    /// Each subcarrier's index relative to the channel centre, in units of its spacing (312.5 kHz; 78.125 kHz for HE).
    pub subcarriers: Vec<i16>,
    /// Which of them the card measured: not pilots of an AX2xx, not the centre, nothing outside the frame's own.
    pub measured: Vec<bool>,
    /// CSI `[rx][tx][subcarrier]`, subcarrier fastest, real and imaginary part in units of the card.
    pub csi: Vec<[f32; 2]>,
    /// Strength by receive chain; `None` where the card does not tell.
    pub rssi: Vec<Option<i16>>,
    /// What `rssi` is in.
    pub rssi_unit: RssiUnit,
}

impl Frame {
    /// CSI of one pair of chains, in the order of [`Frame::subcarriers`]; `None` when there is no such pair.
    #[must_use]
    pub fn column(&self, rx: usize, tx: usize) -> Option<&[[f32; 2]]> {
        let n = self.subcarriers.len();
        let at = rx.checked_mul(self.n_tx)?.checked_add(tx).filter(|_| tx < self.n_tx)?.checked_mul(n)?;
        self.csi.get(at..at.checked_add(n)?)
    }

    /// Distance of two neighbouring subcarriers, Hz.
    #[must_use]
    pub fn spacing_hz(&self) -> f64 {
        if self.kind == Some(Kind::He) { 78_125.0 } else { 312_500.0 }
    }
}

/// Why bytes are no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Why {
    /// They contradict themselves: damage, or another kind of data.
    Damaged,
    /// The log ends inside them.
    Cut,
    /// A frame of which the card measured no CSI, or a packet of something else.
    NoCsi,
    /// A version of a segment that only PicoScenes' own library reads: newer ones may be compressed.
    Version {
        /// The segment's version.
        got: u16,
    },
    /// A device or chip whose CSI has another form.
    Device {
        /// Its number in the format.
        got: u16,
    },
    /// A number of subcarriers that the frame's kind and width do not have.
    Subcarriers {
        /// As read.
        got: u32,
    },
}

impl fmt::Display for Why {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Damaged => write!(f, "no record, or a damaged one"),
            Self::Cut => write!(f, "the log ends inside a record"),
            Self::NoCsi => write!(f, "no CSI in it"),
            Self::Version { got } => {
                write!(f, "a CSI segment of version {got}: export it with PicoScenes, whose library alone reads it")
            }
            Self::Device { got } => write!(f, "CSI of device {got:#06x}, which is not read"),
            Self::Subcarriers { got } => write!(f, "{got} subcarriers, which no frame of its kind and width has"),
        }
    }
}

/// Bytes that are no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Skipped {
    /// Where they begin in the log.
    pub offset: u64,
    /// How many.
    pub len: u64,
    /// Why.
    pub why: Why,
}

/// What a log has at one place.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // frames are what there are many of
pub enum Item {
    /// A frame with its CSI.
    Frame(Frame),
    /// Bytes that are none.
    Skipped(Skipped),
}

/// The kinds of logs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Format {
    /// See [`feitcsi`].
    FeitCsi,
    /// See [`picoscenes`].
    PicoScenes,
    /// See [`nexmon`].
    Nexmon,
    /// See [`esp32`].
    Esp32,
    /// See [`atheros`].
    Atheros(Endian),
}

impl Format {
    /// What to call it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::FeitCsi => "FeitCSI",
            Self::PicoScenes => "PicoScenes",
            Self::Nexmon => "nexmon pcap",
            Self::Esp32 => "ESP32 CSV",
            Self::Atheros(Endian::Little) => "Atheros CSI tool",
            Self::Atheros(Endian::Big) => "Atheros CSI tool, big-endian",
        }
    }
}

/// Order of the bytes of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Endian {
    /// Lowest first.
    Little,
    /// Highest first.
    Big,
}

/// Bytes from the beginning of a log with which [`detect`] is sure.
pub const DETECT: usize = 64 * 1024;

/// What kind of log these are the first bytes of; `None` for any other file, a csitool log among them.
///
/// The strictest are asked first: a magic number, then text, then records that agree with themselves.
#[must_use]
pub fn detect(bytes: &[u8]) -> Option<Format> {
    let atheros = |endian| atheros::is_log(bytes, endian).then_some(Format::Atheros(endian));
    if nexmon::is_log(bytes) {
        Some(Format::Nexmon)
    } else if picoscenes::is_log(bytes) {
        Some(Format::PicoScenes)
    } else if esp32::is_log(bytes) {
        Some(Format::Esp32)
    } else if feitcsi::is_log(bytes) {
        Some(Format::FeitCsi)
    } else {
        atheros(Endian::Little).or_else(|| atheros(Endian::Big))
    }
}

/// All items of a log in order; `None` when it is of no kind that is read here.
#[must_use]
pub fn items(bytes: &[u8]) -> Option<Items<'_>> {
    detect(bytes).map(|format| Items::new(format, bytes))
}

/// Items of a log, one after the other. Every byte belongs to one item, but the heads of a pcap and of a table.
#[derive(Clone, Debug)]
pub struct Items<'a> {
    format: Format,
    bytes: &'a [u8],
    at: usize,
    columns: Option<esp32::Columns>,
}

impl<'a> Items<'a> {
    /// Of a log whose format is known.
    #[must_use]
    pub fn new(format: Format, bytes: &'a [u8]) -> Self {
        let at = if format == Format::Nexmon { nexmon::HEAD.min(bytes.len()) } else { 0 };
        Self { format, bytes, at, columns: None }
    }

    /// What kind of log it is.
    #[must_use]
    pub fn format(&self) -> Format {
        self.format
    }
}

/// What the front of some bytes is, and how many of them.
type Front = (Result<Frame, Why>, usize);

impl Iterator for Items<'_> {
    type Item = Item;

    fn next(&mut self) -> Option<Item> {
        loop {
            let front = self.bytes.get(self.at..).filter(|front| !front.is_empty())?;
            let (read, len) = match self.format {
                Format::FeitCsi => feitcsi::front(front),
                Format::PicoScenes => picoscenes::front(front),
                Format::Nexmon => nexmon::front(front, self.bytes),
                Format::Esp32 => match esp32::front(front, &mut self.columns) {
                    (Some(read), len) => (read, len),
                    (None, len) => {
                        self.at += len.max(1);
                        continue;
                    }
                },
                Format::Atheros(endian) => atheros::front(front, endian),
            };
            let (offset, len) = (self.at as u64, len.clamp(1, front.len()));
            self.at += len;
            return Some(match read {
                Ok(frame) => Item::Frame(Frame { offset, ..frame }),
                Err(why) => Item::Skipped(Skipped { offset, len: len as u64, why }),
            });
        }
    }
}

/// Bytes up to the next place at which a record can begin, or all: what is skipped of damage. The first byte always is.
fn to_next(front: &[u8], is_record: impl Fn(&[u8]) -> bool) -> usize {
    (1..front.len()).find(|at| front.get(*at..).is_some_and(&is_record)).unwrap_or(front.len())
}

/// The `N` bytes at a place.
fn array<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk().copied()
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    array(bytes, at).map(u16::from_le_bytes)
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    array(bytes, at).map(u32::from_le_bytes)
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    array(bytes, at).map(u64::from_le_bytes)
}

/// Pairs of i16, real part first, as many as there are.
fn i16_pairs(bytes: &[u8]) -> Vec<[f32; 2]> {
    let (pairs, _) = bytes.as_chunks::<4>();
    pairs.iter().map(|&[a, b, c, d]| [i16::from_le_bytes([a, b]).into(), i16::from_le_bytes([c, d]).into()]).collect()
}
