//! Tests every rule with a configuration whose wrong key is not the first: the refusal names its line.

use crate::config::Config;
use std::path::Path;

/// A valid room; peers come last.
const ROOM: &str = "name = \"here\"\nchannel = \"108\"\n\n# A comment that names mac, odometry and rate_hz.\n\
                    capture.room = { scene = \"lab-circle\", robot = \"rx\" }\nodometry.room = {}\n";
/// A valid card, except for missing features.
const CARD: &str = "name = \"here\"\nchannel = \"108\"\nmac = \"02:00:00:00:00:01\"\ncapture.card = {}\n\
                    odometry.opencr.port = \"/dev/null\"\n[log]\nfile = \"x.dat\"\n";
const PEER: &str = "[[peer]]\nname = \"tx\"\nyaw_deg = 0.0\nrecords.room = {}\n";

/// Refusals of a text, each `line N: why`.
fn refusals(text: &str) -> Vec<String> {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/src"));
    let refused = Config::read(text, folder).err().map(|error| error.to_string());
    refused.unwrap_or_default().lines().map(str::to_owned).collect()
}

/// One of the refusals is `wanted`, from its beginning; its line is that of `key` in the text.
#[track_caller]
fn refused(text: &str, key: &str, why: &str) {
    let line = text.lines().position(|line| line.contains(key)).unwrap() + 1;
    let all = refusals(text);
    let is_it = |refusal: &&String| refusal.starts_with(&format!("line {line}: ")) && refusal.contains(why);
    assert!(all.iter().any(|refusal| is_it(&refusal)), "line {line} ({key}), {why}: {all:?}\n{text}");
}

#[test]
fn the_base_configuration_is_good() {
    assert_eq!(refusals(&format!("{ROOM}{PEER}")), Vec::<String>::new());
    assert_eq!(refusals(CARD), Vec::<String>::new());
}

#[test]
fn the_team() {
    let team = |rest: &str| format!("{ROOM}[team]\n{rest}\n{PEER}");
    assert_eq!(refusals(&team("places = { tx = [1.0, 2.0] }\nframe = \"hall\"")), Vec::<String>::new());
    refused(&team("frame = \"hall\"\nplaces.ty = [1.0, 2.0]"), "places", "no peer `ty`");
    refused(&team("places.tx = [1.0, inf]"), "places", "finite");
    refused(&team("places.tx = [1.0, 2.0, 3.0]"), "places", "3 numbers where 2 are expected");
    refused(&format!("antenna_offset_m = [0, 0, 0, 7]\n{}", team("")), "antenna_offset_m", "4 numbers where 3");
    refused(&team("places = {}\nplace = {}"), "place = ", "unknown field");
    assert_eq!(refusals(&team("ranges.tx = { topic = \"/uwb/tx\" }")), Vec::<String>::new());
    refused(&team("frame = \"map\"\nranges.ty = { topic = \"/uwb/ty\" }"), "ranges", "no peer `ty`");
    refused(&team("frame = \"map\"\nranges.tx = { topic = \"/uwb tx\" }"), "ranges", "not a valid ROS 2 name");
    refused(&team("frame = \"map\"\nranges.tx = { topic = \"/uwb\", sd_m = 0.0 }"), "ranges", "above 0");
    refused(
        &format!("{}[ros2]\nframe = \"map\"\n", team("frame = \"map\"\nplaces.tx = [1.0, 2.0]")),
        "frame",
        "other than",
    );
    refused(&format!("{CARD}[team]\n"), "[team]", "needs a [[peer]]");
}

