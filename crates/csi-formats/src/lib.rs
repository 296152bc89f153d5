//! Reads CSI logs of cards other than the Intel 5300 as frames of one type.
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
//! | [`feitcsi`] | Intel AX200, AX210 | records of a 272-byte head and CSI, one per UDP datagram or one after the other |
//! | [`picoscenes`] | Intel 5300, AX200, AX210, QCA9300 | frames of named segments |
//! | [`nexmon`] | Broadcom 4339, 43455c0, 4358, 4366c0 | UDP datagrams in a pcap |
//! | [`esp32`] | ESP32 (two tools) | lines of text |
//! | [`atheros`] | QCA9300 | records preceded by their length, in the byte order of the logger's machine |
//!
//! A log is recognised by its content ([`detect`]). What a format does not contain is absent from a [`Frame`], never 0: an
//! ESP32 has no host time unless its clock was set, a FeitCSI record has no frame number. Unreadable bytes become an
//! [`Item::Skipped`] with offset and reason; reading continues at the next consistent record.
//!
//! Nothing here does I/O, and no input causes a panic.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

extern crate alloc;
#[cfg(test)]
extern crate std;

pub mod atheros;
pub mod esp32;
pub mod feitcsi;
pub mod nexmon;
pub mod picoscenes;

use alloc::vec::Vec;
use core::fmt;

/// The card that measured a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Card {
    /// Intel AX200 or AX210.
    Ax2xx,
    /// Intel 5300.
    Intel5300,
    /// Qualcomm Atheros QCA9300.
    Qca9300,
    /// Broadcom, with the chip's number.
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
    /// Its name in the standard.
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
    /// Ticks since an unknown moment.
    pub ticks: u64,
    /// Length of a tick, picoseconds.
    pub tick_ps: u32,
    /// Bits of the counter before it wraps.
    pub bits: u8,
}

impl Clock {
    const fn us(ticks: u64, bits: u8) -> Self {
        Self { ticks, tick_ps: 1_000_000, bits }
    }
}

/// Unit of [`Frame::rssi`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RssiUnit {
    /// dBm.
    Dbm,
    /// dB above an unknown reference.
    Db,
}

/// The subcarriers of a frame that carry a signal, by index relative to the channel centre.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tones {
    /// In rising order.
    pub subcarriers: Vec<i16>,
    /// Which of them carry data rather than a pilot.
    pub data: Vec<bool>,
}

/// Ranges of indices above the centre, both ends included, and their pilots; the lower half mirrors them.
type Upper = (&'static [(i16, i16)], &'static [i16]);

/// 802.11-2016 17.3.5.10 (legacy), 19.3.11.10 (HT), 21.3.10.10 (VHT); 802.11ax 27.3.12.13 (HE, one user on the whole width).
const fn upper(kind: Kind, width_mhz: u16) -> Option<Upper> {
    Some(match (kind, width_mhz) {
        (Kind::Legacy, 20) => (&[(1, 26)], &[7, 21]),
        (Kind::Ht | Kind::Vht, 20) => (&[(1, 28)], &[7, 21]),
        (Kind::Ht | Kind::Vht, 40) => (&[(2, 58)], &[11, 25, 53]),
        (Kind::Vht, 80) => (&[(2, 122)], &[11, 39, 75, 103]),
        (Kind::Vht, 160) => (&[(6, 126), (130, 250)], &[25, 53, 89, 117, 139, 167, 203, 231]),
        (Kind::He, 20) => (&[(2, 122)], &[22, 48, 90, 116]),
        (Kind::He, 40) => (&[(3, 244)], &[10, 36, 78, 104, 144, 170, 212, 238]),
        (Kind::He, 80) => (&[(3, 500)], &[24, 92, 158, 226, 266, 334, 400, 468]),
        (Kind::He, 160) => (
            &[(12, 509), (515, 1012)],
            &[44, 112, 178, 246, 286, 354, 420, 488, 536, 604, 670, 738, 778, 846, 912, 980],
        ),
        _ => return None,
    })
}

