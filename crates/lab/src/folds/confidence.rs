//! Probabilities of places that the models were not fitted to.

use super::gather::{FoldRow, Kind, PARTS, SOURCES};
use super::report::{Which, sight};
use crate::evaluate::{Kept, Reliability, Sure, TrajectorySource, WRONG_DEG, above, reliability, surest};
use crate::fit_confidence::{LabelledBearing, LogisticModel, calibration};
use csi5300::internal::{heading_feature, probability_limits};
use csi5300_sim::random::Stream;
use serde::Serialize;
use std::collections::BTreeSet;

/// Outcomes drawn to see what a perfect probability would have for an error.
const DRAWS: usize = 200;

/// How well probabilities from other places agree with what happened.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ConfidenceColumn {
    /// Trajectory.
    pub source: TrajectorySource,
    /// Parts that the motion was cut into.
    pub parts: u32,
    /// Kind of answer.
    pub kind: Kind,
    /// Bearings with a probability.
    pub bearings: usize,
    /// Share of them within five degrees.
    pub right: f64,
    /// Mean probability.
    pub said: f64,
    /// Expected calibration error in five bins, places weighing the same.
    pub expected_error: f64,
    /// The same for outcomes drawn from the probabilities themselves, on average: what so few bearings show of a
    /// perfect calibration.
    pub perfect: f64,
    /// Its bins.
    pub bins: Vec<Reliability>,
}

/// What refusing bearings of low probability keeps and costs.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RefusalColumn {
    /// What it is of; its group is `LOS`, `NLOS` or `all`.
    #[serde(flatten)]
    pub which: Which,
    /// Those of at least 0, 0.1, .. 0.9.
    pub above: Vec<Kept>,
    /// The surest 100, 90, .. 50 %.
    pub surest: Vec<Kept>,
}

/// A bearing with its probability from all other places.
struct Told<'a> {
    row: &'a FoldRow,
    labelled: LabelledBearing,
    error_deg: f64,
}

impl Told<'_> {
    fn sure(&self) -> Sure {
        Sure::new(self.labelled.probability, self.error_deg)
    }
}

/// The columns of one kind of answer.
pub(super) fn columns(rows: &[FoldRow], kind: Kind) -> (Vec<ConfidenceColumn>, Vec<RefusalColumn>) {
    let told = told(rows, kind);
    (calibrations(&told, kind), refusals(&told, kind))
}

fn calibrations(told: &[Told<'_>], kind: Kind) -> Vec<ConfidenceColumn> {
    let each = SOURCES.into_iter().flat_map(|source| PARTS.map(move |parts| (source, parts)));
    let column = |(source, parts)| {
        let own: Vec<&Told<'_>> =
            told.iter().filter(|told| told.row.source == source && told.row.part.of == parts).collect();
        (!own.is_empty()).then(|| column(source, parts, kind, &own))
    };
    each.filter_map(column).collect()
}

/// What refusals keep of whole motions, halves and quarters in sight, behind walls, and together.
fn refusals(told: &[Told<'_>], kind: Kind) -> Vec<RefusalColumn> {
    let mut columns = Vec::new();
    for (source, parts) in SOURCES.into_iter().flat_map(|source| PARTS.map(|parts| (source, parts))) {
        for group in ["LOS", "NLOS", "all"] {
            let belongs = |row: &FoldRow| group == "all" || sight(&row.set) == Some(group);
            let is_of = |told: &&Told<'_>| told.row.source == source && told.row.part.of == parts && belongs(told.row);
            let own: Vec<Sure> = told.iter().filter(is_of).map(Told::sure).collect();
            let tenths = |from: u32, to: u32| (from..=to).map(|tenths| f64::from(tenths) / 10.0);
            let (above, surest) = (above(&own, &tenths(0, 9).collect::<Vec<_>>()), surest(&own, tenths(5, 10).rev()));
            let which = Which { source, parts, kind, group: group.to_owned() };
            columns.extend((!own.is_empty()).then_some(RefusalColumn { which, above, surest }));
        }
    }
    columns
}

fn column(source: TrajectorySource, parts: u32, kind: Kind, told: &[&Told<'_>]) -> ConfidenceColumn {
    let own: Vec<&LabelledBearing> = told.iter().map(|told| &told.labelled).collect();
    let own = own.as_slice();
    let probabilities: Vec<f64> = own.iter().map(|row| row.probability).collect();
    let bearings = own.len();
    ConfidenceColumn {
        source,
        parts,
        kind,
        bearings,
        right: own.iter().filter(|row| row.right).count() as f64 / bearings as f64,
        said: probabilities.iter().sum::<f64>() / bearings as f64,
        expected_error: calibration(own, &probabilities).expected_error,
        perfect: perfect(own, &probabilities),
        bins: reliability(&told.iter().map(|told| told.sure()).collect::<Vec<_>>()),
    }
}

/// The calibration error of outcomes that are drawn from the probabilities, on average.
fn perfect(own: &[&LabelledBearing], probabilities: &[f64]) -> f64 {
    let mut random = Stream::of_seed(1);
    let mut draw = || {
        let drawn: Vec<LabelledBearing> = own
            .iter()
            .map(|row| LabelledBearing { right: random.happens(row.probability), ..(*row).clone() })
            .collect();
        calibration(&drawn.iter().collect::<Vec<_>>(), probabilities).expected_error
    };
    (0..DRAWS).map(|_| draw()).sum::<f64>() / DRAWS as f64
}

/// What probabilities are fitted to: all bearings that have one. Their last feature is that of the trajectory's heading.
#[must_use]
pub fn labelled(rows: &[FoldRow], kind: Kind) -> Vec<LabelledBearing> {
    rows.iter().filter_map(|row| label(row, kind)).collect()
}

fn label(row: &FoldRow, kind: Kind) -> Option<LabelledBearing> {
    let answered = row.answered(kind).filter(|answered| !answered.mirrored)?;
    let mut features = answered.features.clone()?;
    features.push(heading_feature(row.heading_sd_rad));
    Some(LabelledBearing {
        place: row.place.clone(),
        parts: row.part.of,
        features,
        right: answered.error_deg.abs() <= WRONG_DEG,
        probability: f64::NAN,
    })
}

/// Every bearing with the probability of a model that was fitted to all other places.
fn told(rows: &[FoldRow], kind: Kind) -> Vec<Told<'_>> {
    let places: BTreeSet<&str> = rows.iter().map(|row| row.place.as_str()).collect();
    let fitted = labelled(rows, kind);
    let mut told = Vec::new();
    for place in places {
        let others: Vec<&LabelledBearing> = fitted.iter().filter(|row| row.place != place).collect();
        let Some(model) = LogisticModel::fit(&others) else { continue };
        let own = rows.iter().filter(|row| row.place == place);
        told.extend(own.filter_map(|row| {
            let mut labelled = label(row, kind)?;
            let [least, most] = probability_limits();
            labelled.probability = model.probability(&labelled.features).clamp(least, most);
            let error_deg = row.answered(kind)?.error_deg;
            Some(Told { row, labelled, error_deg })
        }));
    }
    told
}
