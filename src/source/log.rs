//! A log, frame by frame: all that most readers need.

use super::replay::Replay;
use super::survey::{CardClock, Identity, Survey};
use super::{CsiSource as _, Error, Next, Origin};
use crate::signal::csi::{Csi, ScaleError, scale_factor};
use crate::time::Instant;
use driver_iface::Mac;
use driver_iface::bfee::{Bfee, NOISE_UNKNOWN_DBM};
use driver_iface::record::Tail;
use std::io::Read;
use std::path::Path;

/// A recorded log, read in chunks: an iterator over its frames with CSI.
///
/// What was damaged or is missing is no error; it is counted in [`Log::survey`], to be asked during the loop or after it.
/// Host times come from the log's side file if there is one (`.datstp`), else from the records where the driver
/// writes them (WSR layout). Senders and frame numbers come from the record (WSR layout) or from the frame that the
/// driver logged before it (stock layout with connector_log 5).
///
/// ```
/// use csi5300::Log;
///
/// let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/small-circle/csi_rx_2023-11-14_221320.dat");
/// let mut log = Log::open(path)?;
/// let mut frames = 0;
/// for frame in &mut log {
///     let frame = frame?;
///     let h = frame.csi.get(0, 0, 0).expect("each frame has a first subcarrier, row and stream");
///     assert!(h.norm() < 182.0 && frame.mac.is_some());
///     frames += 1;
/// }
/// assert_eq!(frames, log.survey().bfees());
/// assert!(!log.survey().lost_something());
/// # Ok::<(), csi5300::source::Error>(())
/// ```
pub struct Log {
    replay: Replay<Box<dyn Read + Send>>,
    survey: Survey,
    clock: CardClock,
    failed: bool,
}

/// One received frame: its channel, and what the card and the host say of its reception.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Frame {
    /// The channel, `h[subcarrier][rx][tx]` in the card's integers: 30 subcarriers, `n_rx` antennas, `n_tx` streams.
    ///
    /// Rows are antennas from A on; where the record does not say which antenna is which ([`Csi::antenna`] is `None`),
    /// they are receive chains.
    pub csi: Csi,
    /// Factor from the card's integers to sqrt(SNR), the channel's gain over the noise; see [`scale_factor`].
    pub scale: Result<f64, ScaleError>,
    /// The sender, if it is known.
    pub mac: Option<Mac>,
    /// The number that the sender gave the frame, if it is known.
    pub number: Option<u32>,
    /// The card's clock at reception, microseconds from an arbitrary origin, unwrapped along the log.
    pub card_us: i64,
    /// The host's wall clock at reception, microseconds since the Unix epoch, if it is known.
    pub host_us: Option<i64>,
    /// Signal strength at antennas A, B, C, dB above an internal reference; 0 where nothing was heard.
    pub rssi: [u8; 3],
    /// The receiver's gain, dB.
    pub agc: u8,
    /// Noise floor, dBm, where the driver measured one.
    pub noise_dbm: Option<i8>,
    /// Rate and format of the frame, as the driver has them (`rate_n_flags`).
    pub rate_n_flags: u16,
    /// The card's count of frames with CSI, wrapping: a gap is a record that was lost before the log.
    pub bfee_count: u16,
    /// Bytes of the log before the record.
    pub offset: u64,
}

impl Log {
    /// Opens a log; `-` is standard input.
    ///
    /// # Errors
    /// If it cannot be opened, or is a directory.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, Error> {
        let replay = Replay::open(path.as_ref())?;
        Ok(Self { replay, survey: Survey::default(), clock: CardClock::default(), failed: false })
    }

    /// What was read so far: records by kind, senders, losses with their places.
    #[must_use]
    pub fn survey(&self) -> &Survey {
        &self.survey
    }

    /// How the log ended, once it did.
    #[must_use]
    pub fn tail(&self) -> Option<Tail> {
        self.survey.tail
    }

    /// Bytes read so far: the size of the log once it ended.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.replay.bytes()
    }

    /// The next frame; `None` at the end of the log.
    fn next_frame(&mut self) -> Result<Option<Frame>, Error> {
        loop {
            let next = self.replay.receive(Instant::ZERO)?;
            let origin = match &next {
                Next::Record(stamps, _) => stamps.origin,
                Next::End(_) | Next::Pending => {
                    self.survey.note(&next);
                    return Ok(None);
                }
                Next::Lost(_) => Origin::default(),
            };
            let Some((bfee, identity)) = self.survey.note(&next) else { continue };
            let (card_us, _) = self.clock.note(bfee.timestamp_low(), identity.host_us);
            return Ok(Some(Frame::new(&bfee, identity, card_us, origin)));
        }
    }
}

impl Iterator for Log {
    type Item = Result<Frame, Error>;

    /// The next frame, or why the file could not be read further; nothing comes after that.
    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let next = self.next_frame().transpose();
        self.failed = matches!(next, Some(Err(_)));
        next
    }
}

impl Frame {
    fn new(bfee: &Bfee<'_>, identity: Identity, card_us: i64, origin: Origin) -> Self {
        Self {
            csi: Csi::from_bfee(bfee).unwrap_or_else(|_| Csi::raw(bfee)),
            scale: scale_factor(bfee),
            mac: Some(identity.mac).filter(|mac| !mac.is_zero()),
            number: identity.frame_count,
            card_us,
            host_us: identity.host_us,
            rssi: bfee.rssi(),
            agc: bfee.agc(),
            noise_dbm: Some(bfee.noise_dbm()).filter(|noise| *noise != NOISE_UNKNOWN_DBM),
            rate_n_flags: bfee.rate_n_flags(),
            bfee_count: bfee.bfee_count(),
            offset: origin.position(),
        }
    }
}
