//! Captures and bearings for viewers, with the stock schemas of Foxglove: recorded as MCAP, for its viewers and for any MCAP
//! reader, or live over a websocket (`foxglove.sdk.v1`), for its viewers. Both have the same channels.
//!
//! | topic | schema | what |
//! |---|---|---|
//! | `/csi/LOG` | `CsiRow` | one record: sender, number, magnitude and phase of one antenna by subcarrier |
//! | `/counters/LOG` | `Counters` | what was read and lost in a log |
//! | `/tf` | `foxglove.FrameTransform` | the robot in the trajectory's frame, `odom` -> `robot`, and each bearing, `odom` -> `bearing/LINK`, at the middle of the motion with its x axis to the transmitter |
//! | `/pose` | `foxglove.PoseInFrame` | the robot as a pose |
//! | `/trajectory` | `foxglove.PosesInFrame` | the whole path |
//! | `/bearing/LINK` | `foxglove.PoseInFrame` | the bearing as a pose |
//! | `/mirror/LINK` | `foxglove.PoseInFrame` | the mirror of the bearing as a pose, where it has one |
//! | `/aoa_profile/LINK` | `foxglove.LaserScan` | the profile round the horizon, in metres of length 1 at its peak, about the robot |

use super::door::{Door, Rules};
use csi5300::bartlett::{self, Grid};
use csi5300::internal::FrameHeard;
use csi5300::motion::pose::Pose;
use csi5300::pipeline::Bearing;
use csi5300::signal::channel::SUBCARRIERS;
use csi5300::source::survey::Survey;
use driver_iface::Mac;
use foxglove::messages as fox;
use foxglove::{Channel, Context, Encode, WebSocketServer, WebSocketServerHandle};
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;

/// Directions of a profile.
const DIRECTIONS: usize = 360;
/// The trajectory's frame, and the robot's.
const ODOM: &str = "odom";
const ROBOT: &str = "robot";

/// One record.
#[derive(Encode)]
struct CsiRow {
    /// MAC of the sender.
    sender: String,
    /// Frame number.
    number: u32,
    /// The card's clock, microseconds, wrapping.
    card_us: u32,
    /// |CSI| by subcarrier, unscaled.
    magnitude: Vec<f32>,
    /// Its phase, radians.
    phase: Vec<f32>,
}

/// Counts of a log: read and lost.
#[derive(Encode)]
struct Counters {
    records: u64,
    damages: u64,
    damaged_bytes: u64,
    impossible_records: u64,
    overruns: u64,
    bfee_missing: u64,
}

/// Errors of viewers.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// No viewer can connect.
    #[error("cannot listen for viewers on {address}: {source}")]
    Listen {
        /// Where.
        address: SocketAddr,
        /// The server's reason.
        source: foxglove::FoxgloveError,
    },
    /// No viewer can connect.
    #[error("cannot listen for viewers on {address}: {source}")]
    Door {
        /// Where.
        address: SocketAddr,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A profile could not be computed.
    #[error(transparent)]
    Bartlett(#[from] bartlett::Error),
}

/// A websocket for viewers, on its own threads, behind a door. A slow viewer loses messages and delays nothing.
pub struct Live {
    /// The channels that viewers subscribe to.
    pub channels: Channels,
    // Open as long as this lives.
    _door: Door,
    server: Option<WebSocketServerHandle>,
}

impl Drop for Live {
    fn drop(&mut self) {
        drop(self.server.take().map(WebSocketServerHandle::stop));
    }
}

impl Live {
    /// Listens, with the channels of the log `name` and of `links`. Call it outside of an async runtime: the server has
    /// its own. Pages in `origins`, and those that are always allowed, may connect.
    ///
    /// All channels exist before a viewer can connect: the SDK (0.30) advertises a later channel before it is ready,
    /// and refuses a viewer that subscribes in between.
    ///
    /// # Errors
    /// If the address cannot be used.
    pub fn listen<'a>(
        name: &str,
        links: impl Iterator<Item = &'a str>,
        address: SocketAddr,
        origins: Vec<String>,
    ) -> Result<Self, Error> {
        let context = Context::new();
        let mut channels = Channels::new(Arc::clone(&context));
        channels.make(name, links);
        let server = WebSocketServer::new().name(name).bind("127.0.0.1", 0).context(&context);
        let server = server.start_blocking().map_err(|source| Error::Listen { address, source })?;
        let inside = SocketAddr::from(([127, 0, 0, 1], server.port()));
        let door =
            Door::open(address, inside, Rules::new(origins)).map_err(|source| Error::Door { address, source })?;
        Ok(Self { channels, _door: door, server: Some(server) })
    }
}

