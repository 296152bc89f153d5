//! PicoScenes: the Intel 5300, AX200 and AX210, and the Atheros QCA9300.
//!
//! A frame starts with its length (u32, excluding itself), the magic number `0x20150315`, a version (u16) and the number of
//! segments (u8); then come the segments and the 802.11 frame. A segment is its length (u32, excluding itself), the length of
//! its name (u8), the name (a zero byte may end it), a version (u16) and its content:
//!
//! | segment | |
//! |---|---|
//! | `RxSBasic` | device, clock, channel, kind, RSSI; versions 1 to 3 |
//! | `CSI` | the samples as the device packs them; versions 1 to 4 |
//! | `MVMExtra` | the head that the AX200's firmware writes ([`crate::feitcsi`]), with its clocks |
//!
//! Other segments are skipped by their length. CSI segments of version 5 and later may be compressed; only PicoScenes' own
//! library reads those.

use crate::feitcsi::Head as MvmHead;
use crate::{
    Bits, Card, Clock, Frame, Front, Kind, RssiUnit, Tones, Why, array, i16_pairs, no_end, of_5300, sequence, to_next,
    u16_at, u32_at, u64_at,
};
use alloc::vec::Vec;

const MAGIC: u32 = 0x2015_0315;
/// Bytes of a frame before its segments: length, magic, version, number of segments.
const HEAD: usize = 11;
/// RSSI of a chain that was not used.
const NO_RSSI: i8 = -128;

/// Devices by their numbers in the format.
mod device {
    pub(super) const INTEL_5300: u16 = 0x5300;
    pub(super) const QCA9300: u16 = 0x9300;
    pub(super) const AX200: u16 = 0x2000;
    pub(super) const AX210: u16 = 0x2100;
}

pub(crate) fn is_log(bytes: &[u8]) -> bool {
    u32_at(bytes, 4) == Some(MAGIC)
}

/// The frame at the front and its length, or why it is invalid and how many bytes to skip.
pub fn front(bytes: &[u8]) -> Front {
    let next = || to_next(bytes, is_log);
    let Some(len) = u32_at(bytes, 0).filter(|_| is_log(bytes)) else {
        let why = if bytes.len() < HEAD { Why::Cut } else { Why::Damaged };
        return (Err(why), next());
    };
    let len = (len as usize).saturating_add(4);
    match bytes.get(..len) {
        Some(frame) if len >= HEAD => match read(frame) {
            // Bytes may be missing from it: then the next frame begins inside.
            Err(why) => (Err(why), next().min(len)),
            read => (read, len),
        },
        _ => no_end(bytes, is_log),
    }
}

/// A part of a frame.
struct Segment<'a> {
    name: &'a [u8],
    version: u16,
    body: &'a [u8],
}

/// The segment at the front, and the bytes after it.
fn segment(bytes: &[u8]) -> Option<(Segment<'_>, &[u8])> {
    let len = usize::try_from(u32_at(bytes, 0)?).ok()?;
    let (segment, rest) = bytes.get(4..)?.split_at_checked(len)?;
    let (&name_len, segment) = segment.split_first()?;
    let (name, segment) = segment.split_at_checked(name_len.into())?;
    let (version, body) = segment.split_first_chunk()?;
    let name = name.strip_suffix(&[0]).unwrap_or(name);
    Some((Segment { name, version: u16::from_le_bytes(*version), body }, rest))
}

fn read(bytes: &[u8]) -> Result<Frame, Why> {
    let (mut basic, mut csi, mut mvm) = (None, None, None);
    let mut rest = bytes.get(HEAD..).ok_or(Why::Damaged)?;
    for _ in 0..bytes.get(HEAD - 1).copied().unwrap_or(0) {
        let (segment, behind) = segment(rest).ok_or(Why::Damaged)?;
        rest = behind;
        match segment.name {
            b"RxSBasic" => basic = Basic::parse(&segment),
            b"CSI" => csi = Some(Csi::parse(&segment)?),
            // The segment's own u16 length precedes the head.
            b"MVMExtra" if segment.version == 1 => mvm = segment.body.get(2..).and_then(MvmHead::parse),
            _ => {}
        }
    }
    join(basic.as_ref(), &csi.ok_or(Why::NoCsi)?, mvm.as_ref(), rest)
}

