//! Claims about the records of one card.

use super::Told;
use crate::evidence::{Evidence, Heard, HeardRecord, antenna_a, antennas, column};
use crate::stats::{SURE, mean_and_error, quantile};
use csi5300::signal::channel::Width;
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, Iq, NOISE_UNKNOWN_DBM, SUBCARRIERS, rate};
use driver_iface::record::Tail;
use num_complex::Complex32;
use std::collections::{BTreeMap, HashMap};

/// The share of records with a property.
fn share(heard: &Heard, limit: f64, what: &str, is_bad: impl Fn(&HeardRecord) -> bool) -> Told {
    let bad = heard.records.iter().filter(|record| is_bad(record)).count();
    Told::share(bad, heard.records.len(), limit, what)
}

pub(super) fn whole(heard: &Heard, _: &Evidence) -> Told {
    let survey = &heard.survey;
    let (damaged, bad) = (survey.damaged_bytes, survey.bad_bfee);
    let tail = match survey.tail {
        Some(Tail::Clean) | None => "",
        Some(_) => ", and a last record cut by a killed logger",
    };
    let first = survey
        .losses
        .first()
        .map_or_else(String::new, |lost| format!("; the first at byte {}: {}", lost.offset, lost.reason));
    let found = format!("{damaged} bytes in no record, {bad} records that contradict themselves{tail}{first}");
    Told::decided(damaged == 0 && bad == 0, found).with("bytes", damaged as f64, "").with("records", bad as f64, "")
}

pub(super) fn layout(heard: &Heard, _: &Evidence) -> Told {
    let survey = &heard.survey;
    let all = [(survey.stock, "stock"), (survey.wsr_2021, "WSR of 2021"), (survey.wsr, "WSR")];
    let there: Vec<String> =
        all.iter().filter(|(count, _)| *count > 0).map(|(count, name)| format!("{count} {name}")).collect();
    only_one(&there)
}

/// A verdict on values of which there must be one.
fn only_one(found: &[String]) -> Told {
    match found.len() {
        0 => Told::not_tried("no record with CSI"),
        values => Told::decided(values == 1, found.join(", ")),
    }
}

pub(super) fn count(heard: &Heard, _: &Evidence) -> Told {
    let pairs = heard.records.windows(2);
    let still =
        pairs.filter(|pair| matches!(pair, [before, now] if now.head.bfee_count == before.head.bfee_count)).count();
    Told::share(still, heard.records.len(), 0.01, "records repeat the count of the one before")
}

pub(super) fn gaps(heard: &Heard, evidence: &Evidence) -> Told {
    let missing = heard.survey.bfee_missing as usize;
    let logs = std::iter::once(&evidence.near).chain(&evidence.far);
    let robots = logs.map(|log| log.survey.senders.len()).max().unwrap_or(0);
    if heard.survey.senders.len() < robots {
        // The driver counts every frame with CSI.
        return Told::not_tried(format!(
            "{missing} are missing, but {robots} robots sounded and this logger kept fewer of them"
        ));
    }
    Told::share(missing, missing + heard.records.len(), 0.01, "records are missing in `bfee_count`")
}

pub(super) fn ht(heard: &Heard, _: &Evidence) -> Told {
    share(heard, 0.0, "records of a frame at a legacy rate", |record| record.head.rate_n_flags & rate::HT == 0)
}

pub(super) fn width(heard: &Heard, evidence: &Evidence) -> Told {
    let wide = evidence.plan.channel.width() != Width::Ht20;
    let what = if wide {
        "records of a frame of 20 MHz on a channel of 40"
    } else {
        "records of a frame of 40 MHz on a channel of 20"
    };
    share(heard, 0.0, what, |record| (record.head.rate_n_flags & rate::HT40 != 0) != wide)
}

pub(super) fn chains(heard: &Heard, _: &Evidence) -> Told {
    let mut counts: BTreeMap<u8, usize> = BTreeMap::new();
    for record in &heard.records {
        *counts.entry(record.head.n_rx).or_default() += 1;
    }
    let found: Vec<String> =
        counts.iter().map(|(chains, count)| format!("{chains} chains in {count} records")).collect();
    only_one(&found)
}

pub(super) fn order(heard: &Heard, _: &Evidence) -> Told {
    share(heard, 0.0, "records name no antenna or one twice", |record| antennas(record).is_none())
}

/// Mean power of a chain, steps squared, first stream.
fn chain_power(record: &HeardRecord, chain: usize) -> f64 {
    mean_power(&column(record, chain))
}

fn mean_power(h: &[Complex32; SUBCARRIERS]) -> f64 {
    h.iter().map(|h| f64::from(h.norm_sqr())).sum::<f64>() / SUBCARRIERS as f64
}

