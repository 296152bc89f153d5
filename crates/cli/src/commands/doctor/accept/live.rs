//! The card of this machine, or a robot of a served room: listened to, while frames are sent or a person unplugs antennas.

use super::super::super::Words;
use super::super::Args;
use super::stopped::Stopped;
use super::{Desk, Found, Judged, assist, later, plan};
use crate::commands::listener::{Listening, Needs, describe};
use crate::commands::live::{Signals, join_refused};
use csi5300::internal::FrameReceiver;
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::{CsiSource, Error, Injector, Next};
use csi5300::time::{Instant, Span};
use csi5300_accept::{Collector, Interface, Sending, Side};
use csi5300_live::doctor::{Machine, System, channel_flags, module_counters};
use csi5300_live::listener::Listener;
use csi5300_live::monitor::{Monitor, Options};
use csi5300_live::wait::Monotonic;
use csi5300_sim::served::{self, Address};
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use std::cell::RefCell;
use std::hash::{Hash, Hasher};
use std::io::{BufRead, IsTerminal};
use std::os::fd::AsFd;

/// How long to listen to a card without `--listen`.
const LISTEN_S: f64 = 20.0;
/// How long with each antenna unplugged, and before.
const UNPLUGGED_S: f64 = 10.0;
/// How long frames may arrive after the last one was sent.
const TAIL_S: f64 = 1.0;
/// How long a person takes to unplug an antenna, for the announced duration.
const PERSON_S: f64 = 20.0;
/// How often a waiting host is woken, to see how late it is.
const WAKE_US: i64 = 5_000;

/// The robot of a room in place of the card, if any.
pub(super) fn address(desk: &Desk) -> Words<Option<Address>> {
    let parse = |text: &String| text.parse().map_err(|error| format!("room = {text:?}: {error}"));
    desk.room.as_ref().map(parse).transpose()
}

/// The card's records.
pub(super) fn open(args: &Args, desk: &Desk) -> Words<Listener> {
    let listening = Listening { card: args.card.clone(), allow_user_sender: false, room: address(desk)? };
    listening.open(Needs::default())
}

/// The interface that sends, and its MAC.
pub(super) fn air(desk: &Desk, options: &Options) -> Words<(Monitor, Mac)> {
    let monitor = match address(desk)? {
        Some(address) => {
            let (air, mac) = served::join(&address, served::Role::Air).map_err(|error| join_refused(&error))?;
            Monitor::over(air, mac, options)
        }
        None => Monitor::open(options),
    };
    let monitor = monitor.map_err(|error| error.to_string())?;
    let mac = monitor.mac().ok_or_else(|| format!("{} has no MAC", options.interface))?;
    Ok((monitor, mac))
}

/// An interface that frames are sent through while it is read.
struct Shared<'a>(&'a RefCell<Monitor>);

impl Injector for Shared<'_> {
    fn inject(&mut self, now: Instant, frame: &[u8]) -> Result<(), Error> {
        self.0.borrow_mut().inject(now, frame)
    }
}

/// What runs the card, without a name or an address.
fn facts(system: &dyn System, desk: &Desk) -> Vec<String> {
    let text = |path: &str| system.text(path).unwrap_or_else(|| "-".into());
    let backend = if desk.room.is_some() { "a robot of a served room" } else { "the card of this machine" };
    let mut facts = vec![format!("backend: {backend}"), format!("kernel: {}", text("/proc/sys/kernel/osrelease"))];
    for module in ["iwlwifi", "csi5300"] {
        let folder = format!("/sys/module/{module}/parameters");
        for name in system.names(&folder) {
            facts.push(format!("{module} {name}={}", text(&format!("{folder}/{name}"))));
        }
    }
    facts
}

/// The steps, in order.
pub(super) enum Step {
    Listen(Span),
    Send,
    Unplug(Antenna),
}

impl Step {
    /// The steps of a desk, and why others are skipped.
    fn plan(args: &Args, desk: &Desk) -> Words<(Vec<Self>, Option<&'static str>)> {
        let antenna = |name: &String| {
            let found = Antenna::ALL.into_iter().find(|antenna| format!("{antenna:?}") == *name);
            found.ok_or_else(|| format!("unplug = [{name:?}]: antennas are \"A\", \"B\" and \"C\""))
        };
        let unplug = desk.unplug.iter().map(antenna).collect::<Words<Vec<_>>>()?;
        let usual = if unplug.is_empty() { LISTEN_S } else { UNPLUGGED_S };
        let listen = args.listen.or((!desk.send).then(|| Span::from_s(usual))).map(Self::Listen);
        let mut steps: Vec<Self> = listen.into_iter().chain(desk.send.then_some(Self::Send)).collect();
        if unplug.is_empty() || std::io::stdin().is_terminal() {
            steps.extend(unplug.into_iter().map(Self::Unplug));
            return Ok((steps, None));
        }
        Ok((steps, Some("standard input is no terminal, so nobody is asked to unplug an antenna")))
    }

