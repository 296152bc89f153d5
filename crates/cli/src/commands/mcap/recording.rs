//! A capture as a recording of ROS 2: MCAP with messages in CDR, which Foxglove, Lichtblick, `ros2 bag` and MCAP readers read.
//!
//! | topic | type | what |
//! |---|---|---|
//! | `/csi/LOG` | `csi5300_msgs/msg/CsiRow` | one record: sender, number, magnitude and phase of one antenna by subcarrier |
//! | `/counters/LOG` | `csi5300_msgs/msg/Counters` | what was read and lost in a log |
//! | `/tf` | `tf2_msgs/msg/TFMessage` | the robot in the trajectory's frame, `odom` -> `robot`, and each bearing, `odom` -> `bearing/LINK`, at the middle of the motion with its x axis to the transmitter |
//! | `/pose` | `geometry_msgs/msg/PoseStamped` | the robot as a pose |
//! | `/trajectory` | `nav_msgs/msg/Path` | the whole path |
//! | `/bearing/LINK` | `geometry_msgs/msg/PoseStamped` | the bearing as a pose |
//! | `/mirror/LINK` | `geometry_msgs/msg/PoseStamped` | the mirror of the bearing as a pose, if it has one |
//! | `/aoa_profile/LINK` | `sensor_msgs/msg/LaserScan` | the profile round the horizon, in metres of length 1 at its peak, in the frame `bearing/LINK` |

use csi5300::bartlett::{self, Grid};
use csi5300::internal::FrameHeard;
use csi5300::motion::pose::Pose;
use csi5300::pipeline::Bearing;
use csi5300::signal::channel::SUBCARRIERS;
use csi5300::source::survey::Survey;
use csi5300_bag::mcap::McapWriter;
use csi5300_bag::messages::{
    Counters, CsiRow, Header, LaserScan, Message, Path, Pose as Placed, PoseStamped, Quaternion, TfMessage, Time,
    Transform, TransformStamped, Vector3,
};
use driver_iface::Mac;
use std::fs::File;
use std::io::{self, BufWriter};

/// Directions of a profile.
const DIRECTIONS: usize = 360;
/// The trajectory's frame, and the robot's.
const ODOM: &str = "odom";
const ROBOT: &str = "robot";

/// A recording being written.
pub struct Recording(McapWriter<BufWriter<File>>);

impl Recording {
    /// Begins a file.
    pub fn create(path: &std::path::Path) -> io::Result<Self> {
        McapWriter::new(BufWriter::new(File::create(path)?)).map(Self)
    }

    /// Ends the file.
    pub fn finish(mut self) -> io::Result<()> {
        self.0.finish()
    }

    fn put<T: Message>(&mut self, topic: &str, t_s: f64, message: &T) -> io::Result<()> {
        self.0.put((topic, T::TYPE, T::definition), us(t_s).unsigned_abs().saturating_mul(1_000), &message.payload())
    }

    /// A record of the log `log`, received at `t_s`, seconds since the Unix epoch.
    pub fn record(&mut self, log: &str, t_s: f64, sender: Mac, heard: &FrameHeard) -> io::Result<()> {
        let csi: [_; SUBCARRIERS] = heard.csi();
        let row = CsiRow {
            header: header(t_s, ""),
            sender: sender.to_string(),
            number: heard.number,
            card_us: heard.timestamp_low,
            magnitude: csi.iter().map(|h| h.norm()).collect(),
            phase: csi.iter().map(|h| h.arg()).collect(),
        };
        self.put(&format!("/csi/{log}"), t_s, &row)
    }

    /// Counts of a log until `t_s`.
    pub fn counters(&mut self, log: &str, t_s: f64, survey: &Survey) -> io::Result<()> {
        let counters = Counters {
            header: header(t_s, ""),
            records: survey.records,
            damages: survey.damages,
            damaged_bytes: survey.damaged_bytes,
            impossible_records: survey.bad_bfee,
            overruns: survey.overruns,
            bfee_missing: survey.bfee_missing,
        };
        self.put(&format!("/counters/{log}"), t_s, &counters)
    }

    /// Where the robot is.
    pub fn pose(&mut self, pose: &Pose) -> io::Result<()> {
        let turned = aim(pose.heading_rad.unwrap_or(0.0), 0.0);
        self.transform(ROBOT, pose, turned.clone())?;
        self.put("/pose", pose.t_s, &placed(pose, turned))
    }

