//! `doctor --accept` on logs, on a scene and on nothing; what it writes; and that the commands it advises are commands.

use crate::air::Program;
use crate::cards::{PAIR, simulated};
use crate::commands::{Folder, json};
use csi5300_accept::CLAIMS;

/// A scene of 15 s whose first robot's card has a fault, or none.
fn scene(fault: &str) -> String {
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/lab-circle.toml")).unwrap();
    let healthy = "faults = { loss = 0.0018, killed = true }";
    assert!(text.contains(healthy));
    text.replace(healthy, fault)
}

#[test]
fn a_scene_is_judged_and_the_report_is_written() {
    let folder = Folder::new("accept");
    folder.write("broken.toml", scene("faults = { card = [\"clock_steps\"] }").as_bytes());
    let (out, _) = folder.says(&["doctor", "--accept", "broken.toml", "--report", "desk"], 1, &[]);
    assert!(out.starts_with("backend: simulated room"));
    assert!(out.contains("FAILS      card.clock") && out.contains("next: "), "{out}");
    let report = json(&std::fs::read_to_string(folder.0.join("desk/report.json")).unwrap());
    let findings = report["findings"].as_array().unwrap();
    assert!(findings.iter().any(|finding| finding["id"] == "card.clock" && finding["verdict"] == "fails"));
    for name in ["report.html", "report.xml", "report.json", "bench-log.md"] {
        let text = std::fs::read_to_string(folder.0.join("desk").join(name)).unwrap();
        assert!(text.contains("card.clock"), "{name}");
        // Neither a MAC address nor a path of this machine.
        assert!(!text.contains("02:53:00") && !text.contains(folder.0.to_str().unwrap()), "{name}");
    }
    // The logs beside it are judged alike, by the same claims.
    folder.write("desk.toml", b"near = \"desk/near.dat\"\nfar = \"desk/far.dat\"\nchannel = \"108\"\n");
    let (out, _) = folder.says(&["doctor", "--accept", "desk.toml"], 1, &[]);
    assert!(out.contains("FAILS      card.clock") && out.contains("recorder.same"), "{out}");
    // Logs after a retune are compared with those before it; these are copies of them, of a robot that moved.
    for name in ["near", "far"] {
        let [from, to] = ["", "2"].map(|end| folder.0.join(format!("desk/{name}{end}.dat")));
        std::fs::copy(from, to).unwrap();
    }
    let more = "near = \"desk/near.dat\"\nfar = \"desk/far.dat\"\nchannel = \"108\"\nat_rest = true\nretuned = [[\"desk/near2.dat\", \"desk/far2.dat\"]]\n";
    folder.write("retuned.toml", more.as_bytes());
    let (_, out, err) = folder.run(&["doctor", "--accept", "retuned.toml", "-v"]);
    assert!(out.contains("logs after it: 1; the largest step is that of round trip: +0 degrees"), "{out}{err}");
    let (out, _) = folder.says(&["doctor", "--accept", "desk/far.dat", "--channel", "108", "--json"], 0, &[]);
    let report = json(&out);
    assert_eq!(report["logs"][0]["records"], 2998);
    // Logs in a report's folder are those of the last run, or said to be older; other folders' logs stay.
    let again = |report: &'static str| ["doctor", "--accept", "desk/near2.dat", "--channel", "108", "--report", report];
    let (_, _, err) = folder.run(&again("desk"));
    assert!(err.contains("desk/far.dat is of an earlier run") && !err.contains("near.dat is"), "{err}");
    std::fs::create_dir(folder.0.join("own")).unwrap();
    let own = folder.write("own/near.dat", b"a recording");
    folder.says(&again("own"), 1, &["own/near.dat exists, and no report beside it"]);
    assert_eq!(std::fs::read(own).unwrap(), b"a recording");
}

#[test]
fn a_report_whose_reader_is_gone_is_no_panic() {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_csi5300"));
    let output = command.args(["doctor", "--accept", "lab-circle", "--json"]).stdout(writer).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() != Some(101) && !said.contains("panicked"), "{:?}: {said}", output.status);
}

