use super::*;
use std::path::PathBuf;

fn fixture() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/small-circle");
    let logs = std::fs::read_dir(root).unwrap().flatten().map(|entry| entry.path());
    logs.filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("csi_rx_")))
        .min()
        .unwrap()
}

/// The fixture with some of its bytes taken out, in a file of its own.
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
    assert_eq!(whole.records as u64, index.survey().bfees());
    let width_s = (to_s - from_s) / whole.rate_hz.len() as f64;
    let counted: f64 = whole.rate_hz.iter().map(|rate| rate * width_s).sum();
    assert!((counted - whole.records as f64).abs() < 0.1, "{counted}");
    let middle_s = 0.5 * (from_s + to_s) + 1e-7;
    let parts = [(from_s, middle_s), (middle_s, to_s)].map(|(a, b)| index.stretch(a, b, 50, None).records);
    assert_eq!(parts[0] + parts[1], whole.records);
    let band = &whole.rssi[0];
    let survey = index.survey().rssi[0];
    assert_eq!(band.min.iter().flatten().min().map(|rssi| i32::from(*rssi)), Some(survey.min));
    assert_eq!(band.max.iter().flatten().max().map(|rssi| i32::from(*rssi)), Some(survey.max));
    for ((low, mean), high) in band.min.iter().zip(&band.mean).zip(&band.max) {
        let (Some(low), Some(mean), Some(high)) = (low, mean, high) else { continue };
        assert!(f64::from(*low) <= *mean && *mean <= f64::from(*high));
    }
}

#[test]
fn csi_kept_and_csi_read_again_are_the_same() {
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
    // A short stretch is read again whoever sent it, a column for two records at most.
    let near = index.csi(from_s, from_s + 0.05, 500, None).unwrap();
    assert!(near.records > 2 && near.columns == near.records.div_ceil(2) && near.every == 1, "{near:?}");
    let own = &near.antennas[0].line_db;
    assert!(own.len() > near.columns / 2, "{own:?}");
}

#[test]
fn what_is_missing_stands_where_it_is_missing() {
    let whole = LogIndex::read(&fixture()).unwrap();
    let at = |k: usize| whole.seen.rows[k].offset as usize;
    // Three records, and later a piece of one.
    let gone = without(at(100)..at(103), "gone");
    let index = LogIndex::read(&gone).unwrap();
    let (from_s, to_s) = index.span_s();
    let stretch = index.stretch(from_s, to_s, 1_000, None);
    assert_eq!(stretch.columns, stretch.records.div_ceil(2));
    let column = |row: usize| bin(whole.seen.rows[row].t_s(), (from_s, to_s), stretch.columns);
    assert_eq!(stretch.missing, [(column(103), 3)]);
    assert!(stretch.damaged.is_empty());

    let torn = without(at(200) + 40..at(200) + 90, "torn");
    let index = LogIndex::read(&torn).unwrap();
    let stretch = index.stretch(0.0, f64::INFINITY, 100, None);
    assert_eq!(stretch.damaged.iter().map(|(_, count)| count).sum::<u64>(), index.survey().damages);
    assert!(!stretch.damaged.is_empty());
    // Behind the damage each row still finds its record.
    let (later_s, end_s) = (index.seen.rows[210].t_s(), index.span_s().1);
    let sender = index.senders()[0];
    let behind = index.csi(later_s, end_s, 10, Some(sender)).unwrap();
    assert!(behind.antennas[0].amplitude_db.iter().all(|db| db.is_finite()), "{behind:?}");
    [gone, torn].iter().for_each(|path| std::fs::remove_file(path).unwrap());
}

#[test]
fn kept_columns_double_as_the_log_grows() {
    let index = LogIndex::read(&fixture()).unwrap();
    let (from_s, to_s) = index.span_s();
    let length_us = ((to_s - from_s) * 1e6) as i64;
    let kept = &index.kept;
    assert!(
        kept.width_us * KEPT as i64 > length_us
            && (kept.width_us == FIRST_WIDTH_US || kept.width_us * KEPT as i64 / 2 <= length_us)
    );
    let mut long = Kept::new();
    let csi_of = |path: &Path| -> Csi {
        let mut source = Replay::open(path).unwrap();
        loop {
            if let Next::Record(_, record) = source.receive(Instant::ZERO).unwrap()
                && let Ok(bfee) = Bfee::new_checked(record.body)
            {
                return Csi::from_bfee(&bfee).unwrap();
            }
        }
    };
    let csi = csi_of(&fixture());
    let times_s = [0.0, 1.0, 10.0, 100.0, 1000.0];
    times_s.iter().for_each(|t_s| long.add((t_s * 1e6) as i64, &csi));
    let cells = long.stretch((0.0, 1000.0), 1000);
    let line = cells[&0].clone().course(Antenna::A, (0.0, 1000.0)).unwrap().line_db;
    let seen: Vec<f64> = line.iter().map(|point| point.0).collect();
    for (t_s, seen) in [0.0, 10.0, 100.0, 999.5].iter().zip(&seen) {
        assert!((t_s - seen).abs() < 1.5, "{seen}");
    }
}
