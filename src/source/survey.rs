//! Contents and losses of a log: counts of everything read, dropped and missing.

use crate::source::{Loss, Next, Stamps};
use crate::time::Step16;
use driver_iface::mpdu::{self, Header};
use driver_iface::record::{Record, Tail, code, left_out};
use driver_iface::sounding;
use driver_iface::{Mac, bfee::Bfee};
use std::collections::{BTreeMap, BTreeSet};

mod antennas;
pub(crate) mod bounds;
mod clocks;
mod fields;
mod sender;
mod senders;
mod tally;

pub(super) use clocks::CardClock;
#[doc(hidden)]
pub use clocks::TimeBase;
pub use clocks::{ClockSteps, HostSteps};
#[doc(hidden)]
pub use fields::Fields;
pub use sender::Sender;
#[doc(hidden)]
pub use sender::{NumberStep, Numbering};
#[doc(hidden)]
pub use tally::Tally;

use bounds::LOSSES_KEPT;

/// Smallest, largest and mean value of a quantity; null in JSON where it was never measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
#[serde(into = "Option<Spread>")]
pub struct Range {
    /// Smallest value.
    pub min: i32,
    /// Largest value.
    pub max: i32,
    /// Mean value.
    pub mean: f64,
    count: u64,
}

/// A [`Range`] of something, as JSON has it.
#[derive(serde::Serialize)]
struct Spread {
    min: i32,
    max: i32,
    mean: f64,
}

impl From<Range> for Option<Spread> {
    fn from(range: Range) -> Self {
        range.is_measured().then_some(Spread { min: range.min, max: range.max, mean: range.mean })
    }
}

impl Range {
    /// False if there was no value.
    #[must_use]
    pub fn is_measured(&self) -> bool {
        self.count > 0
    }

    fn note(&mut self, value: i32) {
        if self.count == 0 {
            (self.min, self.max) = (value, value);
        }
        self.count += 1;
        self.min = self.min.min(value);
        self.max = self.max.max(value);
        self.mean += (f64::from(value) - self.mean) / self.count as f64;
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
    pub noise_dbm: Range,
    /// RSSI by antenna A, B, C, dB relative to the card's reference; zeros (not connected) skipped.
    pub rssi: [Range; 3],
    /// Gain of the receiver, dB.
    pub agc: Range,
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
    let frame = sounding::Frame::new_checked(frame).ok().filter(|frame| frame.sender().0[0] & 1 == 0)?;
    Some((frame.sender(), Some(frame.number())))
}

/// Sender of any frame: address 2, if it has one.
fn sent(frame: &[u8]) -> Option<(Mac, Option<u32>)> {
    Some((Header::new_checked(frame).ok()?.addr2()?, None))
}

impl Survey {
    /// A survey with reserved places for these senders.
    #[must_use]
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
            Next::Record(stamps, record) => self.note_record(tally, *stamps, *record),
            Next::Lost(loss) => {
                self.note_loss(loss);
                None
            }
            Next::Pending => None,
            Next::End(tail) => {
                self.tail = Some(*tail);
                None
            }
        }
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
                Ok(bfee) => Some((bfee, self.note_bfee(tally, stamps, &Fields::of(&bfee)))),
                Err(error) => {
                    self.bad_bfee += 1;
                    self.keep(stamps.origin.position(), record.body.len() as u64 + 3, error.to_string());
                    None
                }
            },
            code::MPDU => {
                self.note_mpdu(record.body);
                None
            }
            code::LEFT_OUT => {
                if let Some((offset, len, why)) = left_out(record.body) {
                    self.damages += 1;
                    self.damaged_bytes = self.damaged_bytes.saturating_add(len);
                    self.keep(offset, len, why.to_owned());
                }
                None
            }
            _ => None,
        }
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
            noise => self.noise_dbm.note(i32::from(noise)),
        }
        for (range, rssi) in self.rssi.iter_mut().zip(head.rssi).filter(|(_, rssi)| *rssi != 0) {
            range.note(i32::from(rssi));
        }
        self.agc.note(i32::from(head.agc));
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
            Loss::Bytes { offset, len, reason } => {
                self.damages += 1;
                self.damaged_bytes += len;
                self.keep(*offset, *len, reason.to_string());
            }
            Loss::Datagram { number, len, reason } => {
                self.damages += 1;
                self.damaged_bytes += len;
                self.keep(*number, *len, reason.to_string());
            }
            // A peer says its own numbers (`remote`): two may be more than are counted here.
            Loss::Overrun { dropped } => self.overruns = self.overruns.saturating_add(dropped.unwrap_or(1)),
        }
    }

    fn keep(&mut self, offset: u64, bytes: u64, reason: String) {
        if self.losses.len() < LOSSES_KEPT {
            self.losses.push(LostBytes { offset, bytes, reason });
        }
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

#[cfg(test)]
mod tests;
