//! A card that sends, and the driver of another that answers.

use crate::room::failed;
use csi5300_accept::{Plan, Report, Sending, Verdict, run_sending};
use csi5300_sim::{Room, Scene};

/// The near robot sends through its interface; the far robot's driver answers frames of the length that the suite sends.
fn sent(far: &str) -> Report {
    let text = format!(
        "duration_s = 20.0\ncfo = \"physical\"\n[radio]\nnoise.snr_db = 25.0\ndelay_ns = 200.0\nphase_noise_rad = 0.1\nturn_around.spread_us = 15.0\n\
         [[robot]]\nname = \"near\"\ncrystal = {{ offset_ppm = -2.0 }}\n\
         [[robot]]\nname = \"far\"\nposition_m = [2.0, 1.0, 0.0]\nack_len = 57\ncrystal = {{ offset_ppm = 3.0 }}\n{far}\n"
    );
    let mut room = Room::quiet(&Scene::parse(&text).unwrap()).unwrap();
    let mut interface = room.interface(0).unwrap();
    let sender = room.mac(0).unwrap();
    let (mut near, mut far) = (room.card(0).unwrap(), room.card(1).unwrap());
    let plan = Plan { at_rest: true, ..Plan::new("108".parse().unwrap()) };
    run_sending(&mut near, Some(&mut far), Sending::new(&mut interface, sender), plan).unwrap()
}

#[test]
fn what_is_sent_is_heard_and_answered() {
    let report = sent("");
    assert!(failed(&report).is_empty(), "{report}");
    let verdict = |id: &str| report.findings.iter().find(|finding| finding.id == id).unwrap().verdict;
    for id in [
        "injection.taken",
        "injection.heard",
        "injection.numbers",
        "recorder.same",
        "exchange.pairs",
        "phase.cancels",
        "phase.rest",
    ] {
        assert_eq!(verdict(id), Verdict::Holds, "{id}\n{report}");
    }
}

#[test]
fn frames_that_are_lost_or_renumbered_are_noticed() {
    let lost = sent("faults.loss = 0.3");
    assert!(failed(&lost).contains("injection.heard"), "{lost}");
    let renumbered = sent("faults.card = [\"other_sender\"]");
    assert!(failed(&renumbered).contains("injection.heard"), "{renumbered}");
}
