//! The body of the fuzz target for frames from the air, on lists of steps from a seeded generator.

#[path = "../../fuzz/targets/sounding.rs"]
mod sounding;

use driver_iface::sounding::native::{self, Role};

/// xorshift64.
fn random(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

/// A native frame that could be right, of and for anybody.
fn crafted(state: &mut u64) -> Vec<u8> {
    let mac = |state: &mut u64| [2, 0, 0, 0, 0, 1 + (random(state) % 4) as u8];
    let few = |state: &mut u64| (random(state) % 4) as u32;
    let repr = native::Repr {
        sender: driver_iface::Mac(mac(state)),
        number: few(state),
        role: if random(state).is_multiple_of(2) { Role::Forward } else { Role::Backward },
        destination: driver_iface::Mac(mac(state)),
        next: driver_iface::Mac(mac(state)),
        wants_turn: random(state).is_multiple_of(2),
        session: few(state),
        sender_session: few(state),
        turn: random(state) as u32 >> (random(state) % 32),
        left: (random(state) % 70) as u16,
        slot: random(state) >> (random(state) % 64),
        round_us: 5_000,
        slots: 2,
        measurement: None,
        tag: random(state).is_multiple_of(3).then_some([0; native::TAG_LEN]),
    };
    let mut frame = vec![0; native::MAX_LEN];
    let len = repr.emit(&mut frame).unwrap();
    frame.truncate(len);
    frame
}

#[test]
fn hostile_air() {
    let mut state = 0x5300_0005;
    for case in 0..20_000_u32 {
        let mut steps = vec![case as u8];
        for _ in 0..random(&mut state) % 60 {
            let operation = random(&mut state) as u8;
            match operation % 8 {
                1 | 2 => {
                    let mut frame = crafted(&mut state);
                    if random(&mut state).is_multiple_of(4) {
                        frame = (0..random(&mut state) % 90).map(|_| random(&mut state) as u8).collect();
                    }
                    if operation % 8 == 2 {
                        frame.splice(0..0, [0, 0, 8, 0, 0, 0, 0, 0]);
                    }
                    steps.extend([operation, frame.len() as u8]);
                    steps.extend(frame);
                }
                3 => {
                    steps.extend([operation, random(&mut state) as u8]);
                    steps.extend((0..4).map(|_| random(&mut state) as u8));
                }
                _ => steps.extend([operation, random(&mut state) as u8]),
            }
        }
        sounding::run(&steps);
    }
}
