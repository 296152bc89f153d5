//! Leaving places out, on simulated rooms in the layout of captures.

use csi5300::motion::odometry::csv;
use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::motion::rolling::Mount;
use csi5300::pipeline::Options;
use csi5300_lab::evaluate::{Capture, Part, TrajectorySource, find};
use csi5300_lab::folds::{ErrorColumn, Kind, gather, report};
use csi5300_lab::rooms;
use nalgebra::Vector3;
use std::path::Path;

/// Where the rooms' antenna is, seen from the middle between the wheels.
const OFFSET_M: Vector3<f64> = Vector3::new(0.04, 0.16, 0.0);

/// How the rooms' robot carries its camera.
const CAMERA: Mount = Mount { offset_m: Vector3::new(0.02, 0.13, 0.0), yaw_rad: -0.03 };

/// Writes a room's odometry as that of wheels beside whose middle the antenna is, and that of a camera on the robot.
fn beside_the_antenna(capture: &Capture) {
    let path = |of: &str| capture.folder.join(format!("{of}_rx_trajectory_{}_.csv", capture.stamp));
    let write = |of: &str, trajectory: &Trajectory| {
        std::fs::write(path(of), trajectory.poses().iter().map(csv::line).collect::<String>()).unwrap();
    };
    let (antenna, _) = csv::read(&path("odom")).unwrap();
    let wheels = antenna.with_antenna_offset(-OFFSET_M).unwrap();
    let camera = |pose: &Pose| {
        let place = pose.mounted(CAMERA.offset_m).unwrap();
        Pose { heading_rad: place.heading_rad.map(|heading| heading + CAMERA.yaw_rad), ..place }
    };
    write("t265", &Trajectory::new(wheels.poses().iter().map(camera).collect()).unwrap());
    write("odom", &wheels);
}

#[test]
fn rooms_are_places_and_every_part_of_their_motion_is_judged() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("folds");
    let _ = std::fs::remove_dir_all(&folder);
    rooms::write(&folder, 2, 5).unwrap();
    let (captures, unreadable) = find(&folder);
    captures.iter().for_each(beside_the_antenna);
    assert!(captures.len() == 4 && unreadable.is_empty(), "{captures:?}");
    let rows = gather(&captures, &Options::new("108".parse().unwrap()));
    // Four rooms with three links each: seven parts by the true trajectory, by wheels, and by the camera in two ways.
    assert_eq!(rows.len(), 4 * 3 * 7 * 4);
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
    // Wheels are told where the antenna is, each by the other rooms, as well as their drifting heading lets these see it.
    let off_m = rows.iter().filter_map(|row| row.antenna_offset_m).map(|[x, y]| (x - OFFSET_M.x).hypot(y - OFFSET_M.y));
    assert_eq!(off_m.clone().count(), 4 * 3 * 7 * 2);
    assert!(off_m.clone().all(|off_m| off_m < 0.04), "{:?}", off_m.collect::<Vec<_>>());
    for source in [TrajectorySource::Odometry, TrajectorySource::RollingT265] {
        let is_it = |column: &&ErrorColumn| {
            let which = &column.which;
            which.source == source && which.parts == 1 && which.group == "LOS"
        };
        let own = report.errors.iter().find(is_it).unwrap();
        assert!(own.errors.mean_deg < 10.0, "{own:?}");
        // The rooms' odometry is turned: less that, what is left is small.
        assert!(own.unturned.is_some_and(|unturned| unturned.mean_deg < own.errors.mean_deg), "{own:?}");
    }
    // So is the camera; what the rooms' heading drifts by during a motion counts as the camera's.
    let mount = report.camera.unwrap();
    let off_m = (mount.forward_m - CAMERA.offset_m.x).hypot(mount.left_m - CAMERA.offset_m.y);
    assert!(off_m < 0.05 && (mount.yaw_deg - CAMERA.yaw_rad.to_degrees()).abs() < 10.0, "{mount:?}");
    let paths = report.paths.iter().filter(|column| column.parts == 1).map(|column| (column.source, column.paths));
    let each = [TrajectorySource::T265, TrajectorySource::RollingT265, TrajectorySource::Odometry];
    assert_eq!(paths.collect::<Vec<_>>(), each.map(|source| (source, 4)));
    // A part is judged from its own mean pose: in sight its error is no larger than a beam.
    let first = rows.iter().find(|row| row.part != Part::WHOLE && row.set == "rooms_LOS").unwrap();
    assert!(first.full.as_ref().unwrap().error_deg.abs() < 20.0, "{first:?}");
    std::fs::remove_dir_all(&folder).unwrap();
}
