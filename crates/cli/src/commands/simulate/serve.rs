//! `csi5300 simulate --serve`: a room in real time.

use crate::commands::live::Signals;
use crate::commands::{InWords, Outcome, Result, Words, is_same_file};
use csi5300::motion::odometry::{NextPose, OdometrySource, csv};
use csi5300::motion::pose::Pose;
use csi5300::source::{CsiSource, Loss, Next};
use csi5300::time::{Instant, Span};
use csi5300_live::netlink::Sender;
use csi5300_live::wait::{Monotonic, wall_us};
use csi5300_sim::motion::RobotMotion;
use csi5300_sim::served::{ServedCounts, Server};
use csi5300_sim::{Injected, Odometer, Port, Room, Scene};
use driver_iface::connector::CN_IDX;
use nix::sys::prctl::set_timerslack;
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::FileTypeExt;
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
    #[arg(long, value_parser = crate::commands::live::speed)]
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
    /// Where its records go, on the kernel's connector.
    sender: Option<Sender>,
    /// Its card, until that ends.
    card: Option<Port>,
    sent: u64,
    poses: Option<PosesFile>,
    odometry: Option<Odometer>,
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
        crate::commands::usage("--json and --poses - both want standard output");
    }
    let signals = Signals::catch().in_words()?;
    let speed = args.speed.unwrap_or(1.0);
    if args.socket.is_some() && speed != 1.0 {
        crate::commands::usage("other programs live in real time: --socket and --speed do not go together");
    }
    let mut robots = open(&scene, file, args)?;
    let server = args.socket.as_deref().map(Server::bind).transpose().in_words()?;
    for (robot, sender) in robots.iter().filter_map(|robot| Some((robot, robot.sender.as_ref()?))) {
        note!("serving {} on connector index {}", robot.name, sender.index());
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
    let mut room = room.in_words()?;
    robots.iter_mut().try_for_each(|robot| robot.join(&mut room))?;
    let mut serving = Serving { room, server, robots, clock, speed, behind: Span::default() };
    serving.work(&signals)?;
    if json {
        crate::commands::print_json(&serving.row());
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
            let ready = self.clock.wait(fds, Some(until.unwrap_or(Instant::ZERO))).in_words()?;
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
            next = server.turn(&mut self.room, *now, wall_us()).in_words()?;
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
            let own = self.robots.iter().find(|robot| robot.name == name && robot.sender.is_some());
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
        for robot in self.robots.iter().filter(|robot| robot.sender.is_some()) {
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
        for (unwritten, file) in self.robots.iter().filter_map(|robot| Some(robot.poses.as_ref()?.unwritten())) {
            if unwritten > 0 {
                note!("{} not written to {file}", crate::commands::some(unwritten, "pose", "poses"));
                all_written = false;
            }
        }
        Outcome::of(sent > 0, !all_written)
    }
}

/// The traffic over the socket, and what happened to each robot's frames.
fn describe(scene: &Scene, counts: &ServedCounts, injected: &[Injected]) -> String {
    let mut text = format!(
        "{} joined, {} refused; {} put on air, {} not; {} sent\n",
        crate::commands::some(counts.joined, "program", "programs"),
        counts.refused,
        crate::commands::some(counts.frames, "frame", "frames"),
        counts.bad_frames,
        crate::commands::some(counts.records, "record", "records")
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
fn open(scene: &Scene, file: &Path, args: &Args) -> Words<Vec<Served>> {
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
            let robots: Vec<&str> = scene.robot.iter().map(|robot| robot.name.as_str()).collect();
            return Err(format!("no robot {name} in the scene: it has {}", robots.join(", ")));
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
        let sender = index.map(|index| Sender::open(index, true)).transpose().in_words()?;
        let poses = args.poses.get(k).map(|path| PosesFile::open(path, &taken)).transpose()?;
        taken.extend(args.poses.get(k).map(|path| (path.clone(), "where the poses of another robot go")));
        Ok(Served { name, sender, card: None, sent: 0, poses, odometry: None })
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

impl Served {
    /// Takes the robot's card and odometry from the room, as far as they are served.
    fn join(&mut self, room: &mut Room) -> Words<()> {
        let number = room.number(&self.name).ok_or_else(|| format!("no robot {} in the scene", self.name))?;
        if self.sender.is_some() {
            self.card = Some(room.card(number).ok_or_else(|| format!("{} is served twice", self.name))?);
        }
        self.odometry = self.poses.as_ref().and_then(|_| room.odometry(number));
        Ok(())
    }

    /// Sends what is due by `now`. Returns when more is due; `None` at the end.
    fn pump(&mut self, now: Instant) -> Words<Option<Instant>> {
        let mut card_at = None;
        while let (Some(card), Some(sender)) = (&mut self.card, &mut self.sender) {
            match card.receive(now).in_words()? {
                Next::Record(_, record) => {
                    sender.send(record).in_words()?;
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
        let (Some(source), Some(out)) = (&mut self.odometry, &mut self.poses) else { return Ok(None) };
        loop {
            match source.receive(now).in_words()? {
                NextPose::Pose(pose) => out.write(&pose),
                NextPose::NewFrame => {}
                NextPose::Pending => return Ok(source.next_at()),
                NextPose::End => return Ok(None),
            }
        }
    }
}

/// A row of poses is shorter, bytes.
const ROW: u64 = 512;

/// Where a robot's poses go.
struct PosesFile {
    name: String,
    out: Box<dyn Write>,
    /// Poses that are not there, since the first that could not be written.
    unwritten: u64,
}

impl PosesFile {
    /// Opens a file to append to; `-` is standard output. `others` are of other use here: what the scene was read from, the
    /// room's socket, poses of other robots.
    pub fn open(path: &Path, others: &[(PathBuf, &str)]) -> Words<Self> {
        if path.as_os_str() == "-" {
            return Ok(Self::over("standard output".into(), Box::new(io::stdout())));
        }
        let name = path.display().to_string();
        if let Some((_, what)) = others.iter().find(|(other, _)| is_same_place(path, other)) {
            return Err(format!("{name} is {what}: --poses needs a file of its own"));
        }
        let failed = |error: io::Error| format!("cannot append poses to {name}: {error}");
        if !may_grow(path).map_err(failed)? {
            return Err(format!(
                "{name} exists and holds something other than whole rows of poses that a room wrote: --poses needs a file \
                 of its own"
            ));
        }
        let file: File = OpenOptions::new().create(true).append(true).open(path).map_err(failed)?;
        Ok(Self::over(name, Box::new(file)))
    }

    fn over(name: String, out: Box<dyn Write>) -> Self {
        Self { name, out, unwritten: 0 }
    }

    /// Appends a pose, in the columns of motion capture with a heading. After a failure, reported once, poses are only
    /// counted: a row after half a row would be read with it.
    pub fn write(&mut self, pose: &Pose) {
        if self.unwritten > 0 {
            self.unwritten += 1;
            return;
        }
        let done = self.out.write_all(csv::line(pose).as_bytes()).and_then(|()| self.out.flush());
        if let Err(error) = done {
            self.unwritten = 1;
            wrong!("cannot write poses to {}: {error}. The room continues without writing more of them", self.name);
        }
    }

    /// Poses that were not written, and where.
    fn unwritten(&self) -> (u64, &str) {
        (self.unwritten, &self.name)
    }
}

/// True if two paths are of one file, or will be: links are followed. Devices and pipes are anybody's.
fn is_same_place(path: &Path, other: &Path) -> bool {
    let place = |path: &Path| {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Some(folder.canonicalize().ok()?.join(path.file_name()?))
    };
    match std::fs::metadata(path) {
        Ok(there) if there.file_type().is_char_device() || there.file_type().is_fifo() => false,
        Ok(_) if is_same_file(other, path) => true,
        _ => place(path).is_some_and(|here| place(other) == Some(here)),
    }
}

/// True if a file is new or empty, no plain file at all, or begins and ends with rows of poses as a room writes them.
fn may_grow(path: &Path) -> io::Result<bool> {
    let len = match std::fs::metadata(path) {
        Ok(there) if there.is_file() => there.len(),
        _ => return Ok(true),
    };
    if len == 0 {
        return Ok(true);
    }
    let mut file = File::open(path)?;
    let (mut begins, mut ends) = (Vec::new(), Vec::new());
    (&file).take(ROW).read_to_end(&mut begins)?;
    file.seek(SeekFrom::Start(len.saturating_sub(ROW)))?;
    file.read_to_end(&mut ends)?;
    let first = begins.split_inclusive(|&byte| byte == b'\n').next();
    let last = ends.split_inclusive(|&byte| byte == b'\n').next_back();
    Ok([first, last].into_iter().flatten().all(is_row))
}

/// True for a row that a room would write in the same way.
fn is_row(row: &[u8]) -> bool {
    csv::parse_line(row).is_ok_and(|pose| pose.heading_rad.is_some() && csv::line(&pose).as_bytes() == row)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn pose(k: u32) -> Pose {
        let position_m = Vector3::new(0.1 * f64::from(k), -0.3, 1e-7);
        Pose { t_s: 1_700_000_000.123_456 + f64::from(k), position_m, heading_rad: Some(-0.5) }
    }

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("csi5300-poses-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn poses_are_appended_to_those_of_a_room_before() {
        let folder = folder("append");
        let path = folder.join("poses.csv");
        for run in 0..3 {
            let mut poses = PosesFile::open(&path, &[]).unwrap();
            (0..20).for_each(|k| poses.write(&pose(100 * run + k)));
            assert_eq!(poses.unwritten().0, 0);
        }
        assert_eq!(csv::read(&path, None).unwrap().1.rows, 60);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn files_of_another_kind_are_refused_and_stay_as_they_are() {
        let folder = folder("refuse");
        let row = csv::line(&pose(1));
        let others: [&[u8]; 6] = [
            b"duration_s = 3.0\n",
            b"10.0,0,1,2,3,\n",
            b"10.0,0,1,2,3,0.5,\n",
            &row.as_bytes()[..20],
            &[row.as_bytes(), b"and more"].concat(),
            &[&[0xff; 600], row.as_bytes()].concat(),
        ];
        for other in others {
            let path = folder.join("other");
            std::fs::write(&path, other).unwrap();
            let said = PosesFile::open(&path, &[]).err().unwrap();
            assert!(said.contains("holds something other than whole rows"), "{said}");
            assert_eq!(std::fs::read(&path).unwrap(), other);
        }
        assert!(PosesFile::open(&folder, &[]).is_err(), "a folder");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn what_the_room_reads_or_is_reached_by_is_refused_under_any_name() {
        let folder = folder("own");
        let [scene, link, socket] = ["scene.toml", "link", "room"].map(|name| folder.join(name));
        std::fs::write(&scene, csv::line(&pose(1))).unwrap();
        std::os::unix::fs::symlink(&scene, &link).unwrap();
        let others = [(scene.clone(), "the scene"), (socket, "the room's socket")];
        for (path, what) in
            [(&scene, "is the scene"), (&link, "is the scene"), (&folder.join("./room"), "the room's socket")]
        {
            let said = PosesFile::open(path, &others).err().unwrap();
            assert!(said.contains(what), "{said}");
        }
        assert!(!folder.join("room").exists());
        let null = Path::new("/dev/null");
        assert!(PosesFile::open(null, &[(null.into(), "the poses of another robot")]).is_ok());
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn what_a_full_disk_does_not_take_is_counted() {
        let mut poses = PosesFile::open(Path::new("/dev/full"), &[]).unwrap();
        (0..7).for_each(|k| poses.write(&pose(k)));
        assert_eq!(poses.unwritten(), (7, "/dev/full"));
    }
}
