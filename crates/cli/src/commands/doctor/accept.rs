//! `csi5300 doctor --accept`: which promises of the card, its driver and its host hold.
//!
//! The second robot waits for the first, records while that sends, answers if it is to, and hands its log over. They speak over one
//! connection of TCP, in lines: `csi5300-accept 1 CHANNEL MAC` (or `-` for a robot that does not send); `ok MAC` (or `-`), or `no WHY`;
//! `end`; `log BYTES` and the log. The finished parts of an interrupted run are kept in the report's folder; the same command continues
//! from them.

use super::Args;
use crate::commands::draft::{FolderDraft, reads};
use crate::commands::files::{open_log, read_trajectory, refuse_twice};
use crate::commands::live::{Listening, Needs, Signals};
use crate::commands::{InWords, Outcome, Result, Words, print, simulate, sound, usage};
use csi5300::exchange::tdma::{Dialect, Epoch, Phy, Request};
use csi5300::internal::FrameReceiver;
use csi5300::signal::channel::{Channel, Width};
use csi5300::source::{CsiSource, Next};
use csi5300::time::{Instant, Span};
use csi5300_accept::{
    After, Curve, Done, Evidence, Heard, Interface, Plan, Report, Sending, Side, Truth, Verdict, collect,
};
use csi5300_lab::show::{Chart, Look, Series};
use csi5300_live::doctor::{Machine, System, channel_flags, module_counters, module_growth};
use csi5300_live::listener::Listener;
use csi5300_live::monitor::{Monitor, Options};
use csi5300_live::sounding::{Running, Settings, Setup};
use csi5300_live::wait::Monotonic;
use csi5300_say::{Tone, toned};
use csi5300_sim::motion::RobotMotion;
use csi5300_sim::served::Address;
use csi5300_sim::{Room, Scene, stamp};
use driver_iface::Mac;
use driver_iface::bfee::Antenna;
use driver_iface::radiotap::Bandwidth;
use driver_iface::side_file::{Entry, Layout};
use driver_iface::sounding::wsr;
use std::collections::BTreeMap;
use std::hash::{Hash, Hasher};
use std::io::{BufRead, BufReader, IsTerminal, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The desk, as its TOML describes it. Every key is optional; without logs, this machine's card is judged.
#[derive(serde::Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct Desk {
    /// The first robot's log.
    near: Option<PathBuf>,
    /// The second robot's log of the same time.
    far: Option<PathBuf>,
    /// The channel, as `--channel` takes it.
    channel: Option<String>,
    /// Neither robot moves.
    at_rest: bool,
    /// The first robot's trajectory.
    trajectory: Option<PathBuf>,
    /// The true direction from the first to the second robot, degrees from +x towards +y of the trajectory's frame.
    azimuth_deg: Option<f64>,
    /// One or two logs, the first robot's first, after each retune.
    retuned: Vec<Vec<PathBuf>>,
    /// The same after the driver was reloaded.
    reloaded: Vec<Vec<PathBuf>>,
    /// The monitor interface: the first robot sends on it, the second answers.
    interface: Option<String>,
    /// A robot of a served room in place of a card: PATH#ROBOT.
    room: Option<String>,
    /// Send frames at several rates while listening.
    send: bool,
    /// Where the second robot waits (its `assist`), host and port: its log comes from there at the end.
    peer: Option<String>,
    /// This is the second robot; it waits here for the first, address and port.
    assist: Option<String>,
    /// The second robot answers on its interface; otherwise its driver answers, or nobody.
    answer: bool,
    /// Antennas that a person unplugs one after the other: A, B, C.
    unplug: Vec<String>,
}