impl Tones {
    /// Those of a kind and width; `None` for a width that the kind does not have.
    #[must_use]
    pub fn of(kind: Kind, width_mhz: u16) -> Option<Self> {
        let (ranges, pilots) = upper(kind, width_mhz)?;
        let above = || ranges.iter().flat_map(|(from, to)| *from..=*to);
        let below: Vec<i16> = above().map(|index| -index).collect();
        let subcarriers: Vec<i16> = below.into_iter().rev().chain(above()).collect();
        let data = subcarriers.iter().map(|index| !pilots.contains(&index.abs())).collect();
        Some(Self { subcarriers, data })
    }
}

/// The 30 that a 5300 reports: grouped by 2 at 20 MHz, by 4 at 40 MHz (802.11n-2009 7.3.1.28).
fn of_5300(width_mhz: u16) -> Option<Vec<i16>> {
    let above = |index: i16| match width_mhz {
        20 => Some(if index < 14 { 2 * index + 1 } else { 28 }),
        40 => Some(4 * index + 2),
        _ => None,
    };
    let below = |index: i16| if width_mhz == 20 { [1, 2 * index].into_iter().max() } else { Some(4 * index + 2) };
    let lower = (0..15).rev().map(|index| below(index).map(|index| -index));
    lower.chain((0..15).map(above)).collect()
}

/// One received frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Offset of its record in the log, bytes.
    pub offset: u64,
    /// The card that measured it.
    pub card: Card,
    /// The card's clock at reception: the finest one, if there are several.
    pub clock: Option<Clock>,
    /// A coarser clock of the card, which wraps later.
    pub slow_clock: Option<Clock>,
    /// Host time, microseconds since the Unix epoch.
    pub host_us: Option<i64>,
    /// Address 2 of the frame.
    pub sender: Option<[u8; 6]>,
    /// Sequence number of the 802.11 frame, 0 to 4095, if the format contains it.
    pub sequence: Option<u16>,
    /// Centre of the channel, MHz.
    pub centre_mhz: Option<u16>,
    /// Width of the frame, MHz.
    pub width_mhz: u16,
    /// From its preamble; `None` if the format does not contain it.
    pub kind: Option<Kind>,
    /// Receive chains in `csi`.
    pub n_rx: usize,
    /// Transmit chains or streams in `csi`.
    pub n_tx: usize,
    /// First receive chain of `csi`: not 0 where a format has one record per chain.
    pub first_rx: u8,
    /// First stream of `csi`.
    pub first_tx: u8,
    /// The antenna of each chain of a 5300, packed as the card does.
    pub antenna_sel: Option<u8>,
    /// Index of each subcarrier relative to the channel centre, in units of its spacing (312.5 kHz; 78.125 kHz for HE).
    pub subcarriers: Vec<i16>,
    /// Which subcarriers the card measured: not an AX2xx's pilots, not the centre, nothing outside the frame's own.
    pub measured: Vec<bool>,
    /// CSI `[rx][tx][subcarrier]`, subcarrier fastest, real and imaginary part in units of the card.
    pub csi: Vec<[f32; 2]>,
    /// Signal strength by receive chain; `None` if the card does not report it.
    pub rssi: Vec<Option<i16>>,
    /// Unit of `rssi`.
    pub rssi_unit: RssiUnit,
}

impl Frame {
    /// A frame of one chain of which nothing else is known.
    const fn of(card: Card, rssi_unit: RssiUnit) -> Self {
        Self {
            offset: 0,
            card,
            clock: None,
            slow_clock: None,
            host_us: None,
            sender: None,
            sequence: None,
            centre_mhz: None,
            width_mhz: 0,
            kind: None,
            n_rx: 1,
            n_tx: 1,
            first_rx: 0,
            first_tx: 0,
            antenna_sel: None,
            subcarriers: Vec::new(),
            measured: Vec::new(),
            csi: Vec::new(),
            rssi: Vec::new(),
            rssi_unit,
        }
    }