    fn takes_s(&self) -> f64 {
        match self {
            Self::Listen(span) => span.as_s(),
            Self::Send => Sending::takes().as_s() + TAIL_S,
            Self::Unplug(_) => UNPLUGGED_S + PERSON_S,
        }
    }

    fn words(&self) -> String {
        match self {
            Self::Listen(_) => "listen while another robot sounds".into(),
            Self::Send => "send frames at 20, 50, 200 and 1,000 a second".into(),
            Self::Unplug(antenna) => format!("you unplug antenna {antenna:?}"),
        }
    }

    /// What identifies a run: the channel, the card and the parts.
    fn asked(steps: &[Self], desk: &Desk, channel: Channel) -> String {
        let words: Vec<String> = steps.iter().map(|step| format!("{} {}", step.words(), step.takes_s())).collect();
        let text = format!("{channel} {:?} {:?} {:?} {}", desk.interface, desk.room, desk.peer, words.join(", "));
        // The folder may be sent: no name stands in it.
        let mut hasher = std::hash::DefaultHasher::new();
        text.hash(&mut hasher);
        format!("{:016x}", hasher.finish())
    }

    /// All of them, with the time that they take.
    fn told(steps: &[Self]) -> String {
        let words: Vec<String> =
            steps.iter().map(|step| format!("{} ({:.0} s)", step.words(), step.takes_s())).collect();
        let all: f64 = steps.iter().map(Self::takes_s).sum();
        format!("{}: {all:.0} s in all; Ctrl-C ends it sooner", words.join(", then "))
    }
}

/// What runs.
struct Run<'a> {
    clock: Monotonic,
    listener: Listener,
    monitor: Option<&'a RefCell<Monitor>>,
    signals: Signals,
    collector: Collector,
}

/// Judges what the card gives.
pub(super) fn listen(args: &Args, desk: &Desk) -> Found {
    let system = Machine;
    let mut plan = plan(args, desk)?;
    let (steps, left_out) = Step::plan(args, desk)?;
    let signals = Signals::catch().map_err(|error| error.to_string())?;
    let air = desk.send.then(|| sender(desk)).transpose()?;
    let mac = air.as_ref().map(|air| air.1);
    let asked = Step::asked(&steps, desk, plan.channel);
    let folder = args.report.as_deref();
    let before = folder.and_then(|folder| Some((folder, Stopped::read(folder, &asked, &steps)?)));
    let peer = desk.peer.as_deref().filter(|_| before.is_none());
    let helper = peer.map(|peer| assist::Helper::call(peer, plan.channel, mac)).transpose()?;
    plan.macs = mac.zip(helper.as_ref().and_then(assist::Helper::mac)).map(|(near, far)| [near, far]);
    let monitor = air.map(|(monitor, _)| RefCell::new(monitor));
    let listener = open(args, desk)?;
    note!("{}", describe(&listener));
    left_out.iter().for_each(|why| note!("{why}"));
    let mut collector = Collector::new(plan.clone());
    let mut finished = 0;
    if let Some((folder, stopped)) = &before {
        stopped.take_up(folder, &steps, &mut collector)?;
        finished = stopped.finished;
        let words: Vec<String> = steps.iter().take(finished).map(Step::words).collect();
        note!("continuing the interrupted run: {} taken from {}", words.join(", then "), folder.display());
    }
    note!("{}", Step::told(steps.get(finished..).unwrap_or_default()));
    let counters = module_counters(&system);
    let mut run = Run { clock: Monotonic::new(), listener, monitor: monitor.as_ref(), signals, collector };
    for step in steps.iter().skip(finished) {
        if run.step(step, mac)? {
            break;
        }
        finished += 1;
    }
    let Run { mut collector, signals, .. } = run;
    signals.take();
    for (name, count) in module_counters(&system) {
        let old = counters.iter().find(|(known, _)| *known == name).map_or(0, |(_, count)| *count);
        let earlier = before.as_ref().map_or(0, |(_, stopped)| stopped.counted(&name));
        collector.counted(&name, count.wrapping_sub(old) + earlier);
    }
    if let Some(monitor) = &monitor {
        let counters = monitor.borrow_mut().counters();
        let (confirmed, retried) = (Some(counters.tx_status), counters.tx_retried);
        // Of the channel that frames are named by, the lower or upper half of 40 MHz.
        let half = Channel::new(plan.channel.number(), Width::Ht20).map_err(|error| error.to_string())?;
        let mhz = (half.centre_hz() / 1e6).round() as u32;
        let channel_flags = desk.interface.as_deref().and_then(|name| channel_flags(&system, name, mhz));
        collector.interface(Interface { confirmed, retried, channel_flags });
    }
    if let Some(log) = helper.map(assist::Helper::end).transpose()? {
        collector.log(Side::Far, &log);
    }
    if collector.records() == 0 {
        note!("no record came: is another robot sounding on this channel? `csi5300 doctor` examines this one");
    }
    later(&mut collector, desk)?;
    let (evidence, mut facts, mut stopped) = (collector.finish(), facts(&system, desk), None);
    if let Some(step) = steps.get(finished) {
        let missing: Vec<String> = steps.iter().skip(finished).map(Step::words).collect();
        facts.push(format!(
            "stopped: {} of {} parts are finished; missing: {}",
            finished,
            steps.len(),
            missing.join(", then ")
        ));
        stopped = Stopped::after(finished, &steps, asked, &evidence);
        let how = match (&stopped, folder) {
            (Some(_), Some(_)) => "the same command continues from there",
            (Some(_), None) => "with --report DIR an interrupted run can be continued",
            (None, _) => "no part before it is complete, so the same command starts again",
        };
        note!("stopped before: {}; {how}", step.words());
    }
    Ok(Judged { evidence, facts, is_whole: finished == steps.len(), stopped })
}

