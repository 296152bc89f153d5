use super::*;
use csi_formats::{Kind, Tones, feitcsi};
use csi5300::source::{CsiSource, Next, replay::Replay};
use csi5300::time::Instant;
use driver_iface::bfee::{Iq, Repr, Wsr};
use driver_iface::record::{Record, code};
use std::path::PathBuf;

/// A record: card's clock, host time (whole microseconds; 0 for none), frame number.
type Told = (u32, u64, u32);

/// A sender.
const fn sender(number: u8) -> Mac {
    Mac([2, 0, 0, 0, 0, number])
}

/// A log of one sender's records, in a file of its own.
fn log(name: &str, records: &[Told]) -> PathBuf {
    log_of(name, &records.iter().map(|told| (sender(1), *told)).collect::<Vec<_>>())
}

/// A log of several senders' records.
fn log_of(name: &str, records: &[(Mac, Told)]) -> PathBuf {
    let mut bytes = Vec::new();
    for (k, (mac, (timestamp_low, host_us, frame_count))) in records.iter().enumerate() {
        let mac = *mac;
        let (tv_sec, tv_usec) = ((host_us / 1_000_000) as u32, (host_us % 1_000_000) as u32);
        let wsr = Some(Wsr { tv_sec, tv_usec, mac, frame_count: Some(*frame_count) });
        let repr =
            Repr { timestamp_low: *timestamp_low, bfee_count: k as u16, rssi: [38, 30, 31], wsr, ..Repr::default() };
        let csi = vec![Iq { i: 40, q: 9 }; repr.samples()];
        let mut body = vec![0; repr.body_len()];
        repr.emit(&csi, &mut body).unwrap();
        let record = Record { code: code::BFEE, body: &body };
        let at = bytes.len();
        bytes.resize(at + record.emit_len(), 0);
        record.emit(&mut bytes[at..]).unwrap();
    }
    let path = std::env::temp_dir().join(format!("csi5300-course-{name}-{}.dat", std::process::id()));
    std::fs::write(&path, bytes).unwrap();
    path
}

/// What `csi5300 info` reports of a log.
fn survey(path: &Path) -> Survey {
    let (mut source, mut survey) = (Replay::open(path).unwrap(), Survey::default());
    loop {
        let next = source.receive(Instant::ZERO).unwrap();
        survey.note(&next);
        if matches!(next, Next::End(_)) {
            return survey;
        }
    }
}

const START_US: u64 = 1_700_000_000_000_000;

/// Checks that `info`, its pictures and `view` agree on a log's times; returns the picture's data.
fn agreed(path: &Path) -> Course {
    let (survey, index) = (survey(path), LogIndex::read(path).unwrap());
    let course = Course::read(path, &Wanted::default()).unwrap();
    let stretch = index.stretch(0.0, f64::INFINITY, 100, None);
    let long_s = survey.elapsed_us(survey.time_base()) as f64 * 1e-6;
    assert!((course.span_s.1 - course.span_s.0 - long_s).abs() < 1e-9, "{:?} {long_s}", course.span_s);
    assert_eq!((course.span_s, course.base), (index.span_s(), index.base()));
    assert_eq!(course.base, survey.time_base());
    let back = [course.steps_back.len(), stretch.steps_back.len()];
    assert_eq!(back, [survey.clock_steps.steps_back as usize; 2]);
    let sender = survey.senders.values().next().unwrap();
    let sum = |marks: &[(usize, u64)]| marks.iter().map(|mark| mark.1).sum::<u64>();
    let counted = |count: u64| if sender.counts_up() { count } else { 0 };
    assert_eq!(
        [course.skipped.iter().map(|mark| mark.1).sum(), sum(&stretch.skipped)],
        [counted(sender.frames_skipped); 2]
    );
    assert_eq!([course.repeated.len() as u64, sum(&stretch.repeated)], [counted(sender.frames_repeated); 2]);
    assert_eq!((&course.gaps_s, &course.steps_back), (&stretch.gaps_s, &stretch.steps_back));
    std::fs::remove_file(path).unwrap();
    course
}

