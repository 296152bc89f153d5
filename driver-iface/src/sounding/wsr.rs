//! The dialect of the WSR toolbox: a frame's length selects the robot.
//!
//! A forward frame to robot `k` is `n + 2 k` bytes long on air, FCS included (`n` = 57 in WSR's own examples). The driver of robot
//! `k`, loaded with `ack_len` = `n + 2 k`, answers every frame of exactly that length with a copy, one byte longer and with its own
//! MAC in addr3. As the copy includes the 4 bytes of the old FCS and the card appends a new one, the answer is `ack_len + 5` long
//! on air. If `ack_len` is odd, that is even, so no answer is ever answered. Sources: WSR `injection/random_packets.c`; driver
//! `dvm/rx.c`, `check_and_send_ack`.

use super::{Error, FCS_LEN, Frame, MIN_LEN, emit_header, field, put};
use crate::Mac;

/// On-air length of the forward frame to the first robot in WSR's examples.
pub const DEFAULT_LEN: usize = 57;
/// Shortest forward frame, FCS included: header, number and FCS, made odd.
pub const MIN_FORWARD_LEN: usize = MIN_LEN + FCS_LEN + 1;
/// Length of the answer on air minus that of the forward frame: one byte, and the FCS of the copied frame.
pub const REPLY_GROWTH: usize = 1 + FCS_LEN;

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
    pub fn next_byte(&mut self) -> u8 {
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
        self.len_with_fcs.saturating_sub(FCS_LEN)
    }

    /// Writes the frame at the start of `buffer` and returns its length without FCS. Advances `filler`.
    ///
    /// # Errors
    /// [`Error::Length`] if the frame does not fit, or is too short for header and number.
    pub fn emit(&self, buffer: &mut [u8], filler: &mut Lfsr) -> Result<usize, Error> {
        let len = self.mpdu_len();
        if len < MIN_LEN {
            return Err(Error::Length { expect: MIN_LEN, got: len });
        }
        let got = buffer.len();
        let frame = buffer.get_mut(..len).ok_or(Error::Length { expect: len, got })?;
        emit_header(frame, self.sender, self.number);
        filler.fill(frame.get_mut(field::BODY..).unwrap_or(&mut []));
        Ok(len)
    }
}

/// Writes the answer to `forward` as the WSR driver does and returns its length without the new FCS.
///
/// `forward_fcs` are the 4 bytes that followed the forward frame; zeros if the receiver strips them, because nobody reads them.
/// The driver allocates one byte more than the copy and leaves it unset; here it is 0.
///
/// # Errors
/// [`Error::Length`] if the answer does not fit into `buffer`.
#[doc(alias = "check_and_send_ack")]
pub fn emit_reply(
    forward: &Frame<'_>,
    forward_fcs: [u8; FCS_LEN],
    responder: Mac,
    buffer: &mut [u8],
) -> Result<usize, Error> {
    let copied = forward.mpdu();
    let len = copied.len() + REPLY_GROWTH;
    let got = buffer.len();
    let reply = buffer.get_mut(..len).ok_or(Error::Length { expect: len, got })?;
    reply.fill(0);
    put(reply, 0, copied);
    put(reply, copied.len(), &forward_fcs);
    put(reply, field::ADDR3, &responder.0);
    Ok(len)
}

#[cfg(test)]
#[path = "wsr_tests.rs"]
mod tests;
