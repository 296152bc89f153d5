use super::*;

const GOOD: &str = r#"duration_s = 10.0
seed = 3
noise_free = true
[cfo.paper]
df_hz = 10
[[robot]]
name = "rx"
mac = "00:21:6A:53:89:D2"
motion.circle = { radius_m = 0.3, duration_s = 10.0 }
[[robot]]
name = "tx"
position_m = [-3.858, 0.929, 0.0]
[[wall]]
from_m = [-5.0, 3.0]
to_m = [5.0, 3.0]
"#;

fn good() -> String {
    GOOD.replace("noise_free = true", "reflections = 1")
}

fn refused(text: &str) -> (usize, String) {
    let error = Scene::from_toml(text).unwrap_err();
    (error.line().unwrap_or_else(|| panic!("no line: {error}")), error.to_string())
}

#[test]
fn a_good_scene_is_read() {
    let scene = Scene::from_toml(&good()).unwrap();
    assert_eq!(scene.robot.len(), 2);
    assert_eq!(scene.robot[1].mac_address(1).unwrap().0, [2, 0x53, 0, 0, 0, 1]);
    assert!(matches!(scene.cfo, super::super::scene::Cfo::Paper(c) if c.c1 == 10_000.0 && c.df_hz == 10.0));
}

#[test]
fn bad_scenes_are_refused_with_line_and_reason() {
    let good = good();
    let cases: [(String, usize, &str); 37] = [
        (GOOD.to_owned(), 3, "noise_free"),
        (good.replace("duration_s = 10.0\nseed", "duration_s = -1.0\nseed"), 1, "more than 0"),
        (good.replace("duration_s = 10.0\nseed", "duration_s = 1e12\nseed"), 1, "is the most"),
        (good.replace("seed = 3", "radio.host_latency_std_us = 1e18"), 2, "is the most"),
        (good.replace("name = \"tx\"", "name = \"tx\"\nodometry.rate_hz = 1e12"), 12, "is the most"),
        (good.replace("seed = 3", "channel = 20"), 2, "channels are"),
        (good.replace("radius_m = 0.3,", "radius_m = -0.3,"), 9, "radius_m is -0.3"),
        (good.replace("radius_m = 0.3,", "radius_m = 0.3, colour = 1,"), 9, "colour"),
        (good.replace("name = \"tx\"", "name = \"tx\"\nmac = \"00:21:6a:53:89:d2\""), 12, "is also that of rx"),
        (good.replace("mac = \"00:21:6A:53:89:D2\"", "mac = \"00:21:6A:53:89\""), 8, "no MAC address"),
        (good.replace("[-3.858, 0.929, 0.0]", "[-3.858, 2.97, 0.0]"), 12, "inside the wall"),
        (good.replace("[-3.858, 0.929, 0.0]", "[0.0, 0.0, 0.0]"), 12, "tx is where rx is"),
        (good.replace("radius_m = 0.3,", "radius_m = 1.6,"), 9, "drives, after"),
        (good.replace("name = \"tx\"", "name = \"tx\"\n[robot.faults]\nloss = 1.5\n[robot.x]"), 14, "x"),
        (good.replace("name = \"tx\"", "name = \"tx\"\nfaults.loss = 1.5"), 12, "a share"),
        (
            good.replace("name = \"tx\"", "name = \"tx\"\nfaults = { stall_every_s = 1.0, stall_s = 1.0 }"),
            12,
            "never go on",
        ),
        // Both are 2 us on the clock of the room.
        (
            good.replace("name = \"tx\"", "name = \"tx\"\nfaults = { stall_every_s = 0.000002, stall_s = 0.0000016 }"),
            12,
            "never go on",
        ),
        (good.replace("seed = 3", "start_unix_s = 4294967294"), 2, "lasts 10 s; records hold"),
        (good.replace("seed = 3", "start_unix_s = -1"), 2, "is -1"),
        (
            good.replace("name = \"tx\"", "name = \"tx\"\nhost_clock.offset_s = -9.0")
                .replace("seed = 3", "start_unix_s = 5"),
            12,
            "is -9 s ahead of a scene that begins at 5 s",
        ),
        (
            good.replace("name = \"tx\"", "name = \"tx\"\nmotion.random_walk = { speed_m_s = 1.0, duration_s = 1e9 }"),
            12,
            "86400 is the most",
        ),
        (
            good.replace("motion.circle = { radius_m = 0.3, duration_s = 10.0 }", "antenna_m = [-3.858, 0.929, 0.2]")
                .replace("name = \"tx\"", "name = \"tx\"\nantenna_m = [0.0, 0.0, 0.2]"),
            12,
            "an antenna of tx is where one of rx is",
        ),
        (good.replace("to_m = [5.0, 3.0]", "to_m = [-5.0, 3.0]"), 15, "where the wall begins"),
        (good.replace("to_m = [5.0, 3.0]", "to_m = [1e308, 3.0]"), 15, "at most 1e9"),
        (good.replace("to_m = [5.0, 3.0]", "to_m = [5.0, 3.0]\ntop_m = inf"), 16, "at most 1e9"),
        (good.replace("radius_m = 0.3,", "radius_m = 0.3, turns = inf,"), 9, "at most 1e9"),
        (good.replace("seed = 3", "radio.turn_around.max_us = 1e300"), 2, "is the most"),
        (
            good.clone()
                + "[[reflector]]\ncorner_m = [9.0, 9.0, 0.0]\nedge_a_m = [1e308, 0.0, 0.0]\nedge_b_m = [0.0, 0.0, 1.0]\n",
            good.lines().count() + 3,
            "at most 1e9",
        ),
        (good.replace("name = \"tx\"", "name = \"tx\"\nodometry.noise_m = 1e300"), 12, "is the most"),
        (good.replace("duration_s = 10.0 }", "duration_s = 1e-300 }"), 9, "is the least"),
        (good.replace("seed = 3", "radio.noise = { floor_dbm = 1e300 }"), 2, "numbers of dB"),
        (good.replace("seed = 3", "radio.delay_ns = 1e300"), 2, "at most 1e9"),
        (good.replace("seed = 3", "radio.send_delay = { share = 2.0 }"), 2, "a share"),
        (good.replace("seed = 3", "radio.send_delay = { us = -1.0 }"), 2, "us is -1"),
        (good.replace("seed = 3", "radio.filter_db = [0.0, 1.0]"), 2, "length 2"),
        (good.replace("name = \"tx\"", "name = \"tx\"\npattern = { cos_db = 70.0 }"), 12, "60 dB"),
        (
            good.replace(
                "circle = { radius_m = 0.3, duration_s = 10.0 }",
                "recorded = { file = \"t\", stray_m = -0.1 }",
            ),
            9,
            "stray_m is -0.1",
        ),
    ];
    for (text, line, what) in cases {
        let (got, reason) = refused(&text);
        assert!(reason.contains(what), "{reason:?} does not say {what:?}");
        assert_eq!(got, line, "{reason}\n{text}");
    }
}

#[test]
fn missing_things_are_refused_too() {
    assert!(Scene::from_toml("duration_s = 1.0").unwrap_err().to_string().contains("[[robot]]"));
    let no_rate = good().replace("[cfo.paper]", "[sounding]\nrate_hz = -5.0\n[cfo.paper]");
    let (line, reason) = refused(&no_rate);
    assert_eq!((line, reason.contains("rate_hz is -5")), (5, true), "{reason}");
    let nobody = good().replace("[cfo.paper]", "[sounding]\ninitiators = [\"me\"]\n[cfo.paper]");
    assert!(refused(&nobody).1.contains("no robot \"me\""));
    let twice = nobody.replace("[\"me\"]", "[\"rx\", \"tx\", \"rx\"]");
    assert!(refused(&twice).1.contains("names \"rx\" twice"));
}
