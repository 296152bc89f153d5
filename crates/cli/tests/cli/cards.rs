//! Cards other than the 5300: FeitCSI's logs of two simulated robots, and the constants between the chains of one.

use crate::commands::{Folder, json};
use std::path::PathBuf;

/// Simulates a scene into `name`; the receiver's log, the transmitter's, and the trajectory that begins so.
fn simulated(folder: &Folder, name: &str, scene: &str, trajectory: &str) -> [String; 3] {
    folder.write("scene.toml", scene.as_bytes());
    let (status, _, err) = folder.run(&["simulate", "scene.toml", "--out", name]);
    assert_eq!(status, 0, "{err}");
    let find = |start: &str| {
        let files = std::fs::read_dir(folder.0.join(name)).unwrap().map(|entry| entry.unwrap().path());
        let is_it = |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().starts_with(start);
        files.into_iter().find(is_it).unwrap().to_str().unwrap().to_owned()
    };
    ["csi_rx_", "csi_tx1_", trajectory].map(find)
}

const PAIR: &str = "duration_s = 12.0\ncard = \"ax210\"\ncfo = \"physical\"\nsounding.rate_hz = 50\n\
     [radio]\nnoise.snr_db = 20\nsend_jitter_us = 60\nturn_around.spread_us = 8\n\
     [[robot]]\nname = \"rx\"\nmotion.circle = { radius_m = 0.25, duration_s = 12.0 }\n\
     [[robot]]\nname = \"tx\"\nposition_m = [-4.0, 9.0, 0.0]\ncrystal.offset_ppm = -6.0\n";

#[test]
fn two_logs_of_feitcsi_give_the_rooms_bearing() {
    let folder = Folder::new("feitcsi");
    let [rx, tx, path] = simulated(&folder, "room", PAIR, "rx_trajectory_");
    let (status, out, err) = folder.run(&["info", &rx]);
    assert!(status == 0 && out.contains("FeitCSI, 600 frames") && out.contains("of two robots"), "{out}{err}");
    let (status, out, err) = folder.run(&["bearing", &rx, &tx, &path, "--channel", "108", "--json"]);
    let answer = json(out.lines().next().unwrap());
    assert_eq!(status, 0, "{err}");
    // From the circle's middle, 25 cm to the left of where it began.
    let truth_deg = (9.0_f64 - 0.25).atan2(-4.0).to_degrees();
    assert!((answer["azimuth_deg"].as_f64().unwrap() - truth_deg).abs() < 0.2, "{answer}");
    assert!(answer["compensated"].as_bool().unwrap() && answer["pairs"].as_u64().unwrap() >= 595, "{answer}");
    // The same of the folder, whose files are named as those of a capture.
    let (status, out, err) = folder.run(&["bearing", "room", "--json"]);
    assert_eq!((status, &json(out.lines().next().unwrap())["azimuth_deg"]), (0, &answer["azimuth_deg"]), "{err}");

    // Damage costs what it is in, and is said; a log that was cut is read to there.
    let mut log = std::fs::read(&rx).unwrap();
    let len = log.len() / 600;
    log.truncate(log.len() - 100);
    log.drain(200 * len + 300..200 * len + 400);
    let damaged = folder.write("damaged.csi", &log);
    let damaged = damaged.to_str().unwrap();
    let (status, out, err) =
        folder.run(&["bearing", "--rx", damaged, "--tx", &tx, "--trajectory", &path, "--channel", "108"]);
    assert!(status == 3 && out.contains("114.") && err.contains("598 bfee records"), "{status} {out}{err}");
    // Frames of 80 and 160 MHz are taken about their centres.
    for (width, number, centre) in [("80", "106", "5530MHz"), ("160", "114", "5570MHz")] {
        let wide = PAIR.replace("card =", &format!("bandwidth_mhz = {width}\nchannel = {number}\ncard ="));
        let [rx, tx, path] = simulated(&folder, width, &wide, "rx_trajectory_");
        let (status, out, err) = folder.run(&["bearing", &rx, &tx, &path, "--channel", centre, "--json"]);
        let answer = json(out.lines().next().unwrap());
        assert!(status == 0 && !err.contains("by that"), "{err}");
        assert!((answer["azimuth_deg"].as_f64().unwrap() - truth_deg).abs() < 0.2, "{width}: {answer}");
        let (_, _, err) = folder.run(&["bearing", &rx, &tx, &path, "--channel", "108"]);
        assert!(err.contains("name the channel by that, for example --channel 5530MHz"), "{err}");
    }
}

#[cfg(feature = "live")]
#[test]
fn claims_about_fields_of_a_5300_are_not_tried_on_logs_of_another_card() {
    let folder = Folder::new("accept-cards");
    let [rx, tx, _] = simulated(&folder, "room", PAIR, "rx_trajectory_");
    let (status, out, err) = folder.run(&["doctor", "--accept", &rx, &tx, "--channel", "108", "--json"]);
    assert_eq!(status, 0, "{out}{err}");
    let report = json(&out);
    let verdict = |id: &str| {
        let all = report["findings"].as_array().unwrap();
        all.iter()
            .filter(|one| one["id"] == id)
            .map(|one| one["verdict"].as_str().unwrap().to_owned())
            .collect::<Vec<_>>()
    };
    assert_eq!(verdict("reception.saturation"), ["not_tried"; 2], "{report}");
    for id in ["card.clock", "card.rate", "log.whole", "reception.snr", "reception.subcarriers"] {
        assert_eq!(verdict(id), ["holds"; 2], "{id}");
    }
}

