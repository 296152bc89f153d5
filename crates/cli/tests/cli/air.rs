//! A room in real time with real processes: `simulate --serve` on the kernel's connector, heard by `record`, is the room that the library
//! simulates; programs sound each other in it; and a stranger with a radio and without a key attacks them.

use crate::commands::{Folder, json};
use csi5300::internal::FrameReceiver;
use csi5300::motion::odometry::csv;
use csi5300::source::replay::Replay;
use csi5300::source::{CsiSource, Injector, Next};
use csi5300::time::Instant;
use csi5300_live::monitor::{Monitor, Options};
use csi5300_live::wait::{Monotonic, wall_us};
use csi5300_sim::served::{Address, Role, join};
use csi5300_sim::{Room, Scene};
use driver_iface::Mac;
use driver_iface::bfee::{Bfee, offset};
use driver_iface::sounding::Frame;
use driver_iface::sounding::native::{self, Repr};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::io::{BufRead, BufReader, Read};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicBool, AtomicU64};

const SCENE: &str = r#"
duration_s = 3.0
[sounding]
rate_hz = 100
[radio]
noise.snr_db = 20.0
host_latency_us = 300.0
[[robot]]
name = "rx"
motion.circle = { radius_m = 0.3, duration_s = 3.0 }
odometry = { rate_hz = 50.0, noise_m = 0.001 }
faults = { loss = 0.1, stall_every_s = 1.0, stall_s = 0.9, queue_records = 5 }
[[robot]]
name = "tx"
position_m = [4.0, 0.0, 0.0]
"#;

/// The bodies of a source's records, without the host's time, which is that of the run.
fn bodies(source: &mut dyn CsiSource) -> Vec<Vec<u8>> {
    let (mut bodies, mut now) = (Vec::new(), Instant::ZERO);
    loop {
        match source.receive(now).unwrap() {
            Next::Record(_, record) => {
                let mut body = record.body.to_vec();
                body[offset::TV_SEC..offset::TV_SEC + 8].fill(0);
                bodies.push(body);
            }
            Next::Pending => now = source.next_at().unwrap(),
            Next::End(_) => return bodies,
            Next::Lost(loss) => panic!("{loss:?}"),
        }
    }
}

/// The driver's time in the first record, microseconds since the Unix epoch.
fn first_host_us(log: &Path) -> i64 {
    let mut log = Replay::open(log).unwrap();
    let Next::Record(_, record) = log.receive(Instant::ZERO).unwrap() else { panic!("no record") };
    let wsr = Bfee::new_checked(record.body).unwrap().wsr().unwrap();
    i64::from(wsr.tv_sec) * 1_000_000 + i64::from(wsr.tv_usec)
}

/// Runs `record` on the connector while `serve` runs; gives what the server said, and its line of JSON.
fn serve(scene: &Path, logs: &[(&Path, &str)], more: &[&str]) -> (String, String) {
    let own = env!("CARGO_BIN_EXE_csi5300");
    let recorder = |(log, index): &(&Path, &str)| {
        let args = ["--allow-user-sender", "--connector-index", index];
        let mut program = Program::of(Command::new(own).arg("record").arg(log).args(args).stdout(Stdio::null()));
        program.until("listening");
        program
    };
    let recorders: Vec<_> = logs.iter().map(recorder).collect();
    let out = Command::new(own).arg("simulate").arg(scene).args(["--serve", "--json"]).args(more).output().unwrap();
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.success(), "{said}");
    for recorder in recorders {
        let (status, rest) = recorder.end_by(Signal::SIGINT);
        assert_eq!(status, Some(0), "{rest}");
    }
    (said, String::from_utf8(out.stdout).unwrap())
}

