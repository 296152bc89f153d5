//! Contents and losses of a log: counts of everything read, dropped and missing.

use crate::maths::{unwrap_near, upper_median_ord};
use crate::source::{Loss, Next, Stamps};
use crate::time::Step16;
use driver_iface::bfee::{Antenna, Antennas, Bfee, Repr};
use driver_iface::mpdu::Header;
use driver_iface::record::{Record, Tail, code, left_out};
use driver_iface::{Mac, mpdu, sounding};
use std::collections::{BTreeMap, BTreeSet};

/// Losses kept with their place; further ones are only counted.
#[doc(hidden)] // for the crates of this workspace
pub const LOSSES_KEPT: usize = 16;
/// Senders that are surveyed one by one, besides those [named](Survey::with_known). Noise and malice make up any
/// number of them: beyond this the one with the least evidence is forgotten for each that is new.
#[doc(hidden)] // for the crates of this workspace
pub const SENDERS_KEPT: usize = 256;
/// Records this far apart on the card's clock, microseconds, have a pause between them.
#[doc(hidden)] // for the crates of this workspace
pub const PAUSE_US: i64 = 1_000_000;

/// Smallest, largest and mean value of a quantity.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Range {
    /// Smallest value.
    pub min: i32,
    /// Largest value.
    pub max: i32,
    /// Mean value.
    pub mean: f64,
    #[serde(skip)]
    count: u64,
}

impl Range {
    fn note(range: &mut Option<Self>, value: i32) {
        let range = range.get_or_insert(Self { min: value, max: value, ..Self::default() });
        range.count += 1;
        range.min = range.min.min(value);
        range.max = range.max.max(value);
        range.mean += (f64::from(value) - range.mean) / range.count as f64;
    }
}

/// A stretch of a log that was lost, in words.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct LostBytes {
    /// Offset of the first lost byte.
    pub offset: u64,
    /// Bytes skipped.
    pub bytes: u64,
    /// Why.
    pub reason: String,
}

/// Everything counted while reading one log.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Survey {
    /// Records of any code.
    pub records: u64,
    /// Records by code.
    pub by_code: BTreeMap<u8, u64>,
    /// Intact bfee records in the stock layout.
    pub stock: u64,
    /// Intact bfee records in the WSR layout of 2021, which has no frame number.
    pub wsr_2021: u64,
    /// Intact bfee records in the WSR layout.
    pub wsr: u64,
    /// Records with bytes behind their CSI, which are no part of it.
    pub longer: u64,
    /// Those bytes.
    pub bytes_behind_csi: u64,
    /// bfee records that were framed but hold something impossible.
    pub bad_bfee: u64,
    /// Stretches of bytes that are no record.
    pub damages: u64,
    /// Bytes in them.
    pub damaged_bytes: u64,
    /// The first of both kinds.
    pub losses: Vec<LostBytes>,
    /// Queue overruns reported by the source.
    pub overruns: u64,
    /// Numbers missing from `bfee_count` (lost, or filtered out of the log).
    pub bfee_missing: u64,
    /// Records with the `bfee_count` of the one before.
    pub bfee_repeated: u64,
    /// Steps back of `bfee_count`: the driver was reloaded (or more than 32,767 records are missing).
    pub bfee_restarted: u64,
    /// Records of senders that were forgotten, as there were more than 256 kept.
    pub further_senders: u64,
    /// Times that a sender was forgotten for a new one.
    pub senders_forgotten: u64,
    /// Records by receive chains and streams: `streams[n_rx - 1][n_tx - 1]`.
    pub streams: [[u64; 3]; 3],
    /// Records by `antenna_sel`.
    pub antenna_sel: BTreeMap<u8, u64>,
    /// Records whose `antenna_sel` is no permutation.
    pub bad_permutations: u64,
    /// Records by `fake_rate_n_flags`.
    pub rates: BTreeMap<u16, u64>,
    /// Records without a noise measurement (-127).
    pub noise_unknown: u64,
    /// Noise floor where measured, dBm.
    pub noise_dbm: Option<Range>,
    /// RSSI by antenna A, B, C, dB relative to the card's reference; zeros (not connected) skipped.
    pub rssi: [Option<Range>; 3],
    /// Gain of the receiver, dB.
    pub agc: Option<Range>,
    /// Frames by sender; the all-zero MAC is "unknown".
    #[serde(skip)]
    pub senders: BTreeMap<Mac, Sender>,
    /// First and last card clock, unwrapped microseconds.
    pub clock_us: Option<(i64, i64)>,
    /// How it went on from record to record.
    pub clock_steps: ClockSteps,
    /// First and last host time, microseconds since the Unix epoch.
    pub host_us: Option<(i64, i64)>,
    /// How the host's clock went on beside the card's.
    pub host_steps: HostSteps,
    /// MPDU records whose frame check sequence does not fit, in a log that has them.
    pub mpdu_bad_fcs: u64,
    /// MPDU records without a frame check sequence, as the card hands them up in client and access point mode.
    pub mpdu_without_fcs: u64,
    /// How the log ended.
    #[serde(skip)]
    pub tail: Option<Tail>,
    #[serde(skip)]
    count: Step16,
    #[serde(skip)]
    clock: CardClock,
    #[serde(skip)]
    heard: Option<(Mac, Option<u32>)>,
    /// A frame ended in its own frame check sequence, so all have one.
    #[serde(skip)]
    has_fcs: bool,
    /// Senders that always have a place.
    #[serde(skip)]
    known: BTreeSet<Mac>,
}

/// The identity of a bfee: who sent the frame, its number, when the host saw it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Sender; all zero if unknown.
    pub mac: Mac,
    /// Sounding counter.
    pub frame_count: Option<u32>,
    /// Host time of the record, microseconds since the Unix epoch.
    pub host_us: Option<i64>,
}

/// Sender and number of a sounding frame (no FCS), which has its sender in address 3. A group address sends nothing: that
/// frame is of another program (csitool's injection broadcasts there), and its payload no number.
fn sounded(frame: &[u8]) -> Option<(Mac, Option<u32>)> {
    let frame = sounding::Frame::new_checked(frame).filter(|frame| !frame.sender().is_group())?;
    Some((frame.sender(), Some(frame.number())))
}

/// Sender of any frame: address 2, if it has one.
fn sent(frame: &[u8]) -> Option<(Mac, Option<u32>)> {
    Some((Header::new_checked(frame)?.addr2()?, None))
}

impl Survey {
    /// A survey with reserved places for these senders.
    #[must_use]
    #[doc(hidden)] // for the crates of this workspace
    pub fn with_known(known: impl IntoIterator<Item = Mac>) -> Self {
        Self { known: known.into_iter().collect(), ..Self::default() }
    }

