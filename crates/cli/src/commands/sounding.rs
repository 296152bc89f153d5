//! What `sound` and `respond` share: arguments, the running exchange, its summary.

use super::args::mac;
use super::live::{Listening, Signals, create_refused, duration};
use super::{Outcome, Result, usage};
use csi5300::exchange::tdma::{Config, Dialect, Event, GUARD_US, Phy, Plan, PlanError, Request, TURN_AROUND_US, Tdma};
use csi5300::source::recorder::{LogFiles, Options, Recorder, Rotation, Totals};
use csi5300::source::{CsiSource, Error, Next};
use csi5300::time::{Instant, Span};
use csi5300_live::doctor::Machine;
use csi5300_live::monitor::{Counters, Monitor};
use csi5300_live::netlink::Netlink;
use csi5300_live::sounding::{
    Exchange, KERNEL_TURN_AROUND_US, News, Opened, Rate, Running, Settings, Setup, rate_n_flags, read_key, set_rate,
    spread_of,
};
use csi5300_live::wait::Monotonic;
use csi5300_sim::served;
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use driver_iface::radiotap::Bandwidth;
use driver_iface::sounding::wsr;
use std::fmt::Write as _;
use std::os::fd::{AsFd, OwnedFd};
use std::path::PathBuf;

/// How often news are fetched and the view is drawn.
const LOOK: Span = Span::from_ms(50);

/// How long the driver is listened to after the end, if it does not fall silent before.
const LAST_WORDS: Span = Span::from_ms(500);

/// Arguments of both commands.
#[derive(clap::Args, Clone, Debug)]
pub struct Sounding {
    /// Monitor interface
    #[arg(long, value_name = "NAME", required_unless_present = "room", conflicts_with = "room")]
    pub interface: Option<String>,
    /// MACs of the other robots, with commas between; in the WSR dialect the first is sounded with --first-len, the next
    /// with two bytes more, and so on
    #[arg(long, required = true, value_delimiter = ',', value_parser = mac, value_name = "MAC,..")]
    pub peers: Vec<Mac>,
    /// Rounds a second: one exchange with every peer each
    #[arg(long, default_value_t = 100.0, value_name = "HZ")]
    pub rate: f64,
    /// Frames: ours, which need no more than the stock CSI driver, or the WSR toolbox's
    #[arg(long, value_enum, default_value_t = Words::Native)]
    pub dialect: Words,
    /// Links in a round, the same on all robots; as many as there are peers where not given
    #[arg(long, value_name = "N")]
    pub links: Option<u16>,
    /// Modulation of every frame, 0 to 23; from 8 on it has several streams, on as many antennas
    #[arg(long, default_value_t = 1, value_name = "MCS")]
    pub mcs: u8,
    /// Frames 40 MHz wide
    #[arg(long)]
    pub ht40: bool,
    /// WSR dialect: length of the frames for the first robot, frame check sequence included
    #[arg(long, default_value_t = wsr::DEFAULT_LEN as u16, value_name = "BYTES")]
    pub first_len: u16,
    /// WSR dialect: length of the frames that this robot answers (57, 59, 61 ...)
    #[arg(long, value_name = "BYTES")]
    pub ack_len: Option<u16>,
    /// How late a frame may be sent, and how much time is left free after it, microseconds; later ones are skipped
    #[arg(long, default_value_t = GUARD_US, value_name = "US")]
    pub guard: u32,
    /// How long after a forward frame its answer may begin, microseconds
    #[arg(long, default_value_t = TURN_AROUND_US, value_name = "US")]
    pub turn_around: u32,
    /// File with a key that all robots share, 32 hexadecimal digits or 16 bytes: frames without it are ignored
    ///
    /// So are frames of an older session. A session is numbered by the clock, and later than the one before as kept in
    /// $XDG_STATE_HOME/csi5300, ~/.local/state/csi5300 or /var/lib/csi5300: where none of these can be written and the
    /// clock was set back, the others ignore this robot until its clock has caught up.
    #[arg(long, value_name = "FILE")]
    pub key: Option<PathBuf>,
    /// This robot's MAC, instead of the interface's own
    #[arg(long, value_parser = mac, value_name = "MAC")]
    pub mac: Option<Mac>,
    /// Answers carry no measurement (native dialect); then they are shorter, and there are no live bearings
    #[arg(long)]
    pub no_measurement: bool,
    /// Leave the driver's rate (monitor_tx_rate) as it is
    #[arg(long)]
    pub keep_rate: bool,
    /// Do not ask for SCHED_FIFO
    #[arg(long)]
    pub no_fifo: bool,
    /// Stop after this time
    #[arg(long, value_parser = duration, value_name = "TIME")]
    pub stop_after: Option<Span>,
    /// Also record the driver's messages to this log
    #[arg(long, value_name = "OUT.dat")]
    pub log: Option<PathBuf>,
    /// Overwrite the log if it is there
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub listening: Listening,
}

