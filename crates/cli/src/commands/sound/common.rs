//! What sounding and answering (`sound --answer`) share: arguments, interface, messages.

use super::super::Words;
use super::super::args::{channel_of_5300, mac};
use super::super::listener::{Listening, Needs, describe};
use super::super::live::{Signals, create_refused, duration, join_refused};
use super::super::{Outcome, is_end_of_room, usage};
use csi5300::exchange::tdma::{Config, Dialect, Phy, Plan, PlanError, Request};
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::Error;
use csi5300::source::recorder::{LogFiles, Rotation};
use csi5300::time::Span;
use csi5300_live::doctor::Machine;
use csi5300_live::monitor::Monitor;
use csi5300_live::sounding::{
    DriverMessages, Finished, Observer, Opened, Rate, Session, Settings, Setup, rate_n_flags, read_key, set_rate,
};
use csi5300_live::wait::Monotonic;
use csi5300_sim::served;
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use driver_iface::radiotap::Bandwidth;
use driver_iface::sounding::wsr;
use std::os::fd::AsFd;
use std::path::PathBuf;

mod causes;
mod row;
mod words;

pub use row::ExchangeRow;
pub use words::{NO_NUMBERS, tell, waiting};

/// WSR dialect: length of the frames for the first robot, frame check sequence included.
const FIRST_LEN: u16 = wsr::DEFAULT_LEN as u16;

// Arguments of sounding and answering.
#[derive(clap::Args, Clone, Debug)]
pub struct Sounding {
    /// Monitor interface
    #[arg(long, value_name = "NAME", required_unless_present = "room", conflicts_with = "room")]
    pub interface: Option<String>,
    /// MACs of the other robots; in the WSR dialect they get frames of 57, 59, 61 ... bytes
    #[arg(long, required = true, value_delimiter = ',', value_parser = mac, value_name = "MAC,..")]
    pub peers: Vec<Mac>,
    /// Rounds a second, each with one exchange per peer
    #[arg(long, default_value_t = 100.0, value_name = "HZ")]
    pub rate: f64,
    /// Format of the frames
    #[arg(long, value_enum, default_value_t = DialectArg::Native)]
    pub dialect: DialectArg,
    /// Links in a round, the same on all robots [default: the number of peers]
    #[arg(long, value_name = "N")]
    pub links: Option<u16>,
    /// Modulation of every frame, 0 to 23; from 8 on frames use several streams and antennas
    #[arg(long, default_value_t = 1, value_name = "MCS")]
    pub mcs: u8,
    // Of one version ago: a channel of 40 MHz says so.
    #[arg(long, hide = true)]
    pub ht40: bool,
    /// WiFi channel, with + or - for 40 MHz; needed for bearings
    #[arg(long, value_parser = channel_of_5300, value_name = "NUMBER")]
    pub channel: Option<Channel>,
    /// WSR dialect: length of the frames that this robot answers (57, 59, 61 ...)
    #[arg(long, value_name = "BYTES")]
    pub ack_len: Option<u16>,
    /// How late a frame may be sent, and the free time after it, microseconds; later frames are skipped
    #[arg(long, default_value_t = Request::default().guard_us, value_name = "US")]
    pub guard: u32,
    /// How long after a forward frame its answer may begin, microseconds
    #[arg(long, default_value_t = Request::default().turn_around_us, value_name = "US")]
    pub turn_around: u32,
    /// Key file of the group or of this robot (`csi5300 key`): frames without a valid tag and of older sessions are
    /// ignored
    ///
    /// The clock numbers the sessions; $XDG_STATE_HOME/csi5300, ~/.local/state/csi5300 or /var/lib/csi5300 keeps the
    /// last number. If none can be written and the clock is set back, other robots ignore this one until its clock has
    /// caught up.
    #[arg(long, value_name = "FILE")]
    pub key: Option<PathBuf>,
    /// This robot's MAC, instead of the interface's own
    #[arg(long, value_parser = mac, value_name = "MAC")]
    pub mac: Option<Mac>,
    /// Do not ask for SCHED_FIFO
    #[arg(long)]
    pub no_fifo: bool,
    /// Stop after this time
    #[arg(long, value_parser = duration, value_name = "TIME")]
    pub stop_after: Option<Span>,
    /// Also record what the card hears to this log
    #[arg(long, value_name = "OUT.dat")]
    pub log: Option<PathBuf>,
    /// Overwrite existing outputs
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub listening: Listening,
}

/// A dialect by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum DialectArg {
    /// Ours, for any CSI driver: destination, role, number and slot in the frame
    Native,
    /// The WSR toolbox's: the length of a frame addresses a robot
    Wsr,
}