#[test]
fn a_served_room_is_heard_through_the_kernel() {
    let Some(folder) = Folder::inside(a_served_room_is_heard_through_the_kernel, "-Urn", "serve") else { return };
    let [rx, tx, poses] = ["rx.dat", "tx.dat", "poses.csv"].map(|name| folder.0.join(name));
    let scene = folder.write("scene.toml", SCENE.as_bytes());
    let options = ["--speed", "20", "--robot", "rx=26", "--robot", "tx=12", "--poses", poses.to_str().unwrap()];
    let (before_us, clock) = (wall_us().unwrap(), Monotonic::new());
    let (said, row) = serve(&scene, &[(&rx, "26"), (&tx, "12")], &options);
    assert!(crate::documented::are_documented(&row) > 5, "{row}");
    let row = json(&row);
    let (after_us, took_s) = (wall_us().unwrap(), clock.now().as_s());
    // Three seconds at twenty times real time, and the first frames are of the first milliseconds.
    assert!(took_s >= 3.0 / 20.0, "{took_s} s: not paced");
    let first_us = first_host_us(&rx);
    assert!((before_us..after_us).contains(&first_us), "{first_us} is not within {before_us} and {after_us}");
    assert!(said.contains("ms behind real time"), "{said}");

    // Stalls and queues of the scene are left to the real listener; losses on air are not.
    let mut expected = Scene::from_toml(SCENE).unwrap();
    let faults = &mut expected.robot[0].faults;
    (faults.stall_every_s, faults.queue_records) = (0.0, usize::MAX);
    let mut room = Room::new(&expected).unwrap();
    let cards = [room.card(0).unwrap(), room.card(1).unwrap()];
    for (robot, (mut card, log)) in cards.into_iter().zip([&rx, &tx]).enumerate() {
        let (heard, simulated) = (bodies(&mut Replay::open(log).unwrap()), bodies(&mut card));
        assert!(heard.len() > 250, "{} records", heard.len());
        assert!(heard == simulated, "robot {robot}: {} heard, {} simulated", heard.len(), simulated.len());
        assert!(said.contains(&format!("{} records sent", heard.len())), "{said}");
        assert_eq!(row["robots"][robot]["on_connector"], heard.len(), "{row}");
    }
    let (trajectory, counts) = csv::read(&poses, None).unwrap();
    assert_eq!((counts.rows, counts.bad_rows), (151, 0));
    let reach = trajectory.poses().iter().map(|pose| pose.position_m.norm()).fold(0.0, f64::max);
    assert!((reach - 0.6).abs() < 0.01, "{reach}");
}

/// Two robots, the one on circles for as long as the room lasts, which is longer than any test; radios as real ones but for their crystals, which nearly
/// agree: a busy machine answers milliseconds late, in which real ones would turn by tens of cycles (that they are
/// compensated is tested in virtual time). Drivers in the stock layout.
const LIVE: &str = r#"
duration_s = 12000.0
cfo = "physical"
driver = "stock"
[radio]
mcs = 1
noise.snr_db = 20.0
host_latency_us = 100.0
delay_ns = 200.0
sampling_offset = true
[[robot]]
name = "rx"
mac = "02:00:00:00:00:0a"
motion.circle = { radius_m = 0.3, duration_s = 12000.0, turns = 3000 }
crystal.offset_ppm = 0.0015
[[robot]]
name = "tx"
mac = "02:00:00:00:00:0b"
position_m = [-386.0, 93.0, 0.0]
crystal = { offset_ppm = -0.001, clock_start_us = 1000000 }
"#;

/// A node of robot `own`, whose peer's table goes on so; it only listens.
fn node(own: &str, peer: &str) -> String {
    let moves = if own == "rx" { "odometry.room = {}\n" } else { "" };
    format!(
        "channel = \"108\"\ncapture.served = {{ socket = \"room\", robot = \"{own}\" }}\n{moves}[[peer]]\n{peer}\n\
         [estimator]\naccurate = false\n[output]\nbearings = \"{own}.jsonl\"\nstatus_line = \"always\"\n"
    )
}

/// A peer whose records, and poses if it moves, are those of the room.
fn peer(name: &str) -> String {
    let poses = if name == "rx" { "poses.room = {}" } else { "" };
    format!("name = \"{name}\"\nrecords.room = {{}}\n{poses}")
}

/// What lets such a node sound. A busy machine is late by milliseconds: slots are long, and answers have time.
const SOUNDS: &str = "[sounding]\nrate_hz = 50.0\nturn_around_us = 6000\nguard_us = 1500\nfifo = false\n";

