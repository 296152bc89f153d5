//! `csi5300 simulate --serve`: a room in real time.

mod poses;

use self::poses::PosesFile;
use super::super::Words;
use super::super::live::Signals;
use super::super::{Outcome, Result};
use csi5300::motion::odometry::{NextPose, OdometrySource};
use csi5300::source::{CsiSource, Loss, Next};
use csi5300::time::{Instant, Span};
use csi5300_live::netlink::Sender;
use csi5300_live::wait::{Monotonic, wall_us};
use csi5300_sim::motion::RobotMotion;
use csi5300_sim::served::{ServedCounts, Server};
use csi5300_sim::{Injected, Odometer, Port, Room, Scene};
use driver_iface::connector::CN_IDX;
use nix::sys::prctl::set_timerslack;
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};

// Options of a served room.
#[derive(clap::Args)]
#[group(id = "serving")]
#[command(next_help_heading = "Serving a room in real time")]
pub struct Args {
    /// Run the room in real time and send a robot's records over the kernel's connector, as its driver would
    #[arg(long, conflicts_with_all = ["out", "force"])]
    pub serve: bool,
    /// Offer the robots' cards to other programs (`--room PATH#ROBOT`) on this socket. The robots then send only what
    /// these hand over, and answers of drivers with an `ack_len`
    #[arg(long, value_name = "PATH", requires = "serve")]
    socket: Option<PathBuf>,
    /// Robot to serve, with =INDEX on another connector index; may be repeated [default: the first initiator; with
    /// --socket none]
    #[arg(long, value_name = "NAME[=INDEX]", value_parser = served)]
    robot: Vec<(String, u32)>,
    /// Append the robot's odometry to this CSV file; - is standard output. One for each --robot, in the same order;
    /// with --socket alone, the first initiator's
    #[arg(long, value_name = "FILE")]
    poses: Vec<PathBuf>,
    /// Speed relative to real time [default: 1]; max does not wait
    #[arg(long, value_parser = super::super::live::speed)]
    speed: Option<f64>,
}

impl Args {
    /// True if an option of serving was given.
    pub fn asked(&self) -> bool {
        self.socket.is_some() || !self.robot.is_empty() || !self.poses.is_empty() || self.speed.is_some()
    }
}

fn served(text: &str) -> Words<(String, u32)> {
    match text.rsplit_once('=') {
        None => Ok((text.to_owned(), CN_IDX)),
        Some((name, index)) => {
            let index = index.parse().ok().filter(|index| (1..=32).contains(index));
            index.map(|index| (name.to_owned(), index)).ok_or_else(|| "a connector index is 1 to 32".into())
        }
    }
}

/// One robot whose card and odometry are served.
struct Served {
    name: String,
    on_connector: bool,
    /// The room's end.
    card: Option<(Port, Sender)>,
    sent: u64,
    poses: Option<(Odometer, PosesFile)>,
}

/// The line of JSON: what was served, and what was done to each robot.
#[derive(serde::Serialize)]
struct Row<'a> {
    robots: Vec<RobotRow<'a>>,
    /// The traffic over the socket, if there is one.
    #[serde(flatten)]
    socket: Option<SocketRow>,
    /// The greatest delay behind real time, milliseconds; `None` if the room does not wait for it.
    behind_ms: Option<f64>,
}

#[derive(serde::Serialize)]
struct RobotRow<'a> {
    robot: &'a str,
    /// Frames that it sent, that its card received, and that overlapped and were lost.
    sent: u64,
    received: u64,
    collided: u64,
    /// Records sent on the kernel's connector; `None` if it was not served there.
    on_connector: Option<u64>,
}

#[derive(serde::Serialize)]
struct SocketRow {
    joined: u64,
    refused: u64,
    frames: u64,
    bad_frames: u64,
    records: u64,
    untaken: u64,
}

