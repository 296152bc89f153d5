//! Translates logs of another card into records of the 5300: FeitCSI's, from the AX200 and AX210.
//!
//! | frame | 5300 record |
//! |---|---|
//! | CSI of 20 or 40 MHz | the 30 subcarriers of a 5300, 8 bits, full scale: each is the mean of the nearest measured ones, moved along the phase slope |
//! | CSI of 80 or 160 MHz | the same for the 20 MHz about the frame's centre, which is not the centre of its 20 MHz channel; marked by [`WIDE`] |
//! | the card's clock | `timestamp_low` in whole microseconds; a record before the bfee has the remainder ([`code::CARD_CLOCK`]) |
//! | host time, sender | as in WSR's layout of 2021, which has no frame numbers: frames are paired by the clocks |
//! | RSSI, dBm | RSSI at a gain of 60 dB |
//!
//! Damaged bytes and frames of other widths become a [`code::LEFT_OUT`] record with the reason.

use crate::signal::channel::{INDICES_20_MHZ, INDICES_40_MHZ, SUBCARRIER_SPACING_HZ, SUBCARRIERS};
use csi_formats::{Frame, Why, feitcsi};
use driver_iface::Mac;
use driver_iface::bfee::{Iq, Repr, Wsr, rate};
use driver_iface::record::{Record, code};
use num_complex::Complex32;
use std::io::{self, Read, Seek, SeekFrom};

const PS_PER_US: i128 = 1_000_000;
/// Receive chains of a 5300, the limit of a record.
const MOST_CHAINS: usize = 3;
/// Gain written to the records, dB: RSSI is above 0 from -104 dBm on.
const GAIN_DB: u8 = 60;
/// `rss = rssi - 44 - agc` dBm (csitool, `get_total_rss.m`).
const RSSI_OFFSET_DB: i16 = 44;
/// Antennas of chains 0, 1 and 2: A, B and C.
const IN_ORDER: u8 = 0b10_01_00;
/// Bytes read at a time; no datagram is longer.
const CHUNK: usize = 64 * 1024;
/// Longer than any record, bytes. If a record seems cut after this many bytes, its length field is damaged.
const LONGEST: usize = 256 * 1024;

/// In `rate_n_flags`: the frame was 80 or 160 MHz wide (iwlwifi's `RATE_MCS_CHAN_WIDTH_80`, bit 12).
pub const WIDE: u16 = 0x1000;

/// Translates frames, in the order of their log, into records.
#[derive(Clone, Debug, Default)]
pub struct Translator {
    last: Option<Reading>,
    count: u16,
}

/// A card's clocks at a frame.
#[derive(Clone, Copy, Debug)]
struct Reading {
    ticks: u64,
    slow_us: Option<u64>,
    /// Unwrapped time, picoseconds.
    at_ps: i128,
}

impl Translator {
    /// Appends the records of one frame, or of `len` unreadable bytes at `offset`, to a `.dat` log.
    pub fn take(&mut self, read: &Result<Frame, Why>, offset: u64, len: usize, log: &mut Vec<u8>) {
        match read {
            Err(Why::NoCsi) => {}
            // The logger was killed: the translated log ends within a record too.
            Err(Why::Cut) => log.extend_from_slice(&[0, u8::MAX, code::BFEE]),
            Err(why) => left_out(offset, len, &why.to_string(), log),
            Ok(frame) => {
                if let Err(why) = self.frame(frame, log) {
                    left_out(offset, len, &why, log);
                }
            }
        }
    }

    /// As [`Self::take`], for FeitCSI's bytes of one frame, with more frames to follow.
    #[doc(hidden)] // for the crates of this workspace
    pub fn take_bytes(&mut self, bytes: &[u8], offset: u64, log: &mut Vec<u8>) {
        let read = feitcsi::front(bytes).0;
        let read = if read == Err(Why::Cut) { Err(Why::Damaged) } else { read };
        self.take(&read, offset, bytes.len(), log);
    }

