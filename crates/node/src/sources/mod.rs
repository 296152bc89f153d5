//! What a configuration names, opened: one module a kind of source.

mod card;
mod poses;
mod replay;
mod rolling;
mod room;
mod serial;
mod served;

use crate::NodeError;
use crate::adapters::Adapter;
use crate::config::{CameraMount, Capture, Config, Odometry, Peer as PeerConfig, Records};
use csi5300::motion::odometry::Mounted;
use csi5300::motion::odometry::OdometrySource;
use csi5300::motion::odometry::ros::Stamp;
use csi5300::pipeline::Array;
use csi5300::pipeline::live::{LivePeer, Track};
use csi5300::source::{CsiSource, Error};
use csi5300::time::Instant;
use driver_iface::Mac;
use nalgebra::Vector3;
use replay::Replayed;
use room::SharedRoom;
use std::os::unix::net::UnixStream;
use std::path::Path;

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
}

/// Everything that a configuration names.
pub struct Sources {
    /// This robot's MAC.
    pub own: Mac,
    /// This robot's records.
    pub capture: Card,
    /// Something to wait on for more records, for a source that does not know when they come.
    pub wake: Option<UnixStream>,
    /// This robot's poses.
    pub poses: Option<Poses>,
    /// Its place, if it never moves.
    pub track: Track,
    /// The peers.
    pub peers: Vec<PeerSources>,
    /// The antennas for bearings of what is heard alone.
    pub array: Option<Array>,
    /// Times real time.
    pub speed: f64,
}

/// This robot's records, opened.
struct Opened {
    card: Card,
    wake: Option<UnixStream>,
    /// The MAC of the card, where the source says it.
    mac: Option<Mac>,
    /// Times real time.
    speed: f64,
}

/// Where things are on a robot.
struct Mounting {
    /// The antenna: metres forward, left, up.
    antenna_m: [f64; 3],
    /// The camera that its poses are of.
    camera: Option<CameraMount>,
}

/// What several sources of one configuration share.
struct Shared<'a> {
    start: Instant,
    /// Reads the host's wall clock.
    wall_us: fn() -> Option<i64>,
    adapters: &'a mut [Box<dyn Adapter>],
    /// The simulated room of this process.
    room: Option<SharedRoom>,
    /// The socket of a room that another program runs.
    served: Option<&'a Path>,
    /// This robot's replayed log.
    replayed: Option<Replayed<'a>>,
}

impl Sources {
    /// Opens everything; the sources' time begins at `start`. `wall_us` reads the host's wall clock, and `adapters` have poses.
    ///
    /// # Errors
    /// What cannot be opened, with what to do about it.
    pub fn open(
        config: &Config,
        start: Instant,
        wall_us: fn() -> Option<i64>,
        adapters: &mut [Box<dyn Adapter>],
    ) -> Result<Self, Error> {
        let mut shared = Shared { start, wall_us, adapters, room: None, served: None, replayed: None };
        let capture = config.capture.get_ref();
        let Opened { card, wake, mac, speed } = shared.capture(capture, config)?;
        let own = config.mac.or(mac);
        let robot = capture.robot().unwrap_or_default();
        let mount = Mounting { antenna_m: config.antenna_offset_m, camera: config.camera_mount };
        let (poses, track) = shared.poses(&config.odometry, robot, mount)?;
        let peers = config.peer.iter().map(|peer| shared.peer(peer.get_ref())).collect::<Result<_, _>>()?;
        let own = own.ok_or(NodeError::OwnMac)?;
        let array = config.array.as_ref().map(|array| array.array()).transpose();
        let array = array.map_err(|error| Error::Backend(Box::new(error)))?;
        Ok(Self { own, capture: card, wake, poses, track, peers, array, speed })
    }
}

/// Poses of an adapter, with the time that is usual unless the configuration says which.
fn adapted(adapters: &mut [Box<dyn Adapter>], odometry: &Odometry, usual: Stamp) -> Result<Poses, Error> {
    let found = adapters.iter_mut().find_map(|adapter| adapter.poses(odometry, usual));
    found.ok_or_else(|| NodeError::NoAdapter.into())
}

