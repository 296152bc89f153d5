//! Tests: a peer's feed that is this robot's own log is refused for as long as the window is full of it.

use super::*;
use crate::motion::pose::Pose;
use crate::pipeline::{LinkError, Options};
use crate::source::{Next, Stamps};
use crate::time::Instant;
use driver_iface::Mac;
use driver_iface::bfee::{Iq, Repr, Wsr};
use driver_iface::record::{Record, code};
use nalgebra::Vector3;

const OWN: Mac = Mac([2, 0, 0, 0, 0, 1]);
const PEER: Mac = Mac([2, 0, 0, 0, 0, 2]);

/// Frame `number` of `mac`, heard 10 ms after the one before, by a card so far ahead, with numbers that turn with it.
fn hear(mac: Mac, number: u32, (turn, ahead_us): (f64, u32), take: &mut dyn FnMut(&Next<'_>)) {
    let timestamp_low = number * 10_000 + ahead_us;
    let (tv_sec, tv_usec) = (timestamp_low / 1_000_000, timestamp_low % 1_000_000);
    let wsr = Wsr { mac, frame_count: Some(number), tv_sec, tv_usec };
    let repr = Repr { timestamp_low, n_rx: 1, n_tx: 1, antenna_sel: 0, wsr: Some(wsr), ..Repr::default() };
    let mut body = vec![0; repr.body_len()];
    let iq = Iq { i: (40.0 * turn.cos()) as i8, q: (40.0 * turn.sin()) as i8 };
    repr.emit(&vec![iq; repr.samples()], &mut body).unwrap();
    take(&Next::Record(Stamps::default(), Record { code: code::BFEE, body: &body }));
}

/// Drives in circles for 4 s a feed: the peer's channel is turned by so much against this robot's own, and its card so far
/// ahead; with neither it is this robot's own log. Gives why there was no bearing at the end of each.
fn causes(feeds: &[(f64, u32)]) -> Vec<Option<LinkError>> {
    let still = Track::still(Vector3::zeros(), 0.0);
    let peer = LivePeer { name: "b".into(), mac: PEER, track: still, yaw_rad: 0.0 };
    let options = Options::new("108".parse().unwrap());
    let settings = LiveSettings { window_s: 3.0, window_m: 0.5, rate_hz: 1.0, ..LiveSettings::new(0.054) };
    let mut estimator = LiveEstimator::new(OWN, Track::default(), vec![peer], settings, options, Instant::ZERO);
    let (mut number, mut causes) = (0, Vec::new());
    for (turned, ahead_us) in feeds {
        let mut cause = None;
        for _ in 0..400 {
            number += 1;
            let t_s = f64::from(number) * 0.01;
            let position_m = Vector3::new(0.2 * t_s.cos(), 0.2 * t_s.sin(), 0.0);
            estimator.handle_pose(Some(Pose { t_s, position_m, heading_rad: None }));
            hear(PEER, number, (t_s, 0), &mut |next| estimator.handle_own(next));
            hear(OWN, number, (t_s + turned, *ahead_us), &mut |next| estimator.handle_peer(0, next));
            let now = Instant::from_us(i64::from(number) * 10_000);
            if let Some((_, report)) = estimator.poll_report(now).filter(|(_, report)| report.state != PeerState::Held)
            {
                cause = report.answer.cause;
            }
        }
        causes.push(cause);
    }
    causes
}

#[test]
fn a_feed_that_is_ones_own_log_is_refused_by_the_window_alone() {
    let (other, own, alike) = ((1.0, 0), (0.0, 0), (0.0, 40));
    let causes = causes(&[other, own, other, alike]);
    let refused: Vec<bool> = causes.iter().map(|cause| *cause == Some(LinkError::OneLogTwice)).collect();
    assert_eq!(refused, [false, true, false, false], "{causes:?}");
}
