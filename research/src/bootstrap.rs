//! Intervals of statistics by resampling places.

use csi5300::maths::percentile;
use csi5300_lab::evaluate::Errors;
use csi5300_sim::random::Stream;

/// Samples of places.
const SAMPLES: usize = 1_000;
/// Random seed.
const SEED: u64 = 15;
/// Share of the samples below and above an interval.
const OUTSIDE: f64 = 0.025;

/// The range of a statistic for 95 % of the samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Interval {
    /// 2.5 % of the samples are below it.
    pub low: f64,
    /// 2.5 % are above it.
    pub high: f64,
}

/// Intervals of mean, median, 90th percentile and share over 20 degrees of absolute errors, by resampling places (with all their
/// errors) with replacement.
pub fn intervals(places: &[Vec<f64>]) -> [Interval; 4] {
    let Some(count) = u64::try_from(places.len()).ok().filter(|count| *count > 0) else {
        return [Interval::default(); 4];
    };
    let mut random = Stream::of_seed(SEED);
    let mut drawn: [Vec<f64>; 4] = Default::default();
    for _ in 0..SAMPLES {
        let chosen: Vec<usize> = (0..places.len()).map(|_| random.below(count) as usize).collect();
        let errors = Errors::of(chosen.iter().filter_map(|&place| places.get(place)).flatten().copied());
        let found = [errors.mean_deg, errors.median_deg, errors.p90_deg, errors.over_20];
        drawn.iter_mut().zip(found).for_each(|(all, own)| all.push(own));
    }
    drawn.map(|mut all| {
        all.sort_by(f64::total_cmp);
        Interval { low: percentile(&all, OUTSIDE), high: percentile(&all, 1.0 - OUTSIDE) }
    })
}

/// Intervals of the difference in mean, median and share over 20 degrees between the second of two designs and the first, on the same
/// links: `(error of the first, error of the second)` by place.
pub fn differences(places: &[Vec<(f64, f64)>]) -> [Interval; 3] {
    let Some(count) = u64::try_from(places.len()).ok().filter(|count| *count > 0) else {
        return [Interval::default(); 3];
    };
    let mut random = Stream::of_seed(SEED);
    let mut drawn: [Vec<f64>; 3] = Default::default();
    for _ in 0..SAMPLES {
        let chosen: Vec<usize> = (0..places.len()).map(|_| random.below(count) as usize).collect();
        let found = difference(chosen.iter().filter_map(|&place| places.get(place)).flatten().copied());
        drawn.iter_mut().zip(found).for_each(|(all, own)| all.push(own));
    }
    drawn.map(|mut all| {
        all.sort_by(f64::total_cmp);
        Interval { low: percentile(&all, OUTSIDE), high: percentile(&all, 1.0 - OUTSIDE) }
    })
}

/// Difference in mean, median and share over 20 degrees between the second of two designs and the first.
pub fn difference(pairs: impl Iterator<Item = (f64, f64)>) -> [f64; 3] {
    let (first, second): (Vec<f64>, Vec<f64>) = pairs.unzip();
    let (first, second) = (Errors::of(first.into_iter()), Errors::of(second.into_iter()));
    [second.mean_deg - first.mean_deg, second.median_deg - first.median_deg, second.over_20 - first.over_20]
}

impl std::fmt::Display for Interval {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.2} to {:.2}", self.low, self.high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interval_of_the_mean_is_as_wide_as_its_standard_error() {
        let mut random = Stream::of_seed(1);
        let places: Vec<Vec<f64>> = (0..100).map(|_| vec![random.between(0.0, 12.0); 3]).collect();
        let mean = places.iter().map(|own| own[0]).sum::<f64>() / 100.0;
        let [own, median, ..] = intervals(&places);
        // A uniform distribution 12 wide has a deviation of 3.46: 0.346 for the mean of a hundred places, however many copies each has.
        assert!(own.low < mean && mean < own.high, "{own:?} {mean}");
        assert!(((own.high - own.low) / (2.0 * 1.96 * 0.346) - 1.0).abs() < 0.2, "{own:?}");
        assert!(median.low < median.high, "{median:?}");
        assert_eq!(intervals(&places), intervals(&places));
        assert_eq!(intervals(&[]), [Interval::default(); 4]);
    }

    #[test]
    fn a_common_growth_is_certain_and_one_of_half_the_links_is_not() {
        let mut random = Stream::of_seed(2);
        let mut places = |more: [f64; 2]| -> Vec<Vec<(f64, f64)>> {
            let place = |k: usize| (0..3).map(|_| random.between(0.0, 12.0)).map(|e| (e, e + more[k % 2])).collect();
            (0..20).map(place).collect()
        };
        let [mean, median, over] = differences(&places([0.5, 0.5]));
        assert!((mean.low - 0.5).abs() < 1e-9 && (mean.high - 0.5).abs() < 1e-9, "{mean:?}");
        assert!((median.low - 0.5).abs() < 1e-9, "{median:?}");
        assert_eq!(over, Interval::default());
        let [mean, ..] = differences(&places([-1.0, 1.0]));
        assert!(mean.low < -0.2 && mean.high > 0.2, "{mean:?}");
        assert_eq!(differences(&[]), [Interval::default(); 3]);
    }
}
