use super::grid::{PlaceGrid, normalise};
use super::peer_track::TrackError;
use super::*;
use crate::maths::wrap_rad;
use nalgebra::Vector2;
use std::f64::consts::{FRAC_PI_2, PI};

const DEGREE: f64 = PI / 180.0;

fn settings() -> TrackSettings {
    TrackSettings::new(0.0)
}

/// Azimuth from `from` to `to`, radians.
fn azimuth(from: Vector2<f64>, to: Vector2<f64>) -> f64 {
    (to - from).y.atan2((to - from).x)
}

/// What a stretch says that sees these places alike.
fn seen(t_s: f64, from: Vector2<f64>, places: &[Vector2<f64>]) -> Evidence {
    let mode = |place: &Vector2<f64>| EvidenceMode::new(azimuth(from, *place), DEGREE, 1.0);
    Evidence::new(t_s, from, places.iter().map(mode).collect(), 0.95)
}

/// What a stretch along the direction `axis_rad` says: the place and its mirror image in that line are alike.
fn mirrored(t_s: f64, from: Vector2<f64>, axis_rad: f64, place: Vector2<f64>) -> Evidence {
    let own = azimuth(from, place);
    let modes = [own, wrap_rad(2.0 * axis_rad - own)].map(|azimuth| EvidenceMode::new(azimuth, DEGREE, 0.5));
    Evidence::new(t_s, from, modes.to_vec(), 0.95)
}

fn off_deg(answer: &TrackAnswer, truth_rad: f64) -> f64 {
    wrap_rad(answer.azimuth_rad - truth_rad).abs() / DEGREE
}

#[test]
fn two_lines_in_different_directions_settle_which_side_the_peer_is_on() {
    let peer = Vector2::new(3.0, 2.0);
    for side in [1.0, -1.0] {
        let peer = Vector2::new(peer.x, side * peer.y);
        let mut track = PeerTrack::new(settings());
        track.update(&mirrored(0.0, Vector2::new(0.5, 0.0), 0.0, peer)).unwrap();
        let first = track.last_answer().unwrap();
        assert!(first.probability < 0.52 && first.modes.len() == 2, "{first:?}");
        assert!((first.modes[0].share - first.modes[1].share).abs() < 1e-6, "{first:?}");
        let from = Vector2::new(1.0, 0.5);
        track.update(&mirrored(5.0, from, FRAC_PI_2, peer)).unwrap();
        let second = track.last_answer().unwrap();
        assert!(off_deg(&second, azimuth(from, peer)) < 1.0 && second.probability > 0.55, "{second:?}");
        assert!(second.modes.iter().skip(1).all(|mode| 4.0 * mode.share < second.probability), "{second:?}");
        assert!(second.azimuth_sd_rad < 0.6 * first.azimuth_sd_rad && second.stretches == 2, "{second:?}");
    }
}

#[test]
fn a_candidate_that_moves_with_the_robot_loses_to_one_that_stays() {
    let peer = Vector2::new(4.0, 1.0);
    let mut track = PeerTrack::new(settings());
    for k in 0..3 {
        let from = Vector2::new(0.0, 1.2 * f64::from(k));
        // It turns ahead where a place would fall behind, and is the stronger of the two.
        let gliding = EvidenceMode::new(PI - 10.0 * DEGREE * f64::from(k), DEGREE, 2.0);
        let still = EvidenceMode::new(azimuth(from, peer), DEGREE, 1.0);
        track.update(&Evidence::new(f64::from(k), from, vec![gliding, still], 0.95)).unwrap();
        let answer = track.last_answer().unwrap();
        let truth = if k == 0 { PI } else { azimuth(from, peer) };
        assert!(off_deg(&answer, truth) < 2.0, "{k}: {answer:?}");
    }
    assert!(track.last_answer().unwrap().probability > 0.5);
}

