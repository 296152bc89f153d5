//! What every command has: how much it says, in which colours, how it ends, and what it says of the wrong file.

use super::commands::{Folder, json};
use crate::common::link;

#[test]
fn quiet_says_results_and_errors_and_verbose_what_was_read() {
    let folder = Folder::new("quiet");
    let mut damaged = link(300, 2.0);
    damaged.rx[100].remove(7);
    folder.link(&damaged);
    let (status, usual_out, usual) = folder.bearing(&[]);
    assert!(status == 3 && usual.contains("lost:"), "{usual}");
    let (status, out, err) = folder.bearing(&["--quiet"]);
    assert_eq!((status, out, err.as_str()), (3, usual_out.clone(), ""));
    let (_, out, err) = folder.bearing(&["-v"]);
    assert!(out.starts_with(&usual_out) && out.contains("coherence, 0 to 1") && out.contains("CFO"), "{out}");
    for words in ["lost:", "reading rx.dat", "reading tx.dat", "reading t.csv: ", " s, ", " MB of memory"] {
        assert!(err.contains(words), "no `{words}` in {err}");
    }
    // Errors are printed even so.
    let (status, _, err) = folder.run(&["-q", "info", "none.dat"]);
    assert!(status == 1 && err.contains("none.dat"), "{err}");
    assert_eq!(folder.run(&["info", "rx.dat", "-q", "-v"]).0, 2);
}

#[test]
fn colours_are_for_terminals_and_for_who_asks() {
    let folder = Folder::new("colours");
    std::fs::create_dir_all(folder.0.join("machine")).unwrap();
    let doctor = |more: &[&str]| folder.run(&[&["doctor", "machine"][..], more].concat()).1;
    assert!(!doctor(&[]).contains('\x1b'));
    assert!(!doctor(&["--color", "never"]).contains('\x1b'));
    let coloured = doctor(&["--color", "always"]);
    assert!(coloured.contains("\x1b[1;31mBAD \x1b[0m"), "{coloured}");
    assert!(!folder.run(&["info", "none.dat"]).2.contains('\x1b'));
    let (_, _, err) = folder.run(&["--color", "always", "info", "none.dat"]);
    assert!(err.starts_with("\x1b[1;31mcsi5300:\x1b[0m "), "{err}");
}

#[test]
fn a_name_is_shown_and_commands_no_terminal() {
    let folder = Folder::new("terminal");
    let name = "here\x1b[2J\x1b]0;mine\x07\u{9b}7m";
    super::commands::capture(&folder, &format!("tree/{name}"), &link(300, 2.0));
    folder.write(&format!("{name}.dat"), b"none");
    let shown = r"here\u001b[2J\u001b]0;mine\u0007\u009b7m";
    let log = format!("{name}.dat");
    let bearing = vec!["-v", "bearing", "--channel", "108", "--rx", &log, "--tx", &log, "--trajectory", &log];
    let no_option = format!("--{name}");
    for arguments in
        [vec!["bearing", "tree"], vec!["info", &no_option], vec!["info", &log], vec!["info", "--json", &log], bearing]
    {
        let (_, out, err) = folder.run(&arguments);
        let said = out + &err;
        assert!(said.contains(shown) && !said.contains(|sign: char| sign.is_control() && sign != '\n'), "{said:?}");
    }
    assert_eq!(json(&folder.run(&["bearing", "tree", "--json"]).1)["link"].as_str().unwrap().find(name), Some(0));
}