/// Standard deviation of a bearing that tests look at. That of a search on the coarse grid alone is 1.4.
const SURE_DEG: f64 = 1.5;

/// Off by less than two degrees, or than the error bar of a search on the coarse grid alone.
fn is_near(off_deg: f64, sure: &serde_json::Value) -> bool {
    off_deg.abs() < sure["azimuth_95_deg"].as_f64().unwrap().max(2.0)
}

/// The bearings that a node wrote. The last line may not be whole yet.
fn bearings(file: &Path) -> Vec<serde_json::Value> {
    let lines = std::fs::read_to_string(file).unwrap_or_default();
    let lines = lines.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    lines.filter(|line| line["state"] == "bearing").collect()
}

/// The error of a bearing to the robot that answers, from the middle of the circle.
fn off_deg(bearing: &serde_json::Value) -> f64 {
    let off = bearing["azimuth_deg"].as_f64().unwrap() - 93f64.atan2(-386.0).to_degrees();
    (off + 180.0).rem_euclid(360.0) - 180.0
}

/// A program whose words are waited for.
pub struct Program {
    pub child: Child,
    stderr: BufReader<ChildStderr>,
    pub said: String,
}

impl Program {
    pub fn start(args: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_csi5300"));
        Self::of(command.args(args).stdout(Stdio::null()))
    }

    /// One whose results are read by [`Self::output`].
    fn heard(args: &[&str]) -> Self {
        Self::of(Command::new(env!("CARGO_BIN_EXE_csi5300")).args(args).stdout(Stdio::piped()))
    }

    /// All that it prints.
    pub fn output(&mut self) -> String {
        let mut out = String::new();
        self.child.stdout.take().unwrap().read_to_string(&mut out).unwrap();
        out
    }

    pub fn of(command: &mut Command) -> Self {
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let stderr = BufReader::new(child.stderr.take().unwrap());
        Self { child, stderr, said: String::new() }
    }

    pub fn until(&mut self, word: &str) {
        while !self.said.contains(word) {
            let read = self.stderr.read_line(&mut self.said).unwrap();
            assert!(read > 0, "it ended before it said `{word}`:\n{}", self.said);
        }
    }

    /// For a node that writes its bearings there and prints its state: its last one, once it has made so many and knows the last
    /// well. A busy machine's first ones are of few exchanges, or have moved too little.
    fn sure_bearing(&mut self, file: &Path, least: usize) -> serde_json::Value {
        loop {
            let mut made = bearings(file);
            let is_sure = |last: &serde_json::Value| last["azimuth_sd_deg"].as_f64().is_some_and(|sd| sd < SURE_DEG);
            if made.len() >= least && made.last().is_some_and(is_sure) {
                return made.remove(made.len() - 1);
            }
            self.said.clear();
            self.until("records/s");
        }
    }

