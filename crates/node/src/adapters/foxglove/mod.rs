//! A running robot in Foxglove's viewers, over a websocket (`foxglove.sdk.v1`), with the channels and the stock schemas that
//! `csi5300 mcap` records.
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

mod door;

use super::{Adapter, Made, Said, Start};
use crate::health::Health;
use crate::machine::{Machine, Tap};
use crate::{lock, refused};
use csi5300::bartlett::{self, Grid};
use csi5300::internal::Front;
use csi5300::motion::pose::Pose;
use csi5300::pipeline::Bearing;
use csi5300::pipeline::live::PeerState;
use csi5300::source::{Error, Next};
use csi5300::time::Instant;
use csi5300_bag::messages::Quaternion;
use door::{Door, Rules};
use driver_iface::bfee::{Antenna, SUBCARRIERS};
use foxglove::{Channel, Context, Encode, WebSocketServer, WebSocketServerHandle, messages as fox};
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};

/// Poses of a path at most.
const PATH: usize = 500;
/// Directions of a profile.
const DIRECTIONS: usize = 360;
/// The trajectory's frame, and the robot's.
const ODOM: &str = "odom";
const ROBOT: &str = "robot";

struct Shown {
    live: Arc<Mutex<Live>>,
    antenna: Antenna,
}

pub(super) fn make(start: &Start<'_>) -> Made {
    let config = start.config;
    let Some(address) = config.output.foxglove else { return Ok(None) };
    let links = config.peer.iter().map(|peer| peer.get_ref().name.as_str());
    let live = Live::listen(start.name, links, address, config.output.foxglove_origins.clone())?;
    Ok(Some(Box::new(Shown { live: Arc::new(Mutex::new(live)), antenna: config.antenna })))
}

impl Adapter for Shown {
    fn attach(&mut self, machine: &mut Machine) -> Result<(), Error> {
        machine.add_tap(Box::new(Told { live: Arc::clone(&self.live), front: Front::new(self.antenna) }));
        Ok(())
    }

    fn report(&mut self, said: &Said<'_>) {
        if said.report.state == PeerState::Bearing
            && let Some(bearing) = said.bearing
        {
            lock(&self.live).bearing(&said.report.answer.link, bearing);
        }
    }

    fn tell(&mut self, _: &Health, machine: &Machine) {
        let (survey, track) = (&machine.estimator.own_log().survey, machine.estimator.track());
        let records_s = survey.host_us.map(|(_, last)| last as f64 * 1e-6);
        let live = lock(&self.live);
        if let Some(t_s) = records_s {
            let counters = Counters {
                records: survey.records,
                damages: survey.damages,
                damaged_bytes: survey.damaged_bytes,
                impossible_records: survey.bad_bfee,
                overruns: survey.overruns,
                bfee_missing: survey.bfee_missing,
            };
            live.counters.log_with_time(&counters, nanoseconds(t_s));
        }
        if let Some(last) = track.last().filter(|_| !track.is_still()) {
            let poses = track.poses().step_by(track.len().div_ceil(PATH).max(1));
            let path = fox::PosesInFrame {
                timestamp: Some(timestamp(last.t_s)),
                frame_id: ODOM.into(),
                poses: poses.map(|pose| placed(pose, aim(pose.heading_rad.unwrap_or(0.0), 0.0))).collect(),
            };
            live.trajectory.log_with_time(&path, nanoseconds(last.t_s));
        }
    }
}

struct Told {
    live: Arc<Mutex<Live>>,
    front: Front,
}