/// The interface that the first robot sends through, set to an HT rate if possible.
fn sender(desk: &Desk) -> Words<(Monitor, Mac)> {
    let options = Options::new(desk.interface.clone().unwrap_or_default(), Sending::frame_len());
    let options = options.with_rate(assist::PHY.mcs, assist::PHY.bandwidth);
    if let Some(interface) = &desk.interface {
        crate::commands::sound::see_to_rate(interface, assist::PHY, Antenna::A)?;
    }
    air(desk, &options)
}

impl Run<'_> {
    /// True if a signal or the end of the records ends the run.
    fn step(&mut self, step: &Step, mac: Option<Mac>) -> Words<bool> {
        match step {
            Step::Listen(span) => self.until(self.clock.now() + *span, None),
            Step::Unplug(antenna) => {
                note!("unplug antenna {antenna:?} of this robot, and plug in all others; then press Enter");
                if self.wait_for_enter()? {
                    return Ok(true);
                }
                self.collector.unplugged(*antenna);
                self.until(self.clock.now() + Span::from_s(UNPLUGGED_S), None)
            }
            Step::Send => {
                let (Some(monitor), Some(mac)) = (self.monitor, mac) else { return Ok(false) };
                let mut injector = Shared(monitor);
                let mut sending = Sending::new(&mut injector, mac);
                // The schedule is the run's own; the clock began before.
                let begun = self.clock.now();
                let end = begun + Sending::takes() + Span::from_s(TAIL_S);
                self.until(end, Some(&mut (begun, &mut sending)))
            }
        }
    }

    /// Receives until `end` and sends what is due. True if a signal or the end of the records ends the run.
    fn until(&mut self, end: Instant, mut sending: Option<&mut (Instant, &mut Sending<'_>)>) -> Words<bool> {
        while self.clock.now() < end {
            let mut due = None;
            if let Some((begun, sending)) = &mut sending {
                let begun = *begun;
                while let Some(sent) = sending.send(Instant::ZERO + (self.clock.now() - begun)) {
                    self.collector.sent(sent);
                }
                due = sending.next_at().map(|at| begun + (at - Instant::ZERO));
            }
            if let Some(monitor) = self.monitor {
                // What the driver reports of own frames is counted on the way.
                while monitor.borrow_mut().hear().map_err(|error| error.to_string())?.is_some() {}
            }
            let next = self.listener.receive(self.clock.now()).map_err(|error| error.to_string())?;
            let (pending, over) = (matches!(next, Next::Pending), matches!(next, Next::End(_)));
            self.collector.heard(Side::Near, &next);
            if over || (pending && self.wait(end, due)?) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Waits for the listener or the next wake, and notes how late it was. True if a signal ends it.
    fn wait(&mut self, end: Instant, due: Option<Instant>) -> Words<bool> {
        let wake = (self.clock.now() + Span::from_us(WAKE_US)).min(end);
        let until = [self.listener.next_at(), due, Some(wake)].into_iter().flatten().min();
        let fds = [self.listener.as_fd(), self.signals.as_fd()];
        let ready = self.clock.wait(fds, until).map_err(|error| error.to_string())?;
        if !ready.contains(&true)
            && let Some(until) = until
        {
            self.collector.woke_late(self.clock.now() - until);
        }
        Ok(ready[1])
    }

    /// Waits for Enter and skips records meanwhile. True if a signal or the end of the input comes first.
    fn wait_for_enter(&mut self) -> Words<bool> {
        let stdin = std::io::stdin();
        loop {
            let until = self.clock.now() + Span::from_ms(50);
            let fds = [stdin.as_fd(), self.signals.as_fd()];
            match self.clock.wait(fds, Some(until)).map_err(|error| error.to_string())? {
                [_, true] => return Ok(true),
                [true, _] => {
                    let read = stdin.lock().read_line(&mut String::new()).map_err(|error| error.to_string())?;
                    return Ok(read == 0);
                }
                _ => {}
            }
            loop {
                match self.listener.receive(self.clock.now()).map_err(|error| error.to_string())? {
                    Next::Pending => break,
                    Next::End(_) => return Ok(true),
                    Next::Record(..) | Next::Lost(_) => {}
                }
            }
        }
    }
}
