//! What a survey takes of a bfee record: its fields beside the CSI.

use driver_iface::bfee::{Antennas, Bfee, Wsr};

/// The fields of an intact bfee record beside its CSI: small enough to be handed from one thread to another, which need not look at
/// the record itself then.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fields {
    /// Low 32 bits of the card's clock, microseconds.
    pub timestamp_low: u32,
    /// The driver's count of records.
    pub bfee_count: u16,
    /// `rate_n_flags`.
    pub rate: u16,
    /// Receive chains.
    pub n_rx: u8,
    /// Streams.
    pub n_tx: u8,
    /// RSSI at antennas A, B, C, dB relative to the card's reference.
    pub rssi: [u8; 3],
    /// Noise floor, dBm; -127 where not measured.
    pub noise_dbm: i8,
    /// Gain, dB.
    pub agc: u8,
    /// Antenna of each chain, packed.
    pub antenna_sel: u8,
    /// The same read, where it is a permutation.
    pub antennas: Option<Antennas>,
    /// What the WSR driver adds.
    pub wsr: Option<Wsr>,
}

impl Fields {
    /// Those of a record.
    #[must_use]
    #[inline]
    pub fn of(bfee: &Bfee<'_>) -> Self {
        Self {
            timestamp_low: bfee.timestamp_low(),
            bfee_count: bfee.bfee_count(),
            rate: bfee.rate_n_flags(),
            n_rx: bfee.n_rx() as u8,
            n_tx: bfee.n_tx() as u8,
            rssi: bfee.rssi(),
            noise_dbm: bfee.noise_dbm(),
            agc: bfee.agc(),
            antenna_sel: bfee.antenna_sel(),
            antennas: bfee.antennas().ok(),
            wsr: bfee.wsr(),
        }
    }
}