#[test]
fn this_robot() {
    let card = |from: &str, to: &str| CARD.replace(from, to);
    refused(&card("mac = \"02:00:00:00:00:01\"\n", ""), "capture.card", "`mac`");
    let stock = card("capture.card = {}", "capture.stock.frames = true");
    assert_eq!(refusals(&stock), Vec::<String>::new());
    refused(&stock.replace("frames", "frame"), "frame", "unknown field");
    let replay = format!("{}[capture.replay]\nspeed = 2\nfile = \"no.dat\"\n", card("capture.card = {}\n", ""));
    refused(&replay, "no.dat", "there is no log");
    let room = |from: &str, to: &str| format!("{ROOM}{PEER}").replace(from, to);
    let inline = "capture.room = { scene = \"lab-circle\", robot = \"rx\" }\nodometry.room = {}";
    let table = |scene: &str, robot: &str| {
        room(
            inline,
            &format!("odometry.room = {{}}\n[capture.room]\nspeed = 2.0\nscene = \"{scene}\"\nrobot = \"{robot}\""),
        )
    };
    refused(&table("no.toml", "rx"), "no.toml", "no.toml");
    refused(&table("lab-circle", "nobody"), "nobody", "no robot `nobody`");
    let followed = table("lab-circle", "rx\"\n[capture.room.follow]\ntx.csv.file = \"way.csv");
    refused(&followed, "tx.csv", "`tx` moves as the scene says");
    refused(&room("channel", "mac = \"02:00:00:00:00:99\"\nchannel"), "mac =", "`rx` has the MAC");
    refused(&format!("{ROOM}{PEER}mac = \"02:00:00:00:00:99\"\n"), "mac = ", "`tx` has the MAC");
    refused(&room("odometry.room = {}\n", ""), "[[peer]]", "no robot here ever moves");
    refused(&card("[log]\nfile = \"x.dat\"\n", ""), "capture.card", "there is nothing to do");
}

#[test]
fn numbers() {
    let estimator = |more: &str| format!("{ROOM}{PEER}[estimator]\naccurate = true\n{more}\n");
    for (key, value) in [
        ("elevation_max_deg", "91.0"),
        ("heading_sd_deg", "-1.0"),
        ("accurate_every_s", "-1.0"),
        ("extrapolate_s", "2.0"),
        ("window_m", "0.05"),
        ("least_motion_m", "9.0"),
        ("rate_hz", "101.0"),
    ] {
        refused(&estimator(&format!("{key} = {value}")), &format!("{key} ="), "");
    }
    let room = |from: &str, to: &str| format!("{ROOM}{PEER}").replace(from, to);
    refused(&room("odometry.room", "antenna_offset_m = [0.0,\n  inf, 0.0]\nodometry.room"), "inf", "antenna_offset_m");
    let place = "[odometry.static]\nposition_m = [0.0, 0.0, 0.0]\nheading_deg = nan";
    refused(&room("odometry.room = {}", place), "nan", "odometry: every number");
    refused(&room("yaw_deg = 0.0", "yaw_deg = nan"), "nan", "peer `tx`");
    refused(&format!("{ROOM}{PEER}antenna_offset_m = [0, nan, 0]\n"), "nan", "peer `tx`");
    refused(&format!("{ROOM}{PEER}[peer.poses.static]\nheading_deg = 1.0\nposition_m = [0, 0, inf]\n"), "inf", "peer");
}

#[test]
fn an_antenna_is_on_its_robot_and_a_pace_is_one_that_can_be_kept() {
    let room = |from: &str, to: &str| format!("{ROOM}{PEER}").replace(from, to);
    refused(&room("odometry.room", "antenna_offset_m = [1e300, 0.0, 0.0]\nodometry.room"), "1e300", "not on a robot");
    refused(
        &format!("{ROOM}{PEER}antenna_offset_m = [0, 0,\n-10.5]\n"),
        "-10.5",
        "peer `tx`: antenna_offset_m: -1.05e1 m",
    );
    assert_eq!(refusals(&format!("{ROOM}{PEER}antenna_offset_m = [0, 0, -10]\n")), Vec::<String>::new());
    let inline = "capture.room = { scene = \"lab-circle\", robot = \"rx\" }\n";
    let paced = |speed: &str| {
        let table = format!("[capture.room]\nscene = \"lab-circle\"\nspeed = {speed}\nrobot = \"rx\"\n");
        room(inline, "").replace(PEER, &format!("{table}{PEER}"))
    };
    let replay = |speed: &str| {
        CARD.replace("capture.card = {}\n", "").replace("odometry.opencr.port = \"/dev/null\"", "odometry.static = {}")
            + &format!("[capture.replay]\nfile = \"lib.rs\"\nspeed = {speed}\n")
    };
    for speed in ["1e-3", "1", "1e3"] {
        assert_eq!(refusals(&paced(speed)), Vec::<String>::new(), "{speed}");
        assert_eq!(refusals(&replay(speed)), Vec::<String>::new(), "{speed}");
    }
    for speed in ["1e300", "1.1e3", "9e-4"] {
        refused(&paced(speed), "speed", "0.001 to 1000 times");
        refused(&replay(speed), "speed", "0.001 to 1000 times");
    }
}