impl Desk {
    /// Ends the command if keys contradict each other or the options.
    fn check(&self, args: &Args) {
        let is_live = self.near.is_none();
        let needs_interface = self.send || self.answer;
        let has_card = self.interface.is_some() || self.room.is_some() || self.send || !self.unplug.is_empty();
        let sets = [
            (
                !is_live && (has_card || self.peer.is_some() || self.assist.is_some()),
                "a desk with `near` is judged by that log: `interface`, `room`, `send`, `peer`, `assist` and `unplug` need a card",
            ),
            (is_live && self.far.is_some(), "`far` needs `near`, the first robot's log of the same time"),
            (
                self.room.is_some() && (self.interface.is_some() || args.card.is_named()),
                "a robot of a `room` takes the place of a card: leave out `interface`, --connector-index and --stock",
            ),
            (
                self.assist.is_some() && (args.report.is_some() || args.json || args.listen.is_some()),
                "the second robot hands its log to the first, which reports: give --report, --json and --listen there",
            ),
            (
                self.assist.is_some() && (self.send || self.peer.is_some() || !self.unplug.is_empty()),
                "`assist` is for the second robot; `send`, `peer` and `unplug` are for the first",
            ),
            (self.answer && self.assist.is_none(), "`answer` belongs to the second robot, which has `assist`"),
            (
                needs_interface && self.interface.is_none() && self.room.is_none(),
                "`send` and `answer` need the monitor interface: `interface = \"mon0\"`",
            ),
            (
                self.send && !self.unplug.is_empty(),
                "`send` and `unplug` do not go together: run one after the other, while another robot sounds",
            ),
            (
                self.azimuth_deg.is_some_and(|deg| !(-360.0..=360.0).contains(&deg)),
                "`azimuth_deg` is a direction, from -360 to 360 degrees",
            ),
            (
                self.retuned.iter().chain(&self.reloaded).any(|logs| !(1..=2).contains(&logs.len())),
                "each item of `retuned` and `reloaded` is one log or two: [[\"near2.dat\", \"far2.dat\"]]",
            ),
        ];
        if let Some((_, why)) = sets.iter().find(|(is_wrong, _)| *is_wrong) {
            usage(why);
        }
        let later = self.retuned.iter().chain(&self.reloaded).flatten();
        refuse_twice(self.near.iter().chain(&self.far).chain(later));
    }
}

/// Judges the desk. Exit status 1 if a claim fails or none could be tried, 3 if the run was interrupted.
pub fn run(args: &Args) -> Result {
    let folder = args.report.as_deref().filter(|folder| !folder.join("report.json").exists());
    if let Some(log) = folder.into_iter().flat_map(logs_in).next() {
        return Err(format!("{} exists, and no report beside it: give --report another folder", log.display()));
    }
    let Some(Judged { mut evidence, facts, is_whole, stopped }) = evidence(args)? else { return Ok(Outcome::Done) };
    let mut report = evidence.judge();
    report.facts = facts;
    match args.json {
        true => print(&format!("{}\n", report.json().in_words()?)),
        false => print(&text(&report)),
    }
    if let Some(folder) = &args.report {
        write(&report, &evidence, stopped.as_ref(), folder)?;
        note!(
            "the report is in {}: report.html to look at, report.json, report.xml (JUnit), bench-log.md; the logs beside it have MAC addresses, the report has none",
            folder.display()
        );
    }
    let judged = report.count(Verdict::Holds) + report.count(Verdict::Measured);
    Ok(Outcome::of(report.count(Verdict::Fails) == 0 && judged > 0, !is_whole))
}

/// The table with coloured verdicts.
fn text(report: &Report) -> String {
    let coloured = |line: &str| {
        let tones = [("FAILS", Tone::Bad), ("holds", Tone::Good)];
        match tones.iter().find(|(word, _)| line.starts_with(word)) {
            Some((word, tone)) => format!("{}{}", toned(word, *tone), &line[word.len()..]),
            None => line.to_owned(),
        }
    };
    let mut text: String = report.facts.iter().map(|fact| format!("{fact}\n")).collect();
    let is_long = csi5300_say::says(csi5300_say::Level::Verbose);
    let words = if is_long { format!("{report:#}") } else { report.to_string() };
    text.extend(words.lines().map(|line| coloured(line) + "\n"));
    text
}

/// The observations that claims are judged by, and facts about their source.
struct Judged {
    evidence: Evidence,
    facts: Vec<String>,
    /// All parts of the run are finished.
    is_whole: bool,
    /// The part of an interrupted run that can be continued.
    stopped: Option<Stopped>,
}

impl Judged {
    fn of(evidence: Evidence, fact: String) -> Self {
        Self { evidence, facts: vec![fact], is_whole: true, stopped: None }
    }
}

/// `None` if this robot assisted.
fn evidence(args: &Args) -> Words<Option<Judged>> {
    let toml = |path: &Path| path.extension().is_some_and(|ending| ending == "toml");
    let found = match args.what.as_slice() {
        [] => listen(args, &Desk::default()),
        [only] if toml(only) && only.exists() => {
            let text = std::fs::read_to_string(only).map_err(|error| format!("{}: {error}", only.display()))?;
            match Scene::parse(&text) {
                Ok(scene) => return room(args, &scene).map(Some),
                // A desk has no robots.
                Err(error) if text.lines().any(|line| line.trim_start().starts_with("[[robot]]")) => {
                    return Err(error.of_file(only));
                }
                Err(_) => {}
            }
            reads(only);
            let mut desk: Desk = toml::from_str(&text).map_err(|error| format!("{}: {error}", only.display()))?;
            let folder = only.parent().unwrap_or(Path::new(""));
            let later = desk.retuned.iter_mut().chain(&mut desk.reloaded).flatten();
            for path in later.chain(&mut desk.near).chain(&mut desk.far).chain(&mut desk.trajectory) {
                *path = folder.join(&path);
            }
            desk.check(args);
            if let Some(address) = &desk.assist {
                return assist(args, &desk, address).map(|()| None);
            }
            if desk.near.is_some() { logs(args, &desk) } else { listen(args, &desk) }
        }
        [only] if !only.exists() => room(args, &simulate::load(only)?),
        [near, far @ ..] if far.len() < 2 => {
            let desk = Desk { near: Some(near.clone()), far: far.first().cloned(), ..Desk::default() };
            desk.check(args);
            logs(args, &desk)
        }
        _ => usage("--accept takes the logs of two robots at most: the first robot's, then the second's"),
    };
    found.map(Some)
}

