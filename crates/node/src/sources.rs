//! What a configuration names, opened.

use crate::adapters::Adapter;
use crate::config::{self, CameraMount, Capture, Config, Feitcsi, Odometry, Peer as PeerConfig, Records};
use crate::refused;
use crate::threads::{CardThread, PoseThread};
use csi5300::internal::Roller;
use csi5300::motion::odometry::csv::{self, CsvError};
use csi5300::motion::odometry::ros::Stamp;
use csi5300::motion::odometry::{NextPose, OdometrySource, Replayed, SourceCounts};
use csi5300::motion::pose::Pose;
use csi5300::pipeline::Array;
use csi5300::pipeline::live::{LivePeer, Track};
use csi5300::source::replay::{Paced, Replay};
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::{Instant, Span};
use csi5300_live::feitcsi::{FeitCsi, Frames};
use csi5300_live::netlink::{self, Netlink};
use csi5300_live::serial::Serial;
use csi5300_live::stock::{self, Stock};
use csi5300_live::wait::wall_us;
use csi5300_sim::Room;
use csi5300_sim::served::{self, Address, Role};
use driver_iface::Mac;
use nalgebra::Vector3;
use std::collections::HashMap;
use std::os::fd::AsFd;
use std::path::Path;
use std::sync::Arc;
use tokio::sync::Notify;

/// Records of a log in which a host time is looked for.
const LOOKED_AT: usize = 4_096;
/// Frames at the start of a log that are searched for a common one.
const FRAMES: usize = 4_096;
/// Records and time by which logs may be apart without being moved, because records wait for their partners.
const RECORDS: usize = 1_024;
const APART: Span = Span::from_ms(5_000);

/// A source of records that may move to another thread.
pub type Card = Box<dyn CsiSource + Send>;
/// A source of poses that may move to another thread.
pub type Poses = Box<dyn OdometrySource + Send>;

/// One peer's sources. What comes over the network or with answers has none here.
pub struct PeerSources {
    /// What the estimator knows of it.
    pub peer: LivePeer,
    /// Its records.
    pub records: Option<Card>,
    /// Its poses.
    pub poses: Option<Poses>,
    /// It does not answer: its bearing is that of the array.
    pub is_heard_only: bool,
    /// Its records come over a network, which does not signal their end.
    pub open_ended: bool,
    /// Times that its poses changed to another frame.
    pub new_frames: u64,
}

/// Everything that a configuration names.
pub struct Sources {
    /// This robot's MAC.
    pub own: Mac,
    /// This robot's records.
    pub capture: Card,
    /// The records are those of a card now, not of a log or a room of this process.
    pub is_live: bool,
    /// This robot's poses.
    pub poses: Option<Poses>,
    /// Its place, if it never moves.
    pub track: Track,
    /// The peers.
    pub peers: Vec<PeerSources>,
    /// The antennas for bearings of what is heard alone.
    pub array: Option<Array>,
    /// How the trajectory files were read.
    pub trajectories: Trajectories,
    /// Times real time.
    pub speed: f64,
}

/// How trajectory files were read.
#[derive(Default)]
pub struct Trajectories {
    /// What was skipped, sorted or spread, in words.
    pub notes: Vec<String>,
    /// Files of which rows were skipped.
    pub incomplete: u64,
}

impl Trajectories {
    /// A trajectory at its own pace from `origin_s` on, or from its first pose.
    fn open(&mut self, file: &config::Csv, origin_s: Option<f64>) -> Result<Poses, Error> {
        let name = file.file.display();
        let (trajectory, counts) = csv::read(&file.file, None).map_err(|error| match error {
            CsvError::Io { .. } => Error::Backend(Box::new(error)),
            error => refused(format!("{name}: {error}")),
        })?;
        self.notes.extend(counts.notes(&trajectory).into_iter().map(|words| format!("{name}: {words}")));
        self.incomplete += u64::from(counts.lost_something(&trajectory));
        Ok(Box::new(Replayed::new(&trajectory, origin_s.unwrap_or(trajectory.span_s().0), Instant::ZERO, 1.0)))
    }
}

/// This robot's records, opened.
struct Opened {
    card: Card,
    /// The MAC of the card, where the source says it.
    mac: Option<Mac>,
    /// Times real time; none of a card whose records come when they come.
    speed: Option<f64>,
}