    fn transform(&mut self, child: &str, place: &Pose, rotation: Quaternion) -> io::Result<()> {
        let [x, y, z] = place.position_m.into();
        let transform = Transform { translation: Vector3 { x, y, z }, rotation };
        let told = TransformStamped { header: header(place.t_s, ODOM), child_frame_id: child.to_owned(), transform };
        self.put("/tf", place.t_s, &TfMessage { transforms: vec![told] })
    }

    /// The robot's path, as known at `t_s`.
    pub fn path(&mut self, t_s: f64, poses: &[Pose]) -> io::Result<()> {
        let poses = poses.iter().map(|pose| placed(pose, aim(pose.heading_rad.unwrap_or(0.0), 0.0))).collect();
        self.put("/trajectory", t_s, &Path { header: header(t_s, ODOM), poses })
    }

    /// A bearing, its mirror if it has one, and its profile.
    pub fn bearing(&mut self, link: &str, bearing: &Bearing) -> Result<(), String> {
        let (answer, t_s) = (&bearing.answer, bearing.samples.t_s().last().copied().unwrap_or(0.0));
        let from = Pose { t_s, position_m: bearing.mean_position_m, heading_rad: None };
        let towards = aim(answer.azimuth_rad, answer.signed_elevation_rad.unwrap_or(0.0));
        let scan = profile(link, t_s, bearing).map_err(|error| error.to_string())?;
        let mut put = || {
            self.put(&format!("/bearing/{link}"), t_s, &placed(&from, towards.clone()))?;
            if let Some(mirror_rad) = answer.mirror_rad {
                let mirror = placed(&from, aim(mirror_rad, answer.mirror_elevation_rad.unwrap_or(0.0)));
                self.put(&format!("/mirror/{link}"), t_s, &mirror)?;
            }
            self.transform(&format!("bearing/{link}"), &from, towards.clone())?;
            self.put(&format!("/aoa_profile/{link}"), t_s, &scan)
        };
        put().map_err(|error: io::Error| error.to_string())
    }
}

/// The profile about the middle of the motion, from the bearing on.
fn profile(link: &str, t_s: f64, bearing: &Bearing) -> Result<LaserScan, bartlett::Error> {
    let (azimuth, elevation) = (bearing.answer.azimuth_rad, bearing.answer.elevation_rad());
    let step = std::f64::consts::TAU / DIRECTIONS as f64;
    let angles = (0..DIRECTIONS).map(|k| k as f64 * step - std::f64::consts::PI);
    let directions = angles.map(|angle| (csi5300::maths::wrap_rad(azimuth + angle), elevation)).collect();
    let profile = bartlett::profile(&bearing.samples, &Grid::directions(directions))?;
    let peak = profile.values.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    Ok(LaserScan {
        header: header(t_s, &format!("bearing/{link}")),
        angle_min: -std::f32::consts::PI,
        angle_max: (std::f64::consts::PI - step) as f32,
        angle_increment: step as f32,
        range_max: 1.0,
        ranges: profile.values.iter().map(|value| (value / peak) as f32).collect(),
        intensities: profile.values.iter().map(|value| *value as f32).collect(),
        ..LaserScan::default()
    })
}

fn us(t_s: f64) -> i64 {
    (t_s.max(0.0) * 1e6).round() as i64
}

fn header(t_s: f64, frame: &str) -> Header {
    Header { stamp: Time::from_us(us(t_s)), frame_id: frame.to_owned() }
}

/// The rotation that turns +x to an azimuth and from there up to an elevation.
fn aim(azimuth_rad: f64, elevation_rad: f64) -> Quaternion {
    let ((z, w), (up, level)) = ((0.5 * azimuth_rad).sin_cos(), (-0.5 * elevation_rad).sin_cos());
    Quaternion { x: -z * up, y: w * up, z: z * level, w: w * level }
}

fn placed(pose: &Pose, orientation: Quaternion) -> PoseStamped {
    let position = <[f64; 3]>::from(pose.position_m).into();
    PoseStamped { header: header(pose.t_s, ODOM), pose: Placed { position, orientation } }
}
