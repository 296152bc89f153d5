//! Tests of the suite: mutants of the card, its driver, the air and the desk, each of which fails its own claims and no
//! others; and healthy cards, which fail none.
#![allow(clippy::unwrap_used, clippy::expect_used, missing_docs)]

use csi5300::internal::FrameReceiver;
use csi5300::source::{Error, Injector, Next, Stamps};
use csi5300::time::Instant;
use csi5300_accept::{
    After, Done, Evidence, Finding, Heard, Plan, Report, Sending, Side, Truth, Verdict, collect, run,
};
use csi5300_sim::{CardFault, Room, Scene};
use driver_iface::bfee::{Antenna, Antennas, Bfee, Iq};
use driver_iface::record::{Record, Step, code, events};
use std::collections::BTreeSet;

/// A fault: its name, additions to the radio and to the two robots, the stated channel, the error of the stated
/// direction in degrees, and the claims that fail.
struct Fault {
    name: String,
    more: &'static str,
    radio: &'static str,
    near: String,
    far: &'static str,
    channel: &'static str,
    off_deg: f64,
    desk: Desk,
    fails: &'static [&'static str],
}

/// The set-up on the desk.
#[derive(Clone, Copy)]
enum Desk {
    /// Two robots sound each other.
    Sounding,
    /// Both are at rest, and the fault starts after this action on the near card.
    After(Done),
    /// Both are at rest; the person should unplug the first antenna, but the second one falls.
    Unplugged(Antenna, Option<Antenna>),
    /// The near robot sends through a faulty driver.
    Sending(Way),
    /// The interface's channel has these flags.
    Flags(&'static str),
}

/// A plan for robots at rest.
fn resting() -> Plan {
    Plan { at_rest: true, ..Plan::new("108".parse().unwrap()) }
}

/// Each fault of the near card, and the claims that fail.
const OF_CARD: [(CardFault, &[&str]); 30] = [
    (CardFault::AntennasSwapped, &["reception.antennas"]),
    (CardFault::AntennasConstant, &["reception.antennas"]),
    (CardFault::RssiSwapped, &["reception.antennas"]),
    (CardFault::AntennasInvalid, &["reception.order"]),
    // The bearing is wrong too, but says so: its 95 % are nearly the whole circle.
    (CardFault::Conjugated, &["phase.cancels", "phase.sign"]),
    (CardFault::SubcarriersShifted, &["reception.subcarriers"]),
    (CardFault::SubcarriersReversed, &["reception.subcarriers"]),
    (CardFault::ClockFast, &["exchange.drift", "phase.cancels"]),
    (CardFault::ClockSteps, &["card.clock", "exchange.late", "exchange.turn_around"]),
    // Poses and frames no longer belong together.
    (CardFault::HostClockSteps, &["host.clock"]),
    (CardFault::NumberRepeated, &["reception.once"]),
    (CardFault::OtherSender, &["exchange.pairs"]),
    (CardFault::LegacyRate, &["reception.rate"]),
    (CardFault::WideTold, &["reception.width"]),
    (CardFault::PhaseJumps, &["phase.cancels"]),
    (CardFault::CarrierNotShared, &["phase.cancels"]),
    (CardFault::NoGain, &["reception.gain"]),
    (CardFault::Saturated, &["reception.level", "reception.saturation"]),
    (CardFault::Faint, &["reception.level"]),
    (CardFault::ChainsToggle, &["reception.chains"]),
    (CardFault::ZeroCsi, &["reception.zero"]),
    (CardFault::StaleCsi, &["phase.cancels", "reception.fresh"]),
    (CardFault::NoTail, &["exchange.pairs", "log.layout"]),
    (CardFault::CutShort, &["log.whole"]),
    (CardFault::DropsTwentieth, &["reception.gaps"]),
    (CardFault::CountStands, &["reception.count"]),
    (CardFault::NoiseFloor, &["reception.noise"]),
    (CardFault::QuarterTurn, &["phase.retune"]),
    (CardFault::HalfTurn, &["phase.reload"]),
    (CardFault::Deaf, &["phase.cancels", "reception.antennas", "reception.snr"]),
];

/// Each other fault of the near robot: its name, what is added to the scene, and the claims that fail.
const OF_ROBOT: [(&str, &str, &[&str]); 6] = [
    ("driver drops one in 20 at random", "faults.driver_drop = 0.05", &["reception.gaps"]),
    ("frames reported twice", "faults.duplicate = 0.2", &["reception.once"]),
    ("a quarter lost on the air", "faults.loss = 0.25", &["exchange.pairs"]),
    (
        "listener stalls",
        "faults = { queue_records = 30, stall_every_s = 3.0, stall_s = 0.5 }",
        &["host.buffer", "reception.gaps"],
    ),
    // Its numbers restart.
    ("card restarts", "faults = { restart_at_s = [7.0], restart_s = 0.5 }", &["card.clock", "exchange.pairs"]),
    ("host clock 160 ppm fast", "host_clock.drift_ppm = 160.0", &["card.rate"]),
];

fn of_card((fault, fails): (CardFault, &'static [&'static str])) -> Fault {
    let near = format!("faults.card = [\"{}\"]", fault.name());
    let on = match fault {
        CardFault::QuarterTurn => Desk::After(Done::Retuned),
        CardFault::HalfTurn => Desk::After(Done::Reloaded),
        _ => Desk::Sounding,
    };
    Fault { near, fails, desk: on, ..desk(&fault.name()) }
}

