use super::*;
use crate::random::Purpose;
use proptest::prelude::*;

fn track(motion: &RobotMotion) -> Track {
    let start = Pose { position_m: Vector3::new(1.0, -2.0, 0.3), yaw_rad: 0.4 };
    Track::new(start, motion, None, &mut Stream::new(5, 0, Purpose::Walk))
}

fn all() -> Vec<RobotMotion> {
    vec![
        RobotMotion::Static,
        RobotMotion::Line(Line { length_m: 1.885, duration_s: 10.0, start_s: 1.0 }),
        RobotMotion::Circle(Circle { radius_m: 0.3, duration_s: 10.0, turns: 1.0, start_s: 1.0 }),
        RobotMotion::Arc(Arc { radius_m: 0.4, angle_deg: -120.0, duration_s: 7.0, start_s: 1.0 }),
        RobotMotion::Square(Square { side_m: 0.5, duration_s: 8.0, turns: 1.0, start_s: 1.0 }),
        RobotMotion::Helix(Helix { radius_m: 0.2, rise_m: 0.1, duration_s: 9.0, turns: 3.0, start_s: 1.0 }),
        RobotMotion::FigureEight(FigureEight { radius_m: 0.2, duration_s: 8.0, turns: 1.0, start_s: 1.0 }),
        RobotMotion::RandomWalk(RandomWalk {
            speed_m_s: 0.2,
            turning_deg_s: 60.0,
            within_m: 0.5,
            duration_s: 10.0,
            start_s: 1.0,
        }),
        RobotMotion::Waypoints(Waypoints {
            points_m: vec![[2.0, -2.0, 0.3], [2.0, -1.0, 0.3]],
            speed_m_s: 0.2,
            start_s: 1.0,
        }),
    ]
}

#[test]
fn every_motion_rests_starts_at_the_start_and_then_stays() {
    for motion in all() {
        let t = track(&motion);
        assert_eq!(t.at(0.0).position_m, t.at(1.0).position_m, "{motion:?} rests first");
        assert!((t.at(0.0).position_m - Vector3::new(1.0, -2.0, 0.3)).norm() < 1e-12, "{motion:?}");
        assert_eq!(t.at(100.0), t.at(1000.0), "{motion:?} rests afterwards");
        assert_eq!(t.is_still(), motion == RobotMotion::Static);
    }
}

#[test]
fn closed_figures_close_and_go_where_they_say() {
    let t = track(&RobotMotion::Circle(Circle { radius_m: 0.3, duration_s: 10.0, turns: 1.0, start_s: 0.0 }));
    let half = t.at(5.0);
    // To the left of the heading, one diameter away, facing back.
    let across = turned(Vector3::new(0.0, 0.6, 0.0), 0.4);
    assert!((half.position_m - t.at(0.0).position_m - across).norm() < 1e-12);
    assert!((half.yaw_rad - 0.4 - std::f64::consts::PI).abs() < 1e-12);

    let t = track(&RobotMotion::FigureEight(FigureEight { radius_m: 0.2, duration_s: 8.0, turns: 1.0, start_s: 0.0 }));
    let (left, right) = (t.at(2.0).position_m, t.at(6.0).position_m);
    assert!((left - right).norm() > 0.79 && (t.at(4.0).position_m - t.at(0.0).position_m).norm() < 1e-12);

    for turns in [1.0, 2.0] {
        let t = track(&RobotMotion::Square(Square { side_m: 0.5, duration_s: 8.0, turns, start_s: 0.0 }));
        assert!((t.at(8.0).position_m - t.at(0.0).position_m).norm() < 1e-12);
        let diagonal = t.at(4.0 / turns).position_m - t.at(0.0).position_m;
        assert!((diagonal.norm() - 0.5 * 2f64.sqrt()).abs() < 1e-12, "{diagonal}");
    }

    let t = track(&RobotMotion::Helix(Helix { radius_m: 0.2, rise_m: 0.1, duration_s: 9.0, turns: 3.0, start_s: 0.0 }));
    assert!((t.at(9.0).position_m.z - 0.3 - 0.3).abs() < 1e-12);
}

#[test]
fn a_right_hand_arc_goes_right() {
    let arc = RobotMotion::Arc(Arc { radius_m: 1.0, angle_deg: -90.0, duration_s: 1.0, start_s: 0.0 });
    let start = Pose { position_m: Vector3::zeros(), yaw_rad: 0.0 };
    let t = Track::new(start, &arc, None, &mut Stream::new(0, 0, Purpose::Walk));
    assert!((t.at(1.0).position_m - Vector3::new(1.0, -1.0, 0.0)).norm() < 1e-12);
}

#[test]
fn walks_keep_within_their_bounds_and_differ_by_seed() {
    let walk = RandomWalk { speed_m_s: 0.3, turning_deg_s: 90.0, within_m: 0.5, duration_s: 120.0, start_s: 0.0 };
    let start = Pose { position_m: Vector3::zeros(), yaw_rad: 0.0 };
    let of = |seed| Track::new(start, &RobotMotion::RandomWalk(walk), None, &mut Stream::new(seed, 0, Purpose::Walk));
    let (a, b) = (of(1), of(2));
    let mut furthest: f64 = 0.0;
    for i in 0..12_000 {
        furthest = furthest.max(a.at(f64::from(i) * 0.01).position_m.norm());
    }
    assert!(furthest > 0.2 && furthest < 0.5 + 0.3, "{furthest}");
    assert_ne!(a.at(60.0), b.at(60.0));
}

#[test]
fn a_recorded_motion_strays_slowly_and_by_as_much_as_stated() {
    let rows =
        (0..=6_000).map(|k| (f64::from(k) * 0.01, Pose { position_m: Vector3::zeros(), yaw_rad: 0.5 })).collect();
    let table = Recorded::from_rows(rows);
    assert_eq!(table.clone().strayed(0.0, 6.0), table);
    let strayed = table.strayed(0.01, 6.0);
    let places: Vec<Vector3<f64>> = (0..6_000).map(|k| strayed.at(f64::from(k) * 0.01).position_m).collect();
    for axis in 0..2 {
        let rms = (places.iter().map(|p| p[axis].powi(2)).sum::<f64>() / 6_000.0).sqrt();
        assert!((0.0085..0.0115).contains(&rms), "{rms}");
    }
    let both = places.iter().map(|p| p.x * p.y).sum::<f64>() / 6_000.0;
    assert!(both.abs() < 3e-5, "x and y stray each for itself: {both}");
    let fastest = places.windows(2).map(|w| (w[1] - w[0]).norm() / 0.01).fold(0.0, f64::max);
    assert!(fastest < 0.09 && places.iter().all(|p| p.z == 0.0), "{fastest} m/s");
}

proptest! {
    /// No motion jumps: between two instants a robot goes no further than its top speed allows.
    #[test]
    fn motions_are_continuous(t in 0.0..14.0f64, dt in 0.0..0.05f64) {
        for motion in all() {
            let track = track(&motion);
            let step = (track.at(t + dt).position_m - track.at(t).position_m).norm();
            // The fastest of them is the helix: three turns of 0.2 m in 9 s, 0.43 m/s.
            prop_assert!(step <= 0.5 * dt + 1e-12, "{:?} moved {} m in {} s", motion, step, dt);
        }
    }
}
