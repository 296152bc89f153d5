//! Reads one log: records in, frames of interest out, everything else counted.

use super::LogReport;
use super::options::Options;
use crate::exchange::pairing::by_clock::Refusal;
use crate::exchange::tdma::{Key, Proof, Prover};
use crate::signal::cfo::Heard;
use crate::signal::channel::SUBCARRIERS;
use crate::source::survey::Survey;
use crate::source::{CsiSource, Error, Next};
use crate::time::Instant;
use driver_iface::record::{Record, card_clock_ps, code};
use driver_iface::sounding::native::Measurement;
use driver_iface::{
    Mac,
    bfee::{Antenna, Bfee, Iq},
};
use num_complex::Complex32;
use std::collections::VecDeque;

/// One frame at one antenna: about a hundred bytes, so that many can wait for their partners.
#[derive(Clone, Copy, Debug)]
pub struct FrameHeard {
    /// Frame number.
    pub number: u32,
    /// Card clock, microseconds, wrapping.
    pub timestamp_low: u32,
    /// Host time, microseconds since the Unix epoch.
    pub host_us: Option<i64>,
    /// Running number among the frames of its sender in this log, from 0.
    pub row: u32,
    /// Picoseconds of the card's clock past that microsecond, if it is finer than one.
    pub left_ps: u32,
    /// What is known about the frame itself.
    pub proof: Proof,
    iq: [Iq; SUBCARRIERS],
}

impl FrameHeard {
    /// What `antenna` heard of a frame, if the record has it.
    #[must_use]
    pub fn of(bfee: &Bfee<'_>, antenna: Antenna, number: u32, host_us: Option<i64>, row: u32) -> Option<Self> {
        let iq = bfee.column(bfee.chain_of(antenna)?, 0)?;
        let timestamp_low = bfee.timestamp_low();
        Some(Self { number, timestamp_low, host_us, row, left_ps: 0, proof: Proof::Unknown, iq })
    }

    /// A forward frame as measured by the robot that answered it.
    #[must_use]
    pub(crate) fn measured(measurement: &Measurement, row: u32) -> Self {
        let iq = measurement.iq.map(|[i, q]| Iq { i, q });
        let Measurement { number, timestamp_low, .. } = *measurement;
        Self { number, timestamp_low, host_us: None, row, left_ps: 0, proof: Proof::Unknown, iq }
    }

    /// The same with another number, and another running number in its log.
    pub(super) fn with_number(self, number: u32, row: u32) -> Self {
        Self { number, row, ..self }
    }

    /// As raw pairs `[I, Q]` by reported subcarrier.
    #[must_use]
    pub fn iq(&self) -> [[i8; 2]; SUBCARRIERS] {
        self.iq.map(|iq| [iq.i, iq.q])
    }

    /// As it is, by reported subcarrier.
    pub(crate) fn heard(&self) -> &Heard {
        &self.iq
    }

    /// The CSI, unscaled, by reported subcarrier.
    #[must_use]
    pub fn csi(&self) -> [Complex32; SUBCARRIERS] {
        self.iq.map(|iq| Complex32::new(f32::from(iq.i), f32::from(iq.q)))
    }
}

/// Intact bfee records that the pipeline could not use, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct UnusedRecords {
    /// No frame number: a stock record without an MPDU before it, or an unknown sender.
    pub no_number: u64,
    /// The record lacks the requested antenna, or its place is unknown.
    pub no_antenna: u64,
    /// From another sender.
    pub other_sender: u64,
    /// With a key: the measured frame has no valid tag.
    pub unauthenticated: u64,
}

/// The part of each record that the pipeline uses: one antenna of frames with a number. Everything is counted.
#[derive(Debug)]
pub struct Front {
    antenna: Antenna,
    /// The counts.
    pub log: LogReport,
    prover: Prover,
    /// The clock's fraction for the next bfee, from the record before it.
    left_ps: u32,
}

impl Front {
    /// A front that decodes only `antenna`.
    #[must_use]
    pub fn new(antenna: Antenna) -> Self {
        Self { antenna, log: LogReport::default(), prover: Prover::default(), left_ps: 0 }
    }

    /// The same, with reserved places for these senders: strangers compete for the others (see [`Survey::with_known`]).
    #[must_use]
    pub fn with_known(mut self, known: impl IntoIterator<Item = Mac>) -> Self {
        self.log.survey = Survey::with_known(known);
        self
    }

