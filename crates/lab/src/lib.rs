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
pub mod evaluate;
pub mod export;
pub mod kinds;
#[cfg(feature = "plot")]
pub mod show;
pub mod suite;
pub mod table;

/// Why something failed, in words.
pub type Failure = Box<dyn std::error::Error + Send + Sync>;

/// An angle brought into (-180, 180], degrees.
fn wrap_deg(angle_deg: f64) -> f64 {
    csi5300::maths::wrap_rad(angle_deg.to_radians()).to_degrees()
}

#[cfg(test)]
mod temporary {
    use std::path::{Path, PathBuf};
    use std::sync::atomic::{AtomicU32, Ordering};

    /// The receiver's log of the committed capture.
    pub fn fixture() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/small-circle/csi_rx_2023-11-14_221320.dat")
    }

    /// A path of one test alone; what is there is removed at the end.
    pub struct Temporary(pub PathBuf);

    impl Temporary {
        pub fn path(name: &str) -> Self {
            static COUNT: AtomicU32 = AtomicU32::new(0);
            let count = COUNT.fetch_add(1, Ordering::Relaxed);
            Self(std::env::temp_dir().join(format!("csi5300-lab-{}-{count}-{name}", std::process::id())))
        }

        /// A file with these bytes.
        pub fn file(name: &str, bytes: &[u8]) -> Self {
            let file = Self::path(name);
            std::fs::write(&file.0, bytes).unwrap();
            file
        }

        /// An empty folder.
        pub fn folder(name: &str) -> Self {
            let folder = Self::path(name);
            std::fs::create_dir(&folder.0).unwrap();
            folder
        }
    }

    impl Drop for Temporary {
        fn drop(&mut self) {
            let _ = std::fs::remove_file(&self.0).or_else(|_| std::fs::remove_dir_all(&self.0));
        }
    }
}
