//! A page to look at logs, captures and a running node: served to a browser on this machine, or written as one file.
//!
//! | module | what it is |
//! |---|---|
//! | [`View`] | what is looked at, the page's files, and every answer that the page asks for |
//! | `logs` | logs, read once and binned again for each stretch that is looked at |
//! | `links` | the links of captures, evaluated in the background: rows, curves, paths, phases |
//! | `node` | the states of a running node, from its status socket |
//! | [`Server`] | HTTP on one address, and who is let in |
//!
//! The answers are the JSON of the library and of `csi5300_lab` (docs/reference/formats.md), binned. docs/guides/view.md is the guide.
//!
//! # Requests of the page
//!
//! `GET` returns JSON. A page that is one file holds the answers without a query in its element `answers`.
//!
//! * `/data/overview`: `program` (version), `name`, `kind` (`captures`, `logs`, `node`), `logs`, `links` (names), `trajectory`, `has_beside`
//! * `/data/rows?known=N`: links after the first N: as `evaluate --json`, `number`, `set`, `beside` (of `links.csv`); `known`, `of`, `notes`
//! * `/data/sets`: summary of `evaluate --json` by set; `beside`: the other program's
//! * `/data/link/N`: until evaluated: `waiting` (true), `logs`; then `row` (as `evaluate --json`), `receiver` (located), numbers of `logs` (`receiver`, `transmitter`), `drawn`
//! * `/data/log/N`: as `info --json`, `senders` as a list; `span_s`, `subcarriers` (indices), `antennas` (letters), `rssi_in_dbm`
//! * `/data/log/N/levels?from=&to=&columns=&sender=`: from `from_s` to `to_s` in `columns`: `records`, `rate_hz`; `min`, `mean`, `max` of `rssi` and `agc`; (column, count) of `missing`, `damaged`, `skipped`, `repeated`; `gaps_s`, `steps_back`
//! * `/data/log/N/csi?from=&to=&columns=&sender=&antenna=`: column means of every n-th record (`every`); for each `antenna` in `antennas` `amplitude_db`, `phase_rad`; `cells`: bytes in base64, `[row][column]`, 0 `low`, 254 `high`, 255 nothing; `rows` of `subcarriers_a_row` each, with the index of their middle one in `subcarriers`; of other cards kind and width of `frames`, and how many `other_frames` have another one; without `sender=` that of the log's most frequent `sender`
//! * `/data/log/N/levels`, `/data/log/N/csi` of a log replaced, cut or rewritten: status 409; the next `/data/log/N` reads it again, and one that grew
//! * `/data/states`: last 1,200 states of a node
//! * `/events`: server-sent events: `rows`, `state` (of a node), `silent`
//!
//! `drawn` is null without a bearing; long rows are thinned:
//!
//! * `curves`: profiles, the answer's first: `name`, `azimuths_deg`, `values` relative to their highest
//! * `path_m`, `used_m`: (x, y) of the trajectory, of pairs used
//! * `phases`: at `t_s` of all pairs: `one_way_rad` (forward), `round_trip_rad`, `compensated_rad`; at `left_t_s` (from the first pair used) `left_rad`: residual about its mean
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

mod links;
mod logs;
mod node;
mod server;
mod view;

pub use links::Reading;
pub use server::{Ends, Server};
use std::io;
use std::path::{Path, PathBuf};
pub use view::{Answer, View};

/// Why nothing can be shown, or a question of the page has no answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// What was named is not there or cannot be shown, or nothing can be started; in words.
    #[error("{0}")]
    Words(String),
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
    /// A log cannot be read.
    #[error(transparent)]
    Log(#[from] csi5300::source::Error),
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
    /// What was named is not there.
    pub(crate) fn missing(path: &Path, source: &io::Error) -> Self {
        let is_socket = path.extension().is_some_and(|extension| extension == "sock");
        Self::Words(format!("{}: {source}{}", path.display(), if is_socket { "; does the node run?" } else { "" }))
    }

    /// A thread or the server could not be started.
    pub(crate) fn start(what: &str, source: &dyn std::fmt::Display) -> Self {
        Self::Words(format!("cannot start {what}: {source}"))
    }

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

#[cfg(test)]
mod tests {
    use super::Reading;
    use csi5300::pipeline::Options;
    use csi5300::signal::channel::{Channel, Width};
    use csi5300_lab::evaluate::TrajectorySource;

    /// How the tests read captures.
    pub fn reading() -> Reading {
        let options = Options::new(Channel::new(108, Width::Ht20).unwrap());
        let source = TrajectorySource::GroundTruth;
        Reading { source, channel: None, options, antenna_offset_m: None, camera: None }
    }
}
