//! Pictures of links, sets and comparisons, 1200 px wide, each as a PNG and an SVG.
//!
//! | file | what it shows |
//! |---|---|
//! | [`link`] | a link: [`link::LinkPictures`] |
//! | [`log`] | a log over time: heat maps of CSI, levels, rate, losses |
//! | [`set`] | an evaluation: error distributions, refusals, reliability, a map of each place |
//! | [`compared`] | a recording and a simulation side by side |
//! | [`repeated`] | the phase of stationary robots |
//! | `phase`, `profile`, `place`, `plane`, `curves`, `reliability` | the kinds of picture |
//! | `format` | the files of a picture |
//! | `canvas`, `axes` | lines, text, legends, ticks; the only files that use the drawing library |
//!
//! Every kind of picture is a struct with public fields and one `write(stem, format)`. It adds `.png` and `.svg` to `stem`,
//! creates missing folders, and returns the paths. Values that are not finite are dropped; a picture without values is
//! [`Error::Empty`]. Colours are those of Okabe and Ito (2008), safe for colour-blind readers; legends are above the axes,
//! never on the data. Azimuths count from +x towards +y.
mod axes;
mod canvas;
pub mod compared;
mod curves;
mod format;
pub mod link;
pub mod log;
mod phase;
mod place;
mod plane;
mod profile;
mod reliability;
pub mod repeated;
pub mod set;

pub use curves::{CdfPlot, ScatterLines};
pub use format::Format;
pub use phase::{PhasePlot, PhaseTrack};
pub use place::PlaceMap;
pub use plane::{Ellipse, MapPlot, Ray, RayClass, TrajectoryPlot};
pub use profile::{ProfileMap, ProfilePlot};
pub use reliability::{ReliabilityPlot, ReliabilityPoint};
use std::path::PathBuf;

/// Why a picture was not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// No finite value to draw.
    #[error("{what}: no finite value to draw; check that the estimator produced output")]
    Empty {
        /// The empty part of the picture.
        what: &'static str,
    },
    /// Fields that must have the same length do not.
    #[error("{what}: {got} values where {expect} were expected")]
    Length {
        /// The wrong field.
        what: &'static str,
        /// The length of the other fields.
        expect: usize,
        /// Its length.
        got: usize,
    },
    /// The folder or file could not be written.
    #[error("cannot write {}: {source}; check the folder and its rights", path.display())]
    Io {
        /// What was being written.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file of this name leads to one that must never be replaced.
    #[error("{} leads to an input file: name another folder", path.display())]
    Kept {
        /// The file.
        path: PathBuf,
    },
    /// A file of this name exists and may not be replaced.
    #[error("{} already exists", path.display())]
    There {
        /// The file.
        path: PathBuf,
    },
    /// The folder of a link's pictures could not be created.
    #[error("cannot make the folder {folder}: {source}")]
    Folder {
        /// The folder.
        folder: String,
        /// The operating system's answer.
        source: std::io::Error,
    },
    /// A profile could not be computed.
    #[error(transparent)]
    Profile(#[from] csi5300::bartlett::Error),
    /// The rasteriser failed.
    #[error("drawing failed: {0}")]
    Drawing(String),
}

/// A link name as a file name: keeps letters, digits, `.` and `-`, and replaces everything else (`/`, `:`, spaces) and a leading
/// dot by `_`, so that no hidden file or `..` results. Never empty.
pub fn file_safe(name: &str) -> String {
    let keep = |c: char| if c.is_alphanumeric() || matches!(c, '.' | '-') { c } else { '_' };
    let safe: String = name.chars().map(keep).collect();
    match safe.strip_prefix('.') {
        Some(rest) => format!("_{rest}"),
        None if safe.is_empty() => "_".into(),
        None => safe,
    }
}

#[cfg(test)]
mod tests;
