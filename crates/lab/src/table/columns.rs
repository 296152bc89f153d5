//! The fields of each record besides its CSI, a column per field.

use csi5300::source::survey::{Fields, Identity};
use driver_iface::bfee::{Antenna, Antennas, Bfee};
use std::mem::MaybeUninit;

/// No host time: NumPy's NaT.
pub const NO_TIME: i64 = i64::MIN;
/// No antenna.
pub const NO_ANTENNA: u8 = 255;

/// Called with memory before it is first written, for example to request large pages.
pub trait Advise {
    /// Receives memory that will be written.
    fn advise<T>(&mut self, memory: &mut [MaybeUninit<T>]);
}

/// Does nothing.
impl Advise for () {
    fn advise<T>(&mut self, _: &mut [MaybeUninit<T>]) {}
}

/// Columns of equal length.
#[derive(Clone, Debug, Default)]
pub struct Columns {
    /// The card's clock, unwrapped along the log, microseconds from an arbitrary origin.
    pub time_us: Vec<i64>,
    /// Host time, microseconds since the Unix epoch; [`NO_TIME`] if unknown.
    pub host_us: Vec<i64>,
    /// The card's clock as in the record, microseconds; wraps.
    pub timestamp_low: Vec<u32>,
    /// The driver's count of records; wraps.
    pub bfee_count: Vec<u16>,
    /// Receive chains.
    pub n_rx: Vec<u8>,
    /// Streams.
    pub n_tx: Vec<u8>,
    /// RSSI at antennas A, B, C, three per record, dB relative to the card's reference.
    pub rssi: Vec<u8>,
    /// Noise floor, dBm; -127 if not measured.
    pub noise_dbm: Vec<i8>,
    /// Gain, dB.
    pub agc: Vec<u8>,
    /// `rate_n_flags`.
    pub rate: Vec<u16>,
    /// Antenna of each chain, packed.
    pub antenna_sel: Vec<u8>,
    /// Antenna of each chain, three per record; see [`antenna_order`].
    pub antenna_order: Vec<u8>,
    /// The sender's frame number; -1 if unknown.
    pub frame: Vec<i64>,
    /// The sender's address, six per record; zeros if unknown.
    pub mac: Vec<u8>,
    /// Offset of the record in the log, or its running number.
    pub offset: Vec<i64>,
}

impl Columns {
    /// Number of records.
    #[must_use]
    pub fn len(&self) -> usize {
        self.time_us.len()
    }

    /// True without records.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.time_us.is_empty()
    }

    /// Reserves room for this many more records, as far as memory allows; `advise` gets the memory of each column.
    pub(super) fn reserve(&mut self, records: usize, advise: &mut impl Advise) {
        fn room<T>(column: &mut Vec<T>, more: usize, advise: &mut impl Advise) {
            if column.try_reserve_exact(more).is_ok() {
                advise.advise(column.spare_capacity_mut());
            }
        }
        room(&mut self.time_us, records, advise);
        room(&mut self.host_us, records, advise);
        room(&mut self.timestamp_low, records, advise);
        room(&mut self.bfee_count, records, advise);
        room(&mut self.n_rx, records, advise);
        room(&mut self.n_tx, records, advise);
        room(&mut self.rssi, records.saturating_mul(3), advise);
        room(&mut self.noise_dbm, records, advise);
        room(&mut self.agc, records, advise);
        room(&mut self.rate, records, advise);
        room(&mut self.antenna_sel, records, advise);
        room(&mut self.antenna_order, records.saturating_mul(3), advise);
        room(&mut self.frame, records, advise);
        room(&mut self.mac, records.saturating_mul(6), advise);
        room(&mut self.offset, records, advise);
    }

    /// The rows and columns needed for the CSI of all records.
    #[must_use]
    pub fn widest(&self) -> Widest {
        let mut widest = Widest::default();
        widest.note(self);
        widest
    }

    /// Adds a record.
    pub(super) fn push(&mut self, fields: &Fields, identity: Identity, time_us: i64, offset: u64) {
        self.time_us.push(time_us);
        self.host_us.push(identity.host_us.unwrap_or(NO_TIME));
        let head = &fields.head;
        self.timestamp_low.push(head.timestamp_low);
        self.bfee_count.push(head.bfee_count);
        self.n_rx.push(head.n_rx);
        self.n_tx.push(head.n_tx);
        self.rssi.extend(head.rssi);
        self.noise_dbm.push(head.noise_dbm);
        self.agc.push(head.agc);
        self.rate.push(head.rate_n_flags);
        self.antenna_sel.push(head.antenna_sel);
        self.antenna_order.extend(order_of(fields.antennas));
        self.frame.push(identity.frame_count.map_or(-1, i64::from));
        self.mac.extend(identity.mac.0);
        self.offset.push(i64::try_from(offset).unwrap_or(i64::MAX));
    }
}

