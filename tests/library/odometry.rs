//! Odometry with known errors, corrected by the phases, in simulated rooms.

use csi5300::maths::wrap_rad;
use csi5300::motion::pose::{Pose, Trajectory};
use csi5300::pipeline::{Answer, Bearing, Options, Transmitter, bearings};
use csi5300_sim::{Room, Scene, Simulation};
use nalgebra::Vector3;

/// Lengths for each reported one, and the antenna, metres forward and left.
const SCALE: f64 = 1.03;
const ANTENNA_M: Vector3<f64> = Vector3::new(0.06, 0.12, 0.0);

/// Three robots in a room with four walls; the first drives.
fn simulated(motion: &str, seed: u64) -> Simulation {
    let walls: String = [[-5, -5, 5, -5], [5, -5, 5, 5], [5, 5, -5, 5], [-5, 5, -5, -5]]
        .map(|[a, b, c, d]| format!("[[wall]]\nfrom_m = [{a}.0, {b}.0]\nto_m = [{c}.0, {d}.0]\nloss_db = 8.0\n"))
        .concat();
    let scene = format!(
        "duration_s = 11.0\nseed = {seed}\nchannel = 108\ncfo = \"physical\"\nsounding.rate_hz = 100\nreflections = 1\n\
         [radio]\nnoise.snr_db = 20\n[[robot]]\nname = \"rx\"\nmotion = {motion}\n\
         [[robot]]\nname = \"tx1\"\nposition_m = [3.5, 0.8, 0.4]\ncrystal.offset_ppm = 1.0\n\
         [[robot]]\nname = \"tx2\"\nposition_m = [-1.2, -3.0, 0.2]\ncrystal.offset_ppm = -1.0\n{walls}"
    );
    Room::new(&Scene::parse(&scene).unwrap()).unwrap().run().unwrap()
}

/// What wheels report whose lengths are too short, of a point that the antenna is seen from.
fn wheels(run: &Simulation) -> Trajectory {
    let middle = run.robots[0].true_path.as_ref().unwrap().with_antenna_offset(-ANTENNA_M).unwrap();
    let shorter = |pose: &Pose| Pose { position_m: pose.position_m / SCALE, ..*pose };
    Trajectory::new(middle.poses().iter().map(shorter).collect()).unwrap()
}

fn run(run: &Simulation, path: &Trajectory, fit: bool) -> Vec<(Answer, Bearing)> {
    let options = Options::new("108".parse().unwrap()).with_fit_odometry(fit);
    let mut logs: Vec<_> = run.robots.iter().map(|robot| robot.replay()).collect();
    let (receiver, others) = logs.split_first_mut().unwrap();
    let transmitters = others.iter_mut().map(|log| Transmitter { log, trajectory: None }).collect();
    let report = bearings(receiver, transmitters, path, &options).unwrap();
    report.links.into_iter().map(|link| (Answer::new("tx".into(), &link), link.bearing.unwrap())).collect()
}

/// Largest error of a bearing, degrees.
fn worst_deg(run: &Simulation, found: &[(Answer, Bearing)]) -> f64 {
    let errors = run.robots[1..].iter().zip(found).map(|(robot, (_, bearing))| {
        let times = bearing.samples.t_s().iter();
        let places: Vec<_> = times.filter_map(|t_s| run.robots[0].true_path.as_ref().unwrap().at(*t_s)).collect();
        let mean = places.iter().map(|pose| pose.position_m).sum::<Vector3<f64>>() / places.len() as f64;
        let way = robot.start_m().unwrap() - mean;
        wrap_rad(bearing.answer.azimuth_rad - way.y.atan2(way.x)).to_degrees().abs()
    });
    errors.fold(0.0, f64::max)
}

#[test]
fn a_drive_with_curves_to_both_sides_shows_scale_and_offset() {
    for seed in 1..=2 {
        let simulation = simulated("{ figure_eight = { radius_m = 0.25, duration_s = 10.0, start_s = 0.5 } }", seed);
        let path = wheels(&simulation);
        let (before, after) = (run(&simulation, &path, false), run(&simulation, &path, true));
        assert!(before.iter().all(|(answer, bearing)| bearing.odometry_fit.is_none() && answer.odometry_fit.is_none()));
        let fit = after[0].1.odometry_fit.clone().unwrap();
        println!("{fit:?}\n{fit}");
        assert!(fit.refused.is_none() && fit.links == 2 && after[1].0.odometry_fit.as_ref() == Some(&fit), "{fit:?}");
        for (own, truth) in
            [(fit.scale, SCALE - 1.0), (fit.turn, 0.0), (fit.forward_m, ANTENNA_M.x), (fit.left_m, ANTENNA_M.y)]
        {
            assert!((own.value - truth).abs() < 3.0 * own.sd, "{own:?}, {truth}");
        }
        // Elevations hide the scale.
        assert!(fit.turn.known && fit.forward_m.known && fit.left_m.known, "{fit:?}");
        assert!(fit.forward_m.sd < 0.015 && fit.left_m.sd < 0.015, "{fit:?}");
        let [bad, good] = [&before, &after].map(|found| worst_deg(&simulation, found));
        println!("{bad} {good}");
        assert!(good < 2.0 && bad > 2.0 * good, "{bad} {good}");
    }
}

#[test]
fn right_odometry_stays_as_it_is() {
    let simulation = simulated("{ figure_eight = { radius_m = 0.25, duration_s = 10.0, start_s = 0.5 } }", 3);
    let path = simulation.robots[0].true_path.clone().unwrap();
    let (before, after) = (run(&simulation, &path, false), run(&simulation, &path, true));
    let fit = after[0].1.odometry_fit.clone().unwrap();
    assert!(fit.refused.is_some_and(|why| why.contains("hardly prefer")));
    for ((_, before), (_, after)) in before.iter().zip(&after) {
        assert_eq!(before.answer, after.answer);
    }
}