impl Tap for Told {
    fn own(&mut self, _: Instant, next: &Next<'_>) {
        let Some((sender, heard)) = self.front.note(next) else { return };
        let live = lock(&self.live);
        if !live.rows.has_sinks() {
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
        let t_s = heard.host_us.map_or(0.0, |us| us as f64 * 1e-6);
        live.rows.log_with_time(&row, nanoseconds(t_s));
    }

    fn pose(&mut self, pose: Option<Pose>) {
        let Some(pose) = pose else { return };
        let (live, rotation) = (lock(&self.live), aim(pose.heading_rad.unwrap_or(0.0), 0.0));
        transform(&live.transforms, ROBOT, &pose, rotation);
        live.poses.log_with_time(&in_frame(&pose, rotation), nanoseconds(pose.t_s));
    }
}

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

/// A websocket for viewers, on its own threads, behind a door. A slow viewer loses messages and delays nothing.
struct Live {
    context: Arc<Context>,
    transforms: Channel<fox::FrameTransform>,
    poses: Channel<fox::PoseInFrame>,
    trajectory: Channel<fox::PosesInFrame>,
    rows: Channel<CsiRow>,
    counters: Channel<Counters>,
    bearings: BTreeMap<String, OfLink>,
    // Open as long as this lives.
    _door: Door,
    server: Option<WebSocketServerHandle>,
}

impl Drop for Live {
    fn drop(&mut self) {
        drop(self.server.take().map(WebSocketServerHandle::stop));
    }
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

impl Live {
    /// Listens, with the channels of the log `name` and of `links`. Call it outside of an async runtime: the server has
    /// its own. Pages in `origins`, and those that are always allowed, may connect.
    ///
    /// All channels exist before a viewer can connect: the SDK (0.30) advertises a later channel before it is ready,
    /// and refuses a viewer that subscribes in between.
    fn listen<'a>(
        name: &str,
        links: impl Iterator<Item = &'a str>,
        address: SocketAddr,
        origins: Vec<String>,
    ) -> Result<Self, Error> {
        let failed = |source: &dyn Display| refused(format!("cannot listen for viewers on {address}: {source}"));
        let context = Context::new();
        let transforms = context.channel_builder("/tf").build();
        let poses = context.channel_builder("/pose").build();
        let trajectory = context.channel_builder("/trajectory").build();
        let rows = context.channel_builder(format!("/csi/{name}")).build();
        let counters = context.channel_builder(format!("/counters/{name}")).build();
        let bearings = links.map(|link| (link.to_owned(), OfLink::new(&context, link))).collect();
        let server = WebSocketServer::new().name(name).bind("127.0.0.1", 0).context(&context);
        let server = server.start_blocking().map_err(|source| failed(&source))?;
        let inside = SocketAddr::from(([127, 0, 0, 1], server.port()));
        let door = Door::open(address, inside, Rules::new(origins)).map_err(|source| failed(&source))?;
        let server = Some(server);
        Ok(Self { context, transforms, poses, trajectory, rows, counters, bearings, _door: door, server })
    }

    /// A bearing, its mirror if any, and its profile.
    fn bearing(&mut self, link: &str, bearing: &Bearing) {
        let new = || OfLink::new(&self.context, link);
        let channels = self.bearings.entry(link.to_owned()).or_insert_with(new);
        let t_s = bearing.samples.t_s().last().copied().unwrap_or(0.0);
        let from = Pose { t_s, position_m: bearing.mean_position_m, heading_rad: None };
        let answer = &bearing.answer;
        let rotation = aim(answer.azimuth_rad, answer.signed_elevation_rad.unwrap_or(0.0));
        channels.bearing.log_with_time(&in_frame(&from, rotation), nanoseconds(t_s));
        if let Some(mirror_rad) = answer.mirror_rad {
            let towards = aim(mirror_rad, answer.mirror_elevation_rad.unwrap_or(0.0));
            channels.mirror.log_with_time(&in_frame(&from, towards), nanoseconds(t_s));
        }
        transform(&self.transforms, &format!("bearing/{link}"), &from, rotation);
        // What is refused has no profile, and is in the report.
        if channels.profile.has_sinks()
            && let Ok(profile) = profile(bearing, &from)
        {
            channels.profile.log_with_time(&profile, nanoseconds(t_s));
        }
    }
}

/// A frame at a place in the trajectory's frame.
fn transform(to: &Channel<fox::FrameTransform>, child: &str, place: &Pose, rotation: fox::Quaternion) {
    let transform = fox::FrameTransform {
        timestamp: Some(timestamp(place.t_s)),
        parent_frame_id: ODOM.into(),
        child_frame_id: child.into(),
        translation: Some(vector(place)),
        rotation: Some(rotation),
    };
    to.log_with_time(&transform, nanoseconds(place.t_s));
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
            (ROBOT, placed(&origin, aim(-heading, 0.0)))
        }
        None => (ODOM, placed(from, aim(0.0, 0.0))),
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

/// The rotation that turns +x to an azimuth and from there up to an elevation.
fn aim(azimuth_rad: f64, elevation_rad: f64) -> fox::Quaternion {
    let Quaternion { x, y, z, w } = Quaternion::along(azimuth_rad, elevation_rad);
    fox::Quaternion { x, y, z, w }
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
        let live = Live::listen("burger", ["a", "b"].into_iter(), address, Vec::new()).unwrap();
        let id = |live: &Live, link: &str| live.bearings.get(link).map(|own| own.bearing.id());
        assert!(live.bearings.len() == 2 && id(&live, "a").is_some() && id(&live, "a") != id(&live, "b"));
    }
}
