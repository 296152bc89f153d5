//! `csi5300 sound`, and `sound --answer`: answers the frames of robots that sound. Answers are given at once, from user space; with
//! `--dialect wsr --ack-len N` as the WSR driver gives them in the kernel. In the native dialect an answer carries what the card measured
//! of an earlier frame, so that the initiator has bearings live.

use super::args::{Estimation, antenna, channel_of_5300};
use super::live::{Listening, Needs, Signals, create_refused, duration, join_refused};
use super::{InWords, Outcome, Result, Words, fixed, hint, is_end_of_room, print, print_json, usage};
use csi5300::exchange::tdma::{Config, Dialect, Epoch, Event, Phy, Plan, PlanError, Request, TdmaCounts};
use csi5300::motion::odometry::csv::{self, CsvError};
use csi5300::pipeline::live::LiveEstimator;
use csi5300::pipeline::{Bearing, LinkError};
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::recorder::{LogFiles, Rotation};
use csi5300::source::{Error, Next, read_key};
use csi5300::time::{Instant, Span};
use csi5300_live::doctor::{Machine, other_channel};
use csi5300_live::listener::Listener;
use csi5300_live::logged::Logged;
use csi5300_live::monitor::{AirCounts, Monitor, Options};
use csi5300_live::sounding::{
    Beside, Figures, Finished, KERNEL_TURN_AROUND_US, Measuring, News, Observer, Opened, Running, Session, Settings,
    Setup, Spread, products, rate_n_flags, set_rate, spread_of,
};
use csi5300_live::wait::Monotonic;
use csi5300_sim::served::{self, Address};
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use driver_iface::radiotap::Bandwidth;
use driver_iface::sounding::wsr;
use std::collections::BTreeMap;
use std::fmt::Write;
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
    #[arg(long, conflicts_with_all = ["alone", "open_loop", "trajectory", "bearing_every", "heading_sd"])]
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
    #[arg(long, value_parser = duration, default_value = "2s", value_name = "TIME", requires = "trajectory")]
    bearing_every: Span,
    /// Antenna (RF port) used on both robots: A, B or C
    #[arg(long, default_value = "A", value_parser = antenna)]
    antenna: Antenna,
    /// Standard deviation of the trajectory's heading: 0.3 for motion capture or an unknown sensor, about 4 for a tracking
    /// camera, 20 for wheels (1.5 if the antenna's place is known). Error bars, ranges and confidence include it
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

/// What the trajectory lacks, and the bearings of all peers with products; or why it cannot be read.
type Made = Words<(Lacks, Vec<(Mac, usize, std::result::Result<Bearing, LinkError>)>)>;

/// Skipped rows of a trajectory, in words, and whether they are a loss.
#[derive(Default)]
struct Lacks(Vec<String>, bool);

/// Makes bearings from products, beside the sounding.
struct Bearings<'a> {
    args: &'a Args,
    products: LiveEstimator,
    path: &'a Path,
    beside: Beside<Made>,
    clock: Monotonic,
    told: bool,
    /// Reported numbers with two records.
    contested: u64,
    /// Of the last reading of the trajectory; one that could not be read is a loss.
    lacks: Lacks,
}

/// What `sound` does beside sounding: bearings, and measurements for the answers to other initiators.
struct Live<'a>(Option<Bearings<'a>>, Measuring);

