//! The 0xC1 record: a received frame, from the 802.11 header on.
//!
//! In monitor mode the frame ends with its frame check sequence (FCS); in client and access point mode the card removes it
//! ([`Repr`] is a frame with FCS, [`Header`] the view of any frame). A record does not show which is the case: if no
//! frame of a log ends with its own FCS, none has one.
//!
//! The driver sends it before it checks the FCS, so damaged frames appear, too, and before the 0xBB of the same frame. A 0xBB
//! belongs to the 0xC1 just before it; counting records does not find the right one.

use byteorder::{BigEndian, ByteOrder, LittleEndian};

use crate::{EmitError, Mac, array, checksum, room};

/// Bytes of an 802.11 data header with three addresses (802.11-2016 9.2.4).
pub const HEADER: usize = 24;
/// Bytes of the frame check sequence.
pub const FCS: usize = 4;
/// Bytes of the sounding counter that follows the header in frames of the WSR injector.
pub const COUNTER: usize = 4;

/// Offsets in the frame.
pub(crate) mod offset {
    /// u16, little-endian.
    pub(crate) const FRAME_CONTROL: usize = 0;
    /// u16, little-endian, microseconds.
    pub(crate) const DURATION: usize = 2;
    /// 6 bytes: receiver.
    pub(crate) const ADDR1: usize = 4;
    /// 6 bytes: transmitter.
    pub(crate) const ADDR2: usize = 10;
    /// 6 bytes: BSSID, or the sounding robot's own address.
    pub(crate) const ADDR3: usize = 16;
    /// u16, little-endian.
    pub(crate) const SEQ_CTRL: usize = 22;
    /// u32, **big-endian**: the sounding counter.
    pub(crate) const COUNTER: usize = 24;
}

/// A checked view of the header of a frame of any type, with or without an FCS at the end.
///
/// Fields that the frame's type does not have are `None`: an ACK or CTS has one address, other control frames two (802.11-2016
/// 9.3.1).
#[derive(Clone, Copy, Debug)]
pub struct Header<'a> {
    frame: &'a [u8],
    control: u16,
}

impl<'a> Header<'a> {
    /// Bytes of the shortest header, an ACK's: frame control, duration, address 1.
    pub const SHORTEST: usize = offset::ADDR2;

    /// Checks the body of a 0xC1 record; `None` for fewer than 10 bytes.
    #[must_use]
    pub fn new_checked(frame: &'a [u8]) -> Option<Self> {
        frame.get(..Self::SHORTEST).map(|control| Self { frame, control: LittleEndian::read_u16(control) })
    }

    /// For a control frame, whether it has a single address; otherwise `None`.
    fn control_kind(&self) -> Option<bool> {
        (self.control >> 2 & 3 == 1).then_some(matches!(self.control >> 4 & 15, 12 | 13))
    }

    fn mac_at(&self, at: usize) -> Option<Mac> {
        self.frame.get(at..)?.first_chunk().copied().map(Mac)
    }

    /// Frame control: version, type, subtype and flags.
    #[must_use]
    pub fn frame_control(&self) -> u16 {
        self.control
    }

    /// Duration field, microseconds.
    #[must_use]
    pub fn duration_us(&self) -> u16 {
        self.frame.get(offset::DURATION..).map_or(0, LittleEndian::read_u16)
    }

    /// Address 1, the receiver.
    #[must_use]
    pub fn addr1(&self) -> Mac {
        self.mac_at(offset::ADDR1).unwrap_or_default()
    }

    /// Address 2, the transmitter.
    #[must_use]
    pub fn addr2(&self) -> Option<Mac> {
        self.mac_at(offset::ADDR2).filter(|_| self.control_kind() != Some(true))
    }

    /// Address 3: BSSID, or the sounding robot's own address.
    #[must_use]
    pub fn addr3(&self) -> Option<Mac> {
        self.mac_at(offset::ADDR3).filter(|_| self.control_kind().is_none())
    }

    /// Sequence control.
    #[must_use]
    pub fn seq_ctrl(&self) -> Option<u16> {
        let bytes = self.frame.get(offset::SEQ_CTRL..HEADER).filter(|_| self.control_kind().is_none())?;
        Some(LittleEndian::read_u16(bytes))
    }
}

/// True if a frame of any type ends with its own FCS.
#[must_use]
pub fn fcs_is_good(frame: &[u8]) -> bool {
    frame.split_last_chunk::<FCS>().is_some_and(|(bytes, fcs)| crc32(bytes) == u32::from_le_bytes(*fcs))
}

/// CRC-32 of the frame check sequence (802.11-2016 9.2.4.8): reflected 0x04C11DB7, with all ones before and after.
#[must_use]
pub fn crc32(bytes: &[u8]) -> u32 {
    checksum::of(&CRC_TABLES, bytes)
}

static CRC_TABLES: checksum::Tables = checksum::tables(0xEDB8_8320);

/// A frame with a three-address header and an FCS, as a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Repr<'a> {
    /// Frame control: version, type, subtype and flags; 0x0008 for plain data.
    pub frame_control: u16,
    /// Duration field, microseconds.
    pub duration_us: u16,
    /// Receiver.
    pub addr1: Mac,
    /// Transmitter.
    pub addr2: Mac,
    /// Address 3; the robot's own address in sounding frames.
    pub addr3: Mac,
    /// Sequence control.
    pub seq_ctrl: u16,
    /// The bytes between header and FCS.
    pub payload: &'a [u8],
}