/// The content of `RxSBasic`.
struct Basic {
    clock: u64,
    centre_mhz: u16,
    width_mhz: u16,
    rssi: [i8; 3],
}

impl Basic {
    /// `None` for later versions: their layout is unknown, but the CSI is readable.
    fn parse(segment: &Segment<'_>) -> Option<Self> {
        let body = segment.body;
        // Offsets of the widths, and of the chains' RSSI after noise floor and total RSSI.
        let (width, rssi) = match segment.version {
            1 => (13, 23),
            2 => (13, 25),
            3 => (17, 27),
            _ => return None,
        };
        Some(Self {
            clock: u64_at(body, 2)?,
            centre_mhz: u16_at(body, 10)?,
            width_mhz: u16_at(body, width)?,
            rssi: array::<3>(body, rssi)?.map(u8::cast_signed),
        })
    }
}

/// The fields of `CSI` before its samples, and the samples.
struct Csi<'a> {
    device: u16,
    kind: Option<Kind>,
    width_mhz: u16,
    tones: u16,
    n_tx: u8,
    n_rx: u8,
    antenna_sel: u8,
    samples: &'a [u8],
}

impl<'a> Csi<'a> {
    fn parse(segment: &Segment<'a>) -> Result<Self, Why> {
        let (device, rest) = segment.body.split_first_chunk().ok_or(Why::Damaged)?;
        // Version 4 has a firmware byte after the device; 3 and 4 have a number of CSIs before the antennas.
        let (skip, antennas, len_at) = match segment.version {
            1 => (0, 28, 29),
            2 => (0, 28, 31),
            3 => (0, 30, 33),
            4 => (1, 30, 33),
            got => return Err(Why::Version { got }),
        };
        let rest = rest.get(skip..).ok_or(Why::Damaged)?;
        Self::fields(u16::from_le_bytes(*device), rest, antennas, len_at).ok_or(Why::Damaged)
    }

    /// The fields after the device: kind u8, width u16, carrier u64, sampling rate u64, spacing u32, tones u16, then streams,
    /// chains and extension streams, u8 each.
    fn fields(device: u16, rest: &'a [u8], antennas: usize, len_at: usize) -> Option<Self> {
        let samples = rest.get(len_at + 4..)?;
        Some(Self {
            device,
            kind: match rest.first()? {
                0 => Some(Kind::Legacy),
                1 => Some(Kind::Ht),
                2 => Some(Kind::Vht),
                3 | 4 => Some(Kind::He),
                _ => None,
            },
            width_mhz: u16_at(rest, 1)?,
            tones: u16_at(rest, 23)?,
            n_tx: *rest.get(25)?,
            n_rx: *rest.get(26)?,
            antenna_sel: *rest.get(antennas)?,
            samples: samples.get(..usize::try_from(u32_at(rest, len_at)?).ok()?)?,
        })
    }

    /// Subcarriers, and which of them were measured.
    fn tones(&self) -> Option<(Vec<i16>, Vec<bool>)> {
        if self.device == device::INTEL_5300 {
            return of_5300(self.width_mhz).map(|all| (all, alloc::vec![true; 30]));
        }
        let Tones { subcarriers, data } = Tones::of(self.kind?, self.width_mhz)?;
        let measured = if self.device == device::QCA9300 { alloc::vec![true; data.len()] } else { data };
        (subcarriers.len() == usize::from(self.tones)).then_some((subcarriers, measured))
    }

