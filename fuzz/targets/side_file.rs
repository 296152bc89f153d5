//! Any bytes as a side file: every entry is read, and writing it gives the same bytes or the same meaning.

use driver_iface::side_file::{Entry, Layout};

/// Runs the target.
pub fn run(bytes: &[u8]) {
    let layout = Layout::of(bytes);
    let Some((head, entries)) = bytes.split_at_checked(layout.head().len()) else {
        unreachable!("a head that is not there")
    };
    // Damage in the head does not hide the layout.
    let damaged = head.iter().zip(layout.head()).filter(|(found, byte)| found != byte).count();
    assert!(damaged <= 4, "{damaged} bytes");
    for bytes in entries.chunks(layout.bytes()) {
        let entry = Entry::parse(bytes, layout);
        if bytes.len() < layout.bytes() {
            assert_eq!(entry, Entry::default());
            continue;
        }
        let mut again = [0; 16];
        match entry.emit(layout, &mut again) {
            Ok(len) => assert_eq!((len, Entry::parse(&again[..len], layout)), (layout.bytes(), entry)),
            Err(error) => panic!("what was read cannot be written: {error}"),
        }
        // Every bit pattern of length and checksum is valid; an invalid time becomes zeros.
        let has_length = bytes.get(8..12).is_some_and(|len| *len != [0; 4]);
        assert!(layout != Layout::Checked || !has_length || again == *bytes);
        assert!(layout != Layout::Narrow || entry.host_us.is_none() || again[..8] == *bytes);
    }
}
