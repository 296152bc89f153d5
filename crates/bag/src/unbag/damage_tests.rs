//! Damaged recordings: the intact parts are read, and damage is counted.

use super::kinds_tests::{connection, message, numbers, odometry, read_of, record1, text};
use super::tests::{csi, put, recorded};
use super::*;

/// A recording in two chunks, of which only the first describes the topics. It has three records of CSI and two poses, then
/// two records and one pose. Also returns the offsets of the chunks.
fn in_two() -> (Vec<u8>, [usize; 2]) {
    let folder = recorded("two", |writer| {
        (1..=3).for_each(|k| put(writer, "/n/csi", &csi(k)));
        (1..=2).for_each(|k| put(writer, "/odom", &odometry(k)));
        writer.flush().unwrap();
        (4..=5).for_each(|k| put(writer, "/n/csi", &csi(k)));
        put(writer, "/odom", &odometry(3));
        writer.finish().unwrap();
    });
    let bytes = std::fs::read(folder.join("run_0.mcap")).unwrap();
    std::fs::remove_dir_all(&folder).unwrap();
    let (mut found, mut at) = (Vec::new(), 8);
    while found.len() < 2 {
        if bytes[at] == 0x06 {
            found.push(at + 9 + 40);
        }
        at += 9 + u64::from_le_bytes(*bytes[at + 1..].first_chunk().unwrap()) as usize;
    }
    (bytes, [found[0], found[1]])
}

/// The offset at which an MCAP file's data ends and its summary begins.
fn end_of_data(bytes: &[u8]) -> usize {
    let mut at = 8;
    while bytes[at] != 0x0f {
        at += 9 + u64::from_le_bytes(*bytes[at + 1..].first_chunk().unwrap()) as usize;
    }
    at
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
    let data = end_of_data(&damaged);
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
            Err(error) => assert!(matches!(error, BagError::NoTables { .. }), "{error}"),
        }
    }
    // Most pages hold messages; without the page of topics, every message lacks one.
    assert!(messages.iter().filter(|count| (26..52).contains(*count)).count() > 10, "{messages:?}");
    assert_eq!(without.iter().filter(|orphans| **orphans == 52).count(), 1, "{without:?}");
    assert!(messages.iter().all(|count| *count <= 52));
}

#[test]
fn a_bags_index_replaces_connections_of_a_damaged_chunk() {
    let header = [&9_u32.to_le_bytes()[..], &12_u32.to_le_bytes(), &500_u32.to_le_bytes(), &text("odom")].concat();
    let pose = [header, numbers(&[1.5, -2.0, 0.0, 0.0, 0.0, 0.0, 1.0])].concat();
    let chunk =
        |by: &str, data: &[u8]| record1(&[("op", &[5]), ("compression", by.as_bytes()), ("size", &[0; 4])], data);
    let described = connection(0, "/pose", "geometry_msgs/PoseStamped");
    let chunks = [
        chunk("lz4", &[7; 40]),
        chunk("none", &[message(0, &pose), message(0, &pose)].concat()),
        // It ends inside a message.
        chunk("none", &message(0, &pose)[..60]),
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
    let packed = ruzstd::encoding::compress_to_vec(records, ruzstd::encoding::CompressionLevel::Fastest);
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
