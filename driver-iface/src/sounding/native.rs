//! The native dialect: the payload contains destination, role, turn and slot, so that one length serves every robot, any robot may
//! initiate, and clocks can be synchronised over the air. Works with the stock CSI driver.
//!
//! After the common header and number ([`super`]), all numbers big-endian:
//!
//! | offset | size | field |
//! |---|---|---|
//! | 28 | 3 | [`MAGIC`] |
//! | 31 | 1 | [`VERSION`] |
//! | 32 | 1 | role: 0 forward, 1 backward |
//! | 33 | 1 | flags: 0x01 measurement follows, 0x02 tag follows, 0x04 sender wants the turn |
//! | 34 | 6 | destination: the robot that should answer, or is answered |
//! | 40 | 6 | next: initiator of the next turn (the current one if the turn should be renewed) |
//! | 46 | 4 | session of the initiator: scope of the frame number, new at every start |
//! | 50 | 4 | session of the sender (in a forward frame the same) |
//! | 54 | 4 | turn: counts changes and renewals of the initiator |
//! | 58 | 2 | left: slots of this turn after this one |
//! | 60 | 8 | slot number since the initiator's epoch, of the forward frame |
//! | 68 | 4 | length of a round, microseconds |
//! | 72 | 2 | slots of a round |
//! | 74 | 76 | [`Measurement`], if flagged |
//! | .. | 16 | authentication tag, if flagged; over [`authenticated_parts`]: 8 bytes with the group's key, 8 with that of sender and destination |
//!
//! A backward frame repeats number, initiator's session, turn, left, next, slot, round and slots of the forward frame that it
//! answers.

use super::{Error, FCS_LEN, Frame, emit_header, put};
use crate::Mac;

/// First bytes of a native body.
pub const MAGIC: [u8; 3] = *b"csi";
/// Version of this layout.
pub const VERSION: u8 = 1;
/// Bytes without measurement and tag, without FCS.
pub const BASE_LEN: usize = field::MEASUREMENT;
/// Bytes of a measurement.
pub const MEASUREMENT_LEN: usize = 16 + 2 * SUBCARRIERS;
/// Bytes of the authentication tag.
pub const TAG_LEN: usize = 16;
/// Bytes of the longest frame, without FCS.
pub const MAX_LEN: usize = BASE_LEN + MEASUREMENT_LEN + TAG_LEN;
/// Subcarriers that the card reports.
pub const SUBCARRIERS: usize = 30;

/// Offsets in the MPDU.
mod field {
    pub(super) const MAGIC: usize = 28;
    pub(super) const VERSION: usize = 31;
    pub(super) const ROLE: usize = 32;
    pub(super) const FLAGS: usize = 33;
    pub(super) const DESTINATION: usize = 34;
    pub(super) const NEXT: usize = 40;
    pub(super) const SESSION: usize = 46;
    pub(super) const SENDER_SESSION: usize = 50;
    pub(super) const TURN: usize = 54;
    pub(super) const LEFT: usize = 58;
    pub(super) const SLOT: usize = 60;
    pub(super) const ROUND_US: usize = 68;
    pub(super) const SLOTS: usize = 72;
    pub(super) const MEASUREMENT: usize = 74;
}

/// Offsets in a measurement.
mod measured {
    pub(super) const NUMBER: usize = 0;
    pub(super) const TIMESTAMP_LOW: usize = 4;
    pub(super) const RX_ANTENNA: usize = 8;
    pub(super) const ANTENNA_SEL: usize = 9;
    pub(super) const RSSI: usize = 10;
    pub(super) const NOISE_DBM: usize = 13;
    pub(super) const AGC: usize = 14;
    pub(super) const RESERVED: usize = 15;
    pub(super) const IQ: usize = 16;
}

mod flag {
    pub(super) const MEASUREMENT: u8 = 0x01;
    pub(super) const TAG: u8 = 0x02;
    pub(super) const WANTS_TURN: u8 = 0x04;
}

/// Direction of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Role {
    /// From the initiator to the robot that should answer.
    Forward,
    /// The answer.
    Backward,
}

/// One antenna's CSI of a forward frame as its receiver's card measured it: unchanged 8-bit values.
///
/// The measured frame is number `number` of the same initiator's session, not necessarily the frame just answered: the kernel may
/// deliver its CSI too late for that answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Measurement {
    /// Number of the measured forward frame.
    pub number: u32,
    /// The card's 1 MHz clock at reception; wraps every 4,295 s.
    pub timestamp_low: u32,
    /// Receive antenna, 0 to 2 for A to C (after undoing the card's permutation).
    pub rx_antenna: u8,
    /// `antenna_sel` of the record.
    pub antenna_sel: u8,
    /// `rssi_a`, `rssi_b`, `rssi_c` of the record.
    pub rssi: [u8; 3],
    /// Noise, dBm; -127 if unknown.
    pub noise_dbm: i8,
    /// Automatic gain, dB.
    pub agc: u8,
    /// `iq[subcarrier] = [I, Q]`, in the card's order of subcarriers.
    pub iq: [[i8; 2]; SUBCARRIERS],
}

