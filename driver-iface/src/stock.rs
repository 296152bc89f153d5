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

use crate::bfee::{self, Layout, MAX_BODY, NOISE_UNKNOWN_DBM, STOCK_HEADER, Wsr};
use crate::mpdu::FCS;
use crate::record::{Record, code};
use crate::{EmitError, Mac, array, mpdu, room};
use byteorder::{BigEndian, ByteOrder, LittleEndian};

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

/// Offsets in the data of commands.
mod offset {
    /// u8 of 0xC0: number of words after the fixed part; the first byte of the first one is the antenna order.
    pub(super) const PHY_CFG_COUNT: usize = 1;
    /// u64 of 0xC0, microseconds of the card's clock.
    pub(super) const PHY_TIMESTAMP: usize = 4;
    /// u32 of 0xC0, bits 15 to 9: gain in dB.
    pub(super) const PHY_AGC: usize = 24;
    /// u32 of 0xC0: RSSI of antenna A in bits 7 to 0, of B in bits 23 to 16.
    pub(super) const PHY_RSSI_AB: usize = 28;
    /// u32 of 0xC0: RSSI of antenna C in bits 7 to 0.
    pub(super) const PHY_RSSI_C: usize = 32;
    /// u32 of 0xC0.
    pub(super) const PHY_RATE_N_FLAGS: usize = 52;
    /// u8 of 0xC0, if there are configured words.
    pub(super) const PHY_ANTENNA_SEL: usize = 60;
    /// The frame in 0xC1, after a u16 of its length, FCS included; a u32 of status follows it.
    pub(super) const MPDU_FRAME: usize = 4;
}

/// Bytes of 0xC0 without configured words.
const PHY_LEN: usize = 60;
/// Bytes of 0xC0 with one configured word.
const PHY_LEN_WITH_ORDER: usize = 64;
/// Bytes of the status after a frame.
const STATUS_LEN: usize = 4;
/// Bits of the status: checksum correct, and no overflow of the card's buffer (RX_RES_STATUS_NO_CRC32_ERROR,
/// RX_RES_STATUS_NO_RXE_OVERFLOW).
const STATUS_GOOD: u32 = 0b11;
/// The shortest frame: an acknowledgement with its FCS.
const MIN_FRAME: usize = 14;
/// The longest frame that fits a record.
const MAX_FRAME: usize = crate::record::MAX_LENGTH - 1;
/// Bytes of a frame that are read: 802.11 header and number.
const FRAME_START: usize = crate::mpdu::HEADER + crate::mpdu::COUNTER;
/// `antenna_sel` if the card did not report it: it names no antenna.
const ORDER_UNKNOWN: u8 = 0xff;

/// The wanted records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// csitool's layout, or WSR's with host time, sender and frame number.
    pub layout: Layout,
    /// Return 0xC1 records, the frames themselves, before their 0xBB (`connector_log` 0x4).
    pub frames: bool,
    /// Return 0xBB records (`connector_log` 0x1).
    pub csi: bool,
}

impl Default for Options {
    /// 0xBB records in WSR's layout, because a bearing needs sender and frame number.
    fn default() -> Self {
        Self { layout: Layout::Wsr, frames: false, csi: true }
    }
}

/// Counts of a card's packets and their use. The counters wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Counts {
    /// 0xC0 seen.
    pub phy: u32,
    /// 0xC1 seen.
    pub mpdu: u32,
    /// 0xBB seen.
    pub bfee: u32,
    /// Records made from 0xBB.
    pub records: u32,
    /// 0xC0 too short.
    pub bad_phy: u32,
    /// 0xC1 with contradictory lengths.
    pub bad_mpdu: u32,
    /// 0xC1 before any 0xC0, dropped.
    pub mpdu_no_phy: u32,
    /// 0xBB with contradictory counts or lengths.
    pub bad_bfee: u32,
    /// 0xBB without its own 0xC0, dropped.
    pub no_phy: u32,
    /// Records without antenna order from the card.
    pub no_order: u32,
    /// Records in WSR's layout without a good 0xC1 of their frame: sender unknown.
    pub no_sender: u32,
}

impl Counts {
    /// 0xBB that gave no record.
    #[must_use]
    pub fn dropped(&self) -> u32 {
        self.bad_bfee.wrapping_add(self.no_phy)
    }
}

