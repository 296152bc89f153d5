//! The robot's own service: capture, odometry, peers and the live estimator in one process.
//!
//! | module | what it is |
//! |---|---|
//! | [`config`] | the configuration file, checked whole before anything starts |
//! | [`csi5300::pipeline::live`] | the library's estimator: records and poses in, bearings out, time as an argument |
//! | [`sources`] | what a configuration names, opened |
//! | `threads` | the card and the wheels read on threads of their own |
//! | [`machine`] | the robot as one value: sources, log, estimator, taps |
//! | [`diagnostics`] | the acceptance claims of the last seconds; the state as ROS shows it |
//! | `sounder` | the robot's part in the sounding exchange |
//! | `adapters` | what a node speaks, behind one trait: ROS 1 and 2, zenoh, Foxglove, lines of JSON, the status socket |
//! | `health` | what is published beside the bearings |
//! | [`team`] | this robot and its peers as one graph; ranges of another sensor for it |
//! | [`service`] | tokio: waits, hands over, publishes |
//!
//! A feature gates only the module of its adapter and its line in the list of adapters.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

mod adapters;
pub mod config;
pub mod diagnostics;
mod health;
pub mod machine;
pub mod service;
mod sounder;
pub mod sources;
pub mod team;
mod threads;

use csi5300::source;
use std::path::PathBuf;

/// Errors of this crate. Within [`csi5300::source::Error`] they are a backend's.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NodeError {
    /// Neither the configuration nor the card's source has this robot's MAC.
    #[error("this robot's MAC is not known")]
    OwnMac,
    /// Neither the configuration nor the records' source has a peer's MAC.
    #[error("the MAC of peer `{peer}` is not known")]
    PeerMac {
        /// The peer's name.
        peer: String,
    },
    /// A scene cannot be loaded.
    #[error("{}", .source.of_file(.scene))]
    Scene {
        /// Its file.
        scene: PathBuf,
        /// Why.
        source: csi5300_sim::SceneError,
    },
    /// A robot of the room should follow a source without poses on this host.
    #[error("robot `{robot}` follows `ros2`, `ros` or `csv`")]
    Follows {
        /// Its name.
        robot: String,
    },
    /// The scene has no robot of that name.
    #[error("the scene has no robot `{robot}`: it has {}", .known.join(", "))]
    NotInScene {
        /// The name.
        robot: String,
        /// The names that it has.
        known: Vec<String>,
    },
    /// The room has no robot of that name.
    #[error("the room has no robot `{robot}`")]
    NotInRoom {
        /// The name.
        robot: String,
    },
    /// The room has no card of that robot left.
    #[error("the room has no robot `{robot}`, or it is used twice")]
    NotInRoomOrTwice {
        /// The robot's name.
        robot: String,
    },
    /// This robot's card of the room was taken before.
    #[error("the room's card is taken")]
    CardTaken,
    /// A log cannot be joined with poses.
    #[error(
        "{}: no record has a host time (WSR layout, or a .datstp file beside the log), so poses cannot be joined with it",
        .log.display()
    )]
    NoHostTime {
        /// The log.
        log: PathBuf,
    },
    /// Poses need a protocol that this program lacks.
    #[error("these poses come by what this program does not speak")]
    NoAdapter,
    /// The thread that listens to the card has ended.
    #[error("the thread that listens to the card has ended")]
    CardThreadEnded,
    /// The robots' network would admit anybody.
    #[error(
        "anybody who reaches {endpoint} could publish as any robot: ask for a password or a certificate in zenoh's file \
         (`network.zenoh`), listen on 127.0.0.1, or say `insecure = true` in [network]"
    )]
    OpenNetwork {
        /// Where it would listen.
        endpoint: String,
    },
    /// The network's file of users is empty, so zenoh would ask for no password.
    #[error(
        "{} names no user: a line `user:password` for each, or leave out `dictionary_file` in zenoh's file (`network.zenoh`){}",
        .path.display(),
        .source.as_ref().map(|source| format!(": {source}")).unwrap_or_default()
    )]
    NoUsers {
        /// The file.
        path: PathBuf,
        /// Why it cannot be read, if it cannot.
        source: Option<std::io::Error>,
    },
    /// The group's name would be a pattern, or a path, among zenoh's keys.
    #[error("[network] group {group:?}: letters, digits, `-`, `_` and `.` only")]
    GroupName {
        /// The name.
        group: String,
    },
    /// A peer has a certificate, but the network requires none.
    #[error(
        "a peer's `certificate` needs a network where both ends show one: TLS with `enable_mtls` in zenoh's file \
         (`network.zenoh`), as in packaging/zenoh-tls.json5"
    )]
    NoCertificates,
    /// A peer has a certificate, but zenoh's file has its own access control.
    #[error(
        "zenoh's file (`network.zenoh`) has an `access_control` of its own: leave out that, or the peers' `certificate`, \
         of which one is made"
    )]
    TwoAccessControls,
    /// Another kind of file is at the status socket's path.
    #[error("{} is there and is no socket: give `status_socket` another name", .path.display())]
    NoSocket {
        /// The path.
        path: PathBuf,
    },
    /// Another process listens on the status socket.
    #[error("another node answers on {}: stop it first", .path.display())]
    AnotherNode {
        /// The socket.
        path: PathBuf,
    },
}

impl From<NodeError> for source::Error {
    fn from(error: NodeError) -> Self {
        Self::Backend(Box::new(error))
    }
}