#[test]
fn every_view_shows_the_same_pause_of_an_hour() {
    // The card's clock advances by more than half its range in the pause: only the host's clock shows that it went forward.
    let told = |k: u32| {
        let pause = if k < 50 { 0 } else { 3_553_500_000_u64 };
        let clock = u64::from(4_000_000_000 + 4_000 * k) + pause;
        (clock as u32, START_US + 4_000 * u64::from(k) + pause, k)
    };
    let course = agreed(&log("pause", &(0..100).map(told).collect::<Vec<_>>()));
    assert!(course.steps_back.is_empty() && course.gaps_s.len() == 1, "{:?}", course.gaps_s);
    assert!((course.gaps_s[0].1 - course.gaps_s[0].0 - 3_553.504).abs() < 1e-6, "{:?}", course.gaps_s);
}

#[test]
fn a_clock_that_steps_back_is_seen_once_and_takes_no_time() {
    let told = |k: u32| (1_000_000 + 4_000 * k - if k < 50 { 0 } else { 900_000 }, 0, k);
    let course = agreed(&log("back", &(0..100).map(told).collect::<Vec<_>>()));
    assert_eq!(course.steps_back.len(), 1);
    assert!((course.steps_back[0].1 - 0.896).abs() < 1e-9, "{:?}", course.steps_back);
}

#[test]
fn without_a_card_clock_times_are_the_hosts_or_record_numbers() {
    // Some programs write 0, others add 1 now and then.
    let host =
        agreed(&log("host", &(0..100).map(|k| (k / 10, START_US + 10_000 * u64::from(k), k)).collect::<Vec<_>>()));
    assert_eq!((host.base, host.columns), (TimeBase::Host, 100));
    assert!((host.span_s.1 - 0.99).abs() < 1e-9, "{:?}", host.span_s);
    let number = agreed(&log("number", &(0..29).map(|k| (0, 0, k)).collect::<Vec<_>>()));
    assert_eq!((number.base, number.span_s, number.columns), (TimeBase::Number, (0.0, 28.0), 29));
    assert!(number.gaps_s.is_empty());
    // One column for each record, no empty column between them.
    assert!(number.antennas[0].amplitude_db.iter().all(|db| db.is_finite()), "{:?}", number.antennas[0].line_db);
}

#[test]
fn skipped_and_repeated_frame_numbers_are_marked_in_place() {
    let number = |k: u32| if k < 20 { k } else { k + 3 } - u32::from(k >= 40);
    let course = agreed(&log("numbers", &(0..60).map(|k| (1_000 * k, 0, number(k))).collect::<Vec<_>>()));
    assert_eq!((&course.skipped, &course.repeated), (&vec![(0.02, 3)], &vec![0.04]));
    // Values that do not count up are not frame numbers.
    let random = |k: u32| (1_000 * k, 0, k.wrapping_mul(2_654_435_761) ^ 0x5bd1_e995);
    let course = agreed(&log("random", &(0..60).map(random).collect::<Vec<_>>()));
    assert!(course.skipped.is_empty() && course.repeated.is_empty());
}

#[test]
fn a_stretch_has_its_csi_with_any_clock() {
    // By the card's clock, no record lies after 0.5 s, or at 20 s and later.
    let host = |k: u32| (k / 10, START_US + 10_000 * u64::from(k), k);
    let path = log("cut-host", &(0..100).map(host).collect::<Vec<_>>());
    let course = Course::read(&path, &Wanted::default().with_cut(Some(0.5), None)).unwrap();
    assert_eq!((course.base, course.records, course.antennas.len()), (TimeBase::Host, 50, 3));
    std::fs::remove_file(path).unwrap();
    let path = log("cut-number", &(0..29).map(|k| (0, 0, k)).collect::<Vec<_>>());
    let course = Course::read(&path, &Wanted::default().with_cut(Some(20.0), Some(24.0))).unwrap();
    assert_eq!((course.base, course.records, course.antennas.len()), (TimeBase::Number, 5, 3));
    assert_eq!(course.antennas[0].line_db.len(), 5);
    std::fs::remove_file(path).unwrap();
}