/// Judges two logs; gives the verdict of each claim about both, by its id.
fn of_link(folder: &Folder, near: &str, far: &str) -> std::collections::BTreeMap<String, String> {
    let (_, out, err) = folder.run(&["doctor", "--accept", near, far, "--channel", "108", "--json"]);
    let report: serde_json::Value = serde_json::from_str(&out).unwrap_or_else(|_| panic!("{err}"));
    let words = |value: &serde_json::Value| value.as_str().unwrap().to_owned();
    let links = report["findings"].as_array().unwrap().iter().filter(|finding| finding["of"] == "link");
    links.map(|finding| (words(&finding["id"]), words(&finding["verdict"]))).collect()
}

#[test]
fn logs_without_numbers_are_judged_by_the_clocks_of_their_cards() {
    let folder = Folder::new("accept-clocks");
    // Both stand still.
    let room = PAIR.replace("motion.circle = { radius_m = 0.25, duration_s = 12.0 }\n", "");
    let [near, far, _] = simulated(&folder, "room", &format!("seed = 3\n{room}"), "csi_");
    let found = of_link(&folder, &near, &far);
    for id in ["exchange.pairs", "exchange.turn_around", "exchange.drift", "phase.cancels", "phase.sign"] {
        assert_eq!(found[id], "holds", "{id} {found:?}");
    }

    let Some(cases) = crate::common::cases("wsr-2021") else { return };
    let log = |name: &str| cases.join("floor").join(name).to_str().unwrap().to_owned();
    let [first, second] = ["154746", "155046"]
        .map(|time| ["csi_rx", "csi_tx1"].map(|name| log(&format!("{name}_2021-03-04_{time}.dat"))));
    for [near, far] in [&first, &second] {
        let found = of_link(&folder, near, far);
        for id in ["exchange.pairs", "exchange.turn_around", "exchange.late", "phase.cancels", "phase.sign"] {
            assert_eq!(found[id], "holds", "{id} {found:?}");
        }
    }
    let found = of_link(&folder, &first[0], &second[1]);
    assert!(found.values().all(|verdict| verdict == "not_tried"), "{found:?}");
}

#[test]
fn the_host_times_beside_a_stock_log_are_used_and_stay_beside_it() {
    let folder = Folder::new("accept-beside");
    let room = format!("seed = 3\n{}", PAIR.replace("card = \"ax210\"\n", ""));
    let [near, far, path] = simulated(&folder, "room", &room, "rx_trajectory_");
    for (log, stock) in [(&near, "near.dat"), (&far, "far.dat")] {
        folder.says(&["export", "--dat", log, stock, "--layout", "stock"], 0, &[]);
    }
    // 25 cm to the left of where it began is the circle's middle.
    let azimuth_deg = (9.0_f64 - 0.25).atan2(-4.0).to_degrees();
    let desk = |logs: &str| {
        format!(
            "channel = \"108\"\nnear = \"{logs}near.dat\"\nfar = \"{logs}far.dat\"\n\
             trajectory = \"{path}\"\nazimuth_deg = {azimuth_deg}\n"
        )
    };
    for (name, logs, report) in [("first.toml", "", "one"), ("again.toml", "one/", "two")] {
        folder.write(name, desk(logs).as_bytes());
        let (out, _) = folder.says(&["doctor", "--accept", name, "--report", report, "-v"], 0, &[]);
        for claim in ["host.clock             both", "truth.bearing          link"] {
            assert!(out.contains(&format!("holds      {claim}")), "{claim}: {out}");
        }
    }
}

