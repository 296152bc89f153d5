//! The fuzz targets of the library and the simulator on their corpus, and two of them on input from a seeded generator.

#[path = "../common/corpus.rs"]
mod corpus;
#[path = "../../fuzz/targets/log.rs"]
mod log;
#[path = "../../fuzz/targets/remote.rs"]
mod remote;
#[path = "../../fuzz/targets/scene.rs"]
mod scene;
#[path = "../../fuzz/targets/sounding.rs"]
mod sounding;
#[path = "../../fuzz/targets/trajectory_csv.rs"]
mod trajectory_csv;

use csi5300_sim::random::Stream;
use driver_iface::sounding::native::{self, Role};

#[test]
fn corpora() {
    corpus::replay("log", log::run);
    corpus::replay("remote", remote::run);
    corpus::replay("scene", scene::run);
    corpus::replay("sounding", sounding::run);
    corpus::replay("trajectory_csv", trajectory_csv::run);
}

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

/// A native frame that could be right, of and for anybody.
fn crafted(random: &mut Stream) -> Vec<u8> {
    let mac = |random: &mut Stream| [2, 0, 0, 0, 0, 1 + random.below(4) as u8];
    let few = |random: &mut Stream| random.below(4) as u32;
    let repr = native::Repr {
        sender: driver_iface::Mac(mac(random)),
        number: few(random),
        role: if random.below(2) == 0 { Role::Forward } else { Role::Backward },
        destination: driver_iface::Mac(mac(random)),
        next: driver_iface::Mac(mac(random)),
        wants_turn: random.below(2) == 0,
        session: few(random),
        sender_session: few(random),
        turn: random.bits() as u32 >> random.below(32),
        left: random.below(70) as u16,
        slot: random.bits() >> random.below(64),
        round_us: 5_000,
        slots: 2,
        measurement: None,
        tag: (random.below(3) == 0).then_some([0; native::TAG_LEN]),
    };
    let mut frame = vec![0; native::MAX_LEN];
    let len = repr.emit(&mut frame).unwrap();
    frame.truncate(len);
    frame
}

#[test]
fn hostile_air() {
    let mut random = Stream::of_seed(0x5300_0005);
    for case in 0..20_000_u32 {
        let mut steps = vec![case as u8];
        for _ in 0..random.below(60) {
            let operation = random.bits() as u8;
            match operation % 8 {
                1 | 2 => {
                    let mut frame = crafted(&mut random);
                    if random.below(4) == 0 {
                        frame = (0..random.below(90)).map(|_| random.bits() as u8).collect();
                    }
                    if operation % 8 == 2 {
                        frame.splice(0..0, [0, 0, 8, 0, 0, 0, 0, 0]);
                    }
                    steps.extend([operation, frame.len() as u8]);
                    steps.extend(frame);
                }
                3 => {
                    steps.extend([operation, random.bits() as u8]);
                    steps.extend((0..4).map(|_| random.bits() as u8));
                }
                _ => steps.extend([operation, random.bits() as u8]),
            }
        }
        sounding::run(&steps);
    }
}
