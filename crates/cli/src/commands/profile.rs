//! Profiles as files.

use csi5300::bartlett::{self, Grid};
use csi5300::signal::samples::Samples;
use csi5300_lab::export::{ExportError, Npz};
use std::io::{BufWriter, Write};
use std::path::Path;

/// The grid named by `--grid`.
pub fn grid(text: &str) -> Result<Grid, String> {
    const LIMIT: usize = 10_000_000;
    let wrong = || format!("`{text}` is no grid: 360 (azimuths), 360x181 (azimuths x elevations) or wsr");
    let count = |text: &str| text.parse::<usize>().ok().filter(|n| (1..=LIMIT).contains(n)).ok_or_else(wrong);
    match text.split_once('x') {
        _ if text == "wsr" => Ok(Grid::wsr()),
        None => Ok(Grid::azimuth(count(text)?)),
        Some((azimuths, elevations)) => {
            let (azimuths, elevations) = (count(azimuths)?, count(elevations)?);
            let all = azimuths.checked_mul(elevations).filter(|all| *all <= LIMIT);
            all.map(|_| Grid::azimuth_elevation(azimuths, elevations))
                .ok_or_else(|| format!("{text}: over {LIMIT} directions"))
        }
    }
}

/// True for a file that [`write`] can write.
pub fn is_known(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "csv" || extension == "npz")
}

/// Writes the profile of `samples` over `grid` to a .csv (azimuth_deg, elevation_deg, value) or an .npz (arrays
/// `azimuth_deg`, `elevation_deg`, `value`, rows of elevations by columns of azimuths).
///
/// Values are `|f|^2 / (sum |z|)^2`, 0 to 1.
pub fn write(path: &Path, grid: &Grid, samples: &Samples) -> Result<(), String> {
    let profile = bartlett::profile(samples, grid).map_err(|error| error.to_string())?;
    let (rows, columns) = profile.grid.shape();
    let shape = [rows as u64, columns as u64];
    let angles = || (0..profile.values.len()).map(|index| profile.grid.at(index));
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("npz") => {
            let written = || -> Result<(), ExportError> {
                let mut npz = Npz::create(path)?;
                npz.array("azimuth_deg", &shape, angles().map(|(azimuth, _)| azimuth.to_degrees()))?;
                npz.array("elevation_deg", &shape, angles().map(|(_, elevation)| elevation.to_degrees()))?;
                npz.array("value", &shape, profile.values.iter().copied())?;
                npz.finish()
            };
            written().map_err(|error| error.to_string())
        }
        Some("csv") => {
            let failed = |error: std::io::Error| format!("writing {}: {error}", path.display());
            let mut out = BufWriter::new(std::fs::File::create(path).map_err(failed)?);
            writeln!(out, "azimuth_deg,elevation_deg,value").map_err(failed)?;
            for ((azimuth, elevation), value) in angles().zip(&profile.values) {
                writeln!(out, "{:.6},{:.6},{value:.9e}", azimuth.to_degrees(), elevation.to_degrees())
                    .map_err(failed)?;
            }
            out.flush().map_err(failed)
        }
        _ => Err(format!("{}: a profile is written as .csv or .npz", path.display())),
    }
}
