//! Figures of sets of judged links: bearing errors, probabilities and refusals, ranges, another program's answers.

use super::{Judged, TrajectorySource};
use csi5300::maths::{median, percentile};
use csi5300::pipeline::Answer;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Errors of a set of links, degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Errors {
    /// Links with an error.
    pub links: usize,
    /// Mean of the absolute errors.
    pub mean_deg: f64,
    /// Their median.
    pub median_deg: f64,
    /// Their 90th percentile.
    pub p90_deg: f64,
    /// Share over 20 degrees, 0..1.
    pub over_20: f64,
}

impl Errors {
    /// Statistics of absolute errors; percentiles are interpolated linearly.
    #[must_use]
    pub fn of(errors_deg: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = errors_deg.map(f64::abs).filter(|e| e.is_finite()).collect();
        if sorted.is_empty() {
            // NaN, null in JSON: a set without links does not have error 0.
            let none = f64::NAN;
            return Self { links: 0, mean_deg: none, median_deg: none, p90_deg: none, over_20: none };
        }
        sorted.sort_by(f64::total_cmp);
        let n = sorted.len() as f64;
        let over = sorted.iter().filter(|e| **e > 20.0).count() as f64;
        Self {
            links: sorted.len(),
            mean_deg: sorted.iter().sum::<f64>() / n,
            median_deg: percentile(&sorted, 0.5),
            p90_deg: percentile(&sorted, 0.9),
            over_20: over / n,
        }
    }
}

/// Statistics of one set.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SetSummary {
    /// Number of links, including failed ones.
    pub links: usize,
    /// Links without a bearing.
    pub failed: usize,
    /// Against the bearing from the mean pose.
    pub from_mean_pose: Errors,
    /// Against the bearing from the start pose.
    pub from_start: Errors,
}

/// The name for all sets together.
pub const ALL_SETS: &str = "all";

/// Statistics by set (the first folder below the evaluated one) and of all.
#[must_use]
pub fn summarise(rows: &[Judged]) -> BTreeMap<String, SetSummary> {
    let summary = |rows: &[&Judged]| SetSummary {
        links: rows.len(),
        failed: rows.iter().filter(|row| row.answer.azimuth_deg.is_none()).count(),
        from_mean_pose: Errors::of(rows.iter().filter_map(|row| row.error_from_mean_pose_deg)),
        from_start: Errors::of(rows.iter().filter_map(|row| row.error_from_start_deg)),
    };
    let mut summaries: BTreeMap<String, SetSummary> =
        sets(rows).into_iter().map(|(set, own)| (set.to_owned(), summary(&own))).collect();
    summaries.insert(ALL_SETS.into(), summary(&rows.iter().collect::<Vec<_>>()));
    summaries
}

/// Links by set.
#[must_use]
pub fn sets(rows: &[Judged]) -> BTreeMap<&str, Vec<&Judged>> {
    let mut sets: BTreeMap<&str, Vec<&Judged>> = BTreeMap::new();
    for row in rows {
        sets.entry(row.set()).or_default().push(row);
    }
    sets
}

/// Bearings further off than this are wrong, degrees; probabilities refer to it.
pub const WRONG_DEG: f64 = 5.0;
/// Edges of the bins of probability, as for the expected calibration error.
const BINS: [f64; 6] = [0.0, 0.2, 0.4, 0.6, 0.8, 1.000_001];

/// A bearing's probability of being within five degrees, and its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sure {
    /// The probability, 0..1.
    pub probability: f64,
    /// Its absolute error, degrees.
    pub error_deg: f64,
}

impl Sure {
    /// A bearing with this probability and this error, degrees (of either sign).
    #[must_use]
    pub fn new(probability: f64, error_deg: f64) -> Self {
        Self { probability, error_deg: error_deg.abs() }
    }

    /// Whether it was within five degrees.
    #[must_use]
    pub fn is_right(&self) -> bool {
        self.error_deg <= WRONG_DEG
    }
}

/// Errors of the remaining bearings after refusing the least sure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kept {
    /// Share kept, 0..1.
    pub share: f64,
    /// Lowest probability of a kept bearing.
    pub confidence: f64,
    /// Errors of those kept.
    pub errors: Errors,
}

