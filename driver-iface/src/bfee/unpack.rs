//! Unpacks the CSI: a bit stream, least significant bit first.
//!
//! Each of 30 subcarriers has 3 bits that are not CSI (the SNR field of 802.11n 7.3.1.28, always 0), then `n_rx n_tx` samples of
//! 8 bits real and 8 bits imaginary, two's complement, tx fastest. Trailing bits are 0.

use super::{Bfee, SUBCARRIERS};

/// Samples of the largest record: 30 subcarriers, 3 by 3 chains.
pub const MAX_SAMPLES: usize = SUBCARRIERS * 9;

/// Bytes that [`Bfee::unpack_bytes`] needs for the largest record.
pub const MAX_SAMPLE_BYTES: usize = 2 * MAX_SAMPLES + WORD;

/// Bits before the samples of each subcarrier.
const GAP: usize = 3;
/// Bytes of a load for three samples.
const WORD: usize = 8;
/// Bytes of a load for one sample.
const LOAD: usize = 4;
/// Bytes of one sample of every subcarrier, and of the rest of the last load.
const COLUMN: usize = 2 * SUBCARRIERS + LOAD;
/// Samples in one 64-bit load at any bit offset: 48 bits and at most 7 before them.
const PER_WORD: usize = 3;

/// Bytes to be widened to floats, aligned so that no wide vector straddles two cache lines.
#[repr(align(64))]
struct Lines<const N: usize>([u8; N]);

/// One sample as the card reports it; +-127 and -128 mean saturation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Iq {
    /// Real part.
    pub i: i8,
    /// Imaginary part.
    pub q: i8,
}

/// First bit of sample `index` (`rx n_tx + tx`) of a subcarrier that has `n` samples.
const fn bit_of(subcarrier: usize, index: usize, n: usize) -> usize {
    GAP + subcarrier * (GAP + 16 * n) + 16 * index
}

/// At least 57 bits of the payload from `bit` on, in the low bits, or zeros after its end.
///
/// Near the end the load starts earlier, so it never leaves the payload (at least 72 bytes).
#[inline(always)]
fn word_at(payload: &[u8], bit: usize) -> u64 {
    let from = (bit / 8).min(payload.len().saturating_sub(8));
    let shift = bit - 8 * from;
    let word = payload.get(from..).and_then(|rest| rest.first_chunk());
    word.map_or(0, |word| u64::from_le_bytes(*word)) >> (shift & 63)
}

/// The sample in the low 16 bits.
const fn low_iq(word: u64) -> Iq {
    Iq { i: word as i8, q: (word >> 8) as i8 }
}

/// Unpacks `N` chain pairs to bytes, one word per three samples: the last word ends after the samples. `None` if a slice is too
/// short.
#[inline(always)]
fn unpack_bytes_n<const N: usize>(payload: &[u8], bytes: &mut [u8]) -> Option<usize> {
    let payload = payload.get(..60 * N + 12)?;
    let bytes = bytes.get_mut(..60 * N + WORD)?;
    for octave in 0..3 {
        let from = octave * (GAP + 16 * N);
        let to = octave * 16 * N;
        unpack_run::<N, 8>(payload.get(from..from + GAP + 16 * N + 8)?, bytes.get_mut(to..to + 16 * N + WORD)?);
    }
    unpack_run::<N, 6>(payload.get(3 * (GAP + 16 * N)..)?, bytes.get_mut(48 * N..)?);
    Some(SUBCARRIERS * N)
}

/// Unpacks and widens `N` chain pairs; `BYTES` is `60 N` and room for one word. `None` if a slice is too short.
///
/// First to bytes, then all bytes to floats, in a loop that compilers vectorise.
#[inline(always)]
fn unpack_f32_n<const N: usize, const BYTES: usize>(payload: &[u8], out: &mut [f32]) -> Option<usize> {
    let out = out.get_mut(..2 * SUBCARRIERS * N)?;
    let mut bytes = Lines([0; BYTES]);
    unpack_bytes_n::<N>(payload, &mut bytes.0)?;
    widen(&bytes.0, out);
    Some(SUBCARRIERS * N)
}

