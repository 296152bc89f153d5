use super::*;
use std::collections::BTreeMap;
use std::path::PathBuf;

const ROOM: &str = "channel = \"108\"\ncapture.room = { scene = \"lab-circle\", robot = \"rx\" }\nodometry.room = {}\n\
                    [[peer]]\nname = \"tx\"\nrecords.room = {}\n";

fn refused(text: &str) -> String {
    Config::read(text, Path::new("")).unwrap_err().to_string()
}

#[test]
fn a_simulated_room_is_a_few_lines() {
    let config = Config::read(ROOM, Path::new("/nowhere")).unwrap();
    assert_eq!(
        config.capture.get_ref(),
        &Capture::Room(Room { scene: "lab-circle".into(), robot: "rx".into(), speed: 1.0, follow: BTreeMap::new() })
    );
    assert_eq!(config.estimator, Estimation::default());
    assert_eq!(config.peer[0].get_ref().poses, Odometry::Static(Place::default()));
}

#[test]
fn a_channel_is_text_or_a_number() {
    let of = |text: &str| {
        Config::read(&ROOM.replace("\"108\"", text), Path::new("")).map(|config| config.channel.to_string())
    };
    assert_eq!(of("36").unwrap(), "36");
    assert_eq!(of("\"36+\"").unwrap(), "36+");
    assert!(refused(&ROOM.replace("\"108\"", "109")).contains("`109` is no channel"));
}

#[test]
fn a_served_room_is_configured_in_a_few_lines() {
    let served = ROOM.replace("capture.room = { scene = \"lab-circle\"", "capture.served = { socket = \"s\"");
    let config = Config::read(&served, Path::new("/f")).unwrap();
    let expected = Served { socket: "/f/s".into(), robot: "rx".into() };
    assert_eq!(config.capture.get_ref(), &Capture::Served(expected));
}

