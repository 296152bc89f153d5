//! DYNAMIXEL protocol 2.0, sans-IO: packets out, bytes in.
//!
//! A packet is `FF FF FD 00 | id | length (2) | instruction | parameters | CRC (2)`, little-endian; `length` counts
//! everything after itself. Within instruction and parameters `FF FF FD` is sent as `FF FF FD FD`, so that no header
//! appears there. Source: ROBOTIS e-Manual, "Protocol 2.0"; the tests hold its four examples.

/// How every packet begins.
const HEADER: [u8; 4] = [0xFF, 0xFF, 0xFD, 0x00];
/// Bytes before the instruction.
const PREFIX: usize = 7;
const CRC: usize = 2;
/// The longest packet that is accepted: a whole control table of 1 KiB, stuffed.
const MAX_PACKET: usize = 1_400;

/// Instructions that are used here. There is deliberately none that writes.
pub mod instruction {
    /// Reads `length` bytes of the control table from `address`.
    pub const READ: u8 = 0x02;
    /// An answer; its first parameter is the error.
    pub const STATUS: u8 = 0x55;
}

/// CRC-16/UMTS: polynomial 0x8005, initial value 0, most significant bit first.
#[must_use]
pub fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ u16::from(*byte) << 8, |crc, _| (crc << 1) ^ if crc & 0x8000 == 0 { 0 } else { 0x8005 })
    })
}

/// Appends a packet to `out`.
pub fn emit(id: u8, instruction: u8, parameters: &[u8], out: &mut Vec<u8>) {
    let from = out.len();
    out.extend(HEADER);
    out.extend([id, 0, 0, instruction]);
    let body = out.len() - 1;
    for byte in parameters {
        out.push(*byte);
        if out.get(body..).is_some_and(|sent| sent.ends_with(&[0xFF, 0xFF, 0xFD])) {
            out.push(0xFD);
        }
    }
    let length = (out.len() - body + CRC) as u16;
    if let Some(place) = out.get_mut(from + 5..from + 7) {
        place.copy_from_slice(&length.to_le_bytes());
    }
    let crc = crc16(out.get(from..).unwrap_or_default());
    out.extend(crc.to_le_bytes());
}

/// Appends a READ of `length` bytes from `address`.
pub fn emit_read(id: u8, address: u16, length: u16, out: &mut Vec<u8>) {
    let ([a, b], [c, d]) = (address.to_le_bytes(), length.to_le_bytes());
    emit(id, instruction::READ, &[a, b, c, d], out);
}

/// An answer to a READ.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// The device.
    pub id: u8,
    /// Error number, 0 for none; bit 7 is the device's alert and no failure of the instruction.
    pub error: u8,
    /// What was read, as sent: stuffed.
    sent: Vec<u8>,
}

impl Status {
    /// What was read, if it is `length` bytes. A device that does not stuff its answers is understood too.
    #[must_use]
    pub fn data(&self, length: usize) -> Option<Vec<u8>> {
        let mut plain = Vec::with_capacity(self.sent.len());
        let mut after_mark = false;
        for byte in &self.sent {
            if !(after_mark && *byte == 0xFD) {
                plain.push(*byte);
                after_mark = plain.ends_with(&[0xFF, 0xFF, 0xFD]);
            } else {
                after_mark = false;
            }
        }
        [plain, self.sent.clone()].into_iter().find(|data| data.len() == length)
    }
}

/// What the parser counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct PacketCounts {
    /// Intact answers.
    pub packets: u64,
    /// Packets whose CRC does not fit.
    pub bad_crc: u64,
    /// Bytes that belong to no intact answer.
    pub skipped_bytes: u64,
}

/// Finds answers in a stream of bytes, and finds its feet again after damage: a packet that does not check out costs its
/// first byte only, so one that begins inside it is still found.
#[derive(Clone, Debug, Default)]
pub struct Parser {
    buffer: Vec<u8>,
    /// The counts.
    pub counts: PacketCounts,
}

