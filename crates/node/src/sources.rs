//! What a configuration names, opened.

use super::config::ros::Topic;
use super::config::{Capture, Config, Csv, Odometry, Peer as PeerConfig, Place, Records};
use super::estimator::{Peer, Settings};
use super::motion::Track;
use super::together::{self, Begin};
use csi5300::motion::odometry::replay::{Mounted, Replayed};
use csi5300::motion::odometry::ros::Stamp;
#[cfg(feature = "ros1")]
use csi5300::motion::odometry::ros::Wanted;
use csi5300::motion::odometry::{OdometrySource, csv};
use csi5300::source::paced::Paced;
use csi5300::source::replay::Replay;
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::Instant;
use csi5300_live::netlink::{Netlink, Options};
use csi5300_sim::{Room, Scene, served};
use driver_iface::Mac;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::path::Path;

/// A source of records that may move to another thread.
pub type Card = Box<dyn CsiSource + Send>;
/// A source of poses that may move to another thread.
pub type Poses = Box<dyn OdometrySource + Send>;

/// Records of a log in which a host time is looked for.
const LOOKED_AT: usize = 4_096;

/// One peer's sources. What comes over the network has none here.
pub struct PeerSources {
    /// What the estimator is told of it.
    pub peer: Peer,
    /// Its records.
    pub records: Option<Card>,
    /// Its poses.
    pub poses: Option<Poses>,
}

/// Everything that a configuration names.
pub struct Sources {
    /// This robot's MAC.
    pub own: Mac,
    /// This robot's records.
    pub capture: Card,
    /// Something to wait on for more records, for a source that does not know when they come.
    pub wake: Option<std::os::fd::OwnedFd>,
    /// This robot's poses.
    pub poses: Option<Poses>,
    /// Its place, if it never moves.
    pub track: Track,
    /// The peers.
    pub peers: Vec<PeerSources>,
    /// Times real time.
    pub speed: f64,
    /// This program as a node of ROS.
    #[cfg(feature = "ros1")]
    pub ros: Option<crate::ros1::Link>,
}

/// What several sources of one configuration share.
struct Shared<'a> {
    room: Option<Room>,
    /// The socket of a room that another program runs.
    served: Option<&'a Path>,
    /// This robot's replayed log and its MAC.
    replayed: Option<(&'a Path, Mac)>,
    /// Host time at which the replayed log begins, seconds.
    origin_s: f64,
    start: Instant,
    #[cfg(feature = "ros1")]
    ros: Option<crate::ros1::Link>,
}

impl Sources {
    /// Opens everything; the sources' time begins at `start`. `wall_us` reads the host's wall clock.
    ///
    /// # Errors
    /// What cannot be opened, with what to do about it.
    pub fn open(config: &Config, start: Instant, wall_us: fn() -> Option<i64>) -> Result<Self, Error> {
        let capture = config.capture.get_ref();
        let mut shared = Shared {
            room: None,
            served: None,
            replayed: None,
            origin_s: 0.0,
            start,
            #[cfg(feature = "ros1")]
            ros: link(config, wall_us)?,
        };
        let mut own = config.mac;
        // A card's records come when they come.
        let speed = match capture {
            Capture::Card(_) | Capture::Served(_) => 1.0,
            Capture::Replay(replay) => replay.speed,
            Capture::Room(room) => room.speed,
        };
        let mut wake = None;
        let card: Card = match capture {
            Capture::Card(card) => {
                let listener = listener(card, wall_us)?;
                wake = Some(listener.wake()?);
                Box::new(listener)
            }
            Capture::Served(served) => {
                shared.served = Some(&served.socket);
                let (card, mac) = served_card(&served.socket, &served.robot, wall_us)?;
                own = own.or(Some(mac));
                wake = Some(card.wake()?);
                Box::new(card)
            }
            Capture::Replay(replay) => {
                shared.origin_s = first_host_s(&replay.file)?;
                shared.replayed = own.map(|own| (replay.file.as_path(), own));
                Box::new(Paced::new(Replay::open(&replay.file)?, 1.0, None))
            }
            Capture::Room(asked) => {
                let made = Room::new(&scene(&asked.scene)?)?;
                let (number, made) = numbered(made, &asked.robot)?;
                shared.room = Some(made);
                shared.follow(&asked.follow)?;
                let room = shared.room.as_mut().ok_or_else(|| Error::Input("there is no room".into()))?;
                own = own.or(room.mac(number));
                let card = room.card(number).ok_or_else(|| Error::Input("the room's card is taken".into()))?;
                Box::new(card)
            }
        };
        let robot = match capture {
            Capture::Room(room) => room.robot.as_str(),
            Capture::Served(served) => served.robot.as_str(),
            Capture::Card(_) | Capture::Replay(_) => "",
        };
        let (poses, track) = shared.poses(&config.odometry, robot, config.antenna_offset_m, wall_us)?;
        let peers = config.peer.iter().map(|peer| shared.peer(peer.get_ref(), wall_us)).collect::<Result<_, _>>()?;
        let own = own.ok_or_else(|| Error::Input("this robot's MAC is not known".into()))?;
        Ok(Self {
            own,
            capture: card,
            wake,
            poses,
            track,
            peers,
            speed,
            #[cfg(feature = "ros1")]
            ros: shared.ros,
        })
    }

