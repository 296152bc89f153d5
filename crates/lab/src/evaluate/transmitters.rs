//! Locates transmitters, each from all receiver motions in one common frame.

use super::captures::{Capture, TrajectorySource};
use super::judge::Evaluated;
use csi5300::internal::track::{Evidence, places};
use csi5300::pipeline::{Bearing, Options};
use csi5300::signal::channel::Channel;
use nalgebra::{Matrix2, Rotation2, Vector2};
use serde::Serialize;
use std::collections::BTreeMap;

/// Squared distance, in standard deviations, that holds 68 % of a plane normal distribution.
const ELLIPSE: f64 = 2.278_868_566_376_729_5;

/// Position of a capture's trajectory frame in the common frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Frame {
    /// Its origin, metres.
    pub origin_m: [f64; 2],
    /// Its x axis, radians from the common one's towards +y.
    pub yaw_rad: f64,
}

/// The evidence of one receiver motion about a transmitter, in the common frame.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Motion {
    /// Name of the transmitter: `tx2`.
    pub transmitter: String,
    /// The directions from the middle of the motion.
    pub evidence: Evidence,
    /// Place of the transmitter, metres, if the capture has a truth in its trajectory's frame.
    pub true_m: Option<[f64; 2]>,
}

/// The motions of a capture.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct Motions {
    /// One for each transmitter that has a bearing.
    pub motions: Vec<Motion>,
    /// Links without a bearing, and why.
    pub failed: Vec<(String, String)>,
    /// Losses, one line each.
    pub notes: Vec<String>,
    /// True if records were lost, or a link failed.
    pub lost: bool,
}

/// A place where a transmitter may be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct OtherPlace {
    /// Its middle, metres in the common frame.
    pub position_m: [f64; 2],
    /// Its probability.
    pub share: f64,
}

/// A transmitter, located from all motions together.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct LocatedTransmitter {
    /// Its name.
    pub transmitter: String,
    /// Motions used.
    pub motions: usize,
    /// Motions with unusable evidence.
    pub refused: usize,
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

impl Capture {
    /// This capture's evidence about each of its transmitters in the common frame, where its trajectory's frame lies at `frame`.
    /// Truths are in motion capture's frame only.
    #[must_use]
    pub fn motions(
        &self,
        source: TrajectorySource,
        channel: Option<Channel>,
        options: &Options,
        frame: Frame,
    ) -> Motions {
        let heading_sd_rad = options.heading_sd_rad.unwrap_or(self.heading_sd_rad(source));
        let common = |place_m: [f64; 2]| {
            let place_m = Vector2::from(frame.origin_m) + Rotation2::new(frame.yaw_rad) * Vector2::from(place_m);
            place_m.into()
        };
        let mut seen: BTreeMap<String, Evidence> = BTreeMap::new();
        let mut look = |name: &str, bearing: &Bearing, _: &Options| {
            let evidence = bearing.evidence().with_heading_sd_rad(heading_sd_rad);
            seen.insert(name.to_owned(), evidence.in_frame(frame.origin_m.into(), frame.yaw_rad));
        };
        let Evaluated { rows, lost, notes } = self.evaluate_and(source, channel, options, &mut look);
        let mut found = Motions { notes, lost, ..Motions::default() };
        for row in rows {
            let Some(evidence) = seen.remove(&row.answer.link) else {
                found.failed.push((row.answer.link, row.answer.error.unwrap_or_default()));
                continue;
            };
            let true_m = row.true_transmitter_m.filter(|_| source == TrajectorySource::GroundTruth).map(common);
            found.motions.push(Motion { transmitter: row.transmitter().to_owned(), evidence, true_m });
        }
        found
    }
}

/// Locates every transmitter from all motions that heard it; `told` has the places that the caller knows, by name.
#[must_use]
pub fn located(motions: &[Motion], told: &BTreeMap<String, [f64; 2]>) -> Vec<LocatedTransmitter> {
    let mut transmitters: BTreeMap<&str, Vec<&Motion>> = BTreeMap::new();
    for motion in motions {
        transmitters.entry(&motion.transmitter).or_default().push(motion);
    }
    let one = |(name, own): (&str, Vec<&Motion>)| {
        let true_m = told.get(name).copied().or_else(|| own.iter().find_map(|motion| motion.true_m));
        locate(name, &own, true_m)
    };
    transmitters.into_iter().map(one).collect()
}

fn locate(name: &str, motions: &[&Motion], true_position_m: Option<[f64; 2]>) -> LocatedTransmitter {
    let evidence: Vec<Evidence> = motions.iter().map(|motion| motion.evidence.clone()).collect();
    let (found, error, motions, refused) = match places(&evidence) {
        Ok(found) => (found.places, None, found.used, found.refused),
        Err(error) => (Vec::new(), Some(error.to_string()), 0, evidence.len()),
    };
    let best = found.first();
    let axes = best.map(|place| axes(&place.covariance_m2));
    let off_m = best.zip(true_position_m).map(|(place, truth)| place.position_m - Vector2::from(truth));
    LocatedTransmitter {
        transmitter: name.to_owned(),
        motions,
        refused,
        position_m: best.map(|place| place.position_m.into()),
        covariance_m2: best.map(|place| place.covariance_m2.into()),
        ellipse_m: axes.map(|(half_m, _)| half_m),
        ellipse_deg: axes.map(|(_, deg)| deg),
        share: best.map(|place| place.share),
        others: found
            .iter()
            .skip(1)
            .map(|own| OtherPlace { position_m: own.position_m.into(), share: own.share })
            .collect(),
        error,
        true_position_m,
        off_m: off_m.map(|off_m| off_m.norm()),
        within: best.zip(off_m).and_then(|(place, off_m)| {
            let inverse = place.covariance_m2.try_inverse()?;
            Some(off_m.dot(&(inverse * off_m)) <= ELLIPSE)
        }),
    }
}

/// Half axes of the ellipse, metres, and the direction of the longer one, degrees.
fn axes(covariance_m2: &Matrix2<f64>) -> ([f64; 2], f64) {
    let own = covariance_m2.symmetric_eigen();
    let longer = usize::from(own.eigenvalues[1] > own.eigenvalues[0]);
    let half_m = |k: usize| (ELLIPSE * own.eigenvalues[k].max(0.0)).sqrt();
    let along = own.eigenvectors.column(longer);
    let deg = along[1].atan2(along[0]).to_degrees();
    let upright = if deg > 90.0 {
        deg - 180.0
    } else if deg <= -90.0 {
        deg + 180.0
    } else {
        deg
    };
    ([half_m(longer), half_m(1 - longer)], upright)
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::internal::track::EvidenceMode;

    const AT: [f64; 2] = [3.0, 1.0];

    fn seen(from: [f64; 2]) -> Motion {
        let to = Vector2::from(AT) - Vector2::from(from);
        let modes = vec![EvidenceMode::new(to.y.atan2(to.x), 0.02, 1.0)];
        let evidence = Evidence::new(0.0, from.into(), modes, 0.9);
        Motion { transmitter: "tx2".into(), evidence, true_m: None }
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
    fn unusable_evidence_is_counted() {
        let mut broken = seen([0.0, 0.0]);
        broken.evidence.modes.clear();
        let [found] = &located(&[broken.clone(), seen([0.0, 0.0])], &BTreeMap::new())[..] else { panic!() };
        assert_eq!((found.motions, found.refused, found.error.is_none()), (1, 1, true));
        let [found] = &located(&[broken], &BTreeMap::new())[..] else { panic!() };
        assert!(found.error.as_ref().is_some_and(|error| error.contains("usable")), "{found:?}");
    }
}