#[test]
fn camera_mount_needs_poses_of_a_camera() {
    let mounted = |camera: &str, poses: &str| {
        let given = format!("camera_mount = {camera}\n{poses}");
        CARD.replace("odometry.opencr.port = \"/dev/null\"", &given)
    };
    let mount = "{ forward_m = 0.04, left_m = 0.17, yaw_deg = -1.5 }";
    refused(&mounted(mount, "odometry.opencr.port = \"/dev/null\""), "camera_mount", "of the wheels already");
    refused(&mounted(mount, "odometry.static = {}"), "camera_mount", "no poses of a camera");
    let room = format!("camera_mount = {mount}\n{ROOM}{PEER}");
    refused(&room, "camera_mount", "of the robot, not of a camera");
    let endless = mounted("{ forward_m = 0.0, left_m = inf }", "odometry.csv.file = \"no.csv\"");
    refused(&endless, "inf", "left_m: every number must be finite");
    refused(
        &mounted("{ forward_m = 1e300, left_m = 0 }", "odometry.static = {}"),
        "1e300",
        "forward_m: 1e300 m is not on",
    );
    assert_eq!(refusals(&mounted(mount, "odometry.ros2 = { topic = \"/odom\" }")), Vec::<String>::new());
    let antenna = mounted(mount, "odometry.ros2 = { topic = \"/odom\", antenna_frame = \"wifi\" }");
    refused(&antenna, "camera_mount", "`antenna_frame` moves poses");
}

#[test]
fn poses() {
    let card = |poses: &str| CARD.replace("odometry.opencr.port = \"/dev/null\"", poses);
    refused(&card("odometry.csv.file = \"no.csv\""), "no.csv", "no trajectory");
    refused(&card("odometry.csv.file = \"lib.rs\""), "odometry.csv", "replayed capture");
    refused(&card("odometry.room = {}"), "odometry.room", "`room` poses");
    refused(&card("odometry.network = {}"), "odometry.network", "own poses");
    let room = |poses: &str| format!("{ROOM}{PEER}").replace("odometry.room = {}", poses);
    refused(&room("odometry.opencr.port = \"/dev/null\""), "opencr", "`opencr` poses are live");
    refused(&room("odometry.ros.topic = \"/odom\""), "odometry.ros", "`ros` poses are live");
    let peer = "[[peer]]\nname = \"b\"\nmac = \"02:00:00:00:00:02\"\nrecords.network = {}\n";
    refused(&format!("{CARD}{peer}poses.network = {{}}\n"), "poses.network", "peer `b`: `network` poses");
    refused(&format!("{CARD}{peer}poses.opencr.port = \"x\"\n"), "poses.opencr", "peer `b`: a peer's port");
    refused(&card("odometry.ros = {\n  topic = \"odom\" }"), "topic", "");
}

