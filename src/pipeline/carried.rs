//! Bearings carried from one stretch of motion to the next: the flat form, and a capture cut into stretches.

use super::error::LinkError;
use super::options::Options;
use super::{Answer, Bearing, CaptureReport};
use super::{LinkJoin, estimate};
use crate::motion::pose::Trajectory;
use crate::place::{PeerTrack, TrackAnswer, TrackSettings};
use serde::Serialize;

/// The combined evidence of all stretches of motion about a peer, in degrees: a part of a JSON line.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CarriedAnswer {
    /// Bearing to the peer from the middle of the last stretch, in the trajectory's frame, from +x towards +y, (-180, 180].
    pub azimuth_deg: f64,
    /// Half of the width about the azimuth that holds 0.68 of the evidence. It is not calibrated, so it is no error
    /// bar.
    pub spread_deg: f64,
    /// The directions in which the peer may be, the likeliest first.
    pub candidates: Vec<CarriedCandidate>,
    /// Where the peer is in the trajectory's frame, metres, where its range is known well enough. If the peer moves
    /// too, less its displacement since its odometry began.
    pub place_m: Option<[f64; 2]>,
    /// Its covariance, metres squared, row by row.
    pub place_covariance_m2: Option<[[f64; 2]; 2]>,
    /// Stretches of motion that it is made of.
    pub stretches: u32,
}

/// One direction of a [`CarriedAnswer`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CarriedCandidate {
    /// Bearing, degrees.
    pub azimuth_deg: f64,
    /// Probability of being within five degrees of it, 0..1: right on average over places (docs/method/accuracy.md),
    /// too low in line of sight and too high behind walls.
    pub share: f64,
}

impl CarriedAnswer {
    /// The same in degrees.
    #[must_use]
    pub(crate) fn new(answer: &TrackAnswer) -> Self {
        let candidate = |mode: &crate::place::TrackMode| CarriedCandidate {
            azimuth_deg: mode.azimuth_rad.to_degrees(),
            share: mode.share,
        };
        let (place_m, covariance_m2) = answer.place_m.unzip();
        Self {
            azimuth_deg: answer.azimuth_rad.to_degrees(),
            spread_deg: answer.azimuth_sd_rad.to_degrees(),
            candidates: answer.modes.iter().map(candidate).collect(),
            place_m: place_m.map(Into::into),
            place_covariance_m2: covariance_m2.map(Into::into),
            stretches: answer.stretches,
        }
    }
}

/// One stretch of a capture's motion, of one link.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct StretchAnswer {
    /// It begins here, seconds on the trajectory's clock.
    pub from_s: f64,
    /// It ends here, seconds on the trajectory's clock.
    pub to_s: f64,
    /// The answer of the stretch alone, with the combined evidence up to its end in `carried`.
    #[serde(flatten)]
    pub answer: Answer,
}

impl CaptureReport {
    /// The links in stretches of motion of `every_s` seconds, each alone and carried on from those before; a last
    /// stretch shorter than half of that belongs to the one before. One list for each link, in their order; empty for a
    /// link without a bearing. `transmitters` are the trajectories of those that moved. Links joined row by row give
    /// errors, because stretches lack the whole trajectory's rows.
    #[must_use]
    pub fn in_stretches(
        &self,
        trajectory: &Trajectory,
        transmitters: &[Option<&Trajectory>],
        every_s: f64,
        options: &Options,
    ) -> Vec<Vec<StretchAnswer>> {
        let settings = TrackSettings::new(options.heading_sd_rad.unwrap_or_default());
        let mut tracks = vec![(PeerTrack::new(settings), None); self.links.len()];
        let mut answers: Vec<Vec<StretchAnswer>> = vec![Vec::new(); self.links.len()];
        for stretch in stretches(trajectory, every_s) {
            let (from_s, to_s) = stretch.span_s();
            let used = || self.links.iter().enumerate().filter_map(|(k, report)| Some((k, report.link.as_ref()?)));
            let transmitter = |k: usize| transmitters.get(k).copied().flatten();
            let join = |(k, link)| LinkJoin { link, receiver: &stretch, transmitter: transmitter(k) };
            let joins: Vec<LinkJoin<'_>> = used().map(join).collect();
            for ((k, link), made) in used().zip(estimate(&joins, options)) {
                let mut answer = Answer::of(String::new(), Some(link), made.as_ref());
                if let Some((track, last_s)) = tracks.get_mut(k) {
                    answer.carried = carry(track, last_s, trajectory, &made);
                }
                if let Some(own) = answers.get_mut(k) {
                    own.push(StretchAnswer { from_s, to_s, answer });
                }
            }
        }
        answers
    }
}

