//! Arguments that several commands share.

use clap::Args;
use csi5300::bartlett::SearchOptions;
use csi5300::motion::odometry::csv::Columns;
use csi5300::pipeline::{Accuracy, Effort, Options};
use csi5300::signal::channel::Channel;
use driver_iface::{Mac, bfee::Antenna};
use nalgebra::Vector3;
use std::num::NonZeroUsize;

/// No card hears another one so far away, metres.
const FURTHEST_M: f64 = 1e6;

// How bearings are made.
#[derive(Args, Clone, Debug)]
pub struct Estimation {
    /// Antenna (RF port) used on both robots: A, B or C
    #[arg(long, default_value = "A", value_parser = antenna)]
    pub antenna: Antenna,
    /// Added to the receiver's host time to get the trajectory's
    #[arg(long, default_value_t = 0.0, value_name = "SECONDS", allow_negative_numbers = true)]
    pub clock_offset: f64,
    /// Largest elevation of a transmitter above or below the plane of motion, degrees
    #[arg(long, default_value_t = 20.0, value_name = "DEGREES")]
    pub elevation_max: f64,
    /// Leave out the turn-around compensation
    #[arg(long)]
    pub no_compensation: bool,
    /// Steps to leave out, to see what each brings
    #[arg(long, value_enum, value_delimiter = ',', value_name = "STEP,..")]
    pub without: Vec<Step>,
    /// Leave out every step that cannot move the azimuth by more than this, degrees, and all of them where the plane wave's
    /// error bar is below it; 0 takes every step. Default: a tenth of the error bar
    #[arg(long, value_name = "DEGREES")]
    pub accuracy: Option<f64>,
    /// Shortest distance of a transmitter, metres
    #[arg(long, default_value_t = 1.8, value_name = "METRES")]
    pub range_min: f64,
    /// Height of the transmitter above the receiver's antenna, where known, metres
    #[arg(long, value_name = "METRES", allow_negative_numbers = true)]
    pub height: Option<f64>,
    /// Standard deviation of the heading of the whole trajectory, degrees: 0 for motion capture, about 3 for a tracking
    /// camera, 20 for wheels. Error bars and confidence take it into account
    #[arg(long, value_name = "DEGREES")]
    pub heading_sd: Option<f64>,
    /// Use pairs from this many seconds after the link's first one on
    #[arg(long, value_name = "SECONDS")]
    pub from: Option<f64>,
    /// Use pairs up to this many seconds after the link's first one
    #[arg(long, value_name = "SECONDS")]
    pub to: Option<f64>,
    /// Use only every Nth pair of frames: what bearings of slower sounding would be
    #[arg(long, default_value_t = NonZeroUsize::MIN, value_name = "N")]
    pub decimate: NonZeroUsize,
}

/// A step of the estimate that can be left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Step {
    /// Turn-around compensation
    Compensation,
    /// Alignment of the sampling time from packet to packet
    Alignment,
    /// The one-way channel beside the round trip
    OneWay,
    /// Spherical waves (and with them all subcarriers, alignment and the one-way channel)
    NearField,
    /// The search for the elevation
    Elevation,
    /// Autofocus of the trajectory over all transmitters
    Focus,
    /// The list of paths
    Paths,
}

impl Step {
    /// All that change bearings.
    pub const ALL: [Self; 6] =
        [Self::Compensation, Self::Alignment, Self::OneWay, Self::NearField, Self::Elevation, Self::Focus];
}

impl Default for Estimation {
    fn default() -> Self {
        Self {
            antenna: Antenna::A,
            clock_offset: 0.0,
            elevation_max: 20.0,
            no_compensation: false,
            without: Vec::new(),
            accuracy: None,
            range_min: 1.8,
            height: None,
            heading_sd: None,
            from: None,
            to: None,
            decimate: NonZeroUsize::MIN,
        }
    }
}

