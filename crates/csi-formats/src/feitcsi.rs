//! FeitCSI: the Intel AX200 and AX210.
//!
//! A record is a head of 272 bytes followed by CSI, all little-endian. The program writes records one after the other to a
//! file or standard output, or each as a UDP datagram. [`front`] reads one record from the front of any of these.
//!
//! | offset | type | |
//! |---|---|---|
//! | 0 | u32 | bytes of CSI |
//! | 8 | u32 | FTM clock, 320 MHz: a tick is 3.125 ns; wraps every 13.4 s |
//! | 12 | u64 | host time, microseconds since the epoch; 0 in old logs |
//! | 46, 47 | u8 | receive, transmit chains |
//! | 52 | u32 | subcarriers |
//! | 60, 64 | u32 | RSSI of the two chains, -dBm |
//! | 68 | 6 bytes | sender |
//! | 88 | u32 | the card's microsecond clock |
//! | 92 | u32 | `rate_n_flags` of version 2: bits 8-10 kind, 11-13 width |
//!
//! CSI is `[rx][tx][subcarrier]` of i16 pairs, real part first. Pilots are not measured: the firmware leaves noise there. Old
//! firmware writes 14 extra subcarriers into the middle of VHT160; they are removed.

use crate::{Card, Clock, Frame, Front, Kind, RssiUnit, Tones, Why, array, i16_pairs, no_end, to_next, u32_at, u64_at};
use alloc::vec::Vec;

/// Bytes of a record before its CSI.
pub const HEAD: usize = 272;
/// Length of a tick of the FTM clock, picoseconds: 1 / 320 MHz.
pub const FTM_TICK_PS: u32 = 3_125;
/// Number and position of the extra subcarriers that old firmware writes in VHT160.
const VHT160_FAULT: core::ops::Range<usize> = 242..256;
/// Antennas A and B, in `rate_n_flags`.
const BOTH_ANTENNAS: u32 = 3 << 14;
/// More chains than any of these cards has.
const MAX_CHAINS: u8 = 4;

/// The head of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Head {
    csi_len: usize,
    ftm: u32,
    host_us: u64,
    n_rx: u8,
    n_tx: u8,
    subcarriers: u32,
    rssi: [u32; 2],
    pub(crate) sender: [u8; 6],
    pub(crate) clock_us: u32,
    rate: u32,
}

impl Head {
    /// The head at the front; `None` if there are too few bytes.
    pub(crate) fn parse(bytes: &[u8]) -> Option<Self> {
        let bytes = bytes.get(..HEAD)?;
        let &[n_rx, n_tx] = bytes.get(46..48)? else { return None };
        Some(Self {
            csi_len: usize::try_from(u32_at(bytes, 0)?).ok()?,
            ftm: u32_at(bytes, 8)?,
            host_us: u64_at(bytes, 12)?,
            n_rx,
            n_tx,
            subcarriers: u32_at(bytes, 52)?,
            rssi: [u32_at(bytes, 60)?, u32_at(bytes, 64)?],
            sender: array(bytes, 68)?,
            clock_us: u32_at(bytes, 88)?,
            rate: u32_at(bytes, 92)?,
        })
    }

    /// Whether its numbers are consistent.
    fn is_consistent(&self) -> bool {
        let chains = 1..=MAX_CHAINS;
        let samples = u64::from(self.n_rx) * u64::from(self.n_tx) * u64::from(self.subcarriers);
        chains.contains(&self.n_rx) && chains.contains(&self.n_tx) && samples > 0 && self.csi_len as u64 == 4 * samples
    }

    /// Kind of the frame, `None` for CCK and for kinds after HE, and its width, MHz.
    pub(crate) fn kind_and_width(&self) -> (Option<Kind>, u16) {
        let kind = match self.rate >> 8 & 7 {
            1 => Some(Kind::Legacy),
            2 => Some(Kind::Ht),
            3 => Some(Kind::Vht),
            4 => Some(Kind::He),
            _ => None,
        };
        (kind, 20 << (self.rate >> 11 & 7).min(4))
    }

    /// The FTM clock, and the one that wraps later.
    pub(crate) fn clocks(&self) -> (Clock, Clock) {
        (Clock { ticks: self.ftm.into(), tick_ps: FTM_TICK_PS, bits: 32 }, Clock::us(self.clock_us.into(), 32))
    }

    /// RSSI of the chains, dBm.
    pub(crate) fn rssi_dbm(&self) -> Vec<Option<i16>> {
        let dbm = |rssi: &u32| i16::try_from(*rssi).ok().filter(|rssi| (1..=127).contains(rssi)).map(|rssi| -rssi);
        self.rssi.iter().take(self.n_rx.into()).map(dbm).collect()
    }
}

