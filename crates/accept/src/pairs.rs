//! Forward and backward frames of the exchanges of two cards.

use crate::collect::{Heard, HeardRecord, Plan};
use crate::stats::line;
use csi5300::exchange::pairing::LinkSide;
use csi5300::internal::{ByClock, CardClock, Refusal};
use csi5300::signal::cfo::{TurnAround, at_centre, round_trip_at_centre};
use csi5300::signal::channel::{Channel, SUBCARRIERS};
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, Antennas};
use num_complex::{Complex32, Complex64};
use std::collections::{BTreeMap, HashMap};

/// Exchanges of two cards: all frames that each heard of the other, paired by number, or by the cards' clocks without
/// numbers.
#[derive(Debug, Default)]
pub(crate) struct Pairs {
    /// Frames that each card heard of the other, each number once.
    pub frames: [usize; 2],
    /// Why frames without numbers could not be paired by the cards' clocks.
    pub refused: Option<Refusal>,
    /// The near robot sounds others too, so not all frames that the far card heard were for the far robot.
    pub among_others: bool,
    /// The near card's clock at each pair, microseconds.
    pub near_us: Vec<i64>,
    /// Far clock less near clock, microseconds.
    pub difference_us: Vec<i64>,
    /// Forward times backward at the channel centre, of antenna A.
    pub product: Vec<Complex64>,
    /// Forward times the conjugate of backward.
    pub ratio: Vec<Complex64>,
    /// One direction alone: the near card's CSI.
    pub one_way: Vec<Complex64>,
    /// Turn-around of each pair less the clocks' line, microseconds.
    pub turn_us: Vec<f64>,
    /// Drift of the far clock against the near one by that line, ppm, and its standard error.
    pub drift_ppm: Option<(f64, f64)>,
    /// The library's compensation of the product.
    pub compensation: Option<TurnAround>,
    /// The same of the ratio.
    pub ratio_compensation: Option<TurnAround>,
}

/// Antenna A's coefficients of the first stream; the first chain's if the record does not name A.
pub(crate) fn antenna_a(record: &HeardRecord) -> [Complex32; SUBCARRIERS] {
    let head = &record.head;
    let antennas = Antennas::new(head.antenna_sel, head.n_rx, head.rssi).ok();
    let chain = antennas.and_then(|antennas| antennas.chain_of(Antenna::A)).unwrap_or(0);
    column(record, chain)
}

/// The coefficients of one chain, first stream.
pub(crate) fn column(record: &HeardRecord, chain: usize) -> [Complex32; SUBCARRIERS] {
    let (n_rx, n_tx) = (usize::from(record.head.n_rx), usize::from(record.head.n_tx));
    std::array::from_fn(|k| {
        let iq = record.csi.get((k * n_rx + chain) * n_tx).copied().unwrap_or_default();
        Complex32::new(f32::from(iq.i), f32::from(iq.q))
    })
}

/// Senders of records with or without numbers, and how many each has.
fn senders(heard: &Heard, numbered: bool) -> BTreeMap<Mac, usize> {
    let mut counts = BTreeMap::new();
    for record in heard.records.iter().filter(|record| record.number.is_some() == numbered) {
        *counts.entry(record.mac).or_default() += 1;
    }
    counts
}

fn most(senders: BTreeMap<Mac, usize>) -> Option<Mac> {
    senders.into_iter().max_by_key(|(mac, count)| (*count, *mac)).map(|(mac, _)| mac)
}

/// The sender that most numbered records have.
pub(crate) fn usual_sender(heard: &Heard) -> Option<Mac> {
    most(senders(heard, true))
}

/// The near card's record and the far card's of each exchange.
struct Partners<'a> {
    pairs: Vec<(&'a HeardRecord, &'a HeardRecord)>,
    frames: [usize; 2],
    refused: Option<Refusal>,
}

fn by_number<'a>(near: &'a Heard, far: &'a Heard, [of_near, of_far]: [Mac; 2]) -> Partners<'a> {
    // A repeated number identifies no exchange.
    let mut heard_by_far: HashMap<u32, Option<&HeardRecord>> = HashMap::new();
    for record in far.records.iter().filter(|record| record.mac == of_near) {
        if let Some(number) = record.number {
            heard_by_far.entry(number).and_modify(|twice| *twice = None).or_insert(Some(record));
        }
    }
    let (mut pairs, mut frames, mut last) = (Vec::new(), 0, None);
    for record in near.records.iter().filter(|record| record.mac == of_far && record.number.is_some()) {
        if record.number == last {
            continue;
        }
        last = record.number;
        frames += 1;
        let other = record.number.and_then(|number| heard_by_far.get(&number).copied().flatten());
        pairs.extend(other.map(|other| (record, other)));
    }
    Partners { pairs, frames: [frames, heard_by_far.len()], refused: None }
}

