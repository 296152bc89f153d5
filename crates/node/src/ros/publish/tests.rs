use super::*;
use csi5300::pipeline::Answer;
use csi5300::pipeline::live::PeerState;
use driver_iface::bfee::{Iq, Repr, Wsr};
use driver_iface::record::code;

fn report(state: PeerState, azimuth_deg: Option<f64>) -> PeerReport {
    let mut answer = Answer::default();
    (answer.azimuth_deg, answer.azimuth_sd_deg) = (azimuth_deg, Some(0.5));
    PeerReport {
        t_s: Some(1_700_000_000.25),
        state,
        words: "moved 0.04 m".into(),
        moved_m: 0.04,
        needed_m: 0.11,
        age_s: 0.0,
        accurate: false,
        heard_at: None,
        answer,
    }
}

#[test]
fn a_bearing_is_in_radians_and_what_is_not_known_is_no_number() {
    let told = bearing(Header::default(), "b", "02:00:00:00:00:01", &report(PeerState::NotYet, None));
    assert_eq!((told.state.as_str(), told.words.as_str(), told.moved), ("not_yet", "moved 0.04 m", 0.04));
    assert!(told.azimuth.is_nan() && told.range.is_nan() && (told.azimuth_sd - 0.5_f64.to_radians()).abs() < 1e-12);
    let told = bearing(Header::default(), "b", "", &report(PeerState::Bearing, Some(-90.0)));
    assert!((told.azimuth + std::f64::consts::FRAC_PI_2).abs() < 1e-12);
}

#[test]
fn a_pose_looks_along_the_bearing() {
    let own = Pose { t_s: 0.0, position_m: nalgebra::Vector3::new(1.0, 2.0, 0.2), heading_rad: Some(0.3) };
    for (azimuth, elevation) in [(2.0, 0.0), (2.0, 0.7), (-0.4, -1.2)] {
        let told = pointing(Header::default(), &own, azimuth, elevation);
        let q = told.pose.orientation;
        let turned = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q.w, q.x, q.y, q.z));
        let looks = turned * nalgebra::Vector3::x();
        assert!((looks - csi5300::bartlett::direction(azimuth, elevation)).norm() < 1e-12);
        assert!((csi5300::internal::heading_of(&turned) - azimuth).abs() < 1e-12);
        assert_eq!((told.pose.position.x, told.pose.position.z), (1.0, 0.2));
    }
}

#[test]
fn csi_is_in_the_order_of_antennas_and_in_the_cards_units() {
    let wsr = Wsr { tv_sec: 1_700_000_000, tv_usec: 250_000, mac: driver_iface::Mac([2; 6]), frame_count: Some(77) };
    // The first chain is antenna B, the second A.
    let repr = Repr { n_rx: 2, n_tx: 1, antenna_sel: 0b0001, rssi: [30, 31, 0], wsr: Some(wsr), ..Repr::default() };
    let mut samples = [Iq { i: 0, q: 0 }; 60];
    samples[0] = Iq { i: -128, q: 1 };
    samples[1] = Iq { i: 127, q: -3 };
    let mut body = vec![0; repr.body_len()];
    repr.emit(&samples, &mut body).unwrap();
    let mut survey = Survey::default();
    let next = Next::Record(Stamps::default(), Record { code: code::BFEE, body: &body });
    let (bfee, identity) = survey.note(&next).unwrap();
    let told = csi(5, &bfee, identity);
    assert_eq!((told.antennas.as_slice(), told.n_rx, told.n_tx, told.re.len()), (&[0, 1][..], 2, 1, 60));
    assert_eq!(((told.re[0], told.im[0]), (told.re[1], told.im[1])), ((127, -3), (-128, 1)));
    assert_eq!((told.header.stamp.secs, told.header.stamp.nsecs), (1_700_000_000, 250_000_000));
    assert_eq!((told.mac.as_str(), told.frame_count, told.header.seq), ("02:02:02:02:02:02", 77, 5));
}