/// A record's fields besides its CSI, for writing: those that [`front`] reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Repr {
    /// FTM clock, ticks of 3.125 ns.
    pub ftm: u32,
    /// Host time, microseconds since the epoch; 0 if unknown.
    pub host_us: u64,
    /// Receive chains.
    pub n_rx: u8,
    /// Transmit chains.
    pub n_tx: u8,
    /// Kind of the frame.
    pub kind: Kind,
    /// Its width, 20, 40, 80 or 160 MHz.
    pub width_mhz: u16,
    /// Its modulation and coding scheme.
    pub mcs: u8,
    /// RSSI of the two chains, dBm below 0.
    pub rssi_dbm: [i16; 2],
    /// The frame's sender.
    pub sender: [u8; 6],
    /// The card's microsecond clock.
    pub clock_us: u32,
}

impl Repr {
    /// Appends the record to `out`; `csi` is `[rx][tx][subcarrier]`.
    pub fn emit(&self, csi: &[[i16; 2]], out: &mut Vec<u8>) {
        let chains = (usize::from(self.n_rx) * usize::from(self.n_tx)).max(1);
        let kind = match self.kind {
            Kind::Legacy => 1,
            Kind::Ht => 2,
            Kind::Vht => 3,
            Kind::He => 4,
        };
        let width = u32::from(self.width_mhz / 20).max(1).ilog2();
        let rate = BOTH_ANTENNAS | width << 11 | kind << 8 | u32::from(self.mcs & 15);
        let [a, b] = self.rssi_dbm.map(|dbm| u32::from(dbm.unsigned_abs()));
        let mut head = [0; HEAD];
        let fields: [(usize, &[u8]); 11] = [
            (0, &(4 * csi.len() as u32).to_le_bytes()),
            (8, &self.ftm.to_le_bytes()),
            (12, &self.host_us.to_le_bytes()),
            (46, &[self.n_rx, self.n_tx]),
            (52, &((csi.len() / chains) as u32).to_le_bytes()),
            (60, &a.to_le_bytes()),
            (64, &b.to_le_bytes()),
            (68, &self.sender),
            (88, &self.clock_us.to_le_bytes()),
            (92, &rate.to_le_bytes()),
            // As in the known files.
            (4, &[4]),
        ];
        for (at, field) in fields {
            head.iter_mut().skip(at).zip(field).for_each(|(byte, own)| *byte = *own);
        }
        out.extend_from_slice(&head);
        out.extend(csi.iter().flatten().flat_map(|part| part.to_le_bytes()));
    }
}

/// Whether the first record is consistent and followed by another one or the end.
pub fn is_log(bytes: &[u8]) -> bool {
    let Some(head) = Head::parse(bytes).filter(Head::is_consistent) else { return false };
    let next = bytes.get(HEAD.saturating_add(head.csi_len)..).unwrap_or_default();
    next.is_empty() || Head::parse(next).is_some_and(|head| head.is_consistent())
}

/// The record at the front and its length, or why it is invalid and how many bytes to skip.
pub fn front(bytes: &[u8]) -> Front {
    let is_record = |bytes: &[u8]| Head::parse(bytes).is_some_and(|head| head.is_consistent());
    let Some(head) = Head::parse(bytes) else { return (Err(Why::Cut), bytes.len()) };
    if !head.is_consistent() {
        return (Err(Why::Damaged), to_next(bytes, is_record));
    }
    let len = HEAD.saturating_add(head.csi_len);
    bytes.get(HEAD..len).map_or_else(|| no_end(bytes, is_record), |csi| (frame(&head, csi), len))
}

fn frame(head: &Head, csi: &[u8]) -> Result<Frame, Why> {
    let wrong = Why::Subcarriers { got: head.subcarriers };
    let (kind, width_mhz) = head.kind_and_width();
    let Tones { subcarriers, data } = kind.and_then(|kind| Tones::of(kind, width_mhz)).ok_or(wrong)?;
    let (n, written) = (subcarriers.len(), head.subcarriers as usize);
    let is_faulty = kind == Some(Kind::Vht) && width_mhz == 160 && written == n + VHT160_FAULT.len();
    if written != n && !is_faulty {
        return Err(wrong);
    }
    let (clock, slow_clock) = head.clocks();
    Ok(Frame {
        clock: Some(clock),
        slow_clock: Some(slow_clock),
        host_us: i64::try_from(head.host_us).ok().filter(|us| *us > 0),
        sender: Some(head.sender),
        width_mhz,
        kind,
        n_rx: head.n_rx.into(),
        n_tx: head.n_tx.into(),
        csi: columns(csi, written, is_faulty),
        subcarriers,
        measured: data,
        rssi: head.rssi_dbm(),
        ..Frame::of(Card::Ax2xx, RssiUnit::Dbm)
    })
}

