//! Compares a recorded capture with a simulated one of the same scene, figure by figure.
//!
//! [`Figures`] are the measurable properties of any capture: its records, their times, and the effects of radios and
//! channel on the phase. [`rows`] compares those of two captures with their limits, and [`fit()`] derives a scene from
//! a recorded capture.

pub mod figures;
pub mod fit;

use figures::{Distribution, Histogram, SideFigures};
pub use figures::{Figures, LinkFigures, measure, measure_scene};
pub use fit::{Fitted, channel_about, channel_of, fit, scene_channel};
use std::collections::BTreeSet;

/// How far a simulated figure may be from the recorded one.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Allowed {
    /// It must be equal.
    Nothing,
    /// By this much, in the figure's unit.
    By(f64),
    /// By this share of the recorded value.
    Share(f64),
    /// Shown without a limit.
    Anything,
}

/// The result of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Within its limit.
    Agrees,
    /// Outside its limit.
    Differs,
    /// No limit.
    Shown,
}

/// One figure of both captures.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct FigureRow {
    /// Its owner: `link`, `receiver`, `transmitter`.
    pub of: &'static str,
    /// Its name.
    pub name: String,
    /// Its unit, empty for none.
    pub unit: &'static str,
    /// Its value in the recorded capture; `None` if it could not be measured.
    pub recorded: Option<f64>,
    /// Its value in the simulated capture.
    pub simulated: Option<f64>,
    /// Its limit.
    pub allowed: Allowed,
    /// Whether it is within the limit.
    pub verdict: Verdict,
}

/// Limit of phase spreads, relative.
pub const SPREAD: Allowed = Allowed::Share(0.15);
/// Limit of coherences, absolute.
pub(crate) const COHERENCE: Allowed = Allowed::By(0.1);
/// Limit of interquartile ranges of times, and of levels, relative.
const WIDTH: Allowed = Allowed::Share(0.2);

/// All figures of two captures side by side.
#[must_use]
pub fn rows(recorded: &Figures, simulated: &Figures) -> Vec<FigureRow> {
    let (a, b) = (&recorded.link, &simulated.link);
    let mut table = Table { of: "link", rows: Vec::new() };
    table.add("pairs", "", a.pairs as f64, b.pairs as f64, Allowed::Share(0.02));
    let allowed = if a.df_hz.and(b.df_hz).is_some() { Allowed::By(500.0) } else { Allowed::Anything };
    table.maybe("carrier frequency offset", "Hz", [a.df_hz, b.df_hz], allowed);
    table.maybe("host clocks apart", "s", [a.host_apart_s, b.host_apart_s], Allowed::By(1e-3));
    table.add("drift of the clocks", "ppm", a.drift_ppm, b.drift_ppm, Allowed::Anything);
    let (turn, other) = (&a.turn_around_us, &b.turn_around_us);
    table.add("turn-around, quartile range", "us", turn.quartile_range(), other.quartile_range(), Allowed::By(2.0));
    table.add("turn-arounds away from the core", "", a.away(), b.away(), Allowed::By(0.05));
    table.add("phase spread before compensation", "rad", a.spread_before_rad, b.spread_before_rad, SPREAD);
    table.add("phase spread after compensation", "rad", a.spread_after_rad, b.spread_after_rad, SPREAD);
    table.maybe("coherence", "", [a.coherence, b.coherence], COHERENCE);
    table.maybe("coherence within a second", "", [a.short_coherence, b.short_coherence], COHERENCE);
    table.maybe("azimuth", "deg", [a.azimuth_deg, b.azimuth_deg], Allowed::Anything);
    table.maybe("|elevation|", "deg", [a.abs_elevation_deg, b.abs_elevation_deg], Allowed::Anything);
    if a.elevation_deg.or(b.elevation_deg).is_some() {
        table.maybe("elevation", "deg", [a.elevation_deg, b.elevation_deg], Allowed::Anything);
    }
    table.side("receiver", &recorded.receiver, &simulated.receiver);
    table.side("transmitter", &recorded.transmitter, &simulated.transmitter);
    table.rows
}

