//! nexmon_csi: Broadcom's 4339, 43455c0, 4358 and 4366c0.
//!
//! The firmware sends a UDP datagram to port 5500 for each core and spatial stream; tcpdump writes them to a pcap. The payload:
//!
//! | offset | type | |
//! |---|---|---|
//! | 0 | u16 | magic, `0x1111` |
//! | 2 | i8 | RSSI, dBm, in newer firmware; `0x11` in older |
//! | 3 | u8 | frame control, in newer firmware; `0x11` in older |
//! | 4 | 6 bytes | sender |
//! | 10 | u16 | sequence control |
//! | 12 | u16 | bits 0-2 core, 3-5 spatial stream |
//! | 14 | u16 | chanspec: bits 0-7 channel, 11-13 width, 14-15 band |
//! | 16 | u16 | chip |
//! | 18 | | CSI, 4 bytes a point of the FFT, from the channel centre up, then from the lower edge |
//!
//! A point is a pair of i16 (43455c0, 4339), or a u32 of two mantissas with a common exponent (4358, 4366c0). One datagram is
//! one [`Frame`] of one chain: [`Frame::first_rx`] is the core. The points at the edges and the centre carry no signal.

use crate::{Card, Endian, Frame, Front, RssiUnit, Why, array, i16_pairs, no_end, to_next, u16_at};
use alloc::vec::Vec;

/// Bytes of a pcap's header.
pub const HEAD: usize = 24;
/// Bytes of a packet's header in it.
const PACKET_HEAD: usize = 16;
/// Bytes of the payload before the CSI.
const CSI: usize = 18;
/// Longest plausible packet of a pcap, bytes.
const MAX_PACKET: u32 = 262_144;
const PORT: u16 = 5_500;
const MAGIC: [u8; 2] = [0x11, 0x11];

/// How the numbers of a pcap are written.
#[derive(Clone, Copy)]
struct Pcap {
    endian: Endian,
    is_nano: bool,
}

impl Pcap {
    /// From the magic number of a pcap of Ethernet packets.
    fn of(bytes: &[u8]) -> Option<Self> {
        let (endian, is_nano) = match array::<4>(bytes, 0)? {
            [0xd4, 0xc3, 0xb2, 0xa1] => (Endian::Little, false),
            [0xa1, 0xb2, 0xc3, 0xd4] => (Endian::Big, false),
            [0x4d, 0x3c, 0xb2, 0xa1] => (Endian::Little, true),
            [0xa1, 0xb2, 0x3c, 0x4d] => (Endian::Big, true),
            _ => return None,
        };
        let pcap = Self { endian, is_nano };
        (pcap.u32_at(bytes, 20)? & 0xffff == 1).then_some(pcap)
    }

    fn u32_at(self, bytes: &[u8], at: usize) -> Option<u32> {
        array(bytes, at).map(if self.endian == Endian::Big { u32::from_be_bytes } else { u32::from_le_bytes })
    }

    /// Host time, microseconds, and length of the packet at the front, if its header is plausible.
    fn packet(self, bytes: &[u8]) -> Option<(i64, usize)> {
        let [s, fraction, len, on_air] = [0, 4, 8, 12].map(|at| self.u32_at(bytes, at));
        let (s, fraction, len) = (s?, fraction?, len?);
        let second = if self.is_nano { 1_000_000_000 } else { 1_000_000 };
        let us = i64::from(if self.is_nano { fraction / 1_000 } else { fraction });
        let is_possible = fraction < second && len <= MAX_PACKET && len <= on_air?;
        is_possible.then_some((1_000_000 * i64::from(s) + us, len as usize))
    }
}

/// Whether it is a pcap with a nexmon datagram among its first packets.
pub(crate) fn is_log(bytes: &[u8]) -> bool {
    let Some(pcap) = Pcap::of(bytes) else { return false };
    let mut rest = bytes.get(HEAD..).unwrap_or_default();
    while let Some((_, len)) = pcap.packet(rest) {
        let packet = rest.get(PACKET_HEAD..).unwrap_or_default();
        if datagram(packet.get(..len).unwrap_or(packet)).is_some() {
            return true;
        }
        rest = rest.get(PACKET_HEAD + len..).unwrap_or_default();
    }
    false
}

/// Payload of an Ethernet packet that holds a nexmon datagram, without trailing bytes (a checksum, padding).
fn datagram(packet: &[u8]) -> Option<&[u8]> {
    let ip = packet.get(14..).filter(|_| array(packet, 12) == Some([0x08, 0x00]))?;
    let &first = ip.first()?;
    let is_udp = first >> 4 == 4 && ip.get(9) == Some(&17);
    let udp = ip.get(4 * usize::from(first & 15)..).filter(|_| is_udp)?;
    let end = usize::from(array(udp, 4).map(u16::from_be_bytes)?).min(udp.len());
    let payload = udp.get(8..end).filter(|_| array(udp, 2).map(u16::from_be_bytes) == Some(PORT))?;
    (array(payload, 0) == Some(MAGIC)).then_some(payload)
}

