//! Locates transmitters, each from all receiver motions in one common frame, by a graph of `csi5300-team`.
//!
//! A motion is a robot with one keyframe at its middle. The pose of this keyframe is known, up to the deviation of the
//! trajectory's heading. A link is a mixture of the bearing's candidates, as in [`super::receivers`].

use super::captures::TrajectorySource;
use super::judge::Judged;
use super::receivers::{PLACE_SD_M, noise, place};
use csi5300_team::answers::{LINK_OUTLIERS, ways};
use csi5300_team::{KeyframeId, Mode, Solution, Team, TeamError};
use nalgebra::{Matrix2, Rotation2, Vector2};
use serde::Serialize;
use std::collections::BTreeMap;

/// Squared distance, in standard deviations, that holds 68 % of a plane normal distribution.
const ELLIPSE: f64 = 2.278_868_566_376_729_5;

/// Standard deviation of a transmitter's place from the motions' middle before anything was heard, metres: the farthest range
/// that the estimate's prior expects. Nearly parallel bearings cross within it.
const FAR_M: f64 = 36.0;

/// Position of a capture's trajectory frame in the common frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Frame {
    /// Its origin, metres.
    pub origin_m: [f64; 2],
    /// Its x axis, radians from the common one's towards +y.
    pub yaw_rad: f64,
}

impl Frame {
    /// A position of the trajectory's frame in the common one, metres.
    fn common(&self, place_m: [f64; 2]) -> Vector2<f64> {
        Vector2::from(self.origin_m) + Rotation2::new(self.yaw_rad) * Vector2::from(place_m)
    }
}

/// A place where a transmitter may be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OtherPlace {
    /// Its middle, metres in the common frame.
    pub position_m: [f64; 2],
    /// Its probability.
    pub share: f64,
}

/// A transmitter, located from all motions together.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LocatedTransmitter {
    /// Its name.
    pub transmitter: String,
    /// Motions used.
    pub motions: usize,
    /// The likeliest place, metres in the common frame.
    pub position_m: Option<[f64; 2]>,
    /// Its covariance, metres squared, row by row.
    pub covariance_m2: Option<[[f64; 2]; 2]>,
    /// Half axes, metres, the longer first, of the ellipse that holds 68 % of this place.
    pub ellipse_m: Option<[f64; 2]>,
    /// Direction of the longer axis, degrees from +x towards +y, in (-90, 90].
    pub ellipse_deg: Option<f64>,
    /// Probability that the transmitter is at this place rather than at the others.
    pub share: Option<f64>,
    /// The other places, the likeliest first.
    pub others: Vec<OtherPlace>,
    /// Why there is none.
    pub error: Option<String>,
    /// Its true place, metres, if a capture or the caller gives it.
    pub true_position_m: Option<[f64; 2]>,
    /// Distance between estimate and truth, metres.
    pub off_m: Option<f64>,
    /// Whether the truth is within the ellipse.
    pub within: Option<bool>,
}

/// Locates every transmitter from all links with a bearing to it, each with the frame of its trajectory by `source`. Truths of
/// captures are in motion capture's frame only; `told` has the places that the caller knows, by name.
#[must_use]
pub fn located(
    links: &[(Judged, Frame)],
    source: TrajectorySource,
    told: &BTreeMap<String, [f64; 2]>,
) -> Vec<LocatedTransmitter> {
    let mut transmitters: BTreeMap<&str, Vec<&(Judged, Frame)>> = BTreeMap::new();
    for link in links.iter().filter(|(row, _)| row.answer.azimuth_deg.is_some()) {
        transmitters.entry(link.0.transmitter()).or_default().push(link);
    }
    let is_common = source == TrajectorySource::GroundTruth;
    let one = |(name, own): (&str, Vec<&(Judged, Frame)>)| {
        let truth = |(row, frame): &&(Judged, Frame)| Some(frame.common(row.true_transmitter_m?).into());
        let truth = told.get(name).copied().or_else(|| own.iter().find_map(truth).filter(|_| is_common));
        locate(name, &own, truth)
    };
    transmitters.into_iter().map(one).collect()
}

fn locate(name: &str, links: &[&(Judged, Frame)], true_position_m: Option<[f64; 2]>) -> LocatedTransmitter {
    let located = LocatedTransmitter {
        transmitter: name.to_owned(),
        motions: links.len(),
        true_position_m,
        ..LocatedTransmitter::default()
    };
    let (found, keyframe) = match solve(links) {
        Ok(solved) => solved,
        Err(error) => return LocatedTransmitter { error: Some(error.to_string()), ..located },
    };
    let (position_m, covariance_m2, others_m) = place(&found, keyframe);
    let likelihoods: Vec<f64> = found.others.iter().map(|other| (-other.cost_over).exp()).collect();
    let share = 1.0 / (1.0 + likelihoods.iter().sum::<f64>());
    let other = |(position_m, likelihood)| OtherPlace { position_m, share: share * likelihood };
    let (half_m, deg) = axes(&covariance_m2.into());
    // The bearings have to halve the prior's deviation.
    if half_m[0] > 0.5 * FAR_M * ELLIPSE.sqrt() {
        let error = "the bearings leave its range open: a place needs two that cross, or one with a range".to_owned();
        return LocatedTransmitter { error: Some(error), ..located };
    }
    let off_m = true_position_m.map(|truth| Vector2::from(position_m) - Vector2::from(truth));
    let inverse = Matrix2::from(covariance_m2).try_inverse();
    LocatedTransmitter {
        position_m: Some(position_m),
        covariance_m2: Some(covariance_m2),
        ellipse_m: Some(half_m),
        ellipse_deg: Some(deg),
        share: Some(share),
        others: others_m.into_iter().zip(likelihoods).map(other).collect(),
        off_m: off_m.map(|off_m| off_m.norm()),
        within: off_m.zip(inverse).map(|(off_m, inverse)| off_m.dot(&(inverse * off_m)) <= ELLIPSE),
        ..located
    }
}