impl Measurement {
    fn parse(bytes: &[u8; MEASUREMENT_LEN]) -> Self {
        let mut iq = [[0; 2]; SUBCARRIERS];
        let (pairs, _) = bytes.split_at(measured::IQ).1.as_chunks::<2>();
        for (value, pair) in iq.iter_mut().zip(pairs) {
            *value = pair.map(u8::cast_signed);
        }
        let [noise_dbm] = array(bytes, measured::NOISE_DBM);
        let [rx_antenna] = array(bytes, measured::RX_ANTENNA);
        let [antenna_sel] = array(bytes, measured::ANTENNA_SEL);
        let [agc] = array(bytes, measured::AGC);
        Self {
            number: u32::from_be_bytes(array(bytes, measured::NUMBER)),
            timestamp_low: u32::from_be_bytes(array(bytes, measured::TIMESTAMP_LOW)),
            rx_antenna,
            antenna_sel,
            rssi: array(bytes, measured::RSSI),
            noise_dbm: noise_dbm.cast_signed(),
            agc,
            iq,
        }
    }

    fn emit(&self, bytes: &mut [u8]) {
        put(bytes, measured::NUMBER, &self.number.to_be_bytes());
        put(bytes, measured::TIMESTAMP_LOW, &self.timestamp_low.to_be_bytes());
        put(bytes, measured::RX_ANTENNA, &[self.rx_antenna, self.antenna_sel]);
        put(bytes, measured::RSSI, &self.rssi);
        put(bytes, measured::NOISE_DBM, &[self.noise_dbm.cast_unsigned(), self.agc]);
        put(bytes, measured::RESERVED, &[0]);
        for (k, value) in self.iq.iter().enumerate() {
            put(bytes, measured::IQ + 2 * k, &value.map(i8::cast_unsigned));
        }
    }
}

/// A native frame as a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Repr {
    /// The sender's own MAC (addr3).
    pub sender: Mac,
    /// Frame number, counted by the initiator.
    pub number: u32,
    /// Forward or backward.
    pub role: Role,
    /// The robot that the frame addresses.
    pub destination: Mac,
    /// Initiator of the next turn.
    pub next: Mac,
    /// The sender requests the turn.
    pub wants_turn: bool,
    /// Session of the initiator.
    pub session: u32,
    /// Session of the sender.
    pub sender_session: u32,
    /// Number of the turn.
    pub turn: u32,
    /// Slots of the turn after this one.
    pub left: u16,
    /// Number of this slot since the initiator's epoch.
    pub slot: u64,
    /// Length of a round, microseconds.
    pub round_us: u32,
    /// Slots of a round.
    pub slots: u16,
    /// The sender's measurement of an earlier frame.
    pub measurement: Option<Measurement>,
    /// Authentication tag.
    pub tag: Option<[u8; TAG_LEN]>,
}

impl Repr {
    /// Bytes to hand to the card, which appends the FCS.
    #[must_use]
    pub const fn mpdu_len(&self) -> usize {
        mpdu_len(self.measurement.is_some(), self.tag.is_some())
    }

    /// Reads a checked frame. The tag is copied, not verified.
    ///
    /// # Errors
    /// [`Error::Magic`] for a frame of another dialect; [`Error::Version`], [`Error::Role`], [`Error::Flags`] or [`Error::Length`] for
    /// a damaged or newer one.
    pub fn parse(frame: &Frame<'_>) -> Result<Self, Error> {
        let bytes = frame.mpdu();
        let head: &[u8; BASE_LEN] = bytes.first_chunk().ok_or(Error::Length { expect: BASE_LEN, got: bytes.len() })?;
        let magic = array(head, field::MAGIC);
        if magic != MAGIC {
            return Err(Error::Magic(magic));
        }
        let ([version], [role], [flags]) =
            (array(head, field::VERSION), array(head, field::ROLE), array(head, field::FLAGS));
        if version != VERSION {
            return Err(Error::Version(version));
        }
        if flags & !(flag::MEASUREMENT | flag::TAG | flag::WANTS_TURN) != 0 {
            return Err(Error::Flags(flags));
        }
        let role = match role {
            0 => Role::Forward,
            1 => Role::Backward,
            other => return Err(Error::Role(other)),
        };
        let (has_measurement, has_tag) = (flags & flag::MEASUREMENT != 0, flags & flag::TAG != 0);
        let expect = mpdu_len(has_measurement, has_tag);
        if bytes.len() != expect {
            return Err(Error::Length { expect, got: bytes.len() });
        }
        let after = bytes.get(BASE_LEN..).unwrap_or(&[]);
        Ok(Self {
            sender: frame.sender(),
            number: frame.number(),
            role,
            destination: Mac(array(head, field::DESTINATION)),
            next: Mac(array(head, field::NEXT)),
            wants_turn: flags & flag::WANTS_TURN != 0,
            session: u32::from_be_bytes(array(head, field::SESSION)),
            sender_session: u32::from_be_bytes(array(head, field::SENDER_SESSION)),
            turn: u32::from_be_bytes(array(head, field::TURN)),
            left: u16::from_be_bytes(array(head, field::LEFT)),
            slot: u64::from_be_bytes(array(head, field::SLOT)),
            round_us: u32::from_be_bytes(array(head, field::ROUND_US)),
            slots: u16::from_be_bytes(array(head, field::SLOTS)),
            measurement: after.first_chunk().filter(|_| has_measurement).map(Measurement::parse),
            tag: after.last_chunk().filter(|_| has_tag).copied(),
        })
    }

