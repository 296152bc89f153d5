//! Tests: whoever else is heard, a peer keeps its place.

use super::*;
use crate::exchange::tdma::Key;
use crate::pipeline::Options;
use crate::source::{Next, Stamps};
use crate::time::Instant;
use driver_iface::Mac;
use driver_iface::bfee::{Iq, Repr, Wsr};
use driver_iface::record::{Record, code};

const OWN: Mac = Mac([2, 0, 0, 0, 0, 1]);
const PEER: Mac = Mac([2, 0, 0, 0, 0, 2]);

/// A record of a card that heard frame `number` of `mac`, in the WSR layout.
fn hear(mac: Mac, number: u32, clock_us: u32, take: &mut dyn FnMut(&Next<'_>)) {
    let wsr = Wsr { mac, frame_count: Some(number), tv_sec: 1, tv_usec: 0 };
    let repr = Repr { timestamp_low: clock_us, n_rx: 1, n_tx: 1, antenna_sel: 0, wsr: Some(wsr), ..Repr::default() };
    let mut body = vec![0; repr.body_len()];
    repr.emit(&vec![Iq { i: 20, q: 3 }; repr.samples()], &mut body).unwrap();
    take(&Next::Record(Stamps::default(), Record { code: code::BFEE, body: &body }));
}

fn made_up(n: u32) -> Mac {
    let [_, a, b, c] = n.to_be_bytes();
    Mac([2, 0x66, 0, a, b, c])
}

fn estimator() -> LiveEstimator {
    let peer = LivePeer { name: "b".into(), mac: PEER, track: Track::default(), yaw_rad: 0.0 };
    let options = Options::new("108".parse().unwrap());
    LiveEstimator::new(OWN, Track::default(), vec![peer], LiveSettings::new(0.054), options, Instant::ZERO)
}

#[test]
fn a_peer_is_heard_though_strangers_came_first() {
    let mut estimator = estimator();
    (0..400).for_each(|n| hear(made_up(n), 1, n, &mut |next| estimator.handle_own(next)));
    (0..400).for_each(|n| hear(made_up(n), 1, n, &mut |next| estimator.handle_peer(0, next)));
    for number in 1..=50 {
        let at = 10_000 * number;
        hear(OWN, number, at, &mut |next| estimator.handle_peer(0, next));
        hear(PEER, number, at + 300, &mut |next| estimator.handle_own(next));
    }
    let counts = estimator.peers().next().unwrap().1;
    assert_eq!((counts.heard, counts.heard_by_peer), (50, 50));
    estimator.finish(Instant::from_us(1_000_000));
    assert_eq!(estimator.peers().next().unwrap().1.pairs, 50);
}

#[test]
fn with_a_key_a_strangers_answers_replace_no_pair() {
    let mut estimator = estimator();
    estimator.require_key(&Key::new([7; 16]));
    for number in 1..=100 {
        let at = 10_000 * number;
        hear(OWN, number, at, &mut |next| estimator.handle_peer(0, next));
        if number % 2 == 0 {
            // Sooner than the peer, in its name.
            hear(PEER, number, at + 200, &mut |next| estimator.handle_own(next));
        }
        hear(PEER, number, at + 300, &mut |next| estimator.handle_own(next));
        if number % 5 != 0 {
            estimator.handle_confirmed(PEER, number, Instant::ZERO);
        }
    }
    estimator.finish(Instant::from_us(100_000));
    let counts = estimator.peers().next().unwrap().1;
    // Odd numbers that the scheduler has seen answered.
    assert_eq!((counts.pairs, counts.refused.contested), (40, 50));
}