/// The result of keeping each of `shares`, rounded up to a whole bearing, the surest first; empty without bearings.
#[must_use]
pub fn surest(all: &[Sure], shares: impl Iterator<Item = f64>) -> Vec<Kept> {
    let mut falling = all.to_vec();
    falling.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    let of = |share: f64| {
        // Rounding errors of a share must not add a bearing.
        let count = ((falling.len() as f64 * share - 1e-9).ceil() as usize).min(falling.len());
        let kept = falling.get(..count).unwrap_or_default();
        let confidence = kept.last().map_or(0.0, |own| own.probability);
        Kept { share, confidence, errors: Errors::of(kept.iter().map(|own| own.error_deg)) }
    };
    if all.is_empty() { Vec::new() } else { shares.map(of).collect() }
}

/// Bearings of similar probability.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Reliability {
    /// Lower edge.
    pub from: f64,
    /// Upper edge.
    pub to: f64,
    /// Number of bearings.
    pub links: usize,
    /// Their mean probability.
    pub said: f64,
    /// Share that was within five degrees.
    pub right: f64,
}

/// How often bearings in each fifth of the probabilities were right, without empty fifths.
#[must_use]
pub fn reliability(all: &[Sure]) -> Vec<Reliability> {
    let bin = |edges: &[f64]| {
        let own: Vec<&Sure> = all.iter().filter(|own| (edges[0]..edges[1]).contains(&own.probability)).collect();
        let n = own.len().max(1) as f64;
        Reliability {
            from: edges[0],
            to: edges[1].min(1.0),
            links: own.len(),
            said: own.iter().map(|own| own.probability).sum::<f64>() / n,
            right: own.iter().filter(|own| own.is_right()).count() as f64 / n,
        }
    };
    BINS.windows(2).map(bin).filter(|bin| bin.links > 0).collect()
}

/// The risk-coverage curve: errors when 100, 90, .. 50 % are kept.
#[must_use]
pub fn risk_coverage(rows: &[Judged]) -> Vec<Kept> {
    surest(&sure(rows), (5..=10).rev().map(|tenths| f64::from(tenths) / 10.0))
}

/// The same in steps of 2 %, down to a tenth: for pictures.
#[must_use]
pub fn refusals(rows: &[Judged]) -> Vec<Kept> {
    surest(&sure(rows), (5..=50).rev().map(|fiftieths| f64::from(fiftieths) / 50.0))
}

/// Every link that has a probability and an error.
#[must_use]
pub fn sure(rows: &[Judged]) -> Vec<Sure> {
    rows.iter().filter_map(|row| Some(Sure::new(row.answer.confidence?, row.error_from_mean_pose_deg?))).collect()
}

/// Median of `|error| / deviation`, divided by that of a normal distribution: 1 if deviations are right, whatever a few false
/// answers do. `None` without links that have both.
fn scale(pairs: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let mut ratios: Vec<f64> = pairs.filter(|(_, sd)| *sd > 0.0).map(|(error, sd)| (error / sd).abs()).collect();
    median(&mut ratios).map(|ratio| ratio / 0.674_5)
}

/// The azimuths' errors relative to their error bars: 1 if the bars are right, less if they are too long.
#[must_use]
pub fn over_bound(rows: &[&Judged]) -> Option<f64> {
    scale(rows.iter().filter_map(|row| row.error_from_mean_pose_deg.zip(row.answer.azimuth_sd_deg)))
}

/// Errors of reported ranges.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Ranges {
    /// Links with a bearing and a true range.
    pub links: usize,
    /// Number of those that reported a range.
    pub reported: usize,
    /// Median of the absolute errors, metres.
    pub median_m: Option<f64>,
    /// Errors relative to the predicted deviations: 1 if the deviations are right.
    pub over_bound: Option<f64>,
    /// Numbers of reported places with a known truth, and of those within their 68 % and their 95 % ellipses.
    pub places: [usize; 3],
}

/// A plane normal distribution has 68.3 and 95.4 % within these deviations: `sqrt(-2 ln(1 - share))`.
const ELLIPSES: [f64; 2] = [1.515_8, 2.481_6];

/// Accuracy of the ranges.
#[must_use]
pub fn ranges(rows: &[&Judged]) -> Ranges {
    let known = rows.iter().filter(|row| row.true_range_m.is_some() && row.answer.azimuth_deg.is_some());
    let mut errors: Vec<f64> = rows.iter().filter_map(|row| row.range_error_m).map(f64::abs).collect();
    let reported = errors.len();
    // Errors are horizontal, and so are their deviations.
    let sd_m = |answer: &Answer| answer.range_sd_m.map(|sd| sd * horizontal(answer));
    let over_bound = scale(rows.iter().filter_map(|row| row.range_error_m.zip(sd_m(&row.answer))));
    let within = |most: f64| rows.iter().filter(|row| row.position_error_sd.is_some_and(|off| off <= most)).count();
    let places = [within(f64::INFINITY), within(ELLIPSES[0]), within(ELLIPSES[1])];
    Ranges { links: known.count(), reported, median_m: median(&mut errors), over_bound, places }
}