#[test]
fn a_file_of_another_kind_is_named_for_what_it_is() {
    let folder = Folder::new("kinds");
    folder.link(&link(300, 2.0));
    let args = |rx: &str, tx: &str, t: &str| {
        folder.run(&["bearing", "--rx", rx, "--tx", tx, "--trajectory", t, "--channel", "108"])
    };
    for (rx, tx) in [("t.csv", "tx.dat"), ("rx.dat", "t.csv")] {
        let (status, _, err) = args(rx, tx, "t.csv");
        assert!(status == 1 && err.contains("t.csv is another kind of file, a table of numbers"), "{err}");
        assert!(!err.contains("one run"), "{err}");
    }
    let (status, _, err) = args("rx.dat", "tx.dat", "tx.dat");
    assert!(
        status == 1 && err.contains("tx.dat is a log of CSI: a trajectory is a table of times and places"),
        "{err}"
    );
    assert_eq!(folder.run(&["export", "rx.dat", "rx.npz"]).0, 0);
    for command in [&["info", "rx.npz"][..], &["export", "rx.npz", "x.csv"], &["export", "--dat", "rx.npz", "x.dat"]] {
        let (status, _, err) = folder.run(command);
        assert!(status == 1 && err.contains("rx.npz is another kind of file, a ZIP archive"), "{command:?}: {err}");
    }
    assert!(folder.run(&["info", "t.csv", "--plot", "."]).2.contains("another kind of file"));
    assert!(folder.run(&["view", "t.csv"]).2.contains("another kind of file"));
}

#[test]
fn every_command_ends_with_2_where_it_is_used_wrongly_and_has_the_same_help() {
    let folder = Folder::new("usages");
    let (_, help, _) = folder.run(&["--help"]);
    let commands = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    // What goes on in a further line stands further to the right.
    let first = |line: &'_ str| line.strip_prefix("  ").filter(|rest| !rest.starts_with(' ')).is_some();
    let commands: Vec<&str> =
        commands.filter(|line| first(line)).filter_map(|line| line.split_whitespace().next()).collect();
    assert!(commands.len() > 5 && commands.contains(&"bearing") && commands.contains(&"simulate"), "{commands:?}");
    for command in commands.into_iter().filter(|command| *command != "help") {
        let (status, _, err) = folder.run(&[command, "--no-such-option"]);
        assert!(status == 2 && err.contains("--no-such-option"), "{command}: {status} {err}");
        let (status, help, _) = folder.run(&[command, "--help"]);
        assert!(status == 0 && help.contains("--quiet") && help.contains("--color"), "{command}: {help}");
    }
    // The table of the page is the one of the program.
    let page = std::fs::read_to_string(crate::common::root().join("docs/reference/troubleshooting.md")).unwrap();
    let table: Vec<&str> = page.split("## Exit status").nth(1).unwrap().lines().collect();
    for status in ["0", "1", "2", "3"] {
        assert!(help.contains(&format!("\n  {status}  ")), "{help}");
        assert!(table.iter().any(|line| line.starts_with(&format!("| {status} |"))), "{table:?}");
    }
}

/// A capture without a truth, with the names of Dijkstra et al.
fn capture(folder: &Folder) {
    let made = link(600, 2.0);
    std::fs::create_dir_all(folder.0.join("runs/circle")).unwrap();
    folder.write("runs/circle/csi_rx_real_1.dat", &made.rx.concat());
    folder.write("runs/circle/csi_tx_real_1.dat", &made.tx.concat());
    folder.write("runs/circle/rx_movement_real_1.csv", made.trajectory.as_bytes());
}