#[test]
fn the_peers() {
    let peer = |name: &str, more: &str| format!("[[peer]]\nname = \"{name}\"\n{more}\n");
    let two =
        |second: &str| format!("{CARD}{}{second}", peer("a", "mac = \"02:00:00:00:00:02\"\nrecords.network = {}"));
    let second = |more: &str| two(&peer("b", more));
    let mac = "mac = \"02:00:00:00:00:03\"\n";
    refused(&two(&format!("[[peer]]\n{mac}records.network = {{}}\nname = \"a\" # again\n")), "# again", "has its name");
    let same = "records.network = {}\nmac = \"02:00:00:00:00:02\" # again";
    refused(&second(same), "# again", "another peer has its name or MAC");
    let missing = two("[[peer]] # b\nname = \"b\"\nrecords.network = {}\n");
    refused(&missing, "# b", "peer `b`: `mac` is missing");
    refused(&second("records.network = {}\nmac = \"02:00:00:00:00:01\" # own"), "# own", "this robot's own MAC");
    refused(&second(&format!("{mac}records.replay.file = \"no.dat\"")), "no.dat", "there is no log");
    refused(&second(&format!("{mac}records.replay.file = \"lib.rs\"")), "lib.rs", "a replayed log needs");
    refused(&second(&format!("{mac}records.room = {{}}")), "records.room", "`room` records need");
    refused(&second(&format!("{mac}records.network = {{}} # b")), "# b", "`network` records need a [network]");
    let owned = |rest: &str| second(&format!("{mac}certificate = {rest}"));
    refused(&owned("\" \"\nrecords.network = {}"), "certificate", "`certificate` is the common name");
    refused(&owned("\"b\"\nrecords.replay.file = \"no.dat\""), "certificate", "records and poses of the network");
    refused(&format!("{ROOM}{PEER}[[peer]]\nrecords.room = {{}}\nname = \"ty\"\n"), "\"ty\"", "no robot `ty`");
    let itself = "[[peer]]\nrecords.room = {}\nname = \"rx\" # itself\n";
    refused(&format!("{ROOM}{itself}"), "# itself", "peer `rx` is this robot itself");
    let served = CARD.replace("capture.card = {}", "capture.served = { socket = \"s\", robot = \"rx\" }");
    refused(&format!("{}{itself}", served.replace("mac =", "#")), "# itself", "peer `rx` is this robot itself");
}

#[test]
fn antennas_that_need_no_peer() {
    let array = "[array]\nantennas = [\"A\", \"B\"]\nbaselines_m = [[0.1, 0.0, 0.0]]\n";
    let alone = format!("{ROOM}{array}");
    assert_eq!(refusals(&alone), Vec::<String>::new());
    let wrong = |from: &str, to: &str, key: &str, why: &str| refused(&alone.replace(from, to), key, why);
    wrong("\"B\"", "\"A\"", "antennas =", "named twice");
    wrong("\"B\"", "\"D\"", "antennas =", "A, B or C");
    wrong(", \"B\"", "", "antennas =", "2 or 3");
    wrong("[[0.1, 0.0, 0.0]]", "[]", "baselines_m", "0 baselines for 2 antennas");
    wrong("0.1,", "100.0,", "baselines_m", "metres are expected");
    let constants = |constants: &str| format!("{alone}chain_constants_deg = {constants}\n");
    refused(&constants("[[1.0, -2.0]]"), "chain_constants_deg", "a deviation of 0 or more");
    // A sender by its name in the room, or by its MAC.
    let heard = "[[peer]]\nname = \"tx\"\nrecords.heard = {}\n";
    assert_eq!(refusals(&format!("{alone}{heard}")), Vec::<String>::new());
    refused(&format!("{ROOM}{heard}"), "records.heard", "needs an [array]");
    refused(&format!("{alone}{}", heard.replace("tx", "ty")), "\"ty\"", "no robot `ty`");
    refused(&format!("{alone}{heard}poses.room = {{}}\n"), "records.heard", "leave `poses` out");
    let stands = alone.replace("odometry.room", "odometry.static") + heard;
    refused(&stands, "[[peer]]", "no robot here ever moves");
    let known =
        format!("{}chain_constants_deg = [[52.7, 0.3]]\n{heard}", alone.replace("odometry.room", "odometry.static"));
    assert_eq!(refusals(&known), Vec::<String>::new());
}

#[test]
fn feitcsi() {
    let of = |capture: &str| CARD.replace("capture.card = {}", capture);
    assert_eq!(refusals(&of("capture.feitcsi.udp = \"127.0.0.1:8008\"")), Vec::<String>::new());
    refused(&of("capture.feitcsi.udp = \"8008\""), "udp", "address");
    refused(&of("capture.feitcsi.pipe = \"lib.rs\""), "pipe", "no named pipe");
}

