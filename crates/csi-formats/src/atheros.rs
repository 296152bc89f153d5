//! The Atheros CSI tool: the QCA9300.
//!
//! A log is a sequence of a u16 length and a record, in the byte order of the logger's machine:
//!
//! | offset | type | |
//! |---|---|---|
//! | 0 | u64 | the card's clock, microseconds |
//! | 8 | u16 | bytes of CSI |
//! | 10 | u16 | centre of the channel, MHz |
//! | 12 | u8 | error, noise floor, rate, width (0: 20 MHz, 1: 40 MHz) |
//! | 16 | u8 | subcarriers (56 or 114), receive chains, transmit streams |
//! | 19 | u8 | total RSSI and that of chains 1 to 3; 128: none |
//! | 23 | u16 | bytes of the frame |
//! | 25 | | CSI, then the frame |
//!
//! CSI is a bit stream of 10-bit numbers, imaginary part first, `[subcarrier][tx][rx]` with rx fastest.

use crate::{Bits, Card, Clock, Endian, Frame, Front, Kind, RssiUnit, Tones, Why, array, no_end, sequence, to_next};
use alloc::vec::Vec;

/// Bytes of a record before its CSI, without the length field.
pub const HEAD: usize = 25;
/// Bytes of the length field.
const LENGTH_FIELD: usize = 2;
/// RSSI of a chain that was not used.
const NO_RSSI: u8 = 128;

struct Head {
    len: usize,
    clock_us: u64,
    csi_len: usize,
    centre_mhz: u16,
    is_40_mhz: bool,
    tones: u8,
    n_rx: u8,
    n_tx: u8,
    rssi: [u8; 3],
    frame_len: usize,
}

impl Head {
    /// The head at the front, if its fields are consistent; `None` otherwise, or if there are too few bytes.
    fn parse(bytes: &[u8], endian: Endian) -> Option<Self> {
        let u16_of =
            |at| array(bytes, at).map(if endian == Endian::Big { u16::from_be_bytes } else { u16::from_le_bytes });
        let u64_of =
            |at| array(bytes, at).map(if endian == Endian::Big { u64::from_be_bytes } else { u64::from_le_bytes });
        let len = usize::from(u16_of(0)?);
        let &[_, _, _, is_40_mhz, tones, n_rx, n_tx, _, a, b, c] = bytes.get(14..25)? else { return None };
        let head = Self {
            len: LENGTH_FIELD + len,
            clock_us: u64_of(2)?,
            csi_len: u16_of(10)?.into(),
            centre_mhz: u16_of(12)?,
            is_40_mhz: is_40_mhz != 0,
            tones,
            n_rx,
            n_tx,
            rssi: [a, b, c],
            frame_len: u16_of(25)?.into(),
        };
        head.is_consistent(len).then_some(head)
    }

    fn is_consistent(&self, len: usize) -> bool {
        let chains = 1..=3_u8;
        let bits = 20 * usize::from(self.tones) * usize::from(self.n_rx) * usize::from(self.n_tx);
        let has_csi = self.csi_len == bits.div_ceil(8) && matches!(self.tones, 56 | 114);
        len == HEAD + self.csi_len + self.frame_len
            && (2_000..8_000).contains(&self.centre_mhz)
            && (self.csi_len == 0 || has_csi && chains.contains(&self.n_rx) && chains.contains(&self.n_tx))
    }
}

/// Whether the first record is consistent and followed by another one or the end.
pub(crate) fn is_log(bytes: &[u8], endian: Endian) -> bool {
    let Some(head) = Head::parse(bytes, endian) else { return false };
    let next = bytes.get(head.len..).unwrap_or_default();
    next.len() < LENGTH_FIELD + HEAD || Head::parse(next, endian).is_some()
}

/// The record at the front and its length, or why it is invalid and how many bytes to skip.
pub fn front(bytes: &[u8], endian: Endian) -> Front {
    let is_record = |bytes: &[u8]| Head::parse(bytes, endian).is_some();
    if bytes.len() < LENGTH_FIELD + HEAD {
        return (Err(Why::Cut), bytes.len());
    }
    let Some(head) = Head::parse(bytes, endian) else { return (Err(Why::Damaged), to_next(bytes, is_record)) };
    let Some(record) = bytes.get(LENGTH_FIELD + HEAD..head.len) else { return no_end(bytes, is_record) };
    let Some((csi, frame)) = record.split_at_checked(head.csi_len).filter(|_| head.csi_len > 0) else {
        return (Err(Why::NoCsi), head.len);
    };
    (read(&head, csi, frame).ok_or(Why::Damaged), head.len)
}