#[test]
fn captures_without_a_truth_are_explained_located_and_shown() {
    let folder = Folder::new("truthless");
    capture(&folder);
    let (status, out, err) = folder.run(&["bearing", "runs", "--channel", "108", "--explain"]);
    assert!(status == 0 && out.starts_with("circle/real_1/tx\n") && !out.contains("\ntruth"), "{out}{err}");
    // Links as they are named there, wholly or by their end.
    for name in ["runs/circle/real_1/tx", "runs/circle/tx"] {
        let (status, out, err) = folder.run(&["bearing", name, "--channel", "108", "--json"]);
        let row = json(&out);
        assert_eq!(status, 0, "{err}");
        assert!((row["azimuth_deg"].as_f64().unwrap() - 2f64.to_degrees()).abs() < 0.2, "{row}");
        assert!(row["error_from_mean_pose_deg"].is_null() && row["residual_phase_rad"].is_f64(), "{row}");
    }
    let (status, _, err) = folder.run(&["bearing", "runs/circle/real_2/tx", "--channel", "108"]);
    assert!(status == 1 && err.contains("real_2/tx is no link of runs/circle"), "{err}");
    let (status, _, err) = folder.run(&["bearing", "runs"]);
    assert!(status == 2 && err.contains("--channel"), "{err}");
    let (status, _, err) = folder.run(&["evaluate", "runs", "--channel", "108"]);
    assert!(status == 1 && err.contains("1 capture without one"), "{err}");
    // The transmitter is 1 km away, so the bearing alone says little of where the receiver is; the output says that it is used.
    let unplaced = "not located: the place of tx is not known (--place tx=X,Y)";
    let place = |place: &str| folder.run(&["bearing", "runs", "--channel", "108", "--place", place, "--json"]);
    let receiver = |out: &str| json(out.lines().nth(1).unwrap_or_else(|| panic!("{out}")));
    assert_eq!(receiver(&place("tx7=1,2").1)["error"], unplaced);
    assert_eq!(receiver(&place("tx=-416,909").1)["links"], 1);
    assert_eq!(place("tx=1").0, 2);
    // One motion has a direction and no range: a long place. Another, beside the first, looks past it at a right angle.
    let locate = |more: &[&str]| folder.run(&[&["bearing", "--transmitters", "--channel", "108"], more].concat());
    let place = |out: &str| {
        let found = json(out);
        let number = |name: &str, k: usize| found[name][k].as_f64().unwrap_or_else(|| panic!("{found}"));
        assert_eq!(found["transmitter"], "tx");
        ([number("position_m", 0), number("position_m", 1)], [number("ellipse_m", 0), number("ellipse_m", 1)], found)
    };
    let (_, [longer, shorter], _) = place(&locate(&["runs", "--json"]).1);
    assert!(longer > 3.0 * shorter, "{longer} {shorter}");
    let beside = ["runs", "other", "--frame", "other/circle=-7.04,3.38,-90", "--place", "tx=-2.50,5.46", "--json"];
    std::fs::rename(folder.0.join("runs"), folder.0.join("other")).unwrap();
    capture(&folder);
    let (status, out, err) = locate(&beside);
    let ([x, y], [longer, _], found) = place(&out);
    // 114.6 degrees from about the origin, and 24.6 from about (-7.04, 3.38), cross six metres from here.
    let off_m = (x + 2.5).hypot(y - 5.46);
    assert!(status == 0 && found["motions"] == 2 && off_m < 0.8 && longer < 4.0, "{found} {err}");
    assert!((found["off_m"].as_f64().unwrap() - off_m).abs() < 1e-3, "{found}");
    let (status, _, err) = locate(&["runs", "--frame", "kitchen=0,0,0"]);
    assert!(status == 2 && err.contains("no capture has this name"), "{err}");
    std::fs::remove_dir_all(folder.0.join("other")).unwrap();
    let (status, _, err) = folder.run(&["evaluate", "runs", "--channel", "108", "--html", "r.html"]);
    assert_eq!(status, 0, "{err}");
}

#[test]
fn logs_of_a_capture_give_their_link_the_name_of_captures() {
    let folder = Folder::new("names");
    capture(&folder);
    let file = |name: &str| format!("runs/circle/{name}");
    let (rx, tx, t) = (file("csi_rx_real_1.dat"), file("csi_tx_real_1.dat"), file("rx_movement_real_1.csv"));
    let args = ["bearing", "--rx", &rx, "--tx", &tx, "--trajectory", &t, "--channel", "108", "--json"];
    assert_eq!(json(&folder.run(&args).1)["link"], "real_1/tx");
    let (status, _, err) = folder.run(&[&args[..], &["--tx", "gone.dat", "--profile", "p.csv"]].concat());
    assert_eq!(status, 3, "{err}");
    folder.write("csi_tx2.dat", &std::fs::read(folder.0.join(&tx)).unwrap());
    let (_, out, _) =
        folder.run(&["bearing", "--rx", &rx, "--tx", "csi_tx2.dat", "--trajectory", &t, "--channel", "108", "--json"]);
    assert_eq!(json(&out)["link"], "csi_tx2");
}

