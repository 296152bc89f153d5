//! CSI matrices: which antenna is which, how strong the signal was, and in what units.
//!
//! The card reports small integers whose scale floats with its gain control. [`Csi::from_bfee`] puts the receive
//! chains in antenna order; [`scale_factor`] turns the integers into sqrt(SNR), the channel's gain over the noise.
//! The steps are those of csitool \[csitool\] (`get_total_rss.m`, `get_scaled_csi.m`, `remove_sm.m`).

use std::f64::consts::TAU;
use std::sync::LazyLock;

use driver_iface::bfee::{Antenna, Bfee, InvalidPerm, MAX_SAMPLES, NOISE_UNKNOWN_DBM, SUBCARRIERS};
use num_complex::{Complex32, Complex64};

/// RSSI values are dB above this level, below the gain: subtracted to reach dBm (csitool `get_total_rss.m`).
const RSSI_OFFSET_DB: i32 = 44;
/// Noise floor taken when the driver measured none, dBm (csitool `get_scaled_csi.m`).
const DEFAULT_NOISE_DBM: i8 = -92;
/// 4.5 dB as an amplitude: what csitool uses for three streams, instead of the exact sqrt(3) = 4.77 dB.
const THREE_STREAMS: f64 = 1.678_804_018_122_559_7;

/// The CSI of one frame, `h[subcarrier][rx][tx]`, tx fastest, held inline.
///
/// `rx` counts rows: antennas from A on, or raw chains where the record was read as [`Csi::raw`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Csi {
    h: [Complex32; MAX_SAMPLES],
    n_rx: usize,
    n_tx: usize,
    antennas: Option<[Antenna; 3]>,
}

/// Why CSI has no scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ScaleError {
    /// No antenna heard anything.
    #[error("RSSI is 0 on antennas A, B and C (AGC {agc} dB): received power is unknown")]
    NoRssi {
        /// The receiver's gain, dB.
        agc: u8,
    },
    /// Nothing to scale.
    #[error("all {values} CSI values are 0")]
    ZeroCsi {
        /// How many there are.
        values: usize,
    },
}

impl Csi {
    /// Rows in antenna order: the first row is the first antenna used, A if it was, and so on.
    ///
    /// # Errors
    /// [`InvalidPerm`] when the record does not say which antenna is which; [`Csi::raw`] reads it all the same.
    pub fn from_bfee(bfee: &Bfee<'_>) -> Result<Self, InvalidPerm> {
        let perm = bfee.antennas()?;
        let raw = Self::raw(bfee);
        let mut csi = raw;
        let mut antennas = [Antenna::A; 3];
        let used = Antenna::ALL.into_iter().filter_map(|antenna| Some((antenna, perm.chain_of(antenna)?)));
        for (row, (antenna, chain)) in used.enumerate() {
            antennas[row] = antenna;
            for subcarrier in 0..SUBCARRIERS {
                let (to, from) = (raw.index(subcarrier, row, 0), raw.index(subcarrier, chain, 0));
                csi.h[to..to + raw.n_tx].copy_from_slice(&raw.h[from..from + raw.n_tx]);
            }
        }
        csi.antennas = Some(antennas);
        Ok(csi)
    }

    /// Rows in the order of the receive chains, whichever antennas they were connected to: the same antenna moves from
    /// row to row between frames of one link.
    #[must_use]
    pub fn raw(bfee: &Bfee<'_>) -> Self {
        let mut re_im = [0.0; 2 * MAX_SAMPLES];
        bfee.unpack_f32(&mut re_im);
        let (pairs, _) = re_im.as_chunks::<2>();
        let h = std::array::from_fn(|k| Complex32::new(pairs[k][0], pairs[k][1]));
        Self { h, n_rx: bfee.n_rx(), n_tx: bfee.n_tx(), antennas: None }
    }

    /// Number of rows: receive chains used.
    #[must_use]
    pub fn n_rx(&self) -> usize {
        self.n_rx
    }

    /// Number of columns: space-time streams.
    #[must_use]
    pub fn n_tx(&self) -> usize {
        self.n_tx
    }

    /// One entry, or `None` outside the matrix.
    #[must_use]
    pub fn get(&self, subcarrier: usize, rx: usize, tx: usize) -> Option<Complex32> {
        let inside = subcarrier < SUBCARRIERS && rx < self.n_rx && tx < self.n_tx;
        inside.then(|| self.h[self.index(subcarrier, rx, tx)])
    }

