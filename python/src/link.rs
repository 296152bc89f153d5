//! The evidence of a bearing: its profile, its samples, and both in a pickle.

use crate::error::{Failure, Kind, Stop, interruptible};
use csi5300::bartlett::{self, Grid};
use csi5300::nalgebra::Vector3;
use csi5300::pipeline::Bearing;
use csi5300::signal::samples::Samples;
use num_complex::Complex64;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

/// A link that has a bearing.
#[pyclass(frozen, module = "csi5300._native")]
pub struct Link {
    samples: Arc<Samples>,
    path_m: Vec<Vector3<f64>>,
    /// Per pair: seconds, and radians one way, round trip, compensated.
    course: Vec<[f64; 4]>,
    /// Per exchange: seconds, change of the distance since the first and its deviation, metres. Empty unless requested.
    range_change: Vec<[f64; 3]>,
}

/// Rows of a matrix with this many columns.
fn matrix<'py, const N: usize>(
    py: Python<'py>,
    rows: impl ExactSizeIterator<Item = [f64; N]>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let count = rows.len();
    let values: Vec<f64> = rows.flatten().collect();
    values.into_pyarray(py).reshape([count, N])
}

fn points<'py>(py: Python<'py>, points: &[Vector3<f64>]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    matrix(py, points.iter().map(|p| [p.x, p.y, p.z]))
}

/// The rows of an array with N columns.
fn rows<const N: usize>(array: &PyReadonlyArray2<'_, f64>) -> Result<Vec<[f64; N]>, Failure> {
    let array = array.as_array();
    let row = |row: numpy::ndarray::ArrayView1<'_, f64>| <[f64; N]>::try_from(row.to_vec()).ok();
    array.rows().into_iter().map(row).collect::<Option<_>>().ok_or_else(|| wrong(format!("{N} columns are needed")))
}

fn wrong(why: impl std::fmt::Display) -> Failure {
    Failure::new(Kind::Option, format!("a pickled bearing that is damaged: {why}"))
}

impl Link {
    /// The parts of a bearing that Python requests.
    pub fn new(bearing: Bearing) -> Self {
        let course = bearing.course.iter().map(|p| [p.t_s, p.one_way_rad, p.round_trip_rad, p.compensated_rad]);
        let range_change =
            bearing.range_change.as_ref().and_then(|found| found.as_ref().ok()).map_or_else(Vec::new, |found| {
                let rows = found.t_s.iter().zip(&found.range_change_m).zip(&found.deviation_m);
                rows.map(|((t_s, change), deviation)| [*t_s, *change, *deviation]).collect()
            });
        Self { course: course.collect(), path_m: bearing.path_m, range_change, samples: Arc::new(bearing.samples) }
    }
}

