//! A display of a running capture: rates, losses, senders, signal, channel.

use csi5300::internal::SENDERS_KEPT;
use csi5300::source::Next;
use csi5300::source::survey::Survey;
use csi5300::time::{Instant, Span};
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, Bfee, SUBCARRIERS};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Bars of a sparkline, lowest first.
const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// Losses on the way to the disk and in the kernel, as counted by socket, pipe and recorder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Losses {
    /// Messages or packets that the kernel dropped for lack of room.
    pub kernel: u64,
    /// Records missing before that: numbers missing from `bfee_count`, or CSI without a record.
    pub driver: u64,
    /// Records that the log does not have: disk too slow, full or failing.
    pub disk: u64,
}

/// The last CSI of one antenna: magnitudes, unscaled.
type Picture = (Antenna, [f32; SUBCARRIERS]);

/// A running view of a source.
#[derive(Debug, Default)]
pub struct Status {
    /// Everything since the start.
    pub survey: Survey,
    /// When the first record came.
    pub first_at: Option<Instant>,
    /// When the last record came.
    pub last_at: Option<Instant>,
    pictures: Vec<Picture>,
    rssi: [u8; 3],
    window_from: Instant,
    window: BTreeMap<Mac, u64>,
    rates_hz: Vec<(Mac, f64)>,
}

impl Status {
    /// A view that begins now.
    #[must_use]
    pub fn new(now: Instant) -> Self {
        Self { window_from: now, ..Self::default() }
    }

    /// Counts what a source gave.
    pub fn note(&mut self, now: Instant, next: &Next<'_>) {
        if matches!(next, Next::Record(..)) {
            self.first_at.get_or_insert(now);
            self.last_at = Some(now);
        }
        if let Some((bfee, identity)) = self.survey.note(next) {
            if self.window.len() < SENDERS_KEPT || self.window.contains_key(&identity.mac) {
                *self.window.entry(identity.mac).or_default() += 1;
            }
            self.rssi = bfee.rssi();
            // One picture for each look: `refresh` clears them.
            if self.pictures.is_empty() {
                self.pictures = pictures(&bfee);
            }
        }
    }

    /// Closes the window over which rates are counted.
    pub fn refresh(&mut self, now: Instant) {
        let seconds = (now - self.window_from).as_s();
        if seconds > 0.0 {
            self.rates_hz = self.window.iter().map(|(mac, count)| (*mac, *count as f64 / seconds)).collect();
            // Silent senders are removed.
            self.window.retain(|_, count| std::mem::take(count) > 0);
            self.window_from = now;
        }
    }

    /// Everything on one line, and readiness for the next picture.
    pub fn line(&mut self, losses: Losses) -> String {
        let rate: f64 = self.rates_hz.iter().map(|(_, rate)| rate).sum();
        let mut text = format!("{} records, {rate:.0}/s", self.survey.came());
        let _ = write!(text, "; lost {}", losses.kernel + losses.driver + losses.disk);
        let heard = self.rates_hz.iter().filter(|(_, rate)| *rate > 0.0).count();
        let _ = write!(text, "; {heard} senders; RSSI {}", rssi(self.rssi));
        if let Some((antenna, magnitude)) = self.pictures.first() {
            let _ = write!(text, "; {antenna} {}", sparkline(magnitude));
        }
        self.pictures.clear();
        text
    }

