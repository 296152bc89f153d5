//! Another program's answers on the same links, from a table beside the captures.

use super::TrajectorySource;
use std::collections::BTreeMap;
use std::path::Path;

/// The table's name in the evaluated folder.
pub const TABLE: &str = "links.csv";
/// Its columns that are read.
const COLUMNS: [&str; 5] = ["capture", "tx", "displacement", "peer_est_deg", "peer_err_from_mean_pose_deg"];

/// Another program's answer on a link.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct Beside {
    /// Its azimuth, degrees.
    pub azimuth_deg: f64,
    /// Its error against the bearing from the mean pose, degrees.
    pub error_deg: f64,
}

/// Another program's answers by link name, for one kind of trajectory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    links: BTreeMap<String, Beside>,
    bad_rows: usize,
}

/// Why a table is not used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TableError {
    /// It cannot be read.
    #[error("{TABLE}: {0}")]
    Csv(#[from] csv::Error),
    /// It lacks a needed column.
    #[error("{TABLE} has no column `{column}`: it is skipped")]
    Column {
        /// The missing one.
        column: &'static str,
    },
}

impl Table {
    /// Reads the table of a folder; `None` if there is no such file. Counts rows without numbers.
    ///
    /// # Errors
    /// If the file exists and is not such a table.
    pub fn read(folder: &Path, source: TrajectorySource) -> Result<Option<Self>, TableError> {
        let path = folder.join(TABLE);
        if !path.is_file() {
            return Ok(None);
        }
        let mut reader = csv::ReaderBuilder::new().flexible(true).from_path(path)?;
        let head = reader.headers()?.clone();
        let mut places = [0; COLUMNS.len()];
        for (place, column) in places.iter_mut().zip(COLUMNS) {
            *place = head.iter().position(|name| name == column).ok_or(TableError::Column { column })?;
        }
        let displacement = match source {
            TrajectorySource::GroundTruth => "gt",
            TrajectorySource::T265 | TrajectorySource::RollingT265 => "t265",
            TrajectorySource::Odometry => "odom",
        };
        let mut table = Self::default();
        for row in reader.records() {
            let Ok(row) = row else {
                table.bad_rows += 1;
                continue;
            };
            let [capture, tx, kind, azimuth, error] = places.map(|place| row.get(place).unwrap_or_default());
            if kind != displacement {
                continue;
            }
            let number = |text: &str| text.trim().parse::<f64>().ok().filter(|value| value.is_finite());
            match number(azimuth).zip(number(error)) {
                Some((azimuth_deg, error_deg)) => {
                    table.links.insert(format!("{capture}/{tx}"), Beside { azimuth_deg, error_deg });
                }
                None => table.bad_rows += 1,
            }
        }
        Ok(Some(table))
    }

    /// [`Self::read`] with a message about a skipped table or skipped rows; both are losses.
    #[must_use]
    pub fn noted(folder: &Path, source: TrajectorySource) -> (Option<Self>, Option<String>) {
        let said = |words: String| Some(format!("{}: {words}", folder.display()));
        match Self::read(folder, source) {
            Err(error) => (None, said(error.to_string())),
            Ok(Some(table)) if table.bad_rows > 0 => {
                let rows = crate::words::count(table.bad_rows as u64, "row", "rows");
                (Some(table), said(format!("{TABLE}: {rows} without numbers skipped")))
            }
            Ok(table) => (table, None),
        }
    }

    /// The answer on a link.
    #[must_use]
    pub fn of(&self, link: &str) -> Option<Beside> {
        self.links.get(link).copied()
    }

    /// Rows that could not be read or lack numbers.
    #[must_use]
    pub fn bad_rows(&self) -> usize {
        self.bad_rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_found_by_name_and_trajectory_and_bad_rows_are_counted() {
        let folder = std::env::temp_dir().join(format!("csi5300-beside-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        assert_eq!(Table::read(&folder, TrajectorySource::GroundTruth).unwrap(), None);
        let rows = "tx,capture,displacement,other,peer_est_deg,peer_err_from_mean_pose_deg\n\
                    tx2,A/L1/x,gt,1,132.8,5.9\ntx2,A/L1/x,t265,1,125.8,-1.0\ntx3,A/L1/x,gt,1,,\ntx4,A/L1/x,gt\n";
        std::fs::write(folder.join(TABLE), rows).unwrap();
        let table = Table::read(&folder, TrajectorySource::GroundTruth).unwrap().unwrap();
        assert_eq!(table.of("A/L1/x/tx2"), Some(Beside { azimuth_deg: 132.8, error_deg: 5.9 }));
        assert_eq!((table.of("A/L1/x/tx3"), table.bad_rows()), (None, 2));
        let (noted, note) = Table::noted(&folder, TrajectorySource::GroundTruth);
        assert!(noted == Some(table) && note.unwrap().ends_with("links.csv: 2 rows without numbers skipped"));
        let camera = Table::read(&folder, TrajectorySource::T265).unwrap().unwrap();
        assert_eq!(camera.of("A/L1/x/tx2").map(|beside| beside.error_deg), Some(-1.0));
        assert_eq!(Table::noted(&folder, TrajectorySource::T265), (Some(camera), None));
        std::fs::write(folder.join(TABLE), "a,b\n1,2\n").unwrap();
        let error = Table::read(&folder, TrajectorySource::GroundTruth).unwrap_err();
        assert!(error.to_string().contains("no column `capture`"), "{error}");
        let (noted, note) = Table::noted(&folder, TrajectorySource::GroundTruth);
        assert!(noted.is_none() && note.unwrap().contains("no column `capture`"));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
