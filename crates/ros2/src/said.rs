//! A peer's report as messages, and as markers for RViz and Foxglove: the bearing as an arrow, twice its error bar as a wedge, the
//! mirror as a line, the place as an ellipsoid, and a label. Markers that no longer apply are deleted.

use csi5300::pipeline::live::{PeerReport, PeerState};
use csi5300_bag::messages::{
    Bearing, Colour, Covariance, Duration, Header, Marker, MarkerArray, Point, Pose as PoseMessage, PoseStamped,
    PoseWithCovariance, PoseWithCovarianceStamped, Quaternion, TfMessage, Transform, TransformStamped, Vector3,
};
use nalgebra::{Matrix3, Rotation3, SymmetricEigen, UnitQuaternion, Vector3 as Place};
use std::f64::consts::PI;

/// Variance of an unknown rotation, squared radians.
const ANY_TURN: f64 = PI * PI;

/// Length of an arrow without a range, metres.
const LENGTH_M: f64 = 3.0;
/// Triangles of a wedge.
const PARTS: u32 = 12;
/// Largest half width of a wedge, radians.
const WIDEST_RAD: f64 = 1.5;
/// Largest size of an ellipsoid, metres.
const LARGEST_M: f64 = 20.0;
/// Lifetime of a marker, seconds.
const LIFETIME_S: i32 = 5;

/// Colours of peers, in turn.
const COLOURS: [[f32; 3]; 6] = [
    [0.12, 0.47, 0.71],
    [1.0, 0.5, 0.05],
    [0.17, 0.63, 0.17],
    [0.84, 0.15, 0.16],
    [0.58, 0.4, 0.74],
    [0.55, 0.34, 0.29],
];

/// True for a report with a bearing, new or repeated.
fn has_bearing(report: &PeerReport) -> bool {
    matches!(report.state, PeerState::Bearing | PeerState::Held)
}

/// The report's state, as in the JSON lines.
fn state_name(state: PeerState) -> String {
    let name = serde_json::to_value(state).ok().and_then(|state| state.as_str().map(str::to_owned));
    name.unwrap_or_default()
}

/// The whole report; angles in radians, NaN for unknown values.
pub fn bearing(header: Header, report: &PeerReport) -> Bearing {
    let answer = &report.answer;
    let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
    let angle = |degrees: Option<f64>| number(degrees).to_radians();
    Bearing {
        header,
        peer: answer.link.clone(),
        mac: answer.mac.clone().unwrap_or_default(),
        state: state_name(report.state),
        words: report.words.clone(),
        azimuth: angle(answer.azimuth_deg),
        azimuth_sd: angle(answer.azimuth_sd_deg),
        azimuth_body: angle(answer.azimuth_body_deg),
        mirror: angle(answer.mirror_deg),
        elevation: angle(answer.abs_elevation_deg),
        signed_elevation: angle(answer.elevation_deg),
        range: number(answer.range_m),
        range_sd: number(answer.range_sd_m),
        coherence: number(answer.coherence),
        confidence: number(answer.confidence),
        moved: report.moved_m,
        needed: report.needed_m,
        age: report.age_s,
        pairs: u32::try_from(answer.pairs_in_motion).unwrap_or(u32::MAX),
    }
}

/// A pose at the point that the bearing refers to, the middle of the motion, along the bearing. It is pitched where the sign
/// of the elevation is known.
pub fn direction(header: &Header, report: &PeerReport) -> Option<PoseStamped> {
    let (origin_m, azimuth_deg) =
        report.answer.origin_m.zip(report.answer.azimuth_deg).filter(|_| has_bearing(report))?;
    let elevation_deg = report.answer.elevation_deg.unwrap_or(0.0);
    let orientation = Quaternion::along(azimuth_deg.to_radians(), elevation_deg.to_radians());
    let pose = PoseMessage { position: origin_m.into(), orientation };
    Some(PoseStamped { header: header.clone(), pose })
}

