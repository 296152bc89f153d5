//! The way through the records of an export: once, piece by piece, each decoded into memory that the caller has.

use super::log_reader::LogReader;
use super::{Export, ExportError, Source};
use crate::table::{Decoder, Order, Rows, decode_in};
use csi5300::signal::csi::{scale_factor, total_rss_dbm};
use driver_iface::bfee::Bfee;
use num_complex::Complex32;

/// Records decoded at a time on all cores.
pub(super) const PIECE: usize = 4_096;
/// Bytes of CSI of a log decoded at a time: they stay in the second-level cache until they are written, and are many for one call of
/// the kernel.
const LOG_PIECE: usize = 512 * 1024;

/// What is computed of each record, in the order of the records; not a number where it has none.
#[derive(Clone, Debug, Default)]
pub(super) struct Figures {
    /// Received power, dBm.
    pub rss_dbm: Vec<f64>,
    /// Factor from the card's integers to sqrt(SNR).
    pub scale: Vec<f64>,
}

impl Figures {
    fn with_room(records: usize) -> Self {
        Self { rss_dbm: Vec::with_capacity(records), scale: Vec::with_capacity(records) }
    }

    /// Adds a record's; `scale` is its factor, where it has one.
    fn push(&mut self, bfee: Option<&Bfee<'_>>, scale: Option<f64>) {
        self.rss_dbm.push(bfee.and_then(|bfee| total_rss_dbm(bfee).ok()).unwrap_or(f64::NAN));
        self.scale.push(scale.unwrap_or(f64::NAN));
    }

    /// Records without a scale.
    pub fn unscaled(&self) -> u64 {
        self.scale.iter().filter(|scale| scale.is_nan()).count() as u64
    }
}

/// A walk through all records of an export.
pub(super) struct Walk<'a> {
    export: &'a Export<'a>,
    order: Order,
    rows: Rows,
    log: Option<(LogReader, Decoder)>,
    done: usize,
    figures: Figures,
    failure: Option<ExportError>,
}

impl<'a> Walk<'a> {
    /// Before the first record; CSI in this order.
    ///
    /// # Errors
    /// If the records are in a log that cannot be opened.
    pub fn new(export: &'a Export<'a>, order: Order) -> Result<Self, ExportError> {
        let rows = Rows::new(&export.antennas, export.streams);
        let log = match &export.source {
            Source::Arena { .. } => None,
            Source::Log(path) => Some((LogReader::open(path)?, Decoder::new(order, rows.clone(), export.form))),
        };
        let figures = Figures::with_room(export.len());
        Ok(Self { export, order, rows, log, done: 0, figures, failure: None })
    }

    /// Puts the CSI of the next records, one after the other, in the place of what is in the vector: nothing
    /// behind the last record, once the export was stopped, and when the log cannot be read further ([`Walk::finish`] says so).
    pub fn next(&mut self, csi: &mut Vec<Complex32>) {
        let log_piece = (LOG_PIECE / (size_of::<Complex32>() * self.rows.len().max(1))).max(1);
        let size = if self.log.is_some() { log_piece } else { PIECE };
        let from = self.done;
        let wanted = if self.failure.is_some() || self.export.is_stopped() { 0 } else { size };
        self.done = (from + wanted).min(self.export.len());
        csi.resize((self.done - from) * self.rows.len(), Complex32::default());
        match &self.export.source {
            Source::Arena { arena, records } => {
                let records = records.get(from..self.done).unwrap_or_default();
                decode_in(self.order, arena, records, &self.rows, self.export.form, csi);
                for bfee in records.iter().map(|record| arena.bfee(*record)) {
                    self.figures.push(bfee.as_ref(), bfee.and_then(|bfee| scale_factor(&bfee).ok()));
                }
            }
            Source::Log(_) => {
                if let Err(failure) = self.read(from, csi) {
                    self.failure = Some(failure);
                    csi.clear();
                }
            }
        }
    }

    /// Reads and decodes the records from the one numbered `from` to those that are done.
    fn read(&mut self, from: usize, csi: &mut [Complex32]) -> Result<(), ExportError> {
        let Some((log, decoder)) = &mut self.log else { return Ok(()) };
        let offsets = self.export.columns.offset.get(from..self.done).unwrap_or_default();
        for (offset, out) in offsets.iter().zip(csi.chunks_exact_mut(self.rows.len().max(1))) {
            let bfee = log.bfee(*offset)?;
            let scale = decoder.decode(&bfee, out);
            self.figures.push(Some(&bfee), scale);
        }
        Ok(())
    }

    /// The figures of the records so far.
    #[cfg(feature = "parquet")]
    pub fn figures(&self) -> &Figures {
        &self.figures
    }

    /// The figures of all records.
    ///
    /// # Errors
    /// If the log could not be read to its end, or was changed after its columns were read.
    pub fn finish(self) -> Result<Figures, ExportError> {
        self.failure.map_or(Ok(self.figures), Err)
    }
}