/// Bytes of `COUNT` consecutive subcarriers, the first of which begins on a byte of `payload`; every eighth one does.
///
/// With both counts known at compile time the loop unrolls, and all offsets and shifts are constants.
#[inline(always)]
fn unpack_run<const N: usize, const COUNT: usize>(payload: &[u8], bytes: &mut [u8]) {
    for subcarrier in 0..COUNT {
        for first in (0..N).step_by(PER_WORD) {
            let word = word_at(payload, bit_of(subcarrier, first, N));
            let at = 2 * (subcarrier * N + first);
            // An array, because copying a slice may be a call.
            if let Some(place) = bytes.get_mut(at..).and_then(|rest| rest.first_chunk_mut()) {
                *place = word.to_le_bytes();
            }
        }
    }
}

/// Unpacks `N` chain pairs, with the samples of each adjacent. `None` if a slice is too short.
#[inline(always)]
fn unpack_planes_n<const N: usize>(payload: &[u8], out: &mut [[i8; 2]]) -> Option<usize> {
    let payload = payload.get(..60 * N + 12)?;
    let planes = out.as_chunks_mut::<SUBCARRIERS>().0.first_chunk_mut::<N>()?;
    for octave in 0..3 {
        let from = octave * (GAP + 16 * N);
        unpack_planes_run::<N, 8>(payload.get(from..from + GAP + 16 * N + 8)?, planes, 8 * octave);
    }
    unpack_planes_run::<N, 6>(payload.get(3 * (GAP + 16 * N)..)?, planes, 24);
    Some(SUBCARRIERS * N)
}

/// Samples of `COUNT` consecutive subcarriers from `first` on, which begins on a byte of `payload`; see [`unpack_run`].
#[inline(always)]
fn unpack_planes_run<const N: usize, const COUNT: usize>(
    payload: &[u8],
    planes: &mut [[[i8; 2]; SUBCARRIERS]; N],
    first: usize,
) {
    for subcarrier in 0..COUNT {
        for part in (0..N).step_by(PER_WORD) {
            let mut word = word_at(payload, bit_of(subcarrier, part, N));
            for plane in planes.iter_mut().skip(part).take(PER_WORD) {
                if let Some(sample) = plane.get_mut(first + subcarrier) {
                    *sample = [word as i8, (word >> 8) as i8];
                }
                word >>= 16;
            }
        }
    }
}

/// The place of a sample in the payload: the first byte of a load, and the bits before the sample in it.
#[derive(Clone, Copy)]
struct Place {
    from: u16,
    shift: u16,
}

impl Place {
    /// The place of sample `index` of the subcarrier that begins at `bit`, in a payload of `len` bytes. Near the end the load starts
    /// earlier, as in [`word_at`].
    #[inline(always)]
    const fn new(len: usize, bit: usize, index: usize) -> Self {
        let (wanted, last) = (bit / 8 + 2 * index, len.saturating_sub(LOAD));
        let from = if wanted < last { wanted } else { last };
        Self { from: from as u16, shift: (8 * (wanted - from) + bit % 8) as u16 }
    }

    /// The sample in the low half.
    #[inline(always)]
    fn load(self, payload: &[u8]) -> u32 {
        let rest = payload.get(self.from.into()..);
        rest.and_then(|rest| rest.first_chunk()).map_or(0, |word| u32::from_le_bytes(*word)) >> (self.shift & 31)
    }

    /// The two bytes of the sample.
    #[inline(always)]
    fn sample(self, payload: &[u8]) -> [u8; 2] {
        (self.load(payload) as u16).to_le_bytes()
    }
}

/// The places of `N` chain pairs' samples: for each pair, every subcarrier's.
struct Places<const N: usize>;

impl<const N: usize> Places<N> {
    const OF: &[[Place; SUBCARRIERS]; N] = &{
        let mut places = [[Place { from: 0, shift: 0 }; SUBCARRIERS]; N];
        let mut at = 0;
        while at < SUBCARRIERS * N {
            let (subcarrier, index) = (at / N, at % N);
            places[index][subcarrier] = Place::new(60 * N + 12, bit_of(subcarrier, 0, N), index);
            at += 1;
        }
        places
    };
}

