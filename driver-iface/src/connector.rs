//! The kernel connector: transports a record from the driver to user space.
//!
//! A datagram of `NETLINK_CONNECTOR` holds an `nlmsghdr` (16 bytes), then one or more `cn_msg` (20 bytes and data). The driver
//! sends one message per record; its data is code and body. The kernel pads the datagram to 4 bytes, a user-space sender does
//! not: the record ends at `cn_msg.len`, not at the datagram's end.
//!
//! Fields are in host order, which is little-endian wherever the driver runs (`linux/netlink.h`, `linux/connector.h`).

use byteorder::{ByteOrder, LittleEndian};
use core::fmt;

use crate::record::Record;
use crate::{EmitError, array, room};

/// Protocol of the connector.
pub const NETLINK_CONNECTOR: u16 = 11;
/// `nlmsg_type` of connector messages.
pub const NLMSG_DONE: u16 = 3;
/// Bytes of `struct nlmsghdr`.
pub const NLMSGHDR: usize = 16;
/// Bytes of `struct cn_msg` before its data.
pub const CN_MSG: usize = 20;
/// Bytes before code and body of a datagram's first record.
pub(crate) const HEADERS: usize = NLMSGHDR + CN_MSG;
/// Longest datagram: headers and the largest u16 length, padded.
pub const MAX_DATAGRAM: usize = HEADERS + 65_536;

/// `CN_NETLINK_USERS` + 0xf of kernels from about 3.10 on (11 users): all in use today.
pub const CN_IDX: u32 = 26;
/// The same for kernels of about 2.6.39 to 3.9 (10 users), including csitool's own 3.5.7 tree.
pub const CN_IDX_10_USERS: u32 = 25;
/// `CN_VAL_IWLAGN`.
pub const CN_VAL: u32 = 1;
/// The name under which the driver registers, the first column of `/proc/net/connector`.
pub(crate) const CN_NAME: &str = "iwlagn";

/// Offsets in a datagram.
pub(crate) mod offset {
    /// u16.
    pub(crate) const NLMSG_TYPE: usize = 4;
    /// u32.
    pub(crate) const CN_IDX: usize = 16;
    /// u32.
    pub(crate) const CN_VAL: usize = 20;
    /// u16, bytes of data.
    pub(crate) const CN_LEN: usize = 32;
}

/// Why a datagram, or the rest of it, cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error {
    /// Shorter than its headers.
    Short {
        /// Bytes that the headers need.
        need: usize,
        /// Bytes received.
        got: usize,
    },
    /// `nlmsg_len` is less than the headers, or more than was received.
    MessageLength {
        /// The field.
        nlmsg_len: usize,
        /// Bytes received.
        received: usize,
    },
    /// `nlmsg_type` is not [`NLMSG_DONE`].
    MessageType {
        /// The field.
        got: u16,
    },
    /// `cn_msg.len` reaches beyond the netlink message.
    DataLength {
        /// The field.
        len: usize,
        /// Bytes left in the message after the header.
        left: usize,
    },
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Short { need, got } => write!(f, "datagram of {got} bytes, its headers need {need}"),
            Self::MessageLength { nlmsg_len, received } => {
                write!(f, "nlmsg_len says {nlmsg_len} bytes, {received} were received (at least {HEADERS} are needed)")
            }
            Self::MessageType { got } => write!(f, "nlmsg_type is {got}, the connector uses {NLMSG_DONE}"),
            Self::DataLength { len, left } => {
                write!(f, "cn_msg.len says {len} bytes, the netlink message has {left} left")
            }
        }
    }
}

impl core::error::Error for Error {}

/// One `cn_msg`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message<'a> {
    /// Connector index; for the driver [`CN_IDX`] or an older one.
    pub idx: u32,
    /// Connector value; [`CN_VAL`] for the driver.
    pub val: u32,
    /// The message's data: code and body, without padding.
    pub data: &'a [u8],
}

impl<'a> Message<'a> {
    /// The record in it, if it comes from the driver registered at one of these indices; `None` for foreign or empty messages.
    #[must_use]
    pub fn record(&self, indices: &[u32]) -> Option<Record<'a>> {
        Record::from_message(self.data).filter(|_| self.val == CN_VAL && indices.contains(&self.idx))
    }
}

/// The `cn_msg` of a datagram, which end after an error. The driver sends one per datagram; several are valid.
#[derive(Clone, Debug)]
pub struct Messages<'a> {
    rest: &'a [u8],
}

