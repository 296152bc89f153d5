//! Logs as tables in memory: a column per field, and the CSI packed as the card sent it, decoded into arrays on demand.
//!
//! [`Reading`] reads a source once through a [`Filter`] into an [`Arena`] and [`Columns`]; [`decode`] writes the CSI of
//! any of its records into the caller's memory. Exports, pictures of logs, the page and the Python package use it.

mod decode;
mod memory;
mod reading;

use csi5300::source::survey::{Fields, Identity};
pub(crate) use decode::{Decoder, Order, decode_in};
pub use decode::{Form, Rows, decode};
use driver_iface::bfee::{Antenna, Antennas, Bfee};
pub use memory::Arena;
pub(crate) use memory::LogReader;
pub use reading::{Filter, Reading, Table};

/// No host time: NumPy's NaT.
pub const NO_TIME: i64 = i64::MIN;
/// No antenna.
pub const NO_ANTENNA: u8 = 255;

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

    /// The rows and columns needed for the CSI of all records.
    #[must_use]
    pub fn widest(&self) -> Widest {
        let mut widest = Widest::default();
        widest.note(self);
        widest
    }

    /// Adds a record.
    fn push(&mut self, fields: &Fields, identity: Identity, time_us: i64, offset: u64) {
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
    let named = |letter: char| {
        let letter = letter.to_ascii_uppercase().to_string();
        Antenna::ALL.into_iter().find(|antenna| antenna.to_string() == letter)
    };
    let letters = text.chars().filter(|c| !matches!(c, ',' | ' '));
    let mut antennas: Vec<Antenna> = letters.map(named).collect::<Option<_>>()?;
    antennas.sort();
    antennas.dedup();
    (!antennas.is_empty()).then_some(antennas)
}

#[cfg(test)]
mod tests {
    use super::reading::Cut;
    use super::*;
    use crate::temporary::{Temporary, fixture};
    use csi5300::source::replay::Replay;
    use csi5300::time::Instant;
    use csi5300::{Frame, Log};
    use driver_iface::bfee::{Iq, Repr};
    use driver_iface::record::{LOOKAHEAD, Record, code, written};
    use num_complex::Complex32;
    use std::io::Read;

    fn table(filter: Filter) -> (Arena, Columns, u64) {
        let mut reading = Reading::new(Replay::open(&fixture()).unwrap(), filter);
        while reading.burst(Instant::ZERO, usize::MAX).unwrap() {}
        assert!(reading.has_ended());
        let (arena, columns) = reading.take();
        (arena, columns, reading.table.left_out)
    }

    fn frames() -> Vec<Frame> {
        Log::open(fixture()).unwrap().map(Result::unwrap).collect()
    }

    #[test]
    fn a_table_equals_its_frames() {
        let (arena, columns, left_out) = table(Filter::default());
        let frames = frames();
        assert!(frames.len() > 100 && arena.len() == frames.len() && columns.len() == frames.len() && left_out == 0);
        let rows = Rows::new(&[Antenna::A, Antenna::B, Antenna::C], 1);
        for form in [Form::default(), Form { scaled: true, without_spatial_mapping: false }] {
            let mut csi = vec![Complex32::default(); arena.len() * rows.len()];
            decode(&arena, &(0..arena.len()).collect::<Vec<_>>(), &rows, form, &mut csi);
            for (frame, own) in frames.iter().zip(csi.chunks(rows.len())) {
                let factor = if form.scaled { frame.scale.unwrap() as f32 } else { 1.0 };
                for (k, h) in own.iter().enumerate() {
                    assert_eq!(Some(*h), frame.csi.get(k % 30, k / 30, 0).map(|h| h * factor));
                }
            }
        }
        for (k, frame) in frames.iter().enumerate() {
            assert_eq!(
                (columns.time_us[k], columns.agc[k], columns.rate[k]),
                (frame.card_us, frame.agc, frame.rate_n_flags)
            );
            assert_eq!(columns.host_us[k], frame.host_us.unwrap_or(NO_TIME));
            assert_eq!(columns.frame[k], frame.number.map_or(-1, i64::from));
            assert_eq!(columns.rssi[3 * k..3 * k + 3], frame.rssi);
            assert_eq!(columns.offset[k], frame.offset as i64);
            assert_eq!(columns.mac[6 * k..6 * k + 6], frame.mac.unwrap().0);
        }
    }

