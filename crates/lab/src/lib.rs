//! Evaluates captures against their truth, compares recordings with simulations, repeats the experiments of Dijkstra et al.
//! (\[paper\] in docs/reference/references.md), and draws pictures of all of them.
//!
//! | module | input | output |
//! |---|---|---|
//! | [`evaluate`] | a folder of captures with their truth | a row for each link, errors by set, quality figures |
//! | [`compare`] | a recorded capture, with or without a simulated one | their figures side by side; a scene fitted to the recording |
//! | [`suite`] | the experiments of \[paper\] as scenes | the results of each, repeated and summarised |
//! | [`cards`] | a log of a card other than the 5300 | its kind and counters |
//! | [`course`] | a log | CSI, levels and rate over time, binned |
//! | [`curves`] | a bearing | curves over azimuth and time for pictures and pages |
//! | [`table`] | a log | its records in memory: columns, and CSI decoded on demand |
//! | [`export`] | such a table | NPZ, MAT and Parquet files |
//! | `show` (feature `plot`) | bearings, rows, figures | pictures (PNG, SVG) |
//!
//! `evaluate`, `compare` and `suite` do not depend on pictures; `show` draws their results.
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