/// The peer's place, where the range is known; the orientation is unknown.
pub(crate) fn place(header: &Header, report: &PeerReport) -> Option<PoseWithCovarianceStamped> {
    let position_m = report.answer.position_m.filter(|_| has_bearing(report))?;
    let mut covariance = Covariance::default();
    let known = report.answer.position_covariance_m2.unwrap_or_default();
    for (to, from) in covariance.0.iter_mut().zip(known) {
        to.iter_mut().zip(from).for_each(|(to, from)| *to = from);
    }
    for (k, row) in covariance.0.iter_mut().enumerate().skip(3) {
        row.iter_mut().skip(k).take(1).for_each(|turn| *turn = ANY_TURN);
    }
    let orientation = Quaternion { w: 1.0, ..Quaternion::default() };
    let pose = PoseMessage { position: position_m.into(), orientation };
    Some(PoseWithCovarianceStamped { header: header.clone(), pose: PoseWithCovariance { pose, covariance } })
}

/// A peer's place as a transform to a frame of the peer's name.
pub(crate) fn transform(place: &PoseWithCovarianceStamped, child: &str) -> TfMessage {
    let at = &place.pose.pose.position;
    let translation = Vector3 { x: at.x, y: at.y, z: at.z };
    let transform = Transform { translation, rotation: place.pose.pose.orientation.clone() };
    let child_frame_id = child.to_owned();
    TfMessage { transforms: vec![TransformStamped { header: place.header.clone(), child_frame_id, transform }] }
}

/// The colour of peer number `number`: red, green, blue, each 0 to 1.
#[must_use]
pub fn colour(number: usize) -> [f32; 3] {
    COLOURS.get(number % COLOURS.len()).copied().unwrap_or_default()
}

fn point(place: Place<f64>) -> Point {
    <[f64; 3]>::from(place).into()
}

/// What all markers of a robot share.
pub struct Pen<'a> {
    /// Frame and time.
    pub header: &'a Header,
    /// Their namespace.
    pub name: &'a str,
    /// Red, green, blue, each 0 to 1.
    pub colour: [f32; 3],
}

impl Pen<'_> {
    /// A marker at the origin that lasts some seconds.
    #[must_use]
    pub fn marker(&self, id: i32, kind: i32, alpha: f32, scale: [f64; 3]) -> Marker {
        let ([r, g, b], [x, y, z]) = (self.colour, scale);
        Marker {
            header: self.header.clone(),
            ns: self.name.to_owned(),
            id,
            r#type: kind,
            pose: PoseMessage { orientation: Quaternion { w: 1.0, ..Quaternion::default() }, ..PoseMessage::default() },
            scale: Vector3 { x, y, z },
            color: Colour { r, g, b, a: alpha },
            lifetime: Duration { sec: LIFETIME_S, nanosec: 0 },
            ..Marker::default()
        }
    }

    fn none(&self, id: i32) -> Marker {
        Marker { action: Marker::DELETE, ..self.marker(id, Marker::ARROW, 0.0, [0.0; 3]) }
    }
}

/// The point at an azimuth and an elevation from `from`.
fn along(from: Place<f64>, azimuth: f64, elevation: f64, length: f64) -> Place<f64> {
    from + length * Place::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin())
}

/// The markers of the peer of this name and number.
pub(crate) fn markers(header: &Header, (name, number): (&str, usize), report: &PeerReport) -> MarkerArray {
    let (peer, answer) = (Pen { header, name, colour: colour(number) }, &report.answer);
    let seen = answer.origin_m.zip(answer.azimuth_deg).filter(|_| has_bearing(report));
    let Some((from, azimuth)) = seen.map(|(origin_m, deg)| (Place::from(origin_m), deg.to_radians())) else {
        return MarkerArray { markers: (0..5).map(|id| peer.none(id)).collect() };
    };
    let elevation = answer.elevation_deg.unwrap_or(0.0).to_radians();
    let length = answer.range_m.unwrap_or(LENGTH_M);
    let end = along(from, azimuth, elevation, length);
    let arrow =
        Marker { points: vec![point(from), point(end)], ..peer.marker(0, Marker::ARROW, 0.9, [0.04, 0.1, 0.15]) };
    let wedge = match answer.azimuth_sd_deg.map(f64::to_radians).filter(|sd| *sd > 0.0) {
        Some(sd) => {
            let half = (2.0 * sd).min(WIDEST_RAD);
            let edge =
                |k: u32| along(from, azimuth + half * (2.0 * f64::from(k) / f64::from(PARTS) - 1.0), elevation, length);
            let points = (0..PARTS).flat_map(|k| [from, edge(k), edge(k + 1)]).map(point).collect();
            Marker { points, ..peer.marker(1, Marker::TRIANGLES, 0.25, [1.0; 3]) }
        }
        None => peer.none(1),
    };
    let mirror = match answer.mirror_deg.map(f64::to_radians) {
        Some(mirror) => {
            let elevation = answer.mirror_elevation_deg.unwrap_or(0.0).to_radians();
            let points = vec![point(from), point(along(from, mirror, elevation, length))];
            Marker { points, ..peer.marker(2, Marker::LINE_STRIP, 0.4, [0.02, 0.0, 0.0]) }
        }
        None => peer.none(2),
    };
    let place = ellipsoid(&peer, report).unwrap_or_else(|| peer.none(3));
    let mut words = peer.marker(4, Marker::TEXT, 1.0, [0.0, 0.0, 0.25]);
    words.pose.position = point(end + Place::new(0.0, 0.0, 0.3));
    words.text = match (answer.range_m, answer.azimuth_sd_deg) {
        (Some(range), Some(sd)) => format!("{name}: {:.1} +- {sd:.1} deg, {range:.1} m", azimuth.to_degrees()),
        (None, Some(sd)) => format!("{name}: {:.1} +- {sd:.1} deg", azimuth.to_degrees()),
        _ => format!("{name}: {:.1} deg", azimuth.to_degrees()),
    };
    MarkerArray { markers: vec![arrow, wedge, mirror, place, words] }
}