impl Observer for Live<'_> {
    fn record(&mut self, next: &Next<'_>, running: &Running) {
        self.1.note(next, running);
        if let Some(bearings) = &mut self.0 {
            bearings.products.handle_own(next);
        }
    }

    fn news(&mut self, news: &News) {
        tell(news);
        let (Some(bearings), News::Event(Event::Answered { peer, number, measurement, .. })) = (&mut self.0, news)
        else {
            return;
        };
        bearings.products.handle_confirmed(*peer, *number, bearings.clock.now());
        if let Some(measurement) = measurement {
            bearings.products.handle_measurement(*peer, measurement);
        }
    }

    fn look(&mut self, now: Instant, _running: &Running) {
        let Some(bearings) = &mut self.0 else { return };
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
        if self.products.own_log().unused.no_number > 0 && !self.told {
            self.told = true;
            note!("{NO_NUMBERS}");
        }
        // Of all peers: numbers with two records, of which neither is used.
        let contested = self.products.peers().map(|(_, counts)| counts.refused.contested).sum();
        if contested > self.contested {
            self.contested = contested;
            note!("{contested} numbers have two records: somebody answers in a peer's name; none of them is used");
        }
        let (links, path) = (self.products.links(), self.path.to_owned());
        let work = move || match csv::read(&path, None) {
            Ok((trajectory, mut counts)) => {
                let notes = counts.notes(&trajectory);
                // One row may be in the middle of being written.
                counts.bad_rows = counts.bad_rows.saturating_sub(1);
                Ok((Lacks(notes, counts.lost_something(&trajectory)), links.bearings(&trajectory)))
            }
            Err(error @ CsvError::Io { .. }) => Err(error.to_string()),
            Err(error) => Err(format!("{}: {error}", path.display())),
        };
        if let Err(error) = self.beside.begin(now, work) {
            wrong!("{error}");
        }
    }

    /// Prints the bearings that are ready.
    fn tell(&mut self, made: Made) {
        let (lacks, made) = made.unwrap_or_else(|error| {
            wrong!("{error}");
            (Lacks(Vec::new(), true), Vec::new())
        });
        self.lacks = lacks;
        for (mac, pairs, made) in made {
            self.show(&Line::new(mac, pairs, &made));
        }
    }

    /// The end: waits for the bearings under way and prints them, unless a signal ended the sounding or ends this. False if
    /// something of the trajectory could not be read, or no answer carried a measurement.
    fn finish(mut self, signals: &Signals) -> Words<bool> {
        let last = self.beside.last(self.clock, signals.as_fd()).in_words()?;
        last.into_iter().for_each(|made| self.tell(made));
        let Lacks(notes, is_loss) = self.lacks;
        notes.into_iter().for_each(|words| note!("{}: {words}", self.path.display()));
        let is_measured = self.products.peers().any(|(_, counts)| counts.heard_by_peer > 0);
        if !is_measured {
            note!("{NO_MEASUREMENT}");
        }
        Ok(is_measured && !is_loss)
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
        return answer(common, args.antenna, args.json);
    }
    if args.trajectory.is_some() && common.dialect == DialectArg::Wsr {
        usage(
            "live bearings need the responder's measurements, which only native frames carry: leave out --trajectory, \
             record with --log, and use `csi5300 bearing` on the logs of both robots",
        );
    }
    let wanted = if args.trajectory.is_some() { Wanted::Needed } else { Wanted::Not };
    common.check(wanted);
    let (antenna, heading_sd) = (vec![args.antenna], args.heading_sd);
    let estimation = Estimation { antenna, heading_sd, ..Estimation::default() };
    let options = common.channel.map(|channel| estimation.options(channel).unwrap_or_else(|message| usage(&message)));
    let signals = Signals::catch().in_words()?;
    let clock = Monotonic::new();
    let now = clock.now();
    let opened = common.open(|config| {
        (config.epoch, config.start) = (Epoch::Heard(now), now);
        (config.initiate, config.open_loop) = (true, args.open_loop);
        if args.alone || args.open_loop {
            let slot_us = Plan::new(&config.request).map_or(ALONE_SILENCE_US, |plan| plan.slot_us);
            config.silence_slots = ALONE_SILENCE_SLOTS.max((ALONE_SILENCE_US / slot_us).ceil() as u32);
        }
    })?;
    note!("{}", waiting(&common.peers, opened.tdma.transmit_at().map(|at| at - now), args.open_loop));
    let bearings = match (&args.trajectory, options) {
        (Some(path), Some(options)) => {
            let mut products = products(&common.peers, options);
            opened.key.iter().for_each(|key| products.require_key(key));
            let beside = Beside::new(now, args.bearing_every);
            Some(Bearings { args, products, path, beside, clock, told: false, contested: 0, lacks: Lacks::default() })
        }
        _ => None,
    };
    common.see_to_rate(args.antenna)?;
    let messages = common.messages(wanted, opened.own)?;
    let measuring = Measuring::new(args.antenna, common.peers.clone(), opened.key.clone());
    let mut live = Live(bearings, measuring);
    let (mut outcome, row) = common.run(&signals, messages, opened, (clock, args.open_loop), &mut live)?;
    if let Some(bearings) = live.0
        && !bearings.finish(&signals)?
        && outcome == Outcome::Done
    {
        outcome = Outcome::DataLost;
    }
    if args.json {
        print_json(&BTreeMap::from([("summary", row)]));
    }
    Ok(outcome)
}