/// The rows and columns needed for the CSI of some records.
#[derive(Clone, Debug, Default)]
pub struct Widest {
    used: [bool; 3],
    /// Most chains of a record that does not name its antennas.
    unnamed: usize,
    streams: usize,
}

impl Widest {
    /// Includes more records.
    pub fn note(&mut self, columns: &Columns) {
        for (used, antenna) in self.used.iter_mut().zip(Antenna::ALL) {
            *used = *used || columns.antenna_order.iter().any(|order| usize::from(*order) == antenna.index());
        }
        let first = columns.antenna_order.iter().step_by(3).zip(&columns.n_rx);
        let most = first.filter(|(first, _)| **first == NO_ANTENNA).map(|(_, n_rx)| usize::from(*n_rx)).max();
        self.unnamed = self.unnamed.max(most.unwrap_or(0));
        self.streams = self.streams.max(columns.n_tx.iter().copied().max().map_or(0, usize::from));
    }

    /// Antennas in order: those that any record used and, if records do not name theirs, enough more for their chains.
    #[must_use]
    pub fn antennas(&self) -> Vec<Antenna> {
        let (used, others): (Vec<_>, Vec<_>) = Antenna::ALL.into_iter().partition(|antenna| self.used[antenna.index()]);
        let more = self.unnamed.saturating_sub(used.len());
        let mut antennas: Vec<Antenna> = used.into_iter().chain(others.into_iter().take(more)).collect();
        antennas.sort();
        antennas
    }

    /// The most streams of a record; 1 without records.
    #[must_use]
    pub fn streams(&self) -> usize {
        self.streams.max(1)
    }
}

/// The antenna of each chain, 0 to 2 for A to C; [`NO_ANTENNA`] for unused chains and if the record does not name it.
#[must_use]
pub fn antenna_order(bfee: &Bfee<'_>) -> [u8; 3] {
    order_of(bfee.antennas().ok())
}

fn order_of(antennas: Option<Antennas>) -> [u8; 3] {
    let mut order = [NO_ANTENNA; 3];
    if let Some(antennas) = antennas {
        for (place, antenna) in order.iter_mut().zip(antennas.as_slice()) {
            *place = antenna.index() as u8;
        }
    }
    order
}

/// Antennas by their letters: `A`, `BC`, `A,C`.
#[must_use]
pub fn antennas(text: &str) -> Option<Vec<Antenna>> {
    let letter = |letter: char| match letter.to_ascii_uppercase() {
        'A' => Some(Antenna::A),
        'B' => Some(Antenna::B),
        'C' => Some(Antenna::C),
        _ => None,
    };
    let letters = text.chars().filter(|c| !matches!(c, ',' | ' '));
    let mut antennas: Vec<Antenna> = letters.map(letter).collect::<Option<_>>()?;
    antennas.sort();
    antennas.dedup();
    (!antennas.is_empty()).then_some(antennas)
}