#[test]
fn stretches_that_are_deceived_together_are_not_as_sure_as_independent_ones() {
    let places = [Vector2::new(4.0, 1.0), Vector2::new(-3.0, 2.0)];
    let sure = [1.0, 0.3, 0.0].map(|own_share| {
        let mut track = PeerTrack::new(settings().with_own_share(own_share));
        for k in 0..4 {
            let mut evidence = seen(f64::from(k), Vector2::new(0.0, 0.2 * f64::from(k)), &places);
            evidence.modes[1].share = 0.5;
            track.update(&evidence).unwrap();
        }
        let answer = track.last_answer().unwrap();
        assert!(off_deg(&answer, azimuth(Vector2::new(0.0, 0.6), places[0])) < 2.0, "{answer:?}");
        answer.probability
    });
    // Alone the first place has twice the share of the second: so it has of all four if they are one. Four independent ones
    // would have sixteen times.
    assert!(sure[0] > 0.85 && sure[0] > sure[1] + 0.05 && sure[1] > sure[2] + 0.05 && sure[2] < 0.75, "{sure:?}");
}

#[test]
fn crossing_bearings_give_a_place_and_bearings_from_anywhere() {
    let peer = Vector2::new(-2.0, 3.0);
    let mut track = PeerTrack::new(settings());
    for (k, x) in [-3.0, -1.0, 1.0, 2.0].into_iter().enumerate() {
        track.update(&seen(k as f64, Vector2::new(x, 0.0), &[peer])).unwrap();
    }
    let (place, covariance) = track.last_answer().unwrap().place_m.unwrap();
    assert!((place - peer).norm() < 0.3 && covariance.determinant() > 0.0, "{place} {covariance}");
    for from in [Vector2::new(0.0, 6.0), Vector2::new(-6.0, 3.0), Vector2::new(1.0, 1.0)] {
        let answer = track.answer(from).unwrap();
        assert!(off_deg(&answer, azimuth(from, peer)) < 3.0 && answer.probability > 0.35, "{from} {answer:?}");
    }
    assert!(track.answer(Vector2::new(f64::NAN, 0.0)).is_none());
}

#[test]
fn a_range_tells_two_places_in_one_direction_apart() {
    let (near, far) = (Vector2::new(2.0, 0.0), Vector2::new(12.0, 0.0));
    let from = Vector2::new(1.0, 1.0);
    let odds = [None, Some((2.0, 0.2)), Some((12.0, 1.0))].map(|range_m| {
        let mut track = PeerTrack::new(settings());
        let mode = EvidenceMode::new(0.0, DEGREE, 1.0).with_range_m(range_m);
        track.update(&Evidence::new(0.0, Vector2::zeros(), vec![mode], 0.95)).unwrap();
        let modes = [near, far].map(|place| EvidenceMode::new(azimuth(from, place), DEGREE, 0.5));
        track.update(&Evidence::new(1.0, from, modes.to_vec(), 0.95)).unwrap();
        let answer = track.last_answer().unwrap();
        let share = |place| {
            let about = |mode: &&TrackMode| wrap_rad(mode.azimuth_rad - azimuth(from, place)).abs() < 5.0 * DEGREE;
            answer.modes.iter().filter(about).map(|mode| mode.share).sum::<f64>().max(0.01)
        };
        share(near) / share(far)
    });
    assert!(odds[1] > 2.0 * odds[0] && odds[0] > 1.5 * odds[2], "{odds:?}");
}

#[test]
fn odometry_that_drifts_makes_what_was_known_less_sure() {
    let peer = Vector2::new(3.0, 0.0);
    let shares = [0.0, 2.0, 20.0].map(|turn_deg: f64| {
        let drifting = settings().with_turn_rad_per_rt_m(turn_deg * DEGREE);
        let mut track = PeerTrack::new(drifting);
        track.update(&seen(0.0, Vector2::zeros(), &[peer])).unwrap();
        // Sees next to nothing, after a metre.
        let blind = Evidence::new(9.0, Vector2::new(0.0, 1.0), vec![EvidenceMode::new(0.0, PI, 1.0)], 0.01);
        track.update(&blind.with_driven_m(1.0)).unwrap();
        track.last_answer().unwrap().azimuth_sd_rad
    });
    assert!(shares[0] < shares[1] && 2.0 * shares[1] < shares[2], "{shares:?}");
    let wandering = |wander| {
        let mut track = PeerTrack::new(settings().with_wander_m_per_rt_s(wander));
        track.update(&seen(0.0, Vector2::zeros(), &[peer])).unwrap();
        track.update(&seen(100.0, Vector2::new(0.0, 0.1), &[Vector2::new(0.0, 3.0)])).unwrap();
        off_deg(&track.last_answer().unwrap(), FRAC_PI_2)
    };
    // A peer that may have gone anywhere is where it is seen last.
    assert!(wandering(0.5) < 3.0, "{}", wandering(0.5));
}

