use super::*;

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
        &Capture::Room(Room { scene: "lab-circle".into(), robot: "rx".into(), speed: 1.0 })
    );
    assert_eq!(config.estimator, Estimation::default());
    assert_eq!(config.peer[0].get_ref().poses, Odometry::Static(Place::default()));
}

#[test]
fn all_paths_are_relative_to_the_file() {
    let more = "[log]\nfile = \"l.dat\"\n[output]\nbearings = \"b\"\nstatus_socket = \"s\"\n";
    let config = Config::read(&format!("{ROOM}{more}"), Path::new("/f")).unwrap();
    assert_eq!(config.log.unwrap().file, Path::new("/f/l.dat"));
    assert_eq!((config.output.bearings.as_str(), config.output.status_socket), ("/f/b", Some("/f/s".into())));
    for told in ["-", ""] {
        let text = format!("{ROOM}[output]\nbearings = \"{told}\"\n");
        assert_eq!(Config::read(&text, Path::new("/f")).unwrap().output.bearings, told);
    }
    let zenoh = refused(&format!("{ROOM}[network]\nzenoh = \"nowhere.json5\"\n"));
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
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
    let two =
        refused(&ROOM.replace("capture.room = { scene = \"lab-circle\", robot = \"rx\" }", "capture.card = {}"));
    let lines: Vec<&str> = two.lines().collect();
    assert!(lines.len() == 3 && lines[0].starts_with("line 2: `mac`"), "{two}");
    assert!(lines[1].starts_with("line 3:") && lines[2].starts_with("line 4: peer `tx`"), "{two}");
    let twice = refused(&format!("{ROOM}[[peer]]\nname = \"tx\"\nrecords.room = {{}}\n"));
    assert!(twice.starts_with("line 7: peer `tx`: another peer"), "{twice}");
    let nobody = refused(&ROOM.replace("name = \"tx\"", "name = \"ty\""));
    assert!(nobody.starts_with("line 4: the scene has no robot `ty`: it has rx, tx"), "{nobody}");
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
        [("yaw_deg = nan", "line 4: peer `tx`"), ("antenna_offset_m = [inf, 0, 0]", "line 4: peer `tx`")]
    {
        let endless = room(&format!("{wrong}\n"));
        assert!(endless.starts_with(line) && endless.contains("finite"), "{endless}");
    }
    let other = room("mac = \"02:00:00:00:00:99\"\n");
    assert!(other.starts_with("line 4: `tx` has the MAC"), "{other}");
    let own = refused(&format!("mac = \"02:00:00:00:00:99\"\n{ROOM}"));
    assert!(own.starts_with("line 1: `rx` has the MAC"), "{own}");
    let full = room("[network]\nbacklog = 0\n");
    assert!(full.contains("line 8: backlog"), "{full}");
    let far = refused(&format!("{ROOM}[estimator]\nextrapolate_s = 30\n"));
    assert!(far.starts_with("line 8"), "{far}");
}