/// The channel by the command line or the desk.
fn channel(args: &Args, desk: &Desk) -> Words<Channel> {
    let told = desk.channel.as_deref().map(str::parse).transpose().in_words()?;
    let Some(channel) = args.channel.or(told) else {
        usage(
            "which WiFi channel were the cards tuned to? Give it with --channel, or with `channel = \"108\"` in the desk's TOML",
        )
    };
    Ok(channel)
}

/// The plan by the desk and the command line.
fn plan(args: &Args, desk: &Desk) -> Words<Plan> {
    let mut plan = Plan::new(channel(args, desk)?);
    plan.at_rest = desk.at_rest;
    plan.truth = match (&desk.trajectory, desk.azimuth_deg) {
        (Some(path), Some(deg)) => {
            reads(path);
            Some(Truth { trajectory: read_trajectory(path, None)?, azimuth_rad: deg.to_radians() })
        }
        (None, None) => None,
        _ => usage("a desk has both `trajectory` and `azimuth_deg`, or neither"),
    };
    Ok(plan)
}

/// A log's records, with the times of its side file.
fn heard(path: &Path) -> Words<Heard> {
    Heard::of(&mut open_log(path)?).in_words()
}

/// The same of a log that no output may overwrite.
fn given(path: &Path) -> Words<Heard> {
    reads(path);
    heard(path)
}

/// The logs after retunes and reloads.
fn later(evidence: &mut Evidence, desk: &Desk) -> Words<()> {
    for (done, all) in [(Done::Retuned, &desk.retuned), (Done::Reloaded, &desk.reloaded)] {
        for logs in all {
            if let Some(near) = logs.first() {
                let (near, far) = (given(near)?, logs.get(1).map(|far| given(far)).transpose()?);
                evidence.after.push(After { done, near, far });
            }
        }
    }
    Ok(())
}

/// Ends the command if an option of this machine's card is given where no card is judged.
fn without_card(args: &Args) {
    if args.listen.is_some() || args.card.is_named() {
        usage("--listen, --connector-index and --stock are for this machine's card, not for logs or a scene");
    }
}

/// Recorded logs.
fn logs(args: &Args, desk: &Desk) -> Words<Judged> {
    without_card(args);
    let mut evidence = Evidence::new(plan(args, desk)?);
    if let Some(path) = &desk.near {
        evidence.near = given(path)?;
    }
    evidence.far = desk.far.as_deref().map(given).transpose()?;
    later(&mut evidence, desk)?;
    Ok(Judged::of(evidence, "backend: recorded logs".into()))
}

/// The first two robots of a simulated room, in virtual time.
fn room(args: &Args, scene: &Scene) -> Words<Judged> {
    without_card(args);
    if args.channel.is_some() {
        usage("a scene has its own channel: leave out --channel");
    }
    let mut room = Room::new(scene).in_words()?;
    let mut plan = Plan::new(csi5300_lab::compare::channel_of(scene).in_words()?);
    let still = |robot: &csi5300_sim::scene::Robot| robot.motion == RobotMotion::default();
    plan.at_rest = scene.robot.iter().all(still);
    if let (Some(trajectory), Some(to)) = (room.true_path(0, 100.0), room.antenna(1, 0.0))
        && scene.robot.get(1).is_some_and(still)
    {
        let poses = trajectory.poses();
        let mean = poses.iter().map(|pose| pose.position_m).sum::<nalgebra::Vector3<f64>>() / poses.len().max(1) as f64;
        let towards = to - mean;
        plan.truth = Some(Truth { azimuth_rad: towards.y.atan2(towards.x), trajectory });
    }
    let Some(mut near) = room.card(0) else { return Err("the scene has no robot".into()) };
    let mut far = room.card(1);
    let far = far.as_mut().map(|far| far as &mut dyn CsiSource);
    let evidence = collect(&mut near, far, None, plan).in_words()?;
    Ok(Judged::of(evidence, format!("backend: simulated room, scene {:?}, seed {}", scene.name, scene.seed)))
}

