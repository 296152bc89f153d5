//! The room: one card and one odometry for each robot, and their accounts; or a run to its end in memory.

use super::air::Air;
use super::faults::Injected;
use super::motion::{Follower, Pose};
use super::port::{Interface, Odometer, Port, ceil_us, host_us};
use super::refusal::{SceneError, check};
use super::refused;
use super::scene::{Card, Scene};
use super::sounder::{FrameRole, sounder};
use super::world::World;
use csi_formats::feitcsi;
use csi5300::exchange::tdma::PlanError;
use csi5300::internal::lock;
use csi5300::motion::odometry::OdometrySource;
use csi5300::motion::pose::{self, Trajectory};
use csi5300::source::other_card::Translated;
use csi5300::source::replay::Replay;
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::Instant;
use driver_iface::Mac;
use driver_iface::record::Record;
use nalgebra::Vector3;
use std::io::Read;
use std::sync::{Arc, Mutex};

/// A room full of robots.
///
/// Time is virtual: it follows the times at which cards and odometries are called. One thread may drive all robots, or
/// each robot has its own.
#[derive(Debug)]
pub struct Room {
    air: Arc<Mutex<Air>>,
    world: Arc<World>,
    taken: Vec<bool>,
}

impl Room {
    /// A room whose robots sound each other as the scene states, by the TDMA state machine of live cards. Without
    /// `sounding` in the scene it is [`Room::quiet`].
    ///
    /// # Errors
    /// [`RoomError::Scene`] when a value of the scene makes no sense, a trajectory file cannot be read, the sounding does
    /// not fit, or a robot is inside a wall; [`RoomError::Sounding`] when there is no sender for the scene's sounding.
    pub fn new(scene: &Scene) -> Result<Self, RoomError> {
        let world = Self::checked(scene)?;
        // Errors occur for the first robot already.
        sounder(&world, 0, 0, Instant::ZERO)?;
        Ok(Self::in_world(world, true))
    }

    /// A room in which robots send only what is injected through their [`Port`]s (and what a driver with an `ack_len`
    /// answers). The scene's `sounding` has no effect.
    ///
    /// # Errors
    /// [`RoomError::Scene`] as [`Room::new`].
    pub fn quiet(scene: &Scene) -> Result<Self, RoomError> {
        Ok(Self::in_world(Self::checked(scene)?, false))
    }

    fn checked(scene: &Scene) -> Result<Arc<World>, RoomError> {
        let world = World::new(scene)?;
        check(&world)?;
        Ok(Arc::new(world))
    }

    fn in_world(world: Arc<World>, sounds: bool) -> Self {
        let air = Arc::new(Mutex::new(Air::new(Arc::clone(&world), sounds)));
        Self { air, taken: vec![false; world.scene().robot.len()], world }
    }

