//! Reads logs of cards other than the 5300 as rows.

use super::{Cells, HeatRows, LogIndex, Marks, NO_RSSI, Source, gaps, numbered, span_s};
use crate::cards::{CardSurvey, CardTime, Layout, is_damage, is_dbm, sender};
use csi_formats::{Format, Frame, Item, Items};
use csi5300::source::survey::TimeBase;
use driver_iface::bfee::{Antenna, Antennas};
use num_complex::Complex32;
use std::path::Path;

/// A log of another card, besides its rows.
pub(super) struct CardLog {
    pub format: Format,
    pub survey: CardSurvey,
    /// [`LogIndex`] has an index into these of each row.
    layouts: Vec<Layout>,
    /// The displayed stream: the log's first one.
    stream: usize,
}

/// The antenna of a chain: a 5300 reports it; with other cards chains are numbered.
fn port_of(frame: &Frame, chain: usize) -> usize {
    let told = frame.antenna_sel.zip(u8::try_from(frame.n_rx).ok());
    let antennas = told.and_then(|(sel, n_rx)| Antennas::new(sel, n_rx, [0; 3]).ok());
    let is_it = |antenna: &Antenna| antennas.and_then(|antennas| antennas.chain_of(*antenna)) == Some(chain);
    let told = Antenna::ALL.into_iter().find(is_it).map(Antenna::index);
    told.unwrap_or(usize::from(frame.first_rx) + chain)
}

/// Time since the first frame by both clocks, microseconds.
#[derive(Default)]
struct Times {
    card: CardTime,
    card_us: Vec<i64>,
    has_card: bool,
    host_us: Vec<i64>,
    last_host_us: Option<i64>,
    /// By row, seconds.
    steps_back: Vec<(usize, f64)>,
}

impl Times {
    fn note(&mut self, frame: &Frame) {
        let told = self.card.of(frame);
        self.has_card |= told.is_some();
        let before = self.card_us.last().copied().unwrap_or(0);
        let us = told.map_or(before, |(ps, _)| i64::try_from(ps / 1_000_000).unwrap_or(i64::MAX));
        self.steps_back.extend(
            told.filter(|(_, back_ps)| *back_ps > 0).map(|(_, back_ps)| (self.card_us.len(), back_ps as f64 * 1e-12)),
        );
        self.card_us.push(us);
        let step = frame.host_us.and_then(|now| Some(now.saturating_sub(self.last_host_us?)));
        self.last_host_us = frame.host_us.or(self.last_host_us);
        self.host_us.push(self.host_us.last().copied().unwrap_or(0).saturating_add(step.unwrap_or(0).max(0)));
    }

    /// The source of the times, and the times: the card's clock; the host's if the card's stands still or is missing; or numbers.
    fn settle(self) -> (TimeBase, Vec<i64>, Vec<(usize, f64)>) {
        let (card, host) = (self.card_us.last().copied().unwrap_or(0), self.host_us.last().copied().unwrap_or(0));
        if card > 0 || self.has_card && self.card_us.len() < 2 {
            (TimeBase::Card, self.card_us, self.steps_back)
        } else if host > 0 {
            (TimeBase::Host, self.host_us, Vec::new())
        } else {
            let numbers = (0..self.card_us.len() as i64).map(|number| number.saturating_mul(1_000_000));
            (TimeBase::Number, numbers.collect(), Vec::new())
        }
    }
}

/// Reads the rows of a log.
pub(super) fn open(path: &Path, format: Format, bytes: &[u8]) -> LogIndex {
    let (mut survey, mut times, mut marks) = (CardSurvey::default(), Times::default(), Marks::default());
    let (mut layouts, mut layout_of): (Vec<Layout>, Vec<u16>) = (Vec::new(), Vec::new());
    let (mut macs, mut offset) = (Vec::new(), Vec::new());
    // By row and port; the number of ports is only known at the end.
    let mut levels: Vec<(usize, usize, i16)> = Vec::new();
    let (mut ports, mut stream, mut rssi_in_dbm) = (0, usize::MAX, false);
    for item in Items::new(format, bytes) {
        survey.note(&item);
        let frame = match item {
            Item::Frame(frame) => frame,
            Item::Skipped(skipped) => {
                marks.damaged.extend(is_damage(skipped.why).then(|| (offset.len().saturating_sub(1), 1)));
                continue;
            }
        };
        times.note(&frame);
        let known = layouts.iter().rposition(|layout| layout.holds(&frame)).unwrap_or_else(|| {
            layouts.push(Layout::of(&frame));
            layouts.len() - 1
        });
        layout_of.push(u16::try_from(known).unwrap_or(u16::MAX));
        for chain in 0..frame.n_rx {
            let port = port_of(&frame, chain);
            ports = ports.max(port + 1);
            levels.extend(frame.rssi.get(chain).copied().flatten().map(|rssi| (offset.len(), port, rssi)));
        }
        stream = stream.min(usize::from(frame.first_tx));
        rssi_in_dbm = is_dbm(&frame);
        macs.push(sender(&frame));
        offset.push(i64::try_from(frame.offset).unwrap_or(-1));
    }
    let mut rssi = vec![NO_RSSI; offset.len() * ports];
    for (row, port, value) in levels {
        rssi.get_mut(row * ports + port).into_iter().for_each(|place| *place = value);
    }
    let (base, t_us, steps_back) = times.settle();
    marks.steps_back = steps_back;
    let times_s: Vec<f64> = t_us.iter().map(|us| *us as f64 * 1e-6).collect();
    let (senders, sent_by) = numbered(macs.into_iter());
    LogIndex {
        path: path.into(),
        base,
        source: Source::Card(Box::new(CardLog { format, survey, layouts, stream })),
        bytes: bytes.len() as u64,
        span_s: span_s(&times_s).unwrap_or_default(),
        gaps_s: gaps(&times_s),
        t_us,
        offset,
        ports,
        rssi,
        rssi_in_dbm,
        agc: Vec::new(),
        layout_of,
        sent_by,
        senders,
        marks,
        kept: None,
    }
}