impl From<CardThread> for Opened {
    fn from(card: CardThread) -> Self {
        Self { card: Box::new(card), mac: None, speed: None }
    }
}

/// What several sources of one configuration share.
struct Shared<'a> {
    adapters: &'a mut [Box<dyn Adapter>],
    /// Notified when a card's thread has something.
    wake: &'a Arc<Notify>,
    /// The simulated room of this process.
    room: Option<Room>,
    /// The socket of a room that another program runs.
    served: Option<&'a Path>,
    /// This robot's replayed log.
    replayed: Option<ReplayedLog<'a>>,
    trajectories: Trajectories,
}

impl Sources {
    /// Opens everything; the sources' time begins at zero, and `adapters` have poses. `wake` is notified when a card's thread
    /// has something.
    ///
    /// # Errors
    /// What cannot be opened, with what to do about it.
    pub fn open(config: &Config, adapters: &mut [Box<dyn Adapter>], wake: &Arc<Notify>) -> Result<Self, Error> {
        let trajectories = Trajectories::default();
        let mut shared = Shared { adapters, wake, room: None, served: None, replayed: None, trajectories };
        let capture = config.capture.get_ref();
        let Opened { card, mac, speed } = shared.capture(capture, config)?;
        let (is_live, speed) = (speed.is_none(), speed.unwrap_or(1.0));
        let own = config.mac.or(mac);
        let robot = capture.robot().unwrap_or_default();
        let (poses, track) = shared.poses(&config.odometry, robot, config.antenna_offset_m, config.camera_mount)?;
        let peers = config.peer.iter().map(|peer| shared.peer(peer.get_ref())).collect::<Result<_, _>>()?;
        let own = own.ok_or_else(|| refused("this robot's MAC is not known"))?;
        let array = config.array.as_ref().map(|array| array.array()).transpose();
        let array = array.map_err(|error| Error::Backend(Box::new(error)))?;
        let is_placed = config.antenna_offset_m != [0.0; 3];
        let array = array.map(|array| if is_placed { array.on_trajectory() } else { array });
        let trajectories = shared.trajectories;
        Ok(Self { own, capture: card, is_live, poses, track, peers, array, trajectories, speed })
    }
}

/// Poses of an adapter, with the time that is usual unless the configuration says which.
fn adapted(adapters: &mut [Box<dyn Adapter>], odometry: &Odometry, usual: Stamp) -> Result<Poses, Error> {
    let found = adapters.iter_mut().find_map(|adapter| adapter.poses(odometry, usual));
    found.ok_or_else(|| refused("these poses come by what this program does not speak"))
}

impl<'a> Shared<'a> {
    fn thread(&self, card: impl CsiSource + AsFd + Send + 'static) -> Result<CardThread, Error> {
        let wake = Arc::clone(self.wake);
        CardThread::start(card, move || wake.notify_one())
    }

    /// A robot's card in a room that another program runs, and its MAC.
    fn join(&self, socket: &Path, robot: &str) -> Result<(CardThread, Mac), Error> {
        let (room, mac) = served::join(&address(socket, robot), Role::Card)?;
        Ok((self.thread(Netlink::over(room, wall_us))?, mac))
    }

    /// This robot's records.
    fn capture(&mut self, capture: &'a Capture, config: &Config) -> Result<Opened, Error> {
        match capture {
            &Capture::Card(config::Card { connector_index, allow_user_sender }) => {
                let options = netlink::Options { connector_index, allow_user_sender, ..netlink::Options::default() };
                self.thread(Netlink::open(&options)?).map(Opened::from)
            }
            Capture::Stock(asked) => {
                // With a key the tags of frames are checked.
                let has_key = config.sounding.as_ref().is_some_and(|sounding| sounding.key.is_some());
                let records = driver_iface::stock::Options { frames: asked.frames || has_key, ..Default::default() };
                let options = stock::Options { records, ring: stock::RING, own: config.mac };
                self.thread(Stock::open(&options)?).map(Opened::from)
            }
            Capture::Feitcsi(asked) => self.thread(FeitCsi::new(frames_of(asked)?)).map(Opened::from),
            Capture::Served(served) => {
                self.served = Some(&served.socket);
                let (card, mac) = self.join(&served.socket, &served.robot)?;
                Ok(Opened { mac: Some(mac), ..card.into() })
            }
            Capture::Replay(asked) => {
                let origin_s = first_host_s(&asked.file)?;
                self.replayed = Some(ReplayedLog { file: &asked.file, own: config.mac, origin_s });
                let card = Box::new(Paced::new(Replay::open(&asked.file)?, 1.0, None));
                Ok(Opened { card, mac: None, speed: Some(asked.speed) })
            }
            Capture::Room(asked) => {
                let mut room = Room::new(&asked.load_scene()?)?;
                for (robot, odometry) in &asked.follow {
                    let source = match odometry {
                        Odometry::Csv(file) => self.trajectories.open(file, None)?,
                        // The room's time is that of this host.
                        topic => adapted(self.adapters, topic, Stamp::Receipt)?,
                    };
                    room.follow(number(&room, robot)?, source)?;
                }
                let own = number(&room, &asked.robot)?;
                let card = Box::new(room.card(own).ok_or_else(|| refused("the room's card is taken"))?);
                let mac = room.mac(own);
                self.room = Some(room);
                Ok(Opened { card, mac, speed: Some(asked.speed) })
            }
        }
    }