/// The channels of a recording or of a websocket.
pub struct Channels {
    context: Arc<Context>,
    transforms: Channel<fox::FrameTransform>,
    poses: Channel<fox::PoseInFrame>,
    trajectory: Channel<fox::PosesInFrame>,
    rows: BTreeMap<String, Channel<CsiRow>>,
    counters: BTreeMap<String, Channel<Counters>>,
    bearings: BTreeMap<String, OfLink>,
}

/// The channels of a link: its bearing, the mirror of it, and its profile.
struct OfLink {
    bearing: Channel<fox::PoseInFrame>,
    mirror: Channel<fox::PoseInFrame>,
    profile: Channel<fox::LaserScan>,
}

impl OfLink {
    fn new(context: &Arc<Context>, link: &str) -> Self {
        let named = |topic: &str| context.channel_builder(format!("/{topic}/{link}"));
        Self {
            bearing: named("bearing").build(),
            mirror: named("mirror").build(),
            profile: named("aoa_profile").build(),
        }
    }
}

/// The channel of that name, made if needed.
fn named<'a, T>(channels: &'a mut BTreeMap<String, T>, name: &str, make: impl FnOnce() -> T) -> &'a T {
    if !channels.contains_key(name) {
        channels.insert(name.to_owned(), make());
    }
    &channels[name]
}

impl Channels {
    fn new(context: Arc<Context>) -> Self {
        Self {
            transforms: context.channel_builder("/tf").build(),
            poses: context.channel_builder("/pose").build(),
            trajectory: context.channel_builder("/trajectory").build(),
            rows: BTreeMap::new(),
            counters: BTreeMap::new(),
            bearings: BTreeMap::new(),
            context,
        }
    }

    /// Makes the channels of a log and of links in advance.
    fn make<'a>(&mut self, log: &str, links: impl Iterator<Item = &'a str>) {
        let context = &self.context;
        named(&mut self.rows, log, || context.channel_builder(format!("/csi/{log}")).build());
        named(&mut self.counters, log, || context.channel_builder(format!("/counters/{log}")).build());
        for link in links {
            named(&mut self.bearings, link, || OfLink::new(context, link));
        }
    }

    /// A record of the log `log`, received at `t_s`, seconds since the Unix epoch.
    pub fn record(&mut self, log: &str, t_s: f64, sender: Mac, heard: &FrameHeard) {
        let context = &self.context;
        let channel = named(&mut self.rows, log, || context.channel_builder(format!("/csi/{log}")).build());
        if !channel.has_sinks() {
            return;
        }
        let csi: [_; SUBCARRIERS] = heard.csi();
        let row = CsiRow {
            sender: sender.to_string(),
            number: heard.number,
            card_us: heard.timestamp_low,
            magnitude: csi.iter().map(|h| h.norm()).collect(),
            phase: csi.iter().map(|h| h.arg()).collect(),
        };
        channel.log_with_time(&row, nanoseconds(t_s));
    }

    /// Counts of a log until `t_s`.
    pub fn counters(&mut self, log: &str, t_s: f64, survey: &Survey) {
        let counters = Counters {
            records: survey.records,
            damages: survey.damages,
            damaged_bytes: survey.damaged_bytes,
            impossible_records: survey.bad_bfee,
            overruns: survey.overruns,
            bfee_missing: survey.bfee_missing,
        };
        let context = &self.context;
        let channel = named(&mut self.counters, log, || context.channel_builder(format!("/counters/{log}")).build());
        channel.log_with_time(&counters, nanoseconds(t_s));
    }

    /// The robot's pose.
    pub fn pose(&self, pose: &Pose) {
        let rotation = turn(pose.heading_rad.unwrap_or(0.0));
        self.transform(ROBOT, pose, rotation);
        self.poses.log_with_time(&in_frame(pose, rotation), nanoseconds(pose.t_s));
    }

    fn transform(&self, child: &str, place: &Pose, rotation: fox::Quaternion) {
        let transform = fox::FrameTransform {
            timestamp: Some(timestamp(place.t_s)),
            parent_frame_id: ODOM.into(),
            child_frame_id: child.into(),
            translation: Some(vector(place)),
            rotation: Some(rotation),
        };
        self.transforms.log_with_time(&transform, nanoseconds(place.t_s));
    }

    /// The robot's path, as known at `t_s`.
    pub fn path<'a>(&self, t_s: f64, poses: impl Iterator<Item = &'a Pose>) {
        let path = fox::PosesInFrame {
            timestamp: Some(timestamp(t_s)),
            frame_id: ODOM.into(),
            poses: poses.map(|pose| placed(pose, turn(pose.heading_rad.unwrap_or(0.0)))).collect(),
        };
        self.trajectory.log_with_time(&path, nanoseconds(t_s));
    }

    /// A bearing, its mirror if any, and its profile.
    ///
    /// # Errors
    /// If the profile cannot be computed.
    pub fn bearing(&mut self, link: &str, bearing: &Bearing) -> Result<(), Error> {
        let context = &self.context;
        named(&mut self.bearings, link, || OfLink::new(context, link));
        let Some(channels) = self.bearings.get(link) else { return Ok(()) };
        let t_s = bearing.samples.t_s().last().copied().unwrap_or(0.0);
        let from = Pose { t_s, position_m: bearing.mean_position_m, heading_rad: None };
        let answer = &bearing.answer;
        let rotation = aim(answer.azimuth_rad, answer.signed_elevation_rad.unwrap_or(0.0));
        channels.bearing.log_with_time(&in_frame(&from, rotation), nanoseconds(t_s));
        if let Some(mirror_rad) = answer.mirror_rad {
            let towards = aim(mirror_rad, answer.mirror_elevation_rad.unwrap_or(0.0));
            channels.mirror.log_with_time(&in_frame(&from, towards), nanoseconds(t_s));
        }
        self.transform(&format!("bearing/{link}"), &from, rotation);
        if channels.profile.has_sinks() {
            channels.profile.log_with_time(&profile(bearing, &from)?, nanoseconds(t_s));
        }
        Ok(())
    }
}

