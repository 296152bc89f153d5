//! The fields of records beside their CSI, as arrays of their own types.

use super::mat::{Mat, Number};
use super::npz::{Element, Npz};
use super::walk::Figures;
use super::{Export, ExportError};
use crate::table::NO_TIME;

/// A file that takes arrays of `count` times `width` values, the values of one record beside each other.
pub trait Target {
    /// Adds an array.
    ///
    /// # Errors
    /// If it cannot be written.
    fn put<T: Element + Number>(
        &mut self,
        name: &str,
        count: u64,
        width: u64,
        values: impl Iterator<Item = T>,
    ) -> Result<(), ExportError>;
}

impl Target for Npz {
    fn put<T: Element + Number>(
        &mut self,
        name: &str,
        count: u64,
        width: u64,
        values: impl Iterator<Item = T>,
    ) -> Result<(), ExportError> {
        let shape = if width == 1 { vec![count] } else { vec![count, width] };
        self.array(name, &shape, values)
    }
}

impl Target for Mat {
    /// With the records last, as the order of MATLAB's indices has them.
    fn put<T: Element + Number>(
        &mut self,
        name: &str,
        count: u64,
        width: u64,
        values: impl Iterator<Item = T>,
    ) -> Result<(), ExportError> {
        self.array(name, &[width, count], values)
    }
}

/// Bytes that [`write`] writes of each record.
pub const BYTES: u64 = 79;

/// Writes all fields.
pub fn write(export: &Export<'_>, figures: &Figures, file: &mut impl Target) -> Result<(), ExportError> {
    let (n, columns) = (export.len() as u64, export.columns);
    let host = columns.host_us.iter().map(|us| if *us == NO_TIME { -1 } else { *us });
    let rssi = |port: usize| columns.rssi.iter().skip(port).step_by(3).copied();
    file.put("record", n, 1, 0..n as i64)?;
    file.put("time_us", n, 1, columns.time_us.iter().copied())?;
    file.put("timestamp_low", n, 1, columns.timestamp_low.iter().copied())?;
    file.put("bfee_count", n, 1, columns.bfee_count.iter().copied())?;
    file.put("host_us", n, 1, host)?;
    file.put("frame_count", n, 1, columns.frame.iter().copied())?;
    file.put("n_rx", n, 1, columns.n_rx.iter().copied())?;
    file.put("n_tx", n, 1, columns.n_tx.iter().copied())?;
    for (port, name) in ["rssi_a", "rssi_b", "rssi_c"].into_iter().enumerate() {
        file.put(name, n, 1, rssi(port))?;
    }
    file.put("noise_dbm", n, 1, columns.noise_dbm.iter().copied())?;
    file.put("agc", n, 1, columns.agc.iter().copied())?;
    file.put("antenna_sel", n, 1, columns.antenna_sel.iter().copied())?;
    file.put("rate_n_flags", n, 1, columns.rate.iter().copied())?;
    file.put("antennas_known", n, 1, export.antennas_known().map(u8::from))?;
    file.put("total_rss_dbm", n, 1, figures.rss_dbm.iter().copied())?;
    file.put("scale", n, 1, figures.scale.iter().copied())?;
    file.put("offset", n, 1, columns.offset.iter().copied())?;
    file.put("mac", n, 6, columns.mac.iter().copied())?;
    if let Some(subcarriers) = export.subcarriers() {
        file.put("subcarriers", subcarriers.len() as u64, 1, subcarriers.into_iter())?;
    }
    let ports = export.antennas.iter().map(|antenna| antenna.index() as u8);
    file.put("antennas", export.antennas.len() as u64, 1, ports)?;
    file.put("scaled", 1, 1, [u8::from(export.form.scaled)].into_iter())
}
