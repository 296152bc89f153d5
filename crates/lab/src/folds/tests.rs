use super::*;
use crate::evaluate::{Part, TrajectorySource};
use std::sync::LazyLock;

/// Bearings of 20 places, of which every fourth is wrong, as a feature says.
fn rows() -> Vec<FoldRow> {
    let mut rows = Vec::new();
    for place in 0..20u32 {
        let set = if place % 2 == 0 { "LOS_Set_A" } else { "NLOS_Set_B" };
        for source in [TrajectorySource::GroundTruth, TrajectorySource::T265] {
            for part in Part::each(1).chain(Part::each(2)) {
                for link in 0..3u32 {
                    let wrong = (place / 2 + link) % 4 == 0;
                    let error_deg = if wrong { 40.0 } else { 1.0 };
                    let features = Some(vec![f64::from(u8::from(wrong)), 0.5]);
                    let full =
                        Some(Answered { error_deg, oracle_deg: 1.0, features, bound_deg: 0.5, ..Answered::default() });
                    rows.push(FoldRow {
                        place: format!("{set}/L{place}"),
                        set: set.into(),
                        link: format!("{place}/{link}"),
                        source,
                        antenna_offset_m: None,
                        camera: None,
                        heading_sd_rad: source.heading_sd_rad(),
                        path: None,
                        part,
                        quick: full.clone(),
                        full: full.filter(|_| (place, link) != (3, 0)),
                    });
                }
            }
        }
    }
    rows
}

/// The report of these rows: it takes most of the time of what follows.
static REPORT: LazyLock<Report> = LazyLock::new(|| report(&rows()));

#[test]
fn groups_are_pooled_by_sight_and_listed_by_set() {
    let report = &*REPORT;
    assert_eq!((report.places, report.links), (20, 60));
    let whole = |kind: Kind, group: &str| {
        let is_it = |column: &&ErrorColumn| {
            let which = &column.which;
            which.source == TrajectorySource::T265 && which.parts == 1 && which.kind == kind && which.group == group
        };
        report.errors.iter().find(is_it).unwrap().clone()
    };
    let (sight, behind) = (whole(Kind::Full, "LOS"), whole(Kind::Full, "NLOS"));
    assert_eq!((sight.places, sight.failed, sight.errors.links), (10, 0, 30));
    assert_eq!((behind.places, behind.failed, behind.errors.links), (10, 1, 29));
    assert_eq!(whole(Kind::Quick, "NLOS_Set_B").errors.links, 30);
    assert_eq!(whole(Kind::Full, "LOS_Set_A").errors, sight.errors);
    assert!((sight.oracle.mean_deg - 1.0).abs() < 1e-12 && sight.errors.mean_deg > 5.0);
    let [mean, ..] = sight.intervals;
    assert!(mean.low < sight.errors.mean_deg && sight.errors.mean_deg < mean.high, "{sight:?}");
}

#[test]
fn probabilities_come_from_other_places() {
    let whole = |report: &Report| {
        let is_it = |column: &&ConfidenceColumn| column.parts == 1 && column.source == TrajectorySource::GroundTruth;
        report.confidence.iter().find(is_it).unwrap().clone()
    };
    let own = whole(&REPORT);
    assert!((own.said - own.right).abs() < 0.05 && own.expected_error < 0.15, "{own:?}");
    // A feature that means something else at one place only cannot be learnt from the others.
    let mut odd = rows();
    for row in odd.iter_mut().filter(|row| row.place == "LOS_Set_A/L4") {
        if let Some(full) = &mut row.full {
            full.features = full.features.take().map(|f| vec![1.0 - f[0], f[1]]);
        }
    }
    assert!(whole(&report(&odd)).expected_error > own.expected_error + 0.02, "{:?}", whole(&report(&odd)));
}

#[test]
fn refusing_what_models_of_other_places_doubt_leaves_what_is_right() {
    let report = &*REPORT;
    let is_it = |column: &&RefusalColumn| {
        let which = &column.which;
        (which.source, which.parts, which.kind, which.group.as_str()) == (TrajectorySource::T265, 2, Kind::Quick, "all")
    };
    let column = report.refusals.iter().find(is_it).unwrap();
    let (everything, half) = (column.above[0], column.above[5]);
    assert_eq!((everything.errors.links, everything.share, everything.refused_right), (120, 1.0, None));
    // 28 of 120 are wrong, and the feature says which.
    assert_eq!((half.errors.over_20, half.errors.links, half.refused_right), (0.0, 92, Some(0.0)));
    assert_eq!(column.surest.iter().map(|kept| kept.errors.links).collect::<Vec<_>>(), [120, 108, 96, 84, 72, 60]);
}

#[test]
fn the_same_rows_give_the_same_digits() {
    assert_eq!(*REPORT, report(&rows()));
    assert!(report(&[]).errors.is_empty() && report(&[]).confidence.is_empty());
}
