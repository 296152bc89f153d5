//! CSI matrices: which antenna is which, how strong the signal was, and in what units.
//!
//! The card reports small integers whose scale floats with its gain control. [`Csi::from_bfee`] puts the receive
//! chains in antenna order; [`scale_factor`] turns the integers into sqrt(SNR), the channel's gain over the noise.
//! The steps are those of csitool \[csitool\] (`get_total_rss.m`, `get_scaled_csi.m`, `remove_sm.m`).

use driver_iface::bfee::{Antenna, Bfee, InvalidPerm, MAX_SAMPLES, NOISE_UNKNOWN_DBM, SUBCARRIERS};
use num_complex::{Complex32, Complex64};
use std::f64::consts::TAU;
use std::sync::LazyLock;

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
fn noise_dbm(bfee: &Bfee<'_>) -> i8 {
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
    let noise = ratio(i32::from(noise_dbm(bfee))) + rounding;
    let streams = match bfee.n_tx() {
        2 => std::f64::consts::SQRT_2,
        3 => THREE_STREAMS,
        _ => 1.0,
    };
    Ok((milliwatt_per_unit / noise).sqrt() * streams)
}

#[cfg(test)]
mod tests {
    use super::*;
    use driver_iface::bfee::{Iq, Repr};
    use driver_iface::record::{Step, events};
    use std::path::{Path, PathBuf};

    fn emitted(repr: Repr, csi: &[Iq]) -> Vec<u8> {
        let mut body = vec![0; repr.body_len()];
        repr.emit(csi, &mut body).unwrap();
        body
    }

    /// Every entry of raw chain `k` is `k + 1 + (subcarrier) j`.
    fn by_chain(repr: &Repr) -> Vec<Iq> {
        let (n_rx, n_tx) = (usize::from(repr.n_rx), usize::from(repr.n_tx));
        let entry = |k: usize| Iq { i: (k / n_tx % n_rx + 1) as i8, q: (k / n_tx / n_rx) as i8 };
        (0..repr.samples()).map(entry).collect()
    }

    #[test]
    fn rows_are_antennas_and_chains_stay_reachable() {
        // B, C, A as in the csiread sample.
        let repr = Repr { antenna_sel: 0x09, ..Repr::default() };
        let body = emitted(repr, &by_chain(&repr));
        let bfee = Bfee::new_checked(&body).unwrap();
        let (csi, raw) = (Csi::from_bfee(&bfee).unwrap(), Csi::raw(&bfee));
        let re = |csi: &Csi, rx| csi.get(29, rx, 0).unwrap();
        assert_eq!([0, 1, 2].map(|k| re(&raw, k).re), [1.0, 2.0, 3.0]);
        assert_eq!([0, 1, 2].map(|k| re(&csi, k).re), [3.0, 1.0, 2.0]);
        assert_eq!(re(&csi, 0).im, 29.0);
        assert_eq!([csi.row(Antenna::A), csi.row(Antenna::C), raw.row(Antenna::A)], [Some(0), Some(2), None]);
        assert_eq!((csi.antenna(1), csi.antenna(3), raw.antenna(0)), (Some(Antenna::B), None, None));
        assert_eq!((csi.get(30, 0, 0), csi.get(0, 3, 0), csi.get(0, 0, 1)), (None, None, None));
    }

    #[test]
    fn two_chains_of_antennas_c_and_a() {
        let repr = Repr { n_rx: 2, n_tx: 2, antenna_sel: 0x02, rssi: [20, 0, 30], ..Repr::default() };
        let body = emitted(repr, &by_chain(&repr));
        let csi = Csi::from_bfee(&Bfee::new_checked(&body).unwrap()).unwrap();
        assert_eq!((csi.n_rx(), csi.n_tx(), csi.as_slice().len()), (2, 2, 120));
        assert_eq!((csi.antenna(0), csi.antenna(1), csi.antenna(2)), (Some(Antenna::A), Some(Antenna::C), None));
        assert_eq!(csi.get(0, 0, 1).unwrap().re, 2.0);
        assert_eq!((csi.row(Antenna::B), csi.row(Antenna::C)), (None, Some(1)));
    }

    #[test]
    fn an_invalid_permutation_is_an_error_and_raw_still_reads() {
        let repr = Repr { antenna_sel: 0x3f, ..Repr::default() };
        let body = emitted(repr, &by_chain(&repr));
        let bfee = Bfee::new_checked(&body).unwrap();
        let error = Csi::from_bfee(&bfee).unwrap_err();
        assert_eq!(error, InvalidPerm { antenna_sel: 0x3f, n_rx: 3 });
        assert!(error.to_string().contains("0x3f"));
        assert_eq!(Csi::raw(&bfee).get(0, 2, 0).unwrap().re, 3.0);
    }

