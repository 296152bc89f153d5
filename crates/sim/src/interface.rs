//! One robot's monitor interface: injected frames, and frames that the robot's card decodes.

use super::air::Air;
use super::node::{Flight, Passed};
use super::port::{inject, lock};
use super::room_error::CardError;
use csi5300::internal::{FrameReceiver, HeardFrame};
use csi5300::source::{Error, Injector};
use csi5300::time::{Instant, Span};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

/// A robot's monitor interface in a room, the counterpart of `csi5300_live::monitor::Monitor`.
///
/// It hears everything up to the room's time, which cards, odometries, injectors and [`super::Room::advance`] move
/// forward. A sender of the room's own on the same robot continues beside it.
#[derive(Debug)]
pub struct Interface {
    air: Arc<Mutex<Air>>,
    robot: usize,
    current: Option<Arc<Flight>>,
    went_out: u64,
    retried: u64,
}

/// A frame that passed the interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Seen<'a> {
    /// The frame, without FCS.
    pub frame: &'a [u8],
    /// Modulation and coding scheme, 0 to 7.
    pub mcs: u8,
    /// How long ago it ended on air.
    pub age: Span,
    /// This robot sent it: the card reports it as sent.
    pub own: bool,
    /// How often the card sent it again.
    pub retries: u8,
}

impl Interface {
    /// `None` if it is taken.
    pub(super) fn new(air: Arc<Mutex<Air>>, robot: usize) -> Option<Self> {
        let mut guard = lock(&air);
        let passed = &mut guard.node(robot).passed;
        if passed.is_some() {
            return None;
        }
        *passed = Some(VecDeque::new());
        drop(guard);
        Some(Self { air, robot, current: None, went_out: 0, retried: 0 })
    }

    /// The next frame that passed, own ones too; `None` if there is none yet.
    pub fn see(&mut self) -> Option<Seen<'_>> {
        let mut air = lock(&self.air);
        let Passed { flight, own } = air.node(self.robot).passed.as_mut()?.pop_front()?;
        let age = Span::from_us((air.now_ns() - flight.end_ns).max(0) / 1_000);
        drop(air);
        self.went_out += u64::from(own);
        self.retried += u64::from(own && flight.retries > 0);
        let flight = self.current.insert(flight);
        Some(Seen { frame: flight.bytes.without_fcs(), mcs: flight.mcs, age, own, retries: flight.retries })
    }

    /// As [`Injector::inject`], at a modulation and coding scheme of one stream, 0 to 7, other than the scene's.
    ///
    /// # Errors
    /// [`Error::Backend`] with [`CardError::Mcs`] for another scheme, [`CardError::FrameLength`] for a frame too short or too
    /// long.
    pub fn inject_at(&mut self, now: Instant, frame: &[u8], mcs: u8) -> Result<(), Error> {
        if mcs > 7 {
            return Err(CardError::Mcs { mcs }.into());
        }
        inject(&self.air, self.robot, now, frame, Some(mcs))
    }

    /// Own frames that the card reports as sent more than once.
    #[must_use]
    pub fn retried(&self) -> u64 {
        self.retried
    }

    /// Frames that passed and were lost because they were not fetched.
    #[must_use]
    pub fn lost(&self) -> u64 {
        lock(&self.air).node(self.robot).passed_lost
    }
}

impl Drop for Interface {
    fn drop(&mut self) {
        lock(&self.air).node(self.robot).passed = None;
    }
}

impl Injector for Interface {
    fn inject(&mut self, now: Instant, frame: &[u8]) -> Result<(), Error> {
        inject(&self.air, self.robot, now, frame, None)
    }
}

impl FrameReceiver for Interface {
    fn hear(&mut self) -> Result<Option<HeardFrame<'_>>, Error> {
        loop {
            match self.see().map(|seen| (seen.own, seen.age)) {
                None => return Ok(None),
                Some((true, _)) => {}
                Some((false, age)) => {
                    let frame = self.current.as_ref().map(|flight| flight.bytes.without_fcs());
                    return Ok(frame.map(|frame| HeardFrame { frame, age }));
                }
            }
        }
    }

    fn sent_for_certain(&self) -> Option<u64> {
        Some(self.went_out)
    }

    fn failed_for_certain(&self) -> u64 {
        0
    }
}
