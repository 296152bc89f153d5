//! Live bearings: products from the card's records and the measurements in the answers, as good as from both logs.

use crate::common::{RECEIVER, TRANSMITTER, link};
use csi5300::motion::odometry::csv;
use csi5300::pipeline::Options;
use csi5300::pipeline::live::LiveEstimator;
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::survey::Survey;
use csi5300::source::{Next, Stamps};
use csi5300_live::sounding::{measurement, products};
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use driver_iface::record::{Record, code};
use driver_iface::sounding::{Frame, native};
use std::collections::VecDeque;

/// An answer that carries `measurement`, over the air and back.
fn carried(measurement: native::Measurement) -> native::Measurement {
    let repr = native::Repr {
        sender: TRANSMITTER,
        number: measurement.number + 1,
        role: native::Role::Backward,
        destination: RECEIVER,
        next: RECEIVER,
        wants_turn: false,
        session: 1,
        sender_session: 1,
        turn: 1,
        left: 0,
        slot: 1,
        round_us: 10_000,
        slots: 1,
        measurement: Some(measurement),
        tag: None,
    };
    let mut buffer = [0; native::MAX_LEN];
    let len = repr.emit(&mut buffer).unwrap();
    native::Repr::parse(&Frame::new_checked(&buffer[..len]).unwrap()).unwrap().measurement.unwrap()
}

#[test]
fn products_from_answers_give_the_bearing() {
    let truth_rad = 2.0_f64;
    let made = link(600, truth_rad);
    let (trajectory, _) = csv::parse(made.trajectory.as_bytes(), None).unwrap();
    let options = Options::new(Channel::new(108, Width::Ht20).unwrap());
    let mut products = products(&[Mac([9; 6]), TRANSMITTER], options);
    let mut responder = Survey::default();
    // The responder's card reports a frame some exchanges later than it answers it.
    let mut under_way = VecDeque::new();
    for (k, (rx, tx)) in made.rx.iter().zip(&made.tx).enumerate() {
        let record = |bytes| Next::Record(Stamps::default(), Record { code: code::BFEE, body: bytes });
        let next = record(&tx[3..]);
        let (bfee, identity) = responder.note(&next).unwrap();
        let lost = k % 11 == 3;
        under_way.extend(measurement(&bfee, &identity, Antenna::A).filter(|_| !lost));
        assert_eq!(measurement(&bfee, &identity, Antenna::A).unwrap().number, k as u32 + 1);
        products.handle_own(&record(&rx[3..]));
        if under_way.len() > 3 {
            products.handle_measurement(TRANSMITTER, &carried(under_way.pop_front().unwrap()));
        }
    }
    let made = products.links().bearings(&trajectory);
    // One that never answered has no product, and no bearing.
    assert_eq!(made.len(), 1);
    let (mac, pairs, bearing) = &made[0];
    assert_eq!(*mac, TRANSMITTER);
    assert!(*pairs >= 540, "{pairs}");
    let error_deg = (bearing.as_ref().unwrap().answer.azimuth_rad - truth_rad).to_degrees();
    assert!(error_deg.abs() < 0.1, "{error_deg}");
    // What another antenna measured does not belong to these products.
    let mut other = under_way.pop_front().unwrap();
    other.rx_antenna = 2;
    let used = |products: &LiveEstimator| products.peers().next().unwrap().1.heard_by_peer;
    let before = used(&products);
    products.handle_measurement(TRANSMITTER, &other);
    assert_eq!((used(&products), products.other_antenna()), (before, 1));
}