    /// Counts what a source gave. For an intact bfee record it gives the checked view and the frame's identity.
    pub fn note<'a>(&mut self, next: &Next<'a>) -> Option<(Bfee<'a>, Identity)> {
        let mut tally = Tally::default();
        let noted = self.note_in(&mut tally, next);
        self.settle(&mut tally);
        noted
    }

    /// The same for many in a row: what is counted by code, antennas and rate may be in the tally until [`Survey::settle`].
    #[doc(hidden)]
    pub fn note_in<'a>(&mut self, tally: &mut Tally, next: &Next<'a>) -> Option<(Bfee<'a>, Identity)> {
        match next {
            Next::Record(stamps, record) => return self.note_record(tally, *stamps, *record),
            Next::Lost(loss) => self.note_loss(loss),
            Next::Pending => {}
            Next::End(tail) => self.tail = Some(*tail),
        }
        None
    }

    fn note_record<'a>(
        &mut self,
        tally: &mut Tally,
        stamps: Stamps,
        record: Record<'a>,
    ) -> Option<(Bfee<'a>, Identity)> {
        self.records += 1;
        self.tally_code(tally, record.code);
        match record.code {
            code::BFEE => match Bfee::new_checked(record.body) {
                Ok(bfee) => return Some((bfee, self.note_bfee(tally, stamps, &Fields::of(&bfee)))),
                Err(error) => {
                    self.bad_bfee += 1;
                    self.keep(stamps.origin.position(), record.body.len() as u64 + 3, error.to_string());
                }
            },
            code::MPDU => self.note_mpdu(record.body),
            code::LEFT_OUT => {
                if let Some((offset, len, why)) = left_out(record.body) {
                    self.note_damage(offset, len, why.to_owned());
                }
            }
            _ => {}
        }
        None
    }

    /// Counts an intact bfee record by its fields, as [`Survey::note_in`] does; gives the frame's identity.
    #[doc(hidden)]
    pub fn note_fields(&mut self, tally: &mut Tally, stamps: Stamps, fields: &Fields) -> Identity {
        self.records += 1;
        self.tally_code(tally, code::BFEE);
        self.note_bfee(tally, stamps, fields)
    }

    fn note_mpdu(&mut self, body: &[u8]) {
        self.heard = None;
        if mpdu::fcs_is_good(body) {
            self.has_fcs = true;
            // What was taken for a frame without one was damaged.
            self.mpdu_bad_fcs += std::mem::take(&mut self.mpdu_without_fcs);
            let frame = body.split_last_chunk::<{ mpdu::FCS }>().map_or(body, |(frame, _)| frame);
            self.heard = sounded(frame).or_else(|| sent(frame));
        } else if self.has_fcs {
            self.mpdu_bad_fcs += 1;
        } else {
            self.mpdu_without_fcs += 1;
            // Robots sound in monitor mode, where frames have an FCS.
            self.heard = sent(body).filter(|(mac, _)| *mac != sounding::MAGIC_MAC);
        }
    }

    fn note_bfee(&mut self, tally: &mut Tally, stamps: Stamps, fields: &Fields) -> Identity {
        let (heard, head) = (self.heard.take(), &fields.head);
        let identity = match head.wsr {
            Some(wsr) => {
                *if wsr.frame_count.is_some() { &mut self.wsr } else { &mut self.wsr_2021 } += 1;
                let host_us = i64::from(wsr.tv_sec) * 1_000_000 + i64::from(wsr.tv_usec);
                Identity {
                    mac: wsr.mac,
                    frame_count: wsr.frame_count.filter(|_| wsr.sender_known()),
                    // The driver's own time is nearer to the frame than a listener's.
                    host_us: (host_us > 0).then_some(host_us).or(stamps.host_us),
                }
            }
            None => {
                self.stock += 1;
                let (mac, frame_count) = heard.unwrap_or_default();
                Identity { mac, frame_count, host_us: stamps.host_us }
            }
        };
        self.longer += u64::from(fields.behind_csi > 0);
        self.bytes_behind_csi += u64::from(fields.behind_csi);
        match self.count.step(head.bfee_count) {
            None | Some(1) => {}
            Some(0) => self.bfee_repeated += 1,
            Some(step) if step <= u16::MAX / 2 => self.bfee_missing += u64::from(step - 1),
            Some(_) => self.bfee_restarted += 1,
        }
        if let Some(row) = self.streams.get_mut(usize::from(head.n_rx).wrapping_sub(1))
            && let Some(count) = row.get_mut(usize::from(head.n_tx).wrapping_sub(1))
        {
            *count += 1;
        }
        self.tally_bfee(tally, head.antenna_sel, head.rate_n_flags);
        self.bad_permutations += u64::from(fields.antennas.is_none());
        match head.noise_dbm {
            -127 => self.noise_unknown += 1,
            noise => Range::note(&mut self.noise_dbm, i32::from(noise)),
        }
        for (range, rssi) in self.rssi.iter_mut().zip(head.rssi).filter(|(_, rssi)| *rssi != 0) {
            Range::note(range, i32::from(rssi));
        }
        Range::note(&mut self.agc, i32::from(head.agc));
        self.note_sender(&identity, head.timestamp_low);
        self.host_steps.note(head.timestamp_low, identity.host_us);
        let (now_us, step_us) = self.clock.note(head.timestamp_low, identity.host_us);
        if let Some(step_us) = step_us {
            self.clock_steps.note(step_us);
        }
        self.clock_us = Some((self.clock_us.map_or(now_us, |(first, _)| first), now_us));
        if let Some(host_us) = identity.host_us {
            self.host_us = Some((self.host_us.map_or(host_us, |(first, _)| first), host_us));
        }
        identity
    }

    fn note_loss(&mut self, loss: &Loss) {
        // The frame before may be that of a record which is lost.
        self.heard = None;
        match loss {
            Loss::Bytes { offset, len, reason } => self.note_damage(*offset, *len, reason.to_string()),
            Loss::Datagram { number, len, reason } => self.note_damage(*number, *len, reason.to_string()),
            // A peer says its own numbers (`remote`): two may be more than are counted here.
            Loss::Overrun { dropped } => self.overruns = self.overruns.saturating_add(dropped.unwrap_or(1)),
        }
    }

    fn note_damage(&mut self, offset: u64, bytes: u64, reason: String) {
        self.damages += 1;
        self.damaged_bytes = self.damaged_bytes.saturating_add(bytes);
        self.keep(offset, bytes, reason);
    }

    fn keep(&mut self, offset: u64, bytes: u64, reason: String) {
        if self.losses.len() < LOSSES_KEPT {
            self.losses.push(LostBytes { offset, bytes, reason });
        }
    }

    /// The records without those that only tell the clock of the next one, as translated logs of other cards have.
    #[must_use]
    #[doc(hidden)] // for the crates of this workspace
    pub fn came(&self) -> u64 {
        self.records - self.by_code.get(&code::CARD_CLOCK).copied().unwrap_or(0)
    }

    /// Intact bfee records.
    #[must_use]
    pub fn bfees(&self) -> u64 {
        self.stock + self.wsr_2021 + self.wsr
    }

    /// The clock that times the records. It may change as long as there are few.
    #[must_use]
    #[doc(hidden)] // for the crates of this workspace
    pub fn time_base(&self) -> TimeBase {
        TimeBase::of(self.bfees().saturating_sub(1), self.clock_steps.forward_us, self.clock.host_forward_us)
    }

    /// Time from the first record to the last so far, microseconds; steps back of the clock count as none. If there is no
    /// clock it is the number of the last record, from 0, in millions.
    #[must_use]
    #[doc(hidden)] // for the crates of this workspace
    pub fn elapsed_us(&self, base: TimeBase) -> i64 {
        match base {
            TimeBase::Card => self.clock_steps.forward_us,
            TimeBase::Host => self.clock.host_forward_us,
            TimeBase::Number => {
                i64::try_from(self.bfees().saturating_sub(1)).unwrap_or(i64::MAX).saturating_mul(1_000_000)
            }
        }
    }

    /// True if anything before the tail was dropped or damaged.
    #[must_use]
    pub fn lost_something(&self) -> bool {
        self.damages > 0 || self.bad_bfee > 0 || self.overruns > 0
    }
}

/// Counts of frame numbers distinguished for each sender, and how far numbers of one count are from each other at most:
/// initiators begin further apart (`exchange::tdma::roster::before_first_number`).
const COUNTS_KEPT: usize = 16;
const SAME_COUNT: u32 = 1 << 22;
/// Inter-packet times kept for the median.
const STEPS_KEPT: usize = 4_096;

/// Steps of a frame number that count as counting up: a sender that several robots share counts past the others' frames.
const COUNTING_UP: std::ops::RangeInclusive<u32> = 1..=64;