impl<'a> Messages<'a> {
    /// Checks the netlink header of one `recv`'s bytes, with or without padding.
    ///
    /// # Errors
    /// If it is too short, has another type than the connector's, or is shorter than `nlmsg_len`.
    pub fn new_checked(datagram: &'a [u8]) -> Result<Self, Error> {
        let received = datagram.len();
        let head = datagram.first_chunk::<NLMSGHDR>().ok_or(Error::Short { need: HEADERS, got: received })?;
        let nlmsg_len = LittleEndian::read_u32(head) as usize;
        let rest = datagram.get(NLMSGHDR..nlmsg_len).filter(|messages| messages.len() >= CN_MSG);
        let rest = rest.ok_or(Error::MessageLength { nlmsg_len, received })?;
        let got = LittleEndian::read_u16(&head[offset::NLMSG_TYPE..]);
        if got == NLMSG_DONE { Ok(Self { rest }) } else { Err(Error::MessageType { got }) }
    }
}

impl<'a> Iterator for Messages<'a> {
    type Item = Result<Message<'a>, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        let rest = core::mem::take(&mut self.rest);
        let Some((head, data)) = rest.split_first_chunk::<CN_MSG>() else {
            return Some(Err(Error::Short { need: CN_MSG, got: rest.len() }));
        };
        let [idx, val] = [offset::CN_IDX, offset::CN_VAL].map(|at| u32::from_le_bytes(array(head, at - NLMSGHDR)));
        let len = usize::from(LittleEndian::read_u16(&head[offset::CN_LEN - NLMSGHDR..]));
        let Some((data, rest)) = data.split_at_checked(len) else {
            return Some(Err(Error::DataLength { len, left: data.len() }));
        };
        self.rest = rest;
        Some(Ok(Message { idx, val, data }))
    }
}

/// The fields of a datagram around a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Repr<'a> {
    /// Connector index.
    pub idx: u32,
    /// Connector value.
    pub val: u32,
    /// The record.
    pub record: Record<'a>,
    /// Pad to 4 bytes, as the kernel does.
    pub padded: bool,
}

impl Repr<'_> {
    /// `nlmsg_len`: the bytes without padding.
    fn message_len(&self) -> usize {
        HEADERS + self.record.length()
    }

    /// Bytes of the datagram.
    #[must_use]
    pub fn emit_len(&self) -> usize {
        if self.padded { self.message_len().next_multiple_of(4) } else { self.message_len() }
    }

    /// Writes a datagram with one message. Returns [`Repr::emit_len`].
    ///
    /// # Errors
    /// If the record does not fit `cn_msg.len` (65,535 bytes) or `out` is too short.
    pub fn emit(&self, out: &mut [u8]) -> Result<usize, EmitError> {
        let got = self.record.length();
        let max = usize::from(u16::MAX);
        let len = u16::try_from(got).map_err(|_| EmitError::Field { name: "cn_msg.len", got, max })?;
        let out = room(out, self.emit_len())?;
        out.fill(0);
        let (head, data) = out.split_at_mut(HEADERS);
        LittleEndian::write_u32(head, self.message_len() as u32);
        LittleEndian::write_u16(&mut head[offset::NLMSG_TYPE..], NLMSG_DONE);
        LittleEndian::write_u32(&mut head[offset::CN_IDX..], self.idx);
        LittleEndian::write_u32(&mut head[offset::CN_VAL..], self.val);
        LittleEndian::write_u16(&mut head[offset::CN_LEN..], len);
        for (to, from) in data.iter_mut().zip(core::iter::once(&self.record.code).chain(self.record.body)) {
            *to = *from;
        }
        Ok(self.emit_len())
    }
}