#[test]
fn all_subcarriers_of_another_card_are_exported() {
    let folder = Folder::new("export-cards");
    let [rx, ..] = simulated(&folder, "room", PAIR, "rx_trajectory_");
    let (status, out, err) = folder.run(&["export", &rx, "a.csv", "--from", "1", "--to", "2", "--json"]);
    assert_eq!(status, 0, "{err}");
    let text = std::fs::read_to_string(folder.0.join("a.csv")).unwrap();
    let records = text.lines().count() as u64 - 1;
    assert!((48..=52).contains(&records) && json(out.trim())["records"] == records, "{out}");
    assert_eq!(json(out.trim())["left_out"], 600 - records);
    // 242 subcarriers of HE at 20 MHz, two chains.
    assert_eq!(text.lines().next().unwrap().matches(",re_").count(), 2 * 242);
    for args in [&["--scaled"][..], &["--antennas", "A"], &["--remove-spatial-mapping"]] {
        let (status, _, err) = folder.run(&[&["export", &rx, "b.npz"], args].concat());
        assert!(status == 2 && err.contains("a FeitCSI log"), "{status} {err}");
    }
    let (status, _, err) = folder.run(&["export", &rx, "c.npz", "--mac", "02:00:00:00:00:09"]);
    assert!(status == 1 && err.contains("600 frames skipped") && !folder.0.join("c.npz").exists(), "{status} {err}");
    let Some(cases) = crate::common::cases("other-cards") else { return };
    for name in
        ["atheros/ath_csi_1.dat", "picoscenes/rx_by_iwl5300.csi", "nexmon/example_4358.pcap", "esp32/example_csi.csv"]
    {
        let log = cases.join(name);
        let (status, _, err) = folder.run(&["export", log.to_str().unwrap(), "d.npz", "--force"]);
        assert!(matches!(status, 0 | 3) && err.contains("written to d.npz"), "{name}: {status} {err}");
    }
}

#[test]
fn the_constant_of_a_turn_gives_a_robot_that_stands_a_bearing() {
    let folder = Folder::new("chains");
    let scene = |motion: &str| {
        format!(
            "duration_s = 5.0\nsounding.rate_hz = 40\n[radio]\nnoise.snr_db = 20\nchain_deg = [-50.0, 0.0]\n\
             chain_noise_rad = 0.1\n[[robot]]\nname = \"rx\"\nyaw_deg = 20.0\nantenna_b_m = [-0.025, 0.0, 0.0]\n{motion}\n\
             [[robot]]\nname = \"tx\"\nposition_m = [30.0, 40.0, 0.0]\n"
        )
    };
    let run = |name: &str, motion: &str, baseline: &str| {
        let [rx, _, path] = simulated(&folder, name, &scene(motion), "odom_rx_trajectory_");
        let baseline = ["--antennas", "A,B", "--baseline", baseline, "--elevation-max", "0", "--json"];
        let logs = ["bearing", "--rx", &rx, "--trajectory", &path, "--channel", "108"];
        let (status, out, err) = folder.run(&[&logs[..], &baseline].concat());
        (status, out.lines().next().map(json).unwrap_or_default(), err)
    };
    let (status, turned, err) = run("turn", "motion.circle = { radius_m = 0.0, duration_s = 5.0 }", "0.025,0,0");
    assert_eq!(status, 0, "{err}");
    // Of A against B the constant is that of B against A with the other sign.
    let [deg, sd_deg] = [0, 1].map(|k| turned["chain_constants_deg"][0][k].as_f64().unwrap());
    assert!((deg - 50.0).abs() < 4.0 * sd_deg && sd_deg < 2.0, "{deg} +- {sd_deg}");
    let (status, still, _) = run("still", "", "0.025,0,0");
    assert!(status != 0 && still["error"].as_str().unwrap().contains("constant between their chains"), "{still}");
    let (status, still, err) = run("still2", "", &format!("0.025,0,0,{deg},{sd_deg}"));
    assert_eq!(status, 0, "{err}");
    let truth_deg = 4.0_f64.atan2(3.0).to_degrees();
    let sides = ["azimuth_deg", "mirror_deg"].map(|key| still[key].as_f64().unwrap());
    let mirror_deg = 40.0 - truth_deg;
    assert!(sides.iter().any(|deg| (deg - truth_deg).abs() < 2.0), "{still}");
    assert!(sides.iter().any(|deg| (deg - mirror_deg).abs() < 2.0), "{still}");
    assert!(still["chain_constants_deg"].is_null() && still["azimuth_sd_deg"].as_f64().unwrap() < 3.0, "{still}");
    let (status, _, err) = run("wrong", "", "0.025,0,0,x");
    assert!(status == 2 && err.contains("degrees"), "{status} {err}");
}