#[test]
fn numbers_skipped_outside_the_selection_are_not_counted() {
    // Two senders alternate, a record a millisecond. The first skips 3 at 20 ms and 5 at 60 ms and repeats one at 30 ms; the other
    // skips 7 at 41 ms.
    let told = |k: u32| {
        let own = k / 2;
        let number = match k % 2 {
            0 => own + if own >= 10 { 3 } else { 0 } + if own >= 30 { 5 } else { 0 } - u32::from(own >= 15),
            _ => own + if own >= 20 { 7 } else { 0 },
        };
        (sender(1 + (k % 2) as u8), (1_000_000 + 1_000 * k, 0, number))
    };
    let path = log_of("cut-numbers", &(0..100).map(told).collect::<Vec<_>>());
    let ms = |t_s: f64| (1_000.0 * t_s).round() as u32;
    let read = |wanted: Wanted| {
        let course = Course::read(&path, &wanted).unwrap();
        let skipped: Vec<_> = course.skipped.iter().map(|(t_s, count)| (ms(*t_s), *count)).collect();
        (skipped, course.repeated.iter().map(|t_s| ms(*t_s)).collect::<Vec<_>>())
    };
    assert_eq!(read(Wanted::default()), (vec![(20, 3), (41, 7), (60, 5)], vec![30]));
    assert_eq!(read(Wanted::default().with_cut(Some(0.05), None)), (vec![(60, 5)], vec![]));
    assert_eq!(read(Wanted::default().with_cut(Some(0.025), Some(0.05))), (vec![(41, 7)], vec![30]));
    assert_eq!(read(Wanted::default().with_macs(vec![sender(2)])), (vec![(41, 7)], vec![]));
    let own = Wanted::default().with_macs(vec![sender(1)]).with_cut(Some(0.045), None);
    assert_eq!(read(own), (vec![(60, 5)], vec![]));

    // The same for a stretch of one chosen sender.
    let index = LogIndex::read(&path).unwrap();
    let counts = |sender: Option<Mac>| {
        let stretch = index.stretch(0.0, f64::INFINITY, 50, sender);
        [stretch.skipped, stretch.repeated].map(|marks| marks.iter().map(|mark| mark.1).sum::<u64>())
    };
    assert_eq!([None, Some(sender(1)), Some(sender(2))].map(counts), [[15, 1], [8, 1], [7, 0]]);
    std::fs::remove_file(path).unwrap();
}

fn fixture() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/small-circle");
    let logs = std::fs::read_dir(root).unwrap().flatten().map(|entry| entry.path());
    logs.filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("csi_rx_")))
        .min()
        .unwrap()
}

/// The fixture without some of its bytes, in a file of its own.
fn without(bytes: std::ops::Range<usize>, name: &str) -> PathBuf {
    let mut log = std::fs::read(fixture()).unwrap();
    log.drain(bytes);
    let path = std::env::temp_dir().join(format!("csi5300-index-{name}-{}.dat", std::process::id()));
    std::fs::write(&path, log).unwrap();
    path
}

