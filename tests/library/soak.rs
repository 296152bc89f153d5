//! An hour of virtual time with strangers, a peer that starts over and over, and a peer that is gone: what is kept does not grow.

use csi5300::exchange::tdma::Key;
use csi5300::pipeline::Options;
use csi5300::pipeline::live::{LiveEstimator, LivePeer, LiveSettings, Track};
use csi5300::source::remote::{Batch, Mailbox};
use csi5300::source::{CsiSource, Next, Origin, Stamps};
use csi5300::time::{Instant, Span};
use csi5300_sim::random::Stream;
use driver_iface::Mac;
use driver_iface::bfee::{Iq, Repr, Wsr};
use driver_iface::record::{Record, code};
use nalgebra::Vector3;

const OWN: Mac = Mac([2, 0, 0, 0, 0, 1]);
const PEER: Mac = Mac([2, 0, 0, 0, 0, 2]);
/// Time between records.
const STEP: Span = Span::from_ms(20);

/// A node's estimator and the mailbox of its peer, on a virtual clock.
struct Node {
    estimator: LiveEstimator,
    mailbox: Mailbox,
    now: Instant,
    count: u16,
    random: Stream,
}

impl Node {
    fn new() -> Self {
        let options = Options::new("108".parse().unwrap());
        let track = || Track::still(Vector3::zeros(), 0.0);
        let peer = LivePeer { name: "peer".into(), mac: PEER, track: track(), yaw_rad: 0.0 };
        let settings = LiveSettings::new(0.054);
        let mut estimator = LiveEstimator::new(OWN, track(), vec![peer], settings, options, Instant::ZERO);
        estimator.require_key(&Key::new([7; 16]));
        let random = Stream::of_seed(0x5300_0050);
        Self { estimator, mailbox: Mailbox::new(1_000), now: Instant::ZERO, count: 0, random }
    }

    fn host_us(&self) -> i64 {
        1_700_000_000_000_000 + self.now.as_us()
    }

    /// A record in the WSR layout of a frame that `sender` numbered.
    fn record(&mut self, sender: Mac, number: u32) -> Vec<u8> {
        self.count = self.count.wrapping_add(1);
        let wsr = Wsr { mac: sender, frame_count: Some(number), ..Wsr::default() };
        let repr = Repr {
            timestamp_low: self.now.as_us() as u32,
            bfee_count: self.count,
            n_rx: 1,
            wsr: Some(wsr),
            ..Repr::default()
        };
        let mut body = vec![0; repr.body_len()];
        repr.emit(&[Iq { i: 40, q: 3 }; 30], &mut body).unwrap();
        body
    }

    /// This robot's card reports a frame.
    fn hears(&mut self, sender: Mac, number: u32) {
        let body = self.record(sender, number);
        let stamps = Stamps { at: self.now, host_us: Some(self.host_us()), origin: Origin::default() };
        self.estimator.handle_own(&Next::Record(stamps, Record { code: code::BFEE, body: &body }));
    }

    /// A message of the peer comes: its card's record of a frame of this robot.
    fn is_told(&mut self, session: u32, item: u64, number: u32) {
        let body = self.record(OWN, number);
        let mut batch = Batch::records(session);
        let _ = batch.number(item);
        batch.push_record(Some(self.host_us()), Record { code: code::BFEE, body: &body });
        self.mailbox.put_at(self.now, &batch.take());
        let mut card = self.mailbox.card();
        while let next @ (Next::Record(..) | Next::Lost(_)) = card.receive(self.now).unwrap() {
            self.estimator.handle_peer(0, &next);
        }
    }

    fn go_on(&mut self) {
        self.now += STEP;
        while self.estimator.poll_report(self.now).is_some() {}
    }

    /// Ten minutes with made-up senders.
    fn flood(&mut self) {
        for step in 0..30_000_u32 {
            for _ in 0..2 {
                let bits = self.random.bits().to_le_bytes();
                let sender = Mac([2, bits[0], bits[1], bits[2], bits[3], bits[4]]);
                self.hears(sender, u32::from_le_bytes([bits[5], bits[6], bits[7], 0]));
            }
            // One of them is the peer by its address, with numbers that no scheduler knows.
            let number = self.random.bits() as u32;
            self.hears(PEER, number);
            self.is_told(step, 0, number);
            self.go_on();
        }
    }

    /// Ten minutes in which the peer starts anew every two seconds, and everything is as it should be between.
    fn crashes(&mut self) {
        for step in 0..30_000_u32 {
            let (session, number) = (1_000_000 + step / 100, 1 + step % 100);
            self.hears(PEER, number);
            self.estimator.handle_confirmed(PEER, number, self.now);
            self.is_told(session, u64::from(number), number);
            self.go_on();
        }
    }

    /// Ten minutes in which the peer is gone.
    fn silence(&mut self) {
        (0..30_000).for_each(|_| self.go_on());
    }
}

#[test]
fn an_hour_of_strangers_crashes_and_silence_leaves_nothing_behind() {
    let mut node = Node::new();
    let mut hour = Vec::new();
    for _ in 0..2 {
        let half = allocation_counter::measure(|| {
            node.flood();
            node.crashes();
            node.silence();
        });
        hour.push(half);
    }
    let counts = node.estimator.peers().next().unwrap().1;
    println!(
        "bytes kept of each half hour: {:?}, {counts:?}",
        hour.iter().map(|h| h.bytes_current).collect::<Vec<_>>()
    );
    assert!(node.now >= Instant::from_us(3_600_000_000));
    assert!(counts.heard >= 120_000 && counts.pairs > 10_000 && counts.refused.unconfirmed > 10_000, "{counts:?}");
    assert!(node.mailbox.counts().sessions > 600, "{:?}", node.mailbox.counts());
    assert!(hour[1].bytes_current.abs() < 64 * 1024, "{} bytes more after the second half hour", hour[1].bytes_current);
    // At its worst it holds no more than at its worst before.
    assert!(hour[1].bytes_max <= hour[0].bytes_max + 64 * 1024, "{} and {}", hour[0].bytes_max, hour[1].bytes_max);
}
