//! The drift of one card's clock against another's, as a straight line.

use crate::maths::upper_median;

/// Outliers are further than this from the line, microseconds (the jitter is 4 to 22).
const OUTLIER_US: f64 = 25.0;

/// `value = middle + slope * (x - middle_x)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriftLine {
    /// Counts of drift per count of the clock.
    pub(super) slope: f64,
    x: f64,
    y: f64,
}

impl DriftLine {
    /// The value at `x`.
    #[must_use]
    pub fn at(&self, x: f64) -> f64 {
        self.y + self.slope * (x - self.x)
    }
}

/// The drift of one card's clock against another's: a line through `difference_us` (their difference) over `clock_us` (one
/// of them), both unwrapped, microseconds, one entry per pair in time order.
///
/// The median of the slopes between pairs half a record apart (after Theil and Sen \[theil-sen\]), then least squares without
/// the pairs that are further than 25 us from the line, four times over.
pub fn drift_line(clock_us: &[i64], difference_us: &[i64]) -> DriftLine {
    drift_line_of(clock_us, difference_us, slope_between(clock_us, difference_us, clock_us.len() / 2))
}

/// The median of the slopes between pairs `lag` apart. A turn-around that steps to another level tilts it only if more than half of
/// them have the step between them, and the shorter they are the fewer have.
pub(super) fn slope_between(clock_us: &[i64], difference_us: &[i64], lag: usize) -> f64 {
    let slope = |k: usize| {
        let run = (clock_us[k + lag] - clock_us[k]) as f64;
        (run > 0.0).then(|| (difference_us[k + lag] - difference_us[k]) as f64 / run)
    };
    median((0..clock_us.len() - lag).filter_map(slope).collect())
}

/// The line about one of this slope.
pub(super) fn drift_line_of(clock_us: &[i64], difference_us: &[i64], slope: f64) -> DriftLine {
    let n = clock_us.len();
    let origin = clock_us[0] as f64;
    let y = median((0..n).map(|k| difference_us[k] as f64 - slope * (clock_us[k] as f64 - origin)).collect());
    let mut line = DriftLine { slope, x: origin, y };
    for _ in 0..4 {
        let near = (0..n).filter(|&k| (difference_us[k] as f64 - line.at(clock_us[k] as f64)).abs() <= OUTLIER_US);
        let (mut count, mut sx, mut sy) = (0.0, 0.0, 0.0);
        for k in near.clone() {
            count += 1.0;
            sx += clock_us[k] as f64 - origin;
            sy += difference_us[k] as f64 - y;
        }
        if count < 4.0 {
            break;
        }
        let (mx, my) = (sx / count, sy / count);
        let (mut sxx, mut sxy) = (0.0, 0.0);
        for k in near {
            let x = clock_us[k] as f64 - origin - mx;
            sxx += x * x;
            sxy += x * (difference_us[k] as f64 - y - my);
        }
        if sxx <= 0.0 {
            break;
        }
        line = DriftLine { slope: sxy / sxx, x: origin + mx, y: y + my };
    }
    line
}

/// The upper median; 0 if there are no values.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    upper_median(&mut values).unwrap_or(0.0)
}
