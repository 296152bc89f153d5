//! Why nothing can be shown.

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;

/// Why nothing can be shown, or a question of the page has no answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// What was named is not there.
    #[error("{}: {source}{}", path.display(), if is_socket(path) { "; does the node run?" } else { "" })]
    Missing {
        /// What was named.
        path: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
    /// What can be read only once, or is no file at all.
    #[error(
        "{} is a pipe or a device: the page reads a log more than once, so write it to a file first", path.display()
    )]
    NoFile {
        /// What was named.
        path: PathBuf,
    },
    /// A log is another one than the page was made of.
    #[error("{} was changed since it was read: load the page again", path.display())]
    Changed {
        /// The log.
        path: PathBuf,
    },
    /// A folder without anything that can be shown.
    #[error("no log and no capture below {}: a log's name ends in .dat, of another card in .csi, .pcap or .csv", path.display())]
    Empty {
        /// The folder.
        path: PathBuf,
    },
    /// A log without an intact CSI record.
    #[error("{}: no intact CSI record in it (`csi5300 info` lists its content)", path.display())]
    NoRecord {
        /// The log.
        path: PathBuf,
    },
    /// A log cannot be read.
    #[error(transparent)]
    Log(#[from] csi5300::source::Error),
    /// Nobody listens on the socket of a node.
    #[error("{}: {source}; does the node run, and is this its `output.status_socket`?", path.display())]
    Node {
        /// The socket.
        path: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
    /// The page cannot be served at this address.
    #[error("cannot listen on {address}: {source}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The system's answer.
        source: io::Error,
    },
    /// A thread or the server could not be started.
    #[error("cannot start {what}: {source}")]
    Start {
        /// What.
        what: &'static str,
        /// The system's answer.
        source: io::Error,
    },
    /// The page requested something that does not exist.
    #[error("nothing at {path}")]
    NoSuch {
        /// The request.
        path: String,
    },
    /// The page asked with a value that cannot be meant.
    #[error("`{name}={value}` cannot be read")]
    Query {
        /// The name of the value.
        name: &'static str,
        /// The value.
        value: String,
    },
    /// An answer could not be written as JSON.
    #[error("cannot write the answer: {0}")]
    Json(#[from] serde_json::Error),
}

impl Error {
    /// The status of the HTTP answer that says this.
    pub(crate) fn status(&self) -> u16 {
        match self {
            Self::NoSuch { .. } => 404,
            Self::Query { .. } => 400,
            Self::Changed { .. } => 409,
            _ => 500,
        }
    }
}

/// True if a path is named like a socket.
fn is_socket(path: &std::path::Path) -> bool {
    path.extension().is_some_and(|extension| extension == "sock")
}
