//! Leaving places out, on simulated rooms in the layout of captures.

use csi5300::pipeline::Options;
use csi5300_lab::evaluate::{Part, TrajectorySource, find};
use csi5300_lab::folds::{ErrorColumn, Kind, gather, report};
use csi5300_lab::rooms;
use std::path::Path;

#[test]
fn rooms_are_places_and_every_part_of_their_motion_is_judged() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("folds");
    let _ = std::fs::remove_dir_all(&folder);
    rooms::write(&folder, 2, 5).unwrap();
    let (captures, unreadable) = find(&folder);
    assert!(captures.len() == 4 && unreadable.is_empty(), "{captures:?}");
    let rows = gather(&captures, &Options::new("108".parse().unwrap()));
    // Four rooms with three links each: seven parts by the true trajectory, the whole motion by odometry.
    assert_eq!(rows.len(), 4 * 3 * (7 + 1));
    assert!(rows.iter().all(|row| row.full.is_some() && row.quick.is_some()));
    let report = report(&rows);
    assert_eq!((report.places, report.links), (4, 12));
    let column = |kind: Kind, parts: u32| -> ErrorColumn {
        let is_it = |column: &&ErrorColumn| {
            let which = &column.which;
            which.source == TrajectorySource::GroundTruth
                && (which.parts, which.kind, which.group.as_str()) == (parts, kind, "LOS")
        };
        report.errors.iter().find(is_it).unwrap().clone()
    };
    let (whole, quarters) = (column(Kind::Full, 1), column(Kind::Full, 4));
    assert_eq!((whole.places, whole.errors.links, quarters.errors.links), (2, 6, 24));
    assert!(whole.errors.mean_deg < 0.5 && whole.errors.mean_deg < quarters.errors.mean_deg, "{whole:?} {quarters:?}");
    assert!(whole.errors.mean_deg < column(Kind::Quick, 1).errors.mean_deg, "a plane wave is bent in the near field");
    assert!(report.errors.iter().all(|column| column.oracle.mean_deg <= column.errors.mean_deg));
    let by_odometry = report.errors.iter().filter(|column| column.which.source == TrajectorySource::Odometry);
    assert!(by_odometry.clone().count() > 0 && by_odometry.clone().all(|column| column.which.parts == 1));
    // A part is judged from its own mean pose: in sight its error is no larger than a beam.
    let first = rows.iter().find(|row| row.part != Part::WHOLE && row.set == "rooms_LOS").unwrap();
    assert!(first.full.as_ref().unwrap().error_deg.abs() < 20.0, "{first:?}");
    std::fs::remove_dir_all(&folder).unwrap();
}