#[test]
fn every_record_is_in_one_column_of_one_stretch() {
    let index = LogIndex::read(&fixture()).unwrap();
    let (from_s, to_s) = index.span_s();
    let whole = index.stretch(from_s, to_s, 50, None);
    assert_eq!(whole.records as u64, index.survey().unwrap().bfees());
    let width_s = (to_s - from_s) / whole.rate_hz.len() as f64;
    let counted: f64 = whole.rate_hz.iter().map(|rate| rate * width_s).sum();
    assert!((counted - whole.records as f64).abs() < 0.1, "{counted}");
    let middle_s = 0.5 * (from_s + to_s) + 1e-7;
    let parts = [(from_s, middle_s), (middle_s, to_s)].map(|(a, b)| index.stretch(a, b, 50, None).records);
    assert_eq!(parts[0] + parts[1], whole.records);
    let band = &whole.rssi[0];
    let survey = index.survey().unwrap().rssi[0];
    assert_eq!(band.min.iter().flatten().min().map(|rssi| i32::from(*rssi)), Some(survey.min));
    assert_eq!(band.max.iter().flatten().max().map(|rssi| i32::from(*rssi)), Some(survey.max));
    for ((low, mean), high) in band.min.iter().zip(&band.mean).zip(&band.max) {
        let (Some(low), Some(mean), Some(high)) = (low, mean, high) else { continue };
        assert!(f64::from(*low) <= *mean && *mean <= f64::from(*high));
    }
}

#[test]
fn kept_csi_equals_csi_read_again() {
    let index = LogIndex::read(&fixture()).unwrap();
    let (from_s, to_s) = index.span_s();
    let [sender] = index.senders() else { panic!("{:?}", index.senders()) };
    let kept = index.csi(from_s, to_s, 1, None).unwrap();
    let again = index.csi(from_s, to_s, 1, Some(*sender)).unwrap();
    assert_eq!((kept.records, kept.every, kept.antennas.len()), (again.records, again.every, again.antennas.len()));
    for (a, b) in kept.antennas.iter().zip(&again.antennas) {
        let amplitudes = a.amplitude_db.iter().zip(&b.amplitude_db);
        assert!(amplitudes.clone().count() == 30 && amplitudes.clone().all(|(a, b)| (a - b).abs() < 1e-9));
        assert!(a.phase_rad.iter().zip(&b.phase_rad).all(|(a, b)| (a - b).abs() < 1e-4));
    }
    // A short stretch is read again for any sender, at least two records a column.
    let near = index.csi(from_s, from_s + 0.05, 500, None).unwrap();
    assert!(near.records > 2 && near.columns == near.records.div_ceil(2) && near.every == 1, "{near:?}");
    let own = &near.antennas[0].line_db;
    assert!(own.len() > near.columns / 2, "{own:?}");
}

#[test]
fn losses_are_marked_in_place() {
    let whole = LogIndex::read(&fixture()).unwrap();
    let at = |k: usize| whole.offset[k] as usize;
    // Three records, and later part of one.
    let gone = without(at(100)..at(103), "gone");
    let index = LogIndex::read(&gone).unwrap();
    let (from_s, to_s) = index.span_s();
    let stretch = index.stretch(from_s, to_s, 1_000, None);
    assert_eq!(stretch.columns, stretch.records.div_ceil(2));
    let column = |row: usize| bin(whole.t_s(row), (from_s, to_s), stretch.columns);
    assert_eq!(stretch.missing, [(column(103), 3)]);
    assert!(stretch.damaged.is_empty());

    let torn = without(at(200) + 40..at(200) + 90, "torn");
    let index = LogIndex::read(&torn).unwrap();
    let stretch = index.stretch(0.0, f64::INFINITY, 100, None);
    assert_eq!(stretch.damaged.iter().map(|(_, count)| count).sum::<u64>(), index.survey().unwrap().damages);
    assert!(!stretch.damaged.is_empty());
    // After the damage each row still finds its record.
    let (later_s, end_s) = (index.t_s(210), index.span_s().1);
    let sender = index.senders()[0];
    let behind = index.csi(later_s, end_s, 10, Some(sender)).unwrap();
    assert!(behind.antennas[0].amplitude_db.iter().all(|db| db.is_finite()), "{behind:?}");
    [gone, torn].iter().for_each(|path| std::fs::remove_file(path).unwrap());
}

/// A frame of an AX2xx: kind, width in MHz, receive chains, sender; frames are 1 ms apart by the card's clock.
type Heard = (Kind, u16, u8, u8);

