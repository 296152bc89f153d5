//! Compares a log as a table with the same log frame by frame.

use super::whole::Cut;
use super::{
    Arena, Columns, Filter, FilterError, Form, Held, NO_ANTENNA, NO_TIME, Order, Reading, Rows, Widest, decode,
    decode_in,
};
use csi5300::source::replay::Replay;
use csi5300::source::{CsiSource, Next};
use csi5300::time::Instant;
use csi5300::{Frame, Log};
use driver_iface::bfee::{Antenna, Iq, Repr};
use driver_iface::record::{LOOKAHEAD, Record, code};
use num_complex::Complex32;
use std::io::Read;
use std::path::{Path, PathBuf};

fn path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/small-circle/csi_rx_2023-11-14_221320.dat")
}

fn table(filter: Filter) -> (Arena, Columns, u64) {
    let mut reading = Reading::new(Replay::open(&path()).unwrap(), filter);
    while reading.burst(Instant::ZERO, usize::MAX).unwrap() {}
    assert!(reading.has_ended());
    let (arena, columns) = reading.take();
    (arena, columns, reading.left_out)
}

fn frames() -> Vec<Frame> {
    Log::open(path()).unwrap().map(Result::unwrap).collect()
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
    assert!(matches!(Filter::default().with_macs(["me"]), Err(FilterError::Mac { .. })));
    assert!(matches!(Filter::default().with_antennas("AD"), Err(FilterError::Antennas { .. })));
    assert!(matches!(Filter::default().with_time(Some(2.0), Some(2.0)), Err(FilterError::Time { .. })));
    assert!(matches!(Filter::default().with_time(Some(f64::NAN), None), Err(FilterError::Time { .. })));
}

/// Copies of the fixture's 281 records.
const COPIES: usize = 150;

/// Enough copies of the fixture for several blocks of memory, damaged in places, with MPDU records in between.
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

fn long() -> Vec<u8> {
    let whole = std::fs::read(path()).unwrap();
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
        // As if for too few bytes, and for more than there is memory.
        for size in [None, Some(1), Some(u64::MAX)] {
            let mut other = Reading::new(replay(&log), filter.clone());
            other.read_cut(Instant::ZERO, cut, size, &mut (), || true).unwrap();
            assert_eq!((other.arena.len(), other.columns.len()), (one.arena.len(), one.columns.len()), "{size:?}");
        }
        let mut two = Reading::new(replay(&log), filter);
        two.read_cut(Instant::ZERO, cut, Some(log.len() as u64), &mut (), || true).unwrap();
        assert!(one.has_ended() && two.has_ended() && one.left_out == two.left_out);
        assert_eq!(serde_json::to_string(&one.survey).unwrap(), serde_json::to_string(&two.survey).unwrap());
        let ((a, a_columns), (b, b_columns)) = (one.take(), two.take());
        assert!(bodies(&a) == bodies(&b), "{} records, {}", a.len(), b.len());
        assert_eq!(format!("{a_columns:?}"), format!("{b_columns:?}"));
        assert_eq!(a.len() + one.left_out as usize, COPIES * 281);
    }
}

/// Without bodies a whole log is read on one thread, in reused memory.
#[test]
fn columns_without_bodies_equal_those_of_the_whole_log() {
    let log = long();
    let few = Filter::default().with_time(Some(0.5), Some(0.6)).unwrap();
    let small = |head| Cut { first: 1_000, block: Some(4_096 + head), head };
    let cuts = [Cut::default(), small(LOOKAHEAD), small(100)];
    for (filter, cut) in [Filter::default(), few].iter().flat_map(|filter| cuts.map(|cut| (filter.clone(), cut))) {
        let mut whole = Reading::new(replay(&log), filter.clone());
        while whole.burst(Instant::ZERO, usize::MAX).unwrap() {}
        let mut alone = Reading::new(replay(&log), filter).without_bodies();
        alone.read_cut(Instant::ZERO, cut, Some(log.len() as u64), &mut (), || true).unwrap();
        assert!(alone.has_ended() && alone.arena.is_empty() && alone.left_out == whole.left_out);
        assert_eq!(serde_json::to_string(&alone.survey).unwrap(), serde_json::to_string(&whole.survey).unwrap());
        assert!(format!("{:?}", alone.columns) == format!("{:?}", whole.columns), "columns differ");
    }
    let mut asked = 0;
    let mut stopped = Reading::new(replay(&log), Filter::default()).without_bodies();
    let go_on = || {
        asked += 1;
        asked < 3
    };
    stopped.read_all(Instant::ZERO, go_on).unwrap();
    assert!(asked == 3 && !stopped.has_ended() && !stopped.columns.is_empty());
}