/// Takes a stretch's bearing; the answer is that of all so far, `None` without a bearing. `last_s` is the time of the last
/// stretch's last sample.
fn carry(
    track: &mut PeerTrack,
    last_s: &mut Option<f64>,
    trajectory: &Trajectory,
    made: &Result<Bearing, LinkError>,
) -> Option<CarriedAnswer> {
    let evidence = made.as_ref().ok()?.evidence();
    let driven_m = last_s.map_or(0.0, |last_s| way_m(trajectory, last_s, evidence.t_s));
    *last_s = Some(evidence.t_s);
    track.update(&evidence.with_driven_m(driven_m)).ok()?;
    track.last_answer().as_ref().map(CarriedAnswer::new)
}

/// Way driven between two times, metres.
fn way_m(trajectory: &Trajectory, from_s: f64, to_s: f64) -> f64 {
    let inside = || trajectory.poses().iter().filter(|pose| (from_s..=to_s).contains(&pose.t_s));
    inside().zip(inside().skip(1)).map(|(a, b)| (b.position_m - a.position_m).norm()).sum()
}

/// The motion of a trajectory cut every `every_s` seconds.
fn stretches(trajectory: &Trajectory, every_s: f64) -> Vec<Trajectory> {
    let Some((start_s, end_s)) = trajectory.motion().window_s.filter(|_| every_s > 0.0) else { return Vec::new() };
    let count = (((end_s - start_s) / every_s).round() as usize).clamp(1, trajectory.poses().len());
    let edge_s = |k: usize| if k == count { end_s } else { start_s + every_s * k as f64 };
    let cut = |k: usize| {
        let (from_s, to_s) = (edge_s(k), edge_s(k + 1));
        let inside = trajectory.poses().iter().filter(|pose| (from_s..=to_s).contains(&pose.t_s));
        Trajectory::new(inside.copied().collect()).ok()
    };
    (0..count).filter_map(cut).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::pose::Pose;
    use nalgebra::Vector3;

    fn trajectory() -> Trajectory {
        let at = |k: usize| Vector3::new(0.01 * (k.clamp(100, 600) as f64 - 100.0), 0.0, 0.0);
        let pose = |k: usize| Pose { t_s: 0.02 * k as f64, position_m: at(k), heading_rad: None };
        Trajectory::new((0..800).map(pose).collect()).unwrap()
    }

    #[test]
    fn stretches_follow_each_other_and_hold_the_motion() {
        let whole = trajectory();
        let (start_s, end_s) = whole.motion().window_s.unwrap();
        for every_s in [0.7, 2.0, 3.0, 4.0] {
            let cut: Vec<(f64, f64)> = stretches(&whole, every_s).iter().map(Trajectory::span_s).collect();
            let (first, last) = (cut[0], cut[cut.len() - 1]);
            assert!((first.0 - start_s).abs() < 0.03 && (last.1 - end_s).abs() < 0.03, "{every_s}: {cut:?}");
            assert!(cut.windows(2).all(|two| (two[1].0 - two[0].1).abs() < 0.03), "{every_s}: {cut:?}");
            assert!(last.1 - last.0 > 0.45 * every_s && last.1 - last.0 < 1.55 * every_s, "{every_s}: {cut:?}");
        }
        assert_eq!(stretches(&whole, 1e9).len(), 1);
        assert!([0.0, -1.0, f64::NAN].iter().all(|every_s| stretches(&whole, *every_s).is_empty()));
    }

    #[test]
    fn the_driven_distance_is_that_of_the_poses_between() {
        let whole = trajectory();
        assert!((way_m(&whole, 4.0, 6.0) - 1.0).abs() < 0.02, "{}", way_m(&whole, 4.0, 6.0));
        assert_eq!([way_m(&whole, 6.0, 4.0), way_m(&whole, 100.0, 200.0)], [0.0, 0.0]);
    }
}
