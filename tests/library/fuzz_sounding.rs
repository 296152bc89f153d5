//! The body of the fuzz target for frames from the air, on lists of steps from a seeded generator.

#[path = "../../fuzz/targets/sounding.rs"]
pub mod sounding;

use csi5300_sim::random::Stream;
use driver_iface::sounding::native::{self, Role};

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