impl Parser {
    /// Takes bytes as they come.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.extend_from_slice(bytes);
    }

    /// Drops incomplete data: the rest will not come.
    pub fn reset(&mut self) {
        self.counts.skipped_bytes += self.buffer.len() as u64;
        self.buffer.clear();
    }

    fn skip(&mut self, bytes: usize) {
        self.counts.skipped_bytes += bytes as u64;
        self.buffer.drain(..bytes);
    }

    /// The next intact answer.
    pub fn poll_status(&mut self) -> Option<Status> {
        loop {
            let begins = |at: &usize| self.buffer[*at..].iter().zip(HEADER).all(|(a, b)| *a == b);
            let start = (0..self.buffer.len()).find(begins).unwrap_or(self.buffer.len());
            self.skip(start);
            let &[_, _, _, _, id, low, high, ..] = self.buffer.as_slice() else { return None };
            let length = PREFIX + usize::from(u16::from_le_bytes([low, high]));
            if !(PREFIX + 2 + CRC..=MAX_PACKET).contains(&length) {
                self.skip(1);
                continue;
            }
            let packet = self.buffer.get(..length)?;
            let (checked, crc) = packet.split_at(length - CRC);
            if crc != crc16(checked).to_le_bytes() {
                self.counts.bad_crc += 1;
                self.skip(1);
                continue;
            }
            let &[kind, error, ref sent @ ..] = &checked[PREFIX..] else { return None };
            let sent = sent.to_vec();
            if kind != instruction::STATUS {
                // Our own request, on a line that echoes.
                self.skip(length);
                continue;
            }
            self.buffer.drain(..length);
            self.counts.packets += 1;
            return Some(Status { id, error, sent });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn packet(id: u8, instruction: u8, parameters: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        emit(id, instruction, parameters, &mut out);
        out
    }

    fn status(data: &[u8]) -> Vec<u8> {
        packet(200, instruction::STATUS, &[&[0], data].concat())
    }

    #[test]
    fn packets_are_those_of_the_manual() {
        let hex = |text: &str| -> Vec<u8> {
            text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
        };
        for (made, expected) in [
            (packet(1, 0x01, &[]), "ff ff fd 00 01 03 00 01 19 4e"),
            (packet(1, 0x02, &[0x84, 0, 4, 0]), "ff ff fd 00 01 07 00 02 84 00 04 00 1d 15"),
            (packet(1, 0x55, &[0, 6, 4, 0x26]), "ff ff fd 00 01 07 00 55 00 06 04 26 65 5d"),
            (packet(1, 0x03, &[0x74, 0, 0, 2, 0, 0]), "ff ff fd 00 01 09 00 03 74 00 00 02 00 00 ca 89"),
        ] {
            assert_eq!(made, hex(expected));
        }
        let mut read = Vec::new();
        emit_read(200, 136, 8, &mut read);
        assert_eq!(read, hex("ff ff fd 00 c8 07 00 02 88 00 08 00 83 5f"));
        read.clear();
        emit_read(200, 10, 172, &mut read);
        assert_eq!(read, hex("ff ff fd 00 c8 07 00 02 0a 00 ac 00 b6 2f"));
    }

    #[test]
    fn a_header_within_the_data_is_stuffed() {
        // Ticks of -100 and -3: .. FF FF FF FD FF FF FF holds FF FF FD.
        let ticks = [(-100i32).to_le_bytes(), (-3i32).to_le_bytes()].concat();
        let bytes = status(&ticks);
        assert_eq!(bytes.len(), PREFIX + 2 + ticks.len() + 1 + CRC, "one byte is stuffed");
        let mut parser = Parser::default();
        parser.push(&bytes);
        assert_eq!(parser.poll_status().unwrap().data(8), Some(ticks.clone()));
        // A device that does not stuff.
        let mut plain = HEADER.to_vec();
        plain.extend([200, 12, 0, 0x55, 0]);
        plain.extend(&ticks);
        plain.extend(crc16(&plain).to_le_bytes());
        parser.push(&plain);
        assert_eq!(parser.poll_status().unwrap().data(8), Some(ticks));
        assert_eq!(parser.counts, PacketCounts { packets: 2, ..PacketCounts::default() });
    }

    #[test]
    fn damage_costs_the_packet_that_it_is_in() {
        let good = status(&[1, 2, 3, 4]);
        let mut flipped = good.clone();
        flipped[9] ^= 4;
        let mut long = good.clone();
        long[6] = 0xFF;
        let cut = &good[..8];
        let mut parser = Parser::default();
        parser.push(&[&[0xFF, 7, 0xFF][..], &good, &flipped, &good, &long, &good, cut, &good].concat());
        let found: Vec<Status> = std::iter::from_fn(|| parser.poll_status()).collect();
        assert_eq!(found.len(), 4, "{:?}", parser.counts);
        assert!(found.iter().all(|status| status.data(4).unwrap() == [1, 2, 3, 4]));
        let skipped = 3 + flipped.len() + long.len() + cut.len();
        assert_eq!(parser.counts.skipped_bytes, skipped as u64);
    }

    proptest! {
        #[test]
        fn emitted_packets_are_found_among_noise(
            data in prop::collection::vec(prop::sample::select(vec![0u8, 0xFF, 0xFD, 7]), 0..60),
            noise in prop::collection::vec(any::<u8>(), 0..40),
            chunk in 1usize..50,
        ) {
            let mut parser = Parser::default();
            parser.push(&noise);
            while parser.poll_status().is_some() {}
            parser.reset();
            let mut found = Vec::new();
            for bytes in status(&data).chunks(chunk) {
                parser.push(bytes);
                found.extend(parser.poll_status());
            }
            prop_assert_eq!(found.len(), 1);
            prop_assert_eq!(found[0].data(data.len()), Some(data));
        }
    }
}