    /// The same; if frames come with the records, only those with a tag of this key are used.
    #[must_use]
    pub fn with_key(mut self, key: Option<Key>) -> Self {
        self.prover = Prover::new(key);
        self
    }

    /// Notes an item of a source, and returns its frame with its sender.
    pub fn note(&mut self, next: &Next<'_>) -> Option<(Mac, FrameHeard)> {
        let (mac, heard, is_numbered) = self.note_any(next)?;
        self.log.unused.no_number += u64::from(!is_numbered);
        is_numbered.then_some((mac, heard))
    }

    /// The same for frames without a number too, which get 0; the last value is true if it has one.
    pub fn note_any(&mut self, next: &Next<'_>) -> Option<(Mac, FrameHeard, bool)> {
        let proof = self.prover.note(next);
        if let Next::Record(_, Record { code: code::CARD_CLOCK, body }) = next {
            self.left_ps = card_clock_ps(body).unwrap_or(0);
        }
        let (bfee, identity) = self.log.survey.note(next)?;
        let left_ps = std::mem::take(&mut self.left_ps);
        let Some(number) = identity.frame_count else {
            let heard = FrameHeard::of(&bfee, self.antenna, 0, identity.host_us, 0);
            let heard = heard.filter(|_| proof != Proof::Wrong);
            self.log.unused.no_number += u64::from(heard.is_none());
            return heard.map(|heard| (identity.mac, FrameHeard { proof, left_ps, ..heard }, false));
        };
        let row = self.log.survey.senders.get(&identity.mac).map_or(0, |sender| sender.numbered.saturating_sub(1));
        let heard = FrameHeard::of(&bfee, self.antenna, number, identity.host_us, row);
        self.log.unused.no_antenna += u64::from(heard.is_none());
        if proof == Proof::Wrong {
            self.log.unused.unauthenticated += 1;
            return None;
        }
        self.log.unchecked += u64::from(proof == Proof::Unknown && self.prover.has_key() && heard.is_some());
        heard.map(|heard| (identity.mac, FrameHeard { proof, left_ps, ..heard }, true))
    }
}

/// Limit of kept frames of a log without numbers: three quarters of an hour at 100 a second.
const MOST_UNNUMBERED: usize = 1 << 18;

/// A log being read.
pub(crate) struct LogReader<'a> {
    source: &'a mut (dyn CsiSource + Send),
    /// Counts and used frames.
    pub front: Front,
    queue: VecDeque<(Mac, FrameHeard)>,
    /// Frames without a number, until one has one.
    unnumbered: Vec<(Mac, FrameHeard)>,
    has_numbers: bool,
    /// Why its frames could not be numbered.
    pub refused: Option<Refusal>,
    now: Instant,
    ended: bool,
}

impl<'a> LogReader<'a> {
    /// A log from `source` that decodes only `antenna`; `known` are named senders.
    pub(crate) fn new(
        source: &'a mut (dyn CsiSource + Send),
        options: &Options,
        known: impl IntoIterator<Item = Mac>,
    ) -> Self {
        let front = Front::new(options.antenna).with_known(known).with_key(options.key.clone());
        let (queue, unnumbered) = (VecDeque::new(), Vec::new());
        let now = Instant::ZERO;
        Self { source, front, queue, unnumbered, has_numbers: false, refused: None, now, ended: false }
    }

    /// Reads ahead until `limit` frames wait or the log ends, and returns those that wait.
    ///
    /// # Errors
    /// If the source fails.
    pub(crate) fn read_ahead(&mut self, limit: usize) -> Result<&VecDeque<(Mac, FrameHeard)>, Error> {
        while self.queue.len() < limit && !self.ended {
            self.pull()?;
        }
        Ok(&self.queue)
    }

    /// The frames that wait.
    pub(crate) fn ahead(&self) -> &VecDeque<(Mac, FrameHeard)> {
        &self.queue
    }

    /// As [`Self::read_ahead`], and removes those frames.
    ///
    /// # Errors
    /// If the source fails.
    pub(crate) fn take_ahead(&mut self, limit: usize) -> Result<VecDeque<(Mac, FrameHeard)>, Error> {
        self.read_ahead(limit)?;
        Ok(std::mem::take(&mut self.queue))
    }