/// The graph's solution, and the transmitter's keyframe.
fn solve(links: &[&(Judged, Frame)]) -> Result<(Solution, KeyframeId), TeamError> {
    let mut team = Team::default();
    let transmitter = team.robot("transmitter", false, noise(0.0))?;
    let transmitter = team.keyframe(transmitter, 0.0, [0.0; 3], 0.0)?;
    let mut sum_m = Vector2::zeros();
    for (k, (row, frame)) in links.iter().enumerate() {
        let heading_sd_rad = row.heading_sd_rad.unwrap_or_default();
        let [x, y, _] = row.answer.origin_m.unwrap_or_default();
        let at_m = frame.common([x, y]);
        sum_m += at_m;
        let motion = team.robot(&format!("motion {k}"), true, noise(heading_sd_rad))?;
        let middle = team.keyframe(motion, 0.0, [x, y, 0.0], 0.0)?;
        let pose = [at_m.x, at_m.y, frame.yaw_rad];
        team.prior(middle, pose, [PLACE_SD_M, PLACE_SD_M, heading_sd_rad.max(1e-4)])?;
        let ways = ways(&row.answer, heading_sd_rad.to_degrees());
        let modes: Vec<Mode> = ways.into_iter().map(|way| way.mode).collect();
        team.link(middle, transmitter, &modes, LINK_OUTLIERS)?;
    }
    let [x, y]: [f64; 2] = (sum_m / links.len().max(1) as f64).into();
    team.prior(transmitter, [x, y, 0.0], [FAR_M, FAR_M, f64::INFINITY])?;
    Ok((team.solve()?, transmitter))
}

/// Half axes of the ellipse, metres, and the direction of the longer one, degrees.
fn axes(covariance_m2: &Matrix2<f64>) -> ([f64; 2], f64) {
    let own = covariance_m2.symmetric_eigen();
    let longer = usize::from(own.eigenvalues[1] > own.eigenvalues[0]);
    let half_m = |k: usize| (ELLIPSE * own.eigenvalues[k].max(0.0)).sqrt();
    let along = own.eigenvectors.column(longer);
    let deg = along[1].atan2(along[0]).to_degrees();
    // Half turns change nothing.
    ([half_m(longer), half_m(1 - longer)], deg - 180.0 * (deg / 180.0 - 0.5).ceil())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::judge::row;

    const AT: [f64; 2] = [3.0, 1.0];

    /// A link from a motion about `from` in the common frame, by a trajectory in `frame`.
    fn link(from: [f64; 2], frame: Frame, off_deg: f64) -> (Judged, Frame) {
        let own = Rotation2::new(-frame.yaw_rad) * (Vector2::from(from) - Vector2::from(frame.origin_m));
        let to = Vector2::from(AT) - Vector2::from(from);
        let azimuth_deg = (to.y.atan2(to.x) - frame.yaw_rad).to_degrees() + off_deg;
        let mut row = row("a/tx2", azimuth_deg, off_deg, 0.9);
        row.answer.origin_m = Some([own.x, own.y, 0.0]);
        row.heading_sd_rad = Some(0.005);
        (row, frame)
    }

    fn one(links: &[(Judged, Frame)]) -> LocatedTransmitter {
        let told = BTreeMap::from([("tx2".to_owned(), AT)]);
        let mut found = located(links, TrajectorySource::Odometry, &told);
        assert_eq!(found.len(), 1);
        found.remove(0)
    }

    #[test]
    fn an_ellipse_has_its_longer_axis_first_and_upright() {
        let turned = Rotation2::new(-1.0);
        let covariance = turned.matrix() * Matrix2::new(4.0, 0.0, 0.0, 1.0) * turned.matrix().transpose();
        let ([longer, shorter], deg) = axes(&covariance);
        assert!((longer - 2.0 * ELLIPSE.sqrt()).abs() < 1e-9 && (shorter - ELLIPSE.sqrt()).abs() < 1e-9);
        assert!((deg + 57.295_779_5).abs() < 1e-6, "{deg}");
        assert!((ELLIPSE + 2.0 * 0.32f64.ln()).abs() < 1e-6);
    }

    #[test]
    fn bearings_of_any_frames_cross_at_the_transmitter() {
        let turned = Frame { origin_m: [-3.0, 7.0], yaw_rad: 2.5 };
        let links = [
            link([0.0, 0.0], Frame::default(), 1.0),
            link([1.0, 3.0], turned, -1.0),
            link([-1.0, 2.0], Frame::default(), 0.0),
        ];
        let found = one(&links);
        assert!(found.off_m.is_some_and(|off_m| off_m < 0.2) && found.within == Some(true), "{found:?}");
        assert!(found.motions == 3 && found.share == Some(1.0) && found.others.is_empty(), "{found:?}");
    }

    #[test]
    fn bearings_that_do_not_cross_give_no_place() {
        let found = one(&[link([0.0, 1.0], Frame::default(), 0.0), link([0.5, 1.0], Frame::default(), 0.0)]);
        assert!(found.error.is_some_and(|error| error.contains("range open")) && found.position_m.is_none());
    }

    #[test]
    fn links_without_a_bearing_locate_nothing() {
        let mut none = link([0.0, 0.0], Frame::default(), 0.0);
        none.0.answer.azimuth_deg = None;
        assert_eq!(located(&[none], TrajectorySource::Odometry, &BTreeMap::new()), []);
    }
}
