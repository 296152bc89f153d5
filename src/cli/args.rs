//! Arguments that several commands share.

use clap::Args;
use csi5300::bartlett::SearchOptions;
use csi5300::channel::Channel;
use csi5300::pipeline::Options;
use driver_iface::{Mac, bfee::Antenna};

/// How bearings are made.
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
    /// Use pairs from this many seconds after the link's first one on
    #[arg(long, value_name = "SECONDS")]
    pub from: Option<f64>,
    /// Use pairs up to this many seconds after the link's first one
    #[arg(long, value_name = "SECONDS")]
    pub to: Option<f64>,
}

impl Default for Estimation {
    fn default() -> Self {
        Self {
            antenna: Antenna::A,
            clock_offset: 0.0,
            elevation_max: 20.0,
            no_compensation: false,
            from: None,
            to: None,
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
        Ok(Options {
            antenna: self.antenna,
            clock_offset_s: self.clock_offset,
            from_s: self.from,
            to_s: self.to,
            compensate: !self.no_compensation,
            search: SearchOptions { elevation_max_rad: self.elevation_max.to_radians(), ..SearchOptions::default() },
            ..Options::new(channel)
        })
    }
}

fn antenna(text: &str) -> Result<Antenna, String> {
    match text {
        "A" | "a" => Ok(Antenna::A),
        "B" | "b" => Ok(Antenna::B),
        "C" | "c" => Ok(Antenna::C),
        _ => Err("A, B or C".into()),
    }
}

/// A WiFi channel: its number, with `+` or `-` for a 40 MHz pair.
pub fn channel(text: &str) -> Result<Channel, String> {
    text.parse::<Channel>().map_err(|error| error.to_string())
}

/// A MAC address.
pub fn mac(text: &str) -> Result<Mac, String> {
    text.parse::<Mac>().map_err(|error| error.to_string())
}