    #[test]
    fn missing_rows_are_nan() {
        let (arena, ..) = table(Filter::default());
        // Columns for two streams of records that have one; rows in another order; a missing record.
        let rows = Rows::new(&[Antenna::C, Antenna::A], 2);
        let mut csi = vec![Complex32::default(); 3 * rows.len()];
        decode(&arena, &[5, 5, arena.len()], &rows, Form::default(), &mut csi);
        let frame = &frames()[5];
        for (k, h) in csi[..rows.len()].iter().enumerate() {
            match k / 30 {
                row @ (0 | 2) => assert_eq!(Some(*h), frame.csi.get(k % 30, [2, 0][row / 2], 0)),
                _ => assert!(h.is_nan()),
            }
        }
        assert!(csi[2 * rows.len()..].iter().all(|h| h.is_nan()));
    }

    /// Records of every number of chains and streams, with antennas in every order, unknown antennas and silent ones; consecutive
    /// records are always of different kinds.
    fn all_kinds() -> Arena {
        let mut arena = Arena::default();
        for (k, antenna_sel) in (0..64_u8).enumerate() {
            for (n_rx, n_tx) in (1..=3).flat_map(|n_rx| (1..=3).map(move |n_tx| (n_rx, n_tx))) {
                let rssi = [[38, 0, 0], [0, 35, 0], [40, 38, 35], [0, 0, 0]][k % 4];
                let rate_n_flags = if k % 3 == 0 { 0x0900 } else { 0x0100 };
                let repr = Repr { n_rx, n_tx, antenna_sel, rssi, rate_n_flags, agc: 30, ..Repr::default() };
                let value = |at: usize| ((at * 73 + k * 11) as u8).cast_signed();
                let samples: Vec<Iq> =
                    (0..repr.samples()).map(|at| Iq { i: value(2 * at), q: value(2 * at + 1) }).collect();
                let mut body = vec![0; repr.body_len()];
                repr.emit(&samples, &mut body).unwrap();
                arena.push(&body);
            }
        }
        arena
    }

    #[test]
    fn both_orders_of_indices_hold_the_same_numbers() {
        use Antenna::{A, B, C};
        let arena = all_kinds();
        let records: Vec<usize> = (0..arena.len() + 1).collect();
        for (antennas, n_tx) in [(&[A, B, C][..], 3), (&[A, B, C], 1), (&[A, C], 2), (&[B], 1), (&[], 1)] {
            let rows = Rows::new(antennas, n_tx);
            let columns = antennas.len() * n_tx;
            for (scaled, without_spatial_mapping) in [(false, false), (true, false), (false, true), (true, true)] {
                let form = Form { scaled, without_spatial_mapping };
                let mut last = vec![Complex32::default(); records.len() * rows.len()];
                decode(&arena, &records, &rows, form, &mut last);
                let mut first = vec![Complex32::default(); records.len() * rows.len()];
                decode_in(Order::SubcarriersFirst, &arena, &records, &rows, form, &mut first);
                for (at, h) in first.iter().enumerate() {
                    let (record, inside) = (at / rows.len(), at % rows.len());
                    let other = last[record * rows.len() + inside % columns * 30 + inside / columns];
                    let bits =
                        |h: Complex32| [h.re, h.im].map(|part| if part.is_nan() { None } else { Some(part.to_bits()) });
                    assert_eq!(bits(*h), bits(other), "{antennas:?}, {n_tx} columns, {form:?}, {record}, {inside}");
                }
                let numbers = last.iter().filter(|h| !h.is_nan()).count();
                assert!(
                    antennas.is_empty() || 6 * numbers > last.len() && numbers < last.len(),
                    "{numbers} of {}",
                    last.len()
                );
            }
        }
    }

    #[test]
    fn filters_keep_the_requested_records() {
        let frames = frames();
        let (first, sender) = (frames[0].card_us, frames[0].mac.unwrap().to_string());
        let (arena, columns, left_out) = table(Filter::default().with_time(Some(0.5), Some(1.0)).unwrap());
        let inside = frames.iter().filter(|f| (500_000..1_000_000).contains(&(f.card_us - first))).count();
        assert!(inside > 10 && arena.len() == inside && columns.len() + left_out as usize == frames.len());
        assert_eq!(table(Filter::default().with_macs([&sender]).unwrap()).0.len(), frames.len());
        assert!(table(Filter::default().with_macs(["02:00:00:00:00:77"]).unwrap()).0.is_empty());
        assert_eq!(table(Filter::default().with_antennas("b,c").unwrap()).0.len(), frames.len());
        assert!(Filter::default().with_macs(["me"]).unwrap_err().contains("not a sender address"));
        assert!(Filter::default().with_antennas("AD").unwrap_err().contains("names no antennas"));
        for (from_s, to_s) in [(2.0, 2.0), (f64::NAN, 3.0)] {
            assert!(Filter::default().with_time(Some(from_s), Some(to_s)).unwrap_err().contains("not a stretch"));
        }
    }