/// Hands the card's measurements to the answers, if they carry any.
struct Answering {
    measuring: Option<Measuring>,
    told: bool,
}

impl Observer for Answering {
    fn record(&mut self, next: &Next<'_>, running: &Running) {
        let is_numbered = self.measuring.as_mut().is_none_or(|measuring| measuring.note(next, running));
        if !is_numbered && !std::mem::replace(&mut self.told, true) {
            note!("{NO_NUMBERS}");
        }
    }

    fn news(&mut self, news: &News) {
        tell(news);
    }
}

/// Answers until a signal or a limit ends it.
fn answer(common: &Sounding, antenna: Antenna, json: bool) -> Result {
    if common.dialect == DialectArg::Wsr && common.ack_len.is_none() {
        usage("--dialect wsr needs --ack-len, the length of the frames meant for this robot (57 for the first)");
    }
    let carries = common.dialect == DialectArg::Native;
    let wanted = if carries { Wanted::IfPossible } else { Wanted::Not };
    common.check(wanted);
    let signals = Signals::catch().in_words()?;
    let clock = Monotonic::new();
    let opened = common.open(|config| (config.epoch, config.start) = (Epoch::Heard(clock.now()), clock.now()))?;
    common.see_to_rate(antenna)?;
    let messages = common.messages(wanted, opened.own)?;
    let measuring = carries.then(|| Measuring::new(antenna, common.peers.clone(), opened.key.clone()));
    let mut task = Answering { measuring, told: false };
    let (outcome, row) = common.run(&signals, messages, opened, (clock, false), &mut task)?;
    if json {
        print_json(&row);
    }
    Ok(outcome)
}

/// WSR dialect: length of the frames for the first robot, frame check sequence included.
const FIRST_LEN: u16 = wsr::DEFAULT_LEN as u16;

// Arguments of sounding and answering.
#[derive(clap::Args, Clone, Debug)]
struct Sounding {
    /// Monitor interface
    #[arg(long, value_name = "NAME", required_unless_present = "room", conflicts_with = "room")]
    interface: Option<String>,
    /// MACs of the other robots; in the WSR dialect they get frames of 57, 59, 61 ... bytes
    #[arg(long, required = true, value_delimiter = ',', value_name = "MAC,..")]
    peers: Vec<Mac>,
    /// Rounds a second, each with one exchange per peer
    #[arg(long, default_value_t = 100.0, value_name = "HZ")]
    rate: f64,
    /// Format of the frames
    #[arg(long, value_enum, default_value_t = DialectArg::Native)]
    dialect: DialectArg,
    /// Links in a round, the same on all robots [default: the number of peers]
    #[arg(long, value_name = "N")]
    links: Option<u16>,
    /// Modulation of every frame, 0 to 23; from 8 on frames use several streams and antennas
    #[arg(long, default_value_t = 1, value_name = "MCS", value_parser = clap::value_parser!(u8).range(0..=23))]
    mcs: u8,
    /// WiFi channel, with + or - for 40 MHz; needed for bearings
    #[arg(long, value_parser = channel_of_5300, value_name = "NUMBER")]
    channel: Option<Channel>,
    /// WSR dialect: length of the frames that this robot answers (57, 59, 61 ...)
    #[arg(long, value_name = "BYTES")]
    ack_len: Option<u16>,
    /// How late a frame may be sent, and the free time after it, microseconds; later frames are skipped
    #[arg(long, default_value_t = Request::default().guard_us, value_name = "US")]
    guard: u32,
    /// How long after a forward frame its answer may begin, microseconds
    #[arg(long, default_value_t = Request::default().turn_around_us, value_name = "US")]
    turn_around: u32,
    /// Key file of the group or of this robot (`csi5300 key`): frames without a valid tag and of older sessions are
    /// ignored
    ///
    /// The clock numbers the sessions; $XDG_STATE_HOME/csi5300, ~/.local/state/csi5300 or /var/lib/csi5300 keeps the
    /// last number. If none can be written and the clock is set back, other robots ignore this one until its clock has
    /// caught up.
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// This robot's MAC, instead of the interface's own
    #[arg(long, value_name = "MAC")]
    mac: Option<Mac>,
    /// Do not ask for SCHED_FIFO
    #[arg(long)]
    no_fifo: bool,
    /// Stop after this time
    #[arg(long, value_parser = duration, value_name = "TIME")]
    stop_after: Option<Span>,
    /// Also record what the card hears to this log
    #[arg(long, value_name = "OUT.dat")]
    log: Option<PathBuf>,
    /// Overwrite existing outputs
    #[arg(long, requires = "log")]
    force: bool,
    #[command(flatten)]
    listening: Listening,
}