/// Frames of one sender in a log.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Sender {
    /// bfee records.
    pub records: u64,
    /// How the card's clock went on from one to the next.
    pub clock_steps: ClockSteps,
    /// Steps of the frame number by 1 to 64.
    #[serde(skip)]
    followed: u64,
    /// Lowest and highest frame number.
    pub frame_count: Option<(u32, u32)>,
    /// Frame numbers skipped on the way up.
    pub frames_skipped: u64,
    /// Frames with the number of the one before: the card reports some twice.
    pub frames_repeated: u64,
    /// Steps back of the frame number: a sender that restarted.
    pub frames_restarted: u64,
    #[serde(skip)]
    numbering: Numbering,
    #[serde(skip)]
    clock: CardClock,
    #[serde(skip)]
    steps_us: Vec<i64>,
    /// Frames that had a number.
    #[serde(skip)]
    pub(crate) numbered: u32,
    #[serde(skip)]
    standing: Standing,
}

impl Sender {
    /// The clock that times its records.
    fn time_base(&self) -> TimeBase {
        TimeBase::of(self.records.saturating_sub(1), self.clock_steps.forward_us, self.clock.host_forward_us)
    }

    /// Frames per second from the median time between frames on the card's clock; `None` where that stands.
    #[must_use]
    pub fn rate_hz(&self) -> Option<f64> {
        let median = upper_median_ord(&mut self.steps_us.clone())?;
        (median > 0 && self.time_base() == TimeBase::Card).then(|| 1e6 / median as f64)
    }

    /// Frames per second over the whole log: steps over their sum on the card's clock, pauses included, steps back left
    /// out; where that clock stands, on the host's.
    #[must_use]
    pub fn mean_rate_hz(&self) -> Option<f64> {
        let (steps, us) = match self.time_base() {
            TimeBase::Card => {
                (self.records.saturating_sub(1 + self.clock_steps.steps_back), self.clock_steps.forward_us)
            }
            TimeBase::Host => (self.records.saturating_sub(1), self.clock.host_forward_us),
            TimeBase::Number => return None,
        };
        (us > 0).then(|| 1e6 * steps as f64 / us as f64)
    }

    /// Whether what stands where a sounding frame has its number counts up from frame to frame, in at least half of the
    /// records. Frames of other programs have anything there.
    #[must_use]
    pub fn counts_up(&self) -> bool {
        self.frame_count.is_some() && 2 * self.followed + 2 * self.frames_repeated + 1 >= self.records
    }

    fn note(&mut self, frame_count: Option<u32>, timestamp_low: u32, host_us: Option<i64>) {
        self.records += 1;
        self.numbered = self.numbered.saturating_add(u32::from(frame_count.is_some()));
        if let Some(number) = frame_count {
            let (low, high) = self.frame_count.unwrap_or((number, number));
            self.frame_count = Some((low.min(number), high.max(number)));
            self.note_number(number);
        }
        if let (_, Some(step_us)) = self.clock.note(timestamp_low, host_us) {
            self.clock_steps.note(step_us);
            if self.steps_us.len() < STEPS_KEPT {
                self.steps_us.push(step_us);
            }
        }
    }

    fn note_number(&mut self, number: u32) {
        match self.numbering.note(number) {
            NumberStep::New => {}
            NumberStep::Repeated => self.frames_repeated += 1,
            NumberStep::Back => self.frames_restarted += 1,
            NumberStep::Forward(step) => {
                self.followed += u64::from(COUNTING_UP.contains(&step));
                self.frames_skipped += u64::from(step - 1);
            }
        }
    }
}

/// How a frame number went on from those before.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberStep {
    /// The first of a count.
    New,
    /// Up by 1 or more.
    Forward(u32),
    /// The one before once more.
    Repeated,
    /// Back: the sender restarted.
    Back,
}

/// The frame numbers of one sender. Where several robots initiate, a sender's answers bear the numbers of others: there are several
/// counts then, and each number goes on from the nearest one.
#[doc(hidden)]
#[derive(Clone, Debug, Default)]
pub struct Numbering {
    /// The newest number of each count.
    last: Vec<u32>,
}

impl Numbering {
    /// Takes the next number.
    pub fn note(&mut self, number: u32) -> NumberStep {
        let step_from = |last: u32| number.wrapping_sub(last).cast_signed();
        let has_room = self.last.len() < COUNTS_KEPT;
        match self.last.iter_mut().min_by_key(|last| step_from(**last).unsigned_abs()) {
            Some(last) if step_from(*last).unsigned_abs() <= SAME_COUNT => {
                let step = step_from(*last);
                *last = number;
                match step {
                    0 => NumberStep::Repeated,
                    1.. => NumberStep::Forward(step.unsigned_abs()),
                    _ => NumberStep::Back,
                }
            }
            _ if has_room => {
                self.last.push(number);
                NumberStep::New
            }
            _ => NumberStep::Back,
        }
    }
}

/// Evidence of all strangers is halved each time that this many were dropped.
const HALVED_EVERY: u64 = 4_096;

/// The evidence for a stranger.
///
/// Senders that are named always have a place in a survey, strangers by evidence and age. The places of strangers are a space-saving table \[metwally2005\]: a new sender takes the place of the one with the
/// least evidence and starts with one more, so a sender of more than 1 in [`SENDERS_KEPT`] records has a place whatever
/// addresses others forge. Evidence halves with time, so old senders are replaced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
struct Standing {
    evidence: u64,
    /// Records surveyed when it was last heard: of equal evidence the one that was silent for longest goes.
    heard_at: u64,
}

impl Standing {
    /// One record more, the survey's `at`th; `least` was the evidence of who had the place before.
    fn hear(&mut self, least: u64, at: u64) {
        self.evidence = self.evidence.max(least).saturating_add(1);
        self.heard_at = at;
    }
}

impl Survey {
    /// Counts a record of a sender, which has a place from now on.
    fn note_sender(&mut self, identity: &Identity, timestamp_low: u32) {
        let (heard_at, Identity { mac, frame_count, host_us }) = (self.records, *identity);
        if let Some(sender) = self.senders.get_mut(&mac) {
            sender.standing.hear(0, heard_at);
            return sender.note(frame_count, timestamp_low, host_us);
        }
        let least = if self.known.contains(&mac) { None } else { self.make_room() };
        let sender = self.senders.entry(mac).or_default();
        sender.standing.hear(least.unwrap_or(0), heard_at);
        sender.note(frame_count, timestamp_low, host_us);
    }

    /// Drops a stranger if all places are taken; returns its evidence.
    fn make_room(&mut self) -> Option<u64> {
        let strangers = self.senders.iter().filter(|(mac, _)| !self.known.contains(mac));
        let (mut count, mut weakest) = (0, None);
        for (mac, sender) in strangers {
            count += 1;
            weakest = weakest.into_iter().chain([(sender.standing, *mac)]).min();
        }
        let (standing, mac) = weakest.filter(|_| count >= SENDERS_KEPT)?;
        let forgotten = self.senders.remove(&mac)?;
        self.further_senders = self.further_senders.saturating_add(forgotten.records);
        self.senders_forgotten += 1;
        if self.senders_forgotten.is_multiple_of(HALVED_EVERY) {
            self.senders.values_mut().for_each(|sender| sender.standing.evidence /= 2);
        }
        Some(standing.evidence)
    }
}

/// How the card's clock went on from record to record.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct ClockSteps {
    /// Sum of the steps forward, microseconds.
    pub forward_us: i64,
    /// Steps back: the card was reset, or its clock jumped.
    pub steps_back: u64,
    /// The largest of them, microseconds, positive.
    pub furthest_back_us: i64,
    /// Steps forward of a second and more.
    pub pauses: u64,
    /// The longest of them, microseconds.
    pub longest_pause_us: i64,
}

