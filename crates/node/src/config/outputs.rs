//! What is recorded and published, and the network of the robots.

use std::io::IsTerminal;
use std::path::PathBuf;

/// The log of everything that this robot's card reports.
#[derive(Clone, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Log {
    /// The file, `.dat`; later starts append a number to its name.
    pub file: PathBuf,
    /// Continue in a new file before this size, MiB; more than 0.
    #[serde(default)]
    pub rotate_mib: Option<u64>,
    /// With a checksum of each record in the side file.
    #[serde(default)]
    pub checksums: bool,
}

/// What is published where.
#[derive(Clone, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Output {
    /// Bearings as JSON lines: a file, or `-` for standard output; empty for nowhere. On a terminal, the line of state replaces those of `-`.
    pub bearings: String,
    /// A Unix socket on which the state is published, for `csi5300 watch`.
    pub status_socket: Option<PathBuf>,
    /// One line of state on standard error: on a terminal (`auto`), `always` or `never`.
    pub status_line: StatusLine,
    /// The address for Foxglove's viewers; their default is `127.0.0.1:8765` (feature `foxglove`).
    pub foxglove: Option<std::net::SocketAddr>,
    /// Further web pages that may connect, beside Foxglove's and those of this machine: `https://lichtblick.lab`.
    pub foxglove_origins: Vec<String>,
}

impl Default for Output {
    fn default() -> Self {
        Self {
            bearings: "-".into(),
            status_socket: None,
            status_line: StatusLine::Auto,
            foxglove: None,
            foxglove_origins: Vec::new(),
        }
    }
}

impl Output {
    /// True if the line of state is shown.
    pub(crate) fn shows_line(&self) -> bool {
        match self.status_line {
            StatusLine::Auto => std::io::stderr().is_terminal(),
            StatusLine::Always => true,
            StatusLine::Never => false,
        }
    }
}

/// See [`Output::status_line`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StatusLine {
    /// On a terminal.
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

/// The network of the robots (feature `zenoh`).
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Network {
    /// First part of all keys, so that several groups share a network.
    pub group: String,
    /// Zenoh's own configuration file, for TLS, users, routers; its defaults (peer to peer, discovery) where absent.
    pub zenoh: Option<PathBuf>,
    /// Endpoints to connect to, such as `tcp/192.168.1.10:7447`, beside those that are discovered.
    pub connect: Vec<String>,
    /// Endpoints to listen on. Without any, and without passwords or certificates: a local port.
    pub listen: Vec<String>,
    /// Anybody who reaches this network may join, publish as any robot, and read everything.
    pub insecure: bool,
    /// Publish this robot's records.
    pub publish_records: bool,
    /// Publish this robot's poses.
    pub publish_poses: bool,
    /// Carry the topics of ROS 2 too, for nodes with `rmw_zenoh_cpp`.
    pub ros2: bool,
    /// Limit of a peer's waiting records; further ones are lost and counted.
    pub backlog: Option<usize>,
}
