//! Robots with AX210s, and robots with two antennas, in virtual time.

use super::robots::{folder, machine, off_deg, run};
use csi5300::pipeline::live::PeerState;
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::Instant;
use csi5300_node::config::Config;
use csi5300_node::machine::{Capture, Machine};
use csi5300_node::sources::{Card, Sources};
use csi5300_sim::{Room, Scene};
use driver_iface::record::{Record, card_clock_ps, code};

const AX210: &str = "duration_s = 26.0\nseed = 5\nchannel = 108\ncard = \"ax210\"\npreamble = \"he\"\ncfo = \"physical\"\n\
    sounding.rate_hz = 60\n\
    [radio]\nnoise.snr_db = 20\nsend_jitter_us = 60\ndelay_ns = 100\ndelay_std_ns = 20\nturn_around.spread_us = 8\n\
    [[robot]]\nname = \"rx\"\nmotion.circle = { radius_m = 0.25, duration_s = 20.0, start_s = 1.0 }\n\
    crystal.clock_start_us = 4294960000\nodometry = { rate_hz = 50.0 }\n\
    [[robot]]\nname = \"tx\"\nposition_m = [7.0, -4.0, 0.0]\ncrystal.offset_ppm = 4.0\nhost_clock = { offset_s = 11.0 }\n";

/// A card that loses records and restarts its clocks.
struct Worse {
    card: Card,
    /// Lost records per 1,000.
    lost: u64,
    /// Number of records after which the card restarts.
    restart_at: u64,
    count: u64,
    seed: u64,
    /// Clock at the restart, microseconds.
    from_us: u32,
    /// True after a lost record of the fine clock; its bfee is lost too.
    losing: bool,
    body: Vec<u8>,
}

impl Worse {
    fn new(card: Card, lost: u64, restart_at: u64, seed: u64) -> Self {
        Self { card, lost, restart_at, count: 0, seed, from_us: 0, losing: false, body: Vec::new() }
    }

    fn is_lost(&mut self) -> bool {
        self.seed ^= self.seed << 13;
        self.seed ^= self.seed >> 7;
        self.seed ^= self.seed << 17;
        self.seed % 1_000 < self.lost
    }
}

impl CsiSource for Worse {
    fn receive(&mut self, now: Instant) -> Result<Next<'_>, Error> {
        let (stamps, code) = loop {
            match self.card.receive(now)? {
                Next::Record(stamps, Record { code, body }) => {
                    self.body.clear();
                    self.body.extend_from_slice(body);
                    if code == code::CARD_CLOCK {
                        assert!(card_clock_ps(&self.body).is_some());
                        self.count += 1;
                        self.losing = self.is_lost();
                    }
                    if !self.losing {
                        break (stamps, code);
                    }
                }
                Next::Lost(loss) => return Ok(Next::Lost(loss)),
                Next::Pending => return Ok(Next::Pending),
                Next::End(tail) => return Ok(Next::End(tail)),
            }
        };
        if code == code::BFEE && self.count >= self.restart_at {
            let clock_us = u32::from_le_bytes(self.body[..4].try_into().unwrap());
            if self.from_us == 0 {
                self.from_us = clock_us - 1_000;
            }
            self.body[..4].copy_from_slice(&clock_us.wrapping_sub(self.from_us).to_le_bytes());
        }
        Ok(Next::Record(stamps, Record { code, body: &self.body }))
    }

    fn next_at(&self) -> Option<Instant> {
        self.card.next_at()
    }
}

#[test]
fn two_ax210s_give_the_true_bearing_despite_losses_and_a_restart() {
    let folder = folder("ax210");
    std::fs::write(folder.join("room.toml"), AX210).unwrap();
    let text = "channel = \"108\"\ncapture.room = { scene = \"room.toml\", robot = \"rx\" }\nodometry.room = {}\n\
                [[peer]]\nname = \"tx\"\nrecords.room = {}\n[estimator]\nrate_hz = 0.5\n";
    let config = Config::read(text, &folder).unwrap_or_else(|error| panic!("{error}"));
    // From the centre of the circle, 25 cm to the left of the start.
    let truth_deg = (-4.25_f64).atan2(7.0).to_degrees();
    for (lost, restart_at, least) in [(0, u64::MAX, 1_300), (300, u64::MAX, 600), (300, 350, 350)] {
        let mut sources = Sources::open(&config, Instant::ZERO, || None, &mut []).unwrap();
        let peer = sources.peers[0].records.take().unwrap();
        sources.peers[0].records = Some(Box::new(Worse::new(peer, lost, restart_at, 77)));
        let plain = |card| Ok(Capture::Plain(Box::new(Worse::new(card, lost, u64::MAX, 99)) as Card));
        let machine =
            Machine::new(sources, plain, config.estimator_settings(), config.options(), Instant::ZERO).unwrap();
        let (reports, last) = run(machine, Instant::from_us(25_000_000));
        let (off, report) = (off_deg(&last[0], truth_deg), &last[0]);
        println!("{lost} lost of 1,000, restart at {restart_at}: {off:.3} deg off, {} pairs", report.answer.pairs);
        assert!(report.state == PeerState::Bearing && off < 0.2, "{off} {report:?}");
        assert!(report.answer.pairs >= least && report.answer.compensated, "{report:?}");
        assert!(reports.iter().any(|(at, _, report)| at.as_s() < 12.0 && report.state == PeerState::Bearing));
    }
}

