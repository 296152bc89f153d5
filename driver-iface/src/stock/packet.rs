//! Checked views of the packets.

use byteorder::{BigEndian, ByteOrder, LittleEndian};
use core::fmt;

use super::{
    FRAME_START, MAX_FRAME, MIN_FRAME, ORDER_UNKNOWN, PHY_LEN, PHY_LEN_WITH_ORDER, STATUS_GOOD, STATUS_LEN, command,
    offset,
};
use crate::Mac;
use crate::bfee::{self, STOCK_HEADER, csi_len};
use crate::mpdu::{self, FCS};

/// Why a packet is not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BadPacket {
    /// 0xC0 shorter than its fixed part.
    Phy {
        /// Bytes of data.
        got: usize,
    },
    /// 0xC1 whose frame length is impossible or exceeds the packet.
    Mpdu {
        /// The frame's length by its header.
        byte_count: usize,
        /// Bytes of data.
        got: usize,
    },
    /// 0xBB shorter than its header, or than header and CSI.
    CsiShort {
        /// Bytes needed.
        need: usize,
        /// Bytes of data.
        got: usize,
    },
    /// 0xBB whose header contradicts itself.
    Csi(bfee::Error),
}

impl fmt::Display for BadPacket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Phy { got } => write!(f, "RX_PHY of {got} bytes, its fixed part has {PHY_LEN}"),
            Self::Mpdu { byte_count, got } => write!(
                f,
                "RX_MPDU of {got} bytes with a frame of {byte_count}; {MIN_FRAME} to {MAX_FRAME} are possible, and 8 more \
                 bytes belong to it"
            ),
            Self::CsiShort { need, got } => write!(f, "CSI notification of {got} bytes, {need} are needed"),
            Self::Csi(error) => write!(f, "CSI notification: {error}"),
        }
    }
}

impl core::error::Error for BadPacket {}

/// The packets that records are made from.
#[derive(Clone, Copy, Debug)]
pub enum Packet<'a> {
    /// 0x01: the firmware restarted.
    Alive,
    /// 0xC0, or its error.
    RxPhy(Result<RxPhy, BadPacket>),
    /// 0xC1, or its error.
    RxMpdu(Result<RxMpdu<'a>, BadPacket>),
    /// 0xBB, or its error.
    Csi(Result<CsiNotification<'a>, BadPacket>),
    /// Every other command.
    Other,
}

impl<'a> Packet<'a> {
    /// A complete packet: its command and the data after its header of 8 bytes.
    #[must_use]
    pub fn new(command: u8, data: &'a [u8]) -> Self {
        match command {
            command::ALIVE => Self::Alive,
            command::RX_PHY => Self::RxPhy(RxPhy::new_checked(data)),
            command::RX_MPDU => Self::RxMpdu(RxMpdu::new_checked(data)),
            command::CSI => Self::Csi(CsiNotification::new_checked(data)),
            _ => Self::Other,
        }
    }
}

/// The fields that a record takes from 0xC0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RxPhy {
    /// Low 32 bits of the card's 1 MHz clock when the frame began, microseconds.
    pub timestamp_low: u32,
    /// RSSI of antennas A, B, C in dB above an internal reference.
    pub rssi: [u8; 3],
    /// Receiver gain, dB.
    pub agc: u8,
    /// The antennas of the chains, packed; `None` if the card did not report them.
    pub antenna_sel: Option<u8>,
    /// Rate and flags, the low 14 bits.
    pub rate_n_flags: u16,
}

impl RxPhy {
    /// Reads the data of 0xC0.
    ///
    /// # Errors
    /// [`BadPacket::Phy`] for less than [`PHY_LEN`] bytes.
    pub fn new_checked(data: &[u8]) -> Result<Self, BadPacket> {
        let fixed = data.first_chunk::<PHY_LEN>().ok_or(BadPacket::Phy { got: data.len() })?;
        let word = |at: usize| fixed.get(at..).map_or(0, LittleEndian::read_u32);
        let (ab, c) = (word(offset::PHY_RSSI_AB), word(offset::PHY_RSSI_C));
        let configured = fixed[offset::PHY_CFG_COUNT] > 0 && data.len() >= PHY_LEN_WITH_ORDER;
        let order = data.get(offset::PHY_ANTENNA_SEL).copied();
        Ok(Self {
            timestamp_low: word(offset::PHY_TIMESTAMP),
            rssi: [ab as u8, (ab >> 16) as u8, c as u8],
            agc: (word(offset::PHY_AGC) >> 9 & 0x7f) as u8,
            antenna_sel: order.filter(|order| configured && *order != ORDER_UNKNOWN),
            rate_n_flags: (word(offset::PHY_RATE_N_FLAGS) & 0x3fff) as u16,
        })
    }
}

/// The first bytes of a frame, as far as they exist.
pub type FrameStart = [u8; FRAME_START];

