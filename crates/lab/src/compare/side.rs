//! Measures what one robot's log shows of its card, driver and host.

use super::distribution::{Distribution, QUARTILES};
use super::figures::{LOST_US, LateGroup};
use csi5300::internal::SENDERS_KEPT;
use csi5300::internal::drift_line;
use csi5300::maths::wrap_rad;
use csi5300::signal::channel::SUBCARRIERS;
use csi5300::source::survey::{Identity, Survey};
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::{Instant, Unwrap32};
use driver_iface::Mac;
use driver_iface::bfee::{ALL_SUBCARRIERS, Antenna, Bfee, Iq};
use driver_iface::record::Tail;
use num_complex::Complex64;
use std::collections::BTreeMap;

/// Figures of one sender's frames in one log.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct SideFigures {
    /// Intact bfee records of the sender.
    pub records: usize,
    /// Those of them in the stock layout.
    pub stock: usize,
    /// Intact bfee records of other senders, which no other figure includes.
    pub of_others: usize,
    /// Records by length on disk, bytes.
    pub lengths: BTreeMap<usize, u64>,
    /// Records by receive chains and streams, `10 n_rx + n_tx`.
    pub streams: BTreeMap<usize, u64>,
    /// Records by `noise`, dBm.
    pub noise_dbm: BTreeMap<i8, u64>,
    /// Records by `fake_rate_n_flags`.
    pub rates: BTreeMap<u16, u64>,
    /// Records by `antenna_sel`.
    pub antenna_sel: BTreeMap<u8, u64>,
    /// RSSI of antennas A, B, C, dB.
    pub rssi_db: [Distribution; 3],
    /// Gain, dB.
    pub agc_db: Distribution,
    /// Root mean square of the coefficients of antennas A, B, C, ADC steps.
    pub level: [Distribution; 3],
    /// Share of frame numbers that are missing between the first and the last.
    pub missing: f64,
    /// Time between frames of consecutive numbers on the card's clock, microseconds.
    pub interval_us: Distribution,
    /// Unusually late frames: by at least twice the interquartile range.
    pub delayed: LateGroup,
    /// The same on the host's clock.
    pub host_interval_us: Distribution,
    /// Host time minus card time without its drift, microseconds; its median is about 0.
    pub latency_us: Distribution,
    /// Standard deviation of its core: that of a normal distribution with the same shortest half, microseconds.
    pub latency_core_us: f64,
    /// How much faster the card's clock runs than the host's, parts per million.
    pub card_ppm: f64,
    /// Slope of the phase, radians per subcarrier index, antenna A.
    pub slope_rad: Distribution,
    /// Ripple of the magnitude over the subcarriers, standard deviation over mean, antenna A.
    pub ripple: Distribution,
    /// Mean magnitude of each subcarrier relative to the root mean square of all, antenna A: the filters' effect.
    pub filter: [f64; SUBCARRIERS],
    /// Signal to noise ratio of single subcarriers, from their change between packets, antenna A, dB.
    pub tone_snr_db: f64,
    /// First and last host time, microseconds since the Unix epoch.
    pub host_us: Option<(i64, i64)>,
    /// First and last time on the card's clock, unwrapped microseconds.
    pub clock_us: Option<(i64, i64)>,
    /// Bytes of a cut last record.
    pub tail_bytes: usize,
    /// Power at antenna A, RSSI minus gain, dB, by host time, seconds since the Unix epoch.
    #[serde(skip)]
    pub powers: Vec<(f64, f64)>,
}

/// Passes a source's items on and measures its records.
pub struct Observed<'a> {
    source: &'a mut (dyn CsiSource + Send),
    indices: [i8; SUBCARRIERS],
    survey: Survey,
    unwrap: Unwrap32,
    senders: BTreeMap<Mac, Collector>,
}

impl<'a> Observed<'a> {
    /// Measures `source`; the subcarrier `indices` are those of its channel.
    pub fn new(source: &'a mut (dyn CsiSource + Send), indices: [i8; SUBCARRIERS]) -> Self {
        Self { source, indices, survey: Survey::default(), unwrap: Unwrap32::default(), senders: BTreeMap::new() }
    }

    /// The figures of one sender; by default the one with the most numbered frames.
    #[must_use]
    pub fn finish(mut self, sender: Option<Mac>) -> SideFigures {
        let most = || self.senders.iter().max_by_key(|(_, collector)| collector.frames).map(|(mac, _)| *mac);
        let collector = sender.or_else(most).and_then(|mac| self.senders.remove(&mac));
        let mut side = collector.map_or_else(SideFigures::default, Collector::finish);
        side.of_others = (self.survey.bfees() as usize).saturating_sub(side.records);
        side.tail_bytes = match self.survey.tail {
            Some(Tail::Cut { bytes, .. }) => bytes as usize,
            _ => 0,
        };
        side
    }