/// The samples, without the extra subcarriers of each column.
fn columns(csi: &[u8], written: usize, is_faulty: bool) -> Vec<[f32; 2]> {
    let mut all = i16_pairs(csi);
    if is_faulty {
        let mut k = 0;
        all.retain(|_| {
            let at = k % written.max(1);
            k += 1;
            !VHT160_FAULT.contains(&at)
        });
    }
    all
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use std::vec;

    /// A record of 2 x 1 chains in which sample `k` of a column is `(k, -1)`.
    pub(crate) fn record(rate: u32, subcarriers: u32) -> Vec<u8> {
        let mut bytes = vec![0; HEAD];
        bytes[..4].copy_from_slice(&(8 * subcarriers).to_le_bytes());
        bytes[8..12].copy_from_slice(&7_u32.to_le_bytes());
        bytes[46..48].copy_from_slice(&[2, 1]);
        bytes[52..56].copy_from_slice(&subcarriers.to_le_bytes());
        bytes[60] = 41;
        bytes[68..74].copy_from_slice(&[2, 0, 0, 0, 0, 9]);
        bytes[88..92].copy_from_slice(&1_000_u32.to_le_bytes());
        bytes[92..96].copy_from_slice(&rate.to_le_bytes());
        for k in (0..subcarriers as i16).chain(0..subcarriers as i16) {
            bytes.extend(k.to_le_bytes().into_iter().chain((-1_i16).to_le_bytes()));
        }
        bytes
    }

    #[test]
    fn a_record_is_read_with_its_own_subcarriers() {
        let (frame, len) = front(&record(0x0200, 56));
        let frame = frame.unwrap();
        assert_eq!((len, frame.kind, frame.width_mhz), (272 + 448, Some(Kind::Ht), 20));
        assert_eq!((frame.n_rx, frame.n_tx, frame.rssi), (2, 1, vec![Some(-41), None]));
        assert_eq!(
            (frame.clock, frame.slow_clock),
            (Some(Clock { ticks: 7, tick_ps: 3_125, bits: 32 }), Some(Clock::us(1_000, 32)))
        );
        assert_eq!((frame.host_us, frame.sender), (None, Some([2, 0, 0, 0, 0, 9])));
        assert_eq!((frame.subcarriers[0], frame.subcarriers[28], frame.measured[7]), (-28, 1, false));
        assert_eq!(front(&record(0x0200, 57)).0, Err(Why::Subcarriers { got: 57 }));
        assert_eq!(front(&record(0x0000, 56)).0, Err(Why::Subcarriers { got: 56 }), "CCK");
    }

    #[test]
    fn a_written_record_is_read_back() {
        for (kind, width_mhz) in [(Kind::Legacy, 20), (Kind::Ht, 40), (Kind::Vht, 80), (Kind::He, 20), (Kind::He, 160)]
        {
            let n = Tones::of(kind, width_mhz).unwrap().subcarriers.len();
            let csi: Vec<[i16; 2]> = (0..2 * n as i16).map(|k| [k, -2 * k]).collect();
            let repr = Repr {
                ftm: 0xdead_beef,
                host_us: 1_700_000_000_000_001,
                n_rx: 2,
                n_tx: 1,
                kind,
                width_mhz,
                mcs: 7,
                rssi_dbm: [-41, -73],
                sender: [2, 3, 4, 5, 6, 7],
                clock_us: 123_456,
            };
            let mut log = vec![1; 3];
            repr.emit(&csi, &mut log);
            let (frame, len) = front(&log[3..]);
            let frame = frame.unwrap();
            assert_eq!((len, frame.kind, frame.width_mhz), (log.len() - 3, Some(kind), width_mhz));
            assert_eq!((frame.n_rx, frame.n_tx, frame.rssi), (2, 1, vec![Some(-41), Some(-73)]));
            assert_eq!((frame.host_us, frame.sender), (Some(1_700_000_000_000_001), Some(repr.sender)));
            assert_eq!(frame.clock, Some(Clock { ticks: 0xdead_beef, tick_ps: 3_125, bits: 32 }));
            assert_eq!(frame.slow_clock, Some(Clock::us(123_456, 32)));
            assert_eq!(frame.csi, csi.iter().map(|iq| iq.map(f32::from)).collect::<Vec<_>>());
        }
    }

    #[test]
    fn the_extra_subcarriers_of_vht160_are_removed() {
        let frame = front(&record(0x0300 | 3 << 11, 498)).0.unwrap();
        assert_eq!((frame.subcarriers.len(), frame.csi.len()), (484, 968));
        let column = frame.column(1, 0).unwrap();
        assert_eq!((column[241], column[242], column[483]), ([241.0, -1.0], [256.0, -1.0], [497.0, -1.0]));
    }

    #[test]
    fn damage_costs_the_record_that_it_is_in() {
        let mut log: Vec<u8> = (0..4).flat_map(|_| record(0x0400, 242)).collect();
        let len = log.len() / 4;
        log.drain(len + 400..len + 500);
        let offsets: Vec<Result<u64, (u64, u64, Why)>> = crate::items(&log)
            .unwrap()
            .map(|item| match item {
                crate::Item::Frame(frame) => Ok(frame.offset),
                crate::Item::Skipped(skipped) => Err((skipped.offset, skipped.len, skipped.why)),
            })
            .collect();
        let len = len as u64;
        // The second record has an intact head but takes bytes of the third; the rest of the third is skipped.
        assert_eq!(offsets, [Ok(0), Ok(len), Err((2 * len, len - 100, Why::Damaged)), Ok(3 * len - 100)]);
        assert_eq!(front(&record(0x0400, 242)[..300]), (Err(Why::Cut), 300));
    }
}