/// Serves a scene, which was read from `file`, until its end or a signal.
pub fn run(mut scene: Scene, file: &Path, args: &Args, json: bool) -> Result {
    if json && args.poses.iter().any(|path| path.as_os_str() == "-") {
        super::super::usage("--json and --poses - both want standard output");
    }
    let signals = Signals::catch().map_err(|error| error.to_string())?;
    let speed = args.speed.unwrap_or(1.0);
    if args.socket.is_some() && speed != 1.0 {
        return Err("other programs live in real time: --socket and --speed do not go together".into());
    }
    let outputs = open(&scene, file, args)?;
    let server = args.socket.as_deref().map(Server::bind).transpose().map_err(|error| error.to_string())?;
    for (output, sender) in outputs.iter().filter_map(|output| Some((output, output.sender.as_ref()?))) {
        note!("serving {} on connector index {}", output.name, sender.index());
    }
    if let Some(path) = &args.socket {
        // Programs must answer within microseconds, so ask for the kernel's tightest timers; without them answers are
        // late.
        let _ = set_timerslack(1);
        note!("serving the room at {}", path.display());
    }
    // The scene begins when this clock starts.
    let clock = Monotonic::new();
    begin(&mut scene, wall_us());
    let room = if server.is_some() { Room::quiet(&scene) } else { Room::new(&scene) };
    let mut room = room.map_err(|error| error.to_string())?;
    let robots = outputs.into_iter().map(|output| output.of(&mut room)).collect::<Words<Vec<_>>>()?;
    let mut serving = Serving { room, server, robots, clock, speed, behind: Span::default() };
    serving.work(&signals)?;
    if json {
        super::super::print_json(&serving.row());
    }
    Ok(serving.conclude())
}

/// Sets a scene's start to the present.
fn begin(scene: &mut Scene, wall_us: Option<i64>) {
    let start_us = wall_us.unwrap_or(scene.start_unix_s.saturating_mul(1_000_000));
    scene.start_unix_s = start_us.div_euclid(1_000_000);
    for robot in &mut scene.robot {
        robot.host_clock.offset_s += start_us.rem_euclid(1_000_000) as f64 * 1e-6;
        // The real socket and the real listener bring their own queue and stalls.
        (robot.faults.queue_records, robot.faults.stall_every_s) = (usize::MAX, 0.0);
    }
}

/// A room being served.
struct Serving {
    room: Room,
    server: Option<Server>,
    robots: Vec<Served>,
    clock: Monotonic,
    speed: f64,
    /// The greatest lateness so far.
    behind: Span,
}

impl Serving {
    /// Until the scene's end or a signal.
    fn work(&mut self, signals: &Signals) -> Words<()> {
        let mut now = Instant::ZERO;
        while let Some(next) = self.turn(&mut now)? {
            // Without waiting, time still passes event by event.
            let until = self.speed.is_finite().then(|| Span::from_s(next.as_s() / self.speed));
            let until = until.map(|span| Instant::ZERO + span + Span::from_us(1));
            // Without a socket, this waits for the signals twice.
            let fds = [signals.as_fd(), self.server.as_ref().map_or(signals.as_fd(), AsFd::as_fd)];
            let ready =
                self.clock.wait(fds, Some(until.unwrap_or(Instant::ZERO))).map_err(|error| error.to_string())?;
            if ready[0] {
                break;
            }
            let woken = self.clock.now();
            let waited = match self.speed.is_finite() {
                true => Instant::ZERO + Span::from_s(woken.as_s() * self.speed),
                false => next,
            };
            self.behind = until.map_or(self.behind, |until| self.behind.max(woken - until));
            now = waited.max(now);
        }
        Ok(())
    }