    pub fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.child.id() as i32), signal).unwrap();
    }

    pub fn stop(&self) {
        self.signal(Signal::SIGTERM);
    }

    /// Ends it so.
    pub fn end_by(self, signal: Signal) -> (Option<i32>, String) {
        self.signal(signal);
        self.end()
    }

    /// Its exit status and all that it said.
    pub fn end(mut self) -> (Option<i32>, String) {
        self.stderr.read_to_string(&mut self.said).unwrap();
        (self.child.wait().unwrap().code(), std::mem::take(&mut self.said))
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // One that has ended is none the worse for it.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A room that another program serves, in a folder with its socket and its nodes' configurations and bearings.
struct Served {
    folder: Folder,
    room: Program,
}

impl Served {
    fn new(name: &str, scene: &str) -> Self {
        crate::with_node();
        let folder = Folder::new(name);
        let (scene, socket) = (folder.write("scene.toml", scene.as_bytes()), folder.0.join("room"));
        let [scene, socket] = [&scene, &socket].map(|path| path.to_str().unwrap());
        let mut room = Program::start(&["simulate", scene, "--serve", "--socket", socket]);
        room.until("serving the room at");
        Self { folder, room }
    }

    /// A node of robot `own` with this configuration.
    fn node(&self, own: &str, text: &str) -> Program {
        let file = self.folder.write(&format!("{own}.toml"), text.as_bytes());
        Program::start(&["node", "--config", file.to_str().unwrap()])
    }

    /// The bearings of the robot on circles.
    fn file(&self) -> PathBuf {
        self.folder.0.join("rx.jsonl")
    }

    /// Ends the nodes and the room; gives what that said.
    fn end(self, nodes: [Program; 2]) -> String {
        nodes.iter().for_each(Program::stop);
        for (status, said) in nodes.map(Program::end) {
            assert!(matches!(status, Some(0 | 3)), "{status:?}: {said}");
        }
        self.room.stop();
        self.room.end().1
    }
}

/// Two nodes, of `rx` and of `tx`, with these configurations in one room, until the robot on circles has made so many bearings,
/// and one that is right to two degrees. Gives its last one, and what the room said.
fn two_nodes(name: &str, [rx, tx]: [String; 2], least: usize) -> (serde_json::Value, String) {
    let room = Served::new(name, LIVE);
    let (tx, mut rx) = (room.node("tx", &tx), room.node("rx", &rx));
    let file = room.file();
    let sure = rx.sure_bearing(&file, least);
    assert!(is_near(off_deg(&sure), &sure), "{sure}");
    let served = room.end([rx, tx]);
    (bearings(&file).pop().unwrap(), served)
}

/// The number before a word in what a program said.
fn number(said: &str, after: &str) -> u64 {
    let words = said.split(after).next().unwrap_or_default();
    words
        .rsplit(|c: char| !c.is_ascii_digit())
        .find(|word| !word.is_empty())
        .and_then(|word| word.parse().ok())
        .unwrap()
}

#[test]
fn nodes_sound_each_other_in_turns() {
    // Both have had turns once the robot that moves has a dozen bearings.
    let nodes = [("rx", "tx"), ("tx", "rx")].map(|(own, other)| node(own, &peer(other)) + SOUNDS);
    let (last, served) = two_nodes("turns", nodes, 12);
    let (own, other) = (&last["receiver_records"], &last["transmitter_records"]);
    // Two counts in each log: both robots initiated. And their numbers do not meet, or one robot's exchanges would pair
    // with the other's and be refused, half of all. A busy machine makes some answers late by more than the clocks allow.
    let counts = |side: &serde_json::Value, of: &str| side[of].as_u64().unwrap();
    for side in [own, other] {
        assert!(counts(side, "restarts") >= 1, "{last}\n{served}");
        assert!(counts(side, "mispaired") * 2 < counts(side, "paired"), "{last}");
    }
    assert!(counts(own, "paired") > 50 && last["pairs"].as_u64() > Some(10), "{last}");
}

/// What `sound --json` says and prints at its end, where answers were heard. How many were in time is the machine's business.
fn sounding_is_told(out: &str, said: &str) {
    for words in ["02:00:00:00:00:0b joined", "lateness: p50", "answers began after: p50", "145 to 322 us"] {
        assert!(said.contains(words), "no `{words}` in {said}");
    }
    let row = &json(out)["summary"];
    assert!(crate::documented::are_documented(&row.to_string()) > 10, "{out}");
    let (forward, answered) = (row["forward"].as_u64().unwrap(), row["answered"].as_u64().unwrap());
    assert!(forward >= answered && answered > 0 && row["peers"][0]["forward"].as_u64() == Some(forward), "{row}");
    assert!(row["lateness_us"]["p50"].is_u64() && row["records"].as_u64() >= Some(1), "{row}");
}

#[test]
fn programs_sound_each_other_in_a_served_room() {
    crate::with_node();
    let folder = Folder::new("live");
    folder.write("scene.toml", LIVE.as_bytes());
    folder.write("node.toml", node("rx", &peer("tx")).as_bytes());
    let names = ["scene.toml", "rx.dat", "tx.dat", "poses.csv", "room", "record.dat", "node.toml"];
    let paths = names.map(|name| folder.0.join(name));
    let [scene, rx, tx, poses, socket, record, node] = paths.each_ref().map(|path| path.to_str().unwrap());
    let of = |robot: &str| format!("{socket}#{robot}");
    let mut room = Program::start(&["simulate", scene, "--serve", "--socket", socket, "--poses", poses]);
    room.until("serving the room at");
    // A busy machine is late by milliseconds: slots are long, and answers have time.
    let slow = ["--rate", "50", "--turn-around", "6000", "--guard", "1500", "--no-fifo"];
    let tx_room = of("tx");
    let respond = ["sound", "--answer", "--json", "--room", &tx_room, "--peers", "02:00:00:00:00:0a", "--log", tx];
    let mut respond = Program::heard(&[&respond[..], &slow].concat());
    respond.until("sending under");
    let rx_room = of("rx");
    // A second listener on the same card.
    let mut recorder = Program::start(&["record", record, "--room", &rx_room]);
    recorder.until("recording to");
    let mut node = Program::start(&["node", "--config", node]);
    let sound = ["sound", "--json", "--room", &rx_room, "--peers", "02:00:00:00:00:0b", "--alone", "--log", rx];
    let mut sound = Program::heard(&[&sound[..], &slow[..]].concat());
    let found = node.sure_bearing(&folder.0.join("rx.jsonl"), 6);
    assert!(is_near(off_deg(&found), &found), "{found}");
    sound.stop();
    let out = sound.output();
    let (status, sounded) = sound.end();
    assert_eq!(status, Some(0), "{sounded}");
    sounding_is_told(&out, &sounded);
    [&recorder, &node].into_iter().for_each(Program::stop);
    let (_, recorded) = recorder.end();
    let (status, said) = node.end();
    assert!(matches!(status, Some(0 | 3)), "{status:?}: {said}");
    room.stop();
    let (status, served) = room.end();
    assert_eq!(status, Some(0), "{served}");
    // A room that ends is a normal end.
    let out = respond.output();
    let (status, responded) = respond.end();
    assert!(status == Some(0) && responded.contains("the room has ended"), "{status:?} {responded}");
    assert!(
        responded.contains("receive stamp: p50") && crate::documented::are_documented(&out) > 10,
        "{out}{responded}"
    );
    let row = json(&out);
    assert!(row["answers"].as_u64() >= Some(number(&sounded, " answered")) && row["forward"] == 0, "{row}");
    assert!(row["turn_around_us"]["max"].is_u64() && row["error"].is_null(), "{row}");
    let (answered, sent) = (number(&sounded, " answered"), number(&sounded, " forward frames"));
    assert!(answered > 0, "{answered} of {sent}:\n{sounded}\n{responded}\n{served}");
    assert!(served.contains("8 programs joined, 0 refused"), "{served}");
    // What each side says went out, the room put on air; nothing of it was lost.
    let on_air = number(&served, " frames put on air");
    assert_eq!(on_air, sent + number(&responded, " answers"), "{sounded}\n{responded}\n{served}");
    assert!(served.contains(" 0 not;"), "{served}");

    // `bearing` finds the robot in both logs.
    let args = ["bearing", "--channel", "108", "--rx", rx, "--tx", tx, "--trajectory", poses, "--json"];
    let found = json(folder.says(&args, 0, &[]).0.lines().next().unwrap());
    assert!(off_deg(&found).abs() < 2.0, "{found}");
    // The other listener heard the same card, but for what it was too late for.
    let heard = number(&recorded, " records written");
    let lost = if served.contains(" messages were lost") { number(&served, " messages were lost") } else { 0 };
    assert!(heard + lost >= answered, "{heard} and {lost} of {answered}: {recorded}");
}

#[test]
fn sounding_without_a_trajectory_is_not_all_done_and_without_answers_it_is_if_none_are_wanted() {
    let Served { folder, room } = Served::new("live-loops", LIVE);
    let [rx, tx] = ["rx", "tx"].map(|robot| format!("{}#{robot}", folder.0.join("room").display()));
    let slow = ["--rate", "50", "--turn-around", "6000", "--guard", "1500", "--no-fifo"];
    let mut respond =
        Program::start(&[&["sound", "--answer", "--room", &tx, "--peers", "02:00:00:00:00:0a"], &slow[..]].concat());
    respond.until("sending under");
    let sound = ["sound", "--room", &rx, "--peers", "02:00:00:00:00:0b", "--alone", "--stop-after", "2s"];
    let bearings = ["--trajectory", "nowhere.csv", "--channel", "108"];
    let (status, _, said) = folder.run(&[&sound[..], &slow, &bearings].concat());
    assert!(status == 3 && !said.contains("nowhere.csv: cannot read the trajectory nowhere.csv"), "{status} {said}");
    assert!(said.contains("cannot read the trajectory nowhere.csv"), "{said}");
    folder.write("holes.csv", b"1,0,0,0,0\n2,0,1,0,0\n?,?,?,?,?\n?,?,?,?,?\n3,0,2,0,0\n");
    let bearings = ["--trajectory", "holes.csv", "--channel", "108"];
    let (status, _, said) = folder.run(&[&sound[..], &slow, &bearings].concat());
    assert!(status == 3 && said.contains("holes.csv: 2 rows skipped, the first in line 3"), "{status} {said}");
    respond.end_by(Signal::SIGINT);
    // A robot that initiates too answers as one that only answers, if it listens to its card.
    for (more, is_measured) in [(&bearings[..], true), (&[], false)] {
        let other = ["sound", "--room", &tx, "--peers", "02:00:00:00:00:0a"];
        let mut other = Program::start(&[&other[..], &slow, more].concat());
        other.until("sending under");
        let (status, _, said) = folder.run(&[&sound[..], &slow, &bearings].concat());
        let has_none = said.contains("no answer carried a measurement");
        assert!(status == 3 && has_none != is_measured, "{status} {said}");
        other.end_by(Signal::SIGINT);
    }
    let (status, _, said) = folder.run(&[&sound[..], &slow, &["--dialect", "wsr", "--open-loop"]].concat());
    assert!(status == 0 && said.contains(", 0 answered\n"), "{status} {said}");
    assert!(!said.contains("does not answer") && !said.contains("waiting for"), "{said}");
    room.end_by(Signal::SIGINT);
}

#[test]
fn two_robots_on_one_connector_index_are_refused() {
    let folder = Folder::new("serve-index");
    folder.write("scene.toml", SCENE.as_bytes());
    let args = ["simulate", "scene.toml", "--serve", "--robot", "rx=9", "--robot", "tx=9"];
    folder.says(&args, 1, &["rx and tx would both be served on connector index 9"]);
}

#[test]
fn a_room_takes_no_file_for_its_socket_and_writes_no_poses_into_others() {
    let folder = Folder::new("serve-files");
    let (scene, log) = (folder.write("scene.toml", LIVE.as_bytes()), folder.write("precious.dat", b"precious"));
    for (options, words) in [
        (&["--socket", "precious.dat"][..], "precious.dat is there and is no socket"),
        (&["--socket", "room", "--poses", "scene.toml"], "scene.toml is an input: name another output"),
        (&["--socket", "room", "--poses", "precious.dat"], "precious.dat exists and holds something other"),
        (&["--socket", "room", "--poses", "room"], "is the room's socket"),
    ] {
        folder.says(&[&["simulate", "scene.toml", "--serve"], options].concat(), 1, &[words]);
    }
    assert_eq!(std::fs::read_to_string(scene).unwrap(), LIVE);
    assert_eq!(std::fs::read_to_string(log).unwrap(), "precious");
}

#[test]
fn poses_that_cannot_be_written_stop_no_room() {
    use nix::sys::socket::{MsgFlags, recv};
    let folder = Folder::new("serve-full");
    let (scene, socket) = (folder.write("scene.toml", LIVE.as_bytes()), folder.0.join("room"));
    let [scene, room] = [&scene, &socket].map(|path| path.to_str().unwrap());
    let mut program = Program::start(&["simulate", scene, "--serve", "--socket", room, "--poses", "/dev/full"]);
    program.until("cannot write poses to /dev/full");
    // The room is there for the others: what one robot sends, the other's card records.
    let of = |robot: &str| Address { socket: socket.clone(), robot: robot.into() };
    let (air, mac) = join(&of("tx"), Role::Air).unwrap();
    let mut air = Monitor::over(air, mac, &Options { wall_us: || None, ..Options::new("room", 200) }).unwrap();
    let (card, _) = join(&of("rx"), Role::Card).unwrap();
    let mut frame = vec![0x08, 0, 0xff, 0xff];
    frame.extend([0x00, 0x16, 0xea, 0x12, 0x34, 0x56].repeat(2));
    frame.extend(mac.0);
    frame.resize(53, 0x55);
    air.inject(Instant::ZERO, &frame).unwrap();
    // In the stock layout a record comes after a copy of its frame.
    for _ in 0..2 {
        let mut record = [0; 4096];
        assert!(recv(std::os::fd::AsRawFd::as_raw_fd(&card), &mut record, MsgFlags::empty()).unwrap() > 0);
    }
    program.stop();
    let (status, said) = program.end();
    assert!(status == Some(3) && said.contains("not written to /dev/full"), "{status:?}: {said}");
    assert!(said.contains("rx: 1 received, 1 records delivered"), "{said}");
    assert_eq!(said.matches("cannot write poses").count(), 1, "{said}");
}

#[test]
fn records_of_a_peer_come_with_its_answers() {
    // The one that answers listens to the room; the one that asks hears of the other's card through its answers only.
    let asks = "name = \"tx\"\nmac = \"02:00:00:00:00:0b\"\nrecords.sounding = {}";
    let nodes =
        [node("rx", asks) + SOUNDS + "initiate = true\n", node("tx", &peer("rx")) + SOUNDS + "initiate = false\n"];
    let (last, _) = two_nodes("answers", nodes, 6);
    assert!(last["transmitter_records"]["paired"].as_u64() >= Some(50), "{last}");
}

/// Another radio in the room, nearer to the robot on circles than its peer is, and in another direction.
const STRANGER: &str =
    "\n[[robot]]\nname = \"stranger\"\nmac = \"02:66:00:00:00:01\"\nposition_m = [3.0, -120.0, 0.0]\n";

/// A room with a stranger, and with nodes that have a key.
fn attacked(name: &str, driver: &str) -> Served {
    let scene = LIVE.replace("driver = \"stock\"", &format!("driver = \"{driver}\"")) + STRANGER;
    let room = Served::new(&format!("attack-{name}"), &scene);
    let key = room.folder.write("key", b"3f7c1e9a5b2d8046c1e0f4a7936bd258\n");
    std::fs::set_permissions(&key, std::fs::Permissions::from_mode(0o600)).unwrap();
    room
}

impl Served {
    /// A node of robot `own` with one peer, with the key.
    fn keyed(&self, own: &str, other: &str, initiate: bool) -> Program {
        self.node(own, &format!("{}{SOUNDS}initiate = {initiate}\nkey = \"key\"\n", node(own, &peer(other))))
    }

    /// The stranger's radio.
    fn stranger(&self) -> Monitor {
        let address = Address { socket: self.folder.0.join("room"), robot: "stranger".into() };
        let (air, mac) = join(&address, Role::Air).unwrap();
        Monitor::over(air, mac, &Options { mcs: 1, ..Options::new("stranger", native::MAX_LEN) }).unwrap()
    }
}

/// A frame of a robot that is not there.
fn made_up(n: u32) -> Vec<u8> {
    let [_, a, b, c] = n.to_be_bytes();
    let sender = Mac([2, 0x66, 0, a, b, c]);
    let repr = Repr {
        sender,
        number: n,
        role: native::Role::Forward,
        destination: Mac([2, 0x66, 0, 0, 0, 1]),
        next: sender,
        wants_turn: false,
        session: 1,
        sender_session: 1,
        turn: 0,
        left: 0,
        slot: 0,
        round_us: 20_000,
        slots: 1,
        measurement: None,
        tag: None,
    };
    let mut bytes = vec![0; native::MAX_LEN];
    let len = repr.emit(&mut bytes).unwrap();
    bytes.truncate(len);
    bytes
}

#[test]
fn four_hundred_made_up_senders_do_not_blind_a_node() {
    let room = attacked("crowd", "wsr");
    let mut rx = room.keyed("rx", "tx", true);
    rx.until("records/s");
    let (mut stranger, clock) = (room.stranger(), Monotonic::new());
    let shared = Arc::new(Shared::default());
    let seen = Arc::clone(&shared);
    // Again and again: on a busy machine not every frame goes out, and not each is heard.
    let crowd = std::thread::spawn(move || {
        for n in (0..400).cycle().take_while(|_| !seen.stop.load(Relaxed)) {
            let next_at = clock.now() + csi5300::time::Span::from_ms(2);
            let _ = stranger.inject(clock.now(), &made_up(n));
            clock.sleep_until(next_at);
        }
    });
    rx.until("more than 256 senders on this channel");
    shared.stop.store(true, Relaxed);
    crowd.join().unwrap();
    let tx = room.keyed("tx", "rx", false);
    let last = rx.sure_bearing(&room.file(), 4);
    assert!(is_near(off_deg(&last), &last), "{last}");
    room.end([rx, tx]);
}

/// What a thread of a stranger and its test share.
#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    answered: AtomicU64,
}

