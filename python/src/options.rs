//! Options of bearings: keyword arguments with the names of the command line's options.

use crate::error::{Failure, Kind};
use csi5300::motion::odometry::csv::Columns;
use csi5300::motion::pose::{Mount, Trajectory};
use csi5300::nalgebra::Vector3;
use csi5300::pipeline::{Accuracy, Effort, JoinBy, Options};
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::{Error, read_key};
use csi5300_lab::table::antennas;
use driver_iface::Mac;
use serde::Deserialize;
use std::num::NonZeroUsize;
use std::path::PathBuf;

/// Steps that can be skipped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Step {
    Compensation,
    Alignment,
    OneWay,
    NearField,
    Elevation,
}

/// What can be fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Fit {
    Odometry,
}

/// Keyword arguments from JSON; absent ones have their defaults.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Keywords {
    channel: Option<String>,
    antenna: Option<String>,
    clock_offset: Option<f64>,
    elevation_max: Option<f64>,
    no_compensation: bool,
    without: Vec<Step>,
    accuracy: Option<f64>,
    range_min: Option<f64>,
    height: Option<f64>,
    heading_sd: Option<f64>,
    from_: Option<f64>,
    to: Option<f64>,
    decimate: Option<usize>,
    join_rows: bool,
    /// Position of the antenna on the receiver, metres forward, left, up.
    pub antenna_offset: Option<[f64; 3]>,
    /// Position of the tracking camera, metres forward and left of the middle between the wheels, and its heading minus the robot's,
    /// degrees.
    camera_mount: Option<[f64; 3]>,
    /// Bearings less likely than this to be within 5 degrees are refused, 0 to 1.
    pub min_confidence: Option<f64>,
    /// Length of the stretches for which links are answered separately, seconds.
    pub every: Option<f64>,
    /// Whether answers include the plan of the computation.
    pub explain: bool,
    /// Whether links include the change of the distance.
    range_change: bool,
    /// What is fitted before bearings.
    fit: Option<Fit>,
    key: Option<PathBuf>,
    /// The columns of trajectories.
    columns: Option<String>,
    tx_mac: Vec<String>,
    rx_mac: Option<String>,
    /// Links estimated in parallel; 0 means one per core.
    pub threads: usize,
}

/// Columns by their names.
///
/// # Errors
/// If a name is unknown, or time, x or y is missing.
pub fn columns(text: Option<&str>) -> Result<Option<Columns>, Failure> {
    text.map(|text| text.parse::<Columns>().map_err(|error| wrong(format!("columns: {error}")))).transpose()
}

fn wrong(message: impl ToString) -> Failure {
    Failure::new(Kind::Option, message)
}

impl Keywords {
    /// From JSON.
    ///
    /// # Errors
    /// For an unknown name or a value of the wrong type, with the name.
    pub fn parse(json: &str) -> Result<Self, Failure> {
        serde_json::from_str(json).map_err(|error| wrong(format!("options: {error}")))
    }

    /// The named columns of trajectories, if any.
    ///
    /// # Errors
    /// If a name is unknown, or time, x or y is missing.
    pub fn columns(&self) -> Result<Option<Columns>, Failure> {
        columns(self.columns.as_deref())
    }

    /// The named channel, if any.
    ///
    /// # Errors
    /// If there is no such channel.
    pub fn channel(&self) -> Result<Option<Channel>, Failure> {
        let parse = |text: &String| text.parse::<Channel>().map_err(|error| wrong(format!("channel: {error}")));
        self.channel.as_ref().map(parse).transpose()
    }

    /// The pipeline's options, on the named channel or, if there is none, a placeholder.
    ///
    /// # Errors
    /// For a value outside its range, with its name.
    pub fn options(&self) -> Result<Options, Failure> {
        self.check()?;
        let channel = self.channel()?.map_or_else(|| Channel::new(108, Width::Ht20).map_err(wrong), Ok)?;
        let mac = |name: &str, text: &String| text.parse::<Mac>().map_err(|error| wrong(format!("{name}: {error}")));
        let decimate =
            NonZeroUsize::new(self.decimate.unwrap_or(1)).ok_or_else(|| wrong("decimate: 0 is not 1 or more"))?;
        let mut options = Options {
            from_s: self.from_,
            to_s: self.to,
            decimate,
            compensate: !self.no_compensation && !self.left_out(Step::Compensation),
            accuracy: self.accuracy(),
            range_change: self.range_change,
            fit_odometry: self.fit.is_some(),
            heading_sd_rad: self.heading_sd.map(f64::to_radians),
            clock_offset_s: self.clock_offset.unwrap_or(0.0),
            join: if self.join_rows { JoinBy::Row } else { JoinBy::Time },
            rx_mac: self.rx_mac.as_ref().map(|text| mac("rx_mac", text)).transpose()?,
            tx_macs: self.tx_mac.iter().map(|text| mac("tx_mac", text)).collect::<Result<_, _>>()?,
            ..Options::new(channel)
        };
        if let Some(text) = &self.antenna {
            let one =
                antennas(text).filter(|antennas| antennas.len() == 1).and_then(|antennas| antennas.first().copied());
            options.antenna = one.ok_or_else(|| wrong(format!("antenna: {text:?} is not A, B or C")))?;
        }
        if let Some(path) = &self.key {
            let refused = |error: Error| {
                let unread = matches!(error, Error::Io { .. } | Error::NotAFile { .. });
                Failure::new(if unread { Kind::OptionFile } else { Kind::Option }, format!("key: {error}"))
            };
            options.key = Some(read_key(path).map_err(refused)?);
        }
        Ok(options)
    }