/// True for all subcarriers in order. Comparing an array needs no call.
#[inline(always)]
fn is_whole(subcarriers: &[u8]) -> bool {
    <&[u8; SUBCARRIERS]>::try_from(subcarriers).is_ok_and(|numbers| *numbers == ALL_SUBCARRIERS)
}

/// True if all numbers are subcarrier indices; checks eight at once, and skips a whole column's.
#[inline(always)]
fn are_subcarriers(numbers: &[u8]) -> bool {
    let outside = |numbers: &[u8]| numbers.iter().fold(false, |any, &s| any | (usize::from(s) >= SUBCARRIERS));
    let (eights, rest) = numbers.as_chunks::<8>();
    is_whole(numbers) || !eights.iter().fold(outside(rest), |any, eight| any | outside(eight))
}

/// One sample of each requested subcarrier, of `N` chain pairs, widened.
#[inline(always)]
fn column_f32_n<const N: usize>(payload: &[u8], index: usize, subcarriers: &[u8], out: &mut [[f32; 2]]) -> Option<()> {
    let payload = payload.get(..60 * N + 12)?;
    if let Ok(out) = out.try_into()
        && is_whole(subcarriers)
    {
        return column_f32_all::<N>(payload, index, out);
    }
    let places = Places::<N>::OF.get(index)?;
    let sample = |subcarrier: u8| places.get(usize::from(subcarrier)).map_or([0; 2], |place| place.sample(payload));
    let (fours, rest) = subcarriers.as_chunks::<4>();
    let (out_fours, out_rest) = out.split_at_mut(4 * fours.len());
    for (out, four) in out_fours.as_chunks_mut::<4>().0.iter_mut().zip(fours) {
        // Combined in a register: through memory the wide load would wait for the narrow stores.
        let word = four.iter().rev().fold(0, |word, &s| word << 16 | u64::from(u16::from_le_bytes(sample(s))));
        widen(&word.to_le_bytes(), out.as_flattened_mut());
    }
    for (out, &subcarrier) in out_rest.iter_mut().zip(rest) {
        widen(&sample(subcarrier), out);
    }
    Some(())
}

/// One sample of every subcarrier: gathered first, so that widening vectorises.
#[inline(always)]
fn column_f32_all<const N: usize>(payload: &[u8], index: usize, out: &mut [[f32; 2]; SUBCARRIERS]) -> Option<()> {
    widen(&gather::<N>(payload, index)?.0, out.as_flattened_mut());
    Some(())
}

/// The bytes of one sample of every subcarrier.
#[inline(always)]
fn gather<const N: usize>(payload: &[u8], index: usize) -> Option<Lines<COLUMN>> {
    let payload = payload.get(..60 * N + 12)?;
    let mut bytes = Lines([0; COLUMN]);
    for octave in 0..3 {
        let from = octave * (GAP + 16 * N) + 2 * index;
        gather_run::<N, 8>(payload.get(from..from + 14 * N + 6)?, bytes.0.get_mut(16 * octave..)?);
    }
    let from = 3 * (GAP + 16 * N) + 2 * index;
    gather_run::<N, 6>(payload.get(from..from + 10 * N + 5)?, bytes.0.get_mut(48..)?);
    Some(bytes)
}

/// One sample of each of `COUNT` consecutive subcarriers, the first of which begins on a byte of `payload`, as every eighth one
/// does: all offsets are constants. Each is written with the rest of its load, which the next one overwrites.
#[inline(always)]
fn gather_run<const N: usize, const COUNT: usize>(payload: &[u8], bytes: &mut [u8]) {
    for subcarrier in 0..COUNT {
        let place = bytes.get_mut(2 * subcarrier..).and_then(|rest| rest.first_chunk_mut());
        if let Some(place) = place {
            *place = Place::new(payload.len(), bit_of(subcarrier, 0, N), 0).load(payload).to_le_bytes();
        }
    }
}

/// Bytes to floats, as many as the shorter slice has.
#[inline(always)]
fn widen(bytes: &[u8], out: &mut [f32]) {
    for (value, &byte) in out.iter_mut().zip(bytes) {
        *value = f32::from(byte.cast_signed());
    }
}

/// All subcarriers, in order: the argument of [`Bfee::column`] for a whole column.
#[rustfmt::skip]
pub const ALL_SUBCARRIERS: [u8; SUBCARRIERS] = [
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29,
];