/// A dialect by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum DialectArg {
    /// Ours, for any CSI driver: destination, role, number and slot in the frame
    Native,
    /// The WSR toolbox's: the length of a frame addresses a robot
    Wsr,
}

impl Sounding {
    /// The plan that the arguments request.
    fn request(&self) -> Request {
        let is_wide = self.channel.is_some_and(|channel| channel.width() != Width::Ht20);
        let bandwidth = if is_wide { Bandwidth::Ht40 } else { Bandwidth::Ht20 };
        let dialect = match self.dialect {
            DialectArg::Native => Dialect::Native { measurement: true, authenticated: self.key.is_some() },
            DialectArg::Wsr => Dialect::Wsr { first_len: FIRST_LEN },
        };
        let own = self.own_index().map_or(0, |index| index.saturating_add(1));
        let peers = u16::try_from(self.peers.len()).unwrap_or(u16::MAX);
        Request {
            phy: Phy { mcs: self.mcs, bandwidth },
            dialect,
            guard_us: self.guard,
            turn_around_us: self.turn_around,
            ..Request::new(self.links.unwrap_or(peers.max(own)), self.rate)
        }
    }

    /// What carries the frames, in words.
    fn name(&self) -> String {
        match (&self.interface, &self.listening.room) {
            (Some(interface), _) => interface.clone(),
            (None, Some(address)) => address.to_string(),
            (None, None) => String::new(),
        }
    }

    /// The robot's index in the WSR dialect, from the length that it answers.
    fn own_index(&self) -> Option<u16> {
        self.ack_len.map(|len| len.saturating_sub(FIRST_LEN) / 2)
    }

    /// Ends the command if arguments contradict each other, or name a card whose records nobody takes.
    fn check(&self, wanted: Wanted) {
        let names_card = self.listening.card.is_named() || self.listening.allow_user_sender;
        if names_card && self.log.is_none() && wanted == Wanted::Not {
            usage(
                "--connector-index, --stock and --allow-user-sender need --log or --trajectory, which take the card's records",
            );
        }
        match (self.dialect, self.ack_len) {
            (DialectArg::Native, Some(_)) => usage("--ack-len belongs to --dialect wsr"),
            (DialectArg::Wsr, Some(len)) if len < FIRST_LEN || (len - FIRST_LEN) % 2 == 1 => {
                usage(&format!("--ack-len {len}: {FIRST_LEN}, and two bytes more for each robot"))
            }
            _ => {}
        }
        if self.dialect == DialectArg::Wsr && self.key.is_some() {
            usage("--key belongs to the native dialect: WSR frames have no room for a tag");
        }
    }