    /// The scene.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        self.world.scene()
    }

    /// The number of the robot of this name.
    #[must_use]
    pub fn number(&self, name: &str) -> Option<usize> {
        self.scene().robot.iter().position(|robot| robot.name == name)
    }

    /// A robot's card: source and injector. Each is handed out once; `None` the second time, or without such a robot.
    ///
    /// Records are made from then on.
    pub fn card(&mut self, robot: usize) -> Option<Port> {
        let taken = self.taken.get_mut(robot).filter(|taken| !**taken)?;
        *taken = true;
        Some(Port::new(Arc::clone(&self.air), robot))
    }

    /// A robot's monitor interface: frames injected and heard, for a sender outside of the room. `None` without such a
    /// robot, or while it is taken. Frames are kept from then on.
    pub fn interface(&mut self, robot: usize) -> Option<Interface> {
        (robot < self.taken.len()).then(|| Interface::new(Arc::clone(&self.air), robot)).flatten()
    }

    /// Lets time pass, for rooms in which nobody reads records.
    pub fn advance(&mut self, now: Instant) {
        lock(&self.air).advance(now.as_us().saturating_mul(1_000));
    }

    /// The time of the next event, or the room's end; `None` after that.
    #[must_use]
    pub fn next_at(&self) -> Option<Instant> {
        let air = lock(&self.air);
        let at_ns = air.next_ns().or((air.now_ns() < air.end_ns()).then(|| air.end_ns()));
        at_ns.map(ceil_us)
    }

    /// A robot's odometry; `None` without such a robot. Two of the same robot give the same poses, and count twice.
    #[must_use]
    pub fn odometry(&self, robot: usize) -> Option<Odometer> {
        (robot < self.taken.len()).then(|| Odometer::new(Arc::clone(&self.air), robot))
    }

    /// Lets a robot follow `source`, a tenth of a second behind. Its motion in the scene must be `followed`. The
    /// robot's odometry gives its place in the room, so poses and records agree.
    ///
    /// # Errors
    /// When there is no such robot, it has another motion, or it follows a source already.
    pub fn follow(&mut self, robot: usize, source: Box<dyn OdometrySource + Send>) -> Result<(), RoomError> {
        let name = || self.scene().robot.get(robot).map_or("?", |robot| robot.name.as_str()).to_owned();
        let way = self.world.way(robot).ok_or_else(|| {
            refused(format!("robot `{}` follows no poses: its motion in the scene is not `followed`", name()))
        })?;
        if lock(&self.air).follow(Follower::new(robot, Arc::clone(way), source)) {
            Ok(())
        } else {
            Err(refused(format!("robot `{}` follows a source already", name())).into())
        }
    }

    /// A robot's MAC address, if there is such a robot.
    #[must_use]
    pub fn mac(&self, robot: usize) -> Option<Mac> {
        (robot < self.taken.len()).then(|| self.world.mac(robot))
    }

    /// A robot's true pose at true time `t_s` of the scene, if there is such a robot.
    #[must_use]
    pub fn pose(&self, robot: usize, t_s: f64) -> Option<Pose> {
        (robot < self.taken.len()).then(|| self.world.pose(robot, t_s))
    }

    /// The place of a robot's antenna A at true time `t_s`, if there is such a robot.
    #[must_use]
    pub fn antenna(&self, robot: usize, t_s: f64) -> Option<nalgebra::Vector3<f64>> {
        (robot < self.taken.len()).then(|| self.world.antenna(robot, 0, t_s)).flatten()
    }

    /// A robot's wall clock at true time `t_s`, microseconds since the Unix epoch, if there is such a robot.
    #[must_use]
    pub fn host_us(&self, robot: usize, t_s: f64) -> Option<i64> {
        (robot < self.taken.len()).then(|| host_us(&lock(&self.air), robot, (t_s * 1e9).round() as i64))
    }

    pub(super) fn air(&self) -> std::sync::MutexGuard<'_, Air> {
        lock(&self.air)
    }

    /// The account of each robot so far.
    #[must_use]
    pub fn injected(&self) -> Vec<Injected> {
        lock(&self.air).injected().collect()
    }
}

/// One robot's backend, as a real robot has it.
#[derive(Debug)]
pub struct Backend {
    /// Its card: [`csi5300::source::CsiSource`] and [`csi5300::source::Injector`].
    pub card: Port,
    /// Its odometry: [`csi5300::motion::odometry::OdometrySource`].
    pub odometry: Odometer,
}

impl Room {
    /// A robot's backend. Each is handed out once; `None` if its card was taken, or without such a robot.
    pub fn backend(&mut self, robot: usize) -> Option<Backend> {
        let odometry = self.odometry(robot)?;
        Some(Backend { card: self.card(robot)?, odometry })
    }
}

/// Rows per second of true paths, as motion capture gives them.
const TRUTH_HZ: f64 = 200.0;

/// A room that was run to its end.
#[derive(Clone, Debug)]
pub struct Simulation {
    /// Its robots, in the scene's order.
    pub robots: Vec<SimulatedRobot>,
}

/// The log of a robot, and its true path.
#[derive(Clone, Debug)]
pub struct SimulatedRobot {
    /// Its name in the scene.
    pub name: String,
    /// Its card's MAC address.
    pub mac: Mac,
    /// The bytes of its log (a `.dat`, of an AX210 FeitCSI's): the records of exchanges in which it took part.
    pub log: Vec<u8>,
    /// Whole records in it.
    pub records: u64,
    /// The true path of its antenna A, 200 times a second on its host's clock, metres in the scene's frame; `None` if
    /// the scene is too short for two poses.
    pub true_path: Option<Trajectory>,
    /// Its account of faults.
    pub injected: Injected,
}

impl Simulation {
    /// The robot of this name.
    #[must_use]
    pub fn robot(&self, name: &str) -> Option<&SimulatedRobot> {
        self.robots.iter().find(|robot| robot.name == name)
    }
}

impl SimulatedRobot {
    /// Its log as a source of records.
    #[must_use]
    pub fn replay(&self) -> Replay<Box<dyn Read + Send + '_>> {
        let log: &[u8] = &self.log;
        let is_feitcsi = feitcsi::is_log(log);
        let log: Box<dyn Read + Send + '_> = if is_feitcsi { Box::new(Translated::new(log)) } else { Box::new(log) };
        Replay::new(log, format!("the log of {}", self.name))
    }

    /// Where its antenna A was at the start, metres in the scene's frame.
    #[must_use]
    pub fn start_m(&self) -> Option<Vector3<f64>> {
        self.true_path.as_ref()?.poses().first().map(|pose| pose.position_m)
    }
}