#[test]
fn rows_of_a_trajectory_that_cannot_be_read_are_a_loss_and_a_line_of_headings_is_none() {
    let folder = Folder::new("rows");
    let made = link(600, 2.0);
    folder.link(&made);
    let (status, expected, errors) = folder.bearing(&["--json"]);
    assert_eq!(status, 0, "{errors}");
    folder.write("t.csv", format!("time,ns,x,y,z\n{}", made.trajectory).as_bytes());
    let (status, out, errors) = folder.bearing(&["--json"]);
    assert_eq!((status, &out), (0, &expected), "{errors}");
    // Every tenth row is damaged, by a stray quote among others.
    let damaged = |(k, line): (usize, &str)| match k % 20 {
        5 => line.replacen(',', ",\"x", 1) + "\n",
        15 => "x\n".to_owned(),
        _ => line.to_owned() + "\n",
    };
    let rows: String = made.trajectory.lines().enumerate().map(damaged).collect();
    folder.write("t.csv", rows.as_bytes());
    let (status, out, errors) = folder.bearing(&["--json"]);
    let lost = made.trajectory.lines().count() / 10;
    assert!(status == 3 && errors.contains(&format!("{lost} rows skipped")), "{status}: {errors}");
    let azimuth = |text: &str| json(text.lines().next().unwrap())["azimuth_deg"].as_f64().unwrap();
    assert!((azimuth(&out) - azimuth(&expected)).abs() < 1.0, "{out}");
    // Times of whole seconds are too coarse for a path that turns; a clock that was set back leaves the longest part.
    let time = |line: &str| line.split(',').next().unwrap().parse::<f64>().unwrap();
    let with_times = |of: &dyn Fn(usize, f64) -> f64| {
        let row = |(k, line): (usize, &str)| format!("{:.6},{}\n", of(k, time(line)), line.split_once(',').unwrap().1);
        made.trajectory.lines().enumerate().map(row).collect::<String>()
    };
    let middle = made.trajectory.lines().count() / 3;
    let set_back = with_times(&|k, t_s| if k < middle { t_s } else { t_s - 1.0 });
    let whole = with_times(&|_, t_s| t_s.floor());
    for (rows, words, expected) in [(whole, "times are rounded to 1 s", 1), (set_back, "time goes back by 0.9", 3)] {
        folder.write("t.csv", rows.as_bytes());
        let (status, _, errors) = folder.bearing(&["--json"]);
        assert!(status == expected && errors.contains(words), "{status}: {errors}");
    }
    // Semicolons and decimal commas change nothing.
    let semicolons: String =
        made.trajectory.lines().map(|line| line.replace(',', ";").replace('.', ",") + "\n").collect();
    folder.write("t.csv", semicolons.as_bytes());
    assert_eq!(folder.bearing(&["--json"]).1, expected);
    // Coordinates that no room has are left out with their rows.
    for far in ["1e308", "-1e308", "1e155"] {
        for every in [1, 2, 7] {
            let moved = |(k, line): (usize, &str)| {
                let mut cells: Vec<&str> = line.split(',').collect();
                if k % every == 0 {
                    cells[2] = far;
                }
                cells.join(",") + "\n"
            };
            let rows: String = made.trajectory.lines().enumerate().map(moved).collect();
            folder.write("t.csv", rows.as_bytes());
            let (status, out, errors) = folder.bearing(&["--json"]);
            assert!(errors.contains("column 3 is further than 1e9 m from the origin"), "{errors}");
            assert_eq!(status, if every == 1 { 1 } else { 3 }, "{far} {every}: {errors}");
            assert!(every == 1 || (azimuth(&out) - azimuth(&expected)).abs() < 1.0, "{far} {every}: {out}");
        }
    }
}