#[test]
fn ros_and_sounding() {
    let ros = |more: &str| format!("{CARD}[ros]\nframe = \"odom\"\n{more}\n");
    refused(&ros("master = \"10.0.0.1\""), "master", "one looks like");
    refused(&ros("node = \"a b\""), "node", "not a valid ROS name");
    let peer = "[[peer]]\nname = \"b\"\nmac = \"02:00:00:00:00:02\"\nrecords.network = {}\n";
    let sounding = |more: &str| format!("{CARD}{peer}[sounding]\nfifo = false\n{more}\n");
    let mon = "interface = \"mon0\"\n";
    refused(&sounding(""), "[sounding]", "a monitor interface, is missing");
    refused(&format!("{CARD}[sounding]\n{mon}"), "[sounding]", "needs a [[peer]]");
    refused(&format!("{ROOM}{PEER}[sounding]\n{mon}"), "[sounding]", "is done with a card");
    let answers = |text: String| text.replace("records.network = {}", "records.sounding = {}");
    let of_answers = answers(sounding(mon));
    assert_eq!(refusals(&of_answers), Vec::<String>::new());
    refused(&answers(sounding(&format!("{mon}initiate = false"))), "records.sounding", "`initiate`");
    let moves = of_answers.replace("records.sounding = {}", "records.sounding = {}\nposes.room = {}");
    refused(&moves, "records.sounding", "it must stand");
    let served = sounding(mon).replace("capture.card = {}", "capture.served = { socket = \"s\", robot = \"a\" }");
    refused(&served, "interface", "leave `interface` out");
    for (key, why) in [
        ("key = \"no.key\"", "there is no key"),
        ("rate_hz = 1e5", "rounds"),
        ("mcs = 24", "23"),
        ("links = 0", "links"),
    ] {
        refused(&sounding(&format!("{mon}{key}")), key, why);
    }
}

#[test]
fn ros_2() {
    let ros = |more: &str| format!("{CARD}[ros2]\nframe = \"odom\"\n{more}\n");
    let topic = |more: &str| CARD.replace("odometry.opencr.port = \"/dev/null\"", &format!("[odometry.ros2]\n{more}"));
    assert_eq!(refusals(&ros("interface = \"127.0.0.2\"\nnamespace = \"/lab\"\nnode = \"n\"")), Vec::<String>::new());
    assert_eq!(
        refusals(&ros("interface = \"192.168.1.5\"\ninsecure = true\npeers = [\"10.0.0.1\"]")),
        Vec::<String>::new()
    );
    refused(&ros("interface = \"192.168.1.5\""), "interface", "`insecure = true`");
    refused(&ros("interface = \"0.0.0.0\"\ninsecure = true"), "interface", "one address");
    refused(&ros("peers = [\"10.0.0.1\"]"), "peers", "cannot be reached from 127.0.0.1");
    refused(&ros("domain = 233"), "domain", "0 to 232");
    refused(&ros("namespace = \"lab\""), "namespace", "not a valid ROS 2 namespace");
    refused(&ros("node = \"/a/b\""), "node", "not a valid ROS 2 node name");
    refused(&ros("remap = { \"a b\" = \"/c\" }"), "remap", "not a valid ROS 2 name");
    refused(&topic("type = \"tf\"\nframe = \"odom\""), "type", "from `frame` to `child`");
    refused(&topic("child = \"base_link\""), "child", "is for transforms");
    refused(&topic("type = \"pose\"\nantenna_frame = \"wifi\""), "antenna_frame", "is for odometry");
    refused(&topic("imu = \"1mu\""), "imu", "not a valid ROS 2 name");
    refused(&format!("{ROOM}{PEER}").replace("odometry.room = {}", "odometry.ros2 = {}"), "odometry.ros2", "are live");
}

#[test]
fn output_and_network() {
    if let Some(why) = crate::adapters::missing("foxglove") {
        assert!(why.contains("--features foxglove"));
        let output = "[output]\nbearings = \"-\"\nfoxglove = \"127.0.0.1:1\"\n";
        refused(&format!("{CARD}{output}"), "foxglove", "foxglove in [output]");
    }
    let network = |more: &str| format!("{CARD}[network]\ngroup = \"g\"\n{more}\n");
    if crate::adapters::missing("zenoh").is_some() {
        refused(&network(""), "[network]", "--features zenoh");
    }
    refused(&network("backlog = 1"), "backlog", "256 to 1000000");
    refused(&network("zenoh = \"no.json5\""), "no.json5", "no such file");
}