struct Table {
    of: &'static str,
    rows: Vec<FigureRow>,
}

impl Table {
    fn add(&mut self, name: &str, unit: &'static str, recorded: f64, simulated: f64, allowed: Allowed) {
        self.maybe(name, unit, [Some(recorded), Some(simulated)], allowed);
    }

    fn maybe(&mut self, name: &str, unit: &'static str, values: [Option<f64>; 2], allowed: Allowed) {
        let [recorded, simulated] = values.map(|value| value.filter(|value| value.is_finite()));
        let verdict = verdict(recorded, simulated, allowed);
        self.rows.push(FigureRow { of: self.of, name: name.into(), unit, recorded, simulated, allowed, verdict });
    }

    fn side(&mut self, of: &'static str, a: &SideFigures, b: &SideFigures) {
        self.of = of;
        self.add("records", "", a.records as f64, b.records as f64, Allowed::Share(0.02));
        self.extent("record length", "bytes", &a.lengths, &b.lengths);
        self.extent("10 n_rx + n_tx", "", &a.streams, &b.streams);
        self.shares("rate_n_flags", &a.rates, &b.rates);
        self.extent("noise", "dBm", &a.noise_dbm, &b.noise_dbm);
        self.shares("antenna_sel", &a.antenna_sel, &b.antenna_sel);
        for (antenna, (a, b)) in ["A", "B", "C"].iter().zip(a.rssi_db.iter().zip(&b.rssi_db)) {
            self.field(&format!("RSSI {antenna}"), "dB", a, b);
        }
        self.field("AGC", "dB", &a.agc_db, &b.agc_db);
        for (antenna, (a, b)) in ["A", "B", "C"].iter().zip(a.level.iter().zip(&b.level)) {
            self.add(&format!("level {antenna}"), "steps", a.mean, b.mean, WIDTH);
        }
        self.add("numbers missing", "", a.missing, b.missing, Allowed::By(0.01));
        self.times("interval, card", &a.interval_us, &b.interval_us);
        self.times("interval, host", &a.host_interval_us, &b.host_interval_us);
        let (wide, narrow) = (a.latency_us.quartile_range(), b.latency_us.quartile_range());
        self.add("host latency, quartile range", "us", wide, narrow, WIDTH);
        self.add("card's clock against the host's", "ppm", a.card_ppm, b.card_ppm, Allowed::By(1.0));
        self.add("slope of the phase", "rad/index", a.slope_rad.mean, b.slope_rad.mean, Allowed::By(0.02));
        self.add("slope, standard deviation", "rad/index", a.slope_rad.sd, b.slope_rad.sd, Allowed::Share(0.3));
        self.add("ripple over the subcarriers", "", a.ripple.median, b.ripple.median, Allowed::By(0.05));
        self.add("signal to noise of a subcarrier", "dB", a.tone_snr_db, b.tone_snr_db, Allowed::By(2.0));
    }

    /// The range of a field with few values: lowest and highest must be equal.
    fn extent(&mut self, name: &str, unit: &'static str, a: &Histogram, b: &Histogram) {
        let ends = |map: &Histogram| [map.keys().next(), map.keys().next_back()].map(|key| key.map(|key| *key as f64));
        let ([low, high], [other_low, other_high]) = (ends(a), ends(b));
        self.maybe(&format!("{name}, lowest"), unit, [low, other_low], Allowed::Nothing);
        self.maybe(&format!("{name}, highest"), unit, [high, other_high], Allowed::Nothing);
    }

    /// The distribution of the records over a field's values: the total variation distance of the two captures, from 0 (equal)
    /// to 1 (no common value). The recorded capture's distance to itself is 0.
    fn shares(&mut self, name: &str, a: &Histogram, b: &Histogram) {
        self.add(&format!("{name}, total variation distance"), "", 0.0, variation(a, b), Allowed::By(0.05));
    }

    fn field(&mut self, name: &str, unit: &'static str, a: &Distribution, b: &Distribution) {
        self.add(&format!("{name}, mean"), unit, a.mean, b.mean, Allowed::By(1.0));
        self.add(&format!("{name}, standard deviation"), unit, a.sd, b.sd, Allowed::By(0.7));
        self.add(&format!("{name}, 1 %"), unit, a.p01, b.p01, Allowed::By(2.0));
        self.add(&format!("{name}, 99 %"), unit, a.p99, b.p99, Allowed::By(2.0));
    }