impl Sounding {
    /// The plan that the arguments request.
    pub fn request(&self) -> Request {
        let is_wide = self.ht40 || self.channel.is_some_and(|channel| channel.width() != Width::Ht20);
        let bandwidth = if is_wide { Bandwidth::Ht40 } else { Bandwidth::Ht20 };
        let dialect = match self.dialect {
            DialectArg::Native => Dialect::Native { measurement: true, authenticated: self.key.is_some() },
            DialectArg::Wsr => Dialect::Wsr { first_len: FIRST_LEN },
        };
        let own = self.own_index().map_or(0, |index| index.saturating_add(1));
        let peers = u16::try_from(self.peers.len()).unwrap_or(u16::MAX);
        Request::new(self.links.unwrap_or(peers.max(own)), self.rate)
            .with_phy(Phy { mcs: self.mcs, bandwidth })
            .with_dialect(dialect)
            .with_guard_us(self.guard)
            .with_turn_around_us(self.turn_around)
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

    /// Ends the command if arguments contradict each other.
    fn check(&self) {
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
    pub fn open(&self, settle: impl FnOnce(&mut Config)) -> Words<Opened> {
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
            Some(address) => {
                let (air, mac) = served::join(address, served::Role::Air).map_err(|error| join_refused(&error))?;
                Monitor::over(air, mac, &setup.options())
            }
            None => Monitor::open(&setup.options()),
        };
        let opened = monitor.and_then(|monitor| {
            setup.open_on(monitor, |config| {
                // A WSR robot without a length answers nothing here; its kernel may.
                config.respond = self.dialect == DialectArg::Native || self.ack_len.is_some();
                settle(config);
            })
        });
        let opened = opened.map_err(text)?;
        opened.warning.iter().for_each(|warning| note!("{warning}"));
        note!(
            "{} is {}; {} in a round, {:.3} rounds/s, slots of {:.0} us (at least {})",
            self.name(),
            opened.own,
            super::super::some(plan.slots.into(), "link", "links"),
            plan.rate_hz(),
            plan.slot_us(),
            plan.shortest_slot_us()
        );
        Ok(opened)
    }

    /// Sets or checks the driver's rate.
    pub fn see_to_rate(&self, antenna: Antenna) -> Words<()> {
        self.interface.as_deref().map_or(Ok(()), |interface| see_to_rate(interface, self.request().phy, antenna))
    }

    /// The card's records, if wanted: recorded, or only read. `own` is this robot's MAC.
    pub fn messages(&self, wanted: Wanted, own: Mac) -> Words<DriverMessages> {
        if self.log.is_none() && wanted == Wanted::Not {
            return Ok(DriverMessages::none());
        }
        let needs = Needs { own: Some(own), frames: self.key.is_some(), receive_buffer: None };
        let listener = match self.listening.open(needs) {
            Ok(listener) => listener,
            Err(error) if self.log.is_none() && wanted == Wanted::IfPossible => {
                note!("answers carry no measurement: {error}");
                return Ok(DriverMessages::none());
            }
            Err(error) => return Err(error),
        };
        note!("{}", describe(&listener));
        let Some(log) = &self.log else { return Ok(DriverMessages::read(listener)) };
        let files = LogFiles::create(log, Rotation::default(), self.force);
        files.and_then(|files| DriverMessages::recorded(listener, files)).map_err(|error| create_refused(&error))
    }

    /// Runs until a signal, the time limit or a failure of the interface; then prints the summary and returns it for JSON.
    pub fn run(
        &self,
        signals: &Signals,
        messages: DriverMessages,
        opened: Opened,
        clock: Monotonic,
        observer: &mut dyn Observer,
    ) -> Words<(Outcome, ExchangeRow)> {
        let fifo_priority = Settings::default().fifo_priority.filter(|_| !self.no_fifo);
        let session = Session::new(clock, signals.as_fd())
            .with_settings(Settings { fifo_priority, ..Settings::default() })
            .with_stop_at(self.stop_after.map(|span| clock.now() + span));
        let finished = session.run(opened, messages, observer).map_err(|error| error.to_string())?;
        let error = finished.error.as_ref().filter(|_| !self.room_ended(&finished)).map(ToString::to_string);
        Ok((self.conclude(&finished), ExchangeRow::new(&self.peers, &finished, error)))
    }

    /// True if the simulated room ended, which is a normal end.
    fn room_ended(&self, finished: &Finished) -> bool {
        finished.error.as_ref().is_some_and(|error| self.listening.room.is_some() && is_end_of_room(error))
    }

    /// Prints the summary, and returns the outcome.
    fn conclude(&self, finished: &Finished) -> Outcome {
        notes!("{}", words::summary(&self.peers, finished));
        if finished.news_lost > 0 {
            note!("  {} events of the radio were lost", finished.news_lost);
        }
        if let (Some(totals), Some(log)) = (&finished.log, &self.log) {
            note!("{} written to {}", super::super::some(totals.recorded.written, "record", "records"), log.display());
            if totals.missing() > 0 {
                note!("  not in it: {}", super::super::some(totals.missing(), "record", "records"));
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
        match counts.answered + counts.replies {
            0 => Outcome::Nothing,
            _ if lost => Outcome::DataLost,
            _ => Outcome::Done,
        }
    }
}

/// Sets or checks the rate at which an interface's driver sends.
pub fn see_to_rate(interface: &str, phy: Phy, antenna: Antenna) -> Words<()> {
    let rate = rate_n_flags(phy, antenna)
        .ok_or_else(|| format!("--mcs {} has more streams than the card has antennas: 23 is the highest", phy.mcs))?;
    match set_rate(&Machine, interface, rate) {
        Rate::FromRadiotap | Rate::Right(_) => {}
        Rate::Set(rate, before) => note!("monitor_tx_rate set to {rate:#x} (was {before})"),
        Rate::Legacy(mend) => {
            note!("this driver sends injected frames at a legacy rate, which makes no CSI: {mend}")
        }
        Rate::Other { found, error, mend } => {
            note!("monitor_tx_rate is {found}, so frames go out at another rate ({error}): {mend}");
        }
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
pub enum Wanted {
    /// Not needed.
    Not,
    /// Useful.
    IfPossible,
    /// Required.
    Needed,
}