/// The state of one card: packets of the frame whose 0xBB is awaited.
///
/// Call [`handle`](Self::handle) with every packet in order of arrival, and [`gap`](Self::gap) where some are missing.
#[derive(Clone, Debug, Default)]
pub struct Card {
    phy: Option<RxPhy>,
    phy_seen: bool,
    sender: Option<(Mac, u32)>,
    bfee_count: u16,
}

impl Card {
    /// Packets are missing here: the current frame must not be combined with later packets.
    pub fn gap(&mut self) {
        (self.phy, self.sender) = (None, None);
    }

    /// Handles one packet, and counts it in `counts`. `host_us` is the host's wall clock at its arrival, microseconds since the Unix epoch; a record of CSI is
    /// written to `body`.
    ///
    /// Returns the record that this packet completes, if any: 0xBB, or with [`Options::frames`] 0xC1.
    pub fn handle<'b>(
        &mut self,
        counts: &mut Counts,
        options: &Options,
        packet: &Packet<'b>,
        host_us: i64,
        body: &'b mut [u8; MAX_BODY],
    ) -> Option<Record<'b>> {
        match packet {
            Packet::Alive => {
                self.gap();
                self.phy_seen = false;
                None
            }
            Packet::RxPhy(phy) => {
                counts.phy = counts.phy.wrapping_add(1);
                (self.phy, self.sender) = (*phy, None);
                self.phy_seen |= phy.is_some();
                counts.bad_phy = counts.bad_phy.wrapping_add(phy.is_none().into());
                None
            }
            Packet::RxMpdu(mpdu) => self.mpdu(counts, options, mpdu.as_ref()),
            Packet::Csi(csi) => self.csi(counts, options, csi.as_ref(), host_us, body),
            Packet::Other => None,
        }
    }

    fn mpdu<'a>(&mut self, counts: &mut Counts, options: &Options, mpdu: Option<&RxMpdu<'a>>) -> Option<Record<'a>> {
        counts.mpdu = counts.mpdu.wrapping_add(1);
        let Some(mpdu) = mpdu else {
            counts.bad_mpdu = counts.bad_mpdu.wrapping_add(1);
            self.sender = None;
            return None;
        };
        if !self.phy_seen {
            counts.mpdu_no_phy = counts.mpdu_no_phy.wrapping_add(1);
            return None;
        }
        // WSR's driver uses one variable for "sender known" and the number: with number 0 the address is lost, too.
        let found = mpdu.sender().map(|(mac, number)| (if number == 0 { Mac::default() } else { mac }, number));
        self.sender = found.or(self.sender);
        let body = mpdu.frame().filter(|_| options.frames)?;
        Some(Record { code: code::MPDU, body })
    }

    fn csi<'b>(
        &mut self,
        counts: &mut Counts,
        options: &Options,
        csi: Option<&CsiNotification<'_>>,
        host_us: i64,
        body: &'b mut [u8; MAX_BODY],
    ) -> Option<Record<'b>> {
        counts.bfee = counts.bfee.wrapping_add(1);
        let (phy, sender) = (self.phy.take(), self.sender.take());
        let Some(csi) = csi else {
            counts.bad_bfee = counts.bad_bfee.wrapping_add(1);
            return None;
        };
        let Some(phy) = phy else {
            counts.no_phy = counts.no_phy.wrapping_add(1);
            return None;
        };
        self.bfee_count = self.bfee_count.wrapping_add(1);
        counts.records = counts.records.wrapping_add(1);
        counts.no_order = counts.no_order.wrapping_add(phy.antenna_sel.is_none().into());
        let is_wsr = options.layout != Layout::Stock;
        counts.no_sender = counts.no_sender.wrapping_add((is_wsr && sender.is_none()).into());
        let (mac, number) = sender.unwrap_or_default();
        let wsr = Wsr::at(host_us, mac, (options.layout == Layout::Wsr).then_some(number));
        // Chains and reserved bytes are the firmware's, the rest is from 0xC0.
        let repr = bfee::Repr {
            timestamp_low: phy.timestamp_low,
            bfee_count: self.bfee_count,
            reserved: u16::from_le_bytes(array(csi.head, bfee::offset::RESERVED)),
            n_rx: csi.head[bfee::offset::N_RX],
            n_tx: csi.head[bfee::offset::N_TX],
            rssi: phy.rssi,
            noise_dbm: NOISE_UNKNOWN_DBM,
            agc: phy.agc,
            antenna_sel: phy.antenna_sel.unwrap_or(ORDER_UNKNOWN),
            rate_n_flags: phy.rate_n_flags,
            wsr: is_wsr.then_some(wsr),
        };
        let body = body.get_mut(..repr.body_len())?;
        let (header, payload) = body.split_at_mut_checked(repr.layout().header_len())?;
        repr.emit_header(header);
        payload.copy_from_slice(csi.csi);
        Some(Record { code: code::BFEE, body }).filter(|_| options.csi)
    }
}

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