/// A FeitCSI log: chain k has an amplitude of `100 * (k + 1)` and a delay of `SLOPE_RAD` per subcarrier index. Subcarriers that
/// are not measured have noise of ten times that amplitude.
fn card_log(name: &str, frames: &[Heard]) -> PathBuf {
    let mut bytes = Vec::new();
    for (k, (kind, width_mhz, n_rx, sender)) in frames.iter().enumerate() {
        let tones = Tones::of(*kind, *width_mhz).unwrap();
        let repr = feitcsi::Repr {
            ftm: k as u32 * 320_000,
            host_us: START_US + 1_000 * k as u64,
            n_rx: *n_rx,
            n_tx: 1,
            kind: *kind,
            width_mhz: *width_mhz,
            mcs: 0,
            rssi_dbm: [-40 - i16::from(*sender), -50],
            sender: [2, 0, 0, 0, 0, *sender],
            clock_us: 1_000 * k as u32,
        };
        let value = |chain: u8, index: i16, is_data: bool| {
            let size = if is_data { 100.0 * (f64::from(chain) + 1.0) } else { 1_000.0 };
            let (sin, cos) = (0.5 - SLOPE_RAD * f64::from(index)).sin_cos();
            [cos, sin].map(|part| (size * part).round() as i16)
        };
        let csi: Vec<[i16; 2]> = (0..*n_rx)
            .flat_map(|chain| {
                tones.subcarriers.iter().zip(&tones.data).map(move |(index, is_data)| value(chain, *index, *is_data))
            })
            .collect();
        repr.emit(&csi, &mut bytes);
    }
    let path = std::env::temp_dir().join(format!("csi5300-course-{name}-{}.csi", std::process::id()));
    std::fs::write(&path, bytes).unwrap();
    path
}

const SLOPE_RAD: f64 = 0.05;

#[test]
fn other_cards_subcarriers_are_at_their_indices_and_unmeasured_ones_empty() {
    let path = card_log("card", &[(Kind::Ht, 20, 2, 1); 40]);
    let course = Course::read(&path, &Wanted::default()).unwrap();
    assert_eq!((course.records, course.base, course.format), (40, TimeBase::Card, Some("FeitCSI")));
    assert!((course.span_s.1 - 0.039).abs() < 1e-9, "{:?}", course.span_s);
    let indices = course.rows.indices.clone().unwrap();
    assert_eq!((indices.len(), indices[0], indices[28], course.rows.each), (56, -28, 1, 1));
    assert_eq!((course.sender, course.rows.frames.as_deref()), (Some(sender(1)), Some("HT 20 MHz")));
    assert_eq!((course.antennas.len(), course.left_out()), (2, None));
    for (antenna, own) in course.antennas.iter().enumerate() {
        let db = 20.0 * (100.0 * (antenna as f64 + 1.0)).log10();
        for (row, index) in indices.iter().enumerate() {
            let cells = row * course.columns..(row + 1) * course.columns;
            if [7, 21].contains(&index.abs()) {
                assert!(own.amplitude_db[cells].iter().all(|value| value.is_nan()), "a pilot at {index}");
                continue;
            }
            assert!(own.amplitude_db[cells.clone()].iter().all(|value| (value - db).abs() < 0.1), "{antenna} {index}");
            let expected = -SLOPE_RAD * f64::from(index - 1);
            assert!(own.phase_rad[cells].iter().all(|value| (value - expected).abs() < 0.02), "{antenna} {index}");
        }
        assert!(own.line_db.iter().all(|point| (point.1 - db).abs() < 0.1), "{:?}", own.line_db);
    }
    assert!(course.rssi_in_dbm && course.agc.is_empty());
    let levels: Vec<f64> = course.rssi.iter().map(|line| line[0].1).collect();
    assert_eq!((levels, course.rssi[1].len()), (vec![-41.0, -50.0], 40));
    // The page gets the same, from the kept CSI and from the file.
    let index = LogIndex::read(&path).unwrap();
    assert!(index.survey().is_none() && index.card().is_some_and(|(_, survey)| survey.frames == 40));
    assert_eq!((index.antennas(), index.sent()[0].0, index.subcarriers().unwrap().len()), (2, 40, 56));
    assert!((index.sent()[0].1.unwrap() - 1_000.0).abs() < 1e-6);
    let [kept, again] = [None, Some(sender(1))].map(|sender| index.csi(0.0, 1.0, 20, sender).unwrap());
    assert_eq!((kept.antennas.len(), &kept.rows), (2, &course.rows));
    for (a, b) in kept.antennas.iter().zip(&again.antennas) {
        let same = |(a, b): (&f64, &f64)| a.is_nan() && b.is_nan() || (a - b).abs() < 1e-4;
        assert!(a.amplitude_db.iter().zip(&b.amplitude_db).all(same) && a.phase_rad.iter().zip(&b.phase_rad).all(same));
    }
    let band = &index.stretch(0.0, 1.0, 20, None).rssi;
    assert_eq!((band.len(), band[0].min[0], band[1].max[0]), (2, Some(-41), Some(-50)));
    std::fs::remove_file(path).unwrap();
}

