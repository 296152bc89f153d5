//! The program as its users meet it.

use crate::{Running, folder};
use csi5300::source::replay::Replay;
use csi5300::source::survey::Survey;
use csi5300::source::{CsiSource, Next};
use csi5300::time::Instant;
use csi5300_sim::{Room, Scene, write_dataset};
use nix::fcntl::{FcntlArg, FdFlag, fcntl};
use nix::pty::{OpenptyResult, Winsize, openpty};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

fn program(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_csi5300-node"));
    command.current_dir(folder).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn said(output: Output) -> (i32, String, String) {
    let words = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code().expect("no signal"), words(output.stdout), words(output.stderr))
}

/// Runs the node of a configuration to its end.
fn run(folder: &Path, config: &str) -> (i32, String, String) {
    std::fs::write(folder.join("robot.toml"), config).unwrap();
    said(program(folder).args(["node", "--config", "robot.toml"]).output().unwrap())
}

/// The same on a disk that takes files of a few KiB.
fn run_limited(folder: &Path, config: &str) -> (i32, String, String) {
    std::fs::write(folder.join("robot.toml"), config).unwrap();
    let mut command = Command::new("sh");
    let limited = "ulimit -f 8; exec \"$0\" node --config robot.toml";
    command.args(["-c", limited, env!("CARGO_BIN_EXE_csi5300-node")]).current_dir(folder);
    said(command.output().unwrap())
}

/// Starts the node of a configuration.
fn started(folder: &Path, config: &str) -> Running {
    std::fs::write(folder.join("robot.toml"), config).unwrap();
    Running(program(folder).args(["node", "--config", "robot.toml"]).spawn().unwrap())
}

const ROOM: &str = "name = \"alpha\"\nchannel = \"108\"\ncapture.room = { scene = \"lab-circle\", robot = \"rx\", speed = 40 }\n\
                    odometry.room = {}\n[[peer]]\nname = \"tx\"\nrecords.room = {}\n";

/// The same in a room of the folder: the built-in one, changed.
fn changed_room(folder: &Path, change: impl Fn(&str) -> String) -> String {
    let scene = std::fs::read_to_string(crate::common::root().join("scenes/lab-circle.toml")).unwrap();
    std::fs::write(folder.join("room.toml"), change(&scene)).unwrap();
    ROOM.replace("\"lab-circle\"", "\"room.toml\"")
}

/// The same in a room that no test sees the end of.
fn endless_room(folder: &Path, speed: &str) -> String {
    let room = changed_room(folder, |scene| scene.replace("duration_s = 30.0", "duration_s = 1000000.0"));
    room.replace("speed = 40", speed)
}

#[test]
fn a_configuration_is_checked_whole_before_anything_starts() {
    let folder = folder("node-check");
    std::fs::write(folder.join("good.toml"), ROOM).unwrap();
    let check = |name: &str| said(program(&folder).args(["node", "--config", name, "--check"]).output().unwrap());
    let (status, out, err) = check("good.toml");
    assert!(status == 0 && out.starts_with("good.toml: good\n  channel "), "{out}{err}");
    assert!(out.contains("simulated room lab-circle") && out.contains("peers        tx"), "{out}");
    let antennas = "[array]\nantennas = [\"A\", \"B\"]\nbaselines_m = [[0.1, 0, 0]]\n";
    std::fs::write(folder.join("heard.toml"), ROOM.split("[[peer]]").next().unwrap().to_owned() + antennas).unwrap();
    let (status, out, err) = check("heard.toml");
    assert!(
        status == 0 && out.contains("antennas     A, B\n  peers        every sender that is heard\n"),
        "{out}{err}"
    );
    let bad = ROOM.replace("channel = \"108\"", "channel = \"13\"").replace("capture.room", "capture.radio");
    std::fs::write(folder.join("bad.toml"), bad).unwrap();
    let (status, _, err) = check("bad.toml");
    assert!(status == 2 && err.contains("bad.toml: line 3") && err.contains("radio"), "{err}");
    let (status, _, err) = check("absent.toml");
    assert!(status == 1 && err.contains("absent.toml"), "a missing file is no wrong usage: {err}");
    let alone = |args: &[&str]| said(program(&folder).args(args).output().unwrap());
    assert_eq!(alone(&["--check", "--config", "good.toml"]).0, 0, "the service needs no name");
    assert_eq!(alone(&["--check", "watch", "--once"]).0, 2, "every option acts or is refused");
}

