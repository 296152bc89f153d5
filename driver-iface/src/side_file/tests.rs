use super::*;
use proptest::prelude::*;
use std::vec::Vec;

fn entries(entries: &[Entry], layout: Layout) -> Vec<u8> {
    let mut bytes = layout.head().to_vec();
    for entry in entries {
        let mut out = [0; 16];
        assert_eq!(entry.emit(layout, &mut out), Ok(layout.bytes()));
        bytes.extend(&out[..layout.bytes()]);
    }
    bytes
}

fn parsed(file: &[u8]) -> (Layout, Vec<Entry>) {
    let layout = Layout::of(file);
    let rest = &file[layout.head().len()..];
    (layout, rest.chunks(layout.bytes()).map(|entry| Entry::parse(entry, layout)).collect())
}

#[test]
fn the_first_entries_distinguish_layouts() {
    let narrow: Vec<u8> = [1_700_000_000_u32, 250_000, 1_700_000_000, 260_000].map(u32::to_le_bytes).concat();
    assert_eq!(Layout::of(&narrow), Layout::Narrow);
    assert_eq!(Layout::of(&narrow[..8]), Layout::Narrow);
    let wide: Vec<u8> = [1_700_000_000_i64, 250_000].map(i64::to_le_bytes).concat();
    assert_eq!(Layout::of(&wide), Layout::Wide);
    // The first record was received at a whole second.
    let even: Vec<u8> = [1_700_000_000_u32, 0, 1_700_000_000, 10_000].map(u32::to_le_bytes).concat();
    assert_eq!(Layout::of(&even), Layout::Narrow);
    // A microsecond field of a second is invalid.
    let second: Vec<u8> = [1_700_000_000_i64, 1_000_000].map(i64::to_le_bytes).concat();
    assert_eq!(Layout::of(&second), Layout::Narrow);
    for high in [4, 7, 12, 15] {
        let mut other = wide.clone();
        other[high] = 1;
        assert_eq!(Layout::of(&other), Layout::Narrow, "byte {high}");
    }
    // Unknown first times: zeros in either layout.
    for unknown in 1..6 {
        assert_eq!(Layout::of(&[&[0; 16].repeat(unknown)[..], &wide].concat()), Layout::Wide, "{unknown}");
        assert_eq!(Layout::of(&[&[0; 8].repeat(unknown)[..], &narrow].concat()), Layout::Narrow, "{unknown}");
        assert_eq!(Layout::of(&[0; 16].repeat(unknown)), Layout::Narrow, "nothing is known in it");
        assert_eq!(Layout::of(&[&[0; 16].repeat(unknown)[..], &MAGIC].concat()), Layout::Narrow, "it is the first");
    }
    assert_eq!(Layout::of(&MAGIC), Layout::Checked);
    for at in 0..16 {
        let mut other = MAGIC;
        other[at] ^= 1;
        assert_eq!(Layout::of(&other), Layout::Checked, "byte {at}");
    }
    assert_eq!(Layout::of(&[&MAGIC[..11], &[0xff; 5]].concat()), Layout::Narrow);
}

#[test]
fn values_that_do_not_fit_are_refused() {
    let mut out = [0; 16];
    let (us, late) = (Entry::from(Some(1)), Entry::from(Some((i64::from(u32::MAX) + 1) * US_PER_S)));
    for layout in [Layout::Narrow, Layout::Wide, Layout::Checked] {
        let short = layout.bytes() - 1;
        assert_eq!(us.emit(layout, &mut out[..short]), Err(EmitError::Buffer { need: short + 1, got: short }));
        assert_eq!(Entry::parse(&[1; 15][..short], layout), Entry::default());
    }
    assert!(matches!(late.emit(Layout::Narrow, &mut out), Err(EmitError::Field { .. })));
    assert!(matches!(Entry::from(Some(-1)).emit(Layout::Narrow, &mut out), Err(EmitError::Field { .. })));
    let [second, whole] = [1_000_000_u32, 999_999].map(|us| [7_u32, us].map(u32::to_le_bytes).concat());
    let time = |entry: &[u8]| Entry::parse(entry, Layout::Narrow).host_us;
    assert_eq!((time(&second), time(&whole)), (None, Some(7_999_999)));
}

