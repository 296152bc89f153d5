//! How fast the simulated room is: `cargo bench --bench sim`. One thread; each line is the best of five runs.
#![allow(clippy::expect_used)]

use csi5300::source::{CsiSource, Next};
use csi5300::time::Instant as Virtual;
use csi5300_sim::{Room, Scene};
use std::time::Instant;

/// Every radio effect, no reflections.
const FULL: &str = r#"
cfo = "physical"
[radio]
noise.snr_db = 20.0
phase_noise_rad = 0.16
delay_ns = 200.0
delay_std_ns = 20.0
sampling_offset = true
gain.agc = { target_lsb = 31.0, lsb_std_db = 0.4, rssi_db = 38.0, agc_std_db = 0.8 }
stray_b = { lsb = 0.65, rssi_db = 3.0, rssi_std_db = 3.0 }
stray_c = { lsb = 1.7, rssi_db = 13.0, rssi_std_db = 1.2 }
antenna_order = "by_rssi"
send_jitter_us = 5.0
turn_around = { spread_us = 8.0, tail = 0.1, tail_spread_us = 30.0 }
host_latency_std_us = 20.0
"#;

/// A room of `robots`, the first driving a circle, sounding at `rate_hz`.
fn scene(robots: usize, duration_s: f64, rate_hz: &str, effects: &str) -> Scene {
    let mut text = format!("duration_s = {duration_s:?}\nsounding.rate_hz = {rate_hz}\n{effects}\n");
    for robot in 0..robots {
        let (x, y) = (robot % 8, robot / 8);
        text += &format!("[[robot]]\nname = \"r{robot}\"\nposition_m = [{x}.0, {y}.5, 0.0]\n");
        if robot == 0 {
            text += &format!("motion.circle = {{ radius_m = 0.3, duration_s = {duration_s:?} }}\n");
        }
        text += "crystal = { offset_ppm = 1.5, wander_ppm = 0.02 }\n";
    }
    Scene::from_toml(&text).unwrap_or_else(|e| panic!("{e}\n{text}"))
}

/// Runs a room to its end; records by robot, and seconds.
fn run(scene: &Scene) -> (Vec<u64>, f64) {
    let begin = Instant::now();
    let mut room = Room::new(scene).expect("the room");
    let mut cards: Vec<_> = (0..scene.robot.len()).map(|robot| room.card(robot).expect("a card")).collect();
    cards.iter_mut().for_each(|card| card.own_only());
    let mut counts = vec![0; cards.len()];
    let mut now = Virtual::ZERO;
    let mut over = false;
    while !over {
        over = true;
        let mut next: Option<Virtual> = None;
        for (card, count) in cards.iter_mut().zip(&mut counts) {
            let ended = loop {
                match card.receive(now).expect("no error") {
                    Next::Record(_, record) => *count += u64::from(record.code == 0xBB),
                    Next::Lost(_) => {}
                    Next::Pending => break false,
                    Next::End(_) => break true,
                }
            };
            over &= ended;
            next = [next, card.next_at().filter(|_| !ended)].into_iter().flatten().min();
        }
        now = next.unwrap_or(now);
    }
    (counts, begin.elapsed().as_secs_f64())
}

fn best(scene: &Scene) -> (Vec<u64>, f64) {
    (0..5).map(|_| run(scene)).min_by(|a, b| a.1.total_cmp(&b.1)).expect("five runs")
}

fn main() {
    println!(
        "{:<64} {:>9} {:>9} {:>12}",
        "scene (3 chains, 1 antenna, one thread, best of 5)", "pairs", "seconds", "pairs/s"
    );
    for (name, effects) in [("every radio effect, no reflections", FULL), ("bare: geometry and 8-bit records only", "")]
    {
        let (counts, s) = best(&scene(2, 60.0, "1000", effects));
        println!("{name:<64} {:>9} {s:>9.3} {:>12.0}", counts[0], counts[0] as f64 / s);
    }
    for robots in [2, 4] {
        let (counts, s) = best(&scene(robots, 3_600.0, "10", FULL));
        let name = format!("an hour of {robots} robots at 10 rounds/s, every radio effect");
        println!("{name:<64} {:>9} {s:>9.3} {:>12.0}", counts[0], counts[0] as f64 / s);
    }
    let (counts, s) = run(&scene(32, 60.0, "inf", &format!("{FULL}mcs = 1\n")));
    let name = "60 s of 31 peers at the highest rate, every radio effect, once";
    println!("{name:<64} {:>9} {s:>9.3} {:>12.0}", counts[0], counts[0] as f64 / s);
}
