//! The source of this robot's records.

use super::robots::Odometry;
use super::values::{one, parsed, positive};
use crate::NodeError;
use csi5300::source::Error;
use csi5300_live::feitcsi::Command;
use csi5300_sim::Scene;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Sources of records.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Capture {
    /// The card of this machine, through its driver.
    Card(Card),
    /// The card of this machine under the kernel's own driver, by an eBPF program (feature `stock`).
    Stock(Stock),
    /// An AX200 or AX210 of this machine, by FeitCSI.
    Feitcsi(Feitcsi),
    /// A recorded log at its own pace.
    Replay(Replay),
    /// A simulated room.
    Room(Room),
    /// A robot of a simulated room that another program runs (`csi5300 simulate --serve --socket`), in real time.
    Served(Served),
}

/// See [`Capture::Card`].
#[derive(Clone, Debug, Default, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Card {
    /// Connector index of the driver, instead of looking for it.
    pub connector_index: Option<u32>,
    /// Accept messages of other programs too: emulators, `replay --connector`.
    pub allow_user_sender: bool,
}

/// See [`Capture::Stock`].
#[derive(Clone, Debug, Default, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Stock {
    /// The frames themselves too (0xC1): for the log. With a key they are read in any case.
    pub frames: bool,
}

/// See [`Capture::Feitcsi`].
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Feitcsi {
    /// The address of its UDP socket, and its options: `127.0.0.1:8008 --frequency 5180`.
    Udp(#[serde(deserialize_with = "parsed")] Command),
    /// The named pipe that its standard output goes to.
    Pipe(PathBuf),
}

/// See [`Capture::Replay`].
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Replay {
    /// The log.
    pub file: PathBuf,
    /// Times its own pace.
    #[serde(default = "one", deserialize_with = "positive")]
    pub speed: f64,
}

/// See [`Capture::Room`].
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Room {
    /// The scene's file, or the name of a built-in one.
    pub scene: PathBuf,
    /// The robot of the scene that this is.
    pub robot: String,
    /// Times real time.
    #[serde(default = "one", deserialize_with = "positive")]
    pub speed: f64,
    /// The sources of poses for robots whose motion in the scene is `followed`.
    #[serde(default)]
    pub follow: BTreeMap<String, Odometry>,
}

/// See [`Capture::Served`].
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Served {
    /// The room's socket.
    pub socket: PathBuf,
    /// The robot of the scene that this is.
    pub robot: String,
}

impl Capture {
    /// The name that this robot has in its simulated room, if it is in one.
    #[must_use]
    pub fn robot(&self) -> Option<&str> {
        match self {
            Self::Room(room) => Some(&room.robot),
            Self::Served(served) => Some(&served.robot),
            Self::Card(_) | Self::Stock(_) | Self::Feitcsi(_) | Self::Replay(_) => None,
        }
    }
}

impl Room {
    /// The scene: a built-in one by its name, or that of the file.
    ///
    /// # Errors
    /// If there is no such scene, or it is refused.
    pub fn load_scene(&self) -> Result<Scene, Error> {
        let name = &self.scene;
        Scene::find(name).map_err(|source| NodeError::Scene { scene: name.clone(), source }.into())
    }
}