#[test]
fn checksums_are_those_of_rfc_3720() {
    // Appendix B.4: 32 bytes of zeros, of ones, counting up; and the check string of the catalogue of CRCs.
    let up: Vec<u8> = (0..32).collect();
    for (bytes, expect) in
        [(&[0; 32][..], 0x8A91_36AA_u32), (&[0xff; 32], 0x62A8_AB43), (&up, 0x46DD_794E), (b"123456789", 0xE306_9283)]
    {
        assert_eq!(Check::of(bytes), Check { len: bytes.len() as u32, crc32c: expect });
    }
}

/// The bytes of the format as in docs/reference/formats.md.
#[test]
fn a_checked_side_file_has_a_head_and_16_bytes_per_record() {
    let check = Check { len: 0x0102, crc32c: 0x0304_0506 };
    let file = entries(&[Entry { host_us: Some(0x0708), check: Some(check) }, Entry::default()], Layout::Checked);
    assert_eq!(&file[..16], b"csi5300 checks 1");
    assert_eq!(file[16..32], [8, 7, 0, 0, 0, 0, 0, 0, 2, 1, 0, 0, 6, 5, 4, 3]);
    assert_eq!(file[32..], [0; 16]);
}

/// Found by fuzzing: a time too large for microseconds came back as another one.
#[test]
fn a_time_beyond_64_bits_is_unknown() {
    let last = i64::MAX / US_PER_S;
    for (seconds, us, expect) in [
        (last, i64::MAX % US_PER_S, Some(i64::MAX)),
        (last, i64::MAX % US_PER_S + 1, None),
        (last + 1, 0, None),
        (-last, 0, Some(-last * US_PER_S)),
        (i64::MIN, 0, None),
    ] {
        let entry = [seconds, us].map(i64::to_le_bytes).concat();
        assert_eq!(Entry::parse(&entry, Layout::Wide).host_us, expect, "{seconds} s, {us} us");
    }
}

fn any_check() -> impl Strategy<Value = Check> {
    (1..=u32::MAX, any::<u32>()).prop_map(|(len, crc32c)| Check { len, crc32c })
}

proptest! {
    #[test]
    fn emit_then_parse_is_the_identity(
        entry in (prop::option::of(1..i64::MAX), prop::option::of(any_check())), negative in i64::MIN..0,
    ) {
        let entry = Entry { host_us: entry.0, check: entry.1 };
        for host_us in [entry.host_us, Some(negative)] {
            let mut out = [0; 16];
            let checked = Entry { host_us, ..entry };
            checked.emit(Layout::Checked, &mut out).unwrap();
            prop_assert_eq!(Entry::parse(&out, Layout::Checked), checked);
        }
        let mut out = [0; 16];
        entry.emit(Layout::Wide, &mut out).unwrap();
        prop_assert_eq!(Entry::parse(&out, Layout::Wide), Entry { check: None, ..entry });
    }

    /// Times of this century: the range of a host's clock, which the layout is recognised by.
    #[test]
    fn layout_and_times_of_a_file_come_back(
        times in prop::collection::vec(946_684_800_000_000..4_102_444_800_000_000_i64, 2..20),
        unknown in 0..9_usize,
    ) {
        let times = std::iter::repeat_n(None, unknown).chain(times.into_iter().map(Some));
        let times: Vec<_> = times.map(Entry::from).collect();
        for layout in [Layout::Narrow, Layout::Wide, Layout::Checked] {
            prop_assert_eq!(parsed(&entries(&times, layout)), (layout, times.clone()));
        }
    }
}