    /// How the estimator is set.
    #[must_use]
    pub fn settings(config: &Config) -> Settings {
        let asked = &config.estimator;
        let usual = Settings::new(config.channel.wavelength_m());
        Settings {
            window_m: asked.window_m,
            window_s: asked.window_s,
            least_m: asked.least_motion_m.unwrap_or(usual.least_m),
            rate_hz: asked.rate_hz,
            extrapolate_s: asked.extrapolate_s,
            accurate_every_s: asked.accurate_every_s,
        }
    }
}

impl Shared<'_> {
    /// A source of poses, or the place of a robot that has none.
    fn poses(
        &self,
        odometry: &Odometry,
        robot: &str,
        offset_m: [f64; 3],
        wall_us: fn() -> Option<i64>,
    ) -> Result<(Option<Poses>, Track), Error> {
        let source: Poses = match odometry {
            Odometry::Static(place) => return Ok((None, still(place, offset_m))),
            Odometry::Network(_) => return Ok((None, Track::default())),
            Odometry::Csv(file) => self.trajectory(file, Some(self.origin_s))?,
            Odometry::Ros(topic) => self.topic(topic, Stamp::Header)?,
            Odometry::Room(_) => match self.served {
                Some(socket) => served_poses(socket, robot)?,
                None => self.room_poses(robot)?,
            },
            Odometry::Opencr(port) => serial(port, self.start, wall_us)?,
        };
        let offset_m = Vector3::from(offset_m);
        let mounted: Poses =
            if offset_m == Vector3::zeros() { source } else { Box::new(Mounted::new(source, offset_m)) };
        Ok((Some(mounted), Track::default()))
    }

    /// A trajectory at its own pace from `origin_s` on, or from its first pose.
    fn trajectory(&self, file: &Csv, origin_s: Option<f64>) -> Result<Poses, Error> {
        let (trajectory, _) = csv::read(&file.file).map_err(|error| Error::Input(error.to_string()))?;
        Ok(Box::new(Replayed::new(&trajectory, origin_s.unwrap_or(trajectory.span_s().0), self.start, 1.0)))
    }

    #[cfg(feature = "ros1")]
    fn topic(&self, topic: &Topic, usual: Stamp) -> Result<Poses, Error> {
        let link = self.ros.as_ref().ok_or_else(|| Error::Input("there is no node of ROS".into()))?;
        let wanted = Wanted { stamp: topic.stamp.unwrap_or(usual), frame: topic.frame.clone() };
        Ok(Box::new(link.poses(&topic.topic, topic.kind, wanted)))
    }

    #[cfg(not(feature = "ros1"))]
    fn topic(&self, _: &Topic, _: Stamp) -> Result<Poses, Error> {
        Err(Error::Input("this program was built without ROS (feature `ros1`)".into()))
    }

    /// Robots of the room go where their sources say.
    fn follow(&mut self, sources: &BTreeMap<String, Odometry>) -> Result<(), Error> {
        for (name, odometry) in sources {
            let source = match odometry {
                Odometry::Csv(file) => self.trajectory(file, None)?,
                // The room's time is that of this host.
                Odometry::Ros(topic) => self.topic(topic, Stamp::Receipt)?,
                _ => return Err(Error::Input(format!("robot `{name}` follows `ros` or `csv`"))),
            };
            let absent = || Error::Input(format!("the room has no robot `{name}`"));
            let room = self.room.as_mut().ok_or_else(absent)?;
            room.follow(room.number(name).ok_or_else(absent)?, source)?;
        }
        Ok(())
    }

    fn room_poses(&self, robot: &str) -> Result<Poses, Error> {
        let absent = || Error::Input(format!("the room has no robot `{robot}`"));
        let room = self.room.as_ref().ok_or_else(absent)?;
        let number = room.number(robot).ok_or_else(absent)?;
        Ok(Box::new(room.odometry(number).ok_or_else(absent)?))
    }

    fn room_card(&mut self, robot: &str) -> Result<(Card, Mac), Error> {
        let absent = || Error::Input(format!("the room has no robot `{robot}`, or it is used twice"));
        let room = self.room.as_mut().ok_or_else(absent)?;
        let number = room.number(robot).ok_or_else(absent)?;
        let (mac, card) = (room.mac(number), room.card(number));
        let (mac, card) = mac.zip(card).ok_or_else(absent)?;
        Ok((Box::new(card), mac))
    }

    /// A peer's log, to be played together with this robot's.
    fn replay(&self, log: &Path, peer: Option<Mac>) -> Result<Card, Error> {
        let mut replay = Replay::open(log)?;
        let mut begin = Begin::default();
        if let Some(((own_log, own), peer)) = self.replayed.zip(peer) {
            begin = together::begin(|| Replay::open(own_log), || Replay::open(log), (own, peer))?;
        }
        for _ in 0..begin.skip {
            replay.receive(self.start)?;
        }
        Ok(Box::new(Paced::new(replay, 1.0, None).beginning(self.start + begin.after)))
    }

    fn peer(&mut self, peer: &PeerConfig, wall_us: fn() -> Option<i64>) -> Result<PeerSources, Error> {
        let mut mac = peer.mac;
        let records: Option<Card> = match &peer.records {
            Records::Network(_) => None,
            Records::Replay(log) => Some(self.replay(&log.file, peer.mac)?),
            Records::Room(_) => {
                let (card, told) = match self.served {
                    Some(socket) => boxed(served_card(socket, &peer.name, wall_us)?),
                    None => self.room_card(&peer.name)?,
                };
                mac = mac.or(Some(told));
                Some(card)
            }
        };
        let (poses, track) = self.poses(&peer.poses, &peer.name, peer.antenna_offset_m, wall_us)?;
        let mac = mac.ok_or_else(|| Error::Input(format!("the MAC of peer `{}` is not known", peer.name)))?;
        let told = Peer { name: peer.name.clone(), mac, track, yaw_rad: peer.yaw_deg.to_radians() };
        Ok(PeerSources { peer: told, records, poses })
    }
}

