//! Sounding frames: what robots inject to measure the channel between them, in two dialects.
//!
//! Both are 802.11 data frames outside any network, shaped so that a stock CSI driver reports their CSI and a WSR driver logs their
//! sender and number:
//!
//! | offset | size | value |
//! |---|---|---|
//! | 0 | 2 | frame control, bytes `08 00`: data, no ToDS or FromDS |
//! | 2 | 2 | duration, `ff ff` as written; rewritten by mac80211 or the card |
//! | 4 | 6 | addr1: [`MAGIC_MAC`]; the firmware reports CSI for it, the driver applies `monitor_tx_rate` to it |
//! | 10 | 6 | addr2: [`MAGIC_MAC`]; another sender address gives no CSI at the receiver |
//! | 16 | 6 | addr3: the sender's own MAC, which WSR logs |
//! | 22 | 2 | sequence control, 0 and never filled in by mac80211 |
//! | 24 | 4 | **big-endian** frame number, which WSR logs as `frame_count` |
//! | 28 | .. | [`wsr`]: filler; [`native`]: destination, role, turn, slot, measurement, tag |
//!
//! The card appends 4 bytes of FCS, which no buffer here contains; the WSR lengths include it. Sources: WSR
//! `injection/random_packets.c`, driver `dvm/rx.c` and `dvm/tx.c`; field values of the stock sender from csiread's
//! `sample_0x5_64_3000.dat`.

use crate::mpdu::{FCS, offset};
use crate::{Mac, array, put};

/// addr1 and addr2 of every sounding frame (WSR `random_packets.c`; iwlwifi `dvm/sta.c`, `dvm/tx.c`).
pub const MAGIC_MAC: Mac = Mac([0x00, 0x16, 0xea, 0x12, 0x34, 0x56]);
/// Bytes of the shortest sounding frame: header and number.
pub const MIN_LEN: usize = offset::COUNTER + crate::mpdu::COUNTER;

/// Frame control of a data frame outside any network, little-endian.
const FRAME_CONTROL: [u8; 2] = [0x08, 0x00];
/// Bits of the second frame control byte that make it another kind of frame: ToDS, FromDS, more fragments, protected.
const FLAGS_MUST_BE_CLEAR: u8 = 0x01 | 0x02 | 0x04 | 0x40;

/// A frame with the shape of a sounding frame: data, magic MAC, a number. Checked once, then total.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    bytes: &'a [u8],
}

impl<'a> Frame<'a> {
    /// Checks an MPDU without FCS: `None` if it is too short, no plain data frame, or its addr1 is not [`MAGIC_MAC`].
    #[must_use]
    pub fn new_checked(bytes: &'a [u8]) -> Option<Self> {
        let [kind, flags] = array(bytes, offset::FRAME_CONTROL);
        let is_plain = kind == FRAME_CONTROL[0] && flags & FLAGS_MUST_BE_CLEAR == 0;
        let is_sounding = is_plain && Mac(array(bytes, offset::ADDR1)) == MAGIC_MAC;
        (bytes.len() >= MIN_LEN && is_sounding).then_some(Self { bytes })
    }

    /// addr3: the sender's own MAC.
    #[must_use]
    #[doc(alias = "addr3")]
    pub fn sender(&self) -> Mac {
        Mac(array(self.bytes, offset::ADDR3))
    }

    /// The frame number.
    #[must_use]
    #[doc(alias = "frame_count")]
    pub fn number(&self) -> u32 {
        u32::from_be_bytes(array(self.bytes, offset::COUNTER))
    }

    /// Everything after the number.
    #[must_use]
    pub fn body(&self) -> &'a [u8] {
        self.bytes.get(MIN_LEN..).unwrap_or(&[])
    }

    /// The whole MPDU, without FCS.
    #[must_use]
    pub fn mpdu(&self) -> &'a [u8] {
        self.bytes
    }

    /// MPDU length **with** FCS, as WSR counts it (`byte_count`).
    #[must_use]
    pub fn len_with_fcs(&self) -> usize {
        self.bytes.len() + FCS
    }
}

