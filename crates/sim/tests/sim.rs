//! The simulated room from outside: an AX210's bytes in its log and the same frames from its card; the captures of Dijkstra et
//! al. (\[paper\] in docs/reference/references.md), simulated and real, byte for byte by our encoder.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../../tests/common/mod.rs"]
mod common;

use csi_formats::{Frame, Item, Kind, items};
use csi5300::source::replay::Replay;
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Next, side_path};
use csi5300::time::Instant;
use csi5300_sim::scene::Driver;
use csi5300_sim::{Room, Scene, SceneError, WrittenLog, write_dataset};
use driver_iface::bfee::{Bfee, Iq, MAX_SAMPLES, Repr};
use driver_iface::record::{Record, Step, Tail, events};

const SCENE: &str = "duration_s = 30.0\ncard = \"ax210\"\nsounding.rate_hz = 20\n\
     [radio]\nsend_jitter_us = 60\nturn_around.spread_us = 5\nchain_deg = [90.0, 0.0]\n\
     [[robot]]\nname = \"rx\"\nantenna_b_m = [0.0, 0.1, 0.0]\n\
     [[robot]]\nname = \"tx\"\nposition_m = [3.0, 0.0, 0.5]\ncrystal = { offset_ppm = 7.0, clock_start_us = 4294000000 }\n";

fn frames(log: &[u8]) -> Vec<Frame> {
    let frame = |item: Item| match item {
        Item::Frame(frame) => frame,
        Item::Skipped(bad) => panic!("{bad:?}"),
    };
    items(log).unwrap().map(frame).collect()
}

#[test]
fn a_log_is_feitcsis_with_both_clocks_of_one_crystal() {
    let run = Room::new(&Scene::parse(SCENE).unwrap()).unwrap().run().unwrap();
    for (robot, other) in [(0, 1), (1, 0)] {
        let robot = &run.robots[robot];
        let all = frames(&robot.log);
        assert_eq!((all.len(), robot.records), (600, 600));
        assert!(all.iter().all(|frame| frame.sender == Some(run.robots[other].mac.0)));
        let shape = |frame: &Frame| (frame.kind, frame.width_mhz, frame.n_rx, frame.n_tx, frame.subcarriers.len());
        assert!(all.iter().all(|frame| shape(frame) == (Some(Kind::He), 20, 2, 1, 242)));
        // The FTM clock wraps twice meanwhile; between two frames both clocks agree to a microsecond.
        let mut wraps = 0;
        for two in all.windows(2) {
            let [[from, from_us], [to, to_us]] =
                [&two[0], &two[1]].map(|frame| [frame.clock.unwrap().ticks, frame.slow_clock.unwrap().ticks]);
            wraps += usize::from(to < from);
            let us = (to as u32).wrapping_sub(from as u32) as f64 * 3.125e-3;
            let slow_us = (to_us as u32).wrapping_sub(from_us as u32) as f64;
            assert!((us - slow_us).abs() < 1.0 && (4e4..6e4).contains(&us), "{us} {slow_us}");
        }
        assert!((2..=3).contains(&wraps), "{wraps}");
    }
    // Chain B has its constant, and a pilot nothing of the channel.
    let frame = &frames(&run.robots[0].log)[0];
    let phase = |k: usize| {
        let [a, b] = [0, 1].map(|chain| frame.column(chain, 0).unwrap()[k]);
        (b[1] * a[0] - b[0] * a[1]).atan2(a[0] * b[0] + a[1] * b[1])
    };
    let middle = phase(120);
    assert!((0..242).filter(|k| frame.measured[*k]).all(|k| (phase(k) - middle).abs() < 0.1), "{middle}");
    let way_m = (3.0_f64.powi(2) + 0.01 + 0.25).sqrt() - (9.25_f64).sqrt();
    let expected = std::f64::consts::FRAC_PI_2 - std::f64::consts::TAU * way_m * 5.54e9 / 299_792_458.0;
    let off = f64::from(middle) - expected;
    assert!((off - std::f64::consts::TAU * (off / std::f64::consts::TAU).round()).abs() < 0.05, "{off}");
}

#[test]
fn a_live_card_and_its_log_give_the_same_records() {
    let scene = Scene::parse(SCENE).unwrap();
    let run = Room::new(&scene).unwrap().run().unwrap();
    let collect = |source: &mut dyn CsiSource| {
        let (mut all, mut now) = (Vec::new(), Instant::ZERO);
        loop {
            match source.receive(now).unwrap() {
                Next::Record(_, record) => all.push((record.code, record.body.to_vec())),
                Next::Pending => now = source.next_at().unwrap(),
                Next::End(_) => break all,
                Next::Lost(loss) => panic!("{loss:?}"),
            }
        }
    };
    let mut room = Room::new(&scene).unwrap();
    let live = collect(&mut room.card(1).unwrap());
    assert_eq!(live.len(), 1_200);
    assert!(live == collect(&mut run.robots[1].replay()));
    // The same in a folder, whose log is recognised by its content.
    let folder = std::env::temp_dir().join(format!("csi5300-ax210-{}", std::process::id()));
    let captures = write_dataset(&mut Room::new(&scene).unwrap(), &folder, &mut |_| ()).unwrap();
    let path = &captures[0].logs[1].path;
    assert!(std::fs::read(path).unwrap() == run.robots[1].log);
    assert!(live == collect(&mut csi5300::source::replay::Replay::open(path).unwrap()));
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn keys_of_another_card_are_refused() {
    let said = |from: &str, to: &str| {
        let error = Room::new(&Scene::parse(&SCENE.replacen(from, to, 1)).unwrap()).unwrap_err();
        error.to_string()
    };
    for (from, to, words) in [
        ("card = \"ax210\"", "preamble = \"he\"", "preamble is of an AX210"),
        ("card", "driver = \"stock\"\ncard", "FeitCSI"),
        ("[radio]", "[radio]\nantenna_order = \"by_rssi\"", "no order by RSSI"),
        ("antenna_b_m", "antenna_c_m = [0.0, 0.2, 0.0]\nantenna_b_m", "has two"),
        ("[radio]", "[radio]\nchain_noise_rad = -1.0", "chain_noise_rad"),
    ] {
        assert!(said(from, to).contains(words), "{}", said(from, to));
    }
    assert!(matches!(Scene::parse("card = \"ax200\""), Err(SceneError::Value { line: Some(1), .. })));
}

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
fn the_papers_captures_survive_our_encoder() {
    let Some(captures) = crate::common::captures() else { return };
    let runs = [
        ("circle", ["sim_30cm_1", "real_10cm_1", "real_20cm_2", "real_30cm_2"]),
        ("line", ["sim_30cm_1", "real_10cm_2", "real_20cm_1", "real_30cm_3"]),
    ];
    for (shape, run) in runs.into_iter().flat_map(|(shape, runs)| runs.map(|run| (shape, run))) {
        for end in ["rx", "tx"] {
            let name = format!("csi_{end}_{run}.dat");
            let bytes = std::fs::read(captures.join("paper").join(shape).join(&name)).unwrap();
            let (written, records) = again(&bytes);
            assert!(bytes.starts_with(&written), "{name} differs after reading and writing");
            // The real ones end in a cut record.
            let (least, cut) = if run.starts_with("sim") { (1_000, 0) } else { (2_501, 232) };
            assert!(records >= least && bytes.len() - written.len() <= cut, "{name}: {records} records");
        }
    }
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