#[test]
fn a_peer_that_was_carried_elsewhere_is_found_there() {
    let (before, after) = (Vector2::new(3.0, 0.0), Vector2::new(0.0, -3.0));
    let mut track = PeerTrack::new(settings());
    let at = |k: u32| Vector2::new(0.0, 0.3 * f64::from(k));
    (0..20).for_each(|k| track.update(&seen(f64::from(k), at(k), &[before])).unwrap());
    let needed = (20..30).find(|k| {
        track.update(&seen(f64::from(*k), at(*k), &[after])).unwrap();
        off_deg(&track.last_answer().unwrap(), azimuth(at(*k), after)) < 5.0
    });
    assert!(needed.is_some_and(|k| k <= 23), "{needed:?}");
}

#[test]
fn a_new_frame_and_a_long_silence_begin_anew_and_are_counted() {
    let mut track = PeerTrack::new(settings().with_gone_s(60.0));
    track.reset();
    assert_eq!(track.counts(), TrackCounts::default());
    let peer = Vector2::new(3.0, 0.0);
    track.update(&seen(0.0, Vector2::zeros(), &[peer])).unwrap();
    track.reset();
    assert!(track.last_answer().is_none() && track.answer(Vector2::zeros()).is_none() && track.last_s().is_none());
    // After a new frame an earlier time is none.
    track.update(&seen(-5.0, Vector2::zeros(), &[peer])).unwrap();
    track.update(&seen(100.0, Vector2::zeros(), &[-peer])).unwrap();
    let answer = track.last_answer().unwrap();
    assert!(answer.stretches == 1 && off_deg(&answer, PI) < 1.0, "{answer:?}");
    let counts = track.counts();
    assert_eq!((counts.used, counts.refused, counts.reset, counts.gone), (3, 0, 1, 1));
}

#[test]
fn what_cannot_be_used_is_refused_and_changes_nothing() {
    let mut track = PeerTrack::new(settings());
    let good = seen(10.0, Vector2::zeros(), &[Vector2::new(3.0, 0.0)]);
    track.update(&good).unwrap();
    let before = track.last_answer();
    let mode = EvidenceMode::new(0.1, DEGREE, 1.0);
    let with = |modes: Vec<EvidenceMode>| Evidence { modes, ..good.clone() };
    let nothing = [
        vec![],
        vec![EvidenceMode { azimuth_rad: f64::NAN, ..mode }],
        vec![EvidenceMode { sd_rad: 0.0, ..mode }, EvidenceMode { sd_rad: f64::INFINITY, ..mode }],
        vec![EvidenceMode { share: 0.0, ..mode }, EvidenceMode { share: -1.0, ..mode }],
        vec![mode.with_range_m(Some((0.0, 1.0))), mode.with_range_m(Some((f64::NAN, 1.0)))],
    ];
    for modes in nothing {
        let count = modes.len();
        assert_eq!(track.update(&with(modes)), Err(TrackError::NoDirection { modes: count }));
    }
    let bad = [
        Evidence { t_s: f64::NAN, ..good.clone() },
        Evidence { position_m: Vector2::new(0.0, f64::INFINITY), ..good.clone() },
        Evidence { driven_m: f64::NAN, ..good.clone() },
        Evidence { known: f64::NAN, ..good.clone() },
        Evidence { fresh: f64::NAN, ..good.clone() },
    ];
    for evidence in bad {
        assert!(matches!(track.update(&evidence), Err(TrackError::NotFinite { .. })), "{evidence:?}");
    }
    let early = Evidence { t_s: 9.0, ..good.clone() };
    assert_eq!(track.update(&early), Err(TrackError::OutOfOrder { t_s: 9.0, last_s: 10.0 }));
    assert_eq!((track.counts().refused, track.counts().used), (11, 1));
    assert_eq!(track.last_answer(), before);
    // A direction that cannot be used takes nothing from one that can.
    track.update(&with(vec![mode, EvidenceMode { share: f64::NAN, ..mode }])).unwrap();
}