    /// Samples `[rx][tx][subcarrier]` of `n` subcarriers.
    fn unpack(&self, n: usize) -> Option<Vec<[f32; 2]>> {
        let shape = (usize::from(self.n_rx), usize::from(self.n_tx), n);
        let all = match self.device {
            device::INTEL_5300 => unpack_5300(self.samples, shape)?,
            device::QCA9300 => crate::atheros::unpack(self.samples, shape)?,
            _ => i16_pairs(self.samples),
        };
        (all.len() == shape.0 * shape.1 * n).then_some(all)
    }
}

/// The 5300's 8-bit samples, `[subcarrier][rx][tx]` with 3 bits before each subcarrier, as `[rx][tx][subcarrier]`.
fn unpack_5300(bytes: &[u8], (n_rx, n_tx, n): (usize, usize, usize)) -> Option<Vec<[f32; 2]>> {
    let mut bits = Bits::new(bytes);
    let mut out = alloc::vec![[0.0; 2]; n_rx * n_tx * n];
    for k in 0..n {
        bits.skip(3);
        for pair in 0..n_rx * n_tx {
            let (re, im) = (bits.signed(8)?, bits.signed(8)?);
            *out.get_mut(pair * n + k)? = [re.into(), im.into()];
        }
    }
    Some(out)
}

