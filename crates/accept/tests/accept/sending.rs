//! A card that sends, and the driver of another that answers.

use crate::room::failed;
use csi5300::internal::FrameReceiver;
use csi5300::source::{Error, Injector};
use csi5300::time::Instant;
use csi5300_accept::{Collector, Interface, Plan, Report, Sending, Verdict, collect};
use csi5300_sim::{Room, Scene};

/// A driver's treatment of a frame: whether and when it is sent.
pub type Way = fn(Instant) -> Option<Instant>;

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

/// The near robot sends through its interface; the far robot's driver answers frames of the length that the suite sends.
fn sent(far: &str, way: Way) -> Report {
    sent_at(1, 25.0, ["", far], way)
}

/// The same with another seed, another signal to noise, and what is added to either robot.
pub fn sent_at(seed: u64, snr_db: f64, [near, far]: [&str; 2], way: Way) -> Report {
    let text = format!(
        "seed = {seed}\nduration_s = 20.0\ncfo = \"physical\"\n[radio]\nnoise.snr_db = {snr_db:?}\ndelay_ns = 200.0\nphase_noise_rad = 0.1\nturn_around.spread_us = 15.0\n\
         [[robot]]\nname = \"near\"\ncrystal = {{ offset_ppm = -2.0 }}\n{near}\n\
         [[robot]]\nname = \"far\"\nposition_m = [2.0, 1.0, 0.0]\nack_len = 57\ncrystal = {{ offset_ppm = 3.0 }}\n{far}\n"
    );
    let mut room = Room::quiet(&Scene::parse(&text).unwrap()).unwrap();
    let mut interface = Driver { interface: room.interface(0).unwrap(), way };
    let sender = room.mac(0).unwrap();
    let (mut near, mut far) = (room.card(0).unwrap(), room.card(1).unwrap());
    let plan = Plan { at_rest: true, ..Plan::new("108".parse().unwrap()) };
    let mut evidence = collect(&mut near, Some(&mut far), Some(Sending::new(&mut interface, sender)), plan).unwrap();
    // The room's interface reports each frame as sent when it is read.
    while interface.interface.hear().unwrap().is_some() {}
    evidence.interface.confirmed = interface.interface.sent_for_certain();
    evidence.interface.retried = interface.interface.retried();
    evidence.interface.channel_flags = Some(String::new());
    evidence.judge()
}

/// A good driver.
pub fn at_once(now: Instant) -> Option<Instant> {
    Some(now)
}

#[test]
fn sent_frames_are_heard_and_answered() {
    let report = sent("", at_once);
    assert!(failed(&report).is_empty(), "{report}");
    let verdict = |id: &str| report.findings.iter().find(|finding| finding.id == id).unwrap().verdict;
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
        assert_eq!(verdict(id), Verdict::Holds, "{id}\n{report}");
    }
}

#[test]
fn renumbered_frames_are_noticed() {
    let renumbered = sent("faults.card = [\"other_sender\"]", at_once);
    assert!(failed(&renumbered).contains("injection.heard"), "{renumbered}");
}

#[test]
fn the_air_that_frames_use_is_that_of_the_standard() {
    let report = sent("", at_once);
    let pace = report.findings.iter().find(|finding| finding.id == "injection.pace").unwrap();
    let figure = |name: &str| pace.figures.iter().find(|figure| figure.name == name).unwrap().value;
    // HT20 MCS 0: 36 us of preamble, then 57 bytes in 19 symbols of 4 us.
    assert_eq!(figure("air time of a frame"), 112.0, "{pace:?}");
    let percent = figure("air used at the fastest");
    assert!((percent - 11.2).abs() < 0.3 && pace.found.contains("% of the air"), "{percent} {pace:?}");
}

/// The report of an interface whose channel has these flags.
pub fn flagged(flags: Option<&str>) -> Report {
    let mut collector = Collector::new(Plan::new("108".parse().unwrap()));
    collector.interface(Interface { channel_flags: flags.map(str::to_owned), ..Interface::default() });
    collector.finish().judge()
}

#[test]
fn flags_of_the_channel_are_reported() {
    let told = |flags: Option<&str>| {
        let report = flagged(flags);
        report.findings.iter().find(|finding| finding.id == "injection.channel").unwrap().verdict
    };
    assert_eq!([None, Some("(20.0 dBm)")].map(told), [Verdict::NotTried, Verdict::Holds]);
}