/// The report's files, the logs beside it, and the state from which an interrupted run continues.
fn write(report: &Report, evidence: &Evidence, stopped: Option<&Stopped>, folder: &Path) -> Words<()> {
    let draft = FolderDraft::new(folder)?;
    let date = evidence
        .near
        .records
        .iter()
        .find_map(|record| record.host_us)
        .map_or_else(|| "no date".into(), |us| stamp(us.div_euclid(1_000_000)));
    let json = report.json().in_words()?;
    let goes_on = stopped.map(serde_json::to_vec).transpose().in_words()?.unwrap_or_default();
    let mut files = vec![
        ("report.json".to_owned(), json.into_bytes()),
        ("report.xml".into(), report.junit().into_bytes()),
        ("report.html".into(), report.html(svg).into_bytes()),
        ("bench-log.md".into(), report.entry(&date).into_bytes()),
        (FILE.into(), goes_on),
    ];
    let logs = [("near.dat".to_owned(), &evidence.near)].into_iter();
    let logs = logs.chain(evidence.far.as_ref().map(|far| ("far.dat".into(), far)));
    for (name, heard) in logs.chain(evidence.unplugged.iter().map(|(antenna, heard)| (unplugged(*antenna), heard))) {
        files.extend([(format!("{name}stp"), times(heard)), (name, heard.log.clone())]);
    }
    // A continued run needs every log, even an empty one.
    files.retain(|(name, bytes)| !bytes.is_empty() || (stopped.is_some() && name.ends_with(".dat")));
    for (name, bytes) in &files {
        std::fs::write(draft.path().join(name), bytes)
            .map_err(|error| draft.words(&format!("cannot write {name}: {error}")))?;
    }
    draft.keep()?;
    let is_new = |log: &PathBuf| files.iter().any(|(name, _)| log.ends_with(name));
    logs_in(folder).filter(|log| !is_new(log)).for_each(|log| note!("{} is of an earlier run", log.display()));
    if stopped.is_some() {
        return Ok(());
    }
    match std::fs::remove_file(folder.join(FILE)) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(format!("cannot remove {FILE}: {error}")),
        _ => Ok(()),
    }
}

/// A log's side file; empty if no time is known.
fn times(heard: &Heard) -> Vec<u8> {
    let entry = |us: &Option<i64>| {
        let mut entry = [0; Layout::Narrow.bytes()];
        // What fits no entry stays unknown.
        let _ = Entry::from(*us).emit(Layout::Narrow, &mut entry);
        entry
    };
    let known = heard.times.iter().any(Option::is_some);
    if known { heard.times.iter().flat_map(entry).collect() } else { Vec::new() }
}

/// The logs in a report's folder.
fn logs_in(folder: &Path) -> impl Iterator<Item = PathBuf> {
    let names = ["near.dat", "far.dat"].map(str::to_owned).into_iter().chain(Antenna::ALL.map(unplugged));
    names.map(|name| folder.join(name)).filter(|log| log.exists())
}

/// A curve of the report.
fn svg(curve: &Curve) -> String {
    let series = curve.series.iter().enumerate();
    let series = series.map(|(colour, (name, points))| Series {
        name: (*name).into(),
        points: points.clone(),
        look: Look::Dots,
        colour,
    });
    let (x_label, y_label) = (curve.x.into(), curve.y.into());
    let chart = Chart { x_label, y_label, series: series.collect(), ..Chart::default() };
    // Without points there is nothing to draw.
    chart.svg().unwrap_or_default()
}

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
fn address(desk: &Desk) -> Words<Option<Address>> {
    let parse = |text: &String| text.parse().map_err(|error| format!("room = {text:?}: {error}"));
    desk.room.as_ref().map(parse).transpose()
}

/// The card's records.
fn open(args: &Args, desk: &Desk) -> Words<Listener> {
    let listening = Listening { card: args.card.clone(), allow_user_sender: false, room: address(desk)? };
    listening.open(Needs::default())
}