/// An event of the program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Event<'a> {
    /// The card: equal for one card's packets while its driver runs.
    pub card: u64,
    /// When the driver handled the packet: CLOCK_MONOTONIC, nanoseconds.
    pub time_ns: u64,
    /// Number of events without room in the ring before this one, since the program was loaded; wraps.
    pub ring_full: u32,
    /// Number of packets before this one that the program could not read; wraps.
    pub unreadable: u32,
    /// Bytes of data of the packet, from its header.
    pub data_len: u32,
    /// The packet's command.
    pub command: u8,
    /// How the packet was cut, [`flag`].
    pub flags: u8,
    /// What is there of the packet's data.
    pub data: &'a [u8],
}

impl<'a> Event<'a> {
    /// Checks an event as it stands in the ring; bytes after its data are padding. `None` if it is shorter than its header and data,
    /// has more data than its packet, or unknown flags.
    #[must_use]
    pub fn new_checked(bytes: &'a [u8]) -> Option<Self> {
        let (head, rest) = bytes.split_first_chunk::<{ at::DATA }>()?;
        let event = Self {
            card: LittleEndian::read_u64(&head[at::CARD..]),
            time_ns: LittleEndian::read_u64(&head[at::TIME_NS..]),
            ring_full: LittleEndian::read_u32(&head[at::RING_FULL..]),
            unreadable: LittleEndian::read_u32(&head[at::UNREADABLE..]),
            data_len: LittleEndian::read_u32(&head[at::DATA_LEN..]),
            command: head[at::COMMAND],
            flags: head[at::FLAGS],
            data: rest.get(..LittleEndian::read_u16(&head[at::KEPT..]).into())?,
        };
        let limit = (event.data_len as usize).saturating_add(if event.is_start() { STATUS_LEN } else { 0 });
        (event.data.len() <= limit && event.flags & !flag::FRAME_START == 0).then_some(event)
    }

    fn is_start(&self) -> bool {
        self.command == command::RX_MPDU && self.flags & flag::FRAME_START != 0
    }

    /// The packet. Making a record does not use what the program cut off.
    #[must_use]
    pub fn packet(&self) -> Packet<'a> {
        if !self.is_start() {
            return Packet::new(self.command, self.data);
        }
        let (start, status) = self.data.split_last_chunk::<STATUS_LEN>().unwrap_or((&[], &[0; STATUS_LEN]));
        Packet::RxMpdu(RxMpdu::from_start(self.data_len as usize, start, u32::from_le_bytes(*status)))
    }

    /// Writes the event as the program does. Returns its length.
    ///
    /// # Errors
    /// If its data is too long for its u16, or `out` is too short.
    pub fn emit(&self, out: &mut [u8]) -> Result<usize, EmitError> {
        let got = self.data.len();
        let kept = u16::try_from(got).map_err(|_| EmitError::Field { name: "kept", got, max: u16::MAX.into() })?;
        let out = room(out, at::DATA + got)?;
        LittleEndian::write_u64(&mut out[at::CARD..], self.card);
        LittleEndian::write_u64(&mut out[at::TIME_NS..], self.time_ns);
        LittleEndian::write_u32(&mut out[at::RING_FULL..], self.ring_full);
        LittleEndian::write_u32(&mut out[at::UNREADABLE..], self.unreadable);
        LittleEndian::write_u32(&mut out[at::DATA_LEN..], self.data_len);
        out[at::COMMAND] = self.command;
        out[at::FLAGS] = self.flags;
        LittleEndian::write_u16(&mut out[at::KEPT..], kept);
        out[at::DATA..].copy_from_slice(self.data);
        Ok(out.len())
    }
}