/// The keys that a table may have, as the refusal of an unknown one lists them.
fn keys_of(table: &str) -> Vec<String> {
    let capture = if table.starts_with("capture") { "" } else { "capture.card = {}\n" };
    let text = format!("channel = '108'\n{capture}{}\n", table.replace("{}", "{ unknown_ = 1 }"));
    let refusal = csi5300_node::config::Config::read(&text, Path::new("")).unwrap_err().to_string();
    let (_, known) = refusal.split_once("unknown field `unknown_`, expected").unwrap_or_else(|| panic!("{refusal}"));
    known.lines().next().unwrap().split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

#[test]
fn the_example_configuration_has_every_key() {
    let text = std::fs::read_to_string(crate::common::root().join("packaging/robot.toml")).unwrap();
    let words: Vec<&str> = text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_').collect();
    let tables = ["estimator", "team", "output", "network", "sounding", "log", "ros", "ros2", "array"];
    let tables = tables.map(|name| format!("[{name}]\nunknown_ = 1"));
    let inline =
        ["unknown_ = 1", "[[peer]]\nunknown_ = 1", "team.ranges.b = {}", "camera_mount = {}"].map(str::to_owned);
    let poses = ["opencr", "ros", "ros2", "static"].map(|kind| format!("odometry.{kind} = {{}}"));
    let captures = ["card", "stock", "replay", "room", "served"].map(|kind| format!("capture.{kind} = {{}}"));
    for table in tables.iter().chain(&inline).chain(&poses).chain(&captures) {
        let keys = keys_of(table);
        let missing: Vec<&String> = keys.iter().filter(|key| !words.contains(&key.as_str())).collect();
        assert!(!keys.is_empty() && missing.is_empty(), "{table}: {missing:?}");
    }
}

#[test]
fn the_example_configuration_is_good() {
    let example = crate::common::root().join("packaging/robot.toml");
    let text = std::fs::read_to_string(example).unwrap();
    // As it is, in every build.
    csi5300_node::config::Config::read(&text, Path::new("")).unwrap();
    // With the network, whose lines it has as comments.
    let network = text
        .replace("records.sounding = {}", "records.network = {}")
        .replace("# poses.network = {}", "poses.network = {}")
        .replace("# [network]", "[network]")
        .replace("# group = ", "group = ")
        .replace("# publish_records", "publish_records")
        .replace("# publish_poses", "publish_poses");
    let refused = csi5300_node::config::Config::read(&network, Path::new(""));
    if cfg!(feature = "zenoh") {
        refused.unwrap();
    } else {
        let problems = refused.unwrap_err().0;
        assert!(problems.len() == 1 && problems[0].reason.contains("--features zenoh"), "{problems:?}");
    }
}

#[test]
fn a_configuration_is_found_in_the_usual_places() {
    let folder = folder("node-places");
    let home = folder.join("home");
    let run = |args: &[&str]| {
        let mut command = program(&folder);
        said(command.env("HOME", &home).env_remove("XDG_CONFIG_HOME").args(args).output().unwrap())
    };
    if !Path::new("/etc/csi5300/robot.toml").exists() {
        let (status, _, err) = run(&["node", "--check"]);
        assert!(status == 2 && err.contains("--config") && err.contains(".config/csi5300/robot.toml"), "{err}");
    }
    let own = home.join(".config/csi5300");
    std::fs::create_dir_all(&own).unwrap();
    std::fs::write(own.join("robot.toml"), format!("{ROOM}[output]\nstatus_socket = \"there\"\n")).unwrap();
    let (status, out, err) = run(&["node", "--check"]);
    assert!(status == 0 && out.contains("home/.config/csi5300/robot.toml: good"), "{out}{err}");
    // `watch` asks at the socket that it names.
    let (status, _, err) = run(&["watch", "--once"]);
    assert!(status == 1 && err.contains("home/.config/csi5300/there"), "{err}");
    std::fs::write(folder.join("robot.toml"), ROOM).unwrap();
    let (status, out, _) = run(&["node", "--check"]);
    assert!(status == 0 && out.starts_with("robot.toml: good"), "{out}");
    let (_, out, err) = run(&["node", "--check", "-q"]);
    assert!(out.contains("good") && err.is_empty(), "{err}");
}

#[test]
fn a_simulated_robot_runs_to_its_end_with_its_log_and_its_bearings() {
    let folder = folder("node-room");
    // Records wait however late the robot is.
    let room = changed_room(&folder, |scene| scene.replace("killed = true", "killed = true, queue_records = 1000000"));
    let text = format!(
        "{room}[output]\nbearings = \"{0}/bearings.jsonl\"\nstatus_line = \"always\"\n[log]\nfile = \"{0}/own.dat\"\n",
        folder.display()
    );
    // No start may take another's log for its own, whether or not it goes on in new files.
    for (log, rotate) in
        [("own.dat", ""), ("own-r1-0001.dat", "rotate_mib = 100\n"), ("own-r2-0001.dat", "rotate_mib = 100\n")]
    {
        let (status, out, err) = run(&folder, &format!("{text}{rotate}"));
        // At forty times real time a busy machine writes lines late: that is status 3.
        assert!(matches!(status, 0 | 3) && out.is_empty(), "{status} {err}");
        assert!(err.contains("tx: bearing") && err.contains("records/s"), "{err}");
        assert!(survey(&folder.join(log)).wsr > 0 && err.contains("records in the log, 0 not"), "{err}");
    }
    let lines = std::fs::read_to_string(folder.join("bearings.jsonl")).unwrap();
    assert!(crate::documented::are_documented(&lines) > 30);
    let reports: Vec<serde_json::Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let last = reports.last().unwrap();
    // The scene: from the middle of the circle to the transmitter.
    let truth = (1.11 + 0.494f64).atan2(-3.18 - 0.72).to_degrees();
    let off = (last["azimuth_deg"].as_f64().unwrap() - truth).abs();
    // Of a busy machine's records, what has no pose in time is not used. What is left may be one side of the circle (radius 0.3 m),
    // from where the transmitter is seen in up to 4.1 degrees another direction.
    let bar = last["azimuth_sd_deg"].as_f64().unwrap();
    assert!(off < 4.1 + f64::max(3.0, 2.0 * bar) && last["state"] == "bearing" && last["link"] == "tx", "{off} {last}");
}

/// A simulated capture, replayed: the configuration, with the files `rx.dat`, `tx.dat` and `way.csv` in the folder.
fn replayed(folder: &Path) -> String {
    let mut room = Room::new(&Scene::find("paper-circle".as_ref()).unwrap()).unwrap();
    let written = write_dataset(&mut room, folder, &mut |_| {}).unwrap();
    let mac = |robot: &str| room.mac(room.number(robot).unwrap()).unwrap();
    for log in &written[0].logs {
        let name = if Some(log.robot) == room.number("rx") { "rx.dat" } else { "tx.dat" };
        std::fs::copy(&log.path, folder.join(name)).unwrap();
    }
    let mut files = std::fs::read_dir(&written[0].dir).unwrap().map(|entry| entry.unwrap().path());
    let is_way = |file: &PathBuf| file.file_name().unwrap().to_str().unwrap().starts_with("rx_trajectory_");
    std::fs::copy(files.find(is_way).unwrap(), folder.join("way.csv")).unwrap();
    format!(
        "channel = \"108\"\nmac = \"{}\"\ncapture.replay = {{ file = \"rx.dat\", speed = 20 }}\nodometry.csv = \"way.csv\"\n\
         [output]\nbearings = \"bearings.jsonl\"\n\
         [[peer]]\nname = \"tx\"\nmac = \"{}\"\nrecords.replay = \"tx.dat\"\n",
        mac("rx"),
        mac("tx")
    )
}

#[test]
fn what_a_replay_lacks_is_in_its_words_and_its_status() {
    let folder = folder("node-replay");
    let config = replayed(&folder);
    let run = |from: &str, to: &str| {
        assert!(config.contains(from));
        run(&folder, &config.replace(from, to))
    };
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    // A robot whose sources cannot be opened leaves no file.
    write("table.dat", "1,2,3\n4,5,6\n");
    let (status, _, err) = run("rx.dat", "table.dat");
    assert!(status == 1 && err.contains("table.dat: no record of a csitool log in it"), "{status} {err}");
    write("short.csv", "1700000000.0,0,0,0,0\n");
    let (status, _, err) = run("way.csv", "short.csv");
    assert!(status == 1 && err.contains("short.csv: 1 usable poses make no trajectory"), "{status} {err}");
    assert!(!folder.join("bearings.jsonl").exists());
    let way = std::fs::read_to_string(folder.join("way.csv")).unwrap();
    let (before, after) = way.split_at(way.match_indices('\n').nth(900).unwrap().0);
    write("torn.csv", &format!("{before}\n1700000004.5,0.1\n{after}"));
    let (status, _, err) = run("way.csv", "torn.csv");
    assert!(status == 3 && err.contains("lost: 1 trajectories with skipped rows"), "{status} {err}");
    assert!(err.contains("tx: bearing") && err.contains("torn.csv: 1 rows skipped, the first in line 902"), "{err}");
    // Without any bearing nothing is usable.
    write("other.csv", &way.replace("17000000", "16000000"));
    let (status, _, err) = run("way.csv", "other.csv");
    assert!(status == 1 && err.contains("lie outside the trajectory"), "{status} {err}");
}

#[test]
fn a_full_disk_leaves_whole_lines_of_bearings() {
    let folder = folder("node-full");
    let (status, _, err) = run_limited(&folder, &format!("{ROOM}[output]\nbearings = \"bearings.jsonl\"\n"));
    assert!(status == 3 && err.contains("bearings are not written (File too large"), "{status} {err}");
    let lines = std::fs::read_to_string(folder.join("bearings.jsonl")).unwrap();
    assert!(lines.ends_with("}\n") && lines.lines().count() > 1, "{lines}");
    lines.lines().for_each(|line| drop(serde_json::from_str::<serde_json::Value>(line).unwrap()));
}

#[test]
fn a_recording_that_ended_early_is_a_loss() {
    let folder = folder("node-full-bag");
    let bag = "[output]\nbearings = \"\"\n[ros2]\ndomain = 142\nbag = \"run\"\n";
    let (status, _, err) = run_limited(&folder, &format!("{ROOM}{bag}"));
    assert!(status == 3 && err.contains("messages missing in the recording"), "{status} {err}");
    assert_eq!(err.matches("the recording of ROS 2 ended: File too large").count(), 1, "{err}");
}

#[test]
fn a_node_of_ros_2_prints_its_discovery_range_at_the_start() {
    let folder = folder("node-reach");
    std::fs::write(folder.join("robot.toml"), format!("{ROOM}[ros2]\ndomain = 141\n[output]\nbearings = \"\"\n"))
        .unwrap();
    let mut command = program(&folder);
    command.args(["node", "--config", "robot.toml"]).env_remove("ROS_LOCALHOST_ONLY").env_remove("ROS_STATIC_PEERS");
    let (status, _, err) = said(command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF").output().unwrap());
    let first = "ROS 2, domain 141: meets nobody; range: ROS_AUTOMATIC_DISCOVERY_RANGE\n";
    assert!(matches!(status, 0 | 3) && err.starts_with(first), "{status} {err}");
}

#[test]
fn the_state_is_served_on_a_socket_and_a_signal_ends_the_robot_in_order() {
    let folder = folder("node-socket");
    let text = format!(
        "{}[output]\nbearings = \"\"\nstatus_socket = \"{1}/s\"\n[log]\nfile = \"{1}/own.dat\"\n",
        endless_room(&folder, "speed = 1"),
        folder.display()
    );
    let mut node = started(&folder, &text);
    let look = || said(program(&folder).args(["watch", "s"]).output().unwrap());
    // The socket appears when the robot is up.
    let state = loop {
        let (status, out, _) = look();
        if status == 0 {
            break serde_json::from_str::<serde_json::Value>(&out).unwrap();
        }
        assert!(node.0.try_wait().unwrap().is_none(), "the robot ended by itself");
        std::thread::yield_now();
    };
    assert!(crate::documented::are_documented(&state.to_string()) > 18);
    assert_eq!((state["name"].as_str(), state["peers"][0]["name"].as_str()), (Some("alpha"), Some("tx")));
    let (status, table, err) = said(program(&folder).args(["watch", "s", "--once"]).output().unwrap());
    assert!(status == 0 && table.starts_with("alpha  up ") && table.contains("\n1 tx  "), "{table}{err}");
    // A second one on the same socket is refused, and does not take it away.
    let (status, _, err) = said(program(&folder).args(["node", "--config", "robot.toml"]).output().unwrap());
    assert!(status == 1 && err.contains("another node answers"), "{err}");
    assert_eq!(look().0, 0);
    nix::sys::signal::kill(nix::unistd::Pid::from_raw(node.0.id() as i32), nix::sys::signal::Signal::SIGTERM).unwrap();
    let status = node.0.wait().unwrap();
    let mut err = String::new();
    node.0.stderr.take().unwrap().read_to_string(&mut err).unwrap();
    // Also where no record had come yet.
    assert!(matches!(status.code(), Some(0 | 3)), "{status} {err}");
    assert!(err.contains("records in the log, 0 not"), "{err}");
    // What came between the signal and the end is in both.
    let number = |line: Option<&str>| line.and_then(|line| line.split_whitespace().next()).map(str::to_owned);
    let logged = err.lines().find(|line| line.contains("in the log"));
    assert_eq!(number(err.lines().next()), number(logged), "{err}");
    assert!(!folder.join("s").exists(), "the socket is gone with the robot");
    let (_, _, err) = look();
    assert!(err.contains("does the node run"), "{err}");
}

/// What is in a log.
fn survey(log: &Path) -> Survey {
    let (mut log, mut survey) = (Replay::open(log).unwrap(), Survey::default());
    loop {
        let next = log.receive(Instant::ZERO).unwrap();
        survey.note(&next);
        if matches!(next, Next::End(_)) {
            return survey;
        }
    }
}

/// `csi5300-node watch` on a terminal whose ends no program inherits: one that holds its own terminal's other end never sees that
/// it ended.
struct Watching {
    child: Child,
    terminal: OpenptyResult,
    screen: File,
    shown: String,
    /// The connection of the node that it watches.
    _state: UnixStream,
}

impl Watching {
    /// Starts `command` on the socket of a node named burger-7, and waits until it shows that name.
    fn start(mut command: Command, socket: &Path) -> Self {
        let node = UnixListener::bind(socket).unwrap();
        let size = Winsize { ws_row: 24, ws_col: 100, ws_xpixel: 0, ws_ypixel: 0 };
        let terminal = openpty(&size, None).unwrap();
        for end in [&terminal.master, &terminal.slave] {
            fcntl(end, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)).unwrap();
        }
        let side = || Stdio::from(terminal.slave.try_clone().unwrap());
        command.arg("watch").arg(socket).stdin(side()).stdout(side()).stderr(side()).env("TERM", "xterm");
        let child = command.spawn().unwrap();
        let mut state = node.accept().unwrap().0;
        state.write_all(b"{\"name\": \"burger-7\"}\n").unwrap();
        let screen = File::from(terminal.master.try_clone().unwrap());
        let mut own = Self { child, terminal, screen, shown: String::new(), _state: state };
        own.read_until(|shown| shown.contains("burger-7"));
        own
    }

    fn read_until(&mut self, is_there: impl Fn(&str) -> bool) {
        let mut bytes = [0; 4096];
        while !is_there(&self.shown) {
            let count = self.screen.read(&mut bytes).unwrap();
            self.shown += &String::from_utf8_lossy(&bytes[..count]);
        }
    }

    fn echoes(&self) -> bool {
        let flags = nix::sys::termios::tcgetattr(&self.terminal.slave).unwrap().local_flags;
        flags.contains(nix::sys::termios::LocalFlags::ECHO | nix::sys::termios::LocalFlags::ICANON)
    }
}

fn send(child: &Child, signal: Signal) {
    kill(Pid::from_raw(child.id() as i32), signal).unwrap();
}

#[test]
fn a_signal_gives_the_terminal_back_as_it_was() {
    let folder = folder("watch-signals");
    for signal in [Signal::SIGTERM, Signal::SIGINT, Signal::SIGHUP, Signal::SIGQUIT] {
        let Some(command) = crate::common::with_usual_signals(env!("CARGO_BIN_EXE_csi5300-node")) else { return };
        let mut watching = Watching::start(command, &folder.join(format!("{signal}.sock")));
        let is_on_its_own_screen = watching.shown.contains("\x1b[?1049h") && !watching.echoes();
        assert!(is_on_its_own_screen, "{signal}: {}", watching.shown);
        send(&watching.child, signal);
        assert_eq!(watching.child.wait().unwrap().code(), Some(0), "{signal}");
        assert!(watching.echoes(), "{signal}");
        nix::unistd::write(&watching.terminal.slave, b"end").unwrap();
        watching.read_until(|shown| shown.ends_with("end"));
        let shown = watching.shown;
        assert!(shown.contains("\x1b[?1049l"), "{signal}: {shown:?}");
        assert!(shown.rfind("\x1b[?25h") > shown.rfind("\x1b[?25l"), "{signal}: {shown:?}");
    }
}

#[test]
fn half_a_state_and_a_line_without_an_end_are_no_state() {
    let folder = folder("watch-half");
    let half = |state: &mut UnixStream| state.write_all(b"{\"name\":\"burger\",\"peers\":[").unwrap();
    // Until nobody reads any more.
    let endless = |state: &mut UnixStream| while state.write_all(&[b'a'; 1 << 16]).is_ok() {};
    type Case<'a> = (&'a str, &'a [&'a str], &'a dyn Fn(&mut UnixStream), &'a str);
    let cases: [Case; 2] = [
        ("half", &["watch"], &half, "ended before it sent its state"),
        ("endless", &["watch", "--once"], &endless, "more than 16 MiB"),
    ];
    for (name, args, send, words) in cases {
        let node = UnixListener::bind(folder.join(name)).unwrap();
        let child = program(&folder).args(args).arg(name).spawn().unwrap();
        send(&mut node.accept().unwrap().0);
        let (status, out, err) = said(child.wait_with_output().unwrap());
        assert!(status == 1 && out.is_empty() && err.contains(words), "{name}: {status} {out} {err}");
    }
}

/// As when an SSH session or a pane goes: by a hangup where it is the program's own terminal, and where that does not reach the
/// program (`nohup`, another session) the end of the terminal is all that there is to see.
#[test]
fn a_closed_terminal_ends_the_display() {
    let folder = folder("watch-ended");
    for is_own in [true, false] {
        let Some(mut command) = crate::common::with_usual_signals(env!("CARGO_BIN_EXE_csi5300-node")) else { return };
        if is_own {
            let usual = command;
            command = Command::new("setsid");
            command.arg("--ctty").arg(usual.get_program()).args(usual.get_args());
        }
        let watching = Watching::start(command, &folder.join(format!("{is_own}.sock")));
        let Watching { mut child, terminal, mut screen, _state, .. } = watching;
        // Part of an arrow key, after which crossterm would wait for the rest.
        screen.write_all(b"\x1b[").unwrap();
        drop((screen, terminal));
        assert_eq!(child.wait().unwrap().code(), Some(0), "its own: {is_own}");
    }
}
