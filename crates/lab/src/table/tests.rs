//! A log as a table against the same log frame by frame.

use super::{Arena, Columns, Filter, FilterError, Form, NO_TIME, Reading, Rows, decode};
use csi5300::source::replay::Replay;
use csi5300::time::Instant;
use csi5300::{Frame, Log};
use driver_iface::bfee::Antenna;
use num_complex::Complex32;
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
fn a_table_is_its_frames() {
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
fn rows_that_a_record_does_not_have_are_no_numbers() {
    let (arena, ..) = table(Filter::default());
    // Columns for two streams, of which the records have one; rows in another order; a record that is not there.
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

#[test]
fn filters_keep_what_was_asked_for() {
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
