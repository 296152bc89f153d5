//! Claims that need a person, who retunes a card, reloads its driver, or unplugs an antenna.

use super::{LEAST, Needs, Told};
use crate::collect::{After, Done, Evidence, Heard, HeardRecord};
use crate::pairs::{Pairs, column};
use crate::report::Verdict;
use crate::stats::{SURE, quantile};
use driver_iface::bfee::{Antenna, Antennas};
use num_complex::{Complex32, Complex64};
use std::f64::consts::{FRAC_PI_4, TAU};

/// The longest turn-around that is known, seconds (the WSR driver's).
const TURN_AROUND_S: f64 = 322e-6;

/// A phase that stays the same at rest, with its standard error.
struct Constant {
    name: String,
    rad: f64,
    error: f64,
    /// The carrier offset, Hz, which turns the round trip by an unknown whole turn-around.
    offset_hz: f64,
}

impl Constant {
    /// The mean of phases.
    fn of(name: String, units: impl Iterator<Item = Complex64>) -> Option<Self> {
        let (mut sum, mut n) = (Complex64::default(), 0.0);
        for unit in units {
            let norm = unit.norm();
            if norm > 0.0 {
                (sum, n) = (sum + unit / norm, n + 1.0);
            }
        }
        // Circular standard deviation (Mardia and Jupp 2000, 2.3.11).
        let deviation = (-2.0 * (sum.norm() / n).ln()).sqrt();
        (n >= LEAST as f64 && deviation.is_finite()).then(|| Self {
            name,
            rad: sum.arg(),
            error: deviation / n.sqrt(),
            offset_hz: 0.0,
        })
    }

    /// Difference from `before`, radians, and its standard error.
    fn step(&self, before: &Self) -> (f64, f64) {
        let turn = TAU * (self.offset_hz - before.offset_hz).abs() * TURN_AROUND_S;
        let step = (self.rad - before.rad + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0;
        (step, SURE * self.error.hypot(before.error) + turn)
    }
}

/// The coefficients of a named antenna.
fn antenna(record: &HeardRecord, antenna: Antenna) -> Option<[Complex32; csi5300::signal::channel::SUBCARRIERS]> {
    let head = &record.head;
    let antennas = Antennas::new(head.antenna_sel, head.n_rx, head.rssi).ok()?;
    antennas.chain_of(antenna).map(|chain| column(record, chain))
}

/// Phases that are constant at rest: each antenna's against antenna A's, and the compensated round trip's.
fn constants(near: &Heard, pairs: Option<&Pairs>) -> Vec<Constant> {
    let against_a = |other: Antenna| {
        let unit = |record: &HeardRecord| {
            let (a, other) = antenna(record, Antenna::A).zip(antenna(record, other))?;
            let sum: Complex32 = other.iter().zip(&a).map(|(other, a)| other * a.conj()).sum();
            Some(Complex64::new(sum.re.into(), sum.im.into()))
        };
        Constant::of(format!("antenna {other:?} against A"), near.records.iter().filter_map(unit))
    };
    let round_trip = pairs.and_then(|pairs| {
        let found = pairs.compensation.as_ref()?;
        let mut z = pairs.product.clone();
        found.apply(&mut z);
        let constant = Constant::of("round trip".into(), z.into_iter())?;
        // The error of the median turn-around, its spread over the root of the pairs, limits that of its phase.
        let spread_us = 1.4826 * quantile(&found.jitter_us.iter().map(|us| us.abs()).collect::<Vec<_>>(), 0.5)?;
        let error_s = 1.2533 * 1e-6 * spread_us / (pairs.len() as f64).sqrt();
        let error = constant.error.hypot(TAU * found.df_hz * error_s);
        Some(Constant { error, offset_hz: found.df_hz, ..constant })
    });
    [against_a(Antenna::B), against_a(Antenna::C), round_trip].into_iter().flatten().collect()
}

fn same(evidence: &Evidence, done: Done, needs: Needs) -> Told {
    let after: Vec<&After> = evidence.after.iter().filter(|after| after.done == done).collect();
    if after.is_empty() || !evidence.plan.at_rest {
        return Told::needs(needs);
    }
    let before = constants(&evidence.near, evidence.pairs.as_ref());
    let steps: Vec<(String, f64, f64)> = after
        .iter()
        .flat_map(|after| constants(&after.near, after.pairs.as_ref()))
        .filter_map(|now| {
            let (step, error) = now.step(before.iter().find(|before| before.name == now.name)?);
            Some((now.name, step, error))
        })
        .collect();
    let Some((name, step, error)) = steps.iter().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs())) else {
        return Told::not_tried(format!(
            "no phase can be compared: at least {LEAST} records of two antennas or exchanges"
        ));
    };
    let found = format!(
        "logs after it: {}; the largest step is that of {name}: {:+.0} degrees +- {:.0}",
        after.len(),
        step.to_degrees(),
        error.to_degrees()
    );
    // Half of the smallest step that is known.
    let told = if steps.iter().any(|(_, step, error)| step.abs() - error > FRAC_PI_4) {
        Told::decided(false, found)
    } else if steps.iter().all(|(_, step, error)| step.abs() + error <= FRAC_PI_4) {
        Told::decided(true, found)
    } else {
        Told::not_tried(format!("{found}: too uncertain to tell that from 45"))
    };
    told.with("largest step", step.to_degrees(), "deg")
}