/// The packets that records are made from.
#[derive(Clone, Copy, Debug)]
pub enum Packet<'a> {
    /// 0x01: the firmware restarted.
    Alive,
    /// 0xC0; `None` if it is contradictory, as for the next two.
    RxPhy(Option<RxPhy>),
    /// 0xC1.
    RxMpdu(Option<RxMpdu<'a>>),
    /// 0xBB.
    Csi(Option<CsiNotification<'a>>),
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
    /// Reads the data of 0xC0; `None` for less than 60 bytes.
    #[must_use]
    pub fn new_checked(data: &[u8]) -> Option<Self> {
        let fixed = data.first_chunk::<PHY_LEN>()?;
        let word = |at: usize| u32::from_le_bytes(array(fixed, at));
        let (ab, c) = (word(offset::PHY_RSSI_AB), word(offset::PHY_RSSI_C));
        let configured = fixed[offset::PHY_CFG_COUNT] > 0 && data.len() >= PHY_LEN_WITH_ORDER;
        let order = data.get(offset::PHY_ANTENNA_SEL).copied();
        Some(Self {
            timestamp_low: word(offset::PHY_TIMESTAMP),
            rssi: [ab as u8, (ab >> 16) as u8, c as u8],
            agc: (word(offset::PHY_AGC) >> 9 & 0x7f) as u8,
            antenna_sel: order.filter(|order| configured && *order != ORDER_UNKNOWN),
            rate_n_flags: (word(offset::PHY_RATE_N_FLAGS) & 0x3fff) as u16,
        })
    }
}

/// A frame of 0xC1, complete or only its beginning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RxMpdu<'a> {
    byte_count: usize,
    frame: &'a [u8],
    status: u32,
}

impl<'a> RxMpdu<'a> {
    /// Reads the data of 0xC1; `None` if the frame is impossibly short or long, or longer than the packet.
    #[must_use]
    pub fn new_checked(data: &'a [u8]) -> Option<Self> {
        let byte_count = checked_len(data, data.len())?;
        let (frame, status) = data.get(offset::MPDU_FRAME..)?.split_at_checked(byte_count)?;
        Some(Self { byte_count, frame, status: LittleEndian::read_u32(status.first_chunk::<STATUS_LEN>()?) })
    }

    /// From the first bytes of an 0xC1's data, which has `data_len` bytes, and the status from the frame's end. `None` as for
    /// [`new_checked`](Self::new_checked), and if `start` lacks needed bytes of the frame.
    #[must_use]
    pub fn from_start(data_len: usize, start: &'a [u8], status: u32) -> Option<Self> {
        let byte_count = checked_len(start, data_len)?;
        let frame = start.get(offset::MPDU_FRAME..)?;
        let frame = frame.get(..byte_count).unwrap_or(frame);
        (frame.len() >= byte_count.min(FRAME_START)).then_some(Self { byte_count, frame, status })
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
        let start = self.frame.first_chunk::<FRAME_START>().filter(|_| self.is_good() && long_enough)?;
        let mac = start.get(mpdu::offset::ADDR3..)?.first_chunk()?;
        Some((Mac(*mac), start.get(mpdu::offset::COUNTER..).map(BigEndian::read_u32)?))
    }
}

/// The frame's length from the packet's first bytes, if it fits the packet of `data_len` bytes.
fn checked_len(start: &[u8], data_len: usize) -> Option<usize> {
    let byte_count = usize::from(u16::from_le_bytes(*start.first_chunk()?));
    let fits = offset::MPDU_FRAME + byte_count + STATUS_LEN <= data_len;
    (fits && (MIN_FRAME..=MAX_FRAME).contains(&byte_count)).then_some(byte_count)
}

/// The CSI of 0xBB, checked; a record's header whose driver fields are still empty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CsiNotification<'a> {
    head: &'a [u8; STOCK_HEADER],
    csi: &'a [u8],
}