/// Chains with less than this are quantisation and crosstalk, steps squared.
const LEAST_POWER: f64 = 36.0;

/// Power of the chain that the record names after an antenna, and the antenna's RSSI, dB; none for a weak chain or without RSSI.
fn levels_db(record: &HeardRecord, antenna: Antenna) -> Option<(f64, f64)> {
    let chain = antennas(record)?.chain_of(antenna)?;
    let rssi = record.head.rssi.get(antenna.index()).copied().filter(|rssi| *rssi > 0)?;
    let power = chain_power(record, chain);
    (power >= LEAST_POWER).then(|| (10.0 * power.log10(), f64::from(rssi)))
}

/// The largest disagreement between two chains, dB: the difference of their powers less the difference of their named
/// antennas' RSSI. Exchanged names double a difference. `None` without two strong chains, or without two RSSI 3 dB
/// apart. In three WSR logs the median is 1.6 to 2.1 dB between a strong and a weak chain.
fn disagreement_db(record: &HeardRecord) -> Option<f64> {
    let chains: Vec<(f64, f64)> = Antenna::ALL.into_iter().filter_map(|antenna| levels_db(record, antenna)).collect();
    let pairs = || chains.iter().enumerate().flat_map(|(k, a)| chains.iter().skip(k + 1).map(move |b| (a, b)));
    if !pairs().any(|(a, b)| (a.1 - b.1).abs() >= 3.0) {
        return None;
    }
    Some(pairs().map(|(a, b)| ((a.0 - b.0) - (a.1 - b.1)).abs()).fold(0.0, f64::max))
}

pub(super) fn antenna_names(heard: &Heard, _: &Evidence) -> Told {
    let off: Vec<f64> = heard.records.iter().filter_map(disagreement_db).collect();
    if off.len() < super::LEAST {
        return Told::not_tried(format!(
            "{} of {} records have two antennas that differ by 3 dB or more: weaken one, or unplug it",
            off.len(),
            heard.records.len()
        ));
    }
    let told = Told::share(
        off.iter().filter(|off| **off > 5.0).count(),
        off.len(),
        0.02,
        "records have powers and RSSI that disagree by more than 5 dB",
    );
    told.adding(&power_and_rssi(heard))
}

/// The median level of B and C above A, by the named chain's power and by RSSI: `; B less A: 4 dB by power, -4 dB by RSSI`.
fn power_and_rssi(heard: &Heard) -> String {
    let above_a = |antenna: Antenna| {
        let both = |record| levels_db(record, antenna).zip(levels_db(record, Antenna::A));
        let both = heard.records.iter().filter_map(both);
        let (power, rssi): (Vec<f64>, Vec<f64>) = both.map(|(own, a)| (own.0 - a.0, own.1 - a.1)).unzip();
        let (power, rssi) = quantile(&power, 0.5).zip(quantile(&rssi, 0.5))?;
        Some(format!("; {antenna} less A: {power:.0} dB by power, {rssi:.0} dB by RSSI"))
    };
    [Antenna::B, Antenna::C].into_iter().filter_map(above_a).collect()
}

/// The place of the value of the k-th index.
type Order = fn(usize) -> usize;

/// Possible wrong orders of the 30 values: actual place by correct place.
const ORDERS: [(&str, Order); 3] = [
    ("shifted up by one place, the last to the first", |k| (k + 1) % SUBCARRIERS),
    ("shifted down by one place, the first to the last", |k| (k + SUBCARRIERS - 1) % SUBCARRIERS),
    ("reversed", |k| SUBCARRIERS - 1 - k),
];

/// The sum of squares of the phase steps between neighbours without a delay, radians squared, if value `order(k)` is of
/// `indices[k]`.
fn left_over(h: &[Complex32; SUBCARRIERS], indices: &[i8; SUBCARRIERS], order: impl Fn(usize) -> usize) -> f64 {
    let value = |k: usize| h.get(order(k)).copied().unwrap_or_default();
    let steps: Vec<(f64, f64)> = indices
        .windows(2)
        .enumerate()
        .filter_map(|(k, pair)| {
            let [a, b] = pair else { return None };
            Some((f64::from(b - a), f64::from((value(k + 1) * value(k).conj()).arg())))
        })
        .collect();
    // The slope from steps of the usual width: narrower ones distinguish the orders.
    let usual = steps.iter().map(|step| step.0).fold(0.0, f64::max);
    let wide: Vec<f64> = steps.iter().filter(|step| step.0 == usual).map(|step| step.1).collect();
    let slope = quantile(&wide, 0.5).unwrap_or(0.0) / usual;
    steps
        .iter()
        .map(|(width, phase)| {
            (phase - slope * width).sin().powi(2) + if (phase - slope * width).cos() < 0.0 { 1.0 } else { 0.0 }
        })
        .sum()
}