    /// RSSI 20, 0, 20 and AGC 19: 10 log10(200) - 44 - 19 = -39.98970 dBm = 200 x 5.0118723e-7 mW. 3 x 1 entries of 3 + 4j: power
    /// 75 for each subcarrier, 1.00237447e-4 / 75 = 1.33649929e-6 mW a unit; noise 6.3095734e-10 mW + 3 x that.
    #[test]
    fn scaling_of_a_record_computed_by_hand() {
        let repr = Repr { rssi: [20, 0, 20], agc: 19, ..Repr::default() };
        let body = emitted(repr, &[Iq { i: 3, q: 4 }; 90]);
        let bfee = Bfee::new_checked(&body).unwrap();
        let rss = total_rss_dbm(&bfee).unwrap();
        assert!((rss + 39.989_700_04).abs() < 1e-8, "{rss}");
        let factor = scale_factor(&bfee).unwrap();
        let by_hand = 1.0 / (6.309_573_445e-10_f64 / 1.336_499_29e-6 + 3.0).sqrt();
        assert!((factor - by_hand).abs() < 1e-9, "{factor} {by_hand}");
        // A measured noise floor 40 dB higher counts instead of the default.
        let noisy = emitted(Repr { noise_dbm: -52, ..repr }, &[Iq { i: 3, q: 4 }; 90]);
        let factor = scale_factor(&Bfee::new_checked(&noisy).unwrap()).unwrap();
        let by_hand = 1.0 / (6.309_573_445e-6_f64 / 1.336_499_29e-6 + 3.0).sqrt();
        assert!((factor - by_hand).abs() < 1e-9, "{factor} {by_hand}");
    }

    /// All entries 1 and all noise from rounding: the factor is 1 / sqrt(n_rx n_tx) times the share of the streams.
    #[test]
    fn streams_share_the_power() {
        for (n_tx, db) in [(1, 0.0), (2, 10.0 * 2_f64.log10()), (3, 4.5)] {
            let repr = Repr { n_tx, rssi: [90; 3], agc: 0, ..Repr::default() };
            let body = emitted(repr, &vec![Iq { i: 1, q: 0 }; repr.samples()]);
            let factor = scale_factor(&Bfee::new_checked(&body).unwrap()).unwrap();
            let expect = 10_f64.powf(db / 20.0) / (3.0 * f64::from(n_tx)).sqrt();
            assert!((factor - expect).abs() < 1e-9, "{n_tx}: {factor} {expect}");
        }
    }

    #[test]
    fn what_cannot_be_scaled_says_so() {
        let zero = emitted(Repr::default(), &[Iq::default(); 90]);
        assert_eq!(scale_factor(&Bfee::new_checked(&zero).unwrap()), Err(ScaleError::ZeroCsi { values: 90 }));
        let silent = emitted(Repr { rssi: [0; 3], ..Repr::default() }, &[Iq { i: 1, q: 1 }; 90]);
        let bfee = Bfee::new_checked(&silent).unwrap();
        assert_eq!(total_rss_dbm(&bfee), Err(ScaleError::NoRssi { agc: 40 }));
        assert_eq!(scale_factor(&bfee), Err(ScaleError::NoRssi { agc: 40 }));
        assert!(ScaleError::NoRssi { agc: 40 }.to_string().contains("40 dB"));
    }

    /// `C = H Q` made here, from the matrices as csitool prints them, then removed again.
    #[test]
    fn spatial_mapping_is_undone() {
        let j = Complex64::i();
        let one = Complex64::new(1.0, 0.0);
        let e = |turns: f64| Complex64::from_polar(1.0, TAU * turns);
        let two_20 = vec![vec![one, one], vec![one, -one]];
        let two_40 = vec![vec![one, j], vec![j, one]];
        let three_20 = vec![
            vec![e(-1.0 / 16.0), e(-33.0 / 80.0), e(3.0 / 80.0)],
            vec![e(23.0 / 80.0), e(13.0 / 48.0), e(13.0 / 240.0)],
            vec![e(-13.0 / 80.0), e(37.0 / 240.0), e(13.0 / 48.0)],
        ];
        let three_40 = vec![
            vec![e(-1.0 / 16.0), e(-13.0 / 80.0), e(23.0 / 80.0)],
            vec![e(-37.0 / 80.0), e(-11.0 / 48.0), e(-107.0 / 240.0)],
            vec![e(7.0 / 80.0), e(-83.0 / 240.0), e(-11.0 / 48.0)],
        ];
        for (q, is_40) in [(two_20, false), (two_40, true), (three_20, false), (three_40, true)] {
            let n_tx = q.len();
            let repr = Repr { n_tx: n_tx as u8, ..Repr::default() };
            let body = emitted(repr, &vec![Iq::default(); repr.samples()]);
            let mut mapped = Csi::raw(&Bfee::new_checked(&body).unwrap());
            let h = |row: usize, t: usize| Complex64::new((row * 3 + t) as f64 % 7.0 - 3.0, (row + 2 * t) as f64 % 5.0);
            for row in 0..90 {
                for t in 0..n_tx {
                    let column = q.iter().map(|row| row[t]).enumerate();
                    let c: Complex64 = column.map(|(k, q)| h(row, k) * q).sum::<Complex64>() / (n_tx as f64).sqrt();
                    mapped.h[row * n_tx + t] = Complex32::new(c.re as f32, c.im as f32);
                }
            }
            let removed = mapped.without_spatial_mapping(is_40);
            for row in 0..90 {
                for t in 0..n_tx {
                    let expect = h(row, t);
                    let got = removed.get(row / 3, row % 3, t).unwrap();
                    let error = (got - Complex32::new(expect.re as f32, expect.im as f32)).norm();
                    assert!(error < 1e-5, "n_tx {n_tx}, 40 MHz {is_40}, row {row}, tx {t}: {got} {expect}");
                }
            }
        }
        let one_stream = emitted(Repr::default(), &[Iq { i: 5, q: -6 }; 90]);
        let csi = Csi::raw(&Bfee::new_checked(&one_stream).unwrap());
        assert_eq!(csi.without_spatial_mapping(false), csi);
    }