impl Bfee<'_> {
    /// Number of samples in the record, `30 n_rx n_tx`.
    #[must_use]
    pub fn samples(&self) -> usize {
        SUBCARRIERS * self.n_rx() * self.n_tx()
    }

    /// One sample, or `None` if an index is out of range.
    #[must_use]
    pub fn iq(&self, subcarrier: usize, rx: usize, tx: usize) -> Option<Iq> {
        let inside = subcarrier < SUBCARRIERS && rx < self.n_rx() && tx < self.n_tx();
        let n = self.n_rx() * self.n_tx();
        inside.then(|| low_iq(word_at(self.payload(), bit_of(subcarrier, rx * self.n_tx() + tx, n))))
    }

    /// Unpacks everything bit by bit: slow, obvious, and the oracle of the fast ways.
    ///
    /// Writes `[subcarrier][rx][tx]` to `out` and returns the number of samples; `None` if `out` is too short.
    pub fn unpack_bits(&self, out: &mut [Iq]) -> Option<usize> {
        let payload = self.payload();
        let bit = |at: usize| payload.get(at / 8).map_or(0, |byte| byte >> (at % 8) & 1);
        let byte = |at: usize| (0..8).fold(0, |byte, k| byte | bit(at + k) << k).cast_signed();
        let n = self.n_rx() * self.n_tx();
        let out = out.get_mut(..self.samples())?;
        for (k, iq) in out.iter_mut().enumerate() {
            let at = bit_of(k / n, k % n, n);
            *iq = Iq { i: byte(at), q: byte(at + 8) };
        }
        Some(self.samples())
    }

    /// Unpacks everything with 64-bit loads, `[subcarrier][rx][tx]`; `None` if `out` is too short.
    pub fn unpack(&self, out: &mut [Iq]) -> Option<usize> {
        let n = self.n_rx() * self.n_tx();
        let out = out.get_mut(..self.samples())?;
        for (subcarrier, row) in out.chunks_exact_mut(n).enumerate() {
            for (part, samples) in row.chunks_mut(PER_WORD).enumerate() {
                let mut word = word_at(self.payload(), bit_of(subcarrier, PER_WORD * part, n));
                for iq in samples {
                    *iq = low_iq(word);
                    word >>= 16;
                }
            }
        }
        Some(self.samples())
    }

    /// Unpacks everything to `f32`, re and im alternating, `[subcarrier][rx][tx][re, im]`.
    ///
    /// Returns the number of samples (half the number of floats); `None` if `out` is too short.
    ///
    /// Inlined, like [`Bfee::unpack_bytes`] and [`Bfee::column_f32`], so that callers compiled for wide vectors use those here.
    #[inline(always)]
    pub fn unpack_f32(&self, out: &mut [f32]) -> Option<usize> {
        let payload = self.payload();
        match self.n_rx() * self.n_tx() {
            1 => unpack_f32_n::<1, 68>(payload, out),
            2 => unpack_f32_n::<2, 128>(payload, out),
            3 => unpack_f32_n::<3, 188>(payload, out),
            4 => unpack_f32_n::<4, 248>(payload, out),
            6 => unpack_f32_n::<6, 368>(payload, out),
            _ => unpack_f32_n::<9, 548>(payload, out),
        }
    }

    /// Unpacks everything in the order of the payload, `[subcarrier][rx][tx][i, q]`, two's complement.
    ///
    /// Returns the number of samples (half the number of bytes); `None` if `out` does not have 8 more bytes than they take. Those
    /// may be overwritten.
    #[inline(always)]
    pub fn unpack_bytes(&self, out: &mut [u8]) -> Option<usize> {
        let payload = self.payload();
        match self.n_rx() * self.n_tx() {
            1 => unpack_bytes_n::<1>(payload, out),
            2 => unpack_bytes_n::<2>(payload, out),
            3 => unpack_bytes_n::<3>(payload, out),
            4 => unpack_bytes_n::<4>(payload, out),
            6 => unpack_bytes_n::<6>(payload, out),
            _ => unpack_bytes_n::<9>(payload, out),
        }
    }

    /// Unpacks everything, one chain pair after the other, `[rx][tx][subcarrier][i, q]`, for work antenna by antenna.
    ///
    /// Returns the number of samples; `None` if `out` is too short.
    pub fn unpack_planes(&self, out: &mut [[i8; 2]]) -> Option<usize> {
        let payload = self.payload();
        match self.n_rx() * self.n_tx() {
            1 => unpack_planes_n::<1>(payload, out),
            2 => unpack_planes_n::<2>(payload, out),
            3 => unpack_planes_n::<3>(payload, out),
            4 => unpack_planes_n::<4>(payload, out),
            6 => unpack_planes_n::<6>(payload, out),
            _ => unpack_planes_n::<9>(payload, out),
        }
    }

    /// Unpacks one chain pair at the requested subcarriers only.
    ///
    /// Returns the number of samples; `None` if an index is out of range or `out` is shorter than `subcarriers`.
    pub fn column(&self, rx: usize, tx: usize, subcarriers: &[u8], out: &mut [Iq]) -> Option<usize> {
        let index = self.column_index(rx, tx, subcarriers)?;
        let n = self.n_rx() * self.n_tx();
        if is_whole(subcarriers) {
            let bytes = match n {
                1 => gather::<1>(self.payload(), index),
                2 => gather::<2>(self.payload(), index),
                3 => gather::<3>(self.payload(), index),
                4 => gather::<4>(self.payload(), index),
                6 => gather::<6>(self.payload(), index),
                _ => gather::<9>(self.payload(), index),
            }?;
            let pairs = bytes.0.as_chunks::<2>().0;
            for (out, [i, q]) in out.get_mut(..SUBCARRIERS)?.iter_mut().zip(pairs) {
                *out = Iq { i: i.cast_signed(), q: q.cast_signed() };
            }
            return Some(SUBCARRIERS);
        }
        for (out, &subcarrier) in out.get_mut(..subcarriers.len())?.iter_mut().zip(subcarriers) {
            let bit = bit_of(usize::from(subcarrier), 0, n);
            let [i, q] = Place::new(self.payload().len(), bit, index).sample(self.payload()).map(u8::cast_signed);
            *out = Iq { i, q };
        }
        Some(subcarriers.len())
    }

    /// [`Bfee::column`] to `f32`, re and im alternating; `out` needs at least two floats per subcarrier.
    #[inline(always)]
    pub fn column_f32(&self, rx: usize, tx: usize, subcarriers: &[u8], out: &mut [f32]) -> Option<usize> {
        let index = self.column_index(rx, tx, subcarriers)?;
        let (out, _) = out.get_mut(..2 * subcarriers.len())?.as_chunks_mut::<2>();
        let payload = self.payload();
        match self.n_rx() * self.n_tx() {
            1 => column_f32_n::<1>(payload, index, subcarriers, out),
            2 => column_f32_n::<2>(payload, index, subcarriers, out),
            3 => column_f32_n::<3>(payload, index, subcarriers, out),
            4 => column_f32_n::<4>(payload, index, subcarriers, out),
            6 => column_f32_n::<6>(payload, index, subcarriers, out),
            _ => column_f32_n::<9>(payload, index, subcarriers, out),
        }?;
        Some(subcarriers.len())
    }

    /// True if the bits that carry no CSI are all 0, as the firmware writes them.
    ///
    /// 96 bits in all, spread over the payload: they show bytes lost or inserted before them.
    #[must_use]
    pub fn gaps_are_clear(&self) -> bool {
        let n = self.n_rx() * self.n_tx();
        let gaps = (0..SUBCARRIERS).fold(0, |all, s| all | word_at(self.payload(), bit_of(s, 0, n) - GAP) & 7);
        gaps | word_at(self.payload(), bit_of(SUBCARRIERS, 0, n) - GAP) == 0
    }

    /// Position of a chain pair among a subcarrier's samples, if it and all `subcarriers` are in range.
    #[inline]
    fn column_index(&self, rx: usize, tx: usize, subcarriers: &[u8]) -> Option<usize> {
        let inside = rx < self.n_rx() && tx < self.n_tx() && are_subcarriers(subcarriers);
        inside.then(|| rx * self.n_tx() + tx)
    }
}
