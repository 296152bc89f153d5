//! One robot's side of the exchange: connects air and state machine, in the order of the machine's contract.

use super::figures::Figures;
use super::watch::{Notice, Watch};
use csi5300::exchange::tdma::{Event, Tdma};
use csi5300::internal::FrameReceiver;
use csi5300::source::{Error, Injector};
use csi5300::time::Instant;
use driver_iface::sounding::FCS_LEN;
use driver_iface::sounding::native::Role;

/// News of the exchange.
#[derive(Clone, Debug)]
pub enum News {
    /// The thread runs with this grant.
    Started(super::Granted),
    /// Something happened on the air.
    Event(Event),
    /// Something that the user should know.
    Notice(Notice),
}

/// The machine, the air, and timing figures.
#[derive(Debug)]
pub struct Exchange<A> {
    /// The machine: its plan and counts.
    pub tdma: Tdma,
    /// The interface: its counters.
    pub air: A,
    /// Lateness and turn-around.
    pub figures: Figures,
    watch: Watch,
    /// Number and hand-over of the last forward frame.
    last_forward: Option<(u32, Instant)>,
    stop_at: Option<Instant>,
}

/// The frame being handled: when its reception ended, and its length with FCS.
type FrameEnd = (Instant, usize);

impl<A: Injector + FrameReceiver> Exchange<A> {
    /// A machine on an interface.
    #[must_use]
    pub fn new(tdma: Tdma, air: A) -> Self {
        Self { tdma, air, figures: Figures::new(), watch: Watch::default(), last_forward: None, stop_at: None }
    }

    /// The optional end: from then on nothing is received or sent.
    #[must_use]
    pub fn with_stop_at(mut self, stop_at: Option<Instant>) -> Self {
        self.stop_at = stop_at;
        self
    }

    /// True from the time at which it ends.
    #[must_use]
    pub fn is_over(&self, now: Instant) -> bool {
        self.stop_at.is_some_and(|end| end <= now)
    }

    /// Takes all received frames, sends all due ones, and returns the time of the next step. Does nothing once it [is
    /// over](Self::is_over).
    ///
    /// # Errors
    /// If the interface failed for good. Refused frames are only counted and reported in a [`Notice`].
    pub fn step(&mut self, now: &impl Fn() -> Instant, tell: &mut impl FnMut(News)) -> Result<Option<Instant>, Error> {
        loop {
            // The time is read before the frame's age, so that delays between make answers early, never late.
            let at = now();
            if self.is_over(at) {
                return Ok(None);
            }
            let Some(heard) = self.air.hear()? else { break };
            let ended = at - heard.age;
            let heard_len = heard.frame.len() + FCS_LEN;
            self.tdma.handle_heard(at, ended, heard.frame);
            self.send_due(now, Some((ended, heard_len)), tell)?;
        }
        self.send_due(now, None, tell)?;
        if let Some(notice) = self.watch.look(now(), self.air.sent_for_certain(), self.air.failed_for_certain()) {
            tell(News::Notice(notice));
        }
        Ok([self.tdma.poll_timeout(), self.stop_at].into_iter().flatten().min())
    }

    fn send_due(
        &mut self,
        now: &impl Fn() -> Instant,
        heard: Option<FrameEnd>,
        tell: &mut impl FnMut(News),
    ) -> Result<(), Error> {
        loop {
            let at = now();
            let due = if self.is_over(at) { None } else { self.tdma.poll_transmit(at) };
            let Some(transmit) = due else { break };
            let before = now();
            let (role, number) = (transmit.role, transmit.number);
            self.figures.note_due(&transmit, before);
            // The host may have been busy since the machine returned the frame.
            if before > transmit.latest {
                self.figures.too_late += 1;
                self.tdma.not_sent(role, number);
                continue;
            }
            let taken = self.air.inject(before, transmit.frame);
            if let Err(error) = taken {
                self.tdma.not_sent(role, number);
                let Error::NotSent(why) = error else { return Err(error) };
                self.watch.not_sent(why).map(News::Notice).into_iter().for_each(&mut *tell);
                continue;
            }
            let after = now();
            self.figures.note_sent(&transmit, before, after, heard.map(|(ended, _)| ended));
            self.watch.sent(role, before);
            if role == Role::Forward {
                self.last_forward = Some((number, before));
            }
        }
        while let Some(event) = self.tdma.poll_event() {
            match event {
                Event::Answered { number, .. } => {
                    self.watch.answered();
                    self.note_answer(number, heard);
                }
                Event::Missed { slots, late, slot } => self.figures.note_missed(slots, late, slot),
                _ => {}
            }
            tell(News::Event(event));
        }
        Ok(())
    }

    /// How long after the forward frame's hand-over the answer to it began.
    fn note_answer(&mut self, number: u32, heard: Option<FrameEnd>) {
        let sent = self.last_forward.filter(|(sent, _)| *sent == number);
        if let (Some((_, sent)), Some((ended, len))) = (sent, heard) {
            let airtime_us = i64::from(self.tdma.plan().phy.airtime_us(len));
            self.figures.note_answer_us((ended - sent).as_us() - airtime_us);
        }
    }
}
