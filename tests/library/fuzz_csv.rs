//! The body of the fuzz target for trajectory files on damaged and random text from a seeded generator.

#[path = "../../fuzz/targets/trajectory_csv.rs"]
pub mod trajectory_csv;

use csi5300_sim::random::Stream;

#[test]
fn trajectories() {
    const WORDS: [&[u8]; 14] = [
        b"0", b"1.5", b"-3e2", b"nan", b"inf", b"1e308", b"1e-320", b",", b",,", b"\"", b"\n", b"\r\n", b"x", b"\xff\0",
    ];
    let mut random = Stream::of_seed(0x5300_0004);
    let mut below = |end: usize| random.below(end as u64) as usize;
    for case in 0..100_000_u32 {
        let columns = [5, 6, 9, 15][below(4)];
        let mut text = Vec::new();
        for row in 0..below(6) {
            for column in 0..columns {
                let value = if column == 0 { row as f64 } else { below(1_000) as f64 * 1e-3 };
                text.extend(format!("{value},").into_bytes());
            }
            text.push(b'\n');
        }
        for _ in 0..below(4) {
            let at = below(text.len() + 1);
            match below(3) {
                0 => text.truncate(at),
                1 if at < text.len() => drop(text.remove(at)),
                _ => drop(text.splice(at..at, WORDS[below(WORDS.len())].iter().copied())),
            }
        }
        if case % 5 == 0 {
            text = (0..below(40)).flat_map(|_| WORDS[below(WORDS.len())].to_vec()).collect();
        }
        trajectory_csv::run(&text);
    }
}