/// Host times of a side file, some unknown, with noise between records: records with and without them in one block.
#[test]
fn two_threads_read_the_host_times_that_one_reads() {
    let folder = std::env::temp_dir().join(format!("csi5300-table-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("stock.dat");
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
    std::fs::write(folder.join("stock.datstp"), times.as_flattened()).unwrap();
    let open = || Reading::new(Replay::open(&path).unwrap(), Filter::default());
    let (mut one, mut two) = (open(), open());
    while one.burst(Instant::ZERO, usize::MAX).unwrap() {}
    let cut = Cut { first: 1_000, block: Some(4_096 + LOOKAHEAD), head: LOOKAHEAD };
    two.read_cut(Instant::ZERO, cut, None, &mut (), || true).unwrap();
    std::fs::remove_dir_all(&folder).unwrap();
    assert_eq!(format!("{:?}", one.columns), format!("{:?}", two.columns));
    assert_eq!(two.columns.host_us.iter().filter(|us| **us == NO_TIME).count(), 1_000);
    assert_eq!(two.columns.host_us[2_999], 1_700_002_999_250_000);
}

/// A partly received log, and one whose reader fails in the middle.
#[test]
fn received_records_are_not_read_twice_and_survive_an_error() {
    let log = long();
    let mut one = Reading::new(replay(&log), Filter::default());
    assert!(one.burst(Instant::ZERO, 700).unwrap() || one.arena.len() == 700);
    one.read_all(Instant::ZERO, || true).unwrap();
    assert_eq!((one.arena.len(), one.has_ended(), one.source().bytes()), (COPIES * 281, true, log.len() as u64));
    let half = &log[..log.len() / 2];
    let failing = Replay::new(half.chain(Failing), "half a log".into());
    let mut two = Reading::new(failing, Filter::default());
    let error = two.read_all(Instant::ZERO, || true).unwrap_err().to_string();
    assert!(error.contains(&format!("half a log at byte {}", half.len())), "{error}");
    assert!(!two.has_ended() && two.arena.len() > COPIES * 130, "{}", two.arena.len());
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
    assert!(asked == 2 && !reading.has_ended() && !reading.arena.is_empty());
    assert!(Held::read(&mut replay(&log), &|| false).unwrap().is_none());
}

#[test]
fn a_held_log_can_be_replayed() {
    let log = long();
    let held = Held::read(&mut replay(&log), &|| true).unwrap().unwrap();
    for _ in 0..2 {
        let (mut own, mut again, mut given) = (replay(&log), held.source(), 0);
        loop {
            let (a, b) = (own.receive(Instant::ZERO).unwrap(), again.receive(Instant::ZERO).unwrap());
            match (&a, &b) {
                (Next::Record(a_stamps, a), Next::Record(b_stamps, b)) => {
                    assert!(a_stamps == b_stamps && (a.code, a.body) == (b.code, b.body));
                }
                _ => assert_eq!(format!("{a:?}"), format!("{b:?}")),
            }
            given += 1;
            if matches!(a, Next::End(_)) {
                break;
            }
        }
        assert!(given > 12_000 && again.next_at().is_none());
    }
}
