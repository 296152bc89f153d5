use super::content::BFEE;
use super::*;
use crate::mcap::McapWriter;
use crate::messages::Message;
use crate::messages::own::Csi;
use crate::messages::standard::{Clock, Header, Odometry, PoseStamped, Time};
use csi5300::signal::csi::Csi as Matrix;
use csi5300::source::survey::Survey;
use csi5300::source::{Next, Stamps};
use driver_iface::bfee::{Bfee, Repr};
use driver_iface::record::{Record, Step, events};
use std::sync::atomic::{AtomicU64, Ordering};

pub(super) fn csi(number: u32) -> Csi {
    Csi {
        header: Header { stamp: Time::from_us(12_000_000 + i64::from(number)), frame_id: String::new() },
        mac: "00:21:6a:00:00:07".into(),
        frame_count: number,
        timestamp_low: 9,
        bfee_count: 8,
        n_rx: 2,
        n_tx: 1,
        rssi: [30, 0, 31],
        noise: -92,
        agc: 40,
        rate_n_flags: 0x101,
        antennas: vec![0, 2],
        re: (0..60).collect(),
        im: (-60..0).collect(),
    }
}

/// A path of this test alone: tests of one process run in parallel.
pub(super) fn own_path(name: &str) -> PathBuf {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let count = COUNT.fetch_add(1, Ordering::Relaxed);
    std::env::temp_dir().join(format!("csi5300-unbag-{}-{count}-{name}", std::process::id()))
}

/// A folder with a recording of these messages.
pub(super) fn recorded(name: &str, write: impl FnOnce(&mut McapWriter<File>)) -> PathBuf {
    let folder = own_path(name);
    std::fs::create_dir_all(&folder).unwrap();
    write(&mut McapWriter::new(File::create(folder.join("run_0.mcap")).unwrap()).unwrap());
    folder
}

pub(super) fn put<T: Message>(writer: &mut McapWriter<File>, topic: &str, message: &T) {
    writer.put((topic, T::TYPE, T::definition), 5, &message.payload()).unwrap();
}

#[test]
fn a_recording_becomes_a_log_and_a_trajectory() {
    let folder = recorded("whole", |writer| {
        (1..=3).for_each(|k| put(writer, "/n/csi", &csi(k)));
        let bad = Csi { re: vec![1; 7], ..csi(4) };
        put(writer, "/n/csi", &bad);
        let mut odometry = Odometry::default();
        odometry.header.stamp = Time::from_us(12_500_000);
        (odometry.pose.pose.position.x, odometry.pose.pose.orientation.w) = (1.5, 1.0);
        put(writer, "/odom", &odometry);
        put(writer, "/clock", &Clock::default());
        // A bearing published as a pose.
        put(writer, "/lab/csi5300_a/b/direction", &PoseStamped::default());
        writer.finish().unwrap();
    });
    let out = folder.join("out");
    let done = unbag(&folder, &out, false).unwrap();
    let counts: Vec<_> =
        done.topics.iter().map(|topic| (topic.topic.as_str(), topic.messages, topic.unreadable)).collect();
    assert_eq!(counts, [("/n/csi", 3, 1), ("/odom", 1, 0)]);
    assert_eq!((done.others, done.cut.len()), (2, 0));
    let log = std::fs::read(out.join("n_csi.dat")).unwrap();
    assert_eq!(bodies(&log).len(), 3);
    let bfee = Bfee::new_checked(bodies(&log)[1]).unwrap();
    let wsr = bfee.wsr().unwrap();
    assert_eq!((wsr.tv_sec, wsr.tv_usec, wsr.frame_count, wsr.mac.to_string()), (12, 2, Some(2), csi(2).mac));
    let matrix = Matrix::from_bfee(&bfee).unwrap();
    assert_eq!(matrix.as_slice().iter().map(|h| h.re as i8).collect::<Vec<_>>(), csi(2).re);
    assert_eq!(matrix.antenna(1), Some(driver_iface::bfee::Antenna::ALL[2]));
    let path = std::fs::read_to_string(out.join("odom.csv")).unwrap();
    assert!(path.starts_with("12.500000,0,1.500000,"), "{path}");
    assert!(matches!(unbag(&folder, &out, false), Err(BagError::There { .. })), "nothing is overwritten");
    unbag(&folder, &out, true).unwrap();
    std::fs::remove_dir_all(&folder).unwrap();
}

/// The records of a log.
fn bodies(log: &[u8]) -> Vec<&[u8]> {
    let body = |step| match step {
        Step::Record { record, .. } => Some(record.body),
        _ => None,
    };
    events(log).filter_map(body).collect()
}

