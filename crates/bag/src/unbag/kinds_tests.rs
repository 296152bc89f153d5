//! All kinds of recordings: compressed, SQLite, ROS 1.

use super::tests::{csi, put, recorded};
use super::*;
use crate::cdr::Cdr;
use crate::messages::Message;
use crate::messages::standard::{Odometry, Time};

/// A recording of three records of CSI and two poses, as uncompressed MCAP.
fn plain() -> Vec<u8> {
    let folder = recorded("plain", |writer| {
        (1..=3).for_each(|k| put(writer, "/n/csi", &csi(k)));
        (1..=2).for_each(|k| put(writer, "/odom", &odometry(k)));
        writer.finish().unwrap();
    });
    let bytes = std::fs::read(folder.join("run_0.mcap")).unwrap();
    std::fs::remove_dir_all(&folder).unwrap();
    bytes
}

pub(super) fn odometry(number: u32) -> Odometry {
    let mut odometry = Odometry::default();
    odometry.header.stamp = Time::from_us(12_000_000 + i64::from(number));
    odometry.child_frame_id = "base_link".into();
    (odometry.pose.pose.position.x, odometry.pose.pose.orientation.w) = (f64::from(number) / 2.0, 1.0);
    odometry
}

/// The result of reading a file with these bytes.
pub(super) fn read_of(name: &str, bytes: &[u8]) -> Result<Recording, BagError> {
    let file = super::tests::own_path(name);
    std::fs::write(&file, bytes).unwrap();
    let read = Recording::read(&file);
    std::fs::remove_file(&file).unwrap();
    read
}

/// Name, messages and bytes of each topic.
fn contents(recording: &Recording) -> Vec<(&str, u64, &[u8])> {
    recording.topics.iter().map(|one| (one.topic.as_str(), one.messages, one.bytes.as_slice())).collect()
}

fn zstd(bytes: &[u8]) -> Vec<u8> {
    ruzstd::encoding::compress_to_vec(bytes, ruzstd::encoding::CompressionLevel::Fastest)
}

/// The same file without a summary, its chunks compressed with `pack` under the name `by`.
fn chunks(bytes: &[u8], by: &str, pack: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
    let (mut made, mut rest) = (bytes[..8].to_vec(), &bytes[8..]);
    while rest.len() > 9 {
        let length = u64::from_le_bytes(*rest[1..].first_chunk().unwrap()) as usize;
        let (kind, content) = (rest[0], &rest[9..9 + length]);
        rest = &rest[9 + length..];
        if kind == 0x06 {
            assert_eq!(content[28..32], [0; 4], "this one is not compressed");
            let packed = pack(&content[40..]);
            let head = [&content[..28], &(by.len() as u32).to_le_bytes(), by.as_bytes()];
            let content = [&head.concat()[..], &(packed.len() as u64).to_le_bytes(), &packed].concat();
            made.extend([&[kind][..], &(content.len() as u64).to_le_bytes(), &content].concat());
        } else if kind == 0x0f {
            made.extend([&[kind][..], &(length as u64).to_le_bytes(), content].concat());
            return made;
        }
    }
    panic!("no end of the data")
}

#[test]
fn compressed_recordings_read_like_uncompressed_ones() {
    let bytes = plain();
    let expected = read_of("plain", &bytes).unwrap();
    assert_eq!(
        contents(&expected).iter().map(|(topic, messages, _)| (*topic, *messages)).collect::<Vec<_>>(),
        [("/n/csi", 3), ("/odom", 2)]
    );
    let lz4 = |bytes: &[u8]| {
        let mut to = lz4_flex::frame::FrameEncoder::new(Vec::new());
        to.write_all(bytes).unwrap();
        to.finish().unwrap()
    };
    let two_frames = |bytes: &[u8]| [zstd(&bytes[..10]), zstd(&bytes[10..])].concat();
    for (name, made) in [
        ("zstd", chunks(&bytes, "zstd", zstd)),
        ("frames", chunks(&bytes, "zstd", two_frames)),
        ("lz4", chunks(&bytes, "lz4", lz4)),
        ("file", zstd(&bytes)),
    ] {
        assert_eq!(contents(&read_of(name, &made).unwrap()), contents(&expected), "{name}");
    }
    // A compressed file that was cut is read up to the cut.
    let folder = recorded("many", |writer| {
        for k in 1..=1_500 {
            put(writer, "/n/csi", &csi(k));
            (k % 100 == 0).then(|| writer.flush().unwrap());
        }
        writer.finish().unwrap();
    });
    let packed = zstd(&std::fs::read(folder.join("run_0.mcap")).unwrap());
    let read = |length: usize| read_of("cut", &packed[..length]).unwrap();
    let cut = read(packed.len() * 3 / 4);
    assert!((100..1_500).contains(&cut.topics[0].messages) && cut.cut.len() == 1, "{}", cut.topics[0].messages);
    assert_eq!((read(packed.len()).topics[0].messages, read(30).cut.len()), (1_500, 1));
    std::fs::remove_dir_all(&folder).unwrap();
    // Each message compressed by itself.
    let folder = recorded("messages", |writer| {
        let mut put = |topic: &str, kind, payload: Vec<u8>| {
            writer.put((topic, kind, String::new), 5, &zstd(&payload)).unwrap();
        };
        (1..=3).for_each(|k| put("/n/csi", "csi5300_msgs/msg/Csi", csi(k).payload()));
        (1..=2).for_each(|k| put("/odom", Odometry::TYPE, odometry(k).payload()));
        writer.finish().unwrap();
    });
    assert_eq!(contents(&Recording::read(&folder).unwrap()), contents(&expected));
    std::fs::remove_dir_all(&folder).unwrap();
    // Damage costs one chunk and is counted.
    let damaged = read_of("damaged", &chunks(&bytes, "lz4", |bytes| vec![7; bytes.len()])).unwrap();
    assert_eq!((damaged.damaged_parts, damaged.topics.len()), (1, 0));
    let other = read_of("other", &chunks(&bytes, "brotli", <[u8]>::to_vec));
    assert!(matches!(other, Err(BagError::Compressed { by, .. }) if by == "brotli"));
}