    /// A source of poses of a robot's antenna, which is so far forward, left and up; or the place of a robot that has none.
    /// With a camera the source's poses are of that.
    fn poses(
        &mut self,
        odometry: &Odometry,
        robot: &str,
        antenna_m: [f64; 3],
        camera: Option<CameraMount>,
    ) -> Result<(Option<Poses>, Track), Error> {
        let source: Poses = match odometry {
            Odometry::Static(place) => return Ok((None, still(place, antenna_m))),
            Odometry::Network(_) => return Ok((None, Track::default())),
            Odometry::Csv(file) => {
                let origin_s = self.replayed.as_ref().map_or(0.0, |replayed| replayed.origin_s);
                self.trajectories.open(file, Some(origin_s))?
            }
            Odometry::Ros(_) | Odometry::Ros2(_) => adapted(self.adapters, odometry, Stamp::Header)?,
            Odometry::Room(_) => match (self.served, &self.room) {
                (Some(socket), _) => Box::new(served::Poses::join(&address(socket, robot))?),
                (None, Some(room)) => Box::new(room.odometry(number(room, robot)?).ok_or_else(|| absent(robot))?),
                (None, None) => return Err(absent(robot)),
            },
            Odometry::Opencr(port) => {
                let serial = Serial::open(port.port.clone(), port.rate_hz, port.model, Instant::ZERO, wall_us)?;
                Box::new(PoseThread::start(serial)?)
            }
        };
        let roller = camera.map(|camera| Roller::new(camera.mount()));
        Ok((Some(Box::new(AntennaPoses { source, roller, offset_m: antenna_m.into() })), Track::default()))
    }

    /// A peer's records; its MAC, where the source says it.
    fn records(&mut self, peer: &PeerConfig) -> Result<(Option<Card>, Option<Mac>), Error> {
        match &peer.records {
            Records::Network(_) | Records::Sounding(_) => Ok((None, None)),
            Records::Heard(_) => {
                let in_room = |room: &Room| room.mac(room.number(&peer.name)?);
                Ok((None, self.room.as_ref().and_then(in_room)))
            }
            Records::Replay(log) => Ok((Some(peer_log(&log.file, peer.mac, self.replayed.as_ref())?), None)),
            Records::Room(_) => {
                let (card, mac): (Card, Mac) = match (self.served, &mut self.room) {
                    (Some(socket), _) => {
                        let (card, mac) = self.join(socket, &peer.name)?;
                        (Box::new(card), mac)
                    }
                    (None, Some(room)) => peer_card(room, &peer.name)?,
                    (None, None) => return Err(absent(&peer.name)),
                };
                Ok((Some(card), Some(mac)))
            }
        }
    }

    fn peer(&mut self, peer: &PeerConfig) -> Result<PeerSources, Error> {
        let (records, mac) = self.records(peer)?;
        let (poses, track) = self.poses(&peer.poses, &peer.name, peer.antenna_offset_m, None)?;
        let unknown = || refused(format!("the MAC of peer `{}` is not known", peer.name));
        let mac = peer.mac.or(mac).ok_or_else(unknown)?;
        let told = LivePeer { name: peer.name.clone(), mac, track, yaw_rad: peer.yaw_deg.to_radians() };
        let is_heard_only = matches!(peer.records, Records::Heard(_));
        Ok(PeerSources { peer: told, records, poses, is_heard_only, open_ended: false, new_frames: 0 })
    }
}

