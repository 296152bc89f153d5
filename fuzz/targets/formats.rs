//! Any bytes as a log of each other card: items advance, do not overlap, and every frame has the stated number of samples.

use csi_formats::{Endian, Format, Item, Items, detect};

const FORMATS: [Format; 6] = [
    Format::FeitCsi,
    Format::PicoScenes,
    Format::Nexmon,
    Format::Esp32,
    Format::Atheros(Endian::Little),
    Format::Atheros(Endian::Big),
];

/// Runs the target.
pub fn run(bytes: &[u8]) {
    let _ = detect(bytes);
    for format in FORMATS {
        read(format, bytes);
    }
}

/// Reads a log of one kind; returns the number of frames and skipped stretches.
pub fn read(format: Format, bytes: &[u8]) -> (usize, usize) {
    let (mut frames, mut skipped, mut end) = (0, 0, 0);
    for item in Items::new(format, bytes) {
        let (offset, len) = match item {
            Item::Frame(frame) => {
                frames += 1;
                let n = frame.subcarriers.len();
                assert!(n > 0 && frame.n_rx * frame.n_tx > 0);
                assert_eq!((frame.csi.len(), frame.measured.len()), (frame.n_rx * frame.n_tx * n, n));
                assert!(frame.column(frame.n_rx - 1, frame.n_tx - 1).is_some_and(|column| column.len() == n));
                assert!(frame.column(frame.n_rx, 0).is_none() && frame.column(0, frame.n_tx).is_none());
                (frame.offset, 1)
            }
            Item::Skipped(bad) => {
                skipped += 1;
                (bad.offset, bad.len)
            }
        };
        assert!(offset >= end && len > 0);
        end = offset + len;
    }
    assert!(end <= bytes.len() as u64);
    (frames, skipped)
}