/// A dialect by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Words {
    /// Ours: destination, role, number and slot in the frame
    Native,
    /// The WSR toolbox's: robots told apart by length
    Wsr,
}

impl Sounding {
    /// The request for a plan.
    pub fn request(&self) -> Request {
        let bandwidth = if self.ht40 { Bandwidth::Ht40 } else { Bandwidth::Ht20 };
        let dialect = match self.dialect {
            Words::Native => Dialect::Native { measurement: !self.no_measurement, authenticated: self.key.is_some() },
            Words::Wsr => Dialect::Wsr { first_len: self.first_len },
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

    /// What frames go through, in words.
    fn name(&self) -> String {
        match (&self.interface, &self.listening.room) {
            (Some(interface), _) => interface.clone(),
            (None, Some(address)) => address.to_string(),
            (None, None) => String::new(),
        }
    }

    /// The robot's index in the WSR dialect, from the length that it answers.
    fn own_index(&self) -> Option<u16> {
        self.ack_len.map(|len| len.saturating_sub(self.first_len) / 2)
    }

    /// What of the arguments contradicts itself ends the command.
    fn check(&self) {
        match (self.dialect, self.ack_len) {
            (Words::Native, Some(_)) => usage("--ack-len belongs to --dialect wsr"),
            (Words::Wsr, Some(len)) if len < self.first_len || (len - self.first_len) % 2 == 1 => {
                usage(&format!("--ack-len {len}: {}, and two bytes more for each robot", self.first_len))
            }
            _ => {}
        }
        if self.dialect == Words::Wsr && self.key.is_some() {
            usage("--key belongs to the native dialect: WSR frames have no room for a tag");
        }
    }

    /// Opens the interface and makes the machine.
    pub fn open(&self, settle: impl FnOnce(&mut Config)) -> std::result::Result<(Tdma, Monitor), String> {
        self.check();
        let request = self.request();
        let plan = Plan::new(&request).map_err(|error| refused(&error))?;
        let text = |error: Error| error.to_string();
        let setup = Setup {
            interface: self.name(),
            mac: self.mac,
            peers: self.peers.clone(),
            request,
            own_index: self.own_index().unwrap_or(0),
            key: self.key.as_deref().map(read_key).transpose().map_err(text)?,
        };
        let monitor = match &self.listening.room {
            Some(address) => served::join(address, served::Role::Air)
                .and_then(|(air, mac)| Monitor::over(air, mac, &setup.options())),
            None => Monitor::open(&setup.options()),
        };
        let opened = monitor.and_then(|monitor| {
            setup.open_on(monitor, |config| {
                // A WSR robot without a length of its own answers nothing: its kernel may.
                config.respond = self.dialect == Words::Native || self.ack_len.is_some();
                settle(config);
            })
        });
        let Opened { tdma, monitor, own, warning } = opened.map_err(text)?;
        warning.into_iter().for_each(|warning| eprintln!("{warning}"));
        eprintln!(
            "{} is {}; {} links in a round, {:.3} rounds/s, slots of {:.0} us (at least {})",
            self.name(),
            own,
            plan.slots(),
            plan.rate_hz(),
            plan.slot_us(),
            plan.shortest_slot_us()
        );
        Ok((tdma, monitor))
    }

    /// Sees to the driver's rate.
    pub fn see_to_rate(&self, antenna: Antenna) -> std::result::Result<(), String> {
        let Some(interface) = self.interface.as_deref().filter(|_| !self.keep_rate) else { return Ok(()) };
        let rate = rate_n_flags(self.request().phy, antenna).ok_or_else(|| {
            format!("--mcs {} has more streams than the card has antennas: 23 is the highest", self.mcs)
        })?;
        match set_rate(&Machine, interface, rate) {
            Rate::FromRadiotap | Rate::Right(_) => {}
            Rate::Set(rate, before) => eprintln!("monitor_tx_rate set to {rate:#x} (was {before})"),
            Rate::Other { found, error, mend } => {
                eprintln!("monitor_tx_rate is {found}, so frames go out at another rate ({error}): {mend}");
            }
        }
        Ok(())
    }

    /// The driver's messages, if they are wanted: recorded, or only read.
    pub fn source(&self, wanted: Wanted) -> std::result::Result<Source, String> {
        if self.log.is_none() && wanted == Wanted::Not {
            return Ok(Source::None);
        }
        let listener = match self.listening.open() {
            Ok(listener) => listener,
            Err(error) if self.log.is_none() && wanted == Wanted::IfPossible => {
                eprintln!("answers carry no measurement: {error}");
                return Ok(Source::None);
            }
            Err(error) => return Err(error),
        };
        eprintln!("{}", Listening::describe(&listener));
        let Some(log) = &self.log else { return Ok(Source::Bare(Box::new(listener))) };
        let text = |error: Error| error.to_string();
        let files = LogFiles::create(log, Rotation::default(), self.force).map_err(|error| create_refused(&error))?;
        let recorder = Recorder::new(listener, files, Options::default()).map_err(text)?;
        Ok(Source::Logged(Box::new(recorder)))
    }
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
pub enum Wanted {
    /// No.
    Not,
    /// They would help.
    IfPossible,
    /// Nothing goes without them.
    Needed,
}

/// The driver's messages.
pub enum Source {
    /// Not listened to.
    None,
    /// Only read.
    Bare(Box<Netlink>),
    /// Also recorded.
    Logged(Box<Recorder<Netlink, LogFiles>>),
}

impl Source {
    fn fd(&self) -> std::result::Result<Option<OwnedFd>, String> {
        let fd = match self {
            Self::None => return Ok(None),
            Self::Bare(listener) => listener.as_fd(),
            Self::Logged(recorder) => recorder.source().as_fd(),
        };
        fd.try_clone_to_owned().map(Some).map_err(|error| format!("the connector socket: {error}"))
    }

    fn receive(&mut self, now: Instant) -> std::result::Result<Next<'_>, Error> {
        match self {
            Self::None => Ok(Next::Pending),
            Self::Bare(listener) => listener.receive(now),
            Self::Logged(recorder) => recorder.receive(now),
        }
    }

    fn next_at(&self) -> Option<Instant> {
        if let Self::Logged(recorder) = self { recorder.next_at() } else { None }
    }

    /// Ends the log; gives what is in it, and what the kernel dropped before it.
    fn finish(self, now: Instant) -> std::result::Result<Option<(Totals, u64)>, String> {
        let Self::Logged(recorder) = self else { return Ok(None) };
        let (listener, _, totals) = recorder.finish(now).map_err(|error| error.to_string())?;
        let counters = listener.counters();
        Ok(Some((totals, counters.kernel_drops.max(counters.overrun_bfee_gap) + counters.other_bfee_gap)))
    }
}

/// What a command does with what comes.
pub trait Task {
    /// Something from the driver.
    fn record(&mut self, next: &Next<'_>, running: &Running);
    /// Something from the air.
    fn event(&mut self, event: &Event);
    /// Time to look up and speak.
    fn look(&mut self, now: Instant, running: &Running);
}

/// Runs until a signal, the time is up, or the interface fails; then says how it went.
pub fn run(
    common: &Sounding,
    signals: &Signals,
    mut source: Source,
    (tdma, monitor): (Tdma, Monitor),
    clock: Monotonic,
    task: &mut dyn Task,
) -> Result {
    let text = |error: Error| error.to_string();
    let settings = Settings { fifo_priority: Settings::default().fifo_priority.filter(|_| !common.no_fifo) };
    let connector = source.fd()?;
    let running = Running::start(tdma, monitor, clock, settings).map_err(text)?;
    let end_at = common.stop_after.map(|span| clock.now() + span);
    let mut failed = None;
    loop {
        if let Err(error) = take(&mut source, clock.now(), &running, task) {
            failed = Some(error.to_string());
            break;
        }
        while let Some(news) = running.news() {
            tell(&news, task);
        }
        let now = clock.now();
        task.look(now, &running);
        if running.has_ended() || end_at.is_some_and(|end| end <= now) {
            break;
        }
        let until = [source.next_at(), end_at, Some(now + LOOK)].into_iter().flatten().min();
        // Without a listener the signals are waited for twice.
        let first = connector.as_ref().map_or(signals.as_fd(), |fd| fd.as_fd());
        if clock.wait([first, signals.as_fd()], until).map_err(text)?[1] {
            break;
        }
    }
    let (exchange, left, news_lost, error) = running.stop().map_err(text)?;
    left.iter().for_each(|news| tell(news, task));
    // What the driver had said by then belongs in the log. A driver that never stops to speak does not hold up the end.
    let enough_at = clock.now() + LAST_WORDS;
    while failed.is_none() && matches!(source, Source::Logged(_)) && clock.now() < enough_at {
        match source.receive(clock.now()) {
            Ok(Next::Pending | Next::End(_)) => break,
            Ok(_) => {}
            Err(error) => failed = Some(error.to_string()),
        }
    }
    let logged = source.finish(clock.now())?;
    Ok(conclude(common, exchange, logged, news_lost, failed.or(error.map(text))))
}

/// Said once where the driver's records cannot be told apart.
pub const NO_NUMBERS: &str = "the driver's records carry neither sender nor number: load it with connector_log=0x5 (csitool), or use the WSR driver";

/// Takes everything that the driver has said.
fn take(source: &mut Source, now: Instant, running: &Running, task: &mut dyn Task) -> std::result::Result<(), Error> {
    loop {
        let next = source.receive(now)?;
        if matches!(next, Next::Pending | Next::End(_)) {
            return Ok(());
        }
        task.record(&next, running);
    }
}

fn tell(news: &News, task: &mut dyn Task) {
    match news {
        News::Started(granted) => eprintln!("{granted}"),
        News::Notice(notice) => eprintln!("{notice}"),
        News::Event(event) => {
            match event {
                Event::Joined(peer) => eprintln!("{} is there", peer),
                Event::Absent(peer) => eprintln!("{} does not answer any more", peer),
                Event::Restarted { peer, .. } => eprintln!("{} was started anew", peer),
                Event::Yielded { to, .. } => eprintln!("{} initiates too, and takes precedence", to),
                _ => {}
            }
            task.event(event);
        }
    }
}

/// Says how it went, and gives the outcome.
fn conclude(
    common: &Sounding,
    mut exchange: Exchange<Monitor>,
    logged: Option<(Totals, u64)>,
    news_lost: u64,
    failed: Option<String>,
) -> Outcome {
    let air = exchange.air.counters();
    eprint!("{}", summary(common, &exchange, &air));
    if news_lost > 0 {
        eprintln!("  {news_lost} news of the air were not fetched in time");
    }
    let mut lost = air.not_taken() > 0 || failed.is_some();
    if let (Some((totals, before)), Some(log)) = (logged, &common.log) {
        eprintln!("{} records written to {}", totals.written, log.display());
        let missing = totals.dropped + totals.lost_on_disk + before;
        if missing > 0 {
            eprintln!("  {missing} records are not in it");
            lost = true;
        }
    }
    if let Some(message) = failed {
        eprintln!("csi5300: {message}");
    }
    let counts = exchange.tdma.counts();
    match counts.answered + counts.replies {
        0 => Outcome::Nothing,
        _ if lost => Outcome::DataLost,
        _ => Outcome::Done,
    }
}

fn summary(common: &Sounding, exchange: &Exchange<Monitor>, air: &Counters) -> String {
    let (counts, figures, mut text) = (exchange.tdma.counts(), &exchange.figures, String::new());
    if counts.forward > 0 {
        let _ = writeln!(text, "{} forward frames, {} answered", counts.forward, counts.answered);
        for mac in &common.peers {
            if let Some(link) = exchange.tdma.link_counts(*mac) {
                let _ = writeln!(text, "  {mac}: {} sounded, {} answered", link.sounded, link.answered);
            }
        }
        let _ = writeln!(text, "  lateness: {}: every slot that was due, skipped ones too", spread_of(&figures.due_us));
        let _ = writeln!(text, "  lateness of the frames sent: {}", spread_of(&figures.lateness_us));
        let _ = writeln!(text, "  answers began after: {}", spread_of(&figures.answer_us));
    }
    if counts.replies > 0 {
        let _ = writeln!(text, "{} answers", counts.replies);
        let _ =
            writeln!(text, "  turn-around, from the kernel's receive stamp: {}", spread_of(&figures.turn_around_us));
    }
    if counts.answered + counts.replies > 0 {
        let [least, median, most] = KERNEL_TURN_AROUND_US;
        let airtime_us = exchange.tdma.plan().phy().airtime_us(wsr::DEFAULT_LEN);
        let _ = writeln!(
            text,
            "  the WSR kernel driver: {least} to {most} us, median {median}, from rise to rise, {airtime_us} us of it on air"
        );
    }
    let skipped = [
        (counts.missed_slots + figures.too_late, "frames skipped because the host was late (never sent late)"),
        (counts.missed_replies, "answers skipped because they were late"),
        (figures.perhaps_late, "frames handed over in time, but taken only after it"),
    ];
    let refused = [
        (air.no_room, "frames not taken: no room in the kernel's queue"),
        (air.down, "frames not taken: the interface was down"),
        (air.too_long, "frames not taken: longer than the MTU"),
        (air.cut, "frames of which the kernel took only a part"),
    ];
    let heard = [
        (air.dropped, "frames heard but dropped by the kernel before they were read"),
        (air.stale, "frames dropped because they had lain in the kernel's queue for a second or more"),
        (air.bad_fcs, "frames with a wrong check sequence"),
        (air.damaged, "frames behind an unreadable radiotap header"),
        (counts.foreign, "frames of another dialect or damaged"),
        (counts.strangers, "frames of robots that are no peers"),
        (counts.unauthenticated, "frames without the key"),
        (counts.replayed, "frames repeated or of an old session"),
        (counts.unmatched, "answers to nothing that waits"),
        (counts.other_plan, "frames of another plan (--rate, --links)"),
        (counts.yields, "turns given up to another initiator"),
        (counts.overslept, "turns lost because the host was away"),
        (counts.rivals, "frames of an initiator or a turn that contradicts what was heard before"),
        (counts.off_epoch, "frames at another time than their slot's"),
        (counts.own_echoes, "copies of this robot's own frames"),
        (counts.events_lost, "events lost because too many came at once"),
    ];
    for (count, what) in skipped.into_iter().chain(refused).chain(heard).filter(|(count, _)| *count > 0) {
        let _ = writeln!(text, "  {count} {what}");
    }
    let sent = counts.forward + counts.replies;
    if air.tx_failed > 0 {
        let _ = writeln!(text, "  the kernel reports {} of {sent} frames as failed", air.tx_failed.min(sent));
    }
    let confirmed = air.tx_status.saturating_sub(air.tx_failed).min(sent);
    if confirmed > 0 {
        let _ = writeln!(text, "  the kernel confirms {confirmed} of {sent} frames as sent");
    } else if sent > 0 {
        let _ = writeln!(text, "  the kernel confirms none of {sent} frames as sent");
    }
    text
}