fn desk(name: &str) -> Fault {
    Fault {
        name: name.into(),
        more: "",
        radio: "",
        near: String::new(),
        far: "",
        channel: "108",
        off_deg: 0.0,
        desk: Desk::Sounding,
        fails: &[],
    }
}

fn all() -> Vec<Fault> {
    let mut all: Vec<Fault> = OF_CARD.map(of_card).into();
    let of_robot = |(name, near, fails): (&str, &str, _)| Fault { near: near.into(), fails, ..desk(name) };
    all.extend(OF_ROBOT.map(of_robot));
    all.extend([
        Fault { more: "cfo = \"off\"", fails: &["phase.crystal"], ..desk("carrier not from the clock's crystal") },
        Fault {
            radio: "turn_around = { spread_us = 20.0, tail = 0.2, tail_us = 3000.0, max_us = 9000.0 }",
            fails: &["exchange.late", "exchange.turn_around"],
            ..desk("answers 3 ms late")
        },
        Fault { channel: "6", fails: &["phase.crystal"], ..desk("channel of another band told") },
        Fault { channel: "108+", fails: &["reception.width"], ..desk("40 MHz told") },
        Fault { off_deg: 90.0, fails: &["truth.bearing"], ..desk("direction told in another frame") },
        Fault {
            radio: "gain.fixed = { lsb_at_1m = 700.0, agc_db = 20 }",
            fails: &["reception.level", "reception.saturation"],
            ..desk("no gain control")
        },
        Fault {
            desk: Desk::Unplugged(Antenna::B, Some(Antenna::A)),
            fails: &["reception.unplugged"],
            ..desk("another antenna falls than was unplugged")
        },
        Fault {
            desk: Desk::Unplugged(Antenna::B, None),
            fails: &["reception.unplugged"],
            ..desk("no antenna falls when one is unplugged")
        },
        Fault {
            desk: Desk::Sending(|_| None),
            fails: &["injection.confirmed", "injection.heard"],
            ..desk("frames vanish before they are sent")
        },
        Fault {
            // A queue that grows: 200 frames a second become 174.
            desk: Desk::Sending(|now| Some(Instant::from_us(now.as_us() + now.as_us() * 15 / 100))),
            fails: &["injection.pace"],
            ..desk("frames wait in a queue")
        },
        Fault {
            desk: Desk::Sending(at_once),
            far: "faults.loss = 0.3",
            fails: &["injection.heard"],
            ..desk("three in ten of the frames sent are not heard")
        },
        Fault {
            desk: Desk::Sending(at_once),
            near: "faults.retry = 0.05".into(),
            fails: &["injection.once", "reception.once"],
            ..desk("the card sends one frame in twenty again")
        },
        Fault {
            desk: Desk::Flags("(20.0 dBm) (no IR, radar detection)"),
            fails: &["injection.channel"],
            ..desk("channel on which nobody may begin to send")
        },
    ]);
    all
}

/// The report of a desk with a fault.
fn report(fault: &Fault) -> Report {
    match fault.desk {
        Desk::Sounding => {
            let radio = format!("noise.snr_db = 25.0\n{}", fault.radio);
            judged(&scene(1, fault.more, &radio, &fault.near, fault.far), fault.channel, fault.off_deg)
        }
        Desk::After(done) => standing(1, 25.0, &[(done, &fault.near)]),
        Desk::Unplugged(told, falls) => unplugged(1, 25.0, told, falls),
        Desk::Sending(way) => sent(1, 25.0, [&fault.near, fault.far], way),
        Desk::Flags(flags) => flagged(Some(flags)),
    }
}

#[test]
fn an_antenna_that_falls_when_it_is_unplugged_has_its_own_name() {
    for antenna in [Antenna::A, Antenna::B] {
        let report = unplugged(1, 25.0, antenna, Some(antenna));
        assert!(failed(&report).is_empty() && report.to_string().contains("reception.unplugged"), "{report}");
    }
}