impl Room {
    /// Runs the room to its end and keeps all logs in memory, each with the records of its robot's own exchanges.
    ///
    /// # Errors
    /// If somebody reads one of the cards already; [`RoomError::Source`] as a card's
    /// [`CsiSource::receive`].
    pub fn run(self) -> Result<Simulation, RoomError> {
        self.run_while(|_| true)
    }

    /// [`Room::run`] while `go_on` returns true; it gets the scene's time after each event.
    ///
    /// # Errors
    /// As [`Room::run`], and [`RoomError::Stopped`].
    pub fn run_while(mut self, mut go_on: impl FnMut(Instant) -> bool) -> Result<Simulation, RoomError> {
        let is_framed = self.scene().card == Card::Intel5300;
        let mut logs = vec![(Vec::new(), 0); self.scene().robot.len()];
        let keep = |robot: usize, _, _, _, record: &Record<'_>| {
            let Some((log, records)) = logs.get_mut(robot) else { return Ok(()) };
            *records += 1;
            append(log, record, is_framed)
        };
        self.run_cards(keep, |now| match go_on(now) {
            true => Ok(()),
            false => Err(RoomError::Stopped { at_s: now.as_s() }),
        })?;
        let injected = self.injected();
        let robots = logs.into_iter().zip(injected).enumerate().map(|(robot, ((log, records), injected))| {
            let name = self.scene().robot.get(robot).map_or_else(String::new, |state| state.name.clone());
            let mac = self.mac(robot).unwrap_or(Mac::ZERO);
            SimulatedRobot { name, mac, log, records, true_path: self.true_path(robot, TRUTH_HZ), injected }
        });
        Ok(Simulation { robots: robots.collect() })
    }

    /// Reads all cards, as their usual loggers do, to the room's end. `keep` gets each record with the robot that has it, the
    /// frame's role for it, its sender's number and the host's time; `step` gets the scene's time after each event.
    pub(super) fn run_cards(
        &mut self,
        mut keep: impl FnMut(usize, FrameRole, usize, Option<i64>, &Record<'_>) -> Result<(), Error>,
        mut step: impl FnMut(Instant) -> Result<(), RoomError>,
    ) -> Result<(), RoomError> {
        let robots = self.scene().robot.len();
        let mut cards: Vec<Port> = (0..robots).filter_map(|robot| self.card(robot)).collect();
        if cards.len() != robots {
            return Err(refused("a card of this room was taken before; all are needed").into());
        }
        cards.iter_mut().for_each(Port::for_logger);
        let mut now = Instant::ZERO;
        loop {
            let mut next: Option<Instant> = None;
            for (robot, card) in cards.iter_mut().enumerate() {
                loop {
                    match card.receive_with_role(now)? {
                        (role, from, Next::Record(stamps, record)) => keep(robot, role, from, stamps.host_us, &record)?,
                        (.., Next::Lost(_)) => {}
                        (.., Next::Pending) => {
                            next = [next, card.next_at()].into_iter().flatten().min();
                            break;
                        }
                        (.., Next::End(_)) => break,
                    }
                }
            }
            let Some(at) = next else { return Ok(()) };
            now = now.max(at);
            step(now)?;
        }
    }

    /// The true path of a robot's antenna A, start to end, `rate_hz` times a second on its host's clock, metres in the
    /// scene's frame; `None` without such a robot, or if the scene is too short for two poses.
    #[must_use]
    pub fn true_path(&self, robot: usize, rate_hz: f64) -> Option<Trajectory> {
        let rows = (self.scene().duration_s * rate_hz).floor() as usize;
        let pose = |row: usize| {
            let t_s = row as f64 / rate_hz;
            let (position_m, host_us) = (self.antenna(robot, t_s)?, self.host_us(robot, t_s)?);
            let heading_rad = self.pose(robot, t_s).map(|pose| pose.yaw_rad);
            Some(pose::Pose { t_s: host_us as f64 * 1e-6, position_m, heading_rad })
        };
        Trajectory::new((0..=rows).filter_map(pose).collect()).ok()
    }
}

/// Appends a record as its logger does; FeitCSI's has no length before it.
pub(super) fn append(log: &mut Vec<u8>, record: &Record<'_>, is_framed: bool) -> Result<(), Error> {
    if !is_framed {
        log.extend_from_slice(record.body);
        return Ok(());
    }
    let is_written = csi5300::source::append(*record, log);
    is_written.then_some(()).ok_or_else(|| refused("a simulated record is longer than any"))
}