#[test]
fn a_database_with_deep_trees_and_overflow_pages_is_read() {
    let bytes = include_bytes!("../../../../tests/fixtures/recording.db3");
    let read = read_of("whole.db3", bytes).unwrap();
    let messages: Vec<_> =
        read.topics.iter().map(|one| (one.topic.as_str(), one.content, one.messages, one.unreadable)).collect();
    assert_eq!(messages, [("/odom", Content::Poses, 12, 0), ("/n/csi", Content::Csi, 40, 0)]);
    let rows = String::from_utf8(read.topics[0].bytes.clone()).unwrap();
    assert!(rows.starts_with("12.001000,0,0.500000,") && rows.contains("\n12.012000,0,6.000000,"), "{rows}");
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
            Err(error) => assert!(matches!(error, BagError::NoTables { .. }), "{error}"),
        }
    }
    assert!((30..52).contains(&most), "{most}");
    // A tree whose right-most page leads to itself.
    let mut endless = bytes.to_vec();
    endless[100..112].copy_from_slice(&[5, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1]);
    endless.resize(20 << 20, 0);
    let ended = sqlite::read(Path::new("endless.db3"), io::Cursor::new(endless), &mut |_, _| Ok(()));
    assert!(matches!(ended, Err(BagError::NoTables { .. })), "{ended:?}");
    // Playing a compressed file leaves the unpacked one beside it: each message counts once.
    let folder = std::env::temp_dir().join(format!("csi5300-kinds-{}-beside", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("run_0.db3"), bytes).unwrap();
    std::fs::write(folder.join("run_0.db3.zstd"), zstd(bytes)).unwrap();
    assert_eq!(contents(&Recording::read(&folder).unwrap()), contents(&read));
    std::fs::remove_dir_all(&folder).unwrap();
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
        assert!(matches!(ended, Ok(_) | Err(BagError::NoTables { .. })) && messages < 1_000, "{ended:?}");
    }
}

/// A record of a bag of ROS 1.
pub(super) fn record1(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    let field = |(name, value): &(&str, &[u8])| {
        let one = [name.as_bytes(), b"=", value].concat();
        [&(one.len() as u32).to_le_bytes()[..], &one].concat()
    };
    let header: Vec<u8> = fields.iter().flat_map(field).collect();
    [&(header.len() as u32).to_le_bytes()[..], &header, &(data.len() as u32).to_le_bytes(), data].concat()
}

/// A bag's description of the topic whose messages have `number`.
pub(super) fn connection(number: u32, topic: &str, kind: &str) -> Vec<u8> {
    let data = record1(&[("topic", topic.as_bytes()), ("type", kind.as_bytes())], &[]);
    // Only the fields: a connection's data is itself a header.
    let data = &data[4..data.len() - 4];
    record1(&[("op", &[7]), ("conn", &number.to_le_bytes()), ("topic", topic.as_bytes())], data)
}

/// A message of ROS 1 in a bag.
pub(super) fn message(number: u32, data: &[u8]) -> Vec<u8> {
    record1(&[("op", &[2]), ("conn", &number.to_le_bytes()), ("time", &[0; 8])], data)
}

/// A string as ROS 1 writes it.
pub(super) fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

/// Numbers as ROS 1 writes them.
pub(super) fn numbers(numbers: &[f64]) -> Vec<u8> {
    numbers.iter().flat_map(|v| v.to_le_bytes()).collect()
}

#[test]
fn a_ros_1_bag_is_read() {
    let header = |s: u32| [&9_u32.to_le_bytes()[..], &s.to_le_bytes(), &500_u32.to_le_bytes(), &text("odom")].concat();
    let pose = numbers(&[1.5, -2.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    let odometry = [header(12), text("base"), pose.clone(), numbers(&[0.0; 36 + 6 + 36])].concat();
    let csi = [
        header(13),
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
        let chunk = record1(&[("op", &[5]), ("compression", compression.as_bytes()), ("size", &[0; 4])], data);
        [&ros1::MAGIC[..], &record1(&[("op", &[3])], &[32; 40]), &chunk].concat()
    };
    let lz4 = {
        let mut to = lz4_flex::frame::FrameEncoder::new(Vec::new());
        to.write_all(&inside).unwrap();
        to.finish().unwrap()
    };
    for (name, bytes) in [("none.bag", file("none", &inside)), ("lz4.bag", file("lz4", &lz4))] {
        let read = read_of(name, &bytes).unwrap();
        let counts: Vec<_> = read.topics.iter().map(|one| (one.topic.as_str(), one.messages, one.unreadable)).collect();
        assert_eq!((counts, read.others, read.cut.len()), (vec![("/odom", 1, 1), ("/csi", 1, 0)], 1, 0));
        assert_eq!(read.topics[0].bytes, b"12.000000,0,1.500000,-2.000000,0.000000,0.000000,\n");
        let cut = read_of(name, &bytes[..bytes.len() - 9]).unwrap();
        assert_eq!(cut.cut.len(), 1);
    }
    assert!(matches!(read_of("bz2.bag", &file("bz2", &inside)), Err(BagError::Compressed { by, .. }) if by == "bz2"));
}
