//! `csi5300 sound`.

mod common;
mod respond;

pub use self::common::see_to_rate;
use self::common::{DialectArg, NO_NUMBERS, Sounding, Wanted, tell, waiting};
use super::Words;
use super::args::{Estimation, antenna};
use super::live::{Signals, duration};
use super::{Result, fixed, hint, print, print_json, usage};
use csi5300::exchange::tdma::{Epoch, Event, Plan};
use csi5300::motion::odometry::csv;
use csi5300::pipeline::{Bearing, LinkError};
use csi5300::source::Next;
use csi5300::time::{Instant, Span};
use csi5300_live::sounding::{Beside, News, Observer, Products, Running};
use csi5300_live::wait::Monotonic;
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use std::collections::BTreeMap;
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};

/// A robot that initiates alone takes a lost turn after this silence, microseconds and slots at least. A busy host that
/// sleeps for less keeps its turn.
const ALONE_SILENCE_US: f64 = 50_000.0;
const ALONE_SILENCE_SLOTS: u32 = 2;

// Arguments of `sound`.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  csi5300 sound --interface mon0 --peers 00:21:6a:53:89:d2,00:21:6a:53:90:a4 --rate 100\n  \
                        csi5300 sound --interface mon0 --peers 00:21:6a:53:89:d2 --log OUT.dat --trajectory T.csv --channel 64\n  \
                        csi5300 sound --interface mon0 --peers 00:21:6a:53:89:d2 --dialect wsr --open-loop\n  \
                        csi5300 sound --answer --interface mon0 --peers 00:21:6a:53:89:d2"
)]
pub struct Args {
    /// Answer other robots' frames instead of sounding. Answers carry the card's measurement, for live bearings (driver
    /// with connector_log=0x5, or --stock); --dialect wsr --ack-len N answers as the WSR driver
    #[arg(long, conflicts_with_all = ["alone", "open_loop", "trajectory", "heading_sd"])]
    answer: bool,
    #[command(flatten)]
    common: Sounding,
    /// Begin at once: no other robot initiates
    #[arg(long)]
    alone: bool,
    /// Sound every peer in every round, even if no answers are heard
    #[arg(long)]
    open_loop: bool,
    /// Trajectory of this robot for live bearings: a growing CSV, on this host's clock
    #[arg(long, value_name = "T.csv", requires = "channel")]
    trajectory: Option<PathBuf>,
    /// How often to estimate bearings; the last one may come after the sounding
    #[arg(long, value_parser = duration, default_value = "2s", value_name = "TIME")]
    bearing_every: Span,
    /// Antenna (RF port) used on both robots: A, B or C
    #[arg(long, default_value = "A", value_parser = antenna)]
    antenna: Antenna,
    /// Standard deviation of the trajectory's heading: 0.3 for motion capture, about 4 for a tracking camera, 20 for
    /// wheels. Error bars and confidence include it
    #[arg(long, value_name = "DEGREES", requires = "trajectory")]
    heading_sd: Option<f64>,
    /// Print JSON, one object a line (docs/reference/formats.md)
    #[arg(long)]
    json: bool,
}

/// A bearing while sounding.
#[derive(serde::Serialize)]
struct Line {
    mac: String,
    pairs: usize,
    azimuth_deg: Option<f64>,
    azimuth_sd_deg: Option<f64>,
    mirror_deg: Option<f64>,
    coherence: Option<f64>,
    error: Option<String>,
}

impl Line {
    fn new(mac: Mac, pairs: usize, made: &std::result::Result<Bearing, LinkError>) -> Self {
        let bearing = made.as_ref().ok();
        let answer = bearing.map(|bearing| &bearing.answer);
        let finite = |sd: &f64| sd.is_finite();
        Self {
            mac: mac.to_string(),
            pairs,
            azimuth_deg: answer.map(|answer| answer.azimuth_rad.to_degrees()),
            azimuth_sd_deg: answer.map(|answer| answer.azimuth_sd_rad.to_degrees()).filter(finite),
            mirror_deg: answer.and_then(|answer| answer.mirror_rad).map(f64::to_degrees),
            coherence: bearing.map(|bearing| bearing.plane_wave.coherence),
            error: made.as_ref().err().map(hint::words),
        }
    }
}

/// The bearings of all peers with products, or why the trajectory cannot be read.
type Made = Words<Vec<(Mac, usize, std::result::Result<Bearing, LinkError>)>>;

/// Makes bearings from products, beside the sounding.
struct Bearings<'a> {
    args: &'a Args,
    products: Products,
    path: &'a Path,
    beside: Beside<Made>,
    clock: Monotonic,
    told: bool,
    /// Reported numbers with two records.
    contested: u64,
}

/// What `sound` does beside sounding.
struct Live<'a> {
    bearings: Option<Bearings<'a>>,
}

