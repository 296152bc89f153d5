//! Simulated rooms, in memory.

use crate::capture::pose_array;
use crate::error::{Failure, Kind, Stop, interruptible};
use csi5300::signal::channel::{Channel, Width};
use csi5300_sim::scene::Driver;
use csi5300_sim::{Room, Scene, SceneError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::path::Path;

/// A scene: JSON of its values, a file, or the name of a built-in one.
fn scene(text: &str, is_json: bool) -> Result<Scene, Failure> {
    if is_json {
        return serde_json::from_str(text).map_err(|error| Failure::new(Kind::Scene, format!("the scene: {error}")));
    }
    Scene::find(Path::new(text)).map_err(|error| refused(&error, text))
}

fn refused(error: &SceneError, name: &str) -> Failure {
    let is_file = matches!(error, SceneError::Io { .. } | SceneError::Nowhere { .. });
    Failure::new(if is_file { Kind::SceneFile } else { Kind::Scene }, error.to_string()).of(name)
}

/// Runs a scene: channel, initiators, and for each robot its name, MAC, log, true path and injected faults.
#[pyfunction]
#[pyo3(signature = (text, is_json, seed=None, layout=None))]
pub fn simulate<'py>(
    py: Python<'py>,
    text: &str,
    is_json: bool,
    seed: Option<u64>,
    layout: Option<&str>,
) -> PyResult<(String, Vec<usize>, Vec<Bound<'py, PyDict>>)> {
    let mut scene = scene(text, is_json)?;
    scene.seed = seed.unwrap_or(scene.seed);
    scene.driver = match layout {
        None => scene.driver,
        Some("wsr") => Driver::Wsr,
        Some("stock") => Driver::Stock,
        Some(other) => return Err(Failure::new(Kind::Option, format!("layout: {other:?} is not wsr or stock")).into()),
    };
    // The number of a wider channel is that of its centre, which may be none of 20 MHz.
    let centre = Channel::new(scene.channel.into(), Width::Ht20).ok().filter(|_| scene.bandwidth_mhz > 20);
    let channel = centre.map_or(scene.channel.to_string(), |own| format!("{:.0}MHz", 1e-6 * own.centre_hz()));
    let initiators = scene.initiators();
    let stop = Stop::default();
    let asked = stop.clone();
    let run = interruptible(py, &stop, move || {
        let room = Room::new(&scene).map_err(|error| Failure::new(Kind::Scene, error))?;
        room.run_while(|_| !asked.is_asked()).map_err(|error| Failure::new(Kind::Scene, error))
    })?;
    let robot = |robot: &csi5300_sim::SimulatedRobot| {
        let values = PyDict::new(py);
        values.set_item("name", &robot.name)?;
        values.set_item("mac", robot.mac.to_string())?;
        values.set_item("log", PyBytes::new(py, &robot.log))?;
        values.set_item("records", robot.records)?;
        values.set_item("injected", robot.injected.to_string())?;
        let path = robot.true_path.as_ref().map(|path| pose_array(py, path)).transpose()?;
        values.set_item("path", path)?;
        Ok(values)
    };
    Ok((channel, initiators, run.robots.iter().map(robot).collect::<PyResult<_>>()?))
}