    /// Copies of the fixture's 281 records.
    const COPIES: usize = 150;

    #[test]
    fn the_needs_of_pieces_add_up_to_those_of_the_whole() {
        let columns = |orders: &[[u8; 3]], n_rx: &[u8], n_tx: &[u8]| Columns {
            antenna_order: orders.concat(),
            n_rx: n_rx.to_vec(),
            n_tx: n_tx.to_vec(),
            ..Columns::default()
        };
        let (only_c, unknown) = ([2, NO_ANTENNA, NO_ANTENNA], [NO_ANTENNA; 3]);
        for (chains, expect) in [(1, vec![Antenna::C]), (2, vec![Antenna::A, Antenna::C])] {
            let mut together = Widest::default();
            together.note(&columns(&[only_c], &[1], &[1]));
            together.note(&columns(&[unknown], &[chains], &[2]));
            let whole = columns(&[only_c, unknown], &[1, chains], &[1, 2]).widest();
            assert_eq!((whole.antennas(), whole.streams()), (expect.clone(), 2));
            assert_eq!((together.antennas(), together.streams()), (expect, 2));
        }
        assert_eq!((Widest::default().antennas(), Widest::default().streams()), (vec![], 1));
    }

    /// Enough copies of the fixture for several blocks of memory, damaged in places, with MPDU records in between.
    fn long() -> Vec<u8> {
        let whole = std::fs::read(fixture()).unwrap();
        let mut log = Vec::new();
        for _ in 0..COPIES {
            for record in whole.chunks(233) {
                let number = log.len();
                if number % 5 == 0 {
                    let mpdu = [number as u8; 40];
                    log.extend([0, 41, 0xc1]);
                    log.extend(mpdu);
                }
                log.extend(record);
            }
            log.extend([0xff; 700]);
        }
        log
    }

    fn replay(log: &[u8]) -> Replay<&[u8]> {
        Replay::new(log, "a long log".into())
    }

    /// The content of an arena: each record's MPDU and body.
    fn bodies(arena: &Arena) -> Vec<(&[u8], &[u8])> {
        (0..arena.len()).map(|k| (arena.mpdu(k), arena.body(k))).collect()
    }

    #[test]
    fn two_threads_read_what_one_reads() {
        let log = long();
        let few = Filter::default().with_time(Some(0.5), Some(0.6)).unwrap();
        let nobody = Filter::default().with_macs(["02:00:00:00:00:77"]).unwrap();
        // The usual blocks; blocks for few records, so that many straddle two of them; and no room for incomplete records.
        let small = |head| Cut { first: 1_000, block: Some(4_096 + head), head };
        let cuts = [Cut::default(), small(LOOKAHEAD), small(100)];
        for (filter, cut) in
            [Filter::default(), few, nobody].iter().flat_map(|filter| cuts.map(|cut| (filter.clone(), cut)))
        {
            let mut one = Reading::new(replay(&log), filter.clone());
            while one.burst(Instant::ZERO, usize::MAX).unwrap() {}
            let mut two = Reading::new(replay(&log), filter.clone());
            two.read_cut(Instant::ZERO, cut, || true).unwrap();
            // Without bodies a whole log is read on one thread, in reused memory.
            let mut alone = Reading::new(replay(&log), filter).without_bodies();
            alone.read_cut(Instant::ZERO, cut, || true).unwrap();
            assert!(one.has_ended() && two.has_ended() && one.table.left_out == two.table.left_out);
            assert_eq!(
                serde_json::to_string(&one.table.survey).unwrap(),
                serde_json::to_string(&two.table.survey).unwrap()
            );
            assert!(alone.has_ended() && alone.table.arena.is_empty() && alone.table.left_out == one.table.left_out);
            assert_eq!(
                serde_json::to_string(&one.table.survey).unwrap(),
                serde_json::to_string(&alone.table.survey).unwrap()
            );
            assert!(format!("{:?}", alone.table.columns) == format!("{:?}", one.table.columns), "columns differ");
            let ((a, a_columns), (b, b_columns)) = (one.take(), two.take());
            assert!(bodies(&a) == bodies(&b), "{} records, {}", a.len(), b.len());
            assert_eq!(format!("{a_columns:?}"), format!("{b_columns:?}"));
            assert_eq!(a.len() + one.table.left_out as usize, COPIES * 281);
        }
    }

