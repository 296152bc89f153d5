//! CSI beside the kernel's own driver: the card's packets as the driver receives them, and the records made from them.
//!
//! For each frame the CSI firmware sends the notification 0xBB, which the distributions' `iwlwifi` ignores. (The patched drivers
//! also request CSI from the card; whether it comes without a request is unknown, see `firmware-notes/kernels.md`.) csitool's
//! driver makes a record from it, with time, RSSI, gain and rate from the reception 0xC0 before it. [`Card`] does the same from a
//! copy of the packets, taken where `iwldvm` passes each to `iwl_notification_wait`, by an eBPF program whose events [`Event`]
//! reads.
//!
//! For one frame the card sends 0xC0 ([`RxPhy`]), 0xC1 ([`RxMpdu`]), 0xBB. Layouts are those of the firmware
//! (`dvm/commands.h` of Linux 6.1: `struct iwl_rx_phy_res`, `struct iwl_rx_mpdu_res_start`), little-endian.
//! Every length and count is checked: a card may send anything.
//!
//! A record is made from one 0xC0 and one 0xBB. Used or contradictory packets are forgotten, so that no record contains another
//! frame's fields; [`Counts`] counts dropped packets by reason.

mod card;
mod event;
mod packet;

pub use card::{Card, Counts, Options};
pub use event::{Event, EventError, EventRepr, flag};
pub use packet::{BadPacket, CsiNotification, FrameStart, Packet, RxMpdu, RxPhy};

/// Commands in a packet's header (`dvm/commands.h`).
pub mod command {
    /// REPLY_ALIVE: the firmware started.
    pub const ALIVE: u8 = 0x01;
    /// REPLY_RX_PHY_CMD: the PHY part of a reception.
    pub const RX_PHY: u8 = 0xC0;
    /// REPLY_RX_MPDU_CMD: a received frame.
    pub const RX_MPDU: u8 = 0xC1;
    /// REPLY_BFEE_NOTIFICATION of csitool: CSI.
    pub const CSI: u8 = 0xBB;
}

/// Offsets in a packet and in its commands' data.
pub mod offset {
    /// u32 of the packet; [`SIZE_MASK`](super::SIZE_MASK) selects the number of bytes after it.
    pub const LEN_N_FLAGS: usize = 0;
    /// u8 of the packet.
    pub const COMMAND: usize = 4;
    /// The packet's data.
    pub const DATA: usize = 8;
    /// u8 of 0xC0: number of words after the fixed part; the first byte of the first one is the antenna order.
    pub const PHY_CFG_COUNT: usize = 1;
    /// u64 of 0xC0, microseconds of the card's clock.
    pub const PHY_TIMESTAMP: usize = 4;
    /// u32 of 0xC0, bits 15 to 9: gain in dB.
    pub const PHY_AGC: usize = 24;
    /// u32 of 0xC0: RSSI of antenna A in bits 7 to 0, of B in bits 23 to 16.
    pub const PHY_RSSI_AB: usize = 28;
    /// u32 of 0xC0: RSSI of antenna C in bits 7 to 0.
    pub const PHY_RSSI_C: usize = 32;
    /// u32 of 0xC0.
    pub const PHY_RATE_N_FLAGS: usize = 52;
    /// u8 of 0xC0, if there are configured words.
    pub const PHY_ANTENNA_SEL: usize = 60;
    /// u16 of 0xC1: bytes of the frame, FCS included.
    pub const MPDU_BYTE_COUNT: usize = 0;
    /// The frame in 0xC1; a u32 of status follows it.
    pub const MPDU_FRAME: usize = 4;
}

/// Bits of [`offset::LEN_N_FLAGS`] with the packet's size, counted from the command byte on.
pub const SIZE_MASK: u32 = 0x3fff;
/// Bytes of 0xC0 without configured words.
pub const PHY_LEN: usize = 60;
/// Bytes of 0xC0 with one configured word.
pub const PHY_LEN_WITH_ORDER: usize = 64;
/// Bytes of the status after a frame.
pub const STATUS_LEN: usize = 4;
/// Bits of the status: checksum correct, and no overflow of the card's buffer (RX_RES_STATUS_NO_CRC32_ERROR,
/// RX_RES_STATUS_NO_RXE_OVERFLOW).
pub const STATUS_GOOD: u32 = 0b11;
/// The shortest frame: an acknowledgement with its FCS.
pub const MIN_FRAME: usize = 14;
/// The longest frame that fits a record.
pub const MAX_FRAME: usize = crate::record::MAX_LENGTH - 1;
/// Bytes of a frame that are read: 802.11 header and number.
pub const FRAME_START: usize = crate::mpdu::HEADER + crate::mpdu::COUNTER;
/// `antenna_sel` if the card did not report it: it names no antenna.
pub const ORDER_UNKNOWN: u8 = 0xff;

#[cfg(test)]
mod tests;