    /// Does what is due. Returns when more is due; `None` at the end.
    fn turn(&mut self, now: &mut Instant) -> Words<Option<Instant>> {
        let mut next: Option<Instant> = None;
        if let Some(server) = &mut self.server {
            // Both clocks at one moment: the kernel stamps by one, the room runs by the other.
            *now = self.clock.now();
            next = server.turn(&mut self.room, *now, wall_us()).map_err(|error| error.to_string())?;
            server.notice().into_iter().for_each(|why| note!("a frame was not sent: {why}"));
        }
        for robot in &mut self.robots {
            next = [next, robot.pump(*now)?].into_iter().flatten().min();
        }
        Ok(next)
    }

    fn row(&self) -> Row<'_> {
        let injected = self.room.injected();
        let on_connector = |name: &str| {
            let own = self.robots.iter().find(|robot| robot.name == name && robot.on_connector);
            own.map(|robot| robot.sent)
        };
        let robots = self.room.scene().robot.iter().zip(&injected).map(|(robot, done)| RobotRow {
            robot: &robot.name,
            sent: done.sent,
            received: done.received,
            collided: done.collided,
            on_connector: on_connector(&robot.name),
        });
        let socket = self.server.as_ref().map(|server| {
            let ServedCounts { joined, refused, frames, bad_frames, records, untaken, .. } = server.counts();
            SocketRow { joined, refused, frames, bad_frames, records, untaken }
        });
        Row { robots: robots.collect(), socket, behind_ms: self.speed.is_finite().then(|| self.behind.as_s() * 1e3) }
    }

    fn conclude(&self) -> Outcome {
        let (mut sent, injected) = (0, self.room.injected());
        for robot in self.robots.iter().filter(|robot| robot.on_connector) {
            sent += robot.sent;
            let number = self.room.number(&robot.name).unwrap_or_default();
            let done = injected.get(number).map_or_else(|| "nothing".into(), ToString::to_string);
            note!("{}: {} records sent; in the room: {done}", robot.name, robot.sent);
        }
        if let Some(server) = &self.server {
            sent += server.counts().records;
            notes!("{}", describe(self.room.scene(), &server.counts(), &injected));
        }
        if self.speed.is_finite() {
            note!("at most {:.1} ms behind real time", self.behind.as_s() * 1e3);
        }
        let mut all_written = true;
        for (unwritten, file) in self.robots.iter().filter_map(|robot| Some(robot.poses.as_ref()?.1.unwritten())) {
            if unwritten > 0 {
                note!("{} not written to {file}", super::super::some(unwritten, "pose", "poses"));
                all_written = false;
            }
        }
        match (sent, all_written) {
            (0, _) => Outcome::Nothing,
            (_, true) => Outcome::Done,
            (_, false) => Outcome::DataLost,
        }
    }
}

/// The traffic over the socket, and what happened to each robot's frames.
fn describe(scene: &Scene, counts: &ServedCounts, injected: &[Injected]) -> String {
    let mut text = format!(
        "{} joined, {} refused; {} put on air, {} not; {} sent\n",
        super::super::some(counts.joined, "program", "programs"),
        counts.refused,
        super::super::some(counts.frames, "frame", "frames"),
        counts.bad_frames,
        super::super::some(counts.records, "record", "records")
    );
    if counts.untaken > 0 {
        text += &format!("  {} messages were lost because a program did not read them\n", counts.untaken);
    }
    for (robot, injected) in scene.robot.iter().zip(injected) {
        text += &format!("  {}: {injected}\n", robot.name);
    }
    text
}