/// Positions of a layout's subcarriers in the order of their indices, without those outside the measured range.
fn places(layout: &Layout) -> Vec<usize> {
    let mut places: Vec<usize> = (0..layout.subcarriers.len()).collect();
    places.sort_by_key(|place| layout.subcarriers.get(*place));
    let is_measured = |place: &usize| layout.measured.get(*place) == Some(&true);
    let end = places.iter().rposition(is_measured).map_or(0, |last| last + 1);
    let first = places.iter().position(is_measured).unwrap_or(0).min(end);
    places.drain(first..end).collect()
}

impl CardLog {
    /// See [`LogIndex::heat_rows`].
    pub(super) fn heat_rows(&self, layout: u16, most: usize) -> HeatRows {
        let Some(layout) = self.layouts.get(usize::from(layout)) else { return HeatRows::default() };
        let indices: Vec<i16> =
            places(layout).iter().filter_map(|place| layout.subcarriers.get(*place).copied()).collect();
        let subcarriers = indices.len();
        HeatRows { frames: Some(layout.words()), ..HeatRows::new(Some(indices), subcarriers, most) }
    }

    /// CSI of the frames at these offsets of the log, each with its column, by antenna.
    pub(super) fn cells(
        &self,
        bytes: &[u8],
        wanted: impl Iterator<Item = (i64, usize)>,
        (layout, heat): (u16, &HeatRows),
        ports: usize,
        columns: usize,
    ) -> Vec<Cells> {
        let Some(layout) = self.layouts.get(usize::from(layout)).filter(|_| !heat.is_empty()) else {
            return Vec::new();
        };
        let places = places(layout);
        let is_measured = |place: usize| layout.measured.get(place) == Some(&true);
        let mut each = vec![0.0; heat.len()];
        for (k, _) in places.iter().enumerate().filter(|(_, place)| is_measured(**place)) {
            each.get_mut(k / heat.each).into_iter().for_each(|count| *count += 1.0);
        }
        let half = places.split_at(places.len() / 2);
        let middle = half.1.iter().chain(half.0.iter().rev()).copied().find(|place| is_measured(*place));
        let mut cells = vec![Cells::new(columns, each); ports];
        let mut wanted = wanted.peekable();
        for item in Items::new(self.format, bytes) {
            let Item::Frame(frame) = item else { continue };
            let offset = i64::try_from(frame.offset).unwrap_or(i64::MAX);
            // Frames that are gone are skipped.
            while wanted.next_if(|(wanted, _)| *wanted < offset).is_some() {}
            let Some((_, column)) = wanted.next_if(|(wanted, _)| *wanted == offset) else {
                if wanted.peek().is_none() {
                    break;
                }
                continue;
            };
            let Some(stream) = self.stream.checked_sub(frame.first_tx.into()).filter(|_| layout.holds(&frame)) else {
                continue;
            };
            for chain in 0..frame.n_rx {
                let (Some(h), Some(cells)) = (frame.column(chain, stream), cells.get_mut(port_of(&frame, chain)))
                else {
                    continue;
                };
                let value = |place: usize| h.get(place).map(|[re, im]| Complex32::new(*re, *im));
                let rows = places.iter().enumerate().filter(|(_, place)| is_measured(**place));
                let values = rows.filter_map(|(k, place)| Some((k / heat.each, value(*place)?)));
                cells.add(column, middle.and_then(value).unwrap_or_default(), values);
            }
        }
        cells
    }
}
