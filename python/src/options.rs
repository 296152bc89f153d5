//! How bearings are made: keyword arguments with the names of the command line's options.

use crate::error::{Failure, Kind};
use csi5300::bartlett::SearchOptions;
use csi5300::pipeline::{Accuracy, JoinBy, Options};
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::read_key;
use csi5300_lab::table::antennas;
use driver_iface::Mac;
use serde::Deserialize;
use std::path::PathBuf;

/// Steps that can be left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Step {
    Compensation,
    Alignment,
    OneWay,
    NearField,
    Elevation,
    Focus,
    Paths,
}

/// Keyword arguments, as JSON brings them; what is absent is as by default.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Keywords {
    channel: Option<String>,
    antenna: Option<String>,
    clock_offset: Option<f64>,
    elevation_max: Option<f64>,
    no_compensation: bool,
    without: Vec<Step>,
    range_min: Option<f64>,
    height: Option<f64>,
    heading_sd: Option<f64>,
    from_: Option<f64>,
    to: Option<f64>,
    join_rows: bool,
    /// Place of the antenna on the receiver, metres forward, left, up.
    pub antenna_offset: Option<[f64; 3]>,
    key: Option<PathBuf>,
    tx_mac: Vec<String>,
    rx_mac: Option<String>,
    /// Links worked on at a time; 0 is one a core.
    pub threads: usize,
}

fn wrong(message: impl ToString) -> Failure {
    Failure::new(Kind::Option, message)
}

impl Keywords {
    /// From JSON.
    ///
    /// # Errors
    /// For an unknown name and a value of another kind, with its name.
    pub fn parse(json: &str) -> Result<Self, Failure> {
        serde_json::from_str(json).map_err(|error| wrong(format!("options: {error}")))
    }

    /// The channel, where one was named.
    ///
    /// # Errors
    /// If there is no such channel.
    pub fn channel(&self) -> Result<Option<Channel>, Failure> {
        let parse = |text: &String| text.parse::<Channel>().map_err(|error| wrong(format!("channel: {error}")));
        self.channel.as_ref().map(parse).transpose()
    }

    /// The pipeline's options, on the channel named or, where none is, on a stand-in.
    ///
    /// # Errors
    /// For a value out of its range, with its name.
    pub fn options(&self) -> Result<Options, Failure> {
        self.check()?;
        let channel = self.channel()?.map_or_else(|| Channel::new(108, Width::Ht20).map_err(wrong), Ok)?;
        let mac = |name: &str, text: &String| text.parse::<Mac>().map_err(|error| wrong(format!("{name}: {error}")));
        let mut options = Options::new(channel)
            .with_cut(self.from_, self.to)
            .with_compensate(!self.no_compensation && !self.left_out(Step::Compensation))
            .with_accuracy(self.accuracy())
            .with_heading_sd_rad(self.heading_sd.map(f64::to_radians))
            .with_search(self.search())
            .with_clock_offset_s(self.clock_offset.unwrap_or(0.0))
            .with_join(if self.join_rows { JoinBy::Row } else { JoinBy::Time })
            .with_macs(
                self.rx_mac.as_ref().map(|text| mac("rx_mac", text)).transpose()?,
                self.tx_mac.iter().map(|text| mac("tx_mac", text)).collect::<Result<_, _>>()?,
            );
        if let Some(text) = &self.antenna {
            let one =
                antennas(text).filter(|antennas| antennas.len() == 1).and_then(|antennas| antennas.first().copied());
            options = options.with_antenna(one.ok_or_else(|| wrong(format!("antenna: {text:?} is not A, B or C")))?);
        }
        if let Some(path) = &self.key {
            options = options.with_key(Some(read_key(path).map_err(wrong)?));
        }
        Ok(options)
    }

    fn left_out(&self, step: Step) -> bool {
        self.without.contains(&step)
    }

    fn accuracy(&self) -> Accuracy {
        let mut accuracy =
            Accuracy::default().with_near_field(!self.left_out(Step::NearField)).with_height_m(self.height);
        if let Some(range_min) = self.range_min {
            accuracy = accuracy.with_range_min_m(range_min);
        }
        accuracy.align = !self.left_out(Step::Alignment);
        accuracy.one_way = !self.left_out(Step::OneWay);
        accuracy.focus = !self.left_out(Step::Focus);
        accuracy.paths = !self.left_out(Step::Paths);
        accuracy
    }

    fn search(&self) -> SearchOptions {
        let search = SearchOptions::default();
        match self.elevation_max {
            _ if self.left_out(Step::Elevation) => search.with_elevation_max_rad(0.0),
            Some(degrees) => search.with_elevation_max_rad(degrees.to_radians()),
            None => search,
        }
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
        within("range_min", self.range_min, f64::MIN_POSITIVE, 1e6)?;
        if self.from_.zip(self.to).is_some_and(|(from, to)| from >= to) {
            return Err(wrong("from_ is not before to"));
        }
        Ok(())
    }
}