/// Opens everything that may take time or fail, before the scene's time begins.
fn open(scene: &Scene, file: &Path, args: &Args) -> Words<Vec<Output>> {
    let first = scene.initiators().first().and_then(|&k| scene.robot.get(k)).map(|robot| robot.name.clone());
    let named = match args.robot.as_slice() {
        [] if args.socket.is_some() && args.poses.is_empty() => Vec::new(),
        [] => vec![(first.unwrap_or_default(), args.socket.is_none().then_some(CN_IDX))],
        named => named.iter().map(|(name, index)| (name.clone(), Some(*index))).collect(),
    };
    if args.poses.len() > named.len() {
        return Err(format!("{} files for poses and {} robots served", args.poses.len(), named.len()));
    }
    for (k, (name, index)) in named.iter().enumerate() {
        if !scene.robot.iter().any(|robot| robot.name == *name) {
            return Err(format!("no robot {name} in the scene"));
        }
        for (other, same) in &named[..k] {
            if other == name {
                return Err(format!("{name} is served twice"));
            }
            if let Some(index) = index.filter(|_| same == index) {
                let free = "give each its own, such as NAME=27";
                return Err(format!("{other} and {name} would both be served on connector index {index}: {free}"));
            }
        }
    }
    let mut taken = in_use(scene, file, args);
    let output = |(k, (name, index)): (usize, (String, Option<u32>))| {
        let sender = index.map(|index| Sender::open(index, true)).transpose().map_err(|error| error.to_string())?;
        let poses = args.poses.get(k).map(|path| PosesFile::open(path, &taken)).transpose()?;
        taken.extend(args.poses.get(k).map(|path| (path.clone(), "where the poses of another robot go")));
        Ok(Output { name, sender, poses })
    };
    named.into_iter().enumerate().map(output).collect()
}

/// Files that cannot hold poses, and what they are.
fn in_use(scene: &Scene, file: &Path, args: &Args) -> Vec<(PathBuf, &'static str)> {
    let socket = args.socket.iter().map(|socket| (socket.clone(), "the room's socket"));
    let recorded = scene.robot.iter().filter_map(|robot| match &robot.motion {
        RobotMotion::Recorded(motion) => Some((motion.file.clone(), "a trajectory that the scene reads")),
        _ => None,
    });
    std::iter::once((file.to_owned(), "the scene")).chain(socket).chain(recorded).collect()
}

/// Where a robot's records and poses go.
struct Output {
    name: String,
    sender: Option<Sender>,
    poses: Option<PosesFile>,
}

impl Output {
    /// Joins the outputs with the robot's card and odometry.
    fn of(self, room: &mut Room) -> Words<Served> {
        let Self { name, sender, poses } = self;
        let number = room.number(&name).ok_or_else(|| format!("no robot {name} in the scene"))?;
        let twice = || format!("{name} is served twice");
        let card = sender.map(|sender| room.card(number).map(|card| (card, sender)).ok_or_else(twice)).transpose()?;
        let poses = poses.and_then(|out| room.odometry(number).map(|source| (source, out)));
        Ok(Served { name, on_connector: card.is_some(), card, sent: 0, poses })
    }
}

impl Served {
    /// Sends what is due by `now`. Returns when more is due; `None` at the end.
    fn pump(&mut self, now: Instant) -> Words<Option<Instant>> {
        let words = |error: csi5300::source::Error| error.to_string();
        let mut card_at = None;
        while let Some((card, sender)) = &mut self.card {
            match card.receive(now).map_err(words)? {
                Next::Record(_, record) => {
                    sender.send(record).map_err(words)?;
                    self.sent += 1;
                }
                Next::Lost(Loss::Overrun { .. } | Loss::Bytes { .. } | Loss::Datagram { .. }) => {}
                Next::Pending => {
                    card_at = card.next_at();
                    break;
                }
                Next::End(_) => self.card = None,
            }
        }
        Ok([card_at, self.pump_poses(now)?].into_iter().flatten().min())
    }

    /// Writes the poses that are due.
    fn pump_poses(&mut self, now: Instant) -> Words<Option<Instant>> {
        let Some((source, out)) = &mut self.poses else { return Ok(None) };
        loop {
            match source.receive(now).map_err(|error| error.to_string())? {
                NextPose::Pose(pose) => out.write(&pose),
                NextPose::NewFrame => {}
                NextPose::Pending => return Ok(source.next_at()),
                NextPose::End => return Ok(None),
            }
        }
    }
}