fn by_clock<'a>(near: &'a Heard, far: &'a Heard, [of_near, of_far]: [Mac; 2]) -> Partners<'a> {
    // Whole microseconds, without wraps.
    const CLOCK: CardClock = CardClock { tick_ps: 1_000_000, bits: 64 };
    let mut machine = ByClock::new(CLOCK, CLOCK);
    for (side, heard, sender) in [(LinkSide::Receiver, near, of_far), (LinkSide::Transmitter, far, of_near)] {
        for record in heard.records.iter().filter(|record| record.mac == sender) {
            machine.handle(side, record.card_us.cast_unsigned(), record);
        }
    }
    let refused = machine.finish().err();
    let frames = [LinkSide::Receiver, LinkSide::Transmitter].map(|side| {
        let counts = machine.counts(side);
        counts.handed - counts.twice
    });
    let pairs = std::iter::from_fn(|| machine.poll_pair()).map(|pair| (pair.receiver, pair.transmitter)).collect();
    Partners { pairs, frames, refused }
}

impl Pairs {
    /// Pairs each frame that near heard of far with the frame of the same number that far heard of near. If near heard
    /// several robots, the one with the most coherent product is used.
    pub(crate) fn of(near: &Heard, far: &Heard, plan: &Plan) -> Self {
        let numbered = [near, far].iter().all(|heard| heard.records.iter().any(|record| record.number.is_some()));
        let Some(of_near) = plan.macs.map(|macs| macs[0]).or_else(|| most(senders(far, numbered))) else {
            return Self::default();
        };
        let of_far = |mac: &Mac| plan.macs.is_none_or(|macs| macs[1] == *mac);
        let pair = if numbered { by_number } else { by_clock };
        let candidates = senders(near, numbered).into_keys().filter(of_far);
        let candidates = candidates.map(|of_far| Self::with(pair(near, far, [of_near, of_far]), plan.channel));
        let (candidates, refused): (Vec<Self>, Vec<Self>) = candidates.partition(|pairs| pairs.len() > 0);
        if let (true, Some(refused)) =
            (candidates.is_empty(), refused.into_iter().find(|pairs| pairs.refused.is_some()))
        {
            return refused;
        }
        let most = candidates.iter().map(Self::len).max().unwrap_or(0);
        let coherence = |pairs: &Self| pairs.compensation.as_ref().map_or(0.0, |found| found.coherence_after);
        let likely = candidates.into_iter().filter(|pairs| 2 * pairs.len() >= most).map(|mut pairs| {
            pairs.compensate(plan.channel.centre_hz());
            pairs
        });
        let pairs = likely.max_by(|a, b| coherence(a).total_cmp(&coherence(b))).unwrap_or_default();
        let among_others = plan.macs.is_some() && senders(near, numbered).len() > 1;
        Self { among_others, ..pairs }
    }

    fn with(partners: Partners<'_>, channel: Channel) -> Self {
        let indices = channel.subcarriers();
        let mut pairs = Self { frames: partners.frames, refused: partners.refused, ..Self::default() };
        for (record, other) in partners.pairs {
            let (backward, forward) = (antenna_a(record), antenna_a(other));
            let conjugated = backward.map(|h| h.conj());
            let product = round_trip_at_centre(&forward, &backward, &indices);
            let ratio = round_trip_at_centre(&forward, &conjugated, &indices);
            let Some(((product, ratio), one_way)) = product.zip(ratio).zip(at_centre(&backward, &indices)) else {
                continue;
            };
            pairs.near_us.push(record.card_us);
            pairs.difference_us.push(other.card_us - record.card_us);
            pairs.product.push(product.h);
            pairs.ratio.push(ratio.h);
            pairs.one_way.push(one_way.h);
        }
        pairs.fit();
        pairs
    }

    /// The clocks' line through the pairs.
    fn fit(&mut self) {
        let (Some(&first_us), Some(&first_difference)) = (self.near_us.first(), self.difference_us.first()) else {
            return;
        };
        let points: Vec<(f64, f64)> = self
            .near_us
            .iter()
            .zip(&self.difference_us)
            .map(|(us, difference)| ((us - first_us) as f64, (difference - first_difference) as f64))
            .collect();
        if let Some((offset, slope, error)) = line(&points) {
            self.turn_us = points.iter().map(|(x, y)| y - offset - slope * x).collect();
            self.drift_ppm = Some((slope * 1e6, error * 1e6));
        }
    }

    /// The library's compensation of the phases.
    fn compensate(&mut self, carrier_hz: f64) {
        let difference_us: Vec<f64> = self.difference_us.iter().map(|us| *us as f64).collect();
        let estimate = |z: &[Complex64]| TurnAround::estimate(z, &self.near_us, &difference_us, carrier_hz);
        let (product, ratio) = (estimate(&self.product), estimate(&self.ratio));
        (self.compensation, self.ratio_compensation) = (product, ratio);
    }

    /// Pairs that were formed.
    pub(crate) fn len(&self) -> usize {
        self.product.len()
    }
}