/// Why a room could not be built or used.
#[derive(Debug, thiserror::Error)]
pub enum RoomError {
    /// The scene was refused.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The scene's sounding does not fit.
    #[error(transparent)]
    Sounding(#[from] PlanError),
    /// A run was stopped before the room's end.
    #[error("the run was stopped {at_s:.3} s into the scene")]
    Stopped {
        /// Time of the scene, seconds.
        at_s: f64,
    },
    /// A card or an odometry of the room failed, or a file could not be written.
    #[error(transparent)]
    Source(#[from] csi5300::source::Error),
}

impl From<RoomError> for csi5300::source::Error {
    fn from(error: RoomError) -> Self {
        match error {
            RoomError::Source(error) => error,
            other => Self::Backend(Box::new(other)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Room, RoomError, Scene};
    use csi5300::motion::odometry::NextPose;
    use csi5300::source::{Injector, Loss};
    use csi5300::time::Span;
    use driver_iface::bfee::{Bfee, Layout};
    use driver_iface::mpdu;
    use driver_iface::record::code;
    use proptest::prelude::*;

    #[test]
    fn a_run_ends_when_it_is_told_to() {
        let scene = Scene::parse(
            "duration_s = 36000.0\nsounding.rate_hz = 100\n\
             [[robot]]\nname = \"rx\"\nmotion.circle = { radius_m = 0.3, duration_s = 36000.0 }\n\
             [[robot]]\nname = \"tx\"\nposition_m = [3.0, 1.0, 0.5]\n",
        );
        let room = Room::new(&scene.unwrap()).unwrap();
        let ended = room.run_while(|now| now.as_s() < 0.5);
        assert!(matches!(ended, Err(RoomError::Stopped { at_s }) if (0.5..0.6).contains(&at_s)), "{ended:?}");
    }

    /// A frame as the WSR toolbox sends it: magic addresses, own MAC, big-endian number, `len` bytes with FCS.
    fn frame(mac: [u8; 6], number: u32, len: usize) -> Vec<u8> {
        let mut bytes = vec![0x08, 0, 0xff, 0xff];
        bytes.extend([0x00, 0x16, 0xea, 0x12, 0x34, 0x56].repeat(2));
        bytes.extend(mac);
        bytes.extend([0, 0]);
        bytes.extend(number.to_be_bytes());
        bytes.resize(len - 4, 0x55);
        bytes
    }

    /// Robot 0 of the scene sends one numbered frame every 10 ms, from one again after a restart; the others answer by
    /// their drivers' `ack_len`. The room and the cards of robots 0 and 1.
    fn beaconing(scene: &Scene) -> (Room, [Port; 2]) {
        let mut room = Room::quiet(scene).unwrap();
        let mut cards = [0, 1].map(|robot| room.card(robot).unwrap());
        let (mac, faults) = (room.mac(0).unwrap().0, &scene.robot[0].faults);
        let mut number = 0;
        for tick in 0..=(scene.duration_s * 100.0) as i64 {
            let t_s = tick as f64 / 100.0;
            let is_off = |at_s: &f64| (*at_s..at_s + faults.restart_s).contains(&t_s);
            number = if faults.restart_at_s.iter().any(is_off) { 0 } else { number + 1 };
            cards[0].inject(Instant::from_us(tick * 10_000), &frame(mac, number, 57)).unwrap();
        }
        (room, cards)
    }

    fn two(head: &str, rx: &str, tx: &str) -> Scene {
        let text = format!(
            "duration_s = 10.0\n{head}\n[[robot]]\nname = \"rx\"\n{rx}\n[[robot]]\nname = \"tx\"\n\
             position_m = [-3.858, 0.929, 0.0]\nack_len = 57\n{tx}\n"
        );
        Scene::from_toml(&text).unwrap_or_else(|e| panic!("{e}\n{text}"))
    }

    /// One record, as read.
    #[derive(Clone, Debug, PartialEq)]
    struct Row {
        at: Instant,
        host_us: i64,
        body: Vec<u8>,
    }

    impl Row {
        fn bfee(&self) -> Bfee<'_> {
            Bfee::new_checked(&self.body).unwrap()
        }

        fn number(&self) -> u32 {
            self.bfee().wsr().unwrap().frame_count.unwrap()
        }
    }

    /// Reads a card to its end, as a process does that wakes whenever something comes.
    fn drain(port: &mut Port) -> (Vec<Row>, u64) {
        let (mut rows, mut lost, mut now) = (Vec::new(), 0, Instant::ZERO);
        loop {
            match port.receive(now).unwrap() {
                Next::Record(stamps, record) => {
                    assert_eq!(record.code, code::BFEE);
                    rows.push(Row { at: stamps.at, host_us: stamps.host_us.unwrap(), body: record.body.to_vec() });
                }
                Next::Lost(Loss::Overrun { dropped }) => lost += dropped.unwrap(),
                Next::Lost(other) => panic!("{other:?}"),
                Next::Pending => {
                    let next = port.next_at().unwrap();
                    assert!(next > now, "no progress at {now:?}");
                    now = next;
                }
                Next::End(_) => return (rows, lost),
            }
        }
    }

    /// Runs a beaconing room to its end: records of robots 0 and 1, overruns reported by them, and the room's account.
    fn run(scene: &Scene) -> ([Vec<Row>; 2], [u64; 2], Vec<Injected>) {
        let (room, [mut rx, mut tx]) = beaconing(scene);
        let (rx_rows, rx_lost) = drain(&mut rx);
        let (tx_rows, tx_lost) = drain(&mut tx);
        ([rx_rows, tx_rows], [rx_lost, tx_lost], room.injected())
    }

    #[test]
    fn an_exchange_gives_pairs_in_the_wsr_layout() {
        let scene = two(
            "radio.send_jitter_us = 100.0\n[radio.turn_around]\nspread_us = 20.0",
            "crystal.offset_ppm = 2.0",
            "host_clock = { offset_s = 4.06 }",
        );
        let ([rx, tx], lost, injected) = run(&scene);
        assert_eq!((rx.len(), tx.len(), lost), (1000, 1000, [0, 0]), "the frame of 10.0 s is too late");
        assert_eq!((injected[0].sent, injected[1].sent), (1000, 1000));
        let mut turns_us = Vec::new();
        for (i, (back, forth)) in rx.iter().zip(&tx).enumerate() {
            let (b, f) = (back.bfee(), forth.bfee());
            assert_eq!((b.layout(), back.body.len()), (Layout::Wsr, 230));
            assert_eq!((back.number(), forth.number()), (i as u32 + 1, i as u32 + 1));
            assert_eq!(b.wsr().unwrap().mac.0, [2, 0x53, 0, 0, 0, 1]);
            assert_eq!(f.wsr().unwrap().mac.0, [2, 0x53, 0, 0, 0, 0]);
            assert_eq!((b.bfee_count(), b.noise_dbm(), b.rate_n_flags()), (i as u16 + 1, -127, 0x100));
            let host_apart_us = forth.host_us - back.host_us;
            assert!((4_059_000..4_061_000).contains(&host_apart_us), "{host_apart_us}");
            // The receiver's card clock gains 2 us a second on the other's.
            let gained_us = 2e-6 * f64::from(f.timestamp_low());
            turns_us.push(f64::from(b.timestamp_low()) - f64::from(f.timestamp_low()) - gained_us);
        }
        let mean = turns_us.iter().sum::<f64>() / 1000.0;
        let std = (turns_us.iter().map(|t| (t - mean).powi(2)).sum::<f64>() / 1000.0).sqrt();
        assert!((mean - 225.0).abs() < 3.0 && (std - 20.0).abs() < 2.0, "turn-around {mean} +- {std} us");
    }

    #[test]
    fn the_same_seed_gives_the_same_bytes_whoever_reads_first() {
        let text = "radio.noise.snr_db = 10.0\nradio.phase_noise_rad = 0.1\nradio.delay_std_ns = 30.0\nradio.antenna_order = \"by_rssi\"";
        let scene = two(text, "faults = { loss = 0.1, duplicate = 0.1 }", "");
        let ([rx, tx], ..) = run(&scene);
        let (mut room, [mut rx2, mut tx2]) = beaconing(&scene);
        assert!(room.card(0).is_none(), "each card is handed out once");
        let tx2 = drain(&mut tx2).0;
        assert_eq!((drain(&mut rx2).0, tx2), (rx.clone(), tx));
        let other = Scene { seed: 2, ..scene };
        assert_ne!(run(&other).0[0], rx);
    }

    #[test]
    fn missing_copies_are_not_counted() {
        // Every frame comes twice, 112 and 225 us after its rise at least, but for one: its receiver is switched off between.
        let scene = two("", "", "faults = { duplicate = 1.0, restart_at_s = [5.00015], restart_s = 0.005 }");
        let ([_, tx], _, injected) = run(&scene);
        let numbers: Vec<u32> = tx.iter().map(Row::number).collect();
        let twice = numbers.windows(2).filter(|pair| pair[0] == pair[1]).count() as u64;
        assert_eq!((injected[1].duplicated, injected[1].delivered), (twice, 2 * twice + 1), "{:?}", injected[1]);
    }

    #[test]
    fn after_an_overrun_nothing_comes_until_the_queue_is_empty() {
        let scene = two("", "faults.queue_records = 10", "");
        let (_room, [mut rx, _]) = beaconing(&scene);
        // Half a second without reading: 51 records came, 10 were kept. One is read, then half a second passes again.
        assert!(matches!(rx.receive(Instant::from_us(504_000)).unwrap(), Next::Record(..)));
        let later = Instant::from_us(1_004_000);
        for _ in 0..9 {
            assert!(matches!(rx.receive(later).unwrap(), Next::Record(..)));
        }
        let lost = rx.receive(later).unwrap();
        assert!(matches!(lost, Next::Lost(Loss::Overrun { dropped: Some(91) })), "{lost:?}");
        assert!(matches!(rx.receive(later).unwrap(), Next::Pending));
        assert!(matches!(rx.receive(Instant::from_us(1_014_000)).unwrap(), Next::Record(..)));
    }

    #[test]
    fn a_restart_resets_all_counters() {
        let scene =
            two("", "faults = { restart_at_s = [4.0], restart_s = 1.0 }\ncrystal.clock_start_us = 4000000000", "");
        let ([rx, tx], _, injected) = run(&scene);
        let counts: Vec<u16> = rx.iter().map(|r| r.bfee().bfee_count()).collect();
        let restart = counts.windows(2).position(|w| w[1] < w[0]).unwrap() + 1;
        assert_eq!((counts[restart], rx[restart].number()), (1, 1));
        assert_eq!((rx[0].bfee().timestamp_low() / 1_000, rx[restart].bfee().timestamp_low() / 1_000), (4_000_000, 0));
        assert!(rx[restart].at - rx[restart - 1].at >= Span::from_ms(999));
        assert_eq!(injected[0].restarts, 1);
        assert_eq!(
            tx.iter().filter(|row| row.number() == 1).count(),
            2,
            "the other robot sees the numbers begin again"
        );
    }

    #[test]
    fn the_stock_driver_gives_frame_and_record_in_turn() {
        let scene = two("driver = \"stock\"", "", "");
        let (_room, [mut rx, _]) = beaconing(&scene);
        let now = Instant::from_us(500_000);
        for number in 1..=40 {
            let Next::Record(_, record) = rx.receive(now).unwrap() else { panic!("no frame {number}") };
            assert_eq!(record.code, code::MPDU);
            let frame = mpdu::Repr::parse(record.body).unwrap();
            assert!(mpdu::fcs_is_good(record.body));
            assert_eq!((frame.sounding_counter(), frame.addr3.0[5]), (Some(number), 1));
            let Next::Record(_, record) = rx.receive(now).unwrap() else { panic!("no record {number}") };
            assert_eq!((record.code, Bfee::new_checked(record.body).unwrap().layout()), (code::BFEE, Layout::Stock));
        }
    }

    #[test]
    fn frames_that_overlap_are_lost_and_busy_air_is_waited_for() {
        let scene = two("", "", "");
        let mut room = Room::quiet(&scene).unwrap();
        let (mut a, mut b) = (room.card(0).unwrap(), room.card(1).unwrap());
        let mac = [1; 6];
        // Within the time of channel assessment: neither hears the other.
        a.inject(Instant::from_us(1_000), &frame(mac, 1, 59)).unwrap();
        b.inject(Instant::from_us(1_002), &frame(mac, 2, 59)).unwrap();
        // Later it does, and waits.
        a.inject(Instant::from_us(5_000), &frame(mac, 3, 59)).unwrap();
        b.inject(Instant::from_us(5_050), &frame(mac, 4, 59)).unwrap();
        let (a_rows, b_rows) = (drain(&mut a).0, drain(&mut b).0);
        assert_eq!((a_rows.len(), a_rows[0].number()), (1, 4));
        assert_eq!((b_rows.len(), b_rows[0].number()), (1, 3));
        let injected = room.injected();
        assert_eq!((injected[0].collided, injected[1].collided), (1, 1));
        // Frame 3 is on air for 116 us; DIFS is 34.
        assert!(a_rows[0].bfee().timestamp_low() >= 5_150);
        // What one card is given at once goes out in order.
        let mut room = Room::quiet(&scene).unwrap();
        let (mut a, mut b) = (room.card(0).unwrap(), room.card(1).unwrap());
        for number in 1..=50 {
            a.inject(Instant::ZERO, &frame(mac, number, 59)).unwrap();
        }
        assert_eq!(drain(&mut b).0.iter().map(Row::number).collect::<Vec<_>>(), (1..=50).collect::<Vec<_>>());
        let error = a.inject(Instant::ZERO, &[0; 9]).unwrap_err();
        assert!(error.to_string().contains("9 bytes"), "{error}");
    }

    #[test]
    fn walls_keep_frames_out() {
        let wall = "[[wall]]\nfrom_m = [-2.0, -9.0]\nto_m = [-2.0, 9.0]\n";
        let ([rx, tx], _, injected) = run(&two("", "", wall));
        assert_eq!((rx.len(), tx.len(), injected[1].out_of_reach), (0, 0, 1000));
        let thin = format!("{wall}through_db = 10.0\n");
        let ([rx, _], ..) = run(&two("", "", &thin));
        assert_eq!(rx.len(), 1000);
        // 10 dB less: the gain control compensates.
        let open = run(&two("", "", "")).0;
        assert_eq!(rx[0].bfee().agc(), open[0][0].bfee().agc() + 10);
    }

    #[test]
    fn odometry_is_a_sensor() {
        let circle = "motion.circle = { radius_m = 0.3, duration_s = 10.0 }\n";
        let poses = |sensor: &str| {
            let room = Room::quiet(&two("", &format!("{circle}odometry = {{ {sensor} }}"), "")).unwrap();
            let mut source = room.odometry(0).unwrap();
            let (mut poses, mut now) = (Vec::new(), Instant::ZERO);
            loop {
                match source.receive(now).unwrap() {
                    NextPose::Pose(pose) => poses.push(pose),
                    NextPose::Pending => now = source.next_at().unwrap(),
                    NextPose::NewFrame => panic!("the room has one frame"),
                    NextPose::End => break,
                }
            }
            (poses, room.injected()[0], room)
        };
        let (perfect, counts, room) = poses("rate_hz = 50.0");
        assert_eq!((perfect.len(), counts.poses), (501, 501));
        for (n, pose) in perfect.iter().enumerate() {
            let t_s = n as f64 / 50.0;
            assert!((pose.position_m - room.pose(0, t_s).unwrap().position_m).norm() < 1e-9);
            assert!((pose.t_s - 1.7e9 - t_s).abs() < 1e-6);
        }
        let (scaled, ..) = poses("scale = 1.1");
        let reach = scaled.iter().map(|p| p.position_m.norm()).fold(0.0, f64::max);
        assert!((reach - 0.66).abs() < 1e-3, "{reach}");
        let (turned, ..) = poses("heading_drift_deg_s = 2.0");
        let turn = turned[1000].heading_rad.unwrap() - perfect[500].heading_rad.unwrap();
        assert!((turn - 20f64.to_radians()).abs() < 1e-9, "{turn}");
        let end = turned[1000].position_m.norm();
        assert!(end > 0.03, "a drifting heading does not close the circle: {end} m");
        let (gappy, counts, _) = poses("drop = 0.1, late = 0.1, late_s = 0.05, noise_m = 0.002");
        assert_eq!(gappy.len() as u64 + counts.poses_dropped, 1001);
        let backwards = gappy.windows(2).filter(|w| w[1].t_s < w[0].t_s).count() as u64;
        assert!(counts.poses_late > 50 && backwards > 0 && backwards <= counts.poses_late);
        let rms = gappy.iter().map(|p| p.position_m.z.powi(2)).sum::<f64>() / gappy.len() as f64;
        assert!((rms.sqrt() - 0.002).abs() < 2e-4, "{}", rms.sqrt());
    }

    proptest! {
        /// No injected frame causes a panic, and exactly the frames for which a card reports CSI give records.
        #[test]
        fn any_frame_is_carried(frames in prop::collection::vec((prop::collection::vec(any::<u8>(), 0..90), any::<bool>()), 0..12)) {
            let mut scene = two("", "", "");
            // An answer to a frame of 57 bytes could collide with the next.
            scene.robot[1].ack_len = None;
            let mut room = Room::quiet(&scene).unwrap();
            let (mut a, mut b) = (room.card(0).unwrap(), room.card(1).unwrap());
            let mut with_csi = 0;
            for (mut bytes, magic) in frames {
                if magic && bytes.len() >= 16 {
                    bytes[4..16].copy_from_slice(&[0x00, 0x16, 0xea, 0x12, 0x34, 0x56].repeat(2));
                }
                let sent = a.inject(Instant::ZERO, &bytes).is_ok();
                prop_assert_eq!(sent, bytes.len() >= 24);
                with_csi += usize::from(sent && magic);
            }
            prop_assert_eq!(drain(&mut b).0.len(), with_csi);
        }
    }

    /// A robot `tx`, and `rx` with these lines.
    fn scene(rx: &str) -> Scene {
        let text = format!(
            "duration_s = 10.0\n[[robot]]\nname = \"tx\"\nposition_m = [1.5, 0.0, 0.0]\n[[robot]]\nname = \"rx\"\n{rx}\n"
        );
        Scene::from_toml(&text).unwrap_or_else(|error| panic!("{error}\n{text}"))
    }

    /// `tx` sends frames of these numbers, one every 10 ms.
    fn send(tx: &mut Port, numbers: std::ops::Range<u32>) {
        numbers.for_each(|number| {
            tx.inject(Instant::from_us(i64::from(number) * 10_000), &frame([2, 0x53, 0, 0, 0, 1], number, 57)).unwrap()
        });
    }

    fn sum(of: Injected) -> u64 {
        let lost = of.driver_dropped + of.overrun_records + of.unmeasured;
        of.delivered + of.unheard + of.under_way + of.overheard + lost
    }

    /// The account of a thousand frames, with `rx`'s card read to its end.
    fn counted(scene: &Scene) -> Injected {
        let mut room = Room::quiet(scene).unwrap();
        let (mut tx, mut rx) = (room.card(0).unwrap(), room.card(1).unwrap());
        send(&mut tx, 0..1000);
        let records = drain(&mut rx).0.len() as u64;
        let counts = room.injected()[1];
        assert_eq!((records, sum(counts)), (counts.delivered, counts.received), "{counts}");
        counts
    }

    #[test]
    fn a_frame_that_comes_while_antennas_meet_is_counted_as_such() {
        // It drives over the other's antenna after 5 s, when frame 500 is on air.
        let mut scene = scene("motion.line = { length_m = 3.0, duration_s = 10.0 }");
        let counts = counted(&scene);
        assert_eq!((counts.received, counts.delivered, counts.unmeasured), (1000, 999, 1));
        assert!(counts.to_string().contains("1 without a record because antennas met"), "{counts}");
        // With a second antenna there is no record of that moment either.
        scene.robot[1].antenna_b_m = Some([0.0, 0.5, 0.0]);
        assert_eq!(counted(&scene).unmeasured, 1);
    }

    #[test]
    fn a_frame_of_the_stock_layout_without_its_record_is_counted_once() {
        let mut scene =
            scene("motion.line = { length_m = 3.0, duration_s = 10.0 }\nfaults.card = [\"drops_twentieth\"]");
        scene.driver = crate::scene::Driver::Stock;
        let mut room = Room::quiet(&scene).unwrap();
        let (mut tx, mut rx) = (room.card(0).unwrap(), room.card(1).unwrap());
        send(&mut tx, 0..1000);
        let mut now = Instant::ZERO;
        while !matches!(rx.receive(now).unwrap(), Next::End(_)) {
            now = rx.next_at().unwrap();
        }
        let counts = room.injected()[1];
        assert_eq!((counts.received, sum(counts), counts.unmeasured), (1000, 1000, 1), "{counts}");
        assert!(counts.driver_dropped > 40, "{counts}");
    }

    #[test]
    fn records_of_a_card_that_nobody_has_are_counted_as_unheard() {
        let mut room = Room::quiet(&scene("")).unwrap();
        send(&mut room.card(0).unwrap(), 0..1000);
        room.advance(Instant::from_us(10_000_000));
        let counts = room.injected()[1];
        assert_eq!((counts.received, counts.unheard, counts.delivered), (1000, 1000, 0));
        assert!(counts.to_string().contains("1000 records nobody listened to"), "{counts}");
    }

    #[test]
    fn records_let_go_are_counted_as_unheard_and_those_after_them_come() {
        let mut room = Room::quiet(&scene("")).unwrap();
        let (mut tx, mut rx) = (room.card(0).unwrap(), room.card(1).unwrap());
        send(&mut tx, 0..50);
        // Frame 49 is on its way to the host.
        rx.let_go(Instant::from_us(490_150));
        let counts = room.injected()[1];
        assert_eq!((counts.received, counts.unheard, counts.under_way, counts.delivered), (50, 49, 1, 0));
        send(&mut tx, 50..100);
        assert_eq!(drain(&mut rx).0.len(), 51);
        rx.take_back();
        let counts = room.injected()[1];
        assert_eq!((counts.delivered, counts.unheard, sum(counts)), (50, 50, 100), "the last one reached nobody");
    }
}