/// What FeitCSI writes. A pipe stays open, whoever writes to it and whenever.
fn frames_of(asked: &Feitcsi) -> Result<Frames, Error> {
    match asked {
        Feitcsi::Udp(command) => Frames::ask(command, wall_us),
        Feitcsi::Pipe(pipe) => {
            let opened = std::fs::File::options().read(true).write(true).open(pipe);
            let opened = opened.map_err(Error::io(format!("cannot read {}", pipe.display())))?;
            Ok(Frames::read(opened.into(), wall_us))
        }
    }
}

fn address(socket: &Path, robot: &str) -> Address {
    Address { socket: socket.to_owned(), robot: robot.to_owned() }
}

/// There is no such robot.
fn absent(robot: &str) -> Error {
    refused(format!("the room has no robot `{robot}`"))
}

fn number(room: &Room, robot: &str) -> Result<usize, Error> {
    room.number(robot).ok_or_else(|| absent(robot))
}

/// A peer's card, and its MAC.
fn peer_card(room: &mut Room, robot: &str) -> Result<(Card, Mac), Error> {
    let number = number(room, robot)?;
    let (mac, card) = room
        .mac(number)
        .zip(room.card(number))
        .ok_or_else(|| refused(format!("robot `{robot}` of the room is used twice")))?;
    Ok((Box::new(card), mac))
}

/// This robot's replayed log.
struct ReplayedLog<'a> {
    file: &'a Path,
    /// Its MAC, if that is known.
    own: Option<Mac>,
    /// Host time at which the log begins, seconds.
    origin_s: f64,
}

/// A peer's log, to be played together with this robot's.
fn peer_log(log: &Path, peer: Option<Mac>, own: Option<&ReplayedLog<'_>>) -> Result<Card, Error> {
    let mut replay = Replay::open(log)?;
    let mut begin = Begin::default();
    if let Some((own, (own_mac, peer))) = own.and_then(|own| Some((own, own.own.zip(peer)?))) {
        begin = together(|| Replay::open(own.file), || Replay::open(log), (own_mac, peer))?;
    }
    for _ in 0..begin.skip {
        replay.receive(Instant::ZERO)?;
    }
    Ok(Box::new(Paced::new(replay, 1.0, None).beginning(Instant::ZERO + begin.after)))
}

/// The host time of a log's first record that has one, seconds since the Unix epoch.
fn first_host_s(log: &Path) -> Result<f64, Error> {
    let mut source = Replay::open(log)?;
    let mut survey = Survey::default();
    let name = log.display();
    for _ in 0..LOOKED_AT {
        let next = source.receive(Instant::ZERO)?;
        let ended = matches!(next, Next::End(_));
        if let Some(host_us) = survey.note(&next).and_then(|(_, identity)| identity.host_us) {
            return Ok(host_us as f64 * 1e-6);
        }
        if ended {
            break;
        }
    }
    if survey.records == 0 {
        return Err(refused(format!("{name}: no record of a csitool log in it: is it another kind of file?")));
    }
    Err(refused(format!(
        "{name}: no record has a host time (WSR layout, or a .datstp file beside the log), so poses cannot be joined with it"
    )))
}

/// The start of the peer's log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Begin {
    /// Its skipped records, from before this robot's log.
    skip: usize,
    /// Its start after this robot's log.
    after: Span,
}

/// A frame of one sender in a log.
struct Frame {
    number: u32,
    /// Records and losses before it, ...
    before: usize,
    /// ... and the card's time since the first.
    since: Span,
}

/// The frames of `sender` in a log, one by one.
fn frames(mut log: impl CsiSource, sender: Mac) -> impl Iterator<Item = Result<Frame, Error>> {
    let (mut survey, mut before, mut ended) = (Survey::default(), 0, false);
    std::iter::from_fn(move || {
        while !ended {
            let next = match log.receive(Instant::ZERO) {
                Ok(next) => next,
                Err(error) => {
                    ended = true;
                    return Some(Err(error));
                }
            };
            ended = matches!(next, Next::End(_));
            before += 1;
            let of_sender = survey.note(&next).filter(|(_, identity)| identity.mac == sender);
            if let Some(number) = of_sender.and_then(|(_, identity)| identity.frame_count) {
                let (first_us, now_us) = survey.clock_us.unwrap_or_default();
                return Some(Ok(Frame { number, before: before - 1, since: Span::from_us(now_us - first_us) }));
            }
        }
        None
    })
}

