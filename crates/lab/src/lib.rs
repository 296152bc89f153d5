//! Judging and showing: captures evaluated against their truth, recordings beside simulations, the experiments of
//! Dijkstra et al. (\[paper\] in docs/reference/references.md) repeated, and pictures of all of them.
//!
//! | module | what goes in | what comes out |
//! |---|---|---|
//! | [`evaluate`] | a folder of captures with their truth | a row of each link, errors by set, what the rows are worth |
//! | [`compare`] | a recorded capture, and a simulated one or none | their figures beside each other; a scene fitted to the recording |
//! | [`suite`] | the experiments of \[paper\] as scenes | each repeated and summed up |
//! | [`cards`] | a log of a card other than the 5300 | its kind, and what is counted in it |
//! | [`course`] | a log | CSI, levels and rate over time, binned |
//! | [`curves`] | a bearing | curves over azimuth and time for pictures and pages |
//! | [`table`] | a log | its records in memory: columns, and CSI decoded on demand |
//! | [`export`] | such a table | NPZ, MAT and Parquet files |
//! | [`words`] | counts | them with their nouns |
//! | `show` (feature `plot`) | bearings, rows, figures | pictures (PNG, SVG) |
//!
//! `evaluate`, `compare` and `suite` know nothing of pictures; `show` draws what they give.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

pub mod cards;
pub mod compare;
pub mod course;
pub mod curves;
pub mod ends;
pub mod evaluate;
pub mod export;
pub mod kinds;
#[cfg(feature = "plot")]
pub mod show;
pub mod suite;
pub mod table;
pub mod words;