/// The packet at the front and its length, or why it has no CSI and how many bytes to skip; `log` is the whole log.
pub(crate) fn front(bytes: &[u8], log: &[u8]) -> Front {
    let Some(pcap) = Pcap::of(log) else { return (Err(Why::Damaged), bytes.len()) };
    let is_ours = |bytes: &[u8]| pcap.packet(bytes).is_some() && bytes.get(PACKET_HEAD..).and_then(datagram).is_some();
    let Some((host_us, len)) = pcap.packet(bytes) else {
        let why = if bytes.len() < PACKET_HEAD { Why::Cut } else { Why::Damaged };
        return (Err(why), to_next(bytes, is_ours));
    };
    let Some(packet) = bytes.get(PACKET_HEAD..PACKET_HEAD + len) else { return no_end(bytes, is_ours) };
    let frame = datagram(packet).ok_or(Why::NoCsi).and_then(read);
    (frame.map(|frame| Frame { host_us: Some(host_us), ..frame }), PACKET_HEAD + len)
}

/// How a chip encodes its points.
enum Points {
    Pairs,
    /// Bits of a mantissa, including its sign, and of the exponent.
    Floats {
        mantissa: u32,
        exponent: u32,
    },
}

/// Chips by their numbers, which some firmware leaves to the driver: from CSIKit's list of observed numbers.
fn chip(number: [u8; 2]) -> Option<(&'static str, Points)> {
    match number {
        [0x01, 0x00] => Some(("4339", Points::Pairs)),
        [0x65, 0x00] | [0xdc, 0xa6] => Some(("43455c0", Points::Pairs)),
        [0x03, 0x00] | [0xad, 0xde] => Some(("4358", Points::Floats { mantissa: 9, exponent: 5 })),
        [0x34, 0xe8] | [0x6a, 0x00] => Some(("4366c0", Points::Floats { mantissa: 12, exponent: 6 })),
        _ => None,
    }
}

/// The FFT points per side that a frame of a width (MHz) can fill: the innermost and the outermost.
const fn filled(points: usize) -> Option<(u16, i16, i16)> {
    match points {
        64 => Some((20, 1, 28)),
        128 => Some((40, 2, 58)),
        256 => Some((80, 2, 122)),
        512 => Some((160, 6, 250)),
        _ => None,
    }
}

fn read(payload: &[u8]) -> Result<Frame, Why> {
    let number: [u8; 2] = array(payload, 16).ok_or(Why::Damaged)?;
    let (name, points) = chip(number).ok_or(Why::Device { got: u16::from_le_bytes(number) })?;
    let csi = payload.get(CSI..).ok_or(Why::Damaged)?;
    let got = csi.len() / 4;
    let (width_mhz, inner, outer) = filled(got).ok_or(Why::Subcarriers { got: got as u32 })?;
    let n = got as i16;
    let subcarriers: Vec<i16> = (0..n).map(|k| if k < n / 2 { k } else { k - n }).collect();
    let cores = u16_at(payload, 12).ok_or(Why::Damaged)?;
    // Some firmware swaps these bytes.
    let cores = if cores > 63 { cores.swap_bytes() } else { cores };
    // Firmware that does not report the RSSI repeats the magic number there.
    let rssi = array::<2>(payload, 2).filter(|bytes| *bytes != MAGIC).map(|[rssi, _]| i16::from(rssi.cast_signed()));
    Ok(Frame {
        sender: array(payload, 4),
        sequence: u16_at(payload, 10).map(|control| control >> 4),
        centre_mhz: u16_at(payload, 14).and_then(centre_mhz),
        width_mhz,
        first_rx: (cores & 7) as u8,
        first_tx: (cores >> 3 & 7) as u8,
        measured: subcarriers.iter().map(|index| (inner..=outer).contains(&index.abs())).collect(),
        subcarriers,
        csi: match points {
            Points::Pairs => i16_pairs(csi),
            Points::Floats { mantissa, exponent } => floats(csi, mantissa, exponent),
        },
        rssi: alloc::vec![rssi],
        ..Frame::of(Card::Broadcom(name), RssiUnit::Dbm)
    })
}

/// Centre of a channel, MHz, from its number, which denotes the centre at any width.
fn centre_mhz(chanspec: u16) -> Option<u16> {
    let channel = chanspec & 0xff;
    match (chanspec >> 14, channel) {
        (3, 1..) => Some(5_000 + 5 * channel),
        (0, 14) => Some(2_484),
        (0, 1..=13) => Some(2_407 + 5 * channel),
        _ => None,
    }
}