    /// The mount of the robot's tracking camera, if given.
    pub fn camera(&self) -> Option<Mount> {
        let [x, y, yaw] = self.camera_mount?;
        Some(Mount { offset_m: Vector3::new(x, y, 0.0), yaw_rad: yaw.to_radians() })
    }

    /// The antenna's trajectory, computed from the recorded one.
    ///
    /// # Errors
    /// If the recorded one has no heading.
    pub fn of_antenna(&self, recorded: Trajectory) -> Result<Trajectory, Failure> {
        let moved = recorded.of_antenna(self.camera(), self.antenna_offset.map(Vector3::from));
        moved.map_err(|error| Failure::new(Kind::Trajectory, error))
    }

    /// Refuses options that apply to single bearings but not to captures with a truth.
    ///
    /// # Errors
    /// With the name of the option.
    pub fn of_captures(&self) -> Result<(), Failure> {
        let given = [
            ("min_confidence", self.min_confidence.is_some()),
            ("columns", self.columns.is_some()),
            ("every", self.every.is_some()),
            ("explain", self.explain),
            ("key", self.key.is_some()),
            ("tx_mac", !self.tx_mac.is_empty()),
            ("rx_mac", self.rx_mac.is_some()),
        ];
        match given.iter().find(|(_, is_given)| *is_given) {
            Some((name, _)) => Err(wrong(format!("{name}: an option of bearings, not of an evaluation"))),
            None => Ok(()),
        }
    }

    fn left_out(&self, step: Step) -> bool {
        self.without.contains(&step)
    }

    fn accuracy(&self) -> Accuracy {
        let effort = match self.accuracy {
            None => Effort::Needed,
            Some(0.0) => Effort::Everything,
            Some(degrees) => Effort::Within(degrees.to_radians()),
        };
        let elevation_max = self.elevation_max.map(f64::to_radians);
        let mut accuracy = Accuracy {
            near_field: !self.left_out(Step::NearField),
            effort,
            elevation_max_rad: if self.left_out(Step::Elevation) { Some(0.0) } else { elevation_max },
            range_min_m: self.range_min,
            height_m: self.height,
            ..Accuracy::default()
        };
        accuracy.align = !self.left_out(Step::Alignment);
        accuracy.one_way = !self.left_out(Step::OneWay);
        accuracy
    }

    fn check(&self) -> Result<(), Failure> {
        let finite =
            [("clock_offset", self.clock_offset), ("from_", self.from_), ("to", self.to), ("height", self.height)];
        if let Some((name, _)) = finite.iter().find(|(_, value)| value.is_some_and(|value| !value.is_finite())) {
            return Err(wrong(format!("{name}: not a finite number")));
        }
        let within = |name: &str, value: Option<f64>, least: f64, most: f64| match value {
            Some(value) if !(least..=most).contains(&value) => {
                Err(wrong(format!("{name}: {value} is not {least} to {most}")))
            }
            _ => Ok(()),
        };
        within("elevation_max", self.elevation_max, 0.0, 90.0)?;
        within("heading_sd", self.heading_sd, 0.0, 180.0)?;
        within("accuracy", self.accuracy, 0.0, 180.0)?;
        within("min_confidence", self.min_confidence, 0.0, 1.0)?;
        if let Some(value) = self.every.filter(|value| *value <= 0.0) {
            return Err(wrong(format!("every: {value} is not above 0")));
        }
        within("every", self.every, 0.0, 1e9)?;
        for (name, numbers) in [("antenna_offset", self.antenna_offset), ("camera_mount", self.camera_mount)] {
            if numbers.is_some_and(|numbers| numbers.iter().any(|number| !number.is_finite())) {
                return Err(wrong(format!("{name}: three finite numbers")));
            }
        }
        if self.camera_mount.is_some() && self.antenna_offset.is_none() {
            return Err(wrong("camera_mount: also needs antenna_offset, relative to the middle between the wheels"));
        }
        if self.every.is_some() && self.join_rows {
            return Err(wrong("every: stretches have no rows to join by (join_rows)"));
        }
        within("range_min", self.range_min, 0.01, 1e6)?;
        if self.from_.zip(self.to).is_some_and(|(from, to)| from >= to) {
            return Err(wrong("from_ is not before to"));
        }
        Ok(())
    }
}