impl Observer for Live<'_> {
    fn record(&mut self, next: &Next<'_>, _running: &Running) {
        if let Some(bearings) = &mut self.bearings {
            bearings.products.note(next);
        }
    }

    fn news(&mut self, news: &News) {
        tell(news);
        let (Some(bearings), News::Event(Event::Answered { peer, number, measurement, .. })) =
            (&mut self.bearings, news)
        else {
            return;
        };
        bearings.products.confirmed(*peer, *number, bearings.clock.now());
        if let Some(measurement) = measurement {
            bearings.products.answered(*peer, measurement);
        }
    }

    fn look(&mut self, now: Instant, _running: &Running) {
        let Some(bearings) = &mut self.bearings else { return };
        if let Some(made) = bearings.beside.take() {
            bearings.tell(made);
        }
        if bearings.beside.is_due(now) {
            bearings.begin(now);
        }
    }
}

impl Bearings<'_> {
    /// Starts to estimate bearings from the products so far.
    fn begin(&mut self, now: Instant) {
        if self.products.unused().no_number > 0 && !self.told {
            self.told = true;
            note!("{NO_NUMBERS}");
        }
        let contested = self.products.contested();
        if contested > self.contested {
            self.contested = contested;
            note!("{contested} numbers have two records: somebody answers in a peer's name; none of them is used");
        }
        let (links, path) = (self.products.links(), self.path.to_owned());
        let work = move || match csv::read_as(&path, None) {
            Ok((trajectory, _)) => Ok(links.bearings(&trajectory)),
            Err(error) => Err(format!("{}: {error}", path.display())),
        };
        if let Err(error) = self.beside.begin(now, work) {
            wrong!("{error}");
        }
    }

    /// Prints the bearings that are ready.
    fn tell(&self, made: Made) {
        let made = match made {
            Ok(made) => made,
            Err(error) => return wrong!("{error}"),
        };
        for (mac, pairs, made) in made {
            let line = Line::new(mac, pairs, &made);
            self.show(&line);
        }
    }

    /// The end: waits for the bearings under way and prints them, unless a signal ended the sounding or ends this.
    fn finish(mut self, signals: &Signals) -> Words<()> {
        let last = self.beside.last(self.clock, signals.as_fd()).map_err(|error| error.to_string())?;
        last.into_iter().for_each(|made| self.tell(made));
        Ok(())
    }

    fn show(&self, line: &Line) {
        if self.args.json {
            return print_json(line);
        }
        let Line { mac, pairs, .. } = line;
        match (line.azimuth_deg, &line.error) {
            (Some(azimuth), _) => {
                let sd = line.azimuth_sd_deg.map_or(String::new(), |sd| format!(" +- {sd:.2}"));
                let mirror = line.mirror_deg.map_or(String::new(), |mirror| format!(", or {}", fixed(mirror, 1)));
                let coherence = line.coherence.unwrap_or(0.0);
                let azimuth = fixed(azimuth, 1);
                print(&format!("{mac}  {azimuth}{sd} deg{mirror}; coherence {coherence:.2}, {pairs} pairs\n"));
            }
            (None, Some(error)) => print(&format!("{mac}  no bearing yet: {error}\n")),
            (None, None) => {}
        }
    }
}

/// Sounds until a signal or a limit ends it.
pub fn run(args: &Args) -> Result {
    let common = &args.common;
    if args.answer {
        return respond::run(common, args.antenna, args.json);
    }
    if args.trajectory.is_some() && common.dialect == DialectArg::Wsr {
        usage(
            "live bearings need the responder's measurements, which only native frames carry: leave out --trajectory, \
             record with --log, and use `csi5300 bearing` on the logs of both robots",
        );
    }
    let signals = Signals::catch().map_err(|error| error.to_string())?;
    let clock = Monotonic::new();
    let now = clock.now();
    let opened = common.open(|config| {
        (config.epoch, config.start) = (Epoch::Heard(now), now);
        (config.initiate, config.open_loop) = (true, args.open_loop);
        if args.alone || args.open_loop {
            let slot_us = Plan::new(&config.request).map_or(ALONE_SILENCE_US, |plan| plan.slot_us());
            config.silence_slots = ALONE_SILENCE_SLOTS.max((ALONE_SILENCE_US / slot_us).ceil() as u32);
        }
    })?;
    note!("{}", waiting(&common.peers, opened.tdma.transmit_at().map(|at| at - now)));
    let bearings = match (&args.trajectory, common.channel) {
        (Some(path), Some(channel)) => {
            let estimation = Estimation { heading_sd: args.heading_sd, ..Estimation::with_antenna(args.antenna) };
            let options = estimation.options(channel)?;
            let products = Products::new(&common.peers, options).with_key(opened.key.as_ref());
            let beside = Beside::new(now, args.bearing_every);
            Some(Bearings { args, products, path, beside, clock, told: false, contested: 0 })
        }
        _ => None,
    };
    common.see_to_rate(args.antenna)?;
    let wanted = if bearings.is_some() { Wanted::Needed } else { Wanted::Not };
    let messages = common.messages(wanted, opened.own)?;
    let mut live = Live { bearings };
    let (outcome, row) = common.run(&signals, messages, opened, clock, &mut live)?;
    if let Some(bearings) = live.bearings {
        bearings.finish(&signals)?;
    }
    if args.json {
        print_json(&BTreeMap::from([("summary", row)]));
    }
    Ok(outcome)
}