impl ClockSteps {
    fn note(&mut self, step_us: i64) {
        if step_us < 0 {
            self.steps_back += 1;
            self.furthest_back_us = self.furthest_back_us.max(step_us.saturating_neg());
            return;
        }
        self.forward_us = self.forward_us.saturating_add(step_us);
        if step_us >= PAUSE_US {
            self.pauses += 1;
            self.longest_pause_us = self.longest_pause_us.max(step_us);
        }
    }
}

/// The clock that times the records of a log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
#[doc(hidden)] // for the crates of this workspace
pub enum TimeBase {
    /// The card's clock, `timestamp_low`.
    #[default]
    Card,
    /// The host's times: the card's clock stands.
    Host,
    /// Nothing: the card's clock stands and there are no host times. Records have their numbers.
    Number,
}

/// A card's clock that advances by less than this a record, microseconds, stands still: the preamble and SIGNAL field
/// of a frame alone take as long (802.11-2016 table 17-5).
const LEAST_US: i64 = 20;

impl TimeBase {
    /// Of so many steps between records, with the sums of the steps forward of both clocks, microseconds.
    fn of(steps: u64, card_us: i64, host_us: i64) -> Self {
        let least_us = i64::try_from(steps).unwrap_or(i64::MAX).saturating_mul(LEAST_US);
        match () {
            () if steps == 0 || card_us >= least_us => Self::Card,
            () if host_us > 0 => Self::Host,
            () => Self::Number,
        }
    }
}

/// The card's clock from record to record. The host's beside it says how often it wrapped in a pause.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CardClock {
    /// The last reading, and its unwrapped value.
    last: Option<(u32, i64)>,
    /// Unwrapped time and host time of the last record that had both.
    last_both: Option<(i64, i64)>,
    /// Sum of the host's steps forward, microseconds.
    host_forward_us: i64,
}

impl CardClock {
    /// The unwrapped time of the next record and the step to it from the one before, microseconds; `timestamp_low` as the card
    /// gives it, `host_us` since the Unix epoch.
    pub(super) fn note(&mut self, timestamp_low: u32, host_us: Option<i64>) -> (i64, Option<i64>) {
        let now_us = self.unwrap(timestamp_low, host_us);
        let step_us = self.last.replace((timestamp_low, now_us)).map(|(_, last)| now_us.saturating_sub(last));
        if let Some(host_us) = host_us {
            let host_step_us =
                self.last_both.replace((now_us, host_us)).map_or(0, |(_, last)| host_us.saturating_sub(last));
            self.host_forward_us = self.host_forward_us.saturating_add(host_step_us.max(0));
        }
        (now_us, step_us)
    }

    /// The reading nearest to the last one; where the host's clock went on by so many wraps more, it was a pause of those. A
    /// host's clock that was set tells nothing about the card's, and one that did not move at all stands.
    fn unwrap(&self, timestamp_low: u32, host_us: Option<i64>) -> i64 {
        let Some((last, last_us)) = self.last else { return i64::from(timestamp_low) };
        let near_us = unwrap_near(last_us, timestamp_low);
        let Some((both_us, last_host_us)) = self.last_both.filter(|_| last != timestamp_low) else { return near_us };
        let Some(elapsed_us) = host_us.map(|now| now.saturating_sub(last_host_us)) else { return near_us };
        let off_us = elapsed_us.saturating_sub(near_us.saturating_sub(both_us));
        let usual_us = SET_US.saturating_add(elapsed_us / SLEW).min(FURTHEST_US);
        if is_whole_wraps(off_us, usual_us) {
            unwrap_near(both_us.saturating_add(elapsed_us), timestamp_low)
        } else {
            near_us
        }
    }
}

/// Beside pauses of any length clocks do not differ by more, microseconds; of clocks that were set, one in 200 does not by chance.
const FURTHEST_US: i64 = 10_000_000;
/// Period of the card's clock, microseconds.
const WRAP_US: i64 = 1 << 32;

/// True if a clock that was off by so much went on by a wrap of the card's clock or several, to within `usual_us`.
fn is_whole_wraps(off_us: i64, usual_us: i64) -> bool {
    let from_whole = off_us.saturating_add(WRAP_US / 2).rem_euclid(WRAP_US).abs_diff(WRAP_US / 2);
    off_us > 0 && from_whole < usual_us.unsigned_abs()
}

/// A host's clock may be this far from the card's between two records, microseconds, and be no clock that was set: records
/// are read late, and network time is slewed.
pub(crate) const SET_US: i64 = 500_000;
/// And this share of the time between them.
const SLEW: i64 = 1_000;

/// How the host's clock went on beside the card's, from record to record.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct HostSteps {
    /// Times that it was set: half a second and more off what the card's clock says went by.
    pub set: u64,
    /// The furthest of them, microseconds, negative where it was set back.
    pub furthest_us: i64,
    /// The last host time before it.
    #[serde(skip)]
    pub(crate) before_us: i64,
    /// Card's clock and host time of the last record that had both.
    #[serde(skip)]
    last: Option<(u32, i64)>,
}

impl HostSteps {
    /// Takes the next record. The card's clock wraps every 71.6 minutes: how often between two records nobody knows, so a
    /// clock that was set on by just that is a pause. Where the card's clock went back, it is that clock which restarted.
    pub(crate) fn note(&mut self, timestamp_low: u32, host_us: Option<i64>) {
        let Some(host_us) = host_us else { return };
        let Some((card, host)) = self.last.replace((timestamp_low, host_us)) else { return };
        let card_us = i64::from(timestamp_low.wrapping_sub(card).cast_signed());
        let off_us = host_us.saturating_sub(host).saturating_sub(card_us);
        let is_pause = is_whole_wraps(off_us, SET_US);
        let usual_us = SET_US.saturating_add(card_us.abs() / SLEW);
        if card_us < 0 || is_pause || off_us.saturating_abs() <= usual_us {
            return;
        }
        self.set += 1;
        if off_us.saturating_abs() > self.furthest_us.saturating_abs() {
            (self.furthest_us, self.before_us) = (off_us, host);
        }
    }
}

/// The fields of an intact bfee record beside its CSI: small enough to be handed from one thread to another, which need not look at
/// the record itself then.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fields {
    /// As they are in the record.
    pub head: Repr,
    /// Antenna of each chain, where the record says a permutation.
    pub antennas: Option<Antennas>,
    /// Bytes behind the CSI.
    pub behind_csi: u16,
}

impl Fields {
    /// Those of a record.
    #[must_use]
    #[inline]
    pub fn of(bfee: &Bfee<'_>) -> Self {
        Self { head: Repr::parse(bfee), antennas: bfee.antennas().ok(), behind_csi: bfee.behind_csi().len() as u16 }
    }
}

/// An antenna whose mean RSSI is this much below the strongest one's is as good as unconnected, dB (ports without an
/// antenna are 18 to 35 below in 64 logs).
const UNCONNECTED_DB: f64 = 14.0;

impl Survey {
    /// Where `antenna` hears so much less than another that nothing seems to be connected to its port: the antenna that
    /// hears most, and by how much its mean RSSI is higher, dB.
    #[doc(hidden)] // for the crates of this workspace
    #[must_use]
    pub fn better_antenna(&self, antenna: Antenna) -> Option<(Antenna, f64)> {
        let mean = |antenna: Antenna| self.rssi.get(antenna.index())?.map(|rssi| rssi.mean);
        let heard = Antenna::ALL.into_iter().filter_map(|other| Some((other, mean(other)?)));
        let (best, level_db) = heard.max_by(|a, b| a.1.total_cmp(&b.1))?;
        let above_db = level_db - mean(antenna).unwrap_or(0.0);
        (best != antenna && above_db >= UNCONNECTED_DB).then_some((best, above_db))
    }
}

