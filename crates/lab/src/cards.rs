//! Logs of cards other than the 5300: recognised by content; their frames counted, sorted by kind and timed.

use csi_formats::{Clock, Format, Frame, Item, RssiUnit, Why, detect};
use driver_iface::Mac;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

/// The kind and the bytes of another card's log; `None` for any other file, and for an unreadable one.
#[must_use]
pub fn read(path: &Path) -> Option<(Format, Vec<u8>)> {
    let (format, mut file, mut bytes) = begun(path)?;
    file.read_to_end(&mut bytes).ok()?;
    Some((format, bytes))
}

/// True for a log of another card.
#[must_use]
pub fn is_log(path: &Path) -> bool {
    begun(path).is_some()
}

/// File extensions of other cards' logs; other files have them, too.
const ENDS: [&str; 3] = ["csi", "pcap", "csv"];

/// True for a log: a 5300's by its name, another card's by its content, too.
#[must_use]
pub fn is_named_as_log(path: &Path) -> bool {
    let Some(end) = path.extension().and_then(|end| end.to_str()) else { return false };
    end == "dat" || ENDS.contains(&end) && is_log(path)
}

/// True if the first bytes of a file are a log's.
fn begun(path: &Path) -> Option<(Format, std::fs::File, Vec<u8>)> {
    // A pipe can be opened and read only once.
    let mut file = path.is_file().then(|| std::fs::File::open(path).ok()).flatten()?;
    let mut bytes = Vec::new();
    file.by_ref().take(csi_formats::DETECT as u64).read_to_end(&mut bytes).ok()?;
    Some((detect(&bytes)?, file, bytes))
}

/// The content of another card's log, as `info --json` prints it.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct CardSurvey {
    /// Frames with CSI.
    pub frames: u64,
    /// Frames by the card that measured them.
    pub cards: BTreeMap<String, u64>,
    /// Frames by kind, width, chains and number of subcarriers.
    pub shapes: BTreeMap<String, u64>,
    /// Frames by sender; all zero stands for an unknown one.
    #[serde(skip)]
    pub senders: BTreeMap<Mac, u64>,
    /// Time from the first to the last frame by the host's clock, seconds; `None` if the log does not contain it.
    pub host_span_s: Option<f64>,
    /// Bytes that are not frames with CSI, by reason.
    pub skipped: BTreeMap<String, u64>,
    /// The most receive chains in one frame.
    #[serde(skip)]
    pub n_rx: usize,
    /// Frames were lost: more than frames without CSI or a cut end of the log.
    #[serde(skip)]
    pub is_damaged: bool,
    #[serde(skip)]
    first_us: Option<i64>,
}

impl CardSurvey {
    /// Counts the next item of a log.
    pub fn note(&mut self, item: &Item) {
        match item {
            Item::Frame(frame) => {
                self.frames += 1;
                self.n_rx = self.n_rx.max(frame.n_rx);
                *self.cards.entry(frame.card.to_string()).or_default() += 1;
                *self.shapes.entry(shape(frame)).or_default() += 1;
                *self.senders.entry(sender(frame)).or_default() += 1;
                if let Some(host_us) = frame.host_us {
                    let first_us = *self.first_us.get_or_insert(host_us);
                    self.host_span_s = Some((host_us - first_us) as f64 * 1e-6);
                }
            }
            Item::Skipped(bad) => {
                *self.skipped.entry(bad.why.to_string()).or_default() += bad.len;
                self.is_damaged |= is_damage(bad.why);
            }
        }
    }
}

/// True if the bytes should have been a frame: not a frame without CSI, nor the cut end of the log.
#[must_use]
pub fn is_damage(why: Why) -> bool {
    !matches!(why, Why::NoCsi | Why::Cut)
}

/// The sender of a frame; all zero if unknown.
pub(crate) fn sender(frame: &Frame) -> Mac {
    Mac(frame.sender.unwrap_or_default())
}

fn shape(frame: &Frame) -> String {
    let kind = frame.kind.map_or("", csi_formats::Kind::name);
    let (width, n) = (frame.width_mhz, frame.subcarriers.len());
    format!("{kind} {width} MHz, {}x{} chains, {n} subcarriers", frame.n_rx, frame.n_tx).trim_start().to_owned()
}

/// What frames must share for their subcarriers to be comparable.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Layout {
    pub width_mhz: u16,
    pub kind: Option<&'static str>,
    pub subcarriers: Vec<i16>,
    pub measured: Vec<bool>,
}

impl Layout {
    pub(crate) fn of(frame: &Frame) -> Self {
        Self {
            width_mhz: frame.width_mhz,
            kind: frame.kind.map(csi_formats::Kind::name),
            subcarriers: frame.subcarriers.clone(),
            measured: frame.measured.clone(),
        }
    }

    /// True if a frame has this layout.
    pub(crate) fn holds(&self, frame: &Frame) -> bool {
        self.width_mhz == frame.width_mhz
            && self.kind == frame.kind.map(csi_formats::Kind::name)
            && self.subcarriers == frame.subcarriers
            && self.measured == frame.measured
    }

    /// Kind and width.
    pub(crate) fn words(&self) -> String {
        format!("{} {} MHz", self.kind.unwrap_or_default(), self.width_mhz).trim_start().to_owned()
    }
}

/// The most frequent of some values.
pub(crate) fn most_frequent<T: Ord + Copy>(values: impl Iterator<Item = T>) -> Option<T> {
    let mut counts: BTreeMap<T, u64> = BTreeMap::new();
    values.for_each(|value| *counts.entry(value).or_default() += 1);
    counts.into_iter().max_by_key(|(_, count)| *count).map(|(value, _)| value)
}

/// True if RSSI is in dBm.
pub(crate) fn is_dbm(frame: &Frame) -> bool {
    frame.rssi_unit == RssiUnit::Dbm
}

/// A card's wrapping clock as picoseconds since the first reading. Backward steps take no time.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct CardTime {
    last: Option<(Clock, Option<i64>)>,
    ps: u128,
}

impl CardTime {
    /// A frame's time since the first reading, and by how much the clock stepped back before it; `None` without a reading.
    ///
    /// A step of more than half the counter's range is a backward one, unless the host's clock advanced as far.
    pub(crate) fn of(&mut self, frame: &Frame) -> Option<(u128, u128)> {
        // The coarse clock wraps later and is fine enough here.
        let clock = frame.slow_clock.or(frame.clock)?;
        let mask = if clock.bits >= 64 { u64::MAX } else { (1 << clock.bits) - 1 };
        let tick_ps = u128::from(clock.tick_ps);
        let Some((last, last_us)) = self.last.replace((clock, frame.host_us)) else { return Some((0, 0)) };
        let went = clock.ticks.wrapping_sub(last.ticks) & mask;
        let host_ps = frame.host_us.zip(last_us).map(|(now, last)| i128::from(now - last) * 1_000_000);
        let half = mask / 2 + 1;
        let is_back = went >= half && host_ps.is_none_or(|ps| ps < (u128::from(half) * tick_ps).cast_signed());
        if is_back {
            return Some((self.ps, u128::from(went.wrapping_neg() & mask) * tick_ps));
        }
        self.ps += u128::from(went) * tick_ps;
        Some((self.ps, 0))
    }
}