#[test]
fn a_published_and_recorded_log_is_restored() {
    let log = include_bytes!("../../../../tests/fixtures/small-circle/csi_rx_2023-11-14_221320.dat");
    let mut survey = Survey::default();
    let folder = recorded("again", |writer| {
        for body in bodies(log) {
            let next = Next::Record(Stamps::default(), Record { code: BFEE, body });
            let (bfee, identity) = survey.note(&next).unwrap();
            put(writer, "/csi", &Csi::of(Time::from_us(identity.host_us.unwrap()), &bfee, identity));
        }
        writer.finish().unwrap();
    });
    unbag(&folder, &folder, false).unwrap();
    let again = std::fs::read(folder.join("csi.dat")).unwrap();
    assert!(bodies(log).len() > 100 && bodies(log).len() == bodies(&again).len());
    for (before, after) in bodies(log).into_iter().zip(bodies(&again)) {
        let (before, after) = (Bfee::new_checked(before).unwrap(), Bfee::new_checked(after).unwrap());
        // Chains are then in the order of their antennas.
        let plain = |bfee| Repr { antenna_sel: 0, reserved: 0, ..Repr::parse(bfee) };
        assert_eq!(plain(&before), plain(&after));
        let matrix = |bfee| Matrix::from_bfee(bfee).unwrap();
        assert_eq!(matrix(&before).as_slice(), matrix(&after).as_slice());
        assert_eq!(matrix(&before).antenna(0), matrix(&after).antenna(0));
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_cut_recording_is_read_up_to_the_cut_and_other_files_are_refused() {
    let folder = recorded("cut", |writer| {
        put(writer, "/csi", &csi(1));
        writer.flush().unwrap();
        put(writer, "/csi", &csi(2));
        writer.flush().unwrap();
    });
    let file = folder.join("run_0.mcap");
    let bytes = std::fs::read(&file).unwrap();
    let messages = |length: usize| {
        std::fs::write(&file, &bytes[..length]).unwrap();
        let out = folder.join(length.to_string());
        let done = unbag(&file, &out, false).unwrap();
        assert_eq!(done.cut, std::slice::from_ref(&file));
        done.topics.iter().map(|topic| topic.messages).sum::<u64>()
    };
    assert_eq!(messages(bytes.len()), 2);
    assert_eq!(messages(bytes.len() - 100), 1);
    assert_eq!(messages(60), 0);
    std::fs::write(&file, b"PNG").unwrap();
    assert!(matches!(unbag(&file, &folder.join("x"), false), Err(BagError::Unknown { .. })));
    assert!(matches!(unbag(&folder.join("60"), &folder.join("x"), false), Err(BagError::Empty { .. })));
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn topics_with_equal_or_empty_plain_names_get_separate_files() {
    let folder = recorded("names", |writer| {
        for topic in ["/a/b", "/a_b", "", "/", "a/b"] {
            let mut pose = PoseStamped::default();
            pose.pose.orientation.w = 1.0;
            put(writer, topic, &pose);
        }
        writer.finish().unwrap();
    });
    for replace in [false, true] {
        let done = unbag(&folder, &folder.join("out"), replace).unwrap();
        let names = |topic: &UnbaggedTopic| topic.file.file_name().unwrap().to_str().unwrap().to_owned();
        let mut names: Vec<_> = done.topics.iter().map(names).collect();
        names.sort();
        assert_eq!(names, ["a_b-2.csv", "a_b-3.csv", "a_b.csv", "topic-2.csv", "topic.csv"]);
        assert!(done.topics.iter().all(|topic| topic.messages == 1));
    }
    assert_eq!(std::fs::read_dir(folder.join("out")).unwrap().count(), 5, "nothing else is left");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn the_recording_is_never_overwritten() {
    let folder = recorded("input", |writer| {
        put(writer, "/n/csi", &csi(1));
        writer.finish().unwrap();
    });
    let (recording, log) = (folder.join("run_0.mcap"), folder.join("n_csi.dat"));
    let before = std::fs::read(&recording).unwrap();
    let links: [fn(&Path, &Path) -> io::Result<()>; 2] =
        [|from, to| std::fs::hard_link(from, to), |from, to| std::os::unix::fs::symlink(from, to)];
    for link in links {
        link(&recording, &log).unwrap();
        for bag in [&recording, &log, &folder] {
            assert!(matches!(unbag(bag, &folder, true), Err(BagError::Input { .. })), "{}", bag.display());
        }
        assert_eq!(std::fs::read(&recording).unwrap(), before);
        std::fs::remove_file(&log).unwrap();
    }
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1, "nothing is left of what was refused");
    std::fs::remove_dir_all(&folder).unwrap();
}