#[test]
fn numbers_at_the_ends_of_what_there_is_leave_answers_finite() {
    let extremes = [0.0, 1e-300, 1e-9, 1.0, 1e9, 1e300];
    let mut track = PeerTrack::new(settings().with_turn_rad_per_rt_m(1e300).with_slip(1e300));
    for (k, value) in extremes.into_iter().enumerate() {
        let mode = EvidenceMode::new(value, value.max(1e-300), 1.0).with_range_m(Some((value.max(1e-300), value)));
        let evidence = Evidence::new(k as f64, Vector2::new(value, -value), vec![mode], value).with_driven_m(value);
        track.update(&evidence.with_fresh(value)).unwrap();
        let answer = track.last_answer().unwrap();
        let numbers = [answer.azimuth_rad, answer.azimuth_sd_rad, answer.probability];
        assert!(numbers.iter().all(|number| number.is_finite()), "{value}: {answer:?}");
    }
}

#[test]
fn the_same_evidence_gives_the_same_answer_whichever_way_azimuths_are_wrapped() {
    let run = |turns: f64| {
        let mut track = PeerTrack::new(settings());
        for k in 0..4 {
            let from = Vector2::new(0.4 * f64::from(k), 0.0);
            let mut evidence = seen(f64::from(k), from, &[Vector2::new(-4.0, 0.05), Vector2::new(-3.0, -4.0)]);
            evidence.modes.iter_mut().for_each(|mode| mode.azimuth_rad += turns * 2.0 * PI);
            track.update(&evidence).unwrap();
        }
        track.last_answer().unwrap()
    };
    assert_eq!(run(0.0), run(0.0));
    // The first place is straight behind, on the cut of the azimuth.
    let (own, turned) = (run(0.0), run(3.0));
    assert!(wrap_rad(own.azimuth_rad - turned.azimuth_rad).abs() < 1e-9, "{own:?} {turned:?}");
    assert!((own.probability - turned.probability).abs() < 1e-9);
}

#[test]
fn evidence_that_is_not_new_changes_nothing_and_an_answer_with_it_takes_nothing() {
    let mut track = PeerTrack::new(settings());
    let evidence = seen(0.0, Vector2::zeros(), &[Vector2::new(3.0, 0.0)]);
    track.update(&evidence).unwrap();
    let before = track.last_answer();
    let elsewhere = seen(1.0, Vector2::zeros(), &[Vector2::new(0.0, 3.0)]);
    let beside = track.answer_with(&elsewhere.clone().with_fresh(0.0)).unwrap();
    assert!(off_deg(&beside, 0.0) < 0.1, "{beside:?}");
    assert!(off_deg(&track.answer_with(&elsewhere).unwrap(), 0.0) > 1.0 || beside.probability > 0.5);
    assert_eq!((track.last_answer(), track.counts().used), (before, 1));
}

#[test]
fn a_grid_that_is_moved_there_and_back_keeps_its_places() {
    let peer = Vector2::new(2.0, 2.5);
    let mut grid = PlaceGrid::prior(Vector2::zeros());
    for x in [0.0, 1.5, -1.5, 0.0] {
        let from = Vector2::new(x, 0.0);
        grid = grid.moved_to(from);
        assert!(grid.multiply(&seen(0.0, from, &[peer])));
    }
    let sum = |grid: &PlaceGrid| grid.around().iter().sum::<f64>();
    let there = grid.moved_to(Vector2::new(0.7, -1.0)).moved_to(Vector2::zeros());
    assert!((sum(&there) - 1.0).abs() < 1e-9 && (sum(&grid) - 1.0).abs() < 1e-9);
    let middle = |grid: &PlaceGrid| {
        let around = grid.around();
        let (sin, cos) = around.iter().enumerate().fold((0.0, 0.0), |(sin, cos), (cell, p)| {
            let azimuth = super::grid::azimuth_rad(cell);
            (sin + p * azimuth.sin(), cos + p * azimuth.cos())
        });
        sin.atan2(cos)
    };
    assert!((middle(&there) - middle(&grid)).abs() < 0.5 * DEGREE, "{} {}", middle(&there), middle(&grid));
    assert!(!normalise(&mut [0.0, 0.0]) && !normalise(&mut [f64::NAN]));
}
