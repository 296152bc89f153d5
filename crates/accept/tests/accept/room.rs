//! Rooms for the suite.

use csi5300::source::{Next, Stamps};
use csi5300_accept::{Collector, Done, Evidence, Plan, Report, Side, Truth, Verdict, collect, run};
use csi5300_sim::{Room, Scene};
use driver_iface::bfee::{Antenna, Antennas, Iq};
use driver_iface::record::{Record, code};
use std::collections::BTreeSet;

/// A robot on a circle and one that stands, with every effect of real cards. `more` is added to the scene's first lines, `near` and `far` to the robots.
pub fn scene(seed: u64, more: &str, radio: &str, near: &str, far: &str) -> Scene {
    let cfo = if more.contains("cfo") { "" } else { "cfo = \"physical\"\n" };
    let agc = if radio.contains("gain") { "" } else { "gain.agc = { lsb_std_db = 0.4, agc_std_db = 0.7 }\n" };
    let turn_around =
        if radio.contains("turn_around") { "" } else { "turn_around = { median_us = 225.0, spread_us = 20.0 }\n" };
    let host_clock = if near.contains("host_clock") { "" } else { "host_clock = { drift_ppm = 6.0 }\n" };
    let text = format!(
        "seed = {seed}\n{cfo}duration_s = 15.0\nchannel = 108\nreflections = 1\n{more}\n\
         [sounding]\nrate_hz = 100.0\n\
         [radio]\nphase_noise_rad = 0.1\ndelay_ns = 200.0\ndelay_std_ns = 18.0\nantenna_order = \"by_rssi\"\nsend_jitter_us = 60.0\n\
         host_latency_us = 120.0\nhost_latency_std_us = 55.0\n{agc}\
         {turn_around}{radio}\n\
         [[robot]]\nname = \"rx\"\nposition_m = [0.0, 0.0, 0.3]\nantenna_m = [0.0, 0.0, 0.0]\nantenna_b_m = [0.02, 0.12, 0.0]\nantenna_c_m = [0.1, -0.1, 0.0]\n\
         motion.circle = {{ radius_m = 0.3, duration_s = 14.0, start_s = 0.5 }}\ncrystal = {{ offset_ppm = -2.0 }}\n{host_clock}{near}\n\
         [[robot]]\nname = \"tx\"\nposition_m = [3.0, 2.0, 0.3]\nantenna_b_m = [0.0, 0.1, 0.0]\nantenna_c_m = [0.0, -0.1, 0.0]\ncrystal = {{ offset_ppm = -5.0 }}\n\
         host_clock = {{ drift_ppm = 3.0 }}\n{far}\n\
         [[wall]]\nfrom_m = [-3.0, -2.0]\nto_m = [-3.0, 4.0]\nloss_db = 4.0\n\
         [[wall]]\nfrom_m = [-3.0, 5.0]\nto_m = [6.0, 5.5]\nloss_db = 5.0\n"
    );
    Scene::parse(&text).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

/// The report on a scene whose first two robots are the cards. `off_deg` is added to the stated direction.
pub fn judged(scene: &Scene, channel: &str, off_deg: f64) -> Report {
    let mut room = Room::new(scene).unwrap();
    let mut plan = Plan::new(channel.parse().unwrap());
    let (from, to) = (room.antenna(0, 0.5 * scene.duration_s).unwrap(), room.antenna(1, 0.0).unwrap());
    // A circle's mean position is its centre.
    let trajectory = room.true_path(0, 100.0).unwrap();
    let mean = trajectory.poses().iter().map(|pose| pose.position_m).sum::<nalgebra::Vector3<f64>>()
        / trajectory.poses().len() as f64;
    let towards = to - if scene.robot[0].motion == csi5300_sim::motion::RobotMotion::default() { from } else { mean };
    plan.truth = Some(Truth { trajectory, azimuth_rad: towards.y.atan2(towards.x) + off_deg.to_radians() });
    plan.at_rest = scene.robot.iter().all(|robot| robot.motion == csi5300_sim::motion::RobotMotion::default());
    let (mut near, mut far) = (room.card(0).unwrap(), room.card(1).unwrap());
    run(&mut near, Some(&mut far), plan).unwrap()
}

/// Both cards' data of robots at rest; `near` is added to the first one.
fn at_rest(seed: u64, snr_db: f64, near: &str) -> Evidence {
    let mut scene = scene(seed, "", &format!("noise.snr_db = {snr_db:?}\nchains = 3"), near, "");
    scene.robot[0].motion = Default::default();
    let mut room = Room::new(&scene).unwrap();
    let (mut near, mut far) = (room.card(0).unwrap(), room.card(1).unwrap());
    collect(&mut near, Some(&mut far), None, Plan::new("108".parse().unwrap())).unwrap()
}

/// Robots at rest: their first logs, then those after each step, each with an addition to the near robot.
pub fn standing(seed: u64, snr_db: f64, after: &[(Done, &str)]) -> Report {
    let mut collector = Collector::new(Plan { at_rest: true, ..Plan::new("108".parse().unwrap()) });
    let first = at_rest(seed, snr_db, "");
    collector.log(Side::Near, &first.near.log);
    collector.log(Side::Far, &first.far.unwrap().log);
    for (later, (done, near)) in (1_000..).zip(after) {
        let later = at_rest(seed + later, snr_db, near);
        collector.after(*done, &later.near.log, later.far.as_ref().map(|far| far.log.as_slice()));
    }
    collector.finish().judge()
}

/// Robots at rest; one antenna falls by 20 dB after the person was asked to unplug `told`.
pub fn unplugged(seed: u64, snr_db: f64, told: Antenna, falls: Option<Antenna>) -> Report {
    let mut collector = Collector::new(Plan { at_rest: true, ..Plan::new("108".parse().unwrap()) });
    collector.log(Side::Near, &at_rest(seed, snr_db, "").near.log);
    collector.unplugged(told);
    for record in at_rest(seed + 1_000, snr_db, "").near.records {
        let antennas = Antennas::new(record.head.antenna_sel, record.head.n_rx, record.head.rssi).unwrap();
        let chain = falls.and_then(|antenna| antennas.chain_of(antenna));
        let mut csi = record.csi;
        for (k, iq) in csi.iter_mut().enumerate().filter(|(k, _)| Some(k % 3) == chain) {
            // What is left of it is noise.
            *iq = Iq { i: iq.i / 10 + (k % 2) as i8, q: iq.q / 10 };
        }
        let mut body = vec![0; record.head.body_len()];
        record.head.emit(&csi, &mut body).unwrap();
        let stamps = Stamps { host_us: record.host_us, ..Stamps::default() };
        collector.heard(Side::Near, &Next::Record(stamps, Record { code: code::BFEE, body: &body }));
    }
    collector.finish().judge()
}

/// Identities of the claims that fail.
pub fn failed(report: &Report) -> BTreeSet<&'static str> {
    report.findings.iter().filter(|finding| finding.verdict == Verdict::Fails).map(|finding| finding.id).collect()
}
