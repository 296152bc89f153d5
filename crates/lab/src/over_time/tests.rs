use super::gather::{Drive, Seen, StretchRow};
use super::report;
use crate::evaluate::{Part, TrajectorySource};
use csi5300::internal::track::{Evidence, EvidenceMode, TrackSettings};
use nalgebra::Vector2;

/// A drive along x past a transmitter at (2, 3), each stretch a line that hides a mirror; the side that a stretch takes for
/// right alternates.
fn drive() -> Drive {
    let row = |part: Part| {
        let k = f64::from(part.index);
        let from = Vector2::new(k, 0.3 * k);
        let truth = (3.0 - from.y).atan2(2.0 - from.x);
        // The lines turn by 30 degrees from one to the next.
        let mirror = 2.0 * (30.0 * k).to_radians() - truth;
        let favoured = if part.index.is_multiple_of(2) { mirror } else { truth };
        let mode = |azimuth: f64| EvidenceMode::new(azimuth, 0.02, if azimuth == favoured { 0.6 } else { 0.4 });
        let own = Seen {
            evidence: Evidence::new(k, from, vec![mode(truth), mode(mirror)], 0.9),
            truth_deg: truth.to_degrees(),
            error_deg: (favoured - truth).to_degrees(),
            sd_deg: 30.0,
            confidence: Some(0.5),
        };
        StretchRow { part, own: (part.index != 2).then_some(own), so_far_deg: (part.index == 3).then_some(1.5) }
    };
    Drive {
        place: "LOS/a".into(),
        set: "LOS".into(),
        link: "LOS/a/tx2".into(),
        source: TrajectorySource::GroundTruth,
        heading_sd_rad: 0.0,
        stretches: Part::each(5).map(row).collect(),
    }
}

#[test]
fn what_is_carried_settles_where_single_stretches_alternate() {
    let drives = [drive()];
    let report = report(&drives, &|drive| drive.set.clone(), &|_| TrackSettings::new(0.0));
    let [column] = report.columns.as_slice() else { panic!("{report:?}") };
    assert_eq!((column.group.as_str(), column.links, column.carried), ("LOS", 1, 4));
    assert_eq!(column.points.iter().map(|point| point.carried.links).collect::<Vec<_>>(), [1, 1, 0, 1, 1]);
    let (first, last) = (&column.points[0], &column.points[4]);
    assert!((first.carried.mean_deg - first.single.mean_deg).abs() < 1.0, "{first:?}");
    assert!(last.single.mean_deg > 20.0 && last.carried.mean_deg < 1.0, "{last:?}");
    assert_eq!((column.points[3].at_once.mean_deg, last.at_once.links), (1.5, 0));
    assert!((column.right - 0.75).abs() < 1e-12 && column.said > 0.5, "{column:?}");
}