    /// Opens the interface and makes the machine.
    fn open(&self, settle: impl FnOnce(&mut Config)) -> Words<Opened> {
        let request = self.request();
        let plan = Plan::new(&request).unwrap_or_else(|error| usage(&refused(&error)));
        let setup = Setup {
            interface: self.name(),
            mac: self.mac,
            peers: self.peers.clone(),
            request,
            own_index: self.own_index().unwrap_or(0),
            key: self.key.as_deref().map(read_key).transpose().in_words()?,
        };
        let opened = monitor(self.listening.room.as_ref(), &setup.options())?.and_then(|monitor| {
            setup.open_on(monitor, |config| {
                // A WSR robot without a length answers nothing here; its kernel may.
                config.respond = self.dialect == DialectArg::Native || self.ack_len.is_some();
                settle(config);
            })
        });
        let opened = opened.in_words()?;
        opened.warning.iter().for_each(|warning| note!("{warning}"));
        note!(
            "{} is {}; {} in a round, {:.3} rounds/s, slots of {:.0} us (at least {})",
            self.name(),
            opened.own,
            super::some(plan.slots.into(), "link", "links"),
            plan.rate_hz,
            plan.slot_us,
            plan.shortest_slot_us
        );
        Ok(opened)
    }

    /// Sets or checks the driver's rate, and checks the channel.
    fn see_to_rate(&self, antenna: Antenna) -> Words<()> {
        let Some(interface) = self.interface.as_deref() else { return Ok(()) };
        let other = self.channel.and_then(|channel| other_channel(&Machine, interface, channel));
        other.into_iter().for_each(|words| note!("{words}"));
        see_to_rate(interface, self.request().phy, antenna)
    }

    /// The card's records, if wanted: recorded, or only read. `own` is this robot's MAC.
    fn messages(&self, wanted: Wanted, own: Mac) -> Words<Option<Logged<Listener>>> {
        if self.log.is_none() && wanted == Wanted::Not {
            return Ok(None);
        }
        let needs = Needs { own: Some(own), frames: self.key.is_some(), receive_buffer: None };
        let listener = match self.listening.open(needs) {
            Ok(listener) => listener,
            Err(error) if self.log.is_none() && wanted == Wanted::IfPossible => {
                note!("answers carry no measurement: {error}");
                return Ok(None);
            }
            Err(error) => return Err(error),
        };
        note!("{}", listener.describe());
        let files = self.log.as_ref().map(|log| LogFiles::create(log, Rotation::default(), self.force)).transpose();
        files.and_then(|files| Logged::new(listener, files)).map(Some).map_err(|error| create_refused(&error))
    }

    /// Runs until a signal, the time limit or a failure of the interface; then prints the summary and returns it for JSON.
    fn run(
        &self,
        signals: &Signals,
        messages: Option<Logged<Listener>>,
        opened: Opened,
        (clock, open_loop): (Monotonic, bool),
        observer: &mut dyn Observer,
    ) -> Words<(Outcome, ExchangeRow)> {
        let fifo_priority = Settings::default().fifo_priority.filter(|_| !self.no_fifo);
        let settings = Settings { fifo_priority, stop_at: self.stop_after.map(|span| clock.now() + span) };
        let session = Session { clock, stop: signals.as_fd(), settings };
        let finished = session.run(opened, messages, observer).in_words()?;
        let error = finished.error.as_ref().filter(|_| !self.room_ended(&finished)).map(ToString::to_string);
        Ok((self.conclude(&finished, open_loop), ExchangeRow::new(&self.peers, &finished, error)))
    }

    /// True if the simulated room ended, which is a normal end.
    fn room_ended(&self, finished: &Finished) -> bool {
        finished.error.as_ref().is_some_and(|error| self.listening.room.is_some() && is_end_of_room(error))
    }

    /// Prints the summary, and returns the outcome.
    fn conclude(&self, finished: &Finished, open_loop: bool) -> Outcome {
        notes!("{}", summary(&self.peers, finished, open_loop));
        if finished.news_lost > 0 {
            note!("  {} events of the radio were lost", finished.news_lost);
        }
        if let (Some(totals), Some(log)) = (&finished.log, &self.log) {
            note!("{} written to {}", super::some(totals.recorded.written, "record", "records"), log.display());
            if totals.missing() > 0 {
                note!("  not in it: {}", super::some(totals.missing(), "record", "records"));
            }
        }
        let over = self.room_ended(finished);
        match &finished.error {
            Some(_) if over => note!("the room has ended"),
            Some(error) => wrong!("{error}"),
            None => {}
        }
        let unlogged = finished.log.as_ref().is_some_and(|log| log.missing() > 0);
        let lost = if over { unlogged } else { finished.lost_anything() };
        let counts = finished.counts();
        let sent = if open_loop { finished.confirmed() } else { 0 };
        Outcome::of(counts.answered + counts.replies + sent > 0, lost)
    }
}

