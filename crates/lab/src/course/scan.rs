//! A log read once: a short row for each record, and everything that is missing with its time.

use super::Wanted;
use csi5300::source::survey::{Identity, Survey, TimeBase};
use csi5300::source::{CsiSource, Error, Next, Origin, replay::Replay};
use csi5300::time::{Instant, Step16};
use driver_iface::Mac;
use driver_iface::bfee::Bfee;
use std::collections::BTreeMap;
use std::path::Path;

/// One record of the log, short.
#[derive(Clone, Copy)]
pub(super) struct Row {
    /// Time since the log's first record, microseconds.
    pub t_us: i64,
    /// Where it begins in the file, bytes.
    pub offset: u64,
    pub rssi: [u8; 3],
    pub agc: u8,
}

impl Row {
    pub fn t_s(&self) -> f64 {
        self.t_us as f64 * 1e-6
    }
}

/// What was seen on the way through a log: what does not depend on the time that it takes.
#[derive(Default)]
pub(super) struct Seen {
    pub rows: Vec<Row>,
    /// When, seconds, and how many numbers of `bfee_count` are missing.
    pub missing: Vec<(f64, u64)>,
    pub damaged: Vec<f64>,
    /// Who skipped frame numbers, when, and how many.
    pub skipped: Vec<(Mac, f64, u64)>,
    /// Who sent a number again, and when.
    pub repeated: Vec<(Mac, f64)>,
    /// When the card's clock stepped back, and by how much, seconds.
    pub steps_back: Vec<(f64, f64)>,
    pub survey: Survey,
    pub bytes: u64,
}

/// Frame numbers that senders skipped and repeated, with their senders: what stands where a sounding frame has its number is
/// none in frames of other programs, which is known in the end only.
#[derive(Default)]
struct Numbers {
    /// Skipped and repeated ones so far.
    counts: BTreeMap<Mac, (u64, u64)>,
    skipped: Vec<(Mac, f64, u64)>,
    repeated: Vec<(Mac, f64)>,
}

impl Numbers {
    /// Notes a record, and marks what it shows if it is wanted: of one that is not, the next one must not be charged.
    fn note(&mut self, survey: &Survey, mac: Mac, t_s: f64, is_wanted: bool) {
        let Some(sender) = survey.senders.get(&mac).filter(|sender| sender.counts_up()) else { return };
        let now = (sender.frames_skipped, sender.frames_repeated);
        let before = self.counts.insert(mac, now).unwrap_or_default();
        match (now.0.saturating_sub(before.0), now.1.saturating_sub(before.1)) {
            _ if !is_wanted => {}
            (0, 0) => {}
            (0, _) => self.repeated.push((mac, t_s)),
            (skipped, _) => self.skipped.push((mac, t_s, skipped)),
        }
    }

    fn settle(self, seen: &mut Seen) {
        let counts = |mac: &Mac| seen.survey.senders.get(mac).is_some_and(csi5300::source::survey::Sender::counts_up);
        seen.skipped = self.skipped.into_iter().filter(|mark| counts(&mark.0)).collect();
        seen.repeated = self.repeated.into_iter().filter(|mark| counts(&mark.0)).collect();
    }
}

/// Reads a log once; `each` takes the records that are wanted with their short row and sender. Times are those of the survey:
/// they are what `csi5300 info` counts.
pub(super) fn scan(
    path: &Path,
    base: TimeBase,
    wanted: &Wanted,
    mut each: impl FnMut(Row, &Identity, &Bfee<'_>),
) -> Result<Seen, Error> {
    let (mut source, mut survey, mut seen) = (Replay::open(path)?, Survey::default(), Seen::default());
    let (mut count, mut numbers) = (Step16::default(), Numbers::default());
    loop {
        let next = source.receive(Instant::ZERO)?;
        let (steps_back, bad, last_us) = (survey.clock_steps.steps_back, survey.bad_bfee, survey.clock_us);
        let before_s = survey.elapsed_us(base) as f64 * 1e-6;
        let noted = survey.note(&next);
        let offset = match next {
            Next::End(_) => break,
            Next::Record(stamps, _) => match stamps.origin {
                Origin::File { offset } => offset,
                Origin::Live { .. } => 0,
            },
            Next::Lost(_) => {
                seen.damaged.push(before_s);
                continue;
            }
            Next::Pending => continue,
        };
        if survey.bad_bfee > bad {
            seen.damaged.push(before_s);
        }
        let Some((bfee, identity)) = noted else { continue };
        let t_us = survey.elapsed_us(base);
        let t_s = t_us as f64 * 1e-6;
        if survey.clock_steps.steps_back > steps_back {
            let back_us = last_us.zip(survey.clock_us).map_or(0, |(last, now)| last.1.saturating_sub(now.1));
            seen.steps_back.push((t_s, back_us as f64 * 1e-6));
        }
        if let Some(step @ 2..) = count.step(bfee.bfee_count()).filter(|step| *step <= u16::MAX / 2) {
            seen.missing.push((t_s, u64::from(step - 1)));
        }
        let is_wanted = wanted.takes(identity.mac, t_s);
        numbers.note(&survey, identity.mac, t_s, is_wanted);
        if is_wanted {
            let row = Row { t_us, offset, rssi: bfee.rssi(), agc: bfee.agc() };
            seen.rows.push(row);
            each(row, &identity, &bfee);
        }
    }
    (seen.survey, seen.bytes) = (survey, source.bytes());
    numbers.settle(&mut seen);
    Ok(seen)
}