    fn frame(&mut self, frame: &Frame, log: &mut Vec<u8>) -> Result<(), String> {
        let indices = match frame.width_mhz {
            20 | 80 | 160 => &INDICES_20_MHZ,
            40 => &INDICES_40_MHZ,
            other => return Err(format!("a frame of {other} MHz: bearings of two robots need 20 to 160 MHz")),
        };
        let width_bits = match frame.width_mhz {
            40 => rate::HT40,
            80 | 160 => WIDE,
            _ => 0,
        };
        let at_ps = self.clock_ps(frame).ok_or("a frame without the card's clock")?;
        let (n_rx, n_tx) = (frame.n_rx.clamp(1, MOST_CHAINS), frame.n_tx.clamp(1, MOST_CHAINS));
        let columns: Vec<[Complex32; SUBCARRIERS]> = (0..n_rx * n_tx)
            .map(|k| reported(frame, k / n_tx, k % n_tx, indices))
            .collect::<Option<_>>()
            .ok_or("a frame without measured subcarriers")?;
        self.count = self.count.wrapping_add(1);
        let (at_us, left_ps) = (at_ps.div_euclid(PS_PER_US), at_ps.rem_euclid(PS_PER_US));
        let rssi = |chain: usize| frame.rssi.get(chain).copied().flatten().map_or(0, rssi);
        let repr = Repr {
            timestamp_low: at_us as u32,
            bfee_count: self.count,
            n_rx: n_rx as u8,
            n_tx: n_tx as u8,
            rssi: std::array::from_fn(rssi),
            agc: GAIN_DB,
            antenna_sel: IN_ORDER & ((1 << (2 * n_rx)) - 1),
            rate_n_flags: rate::HT | width_bits,
            wsr: Some(Wsr::at(frame.host_us.unwrap_or(0), Mac(frame.sender.unwrap_or_default()), None)),
            ..Repr::default()
        };
        let mut body = vec![0; repr.body_len()];
        repr.emit(&quantised(&columns), &mut body).map_err(|error| error.to_string())?;
        super::append(Record { code: code::CARD_CLOCK, body: &(left_ps as u32).to_le_bytes() }, log);
        super::append(Record { code: code::BFEE, body: &body }, log);
        Ok(())
    }

    /// The fine clock, unwrapped by the coarse one if it wrapped more than once, picoseconds.
    fn clock_ps(&mut self, frame: &Frame) -> Option<i128> {
        let clock = frame.clock?;
        let period = 1_i128 << clock.bits.min(64);
        let slow_us = frame.slow_clock.map(|slow| slow.ticks);
        let tick_ps = i128::from(clock.tick_ps);
        let at_ps = match self.last {
            None => i128::from(clock.ticks) * tick_ps,
            Some(last) => {
                let ticks = (i128::from(clock.ticks) - i128::from(last.ticks)).rem_euclid(period);
                let coarse_us = slow_us.zip(last.slow_us).map(|(now, last)| (now as u32).wrapping_sub(last as u32));
                let wraps = match coarse_us.map(u32::cast_signed) {
                    // Set back: the result goes back too, so that readers notice it.
                    Some(us @ ..0) => return self.keep(clock.ticks, slow_us, last.at_ps + i128::from(us) * PS_PER_US),
                    Some(us) => (i128::from(us) * PS_PER_US - ticks * tick_ps + period * tick_ps / 2)
                        .div_euclid(period * tick_ps)
                        .max(0),
                    None => -i128::from(ticks > period / 2),
                };
                last.at_ps + (ticks + wraps * period) * tick_ps
            }
        };
        self.keep(clock.ticks, slow_us, at_ps)
    }

    fn keep(&mut self, ticks: u64, slow_us: Option<u64>, at_ps: i128) -> Option<i128> {
        self.last = Some(Reading { ticks, slow_us, at_ps });
        Some(at_ps)
    }
}

fn left_out(offset: u64, len: usize, why: &str, log: &mut Vec<u8>) {
    let body = [&offset.to_le_bytes()[..], &(len as u64).to_le_bytes(), why.as_bytes()].concat();
    super::append(Record { code: code::LEFT_OUT, body: &body }, log);
}

fn rssi(dbm: i16) -> u8 {
    (dbm + RSSI_OFFSET_DB + i16::from(GAIN_DB)).clamp(1, 255) as u8
}