/// The interface, or a robot's air in a served room.
pub fn monitor(room: Option<&Address>, options: &Options) -> Words<std::result::Result<Monitor, Error>> {
    let Some(address) = room else { return Ok(Monitor::open(options)) };
    let (air, mac) = served::join(address, served::Role::Air).map_err(|error| join_refused(&error))?;
    Ok(Monitor::over(air, mac, options))
}

/// Sets or checks the rate at which an interface's driver sends.
pub fn see_to_rate(interface: &str, phy: Phy, antenna: Antenna) -> Words<()> {
    let rate = rate_n_flags(phy, antenna)
        .ok_or_else(|| format!("--mcs {} has more streams than the card has antennas: 23 is the highest", phy.mcs))?;
    if let Ok(Some(words)) | Err(words) = set_rate(&Machine, interface, rate) {
        note!("{words}");
    }
    Ok(())
}

/// A plan's refusal in words.
fn refused(error: &PlanError) -> String {
    match error {
        PlanError::Rate { highest_hz, .. } => {
            format!("{error}: try --rate {:.2}", (highest_hz * 100.0).floor() / 100.0)
        }
        _ => error.to_string(),
    }
}

/// Whether the driver's messages are needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wanted {
    /// Not needed.
    Not,
    /// Useful.
    IfPossible,
    /// Required.
    Needed,
}

/// How many were lost or ignored for one cause: its name in JSON, the number, and the words that follow it.
type Cause = (&'static str, u64, &'static str);

/// Due frames that were not sent, or perhaps late.
fn not_sent(counts: &TdmaCounts, figures: &Figures, air: &AirCounts) -> [Cause; 7] {
    let skipped = counts.missed_slots + figures.too_late;
    [
        ("host_late", skipped, "frames skipped because the host was late (never sent late)"),
        ("answer_late", counts.missed_replies, "answers skipped because they were late"),
        ("perhaps_late", figures.perhaps_late, "frames handed over in time that the kernel took late"),
        ("no_room", air.no_room, "frames not taken: no room in the kernel's queue"),
        ("interface_down", air.down, "frames not taken: the interface was down"),
        ("too_long", air.too_long, "frames not taken: longer than the MTU"),
        ("cut", air.cut, "frames that the kernel took only in part"),
    ]
}

/// Frames heard and turns that were not used.
fn not_used(counts: &TdmaCounts, air: &AirCounts) -> [Cause; 17] {
    [
        ("kernel_dropped", air.dropped, "frames heard but dropped by the kernel before they were read"),
        ("stale", air.stale, "frames dropped after a second or more in the kernel's queue"),
        ("bad_fcs", air.bad_fcs, "frames with a wrong check sequence"),
        ("damaged", air.damaged, "frames behind an unreadable radiotap header"),
        ("foreign", counts.foreign, "frames of another dialect or damaged"),
        ("strangers", counts.strangers, "frames of robots that are no peers"),
        ("unauthenticated", counts.unauthenticated, "frames without the key"),
        ("contested", counts.contested, "measurements whose number two frames had"),
        ("replayed", counts.replayed, "frames repeated or of an old session"),
        ("unmatched", counts.unmatched, "answers that match no waiting frame"),
        ("other_plan", counts.other_plan, "frames of another plan (--rate, --links)"),
        ("yields", counts.yields, "turns yielded to another initiator"),
        ("overslept", counts.overslept, "turns lost because the host was busy"),
        ("rivals", counts.rivals, "frames that contradict an earlier initiator or turn"),
        ("off_epoch", counts.off_epoch, "frames outside their slot"),
        ("own_echoes", counts.own_echoes, "copies of this robot's own frames"),
        ("events_lost", counts.events_lost, "events lost because too many came at once"),
    ]
}