/// Answers every forward frame for the peer at once, in its name, with its number and without a tag, until it is to stop.
fn answer(mut stranger: Monitor, shared: &Shared) {
    let clock = Monotonic::new();
    let mut bytes = vec![0; native::MAX_LEN];
    while !shared.stop.load(Relaxed) {
        let heard = stranger.hear().unwrap().map(|heard| heard.frame.to_vec());
        let Some(frame) = heard else {
            clock.sleep_until(clock.now() + csi5300::time::Span::from_us(100));
            continue;
        };
        let parsed = Frame::new_checked(&frame).and_then(|frame| Repr::parse(&frame));
        let Some(forward) = parsed.filter(|repr| repr.role == native::Role::Forward) else { continue };
        let (role, tag) = (native::Role::Backward, None);
        let forged = Repr { sender: forward.destination, role, destination: forward.sender, tag, ..forward };
        let len = forged.emit(&mut bytes).unwrap();
        // A room that is late has no space for it.
        shared.answered.fetch_add(u64::from(stranger.inject(clock.now(), &bytes[..len]).is_ok()), Relaxed);
    }
}

fn a_stranger_answers(driver: &str, alarm: &str) {
    let room = attacked(driver, driver);
    let tx = room.keyed("tx", "rx", false);
    let stranger = room.stranger();
    let shared = Arc::new(Shared::default());
    let seen = Arc::clone(&shared);
    let thread = std::thread::spawn(move || answer(stranger, &seen));
    let mut rx = room.keyed("rx", "tx", true);
    rx.until(alarm);
    // Nothing but the peer's own answers is used, if any are left. On a machine with more to do, the stranger answers seldom.
    let mut seconds = 0;
    while seconds < 7 || shared.answered.load(Relaxed) <= 100 {
        rx.said.clear();
        rx.until("records/s");
        seconds += 1;
    }
    let bearings = bearings(&room.file());
    shared.stop.store(true, Relaxed);
    thread.join().unwrap();
    for bearing in &bearings {
        // A busy machine's first bearings have moved too little, and say so.
        let bar_deg = bearing["azimuth_95_deg"].as_f64().unwrap();
        assert!(off_deg(bearing).abs() < f64::max(3.0, 2.0 * bar_deg), "{bearing}");
    }
    room.end([rx, tx]);
}

#[test]
fn a_strangers_answers_replace_no_pair_where_frames_come_with_the_records() {
    a_stranger_answers("stock", "frames with numbers of the exchange and without its key");
}

#[test]
fn a_strangers_answers_replace_no_pair_where_they_do_not() {
    a_stranger_answers("wsr", "exchanges have two records");
}