fn two_antennas(more: &str) -> String {
    format!(
        "channel = \"108\"\ncapture.room = {{ scene = \"two-antennas\", robot = \"rx\" }}\nodometry.room = {{}}\n\
         [array]\nantennas = [\"A\", \"B\"]\nbaselines_m = [[0.10, 0.0, 0.0]]\n{more}"
    )
}

#[test]
fn a_turning_robot_has_a_bearing_of_each_sender() {
    let folder = folder("two-antennas");
    let room = Room::new(&Scene::find("two-antennas".as_ref()).unwrap()).unwrap();
    let truth_deg = 5.0_f64.atan2(3.0).to_degrees();
    for (more, name) in [("", "02:53:00:00:00:02"), ("[[peer]]\nname = \"tx\"\nrecords.heard = {}\n", "tx")] {
        let config = Config::read(&two_antennas(more), &folder).unwrap_or_else(|error| panic!("{error}"));
        let (reports, last) = run(machine(&config), Instant::from_us(12_000_000));
        let [report] = &last[..] else { panic!("{last:?}") };
        let off = off_deg(report, truth_deg);
        println!("{name}: {off:.3} deg off, +- {:?}, {} records", report.answer.azimuth_sd_deg, report.answer.pairs);
        assert_eq!((report.answer.link.as_str(), report.state), (name, PeerState::Bearing));
        assert_eq!(report.answer.mac.as_deref(), Some(room.mac(1).unwrap().to_string().as_str()));
        assert!(off < 0.5 && off < 3.0 * report.answer.azimuth_sd_deg.unwrap(), "{off} {report:?}");
        assert_eq!(report.answer.chain_constants_deg.len(), 1);
        let words: Vec<&str> = reports.iter().map(|(.., report)| report.words.as_str()).collect();
        assert!(words.iter().any(|words| words.starts_with("not yet: turned")), "{words:?}");
        let made = reports.iter().filter(|(.., report)| report.state == PeerState::Bearing).count();
        assert!(made >= 12, "{made} {words:?}");
    }
}

#[test]
fn a_standing_robot_has_a_bearing_with_the_chain_constant_of_an_earlier_turn() {
    let folder = folder("two-antennas-stand");
    let config = Config::read(&two_antennas(""), &folder).unwrap();
    let (_, last) = run(machine(&config), Instant::from_us(12_000_000));
    let [deg, sd_deg] = last[0].answer.chain_constants_deg[0];
    let known = two_antennas(&format!("chain_constants_deg = [[{deg:?}, {sd_deg:?}]]\n"));
    let config = Config::read(&known, &folder).unwrap_or_else(|error| panic!("{error}"));
    // Before the turn.
    let (_, last) = run(machine(&config), Instant::from_us(900_000));
    let truth_deg = 5.0_f64.atan2(3.0).to_degrees();
    // The mirror, and the grating lobes of a baseline longer than half a wavelength, are candidates too.
    let off = |azimuth_deg: f64| csi5300::maths::wrap_rad((azimuth_deg - truth_deg).to_radians()).to_degrees().abs();
    let nearest = last[0].answer.candidates.iter().map(|own| off(own.azimuth_deg)).fold(f64::MAX, f64::min);
    println!("standing: nearest candidate {nearest:.2} deg off of {}", last[0].answer.candidates.len());
    assert!(last[0].state == PeerState::Bearing && nearest < 3.0, "{:?}", last[0]);
}

#[test]
fn antennas_and_answers_of_a_peer_are_combined() {
    let folder = folder("two-antennas-both");
    let text = two_antennas("[[peer]]\nname = \"tx\"\nrecords.room = {}\n[estimator]\nleast_motion_m = 0.02\n");
    let scene = std::fs::read_to_string(crate::common::root().join("scenes/two-antennas.toml")).unwrap();
    std::fs::write(folder.join("room.toml"), scene.replace("radius_m = 0.0", "radius_m = 0.05")).unwrap();
    let text = text.replace("scene = \"two-antennas\"", "scene = \"room.toml\"");
    let config = Config::read(&text, &folder).unwrap_or_else(|error| panic!("{error}"));
    let (_, last) = run(machine(&config), Instant::from_us(12_000_000));
    let [report] = &last[..] else { panic!("{last:?}") };
    let [two, one] = report.answer.kinds_deg[..] else { panic!("{report:?}") };
    let off = off_deg(report, 5.0_f64.atan2(3.0).to_degrees());
    println!("{two:?} from answers, {one:?} from antennas, combined {off:.2} deg off");
    assert!(report.state == PeerState::Bearing && off < 1.0, "{off} {report:?}");
    assert!(report.answer.azimuth_sd_deg.unwrap() < 1.1 * two[1].min(one[1]) + 0.02, "{report:?}");
}