fn still(place: &Place, offset_m: [f64; 3]) -> Track {
    let heading_rad = place.heading_deg.to_radians();
    let pose = csi5300::motion::pose::Pose {
        t_s: 0.0,
        position_m: Vector3::from(place.position_m),
        heading_rad: Some(heading_rad),
    };
    let antenna = pose.mounted(Vector3::from(offset_m)).map_or(pose.position_m, |pose| pose.position_m);
    Track::still(antenna, heading_rad)
}

/// A scene by its file, or by the name of a built-in one.
pub(super) fn scene(name: &Path) -> Result<Scene, Error> {
    if let Some(scene) = name.to_str().and_then(Scene::built_in) {
        return Ok(scene);
    }
    Scene::load(name).map_err(|error| Error::Input(format!("{}: {error}", name.display())))
}

fn numbered(room: Room, robot: &str) -> Result<(usize, Room), Error> {
    let names = || room.scene().robot.iter().map(|robot| robot.name.as_str()).collect::<Vec<_>>().join(", ");
    match room.number(robot) {
        Some(number) => Ok((number, room)),
        None => Err(Error::Input(format!("the scene has no robot `{robot}`: it has {}", names()))),
    }
}

/// The host time of a log's first record that has one, seconds since the Unix epoch.
fn first_host_s(log: &Path) -> Result<f64, Error> {
    let mut source = Replay::open(log)?;
    let mut survey = Survey::default();
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
    let what =
        "no record has a host time (WSR layout, or a .datstp file beside the log), so poses cannot be joined with it";
    Err(Error::Input(format!("{}: {what}", log.display())))
}

fn listener(card: &super::config::Card, wall_us: fn() -> Option<i64>) -> Result<super::threads::CardThread, Error> {
    let (connector_index, allow_user_sender) = (card.connector_index, card.allow_user_sender);
    let options = Options::default()
        .with_connector_index(connector_index)
        .with_allow_user_sender(allow_user_sender)
        .with_wall_us(wall_us);
    super::threads::CardThread::start(Netlink::open(&options)?)
}

/// This program as a node of ROS, if anything of the configuration needs it.
#[cfg(feature = "ros1")]
fn link(config: &Config, wall_us: fn() -> Option<i64>) -> Result<Option<crate::ros1::Link>, Error> {
    if !super::config::ros::is_used(config) {
        return Ok(None);
    }
    let ros = config.ros.clone().unwrap_or_default();
    crate::ros1::Link::start(ros.master(), ros.node(config), wall_us).map(Some)
}

fn boxed((card, mac): (impl CsiSource + Send + 'static, Mac)) -> (Card, Mac) {
    (Box::new(card), mac)
}

/// A robot's card in a room that another program runs, and its MAC.
fn served_card(
    socket: &Path,
    robot: &str,
    wall_us: fn() -> Option<i64>,
) -> Result<(super::threads::CardThread, Mac), Error> {
    let (room, mac) = served::join(&address(socket, robot), served::Role::Card)?;
    Ok((super::threads::CardThread::start(Netlink::over(room, wall_us))?, mac))
}

fn served_poses(socket: &Path, robot: &str) -> Result<Poses, Error> {
    Ok(Box::new(csi5300_sim::served::Poses::join(&address(socket, robot))?))
}

fn address(socket: &Path, robot: &str) -> csi5300_sim::served::Address {
    csi5300_sim::served::Address { socket: socket.to_owned(), robot: robot.to_owned() }
}

fn serial(port: &super::config::OpenCr, start: Instant, wall_us: fn() -> Option<i64>) -> Result<Poses, Error> {
    let geometry = port.model.map(super::config::Model::geometry);
    let serial = csi5300_live::serial::Serial::open(port.port.clone(), port.rate_hz, geometry, start, wall_us)?;
    Ok(Box::new(super::threads::PoseThread::start(serial)?))
}