pub(super) fn subcarriers(heard: &Heard, evidence: &Evidence) -> Told {
    let indices = evidence.plan.channel.subcarriers();
    let step = (heard.records.len() / 2_000).max(1);
    let mut gains: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::new());
    for record in heard.records.iter().step_by(step) {
        let h = strongest(record);
        let stated = left_over(&h, &indices, |k| k);
        for (gain, (_, order)) in gains.iter_mut().zip(ORDERS) {
            gain.push(left_over(&h, &indices, order) - stated);
        }
    }
    if gains.iter().any(|gain| gain.len() < super::LEAST) {
        return Told::not_tried(format!("fewer than {} records", super::LEAST));
    }
    let against: Vec<(&str, f64, f64)> = ORDERS
        .iter()
        .zip(&gains)
        .filter_map(|((name, _), gain)| mean_and_error(gain).map(|(mean, error)| (*name, mean, SURE * error)))
        .collect();
    let worst = against.iter().min_by(|a, b| a.1.total_cmp(&b.1)).copied();
    let Some((name, gain, error)) = worst else { return Told::not_tried("no record with CSI") };
    let told = if gain + error < 0.0 {
        Told::decided(
            false,
            format!("they fit a line better if the values are {name}: by {:.2} +- {error:.2} rad^2 a record", -gain),
        )
    } else if gain > error {
        Told::decided(
            true,
            format!(
                "a line fits best in the order of 802.11n; the next best order ({name}) is {gain:.2} +- {error:.2} rad^2 a record worse"
            ),
        )
    } else {
        Told::not_tried(format!("{name} fits as well: the delay is too short to tell"))
    };
    told.with("gain", gain, "rad^2")
}

/// The strongest chain's coefficients.
fn strongest(record: &HeardRecord) -> [Complex32; SUBCARRIERS] {
    let chains = 0..usize::from(record.head.n_rx);
    let best = chains.max_by(|a, b| chain_power(record, *a).total_cmp(&chain_power(record, *b)));
    best.map_or_else(|| antenna_a(record), |chain| column(record, chain))
}

pub(super) fn level(heard: &Heard, _: &Evidence) -> Told {
    let levels: Vec<f64> =
        heard.records.iter().map(|record| mean_power(&strongest(record)).sqrt()).filter(|level| *level > 0.0).collect();
    match quantile(&levels, 0.5) {
        Some(median) if levels.len() >= super::LEAST => {
            Told::decided((8.0..=64.0).contains(&median), format!("median {median:.1} steps"))
                .with("median", median, "steps")
        }
        _ => Told::not_tried(format!("fewer than {} records", super::LEAST)),
    }
}

pub(super) fn saturation(heard: &Heard, _: &Evidence) -> Told {
    let cut = |half: i8| half == i8::MIN || half == i8::MAX;
    let told = share(heard, 0.01, "records with a value of -128 or 127", |record| {
        record.csi.iter().any(|iq| cut(iq.i) || cut(iq.q))
    });
    let gains: Vec<f64> = heard.records.iter().map(|record| f64::from(record.head.agc)).collect();
    match quantile(&gains, 0.5) {
        Some(gain) => told.adding(&format!("; median gain {gain:.0} dB")),
        None => told,
    }
}

pub(super) fn zero(heard: &Heard, _: &Evidence) -> Told {
    share(heard, 0.0, "records are all zero", |record| record.csi.iter().all(|iq| *iq == Iq::default()))
}

pub(super) fn fresh(heard: &Heard, _: &Evidence) -> Told {
    let pairs = heard.records.windows(2);
    let is_old = |pair: &&[HeardRecord]| matches!(pair, [before, now] if now.csi == before.csi && now.csi.iter().any(|iq| *iq != Iq::default()));
    let old = pairs.filter(is_old).count();
    Told::share(old, heard.records.len(), 0.01, "records have the coefficients of the one before")
}

/// Total power at the antennas, dBm, as csitool's `get_total_rss` has it.
fn total_rss_dbm(record: &HeardRecord) -> Option<f64> {
    let sum: f64 =
        record.head.rssi.iter().filter(|rssi| **rssi > 0).map(|rssi| 10_f64.powf(0.1 * f64::from(*rssi))).sum();
    (sum > 0.0).then(|| 10.0 * sum.log10() - 44.0 - f64::from(record.head.agc))
}