    /// CSI of one pair of chains, in the order of [`Frame::subcarriers`]; `None` if there is no such pair.
    #[must_use]
    pub fn column(&self, rx: usize, tx: usize) -> Option<&[[f32; 2]]> {
        let n = self.subcarriers.len();
        let at = rx.checked_mul(self.n_tx)?.checked_add(tx).filter(|_| tx < self.n_tx)?.checked_mul(n)?;
        self.csi.get(at..at.checked_add(n)?)
    }

    /// Subcarrier spacing, Hz.
    #[must_use]
    pub fn spacing_hz(&self) -> f64 {
        if self.kind == Some(Kind::He) { 78_125.0 } else { 312_500.0 }
    }
}

/// Why bytes are not a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Why {
    /// Their fields are inconsistent: damage, or other data.
    Damaged,
    /// The log ends inside them.
    Cut,
    /// A frame without CSI, or a packet of something else.
    NoCsi,
    /// A version of a segment that only PicoScenes' own library reads: newer ones may be compressed.
    Version {
        /// The segment's version.
        got: u16,
    },
    /// A device or chip whose CSI has an unknown form.
    Device {
        /// Its number in the format.
        got: u16,
    },
    /// A number of subcarriers that the frame's kind and width do not allow.
    Subcarriers {
        /// As read.
        got: u32,
    },
}

impl fmt::Display for Why {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Damaged => write!(f, "not a record, or a damaged one"),
            Self::Cut => write!(f, "the log ends inside a record"),
            Self::NoCsi => write!(f, "no CSI in it"),
            Self::Version { got } => {
                write!(f, "a CSI segment of version {got}: export it with PicoScenes, whose library alone reads it")
            }
            Self::Device { got } => write!(f, "CSI of unsupported device {got:#06x}"),
            Self::Subcarriers { got } => write!(f, "{got} subcarriers, which no frame of its kind and width has"),
        }
    }
}

/// Bytes that are not a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Skipped {
    /// Their offset in the log.
    pub offset: u64,
    /// Their number.
    pub len: u64,
    /// Why.
    pub why: Why,
}

/// One item of a log.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // most items are frames
pub enum Item {
    /// A frame with its CSI.
    Frame(Frame),
    /// Bytes that are not a frame.
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
    /// Its name for people.
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

/// Bytes from the start of a log that [`detect`] needs.
pub const DETECT: usize = 64 * 1024;

/// The kind of log that starts with these bytes; `None` for any other file, including a csitool log.
///
/// Strict formats are tried first: a magic number, then text, then records that must be consistent.
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

/// All items of a log in order; `None` if its kind is not supported.
#[must_use]
pub fn items(bytes: &[u8]) -> Option<Items<'_>> {
    detect(bytes).map(|format| Items::new(format, bytes))
}

/// Items of a log, in order. Every byte belongs to one item, except the headers of a pcap and of a table.
#[derive(Clone, Debug)]
pub struct Items<'a> {
    format: Format,
    bytes: &'a [u8],
    at: usize,
    columns: Option<esp32::Columns>,
}

impl<'a> Items<'a> {
    /// For a log of known format.
    #[must_use]
    pub fn new(format: Format, bytes: &'a [u8]) -> Self {
        let at = if format == Format::Nexmon { nexmon::HEAD.min(bytes.len()) } else { 0 };
        Self { format, bytes, at, columns: None }
    }

    /// The log's format.
    #[must_use]
    pub fn format(&self) -> Format {
        self.format
    }
}

/// The item at the front of some bytes, and its length.
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

/// Number of damaged bytes to skip: at least one, up to the next possible start of a record or the end.
fn to_next(front: &[u8], is_record: impl Fn(&[u8]) -> bool) -> usize {
    (1..front.len()).find(|at| front.get(*at..).is_some_and(&is_record)).unwrap_or(front.len())
}

/// A record whose end is missing: the log is cut or, if another record begins inside, the length is damaged.
fn no_end(front: &[u8], is_record: impl Fn(&[u8]) -> bool) -> Front {
    let next = to_next(front, is_record);
    (Err(if next == front.len() { Why::Cut } else { Why::Damaged }), next)
}