/// The profile in directions of the trajectory's frame, at the robot, or at the middle of the motion without a heading.
fn profile(bearing: &Bearing, from: &Pose) -> Result<fox::LaserScan, bartlett::Error> {
    let elevation = bearing.answer.elevation_rad();
    let directions: Vec<(f64, f64)> = (0..DIRECTIONS).map(|k| (Grid::azimuth(DIRECTIONS).at(k).0, elevation)).collect();
    let (first, last) = (directions[0].0, directions[DIRECTIONS - 1].0);
    let profile = bartlett::profile(&bearing.samples, &Grid::directions(directions))?;
    let peak = profile.values.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let (frame_id, pose) = match bearing.heading_rad {
        Some(heading) => {
            let origin = Pose { position_m: Vector3::zeros(), ..*from };
            (ROBOT, placed(&origin, turn(-heading)))
        }
        None => (ODOM, placed(from, turn(0.0))),
    };
    Ok(fox::LaserScan {
        timestamp: Some(timestamp(from.t_s)),
        frame_id: frame_id.into(),
        pose: Some(pose),
        start_angle: first,
        end_angle: last,
        ranges: profile.values.iter().map(|value| value / peak).collect(),
        intensities: profile.values,
    })
}

fn nanoseconds(t_s: f64) -> u64 {
    (t_s.max(0.0) * 1e9) as u64
}

fn timestamp(t_s: f64) -> fox::Timestamp {
    let ns = nanoseconds(t_s);
    fox::Timestamp::new((ns / 1_000_000_000) as u32, (ns % 1_000_000_000) as u32)
}

fn vector(pose: &Pose) -> fox::Vector3 {
    let [x, y, z] = pose.position_m.into();
    fox::Vector3 { x, y, z }
}

/// The rotation that turns +x to an azimuth.
fn turn(azimuth_rad: f64) -> fox::Quaternion {
    let (z, w) = (0.5 * azimuth_rad).sin_cos();
    fox::Quaternion { x: 0.0, y: 0.0, z, w }
}

/// The rotation that turns +x to an azimuth and from there up to an elevation.
fn aim(azimuth_rad: f64, elevation_rad: f64) -> fox::Quaternion {
    let ((z, w), (up, level)) = ((0.5 * azimuth_rad).sin_cos(), (-0.5 * elevation_rad).sin_cos());
    fox::Quaternion { x: -z * up, y: w * up, z: z * level, w: w * level }
}

fn placed(pose: &Pose, orientation: fox::Quaternion) -> fox::Pose {
    fox::Pose { position: Some(vector(pose)), orientation: Some(orientation) }
}

fn in_frame(pose: &Pose, orientation: fox::Quaternion) -> fox::PoseInFrame {
    let pose_in = Some(placed(pose, orientation));
    fox::PoseInFrame { timestamp: Some(timestamp(pose.t_s)), frame_id: ODOM.into(), pose: pose_in }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_channel_of_a_robot_is_made_before_a_viewer_can_come() {
        let address = SocketAddr::from(([127, 0, 0, 1], 0));
        let mut live = Live::listen("burger", ["a", "b"].into_iter(), address, Vec::new()).unwrap();
        let ids = |live: &Live| {
            let of = |own: &OfLink| [own.bearing.id(), own.mirror.id(), own.profile.id()];
            live.channels.bearings.values().map(of).collect::<Vec<_>>()
        };
        let before = ids(&live);
        assert_eq!((before.len(), live.channels.rows.len(), live.channels.counters.len()), (2, 1, 1));
        live.channels.make("burger", ["a", "b"].into_iter());
        assert_eq!(ids(&live), before, "none is made twice");
    }
}