/// The interface that sends, set to an HT rate if possible, and its MAC.
fn air(desk: &Desk, options: &Options) -> Words<(Monitor, Mac)> {
    if let Some(interface) = &desk.interface {
        sound::see_to_rate(interface, PHY, Antenna::A)?;
    }
    let monitor = sound::monitor(address(desk)?.as_ref(), options)?.in_words()?;
    let mac = monitor.mac.ok_or_else(|| format!("{} has no MAC", options.interface))?;
    Ok((monitor, mac))
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
enum Step {
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
struct Run {
    clock: Monotonic,
    listener: Listener,
    monitor: Option<Monitor>,
    signals: Signals,
    evidence: Evidence,
}

/// Judges what the card gives.
fn listen(args: &Args, desk: &Desk) -> Words<Judged> {
    let system = Machine;
    let mut plan = plan(args, desk)?;
    let (steps, left_out) = Step::plan(args, desk)?;
    let signals = Signals::catch().in_words()?;
    let air = desk.send.then(|| sender(desk)).transpose()?;
    let mac = air.as_ref().map(|air| air.1);
    let asked = Step::asked(&steps, desk, plan.channel);
    let folder = args.report.as_deref();
    let before = folder.and_then(|folder| Some((folder, Stopped::read(folder, &asked, &steps)?)));
    let peer = desk.peer.as_deref().filter(|_| before.is_none());
    let helper = peer.map(|peer| Helper::call(peer, plan.channel, mac)).transpose()?;
    plan.macs = mac.zip(helper.as_ref().and_then(|helper| helper.mac)).map(|(near, far)| [near, far]);
    let monitor = air.map(|(monitor, _)| monitor);
    let listener = open(args, desk)?;
    note!("{}", listener.describe());
    left_out.iter().for_each(|why| note!("{why}"));
    let channel = plan.channel;
    let mut evidence = Evidence::new(plan);
    let mut finished = 0;
    let mut counters = module_counters(&system);
    if let Some((folder, stopped)) = &before {
        stopped.take_up(folder, &steps, &mut evidence)?;
        for (name, count) in &mut counters {
            *count = count.wrapping_sub(stopped.counters.get(name).copied().unwrap_or(0));
        }
        finished = stopped.finished;
        let words: Vec<String> = steps.iter().take(finished).map(Step::words).collect();
        note!("continuing the interrupted run: {} taken from {}", words.join(", then "), folder.display());
    }
    note!("{}", Step::told(steps.get(finished..).unwrap_or_default()));
    let mut run = Run { clock: Monotonic::new(), listener, monitor, signals, evidence };
    for step in steps.iter().skip(finished) {
        if run.step(step, mac)? {
            break;
        }
        finished += 1;
    }
    let Run { mut evidence, signals, monitor, .. } = run;
    signals.take();
    evidence.counters = module_growth(&system, &counters);
    if let Some(mut monitor) = monitor {
        let counters = monitor.counters();
        let (confirmed, retried) = (Some(counters.tx_status), counters.tx_retried);
        // Of the channel that frames are named by, the lower or upper half of 40 MHz.
        let half = Channel::new(channel.number(), Width::Ht20).in_words()?;
        let mhz = (half.centre_hz() / 1e6).round() as u32;
        let channel_flags = desk.interface.as_deref().and_then(|name| channel_flags(&system, name, mhz));
        evidence.interface = Interface { confirmed, retried, channel_flags };
    }
    if let Some(log) = helper.map(Helper::end).transpose()? {
        evidence.far = Some(Heard::of_log(&log));
    }
    if evidence.near.records.is_empty() {
        note!("no record came: is another robot sounding on this channel? `csi5300 doctor` examines this one");
    }
    later(&mut evidence, desk)?;
    let (mut facts, mut stopped) = (facts(&system, desk), None);
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

/// The interface that the first robot sends through.
fn sender(desk: &Desk) -> Words<(Monitor, Mac)> {
    let options = Options::new(desk.interface.clone().unwrap_or_default(), Sending::frame_len());
    air(desk, &Options { mcs: PHY.mcs, bandwidth: PHY.bandwidth, ..options })
}

impl Run {
    /// True if a signal or the end of the records ends the run.
    fn step(&mut self, step: &Step, mac: Option<Mac>) -> Words<bool> {
        match step {
            Step::Listen(span) => self.until(self.clock.now() + *span, None),
            Step::Unplug(antenna) => {
                note!("unplug antenna {antenna:?} of this robot, and plug in all others; then press Enter");
                if self.wait_for_enter()? {
                    return Ok(true);
                }
                self.evidence.unplugged.push((*antenna, Heard::default()));
                self.until(self.clock.now() + Span::from_s(UNPLUGGED_S), None)
            }
            Step::Send => {
                let Some(mac) = mac else { return Ok(false) };
                let now = self.clock.now();
                self.until(now + Sending::takes() + Span::from_s(TAIL_S), Some(Sending::new(mac, now)))
            }
        }
    }

    /// Receives until `end` and sends what is due. True if a signal or the end of the records ends the run.
    fn until(&mut self, end: Instant, mut sending: Option<Sending>) -> Words<bool> {
        while self.clock.now() < end {
            let mut due = None;
            if let Some(monitor) = &mut self.monitor {
                if let Some(sending) = &mut sending {
                    self.evidence.sent.extend(std::iter::from_fn(|| sending.send(self.clock.now(), monitor)));
                    due = sending.next_at();
                }
                // What the driver reports of own frames is counted on the way.
                while monitor.hear().in_words()?.is_some() {}
            }
            let next = self.listener.receive(self.clock.now()).in_words()?;
            let (pending, over) = (matches!(next, Next::Pending), matches!(next, Next::End(_)));
            self.evidence.heard(Side::Near, &next);
            if over || (pending && self.wait(end, due)?) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Waits for the listener or the next wake, and notes how late it was. True if a signal ends it.
    fn wait(&mut self, end: Instant, due: Option<Instant>) -> Words<bool> {
        let wake = (self.clock.now() + Span::from_us(WAKE_US)).min(end);
        let until = [self.listener.next_at(), due].into_iter().flatten().fold(wake, Instant::min);
        let fds = [self.listener.as_fd(), self.signals.as_fd()];
        let ready = self.clock.wait(fds, Some(until)).in_words()?;
        if !ready.contains(&true) {
            self.evidence.lateness_us.push((self.clock.now() - until).as_us() as f64);
        }
        Ok(ready[1])
    }

    /// Waits for Enter and skips records meanwhile. True if a signal or the end of the input comes first.
    fn wait_for_enter(&mut self) -> Words<bool> {
        let stdin = std::io::stdin();
        loop {
            let until = self.clock.now() + Span::from_ms(50);
            let fds = [stdin.as_fd(), self.signals.as_fd()];
            match self.clock.wait(fds, Some(until)).in_words()? {
                [_, true] => return Ok(true),
                [true, _] => {
                    let read = stdin.lock().read_line(&mut String::new()).in_words()?;
                    return Ok(read == 0);
                }
                _ => {}
            }
            loop {
                match self.listener.receive(self.clock.now()).in_words()? {
                    Next::Pending => break,
                    Next::End(_) => return Ok(true),
                    Next::Record(..) | Next::Lost(_) => {}
                }
            }
        }
    }
}

/// The greeting.
const GREETING: &str = "csi5300-accept 1";
/// Modulation of frames and answers.
const PHY: Phy = Phy { mcs: 0, bandwidth: Bandwidth::Ht20 };
/// A partner that is silent for this long is given up.
const PATIENCE: Duration = Duration::from_secs(30);
/// Bytes of a line, and of a log, at most.
const LINE: u64 = 256;
const LOG: u64 = 256 << 20;

fn line(from: &mut impl BufRead) -> Words<String> {
    let mut text = String::new();
    let read =
        from.take(LINE).read_line(&mut text).map_err(|error| format!("the other robot does not answer: {error}"))?;
    if read == 0 {
        return Err("the other robot ended the connection".into());
    }
    Ok(text.trim_end().to_owned())
}

fn name(mac: Option<Mac>) -> String {
    mac.map_or_else(|| "-".into(), |mac| mac.to_string())
}

/// The second robot, as the first one has it.
struct Helper {
    stream: BufReader<TcpStream>,
    /// Its MAC, if it answers.
    mac: Option<Mac>,
}

impl Helper {
    /// Calls it; `mac` is of the robot that calls, if that sends.
    fn call(peer: &str, channel: Channel, mac: Option<Mac>) -> Words<Self> {
        let failed = |error: std::io::Error| {
            format!(
                "cannot reach the second robot at {peer}: {error}. Does `csi5300 doctor --accept` run there, with `assist` in its TOML?"
            )
        };
        let mut stream = TcpStream::connect(peer).map_err(failed)?;
        stream.set_read_timeout(Some(PATIENCE)).map_err(failed)?;
        writeln!(stream, "{GREETING} {channel} {}", name(mac)).map_err(failed)?;
        let mut stream = BufReader::new(stream);
        let said = line(&mut stream)?;
        match said.split_once(' ') {
            Some(("ok", mac)) => Ok(Self { stream, mac: mac.parse().ok() }),
            Some(("no", why)) => Err(format!("the second robot refuses: {why}")),
            _ => Err(format!("a program other than `csi5300 doctor --accept` answers at {peer}")),
        }
    }

    /// Ends its recording; its log.
    fn end(mut self) -> Words<Vec<u8>> {
        let failed = |error: std::io::Error| format!("the second robot's log did not come: {error}");
        writeln!(self.stream.get_mut(), "end").map_err(failed)?;
        let said = line(&mut self.stream)?;
        let len = said.strip_prefix("log ").and_then(|len| len.parse().ok()).filter(|len| *len <= LOG);
        let len: u64 = len.ok_or_else(|| format!("the second robot has no log: {said}"))?;
        let mut log = Vec::new();
        self.stream.take(len).read_to_end(&mut log).map_err(failed)?;
        if (log.len() as u64) < len {
            return Err(format!("{} of {len} bytes of the second robot's log came", log.len()));
        }
        note!("{len} bytes of log came from the second robot");
        Ok(log)
    }
}

/// Refuses a name that no interface has.
fn must_be_there(interface: &str) -> Words<()> {
    let is_there = std::path::Path::new("/sys/class/net").join(interface).exists();
    if is_there { Ok(()) } else { Err(format!("there is no interface {interface}: `ip link` lists them")) }
}

/// Waits for the first robot and assists it.
fn assist(args: &Args, desk: &Desk, address: &str) -> Words<()> {
    desk.interface.as_deref().map_or(Ok(()), must_be_there)?;
    let signals = Signals::catch().in_words()?;
    let failed = |error: std::io::Error| format!("cannot wait at {address}: {error}");
    let waiting = TcpListener::bind(address).map_err(failed)?;
    note!("waiting at {} for the first robot; Ctrl-C ends it", waiting.local_addr().map_err(failed)?);
    let clock = Monotonic::new();
    let ready = clock.wait([waiting.as_fd(), signals.as_fd()], None).in_words()?;
    if ready[1] {
        return Ok(());
    }
    let (stream, _) = waiting.accept().map_err(failed)?;
    stream.set_read_timeout(Some(PATIENCE)).map_err(failed)?;
    stream.set_write_timeout(Some(PATIENCE)).map_err(failed)?;
    let mut stream = BufReader::new(stream);
    let made = agree(args, desk, &line(&mut stream)?);
    let (mut listener, running, own, told) = match made {
        Ok(made) => made,
        Err(why) => {
            let _ = writeln!(stream.get_mut(), "no {why}");
            return Err(why);
        }
    };
    writeln!(stream.get_mut(), "ok {}", name(own)).map_err(failed)?;
    note!("the first robot came, on channel {told}: recording until it ends");
    let mut evidence = Evidence::new(Plan::new(told));
    loop {
        let next = listener.receive(clock.now()).in_words()?;
        let (pending, over) = (matches!(next, Next::Pending), matches!(next, Next::End(_)));
        evidence.heard(Side::Near, &next);
        if over {
            break;
        }
        while running.as_ref().and_then(Running::news).is_some() {}
        if pending {
            let latest = clock.now() + Span::from_ms(200);
            let until = listener.next_at().map_or(latest, |at| at.min(latest));
            let fds = [listener.as_fd(), stream.get_ref().as_fd(), signals.as_fd()];
            let ready = clock.wait(fds, Some(until)).in_words()?;
            if ready[2] {
                return Err("ended before the first robot did".into());
            }
            if ready[1] {
                break;
            }
        }
    }
    let said = line(&mut stream)?;
    if said != "end" {
        return Err(format!("unexpected message from the first robot: {said}"));
    }
    if let Some(running) = running {
        running.stop().in_words()?;
    }
    let log = evidence.near.log;
    let stream = stream.get_mut();
    writeln!(stream, "log {}", log.len()).and_then(|()| stream.write_all(&log)).map_err(failed)?;
    note!("{} bytes of log went to the first robot, which judges", log.len());
    Ok(())
}

/// The first robot's request: the card, the answering MAC, and the channel.
type Agreed = (csi5300_live::listener::Listener, Option<Running>, Option<Mac>, Channel);

fn agree(args: &Args, desk: &Desk, said: &str) -> Words<Agreed> {
    let words: Vec<&str> = said.strip_prefix(GREETING).unwrap_or_default().split_whitespace().collect();
    let [told, mac] = words.as_slice() else { return Err(format!("no greeting of `csi5300 doctor --accept`: {said}")) };
    let own = channel(args, desk)?;
    if *told != own.to_string() {
        return Err(format!("the first robot is on channel {told}, the second on {own}"));
    }
    let listener = open(args, desk)?;
    if !desk.answer {
        return Ok((listener, None, None, own));
    }
    let first =
        mac.parse().map_err(|_| "`answer` needs a first robot that sends: `send = true` in its TOML".to_owned())?;
    let (running, mac) = answerer(desk, first)?;
    Ok((listener, Some(running), Some(mac), own))
}

/// Answers the first robot's frames on the interface, from user space.
fn answerer(desk: &Desk, first: Mac) -> Words<(Running, Mac)> {
    let dialect = Dialect::Wsr { first_len: wsr::DEFAULT_LEN as u16 };
    let setup = Setup {
        interface: desk.interface.clone().unwrap_or_default(),
        mac: None,
        peers: vec![first],
        // It answers each frame when it comes, and sends none of its own: the plan only has to fit.
        request: Request { phy: PHY, dialect, turn_around_us: 6_000, ..Request::new(1, 100.0) },
        own_index: 0,
        key: None,
    };
    let (monitor, mac) = air(desk, &setup.options())?;
    let clock = Monotonic::new();
    let opened =
        setup.open_on(monitor, |config| (config.epoch, config.start) = (Epoch::Heard(clock.now()), clock.now()));
    let running = Running::start(opened.in_words()?, clock, Settings::default()).in_words()?;
    Ok((running, mac))
}

/// Its file, beside the logs.
const FILE: &str = "stopped.json";

/// What the finished parts of a run leave besides their logs.
#[derive(Debug, serde::Deserialize, serde::Serialize)]
struct Stopped {
    /// The run's channel and parts: only the same run may continue it.
    asked: String,
    /// Parts that are finished, from the first on.
    finished: usize,
    /// How late the host woke meanwhile, microseconds.
    lateness_us: Vec<f64>,
    /// By how much each counter of the kernel module grew.
    counters: BTreeMap<String, u64>,
}

/// The log of a run without an antenna.
fn unplugged(antenna: Antenna) -> String {
    format!("unplugged-{antenna:?}.dat")
}

impl Stopped {
    /// The state after this many parts; `None` if it cannot be continued. Everything before the first antenna is one part.
    fn after(finished: usize, steps: &[Step], asked: String, evidence: &Evidence) -> Option<Self> {
        let (lateness_us, counters) = (evidence.lateness_us.clone(), evidence.counters.clone());
        (finished >= first(steps)).then_some(Self { asked, finished, lateness_us, counters })
    }

    /// What a run with the same channel and parts left in a folder.
    fn read(folder: &Path, asked: &str, steps: &[Step]) -> Option<Self> {
        let stopped: Self = serde_json::from_slice(&std::fs::read(folder.join(FILE)).ok()?).ok()?;
        (stopped.asked == asked && (first(steps)..=steps.len()).contains(&stopped.finished)).then_some(stopped)
    }

    /// Hands over what was measured.
    fn take_up(&self, folder: &Path, steps: &[Step], evidence: &mut Evidence) -> Words<()> {
        let log =
            |name: &str| heard(&folder.join(name)).map_err(|error| format!("{error}; without {FILE} the run restarts"));
        evidence.near = log("near.dat")?;
        if folder.join("far.dat").exists() {
            evidence.far = Some(log("far.dat")?);
        }
        for step in steps.iter().take(self.finished) {
            if let Step::Unplug(antenna) = step {
                evidence.unplugged.push((*antenna, log(&unplugged(*antenna))?));
            }
        }
        evidence.lateness_us.clone_from(&self.lateness_us);
        Ok(())
    }
}

/// Parts before the first antenna is unplugged.
fn first(steps: &[Step]) -> usize {
    steps.iter().take_while(|step| !matches!(step, Step::Unplug(_))).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_same_run_goes_on_with_whole_parts() {
        let steps = [Step::Listen(Span::from_s(1.0)), Step::Unplug(Antenna::B), Step::Unplug(Antenna::C)];
        let mut evidence = Evidence::new(Plan::new("64".parse().unwrap()));
        evidence.lateness_us.push(70.0);
        evidence.counters.insert("bfee".into(), 5);
        assert!(Stopped::after(0, &steps, "64".into(), &evidence).is_none(), "nothing is whole");
        let folder = std::env::temp_dir().join(format!("csi5300-stopped-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let stopped = Stopped::after(2, &steps, "64".into(), &evidence).unwrap();
        std::fs::write(folder.join(FILE), serde_json::to_vec(&stopped).unwrap()).unwrap();
        assert!(Stopped::read(&folder, "108", &steps).is_none(), "another run");
        let read = Stopped::read(&folder, "64", &steps).unwrap();
        assert_eq!((read.finished, &read.counters), (2, &evidence.counters));
        let mut evidence = Evidence::new(Plan::new("64".parse().unwrap()));
        let why = read.take_up(&folder, &steps, &mut evidence).unwrap_err();
        assert!(why.contains("near.dat"), "{why}");
        for name in ["near.dat", "unplugged-B.dat"] {
            std::fs::write(folder.join(name), b"").unwrap();
        }
        read.take_up(&folder, &steps, &mut evidence).unwrap();
        assert_eq!((evidence.unplugged.len(), evidence.lateness_us), (1, vec![70.0]));
        std::fs::remove_dir_all(folder).unwrap();
    }
}
