//! The socket's filter: sounding frames only, so that other traffic on the channel does not wake the process.

use crate::sys::Instruction;
use driver_iface::sounding::MAGIC_MAC;

/// Offset of the packet's type in the kernel's ancillary data (SKF_AD_OFF + SKF_AD_PKTTYPE, `linux/filter.h`).
const PACKET_TYPE: u32 = (-0x1000_i32 + 4).cast_unsigned();
/// PACKET_OUTGOING (`linux/if_packet.h`): a copy of what this host sends.
const OUTGOING: u32 = 4;

/// A classic filter that passes data frames (frame control 08) with the magic MAC in addr1, which both dialects have,
/// after a radiotap header of any length; it drops outgoing copies, but not tx-status frames.
pub(super) fn sounding() -> Vec<Instruction> {
    const LOAD_WORD: u16 = 0x20; // BPF_LD | BPF_W | BPF_ABS
    const LOAD_BYTE: u16 = 0x30; // BPF_LD | BPF_B | BPF_ABS
    const LOAD_WORD_AT_X: u16 = 0x40; // BPF_LD | BPF_W | BPF_IND
    const LOAD_HALF_AT_X: u16 = 0x48; // BPF_LD | BPF_H | BPF_IND
    const LOAD_BYTE_AT_X: u16 = 0x50; // BPF_LD | BPF_B | BPF_IND
    const SHIFT_LEFT: u16 = 0x64; // BPF_ALU | BPF_LSH | BPF_K
    const ADD_X: u16 = 0x0c; // BPF_ALU | BPF_ADD | BPF_X
    const TO_X: u16 = 0x07; // BPF_MISC | BPF_TAX
    const JUMP_IF_EQUAL: u16 = 0x15; // BPF_JMP | BPF_JEQ | BPF_K
    const RETURN: u16 = 0x06; // BPF_RET | BPF_K
    let [a, b, c, d, e, f] = MAGIC_MAC.0;
    let (magic_high, magic_low) = (u32::from_be_bytes([a, b, c, d]), u32::from_be_bytes([0, 0, e, f]));
    let steps = [
        (LOAD_WORD, 0, 0, PACKET_TYPE),
        (JUMP_IF_EQUAL, 13, 0, OUTGOING),
        // The radiotap header's length, little-endian at offset 2, becomes X.
        (LOAD_BYTE, 0, 0, 3),
        (SHIFT_LEFT, 0, 0, 8),
        (TO_X, 0, 0, 0),
        (LOAD_BYTE, 0, 0, 2),
        (ADD_X, 0, 0, 0),
        (TO_X, 0, 0, 0),
        (LOAD_BYTE_AT_X, 0, 0, 0),
        (JUMP_IF_EQUAL, 0, 5, 0x08),
        (LOAD_WORD_AT_X, 0, 0, 4),
        (JUMP_IF_EQUAL, 0, 3, magic_high),
        (LOAD_HALF_AT_X, 0, 0, 8),
        (JUMP_IF_EQUAL, 0, 1, magic_low),
        (RETURN, 0, 0, u32::MAX),
        (RETURN, 0, 0, 0),
    ];
    steps.map(|(code, if_true, if_false, k)| Instruction { code, if_true, if_false, k }).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;
    use driver_iface::radiotap::{Bandwidth, Repr};
    use driver_iface::sounding::wsr::{self, Lfsr};

    /// Runs a filter as `linux/filter.h` defines it, as far as ours goes; a load beyond the end refuses the packet.
    fn passes(program: &[Instruction], packet: &[u8], packet_type: u32) -> bool {
        let (mut at, mut a, mut x) = (0, 0_u32, 0_u32);
        loop {
            let step = program[at];
            at += 1;
            let load = |offset: u32, len: usize| {
                let bytes = packet.get(offset as usize..)?.get(..len)?;
                Some(bytes.iter().fold(0, |sum, byte| sum << 8 | u32::from(*byte)))
            };
            let loaded = match step.code {
                0x20 if step.k == PACKET_TYPE => Some(packet_type),
                0x20 => load(step.k, 4),
                0x30 => load(step.k, 1),
                0x40 => load(x + step.k, 4),
                0x48 => load(x + step.k, 2),
                0x50 => load(x + step.k, 1),
                0x64 => Some(a << step.k),
                0x0c => Some(a + x),
                0x07 => {
                    x = a;
                    Some(a)
                }
                0x15 => {
                    at += usize::from(if a == step.k { step.if_true } else { step.if_false });
                    Some(a)
                }
                _ => return step.k != 0,
            };
            let Some(loaded) = loaded else { return false };
            a = loaded;
        }
    }

    #[test]
    fn sounding_frames_pass_behind_any_header_and_nothing_else_does() {
        let program = sounding();
        let mut frame = [0; 60];
        let repr = wsr::Repr { sender: driver_iface::Mac([2; 6]), number: 7, len_with_fcs: 57 };
        let len = repr.emit(&mut frame, &mut Lfsr::default()).unwrap();
        let frame = &frame[..len];
        for header in [Repr::default(), Repr::injected(1, Bandwidth::Ht20), Repr::lorcon(5_540)] {
            let mut buffer = vec![0; header.header_len()];
            header.emit(&mut buffer).unwrap();
            let start = buffer.len();
            buffer.extend(frame);
            assert!(passes(&program, &buffer, 3), "of others");
            assert!(!passes(&program, &buffer, OUTGOING), "own, on its way out");
            for at in [0, 4, 5, 6, 7, 8, 9] {
                let mut other = buffer.clone();
                other[start + at] ^= 1;
                assert!(!passes(&program, &other, 3), "byte {at}");
            }
            for cut in 0..start + 10 {
                assert!(!passes(&program, &buffer[..cut], 3), "cut to {cut}");
            }
        }
        // A header longer than 255 bytes.
        let mut long = vec![0; 300];
        (long[2], long[3]) = (44, 1);
        long.extend(frame);
        assert!(passes(&program, &long, 3));
    }
}