/// The sequence number of an 802.11 frame.
fn sequence(mpdu: &[u8]) -> Option<u16> {
    u16_at(mpdu, 22).map(|control| control >> 4)
}

/// The `N` bytes at an offset.
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

/// Reads numbers of a few bits each, lowest bit first, as the 5300 and the QCA9300 pack their samples.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Bits<'a> {
    const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    const fn skip(&mut self, bits: usize) {
        self.at += bits;
    }

    /// The next `bits` (at most 16) as a two's complement number; `None` past the end.
    fn signed(&mut self, bits: usize) -> Option<i16> {
        let mut word = 0_u32;
        for k in 0..3 {
            word |= u32::from(self.bytes.get(self.at / 8 + k).copied().unwrap_or(0)) << (8 * k);
        }
        let at = self.at;
        self.at += bits;
        let value = (word >> (at % 8)) << (32 - bits);
        (self.at <= 8 * self.bytes.len()).then_some((value.cast_signed() >> (32 - bits)) as i16)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positions of the pilots in a record, from CSIKit's list of interpolated subcarriers.
    #[test]
    fn pilots_match_csikits_list() {
        for (kind, width, n, first) in [
            (Kind::Ht, 20, 56, &[7, 21, 34, 48][..]),
            (Kind::Ht, 40, 114, &[5, 33, 47, 66, 80, 108]),
            (Kind::Vht, 80, 242, &[19, 47, 83, 111, 130, 158, 194, 222]),
            (Kind::Vht, 160, 484, &[19, 47, 83, 111, 130, 158, 194, 222, 261, 289, 325, 353, 372, 400, 436, 464]),
            (Kind::He, 20, 242, &[6, 32, 74, 100, 141, 167, 209, 235]),
            (Kind::He, 40, 484, &[6, 32, 74, 100, 140, 166, 208, 234, 249, 275, 317, 343, 383, 409, 451, 477]),
            (Kind::He, 80, 996, &[32, 100, 166, 234, 274, 342, 408, 476, 519, 587, 653, 721, 761, 829, 895, 963]),
            (
                Kind::He,
                160,
                1992,
                &[32, 100, 166, 234, 274, 342, 408, 476, 519, 587, 653, 721, 761, 829, 895, 963, 1028],
            ),
        ] {
            let tones = Tones::of(kind, width).unwrap();
            let pilots: Vec<usize> = (0..n).filter(|k| !tones.data[*k]).collect();
            assert_eq!(tones.subcarriers.len(), n, "{kind:?} {width}");
            assert_eq!(&pilots[..first.len()], first, "{kind:?} {width}");
        }
        assert_eq!(Tones::of(Kind::Ht, 80), None);
    }

    #[test]
    fn a_5300_reports_the_groups_of_the_standard() {
        let lower: Vec<i16> = of_5300(20).unwrap().into_iter().take(16).collect();
        assert_eq!(lower, [-28, -26, -24, -22, -20, -18, -16, -14, -12, -10, -8, -6, -4, -2, -1, 1]);
        assert_eq!(of_5300(20).unwrap()[28..], [27, 28]);
        let wide = of_5300(40).unwrap();
        assert_eq!((wide[0], wide[14], wide[15], wide[29]), (-58, -2, 2, 58));
        assert_eq!(of_5300(80), None);
    }

    #[test]
    fn numbers_come_lowest_bit_first_and_end_with_the_bytes() {
        // 3 bits unused, then -1 of 8 bits, then 2 of 10 bits: 0b0000000010_11111111_000.
        let mut bits = Bits::new(&[0b1111_1000, 0b0001_0111, 0b0000_0000]);
        bits.skip(3);
        assert_eq!((bits.signed(8), bits.signed(10)), (Some(-1), Some(2)));
        assert_eq!((bits.signed(3), bits.signed(1)), (Some(0), None));
    }
}