#[test]
fn all_paths_are_relative_to_the_file() {
    let more = "[log]\nfile = \"l.dat\"\n[output]\nbearings = \"b\"\nstatus_socket = \"s\"\n";
    let folder = std::env::temp_dir().join(format!("csi5300-config-paths-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let there = |name: &str| folder.join(name);
    let config = Config::read(&format!("{ROOM}{more}"), &folder).unwrap();
    assert_eq!(config.log.unwrap().file, there("l.dat"));
    assert_eq!((Path::new(&config.output.bearings), config.output.status_socket), (&*there("b"), Some(there("s"))));
    std::fs::remove_dir_all(&folder).unwrap();
    for told in ["-", ""] {
        let text = format!("{ROOM}[output]\nbearings = \"{told}\"\n");
        assert_eq!(Config::read(&text, Path::new("/f")).unwrap().output.bearings, told);
    }
    let zenoh = refused(&format!("{ROOM}[network]\nzenoh = \"nowhere.json5\"\n"));
    let here = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    let there = Config::read(&format!("{ROOM}[network]\nzenoh = \"Cargo.toml\"\n"), here);
    let words = there.map_or_else(|error| error.to_string(), |_| String::new());
    assert!(!words.contains("no such file") && zenoh.contains("zenoh"), "{words}");
}

#[test]
fn every_problem_has_its_line() {
    assert_eq!(refused(&ROOM.replace("108", "999")).split(':').next(), Some("line 1"));
    let unknown = refused(&format!("{ROOM}colour = 3\n"));
    assert!(unknown.starts_with("line 7") && unknown.contains("colour"), "{unknown}");
    let negative = refused(&format!("{ROOM}[estimator]\nwindow_m = -3.0\n"));
    assert!(negative.starts_with("line 8") && negative.contains("above 0"), "{negative}");
    let typo = refused(&ROOM.replace("records.room", "records.rom"));
    assert!(typo.starts_with("line 6"), "{typo}");
    let two = refused(&ROOM.replace("capture.room = { scene = \"lab-circle\", robot = \"rx\" }", "capture.card = {}"));
    let lines: Vec<&str> = two.lines().collect();
    assert!(lines.len() == 3 && lines[0].starts_with("line 2: `mac`"), "{two}");
    assert!(lines[1].starts_with("line 3:") && lines[2].starts_with("line 6: peer `tx`"), "{two}");
    let twice = refused(&format!("{ROOM}[[peer]]\nname = \"tx\"\nrecords.room = {{}}\n"));
    assert!(twice.starts_with("line 8: peer `tx`: another peer"), "{twice}");
    // Beside what nobody knows in a capture, the rest of the file is checked as well.
    let both = refused(
        &ROOM.replace("robot = \"rx\"", "robot = \"rx\", colour = 3").replace("name = \"tx\"", "name = \"ty\""),
    );
    assert!(both.contains("colour") && both.contains("the scene has no robot `ty`"), "{both}");
    let nobody = refused(&ROOM.replace("name = \"tx\"", "name = \"ty\""));
    assert!(nobody.starts_with("line 5: the scene has no robot `ty`: it has rx, tx"), "{nobody}");
    let nowhere = refused(&ROOM.replace("lab-circle", "lab.toml"));
    assert!(nowhere.starts_with("line 2:") && nowhere.contains("lab.toml"), "{nowhere}");
    let room = |more: &str| refused(&format!("{ROOM}{more}"));
    let short = room("[estimator]\nwindow_m = 0.05\n");
    assert!(short.starts_with("line 8: window_m (0.050 m)"), "{short}");
    for rate in ["1e9", "1e-9"] {
        let absurd = room(&format!("[estimator]\nrate_hz = {rate}\n"));
        assert!(absurd.starts_with("line 8: rate_hz"), "{absurd}");
    }
    let still = refused(&ROOM.replace("odometry.room = {}", ""));
    assert!(still.starts_with("line 4: no robot here ever moves"), "{still}");
    let live = refused(&ROOM.replace("odometry.room = {}", "odometry.opencr.port = \"/dev/null\""));
    assert!(live.starts_with("line 3: `opencr` poses"), "{live}");
    for (wrong, line) in
        [("yaw_deg = nan", "line 7: peer `tx`"), ("antenna_offset_m = [inf, 0, 0]", "line 7: peer `tx`")]
    {
        let endless = room(&format!("{wrong}\n"));
        assert!(endless.starts_with(line) && endless.contains("finite"), "{endless}");
    }
    let other = room("mac = \"02:00:00:00:00:99\"\n");
    assert!(other.starts_with("line 7: `tx` has the MAC"), "{other}");
    let own = refused(&format!("mac = \"02:00:00:00:00:99\"\n{ROOM}"));
    assert!(own.starts_with("line 1: `rx` has the MAC"), "{own}");
    let full = room("[network]\nbacklog = 0\n");
    assert!(full.contains("line 8: backlog"), "{full}");
    let air = room("[sounding]\ninterface = \"mon0\"\n");
    assert!(air.starts_with("line 7: [sounding] is done with a card"), "{air}");
    let card = "mac = \"02:00:00:00:00:01\"\nchannel = \"108\"\ncapture.card = {}\nodometry.opencr.port = \"/dev/null\"\n\
                [network]\n[[peer]]\nname = \"b\"\nmac = \"02:00:00:00:00:02\"\nrecords.network = {}\n\
                [sounding]\ninterface = \"mon0\"\n";
    let fast = refused(&format!("{card}rate_hz = 1e5\n"));
    assert!(fast.contains("line 12: [sounding]") && fast.contains("rounds"), "{fast}");
    let far = refused(&format!("{ROOM}[estimator]\nextrapolate_s = 30\n"));
    assert!(far.starts_with("line 8"), "{far}");
}

/// A scene whose robot `a` is followed, in a folder of its own.
fn followed(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("csi5300-config-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let scene = "duration_s = 9\n[[robot]]\nname = \"a\"\nmotion.followed = {}\n[[robot]]\nname = \"b\"\nposition_m = [4, 0, 0]\n";
    std::fs::write(folder.join("scene.toml"), scene).unwrap();
    folder
}

#[test]
fn robots_of_a_room_follow_what_there_is() {
    let folder = followed("follow");
    let read = |follow: &str| {
        let room = format!("capture.room = {{ scene = \"scene.toml\", robot = \"a\"{follow} }}");
        let text = ROOM.replace("capture.room = { scene = \"lab-circle\", robot = \"rx\" }", &room).replace("tx", "b");
        Config::read(&text, &folder).map_err(|error| error.to_string())
    };
    let alone = read("").unwrap_err();
    assert!(alone.starts_with("line 2: robot `a` of the scene follows nothing"), "{alone}");
    std::fs::write(folder.join("way.csv"), "0,0,0,0,0\n").unwrap();
    let config = read(", follow.a.csv.file = \"way.csv\"").unwrap();
    assert!(!ros::is_used(&config));
    for (follow, why) in [
        (", follow = { a.csv.file = \"no.csv\" }", "no trajectory"),
        (", follow = { a.csv.file = \"way.csv\", c.csv.file = \"way.csv\" }", "no robot `c`"),
        (", follow = { a.csv.file = \"way.csv\", b.csv.file = \"way.csv\" }", "`b` moves as the scene says"),
        (", follow = { a.room = {} }", "`ros` or `csv`"),
    ] {
        let refused = read(follow).unwrap_err();
        assert!(refused.starts_with("line 2: ") && refused.contains(why), "{refused}");
    }
    let topic = read(", follow = { a.ros.topic = \"/a/odom\" }");
    assert!(ros::is_used(&topic.unwrap()));
    for (follow, why) in [
        (", follow = { a.ros.topic = \"odom\" }", "not a valid ROS name"),
        (", speed = 2.0, follow = { a.ros.topic = \"/odom\" }", "are live"),
        (", follow = { a.ros = { topic = \"/odom\", stamp = \"header\" } }", "times of arrival"),
    ] {
        let refused = read(follow).unwrap_err();
        assert!(refused.starts_with("line 2: ") && refused.contains(why), "{refused}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_node_of_ros_is_checked_like_everything_else() {
    let card = "mac = \"00:21:6a:00:00:01\"\nchannel = \"108\"\ncapture.card = {}\nodometry.ros.topic = \"/odom\"\n\
                [ros]\nmaster = \"http://10.0.0.1:11311/\"\n[log]\nfile = \"x.dat\"\n";
    let read = |text: &str| Config::read(text, &std::env::temp_dir()).map_err(|error| error.to_string());
    let in_room = refused(&ROOM.replace("odometry.room = {}", "odometry.ros.topic = \"/odom\""));
    assert!(in_room.starts_with("line 3: `ros` poses are live"), "{in_room}");
    let config = read(card).unwrap();
    assert!(ros::is_used(&config));
    let ros = config.ros.clone().unwrap();
    assert_eq!(
        (ros.master().as_str(), ros.node(&config).as_str()),
        ("http://10.0.0.1:11311", "/csi5300_00_21_6a_00_00_01")
    );
    for (from, to, why) in [
        ("http://", "", "line 6: master"),
        ("master", "node = \"a b\"\nmaster", "line 6: `a b` is not a valid ROS name"),
        ("\"/odom\"", "\"/odom/\"", "line 4: `/odom/` is not a valid ROS name"),
        ("odometry.ros.topic = \"/odom\"", "odometry.ros = { topic = \"/odom\", type = \"imu\" }", "line 4: "),
        ("odometry.ros.topic = \"/odom\"", "odometry.ros = { topic = \"/odom\", stamp = \"now\" }", "line 4: "),
    ] {
        let refused = read(&card.replace(from, to)).unwrap_err();
        assert!(refused.starts_with(why), "{refused}");
    }
    let peer = "[[peer]]\nname = \"b\"\nmac = \"00:21:6a:00:00:02\"\nrecords.network = {}\n\
                poses.ros = { topic = \"/b/odom\", stamp = \"receipt\" }\n";
    let refused = read(&format!("{card}{peer}")).unwrap_err();
    assert!(refused.contains("line 13: peer `b`: a peer's poses have the times of its own clock"), "{refused}");
}

#[test]
fn the_example_for_simulators_is_good() {
    let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).join("examples/ros/robot.toml");
    Config::load(&file).unwrap();
}

#[test]
fn error_bars_hold_the_heading_of_the_odometry() {
    let config = |text: &str| Config::read(text, Path::new("")).unwrap();
    assert_eq!(config(ROOM).options().heading_sd_rad, Some(0.0));
    let own = config(&format!("{ROOM}[estimator]\nheading_sd_deg = 3.0\n")).options().heading_sd_rad;
    assert!((own.unwrap() - 3f64.to_radians()).abs() < 1e-12, "{own:?}");
    let of = |change: &dyn Fn(&mut Config)| {
        let mut changed = config(ROOM);
        change(&mut changed);
        changed.heading_sd_deg()
    };
    let wheels = of(&|config| {
        config.odometry = Odometry::Opencr(OpenCr { port: "/dev/null".into(), model: None, rate_hz: 100.0 });
    });
    let camera = of(&|config| {
        config.camera_mount = Some(CameraMount { forward_m: 0.0, left_m: 0.0, yaw_deg: 0.0 });
    });
    assert!(0.0 < wheels && wheels < camera && camera < 5.0, "{wheels} {camera}");
}

/// Lines of all refusals of a text.
fn refused_lines(text: &str) -> Vec<String> {
    refused(text).lines().map(str::to_owned).collect()
}

#[test]
fn one_wrong_value_does_not_hide_the_others() {
    let text = "channel = 108.5\nantenna = \"D\"\nmac = \"02:00:00:00:00:01\"\ncapture.card = {}\n[estimator]\nwindow = 3\n\
                window_m = \"three\"\n[log]\nfile = \"no/folder/x.dat\"\n[output]\nbearings = \"no/folder/b.jsonl\"\n\
                status_socket = \"no/folder/s\"\n";
    let all = refused_lines(text);
    let found: Vec<(&str, bool)> = [
        (0, "line 1: ", "a channel: \"108\""),
        (1, "line 2: ", "antenna `D`: A, B or C"),
        (2, "line 6: ", "unknown field `window`"),
        (3, "line 7: ", "\"three\""),
        (4, "line 9: ", "there is no folder no/folder"),
        (5, "line 11: ", "there is no folder no/folder"),
        (6, "line 12: ", "there is no folder no/folder"),
    ]
    .map(|(k, line, why)| (line, all.get(k).is_some_and(|said| said.starts_with(line) && said.contains(why))))
    .to_vec();
    assert!(all.len() == 7 && found.iter().all(|found| found.1), "{found:?}\n{all:#?}");
}

#[test]
fn a_misspelt_key_is_suggested_and_a_bare_file_name_works() {
    let all = refused_lines(&ROOM.replace("odometry.room", "odometry.rooom"));
    assert!(all[0].ends_with("; did you mean `room`?"), "{all:#?}");
    let all = refused_lines(&format!("{ROOM}[estimator]\nleast_moton_m = 0.2\nfoo = 1\n"));
    assert!(all[0].ends_with("; did you mean `least_motion_m`?") && !all[1].contains("did you mean"), "{all:#?}");
    let csv = |text: &str| {
        toml::from_str::<std::collections::BTreeMap<String, super::Csv>>(text).map(|map| map["csv"].file.clone())
    };
    assert_eq!(csv("csv = \"x.csv\"").unwrap(), csv("csv = { file = \"x.csv\" }").unwrap());
    assert!(csv("csv = { fil = \"x.csv\" }").is_err() && csv("csv = 3").is_err());
}

#[test]
fn a_wrong_key_is_not_also_reported_as_missing() {
    let peers = "[[peer]]\nname = 3\nrecords.rom = {}\n[[peer]]\nname = \"tx\"\nrecords.room = {}\nfoo = 1\n";
    let all = refused_lines(&ROOM.replace("[[peer]]\nname = \"tx\"\nrecords.room = {}\n", peers));
    assert_eq!(all.len(), 3, "{all:#?}");
    assert!(all[0].starts_with("line 5: ") && all[1].starts_with("line 6: unknown variant `rom`"), "{all:#?}");
    assert!(all[2].starts_with("line 10: unknown field `foo`"), "{all:#?}");
    let nothing = refused_lines("antenna = \"A\"\n[output]\nbearing = \"x\"\n");
    assert!(nothing.len() == 3 && nothing[0].contains("missing field `channel`"), "{nothing:#?}");
    assert!(nothing[1].contains("missing field `capture`") && nothing[2].starts_with("line 3: "), "{nothing:#?}");
    // Text that is no TOML is refused as such, each place of it.
    let broken = refused_lines("[a\ny = 3\nz = [1,,2]\n");
    assert!(broken.len() == 2 && broken[0].starts_with("line 1: ") && broken[1].starts_with("line 3: "), "{broken:#?}");
}

#[test]
fn an_unknown_scene_is_named_once_with_the_known_ones() {
    let nowhere = refused(&ROOM.replace("lab-circle", "nosuch"));
    let words =
        "line 2: there is no file nosuch, and no built-in scene of that name: paper-circle, paper-line, lab-circle";
    assert!(nowhere.starts_with(words), "{nowhere}");
}

#[test]
fn another_kind_of_file_is_one_problem_and_syntax_errors_are_few() {
    let other = refused("root:x:0:0:root\nbin:x:1:1:bin\nsys:x:2:2:sys\n");
    assert!(other.lines().count() == 1 && other.contains("no configuration in TOML"), "{other}");
    let broken: String = (0..20).map(|k| format!("a b {k}\n")).collect();
    let many = refused(&format!("{ROOM}{broken}"));
    assert!(many.lines().count() <= FEW_LINES && many.contains("further syntax errors"), "{many}");
}

/// Most lines that syntax errors take.
const FEW_LINES: usize = 5;