    /// The frames of a completely read log without numbers; none for other logs.
    pub(crate) fn take_unnumbered(&mut self) -> Vec<(Mac, FrameHeard)> {
        let of_use = self.ended && !self.has_numbers;
        std::mem::take(&mut self.unnumbered).into_iter().filter(|_| of_use).collect()
    }

    /// Puts back frames that now have a number, to be read like others.
    pub(crate) fn put_numbered(&mut self, frames: Vec<(Mac, FrameHeard)>) {
        let unused = &mut self.front.log.unused;
        unused.no_number = unused.no_number.saturating_sub(frames.len() as u64);
        self.queue.extend(frames);
    }

    /// The next frame in the log, or `None` at its end.
    ///
    /// # Errors
    /// If the source fails.
    pub(crate) fn next_frame(&mut self) -> Result<Option<(Mac, FrameHeard)>, Error> {
        self.read_ahead(1)?;
        Ok(self.queue.pop_front())
    }

    /// True once everything was read and given out.
    #[must_use]
    pub(crate) fn is_done(&self) -> bool {
        self.ended && self.queue.is_empty()
    }

    fn pull(&mut self) -> Result<(), Error> {
        let next = self.source.receive(self.now)?;
        match self.front.note_any(&next) {
            Some((mac, heard, true)) => {
                self.queue.push_back((mac, heard));
                self.has_numbers = true;
                self.unnumbered.clear();
            }
            Some((mac, heard, false)) => {
                self.front.log.unused.no_number += 1;
                if !self.has_numbers && self.unnumbered.len() < MOST_UNNUMBERED {
                    self.unnumbered.push((mac, heard));
                }
            }
            None => {}
        }
        match next {
            Next::End(_) => self.ended = true,
            Next::Pending => match self.source.next_at() {
                Some(at) => self.now = at.max(self.now),
                None => return Err(Error::Endless),
            },
            Next::Record(..) | Next::Lost(_) => {}
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Stamps;
    use driver_iface::bfee::{Repr, Wsr};

    const SENDER: Mac = Mac([2; 6]);

    /// A record of the WSR driver, after these copies of frames.
    fn note(front: &mut Front, copies: &[&[u8]], frame_count: u32) -> Option<(Mac, FrameHeard)> {
        let wsr = Wsr { mac: SENDER, frame_count: Some(frame_count), ..Wsr::default() };
        let repr = Repr { wsr: Some(wsr), n_rx: 2, timestamp_low: 10 * frame_count, ..Repr::default() };
        let mut body = vec![0; repr.body_len()];
        let iq: Vec<Iq> = (0..repr.samples()).map(|k| Iq { i: k as i8, q: -(k as i8) }).collect();
        repr.emit(&iq, &mut body).unwrap();
        for copy in copies {
            assert!(front.note(&Next::Record(Stamps::default(), Record { code: code::MPDU, body: copy })).is_none());
        }
        front.note(&Next::Record(Stamps::default(), Record { code: code::BFEE, body: &body }))
    }

    #[test]
    fn a_frame_keeps_its_number_clock_row_and_samples() {
        let mut front = Front::new(Antenna::A);
        for (row, number) in [7, 9, 12].into_iter().enumerate() {
            let (sender, heard) = note(&mut front, &[], number).unwrap();
            assert_eq!((sender, heard.number, heard.timestamp_low), (SENDER, number, 10 * number));
            assert_eq!((heard.row as usize, heard.proof), (row, Proof::Unknown));
            assert_eq!(heard.iq()[29], [58, -58]);
            assert_eq!(heard.csi()[3], Complex32::new(6.0, -6.0));
            assert_eq!(heard.heard()[4], Iq { i: 8, q: -8 });
        }
        assert_eq!((front.log.unused, front.log.unchecked), (UnusedRecords::default(), 0), "there is no key");
    }

    #[test]
    fn with_a_key_wrong_frames_are_skipped_and_unchecked_records_counted() {
        let mut front = Front::new(Antenna::A).with_key(Some(Key::new([7; 16])));
        assert!(note(&mut front, &[], 1).is_some());
        assert_eq!((front.log.unchecked, front.log.unused.unauthenticated), (1, 0));
        for wrong in 1..4 {
            assert!(note(&mut front, &[&[0; 60]], 1).is_none());
            assert_eq!((front.log.unchecked, front.log.unused.unauthenticated), (1, wrong));
        }
        let right = crate::exchange::tdma::auth::tests::recorded(&Key::new([7; 16]));
        let (_, heard) = note(&mut front, &[&right], 1).unwrap();
        assert_eq!((heard.proof, front.log.unchecked, front.log.unused.unauthenticated), (Proof::Good, 1, 3));
        let mut open = Front::new(Antenna::A);
        assert!(note(&mut open, &[&[0; 60]], 1).is_some(), "nothing is checked without a key");
        assert_eq!((open.log.unchecked, open.log.unused.unauthenticated), (0, 0));
    }

    /// A card that has nothing yet, until the time that it names; then it is over.
    struct Late(Option<Instant>, Vec<Instant>);

    impl CsiSource for Late {
        fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
            self.1.push(now);
            let is_over = self.0.is_some_and(|at| now >= at);
            Ok(if is_over { Next::End(driver_iface::record::Tail::Clean) } else { Next::Pending })
        }

        fn next_at(&self) -> Option<Instant> {
            self.0
        }
    }

    #[test]
    fn a_source_is_asked_again_when_it_says_and_one_that_never_does_is_refused() {
        let options = Options::new("108".parse().unwrap());
        let at = Instant::from_us(7_000);
        let mut late = Late(Some(at), Vec::new());
        let mut reader = LogReader::new(&mut late, &options, []);
        assert!(!reader.is_done());
        assert!(reader.next_frame().unwrap().is_none() && reader.is_done());
        assert!(reader.read_ahead(5).unwrap().is_empty());
        assert_eq!(late.1, [Instant::ZERO, at]);
        let mut never = Late(None, Vec::new());
        assert!(matches!(LogReader::new(&mut never, &options, []).next_frame(), Err(Error::Endless)));
    }

    /// A card that has heard these frames.
    struct Heard(Vec<Vec<u8>>, usize);

    impl CsiSource for Heard {
        fn receive(&mut self, _: Instant) -> Result<Next<'_>, Error> {
            self.1 += 1;
            let body = self.0.get(self.1 - 1);
            Ok(body.map_or(Next::End(driver_iface::record::Tail::Clean), |body| {
                Next::Record(Stamps::default(), Record { code: code::BFEE, body })
            }))
        }

        fn next_at(&self) -> Option<Instant> {
            None
        }
    }