    /// The captures, or a word on why the test says nothing.
    fn capture(name: &str) -> Option<Vec<u8>> {
        let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/captures");
        let path = std::env::var_os("CSI5300_CAPTURES").map_or(beside, PathBuf::from).join("csitool").join(name);
        let bytes = std::fs::read(&path);
        if bytes.is_err() {
            println!("skipped: no {} (set CSI5300_CAPTURES)", path.display());
        }
        bytes.ok()
    }

    /// Runs `check` on bfee number `n` of a log.
    fn with_record(log: &[u8], n: usize, check: impl FnOnce(&Bfee<'_>)) {
        let mut bfees = events(log).filter_map(|step| match step {
            Step::Record { record, .. } => Bfee::new_checked(record.body).ok(),
            _ => None,
        });
        check(&bfees.nth(n).unwrap());
    }

    /// Values of an independent port of csitool's scripts, which agree with CSIKit on the same records.
    #[test]
    fn reference_vectors_of_csitool() {
        let close = |got: Complex32, re: f64, im: f64| {
            assert!((Complex64::new(got.re.into(), got.im.into()) - Complex64::new(re, im)).norm() < 2e-6, "{got}");
        };
        let numbers = |bfee: &Bfee<'_>, rss: f64, factor: f64| {
            assert!((total_rss_dbm(bfee).unwrap() - rss).abs() < 1e-6);
            assert!((scale_factor(bfee).unwrap() - factor).abs() < 1e-9);
        };
        let scaled = |bfee: &Bfee<'_>, s, rx| {
            Csi::from_bfee(bfee).unwrap().get(s, rx, 0).unwrap() * scale_factor(bfee).unwrap() as f32
        };
        if let Some(log) = capture("log.all_csi.6.7.6.dat") {
            with_record(&log, 0, |bfee| {
                numbers(bfee, -39.078_240, 0.576_555_488);
                let csi = Csi::from_bfee(bfee).unwrap();
                let first = [0, 1, 2].map(|rx| csi.get(0, rx, 0).unwrap());
                assert_eq!(first, [(11.0, -3.0), (10.0, 6.0), (-5.0, 14.0)].map(|(re, im)| Complex32::new(re, im)));
                close(scaled(bfee, 0, 0), 6.342_110, -1.729_666);
                close(scaled(bfee, 29, 2), 5.765_555, 14.990_443);
            });
            with_record(&log, 10, |bfee| {
                numbers(bfee, -42.105_928, 0.573_458_817);
                close(scaled(bfee, 0, 0), -1.146_918, 14.336_470);
            });
            with_record(&log, 19, |bfee| {
                numbers(bfee, -41.352_187, 0.546_927_646);
                close(scaled(bfee, 0, 0), 21.877_106, 1.093_855);
            });
        }
        if let Some(log) = capture("sample_0x1_ap.dat") {
            with_record(&log, 0, |bfee| {
                numbers(bfee, -37.409_985, 0.572_329_580);
                close(scaled(bfee, 0, 0), 7.440_285, -5.723_296);
            });
        }
    }

    /// The first record of `test_count_rx_0527_7.dat`: RSSI 37, 20, 18 and AGC 63.
    #[test]
    fn total_rss_of_a_wsr_record() {
        let body = emitted(Repr { rssi: [37, 20, 18], agc: 63, ..Repr::default() }, &[Iq::default(); 90]);
        assert!((total_rss_dbm(&Bfee::new_checked(&body).unwrap()).unwrap() + 69.860_923).abs() < 1e-6);
    }
}