    fn note(
        survey: &mut Survey,
        unwrap: &mut Unwrap32,
        senders: &mut BTreeMap<Mac, Collector>,
        next: &Next<'_>,
        indices: [i8; SUBCARRIERS],
    ) {
        let Some((bfee, identity)) = survey.note(next) else { return };
        let clock_us = unwrap.next(bfee.timestamp_low());
        if senders.len() >= SENDERS_KEPT && !senders.contains_key(&identity.mac) {
            return;
        }
        let new = || Collector { indices, ..Collector::default() };
        let length = if let Next::Record(_, record) = next { record.emit_len() } else { 0 };
        senders.entry(identity.mac).or_insert_with(new).note(&bfee, identity, clock_us, length);
    }
}

impl CsiSource for Observed<'_> {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        let next = self.source.receive(now)?;
        Self::note(&mut self.survey, &mut self.unwrap, &mut self.senders, &next, self.indices);
        Ok(next)
    }

    fn next_at(&self) -> Option<Instant> {
        self.source.next_at()
    }
}

/// Values collected from one sender's frames.
#[derive(Default)]
struct Collector {
    indices: [i8; SUBCARRIERS],
    last: Option<LastFrame>,
    /// Frames with a number.
    frames: usize,
    /// Numbers present, and numbers expected.
    numbers: (u64, u64),
    side: SideFigures,
    rssi: [Vec<f64>; 3],
    agc: Vec<f64>,
    level: [Vec<f64>; 3],
    intervals: [Vec<f64>; 2],
    clocks: Vec<i64>,
    ahead: Vec<i64>,
    slopes: Vec<f64>,
    ripples: Vec<f64>,
    /// The last two packets, without slope and mean phase.
    rows: [Tones; 2],
    /// Noise power, and the number of tones it was summed over.
    noise: (f64, f64),
}

type Tones = [Complex64; SUBCARRIERS];

#[derive(Clone, Copy)]
struct LastFrame {
    number: u32,
    clock_us: i64,
    host_us: Option<i64>,
}

impl Collector {
    fn note(&mut self, bfee: &Bfee<'_>, identity: Identity, clock_us: i64, length: usize) {
        *self.side.lengths.entry(length).or_default() += 1;
        self.fields(bfee);
        self.tones(bfee);
        if let Some(host_us) = identity.host_us {
            let power_db = f64::from(bfee.rssi()[0]) - f64::from(bfee.agc());
            self.side.powers.push((host_us as f64 * 1e-6, power_db));
            self.clocks.push(clock_us);
            self.ahead.push(host_us - clock_us);
            self.side.host_us = Some((self.side.host_us.map_or(host_us, |(first, _)| first), host_us));
        }
        self.step(identity, clock_us);
    }

    fn fields(&mut self, bfee: &Bfee<'_>) {
        let side = &mut self.side;
        side.records += 1;
        side.stock += usize::from(bfee.wsr().is_none());
        *side.streams.entry(10 * bfee.n_rx() + bfee.n_tx()).or_default() += 1;
        *side.noise_dbm.entry(bfee.noise_dbm()).or_default() += 1;
        *side.rates.entry(bfee.rate_n_flags()).or_default() += 1;
        *side.antenna_sel.entry(bfee.antenna_sel()).or_default() += 1;
        self.agc.push(f64::from(bfee.agc()));
        for (values, rssi) in self.rssi.iter_mut().zip(bfee.rssi()) {
            values.push(f64::from(rssi));
        }
    }

    fn tones(&mut self, bfee: &Bfee<'_>) {
        let mut iq = [Iq::default(); SUBCARRIERS];
        for antenna in 0..Antenna::ALL.len() {
            let Some(chain) = bfee.chain_of(Antenna::ALL[antenna]) else { continue };
            if bfee.column(chain, 0, &ALL_SUBCARRIERS, &mut iq).is_none() {
                continue;
            }
            let tones = iq.map(|iq| Complex64::new(f64::from(iq.i), f64::from(iq.q)));
            let rms = (tones.iter().map(Complex64::norm_sqr).sum::<f64>() / SUBCARRIERS as f64).sqrt();
            self.level[antenna].push(rms);
            if antenna == 0 && rms > 0.0 {
                let (slope, row) = flattened(&tones, rms, &self.indices);
                self.slopes.push(slope);
                self.side.filter.iter_mut().zip(&row).for_each(|(sum, h)| *sum += h.norm());
                let mean = row.iter().map(|h| h.norm()).sum::<f64>() / SUBCARRIERS as f64;
                self.ripples.push((1.0 - mean * mean).max(0.0).sqrt() / mean);
                change(&mut self.rows, &mut self.noise, row);
            }
        }
    }

    /// The step from the last frame to this one.
    fn step(&mut self, identity: Identity, clock_us: i64) {
        let Some(number) = identity.frame_count else { return };
        let this = LastFrame { number, clock_us, host_us: identity.host_us };
        self.frames += 1;
        let Some(before) = self.last.replace(this) else { return };
        let ahead = number.wrapping_sub(before.number);
        // A restart or a repeated number is not a gap.
        if (1..1_000).contains(&ahead) {
            self.numbers = (self.numbers.0 + 1, self.numbers.1 + u64::from(ahead));
        }
        if ahead == 1 {
            self.intervals[0].push((clock_us - before.clock_us) as f64);
            self.intervals[1].extend(this.host_us.zip(before.host_us).map(|(now, then)| (now - then) as f64));
        }
    }