/// Writes header and number at the start of `buffer` (at least [`MIN_LEN`] long; otherwise writes nothing).
fn emit_header(buffer: &mut [u8], sender: Mac, number: u32) {
    if let Some(header) = buffer.first_chunk_mut::<MIN_LEN>() {
        header.fill(0);
        put(header, offset::FRAME_CONTROL, &FRAME_CONTROL);
        put(header, offset::DURATION, &[0xff, 0xff]);
        put(header, offset::ADDR1, &MAGIC_MAC.0);
        put(header, offset::ADDR2, &MAGIC_MAC.0);
        put(header, offset::ADDR3, &sender.0);
        put(header, offset::COUNTER, &number.to_be_bytes());
    }
}

pub mod native {
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

    use super::{FCS, Frame, emit_header};
    use crate::bfee::SUBCARRIERS;
    use crate::mpdu::offset;
    use crate::{Mac, array, put};

    /// First bytes of a native body.
    pub const MAGIC: [u8; 3] = *b"csi";
    /// Version of this layout.
    pub const VERSION: u8 = 1;
    /// Bytes without measurement and tag, without FCS.
    const BASE_LEN: usize = field::MEASUREMENT;
    /// Bytes of a measurement.
    const MEASUREMENT_LEN: usize = 16 + 2 * SUBCARRIERS;
    /// Bytes of the authentication tag.
    pub const TAG_LEN: usize = 16;
    /// Bytes of the longest frame, without FCS.
    pub const MAX_LEN: usize = BASE_LEN + MEASUREMENT_LEN + TAG_LEN;

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

