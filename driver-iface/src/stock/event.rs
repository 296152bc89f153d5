//! Events of the eBPF program (`driver-iface/bpf/csi5300.bpf.c`) in its ring buffer: one per packet of interest.

use byteorder::{ByteOrder, LittleEndian};
use core::fmt;

use super::{Packet, RxMpdu, STATUS_LEN, command};
use crate::{EmitError, room};

/// Offsets in an event, little-endian as in the program.
mod at {
    /// u64: an address unique to the card while its driver runs.
    pub(super) const CARD: usize = 0;
    /// u64: CLOCK_MONOTONIC, nanoseconds.
    pub(super) const TIME_NS: usize = 8;
    /// u32: number of events so far without room in the ring.
    pub(super) const RING_FULL: usize = 16;
    /// u32: number of unreadable packets so far.
    pub(super) const UNREADABLE: usize = 20;
    /// u32: bytes of data in the packet.
    pub(super) const DATA_LEN: usize = 24;
    /// u8: the packet's command.
    pub(super) const COMMAND: usize = 28;
    /// u8: [`flag`](super::flag).
    pub(super) const FLAGS: usize = 29;
    /// u16: bytes of data in the event.
    pub(super) const KEPT: usize = 30;
    /// The data.
    pub(super) const DATA: usize = 32;
}

/// Bits of [`Event::flags`].
pub mod flag {
    /// The data of an 0xC1 is its beginning, then the four bytes of status from the frame's end.
    pub const FRAME_START: u8 = 1;
}

/// Why bytes are not an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EventError {
    /// Shorter than the header.
    Short {
        /// Bytes that the header has.
        need: usize,
        /// Bytes of the event.
        got: usize,
    },
    /// The data is longer than the event, or than its packet.
    Kept {
        /// Bytes of data by the header.
        kept: usize,
        /// Bytes after the header.
        left: usize,
        /// Bytes of the packet's data.
        data_len: usize,
    },
    /// An unknown flag.
    Flags {
        /// The byte.
        got: u8,
    },
}

impl fmt::Display for EventError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Short { need, got } => write!(f, "event of {got} bytes, its header has {need}"),
            Self::Kept { kept, left, data_len } => {
                write!(f, "event with {kept} bytes kept of a packet of {data_len}, {left} are there")
            }
            Self::Flags { got } => write!(f, "event with unknown flags {got:#04x}"),
        }
    }
}

impl core::error::Error for EventError {}

/// A checked view of an event.
#[derive(Clone, Copy, Debug)]
pub struct Event<'a> {
    head: &'a [u8; at::DATA],
    data: &'a [u8],
}

impl<'a> Event<'a> {
    /// Checks an event as it stands in the ring; bytes after its data are padding.
    ///
    /// # Errors
    /// If it is shorter than its header and data, has more data than its packet, or unknown flags.
    pub fn new_checked(bytes: &'a [u8]) -> Result<Self, EventError> {
        let short = EventError::Short { need: at::DATA, got: bytes.len() };
        let (head, rest) = bytes.split_first_chunk().ok_or(short)?;
        let mut event = Self { head, data: rest };
        let kept = usize::from(LittleEndian::read_u16(&head[at::KEPT..]));
        let limit = event.data_len().saturating_add(if event.is_start() { STATUS_LEN } else { 0 });
        let refused = EventError::Kept { kept, left: rest.len(), data_len: event.data_len() };
        event.data = rest.get(..kept).filter(|_| kept <= limit).ok_or(refused)?;
        match event.flags() & !flag::FRAME_START {
            0 => Ok(event),
            _ => Err(EventError::Flags { got: event.flags() }),
        }
    }

    fn u32_at(&self, at: usize) -> u32 {
        self.head.get(at..).map_or(0, LittleEndian::read_u32)
    }

    fn u64_at(&self, at: usize) -> u64 {
        self.head.get(at..).map_or(0, LittleEndian::read_u64)
    }

    fn is_start(&self) -> bool {
        self.command() == command::RX_MPDU && self.flags() & flag::FRAME_START != 0
    }

    /// The card: equal for one card's packets while its driver runs.
    #[must_use]
    pub fn card(&self) -> u64 {
        self.u64_at(at::CARD)
    }

    /// When the driver handled the packet: CLOCK_MONOTONIC, nanoseconds.
    #[must_use]
    pub fn time_ns(&self) -> u64 {
        self.u64_at(at::TIME_NS)
    }

    /// Number of events without room in the ring before this one, since the program was loaded; wraps.
    #[must_use]
    pub fn ring_full(&self) -> u32 {
        self.u32_at(at::RING_FULL)
    }

    /// Number of packets before this one that the program could not read; wraps.
    #[must_use]
    pub fn unreadable(&self) -> u32 {
        self.u32_at(at::UNREADABLE)
    }

    /// Bytes of data of the packet, from its header.
    #[must_use]
    pub fn data_len(&self) -> usize {
        self.u32_at(at::DATA_LEN) as usize
    }

    /// The packet's command.
    #[must_use]
    pub fn command(&self) -> u8 {
        self.head[at::COMMAND]
    }

    /// How the packet was cut, [`flag`].
    #[must_use]
    pub fn flags(&self) -> u8 {
        self.head[at::FLAGS]
    }

    /// The packet. Making a record does not use what the program cut off.
    #[must_use]
    pub fn packet(&self) -> Packet<'a> {
        if !self.is_start() {
            return Packet::new(self.command(), self.data);
        }
        let (start, status) = self.data.split_last_chunk::<STATUS_LEN>().unwrap_or((&[], &[0; STATUS_LEN]));
        Packet::RxMpdu(RxMpdu::from_start(self.data_len(), start, u32::from_le_bytes(*status)))
    }
}

/// All fields of an event; [`EventRepr::emit`] gets the data separately.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EventRepr {
    /// See [`Event::card`].
    pub card: u64,
    /// See [`Event::time_ns`].
    pub time_ns: u64,
    /// See [`Event::ring_full`].
    pub ring_full: u32,
    /// See [`Event::unreadable`].
    pub unreadable: u32,
    /// See [`Event::data_len`].
    pub data_len: u32,
    /// See [`Event::command`].
    pub command: u8,
    /// See [`Event::flags`].
    pub flags: u8,
}

impl EventRepr {
    /// Writes the event as the program does. Returns its length.
    ///
    /// # Errors
    /// If `data` is too long for its u16, or `out` is too short.
    pub fn emit(&self, data: &[u8], out: &mut [u8]) -> Result<usize, EmitError> {
        let kept = u16::try_from(data.len());
        let kept = kept.map_err(|_| EmitError::Field { name: "kept", got: data.len(), max: u16::MAX.into() })?;
        let out = room(out, at::DATA + data.len())?;
        LittleEndian::write_u64(&mut out[at::CARD..], self.card);
        LittleEndian::write_u64(&mut out[at::TIME_NS..], self.time_ns);
        LittleEndian::write_u32(&mut out[at::RING_FULL..], self.ring_full);
        LittleEndian::write_u32(&mut out[at::UNREADABLE..], self.unreadable);
        LittleEndian::write_u32(&mut out[at::DATA_LEN..], self.data_len);
        out[at::COMMAND] = self.command;
        out[at::FLAGS] = self.flags;
        LittleEndian::write_u16(&mut out[at::KEPT..], kept);
        let len = out.len();
        out[at::DATA..].copy_from_slice(data);
        Ok(len)
    }
}