#[test]
fn every_fault_fails_its_own_claims_and_no_others() {
    // The message names every fault.
    let known = serde_json::from_str::<CardFault>("\"\"").unwrap_err().to_string();
    assert_eq!(known.matches('`').count() / 2 - 1, OF_CARD.len(), "{known}");
    let all = all();
    let judge =
        |faults: &[Fault]| -> Vec<BTreeSet<&str>> { faults.iter().map(|fault| failed(&report(fault))).collect() };
    // On two processors.
    let (first, second) = all.split_at(all.len() / 2);
    let found: Vec<BTreeSet<&str>> = std::thread::scope(|scope| {
        let later = scope.spawn(|| judge(second));
        let mut found = judge(first);
        found.extend(later.join().unwrap());
        found
    });
    let (mut wrong, mut caught) = (Vec::new(), 0);
    for (fault, failed) in all.iter().zip(found) {
        caught += usize::from(!failed.is_empty());
        println!("| {} | {} |", fault.name, failed.iter().copied().collect::<Vec<_>>().join(", "));
        if failed != fault.fails.iter().copied().collect::<BTreeSet<_>>() {
            wrong.push(format!("{}: {failed:?}, expected {:?}", fault.name, fault.fails));
        }
    }
    println!("{caught} of {} faults caught", all.len());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn answers_that_come_unevenly_judge_no_crystal() {
    let late = all().into_iter().find(|fault| fault.name == "answers 3 ms late").unwrap();
    assert_eq!(finding(&report(&late), "phase.crystal").verdict, Verdict::NotTried);
}

#[test]
fn the_order_of_logs_decides_nothing_where_one_card_heard_several_robots() {
    // The first robot hears more of the third than of the second.
    let third = "faults.loss = 0.02\n[[robot]]\nname = \"third\"\nposition_m = [2.0, -1.0, 0.3]\ncrystal = { offset_ppm = 4.0 }";
    let mut room = Room::new(&scene(3, "", "noise.snr_db = 20.0", "", third)).unwrap();
    let (mut first, mut second) = (room.card(0).unwrap(), room.card(1).unwrap());
    let heard = collect(&mut first, Some(&mut second), None, resting()).unwrap();
    let logs = [heard.near.log, heard.far.unwrap().log];
    for order in [[0, 1], [1, 0]] {
        let [near, far] = order.map(|card| Heard::of_log(&logs[card]));
        let mut evidence = Evidence::new(Plan::new("108".parse().unwrap()));
        (evidence.near, evidence.far) = (near, Some(far));
        let report = evidence.judge();
        for id in ["exchange.pairs", "phase.cancels", "phase.sign"] {
            assert_eq!(finding(&report, id).verdict, Verdict::Holds, "{order:?} {:?}", finding(&report, id));
        }
    }
    // The second logger keeps one sender: what its driver counted of the other is no gap.
    let is_of_first = |record: &Record<'_>| {
        let wsr = Bfee::new_checked(record.body).ok().and_then(|bfee| bfee.wsr());
        wsr.is_some_and(|wsr| wsr.mac.0[5] == 0)
    };
    let mut kept = Vec::new();
    for step in events(&logs[1]) {
        if let Step::Record { record, .. } = step
            && is_of_first(&record)
        {
            assert!(csi5300::source::append(record, &mut kept));
        }
    }
    let mut evidence = Evidence::new(Plan::new("108".parse().unwrap()));
    (evidence.near, evidence.far) = (Heard::of_log(&kept), Some(Heard::of_log(&logs[0])));
    let report = evidence.judge();
    let gaps = report.findings.iter().filter(|finding| finding.id == "reception.gaps");
    assert_eq!(gaps.map(|finding| finding.verdict).collect::<Vec<_>>(), [Verdict::NotTried, Verdict::Holds]);
}

#[test]
fn a_healthy_pair_fails_no_claim_and_tries_most() {
    let report = judged(&scene(1, "", "noise.snr_db = 25.0", "", ""), "108", 0.0);
    assert!(failed(&report).is_empty(), "{report}");
    assert!(report.count(Verdict::Holds) >= 50, "{report}");
}

#[test]
fn phases_at_rest_are_the_same_after_retunes_and_a_reload() {
    let retuned = (Done::Retuned, "");
    let report = standing(1, 25.0, &[retuned, retuned, retuned, retuned, retuned, (Done::Reloaded, "")]);
    assert!(failed(&report).is_empty(), "{report}");
    for id in ["phase.retune", "phase.reload", "phase.rest"] {
        let finding = finding(&report, id);
        assert_eq!(finding.verdict, Verdict::Holds, "{id}: {}", finding.found);
    }
}