/// Points of two signed mantissas and an exponent, scaled so that the largest has 10 bits, as nexmon's own
/// `unpack_float_acphy` does; values below one unit become 0.
fn floats(csi: &[u8], mantissa: u32, exponent: u32) -> Vec<[f32; 2]> {
    const BITS: i32 = 10;
    let magnitude_mask = (1 << (mantissa - 1)) - 1;
    let parse = |bytes: &[u8; 4]| {
        let word = u32::from_le_bytes(*bytes);
        let part = |at: u32| {
            let magnitude = i64::from(word >> at & magnitude_mask);
            (magnitude, word >> (at + mantissa - 1) & 1 == 1)
        };
        let shift = 32 - exponent;
        let power = (word << shift).cast_signed() >> shift;
        (part(exponent + mantissa), part(exponent), power)
    };
    let points: Vec<_> = csi.as_chunks::<4>().0.iter().map(parse).collect();
    let lowest = -(1 << (exponent - 1));
    let top = |((re, _), (im, _), power): &((i64, bool), (i64, bool), i32)| {
        let both = re | im;
        if both > 0 { power + both.ilog2() as i32 } else { lowest }
    };
    let highest = points.iter().map(top).fold(lowest, i32::max);
    let scale = |(magnitude, is_negative): (i64, bool), power: i32| {
        let shift = power + BITS - highest;
        let value = match shift {
            _ if shift < -(mantissa.cast_signed()) => 0,
            ..0 => magnitude >> -shift,
            _ => magnitude << shift.min(40),
        };
        if is_negative { -(value as f32) } else { value as f32 }
    };
    points.iter().map(|(re, im, power)| [scale(*re, *power), scale(*im, *power)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;

    /// A packet of 64 points, the first `(5, -7)`.
    fn packet(endian: Endian, chip: [u8; 2], first: [u8; 4]) -> Vec<u8> {
        let payload =
            [&[0x11, 0x11, 0xc6, 0x94], &[2; 6][..], &[0x50, 0], &[0x0a, 0], &[0x06, 0x10], &chip, &first, &[0; 252]];
        let payload = payload.concat();
        let ip = [&[0x45][..], &[0; 8], &[17], &[0; 10]].concat();
        let len = (8 + payload.len() as u16).to_be_bytes();
        let udp = [&[0x15, 0x7c, 0x15, 0x7c][..], &len, &[0; 2]].concat();
        let packet = [&[0xff; 12][..], &[8, 0], &ip, &udp, &payload, b"FCS."].concat();
        let number = |value: u32| if endian == Endian::Big { value.to_be_bytes() } else { value.to_le_bytes() };
        let len = packet.len() as u32;
        [&number(3)[..], &number(4), &number(len), &number(len), &packet].concat()
    }

    fn pcap(endian: Endian, packets: &[Vec<u8>]) -> Vec<u8> {
        let number = |value: u32| if endian == Endian::Big { value.to_be_bytes() } else { value.to_le_bytes() };
        [&number(0xa1b2_c3d4)[..], &[0; 16], &number(1), &packets.concat()].concat()
    }

    #[test]
    fn a_datagram_is_a_frame_of_one_chain() {
        for endian in [Endian::Little, Endian::Big] {
            let log = pcap(endian, &[packet(endian, [0x65, 0], [5, 0, 0xf9, 0xff])]);
            let items: Vec<_> = crate::items(&log).unwrap().collect();
            let [crate::Item::Frame(frame)] = &items[..] else { panic!("{items:?}") };
            assert_eq!((frame.host_us, frame.clock, frame.sender), (Some(3_000_004), None, Some([2; 6])));
            assert_eq!((frame.first_rx, frame.first_tx, frame.sequence), (2, 1, Some(5)));
            assert_eq!((frame.centre_mhz, frame.width_mhz, &frame.rssi), (Some(2_437), 20, &vec![Some(-58)]));
            assert_eq!((frame.csi[0], frame.subcarriers[31], frame.subcarriers[32]), ([5.0, -7.0], 31, -32));
            assert_eq!(
                (frame.measured[0], frame.measured[1], frame.measured[28], frame.measured[29]),
                (false, true, true, false)
            );
        }
    }

    #[test]
    fn mantissas_share_an_exponent() {
        // Re 3, im -1 with exponent 0: scaling adds 10 bits to the largest value's two.
        let word = 3_u32 << 14 | 1 << 13 | 1 << 5;
        let log = pcap(Endian::Little, &[packet(Endian::Little, [0x03, 0], word.to_le_bytes())]);
        let Some(crate::Item::Frame(frame)) = crate::items(&log).unwrap().next() else { panic!() };
        assert_eq!((frame.csi[0], frame.csi[1]), ([1_536.0, -512.0], [0.0, 0.0]));
    }

    #[test]
    fn other_packets_and_chips_are_skipped_over() {
        let good = packet(Endian::Little, [0x65, 0], [0; 4]);
        let mut other = good.clone();
        other[16 + 36] = 1;
        let log =
            pcap(Endian::Little, &[good.clone(), other, packet(Endian::Little, [9, 9], [0; 4]), good[..100].to_vec()]);
        let why: Vec<_> = crate::items(&log)
            .unwrap()
            .map(|item| match item {
                crate::Item::Frame(_) => None,
                crate::Item::Skipped(skipped) => Some(skipped.why),
            })
            .collect();
        assert_eq!(why, [None, Some(Why::NoCsi), Some(Why::Device { got: 0x0909 }), Some(Why::Cut)]);
    }
}
