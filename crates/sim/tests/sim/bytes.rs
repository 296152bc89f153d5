//! The captures of Dijkstra et al. (\[paper\] in docs/reference/references.md), simulated and real, read and written again by our encoder, are byte-identical.

use csi5300::source::replay::Replay;
use csi5300::source::side_path;
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Next};
use csi5300::time::Instant;
use csi5300_sim::scene::Driver;
use csi5300_sim::{Room, Scene, WrittenLog, write_dataset};
use driver_iface::bfee::{Bfee, Iq, MAX_SAMPLES, Repr};
use driver_iface::record::{Record, Step, Tail, events};

/// Parses a log and re-encodes every record, up to a cut tail.
fn again(bytes: &[u8]) -> (Vec<u8>, usize) {
    let (mut out, mut records) = (Vec::with_capacity(bytes.len()), 0);
    for event in events(bytes) {
        let record = match event {
            Step::Record { record, .. } => record,
            Step::End(Tail::Clean | Tail::Cut { .. }) => break,
            other => panic!("damage in a simulated capture: {other:?}"),
        };
        let bfee = Bfee::new_checked(record.body).unwrap();
        let mut csi = [Iq::default(); MAX_SAMPLES];
        let samples = bfee.unpack(&mut csi).unwrap();
        let repr = Repr::parse(&bfee);
        let mut body = vec![0; repr.body_len()];
        repr.emit(&csi[..samples], &mut body).unwrap();
        let copy = Record { code: record.code, body: &body };
        let at = out.len();
        out.resize(at + copy.emit_len(), 0);
        copy.emit(&mut out[at..]).unwrap();
        records += 1;
    }
    (out, records)
}

#[test]
fn the_papers_simulated_captures_survive_our_encoder() {
    let Some(captures) = crate::common::captures() else { return };
    for shape in ["circle", "line"] {
        for end in ["rx", "tx"] {
            let path = captures.join("paper").join(shape).join(format!("csi_{end}_sim_30cm_1.dat"));
            let bytes = std::fs::read(&path).unwrap();
            let (written, records) = again(&bytes);
            assert_eq!(records, 1_000, "{}", path.display());
            assert!(written == bytes, "{} differs after reading and writing", path.display());
        }
    }
}

#[test]
fn the_papers_real_captures_survive_it_too() {
    let Some(captures) = crate::common::captures() else { return };
    let mut files = 0;
    for (shape, runs) in [("circle", ["10cm_1", "20cm_2", "30cm_2"]), ("line", ["10cm_2", "20cm_1", "30cm_3"])] {
        for (run, end) in runs.into_iter().flat_map(|run| [(run, "rx"), (run, "tx")]) {
            let name = format!("csi_{end}_real_{run}.dat");
            let path = captures.join("paper").join(shape).join(&name);
            let bytes = std::fs::read(&path).unwrap();
            let (written, records) = again(&bytes);
            assert!(records > 2_500 && bytes.len() - written.len() < 233, "{name}: {records} records");
            assert!(bytes.starts_with(&written), "{name} differs after reading and writing");
            files += 1;
        }
    }
    assert_eq!(files, 12);
}

/// Number and host time of a bfee.
type Told = (Option<u32>, Option<i64>);

/// Frame number and host time of every bfee in a log, and how many records it has.
fn identities(log: &WrittenLog) -> (Vec<Told>, u64) {
    let mut replay = Replay::open(&log.path).unwrap();
    let (mut survey, mut found) = (Survey::default(), Vec::new());
    loop {
        let next = replay.receive(Instant::ZERO).unwrap();
        found.extend(survey.note(&next).map(|(_, identity)| (identity.frame_count, identity.host_us)));
        if matches!(next, Next::End(_)) {
            return (found, survey.records);
        }
    }
}

#[test]
fn the_stock_layouts_side_file_has_the_host_times_of_wsr_records() {
    let folder = std::env::temp_dir().join(format!("csi5300-stock-{}", std::process::id()));
    let logs = |driver: Driver, killed: bool| {
        let mut scene = Scene { duration_s: 3.0, driver, ..Scene::built_in("lab-circle").unwrap() };
        scene.robot.iter_mut().for_each(|robot| robot.faults.killed = killed);
        let dir = folder.join(format!("{driver:?}{killed}"));
        write_dataset(&mut Room::new(&scene).unwrap(), &dir, &mut |_| {}).unwrap()[0].logs.clone()
    };
    let (wsr, stock) = (logs(Driver::Wsr, false), logs(Driver::Stock, false));
    for (wsr, stock) in wsr.iter().zip(&stock) {
        let ((said, records), (beside, twice)) = (identities(wsr), identities(stock));
        assert!(said == beside && said.len() > 250 && said.iter().all(|said| said.1.is_some()));
        assert_eq!((twice, stock.records), (2 * records, twice));
        assert!(!side_path(&wsr.path).exists());
    }
    let cut = &logs(Driver::Stock, true)[0];
    let stamps = std::fs::metadata(side_path(&cut.path)).unwrap().len();
    assert!(cut.tail_records > 0 && stamps == 8 * cut.records, "{cut:?}: {stamps} bytes of stamps");
    std::fs::remove_dir_all(&folder).unwrap();
}
