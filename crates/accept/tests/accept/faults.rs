//! Mutants of the card, its driver, the air and the desk: each fault fails its own claims and no others.

use crate::room::{failed, judged, scene, standing, unplugged};
use csi5300_accept::Done;
use csi5300_sim::CardFault;
use driver_iface::bfee::Antenna;
use std::collections::BTreeSet;

/// A fault: its name, what it adds to the radio and to the two robots, what is told of the channel and by how many degrees the direction is told
/// wrongly, and the claims that fail.
struct Fault {
    name: String,
    more: &'static str,
    radio: &'static str,
    near: String,
    far: &'static str,
    channel: &'static str,
    off_deg: f64,
    /// Both robots stand still, and the fault begins after this was done to the near card.
    after: Option<Done>,
    fails: &'static [&'static str],
}

/// A fault of the near card, and the claims that fail.
fn of_card(fault: CardFault) -> Fault {
    let fails: &[&str] = match fault {
        CardFault::AntennasSwapped | CardFault::AntennasConstant | CardFault::RssiSwapped => &["reception.antennas"],
        CardFault::AntennasInvalid => &["reception.order"],
        // Beside the phases the bearing is wrong: conjugated, a motion looks like its opposite.
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
    let after = match fault {
        CardFault::QuarterTurn => Some(Done::Retuned),
        CardFault::HalfTurn => Some(Done::Reloaded),
        _ => None,
    };
    Fault { near, fails, after, ..desk(&fault.name()) }
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
        after: None,
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
            // Its numbers begin anew.
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
    ]);
    all
}

#[test]
fn a_chain_that_is_named_wrongly_does_not_fall_with_its_antenna() {
    let (a, b) = (Antenna::A, Antenna::B);
    for (told, falls, fails) in [(b, Some(b), false), (a, Some(a), false), (b, Some(a), true), (b, None, true)] {
        let report = unplugged(1, 25.0, told, falls);
        let expected = fails.then_some("reception.unplugged");
        assert_eq!(failed(&report), expected.into_iter().collect(), "{told:?} {falls:?} {report}");
        assert!(fails || report.to_string().contains("reception.unplugged"), "{report}");
    }
}

#[test]
fn every_fault_fails_its_own_claims_and_no_others() {
    let (mut wrong, mut caught) = (Vec::new(), 0);
    let all = all();
    for fault in &all {
        let scene = scene(1, fault.more, &format!("noise.snr_db = 25.0\n{}", fault.radio), &fault.near, fault.far);
        let report = match fault.after {
            None => judged(&scene, fault.channel, fault.off_deg),
            Some(done) => standing(1, 25.0, &[(done, &fault.near)]),
        };
        let failed = failed(&report);
        caught += usize::from(!failed.is_empty());
        println!("| {} | {} |", fault.name, failed.iter().copied().collect::<Vec<_>>().join(", "));
        if failed != fault.fails.iter().copied().collect::<BTreeSet<_>>() {
            wrong.push(format!("{}: {failed:?}, expected {:?}", fault.name, fault.fails));
        }
    }
    println!("{caught} of {} faults caught", all.len());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