    fn times(&mut self, name: &str, a: &Distribution, b: &Distribution) {
        self.add(&format!("{name}, median"), "us", a.median, b.median, Allowed::Share(0.001));
        self.add(&format!("{name}, quartile range"), "us", a.quartile_range(), b.quartile_range(), WIDTH);
        self.add(&format!("{name}, standard deviation"), "us", a.sd, b.sd, WIDTH);
        self.add(&format!("{name}, 1 %"), "us", a.p01, b.p01, Allowed::Share(0.01));
        self.add(&format!("{name}, 99 %"), "us", a.p99, b.p99, Allowed::Share(0.01));
    }
}

/// Total variation distance: half the sum of the differences of all shares.
fn variation(a: &Histogram, b: &Histogram) -> f64 {
    let share = |counts: &Histogram, value: i64| {
        let all: u64 = counts.values().sum();
        counts.get(&value).map_or(0.0, |&n| n as f64 / all.max(1) as f64)
    };
    let values: BTreeSet<i64> = a.keys().chain(b.keys()).copied().collect();
    0.5 * values.into_iter().map(|value| (share(a, value) - share(b, value)).abs()).sum::<f64>()
}

fn verdict(recorded: Option<f64>, simulated: Option<f64>, allowed: Allowed) -> Verdict {
    let limit = |recorded: f64| match allowed {
        Allowed::Nothing => Some(0.0),
        Allowed::By(by) => Some(by),
        Allowed::Share(share) => Some(share * recorded.abs()),
        Allowed::Anything => None,
    };
    match (recorded, simulated) {
        (None, None) => Verdict::Shown,
        (Some(recorded), Some(simulated)) => match limit(recorded) {
            None => Verdict::Shown,
            Some(limit) if (recorded - simulated).abs() <= limit => Verdict::Agrees,
            Some(_) => Verdict::Differs,
        },
        _ if allowed == Allowed::Anything => Verdict::Shown,
        _ => Verdict::Differs,
    }
}

/// Why a scene or recording of one robot has no figures of a link.
pub(crate) const ONE_ROBOT: &str = "a scene of one robot has no link to measure";
pub(crate) const NO_TRANSMITTER: &str = "no transmitter's log";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn total_variation_counts_every_value() {
        let counts = |pairs: &[(i64, u64)]| pairs.iter().copied().collect::<Histogram>();
        let a = counts(&[(0x24, 60), (0x09, 30), (0x21, 10)]);
        assert_eq!(variation(&a, &counts(&[(0x24, 6), (0x09, 3), (0x21, 1)])), 0.0);
        // The most frequent value has the same share; the others are swapped.
        assert!((variation(&a, &counts(&[(0x24, 60), (0x09, 10), (0x21, 30)])) - 0.2).abs() < 1e-12);
        assert_eq!(variation(&a, &counts(&[(0x12, 5)])), 1.0);
        assert_eq!(variation(&a, &counts(&[])), 0.5);
    }

    #[test]
    fn verdicts_follow_the_limits() {
        use Verdict::{Agrees, Differs, Shown};
        for (recorded, simulated, allowed, expected) in [
            (Some(1.0), Some(1.14), SPREAD, Agrees),
            (Some(1.0), Some(1.16), SPREAD, Differs),
            (Some(0.5), Some(0.61), COHERENCE, Differs),
            (Some(-127.0), Some(-127.0), Allowed::Nothing, Agrees),
            (Some(-127.0), Some(-126.0), Allowed::Nothing, Differs),
            (Some(1.0), None, Allowed::By(9.0), Differs),
            (None, None, Allowed::Nothing, Shown),
            (Some(1.0), Some(9.0), Allowed::Anything, Shown),
        ] {
            assert_eq!(verdict(recorded, simulated, allowed), expected, "{recorded:?} {simulated:?} {allowed:?}");
        }
    }
}