#[test]
fn outputs_are_in_separate_files() {
    let folder = std::env::temp_dir().join(format!("csi5300-written-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let name = |file: &str| folder.join(file).display().to_string();
    let with = |log: &str, bearings: &str, socket: &str| {
        CARD.replace("x.dat", &name(log))
            + &format!("[output]\nbearings = '{}'\nstatus_socket = '{}'\n", name(bearings), name(socket))
    };
    assert_eq!(refusals(&with("a.dat", "b", "c")), Vec::<String>::new());
    refused(&with("a.dat", "./a.dat", "c"), "bearings", "is also the output of `file`");
    refused(&with("a.dat", "a.datstp", "c"), "bearings", "is also the output of `file`");
    refused(&with("a.dat", "b", "a.dat"), "status_socket", "is also the output of `file`");
    refused(&with("a.dat", "b", "b"), "status_socket", "is also the output of `bearings`");
    refused(&CARD.replace("x.dat", "/dev/full"), "/dev/full", "no regular file");
    refused(&format!("{CARD}rotate_mib = 0\n"), "rotate_mib", "a file of its own");
    // What already exists: a log and a recording get other names, lines are added, a socket is one.
    std::fs::create_dir_all(folder.join("run")).unwrap();
    std::fs::write(folder.join("old"), "").unwrap();
    let ros = |bag: &str| format!("{CARD}[ros2]\nbag = '{}'\n", name(bag));
    let bags = [ros("run"), ros("no/such/run")];
    for good in [with("old", "/dev/null", "c"), with("a.dat", "old", "c")].into_iter().chain(bags) {
        assert_eq!(refusals(&good.replace(&name("/dev/null"), "/dev/null")), Vec::<String>::new(), "{good}");
    }
    refused(&ros("old/run"), "bag", "old is no folder");
    refused(&with("run", "b", "c"), "file", "it is a folder");
    refused(&with("a.dat", "run", "c"), "bearings", "it is a folder");
    refused(&with("a.dat", "b", "old"), "status_socket", "there and no socket");
    let _socket = std::os::unix::net::UnixListener::bind(folder.join("socket")).unwrap();
    refused(&with("a.dat", "socket", "c"), "bearings", "it is a socket");
    assert_eq!(refusals(&with("a.dat", "b", "socket")), Vec::<String>::new(), "left by another start, or refused then");
    // Its own file, by another name.
    let own = folder.join("robot.toml");
    std::fs::write(&own, with("a.dat", "robot.toml", "c")).unwrap();
    std::os::unix::fs::symlink(&own, folder.join("link.toml")).unwrap();
    let said = Config::load(&folder.join("link.toml")).unwrap_err().to_string();
    assert!(said.contains("is this configuration"), "{said}");
    std::fs::remove_dir_all(folder).unwrap();
}

/// Whatever name it is given: the recording would be what is written, or have lines of JSON in it.
#[test]
fn inputs_are_not_written() {
    let folder = std::env::temp_dir().join(format!("csi5300-read-{}", std::process::id()));
    std::fs::create_dir_all(folder.join("sub")).unwrap();
    for file in ["rx.dat", "rx.datstp", "tx.dat", "way.csv", "key"] {
        std::fs::write(folder.join(file), file).unwrap();
    }
    std::os::unix::fs::symlink("../rx.dat", folder.join("sub/link.dat")).unwrap();
    std::fs::hard_link(folder.join("rx.dat"), folder.join("sub/hard.dat")).unwrap();
    std::fs::hard_link(folder.join("way.csv"), folder.join("hard.csv")).unwrap();
    let config = |capture: &str, output: &str| {
        format!(
            "name = 'here'\nchannel = '108'\nmac = '02:00:00:00:00:01'\ncapture.replay.file = '{capture}'\n\
             odometry.csv.file = 'way.csv'\n[output]\n{output}\n[[peer]]\nname = 'tx'\n\
             mac = '02:00:00:00:00:02'\nrecords.replay.file = 'tx.dat'\n"
        )
    };
    let said = |text: &str| Config::read(text, &folder).err().map(|error| error.to_string()).unwrap_or_default();
    for (capture, bearings, key) in [
        ("rx.dat", "rx.dat", "`capture.replay`"),
        ("rx.dat", "sub/../rx.dat", "`capture.replay`"),
        ("rx.dat", "./rx.dat", "`capture.replay`"),
        ("rx.dat", "sub/link.dat", "`capture.replay`"),
        ("sub/link.dat", "rx.dat", "`capture.replay`"),
        ("rx.dat", "sub/hard.dat", "`capture.replay`"),
        ("rx.dat", "rx.datstp", "`capture.replay`"),
        ("sub/link.dat", "rx.datstp", "`capture.replay`"),
        ("rx.dat", "tx.dat", "`records.replay` of peer `tx`"),
        ("rx.dat", "way.csv", "`odometry`"),
        ("rx.dat", "hard.csv", "`odometry`"),
    ] {
        let why = said(&config(capture, &format!("bearings = '{bearings}'")));
        let wanted = format!("is an input ({key}): name another output");
        assert!(why.starts_with("line 7: ") && why.contains(&wanted), "{capture}, {bearings}: {why}");
    }
    let output = |more: &str| said(&config("rx.dat", more));
    assert_eq!(output("bearings = 'out.json'\n[log]\nfile = 'own.dat'"), "");
    assert!(output("bearings = ''\n[log]\nfile = 'rx.dat'").starts_with("line 9: "));
    assert!(output("bearings = ''\nstatus_socket = 'way.csv'").starts_with("line 8: "));
    let keyed = format!("{CARD}[output]\nbearings = 'key'\n[sounding]\ninterface = 'mon0'\nkey = 'key'\n{PEER}")
        .replace("records.room = {}", "mac = '02:00:00:00:00:02'\nrecords.sounding = {}");
    let why = said(&keyed);
    assert!(why.contains("is an input (`sounding.key`)"), "{why}");
    assert_eq!(std::fs::read(folder.join("rx.dat")).unwrap(), b"rx.dat");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn names_that_no_file_or_socket_can_have_are_refused_before_the_start() {
    let output = |more: &str| format!("{CARD}[output]\nbearings = \"\"\n{more}\n");
    let said = |text: &str| Config::read(text, Path::new("")).err().map(|error| error.to_string()).unwrap_or_default();
    let empty = "an empty name is no file";
    assert!(said(&output("status_socket = \"\"")).starts_with(&format!("line 10: {empty}")));
    assert!(said(&CARD.replace("x.dat", "")).starts_with(&format!("line 7: {empty}")));
    let socket = |bytes: usize| output(&format!("status_socket = '/tmp/{}'", "s".repeat(bytes - "/tmp/".len())));
    assert_eq!(said(&socket(107)), "");
    let why = said(&socket(108));
    assert!(why.starts_with("line 10: ") && why.contains("it has 108 bytes") && why.contains("at most 107"), "{why}");
}

#[cfg(feature = "zenoh")]
#[test]
fn topics_of_ros_2_over_the_network() {
    let network = |ros2: &str| format!("{CARD}[network]\nros2 = true\n{ros2}");
    assert_eq!(refusals(&network("[ros2]\n")), Vec::<String>::new());
    refused(&network(""), "ros2 = true", "no topics to carry");
    refused(&network("[ros2]\ndistribution = \"humble\"\n"), "ros2 = true", "Jazzy");
}

#[cfg(feature = "zenoh")]
#[test]
fn certificates_of_peers() {
    let folder = std::env::temp_dir().join(format!("csi5300-owners-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let zenoh = |name: &str, more: &str| {
        let file = folder.join(name);
        std::fs::write(&file, format!("{{ transport: {{ link: {{ tls: {{ enable_mtls: true }} }} }}, {more} }}"))
            .unwrap();
        format!("zenoh = '{}'\nlisten = [\"tls/127.0.0.1:7447\"]\n", file.display())
    };
    let peer = "[[peer]]\nname = \"b\"\nmac = \"02:00:00:00:00:02\"\nrecords.network = {}\ncertificate = \"b\"\n";
    let network = |file: &str| format!("{CARD}[network]\n{file}{peer}");
    refused(&network(""), "[network]", "needs a network where both ends show one");
    assert_eq!(refusals(&network(&zenoh("asks.json5", ""))), Vec::<String>::new());
    let ruled = zenoh("rules.json5", "access_control: { enabled: true, default_permission: 'allow' }");
    refused(&network(&ruled), "[network]", "has an `access_control` of its own");
    assert_eq!(refusals(&network(&ruled).replace("certificate = \"b\"\n", "")), Vec::<String>::new());
    std::fs::remove_dir_all(folder).unwrap();
}