/// The start of the peer's log at which the two meet, by their first common frame number. `own` and `peer` open the
/// logs; the sender in each is the other robot.
fn together<S: CsiSource>(
    own: impl Fn() -> Result<S, Error>,
    peer: impl Fn() -> Result<S, Error>,
    (own_mac, peer_mac): (Mac, Mac),
) -> Result<Begin, Error> {
    let common = match first_common(frames(own()?, peer_mac), frames(peer()?, own_mac))? {
        Some((own, peer)) => Some((own, peer)),
        None => first_common(frames(peer()?, own_mac), frames(own()?, peer_mac))?.map(|(peer, own)| (own, peer)),
    };
    let Some((own, peer)) = common else { return Ok(Begin::default()) };
    if peer.since > own.since + APART && peer.before > RECORDS {
        // A stock record comes after its MPDU.
        return Ok(Begin { skip: peer.before - 1, after: own.since });
    }
    let after = own.since - peer.since;
    Ok(Begin { skip: 0, after: if after > APART { after } else { Span::default() } })
}

/// The first common frame number, in both logs.
fn first_common(
    one: impl Iterator<Item = Result<Frame, Error>>,
    other: impl Iterator<Item = Result<Frame, Error>>,
) -> Result<Option<(Frame, Frame)>, Error> {
    let mut first = HashMap::new();
    for frame in one.take(FRAMES) {
        let frame = frame?;
        first.entry(frame.number).or_insert(frame);
    }
    for frame in other {
        let frame = frame?;
        if let Some(partner) = first.remove(&frame.number) {
            return Ok(Some((partner, frame)));
        }
    }
    Ok(None)
}

/// The place of the antenna of a robot that stands.
fn still(place: &config::Place, offset_m: [f64; 3]) -> Track {
    let heading_rad = place.heading_deg.to_radians();
    let pose = Pose { t_s: 0.0, position_m: Vector3::from(place.position_m), heading_rad: Some(heading_rad) };
    let antenna = pose.mounted(Vector3::from(offset_m)).map_or(pose.position_m, |pose| pose.position_m);
    Track::still(antenna, heading_rad)
}

/// The antenna of a robot, by poses of its middle between the wheels, or of the camera that it carries.
struct AntennaPoses {
    source: Poses,
    /// Of a camera.
    roller: Option<Roller>,
    /// Forward, left and up from the middle, turned with the heading.
    offset_m: Vector3<f64>,
}

impl OdometrySource for AntennaPoses {
    fn receive(&mut self, now: Instant) -> Result<NextPose, Error> {
        let next = self.source.receive(now)?;
        Ok(match (next, &mut self.roller) {
            (NextPose::Pose(pose), roller) => {
                let middle = roller.as_mut().map_or(Ok(pose), |roller| roller.step(&pose))?;
                let is_there = self.offset_m == Vector3::zeros();
                NextPose::Pose(if is_there { middle } else { middle.mounted(self.offset_m)? })
            }
            (NextPose::NewFrame, Some(roller)) => {
                roller.reset();
                NextPose::NewFrame
            }
            (other, _) => other,
        })
    }

    fn next_at(&self) -> Option<Instant> {
        self.source.next_at()
    }

    fn trouble(&self) -> Option<String> {
        self.source.trouble()
    }