impl<'a> CsiNotification<'a> {
    /// Checks the data of 0xBB; bytes after the CSI are allowed and skipped. `None` if chains are not 1 to 3, the CSI length does not
    /// match, or the data is shorter.
    #[must_use]
    pub fn new_checked(data: &'a [u8]) -> Option<Self> {
        let (head, rest) = data.split_first_chunk::<STOCK_HEADER>()?;
        let len = usize::from(u16::from_le_bytes([head[bfee::offset::LEN], head[bfee::offset::LEN + 1]]));
        bfee::check(head, STOCK_HEADER + len).ok()?;
        Some(Self { head, csi: rest.get(..len)? })
    }

    /// The packed CSI.
    #[must_use]
    pub fn csi(&self) -> &'a [u8] {
        self.csi
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;
    use std::vec::Vec;

    /// 0xC1 with a frame of 57 bytes, number 0x01020304, from 00:21:6a:00:00:07.
    fn mpdu() -> Vec<u8> {
        let mut data = vec![0; 4 + 57 + 4];
        data[0] = 57;
        data[4 + 16..4 + 22].copy_from_slice(&[0, 0x21, 0x6a, 0, 0, 7]);
        data[4 + 24..4 + 28].copy_from_slice(&[1, 2, 3, 4]);
        data[4 + 57] = 3;
        data
    }

    /// What becomes of packets otherwise: `tests/stock.rs` compares it with an oracle and the kernel module.
    #[test]
    fn nothing_from_before_a_gap_is_used() {
        let (phy, mut csi) = ([0; 64], vec![0; 20 + 192]);
        (csi[8], csi[9], csi[16]) = (3, 1, 192);
        for (gap, records) in [(false, 1), (true, 0)] {
            let (mut card, mut counts, mut body) = (Card::default(), Counts::default(), [0; MAX_BODY]);
            card.handle(&mut counts, &Options::default(), &Packet::new(0xC0, &phy), 0, &mut body);
            if gap {
                card.gap();
            }
            card.handle(&mut counts, &Options::default(), &Packet::new(0xBB, &csi), 0, &mut body);
            assert_eq!((counts.records, counts.no_phy), (records, 1 - records));
        }
    }

    #[test]
    fn the_kept_beginning_of_a_frame_is_as_long_as_needed() {
        let data = mpdu();
        let frame = |kept: usize| RxMpdu::from_start(data.len(), &data[..kept], 3).map(|mpdu| mpdu.byte_count());
        assert_eq!([frame(32), frame(33), frame(data.len())], [Some(57); 3]);
        assert_eq!([1, 2, 3, 4, 5, 31].map(frame), [None; 6]);
    }

    #[test]
    fn only_a_cut_frame_has_its_status_at_the_end() {
        for (command, flags, kept) in [(0xC1, 1, 12), (0xC1, 0, 8), (0xBB, 1, 8), (0xBB, 0, 8)] {
            let mut bytes = [0; 64];
            for (len, fits) in [(kept, true), (kept + 1, false)] {
                let event = Event { data_len: 8, command, flags, data: &[7; 13][..len], ..Event::default() };
                event.emit(&mut bytes).unwrap();
                assert_eq!(Event::new_checked(&bytes).is_some(), fits, "{command:#x} {flags} {len}");
            }
        }
    }

    #[test]
    fn events_round_trip() {
        let event = Event {
            card: 0x1122_3344_5566_7788,
            time_ns: 0x0102_0304_0506_0708,
            ring_full: 0x0a0b_0c0d,
            unreadable: 0x1a1b_1c1d,
            data_len: 0x0102_0304,
            command: 0xBB,
            flags: 0,
            data: &[5, 6, 7],
        };
        let mut bytes = [0xee; 64];
        assert_eq!(event.emit(&mut bytes), Ok(35));
        assert_eq!(Event::new_checked(&bytes), Some(event));
        // Offsets as the program has them.
        assert_eq!(
            (bytes[0], bytes[8], bytes[16], bytes[20], bytes[24], bytes[28], bytes[30]),
            (0x88, 8, 0x0d, 0x1d, 4, 0xBB, 3)
        );
    }

    #[test]
    fn dropped_counts_every_notification_without_a_record() {
        let counts = Counts { bfee: 9, records: 4, bad_bfee: 2, no_phy: 3, ..Counts::default() };
        assert_eq!(counts.dropped(), 5);
        assert_eq!(Counts { bad_bfee: u32::MAX, ..counts }.dropped(), 2);
    }
}