    /// All entries, `[subcarrier][rx][tx]`, tx fastest.
    #[must_use]
    pub fn as_slice(&self) -> &[Complex32] {
        &self.h[..SUBCARRIERS * self.n_rx * self.n_tx]
    }

    /// The antenna of a row; `None` beyond the last and for raw chains.
    #[must_use]
    pub fn antenna(&self, rx: usize) -> Option<Antenna> {
        self.antennas?.get(..self.n_rx)?.get(rx).copied()
    }

    /// The row of an antenna; `None` if it was not used and for raw chains.
    #[must_use]
    pub fn row(&self, antenna: Antenna) -> Option<usize> {
        (0..self.n_rx).find(|&rx| self.antenna(rx) == Some(antenna))
    }

    /// Sum of squared magnitudes of all entries.
    #[must_use]
    pub fn power(&self) -> f64 {
        self.as_slice().iter().map(|h| f64::from(h.norm_sqr())).sum()
    }

    /// The CSI in sqrt(SNR): [`scale_factor`] times the record's integers.
    ///
    /// # Errors
    /// When the record has no RSSI or no CSI to scale.
    pub fn scaled(&self, bfee: &Bfee<'_>) -> Result<Self, ScaleError> {
        let factor = scale_factor(bfee)? as f32;
        Ok(Self { h: self.h.map(|h| h * factor), ..*self })
    }

    /// Takes out the matrix with which the transmitter spreads streams over its antennas, so that columns are transmit
    /// antennas: `H = C Q^H` for each subcarrier. One stream has none. Cyclic shifts stay in.
    ///
    /// The matrices are those of Intel transmitters (csitool `sm_matrices.m`); others may spread otherwise.
    #[must_use]
    pub fn without_spatial_mapping(&self, is_40_mhz: bool) -> Self {
        let q = match (self.n_tx, is_40_mhz) {
            (2, false) => two_streams([[0.0, 0.0], [0.0, 0.5]]),
            (2, true) => two_streams([[0.0, 0.25], [0.25, 0.0]]),
            (3, false) => three_streams(&Q3_20_MHZ),
            (3, true) => three_streams(&Q3_40_MHZ),
            _ => return *self,
        };
        let mut out = *self;
        for (row, mapped) in out.h.chunks_exact_mut(self.n_tx).zip(self.h.chunks_exact(self.n_tx)) {
            for (h, q_row) in row.iter_mut().zip(&q) {
                *h = mapped.iter().zip(q_row).map(|(c, q)| c * q.conj()).sum();
            }
        }
        out
    }

    fn index(&self, subcarrier: usize, rx: usize, tx: usize) -> usize {
        (subcarrier * self.n_rx + rx) * self.n_tx + tx
    }
}

/// Turns of the 3-stream matrix at 20 MHz (csitool `sm_matrices.m`).
const Q3_20_MHZ: [[f64; 3]; 3] = [
    [-1.0 / 16.0, -33.0 / 80.0, 3.0 / 80.0],
    [23.0 / 80.0, 13.0 / 48.0, 13.0 / 240.0],
    [-13.0 / 80.0, 37.0 / 240.0, 13.0 / 48.0],
];
/// The same at 40 MHz.
const Q3_40_MHZ: [[f64; 3]; 3] = [
    [-1.0 / 16.0, -13.0 / 80.0, 23.0 / 80.0],
    [-37.0 / 80.0, -11.0 / 48.0, -107.0 / 240.0],
    [7.0 / 80.0, -83.0 / 240.0, -11.0 / 48.0],
];

type Mapping = [[Complex32; 3]; 3];

fn unit(turns: f64, streams: f64) -> Complex32 {
    let q = Complex64::from_polar(streams.sqrt().recip(), TAU * turns);
    Complex32::new(q.re as f32, q.im as f32)
}

fn two_streams(turns: [[f64; 2]; 2]) -> Mapping {
    let mut q = [[Complex32::default(); 3]; 3];
    for (row, turns) in q.iter_mut().zip(turns) {
        row[..2].copy_from_slice(&turns.map(|turns| unit(turns, 2.0)));
    }
    q
}

fn three_streams(turns: &[[f64; 3]; 3]) -> Mapping {
    turns.map(|row| row.map(|turns| unit(turns, 3.0)))
}

