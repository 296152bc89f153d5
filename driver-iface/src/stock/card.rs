//! Turns one card's packets, in order, into records.

use byteorder::{ByteOrder, LittleEndian};

use super::{ORDER_UNKNOWN, Packet, RxMpdu, RxPhy};
use crate::Mac;
use crate::bfee::{Layout, MAX_BODY, NOISE_UNKNOWN_DBM, STOCK_HEADER, WSR_HEADER, offset};
use crate::record::{Record, code};
use crate::stock::CsiNotification;

/// The wanted records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
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

impl Options {
    /// Sets [`layout`](Self::layout).
    #[must_use]
    pub fn with_layout(self, layout: Layout) -> Self {
        Self { layout, ..self }
    }

    /// Sets [`frames`](Self::frames).
    #[must_use]
    pub fn with_frames(self, frames: bool) -> Self {
        Self { frames, ..self }
    }

    /// Sets [`csi`](Self::csi).
    #[must_use]
    pub fn with_csi(self, csi: bool) -> Self {
        Self { csi, ..self }
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

    /// The sum of two cards' counts.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        Self {
            phy: self.phy.wrapping_add(other.phy),
            mpdu: self.mpdu.wrapping_add(other.mpdu),
            bfee: self.bfee.wrapping_add(other.bfee),
            records: self.records.wrapping_add(other.records),
            bad_phy: self.bad_phy.wrapping_add(other.bad_phy),
            bad_mpdu: self.bad_mpdu.wrapping_add(other.bad_mpdu),
            mpdu_no_phy: self.mpdu_no_phy.wrapping_add(other.mpdu_no_phy),
            bad_bfee: self.bad_bfee.wrapping_add(other.bad_bfee),
            no_phy: self.no_phy.wrapping_add(other.no_phy),
            no_order: self.no_order.wrapping_add(other.no_order),
            no_sender: self.no_sender.wrapping_add(other.no_sender),
        }
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
    counts: Counts,
}

impl Card {
    /// Counts since the card was first seen.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Packets are missing here: the current frame must not be combined with later packets.
    pub fn gap(&mut self) {
        (self.phy, self.sender) = (None, None);
    }

    /// Handles one packet. `host_us` is the host's wall clock at its arrival, microseconds since the Unix epoch; a record of CSI is
    /// written to `body`.
    ///
    /// Returns the record that this packet completes, if any: 0xBB, or with [`Options::frames`] 0xC1.
    pub fn handle<'b>(
        &mut self,
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
                self.counts.phy = self.counts.phy.wrapping_add(1);
                (self.phy, self.sender) = (phy.ok(), None);
                self.phy_seen |= phy.is_ok();
                self.counts.bad_phy = self.counts.bad_phy.wrapping_add(phy.is_err().into());
                None
            }
            Packet::RxMpdu(mpdu) => self.mpdu(options, mpdu.as_ref().ok()),
            Packet::Csi(csi) => self.csi(options, csi.as_ref().ok(), host_us, body),
            Packet::Other => None,
        }
    }

    fn mpdu<'a>(&mut self, options: &Options, mpdu: Option<&RxMpdu<'a>>) -> Option<Record<'a>> {
        self.counts.mpdu = self.counts.mpdu.wrapping_add(1);
        let Some(mpdu) = mpdu else {
            self.counts.bad_mpdu = self.counts.bad_mpdu.wrapping_add(1);
            self.sender = None;
            return None;
        };
        if !self.phy_seen {
            self.counts.mpdu_no_phy = self.counts.mpdu_no_phy.wrapping_add(1);
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
        options: &Options,
        csi: Option<&CsiNotification<'_>>,
        host_us: i64,
        body: &'b mut [u8; MAX_BODY],
    ) -> Option<Record<'b>> {
        self.counts.bfee = self.counts.bfee.wrapping_add(1);
        let (phy, sender) = (self.phy.take(), self.sender.take());
        let Some(csi) = csi else {
            self.counts.bad_bfee = self.counts.bad_bfee.wrapping_add(1);
            return None;
        };
        let Some(phy) = phy else {
            self.counts.no_phy = self.counts.no_phy.wrapping_add(1);
            return None;
        };
        self.bfee_count = self.bfee_count.wrapping_add(1);
        self.counts.records = self.counts.records.wrapping_add(1);
        self.counts.no_order = self.counts.no_order.wrapping_add(phy.antenna_sel.is_none().into());
        let (head, rest) = body.split_first_chunk_mut::<STOCK_HEADER>()?;
        fill(head, csi.head(), &phy, self.bfee_count);
        let header_len = options.layout.header_len();
        if options.layout != Layout::Stock {
            self.counts.no_sender = self.counts.no_sender.wrapping_add(sender.is_none().into());
            // In the layout of 2021 the CSI overwrites the number.
            extend(rest.first_chunk_mut()?, host_us, sender.unwrap_or_default());
        }
        let len = header_len + csi.csi().len();
        body.get_mut(header_len..len)?.copy_from_slice(csi.csi());
        Some(Record { code: code::BFEE, body: body.get(..len)? }).filter(|_| options.csi)
    }
}

/// The 20 bytes of the stock layout: chains, length and reserved bytes from the firmware, the rest from 0xC0.
fn fill(out: &mut [u8; STOCK_HEADER], firmware: &[u8; STOCK_HEADER], phy: &RxPhy, bfee_count: u16) {
    *out = *firmware;
    LittleEndian::write_u32(out, phy.timestamp_low);
    LittleEndian::write_u16(&mut out[offset::BFEE_COUNT..], bfee_count);
    out[offset::RSSI] = phy.rssi[0];
    out[offset::RSSI + 1] = phy.rssi[1];
    out[offset::RSSI + 2] = phy.rssi[2];
    out[offset::NOISE] = NOISE_UNKNOWN_DBM.cast_unsigned();
    out[offset::AGC] = phy.agc;
    out[offset::ANTENNA_SEL] = phy.antenna_sel.unwrap_or(ORDER_UNKNOWN);
    LittleEndian::write_u16(&mut out[offset::RATE_N_FLAGS..], phy.rate_n_flags);
}

/// The 18 additional bytes of WSR's layout.
fn extend(out: &mut [u8; WSR_HEADER - STOCK_HEADER], host_us: i64, (mac, number): (Mac, u32)) {
    LittleEndian::write_u32(out, host_us.div_euclid(1_000_000) as u32);
    LittleEndian::write_u32(&mut out[offset::TV_USEC - STOCK_HEADER..], host_us.rem_euclid(1_000_000) as u32);
    for (byte, octet) in out.iter_mut().skip(offset::MAC - STOCK_HEADER).zip(mac.0) {
        *byte = octet;
    }
    LittleEndian::write_u32(&mut out[offset::FRAME_COUNT - STOCK_HEADER..], number);
}