impl Estimation {
    /// The pipeline's options, on `channel`.
    pub fn options(&self, channel: Channel) -> Result<Options, String> {
        let finite = [Some(self.clock_offset), Some(self.elevation_max), self.from, self.to];
        if finite.iter().flatten().any(|value| !value.is_finite()) {
            return Err("--clock-offset, --elevation-max, --from and --to take finite numbers".into());
        }
        if !(0.0..=90.0).contains(&self.elevation_max) {
            return Err(format!("--elevation-max {}: 0 to 90 degrees", self.elevation_max));
        }
        if let (Some(from), Some(to)) = (self.from, self.to)
            && from >= to
        {
            return Err(format!("--from {from} is not before --to {to}"));
        }
        let far = |metres: f64| metres.is_nan() || metres.abs() > FURTHEST_M;
        if self.range_min <= 0.0 || far(self.range_min) || self.height.is_some_and(far) {
            return Err("--range-min takes metres, more than 0, --height metres, both of at most 1e6".into());
        }
        if self.heading_sd.is_some_and(|sd| !(0.0..=180.0).contains(&sd)) {
            return Err("--heading-sd takes 0 to 180 degrees".into());
        }
        if self.accuracy.is_some_and(|asked| !(0.0..=180.0).contains(&asked)) {
            return Err("--accuracy takes 0 to 180 degrees".into());
        }
        let effort = match self.accuracy {
            None => Effort::Needed,
            Some(0.0) => Effort::Everything,
            Some(asked) => Effort::Within(asked.to_radians()),
        };
        let left_out = |step| self.without.contains(&step);
        let elevation_max = if left_out(Step::Elevation) { 0.0 } else { self.elevation_max };
        let mut accuracy = Accuracy::default()
            .with_near_field(!left_out(Step::NearField))
            .with_effort(effort)
            .with_range_min_m(self.range_min)
            .with_height_m(self.height);
        accuracy.align = !left_out(Step::Alignment);
        accuracy.one_way = !left_out(Step::OneWay);
        accuracy.focus = !left_out(Step::Focus);
        accuracy.paths = !left_out(Step::Paths);
        let search = SearchOptions::default().with_elevation_max_rad(elevation_max.to_radians());
        Ok(Options::new(channel)
            .with_antenna(self.antenna)
            .with_clock_offset_s(self.clock_offset)
            .with_cut(self.from, self.to)
            .with_decimate(self.decimate)
            .with_compensate(!self.no_compensation && !left_out(Step::Compensation))
            .with_accuracy(accuracy)
            .with_heading_sd_rad(self.heading_sd.map(f64::to_radians))
            .with_search(search))
    }
}

/// What is in the columns of a trajectory.
pub fn columns(text: &str) -> Result<Columns, String> {
    text.parse::<Columns>().map_err(|error| error.to_string())
}

/// An antenna by its letter.
pub fn antenna(text: &str) -> Result<Antenna, String> {
    match text {
        "A" | "a" => Ok(Antenna::A),
        "B" | "b" => Ok(Antenna::B),
        "C" | "c" => Ok(Antenna::C),
        _ => Err("A, B or C".into()),
    }
}

/// A WiFi channel: its number, with `+` or `-` for a 40 MHz pair.
pub fn channel(text: &str) -> Result<Channel, String> {
    let channel = text.parse::<Channel>().map_err(|error| error.to_string())?;
    match channel.number() {
        // 802.11-2016 annex E; 34 to 46 and 184 to 196 were Japan's.
        1..=14 | 34 | 36 | 38 | 40 | 42 | 44 | 46 => Ok(channel),
        48..=64 | 100..=144 | 184..=196 if channel.number().is_multiple_of(4) => Ok(channel),
        149..=177 if channel.number() % 4 == 1 => Ok(channel),
        number => {
            Err(format!("there is no channel {number}: 5 GHz has 36, 40, .. 64, 100, 104, .. 144 and 149, 153, .. 177"))
        }
    }
}

/// A MAC address.
pub fn mac(text: &str) -> Result<Mac, String> {
    text.parse::<Mac>().map_err(|error| error.to_string())
}

/// Three numbers: metres forward, left, up.
pub fn triple(text: &str) -> Result<Vector3<f64>, String> {
    let parts: Vec<f64> =
        text.split(',').map(|part| part.trim().parse::<f64>()).collect::<Result<_, _>>().map_err(|e| e.to_string())?;
    match parts[..] {
        [x, y, z] if parts.iter().all(|p| p.is_finite()) => Ok(Vector3::new(x, y, z)),
        _ => Err("three finite numbers with commas between, in metres".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::channel;

    #[test]
    fn channels_are_those_that_there_are() {
        for text in ["1", "14", "36", "36+", "64", "100", "108", "144", "149", "165", "196"] {
            assert_eq!(channel(text).map(|channel| channel.to_string()), Ok(text.into()));
        }
        for text in ["0", "15", "37", "50", "66", "99", "110", "148", "152", "180", "197", "14+", "x"] {
            let error = channel(text).unwrap_err();
            assert!(error.contains("no channel"), "{text}: {error}");
        }
    }
}