fn read(head: &Head, csi: &[u8], frame: &[u8]) -> Option<Frame> {
    let width_mhz = if head.is_40_mhz { 40 } else { 20 };
    // The card states the number; a 20 MHz frame on a 40 MHz channel has that of 20 MHz.
    let Tones { subcarriers, .. } = Tones::of(Kind::Ht, if head.tones == 114 { 40 } else { 20 })?;
    let (n_rx, n_tx, n) = (usize::from(head.n_rx), usize::from(head.n_tx), subcarriers.len());
    let rssi = |rssi: &u8| (*rssi != NO_RSSI).then_some(i16::from(*rssi));
    Some(Frame {
        clock: Some(Clock::us(head.clock_us, 64)),
        sender: array(frame, 10),
        sequence: sequence(frame),
        centre_mhz: Some(head.centre_mhz),
        width_mhz,
        kind: Some(Kind::Ht),
        n_rx,
        n_tx,
        csi: unpack(csi, (n_rx, n_tx, n))?,
        measured: alloc::vec![true; n],
        subcarriers,
        rssi: head.rssi.iter().take(n_rx).map(rssi).collect(),
        ..Frame::of(Card::Qca9300, RssiUnit::Db)
    })
}

/// 10-bit samples `[subcarrier][tx][rx]` as `[rx][tx][subcarrier]`.
pub(crate) fn unpack(csi: &[u8], (n_rx, n_tx, n): (usize, usize, usize)) -> Option<Vec<[f32; 2]>> {
    let mut bits = Bits::new(csi);
    let mut out = alloc::vec![[0.0; 2]; n_rx * n_tx * n];
    for k in 0..n {
        for tx in 0..n_tx {
            for rx in 0..n_rx {
                let (im, re) = (bits.signed(10)?, bits.signed(10)?);
                *out.get_mut((rx * n_tx + tx) * n + k)? = [re.into(), im.into()];
            }
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;

    /// A record of one chain whose first sample is `5 - 2j`, all others 0.
    fn record(endian: Endian) -> Vec<u8> {
        let two = |value: u16| if endian == Endian::Big { value.to_be_bytes() } else { value.to_le_bytes() };
        let clock = if endian == Endian::Big { 77_u64.to_be_bytes() } else { 77_u64.to_le_bytes() };
        let (csi_len, frame_len) = (140, 24);
        let mut bytes = [&two(25 + csi_len + frame_len)[..], &clock, &two(csi_len), &two(2437)].concat();
        bytes.extend([0, 0, 0x8f, 0, 56, 1, 1, 50, 49, 128, 128]);
        bytes.extend(two(frame_len));
        // -2 in ten bits, then 5 in ten bits.
        bytes.extend([0xfe, 0x17, 0x00]);
        bytes.extend(vec![0; usize::from(csi_len) - 3]);
        bytes.extend([0x88, 0, 0, 0, 1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2, 9, 3, 3, 3, 3, 3, 3, 0x10, 0x20]);
        bytes
    }

    #[test]
    fn both_byte_orders_are_read_and_distinguished() {
        for endian in [Endian::Little, Endian::Big] {
            let log = [record(endian), record(endian)].concat();
            assert_eq!(crate::detect(&log), Some(crate::Format::Atheros(endian)));
            let (frame, len) = front(&log, endian);
            let frame = frame.unwrap();
            assert_eq!((len, frame.clock, frame.centre_mhz), (191, Some(Clock::us(77, 64)), Some(2437)));
            assert_eq!((frame.csi[0], frame.csi[1], frame.csi.len()), ([5.0, -2.0], [0.0, 0.0], 56));
            assert_eq!((frame.sender, frame.sequence), (Some([2, 2, 2, 2, 2, 9]), Some(0x201)));
            assert_eq!((frame.rssi, frame.rssi_unit), (vec![Some(49)], RssiUnit::Db));
        }
    }

    #[test]
    fn frames_without_csi_and_damage_are_skipped_over() {
        let without = [&[49, 0][..], &[0; 8], &[0, 0], &2437_u16.to_le_bytes(), &[0; 11], &[24, 0], &[0; 24]].concat();
        let good = record(Endian::Little);
        let log = [&good[..], &without, &good[10..150], &good, &good[..9]].concat();
        let skipped: Vec<_> = crate::Items::new(crate::Format::Atheros(Endian::Little), &log)
            .map(|item| match item {
                crate::Item::Skipped(skipped) => Some((skipped.len, skipped.why)),
                crate::Item::Frame(_) => None,
            })
            .collect();
        assert_eq!(skipped, [None, Some((51, Why::NoCsi)), Some((140, Why::Damaged)), None, Some((9, Why::Cut))]);
    }
}