/// Combines the segments; `mpdu` is the 802.11 frame.
fn join(basic: Option<&Basic>, csi: &Csi<'_>, mvm: Option<&MvmHead>, mpdu: &[u8]) -> Result<Frame, Why> {
    let card = match csi.device {
        device::INTEL_5300 => Card::Intel5300,
        device::QCA9300 => Card::Qca9300,
        device::AX200 | device::AX210 => Card::Ax2xx,
        got => return Err(Why::Device { got }),
    };
    if !(1..=4).contains(&csi.n_rx) || !(1..=4).contains(&csi.n_tx) {
        return Err(Why::Damaged);
    }
    let wrong = Why::Subcarriers { got: csi.tones.into() };
    let (subcarriers, measured) = csi.tones().ok_or(wrong)?;
    let samples = csi.unpack(subcarriers.len()).ok_or(Why::Damaged)?;
    // The AX200's clock is in its firmware's head; `RxSBasic` has 0.
    let of_basic = basic.filter(|basic| basic.clock > 0).map(|basic| Clock::us(basic.clock, 64));
    let clocks = mvm.map(MvmHead::clocks);
    // A 5300 reports RSSI by antenna, 0 if none is connected (`iwl_bfee_notif`); two bits per chain name its antenna.
    let rssi = |basic: &Basic, chain: usize| match card {
        Card::Intel5300 => {
            let antenna = usize::from(csi.antenna_sel >> (2 * chain.min(3)) & 3);
            basic.rssi.get(antenna).copied().filter(|rssi| *rssi > 0)
        }
        _ => basic.rssi.get(chain).copied().filter(|rssi| *rssi != NO_RSSI),
    };
    let all = |basic: &Basic| (0..csi.n_rx.into()).map(|chain| rssi(basic, chain).map(i16::from)).collect();
    Ok(Frame {
        clock: clocks.map(|(ftm, _)| ftm).or(of_basic),
        slow_clock: clocks.map(|(_, us)| us),
        sender: array(mpdu, 10),
        sequence: sequence(mpdu),
        centre_mhz: basic.map(|basic| basic.centre_mhz),
        width_mhz: if csi.width_mhz > 0 { csi.width_mhz } else { basic.map_or(0, |basic| basic.width_mhz) },
        kind: csi.kind,
        n_rx: csi.n_rx.into(),
        n_tx: csi.n_tx.into(),
        antenna_sel: (card == Card::Intel5300).then_some(csi.antenna_sel),
        csi: samples,
        subcarriers,
        measured,
        rssi: basic.map_or_else(Vec::new, all),
        ..Frame::of(card, if card == Card::Ax2xx { RssiUnit::Dbm } else { RssiUnit::Db })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;

    fn segment_bytes(name: &str, version: u16, body: &[u8]) -> Vec<u8> {
        let len = 1 + name.len() + 1 + 2 + body.len();
        let head = [&(len as u32).to_le_bytes()[..], &[name.len() as u8 + 1], name.as_bytes(), &[0]].concat();
        [&head[..], &version.to_le_bytes(), body].concat()
    }

    fn frame_bytes(segments: &[Vec<u8>], mpdu: &[u8]) -> Vec<u8> {
        let body = [&segments.concat()[..], mpdu].concat();
        let head = [&((HEAD - 4 + body.len()) as u32).to_le_bytes()[..], &MAGIC.to_le_bytes(), &[1, 0]].concat();
        [&head[..], &[segments.len() as u8], &body].concat()
    }

    /// A CSI segment of an AX200, 1 x 1, HT20, of this version.
    fn csi(version: u16) -> Vec<u8> {
        let firmware = if version == 4 { &[67][..] } else { &[] };
        let middle = if version >= 3 { &[1, 0][..] } else { &[] };
        let offset = if version >= 2 { &[0, 0][..] } else { &[] };
        let samples: Vec<u8> = (0..56_i16).flat_map(|k| [k.to_le_bytes(), (-k).to_le_bytes()].concat()).collect();
        let body = [
            &device::AX200.to_le_bytes()[..],
            firmware,
            &[1],
            &20_u16.to_le_bytes(),
            &[0; 20],
            &56_u16.to_le_bytes(),
            &[1, 1, 0],
            middle,
            &[0],
            offset,
            &224_u32.to_le_bytes(),
            &samples,
        ];
        segment_bytes("CSI", version, &body.concat())
    }

    const MPDU: [u8; 24] = [8, 0, 0, 0, 1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 0x50, 0];

    #[test]
    fn segments_of_every_version_are_read_and_unknown_ones_skipped() {
        for version in 1..=4 {
            let unknown = segment_bytes("Tomorrow", 9, &[5; 31]);
            let bytes = frame_bytes(&[unknown, csi(version)], &MPDU);
            let (frame, len) = front(&bytes);
            let frame = frame.unwrap();
            assert_eq!((len, frame.subcarriers.len(), frame.csi[3]), (bytes.len(), 56, [3.0, -3.0]), "{version}");
            assert_eq!((frame.sender, frame.sequence), (Some([2; 6]), Some(5)));
            assert_eq!((frame.clock, frame.centre_mhz, frame.rssi), (None, None, vec![]), "no segment says so");
        }
        assert_eq!(front(&frame_bytes(&[segment_bytes("CSI", 5, &[0; 90])], &MPDU)).0, Err(Why::Version { got: 5 }));
        assert_eq!(front(&frame_bytes(&[], &MPDU)).0, Err(Why::NoCsi));
    }

    #[test]
    fn a_5300_reports_rssi_by_antenna_and_csi_by_chain() {
        let samples = [0; 60 * 30];
        let body = [
            &device::INTEL_5300.to_le_bytes()[..],
            &[1],
            &20_u16.to_le_bytes(),
            &[0; 20],
            &30_u16.to_le_bytes(),
            // One stream, two chains: the first on C, the other on A.
            &[1, 2, 0, 0b01_00_10],
            &(samples.len() as u32).to_le_bytes(),
            &samples,
        ];
        let basic = [&[0; 23][..], &[37, 0, 40]].concat();
        let segments = [segment_bytes("RxSBasic", 1, &basic), segment_bytes("CSI", 1, &body.concat())];
        let frame = front(&frame_bytes(&segments, &MPDU)).0.unwrap();
        assert_eq!((frame.rssi, frame.rssi_unit), (vec![Some(40), Some(37)], RssiUnit::Db));
    }

    #[test]
    fn reading_goes_on_at_the_next_frame() {
        let good = frame_bytes(&[csi(4)], &MPDU);
        let mut log = [&good[..], &good, &good].concat();
        log.drain(good.len() + 20..good.len() + 60);
        let frames: Vec<_> = crate::items(&log).unwrap().filter(|item| matches!(item, crate::Item::Frame(_))).collect();
        assert_eq!(frames.len(), 2);
    }
}
