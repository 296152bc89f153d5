//! A bfee as a value, and how to write it.

use byteorder::{ByteOrder, LittleEndian};

use super::{Bfee, Iq, Layout, NOISE_UNKNOWN_DBM, STOCK_HEADER, SUBCARRIERS, Wsr, csi_len, offset};
use crate::{EmitError, room};

/// All header fields of a bfee; [`Repr::emit`] gets the CSI separately.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Repr {
    /// See [`Bfee::timestamp_low`], microseconds.
    pub timestamp_low: u32,
    /// See [`Bfee::bfee_count`].
    pub bfee_count: u16,
    /// See [`Bfee::reserved`].
    pub reserved: u16,
    /// Receive chains, 1 to 3.
    pub n_rx: u8,
    /// Space-time streams, 1 to 3.
    pub n_tx: u8,
    /// RSSI of antennas A, B, C in dB; 0 if unused.
    pub rssi: [u8; 3],
    /// Noise floor in dBm.
    pub noise_dbm: i8,
    /// Receiver gain, dB.
    pub agc: u8,
    /// Antennas of the chains, packed.
    pub antenna_sel: u8,
    /// Rate and flags.
    pub rate_n_flags: u16,
    /// Fields that the WSR driver adds: `None` writes the stock layout, a missing frame number that of 2021.
    pub wsr: Option<Wsr>,
}

impl Default for Repr {
    /// One stream received on three chains in antenna order, MCS 1 at 20 MHz, noise unknown, stock layout.
    fn default() -> Self {
        Self {
            timestamp_low: 0,
            bfee_count: 0,
            reserved: 0,
            n_rx: 3,
            n_tx: 1,
            rssi: [30; 3],
            noise_dbm: NOISE_UNKNOWN_DBM,
            agc: 40,
            antenna_sel: 0x24,
            rate_n_flags: 0x101,
            wsr: None,
        }
    }
}

impl Repr {
    /// The header fields of a record.
    #[must_use]
    #[inline]
    pub fn parse(bfee: &Bfee<'_>) -> Self {
        Self {
            timestamp_low: bfee.timestamp_low(),
            bfee_count: bfee.bfee_count(),
            reserved: bfee.reserved(),
            n_rx: bfee.n_rx() as u8,
            n_tx: bfee.n_tx() as u8,
            rssi: bfee.rssi(),
            noise_dbm: bfee.noise_dbm(),
            agc: bfee.agc(),
            antenna_sel: bfee.antenna_sel(),
            rate_n_flags: bfee.rate_n_flags(),
            wsr: bfee.wsr(),
        }
    }

    /// Number of its CSI samples, `30 n_rx n_tx`.
    #[must_use]
    pub fn samples(&self) -> usize {
        SUBCARRIERS * usize::from(self.n_rx) * usize::from(self.n_tx)
    }

    /// The layout that [`Repr::emit`] writes.
    #[must_use]
    pub fn layout(&self) -> Layout {
        match self.wsr {
            None => Layout::Stock,
            Some(Wsr { frame_count: None, .. }) => Layout::Wsr2021,
            Some(_) => Layout::Wsr,
        }
    }

    /// Bytes of the body, without the code.
    #[must_use]
    pub fn body_len(&self) -> usize {
        csi_len(self.n_rx, self.n_tx) + self.layout().header_len()
    }

    /// Writes the body (without the code): header, then `csi` packed, `[subcarrier][raw rx chain][tx]`.
    ///
    /// Returns the number of bytes written, [`Repr::body_len`].
    ///
    /// # Errors
    /// If chains are not 1 to 3, `csi` is not `30 n_rx n_tx` long, or `out` is too short.
    pub fn emit(&self, csi: &[Iq], out: &mut [u8]) -> Result<usize, EmitError> {
        for (name, got) in [("n_rx", self.n_rx), ("n_tx", self.n_tx)] {
            if !(1..=3).contains(&got) {
                return Err(EmitError::Field { name, got: got.into(), max: 3 });
            }
        }
        if csi.len() != self.samples() {
            return Err(EmitError::Samples { expect: self.samples(), got: csi.len() });
        }
        let out = room(out, self.body_len())?;
        let (header, payload) = out.split_at_mut(self.body_len() - csi_len(self.n_rx, self.n_tx));
        let (stock, extra) = header.split_at_mut(STOCK_HEADER);
        if let Some(stock) = stock.first_chunk_mut() {
            self.emit_stock(stock);
        }
        if let Some(wsr) = &self.wsr {
            emit_wsr(wsr, extra);
        }
        pack(csi, usize::from(self.n_rx) * usize::from(self.n_tx), payload);
        Ok(self.body_len())
    }

    fn emit_stock(&self, out: &mut [u8; STOCK_HEADER]) {
        let [a, b, c] = self.rssi;
        LittleEndian::write_u32(out, self.timestamp_low);
        LittleEndian::write_u16(&mut out[offset::BFEE_COUNT..], self.bfee_count);
        LittleEndian::write_u16(&mut out[offset::RESERVED..], self.reserved);
        out[offset::N_RX] = self.n_rx;
        out[offset::N_TX] = self.n_tx;
        out[offset::RSSI] = a;
        out[offset::RSSI + 1] = b;
        out[offset::RSSI + 2] = c;
        out[offset::NOISE] = self.noise_dbm.cast_unsigned();
        out[offset::AGC] = self.agc;
        out[offset::ANTENNA_SEL] = self.antenna_sel;
        LittleEndian::write_u16(&mut out[offset::LEN..], csi_len(self.n_rx, self.n_tx) as u16);
        LittleEndian::write_u16(&mut out[offset::RATE_N_FLAGS..], self.rate_n_flags);
    }
}

/// Writes the 18 bytes that follow the stock header, or 14 if there is no number.
fn emit_wsr(wsr: &Wsr, out: &mut [u8]) {
    let fields = wsr.tv_sec.to_le_bytes().into_iter().chain(wsr.tv_usec.to_le_bytes());
    let fields = fields.chain(wsr.mac.0).chain(wsr.frame_count.unwrap_or(0).to_le_bytes());
    for (byte, field) in out.iter_mut().zip(fields) {
        *byte = field;
    }
}

/// Packs samples, `n` per subcarrier, as a bit stream.
fn pack(csi: &[Iq], n: usize, out: &mut [u8]) {
    let mut out = out.iter_mut();
    let (mut pending, mut bits) = (0_u32, 0);
    let mut put = |value: u32, width: u32| {
        pending |= value << bits;
        bits += width;
        while bits >= 8 {
            if let Some(byte) = out.next() {
                *byte = pending as u8;
            }
            pending >>= 8;
            bits -= 8;
        }
    };
    for subcarrier in csi.chunks(n) {
        put(0, 3);
        for iq in subcarrier {
            put(u32::from(iq.i.cast_unsigned()), 8);
            put(u32::from(iq.q.cast_unsigned()), 8);
        }
    }
    put(0, 7);
}