#[test]
fn a_file_that_is_missing_is_no_wrong_usage_and_one_that_makes_no_sense_is() {
    let folder = Folder::new("words-status");
    folder.write("scene.toml", b"colour = 3\n");
    let (status, _, err) = folder.run(&["simulate", "gone.toml", "--out", "o"]);
    assert!(status == 1 && err.contains("no file gone.toml, and no built-in scene"), "{status} {err}");
    folder.link(&link(300, 1.0));
    let (status, _, err) = folder.bearing(&["--key", "gone.key"]);
    assert!(status == 1 && err.contains("gone.key"), "{status} {err}");
    let (status, _, err) = folder.run(&["simulate", "scene.toml", "--out", "o"]);
    assert!(status == 2 && err.contains("scene.toml: line 1: unknown field `colour`"), "{status} {err}");
    // What a configuration has is for the robot's service to say (crates/node/tests/node/program.rs).
    assert_eq!(folder.run(&["node", "--check", "--colour", "never", "--no-such-option"]).0, 2);
}

/// A sender repeats some of its frames; many numbers that come twice may be somebody else's answers.
#[test]
fn numbers_that_come_twice_are_said_where_they_are_many() {
    let folder = Folder::new("twice");
    let made = link(400, 1.0);
    folder.link(&made);
    let said = |every: usize| {
        let twice = |(at, record): (usize, &Vec<u8>)| record.repeat(1 + usize::from(at % every == 0));
        folder.write("rx.dat", &made.rx.iter().enumerate().flat_map(twice).collect::<Vec<u8>>());
        folder.bearing(&["-v"]).1
    };
    let words = "100 frames of the receiver's log repeat an earlier number";
    assert!(said(4).contains(words), "{}", said(4));
    assert!(folder.bearing(&[]).1.contains(words), "without -v, too");
    assert!(!said(20).contains("repeat an earlier number") && said(20).contains("20 duplicates"), "{}", said(20));
}

#[test]
fn columns_that_may_mean_two_things_are_asked_for() {
    let folder = Folder::new("columns");
    let made = link(600, 2.0);
    folder.link(&made);
    let (_, plain, _) = folder.bearing(&["--json"]);
    // Time, x, y and yaw, as a robot's own logger writes them, without headings and with.
    let rows: Vec<Vec<&str>> = made.trajectory.lines().map(|line| line.split(',').collect()).collect();
    let four: String = rows.iter().map(|row| format!("{},{},{},0.5\n", row[0], row[2], row[3])).collect();
    folder.write("t.csv", four.as_bytes());
    let (status, _, err) = folder.bearing(&[]);
    assert!(status == 1 && err.contains("4 columns without headings") && err.contains("--columns"), "{status}: {err}");
    let azimuth = |out: &str| json(out.trim())["azimuth_deg"].as_f64().unwrap();
    let (_, named, err) = folder.bearing(&["--json", "--columns", "t,x,y,yaw"]);
    assert!((azimuth(&named) - azimuth(&plain)).abs() < 1e-6, "{err}");
    folder.write("t.csv", format!("time [s],pos_x,pos_y,yaw\n{four}").as_bytes());
    let (_, headed, err) = folder.bearing(&["--json"]);
    assert!((azimuth(&headed) - azimuth(&plain)).abs() < 1e-6, "{err}");
    let (status, _, err) = folder.bearing(&["--columns", "t,x,z"]);
    assert!(status == 2 && err.contains("name no y"), "{status}: {err}");
    let (status, _, err) = folder.bearing(&["--antenna-offset", "4.6,15.9,0"]);
    assert!(status == 1 && err.contains("16.6 m is off the robot"), "{status}: {err}");
    let (status, _, err) =
        folder.run(&["bearing", "--rx", "rx.dat", "--tx", "tx.dat", "--trajectory", "t.csv", "--channel", "37"]);
    assert!(status == 2 && err.contains("`37` is no channel"), "{status}: {err}");
}