    #[test]
    fn the_clock_of_a_translated_log_stays_with_its_record() {
        let whole = std::fs::read(fixture()).unwrap();
        let mut log = Vec::new();
        for (k, record) in (0_u32..30).zip(written(&whole)) {
            log.extend([[0, 5].as_slice(), &[code::CARD_CLOCK], &k.to_le_bytes(), record].concat());
        }
        let (mut one, mut two) =
            (Reading::new(replay(&log), Filter::default()), Reading::new(replay(&log), Filter::default()));
        while one.burst(Instant::ZERO, usize::MAX).unwrap() {}
        two.read_all(Instant::ZERO, || true).unwrap();
        for (arena, k) in
            [one.table.arena, two.table.arena].iter().flat_map(|arena| (0..30_u32).map(move |k| (arena, k)))
        {
            let codes: Vec<u8> = arena.records(k as usize).map(|(code, _)| code).collect();
            assert_eq!((codes, arena.mpdu(k as usize)), (vec![code::CARD_CLOCK, code::BFEE], &k.to_le_bytes()[..]));
        }
    }

    /// Host times of a side file, some unknown, with noise between records: records with and without them in one block.
    #[test]
    fn two_threads_read_the_host_times_that_one_reads() {
        let folder = Temporary::folder("table");
        let path = folder.0.join("stock.dat");
        let repr = Repr::default();
        let mut body = vec![0; repr.body_len()];
        repr.emit(&vec![Iq { i: 3, q: -4 }; repr.samples()], &mut body).unwrap();
        let whole = Record { code: code::BFEE, body: &body };
        let mut record = vec![0; whole.emit_len()];
        whole.emit(&mut record).unwrap();
        let (mut log, mut times) = (Vec::new(), Vec::new());
        for k in 0..3_000_i64 {
            log.extend(&record);
            let known = k % 3 != 1;
            times.extend([1_700_000_000 + k, 250_000].map(|part| if known { part } else { 0 }).map(i64::to_le_bytes));
        }
        std::fs::write(&path, &log).unwrap();
        std::fs::write(folder.0.join("stock.datstp"), times.as_flattened()).unwrap();
        let open = || Reading::new(Replay::open(&path).unwrap(), Filter::default());
        let (mut one, mut two) = (open(), open());
        while one.burst(Instant::ZERO, usize::MAX).unwrap() {}
        let cut = Cut { first: 1_000, block: Some(4_096 + LOOKAHEAD), head: LOOKAHEAD };
        two.read_cut(Instant::ZERO, cut, || true).unwrap();
        assert_eq!(format!("{:?}", one.table.columns), format!("{:?}", two.table.columns));
        assert_eq!(two.table.columns.host_us.iter().filter(|us| **us == NO_TIME).count(), 1_000);
        assert_eq!(two.table.columns.host_us[2_999], 1_700_002_999_250_000);
    }

    /// A partly received log, and one whose reader fails in the middle.
    #[test]
    fn received_records_are_not_read_twice_and_survive_an_error() {
        let log = long();
        let mut one = Reading::new(replay(&log), Filter::default());
        assert!(one.burst(Instant::ZERO, 700).unwrap() || one.table.arena.len() == 700);
        one.read_all(Instant::ZERO, || true).unwrap();
        assert_eq!(
            (one.table.arena.len(), one.has_ended(), one.source.bytes()),
            (COPIES * 281, true, log.len() as u64)
        );
        let half = &log[..log.len() / 2];
        let failing = Replay::new(half.chain(Failing), "half a log".into());
        let mut two = Reading::new(failing, Filter::default());
        let error = two.read_all(Instant::ZERO, || true).unwrap_err().to_string();
        assert!(error.contains(&format!("half a log at byte {}", half.len())), "{error}");
        assert!(!two.has_ended() && two.table.arena.len() > COPIES * 130, "{}", two.table.arena.len());
    }

    struct Failing;

    impl Read for Failing {
        fn read(&mut self, _: &mut [u8]) -> std::io::Result<usize> {
            Err(std::io::Error::other("the disk is gone"))
        }
    }

    #[test]
    fn reading_stops_on_request() {
        let log = long();
        let mut asked = 0;
        let mut reading = Reading::new(replay(&log), Filter::default());
        let go_on = || {
            asked += 1;
            asked < 2
        };
        reading.read_all(Instant::ZERO, go_on).unwrap();
        assert!(asked == 2 && !reading.has_ended() && !reading.table.arena.is_empty());
        let mut asked = 0;
        let mut stopped = Reading::new(replay(&log), Filter::default()).without_bodies();
        let go_on = || {
            asked += 1;
            asked < 3
        };
        stopped.read_all(Instant::ZERO, go_on).unwrap();
        assert!(asked == 3 && !stopped.has_ended() && !stopped.table.columns.is_empty());
    }
}
