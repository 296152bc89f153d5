//! Mutants of the card, its driver, the air and the desk: each fault fails its own claims and no others.

use crate::room::{failed, judged, scene, standing, unplugged};
use crate::sending::{Way, at_once, flagged, sent_at};
use csi5300::time::Instant;
use csi5300_accept::{Done, Report};
use csi5300_sim::CardFault;
use driver_iface::bfee::Antenna;
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

/// A fault of the near card, and the claims that fail.
fn of_card(fault: CardFault) -> Fault {
    let fails: &[&str] = match fault {
        CardFault::AntennasSwapped | CardFault::AntennasConstant | CardFault::RssiSwapped => &["reception.antennas"],
        CardFault::AntennasInvalid => &["reception.order"],
        // The bearing is wrong too: conjugated, a motion looks like its opposite.
        CardFault::Conjugated => &["phase.cancels", "phase.sign", "truth.bearing"],
        CardFault::SubcarriersShifted | CardFault::SubcarriersReversed => &["reception.subcarriers"],
        CardFault::ClockFast => &["exchange.drift", "phase.cancels"],
        CardFault::ClockSteps => &["card.clock", "exchange.late", "exchange.turn_around"],
        // Poses and frames no longer belong together.
        CardFault::HostClockSteps => &["host.clock", "truth.bearing"],
        CardFault::NumberRepeated => &["reception.once"],
        CardFault::OtherSender => &["exchange.pairs"],
        CardFault::LegacyRate => &["reception.rate"],
        CardFault::WideTold => &["reception.width"],
        CardFault::PhaseJumps | CardFault::CarrierNotShared => &["phase.cancels"],
        CardFault::NoGain => &["reception.gain"],
        CardFault::Saturated => &["reception.level", "reception.saturation"],
        CardFault::Faint => &["reception.level"],
        CardFault::ChainsToggle => &["reception.chains"],
        CardFault::ZeroCsi => &["reception.zero"],
        CardFault::StaleCsi => &["phase.cancels", "reception.fresh"],
        CardFault::NoTail => &["exchange.pairs", "log.layout"],
        CardFault::CutShort => &["log.whole"],
        CardFault::DropsTwentieth => &["reception.gaps"],
        CardFault::CountStands => &["reception.count"],
        CardFault::NoiseFloor => &["reception.noise"],
        CardFault::QuarterTurn => &["phase.retune"],
        CardFault::HalfTurn => &["phase.reload"],
        CardFault::Deaf => &["phase.cancels", "reception.antennas", "reception.snr"],
    };
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
    let mut all: Vec<Fault> = CardFault::ALL.map(of_card).into();
    all.extend([
        Fault {
            near: "faults.driver_drop = 0.05".into(),
            fails: &["reception.gaps"],
            ..desk("driver drops one in 20 at random")
        },
        Fault { near: "faults.duplicate = 0.2".into(), fails: &["reception.once"], ..desk("frames reported twice") },
        Fault { near: "faults.loss = 0.25".into(), fails: &["exchange.pairs"], ..desk("a quarter lost on the air") },
        Fault {
            near: "faults = { queue_records = 30, stall_every_s = 3.0, stall_s = 0.5 }".into(),
            fails: &["host.buffer", "reception.gaps"],
            ..desk("listener stalls")
        },
        Fault {
            near: "faults = { restart_at_s = [7.0], restart_s = 0.5 }".into(),
            // Its numbers restart.
            fails: &["card.clock", "exchange.pairs"],
            ..desk("card restarts")
        },
        Fault { near: "host_clock.drift_ppm = 160.0".into(), fails: &["card.rate"], ..desk("host clock 160 ppm fast") },
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
        Desk::Sending(way) => sent_at(1, 25.0, [&fault.near, fault.far], way),
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