impl<'a> Repr<'a> {
    /// The fields of the body of a 0xC1 record; [`fcs_is_good`] says whether they are right. `None` for fewer than 28 bytes.
    #[must_use]
    pub fn parse(frame: &'a [u8]) -> Option<Self> {
        let (head, rest) = frame.split_first_chunk::<HEADER>()?;
        let (payload, _) = rest.split_last_chunk::<FCS>()?;
        let [addr1, addr2, addr3] = [offset::ADDR1, offset::ADDR2, offset::ADDR3].map(|at| Mac(array(head, at)));
        Some(Self {
            frame_control: LittleEndian::read_u16(head),
            duration_us: LittleEndian::read_u16(&head[offset::DURATION..]),
            addr1,
            addr2,
            addr3,
            seq_ctrl: LittleEndian::read_u16(&head[offset::SEQ_CTRL..]),
            payload,
        })
    }

    /// The sounding counter, the first four bytes of the payload, big-endian; `None` if there are fewer.
    #[must_use]
    #[doc(alias = "frame_count")]
    pub fn sounding_counter(&self) -> Option<u32> {
        self.payload.get(..COUNTER).map(BigEndian::read_u32)
    }

    /// Bytes of the frame, including the FCS.
    #[must_use]
    pub fn emit_len(&self) -> usize {
        HEADER + self.payload.len() + FCS
    }

    /// Writes the frame with a correct FCS: the body of a 0xC1 record. Returns [`Repr::emit_len`].
    ///
    /// # Errors
    /// If `out` is too short.
    pub fn emit(&self, out: &mut [u8]) -> Result<usize, EmitError> {
        let out = room(out, self.emit_len())?;
        let (frame, fcs) = out.split_at_mut(HEADER + self.payload.len());
        let (head, payload) = frame.split_at_mut(HEADER);
        let fields = self.frame_control.to_le_bytes().into_iter().chain(self.duration_us.to_le_bytes());
        let fields = fields.chain(self.addr1.0).chain(self.addr2.0).chain(self.addr3.0);
        for (byte, field) in head.iter_mut().zip(fields.chain(self.seq_ctrl.to_le_bytes())) {
            *byte = field;
        }
        payload.copy_from_slice(self.payload);
        LittleEndian::write_u32(fcs, crc32(frame));
        Ok(self.emit_len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::collection::vec;
    use proptest::prelude::*;
    use std::vec;

    #[test]
    fn crc_of_the_check_string() {
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
    }

    #[test]
    fn fields_lie_where_the_format_says() {
        let frame: std::vec::Vec<u8> = (0..36).collect();
        let mpdu = Repr::parse(&frame).unwrap();
        assert_eq!((mpdu.frame_control, mpdu.duration_us, mpdu.seq_ctrl), (0x0100, 0x0302, 0x1716));
        assert_eq!(mpdu.addr1, Mac([4, 5, 6, 7, 8, 9]));
        assert_eq!(mpdu.addr2, Mac([10, 11, 12, 13, 14, 15]));
        assert_eq!(mpdu.addr3, Mac([16, 17, 18, 19, 20, 21]));
        assert_eq!((mpdu.sounding_counter(), mpdu.payload), (Some(0x1819_1a1b), &frame[24..32]));
        assert!(!fcs_is_good(&frame));
        assert_eq!(Repr::parse(&frame[..27]), None);
        assert_eq!(Repr::parse(&frame[..31]).unwrap().sounding_counter(), None);
    }

    #[test]
    fn a_header_has_the_addresses_of_its_type() {
        let frame =
            |control: u16, len: u8| -> std::vec::Vec<u8> { control.to_le_bytes().into_iter().chain(2..len).collect() };
        let [one, two, three] = [4, 10, 16].map(|from: u8| Mac(core::array::from_fn(|k| from + k as u8)));
        for (control, len, addr2, addr3, seq_ctrl) in [
            (0x00d4, 14, None, None, None),
            (0x00c4, 14, None, None, None),
            (0x00b4, 20, Some(two), None, None),
            (0x0094, 32, Some(two), None, None),
            (0x0948, 24, Some(two), Some(three), Some(0x1716)),
            (0x0188, 26, Some(two), Some(three), Some(0x1716)),
            (0x0008, 15, None, None, None),
        ] {
            let bytes = frame(control, len);
            let header = Header::new_checked(&bytes).unwrap();
            assert_eq!((header.frame_control(), header.duration_us(), header.addr1()), (control, 0x0302, one));
            assert_eq!((header.addr2(), header.addr3(), header.seq_ctrl()), (addr2, addr3, seq_ctrl), "{control:#06x}");
        }
        assert!(Header::new_checked(&[0; 9]).is_none());
    }

    proptest! {
        #[test]
        fn emit_then_parse_is_the_identity(
            fields in any::<(u16, u16, u16)>(), addrs in any::<([u8; 6], [u8; 6], [u8; 6])>(),
            payload in vec(any::<u8>(), 0..80), flip in any::<prop::sample::Index>(), bit in 0..8_u8,
        ) {
            let repr = Repr {
                frame_control: fields.0, duration_us: fields.1, seq_ctrl: fields.2,
                addr1: Mac(addrs.0), addr2: Mac(addrs.1), addr3: Mac(addrs.2), payload: &payload,
            };
            let mut frame = vec![0; repr.emit_len()];
            prop_assert_eq!(repr.emit(&mut frame), Ok(frame.len()));
            prop_assert!(fcs_is_good(&frame));
            prop_assert_eq!(Repr::parse(&frame), Some(repr));
            let mut damaged = frame.clone();
            damaged[flip.index(frame.len())] ^= 1 << bit;
            prop_assert!(!fcs_is_good(&damaged));
        }
    }
}