#[test]
fn heat_maps_show_one_sender_and_its_most_frequent_frames() {
    let ht = (Kind::Ht, 20, 2, 1);
    let frames: Vec<Heard> = (0..60)
        .map(|k| match k % 6 {
            // Of the most frequent sender's frames, one in five is wider, and one in five has one chain.
            0 => (Kind::Ht, 40, 2, 1),
            1 => (Kind::Ht, 20, 1, 1),
            2 => (Kind::Vht, 80, 2, 2),
            _ => ht,
        })
        .collect();
    let path = card_log("card-mixed", &frames);
    let course = Course::read(&path, &Wanted::default()).unwrap();
    assert_eq!((course.records, course.other_senders, course.other_frames), (60, 10, 10));
    assert_eq!((course.sender, course.rows.subcarriers, course.antennas.len()), (Some(sender(1)), 56, 2));
    let words = course.left_out().unwrap();
    assert_eq!(words, "without 10 records of other senders and 10 records of another kind or width");
    // The levels include all of them.
    assert_eq!((course.rssi[0].len(), course.rssi[1].len()), (60, 50));
    let other = Course::read(&path, &Wanted::default().with_macs(vec![sender(2)])).unwrap();
    assert_eq!((other.records, other.other_senders, other.left_out()), (10, 0, None));
    // 242 subcarriers, two a row.
    assert_eq!((other.rows.subcarriers, other.rows.each, other.rows.len()), (242, 2, 121));
    assert_eq!(other.antennas[0].amplitude_db.len(), 121 * other.columns);
    assert!(other.antennas[0].amplitude_db.iter().all(|db| (db - 40.0).abs() < 0.1), "pilots are no part of the means");
    let index = LogIndex::read(&path).unwrap();
    let all = index.csi(0.0, 1.0, 10, None).unwrap();
    assert_eq!((all.records, all.other_frames, all.rows.subcarriers), (60, 20, 56));
    let own = index.csi(0.0, 1.0, 10, Some(sender(2))).unwrap();
    assert_eq!((own.records, own.other_frames, own.rows.subcarriers), (10, 0, 242));
    std::fs::remove_file(path).unwrap();
}

#[test]
fn damage_in_another_cards_log_is_marked_in_place() {
    let path = card_log("card-torn", &[(Kind::Ht, 20, 1, 1); 20]);
    let mut bytes = std::fs::read(&path).unwrap();
    let len = bytes.len() / 20;
    bytes.drain(10 * len + 300..10 * len + 350);
    std::fs::write(&path, bytes).unwrap();
    let course = Course::read(&path, &Wanted::default()).unwrap();
    assert!(course.lost_something && course.records == 19, "{}", course.records);
    // The tenth frame takes its missing bytes from the next; the rest of that is damage.
    let [damaged_s] = course.damaged[..] else { panic!("{:?}", course.damaged) };
    assert!((damaged_s - 0.010).abs() < 1e-9, "{damaged_s}");
    std::fs::remove_file(path).unwrap();
}
