//! Arguments that several commands share, and how commands on folders of captures read them.

use super::{InWords, usage};
use clap::Args;
use csi5300::motion::pose::{Mount, Trajectory};
use csi5300::pipeline::{Accuracy, ChainConstant, JoinBy, Options};
use csi5300::signal::channel::{Channel, Width};
use csi5300_lab::evaluate::{Capture, TrajectorySource, find_all};
use csi5300_view::Reading;
use driver_iface::bfee::Antenna;
use nalgebra::Vector3;
use std::net::SocketAddr;
use std::path::Path;

/// No card hears another one at this distance, metres.
pub const FURTHEST_M: f64 = 1e6;

// How bearings are made.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "How bearings are made")]
pub struct Estimation {
    /// Antenna (RF port) used on both robots: A, B or C. With --baseline, two or three of one robot: A,B
    #[arg(
        long,
        visible_alias = "antennas",
        default_value = "A",
        value_delimiter = ',',
        value_parser = one_of_antennas,
        hide_short_help = true
    )]
    pub antenna: Vec<Antenna>,
    /// The trajectory's clock minus the receiver's host clock; `rows` joins the n-th frame of a link with the n-th row
    #[arg(
        long,
        default_value = "0",
        value_name = "SECONDS",
        value_parser = clock_offset,
        allow_negative_numbers = true,
        hide_short_help = true
    )]
    pub clock_offset: (f64, JoinBy),
    /// Largest elevation of a transmitter above or below the horizon [default: 20; more where the signals show it]
    #[arg(long, value_name = "DEGREES", hide_short_help = true)]
    pub elevation_max: Option<f64>,
    /// Shortest distance of a transmitter [default: 1.8; less where the signals show it]
    #[arg(long, value_name = "METRES", hide_short_help = true)]
    pub range_min: Option<f64>,
    /// Height of the transmitter above the receiver's antenna, if known
    #[arg(long, value_name = "METRES", allow_negative_numbers = true, hide_short_help = true)]
    pub height: Option<f64>,
    /// Standard deviation of the trajectory's heading: 0.3 for motion capture or an unknown sensor, about 4 for a tracking
    /// camera, 20 for wheels (1.5 if the antenna's place is known). Error bars, ranges and confidence include it
    #[arg(long, value_name = "DEGREES", hide_short_help = true)]
    pub heading_sd: Option<f64>,
    /// Use pairs from this many seconds after the link's first pair
    #[arg(long, value_name = "SECONDS", hide_short_help = true)]
    pub from: Option<f64>,
    /// Use pairs up to this many seconds after the link's first pair
    #[arg(long, value_name = "SECONDS", hide_short_help = true)]
    pub to: Option<f64>,
}

impl Estimation {
    /// The antenna on both robots, or the first of several.
    pub fn antenna(&self) -> Antenna {
        self.antenna.first().copied().unwrap_or(Antenna::A)
    }

    /// Reports the deviation of the heading where no option and no name tells it.
    pub fn say_heading(&self, path: &Path, trajectory: &Trajectory, is_mounted: bool) {
        let words = match trajectory.frame() {
            _ if self.heading_sd.is_some() => return,
            "odom" => {
                "nothing names its sensor, so its heading is taken for motion capture's: --heading-sd 4 is a tracking camera's, \
                 1.5 that of wheels with --antenna-offset, 20 without"
            }
            "wheel_odom" if !is_mounted => "of wheels, without --antenna-offset: error bars include 20 degrees",
            _ => return,
        };
        csi5300_say::note!("{}: {words}", path.display());
    }