#[test]
fn a_robot_that_sends_and_one_that_assists_are_judged_together() {
    let folder = Folder::new("accept-together");
    let robot = |name: &str, more: &str| format!("[[robot]]\nname = \"{name}\"\nposition_m = {more}\n");
    let (near, far) =
        (robot("near", "[0.0, 0.0, 0.0]"), robot("far", "[2.0, 1.0, 0.0]\nfaults.card = [\"legacy_rate\"]"));
    folder.write("scene.toml", format!("duration_s = 600.0\nchannel = 108\n{near}{far}").as_bytes());
    let path = |name: &str| folder.0.join(name).to_str().unwrap().to_owned();
    let mut room = Program::start(&["simulate", &path("scene.toml"), "--serve", "--socket", &path("room")]);
    room.until("serving the room at");
    let desk = |name: &str, more: &str| {
        let text = format!("channel = \"108\"\nroom = \"{}#{name}\"\n{more}", path("room"));
        folder.write(&format!("{name}.toml"), text.as_bytes());
    };
    desk("far", "assist = \"127.0.0.1:0\"\nanswer = true\n");
    let assisting = || {
        let mut assist = Program::start(&["doctor", "--accept", &path("far.toml")]);
        assist.until("for the first robot");
        let address = assist.said.split("waiting at ").nth(1).unwrap().split(' ').next().unwrap().to_owned();
        (assist, address)
    };
    // Of another channel it is refused, in words on both sides.
    let (assist, address) = assisting();
    desk("near", &format!("peer = \"{address}\"\n"));
    let (status, _, err) = folder.run(&["doctor", "--accept", "near.toml", "--channel", "64"]);
    assert!(status != 0 && err.contains("on channel 64, the second on 108"), "{err}");
    assert!(assist.end().1.contains("on channel 64, the second on 108"));

    let (assist, address) = assisting();
    desk("near", &format!("send = true\npeer = \"{address}\"\n"));
    let (status, out, err) = folder.run(&["doctor", "--accept", "near.toml", "--json"]);
    assert!(err.contains("send frames at 20, 50, 200 and 1,000 a second (17 s)"), "{err}");
    let (assisted, said) = assist.end();
    assert!(assisted == Some(0) && said.contains("bytes of log went to the first robot"), "{said}");
    let report = json(&out);
    let verdict = |id: &str, of: &str| {
        let findings = report["findings"].as_array().unwrap();
        findings.iter().find(|finding| finding["id"] == id && finding["of"] == of).unwrap()["verdict"].clone()
    };
    // How punctual a busy machine is, is nobody's question here.
    assert_eq!(
        (status, verdict("reception.rate", "far"), verdict("reception.rate", "near")),
        (1, "fails".into(), "holds".into())
    );
    assert_eq!(verdict("injection.numbers", "link"), "holds", "{out}");
    let arrived = ["injection.heard", "injection.confirmed"].map(|id| verdict(id, "link"));
    assert_ne!(verdict("exchange.pairs", "link"), "not_tried");
    assert_eq!(verdict("injection.channel", "link"), "not_tried");

    // Nobody is asked where nobody sits.
    desk("near", "unplug = [\"B\"]\n");
    let (_, out, err) = folder.run(&["doctor", "--accept", "near.toml", "--listen", "100ms"]);
    assert!(err.contains("no terminal") && out.contains("reception.unplugged"), "{out}{err}");

    // Somebody sits at this one, stops it when asked for the first antenna, and goes on with it; then does so at the second antenna.
    desk("near", "unplug = [\"B\", \"C\"]\n");
    let terminal = nix::pty::openpty(None, None).unwrap();
    let asked = |enter: &[&str], stop_at: &str| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_csi5300"));
        command.args(["doctor", "--accept", &path("near.toml"), "--listen", "100ms", "-v", "--report", &path("desk")]);
        command.stdin(terminal.slave.try_clone().unwrap());
        let mut asking = Program::of(command.stdout(std::process::Stdio::piped()));
        for antenna in enter {
            asking.until(&format!("\nunplug antenna {antenna} of this robot"));
            nix::unistd::write(&terminal.master, b"\n").unwrap();
        }
        asking.until(&format!("\nunplug antenna {stop_at} of this robot"));
        asking.signal(nix::sys::signal::Signal::SIGINT);
        asking.until("\nstopped before: ");
        asking.until("\nthe report is in");
        (asking.output(), asking.end().1)
    };
    let (out, said) = asked(&[], "B");
    assert!(out.contains("stopped: 1 of 3 parts are finished") && !said.contains("going on"), "{out}{said}");
    let (out, said) = asked(&["B"], "C");
    assert!(said.contains("continuing the interrupted run: listen"), "{said}");
    assert!(out.contains("stopped: 2 of 3") && out.contains("0 records came without antenna B"), "{out}");
    let (out, said) = asked(&[], "C");
    assert!(said.contains("listen while another robot sounds, then you unplug antenna B taken from"), "{said}");
    assert!(out.contains("stopped: 2 of 3") && out.contains("0 records came without antenna B"), "{out}");
    room.stop();
    let (_, served) = room.end();
    // What a busy machine reads too late is lost, and the room says so.
    assert!(arrived == ["holds", "holds"] || served.contains(" messages were lost"), "{arrived:?} {served}");
}