/// The line.
#[derive(serde::Serialize)]
struct ExchangeRow {
    /// Forward frames sent, and how many of them were answered.
    forward: u64,
    answered: u64,
    /// Answers sent.
    answers: u64,
    /// Forward frames and their answers by peer, if any.
    peers: Vec<PeerRow>,
    /// From a slot's start to the time at which the host came to it, of every slot that was due.
    lateness_us: Option<Spread>,
    /// From the hand-over of a forward frame to the beginning of its answer.
    answer_us: Option<Spread>,
    /// From the kernel's stamp on a forward frame to the hand-over of its answer.
    turn_around_us: Option<Spread>,
    /// Frames not sent, and frames heard but not used, by cause; causes with none are omitted.
    not_sent: BTreeMap<&'static str, u64>,
    not_used: BTreeMap<&'static str, u64>,
    /// Frames that the kernel reports as sent, and as failed; `None` if it reports nothing.
    confirmed: Option<u64>,
    failed: Option<u64>,
    /// The driver's messages in the log, and those missing from it, if they were recorded.
    records: Option<u64>,
    records_missing: Option<u64>,
    /// What ended the session, if neither the time nor a signal did.
    error: Option<String>,
}

#[derive(serde::Serialize)]
struct PeerRow {
    mac: String,
    forward: u64,
    answered: u64,
}

impl ExchangeRow {
    /// Of a session with `peers`; `error` is what ended it, if neither the time nor a signal did.
    fn new(peers: &[Mac], finished: &Finished, error: Option<String>) -> Self {
        let (counts, figures, air) = (finished.counts(), &finished.exchange.figures, finished.air);
        let peer = |mac: &Mac| {
            let link = finished.exchange.tdma.link_counts(*mac).filter(|link| link.sounded > 0)?;
            Some(PeerRow { mac: mac.to_string(), forward: link.sounded, answered: link.answered })
        };
        let named =
            |causes: &[Cause]| causes.iter().filter(|cause| cause.1 > 0).map(|cause| (cause.0, cause.1)).collect();
        let reports = air.tx_status > 0;
        Self {
            forward: counts.forward,
            answered: counts.answered,
            answers: counts.replies,
            peers: peers.iter().filter_map(peer).collect(),
            lateness_us: Spread::of(&figures.due_us),
            answer_us: Spread::of(&figures.answer_us),
            turn_around_us: Spread::of(&figures.turn_around_us),
            not_sent: named(&not_sent(counts, figures, &air)),
            not_used: named(&not_used(counts, &air)),
            confirmed: reports.then(|| finished.confirmed()),
            failed: reports.then(|| finished.reported_failed()),
            records: finished.log.as_ref().map(|log| log.recorded.written),
            records_missing: finished.log.as_ref().map(csi5300_live::sounding::LogTotals::missing),
            error,
        }
    }
}

/// Printed if no answer is of use for bearings.
const NO_MEASUREMENT: &str = "no answer carried a measurement, so there is no bearing: the other robots need access to their cards, and \
                              those that initiate too need --trajectory or --log";
/// Printed once if the driver's records carry neither sender nor number.
const NO_NUMBERS: &str = "the driver's records carry neither sender nor number: load it with connector_log=0x5 (csitool), or use the WSR driver";

/// A first frame within this time is announced as "at once", seconds.
const AT_ONCE_S: f64 = 0.5;
/// The summary of a session without a frame.
const NOTHING_SENT: &str =
    "no frame was sent: it ended while this robot still listened for others, or nobody sounded it\n";

/// Prints events as they come.
fn tell(news: &News) {
    match news {
        News::Started(granted) => note!("{granted}"),
        News::Notice(notice) => note!("{notice}"),
        News::Event(Event::Joined(peer)) => note!("{} joined", peer),
        News::Event(Event::Absent(peer)) => note!("{} does not answer; waiting for it", peer),
        News::Event(Event::Restarted { peer, .. }) => note!("{} restarted", peer),
        News::Event(Event::Yielded { to, .. }) => note!("{} initiates too, and takes precedence", to),
        News::Event(_) => {}
    }
}

/// When the first frame is sent, and whose answers are awaited from then on.
fn waiting(peers: &[Mac], first_in: Option<Span>, open_loop: bool) -> String {
    let peers = peers.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    let first = first_in.map_or(0, Span::as_us) as f64 * 1e-6;
    let first = match first > AT_ONCE_S {
        true => format!("in {first:.1} s, if no other robot is heard to initiate until then (--alone: at once)"),
        false => "at once".to_string(),
    };
    match open_loop {
        true => format!("first frame {first}; then sounding {peers}, whether answers are heard or not"),
        false => format!("first frame {first}; then waiting for answers of {peers}"),
    }
}