    /// Writes the frame at the start of `buffer` and returns its length without FCS.
    ///
    /// # Errors
    /// [`Error::Length`] if it does not fit; [`MAX_LEN`] always does.
    pub fn emit(&self, buffer: &mut [u8]) -> Result<usize, Error> {
        let len = self.mpdu_len();
        let got = buffer.len();
        let frame = buffer.get_mut(..len).ok_or(Error::Length { expect: len, got })?;
        emit_header(frame, self.sender, self.number);
        let role = match self.role {
            Role::Forward => 0,
            Role::Backward => 1,
        };
        let flags = set_if(self.measurement.is_some(), flag::MEASUREMENT)
            | set_if(self.tag.is_some(), flag::TAG)
            | set_if(self.wants_turn, flag::WANTS_TURN);
        put(frame, field::MAGIC, &MAGIC);
        put(frame, field::VERSION, &[VERSION]);
        put(frame, field::ROLE, &[role]);
        put(frame, field::FLAGS, &[flags]);
        put(frame, field::DESTINATION, &self.destination.0);
        put(frame, field::NEXT, &self.next.0);
        put(frame, field::SESSION, &self.session.to_be_bytes());
        put(frame, field::SENDER_SESSION, &self.sender_session.to_be_bytes());
        put(frame, field::TURN, &self.turn.to_be_bytes());
        put(frame, field::LEFT, &self.left.to_be_bytes());
        put(frame, field::SLOT, &self.slot.to_be_bytes());
        put(frame, field::ROUND_US, &self.round_us.to_be_bytes());
        put(frame, field::SLOTS, &self.slots.to_be_bytes());
        if let (Some(measurement), Some(place)) = (&self.measurement, frame.get_mut(field::MEASUREMENT..)) {
            measurement.emit(place);
        }
        if let (Some(tag), Some(place)) = (&self.tag, frame.last_chunk_mut()) {
            *place = *tag;
        }
        Ok(len)
    }
}

/// Length without FCS of a frame with or without its optional parts.
#[must_use]
pub const fn mpdu_len(has_measurement: bool, has_tag: bool) -> usize {
    let measurement = if has_measurement { MEASUREMENT_LEN } else { 0 };
    let tag = if has_tag { TAG_LEN } else { 0 };
    BASE_LEN + measurement + tag
}

/// Length with FCS, as [`mpdu_len`].
#[must_use]
pub const fn len_with_fcs(has_measurement: bool, has_tag: bool) -> usize {
    mpdu_len(has_measurement, has_tag) + FCS_LEN
}

/// The bytes that the tag covers: the addresses, and everything from the number up to the tag.
///
/// Frame control, duration and sequence control are excluded: mac80211 and the card rewrite them.
#[must_use]
pub fn authenticated_parts(mpdu: &[u8]) -> [&[u8]; 2] {
    let addresses = mpdu.get(super::field::ADDR1..super::field::ADDR3 + 6).unwrap_or(&[]);
    let end = mpdu.len().saturating_sub(TAG_LEN);
    [addresses, mpdu.get(super::field::NUMBER..end).unwrap_or(&[])]
}

/// Replaces the tag of an emitted frame whose [`Repr::tag`] was set.
pub fn set_tag(mpdu: &mut [u8], tag: [u8; TAG_LEN]) {
    if let Some(place) = mpdu.last_chunk_mut() {
        *place = tag;
    }
}

fn set_if(condition: bool, bits: u8) -> u8 {
    if condition { bits } else { 0 }
}

fn array<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    bytes.get(at..).and_then(|rest| rest.first_chunk()).copied().unwrap_or([0; N])
}

#[cfg(test)]
#[path = "native_tests.rs"]
mod tests;