/// One column of a frame at the subcarriers that a 5300 reports.
fn reported(frame: &Frame, rx: usize, tx: usize, indices: &[i8; SUBCARRIERS]) -> Option<[Complex32; SUBCARRIERS]> {
    let step = (frame.spacing_hz() / SUBCARRIER_SPACING_HZ) as f32;
    let values = frame.column(rx, tx)?.iter().zip(&frame.subcarriers).zip(&frame.measured);
    let heard: Vec<(f32, Complex32)> = values
        .filter(|(_, measured)| **measured)
        .map(|(([re, im], index), _)| (f32::from(*index) * step, Complex32::new(*re, *im)))
        .collect();
    let neighbours = heard.windows(2).filter(|two| two[1].0 - two[0].0 < 1.5 * step);
    let slope = neighbours.map(|two| two[1].1 * two[0].1.conj()).sum::<Complex32>().arg() / step;
    let brought = |(x, h): &(f32, Complex32), to: f32| h * Complex32::cis(slope * (to - x));
    let mut out = [Complex32::default(); SUBCARRIERS];
    for (k, slot) in out.iter_mut().enumerate() {
        let at = |k: usize| indices.get(k).map(|index| f32::from(*index));
        let to = at(k)?;
        let low = k.checked_sub(1).and_then(at).map_or(f32::MIN, |before| 0.5 * (before + to));
        let high = at(k + 1).map_or(f32::MAX, |after| 0.5 * (after + to));
        let near = || heard.iter().filter(|(x, _)| (low..high).contains(x));
        *slot = match near().count() {
            0 => brought(heard.iter().min_by(|a, b| (a.0 - to).abs().total_cmp(&(b.0 - to).abs()))?, to),
            n => near().map(|one| brought(one, to)).sum::<Complex32>() / n as f32,
        };
    }
    Some(out)
}

/// `[subcarrier][chain]`, scaled so that the largest real or imaginary part is 127.
fn quantised(columns: &[[Complex32; SUBCARRIERS]]) -> Vec<Iq> {
    let largest = columns.iter().flatten().flat_map(|h| [h.re.abs(), h.im.abs()]).fold(0.0, f32::max);
    let scale = if largest > 0.0 { f32::from(i8::MAX) / largest } else { 0.0 };
    let iq = |h: &Complex32| Iq { i: (h.re * scale).round() as i8, q: (h.im * scale).round() as i8 };
    (0..SUBCARRIERS).flat_map(|k| columns.iter().filter_map(move |column| column.get(k))).map(iq).collect()
}

/// True if a file is a FeitCSI log, by its first bytes; rewinds the file.
pub(super) fn is_other(file: &mut std::fs::File) -> io::Result<bool> {
    if !file.metadata()?.is_file() {
        return Ok(false);
    }
    let mut head = Vec::new();
    file.by_ref().take(feitcsi::HEAD as u64).read_to_end(&mut head)?;
    file.seek(SeekFrom::Start(0))?;
    Ok(feitcsi::is_log(&head))
}

/// Splits a stream of bytes into FeitCSI's records.
#[doc(hidden)] // for the crates of this workspace
#[derive(Debug, Default)]
pub struct Pieces {
    /// Buffered bytes; those before `given` have been returned.
    input: Vec<u8>,
    given: usize,
    /// Offset of the next piece in the stream, bytes.
    offset: u64,
    ended: bool,
}

/// A record of FeitCSI, or unreadable bytes.
#[doc(hidden)] // for the crates of this workspace
#[derive(Debug)]
pub struct Piece<'a> {
    /// The frame, or why there is none.
    pub read: Result<Frame, Why>,
    /// Its offset in the stream, bytes.
    pub offset: u64,
    /// The bytes, unchanged.
    pub bytes: &'a [u8],
}

impl Pieces {
    /// Reads once, at most one datagram. Returns the number of bytes, 0 at the end.
    ///
    /// # Errors
    /// Any error of the reader.
    pub fn fill(&mut self, reader: &mut impl Read) -> io::Result<usize> {
        self.input.drain(..self.given);
        self.given = 0;
        let from = self.input.len();
        self.input.resize(from + CHUNK, 0);
        let read = reader.read(self.input.get_mut(from..).unwrap_or_default());
        self.input.truncate(from + read.as_ref().map_or(0, |read| *read));
        self.ended |= matches!(read, Ok(0));
        read
    }

