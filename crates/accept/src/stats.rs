//! Certain decisions about shares and means.

use csi5300::maths::nearest_rank;

/// Standard deviations of a normal distribution beyond which 1 in 10,000 values lies on one side.
pub const SURE: f64 = 3.72;

/// Wilson's bounds of a share of `count` in `total` (Wilson 1927), each wrong once in 10,000.
#[must_use]
pub fn share_bounds(count: usize, total: usize) -> (f64, f64) {
    let (count, total) = (count as f64, total as f64);
    if total <= 0.0 {
        return (0.0, 1.0);
    }
    let (share, square) = (count / total, SURE * SURE);
    let middle = share + square / (2.0 * total);
    let half = SURE * (share * (1.0 - share) / total + square / (4.0 * total * total)).sqrt();
    let scale = 1.0 + square / total;
    (((middle - half) / scale).max(0.0), ((middle + half) / scale).min(1.0))
}

/// Mean of values and its standard error; `None` of fewer than two.
#[must_use]
pub fn mean_and_error(values: &[f64]) -> Option<(f64, f64)> {
    let n = values.len() as f64;
    if values.len() < 2 {
        return None;
    }
    let mean = values.iter().sum::<f64>() / n;
    let square = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0);
    Some((mean, (square / n).sqrt()))
}

/// The quantile of the values at a share; `None` without values. Ignores not-a-number.
#[must_use]
pub fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut values: Vec<f64> = values.iter().copied().filter(|value| !value.is_nan()).collect();
    values.sort_by(f64::total_cmp);
    nearest_rank(&values, share)
}

/// The line through points with up to a third of outliers: (value at `x = 0`, slope, standard error of the slope). It
/// starts from the medians of the outer thirds and repeats least squares on the points within three deviations.
#[must_use]
pub fn line(points: &[(f64, f64)]) -> Option<(f64, f64, f64)> {
    let third = points.len() / 3;
    let median = |points: &[(f64, f64)]| {
        let xs: Vec<f64> = points.iter().map(|point| point.0).collect();
        let ys: Vec<f64> = points.iter().map(|point| point.1).collect();
        Some((quantile(&xs, 0.5)?, quantile(&ys, 0.5)?))
    };
    let (first, last) = (median(points.get(..third)?)?, median(points.get(points.len() - third..)?)?);
    let mut slope = (last.1 - first.1) / (last.0 - first.0);
    let mut offset = first.1 - slope * first.0;
    let mut error = f64::NAN;
    for _ in 0..4 {
        let away: Vec<f64> = points.iter().map(|(x, y)| (y - offset - slope * x).abs()).collect();
        let limit = 3.0 * 1.4826 * quantile(&away, 0.5)?.max(1e-9);
        let kept: Vec<(f64, f64)> =
            points.iter().zip(&away).filter(|(_, away)| **away <= limit).map(|(point, _)| *point).collect();
        let n = kept.len() as f64;
        let (mean_x, mean_y) = (kept.iter().map(|p| p.0).sum::<f64>() / n, kept.iter().map(|p| p.1).sum::<f64>() / n);
        let spread: f64 = kept.iter().map(|p| (p.0 - mean_x).powi(2)).sum();
        slope = kept.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum::<f64>() / spread;
        offset = mean_y - slope * mean_x;
        let square: f64 = kept.iter().map(|(x, y)| (y - offset - slope * x).powi(2)).sum();
        error = (square / (n - 2.0).max(1.0) / spread).sqrt();
    }
    (slope.is_finite() && error.is_finite()).then_some((offset, slope, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_hold_the_share() {
        let (low, high) = share_bounds(10, 1_000);
        assert!(low < 0.01 && high > 0.01 && high < 0.04, "{low} {high}");
        assert_eq!(share_bounds(0, 0), (0.0, 1.0));
        assert!(share_bounds(0, 1_000).1 < 0.015);
        // Interval of the binomial distribution by Clopper and Pearson: 0.0023 to 0.0274.
        assert!((low - 0.0031).abs() < 0.002, "{low}");
    }

    #[test]
    fn a_line_is_found_beside_outliers() {
        let points: Vec<(f64, f64)> = (0..300)
            .map(|k| (f64::from(k), 5.0 + 0.25 * f64::from(k) + if k % 4 == 0 { 400.0 } else { f64::from(k % 3) }))
            .collect();
        let (_, slope, error) = line(&points).unwrap();
        assert!((slope - 0.25).abs() < SURE * error + 1e-3, "{slope} {error}");
        assert_eq!(line(&[(0.0, 1.0)]), None);
        assert_eq!(quantile(&[], 0.5), None);
        assert_eq!(mean_and_error(&[1.0, 3.0]), Some((2.0, 1.0)));
    }
}