impl<'a> Shared<'a> {
    /// This robot's records.
    fn capture(&mut self, capture: &'a Capture, config: &Config) -> Result<Opened, Error> {
        match capture {
            Capture::Card(asked) => card::open(asked, self.wall_us),
            Capture::Stock(asked) => {
                let has_key = config.sounding.as_ref().is_some_and(|sounding| sounding.key.is_some());
                card::open_stock(asked, config.mac, has_key, self.wall_us)
            }
            Capture::Feitcsi(asked) => card::open_feitcsi(asked, self.wall_us),
            Capture::Served(served) => {
                self.served = Some(&served.socket);
                served::open(served, self.wall_us)
            }
            Capture::Replay(asked) => {
                let (opened, replayed) = replay::open(asked, config.mac)?;
                self.replayed = Some(replayed);
                Ok(opened)
            }
            Capture::Room(asked) => {
                let mut room = SharedRoom::open(asked)?;
                room.follow(&asked.follow, |robot, odometry| match odometry {
                    Odometry::Csv(file) => poses::trajectory(file, None, self.start),
                    // The room's time is that of this host.
                    Odometry::Ros(_) | Odometry::Ros2(_) => adapted(self.adapters, odometry, Stamp::Receipt),
                    _ => Err(NodeError::Follows { robot: robot.to_owned() }.into()),
                })?;
                let (card, mac) = room.own_card(&asked.robot)?;
                self.room = Some(room);
                Ok(Opened { card, wake: None, mac, speed: asked.speed })
            }
        }
    }

    /// A source of poses, or the place of a robot that has none.
    fn poses(&mut self, odometry: &Odometry, robot: &str, mount: Mounting) -> Result<(Option<Poses>, Track), Error> {
        let source: Poses = match odometry {
            Odometry::Static(place) => return Ok((None, poses::still(place, mount.antenna_m))),
            Odometry::Network(_) => return Ok((None, Track::default())),
            Odometry::Csv(file) => {
                let origin_s = self.replayed.as_ref().map_or(0.0, |replayed| replayed.origin_s);
                poses::trajectory(file, Some(origin_s), self.start)?
            }
            Odometry::Ros(_) | Odometry::Ros2(_) => adapted(self.adapters, odometry, Stamp::Header)?,
            Odometry::Room(_) => match (self.served, &self.room) {
                (Some(socket), _) => served::poses(socket, robot)?,
                (None, Some(room)) => room.poses(robot)?,
                (None, None) => return Err(room::absent(robot)),
            },
            Odometry::Opencr(port) => serial::poses(port, self.start, self.wall_us)?,
        };
        let source: Poses = match mount.camera {
            Some(camera) => Box::new(rolling::Rolling::new(source, camera.mount())),
            None => source,
        };
        let offset_m = Vector3::from(mount.antenna_m);
        let mounted: Poses =
            if offset_m == Vector3::zeros() { source } else { Box::new(Mounted::new(source, offset_m)) };
        Ok((Some(mounted), Track::default()))
    }

    /// A peer's records; its MAC, where the source says it.
    fn records(&mut self, peer: &PeerConfig) -> Result<(Option<Card>, Option<Mac>), Error> {
        match &peer.records {
            Records::Network(_) | Records::Sounding(_) => Ok((None, None)),
            Records::Heard(_) => Ok((None, self.room.as_ref().and_then(|room| room.mac(&peer.name)))),
            Records::Replay(log) => {
                Ok((Some(replay::peer(&log.file, peer.mac, self.replayed.as_ref(), self.start)?), None))
            }
            Records::Room(_) => {
                let (card, mac) = match (self.served, &mut self.room) {
                    (Some(socket), _) => served::peer(socket, &peer.name, self.wall_us)?,
                    (None, Some(room)) => room.peer_card(&peer.name)?,
                    (None, None) => return Err(room::absent(&peer.name)),
                };
                Ok((Some(card), Some(mac)))
            }
        }
    }

    fn peer(&mut self, peer: &PeerConfig) -> Result<PeerSources, Error> {
        let (records, mac) = self.records(peer)?;
        let mount = Mounting { antenna_m: peer.antenna_offset_m, camera: None };
        let (poses, track) = self.poses(&peer.poses, &peer.name, mount)?;
        let unknown = || NodeError::PeerMac { peer: peer.name.clone() };
        let mac = peer.mac.or(mac).ok_or_else(unknown)?;
        let told = LivePeer { name: peer.name.clone(), mac, track, yaw_rad: peer.yaw_deg.to_radians() };
        let is_heard_only = matches!(peer.records, Records::Heard(_));
        Ok(PeerSources { peer: told, records, poses, is_heard_only })
    }
}