/// The horizontal share of an answer's range: the truth has no heights.
#[must_use]
pub(crate) fn horizontal(answer: &Answer) -> f64 {
    answer.abs_elevation_deg.unwrap_or(0.0).to_radians().cos()
}

/// The table's name in the evaluated folder.
pub const TABLE: &str = "links.csv";
/// Its columns that are read.
const COLUMNS: [&str; 5] = ["capture", "tx", "displacement", "peer_est_deg", "peer_err_from_mean_pose_deg"];

/// Another program's answer on a link.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Beside {
    /// Its azimuth, degrees.
    pub azimuth_deg: f64,
    /// Its error against the bearing from the mean pose, degrees.
    pub error_deg: f64,
}

/// Another program's answers by link name, for one kind of trajectory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    links: BTreeMap<String, Beside>,
    bad_rows: usize,
}

impl Table {
    /// Reads the table of a folder; `None` if there is no such file. Counts rows without numbers.
    ///
    /// # Errors
    /// If the file exists and is not such a table.
    pub fn read(folder: &Path, source: TrajectorySource) -> Result<Option<Self>, String> {
        let path = folder.join(TABLE);
        if !path.is_file() {
            return Ok(None);
        }
        let unreadable = |error: csv::Error| format!("{TABLE}: {error}");
        let mut reader = csv::ReaderBuilder::new().flexible(true).from_path(path).map_err(unreadable)?;
        let head = reader.headers().map_err(unreadable)?.clone();
        let lacking = |column| format!("{TABLE} has no column `{column}`: it is skipped");
        let mut places = [0; COLUMNS.len()];
        for (place, column) in places.iter_mut().zip(COLUMNS) {
            *place = head.iter().position(|name| name == column).ok_or_else(|| lacking(column))?;
        }
        let displacement = match source {
            TrajectorySource::GroundTruth => "gt",
            TrajectorySource::T265 | TrajectorySource::RollingT265 => "t265",
            TrajectorySource::Odometry => "odom",
        };
        let mut table = Self::default();
        for row in reader.records() {
            let Ok(row) = row else {
                table.bad_rows += 1;
                continue;
            };
            let [capture, tx, kind, azimuth, error] = places.map(|place| row.get(place).unwrap_or_default());
            if kind != displacement {
                continue;
            }
            let number = |text: &str| text.trim().parse::<f64>().ok().filter(|value| value.is_finite());
            match number(azimuth).zip(number(error)) {
                Some((azimuth_deg, error_deg)) => {
                    table.links.insert(format!("{capture}/{tx}"), Beside { azimuth_deg, error_deg });
                }
                None => table.bad_rows += 1,
            }
        }
        Ok(Some(table))
    }

    /// [`Self::read`] with a message about a skipped table or skipped rows; both are losses.
    #[must_use]
    pub fn noted(folder: &Path, source: TrajectorySource) -> (Option<Self>, Option<String>) {
        let said = |words: String| Some(format!("{}: {words}", folder.display()));
        match Self::read(folder, source) {
            Err(error) => (None, said(error)),
            Ok(Some(table)) if table.bad_rows > 0 => {
                let rows = csi5300_say::count(table.bad_rows as u64, "row", "rows");
                (Some(table), said(format!("{TABLE}: {rows} without numbers skipped")))
            }
            Ok(table) => (table, None),
        }
    }