/// Counts that are not in a [`Survey`]'s maps yet: of the last code, antennas and rate, how many records had them.
#[doc(hidden)]
#[derive(Debug, Default)]
pub struct Tally {
    code: (u8, u64),
    antenna_sel: (u8, u64),
    rate: (u16, u64),
}

/// Counts one more of `key`; gives the key before with its count, where it is another.
#[inline(always)]
fn count<K: Copy + PartialEq>(run: &mut (K, u64), key: K) -> Option<(K, u64)> {
    if run.0 == key {
        run.1 += 1;
        return None;
    }
    let before = std::mem::replace(run, (key, 1));
    (before.1 > 0).then_some(before)
}

/// Adds a run to the counts by key, if it is not empty.
fn add<K: Ord>(counts: &mut BTreeMap<K, u64>, (key, records): (K, u64)) {
    if records > 0 {
        *counts.entry(key).or_default() += records;
    }
}

impl Survey {
    /// Counts a record's code.
    #[inline(always)]
    fn tally_code(&mut self, tally: &mut Tally, code: u8) {
        if let Some(run) = count(&mut tally.code, code) {
            add(&mut self.by_code, run);
        }
    }

    /// Counts a bfee record's antennas and rate.
    #[inline(always)]
    fn tally_bfee(&mut self, tally: &mut Tally, antenna_sel: u8, rate: u16) {
        if let Some(run) = count(&mut tally.antenna_sel, antenna_sel) {
            add(&mut self.antenna_sel, run);
        }
        if let Some((rate, records)) = count(&mut tally.rate, rate) {
            self.count_rate(rate, records);
        }
    }

    /// Puts into the maps what [`Survey::note_in`] counted. The tally is empty then.
    #[doc(hidden)]
    pub fn settle(&mut self, tally: &mut Tally) {
        let Tally { code, antenna_sel, rate } = std::mem::take(tally);
        add(&mut self.by_code, code);
        add(&mut self.antenna_sel, antenna_sel);
        if rate.1 > 0 {
            self.count_rate(rate.0, rate.1);
        }
    }

