//! This robot's odometry and its peers.

use super::values::{exactly, hundred, maybe_parsed, positive};
use super::{ros, ros2};
use csi5300::motion::odometry::opencr::Geometry;
use csi5300::motion::pose::Mount;
use driver_iface::Mac;
use nalgebra::Vector3;
use std::path::PathBuf;

/// Sources of poses.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Odometry {
    /// The controller of a TurtleBot3, over its serial port.
    Opencr(OpenCr),
    /// A trajectory file, at the pace of the replayed log.
    Csv(Csv),
    /// The simulated room's.
    Room(NoKeys),
    /// A topic of ROS 1.
    Ros(ros::Topic),
    /// A topic of ROS 2.
    Ros2(ros2::Topic),
    /// The robot stands for ever.
    Static(Place),
    /// Other robots' poses come over the network.
    Network(NoKeys),
}

impl Default for Odometry {
    fn default() -> Self {
        Self::Static(Place::default())
    }
}

/// A table without keys: `{}`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoKeys {}

/// See [`Odometry::Opencr`].
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OpenCr {
    /// The serial port.
    pub port: PathBuf,
    /// The robot's model; by default the controller's.
    #[serde(default)]
    pub model: Option<Model>,
    /// Readings a second.
    #[serde(default = "hundred", deserialize_with = "positive")]
    pub rate_hz: f64,
}

/// A TurtleBot3.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Model {
    /// Burger.
    Burger,
    /// Waffle and Waffle Pi.
    Waffle,
}

impl Model {
    /// Its wheels.
    #[must_use]
    pub fn geometry(self) -> Geometry {
        match self {
            Self::Burger => Geometry::BURGER,
            Self::Waffle => Geometry::WAFFLE,
        }
    }
}

/// See [`Odometry::Csv`]. In a configuration `"FILE"` or `{ file = "FILE" }`.
#[derive(Clone, Debug, PartialEq)]
pub struct Csv {
    /// The trajectory.
    pub file: PathBuf,
}

impl<'de> serde::Deserialize<'de> for Csv {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(CsvVisitor)
    }
}

/// Reads both forms of a [`Csv`], with the errors of the form that was meant.
struct CsvVisitor;

/// The table.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct FileKey {
    file: PathBuf,
}

impl<'de> serde::de::Visitor<'de> for CsvVisitor {
    type Value = Csv;

    fn expecting(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str("a file, \"FILE\" or { file = \"FILE\" }")
    }

    fn visit_str<E>(self, file: &str) -> Result<Csv, E> {
        Ok(Csv { file: file.into() })
    }

    fn visit_map<A: serde::de::MapAccess<'de>>(self, map: A) -> Result<Csv, A::Error> {
        let key: FileKey = serde::Deserialize::deserialize(serde::de::value::MapAccessDeserializer::new(map))?;
        Ok(Csv { file: key.file })
    }
}

/// See [`Odometry::Static`].
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Place {
    /// Metres.
    #[serde(deserialize_with = "exactly")]
    pub position_m: [f64; 3],
    /// Degrees from +x towards +y.
    pub heading_deg: f64,
}

/// The mount of a tracking camera on a robot with wheels.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraMount {
    /// The camera seen from the middle between the wheels, metres forward.
    pub forward_m: f64,
    /// The same, metres to the left.
    pub left_m: f64,
    /// Its heading less the robot's, degrees, counter-clockwise.
    #[serde(default)]
    pub yaw_deg: f64,
}

impl CameraMount {
    /// The same for [`csi5300::motion::pose`].
    #[must_use]
    pub fn mount(&self) -> Mount {
        Mount { offset_m: Vector3::new(self.forward_m, self.left_m, 0.0), yaw_rad: self.yaw_deg.to_radians() }
    }
}

/// A robot whose bearing is wanted.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Peer {
    /// Its name.
    pub name: String,
    /// Its MAC; in a simulated room the scene's.
    #[serde(default, deserialize_with = "maybe_parsed")]
    pub mac: Option<Mac>,
    /// The common name of its certificate: only its holder may publish as it in the robots' network.
    #[serde(default)]
    pub certificate: Option<String>,
    /// The source of its card's records.
    pub records: Records,
    /// The source of its poses.
    #[serde(default)]
    pub poses: Odometry,
    /// Its antenna's place on it: metres forward, left, up.
    #[serde(default, deserialize_with = "exactly")]
    pub antenna_offset_m: [f64; 3],
    /// How far its frame is turned against this robot's, degrees.
    #[serde(default)]
    pub yaw_deg: f64,
}

/// Sources of a peer's records.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Records {
    /// A recorded log, at the pace of this robot's.
    Replay(Csv),
    /// The robot of this peer's name in the simulated room.
    Room(NoKeys),
    /// The network of the robots.
    Network(NoKeys),
    /// None: its bearing comes from what this robot hears of it, with the antennas of `[array]`. It need not answer, nor be
    /// a robot.
    Heard(NoKeys),
    /// Its answers to this robot's frames, which carry its card's measurements. No network is needed, but the peer must
    /// stand, because answers lack the time of its host.
    Sounding(NoKeys),
}
