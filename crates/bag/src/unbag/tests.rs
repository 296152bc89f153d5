//! Recordings of all kinds, intact and damaged.

use super::*;
use crate::cdr::Cdr;
use crate::mcap::McapWriter;
use crate::messages::{Clock, Csi, Header, Message, Odometry, PoseStamped, Time};
use csi5300::motion::odometry::csv;
use csi5300::signal::csi::Csi as Matrix;
use csi5300::source::survey::Survey;
use csi5300::source::{Next, Stamps};
use driver_iface::bfee::{Bfee, Repr};
use driver_iface::record::{Step, events};
use std::sync::atomic::{AtomicU64, Ordering};

fn csi(number: u32) -> Csi {
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

/// A folder of one test alone, because tests of one process run in parallel; removed at its end.
struct Own(PathBuf);

impl Own {
    fn new() -> Self {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("csi5300-unbag-{}-{count}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }
}

impl Drop for Own {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A folder with a recording of these messages.
fn recorded(write: impl FnOnce(&mut McapWriter<File>)) -> Own {
    let folder = Own::new();
    let mut writer = McapWriter::new(File::create(folder.0.join("run_0.mcap")).unwrap()).unwrap();
    write(&mut writer);
    folder
}

/// The topics of a recording, written into a folder that is made for it.
fn written(bag: &Path, out: &Path) -> Result<Recording, BagError> {
    std::fs::create_dir_all(out).unwrap();
    Recording::write(bag, out, |_| Ok(()))
}

/// The recording of these messages.
fn mcap(write: impl FnOnce(&mut McapWriter<File>)) -> Vec<u8> {
    std::fs::read(recorded(write).0.join("run_0.mcap")).unwrap()
}

/// Writes records of CSI and poses of these numbers.
fn put_all(
    writer: &mut McapWriter<File>,
    records: std::ops::RangeInclusive<u32>,
    poses: std::ops::RangeInclusive<u32>,
) {
    records.for_each(|k| put(writer, "/n/csi", &csi(k)));
    poses.for_each(|k| put(writer, "/odom", &odometry(k)));
}

fn put<T: Message>(writer: &mut McapWriter<File>, topic: &str, message: &T) {
    writer.put((topic, T::TYPE, T::definition), 5, &message.payload()).unwrap();
}

#[test]
fn a_recording_becomes_a_log_and_a_trajectory() {
    let own = recorded(|writer| {
        (1..=3).for_each(|k| put(writer, "/n/csi", &csi(k)));
        let bad = Csi { re: vec![1; 7], ..csi(4) };
        put(writer, "/n/csi", &bad);
        put(writer, "/odom", &odometry(3));
        put(writer, "/clock", &Clock::default());
        // Bearings as poses.
        for topic in ["/lab/csi5300_a/b/direction", "/csi5300_a/b/pose", "/bearing/tx1", "/mirror/tx1"] {
            put(writer, topic, &PoseStamped::default());
        }
        writer.finish().unwrap();
    });
    let folder = &own.0;
    let out = folder.join("out");
    let done = written(folder, &out).unwrap();
    let counts: Vec<_> =
        done.topics.iter().map(|topic| (topic.topic.as_str(), topic.messages, topic.unreadable)).collect();
    assert_eq!(counts, [("/n/csi", 3, 1), ("/odom", 1, 0)]);
    assert_eq!((done.others, done.cut.len()), (5, 0));
    let log = std::fs::read(out.join("n_csi.dat")).unwrap();
    assert_eq!(bodies(&log).len(), 3);
    let bfee = Bfee::new_checked(bodies(&log)[1]).unwrap();
    let wsr = bfee.wsr().unwrap();
    assert_eq!((wsr.tv_sec, wsr.tv_usec, wsr.frame_count, wsr.mac.to_string()), (12, 2, Some(2), csi(2).mac));
    let matrix = Matrix::from_bfee(&bfee).unwrap();
    assert_eq!(matrix.as_slice().iter().map(|h| h.re as i8).collect::<Vec<_>>(), csi(2).re);
    assert_eq!(matrix.antenna(1), Some(driver_iface::bfee::Antenna::ALL[2]));
    let path = std::fs::read_to_string(out.join("odom.csv")).unwrap();
    assert_eq!(path.lines().next(), Some("t,ns,frame,child_frame,x,y,z,qx,qy,qz,qw"));
    assert!(path.contains("\n12,3000,,base_link,1.500000,"), "{path}");
    let refused = Recording::write(folder, &out, |file| Err(format!("not {}", file.display()))).unwrap_err();
    assert_eq!(refused.to_string(), "not n_csi.dat");
}

#[test]
fn poses_keep_their_attitude_and_frame_and_need_a_stamp() {
    let tilted = |number: u32, frame: &str| {
        let mut told = odometry(number);
        told.header.frame_id = frame.into();
        (told.pose.pose.orientation.y, told.pose.pose.orientation.w) = 15_f64.to_radians().sin_cos();
        told
    };
    let read = |frames: [&str; 2]| {
        let own = recorded(|writer| {
            let unstamped = Odometry { header: Header::default(), ..tilted(2, "") };
            [tilted(1, frames[0]), unstamped, tilted(3, frames[1])].iter().for_each(|told| put(writer, "/odom", told));
            writer.finish().unwrap();
        });
        Recording::read(&own.0).unwrap().topics.remove(0)
    };
    // Also one that reads like a number, and one with what parts columns.
    for frame in ["odom", "", "1", "a,\"b;"] {
        let one = read([frame; 2]);
        assert_eq!((one.messages, one.unreadable), (2, 1));
        let (path, counts) = csv::parse_topic(&one.bytes, "/odom").unwrap();
        assert_eq!((counts.rows, counts.bad_rows, path.span_s()), (2, 0, (12.000001, 12.000003)));
        // It leans forward by 30 degrees.
        let text = String::from_utf8(one.bytes).unwrap();
        assert!(
            text.ends_with(",1.500000,0.000000,0.000000,0.000000000,0.258819045,0.000000000,0.965925826\n"),
            "{text}"
        );
    }
    // ROS's null quaternion: no orientation was set.
    let own = recorded(|writer| {
        for number in 1..3 {
            let Odometry { header, mut pose, .. } = odometry(number);
            pose.pose.orientation.w = 0.0;
            put(writer, "/pose", &PoseStamped { header, pose: pose.pose });
        }
        writer.finish().unwrap();
    });
    let one = Recording::read(&own.0).unwrap().topics.remove(0);
    let (path, counts) = csv::parse_topic(&one.bytes, "/pose").unwrap();
    assert_eq!((one.unreadable, counts.bad_rows, path.poses()[1].position_m.x), (0, 0, 1.0));
    assert!(path.poses().iter().all(|pose| pose.heading_rad.is_none()));
    let why = csv::parse_topic(&read(["odom", "map"]).bytes, "/odom").unwrap_err().to_string();
    assert!(why.contains("poses of `map -> base_link` among those of `odom -> base_link`"), "{why}");
}

#[test]
fn a_sender_without_frame_numbers_has_none_in_the_log() {
    let own = recorded(|writer| {
        put(writer, "/n/csi", &Csi { frame_count: 0, ..csi(1) });
        writer.finish().unwrap();
    });
    let recording = Recording::read(&own.0).unwrap();
    let wsr = Bfee::new_checked(bodies(&recording.topics[0].bytes)[0]).unwrap().wsr().unwrap();
    assert_eq!((wsr.mac.to_string(), wsr.frame_count), (csi(1).mac, None));
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
    let own = recorded(|writer| {
        for body in bodies(log) {
            let next = Next::Record(Stamps::default(), Record { code: code::BFEE, body });
            let (bfee, identity) = survey.note(&next).unwrap();
            put(writer, "/csi", &Csi::of(Time::from_us(identity.host_us.unwrap()), &bfee, identity));
        }
        writer.finish().unwrap();
    });
    let folder = &own.0;
    written(folder, folder).unwrap();
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
}

#[test]
fn a_cut_recording_is_read_up_to_the_cut_and_other_files_are_refused() {
    let own = recorded(|writer| {
        put(writer, "/csi", &csi(1));
        writer.flush().unwrap();
        put(writer, "/csi", &csi(2));
        writer.flush().unwrap();
    });
    let folder = &own.0;
    let file = folder.join("run_0.mcap");
    let bytes = std::fs::read(&file).unwrap();
    let messages = |length: usize| {
        std::fs::write(&file, &bytes[..length]).unwrap();
        let done = Recording::read(&file).unwrap();
        assert_eq!(done.cut, std::slice::from_ref(&file));
        done.topics.iter().map(|topic| topic.messages).sum::<u64>()
    };
    assert_eq!(messages(bytes.len()), 2);
    assert_eq!(messages(bytes.len() - 100), 1);
    assert_eq!(messages(60), 0);
    std::fs::write(&file, b"PNG").unwrap();
    assert!(matches!(Recording::read(&file), Err(BagError::Refused { .. })));
    std::fs::create_dir(folder.join("empty")).unwrap();
    assert!(matches!(Recording::read(&folder.join("empty")), Err(BagError::Refused { .. })));
}

#[test]
fn of_files_put_one_behind_the_other_each_is_read() {
    let first = mcap(|writer| {
        put_all(writer, 1..=3, 1..=2);
        writer.finish().unwrap();
    });
    // Its first topic has the number that another one has in the first file.
    let second = mcap(|writer| {
        (3..=7).for_each(|k| put(writer, "/odom", &odometry(k)));
        writer.finish().unwrap();
    });
    let counted = |bytes: &[u8]| {
        let done = read_of("both", bytes).unwrap();
        let counts = done.topics.iter().map(|topic| (topic.topic.clone(), topic.messages)).collect::<Vec<_>>();
        (counts, done.damaged_parts, done.cut.len())
    };
    let all = |csi, odom| vec![("/n/csi".to_owned(), csi), ("/odom".to_owned(), odom)];
    assert_eq!(counted(&[first.clone(), second.clone()].concat()), (all(3, 7), 0, 0));
    assert_eq!(counted(&[&first[..], &second[..second.len() / 2]].concat()).2, 1, "the second is cut");
    assert_eq!(counted(&[&first[..], b"else"].concat()), (all(3, 2), 1, 0));
    assert_eq!(counted(&first[..first.len() - 4]), (all(3, 2), 0, 0));
}

#[test]
fn topics_with_equal_or_empty_plain_names_get_separate_files() {
    let own = recorded(|writer| {
        for topic in ["/a/b", "/a_b", "", "/", "a/b"] {
            let Odometry { header, pose, .. } = odometry(1);
            put(writer, topic, &PoseStamped { header, pose: pose.pose });
        }
        writer.finish().unwrap();
    });
    let folder = &own.0;
    let done = written(folder, &folder.join("out")).unwrap();
    let mut names: Vec<_> = done.topics.iter().map(|topic| topic.file.to_str().unwrap()).collect();
    names.sort();
    assert_eq!(names, ["a_b-2.csv", "a_b-3.csv", "a_b.csv", "topic-2.csv", "topic.csv"]);
    assert!(done.topics.iter().all(|topic| topic.messages == 1));
    assert_eq!(std::fs::read_dir(folder.join("out")).unwrap().count(), 5, "nothing else is left");
}

fn odometry(number: u32) -> Odometry {
    let mut odometry = Odometry::default();
    odometry.header.stamp = Time::from_us(12_000_000 + i64::from(number));
    odometry.child_frame_id = "base_link".into();
    (odometry.pose.pose.position.x, odometry.pose.pose.orientation.w) = (f64::from(number) / 2.0, 1.0);
    odometry
}

/// The result of reading a file with these bytes.
fn read_of(name: &str, bytes: &[u8]) -> Result<Recording, BagError> {
    let folder = Own::new();
    let file = folder.0.join(name);
    std::fs::write(&file, bytes).unwrap();
    Recording::read(&file)
}

/// Name, messages and bytes of each topic.
fn contents(recording: &Recording) -> Vec<(&str, u64, &[u8])> {
    recording.topics.iter().map(|one| (one.topic.as_str(), one.messages, one.bytes.as_slice())).collect()
}

fn zstd(bytes: &[u8]) -> Vec<u8> {
    ruzstd::encoding::compress_to_vec(bytes, ruzstd::encoding::CompressionLevel::Fastest)
}

fn lz4(bytes: &[u8]) -> Vec<u8> {
    let mut to = lz4_flex::frame::FrameEncoder::new(Vec::new());
    to.write_all(bytes).unwrap();
    to.finish().unwrap()
}

/// The same file without a summary, its chunks compressed with `pack` under the name `by`.
fn chunks(bytes: &[u8], by: &str, pack: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
    rebuilt(bytes, |content| {
        assert_eq!(content[28..32], [0; 4], "this one is not compressed");
        let packed = pack(&content[40..]);
        let head = [&content[..28], &(by.len() as u32).to_le_bytes(), by.as_bytes()];
        let content = [&head.concat()[..], &(packed.len() as u64).to_le_bytes(), &packed].concat();
        [&[0x06][..], &(content.len() as u64).to_le_bytes(), &content].concat()
    })
}

/// The same file without a summary, its chunks replaced by what `other` makes of their content.
fn rebuilt(bytes: &[u8], other: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
    let (mut made, mut rest) = (bytes[..8].to_vec(), &bytes[8..]);
    while rest.len() > 9 {
        let length = u64::from_le_bytes(*rest[1..].first_chunk().unwrap()) as usize;
        let (kind, content) = (rest[0], &rest[9..9 + length]);
        rest = &rest[9 + length..];
        if kind == 0x06 {
            made.extend(other(content));
        } else if kind == 0x0f {
            made.extend([&[kind][..], &(length as u64).to_le_bytes(), content].concat());
            return made;
        }
    }
    panic!("no end of the data")
}

#[test]
fn compressed_recordings_read_like_uncompressed_ones() {
    let bytes = mcap(|writer| {
        put_all(writer, 1..=3, 1..=2);
        writer.finish().unwrap();
    });
    let expected = read_of("plain", &bytes).unwrap();
    assert_eq!(
        contents(&expected).iter().map(|(topic, messages, _)| (*topic, *messages)).collect::<Vec<_>>(),
        [("/n/csi", 3), ("/odom", 2)]
    );
    let two_frames = |bytes: &[u8]| [zstd(&bytes[..10]), zstd(&bytes[10..])].concat();
    for (name, made) in [
        ("zstd", chunks(&bytes, "zstd", zstd)),
        ("frames", chunks(&bytes, "zstd", two_frames)),
        ("lz4", chunks(&bytes, "lz4", lz4)),
        ("without chunks", rebuilt(&bytes, |content| content[40..].to_vec())),
        ("file", zstd(&bytes)),
    ] {
        assert_eq!(contents(&read_of(name, &made).unwrap()), contents(&expected), "{name}");
    }
    // A compressed file that was cut is read up to the cut.
    let packed = zstd(&mcap(|writer| {
        for k in 1..=1_500 {
            put(writer, "/n/csi", &csi(k));
            (k % 100 == 0).then(|| writer.flush().unwrap());
        }
        writer.finish().unwrap();
    }));
    let read = |length: usize| read_of("cut", &packed[..length]).unwrap();
    let cut = read(packed.len() * 3 / 4);
    assert!((100..1_500).contains(&cut.topics[0].messages) && cut.cut.len() == 1, "{}", cut.topics[0].messages);
    assert_eq!((read(packed.len()).topics[0].messages, read(30).cut.len()), (1_500, 1));
    // Each message compressed by itself.
    let own = recorded(|writer| {
        let mut put = |topic: &str, kind, payload: Vec<u8>| {
            writer.put((topic, kind, String::new), 5, &zstd(&payload)).unwrap();
        };
        (1..=3).for_each(|k| put("/n/csi", "csi5300_msgs/msg/Csi", csi(k).payload()));
        (1..=2).for_each(|k| put("/odom", Odometry::TYPE, odometry(k).payload()));
        writer.finish().unwrap();
    });
    let folder = &own.0;
    assert_eq!(contents(&Recording::read(folder).unwrap()), contents(&expected));
    // Damage costs one chunk and is counted.
    let damaged = read_of("damaged", &chunks(&bytes, "lz4", |bytes| vec![7; bytes.len()])).unwrap();
    assert_eq!((damaged.damaged_parts, damaged.topics.len()), (1, 0));
    let other = read_of("other", &chunks(&bytes, "brotli", <[u8]>::to_vec));
    assert!(matches!(other, Err(BagError::Refused { why, .. }) if why.contains("brotli")));
}

#[test]
fn a_database_with_deep_trees_and_overflow_pages_is_read() {
    let bytes = include_bytes!("../../../../tests/fixtures/recording.db3");
    let read = read_of("whole.db3", bytes).unwrap();
    let messages: Vec<_> =
        read.topics.iter().map(|one| (one.topic.as_str(), one.content, one.messages, one.unreadable)).collect();
    assert_eq!(messages, [("/odom", Content::Poses, 12, 0), ("/n/csi", Content::Csi, 40, 0)]);
    let rows = String::from_utf8(read.topics[0].bytes.clone()).unwrap();
    for row in ["12,1000000,odom,base_link,0.500000,", "12,12000000,odom,base_link,6.000000,"] {
        assert!(rows.contains(&format!("\n{row}")), "{rows}");
    }
    // The fixture's messages compressed one by one, and the whole file.
    assert_eq!(contents(&read_of("packed.db3", &zstd(bytes)).unwrap()), contents(&read));
    // A cut file is read up to the cut; reading ends although pages lead back to themselves.
    let mut most = 0;
    for pages in 1..bytes.len() / 512 {
        match read_of("cut.db3", &bytes[..pages * 512]) {
            Ok(read) => {
                assert_eq!(read.cut.len(), 1, "{pages}");
                most = most.max(read.topics.iter().map(|one| one.messages).sum::<u64>());
            }
            Err(error) => assert!(matches!(error, BagError::Refused { .. }), "{error}"),
        }
    }
    assert!((30..52).contains(&most), "{most}");
    // A tree whose right-most page leads to itself.
    let mut endless = bytes.to_vec();
    endless[100..112].copy_from_slice(&[5, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1]);
    endless.resize(20 << 20, 0);
    let ended = sqlite::read(Path::new("endless.db3"), io::Cursor::new(endless), &mut |_, _| Ok(()));
    assert!(matches!(ended, Err(BagError::Refused { .. })), "{ended:?}");
    // Playing a compressed file leaves the unpacked one beside it: each message counts once.
    let own = Own::new();
    let folder = &own.0;
    std::fs::write(folder.join("run_0.db3"), bytes).unwrap();
    std::fs::write(folder.join("run_0.db3.zstd"), zstd(bytes)).unwrap();
    assert_eq!(contents(&Recording::read(folder).unwrap()), contents(&read));
    let mut seed = 7_u32;
    for _ in 0..2_000 {
        let mut damaged = bytes.to_vec();
        for _ in 0..20 {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let place = 100 + (seed >> 4) as usize % (damaged.len() - 100);
            damaged[place] = seed as u8;
        }
        let path = Path::new("damaged.db3");
        let mut messages = 0;
        let ended = sqlite::read(path, io::Cursor::new(damaged), &mut |_, _| {
            messages += 1;
            Ok(())
        });
        assert!(matches!(ended, Ok(_) | Err(BagError::Refused { .. })) && messages < 1_000, "{ended:?}");
    }
}

/// A record of a bag of ROS 1.
fn record1(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    let field = |(name, value): &(&str, &[u8])| {
        let one = [name.as_bytes(), b"=", value].concat();
        [&(one.len() as u32).to_le_bytes()[..], &one].concat()
    };
    let header: Vec<u8> = fields.iter().flat_map(field).collect();
    [&(header.len() as u32).to_le_bytes()[..], &header, &(data.len() as u32).to_le_bytes(), data].concat()
}

/// A bag's description of the topic whose messages have `number`.
fn connection(number: u32, topic: &str, kind: &str) -> Vec<u8> {
    let data = record1(&[("topic", topic.as_bytes()), ("type", kind.as_bytes())], &[]);
    // Only the fields: a connection's data is itself a header.
    let data = &data[4..data.len() - 4];
    record1(&[("op", &[7]), ("conn", &number.to_le_bytes()), ("topic", topic.as_bytes())], data)
}

/// A message of ROS 1 in a bag.
fn message(number: u32, data: &[u8]) -> Vec<u8> {
    record1(&[("op", &[2]), ("conn", &number.to_le_bytes()), ("time", &[0; 8])], data)
}

/// A string as ROS 1 writes it.
fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

/// Numbers as ROS 1 writes them.
fn numbers(numbers: &[f64]) -> Vec<u8> {
    numbers.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// A header of ROS 1 at `s` seconds.
fn header1(s: u32) -> Vec<u8> {
    [&9_u32.to_le_bytes()[..], &s.to_le_bytes(), &500_u32.to_le_bytes(), &text("odom")].concat()
}

/// A pose of ROS 1.
fn pose1() -> Vec<u8> {
    numbers(&[1.5, -2.0, 0.0, 0.0, 0.0, 0.0, 1.0])
}

/// A chunk of a bag of ROS 1.
fn chunk1(compression: &str, data: &[u8]) -> Vec<u8> {
    record1(&[("op", &[5]), ("compression", compression.as_bytes()), ("size", &[0; 4])], data)
}

#[test]
fn a_ros_1_bag_is_read() {
    let odometry = [header1(12), text("base"), pose1(), numbers(&[0.0; 36 + 6 + 36])].concat();
    let csi = [
        header1(13),
        text("00:21:6a:00:00:07"),
        [5_u32, 6].iter().flat_map(|v| v.to_le_bytes()).collect(),
        7_u16.to_le_bytes().to_vec(),
        vec![1, 1, 30, 0, 0, 164, 40, 1, 1],
        [&1_u32.to_le_bytes()[..], &[0]].concat(),
        [&30_u32.to_le_bytes()[..], &[3; 30]].concat(),
        [&30_u32.to_le_bytes()[..], &[4; 30]].concat(),
    ];
    let inside = [
        connection(0, "/odom", "nav_msgs/Odometry"),
        connection(1, "/csi", "csi5300_msgs/Csi"),
        connection(2, "/words", "std_msgs/String"),
        message(0, &odometry),
        message(1, &csi.concat()),
        message(2, &text("hello")),
        message(0, &odometry[..99]),
    ];
    let inside = inside.concat();
    let file = |compression: &str, data: &[u8]| {
        [&ros1::MAGIC[..], &record1(&[("op", &[3])], &[32; 40]), &chunk1(compression, data)].concat()
    };
    for (name, bytes) in [("none.bag", file("none", &inside)), ("lz4.bag", file("lz4", &lz4(&inside)))] {
        let read = read_of(name, &bytes).unwrap();
        let counts: Vec<_> = read.topics.iter().map(|one| (one.topic.as_str(), one.messages, one.unreadable)).collect();
        assert_eq!((counts, read.others, read.cut.len()), (vec![("/odom", 1, 1), ("/csi", 1, 0)], 1, 0));
        let rows = String::from_utf8(read.topics[0].bytes.clone()).unwrap();
        assert!(rows.contains("\n12,500,odom,base,1.500000,-2.000000,0.000000,0.000000000,"), "{rows}");
        let cut = read_of(name, &bytes[..bytes.len() - 9]).unwrap();
        assert_eq!(cut.cut.len(), 1);
    }
    assert!(
        matches!(read_of("bz2.bag", &file("bz2", &inside)), Err(BagError::Refused { why, .. }) if why.contains("bz2"))
    );
}

/// A recording in two chunks, of which only the first describes the topics. It has three records of CSI and two poses, then
/// two records and one pose. Also returns the offsets of the chunks.
fn in_two() -> (Vec<u8>, [usize; 2]) {
    let bytes = mcap(|writer| {
        put_all(writer, 1..=3, 1..=2);
        writer.flush().unwrap();
        put_all(writer, 4..=5, 3..=3);
        writer.finish().unwrap();
    });
    let chunks: Vec<usize> = places(&bytes, 0x06).take(2).map(|at| at + 9 + 40).collect();
    (bytes, [chunks[0], chunks[1]])
}

/// The offsets of an MCAP file's records of a kind.
fn places(bytes: &[u8], kind: u8) -> impl Iterator<Item = usize> {
    let next = |at: &usize| Some(at + 9 + u64::from_le_bytes(*bytes[at + 1..].first_chunk()?) as usize);
    std::iter::successors(Some(8), next).filter(move |at| bytes[*at] == kind)
}

/// Messages of the topics, damaged parts and messages of unknown topics.
fn counts(recording: &Recording) -> (Vec<u64>, u64, u64) {
    assert!(recording.cut.is_empty(), "{:?}", recording.cut);
    let messages = recording.topics.iter().map(|one| one.messages).collect();
    (messages, recording.damaged_parts, recording.without_topic)
}

#[test]
fn a_chunk_with_a_wrong_checksum_is_skipped() {
    let (bytes, [first, second]) = in_two();
    assert_eq!(counts(&read_of("whole", &bytes).unwrap()), (vec![5, 3], 0, 0));
    // The last byte of the second chunk belongs to a pose.
    let mut damaged = bytes.clone();
    let end = second - 40 + u64::from_le_bytes(*bytes[second - 48..].first_chunk().unwrap()) as usize;
    damaged[end - 1] ^= 1;
    assert_eq!(counts(&read_of("pose", &damaged).unwrap()), (vec![3, 2], 1, 0));
    // Without a CRC the chunk is used.
    damaged[second - 16..second - 12].fill(0);
    assert_eq!(counts(&read_of("sum", &damaged).unwrap()), (vec![5, 3], 0, 0));
    // Without a CRC, a length beyond the chunk costs the messages after it.
    damaged[second + 8] = 0xff;
    assert_eq!(counts(&read_of("length", &damaged).unwrap()), (vec![3, 2], 1, 0));
    // The summary repeats the topics of the first chunk, so that later messages are used.
    let mut damaged = bytes.clone();
    damaged[first + 20] ^= 1;
    assert_eq!(counts(&read_of("first", &damaged).unwrap()), (vec![2, 1], 1, 0));
}

#[test]
fn messages_of_unknown_topics_are_counted() {
    let (bytes, [first, _]) = in_two();
    let mut damaged = bytes.clone();
    damaged[first + 20] ^= 1;
    // Without a summary, as in an unfinished recording; and with a damaged summary.
    // The data ends and the summary begins there.
    let data = places(&damaged, 0x0f).next().unwrap();
    let without = [&damaged[..data], &[0x0f, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]].concat();
    assert_eq!(counts(&read_of("without", &without).unwrap()), (vec![], 1, 3));
    let footer = damaged.len() - 8 - 20;
    let sum = driver_iface::mpdu::crc32(&damaged[data + 13..footer + 16]);
    damaged[footer + 16..footer + 20].copy_from_slice(&sum.to_le_bytes());
    assert_eq!(counts(&read_of("summed", &damaged).unwrap()), (vec![2, 1], 1, 0));
    damaged[data + 13 + 20] ^= 1;
    assert_eq!(counts(&read_of("twice", &damaged).unwrap()), (vec![], 1, 3));
    // The summary is only read where the footer says.
    for start in [0, u64::MAX, bytes.len() as u64] {
        damaged[footer..footer + 8].copy_from_slice(&start.to_le_bytes());
        assert_eq!(counts(&read_of("nowhere", &damaged).unwrap()), (vec![], 1, 3));
    }
}

#[test]
fn damage_in_a_database_loses_only_the_damaged_rows() {
    let bytes = include_bytes!("../../../../tests/fixtures/recording.db3");
    let (mut messages, mut without) = (Vec::new(), Vec::new());
    for page in 1..bytes.len() / 512 {
        let mut damaged = bytes.to_vec();
        let kind = damaged[512 * page];
        damaged[512 * page] = 0xee;
        match read_of("middle.db3", &damaged) {
            Ok(read) => {
                let (topics, parts, orphans) = counts(&read);
                // The first byte of an overflow page belongs to the next page's number.
                assert!(parts > 0 || ![5, 13].contains(&kind) || topics == [12, 40], "page {page}");
                messages.push(topics.iter().sum::<u64>() + orphans);
                without.push(orphans);
            }
            Err(error) => assert!(matches!(error, BagError::Refused { .. }), "{error}"),
        }
    }
    // Most pages hold messages; without the page of topics, every message lacks one.
    assert!(messages.iter().filter(|count| (26..52).contains(*count)).count() > 10, "{messages:?}");
    assert_eq!(without.iter().filter(|orphans| **orphans == 52).count(), 1, "{without:?}");
    assert!(messages.iter().all(|count| *count <= 52));
}

#[test]
fn a_bags_index_replaces_connections_of_a_damaged_chunk() {
    let pose = [header1(12), pose1()].concat();
    let described = connection(0, "/pose", "geometry_msgs/PoseStamped");
    let chunks = [
        chunk1("lz4", &[7; 40]),
        chunk1("none", &[message(0, &pose), message(0, &pose)].concat()),
        // It ends inside a message.
        chunk1("none", &message(0, &pose)[..60]),
    ]
    .concat();
    let start = |index: u64| record1(&[("op", &[3]), ("index_pos", &index.to_le_bytes())], &[32; 40]);
    let index = ros1::MAGIC.len() + start(0).len() + chunks.len();
    let file = |at: u64| [&ros1::MAGIC[..], &start(at), &chunks, &described].concat();
    let read = read_of("indexed.bag", &file(index as u64)).unwrap();
    assert_eq!((counts(&read), read.topics[0].topic.as_str()), ((vec![2], 2, 0), "/pose"));
    // An unfinished bag has no index.
    let read = read_of("unindexed.bag", &file(0)).unwrap();
    assert_eq!(counts(&read), (vec![], 2, 2));
}

/// An MCAP file with one Zstandard chunk that claims `size` bytes.
fn bomb(records: &[u8], size: u64) -> Vec<u8> {
    let packed = zstd(records);
    let mut content = [0, 1, size].map(u64::to_le_bytes).concat();
    content.extend([0; 4]);
    content.extend(4_u32.to_le_bytes());
    content.extend(b"zstd");
    content.extend((packed.len() as u64).to_le_bytes());
    content.extend(packed);
    let head = [&[0x06][..], &(content.len() as u64).to_le_bytes()].concat();
    [crate::mcap::MAGIC, head.as_slice(), &content].concat()
}

#[test]
fn an_unpacked_chunk_is_bounded_and_streamed() {
    // One record of an unknown kind, all zeros.
    let size = 96_u64 << 20;
    let mut records = vec![0x7f];
    records.extend((size - 9).to_le_bytes());
    records.resize(size as usize, 0);
    let good = bomb(&records, size);
    drop(records);
    assert!(good.len() < 1 << 20, "{}", good.len());
    let mut read = None;
    let used = allocation_counter::measure(|| read = Some(read_of("bomb", &good).unwrap()));
    let read = read.unwrap();
    assert_eq!((read.damaged_parts, read.topics.len()), (0, 0));
    assert!(used.bytes_max < 16 << 20, "{} bytes at a time", used.bytes_max);
    // Longer or shorter than claimed, or than allowed.
    for said in [size - 1, size + 1, 1 << 30] {
        assert_eq!(read_of("bomb-said", &bomb(&[0; 64], said)).unwrap().damaged_parts, 1);
    }
}
