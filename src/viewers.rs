//! Captures and bearings as MCAP, with the stock schemas of Foxglove, for its viewers and for any MCAP reader.
//!
//! | topic | schema | what |
//! |---|---|---|
//! | `/csi/LOG` | `CsiRow` | one record: sender, number, magnitude and phase of one antenna by subcarrier |
//! | `/counters/LOG` | `Counters` | what was read and lost in a log |
//! | `/tf` | `foxglove.FrameTransform` | the robot in the trajectory's frame, `odom` -> `robot` |
//! | `/pose` | `foxglove.PoseInFrame` | the same as a pose |
//! | `/trajectory` | `foxglove.PosesInFrame` | the whole path |
//! | `/bearing/LINK` | `foxglove.PoseInFrame` | at the middle of the motion, x axis to the transmitter |
//! | `/aoa_profile/LINK` | `foxglove.LaserScan` | the profile round the horizon, in metres of length 1 at its peak |

use crate::bartlett::{self, Grid};
use crate::channel::SUBCARRIERS;
use crate::pipeline::intake::Heard;
use crate::pipeline::link::Bearing;
use crate::pose::{Pose, Trajectory};
use crate::survey::Survey;
use driver_iface::Mac;
use foxglove::messages as fox;
use foxglove::{Channel, Context, Encode, McapWriterHandle};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
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

/// What was read and lost in a log.
#[derive(Encode)]
struct Counters {
    records: u64,
    damages: u64,
    damaged_bytes: u64,
    impossible_records: u64,
    overruns: u64,
    bfee_missing: u64,
}

/// Why no recording was written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file could not be written.
    #[error("{path}: {source}")]
    Write {
        /// The file.
        path: String,
        /// The writer's reason.
        source: foxglove::FoxgloveError,
    },
    /// A profile could not be computed.
    #[error(transparent)]
    Bartlett(#[from] bartlett::Error),
}

/// A recording being written.
pub struct Recording {
    context: Arc<Context>,
    writer: McapWriterHandle<BufWriter<File>>,
    path: String,
    rows: BTreeMap<String, Channel<CsiRow>>,
}

impl Recording {
    /// Begins a new file.
    ///
    /// # Errors
    /// If it is there already, or cannot be made.
    pub fn create(path: &Path) -> Result<Self, Error> {
        let named = path.display().to_string();
        let context = Context::new();
        let writer = context.mcap_writer().create_new_buffered_file(path);
        let writer = writer.map_err(|source| Error::Write { path: named.clone(), source })?;
        Ok(Self { context, writer, path: named, rows: BTreeMap::new() })
    }

    fn channel<T: Encode>(&self, topic: &str) -> Channel<T> {
        self.context.channel_builder(topic).build()
    }

    /// A record of the log `log`, received at `t_s`, seconds since the Unix epoch.
    pub fn record(&mut self, log: &str, t_s: f64, sender: Mac, heard: &Heard) {
        if !self.rows.contains_key(log) {
            let channel = self.channel(&format!("/csi/{log}"));
            self.rows.insert(log.to_owned(), channel);
        }
        let Some(channel) = self.rows.get(log) else { return };
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

    /// What was counted in a log that ended at `t_s`.
    pub fn counters(&self, log: &str, t_s: f64, survey: &Survey) {
        let counters = Counters {
            records: survey.records,
            damages: survey.damages,
            damaged_bytes: survey.damaged_bytes,
            impossible_records: survey.bad_bfee,
            overruns: survey.overruns,
            bfee_missing: survey.bfee_missing,
        };
        self.channel(&format!("/counters/{log}")).log_with_time(&counters, nanoseconds(t_s));
    }

    /// The robot's path.
    pub fn trajectory(&self, trajectory: &Trajectory) {
        let (transforms, poses) =
            (self.channel::<fox::FrameTransform>("/tf"), self.channel::<fox::PoseInFrame>("/pose"));
        for pose in trajectory.poses() {
            let (position, rotation) = (vector(pose), turn(pose.heading_rad.unwrap_or(0.0)));
            let transform = fox::FrameTransform {
                timestamp: Some(timestamp(pose.t_s)),
                parent_frame_id: ODOM.into(),
                child_frame_id: ROBOT.into(),
                translation: Some(position),
                rotation: Some(rotation),
            };
            transforms.log_with_time(&transform, nanoseconds(pose.t_s));
            poses.log_with_time(&in_frame(pose, rotation), nanoseconds(pose.t_s));
        }
        let (start_s, _) = trajectory.span_s();
        let path = fox::PosesInFrame {
            timestamp: Some(timestamp(start_s)),
            frame_id: ODOM.into(),
            poses: trajectory.poses().iter().map(|pose| placed(pose, turn(pose.heading_rad.unwrap_or(0.0)))).collect(),
        };
        self.channel("/trajectory").log_with_time(&path, nanoseconds(start_s));
    }

    /// A bearing and its profile.
    ///
    /// # Errors
    /// If the profile cannot be computed.
    pub fn bearing(&self, link: &str, bearing: &Bearing, wavelength_m: f64) -> Result<(), Error> {
        let t_s = bearing.samples.t_s.last().copied().unwrap_or(0.0);
        let from = Pose { t_s, position_m: bearing.mean_position_m, heading_rad: None };
        let azimuth = bearing.estimate.azimuth_rad;
        self.channel(&format!("/bearing/{link}")).log_with_time(&in_frame(&from, turn(azimuth)), nanoseconds(t_s));
        let elevation = bearing.estimate.abs_elevation_rad;
        let directions: Vec<(f64, f64)> =
            (0..DIRECTIONS).map(|k| (Grid::azimuth(DIRECTIONS).at(k).0, elevation)).collect();
        let (first, last) = (directions[0].0, directions[DIRECTIONS - 1].0);
        let profile = bartlett::profile(&bearing.samples, wavelength_m, &Grid::directions(directions))?;
        let peak = profile.values.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let scan = fox::LaserScan {
            timestamp: Some(timestamp(t_s)),
            frame_id: ODOM.into(),
            pose: Some(placed(&from, turn(0.0))),
            start_angle: first,
            end_angle: last,
            ranges: profile.values.iter().map(|value| value / peak).collect(),
            intensities: profile.values.clone(),
        };
        self.channel(&format!("/aoa_profile/{link}")).log_with_time(&scan, nanoseconds(t_s));
        Ok(())
    }

    /// Ends the file.
    ///
    /// # Errors
    /// If the rest cannot be written.
    pub fn finish(self) -> Result<(), Error> {
        let path = self.path;
        self.writer.close().map(drop).map_err(|source| Error::Write { path, source })
    }
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

fn placed(pose: &Pose, orientation: fox::Quaternion) -> fox::Pose {
    fox::Pose { position: Some(vector(pose)), orientation: Some(orientation) }
}

fn in_frame(pose: &Pose, orientation: fox::Quaternion) -> fox::PoseInFrame {
    let pose_in = Some(placed(pose, orientation));
    fox::PoseInFrame { timestamp: Some(timestamp(pose.t_s)), frame_id: ODOM.into(), pose: pose_in }
}