        /// Reads a checked frame; `None` for one of another dialect, version, role or length, or with unknown flags. The tag is copied,
        /// not verified.
        #[must_use]
        pub fn parse(frame: &Frame<'_>) -> Option<Self> {
            let bytes = frame.mpdu();
            let head: &[u8; BASE_LEN] = bytes.first_chunk()?;
            let ([version], [role], [flags]) =
                (array(head, field::VERSION), array(head, field::ROLE), array(head, field::FLAGS));
            let is_known = flags & !(flag::MEASUREMENT | flag::TAG | flag::WANTS_TURN) == 0;
            if array(head, field::MAGIC) != MAGIC || version != VERSION || !is_known {
                return None;
            }
            let role = match role {
                0 => Role::Forward,
                1 => Role::Backward,
                _ => return None,
            };
            let (has_measurement, has_tag) = (flags & flag::MEASUREMENT != 0, flags & flag::TAG != 0);
            let after = bytes.get(BASE_LEN..).filter(|_| bytes.len() == mpdu_len(has_measurement, has_tag))?;
            Some(Self {
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

        /// Writes the frame at the start of `buffer` and returns its length without FCS; `None` if it does not fit, which it does into
        /// [`MAX_LEN`].
        pub fn emit(&self, buffer: &mut [u8]) -> Option<usize> {
            let len = self.mpdu_len();
            let frame = buffer.get_mut(..len)?;
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
            Some(len)
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
        mpdu_len(has_measurement, has_tag) + FCS
    }

    /// The bytes that the tag covers: the addresses, and everything from the number up to the tag.
    ///
    /// Frame control, duration and sequence control are excluded: mac80211 and the card rewrite them.
    #[must_use]
    pub fn authenticated_parts(mpdu: &[u8]) -> [&[u8]; 2] {
        let addresses = mpdu.get(offset::ADDR1..offset::ADDR3 + 6).unwrap_or(&[]);
        let end = mpdu.len().saturating_sub(TAG_LEN);
        [addresses, mpdu.get(offset::COUNTER..end).unwrap_or(&[])]
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
}

pub mod wsr {
    //! The dialect of the WSR toolbox: a frame's length selects the robot.
    //!
    //! A forward frame to robot `k` is `n + 2 k` bytes long on air, FCS included (`n` = 57 in WSR's own examples). The driver of robot
    //! `k`, loaded with `ack_len` = `n + 2 k`, answers every frame of exactly that length with a copy, one byte longer and with its own
    //! MAC in addr3. As the copy includes the 4 bytes of the old FCS and the card appends a new one, the answer is `ack_len + 5` long
    //! on air. If `ack_len` is odd, that is even, so no answer is ever answered. Sources: WSR `injection/random_packets.c`; driver
    //! `dvm/rx.c`, `check_and_send_ack`.

    use super::{FCS, Frame, MIN_LEN, emit_header};
    use crate::mpdu::offset;
    use crate::{Mac, put};

    /// On-air length of the forward frame to the first robot in WSR's examples.
    pub const DEFAULT_LEN: usize = 57;
    /// Shortest forward frame, FCS included: header, number and FCS, made odd.
    pub const MIN_FORWARD_LEN: usize = MIN_LEN + FCS + 1;
    /// Length of the answer on air minus that of the forward frame: one byte, and the FCS of the copied frame.
    pub const REPLY_GROWTH: usize = 1 + FCS;

    /// On-air length (FCS included) of the forward frame to robot `k` if the first robot's is `first_len`.
    #[must_use]
    #[doc(alias = "ack_len")]
    pub const fn forward_len(first_len: usize, k: usize) -> usize {
        first_len + 2 * k
    }

    /// WSR's filler: a 32-bit linear feedback shift register, 8 shifts per byte, feedback `b31 ^ b29 ^ b25 ^ b24` into bit 0; the low
    /// byte is the output. The number at the head of a payload does not advance it.
    ///
    /// Receivers ignore the filler. With one register for all of a sender's frames in order, frames equal WSR's byte for byte.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct Lfsr {
        state: u32,
    }

    impl Default for Lfsr {
        fn default() -> Self {
            Self { state: 0x1f3d_5b79 }
        }
    }

    impl Lfsr {
        /// The next byte.
        ///
        /// The eight bits shifted in depend only on bits 31 to 17 of the old state, so they are computed at once.
        fn next_byte(&mut self) -> u8 {
            let s = self.state;
            let byte = ((s >> 24) ^ (s >> 22) ^ (s >> 18) ^ (s >> 17)) as u8;
            self.state = (s << 8) | u32::from(byte);
            byte
        }

        /// Fills a slice.
        pub fn fill(&mut self, bytes: &mut [u8]) {
            bytes.iter_mut().for_each(|byte| *byte = self.next_byte());
        }
    }

    /// A forward frame as a value.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct Repr {
        /// The initiator's own MAC (addr3).
        pub sender: Mac,
        /// Frame number; WSR starts at 1. At 0 its driver forgets the sender's MAC.
        pub number: u32,
        /// Length on air, FCS included: addresses the robot.
        pub len_with_fcs: usize,
    }

    impl Repr {
        /// Reads a checked frame.
        #[must_use]
        pub fn parse(frame: &Frame<'_>) -> Self {
            Self { sender: frame.sender(), number: frame.number(), len_with_fcs: frame.len_with_fcs() }
        }

        /// Bytes to hand to the card, which appends the FCS.
        #[must_use]
        pub const fn mpdu_len(&self) -> usize {
            self.len_with_fcs.saturating_sub(FCS)
        }

        /// Writes the frame at the start of `buffer` and returns its length without FCS; `None` if it does not fit, or is too short for
        /// header and number. Advances `filler`.
        pub fn emit(&self, buffer: &mut [u8], filler: &mut Lfsr) -> Option<usize> {
            let len = self.mpdu_len();
            let frame = buffer.get_mut(..len).filter(|_| len >= MIN_LEN)?;
            emit_header(frame, self.sender, self.number);
            filler.fill(frame.get_mut(MIN_LEN..)?);
            Some(len)
        }
    }

    /// Writes the answer to `forward` as the WSR driver does and returns its length without the new FCS; `None` if it does not fit.
    ///
    /// `forward_fcs` are the 4 bytes that followed the forward frame; zeros if the receiver strips them, because nobody reads them.
    /// The driver allocates one byte more than the copy and leaves it unset; here it is 0.
    #[doc(alias = "check_and_send_ack")]
    pub fn emit_reply(forward: &Frame<'_>, forward_fcs: [u8; FCS], responder: Mac, buffer: &mut [u8]) -> Option<usize> {
        let copied = forward.mpdu();
        let len = copied.len() + REPLY_GROWTH;
        let reply = buffer.get_mut(..len)?;
        reply.fill(0);
        put(reply, 0, copied);
        put(reply, copied.len(), &forward_fcs);
        put(reply, offset::ADDR3, &responder.0);
        Some(len)
    }
}

#[cfg(test)]
mod tests {
    mod native {
        use crate::Mac;
        use crate::sounding::native::*;
        use crate::sounding::{Frame, MAGIC_MAC};
        use proptest::prelude::*;

        fn any_measurement() -> impl Strategy<Value = Measurement> {
            let iq = proptest::collection::vec(any::<[i8; 2]>(), crate::bfee::SUBCARRIERS);
            (any::<(u32, u32, u8, u8, [u8; 3], i8, u8)>(), iq).prop_map(|(m, iq)| Measurement {
                number: m.0,
                timestamp_low: m.1,
                rx_antenna: m.2,
                antenna_sel: m.3,
                rssi: m.4,
                noise_dbm: m.5,
                agc: m.6,
                iq: iq.try_into().unwrap(),
            })
        }

        fn any_repr() -> impl Strategy<Value = Repr> {
            let addresses = any::<([u8; 6], [u8; 6], [u8; 6], u32, bool, bool)>();
            let numbers = any::<(u32, u32, u32, u16, u64, u32, u16)>();
            let extras = (proptest::option::of(any_measurement()), any::<Option<[u8; TAG_LEN]>>());
            (addresses, numbers, extras).prop_map(|(a, n, (measurement, tag))| Repr {
                sender: Mac(a.0),
                destination: Mac(a.1),
                next: Mac(a.2),
                number: a.3,
                role: if a.4 { Role::Forward } else { Role::Backward },
                wants_turn: a.5,
                session: n.0,
                sender_session: n.1,
                turn: n.2,
                left: n.3,
                slot: n.4,
                round_us: n.5,
                slots: n.6,
                measurement,
                tag,
            })
        }

        fn plain() -> Repr {
            Repr {
                sender: Mac([2, 0, 0, 0, 0, 1]),
                number: 0x0102_0304,
                role: Role::Forward,
                destination: Mac([2, 0, 0, 0, 0, 2]),
                next: Mac([2, 0, 0, 0, 0, 3]),
                wants_turn: true,
                session: 5,
                sender_session: 5,
                turn: 6,
                left: 7,
                slot: 8,
                round_us: 10_000,
                slots: 12,
                measurement: None,
                tag: None,
            }
        }

        #[test]
        fn a_native_frame_keeps_what_csi_and_wsr_logs_need() {
            let mut buffer = [0; MAX_LEN];
            let len = plain().emit(&mut buffer).unwrap();
            assert_eq!(len, 74);
            assert_eq!(buffer[4..10], MAGIC_MAC.0);
            assert_eq!(buffer[10..16], MAGIC_MAC.0);
            assert_eq!(buffer[16..22], [2, 0, 0, 0, 0, 1]);
            assert_eq!(buffer[24..28], [1, 2, 3, 4]);
            assert_eq!(buffer[28..34], [b'c', b's', b'i', 1, 0, 4]);
            assert_eq!(buffer[58..74], [0, 7, 0, 0, 0, 0, 0, 0, 0, 8, 0, 0, 0x27, 0x10, 0, 12]);
        }

        #[test]
        fn a_damaged_frame_is_refused() {
            let mut buffer = [0; MAX_LEN];
            let len = plain().emit(&mut buffer).unwrap();
            let parse = |bytes: &[u8]| Repr::parse(&Frame::new_checked(bytes).unwrap());
            assert_eq!(parse(&buffer[..len]), Some(plain()));
            assert_eq!([parse(&buffer[..len - 1]), parse(&buffer[..len + 1])], [None; 2]);
            // Magic, version, role, an unknown flag, flags of longer frames.
            for (at, value) in [(28, b'x'), (31, 2), (32, 2), (33, 8), (33, 3)] {
                let mut damaged = buffer;
                damaged[at] = value;
                assert_eq!(parse(&damaged[..len]), None, "{at}");
            }
        }

        #[test]
        fn the_tag_covers_all_but_what_the_card_rewrites() {
            let mut buffer = [0; MAX_LEN];
            let len = Repr { tag: Some([0; TAG_LEN]), ..plain() }.emit(&mut buffer).unwrap();
            set_tag(&mut buffer[..len], [9; TAG_LEN]);
            let frame = &buffer[..len];
            assert_eq!(Repr::parse(&Frame::new_checked(frame).unwrap()).unwrap().tag, Some([9; TAG_LEN]));
            let [addresses, rest] = authenticated_parts(frame);
            assert_eq!(addresses, &frame[4..22]);
            assert_eq!(rest, &frame[24..74]);
            assert_eq!(authenticated_parts(&[]), [&[] as &[u8]; 2]);
        }

        proptest! {
            #[test]
            fn emit_then_parse_is_the_identity(repr in any_repr()) {
                let mut buffer = [0xee; MAX_LEN];
                let len = repr.emit(&mut buffer).unwrap();
                prop_assert_eq!(len, repr.mpdu_len());
                let frame = Frame::new_checked(&buffer[..len]).unwrap();
                let extras = (repr.measurement.is_some(), repr.tag.is_some());
                prop_assert_eq!(frame.len_with_fcs(), len_with_fcs(extras.0, extras.1));
                prop_assert_eq!(len == MAX_LEN, extras == (true, true));
                prop_assert_eq!(Repr::parse(&frame), Some(repr));
            }

            #[test]
            fn foreign_bytes_never_panic(repr in any_repr(), cut in 0usize..200, at in 0usize..200, value: u8) {
                let mut buffer = [0; MAX_LEN + 40];
                repr.emit(&mut buffer).unwrap();
                if let Some(byte) = buffer.get_mut(at) {
                    *byte = value;
                }
                if let Some(frame) = Frame::new_checked(&buffer[..cut]) {
                    let _ = Repr::parse(&frame);
                }
            }
        }

        #[test]
        fn only_plain_data_frames_are_sounding_frames() {
            let repr = plain();
            let mut bytes = [0; MAX_LEN];
            let len = repr.emit(&mut bytes).unwrap();
            // ToDS, FromDS, more fragments, protected; a frame may have the other bits: retry, power, more data, order.
            for (bit, refused) in
                [(0, true), (1, true), (2, true), (3, false), (4, false), (5, false), (6, true), (7, false)]
            {
                let mut frame = bytes;
                frame[1] |= 1 << bit;
                assert_eq!(Frame::new_checked(&frame[..len]).is_none(), refused, "bit {bit}");
            }
        }
    }

    mod wsr {
        use crate::Mac;
        use crate::mpdu::FCS;
        use crate::sounding::wsr::*;
        use crate::sounding::{Frame, MAGIC_MAC};
        use proptest::prelude::*;

        /// The register as WSR writes it, one shift at a time.
        fn slow_byte(state: &mut u32) -> u8 {
            for _ in 0..8 {
                let bit = (*state >> 31 ^ *state >> 29 ^ *state >> 25 ^ *state >> 24) & 1;
                *state = *state << 1 | bit;
            }
            *state as u8
        }

        #[test]
        fn filler_equals_the_bitwise_register_and_the_bytes_on_air() {
            let (mut fast, mut slow) = (Lfsr::default(), 0x1f3d_5b79);
            // First payload bytes of frames 1 to 3 of csiread's sample_0x5_64_3000.dat (100 payload bytes each, no number).
            let on_air: [[u8; 6]; 3] = [
                [0x32, 0x33, 0x54, 0x48, 0x6f, 0x81],
                [0x7c, 0x5d, 0x0f, 0xb6, 0xb4, 0xed],
                [0x67, 0xcb, 0x81, 0x10, 0xef, 0xc5],
            ];
            for expect in on_air {
                let mut window = [0; 100];
                fast.fill(&mut window);
                assert_eq!(window[..6], expect);
                assert!(window.iter().all(|byte| *byte == slow_byte(&mut slow)));
            }
        }

        #[test]
        fn the_header_equals_the_stock_senders_except_addr3_and_duration() {
            // Header of frame 1 of sample_0x5_64_3000.dat; the card rewrote the duration to 48 us.
            let on_air = [
                0x08, 0x00, 0x30, 0x00, 0x00, 0x16, 0xea, 0x12, 0x34, 0x56, 0x00, 0x16, 0xea, 0x12, 0x34, 0x56, 0xff,
                0xff, 0xff, 0xff, 0xff, 0xff, 0x00, 0x00,
            ];
            let mut buffer = [0; 64];
            let repr = Repr { sender: Mac([0xff; 6]), number: 1, len_with_fcs: 57 };
            assert_eq!(repr.emit(&mut buffer, &mut Lfsr::default()), Some(53));
            assert_eq!(buffer[..2], on_air[..2]);
            assert_eq!(buffer[2..4], [0xff, 0xff]);
            assert_eq!(buffer[4..24], on_air[4..]);
            assert_eq!(buffer[24..34], [0, 0, 0, 1, 0x32, 0x33, 0x54, 0x48, 0x6f, 0x81]);
        }

        #[test]
        fn the_counter_stays_true_and_the_filler_runs_on_beyond_68_966_frames() {
            let (mut filler, mut slow) = (Lfsr::default(), 0x1f3d_5b79);
            let mut buffer = [0; 64];
            for number in 1..=150_000u32 {
                let repr = Repr { sender: Mac([2; 6]), number, len_with_fcs: 57 };
                let len = repr.emit(&mut buffer, &mut filler).unwrap();
                let frame = Frame::new_checked(&buffer[..len]).unwrap();
                assert_eq!(Repr::parse(&frame), repr);
                assert_eq!(frame.body(), &buffer[28..len]);
                assert!(frame.body().iter().all(|byte| *byte == slow_byte(&mut slow)));
            }
        }

        #[test]
        fn an_answer_is_the_forward_frame_grown_by_five_with_the_responders_mac() {
            let mut buffer = [0; 64];
            let len = Repr { sender: Mac([2; 6]), number: 9, len_with_fcs: 59 }
                .emit(&mut buffer, &mut Lfsr::default())
                .unwrap();
            let forward = Frame::new_checked(&buffer[..len]).unwrap();
            let mut reply = [0xee; 64];
            let reply_len = emit_reply(&forward, [1, 2, 3, 4], Mac([7; 6]), &mut reply).unwrap();
            let answer = Frame::new_checked(&reply[..reply_len]).unwrap();
            assert_eq!(answer.len_with_fcs(), 64); // driver-interface: 62, 64, 66 for 57, 59, 61
            assert_eq!((answer.sender(), answer.number()), (Mac([7; 6]), 9));
            assert_eq!(answer.mpdu()[..16], buffer[..16]);
            assert_eq!(answer.mpdu()[22..55], buffer[22..55]);
            assert_eq!(reply[55..60], [1, 2, 3, 4, 0]);
            assert_eq!(answer.mpdu()[10..16], MAGIC_MAC.0);
            assert_eq!(emit_reply(&forward, [0; 4], Mac([7; 6]), &mut [0; 59]), None);
        }

        #[test]
        fn a_frame_to_each_robot_is_two_bytes_longer_than_to_the_one_before() {
            assert_eq!([0, 1, 2, 5].map(|k| forward_len(DEFAULT_LEN, k)), [57, 59, 61, 67]);
            // The shortest one is the shortest odd length with room for its number.
            let emitted = |len_with_fcs| {
                let repr = Repr { sender: Mac([2; 6]), number: 1, len_with_fcs };
                repr.emit(&mut [0; 64], &mut Lfsr::default()).map(|len| len + FCS)
            };
            assert_eq!((MIN_FORWARD_LEN % 2, emitted(MIN_FORWARD_LEN)), (1, Some(MIN_FORWARD_LEN)));
            assert_eq!(emitted(MIN_FORWARD_LEN - 2), None);
        }

        #[test]
        fn no_answer_is_ever_answered() {
            for first in (MIN_FORWARD_LEN..200).step_by(2) {
                for (a, b) in (0..40).flat_map(|a| (0..40).map(move |b| (a, b))) {
                    assert_ne!(forward_len(first, a) + REPLY_GROWTH, forward_len(first, b));
                }
            }
        }

        #[test]
        fn frames_too_short_or_not_ours_are_refused() {
            let mut buffer = [0; 64];
            let short = Repr { sender: Mac([2; 6]), number: 1, len_with_fcs: 31 };
            assert_eq!(short.emit(&mut buffer, &mut Lfsr::default()), None);
            let len = Repr { len_with_fcs: 57, ..short }.emit(&mut buffer, &mut Lfsr::default()).unwrap();
            assert!(Frame::new_checked(&buffer[..27]).is_none());
            let mut other = buffer;
            other[0] = 0x80;
            assert!(Frame::new_checked(&other[..len]).is_none());
            other = buffer;
            other[9] = 0x57;
            assert!(Frame::new_checked(&other[..len]).is_none());
        }

        proptest! {
            #[test]
            fn emit_then_parse_is_the_identity(sender: [u8; 6], number: u32, len_with_fcs in 32usize..300) {
                let repr = Repr { sender: Mac(sender), number, len_with_fcs };
                let mut buffer = [0; 300];
                let len = repr.emit(&mut buffer, &mut Lfsr::default()).unwrap();
                prop_assert_eq!(Repr::parse(&Frame::new_checked(&buffer[..len]).unwrap()), repr);
            }
        }
    }
}