/// How a session went.
fn summary(peers: &[Mac], finished: &Finished, open_loop: bool) -> String {
    let (counts, figures, air) = (finished.counts(), &finished.exchange.figures, finished.air);
    let mut text = String::new();
    if counts.forward > 0 {
        let _ = writeln!(
            text,
            "{} forward frames, {} answered{}",
            counts.forward,
            counts.answered,
            if open_loop { String::new() } else { unanswered(counts.forward, counts.answered) }
        );
        for mac in peers {
            if let Some(link) = finished.exchange.tdma.link_counts(*mac) {
                let _ = writeln!(text, "  {mac}: {} sounded, {} answered", link.sounded, link.answered);
            }
        }
        let _ = writeln!(text, "  lateness: {}: every slot that was due, skipped ones too", spread_of(&figures.due_us));
        let _ = writeln!(text, "  lateness of the frames sent: {}", spread_of(&figures.lateness_us));
        let _ = writeln!(text, "  answers began after: {}", spread_of(&figures.answer_us));
    }
    if counts.forward + counts.replies == 0 {
        text.push_str(NOTHING_SENT);
    }
    if counts.replies > 0 {
        let _ = writeln!(text, "{} answers", counts.replies);
        let turn_around = spread_of(&figures.turn_around_us);
        let _ = writeln!(text, "  turn-around, from the kernel's receive stamp: {turn_around}");
    }
    if counts.answered + counts.replies > 0 {
        let [least, median, most] = KERNEL_TURN_AROUND_US;
        let airtime_us = finished.exchange.tdma.plan().phy.airtime_us(wsr::DEFAULT_LEN);
        let _ = writeln!(
            text,
            "  the WSR kernel driver: {least} to {most} us, median {median}, from start to start of the frames, {airtime_us} us of it on air"
        );
    }
    for (_, count, words) in not_sent(counts, figures, &air).into_iter().chain(not_used(counts, &air)) {
        if count > 0 {
            let _ = writeln!(text, "  {count} {words}");
        }
    }
    text + &confirmed(finished)
}

/// The unanswered frames, if there are more than a few, and likely causes.
fn unanswered(forward: u64, answered: u64) -> String {
    let missing = forward.saturating_sub(answered);
    match missing * 20 > forward {
        true => format!(
            "; {missing} ({:.0} %) were not: the other robot is off, far, or later than --turn-around allows",
            100.0 * missing as f64 / forward as f64
        ),
        false => String::new(),
    }
}

/// What the kernel reports of the frames sent.
fn confirmed(finished: &Finished) -> String {
    let (sent, failed, mut text) = (finished.sent(), finished.reported_failed(), String::new());
    if finished.air.tx_failed > 0 {
        let _ = writeln!(text, "  the kernel reports {failed} of {sent} frames as failed");
    }
    match finished.confirmed() {
        0 if sent > 0 => {
            let _ = writeln!(text, "  the kernel confirms none of {sent} frames as sent");
        }
        0 => {}
        confirmed => {
            let _ = writeln!(text, "  the kernel confirms {confirmed} of {sent} frames as sent");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_waited_for_is_said() {
        let peers = ["00:21:6a:00:00:02".parse().unwrap(), "00:21:6a:00:00:03".parse().unwrap()];
        let soon = waiting(&peers, Some(Span::from_ms(150)), false);
        assert_eq!(soon, "first frame at once; then waiting for answers of 00:21:6a:00:00:02, 00:21:6a:00:00:03");
        assert!(waiting(&peers, Some(Span::from_ms(6_400)), false).contains("in 6.4 s, if no other robot"));
    }

    #[test]
    fn rounds_without_an_answer_are_said_where_they_are_many() {
        assert_eq!(unanswered(1_000, 980), "");
        assert_eq!(unanswered(0, 0), "");
        assert!(unanswered(900, 600).contains("300 (33 %)"));
    }
}