#[test]
fn what_cannot_be_judged_is_refused() {
    let folder = Folder::new("accept-refused");
    let refused = |words: &[&str], said: &str| {
        let (status, _, err) = folder.run(&[&["doctor"], words].concat());
        assert!(status != 0 && err.contains(said), "{words:?}, {said}: {status} {err}");
    };
    for (desk, said) in [
        ("near = \"no.dat\"\nchannel = \"108\"\n", "no.dat"),
        ("neer = \"no.dat\"\n", "neer"),
        ("channel = \"108\"\nassist = \"127.0.0.1:0\"\nsend = true\n", "for the second robot"),
        ("channel = \"108\"\nassist = \"127.0.0.1:0\"\ninterface = \"nowhere0\"\n", "there is no interface nowhere0"),
        ("channel = \"108\"\nsend = true\n", "interface = \"mon0\""),
        ("channel = \"108\"\nfar = \"no.dat\"\n", "`far` needs `near`"),
        ("channel = \"108\"\nnear = \"no.dat\"\nroom = \"a#rx\"\n", "judged by that log"),
        ("channel = \"108\"\nroom = \"a#rx\"\ninterface = \"mon0\"\n", "takes the place of a card"),
        ("channel = \"108\"\nnear = \"a.dat\"\nretuned = [[\"a.dat\"]]\n", "a.dat is given twice"),
        ("channel = \"108\"\nunplug = [\"D\"]\n", "\"D\""),
        ("channel = \"108\"\npeer = \"127.0.0.1:1\"\n", "cannot reach the second robot"),
    ] {
        folder.write("desk.toml", desk.as_bytes());
        refused(&["--accept", "desk.toml"], said);
    }
    folder.write("far.toml", b"channel = \"108\"\nassist = \"127.0.0.1:0\"\n");
    refused(&["--accept", "far.toml", "--report", "desk"], "the second robot hands its log to the first");
    refused(&["--accept", "nowhere"], "no built-in scene");
    refused(&["--accept", "a.dat", "a.dat", "--channel", "108"], "a.dat is given twice");
    refused(&["--accept", "lab-circle", "--channel", "108"], "a scene has its own channel");
    folder.write("a.dat", b"");
    for what in [&["lab-circle"][..], &["a.dat", "--channel", "108"]] {
        refused(&[&["--accept"], what, &["--listen", "1s"]].concat(), "not for logs or a scene");
    }
    refused(&["--connector-index", "9"], "--listen or --accept");
    refused(&["--report", "desk"], "--accept");
    refused(&["a", "b"], "--accept");
}

#[test]
fn every_command_that_a_claim_advises_is_one() {
    let folder = Folder::new("accept-advice");
    let mut seen = 0;
    for claim in &CLAIMS {
        for command in claim.next.split('`').skip(1).step_by(2).filter(|command| command.starts_with("csi5300 ")) {
            // Taken as far as its help: names stand for files.
            let mut words: Vec<&str> =
                command.split(' ').skip(1).map(|word| if word == "N" { "64" } else { word }).collect();
            words.push("--help");
            folder.says(&words, 0, &[]);
            for option in words.iter().filter(|word| word.starts_with("--") && **word != "--help") {
                let (_, help, _) = folder.run(&[words[0], "--help"]);
                assert!(help.contains(option), "{}: {command}: no {option}", claim.id);
            }
            seen += 1;
        }
    }
    assert!(seen > 20, "{seen}");
}

#[test]
fn what_the_notes_do_not_know_names_the_claim_that_settles_it() {
    let notes = concat!(env!("CARGO_MANIFEST_DIR"), "/../../firmware-notes");
    let mut open = 0;
    for file in std::fs::read_dir(notes).unwrap().flatten().map(|entry| entry.path()).filter(|path| path.is_file()) {
        let text = std::fs::read_to_string(&file).unwrap();
        for mark in text.split("[unknown").skip(1) {
            let name = mark.strip_prefix(": ").and_then(|rest| rest.split(']').next()).unwrap_or("");
            let is_named = name == "by hand" || name == "CLAIM" || CLAIMS.iter().any(|claim| claim.id == name);
            let is_of_the_log = file.ends_with("bench-log.md");
            assert!(
                is_named || is_of_the_log,
                "{}: [unknown{}",
                file.display(),
                mark.chars().take(30).collect::<String>()
            );
            open += 1;
        }
    }
    assert!(open >= 11, "{open}");
}