    /// The pipeline's options, on `channel`.
    pub fn options(&self, channel: Channel) -> Result<Options, String> {
        let (clock_offset_s, join) = self.clock_offset;
        let finite = [Some(clock_offset_s), self.elevation_max, self.from, self.to];
        if finite.iter().flatten().any(|value| !value.is_finite()) {
            return Err("--clock-offset, --elevation-max, --from and --to take finite numbers".into());
        }
        if let Some(asked) = self.elevation_max.filter(|asked| !(0.0..=90.0).contains(asked)) {
            return Err(format!("--elevation-max {asked}: 0 to 90 degrees"));
        }
        if let (Some(from), Some(to)) = (self.from, self.to)
            && from >= to
        {
            return Err(format!("--from {from} is not before --to {to}"));
        }
        let far = |metres: f64| metres.is_nan() || metres.abs() > FURTHEST_M;
        if self.range_min.is_some_and(|near| near < 0.01 || far(near)) || self.height.is_some_and(far) {
            return Err("--range-min takes 0.01 to 1e6 metres, --height at most 1e6".into());
        }
        if self.heading_sd.is_some_and(|sd| !(0.0..=180.0).contains(&sd)) {
            return Err("--heading-sd takes 0 to 180 degrees".into());
        }
        let accuracy = Accuracy {
            elevation_max_rad: self.elevation_max.map(f64::to_radians),
            range_min_m: self.range_min,
            height_m: self.height,
            ..Accuracy::default()
        };
        Ok(Options {
            antenna: self.antenna(),
            clock_offset_s,
            join,
            from_s: self.from,
            to_s: self.to,
            accuracy,
            heading_sd_rad: self.heading_sd.map(f64::to_radians),
            ..Options::new(channel)
        })
    }
}

/// Seconds that are added to the frames' times, or `rows`: the n-th frame belongs to the n-th row.
fn clock_offset(text: &str) -> Result<(f64, JoinBy), String> {
    match text {
        "rows" => Ok((0.0, JoinBy::Row)),
        _ => text.parse().map(|seconds| (seconds, JoinBy::Time)).map_err(|_| "seconds, or `rows`".into()),
    }
}

/// An antenna by its letter.
pub fn antenna(text: &str) -> Result<Antenna, String> {
    let named = |antenna: &Antenna| antenna.to_string().eq_ignore_ascii_case(text);
    Antenna::ALL.into_iter().find(named).ok_or_else(|| "A, B or C".into())
}

fn one_of_antennas(text: &str) -> Result<Antenna, String> {
    antenna(text).map_err(|words| format!("{words}; separate several by commas: A,B"))
}

/// A channel that an Intel 5300 can be set to, by its number.
pub fn channel_of_5300(text: &str) -> Result<Channel, String> {
    if text.ends_with("MHz") {
        return Err(
            "an Intel 5300 has channels of 20 and 40 MHz at 2.4 and 5 GHz: give the number, for example 64".into()
        );
    }
    text.parse().in_words()
}

/// An address of this machine with a port.
pub fn address(text: &str) -> Result<SocketAddr, String> {
    let port = text.trim_start_matches(':').parse::<u16>().map_or_else(|_| "8080".to_owned(), |port| port.to_string());
    text.parse().map_err(|_| {
        format!(
            "an IP address and a port, such as 127.0.0.1:{port} (this machine only), 0.0.0.0:{port} or [::1]:{port}"
        )
    })
}

/// The place of an antenna seen from another one, and the constant between their chains if known.
#[derive(Clone, Copy, Debug)]
pub struct Baseline {
    pub metres: Vector3<f64>,
    pub constant: Option<ChainConstant>,
}

/// Three numbers, metres forward, left, up; then optionally degrees and their deviation.
pub fn baseline(text: &str) -> Result<Baseline, String> {
    let (metres, angles) = match numbers(text).as_deref() {
        Some(&[x, y, z, ref angles @ ..]) if angles.len() <= 2 => (Vector3::new(x, y, z), angles.to_vec()),
        _ => return Err("X,Y,Z in metres, then a constant and its deviation in degrees at most".into()),
    };
    let constant = angles.first().map(|deg| {
        let sd_deg = angles.get(1).copied().unwrap_or(0.0);
        ChainConstant { rad: deg.to_radians(), sd_rad: sd_deg.to_radians() }
    });
    Ok(Baseline { metres, constant })
}

/// Finite numbers separated by commas.
pub fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split(',').map(|part| part.trim().parse().ok().filter(|number: &f64| number.is_finite())).collect()
}

/// Three numbers: metres forward, left, up.
fn triple(text: &str) -> Result<Vector3<f64>, String> {
    match numbers(text).as_deref() {
        Some(&[x, y, z]) => Ok(Vector3::new(x, y, z)),
        _ => Err("three finite numbers in metres, separated by commas".into()),
    }
}

// Places of antenna and camera on the robot.
#[derive(clap::Args, Clone, Default)]
pub struct Mounting {
    /// Position of the antenna relative to the tracked point: metres forward, left, up
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_negative_numbers = true, allow_hyphen_values = true)]
    pub antenna_offset: Option<Vector3<f64>>,
    /// Position of the tracking camera: metres forward and left of the middle between the wheels, and its heading minus the
    /// robot's, degrees. --antenna-offset is then relative to that middle, and only rolling motion is kept
    #[arg(
        long,
        value_name = "X,Y,YAW",
        value_parser = mount,
        requires = "antenna_offset",
        hide_short_help = true,
        allow_negative_numbers = true,
        allow_hyphen_values = true
    )]
    pub camera_mount: Option<Mount>,
}