/// How many desks are judged: as `CSI5300_SEEDS` asks, else the usual number.
fn seeds(usual: u64) -> u64 {
    std::env::var("CSI5300_SEEDS").ok().and_then(|seeds| seeds.parse().ok()).unwrap_or(usual)
}

/// The verdict on a claim, with what it was found by.
fn finding<'a>(report: &'a Report, id: &str) -> &'a Finding {
    report.findings.iter().find(|finding| finding.id == id).unwrap()
}

/// Desks with logs after a retune and a reload, with an antenna that a person unplugs, and with a robot that sends; SNR 10 to 35 dB.
#[test]
fn healthy_desks_of_a_busy_person_raise_no_alarm() {
    let seeds = seeds(4);
    let (mut tried, mut alarms) = (0, Vec::new());
    for seed in 0..seeds {
        let snr = 10.0 + (seed * 7 % 26) as f64;
        let antenna = Antenna::ALL[seed as usize % 3];
        let reports = [
            standing(seed, snr, &[(Done::Retuned, ""), (Done::Reloaded, "")]),
            unplugged(seed, snr, antenna, Some(antenna)),
            sent(seed, snr, [""; 2], at_once),
        ];
        for report in &reports {
            tried += report.findings.len() - report.count(Verdict::NotTried);
            alarms.extend(
                report.failed().map(|finding| format!("seed {seed}, {snr} dB: {} {}", finding.id, finding.found)),
            );
        }
    }
    println!("{} alarms in {tried} verdicts of {seeds} desks\n{}", alarms.len(), alarms.join("\n"));
    assert!(alarms.len() * 1_000 <= tried, "{}", alarms.join("\n"));
}

/// Healthy desks of all kinds: SNR 10 to 35 dB, one to three chains, 20 and 40 MHz, standing and moving, both drivers.
#[test]
fn healthy_desks_raise_no_alarm() {
    let seeds = seeds(24);
    let (mut findings, mut alarms) = (0, Vec::new());
    for seed in 0..seeds {
        let (snr, chains, wide) = (10.0 + (seed * 7 % 26) as f64, 1 + seed % 3, seed % 4 == 3);
        let driver = if seed % 5 == 4 { "driver = \"stock\"\n" } else { "" };
        let width = if wide { "bandwidth_mhz = 40\n" } else { "" };
        let rests = seed % 6 == 5;
        let mut scene =
            scene(seed, &format!("{driver}{width}"), &format!("noise.snr_db = {snr}\nchains = {chains}"), "", "");
        if rests {
            scene.robot[0].motion = Default::default();
        }
        let report = judged(&scene, if wide { "108+" } else { "108" }, 0.0);
        findings += report.findings.len();
        let bad: Vec<String> = report.failed().map(|finding| format!("{} {}", finding.id, finding.found)).collect();
        if !bad.is_empty() {
            alarms.push(format!("seed {seed}, {snr} dB, {chains} chains, wide {wide}: {}", bad.join("; ")));
        }
    }
    println!("{} alarms in {findings} findings of {seeds} desks\n{}", alarms.len(), alarms.join("\n"));
    assert!(alarms.len() * 1_000 <= findings, "{} alarms in {findings} findings:\n{}", alarms.len(), alarms.join("\n"));
}

/// A robot on a circle and one that stands, with every effect of real cards. `more` is added to the scene's first lines, `near` and `far` to the robots.
fn scene(seed: u64, more: &str, radio: &str, near: &str, far: &str) -> Scene {
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
fn judged(scene: &Scene, channel: &str, off_deg: f64) -> Report {
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
fn standing(seed: u64, snr_db: f64, after: &[(Done, &str)]) -> Report {
    let again = |heard: Heard| Heard::of_log(&heard.log);
    let first = at_rest(seed, snr_db, "");
    let mut evidence = Evidence::new(resting());
    (evidence.near, evidence.far) = (again(first.near), first.far.map(again));
    for (later, (done, near)) in (1_000..).zip(after) {
        let later = at_rest(seed + later, snr_db, near);
        evidence.after.push(After { done: *done, near: again(later.near), far: later.far.map(again) });
    }
    evidence.judge()
}

/// Robots at rest; one antenna falls by 20 dB after the person was asked to unplug `told`.
fn unplugged(seed: u64, snr_db: f64, told: Antenna, falls: Option<Antenna>) -> Report {
    let mut evidence = Evidence::new(resting());
    evidence.near = Heard::of_log(&at_rest(seed, snr_db, "").near.log);
    evidence.unplugged.push((told, Heard::default()));
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
        evidence.heard(Side::Near, &Next::Record(stamps, Record { code: code::BFEE, body: &body }));
    }
    evidence.judge()
}

/// Identities of the claims that fail.
fn failed(report: &Report) -> BTreeSet<&'static str> {
    report.findings.iter().filter(|finding| finding.verdict == Verdict::Fails).map(|finding| finding.id).collect()
}