    fn finish(self) -> SideFigures {
        let mut side = self.side;
        side.rssi_db = self.rssi.map(|values| Distribution::of(&values));
        side.level = self.level.map(|values| Distribution::of(&values));
        side.agc_db = Distribution::of(&self.agc);
        side.filter.iter_mut().for_each(|sum| *sum /= self.ripples.len().max(1) as f64);
        side.delayed = delayed(&self.intervals[0]);
        [side.interval_us, side.host_interval_us] = self.intervals.map(|values| Distribution::of(&values));
        side.slope_rad = Distribution::of(&self.slopes);
        side.ripple = Distribution::of(&self.ripples);
        let (there, all) = self.numbers;
        side.missing = if all == 0 { 0.0 } else { 1.0 - there as f64 / all as f64 };
        side.tone_snr_db = if self.noise.0 > 0.0 { -10.0 * (self.noise.0 / self.noise.1).log10() } else { f64::NAN };
        side.clock_us = self.clocks.first().copied().zip(self.clocks.last().copied());
        if let (8.., Some(&first)) = (self.ahead.len(), self.ahead.first()) {
            // Relative to the first: a double has too few digits for parts per million of microseconds since 1970.
            let ahead: Vec<i64> = self.ahead.iter().map(|ahead| ahead - first).collect();
            let line = drift_line(&self.clocks, &ahead);
            let late = self.clocks.iter().zip(&ahead).map(|(&clock, &ahead)| ahead as f64 - line.at(clock as f64));
            let late: Vec<f64> = late.collect();
            side.latency_us = Distribution::of(&late);
            side.latency_core_us = shortest_half(late) / QUARTILES;
            let from = self.clocks.first().map_or(0.0, |&clock| clock as f64);
            side.card_ppm = -(line.at(from + 1e6) - line.at(from));
        }
        side
    }
}

/// Unusually late frames. A late frame makes one interval longer and the next one shorter, so only the long ones are counted.
fn delayed(intervals_us: &[f64]) -> LateGroup {
    let usual = Distribution::of(intervals_us);
    let late = intervals_us.iter().map(|interval| interval - usual.median);
    let late: Vec<f64> = late.filter(|&late| late > 2.0 * usual.quartile_range() && late < LOST_US).collect();
    let d = Distribution::of(&late);
    LateGroup { share: late.len() as f64 / intervals_us.len().max(1) as f64, mean_us: d.mean, sd_us: d.sd }
}

/// The most frequent value.
pub(super) fn usual<K: Copy>(counts: &BTreeMap<K, u64>) -> Option<K> {
    counts.iter().max_by_key(|(_, count)| **count).map(|(key, _)| *key)
}

/// Length of the shortest interval that holds half of the values: a few outliers on one side do not widen it.
fn shortest_half(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let lengths = values.iter().zip(values.iter().skip(values.len() / 2)).map(|(from, to)| to - from);
    lengths.min_by(f64::total_cmp).unwrap_or(0.0)
}

/// Power of the second difference of each subcarrier over time: six times its noise power.
fn change(rows: &mut [Tones; 2], noise: &mut (f64, f64), row: Tones) {
    if rows[0].iter().any(|h| *h != Complex64::default()) {
        let second = (0..SUBCARRIERS).map(|k| (rows[0][k] - 2.0 * rows[1][k] + row[k]).norm_sqr() / 6.0);
        noise.0 += second.sum::<f64>();
        noise.1 += SUBCARRIERS as f64;
    }
    *rows = [rows[1], row];
}

/// The phase slope per subcarrier index, and the tones at unit power without slope and mean phase.
fn flattened(tones: &Tones, rms: f64, indices: &[i8; SUBCARRIERS]) -> (f64, Tones) {
    let usual = indices[1] - indices[0];
    let steps = (1..SUBCARRIERS).filter(|&k| indices[k] - indices[k - 1] == usual);
    let rough = steps.map(|k| tones[k] * tones[k - 1].conj()).sum::<Complex64>().arg() / f64::from(usual);
    let flat = |slope: f64, phase: f64| -> Tones {
        std::array::from_fn(|k| tones[k] * Complex64::from_polar(1.0 / rms, -slope * f64::from(indices[k]) - phase))
    };
    let mean = |row: &Tones| row.iter().sum::<Complex64>().arg();
    let once = flat(rough, 0.0);
    let phase = mean(&once);
    // After the rough slope, only a small tilt about the mean remains.
    let (mut sum_xx, mut sum_xy) = (0.0, 0.0);
    for (h, &index) in once.iter().zip(indices) {
        let x = f64::from(index);
        sum_xx += h.norm_sqr() * x * x;
        sum_xy += h.norm_sqr() * x * wrap_rad(h.arg() - phase);
    }
    let slope = rough + if sum_xx > 0.0 { sum_xy / sum_xx } else { 0.0 };
    let twice = flat(slope, 0.0);
    let phase = mean(&twice);
    (slope, twice.map(|h| h * Complex64::cis(-phase)))
}