/// A frame of 0xC1, complete or only its beginning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RxMpdu<'a> {
    byte_count: usize,
    frame: &'a [u8],
    status: u32,
}

impl<'a> RxMpdu<'a> {
    /// Reads the data of 0xC1.
    ///
    /// # Errors
    /// [`BadPacket::Mpdu`] if the frame is impossibly short or long, or longer than the packet.
    pub fn new_checked(data: &'a [u8]) -> Result<Self, BadPacket> {
        let byte_count = checked_len(data, data.len())?;
        let bad = BadPacket::Mpdu { byte_count, got: data.len() };
        let frame = data.get(offset::MPDU_FRAME..).and_then(|rest| rest.split_at_checked(byte_count));
        let (frame, status) = frame.ok_or(bad)?;
        Ok(Self { byte_count, frame, status: LittleEndian::read_u32(status.first_chunk::<STATUS_LEN>().ok_or(bad)?) })
    }

    /// From the first bytes of an 0xC1's data, which has `data_len` bytes, and the status from the frame's end.
    ///
    /// # Errors
    /// As [`new_checked`](Self::new_checked), and if `start` lacks needed bytes of the frame.
    pub fn from_start(data_len: usize, start: &'a [u8], status: u32) -> Result<Self, BadPacket> {
        let byte_count = checked_len(start, data_len)?;
        let frame = start.get(offset::MPDU_FRAME..).unwrap_or_default();
        let frame = frame.get(..byte_count).unwrap_or(frame);
        if frame.len() < byte_count.min(FRAME_START) {
            return Err(BadPacket::Mpdu { byte_count, got: start.len() });
        }
        Ok(Self { byte_count, frame, status })
    }

    /// Bytes of the frame, FCS included.
    #[must_use]
    pub fn byte_count(&self) -> usize {
        self.byte_count
    }

    /// The whole frame, 802.11 header to FCS; `None` if only its beginning is available.
    #[must_use]
    pub fn frame(&self) -> Option<&'a [u8]> {
        (self.frame.len() == self.byte_count).then_some(self.frame)
    }

    /// True if the checksum was correct and the card's buffer did not overflow.
    #[must_use]
    pub fn is_good(&self) -> bool {
        self.status & STATUS_GOOD == STATUS_GOOD
    }

    /// Address 3 and the number after the header, for a good frame that is long enough for both.
    #[must_use]
    pub fn sender(&self) -> Option<(Mac, u32)> {
        let long_enough = self.byte_count >= FRAME_START + FCS;
        let start: &FrameStart = self.frame.first_chunk().filter(|_| self.is_good() && long_enough)?;
        let mac = start.get(mpdu::offset::ADDR3..)?.first_chunk()?;
        Some((Mac(*mac), start.get(mpdu::offset::COUNTER..).map(BigEndian::read_u32)?))
    }
}

/// The frame's length from the packet's first bytes, if it fits the packet of `data_len` bytes.
fn checked_len(start: &[u8], data_len: usize) -> Result<usize, BadPacket> {
    let byte_count = start.first_chunk::<2>().map_or(0, |bytes| usize::from(u16::from_le_bytes(*bytes)));
    let fits = offset::MPDU_FRAME + byte_count + STATUS_LEN <= data_len;
    if !fits || !(MIN_FRAME..=MAX_FRAME).contains(&byte_count) {
        return Err(BadPacket::Mpdu { byte_count, got: data_len });
    }
    Ok(byte_count)
}

/// The CSI of 0xBB, checked; a record's header whose driver fields are still empty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CsiNotification<'a> {
    head: &'a [u8; STOCK_HEADER],
    csi: &'a [u8],
}

impl<'a> CsiNotification<'a> {
    /// Checks the data of 0xBB; bytes after the CSI are allowed and skipped.
    ///
    /// # Errors
    /// If chains are not 1 to 3, the CSI length does not match, or the data is shorter.
    pub fn new_checked(data: &'a [u8]) -> Result<Self, BadPacket> {
        let got = data.len();
        let short = BadPacket::CsiShort { need: STOCK_HEADER, got };
        let (head, rest) = data.split_first_chunk::<STOCK_HEADER>().ok_or(short)?;
        let len = usize::from(u16::from_le_bytes([head[bfee::offset::LEN], head[bfee::offset::LEN + 1]]));
        bfee::check(head, STOCK_HEADER + len).map_err(BadPacket::Csi)?;
        let csi = rest.get(..len).ok_or(BadPacket::CsiShort { need: STOCK_HEADER + len, got })?;
        debug_assert_eq!(len, csi_len(head[bfee::offset::N_RX], head[bfee::offset::N_TX]));
        Ok(Self { head, csi })
    }

    /// The 20 bytes before the CSI, as the firmware sent them.
    pub(super) fn head(&self) -> &'a [u8; STOCK_HEADER] {
        self.head
    }

    /// The packed CSI.
    #[must_use]
    pub fn csi(&self) -> &'a [u8] {
        self.csi
    }
}