/// A driver's treatment of a frame: whether and when it is sent.
type Way = fn(Instant) -> Option<Instant>;

/// An interface that sends so.
struct Driver {
    interface: csi5300_sim::Interface,
    way: Way,
}

impl Injector for Driver {
    fn inject(&mut self, now: Instant, frame: &[u8]) -> Result<(), Error> {
        // Otherwise its reports on older frames are lost.
        while self.interface.hear()?.is_some() {}
        (self.way)(now).map_or(Ok(()), |at| self.interface.inject(at, frame))
    }
}

/// The near robot sends through its interface; the far robot's driver answers frames of the length that the suite sends. `near` and
/// `far` are added to the robots.
fn sent(seed: u64, snr_db: f64, [near, far]: [&str; 2], way: Way) -> Report {
    let text = format!(
        "seed = {seed}\nduration_s = 20.0\ncfo = \"physical\"\n[radio]\nnoise.snr_db = {snr_db:?}\ndelay_ns = 200.0\nphase_noise_rad = 0.1\nturn_around.spread_us = 15.0\n\
         [[robot]]\nname = \"near\"\ncrystal = {{ offset_ppm = -2.0 }}\n{near}\n\
         [[robot]]\nname = \"far\"\nposition_m = [2.0, 1.0, 0.0]\nack_len = 57\ncrystal = {{ offset_ppm = 3.0 }}\n{far}\n"
    );
    let mut room = Room::quiet(&Scene::parse(&text).unwrap()).unwrap();
    let mut interface = Driver { interface: room.interface(0).unwrap(), way };
    let sender = room.mac(0).unwrap();
    let (mut near, mut far) = (room.card(0).unwrap(), room.card(1).unwrap());
    let mut evidence =
        collect(&mut near, Some(&mut far), Some((Sending::new(sender, Instant::ZERO), &mut interface)), resting())
            .unwrap();
    // The room's interface reports each frame as sent when it is read.
    while interface.interface.hear().unwrap().is_some() {}
    evidence.interface.confirmed = interface.interface.sent_for_certain();
    evidence.interface.retried = interface.interface.retried();
    evidence.interface.channel_flags = Some(String::new());
    evidence.judge()
}

/// A good driver.
fn at_once(now: Instant) -> Option<Instant> {
    Some(now)
}

#[test]
fn sent_frames_are_heard_and_answered() {
    let report = sent(1, 25.0, [""; 2], at_once);
    assert!(failed(&report).is_empty(), "{report}");
    for id in [
        "injection.taken",
        "injection.heard",
        "injection.numbers",
        "injection.once",
        "injection.pace",
        "injection.channel",
        "recorder.same",
        "exchange.pairs",
        "phase.cancels",
        "phase.rest",
    ] {
        assert_eq!(finding(&report, id).verdict, Verdict::Holds, "{id}\n{report}");
    }
    let pace = finding(&report, "injection.pace");
    let figure = |name: &str| pace.figures.iter().find(|figure| figure.name == name).unwrap().value;
    // HT20 MCS 0: 36 us of preamble, then 57 bytes in 19 symbols of 4 us.
    assert_eq!(figure("air time of a frame"), 112.0, "{pace:?}");
    let percent = figure("air used at the fastest");
    assert!((percent - 11.2).abs() < 0.3 && pace.found.contains("% of the air"), "{percent} {pace:?}");
}

#[test]
fn renumbered_frames_are_noticed() {
    let renumbered = sent(1, 25.0, ["", "faults.card = [\"other_sender\"]"], at_once);
    assert!(failed(&renumbered).contains("injection.heard"), "{renumbered}");
}

/// The report of an interface whose channel has these flags.
fn flagged(flags: Option<&str>) -> Report {
    let mut evidence = Evidence::new(Plan::new("108".parse().unwrap()));
    evidence.interface.channel_flags = flags.map(str::to_owned);
    evidence.judge()
}

#[test]
fn flags_of_the_channel_are_reported() {
    let told = |flags: Option<&str>| finding(&flagged(flags), "injection.channel").verdict;
    assert_eq!([None, Some("(20.0 dBm)")].map(told), [Verdict::NotTried, Verdict::Holds]);
}