pub(super) fn gain(heard: &Heard, _: &Evidence) -> Told {
    let is_bad = |record: &HeardRecord| {
        record.head.agc == 0 || !total_rss_dbm(record).is_some_and(|dbm| (-95.0..=-10.0).contains(&dbm))
    };
    let powers: Vec<f64> = heard.records.iter().filter_map(total_rss_dbm).collect();
    with_median_dbm(share(heard, 0.01, "records state a power that air cannot carry, or no gain", is_bad), &powers)
}

/// A verdict with the median of its values.
fn with_median_dbm(told: Told, dbm: &[f64]) -> Told {
    match quantile(dbm, 0.5) {
        Some(median) => told.adding(&format!("; median {median:.0} dBm")).with("median", median, "dBm"),
        None => told,
    }
}

pub(super) fn noise(heard: &Heard, _: &Evidence) -> Told {
    let told = share(heard, 0.01, "records state a noise floor that no receiver has", |record| {
        record.head.noise_dbm != NOISE_UNKNOWN_DBM && !(-105..=-60).contains(&record.head.noise_dbm)
    });
    let floors: Vec<f64> = heard.records.iter().map(|record| f64::from(record.head.noise_dbm)).collect();
    with_median_dbm(told, &floors)
}

/// SNR of a record's strongest chain, dB: third differences over equally spaced subcarriers leave 20 times the noise of one.
fn snr_db(record: &HeardRecord) -> Option<f64> {
    let mut h = strongest(record);
    // A delay rotates neighbours, which is not noise.
    let slope: Complex32 = h.windows(2).filter_map(|pair| Some(pair.get(1)? * pair.first()?.conj())).sum();
    for (k, h) in h.iter_mut().enumerate() {
        *h *= Complex32::cis(-slope.arg() * k as f32);
    }
    let power = mean_power(&h);
    // Within each half of the band the indices are equally spaced.
    let thirds = h.get(..14)?.windows(4).chain(h.get(15..29)?.windows(4));
    let square = |four: &[Complex32]| {
        let [a, b, c, d] = four else { return None };
        Some(f64::from((d - c * 3.0 + b * 3.0 - a).norm_sqr()) / 20.0)
    };
    let squares: Vec<f64> = thirds.filter_map(square).collect();
    let noise = squares.iter().sum::<f64>() / squares.len() as f64;
    (power > noise && noise > 0.0).then(|| 10.0 * ((power - noise) / noise).log10())
}

pub(super) fn snr(heard: &Heard, _: &Evidence) -> Told {
    let all: Vec<f64> = heard.records.iter().map(|record| snr_db(record).unwrap_or(0.0)).collect();
    match quantile(&all, 0.5).zip(quantile(&all, 0.05)) {
        Some((median, low)) if all.len() >= super::LEAST => {
            Told::decided(median >= 5.0, format!("median {median:.0} dB, 5 % below {low:.0} dB"))
                .with("median", median, "dB")
        }
        _ => Told::not_tried(format!("fewer than {} records", super::LEAST)),
    }
}

pub(super) fn once(heard: &Heard, _: &Evidence) -> Told {
    let mut last: HashMap<Mac, u32> = HashMap::new();
    let (mut twice, mut numbered, mut skipped) = (0, 0, 0_u64);
    for record in heard.records.iter().filter(|record| record.mac != Mac::ZERO) {
        if let Some(number) = record.number {
            numbered += 1;
            let before = last.insert(record.mac, number);
            twice += usize::from(before == Some(number));
            skipped += before.map_or(0, |before| u64::from(number.saturating_sub(before).saturating_sub(1)));
        }
    }
    match numbered {
        0 => Told::not_tried("no record has a sender and a number"),
        _ => Told::share(twice, numbered, 0.01, "numbers come twice in a row")
            .adding(&format!("; {skipped} are skipped")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Verdict;

    #[test]
    fn orders_are_told_apart_by_a_delay() {
        let indices = csi5300::signal::channel::INDICES_20_MHZ;
        let h: [Complex32; SUBCARRIERS] = std::array::from_fn(|k| Complex32::cis(-0.4 * f32::from(indices[k])));
        let stated = left_over(&h, &indices, |k| k);
        assert!(stated < 1e-6, "{stated}");
        for (name, order) in ORDERS {
            assert!(left_over(&h, &indices, order) > 0.1, "{name}");
        }
    }

    #[test]
    fn nothing_heard_decides_nothing() {
        let (heard, evidence) = (Heard::default(), Evidence::new(crate::Plan::new("108".parse().unwrap())));
        for check in
            [layout, count, gaps, ht, width, chains, order, subcarriers, level, zero, fresh, gain, noise, snr, once]
        {
            assert_eq!(check(&heard, &evidence).verdict, Verdict::NotTried);
        }
    }
}