/// The ellipsoid of two standard deviations about the peer's place.
fn ellipsoid(peer: &Pen<'_>, report: &PeerReport) -> Option<Marker> {
    let (position_m, rows) = report.answer.position_m.zip(report.answer.position_covariance_m2)?;
    let covariance =
        Matrix3::from_fn(|row, column| rows.get(row).and_then(|row| row.get(column)).copied().unwrap_or(0.0));
    if !covariance.iter().all(|x| x.is_finite()) {
        return None;
    }
    let SymmetricEigen { eigenvalues, mut eigenvectors } = SymmetricEigen::new(covariance);
    if eigenvectors.determinant() < 0.0 {
        eigenvectors.neg_mut();
    }
    // Two standard deviations to either side.
    let scale = eigenvalues.map(|variance| (4.0 * variance.max(0.0).sqrt()).clamp(0.02, LARGEST_M));
    let turned = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(eigenvectors)).coords;
    let mut marker = peer.marker(3, Marker::SPHERE, 0.35, scale.into());
    marker.pose.position = position_m.into();
    marker.pose.orientation = Quaternion { x: turned.x, y: turned.y, z: turned.z, w: turned.w };
    Some(marker)
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::pipeline::Answer;
    use nalgebra::Quaternion as Numbers;

    fn actions(markers: &MarkerArray) -> Vec<i32> {
        markers.markers.iter().map(|marker| marker.action).collect()
    }

    #[test]
    fn missing_values_delete_their_markers() {
        let none = markers(&Header::default(), ("b", 7), &report(PeerState::NoPairs, |_| ()));
        assert_eq!(actions(&none), [Marker::DELETE; 5]);
        let plane = report(PeerState::Bearing, |answer| {
            (answer.origin_m, answer.azimuth_deg) = (Some([1.0, 2.0, 0.2]), Some(90.0));
            answer.azimuth_sd_deg = Some(5.0);
        });
        let drawn = markers(&Header::default(), ("b", 7), &plane);
        assert_eq!(actions(&drawn), [0, 0, 2, 2, 0]);
        let end = &drawn.markers[0].points[1];
        assert!((end.x - 1.0).abs() < 1e-9 && (end.y - 2.0 - LENGTH_M).abs() < 1e-9, "{end:?}");
        let wedge = &drawn.markers[1].points;
        assert_eq!(wedge.len(), 3 * PARTS as usize);
        let edge = &wedge[1];
        let off = (edge.y - 2.0).atan2(edge.x - 1.0).to_degrees();
        assert!((off - 80.0).abs() < 1e-9, "twice the error bar: {off}");
        assert_eq!(drawn.markers[4].text, "b: 90.0 +- 5.0 deg");
    }

    #[test]
    fn a_mirror_is_as_steep_as_it_is_found() {
        let tilted = report(PeerState::Bearing, |answer| {
            (answer.origin_m, answer.azimuth_deg, answer.elevation_deg) = (Some([0.0; 3]), Some(0.0), Some(30.0));
            (answer.mirror_deg, answer.mirror_elevation_deg) = (Some(90.0), Some(-30.0));
        });
        let end = markers(&Header::default(), ("b", 7), &tilted).markers[2].points[1].clone();
        assert!((end.z + 0.5 * LENGTH_M).abs() < 1e-9 && end.y > 0.0, "{end:?}");
    }

    #[test]
    fn an_ellipsoid_lies_along_its_covariance() {
        let known = report(PeerState::Bearing, |answer| {
            (answer.origin_m, answer.azimuth_deg, answer.range_m) = (Some([1.0, 2.0, 0.2]), Some(0.0), Some(4.0));
            answer.position_m = Some([5.0, 2.0, 0.0]);
            // One metre along (1, 1, 0), a tenth across.
            answer.position_covariance_m2 = Some([[0.505, 0.495, 0.0], [0.495, 0.505, 0.0], [0.0, 0.0, 0.01]]);
        });
        let marker = markers(&Header::default(), ("b", 0), &known).markers.remove(3);
        let scale = [marker.scale.x, marker.scale.y, marker.scale.z];
        let longest = (0..3).max_by(|a, b| scale[*a].total_cmp(&scale[*b])).unwrap();
        assert!((scale[longest] - 4.0).abs() < 1e-6, "{scale:?}");
        let axis = Place::from_fn(|row, _| f64::from(u8::from(row == longest)));
        let along = marker.pose.orientation.rotation().unwrap() * axis;
        assert!(
            (along.x.abs() - along.y.abs()).abs() < 1e-6 && along.x * along.y > 0.0 && along.z.abs() < 1e-6,
            "{along}"
        );
    }

    /// A report with these fields.
    fn report(state: PeerState, fill: impl FnOnce(&mut Answer)) -> PeerReport {
        let mut answer = Answer::default();
        fill(&mut answer);
        let (words, t_s) = ("words".into(), Some(12.5));
        PeerReport {
            t_s,
            state,
            words,
            moved_m: 1.0,
            needed_m: 0.1,
            age_s: 0.0,
            accurate: true,
            heard_at: None,
            answer,
        }
    }

    #[test]
    fn unknown_values_are_nan() {
        let said = bearing(Header::default(), &report(PeerState::NotYet, |answer| answer.link = "b".into()));
        assert_eq!((said.state.as_str(), said.peer.as_str(), said.pairs), ("not_yet", "b", 0));
        assert!(said.azimuth.is_nan() && said.range.is_nan() && said.confidence.is_nan() && said.moved == 1.0);
        assert_eq!(direction(&Header::default(), &report(PeerState::NotYet, |_| ())), None);
        assert_eq!(place(&Header::default(), &report(PeerState::Bearing, |_| ())), None);
    }

    #[test]
    fn a_direction_points_along_the_bearing() {
        let report = report(PeerState::Bearing, |answer| {
            (answer.origin_m, answer.azimuth_deg) = (Some([1.0, 2.0, 0.2]), Some(120.0));
            answer.elevation_deg = Some(-20.0);
        });
        let said = direction(&Header::default(), &report).unwrap();
        let turned = &said.pose.orientation;
        let along = UnitQuaternion::from_quaternion(Numbers::new(turned.w, turned.x, turned.y, turned.z)) * Place::x();
        let (azimuth, elevation) = (120.0_f64.to_radians(), -(20.0_f64.to_radians()));
        let expected = Place::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
        assert!((along - expected).norm() < 1e-12, "{along}");
        assert_eq!(said.pose.position, [1.0, 2.0, 0.2].into());
    }

    #[test]
    fn a_place_has_its_covariance_and_an_unknown_orientation() {
        let report = report(PeerState::Held, |answer| {
            answer.position_m = Some([4.0, 5.0, 0.5]);
            answer.position_covariance_m2 = Some([[1.0, 2.0, 3.0], [2.0, 4.0, 5.0], [3.0, 5.0, 6.0]]);
        });
        let said = place(&Header::default(), &report).unwrap();
        let rows = said.pose.covariance.0;
        assert_eq!(rows[1], [2.0, 4.0, 5.0, 0.0, 0.0, 0.0]);
        assert_eq!(rows[4], [0.0, 0.0, 0.0, 0.0, ANY_TURN, 0.0]);
        let tf = transform(&said, "b");
        assert_eq!((tf.transforms[0].transform.translation.y, tf.transforms[0].child_frame_id.as_str()), (5.0, "b"));
    }
}