/// Whole decibels that records hold: a noise floor of -128 dBm, a gain of 255 dB above an RSSI of 0, and an RSSI of 255 dB.
const DECIBELS: std::ops::RangeInclusive<i32> = -(RSSI_OFFSET_DB + 255)..=255;

/// The power ratio of each of [`DECIBELS`].
static RATIOS: LazyLock<Vec<f64>> = LazyLock::new(|| DECIBELS.map(|db| 10_f64.powf(f64::from(db) / 10.0)).collect());

/// The power ratio of decibels.
fn ratio(db: i32) -> f64 {
    let place = usize::try_from(db - DECIBELS.start()).ok().and_then(|place| RATIOS.get(place));
    place.copied().unwrap_or_else(|| 10_f64.powf(f64::from(db) / 10.0))
}

/// The RSSI values that are not 0, added as powers above the reference.
fn heard(bfee: &Bfee<'_>) -> Result<f64, ScaleError> {
    let power: f64 = bfee.rssi().into_iter().filter(|&rssi| rssi != 0).map(|rssi| ratio(i32::from(rssi))).sum();
    if power == 0.0 { Err(ScaleError::NoRssi { agc: bfee.agc() }) } else { Ok(power) }
}

/// Received power over all antennas, dBm: the RSSI values that are not 0, added as powers, less 44 dB and the gain.
///
/// # Errors
/// [`ScaleError::NoRssi`] when all are 0.
pub fn total_rss_dbm(bfee: &Bfee<'_>) -> Result<f64, ScaleError> {
    Ok(10.0 * heard(bfee)?.log10() - f64::from(RSSI_OFFSET_DB) - f64::from(bfee.agc()))
}

/// Noise floor, dBm: the driver's, or -92 if it has none.
#[must_use]
pub fn noise_dbm(bfee: &Bfee<'_>) -> f64 {
    f64::from(whole_noise_dbm(bfee))
}

fn whole_noise_dbm(bfee: &Bfee<'_>) -> i8 {
    match bfee.noise_dbm() {
        NOISE_UNKNOWN_DBM => DEFAULT_NOISE_DBM,
        measured => measured,
    }
}

/// What the record's integers are multiplied with to be in sqrt(SNR).
///
/// The received power fixes the scale of the integers, the noise is the thermal floor and the error of rounding (1 for
/// each entry, on that scale), and streams share the transmit power.
///
/// # Errors
/// [`ScaleError`] when all RSSI or all CSI is 0.
pub fn scale_factor(bfee: &Bfee<'_>) -> Result<f64, ScaleError> {
    let mut samples = [[0; 2]; MAX_SAMPLES];
    let count = bfee.unpack_planes(&mut samples).unwrap_or(0);
    scale_factor_of(bfee, samples.get(..count).unwrap_or_default())
}

/// [`scale_factor`] of a record whose `samples` were unpacked before: all of them, in any order.
///
/// # Errors
/// [`ScaleError`] when all RSSI or all CSI is 0.
#[doc(hidden)]
#[inline(always)]
pub fn scale_factor_of(bfee: &Bfee<'_>, samples: &[[i8; 2]]) -> Result<f64, ScaleError> {
    // 540 squares of 2^14 at most. Summed where this is inlined, by the vectors that are compiled for there.
    let samples = samples.get(..MAX_SAMPLES).unwrap_or(samples);
    scale_factor_by(bfee, samples.as_flattened().iter().map(|&value| i32::from(value) * i32::from(value)).sum())
}

/// [`scale_factor`] of a record the squares of whose integers have this sum.
fn scale_factor_by(bfee: &Bfee<'_>, squares: i32) -> Result<f64, ScaleError> {
    let milliwatt = heard(bfee)? * ratio(-(RSSI_OFFSET_DB + i32::from(bfee.agc())));
    if squares == 0 {
        return Err(ScaleError::ZeroCsi { values: bfee.samples() });
    }
    let milliwatt_per_unit = milliwatt / (f64::from(squares) / SUBCARRIERS as f64);
    let rounding = milliwatt_per_unit * (bfee.n_rx() * bfee.n_tx()) as f64;
    let noise = ratio(i32::from(whole_noise_dbm(bfee))) + rounding;
    let streams = match bfee.n_tx() {
        2 => std::f64::consts::SQRT_2,
        3 => THREE_STREAMS,
        _ => 1.0,
    };
    Ok((milliwatt_per_unit / noise).sqrt() * streams)
}

#[cfg(test)]
mod tests;
