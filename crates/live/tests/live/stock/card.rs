//! The cards' side of /dev/fakecard (tests/kernel/fakecard/fakecard.c).

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::OpenOptionsExt;

/// Bytes before the frame of a transmission.
const HEAD: usize = 24;

/// A frame that a card was given to transmit.
#[derive(Debug)]
pub struct Transmission {
    pub card: usize,
    pub rate_n_flags: u32,
    pub tx_flags: u32,
    pub retries: [u8; 2],
    pub frame: Vec<u8>,
}

/// The device.
pub struct Cards(File);

impl Cards {
    pub fn open() -> Self {
        Self(OpenOptions::new().read(true).write(true).custom_flags(libc::O_NONBLOCK).open("/dev/fakecard").unwrap())
    }

    pub fn fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }

    /// Whatever bytes as the packet that a card puts into memory.
    pub fn raw(&mut self, card: u8, packet: &[u8]) {
        let mut bytes = vec![card, 0];
        bytes.extend_from_slice(&u16::try_from(packet.len()).unwrap().to_le_bytes());
        bytes.extend_from_slice(packet);
        assert_eq!(self.0.write(&bytes).unwrap(), bytes.len());
    }

    /// A packet of this command.
    pub fn packet(&mut self, card: u8, command: u8, data: &[u8]) {
        let mut packet = u32::try_from(data.len() + 4).unwrap().to_le_bytes().to_vec();
        packet.extend_from_slice(&[command, 0, 0, 0x80]);
        packet.extend_from_slice(data);
        self.raw(card, &packet);
    }

    pub fn transmitted(&mut self) -> Option<Transmission> {
        let mut bytes = [0; 4_096];
        let len = match self.0.read(&mut bytes) {
            Ok(len) => len,
            Err(error) if error.kind() == ErrorKind::WouldBlock => return None,
            Err(error) => panic!("/dev/fakecard: {error}"),
        };
        let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        Some(Transmission {
            card: bytes[0].into(),
            rate_n_flags: u32_at(4),
            tx_flags: u32_at(8),
            retries: [bytes[12], bytes[13]],
            frame: bytes[HEAD..len].to_vec(),
        })
    }
}