    fn counted(&self) -> Option<SourceCounts> {
        self.source.counted()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use csi5300::motion::pose::Mount;
    use driver_iface::bfee::{Iq, Repr, Wsr};
    use driver_iface::record::{Record, code};
    use std::collections::VecDeque;

    struct Listed(VecDeque<NextPose>);

    impl OdometrySource for Listed {
        fn receive(&mut self, _: Instant) -> Result<NextPose, Error> {
            Ok(self.0.pop_front().unwrap_or(NextPose::End))
        }

        fn next_at(&self) -> Option<Instant> {
            None
        }
    }

    #[test]
    fn sideways_slips_are_removed_until_a_new_frame() {
        let pose = |k: u32, x: f64, y: f64| {
            let heading_rad = Some(0.02);
            NextPose::Pose(Pose { t_s: f64::from(k) * 0.02, position_m: Vector3::new(x, y, 0.1), heading_rad })
        };
        let listed = [
            pose(0, 0.0, 0.0),
            pose(1, 0.01, 0.005),
            NextPose::Pending,
            pose(2, 0.02, 0.01),
            NextPose::NewFrame,
            pose(3, 5.0, 7.0),
        ];
        // A camera that looks 0.02 to the left of a robot that drives along x.
        let mount = Mount { offset_m: Vector3::new(0.1, 0.2, 0.0), yaw_rad: 0.02 };
        let (roller, offset_m) = (Some(Roller::new(mount)), Vector3::zeros());
        let mut rolling = AntennaPoses { source: Box::new(Listed(listed.into())), roller, offset_m };
        let mut at = || rolling.receive(Instant::ZERO).unwrap();
        let place = |next: NextPose| match next {
            NextPose::Pose(pose) => (pose.position_m + Vector3::new(0.1, 0.2, 0.0), pose.heading_rad),
            other => panic!("{other:?}"),
        };
        let near = |next: NextPose, x: f64, y: f64| {
            let (position_m, heading_rad) = place(next);
            assert!((position_m - Vector3::new(x, y, 0.1)).norm() < 1e-9, "{position_m}");
            assert!(heading_rad.unwrap().abs() < 1e-12);
        };
        near(at(), 0.0, 0.0);
        near(at(), 0.01, 0.0);
        assert_eq!(at(), NextPose::Pending);
        near(at(), 0.02, 0.0);
        assert_eq!(at(), NextPose::NewFrame);
        near(at(), 5.0, 7.0);
        assert_eq!(at(), NextPose::End);
    }

    #[test]
    fn the_antenna_turns_with_the_robot() {
        let heading_rad = Some(std::f64::consts::FRAC_PI_2);
        let pose = Pose { t_s: 0.0, position_m: Vector3::new(1.0, 0.0, 0.0), heading_rad };
        let listed = VecDeque::from([NextPose::Pose(pose)]);
        let offset_m = Vector3::new(0.1, 0.0, 0.2);
        let mut antenna = AntennaPoses { source: Box::new(Listed(listed)), roller: None, offset_m };
        let NextPose::Pose(pose) = antenna.receive(Instant::ZERO).unwrap() else { panic!("a pose is there") };
        assert!((pose.position_m - Vector3::new(1.0, 0.1, 0.2)).norm() < 1e-12);
    }

    #[test]
    fn logs_meet_at_their_first_common_frame() {
        let (own_mac, peer_mac) = (Mac([2, 0, 0, 0, 0, 1]), Mac([2, 0, 0, 0, 0, 2]));
        let begin = |own: std::ops::Range<u32>, peer: std::ops::Range<u32>| {
            let (own, peer) = (log(own, peer_mac, 5), log(peer, own_mac, 4_000_000_000));
            let open = |bytes: &'static [u8]| move || Ok(Replay::new(bytes, "test".into()));
            together(open(own.leak()), open(peer.leak()), (own_mac, peer_mac)).unwrap()
        };
        // At 100 frames a second: the peer was started a hundred seconds before, about together, or after.
        let early = begin(10_000..11_000, 0..11_000);
        assert_eq!(early, Begin { skip: 9_999, after: Span::default() });
        assert_eq!(begin(100..1_000, 0..1_000), Begin::default());
        assert_eq!(begin(0..11_000, 10_000..11_000), Begin { skip: 0, after: Span::from_ms(100_000) });
        assert_eq!(begin(0..100, 200..300), Begin::default());
    }

    /// WSR records of `sender`, 10 ms apart.
    fn log(numbers: std::ops::Range<u32>, sender: Mac, from_us: u32) -> Vec<u8> {
        let mut log = Vec::new();
        for number in numbers {
            let wsr = Some(Wsr { tv_sec: 0, tv_usec: 0, mac: sender, frame_count: Some(number) });
            let timestamp_low = from_us.wrapping_add(number * 10_000);
            let repr = Repr { timestamp_low, n_rx: 1, antenna_sel: 0, wsr, ..Repr::default() };
            let mut body = vec![0; repr.body_len()];
            repr.emit(&[Iq { i: 1, q: 1 }; 30], &mut body).unwrap();
            let record = Record { code: code::BFEE, body: &body };
            let from = log.len();
            log.resize(from + record.emit_len(), 0);
            record.emit(&mut log[from..]).unwrap();
        }
        log
    }
}