    /// The next piece; `None` if it needs more bytes, or at the end.
    pub fn piece(&mut self) -> Option<Piece<'_>> {
        let front = self.input.get(self.given..).filter(|front| !front.is_empty())?;
        let (read, mut len) = feitcsi::front(front);
        if len == front.len() && !self.ended && read.is_err() {
            if read == Err(Why::Cut) && len < LONGEST {
                return None;
            }
            // A record may begin in the last bytes.
            len = len.saturating_sub(feitcsi::HEAD - 1);
        }
        let bytes = front.get(..len).filter(|bytes| !bytes.is_empty())?;
        let offset = self.offset;
        self.given += len;
        self.offset += len as u64;
        Some(Piece { read, offset, bytes })
    }

    /// True once the reader has ended.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.ended
    }
}

/// Reads a FeitCSI log as a `.dat` log.
#[derive(Debug)]
pub struct Translated<R> {
    reader: R,
    translator: Translator,
    pieces: Pieces,
    output: Vec<u8>,
    given: usize,
}

impl<R> Translated<R> {
    /// Wraps the reader of a FeitCSI log.
    pub fn new(reader: R) -> Self {
        let (pieces, output) = (Pieces::default(), Vec::new());
        Self { reader, translator: Translator::default(), pieces, output, given: 0 }
    }
}

impl<R: Read> Read for Translated<R> {
    fn read(&mut self, room: &mut [u8]) -> io::Result<usize> {
        while self.given == self.output.len() {
            if self.pieces.has_ended() {
                return Ok(0);
            }
            self.output.clear();
            self.given = 0;
            self.pieces.fill(&mut self.reader)?;
            while let Some(piece) = self.pieces.piece() {
                self.translator.take(&piece.read, piece.offset, piece.bytes.len(), &mut self.output);
            }
        }
        let count = room.len().min(self.output.len() - self.given);
        let from = self.output.get(self.given..).unwrap_or_default();
        room.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
        self.given += count;
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi_formats::{Kind, Tones};
    use driver_iface::bfee::Bfee;
    use driver_iface::record::{self, LENGTH_FIELD, card_clock_ps, written};

    /// A record with a phase slope of `slope` radians per 312.5 kHz; the second chain is half a turn ahead.
    fn feitcsi((kind, width_mhz): (Kind, u16), at_ns: u64, slope: f64) -> Vec<u8> {
        let tones = Tones::of(kind, width_mhz).unwrap();
        let step = if kind == Kind::He { 0.25 } else { 1.0 };
        let value = |chain: f64, index: i16| {
            let (sin, cos) = (chain * std::f64::consts::PI + 0.7 - slope * step * f64::from(index)).sin_cos();
            [cos, sin].map(|part| (150.0 * part).round() as i16)
        };
        let csi: Vec<[i16; 2]> =
            [0.0, 1.0].iter().flat_map(|chain| tones.subcarriers.iter().map(|k| value(*chain, *k))).collect();
        let repr = feitcsi::Repr {
            ftm: (at_ns * 8 / 25) as u32,
            host_us: 1_700_000_000_000_000 + at_ns / 1_000,
            n_rx: 2,
            n_tx: 1,
            kind,
            width_mhz,
            mcs: 0,
            rssi_dbm: [-41, -50],
            sender: [2, 0, 0, 0, 0, 9],
            clock_us: (at_ns / 1_000) as u32,
        };
        let mut log = Vec::new();
        repr.emit(&csi, &mut log);
        log
    }

    /// Reads a few bytes at a time.
    struct Dribble<'a>(&'a [u8], usize);