/// The argument of [`Link::restore`].
type Dumped<'py> =
    ((f64, u8), Bound<'py, PyArray1<Complex64>>, Bound<'py, PyArray2<f64>>, [Bound<'py, PyArray2<f64>>; 3]);

#[pymethods]
impl Link {
    /// The profile over a grid: `(azimuths, elevations)` evenly spaced, or directions (n, 2), degrees. Returns azimuths and elevations
    /// (degrees) and values, each (rows, columns).
    #[pyo3(signature = (azimuths, elevations, directions))]
    fn profile<'py>(
        &self,
        py: Python<'py>,
        azimuths: usize,
        elevations: usize,
        directions: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<[Bound<'py, PyArray2<f64>>; 3]> {
        const LIMIT: usize = 10_000_000;
        let grid = match &directions {
            Some(list) => {
                let list = list.as_array();
                let pair = |row: usize| Some((list.get((row, 0))?.to_radians(), list.get((row, 1))?.to_radians()));
                Grid::directions((0..list.nrows()).filter_map(pair).collect())
            }
            None if azimuths.checked_mul(elevations.max(1)).is_none_or(|all| all > LIMIT || all == 0) => {
                return Err(Failure::new(Kind::Option, format!("a grid of 1 to {LIMIT} directions")).into());
            }
            None if elevations < 2 => Grid::azimuth(azimuths),
            None => Grid::azimuth_elevation(azimuths, elevations),
        };
        let samples = Arc::clone(&self.samples);
        // Ten million directions take less than a second.
        let profile = interruptible(py, &Stop::default(), move || {
            bartlett::profile(&samples, &grid).map_err(|error| Failure::new(Kind::Option, error))
        })?;
        let (rows, columns) = profile.grid.shape();
        let angles: Vec<(f64, f64)> = (0..profile.values.len()).map(|index| profile.grid.at(index)).collect();
        let of = |values: Vec<f64>| values.into_pyarray(py).reshape([rows, columns]);
        Ok([
            of(angles.iter().map(|(azimuth, _)| azimuth.to_degrees()).collect())?,
            of(angles.iter().map(|(_, elevation)| elevation.to_degrees()).collect())?,
            of(profile.values)?,
        ])
    }

    /// The samples: `t_s` (n), `z` (n), `receiver_m` (n, 3); the receiver's whole path `path_m`; the phase of each pair (`phase`: seconds,
    /// one way, round trip, compensated, radians); and, if requested, `range_change`: seconds, change of the distance since the first
    /// exchange and its deviation, metres.
    fn samples<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let samples = &self.samples;
        let arrays = PyDict::new(py);
        arrays.set_item("t_s", PyArray1::<f64>::from_slice(py, samples.t_s()))?;
        arrays.set_item("z", PyArray1::<Complex64>::from_slice(py, samples.z()))?;
        arrays.set_item("receiver_m", points(py, samples.receiver_m())?)?;
        arrays.set_item("path_m", points(py, &self.path_m)?)?;
        arrays.set_item("phase", matrix(py, self.course.iter().copied())?)?;
        arrays.set_item("range_change", matrix(py, self.range_change.iter().copied())?)?;
        Ok(arrays)
    }

    /// Wavelength and gain; samples; for each its seconds, the positions of both sides and its weight; path and course.
    fn dump<'py>(&self, py: Python<'py>) -> PyResult<Dumped<'py>> {
        let samples = &self.samples;
        let row = |k: usize| {
            let (own, other) = (samples.receiver_m().get(k)?, samples.transmitter_m().get(k)?);
            let (t_s, weight) = (*samples.t_s().get(k)?, *samples.weight().get(k)?);
            Some([t_s, own.x, own.y, own.z, other.x, other.y, other.z, weight])
        };
        let rows: Vec<[f64; 8]> = (0..samples.len()).filter_map(row).collect();
        let drawn = [
            points(py, &self.path_m)?,
            matrix(py, self.course.iter().copied())?,
            matrix(py, self.range_change.iter().copied())?,
        ];
        let z = PyArray1::from_slice(py, samples.z());
        Ok(((samples.wavelength_m(), samples.path_gain()), z, matrix(py, rows.into_iter())?, drawn))
    }

    /// A link from the result of [`Link::dump`].
    #[staticmethod]
    fn restore(
        carrier: (f64, u8),
        z: PyReadonlyArray1<'_, Complex64>,
        samples: PyReadonlyArray2<'_, f64>,
        drawn: [PyReadonlyArray2<'_, f64>; 3],
    ) -> PyResult<Self> {
        let places = rows::<8>(&samples)?;
        let z: Vec<Complex64> = z.as_array().to_vec();
        if z.len() != places.len() {
            return Err(wrong(format!("{} samples at {} places", z.len(), places.len())).into());
        }
        let mut samples = Samples::new(carrier.0, carrier.1).map_err(wrong)?;
        for (z, [t_s, x, y, up, other_x, other_y, other_up, weight]) in z.into_iter().zip(places) {
            let (own, other) = (Vector3::new(x, y, up), Vector3::new(other_x, other_y, other_up));
            samples.push_weighted(t_s, z, own, other, weight).map_err(wrong)?;
        }
        let [path, course, range_change] = drawn;
        let path_m = rows::<3>(&path)?.into_iter().map(Vector3::from).collect();
        Ok(Self {
            samples: Arc::new(samples),
            path_m,
            course: rows::<4>(&course)?,
            range_change: rows::<3>(&range_change)?,
        })
    }
}