    /// The answer on a link.
    #[must_use]
    pub fn of(&self, link: &str) -> Option<Beside> {
        self.links.get(link).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::judge::row;
    use crate::temporary::Temporary;

    /// Ten bearings, the surest first, with errors of 0, 1, .. 9 degrees.
    fn ten() -> Vec<Sure> {
        (0..10).map(|k| Sure::new(1.0 - 0.1 * f64::from(k), -f64::from(k))).collect()
    }

    #[test]
    fn refusing_the_unsure_lowers_the_error() {
        let all = ten();
        let curve = surest(&all, [1.0, 0.5].into_iter());
        assert_eq!((curve[0].errors.links, curve[1].errors.links), (10, 5));
        assert!((curve[1].errors.mean_deg - 2.0).abs() < 1e-12 && (curve[0].errors.mean_deg - 4.5).abs() < 1e-12);
        assert!(surest(&[], [1.0].into_iter()).is_empty());
        // The same of judged rows.
        let rows: Vec<Judged> = (0..10).map(|k| row("a/x", 0.0, f64::from(k), 1.0 - f64::from(k) * 0.1)).collect();
        let of_rows = risk_coverage(&rows);
        assert_eq!((of_rows.len(), of_rows[0].errors, of_rows[5].errors), (6, curve[0].errors, curve[1].errors));
        assert!(risk_coverage(&[]).is_empty());
    }

    #[test]
    fn every_bearing_is_in_one_bin() {
        let bins = reliability(&ten());
        assert_eq!(bins.iter().map(|bin| bin.links).sum::<usize>(), 10);
        let last = bins[bins.len() - 1];
        assert!(last.right == 1.0 && last.said > 0.8 && last.to == 1.0, "{last:?}");
        assert!(reliability(&[]).is_empty());
    }

    #[test]
    fn correct_deviations_have_a_scale_of_one() {
        let with_sd = |k: i32| {
            let mut row = row("a/x", 0.0, f64::from(k), 0.5);
            row.answer.azimuth_sd_deg = Some(10.0);
            row
        };
        // Half of all normal errors are within 0.6745 deviations.
        let rows: Vec<Judged> = (-13..=13).map(with_sd).collect();
        let rows: Vec<&Judged> = rows.iter().collect();
        assert!((over_bound(&rows).unwrap() - 0.7 / 0.674_5).abs() < 1e-9, "{:?}", over_bound(&rows));
        assert_eq!(over_bound(&[]), None);
        assert_eq!(ranges(&rows), Ranges { links: 0, reported: 0, median_m: None, over_bound: None, places: [0; 3] });
        // At an elevation of 60 degrees, half a slant deviation is a whole horizontal one.
        let slant = |elevation_deg: f64| {
            let mut row = row("a/x", 0.0, 0.0, 0.5);
            row.answer.abs_elevation_deg = Some(elevation_deg);
            (row.answer.range_sd_m, row.range_error_m, row.true_range_m) = (Some(0.2), Some(0.1), Some(3.0));
            ranges(&[&row])
        };
        assert!((slant(60.0).over_bound.unwrap() - 1.0 / 0.674_5).abs() < 1e-9, "{:?}", slant(60.0));
        assert!((slant(0.0).over_bound.unwrap() - 0.5 / 0.674_5).abs() < 1e-9, "{:?}", slant(0.0));
    }

    #[test]
    fn links_are_found_by_name_and_trajectory_and_bad_rows_are_counted() {
        let folder = &Temporary::folder("beside").0;
        assert_eq!(Table::read(folder, TrajectorySource::GroundTruth).unwrap(), None);
        let rows = "tx,capture,displacement,other,peer_est_deg,peer_err_from_mean_pose_deg\n\
                    tx2,A/L1/x,gt,1,132.8,5.9\ntx2,A/L1/x,t265,1,125.8,-1.0\ntx3,A/L1/x,gt,1,,\ntx4,A/L1/x,gt\n";
        std::fs::write(folder.join(TABLE), rows).unwrap();
        let table = Table::read(folder, TrajectorySource::GroundTruth).unwrap().unwrap();
        assert_eq!(table.of("A/L1/x/tx2"), Some(Beside { azimuth_deg: 132.8, error_deg: 5.9 }));
        assert_eq!((table.of("A/L1/x/tx3"), table.bad_rows), (None, 2));
        let (noted, note) = Table::noted(folder, TrajectorySource::GroundTruth);
        assert!(noted == Some(table) && note.unwrap().ends_with("links.csv: 2 rows without numbers skipped"));
        let camera = Table::read(folder, TrajectorySource::T265).unwrap().unwrap();
        assert_eq!(camera.of("A/L1/x/tx2").map(|beside| beside.error_deg), Some(-1.0));
        assert_eq!(Table::noted(folder, TrajectorySource::T265), (Some(camera), None));
        std::fs::write(folder.join(TABLE), "a,b\n1,2\n").unwrap();
        let error = Table::read(folder, TrajectorySource::GroundTruth).unwrap_err();
        assert!(error.to_string().contains("no column `capture`"), "{error}");
        let (noted, note) = Table::noted(folder, TrajectorySource::GroundTruth);
        assert!(noted.is_none() && note.unwrap().contains("no column `capture`"));
    }
}
