//! Error bars of places that they were not fitted to.

use super::gather::{FoldRow, Kind, PARTS, SOURCES};
use super::report::{Which, sight};
use crate::fit_error_bar::{ErrorBarModel, ErrorRow};
use csi5300::maths::median;
use serde::Serialize;
use std::collections::BTreeSet;

/// No error bar is longer than that of a uniform guess, degrees: 180 / sqrt 3.
const LONGEST_DEG: f64 = 103.923_048_454_132_64;

/// How error bars from other places compare with errors.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ErrorBarColumn {
    /// What it is of; its group is `LOS`, `NLOS` or `all`.
    #[serde(flatten)]
    pub which: Which,
    /// Bearings.
    pub bearings: usize,
    /// Share of errors within the error bar; 0.68 is meant.
    pub within: f64,
    /// Share within twice the error bar; 0.95 is meant.
    pub within_twice: f64,
    /// Median of error over error bar; 0.67 for normal errors.
    pub ratio: f64,
    /// Median error bar, degrees.
    pub median_deg: f64,
    /// Median of error over Cramer-Rao bound.
    pub over_bound: f64,
}

/// Rows of an error bar's fit: all bearings that have one.
#[must_use]
pub fn error_rows(rows: &[FoldRow], kind: Kind) -> Vec<ErrorRow> {
    rows.iter().filter_map(|row| error_row(row, kind)).collect()
}

fn error_row(row: &FoldRow, kind: Kind) -> Option<ErrorRow> {
    let answered = row.answered(kind).filter(|answered| !answered.mirrored)?;
    let heading_deg = row.heading_sd_rad.to_degrees();
    Some(ErrorRow::new(row.place.clone(), row.part.of, answered.features.clone()?, answered.error_deg, heading_deg))
}

/// A bearing, its error bar from all other places, and its error.
struct Barred<'a> {
    row: &'a FoldRow,
    kind: Kind,
    error_deg: f64,
    bar_deg: f64,
    bound_deg: f64,
}

pub(super) fn columns(rows: &[FoldRow]) -> Vec<ErrorBarColumn> {
    let barred = barred(rows);
    let mut columns = Vec::new();
    for kind in [Kind::Full, Kind::Quick] {
        for (source, parts) in SOURCES.into_iter().flat_map(|source| PARTS.map(|parts| (source, parts))) {
            for group in ["LOS", "NLOS", "all"] {
                let is_of = |own: &&Barred<'_>| {
                    let row = own.row;
                    let belongs = group == "all" || sight(&row.set) == Some(group);
                    belongs && own.kind == kind && row.source == source && row.part.of == parts
                };
                let own: Vec<&Barred<'_>> = barred.iter().filter(is_of).collect();
                let which = Which { source, parts, kind, group: group.to_owned() };
                columns.extend((!own.is_empty()).then(|| column(which, &own)));
            }
        }
    }
    columns
}

fn column(which: Which, own: &[&Barred<'_>]) -> ErrorBarColumn {
    let middle = |of: &dyn Fn(&Barred<'_>) -> f64| {
        median(&mut own.iter().map(|one| of(one)).collect::<Vec<f64>>()).unwrap_or(f64::NAN)
    };
    let within =
        |times: f64| own.iter().filter(|one| one.error_deg <= times * one.bar_deg).count() as f64 / own.len() as f64;
    ErrorBarColumn {
        which,
        bearings: own.len(),
        within: within(1.0),
        within_twice: within(2.0),
        ratio: middle(&|one| one.error_deg / one.bar_deg),
        median_deg: middle(&|one| one.bar_deg),
        over_bound: middle(&|one| one.error_deg / one.bound_deg),
    }
}

/// Every bearing with the error bar of models that were fitted to all other places.
fn barred(rows: &[FoldRow]) -> Vec<Barred<'_>> {
    let places: BTreeSet<&str> = rows.iter().map(|row| row.place.as_str()).collect();
    let kinds = [Kind::Full, Kind::Quick];
    let fitted = kinds.map(|kind| error_rows(rows, kind));
    let mut barred = Vec::new();
    for place in places {
        let others = fitted.each_ref().map(|own| own.iter().filter(|row| row.place != place).collect::<Vec<_>>());
        let models = others.each_ref().map(|own| ErrorBarModel::fit(own));
        let own = rows.iter().filter(|row| row.place == place);
        for (row, (kind, model)) in own.flat_map(|row| kinds.iter().zip(&models).map(move |own| (row, own))) {
            let Some((model, own)) = model.as_ref().zip(error_row(row, *kind)) else { continue };
            let bound_deg = row.answered(*kind).map_or(0.0, |answered| answered.bound_deg);
            let bar_deg = model.error_bar_deg(&own.features, own.heading_deg).max(bound_deg).min(LONGEST_DEG);
            barred.push(Barred { row, kind: *kind, error_deg: own.error_deg.abs(), bar_deg, bound_deg });
        }
    }
    barred
}