    /// A page for a terminal, and readiness for the next picture.
    pub fn page(&mut self, now: Instant, title: &str, losses: Losses) -> String {
        let survey = &self.survey;
        let mut text = format!("csi5300  {title}\n\n");
        let seconds = self.first_at.map_or(Span::default(), |first| now - first).as_s();
        let silent = self.last_at.map_or(0.0, |last| (now - last).as_s());
        let _ = writeln!(text, "records   {:>10}   {:>8} bfee   {seconds:>7.0} s", survey.came(), survey.bfees());
        let Losses { kernel, driver, disk } = losses;
        let _ = writeln!(text, "lost      {kernel:>10} in the kernel   {driver:>8} before it   {disk:>8} at the disk");
        let _ = writeln!(text, "damaged   {:>10} datagrams, {} bfee", survey.damages, survey.bad_bfee);
        let agc = survey.agc.unwrap_or_default();
        let _ = writeln!(text, "RSSI      {}   AGC {} to {} dB", rssi(self.rssi), agc.min, agc.max);
        if silent > 1.0 {
            let _ = writeln!(text, "nothing for {silent:.0} s: `csi5300 doctor` reports what may be wrong");
        }
        text.push_str("\nsender              now/s     all\n");
        for (mac, rate) in &self.rates_hz {
            let name = if mac.is_zero() { "unknown".to_string() } else { mac.to_string() };
            let all = survey.senders.get(mac).map_or(0, |sender| sender.records);
            let _ = writeln!(text, "{name:17} {rate:>7.0} {all:>7}");
        }
        text.push_str("\n|CSI|, subcarriers from low to high\n");
        for (antenna, magnitude) in &self.pictures {
            let _ = writeln!(text, "  {antenna} {}", sparkline(magnitude));
        }
        self.pictures.clear();
        text
    }
}

fn rssi(rssi: [u8; 3]) -> String {
    rssi.map(|value| if value == 0 { "-".to_string() } else { value.to_string() }).join("/")
}

fn pictures(bfee: &Bfee<'_>) -> Vec<Picture> {
    let Ok(antennas) = bfee.antennas() else { return Vec::new() };
    let mut pictures = Vec::with_capacity(3);
    for (chain, &antenna) in antennas.as_slice().iter().enumerate() {
        if let Some(iq) = bfee.column(chain, 0) {
            pictures.push((antenna, iq.map(|iq| f32::from(iq.i).hypot(f32::from(iq.q)))));
        }
    }
    pictures.sort_by_key(|(antenna, _)| *antenna);
    pictures
}

/// Values as bars from zero to the largest of them.
#[must_use]
pub fn sparkline(values: &[f32]) -> String {
    let top = values.iter().copied().fold(0.0_f32, f32::max);
    let bar = |value: &f32| {
        let level = if top > 0.0 { (value / top * 7.0).round() as usize } else { 0 };
        BARS.get(level).copied().unwrap_or('?')
    };
    values.iter().map(bar).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::source::Stamps;
    use driver_iface::bfee::{self, csi_len};
    use driver_iface::record::{Record, code};

    #[test]
    fn bars_reach_from_zero_to_the_largest() {
        assert_eq!(sparkline(&[0.0, 1.0, 2.0, 7.0]), "▁▂▃█");
        assert_eq!(sparkline(&[0.0, 0.0]), "▁▁");
    }

    #[test]
    fn a_line_has_the_rate_of_its_window() {
        let mut body = vec![0; bfee::STOCK_HEADER + csi_len(1, 1)];
        (body[bfee::offset::N_RX], body[bfee::offset::N_TX]) = (1, 1);
        body[bfee::offset::LEN] = csi_len(1, 1) as u8;
        body[bfee::offset::RSSI] = 33;
        let mut status = Status::new(Instant::ZERO);
        for k in 0..50_u8 {
            body[bfee::offset::BFEE_COUNT] = k;
            let record = Record { code: code::BFEE, body: &body };
            let now = Instant::from_us(i64::from(k) * 10_000);
            status.note(now, &Next::Record(Stamps::default(), record));
        }
        let half_second = Instant::from_us(500_000);
        status.refresh(half_second);
        let losses = Losses { kernel: 1, driver: 2, disk: 3 };
        let line = status.line(losses);
        assert!(line.starts_with("50 records, 100/s; lost 6; 1 senders; RSSI 33/-/-; A ▁▁"), "{line}");
        let page = status.page(half_second, "test", losses);
        assert!(page.contains("unknown               100      50"), "{page}");
        status.refresh(Instant::from_us(1_000_000));
        assert!(status.line(losses).starts_with("50 records, 0/s; lost 6; 0 senders"));
    }
}