    impl Read for Dribble<'_> {
        fn read(&mut self, room: &mut [u8]) -> io::Result<usize> {
            let (now, later) = self.0.split_at(self.1.min(room.len()).min(self.0.len()));
            room[..now.len()].copy_from_slice(now);
            self.0 = later;
            Ok(now.len())
        }
    }

    fn translated(log: &[u8], at_once: usize) -> Vec<u8> {
        let mut all = Vec::new();
        Translated::new(Dribble(log, at_once)).read_to_end(&mut all).unwrap();
        all
    }

    #[test]
    fn each_reported_subcarrier_has_the_phase_of_its_frequency() {
        for of in [
            (Kind::He, 20),
            (Kind::Ht, 20),
            (Kind::Legacy, 20),
            (Kind::He, 40),
            (Kind::Vht, 40),
            (Kind::Vht, 80),
            (Kind::He, 160),
        ] {
            let log = translated(&feitcsi(of, 5_000_000, 0.5), 4_096);
            let body = written(&log).nth(1).unwrap();
            let bfee = Bfee::new_checked(&body[LENGTH_FIELD + 1..]).unwrap();
            assert_eq!((bfee.n_rx(), bfee.rssi(), bfee.agc()), (2, [63, 54, 0], 60));
            assert_eq!(bfee.rate_n_flags() & WIDE != 0, of.1 > 40);
            assert_eq!(bfee.wsr().unwrap().mac, Mac([2, 0, 0, 0, 0, 9]));
            let indices = if of.1 == 40 { INDICES_40_MHZ } else { INDICES_20_MHZ };
            for (k, index) in indices.iter().enumerate() {
                for chain in [0, 1] {
                    let iq = bfee.iq(k, chain, 0).unwrap();
                    let got = Complex32::new(f32::from(iq.i), f32::from(iq.q));
                    let expected = chain as f32 * std::f32::consts::PI + 0.7 - 0.5 * f32::from(*index);
                    let off = (got * Complex32::cis(-expected)).arg();
                    assert!(off.abs() < 0.03 && got.norm() > 100.0, "{of:?} {index}: {off} {got}");
                }
            }
        }
    }

    #[test]
    fn the_coarse_clock_unwraps_the_fine_one_over_any_pause() {
        // The fine clock wraps after 13.4 s; half of the coarse one's period is 36 minutes. The last step is back, as after a
        // reset.
        let at_ns = [1_000_003, 2_000_009, 14_000_000_025, 70_000_000_050, 2_000_000_000_075, 1_999_000_000_000];
        let log: Vec<u8> = at_ns.iter().flat_map(|at| feitcsi((Kind::He, 20), *at, 0.0)).collect();
        let all = translated(&log, 4_096);
        let records: Vec<&[u8]> = written(&all).collect();
        for (two, at_ns) in records.chunks(2).zip(at_ns) {
            let left_ps = card_clock_ps(&two[0][LENGTH_FIELD + 1..]).unwrap();
            let bfee = Bfee::new_checked(&two[1][LENGTH_FIELD + 1..]).unwrap();
            let ps = i128::from(bfee.timestamp_low()) * PS_PER_US + i128::from(left_ps);
            let wanted_ps = i128::from(at_ns) * 1_000;
            let off = (ps - wanted_ps).abs();
            assert!(off < if at_ns == 1_999_000_000_000 { PS_PER_US } else { 3_126 }, "{at_ns}: {off} ps");
        }
        assert_eq!(records.len(), 12);
    }

    #[test]
    fn unusable_bytes_are_reported_with_offset_and_length_for_any_read_size() {
        let [good, wide] = [(Kind::He, 20), (Kind::He, 80)].map(|of| feitcsi(of, 1_000, 0.1));
        // 320 MHz: these cards have no such frames.
        let wide = [&wide[..92], &(4_u32 << 11 | 4 << 8).to_le_bytes(), &wide[96..]].concat();
        let log = [&good[..], &wide, &good, &[7; 500], &good, &good[..300]].concat();
        let all = translated(&log, 4_096);
        let said: Vec<(u8, Option<(u64, u64)>)> = written(&all)
            .map(|bytes| {
                (bytes[LENGTH_FIELD], record::left_out(&bytes[LENGTH_FIELD + 1..]).map(|(at, len, _)| (at, len)))
            })
            .filter(|(code, _)| *code != code::CARD_CLOCK)
            .map(|(code, place)| (code, place.filter(|_| code == code::LEFT_OUT)))
            .collect();
        let (good_len, wide_len) = (good.len() as u64, wide.len() as u64);
        let bfee = (code::BFEE, None);
        let left_out = |at: u64, len: u64| (code::LEFT_OUT, Some((at, len)));
        assert_eq!(said[..3], [bfee, left_out(good_len, wide_len), bfee]);
        assert_eq!(said[3..], [left_out(2 * good_len + wide_len, 500), bfee]);
        // The translated log ends cut too.
        assert!(all.ends_with(&[0, u8::MAX, code::BFEE]));
        for at_once in [97, 300] {
            let again = translated(&log, at_once);
            let bfees = |all: &[u8]| written(all).filter(|bytes| bytes[LENGTH_FIELD] == code::BFEE).count();
            assert_eq!(bfees(&again), bfees(&all), "{at_once} bytes at a time");
        }
    }
}
