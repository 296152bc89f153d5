//! Frames as the air brings them, beside the records that a card makes of them.

use super::Error;

/// A frame heard: the 802.11 frame without radiotap header and FCS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeardFrame<'a> {
    /// The frame.
    pub frame: &'a [u8],
    /// How long ago its reception ended, if known.
    pub age: crate::time::Span,
}

/// Something that hears frames from the air. It never blocks.
pub trait FrameReceiver {
    /// The next frame, or `None` if there is none yet.
    ///
    /// # Errors
    /// Only for fatal failures; damage is counted and skipped.
    fn hear(&mut self) -> Result<Option<HeardFrame<'_>>, Error>;

    /// Frames confirmed as sent, if the source can tell.
    fn sent_for_certain(&self) -> Option<u64>;

    /// Frames that failed to be sent.
    fn failed_for_certain(&self) -> u64;
}
