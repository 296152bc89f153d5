//! What the commands on folders of captures share.

use super::args::{Estimation, channel};
use csi5300::pipeline::Options;
use csi5300::signal::channel::{Channel, Width};
use csi5300_lab::evaluate::TrajectorySource;

/// How captures are read.
#[derive(clap::Args)]
pub struct Reading {
    /// Which trajectory to use
    #[arg(long, value_enum, default_value = "gt")]
    trajectory: Which,
    /// WiFi channel instead of the one in groundtruth_positions.json
    #[arg(long, value_parser = channel, value_name = "NUMBER")]
    pub channel: Option<Channel>,
    #[command(flatten)]
    pub estimation: Estimation,
}

impl Reading {
    /// The trajectory to use.
    pub fn source(&self) -> TrajectorySource {
        match self.trajectory {
            Which::Gt => TrajectorySource::GroundTruth,
            Which::T265 => TrajectorySource::T265,
            Which::Odom => TrajectorySource::Odometry,
        }
    }

    /// The pipeline's options. Their channel is a stand-in where none was given: each capture brings its own.
    pub fn options(&self) -> Result<Options, String> {
        self.options_of(&self.estimation)
    }

    /// The same for another estimation.
    pub fn options_of(&self, estimation: &Estimation) -> Result<Options, String> {
        let fallback = Channel::new(108, Width::Ht20).map_err(|error| error.to_string())?;
        estimation.options(self.channel.unwrap_or(fallback))
    }
}

/// A trajectory file of a capture.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Which {
    /// Motion capture
    Gt,
    /// Tracking camera
    T265,
    /// Wheel odometry
    Odom,
}
