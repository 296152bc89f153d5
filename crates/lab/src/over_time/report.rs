//! Errors by group and by how much was driven.

use super::gather::Drive;
use crate::evaluate::{Errors, WRONG_DEG};
use crate::fit_confidence::{Calibration, LabelledBearing, calibration};
use csi5300::internal::track::TrackSettings;
use serde::Serialize;
use std::collections::BTreeMap;

/// Errors of one group of links.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Column {
    /// The group.
    pub group: String,
    /// Links in it.
    pub links: usize,
    /// After each number of stretches.
    pub points: Vec<Point>,
    /// Answers that were carried, one after each stretch that has a bearing.
    pub carried: usize,
    /// Mean of the probabilities that they were within five degrees.
    pub said: f64,
    /// Share of them that was.
    pub right: f64,
    /// Mean squared difference between those probabilities and what was, each place weighing the same.
    pub brier: f64,
    /// Expected calibration error of those probabilities in five bins, each place weighing the same.
    pub expected_error: f64,
    /// Share of their errors within the error bar.
    pub within: f64,
    /// Share of their errors within twice the error bar.
    pub within_twice: f64,
}

/// Errors after some stretches, degrees.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Point {
    /// Stretches driven.
    pub stretches: u32,
    /// Of the last stretch by itself.
    pub single: Errors,
    /// Of what was carried, on the same links.
    pub carried: Errors,
    /// Of the whole motion so far at once, on those of the links that have one.
    pub at_once: Errors,
}

/// What [`report`] gives.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Report {
    /// One column for each group.
    pub columns: Vec<Column>,
}

/// The errors of `drives` by groups, which `group` names; `settings` are those of each drive's filter.
#[must_use]
pub fn report(
    drives: &[Drive],
    group: &dyn Fn(&Drive) -> String,
    settings: &dyn Fn(&Drive) -> TrackSettings,
) -> Report {
    let mut groups: BTreeMap<String, Vec<&Drive>> = BTreeMap::new();
    drives.iter().for_each(|drive| groups.entry(group(drive)).or_default().push(drive));
    let columns = groups.into_iter().map(|(group, drives)| column(group, &drives, settings)).collect();
    Report { columns }
}

/// One carried answer: its place, the stretch, its own error, the carried one's, that of all at once; probability and error bar.
struct Row {
    place: String,
    stretch: usize,
    single_deg: f64,
    carried_deg: f64,
    at_once_deg: Option<f64>,
    said: f64,
    bar_deg: f64,
}

fn column(group: String, drives: &[&Drive], settings: &dyn Fn(&Drive) -> TrackSettings) -> Column {
    let rows = |drive: &&Drive| {
        let of = |carried: super::gather::Carried| {
            let stretch = drive.stretches.get(carried.index)?;
            Some(Row {
                place: drive.place.clone(),
                stretch: carried.index,
                single_deg: stretch.own.as_ref()?.error_deg,
                carried_deg: carried.error_deg,
                at_once_deg: stretch.so_far_deg,
                said: carried.answer.probability,
                bar_deg: carried.answer.azimuth_sd_rad.to_degrees(),
            })
        };
        drive.carried(settings(drive)).into_iter().filter_map(of).collect::<Vec<_>>()
    };
    let rows: Vec<Row> = drives.iter().flat_map(rows).collect();
    let most = rows.iter().map(|row| row.stretch + 1).max().unwrap_or(0);
    let point = |stretch: usize| {
        let own = || rows.iter().filter(move |row| row.stretch == stretch);
        Point {
            stretches: stretch as u32 + 1,
            single: Errors::of(own().map(|row| row.single_deg)),
            carried: Errors::of(own().map(|row| row.carried_deg)),
            at_once: Errors::of(own().filter_map(|row| row.at_once_deg)),
        }
    };
    let calibration = calibrated(&rows);
    let share =
        |holds: &dyn Fn(&Row) -> bool| rows.iter().filter(|row| holds(row)).count() as f64 / rows.len().max(1) as f64;
    Column {
        links: drives.len(),
        points: (0..most).map(point).collect(),
        carried: rows.len(),
        said: rows.iter().map(|row| row.said).sum::<f64>() / rows.len().max(1) as f64,
        brier: calibration.brier,
        expected_error: calibration.expected_error,
        right: share(&|row| row.carried_deg.abs() <= WRONG_DEG),
        within: share(&|row| row.carried_deg.abs() <= row.bar_deg),
        within_twice: share(&|row| row.carried_deg.abs() <= 2.0 * row.bar_deg),
        group,
    }
}

/// The answers as what probabilities are judged by.
fn calibrated(rows: &[Row]) -> Calibration {
    let label = |row: &Row| LabelledBearing {
        place: row.place.clone(),
        parts: 1,
        features: Vec::new(),
        right: row.carried_deg.abs() <= WRONG_DEG,
        probability: row.said,
    };
    let own: Vec<LabelledBearing> = rows.iter().map(label).collect();
    calibration(&own.iter().collect::<Vec<_>>(), &own.iter().map(|row| row.probability).collect::<Vec<f64>>())
}
