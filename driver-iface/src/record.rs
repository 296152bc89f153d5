//! Records and the `.dat` log: for each message of the driver a big-endian u16 length, then that many bytes, a code and a body
//! (`log_to_file.c`). No file header, no time stamps, no trailer.
//!
//! [`Framer`] walks such a stream, distinguishes records from damage, and resynchronises.

mod framer;
mod head;

pub use framer::{Framer, LOOKAHEAD, Step, Tail, events};
pub use head::Reason;

use crate::{EmitError, room};

/// Message codes, the first byte of every connector message (`dvm/connector.h`, csitool `iwl_structs.h`).
pub mod code {
    /// CSI of one frame ([`crate::bfee`]).
    pub const BFEE: u8 = 0xBB;
    /// PHY part of a reception; not sent by the 4.15 driver.
    pub const RX_PHY: u8 = 0xC0;
    /// A received frame ([`crate::mpdu`]), sent before its own bfee.
    pub const MPDU: u8 = 0xC1;
    /// Legacy reception; not sent by the 4.15 driver.
    pub const RX: u8 = 0xC3;
    /// Noise floor, i32 dBm.
    pub const NOISE: u8 = 0xD0;
    /// Status (4.15) or an iperf filter (older trees).
    pub const STATUS: u8 = 0xD1;
    /// Parallel packets (older trees).
    pub const PARALLEL: u8 = 0xD2;
    /// Transmission result; not sent by the 4.15 driver.
    pub const TX_RESP: u8 = 0x1C;
    /// Aggregation block, two u32; not sent by the 4.15 driver.
    pub const TX_BLOCK_AGG: u8 = 0xC5;

    /// For logs translated from another card: how far its clock is past the microsecond of the following bfee, u32 picoseconds. No
    /// driver sends it.
    pub const CARD_CLOCK: u8 = 0xCC;
    /// For other cards: bytes of the log without a bfee. Their offset and number, u64 each, then the reason as text.
    pub const LEFT_OUT: u8 = 0xCD;

    /// Codes and their names, in the order of the driver's header, followed by those of translated logs.
    pub const TABLE: [(u8, &str); 11] = [
        (BFEE, "bfee"),
        (RX_PHY, "rx_phy"),
        (MPDU, "mpdu"),
        (RX, "rx"),
        (NOISE, "noise"),
        (TX_RESP, "tx_resp"),
        (TX_BLOCK_AGG, "tx_block_agg"),
        (STATUS, "status"),
        (PARALLEL, "parallel"),
        (CARD_CLOCK, "card_clock"),
        (LEFT_OUT, "left_out"),
    ];

    /// The name of a code, if it has one.
    #[must_use]
    pub fn name(code: u8) -> Option<&'static str> {
        TABLE.iter().find(|(known, _)| *known == code).map(|(_, name)| *name)
    }
}

/// Bytes of the length field.
pub const LENGTH_FIELD: usize = 2;

/// Largest length field that a driver writes: an A-MSDU in the card's 8 KiB receive buffer.
///
/// The field could hold 65,535; such lengths are common in damaged logs and unknown in intact ones.
pub const MAX_LENGTH: usize = 8192;

/// One record: a code and its body (without the code).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record<'a> {
    /// Message code, see [`code`]: 0xBB bfee, 0xC1 MPDU, others kept and counted.
    pub code: u8,
    /// The body, after the code byte.
    pub body: &'a [u8],
}

impl<'a> Record<'a> {
    /// Splits a datagram's message (code and body); `None` if it is empty.
    #[must_use]
    pub fn from_message(message: &'a [u8]) -> Option<Self> {
        let (&code, body) = message.split_first()?;
        Some(Self { code, body })
    }

    /// Value of the length field: code and body.
    #[must_use]
    pub fn length(&self) -> usize {
        1 + self.body.len()
    }

    /// Bytes in a `.dat` log, length field included.
    #[must_use]
    pub fn emit_len(&self) -> usize {
        LENGTH_FIELD + self.length()
    }

    /// Writes the record as in a `.dat` log: length, code, body. Returns [`Record::emit_len`].
    ///
    /// # Errors
    /// If the body does not fit the length field (65,534 bytes) or `out` is too short.
    pub fn emit(&self, out: &mut [u8]) -> Result<usize, EmitError> {
        let length = u16::try_from(self.length()).map_err(|_| EmitError::Field {
            name: "length",
            got: self.length(),
            max: u16::MAX.into(),
        })?;
        let out = room(out, self.emit_len())?;
        let (head, body) = out.split_at_mut(LENGTH_FIELD + 1);
        let [high, low] = length.to_be_bytes();
        head.copy_from_slice(&[high, low, self.code]);
        body.copy_from_slice(self.body);
        Ok(self.emit_len())
    }
}

/// The content of a [`code::CARD_CLOCK`]'s body, picoseconds.
#[must_use]
pub fn card_clock_ps(body: &[u8]) -> Option<u32> {
    body.try_into().ok().map(u32::from_le_bytes)
}

/// The content of a [`code::LEFT_OUT`]'s body: offset and number of the bytes, and the reason.
#[must_use]
pub fn left_out(body: &[u8]) -> Option<(u64, u64, &str)> {
    let (offset, rest) = body.split_first_chunk()?;
    let (len, why) = rest.split_first_chunk()?;
    Some((u64::from_le_bytes(*offset), u64::from_le_bytes(*len), core::str::from_utf8(why).ok()?))
}

/// The complete records of an intact stream, each with its length field; a cut one at the end is dropped.
pub fn written(bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut rest = bytes;
    core::iter::from_fn(move || {
        let length = usize::from(u16::from_be_bytes(*rest.first_chunk::<LENGTH_FIELD>()?));
        let (record, behind) = rest.split_at_checked(LENGTH_FIELD + length)?;
        rest = behind;
        Some(record)
    })
}

/// Bytes and number of the complete records in the first `upto` bytes of an intact stream: where to cut a write that stopped
/// there.
#[must_use]
pub fn whole_records(bytes: &[u8], upto: usize) -> (usize, usize) {
    let whole = written(bytes.get(..upto).unwrap_or(bytes));
    whole.fold((0, 0), |(at, records), record| (at + record.len(), records + 1))
}

#[cfg(test)]
mod damage_tests;
#[cfg(test)]
mod tests;