    fn count_rate(&mut self, rate: u16, records: u64) {
        if self.rates.len() < SENDERS_KEPT || self.rates.contains_key(&rate) {
            *self.rates.entry(rate).or_default() += records;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Refused;
    use driver_iface::bfee::{Iq, Wsr};

    /// Seconds on the card's clock and on the host's, a record each.
    fn steps(records: &[(f64, f64)]) -> (u64, i64) {
        let mut steps = HostSteps::default();
        for (card, host) in records {
            steps.note((card * 1e6) as u64 as u32, Some(1_700_000_000_000_000 + (host * 1e6) as i64));
        }
        (steps.set, steps.furthest_us)
    }

    #[test]
    fn a_clock_that_stands_is_no_step_back_and_a_second_is_a_pause() {
        let mut steps = ClockSteps::default();
        for step_us in [0, PAUSE_US - 1, PAUSE_US, -1, -3, -2, 5] {
            steps.note(step_us);
        }
        let forward_us = 2 * PAUSE_US + 4;
        let expected =
            ClockSteps { forward_us, steps_back: 3, furthest_back_us: 3, pauses: 1, longest_pause_us: PAUSE_US };
        assert_eq!(steps, expected);
    }

    #[test]
    fn a_pause_longer_than_half_a_wrap_is_one_where_the_host_was_beside_it() {
        let steps = |host: [Option<i64>; 2]| {
            let mut clock = CardClock::default();
            clock.note(1_000, host[0]);
            clock.note(1_000 + 3_000_000_000, host[1]).1
        };
        assert_eq!(steps([Some(0), Some(3_000_400_000)]), Some(3_000_000_000));
        assert_eq!(steps([None, None]), Some(3_000_000_000 - (1 << 32)), "the nearer reading");
    }

    /// Sum of the card's steps forward over records of (card's clock, host's) in seconds; none where the host's is not known.
    fn forward_s(records: impl Iterator<Item = (f64, Option<f64>)>) -> f64 {
        let (mut clock, mut steps) = (CardClock::default(), ClockSteps::default());
        for (card_s, host_s) in records {
            let host_us = host_s.map(|at_s| 1_700_000_000_000_000 + (at_s * 1e6) as i64);
            if let Some(step_us) = clock.note((card_s * 1e6) as u64 as u32, host_us).1 {
                steps.note(step_us);
            }
        }
        assert_eq!(steps.steps_back, 0);
        steps.forward_us as f64 * 1e-6
    }

    #[test]
    fn a_hosts_clock_that_is_not_known_for_long_or_set_is_no_pause_of_the_cards() {
        // A record a second for 50 minutes; the host's times are known at both ends only.
        let known = |k: usize| (!(10..2_990).contains(&k)).then_some(k as f64);
        assert_eq!(forward_s((0..3_000).map(|k| (k as f64, known(k)))), 2_999.0);
        // Set on by a year, and back by a day.
        for set_s in [31_536_000.3, -86_400.3] {
            let host_s = |k: u32| f64::from(k) + if k < 50 { 0.0 } else { set_s };
            assert_eq!(forward_s((0..100).map(|k| (f64::from(k), Some(host_s(k))))), 99.0);
        }
        // A clock that stands through a pause.
        assert_eq!(
            forward_s([(5.0, 0.0), (5.0, 1.0), (5.0, 4_295.0)].map(|(card, host)| (card, Some(host))).into_iter()),
            0.0
        );
        // Pauses with a host's clock that is read late, and that drifts.
        let paused = [(0.0, 0.0), (1.0, 1.0), (3_601.0, 3_601.9), (12_001.0, 12_003.0)];
        assert_eq!(forward_s(paused.map(|(card, host)| (card, Some(host))).into_iter()), 12_001.0);
    }

    #[test]
    fn a_clock_that_stands_is_none() {
        assert_eq!(TimeBase::of(0, 0, 5), TimeBase::Card);
        assert_eq!(TimeBase::of(10, 10 * LEAST_US, 5), TimeBase::Card);
        assert_eq!(TimeBase::of(10, 10 * LEAST_US - 1, 5), TimeBase::Host);
        assert_eq!(TimeBase::of(10, 0, 0), TimeBase::Number);
        assert_eq!(TimeBase::of(u64::MAX, i64::MAX, 0), TimeBase::Card);
    }

    #[test]
    fn a_hosts_clock_that_is_set_is_seen_and_what_is_usual_is_not() {
        assert_eq!(steps(&[(0.0, 0.0), (1.0, 1.4), (2.0, 2.0), (3.0, 3.0)]), (0, 0), "records that were read late");
        assert_eq!(steps(&[(0.0, 0.0), (1.0, 3_601.0), (2.0, 3_602.0)]), (1, 3_600_000_000), "an hour on");
        assert_eq!(
            steps(&[(0.0, 0.0), (1.0, 4.0), (2.0, -7.0), (3.0, -6.0)]),
            (2, -12_000_000),
            "on, and further back"
        );
        assert_eq!(steps(&[(0.0, 0.0), (1.0, 1.6)]), (1, 600_000));
        assert_eq!(steps(&[(1.0, 0.0), (1.0, 1.0)]), (1, 1_000_000), "two records of one microsecond");
        // A pause in which the card's clock wraps twice, one in which it does not, and a clock that drifts by 500 ppm in it.
        let wrap = 4_294.967_296;
        assert_eq!(steps(&[(0.0, 0.0), (10.0, 10.0 + 2.0 * wrap), (1_800.0, 1_800.9 + 2.0 * wrap)]), (0, 0));
        // As far from a whole number of wraps as is no pause any more.
        let past_a_wrap = |off_us: i64| {
            let mut steps = HostSteps::default();
            [(0, 0), (10, (1 << 32) + off_us + 10)].iter().for_each(|(card, host)| steps.note(*card, Some(*host)));
            steps.set
        };
        assert_eq!([SET_US - 1, SET_US, 1 - SET_US, -SET_US].map(past_a_wrap), [0, 1, 0, 1]);
        // The card was reset.
        assert_eq!(steps(&[(500.0, 0.0), (0.0, 0.2), (1.0, 1.2)]), (0, 0));
        // Records without a time are passed over.
        let mut passed = HostSteps::default();
        for (card, host_us) in [(0, Some(1)), (1, None), (2_000_000, Some(2_000_001))] {
            passed.note(card, host_us);
        }
        assert_eq!(passed.set, 0);
    }

    fn with_rssi(rssi: [&[i32]; 3]) -> Survey {
        let range = |values: &[i32]| {
            let mut range = None;
            values.iter().for_each(|value| Range::note(&mut range, *value));
            range
        };
        Survey { rssi: rssi.map(range), ..Survey::default() }
    }

    #[test]
    fn a_port_without_an_antenna_is_told_from_one_that_hears_less() {
        let wsr = with_rssi([&[38, 37, 39], &[15, 14], &[13, 12]]);
        assert_eq!(wsr.better_antenna(Antenna::A), None);
        assert_eq!(wsr.better_antenna(Antenna::B), Some((Antenna::A, 23.5)));
        // Fading takes less, and a port of which the card says nothing has 0.
        let faded = with_rssi([&[30], &[20], &[]]);
        assert_eq!(faded.better_antenna(Antenna::B), None);
        assert_eq!(faded.better_antenna(Antenna::C), Some((Antenna::A, 30.0)));
        assert_eq!(with_rssi([&[], &[], &[]]).better_antenna(Antenna::A), None, "nothing is known");
    }

    fn sender(numbers: &[u32]) -> Sender {
        let mut sender = Sender::default();
        for (at, number) in numbers.iter().enumerate() {
            sender.note(Some(*number), 10_000 * at as u32, None);
        }
        sender
    }

    #[test]
    fn skipped_repeated_and_restarted_numbers_are_told_apart() {
        let told = sender(&[7, 8, 8, 12, 13, 1, 2, 2, 2, 4]);
        assert_eq!((told.frames_skipped, told.frames_repeated, told.frames_restarted), (3 + 1, 3, 1));
        assert_eq!(told.frame_count, Some((1, 13)));
        assert_eq!(told.rate_hz(), Some(100.0));
        let wrapped = sender(&[u32::MAX - 1, u32::MAX, 0, 1]);
        assert_eq!((wrapped.frames_skipped, wrapped.frames_restarted), (0, 0));
    }

    /// The body of a bfee record.
    fn body(repr: Repr) -> Vec<u8> {
        let mut body = vec![0; repr.body_len()];
        repr.emit(&vec![Iq::default(); repr.samples()], &mut body).unwrap();
        body
    }

    /// A survey of WSR records with the senders, `bfee_count`s and rates given.
    fn survey(records: impl Iterator<Item = (Mac, u16, u16)>) -> Survey {
        heard_by(Survey::default(), records)
    }

    fn heard_by(mut survey: Survey, records: impl Iterator<Item = (Mac, u16, u16)>) -> Survey {
        for (mac, bfee_count, rate_n_flags) in records {
            let wsr = Wsr { mac, frame_count: Some(1), ..Wsr::default() };
            let body = body(Repr { bfee_count, rate_n_flags, wsr: Some(wsr), ..Repr::default() });
            let record = Record { code: code::BFEE, body: &body };
            assert!(survey.note(&Next::Record(Stamps::default(), record)).is_some());
        }
        survey
    }

    #[test]
    fn numbers_of_several_initiators_are_counts_of_their_own() {
        let far = SAME_COUNT + 1;
        let two = sender(&[10, 10 + far, 11, 11 + far, 13, 12 + far]);
        assert_eq!((two.frames_skipped, two.frames_restarted), (1, 0));
        // One count more than are kept: its numbers are restarts of what is nearest.
        let begin = |k: u32| 2 * far * k;
        let all: Vec<u32> = (0..=COUNTS_KEPT as u32).map(begin).collect();
        assert_eq!(sender(&all[..COUNTS_KEPT]).frames_restarted, 0);
        assert_eq!(sender(&all).frames_restarted, 1);
    }

    #[test]
    fn a_driver_that_was_loaded_anew_is_no_loss() {
        // Half of the range is a gap, and more a restart.
        for (counts, expected) in [
            (&[65_534, 65_535, 0, 1, 1, 5, 0, 1][..], (3, 1, 1)),
            (&[0, 0x7fff], (0x7ffe, 0, 0)),
            (&[0, 0x8000], (0, 0, 1)),
        ] {
            let survey = survey(counts.iter().map(|count| (Mac([2; 6]), *count, 0x101)));
            assert_eq!((survey.bfee_missing, survey.bfee_repeated, survey.bfee_restarted), expected, "{counts:?}");
        }
    }

    #[test]
    fn what_noise_makes_up_is_bounded() {
        let survey = survey((0..1_000).map(|n: u16| (Mac([2, 0, 0, 0, (n >> 8) as u8, n as u8]), n, n)));
        assert_eq!((survey.senders.len(), survey.rates.len()), (SENDERS_KEPT, SENDERS_KEPT));
        assert_eq!(survey.further_senders, 1_000 - SENDERS_KEPT as u64);
        assert_eq!(survey.senders_forgotten, 1_000 - SENDERS_KEPT as u64);
    }

    #[test]
    fn a_clock_that_pauses_or_steps_back_is_seen_and_the_rate_is_that_of_the_whole_log() {
        let mut sender = Sender::default();
        // 101 frames 10 ms apart, a pause of 9 s, 100 more; then the clock falls back by 3 s and 10 frames follow.
        let steps =
            [vec![10_000_i64; 100], vec![9_000_000], vec![10_000; 99], vec![-3_000_000], vec![10_000; 9]].concat();
        let mut at_us = 5_000_000_i64;
        sender.note(None, at_us as u32, None);
        for step in steps {
            at_us += step;
            sender.note(None, at_us as u32, None);
        }
        let clock = sender.clock_steps;
        assert_eq!((clock.pauses, clock.longest_pause_us), (1, 9_000_000));
        assert_eq!((clock.steps_back, clock.furthest_back_us), (1, 3_000_000));
        assert_eq!(clock.forward_us, 208 * 10_000 + 9_000_000);
        assert_eq!(sender.rate_hz(), Some(100.0));
        let mean = sender.mean_rate_hz().unwrap();
        assert!((mean - 209.0 / 11.08).abs() < 1e-9, "{mean}");
    }

    #[test]
    fn a_sender_whose_clock_stands_has_the_rate_of_the_hosts_times_or_none() {
        let sender = |host_us: fn(u32) -> Option<i64>| {
            let mut sender = Sender::default();
            (0..101).for_each(|k| sender.note(None, k / 50, host_us(k)));
            sender
        };
        let by_host = sender(|k| Some(1_700_000_000_000_000 + 10_000 * i64::from(k)));
        assert_eq!((by_host.mean_rate_hz(), by_host.rate_hz()), (Some(100.0), None));
        assert_eq!(sender(|_| None).mean_rate_hz(), None);
        // A pause in which the card's clock goes on by more than half of its range is one of a sender, too.
        let mut paused = Sender::default();
        for (card_us, host_us) in [(0, 0), (3_553_500_000_u32, 3_553_500_000)] {
            paused.note(None, card_us, Some(host_us));
        }
        assert_eq!((paused.clock_steps.pauses, paused.clock_steps.steps_back), (1, 0));
    }

    #[test]
    fn random_payload_is_no_frame_number() {
        let random: Vec<u32> = (1..500_u32).map(|k| k.wrapping_mul(2_654_435_761) ^ 0x5bd1_e995).collect();
        assert!(!sender(&random).counts_up());
        assert!(sender(&[7, 8, 8, 12, 13, 1, 2, 2, 2, 4]).counts_up());
        assert!(!Sender::default().counts_up());
    }

    #[test]
    fn a_broadcast_address_is_no_sender() {
        let frame = |addr1, addr3| {
            let repr = mpdu::Repr {
                frame_control: 0x0008,
                duration_us: 0,
                seq_ctrl: 0,
                addr1,
                addr2: Mac([4; 6]),
                addr3,
                payload: &[0, 0, 0, 9],
            };
            let mut frame = vec![0; repr.emit_len()];
            repr.emit(&mut frame).unwrap();
            frame
        };
        let (magic, four, six, all) = (sounding::MAGIC_MAC, Mac([4; 6]), Mac([6; 6]), Mac([0xff; 6]));
        for (addr1, addr3, sender, number) in
            [(magic, all, four, None), (magic, six, six, Some(9)), (Mac([2; 6]), six, four, None)]
        {
            let body = body(Repr::default());
            let mut survey = Survey::default();
            let mpdu = frame(addr1, addr3);
            survey.note(&Next::Record(Stamps::default(), Record { code: code::MPDU, body: &mpdu }));
            let record = Record { code: code::BFEE, body: &body };
            let (_, identity) = survey.note(&Next::Record(Stamps::default(), record)).unwrap();
            assert_eq!((identity.mac, identity.frame_count), (sender, number));
        }
    }

    #[test]
    fn what_was_never_measured_has_no_range() {
        let json = |values: &[i32]| serde_json::to_value(with_rssi([values, &[], &[]]).rssi).unwrap();
        assert_eq!(json(&[-3, 5, 1]), serde_json::json!([{"min": -3, "max": 5, "mean": 1.0}, null, null]));
        assert_eq!(json(&[7, 9])[0], serde_json::json!({"min": 7, "max": 9, "mean": 8.0}), "0 was not measured");
    }

    #[test]
    fn losses_are_counted_whatever_they_are_of_and_the_first_are_kept() {
        let mut survey = Survey::default();
        assert!(!survey.lost_something());
        let reason = driver_iface::record::Reason::Checksum;
        let of = |loss| {
            let mut survey = Survey::default();
            survey.note(&Next::Lost(loss));
            assert!(survey.lost_something());
            (survey.damages, survey.damaged_bytes, survey.overruns)
        };
        assert_eq!(of(Loss::Bytes { offset: 5, len: 9, reason }), (1, 9, 0));
        let datagram = Loss::Datagram { number: 5, len: 9, reason: Refused::Truncated { sent: 90, kept: 81 } };
        assert_eq!(of(datagram), (1, 9, 0));
        assert_eq!(of(Loss::Overrun { dropped: Some(3) }), (0, 0, 3));
        assert_eq!(of(Loss::Overrun { dropped: None }), (0, 0, 1));
        for offset in 0..LOSSES_KEPT as u64 + 2 {
            survey.note(&Next::Lost(Loss::Bytes { offset, len: 2, reason }));
            survey.note(&Next::Lost(Loss::Overrun { dropped: Some(2) }));
        }
        let lost = LOSSES_KEPT as u64 + 2;
        assert_eq!((survey.damages, survey.damaged_bytes, survey.overruns), (lost, 2 * lost, 2 * lost));
        assert_eq!(survey.losses.iter().map(|lost| lost.offset).collect::<Vec<_>>(), (0..lost - 2).collect::<Vec<_>>());
    }

    #[test]
    fn losses_that_a_peer_makes_up_add_up_to_no_more_than_can_be_counted() {
        let mut survey = Survey::default();
        for dropped in [u64::MAX - 1, u64::MAX - 1, 1] {
            survey.note(&Next::Lost(Loss::Overrun { dropped: Some(dropped) }));
        }
        assert_eq!(survey.overruns, u64::MAX);
    }

    #[test]
    fn records_are_counted_by_code_and_one_that_cannot_be_read_is_something_lost() {
        let mut survey = Survey::default();
        for (code, times) in [(0x7f, 3), (code::BFEE, 2)] {
            (0..times).for_each(|_| {
                assert!(survey.note(&Next::Record(Stamps::default(), Record { code, body: &[1, 2, 3] })).is_none());
            });
        }
        assert_eq!((survey.records, survey.bad_bfee, survey.bfees()), (5, 2, 0));
        assert_eq!((survey.by_code[&0x7f], survey.by_code[&code::BFEE], survey.losses.len()), (3, 2, 2));
        assert!(survey.lost_something());
        // Of a record, its length field, and its code, which are lost with it.
        assert_eq!(survey.losses.iter().map(|lost| lost.bytes).collect::<Vec<_>>(), [6, 6]);
    }

    #[test]
    fn records_counted_in_a_row_are_those_that_are_counted_each() {
        let body =
            |antenna_sel, rate_n_flags| (code::BFEE, body(Repr { antenna_sel, rate_n_flags, ..Repr::default() }));
        let row: Vec<(u8, Vec<u8>)> = [
            vec![(0x7f, vec![1]); 2],
            vec![body(0x24, 0x101); 3],
            vec![body(0x21, 0x101); 2],
            vec![(0x7f, vec![1])],
            vec![body(0x24, 0x102); 4],
            vec![body(0x24, 0x101), (0, vec![1])],
        ]
        .concat();
        let (mut each, mut in_a_row, mut tally) = (Survey::default(), Survey::default(), Tally::default());
        for (code, body) in &row {
            let record = Next::Record(Stamps::default(), Record { code: *code, body });
            let noted =
                [each.note(&record), in_a_row.note_in(&mut tally, &record)].map(|noted| noted.map(|(_, who)| who));
            assert_eq!(noted[0], noted[1]);
        }
        in_a_row.settle(&mut tally);
        // Settled again it counts nothing again.
        in_a_row.settle(&mut tally);
        for survey in [each, in_a_row] {
            assert_eq!(survey.by_code, BTreeMap::from([(0, 1), (0x7f, 3), (code::BFEE, 10)]));
            assert_eq!(survey.antenna_sel, BTreeMap::from([(0x21, 2), (0x24, 8)]));
            assert_eq!(survey.rates, BTreeMap::from([(0x101, 6), (0x102, 4)]));
        }
    }

    #[test]
    fn a_log_without_csi_has_no_antennas_and_no_rates() {
        let mut survey = Survey::default();
        survey.note(&Next::Pending);
        assert!(survey.by_code.is_empty(), "nor has nothing a code");
        survey.note(&Next::Record(Stamps::default(), Record { code: 0x7f, body: &[1] }));
        assert_eq!(survey.by_code, BTreeMap::from([(0x7f, 1)]));
        assert!(survey.antenna_sel.is_empty() && survey.rates.is_empty());
    }

    #[test]
    fn a_number_that_is_sent_again_counts_up_too() {
        // Ten records, of which five, or four, repeat the one before: half of them are enough.
        let far = |k: u32| 0x1000_0000 * (k + 1);
        let with = |repeated: usize| [vec![7; repeated + 1], (0..9 - repeated as u32).map(far).collect()].concat();
        assert!(sender(&with(5)).counts_up());
        assert!(!sender(&with(4)).counts_up());
        // Nine records have eight steps, of which four are half.
        let nine = |counting: u32| [(0..=counting).collect(), (0..8 - counting).map(far).collect::<Vec<_>>()].concat();
        assert!(sender(&nine(4)).counts_up());
        assert!(!sender(&nine(3)).counts_up());
    }

    #[test]
    fn a_wsr_record_has_its_drivers_time_and_a_stock_one_the_listeners() {
        let stamps = Stamps { host_us: Some(77), ..Stamps::default() };
        let mut survey = Survey::default();
        let mut host_us = |wsr: Option<Wsr>| {
            let body = body(Repr { wsr, ..Repr::default() });
            let (_, identity) = survey.note(&Next::Record(stamps, Record { code: code::BFEE, body: &body })).unwrap();
            (identity.host_us, survey.wsr, survey.stock, survey.bfees())
        };
        let wsr = |tv_sec, tv_usec| Some(Wsr { tv_sec, tv_usec, frame_count: Some(0), ..Wsr::default() });
        assert_eq!(host_us(wsr(5, 7)), (Some(5_000_007), 1, 0, 1));
        assert_eq!(host_us(wsr(0, 0)), (Some(77), 2, 0, 2));
        assert_eq!(host_us(None), (Some(77), 2, 1, 3));
    }

    #[test]
    fn the_rate_is_that_of_the_first_4096_steps() {
        // As many of 20 ms as of 10 ms, the upper median of which is 20 ms; one more of 10 ms comes too late.
        let steps = [vec![10_000; 2_048], vec![20_000; 2_048], vec![10_000]].concat();
        let (mut sender, mut at) = (Sender::default(), 0);
        sender.note(None, at, None);
        for step in steps {
            at += step;
            sender.note(None, at, None);
        }
        assert_eq!(sender.rate_hz(), Some(50.0));
    }

    #[test]
    fn what_the_card_says_of_each_record_is_counted() {
        let mut survey = Survey::default();
        let mut hear = |n_rx, n_tx, antenna_sel, noise_dbm, rssi, agc| {
            let body = body(Repr { n_rx, n_tx, antenna_sel, noise_dbm, rssi, agc, ..Repr::default() });
            assert!(survey.note(&Next::Record(Stamps::default(), Record { code: code::BFEE, body: &body })).is_some());
        };
        (0..2).for_each(|_| hear(3, 2, 0x24, -90, [30, 31, 32], 40));
        (0..3).for_each(|_| hear(1, 1, 0, -127, [30, 0, 0], 20));
        hear(2, 3, 0xff, -80, [10, 11, 0], 30);
        assert_eq!(survey.streams, [[3, 0, 0], [0, 0, 1], [0, 2, 0]]);
        assert_eq!((survey.antenna_sel[&0x24], survey.antenna_sel[&0], survey.antenna_sel[&0xff]), (2, 3, 1));
        assert_eq!((survey.bad_permutations, survey.noise_unknown), (1, 3));
        let range = |range: Option<Range>| range.map(|range| (range.min, range.max, range.count)).unwrap();
        assert_eq!(range(survey.noise_dbm), (-90, -80, 3));
        assert_eq!(survey.rssi.map(range), [(10, 30, 6), (11, 31, 3), (32, 32, 2)], "0 is no antenna");
        assert_eq!((range(survey.agc), survey.agc.unwrap().mean), ((20, 40, 6), 170.0 / 6.0));
        let broken = [0; 40];
        (0..2).for_each(|_| {
            survey.note(&Next::Record(Stamps::default(), Record { code: code::MPDU, body: &broken }));
        });
        assert_eq!((survey.mpdu_bad_fcs, survey.mpdu_without_fcs), (0, 2), "no frame of the log has one");
        let ack = [0xd4, 0, 0, 0, 2, 2, 2, 2, 2, 2];
        let ack = [&ack[..], &mpdu::crc32(&ack).to_le_bytes()].concat();
        survey.note(&Next::Record(Stamps::default(), Record { code: code::MPDU, body: &ack }));
        assert_eq!((survey.mpdu_bad_fcs, survey.mpdu_without_fcs), (2, 0), "all frames of the log have one");
    }

    #[test]
    fn a_pause_longer_than_the_cards_clock_is_seen_by_the_hosts() {
        let mut survey = Survey::default();
        // An hour and a half between the second and the third: the card's clock wrapped once.
        let hour_us = 3_600_000_000_i64;
        let at = [5_000_000, 5_010_000, 5_010_000 + 3 * hour_us / 2, 5_020_000 + 3 * hour_us / 2];
        for now_us in at {
            let body = body(Repr { timestamp_low: now_us as u32, ..Repr::default() });
            let stamps = Stamps { host_us: Some(1_700_000_000_000_000 + now_us), ..Stamps::default() };
            survey.note(&Next::Record(stamps, Record { code: code::BFEE, body: &body }));
        }
        assert_eq!(survey.clock_us, Some((at[0], at[3])));
        assert_eq!(survey.host_us, Some((1_700_000_000_000_000 + at[0], 1_700_000_000_000_000 + at[3])));
        let steps = survey.clock_steps;
        assert_eq!((steps.pauses, steps.longest_pause_us, steps.forward_us), (1, 3 * hour_us / 2, at[3] - at[0]));
        assert_eq!(survey.host_steps.set, 0);
    }

    #[test]
    fn there_is_no_rate_without_a_step_forward() {
        let rate = |clocks: &[u32]| {
            let mut sender = Sender::default();
            clocks.iter().for_each(|clock| sender.note(None, *clock, None));
            (sender.rate_hz(), sender.mean_rate_hz())
        };
        assert_eq!([rate(&[]), rate(&[5]), rate(&[5, 5])], [(None, None); 3]);
        assert_eq!(rate(&[5, 1_005]), (Some(1_000.0), Some(1_000.0)));
        assert_eq!(rate(&[9_000_000, 5]).1, None, "the clock stepped back");
    }

    fn made_up(n: u32) -> Mac {
        let [_, a, b, c] = n.to_be_bytes();
        Mac([2, 0x66, 0, a, b, c])
    }

    #[test]
    fn a_busy_stranger_has_a_place_among_any_number_of_made_up_ones() {
        // Made up before it came, and three for each of its records.
        let before = (0..1_000).map(made_up);
        let busy = Mac([2; 6]);
        let among =
            (0..2_000).flat_map(|n| [made_up(1_000 + 3 * n), made_up(1_001 + 3 * n), busy, made_up(1_002 + 3 * n)]);
        let survey = survey(before.chain(among).map(|mac| (mac, 0, 0x101)));
        let sender = &survey.senders[&busy];
        assert!(sender.records >= 1_990, "{}", sender.records);
        assert_eq!(survey.senders.len(), SENDERS_KEPT);
        let kept: u64 = survey.senders.values().map(|sender| sender.records).sum();
        assert_eq!(kept + survey.further_senders, 9_000, "every record is counted once");
    }

    #[test]
    fn strangers_of_long_ago_make_room() {
        let old = (0..SENDERS_KEPT as u32).flat_map(|n| vec![made_up(n); if n == 0 { 5_000 } else { 50 }]);
        // One in twenty is of a robot that came later.
        let late = Mac([2; 6]);
        let later = (0..60_000).map(|n| if n % 20 == 0 { late } else { made_up(1_000 + n) });
        let survey = survey(old.chain(later).map(|mac| (mac, 0, 0x101)));
        let records = survey.senders[&late].records;
        assert!(records >= 1_500, "{records} of 3,000");
        assert!(!survey.senders.contains_key(&made_up(0)), "nothing was heard of it since, however much before");
    }

    #[test]
    fn who_is_known_keeps_its_place_among_any_number_of_strangers() {
        let known = Mac([2; 6]);
        let heard = || [known].into_iter().chain((0..1_000).map(made_up)).map(|mac| (mac, 0, 0x101));
        let survey = heard_by(Survey::with_known([known]), heard());
        assert_eq!((survey.senders[&known].records, survey.senders.len()), (1, SENDERS_KEPT + 1));
        assert!(!heard_by(Survey::default(), heard()).senders.contains_key(&known));
    }
}