impl Mounting {
    /// The antenna's trajectory, from the recorded one.
    ///
    /// # Errors
    /// If that has no heading, in words.
    pub fn of_antenna(&self, recorded: Trajectory) -> Result<Trajectory, String> {
        recorded.of_antenna(self.camera_mount, self.antenna_offset).in_words()
    }
}

/// Metres forward and left, and degrees.
fn mount(text: &str) -> Result<Mount, String> {
    let place =
        triple(text).map_err(|_| "three finite numbers separated by commas: metres, metres, degrees".to_owned())?;
    Ok(Mount { offset_m: Vector3::new(place.x, place.y, 0.0), yaw_rad: place.z.to_radians() })
}

/// What a capture is, for who named a folder without one.
pub const A_CAPTURE: &str = "a capture is a folder with csi_rx_TS.dat, csi_txK_TS.dat, a trajectory (rx_trajectory_TS_.csv) and, \
                             for the truth and the channel, groundtruth_positions.json";

/// Line ends in folder names are printed as escapes.
pub fn add_names(captures: &[Capture], unreadable: &[String]) {
    let places = captures.iter().map(|capture| &capture.place);
    csi5300_say::add_names(places.chain(unreadable).map(Into::into));
}

/// How captures are read, by these arguments. Where no channel is given, that of the options is a stand-in: each capture brings its own.
pub fn reading(which: Which, mounting: &Mounting, channel: Option<Channel>, estimation: &Estimation) -> Reading {
    let source = match (which, mounting.camera_mount) {
        (Which::T265, Some(_)) => TrajectorySource::RollingT265,
        (_, Some(_)) => usage("--camera-mount is of the tracking camera: --trajectory t265"),
        (Which::Gt, None) if mounting.antenna_offset.is_some() => usage(
            "--antenna-offset is for wheels and cameras (--trajectory odom, t265): motion capture tracks the antenna itself",
        ),
        (Which::Gt, None) => TrajectorySource::GroundTruth,
        (Which::T265, None) => TrajectorySource::T265,
        (Which::Odom, None) => TrajectorySource::Odometry,
    };
    let given_or_any = channel.map_or_else(|| Channel::new(108, Width::Ht20).in_words(), Ok);
    let options =
        given_or_any.and_then(|channel| estimation.options(channel)).unwrap_or_else(|message| usage(&message));
    let (antenna_offset_m, camera) = (mounting.antenna_offset.map(Into::into), mounting.camera_mount);
    Reading { source, channel, options, antenna_offset_m, camera }
}

/// The captures in and below `folder`, with a truth or without, and folders that could not be read.
///
/// # Errors
/// If there is none, or none with a channel, in words.
pub fn find(reading: &Reading, folder: &Path) -> Result<(Vec<Capture>, Vec<String>), String> {
    let (captures, unreadable) = find_all(folder);
    add_names(&captures, &unreadable);
    let name = folder.display();
    if captures.is_empty() {
        return Err(match (folder.is_file(), folder.is_dir()) {
            (true, _) => format!("{name} is a file: name the folder of the capture, or all of its files"),
            (_, true) => format!("no capture in or below {name}: {A_CAPTURE}"),
            _ => format!("{name}: no such file or folder; {A_CAPTURE}"),
        });
    }
    detail!("{} in or below {name}", super::some(captures.len() as u64, "capture", "captures"));
    if reading.channel.is_none() && captures.iter().all(|capture| !capture.has_truth()) {
        usage("--channel is needed, such as --channel 108: no groundtruth_positions.json of these captures names it");
    }
    Ok((reading.mounted(captures), unreadable))
}

/// A trajectory file of a capture.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum Which {
    /// Motion capture
    Gt,
    /// Tracking camera
    T265,
    /// Wheel odometry
    Odom,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_5300_has_no_channel_that_only_its_centre_names() {
        assert!(channel_of_5300("5290MHz").unwrap_err().contains("number"));
        assert_eq!(channel_of_5300("60+").map(|channel| channel.to_string()), Ok("60+".into()));
    }
}