pub(super) fn retune(evidence: &Evidence) -> Told {
    same(evidence, Done::Retuned, Needs::Retunes)
}

pub(super) fn reload(evidence: &Evidence) -> Told {
    same(evidence, Done::Reloaded, Needs::Reload)
}

/// Power of each named antenna relative to all, dB: the median over the records; none for antennas in less than half of
/// them.
fn shares(heard: &Heard) -> [Option<f64>; 3] {
    let power = |record: &HeardRecord, which: Antenna| {
        Some(f64::from(antenna(record, which)?.iter().map(Complex32::norm_sqr).sum::<f32>()))
    };
    let all = [Antenna::A, Antenna::B, Antenna::C];
    all.map(|which| {
        let share = |record: &HeardRecord| {
            let total: f64 = all.iter().filter_map(|other| power(record, *other)).sum();
            Some(10.0 * (power(record, which)? / total).max(1e-9).log10()).filter(|_| total > 0.0)
        };
        let shares: Vec<f64> = heard.records.iter().filter_map(share).collect();
        quantile(&shares, 0.5).filter(|_| 2 * shares.len() >= heard.records.len())
    })
}

/// Least loss of an unplugged antenna, dB.
const FALL_DB: f64 = 6.0;

pub(super) fn unplugged(evidence: &Evidence) -> Told {
    if evidence.unplugged.is_empty() {
        return Told::needs(Needs::Unplugged);
    }
    let before = shares(&evidence.near);
    let (mut wrong, mut words, mut figures) = (0, Vec::new(), Vec::new());
    for (which, heard) in &evidence.unplugged {
        if heard.records.len() < LEAST {
            return Told::not_tried(format!(
                "{} records came without antenna {which:?}; {LEAST} are needed",
                heard.records.len()
            ));
        }
        let now = shares(heard);
        let index = which.index();
        let Some(Some(at_first)) = before.get(index) else {
            return Told::not_tried(format!("antenna {which:?} is in no record, or in few"));
        };
        // A chain that the firmware drops fell too.
        let fell =
            |index: usize| Some(before.get(index)?.as_ref()? - now.get(index).copied().flatten().unwrap_or(-90.0));
        let falls: Vec<f64> = (0..3).filter_map(fell).collect();
        let own = at_first - now.get(index).copied().flatten().unwrap_or(-90.0);
        let most = falls.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        wrong += usize::from(own < FALL_DB || own < most);
        words.push(format!("{which:?} fell by {own:.1} dB, the most that any antenna did is {most:.1} dB"));
        figures.push(own);
    }
    let least = figures.iter().copied().fold(f64::INFINITY, f64::min);
    Told::new(if wrong == 0 { Verdict::Holds } else { Verdict::Fails }, words.join("; ")).with(
        "least fall",
        least,
        "dB",
    )
}