    #[test]
    fn the_requested_number_of_frames_is_read_ahead_without_losses() {
        let body = |frame_count| {
            let repr = Repr {
                wsr: Some(Wsr { mac: SENDER, frame_count: Some(frame_count), ..Wsr::default() }),
                ..Repr::default()
            };
            let mut body = vec![0; repr.body_len()];
            repr.emit(&vec![Iq::default(); repr.samples()], &mut body).unwrap();
            body
        };
        let mut card = Heard((1..=6).map(body).collect(), 0);
        let mut reader = LogReader::new(&mut card, &Options::new("108".parse().unwrap()), []);
        let numbers = |frames: &VecDeque<(Mac, FrameHeard)>| frames.iter().map(|(_, f)| f.number).collect::<Vec<_>>();
        assert_eq!(numbers(reader.read_ahead(2).unwrap()), [1, 2]);
        assert_eq!(numbers(reader.read_ahead(1).unwrap()), [1, 2], "what waits is not read again");
        assert_eq!(reader.next_frame().unwrap().unwrap().1.number, 1);
        assert_eq!(numbers(&reader.take_ahead(3).unwrap()), [2, 3, 4]);
        assert!(!reader.is_done());
        assert_eq!(numbers(&reader.take_ahead(9).unwrap()), [5, 6]);
        assert!(reader.is_done() && reader.take_ahead(9).unwrap().is_empty());
    }

    #[test]
    fn records_without_a_number_or_the_antenna_are_counted() {
        let mut front = Front::new(Antenna::C);
        assert!(note(&mut front, &[], 1).is_none());
        assert_eq!((front.log.unused.no_antenna, front.log.unused.no_number), (1, 0));
        let repr = Repr::default();
        let mut body = vec![0; repr.body_len()];
        repr.emit(&vec![Iq::default(); repr.samples()], &mut body).unwrap();
        let record = Record { code: code::BFEE, body: &body };
        assert!(front.note(&Next::Record(Stamps::default(), record)).is_none());
        assert_eq!((front.log.unused.no_antenna, front.log.unused.no_number), (1, 1));
    }
}