/// The connector index under which the driver is registered, from the text of `/proc/net/connector`.
///
/// Each line there is a name and `idx:val`; the driver's name is `iwlagn`.
#[must_use]
pub fn registered_idx(proc_net_connector: &str) -> Option<u32> {
    proc_net_connector.lines().find_map(|line| {
        let mut words = line.split_whitespace();
        let (name, id) = (words.next()?, words.next()?);
        let (idx, val) = id.split_once(':')?;
        (name == CN_NAME && val.parse() == Ok(CN_VAL)).then(|| idx.parse().ok()).flatten()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::collection::vec;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    /// Written by hand from the table: a padded datagram with a three-byte record and leftovers in ack and flags.
    fn sample() -> Vec<u8> {
        let mut bytes = vec![39, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0, 7, 0, 0, 0];
        bytes.extend([26, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0xde, 0xad, 0xbe, 0xef, 3, 0, 0xff, 0xff]);
        bytes.extend([0xBB, 1, 2, 0]);
        bytes
    }

    #[test]
    fn the_record_is_cut_at_cn_msg_len() {
        let bytes = sample();
        for received in [&bytes[..40], &bytes[..39]] {
            let messages: Vec<_> = Messages::new_checked(received).unwrap().collect();
            assert_eq!(messages, [Ok(Message { idx: 26, val: 1, data: &[0xBB, 1, 2] })]);
            let message = messages[0].unwrap();
            assert_eq!(message.record(&[CN_IDX_10_USERS, CN_IDX]), Some(Record { code: 0xBB, body: &[1, 2] }));
            assert_eq!(message.record(&[CN_IDX_10_USERS]), None);
            assert_eq!(Message { val: 2, ..message }.record(&[CN_IDX]), None);
            assert_eq!(Message { data: &[], ..message }.record(&[CN_IDX]), None);
        }
    }

    #[test]
    fn several_messages_in_one_datagram() {
        let mut bytes = sample();
        bytes.truncate(39);
        bytes.extend_from_within(16..39);
        bytes[39] = 25;
        bytes[0] = 62;
        let idx: Vec<_> = Messages::new_checked(&bytes).unwrap().map(|m| m.unwrap().idx).collect();
        assert_eq!(idx, [26, 25]);
    }

    #[test]
    fn wrong_lengths_are_refused() {
        let bytes = sample();
        let error = |bytes: &[u8]| Messages::new_checked(bytes).unwrap_err();
        assert_eq!(error(&bytes[..15]), Error::Short { need: 36, got: 15 });
        assert_eq!(error(&bytes[..38]), Error::MessageLength { nlmsg_len: 39, received: 38 });
        let with = |at: usize, value: u8| {
            let mut bytes = bytes.clone();
            bytes[at] = value;
            bytes
        };
        assert_eq!(error(&with(0, 35)), Error::MessageLength { nlmsg_len: 35, received: 40 });
        assert_eq!(error(&with(4, 2)), Error::MessageType { got: 2 });
        let mut messages = Messages::new_checked(&bytes).unwrap();
        assert!(messages.next().unwrap().is_ok() && messages.next().is_none());
        let long = with(32, 4);
        let mut messages = Messages::new_checked(&long).unwrap();
        assert_eq!(messages.next(), Some(Err(Error::DataLength { len: 4, left: 3 })));
        assert_eq!(messages.next(), None);
        let rest = with(32, 2);
        let mut messages = Messages::new_checked(&rest).unwrap();
        assert!(messages.next().unwrap().is_ok());
        assert_eq!(messages.next(), Some(Err(Error::Short { need: 20, got: 1 })));
        assert_eq!(messages.next(), None);
    }

    #[test]
    fn a_3x1_bfee_arrives_as_252_bytes() {
        let body = [0; 212];
        let repr = Repr { idx: CN_IDX, val: CN_VAL, record: Record { code: 0xBB, body: &body }, padded: true };
        assert_eq!((repr.message_len(), repr.emit_len()), (249, 252));
    }

    #[test]
    fn the_longest_record_makes_the_longest_datagram() {
        let body = vec![7; usize::from(u16::MAX) - 1];
        let repr = Repr { idx: CN_IDX, val: CN_VAL, record: Record { code: 0xBB, body: &body }, padded: true };
        let mut out = vec![0; MAX_DATAGRAM];
        assert_eq!(repr.emit(&mut out), Ok(MAX_DATAGRAM));
    }

    #[test]
    fn index_of_the_loaded_driver() {
        let text = "Name            ID\ncn_proc         1:1\niwlagn          26:1\n";
        assert_eq!(registered_idx(text), Some(26));
        assert_eq!(registered_idx("Name            ID\ncn_proc         1:1\n"), None);
        assert_eq!(registered_idx("iwlagn          25:1"), Some(25));
    }

    proptest! {
        #[test]
        fn emit_then_parse_is_the_identity(
            idx in any::<u32>(), val in any::<u32>(), code in any::<u8>(), body in vec(any::<u8>(), 0..700),
            padded in any::<bool>(),
        ) {
            let record = Record { code, body: &body };
            let repr = Repr { idx, val, record, padded };
            let mut out = vec![0xa5; repr.emit_len()];
            prop_assert_eq!(repr.emit(&mut out), Ok(out.len()));
            let message = Messages::new_checked(&out).unwrap().next().unwrap().unwrap();
            prop_assert_eq!((message.idx, message.val, Record::from_message(message.data)), (idx, val, Some(record)));
        }
    }
}
